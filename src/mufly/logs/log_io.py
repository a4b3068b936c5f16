"""Reading of logs of all formats, as raw topics or as signals on one clock, and writing of datasets to files.

When a log is read, its format follows from its content, never from its name. When a log is written, the file name's
ending selects the format.
"""

from __future__ import annotations

import contextlib
import fnmatch
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.files.answer_store import replace_file_atomically
from mufly.files.text_table import GZIP_MAGIC, is_text_with_digits, read_decompressed
from mufly.logs.block_log import BLOCK_LOG_FORMAT, looks_like_block_log, read_block_log
from mufly.logs.column_map import ColumnMap, TimeEntry, extract_mapped_channels, load_column_map
from mufly.logs.crazyflie import looks_like_crazyflie, read_crazyflie
from mufly.logs.dataflash import MAGIC as DATAFLASH_MAGIC
from mufly.logs.dataflash import is_text_log, read_dataflash
from mufly.logs.mcap import MAGIC as MCAP_MAGIC
from mufly.logs.mcap import (
    FlightEvent,
    make_dataset_from_channels,
    make_event_variables,
    read_mcap,
    restore_dataset,
    split_dataset_into_channels,
    write_recording_csv,
)
from mufly.logs.mcap_recording import is_recording, parse_json_topics, recording_from_contents, write_mcap
from mufly.logs.raw_log import (
    Channel,
    LogWarning,
    RawLog,
    common_clock,
    examine_time_stamps,
    resample_signal,
    select_usable_samples,
)
from mufly.logs.ros.rosbag2 import BAG_ENDING, bag_column_map, is_bag, read_rosbag2, write_rosbag2
from mufly.logs.tables import (
    FEATHER_MAGIC,
    NETCDF_MAGIC,
    PARQUET_MAGIC,
    TABLE_TOPIC,
    read_arrow,
    read_csv,
    read_netcdf,
    write_netcdf,
    write_parquet,
)
from mufly.logs.tlog import looks_like_tlog, read_tlog
from mufly.logs.ulog import MAGIC as ULOG_MAGIC
from mufly.logs.ulog import read_ulog, write_ulog
from mufly.quantities.quantity_table import is_command_signal

_MAGIC_BY_FORMAT: dict[str, bytes | tuple[bytes, ...]] = {
    "MCAP": MCAP_MAGIC,
    "ULog": ULOG_MAGIC,
    "Parquet": PARQUET_MAGIC,
    "Feather": FEATHER_MAGIC,
    "NetCDF": NETCDF_MAGIC,
    "DataFlash": DATAFLASH_MAGIC,
}


_EXAMINED_HEAD_BYTES = 65536
SQLITE_MAGIC = b"SQLite format 3\0"
MCAP_PROFILE_BYTE_RANGE, ROS_PROFILE = slice(17, 25), b"\4\0\0\0ros2"
"""Offset of the profile in the header of an MCAP file (mcap.dev/spec), and the profile of ROS 2."""


