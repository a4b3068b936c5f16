"""Reader of logs of a Crazyflie's micro-SD deck, in both formats of its firmware.

Format since 2020, by events (bitcraze.io, "Micro SD card deck", and the firmware's decoder, tools/usdlog):

* The file begins with the byte 0xBC, the version (u16: 1 or 2) and the number of kinds of events (u16).
* Each kind has its number (u16), its name, its number of variables (u16), and their names with a letter for the type,
  ``acc.x(f)``. Each text ends with a zero byte.
* Events follow, each ``kind (u16), time, values``; time in milliseconds (u32) in version 1 and in microseconds (u64) in
  version 2.
* The last four bytes are the CRC-32 of all bytes before them.

Format before 2020, rows of fixed rate: the number of columns (u8), their names ``tick(I),acc.x(f),...``, each ended by
a comma; then blocks of ``number of rows (u8), rows``, with ticks in milliseconds. Names and blocks are each followed by
a complemented CRC-32. All numbers are little-endian and packed.

A removed card or an empty battery leaves a truncated file, which is read up to its end. Reading ends at an event of an
unknown kind or a block with a wrong CRC, because no mark identifies the next one. It also ends at two successive events
with impossible times; a single such event (a flipped bit) is skipped.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.raw_log import RawLog, RawTable, describe_skipped_bytes

FIXED_RATE_TOPIC = "fixedFrequency"
"""Topic of variables logged at a fixed rate, as named by the firmware."""

_EVENT_FORMAT_BYTE = 0xBC
_TICK_COLUMN = b"tick(I),"
_CRC_SIZE = 4
_NUMPY_TYPES = {
    "B": "u1", "b": "i1", "H": "<u2", "h": "<i2", "I": "<u4", "i": "<i4", "Q": "<u8", "q": "<i8", "e": "<f2",
    "f": "<f4", "d": "<f8",
}  # fmt: skip
_MAX_CLOCK_STEP_BACK_S, _MAX_CLOCK_STEP_AHEAD_S = 1.0, 3600.0  # largest time steps between events in a damaged file
_CLOCK_BY_VERSION = {1: ("<u4", 1e3), 2: ("<u8", 1e6)}
# Units of variables from the firmware documentation; angles in degrees, accelerations in g.
_UNITS_BY_VARIABLE = {
    "gyro": "deg/s", "acc": "gee", "stateEstimate.roll": "deg", "stateEstimate.pitch": "deg",
    "stateEstimate.yaw": "deg", "stateEstimate.x": "m", "stateEstimate.y": "m", "stateEstimate.z": "m",
    "stateEstimate.vx": "m/s", "stateEstimate.vy": "m/s", "stateEstimate.vz": "m/s", "stabilizer.roll": "deg",
    "stabilizer.pitch": "deg", "stabilizer.yaw": "deg", "ctrltarget.roll": "deg", "ctrltarget.pitch": "deg",
    "ctrltarget.x": "m", "ctrltarget.y": "m", "ctrltarget.z": "m", "baro.asl": "m", "baro.temp": "degC",
    "baro.pressure": "mbar", "mag": "gauss", "pm.vbat": "V", "pm.vbatMV": "mV", "range": "mm",
}  # fmt: skip


def looks_like_crazyflie(head: bytes) -> bool:
    """Return whether a file with these first bytes is a Crazyflie log of either format."""
    if head[1 : 1 + len(_TICK_COLUMN)] == _TICK_COLUMN:
        return True
    if len(head) < 7 or head[0] != _EVENT_FORMAT_BYTE:
        return False
    version, kinds = struct.unpack_from("<HH", head, 1)
    return version in _CLOCK_BY_VERSION and 0 < kinds < 256


class _EventKind(NamedTuple):
    """Kind of event in a Crazyflie log: its name, layout of time and values, and offsets of its events in the file."""

    name: str
    row_dtype: np.dtype[Any]
    row_offsets: list[int]


def read_crazyflie(path: str | Path) -> RawLog:
    """Read a log of the micro-SD deck; a truncated log is read up to its end.

    Raises
    ------
    InputError
        If its list of variables is damaged or no row follows it.
    """
    where = str(path)
    data = Path(path).read_bytes()
    try:
        tables, skipped, ended = (_read_event_log if data[0] == _EVENT_FORMAT_BYTE else _read_row_log)(data)
    except (struct.error, ValueError, IndexError, KeyError) as error:
        problem = f"is a damaged log of the micro-SD deck ({error})"
        raise InputError(where, "", problem, "give another copy of the file") from error
    if not tables:
        raise InputError(
            where,
            "",
            "is a log of the micro-SD deck without data",
            "set the Crazyflie's parameter usd.logging to 1 in flight",
        )
    zero = min(float(t.time.min()) for t in tables)
    shifted = {t.name: RawTable(t.name, t.time - zero, t.fields, t.units) for t in tables}
    damage = describe_skipped_bytes(data, skipped, "event")
    damage = damage or ("" if ended else "its checksum at the end is missing or wrong")
    return RawLog(where, "Crazyflie", shifted, info={"system": "Crazyflie"}, is_complete=not damage, damage_text=damage)


def _read_event_log(data: bytes) -> tuple[list[RawTable], list[tuple[int, int]], bool]:
    version, count = struct.unpack_from("<HH", data, 1)
    clock, tick = _CLOCK_BY_VERSION[version]
    whole = len(data) > 9 and crc32(data[:-_CRC_SIZE]) == struct.unpack("<I", data[-_CRC_SIZE:])[0]
    end = len(data) - _CRC_SIZE if whole else len(data)
    at = 5
    kinds: dict[int, _EventKind] = {}
    for _ in range(count):
        number = struct.unpack_from("<H", data, at)[0]
        name, at = _read_string(data, at + 2)
        columns = struct.unpack_from("<H", data, at)[0]
        at += 2
        fields = [("", clock)]
        for _ in range(columns):
            column, at = _read_string(data, at)
            fields.append(_parse_variable(column))
        kinds[number] = _EventKind(name, _row_dtype(fields), [])
    # A truncated file may end with a broken event, and a flipped bit may break the CRC.
    last, width = -1, np.dtype(clock).itemsize
    skipped: list[tuple[int, int]] = []

    def identify_event_at(place: int, after: int) -> tuple[_EventKind, int] | None:
        """Return kind and time (ticks) of the event at byte ``place``; None if no plausible one is there."""
        kind = kinds.get(data[place] | data[place + 1] << 8) if place + 2 <= end else None
        if kind is None or place + 2 + kind.row_dtype.itemsize > end:
            return None
        if not whole and after >= 0 and not any(data[place : place + 2 + kind.row_dtype.itemsize]):
            return None  # zeros of unwritten memory
        now = int.from_bytes(data[place + 2 : place + 2 + width], "little")
        near = whole or after < 0 or -_MAX_CLOCK_STEP_BACK_S * tick <= now - after <= _MAX_CLOCK_STEP_AHEAD_S * tick
        return (kind, now) if near else None

    while at + 2 <= end:
        found = identify_event_at(at, last)
        if found is None:  # without marks, two successive valid events identify the next position
            start = at
            while at + 2 <= end:
                at += 1
                found = identify_event_at(at, last)
                if found is None or found[1] < last:
                    continue
                if identify_event_at(at + 2 + found[0].row_dtype.itemsize, found[1]) is not None:
                    break
            else:
                skipped.append((start, end))
                break
            skipped.append((start, at))
        kind, last = found
        kind.row_offsets.append(at + 2)
        at += 2 + kind.row_dtype.itemsize
    else:
        skipped += [(at, end)] if at < end else []
    begin = skipped[-1][0] if skipped and skipped[-1][1] == end else end
    if begin < end and not any(data[begin - 1 : end]):  # the zeros may have begun inside the previous event
        latest = max(kinds.values(), key=lambda k: k.row_offsets[-1:])
        if latest.row_offsets and latest.row_offsets[-1] + latest.row_dtype.itemsize == begin:
            skipped[-1] = (latest.row_offsets.pop() - 2, end)
    return [_make_table(data, k, tick) for k in kinds.values() if k.row_offsets], skipped, whole


def _read_row_log(data: bytes) -> tuple[list[RawTable], list[tuple[int, int]], bool]:
    at = 1
    fields = []
    for _ in range(data[0]):
        end = data.index(b",", at)
        fields.append(_parse_variable(data[at:end].decode()))
        at = end + 1
    skipped = [] if _crc_matches(data[: at + _CRC_SIZE]) else [(0, at + _CRC_SIZE)]
    at += _CRC_SIZE
    kind = _EventKind(FIXED_RATE_TOPIC, _row_dtype(fields), [])
    size = kind.row_dtype.itemsize
    while at < len(data):
        start = at
        while at < len(data) and not _crc_matches(data[at : at + 1 + data[at] * size + _CRC_SIZE]):
            at += 1  # the next block is found by its checksum
        if at > start:
            skipped.append((start, at))
        if at < len(data):
            kind.row_offsets.extend(range(at + 1, at + 1 + data[at] * size, size))
            at += 1 + data[at] * size + _CRC_SIZE
    return [_make_table(data, kind, 1e3)] if kind.row_offsets else [], skipped, True


def _crc_matches(block: bytes) -> bool:
    """Return whether the CRC at the end of a block is correct.

    The CRC is stored complemented, so that the CRC of the whole block is all ones.
    """
    return crc32(block) == 0xFFFFFFFF


def _read_string(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def _parse_variable(column: str) -> tuple[str, str]:
    """Return name and type of a variable such as ``acc.x(f)``."""
    name, _, letter = column.strip().removesuffix(")").rpartition("(")
    if not name or letter not in _NUMPY_TYPES:
        raise ValueError(f"variable {column!r:.40}")
    return name, _NUMPY_TYPES[letter]


def _row_dtype(fields: list[tuple[str, str]]) -> np.dtype[Any]:
    """Return the layout of a row; the clock comes first and has no name."""
    names = ["", *(name for name, _ in fields[1:])]
    if len(set(names)) < len(names):
        raise ValueError("a variable occurs twice")
    return np.dtype([(name or "clock", kind) for name, (_, kind) in zip(names, fields, strict=True)])


def _make_table(data: bytes, kind: _EventKind, tick: float) -> RawTable:
    stream = np.frombuffer(data, dtype=np.uint8)
    starts = np.array(kind.row_offsets, dtype=np.int64)
    block = np.ascontiguousarray(stream[starts[:, None] + np.arange(kind.row_dtype.itemsize)])
    rows: NDArray[Any] = block.view(kind.row_dtype)[:, 0]
    clock, *names = kind.row_dtype.names or ()
    fields = {name: rows[name] for name in names}
    units = {name: _UNITS_BY_VARIABLE.get(name) or _UNITS_BY_VARIABLE.get(name.partition(".")[0], "") for name in names}
    return RawTable(kind.name, rows[clock] / tick, fields, {k: u for k, u in units.items() if u})
