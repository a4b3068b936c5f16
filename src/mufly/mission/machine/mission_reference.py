"""Reference of the mission for the controllers: the point of the present motion, and the yaw oscillation that scans."""

from __future__ import annotations

import math

import numpy as np

from mufly.compiled.portable_math import sine_cosine
from mufly.estimate import Estimate
from mufly.mission.machine.mission_state import Command, MissionPlan, MissionState, Reference, State
from mufly.mission.machine.offboard import limit_manual_tilt
from mufly.mission.trajectory import Trajectory, TrajectoryPoint

NOSE_SWING_PERIOD_S = 4.0
"""Period of the nose swing while scanning (s); half of it covers every direction."""
_ZERO_VECTOR = (0.0, 0.0, 0.0)


def current_reference(s: MissionState) -> TrajectoryPoint:
    """Return the present reference, without the yaw oscillation that scans for obstacles."""
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


def predict_step_end_reference(s: MissionState) -> TrajectoryPoint:
    """Return the reference at the end of this step, from which another motion must continue.

    The clock of a motion is already at the end of the step. References that a state integrates itself (a detour, a
    landing's height, the tracker of set-points) are still at its start.
    """
    at = current_reference(s)
    if s.state not in (State.OBSTACLE, State.LANDING, State.OFFBOARD) and s.set_point_reference is None:
        return at
    (n, e, d), (u, v, w), dt = at.position, at.velocity, s.step_duration_s
    place = (n, e, d + dt * w) if s.state is State.LANDING else (n + dt * u, e + dt * v, d + dt * w)
    return at._replace(position=place, heading=at.heading + dt * at.heading_rate)


def has_departed(s: MissionState) -> bool:
    """Return whether the reference, having changed height and heading, moves on a leg's path, or tracks a set-point."""
    if s.set_point_reference is not None:
        return True
    return isinstance(s.motion, Trajectory) and s.motion_clock_s >= s.motion.path_start_s


def is_scanning(plan: MissionPlan, s: MissionState) -> bool:
    """Return whether the vehicle yaws to and fro to scan: around an obstacle, or on a level path of a scanning
    mission.
    """
    return s.state is State.OBSTACLE or (plan.scans_by_yawing and s.state is State.WAYPOINT and has_departed(s))


def compute_scan_yaw(plan: MissionPlan, s: MissionState) -> tuple[float, float]:
    """Return angle (rad) and rate (rad/s) of the yaw oscillation that scans for obstacles.

    The amplitude is half the angle between two beams. It rises over the first second of a scan and falls over a second
    after its end.
    """
    if s.scan_duration_s <= 0.0:
        return 0.0, 0.0
    x, most, omega = min(s.scan_duration_s, 1.0), 0.5 * plan.beam_ring.spacing, math.tau / NOSE_SWING_PERIOD_S
    size = most * x * x * (3.0 - 2.0 * x)
    growth = most * 6.0 * x * (1.0 - x) * (1.0 if is_scanning(plan, s) else -1.0)
    sine, cosine = sine_cosine(omega * (s.time_s - NOSE_SWING_PERIOD_S * int(s.time_s / NOSE_SWING_PERIOD_S)))
    return size * sine, growth * sine + size * omega * cosine


def make_reference(plan: MissionPlan, s: MissionState, m: Estimate, c: Command) -> Reference:
    """Return the reference of position, velocity and heading for the controllers at this step."""
    if s.state is State.RC:
        position = np.array((m.position[0], m.position[1], s.hold_position[2]))
        velocity = np.array((m.velocity[0], m.velocity[1], s.descent_rate))
        turning = c.pilot_yaw_rate if s.motors == "fly" else 0.0
        height = s.home_position[2] - float(m.position[2])
        vn, ve, _ = m.velocity.tolist()
        roll, pitch = limit_manual_tilt(height, (vn, ve), float(m.attitude[2]), (c.pilot_roll, c.pilot_pitch))
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
    angle, rate = compute_scan_yaw(plan, s)
    return Reference(
        np.array(at.position),
        np.array(at.velocity),
        np.array(at.acceleration),
        at.heading + angle,
        at.heading_rate + rate,
        s.motors,
    )
