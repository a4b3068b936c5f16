"""Effects of the user's requests on the mission: stop, waypoints, pause, resumption, return and landing."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mufly.compiled.portable_math import vector_length
from mufly.mission.detour import DETOUR_ACCELERATION_M_S2
from mufly.mission.files.mission_schema import MIN_WAYPOINT_HEIGHT_M
from mufly.mission.machine.ground_phases import start_landing
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.mission_reference import current_reference
from mufly.mission.machine.mission_state import (
    MissionPlan,
    MissionState,
    State,
    enter_hover,
    enter_state,
    fail_mission,
    log_event,
)
from mufly.mission.machine.offboard import MAX_HEIGHT_M
from mufly.mission.machine.phases import change_leg_goal, plan_braking, start_leg, start_leg_home
from mufly.mission.trajectory import Trajectory, Triple, compute_stop_time_and_distance, plan_straight, wrap_turn

_SAME_POSITION_TOLERANCE_M, _SAME_HEADING_TOLERANCE_RAD = 0.01, math.radians(0.5)
"""Difference up to which a target is the present one (m, rad): the rounding of a link's coordinates."""
_MIN_TARGET_LOG_INTERVAL_S = 1.0
"""Interval below which changes of the target are not logged (s)."""
_STOP_AT_GOAL_MARGIN_M = 0.3
"""Distance beyond the shortest stop up to which a turn keeps the goal of the present leg (m)."""


def stop_motors(s: MissionState, why: str) -> MissionState:
    """Stop the motors in any state."""
    if s.state is State.INIT and s.motors == "off":
        return s
    if s.has_taken_off or s.mission_begun:
        s = fail_mission(s, why)
    return enter_state(s, State.INIT, why, level="error", motors="off", detour=None, finished=s.outcome != "")


def describe_user_waypoint_fault(where: Triple | None, heading: float | None) -> str:
    """Return the reason to refuse a user's waypoint; "" if it is valid."""
    if heading is not None and not math.isfinite(heading):
        return LogTemplate.HEADING_REFUSED(heading)
    if where is None:
        return ""
    if not all(math.isfinite(v) for v in where) or where[2] > -MIN_WAYPOINT_HEIGHT_M:
        return LogTemplate.USER_WAYPOINT_TOO_LOW(*where, -MIN_WAYPOINT_HEIGHT_M)
    if where[2] < -MAX_HEIGHT_M or vector_length(where[0], where[1]) > 1e4:
        return LogTemplate.USER_WAYPOINT_TOO_FAR(*where, -MAX_HEIGHT_M)
    return ""


def _compass_deg(heading: float) -> float:
    deg = math.degrees(wrap_turn(heading))
    return deg + (360.0 if deg < 0.0 else 0.0)


def _is_already_requested(s: MissionState, goal: Triple | None, heading: float | None) -> bool:
    """Return whether the vehicle already does what the user requests."""
    before = s.requested_heading
    same = (
        before is None
        if heading is None
        else before is not None and abs(heading - before) <= _SAME_HEADING_TOLERANCE_RAD
    )
    near = goal is None or all(abs(a - b) <= _SAME_POSITION_TOLERANCE_M for a, b in zip(goal, s.goal, strict=True))
    return s.user_in_control and not s.returning_home and same and near


def _can_stop_at_goal(s: MissionState) -> bool:
    """Return whether the reference is so near the goal of a leg that it comes to rest there if it brakes now."""
    now = current_reference(s)
    (n, e, d), (gn, ge, gd) = now.position, s.goal
    _, rest = compute_stop_time_and_distance(vector_length(*now.velocity), DETOUR_ACCELERATION_M_S2)
    return s.state is State.WAYPOINT and vector_length(n - gn, e - ge, d - gd) <= rest + _STOP_AT_GOAL_MARGIN_M


