"""The mission state machine (Fig. 6.15) as a pure function of time steps.

Transitions of the thesis::

    init --start--> take-off --altitude reached--> hover --waypoint--> waypoint --goal reached--> hover ...
    take-off, hover, waypoint --obstacle detected--> obstacle --obstacle avoided--> back to where it came from
    take-off --failed--> init (never lifted off) or landing
    any flying state --land signal, battery low--> landing --touchdown--> init
    any state --RC--> RC --RC off--> hover, or init when it stands on the floor

Further transitions, not in the thesis::

    init --take-off signal--> take-off --> hover, where the mission waits
    take-off, waypoint, obstacle, landing --pause--> hover --start--> waypoint
    take-off, hover, waypoint, obstacle --return--> waypoint (home) --goal reached--> landing
    init, take-off, hover, waypoint, obstacle --set-points--> offboard --no more--> hover, or init on the floor
    any state --stop--> init, motors off

After the start signal the machine generates the waypoint signals of the mission file, and the land signal after the
last one. Signals of the user override it, if the state permits them (:mod:`mufly.mission.mission_state`). Each change
of state is logged with its reason in `MissionState.events`.

One step takes measurements and commands and returns the next state and the `Reference` for the controllers. It runs at
about 50 Hz. Trajectories are planned at transitions; other steps only evaluate one. `mufly.mission.phases` and
`mufly.mission.ground_phases` hold the behaviour of each state. Every function below takes a state and returns the next
one: first the effects of the user's signals, then control by a pilot (the thesis's state RC) or a program (offboard). A
moving reference comes to rest before any other motion, so that no transition makes it jump.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mufly.estimate import Estimate
from mufly.mission import ground_phases, phases
from mufly.mission.avoidance import (
    LOOK_AHEAD_M,
    begin_path_check,
    check_map_part,
    insert_beam_hits,
)
from mufly.mission.detour import DETOUR_ACCELERATION_M_S2
from mufly.mission.ground_phases import (
    has_spun_up,
    measured_position,
    refuse_start,
    reset_mission,
    start_fault,
    start_landing,
)
from mufly.mission.log_messages import LogMessage
from mufly.mission.mission_reference import current_reference, is_scanning, make_reference, predict_reference, scan_yaw
from mufly.mission.mission_schema import MIN_WAYPOINT_HEIGHT_M
from mufly.mission.mission_state import (
    Command,
    MissionPlan,
    MissionState,
    Reference,
    State,
    VehicleRequest,
    check_request,
    enter_hover,
    enter_state,
    fail_mission,
    log_event,
)
from mufly.mission.mission_timing import LOOK_AROUND_TIME_S
from mufly.mission.offboard import MAX_HEIGHT_M, SetPoint, limit_manual_climb, needs_lift_off, set_point_fault
from mufly.mission.phases import change_leg_goal, plan_braking, start_leg, start_leg_home, track_set_point
from mufly.mission.trajectory import Trajectory, Triple, plan_stop, plan_straight, smooth_stop_distance, wrap_turn
from mufly.portable_math import vector_length

_FLYING_STATES = frozenset({State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.OBSTACLE, State.OFFBOARD})
_TIPPED_ANGLE = math.radians(60.0)
_LOW_BATTERY_S = 1.0
_VOLTAGE_LAG_S = 0.5
_DEPARTURE_HEIGHT_TOLERANCE_M, _DEPARTURE_HEADING_TOLERANCE = 0.1, math.radians(8.0)

_PHASE_STEPS = {
    State.INIT: ground_phases.step_on_floor,
    State.TAKE_OFF: phases.step_take_off,
    State.HOVER: phases.step_hover,
    State.WAYPOINT: phases.step_leg,
    State.OBSTACLE: phases.step_detour,
    State.LANDING: ground_phases.step_landing,
}


def step_mission(
    plan: MissionPlan, state: MissionState, estimate: Estimate, command: Command
) -> tuple[MissionState, Reference]:
    """Advance the mission by one step.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare_plan`: the mission and the vehicle's data.
    state : MissionState
        From `initial_mission_state` or the previous step.
    estimate : Estimate
        Present estimate; the time step is its time minus the state's (at most 0.5 s).
    command : Command
        The user's signals.

    Returns
    -------
    state : MissionState
        The new state.
    reference : Reference
        Reference for the controllers.

    Thesis: Fig. 6.15; Sec. 6.2.1.
    """
    dt = min(max(estimate.time_s - state.time_s, 0.0), 0.5)
    s = _update_clocks(plan, _finish_pending_curve(state), estimate, dt)
    s = _apply_signals(plan, s, estimate, command, dt)
    if s.state is State.OFFBOARD:
        s = step_offboard(plan, s, estimate, command, dt)
    phase = _PHASE_STEPS.get(s.state)
    if phase is not None:
        s = phase(plan, s, estimate, dt)
    wanted = make_reference(plan, s, estimate, command)
    if plan.avoids_obstacles and s.state in _FLYING_STATES:
        here = wanted.position.tolist()
        goal = s.goal if s.state in (State.WAYPOINT, State.OBSTACLE) else here
        ahead = math.inf if s.state is State.OBSTACLE else LOOK_AHEAD_M
        s = replace(s, path_check=begin_path_check(here, goal, ahead))
    return s, wanted


def update_obstacle_map(
    plan: MissionPlan, state: MissionState, estimate: Estimate, part: int = 1, parts: int = 1
) -> MissionState:
    """Process an eighth of the beams and a part of the points, between two mission steps.

    If the vehicle has just begun a leg along a curve, the curve is computed instead; the vehicle stands or brakes.

    Parameters
    ----------
    plan, state, estimate
        See `step_mission`.
    part, parts : int
        Number of this part (from 1) and of all parts.
    """
    s, m = state, estimate
    if not plan.avoids_obstacles or s.state not in _FLYING_STATES or _has_pending_curve(s):
        return s
    if not s.obstacle_map.point_count and not float(m.ranges.min()) < plan.ring.max_range:
        return s
    beams = len(plan.ring.cos)
    count = (beams + 7) // 8
    memory = insert_beam_hits(s.obstacle_map, plan.ring, m.time_s, m.position, m.attitude, m.ranges, s.next_beam, count)
    after = s.next_beam + count
    clearance = plan.mission.avoidance.clearance_m
    memory, sight = check_map_part(memory, s.path_check, m.time_s, clearance, part, parts)
    return replace(s, obstacle_map=memory, path_check=sight, next_beam=after if after < beams else after - beams)


def _has_pending_curve(s: MissionState) -> bool:
    return isinstance(s.motion, Trajectory) and s.motion.pending_curve is not None


def _finish_pending_curve(s: MissionState) -> MissionState:
    """Return the state with its pending curve computed."""
    return (
        replace(s, motion=s.motion.finish_curve()) if _has_pending_curve(s) and isinstance(s.motion, Trajectory) else s
    )


def _update_clocks(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Advance the clocks and check the battery."""
    clock = s.motion_clock_s + dt
    if s.state is State.WAYPOINT and isinstance(s.motion, Trajectory) and s.set_point_reference is None:
        gate = s.motion.departure_s
        if s.motion_clock_s <= gate < clock and not _may_depart(plan, s, m, s.motion):
            clock = gate
    volts = s.battery_V + (m.battery_voltage - s.battery_V) * min(1.0, dt / _VOLTAGE_LAG_S)
    swinging = s.scan_duration_s
    swinging = min(LOOK_AROUND_TIME_S, swinging + dt) if is_scanning(plan, s) else max(0.0, min(1.0, swinging) - dt)
    return replace(
        s,
        time_s=m.time_s,
        motion_clock_s=clock,
        step_duration_s=dt,
        battery_V=volts,
        low_battery_duration_s=s.low_battery_duration_s + dt if volts < plan.low_battery_V else 0.0,
        scan_duration_s=swinging,
    )


def _may_depart(plan: MissionPlan, s: MissionState, m: Estimate, way: Trajectory) -> bool:
    """Return whether height and heading are reached in fact, and the beams have scanned."""
    at = way.evaluate(way.departure_s)
    angle, _ = scan_yaw(plan, s)
    return (
        abs(m.position[2] - at.position[2]) < _DEPARTURE_HEIGHT_TOLERANCE_M
        and abs(m.attitude[2] - at.heading - angle) < _DEPARTURE_HEADING_TOLERANCE + abs(angle)
        and (
            not plan.scans_with_nose
            or s.resumed_after_detour
            or way.path_profile.distance == 0.0
            or s.scan_duration_s >= LOOK_AROUND_TIME_S
        )
    )


def _apply_signals(plan: MissionPlan, s: MissionState, m: Estimate, c: Command, dt: float) -> MissionState:
    """Apply the transitions that are possible in any state."""
    if c.stop_reason:
        return stop_motors(s, c.stop_reason)
    if s.state is not State.INIT and _has_tipped_over(s, m):
        return stop_motors(fail_mission(s, LogMessage.TIPPED_OVER()), LogMessage.TIPPED_MOTORS_OFF())
    # Rotors that run down after touchdown stop first: centred sticks must not restart them.
    if c.rc_active and s.motors != "ramp_down":
        s = s if s.state is State.RC else enter_manual(s, m)
        if s.motors == "fly" and s.low_battery_duration_s - dt <= _LOW_BATTERY_S < s.low_battery_duration_s:
            # The pilot decides.
            s = log_event(s, LogMessage.BATTERY_LOW_PILOT(s.battery_V, plan.low_battery_V), level="warning")
        return step_manual(plan, s, m, c, dt)
    if s.state is State.RC:
        return exit_manual(s, m)
    if s.state in _FLYING_STATES and s.low_battery_duration_s > _LOW_BATTERY_S:
        return _land_on_low_battery(plan, s)
    return s if s.state is State.INIT and s.motors != "off" else _handle_request(plan, s, m, c)


def _handle_request(plan: MissionPlan, s: MissionState, m: Estimate, c: Command) -> MissionState:
    """Execute the user's requests that the state permits."""

    def is_granted(ask: VehicleRequest) -> bool:
        return bool(check_request(ask, s, height_m=s.home_position[2] - float(m.position[2])))

    if c.land and s.state is not State.LANDING and is_granted(VehicleRequest.LAND):
        return start_land_now(plan, s)
    if s.state is State.OFFBOARD and c.program_set_point is None:
        s = exit_offboard(plan, s, m)
        if s.state is State.INIT:
            return s
    fresh = s.manual or c.first_waypoint is not None
    if s.state is State.INIT and (c.start or c.take_off_height is not None) and is_granted(VehicleRequest.START):
        fault = start_fault(m)
        if fault:
            return refuse_start(s, fault)
    if c.start and s.state is State.INIT and is_granted(VehicleRequest.START):
        return phases.start_flight(plan, s, m, first=c.first_waypoint)
    if c.start and s.state is State.TAKE_OFF and fresh and is_granted(VehicleRequest.START):
        return resume_after_take_off(s, c.first_waypoint)
    if c.take_off_height is not None and is_granted(VehicleRequest.TAKE_OFF):
        return phases.start_flight(plan, s, m, height=c.take_off_height)
    if (c.pause or s.hover_after_take_off) and is_granted(VehicleRequest.PAUSE):
        if s.state is State.TAKE_OFF and not is_granted(VehicleRequest.GO_TO):
            return (
                s
                if s.hover_after_take_off
                else replace(
                    log_event(s, LogMessage.WILL_HOVER_AFTER_TAKE_OFF()),
                    hover_after_take_off=True,
                    manual=True,
                )
            )
        return pause_mission(
            plan, s, LogMessage.LANDING_ABORTED() if s.state is State.LANDING else LogMessage.MISSION_PAUSED()
        )
    if c.return_requested and is_granted(VehicleRequest.RETURN):
        return start_return_home(plan, s)
    if c.program_set_point is not None and is_granted(VehicleRequest.OFFBOARD):
        return s if s.state is State.OFFBOARD else enter_offboard(s, m, c.program_set_point)
    if (c.waypoint is not None or c.heading is not None) and is_granted(VehicleRequest.GO_TO):
        return fly_to_user_waypoint(plan, s, c.waypoint, c.heading)
    if c.start and fresh and is_granted(VehicleRequest.START):
        return resume_mission(plan, s, c.first_waypoint)
    return s


def _has_tipped_over(s: MissionState, m: Estimate) -> bool:
    near = m.position[2] > s.home_position[2] - 0.3
    return bool(near and s.motors != "off" and max(abs(m.attitude[0]), abs(m.attitude[1])) > _TIPPED_ANGLE)


def _land_on_low_battery(plan: MissionPlan, s: MissionState) -> MissionState:
    why = LogMessage.BATTERY_LOW(s.battery_V, plan.low_battery_V)
    # A completed mission that holds does not fail by using up its battery.
    return start_landing(s if s.outcome == "succeeded" else fail_mission(s, why), why, level="warning")


# User signals: stop, waypoints, pause, home


def stop_motors(s: MissionState, why: str) -> MissionState:
    """Stop the motors in any state."""
    if s.state is State.INIT and s.motors == "off":
        return s
    if s.has_taken_off or s.mission_begun:
        s = fail_mission(s, why)
    return enter_state(s, State.INIT, why, level="error", motors="off", detour=None, finished=s.outcome != "")


def user_waypoint_fault(where: Triple | None, heading: float | None) -> str:
    """Return the reason to refuse a user's waypoint; "" if it is valid."""
    if heading is not None and not math.isfinite(heading):
        return LogMessage.HEADING_REFUSED(heading)
    if where is None:
        return ""
    if not all(math.isfinite(v) for v in where) or where[2] > -MIN_WAYPOINT_HEIGHT_M:
        return LogMessage.USER_WAYPOINT_TOO_LOW(*where, -MIN_WAYPOINT_HEIGHT_M)
    if where[2] < -MAX_HEIGHT_M or vector_length(where[0], where[1]) > 1e4:
        return LogMessage.USER_WAYPOINT_TOO_FAR(*where, -MAX_HEIGHT_M)
    return ""


def fly_to_user_waypoint(
    plan: MissionPlan, s: MissionState, where: Triple | None, heading: float | None
) -> MissionState:
    """Stop, fly to ``where`` and hold; the mission waits. Without ``where`` only turn on the spot."""
    refused = user_waypoint_fault(where, heading)
    if refused:
        return s if s.events[-1].text == refused else log_event(s, refused, level="warning")
    goal = None if where is None else (float(where[0]), float(where[1]), float(where[2]))
    if _is_already_requested(s, goal, heading):
        return s
    if goal is None:
        text = LogMessage.TURNING_TO_HEADING(_compass_deg(0.0 if heading is None else heading))
    elif heading is None:
        text = LogMessage.TO_USER_WAYPOINT(*goal)
    else:
        text = LogMessage.TO_USER_WAYPOINT_WITH_HEADING(*goal, math.degrees(heading))

    place = _stop_place(s) if goal is None else goal
    if place is not None and s.manual and not s.returning_home and s.state in (State.WAYPOINT, State.OBSTACLE):
        quiet = s.time_s - s.state_entered_s < _TARGET_STREAM_S
        return change_leg_goal(plan, s, text, place, heading, quiet=quiet)

    def plan_way(at: Triple, psi: float) -> Trajectory:
        return plan_straight(at, at if goal is None else goal, psi, plan.trajectory_limits, final_heading=heading)

    return start_leg(plan, s, text, plan_way, manual=True, requested_heading=heading)


_SAME_PLACE_M, _SAME_HEADING = 0.01, math.radians(0.5)
"""Difference up to which a target is the present one (m, rad): the rounding of a link's coordinates."""
_TARGET_STREAM_S = 1.0
"""Interval below which changes of the target are not logged (s)."""
_STOP_PLACE_M = 0.3
"""Distance beyond the shortest stop up to which a turn keeps the goal of the present leg (m)."""


def _is_already_requested(s: MissionState, goal: Triple | None, heading: float | None) -> bool:
    """Return whether the vehicle already does what the user requests."""
    before = s.requested_heading
    same = before is None if heading is None else before is not None and abs(heading - before) <= _SAME_HEADING
    near = goal is None or all(abs(a - b) <= _SAME_PLACE_M for a, b in zip(goal, s.goal, strict=True))
    return s.manual and not s.returning_home and same and near


def _stop_place(s: MissionState) -> Triple | None:
    """Return the goal of the present leg if the reference may as well stop there for a turn; else None."""
    now = current_reference(s)
    (n, e, d), (gn, ge, gd) = now.position, s.goal
    _, rest = smooth_stop_distance(vector_length(*now.velocity), DETOUR_ACCELERATION_M_S2)
    return (
        s.goal if s.state is State.WAYPOINT and vector_length(n - gn, e - ge, d - gd) <= rest + _STOP_PLACE_M else None
    )


def _compass_deg(heading: float) -> float:
    deg = math.degrees(wrap_turn(heading))
    return deg + (360.0 if deg < 0.0 else 0.0)


def pause_mission(plan: MissionPlan, s: MissionState, why: str = LogMessage.MISSION_PAUSED.value) -> MissionState:
    """Stop and hover; the mission waits."""
    if s.state is State.HOVER:
        return s if s.manual else replace(log_event(s, why), manual=True, abort_reason="")
    brake = plan_braking(plan, s)
    at = brake.evaluate(math.inf)
    n, e, d = at.position
    place = (n, e, min(d, -MIN_WAYPOINT_HEIGHT_M) if s.state is State.LANDING else d)
    flags: dict[str, Any] = {
        "manual": True,
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
    if s.state is State.WAYPOINT and not s.manual and index == s.waypoint_index:
        return s
    why = LogMessage.MISSION_CONTINUES() if s.mission_begun and not over else LogMessage.MISSION_BEGINS()
    if first is not None:
        why = LogMessage.ON_TO_WAYPOINT(first + 1)
    s = replace(log_event(s, why), hover_until_s=s.time_s) if s.state is State.HOVER else pause_mission(plan, s, why)
    return replace(s, manual=False, mission_begun=True, waypoint_index=index, outcome="", reason="", abort_reason="")


def resume_after_take_off(s: MissionState, first: int | None) -> MissionState:
    """Let the mission follow the take-off, from waypoint ``first`` (from 0) if given."""
    s = log_event(
        s, LogMessage.MISSION_AFTER_TAKE_OFF_FROM(first + 1) if first else LogMessage.MISSION_AFTER_TAKE_OFF()
    )
    return replace(
        s,
        manual=False,
        mission_begun=True,
        waypoint_index=first or 0,
        abort_reason="",
        hover_after_take_off=False,
    )


def start_return_home(plan: MissionPlan, s: MissionState) -> MissionState:
    """Start the return: fly to above the take-off position and land."""
    return (
        s
        if s.returning_home
        else start_leg_home(
            plan,
            _set_abort_reason(plan, s, LogMessage.RETURN_BEFORE_LAST_WAYPOINT, LogMessage.RETURN_WITH_WAYPOINTS_LEFT),
            LogMessage.RETURN_SIGNAL(),
        )
    )


def start_land_now(plan: MissionPlan, s: MissionState) -> MissionState:
    """Start a landing by the user's signal."""
    return start_landing(
        _set_abort_reason(plan, s, LogMessage.LAND_BEFORE_LAST_WAYPOINT, LogMessage.LAND_WITH_WAYPOINTS_LEFT),
        LogMessage.LAND_SIGNAL(),
    )


def _set_abort_reason(plan: MissionPlan, s: MissionState, last: LogMessage, early: LogMessage) -> MissionState:
    left = len(plan.mission.waypoint) - s.waypoint_index
    if not s.mission_begun or left <= 0:
        return s
    return replace(s, abort_reason=(early if left > 1 else last)(left))


# Manual control (RC)


def enter_manual(s: MissionState, m: Estimate) -> MissionState:
    """Give control to the pilot, from any state."""
    x, psi = measured_position(m), float(m.attitude[2])
    return enter_state(
        s,
        State.RC,
        LogMessage.RC_ON(),
        hold_position=x,
        hold_heading=psi,
        detour=None,
        returning_home=False,
        descent_rate=0.0,
    )


def step_manual(plan: MissionPlan, s: MissionState, m: Estimate, c: Command, dt: float) -> MissionState:
    """Move the references of height and heading by the pilot's sticks; a climb from the floor starts the rotors."""
    if s.motors == "off":
        x = measured_position(m)
        fault = start_fault(m) if c.climb_rate > 0.0 else ""
        if c.climb_rate <= 0.0 or fault:
            s = refuse_start(s, fault) if fault else s
            return replace(s, hold_position=x, hold_heading=float(m.attitude[2]), descent_rate=0.0)
        s = replace(
            s,
            has_taken_off=True,
            mission_begun=False,
            manual=True,
            waypoint_index=0,
            reached_count=0,
            home_position=x,
        )
        s = replace(s, outcome="", reason="", abort_reason="", finished=False)
        return replace(s, motors="spin_up", motion_clock_s=0.0, hold_position=x)
    if s.motors == "spin_up":
        return replace(s, motors="fly") if has_spun_up(s, m) else s
    # The reference stays near the helicopter, so that it responds to the sticks at once.
    height, (vn, ve, _) = s.home_position[2] - float(m.position[2]), m.velocity.tolist()
    climb = limit_manual_climb(height, (vn, ve), plan.mission.limits.touchdown_m_s, c.climb_rate)
    depth = min(max(s.hold_position[2] - climb * dt, m.position[2] - 0.5), m.position[2] + 0.5)
    n, e, _ = measured_position(m)
    return replace(
        s,
        hold_position=(n, e, depth),
        hold_heading=s.hold_heading + c.yaw_rate * dt,
        descent_rate=-climb,
    )


def exit_manual(s: MissionState, m: Estimate) -> MissionState:
    """End manual control: hover at the present position, or return to init on the floor."""
    x, psi = measured_position(m), float(m.attitude[2])
    if s.motors != "fly" or _is_on_floor(s, m):
        if s.mission_begun and s.outcome == "":
            s = fail_mission(s, LogMessage.LANDED_BY_PILOT())
        elif s.has_taken_off and s.outcome == "":
            s = replace(s, outcome="succeeded", reason=LogMessage.LANDED_BY_PILOT())
        return _end_on_floor(s, LogMessage.RC_OFF_ON_FLOOR())
    brake = plan_stop(x, m.velocity, psi, DETOUR_ACCELERATION_M_S2)
    n, e, d = brake.evaluate(math.inf).position
    if d > s.home_position[2]:
        # The descent is too fast to stop above the floor: the reference must stay above it, and the helicopter brakes
        # fully. The stopping height goes with the descent rate w times the speed: w sqrt(u^2 + w^2) for a level speed
        # u.
        u, w = vector_length(float(m.velocity[0]), float(m.velocity[1])), float(m.velocity[2])
        most = max(0.0, s.home_position[2] - x[2]) / (d - x[2]) * w * vector_length(u, w)
        w = math.sqrt(0.5 * (vector_length(u * u, 2.0 * most) - u * u))
        brake = plan_stop(x, (m.velocity[0], m.velocity[1], w), psi, DETOUR_ACCELERATION_M_S2)
        n, e, d = brake.evaluate(math.inf).position
    at = (n, e, d)
    return enter_hover(s, LogMessage.RC_OFF(), at, psi, motion=brake, manual=True)


def _is_on_floor(s: MissionState, m: Estimate) -> bool:
    return bool(m.position[2] > s.home_position[2] - 0.1 and abs(m.velocity[2]) < 0.1)


def _end_on_floor(s: MissionState, why: str) -> MissionState:
    running = s.motors != "off"
    return enter_state(
        s, State.INIT, why, motors="ramp_down" if running else "off", finished=s.outcome != "" and not running
    )


# Set-points


def enter_offboard(s: MissionState, m: Estimate, wanted: SetPoint) -> MissionState:
    """Give control to a program in flight, or on the floor when its set-point requires lift-off."""
    if set_point_fault(wanted):
        return s
    if s.state is not State.INIT:
        return enter_state(
            s,
            State.OFFBOARD,
            LogMessage.OFFBOARD_ON(),
            set_point_reference=predict_reference(s),
            detour=None,
            manual=True,
            returning_home=False,
        )
    x = measured_position(m)
    if not needs_lift_off(wanted, x):
        return s
    fault = start_fault(m)
    if fault:
        return refuse_start(s, fault)
    return enter_state(
        reset_mission(s, m, manual=True), State.OFFBOARD, LogMessage.OFFBOARD_TAKE_OFF(), motors="spin_up"
    )


def step_offboard(plan: MissionPlan, s: MissionState, m: Estimate, c: Command, dt: float) -> MissionState:
    """Follow the set-point within the mission's limits, away from obstacles that the beams have hit."""
    if s.motors == "spin_up":
        if not has_spun_up(s, m):
            return s
        s = replace(s, motors="fly", set_point_reference=current_reference(replace(s, motion=None)))
    # The reference is predicted for the end of the step of entry.
    if (
        c.program_set_point is None
        or s.set_point_reference is None
        or s.state_entered_s == s.time_s
        or set_point_fault(c.program_set_point)
    ):
        return s
    t = track_set_point(plan, s, s.set_point_reference, c.program_set_point, m, dt)
    return replace(s, set_point_reference=t, hold_position=t.position, goal=t.position, hold_heading=t.heading)


def exit_offboard(plan: MissionPlan, s: MissionState, m: Estimate) -> MissionState:
    """End offboard control: hover where the reference comes to rest, or stay on the floor."""
    if s.motors != "fly" or _is_on_floor(s, m):
        s = replace(s, outcome="succeeded", reason=LogMessage.LANDED()) if s.outcome == "" else s
        return _end_on_floor(s, LogMessage.OFFBOARD_OFF_ON_FLOOR())
    return pause_mission(plan, s, LogMessage.OFFBOARD_OFF())
