"""Options that commands share, the notations of their values, and error messages that name options."""

from __future__ import annotations

import functools
import inspect
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand
from typer.models import OptionInfo

from mufly.cli.output import (
    check_output_place,
    make_console,
    save_figure,
    write_csv,
    write_text_file,
)
from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.quantities.quantity_grammar import (
    ValueWithStd,
    parse_integer,
    parse_interval,
    parse_quantity,
    parse_rotor_pair_values,
    parse_stepped_range,
    parse_value_with_std,
    parse_values,
    parse_vector,
)
from mufly.quantities.units import split_unit_suffix

if TYPE_CHECKING:
    from mufly.drive import DriveTrain
    from mufly.identify import ParameterEstimate
    from mufly.rotor import Blading, Corrections, Rotor, SystemSolution
    from mufly.rotor.wake import WakeSettings
    from mufly.study import StudySetup
    from mufly.study.study_parameters import ParameterValue
    from mufly.vehicle import Vehicle

# Library arguments whose option has another name.
_OPTION_BY_ARGUMENT = {
    "columns": "column",
    "capacity_As": "capacity",
    "edgewise_m_s": "speed",
    "endpoints": "connect",
    "estimates": "write",
    "gear_ratio": "gear",
    "kinds": "kind",
    "mass_kg": "mass",
    "no_load_current_A": "no_load_current",
    "radius_m": "radius",
    "resistance_ohm": "resistance",
    "spectra": "spectrum",
    "speed_rad_s": "rpm",
    "speed_constant_rad_Vs": "kv",
    "structure": "model",
    "symbols": "free",
}


class OptionNamingCommand(TyperCommand):
    """A command whose errors name the option ``--radius`` in place of the library's argument ``radius_m``."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise self._name_option_in_error(error) from error

    def _name_option_in_error(self, error: InputError) -> InputError:
        options = {p.name: max(p.opts, key=len) for p in self.params if p.name and p.param_type_name == "option"}

        def find_option(argument: str) -> str | None:
            other = _OPTION_BY_ARGUMENT.get(argument, argument)
            names = (argument, other, f"{other}_", split_unit_suffix(other)[0])
            return next((options[n] for n in names if n in options), None)

        remedy = re.sub(
            r"(?<!--set )(?<!--vary )\b(\w+)=(?=\S)",
            lambda m: f"{find_option(m[1])} " if find_option(m[1]) else m[0],
            error.remedy,
        )
        named = find_option(error.argument) if isinstance(error, ArgumentError) else None
        return InputError(named or error.where, error.key, error.problem, remedy)


class CommandGroup(typer.Typer):
    """A group of :class:`OptionNamingCommand`."""

    def command(self, name: str | None = None, **more: Any) -> Any:
        """Register a command, as :meth:`typer.Typer.command` does; fields of option records become options."""
        register = super().command(name, **{"cls": OptionNamingCommand, **more})

        def register_function(function: Callable[..., Any]) -> Callable[..., Any]:
            register(_expand_option_records(function))
            return function

        return register_function


def _expand_option_records(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function with the fields of dataclass arguments, such as :class:`PolarOptions`, as own arguments.

    Numeric options without a notation are plain counts or numbers. Fields with an option annotation become options;
    other fields do not. The defaults are those of the function's default record.
    """
    hints = get_type_hints(function, include_extras=True)
    records: dict[str, Any] = {}
    arguments: list[inspect.Parameter] = []
    for one in inspect.signature(function).parameters.values():
        if not is_dataclass(kind := hints[one.name]):
            arguments.append(one.replace(annotation=_add_option_parser(hints[one.name])))
            continue
        records[one.name] = kind
        each = get_type_hints(kind, include_extras=True)
        arguments += [
            one.replace(name=f.name, default=getattr(one.default, f.name), annotation=_add_option_parser(each[f.name]))
            for f in fields(kind)
            if get_origin(each[f.name]) is Annotated
        ]

    @functools.wraps(function)
    def call_with_option_records(**given: Any) -> Any:
        for name, kind in records.items():
            given[name] = kind(**{f.name: given.pop(f.name) for f in fields(kind) if f.name in given})
        return function(**given)

    call_with_option_records.__signature__ = inspect.Signature(arguments)  # type: ignore[attr-defined]
    call_with_option_records.__annotations__ = {a.name: a.annotation for a in arguments}
    return call_with_option_records


