"""DataFlash, the log of ArduPilot: the binary ``.bin`` and its text form ``.log``.

Messages of the kind FMT say what those of every other kind hold (ardupilot.org, "Understanding and Reading Logs"); the
text form has the same, a message a line. Times (TimeUS, microseconds since the board started, or TimeMS) count in
seconds from the earliest message.

In the binary form every message is ``0xA3 0x95 kind body``. The bodies of a kind are laid out as its FMT message says,
one letter a field, little-endian and packed; FMTU gives each field a letter for its unit and one for its multiplier,
which UNIT and MULT explain (ArduPilot, libraries/AP_Logger/README.md). The bodies of one kind are unpacked together by
NumPy: one Python object a message takes forty times as long (pymavlink's ``DFReader``: 1.4 s a megabyte, here 0.03 s),
minutes for a log of usual size.

Logs from before 2017 have no units; they are those of the firmware of their time (ArduPilot's history, ArduCopter/Log.*
and libraries/DataFlash, releases 3.1 to 3.4). Battery voltage and current were whole hundredths; the rates of RATE were
hundredths of a degree per second up to ArduCopter 3.3. ``TimeMS`` of a message with a ``Week`` is the GPS receiver's
time of the week, and the board's stands beside it as ``T``. Messages without a clock of the board (MSG, PARM, EV, MODE,
... of that time) have the time of the one that stands before them in the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.topics import RawLog, RawTable, describe_skipped, foreign_stamps, wall_time

MAGIC = b"\xa3\x95"
DEFINITIONS = ("FMT", "FMTU", "UNIT", "MULT")
_FMT, _FMT_LENGTH = 128, 89
# Letter: NumPy type (little-endian), factor that the letter implies.
_LETTERS: dict[str, tuple[str, float]] = {
    "a": ("32<i2", 1.0), "b": ("i1", 1.0), "B": ("u1", 1.0), "g": ("<f2", 1.0), "h": ("<i2", 1.0),
    "H": ("<u2", 1.0), "i": ("<i4", 1.0), "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0),
    "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0), "c": ("<i2", 1e2), "C": ("<u2", 1e2),
    "e": ("<i4", 1e2), "E": ("<u4", 1e2), "L": ("<i4", 1e7), "M": ("u1", 1.0), "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}  # fmt: skip
# Units of fields that say none, by message, field and whether their letter is a whole number's.
_UNITS_OF_OLD = {
    ("CURR", "Volt", True): "cV", ("CURR", "Curr", True): "cA", ("CURR", "Vcc", True): "mV",
    ("CURR", "Volt", False): "V", ("CURR", "Curr", False): "A",
}  # fmt: skip
_RATES_OF_OLD = ("RDes", "R", "PDes", "P", "YDes", "Y")
_FIRMWARE = re.compile(
    r"^(?:APM:\s?|)(?:Ardu)?(Copter|Plane|Rover|Sub|Blimp|AntennaTracker)\b.*?(\d+)\.(\d+)", re.IGNORECASE
)
# Multipliers that are part of a unit's name.
_PREFIXES = {1e3: "k", 1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n"}


@dataclass
class _Kind:
    """A kind of message: its name, size, letters, columns, and where its messages begin."""

    name: str
    size: int
    letters: str
    columns: list[str]
    starts: list[int] = field(default_factory=list)


def _index(data: bytes) -> tuple[dict[int, _Kind], list[tuple[int, int]]]:
    """Find every whole message; where bytes that belong to none begin and end comes beside."""
    kinds = {_FMT: _Kind("FMT", _FMT_LENGTH, "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])}
    at, end = 0, len(data)
    skipped: list[tuple[int, int]] = []
    while at + 3 <= end:
        kind = kinds.get(data[at + 2]) if data[at] == 0xA3 and data[at + 1] == 0x95 else None
        if kind is None or at + kind.size > end:
            found = data.find(MAGIC, at + 1)
            after = end if found < 0 else found
            if skipped and skipped[-1][1] == at:
                skipped[-1] = (skipped[-1][0], after)
            else:
                skipped.append((at, after))
            at = after
            continue
        kind.starts.append(at)
        if data[at + 2] == _FMT:
            _define(kinds, data[at + 3 : at + _FMT_LENGTH])
        at += kind.size
    skipped += [(at, end)] if at < end else []
    begin = skipped[-1][0] if skipped and skipped[-1][1] == end else end
    if begin < end and not any(data[begin - 1 : end]):  # the zeros may have begun inside the message before
        last = max(kinds.values(), key=lambda kind: kind.starts[-1:])
        if last.starts and last.starts[-1] + last.size == begin:
            skipped[-1] = (last.starts.pop(), end)
    return kinds, skipped


def _define(kinds: dict[int, _Kind], body: bytes) -> None:
    number, size = body[0], body[1]
    name, letters, columns = (_text(body[a:b]) for a, b in ((2, 6), (6, 22), (22, 86)))
    names = [c.strip() for c in columns.split(",")]
    sound = len(names) == len(letters) == len(set(names)) and set(letters) <= set(_LETTERS) and all(names)
    if number == _FMT or not sound or size != 3 + _dtype(letters, names).itemsize:
        return  # what contradicts itself cannot be unpacked
    before = kinds.get(number)
    if before is None or (before.letters, before.columns) != (letters, names):
        kinds[number] = _Kind(name, size, letters, names)


def _dtype(letters: str, columns: list[str]) -> np.dtype[Any]:
    return np.dtype([(c, _LETTERS[k][0]) for c, k in zip(columns, letters, strict=True)])


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode(errors="replace")


def read_binary(data: bytes) -> tuple[list[RawTable], str]:
    """Return the tables of a binary log, with times as they were written, and which bytes were not understood."""
    kinds, skipped = _index(data)
    stream = np.frombuffer(data, dtype=np.uint8)
    rows = {}
    for number, kind in kinds.items():
        if kind.starts:
            starts = np.array(kind.starts, dtype=np.int64)
            body = np.ascontiguousarray(stream[starts[:, None] + np.arange(3, kind.size)])
            rows[number] = body.view(_dtype(kind.letters, kind.columns))[:, 0]
    units, instances = _units(kinds, rows)
    messages: list[_Messages] = []
    for number, part in rows.items():
        kind = kinds[number]
        if kind.name not in DEFINITIONS:
            values = {c: _numbers(part[c], k) for c, k in zip(kind.columns, kind.letters, strict=True)}
            places = np.array(kind.starts, dtype=np.int64)
            own = _old_units(kind.name, kind.letters, kind.columns) | units.get(number, {})
            messages.append(_Messages(kind.name, places, values, own, instances.get(number)))
    return _tables(messages), describe_skipped(data, skipped, "message")


class _Messages(NamedTuple):
    """All messages of a kind: where each stands in the file, its fields, their units, which counts instances."""

    name: str
    places: NDArray[np.int64]
    values: dict[str, NDArray[Any]]
    units: dict[str, str]
    instance: str | None


def _old_units(name: str, letters: str, columns: list[str]) -> dict[str, str]:
    found = {
        c: _UNITS_OF_OLD.get((name, c, k in "bBhHiIqQ"), "") for c, k in zip(columns, letters, strict=False)
    }
    if name == "RATE" and "TimeMS" in columns:
        found |= dict.fromkeys(_RATES_OF_OLD, "cdeg/s")
    return {c: u for c, u in found.items() if u}


def _clock(values: Mapping[str, NDArray[Any]]) -> tuple[str, float]:
    """Field that holds the board's clock and its ticks a second; ``""`` if none does."""
    if "TimeUS" in values:
        return "TimeUS", 1e6
    of_gps = "Week" in values or "GWk" in values
    if of_gps:
        return ("T", 1e3) if "T" in values else ("", 1.0)
    return ("TimeMS", 1e3) if "TimeMS" in values else ("", 1.0)


