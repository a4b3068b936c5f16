"""Detour around an obstacle to the goal, from the points that the range beams have hit.

The repulsive field alone (`mufly.mission.avoidance`) stops in front of a box across the path: attraction and repulsion
balance there. So the helicopter follows the obstacle's contour, as Bug algorithms do (Lumelsky and Stepanov 1987;
Kamon, Rimon and Rivlin 1998):

- If a stored point is closer to the straight path than the clearance (c plus 5 cm), it chooses the side with fewer
  blocking points. If it is stuck or has strayed too far, it tries the other side, twice as far.
- It follows the contour. With n from the nearest stored point to the helicopter, t normal to n on the chosen side, and
  e = d - d_f the error from the following distance (c plus 15 cm), tan a = e / 0.4 m. The desired velocity is
  V (t cos a - n sin a).
- The repulsive field acts on the reference as in eqs 6.18 and 6.19, with the threshold at d_f, as a velocity k F.
- In all cases the approach to every stored point i is limited: -v.n_i <= lambda (d_i - c). So the distance falls no
  faster than exponentially towards c (a control barrier).
- It leaves the contour when it is nearer to the goal than where it met the obstacle and the next 1.5 m of the straight
  path are clear by c plus 8 cm. This progress guarantees arrival for Bug algorithms. The first two
  times on a leg it also leaves wherever the whole path to the goal is that clear. After a whole lap it leaves at the
  lap's nearest point to the goal.
- If the goal itself is too near to a stored point, it keeps its distance and waits. After a stated time it gives up.

The reference is a point whose velocity follows the desired one with limited acceleration and jerk, in the horizontal
plane; the height is held. Own derivation.

The same code runs on board in C (``avoidance.c`` of :mod:`mufly.firmware`), equal to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mufly.compiled.portable_math import exp_decay, sine_cosine
from mufly.mission.avoidance import (
    BLOCKED_PATH_MARGIN_M,
    PATH_LOOK_AHEAD_M,
    BeamRing,
    PathCheck,
    limit_approach_velocity,
    repulsive_force,
)

DETOUR_ACCELERATION_M_S2 = 1.0
"""Largest acceleration of a detour (m/s2): a tilt of 6 degrees."""

CLEAR_PATH_MARGIN_M, FOLLOW_CONTOUR_MARGIN_M, APPROACH_BARRIER_MARGIN_M = 0.08, 0.15, 0.06
"""Margins beyond the clearance (m): of a clear path, of the followed contour, and of the approach barrier.

They cover the 5 cm between stored points and the lag of the position loop."""

_REPULSION_GAIN = 0.15
"""k of eqs 6.18 and 6.19, as a velocity: m/s per 1/m."""

_CONTOUR_CONVERGENCE_DISTANCE_M = 0.4
_VELOCITY_LAG_S = 0.2
_ACCELERATION_LAG_S = 0.08
_SIDE_CHANGE_DEVIATION_M = 3.0
_STUCK_TIME_S = 5.0
_ON_CONTOUR_MARGIN_M = 0.15


@dataclass(frozen=True, slots=True)
class Detour:
    """State of a detour around an obstacle.

    Attributes
    ----------
    position, velocity, acceleration : (3,) tuples
        The reference, N-E-D (m, m/s, m/s2).
    passing_side : float
        +1 keeps the obstacle on the left (passes to its right), -1 on the right.
    hit_point : (2,) tuple
        N, E where the obstacle was met (m).
    hit_goal_distance : float
        Distance from there to the goal (m).
    obstacle_count : int
        Number of obstacles met on this leg.
    side_change_deviation_m : float
        Distance from the line between ``hit_point`` and the goal at which the other side is tried (m).
    path_clear_duration_s, stuck_duration_s : float
        Time for which the path has been clear; time within 0.25 m of ``stuck_check_point`` (2,) (s).
    lap_start_point : (2,) tuple or None
        N, E where the contour was reached (m).
    lap_count : int
        Whole laps around the obstacle.
    lap_distance_m, lap_min_goal_distance_m : float
        Distance flown since ``lap_start_point``, and the least distance to the goal on it (m).
    is_leaving_contour : bool
        Whether the reference brakes, to continue straight from where it stops.
    obstacle_point : (2,) tuple
        N, E of the last nearest point (m), for messages.
    """

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    passing_side: float
    hit_point: tuple[float, float]
    hit_goal_distance: float
    obstacle_count: int = 1
    side_change_deviation_m: float = _SIDE_CHANGE_DEVIATION_M
    path_clear_duration_s: float = 0.0
    stuck_check_point: tuple[float, float] = (0.0, 0.0)
    stuck_duration_s: float = 0.0
    lap_start_point: tuple[float, float] | None = None
    lap_count: int = 0
    lap_distance_m: float = 0.0
    lap_min_goal_distance_m: float = math.inf
    is_leaving_contour: bool = False
    obstacle_point: tuple[float, float] = (math.nan, math.nan)

    @property
    def is_finished(self) -> bool:
        """Whether the obstacle is avoided and the reference has come to rest."""
        return (
            self.is_leaving_contour and _vector_norm(*self.velocity) < 0.01 and _vector_norm(*self.acceleration) < 0.05
        )


def _vector_norm(x: float, y: float, z: float = 0.0) -> float:
    return math.sqrt(x * x + y * y + z * z)


def _planar_distance(a: Sequence[float], b: Sequence[float]) -> float:
    return _vector_norm(a[0] - b[0], a[1] - b[1])


def begin_detour(
    position: tuple[float, float, float],
    velocity: tuple[float, float, float],
    acceleration: tuple[float, float, float],
    goal: tuple[float, float, float],
    sight: PathCheck,
    before: Detour | None,
) -> Detour:
    """Return a detour that starts from the present reference; ``before`` is the leg's previous detour, or None."""
    here = (position[0], position[1])
    far = _planar_distance(goal, here)
    side = -1.0 if sight.mean_blocking_offset > 0.0 else 1.0
    count, stray = 1, _SIDE_CHANGE_DEVIATION_M
    if before is not None:
        count, stray = before.obstacle_count + 1, before.side_change_deviation_m
        if _planar_distance(here, before.position) < 1.5:
            side = before.passing_side
    return Detour(
        position,
        velocity,
        acceleration,
        side,
        here,
        far,
        obstacle_count=count,
        side_change_deviation_m=stray,
        stuck_check_point=here,
    )


