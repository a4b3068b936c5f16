"""A mission that is being drawn: what one does to it, step by step and back, and whether it could be flown.

A :class:`Draft` is frozen: every edit makes the next one, and the missions before it are what undo goes back to. An
edit that the mission's schema refuses (a wait of -1 s) changes nothing; one that the geometry refuses (a waypoint in a
crate) is kept and named, since one draws through such states. :mod:`mufly.mission.check` judges, as for a file.

Rows are numbered as a table shows them: 0 is the take-off, 1 to n the waypoints, n + 1 the end.
"""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mufly.errors import InputError
from mufly.link.codec import Origin
from mufly.link.mission_transfer import Item
from mufly.mission import (
    Fence,
    Limits,
    Mission,
    Waypoint,
    check_geometry,
    check_mission,
    mission_tables,
    slowed,
)
from mufly.mission.check import MissionEstimate
from mufly.mission.items import Refusal, plan_of
from mufly.tables import validated

NEW_NAME = "new-mission"
"""Of a mission that is begun anew: a file under the name of another would replace it."""
MOST_STEPS = 200
MOST_WAYPOINTS = 250
WHERE = "mission"
OWN_WAYPOINT = ("wait_s", "heading_deg", "speed_m_s")
_AXES = {"north": 0, "east": 1, "height": 2}
_SENT = frozenset({"waypoint", "at_end", "name", "description"})
_WAYPOINT_KEY = re.compile(r"waypoint\[(\d+)\]")

Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Draft:
    """A mission, what it was before, and what undo took back.

    Attributes
    ----------
    mission : Mission
        It keeps to the schema; whether it can be flown is for :func:`judge`.
    past, future : tuple of Mission
        For undo and redo, the nearest last.
    gesture : str
        The drag that made the last step: what follows of the same drag is no step of its own.
    """

    mission: Mission = field(default_factory=Mission)
    past: tuple[Mission, ...] = ()
    future: tuple[Mission, ...] = ()
    gesture: str = ""

    def to(self, mission: Mission, gesture: str = "") -> Draft:
        """The next draft; ``gesture`` names the drag it belongs to, "" for a step of its own."""
        if mission == self.mission:
            return self
        going_on = gesture != "" and gesture == self.gesture
        past = self.past if going_on else (*self.past, self.mission)[-MOST_STEPS:]
        return Draft(mission, past, (), gesture)

    def undo(self) -> Draft:
        """The draft before the last step; the same one if there is none."""
        if not self.past:
            return self
        return Draft(self.past[-1], self.past[:-1], (*self.future, self.mission))

    def redo(self) -> Draft:
        """The draft with the step that was taken back last; the same one if there is none."""
        if not self.future:
            return self
        return Draft(self.future[-1], (*self.past, self.mission), self.future[:-1])


# ---- edits: each takes a mission and returns another


def changed(mission: Mission, **parts: Any) -> Mission:
    """The mission with other parts, checked by its schema.

    Raises
    ------
    InputError
        Naming the item, the value and what would be right.
    """
    return validated(Mission, mission.model_dump(exclude_none=True) | parts, WHERE)


def _with(mission: Mission, waypoints: Sequence[Waypoint | Mapping[str, Any]]) -> Mission:
    if len(waypoints) > MOST_WAYPOINTS:
        problem = f"{len(waypoints)} are more than this table holds"
        raise InputError(WHERE, "waypoint", problem, f"draw at most {MOST_WAYPOINTS}")
    tables = [
        w.model_dump(exclude_none=True)
        if isinstance(w, Waypoint)
        else {k: v for k, v in w.items() if v is not None}
        for w in waypoints
    ]
    return changed(mission, waypoint=tables)


def _known(mission: Mission, k: int) -> Waypoint:
    if not 1 <= k <= len(mission.waypoint):
        problem = f"there is no waypoint {k}"
        raise InputError(WHERE, "waypoint", problem, f"the mission has {len(mission.waypoint)}")
    return mission.waypoint[k - 1]


