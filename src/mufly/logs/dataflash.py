"""Reader of ArduPilot's DataFlash logs: the binary form ``.bin`` and the text form ``.log``.

FMT messages describe the layout of all other kinds of messages (ardupilot.org, "Understanding and Reading Logs"); the
text form has the same content, one message on each line. Times (TimeUS, microseconds since the start of the board, or
TimeMS) are converted to seconds since the earliest message.

In the binary form every message is ``0xA3 0x95 kind body``. The FMT message of a kind describes its bodies with one
letter a field, little-endian and packed. FMTU gives each field a letter for its unit and one for its multiplier, which
UNIT and MULT explain (ArduPilot, libraries/AP_Logger/README.md). The bodies of one kind are unpacked together by NumPy:
0.03 s a megabyte, against 1.4 s for one Python object a message (pymavlink's ``DFReader``).

Logs from before 2017 have no units; the units are those of the firmware of that time (ArduPilot's history,
ArduCopter/Log.* and libraries/DataFlash, releases 3.1 to 3.4). Battery voltage and current were whole hundredths; the
rates of RATE were hundredths of a degree per second up to ArduCopter 3.3. In a message with a ``Week``, ``TimeMS`` is
the GPS time of the week, and ``T`` is the time of the board. Messages without a clock of the board (MSG, PARM, EV,
MODE, ... of that time) get the time of the previous message.
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
from mufly.logs.raw_log import (
    RawLog,
    RawTable,
    describe_skipped_bytes,
    find_foreign_epoch_stamps,
    format_wall_time,
    gps_to_unix,
)
from mufly.vehicle_types import ModeFamily, ardupilot_mode_name

MAGIC = b"\xa3\x95"
DEFINITION_MESSAGES = ("FMT", "FMTU", "UNIT", "MULT")
_FMT_MESSAGE_TYPE, _FMT_LENGTH, _MESSAGE_HEAD_BYTES = 128, 89, 3
# Letter: NumPy type (little-endian), factor that the letter implies.
_FORMAT_LETTERS: dict[str, tuple[str, float]] = {
    "a": ("32<i2", 1.0), "b": ("i1", 1.0), "B": ("u1", 1.0), "g": ("<f2", 1.0), "h": ("<i2", 1.0),
    "H": ("<u2", 1.0), "i": ("<i4", 1.0), "I": ("<u4", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0),
    "n": ("S4", 1.0), "N": ("S16", 1.0), "Z": ("S64", 1.0), "c": ("<i2", 1e2), "C": ("<u2", 1e2),
    "e": ("<i4", 1e2), "E": ("<u4", 1e2), "L": ("<i4", 1e7), "M": ("u1", 1.0), "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}  # fmt: skip
# Units of fields without stated unit, by message, field and whether the letter is that of an integer.
_UNITS_OF_OLD_LOGS = {
    ("CURR", "Volt", True): "cV", ("CURR", "Curr", True): "cA", ("CURR", "Vcc", True): "mV",
    ("CURR", "Volt", False): "V", ("CURR", "Curr", False): "A",
}  # fmt: skip
_RATE_FIELDS_OF_OLD_LOGS = ("RDes", "R", "PDes", "P", "YDes", "Y")
_FIRMWARE_PATTERN = re.compile(
    r"^(?:APM:\s?|)(?:Ardu)?(Copter|Plane|Rover|Sub|Blimp|AntennaTracker)\b.*?(\d+)\.(\d+)", re.IGNORECASE
)
# An integer "I" is an instance; in messages of PID controllers "I" is the integral part.
_ESTIMATOR_PREFIX_LENGTH = 3  # of an estimator's message, before its number: NKF1, XKF4
_INSTANCE_FIELDS = ("I", "Instance", "Inst")
_FAMILY_BY_FIRMWARE: dict[str, ModeFamily] = {
    "copter": "copter", "plane": "plane", "rover": "rover", "sub": "submarine", "antennatracker": "tracker",
    "blimp": "airship",
}  # fmt: skip
_FAMILY_BY_BUILD_TYPE: dict[int, ModeFamily] = {
    1: "rover", 2: "copter", 3: "plane", 4: "tracker", 7: "submarine", 12: "airship", 13: "copter",
}  # fmt: skip
# Multipliers that are part of a unit's name.
_UNIT_PREFIXES = {1e3: "k", 1e-1: "d", 1e-2: "c", 1e-3: "m", 1e-6: "u", 1e-9: "n"}


@dataclass
class _MessageKind:
    """Kind of message: name, size, format letters, columns, and offsets of its messages."""

    name: str
    message_size: int
    format_letters: str
    columns: list[str]
    message_offsets: list[int] = field(default_factory=list)


def _index_messages(data: bytes) -> tuple[dict[int, _MessageKind], list[tuple[int, int]]]:
    """Return all complete messages by kind, and the byte ranges that belong to no message."""
    kinds = {
        _FMT_MESSAGE_TYPE: _MessageKind("FMT", _FMT_LENGTH, "BBnNZ", ["Type", "Length", "Name", "Format", "Columns"])
    }
    at, end = 0, len(data)
    skipped: list[tuple[int, int]] = []
    while at + 3 <= end:
        kind = kinds.get(data[at + 2]) if data[at] == 0xA3 and data[at + 1] == 0x95 else None
        if kind is None or at + kind.message_size > end:
            found = data.find(MAGIC, at + 1)
            after = end if found < 0 else found
            if skipped and skipped[-1][1] == at:
                skipped[-1] = (skipped[-1][0], after)
            else:
                skipped.append((at, after))
            at = after
            continue
        kind.message_offsets.append(at)
        if data[at + 2] == _FMT_MESSAGE_TYPE:
            _add_format(kinds, data[at + _MESSAGE_HEAD_BYTES : at + _FMT_LENGTH])
        at += kind.message_size
    skipped += [(at, end)] if at < end else []
    begin = skipped[-1][0] if skipped and skipped[-1][1] == end else end
    if begin < end and not any(data[begin - 1 : end]):  # the zeros may have begun inside the previous message
        last = max(kinds.values(), key=lambda kind: kind.message_offsets[-1:])
        if last.message_offsets and last.message_offsets[-1] + last.message_size == begin:
            skipped[-1] = (last.message_offsets.pop(), end)
    return kinds, skipped


def _add_format(kinds: dict[int, _MessageKind], body: bytes) -> None:
    number, size = body[0], body[1]
    name, letters, columns = (_decode_text(body[a:b]) for a, b in ((2, 6), (6, 22), (22, 86)))
    names = [c.strip() for c in columns.split(",")]
    sound = len(names) == len(letters) == len(set(names)) and set(letters) <= set(_FORMAT_LETTERS) and all(names)
    if number == _FMT_MESSAGE_TYPE or not sound or size != 3 + _message_dtype(letters, names).itemsize:
        return  # a contradictory format cannot be unpacked
    before = kinds.get(number)
    if before is None or (before.format_letters, before.columns) != (letters, names):
        kinds[number] = _MessageKind(name, size, letters, names)


def _message_dtype(letters: str, columns: list[str]) -> np.dtype[Any]:
    return np.dtype([(c, _FORMAT_LETTERS[k][0]) for c, k in zip(columns, letters, strict=True)])


def _decode_text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode(errors="replace")


def read_binary_dataflash(data: bytes) -> tuple[list[RawTable], _InstanceTopics, str]:
    """Read a binary DataFlash log; return its tables, their names by message type and instance, and a text on damage.

    The times are unchanged.
    """
    kinds, skipped = _index_messages(data)
    stream = np.frombuffer(data, dtype=np.uint8)
    rows = {}
    for number, kind in kinds.items():
        if kind.message_offsets:
            starts = np.array(kind.message_offsets, dtype=np.int64)
            body = np.ascontiguousarray(stream[starts[:, None] + np.arange(3, kind.message_size)])
            rows[number] = body.view(_message_dtype(kind.format_letters, kind.columns))[:, 0]
    named = {kinds[n].name: part for n, part in rows.items() if kinds[n].name in DEFINITION_MESSAGES}
    units, instances = _field_units(kinds, {name: _records_to_dicts(part) for name, part in named.items()})
    messages: list[_MessageTable] = []
    for number, part in rows.items():
        kind = kinds[number]
        if kind.name not in DEFINITION_MESSAGES:
            values = {c: _to_numbers(part[c], k) for c, k in zip(kind.columns, kind.format_letters, strict=True)}
            places = np.array(kind.message_offsets, dtype=np.int64)
            own = _units_of_old_log(kind.name, kind.format_letters, kind.columns) | units.get(number, {})
            instance = instances.get(number) or _guess_instance_field(kind)
            messages.append(_MessageTable(kind.name, places, values, own, instance))
    return *_make_tables(messages), describe_skipped_bytes(data, skipped, "message")


def _guess_instance_field(kind: _MessageKind) -> str | None:
    """Return the instance field by its name, for logs that do not mark it with the unit ``#``."""
    whole = {c for c, letter in zip(kind.columns, kind.format_letters, strict=False) if letter in "bBhHiI"}
    names = ("C", *_INSTANCE_FIELDS) if kind.name.startswith(("NK", "XK")) else _INSTANCE_FIELDS
    return next((name for name in names if name in whole), None)