def follow_contour(
    detour: Detour,
    sight: PathCheck,
    beams: BeamRing,
    position: tuple[float, ...],
    heading: float,
    ranges: list[float],
    goal: tuple[float, float, float],
    *,
    clearance: float,
    speed: float,
    dt: float,
) -> Detour:
    """Move the detour's reference by one time step along the contour of the obstacle.

    Parameters
    ----------
    detour : Detour
        State before the step.
    sight : PathCheck
        Check of the whole path from the reference to the goal since the last step.
    beams : BeamRing
        The range ring.
    position : (3,) tuple
        Measured N-E-D (m).
    heading : float
        Measured heading (rad).
    ranges : list of n floats
        Measured ranges (m).
    goal : (3,) tuple
        Goal of the helicopter, N-E-D (m).
    clearance, speed : float
        Distance to keep (m) and speed to fly at (m/s).
    dt : float
        Time step (s).

    Thesis: eqs 6.18, 6.19; Sec. 6.2.3.
    """
    reference = detour.position
    planned, real = sight.find_nearest_point_distance(reference), sight.find_nearest_point_distance(position)
    # Plan from the reference or from the helicopter, which wind may displace, whichever is nearer to an obstacle.
    at = position if real[0] < planned[0] else reference
    distance, north, east = real if real[0] < planned[0] else planned
    to_goal = _planar_distance(goal, reference)

    nearer_goal = to_goal < detour.hit_goal_distance - 0.1
    wide = (clearance + CLEAR_PATH_MARGIN_M) * (clearance + CLEAR_PATH_MARGIN_M)
    onward = nearer_goal and sight.path_start_clearance_sq > wide
    clear = real[0] > clearance and (onward or (detour.obstacle_count < 3 and sight.path_clearance_sq > wide))
    clear_s = detour.path_clear_duration_s + dt if clear else 0.0
    leaving = clear_s > 0.3

    follow = clearance + FOLLOW_CONTOUR_MARGIN_M
    touching = distance < follow + _ON_CONTOUR_MARGIN_M
    goal_blocked = (
        sight.goal_clearance_sq < (clearance + BLOCKED_PATH_MARGIN_M) * (clearance + BLOCKED_PATH_MARGIN_M)
        and to_goal < 1.0
    )
    here = (reference[0], reference[1])
    if not leaving and not goal_blocked:
        detour = _choose_passing_side(detour, here, goal, to_goal, touching, dt)
    side = detour.passing_side

    vn = ve = 0.0
    if leaving:
        pass
    elif goal_blocked:
        push = min(speed, max(0.0, follow - distance))
        vn, ve = push * north, push * east
    elif distance < PATH_LOOK_AHEAD_M + 0.5:
        far, n, e = distance, north, east
        # Off any contour, or at a wrong contour's nearest point to the goal: head for the blocking point.
        block = sight.find_nearest_blocking_distance(at)
        lost = detour.lap_count > 0 and nearer_goal and block[0] > follow + 0.05
        if (lost or not touching) and block[0] < math.inf:
            far, n, e = block
        error = far - follow
        slant = _vector_norm(error, _CONTOUR_CONVERGENCE_DISTANCE_M)
        along, inward = _CONTOUR_CONVERGENCE_DISTANCE_M / slant, error / slant  # cos a, sin a
        # Facing the obstacle, along -n, the right-hand direction is (n_E, -n_N).
        vn = speed * (along * side * e - inward * n)
        ve = speed * (-along * side * n - inward * e)
    elif to_goal > 1e-6:
        pace = min(speed, 0.5 * to_goal)
        vn, ve = pace * (goal[0] - reference[0]) / to_goal, pace * (goal[1] - reference[1]) / to_goal

    fx, fy = repulsive_force(ranges, beams, follow)
    if fx != 0.0 or fy != 0.0:
        s, c = sine_cosine(heading)
        vn += _REPULSION_GAIN * (c * fx - s * fy)
        ve += _REPULSION_GAIN * (s * fx + c * fy)
    vn, ve = limit_approach_velocity(sight, at, (vn, ve), clearance + APPROACH_BARRIER_MARGIN_M)
    fast = _vector_norm(vn, ve)
    limit = speed * max(0.0, 1.0 - max(0.0, _planar_distance(here, position) - 0.15) / 0.15)
    if fast > limit:
        vn, ve = vn * limit / fast, ve * limit / fast

    obstacle = detour.obstacle_point
    if distance < 2.0:
        obstacle = (at[0] - distance * north, at[1] - distance * east)
    moved = _step_detour_reference(detour, (vn, ve, 0.0), dt)
    return replace(moved, path_clear_duration_s=clear_s, is_leaving_contour=leaving, obstacle_point=obstacle)