def detect_log_format(path: str | Path) -> str:
    """Return the format of a log, judged by its content.

    Raises
    ------
    InputError
        If the file cannot be read, is empty, or has none of the formats.
    """
    where = str(path)
    if is_bag(Path(path)):
        return "rosbag2"
    try:
        head, _ = read_decompressed(path, _EXAMINED_HEAD_BYTES)
        with open(path, "rb") as stream:
            packed = stream.read(2) == GZIP_MAGIC
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give the path of a log") from error
    if not head.strip(b"\0"):
        problem = "is empty" if not head else "contains only zeros: its content was not written to the disk"
        raise InputError(where, "", problem, "give a log" if not head else "give another copy of the log")
    if packed and not is_text_with_digits(head):
        raise InputError(where, "", "is compressed (gzip) but not a text table", "unpack it: gunzip FILE")
    if head.startswith(SQLITE_MAGIC) or (head.startswith(MCAP_MAGIC) and head[MCAP_PROFILE_BYTE_RANGE] == ROS_PROFILE):
        return "rosbag2"
    for kind, magic in _MAGIC_BY_FORMAT.items():
        if head.startswith(magic):
            return kind
    if looks_like_block_log(head):
        return BLOCK_LOG_FORMAT
    if is_text_log(head):
        return "DataFlash"
    if looks_like_crazyflie(head):
        return "Crazyflie"
    if looks_like_tlog(head):
        return "MAVLink tlog"
    if head.startswith(b"version https://git-lfs"):
        raise InputError(where, "", "is a Git LFS pointer, not the file itself", "fetch it: git lfs pull")
    if is_text_with_digits(head):
        return "CSV"
    if head.startswith(b"\x89HDF") or head.startswith(b"MATLAB"):
        name = "HDF5" if head.startswith(b"\x89HDF") else "MATLAB"
        remedy = "export it as CSV or NetCDF 3"
        if name == "MATLAB":
            remedy += "; `mufly identify linear` reads it directly"
        raise InputError(where, "", f"is a {name} file, which mufly cannot read", remedy)
    if is_text_with_digits(head.rstrip(b"\0")):
        return "CSV"
    raise InputError(
        where, "", "is not a log in a known format",
        "give MCAP, ULog, DataFlash (.bin, .log), MAVLink tlog, Crazyflie micro-SD, rosbag2, CSV, Parquet, "
        "Feather or "
        "NetCDF",
    )  # fmt: skip


ProgressCallback = Callable[[int, int], None]
_COLUMN_MAP_BY_FORMAT = {
    "ULog": "px4",
    BLOCK_LOG_FORMAT: "px4",
    "DataFlash": "ardupilot",
    "MAVLink tlog": "mavlink",
    "Crazyflie": "crazyflie",
}


def read_raw_log(
    path: str | Path, *, time: TimeEntry | None = None, progress: ProgressCallback | None = None
) -> RawLog:
    """Read a log as it was written: topics, each on its own clock.

    Parameters
    ----------
    path : str or Path
        MCAP, ULog, DataFlash, MAVLink telemetry, Crazyflie micro-SD, rosbag2, CSV, Parquet, Feather or NetCDF, judged
        by its content.
    time : TimeEntry, optional
        Clock of a table: CSV, Parquet, Feather or NetCDF.
    progress : callable, optional
        Called with (bytes read, total bytes) while a long log is read.

    Returns
    -------
    RawLog
        A mapping from topic to :class:`RawTable`.

    Raises
    ------
    InputError
        If the file is no log or damaged beyond use.
    """
    return read_topics_and_dataset(path, time, progress)[0]


def read_topics_and_dataset(
    path: str | Path, time: TimeEntry | None, progress: ProgressCallback | None
) -> tuple[RawLog, xr.Dataset | None]:
    """Return the topics of a log and, if it holds this package's signals on one clock, their dataset; else None.

    Parameters and errors are those of :func:`read_raw_log`.
    """
    kind = detect_log_format(path)
    where = str(path)
    if kind == "MCAP":
        contents = read_mcap(path)
        raw = parse_json_topics(contents, where)
        return raw, recording_from_contents(contents, where) if is_recording(contents) else None
    if kind == "rosbag2":
        return read_rosbag2(path), None
    if kind in ("ULog", BLOCK_LOG_FORMAT):
        raw = read_ulog(path) if kind == "ULog" else read_block_log(path)
        return raw, _restore_own_ulog(raw)
    if kind == "DataFlash":
        return read_dataflash(path), None
    if kind == "Crazyflie":
        return read_crazyflie(path), None
    if kind == "MAVLink tlog":
        return read_tlog(path, progress), None
    if kind in ("Parquet", "Feather"):
        return read_arrow(path, kind, time)
    if kind == "NetCDF":
        return read_netcdf(path, time)
    return read_csv(path, time), None


