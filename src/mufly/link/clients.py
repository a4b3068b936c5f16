"""Who commands: one station at a time, the others watch.

The first to command takes command. It keeps it until it hands over, or has not been heard for :data:`SILENT_S`; then
the next to command has it. A station is a sender (system, component) behind a peer; anything that it says is a sign
of life.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from mufly.link import telemetry as motion
from mufly.link import telemetry as status
from mufly.link.codec import Encoder, MavMessage, Outgoing, Texts, mavlink
from mufly.link.telemetry import Picture

SILENT_S = 5.0
"""After so long without a word the commander may be replaced (s)."""


class Sender(NamedTuple):
    """Who said something: a system and component behind a peer."""

    peer: Hashable
    system: int
    component: int

    def __str__(self) -> str:
        address = getattr(self.peer, "address", None) or str(self.peer)
        return f"system {self.system} at {address}"


@dataclass(slots=True)
class Authority:
    """Who commands, and when it was last heard.

    Attributes
    ----------
    commander : Sender or None
    """

    commander: Sender | None = None
    _heard_s: float = -math.inf

    def hear(self, now_s: float, sender: Sender) -> None:
        """Note a sign of life."""
        if sender == self.commander:
            self._heard_s = now_s

    def claim(self, now_s: float, sender: Sender) -> bool:
        """Return whether ``sender`` commands, which it does from now on if nobody else does."""
        if self.commander not in (None, sender) and self.silent_s(now_s) < SILENT_S:
            return False
        self.commander, self._heard_s = sender, now_s
        return True

    def release(self, sender: Sender) -> bool:
        """Hand over; returns whether ``sender`` had anything to hand over."""
        if sender != self.commander:
            return False
        self.commander = None
        return True

    def silent_s(self, now_s: float) -> float:
        """For how long the commander has not been heard (s); 0 if there is none."""
        return 0.0 if self.commander is None else max(0.0, now_s - self._heard_s)


# ----------------------------------------------------------------------------
# Which message goes out how often, to each peer by its own wish.
#
# :data:`STREAMS` is the table of all messages that can be streamed or asked for, with the rates that a peer gets who
# says nothing. Wishes come as SET_MESSAGE_INTERVAL (one message, interval in us; 0: default, -1: never) and, from
# older
# programs, as REQUEST_DATA_STREAM (a group of messages at a rate).


MOST_HZ = 200.0
"""No message is streamed faster, whatever is asked (Hz)."""

Make = Callable[[Picture], MavMessage | list[MavMessage] | None]


@dataclass(frozen=True, slots=True)
class Stream:
    """One message of the table.

    Attributes
    ----------
    name : str
        Of the message; where several share one, what tells them apart follows in brackets.
    number : int
        Id of the message.
    default_Hz : float
        Rate for a peer that does not ask; 0: only on request.
    groups : tuple of int
        MAV_DATA_STREAM groups that it belongs to.
    make : callable
        Picture -> message, several, or None where there is nothing to tell.
    """

    name: str
    number: int
    default_Hz: float
    groups: tuple[int, ...]
    make: Make


_STATUS, _RC, _RAW, _POSITION, _EXTRA1, _EXTRA2, _EXTRA3 = 2, 3, 4, 6, 10, 11, 12


def _stream(name: str, default_Hz: float, groups: tuple[int, ...], make: Make) -> Stream:
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{name.split(' ')[0]}")
    return Stream(name, number, default_Hz, groups, make)


STREAMS: tuple[Stream, ...] = (
    _stream("HEARTBEAT", 1.0, (), status.heartbeat),
    _stream("SYS_STATUS", 2.0, (_STATUS,), status.sys_status),
    _stream("SYSTEM_TIME", 1.0, (_STATUS,), status.system_time),
    _stream("BATTERY_STATUS", 1.0, (_STATUS,), status.battery_status),
    _stream("EXTENDED_SYS_STATE", 2.0, (_STATUS,), status.extended_sys_state),
    _stream("MISSION_CURRENT", 2.0, (_STATUS,), status.mission_current),
    _stream("NAMED_VALUE_INT (mstate)", 5.0, (_STATUS,), status.mission_state),
    _stream("NAMED_VALUE_INT (command)", 1.0, (_STATUS,), status.command),
    _stream("ATTITUDE", 20.0, (_EXTRA1,), motion.attitude),
    _stream("ATTITUDE_QUATERNION", 5.0, (_EXTRA1,), motion.attitude_quaternion),
    _stream("LOCAL_POSITION_NED", 20.0, (_POSITION,), motion.local_position_ned),
    _stream("POSITION_TARGET_LOCAL_NED", 10.0, (_POSITION,), motion.position_target_local_ned),
    _stream("ATTITUDE_TARGET", 10.0, (_EXTRA1,), motion.attitude_target),
    _stream("VISION_POSITION_ESTIMATE", 5.0, (_RAW,), motion.vision_position_estimate),
    _stream("ACTUATOR_OUTPUT_STATUS", 10.0, (_RC,), motion.actuator_output_status),
    _stream("RAW_RPM", 5.0, (_RC,), motion.raw_rpm),
    _stream("OBSTACLE_DISTANCE", 5.0, (_EXTRA3,), motion.obstacle_distance),
    _stream("DISTANCE_SENSOR", 1.0, (_EXTRA3,), motion.distance_sensors),
    _stream("VFR_HUD", 5.0, (_EXTRA2,), motion.vfr_hud),
    _stream("ALTITUDE", 5.0, (_POSITION,), status.altitude),
    _stream("DEBUG_FLOAT_ARRAY", 0.0, (), motion.truth),
    _stream("GLOBAL_POSITION_INT", 5.0, (_POSITION,), status.global_position_int),
    _stream("GPS_RAW_INT", 2.0, (_POSITION,), status.gps_raw_int),
    _stream("HOME_POSITION", 0.5, (_POSITION,), status.home_position),
    _stream("GPS_GLOBAL_ORIGIN", 0.2, (_POSITION,), status.gps_global_origin),
    _stream("AUTOPILOT_VERSION", 0.0, (), status.autopilot_version),
)
"""Everything that can be streamed or asked for."""

_BY_NUMBER = {n: [k for k, s in enumerate(STREAMS) if s.number == n] for n in {s.number for s in STREAMS}}


class Wishes:
    """What one peer wants, and when each message is due.

    Parameters
    ----------
    now_s : float
    """

    def __init__(self, now_s: float) -> None:
        self._period_s = [_period(s.default_Hz) for s in STREAMS]
        self._due_s = [now_s] * len(STREAMS)
        self._once: list[int] = []

    def known(self, number: int) -> bool:
        """Whether a message can be streamed or asked for."""
        return number in _BY_NUMBER

    def set_interval(self, now_s: float, number: int, interval_us: float) -> bool:
        """Take a wish; returns whether there is such a message and interval."""
        if number not in _BY_NUMBER or not (interval_us == -1.0 or 0.0 <= interval_us < math.inf):
            return False
        for k in _BY_NUMBER[number]:
            if interval_us == 0.0:
                period = _period(STREAMS[k].default_Hz)
            else:
                period = math.inf if interval_us < 0.0 else max(interval_us * 1e-6, 1.0 / MOST_HZ)
            self._set(now_s, k, period)
        return True

    def interval_us(self, number: int) -> int:
        """The interval of a message (us); -1: never, 0: there is no such message."""
        if number not in _BY_NUMBER:
            return 0
        period = min(self._period_s[k] for k in _BY_NUMBER[number])
        return -1 if period == math.inf else min(round(period * 1e6), 2**31 - 1)

    def set_group(self, now_s: float, group: int, rate_Hz: float) -> None:
        """Take the older form of a wish: a group of messages (0: all that are streamed by default) at a rate."""
        for k, stream in enumerate(STREAMS):
            if stream.default_Hz and stream.groups and (group == 0 or group in stream.groups):
                self._set(now_s, k, _period(min(rate_Hz, MOST_HZ)))

    def ask_once(self, number: int) -> bool:
        """Want a message once, now; returns whether there is such a message."""
        wanted = _BY_NUMBER.get(number, [])
        self._once += [k for k in wanted if k not in self._once]
        return bool(wanted)

    def due(self, now_s: float) -> Iterator[int]:
        """Yield the places in :data:`STREAMS` of what is due, and count it as sent.

        A peer that could not be served for a while gets the next message of each kind, not all that it missed.
        """
        once, self._once = self._once, []
        yield from once
        for k, due_s in enumerate(self._due_s):
            if now_s >= due_s - 1e-6:
                period = self._period_s[k]
                self._due_s[k] = due_s + period if now_s - due_s < period else now_s + period
                if k not in once and period < math.inf:
                    yield k

    def _set(self, now_s: float, k: int, period_s: float) -> None:
        if period_s != self._period_s[k]:
            self._period_s[k] = period_s
            self._due_s[k] = now_s if period_s < math.inf else math.inf


def _period(rate_Hz: float) -> float:
    return 1.0 / rate_Hz if rate_Hz > 0.0 else math.inf


# ----------------------------------------------------------------------------
# Whom the vehicle talks to: each peer with its own numbering, its own wishes, and its last sign of life.


CLIENTS = 32
"""So many peers are served; the one that was silent for longest makes room."""
GONE_S = 15.0
"""A peer that called and has been silent for so long is sent nothing more (s)."""


@dataclass(slots=True)
class Client:
    """One peer.

    Attributes
    ----------
    peer : hashable
    encode : Encoder
    wishes : Wishes
    fixed : bool
        Whether the vehicle was told to send there, whoever may listen.
    heard_s : float
        When it was last heard.
    told_s : float
        When it was last told why it may not command.
    """

    peer: Hashable
    encode: Encoder
    wishes: Wishes
    fixed: bool
    heard_s: float
    told_s: float = -math.inf


class Clients:
    """All peers.

    Parameters
    ----------
    system, component : int
        Who the vehicle is.
    """

    def __init__(self, system: int, component: int) -> None:
        self._who = (system, component)
        self._all: dict[Hashable, Client] = {}

    def __iter__(self) -> Iterator[Client]:
        return iter(list(self._all.values()))

    def __len__(self) -> int:
        return len(self._all)

    def get(self, peer: Hashable) -> Client | None:
        """Return a peer that is served."""
        return self._all.get(peer)

    def hear(self, now_s: float, peer: Hashable) -> Client:
        """Note a sign of life of a peer, which is served from now on."""
        client = self._all.get(peer)
        if client is None:
            client = self.add(now_s, peer, fixed=False)
        client.heard_s = now_s
        return client

    def add(self, now_s: float, peer: Hashable, *, fixed: bool) -> Client:
        """Serve a peer."""
        client = Client(peer, Encoder(*self._who), Wishes(now_s), fixed, now_s)
        self._all[peer] = client
        return client

    def drop(self, peer: Hashable) -> None:
        """Serve a peer no more."""
        self._all.pop(peer, None)

    def leaving(self, now_s: float) -> list[Client]:
        """Those who have been silent for too long, and those whom there is no room for."""
        guests = sorted((c for c in self._all.values() if not c.fixed), key=lambda c: c.heard_s)
        surplus = max(0, len(self._all) - CLIENTS)
        return [c for k, c in enumerate(guests) if k < surplus or now_s - c.heard_s > GONE_S]


# ----------------------------------------------------------------------------
# What the vehicle says, and to whom: packs messages for each peer and keeps them until they are sent.


_TELL_EVERY_S = 2.0


class Voice:
    """Speaks to all peers.

    Parameters
    ----------
    system, component : int
        Who the vehicle is.

    Attributes
    ----------
    clients : Clients
        The peers.
    """

    def __init__(self, system: int, component: int) -> None:
        self.clients = Clients(system, component)
        self._texts = Texts()
        self._out: list[Outgoing] = []

    def send(self, peer: Hashable | None, message: MavMessage) -> None:
        """Send a message to a peer; to all if None."""
        for client in self.clients:
            if peer is None or client.peer == peer:
                self._out.append(Outgoing(client.peer, client.encode(message)))

    def say(self, text: str, level: str = "info", peer: Hashable | None = None) -> None:
        """Say a line to a peer; to all if None."""
        for message in self._texts(text, level):
            self.send(peer, message)

    def tell(self, now_s: float, sender: Sender, why: str) -> None:
        """Tell a station why something is refused, but not with every message of a stream."""
        client = self.clients.get(sender.peer)
        if why and client is not None and now_s - client.told_s > _TELL_EVERY_S:
            client.told_s = now_s
            self.say(why, "warning", sender.peer)

    def taken(self) -> list[Outgoing]:
        """Hand over what is to be sent."""
        out, self._out = self._out, []
        return out
