"""What eight range beams say about obstacles: the repulsive field, and a memory of points seen.

The repulsive field of Sec. 6.2.3, with l_i the range of beam i and l_t a threshold:

    f_i = 1/l_i - 1/l_t  if l_i < l_t,  else 0                          (6.14)
    alpha_i = i pi/4 + 9 pi/8                                           (6.15)
    F = sum_i f_i (cos alpha_i, sin alpha_i)                            (6.16, 6.17)

In Fig. 6.18 beam 0 looks forward and to the right, at pi/8 from x towards y, and the beams are numbered clockwise
from above. Then alpha_i of eq. 6.15 is the direction of beam i plus pi: it is the direction of the force, away from
what the beam sees, and F needs no minus sign. Here the direction of the beams comes from the vehicle, and the force of
each is opposite to it, however the ring is numbered.

Beams 45 degrees apart leave gaps, and the field forgets what a beam no longer hits. So points that were hit are kept:
where a beam of range l and body direction u ends, x + l R u, with R the attitude. A hit closer than 5 cm to a known
point confirms that. A point that has not been confirmed for 30 s is forgotten: by then it has gone, or it is far
behind. (That a beam passes a point by proves nothing: it may graze the edge of a thin post.) Points just above the
floor are floor. Own derivation.

Many points and beams are much work for a period of a small processor. So from one step of the mission to the next
they are gone through in parts, some in every period (:func:`look_around`): an eighth of the beams, and a share of the
points, of which a :class:`Sight` keeps what matters: what is in the way, and in each of sixteen directions the nearest
point. The next step goes by that, with distances from where it is by then.

What stands here runs on board as C too (``avoid.c`` of :mod:`mufly.firmware`), equal to the last bit: sums keep their
order, and lengths are square roots of sums.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.trigonometry import sine_cosine

_Array = NDArray[np.float64]

CAPACITY = 160
"""Points remembered; at 5 cm from one another they cover 8 m of contour."""

MEMORY_S = 30.0
"""How long a point is believed in without being hit again (s)."""

_APART = 0.05
_AMONG = 8
_FLOOR = 0.12
_SAME_HEIGHT = 0.15


@dataclass(frozen=True, slots=True)
class Ring:
    """Range beams around the body, all in its x-y plane.

    Attributes
    ----------
    cos, sin : (n,) arrays
        Direction of each beam, from x towards y.
    max_range : float
        What a beam that sees nothing returns (m).
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
        """Angle between neighbours (rad)."""
        return math.tau / len(self.cos)


def ring(count: int, first_angle: float, max_range: float) -> Ring:
    """Ring of ``count`` beams evenly spread from ``first_angle`` (rad, from x towards y)."""
    angles = first_angle + math.tau / count * np.arange(count)
    return Ring(np.cos(angles), np.sin(angles), max_range)


def repulsion(ranges: Sequence[float], beams: Ring, threshold: float) -> tuple[float, float]:
    """Sum of the repulsive forces (eqs 6.14 to 6.17).

    Parameters
    ----------
    ranges : (n,) sequence
        Measured ranges (m).
    beams : Ring
        Their directions.
    threshold : float
        Range l_t from which obstacles repel (m).

    Returns
    -------
    (2,) tuple
        F along body x and y (1/m), away from what is seen; a range below 1 cm counts as 1 cm.

    Thesis: eqs 6.14 to 6.17; Fig. 6.19.
    """
    fx = fy = 0.0
    for i, reach in enumerate(ranges):
        if reach < threshold:
            f = 1.0 / max(reach, 0.01) - 1.0 / threshold
            fx -= f * beams.cos[i]
            fy -= f * beams.sin[i]
    return float(fx), float(fy)


@dataclass(frozen=True, slots=True)
class Memory:
    """Points that beams have hit: in the first ``used`` rows N, E, D (m) and when they were hit last (s).

    Once all rows are in use, the oldest of eight makes room for the next, from row ``turn`` on.
    """

    points: _Array
    used: int = 0
    turn: int = 0

    @staticmethod
    def empty() -> Memory:
        """Nothing seen yet."""
        return Memory(np.zeros((CAPACITY, 4)))


@compiled
def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


