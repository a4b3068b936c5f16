"""Whom the vehicle talks to: each peer with its own numbering, its own wishes, and its last sign of life."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator
from dataclasses import dataclass

from mufly.link.codec import Encoder
from mufly.link.streams import Wishes

__all__ = ["CLIENTS", "GONE_S", "Client", "Clients"]

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
