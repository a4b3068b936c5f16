"""Reader and writer of ULog, the log format of PX4 (docs.px4.io, "ULog File Format", version 1).

Times are microseconds since the start of the board; they are converted to seconds since the time stamp in the file's
header. Messages published before the start of the logger have negative times. A stamp of 0 was never set, unless
the header's stamp is 0, too. Topics have no units.

A file is the header (magic, version, time stamp); definitions (flags B, format F, information I and M, parameters P);
then data (subscription A, data D, logged text L, drop-outs O, synchronisation S), each message ``size (u16), type (u8),
body``, all little-endian. The format has no checksums and no end mark. A message is valid if its size is that of its
topic's format, or its content fits its type. After an invalid message, reading continues at the next head of a message
of a subscribed topic (size, type and number are five known bytes) or at a synchronisation message. The bodies of one
topic are unpacked together by NumPy, in a quarter of the time of one Python object for each message.

Signals of this package are written as one topic, ``table``. Its clock is written in integer microseconds, as the format
requires, and as a double, which restores it to the bit. Text becomes a number; the information ``mufly_dataset`` holds
the texts and all else outside the columns. ``mufly_rows`` is the number of rows.
"""

from __future__ import annotations

import json
import re
import struct
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.logs.mavlink_unknown_values import replace_unknown_values
from mufly.logs.mcap import encode_dataset_metadata, read_events, split_dataset_into_channels
from mufly.logs.raw_log import RawLog, RawTable, find_foreign_epoch_stamps, format_wall_time
from mufly.logs.tables import TABLE_TOPIC

MAGIC = b"ULog\x01\x12\x35"
_MESSAGE_HEAD_BYTES, _STAMP_SIZE = 3, 8  # bytes of length and type of a message, and of a stamp
HEADER_SIZE = 16
_SYNC_BYTES = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
_LEVEL_WORDS = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_MESSAGE_TYPE_OFFSET = 2  # of a message, after its size
_INCOMPATIBLE_FLAGS_SLICE = slice(8, 16)  # of the message of flag bits
_SUBSCRIPTION_NAME_OFFSET = 3  # after instance and number
_MAX_HEADER_TIME_OFFSET_US = 600_000_000
_NUMPY_TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4", "uint32_t": "<u4",
    "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8", "bool": "i1", "char": "i1",
}  # fmt: skip
_FIELD_PATTERN = re.compile(r"([A-Za-z0-9_/]+)(?:\[(\d{1,5})\])? (\S+)")
_MAX_ARRAY_LENGTH, _MAX_FIELDS = 0xFFFF, 20_000
(
    _DATA_MESSAGE,
    _FORMAT_MESSAGE,
    _SUBSCRIPTION_MESSAGE,
    _REMOVAL_MESSAGE,
    _LOG_TEXT_MESSAGE,
    _TAGGED_TEXT_MESSAGE,
) = b"DFARLC"
(
    _INFO_MESSAGE,
    _INFO_MULTIPLE_MESSAGE,
    _PARAMETER_MESSAGE,
    _DEFAULT_PARAMETER_MESSAGE,
    _DROPOUT_MESSAGE,
    _SYNC_MESSAGE,
    _FLAG_BITS_MESSAGE,
) = b"IMPQOSB"
_MESSAGE_TYPES = frozenset(b"DFARLCIMPQOSB")
_APPENDED_DATA_FLAG = 1  # the only supported incompatible flag: data appended to the log


@dataclass
class _SubscribedTopic:
    """A subscribed topic: its layout, and the offsets of its messages' bodies."""

    name: str
    dtype: np.dtype[Any]
    message_sizes: tuple[int, int]  # smallest and largest size of a message: padding at the end may be omitted
    stamp_offset: int
    body_offsets: array[int] = field(default_factory=lambda: array("q"))