@compiled
def _observe(
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
        if d > -_FLOOR:
            continue
        known = False
        for k in range(used):
            dn, de = points[k, 0] - n, points[k, 1] - e
            if dn * dn + de * de < _APART * _APART and abs(points[k, 2] - d) < _SAME_HEIGHT:
                points[k, 3] = time
                known = True
        if not known:
            row = 0
            if used < CAPACITY:
                row = used
                used += 1
            else:
                row = turn
                for k in range(turn, turn + _AMONG):
                    if points[k, 3] < points[row, 3]:
                        row = k
                turn = turn + _AMONG if turn + _AMONG < CAPACITY else 0
            points[row, 0], points[row, 1], points[row, 2], points[row, 3] = n, e, d, time
    return points, used, turn


def observe(
    memory: Memory,
    beams: Ring,
    time_s: float,
    position: _Array,
    attitude: _Array,
    ranges: _Array,
    first: int = 0,
    count: int | None = None,
) -> Memory:
    """Add what beams hit now to the memory.

    Parameters
    ----------
    memory : Memory
        What was known.
    beams : Ring
        The range ring.
    time_s : float
        Now (s).
    position, attitude : (3,) arrays
        N-E-D (m) and roll, pitch, yaw (rad).
    ranges : (n,) array
        Measured ranges (m).
    first, count : int
        The beams that are taken, from which on and how many; after the last comes beam 0. All by default.
    """
    known = _observe(
        memory.points,
        memory.used,
        memory.turn,
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
    return Memory(*known)


# ----------------------------------------------------------------------------
# What seen points mean for a way: how near they are, whether they block it, how fast they may be approached.


LOOK_M = 1.2
"""How far ahead on its way the helicopter minds obstacles."""

_ONWARD_M = LOOK_M + 0.3
"""So much of a way has to be clear where a contour is left."""

ENTER_M = 0.05
"""A way nearer to a seen point than the clearance and this is blocked (m)."""

_APPROACH = 0.8
"""lambda (1/s): slower than the position loop's lag of 0.3 s lets through."""

_SAME_HEIGHT_M = 0.5


_NEAR_M = 2.0
SECTORS = 16
_SLOPE = math.sqrt(2.0) - 1.0  # tan(pi / 8)


class Sight(NamedTuple):
    """What seen points mean for a way, of those that have been gone through since it was begun.

    Attributes
    ----------
    north, east, down : float
        From where it looks (m).
    goal_north, goal_east, ahead : float
        Where to, and how much of that way is looked at (m).
    row : int
        Points gone through.
    way : float
        Square of the least distance of any point from the stretch of the way looked at (m2), where that is within twice
        the one at which the way is blocked; else it may be infinite.
    onward : float
        Likewise from the first 1.5 m of it.
    goal : float
        Square of the distance from the goal to the point nearest to it (m2).
    across : float
        Sum of the distances of the points that block it from the way, positive to the right (m).
    blockers : int
        How many these are.
    block, block_north, block_east : float
        The nearest of those that block it: square of its distance (m2), where it is (m).
    near : (16, 2) array
        In each of sixteen directions the nearest point within 2 m at about this height, N and E (m); infinite where
        there is none. Others in its direction hardly bound a velocity more than it does.
    """

    north: float
    east: float
    down: float
    goal_north: float
    goal_east: float
    ahead: float
    row: int
    way: float
    onward: float
    goal: float
    across: float
    blockers: int
    block: float
    block_north: float
    block_east: float
    near: _Array

    @property
    def offset(self) -> float:
        """Mean distance of the points that block the way from it, positive to the right (m)."""
        return self.across / self.blockers if self.blockers > 0 else 0.0

    def nearest(self, place: tuple[float, ...]) -> tuple[float, float, float]:
        """Distance of the nearest point from a place N, E (m), and the unit vector N, E from that to the place."""
        return _nearest(self.near, place[0], place[1])

    def blocking(self, place: tuple[float, ...]) -> tuple[float, float, float]:
        """As :meth:`nearest`, of the point that blocks the way."""
        if self.block == math.inf:
            return math.inf, 0.0, 0.0
        return _away_from(self.block_north, self.block_east, place[0], place[1])


def begin_sight(position: Sequence[float], goal: Sequence[float], ahead: float = LOOK_M) -> Sight:
    """Begin to look from a position to a goal (N, E, D; m), ``ahead`` metres of that at most; nothing seen yet."""
    n, e, d = position
    none = math.inf
    return Sight(n, e, d, goal[0], goal[1], ahead, 0, none, none, none, 0.0, 0, none, 0.0, 0.0, _NOTHING_NEAR)


_NOTHING_NEAR = np.full((SECTORS, 2), np.inf)
UNSEEN = begin_sight((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
"""What is seen before anything is looked at."""


@compiled
def _away_from(pn: float, pe: float, n: float, e: float) -> tuple[float, float, float]:
    dn, de = n - pn, e - pe
    far = _length(dn, de)
    if far > 1e-9:
        return far, dn / far, de / far
    return far, 0.0, 0.0


@compiled
def _nearest(near: _Array, n: float, e: float) -> tuple[float, float, float]:
    least, row = np.inf, -1
    for k in range(near.shape[0]):
        dn, de = n - near[k, 0], e - near[k, 1]
        square = dn * dn + de * de
        if square < least:
            least, row = square, k
    if row < 0:
        return np.inf, 0.0, 0.0
    return _away_from(near[row, 0], near[row, 1], n, e)


@compiled
def _beyond(along: float, stretch: float) -> float:
    """How far before or behind a stretch."""
    if along < 0.0:
        return along
    return along - stretch if along > stretch else 0.0


@compiled
def _sector(n: float, e: float) -> int:
    """Which of sixteen directions it is; their order does not matter."""
    an, ae = abs(n), abs(e)
    steep = an < ae
    long, short = (ae, an) if steep else (an, ae)
    return (
        (1 if n < 0.0 else 0)
        + (2 if e < 0.0 else 0)
        + (4 if steep else 0)
        + (8 if short > _SLOPE * long else 0)
    )


@compiled
def _examine(
    old: _Array, used: int, s: Sight, time: float, blocked_at: float, part: int, parts: int
) -> tuple[_Array, int, Sight]:
    points, near = old.copy(), s.near.copy()
    n, e = s.north, s.east
    wn, we = s.goal_north - n, s.goal_east - e
    length = _length(wn, we)
    if length > 1e-9:
        wn, we = wn / length, we / length
    else:
        wn, we = 1.0, 0.0
    stretch = s.ahead if s.ahead < length else length
    wide = 2.0 * blocked_at
    first = _ONWARD_M if stretch > _ONWARD_M else stretch
    way, onward, goal, across_all, count = s.way, s.onward, s.goal, s.across, s.blockers
    block, bn, be = s.block, s.block_north, s.block_east
    k = s.row
    end = used * part // parts
    while k < end and k < used:
        if time - points[k, 3] > MEMORY_S:
            used -= 1
            points[k] = points[used]
            continue
        pn, pe, height = points[k, 0], points[k, 1], points[k, 2]
        k += 1
        if abs(height - s.down) > _SAME_HEIGHT_M:
            continue
        qn, qe = pn - n, pe - e
        square = qn * qn + qe * qe
        if square < _NEAR_M * _NEAR_M:
            sector = _sector(qn, qe)
            on, oe = near[sector, 0] - n, near[sector, 1] - e
            if square < on * on + oe * oe:
                near[sector, 0], near[sector, 1] = pn, pe
        hn, he = pn - s.goal_north, pe - s.goal_east
        there = hn * hn + he * he
        goal = there if there < goal else goal
        along = qn * wn + qe * we
        across = qe * wn - qn * we
        if not (abs(across) < wide and along > -wide):
            continue  # neither in the way nor near it
        beyond, beyond_first = _beyond(along, stretch), _beyond(along, first)
        off = beyond * beyond + across * across
        near_first = beyond_first * beyond_first + across * across
        way = off if off < way else way
        onward = near_first if near_first < onward else onward
        if off < blocked_at * blocked_at and square < block:
            block, bn, be = square, pn, pe
        # A blocker's whole visible width tells the side, not only the part inside the corridor.
        if along > -blocked_at and along < stretch + blocked_at:
            across_all += across
            count += 1
    seen = Sight(
        n, e, s.down, s.goal_north, s.goal_east, s.ahead, k, way, onward, goal, across_all, count, block, bn, be, near
    )  # fmt: skip
    return points, used, seen


def look_around(
    memory: Memory, sight: Sight, time_s: float, clearance: float, part: int = 1, parts: int = 1
) -> tuple[Memory, Sight]:
    """Go through a part of the points: drop what has not been hit for long, see what the others mean for the way.

    Parameters
    ----------
    memory : Memory
    sight : Sight
        What has been seen so far.
    time_s : float
        Now (s).
    clearance : float
        Distance to keep (m).
    part, parts : int
        Which part this is (from 1), of how many; after the last all points have been gone through.
    """
    points, used, seen = _examine(memory.points, memory.used, sight, time_s, clearance + ENTER_M, part, parts)
    return Memory(points, used, memory.turn), seen


def look(
    memory: Memory,
    position: tuple[float, ...],
    goal: tuple[float, ...],
    clearance: float,
    ahead: float = LOOK_M,
) -> Sight:
    """Judge the straight level way from ``position`` to ``goal`` (N, E, D; m), ``ahead`` metres of it at most."""
    return look_around(memory, begin_sight(position, goal, ahead), -math.inf, clearance)[1]


def blocked(sight: Sight, clearance: float) -> bool:
    """Whether something stands in the way."""
    at = clearance + ENTER_M
    return sight.way < at * at


@compiled
def _hold_off(near: _Array, n: float, e: float, vn: float, ve: float, keep: float) -> tuple[float, float]:
    """Least change of velocity that approaches no point faster than the barrier allows (cyclic projection)."""
    for _ in range(8):
        changed = False
        for k in range(near.shape[0]):
            qn, qe = n - near[k, 0], e - near[k, 1]
            dist = _length(qn, qe)
            if dist > 2.0 or dist < 1e-9:
                continue
            short = -_APPROACH * (dist - keep) - (vn * qn + ve * qe) / dist
            if short > 1e-6:
                vn += short * qn / dist
                ve += short * qe / dist
                changed = True
        if not changed:
            break
    return vn, ve


def hold_off(
    sight: Sight, position: tuple[float, ...], velocity: tuple[float, float], keep: float
) -> tuple[float, float]:
    """The velocity N, E (m/s) nearest to the wanted one that comes near ``keep`` (m) of a point only exponentially."""
    vn, ve = velocity
    return _hold_off(sight.near, position[0], position[1], vn, ve, keep)
