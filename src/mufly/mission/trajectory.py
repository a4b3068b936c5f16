"""Motion along a line in time, from rest to rest, with limits on speed and acceleration.

The speed rises from 0 to its peak V as V S(t / T_a), stays there, and falls in the same way, with the quintic step

    S(x) = 10 x^3 - 15 x^4 + 6 x^5,   S' = 30 x^2 (1 - x)^2,   integral_0^x S = 5/2 x^4 - 3 x^5 + x^6,

so that acceleration and jerk are continuous and zero at both ends. S' peaks at 15/8, so T_a = 15 V / (8 a) uses the
whole acceleration a; since integral_0^1 S = 1/2, both ramps together cover V T_a. A shorter distance d is flown with
the lower peak V = sqrt(8 a d / 15) and no cruise. Own derivation.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.portable_math import portable_atan2, vector_length, wrap_angle

Triple = tuple[float, float, float]
_PEAK_SPEED_RATIO = 15.0 / 8.0


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """Distance over time, from rest to rest.

    Attributes
    ----------
    distance : float
        Total distance (m or rad), not negative.
    peak_speed : float
        Peak speed (m/s or rad/s).
    ramp_s, cruise_s : float
        Duration of one ramp and of the cruise (s).
    """

    distance: float
    peak_speed: float
    ramp_s: float
    cruise_s: float

    @property
    def duration_s(self) -> float:
        """Time from rest to rest (s)."""
        return 2.0 * self.ramp_s + self.cruise_s

    def evaluate(self, t: float) -> Triple:
        """Return distance, speed and acceleration at time ``t`` (s); at rest before 0 and after the end."""
        ramp = self.ramp_s
        if t <= 0.0 or ramp == 0.0:
            return (0.0 if t <= 0.0 else self.distance), 0.0, 0.0
        left = 2.0 * ramp + self.cruise_s - t
        if left <= 0.0:
            return self.distance, 0.0, 0.0
        if t >= ramp and left >= ramp:
            return self.peak_speed * (t - 0.5 * ramp), self.peak_speed, 0.0
        x = min(t, left) / ramp
        x2 = x * x
        way = self.peak_speed * ramp * x2 * x2 * (2.5 - 3.0 * x + x2)
        speed = self.peak_speed * x2 * x * (10.0 - 15.0 * x + 6.0 * x2)
        acceleration = self.peak_speed / ramp * 30.0 * x2 * ((1.0 - x) * (1.0 - x))
        return (way, speed, acceleration) if t < left else (self.distance - way, speed, -acceleration)


def make_motion_profile(way: float, speed: float, acceleration: float) -> MotionProfile:
    """Return the quickest motion from rest to rest over a distance, within limits of speed and acceleration.

    Parameters
    ----------
    way : float
        Distance (m or rad), at least 0.
    speed, acceleration : float
        Limits, above 0.

    Returns
    -------
    MotionProfile
        Profile that keeps the limits of speed and acceleration and reaches at least one of them.
    """
    if way <= 0.0:
        return MotionProfile(0.0, 0.0, 0.0, 0.0)
    peak = min(speed, math.sqrt(acceleration * way / _PEAK_SPEED_RATIO))
    ramp = _PEAK_SPEED_RATIO * peak / acceleration
    return MotionProfile(way, peak, ramp, max(0.0, way / peak - ramp))


def smooth_step_down(x: float) -> Triple:
    """Return 1 - S(x), its slope, and its integral from 0 to x; S is a smooth step from 0 to 1 over x in [0, 1]."""
    if x <= 0.0:
        return 1.0, 0.0, 0.0
    if x >= 1.0:
        return 0.0, 0.0, 0.5
    x2 = x * x
    return (
        1.0 - x2 * x * (10.0 - 15.0 * x + 6.0 * x2),
        -30.0 * x2 * ((1.0 - x) * (1.0 - x)),
        x - x2 * x2 * (2.5 - 3.0 * x + x2),
    )


def compute_stop_time_and_distance(speed: float, acceleration: float) -> tuple[float, float]:
    """Return time (s) and distance of a stop from ``speed`` by `smooth_step_down` with at most ``acceleration``."""
    duration = _PEAK_SPEED_RATIO * abs(speed) / acceleration
    return duration, 0.5 * abs(speed) * duration


# ----------------------------------------------------------------------------
# Cubic splines through waypoints (Sec. 6.2.2, eqs 6.11 to 6.13).
#
#     P = A t^3 + B t^2 + C t + D,   t in [0, 1]                          (6.11)
#     D = x0,  C = x0',  B = 3 (xg - x0) - 2 x0' - xg',  A = 2 (x0 - xg) + x0' + xg'   (6.12)
#     T = 3 A t^2 + 2 B t + C,  Q = 6 A t + 2 B,  K = T x Q x T / |T|^4    (6.13; the print lacks the 3 in T)
#
# The boundary derivatives are unit directions times the distance between the two points: the interpretation of
# "normalised" velocities here. (T x Q) x T / |T|^4 is the curvature vector: it points to the centre of curvature and
# its length is one over the radius.
#
# In flight the distance s(t) along the curve follows a `MotionProfile`, x = P(u(s)), so that
#
#     v = s' T/|T|,   a = s'' T/|T| + s'^2 K.
#
# u(s) comes from a table of arc lengths (Gauss-Legendre), refined by one Newton step. The peak speed V is the lowest
# that any point of the curve requires: the limit on horizontal speed, the climb and descent limits where the curve
# rises or falls, and V^2 |K| <= a / sqrt(2), which with s'' <= a / sqrt(2) keeps |a| below its limit.


_Array = NDArray[np.float64]
_CubicCoefficients = tuple[float, float, float, float]
_ARC_PIECE_COUNT = 32
"""Pieces of the arc length table, and steps of the search for the extreme points of a curve."""
_EXTREME_REFINEMENT_COUNT = 5
"""Halvings of a step around each extreme point."""
_GAUSS_NODES = tuple(float.fromhex(x) for x in ("-0x1.8c97ef43f7248p-1", "0x0.0p+0", "0x1.8c97ef43f7248p-1"))
_GAUSS_WEIGHTS = tuple(
    float.fromhex(x) for x in ("0x1.1c71c71c71c72p-1", "0x1.c71c71c71c71cp-1", "0x1.1c71c71c71c72p-1")
)
"""Three-point Gauss-Legendre rule, written out for equal values on all machines."""
_MIN_DENOMINATOR = 1e-9
_MIN_CURVE_SPEED_M_S = 0.05  # least speed of a curve


@dataclass(frozen=True)
class CubicSpline:
    """Cubic curve A t^3 + B t^2 + C t + D; ``coefficients`` (4, 3) has a row for each of A, B, C, D."""

    coefficients: _Array

    def evaluate(self, t: ArrayLike) -> tuple[_Array, _Array, _Array]:
        """Return point P, tangent T and second derivative Q, each (..., 3), at parameters ``t`` (...)."""
        a, b, c, d = self.coefficients
        u = np.asarray(t, dtype=np.float64)[..., None]
        return ((a * u + b) * u + c) * u + d, (3.0 * a * u + 2.0 * b) * u + c, 6.0 * a * u + 2.0 * b

    @property
    def axis_cubics(self) -> tuple[_CubicCoefficients, ...]:
        """Return A, B, C, D for each axis."""
        n, e, d = self.coefficients.T.tolist()
        return tuple(n), tuple(e), tuple(d)


def make_spline(x0: ArrayLike, xg: ArrayLike, dx0: ArrayLike, dxg: ArrayLike) -> CubicSpline:
    """Return the cubic from x0 to xg (3,) with boundary derivatives dx0 and dxg (3,) (eq. 6.12).

    Thesis: eqs 6.11 to 6.13; Fig. 6.16.
    """
    p, g, dp, dg = (np.asarray(v, dtype=np.float64) for v in (x0, xg, dx0, dxg))
    return CubicSpline(np.stack([2.0 * (p - g) + dp + dg, 3.0 * (g - p) - 2.0 * dp - dg, dp, p]))


class TimedSpline(NamedTuple):
    """A spline with its timing, stored for fast evaluation."""

    coefficients: tuple[_CubicCoefficients, ...]
    """A, B, C, D for each axis."""
    arc_lengths: tuple[float, ...]
    """Arc length at equal steps of the parameter (m)."""
    speed_profile: MotionProfile

    def evaluate(self, t: float) -> tuple[Triple, Triple, Triple]:
        """Return position, velocity and acceleration (3 each; m, m/s, m/s2) at time ``t`` (s)."""
        s, ds, dds = self.speed_profile.evaluate(t)
        arc = self.arc_lengths
        k = min(max(bisect.bisect_right(arc, s) - 1, 0), _ARC_PIECE_COUNT - 1)
        u = (k + (s - arc[k]) / (arc[k + 1] - arc[k])) / _ARC_PIECE_COUNT
        p, q, r = self.coefficients
        # The table inverts s(u) linearly; a Newton step with the exact arc length makes it smooth.
        u -= (self._arc_length_at(k, u) - s) / _tangent_length(self.coefficients, u)
        tn, te, td = (_cubic_derivative(c, u) for c in (p, q, r))
        square = tn * tn + te * te + td * td
        tangent = math.sqrt(square)
        bn, be, bd = (6.0 * c[0] * u + 2.0 * c[1] for c in (p, q, r))
        along = (tn * bn + te * be + td * bd) / square
        n, e, d = (((c3 * u + c2) * u + c1) * u + c0 for c3, c2, c1, c0 in (p, q, r))
        velocity = (ds * tn / tangent, ds * te / tangent, ds * td / tangent)
        f, g = dds / tangent, ds * ds / square
        acceleration = (
            f * tn + g * (bn - along * tn),
            f * te + g * (be - along * te),
            f * td + g * (bd - along * td),
        )
        return (n, e, d), velocity, acceleration

    def _arc_length_at(self, k: int, u: float) -> float:
        start = k / _ARC_PIECE_COUNT
        return self.arc_lengths[k] + _arc_length(self.coefficients, start, 0.5 * (u - start))


def plan_stop(
    position: ArrayLike,
    velocity: ArrayLike,
    heading: float,
    acceleration: float,
    *,
    heading_rate: float = 0.0,
    yaw_acceleration: float = math.inf,
) -> BrakingMotion:
    """Plan braking from ``velocity`` (3,) at ``position`` (3,) with at most ``acceleration`` (m/s2).

    A ``heading_rate`` (rad/s) is reduced to zero with at most ``yaw_acceleration`` (rad/s2).
    """
    v = _to_triple(velocity)
    duration, _ = compute_stop_time_and_distance(vector_length(*v), acceleration)
    turn_s, _ = compute_stop_time_and_distance(heading_rate, yaw_acceleration)
    return BrakingMotion(_to_triple(position), v, heading, duration, heading_rate, turn_s)


def _cubic_derivative(c: _CubicCoefficients, u: float) -> float:
    return (3.0 * c[0] * u + 2.0 * c[1]) * u + c[2]


def _tangent_length(cubics: tuple[_CubicCoefficients, ...], u: float) -> float:
    """Return the length of a curve's tangent at parameter ``u``."""
    n, e, d = (_cubic_derivative(c, u) for c in cubics)
    return math.sqrt(n * n + e * e + d * d)


