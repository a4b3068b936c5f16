"""What commands share: options, what their texts say, and the options' names in place of a library's arguments."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import typer
from typer.core import TyperCommand

from mufly.cli.present import check_file, console, write_csv, writing
from mufly.errors import ArgumentError, InputError
from mufly.units import split_header

if TYPE_CHECKING:
    from mufly.drive import Drive
    from mufly.identify import Estimate
    from mufly.rotor import Corrections
    from mufly.rotor.engines import Engine
    from mufly.rotor.wake import WakeSettings
    from mufly.vehicle import Vehicle

# Arguments of the library that an option of another name gives.
_OPTIONS = {
    "columns": "column",
    "endpoints": "connect",
    "estimates": "write",
    "kinds": "kind",
    "spectra": "spectrum",
    "structure": "model",
    "symbols": "free",
}


class Command(TyperCommand):
    """A command that says ``--radius`` where the library says ``radius_m``: who typed an option is told its name."""

    def invoke(self, ctx: Any) -> Any:
        """Run it."""
        try:
            return super().invoke(ctx)
        except ArgumentError as error:
            raise self._by_option(error) from error

    def _by_option(self, error: ArgumentError) -> InputError:
        options = {
            p.name: max(p.opts, key=len) for p in self.params if p.name and p.param_type_name == "option"
        }

        def option_of(argument: str) -> str | None:
            other = _OPTIONS.get(argument, argument)
            names = (argument, other, f"{other}_", split_header(other)[0])
            return next((options[n] for n in names if n in options), None)

        option = option_of(error.argument)
        if option is None:
            return error
        remedy = re.sub(
            r"\b(\w+)=(?=\S)", lambda m: f"{option_of(m[1])} " if option_of(m[1]) else m[0], error.remedy
        )
        return InputError(option, error.key, error.problem, remedy)


class Commands(typer.Typer):
    """A group of such commands."""

    def command(self, name: str | None = None, **more: Any) -> Any:
        """Register a command, as :meth:`typer.Typer.command` does."""
        return super().command(name, **{"cls": Command, **more})


def option(names: str, help: str, **more: Any) -> Any:
    """An option.

    Parameters
    ----------
    names : str
        Its names, if its parameter's is not enough, and what stands for its value in the help: ``"--out -o DIR"``.
    help : str
        What it is for.
    """
    words = names.split()
    value = [w for w in words if not w.startswith("-")]
    return typer.Option(
        *(w for w in words if w.startswith("-")), help=help, metavar=value[0] if value else None, **more
    )


def argument(value: str, help: str, **more: Any) -> Any:
    """An argument: what stands for it in the help, and what it is for."""
    return typer.Argument(help=help, metavar=value or None, **more)


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
NCritOption = Annotated[float, option("--n-crit N", "Transition: 0.1 vibrating rotor, 9 quiet wind tunnel.")]
EngineOption = Annotated[str, option("--engine NAME", "Polars: 'neuralfoil' or, where installed, 'xfoil'.")]


def one_of(option: str, value: str, known: Iterable[str]) -> None:
    """InputError if an option has a value that is not known."""
    names = tuple(known)
    if value not in names:
        raise InputError(option, "", f"{value!r} is unknown", f"use one of: {', '.join(names)}")


def engine_of(name: str) -> Engine:
    """Return the polar engine that ``--engine`` names."""
    from mufly.rotor.engines import Engine

    if name not in get_args(Engine):
        raise InputError(
            "--engine", "", f"{name!r} is no polar engine", f"use one of: {', '.join(get_args(Engine))}"
        )
    return cast("Engine", name)


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


def angle(option: str, text: str) -> float:
    """Return an angle (rad) from ``"12"``, ``"12deg"`` or ``"0.2rad"``; a bare number is in degrees.

    Raises
    ------
    InputError
        If the text is no angle.
    """
    from mufly.study import parse_quantity

    try:
        return math.radians(float(text))
    except ValueError:
        pass
    try:
        return float(parse_quantity("pitch", text))
    except InputError as error:
        raise InputError(option, "", error.problem, error.remedy) from None


# ----------------------------------------------------------------------------
# Options and progress of commands that can use the wake method.


MethodOption = Annotated[
    str, option("--method NAME", "'bemt' (blade elements) or 'wake' (vortices, seconds).")
]
WakeOption = Annotated[
    str, option("--wake NAME", "'free', or 'prescribed' (Landgrebe's shape, for slender blades).")
]
WakeSetOption = Annotated[
    list[str] | None,
    option(
        "--wake-set NAME=VALUE",
        "A setting of the wake, as step_deg=10, turns=6, core=0.05, iterations=300; or stations=30 a blade.",
    ),
]

_WHOLE = ("phases", "iterations", "stations")


def wake_of(method: str, wake: str, settings: list[str] | None) -> tuple[WakeSettings, int]:
    """Settings of the wake and stations along a blade, from ``--method``, ``--wake`` and ``--wake-set``.

    Raises
    ------
    InputError
        If one of them is unknown or impossible.
    """
    from mufly.rotor.blading import STATIONS
    from mufly.rotor.wake import WakeSettings
    from mufly.study import METHODS

    one_of("--method", method, METHODS)
    if wake not in ("free", "prescribed"):
        raise InputError("--wake", "", f"{wake!r} is unknown", "use free or prescribed")
    if method == "bemt" and wake != "free":
        raise InputError("--wake", "", "there is no wake in blade element theory", "add --method wake")
    known = [f.name for f in fields(WakeSettings) if f.name not in ("model", "inviscid")]
    given: dict[str, Any] = {}
    for text in settings or []:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or name not in (*known, "stations"):
            raise InputError(
                "--wake-set", text, "is no setting", f"use NAME=VALUE with {', '.join(known)}, stations"
            )
        try:
            given[name] = int(value) if name in _WHOLE else float(value)
        except ValueError:
            raise InputError("--wake-set", text, f"{value!r} is no number", "give a number") from None
    stations = given.pop("stations", STATIONS)
    if not 4 <= stations <= 200:
        raise InputError("--wake-set", "stations", f"is {stations}", "give 4 to 200")
    return WakeSettings(model=wake, **given), stations  # type: ignore[arg-type]


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


def with_doubt(option: str, text: str | None, *, above: float = 0.0) -> tuple[float | None, float]:
    """Return value and standard deviation of ``"0.84"`` or ``"0.84+-0.02"``; None for None or ``"free"``.

    Raises
    ------
    InputError
        If the text is no number above the limit.
    """
    if text is None or text == "free":
        return None, 0.0
    first, _, second = text.replace("±", "+-").partition("+-")
    try:
        value, std = float(first), float(second or 0.0)
    except ValueError:
        raise InputError(option, "", f"{text!r} is no number", "write 0.84 or 0.84+-0.02") from None
    if not (math.isfinite(value) and value > above and math.isfinite(std) and std >= 0):
        raise InputError(option, "", f"{text} is not possible", f"give a number above {above:g}")
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
