"""Signals as a ULog file, for the programs that know PX4's logs.

The format is PX4's published one (docs.px4.io, "ULog File Format", version 1): the header (magic, version, time stamp);
definitions (flags B, format F, information I); then data (subscription A, data D, logged text L), each message
``size (u16), type (u8), body``, all little-endian. The signals become one topic, ``table``: its clock in whole
microseconds, as the format wants, and once more as a double, so that it comes back to the bit; text becomes a number
whose meaning stands in the information ``mufly_dataset``, with whatever else columns do not say.
"""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.csv_file import TOPIC
from mufly.logs.flat import columns_of, describe
from mufly.logs.recording import events_of
from mufly.logs.ulog import MAGIC

__all__ = ["TEXTS", "write_ulog"]

TEXTS = "mufly_texts"
_LEVELS = {"error": b"3", "warning": b"4", "info": b"6"}
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
        raise InputError(str(path), "time", "begins before 0", "shift it, or write .mcap or .nc")
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
        if not _NAME.fullmatch(column.name):
            raise InputError(
                str(path), column.name, "is no name for ULog", "use letters, digits and underscores"
            )
        if column.values.dtype.kind in "US":
            known, number = np.unique(column.values, return_inverse=True)
            texts[column.name] = known.tolist()
            declared.append(f"uint16_t {column.name}")
            layout.append((column.name, "<u2"))
            values.append(number)
        else:
            declared.append(f"double {column.name}")
            layout.append((column.name, "<f8"))
            values.append(column.values)
    format_text = f"{TOPIC}:{';'.join(declared)};".encode()
    rows = np.zeros(len(time), dtype=np.dtype(layout))
    if len(format_text) > _LONGEST or rows.itemsize > _LONGEST:
        raise InputError(
            str(path), "", f"{len(columns)} columns do not fit one ULog message", "choose fewer signals"
        )
    rows["size"], rows["kind"], rows["id"] = rows.itemsize - 3, ord("D"), 0
    rows["stamp"] = np.rint(np.where(np.isfinite(time), time, 0) * 1e6).astype(np.uint64)
    rows["time"] = time
    for column, value in zip(columns, values, strict=True):
        rows[column.name] = value
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
            _LEVELS.get(e.level, b"6")
            + struct.pack("<Q", max(round(e.time_s * 1e6), 0))
            + _said(e.state, e.text),
        )
        for e in (events_of(dataset) if "event_time" in dataset else [])
    )
    path.write_bytes(head + rows.tobytes() + said)


def _said(state: str, text: str) -> bytes:
    return (f"{state}: {text}" if state else text).encode()[: _LONGEST - 16]