@dataclass
class _ScanResult:
    """Contents of a ULog file after one pass: definitions, offsets of data messages, texts and damage."""

    formats: dict[str, list[tuple[str, int, str]]] = field(default_factory=dict)
    info: dict[str, Any] = field(default_factory=dict)
    multi_info: dict[str, list[bytes]] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    topics: dict[str, _SubscribedTopic] = field(default_factory=dict)
    topics_by_id: dict[int, _SubscribedTopic] = field(default_factory=dict)
    log_texts: list[tuple[int, int, str]] = field(default_factory=list)  # stamp, level, text
    dropouts: list[tuple[int, int]] = field(default_factory=list)  # stamp, duration (ms)
    in_data_section: bool = False
    unknown_type_counts: dict[str, int] = field(default_factory=dict)  # messages of unknown types
    undescribed_count: int = 0  # data messages without a subscription
    appended_offsets: list[int] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    damaged_offsets: list[tuple[int, int]] = field(default_factory=list)


def read_ulog(path: str | Path) -> RawLog:
    """Read a ULog file; of a truncated or damaged file all valid messages.

    Raises
    ------
    InputError
        If its header is damaged, it holds no data, or it uses an unknown feature.
    """
    return parse_ulog(Path(path).read_bytes(), str(path))


def parse_ulog(data: bytes, where: str) -> RawLog:
    """Parse the bytes of a ULog file, as :func:`read_ulog`; ``where`` names them in messages."""
    if len(data) < HEADER_SIZE:
        raise InputError(where, "", f"is a ULog file truncated in its header ({len(data)} of {HEADER_SIZE} "
        "bytes)",
                         "give another copy of the file")  # fmt: skip
    header = struct.unpack_from("<Q", data, 8)[0]
    scan = _scan_messages(data, header, where)
    log_rows = {name: _unpack_rows(data, topic) for name, topic in scan.topics.items() if topic.body_offsets}
    log_rows = {name: rows for name, rows in log_rows.items() if "timestamp" in (rows.dtype.names or ())}
    if not log_rows:
        why = f" ({'; '.join(scan.damage)})" if scan.damage else ""
        raise InputError(where, "", f"is a ULog file without data{why}", "the log ended before its first message")
    stamps = {name: rows["timestamp"] for name, rows in log_rows.items()}
    stamps[_LOG_TEXTS_KEY] = np.array([t for t, _, _ in scan.log_texts], dtype=np.uint64)
    stamps[_DROPOUTS_KEY] = np.array([t for t, _ in scan.dropouts], dtype=np.uint64)
    times, notes = _seconds_since_start(header, stamps)
    if scan.unknown_type_counts:
        count, types = sum(scan.unknown_type_counts.values()), ", ".join(map(repr, scan.unknown_type_counts))
        notes.append(f"{count} messages of unknown types ({types}) are skipped")
    tables = {}
    for name, rows in log_rows.items():
        values = {str(k): _decode_text_column(rows[k]) for k in rows.dtype.names or () if k != "timestamp"}
        tables[name] = RawTable(name, times[name], replace_unknown_values(name.partition(":")[0], values))
    info = {key: value for key, value in scan.info.items() if key != "time_ref_utc"}
    # A text too long for one message is split.
    info |= {
        key: b"".join(parts).decode(errors="replace")
        for key, parts in scan.multi_info.items()
        if key.startswith("mufly_")
    }
    info["parameters"] = scan.parameters
    damage = scan.damage + _describe_missing_rows(info, tables)
    info.pop(_ROW_COUNT_KEY, None)
    return RawLog(
        path=where,
        format_name="ULog",
        tables_by_topic=tables,
        start_time=_find_start_time(tables, scan.info),
        info=info,
        messages=tuple(
            (t, _severity_text(level), text)
            for t, (_, level, text) in zip(times[_LOG_TEXTS_KEY].tolist(), scan.log_texts, strict=True)
        ),
        dropouts=tuple(
            (t, duration / 1e3) for t, (_, duration) in zip(times[_DROPOUTS_KEY].tolist(), scan.dropouts, strict=True)
        ),
        is_complete=not damage,
        notes=tuple(notes),
        damage_text="; ".join(damage),
    )


