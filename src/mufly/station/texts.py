"""What a vehicle says in words: STATUSTEXT, put together again where it came in pieces.

A text longer than fifty bytes comes in chunks with a common id; a chunk that is shorter than that ends it. Pieces that
were lost leave "..." in their place. Source: https://mavlink.io/en/messages/common.html#STATUSTEXT.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from mufly.link.dialect import MavMessage
from mufly.station.view import Message

__all__ = ["Texts"]

KEPT = 500
_CHUNK = 50
_WAIT_S = 2.0
_LEVELS = ("error", "error", "error", "error", "warning", "info", "info", "info")  # MAV_SEVERITY


@dataclass(slots=True)
class _Open:
    """A text of which pieces are missing."""

    since_s: float
    severity: int
    pieces: dict[int, str] = field(default_factory=dict)
    last: int | None = None


class Texts:
    """The messages of one vehicle, newest last.

    Attributes
    ----------
    messages : deque of Message
        Of bounded length.
    newest : tuple of (now_s, text)
        What was said last, by our clock; the reason of a refusal comes this way.
    on_message : callable or None
        Told of every message, for a recording.
    """

    def __init__(self) -> None:
        self.messages: deque[Message] = deque(maxlen=KEPT)
        self.newest: tuple[float, str] = (-math.inf, "")
        self.on_message: Callable[[Message], None] | None = None
        self._open: dict[tuple[int, int], _Open] = {}

    def handle(self, now_s: float, time_s: float, message: MavMessage) -> None:
        """Take a STATUSTEXT; ``time_s`` is the vehicle's clock."""
        text = str(message.text).rstrip("\0")
        if message.id == 0:
            self._said(now_s, time_s, message.severity, text)
            return
        key = (message.get_srcComponent(), message.id)
        if key not in self._open and len(self._open) >= 8:
            self._close(now_s, time_s, next(iter(self._open)))
        waiting = self._open.setdefault(key, _Open(now_s, message.severity))
        waiting.pieces[message.chunk_seq] = text
        if len(text.encode()) < _CHUNK:
            waiting.last = message.chunk_seq
        if waiting.last is not None and len(waiting.pieces) > waiting.last:
            self._close(now_s, time_s, key)

    def step(self, now_s: float, time_s: float) -> None:
        """Say what came of texts that wait for a piece that was lost."""
        for key in [k for k, waiting in self._open.items() if now_s - waiting.since_s > _WAIT_S]:
            self._close(now_s, time_s, key)

    def note(self, time_s: float, level: str, text: str) -> None:
        """Add a message of the station's own."""
        self._add(Message(time_s, level, text))

    def since(self, now_s: float) -> str:
        """Return what was said last if it was said since; "" if nothing was."""
        return self.newest[1] if self.newest[0] >= now_s else ""

    def _close(self, now_s: float, time_s: float, key: tuple[int, int]) -> None:
        waiting = self._open.pop(key)
        last = max(waiting.pieces) if waiting.last is None else waiting.last
        text = "".join(waiting.pieces.get(k, "...") for k in range(last + 1))
        self._said(now_s, time_s, waiting.severity, text + ("..." if waiting.last is None else ""))

    def _said(self, now_s: float, time_s: float, severity: int, text: str) -> None:
        self.newest = (now_s, text)
        self._add(Message(time_s, _LEVELS[min(severity, 7)], text))

    def _add(self, message: Message) -> None:
        self.messages.append(message)
        if self.on_message is not None:
            self.on_message(message)
