"""MAVLink telemetry log (``.tlog``): received packets, each after the time of its arrival.

The time is a big-endian count of microseconds since 1970 (eight bytes); the packet follows as transmitted (mavlink.io,
"Serialization"). Arrival times contain the jitter of the link. Messages with their sender's clock (``time_boot_ms``,
``time_usec``) are therefore placed by that clock. After each start of the sender, the clock is synchronised with the
arrival of the fastest packet, which had the least delay. Clock, packet numbers and parameters belong to one sender each
(system and component). Values that mean unknown (a current of -1, a voltage of 65535) become missing:
:mod:`mufly.logs.mavlink_unknown_values`.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, convert_write_errors
from mufly.logs.mavlink_unknown_values import replace_unknown_values
from mufly.logs.raw_log import RawLog, RawTable, describe_skipped_bytes, find_foreign_epoch_stamps, format_wall_time
from mufly.logs.sender_clocks import (
    MessageKey,
    estimate_sending_times,
    find_sender_clock,
    order_by_packet_number,
    remove_arrival_leaps,
    repair_arrival_times,
)
from mufly.vehicle_types import (
    AUTOPILOT_COMPONENT,
    MAV_AUTOPILOT_PX4,
    VEHICLE_TYPE_NAMES,
    flight_mode_name,
    is_vehicle,
    vehicle_rank,
    vehicle_type_name,
)

_STAMP_STRUCT = struct.Struct(">Q")
_MAVLINK_2_MAGIC = 0xFD
_SENDER_AND_ID_SLICE_V1, _SENDER_AND_ID_SLICE_V2 = slice(3, 6), slice(5, 10)  # bytes of system, component and message
_STAMP_SIZE = 8  # bytes before the packet of an entry
_YEAR_2000_US, _YEAR_2100_US = 946_684_800 * 10**6, 4_102_444_800 * 10**6
_SEVERITY_WORDS = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
_INTEGER_PARAM_LAYOUTS = {
    1: "<Bxxx",
    2: "<bxxx",
    3: "<Hxx",
    4: "<hxx",
    5: "<I",
    6: "<i",
}  # MAV_PARAM_TYPE of whole numbers
FLUSH_INTERVAL_S = 1.0
"""Time between flushes (s), which is lost at most when the process is killed."""


def mavlink_packet_length_at(data: bytes | bytearray, at: int) -> int:
    """Return the length of the MAVLink packet that begins at ``at``; 0 if there is none, or it is incomplete."""
    if at + 3 > len(data):
        return 0
    if data[at] == 0xFE:
        return 8 + data[at + 1]
    if data[at] == 0xFD:
        return 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
    return 0


def _entry_length(data: bytes, at: int) -> int:
    """Return the length of the entry (stamp and packet) that begins at ``at``; 0 if there is none."""
    if at + 11 > len(data) or not _YEAR_2000_US < _STAMP_STRUCT.unpack_from(data, at)[0] < _YEAR_2100_US:
        return 0
    size = mavlink_packet_length_at(data, at + 8)
    return 8 + size if size else 0


def looks_like_tlog(head: bytes) -> bool:
    """Return whether a file with these first bytes is a telemetry log: two successive entries, or a single one."""
    size = _entry_length(head, 0)
    return bool(size) and (len(head) <= size + 11 or bool(_entry_length(head, size)))


def _iterate_packets(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield (offset of the entry, packet); bytes outside entries are skipped."""
    at = 0
    while at + 11 <= len(data):
        size = _entry_length(data, at)
        if not size or at + size > len(data):
            at += 1
            continue
        yield at, data[at + _STAMP_SIZE : at + size]
        at += size


