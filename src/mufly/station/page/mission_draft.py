"""The mission draft of the editor: edits with undo and redo, and the check whether it can be flown.

A :class:`MissionDraft` is frozen: every edit returns a new draft, which holds the earlier missions for undo.
An edit that the mission's schema refuses (a wait of -1 s) changes nothing. An edit that violates the geometry (a
waypoint in a crate) is kept and reported, since editing passes through such states.
:mod:`mufly.mission.files.mission_checks` checks drafts as files.

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
from mufly.files.input_files import validate_model
from mufly.link.codec import GlobalOrigin
from mufly.link.mission_transfer import MissionItem
from mufly.mission import (
    Fence,
    Mission,
    TrajectoryLimits,
    Waypoint,
    check_mission_clearance,
    check_mission_endurance,
    read_mission_tables,
    reduce_mission_limits,
)
from mufly.mission.files.mission_checks import MissionEstimate
from mufly.mission.files.mission_items import MissionRefusedError, mission_from_items

NEW_MISSION_NAME = "new-mission"
"""Name of a new mission, so that its file replaces no other."""
MAX_UNDO_STEPS = 200
MAX_WAYPOINTS = 250
ERROR_LOCATION = "mission"
WAYPOINT_OPTIONS = ("wait_s", "heading_deg", "speed_m_s")
_AXIS_INDEX = {"north": 0, "east": 1, "height": 2}
_TRANSMITTED_KEYS = frozenset({"waypoint", "at_end", "name", "description"})
_WAYPOINT_KEY_PATTERN = re.compile(r"waypoint\[(\d+)\]")

PlaceNED = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MissionDraft:
    """A mission with its undo and redo history.

    Attributes
    ----------
    mission : Mission
        Mission that satisfies the schema; :func:`check_draft` checks whether it can be flown.
    undo_stack, redo_stack : tuple of Mission
        Missions for undo and redo, the nearest last.
    drag_gesture : str
        Drag that made the last step; further edits of the same drag extend this step.
    """

    mission: Mission = field(default_factory=Mission)
    undo_stack: tuple[Mission, ...] = ()
    redo_stack: tuple[Mission, ...] = ()
    drag_gesture: str = ""

    def with_mission(self, mission: Mission, gesture: str = "") -> MissionDraft:
        """Return the draft with ``mission`` as its newest edit.

        Edits with the same ``gesture``, a drag, are one step of undo; "" makes a step of its own.
        """
        if mission == self.mission:
            return self
        going_on = gesture != "" and gesture == self.drag_gesture
        past = self.undo_stack if going_on else (*self.undo_stack, self.mission)[-MAX_UNDO_STEPS:]
        return MissionDraft(mission, past, (), gesture)

    def undo(self) -> MissionDraft:
        """Return the draft before the last edit; the same draft if there is none."""
        if not self.undo_stack:
            return self
        return MissionDraft(self.undo_stack[-1], self.undo_stack[:-1], (*self.redo_stack, self.mission))

    def redo(self) -> MissionDraft:
        """Return the draft with the last undone edit; the same draft if there is none."""
        if not self.redo_stack:
            return self
        return MissionDraft(self.redo_stack[-1], (*self.undo_stack, self.mission), self.redo_stack[:-1])


# ---- edits: each takes a mission and returns another


def replace_mission_parts(mission: Mission, **parts: Any) -> Mission:
    """Return a copy of the mission with the fields ``parts`` replaced, validated by its schema.

    Raises
    ------
    InputError
        If the schema refuses it; the error names item, value and remedy.
    """
    return validate_model(Mission, mission.model_dump(exclude_none=True) | parts, ERROR_LOCATION)


def _replace_waypoints(mission: Mission, waypoints: Sequence[Waypoint | Mapping[str, Any]]) -> Mission:
    if len(waypoints) > MAX_WAYPOINTS:
        problem = f"{len(waypoints)} waypoints exceed the limit"
        raise InputError(ERROR_LOCATION, "waypoint", problem, f"use at most {MAX_WAYPOINTS}")
    tables = [
        w.model_dump(exclude_none=True) if isinstance(w, Waypoint) else {k: v for k, v in w.items() if v is not None}
        for w in waypoints
    ]
    return replace_mission_parts(mission, waypoint=tables)


def _require_waypoint(mission: Mission, k: int) -> Waypoint:
    if not 1 <= k <= len(mission.waypoint):
        problem = f"there is no waypoint {k}"
        raise InputError(ERROR_LOCATION, "waypoint", problem, f"give 1 to {len(mission.waypoint)}")
    return mission.waypoint[k - 1]


def add_waypoint(mission: Mission, place: PlaceNED, after: int | None = None) -> Mission:
    """Add a waypoint (N, E, D; m) after row ``after``, by default at the end."""
    n = len(mission.waypoint)
    at = n if after is None else min(max(after, 0), n)
    return _replace_waypoints(mission, [*mission.waypoint[:at], {"position_m": place}, *mission.waypoint[at:]])


def insert_waypoint(mission: Mission, k: int) -> Mission:
    """Insert a waypoint half way between waypoint ``k`` (from 1) and the preceding row."""
    goal = _require_waypoint(mission, k).position_m
    before = (*mission.start_m, -mission.take_off.height_m) if k == 1 else mission.waypoint[k - 2].position_m
    north, east, down = (round(0.5 * (a + b), 3) for a, b in zip(before, goal, strict=True))
    return add_waypoint(mission, (north, east, down), k - 1)


def delete_waypoint(mission: Mission, k: int) -> Mission:
    """Delete waypoint ``k`` (from 1)."""
    _require_waypoint(mission, k)
    return _replace_waypoints(mission, [w for i, w in enumerate(mission.waypoint, 1) if i != k])


def reorder_waypoint(mission: Mission, k: int, by: int) -> Mission:
    """Move waypoint ``k`` (from 1) by ``by`` places; the mission is unchanged at the first or last place."""
    moved, rest = _require_waypoint(mission, k), [w for i, w in enumerate(mission.waypoint, 1) if i != k]
    at = min(max(k - 1 + by, 0), len(rest))
    return _replace_waypoints(mission, [*rest[:at], moved, *rest[at:]])


def set_row_position(mission: Mission, k: int, place: PlaceNED) -> Mission:
    """Move row ``k`` of the mission table to a position (N, E, D; m).

    Row 0 is the take-off: start position and take-off height are set.
    """
    if k == 0:
        climb = mission.take_off.model_dump() | {"height_m": -place[2]}
        return replace_mission_parts(mission, start_m=place[:2], take_off=climb)
    own = _require_waypoint(mission, k).model_dump()
    return _replace_waypoints(
        mission, [own | {"position_m": place} if i == k else w for i, w in enumerate(mission.waypoint, 1)]
    )


def set_row_value(mission: Mission, k: int, name: str, value: float | None) -> Mission:
    """Set one field of a row: ``north``, ``east``, ``height`` (m), or a key of the mission file (``wait_s``, ...)."""
    if name in _AXIS_INDEX:
        if value is None:
            raise InputError(ERROR_LOCATION, _make_row_key(k), f"{name} is missing", "give metres")
        n, e, d = (*mission.start_m, -mission.take_off.height_m) if k == 0 else _require_waypoint(mission, k).position_m
        value = -value if name == "height" else value
        at = [n, e, d]
        at[_AXIS_INDEX[name]] = value
        return set_row_position(mission, k, (at[0], at[1], at[2]))
    if k == 0 and name == "wait_s":
        return replace_mission_parts(mission, take_off=mission.take_off.model_dump() | {"wait_s": value or 0.0})
    if name not in WAYPOINT_OPTIONS or k == 0:
        raise InputError(
            ERROR_LOCATION,
            _make_row_key(k),
            f"has no field {name!r}",
            f"use {', '.join((*_AXIS_INDEX, *WAYPOINT_OPTIONS))}",
        )
    own = _require_waypoint(mission, k).model_dump() | {name: 0.0 if value is None and name == "wait_s" else value}
    return _replace_waypoints(mission, [own if i == k else w for i, w in enumerate(mission.waypoint, 1)])


def _make_row_key(k: int) -> str:
    return f"waypoint[{k}]" if k else "take_off"


def apply_draft_edit(draft: MissionDraft, order: Mapping[str, Any]) -> MissionDraft:
    """Return the draft after an edit, such as ``{"op": "move", "row": 2, "at": [1.0, 0.5, -1.0], "gesture": "7"}``.

    Raises
    ------
    InputError
        If the edit is invalid or the schema refuses the result; the draft is unchanged.
    """
    m, op = draft.mission, order.get("op")
    if op == "undo":
        return draft.undo()
    if op == "redo":
        return draft.redo()
    doing: dict[object, Callable[[], Mission]] = {
        "add": lambda: add_waypoint(
            m, _read_position(order), _read_row_number(order, "after") if order.get("after") is not None else None
        ),
        "insert": lambda: insert_waypoint(m, _read_row_number(order)),
        "delete": lambda: delete_waypoint(m, _read_row_number(order)),
        "shift": lambda: reorder_waypoint(m, _read_row_number(order), _read_row_number(order, "by")),
        "move": lambda: set_row_position(m, _read_row_number(order), _read_position(order)),
        "put": lambda: set_row_value(m, _read_row_number(order), str(order.get("name")), _read_value(order)),
        "end": lambda: replace_mission_parts(m, at_end=order.get("value")),
        "name": lambda: replace_mission_parts(m, name=str(order.get("value", ""))[:80]),
        "empty": lambda: replace_mission_parts(_replace_waypoints(m, []), name=NEW_MISSION_NAME, description=""),
    }
    act = doing.get(op)
    if act is None:
        raise InputError(
            ERROR_LOCATION,
            "",
            f"{op!r} is not an operation on a mission",
            f"use {', '.join(map(str, doing))}",
        )
    return draft.with_mission(act(), str(order.get("gesture") or ""))


def _read_row_number(order: Mapping[str, Any], name: str = "row") -> int:
    value = order.get(name)
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(ERROR_LOCATION, name, f"{value!r} is not a whole number", "name a row of the table")
    return value


def _read_number(value: object, key: str) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise InputError(ERROR_LOCATION, key, f"{value!r} is not a number", "give a finite number")
    return float(value)


def _read_position(order: Mapping[str, Any]) -> PlaceNED:
    at = order.get("at")
    if not isinstance(at, list | tuple) or len(at) != 3:
        raise InputError(ERROR_LOCATION, "at", f"{at!r} is not a position", "give N, E and D in metres")
    n, e, d = (_read_number(v, "at") for v in at)
    return n, e, d


def _read_value(order: Mapping[str, Any]) -> float | None:
    value = order.get("value")
    return None if value is None else _read_number(value, str(order.get("name")))


# ---- whether it can be flown


@dataclass(frozen=True, slots=True)
class DraftCheck:
    """The result of the check of a draft.

    Attributes
    ----------
    fault : str
        One line with the item and the reason; "" if the mission can be flown.
    fault_row : int or None
        Row of the table with the fault.
    estimate : MissionEstimate or None
        Time, length and charge; without a known battery only time and length (``fraction`` is NaN).
    """

    fault: str = ""
    fault_row: int | None = None
    estimate: MissionEstimate | None = None


def check_draft(
    mission: Mission, battery: tuple[float, float] | None = None, able: TrajectoryLimits | None = None
) -> DraftCheck:
    """Check whether a mission draft can be flown, by the checks of ``mufly mission check``.

    Parameters
    ----------
    mission : Mission
    battery : (hover_current_A, capacity_Ah), optional
        Battery of the vehicle; if given, its charge must suffice.
    able : TrajectoryLimits, optional
        Limits of the vehicle's controllers, if known; they bound the speeds.
    """
    try:
        check_mission_clearance(mission, mission.name or ERROR_LOCATION)
        current_A, capacity_Ah = battery or (1.0, math.inf)
        flown = mission if able is None else reduce_mission_limits(mission, able)[0]
        estimate = check_mission_endurance(
            flown, hover_current_A=current_A, capacity_Ah=capacity_Ah, where=mission.name or ERROR_LOCATION
        )
    except InputError as error:
        return DraftCheck(f"{error.key}: {error.problem}; {error.remedy}", row_number_from_key(error.key, mission))
    if battery is None:
        estimate = replace(estimate, charge_Ah=math.nan, charge_fraction=math.nan)
    return DraftCheck(estimate=estimate)


def row_number_from_key(key: str, mission: Mission) -> int | None:
    """Return the table row of a key of a mission file; None if the key belongs to no item."""
    if found := _WAYPOINT_KEY_PATTERN.match(key):
        return int(found[1])
    if key.startswith(("take_off", "start_m")):
        return 0
    return len(mission.waypoint) + 1 if key == "at_end" else None


@dataclass
class SharedDraft:
    """The draft shared by the windows of a station, with its check result.

    Attributes
    ----------
    draft : MissionDraft
    vehicle_mission : Mission or None
        Mission in the vehicle before the upload, if known; the vehicle keeps the settings that items do not hold.
    verdict : DraftCheck or None
        None while the draft is being checked.
    version : int
        Number of changes of draft or verdict.
    """

    draft: MissionDraft = field(default_factory=MissionDraft)
    vehicle_mission: Mission | None = None
    verdict: DraftCheck | None = None
    version: int = 0
    _is_checking: bool = False

    def set_draft(self, draft: MissionDraft) -> None:
        """Replace the mission draft for all windows."""
        if draft.mission is not self.draft.mission:
            self.verdict = None
        if draft is not self.draft:
            self.draft = draft
            self.version += 1

    async def check_draft(
        self, battery: tuple[float, float] | None, able: TrajectoryLimits | None = None
    ) -> DraftCheck:
        """Check the draft; a draft changed during the check is checked after it."""
        while self._is_checking:
            await asyncio.sleep(0.02)
        self._is_checking = True
        try:
            while self.verdict is None:
                mission = self.draft.mission
                verdict = await asyncio.to_thread(check_draft, mission, battery, able)
                if mission is self.draft.mission:
                    self.verdict = verdict
                    self.version += 1
        finally:
            self._is_checking = False
        return self.verdict


# ---- files, and what a vehicle holds


def parse_mission_draft(text: str, name: str) -> Mission:
    """Read a mission file for editing; the mission need not be flyable.

    Raises
    ------
    InputError
        If the text is no mission file or violates the schema.
    """
    mission: Mission = validate_model(Mission, read_mission_tables(text, name), name)
    return mission


def mission_from_vehicle(items: Sequence[MissionItem], base: Mission, origin: GlobalOrigin | None) -> Mission:
    """Convert a vehicle's mission items to a mission; settings that the items lack are taken from ``base``.

    Raises
    ------
    InputError
        If an item has no equivalent in a mission file; the error names the item.
    """
    try:
        return mission_from_items(items, base, origin).mission
    except MissionRefusedError as refusal:
        raise InputError("vehicle", "", str(refusal), "the mission in the editor is unchanged") from None


def find_untransmitted_keys(mission: Mission, held: Mission | None) -> list[str]:
    """Return the keys that differ from the vehicle's mission and that MAVLink items cannot transfer.

    Parameters
    ----------
    mission : Mission
        Mission to be sent.
    held : Mission or None
        Mission in the vehicle, if the station knows it; None: the defaults.
    """
    other = held if held is not None else Mission()
    keys = [k for k in Mission.model_fields if k not in _TRANSMITTED_KEYS and getattr(mission, k) != getattr(other, k)]
    if "fence" in keys and mission.fence is not None:
        keys.remove("fence")  # its zones are sent
        old = other.fence or Fence.model_construct(ceiling_m=None, action="hold")
        if (mission.fence.ceiling_m, mission.fence.action) != (old.ceiling_m, old.action):
            keys += ["fence.ceiling_m", "fence.action"]
    if "take_off" in keys and mission.take_off.wait_s == other.take_off.wait_s:
        keys.remove("take_off")  # the height is sent
    return ["take_off.wait_s" if k == "take_off" else k for k in keys]


def encode_draft(draft: MissionDraft, verdict: DraftCheck | None, refused: str) -> dict[str, Any]:
    """Return a draft for a window: its waypoints as table rows, and the result of its check.

    Parameters
    ----------
    draft : MissionDraft
    verdict : DraftCheck or None
        None while it is being checked.
    refused : str
        Reason why the last edit was refused; "" if it was made.
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
        "undo": len(draft.undo_stack),
        "redo": len(draft.redo_stack),
        "checked": verdict is not None,
        "fault": verdict.fault if verdict is not None else "",
        "bad": verdict.fault_row if verdict is not None else None,
        "refused": refused,
        "estimate": estimate and {
            "s": estimate.duration_s, "m": estimate.path_m,
            "share": estimate.charge_fraction if math.isfinite(estimate.charge_fraction) else None,
        },
    }  # fmt: skip
