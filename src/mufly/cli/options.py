"""What commands share: options, what their texts say, and the options' names in place of a library's arguments."""

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
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand
from typer.models import OptionInfo

from mufly.cli.present import check_file, console, write_csv, writing
from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.grammar import (
    read_band,
    read_doubt,
    read_pair,
    read_quantity,
    read_steps,
    read_values,
    read_vector,
    read_whole,
)
from mufly.units import split_suffix

if TYPE_CHECKING:
    from mufly.drive import Drive
    from mufly.identify import Estimate
    from mufly.rotor import Blading, Corrections, Rotor
    from mufly.rotor.sections.engines import Engine
    from mufly.rotor.wake import WakeSettings
    from mufly.study import Setup
    from mufly.study.parameters import Value
    from mufly.vehicle import Vehicle

# Arguments of the library that an option of another name gives.
_OPTIONS = {
    "columns": "column",
    "capacity_As": "capacity",
    "endpoints": "connect",
    "estimates": "write",
    "gear_ratio": "gear",
    "kinds": "kind",
    "mass_kg": "mass",
    "no_load_current_A": "no_load_current",
    "radius_m": "radius",
    "resistance_ohm": "resistance",
    "spectra": "spectrum",
    "speed_constant_rad_Vs": "kv",
    "structure": "model",
    "symbols": "free",
}


class Command(TyperCommand):
    """A command that says ``--radius`` where the library says ``radius_m``: who typed an option is told its name."""

    def invoke(self, ctx: Any) -> Any:
        """Run it."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            raise self._by_option(error) from error

    def _by_option(self, error: InputError) -> InputError:
        options = {
            p.name: max(p.opts, key=len) for p in self.params if p.name and p.param_type_name == "option"
        }

        def option_of(argument: str) -> str | None:
            other = _OPTIONS.get(argument, argument)
            names = (argument, other, f"{other}_", split_suffix(other)[0])
            return next((options[n] for n in names if n in options), None)

        remedy = re.sub(
            r"(?<!--set )(?<!--vary )\b(\w+)=(?=\S)",
            lambda m: f"{option_of(m[1])} " if option_of(m[1]) else m[0],
            error.remedy,
        )
        named = option_of(error.argument) if isinstance(error, ArgumentError) else None
        return InputError(named or error.where, error.key, error.problem, remedy)


class Commands(typer.Typer):
    """A group of such commands."""

    def command(self, name: str | None = None, **more: Any) -> Any:
        """Register a command, as :meth:`typer.Typer.command` does; records of options become options."""
        register = super().command(name, **{"cls": Command, **more})

        def registered(function: Callable[..., Any]) -> Callable[..., Any]:
            register(_spread(function))
            return function

        return registered


def _spread(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with the fields of a record that it takes, such as :class:`Polars`, as arguments of their own.

    Options that hold a number and say no notation are plain counts or numbers.

    A record's fields say which options they are, and those that say nothing are none; the function's default for the
    record holds theirs.
    """
    hints = get_type_hints(function, include_extras=True)
    records: dict[str, Any] = {}
    arguments: list[inspect.Parameter] = []
    for one in inspect.signature(function).parameters.values():
        if not is_dataclass(kind := hints[one.name]):
            arguments.append(one.replace(annotation=_with_notation(hints[one.name])))
            continue
        records[one.name] = kind
        each = get_type_hints(kind, include_extras=True)
        arguments += [
            one.replace(
                name=f.name, default=getattr(one.default, f.name), annotation=_with_notation(each[f.name])
            )
            for f in fields(kind)
            if get_origin(each[f.name]) is Annotated
        ]

    @functools.wraps(function)
    def call(**given: Any) -> Any:
        for name, kind in records.items():
            given[name] = kind(**{f.name: given.pop(f.name) for f in fields(kind) if f.name in given})
        return function(**given)

    call.__signature__ = inspect.Signature(arguments)  # type: ignore[attr-defined]
    call.__annotations__ = {a.name: a.annotation for a in arguments}
    return call


