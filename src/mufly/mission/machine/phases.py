"""Behaviour of each mission state in the air, and the transitions into it (Fig. 6.15).

Every function takes a state and returns the next one; there is no other memory. The user's signals are handled in
:mod:`mufly.mission.machine.state_machine`, start and landing in :mod:`mufly.mission.machine.ground_phases`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mufly.compiled.portable_math import vector_length
from mufly.estimate import Estimate
from mufly.mission.avoidance import is_path_blocked, limit_approach_velocity
from mufly.mission.detour import DETOUR_ACCELERATION_M_S2, begin_detour, follow_contour
from mufly.mission.files.mission_schema import MIN_WAYPOINT_HEIGHT_M, plan_leg_trajectory
from mufly.mission.machine.ground_phases import has_spun_up, measured_position, reset_mission, start_landing
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.mission_reference import current_reference, has_departed, predict_step_end_reference
from mufly.mission.machine.mission_state import (
    MissionPlan,
    MissionState,
    State,
    enter_hover,
    enter_state,
    fail_mission,
    log_event,
)
from mufly.mission.machine.offboard import SetPoint, follow_set_point
from mufly.mission.trajectory import (
    BrakingMotion,
    Trajectory,
    TrajectoryPoint,
    Triple,
    plan_stop,
    plan_straight,
    wrap_turn,
)

_HOVER_BEFORE_LANDING_S = 2.0
_SETTLED_DISTANCE_M, _SETTLED_SPEED_M_S, _SETTLED_HEADING_RAD = 0.002, 0.01, 0.01
MIN_DISTANCE_FOR_TURN_M = 0.3
"""Level distance to a changed goal below which the nose does not turn to it (m)."""


def start_flight(
    plan: MissionPlan,
    s: MissionState,
    m: Estimate,
    *,
    height: float | None = None,
    first: int | None = None,
) -> MissionState:
    """Start a new flight: the mission or, with a ``height`` (m), a take-off only."""
    fresh = reset_mission(
        s, m, mission_begun=height is None, user_in_control=height is not None, waypoint_index=first or 0
    )
    x = fresh.home_position
    up = plan.mission.take_off.height_m if height is None else height
    goal = (x[0], x[1], -up)
    motion = plan_straight(x, goal, fresh.hold_heading, plan.trajectory_limits)
    why = LogTemplate.START_SIGNAL() if height is None else LogTemplate.TAKE_OFF_SIGNAL(up)
    return enter_state(fresh, State.TAKE_OFF, why, motors="spin_up", goal=goal, motion=motion)


def _hover_until(s: MissionState, why: str, at: Triple, ready_s: float) -> MissionState:
    return enter_hover(s, why, at, current_reference(s).heading, hover_until_s=ready_s)


def _is_at_goal(plan: MissionPlan, s: MissionState, m: Estimate) -> bool:
    """Whether the vehicle is near enough to its goal, and slow enough, to count as having reached it."""
    q = plan.mission.limits
    return _distance_to_goal(m, s.goal) < q.reach_m and vector_length(*m.velocity.tolist()) < q.reach_m_s


def step_take_off(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step the take-off: spin up, climb, and check progress."""
    if s.motors == "spin_up":
        return replace(s, motors="fly", motion_clock_s=0.0, state_entered_s=s.time_s) if has_spun_up(s, m) else s
    way = s.motion
    assert isinstance(way, Trajectory)
    late = s.motion_clock_s - way.duration_s
    if late >= 0.0:
        q = plan.mission.limits
        overdue = late > 8.0 + 0.5 * way.duration_s
        high = abs(m.position[2] - s.goal[2]) < q.reach_m and abs(m.velocity[2]) < q.reach_m_s
        if high and (overdue or _is_at_goal(plan, s, m)):
            ready = s.time_s + plan.mission.take_off.wait_s
            return _hover_until(s, LogTemplate.ALTITUDE_REACHED(-m.position[2]), s.goal, ready)
        gained = s.home_position[2] - m.position[2]
        if late > 3.0 and gained < 0.1:
            s = fail_mission(s, LogTemplate.TAKE_OFF_FAILED(gained, s.motion_clock_s))
            return enter_state(s, State.INIT, s.reason, level="error", motors="ramp_down")
        if overdue:
            why = LogTemplate.TAKE_OFF_SHORT(-m.position[2], -s.goal[2])
            return start_landing(fail_mission(s, why), why, level="warning")
    # On its legs the vehicle cannot avoid obstacles.
    return _start_detour_at_obstacle(plan, s) if m.position[2] < s.home_position[2] - 0.2 else s