def _tables(messages: list[_Messages]) -> list[RawTable]:
    """Make tables of messages; what has no clock takes the time of the message before it."""
    times: dict[int, NDArray[np.float64]] = {}
    for k, m in enumerate(messages):
        clock, tick = _clock(m.values)
        if clock and m.values[clock].dtype.kind not in "US" and m.values[clock].ndim == 1:
            times[k] = m.values[clock].astype(np.float64) / tick
    if not times:
        return []
    foreign, _ = foreign_stamps({str(k): t for k, t in times.items()})
    sound = {k: np.isfinite(t) & ~foreign[str(k)] for k, t in times.items()}
    place = np.concatenate([messages[k].places[sound[k]] for k in times])
    stamp = np.concatenate([t[sound[k]] for k, t in times.items()])
    order = np.argsort(place, kind="stable")
    place, stamp = place[order], stamp[order]
    out: list[RawTable] = []
    for k, m in enumerate(messages):
        time = times.get(k)
        if time is None:
            time = stamp[np.clip(np.searchsorted(place, m.places) - 1, 0, None)]
        rest = {key: v for key, v in m.values.items() if k not in times or key != _clock(m.values)[0]}
        out += split_tables(m.name, time, rest, m.units, m.instance)
    return out


def _numbers(column: NDArray[Any], letter: str) -> NDArray[Any]:
    if column.dtype.kind == "S":
        return np.array([_text(c) for c in column.tolist()], dtype=str)
    factor = _LETTERS[letter][1]
    return column if factor == 1.0 else column / factor


