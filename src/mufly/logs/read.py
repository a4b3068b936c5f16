"""One door for all logs: :func:`read_raw` gives what was written, :func:`read_log` signals on one clock."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mufly.errors import InputError
from mufly.logs.clock import usable_samples
from mufly.logs.column_map import ColumnMap, TimeEntry, load_map
from mufly.logs.csv_file import TOPIC, read_csv
from mufly.logs.dataflash import read_dataflash
from mufly.logs.detect import kind_of
from mufly.logs.flat import columns_of, restore
from mufly.logs.foreign_mcap import is_recording, raw_mcap
from mufly.logs.join import at_rate, choose_series, choose_variables, part_of, put_together
from mufly.logs.mapping import map_signals
from mufly.logs.mcap_file import read_mcap
from mufly.logs.raw import LogWarning, RawLog, RawTable
from mufly.logs.recording import read_recording
from mufly.logs.series import Series
from mufly.logs.tables_file import read_netcdf, read_parquet
from mufly.logs.tlog import read_tlog
from mufly.logs.ulog import read_ulog

__all__ = ["open_log", "read_log", "read_raw", "series_of"]

Progress = Callable[[int, int], None]
_MAPS = {"ULog": "px4", "DataFlash": "ardupilot", "MAVLink tlog": "mavlink"}


def read_raw(path: str | Path, *, time: TimeEntry | None = None, progress: Progress | None = None) -> RawLog:
    """Read a log as it was written: topics, each on its own clock.

    Parameters
    ----------
    path : str or Path
        MCAP, ULog, DataFlash, MAVLink telemetry log, CSV, Parquet or NetCDF; told by content, not by name.
    time : TimeEntry, optional
        The clock of a CSV or Parquet table.
    progress : callable, optional
        Called with (bytes read, bytes in all) while a long log is read.

    Returns
    -------
    RawLog
        A mapping from topic to :class:`RawTable`.

    Raises
    ------
    InputError
        If the file is no log or damaged beyond use.
    """
    return open_log(path, time, progress)[0]


def open_log(
    path: str | Path, time: TimeEntry | None, progress: Progress | None
) -> tuple[RawLog, xr.Dataset | None]:
    """Return the topics of a log and, where it holds signals under our names on one clock already, those.

    Parameters and errors are those of :func:`read_raw`.
    """
    kind = kind_of(path)
    where = str(path)
    if kind == "MCAP":
        return raw_mcap(path), _our_mcap(path)
    if kind == "ULog":
        raw = read_ulog(path)
        return raw, _our_ulog(raw)
    if kind == "DataFlash":
        return read_dataflash(path), None
    if kind == "MAVLink tlog":
        return read_tlog(path, progress), None
    if kind == "Parquet":
        return read_parquet(path, time)
    if kind == "NetCDF":
        data = read_netcdf(path)
        table = RawTable(
            TOPIC, data["time"].values.astype(np.float64), {c.name: c.values for c in columns_of(data)},
            {c.name: c.units for c in columns_of(data)},
        )  # fmt: skip
        return RawLog(where, "NetCDF", {TOPIC: table}, str(data.attrs.get("start_time", ""))), data
    return read_csv(path, time), None


def series_of(
    raw: RawLog, columns: str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap | None = None
) -> tuple[list[Series], list[str]]:
    """Return the signals of a log, each component on its own clock in SI units, and what was guessed and repaired.

    Parameters
    ----------
    raw : RawLog
        From :func:`read_raw`.
    columns : optional
        Column map, as :func:`load_map` takes it.

    Raises
    ------
    InputError
        As :func:`read_log`.
    """
    given = None if columns is None else load_map(columns)
    standard = load_map(_MAPS[raw.kind]) if raw.kind in _MAPS else None
    return map_signals(raw, given, standard)


def _our_mcap(path: str | Path) -> xr.Dataset | None:
    """Return the dataset of a recording of ours, None for somebody else's MCAP file."""
    try:
        return read_recording(path)
    except InputError:
        if is_recording(read_mcap(path)):
            raise
        return None


