"""Obstacle detection with eight range beams: the repulsive field, and a map of points that beams have hit.

The repulsive field of Sec. 6.2.3, with l_i the range of beam i and l_t a threshold:

    f_i = 1/l_i - 1/l_t  if l_i < l_t,  else 0                          (6.14)
    alpha_i = i pi/4 + 9 pi/8                                           (6.15)
    F = sum_i f_i (cos alpha_i, sin alpha_i)                            (6.16, 6.17)

In Fig. 6.18 beam 0 looks forward and to the right, at pi/8 from x towards y, and the beams are numbered clockwise
from above. Then alpha_i of eq. 6.15 is the direction of beam i plus pi: the direction of the force, away from the
obstacle, and F needs no minus sign. Here the vehicle gives the beam directions, and each force is opposite to its
beam, for any numbering of the ring.

Beams 45 degrees apart leave gaps, and the field ignores obstacles that no beam hits at present. So hit points are
stored: the end x + l R u of a beam of range l and body direction u, with R the attitude. A hit closer than 5 cm to a
stored point confirms that point. A point without confirmation for 30 s is removed: the obstacle has gone or is far
behind. (A beam that passes a point disproves nothing: it may graze the edge of a thin post.) Points just above the
floor count as floor. Own derivation.

Checking all points and beams in one period is too much work for a small processor. So the work is spread over the
periods between two mission steps (:func:`check_map_part`): an eighth of the beams, and a share of the points each
time. A :class:`PathCheck` keeps the points that matter: those on the path, and the nearest point in each of sixteen
directions. The next step uses it, with distances from the position at that time.

The same code runs on board in C (``avoidance.c`` of :mod:`mufly.firmware`), equal to the last bit: sums keep their
order, and lengths are square roots of sums.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import sine_cosine

_Array = NDArray[np.float64]

MAP_CAPACITY = 160
"""Capacity of the map; points 5 cm apart cover 8 m of contour."""

POINT_LIFETIME_S = 30.0
"""Time after which a point is removed without a new hit (s)."""

_LAST_HIT_TIME_COLUMN = 3
"""Column of the time of the last hit, after N, E, D."""
_POINT_MERGE_DISTANCE_M = 0.05
_REPLACE_CANDIDATE_COUNT = 8
_FLOOR_POINT_HEIGHT_M = 0.12
_POINT_MERGE_HEIGHT_M = 0.15


@dataclass(frozen=True, slots=True)
class BeamRing:
    """Range beams around the body, all in its x-y plane.

    Attributes
    ----------
    cos, sin : (n,) arrays
        Direction of each beam, from x towards y.
    max_range : float
        Range of a beam that hits nothing (m).
    """

    cos: _Array
    sin: _Array
    max_range: float

    @property
    def first_angle(self) -> float:
        """Direction of beam 0 (rad, from x towards y)."""
        return math.atan2(self.sin[0], self.cos[0])

    @property
    def spacing(self) -> float:
        """Angle between neighbouring beams (rad)."""
        return math.tau / len(self.cos)


def make_beam_ring(count: int, first_angle: float, max_range: float) -> BeamRing:
    """Return a ring of ``count`` beams, evenly spaced from ``first_angle`` (rad, from x towards y)."""
    angles = first_angle + math.tau / count * np.arange(count)
    return BeamRing(np.cos(angles), np.sin(angles), max_range)


def insert_beam_hits(
    memory: ObstacleMap,
    beams: BeamRing,
    time_s: float,
    position: _Array,
    attitude: _Array,
    ranges: _Array,
    first: int = 0,
    count: int | None = None,
) -> ObstacleMap:
    """Add the beams' present hits to the map.

    Parameters
    ----------
    memory : ObstacleMap
        Map before the hits.
    beams : BeamRing
        The range ring.
    time_s : float
        Present time (s).
    position, attitude : (3,) arrays
        N-E-D (m) and roll, pitch, yaw (rad).
    ranges : (n,) array
        Measured ranges (m).
    first, count : int
        First beam and number of beams to add, in cyclic order. All by default.
    """
    known = _insert_hit_points(
        memory.points,
        memory.point_count,
        memory.next_replaced_row,
        time_s,
        position,
        attitude,
        ranges,
        beams.cos,
        beams.sin,
        beams.max_range,
        first,
        len(beams.cos) if count is None else count,
    )
    return ObstacleMap(*known)


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """Points that beams have hit: the first ``point_count`` rows hold N, E, D (m) and the time of the last hit (s).

    In a full map a new point replaces the oldest of eight points, which begin at row ``next_replaced_row``.
    """

    points: _Array
    point_count: int = 0
    next_replaced_row: int = 0

    @staticmethod
    def make_empty_map() -> ObstacleMap:
        """Return an obstacle map without points."""
        return ObstacleMap(np.zeros((MAP_CAPACITY, 4)))


@cached_njit
def _planar_length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


@cached_njit
def _insert_hit_points(
    old: _Array,
    used: int,
    turn: int,
    time: float,
    x: _Array,
    attitude: _Array,
    ranges: _Array,
    cos: _Array,
    sin: _Array,
    max_range: float,
    first: int,
    count: int,
) -> tuple[_Array, int, int]:
    points = old.copy()
    sr, cr = sine_cosine(attitude[0])
    sp, cp = sine_cosine(attitude[1])
    sy, cy = sine_cosine(attitude[2])
    for beam in range(first, first + count):
        i = beam if beam < ranges.shape[0] else beam - ranges.shape[0]
        reach = ranges[i]
        if reach >= max_range or not reach > 0.0:
            continue
        # Body x and y in N-E-D are the first two columns of the rotation matrix (yaw, pitch, roll).
        n = x[0] + reach * (cos[i] * cp * cy + sin[i] * (sr * sp * cy - cr * sy))
        e = x[1] + reach * (cos[i] * cp * sy + sin[i] * (sr * sp * sy + cr * cy))
        d = x[2] + reach * (-cos[i] * sp + sin[i] * sr * cp)
        if d > -_FLOOR_POINT_HEIGHT_M:
            continue
        known = False
        for k in range(used):
            dn, de = points[k, 0] - n, points[k, 1] - e
            if (
                dn * dn + de * de < _POINT_MERGE_DISTANCE_M * _POINT_MERGE_DISTANCE_M
                and abs(points[k, 2] - d) < _POINT_MERGE_HEIGHT_M
            ):
                points[k, _LAST_HIT_TIME_COLUMN] = time
                known = True
        if not known:
            row = 0
            if used < MAP_CAPACITY:
                row = used
                used += 1
            else:
                row = turn
                for k in range(turn, turn + _REPLACE_CANDIDATE_COUNT):
                    if points[k, _LAST_HIT_TIME_COLUMN] < points[row, _LAST_HIT_TIME_COLUMN]:
                        row = k
                turn = turn + _REPLACE_CANDIDATE_COUNT if turn + _REPLACE_CANDIDATE_COUNT < MAP_CAPACITY else 0
            points[row, 0], points[row, 1], points[row, 2], points[row, _LAST_HIT_TIME_COLUMN] = n, e, d, time
    return points, used, turn


@cached_njit
def _distance_outside_interval(along: float, stretch: float) -> float:
    """Return the signed distance of ``along`` from the interval [0, ``stretch``]; 0 inside the interval."""
    if along < 0.0:
        return along
    return along - stretch if along > stretch else 0.0


# ----------------------------------------------------------------------------
# Evaluation of stored points for a path: distance, blocking, permitted approach speed.


PATH_LOOK_AHEAD_M = 1.2
"""Distance along the path within which obstacles count (m)."""

_CLEAR_PATH_TO_LEAVE_M = PATH_LOOK_AHEAD_M + 0.3
"""Length of clear path required to leave a contour (m)."""

BLOCKED_PATH_MARGIN_M = 0.05
"""A path is blocked by points closer than the clearance plus this margin (m)."""

_APPROACH_SPEED_PER_DISTANCE_1_S = 0.8
"""lambda (1/s): slow enough for the position loop's lag of 0.3 s."""