def _scan_messages(data: bytes, header: int, where: str) -> _ScanResult:
    """Return the places of all valid data messages in a file, and the contents of its other messages."""
    scan = _ScanResult()
    at, end = HEADER_SIZE, len(data)
    limits = [end]
    heads: re.Pattern[bytes] | None = None
    unpack, numbers, kinds = struct.Struct("<HBH").unpack_from, scan.topics_by_id, _MESSAGE_TYPES
    while limits:
        limit = limits.pop(0)
        while at + 5 <= limit:
            size, kind, number = unpack(data, at)
            stop = at + 3 + size
            if kind == _DATA_MESSAGE:
                topic = numbers.get(number)
                if topic is not None and topic.message_sizes[0] <= size <= topic.message_sizes[1] and stop <= limit:
                    topic.body_offsets.append(at + 5)
                    at = stop
                    continue
                if (
                    topic is None
                    and scan.in_data_section
                    and stop <= limit
                    and _messages_follow(data, stop, limit, scan)
                ):
                    scan.undescribed_count += 1
                    at = stop
                    continue
            elif (
                kind in kinds
                and stop <= limit
                and _process_non_data_message(scan, kind, data[at + _MESSAGE_HEAD_BYTES : stop], header, data)
            ):
                at = stop
                if kind == _FLAG_BITS_MESSAGE and not limits:
                    limits = _find_log_part_ends(scan, where, end)
                    limit = limits.pop(0)
                elif kind == _SUBSCRIPTION_MESSAGE:
                    heads = None
                continue
            elif kind not in kinds and kind > 0x20 and _messages_follow(data, stop, limit, scan) and stop <= limit:
                scan.unknown_type_counts[chr(kind)] = scan.unknown_type_counts.get(chr(kind), 0) + 1
                at = stop  # a type of a later version
                continue
            heads = heads or _message_head_pattern(scan)
            after = stop if stop < limit and _messages_follow(data, stop, limit, scan) else None
            after = after or _find_next_message(data, at + 1, limit, scan, heads)
            _note_damage(scan, data, at, stop, after, limit)
            at = after
        if at < limit:
            _note_damage(scan, data, at, end + 1, limit, limit)
        at = max(at, limit)
    if scan.undescribed_count:
        scan.damage.append(f"{scan.undescribed_count} messages belong to topics without a description")
    if len(scan.damaged_offsets) > 1:
        size = sum(s for _, s in scan.damaged_offsets)
        scan.damage.insert(0, f"{size} bytes in {len(scan.damaged_offsets)} places are not complete "
        f"messages, the first at byte {scan.damaged_offsets[0][0]}")  # fmt: skip
    elif scan.damaged_offsets:
        place, size = scan.damaged_offsets[0]
        scan.damage.insert(0, f"{size} bytes at byte {place} are not a complete message")
    return scan


def _note_damage(scan: _ScanResult, data: bytes, at: int, stop: int, after: int, limit: int) -> None:
    """Record damage: bytes that are no valid message, or a message cut off by the end of the file."""
    if after == limit and not any(data[at:limit]):
        last = max(scan.topics.values(), key=lambda topic: topic.body_offsets[-1:], default=None)
        if not data[at - 1] and last and last.body_offsets and last.body_offsets[-1] + last.message_sizes[0] - 2 == at:
            at = last.body_offsets.pop() - 5  # the zeros may have begun inside the last message
        scan.damage.append(f"{limit - at} bytes from byte {at} on are zero")
    elif after < limit or stop <= limit:
        scan.damaged_offsets.append((at, after - at))
    elif limit < len(data):
        scan.damage.append(f"logging stopped inside a message at byte {limit}; data were appended after it")
    elif at + 3 > limit:
        scan.damage.append(f"it ends inside a message's head, at byte {at}")
    else:
        scan.damage.append(f"it ends inside a message at byte {at}, {limit - at} of {stop - at} bytes of it are there")