def extract_log_channels(
    raw: RawLog, columns: ColumnMap | None = None, wanted: tuple[str, ...] = ()
) -> tuple[list[Channel], list[str]]:
    """Return the signals of a log in SI units, by a column map and the map of its format, and notes on guesses.

    Parameters and errors are those of :func:`mufly.logs.column_map.extract_mapped_channels`.
    """
    standard = (
        load_column_map(_COLUMN_MAP_BY_FORMAT[raw.format_name]) if raw.format_name in _COLUMN_MAP_BY_FORMAT else None
    )
    standard = bag_column_map(raw) if raw.format_name == "rosbag2" else standard
    return extract_mapped_channels(raw, columns, standard, wanted)


def _restore_own_ulog(raw: RawLog) -> xr.Dataset | None:
    """Return the dataset of a ULog file written by this package."""
    description, texts = raw.info.get("mufly_dataset"), raw.info.get("mufly_texts")
    if not isinstance(description, str) or not isinstance(texts, str) or TABLE_TOPIC not in raw:
        return None
    fields = dict(raw[TABLE_TOPIC].fields)
    try:
        for name, known in json.loads(texts).items():
            number = np.minimum(fields[name], len(known)).astype(np.int64)
            fields[name] = np.array([*known, ""], dtype=str)[number]
            if bad := int((number == len(known)).sum()):
                which = f"{bad} text{'s' if bad > 1 else ''} of {name}"
                warnings.warn(f"{Path(raw.path).name}: {which} is damaged, and empty", LogWarning, stacklevel=4)
        restored = restore_dataset(fields.pop("time", raw[TABLE_TOPIC].time), fields, description)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        problem = f"has a damaged description ({error})"
        raise InputError(raw.path, "", problem, "give another copy of the file") from error
    if "event_time" in restored:
        return restored
    return restored.assign(make_event_variables([FlightEvent(t, "", text, level) for t, level, text in raw.messages]))