class _MessageTable(NamedTuple):
    """All messages of one type: positions in the file, fields, units, and the field with the instance number."""

    name: str
    file_positions: NDArray[np.int64]
    values: dict[str, NDArray[Any]]
    units: dict[str, str]
    instance_field: str | None


def _units_of_old_log(name: str, letters: str, columns: list[str]) -> dict[str, str]:
    found = {c: _UNITS_OF_OLD_LOGS.get((name, c, k in "bBhHiIqQ"), "") for c, k in zip(columns, letters, strict=False)}
    if name == "RATE" and "TimeMS" in columns:
        found |= dict.fromkeys(_RATE_FIELDS_OF_OLD_LOGS, "cdeg/s")
    return {c: u for c, u in found.items() if u}


def _find_clock(values: Mapping[str, NDArray[Any]]) -> tuple[str, float]:
    """Return the field of the board's clock and its ticks per second; ``""`` without one."""
    if "TimeUS" in values:
        return "TimeUS", 1e6
    of_gps = "Week" in values or "GWk" in values
    if of_gps:
        return ("T", 1e3) if "T" in values else ("", 1.0)
    return ("TimeMS", 1e3) if "TimeMS" in values else ("", 1.0)


_InstanceTopics = dict[str, dict[int, str]]  # topic of each instance, by kind of message