def _find_log_part_ends(scan: _ScanResult, where: str, end: int) -> list[int]:
    """Return the ends of the file's parts: the log, and data appended to it."""
    flags, offsets = scan.info.pop(_FLAG_BITS_INFO_KEY)
    if flags[0] & ~_APPENDED_DATA_FLAG or any(flags[1:]):
        raise InputError(where, "flag bits", f"has unknown incompatible flags ({flags.hex()})",
                         "convert it with PX4's own tools: ulog2csv")  # fmt: skip
    return [*sorted(o for o in offsets if flags[0] & _APPENDED_DATA_FLAG and HEADER_SIZE < o < end), end]


def _message_head_pattern(scan: _ScanResult) -> re.Pattern[bytes]:
    """Return a pattern of the heads of messages of subscribed topics and of synchronisation."""
    heads = [struct.pack("<HB", len(_SYNC_BYTES), _SYNC_MESSAGE) + _SYNC_BYTES]
    for number, topic in scan.topics_by_id.items():
        heads += [struct.pack("<HBH", size, _DATA_MESSAGE, number) for size in dict.fromkeys(topic.message_sizes)]
    return re.compile(b"|".join(map(re.escape, heads)))


def _find_next_message(data: bytes, start: int, limit: int, scan: _ScanResult, heads: re.Pattern[bytes]) -> int:
    """Return the offset of the next valid message; ``limit`` if there is none.

    A definition is accepted only as the first of three valid messages in a row.
    """
    for found in heads.finditer(data, start, limit):
        if _messages_follow(data, found.start(), limit, scan):
            start, limit = start, found.start()
            break
    if not scan.in_data_section:
        for at in range(start, min(limit, start + 70_000)):
            if data[at + _MESSAGE_TYPE_OFFSET : at + _MESSAGE_TYPE_OFFSET + 1] in (
                b"F",
                b"I",
                b"M",
                b"P",
                b"Q",
                b"A",
            ) and _messages_follow(data, at, len(data), scan, 3):
                return at
    return limit


def _messages_follow(data: bytes, at: int, limit: int, scan: _ScanResult, chain: int = 2) -> bool:
    """Return whether ``chain`` messages with valid heads follow each other, or as many as are left."""
    for _ in range(chain):
        if at == limit:
            return True
        if at + 5 > limit:
            return False
        size, kind, number = struct.unpack_from("<HBH", data, at)
        topic = scan.topics_by_id.get(number)
        if kind not in _MESSAGE_TYPES or not size:
            return False
        if kind == _DATA_MESSAGE and topic is not None and not topic.message_sizes[0] <= size <= topic.message_sizes[1]:
            return False
        at += 3 + size
    return at <= limit


_FLAG_BITS_INFO_KEY, _ROW_COUNT_KEY = "flag bits", "mufly_rows"