def read_tlog(path: str | Path, progress: Callable[[int, int], None] | None = None) -> RawLog:
    """Read a telemetry log; damaged and repeated packets are omitted and counted.

    The signals are those of one vehicle (:func:`mufly.vehicle_types.vehicle_rank`); topics of others end in
    ``@system.component``, and their parameters are in ``info["parameters@system.component"]``.

    Parameters
    ----------
    path : str or Path
    progress : callable, optional
        Called with (bytes read, total bytes).

    Raises
    ------
    InputError
        If no packet can be decoded.
    """
    os.environ["MAVLINK20"] = "1"
    with contextlib.redirect_stdout(io.StringIO()):
        from pymavlink.dialects.v20 import ardupilotmega as dialect

    where = str(path)
    data = Path(path).read_bytes()
    link = dialect.MAVLink(None)
    link.robust_parsing = False
    raw_rows: defaultdict[bytes, tuple[list[int], list[Any]]] = defaultdict(lambda: ([], []))
    bad = behind = 0
    skipped: list[tuple[int, int]] = []
    for k, (at, packet) in enumerate(_iterate_packets(data)):
        if progress is not None and k % 2000 == 0:
            progress(at, len(data))
        if at > behind:
            skipped.append((behind, at))
        behind = at + _STAMP_SIZE + len(packet)
        try:
            message = link.decode(bytearray(packet))
        except Exception:  # wrong checksum, unknown message: counted
            bad += 1
            continue
        offsets, messages = raw_rows[
            packet[_SENDER_AND_ID_SLICE_V2 if packet[0] == _MAVLINK_2_MAGIC else _SENDER_AND_ID_SLICE_V1]
        ]
        offsets.append(at)
        messages.append(message)
    if behind < len(data):
        skipped.append((behind, len(data)))
    bad += sum(len(messages) for _, messages in raw_rows.values() if _is_unknown_message(messages[0]))
    rows, offset = _group_by_sender_and_type(raw_rows)
    if not rows:
        raise InputError(where, "", "contains no packet that can be decoded", "give a MAVLink 1 or 2 log")
    notes = [f"{bad} packets are damaged or unknown and skipped"] if bad else []
    came_us, number = _read_stamps_and_packet_numbers(data, offset)
    foreign, _ = find_foreign_epoch_stamps({str(key): came_us[places] / 1e6 for key, (places, _) in rows.items()})
    lost = sum(int(f.sum()) for f in foreign.values())
    if lost:
        _drop_packets(rows, {key: ~foreign[str(key)] for key in rows})
        notes.append(f"{lost} packets that arrived on another day are skipped")
    vehicle, said = _choose_vehicle(rows)
    notes += said
    kept = np.sort(np.concatenate([places for places, _ in rows.values()]))
    zero = int(came_us[kept[0]])
    arrival, set_back, said = repair_arrival_times((came_us - zero) / 1e6, kept)
    notes += said
    zero += round(1e6 * arrival[kept].min())
    arrival, again = order_by_packet_number(_packet_file_positions(rows), arrival - arrival[kept].min(), number)
    twice = int(again.sum())
    if twice:
        _drop_packets(rows, {key: ~again[places] for key, (places, _) in rows.items()})
    contents = {
        key: _columns_of_messages(messages)
        for key, (_, messages) in rows.items()
        if key[2] not in _MESSAGES_WITHOUT_TABLE
    }
    if (beats := (*vehicle, "HEARTBEAT")) in contents:
        modes = _flight_mode_names(rows[beats][1], vehicle[1])
        contents[beats][0].update({"mode": modes} if modes.any() else {})
    clocks = {key: clock for key, (fields, _) in contents.items() if (clock := find_sender_clock(fields)) is not None}
    arrival, said = remove_arrival_leaps(arrival, _packet_file_positions(rows), clocks, vehicle, set_back)
    notes += said
    times, said = estimate_sending_times(arrival, _packet_file_positions(rows), clocks, vehicle)
    notes += said
    tables: dict[str, RawTable] = {}
    late = 0
    for key, (fields, units) in contents.items():
        label = key[2] if key[:2] == vehicle else f"{key[2]}@{key[0]}.{key[1]}"
        time = times[key] if key in times else arrival[rows[key][0]]
        behind = int((time < np.maximum.accumulate(time)).sum())
        if behind:
            late += behind
            time, fields = _select_rows(np.argsort(time, kind="stable"), time, fields)
        repeated = _find_repeated_rows(time, fields) if key in clocks else np.zeros(0, dtype=bool)
        if repeated.any():
            twice += int(repeated.sum())
            time, fields = _select_rows(np.flatnonzero(~repeated), time, fields)
        tables[label] = RawTable(label, time, fields, units)
    if late:
        notes.append(f"{late} packets arrived out of order and are sorted by their time of sending")
    if twice:
        notes.append(f"{twice} duplicate packets are skipped")
    texts = [
        (t, level, text if key[:2] == vehicle else f"{key[0]}.{key[1]}: {text}")
        for key, (places, messages) in rows.items()
        if key[2] == "STATUSTEXT"
        for t, level, text in _join_status_texts(arrival[places], messages)
    ]
    return RawLog(
        path=where,
        format_name="MAVLink tlog",
        tables_by_topic=dict(sorted(tables.items())),
        start_time=format_wall_time(zero / 1e6),
        info={"system": _describe_vehicle(dialect, vehicle, rows), **_collect_parameters(rows, vehicle)},
        messages=tuple(sorted(texts)),
        is_complete=not skipped,
        notes=tuple(notes),
        damage_text=describe_skipped_bytes(data, skipped, "packet"),
    )