@dataclass(frozen=True)
class OptionRange:
    """Range of an option's numbers, ends included (None: unbounded), with the reason."""

    low: float | None
    high: float | None
    unit: str = ""
    reason: str = ""

    def check_value(self, option: str, value: float) -> None:
        """Raise InputError if a value lies outside the range."""
        low, high, rounding = self.low, self.high, 1e-9 * abs(value)  # error of a unit conversion
        if (low is None or value >= low - rounding) and (high is None or value <= high + rounding):
            return
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        wanted = f"{low:.10g} to {high:.10g}" if low is not None and high is not None else ""
        wanted = wanted or (f"{low:.10g} or more" if high is None else f"{high:.10g} or less")
        why = f": {self.reason}" if self.reason else ""
        raise InputError(option, "", f"{value:.10g}{unit} is out of range{why}", f"give {wanted}{unit}")


def _add_option_parser(annotation: Any) -> Any:
    """Return an option's annotation with a check of its choices, or a parser of its numbers if it has none."""
    if get_origin(annotation) is not Annotated:
        return annotation
    kind, *more = get_args(annotation)
    words = next((get_args(k) for k in (kind, *get_args(kind)) if get_origin(k) is Literal), ())
    if words:
        more = [copy(one) for one in more]
        more[0].callback = OptionChoices(words).check_option
        return Annotated[kind if kind is str else str if get_origin(kind) is Literal else str | None, *more]
    if any(isinstance(one.parser, NumberOptionParser) and not one.parser.is_scalar for one in more):
        return Annotated[str | None if type(None) in get_args(kind) else str, *more]
    numbers = {int, float}.intersection((kind, *get_args(kind), *(x for k in get_args(kind) for x in get_args(k))))
    for k, one in enumerate(more):
        if numbers and isinstance(one, OptionInfo) and one.parser is None:
            plain = NumberOptionParser(
                "", "count" if int in numbers else "one", allowed_range=OptionRange(one.min, one.max)
            )
            more[k] = copy(one)
            more[k].parser, more[k].callback = plain, plain.read_option_values
    return Annotated[kind, *more]


def _option_name(param: typer.CallbackParam) -> str:
    return next((o for o in param.opts if o.startswith("--")), param.opts[0])


@dataclass(frozen=True)
class OptionChoices:
    """Choices of an option whose type is a Literal."""

    words: tuple[str, ...]

    def check_option(self, param: typer.CallbackParam, value: Any) -> Any:
        """Reject a value that is not among the choices; typer calls this method."""
        if value is not None:
            check_choice(_option_name(param), value, self.words)
        return value


@dataclass(frozen=True)
class NumberOptionParser:
    """Parser of an option's numbers, with their unit, form and range (:mod:`mufly.quantities.quantity_grammar`).

    Attributes
    ----------
    unit : str
        Unit of bare numbers and of the option's value; ``""`` for dimensionless numbers.
    form : str
        A key of :data:`NUMBER_FORMS`.
    allowed_words : tuple of str
        Words accepted in place of a number.
    allowed_range : OptionRange
        Range of each number.
    """

    unit: str
    form: str = "one"
    allowed_words: tuple[str, ...] = ()
    allowed_range: OptionRange = OptionRange(None, None)

    def __call__(self, text: Any) -> Any:
        """Return the text unchanged, because only the option's callback, which parses it, knows the option's name."""
        return text

    @property
    def metavar(self) -> str:
        """Placeholder of the value in the help, with the unit of a bare number in brackets."""
        shown = NUMBER_FORMS[self.form][1] + (f"[{self.unit}]" if self.unit not in ("", "1") else "")
        return "|".join([*self.allowed_words, shown])

    @property
    def is_scalar(self) -> bool:
        """True if each value is a number, and neither a tuple nor a word."""
        return self.form in ("one", "count") and not self.allowed_words

    def parse_option_text(self, where: str, text: str) -> Any:
        """Return the number, numbers or word of a text; ``steps`` stay text: the method sets the number of values."""
        if text in self.allowed_words:
            return text
        value = NUMBER_FORMS[self.form][0](where, text, self.unit)
        for number in value if isinstance(value, tuple) else (value,):
            if number is not None:
                self.allowed_range.check_value(where, number)
        return text if self.form == "steps" else value

    def read_option_values(self, param: typer.CallbackParam, value: Any) -> Any:
        """Read the value or values of an option; typer calls this."""
        name = _option_name(param)
        if isinstance(value, list | tuple):
            return [self.parse_option_text(name, v) if isinstance(v, str) else v for v in value]
        return self.parse_option_text(name, value) if isinstance(value, str) else value