def _make_tables(messages: list[_MessageTable]) -> tuple[list[RawTable], _InstanceTopics]:
    """Create tables of messages; a message without clock gets the time of the previous message."""
    times: dict[int, NDArray[np.float64]] = {}
    for k, m in enumerate(messages):
        clock, tick = _find_clock(m.values)
        if clock and m.values[clock].dtype.kind not in "US" and m.values[clock].ndim == 1:
            times[k] = m.values[clock].astype(np.float64) / tick
    if not times:
        return [], {}
    foreign, _ = find_foreign_epoch_stamps({str(k): t for k, t in times.items()})
    sound = {k: np.isfinite(t) & ~foreign[str(k)] for k, t in times.items()}
    place = np.concatenate([messages[k].file_positions[sound[k]] for k in times])
    stamp = np.concatenate([t[sound[k]] for k, t in times.items()])
    order = np.argsort(place, kind="stable")
    place, stamp = place[order], stamp[order]
    out: list[RawTable] = []
    topics: _InstanceTopics = {}
    for k, m in enumerate(messages):
        time = times.get(k)
        if time is None:
            time = stamp[np.clip(np.searchsorted(place, m.file_positions) - 1, 0, None)]
        rest = {key: v for key, v in m.values.items() if k not in times or key != _find_clock(m.values)[0]}
        parts = split_by_instance(m.name, time, rest, m.units, m.instance_field)
        if m.instance_field in rest:
            which = rest[m.instance_field]
            numbers = np.unique(which[np.isfinite(which)]).astype(int).tolist()
            topics[m.name] = {n: part.name for n, part in zip(numbers, parts, strict=True)}
        out += parts
    return out, topics


