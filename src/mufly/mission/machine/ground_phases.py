"""Phases on and near the floor: start, landing, and the descent without an estimate.

Every function takes a state and returns the next one; there is no other memory.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mufly.estimate import Estimate, compute_standing_tilt
from mufly.mission.detour import DETOUR_ACCELERATION_M_S2
from mufly.mission.files.mission_schema import ROTOR_SPIN_UP_TIME_S
from mufly.mission.files.mission_timing import DESCENT_LAG_S, ROTOR_RUN_DOWN_TIME_S, compute_landing_rate
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.mission_reference import current_reference, predict_step_end_reference
from mufly.mission.machine.mission_state import MissionPlan, MissionState, State, enter_state, fail_mission, log_event
from mufly.mission.machine.offboard import DRIFTING_DESCENT_RATE_M_S
from mufly.mission.trajectory import Triple, plan_stop

_REST_DURATION_ON_FLOOR_S = 0.3
_NEAR_FLOOR_HEIGHT_M = 0.1
_DRIFT_CHECK_HEIGHT_M, _DRIFT_SPEED_M_S = (
    0.6,
    0.3,
)  # below this, above this drift, it descends at DRIFTING_DESCENT_RATE_M_S
_MAX_DESCENT_LAG_M = 0.25  # largest height error during descent
_STANDING_HEIGHT_M, _PRESS_DOWN_DEPTH_M, _PRESS_DOWN_DURATION_S = (
    0.02,
    0.03,
    0.05,
)  # standing on the floor by the estimate: height, reference below it, duration
_MAX_HEIGHT_SIGMA_M = 0.05  # largest height deviation for this test
HARD_TOUCHDOWN_M_S = 0.3
"""Speed above which a touchdown counts as hard (m/s): a fifth above the greatest touchdown speed of missions."""
LIFT_OFF_HEIGHT_M, TIPPING_RATE_RAD_S = 0.02, 0.15
"""Height above the standing position that counts as lift-off (m); roll or pitch rate that counts as tipping (rad/s).

Wind drag on the rotors tips a vehicle whose legs carry little weight."""
MAX_START_TILT_DEG = 6.0
"""Tilt on the floor up to which the motors are started (degrees): the mount of the inertial unit, its bias and legs."""
_MAX_START_TILT_RAD = math.radians(MAX_START_TILT_DEG)


def start_landing(s: MissionState, why: str, *, level: str = "info") -> MissionState:
    """Start a landing below the point where the reference comes to rest."""
    if s.motors == "spin_up":
        s = fail_mission(s, why) if s.mission_begun else s
        return enter_state(s, State.INIT, why, level=level, motors="ramp_down")
    now = current_reference(s)
    brake = plan_stop(
        predict_step_end_reference(s).position, (*now.velocity[:2], 0.0), now.heading, DETOUR_ACCELERATION_M_S2
    )
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
        rest_duration_s=0.0,
        touchdown_speed=0.0,
    )


def _log_touchdown(s: MissionState) -> MissionState:
    if s.touchdown_speed <= HARD_TOUCHDOWN_M_S:
        return log_event(s, LogTemplate.TOUCHDOWN())
    return log_event(s, LogTemplate.HARD_TOUCHDOWN(s.touchdown_speed, HARD_TOUCHDOWN_M_S), level="warning")


def _judge_outcome(s: MissionState) -> MissionState:
    """Return the state after landing; a mission without an outcome is marked as succeeded or failed."""
    if s.outcome != "":
        return s
    if s.abort_reason:
        return fail_mission(s, s.abort_reason)
    return replace(
        s,
        outcome="succeeded",
        reason=(LogTemplate.MISSION_COMPLETE if s.mission_begun else LogTemplate.LANDED)(),
    )


def step_landing(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Descend, slower near the floor, then reduce the thrust until the legs carry the weight, and stop the rotors.

    If the height is known with certainty, the rotors stop as soon as the vehicle is 3 cm above its reference and within
    2 cm of the floor. Otherwise the controllers could follow an undetected drift of the position and tip the vehicle
    over a leg that rubs on the floor. With friction mu, the centre of mass at height h and the legs at distance l, a
    vehicle that slides without thrust does not tip if mu h < l. The rotors must therefore not lift while it slides.
    """
    if s.motors == "ramp_down":
        if s.motion_clock_s < ROTOR_RUN_DOWN_TIME_S:
            return s
        return enter_state(_judge_outcome(s), State.INIT, LogTemplate.LANDED(), motors="off", finished=True)
    q = plan.mission.limits
    a = q.climb_acceleration_m_s2
    above = s.home_position[2] - s.hold_position[2]
    wanted = compute_landing_rate(above, q.descent_m_s, q.touchdown_m_s, a)
    if above < -0.3:
        wanted = 0.0
    elif 0.0 < above < _DRIFT_CHECK_HEIGHT_M and m.velocity[0] ** 2 + m.velocity[1] ** 2 > _DRIFT_SPEED_M_S**2:
        wanted = min(wanted, DRIFTING_DESCENT_RATE_M_S)
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
        and depth > m.position[2] + _PRESS_DOWN_DEPTH_M
        and bool(m.covariance[2, 2] < _MAX_HEIGHT_SIGMA_M * _MAX_HEIGHT_SIGMA_M)
    )
    still = s.rest_duration_s + dt if stands or (lying and abs(m.velocity[2]) < 0.05) else 0.0
    near = m.position[2] > s.home_position[2] - _NEAR_FLOOR_HEIGHT_M
    if m.auxiliary_states is not None:  # a filter that has not detected the floor keeps falling for a moment
        near = near and m.position[2] < s.home_position[2] - LIFT_OFF_HEIGHT_M
    impact = max(s.touchdown_speed, float(m.velocity[2])) if near else s.touchdown_speed
    s = replace(
        s,
        hold_position=(s.hold_position[0], s.hold_position[1], depth),
        descent_rate=speed,
        descent_acceleration=rate,
        rest_duration_s=still,
        touchdown_speed=impact,
    )
    lasts = _PRESS_DOWN_DURATION_S if stands else _REST_DURATION_ON_FLOOR_S
    return replace(_log_touchdown(s), motors="ramp_down", motion_clock_s=0.0) if still > lasts else s


