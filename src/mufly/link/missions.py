"""The vehicle's side of the mission protocol. What items mean is in :mod:`mufly.mission.items`."""

from __future__ import annotations

from collections import OrderedDict

from mufly.flight import Autopilot, FlightState
from mufly.link.clients import Authority, Clients, Source
from mufly.link.mission_transfer import (
    LIMIT,
    Ack,
    ClearAll,
    Count,
    Note,
    Notes,
    Receiver,
    RequestItem,
    RequestList,
    Sender,
    to_mavlink,
)
from mufly.link.telemetry import Progress
from mufly.mission import ACCEPTED, Answer, Fence, fence_of, items_of_fence, never
from mufly.mission.items import Item, MissionResult, Origin, Plan, Refusal, items_of, plan_of

_MISSION, _FENCE, _RALLY, _ALL = 0, 1, 2, 255
_DOWNLOADS = 16
_CLEAR_WITHIN_S = 3.0
_WHY: dict[int, str] = {
    MissionResult.NO_SPACE: f"mission refused: it has more than {LIMIT} items",
    MissionResult.DENIED: "mission refused: another station is sending one; wait until it is done",
    MissionResult.UNSUPPORTED: "refused: missions and fences are known here, rally points are not",
}
"""Refusals that need no look at the items, in words."""
_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5


