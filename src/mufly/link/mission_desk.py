"""The vehicle's side of mission transfers: who uploads, who downloads, and where the mission stands.

The transfers themselves are machines of :mod:`mufly.link.transfer`. A mission that has come in whole is judged,
loaded and acknowledged in one step: loaded whole, or refused with everything left as it was. Fences and rally points
do not exist here: their lists are empty.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from mufly.link.authority import Sender as Station
from mufly.link.geodesy import Origin
from mufly.link.missions import Plan, Refusal, items_of, plan_of
from mufly.link.picture import Progress
from mufly.link.transfer import Receiver, Sender
from mufly.link.transfer_notes import (
    Ack,
    ClearAll,
    Count,
    Item,
    MissionResult,
    Note,
    Notes,
    RequestItem,
    RequestList,
)

if TYPE_CHECKING:
    from mufly.flight import Autopilot, Status

__all__ = ["MissionDesk", "writes"]

_MISSION, _FENCE, _RALLY, _ALL = 0, 1, 2, 255
_DOWNLOADS = 16
_CLEAR_WITHIN_S = 3.0
_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5


def writes(note: Note) -> bool:
    """Whether a note begins to change the mission, which only the commander may."""
    return isinstance(note, Count | ClearAll)


class MissionDesk:
    """Serves missions.

    Attributes
    ----------
    refused : str
        Why the last mission was refused; whoever tells it empties it.
    first : int
        The item that the mission will begin with when it is started.

    Parameters
    ----------
    autopilot : Autopilot
    origin : Origin or None
    """

    def __init__(self, autopilot: Autopilot, origin: Origin | None) -> None:
        self._autopilot, self._origin = autopilot, origin
        self.plan = items_of(autopilot.status.mission)
        self.refused = ""
        self.first = 0
        self._receiver = Receiver(self._judge)
        self._senders: OrderedDict[tuple[Station, int], Sender] = OrderedDict()
        self._told = 0
        self._clearing: tuple[float, Station, int] | None = None

    def receive(self, now_s: float, station: Station, note: Note) -> Notes:
        """Take a note of a station that may do what it says; returns what to answer."""
        kind = note.mission_type
        if kind not in (_MISSION, _FENCE, _RALLY) and not isinstance(note, ClearAll):
            return [] if isinstance(note, Ack) else [(station, Ack(MissionResult.UNSUPPORTED, kind))]
        match note:
            case ClearAll():
                return self._clear(now_s, station, kind)
            case RequestList() | RequestItem():
                return self._give(now_s, station, note)
            case Count() if kind != _MISSION:
                result = MissionResult.UNSUPPORTED if note.count else MissionResult.ACCEPTED
                return [(station, Ack(result, kind))]
            case Ack():
                giver = self._senders.get((station, kind))
                given = giver.receive(now_s, note) if giver is not None else []
                return [*given, *self._receiver.receive(now_s, station, note)]
            case Count() | Item():
                return self._receiver.receive(now_s, station, note)
        return []

    def step(self, now_s: float) -> Notes:
        """Repeat what may have been lost."""
        out = [*self._receiver.step(now_s), *self._clear_at_rest(now_s)]
        for giver in self._senders.values():
            out += giver.step(now_s)
        return out

    def only_from(self, commander: Station | None) -> Notes:
        """An upload ends, with nothing changed, when whoever began it does not command any more."""
        taker = self._receiver.peer
        return [] if taker is None or taker == commander else self._receiver.cancel()

    def forget(self, peer: object) -> None:
        """A peer has gone: its transfers end, the mission stays what it was."""
        for key in [k for k in self._senders if k[0].peer == peer]:
            del self._senders[key]
        taker = self._receiver.peer
        if isinstance(taker, Station) and taker.peer == peer:
            self._receiver.cancel()

    def progress(self, status: Status) -> Progress:
        """Where the mission stands."""
        self._follow(status)
        total = len(self.plan.items)
        if not status.mission.waypoint:
            return Progress(0, total, _NO_MISSION, 2)
        if status.mission_running:
            state = _ACTIVE
        elif self._begun() and status.waypoint >= len(self.plan.item_of_waypoint):
            state = _COMPLETE
        elif self._begun() and status.flying:
            state = _PAUSED
        else:
            state = _NOT_STARTED
        return Progress(min(self._current(status), total - 1), total, state, 1 if state == _ACTIVE else 2)

    def reached(self, status: Status) -> list[int]:
        """Items that were completed since the last call, in order."""
        self._follow(status)
        if not self._begun():
            self._told = 0
            return []
        done = self._done(status)
        if done <= self._told:
            return []
        out = list(range(self._told, done))
        self._told = done
        return out

    def jump(self, item: int) -> int | None:
        """The waypoint to begin with when item ``item`` is to come next; None if there is none."""
        return self.plan.waypoint_of(item) if 0 <= item < len(self.plan.items) else None

    def begin_at(self, item: int) -> None:
        """The mission goes on with an item: those before it are skipped, not reached."""
        self.first, self._told = 0, item

    def _done(self, status: Status) -> int:
        """How many items, from the first, are completed."""
        places, reached = self.plan.item_of_waypoint, status.waypoint
        if reached == len(places) and status.mission_running and status.state == "hover":
            reached -= 1  # it waits there; the last item is completed when nothing of the mission is left
        if status.outcome == "succeeded" and not status.flying and reached >= len(places):
            return len(self.plan.items)
        if reached >= len(places) and status.mission.at_end == "hover" and not status.mission_running:
            return len(self.plan.items)  # also those behind the last waypoint, such as a delay
        if 0 < reached < len(places) and status.mission_running and status.state in ("waypoint", "obstacle"):
            return places[reached]
        if reached > 0:
            return places[min(reached, len(places)) - 1] + 1
        # In the air and under way, it has taken off.
        return places[0] if places and status.state in ("waypoint", "obstacle", "hover") else 0

    def _current(self, status: Status) -> int:
        places = self.plan.item_of_waypoint
        if not self._begun():
            return self.first
        if status.waypoint < len(places):
            return 0 if status.state == "take-off" else places[status.waypoint]
        return len(self.plan.items) - 1

    def _begun(self) -> bool:
        """Whether the mission was started since the last take-off."""
        s = self._autopilot.software.mission_state
        return s is not None and s.begun

    def _follow(self, status: Status) -> None:
        """Somebody else may have loaded a mission, or tuned the one that is loaded."""
        mission = status.mission
        if mission is self.plan.mission:
            return
        if mission.waypoint != self.plan.mission.waypoint or mission.at_end != self.plan.mission.at_end:
            self.plan, self._told = items_of(mission), 0
        else:
            self.plan = Plan(mission, self.plan.items, self.plan.item_of_waypoint)

    def _give(self, now_s: float, station: Station, note: RequestList | RequestItem) -> Notes:
        key = (station, note.mission_type)
        giver = self._senders.get(key)
        if giver is not None and giver.result is None:
            return giver.receive(now_s, note)
        if isinstance(note, RequestItem) and giver is not None:
            return giver.receive(now_s, note)
        items = self.plan.items if note.mission_type == _MISSION else ()
        giver = Sender(station, items, mission_type=note.mission_type, uploading=False)
        self._senders[key] = giver
        while len(self._senders) > _DOWNLOADS:
            self._senders.popitem(last=False)
        offer = giver.start(now_s)
        return offer if isinstance(note, RequestList) else giver.receive(now_s, note)

    def _clear(self, now_s: float, station: Station, kind: int) -> Notes:
        if kind not in (_MISSION, _ALL):
            known = kind in (_FENCE, _RALLY)
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
            plan = plan_of(items, self._autopilot.status.mission, self._origin)
        except Refusal as refusal:
            self.refused = str(refusal)
            return refusal.result
        answer = self._autopilot.load_mission(plan.mission)
        if not answer:
            self.refused = f"mission refused: {answer.reason}"
            return MissionResult.DENIED if answer.temporary else MissionResult.ERROR
        self.first = 0
        self.plan, self._told = Plan(self._autopilot.status.mission, items, plan.item_of_waypoint), 0
        return MissionResult.ACCEPTED
