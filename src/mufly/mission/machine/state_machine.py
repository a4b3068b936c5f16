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
last one. Signals of the user override it, if the state permits them (:mod:`mufly.mission.request_checks`). Each change
of state is logged with its reason in `MissionState.events`.

One step takes measurements and commands and returns the next state and the `Reference` for the controllers. It runs at
about 50 Hz. Trajectories are planned at transitions; other steps only evaluate one. `mufly.mission.machine.phases` and
`mufly.mission.machine.ground_phases` hold the behaviour of each state, `mufly.mission.user_requests` the effects of the
user's signals, `mufly.mission.external_control` control by a pilot (the thesis's state RC) or a program (offboard).
Every function takes a state and returns the next one. A moving reference comes to rest before any other motion, so that
no transition makes it jump.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.estimate import Estimate
from mufly.mission.avoidance import PATH_LOOK_AHEAD_M, begin_path_check, check_map_part, insert_beam_hits
from mufly.mission.external_control import (
    enter_manual,
    enter_offboard,
    exit_manual,
    exit_offboard,
    step_manual,
    step_offboard,
)
from mufly.mission.files.mission_timing import SCAN_TIME_BEFORE_DEPARTURE_S
from mufly.mission.machine import ground_phases, phases
from mufly.mission.machine.ground_phases import describe_start_fault, log_start_refusal, start_landing
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.mission_reference import compute_scan_yaw, is_scanning, make_reference
from mufly.mission.machine.mission_state import (
    Command,
    MissionPlan,
    MissionState,
    Reference,
    State,
    fail_mission,
    log_event,
)
from mufly.mission.request_checks import VehicleRequest, is_request_permitted
from mufly.mission.trajectory import Trajectory
from mufly.mission.user_requests import (
    fly_to_user_waypoint,
    land_on_request,
    pause_mission,
    queue_mission_after_take_off,
    resume_mission,
    return_on_request,
    stop_motors,
)

_FLYING_STATES = frozenset({State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.OBSTACLE, State.OFFBOARD})
_TIPPED_OVER_ANGLE_RAD = math.radians(60.0)
_LOW_BATTERY_DURATION_S = 1.0
_VOLTAGE_LAG_S = 0.5
_LONGEST_STEP_S = 0.5
_DEPARTURE_HEIGHT_TOLERANCE_M, _DEPARTURE_HEADING_TOLERANCE_RAD = 0.1, math.radians(8.0)

_STEP_FUNCTION_BY_STATE = {
    State.INIT: ground_phases.step_on_floor,
    State.TAKE_OFF: phases.step_take_off,
    State.HOVER: phases.step_hover,
    State.WAYPOINT: phases.step_leg,
    State.OBSTACLE: phases.step_detour,
    State.LANDING: ground_phases.step_landing,
}


def _may_depart(plan: MissionPlan, s: MissionState, m: Estimate, way: Trajectory) -> bool:
    """Return whether a leg's path may begin: height and heading are reached as measured, and the scan is complete."""
    at = way.evaluate(way.path_start_s)
    angle, _ = compute_scan_yaw(plan, s)
    return (
        abs(m.position[2] - at.position[2]) < _DEPARTURE_HEIGHT_TOLERANCE_M
        and abs(m.attitude[2] - at.heading - angle) < _DEPARTURE_HEADING_TOLERANCE_RAD + abs(angle)
        and (
            not plan.scans_by_yawing
            or s.resumed_after_detour
            or way.path_profile.distance == 0.0
            or s.scan_duration_s >= SCAN_TIME_BEFORE_DEPARTURE_S
        )
    )


