"""Behaviour of each mission state, the transitions into it (Fig. 6.15), and the resulting reference.

Every function takes a state and returns the next one; there is no other memory. The user's signals are handled in
:mod:`mufly.mission.state_machine`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mufly.estimate import Estimate, measured_tilt
from mufly.mission.avoidance import is_path_blocked, limit_approach_velocity
from mufly.mission.detour import DETOUR_ACCELERATION_M_S2, begin_detour, follow_contour
from mufly.mission.log_messages import LogMessage
from mufly.mission.mission_schema import MIN_WAYPOINT_HEIGHT_M, SPIN_UP_S, plan_leg_trajectory
from mufly.mission.mission_state import (
    Command,
    MissionPlan,
    MissionState,
    Reference,
    State,
    enter_hover,
    enter_state,
    fail_mission,
    log_event,
)
from mufly.mission.mission_timing import DESCENT_LAG_S, RAMP_DOWN_TIME_S, compute_landing_rate
from mufly.mission.offboard import DRIFT_DESCENT_M_S, SetPoint, follow_set_point, limit_manual_tilt
from mufly.mission.trajectory import (
    BrakingMotion,
    Trajectory,
    TrajectoryPoint,
    Triple,
    plan_stop,
    plan_straight,
    wrap_turn,
)
from mufly.portable_math import sine_cosine, vector_length

NOSE_SWING_PERIOD_S = 4.0
"""Period of the nose swing while scanning (s); half of it covers every direction."""

_ZERO_VECTOR = (0.0, 0.0, 0.0)


def current_reference(s: MissionState) -> TrajectoryPoint:
    """Return the present reference, without the swing of the nose."""
    if s.state is State.OBSTACLE and s.detour is not None:
        return TrajectoryPoint(s.detour.position, s.detour.velocity, s.detour.acceleration, s.hold_heading, 0.0)
    if s.state in (State.OFFBOARD, State.WAYPOINT) and s.set_point_reference is not None:
        return s.set_point_reference
    if s.motion is None or s.motors == "spin_up":
        return TrajectoryPoint(s.hold_position, _ZERO_VECTOR, _ZERO_VECTOR, s.hold_heading, 0.0)
    at = s.motion.evaluate(s.motion_clock_s)
    if s.state is State.LANDING:
        (n, e, _), (u, v, _), (a, b, _) = at.position, at.velocity, at.acceleration
        return TrajectoryPoint(
            (n, e, s.hold_position[2]),
            (u, v, s.descent_rate),
            (a, b, s.descent_acceleration),
            at.heading,
            at.heading_rate,
        )
    return at


def predict_reference(s: MissionState) -> TrajectoryPoint:
    """Return the reference at the end of this step, from which another motion must continue.

    A motion's clock is already advanced. References that a state integrates itself (a detour, a landing's height, the
    tracker of set-points) are not.
    """
    at = current_reference(s)
    if s.state not in (State.OBSTACLE, State.LANDING, State.OFFBOARD) and s.set_point_reference is None:
        return at
    (n, e, d), (u, v, w), dt = at.position, at.velocity, s.step_duration_s
    place = (n, e, d + dt * w) if s.state is State.LANDING else (n + dt * u, e + dt * v, d + dt * w)
    return at._replace(position=place, heading=at.heading + dt * at.heading_rate)


def has_departed(s: MissionState) -> bool:
    """Return whether a trajectory has finished height and heading and begun its path, or a moving target is tracked."""
    if s.set_point_reference is not None:
        return True
    return isinstance(s.motion, Trajectory) and s.motion_clock_s >= s.motion.departure_s


def is_scanning(plan: MissionPlan, s: MissionState) -> bool:
    """Return whether the nose swings: around an obstacle, and on a level path if the mission scans."""
    return s.state is State.OBSTACLE or (plan.scans_with_nose and s.state is State.WAYPOINT and has_departed(s))


def scan_yaw(plan: MissionPlan, s: MissionState) -> tuple[float, float]:
    """Return angle and rate of the nose swing (rad, rad/s), with an amplitude of half the gap between two beams.

    The amplitude grows and decays within a second.
    """
    if s.scan_duration_s <= 0.0:
        return 0.0, 0.0
    x, most, omega = min(s.scan_duration_s, 1.0), 0.5 * plan.ring.spacing, math.tau / NOSE_SWING_PERIOD_S
    size = most * x * x * (3.0 - 2.0 * x)
    growth = most * 6.0 * x * (1.0 - x) * (1.0 if is_scanning(plan, s) else -1.0)
    sine, cosine = sine_cosine(omega * (s.time_s - NOSE_SWING_PERIOD_S * int(s.time_s / NOSE_SWING_PERIOD_S)))
    return size * sine, growth * sine + size * omega * cosine


def make_reference(plan: MissionPlan, s: MissionState, m: Estimate, c: Command) -> Reference:
    """Return the reference for the controllers."""
    if s.state is State.RC:
        position = np.array((m.position[0], m.position[1], s.hold_position[2]))
        velocity = np.array((m.velocity[0], m.velocity[1], s.descent_rate))
        turning = c.yaw_rate if s.motors == "fly" else 0.0
        height = s.home_position[2] - float(m.position[2])
        vn, ve, _ = m.velocity.tolist()
        roll, pitch = limit_manual_tilt(height, (vn, ve), float(m.attitude[2]), (c.roll, c.pitch))
        return Reference(
            position,
            velocity,
            np.zeros(3),
            s.hold_heading,
            turning,
            s.motors,
            rc_active=True,
            roll=roll,
            pitch=pitch,
        )
    if s.state is State.INIT:
        return Reference(m.position.copy(), np.zeros(3), np.zeros(3), float(m.attitude[2]), 0.0, s.motors)
    at = current_reference(s)
    angle, rate = scan_yaw(plan, s)
    return Reference(
        np.array(at.position),
        np.array(at.velocity),
        np.array(at.acceleration),
        at.heading + angle,
        at.heading_rate + rate,
        s.motors,
    )


# Descent to the floor: landing, and descent without an estimate


_STILL_DURATION_S = 0.3
_NEAR_FLOOR_HEIGHT_M = 0.1
_DRIFT_CHECK_HEIGHT_M, _DRIFT_SPEED_M_S = 0.6, 0.3  # below this, above this drift, it descends at DRIFT_DESCENT_M_S
_MAX_DESCENT_LAG_M = 0.25  # largest height error during descent
_STANDING_HEIGHT_M, _PRESSED_DEPTH_M, _PRESSED_DURATION_S = (
    0.02,
    0.03,
    0.05,
)  # standing on the floor by the estimate: height, reference below it, duration
_CERTAIN_HEIGHT_M = 0.05  # largest height deviation for this test

HARD_TOUCHDOWN_M_S = 0.3
"""Speed above which a touchdown counts as hard (m/s): a fifth above the greatest touchdown speed of missions."""


def start_landing(s: MissionState, why: str, *, level: str = "info") -> MissionState:
    """Start a landing below the point where the reference comes to rest."""
    if s.motors == "spin_up":
        s = fail_mission(s, why) if s.mission_begun else s
        return enter_state(s, State.INIT, why, level=level, motors="ramp_down")
    now = current_reference(s)
    brake = plan_stop(predict_reference(s).position, (*now.velocity[:2], 0.0), now.heading, DETOUR_ACCELERATION_M_S2)
    foot = brake.evaluate(math.inf).position
    return enter_state(
        s,
        State.LANDING,
        why,
        level=level,
        motion=brake,
        hold_position=(foot[0], foot[1], now.position[2]),
        goal=(foot[0], foot[1], s.home_position[2]),
        hold_heading=now.heading,
        descent_rate=now.velocity[2],
        descent_acceleration=now.acceleration[2],
        motors="fly",
        still_duration_s=0.0,
        touchdown_speed=0.0,
    )


def step_landing(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Descend, slower near the floor, then press down until the legs carry the weight, and stop the rotors.

    With a certain height estimate they stop as soon as the vehicle is 3 cm above its reference, within 2 cm of the
    floor. An undetected drift would otherwise make the controller chase a false position and lift the vehicle over the
    rubbing leg. With friction mu, a centre of mass h above the floor and legs at distance l, a slide does not tip the
    vehicle while mu h < l, without rotor thrust: so the rotors must not lift while it slides.
    """
    if s.motors == "ramp_down":
        if s.motion_clock_s < RAMP_DOWN_TIME_S:
            return s
        return enter_state(_judge_outcome(s), State.INIT, LogMessage.LANDED(), motors="off", finished=True)
    q = plan.mission.limits
    a = q.climb_acceleration_m_s2
    above = s.home_position[2] - s.hold_position[2]
    wanted = compute_landing_rate(above, q.descent_m_s, q.touchdown_m_s, a)
    if above < -0.3:
        wanted = 0.0
    elif 0.0 < above < _DRIFT_CHECK_HEIGHT_M and m.velocity[0] ** 2 + m.velocity[1] ** 2 > _DRIFT_SPEED_M_S**2:
        wanted = min(wanted, DRIFT_DESCENT_M_S)
    ask = min(max((wanted - s.descent_rate) / DESCENT_LAG_S, -a), a)
    rate = s.descent_acceleration + (ask - s.descent_acceleration) * min(1.0, dt / 0.1)
    speed = s.descent_rate + rate * dt
    depth = s.hold_position[2] + speed * dt
    lying = m.position[2] > s.home_position[2] - 0.03 and depth > s.home_position[2] + 0.1
    # A vehicle that does not follow lies on an object, or is lower than estimated.
    lying = lying or depth > m.position[2] + _MAX_DESCENT_LAG_M
    # With unknown drift the vehicle must not be steered with a leg on the floor.
    stands = m.auxiliary_states is not None and m.position[2] > s.home_position[2] - _STANDING_HEIGHT_M
    stands = (
        stands
        and depth > m.position[2] + _PRESSED_DEPTH_M
        and bool(m.covariance[2, 2] < _CERTAIN_HEIGHT_M * _CERTAIN_HEIGHT_M)
    )
    still = s.still_duration_s + dt if stands or (lying and abs(m.velocity[2]) < 0.05) else 0.0
    near = m.position[2] > s.home_position[2] - _NEAR_FLOOR_HEIGHT_M
    if m.auxiliary_states is not None:  # a filter that has not detected the floor keeps falling for a moment
        near = near and m.position[2] < s.home_position[2] - LIFT_OFF_HEIGHT_M
    impact = max(s.touchdown_speed, float(m.velocity[2])) if near else s.touchdown_speed
    s = replace(
        s,
        hold_position=(s.hold_position[0], s.hold_position[1], depth),
        descent_rate=speed,
        descent_acceleration=rate,
        still_duration_s=still,
        touchdown_speed=impact,
    )
    lasts = _PRESSED_DURATION_S if stands else _STILL_DURATION_S
    return replace(_handle_touchdown(s), motors="ramp_down", motion_clock_s=0.0) if still > lasts else s