NUMBER_FORMS: dict[str, tuple[Callable[[str, str, str], Any], str]] = {
    "one": (parse_quantity, "NUMBER"),
    "count": (lambda where, text, unit: parse_integer(where, text), "N"),
    "values": (parse_values, "VALUES"),
    "settings": (functools.partial(parse_values, most=1000), "VALUES"),
    "pair": (parse_rotor_pair_values, "UPPER[,LOWER]"),
    "band": (parse_interval, "LOW:HIGH"),
    "steps": (parse_stepped_range, "FIRST:LAST[:STEP]"),
    "vector": (parse_vector, "SPEED|N,E,D"),
    "doubt": (parse_value_with_std, "NUMBER[+-STD]"),
}
"""Forms of an option's numbers: the reading function, and the placeholder in the help."""


THRUST_RANGE = OptionRange(1e-3, 1e3, "N", "no micro helicopter has such a thrust")
DUTY_RANGE = OptionRange(0.01, 1.0, "", "a share of the supply voltage; below a hundredth, friction holds the motor")
CHARGE_RANGE = OptionRange(0.0, 1.0, "", "a share of the battery's capacity")
GEAR_RATIO_RANGE = OptionRange(0.02, 500.0, "", "no gear train of a few stages has such a ratio")
PITCH_RANGE = OptionRange(-90.0, 90.0, "deg", "beyond, the blade moves trailing edge first")
SPEED_RANGE = OptionRange(0.1, 1e6, "rpm", "no rotor has such a speed")
SPACING_RANGE = OptionRange(1e-4, 5.0, "m", "no coaxial pair has such a distance; write 20 mm as 20mm")


def define_option(
    names: str, help: str, *, unit: str | None = None, form: str = "one", words: tuple[str, ...] = (),
    within: OptionRange | None = None, **more: Any,
) -> Any:  # fmt: skip
    """Define an option of a command: return the ``typer.Option`` that annotates a parameter.

    Parameters
    ----------
    names : str
        Its names, if they differ from its parameter's, and the placeholder of its value: ``"--out -o DIR"``.
    help : str
        Purpose of the option.
    unit : str, optional
        Unit of bare numbers, which :class:`NumberOptionParser` reads and the help shows.
    form, words : str, tuple of str
        As for :class:`NumberOptionParser`.
    within : OptionRange, optional
        Range of its numbers; values outside are rejected before any computation.
    """
    parts = names.split()
    value = [w for w in parts if not w.startswith("-")]
    if unit is not None:
        within = within or OptionRange(more.get("min"), more.get("max"), unit)
        notation = NumberOptionParser(unit, form, words, within)
        more["parser"], more["callback"] = notation, notation.read_option_values
        value = value or [notation.metavar]
    return typer.Option(
        *(w for w in parts if w.startswith("-")), help=help, metavar=value[0] if value else None, **more
    )


def default_text(text: str) -> Any:
    """Return an option's default as written: the parser of the option reads it, and the help shows it."""
    return text


def define_argument(value: str, help: str, **more: Any) -> Any:
    """Define an argument: its placeholder and its purpose in the help."""
    return typer.Argument(help=help, metavar=value or None, **more)


