"""``mufly log convert``: signals on one clock, written to a file."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer

from mufly.cli.log_options import ColumnOption, FromOption, LogArgument, MapOption, ToOption, columns_of
from mufly.cli.options import console, progress_bar
from mufly.errors import InputError

__all__ = ["convert"]


def convert(
    log: LogArgument,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="File to write; its ending says what: .csv, .parquet, .nc, .mcap, .ulg."
        ),
    ],
    signals: Annotated[
        list[str] | None,
        typer.Option("--signal", "-s", metavar="NAME", help="Only this (as for plot); may be repeated."),
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="HZ", help="Rate of the common clock. Default: the highest among the signals."
        ),
    ] = None,
    from_s: FromOption = None,
    to_s: ToOption = None,
    map_file: MapOption = None,
    column: ColumnOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT if it is there.")] = False,
) -> None:
    """Bring the signals of a log onto one clock, in SI units and under our names, and write them to a file.

    Examples: mufly log convert flight.ulg flight.csv --rate 100; mufly log convert bench.csv bench.nc --map bench.toml;
    mufly log export flight.mcap flight.parquet --signal 'measured_*'
    """
    from mufly.logs import FORMATS, LogWarning, read_log, write_log

    if out.suffix.lower() not in FORMATS:
        problem = f"the ending {out.suffix!r} says nothing"
        raise InputError(str(out), "", problem, f"use one of: {', '.join(FORMATS)}")
    if out.exists() and not force:
        raise InputError(str(out), "", "is already there", "choose another name, or add --force")
    columns = columns_of(map_file, column)
    with progress_bar("Reading", True) as progress, warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)  # printed below
        data = read_log(
            log,
            columns=columns,
            signals=signals or (),
            rate_hz=rate_hz,
            from_s=from_s,
            to_s=to_s,
            progress=progress,
        )
    for note in data.attrs.get("notes", []):
        typer.secho(f"{log.name}: {note}", fg=typer.colors.YELLOW, err=True)
    written = write_log(data, out)
    time = data["time"].values
    step = f", {1 / (time[1] - time[0]):.5g} Hz" if len(time) > 1 else ""
    kind = out.suffix.lower()
    over_time = [str(v) for v in data.data_vars if "time" in data[v].dims]
    text = [v for v in over_time if kind == ".mcap" and data[v].dtype.kind == "U" and v != "mission_state"]
    console().print(
        f"{written}: {len(over_time) - len(text)} signals, {len(time)} instants from {time[0]:.2f} to {time[-1]:.2f} s"
        f"{step}",
        highlight=False,
    )
    if text:
        console().print(f"Text does not go into a recording and is left out: {', '.join(text)}", style="dim")
    if kind == ".csv" and len(over_time) < len(data.data_vars):
        console().print("Events are not in a CSV file; .mcap, .nc, .parquet and .ulg keep them.", style="dim")
