"""What seen points mean for a way: how near they are, whether they block it, how fast they may be approached."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mufly.mission.obstacles import Memory

__all__ = ["ENTER_M", "LOOK_M", "Sight", "blocked", "hold_off", "look"]

_Array = NDArray[np.float64]

LOOK_M = 1.2
"""How far ahead on its way the helicopter minds obstacles."""

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
        Least distance of any point from the stretch of the way looked at (m).
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
    offset: float
    goal: float
    block: float
    block_north: float
    block_east: float


@njit(cache=True)
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
) -> tuple[float, float, float, float, float, float, float, float, float]:
    wn, we = gn - n, ge - e
    length = math.hypot(wn, we)
    if length > 1e-9:
        wn, we = wn / length, we / length
    else:
        wn, we = 1.0, 0.0
    stretch = min(length, ahead)
    nearest, nn, ne, way, goal = np.inf, 0.0, 0.0, np.inf, np.inf
    block, bn, be = np.inf, 0.0, 0.0
    total, count = 0.0, 0
    for k in range(used):
        if abs(points[k, 2] - d) > _SAME_HEIGHT_M:
            continue
        qn, qe = points[k, 0] - n, points[k, 1] - e
        dist = math.hypot(qn, qe)
        if dist < nearest:
            nearest = dist
            if dist > 1e-9:
                nn, ne = -qn / dist, -qe / dist
        along = qn * wn + qe * we
        across = qe * wn - qn * we
        beyond = along - min(max(along, 0.0), stretch)
        off = math.hypot(beyond, across)
        way = min(way, off)
        if off < blocked_at and dist < block and dist > 1e-9:
            block, bn, be = dist, -qn / dist, -qe / dist
        goal = min(goal, math.hypot(points[k, 0] - gn, points[k, 1] - ge))
        # A blocker's whole visible width tells the side, not only the part inside the corridor.
        if along > -blocked_at and along < stretch + blocked_at and abs(across) < 2.0 * blocked_at:
            total += across
            count += 1
    return nearest, nn, ne, way, (total / count if count > 0 else 0.0), goal, block, bn, be


@njit(cache=True)
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
            dist = math.hypot(qn, qe)
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
