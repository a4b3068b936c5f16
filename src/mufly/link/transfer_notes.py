"""What the two ends of a mission transfer say to each other, and how MAVLink puts it.

:mod:`mufly.link.transfer` deals in these notes; MISSION_ITEM and MISSION_REQUEST, the older forms, become the same
notes as MISSION_ITEM_INT and MISSION_REQUEST_INT.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from mufly.link.dialect import mavlink

__all__ = [
    "Ack",
    "ClearAll",
    "Count",
    "Item",
    "MissionResult",
    "Note",
    "Notes",
    "RequestItem",
    "RequestList",
    "note_of",
    "to_mavlink",
]


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


@dataclass(frozen=True, slots=True)
class Item:
    """One mission item, as MISSION_ITEM_INT has it: x, y in 1e-4 m or 1e-7 deg, z in m."""

    seq: int
    frame: int
    command: int
    current: int = 0
    autocontinue: int = 1
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    x: int = 0
    y: int = 0
    z: float = 0.0
    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class RequestList:
    """MISSION_REQUEST_LIST: how many are there?"""

    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class Count:
    """MISSION_COUNT: so many items are on offer."""

    count: int
    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class RequestItem:
    """MISSION_REQUEST_INT (or, where ``old``, MISSION_REQUEST, which is answered alike)."""

    seq: int
    mission_type: int = 0
    old: bool = False


@dataclass(frozen=True, slots=True)
class Ack:
    """MISSION_ACK; ``result`` is a number of :class:`MissionResult` or one that it does not know yet."""

    result: int
    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class ClearAll:
    """MISSION_CLEAR_ALL; answered by an :class:`Ack`. No machine here takes it, one request has one answer."""

    mission_type: int = 0


Note = RequestList | Count | RequestItem | Item | Ack | ClearAll
"""What travels between the two."""

Notes = list[tuple[Hashable, Note]]
"""Notes to be sent, each with the peer that it is for."""

_LOCAL_FRAMES = (1, 4, 7, 8, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21)
_INT32 = 2**31


def _scaled(value: float, frame: int) -> int:
    """x or y of a MISSION_ITEM as MISSION_ITEM_INT has it; what does not fit becomes the "not given" of that field."""
    scaled = value * (1e4 if frame in _LOCAL_FRAMES else 1e7)
    if not math.isfinite(scaled) or abs(scaled) >= _INT32:
        return _INT32 - 1
    return round(scaled)


def note_of(message: Any) -> Note | None:
    """Return what a MAVLink message says about a transfer; None if nothing."""
    kind = message.get_type()
    if kind in ("MISSION_ITEM_INT", "MISSION_ITEM"):
        m = message
        x, y = (m.x, m.y) if kind == "MISSION_ITEM_INT" else (_scaled(m.x, m.frame), _scaled(m.y, m.frame))
        params = (m.param1, m.param2, m.param3, m.param4)
        return Item(m.seq, m.frame, m.command, m.current, m.autocontinue, params, x, y, m.z, m.mission_type)
    if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
        return RequestItem(message.seq, message.mission_type, kind == "MISSION_REQUEST")
    if kind == "MISSION_COUNT":
        return Count(message.count, message.mission_type)
    if kind == "MISSION_ACK":
        return Ack(message.type, message.mission_type)
    if kind == "MISSION_REQUEST_LIST":
        return RequestList(message.mission_type)
    return ClearAll(message.mission_type) if kind == "MISSION_CLEAR_ALL" else None


def to_mavlink(note: Note, system: int, component: int) -> Any:
    """Return a note as the MAVLink message to ``system`` and ``component``, ready for a codec to send."""
    to = (system, component)
    match note:
        case Item():
            n = note
            return mavlink.MAVLink_mission_item_int_message(
                *to,
                n.seq,
                n.frame,
                n.command,
                n.current,
                n.autocontinue,
                *n.params,
                n.x,
                n.y,
                n.z,
                n.mission_type,
            )
        case RequestItem():
            return mavlink.MAVLink_mission_request_int_message(*to, note.seq, note.mission_type)
        case Count():
            return mavlink.MAVLink_mission_count_message(*to, note.count, note.mission_type)
        case Ack():
            return mavlink.MAVLink_mission_ack_message(*to, note.result, note.mission_type)
        case RequestList():
            return mavlink.MAVLink_mission_request_list_message(*to, note.mission_type)
        case ClearAll():
            return mavlink.MAVLink_mission_clear_all_message(*to, note.mission_type)