def _to_numbers(column: NDArray[Any], letter: str) -> NDArray[Any]:
    if column.dtype.kind == "S":
        return np.array([_decode_text(c) for c in column.tolist()], dtype=str)
    factor = _FORMAT_LETTERS[letter][1]
    return column if factor == 1.0 else column / factor


def _records_to_dicts(part: NDArray[Any]) -> list[dict[str, Any]]:
    names = part.dtype.names or ()
    return [
        {n: _decode_text(v) if isinstance(v, bytes) else v for n, v in zip(names, row, strict=True)}
        for row in part.tolist()
    ]


def _field_units(
    kinds: Mapping[int, _MessageKind], named: Mapping[str, list[dict[str, Any]]]
) -> tuple[dict[int, dict[str, str]], dict[int, str]]:
    """Return the units of every message kind's fields, and each kind's instance field (marked by the unit ``#``)."""

    def definition_pairs(name: str, key: str, value: str) -> list[tuple[str, Any]]:
        return [(_unit_letter(row[key]), row[value]) for row in named.get(name, ()) if {key, value} <= set(row)]

    labels = {i: str(label) for i, label in definition_pairs("UNIT", "Id", "Label")}
    factors = {i: float(f"{float(m):.6g}") for i, m in definition_pairs("MULT", "Id", "Mult")}
    units: dict[int, dict[str, str]] = {}
    instances: dict[int, str] = {}
    for entry in named.get("FMTU", ()):
        if not {"FmtType", "UnitIds", "MultIds"} <= set(entry):
            continue
        number = int(entry["FmtType"])
        if number not in kinds:
            continue
        kind, out = kinds[number], {}
        ids, multipliers = entry["UnitIds"], entry["MultIds"].ljust(len(kind.columns), "-")
        for column, letter, unit, multiplier in zip(kind.columns, kind.format_letters, ids, multipliers, strict=False):
            if unit == "#":
                instances[number] = column
                continue
            factor = 1.0 if _FORMAT_LETTERS[letter][1] != 1.0 else factors.get(multiplier, 1.0) or 1.0
            label = _normalise_unit(labels.get(unit, ""))
            if label and (factor == 1.0 or factor in _UNIT_PREFIXES):
                out[column] = f"{_UNIT_PREFIXES.get(factor, '')}{label}"
        units[number] = out
    return units, instances


def _unit_letter(value: Any) -> str:
    """Return the letter that identifies a unit or multiplier; some logs store its character code instead."""
    text = str(value)
    return chr(int(text) & 0xFF) if len(text) > 1 and text.lstrip("-").isdigit() else text


def split_by_instance(
    name: str,
    time: NDArray[np.float64],
    values: dict[str, NDArray[Any]],
    units: dict[str, str],
    instance: str | None,
) -> list[RawTable]:
    """Return the messages of one type as tables, one for each instance (such as each battery).

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
    for k, one in enumerate(np.unique(which[np.isfinite(which)])):
        mine = which == one
        own = {key: value[mine] for key, value in fields.items() if key != instance}
        out.append(RawTable(name if k == 0 else f"{name}:{one:g}", time[mine], own, known))
    return out


def _normalise_unit(label: str) -> str:
    """Return the unit in the notation of this package; ArduPilot's labels omit separators."""
    return {"degrees": "deg", "rad/s/s": "rad/s^2", "m/s/s": "m/s^2", "UNKNOWN": "", "instance": ""}.get(label, label)


def is_text_log(head: bytes) -> bool:
    """Return whether a file with these first bytes is a DataFlash log in text form."""
    return any(line.startswith((b"FMT,", b"FMT ,")) for line in head.splitlines()[:50])