def read_log(
    path: str | Path,
    *,
    columns: str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap | None = None,
    signals: Sequence[str] = (),
    rate_hz: float | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    start_s: float | None = None,
    progress: ProgressCallback | None = None,
) -> xr.Dataset:
    """Read a log of any known format as signals on one clock, in SI units.

    Parameters
    ----------
    path : str or Path
        MCAP, ULog, DataFlash, MAVLink telemetry, Crazyflie micro-SD, rosbag2, CSV, Parquet, Feather or NetCDF, judged
        by its content.
    columns : optional
        Column map, as for :func:`load_column_map`; it takes precedence over the map of PX4, ArduPilot or MAVLink.
    signals : sequence of str
        Signals to read: names (``measured_attitude``), components (``measured_attitude.roll``), patterns
        (``measured_*``), or unconverted fields (``sensor_combined/gyro_rad[0]``). Default: all with a name of this
        package.
    rate_hz : float, optional
        Rate of the common clock (Hz). Default: signals with one clock keep it; others are resampled to the highest rate
        among them.
    from_s, to_s : float, optional
        Part of the log to keep (s since its start).
    start_s : float, optional
        Time at which the kept part begins (s); events and ``start_time`` are shifted, too.
    progress : callable, optional
        Called with (bytes read, total bytes) while a long log is read.

    Returns
    -------
    xarray.Dataset
        Coordinate ``time`` (s since the start of the log). Each variable has ``units``, ``long_name`` and, for foreign
        logs, ``source`` and ``source_rate_hz``. Attributes: ``source``, ``format``, ``start_time``, ``complete`` and
        ``notes``, a list of guesses and repairs; every note is also given as a :class:`LogWarning`. Gaps
        are NaN.

    Raises
    ------
    InputError
        If the file is no log, the map does not fit it, a signal is missing, or its clock cannot be repaired.

    Examples
    --------
    >>> data = read_log("flight.ulg", signals=["measured_*"], rate_hz=100)  # doctest: +SKIP
    >>> data = read_log("bench.csv", columns={"battery_voltage": "U[mV]", "time": "t[ms]"})  # doctest: +SKIP
    """
    if rate_hz is not None and not 0 < rate_hz < 1e6:
        raise ArgumentError("rate_hz", "", f"{rate_hz:g} Hz is out of range", "give a rate above 0")
    if from_s is not None and to_s is not None and not from_s < to_s:
        raise ArgumentError("from_s", f"{from_s:g}", f"is not before {to_s:g}", "give the earlier time first")
    given = None if columns is None else load_column_map(columns)
    kind = detect_log_format(path)
    raw: RawLog | None = None
    ready: xr.Dataset | None = None
    as_it_is = given is None and not any("/" in s for s in signals)
    if kind == "MCAP" and as_it_is:
        contents = read_mcap(path)
        ready = recording_from_contents(contents, str(path)) if is_recording(contents) else None
    if ready is None:
        raw, found = read_topics_and_dataset(path, None if given is None else given.time, progress)
        ready = found if as_it_is else None
    if ready is not None:
        index, notes = select_usable_samples(ready["time"].values.astype(np.float64), str(path), "")
        if raw is not None and not raw.is_complete:
            notes += raw.describe_damage()
            ready.attrs["complete"] = False
        ready = ready if len(index) == ready.sizes["time"] and not notes else ready.isel(time=index)
        data = resample_dataset(_select_signals(ready, signals, str(path)), rate_hz)
    else:
        assert raw is not None
        found_channels, said = extract_log_channels(raw, given, tuple(signals))
        notes = [*raw.notes, *said]
        if signals:
            found_channels = select_channels(found_channels, signals, raw.path, "; or write topic/field")
        if not found_channels:
            remedy = f"name some (topic/field), or give a column map; topics are: {', '.join(list(raw)[:10])}"
            raise InputError(str(path), "", "contains no signal with one of mufly's names", remedy)
        data = resample_channels(found_channels, rate_hz, notes)
        data.attrs |= {"start_time": raw.start_time, "complete": raw.is_complete}
        notes += raw.describe_damage()
    data.attrs |= {"source": Path(path).name, "format": kind, "notes": notes}
    for note in notes:
        warnings.warn(f"{Path(path).name}: {note}", LogWarning, stacklevel=2)
    data = select_time_range(data, from_s, to_s, str(path))
    return data if start_s is None else _shift_start(data, start_s)


def _shift_start(data: xr.Dataset, start_s: float) -> xr.Dataset:
    """Return the dataset on a clock that begins at ``start_s``."""
    if not np.isfinite(start_s):
        raise ArgumentError("start_s", "", f"{start_s:g} s is not a time", "give a number, as start_s=0")
    by = start_s - float(data["time"].values[0])
    time = data["time"]
    data = data.assign_coords(time=("time", time.values + by, time.attrs))
    if "event_time" in data:
        event = data["event_time"]
        data = data.assign(event_time=(event.dims, event.values + by, event.attrs))
    if "start_time_ns" in data.attrs:
        data.attrs["start_time_ns"] = int(data.attrs["start_time_ns"]) - round(by * 1e9)
    with contextlib.suppress(ValueError):  # unknown start time
        began = datetime.fromisoformat(str(data.attrs.get("start_time", ""))) - timedelta(seconds=by)
        data.attrs["start_time"] = began.isoformat(timespec="milliseconds")
    return data


# A variation of the steps above this share is reported.
MAX_UNREPORTED_JITTER = 0.02


def matches_signal(name: str, pattern: str) -> bool:
    """Return whether a pattern matches the signal ``variable.label``.

    A pattern is the signal's name, its variable's name, or a text with wildcards (``*``, ``?``).
    """
    variable = name.partition(".")[0]
    if pattern in (variable, name.replace(".", "_")) or pattern.lstrip("/") == name.lstrip("/"):
        return True
    return any(c in pattern for c in "*?") and (
        fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(variable, pattern)
    )