def _units(
    kinds: dict[int, _Kind], rows: dict[int, NDArray[Any]]
) -> tuple[dict[int, dict[str, str]], dict[int, str]]:
    """Units of the fields of every kind, and the field that counts instances (its unit is ``#``)."""
    named = {kinds[n].name: part for n, part in rows.items() if kinds[n].name in DEFINITIONS}
    labels: dict[str, str] = {}
    factors: dict[str, float] = {}
    if "UNIT" in named and {"Id", "Label"} <= set(named["UNIT"].dtype.names or ()):
        labels = {chr(i & 0xFF): _text(t) for i, t in zip(*_pair(named["UNIT"], "Id", "Label"), strict=True)}
    if "MULT" in named and {"Id", "Mult"} <= set(named["MULT"].dtype.names or ()):
        factors = {
            chr(i & 0xFF): float(f"{m:.6g}") for i, m in zip(*_pair(named["MULT"], "Id", "Mult"), strict=True)
        }
    units: dict[int, dict[str, str]] = {}
    instances: dict[int, str] = {}
    if "FMTU" not in named or not {"FmtType", "UnitIds", "MultIds"} <= set(named["FMTU"].dtype.names or ()):
        return units, instances
    for entry in named["FMTU"]:
        number = int(entry["FmtType"])
        if number not in kinds:
            continue
        kind, out = kinds[number], {}
        ids, multipliers = _text(entry["UnitIds"]), _text(entry["MultIds"]).ljust(len(kind.columns), "-")
        for column, letter, unit, multiplier in zip(
            kind.columns, kind.letters, ids, multipliers, strict=False
        ):
            if unit == "#":
                instances[number] = column
                continue
            factor = 1.0 if _LETTERS[letter][1] != 1.0 else factors.get(multiplier, 1.0) or 1.0
            label = _unit(labels.get(unit, ""))
            if label and (factor == 1.0 or factor in _PREFIXES):
                out[column] = f"{_PREFIXES.get(factor, '')}{label}"
        units[number] = out
    return units, instances


def _pair(part: NDArray[Any], first: str, second: str) -> tuple[list[Any], list[Any]]:
    return part[first].tolist(), part[second].tolist()


def split_tables(
    name: str,
    time: NDArray[np.float64],
    values: dict[str, NDArray[Any]],
    units: dict[str, str],
    instance: str | None,
) -> list[RawTable]:
    """Make tables of the messages of one kind, one an instance.

    The first instance keeps the name of the kind, others are ``name:instance``. Times are in seconds, as written.
    """
    fields: dict[str, NDArray[Any]] = {}
    for key, value in values.items():
        if value.ndim == 2:  # 32 numbers in one message
            fields |= {f"{key}[{k}]": value[:, k] for k in range(value.shape[1])}
        else:
            fields[key] = value
    known = {k: u for k, u in units.items() if k in fields}
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
        tables, damage = _read_text(Path(path)) if text else read_binary(Path(path).read_bytes())
    except InputError:
        raise
    except Exception as error:  # whatever a damaged format definition provokes
        problem = f"is a damaged DataFlash log ({error})"
        raise InputError(where, "", problem, "give another copy of the file") from error
    tables = [t for t in tables if len(t.time)]
    foreign, notes = foreign_stamps({t.name: t.time for t in tables})
    tables = [replace(t, time=np.where(foreign[t.name], np.nan, t.time)) for t in tables]
    zero = min((float(np.nanmin(t.time)) for t in tables if np.isfinite(t.time).any()), default=None)
    if zero is None:
        raise InputError(
            where, "", "is a DataFlash log without timed messages", "the log ended before its first"
        )
    shifted = {t.name: replace(t, time=t.time - zero) for t in tables}
    said = shifted.pop("MSG", None)
    texts = [] if said is None else said.fields.get("Message", np.empty(0)).tolist()
    times = [] if said is None else said.time.tolist()
    parameters = shifted.pop("PARM", None)
    firmware = next((t for t in map(str, texts) if _FIRMWARE.match(t)), "")
    info: dict[str, Any] = {"system": firmware} if firmware else {}
    if parameters is not None and {"Name", "Value"} <= set(parameters.fields):
        names, values = parameters.fields["Name"].tolist(), parameters.fields["Value"].tolist()
        info["parameters"] = dict(zip(names, values, strict=True))
    rate = shifted.get("RATE")
    if rate is not None and "R" in rate.fields:
        unit, why = _unit_of_rates(rate, shifted.get("IMU"), firmware)
        shifted["RATE"] = replace(rate, units=dict.fromkeys(_RATES_OF_OLD, unit) | rate.units)
        notes += [f"RATE is in hundredths of a degree per second{why}"] if unit == "cdeg/s" else []
    if "CURR" in shifted and shifted["CURR"].units.get("Volt") == "cV":
        notes.append("voltage and current of CURR are whole hundredths, as ArduPilot wrote them up to 2016")
    return RawLog(
        path=where,
        kind="DataFlash",
        tables=shifted,
        start_time=_start_time(shifted),
        info=info,
        messages=tuple((t, "info", str(m)) for t, m in zip(times, texts, strict=False)),
        complete=not damage,
        notes=tuple(notes),
        damage=damage,
    )