def _process_non_data_message(scan: _ScanResult, kind: int, body: bytes, header: int, data: bytes) -> bool:
    """Process a message other than data; return False if its content does not fit its type."""
    try:
        if kind == _FORMAT_MESSAGE:
            name, _, fields = body.decode("ascii").partition(":")
            parts = [_FIELD_PATTERN.fullmatch(part) for part in fields.split(";") if part]
            if not name or not parts or not all(parts) or any(int(p[2] or 0) > _MAX_ARRAY_LENGTH for p in parts if p):
                return False
            groups = (p.groups() for p in parts if p)
            scan.formats[name] = [(type_name, int(length or 0), field) for type_name, length, field in groups]
        elif kind == _SUBSCRIPTION_MESSAGE:
            _add_subscription(scan, body)
        elif kind in (_INFO_MESSAGE, _PARAMETER_MESSAGE):
            type_name, key, value = _split_key_value(body)
            known = scan.info if kind == _INFO_MESSAGE else scan.parameters
            if kind == _INFO_MESSAGE or not scan.in_data_section:
                known[key] = _decode_value(type_name, value)
        elif kind == _INFO_MULTIPLE_MESSAGE:
            _, key, value = _split_key_value(body[1:])
            scan.multi_info.setdefault(key, []).append(value)
        elif kind in (_LOG_TEXT_MESSAGE, _TAGGED_TEXT_MESSAGE):
            skip = 1 if kind == _LOG_TEXT_MESSAGE else 3
            if not (body[0] < 8 or ord("0") <= body[0] < ord("8")) or len(body) < skip + _STAMP_SIZE:
                return False
            stamp = struct.unpack_from("<Q", body, skip)[0]
            scan.log_texts.append((stamp, body[0], body[skip + _STAMP_SIZE :].decode(errors="ignore")))
            scan.in_data_section = True
        elif kind == _DROPOUT_MESSAGE:
            (duration,) = struct.unpack("<H", body)
            last = (struct.unpack_from("<Q", data, t.body_offsets[-1] + t.stamp_offset)[0]
                    for t in scan.topics.values() if t.body_offsets)  # fmt: skip
            scan.dropouts.append((max(last, default=header), duration))
        elif kind == _SYNC_MESSAGE:
            return body == _SYNC_BYTES
        elif kind == _FLAG_BITS_MESSAGE:
            scan.info[_FLAG_BITS_INFO_KEY] = (body[_INCOMPATIBLE_FLAGS_SLICE], struct.unpack_from("<QQQ", body, 16))
        return kind != _REMOVAL_MESSAGE or len(body) == 2
    except (ValueError, KeyError, IndexError, struct.error, RecursionError):
        return False


def _split_key_value(body: bytes) -> tuple[str, str, bytes]:
    """Return type, name and value of information or a parameter."""
    type_name, key = body[1 : 1 + body[0]].decode("ascii").split(" ")
    return type_name, key, body[1 + body[0] :]


def _decode_value(type_name: str, value: bytes) -> Any:
    if type_name.startswith("char["):
        return value.decode(errors="ignore")
    return np.frombuffer(value, _NUMPY_TYPES[type_name])[0].item() if type_name in _NUMPY_TYPES else value


def _add_subscription(scan: _ScanResult, body: bytes) -> None:
    """Process a subscription; KeyError, ValueError if its format is unknown or contradictory."""
    instance, number = struct.unpack_from("<BH", body)
    name = body[_SUBSCRIPTION_NAME_OFFSET:].decode("ascii")
    fields = _expand_fields(scan.formats, name)
    most = 2 + np.dtype(fields).itemsize
    while fields and fields[-1][0].startswith("_padding"):
        fields.pop()
    dtype = np.dtype(fields)
    label = name if instance == 0 else f"{name}:{instance}"
    known = scan.topics.get(label)
    if known is None or known.dtype != dtype:
        stamp_at = dtype.fields["timestamp"][1] if dtype.fields and "timestamp" in dtype.fields else 0
        known = scan.topics[label] = _SubscribedTopic(label, dtype, (2 + dtype.itemsize, most), stamp_at)
    scan.topics_by_id[number] = known
    scan.in_data_section = True


def _expand_fields(
    formats: Mapping[str, list[tuple[str, int, str]]], name: str, prefix: str = ""
) -> list[tuple[str, str]]:
    """Return names and NumPy types of a format's fields, including nested formats; text is one field."""
    out: list[tuple[str, str]] = []
    for type_name, count, field_name in formats[name]:
        whole = prefix + field_name
        names = [f"{whole}[{k}]" for k in range(count)] if count else [whole]
        if type_name == "char" and count:
            out.append((whole, f"S{count}"))
        elif type_name in _NUMPY_TYPES:
            out += [(n, _NUMPY_TYPES[type_name]) for n in names]
        else:
            for n in names:
                out += _expand_fields(formats, type_name, f"{n}.")
        if len(out) > _MAX_FIELDS:
            raise ValueError("too many fields")
    return out