class MissionProtocol:
    """The vehicle's side of the mission protocol: who uploads, who downloads, and where the mission stands.

    A mission that has come in whole is judged, loaded and acknowledged in one step: loaded whole, or refused with
    everything left as it was; a fence likewise. Rally points do not exist here: their list is empty.

    Parameters
    ----------
    autopilot : Autopilot
    clients : Clients
    authority : Authority
        Who may change the mission.
    origin : Origin or None

    Attributes
    ----------
    plan : Plan
        The mission and its items.
    """

    def __init__(
        self, autopilot: Autopilot, clients: Clients, authority: Authority, origin: Origin | None
    ) -> None:
        self._autopilot, self._clients = autopilot, clients
        self._authority, self._origin = authority, origin
        self.plan = items_of(autopilot.software.asked)
        self._refused = ""  # why the last mission was refused, until it is told
        self._first = 0  # the item that the mission begins with when it is started
        self._receiver = Receiver(self._judge)
        self._fence_receiver = Receiver(self._judge_fence, mission_type=_FENCE)
        self._fence_items: tuple[Fence | None, tuple[Item, ...]] = (None, ())
        self._senders: OrderedDict[tuple[Source, int], Sender] = OrderedDict()
        self._told = 0
        self._clearing: tuple[float, Source, int] | None = None

    def receive(self, now_s: float, station: Source, note: Note) -> None:
        """Take a note of a station; what begins to change the mission, only from the commander."""
        if isinstance(note, Count | ClearAll) and not self._authority.may(now_s, station):
            denied = Ack(MissionResult.DENIED, note.mission_type)  # why, the authority has said
            self._clients.send(station.peer, to_mavlink(denied, station.system, station.component))
        else:
            self._send(self._only_from_commander())
            self._send(self._answer(now_s, station, note))

    def step(self, now_s: float) -> None:
        """Repeat what may have been lost."""
        self._send(self._only_from_commander())
        out = [*self._receiver.step(now_s), *self._fence_receiver.step(now_s), *self._clear_at_rest(now_s)]
        for giver in self._senders.values():
            out += giver.step(now_s)
        self._send(out)

    def forget(self, peer: object) -> None:
        """A peer has gone: its transfers end, the mission stays what it was."""
        for key in [k for k in self._senders if k[0].peer == peer]:
            del self._senders[key]
        for receiver in (self._receiver, self._fence_receiver):
            taker = receiver.peer
            if isinstance(taker, Source) and taker.peer == peer:
                receiver.cancel()

    def start(self, item: float = 0.0) -> Answer:
        """Start the mission, or go on with it; from an item on if one is given, above 0."""
        if item > 0.0:
            self._first = int(min(item, 65535.0))
            if self._waypoint_of(self._first) is None:
                self._first = 0
                return _no_waypoint(item)
        if not self._first:
            running = self._autopilot.status.mission_running
            return ACCEPTED if running else self._autopilot.start_mission()
        answer = self._autopilot.start_mission(self._waypoint_of(self._first))
        if answer:
            self._first, self._told = 0, self._first  # items before it are skipped, not reached
        return answer

    def start_at(self, item: float) -> Answer:
        """Go on with an item of the mission; on the floor, begin with it once the mission is started."""
        first = self._waypoint_of(int(item)) if item >= 0.0 and item < 65535.0 else None
        if first is None:
            return _no_waypoint(item)
        if self._autopilot.status.state == "init":
            self._first = int(item)
            return ACCEPTED
        answer = self._autopilot.start_mission(first)
        if answer:
            self._first, self._told = 0, int(item)
        return answer

    def progress(self, status: FlightState) -> Progress:
        """Where the mission stands."""
        self._follow(status)
        total = len(self.plan.items)
        if not self.plan.mission.waypoint:
            return Progress(0, total, _NO_MISSION, 2)
        if status.mission_running:
            state = _ACTIVE
        elif status.begun and status.waypoint >= len(self.plan.item_of_waypoint):
            state = _COMPLETE
        elif status.begun and status.flying:
            state = _PAUSED
        else:
            state = _NOT_STARTED
        return Progress(min(self._current(status), total - 1), total, state, 1 if state == _ACTIVE else 2)

    def reached(self, status: FlightState) -> list[int]:
        """Items that were completed since the last call, in order."""
        self._follow(status)
        if not status.begun:
            self._told = 0
            return []
        out = list(range(self._told, self._done(status)))
        self._told += len(out)
        return out

    def _send(self, notes: Notes) -> None:
        for station, note in notes:
            if isinstance(station, Source):
                self._clients.send(station.peer, to_mavlink(note, station.system, station.component))
                if isinstance(note, Ack) and not self._refused and note.result in _WHY:
                    self._clients.say(_WHY[note.result], "warning", station.peer)
        if self._refused:
            self._clients.say(self._refused, "warning")
            self._refused = ""

    def _answer(self, now_s: float, station: Source, note: Note) -> Notes:
        kind = note.mission_type
        if kind not in (_MISSION, _FENCE, _RALLY) and not isinstance(note, ClearAll):
            return [] if isinstance(note, Ack) else [(station, Ack(MissionResult.UNSUPPORTED, kind))]
        match note:
            case ClearAll():
                return self._clear(now_s, station, kind)
            case RequestList() | RequestItem():
                return self._give(now_s, station, note)
            case Count() if kind == _RALLY:
                result = MissionResult.UNSUPPORTED if note.count else MissionResult.ACCEPTED
                return [(station, Ack(result, kind))]
            case Ack():
                giver = self._senders.get((station, kind))
                given = giver.receive(now_s, note) if giver is not None else []
                return [*given, *self._receiver_of(kind).receive(now_s, station, note)]
            case Count() | Item():
                return self._receiver_of(kind).receive(now_s, station, note)
        return []

    def _only_from_commander(self) -> Notes:
        """An upload ends, with nothing changed, when whoever began it does not command any more."""
        out: Notes = []
        for receiver in (self._receiver, self._fence_receiver):
            if receiver.peer is not None and receiver.peer != self._authority.commander:
                out += receiver.cancel()
        return out

    def _receiver_of(self, kind: int) -> Receiver:
        return self._fence_receiver if kind == _FENCE else self._receiver

    def fence_items(self) -> tuple[Item, ...]:
        """The fence as it was uploaded or, of a mission file, as items."""
        fence = self._autopilot.software.asked.fence
        if fence != self._fence_items[0]:
            self._fence_items = (fence, items_of_fence(fence, self._origin))
        return self._fence_items[1]

    def _judge_fence(self, items: tuple[Item, ...]) -> int:
        base = self._autopilot.software.asked.fence
        try:
            fence = fence_of(items, base, self._origin)
        except Refusal as refusal:
            self._refused = str(refusal)
            return refusal.result
        answer = self._autopilot.load_fence(fence)
        if not answer:
            self._refused = answer.reason
            return MissionResult.DENIED if answer.temporary else MissionResult.ERROR
        self._fence_items = (fence, items)
        return MissionResult.ACCEPTED

    def _waypoint_of(self, item: int) -> int | None:
        """The waypoint to begin with when an item is to come next; None if there is none."""
        return self.plan.waypoint_of(item) if 0 <= item < len(self.plan.items) else None

    def _done(self, status: FlightState) -> int:
        """How many items, from the first, are completed."""
        places, reached = self.plan.item_of_waypoint, status.waypoint
        if reached == len(places) and status.mission_running and status.state == "hover":
            reached -= 1  # it waits there; the last item is completed when nothing of the mission is left
        if status.outcome == "succeeded" and not status.flying and reached >= len(places):
            return len(self.plan.items)
        if reached >= len(places) and self.plan.mission.at_end == "hover" and not status.mission_running:
            return len(self.plan.items)  # also those behind the last waypoint, such as a delay
        if 0 < reached < len(places) and status.mission_running and status.state in ("waypoint", "obstacle"):
            return places[reached]
        if reached > 0:
            return places[min(reached, len(places)) - 1] + 1
        # In the air and under way, it has taken off.
        return places[0] if places and status.state in ("waypoint", "obstacle", "hover") else 0

    def _current(self, status: FlightState) -> int:
        places = self.plan.item_of_waypoint
        if not status.begun:
            return self._first
        if status.waypoint < len(places):
            return 0 if status.state == "take-off" else places[status.waypoint]
        return len(self.plan.items) - 1

    def _follow(self, status: FlightState) -> None:
        """Somebody else may have loaded a mission, or tuned the one that is loaded."""
        mission = status.mission
        if mission is None or mission is self.plan.mission:
            return
        if mission.waypoint != self.plan.mission.waypoint or mission.at_end != self.plan.mission.at_end:
            self.plan, self._told = items_of(mission), 0
        else:
            self.plan = Plan(mission, self.plan.items, self.plan.item_of_waypoint)

    def _give(self, now_s: float, station: Source, note: RequestList | RequestItem) -> Notes:
        key = (station, note.mission_type)
        before = self._senders.get(key)
        # Whoever goes on with items of a list that was offered before gets those, or nothing: never some of each.
        if before is not None and isinstance(note, RequestItem):
            return before.receive(now_s, note)
        held = {_MISSION: lambda: self.plan.items, _FENCE: self.fence_items}.get(note.mission_type, tuple)
        items: tuple[Item, ...] = held()
        giver = Sender(station, items, mission_type=note.mission_type, uploading=False)
        # A list that is asked for again may be that of another mission than the one that was never fetched.
        if before is not None and before.result is None and before.items == giver.items:
            return before.receive(now_s, note)
        self._senders[key] = giver
        while len(self._senders) > _DOWNLOADS:
            self._senders.popitem(last=False)
        offer = giver.start(now_s)
        return offer if isinstance(note, RequestList) else giver.receive(now_s, note)

    def _clear(self, now_s: float, station: Source, kind: int) -> Notes:
        if kind in (_FENCE, _ALL):
            result = self._judge_fence(())
            if kind == _FENCE or result != MissionResult.ACCEPTED:
                return [(station, Ack(result, kind))]
        if kind not in (_MISSION, _ALL):
            known = kind == _RALLY
            return [(station, Ack(MissionResult.ACCEPTED if known else MissionResult.UNSUPPORTED, kind))]
        if self._clearing is not None:
            return []  # the same again
        if self._autopilot.status.mission_running and self._autopilot.pause():
            self._clearing = (now_s + _CLEAR_WITHIN_S, station, kind)
            return []
        return [(station, Ack(self._judge(()), kind))]

    def _clear_at_rest(self, now_s: float) -> Notes:
        """A mission that is being flown is cleared once the helicopter hovers."""
        if self._clearing is None:
            return []
        until_s, station, kind = self._clearing
        status = self._autopilot.status
        if now_s < until_s and (status.mission_running or status.state != "hover"):
            return []
        self._clearing = None
        return [(station, Ack(self._judge(()), kind))]

    def _judge(self, items: tuple[Item, ...]) -> int:
        try:
            plan = plan_of(items, self._autopilot.software.asked, self._origin)
        except Refusal as refusal:
            self._refused = str(refusal)
            return refusal.result
        answer = self._autopilot.load_mission(plan.mission)
        if not answer:
            self._refused = f"mission refused: {answer.reason}"
            return MissionResult.DENIED if answer.temporary else MissionResult.ERROR
        self._first = 0
        self.plan, self._told = Plan(self._autopilot.software.asked, items, plan.item_of_waypoint), 0
        return MissionResult.ACCEPTED


def _no_waypoint(item: float) -> Answer:
    return never(f"the mission has no waypoint from item {item:g} on")