def fly_to_user_waypoint(
    plan: MissionPlan, s: MissionState, where: Triple | None, heading: float | None
) -> MissionState:
    """Stop, fly to ``where`` and hold; the mission waits. Without ``where`` only turn on the spot."""
    refused = describe_user_waypoint_fault(where, heading)
    if refused:
        return s if s.events[-1].text == refused else log_event(s, refused, level="warning")
    goal = None if where is None else (float(where[0]), float(where[1]), float(where[2]))
    if _is_already_requested(s, goal, heading):
        return s
    if goal is None:
        text = LogTemplate.TURNING_TO_HEADING(_compass_deg(0.0 if heading is None else heading))
    elif heading is None:
        text = LogTemplate.TO_USER_WAYPOINT(*goal)
    else:
        text = LogTemplate.TO_USER_WAYPOINT_WITH_HEADING(*goal, math.degrees(heading))

    place = (s.goal if _can_stop_at_goal(s) else None) if goal is None else goal
    if place is not None and s.user_in_control and not s.returning_home and s.state in (State.WAYPOINT, State.OBSTACLE):
        quiet = s.time_s - s.state_entered_s < _MIN_TARGET_LOG_INTERVAL_S
        return change_leg_goal(plan, s, text, place, heading, quiet=quiet)

    def plan_straight_leg(at: Triple, psi: float) -> Trajectory:
        return plan_straight(at, at if goal is None else goal, psi, plan.trajectory_limits, final_heading=heading)

    return start_leg(plan, s, text, plan_straight_leg, user_in_control=True, requested_heading=heading)


def pause_mission(plan: MissionPlan, s: MissionState, why: str = LogTemplate.MISSION_PAUSED.value) -> MissionState:
    """Stop and hover; the mission waits."""
    if s.state is State.HOVER:
        return s if s.user_in_control else replace(log_event(s, why), user_in_control=True, abort_reason="")
    brake = plan_braking(plan, s)
    at = brake.evaluate(math.inf)
    n, e, d = at.position
    place = (n, e, min(d, -MIN_WAYPOINT_HEIGHT_M) if s.state is State.LANDING else d)
    flags: dict[str, Any] = {
        "user_in_control": True,
        "returning_home": False,
        "abort_reason": "",
        "requested_heading": None,
        "motors": "fly",
    }
    return enter_hover(s, why, place, at.heading, motion=brake, hover_until_s=s.time_s, **flags)


def resume_mission(plan: MissionPlan, s: MissionState, first: int | None) -> MissionState:
    """Resume the mission in flight, or fly to another waypoint of it."""
    n = len(plan.mission.waypoint)
    over = s.outcome == "succeeded" or s.waypoint_index >= n
    index = first if first is not None else 0 if over else s.waypoint_index
    if s.state is State.WAYPOINT and not s.user_in_control and index == s.waypoint_index:
        return s
    why = LogTemplate.MISSION_CONTINUES() if s.mission_begun and not over else LogTemplate.MISSION_BEGINS()
    if first is not None:
        why = LogTemplate.ON_TO_WAYPOINT(first + 1)
    s = replace(log_event(s, why), hover_until_s=s.time_s) if s.state is State.HOVER else pause_mission(plan, s, why)
    return replace(
        s, user_in_control=False, mission_begun=True, waypoint_index=index, outcome="", reason="", abort_reason=""
    )


def queue_mission_after_take_off(s: MissionState, first: int | None) -> MissionState:
    """Let the mission follow the take-off, from waypoint ``first`` (from 0) if given."""
    s = log_event(
        s, LogTemplate.MISSION_AFTER_TAKE_OFF_FROM(first + 1) if first else LogTemplate.MISSION_AFTER_TAKE_OFF()
    )
    return replace(
        s,
        user_in_control=False,
        mission_begun=True,
        waypoint_index=first or 0,
        abort_reason="",
        hover_after_take_off=False,
    )


def _set_abort_reason_if_unfinished(
    plan: MissionPlan, s: MissionState, last: LogTemplate, early: LogTemplate
) -> MissionState:
    left = len(plan.mission.waypoint) - s.waypoint_index
    if not s.mission_begun or left <= 0:
        return s
    return replace(s, abort_reason=(early if left > 1 else last)(left))


def return_on_request(plan: MissionPlan, s: MissionState) -> MissionState:
    """Start the return: fly to above the take-off position and land."""
    return (
        s
        if s.returning_home
        else start_leg_home(
            plan,
            _set_abort_reason_if_unfinished(
                plan, s, LogTemplate.RETURN_BEFORE_LAST_WAYPOINT, LogTemplate.RETURN_WITH_WAYPOINTS_LEFT
            ),
            LogTemplate.RETURN_SIGNAL(),
        )
    )


def land_on_request(plan: MissionPlan, s: MissionState) -> MissionState:
    """Start a landing by the user's signal."""
    return start_landing(
        _set_abort_reason_if_unfinished(
            plan, s, LogTemplate.LAND_BEFORE_LAST_WAYPOINT, LogTemplate.LAND_WITH_WAYPOINTS_LEFT
        ),
        LogTemplate.LAND_SIGNAL(),
    )
