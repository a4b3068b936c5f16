"""MAVLink telemetry log (``.tlog``): what a ground station received, each packet behind the time of its arrival.

The time is a big-endian count of microseconds since 1970 (eight bytes); the packet follows as it was on the air
(mavlink.io, "Serialization"). Arrival times carry the jitter of the link. Messages that hold the vehicle's own clock
(``time_boot_ms``, ``time_usec``) are therefore placed by that clock; it is tied to the time of arrival by the packet
that was quickest, which no link can be faster than, anew each time that the vehicle starts. What a field says where
nothing is known (a current of -1, a voltage of 65535) is missing: :mod:`mufly.logs.unknown`.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.topics import RawLog, RawTable, foreign_stamps, wall_time
from mufly.logs.unknown import without_unknown

_STAMP = struct.Struct(">Q")
_YEAR_2000_US, _YEAR_2100_US = 946_684_800 * 10**6, 4_102_444_800 * 10**6
_GROUND_STATION = 6  # MAV_TYPE_GCS
_SEVERITY = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
# A clock that steps back by more than this was reset.
_RESET_S = 1.0
_LATEST_S = 5.0
_LONGEST_UPTIME_S = 1e8
FLUSH_S = 1.0
"""Of what is written so much is lost with a process that is killed (s)."""


def packet_length(data: bytes | bytearray, at: int) -> int:
    """Length of the packet of MAVLink that begins at ``at``; 0 if none does, or too little of it is there."""
    if at + 3 > len(data):
        return 0
    if data[at] == 0xFE:
        return 8 + data[at + 1]
    if data[at] == 0xFD:
        return 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
    return 0


def _entry(data: bytes, at: int) -> int:
    """Length of the entry (stamp and packet) that begins at ``at``; 0 if none does."""
    if at + 11 > len(data) or not _YEAR_2000_US < _STAMP.unpack_from(data, at)[0] < _YEAR_2100_US:
        return 0
    size = packet_length(data, at + 8)
    return 8 + size if size else 0


def looks_like_tlog(head: bytes) -> bool:
    """Whether a file that begins so is a telemetry log: two entries in a row, or one that fills it."""
    size = _entry(head, 0)
    return bool(size) and (len(head) <= size + 11 or bool(_entry(head, size)))


def _packets(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield (offset, stamp in us, packet); bytes that are no entry are skipped."""
    at = 0
    while at + 11 <= len(data):
        size = _entry(data, at)
        if not size or at + size > len(data):
            at += 1
            continue
        yield at, _STAMP.unpack_from(data, at)[0], data[at + 8 : at + size]
        at += size