def _our_ulog(raw: RawLog) -> xr.Dataset | None:
    """The dataset of a ULog file that this package wrote."""
    description, texts = raw.info.get("mufly_dataset"), raw.info.get("mufly_texts")
    if not isinstance(description, str) or not isinstance(texts, str) or TOPIC not in raw:
        return None
    fields = dict(raw[TOPIC].fields)
    try:
        for name, known in json.loads(texts).items():
            fields[name] = np.array(known, dtype=str)[fields[name]]
        return restore(fields.pop("time"), fields, description)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        problem = f"has a damaged description ({error})"
        raise InputError(raw.path, "", problem, "give another copy of the file") from error


def read_log(
    path: str | Path,
    *,
    columns: str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap | None = None,
    signals: Sequence[str] = (),
    rate_hz: float | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Read a log of any known format as signals on one clock, in SI units.

    Parameters
    ----------
    path : str or Path
        MCAP, ULog, DataFlash, MAVLink telemetry log, CSV, Parquet or NetCDF; told by content, not by name.
    columns : optional
        Column map, as :func:`load_map` takes it; comes before the map of PX4, ArduPilot or MAVLink.
    signals : sequence of str
        What to read: names (``measured_attitude``), components (``measured_attitude.roll``), patterns
        (``measured_*``), fields as they are (``sensor_combined/gyro_rad[0]``). Default: all that have a name of ours.
    rate_hz : float, optional
        Rate of the common clock. Default: signals that share a clock keep it; others come to the highest rate among
        them.
    from_s, to_s : float, optional
        Part of the log to keep (s since its start).
    progress : callable, optional
        Called with (bytes read, bytes in all) while a long log is read.

    Returns
    -------
    xarray.Dataset
        Coordinate ``time`` (s since the start of the log). Each variable has ``units``, ``long_name`` and, for foreign
        logs, ``source`` and ``source_rate_hz``. Attributes: ``source``, ``format``, ``start_time``, ``complete`` and
        ``notes``, a list of what was guessed and repaired; every note is also given as a :class:`LogWarning`. Gaps
        are NaN.

    Raises
    ------
    InputError
        If the file is no log, the map does not fit it, a signal is not in it, or its clock cannot be repaired.

    Examples
    --------
    >>> data = read_log("flight.ulg", signals=["measured_*"], rate_hz=100)  # doctest: +SKIP
    >>> data = read_log("bench.csv", columns={"battery_voltage": "U[mV]", "time": "t[ms]"})  # doctest: +SKIP
    """
    if rate_hz is not None and not 0 < rate_hz < 1e6:
        raise InputError("rate", "", f"{rate_hz:g} Hz is not sensible", "give a rate above 0")
    if from_s is not None and to_s is not None and not from_s < to_s:
        raise InputError("--from", f"{from_s:g}", f"is not before {to_s:g}", "give the earlier time first")
    given = None if columns is None else load_map(columns)
    kind = kind_of(path)
    raw: RawLog | None = None
    ready: xr.Dataset | None = None
    as_it_is = given is None and not any("/" in s for s in signals)
    if kind == "MCAP" and as_it_is:
        ready = _our_mcap(path)
    if ready is None:
        raw, found = open_log(path, None if given is None else given.time, progress)
        ready = found if as_it_is else None
    if ready is not None:
        index, notes = usable_samples(ready["time"].values.astype(np.float64), str(path), "")
        ready = ready if len(index) == ready.sizes["time"] and not notes else ready.isel(time=index)
        data = at_rate(choose_variables(ready, signals, str(path)), rate_hz)
    else:
        assert raw is not None
        standard = load_map(_MAPS[kind]) if kind in _MAPS else None
        series, notes = map_signals(raw, given, standard, tuple(signals))
        notes = [*raw.notes, *notes]
        series = choose_series(series, signals, raw)
        if not series:
            remedy = f"name some (topic/field), or give a column map; topics are: {', '.join(list(raw)[:10])}"
            raise InputError(str(path), "", "holds no signal with a name of ours", remedy)
        data = put_together(series, rate_hz, notes)
        data.attrs |= {"start_time": raw.start_time, "complete": raw.complete}
        notes += [] if raw.complete else ["the file is damaged or cut off; what could be read is here"]
    data.attrs |= {"source": Path(path).name, "format": kind, "notes": notes}
    for note in notes:
        warnings.warn(f"{Path(path).name}: {note}", LogWarning, stacklevel=2)
    return part_of(data, from_s, to_s, str(path))