def read_dataflash(path: str | Path) -> RawLog:
    """Read a DataFlash log, binary or text; a truncated log is read up to its end.

    Raises
    ------
    InputError
        If it holds no messages with a time.
    """
    where = str(path)
    with open(path, "rb") as stream:
        text = not stream.read(2).startswith(MAGIC)
    try:
        tables, topics, damage = _read_text_log(Path(path)) if text else read_binary_dataflash(Path(path).read_bytes())
    except InputError:
        raise
    except Exception as error:  # any error of a damaged format definition
        problem = f"is a damaged DataFlash log ({error})"
        raise InputError(where, "", problem, "give another copy of the file") from error
    tables = [t for t in tables if len(t.time)]
    foreign, notes = find_foreign_epoch_stamps({t.name: t.time for t in tables})
    tables = [replace(t, time=np.where(foreign[t.name], np.nan, t.time)) for t in tables]
    zero = min((float(np.nanmin(t.time)) for t in tables if np.isfinite(t.time).any()), default=None)
    if zero is None:
        raise InputError(where, "", "is a DataFlash log without timed messages", "the log ended before its first")
    shifted = {t.name: replace(t, time=t.time - zero) for t in tables}
    said = shifted.pop("MSG", None)
    texts = [] if said is None else said.fields.get("Message", np.empty(0)).tolist()
    times = [] if said is None else said.time.tolist()
    parameters = shifted.pop("PARM", None)
    firmware = next((t for t in map(str, texts) if _FIRMWARE_PATTERN.match(t)), "")
    info: dict[str, Any] = {"system": firmware} if firmware else {}
    if parameters is not None and {"Name", "Value"} <= set(parameters.fields):
        names, values = parameters.fields["Name"].tolist(), parameters.fields["Value"].tolist()
        info["parameters"] = dict(zip(names, values, strict=True))
    rate = shifted.get("RATE")
    if rate is not None and "R" in rate.fields:
        unit, why = _find_rate_unit(rate, shifted.get("IMU"), firmware)
        shifted["RATE"] = replace(rate, units=dict.fromkeys(_RATE_FIELDS_OF_OLD_LOGS, unit) | rate.units)
        notes += [f"RATE is in hundredths of a degree per second{why}"] if unit == "cdeg/s" else []
    active, words = _make_active_estimate_table(shifted, topics, parameters)
    notes += words
    shifted |= {active.name: active} if active is not None else {}
    if "MODE" in shifted:
        shifted["MODE"] = _name_flight_modes(shifted["MODE"], _firmware_family(firmware, shifted.get("VER")))
    if "CURR" in shifted and shifted["CURR"].units.get("Volt") == "cV":
        notes.append("voltage and current of CURR are whole hundredths, as ArduPilot wrote them up to 2016")
    return RawLog(
        path=where,
        format_name="DataFlash",
        tables_by_topic=shifted,
        start_time=_start_time(shifted),
        info=info,
        messages=tuple((t, "info", str(m)) for t, m in zip(times, texts, strict=False)),
        is_complete=not damage,
        notes=tuple(notes),
        damage_text=damage,
    )


ACTIVE_ESTIMATE_TOPIC = "EKF:active"  # position and velocity of the active estimator and lane
_MOTION_FIELDS = ("PN", "PE", "PD", "VN", "VE", "VD")
# EKFType of ArduPilot's AP_AHRS: name, message with position and velocity, message with the primary core.
_ESTIMATOR_MESSAGES = {
    0: ("DCM", "", ""), 1: ("EKF1", "EKF1", ""), 2: ("EKF2", "NKF1", "NKF4"), 3: ("EKF3", "XKF1", "XKF4"),
    10: ("the simulator", "SIM2", ""), 11: ("the external AHRS", "EAHR", ""),
}  # fmt: skip
# Before 2020 cores 1 and 2 had their own messages: NKF6 and NKF11 are those of NKF1, NKF9 and NKF14 of NKF4.
_MESSAGES_PER_CORE, _MAX_LISTED_CHANGES = 5, 6