def read_tlog(path: str | Path, progress: Callable[[int, int], None] | None = None) -> RawLog:
    """Read a telemetry log; packets that are damaged are left out and counted.

    Parameters
    ----------
    path : str or Path
    progress : callable, optional
        Called with (bytes read, bytes in all).

    Raises
    ------
    InputError
        If no packet of it can be decoded.
    """
    os.environ["MAVLINK20"] = "1"
    with contextlib.redirect_stdout(io.StringIO()):
        from pymavlink.dialects.v20 import ardupilotmega as dialect

    where = str(path)
    data = Path(path).read_bytes()
    link = dialect.MAVLink(None)
    link.robust_parsing = False
    rows: defaultdict[tuple[int, int, str], tuple[list[int], list[Any]]] = defaultdict(lambda: ([], []))
    bad = read = 0
    for k, (at, stamp, packet) in enumerate(_packets(data)):
        if progress is not None and k % 2000 == 0:
            progress(at, len(data))
        read += 8 + len(packet)
        try:
            message = link.decode(bytearray(packet))
        except Exception:  # wrong checksum, unknown message: counted
            bad += 1
            continue
        key = (message.get_srcSystem(), message.get_srcComponent(), message.get_type())
        if key[2].startswith("UNKNOWN"):
            bad += 1
            continue
        stamps, messages = rows[key]
        stamps.append(stamp)
        messages.append(message)
    if not rows:
        raise InputError(where, "", "holds no packet that can be decoded", "give a MAVLink 1 or 2 log")
    foreign, _ = foreign_stamps({str(key): np.array(stamps) / 1e6 for key, (stamps, _) in rows.items()})
    lost = sum(int(f.sum()) for f in foreign.values())
    for key in list(rows) if lost else []:
        kept = [
            pair for pair, f in zip(zip(*rows[key], strict=True), foreign[str(key)], strict=True) if not f
        ]
        rows[key] = ([stamp for stamp, _ in kept], [message for _, message in kept])
        if not kept:
            del rows[key]
    zero = min(min(stamps) for stamps, _ in rows.values())
    vehicle = _vehicle(rows)
    notes = [f"{bad} packets were damaged or unknown and are left out"] if bad else []
    notes += [f"{lost} packets whose time of arrival is of another day are left out"] if lost else []
    tables: dict[str, RawTable] = {}
    said: list[tuple[float, str, str]] = []
    parameters: dict[str, float] = {}
    own: dict[str, tuple[str, NDArray[np.float64]]] = {}
    for (system, component, name), (stamps, messages) in rows.items():
        arrival = (np.array(stamps, dtype=np.int64) - zero) / 1e6
        who = "" if (system, component) == vehicle else f"@{system}.{component}"
        if name == "STATUSTEXT":
            texts = _texts(arrival, messages)
            said += [(t, level, f"{who[1:]}: {text}" if who else text) for t, level, text in texts]
            continue
        if name == "PARAM_VALUE":
            if system == vehicle[0]:
                parameters |= {m.param_id: m.param_value for m in messages}
            continue
        label = f"{name}{who}"
        fields, units = _columns(messages)
        clock = _own_clock(fields) if system == vehicle[0] else None
        if clock is not None:
            own[label] = clock
        tables[label] = RawTable(label, arrival, fields, units)
    placed, restarts = _placed(own, {k: t.time for k, t in tables.items()})
    tables |= {k: replace(tables[k], time=time) for k, time in placed.items()}
    if not placed:
        notes.append(
            "no message holds the vehicle's own clock; times are those of arrival, with the link's jitter"
        )
    if restarts:
        when = ", ".join(f"{t:.0f}" for t in restarts)
        notes.append(
            f"the vehicle started anew at {when} s of the log; its clock was tied to the log's each time"
        )
    return RawLog(
        path=where,
        kind="MAVLink tlog",
        tables=dict(sorted(tables.items())),
        start_time=wall_time(zero / 1e6),
        info={"system": _described(dialect, vehicle, rows), "parameters": parameters},
        messages=tuple(sorted(said)),
        complete=read == len(data),
        notes=tuple(notes),
    )


def _vehicle(rows: Any) -> tuple[int, int]:
    """System and component of the vehicle: whoever has a heartbeat and is no ground station, else who says most."""
    beats = [
        ((s, c), len(stamps))
        for (s, c, name), (stamps, messages) in rows.items()
        if name == "HEARTBEAT" and messages[0].type != _GROUND_STATION and messages[0].autopilot != 8
    ]
    found = beats or [((s, c), len(stamps)) for (s, c, _), (stamps, _) in rows.items()]
    return max(found, key=lambda f: f[1])[0]


def _described(dialect: Any, vehicle: tuple[int, int], rows: Any) -> str:
    """The vehicle in words, from its heartbeat: kind, autopilot, number of system and component."""
    number = f"{vehicle[0]}.{vehicle[1]}"
    beats = rows.get((*vehicle, "HEARTBEAT"))
    if beats is None:
        return f"system {number}"

    def word(enum: str, value: int) -> str:
        known = dialect.enums[enum].get(value)
        return "" if known is None else known.name.removeprefix(f"{enum}_").lower().replace("_", " ")

    said = [word("MAV_TYPE", beats[1][-1].type), word("MAV_AUTOPILOT", beats[1][-1].autopilot)]
    return ", ".join([*(w for w in said if w not in ("", "generic", "invalid")), f"system {number}"])