def select_channels(channels: Sequence[Channel], patterns: Sequence[str], where: str, also: str = "") -> list[Channel]:
    """Return the channels selected by signal names, wildcards or sources (``topic/field``), in that order.

    Raises
    ------
    InputError
        If a pattern matches no channel; ``also`` is added to the remedy.
    """
    out: dict[str, Channel] = {}
    for pattern in patterns:
        found = [c for c in channels if matches_signal(c.name, pattern)]
        found = found or [c for c in channels if "/" in pattern and c.source == pattern]
        if not found:
            names = ", ".join(dict.fromkeys(c.signal_name for c in channels)) or "none"
            raise InputError(where, pattern, "there is no such signal", f"signals are: {names}{also}")
        out |= {c.name: c for c in found}
    return list(out.values())


def _select_signals(data: xr.Dataset, signals: Sequence[str], where: str) -> xr.Dataset:
    """Return the selected signals of a dataset; components of a variable that are not selected become NaN."""
    if not signals:
        return data
    keep: dict[str, set[str]] = {}
    for c in select_channels(split_dataset_into_channels(data), signals, where):
        keep.setdefault(c.signal_name, set()).add(str(c.component_label))
    out = data[list(keep)]
    for name, labels in keep.items():
        if out[name].ndim == 2:
            dim = str(out[name].dims[1])
            out[name] = out[name].where(out[name][dim].astype(str).isin(sorted(labels)))
    return out


def join_channels_at_highest_rate(channels: Sequence[Channel]) -> xr.Dataset:
    """Resample channels to one uniform clock at their highest rate; commands hold their last value."""
    held = [c._replace(hold=is_command_signal(c.signal_name)) for c in channels]
    return resample_channels(held, _highest_rate(held), [])


def resample_channels(channels: list[Channel], rate_hz: float | None, notes: list[str]) -> xr.Dataset:
    """Resample channels to one clock."""
    time = channels[0].time
    shared = all(c.time is time or np.array_equal(c.time, time) for c in channels)
    on_clock = channels
    if shared and rate_hz is None:
        report = examine_time_stamps(time)
        if report.jitter_ratio > MAX_UNREPORTED_JITTER or len(report.gaps):
            holes = f"{len(report.gaps)} gap{'s' if len(report.gaps) > 1 else ''}" if len(report.gaps) else ""
            steps = (
                f"steps vary by {100 * report.jitter_ratio:.2g} %"
                if report.jitter_ratio > MAX_UNREPORTED_JITTER
                else ""
            )
            said = ", ".join(t for t in (steps, holes) if t)
            notes.append(f"the clock is uneven ({said}); give a rate to resample")
    else:
        highest = _highest_rate(channels)
        rate = rate_hz or (float(round(highest)) if highest >= 10 else float(f"{highest:.3g}"))
        time = common_clock([(float(c.time[0]), float(c.time[-1])) for c in channels if len(c.time)], rate)
        on_clock = [c._replace(values=_resample_channel(c, time)) for c in channels]
    data = make_dataset_from_channels(time, on_clock)
    for c in channels:
        attrs = data[c.signal_name].attrs
        attrs.setdefault("source", c.source)
        attrs.setdefault("source_rate_hz", float(f"{_median_rate_hz(c.time):.4g}"))
        if c.long_name:
            attrs["long_name"] = c.long_name
    _align_full_turns(data)
    data.attrs["rate_hz"] = float(f"{_median_rate_hz(time):.6g}")
    return data


def _highest_rate(channels: Sequence[Channel]) -> float:
    return max(
        (r for r in (_median_rate_hz(c.time) for c in channels if not c.is_text) if np.isfinite(r)),
        default=1.0,
    )


def _median_rate_hz(time: NDArray[np.float64]) -> float:
    return float(1 / np.median(np.diff(time))) if len(time) > 1 else float("nan")


def _resample_channel(c: Channel, time: NDArray[np.float64]) -> NDArray[Any]:
    if not c.is_text:
        return resample_signal(c.time, c.values, time, hold=c.hold)
    before = np.searchsorted(c.time, time, side="right") - 1
    out: NDArray[Any] = np.where(before >= 0, c.values[np.clip(before, 0, None)], "")
    return out