VehicleArgument = Annotated[
    str, define_argument("NAME|FILE", "Built-in vehicle (`mufly vehicle list`), or vehicle file (TOML).")
]
VehicleOption = Annotated[
    str,
    define_option("--vehicle -v NAME|FILE", "Built-in vehicle (`mufly vehicle list`), or vehicle file (TOML)."),
]
MethodOption = Annotated[
    Literal["hinf", "h2", "lqg", "ltr", "mu", "fixed", "scheduled", "indi"],
    define_option(
        "--method WHICH",
        "Method of synthesis: hinf, h2 (the same weights), lqg or ltr (LQG with loop transfer recovery). Four more "
        "apply to roll-pitch only, while heave-yaw stays hinf: mu (D-K iteration over the vehicle's parameters), fixed "
        "(--order, tuned for several goals), scheduled (fixed, with outputs over forward speed) and indi (incremental "
        "inversion).",
    ),
]
OrderOption = Annotated[
    int | None,
    define_option("--order N", "Order of roll-pitch with --method fixed or scheduled. Default: 4.", min=2, max=8),
]
TunedOption = Annotated[
    list[str] | None,
    define_option(
        "--tuned FILE", "Controller file of a loop, written by `mufly control tune`. Repeat it for the other loop."
    ),
]
MissionArgument = Annotated[
    str, define_argument("MISSION", "Built-in mission (`mufly mission list`), or mission file.")
]
OptionalMissionArgument = Annotated[
    str | None, define_argument("MISSION", "Built-in mission (`mufly mission list`), or mission file. Default: none.")
]
SeedOption = Annotated[int, define_option("--seed K", "Seed of all random numbers.")]
ClusterOption = Annotated[
    str | None,
    define_option("--cluster ADDRESS", "Scheduler of a dask cluster, as tcp://host:8786. Default: this machine."),
]
CLIMB_RANGE = OptionRange(-300.0, 300.0, "m/s", "the methods are not valid near the speed of sound")
DENSITY_RANGE = OptionRange(1e-3, 20.0, "kg/m3", "air has no such density; 1200 g/m3 are 1.2")
ClimbOption = Annotated[
    float, define_option("--climb", "Axial speed, positive in climb.", unit="m/s", within=CLIMB_RANGE)
]
DensityOption = Annotated[float, define_option("--density", "Density of the air.", unit="kg/m3", within=DENSITY_RANGE)]
RpmOption = Annotated[float, define_option("--rpm", "Rotor speed.", unit="rpm", within=SPEED_RANGE)]
OptionalRpmOption = Annotated[float | None, define_option("--rpm", "Rotor speed.", unit="rpm", within=SPEED_RANGE)]
PitchOption = Annotated[
    float,
    define_option("--pitch", "Pitch setting of the blades: 12, 12deg or 0.2rad.", unit="deg", within=PITCH_RANGE),
]
OptionalPitchOption = Annotated[
    float | None,
    define_option("--pitch", "Pitch setting of the blades: 12, 12deg or 0.2rad.", unit="deg", within=PITCH_RANGE),
]
SpacingOption = Annotated[
    float, define_option("--spacing", "Distance between the discs, as 20mm.", unit="m", within=SPACING_RANGE)
]
PairPitchOption = Annotated[
    tuple[float, ...],
    define_option(
        "--pitch",
        "Pitch settings of upper and lower rotor: 14, 14,12 or 0.2rad.",
        unit="deg",
        form="pair",
        within=PITCH_RANGE,
    ),
]
PairRpmOption = Annotated[
    tuple[float, ...],
    define_option(
        "--rpm",
        "Speeds of upper and lower rotor, as 6000,6650; one value holds for both.",
        unit="rpm",
        form="pair",
        within=SPEED_RANGE,
    ),
]
AirspeedsOption = Annotated[
    tuple[float, ...],
    define_option(
        "--speed", "Airspeeds, as 0:10:1 or 4.", unit="m/s", form="values",
        within=OptionRange(0.0, 100.0, "m/s", "no small helicopter has such an airspeed"),
    ),
]  # fmt: skip
DiscTiltOption = Annotated[
    float,
    define_option(
        "--tilt", "Tilt of the disc into the wind, positive nose down.", unit="deg",
        within=OptionRange(-90.0, 90.0, "deg", "at 90 degrees the flow is along the shaft"),
    ),
]  # fmt: skip
FlapRatiosOption = Annotated[
    tuple[float, ...] | None,
    define_option(
        "--flap-frequency-ratio",
        "Flap frequency over rotor speed (1/rev), one or several. Default: both ends of the band of `mufly rotor "
        "beam`.",
        unit="1", form="values",
        within=OptionRange(1.0, 20.0, "", "1 is a free hinge at the shaft, and no blade is so stiff"),
    ),
]  # fmt: skip
RotorArgument = Annotated[
    str, define_argument("NAME|FILE", "Built-in rotor (`mufly rotor list`), or rotor file (TOML).")
]
DriveOption = Annotated[
    str | None,
    define_option(
        "--drive NAME|FILE",
        "Drive train: 'mufly', a built-in vehicle, a drive or vehicle file; 'none' for no drive.",
    ),
]
JsonOption = Annotated[bool, define_option("--json", "Print JSON, in SI units, and nothing else.")]
OutOption = Annotated[Path | None, define_option("--out DIR", "Folder for pictures (PNG) and tables.")]
ModelOption = Annotated[
    Literal["full", "plain", "thesis"],
    define_option(
        "--model NAME",
        "Blade element theory: 'full' (finite chord, rotation), 'plain' (textbook) or 'thesis' (as in "
        "the dissertation).",
    ),
]


