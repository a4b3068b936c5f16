"""State machines of both ends of the mission protocol, independent of sockets and of the meaning of items.

The owner of the items is a :class:`MissionSender`, the other end a :class:`MissionReceiver` (mavlink.io, "Mission
Protocol")::

    upload      Sender (station)            Receiver (vehicle)        download    Receiver (station)    Sender (vehicle)
                Count          ─────▶                                             RequestList   ─────▶
                               ◀─────       RequestItem 0                                       ◀─────  Count
                Item 0         ─────▶                                             RequestItem 0 ─────▶
                               ◀─────       RequestItem 1 ...                                   ◀─────  Item 0 ...
                               ◀─────       Ack                                   Ack           ─────▶

Packets get lost, doubled, delayed and reordered. The receiver drives the transfer: it requests one item after the
other, repeats unanswered requests, and ignores items that it does not wait for. Complete items are handed over once.

MAVLink items do not name their transfer. So that two missions are not mixed, a receiver that starts again first waits
until packets of the last transfer have arrived (`STALE_PACKET_TIME_S`). A sender that starts again first stops the
receiver (`QUIET_PERIOD_S`): its items could otherwise answer requests of the last transfer.

An answer is expected after one round trip; the retry time follows the measured round trips.

The machines exchange the messages below; the older forms MISSION_ITEM and MISSION_REQUEST become the same messages as
MISSION_ITEM_INT and MISSION_REQUEST_INT.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import astuple, dataclass, fields, replace
from typing import Any

from mufly.link.codec import MavMessage, mavlink, scale_to_integer
from mufly.mission.files.mission_items import MissionItem as MissionItem
from mufly.mission.files.mission_items import MissionResultCode as MissionResultCode

RETRY_BOUNDS_S = (0.25, 1.5)
"""Least and greatest time until a request is repeated (s); MAVLink recommends 0.25 s for items and 1.5 s otherwise."""
FIRST_RETRY_S = 0.8
"""Retry time before any round trip was measured (s): longer than a round trip with 300 ms each way."""
TRANSFER_TIMEOUT_S = 12.0
"""Time without progress after which a transfer is given up (s).

