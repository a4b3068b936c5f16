"""What the commands about rotors, drives and studies share: options, tables, pictures, progress."""

from __future__ import annotations

import csv
import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import numpy as np
import typer

from mufly.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from rich.console import Console

    from mufly.drive import Drive
    from mufly.identify import Estimate
    from mufly.rotor import Corrections
    from mufly.rotor.engines import Engine
    from mufly.rotor.wake import WakeSettings
    from mufly.vehicle import Vehicle

RotorArgument = Annotated[
    str,
    typer.Argument(metavar="NAME|FILE", help="A built-in rotor (`mufly rotor list`) or a rotor file (TOML)."),
]
DriveOption = Annotated[
    str | None,
    typer.Option(
        "--drive", metavar="NAME|FILE", help="Drive train: 'mufly', a built-in vehicle, a drive or vehicle file. "
        "'none' leaves it out.",
    ),
]  # fmt: skip
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, in SI units, and nothing else.")]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write pictures (PNG) and tables there.")
]
ModelOption = Annotated[
    str,
    typer.Option(
        "--model", metavar="NAME", help="Blade element theory: 'full' (finite chord, rotation), 'plain' (textbook) or "
        "'thesis' (as the dissertation writes it).",
    ),
]  # fmt: skip
NCritOption = Annotated[
    float, typer.Option("--n-crit", metavar="N", help="Transition: 0.1 vibrating rotor, 9 quiet wind tunnel.")
]
EngineOption = Annotated[
    str, typer.Option("--engine", metavar="NAME", help="Polars: 'neuralfoil' or, where installed, 'xfoil'.")
]


def engine_of(name: str) -> Engine:
    """Return the polar engine that ``--engine`` names."""
    from mufly.rotor.engines import Engine

    if name not in get_args(Engine):
        raise InputError(
            "--engine", "", f"{name!r} is no polar engine", f"use one of: {', '.join(get_args(Engine))}"
        )
    return cast("Engine", name)


def console() -> Console:
    """Return a console for tables."""
    from rich.console import Console

    return Console()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def print_json(content: Any) -> None:
    """Print as JSON; arrays become lists, numbers that are not finite become null."""
    typer.echo(json.dumps(_plain(content), indent=2, allow_nan=False))


def print_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], *, title: str = "", text: Sequence[int] = (0,)
) -> None:
    """Print a table; columns whose numbers are in ``text`` are text, the others numbers."""
    from rich.table import Table

    table = Table(
        box=None, header_style="bold", title=title or None, title_justify="left", title_style="bold",
        show_header=any(heads),
    )  # fmt: skip
    for k, head in enumerate(heads):
        table.add_column(
            head, justify="left" if k in text else "right", overflow="fold" if k in text else "ellipsis"
        )
    for row in rows:
        table.add_row(*row)
    console().print(table, highlight=False)


def corrections_of(model: str) -> Corrections:
    """Return the switches of a named model.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    from mufly.study import MODELS

    if model not in MODELS:
        raise InputError("--model", "", f"{model!r} is unknown", f"use one of: {', '.join(MODELS)}")
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


def save_picture(figure: Figure, folder: Path, name: str) -> Path:
    """Write a picture as PNG into a folder, which is made if need be.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.png"
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise InputError(
            "--out", str(folder), f"cannot be written ({error})", "give another folder"
        ) from error
    return path


