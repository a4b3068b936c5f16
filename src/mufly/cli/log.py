"""``mufly log``: recordings as text, pictures and files."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mufly.cli.options import ColumnOption, CommandGroup, JsonOption, define_argument, define_option
from mufly.cli.output import (
    print_answer,
    print_blocks,
    print_files,
    print_lines,
    progress_bar,
)
from mufly.errors import InputError, convert_write_errors

if TYPE_CHECKING:
    import xarray as xr

    from mufly.logs import ColumnMap

LogArgument = Annotated[Path, define_argument("LOG", "Log file of any format that `mufly log` reads.")]
MapOption = Annotated[
    str | None, define_option("--map FILE", "Column map file (TOML): signal and unit of each column.")
]
FromOption = Annotated[
    float | None, define_option("--from", "Start time, from the log's start. Default: its start.", unit="s")
]
ToOption = Annotated[float | None, define_option("--to", "End time, from the log's start. Default: its end.", unit="s")]


def column_map_from_options(file: str | None, pairs: Sequence[str] | None) -> ColumnMap | None:
    """Return the column map of ``--map``, preceded by the entries of ``--column``."""
    from mufly.logs import load_column_map

    if file is None and not pairs:
        return None
    first = load_column_map(list(pairs or ()))
    if file is None:
        return first
    second = load_column_map(file)
    time = first.time if first.time.column is not None else second.time
    return second.model_copy(update={"signal": (*first.signal, *second.signal), "time": time})


def convert_log(
    log: LogArgument,
    out: Annotated[
        Path,
        define_argument(
            "OUT",
            "File to write; the ending selects the format: .csv, .parquet, .nc, .mcap, .ulg, or .rosbag2 (a folder).",
        ),
    ],
    signals: Annotated[
        list[str] | None,
        define_option("--signal -s NAME", "Signal to write (as for plot). Repeat it for more. Default: all."),
    ] = None,
    rate_hz: Annotated[
        float | None,
        define_option("--rate", "Rate of the common clock. Default: the highest of the signals.", unit="Hz"),
    ] = None,
    from_s: FromOption = None,
    to_s: ToOption = None,
    start_s: Annotated[
        float | None,
        define_option(
            "--start",
            "Time at which OUT begins; 0 for programs that require it. Default: the log's own.",
            unit="s",
        ),
    ] = None,
    map_file: MapOption = None,
    column: ColumnOption = None,
    force: Annotated[bool, define_option("--force", "Replace OUT if it exists.")] = False,
) -> None:
    """Resample the signals of a log to one clock, in SI units and under mufly's names, and write them to a file.

    Examples: mufly log convert flight.ulg flight.csv --rate 100; mufly log convert bench.csv bench.nc --map bench.toml;
    mufly log export flight.mcap flight.parquet --signal 'measured_*'; mufly log convert flight.mcap flight.rosbag2
    """
    from mufly.logs import BAG_ENDING, LOG_WRITERS, LogWarning, read_log, write_log

    if out.suffix.lower() not in (*LOG_WRITERS, BAG_ENDING):
        problem = f"the ending {out.suffix!r} is unknown"
        raise InputError(str(out), "", problem, f"use one of: {', '.join((*LOG_WRITERS, BAG_ENDING))}")
    if out.exists() and not force:
        raise InputError(str(out), "", "already exists", "choose another name, or add --force")
    columns = column_map_from_options(map_file, column)
    with progress_bar("Reading", True) as progress, warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)  # printed below
        data = read_log(
            log,
            columns=columns,
            signals=signals or (),
            rate_hz=rate_hz,
            from_s=from_s,
            to_s=to_s,
            start_s=start_s,
            progress=progress,
        )
    _print_notes(log, data.attrs.get("notes", []))
    topics = _write_bag(data, log, out) if out.suffix.lower() == BAG_ENDING else ()
    written = out if topics else write_log(data, out)
    time = data["time"].values
    step = f", {1 / (time[1] - time[0]):.5g} Hz" if len(time) > 1 else ""
    kind = out.suffix.lower()
    over_time = [str(v) for v in data.data_vars if "time" in data[v].dims]
    text = [v for v in over_time if kind == ".mcap" and data[v].dtype.kind == "U" and v != "mission_state"]
    print_lines(
        f"{written}: {f'{len(topics)} topics' if topics else f'{len(over_time) - len(text)} signals'}, "
        f"{len(time)} instants from {time[0]:.2f} to {time[-1]:.2f} s"
        f"{step}"
    )
    if text:
        print_lines(f"A recording cannot hold text signals; omitted: {', '.join(text)}", style="dim")
    if kind == ".csv" and len(over_time) < len(data.data_vars):
        print_lines("A CSV file holds no events; .mcap, .nc, .parquet and .ulg do.", style="dim")


def _write_bag(data: xr.Dataset, log: Path, out: Path) -> tuple[str, ...]:
    """Write a ROS 2 bag with the vehicle's range sensors and the recorded pictures; return the bag's topics."""
    from mufly.bridges.ros_geometry import recorded_range_sensor_geometry
    from mufly.camera.picture_recording import read_pictures
    from mufly.logs import RangeSensorGeometry, read_attachments, write_rosbag2

    limits, pictures = RangeSensorGeometry(), list[tuple[float, bytes]]()
    if data.attrs.get("format") == "MCAP":
        limits = recorded_range_sensor_geometry(read_attachments(log).get("vehicle.toml", b""))
        with contextlib.suppress(InputError):  # no pictures
            found = read_pictures(log)
            first, last = data["time"].values[[0, -1]]
            timed = zip(found.times_s, found.iterate_jpegs(), strict=True)
            pictures = [one for one in timed if first <= one[0] <= last]
    return write_rosbag2(data, out, limits=limits, pictures=pictures)


app = CommandGroup(
    help="Read, check, convert and draw logs: MCAP (mufly's and others'), PX4 ULog, ArduPilot DataFlash, MAVLink tlog, "
    "Crazyflie micro-SD, rosbag2, CSV, Parquet, NetCDF.\n\n"
    "The format is detected from the content. Column maps and checks: docs/reference/logs.md.",
    no_args_is_help=True,
)  # fmt: skip


@app.command()
def info(
    log: LogArgument,
    map_file: MapOption = None,
    column: ColumnOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the format, topics, signals and faults of a log.

    Lists topics with their rates and signals with their range; then every gap, repeated or reversed
    time stamp, drop-out, outlier, constant or saturated channel and doubtful unit, and the delays from references to
    measurements.

    Examples: mufly log info flight.ulg; mufly log info bench.csv -c "time=t(ms)" -c "battery_voltage=U(V)"
    """
    from mufly.logs import examine_log

    columns = column_map_from_options(map_file, column)
    with progress_bar("Reading", not as_json) as progress:
        report = examine_log(log, columns, progress=progress)
    print_answer(as_json, report, files=None)


