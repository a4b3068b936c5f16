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
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["CAPACITY", "Memory", "Ring", "observe", "repulsion", "ring"]

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


@njit(cache=True)
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
    cr, sr = math.cos(attitude[0]), math.sin(attitude[0])
    cp, sp = math.cos(attitude[1]), math.sin(attitude[1])
    cy, sy = math.cos(attitude[2]), math.sin(attitude[2])
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
        known, oldest = False, 0
        for k in range(used):
            if (
                math.hypot(points[k, 0] - n, points[k, 1] - e) < _APART
                and abs(points[k, 2] - d) < _SAME_HEIGHT
            ):
                points[k, 3] = time
                known = True
            if points[k, 3] < points[oldest, 3]:
                oldest = k
        if not known:
            if used < CAPACITY:
                oldest = used
                used += 1
            points[oldest, 0], points[oldest, 1], points[oldest, 2], points[oldest, 3] = n, e, d, time
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
