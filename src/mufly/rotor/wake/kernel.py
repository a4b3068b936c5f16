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

__all__ = ["TINY_M2", "induce", "influence", "segments_of"]

Array = NDArray[np.float64]

TINY_M2 = 1e-30  # m2; keeps the ends of a segment finite
_FOUR_PI = 4.0 * math.pi


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _induce(points, start, end, strength, core, out):  # type: ignore[no-untyped-def]
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(start.shape[1]):
            ax, ay, az = px - start[0, k], py - start[1, k], pz - start[2, k]
            bx, by, bz = px - end[0, k], py - end[1, k], pz - end[2, k]
            cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            c2 = cx * cx + cy * cy + cz * cz
            ra = 1.0 / math.sqrt(ax * ax + ay * ay + az * az + TINY_M2)
            rb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz + TINY_M2)
            along = (
                (ax - bx) * (ax * ra - bx * rb)
                + (ay - by) * (ay * ra - by * rb)
                + (az - bz) * (az * ra - bz * rb)
            )
            f = strength[k] * along / math.sqrt(c2 * c2 + core[k])
            sx += f * cx
            sy += f * cy
            sz += f * cz
        out[i, 0], out[i, 1], out[i, 2] = sx, sy, sz


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _influence(points, paths, core, out):  # type: ignore[no-untyped-def]
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        for j in range(paths.shape[0]):
            sx, sy, sz = 0.0, 0.0, 0.0
            for k in range(paths.shape[1] - 1):
                ax, ay, az = px - paths[j, k, 0], py - paths[j, k, 1], pz - paths[j, k, 2]
                bx, by, bz = px - paths[j, k + 1, 0], py - paths[j, k + 1, 1], pz - paths[j, k + 1, 2]
                cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
                c2 = cx * cx + cy * cy + cz * cz
                ra = 1.0 / math.sqrt(ax * ax + ay * ay + az * az + TINY_M2)
                rb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz + TINY_M2)
                along = (
                    (ax - bx) * (ax * ra - bx * rb)
                    + (ay - by) * (ay * ra - by * rb)
                    + (az - bz) * (az * ra - bz * rb)
                )
                f = along / math.sqrt(c2 * c2 + core[j, k])
                sx += f * cx
                sy += f * cy
                sz += f * cz
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
