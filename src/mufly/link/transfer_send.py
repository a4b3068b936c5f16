"""The end of a mission transfer that has the items (:mod:`mufly.link.transfer`)."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import replace

from mufly.link.transfer_notes import Ack, Count, Item, MissionResult, Note, Notes, RequestItem, RequestList
from mufly.link.transfer_pace import Pace

__all__ = ["HUSH_S", "Sender"]

HUSH_S = 2.0
"""A sender that begins anew first tells the receiver to stop, until it has not asked for so long (s)."""


class Sender:
    """Gives its items to one peer, item by item as that one asks.

    ``result`` is None until it is over, then the receiver's word; ``OPERATION_CANCELLED`` if it was stopped from either
    side or nothing was heard for `GIVE_UP_S` (``timed_out`` tells which).

    Parameters
    ----------
    peer : hashable
        Whom it serves.
    items : sequence of Item
        Numbered anew from 0.
    mission_type : int
        MAV_MISSION_TYPE.
    uploading : bool
        True at a station that wants to be rid of its mission: says ``Count`` until it is asked for an item, and ends
        with the vehicle's ``Ack``. False at a vehicle that was asked for its list: says ``Count`` once; a list that is
        asked for again is answered again.
    """

    def __init__(
        self, peer: Hashable, items: Sequence[Item], *, mission_type: int = 0, uploading: bool = True
    ) -> None:
        self.peer = peer
        self.items = tuple(replace(item, seq=k, mission_type=mission_type) for k, item in enumerate(items))
        self.mission_type = mission_type
        self.result: int | None = None
        self.timed_out = False
        self._uploading = uploading
        self._served = -1
        self._hush_s = self._hushed_s = -math.inf
        self._pace = Pace()

    @property
    def progress(self) -> float:
        """Share of the items that were asked for, 0..1."""
        return (self._served + 1) / len(self.items) if self.items else float(self.result is not None)

    def start(self, now_s: float, *, hush: bool = False) -> Notes:
        """Offer the items.

        Parameters
        ----------
        now_s : float
            Clock (s).
        hush : bool
            Another transfer to this peer was not ended in order less than `GIVE_UP_S` ago; stop it first.
        """
        self._pace.begin(now_s)
        if not hush:
            return [(self.peer, self._count())]
        self._hush_s, self._hushed_s = now_s + HUSH_S, now_s
        return [(self.peer, self._cancel_note())]

    def receive(self, now_s: float, note: Note) -> Notes:
        """Answer a note of the peer; notes that mean nothing here are passed over."""
        if getattr(note, "mission_type", None) != self.mission_type:
            return []
        if self.result is not None:
            # Somebody waits for items of a transfer that is over, perhaps begun by a Count that came twice.
            return [(self.peer, self._cancel_note())] if isinstance(note, RequestItem) else []
        if self._hush_s > -math.inf:
            if isinstance(note, RequestItem):
                self._hush_s = now_s + HUSH_S
                return [(self.peer, self._cancel_note())]
            return []
        if isinstance(note, RequestList) and not self._uploading:
            self._pace.moved(now_s)
            return [(self.peer, self._count())]
        if isinstance(note, RequestItem):
            # Item by item: what is asked for out of turn is a question to another sender, before this one.
            if not 0 <= note.seq < len(self.items) or note.seq > self._served + 1:
                return []
            if note.seq > self._served:
                self._served = note.seq
                self._pace.moved(now_s)
            return [(self.peer, self.items[note.seq])]
        return self._acknowledged(now_s, note) if isinstance(note, Ack) else []

    def step(self, now_s: float) -> Notes:
        """Repeat what may have been lost, or give up."""
        if self.result is not None:
            return []
        if self._pace.hopeless(now_s):
            self.timed_out, self.result = True, MissionResult.OPERATION_CANCELLED
            return [(self.peer, self._cancel_note())] if self._uploading else []
        if self._hush_s > -math.inf:
            return self._hush(now_s)
        if not self._uploading or not self._pace.again(now_s):
            return []
        if self._served < 0:
            return [(self.peer, self._count())]
        # In between the receiver asks again; after the last item it may be its Ack that was lost.
        last = self._served == len(self.items) - 1
        return [(self.peer, self.items[-1])] if last else []

    def cancel(self) -> Notes:
        """Stop; the receiver is told."""
        if self.result is not None:
            return []
        self.result = MissionResult.OPERATION_CANCELLED
        return [(self.peer, self._cancel_note())]

    def _hush(self, now_s: float) -> Notes:
        if now_s >= self._hush_s:
            self._hush_s = -math.inf
            return self.start(now_s)
        if now_s - self._hushed_s < 0.2 * HUSH_S:
            return []
        self._hushed_s = now_s
        return [(self.peer, self._cancel_note())]

    def _acknowledged(self, now_s: float, note: Ack) -> Notes:
        if note.result == MissionResult.INVALID_SEQUENCE:
            return []  # some vehicles say so to an item that came twice, and go on
        if note.result == MissionResult.ACCEPTED and self._served < len(self.items) - 1:
            if self._served < 0 or not self._uploading:
                return []  # the late answer to another transfer
            # It counts on fewer items than there are: it never heard our Count. Say it again.
            self._served = -1
            self._pace.moved(now_s)
            return [(self.peer, self._count())]
        self.result = note.result
        return []

    def _count(self) -> Count:
        return Count(len(self.items), self.mission_type)

    def _cancel_note(self) -> Ack:
        return Ack(MissionResult.OPERATION_CANCELLED, self.mission_type)
