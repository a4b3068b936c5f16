"""Conversion of set-points streamed by a program, or of a pilot's sticks, to what the helicopter can follow.

Fig. 6.15 has no such state: there the user gives waypoints, and the helicopter plans the trajectory. In offboard mode a
program plans it and sends positions, velocities, or both, at ten or more messages a second. The reference must not
jump with them. So it is a point with a velocity v that follows the desired velocity w, with at most the acceleration a:

    w = v_given + s(g) g / |g|,     v' = clip(2 b (w - v), a),     x' = v.

g is the gap to the given position (zero on an axis without one) and s the speed from which half of a brakes in time.
Near the goal s is linear, so that the reference settles like a critically damped second-order lag of bandwidth b:

    s(g) = k g                             for g < g0 = (a / 2) / k^2,   k = b / 2
    s(g) = sqrt(2 (a / 2) (g - g0 / 2))    beyond.

w is limited in length to the maximum speed. v moves along a straight line towards w, never past it, so v stays within
any limit that w keeps (a disc is convex). The same holds for height, between its own limits, and for the heading. At
both ends of the permitted height s() of the distance limits the speed towards it. If the helicopter trails its
reference by more than half a metre, the reference waits. Own derivation.

A pilot's sticks are limited near the floor. Below `_STICK_LIMIT_HEIGHT_M` their tilt shrinks with height, and the level
speed has a limit that grows with height: the tilt along the motion is at most what brings the speed to that limit
within `_BRAKING_TIME_S`. The descent rate shrinks to that of a touchdown; above the speed limit it is 5 cm/s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from mufly.compiled.portable_math import exp_decay, sine_cosine, vector_length
from mufly.mission.files.mission_schema import MIN_WAYPOINT_HEIGHT_M
from mufly.mission.trajectory import TrajectoryLimits, TrajectoryPoint, Triple, wrap_turn
from mufly.quantities.units import GRAVITY

MAX_HEIGHT_M = 50.0
"""Greatest height of a reference above the floor (m)."""

TRACKER_BANDWIDTH_RAD_S = 3.0
"""b (rad/s): half the position loop's bandwidth, so that the loop does not lag at the end of braking."""

_MAX_TIME_STEP_S = 0.02
_SLOWING_TRACKING_ERROR_M = 0.5
_ACCELERATION_LAG_S = 0.08
_MAX_POSITION_M, _MAX_SPEED_M_S, _MAX_YAW_RATE_RAD_S = 1e4, 50.0, 50.0

_NAN_VECTOR = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class SetPoint:
    """Set-point of a program; NaN on an axis, or None, means that the axis is not commanded.

    Attributes
    ----------
    position_m, velocity_m_s : (3,) tuple or None
        N, E, D. With both on one axis the velocity is that of the moving position. A free axis comes to rest.
    heading_rad, yaw_rate_rad_s : float or None
        Heading from north to east, and its rate; likewise.
    """

    position_m: Triple | None = None
    velocity_m_s: Triple | None = None
    heading_rad: float | None = None
    yaw_rate_rad_s: float | None = None


def describe_set_point_fault(s: SetPoint) -> str:
    """Return the fault of a set-point as a text; "" if there is none."""
    position, velocity = s.position_m or _NAN_VECTOR, s.velocity_m_s or _NAN_VECTOR
    if len(position) != 3 or len(velocity) != 3:
        return "position and velocity need three numbers each, N, E, D"
    turn = (
        math.nan if s.heading_rad is None else float(s.heading_rad),
        math.nan if s.yaw_rate_rad_s is None else float(s.yaw_rate_rad_s),
    )
    if all(math.isnan(v) for v in (*position, *velocity, *turn)):
        return "the set-point is empty; give a position, a velocity, a heading or a rate of turn"
    for name, values, most in (
        ("position", position, _MAX_POSITION_M),
        ("velocity", velocity, _MAX_SPEED_M_S),
        ("heading", turn[:1], _MAX_POSITION_M),
        ("rate of turn", turn[1:], _MAX_YAW_RATE_RAD_S),
    ):
        for v in values:
            if abs(v) > most:
                return f"a {name} of {v:g} is beyond {most:g}"
    return ""


def needs_lift_off(s: SetPoint, standing: Triple) -> bool:
    """Return whether a helicopter at rest at ``standing`` (N, E, D; m) must lift off for a set-point."""
    higher = s.position_m is not None and s.position_m[2] < min(standing[2] - 0.1, -MIN_WAYPOINT_HEIGHT_M + 1e-9)
    return higher or (s.velocity_m_s is not None and s.velocity_m_s[2] < -0.01)