def check_choice(option: str, value: str, known: Iterable[str]) -> None:
    """Raise InputError if an option has an unknown value."""
    names = tuple(known)
    if value not in names:
        raise InputError(option, "", f"{value!r} is unknown", suggest_name(value, names))


def load_drive_option(name: str | None) -> DriveTrain | None:
    """Return the drive of ``--drive``; None without one."""
    from mufly.drive import load_drive

    return None if name is None or name == "none" else load_drive(name)


# ----------------------------------------------------------------------------
# Computation of rotors: options that the commands of rotors and pairs share, and the wake's progress.


_INTEGER_WAKE_SETTINGS = ("phases", "iterations", "stations")


@dataclass(frozen=True)
class PolarOptions:
    """Options of blade element calculations."""

    n_crit: Annotated[
        float,
        define_option(
            "--n-crit NUMBER",
            "Amplification exponent of transition (e^N): 0.1 for a vibrating rotor, 9 for a quiet wind tunnel.",
        ),
    ] = 0.1
    engine: Annotated[
        Literal["neuralfoil", "xfoil", "table"],
        define_option("--engine NAME", "Polars: 'neuralfoil', 'table' or, where installed, 'xfoil'."),
    ] = "neuralfoil"
    model: ModelOption = "full"

    def select_corrections(self) -> Corrections:
        """Return the corrections that ``--model`` selects."""
        from mufly.study import BEMT_MODELS

        return BEMT_MODELS[self.model]

    def prepare_blading(self, rotor: Rotor, stations: int | None = None) -> Blading:
        """Return a blading of a rotor with its polars."""
        from mufly.rotor import prepare_blading
        from mufly.rotor.blading import STATION_COUNT

        return prepare_blading(
            rotor, n_crit=self.n_crit, engine=self.engine, corrections=self.select_corrections(),
            stations=stations or STATION_COUNT,
        )  # fmt: skip

    def make_study_setup(self, rotor: str, fixed: Mapping[str, ParameterValue], **more: Any) -> StudySetup:
        """Return the setup shared by all cases of a study of a rotor or, with ``lower`` in ``more``, of a pair."""
        from mufly.rotor import load_rotor
        from mufly.study import StudySetup

        return StudySetup(
            load_rotor(rotor), fixed_parameters={"n_crit": self.n_crit, **fixed}, corrections=self.select_corrections(),
            polar_engine=self.engine, **more,
        )  # fmt: skip


