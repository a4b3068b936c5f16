"""Trajectories: where to be, how fast, and where to look, as functions of time.

muFly reaches a waypoint in the simplest way (Sec. 6.2.2): first it adapts heading and height on the spot, then it
flies a straight level line. A cubic spline through the waypoints is the other kind. Either is a `Trajectory` of two
parts: on the spot (height and heading together) up to `gate_s`, then the way. The one who flies it holds the clock at
the gate until the helicopter is there in fact, which is the thesis's "if the desired point is reached".

Every part runs from rest to rest with continuous acceleration (`profile`). A turn takes the shorter way round; the
heading is continuous with the one it started from (it may pass +-pi and go on).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mufly.mission.profile import Profile, profile, step_down, step_down_way
from mufly.mission.spline import SplinePath, spline, spline_path

__all__ = ["Limits", "Point", "Stop", "Trajectory", "curved", "shorter_way_round", "stop", "straight"]

_SPOT = 1e-3
"""Ways shorter than this (m) are no ways: there is no direction to look in."""


class Point(NamedTuple):
    """A trajectory at one instant: N-E-D in m, m/s and m/s2; heading in rad and rad/s."""

    position: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    heading: float
    heading_rate: float


@dataclass(frozen=True, slots=True)
class Limits:
    """What a trajectory may ask for, SI units.

    Attributes
    ----------
    speed, climb, descent : float
        Horizontal speed, rate of climb and of descent (m/s).
    acceleration, climb_acceleration : float
        Horizontal and vertical acceleration (m/s2).
    yaw_rate, yaw_acceleration : float
        Turning (rad/s, rad/s2).
    """

    speed: float
    climb: float
    descent: float
    acceleration: float
    climb_acceleration: float
    yaw_rate: float
    yaw_acceleration: float


@dataclass(frozen=True, slots=True)
class Trajectory:
    """On the spot to a height and a heading, then along a line or a curve.

    Attributes
    ----------
    start, goal : (3,) tuples
        N, E, D (m).
    heading, turn : float
        Heading at the start and the turn on the spot (rad).
    rise, yaw, way : Profile
        Timing of the change of height, of the turn, and of the level line.
    gate_s : float
        When the part on the spot ends (s).
    duration_s : float
        When all is done (s).
    curve : SplinePath or None
        Flown in place of the line.
    lead : Stop or None
        Braking that comes first; `gate_s` and `duration_s` include it.
    """

    start: tuple[float, float, float]
    goal: tuple[float, float, float]
    heading: float
    turn: float
    rise: Profile
    yaw: Profile
    way: Profile
    gate_s: float
    duration_s: float
    curve: SplinePath | None = None
    lead: Stop | None = None

    def after(self, brake: Stop) -> Trajectory:
        """The same trajectory with a braking before it, which has to end where it starts."""
        t = brake.rest_s
        return replace(self, lead=brake, gate_s=self.gate_s + t, duration_s=self.duration_s + t)

    def at(self, t: float) -> Point:
        """Evaluate at time ``t`` (s) after its start; at rest before 0 and after `duration_s`."""
        gate = self.gate_s
        if self.lead is not None:
            if t < self.lead.rest_s:
                return self.lead.at(t)
            t, gate = t - self.lead.rest_s, gate - self.lead.rest_s
        psi, rate = self.heading + self.turn, 0.0
        if t < self.yaw.duration_s:
            angle, rate, _ = self.yaw.at(t)
            sign = math.copysign(1.0, self.turn)
            psi, rate = self.heading + sign * angle, sign * rate
        (n, e, d), (gn, ge, gd) = self.start, self.goal
        if self.curve is not None:
            return Point(*self.curve.at(t - gate), psi, rate)
        climbing = t < gate
        if climbing:
            z, w, a = self.rise.at(t)
            sign = 1.0 if gd > d else -1.0
            return Point((n, e, d + sign * z), (0.0, 0.0, sign * w), (0.0, 0.0, sign * a), psi, rate)
        if self.way.way == 0.0:
            return Point(self.goal, _ZERO, _ZERO, psi, rate)
        s, v, a = self.way.at(t - gate)
        un, ue = (gn - n) / self.way.way, (ge - e) / self.way.way
        return Point((n + s * un, e + s * ue, gd), (v * un, v * ue, 0.0), (a * un, a * ue, 0.0), psi, rate)


_ZERO = (0.0, 0.0, 0.0)


def shorter_way_round(angle: float) -> float:
    """The same turn the shorter way round, in [-pi, pi] (rad)."""
    return math.remainder(angle, math.tau)


def straight(
    start: ArrayLike,
    goal: ArrayLike,
    heading: float,
    limits: Limits,
    *,
    final_heading: float | None = None,
    nose_offset: float = 0.0,
) -> Trajectory:
    """Heading and height first, then a straight level line (Sec. 6.2.2, Fig. 6.17).

    Parameters
    ----------
    start, goal : (3,) arrays
        N, E, D (m).
    heading : float
        Heading at the start (rad, may exceed +-pi).
    limits : Limits
        What it may ask for.
    final_heading : float, optional
        Heading to fly with (rad, compass: any equivalent will do). By default along the line; a line shorter than
        1 mm has no direction and keeps the heading.
    nose_offset : float
        Added to the direction of the line when no ``final_heading`` is given (rad).
    """
    a, b = _triple(start), _triple(goal)
    way = math.hypot(b[0] - a[0], b[1] - a[1])
    turn = _turn(a, b, way, heading, final_heading, nose_offset)
    if way < _SPOT:
        way, b = 0.0, (a[0], a[1], b[2])
    fall = b[2] - a[2]
    rise = profile(abs(fall), limits.descent if fall > 0.0 else limits.climb, limits.climb_acceleration)
    yaw = profile(abs(turn), limits.yaw_rate, limits.yaw_acceleration)
    gate = max(rise.duration_s, yaw.duration_s)
    line = profile(way, limits.speed, limits.acceleration)
    return Trajectory(a, b, heading, turn, rise, yaw, line, gate, gate + line.duration_s)


def curved(
    start: ArrayLike,
    goal: ArrayLike,
    leaving: ArrayLike,
    arriving: ArrayLike,
    heading: float,
    limits: Limits,
    *,
    final_heading: float | None = None,
    nose_offset: float = 0.0,
) -> Trajectory:
    """Heading first, then a cubic spline (eqs 6.11 to 6.13), from rest to rest.

    Parameters
    ----------
    start, goal : (3,) arrays
        N, E, D (m).
    leaving, arriving : (3,) arrays
        Directions of the curve at its ends; their lengths do not matter.
    heading, limits, final_heading, nose_offset
        As for `straight`: the heading is that of the chord and does not follow the curve.

    Returns
    -------
    Trajectory
        The straight one where no curve can be flown (no length, a cusp, a bend too tight).
    """
    plain = straight(start, goal, heading, limits, final_heading=final_heading, nose_offset=nose_offset)
    a, b = np.array(plain.start), np.array(plain.goal)
    reach = float(np.linalg.norm(b - a))
    if reach < _SPOT:
        return plain
    ends = []
    for direction in (leaving, arriving):
        u = np.asarray(direction, dtype=np.float64)
        length = float(np.linalg.norm(u))
        ends.append(u / length * reach if length > 1e-9 else b - a)
    # A curve that rises or sinks has its whole acceleration within the vertical limit.
    level = a[2] == b[2] and all(u[2] == 0.0 for u in ends)
    path = spline_path(
        spline(a, b, *ends),
        speed=limits.speed,
        climb=limits.climb,
        descent=limits.descent,
        acceleration=limits.acceleration if level else min(limits.acceleration, limits.climb_acceleration),
    )
    if path is None:
        return plain
    gate = plain.yaw.duration_s
    still = profile(0.0, 1.0, 1.0)
    return Trajectory(
        plain.start,
        plain.goal,
        heading,
        plain.turn,
        still,
        plain.yaw,
        path.timing,
        gate,
        gate + path.timing.duration_s,
        path,
    )


@dataclass(frozen=True, slots=True)
class Stop:
    """Coming to rest from a given velocity along its own direction: v(t) = v0 (1 - S(t / T)); likewise turning."""

    start: tuple[float, float, float]
    velocity: tuple[float, float, float]
    heading: float
    duration_s: float
    heading_rate: float = 0.0
    turn_s: float = 0.0

    @property
    def rest_s(self) -> float:
        """When both have come to rest (s)."""
        return max(self.duration_s, self.turn_s)

    def at(self, t: float) -> Point:
        """Evaluate at time ``t`` (s) after the start; at rest after `rest_s`."""
        span = self.duration_s
        value, slope, way = step_down(t / span) if span > 0.0 else (0.0, 0.0, 0.0)
        (n, e, d), (u, v, w) = self.start, self.velocity
        s, a = way * span, slope / span if span > 0.0 else 0.0
        psi, rate = self.heading, 0.0
        if self.turn_s > 0.0:
            slower, _, turned = step_down(t / self.turn_s)
            psi, rate = psi + self.heading_rate * self.turn_s * turned, self.heading_rate * slower
        return Point(
            (n + u * s, e + v * s, d + w * s),
            (u * value, v * value, w * value),
            (u * a, v * a, w * a),
            psi,
            rate,
        )


def stop(
    position: ArrayLike,
    velocity: ArrayLike,
    heading: float,
    acceleration: float,
    *,
    heading_rate: float = 0.0,
    yaw_acceleration: float = math.inf,
) -> Stop:
    """Brake from ``velocity`` (3,) at ``position`` (3,) with at most ``acceleration`` (m/s2).

    A ``heading_rate`` (rad/s) is brought to rest with at most ``yaw_acceleration`` (rad/s2).
    """
    v = _triple(velocity)
    duration, _ = step_down_way(math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2), acceleration)
    turn_s, _ = step_down_way(heading_rate, yaw_acceleration)
    return Stop(_triple(position), v, heading, duration, heading_rate, turn_s)


def _triple(x: ArrayLike) -> tuple[float, float, float]:
    n, e, d = np.asarray(x, dtype=np.float64).tolist()
    return n, e, d


def _turn(
    a: tuple[float, float, float],
    b: tuple[float, float, float],
    way: float,
    heading: float,
    final_heading: float | None,
    nose_offset: float,
) -> float:
    if final_heading is not None:
        return shorter_way_round(final_heading - heading)
    if way < _SPOT:
        return 0.0
    return shorter_way_round(math.atan2(b[1] - a[1], b[0] - a[0]) + nose_offset - heading)
