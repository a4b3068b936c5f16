"""Seeing and touching the world: ray casting and signed distances.

A ray x(t) = x0 + t u with unit vector u meets

- a box, in its own axes, where it has entered all three slabs |x_i| <= h_i (slab method);
- an upright cylinder of radius R where |x0 + t u - c|^2 = R^2 in the horizontal plane, a quadratic in t, cut by
  the slab between its foot and its top;
- a wall, the ceiling or the floor where one coordinate reaches the plane.

The signed distance to a box with half edges h of a point at q in its axes is |max(|q| - h, 0)| +
min(max_i(|q_i| - h_i), 0): Euclidean outside, minus the way to the nearest face inside. A cylinder is a box in the
two coordinates (distance from the axis, height). To a wall or ceiling it is the way to the plane. Own derivation.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mufly.world.model import World

__all__ = ["contains", "distance", "distances", "ranges"]

_Array = NDArray[np.float64]


@njit(cache=True)
def _slab(x: float, u: float, half: float, near: float, far: float) -> tuple[float, float]:
    """Cut the stretch [near, far] of a ray to the part where |x + t u| <= half (an empty stretch has near > far)."""
    if u == 0.0:
        return (near, far) if abs(x) <= half else (1.0, -1.0)
    a, b = (-half - x) / u, (half - x) / u
    return max(near, min(a, b)), min(far, max(a, b))


@njit(cache=True)
def _cast(
    x: _Array, directions: _Array, max_range: float, boxes: _Array, cylinders: _Array, limits: _Array
) -> _Array:
    out = np.empty(directions.shape[0])
    for k in range(directions.shape[0]):
        un, ue, ud = directions[k, 0], directions[k, 1], directions[k, 2]
        best = max_range
        for b in boxes:
            dn, de = x[0] - b[0], x[1] - b[1]
            near, far = _slab(b[6] * dn + b[7] * de, b[6] * un + b[7] * ue, b[3], 0.0, best)
            near, far = _slab(-b[7] * dn + b[6] * de, -b[7] * un + b[6] * ue, b[4], near, far)
            near, far = _slab(x[2] - b[2], ud, b[5], near, far)
            if near <= far:
                best = near
        for c in cylinders:
            mid, half = 0.5 * (c[3] + c[4]), 0.5 * (c[4] - c[3])
            near, far = _slab(x[2] - mid, ud, half, 0.0, best)
            dn, de = x[0] - c[0], x[1] - c[1]
            uu, du, dd = un * un + ue * ue, dn * un + de * ue, dn * dn + de * de - c[2] * c[2]
            if uu == 0.0:
                if dd > 0.0:
                    continue
            else:
                under = du * du - uu * dd
                if under < 0.0:
                    continue
                root = math.sqrt(under)
                near, far = max(near, (-du - root) / uu), min(far, (-du + root) / uu)
            if near <= far:
                best = near
        for axis in range(2):
            u = directions[k, axis]
            if u < 0.0:
                best = min(best, max(0.0, (limits[2 * axis] - x[axis]) / u))
            elif u > 0.0:
                best = min(best, max(0.0, (limits[2 * axis + 1] - x[axis]) / u))
        if ud < 0.0:
            best = min(best, max(0.0, (limits[4] - x[2]) / ud))
        elif ud > 0.0:
            best = min(best, max(0.0, (limits[5] - x[2]) / ud))
        out[k] = best
    return out


@njit(cache=True)
def _nearest(
    points: _Array, boxes: _Array, cylinders: _Array, limits: _Array
) -> tuple[_Array, NDArray[np.int64]]:
    count = points.shape[0]
    least, which = np.full(count, np.inf), np.full(count, -1, np.int64)
    nb, nc = boxes.shape[0], cylinders.shape[0]
    for k in range(count):
        x = points[k]
        for i in range(nb):
            b = boxes[i]
            dn, de = x[0] - b[0], x[1] - b[1]
            qx = abs(b[6] * dn + b[7] * de) - b[3]
            qy = abs(-b[7] * dn + b[6] * de) - b[4]
            qz = abs(x[2] - b[2]) - b[5]
            d = math.sqrt(max(qx, 0.0) ** 2 + max(qy, 0.0) ** 2 + max(qz, 0.0) ** 2)
            d += min(max(qx, qy, qz), 0.0)
            if d < least[k]:
                least[k], which[k] = d, i
        for i in range(nc):
            c = cylinders[i]
            qr = math.hypot(x[0] - c[0], x[1] - c[1]) - c[2]
            qz = max(c[3] - x[2], x[2] - c[4])
            d = math.sqrt(max(qr, 0.0) ** 2 + max(qz, 0.0) ** 2) + min(max(qr, qz), 0.0)
            if d < least[k]:
                least[k], which[k] = d, nb + i
        for face in range(5):
            d = x[face // 2] - limits[face]
            if face == 1 or face == 3:
                d = -d
            if d < least[k]:
                least[k], which[k] = d, nb + nc + face
    return least, which


def ranges(world: World, position: ArrayLike, directions: ArrayLike, max_range: float = math.inf) -> _Array:
    """Distance along each beam to the first surface it meets.

    Parameters
    ----------
    world : World
        What there is to see, the floor included (unless ``world.floor`` is false).
    position : (3,) array
        Where the beams start, N, E, D (m).
    directions : (n, 3) array
        Unit vectors of the beams in N, E, D.
    max_range : float
        What a beam that meets nothing nearer returns (m).

    Returns
    -------
    (n,) array
        Ranges (m) in [0, max_range]; 0 for a beam that starts inside an obstacle or outside the room.
    """
    return _cast(
        np.ascontiguousarray(position, dtype=np.float64),
        np.ascontiguousarray(directions, dtype=np.float64),
        float(max_range),
        *world.packed,
    )


def distances(world: World, points: ArrayLike) -> tuple[_Array, NDArray[np.int64]]:
    """Signed distance of many points to the nearest obstacle.

    Parameters
    ----------
    world : World
        The obstacles; walls and ceiling count, the floor does not.
    points : (n, 3) array
        N, E, D (m).

    Returns
    -------
    distance : (n,) array
        Metres, negative inside an obstacle or outside the room, infinite in an empty world.
    which : (n,) array of int
        Index of the nearest obstacle in ``world.names``, -1 in an empty world.
    """
    return _nearest(np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3), *world.packed)


def distance(world: World, point: ArrayLike) -> tuple[float, str]:
    """Signed distance (m) of one point (3,) to the nearest obstacle, and that obstacle's name ("" if none)."""
    least, which = distances(world, point)
    return float(least[0]), world.names[which[0]] if which[0] >= 0 else ""


def contains(world: World, point: ArrayLike) -> str:
    """Name of what the point (3,) is inside of: an obstacle, the wall it is beyond, "floor", or "" in free air."""
    least, name = distance(world, point)
    if least < 0.0:
        return name
    return "floor" if world.floor and float(np.asarray(point, dtype=np.float64)[2]) > 0.0 else ""