@dataclass(frozen=True)
class Range:
    """What the numbers of an option may be, ends included (None: no end), and why they end there."""

    low: float | None
    high: float | None
    unit: str = ""
    why: str = ""

    def check(self, option: str, value: float) -> None:
        """InputError if a value is outside."""
        low, high, rounding = self.low, self.high, 1e-9 * abs(value)  # of a change of unit
        if (low is None or value >= low - rounding) and (high is None or value <= high + rounding):
            return
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        wanted = f"{low:.10g} to {high:.10g}" if low is not None and high is not None else ""
        wanted = wanted or (f"{low:.10g} or more" if high is None else f"{high:.10g} or less")
        why = f": {self.why}" if self.why else ""
        raise InputError(option, "", f"{value:.10g}{unit} is out of range{why}", f"give {wanted}{unit}")


def _with_notation(annotation: Any) -> Any:
    """The annotation of a number's option with the notation of counts or plain numbers, if it has none."""
    if get_origin(annotation) is not Annotated:
        return annotation
    kind, *more = get_args(annotation)
    numbers = {int, float}.intersection(
        (kind, *get_args(kind), *(x for k in get_args(kind) for x in get_args(k)))
    )
    for k, one in enumerate(more):
        if numbers and isinstance(one, OptionInfo) and one.parser is None:
            plain = Notation("", "count" if int in numbers else "one", within=Range(one.min, one.max))
            more[k] = copy(one)
            more[k].parser, more[k].callback = plain, plain.callback
    return Annotated[kind, *more]


@dataclass(frozen=True)
class Notation:
    """How the numbers of an option are written (:mod:`mufly.grammar`).

    Attributes
    ----------
    unit : str
        Of bare numbers and of the option's value; ``""`` where numbers take no unit.
    form : str
        A key of :data:`FORMS`.
    words : tuple of str
        What may stand in place of a number.
    within : Range
        Of each number.
    """

    unit: str
    form: str = "one"
    words: tuple[str, ...] = ()
    within: Range = Range(None, None)

    def __call__(self, text: Any) -> Any:
        """Return the text as it was typed: the option's callback reads it, because it knows the option's name."""
        return text

    @property
    def metavar(self) -> str:
        """What stands for the value in the help, with the unit of a bare number in brackets."""
        shown = FORMS[self.form][1] + (f"[{self.unit}]" if self.unit not in ("", "1") else "")
        return "|".join([*self.words, shown])

    def read(self, where: str, text: str) -> Any:
        """Return the number of one, or the text of several numbers once it is checked."""
        if text in self.words:
            return text
        value = FORMS[self.form][0](where, text, self.unit)
        for number in value if isinstance(value, tuple) else (value,):
            if number is not None:
                self.within.check(where, number)
        return value if self.form in ("one", "count") and not self.words else text

    def callback(self, param: typer.CallbackParam, value: Any) -> Any:
        """Read the value or values of an option; typer calls it."""
        name = next((o for o in param.opts if o.startswith("--")), param.opts[0])
        if isinstance(value, list | tuple):
            return [self.read(name, v) if isinstance(v, str) else v for v in value]
        return self.read(name, value) if isinstance(value, str) else value


FORMS: dict[str, tuple[Callable[[str, str, str], Any], str]] = {
    "one": (read_quantity, "NUMBER"),
    "count": (lambda where, text, unit: read_whole(where, text), "N"),
    "values": (read_values, "VALUES"),
    "pair": (read_pair, "UPPER[,LOWER]"),
    "band": (read_band, "LOW:HIGH"),
    "steps": (read_steps, "FIRST:LAST[:STEP]"),
    "vector": (read_vector, "SPEED|N,E,D"),
    "doubt": (read_doubt, "NUMBER[+-STD]"),
}
"""How an option writes its numbers: what reads them, and what stands for them in the help."""


THRUST = Range(1e-3, 1e3, "N", "a tenth of a gram is nothing to fly with, and 100 kg no micro helicopter")
DUTY = Range(
    0.01, 1.0, "", "it is a share of the supply voltage, of which friction takes the first hundredth"
)
CHARGE = Range(0.0, 1.0, "", "it is a share of the battery's capacity")
GEAR = Range(0.02, 500.0, "", "no gear train of a few stages is beyond")
PITCH = Range(-90.0, 90.0, "deg", "a blade that is turned further flies backwards")
SPEED = Range(0.1, 1e6, "rpm", "no rotor turns so")
SPACING = Range(1e-4, 5.0, "m", "no pair is built so; 20 mm are written 20mm")


