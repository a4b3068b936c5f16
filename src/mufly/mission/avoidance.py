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

What stands here runs on board as C too (``avoid.c`` of :mod:`mufly.firmware`), equal to the last bit: sums keep their
order, and lengths are square roots of sums.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.trigonometry import decay, sine_cosine

_Array = NDArray[np.float64]

CAPACITY = 160
"""Points remembered; at 5 cm from one another they cover 8 m of contour."""

MEMORY_S = 30.0
"""How long a point is believed in without being hit again (s)."""

_APART = 0.05
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
    """Points that beams have hit: in the first ``used`` rows N, E, D (m) and when they were hit last (s)."""

    points: _Array
    used: int = 0

    @staticmethod
    def empty() -> Memory:
        """Nothing seen yet."""
        return Memory(np.zeros((CAPACITY, 4)))


@compiled
def _length(x, y):  # type: ignore[no-untyped-def]
    return math.sqrt(x * x + y * y)


@compiled
def _observe(
    old: _Array,
    used: int,
    time: float,
    x: _Array,
    attitude: _Array,
    ranges: _Array,
    cos: _Array,
    sin: _Array,
    max_range: float,
) -> tuple[_Array, int]:
    points = old.copy()
    k = 0
    while k < used:
        if time - points[k, 3] > MEMORY_S:
            used -= 1
            points[k] = points[used]
        else:
            k += 1
    sr, cr = sine_cosine(attitude[0])
    sp, cp = sine_cosine(attitude[1])
    sy, cy = sine_cosine(attitude[2])
    for i in range(ranges.shape[0]):
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
                for k in range(used):
                    if points[k, 3] < points[row, 3]:
                        row = k
            points[row, 0], points[row, 1], points[row, 2], points[row, 3] = n, e, d, time
    return points, used


def observe(
    memory: Memory, beams: Ring, time_s: float, position: _Array, attitude: _Array, ranges: _Array
) -> Memory:
    """Add what the beams hit now to the memory and drop what has not been hit for long.

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
    """
    return Memory(
        *_observe(
            memory.points,
            memory.used,
            time_s,
            position,
            attitude,
            ranges,
            beams.cos,
            beams.sin,
            beams.max_range,
        )
    )


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


class Sight(NamedTuple):
    """What the seen points mean for a way.

    Attributes
    ----------
    nearest : float
        Distance from the position to the nearest point (m), infinite where there is none.
    north, east : float
        Unit vector from that point to the position.
    way : float
        Least distance of any point from the stretch of the way looked at (m), where that is within twice the one at
        which the way is blocked; else it may be infinite.
    onward : float
        Likewise from the first 1.5 m of it.
    offset : float
        Mean distance of the points that block it from the way, positive to the right (m).
    goal : float
        Distance from the goal to the point nearest to it (m).
    block, block_north, block_east : float
        As the first three, of the points that block the way.
    """

    nearest: float
    north: float
    east: float
    way: float
    onward: float
    offset: float
    goal: float
    block: float
    block_north: float
    block_east: float


@compiled
def _beyond(along: float, stretch: float) -> float:
    """How far before or behind a stretch."""
    if along < 0.0:
        return along
    return along - stretch if along > stretch else 0.0