@app.command()
def plot(
    log: LogArgument,
    signals: Annotated[
        list[str] | None,
        define_argument(
            "SIGNAL",
            "Signals to draw: measured_attitude, measured_attitude.roll, 'measured_*', or any field as "
            "topic/field (`mufly log info` lists them). Default: all named signals.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        define_option("--out DIR", "Folder for the pictures (PNG and SVG). Default: LOG-pictures."),
    ] = None,
    from_s: FromOption = None,
    to_s: ToOption = None,
    spectrum: Annotated[
        bool, define_option("--spectrum", "Draw power spectral densities instead of time series.")
    ] = False,
    beside: Annotated[
        Path | None, define_option("--with LOG", "Second log to draw into the same plots, dashed.")
    ] = None,
    align: Annotated[
        Literal["take-off", "arming", "start", "clock"],
        define_option(
            "--align EVENT", "Event at which two logs are aligned, with --with: take-off, arming, start or clock."
        ),
    ] = "take-off",
    offset_s: Annotated[
        float,
        define_option("--offset", "Additional delay of the second log, with --with.", unit="s"),
    ] = 0.0,
    map_file: MapOption = None,
    column: ColumnOption = None,
) -> None:
    """Draw the signals of a log over time, or their spectra; --with adds a second log to the plots.

    Examples: mufly log plot flight.ulg --out pictures; mufly log plot flight.ulg measured_rates --spectrum;
    mufly log plot flight.ulg sensor_combined/gyro_rad[0] --from 10 --to 20;
    mufly log plot monday.mcap attitude --with tuesday.ulg --align take-off
    """  # fmt: skip
    from mufly.logs import (
        draw_channels,
        group_channels_by_picture,
        read_channels,
        select_channels,
        select_fields_of_fastest_topics,
    )

    if from_s is not None and to_s is not None and not from_s < to_s:
        raise InputError("--from", f"{from_s:g}", f"is not before {to_s:g}", "give the earlier time first")
    names = signals or []
    if beside is not None:
        if spectrum or map_file or column:
            raise InputError(
                "--with", "", "cannot be combined with these options", "leave out --spectrum, --map and --column"
            )
        _plot_two_logs(log, beside, names, align, offset_s, (from_s, to_s), out)
        return
    fields = [n for n in names if "/" in n]
    columns = column_map_from_options(map_file, column)
    with progress_bar("Reading", True) as progress:
        raw, found, _, notes = read_channels(log, columns, fields, progress)
    _print_notes(log, notes)
    if names:
        wanted = select_channels(found, names, str(log), "; or write topic/field")
    else:
        wanted = found or select_fields_of_fastest_topics(raw)
    kept = []
    for channel in wanted:
        inside = (channel.time >= (from_s if from_s is not None else -1e300)) & (
            channel.time <= (to_s if to_s is not None else 1e300)
        )
        if inside.sum() > 1:
            kept.append(channel._replace(time=channel.time[inside], values=channel.values[inside]))
    if not kept:
        start, end = raw.time_span
        raise InputError(
            str(log), "", "has no data in this time span", f"the log lasts from {start:.2f} to {end:.2f} s"
        )
    pictures = group_channels_by_picture(kept)
    suffix = "-spectrum" if spectrum else ""
    with progress_bar("Drawing", True) as progress:
        for k, (kind, members) in enumerate(pictures.items()):
            try:
                figure = draw_channels(members, title=f"{log.name}: {kind.replace('_', ' ')}", spectra=spectrum)
            except InputError as error:
                typer.secho(f"{kind}: {error.problem}; no plot drawn", fg=typer.colors.YELLOW, err=True)
                continue
            print_files(_save_figure(figure, out or Path(f"{log.stem}-pictures"), f"{log.stem}-{kind}{suffix}"))
            if progress is not None:
                progress(k + 1, len(pictures))


def _plot_two_logs(
    log: Path, beside: Path, names: list[str], align: str, offset_s: float,
    span: tuple[float | None, float | None], out: Path | None,
) -> None:  # fmt: skip
    """Draw two logs in the same plots, and print their differences."""
    from dataclasses import replace

    from mufly.station.recording_comparison import (
        RecordingComparison,
        difference_table,
        draw_comparison,
        find_shared_signals,
    )
    from mufly.station.replay import open_recording

    with progress_bar("Reading", True) as progress:
        first, second = open_recording(log, progress), open_recording(beside, progress)
    if first.name == second.name:
        first = replace(first, name=f"{log.absolute().parent.name}/{log.name}")
        second = replace(second, name=f"{beside.absolute().parent.name}/{beside.name}")
    c = RecordingComparison(first, second, align, offset_s)
    found = find_shared_signals(c, names)
    if c.alignment_note:
        typer.secho(c.alignment_note, fg=typer.colors.YELLOW, err=True)
    print_lines(f"{second.name} is shifted by {c.total_shift_s:+.2f} s ({align})")
    folder = out or Path(f"{log.stem}-with-{beside.stem}")
    for quantity, members in found.items():
        figure = draw_comparison(c, members, title=quantity.replace("_", " "))
        figure.axes[-1].set_xlim(*span)
        print_files(_save_figure(figure, folder, f"{log.stem}-with-{beside.stem}-{quantity}"))
    print_blocks(difference_table(c, [n for members in found.values() for n in members]))


def _print_notes(log: Path, notes: Iterable[str]) -> None:
    for note in notes:
        typer.secho(f"{log.name}: {note}", fg=typer.colors.YELLOW, err=True)


def _save_figure(figure: Any, folder: Path, name: str) -> list[Path]:
    paths = [folder / f"{name}{ending}" for ending in (".png", ".svg")]
    with convert_write_errors("--out", key=str(folder)):
        folder.mkdir(parents=True, exist_ok=True)
        for path in paths:
            figure.savefig(path, dpi=130, bbox_inches="tight")
    return paths


app.command("convert")(convert_log)
app.command("export", help="Convert a log to another format; the same command as convert.")(convert_log)