def add(mission: Mission, place: Place, after: int | None = None) -> Mission:
    """Add a waypoint (N, E, D; m) behind row ``after``; at the end if none is given."""
    n = len(mission.waypoint)
    at = n if after is None else min(max(after, 0), n)
    return _with(mission, [*mission.waypoint[:at], {"position_m": place}, *mission.waypoint[at:]])


def insert(mission: Mission, k: int) -> Mission:
    """Insert a waypoint half way before waypoint ``k`` (from 1), or before where it would be."""
    goal = _known(mission, k).position_m
    before = (*mission.start_m, -mission.take_off.height_m) if k == 1 else mission.waypoint[k - 2].position_m
    north, east, down = (round(0.5 * (a + b), 3) for a, b in zip(before, goal, strict=True))
    return add(mission, (north, east, down), k - 1)


def delete(mission: Mission, k: int) -> Mission:
    """Delete waypoint ``k`` (from 1)."""
    _known(mission, k)
    return _with(mission, [w for i, w in enumerate(mission.waypoint, 1) if i != k])


def shift(mission: Mission, k: int, by: int) -> Mission:
    """Fly waypoint ``k`` (from 1) ``by`` places later; the same mission where it is the first or last already."""
    moved, rest = _known(mission, k), [w for i, w in enumerate(mission.waypoint, 1) if i != k]
    at = min(max(k - 1 + by, 0), len(rest))
    return _with(mission, [*rest[:at], moved, *rest[at:]])


def move(mission: Mission, k: int, place: Place) -> Mission:
    """Move a row to a place (N, E, D; m); of the take-off (row 0) that is where it starts, and its height."""
    if k == 0:
        climb = mission.take_off.model_dump() | {"height_m": -place[2]}
        return changed(mission, start_m=place[:2], take_off=climb)
    own = _known(mission, k).model_dump()
    return _with(
        mission, [own | {"position_m": place} if i == k else w for i, w in enumerate(mission.waypoint, 1)]
    )


def put(mission: Mission, k: int, name: str, value: float | None) -> Mission:
    """Set one field of a row: ``north``, ``east``, ``height`` (m), or one of the file's (``wait_s``, ...)."""
    if name in _AXES:
        if value is None:
            raise InputError(WHERE, _row_key(k), f"{name} is missing", "give metres")
        n, e, d = (*mission.start_m, -mission.take_off.height_m) if k == 0 else _known(mission, k).position_m
        value = -value if name == "height" else value
        at = [n, e, d]
        at[_AXES[name]] = value
        return move(mission, k, (at[0], at[1], at[2]))
    if k == 0 and name == "wait_s":
        return changed(mission, take_off=mission.take_off.model_dump() | {"wait_s": value or 0.0})
    if name not in OWN_WAYPOINT or k == 0:
        raise InputError(
            WHERE, _row_key(k), f"has no field {name!r}", f"use {', '.join((*_AXES, *OWN_WAYPOINT))}"
        )
    own = _known(mission, k).model_dump() | {name: 0.0 if value is None and name == "wait_s" else value}
    return _with(mission, [own if i == k else w for i, w in enumerate(mission.waypoint, 1)])


def _row_key(k: int) -> str:
    return f"waypoint[{k}]" if k else "take_off"