def _make_active_estimate_table(
    tables: Mapping[str, RawTable], topics: _InstanceTopics, parameters: RawTable | None
) -> tuple[RawTable | None, list[str]]:
    """Return position and velocity of the estimator core active at each time (None if always the first), and notes.

    The estimator is that of ATT.AEKF, else of the parameter AHRS_EKF_TYPE, else the newest in the log; its core is
    XKF4.PI (NKF4.PI). Samples without local position (DCM, an external AHRS) are missing.
    """
    cores = {kind: _core_topics(message, tables, topics) for kind, (_, message, _) in _ESTIMATOR_MESSAGES.items()}
    default = next((kind for kind in (3, 2, 1) if cores[kind]), None)
    if default is None:
        return None, []
    kinds = _find_active_estimators(tables, parameters) or (np.array([-np.inf]), np.array([default]))
    notes = [
        f"{_ESTIMATOR_MESSAGES[k][0]} was active, but the log has no position of it; the position of "
        f"{_ESTIMATOR_MESSAGES[default][0]} is used"
        for k in np.unique(kinds[1]).tolist()
        if k and not cores[k]
    ]
    kinds = (kinds[0], np.array([k if cores[k] or not k else default for k in kinds[1].tolist()]))
    parts: list[tuple[str, NDArray[np.bool_]]] = []
    for kind in np.unique(kinds[1][kinds[1] > 0]).tolist():
        name, _, primary = _ESTIMATOR_MESSAGES[kind]
        lanes = _find_primary_cores(primary, tables, topics)
        unlogged = sorted(set(lanes[1].tolist()) - set(cores[kind]))
        if unlogged:
            notes.append(f"core {', '.join(map(str, unlogged))} of {name} was active but is not in the log")
        for core, topic in cores[kind].items():
            time = tables[topic].time
            mine = (_sample_and_hold(kinds, time) == kind) & (_sample_and_hold(lanes, time) == core)
            parts += [(topic, mine)] if mine.any() else []
    first = cores[default][min(cores[default])]
    if not parts:
        return None, [
            *notes,
            f"the log has no position of the active estimator; position and velocity are those of {first}",
        ]
    if len(parts) == 1 and parts[0][0] == first and parts[0][1].all():
        return None, notes
    time = np.concatenate([tables[topic].time[mine] for topic, mine in parts])
    order = np.argsort(time, kind="stable")
    fields: dict[str, NDArray[Any]] = {}
    for name in _MOTION_FIELDS:
        held = [tables[topic].fields.get(name, np.full(len(mine), np.nan))[mine] for topic, mine in parts]
        fields[name] = np.concatenate(held)[order]
    source = np.concatenate([np.full(mine.sum(), topic) for topic, mine in parts])[order]
    units = {name: "m" if name[0] == "P" else "m/s" for name in _MOTION_FIELDS}
    notes.append(_describe_source_changes(time[order], source, kinds))
    return RawTable(ACTIVE_ESTIMATE_TOPIC, time[order], fields | {"Source": source}, units), notes


def _core_topics(message: str, tables: Mapping[str, RawTable], topics: _InstanceTopics) -> dict[int, str]:
    """Return the topic of each core (instance) of an estimator."""
    if not message:
        return {}
    if message in topics:
        return {core: topic for core, topic in topics[message].items() if topic in tables}
    names = [message]
    if message[:_ESTIMATOR_PREFIX_LENGTH] in ("NKF", "XKF"):
        family, number = message[:_ESTIMATOR_PREFIX_LENGTH], int(message[_ESTIMATOR_PREFIX_LENGTH:])
        names += [f"{family}{number + _MESSAGES_PER_CORE * k}" for k in (1, 2)]
    return {k: name for k, name in enumerate(names) if name in tables}


_StepSignal = tuple[NDArray[np.float64], NDArray[Any]]  # instants (s) and the value from each on


def _sample_and_hold(steps: _StepSignal, time: NDArray[np.float64]) -> NDArray[Any]:
    """Return the step signal's value at each time; before its first instant the first value."""
    return steps[1][np.clip(np.searchsorted(steps[0], time, side="right") - 1, 0, None)]