def _unpack_rows(data: bytes, topic: _SubscribedTopic) -> NDArray[Any]:
    """Return all messages of a topic as a structured array."""
    size = topic.dtype.itemsize
    bodies = np.ndarray((len(data) - size + 1,), dtype=f"V{size}", buffer=data, strides=(1,))
    return bodies[np.frombuffer(topic.body_offsets, dtype=np.int64)].view(topic.dtype)


def _decode_text_column(values: NDArray[Any]) -> NDArray[Any]:
    if values.dtype.kind != "S":
        return values
    return np.array([v.split(b"\0")[0].decode(errors="replace") for v in values.tolist()], dtype=str)


def _describe_missing_rows(info: Mapping[str, Any], tables: Mapping[str, RawTable]) -> list[str]:
    """Return a sentence on missing rows, if the file states its number of rows, as those of this package do."""
    try:
        rows = int(info[_ROW_COUNT_KEY])
    except (KeyError, ValueError, TypeError):
        return []
    there = len(tables[TABLE_TOPIC].time) if TABLE_TOPIC in tables else 0
    return [f"{there} of {rows} rows are in the file"] if there < rows else []


# Items with a time other than topics.
_LOG_TEXTS_KEY, _DROPOUTS_KEY = "the vehicle's messages", "the logger's drop-outs"


