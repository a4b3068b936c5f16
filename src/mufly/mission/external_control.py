"""Control by a pilot (manual, the thesis's state RC) or by a program's set-points (offboard)."""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.compiled.portable_math import vector_length
from mufly.estimate import Estimate
from mufly.mission.detour import DETOUR_ACCELERATION_M_S2
from mufly.mission.machine.ground_phases import (
    describe_start_fault,
    has_spun_up,
    log_start_refusal,
    measured_position,
    reset_mission,
)
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.mission_reference import current_reference, predict_step_end_reference
from mufly.mission.machine.mission_state import (
    Command,
    MissionPlan,
    MissionState,
    State,
    enter_hover,
    enter_state,
    fail_mission,
)
from mufly.mission.machine.offboard import SetPoint, describe_set_point_fault, limit_manual_climb, needs_lift_off
from mufly.mission.machine.phases import track_set_point
from mufly.mission.trajectory import plan_stop
from mufly.mission.user_requests import pause_mission

# Manual control (RC)


def enter_manual(s: MissionState, m: Estimate) -> MissionState:
    """Enter manual control, in which the pilot's sticks command the vehicle; possible in any state."""
    x, psi = measured_position(m), float(m.attitude[2])
    return enter_state(
        s,
        State.RC,
        LogTemplate.RC_ON(),
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
        fault = describe_start_fault(m) if c.pilot_climb_rate > 0.0 else ""
        if c.pilot_climb_rate <= 0.0 or fault:
            s = log_start_refusal(s, fault) if fault else s
            return replace(s, hold_position=x, hold_heading=float(m.attitude[2]), descent_rate=0.0)
        s = replace(
            s,
            has_taken_off=True,
            mission_begun=False,
            user_in_control=True,
            waypoint_index=0,
            reached_waypoint_count=0,
            home_position=x,
        )
        s = replace(s, outcome="", reason="", abort_reason="", finished=False)
        return replace(s, motors="spin_up", motion_clock_s=0.0, hold_position=x)
    if s.motors == "spin_up":
        return replace(s, motors="fly") if has_spun_up(s, m) else s
    # The reference stays near the helicopter, so that it responds to the sticks at once.
    height, (vn, ve, _) = s.home_position[2] - float(m.position[2]), m.velocity.tolist()
    climb = limit_manual_climb(height, (vn, ve), plan.mission.limits.touchdown_m_s, c.pilot_climb_rate)
    depth = min(max(s.hold_position[2] - climb * dt, m.position[2] - 0.5), m.position[2] + 0.5)
    n, e, _ = measured_position(m)
    return replace(
        s,
        hold_position=(n, e, depth),
        hold_heading=s.hold_heading + c.pilot_yaw_rate * dt,
        descent_rate=-climb,
    )


def _is_on_floor(s: MissionState, m: Estimate) -> bool:
    return bool(m.position[2] > s.home_position[2] - 0.1 and abs(m.velocity[2]) < 0.1)


def _end_control_on_floor(s: MissionState, why: str) -> MissionState:
    running = s.motors != "off"
    return enter_state(
        s, State.INIT, why, motors="ramp_down" if running else "off", finished=s.outcome != "" and not running
    )


def exit_manual(s: MissionState, m: Estimate) -> MissionState:
    """End manual control: hover at the present position, or on the floor return to the state ``init``."""
    x, psi = measured_position(m), float(m.attitude[2])
    if s.motors != "fly" or _is_on_floor(s, m):
        if s.mission_begun and s.outcome == "":
            s = fail_mission(s, LogTemplate.LANDED_BY_PILOT())
        elif s.has_taken_off and s.outcome == "":
            s = replace(s, outcome="succeeded", reason=LogTemplate.LANDED_BY_PILOT())
        return _end_control_on_floor(s, LogTemplate.RC_OFF_ON_FLOOR())
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
    return enter_hover(s, LogTemplate.RC_OFF(), at, psi, motion=brake, user_in_control=True)


# Set-points of a program


def enter_offboard(s: MissionState, m: Estimate, wanted: SetPoint) -> MissionState:
    """Give control to an offboard program: in flight at once, on the floor if its set-point requires lift-off."""
    if describe_set_point_fault(wanted):
        return s
    if s.state is not State.INIT:
        return enter_state(
            s,
            State.OFFBOARD,
            LogTemplate.OFFBOARD_ON(),
            set_point_reference=predict_step_end_reference(s),
            detour=None,
            user_in_control=True,
            returning_home=False,
        )
    x = measured_position(m)
    if not needs_lift_off(wanted, x):
        return s
    fault = describe_start_fault(m)
    if fault:
        return log_start_refusal(s, fault)
    return enter_state(
        reset_mission(s, m, user_in_control=True), State.OFFBOARD, LogTemplate.OFFBOARD_TAKE_OFF(), motors="spin_up"
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
        or describe_set_point_fault(c.program_set_point)
    ):
        return s
    t = track_set_point(plan, s, s.set_point_reference, c.program_set_point, m, dt)
    return replace(s, set_point_reference=t, hold_position=t.position, goal=t.position, hold_heading=t.heading)


def exit_offboard(plan: MissionPlan, s: MissionState, m: Estimate) -> MissionState:
    """End offboard control: hover where the reference comes to rest, or stay on the floor."""
    if s.motors != "fly" or _is_on_floor(s, m):
        s = replace(s, outcome="succeeded", reason=LogTemplate.LANDED()) if s.outcome == "" else s
        return _end_control_on_floor(s, LogTemplate.OFFBOARD_OFF_ON_FLOOR())
    return pause_mission(plan, s, LogTemplate.OFFBOARD_OFF())
