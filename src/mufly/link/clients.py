"""Whom the vehicle talks to: each peer with its own numbering, its own wishes, and its last sign of life.

A peer is a channel of bytes; behind it speak stations, each a system and component. Which message goes out how often
is each peer's own wish: by default the rates of :data:`mufly.link.telemetry.STREAMS`, else what it asked for by
SET_MESSAGE_INTERVAL (one message, interval in us; 0: default, -1: never) or, as older programs do, by
REQUEST_DATA_STREAM (a group of messages at a rate).
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from mufly.link.codec import Encoder, MavMessage, Outgoing, Texts
from mufly.link.telemetry import STREAMS

MOST_HZ = 200.0
"""No message is streamed faster, whatever is asked (Hz)."""
CLIENTS = 32
"""So many peers are served; the one that was silent for longest makes room."""
GONE_S = 15.0
"""A peer that called and has been silent for so long is sent nothing more (s)."""
_TELL_EVERY_S = 2.0

_BY_NUMBER = {n: [k for k, s in enumerate(STREAMS) if s.number == n] for n in {s.number for s in STREAMS}}


class Source(NamedTuple):
    """Who said something: MAVLink's source system and component, behind a peer."""

    peer: Hashable
    system: int
    component: int

    def __str__(self) -> str:
        address = getattr(self.peer, "address", None) or str(self.peer)
        return f"system {self.system} at {address}"


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
            if stream.default_Hz and stream.group and group in (0, stream.group):
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
    """All peers, and what is to be sent to them: packed for each, and kept until it is taken.

    Parameters
    ----------
    system, component : int
        Who the vehicle is.
    """

    def __init__(self, system: int, component: int) -> None:
        self._who = (system, component)
        self._all: dict[Hashable, Client] = {}
        self._texts = Texts()
        self._out: list[Outgoing] = []

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
        client = self._all[peer] = Client(peer, Encoder(*self._who), Wishes(now_s), fixed, now_s)
        return client

    def drop_silent(self, now_s: float) -> list[Hashable]:
        """Serve no more who has been silent for too long, and whom there is no room for; returns who that is."""
        guests = sorted((c for c in self._all.values() if not c.fixed), key=lambda c: c.heard_s)
        surplus = max(0, len(self._all) - CLIENTS)
        leaving = [c.peer for k, c in enumerate(guests) if k < surplus or now_s - c.heard_s > GONE_S]
        for peer in leaving:
            del self._all[peer]
        return leaving

    def send(self, peer: Hashable | None, message: MavMessage) -> None:
        """Send a message to a peer; to all if None."""
        for client in self._all.values():
            if peer is None or client.peer == peer:
                self._out.append(Outgoing(client.peer, client.encode(message)))

    def say(self, text: str, level: str = "info", peer: Hashable | None = None) -> None:
        """Say a line to a peer; to all if None."""
        for message in self._texts(text, level):
            self.send(peer, message)

    def tell(self, now_s: float, station: Source, why: str) -> None:
        """Tell a station why something is refused, but not with every message of a stream."""
        client = self._all.get(station.peer)
        if why and client is not None and now_s - client.told_s > _TELL_EVERY_S:
            client.told_s = now_s
            self.say(why, "warning", station.peer)

    def taken(self) -> list[Outgoing]:
        """Hand over what is to be sent."""
        out, self._out = self._out, []
        return out