def _handle_touchdown(s: MissionState) -> MissionState:
    if s.touchdown_speed <= HARD_TOUCHDOWN_M_S:
        return log_event(s, LogMessage.TOUCHDOWN())
    return log_event(s, LogMessage.HARD_TOUCHDOWN(s.touchdown_speed, HARD_TOUCHDOWN_M_S), level="warning")


def _judge_outcome(s: MissionState) -> MissionState:
    """Set the outcome of the flight after landing."""
    if s.outcome != "":
        return s
    if s.abort_reason:
        return fail_mission(s, s.abort_reason)
    return replace(
        s,
        outcome="succeeded",
        reason=(LogMessage.MISSION_COMPLETE if s.mission_begun else LogMessage.LANDED)(),
    )


def enter_blind_descent(s: MissionState, time_s: float, why: str) -> MissionState:
    """Enter the descent without measurements, which the flight software controls by itself."""
    s = fail_mission(replace(s, time_s=time_s), why)
    return enter_state(s, State.LANDING, why, level="error", motors="blind", detour=None)


def fail_and_land(s: MissionState, why: str) -> MissionState:
    """Fail the mission and land; under RC only report the reason to the pilot."""
    if s.state in (State.INIT, State.RC):
        return log_event(s, why, level="error")
    s = fail_mission(s, why)
    return log_event(s, why, level="error") if s.state is State.LANDING else start_landing(s, why, level="error")