def _find_active_estimators(tables: Mapping[str, RawTable], parameters: RawTable | None) -> _StepSignal | None:
    attitude = tables.get("ATT")
    if attitude is not None and "AEKF" in attitude.fields:
        steps = attitude.time, attitude.fields["AEKF"]
    elif parameters is not None and {"Name", "Value"} <= set(parameters.fields):
        mine = parameters.fields["Name"] == "AHRS_EKF_TYPE"
        steps = parameters.time[mine], parameters.fields["Value"][mine]
    else:
        return None
    known = np.isin(steps[1], list(_ESTIMATOR_MESSAGES)) & np.isfinite(steps[0])
    return _make_step_signal(steps[0][known], steps[1][known].astype(int)) if known.any() else None


def _make_step_signal(time: NDArray[np.float64], value: NDArray[Any]) -> _StepSignal:
    new = np.flatnonzero(np.append(True, value[1:] != value[:-1]))
    return time[new], value[new]


def _find_primary_cores(primary: str, tables: Mapping[str, RawTable], topics: _InstanceTopics) -> _StepSignal:
    """Return the primary core of an estimator over time as a step signal; 0 if unknown."""
    told = [tables[t] for t in _core_topics(primary, tables, topics).values() if "PI" in tables[t].fields]
    time = np.concatenate([t.time for t in told]) if told else np.empty(0)
    lane = np.concatenate([t.fields["PI"] for t in told]) if told else np.empty(0)
    known = np.isfinite(time) & (lane >= 0) & (lane < 100)  # -1 and 255: no core is running
    if not known.any():
        return np.array([-np.inf]), np.array([0])
    order = np.argsort(time[known], kind="stable")
    return _make_step_signal(time[known][order], lane[known][order].astype(int))


def _describe_source_changes(time: NDArray[np.float64], source: NDArray[Any], kinds: _StepSignal) -> str:
    """Return a note on the topics from which position and velocity are taken, with the times of changes."""
    at = [0, *(np.flatnonzero(source[1:] != source[:-1]) + 1).tolist()]
    steps = [f"{source[k]} from {time[k]:.1f} s" for k in at]
    if (more := len(steps) - _MAX_LISTED_CHANGES) > 0:
        steps = [*steps[:_MAX_LISTED_CHANGES], f"and {more} changes more"]
    text = f"position and velocity are those of the active estimator and lane: {', '.join(steps)}"
    return f"{text}; none while DCM was active" if (kinds[1] == 0).any() else text


def _firmware_family(firmware: str, version: RawTable | None) -> ModeFamily:
    """Return the ArduPilot firmware of the log, by its first message or else by its build type."""
    match = _FIRMWARE_PATTERN.match(firmware)
    if match is not None:
        return _FAMILY_BY_FIRMWARE[match[1].lower()]
    build = version.fields.get("BU", np.empty(0)) if version is not None else np.empty(0)
    return _FAMILY_BY_BUILD_TYPE.get(int(build[0]), "") if len(build) and np.isfinite(build[0]) else ""


def _name_flight_modes(mode: RawTable, family: ModeFamily) -> RawTable:
    """Return table MODE with names of the firmware's flight modes; modes given as text are unchanged."""
    field = next((f for f in ("ModeNum", "Mode") if f in mode.fields), None)
    if field is None or mode.fields.get("Mode", np.empty(0)).dtype.kind in "US":
        return mode
    numbers = mode.fields[field].astype(np.float64)
    names = [ardupilot_mode_name(family, int(n)) if np.isfinite(n) else "" for n in numbers.tolist()]
    return replace(mode, fields={**mode.fields, "Name": np.array(names, dtype=str)})