def option(
    names: str, help: str, *, unit: str | None = None, form: str = "one", words: tuple[str, ...] = (),
    within: Range | None = None, **more: Any,
) -> Any:  # fmt: skip
    """An option.

    Parameters
    ----------
    names : str
        Its names, if its parameter's is not enough, and what stands for its value in the help: ``"--out -o DIR"``.
    help : str
        What it is for.
    unit : str, optional
        Of its numbers where they are bare: they are read by :class:`Notation`, which also stands in the help.
    form, words : str, tuple of str
        As for :class:`Notation`.
    within : Range, optional
        Of its number, or numbers; what is outside is refused before anything is done.
    """
    parts = names.split()
    value = [w for w in parts if not w.startswith("-")]
    if unit is not None:
        within = within or Range(more.get("min"), more.get("max"), unit)
        notation = Notation(unit, form, words, within)
        more["parser"], more["callback"] = notation, notation.callback
        value = value or [notation.metavar]
    return typer.Option(
        *(w for w in parts if w.startswith("-")), help=help, metavar=value[0] if value else None, **more
    )


def argument(value: str, help: str, **more: Any) -> Any:
    """An argument: what stands for it in the help, and what it is for."""
    return typer.Argument(help=help, metavar=value or None, **more)


ClimbOption = Annotated[float, option("--climb", "Axial speed, positive in climb.", unit="m/s")]
DensityOption = Annotated[float, option("--density", "Density of the air.", unit="kg/m3")]
RpmOption = Annotated[float, option("--rpm", "Rotor speed.", unit="rpm", within=SPEED)]
SpacingOption = Annotated[
    float, option("--spacing", "Distance between the discs, as 20mm.", unit="m", within=SPACING)
]
PairPitchOption = Annotated[
    str,
    option(
        "--pitch",
        "Pitch of upper and lower rotor: 14, 14,12 or 0.2rad.",
        unit="deg",
        form="pair",
        within=PITCH,
    ),
]
RotorArgument = Annotated[
    str, argument("NAME|FILE", "A built-in rotor (`mufly rotor list`) or a rotor file (TOML).")
]
DriveOption = Annotated[
    str | None,
    option(
        "--drive NAME|FILE",
        "Drive train: 'mufly', a built-in vehicle, a drive or vehicle file. 'none' leaves it out.",
    ),
]
JsonOption = Annotated[bool, option("--json", "Print JSON, in SI units, and nothing else.")]
OutOption = Annotated[Path | None, option("--out DIR", "Write pictures (PNG) and tables there.")]
ModelOption = Annotated[
    str,
    option(
        "--model NAME",
        "Blade element theory: 'full' (finite chord, rotation), 'plain' (textbook) or 'thesis' "
        "(as the dissertation writes it).",
    ),
]


def one_of(option: str, value: str, known: Iterable[str]) -> None:
    """InputError if an option has a value that is not known."""
    names = tuple(known)
    if value not in names:
        raise InputError(option, "", f"{value!r} is unknown", suggest_name(value, names))