_MessageRows = dict[MessageKey, tuple[NDArray[np.int64], list[Any]]]
"""Indices in the order of the file (0, 1, ...) and messages, by sender and kind."""
_MESSAGES_WITHOUT_TABLE = ("STATUSTEXT", "PARAM_VALUE")


def _is_unknown_message(message: Any) -> bool:
    return str(message.get_type()).startswith("UNKNOWN")


def _group_by_sender_and_type(
    raw_rows: Mapping[bytes, tuple[list[int], list[Any]]],
) -> tuple[_MessageRows, NDArray[np.int64]]:
    """Group messages of MAVLink 1 and 2 by sender and type; return also the file offset of every message."""
    parts: defaultdict[MessageKey, list[tuple[NDArray[np.int64], list[Any]]]] = defaultdict(list)
    for offsets, messages in raw_rows.values():
        one = messages[0]
        if not _is_unknown_message(one):
            key = (one.get_srcSystem(), one.get_srcComponent(), one.get_type())
            parts[key].append((np.array(offsets, dtype=np.int64), messages))
    every = [offsets for part in parts.values() for offsets, _ in part]
    offset = np.sort(np.concatenate(every)) if every else np.empty(0, dtype=np.int64)
    rows: _MessageRows = {}
    for key, part in parts.items():
        places = np.searchsorted(offset, np.concatenate([offsets for offsets, _ in part]))
        together = [message for _, messages in part for message in messages]
        if len(part) > 1:
            order = np.argsort(places)
            places, together = places[order], [together[k] for k in order.tolist()]
        rows[key] = places, together
    return rows, offset


