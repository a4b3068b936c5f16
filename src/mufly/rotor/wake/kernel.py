"""Biot and Savart: the velocity that straight vortex segments induce, on all cores.

A segment from A to B with circulation Gamma, its ends seen from the point P as a = P - A and b = P - B, l = b to a::

    v = Gamma / (4 pi)  (a x b)  l.(a/|a| - b/|b|) / sqrt(|a x b|^4 + (r_c |l|)^4)

which is the law of a straight filament with the core of Vatistas (Exp. Fluids 11, 1991) for n = 2: far away |a x b| =
h |l| and v = Gamma / (4 pi h) (cos - cos); inside r_c the speed falls to zero like h. A point on a segment's own line
feels nothing from it.

A filament is stored as a path of points; consecutive points bound a segment.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mufly.compiled import compiled

Array = NDArray[np.float64]

TINY_M2 = 1e-30  # m2; keeps the ends of a segment finite
_FOUR_PI = 4.0 * math.pi


def contribution(px, py, pz, x0, y0, z0, x1, y1, z1, core):  # type: ignore[no-untyped-def]
    """Velocity times 4 pi at a point from a segment of unit circulation; ``core`` is (r_c |l|)^4.

    Plain Python: compiled here for processors and in :mod:`.gpu` for CUDA, where it stands in the innermost loop.

    Thesis: eqs 3.15 to 3.17.
    """
    ax, ay, az = px - x0, py - y0, pz - z0
    bx, by, bz = px - x1, py - y1, pz - z1
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    c2 = cx * cx + cy * cy + cz * cz
    ra = 1.0 / math.sqrt(ax * ax + ay * ay + az * az + TINY_M2)
    rb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz + TINY_M2)
    along = (
        (ax - bx) * (ax * ra - bx * rb) + (ay - by) * (ay * ra - by * rb) + (az - bz) * (az * ra - bz * rb)
    )
    f = along / math.sqrt(c2 * c2 + core)
    return f * cx, f * cy, f * cz


_contribution = njit(inline="always", fastmath=True, error_model="numpy")(contribution)


@compiled(parallel=True, fastmath=True, error_model="numpy")
def _induce(points: Array, start: Array, end: Array, strength: Array, core: Array, out: Array) -> None:
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(start.shape[1]):
            vx, vy, vz = _contribution(
                px, py, pz, start[0, k], start[1, k], start[2, k], end[0, k], end[1, k], end[2, k], core[k]
            )
            sx += strength[k] * vx
            sy += strength[k] * vy
            sz += strength[k] * vz
        out[i, 0], out[i, 1], out[i, 2] = sx, sy, sz


@compiled(parallel=True, fastmath=True, error_model="numpy")
def _influence(points: Array, paths: Array, core: Array, out: Array) -> None:
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        for j in range(paths.shape[0]):
            sx, sy, sz = 0.0, 0.0, 0.0
            for k in range(paths.shape[1] - 1):
                a, b = paths[j, k], paths[j, k + 1]
                vx, vy, vz = _contribution(px, py, pz, a[0], a[1], a[2], b[0], b[1], b[2], core[j, k])
                sx += vx
                sy += vy
                sz += vz
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = sx, sy, sz


def segments_of(paths: Array, core: Array, strength: Array) -> tuple[Array, Array, Array, Array]:
    """Lay filaments out as segments, for :func:`induce`.

    Parameters
    ----------
    paths : (filaments, points, 3) array
        Points of each filament (m).
    core : (filaments, points - 1) array
        Core radius of each segment (m).
    strength : (filaments,) array
        Circulation along each path (m2/s).

    Returns
    -------
    start, end : (3, n) arrays
    strength : (n,) array
        Over 4 pi.
    core : (n,) array
        (r_c |l|)^4.
    """
    start = np.ascontiguousarray(paths[:, :-1].reshape(-1, 3).T)
    end = np.ascontiguousarray(paths[:, 1:].reshape(-1, 3).T)
    length2 = np.sum((end - start) ** 2, axis=0)
    strengths = np.repeat(strength / _FOUR_PI, paths.shape[1] - 1)
    return start, end, strengths, (core.ravel() ** 2 * length2) ** 2 + TINY_M2**2


def induce(points: Array, segments: tuple[Array, Array, Array, Array]) -> Array:
    """Velocity at points (m, 3), in m/s, from the segments of :func:`segments_of`."""
    out = np.empty((points.shape[0], 3))
    _induce(np.ascontiguousarray(points), *segments, out)
    return out


def influence(points: Array, paths: Array, core: Array) -> Array:
    """Velocity at points from each filament with unit circulation.

    Parameters
    ----------
    points : (m, 3) array
    paths : (filaments, points, 3) array
    core : (filaments, points - 1) array
        Core radii (m).

    Returns
    -------
    (m, filaments, 3) array, in 1/m
    """
    out = np.empty((points.shape[0], paths.shape[0], 3))
    length2 = np.sum(np.diff(paths, axis=1) ** 2, axis=2)
    _influence(
        np.ascontiguousarray(points), np.ascontiguousarray(paths), (core**2 * length2) ** 2 + TINY_M2**2, out
    )
    return out / _FOUR_PI