def _arc_length(cubics: tuple[_CubicCoefficients, ...], u: float, half: float) -> float:
    """Return the arc length from parameter ``u`` to ``u`` plus twice ``half``."""
    total = 0.0
    for node, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
        total += weight * _tangent_length(cubics, u + half * (1.0 + node))
    return half * total


def _evaluate_tangent_and_curvature_squares(
    cubics: tuple[_CubicCoefficients, ...], u: float
) -> tuple[float, tuple[float, float, float, float]]:
    """Return squares at parameter ``u``: of the tangent's length, the unit tangent's components, and the curvature.

    The components of the unit tangent are level, climbing and descending. Of climbing and descending, the one that does
    not apply is negative. These and the curvature's are zero where the tangent vanishes.
    """
    n, e, d = (_cubic_derivative(c, u) for c in cubics)
    square = n * n + e * e + d * d
    if square <= 1e-12:
        return square, (0.0, 0.0, 0.0, 0.0)
    qn, qe, qd = (6.0 * c[0] * u + 2.0 * c[1] for c in cubics)
    an, ae, ad = e * qd - d * qe, d * qn - n * qd, n * qe - e * qn
    sink = d * abs(d) / square
    bend = (an * an + ae * ae + ad * ad) / (square * square * square)
    return square, ((n * n + e * e) / square, -sink, sink, bend)


