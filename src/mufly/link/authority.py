"""Who commands: one station at a time, the others watch.

The first to command takes command. It keeps it until it hands over, or has not been heard for :data:`SILENT_S`; then
the next to command has it. A station is a sender (system, component) behind a peer; anything that it says is a sign
of life.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["SILENT_S", "Authority", "Sender"]

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