def enter_blind_descent(s: MissionState, time_s: float, why: str) -> MissionState:
    """Enter the descent without measurements, which the flight software controls by itself."""
    s = fail_mission(replace(s, time_s=time_s), why)
    return enter_state(s, State.LANDING, why, level="error", motors="blind", detour=None)


def fail_and_land(s: MissionState, why: str) -> MissionState:
    """Fail the mission and land; while a pilot flies (state RC) and on the floor only log the reason."""
    if s.state in (State.INIT, State.RC):
        return log_event(s, why, level="error")
    s = fail_mission(s, why)
    return log_event(s, why, level="error") if s.state is State.LANDING else start_landing(s, why, level="error")


def finish_blind_descent(s: MissionState, time_s: float) -> MissionState:
    """End the flight after the descent without measurements: motors off, mission finished."""
    s = replace(s, time_s=time_s)
    return enter_state(s, State.INIT, LogTemplate.MOTORS_OFF_AFTER_DESCENT(), motors="off", finished=True)


def measured_position(m: Estimate) -> Triple:
    """Return the measured position as three numbers (N, E, D; m)."""
    n, e, d = m.position.tolist()
    return n, e, d


def has_lifted_off(s: MissionState, m: Estimate) -> bool:
    """Return whether the vehicle is off the floor."""
    return bool(m.position[2] < s.home_position[2] - LIFT_OFF_HEIGHT_M)


def is_tipping(m: Estimate) -> bool:
    """Return whether the vehicle rotates on its legs: it is nearly lifted and needs attitude control."""
    return bool(max(abs(m.rates[0]), abs(m.rates[1])) > TIPPING_RATE_RAD_S)


def describe_start_fault(m: Estimate) -> str:
    """Return the reason why the motors may not be started with this estimate; "" if they may."""
    if not m.valid:
        return LogTemplate.ESTIMATE_NOT_VALID()
    tilt = compute_standing_tilt(m)
    return "" if tilt <= _MAX_START_TILT_RAD else LogTemplate.STANDS_TILTED(math.degrees(tilt), MAX_START_TILT_DEG)


def log_start_refusal(s: MissionState, why: str) -> MissionState:
    """Log the refusal of a start, once for each reason."""
    head = LogTemplate.STANDS_TILTED.value.partition("{")[0]
    last = s.events[-1].text
    return s if last == why or (last.startswith(head) and why.startswith(head)) else log_event(s, why, level="warning")


def has_spun_up(s: MissionState, m: Estimate) -> bool:
    """Return whether the spin-up time is over or the vehicle has already lifted off.

    A vehicle lighter than its controllers' model lifts off early.
    """
    return s.motion_clock_s >= ROTOR_SPIN_UP_TIME_S or has_lifted_off(s, m)


def step_on_floor(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Run one mission step on the floor, where the vehicle waits for a start; after a flight the motors run down."""
    if s.motors == "ramp_down" and s.motion_clock_s > ROTOR_RUN_DOWN_TIME_S:
        return replace(s, motors="off", finished=s.outcome != "")
    return s


def reset_mission(s: MissionState, m: Estimate, **changes: Any) -> MissionState:
    """Return the mission state at the start of a new flight from the present position."""
    x = measured_position(m)
    return MissionState(
        time_s=s.time_s,
        has_taken_off=True,
        hold_position=x,
        home_position=x,
        hold_heading=float(m.attitude[2]),
        battery_V=s.battery_V,
        events=s.events,
        logged_event_count=s.logged_event_count,
        **changes,
    )