def _find_rate_unit(rate: RawTable, gyro: RawTable | None, firmware: str) -> tuple[str, str]:
    """Return the unit of message RATE and the reason: stated in the file, by firmware version, or by the gyroscopes."""
    if "R" in rate.units:
        return rate.units["R"], ""
    match = _FIRMWARE_PATTERN.match(firmware)
    kind, *version = match.groups() if match is not None else ("",)
    if kind.lower() == "copter":
        old = tuple(map(int, version)) < (3, 4)
        return ("cdeg/s", f", as {firmware.split('(')[0].strip()} wrote it") if old else ("deg/s", "")
    body = ("GyrX", "GyrY", "GyrZ")
    if gyro is not None and set(body) <= set(gyro.fields) and set("RPY") <= set(rate.fields):
        size = [
            float(np.sqrt(np.nanmean([np.nanmean(t.fields[k].astype(np.float64) ** 2) for k in names])))
            for t, names in ((rate, "RPY"), (gyro, body))
        ]
        # The ratio is 57.3 in degrees and 5730 in hundredths; the geometric mean of these is the threshold.
        if size[1] > 0 and size[0] / size[1] > 573:
            return "cdeg/s", ": it is a hundred times the gyroscope's rate in IMU"
    return "deg/s", ""


def _read_text_log(path: Path) -> tuple[list[RawTable], _InstanceTopics, str]:
    kinds: dict[str, _MessageKind] = {}
    numbers: dict[int, _MessageKind] = {}
    rows: dict[str, list[list[str]]] = {}
    bad: list[int] = []
    for place, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines()):
        name, _, rest = line.partition(",")
        name = name.strip()
        if name == "FMT":
            parts = [p.strip() for p in rest.split(",", 4)]
            if len(parts) == 5:
                type_number, _, message, types, names = parts
                columns = [c.strip() for c in names.split(",")]
                kind = kinds.setdefault(message, _MessageKind(message, 0, types, columns))
                bad += [place + 1] if kind.columns != columns else []  # the same name for another format
                if type_number.isdigit():
                    numbers[int(type_number)] = kind
            continue
        if name not in kinds:
            bad += [place + 1] if name else []
            continue
        columns = kinds[name].columns
        cells = [c.strip() for c in rest.split(",", len(columns) - 1)]
        if len(cells) == len(columns):
            rows.setdefault(name, []).append(cells)
            kinds[name].message_offsets.append(place)
        else:
            bad.append(place + 1)
    named = {
        name: [dict(zip(kinds[name].columns, row, strict=True)) for row in rows.get(name, ())]
        for name in DEFINITION_MESSAGES
    }
    units, instances = _field_units(numbers, named)
    messages: list[_MessageTable] = []
    for kind in kinds.values():
        number = next((n for n, k in numbers.items() if k is kind), -1)
        if kind.name in DEFINITION_MESSAGES or not kind.message_offsets:
            continue
        values: dict[str, NDArray[Any]] = {}
        for k, (column, letter) in enumerate(zip(kind.columns, kind.format_letters, strict=False)):
            cells = [row[k] for row in rows[kind.name]]
            values[column] = np.array(cells, dtype=str) if letter in "nNZa" else _parse_cells(cells, letter)
        places = np.array(kind.message_offsets, dtype=np.int64)
        own = _units_of_old_log(kind.name, kind.format_letters, kind.columns) | units.get(number, {})
        instance = instances.get(number) or _guess_instance_field(kind)
        messages.append(_MessageTable(kind.name, places, values, own, instance if instance in values else None))
    first = f"line {bad[0]} is" if len(bad) == 1 else f"{len(bad)} lines, the first line {bad[0]}, are" if bad else ""
    return *_make_tables(messages), f"{first} no whole message" if bad else ""


def _parse_cells(cells: list[str], letter: str) -> NDArray[Any]:
    """Return a column's cells as numbers; flight modes (format ``letter`` M) stay text if the log names them."""
    found = np.array([_parse_number(c) for c in cells])
    if letter == "M" and np.isnan(found).any() and any(c.strip() for c in cells):
        return np.array(cells, dtype=str)
    return found


def _parse_number(cell: str) -> float:
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
    return format_wall_time(gps_to_unix(float(week[k]), float(ms[k]) / 1e3) - float(gps.time[k]))