def _unit_of_rates(rate: RawTable, gyro: RawTable | None, firmware: str) -> tuple[str, str]:
    """Unit of RATE and why: the file's or its time's, that of the firmware's version, or what the gyroscope says."""
    if "R" in rate.units:
        return rate.units["R"], ""
    match = _FIRMWARE.match(firmware)
    if match is not None and match[1].lower() == "copter":
        old = (int(match[2]), int(match[3])) < (3, 4)
        return ("cdeg/s", f", as {firmware.split('(')[0].strip()} wrote it") if old else ("deg/s", "")
    body = ("GyrX", "GyrY", "GyrZ")
    if gyro is not None and set(body) <= set(gyro.fields) and set("RPY") <= set(rate.fields):
        size = [
            float(np.sqrt(np.nanmean([np.nanmean(t.fields[k].astype(np.float64) ** 2) for k in names])))
            for t, names in ((rate, "RPY"), (gyro, body))
        ]
        # One motion: the ratio is 57.3 in degrees and 5730 in hundredths; their geometric mean parts them.
        if size[1] > 0 and size[0] / size[1] > 573:
            return "cdeg/s", ": it says a hundred times what the gyroscope in IMU does"
    return "deg/s", ""


def _read_text(path: Path) -> tuple[list[RawTable], str]:
    formats: dict[str, tuple[str, list[str]]] = {}
    rows: dict[str, list[tuple[int, list[str]]]] = {}
    bad: list[int] = []
    for place, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines()):
        name, _, rest = line.partition(",")
        name = name.strip()
        if name == "FMT":
            parts = [p.strip() for p in rest.split(",", 4)]
            if len(parts) == 5:
                formats[parts[2]] = parts[3], [c.strip() for c in parts[4].split(",")]
            continue
        if name not in formats:
            bad += [place + 1] if name else []
            continue
        columns = formats[name][1]
        cells = [c.strip() for c in rest.split(",", len(columns) - 1)]
        if len(cells) == len(columns):
            rows.setdefault(name, []).append((place, cells))
        else:
            bad.append(place + 1)
    messages: list[_Messages] = []
    for name, lines in rows.items():
        letters, columns = formats[name]
        if name in DEFINITIONS:
            continue
        values: dict[str, NDArray[Any]] = {}
        for k, (column, letter) in enumerate(zip(columns, letters, strict=False)):
            cells = [row[k] for _, row in lines]
            text = letter in "nNZa"
            values[column] = np.array(cells, dtype=str) if text else np.array([_number(c) for c in cells])
        instance = next((i for i in ("I", "Instance") if i in values), None)
        places = np.array([place for place, _ in lines], dtype=np.int64)
        messages.append(_Messages(name, places, values, _old_units(name, letters, columns), instance))
    first = (
        f"line {bad[0]}" if len(bad) == 1 else f"{len(bad)} lines, the first line {bad[0]}," if bad else ""
    )
    return _tables(messages), f"{first} {'is' if len(bad) == 1 else 'are'} no whole message" if bad else ""


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _start_time(tables: dict[str, RawTable]) -> str:
    gps = tables.get("GPS")
    names = next((n for n in (("GWk", "GMS"), ("Week", "TimeMS")) if gps and set(n) <= set(gps.fields)), None)
    if gps is None or names is None:
        return ""
    week, ms = (gps.fields[n].astype(np.float64) for n in names)
    known = np.flatnonzero((week > 1000) & np.isfinite(gps.time))
    if not len(known):
        return ""
    k = known[0]
    at = _GPS_EPOCH + week[k] * 604800 + ms[k] / 1e3 - _LEAP_S - gps.time[k]
    return wall_time(float(at))
