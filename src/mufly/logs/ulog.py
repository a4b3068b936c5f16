"""ULog, the log of PX4 (docs.px4.io, "ULog File Format"), read with pyulog.

Times are microseconds since the board started; here they count in seconds from the time stamp in the file's header.
Topics carry no units.
"""

from __future__ import annotations

import contextlib
import io
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.raw import RawLog, RawTable

__all__ = ["MAGIC", "read_ulog"]

MAGIC = b"ULog\x01\x12\x35"
_LEVELS = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_CHAR = re.compile(r"(.+)\[(\d+)\]$")


def read_ulog(path: str | Path) -> RawLog:
    """Read a ULog file; one that was cut off is read up to the cut.

    Raises
    ------
    InputError
        If its header is damaged or it holds no data.
    """
    from pyulog import ULog

    where = str(path)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):  # pyulog prints what it finds wrong
            log = ULog(where)
    except Exception as error:  # whatever a damaged definition section provokes
        raise InputError(where, "", f"is damaged ULog ({error})", "give another copy of the file") from error
    topics = [data for data in log.data_list if "timestamp" in data.data]
    if not topics:
        raise InputError(where, "", "is a ULog file without data", "the log ended before its first message")
    stamps = [data.data["timestamp"] for data in topics]
    zero = _zero(int(log.start_timestamp), stamps)
    tables = {}
    for data, stamp in zip(topics, stamps, strict=True):
        name = data.name if data.multi_id == 0 else f"{data.name}:{data.multi_id}"
        types = {f.field_name: f.type_str for f in data.field_data}
        values = {key: value for key, value in data.data.items() if key != "timestamp"}
        tables[name] = RawTable(name, _seconds(stamp, zero), _join_text(values, types))
    info = {key: value for key, value in log.msg_info_dict.items() if key != "time_ref_utc"}
    # Text too long for one message comes in several.
    info |= {
        key: "".join(str(part) for part in parts[0])
        for key, parts in log.msg_info_multiple_dict.items()
        if key.startswith("mufly_")
    }
    info["parameters"] = dict(log.initial_parameters)
    return RawLog(
        path=where,
        kind="ULog",
        tables=tables,
        start_time=_start_time(tables, log.msg_info_dict),
        info=info,
        messages=tuple(
            ((m.timestamp - zero) / 1e6, _level(m.log_level), m.message) for m in log.logged_messages
        ),
        dropouts=tuple(((d.timestamp - zero) / 1e6, d.duration / 1e3) for d in log.dropouts),
        complete=not log.file_corruption and "corruption" not in said.getvalue(),
    )


def _zero(header: int, stamps: list[NDArray[Any]]) -> int:
    """The instant 0: the header's, if data are near it; topics whose clock stands still (PX4 has some) do not count."""
    first = min((int(s[0]) for s in stamps if s[-1] > s[0]), default=min(int(s[0]) for s in stamps))
    return header if abs(first - header) < 600_000_000 else first


def _seconds(stamp: NDArray[Any], zero: int) -> NDArray[np.float64]:
    out: NDArray[np.float64] = (stamp.astype(np.int64) - zero) / 1e6
    return out


def _level(number: int) -> str:
    index = number - ord("0") if number >= ord("0") else number
    return _LEVELS[index] if 0 <= index < len(_LEVELS) else "info"


def _join_text(values: dict[str, NDArray[Any]], types: dict[str, str]) -> dict[str, NDArray[Any]]:
    """Put the characters of text fields, which pyulog gives one by one, together again."""
    out: dict[str, NDArray[Any]] = {}
    text: dict[str, list[NDArray[Any]]] = {}
    for key, value in values.items():
        part = _CHAR.match(key) if types.get(key) == "char" else None
        if part is None:
            out[key] = value
        else:
            text.setdefault(part[1], []).append(value)
    for key, columns in text.items():
        block = np.ascontiguousarray(np.stack(columns, axis=1).astype(np.uint8))
        lines = (bytes(row).split(b"\0")[0].decode(errors="replace") for row in block)
        out[key] = np.array(list(lines), dtype=str)
    return out


def _start_time(tables: dict[str, RawTable], info: dict[str, Any]) -> str:
    """Wall time of the instant 0, from the first position fix or from what our own writer noted."""
    if isinstance(info.get("mufly_start_time"), str):
        return str(info["mufly_start_time"])
    for name in ("sensor_gps", "vehicle_gps_position"):
        table = tables.get(name)
        utc = None if table is None else table.fields.get("time_utc_usec")
        if table is None or utc is None:
            continue
        known = np.flatnonzero(utc.astype(np.int64) > 10**15)
        if len(known):
            at = int(utc[known[0]]) / 1e6 - table.time[known[0]]
            return datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds")
    return ""
