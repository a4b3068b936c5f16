"""ULog, the log of PX4 (docs.px4.io, "ULog File Format", version 1): read with pyulog, and written.

Times are microseconds since the board started; here they count in seconds from the time stamp in the file's header.
What was published before the logger started lies before 0. A stamp of 0 in a file whose header has another was never
set. Topics carry no units.

Signals of ours are written as one topic, ``table``: its clock in whole microseconds, as the format wants, and once more
as a double, so that it comes back to the bit; text becomes a number whose meaning stands in the information
``mufly_dataset``, with whatever else columns do not say. A file is the header (magic, version, time stamp); definitions
(flags B, format F, information I); then data (subscription A, data D, logged text L), each message
``size (u16), type (u8), body``, all little-endian.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.logs.mcap import columns_of, describe, events_of
from mufly.logs.tables import TOPIC
from mufly.logs.topics import RawLog, RawTable, foreign_stamps, wall_time
from mufly.logs.unknown import without_unknown

MAGIC = b"ULog\x01\x12\x35"
_LEVELS = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_CHAR = re.compile(r"(.+)\[(\d+)\]$")
_NEAR_US = 600_000_000


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
    header = int(log.start_timestamp)
    stamps = {_name(data): data.data["timestamp"] for data in topics}
    stamps[_SAID] = np.array([m.timestamp for m in log.logged_messages], dtype=np.uint64)
    stamps[_LOST] = np.array([d.timestamp for d in log.dropouts], dtype=np.uint64)
    times, notes = _times(header, stamps)
    tables = {}
    for data in topics:
        types = {f.field_name: f.type_str for f in data.field_data}
        values = {key: value for key, value in data.data.items() if key != "timestamp"}
        name = _name(data)
        tables[name] = RawTable(name, times[name], without_unknown(data.name, _join_text(values, types)))
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
            (t, _level(m.log_level), m.message)
            for t, m in zip(times[_SAID].tolist(), log.logged_messages, strict=True)
        ),
        dropouts=tuple(
            (t, d.duration / 1e3) for t, d in zip(times[_LOST].tolist(), log.dropouts, strict=True)
        ),
        complete=not log.file_corruption and "corruption" not in said.getvalue(),
        notes=tuple(notes),
    )


# What has a time besides the topics.
_SAID, _LOST = "the vehicle's messages", "the logger's drop-outs"


def _name(data: Any) -> str:
    return data.name if data.multi_id == 0 else f"{data.name}:{data.multi_id}"


def _times(
    header: int, stamps: Mapping[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Seconds since the instant 0 of everything that has a stamp (us), NaN where it is none of the log's clock.

    The instant 0 is the header's, if data are near it. If not, it is the first of the log's own; topics whose clock
    stands still (PX4 has some) do not count.
    """
    seconds = {k: s.astype(np.float64) / 1e6 for k, s in stamps.items()}
    if header > 0:
        seconds = {k: np.where(s == 0, np.nan, s) for k, s in seconds.items()}
    unset = {k: int(np.isnan(s).sum()) for k, s in seconds.items()}
    foreign, notes = foreign_stamps(seconds)
    notes += [f"{k}: {n} of {len(stamps[k])} time stamps were never set (0)" for k, n in unset.items() if n]
    known = {k: s[~foreign[k] & np.isfinite(seconds[k])].astype(np.int64) for k, s in stamps.items()}
    running = [s for s in known.values() if len(s) and s[-1] > s[0]] or [s for s in known.values() if len(s)]
    first = min((int(s[0]) for s in running), default=header)
    last = max((int(s[-1]) for s in running), default=header)
    zero = header if first - _NEAR_US < header < last + _NEAR_US else first
    out = {
        k: np.where(foreign[k] | np.isnan(seconds[k]), np.nan, (s.astype(np.int64) - zero) / 1e6)
        for k, s in stamps.items()
    }
    return out, notes


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
        known = np.flatnonzero((utc.astype(np.int64) > 10**15) & np.isfinite(table.time))
        if len(known):
            at = int(utc[known[0]]) / 1e6 - table.time[known[0]]
            return wall_time(at)
    return ""


