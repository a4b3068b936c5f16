"""What the commands about rotors, drives and studies share: options, tables, pictures, progress."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args

import numpy as np
import typer

from mufly.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from mufly.drive import Drive
    from mufly.rotor import Corrections
    from mufly.rotor.build import Engine

__all__ = [
    "DriveOption",
    "EngineOption",
    "JsonOption",
    "ModelOption",
    "NCritOption",
    "OutOption",
    "RotorArgument",
    "angle",
    "console",
    "corrections_of",
    "drive_or_none",
    "engine_of",
    "print_json",
    "print_table",
    "progress_bar",
    "save_picture",
]

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
    from mufly.rotor.build import Engine

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
