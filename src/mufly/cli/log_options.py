"""What the commands about logs share: the log, its column map, the part of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mufly.logs import ColumnMap

__all__ = ["ColumnOption", "FromOption", "LogArgument", "MapOption", "ToOption", "columns_of"]

LogArgument = Annotated[Path, typer.Argument(metavar="LOG", help="Any log, of any of these formats.")]
MapOption = Annotated[
    str | None,
    typer.Option(
        "--map", metavar="FILE", help="Column map (TOML): which column is which signal, in which unit."
    ),
]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        "--column",
        "-c",
        metavar="NAME=COLUMN(unit)",
        help="A line of a column map, as in measured_rates.p=-gyro_x(deg/s), measured_attitude=phi,theta,psi(deg) or "
        "time=t(ms). May be repeated.",
    ),
]
FromOption = Annotated[
    float | None, typer.Option("--from", metavar="S", help="Begin there (s since the start).")
]
ToOption = Annotated[float | None, typer.Option("--to", metavar="S", help="End there (s since the start).")]


def columns_of(file: str | None, pairs: Sequence[str] | None) -> ColumnMap | None:
    """The map of ``--map`` with the lines of ``--column`` before it."""
    from mufly.logs import load_map

    if file is None and not pairs:
        return None
    first = load_map(list(pairs or ()))
    if file is None:
        return first
    second = load_map(file)
    time = first.time if first.time.column is not None else second.time
    return second.model_copy(update={"signal": (*first.signal, *second.signal), "time": time})