def _update_clocks_and_battery(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Advance the clocks and check the battery."""
    clock = s.motion_clock_s + dt
    if s.state is State.WAYPOINT and isinstance(s.motion, Trajectory) and s.set_point_reference is None:
        gate = s.motion.path_start_s
        if s.motion_clock_s <= gate < clock and not _may_depart(plan, s, m, s.motion):
            clock = gate
    volts = s.battery_V + (m.battery_voltage - s.battery_V) * min(1.0, dt / _VOLTAGE_LAG_S)
    swinging = s.scan_duration_s
    swinging = (
        min(SCAN_TIME_BEFORE_DEPARTURE_S, swinging + dt) if is_scanning(plan, s) else max(0.0, min(1.0, swinging) - dt)
    )
    return replace(
        s,
        time_s=m.time_s,
        motion_clock_s=clock,
        step_duration_s=dt,
        battery_V=volts,
        low_battery_duration_s=s.low_battery_duration_s + dt if volts < plan.low_battery_V else 0.0,
        scan_duration_s=swinging,
    )


def _pause_or_defer_pause(plan: MissionPlan, s: MissionState, m: Estimate) -> MissionState:
    if s.state is State.TAKE_OFF and not is_request_permitted(VehicleRequest.GO_TO, s, m):
        if s.hover_after_take_off:
            return s
        return replace(
            log_event(s, LogTemplate.WILL_HOVER_AFTER_TAKE_OFF()), hover_after_take_off=True, user_in_control=True
        )
    why = LogTemplate.LANDING_ABORTED() if s.state is State.LANDING else LogTemplate.MISSION_PAUSED()
    return pause_mission(plan, s, why)


def _handle_request(plan: MissionPlan, s: MissionState, m: Estimate, c: Command) -> MissionState:
    """Execute the user's requests that the state permits."""
    if c.land and s.state is not State.LANDING and is_request_permitted(VehicleRequest.LAND, s, m):
        return land_on_request(plan, s)
    if s.state is State.OFFBOARD and c.program_set_point is None:
        s = exit_offboard(plan, s, m)
        if s.state is State.INIT:
            return s
    fresh = s.user_in_control or c.first_waypoint is not None
    if (
        s.state is State.INIT
        and (c.start or c.take_off_height is not None)
        and is_request_permitted(VehicleRequest.START, s, m)
    ):
        fault = describe_start_fault(m)
        if fault:
            return log_start_refusal(s, fault)
    if c.start and s.state is State.INIT and is_request_permitted(VehicleRequest.START, s, m):
        return phases.start_flight(plan, s, m, first=c.first_waypoint)
    if c.start and s.state is State.TAKE_OFF and fresh and is_request_permitted(VehicleRequest.START, s, m):
        return queue_mission_after_take_off(s, c.first_waypoint)
    if c.take_off_height is not None and is_request_permitted(VehicleRequest.TAKE_OFF, s, m):
        return phases.start_flight(plan, s, m, height=c.take_off_height)
    if (c.pause or s.hover_after_take_off) and is_request_permitted(VehicleRequest.PAUSE, s, m):
        return _pause_or_defer_pause(plan, s, m)
    if c.return_requested and is_request_permitted(VehicleRequest.RETURN, s, m):
        return return_on_request(plan, s)
    if c.program_set_point is not None and is_request_permitted(VehicleRequest.OFFBOARD, s, m):
        return s if s.state is State.OFFBOARD else enter_offboard(s, m, c.program_set_point)
    if (c.waypoint is not None or c.heading is not None) and is_request_permitted(VehicleRequest.GO_TO, s, m):
        return fly_to_user_waypoint(plan, s, c.waypoint, c.heading)
    if c.start and fresh and is_request_permitted(VehicleRequest.START, s, m):
        return resume_mission(plan, s, c.first_waypoint)
    return s


def _has_tipped_over(s: MissionState, m: Estimate) -> bool:
    near = m.position[2] > s.home_position[2] - 0.3
    return bool(near and s.motors != "off" and max(abs(m.attitude[0]), abs(m.attitude[1])) > _TIPPED_OVER_ANGLE_RAD)


def _land_on_low_battery(plan: MissionPlan, s: MissionState) -> MissionState:
    why = LogTemplate.BATTERY_LOW(s.battery_V, plan.low_battery_V)
    # A completed mission that holds does not fail by using up its battery.
    return start_landing(s if s.outcome == "succeeded" else fail_mission(s, why), why, level="warning")


def _apply_any_state_transitions(
    plan: MissionPlan, s: MissionState, m: Estimate, c: Command, dt: float
) -> MissionState:
    """Apply the transitions of every state: emergency stop, tip-over, pilot control, low battery, then requests."""
    if c.motor_stop_reason:
        return stop_motors(s, c.motor_stop_reason)
    if s.state is not State.INIT and _has_tipped_over(s, m):
        return stop_motors(fail_mission(s, LogTemplate.TIPPED_OVER()), LogTemplate.TIPPED_MOTORS_OFF())
    # Rotors that run down after touchdown stop first: centred sticks must not restart them.
    if c.rc_active and s.motors != "ramp_down":
        s = s if s.state is State.RC else enter_manual(s, m)
        if s.motors == "fly" and s.low_battery_duration_s - dt <= _LOW_BATTERY_DURATION_S < s.low_battery_duration_s:
            # The pilot decides.
            s = log_event(s, LogTemplate.BATTERY_LOW_PILOT(s.battery_V, plan.low_battery_V), level="warning")
        return step_manual(plan, s, m, c, dt)
    if s.state is State.RC:
        return exit_manual(s, m)
    if s.state in _FLYING_STATES and s.low_battery_duration_s > _LOW_BATTERY_DURATION_S:
        return _land_on_low_battery(plan, s)
    return s if s.state is State.INIT and s.motors != "off" else _handle_request(plan, s, m, c)


def _has_pending_curve(s: MissionState) -> bool:
    return isinstance(s.motion, Trajectory) and s.motion.pending_curve is not None


def _finish_pending_curve(s: MissionState) -> MissionState:
    """Return the state with arc length and curvature of its planned curve computed, if they are still pending."""
    return (
        replace(s, motion=s.motion.finish_curve()) if _has_pending_curve(s) and isinstance(s.motion, Trajectory) else s
    )


def step_mission(
    plan: MissionPlan, state: MissionState, estimate: Estimate, command: Command
) -> tuple[MissionState, Reference]:
    """Advance the mission by one step.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare_mission_plan`: the mission and the vehicle's data.
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
    dt = min(max(estimate.time_s - state.time_s, 0.0), _LONGEST_STEP_S)
    s = _update_clocks_and_battery(plan, _finish_pending_curve(state), estimate, dt)
    s = _apply_any_state_transitions(plan, s, estimate, command, dt)
    if s.state is State.OFFBOARD:
        s = step_offboard(plan, s, estimate, command, dt)
    phase = _STEP_FUNCTION_BY_STATE.get(s.state)
    if phase is not None:
        s = phase(plan, s, estimate, dt)
    wanted = make_reference(plan, s, estimate, command)
    if plan.avoids_obstacles and s.state in _FLYING_STATES:
        here = wanted.position.tolist()
        goal = s.goal if s.state in (State.WAYPOINT, State.OBSTACLE) else here
        ahead = math.inf if s.state is State.OBSTACLE else PATH_LOOK_AHEAD_M
        s = replace(s, path_check=begin_path_check(here, goal, ahead))
    return s, wanted


def update_obstacle_map(
    plan: MissionPlan, state: MissionState, estimate: Estimate, part: int = 1, parts: int = 1
) -> MissionState:
    """Add the hits of an eighth of the beams to the obstacle map and check a part of the map against the path.

    It is called between two mission steps.
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
    if not s.obstacle_map.point_count and not float(m.ranges.min()) < plan.beam_ring.max_range:
        return s
    beams = len(plan.beam_ring.cos)
    count = (beams + 7) // 8
    memory = insert_beam_hits(
        s.obstacle_map, plan.beam_ring, m.time_s, m.position, m.attitude, m.ranges, s.next_beam, count
    )
    after = s.next_beam + count
    clearance = plan.mission.avoidance.clearance_m
    memory, sight = check_map_part(memory, s.path_check, m.time_s, clearance, part, parts)
    return replace(s, obstacle_map=memory, path_check=sight, next_beam=after if after < beams else after - beams)