def finish_blind_descent(s: MissionState, time_s: float) -> MissionState:
    """Finish the descent without measurements after its time."""
    s = replace(s, time_s=time_s)
    return enter_state(s, State.INIT, LogMessage.MOTORS_OFF_AFTER_DESCENT(), motors="off", finished=True)


# Take-off, hover, legs and detours


_SETTLE_BEFORE_LANDING_S = 2.0


def measured_position(m: Estimate) -> Triple:
    """Return the measured position as three numbers (N, E, D; m)."""
    n, e, d = m.position.tolist()
    return n, e, d


# init and take-off


LIFT_OFF_HEIGHT_M, TIPPING_RATE_RAD_S = 0.02, 0.15
"""Height above the standing position that counts as lift-off (m); roll or pitch rate that counts as tipping (rad/s).

Wind drag on the rotors tips a vehicle whose legs carry little weight."""


MAX_START_TILT_DEG = 6.0
"""Tilt on the floor up to which the motors are started (degrees): the mount of the inertial unit, its bias and legs."""
_MAX_START_TILT = math.radians(MAX_START_TILT_DEG)


def start_fault(m: Estimate) -> str:
    """Return the reason why the motors may not be started with this estimate; "" if they may."""
    if not m.valid:
        return LogMessage.ESTIMATE_NOT_VALID()
    tilt = measured_tilt(m)
    return "" if tilt <= _MAX_START_TILT else LogMessage.STANDS_TILTED(math.degrees(tilt), MAX_START_TILT_DEG)