def _read_stamps_and_packet_numbers(
    data: bytes, offset: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the stamp (us) of each entry, and number and checksum of its packet as checksum * 256 + number."""
    stream = np.frombuffer(data, dtype=np.uint8)
    stamp = stream[offset[:, None] + np.arange(8)].copy().view(">u8")[:, 0].astype(np.int64)
    newer = stream[offset + _STAMP_SIZE] == _MAVLINK_2_MAGIC
    end = offset + _STAMP_SIZE + np.where(newer, 10, 6) + stream[offset + _STAMP_SIZE + 1]
    checksum = stream[end].astype(np.int64) + 256 * stream[end + 1].astype(np.int64)
    return stamp, checksum * 256 + stream[offset + np.where(newer, 12, 10)]


def _drop_packets(rows: _MessageRows, keep: Mapping[MessageKey, NDArray[np.bool_]]) -> None:
    for key, sound in keep.items():
        places, messages = rows[key]
        rows[key] = places[sound], [m for m, good in zip(messages, sound.tolist(), strict=True) if good]
        if not rows[key][1]:
            del rows[key]


# ----------------------------------------------------------------------------
# Choice of the vehicle among the senders.


def _summarise_heartbeats(rows: _MessageRows) -> dict[tuple[int, int], tuple[int, int, int]]:
    """Return rank, MAV_TYPE and number of heartbeats of every sender; the highest rank is the likeliest vehicle.

    Of a sender with several types, the type of the best rank counts.
    """
    out: dict[tuple[int, int], tuple[int, int, int]] = {}
    for (system, component, name), (_, messages) in rows.items():
        if name == "HEARTBEAT":
            kinds = Counter((m.type, m.autopilot) for m in messages)
            ranked = [(vehicle_rank(kind, pilot, component), n, kind) for (kind, pilot), n in kinds.items()]
            rank, count, kind = max(ranked)
            out[system, component] = rank, kind, count
    return out


def _choose_vehicle(rows: _MessageRows) -> tuple[tuple[int, int], list[str]]:
    """Return system and component of the vehicle, and notes on the choice.

    The vehicle is the sender of the heartbeats with the best rank; of equals the one of a known type, then the one with
    most messages. If no sender qualifies: a sender without heartbeats (component 1 first), then an antenna tracker,
    then the one with most messages.
    """
    beats = _summarise_heartbeats(rows)
    counts: Counter[tuple[int, int]] = Counter()
    for (system, component, _), (places, _) in rows.items():
        counts[system, component] += len(places)
    real = {who: beat for who, beat in beats.items() if beat[0] >= 2}
    if real:
        best = max(real, key=lambda w: (real[w][0], real[w][1] in VEHICLE_TYPE_NAMES, real[w][2], -w[0]))
        others = sorted(w for w, beat in real.items() if w[0] != best[0] and beat[0] == real[best][0])
        if not others:
            return best, []
        named = ", ".join(f"{vehicle_type_name(real[w][1]) or 'vehicle'} {w[0]}.{w[1]}" for w in others)
        words = (
            f"the log holds several vehicles; the signals are those of {best[0]}.{best[1]}, topics of "
            "the others end in @"
        )
        return best, [f"{words} ({named})"]
    silent = [w for w in counts if w not in beats]
    trackers = [w for w, beat in beats.items() if beat[0] == 1]
    if silent and not trackers:
        return max(silent, key=lambda w: (w[1] == AUTOPILOT_COMPONENT, counts[w])), []
    best = max(trackers or list(counts), key=lambda w: counts[w])
    what = vehicle_type_name(beats[best][1]) or "equipment"
    return best, [f"the log holds no vehicle; the signals are those of the {what} {best[0]}.{best[1]}"]


def _describe_vehicle(dialect: Any, vehicle: tuple[int, int], rows: _MessageRows) -> str:
    """Return a description of the vehicle from its heartbeat: type, autopilot, system and component."""
    number = f"{vehicle[0]}.{vehicle[1]}"
    if (*vehicle, "HEARTBEAT") not in rows:
        return f"system {number}"
    beats = rows[*vehicle, "HEARTBEAT"][1]
    beat = max(reversed(beats), key=lambda m: vehicle_rank(m.type, m.autopilot, vehicle[1]))

    def enum_entry_text(enum: str, value: int) -> str:
        known = dialect.enums[enum].get(value)
        return "" if known is None else known.name.removeprefix(f"{enum}_").lower().replace("_", " ")

    said = [enum_entry_text("MAV_TYPE", beat.type), enum_entry_text("MAV_AUTOPILOT", beat.autopilot)]
    return ", ".join([*(w for w in said if w not in ("", "generic", "invalid")), f"system {number}"])


def _flight_mode_names(beats: list[Any], component: int) -> NDArray[Any]:
    """Return the name of the flight mode at each heartbeat; heartbeats of equipment repeat the last mode."""
    out, last = [], ""
    for m in beats:
        if is_vehicle(m.type, m.autopilot, component):
            last = flight_mode_name(m.autopilot, m.type, m.base_mode, m.custom_mode)
        out.append(last)
    return np.array(out, dtype=str)


def _collect_parameters(rows: _MessageRows, vehicle: tuple[int, int]) -> dict[str, dict[str, float]]:
    """Return the parameters of every component; those of the vehicle under ``parameters``, even if there are none."""
    out: dict[str, dict[str, float]] = {"parameters": {}}
    for (system, component, name), (_, messages) in rows.items():
        if name == "PARAM_VALUE":
            key = "parameters" if (system, component) == vehicle else f"parameters@{system}.{component}"
            beats = rows[who][1] if (who := (system, component, "HEARTBEAT")) in rows else []
            bytewise = any(m.autopilot == MAV_AUTOPILOT_PX4 for m in beats)
            out[key] = {m.param_id: _parameter_value(m, bytewise) for m in messages}
    return out


def _parameter_value(message: Any, bytewise: bool) -> float:
    """Return the value of a PARAM_VALUE; PX4 puts the bytes of integers into the float field."""
    layout = _INTEGER_PARAM_LAYOUTS.get(message.param_type) if bytewise else None
    if layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def _packet_file_positions(rows: _MessageRows) -> dict[MessageKey, NDArray[np.int64]]:
    return {key: places for key, (places, _) in rows.items()}


def _select_rows(
    index: NDArray[np.int64], time: NDArray[np.float64], fields: Mapping[str, NDArray[Any]]
) -> tuple[NDArray[np.float64], dict[str, NDArray[Any]]]:
    return time[index], {name: values[index] for name, values in fields.items()}


def _find_repeated_rows(time: NDArray[np.float64], fields: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Return a mask of rows equal to the previous row at the same instant: packets received by two links."""
    again = np.zeros(len(time), dtype=bool)
    same = np.flatnonzero(np.diff(time) == 0) + 1
    if len(same):
        keep = np.ones(len(same), dtype=bool)
        for values in fields.values():
            a, b = values[same], values[same - 1]
            keep &= (a == b) | ((a != a) & (b != b))
        again[same[keep]] = True
    return again


def _columns_of_messages(messages: list[Any]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    kind = type(messages[0])
    out: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for name in kind.fieldnames:
        values = list(map(attrgetter(name), messages))
        unit = kind.fieldunits_by_name.get(name, "")
        if isinstance(values[0], str | bytes):
            out[name] = np.array([str(v) for v in values], dtype=str)
        elif isinstance(values[0], list | tuple):
            block = np.array(values)
            parts = {f"{name}[{k}]": block[:, k] for k in range(block.shape[1])}
            out |= parts
            units |= dict.fromkeys(parts, unit) if unit else {}
        else:
            out[name] = np.array(values)
            units |= {name: unit} if unit else {}
    return replace_unknown_values(kind.msgname, out), units


def _join_status_texts(arrival: NDArray[np.float64], messages: list[Any]) -> list[tuple[float, str, str]]:
    """Return (s, level, text) of one sender's STATUSTEXT; chunks of 50 characters are joined."""
    out: list[tuple[float, str, str]] = []
    before = (0, -1)
    for t, m in zip(arrival.tolist(), messages, strict=True):
        here = (m.id, m.chunk_seq)
        if m.id and here == (before[0], before[1] + 1) and m.chunk_seq:
            out[-1] = (*out[-1][:2], out[-1][2] + m.text)
        else:
            out.append((t, _SEVERITY_WORDS[m.severity & 7], m.text))
        before = here
    return out


class TlogWriter:
    """Writer of a telemetry log: packets are appended, each after the time of its arrival or departure.

    Ground stations for MAVLink and :func:`read_tlog` read the file. It is flushed every second, which limits the loss
    when the process is killed.

    Parameters
    ----------
    path : str or Path
        File to write; its folder is created, and a file of that name is replaced.

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._flushed_s = time.monotonic()
        with convert_write_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("wb")

    def write_packet(self, packet: bytes, time_us: int | None = None) -> None:
        """Add one packet.

        Parameters
        ----------
        packet : bytes
            One MAVLink frame.
        time_us : int, optional
            Microseconds since 1970; by default the present time.
        """
        self._file.write(_STAMP_STRUCT.pack(time.time_ns() // 1000 if time_us is None else time_us) + packet)
        now_s = time.monotonic()
        if now_s - self._flushed_s >= FLUSH_INTERVAL_S:
            self._flushed_s = now_s
            self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> TlogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