def _zero_if_nan(x: float) -> float:
    return 0.0 if math.isnan(x) else x


def _distance_to_target(target: float, at: float) -> float:
    return 0.0 if math.isnan(target) else target - at


def _approach_speed(gap: float, acceleration: float) -> float:
    """Return the speed from which half the acceleration suffices to stop within the distance ``gap`` (m)."""
    half, slope = 0.5 * acceleration, 0.5 * TRACKER_BANDWIDTH_RAD_S
    linear = half / (slope * slope)
    return slope * gap if gap < linear else math.sqrt(2.0 * half * (gap - 0.5 * linear))


def _max_velocity_towards_bound(gap: float, limits: TrajectoryLimits) -> float:
    """Return the limit of the vertical velocity (m/s, down) near a height bound that lies ``gap`` metres below."""
    return math.copysign(_approach_speed(abs(gap), limits.climb_acceleration), gap)


def _step_set_point_reference(
    t: TrajectoryPoint,
    wanted: SetPoint,
    limits: TrajectoryLimits,
    measured: tuple[float, ...],
    dt: float,
    hold_off: Callable[[float, float], tuple[float, float]] | None,
) -> TrajectoryPoint:
    target, given = wanted.position_m or _NAN_VECTOR, wanted.velocity_m_s or _NAN_VECTOR
    (n, e, d), (vn, ve, vd) = t.position, t.velocity
    trails = vector_length(n - measured[0], e - measured[1], d - measured[2])
    share = min(1.0, max(0.0, 2.0 - trails / _SLOWING_TRACKING_ERROR_M))

    gn, ge = _distance_to_target(target[0], n), _distance_to_target(target[1], e)
    gap = vector_length(gn, ge)
    pace = min(_approach_speed(gap, limits.acceleration), limits.speed) / gap if gap > 0.0 else 0.0
    wn, we = _zero_if_nan(given[0]) + pace * gn, _zero_if_nan(given[1]) + pace * ge
    if hold_off is not None:
        wn, we = hold_off(wn, we)
    fast = vector_length(wn, we)
    slow = share * (limits.speed / fast if fast > limits.speed else 1.0)
    an, ae = _limited_acceleration(slow * wn - vn, slow * we - ve, limits.acceleration, dt)

    # The height limit comes first: if both are violated (a wild estimate), descending is the lesser risk.
    goal = min(max(target[2], -MAX_HEIGHT_M), -MIN_WAYPOINT_HEIGHT_M)
    gd = _distance_to_target(goal, d) if not math.isnan(target[2]) else 0.0
    wd = _zero_if_nan(given[2]) + math.copysign(_approach_speed(abs(gd), limits.climb_acceleration), gd)
    wd = min(max(wd, -limits.climb), limits.descent)
    wd = min(
        max(wd, _max_velocity_towards_bound(-MAX_HEIGHT_M - d, limits)),
        _max_velocity_towards_bound(-MIN_WAYPOINT_HEIGHT_M - d, limits),
    )
    ad, _ = _limited_acceleration(share * wd - vd, 0.0, limits.climb_acceleration, dt)

    heading = wanted.heading_rad
    turn = 0.0 if heading is None or math.isnan(heading) else wrap_turn(heading - t.heading)
    rate = _zero_if_nan(math.nan if wanted.yaw_rate_rad_s is None else wanted.yaw_rate_rad_s)
    rate += math.copysign(_approach_speed(abs(turn), limits.yaw_acceleration), turn)
    rate = min(max(rate, -limits.yaw_rate), limits.yaw_rate)
    yaw, _ = _limited_acceleration(rate - t.heading_rate, 0.0, limits.yaw_acceleration, dt)

    blend = 1.0 - exp_decay(dt / _ACCELERATION_LAG_S)
    sn, se, sd = (s + blend * (a - s) for s, a in zip(t.acceleration, (an, ae, ad), strict=True))
    vn, ve, vd, psi_rate = vn + dt * an, ve + dt * ae, vd + dt * ad, t.heading_rate + dt * yaw
    return TrajectoryPoint(
        (n + dt * vn, e + dt * ve, d + dt * vd),
        (vn, ve, vd),
        (sn, se, sd),
        t.heading + dt * psi_rate,
        psi_rate,
    )