def refuse_start(s: MissionState, why: str) -> MissionState:
    """Log the refusal of a start, once for each reason."""
    head = LogMessage.STANDS_TILTED.value.partition("{")[0]
    last = s.events[-1].text
    return s if last == why or (last.startswith(head) and why.startswith(head)) else log_event(s, why, level="warning")


def has_lifted_off(s: MissionState, m: Estimate) -> bool:
    """Return whether the vehicle is off the floor."""
    return bool(m.position[2] < s.home_position[2] - LIFT_OFF_HEIGHT_M)


def is_tipping(m: Estimate) -> bool:
    """Return whether the vehicle, nearly lifted, rotates on its legs and needs attitude control."""
    return bool(max(abs(m.rates[0]), abs(m.rates[1])) > TIPPING_RATE_RAD_S)


def has_spun_up(s: MissionState, m: Estimate) -> bool:
    """Return whether the rotors are up to speed, or already lift a vehicle lighter than its controllers' model."""
    return s.motion_clock_s >= SPIN_UP_S or has_lifted_off(s, m)


def step_on_floor(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step on the floor; the motors run down after a flight."""
    if s.motors == "ramp_down" and s.motion_clock_s > RAMP_DOWN_TIME_S:
        return replace(s, motors="off", finished=s.outcome != "")
    return s


def reset_mission(s: MissionState, m: Estimate, **changes: Any) -> MissionState:
    """Return the state of a new flight from the present position."""
    x = measured_position(m)
    return MissionState(
        time_s=s.time_s,
        has_taken_off=True,
        hold_position=x,
        home_position=x,
        hold_heading=float(m.attitude[2]),
        battery_V=s.battery_V,
        events=s.events,
        logged_count=s.logged_count,
        **changes,
    )


def start_flight(
    plan: MissionPlan,
    s: MissionState,
    m: Estimate,
    *,
    height: float | None = None,
    first: int | None = None,
) -> MissionState:
    """Start a new flight: the mission or, with a ``height`` (m), a take-off only."""
    fresh = reset_mission(s, m, mission_begun=height is None, manual=height is not None, waypoint_index=first or 0)
    x = fresh.home_position
    up = plan.mission.take_off.height_m if height is None else height
    goal = (x[0], x[1], -up)
    motion = plan_straight(x, goal, fresh.hold_heading, plan.trajectory_limits)
    why = LogMessage.START_SIGNAL() if height is None else LogMessage.TAKE_OFF_SIGNAL(up)
    return enter_state(fresh, State.TAKE_OFF, why, motors="spin_up", goal=goal, motion=motion)


def _is_at_goal(plan: MissionPlan, s: MissionState, m: Estimate) -> bool:
    """Whether the vehicle is as near its goal, and as slow, as a reached waypoint asks."""
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
            return _hover_until(s, LogMessage.ALTITUDE_REACHED(-m.position[2]), s.goal, ready)
        gained = s.home_position[2] - m.position[2]
        if late > 3.0 and gained < 0.1:
            s = fail_mission(s, LogMessage.TAKE_OFF_FAILED(gained, s.motion_clock_s))
            return enter_state(s, State.INIT, s.reason, level="error", motors="ramp_down")
        if overdue:
            why = LogMessage.TAKE_OFF_SHORT(-m.position[2], -s.goal[2])
            return start_landing(fail_mission(s, why), why, level="warning")
    # On its legs the vehicle cannot avoid obstacles.
    return _detect_obstacle(plan, s) if m.position[2] < s.home_position[2] - 0.2 else s


# hover and waypoint


def step_hover(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step a hover: wait, then start the next leg or the landing."""
    if s.outcome == "failed":
        return start_landing(s, s.reason, level="warning") if s.time_s >= s.hover_until_s else s
    s = _detect_obstacle(plan, s)
    if s.state is not State.HOVER or s.manual or s.time_s < s.hover_until_s:
        return s
    if s.waypoint_index >= len(plan.mission.waypoint):
        return _complete_mission(plan, s)

    def plan_leg(at: Triple, heading: float) -> Trajectory:
        offset = nose_offset(plan)
        return plan_leg_trajectory(
            plan.mission, s.waypoint_index, np.array(at), heading, nose_offset=offset, made=False
        )

    return start_leg(plan, s, LogMessage.TO_WAYPOINT(s.waypoint_index + 1), plan_leg)


def nose_offset(plan: MissionPlan) -> float:
    """Return the angle of the nose from the direction of flight (rad), which points a beam along it when scanning."""
    return math.remainder(-plan.ring.first_angle, plan.ring.spacing) if plan.scans_with_nose else 0.0


def _complete_mission(plan: MissionPlan, s: MissionState) -> MissionState:
    """Finish the mission after the last wait, as its file states."""
    if plan.mission.at_end == "hover":
        s = log_event(s, LogMessage.MISSION_COMPLETE_HOLDING())
        return replace(s, manual=True, outcome="succeeded", reason=LogMessage.MISSION_COMPLETE())
    if plan.mission.at_end == "return":
        return start_leg_home(plan, s, LogMessage.MISSION_COMPLETE_RETURNING())
    return start_landing(s, LogMessage.MISSION_COMPLETE())


def plan_braking(plan: MissionPlan, s: MissionState) -> BrakingMotion:
    """Plan braking from the present motion of the reference."""
    now = predict_reference(s)
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
    """Start the leg ``way(position, heading)``, after braking if the reference moves."""
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
        "manual": False,
        "returning_home": False,
    }
    fresh |= {"requested_heading": None, "motion": motion, "goal": motion.goal}
    return enter_state(s, State.WAYPOINT, why, **(fresh | flags))