class PendingCurve(NamedTuple):
    """A curve with its limits of motion, whose arc length and curvature are to be computed later.

    On board the computation exceeds one period and is spread over the following ones (``trajectory.c``).
    """

    coefficients: tuple[_CubicCoefficients, ...]
    """A, B, C, D for each axis."""
    speed: float
    """Limits of horizontal speed, climb rate and descent rate (m/s)."""
    climb: float
    descent: float
    acceleration: float
    """Limit of the total acceleration (m/s2)."""

    def compute_timed_spline(self) -> TimedSpline | None:
        """Return the curve with its motion over time, from rest to rest within the limits.

        None if the curve has a point without tangent (a cusp or no length) or a bend that limits the speed to less
        than 5 cm/s; a straight line is then better.
        """
        cubics, arc = self.coefficients, [0.0]
        for k in range(_ARC_PIECE_COUNT):
            arc.append(arc[k] + _arc_length(cubics, k / _ARC_PIECE_COUNT, 0.5 / _ARC_PIECE_COUNT))
        least, (level, rise, sink, bend) = _find_extreme_tangent_and_curvature_squares(cubics)
        if math.sqrt(least) < 0.05 * max(arc[-1], _MIN_DENOMINATOR):
            return None
        share = self.acceleration / math.sqrt(2.0)
        peak = min(
            self.speed / max(math.sqrt(level), _MIN_DENOMINATOR),
            self.climb / max(math.sqrt(rise), _MIN_DENOMINATOR),
            self.descent / max(math.sqrt(sink), _MIN_DENOMINATOR),
            math.sqrt(share / max(math.sqrt(bend), _MIN_DENOMINATOR)),
        )
        if peak < _MIN_CURVE_SPEED_M_S:
            return None
        return TimedSpline(cubics, tuple(arc), make_motion_profile(arc[-1], peak, share))


