"""The missions of a vehicle: as rows of a table, as items of MAVLink, and sent, fetched and cleared.

Rows are what a page shows (:class:`mufly.station.view.MissionRow`); items are what travels. Ours go in metres, in the
frame LOCAL_NED (x and y in 1e-4 m); items in a global frame are shown in metres from the vehicle's origin. A mission
file becomes items in :mod:`mufly.link.missions`.

One transfer follows the other; the machines are those of :mod:`mufly.link.mission_transfer`. What the vehicle holds is
known from the last transfer that ended well; when the vehicle counts another number of items (somebody else sent it a
mission) they are fetched anew.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from mufly.errors import InputError
from mufly.link.codec import MavMessage
from mufly.link.conventions import Origin
from mufly.link.mission_transfer import (
    GIVE_UP_S,
    Ack,
    ClearAll,
    Item,
    MissionResult,
    Notes,
    Receiver,
    Sender,
    note_of,
    to_mavlink,
)
from mufly.station.commands import Repeated, StatusTexts
from mufly.station.view import MissionRow, Outcome, Request

LOCAL_NED = 1
WAYPOINT, RETURN, LAND, TAKE_OFF, HEADING, SPEED = 16, 20, 21, 22, 115, 178  # MAV_CMD
OWN_SPEED = "the mission's own"
"""Text of a row that ends what an earlier row said of speed (-2 in MAVLink)."""
_ACTIONS = {
    TAKE_OFF: "take off",
    WAYPOINT: "waypoint",
    SPEED: "speed",
    LAND: "land",
    RETURN: "return",
    HEADING: "turn",
}
_OTHERS = {
    17: "stay",
    18: "circles",
    19: "stay for",
    82: "spline waypoint",
    93: "wait",
    112: "wait",
    177: "jump",
}
_HOLDS = (WAYPOINT, 19, 82, 93, 112)
_COMMANDS = {action: command for command, action in _ACTIONS.items()}
_GLOBAL = {0: 0, 5: 0, 3: 1, 6: 1, 10: 1, 11: 1}  # MAV_FRAME: 0 height over the sea, 1 over home
_NOT_GIVEN = 2**31 - 1
_NOWHERE = (math.nan, math.nan, math.nan)
_NUMBER = re.compile(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?")
_PEER = "vehicle"
_RESULTS = {
    1: "the vehicle cannot take a mission now",
    2: "the vehicle does not fly in this frame of reference",
    3: "the vehicle does not know one of the commands",
    4: "too many items",
    5: "one of the items is not valid",
    13: "items came out of order",
    14: "the vehicle does not take missions from this station now",
    15: "stopped by the vehicle",
} | {6 + k: f"parameter {k + 1} of an item is not valid" for k in range(7)}


def items_of(rows: Sequence[MissionRow], where: str = "mission") -> list[Item]:
    """Return the items of the rows of a table.

    Raises
    ------
    InputError
        If a row cannot be sent.
    """
    return [_item(row, k, where) for k, row in enumerate(rows)]


def _item(row: MissionRow, k: int, where: str) -> Item:
    command, at = _COMMANDS.get(row.action), f"row {k + 1}"
    placed = all(map(math.isfinite, row.position))
    if command is None:
        raise InputError(where, at, f"{row.action!r} cannot be sent", f"use {', '.join(_COMMANDS)}")
    if command in (WAYPOINT, TAKE_OFF) and not placed:
        raise InputError(where, at, "has no place", "give N, E and D in metres")
    heading_deg, place = math.degrees(row.heading_rad), row.position if placed else (0.0, 0.0, 0.0)
    params = (row.wait_s, 0.0, 0.0, heading_deg)
    if command == SPEED:
        number = _NUMBER.search("-2" if row.text == OWN_SPEED else row.text)
        if number is None:
            raise InputError(where, at, "has no speed", 'write for example "0.4 m/s"')
        # 1: over ground, -1: throttle as it is
        params, place = (1.0, float(number[0]), -1.0, 0.0), (0.0, 0.0, 0.0)
    elif command == HEADING:
        params, place = (heading_deg, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    x, y = (round(v * 1e4) for v in place[:2])
    return Item(k, LOCAL_NED, command, params=params, x=x, y=y, z=place[2])


def rows_of(items: Sequence[Item], origin: Origin | None = None, reached: int = 0) -> list[MissionRow]:
    """Return the rows of a table of items.

    Parameters
    ----------
    items : sequence of Item
    origin : Origin, optional
        Where N, E, D are 0, for items in a global frame.
    reached : int
        So many of the first rows are behind the vehicle.
    """
    return [_row(item, origin, k < reached) for k, item in enumerate(items)]


def _row(item: Item, origin: Origin | None, reached: bool) -> MissionRow:
    command = item.command
    action = _ACTIONS.get(command) or _OTHERS.get(command, f"command {command}")
    position, text = _NOWHERE, ""
    if command == SPEED:
        speed = item.params[1]
        return MissionRow(action, reached=reached, text=OWN_SPEED if speed == -2.0 else f"{speed:g} m/s")
    if command == HEADING:
        return MissionRow(action, heading_rad=math.radians(item.params[0]), reached=reached)
    if item.frame == LOCAL_NED and command in (*_ACTIONS, *_OTHERS) and command != RETURN:
        position = (item.x / 1e4, item.y / 1e4, item.z)
    elif item.frame in _GLOBAL and item.x != _NOT_GIVEN:
        position, text = _from_global(item, origin)
    elif command not in _ACTIONS:
        text = " ".join(f"{p:g}" for p in (*item.params, item.x, item.y, item.z))
    wait_s = item.params[0] if command in _HOLDS and math.isfinite(item.params[0]) else 0.0
    heading = math.radians(item.params[3]) if command in (WAYPOINT, TAKE_OFF, LAND) else math.nan
    return MissionRow(action, position, heading, wait_s, reached, text)


def _from_global(item: Item, origin: Origin | None) -> tuple[tuple[float, float, float], str]:
    latitude, longitude = item.x / 1e7, item.y / 1e7
    if (item.x, item.y) == (0, 0):
        return _NOWHERE, ""
    if origin is None:
        return _NOWHERE, f"{latitude:.6f} {longitude:.6f} deg, {item.z:g} m"
    north, east, down = origin.to_local(latitude, longitude, item.z)
    return (north, east, -item.z if _GLOBAL[item.frame] else down), ""


def same_mission(a: Sequence[Item], b: Sequence[Item]) -> bool:
    """Whether two missions would be flown alike; which item is current does not matter, NaN equals NaN."""
    return [_flown(item) for item in a] == [_flown(item) for item in b]


def _flown(item: Item) -> tuple[object, ...]:
    numbers = (None if math.isnan(v) else round(v, 4) for v in (*item.params, item.z))
    return item.frame, item.command, item.x, item.y, *numbers


@dataclass(slots=True, kw_only=True)
class _Job(Repeated):
    """A transfer; ``items`` are to be sent, None: fetch or clear. What is repeated is a clearing."""

    items: tuple[Item, ...] | None = None
    clear: bool = False
    begun_s: float = math.nan


class RemoteMission:
    """The mission of one vehicle.

    Parameters
    ----------
    texts : StatusTexts
        Where the vehicle's reasons are found.
    target : (system, component)

    Attributes
    ----------
    items : tuple of Item or None
        What the vehicle holds; None while that is not known.
    """

    def __init__(self, texts: StatusTexts, target: tuple[int, int]) -> None:
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
        return self._queue(_Job(Request(f"send a mission of {len(items)} items"), items=tuple(items)))

    def download(self) -> Request:
        """Fetch the vehicle's items; they become the ``result``."""
        return self._queue(_Job(Request("fetch the mission")))

    def clear(self) -> Request:
        """Let the vehicle forget its mission."""
        return self._queue(_Job(Request("clear the mission"), clear=True))

    def _queue(self, job: _Job) -> Request:
        self._jobs.append(job)
        return job.request

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
        clearing = job is not None and job.clear and job.tries
        if job is not None and clearing and isinstance(note, Ack) and note.mission_type in (0, 255):
            if note.result == MissionResult.ACCEPTED:
                self.items = ()
                job.request.end(Outcome.ACCEPTED)
            else:
                self._refused(job, note.result)
        elif self._sender is not None:
            self._out += self._sender.receive(now_s, note)
        else:
            self._out += self._receiver.receive(now_s, _PEER, note)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        if self._messy_s is None:
            self._messy_s = now_s  # a station before us may have left one open
        if self._jobs:
            job = self._jobs[0]
            if math.isnan(job.begun_s):
                job.begun_s = now_s
                self._begin(now_s, job)
            if job.clear and job.due(now_s):
                self._out.append((_PEER, ClearAll()))
            elif not job.clear:
                self._go_on(now_s, job)
            if job.request.done:
                self._jobs.popleft()
        notes, self._out = self._out, []
        return [to_mavlink(note, *self.target) for _, note in notes]

    def give_up(self, answer: str) -> None:
        """End everything that is open."""
        for job in self._jobs:
            job.request.end(Outcome.TIMED_OUT, answer)
        self._jobs.clear()
        self._sender = None
        self._receiver.cancel()
        self._out = []
        self._messy_s = None

    def _begin(self, now_s: float, job: _Job) -> None:
        if job.items is not None:
            self._sender = Sender(_PEER, job.items)
            messy = self._messy_s is not None and now_s - self._messy_s < GIVE_UP_S
            self._out += self._sender.start(now_s, hush=messy)
        elif not job.clear:
            self._fetched = None
            self._out += self._receiver.fetch(now_s, _PEER)

    def _go_on(self, now_s: float, job: _Job) -> None:
        machine = self._sender if self._sender is not None else self._receiver
        self._out += machine.step(now_s)
        job.request.progress = max(job.request.progress, machine.progress)
        if machine.result is None:
            return
        self._sender = None
        if machine.result == MissionResult.ACCEPTED:
            self._messy_s = -math.inf
            self.items = job.items if job.items is not None else self._fetched
            job.request.result = self.items
            job.request.end(Outcome.ACCEPTED, f"{len(self.items or ())} items")
            return
        self._messy_s = now_s
        if machine.timed_out:
            job.request.end(Outcome.TIMED_OUT, f"nothing was heard of it for {GIVE_UP_S:.0f} s")
        else:
            self._refused(job, int(machine.result))

    def _refused(self, job: _Job, result: int) -> None:
        words = _RESULTS.get(result, f"result {result}")
        job.request.end(Outcome.REFUSED, self._texts.since(job.begun_s) or words)

    def _take(self, items: tuple[Item, ...]) -> int:
        self._fetched = items
        return MissionResult.ACCEPTED