def _seconds_since_start(
    header: int, stamps: Mapping[str, NDArray[Any]]
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Return all stamps (us) in seconds since the instant 0, NaN for those of a foreign clock, and notes on bad stamps.

    The instant 0 is the header's if data are close to it, else the first stamp of the log's clock; topics whose clock
    stands still (PX4 has some) do not count.
    """
    seconds = {k: s.astype(np.float64) / 1e6 for k, s in stamps.items()}
    if header > 0:
        seconds = {k: np.where(s == 0, np.nan, s) for k, s in seconds.items()}
    unset = {k: int(np.isnan(s).sum()) for k, s in seconds.items()}
    foreign, notes = find_foreign_epoch_stamps(seconds)
    notes += [f"{k}: {n} of {len(stamps[k])} time stamps were never set (0)" for k, n in unset.items() if n]
    known = {k: s[~foreign[k] & np.isfinite(seconds[k])].astype(np.int64) for k, s in stamps.items()}
    running = [s for s in known.values() if len(s) and s[-1] > s[0]] or [s for s in known.values() if len(s)]
    first = min((int(s[0]) for s in running), default=header)
    last = max((int(s[-1]) for s in running), default=header)
    zero = header if first - _MAX_HEADER_TIME_OFFSET_US < header < last + _MAX_HEADER_TIME_OFFSET_US else first
    out = {
        k: np.where(foreign[k] | np.isnan(seconds[k]), np.nan, (s.astype(np.int64) - zero) / 1e6)
        for k, s in stamps.items()
    }
    return out, notes


def _severity_text(number: int) -> str:
    index = number - ord("0") if number >= ord("0") else number
    return _LEVEL_WORDS[index] if 0 <= index < len(_LEVEL_WORDS) else "info"


def _find_start_time(tables: dict[str, RawTable], info: dict[str, Any]) -> str:
    """Return the wall time of the instant 0, from the first position fix or as noted by this package's writer."""
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
            return format_wall_time(at)
    return ""


TEXTS_INFO_KEY, DATASET_INFO_KEY = "mufly_texts", "mufly_dataset"
_ULOG_WRITE_LEVELS = {"error": b"3", "warning": b"4", "info": b"6"}
_MAX_TEXT_LENGTH = 65535
_NAME_PATTERN = re.compile(r"[A-Za-z0-9_]+")


def _encode_message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def _encode_information(key: str, text: str) -> bytes:
    """Encode a text as one information message (I), or as several (M) if it is too long for one."""
    data = text.encode()
    name = f"char[{{}}] {key}"
    room = _MAX_TEXT_LENGTH - 300
    if len(data) <= room:
        head = name.format(len(data)).encode()
        return _encode_message(b"I", bytes([len(head)]) + head + data)
    out = b""
    for at in range(0, len(data), room):
        part = data[at : at + room]
        head = name.format(len(part)).encode()
        out += _encode_message(b"M", bytes([at > 0, len(head)]) + head + part)
    return out


def write_ulog(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as ULog.

    Raises
    ------
    InputError
        If a time is negative (the clock of the format is unsigned), the dataset is too wide for one message, or the
        format does not allow a name.
    """
    columns = split_dataset_into_channels(dataset)
    time = dataset["time"].values.astype(np.float64)
    if len(time) and time[0] < 0:
        raise ArgumentError(
            "start_s", "", f"the log begins at {time[0]:.6g} s, and ULog has no time before 0",
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
        if not _NAME_PATTERN.fullmatch(column.column_name):
            raise InputError(
                str(path), column.column_name, "is not a name for ULog", "use letters, digits and underscores"
            )
        if column.values.dtype.kind in "US":
            known, number = np.unique(column.values, return_inverse=True)
            texts[column.column_name] = known.tolist()
            declared.append(f"uint16_t {column.column_name}")
            layout.append((column.column_name, "<u2"))
            values.append(number)
        else:
            declared.append(f"double {column.column_name}")
            layout.append((column.column_name, "<f8"))
            values.append(column.values)
    format_text = f"{TABLE_TOPIC}:{';'.join(declared)};".encode()
    rows = np.zeros(len(time), dtype=np.dtype(layout))
    if len(format_text) > _MAX_TEXT_LENGTH:  # a row is shorter than its definition
        raise InputError(str(path), "", f"{len(columns)} columns do not fit one ULog message", "choose fewer signals")
    rows["size"], rows["kind"], rows["id"] = rows.itemsize - 3, ord("D"), 0
    rows["stamp"] = np.rint(np.where(np.isfinite(time), time, 0) * 1e6).astype(np.uint64)
    rows["time"] = time
    for column, value in zip(columns, values, strict=True):
        rows[column.column_name] = value
    information = {
        "sys_name": "mufly", "mufly_start_time": str(dataset.attrs.get("start_time", "")),
        _ROW_COUNT_KEY: str(len(time)), TEXTS_INFO_KEY: json.dumps(texts),
        DATASET_INFO_KEY: encode_dataset_metadata(dataset),
    }  # fmt: skip
    head = encode_ulog_file_head(format_text, information)
    said = b"".join(
        _encode_message(
            b"L",
            _ULOG_WRITE_LEVELS.get(e.level, b"6")
            + struct.pack("<Q", max(round(e.time_s * 1e6), 0))
            + _encode_log_text(e.state, e.text),
        )
        for e in (read_events(dataset) if "event_time" in dataset else [])
    )
    path.write_bytes(head + rows.tobytes() + said)


def encode_ulog_file_head(format_text: bytes, information: Mapping[str, str]) -> bytes:
    """Return the beginning of a ULog file with the topic ``table`` as number 0: header, definitions, subscription."""
    head = MAGIC + b"\x01" + struct.pack("<Q", 0) + _encode_message(b"B", bytes(40))
    head += _encode_message(b"F", format_text)
    head += b"".join(_encode_information(key, text) for key, text in information.items())
    return head + _encode_message(b"A", struct.pack("<BH", 0, 0) + TABLE_TOPIC.encode())


def _encode_log_text(state: str, text: str) -> bytes:
    return (f"{state}: {text}" if state else text).encode()[: _MAX_TEXT_LENGTH - 16]
