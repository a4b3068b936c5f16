"""From the state of the mission to the reference of the controllers."""

from __future__ import annotations

import math

import numpy as np

from mufly.mission.signals import Command, Reference, State
from mufly.mission.state import MissionPlan, MissionState
from mufly.mission.trajectory import Point, Trajectory
from mufly.sensors import Measurement

__all__ = ["at_gate", "onward", "point", "reference", "swing"]

SWEEP_PERIOD_S = 4.0
"""Period of the nose's swing while scanning; every direction is looked at once in half of it (s)."""

_ZERO = (0.0, 0.0, 0.0)


def point(s: MissionState) -> Point:
    """Where the reference is now, without the swing of the nose."""
    if s.state is State.OBSTACLE and s.detour is not None:
        return Point(s.detour.position, s.detour.velocity, s.detour.acceleration, s.heading, 0.0)
    if s.state is State.OFFBOARD and s.tracker is not None:
        return s.tracker.point
    if s.motion is None or s.motors == "spin_up":
        return Point(s.hold, _ZERO, _ZERO, s.heading, 0.0)
    at = s.motion.at(s.clock_s)
    if s.state is State.LANDING:
        (n, e, _), (u, v, _), (a, b, _) = at.position, at.velocity, at.acceleration
        return Point((n, e, s.hold[2]), (u, v, s.sink), (a, b, s.sink_rate), at.heading, at.heading_rate)
    return at


def onward(s: MissionState) -> Point:
    """Where the reference is once this step is over, as it moves now: what another motion has to go on from.

    A motion's clock has been moved on already; what a state integrates by itself (a detour, a landing's height, the
    tracker of set-points) has not.
    """
    at = point(s)
    if s.state not in (State.OBSTACLE, State.LANDING, State.OFFBOARD):
        return at
    (n, e, d), (u, v, w), dt = at.position, at.velocity, s.step_s
    place = (n, e, d + dt * w) if s.state is State.LANDING else (n + dt * u, e + dt * v, d + dt * w)
    return at._replace(position=place, heading=at.heading + dt * at.heading_rate)


def at_gate(s: MissionState) -> bool:
    """Whether height and heading are done and the way begins, on a trajectory."""
    return isinstance(s.motion, Trajectory) and s.clock_s >= s.motion.gate_s


def swing(plan: MissionPlan, s: MissionState) -> tuple[float, float]:
    """Angle and rate of the nose's swing (rad, rad/s): half the gap between two beams to either side."""
    if s.swing <= 0.0:
        return 0.0, 0.0
    x = min(s.swing, 1.0)
    size = 0.5 * plan.ring.spacing * x * x * (3.0 - 2.0 * x)
    omega = math.tau / SWEEP_PERIOD_S
    return size * math.sin(omega * s.time_s), size * omega * math.cos(omega * s.time_s)


def reference(plan: MissionPlan, s: MissionState, m: Measurement, c: Command) -> Reference:
    """What the controllers have to follow now."""
    if s.state is State.RC:
        position = np.array((m.position[0], m.position[1], s.hold[2]))
        velocity = np.array((m.velocity[0], m.velocity[1], s.sink))
        turning = c.yaw_rate if s.motors == "fly" else 0.0
        return Reference(
            position, velocity, np.zeros(3), s.heading, turning, s.motors, rc=True, roll=c.roll, pitch=c.pitch
        )
    if s.state is State.INIT:
        return Reference(m.position.copy(), np.zeros(3), np.zeros(3), float(m.attitude[2]), 0.0, s.motors)
    at = point(s)
    angle, rate = swing(plan, s)
    return Reference(
        np.array(at.position),
        np.array(at.velocity),
        np.array(at.acceleration),
        at.heading + angle,
        at.heading_rate + rate,
        s.motors,
    )