def nose_offset(plan: MissionPlan) -> float:
    """Return the heading relative to the direction of flight (rad) with which a range beam points along the path."""
    return math.remainder(-plan.beam_ring.first_angle, plan.beam_ring.spacing) if plan.scans_by_yawing else 0.0


def plan_braking(plan: MissionPlan, s: MissionState) -> BrakingMotion:
    """Plan braking from the present motion of the reference."""
    now = predict_step_end_reference(s)
    return plan_stop(
        now.position,
        now.velocity,
        now.heading,
        DETOUR_ACCELERATION_M_S2,
        heading_rate=now.heading_rate,
        yaw_acceleration=plan.trajectory_limits.yaw_acceleration,
    )


def start_leg(
    plan: MissionPlan,
    s: MissionState,
    why: str,
    way: Callable[[Triple, float], Trajectory],
    **flags: object,
) -> MissionState:
    """Start a leg, after braking if the reference moves.

    ``way(position, heading)`` plans its trajectory.
    """
    at = current_reference(s)
    if vector_length(*at.velocity) > 0.01 or abs(at.heading_rate) > 0.01:
        brake = plan_braking(plan, s)
        at = brake.evaluate(math.inf)
        motion = way(at.position, at.heading).add_initial_braking(brake)
    else:
        motion = way(at.position, at.heading)
    fresh: dict[str, Any] = {
        "detour": None,
        "detour_duration_s": 0.0,
        "resumed_after_detour": False,
        "user_in_control": False,
        "returning_home": False,
    }
    fresh |= {"requested_heading": None, "motion": motion, "goal": motion.goal}
    return enter_state(s, State.WAYPOINT, why, **(fresh | flags))


def start_leg_home(plan: MissionPlan, s: MissionState, why: str) -> MissionState:
    """Fly to a point above the take-off position without descending, and land there."""

    def plan_straight_leg_home(at: Triple, heading: float) -> Trajectory:
        n, e, _ = s.home_position
        goal = (n, e, min(at[2], -MIN_WAYPOINT_HEIGHT_M))
        return plan_straight(at, goal, heading, plan.trajectory_limits, nose_offset=nose_offset(plan))

    return start_leg(plan, s, why, plan_straight_leg_home, user_in_control=True, returning_home=True)


def _complete_mission(plan: MissionPlan, s: MissionState) -> MissionState:
    """Hover, return or land after the wait at the last waypoint, as ``at_end`` in the mission file states."""
    if plan.mission.at_end == "hover":
        s = log_event(s, LogTemplate.MISSION_COMPLETE_HOLDING())
        return replace(s, user_in_control=True, outcome="succeeded", reason=LogTemplate.MISSION_COMPLETE())
    if plan.mission.at_end == "return":
        return start_leg_home(plan, s, LogTemplate.MISSION_COMPLETE_RETURNING())
    return start_landing(s, LogTemplate.MISSION_COMPLETE())