def edited(draft: Draft, order: Mapping[str, Any]) -> Draft:
    """Do what a window asks: ``{"op": "move", "row": 2, "at": [1.0, 0.5, -1.0], "gesture": "7"}`` and its like.

    Raises
    ------
    InputError
        If it makes no sense or the schema refuses it; the draft is as it was.
    """
    m, op = draft.mission, order.get("op")
    if op == "undo":
        return draft.undo()
    if op == "redo":
        return draft.redo()
    doing: dict[object, Callable[[], Mission]] = {
        "add": lambda: add(
            m, _place(order), _row(order, "after") if order.get("after") is not None else None
        ),
        "insert": lambda: insert(m, _row(order)),
        "delete": lambda: delete(m, _row(order)),
        "shift": lambda: shift(m, _row(order), _row(order, "by")),
        "move": lambda: move(m, _row(order), _place(order)),
        "put": lambda: put(m, _row(order), str(order.get("name")), _value(order)),
        "end": lambda: changed(m, at_end=order.get("value")),
        "name": lambda: changed(m, name=str(order.get("value", ""))[:80]),
        "empty": lambda: changed(_with(m, []), name=NEW_NAME, description=""),
    }
    act = doing.get(op)
    if act is None:
        raise InputError(
            WHERE, "", f"{op!r} is nothing that is done to a mission", f"use {', '.join(map(str, doing))}"
        )
    return draft.to(act(), str(order.get("gesture") or ""))


def _row(order: Mapping[str, Any], name: str = "row") -> int:
    value = order.get(name)
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(WHERE, name, f"{value!r} is no whole number", "name a row of the table")
    return value