_MAX_HEIGHT_DIFFERENCE_M = 0.5


_NEAREST_POINT_RANGE_M = 2.0
SECTOR_COUNT = 16
_SECTOR_BOUNDARY_SLOPE = math.sqrt(2.0) - 1.0  # tan(pi / 8)


class PathCheck(NamedTuple):
    """Result of the check of a path against the obstacle map, complete when all parts of the map are checked.

    Attributes
    ----------
    from_north, from_east, from_down : float
        Start of the path (m).
    goal_north, goal_east, look_ahead_m : float
        Goal, and length of path that is checked (m).
    checked_point_count : int
        Number of points checked so far.
    path_clearance_sq : float
        Square of the least distance of any point from the checked path (m2); may be infinite if beyond twice the
        blocking distance.
    path_start_clearance_sq : float
        Likewise for the first 1.5 m of the path.
    goal_clearance_sq : float
        Square of the least distance of any point from the goal (m2).
    lateral_offset_sum : float
        Sum of the lateral offsets of blocking points from the path, positive to the right (m).
    blocking_point_count : int
        Number of blocking points.
    nearest_blocking_distance_sq, nearest_blocking_north, nearest_blocking_east : float
        Nearest blocking point: square of its distance (m2), position (m).
    nearest_point_by_sector : (16, 2) array
        Nearest point within 2 m at about this height in each of sixteen directions, N and E (m); infinite without a
        point. Other points in that direction hardly tighten the velocity limit.
    """

    from_north: float
    from_east: float
    from_down: float
    goal_north: float
    goal_east: float
    look_ahead_m: float
    checked_point_count: int
    path_clearance_sq: float
    path_start_clearance_sq: float
    goal_clearance_sq: float
    lateral_offset_sum: float
    blocking_point_count: int
    nearest_blocking_distance_sq: float
    nearest_blocking_north: float
    nearest_blocking_east: float
    nearest_point_by_sector: _Array

    @property
    def mean_blocking_offset(self) -> float:
        """Mean lateral offset of the blocking points from the path, positive to the right (m)."""
        return self.lateral_offset_sum / self.blocking_point_count if self.blocking_point_count > 0 else 0.0

    def find_nearest_point_distance(self, place: tuple[float, ...]) -> tuple[float, float, float]:
        """Return the distance of the nearest point from a place N, E (m), and the unit vector N, E to the place."""
        return _find_nearest_point_distance(self.nearest_point_by_sector, place[0], place[1])

    def find_nearest_blocking_distance(self, place: tuple[float, ...]) -> tuple[float, float, float]:
        """Return the distance of the nearest point that blocks the path from a place N, E (m), and the unit vector to
        the place.
        """
        if self.nearest_blocking_distance_sq == math.inf:
            return math.inf, 0.0, 0.0
        return _distance_and_unit_vector(self.nearest_blocking_north, self.nearest_blocking_east, place[0], place[1])