def step_hover(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step a hover: wait, then start the next leg or the landing."""
    if s.outcome == "failed":
        return start_landing(s, s.reason, level="warning") if s.time_s >= s.hover_until_s else s
    s = _start_detour_at_obstacle(plan, s)
    if s.state is not State.HOVER or s.user_in_control or s.time_s < s.hover_until_s:
        return s
    if s.waypoint_index >= len(plan.mission.waypoint):
        return _complete_mission(plan, s)

    def plan_leg(at: Triple, heading: float) -> Trajectory:
        offset = nose_offset(plan)
        return plan_leg_trajectory(
            plan.mission, s.waypoint_index, np.array(at), heading, nose_offset=offset, made=False
        )

    return start_leg(plan, s, LogTemplate.TO_WAYPOINT(s.waypoint_index + 1), plan_leg)


def _fail_and_hover(s: MissionState, why: str) -> MissionState:
    """Brake to a hover, from which the vehicle lands."""
    now = current_reference(s)
    brake = plan_stop(now.position, now.velocity, now.heading, DETOUR_ACCELERATION_M_S2)
    at = brake.evaluate(math.inf).position
    ready = s.time_s + brake.duration_s + _HOVER_BEFORE_LANDING_S
    s = fail_mission(s, why)
    return enter_hover(s, why, at, now.heading, level="warning", motion=brake, hover_until_s=ready)


def change_leg_goal(
    plan: MissionPlan, s: MissionState, why: str, goal: Triple, heading: float | None, *, quiet: bool
) -> MissionState:
    """Redirect the user's present leg to another goal without a stop, from the present motion of the reference.

    The reference follows the goal like a program's set-point (:mod:`mufly.mission.machine.offboard`), height and path
    together. Without a ``heading`` the nose turns along the way to the goal, unless that is short.
    """
    known = s.set_point_reference
    now = predict_step_end_reference(s) if known is None else known
    (n, e, _), aim = now.position, heading
    if aim is None and vector_length(goal[0] - n, goal[1] - e) < MIN_DISTANCE_FOR_TURN_M:
        aim = now.heading
    way = plan_straight(now.position, goal, now.heading, plan.trajectory_limits, final_heading=aim)
    changes: dict[str, Any] = {
        "motion": way,
        "goal": goal,
        "set_point_reference": now,
        "requested_heading": heading,
        "state_entered_s": s.time_s,
    }
    if known is not None:
        return replace(s if quiet else log_event(s, why), **changes)
    return enter_state(
        s, State.WAYPOINT, why, detour=None, detour_duration_s=0.0, resumed_after_detour=False, **changes
    )


def track_set_point(
    plan: MissionPlan, s: MissionState, at: TrajectoryPoint, wanted: SetPoint, m: Estimate, dt: float
) -> TrajectoryPoint:
    """Return the reference one time step later, which follows a set-point within the mission's limits.

    It keeps away from obstacles that the beams have hit.
    """
    here = measured_position(m)

    def limit_velocity_near_obstacles(vn: float, ve: float) -> tuple[float, float]:
        return limit_approach_velocity(s.path_check, here, (vn, ve), plan.mission.avoidance.clearance_m)

    guard = limit_velocity_near_obstacles if plan.avoids_obstacles and s.obstacle_map.point_count else None
    return follow_set_point(at, wanted, plan.trajectory_limits, here, dt, guard)


def _track_changed_goal(plan: MissionPlan, s: MissionState, m: Estimate, way: Trajectory, dt: float) -> MissionState:
    """Return the mission with its reference moved one time step towards a goal that was changed in flight.

    In the step of the change itself, the reference has moved already.
    """
    if s.set_point_reference is None or s.motion_clock_s == 0.0:
        return s
    wanted = SetPoint(position_m=s.goal, heading_rad=way.start_heading + way.turn_angle)
    return replace(s, set_point_reference=track_set_point(plan, s, s.set_point_reference, wanted, m, dt))


def _choose_leg_message(
    s: MissionState, mission: LogTemplate, users: LogTemplate, home: LogTemplate, *numbers: float
) -> str:
    if s.returning_home or s.user_in_control:
        return (home if s.returning_home else users)(*numbers)
    return mission(s.waypoint_index + 1, *numbers)


def _distance_to_goal(m: Estimate, goal: Triple) -> float:
    n, e, d = measured_position(m)
    return float(vector_length(n - goal[0], e - goal[1], d - goal[2]))


def _has_settled_at_goal(s: MissionState, way: Trajectory) -> bool:
    """Return whether the reference rests at the changed goal of a leg."""
    at = s.set_point_reference
    assert at is not None
    (n, e, d), (gn, ge, gd) = at.position, s.goal
    return bool(
        vector_length(n - gn, e - ge, d - gd) < _SETTLED_DISTANCE_M
        and vector_length(*at.velocity) < _SETTLED_SPEED_M_S
        and abs(wrap_turn(way.start_heading + way.turn_angle - at.heading)) < _SETTLED_HEADING_RAD
        and abs(at.heading_rate) < _SETTLED_HEADING_RAD
    )


def step_leg(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step a leg and check whether the goal is reached."""
    way = s.motion
    assert isinstance(way, Trajectory)
    s = _track_changed_goal(plan, s, m, way, dt)
    is_over = s.motion_clock_s >= way.duration_s if s.set_point_reference is None else _has_settled_at_goal(s, way)
    if is_over and _is_at_goal(plan, s, m):
        off = _distance_to_goal(m, s.goal)
        why = _choose_leg_message(
            s,
            LogTemplate.WAYPOINT_REACHED,
            LogTemplate.USER_WAYPOINT_REACHED,
            LogTemplate.HOME_REACHED,
            100.0 * off,
        )
        if s.returning_home:
            return start_landing(s, why)
        if s.user_in_control:
            at = s.goal if s.set_point_reference is None else s.set_point_reference.position
            return _hover_until(s, why, at, s.time_s)
        wait = plan.mission.waypoint[s.waypoint_index].wait_s
        s = _hover_until(s, why, s.goal, s.time_s + wait)
        return replace(s, waypoint_index=s.waypoint_index + 1, reached_waypoint_count=s.reached_waypoint_count + 1)
    spent = s.time_s - s.state_entered_s
    if spent > 2.0 * way.duration_s + 20.0:
        off = _distance_to_goal(m, s.goal)
        why = _choose_leg_message(
            s, LogTemplate.WAYPOINT_MISSED, LogTemplate.USER_WAYPOINT_MISSED, LogTemplate.HOME_MISSED, spent, off
        )
        return _fail_and_hover(s, why)
    return _start_detour_at_obstacle(plan, s)


def _start_detour_at_obstacle(plan: MissionPlan, s: MissionState) -> MissionState:
    """Start a detour if an obstacle is detected."""
    if not plan.avoids_obstacles or not s.obstacle_map.point_count:
        return s
    at = current_reference(s)
    clear = plan.mission.avoidance.clearance_m
    # Only a level path has a direction of flight; otherwise the obstacle must come near.
    underway = s.state is State.WAYPOINT and has_departed(s)
    here, sight = at.position, s.path_check
    if underway:  # the check covers this path from the step after the goal changed
        there = sight.goal_north == s.goal[0] and sight.goal_east == s.goal[1] and is_path_blocked(sight, clear)
    else:
        there = sight.find_nearest_point_distance(here)[0] < clear
    if not there:
        return s
    velocity, acceleration = at.velocity, at.acceleration
    detour = begin_detour(here, velocity, acceleration, s.goal, sight, s.detour)
    far = math.sqrt(sight.path_clearance_sq) if underway else sight.find_nearest_point_distance(here)[0]
    why = (LogTemplate.OBSTACLE_AHEAD if underway else LogTemplate.OBSTACLE_NEAR)(far)
    return enter_state(s, State.OBSTACLE, why, state_after_detour=s.state, detour=detour, hold_heading=at.heading)


def step_detour(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step a detour around an obstacle, then resume the previous state."""
    assert s.detour is not None
    q = plan.mission.avoidance
    detour = follow_contour(
        s.detour,
        s.path_check,
        plan.beam_ring,
        measured_position(m),
        float(m.attitude[2]),
        m.ranges.tolist(),
        s.goal,
        clearance=q.clearance_m,
        speed=q.speed_m_s,
        dt=dt,
    )
    s = replace(s, detour=detour, detour_duration_s=s.detour_duration_s + dt)
    if s.detour_duration_s > q.give_up_s:
        n, e = detour.obstacle_point
        return _fail_and_hover(s, LogTemplate.BLOCKED_BY_OBSTACLE(n, e, q.give_up_s))
    if not detour.is_finished:
        return s
    way = plan_straight(detour.position, s.goal, s.hold_heading, plan.trajectory_limits, final_heading=s.hold_heading)
    return enter_state(s, s.state_after_detour, LogTemplate.OBSTACLE_AVOIDED(), motion=way, resumed_after_detour=True)
