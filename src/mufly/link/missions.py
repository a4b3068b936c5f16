"""Missions over the link: items of MAVLink as a :class:`mufly.mission.Mission` and back, and the vehicle's protocol.

=========================  ======================================================================================
item (MAV_CMD)             here
=========================  ======================================================================================
NAV_TAKEOFF (22)           height of the take-off, straight up (no x, y, heading); only before the first waypoint
NAV_WAYPOINT (16)          waypoint; parameter 1: wait (s), 4: heading (deg; NaN: the nose points along the way)
NAV_LOITER_TIME (19)       the same
NAV_DELAY (93)             parameter 1: so much longer a wait (s) at the waypoint, or after the take-off, before it
NAV_LOITER_UNLIM (17)      the same, and hover there; only as the last item
NAV_LAND (21)              fly to its x, y (unless not given), then land; only as the last item
NAV_RETURN_TO_LAUNCH (20)  fly home and land; only as the last item
DO_CHANGE_SPEED (178)      parameter 2: speed (m/s) of the legs that follow, -2: the mission's own
CONDITION_YAW (115)        parameter 1: heading (deg) of the next waypoint that has none itself; absolute only
=========================  ======================================================================================

Frames: LOCAL_NED (1; x, y in 1e-4 m) and LOCAL_ENU (4); with a global origin also GLOBAL (0, 5: altitude above the
sea) and GLOBAL_RELATIVE_ALT (3, 6: above the origin). Items without a place may be in any. A mission that ends
without 17, 20 or 21 ends in a hover. Whatever cannot be flown as it is written is refused whole, with the field that
is to blame.

Speeds, accelerations, obstacle avoidance and the room are those of the mission that was loaded before: items do not
speak of them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from mufly.flight import Autopilot, FlightState
from mufly.link.clients import Authority, Clients, Source
from mufly.link.codec import ABOVE_ORIGIN, ABOVE_SEA, Origin, unscaled
from mufly.link.mission_transfer import (
    LIMIT,
    Ack,
    ClearAll,
    Count,
    Item,
    MissionResult,
    Note,
    Notes,
    Receiver,
    RequestItem,
    RequestList,
    Sender,
    to_mavlink,
)
from mufly.link.telemetry import Progress
from mufly.mission import ACCEPTED, LOWEST_M, Answer, Mission, Waypoint, never
from mufly.mission.schema import TakeOff

_WAYPOINT, _UNLIMITED, _LOITER_TIME, _HOME, _LAND, _TAKE_OFF, _DELAY = 16, 17, 19, 20, 21, 22, 93
_SPEED, _YAW = 178, 115
_ENDS = {_UNLIMITED: "hover", _LAND: "land", _HOME: "return"}
_NED, _ENU = 1, 4
_SAME_PLACE_M = 0.05

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Plan:
    """A mission and the items that it was made of, or that were made of it.

    Attributes
    ----------
    mission : Mission
    items : tuple of Item
    item_of_waypoint : tuple of int
        Which item each waypoint of the mission came from.
    """

    mission: Mission
    items: tuple[Item, ...]
    item_of_waypoint: tuple[int, ...]

    def waypoint_of(self, item: int) -> int | None:
        """The first waypoint that comes from an item or a later one; None if there is none."""
        return next((k for k, i in enumerate(self.item_of_waypoint) if i >= item), None)


class Refusal(Exception):
    """A mission that cannot be flown: the result to acknowledge, and why, in words."""

    def __init__(self, result: MissionResult, text: str) -> None:
        super().__init__(text)
        self.result = result


def _refuse(item: Item, result: MissionResult, why: str) -> Refusal:
    return Refusal(result, f"mission item {item.seq}: {why}")


def plan_of(items: Sequence[Item], base: Mission, origin: Origin | None) -> Plan:
    """Return the mission that items describe.

    Parameters
    ----------
    items : sequence of Item
        Numbered from 0.
    base : Mission
        The rest is taken from it.
    origin : Origin or None
        For items on the globe.

    Raises
    ------
    Refusal
        If it cannot be flown as it is written.
    """
    waypoints: list[Waypoint] = []
    came_from: list[int] = []
    take_off: TakeOff = base.take_off
    speed: float | None = None
    heading: float | None = None
    end: str = "hover" if items else base.at_end
    for item in items:
        if item.seq and items[item.seq - 1].command in _ENDS:
            raise _refuse(
                item, MissionResult.INVALID_SEQUENCE, "nothing can follow a landing or an endless hover"
            )
        if item.command == _TAKE_OFF:
            if waypoints:
                raise _refuse(item, MissionResult.INVALID_SEQUENCE, "a take-off comes before all waypoints")
            take_off = _checked(item, TakeOff, height_m=-_down(item, origin), wait_s=base.take_off.wait_s)
        elif item.command in (_WAYPOINT, _LOITER_TIME, _UNLIMITED):
            own = _heading(item, 3, MissionResult.INVALID_PARAM4)
            place = _place(item, origin)
            wait = 0.0 if item.command == _UNLIMITED else _wait(item)
            waypoints.append(_waypoint(item, place, wait, heading if own is None else own, speed))
            came_from.append(item.seq)
            heading = None
        elif item.command == _DELAY and waypoints:
            w = waypoints[-1]
            longer = w.wait_s + _wait(item)
            waypoints[-1] = _waypoint(item, w.position_m, longer, w.heading_deg, w.speed_m_s)
        elif item.command == _DELAY:
            take_off = _checked(
                item, TakeOff, height_m=take_off.height_m, wait_s=take_off.wait_s + _wait(item)
            )
        elif item.command == _SPEED:
            speed = _speed(item, speed)
        elif item.command == _YAW:
            if item.params[3] == 1.0:
                raise _refuse(item, MissionResult.INVALID_PARAM4, "a relative turn is not known in a mission")
            heading = _heading(item, 0, MissionResult.INVALID_PARAM1)
        elif item.command not in (_LAND, _HOME):
            raise _refuse(item, MissionResult.UNSUPPORTED, f"command {item.command} cannot be flown")
        if item.command == _LAND and waypoints:
            over = _above(item, origin, waypoints[-1])
            if over is not None:
                waypoints.append(_waypoint(item, over, 0.0, heading, speed))
                came_from.append(item.seq)
                heading = None
        end = _ENDS.get(item.command, end)
    if heading is not None:
        last = next(i for i in reversed(items) if i.command == _YAW)
        raise _refuse(
            last, MissionResult.INVALID_SEQUENCE, "no waypoint follows that could have this heading"
        )
    if items and not waypoints:
        raise Refusal(MissionResult.INVALID, "mission: there is no waypoint in it")
    parts: dict[str, Any] = {name: getattr(base, name) for name in Mission.model_fields}
    parts |= {"take_off": take_off, "waypoint": tuple(waypoints), "at_end": end}
    return Plan(Mission(**parts), tuple(items), tuple(came_from))


def items_of(mission: Mission) -> Plan:
    """Return a mission as items in LOCAL_NED."""
    if not mission.waypoint:
        return Plan(mission, (), ())
    items = [Item(0, _NED, _TAKE_OFF, params=(0.0, 0.0, 0.0, math.nan), z=-mission.take_off.height_m)]
    came_from: list[int] = []
    speed: float | None = None
    for w in mission.waypoint:
        if w.speed_m_s != speed:
            speed = w.speed_m_s
            items.append(Item(0, _NED, _SPEED, params=(1.0, -2.0 if speed is None else speed, -1.0, 0.0)))
        n, e, d = w.position_m
        heading = math.nan if w.heading_deg is None else w.heading_deg
        came_from.append(len(items))
        items.append(
            Item(0, _NED, _WAYPOINT, params=(w.wait_s, 0.0, 0.0, heading), x=_counts(n), y=_counts(e), z=d)
        )
    last = items[-1]
    if mission.at_end == "land":
        items.append(replace(last, command=_LAND, params=(0.0, 0.0, 0.0, math.nan), z=0.0))
    elif mission.at_end == "return":
        items.append(Item(0, _NED, _HOME))
    numbered = tuple(replace(item, seq=k, current=int(k == 0)) for k, item in enumerate(items))
    return Plan(mission, numbered, tuple(came_from))


def _counts(metres: float) -> int:
    return round(metres * 1e4)


def _checked(item: Item, table: type, **values: Any) -> Any:
    """A table of the mission, whose own bounds decide."""
    from pydantic import ValidationError

    try:
        return table(**values)
    except ValidationError as error:
        first = error.errors()[0]
        field = str(first["loc"][0]) if first["loc"] else ""
        blame = {
            "height_m": MissionResult.INVALID_PARAM7,
            "wait_s": MissionResult.INVALID_PARAM1,
            "heading_deg": MissionResult.INVALID_PARAM4,
            "speed_m_s": MissionResult.INVALID,
        }.get(field, MissionResult.INVALID)
        raise _refuse(item, blame, f"{field} {values.get(field)!r}: {first['msg'].lower()}") from error


def _waypoint(
    item: Item, place: Triple, wait_s: float, heading: float | None, speed: float | None
) -> Waypoint:
    made: Waypoint = _checked(
        item, Waypoint, position_m=place, wait_s=wait_s, heading_deg=heading, speed_m_s=speed
    )
    return made


def _wait(item: Item) -> float:
    wait = item.params[0]
    if math.isnan(wait):
        return 0.0
    if not 0.0 <= wait <= 3600.0:
        raise _refuse(item, MissionResult.INVALID_PARAM1, f"a wait of {wait:g} s is outside of 0 to 3600 s")
    return wait


def _heading(item: Item, k: int, blame: MissionResult) -> float | None:
    deg = item.params[k]
    if math.isnan(deg):
        return None
    if abs(deg) > 360.0:
        raise _refuse(item, blame, f"a heading of {deg:g} deg is outside of +-360")
    return deg


def _speed(item: Item, before: float | None) -> float | None:
    kind, speed = item.params[0], item.params[1]
    if kind not in (0.0, 1.0):
        raise _refuse(item, MissionResult.INVALID_PARAM1, "only the horizontal speed (0, 1) can be changed")
    if speed in (-1.0, -2.0):
        return before if speed == -1.0 else None
    if not 0.0 < speed <= 3.0:
        raise _refuse(item, MissionResult.INVALID_PARAM2, f"a speed of {speed:g} m/s is outside of 0 to 3")
    return float(f"{speed:.7g}")


def _down(item: Item, origin: Origin | None) -> float:
    """D of an item (m)."""
    if item.frame == _NED:
        down = item.z
    elif item.frame == _ENU or (item.frame in ABOVE_ORIGIN and origin is not None):
        down = -item.z
    elif item.frame in ABOVE_SEA and origin is not None:
        down = origin.alt_m - item.z
    else:
        why = f"frame {item.frame} is not known; use LOCAL_NED (1)"
        if item.frame in (*ABOVE_SEA, *ABOVE_ORIGIN):
            why = f"frame {item.frame} needs a global origin; use LOCAL_NED (1), or give the vehicle one"
        raise _refuse(item, MissionResult.UNSUPPORTED_FRAME, why)
    if not math.isfinite(down) or down > -LOWEST_M:
        raise _refuse(
            item, MissionResult.INVALID_PARAM7, f"height {-down:g} m; it has to be at least {LOWEST_M:g} m"
        )
    return float(f"{down:.7g}")


def _level(item: Item, origin: Origin | None) -> tuple[float, float]:
    """N and E of an item (m); NaN where not given."""
    if item.frame in (_NED, _ENU):
        a, b = (unscaled(v, 1e-4) for v in (item.x, item.y))
        return (a, b) if item.frame == _NED else (b, a)
    if origin is None:
        return math.nan, math.nan
    lat, lon = (unscaled(v, 1e-7) for v in (item.x, item.y))
    n, e, _ = origin.to_local(lat, lon, 0.0)
    return n, e


def _place(item: Item, origin: Origin | None) -> Triple:
    down = _down(item, origin)
    n, e = _level(item, origin)
    if math.isnan(n):
        raise _refuse(item, MissionResult.INVALID_PARAM5_X, "x is not given")
    if math.isnan(e):
        raise _refuse(item, MissionResult.INVALID_PARAM6_Y, "y is not given")
    return n, e, down


def _above(item: Item, origin: Origin | None, last: Waypoint) -> Triple | None:
    """Where to fly before landing, at the height of the last waypoint; None if it is there, or no place is given."""
    n, e = _level(item, origin)
    before = last.position_m
    if math.isnan(n) or math.isnan(e) or math.dist((n, e), before[:2]) < _SAME_PLACE_M:
        return None
    return n, e, before[2]


_MISSION, _FENCE, _RALLY, _ALL = 0, 1, 2, 255
_DOWNLOADS = 16
_CLEAR_WITHIN_S = 3.0
_WHY: dict[int, str] = {
    MissionResult.NO_SPACE: f"mission refused: it has more than {LIMIT} items",
    MissionResult.DENIED: "mission refused: another station is sending one; wait until it is done",
    MissionResult.UNSUPPORTED: "refused: missions are known here, fences and rally points are not",
}
"""Refusals that need no look at the items, in words."""
_NO_MISSION, _NOT_STARTED, _ACTIVE, _PAUSED, _COMPLETE = 1, 2, 3, 4, 5


class MissionProtocol:
    """The vehicle's side of the mission protocol: who uploads, who downloads, and where the mission stands.

    A mission that has come in whole is judged, loaded and acknowledged in one step: loaded whole, or refused with
    everything left as it was. Fences and rally points do not exist here: their lists are empty.

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
        out = [*self._receiver.step(now_s), *self._clear_at_rest(now_s)]
        for giver in self._senders.values():
            out += giver.step(now_s)
        self._send(out)

    def forget(self, peer: object) -> None:
        """A peer has gone: its transfers end, the mission stays what it was."""
        for key in [k for k in self._senders if k[0].peer == peer]:
            del self._senders[key]
        taker = self._receiver.peer
        if isinstance(taker, Source) and taker.peer == peer:
            self._receiver.cancel()

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

    def _only_from_commander(self) -> Notes:
        """An upload ends, with nothing changed, when whoever began it does not command any more."""
        taker = self._receiver.peer
        return [] if taker is None or taker == self._authority.commander else self._receiver.cancel()

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
        items = self.plan.items if note.mission_type == _MISSION else ()
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