With 30 % loss and 300 ms each way an item is requested 16 times within this time. Each request succeeds with
probability 0.49, so one item in 48 000 is given up.
"""
STALE_PACKET_TIME_S = 1.0
"""Time for which packets of an earlier transfer may still arrive (s)."""
MAX_ITEMS = 500
"""Largest number of items that a receiver accepts."""
QUIET_PERIOD_S = 2.0
"""Time without requests after which a sender that starts again regards the receiver as stopped (s)."""
TYPE_MISSION, TYPE_FENCE = mavlink.MAV_MISSION_TYPE_MISSION, mavlink.MAV_MISSION_TYPE_FENCE
TYPE_RALLY, TYPE_ALL = mavlink.MAV_MISSION_TYPE_RALLY, mavlink.MAV_MISSION_TYPE_ALL
_LOCAL_FRAMES = (1, 4, 7, 8, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21)


@dataclass(frozen=True, slots=True)
class MissionRequestList:
    """MISSION_REQUEST_LIST: request of the number of items."""

    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class MissionCount:
    """MISSION_COUNT: number of items that the sender offers."""

    item_count: int
    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class MissionRequestItem:
    """MISSION_REQUEST_INT, or MISSION_REQUEST, which is answered in the same way."""

    seq: int
    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class MissionAck:
    """MISSION_ACK; ``result`` is a number of :class:`MissionResultCode`, or an unknown number."""

    result: int
    mission_type: int = 0


@dataclass(frozen=True, slots=True)
class MissionClearAll:
    """MISSION_CLEAR_ALL, answered by a :class:`MissionAck`; the transfer state machines do not handle it."""

    mission_type: int = 0


TransferMessage = MissionRequestList | MissionCount | MissionRequestItem | MissionItem | MissionAck | MissionClearAll
"""A message between sender and receiver."""

AddressedMessages = list[tuple[Hashable, TransferMessage]]
"""Messages to send, each with its peer."""


_MESSAGE_TYPES: dict[type, Any] = {
    MissionRequestList: mavlink.MAVLink_mission_request_list_message,
    MissionCount: mavlink.MAVLink_mission_count_message,
    MissionRequestItem: mavlink.MAVLink_mission_request_int_message,
    MissionAck: mavlink.MAVLink_mission_ack_message,
    MissionClearAll: mavlink.MAVLink_mission_clear_all_message,
}
"""MAVLink messages, and the transfer messages with the same fields after target system and component."""
_TRANSFER_TYPE_BY_MESSAGE = {m.msgname: note for note, m in _MESSAGE_TYPES.items()} | {
    "MISSION_REQUEST": MissionRequestItem
}


def parse_transfer_message(message: MavMessage) -> TransferMessage | None:
    """Return the transfer message of a MAVLink message; None if it is another message."""
    m, kind = message, message.get_type()
    if kind in ("MISSION_ITEM_INT", "MISSION_ITEM"):
        factor = 1e4 if m.frame in _LOCAL_FRAMES else 1e7
        x, y = (m.x, m.y) if kind == "MISSION_ITEM_INT" else (scale_to_integer(v, factor) for v in (m.x, m.y))
        params = (m.param1, m.param2, m.param3, m.param4)
        return MissionItem(m.seq, m.frame, m.command, m.current, m.autocontinue, params, x, y, m.z, m.mission_type)
    note = _TRANSFER_TYPE_BY_MESSAGE.get(kind)
    return None if note is None else note(*(getattr(m, name) for name in m.fieldnames[2 : 2 + len(fields(note))]))


def encode_transfer_message(note: TransferMessage, system: int, component: int) -> MavMessage:
    """Return the MAVLink message to ``system`` and ``component``, ready for a codec to send."""
    if isinstance(note, MissionItem):
        n = note
        return mavlink.MAVLink_mission_item_int_message(
            system, component, n.seq, n.frame, n.command, n.current, n.autocontinue, *n.params, n.x, n.y, n.z,
            n.mission_type,
        )  # fmt: skip
    return _MESSAGE_TYPES[type(note)](system, component, *astuple(note))


class RetryTimer:
    """Timer of a mission transfer: when to repeat an unanswered request, and when to give up."""

    def __init__(self) -> None:
        self._round_trip_s: float | None = None
        self._asked_s = self._moved_s = 0.0
        self._repeated = False

    def mark_progress(self, now_s: float) -> None:
        """Record that the transfer advanced, and that the next request is sent now."""
        took = now_s - self._asked_s
        # After a repetition the answered request is unknown.
        if not self._repeated and took > 0.0:
            old = self._round_trip_s
            self._round_trip_s = took if old is None else 0.7 * old + 0.3 * took
        self._asked_s = self._moved_s = now_s
        self._repeated = False

    def mark_started(self, now_s: float) -> None:
        """Start the timer: the first request of a mission transfer is sent now."""
        self._asked_s = self._moved_s = now_s
        self._repeated = False

    def take_due_retry(self, now_s: float) -> bool:
        """Return whether to repeat the request now, and record the repetition."""
        trip = self._round_trip_s
        wait = FIRST_RETRY_S if trip is None else min(max(1.1 * trip + 0.05, RETRY_BOUNDS_S[0]), RETRY_BOUNDS_S[1])
        if now_s - self._asked_s < wait:
            return False
        self._asked_s, self._repeated = now_s, True
        return True

    def has_timed_out(self, now_s: float) -> bool:
        """Return whether the transfer has timed out."""
        return now_s - self._moved_s > TRANSFER_TIMEOUT_S


class MissionReceiver:
    """Receiver of mission items from one peer at a time, which hands only the complete list to ``judge``.

    At a vehicle it waits for a ``MissionCount``; at a station :meth:`request_items` starts a transfer. It is reusable.

    Parameters
    ----------
    judge : callable
        Called with the complete items; returns the result to acknowledge (:class:`MissionResultCode` or its number). A
        refusal must leave everything unchanged.
    mission_type : int
        MAV_MISSION_TYPE; messages of other types are ignored.
    limit : int
        Largest number of items; more are refused with ``NO_SPACE``.
    unasked : bool
        Whether a ``MissionCount`` may start a transfer (at a vehicle), or only :meth:`request_items` (at a station).

    Attributes
    ----------
    peer : hashable
        Peer whose items are being fetched; None between transfers.
    result : int or None
        Result of the last transfer; None during a transfer and before the first.
    timed_out : bool
        Whether it ended because the peer was silent.
    """

    def __init__(
        self,
        judge: Callable[[tuple[MissionItem, ...]], int],
        *,
        mission_type: int = 0,
        limit: int = MAX_ITEMS,
        unasked: bool = True,
    ) -> None:
        self.mission_type, self.limit = mission_type, limit
        self.peer: Hashable = None
        self.result: int | None = None
        self.timed_out = False
        self._judge, self._unasked = judge, unasked
        self._fetching = False
        self._count: int | None = None
        self._items: list[MissionItem] = []
        self._settled_s = self._touched_s = -math.inf
        self._done: tuple[Hashable, int, int] | None = None  # peer, number of items and result of the last transfer
        self._retry = RetryTimer()

    @property
    def is_busy(self) -> bool:
        """Return whether a transfer is active."""
        return self.peer is not None

    @property
    def completed_fraction(self) -> float:
        """Share of the items received, 0..1."""
        return len(self._items) / self._count if self._count else 0.0

    def request_items(self, now_s: float, peer: Hashable) -> AddressedMessages:
        """Request the items of a peer; an active transfer is dropped."""
        dropped = self.cancel_transfer()
        self._begin_transfer(now_s, peer, fetching=True)
        return [*dropped, (peer, MissionRequestList(self.mission_type))]

    def handle_message(self, now_s: float, peer: Hashable, note: TransferMessage) -> AddressedMessages:
        """Process a message of a peer and return the answers; one that does not fit the state is ignored."""
        if getattr(note, "mission_type", None) != self.mission_type:
            return []
        if isinstance(note, MissionCount):
            return self._handle_count(now_s, peer, note)
        if isinstance(note, MissionItem):
            return self._handle_item(now_s, peer, note)
        if isinstance(note, MissionAck) and peer == self.peer and note.result != MissionResultCode.ACCEPTED:
            self._end_transfer(now_s, note.result)
        return []

    def take_due_messages(self, now_s: float) -> AddressedMessages:
        """Return the request for the next item again if its answer is late, or end the transfer after the time-out."""
        if self.peer is None:
            return []
        if self._retry.has_timed_out(now_s):
            self.timed_out = True
            return self._refuse_transfer(now_s, MissionResultCode.OPERATION_CANCELLED)
        if now_s < self._settled_s or not self._retry.take_due_retry(now_s):
            return []
        return [(self.peer, self._next_request(now_s))]

    def cancel_transfer(self) -> AddressedMessages:
        """Cancel the transfer; the peer is informed, no items are handed over."""
        if self.peer is None:
            return []
        return self._refuse_transfer(self._touched_s, MissionResultCode.OPERATION_CANCELLED)

    def _handle_count(self, now_s: float, peer: Hashable, note: MissionCount) -> AddressedMessages:
        if self._fetching or not self._unasked:
            if not self._fetching or peer != self.peer or self._count is not None:
                return []
        elif self.is_busy and peer != self.peer:
            return [(peer, MissionAck(MissionResultCode.DENIED, self.mission_type))]
        else:
            self._begin_transfer(now_s, peer, fetching=False)
        if note.item_count > self.limit:
            return self._refuse_transfer(now_s, MissionResultCode.NO_SPACE)
        self._count = note.item_count
        if note.item_count == 0:
            return self._finish_transfer(now_s)
        self._retry.mark_progress(now_s)
        return [] if now_s < self._settled_s else [(peer, self._next_request(now_s))]

    def _handle_item(self, now_s: float, peer: Hashable, item: MissionItem) -> AddressedMessages:
        if peer != self.peer:
            return self._repeat_last_ack(now_s, peer, item)
        if now_s < self._settled_s or self._count is None or item.seq != len(self._items):
            self._touched_s = now_s
            return []
        self._items.append(item)
        self._retry.mark_progress(now_s)
        if len(self._items) == self._count:
            return self._finish_transfer(now_s)
        return [(peer, self._next_request(now_s))]

    def _repeat_last_ack(self, now_s: float, peer: Hashable, item: MissionItem) -> AddressedMessages:
        """Return the acknowledgement of a finished transfer again if the peer sends its last ``item`` again."""
        if self._done is None or self._done[:2] != (peer, item.seq + 1):
            return []
        self._touched_s = now_s
        return [(peer, MissionAck(self._done[2], self.mission_type))]

    def _next_request(self, now_s: float) -> TransferMessage:
        if self._count is None:
            return MissionRequestList(self.mission_type)
        self._touched_s = now_s
        return MissionRequestItem(len(self._items), self.mission_type)

    def _begin_transfer(self, now_s: float, peer: Hashable, *, fetching: bool) -> None:
        self.peer, self._fetching = peer, fetching
        self.result, self.timed_out, self._done = None, False, None
        self._count, self._items = None, []
        self._settled_s = self._touched_s + STALE_PACKET_TIME_S
        self._retry = RetryTimer()
        self._retry.mark_started(now_s)

    def _finish_transfer(self, now_s: float) -> AddressedMessages:
        peer, items = self.peer, tuple(self._items)
        result = int(self._judge(items))
        self._end_transfer(now_s, result)
        self._done = (peer, len(items), result)
        return [(peer, MissionAck(result, self.mission_type))]

    def _refuse_transfer(self, now_s: float, result: MissionResultCode) -> AddressedMessages:
        peer = self.peer
        self._end_transfer(now_s, result)
        return [(peer, MissionAck(result, self.mission_type))]

    def _end_transfer(self, now_s: float, result: int) -> None:
        self.peer, self.result, self._fetching = None, result, False
        self._items, self._count = [], None
        self._touched_s = max(self._touched_s, now_s)


class MissionSender:
    """Sender of items to one peer, item by item on request.

    ``result`` is None until the end, then the receiver's result. It is ``OPERATION_CANCELLED`` if either side
    cancelled, or if nothing was heard for `TRANSFER_TIMEOUT_S`; ``timed_out`` tells these cases apart.

    Parameters
    ----------
    peer : hashable
        Receiver of the items.
    items : sequence of MissionItem
        Items, which are numbered from 0.
    mission_type : int
        MAV_MISSION_TYPE.
    uploading : bool
        True at a station that uploads its mission: it repeats ``MissionCount`` until an item is requested, and ends
        with the vehicle's ``MissionAck``. False at a vehicle whose list was requested: it sends ``MissionCount`` once
        for each request of the list.
    """

    def __init__(
        self, peer: Hashable, items: Sequence[MissionItem], *, mission_type: int = 0, uploading: bool = True
    ) -> None:
        self.peer = peer
        self.items = tuple(replace(item, seq=k, mission_type=mission_type) for k, item in enumerate(items))
        self.mission_type = mission_type
        self.result: int | None = None
        self.timed_out = False
        self._uploading = uploading
        self._served = -1
        self._hush_s = self._hushed_s = -math.inf
        self._retry = RetryTimer()

    @property
    def completed_fraction(self) -> float:
        """Share of the items requested, 0..1."""
        return (self._served + 1) / len(self.items) if self.items else float(self.result is not None)

    def start_transfer(self, now_s: float, *, hush: bool = False) -> AddressedMessages:
        """Start the transfer; return MISSION_COUNT, which offers the items, or first a cancellation of an old transfer.

        Parameters
        ----------
        now_s : float
            Clock (s).
        hush : bool
            Whether to cancel first a transfer to this peer that ended unfinished less than `TRANSFER_TIMEOUT_S` ago.
        """
        self._retry.mark_started(now_s)
        if not hush:
            return [(self.peer, self._make_count_message())]
        self._hush_s, self._hushed_s = now_s + QUIET_PERIOD_S, now_s
        return [(self.peer, self._make_cancel_message())]

    def handle_message(self, now_s: float, note: TransferMessage) -> AddressedMessages:
        """Process a message of the peer and return the answers; one that does not fit the state is ignored."""
        if getattr(note, "mission_type", None) != self.mission_type:
            return []
        if self.result is not None:
            # The peer waits for items of a finished transfer, perhaps started by a doubled Count.
            return [(self.peer, self._make_cancel_message())] if isinstance(note, MissionRequestItem) else []
        if self._hush_s > -math.inf:
            if isinstance(note, MissionRequestItem):
                self._hush_s = now_s + QUIET_PERIOD_S
                return [(self.peer, self._make_cancel_message())]
            return []
        if isinstance(note, MissionRequestList) and not self._uploading:
            self._retry.mark_progress(now_s)
            return [(self.peer, self._make_count_message())]
        if isinstance(note, MissionRequestItem):
            # Items are requested in order: a request out of turn answers an earlier sender.
            if not 0 <= note.seq < len(self.items) or note.seq > self._served + 1:
                return []
            if note.seq > self._served:
                self._served = note.seq
                self._retry.mark_progress(now_s)
            return [(self.peer, self.items[note.seq])]
        return self._handle_ack(now_s, note) if isinstance(note, MissionAck) else []

    def take_due_messages(self, now_s: float) -> AddressedMessages:
        """Return the offer or the last item again if its answer is late, or end the transfer after the time-out."""
        if self.result is not None:
            return []
        if self._retry.has_timed_out(now_s):
            self.timed_out, self.result = True, MissionResultCode.OPERATION_CANCELLED
            return [(self.peer, self._make_cancel_message())] if self._uploading else []
        if self._hush_s > -math.inf:
            return self._start_once_receiver_quiet(now_s)
        if not self._uploading or not self._retry.take_due_retry(now_s):
            return []
        if self._served < 0:
            return [(self.peer, self._make_count_message())]
        # During the transfer the receiver repeats requests; after the last item its Ack may be lost.
        last = self._served == len(self.items) - 1
        return [(self.peer, self.items[-1])] if last else []

    def cancel_transfer(self) -> AddressedMessages:
        """Cancel the transfer, and inform the receiver."""
        if self.result is not None:
            return []
        self.result = MissionResultCode.OPERATION_CANCELLED
        return [(self.peer, self._make_cancel_message())]

    def _start_once_receiver_quiet(self, now_s: float) -> AddressedMessages:
        if now_s >= self._hush_s:
            self._hush_s = -math.inf
            return self.start_transfer(now_s)
        if now_s - self._hushed_s < 0.2 * QUIET_PERIOD_S:
            return []
        self._hushed_s = now_s
        return [(self.peer, self._make_cancel_message())]

    def _handle_ack(self, now_s: float, note: MissionAck) -> AddressedMessages:
        if note.result == MissionResultCode.INVALID_SEQUENCE:
            return []  # some vehicles answer a doubled item so, and continue
        if note.result == MissionResultCode.ACCEPTED and self._served < len(self.items) - 1:
            if self._served < 0 or not self._uploading:
                return []  # late answer to another transfer
            # It expects fewer items than there are: the Count was lost. Repeat it.
            self._served = -1
            self._retry.mark_progress(now_s)
            return [(self.peer, self._make_count_message())]
        self.result = note.result
        return []

    def _make_count_message(self) -> MissionCount:
        return MissionCount(len(self.items), self.mission_type)

    def _make_cancel_message(self) -> MissionAck:
        return MissionAck(MissionResultCode.OPERATION_CANCELLED, self.mission_type)