@compiled
def _look(
    points: _Array,
    used: int,
    n: float,
    e: float,
    d: float,
    gn: float,
    ge: float,
    ahead: float,
    blocked_at: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    wn, we = gn - n, ge - e
    length = _length(wn, we)
    if length > 1e-9:
        wn, we = wn / length, we / length
    else:
        wn, we = 1.0, 0.0
    stretch = ahead if ahead < length else length
    wide = 2.0 * blocked_at
    first = _ONWARD_M if stretch > _ONWARD_M else stretch
    # Squares of distances, until all points have been seen; of the two nearest ones their rows.
    nearest = way = onward = goal = block = np.inf
    near, across_way = -1, -1
    total, count = 0.0, 0
    for k in range(used):
        if abs(points[k, 2] - d) > _SAME_HEIGHT_M:
            continue
        qn, qe = points[k, 0] - n, points[k, 1] - e
        square = qn * qn + qe * qe
        if square < nearest:
            nearest, near = square, k
        along = qn * wn + qe * we
        across = qe * wn - qn * we
        hn, he = points[k, 0] - gn, points[k, 1] - ge
        there = hn * hn + he * he
        goal = there if there < goal else goal
        if not (abs(across) < wide and along > -wide):
            continue  # neither in the way nor near it
        beyond, beyond_first = _beyond(along, stretch), _beyond(along, first)
        off = beyond * beyond + across * across
        near_first = beyond_first * beyond_first + across * across
        way = off if off < way else way
        onward = near_first if near_first < onward else onward
        if off < blocked_at * blocked_at and square < block and square > 1e-18:
            block, across_way = square, k
        # A blocker's whole visible width tells the side, not only the part inside the corridor.
        if along > -blocked_at and along < stretch + blocked_at:
            total += across
            count += 1
    nearest, block = math.sqrt(nearest), math.sqrt(block)
    nn = ne = bn = be = 0.0
    if near >= 0 and nearest > 1e-9:
        nn, ne = (n - points[near, 0]) / nearest, (e - points[near, 1]) / nearest
    if across_way >= 0:
        bn, be = (n - points[across_way, 0]) / block, (e - points[across_way, 1]) / block
    offset = total / count if count > 0 else 0.0
    return nearest, nn, ne, math.sqrt(way), math.sqrt(onward), offset, math.sqrt(goal), block, bn, be


@compiled
def _hold_off(
    points: _Array, used: int, n: float, e: float, d: float, vn: float, ve: float, keep: float
) -> tuple[float, float]:
    """Least change of velocity that approaches no point faster than the barrier allows (cyclic projection)."""
    for _ in range(8):
        changed = False
        for k in range(used):
            if abs(points[k, 2] - d) > _SAME_HEIGHT_M:
                continue
            qn, qe = n - points[k, 0], e - points[k, 1]
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


def look(
    memory: Memory,
    position: tuple[float, ...],
    goal: tuple[float, ...],
    clearance: float,
    ahead: float = LOOK_M,
) -> Sight:
    """Judge the straight level way from ``position`` to ``goal`` (N, E, D; m), ``ahead`` metres of it at most."""
    return Sight(
        *_look(
            memory.points,
            memory.used,
            position[0],
            position[1],
            position[2],
            goal[0],
            goal[1],
            ahead,
            clearance + ENTER_M,
        )
    )


def blocked(sight: Sight, clearance: float) -> bool:
    """Whether something stands in the way."""
    return sight.way < clearance + ENTER_M


def hold_off(
    memory: Memory, position: tuple[float, ...], velocity: tuple[float, float], keep: float
) -> tuple[float, float]:
    """The velocity N, E (m/s) nearest to the wanted one that comes near ``keep`` (m) of a point only exponentially."""
    return _hold_off(
        memory.points, memory.used, position[0], position[1], position[2], velocity[0], velocity[1], keep
    )


# ----------------------------------------------------------------------------
# Around an obstacle and on to the goal, from what the range beams have seen.
#
# The repulsive field alone (`mufly.mission.avoidance`) stops in front of a box that stands across the way: attraction
# and repulsion balance there. So the helicopter goes along the obstacle's contour, as Bug algorithms do (Lumelsky and
# Stepanov 1987; Kamon, Rimon and Rivlin 1998):
#
# - Where a seen point lies nearer to the straight way than the clearance (c plus 5 cm), it picks a side: the one that
#   the blocking points leave more free. It keeps that side, unless it is stuck or has strayed too far, then it tries
#   the other, twice as far.
# - It flies along the contour: with n from the nearest seen point to the helicopter, t across n on the chosen side,
#   and e = d - d_f the error from the distance to follow at (c plus 15 cm), it wants
#   V (t cos a - n sin a), tan a = e / 0.4 m.
# - The repulsive field acts on the reference as in eqs 6.18 and 6.19, with the threshold at d_f, as a velocity k F.
# - Whatever is wanted, the approach to every seen point i is limited: -v.n_i <= lambda (d_i - c), which lets the
#   distance to it fall no faster than exponentially towards c (a control barrier).
# - It leaves the contour when it is nearer to the goal than where it met the obstacle and no seen point lies within c
#   plus 8 cm of the next 1.5 m of the straight way; that progress is what makes Bug algorithms arrive. The first two
#   times on a leg it also leaves, wherever it is, when the whole way to the goal is that clear. After a whole lap it
#   leaves at the place nearest to the goal that the lap came by.
# - Where the goal itself is too near to a seen point it keeps away and waits. After a stated time it gives up.
#
# The reference is a point whose velocity follows what is wanted with limited acceleration and jerk. All in the
# horizontal plane; the height is held. Own derivation.


BRAKE_M_S2 = 1.0
"""Acceleration that avoiding an obstacle may ask for: a tilt of 6 degrees."""

LEAVE_M, FOLLOW_M, KEEP_M = 0.08, 0.15, 0.06
"""Added to the clearance: a way this far from all points is clear; distance to follow a contour at; distance that is
approached only exponentially. They cover the 5 cm between remembered points and the lag of the position loop."""

_FIELD_GAIN = 0.15
"""k of eqs 6.18 and 6.19, as a velocity: m/s per 1/m."""

_LEAN_M = 0.4
_LAG_S = 0.2
_SMOOTH_S = 0.08
_STRAY_M = 3.0
_STUCK_S = 5.0
_CONTACT_M = 0.15


@dataclass(frozen=True, slots=True)
class Detour:
    """A way around an obstacle, in progress.

    Attributes
    ----------
    position, velocity, acceleration : (3,) tuples
        The reference, N-E-D (m, m/s, m/s2).
    side : float
        +1 keeps the obstacle on the left (flies to the right around it), -1 the other way.
    hit : (2,) tuple
        N, E where the obstacle was met (m).
    hit_distance : float
        Distance from there to the goal (m).
    count : int
        How many times an obstacle was met on this leg.
    stray : float
        Distance from the straight way between ``hit`` and the goal at which the other side is tried (m).
    clear_s, anchor_s : float
        For how long the way has been clear; since when ``anchor`` (2,) has not been left by 0.25 m (s).
    lap : (2,) tuple or None
        N, E of where it came to the contour (m).
    laps : int
        Whole laps flown around it.
    lap_way, best : float
        Way flown since then, and the least distance to the goal on it (m).
    leaving : bool
        Whether it brakes, to fly straight on from where it stops.
    obstacle : (2,) tuple
        N, E of the point that was nearest last (m), for messages.
    """

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    side: float
    hit: tuple[float, float]
    hit_distance: float
    count: int = 1
    stray: float = _STRAY_M
    clear_s: float = 0.0
    anchor: tuple[float, float] = (0.0, 0.0)
    anchor_s: float = 0.0
    lap: tuple[float, float] | None = None
    laps: int = 0
    lap_way: float = 0.0
    best: float = math.inf
    leaving: bool = False
    obstacle: tuple[float, float] = (math.nan, math.nan)

    @property
    def done(self) -> bool:
        """Whether the obstacle is avoided and the reference has come to rest."""
        return self.leaving and _norm(*self.velocity) < 0.01 and _norm(*self.acceleration) < 0.05


def _norm(x: float, y: float, z: float = 0.0) -> float:
    return math.sqrt(x * x + y * y + z * z)


def _apart(a: Sequence[float], b: Sequence[float]) -> float:
    return _norm(a[0] - b[0], a[1] - b[1])


def begin_detour(
    position: tuple[float, float, float],
    velocity: tuple[float, float, float],
    acceleration: tuple[float, float, float],
    goal: tuple[float, float, float],
    sight: Sight,
    before: Detour | None,
) -> Detour:
    """Start a detour from where the reference is; ``before`` is the last one on this leg, if there was one."""
    here = (position[0], position[1])
    far = _apart(goal, here)
    side = -1.0 if sight.offset > 0.0 else 1.0
    count, stray = 1, _STRAY_M
    if before is not None:
        count, stray = before.count + 1, before.stray
        if _apart(here, before.position) < 1.5:
            side = before.side
    return Detour(position, velocity, acceleration, side, here, far, count=count, stray=stray, anchor=here)


def go_round(
    detour: Detour,
    memory: Memory,
    beams: Ring,
    position: tuple[float, ...],
    heading: float,
    ranges: list[float],
    goal: tuple[float, float, float],
    *,
    clearance: float,
    speed: float,
    dt: float,
) -> Detour:
    """One step of a detour.

    Parameters
    ----------
    detour : Detour
        As it was.
    memory : Memory
        Points seen, those of now included.
    beams : Ring
        The range ring.
    position : (3,) tuple
        Measured N-E-D (m).
    heading : float
        Measured heading (rad).
    ranges : list of n floats
        Measured ranges (m).
    goal : (3,) tuple
        Where the helicopter wants to be, N-E-D (m).
    clearance, speed : float
        Distance to keep (m) and speed to fly at (m/s).
    dt : float
        Time step (s).

    Thesis: eqs 6.18, 6.19; Sec. 6.2.3.
    """
    reference = detour.position
    sight = look(memory, reference, goal, clearance, math.inf)
    real = look(memory, position, goal, clearance, math.inf)
    # Plan from whichever is nearer to an obstacle: the reference, or the helicopter that the wind has moved off it.
    at = position if real.nearest < sight.nearest else reference
    near = real if real.nearest < sight.nearest else sight
    to_goal = _apart(goal, reference)

    free = real.nearest > clearance
    nearer_goal = to_goal < detour.hit_distance - 0.1
    onward = nearer_goal and sight.onward > clearance + LEAVE_M
    clear = free and (onward or (detour.count < 3 and sight.way > clearance + LEAVE_M))
    clear_s = detour.clear_s + dt if clear else 0.0
    leaving = clear_s > 0.3

    follow = clearance + FOLLOW_M
    touching = near.nearest < follow + _CONTACT_M
    goal_blocked = sight.goal < clearance + ENTER_M and to_goal < 1.0
    here = (reference[0], reference[1])
    if not leaving and not goal_blocked:
        detour = _keep_course(detour, here, goal, to_goal, touching, dt)
    side = detour.side

    vn = ve = 0.0
    if leaving:
        pass
    elif goal_blocked:
        push = min(speed, max(0.0, follow - near.nearest))
        vn, ve = push * near.north, push * near.east
    elif near.nearest < LOOK_M + 0.5:
        far, n, e = near.nearest, near.north, near.east
        # Off any contour, or where a lap around the wrong one came nearest to the goal: make for the one in the way.
        lost = detour.laps > 0 and nearer_goal and near.block > follow + 0.05
        if (lost or not touching) and math.isfinite(near.block):
            far, n, e = near.block, near.block_north, near.block_east
        error = far - follow
        slant = _norm(error, _LEAN_M)
        along, inward = _LEAN_M / slant, error / slant  # cos a, sin a
        # Facing the obstacle, along -n, the way to the right is (n_E, -n_N).
        vn = speed * (along * side * e - inward * n)
        ve = speed * (-along * side * n - inward * e)
    elif to_goal > 1e-6:
        pace = min(speed, 0.5 * to_goal)
        vn, ve = pace * (goal[0] - reference[0]) / to_goal, pace * (goal[1] - reference[1]) / to_goal

    fx, fy = repulsion(ranges, beams, follow)
    if fx != 0.0 or fy != 0.0:
        s, c = sine_cosine(heading)
        vn += _FIELD_GAIN * (c * fx - s * fy)
        ve += _FIELD_GAIN * (s * fx + c * fy)
    vn, ve = hold_off(memory, at, (vn, ve), clearance + KEEP_M)
    fast = _norm(vn, ve)
    limit = speed * max(0.0, 1.0 - max(0.0, _apart(here, position) - 0.15) / 0.15)
    if fast > limit:
        vn, ve = vn * limit / fast, ve * limit / fast

    obstacle = detour.obstacle
    if near.nearest < 2.0:
        obstacle = (at[0] - near.nearest * near.north, at[1] - near.nearest * near.east)
    moved = _follow(detour, (vn, ve, 0.0), dt)
    return replace(moved, clear_s=clear_s, leaving=leaving, obstacle=obstacle)


def _keep_course(
    detour: Detour,
    here: tuple[float, float],
    goal: tuple[float, float, float],
    to_goal: float,
    touching: bool,
    dt: float,
) -> Detour:
    """Change sides when stuck or far off; after a whole lap leave at the best place that it found."""
    side, stray, hit_distance = detour.side, detour.stray, detour.hit_distance
    anchor, anchor_s = detour.anchor, detour.anchor_s + dt
    if _apart(here, anchor) > 0.25:
        anchor, anchor_s = here, 0.0
    elif anchor_s > _STUCK_S:
        side, anchor_s = -side, 0.0
    if _off_course(here, detour.hit, goal) > stray:
        side, stray = -side, 2.0 * stray
    lap, laps, lap_way, best = detour.lap, detour.laps, detour.lap_way, min(detour.best, to_goal)
    lap_way += _norm(*detour.velocity) * dt
    if lap is None or side != detour.side:
        lap, lap_way, best = (here if touching else None), 0.0, to_goal
    elif lap_way > 1.5 and _apart(here, lap) < 0.3:
        hit_distance, laps, lap_way, best = best + 0.25, laps + 1, 0.0, to_goal
    return replace(
        detour,
        side=side,
        stray=stray,
        hit_distance=hit_distance,
        anchor=anchor,
        anchor_s=anchor_s,
        lap=lap,
        laps=laps,
        lap_way=lap_way,
        best=best,
    )


def _off_course(
    here: tuple[float, float], start: tuple[float, float], goal: tuple[float, float, float]
) -> float:
    """Distance of a point from the straight stretch between two others (m), in the horizontal plane."""
    n, e = goal[0] - start[0], goal[1] - start[1]
    square = n * n + e * e
    share = ((here[0] - start[0]) * n + (here[1] - start[1]) * e) / square if square > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return _norm(here[0] - start[0] - share * n, here[1] - start[1] - share * e)


def _follow(detour: Detour, wanted: tuple[float, float, float], dt: float) -> Detour:
    """Move the reference: velocity follows what is wanted, acceleration limited and low-pass filtered."""
    ask = [(w - v) / _LAG_S for w, v in zip(wanted, detour.velocity, strict=True)]
    size = _norm(*ask)
    scale = min(1.0, BRAKE_M_S2 / size) if size > 0.0 else 0.0
    blend = 1.0 - decay(dt / _SMOOTH_S)
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
