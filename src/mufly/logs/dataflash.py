"""DataFlash, the log of ArduPilot: the binary ``.bin`` and its text form ``.log``.

Every message is ``0xA3 0x95 type body``; messages of the kind FMT say what the body of each type is, one letter a
field, and FMTU, UNIT and MULT, where present, give units (ardupilot.org, "Understanding and Reading Logs"). pymavlink
finds the messages and reads the formats; the bodies of one type are then unpacked together by NumPy, because one
Python object a message would take minutes for a log of usual size. Times (TimeUS, microseconds since the board
started, or TimeMS) count in seconds from the earliest message.
"""

from __future__ import annotations

import contextlib
import io
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.raw import RawLog, RawTable

__all__ = ["MAGIC", "is_text_log", "read_dataflash"]

MAGIC = b"\xa3\x95"
_DEFINITIONS = ("FMT", "FMTU", "UNIT", "MULT")
# Letter: NumPy type (little-endian), factor that the letter implies.
_LETTERS: dict[str, tuple[str, float]] = {
    "a": ("32<i2", 1.0), "b": ("i1", 1.0), "B": ("u1", 1.0), "g": ("<f2", 1.0), "h": ("<i2", 1.0),
    "H": ("<u2", 1.0), "i": ("<i4", 1.0), "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0),
    "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0), "c": ("<i2", 1e2), "C": ("<u2", 1e2),
    "e": ("<i4", 1e2), "E": ("<u4", 1e2), "L": ("<i4", 1e7), "M": ("u1", 1.0), "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}  # fmt: skip
# GPS time runs ahead of UTC by the leap seconds since 1980; 18 since 2017.
_GPS_EPOCH, _LEAP_S = 315964800.0, 18.0


def is_text_log(head: bytes) -> bool:
    """Whether a file that begins so is the text form."""
    return any(line.startswith((b"FMT,", b"FMT ,")) for line in head.splitlines()[:50])


def read_dataflash(path: str | Path) -> RawLog:
    """Read a DataFlash log, binary or text; one that was cut off is read up to the cut.

    Raises
    ------
    InputError
        If it holds no messages with a time.
    """
    where = str(path)
    with open(path, "rb") as stream:
        text = not stream.read(2).startswith(MAGIC)
    try:
        tables, complete = _read_text(Path(path)) if text else _read_binary(where)
    except InputError:
        raise
    except Exception as error:  # whatever a damaged format definition provokes
        problem = f"is a damaged DataFlash log ({error})"
        raise InputError(where, "", problem, "give another copy of the file") from error
    stamps = [t.time for t in tables if len(t.time)]
    if not stamps:
        raise InputError(
            where, "", "is a DataFlash log without timed messages", "the log ended before its first"
        )
    zero = min(float(s.min()) for s in stamps)
    shifted = {t.name: RawTable(t.name, t.time - zero, t.fields, t.units) for t in tables}
    said = shifted.pop("MSG", None)
    texts = [] if said is None else said.fields.get("Message", np.empty(0)).tolist()
    times = [] if said is None else said.time.tolist()
    parameters = shifted.pop("PARM", None)
    info: dict[str, Any] = {"system": str(texts[0])} if len(texts) else {}
    if parameters is not None and {"Name", "Value"} <= set(parameters.fields):
        names, values = parameters.fields["Name"].tolist(), parameters.fields["Value"].tolist()
        info["parameters"] = dict(zip(names, values, strict=True))
    return RawLog(
        path=where,
        kind="DataFlash",
        tables=shifted,
        start_time=_start_time(shifted),
        info=info,
        messages=tuple((t, "info", str(m)) for t, m in zip(times, texts, strict=False)),
        complete=complete,
    )


def _read_binary(where: str) -> tuple[list[RawTable], bool]:
    from pymavlink.DFReader import DFReader_binary

    with (
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
        contextlib.closing(DFReader_binary(where)) as reader,
    ):
        data = np.frombuffer(bytes(reader.data_map), dtype=np.uint8)
        tables: list[RawTable] = []
        used = 0
        for number, fmt in reader.formats.items():
            starts = np.asarray(reader.offsets[number], dtype=np.int64)
            starts = starts[starts + fmt.len <= len(data)]
            used += fmt.len * len(starts)
            letters = [str(c) for c in fmt.format.split("\0")[0]]
            columns = list(fmt.columns)
            if fmt.name in _DEFINITIONS or not len(starts) or len(columns) != len(letters):
                continue
            dtype = np.dtype([(c, _LETTERS[k][0]) for c, k in zip(columns, letters, strict=True)])
            if dtype.itemsize != fmt.len - 3:
                continue  # a type whose definition does not fit its length cannot be unpacked
            body = np.ascontiguousarray(data[starts[:, None] + np.arange(3, fmt.len)])
            rows = body.view(dtype)[:, 0]
            values = {c: _numbers(rows[c], k) for c, k in zip(columns, letters, strict=True)}
            units = dict(zip(columns, fmt.units, strict=False)) if fmt.units else {}
            tables += _tables(fmt.name, values, units, fmt.instance_field)
    return tables, used >= len(data)


def _numbers(column: NDArray[Any], letter: str) -> NDArray[Any]:
    if column.dtype.kind == "S":
        return np.array([c.split(b"\0")[0].decode(errors="replace") for c in column.tolist()], dtype=str)
    factor = _LETTERS[letter][1]
    return column if factor == 1.0 else column / factor


def _tables(
    name: str, values: dict[str, NDArray[Any]], units: dict[str, str], instance: str | None
) -> list[RawTable]:
    """Split the messages of a type by instance; none without a clock."""
    clock, tick = ("TimeUS", 1e6) if "TimeUS" in values else ("TimeMS", 1e3)
    if clock not in values:
        return []
    time = values[clock].astype(np.float64) / tick
    fields: dict[str, NDArray[Any]] = {}
    for key, value in values.items():
        if key == clock:
            continue
        if value.ndim == 2:  # 32 numbers in one message
            fields |= {f"{key}[{k}]": value[:, k] for k in range(value.shape[1])}
        else:
            fields[key] = value
    known = {k: _unit(u) for k, u in units.items() if k in fields and _unit(u)}
    if instance is None or instance not in fields:
        return [RawTable(name, time, fields, known)]
    which = fields[instance]
    out = []
    for k, one in enumerate(np.unique(which)):
        mine = which == one
        own = {key: value[mine] for key, value in fields.items() if key != instance}
        out.append(RawTable(name if k == 0 else f"{name}:{one}", time[mine], own, known))
    return out


def _unit(label: str) -> str:
    """Unit as this package writes it; ArduPilot's labels run letters together."""
    return {"degrees": "deg", "rad/s/s": "rad/s^2", "m/s/s": "m/s^2", "UNKNOWN": "", "instance": ""}.get(
        label, label
    )


def _read_text(path: Path) -> tuple[list[RawTable], bool]:
    formats: dict[str, tuple[str, list[str]]] = {}
    rows: dict[str, list[list[str]]] = {}
    complete = True
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        name, _, rest = line.partition(",")
        name = name.strip()
        if name == "FMT":
            parts = [p.strip() for p in rest.split(",", 4)]
            if len(parts) == 5:
                formats[parts[2]] = parts[3], [c.strip() for c in parts[4].split(",")]
            continue
        if name not in formats:
            complete = complete and not name
            continue
        columns = formats[name][1]
        cells = [c.strip() for c in rest.split(",", len(columns) - 1)]
        if len(cells) == len(columns):
            rows.setdefault(name, []).append(cells)
        else:
            complete = False
    tables: list[RawTable] = []
    for name, cells_of in rows.items():
        letters, columns = formats[name]
        if name in _DEFINITIONS:
            continue
        values: dict[str, NDArray[Any]] = {}
        for k, (column, letter) in enumerate(zip(columns, letters, strict=False)):
            cells = [row[k] for row in cells_of]
            text = letter in "nNZa"
            values[column] = np.array(cells, dtype=str) if text else np.array([_number(c) for c in cells])
        instance = next((i for i in ("I", "Instance") if i in values), None)
        tables += _tables(name, values, {}, instance)
    return tables, complete


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _start_time(tables: dict[str, RawTable]) -> str:
    gps = tables.get("GPS")
    if gps is None or not {"GWk", "GMS"} <= set(gps.fields):
        return ""
    week, ms = gps.fields["GWk"].astype(np.float64), gps.fields["GMS"].astype(np.float64)
    known = np.flatnonzero(week > 1000)
    if not len(known):
        return ""
    k = known[0]
    at = _GPS_EPOCH + week[k] * 604800 + ms[k] / 1e3 - _LEAP_S - gps.time[k]
    return datetime.fromtimestamp(float(at), UTC).isoformat(timespec="milliseconds")
