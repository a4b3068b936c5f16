"""Options that commands share, the notations of their values, and error messages that name options."""

from __future__ import annotations

import functools
import inspect
import re
import time
from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand
from typer.models import OptionInfo

from mufly.cli.output import (
    check_output_place,
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
    """Return the function with the fields of dataclass arguments, such as ``PolarOptions``, as own arguments.

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