@contextmanager
def progress_bar(label: str, shown: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar on standard error while cases are computed; yields the function that moves it."""
    if not shown:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


# ----------------------------------------------------------------------------
# Options and progress of commands that can use the wake method.


MethodOption = Annotated[
    str, typer.Option("--method", metavar="NAME", help="'bemt' (blade elements) or 'wake' (vortices, seconds).")
]  # fmt: skip
WakeOption = Annotated[
    str, typer.Option("--wake", metavar="NAME", help="'free', or 'prescribed' (Landgrebe's shape, for slender blades).")
]  # fmt: skip
WakeSetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--wake-set", metavar="NAME=VALUE",
        help="A setting of the wake, as step_deg=10, turns=6, core=0.05, iterations=300; or stations=30 a blade.",
    ),
]  # fmt: skip

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

    if method not in METHODS:
        raise InputError("--method", "", f"{method!r} is unknown", f"use one of: {', '.join(METHODS)}")
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
            from rich.console import Console

            with Console(stderr=True).status(label) as status:
                progress = WakeProgress(lambda text: status.update(f"{label}: {text}"))
                yield progress
    except BaseException:
        if folder is not None and progress.rows:
            rows = np.array(progress.rows, dtype=np.float64)
            write_history(rows, folder, ("wake", "iteration", "residual", "thrust_N"), "progress")
        raise


def write_history(
    history: NDArray[np.float64], folder: Path, heads: tuple[str, ...], name: str = "history"
) -> Path:
    """Write iterations as CSV.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    path = folder / f"{name}.csv"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(heads)
            for row in history:
                writer.writerow([f"{x:.9g}" for x in row])
    except OSError as error:
        raise InputError(
            "--out", str(folder), f"cannot be written ({error})", "give another folder"
        ) from error
    return path


# ----------------------------------------------------------------------------
# What the commands of identification share: options, numbers with a doubt, tables, vehicle files, places to write.


ColumnsOption = Annotated[
    str | None,
    typer.Option(
        "--columns", metavar="OLD=NEW,...", help="What headers mean, as 'RPM=speed_upper_rpm,T_B(N)=thrust_upper_N'."
    ),
]  # fmt: skip
VehicleOption = Annotated[
    str | None,
    typer.Option("--vehicle", metavar="NAME|FILE", help="Vehicle to start from and to compare with."),
]
WriteOption = Annotated[
    Path | None,
    typer.Option(
        "--write", metavar="FILE", help="Write --vehicle with what was found, source 'identified', as a new file."
    ),
]  # fmt: skip


PictureOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write a picture (PNG) of points and fit there.")
]


def check_folder(option: str, folder: Path | None) -> None:
    """Make a folder that results will go to, so that a long fit does not end without a place for them.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    from mufly.errors import InputError

    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            option, str(folder), f"cannot be made ({error.strerror})", "give another folder"
        ) from error
    if not os.access(folder, os.W_OK):
        raise InputError(option, str(folder), "cannot be written to", "give another folder")


def check_file(option: str, file: Path | None) -> None:
    """Look whether a file can be written, before the work that fills it.

    Raises
    ------
    InputError
        If its folder is not there, or either may not be written.
    """
    from mufly.errors import InputError

    if file is None:
        return
    if file.is_dir():
        raise InputError(option, str(file), "is a folder", "give the name of a file")
    if not file.parent.is_dir():
        raise InputError(option, str(file), "its folder is not there", "make it, or give another place")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise InputError(option, str(file), "cannot be written", "give another place")


def with_doubt(option: str, text: str | None, *, above: float = 0.0) -> tuple[float | None, float]:
    """Return value and standard deviation of ``"0.84"`` or ``"0.84+-0.02"``; None for None or ``"free"``.

    Raises
    ------
    InputError
        If the text is no number above the limit.
    """
    from mufly.errors import InputError

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


def print_estimates(
    estimates: Iterable[Estimate], title: str, shares: dict[str, float] | None = None
) -> None:
    """Print a table of estimates with intervals."""
    rows = []
    for e in estimates:
        start = "-" if math.isnan(e.start) else f"{e.start:.4g}"
        if math.isinf(e.std):
            value, interval, doubt = "not seen", "-", "-"
        elif e.at_bound:
            value, interval, doubt = f"{e.value:.5g}", "at its bound", "-"
        else:
            value, interval = f"{e.value:.5g}", f"{e.low:.4g} to {e.high:.4g}"
            doubt = f"{100 * e.std / abs(e.value):.2g} %" if e.value else "-"
        row = [e.symbol, value, doubt, interval, e.unit if e.unit != "1" else "", start]
        rows.append(row if shares is None else [*row, f"{100 * shares.get(e.symbol, 0.0):.0f} %"])
    heads = ["symbol", "value", "std", "95 % interval", "unit", "start"]
    print_table(heads if shares is None else [*heads, "systematic"], rows, title=title)


def say(lines: Iterable[str], *, mark: str = "") -> None:
    """Print lines without markup."""
    out = console()
    for line in lines:
        out.print(f"{mark}: {line}" if mark else line, highlight=False, markup=False)


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
    start: Vehicle | None, estimates: Iterable[Estimate], write: Path | None, note: str
) -> list[Path]:
    """Write the vehicle with its estimates where ``--write`` says; return the files written."""
    from mufly.errors import InputError
    from mufly.identify.result import with_estimates
    from mufly.vehicle import vehicle_toml

    if write is None or start is None:
        return []
    text = vehicle_toml(with_estimates(start, estimates, note))
    try:
        write.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            "--write", str(write), f"cannot be written ({error})", "give another place"
        ) from error
    return [write]


def today() -> str:
    """Return the date, for notes in vehicle files."""
    return time.strftime("%Y-%m-%d")