# ----------------------------------------------------------------------------
# Trajectories: position, velocity and heading as functions of time.
#
# muFly reaches a waypoint in the simplest way (Sec. 6.2.2): first it adapts heading and height on the spot, then it
# flies a straight level line. The other kind is a cubic spline through the waypoints. Either is a `Trajectory` of two
# parts: on the spot (height and heading together) up to `path_start_s`, then the path. The caller holds the clock at
# `path_start_s` until the helicopter is there in fact: the thesis's "if the desired point is reached".
#
# Every part runs from rest to rest with continuous acceleration (`make_motion_profile`). A turn takes the shorter
# direction; the heading is continuous with the initial one (it may pass +-pi).


_MIN_DISTANCE_M = 1e-3
"""Distance below which a path has no direction (m)."""


class TrajectoryPoint(NamedTuple):
    """A trajectory at one instant: N-E-D in m, m/s and m/s2; heading in rad and rad/s."""

    position: Triple
    velocity: Triple
    acceleration: Triple
    heading: float
    heading_rate: float


@dataclass(frozen=True, slots=True)
class TrajectoryLimits:
    """Limits of a trajectory, SI units.

    Attributes
    ----------
    speed, climb, descent : float
        Horizontal speed, rate of climb and of descent (m/s).
    acceleration, climb_acceleration : float
        Horizontal and vertical acceleration (m/s2).
    yaw_rate, yaw_acceleration : float
        Yaw rate and acceleration (rad/s, rad/s2).
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
    """Trajectory of a leg: change of height and heading on the spot, then a line or a curve.

    Attributes
    ----------
    start, goal : (3,) tuples
        N, E, D (m).
    start_heading, turn_angle : float
        Heading at the start and the turn on the spot (rad).
    height_profile, yaw_profile, path_profile : MotionProfile
        Timing of the change of height, of the turn, and of the level line.
    path_start_s : float
        End of the part on the spot (s).
    duration_s : float
        End of the trajectory (s).
    spline_curve : TimedSpline or None
        Curve flown in place of the line.
    initial_braking : BrakingMotion or None
        Braking before the trajectory; `path_start_s` and `duration_s` include it.
    pending_curve : PendingCurve or None
        Curve that :meth:`finish_curve` computes; until then the trajectory is a line.

    Thesis: Fig. 6.17; Sec. 6.2.2.
    """

    start: Triple
    goal: Triple
    start_heading: float
    turn_angle: float
    height_profile: MotionProfile
    yaw_profile: MotionProfile
    path_profile: MotionProfile
    path_start_s: float
    duration_s: float
    spline_curve: TimedSpline | None = None
    initial_braking: BrakingMotion | None = None
    pending_curve: PendingCurve | None = None

    def finish_curve(self) -> Trajectory:
        """Return the trajectory with its pending curve computed, or with a straight line if no curve can be flown."""
        path = None if self.pending_curve is None else self.pending_curve.compute_timed_spline()
        if path is None:
            return replace(self, pending_curve=None)
        gate = self.yaw_profile.duration_s
        way = replace(
            self,
            height_profile=make_motion_profile(0.0, 1.0, 1.0),
            path_profile=path.speed_profile,
            path_start_s=gate,
            duration_s=gate + path.speed_profile.duration_s,
            spline_curve=path,
            initial_braking=None,
            pending_curve=None,
        )
        return way if self.initial_braking is None else way.add_initial_braking(self.initial_braking)

    def add_initial_braking(self, brake: BrakingMotion) -> Trajectory:
        """Return the trajectory with a preceding braking, which must end at its start."""
        t = brake.rest_time_s
        return replace(self, initial_braking=brake, path_start_s=self.path_start_s + t, duration_s=self.duration_s + t)

    def evaluate(self, t: float) -> TrajectoryPoint:
        """Return the point at time ``t`` (s) after the start; at rest before 0 and after `duration_s`."""
        gate = self.path_start_s
        if self.initial_braking is not None:
            if t < self.initial_braking.rest_time_s:
                return self.initial_braking.evaluate(t)
            t, gate = t - self.initial_braking.rest_time_s, gate - self.initial_braking.rest_time_s
        psi, rate = self.start_heading + self.turn_angle, 0.0
        if t < self.yaw_profile.duration_s:
            angle, rate, _ = self.yaw_profile.evaluate(t)
            sign = math.copysign(1.0, self.turn_angle)
            psi, rate = self.start_heading + sign * angle, sign * rate
        (n, e, d), (gn, ge, gd) = self.start, self.goal
        if self.spline_curve is not None:
            return TrajectoryPoint(*self.spline_curve.evaluate(t - gate), psi, rate)
        climbing = t < gate
        if climbing:
            z, w, a = self.height_profile.evaluate(t)
            sign = 1.0 if gd > d else -1.0
            return TrajectoryPoint((n, e, d + sign * z), (0.0, 0.0, sign * w), (0.0, 0.0, sign * a), psi, rate)
        if self.path_profile.distance == 0.0:
            return TrajectoryPoint(self.goal, _ZERO_VECTOR, _ZERO_VECTOR, psi, rate)
        s, v, a = self.path_profile.evaluate(t - gate)
        un, ue = (gn - n) / self.path_profile.distance, (ge - e) / self.path_profile.distance
        return TrajectoryPoint((n + s * un, e + s * ue, gd), (v * un, v * ue, 0.0), (a * un, a * ue, 0.0), psi, rate)


_ZERO_VECTOR = (0.0, 0.0, 0.0)


def wrap_turn(angle: float) -> float:
    """Return the equivalent turn in [-pi, pi] (rad)."""
    return float(wrap_angle(angle))


def _find_extreme_tangent_and_curvature_squares(cubics: tuple[_CubicCoefficients, ...]) -> tuple[float, list[float]]:
    """Return the least square of a curve's tangent length, and the greatest squares of direction and curvature.

    The squares are those of :func:`_evaluate_tangent_and_curvature_squares`. Each maximum is searched in equal steps,
    then by halving the step around the best point.
    """
    least, worst, where = math.inf, [0.0] * 4, [0.0] * 4
    for k in range(_ARC_PIECE_COUNT + 1):
        u = k / _ARC_PIECE_COUNT
        square, asks = _evaluate_tangent_and_curvature_squares(cubics, u)
        least = min(least, square)
        for j in range(4):
            if asks[j] > worst[j]:
                worst[j], where[j] = asks[j], u
    for j in range(4):
        step = 1.0 / _ARC_PIECE_COUNT
        for _ in range(_EXTREME_REFINEMENT_COUNT if worst[j] > 0.0 else 0):
            step, middle = 0.5 * step, where[j]
            for u in (middle - step, middle + step):
                square, asks = _evaluate_tangent_and_curvature_squares(cubics, u)
                if 0.0 <= u <= 1.0 and asks[j] > worst[j]:
                    least = min(least, square)
                    worst[j], where[j] = asks[j], u
    return least, worst


def plan_straight(
    start: ArrayLike,
    goal: ArrayLike,
    heading: float,
    limits: TrajectoryLimits,
    *,
    final_heading: float | None = None,
    nose_offset: float = 0.0,
) -> Trajectory:
    """Plan heading and height first, then a straight level line (Sec. 6.2.2, Fig. 6.17).

    Parameters
    ----------
    start, goal : (3,) arrays
        N, E, D (m).
    heading : float
        Heading at the start (rad, may exceed +-pi).
    limits : TrajectoryLimits
        Limits of the trajectory.
    final_heading : float, optional
        Heading in flight (rad, modulo 2 pi). The default is along the line; a line shorter than 1 mm has no direction
        and keeps the heading.
    nose_offset : float
        Added to the direction of the line if there is no ``final_heading`` (rad).
    """
    a, b = _to_triple(start), _to_triple(goal)
    way = vector_length(b[0] - a[0], b[1] - a[1])
    turn = _compute_turn_before_path(a, b, way, heading, final_heading, nose_offset)
    if way < _MIN_DISTANCE_M:
        way, b = 0.0, (a[0], a[1], b[2])
    fall = b[2] - a[2]
    rise = make_motion_profile(abs(fall), limits.descent if fall > 0.0 else limits.climb, limits.climb_acceleration)
    yaw = make_motion_profile(abs(turn), limits.yaw_rate, limits.yaw_acceleration)
    gate = max(rise.duration_s, yaw.duration_s)
    line = make_motion_profile(way, limits.speed, limits.acceleration)
    return Trajectory(a, b, heading, turn, rise, yaw, line, gate, gate + line.duration_s)


@dataclass(frozen=True, slots=True)
class BrakingMotion:
    """Braking to rest along the velocity's own direction: v(t) = v0 (1 - S(t / T)); likewise for the yaw rate."""

    start: Triple
    velocity: Triple
    heading: float
    duration_s: float
    heading_rate: float = 0.0
    turn_duration_s: float = 0.0

    @property
    def rest_time_s(self) -> float:
        """Time at which velocity and yaw rate are zero (s)."""
        return max(self.duration_s, self.turn_duration_s)

    def evaluate(self, t: float) -> TrajectoryPoint:
        """Return the point at time ``t`` (s) after the start; at rest after `rest_time_s`."""
        span = self.duration_s
        value, slope, way = smooth_step_down(t / span) if span > 0.0 else (0.0, 0.0, 0.0)
        (n, e, d), (u, v, w) = self.start, self.velocity
        s, a = way * span, slope / span if span > 0.0 else 0.0
        psi, rate = self.heading, 0.0
        if self.turn_duration_s > 0.0:
            slower, _, turned = smooth_step_down(t / self.turn_duration_s)
            psi, rate = psi + self.heading_rate * self.turn_duration_s * turned, self.heading_rate * slower
        return TrajectoryPoint(
            (n + u * s, e + v * s, d + w * s),
            (u * value, v * value, w * value),
            (u * a, v * a, w * a),
            psi,
            rate,
        )