def _columns(messages: list[Any]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    kind = type(messages[0])
    out: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for name in kind.fieldnames:
        values = [getattr(m, name) for m in messages]
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
    return without_unknown(kind.msgname, out), units


def _texts(arrival: NDArray[np.float64], messages: list[Any]) -> list[tuple[float, str, str]]:
    """(s, level, text) of one sender's STATUSTEXT; what came in chunks of 50 characters is one text again."""
    out: list[tuple[float, str, str]] = []
    before = (0, -1)
    for t, m in zip(arrival.tolist(), messages, strict=True):
        here = (m.id, m.chunk_seq)
        if m.id and here == (before[0], before[1] + 1) and m.chunk_seq:
            out[-1] = (*out[-1][:2], out[-1][2] + m.text)
        else:
            out.append((t, _SEVERITY[m.severity & 7], m.text))
        before = here
    return out


def _own_clock(fields: Mapping[str, NDArray[Any]]) -> tuple[str, NDArray[np.float64]] | None:
    """Name of the field that holds the vehicle's clock, and that clock (s since it started)."""
    for name, tick in (("time_boot_ms", 1e3), ("time_usec", 1e6)):
        if name in fields:
            time = fields[name].astype(np.float64) / tick
            # A simulation may begin at 0; later a 0 is a stamp that was never set.
            if (time[1:] if len(time) > 1 else time).min() > 0 and time.max() < _LONGEST_UPTIME_S:
                return name, time
    return None


def _placed(
    own: Mapping[str, tuple[str, NDArray[np.float64]]], arrival: Mapping[str, NDArray[np.float64]]
) -> tuple[dict[str, NDArray[np.float64]], list[float]]:
    """Tie the vehicle's clock to the time of arrival, anew each time that the vehicle starts.

    Returns the times of those messages whose clock can be tied, and the arrival of the first message after each
    further start.
    """
    lead = [k for k, (name, _) in own.items() if name == "time_boot_ms"] or list(own)
    if not lead:
        return {}, []
    came = np.concatenate([arrival[k] for k in lead])
    sent = np.concatenate([own[k][1] for k in lead])
    order = np.argsort(came, kind="stable")
    came, sent = came[order], sent[order]
    starts = np.flatnonzero(np.diff(sent) < -_RESET_S) + 1
    borders = came[starts]
    boot = np.searchsorted(starts, np.arange(len(came)), side="right")
    quickest = np.array([(came - sent)[boot == k].min() for k in range(len(starts) + 1)])
    out = {}
    for key, (name, clock) in own.items():
        mine = np.searchsorted(borders, arrival[key], side="right")
        # A topic may be the first to speak after a start, just before the border that the others set.
        next_one = np.minimum(mine + 1, len(quickest) - 1)
        early, time = clock + quickest[next_one], clock + quickest[mine]
        time = np.where(np.abs(arrival[key] - early) < np.abs(arrival[key] - time), early, time)
        late = arrival[key] - time
        # A clock of another kind (that of the GPS receiver) does not fit, a lazy link does.
        if name == "time_boot_ms" or (late.min() > -_RESET_S and np.median(late) < _LATEST_S):
            out[key] = time
    return out, borders.tolist()


class TlogWriter:
    """Telemetry log, written as it comes: each packet behind the time of its arrival or departure.

    That is what every ground station for MAVLink reads, and :func:`read_tlog`. The file is flushed every second, so
    that a process that is killed loses no more.

    Parameters
    ----------
    path : str or Path
        Its folder is made if need be; a file of that name is replaced.

    Raises
    ------
    InputError
        If it cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._flushed_s = time.monotonic()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("wb")
        except OSError as error:
            raise InputError(
                str(self.path), "", f"cannot be written ({error.strerror})", "give another folder"
            ) from error

    def write(self, packet: bytes, time_us: int | None = None) -> None:
        """Add one packet.

        Parameters
        ----------
        packet : bytes
            One frame of MAVLink.
        time_us : int, optional
            Microseconds since 1970; by default now.
        """
        self._file.write(_STAMP.pack(time.time_ns() // 1000 if time_us is None else time_us) + packet)
        now_s = time.monotonic()
        if now_s - self._flushed_s >= FLUSH_S:
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