def start_leg_home(plan: MissionPlan, s: MissionState, why: str) -> MissionState:
    """Fly to above the take-off position, not descending, and land there."""

    def plan_way_home(at: Triple, heading: float) -> Trajectory:
        n, e, _ = s.home_position
        goal = (n, e, min(at[2], -MIN_WAYPOINT_HEIGHT_M))
        return plan_straight(at, goal, heading, plan.trajectory_limits, nose_offset=nose_offset(plan))

    return start_leg(plan, s, why, plan_way_home, manual=True, returning_home=True)


def step_leg(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step a leg and check whether the goal is reached."""
    way = s.motion
    assert isinstance(way, Trajectory)
    s = _track_goal(plan, s, m, way, dt)
    is_over = s.motion_clock_s >= way.duration_s if s.set_point_reference is None else _has_settled(s, way)
    if is_over and _is_at_goal(plan, s, m):
        off = _distance_to_goal(m, s.goal)
        why = _leg_message(
            s,
            LogMessage.WAYPOINT_REACHED,
            LogMessage.USER_WAYPOINT_REACHED,
            LogMessage.HOME_REACHED,
            100.0 * off,
        )
        if s.returning_home:
            return start_landing(s, why)
        if s.manual:
            at = s.goal if s.set_point_reference is None else s.set_point_reference.position
            return _hover_until(s, why, at, s.time_s)
        wait = plan.mission.waypoint[s.waypoint_index].wait_s
        s = _hover_until(s, why, s.goal, s.time_s + wait)
        return replace(s, waypoint_index=s.waypoint_index + 1, reached_count=s.reached_count + 1)
    spent = s.time_s - s.state_entered_s
    if spent > 2.0 * way.duration_s + 20.0:
        off = _distance_to_goal(m, s.goal)
        why = _leg_message(
            s, LogMessage.WAYPOINT_MISSED, LogMessage.USER_WAYPOINT_MISSED, LogMessage.HOME_MISSED, spent, off
        )
        return _fail_and_hover(s, why)
    return _detect_obstacle(plan, s)


_SETTLED_M, _SETTLED_M_S, _SETTLED_RAD = 0.002, 0.01, 0.01


def change_leg_goal(
    plan: MissionPlan, s: MissionState, why: str, goal: Triple, heading: float | None, *, quiet: bool
) -> MissionState:
    """Redirect the user's present leg to another goal without a stop, from the present motion of the reference.

    The reference follows the goal as that of a program (:mod:`mufly.mission.offboard`), height and way together.
    Without a ``heading`` the nose turns along the way to the goal, unless that is short.
    """
    known = s.set_point_reference
    now = predict_reference(s) if known is None else known
    (n, e, _), aim = now.position, heading
    if aim is None and vector_length(goal[0] - n, goal[1] - e) < SHORT_WAY_M:
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


SHORT_WAY_M = 0.3
"""Level distance to a changed goal below which the nose does not turn to it (m)."""


def _track_goal(plan: MissionPlan, s: MissionState, m: Estimate, way: Trajectory, dt: float) -> MissionState:
    """Move the reference towards a changed goal. The step in which the goal changes has moved it already."""
    if s.set_point_reference is None or s.motion_clock_s == 0.0:
        return s
    wanted = SetPoint(position_m=s.goal, heading_rad=way.start_heading + way.turn_angle)
    return replace(s, set_point_reference=track_set_point(plan, s, s.set_point_reference, wanted, m, dt))


def track_set_point(
    plan: MissionPlan, s: MissionState, at: TrajectoryPoint, wanted: SetPoint, m: Estimate, dt: float
) -> TrajectoryPoint:
    """Follow a set-point within the mission's limits, away from obstacles that the beams have hit."""
    here = measured_position(m)

    def limit_velocity(vn: float, ve: float) -> tuple[float, float]:
        return limit_approach_velocity(s.path_check, here, (vn, ve), plan.mission.avoidance.clearance_m)

    guard = limit_velocity if plan.avoids_obstacles and s.obstacle_map.point_count else None
    return follow_set_point(at, wanted, plan.trajectory_limits, here, dt, guard)


def _has_settled(s: MissionState, way: Trajectory) -> bool:
    """Return whether the reference rests at the changed goal of a leg."""
    at = s.set_point_reference
    assert at is not None
    (n, e, d), (gn, ge, gd) = at.position, s.goal
    return bool(
        vector_length(n - gn, e - ge, d - gd) < _SETTLED_M
        and vector_length(*at.velocity) < _SETTLED_M_S
        and abs(wrap_turn(way.start_heading + way.turn_angle - at.heading)) < _SETTLED_RAD
        and abs(at.heading_rate) < _SETTLED_RAD
    )


def _leg_message(s: MissionState, mission: LogMessage, users: LogMessage, home: LogMessage, *numbers: float) -> str:
    if s.returning_home or s.manual:
        return (home if s.returning_home else users)(*numbers)
    return mission(s.waypoint_index + 1, *numbers)


def _distance_to_goal(m: Estimate, goal: Triple) -> float:
    n, e, d = measured_position(m)
    return float(vector_length(n - goal[0], e - goal[1], d - goal[2]))


def _hover_until(s: MissionState, why: str, at: Triple, ready_s: float) -> MissionState:
    return enter_hover(s, why, at, current_reference(s).heading, hover_until_s=ready_s)


def _fail_and_hover(s: MissionState, why: str) -> MissionState:
    """Brake to a hover, from which the vehicle lands."""
    now = current_reference(s)
    brake = plan_stop(now.position, now.velocity, now.heading, DETOUR_ACCELERATION_M_S2)
    at = brake.evaluate(math.inf).position
    ready = s.time_s + brake.duration_s + _SETTLE_BEFORE_LANDING_S
    s = fail_mission(s, why)
    return enter_hover(s, why, at, now.heading, level="warning", motion=brake, hover_until_s=ready)


# obstacle


def _detect_obstacle(plan: MissionPlan, s: MissionState) -> MissionState:
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
        there = sight.nearest_point(here)[0] < clear
    if not there:
        return s
    velocity, acceleration = at.velocity, at.acceleration
    detour = begin_detour(here, velocity, acceleration, s.goal, sight, s.detour)
    far = math.sqrt(sight.path_distance_sq) if underway else sight.nearest_point(here)[0]
    why = (LogMessage.OBSTACLE_AHEAD if underway else LogMessage.OBSTACLE_NEAR)(far)
    return enter_state(s, State.OBSTACLE, why, resume_state=s.state, detour=detour, hold_heading=at.heading)


def step_detour(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Step a detour around an obstacle, then resume the previous state."""
    assert s.detour is not None
    q = plan.mission.avoidance
    detour = follow_contour(
        s.detour,
        s.path_check,
        plan.ring,
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
        return _fail_and_hover(s, LogMessage.BLOCKED_BY_OBSTACLE(n, e, q.give_up_s))
    if not detour.is_finished:
        return s
    way = plan_straight(detour.position, s.goal, s.hold_heading, plan.trajectory_limits, final_heading=s.hold_heading)
    return enter_state(s, s.resume_state, LogMessage.OBSTACLE_AVOIDED(), motion=way, resumed_after_detour=True)
