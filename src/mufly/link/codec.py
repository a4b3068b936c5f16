"""MAVLink codec: the dialect, frames, and lines of text.

Both ends of the link speak ``common``, in version 2 of the wire format. pymavlink decides by an environment
variable, when it is first imported, which wire format it packs; so it is imported here and nowhere else in this room.
Source of every message, field and enumeration: https://mavlink.io/en/messages/common.html

Each sender (system, component) numbers its packets from 0 to 255 on each channel, so that gaps show losses
(https://mavlink.io/en/guide/packet_loss.html). A packet with the number and checksum of a recent one is a duplicate; a
number slightly behind the newest is out of order. Frames of MAVLink 1 and 2 are read, MAVLink 2 is sent
(https://mavlink.io/en/guide/serialization.html).

No input raises an error: bytes outside frames are skipped until a frame is found, and counted. The memory kept for a
peer is bounded by the longest frame and by :data:`MAX_SENDERS` senders.

A text line (STATUSTEXT) longer than 50 bytes is cut into chunks. The chunks have the same id and count from 0; the
first chunk that is not full is the last. ``...`` replaces lost chunks.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from mufly.errors import ArgumentError, InputError
from mufly.logs.tlog import mavlink_packet_length_at
from mufly.mission import State
from mufly.mission.files.mission_items import COORDINATE_NOT_GIVEN as COORDINATE_NOT_GIVEN
from mufly.mission.files.mission_items import FRAMES_ABOVE_ORIGIN as FRAMES_ABOVE_ORIGIN
from mufly.mission.files.mission_items import FRAMES_ABOVE_SEA as FRAMES_ABOVE_SEA
from mufly.mission.files.mission_items import FRAMES_ABOVE_TERRAIN as FRAMES_ABOVE_TERRAIN
from mufly.mission.files.mission_items import GlobalOrigin as GlobalOrigin
from mufly.mission.files.mission_items import decode_coordinate as decode_coordinate
from mufly.quantities.quantity_grammar import parse_quantity

os.environ["MAVLINK20"] = "1"
with contextlib.redirect_stdout(io.StringIO()):
    from pymavlink.dialects.v20 import common

mavlink = common
MavMessage = Any
"""A message of pymavlink (``mavlink.MAVLink_message``), which has no useful static type."""
MavlinkError: type[Exception] = mavlink.MAVError

MAX_FRAME_BYTES = 280
"""Length of the longest frame: ten bytes of header, 255 of payload, two of checksum, thirteen of signature."""
MAX_SENDERS = 64
"""Largest number of senders tracked on one channel; losses of further senders are not counted."""
MAX_TRACKED_PEERS = 128
"""Largest number of peers tracked; the peer that was silent for longest is forgotten."""
_REORDER_WINDOW = 32  # a number at most this far behind the newest is late; others are a jump
_DUPLICATE_WINDOW_S = 1.0  # the same packet after this time is a new one, of a restarted program
_MARKER_V1, _MARKER_V2, _FLAG_SIGNED = 0xFE, 0xFD, 0x01
_MESSAGE_ID_SLICE_V1, _MESSAGE_ID_SLICE_V2 = slice(5, 6), slice(7, 10)  # bytes of a frame
_TEXT_CHUNK_BYTES = 50
MAX_TEXT_BYTES = 400
"""Longest line (bytes); the rest is cut."""
SEVERITY_BY_LEVEL = {
    "error": mavlink.MAV_SEVERITY_ERROR,
    "warning": mavlink.MAV_SEVERITY_WARNING,
    "info": mavlink.MAV_SEVERITY_INFO,
}
_MAX_PARTIAL_TEXTS = 8  # greatest number of incomplete texts of one vehicle
_CHUNK_TIMEOUT_S = 2.0  # time that a text waits for missing chunks

"""Value of x and y in an integer message that means "not given"."""
MAX_FLOAT32 = 3.4028234663852886e38
"""The largest number of a ``float`` field."""


def to_float32(value: float) -> float:
    """Return ``value`` for a ``float`` field; NaN (unknown) beyond its range."""
    return float(value) if abs(value) <= MAX_FLOAT32 else math.nan


def clip_to_integer(value: float, least: int, greatest: int, unknown: int = 0) -> int:
    """Return ``value`` rounded and clipped to the range of an integer field; ``unknown`` if it is NaN."""
    if not math.isfinite(value):
        return unknown
    return int(min(max(round(value), least), greatest))


def scale_to_integer(value: float, factor: float) -> int:
    """Return ``value`` times ``factor`` for the integer field x or y of a message; :data:`NOT_GIVEN` if out of
    range.
    """
    number = value * factor
    return round(number) if math.isfinite(number) and abs(number) <= COORDINATE_NOT_GIVEN else COORDINATE_NOT_GIVEN


def encode_text_field(text: str, size: int = 50) -> bytes:
    """Return ``text`` as UTF-8 for a ``char[size]`` field, truncated to whole characters."""
    return text.encode(errors="replace")[:size].decode(errors="ignore").encode()


class MessageSource(NamedTuple):
    """Source of a message: peer on the link, MAVLink system and component."""

    peer: Hashable
    system: int
    component: int

    def __str__(self) -> str:
        address = getattr(self.peer, "address", None) or str(self.peer)
        return f"system {self.system} at {address}"


class OutgoingFrame(NamedTuple):
    """Bytes for a peer, or for all peers (None)."""

    peer: Hashable | None
    data: bytes


@dataclass(slots=True)
class PacketCounts:
    """Numbers of packets received, lost, duplicated and reordered, of one sender or of all senders of a peer."""

    received_count: int = 0
    lost_count: int = 0
    duplicate_count: int = 0
    reordered_count: int = 0
    unknown_count: int = 0
    garbage_bytes: int = 0

    @property
    def loss_ratio(self) -> float:
        """Share of lost packets, 0..1."""
        sent = self.received_count + self.lost_count
        return self.lost_count / sent if sent else 0.0


@dataclass(slots=True)
class _SequenceTracker:
    """Sequence numbers of one sender: the newest, and recent ones with time of receipt and checksum."""

    newest_number: int
    heard_packets: dict[int, tuple[float, int]] = field(default_factory=dict)

    def accept_number(self, now_s: float, number: int, checksum: int, counts: PacketCounts) -> bool:
        """Count a packet number; return whether the packet is new."""
        ahead = (number - self.newest_number) % 256
        behind = (256 - ahead) % 256
        before = self.heard_packets.get(number)
        if behind < _REORDER_WINDOW and before is not None:
            if before[1] == checksum and now_s - before[0] < _DUPLICATE_WINDOW_S:
                counts.duplicate_count += 1
                return False
            self.heard_packets.clear()  # same number, different packet: the sender restarted
            self.newest_number = number
        elif behind < _REORDER_WINDOW:
            counts.reordered_count += 1
            counts.lost_count = max(0, counts.lost_count - 1)
        elif ahead <= 256 - 2 * _REORDER_WINDOW:
            counts.lost_count += ahead - 1
            for k in range(1, ahead):
                self.heard_packets.pop((self.newest_number + k) % 256, None)
            self.newest_number = number
        else:  # neither ahead nor slightly behind: the sender restarted
            self.heard_packets.clear()
            self.newest_number = number
        self.heard_packets[number] = (now_s, checksum)
        counts.received_count += 1
        return True


@dataclass(slots=True)
class _PeerReception:
    """Reception from one peer: bytes of an incomplete frame, packet numbers of each MAVLink sender, packet counts."""

    buffer: bytearray = field(default_factory=bytearray)
    senders: dict[tuple[int, int], _SequenceTracker] = field(default_factory=dict)
    counts: PacketCounts = field(default_factory=PacketCounts)


class FrameDecoder:
    """Decoder of the frames of all peers.

    Parameters
    ----------
    keep_duplicates : bool
        Return packets that were received before, too. By default duplicates are dropped, because a network that doubles
        packets must not repeat a vehicle's actions.
    """

    def __init__(self, keep_duplicates: bool = False) -> None:
        self._keep = keep_duplicates
        self._channels: dict[Hashable, _PeerReception] = {}
        self._decoder = mavlink.MAVLink(None)

    def decode_bytes(self, now_s: float, peer: Hashable, data: bytes) -> list[MavMessage]:
        """Return the messages completed by these bytes, oldest first.

        Parameters
        ----------
        now_s : float
            Time of a monotonic clock (s).
        peer : hashable
            Channel on which the bytes arrived.
        data : bytes
            Bytes, which may begin or end inside a frame and may contain noise.
        """
        channel = self._channels.get(peer)
        if channel is None:
            channel = _PeerReception()
            if len(self._channels) >= MAX_TRACKED_PEERS:
                del self._channels[next(iter(self._channels))]
        else:
            del self._channels[peer]  # re-inserted at the end: the first entry is the longest silent
        self._channels[peer] = channel
        buffer, counts, out = channel.buffer, channel.counts, []
        buffer += data
        at = 0
        while True:
            start = _find_next_marker(buffer, at)
            counts.garbage_bytes += start - at
            at = start
            size = mavlink_packet_length_at(buffer, at)
            if size and at + size <= len(buffer):
                frame = bytes(buffer[at : at + size])
                message = self._decode_frame(frame)
                if message is None and not _is_unknown_message(frame, buffer, at + size):
                    counts.garbage_bytes += 1
                    at += 1
                    continue
                at += size
                if message is None:
                    counts.unknown_count += 1
                elif self._register_packet(now_s, channel, message):
                    out.append(message)
                continue
            # Incomplete. If a whole frame follows, this marker began none.
            later = self._find_next_frame(buffer, at)
            if later is None:
                break
            counts.garbage_bytes += later - at
            at = later
        del buffer[:at]
        return out

    def packet_counts(self, peer: Hashable) -> PacketCounts:
        """Return the packet counts of a peer."""
        channel = self._channels.get(peer)
        return channel.counts if channel is not None else PacketCounts()

    def forget_peer(self, peer: Hashable) -> None:
        """Drop the state of a peer that has gone."""
        self._channels.pop(peer, None)

    def _register_packet(self, now_s: float, channel: _PeerReception, message: MavMessage) -> bool:
        header = message.get_header()
        sender = (header.srcSystem, header.srcComponent)
        known = channel.senders.get(sender)
        if known is None:
            if len(channel.senders) >= MAX_SENDERS:
                channel.counts.received_count += 1
                return True
            known = channel.senders[sender] = _SequenceTracker((header.seq - 1) % 256)
        return known.accept_number(now_s, header.seq, message.get_crc(), channel.counts) or self._keep

    def _decode_frame(self, frame: bytes) -> MavMessage | None:
        """Return the message in a frame; None if its checksum is wrong or its id unknown."""
        if _message_id(frame) not in mavlink.mavlink_map:
            return None
        try:
            return self._decoder.decode(bytearray(frame))
        except MavlinkError:
            return None

    def _find_next_frame(self, buffer: bytearray, at: int) -> int | None:
        while at < len(buffer):
            at = _find_next_marker(buffer, at + 1)
            size = mavlink_packet_length_at(buffer, at)
            if size and at + size <= len(buffer) and self._decode_frame(bytes(buffer[at : at + size])) is not None:
                return at
        return None


class FrameEncoder:
    """Encoder of one sender's messages for one channel, numbered in the order of encoding.

    Parameters
    ----------
    system, component : int
        MAVLink address of the sender, 1..255.
    """

    def __init__(self, system: int, component: int) -> None:
        self._link = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def __call__(self, message: MavMessage) -> bytes:
        """Return the bytes of a message."""
        data: bytes = message.pack(self._link)
        self._link.seq = (self._link.seq + 1) % 256
        return data


def _find_next_marker(buffer: bytearray, at: int) -> int:
    """Return the index of the next frame marker; the end of the buffer if there is none."""
    found = [k for k in (buffer.find(_MARKER_V1, at), buffer.find(_MARKER_V2, at)) if k >= 0]
    return min(found, default=len(buffer))


def _message_id(frame: bytes) -> int:
    return int.from_bytes(frame[_MESSAGE_ID_SLICE_V1 if frame[0] == _MARKER_V1 else _MESSAGE_ID_SLICE_V2], "little")


def _is_unknown_message(frame: bytes, buffer: bytearray, end: int) -> bool:
    """Return whether a frame seems to hold a message unknown to this dialect, whose checksum cannot be verified."""
    if _message_id(frame) in mavlink.mavlink_map or (frame[0] == _MARKER_V2 and frame[2] & ~_FLAG_SIGNED):
        return False
    return end == len(buffer) or buffer[end] in (_MARKER_V1, _MARKER_V2)


class StatusTextSplitter:
    """Splitter of text lines into STATUSTEXT messages."""

    def __init__(self) -> None:
        self._last_id = 0

    def __call__(self, text: str, level: str = "info") -> list[MavMessage]:
        """Return the STATUSTEXT messages of a text, in order; ``level`` is "info", "warning" or "error"."""
        severity = SEVERITY_BY_LEVEL.get(level, mavlink.MAV_SEVERITY_INFO)
        data = " ".join(text.split()).encode(errors="replace")[:MAX_TEXT_BYTES]
        if len(data) <= _TEXT_CHUNK_BYTES:
            return [mavlink.MAVLink_statustext_message(severity, data)]
        self._last_id = self._last_id % 65535 + 1
        pieces = [data[k : k + _TEXT_CHUNK_BYTES] for k in range(0, len(data), _TEXT_CHUNK_BYTES)]
        if len(pieces[-1]) == _TEXT_CHUNK_BYTES:
            pieces.append(b"")  # a last chunk that is not full
        return [mavlink.MAVLink_statustext_message(severity, piece, self._last_id, k) for k, piece in enumerate(pieces)]


@dataclass(slots=True)
class _PartialText:
    """A text with missing chunks."""

    started_s: float
    severity: int
    chunks: dict[int, str] = field(default_factory=dict)
    last_chunk: int | None = None


class StatusTextAssembler:
    """Assembler of text lines from STATUSTEXT messages, the inverse of :class:`StatusTextSplitter`."""

    def __init__(self) -> None:
        self._waiting: dict[tuple[int, int], _PartialText] = {}

    def add_chunk(self, now_s: float, message: MavMessage) -> list[tuple[int, str]]:
        """Add a STATUSTEXT; return (MAV_SEVERITY, text) of each complete line, and of one dropped for lack of room."""
        text = str(message.text).rstrip("\0")
        if message.id == 0:
            return [(message.severity, text)]
        key, out = (message.get_srcComponent(), message.id), []
        if key not in self._waiting and len(self._waiting) >= _MAX_PARTIAL_TEXTS:
            out.append(self._join_chunks(next(iter(self._waiting))))
        waiting = self._waiting.setdefault(key, _PartialText(now_s, message.severity))
        waiting.chunks[message.chunk_seq] = text
        if len(text.encode()) < _TEXT_CHUNK_BYTES:
            waiting.last_chunk = message.chunk_seq
        if waiting.last_chunk is not None and len(waiting.chunks) > waiting.last_chunk:
            out.append(self._join_chunks(key))
        return out

    def take_overdue(self, now_s: float) -> list[tuple[int, str]]:
        """Return the texts that waited too long for a lost chunk, as far as received."""
        return [
            self._join_chunks(key) for key, w in list(self._waiting.items()) if now_s - w.started_s > _CHUNK_TIMEOUT_S
        ]

    def _join_chunks(self, key: tuple[int, int]) -> tuple[int, str]:
        waiting = self._waiting.pop(key)
        last = max(waiting.chunks) if waiting.last_chunk is None else waiting.last_chunk
        text = "".join(waiting.chunks.get(k, "...") for k in range(last + 1))
        return waiting.severity, text + ("..." if waiting.last_chunk is None else "")


# ----------------------------------------------------------------------------
# Conversions of MAVLink's numbers: global positions and flight modes.
#
# A flight uses metres north and east in the plane tangent to the globe at an origin. With the radii of curvature of the
# ellipsoid WGS 84 at the latitude phi of the origin (height h), meridional M and transverse N::
#
#     M = a (1 - e^2) / (1 - e^2 sin^2 phi)^(3/2),   N = a / (1 - e^2 sin^2 phi)^(1/2)
#     north = (M + h) d_phi,     east = (N + h) cos(phi) d_lambda,     down = h - altitude
#
# The error of the plane grows with the square of the distance d: about d^2 tan(phi) / (2 R) sideways and d^2 / (2 R) in
# height, 8 cm each for a kilometre at 45 degrees, 8 micrometres for ten metres. MAVLink counts latitude and longitude
# in 1e-7 degrees, which is 1.1 cm. Source: P. D. Groves, Principles of GNSS, Inertial and Multisensor Integrated
# Navigation Systems, 2nd ed., Sec. 2.4.
#
# States of the mission are reported as flight modes of PX4, which MAVLink programs know. MAVLink leaves ``custom_mode``
# to each autopilot; PX4 puts a main mode in its third byte and a sub mode in its fourth (PX4-Autopilot,
# ``src/modules/commander/px4_custom_mode.h``).
#
# ============= ==================== =============================================================================
# mission state PX4's mode           action when requested
# ============= ==================== =============================================================================
# init          AUTO READY (4, 1)    none
# take-off      AUTO TAKEOFF (4, 2)  take off
# hover         AUTO LOITER (4, 3)   stop and hover
# waypoint      AUTO MISSION (4, 4)  start or resume the mission; AUTO LOITER while a single point is flown to
# obstacle      mode after avoidance
# landing       AUTO LAND (4, 6)     land
# (return)      AUTO RTL (4, 5)      return above the take-off position, then land
# rc            ALTCTL (2, 0)        fly by sticks; MANUAL, POSCTL and STABILIZED mean the same
# offboard      OFFBOARD (6, 0)      follow streamed set-points
# ============= ==================== =============================================================================


def parse_global_origin(text: str) -> GlobalOrigin:
    """Return the global origin from a text ``LAT,LON,ALT`` in degrees and metres.

    Raises
    ------
    InputError
        If it is no position between 85 degrees south and north, where east is well defined.
    """
    parts = text.split(",")
    example = "give LAT,LON,ALT in degrees and metres, as in 47.3769,8.5417,408"
    if len(parts) != 3:
        raise ArgumentError("origin", "", f"{text!r} is not a global position", example)
    try:
        lat, lon, alt = (parse_quantity("", p, u) for p, u in zip(parts, ("deg", "deg", "m"), strict=True))
    except InputError as error:
        raise ArgumentError("origin", "", error.problem, example) from None
    if abs(lat) > 85.0 or abs(lon) > 180.0 or not -500.0 <= alt <= 9000.0:
        problem = f"{text!r} is outside of +-85, +-180 degrees and -500 to 9000 m"
        raise ArgumentError("origin", "", problem, example)
    return GlobalOrigin(lat, lon, alt)


ModeAction = Literal["take-off", "hover", "mission", "return", "land", "rc", "offboard", ""]


class Px4Mode(NamedTuple):
    """PX4 flight mode: main and sub mode."""

    main_mode: int
    sub_mode: int


MODE_READY, MODE_TAKE_OFF, MODE_LOITER, MODE_MISSION, MODE_RETURN, MODE_LAND = (Px4Mode(4, sub) for sub in range(1, 7))
MODE_ALTITUDE, MODE_OFFBOARD = Px4Mode(2, 0), Px4Mode(6, 0)

_ACTION_BY_MODE: dict[Px4Mode, ModeAction] = {
    MODE_TAKE_OFF: "take-off",
    MODE_LOITER: "hover",
    MODE_MISSION: "mission",
    MODE_RETURN: "return",
    MODE_LAND: "land",
    MODE_OFFBOARD: "offboard",
}
_MANUAL_MAIN_MODES = (1, 2, 3, 7)
_MODE_BY_STATE: dict[str, Px4Mode] = {
    State.INIT: MODE_READY,
    State.TAKE_OFF: MODE_TAKE_OFF,
    State.HOVER: MODE_LOITER,
    State.WAYPOINT: MODE_MISSION,
    State.OBSTACLE: MODE_MISSION,
    State.LANDING: MODE_LAND,
    State.RC: MODE_ALTITUDE,
    State.OFFBOARD: MODE_OFFBOARD,
}


def px4_mode_from_state(state: str, user_in_control: bool = False, returning: bool = False) -> Px4Mode:
    """Return the PX4 flight mode that corresponds to a mission state.

    Parameters
    ----------
    state : str
        A text of :class:`mufly.mission.State`.
    user_in_control : bool
        Whether a user's signal is flown instead of the mission.
    returning : bool
        Whether the vehicle is returning.
    """
    if returning and state in (State.WAYPOINT, State.OBSTACLE):
        return MODE_RETURN
    if user_in_control and state in (State.WAYPOINT, State.OBSTACLE):
        return MODE_LOITER
    return _MODE_BY_STATE[state]


def pack_custom_mode(mode: Px4Mode) -> int:
    """Return PX4's main and sub mode as the field ``custom_mode`` of a HEARTBEAT."""
    return mode.main_mode << 16 | mode.sub_mode << 24


def unpack_custom_mode(number: int) -> Px4Mode:
    """Return PX4's main and sub mode from the field ``custom_mode`` of a HEARTBEAT."""
    return Px4Mode(number >> 16 & 0xFF, number >> 24 & 0xFF)


def action_for_mode(mode: Px4Mode) -> ModeAction:
    """Return the name of the action, such as land, that a station requests with a PX4 mode; "" if unsupported."""
    if mode.main_mode in _MANUAL_MAIN_MODES:
        return "rc"
    return _ACTION_BY_MODE.get(Px4Mode(6, 0) if mode.main_mode == 6 else mode, "")