def begin_path_check(position: Sequence[float], goal: Sequence[float], ahead: float = PATH_LOOK_AHEAD_M) -> PathCheck:
    """Return an empty check of the path from a position to a goal (N, E, D; m), over at most ``ahead`` metres."""
    n, e, d = position
    none = math.inf
    return PathCheck(n, e, d, goal[0], goal[1], ahead, 0, none, none, none, 0.0, 0, none, 0.0, 0.0, _NO_NEAREST_POINTS)


_NO_NEAREST_POINTS = np.full((SECTOR_COUNT, 2), np.inf)
EMPTY_PATH_CHECK = begin_path_check((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""Path check without any point."""


@cached_njit
def _sector_index(n: float, e: float) -> int:
    """Return the number, 0 to 15, of the horizontal sector of the direction (n, e); the numbering is arbitrary."""
    an, ae = abs(n), abs(e)
    steep = an < ae
    long, short = (ae, an) if steep else (an, ae)
    return (
        (1 if n < 0.0 else 0)
        + (2 if e < 0.0 else 0)
        + (4 if steep else 0)
        + (8 if short > _SECTOR_BOUNDARY_SLOPE * long else 0)
    )


@cached_njit
def _distance_and_unit_vector(pn: float, pe: float, n: float, e: float) -> tuple[float, float, float]:
    dn, de = n - pn, e - pe
    far = _planar_length(dn, de)
    if far > 1e-9:
        return far, dn / far, de / far
    return far, 0.0, 0.0


@cached_njit
def _find_nearest_point_distance(near: _Array, n: float, e: float) -> tuple[float, float, float]:
    least, row = np.inf, -1
    for k in range(near.shape[0]):
        dn, de = n - near[k, 0], e - near[k, 1]
        square = dn * dn + de * de
        if square < least:
            least, row = square, k
    if row < 0:
        return np.inf, 0.0, 0.0
    return _distance_and_unit_vector(near[row, 0], near[row, 1], n, e)


def check_map_part(
    memory: ObstacleMap, sight: PathCheck, time_s: float, clearance: float, part: int = 1, parts: int = 1
) -> tuple[ObstacleMap, PathCheck]:
    """Process one part of the obstacle map: remove expired points, and check the others against the path.

    Parameters
    ----------
    memory : ObstacleMap
    sight : PathCheck
        Check so far.
    time_s : float
        Present time (s).
    clearance : float
        Distance to keep (m).
    part, parts : int
        Number of this part (from 1) and of all parts; after the last part all points are checked.
    """
    points, used, seen = _check_points_against_path(
        memory.points, memory.point_count, sight, time_s, clearance + BLOCKED_PATH_MARGIN_M, part, parts
    )
    return ObstacleMap(points, used, memory.next_replaced_row), seen


def is_path_blocked(sight: PathCheck, clearance: float) -> bool:
    """Return whether a point blocks the path."""
    at = clearance + BLOCKED_PATH_MARGIN_M
    return sight.path_clearance_sq < at * at


@cached_njit
def _check_points_against_path(
    old: _Array, used: int, s: PathCheck, time: float, blocked_at: float, part: int, parts: int
) -> tuple[_Array, int, PathCheck]:
    points, near = old.copy(), s.nearest_point_by_sector.copy()
    n, e = s.from_north, s.from_east
    wn, we = s.goal_north - n, s.goal_east - e
    length = _planar_length(wn, we)
    if length > 1e-9:
        wn, we = wn / length, we / length
    else:
        wn, we = 1.0, 0.0
    stretch = s.look_ahead_m if s.look_ahead_m < length else length
    wide = 2.0 * blocked_at
    first = _CLEAR_PATH_TO_LEAVE_M if stretch > _CLEAR_PATH_TO_LEAVE_M else stretch
    way, onward, goal, across_all, count = (
        s.path_clearance_sq,
        s.path_start_clearance_sq,
        s.goal_clearance_sq,
        s.lateral_offset_sum,
        s.blocking_point_count,
    )
    block, bn, be = s.nearest_blocking_distance_sq, s.nearest_blocking_north, s.nearest_blocking_east
    k = s.checked_point_count
    end = used * part // parts
    while k < end and k < used:
        if time - points[k, _LAST_HIT_TIME_COLUMN] > POINT_LIFETIME_S:
            used -= 1
            points[k] = points[used]
            continue
        pn, pe, height = points[k, 0], points[k, 1], points[k, 2]
        k += 1
        if abs(height - s.from_down) > _MAX_HEIGHT_DIFFERENCE_M:
            continue
        qn, qe = pn - n, pe - e
        square = qn * qn + qe * qe
        if square < _NEAREST_POINT_RANGE_M * _NEAREST_POINT_RANGE_M:
            sector = _sector_index(qn, qe)
            on, oe = near[sector, 0] - n, near[sector, 1] - e
            if square < on * on + oe * oe:
                near[sector, 0], near[sector, 1] = pn, pe
        hn, he = pn - s.goal_north, pe - s.goal_east
        there = hn * hn + he * he
        goal = there if there < goal else goal
        along = qn * wn + qe * we
        across = qe * wn - qn * we
        if not (abs(across) < wide and along > -wide):
            continue  # neither on the path nor near it
        beyond, beyond_first = _distance_outside_interval(along, stretch), _distance_outside_interval(along, first)
        off = beyond * beyond + across * across
        near_first = beyond_first * beyond_first + across * across
        way = off if off < way else way
        onward = near_first if near_first < onward else onward
        if off < blocked_at * blocked_at and square < block:
            block, bn, be = square, pn, pe
        # The whole visible width of a blocker decides the side, not only the part inside the corridor.
        if along > -blocked_at and along < stretch + blocked_at:
            across_all += across
            count += 1
    seen = PathCheck(
        n,
        e,
        s.from_down,
        s.goal_north,
        s.goal_east,
        s.look_ahead_m,
        k,
        way,
        onward,
        goal,
        across_all,
        count,
        block,
        bn,
        be,
        near,
    )
    return points, used, seen


def limit_approach_velocity(
    sight: PathCheck, position: tuple[float, ...], velocity: tuple[float, float], keep: float
) -> tuple[float, float]:
    """Limit the part of a velocity N, E (m/s) towards each obstacle point.

    The limit is proportional to the distance of the point beyond ``keep`` (m), which is thus reached exponentially.
    """
    vn, ve = velocity
    return _limit_approach_to_points(sight.nearest_point_by_sector, position[0], position[1], vn, ve, keep)


@cached_njit
def _limit_approach_to_points(
    near: _Array, n: float, e: float, vn: float, ve: float, keep: float
) -> tuple[float, float]:
    """Return the velocity nearest to (vn, ve) that respects the approach limit of every point (cyclic projection)."""
    for _ in range(8):
        changed = False
        for k in range(near.shape[0]):
            qn, qe = n - near[k, 0], e - near[k, 1]
            dist = _planar_length(qn, qe)
            if dist > 2.0 or dist < 1e-9:
                continue
            short = -_APPROACH_SPEED_PER_DISTANCE_1_S * (dist - keep) - (vn * qn + ve * qe) / dist
            if short > 1e-6:
                vn += short * qn / dist
                ve += short * qe / dist
                changed = True
        if not changed:
            break
    return vn, ve


def repulsive_force(ranges: Sequence[float], beams: BeamRing, threshold: float) -> tuple[float, float]:
    """Return the sum of the repulsive forces of the obstacles that the beams hit.

    Parameters
    ----------
    ranges : (n,) sequence
        Measured ranges (m).
    beams : BeamRing
        Directions of the beams.
    threshold : float
        Range l_t below which obstacles repel (m).

    Returns
    -------
    (2,) tuple
        F along body x and y (1/m), away from obstacles; a range below 1 cm counts as 1 cm.

    Thesis: eqs 6.14 to 6.17; Fig. 6.19.
    """
    fx = fy = 0.0
    for i, reach in enumerate(ranges):
        if reach < threshold:
            f = 1.0 / max(reach, 0.01) - 1.0 / threshold
            fx -= f * beams.cos[i]
            fy -= f * beams.sin[i]
    return float(fx), float(fy)