@dataclass(frozen=True)
class WakeOptions(PolarOptions):
    """Command-line options of vortex wakes."""

    method: Literal["bemt", "tubes", "wake", "cfd"] = "wake"  # no option here, but one in TheoryOptions
    wake_geometry: Annotated[
        Literal["free", "prescribed"],
        define_option("--wake NAME", "Wake geometry: 'free', or 'prescribed' (Landgrebe's, for slender blades)."),
    ] = "free"
    wake_set: Annotated[
        list[str] | None,
        define_option(
            "--wake-set NAME=VALUE",
            "Setting of the wake, as step_deg=10, turns=6, core=0.05, iterations=300, or stations=30 for "
            "each blade. Repeat it for more.",
        ),
    ] = None

    def wake_settings_and_stations(self, **defaults: float) -> tuple[WakeSettings, int]:
        """Return settings of the wake and the number of stations along a blade; ``--wake-set`` overrides ``defaults``.

        Raises
        ------
        InputError
            If an option is unknown or out of range.
        """
        from mufly.rotor.blading import STATION_COUNT
        from mufly.rotor.wake import WakeSettings

        if self.method != "wake" and self.wake_geometry != "free":
            raise InputError("--wake", "", "blade element theory has no wake", "add --method wake")
        known = [f.name for f in fields(WakeSettings) if f.name not in ("model", "inviscid")]
        given: dict[str, Any] = {**defaults}
        for text in self.wake_set or []:
            name, equals, value = (part.strip() for part in text.partition("="))
            if not equals or name not in (*known, "stations"):
                otherwise = f"use NAME=VALUE with {', '.join(known)}, stations"
                remedy = suggest_name(name, [*known, "stations"], otherwise) if equals else otherwise
                raise InputError("--wake-set", text, "is unknown", remedy)
            where = f"--wake-set: {name}"
            unit = split_unit_suffix(name)[1]
            given[name] = (
                parse_integer(where, value) if name in _INTEGER_WAKE_SETTINGS else parse_quantity(where, value, unit)
            )
        stations = given.pop("stations", STATION_COUNT)
        if not 4 <= stations <= 200:
            raise InputError("--wake-set", "stations", f"is {stations}", "give 4 to 200 stations")
        return WakeSettings(model=self.wake_geometry, **given), stations

    def make_study_setup(self, rotor: str, fixed: Mapping[str, ParameterValue], **more: Any) -> StudySetup:
        """Return the setup shared by all cases of a study of a rotor or, with ``lower`` in ``more``, of a pair."""
        wake, stations = self.wake_settings_and_stations()
        return super().make_study_setup(
            rotor, fixed, method=self.method, wake_settings=wake, station_count=stations, **more
        )


@dataclass(frozen=True)
class TheoryOptions(WakeOptions):
    """Options of commands that compute rotors by blade elements, vortex tubes or a vortex wake."""

    method: Annotated[
        Literal["bemt", "tubes", "wake"],
        define_option(
            "--method NAME", "Method: 'bemt' (blade elements), 'tubes' (vortex tubes) or 'wake' (vortex wake, seconds)."
        ),
    ] = "bemt"


DEFAULT_POLAR_OPTIONS, DEFAULT_WAKE_OPTIONS, DEFAULT_BEMT_OPTIONS, DEFAULT_FREE_WAKE_OPTIONS = (
    PolarOptions(),
    WakeOptions(),
    TheoryOptions(),
    TheoryOptions(method="wake"),
)


class WakeIterationRecorder:
    """Recorder of the iterations of one or several successive wakes; the solver calls it after each iteration."""

    def __init__(self, show: Callable[[str], None] | None = None) -> None:
        self.rows: list[tuple[int, int, float, float]] = []  # wake, iteration, residual, thrust
        self.wake_count = 0
        self._show = show

    def __call__(self, iteration: int, residual: float, thrust: float) -> None:
        """Record one iteration."""
        self.wake_count += iteration == 1
        self.rows.append((self.wake_count, iteration, residual, thrust))
        if self._show is not None:
            # A residual above 9 marks the first revolutions of a free wake, held in the prescribed shape.
            miss = "still prescribed" if residual > 9.0 else f"misses the air by {100 * residual:.2g} %"
            self._show(f"wake {self.wake_count}, iteration {iteration}: {miss}, thrust {thrust:.4g} N")