def _choose_passing_side(
    detour: Detour,
    here: tuple[float, float],
    goal: tuple[float, float, float],
    to_goal: float,
    touching: bool,
    dt: float,
) -> Detour:
    """Return the detour with the side on which to pass the obstacle.

    The side changes if the vehicle is stuck, or too far from the line between the point that it met first and the goal.

    After a whole lap the contour is left where it was nearest to the goal.
    """
    side, stray, hit_distance = detour.passing_side, detour.side_change_deviation_m, detour.hit_goal_distance
    anchor, anchor_s = detour.stuck_check_point, detour.stuck_duration_s + dt
    if _planar_distance(here, anchor) > 0.25:
        anchor, anchor_s = here, 0.0
    elif anchor_s > _STUCK_TIME_S:
        side, anchor_s = -side, 0.0
    if _distance_from_line(here, detour.hit_point, goal) > stray:
        side, stray = -side, 2.0 * stray
    lap, laps, lap_way, best = (
        detour.lap_start_point,
        detour.lap_count,
        detour.lap_distance_m,
        min(detour.lap_min_goal_distance_m, to_goal),
    )
    lap_way += _vector_norm(*detour.velocity) * dt
    if lap is None or side != detour.passing_side:
        lap, lap_way, best = (here if touching else None), 0.0, to_goal
    elif lap_way > 1.5 and _planar_distance(here, lap) < 0.3:
        hit_distance, laps, lap_way, best = best + 0.25, laps + 1, 0.0, to_goal
    return replace(
        detour,
        passing_side=side,
        side_change_deviation_m=stray,
        hit_goal_distance=hit_distance,
        stuck_check_point=anchor,
        stuck_duration_s=anchor_s,
        lap_start_point=lap,
        lap_count=laps,
        lap_distance_m=lap_way,
        lap_min_goal_distance_m=best,
    )


def _distance_from_line(
    here: tuple[float, float], start: tuple[float, float], goal: tuple[float, float, float]
) -> float:
    """Return the distance of a point from a line segment (m), in the horizontal plane."""
    n, e = goal[0] - start[0], goal[1] - start[1]
    square = n * n + e * e
    share = ((here[0] - start[0]) * n + (here[1] - start[1]) * e) / square if square > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return _vector_norm(here[0] - start[0] - share * n, here[1] - start[1] - share * e)


def _step_detour_reference(detour: Detour, wanted: tuple[float, float, float], dt: float) -> Detour:
    """Step the reference: its velocity follows ``wanted``, with limited, low-pass filtered acceleration."""
    ask = [(w - v) / _VELOCITY_LAG_S for w, v in zip(wanted, detour.velocity, strict=True)]
    size = _vector_norm(*ask)
    scale = min(1.0, DETOUR_ACCELERATION_M_S2 / size) if size > 0.0 else 0.0
    blend = 1.0 - exp_decay(dt / _ACCELERATION_LAG_S)
    (n, e, d), (vn, ve, vd), (an, ae, ad) = detour.position, detour.velocity, detour.acceleration
    an, ae, ad = (
        an + blend * (scale * ask[0] - an),
        ae + blend * (scale * ask[1] - ae),
        ad + blend * (scale * ask[2] - ad),
    )
    vn, ve, vd = vn + dt * an, ve + dt * ae, vd + dt * ad
    return replace(
        detour,
        position=(n + dt * vn, e + dt * ve, d + dt * vd),
        velocity=(vn, ve, vd),
        acceleration=(an, ae, ad),
    )