TEXTS = "mufly_texts"
_ULOG_WRITE_LEVELS = {"error": b"3", "warning": b"4", "info": b"6"}
_LONGEST = 65535
_NAME = re.compile(r"[A-Za-z0-9_]+")


def _message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def _information(key: str, text: str) -> bytes:
    """Information; text that does not fit one message goes on in further ones (M)."""
    data = text.encode()
    name = f"char[{{}}] {key}"
    room = _LONGEST - 300
    if len(data) <= room:
        head = name.format(len(data)).encode()
        return _message(b"I", bytes([len(head)]) + head + data)
    out = b""
    for at in range(0, len(data), room):
        part = data[at : at + room]
        head = name.format(len(part)).encode()
        out += _message(b"M", bytes([at > 0, len(head)]) + head + part)
    return out


def write_ulog(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as ULog.

    Raises
    ------
    InputError
        If it lasts from before the instant 0 (the clock of the format has no sign), is too wide for one message, or a
        name is none that the format allows.
    """
    columns = columns_of(dataset)
    time = dataset["time"].values.astype(np.float64)
    if len(time) and time[0] < 0:
        raise ArgumentError(
            "start_s", "", f"the log begins at {time[0]:.6g} s, and ULog knows no time before 0",
            "give start_s=0 to let its clock begin there, or write .mcap or .nc",
        )  # fmt: skip
    texts: dict[str, list[str]] = {}
    layout: list[tuple[str, Any]] = [
        ("size", "<u2"),
        ("kind", "u1"),
        ("id", "<u2"),
        ("stamp", "<u8"),
        ("time", "<f8"),
    ]
    values: list[NDArray[Any]] = []
    declared = ["uint64_t timestamp", "double time"]
    for column in columns:
        if not _NAME.fullmatch(column.column):
            raise InputError(
                str(path), column.column, "is no name for ULog", "use letters, digits and underscores"
            )
        if column.values.dtype.kind in "US":
            known, number = np.unique(column.values, return_inverse=True)
            texts[column.column] = known.tolist()
            declared.append(f"uint16_t {column.column}")
            layout.append((column.column, "<u2"))
            values.append(number)
        else:
            declared.append(f"double {column.column}")
            layout.append((column.column, "<f8"))
            values.append(column.values)
    format_text = f"{TOPIC}:{';'.join(declared)};".encode()
    rows = np.zeros(len(time), dtype=np.dtype(layout))
    if len(format_text) > _LONGEST:  # a row is shorter than its definition
        raise InputError(
            str(path), "", f"{len(columns)} columns do not fit one ULog message", "choose fewer signals"
        )
    rows["size"], rows["kind"], rows["id"] = rows.itemsize - 3, ord("D"), 0
    rows["stamp"] = np.rint(np.where(np.isfinite(time), time, 0) * 1e6).astype(np.uint64)
    rows["time"] = time
    for column, value in zip(columns, values, strict=True):
        rows[column.column] = value
    head = MAGIC + b"\x01" + struct.pack("<Q", 0) + _message(b"B", bytes(40))
    head += _message(b"F", format_text)
    head += _information("sys_name", "mufly") + _information(
        "mufly_start_time", str(dataset.attrs.get("start_time", ""))
    )
    head += _information(TEXTS, json.dumps(texts)) + _information("mufly_dataset", describe(dataset))
    head += _message(b"A", struct.pack("<BH", 0, 0) + TOPIC.encode())
    said = b"".join(
        _message(
            b"L",
            _ULOG_WRITE_LEVELS.get(e.level, b"6")
            + struct.pack("<Q", max(round(e.time_s * 1e6), 0))
            + _said(e.state, e.text),
        )
        for e in (events_of(dataset) if "event_time" in dataset else [])
    )
    path.write_bytes(head + rows.tobytes() + said)


def _said(state: str, text: str) -> bytes:
    return (f"{state}: {text}" if state else text).encode()[: _LONGEST - 16]