@contextmanager
def show_wake_progress(label: str, shown: bool, folder: Path | None = None) -> Iterator[WakeIterationRecorder]:
    """Report the iterations of a wake on standard error; after a stop or failure its history is left in the folder."""
    try:
        if not shown:
            progress = WakeIterationRecorder()
            yield progress
        else:
            with make_console(stderr=True).status(label) as status:
                progress = WakeIterationRecorder(lambda text: status.update(f"{label}: {text}"))
                yield progress
    except BaseException:
        if folder is not None and progress.rows:
            heads = ("wake", "iteration", "residual", "thrust_N")
            write_csv(folder / "progress.csv", heads, progress.rows)
        raise


def write_wakes(solution: SystemSolution, folder: Path) -> list[Path]:
    """Write the histories of a solution's wakes and, if converged, their geometry and velocity field."""
    from mufly.rotor import draw_flow_field, draw_wake, draw_wake_convergence

    assert solution.settings is not None
    sides = ("",) if len(solution.rotors) == 1 else ("upper_", "lower_")
    heads = ["residual", *(f"{side}{load}" for side in sides for load in ("thrust_N", "torque_Nm"))]
    history = draw_wake_convergence(solution.history, residual=solution.settings.residual, note=solution.message)
    files = [write_csv(folder / "history.csv", heads, solution.history), save_figure(history, folder, "history")]
    if solution.converged:
        files.append(save_figure(draw_wake(solution), folder, "wake"))
        files.append(save_figure(draw_flow_field(solution), folder, "air"))
        files.append(save_figure(draw_flow_field(solution, mean=False), folder, "air-instant"))
    return files


# ----------------------------------------------------------------------------
# Identification: options that its commands share, numbers with standard deviations, tables, vehicle files, outputs.


ColumnOption = Annotated[
    list[str] | None,
    define_option(
        "--column -c NAME=COLUMN(unit)",
        "Column of a signal, as thrust_upper=T_B(N), measured_rates.p=-gyro_x(deg/s), "
        "measured_attitude=phi,theta,psi(deg) or time=t(ms). Repeat it for more.",
    ),
]
StartVehicleOption = Annotated[
    str | None, define_option("--vehicle NAME|FILE", "Vehicle to start from and to compare with.")
]
WriteOption = Annotated[
    Path | None,
    define_option("--write FILE", "Vehicle file to write: --vehicle with the values found, their source 'identified'."),
]


PictureOption = Annotated[Path | None, define_option("--out DIR", "Folder for a picture (PNG) of points and fit.")]


def parse_value_and_std(option: str, given: ValueWithStd | str | None) -> tuple[float | None, float]:
    """Return value and standard deviation of an option; (None, 0) for None or the word ``free``.

    Raises
    ------
    InputError
        If the value is not above 0.
    """
    if given is None or isinstance(given, str):
        return None, 0.0
    if not given.value > 0.0:
        raise InputError(option, "", f"{given.value:g} is out of range", "give a number above 0")
    return given.value, given.std


def load_start_vehicle(name: str | None, write: Path | None) -> Vehicle | None:
    """Return the vehicle of ``--vehicle``; InputError if ``--write`` is given without ``--vehicle``."""
    from mufly.errors import InputError
    from mufly.vehicle import load_vehicle

    if name is None and write is not None:
        raise InputError("--write", str(write), "needs a vehicle to start from", "add --vehicle mufly-1.1 or a file")
    check_output_place("--write", write, "file")
    return None if name is None else load_vehicle(name)


def write_estimated_vehicle(
    start: Vehicle | None,
    estimates: Iterable[ParameterEstimate],
    write: Path | None,
    note: str,
    option: str = "--write",
) -> list[Path]:
    """Write the vehicle with its estimates to the file of ``--write``; return the files written."""
    from mufly.identify import apply_estimates
    from mufly.vehicle import format_vehicle_toml

    if write is None or start is None:
        return []
    text = format_vehicle_toml(apply_estimates(start, estimates, note))
    write_text_file(write, text, "give another place", option)
    return [write]


def format_today() -> str:
    """Return the date, for notes in vehicle files."""
    return time.strftime("%Y-%m-%d")