def plan_pending_curve(
    start: ArrayLike,
    goal: ArrayLike,
    leaving: ArrayLike,
    arriving: ArrayLike,
    heading: float,
    limits: TrajectoryLimits,
    *,
    final_heading: float | None = None,
    nose_offset: float = 0.0,
) -> Trajectory:
    """Plan heading first, then a cubic spline (eqs 6.11 to 6.13), from rest to rest.

    Parameters
    ----------
    start, goal : (3,) arrays
        N, E, D (m).
    leaving, arriving : (3,) arrays
        Directions of the curve at its ends; their lengths do not matter.
    heading, limits, final_heading, nose_offset
        See `plan_straight`: the heading is that of the chord and does not follow the curve.

    Returns
    -------
    Trajectory
        Its curve is pending; :meth:`Trajectory.finish_curve` computes it, or makes the trajectory straight if no curve
        can be flown (no length, a cusp, too tight a bend).
    """
    plain = plan_straight(start, goal, heading, limits, final_heading=final_heading, nose_offset=nose_offset)
    a, b = np.array(plain.start), np.array(plain.goal)
    reach = vector_length(*(b - a).tolist())
    if reach < _MIN_DISTANCE_M:
        return plain
    ends = []
    for end in (leaving, arriving):
        u = np.asarray(end, dtype=np.float64)
        size = vector_length(*u.tolist())
        ends.append(u / size * reach if size > 1e-9 else b - a)
    # On a climbing or descending curve the total acceleration keeps the vertical limit.
    level = a[2] == b[2] and all(u[2] == 0.0 for u in ends)
    acceleration = limits.acceleration if level else min(limits.acceleration, limits.climb_acceleration)
    curve = make_spline(a, b, *ends).axis_cubics
    return replace(plain, pending_curve=PendingCurve(curve, limits.speed, limits.climb, limits.descent, acceleration))


def _to_triple(x: ArrayLike) -> Triple:
    n, e, d = np.asarray(x, dtype=np.float64).tolist()
    return n, e, d


def _compute_turn_before_path(
    a: Triple,
    b: Triple,
    way: float,
    heading: float,
    final_heading: float | None,
    nose_offset: float,
) -> float:
    if final_heading is not None:
        return wrap_turn(final_heading - heading)
    if way < _MIN_DISTANCE_M:
        return 0.0
    return wrap_turn(portable_atan2(b[1] - a[1], b[0] - a[0]) + nose_offset - heading)
