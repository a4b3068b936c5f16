"""Missions sent to a vehicle, fetched from it and cleared: one transfer after the other.

The machines are those of :mod:`mufly.link.transfer`. What the vehicle holds is known from the last transfer that ended
well; when the vehicle counts another number of items (somebody else sent it a mission) they are fetched anew.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from mufly.link.dialect import MavMessage
from mufly.link.transfer import GIVE_UP_S, Receiver, Sender
from mufly.link.transfer_notes import Ack, ClearAll, Item, MissionResult, Notes, note_of, to_mavlink
from mufly.station.requests import end
from mufly.station.texts import Texts
from mufly.station.view import Outcome, Request

__all__ = ["Transfers"]

CLEAR_RETRY_S = 0.8
CLEAR_TRIES = 12
_PEER = "vehicle"
_WORDS = {
    1: "the vehicle cannot take a mission now",
    2: "the vehicle does not fly in this frame of reference",
    3: "the vehicle does not know one of the commands",
    4: "too many items",
    5: "one of the items is not valid",
    13: "items came out of order",
    14: "the vehicle does not take missions from this station now",
    15: "stopped by the vehicle",
} | {6 + k: f"parameter {k + 1} of an item is not valid" for k in range(7)}


@dataclass(slots=True)
class _Job:
    request: Request
    items: tuple[Item, ...] | None  # to be sent; None: fetch or clear
    clear: bool = False
    begun_s: float = math.nan
    asked_s: float = -math.inf
    tries: int = 0


class Transfers:
    """The missions of one vehicle.

    Parameters
    ----------
    texts : Texts
        Where the vehicle's reasons are found.
    target : (system, component)

    Attributes
    ----------
    items : tuple of Item or None
        What the vehicle holds; None while that is not known.
    """

    def __init__(self, texts: Texts, target: tuple[int, int]) -> None:
        self._texts, self.target = texts, target
        self.items: tuple[Item, ...] | None = None
        self._jobs: deque[_Job] = deque()
        self._sender: Sender | None = None
        self._fetched: tuple[Item, ...] | None = None
        self._receiver = Receiver(self._take, unasked=False)
        self._messy_s: float | None = None
        self._out: Notes = []

    def upload(self, items: Sequence[Item]) -> Request:
        """Send items; accepted once the vehicle has taken all of them."""
        request = Request(f"send a mission of {len(items)} items")
        self._jobs.append(_Job(request, tuple(items)))
        return request

    def download(self) -> Request:
        """Fetch the vehicle's items; they become the ``result``."""
        request = Request("fetch the mission")
        self._jobs.append(_Job(request, None))
        return request

    def clear(self) -> Request:
        """Let the vehicle forget its mission."""
        request = Request("clear the mission")
        self._jobs.append(_Job(request, None, clear=True))
        return request

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way or waits."""
        return bool(self._jobs)

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a message of the mission protocol."""
        note = note_of(message)
        if note is None:
            return
        job = self._jobs[0] if self._jobs else None
        if (
            job is not None
            and job.clear
            and isinstance(note, Ack)
            and job.tries
            and note.mission_type in (0, 255)
        ):
            self._cleared(now_s, job, note.result)
        elif self._sender is not None:
            self._out += self._sender.receive(now_s, note)
        else:
            self._out += self._receiver.receive(now_s, _PEER, note)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        if self._messy_s is None:
            self._messy_s = now_s  # a station before us may have left one open
        job = self._jobs[0] if self._jobs else None
        if job is not None:
            if math.isnan(job.begun_s):
                job.begun_s = now_s
                self._begin(now_s, job)
            self._go_on(now_s, job)
        notes, self._out = self._out, []
        return [to_mavlink(note, *self.target) for _, note in notes]

    def give_up(self, answer: str) -> None:
        """End everything that is open."""
        for job in self._jobs:
            end(job.request, Outcome.TIMED_OUT, answer)
        self._jobs.clear()
        self._sender = None
        self._receiver.cancel()
        self._out = []
        self._messy_s = None

    def _begin(self, now_s: float, job: _Job) -> None:
        if job.clear:
            return
        if job.items is not None:
            self._sender = Sender(_PEER, job.items)
            messy = self._messy_s is not None and now_s - self._messy_s < GIVE_UP_S
            self._out += self._sender.start(now_s, hush=messy)
        else:
            self._fetched = None
            self._out += self._receiver.fetch(now_s, _PEER)

    def _go_on(self, now_s: float, job: _Job) -> None:
        if job.clear:
            self._ask_to_clear(now_s, job)
            return
        machine = self._sender if self._sender is not None else self._receiver
        self._out += machine.step(now_s)
        job.request.progress = max(job.request.progress, machine.progress)
        if machine.result is None:
            return
        self._jobs.popleft()
        self._sender = None
        if machine.result != MissionResult.ACCEPTED:
            self._messy_s = now_s
            self._failed(job, int(machine.result), machine.timed_out)
            return
        self._messy_s = -math.inf
        self.items = job.items if job.items is not None else self._fetched
        job.request.result = self.items
        end(job.request, Outcome.ACCEPTED, f"{len(self.items or ())} items")

    def _failed(self, job: _Job, result: int, timed_out: bool) -> None:
        if timed_out:
            end(job.request, Outcome.TIMED_OUT, f"nothing was heard of it for {GIVE_UP_S:.0f} s")
        else:
            words = _WORDS.get(result, f"result {result}")
            end(job.request, Outcome.REFUSED, self._texts.since(job.begun_s) or words)

    def _ask_to_clear(self, now_s: float, job: _Job) -> None:
        if job.request.done:
            self._jobs.popleft()
        elif now_s - job.asked_s >= CLEAR_RETRY_S:
            if job.tries >= CLEAR_TRIES:
                self._jobs.popleft()
                end(job.request, Outcome.TIMED_OUT, f"no answer in {now_s - job.begun_s:.0f} s")
                return
            job.asked_s = now_s
            job.tries += 1
            self._out.append((_PEER, ClearAll()))

    def _cleared(self, now_s: float, job: _Job, result: int) -> None:
        if result == MissionResult.ACCEPTED:
            self.items = ()
            end(job.request, Outcome.ACCEPTED)
        else:
            self._failed(job, result, False)

    def _take(self, items: tuple[Item, ...]) -> int:
        self._fetched = items
        return MissionResult.ACCEPTED
