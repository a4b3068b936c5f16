"""What a broken, mad or hostile program may send over MAVLink: bytes without end, the same for the same seed.

Six kinds, mixed:

* ``field``: a frame of any message of the dialect, whole and with a right checksum, its fields drawn from the corners
  of their types (0, 1, least, greatest, NaN, infinities, largest and smallest numbers, text that is not UTF-8) or
  at random;
* ``aimed``: a frame of a message that the other end acts upon, its fields mostly such as pass the first checks: the
  right target, commands that exist, frames and masks that exist, names of parameters that it has, places nearby;
* ``burst``: hundreds of frames that ask for the same thing (lists, counts, streams);
* ``damaged``: one of the frames above with bits flipped, bytes lost, cut short, doubled or with another frame inside;
* ``noise``: random bytes, some of which begin like a frame;
* ``old``: frames of MAVLink 1, frames that claim to be signed, frames of messages that the dialect lacks.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from mufly.link import mavlink

__all__ = ["AIMED_AT_STATION", "AIMED_AT_VEHICLE", "Hostile", "Packet"]

AIMED_AT_VEHICLE = (
    "COMMAND_LONG", "COMMAND_LONG", "COMMAND_LONG", "COMMAND_INT", "COMMAND_INT", "SET_MODE",
    "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ATTITUDE_TARGET", "MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE", "HEARTBEAT", "PARAM_SET", "PARAM_REQUEST_READ",
    "PARAM_REQUEST_LIST", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_REQUEST", "MISSION_REQUEST_INT",
    "MISSION_REQUEST_LIST", "MISSION_ACK", "MISSION_CLEAR_ALL", "MISSION_SET_CURRENT", "MISSION_WRITE_PARTIAL_LIST",
    "REQUEST_DATA_STREAM", "CHANGE_OPERATOR_CONTROL", "TIMESYNC", "PING", "SET_GPS_GLOBAL_ORIGIN", "SET_HOME_POSITION",
    "FILE_TRANSFER_PROTOCOL", "LOGGING_ACK", "STATUSTEXT", "SYSTEM_TIME",
)  # fmt: skip
"""Messages that a vehicle acts upon, the more often the more it does."""

AIMED_AT_STATION = (
    "HEARTBEAT", "HEARTBEAT", "STATUSTEXT", "STATUSTEXT", "PARAM_VALUE", "PARAM_VALUE", "MISSION_COUNT",
    "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK", "MISSION_CURRENT",
    "MISSION_ITEM_REACHED", "COMMAND_ACK", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT", "POSITION_TARGET_LOCAL_NED", "ATTITUDE_TARGET", "ACTUATOR_OUTPUT_STATUS", "RAW_RPM",
    "SERVO_OUTPUT_RAW", "OBSTACLE_DISTANCE", "DISTANCE_SENSOR", "BATTERY_STATUS", "SYS_STATUS", "EXTENDED_SYS_STATE",
    "AUTOPILOT_VERSION", "DEBUG_FLOAT_ARRAY", "NAMED_VALUE_INT", "NAMED_VALUE_FLOAT", "VISION_POSITION_ESTIMATE",
    "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "GPS_RAW_INT", "TIMESYNC", "PING", "CHANGE_OPERATOR_CONTROL_ACK",
    "VFR_HUD", "RC_CHANNELS", "OPEN_DRONE_ID_LOCATION",
)  # fmt: skip
"""Messages that a station acts upon."""

_INTEGERS = {
    "uint8_t": (0, 2**8 - 1, "B"), "int8_t": (-(2**7), 2**7 - 1, "b"),
    "uint16_t": (0, 2**16 - 1, "H"), "int16_t": (-(2**15), 2**15 - 1, "h"),
    "uint32_t": (0, 2**32 - 1, "I"), "int32_t": (-(2**31), 2**31 - 1, "i"),
    "uint64_t": (0, 2**64 - 1, "Q"), "int64_t": (-(2**63), 2**63 - 1, "q"),
    "uint8_t_mavlink_version": (0, 2**8 - 1, "B"),
}  # fmt: skip
_FLOATS = (
    0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e-45, 1e30, -1e9, 65536.0, 2989.0, 21196.0,
    0.5, 1e4, -400.0,
)  # fmt: skip
_DOUBLES = (*_FLOATS, 1e308, -1e308, 5e-324)
_BY_NAME = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}
_COMMANDS = sorted(mavlink.enums["MAV_CMD"])
_PLAIN_COMMANDS = (16, 20, 21, 22, 23, 24, 115, 176, 177, 178, 179, 185, 189, 191, 192, 193, 210, 224, 241, 246, 300,
                   400, 410, 500, 510, 511, 512, 519, 520, 521, 530, 2500, 4501, 32100)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Packet:
    """Bytes as they come from a socket at once. ``messages`` counts the frames that were put in, whole or not."""

    kind: str
    data: bytes
    messages: int


class Hostile:
    """Makes packets.

    Parameters
    ----------
    seed : int
        Same seed, same packets.
    aimed_at : sequence of str
        Names of the messages that the other end acts upon.
    parameters : sequence of str
        Names of parameters that the other end has.
    targets : sequence of (int, int)
        System and component that it answers to.
    senders : sequence of (int, int)
        Whom the frames claim to come from, mostly.
    allowed : callable, optional
        Judges a message by name and fields; those it turns down are drawn anew. Leaves out what the other end rightly
        obeys whoever says it, as a vehicle does an emergency stop.
    floats, texts : sequence of float, sequence of bytes
        Corners of the fields of single precision; texts that half of the fields of text hold, cut to their length.
    """

    def __init__(
        self,
        seed: int,
        aimed_at: Sequence[str] = AIMED_AT_VEHICLE,
        *,
        parameters: Sequence[str] = (),
        targets: Sequence[tuple[int, int]] = ((1, 1), (0, 0), (1, 0)),
        senders: Sequence[tuple[int, int]] = ((66, 190), (67, 190), (255, 230)),
        allowed: Callable[[str, dict[str, Any]], bool] | None = None,
        floats: Sequence[float] = _FLOATS,
        texts: Sequence[bytes] = (),
    ) -> None:
        self._random = random.Random(seed)
        self._aimed_at, self._parameters = tuple(aimed_at), tuple(parameters)
        self._targets, self._senders, self._allowed = tuple(targets), tuple(senders), allowed
        self._floats, self._texts = tuple(floats), tuple(texts)
        self._all = sorted(_BY_NAME)
        self._sequence = 0
        self._recent = [b"\xfd\x09\x00\x00"]

    def packets(self) -> Iterator[Packet]:
        """Yield packets without end."""
        draw = self._random
        kinds = ("field", "aimed", "damaged", "noise", "old", "burst")
        while True:
            kind = draw.choices(kinds, weights=(30, 45, 15, 5, 4.8, 0.2))[0]
            if kind == "field":
                yield Packet(kind, self._frame(draw.choice(self._all), 0.0), 1)
            elif kind == "aimed":
                yield Packet(kind, self._frame(draw.choice(self._aimed_at), 0.8), 1)
            elif kind == "damaged":
                yield Packet(kind, self._damaged(), 1)
            elif kind == "noise":
                yield Packet(kind, self._noise(), 1)
            elif kind == "old":
                yield Packet(kind, self._old(), 1)
            else:
                count, name = draw.randint(20, 200), draw.choice(self._aimed_at)
                yield Packet(kind, b"".join(self._frame(name, 0.9) for _ in range(count)), count)

    # frames

    def _frame(self, name: str, sense: float) -> bytes:
        kind = _BY_NAME[name]
        for _ in range(20):
            fields = self._fields(kind, sense)
            if self._allowed is None or self._allowed(name, fields):
                break
        else:
            return b""
        frame = self._pack(kind, fields)
        if len(self._recent) < 64:
            self._recent.append(frame)
        else:
            self._recent[self._random.randrange(64)] = frame
        return frame

    def _pack(self, kind: Any, fields: dict[str, Any]) -> bytes:
        values: list[Any] = []
        for field in kind.ordered_fieldnames:
            value = fields[field]
            if isinstance(value, list):
                values.extend(value)
            else:
                values.append(value)
        payload = kind.unpacker.pack(*values).rstrip(b"\0") or b"\0"
        return self._wrap(0xFD, kind.id, payload, kind.crc_extra)

    def _wrap(self, magic: int, number: int, payload: bytes, extra: int, flags: int = 0) -> bytes:
        system, component = (
            self._random.choice(self._senders)
            if self._random.random() < 0.95
            else (self._random.randrange(256), self._random.randrange(256))
        )
        self._sequence = (self._sequence + 1) % 256
        if magic == 0xFE:
            head = struct.pack("<BBBBBB", magic, len(payload), self._sequence, system, component, number % 256)
        else:
            head = struct.pack("<BBBBBBB", magic, len(payload), flags, 0, self._sequence, system, component)
            head += number.to_bytes(3, "little")
        check = mavlink.x25crc(head[1:] + payload + bytes((extra,)))
        return head + payload + struct.pack("<H", check.crc)

    def _fields(self, kind: Any, sense: float) -> dict[str, Any]:
        out: dict[str, Any] = {}
        lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
        for field, type_ in zip(kind.fieldnames, kind.fieldtypes, strict=True):
            many = lengths[field]
            sensible = self._random.random() < sense
            if type_ == "char":
                out[field] = self._text(field, many, sensible)
            elif many:
                out[field] = [self._value(field, type_, sensible) for _ in range(many)]
            else:
                out[field] = self._value(field, type_, sensible)
        if sense and "target_system" in out and self._random.random() < 0.9:
            out["target_system"], component = self._random.choice(self._targets)
            if "target_component" in out:
                out["target_component"] = component
        return out

    def _text(self, field: str, size: int, sensible: bool) -> bytes:
        draw = self._random
        if self._texts and draw.random() < 0.5:
            return draw.choice(self._texts)[:size]
        if sensible and field == "param_id" and self._parameters:
            return draw.choice(self._parameters).encode()[:size]
        if sensible:
            return b"text " + bytes(draw.choices(b"abcdefgh %s\0{}", k=draw.randrange(max(1, size - 4))))
        return draw.randbytes(size)

    def _value(self, field: str, type_: str, sensible: bool) -> float | int:
        draw = self._random
        if sensible:
            value = self._sensible(field)
            if value is not None:
                if type_ in ("float", "double"):
                    return float(value)
                least, greatest, _ = _INTEGERS[type_]
                return min(max(int(value), least), greatest)
        if type_ in ("float", "double"):
            if draw.random() < 0.5:
                return draw.choice(self._floats if type_ == "float" else _DOUBLES)
            return draw.choice((draw.uniform(-5.0, 5.0), draw.uniform(-1e3, 1e3), float(draw.randrange(512))))
        least, greatest, _ = _INTEGERS[type_]
        corners = (least, greatest, 0, 1, greatest - 1, greatest // 2)
        return draw.choice(corners) if draw.random() < 0.4 else draw.randint(least, greatest)

    def _sensible(self, field: str) -> float | int | None:
        """A value that gets past the first checks; None where there is no better one than at random."""
        draw = self._random
        if field == "command":
            return draw.choice(_PLAIN_COMMANDS if draw.random() < 0.7 else _COMMANDS)
        if field.startswith("param") and field[5:].isdigit():
            return draw.choice((0.0, 1.0, 2.0, math.nan, -1.0, float(draw.randrange(450)), draw.uniform(-4.0, 4.0)))
        choices: dict[str, tuple[float, ...]] = {
            "frame": (0, 1, 1, 1, 3, 6, 7, 8, 9, 12),
            "coordinate_frame": (1, 1, 1, 7, 8, 9, 5, 6),
            "type_mask": (0, 0x0DF8, 0x0DC7, 0x0BF8, 0x0E07, 0x0FF8, 0x09F8, 0x0FFF, 0x0C00),
            "mission_type": (0, 0, 0, 0, 1, 2, 255),
            "count": (0, 1, 3, 10, 500, 501, 65535),
            "seq": (0, 0, 1, 2, 3, 65535),
            "base_mode": (209, 81, 157, 1, 0, 128),
            "custom_mode": tuple(m << 16 | s << 24 for m in range(9) for s in range(9)),
            "type": (6, 2, 3, 18, 27),
            "autopilot": (8, 12, 3, 0),
            "req_message_rate": (0, 1, 10, 100, 65535),
            "start_stop": (0, 1),
            "severity": (0, 2, 4, 6),
            "result": (0, 1, 2, 3, 4, 5, 6, 7, 8, 9),
            "param_count": (0, 30, 65535),
            "param_index": (0, 1, 29, -1, 65535),
            "param_type": (9, 9, 6, 1, 10),
            "autocontinue": (0, 1),
            "control_request": (0, 1),
        }
        if field in choices:
            return draw.choice(choices[field])
        if field in ("x", "y"):
            return draw.choice((draw.uniform(-4.0, 4.0), draw.randrange(-40_000, 40_000), draw.randrange(-1000, 1000)))
        if field == "z":
            return draw.choice((draw.uniform(-4.0, 0.5), draw.randrange(1000)))
        if field in ("r", "yaw", "vx", "vy", "vz", "afx", "afy", "afz", "yaw_rate"):
            return draw.uniform(-2.0, 2.0)
        if field.startswith("chan") and field.endswith("_raw"):
            return draw.choice((0, 1000, 1500, 2000, 65535, draw.randrange(900, 2100)))
        if field == "param_value":
            return draw.choice((draw.uniform(0.0, 5.0), float(draw.randrange(100))))
        return None

    # what is not a frame

    def _damaged(self) -> bytes:
        draw = self._random
        data = bytearray(draw.choice(self._recent))
        way = draw.randrange(6)
        if way == 0:
            for _ in range(draw.randint(1, 8)):
                data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        elif way == 1:
            del data[draw.randrange(len(data)) :]
        elif way == 2:
            at = draw.randrange(len(data))
            del data[at : at + draw.randint(1, 4)]
        elif way == 3:
            data *= draw.randint(2, 4)
        elif way == 4:
            at = draw.randrange(len(data))
            data[at:at] = draw.choice(self._recent)
        else:
            data = data[: draw.randrange(len(data) + 1)] + draw.choice(self._recent)
        return bytes(data) or b"\0"

    def _noise(self) -> bytes:
        draw = self._random
        data = draw.randbytes(draw.choice((1, 3, 20, 280, 1400)))
        return draw.choice((b"", b"\xfd", b"\xfe", b"\xfd\xff\x01\x00", b"\xfe\xff")) + data

    def _old(self) -> bytes:
        draw = self._random
        way = draw.randrange(3)
        if way == 0:
            name = draw.choice([n for n in self._aimed_at if _BY_NAME[n].id < 256])
            kind = _BY_NAME[name]
            fields = self._fields(kind, 0.8)
            if self._allowed is not None and not self._allowed(name, fields):
                return b"\xfe"
            values: list[Any] = []
            for field in kind.ordered_fieldnames:
                value = fields[field]
                values.extend(value if isinstance(value, list) else [value])
            payload = kind.unpacker.pack(*values)
            return self._wrap(0xFE, kind.id, payload, kind.crc_extra)
        if way == 1:
            return self._wrap(0xFD, draw.randrange(1 << 24), draw.randbytes(draw.randrange(256)), draw.randrange(256))
        frame = bytearray(draw.choice(self._recent))
        if len(frame) > 3:
            frame[2] |= 0x01
        return bytes(frame) + draw.randbytes(13)