def corrections_of(model: str) -> Corrections:
    """Return the switches of a named model.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    from mufly.study import MODELS

    one_of("--model", model, MODELS)
    return MODELS[model]


def drive_or_none(name: str | None) -> Drive | None:
    """Return the drive of ``--drive``, or None for none."""
    from mufly.drive import load_drive

    return None if name is None or name == "none" else load_drive(name)


# ----------------------------------------------------------------------------
# How rotors are computed: options that the commands of rotors and pairs share, and the wake's progress.


_WHOLE = ("phases", "iterations", "stations")


@dataclass(frozen=True)
class Polars:
    """Options of everything that blade elements are for."""

    n_crit: Annotated[
        float, option("--n-crit NUMBER", "Transition: 0.1 vibrating rotor, 9 quiet wind tunnel.")
    ] = 0.1
    engine: Annotated[str, option("--engine NAME", "Polars: 'neuralfoil' or, where installed, 'xfoil'.")] = (
        "neuralfoil"
    )
    model: ModelOption = "full"

    def polar_engine(self) -> Engine:
        """Return the polar engine that ``--engine`` names."""
        from mufly.rotor.sections.engines import Engine

        one_of("--engine", self.engine, get_args(Engine))
        return cast("Engine", self.engine)

    def corrections(self) -> Corrections:
        """Return the switches of the model that ``--model`` names."""
        return corrections_of(self.model)

    def blading(self, rotor: Rotor, stations: int | None = None) -> Blading:
        """Return a rotor with its polars."""
        from mufly.rotor import prepare
        from mufly.rotor.blading import STATIONS

        return prepare(
            rotor, n_crit=self.n_crit, engine=self.polar_engine(), corrections=self.corrections(),
            stations=stations or STATIONS,
        )  # fmt: skip

    def setup(self, rotor: str, fixed: Mapping[str, Value], **more: Any) -> Setup:
        """Return what the cases of a study of a rotor, or of a pair (``lower``), share."""
        from mufly.rotor import load_rotor
        from mufly.study import Setup

        return Setup(
            load_rotor(rotor), fixed={"n_crit": self.n_crit, **fixed}, corrections=self.corrections(),
            engine=self.polar_engine(), **more,
        )  # fmt: skip


@dataclass(frozen=True)
class Wakes(Polars):
    """Options of what vortex wakes compute."""

    method: str = "wake"  # no option here, one in Theory
    wake: Annotated[
        str, option("--wake NAME", "'free', or 'prescribed' (Landgrebe's shape, for slender blades).")
    ] = "free"
    wake_set: Annotated[
        list[str] | None,
        option(
            "--wake-set NAME=VALUE",
            "A setting of the wake, as step_deg=10, turns=6, core=0.05, iterations=300; or stations=30 a blade.",
        ),
    ] = None

    def wakes(self) -> tuple[WakeSettings, int]:
        """Return settings of the wake and stations along a blade; InputError if an option is unknown or impossible."""
        from mufly.rotor.blading import STATIONS
        from mufly.rotor.wake import WakeSettings
        from mufly.study import METHODS

        one_of("--method", self.method, METHODS)
        if self.wake not in ("free", "prescribed"):
            raise InputError("--wake", "", f"{self.wake!r} is unknown", "use free or prescribed")
        if self.method != "wake" and self.wake != "free":
            raise InputError("--wake", "", "there is no wake in blade element theory", "add --method wake")
        known = [f.name for f in fields(WakeSettings) if f.name not in ("model", "inviscid")]
        given: dict[str, Any] = {}
        for text in self.wake_set or []:
            name, equals, value = (part.strip() for part in text.partition("="))
            if not equals or name not in (*known, "stations"):
                otherwise = f"use NAME=VALUE with {', '.join(known)}, stations"
                remedy = suggest_name(name, [*known, "stations"], otherwise) if equals else otherwise
                raise InputError("--wake-set", text, "is no setting", remedy)
            where = f"--wake-set: {name}"
            unit = split_suffix(name)[1]
            given[name] = read_whole(where, value) if name in _WHOLE else read_quantity(where, value, unit)
        stations = given.pop("stations", STATIONS)
        if not 4 <= stations <= 200:
            raise InputError("--wake-set", "stations", f"is {stations}", "give 4 to 200")
        return WakeSettings(model=self.wake, **given), stations  # type: ignore[arg-type]

    def setup(self, rotor: str, fixed: Mapping[str, Value], **more: Any) -> Setup:
        """Return what the cases of a study of a rotor, or of a pair (``lower``), share."""
        wake, stations = self.wakes()
        return super().setup(rotor, fixed, method=self.method, wake=wake, stations=stations, **more)


@dataclass(frozen=True)
class Theory(Wakes):
    """Options of what blade elements or vortex wakes can compute."""

    method: Annotated[
        str,
        option(
            "--method NAME",
            "'bemt' (blade elements), 'tubes' or 'wake' (seconds).",
        ),
    ] = "bemt"


POLARS, CHECK, BEMT, WAKE = Polars(), Wakes(), Theory(), Theory(method="wake")


class WakeProgress:
    """What the iterations of a wake, or of several in turn, told so far; call it with each."""

    def __init__(self, show: Callable[[str], None] | None = None) -> None:
        self.rows: list[tuple[int, int, float, float]] = []  # wake, iteration, residual, thrust
        self.wakes = 0
        self._show = show

    def __call__(self, iteration: int, residual: float, thrust: float) -> None:
        """Take one iteration in."""
        self.wakes += iteration == 1
        self.rows.append((self.wakes, iteration, residual, thrust))
        if self._show is not None:
            # A residual above 9 marks the first turns of a free wake, held in the prescribed shape.
            miss = "still prescribed" if residual > 9.0 else f"misses the air by {100 * residual:.2g} %"
            self._show(f"wake {self.wakes}, iteration {iteration}: {miss}, thrust {thrust:.4g} N")


@contextmanager
def wake_progress(label: str, shown: bool, folder: Path | None = None) -> Iterator[WakeProgress]:
    """Tell on standard error how a wake gets on. When it is stopped or fails, what it told is left in the folder."""
    try:
        if not shown:
            progress = WakeProgress()
            yield progress
        else:
            with console(stderr=True).status(label) as status:
                progress = WakeProgress(lambda text: status.update(f"{label}: {text}"))
                yield progress
    except BaseException:
        if folder is not None and progress.rows:
            heads = ("wake", "iteration", "residual", "thrust_N")
            write_csv(folder / "progress.csv", heads, progress.rows)
        raise


# ----------------------------------------------------------------------------
# What the commands of identification share: options, numbers with a doubt, tables, vehicle files, places to write.


ColumnsOption = Annotated[
    str | None,
    option("--columns OLD=NEW,...", "What headers mean, as 'RPM=speed_upper_rpm,T_B(N)=thrust_upper_N'."),
]
VehicleOption = Annotated[
    str | None, option("--vehicle NAME|FILE", "Vehicle to start from and to compare with.")
]
WriteOption = Annotated[
    Path | None,
    option("--write FILE", "Write --vehicle with what was found, source 'identified', as a new file."),
]


PictureOption = Annotated[Path | None, option("--out DIR", "Write a picture (PNG) of points and fit there.")]


def with_doubt(option: str, text: str | None, unit: str) -> tuple[float | None, float]:
    """Return value and standard deviation of ``"0.84"`` or ``"0.84+-0.02"`` in a unit; None for None or ``"free"``.

    Raises
    ------
    InputError
        If the text is no number above 0.
    """
    if text is None or text == "free":
        return None, 0.0
    value, std = read_doubt(option, text, unit)
    if not value > 0.0:
        raise InputError(option, "", f"{text} is not possible", "give a number above 0")
    return value, std


def start_vehicle(name: str | None, write: Path | None) -> Vehicle | None:
    """Return the vehicle of ``--vehicle``; InputError for ``--write`` without it."""
    from mufly.errors import InputError
    from mufly.vehicle import load_vehicle

    if name is None and write is not None:
        raise InputError(
            "--write", str(write), "needs a vehicle to start from", "add --vehicle mufly-1.1 or a file"
        )
    check_file("--write", write)
    return None if name is None else load_vehicle(name)


def write_vehicle(
    start: Vehicle | None,
    estimates: Iterable[Estimate],
    write: Path | None,
    note: str,
    option: str = "--write",
) -> list[Path]:
    """Write the vehicle with its estimates where the option says; return the files written."""
    from mufly.identify import with_estimates
    from mufly.vehicle import vehicle_toml

    if write is None or start is None:
        return []
    text = vehicle_toml(with_estimates(start, estimates, note))
    with writing(write, "give another place", option):
        write.write_text(text, encoding="utf-8")
    return [write]


def today() -> str:
    """Return the date, for notes in vehicle files."""
    return time.strftime("%Y-%m-%d")