def _number(value: object, key: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise InputError(WHERE, key, f"{value!r} is no number", "give a finite one")
    return float(value)


def _place(order: Mapping[str, Any]) -> Place:
    at = order.get("at")
    if not isinstance(at, list | tuple) or len(at) != 3:
        raise InputError(WHERE, "at", f"{at!r} is no place", "give N, E and D in metres")
    n, e, d = (_number(v, "at") for v in at)
    return n, e, d


def _value(order: Mapping[str, Any]) -> float | None:
    value = order.get("value")
    return None if value is None else _number(value, str(order.get("name")))


# ---- whether it can be flown


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the check of a mission says.

    Attributes
    ----------
    fault : str
        One line that names the item and why; "" if it can be flown.
    row : int or None
        The row of the table that is to blame.
    estimate : MissionEstimate or None
        What it takes; of a vehicle whose battery is not known, time and length only (``fraction`` is NaN).
    """

    fault: str = ""
    row: int | None = None
    estimate: MissionEstimate | None = None


def judge(
    mission: Mission, battery: tuple[float, float] | None = None, able: Limits | None = None
) -> Verdict:
    """Check a mission as the command line checks its file.

    Parameters
    ----------
    mission : Mission
    battery : (hover_current_A, capacity_Ah), optional
        Of the vehicle, where it is known: then the charge has to last.
    able : Limits, optional
        What the vehicle's controllers can follow, where it is known: it flies no faster.
    """
    try:
        check_geometry(mission, mission.name or WHERE)
        current_A, capacity_Ah = battery or (1.0, math.inf)
        flown = mission if able is None else slowed(mission, able)[0]
        estimate = check_mission(
            flown, hover_current_A=current_A, capacity_Ah=capacity_Ah, where=mission.name or WHERE
        )
    except InputError as error:
        return Verdict(f"{error.key}: {error.problem}; {error.remedy}", row_of(error.key, mission))
    if battery is None:
        estimate = replace(estimate, charge_Ah=math.nan, fraction=math.nan)
    return Verdict(estimate=estimate)


def row_of(key: str, mission: Mission) -> int | None:
    """Row of the table that a key of a mission file belongs to; None if it is no item's."""
    if found := _WAYPOINT_KEY.match(key):
        return int(found[1])
    if key.startswith(("take_off", "start_m")):
        return 0
    return len(mission.waypoint) + 1 if key == "at_end" else None


@dataclass
class Sketch:
    """The draft of a station, and what the check says of it.

    Attributes
    ----------
    draft : Draft
    held : Mission or None
        What the vehicle began with, as far as the station knows: it keeps of it what is not sent.
    verdict : Verdict or None
        None while it is being checked.
    version : int
        Counts the changes of either.
    """

    draft: Draft = field(default_factory=Draft)
    held: Mission | None = None
    verdict: Verdict | None = None
    version: int = 0
    _judging: bool = False

    def take(self, draft: Draft) -> None:
        """Go on with another draft."""
        if draft.mission is not self.draft.mission:
            self.verdict = None
        if draft is not self.draft:
            self.draft = draft
            self.version += 1

    async def check(self, battery: tuple[float, float] | None, able: Limits | None = None) -> Verdict:
        """Judge the draft, unless that is under way; what changes meanwhile is judged after it."""
        while self._judging:
            await asyncio.sleep(0.02)
        self._judging = True
        try:
            while self.verdict is None:
                mission = self.draft.mission
                verdict = await asyncio.to_thread(judge, mission, battery, able)
                if mission is self.draft.mission:
                    self.verdict = verdict
                    self.version += 1
        finally:
            self._judging = False
        return self.verdict


# ---- files, and what a vehicle holds


def opened(text: str, name: str) -> Mission:
    """Read a mission file to go on with; unlike for a flight, it need not be one that can be flown.

    Raises
    ------
    InputError
        If it is no mission file or does not keep to the schema.
    """
    mission: Mission = validated(Mission, mission_tables(text, name), name)
    return mission


def of_vehicle(items: Sequence[Item], base: Mission, origin: Origin | None) -> Mission:
    """The mission of items that a vehicle holds; what items do not tell is taken from ``base``.

    Raises
    ------
    InputError
        Naming the item that no mission file can say.
    """
    try:
        return plan_of(items, base, origin).mission
    except Refusal as refusal:
        raise InputError("vehicle", "", str(refusal), "the mission in the editor is as it was") from None


def kept_back(mission: Mission, held: Mission | None) -> list[str]:
    """Keys in which a mission differs from what the vehicle has, and which items of MAVLink do not carry.

    Parameters
    ----------
    mission : Mission
        That is sent.
    held : Mission or None
        The vehicle's, as far as the station knows it; None: the defaults.
    """
    other = held if held is not None else Mission()
    keys = [k for k in Mission.model_fields if k not in _SENT and getattr(mission, k) != getattr(other, k)]
    if "fence" in keys and mission.fence is not None:
        keys.remove("fence")  # its zones are sent
        old = other.fence or Fence.model_construct(ceiling_m=None, action="hold")
        if (mission.fence.ceiling_m, mission.fence.action) != (old.ceiling_m, old.action):
            keys += ["fence.ceiling_m", "fence.action"]
    if "take_off" in keys and mission.take_off.wait_s == other.take_off.wait_s:
        keys.remove("take_off")  # the height is sent
    return ["take_off.wait_s" if k == "take_off" else k for k in keys]


def shown(draft: Draft, verdict: Verdict | None, refused: str) -> dict[str, Any]:
    """What a window draws: rows, and what the check says of them.

    Parameters
    ----------
    draft : Draft
    verdict : Verdict or None
        None while it is being checked.
    refused : str
        Why the last edit was not made, "" if it was.
    """
    m = draft.mission
    estimate = verdict.estimate if verdict is not None else None
    return {
        "name": m.name,
        "start": [*m.start_m, m.take_off.height_m],
        "take_off_wait": m.take_off.wait_s,
        "rows": [
            {"at": [w.position_m[0], w.position_m[1], -w.position_m[2]], "wait": w.wait_s, "heading": w.heading_deg,
             "speed": w.speed_m_s} for w in m.waypoint
        ],
        "at_end": m.at_end,
        "spline": m.path.kind == "spline",
        "undo": len(draft.past),
        "redo": len(draft.future),
        "checked": verdict is not None,
        "fault": verdict.fault if verdict is not None else "",
        "bad": verdict.row if verdict is not None else None,
        "refused": refused,
        "estimate": estimate and {
            "s": estimate.duration_s, "m": estimate.path_m,
            "share": estimate.fraction if math.isfinite(estimate.fraction) else None,
        },
    }  # fmt: skip