def _align_full_turns(data: xr.Dataset) -> None:
    """Shift reference and estimated angles in place by whole turns, so that they lie next to the measured angles."""
    if "measured_attitude" not in data:
        return
    for name in ("reference_attitude", "estimated_attitude"):
        if name in data:
            apart = data[name].values - data["measured_attitude"].values
            for k in range(apart.shape[1]):
                known = apart[np.isfinite(apart[:, k]), k]
                if len(known):
                    data[name].values[:, k] -= 2 * np.pi * np.rint(np.median(known) / (2 * np.pi))


def resample_dataset(data: xr.Dataset, rate_hz: float | None) -> xr.Dataset:
    """Resample a dataset on one clock to another rate."""
    if rate_hz is None or data.sizes["time"] < 2:
        return data
    old = data["time"].values
    time = common_clock([(float(old[0]), float(old[-1]))], rate_hz)
    out: dict[str, Any] = {}
    for key, variable in data.data_vars.items():
        name = str(key)
        if "time" not in variable.dims:
            out[name] = variable
        elif variable.dtype.kind not in "fiu":
            before = np.clip(np.searchsorted(old, time + 1e-9, side="right") - 1, 0, None)
            out[name] = (variable.dims, variable.values[before], variable.attrs)
        else:
            hold = is_command_signal(name)
            block = variable.values.astype(np.float64).reshape(len(old), -1)
            new = np.column_stack([resample_signal(old, column, time, hold=hold) for column in block.T])
            out[name] = (variable.dims, new.reshape(len(time), *variable.shape[1:]), variable.attrs)
    coords: dict[str, Any] = {str(k): v for k, v in data.coords.items() if k != "time"}
    coords["time"] = ("time", time, data["time"].attrs)
    return xr.Dataset(out, coords, {**data.attrs, "rate_hz": rate_hz})


def select_time_range(data: xr.Dataset, from_s: float | None, to_s: float | None, where: str) -> xr.Dataset:
    if from_s is None and to_s is None:
        return data
    time = data["time"].values
    kept = (time >= (-np.inf if from_s is None else from_s)) & (time <= (np.inf if to_s is None else to_s))
    if not kept.any():
        span = f"the log lasts from {time[0]:.3f} to {time[-1]:.3f} s"
        raise ArgumentError("from_s", "", f"{where} has no samples in that time span", span)
    return data.isel(time=kept)


LOG_WRITERS: dict[str, Callable[[xr.Dataset, Path], object]] = {
    ".csv": write_recording_csv,
    ".parquet": write_parquet,
    ".nc": write_netcdf,
    ".mcap": write_mcap,
    ".ulg": write_ulog,
}
"""Writer of each file format that keeps every signal. A bag of ROS 2 (:data:`BAG_ENDING`) is a folder of messages."""


def write_log(dataset: xr.Dataset, path: str | Path) -> Path:
    """Write signals on one clock to a file; an existing file is replaced only when the new one is complete.

    Parameters
    ----------
    dataset : xarray.Dataset
        Signals, as from :func:`read_log`.
    path : str or Path
        File; its ending decides the format: .csv, .parquet, .nc (NetCDF 3), .mcap (a recording), .ulg or .rosbag2 (the
        folder of a bag of ROS 2).

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        If the ending is unknown, pyarrow is missing for Parquet, or the file cannot be written.
    """
    target = Path(path)
    if target.suffix.lower() == BAG_ENDING:
        write_rosbag2(dataset, target)
        return target
    writer = LOG_WRITERS.get(target.suffix.lower())
    if writer is None:
        problem = f"the ending {target.suffix!r} is not that of a log format"
        raise InputError(str(path), "", problem, f"use one of: {', '.join((*LOG_WRITERS, BAG_ENDING))}")
    with replace_file_atomically(target, "choose another folder or free disk space") as part:
        writer(dataset, part)
    return target
