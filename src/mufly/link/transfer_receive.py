"""The end of a mission transfer that wants the items (:mod:`mufly.link.transfer`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable

from mufly.link.transfer_notes import Ack, Count, Item, MissionResult, Note, Notes, RequestItem, RequestList
from mufly.link.transfer_pace import Pace

__all__ = ["LIMIT", "SETTLE_S", "Receiver"]

SETTLE_S = 1.0
"""For how long packets of an earlier transfer may still be under way (s)."""

LIMIT = 500
"""Most items that a receiver takes."""


class Receiver:
    """Fetches items from one peer at a time and hands them on whole.

    At a vehicle it waits for somebody's ``Count``; at a station :meth:`fetch` begins. It can be used again and again.

    Parameters
    ----------
    judge : callable
        Called with all items once they are there; returns what to acknowledge (:class:`MissionResult` or its number).
        Whatever it refuses, it must leave as it was.
    mission_type : int
        MAV_MISSION_TYPE; notes of others are passed over.
    limit : int
        More items are refused with ``NO_SPACE``.
    unasked : bool
        Whether a ``Count`` may begin a transfer (at a vehicle), or :meth:`fetch` alone (at a station).

    Attributes
    ----------
    peer : hashable
        Whose items are being fetched; None between transfers.
    result : int or None
        How the last transfer ended; None while one is under way, or before the first.
    timed_out : bool
        Whether it ended because nothing was heard any more.
    """

    def __init__(
        self,
        judge: Callable[[tuple[Item, ...]], int],
        *,
        mission_type: int = 0,
        limit: int = LIMIT,
        unasked: bool = True,
    ) -> None:
        self.mission_type, self.limit = mission_type, limit
        self.peer: Hashable = None
        self.result: int | None = None
        self.timed_out = False
        self._judge, self._unasked = judge, unasked
        self._fetching = False
        self._count: int | None = None
        self._items: list[Item] = []
        self._settled_s = self._touched_s = -math.inf
        self._done: tuple[Hashable, int, int] | None = (
            None  # peer, number of items and result of the last one
        )
        self._pace = Pace()

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self.peer is not None

    @property
    def progress(self) -> float:
        """Share of the items that are there, 0..1."""
        return len(self._items) / self._count if self._count else 0.0

    def fetch(self, now_s: float, peer: Hashable) -> Notes:
        """Ask a peer for its items; one transfer that is under way is dropped."""
        dropped = self.cancel()
        self._begin(now_s, peer, fetching=True)
        return [*dropped, (peer, RequestList(self.mission_type))]

    def receive(self, now_s: float, peer: Hashable, note: Note) -> Notes:
        """Take a note of a peer; notes that mean nothing here are passed over."""
        if getattr(note, "mission_type", None) != self.mission_type:
            return []
        if isinstance(note, Count):
            return self._offered(now_s, peer, note)
        if isinstance(note, Item):
            return self._given(now_s, peer, note)
        if isinstance(note, Ack) and peer == self.peer and note.result != MissionResult.ACCEPTED:
            self._end(now_s, note.result)
        return []

    def step(self, now_s: float) -> Notes:
        """Ask again for what may have been lost, or give up."""
        if self.peer is None:
            return []
        if self._pace.hopeless(now_s):
            self.timed_out = True
            return self._refuse(now_s, MissionResult.OPERATION_CANCELLED)
        if now_s < self._settled_s or not self._pace.again(now_s):
            return []
        return [(self.peer, self._question(now_s))]

    def cancel(self) -> Notes:
        """Stop; the peer is told, nothing is handed on."""
        if self.peer is None:
            return []
        return self._refuse(self._touched_s, MissionResult.OPERATION_CANCELLED)

    def _offered(self, now_s: float, peer: Hashable, note: Count) -> Notes:
        if self._fetching or not self._unasked:
            if not self._fetching or peer != self.peer or self._count is not None:
                return []
        elif self.busy and peer != self.peer:
            return [(peer, Ack(MissionResult.DENIED, self.mission_type))]
        else:
            self._begin(now_s, peer, fetching=False)
        if note.count > self.limit:
            return self._refuse(now_s, MissionResult.NO_SPACE)
        self._count = note.count
        if note.count == 0:
            return self._finish(now_s)
        self._pace.moved(now_s)
        return [] if now_s < self._settled_s else [(peer, self._question(now_s))]

    def _given(self, now_s: float, peer: Hashable, item: Item) -> Notes:
        if peer != self.peer:
            return self._acknowledge_again(now_s, peer, item)
        if now_s < self._settled_s or self._count is None or item.seq != len(self._items):
            self._touched_s = now_s
            return []
        self._items.append(item)
        self._pace.moved(now_s)
        if len(self._items) == self._count:
            return self._finish(now_s)
        return [(peer, self._question(now_s))]

    def _acknowledge_again(self, now_s: float, peer: Hashable, item: Item) -> Notes:
        """Answer the last item of the last transfer, which comes again when the answer was lost."""
        if self._done is None or self._done[:2] != (peer, item.seq + 1):
            return []
        self._touched_s = now_s
        return [(peer, Ack(self._done[2], self.mission_type))]

    def _question(self, now_s: float) -> Note:
        if self._count is None:
            return RequestList(self.mission_type)
        self._touched_s = now_s
        return RequestItem(len(self._items), self.mission_type)

    def _begin(self, now_s: float, peer: Hashable, *, fetching: bool) -> None:
        self.peer, self._fetching = peer, fetching
        self.result, self.timed_out, self._done = None, False, None
        self._count, self._items = None, []
        self._settled_s = self._touched_s + SETTLE_S
        self._pace = Pace()
        self._pace.begin(now_s)

    def _finish(self, now_s: float) -> Notes:
        peer, items = self.peer, tuple(self._items)
        result = int(self._judge(items))
        self._end(now_s, result)
        self._done = (peer, len(items), result)
        return [(peer, Ack(result, self.mission_type))]

    def _refuse(self, now_s: float, result: MissionResult) -> Notes:
        peer = self.peer
        self._end(now_s, result)
        return [(peer, Ack(result, self.mission_type))]

    def _end(self, now_s: float, result: int) -> None:
        self.peer, self.result, self._fetching = None, result, False
        self._items, self._count = [], None
        self._touched_s = max(self._touched_s, now_s)