def follow_set_point(
    tracker: TrajectoryPoint,
    wanted: SetPoint,
    limits: TrajectoryLimits,
    measured: tuple[float, ...],
    dt: float,
    hold_off: Callable[[float, float], tuple[float, float]] | None = None,
) -> TrajectoryPoint:
    """Return the reference one time step later, moved towards the set-point.

    Parameters
    ----------
    tracker : TrajectoryPoint
        Previous reference; its acceleration is smoothed, for feedforward.
    wanted : SetPoint
        Set-point without fault.
    limits : TrajectoryLimits
        Limits of the reference.
    measured : (3,) tuple
        Position of the helicopter, N, E, D (m).
    dt : float
        Time step (s); long steps are divided.
    hold_off : callable, optional
        Changes a desired velocity N, E (m/s) to one that avoids obstacles.
    """
    parts = max(1, math.ceil(dt / _MAX_TIME_STEP_S - 1e-9))
    for _ in range(parts if dt > 0.0 else 0):
        tracker = _step_set_point_reference(tracker, wanted, limits, measured, dt / parts, hold_off)
    return tracker


def _limited_acceleration(dx: float, dy: float, most: float, dt: float) -> tuple[float, float]:
    """Return the acceleration towards a change of velocity (dx, dy), at most ``most`` and without overshoot."""
    gain = min(2.0 * TRACKER_BANDWIDTH_RAD_S, 1.0 / dt)
    size = gain * vector_length(dx, dy)
    scale = gain * (most / size if size > most else 1.0)
    return scale * dx, scale * dy


# ----------------------------------------------------------------------------
# A pilot's sticks near the floor.


DRIFTING_DESCENT_RATE_M_S = 0.05
"""Descent rate near the floor at a level speed that is too high for a touchdown (m/s)."""

_STICK_LIMIT_HEIGHT_M = 1.0
_FULL_TILT_HEIGHT_M, _MIN_TILT_FRACTION = 0.3, 0.2
_MAX_HORIZONTAL_SPEED_AT_FLOOR_M_S, _MAX_HORIZONTAL_SPEED_SLOPE_1_S = (
    0.3,
    1.2,
)  # speed limit on the floor (m/s), and its rise with height (1/s)
_BRAKING_TIME_S, _MAX_BRAKING_TILT_RAD = 0.5, 0.09  # s, rad
_FLARE_TIME_S = 1.0  # height over the permitted descent rate beyond that of a touchdown (s)


def _max_horizontal_speed_near_floor(height: float) -> float:
    return _MAX_HORIZONTAL_SPEED_AT_FLOOR_M_S + _MAX_HORIZONTAL_SPEED_SLOPE_1_S * max(0.0, height)


def limit_manual_tilt(
    height: float, velocity: tuple[float, float], yaw: float, tilt: tuple[float, float]
) -> tuple[float, float]:
    """Return the pilot's roll and pitch (rad), limited near the floor.

    Parameters
    ----------
    height : float
        Height above the standing position (m).
    velocity : (2,) tuple
        Velocity N, E (m/s).
    yaw : float
        Heading (rad).
    tilt : (2,) tuple
        Roll, pitch of the sticks (rad).
    """
    roll, pitch = tilt
    if not height < _STICK_LIMIT_HEIGHT_M:
        return roll, pitch
    share = min(max(height / _FULL_TILT_HEIGHT_M, _MIN_TILT_FRACTION), 1.0)
    roll, pitch = share * roll, share * pitch
    vn, ve = velocity
    speed = vector_length(vn, ve)
    if not speed > 0.0:
        return roll, pitch
    sine, cosine = sine_cosine(yaw)
    ahead, right = (cosine * vn + sine * ve) / speed, (cosine * ve - sine * vn) / speed
    along = right * roll - ahead * pitch
    most = max((_max_horizontal_speed_near_floor(height) - speed) / (GRAVITY * _BRAKING_TIME_S), -_MAX_BRAKING_TILT_RAD)
    if along > most:
        roll, pitch = roll + (most - along) * right, pitch - (most - along) * ahead
    return roll, pitch


def limit_manual_climb(height: float, velocity: tuple[float, float], touchdown: float, climb: float) -> float:
    """Return the climb rate (m/s, positive up) that the pilot commands; near the floor the descent is limited.

    Parameters
    ----------
    height, velocity
        See `limit_manual_tilt`.
    touchdown : float
        Descent rate on the floor (m/s).
    climb : float
        Climb rate of the sticks (m/s).
    """
    if height < _STICK_LIMIT_HEIGHT_M and vector_length(*velocity) > _max_horizontal_speed_near_floor(height):
        return max(climb, -DRIFTING_DESCENT_RATE_M_S)
    return max(climb, -(touchdown + max(0.0, height) / _FLARE_TIME_S))
