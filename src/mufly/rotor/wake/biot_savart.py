"""Biot-Savart law: velocity induced by straight vortex segments, computed on all cores.

The vorticity of a line is spread by the high-order algebraic kernel (Winckelmans and Leonard, J. Comput. Phys. 109,
1993; s is the width, x the vector from the line to the point)::

    v = Gamma / (4 pi)  integral of  dl x x  (x^2 + 5/2 s^2) / (x^2 + s^2)^(5/2)

For a straight segment from A to B and the point P, let a = P - A, b = P - B, l = a - b, a' = sqrt(a^2 + s^2), b' =
sqrt(b^2 + s^2) and E = |a x b|^2 + (s |l|)^2. In closed form::

    v = Gamma / (4 pi)  (a x b) / E  [ (l.a / a' - l.b / b') (1 + (s |l|)^2 / E) + s^2 / 2 (l.a / a'^3 - l.b / b'^3) ]

Far away this is the law of a straight filament; inside the core the velocity falls to zero. The greatest velocity of an
infinite straight vortex is proportional to 0.787 / s, at the radius 0.75 s; that of Lamb's vortex with core r_c to
0.715 / r_c. Hence s = 1.1 r_c. The distance to the segment counts, not the distance to its infinite line. Only then
does the velocity belong to a vorticity field whose momentum agrees with the loads, and a bent filament induces its own
motion correctly. A core in the distance to the line (Vatistas) has neither property.

A filament is stored as a path of points; consecutive points bound a segment.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from mufly.numba_cache import cached_njit

Array = NDArray[np.float64]

SINGULARITY_GUARD_M2 = 1e-30  # m^2; keeps the velocity finite at the ends of a segment
_SINGULARITY_GUARD_M4 = 1e-60
_CORE_WIDTH_FACTOR = 1.1  # s over the core radius
_FOUR_PI = 4.0 * math.pi


def segment_velocity(px, py, pz, x0, y0, z0, x1, y1, z1, core):  # type: ignore[no-untyped-def]
    """Return 4 pi times the velocity at a point due to a segment of unit circulation; ``core`` is s^2.

    Plain Python, compiled here for the CPU and in :mod:`.biot_savart_gpu` for CUDA.

    Thesis: eqs 3.15 to 3.17.
    """
    ax, ay, az = px - x0, py - y0, pz - z0
    bx, by, bz = px - x1, py - y1, pz - z1
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    lx, ly, lz = ax - bx, ay - by, az - bz
    ra = 1.0 / math.sqrt(ax * ax + ay * ay + az * az + core)
    rb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz + core)
    along_a = (lx * ax + ly * ay + lz * az) * ra
    along_b = (lx * bx + ly * by + lz * bz) * rb
    thick = core * (lx * lx + ly * ly + lz * lz)
    e = 1.0 / (cx * cx + cy * cy + cz * cz + thick + _SINGULARITY_GUARD_M4)
    f = e * ((along_a - along_b) * (1.0 + thick * e) + 0.5 * core * (along_a * ra * ra - along_b * rb * rb))
    return f * cx, f * cy, f * cz


_segment_velocity = njit(inline="always", fastmath=True, error_model="numpy")(segment_velocity)
_ONE, _HALF, _GUARD_SINGLE = np.float32(1.0), np.float32(0.5), np.float32(1e-30)


@njit(inline="always", fastmath=True, error_model="numpy")
def _segment_velocity_single(px, py, pz, x0, y0, z0, x1, y1, z1, core):  # type: ignore[no-untyped-def]
    """Return :func:`segment_velocity` in single precision, with the cross product a x b = l x a, free of cancellation
    between distant points."""
    ax, ay, az = px - x0, py - y0, pz - z0
    bx, by, bz = px - x1, py - y1, pz - z1
    lx, ly, lz = x1 - x0, y1 - y0, z1 - z0
    cx, cy, cz = az * ly - ay * lz, ax * lz - az * lx, ay * lx - ax * ly
    ra = _ONE / np.sqrt(ax * ax + ay * ay + az * az + core)
    rb = _ONE / np.sqrt(bx * bx + by * by + bz * bz + core)
    along_a = (lx * ax + ly * ay + lz * az) * ra
    along_b = (lx * bx + ly * by + lz * bz) * rb
    thick = core * (lx * lx + ly * ly + lz * lz)
    e = _ONE / (cx * cx + cy * cy + cz * cz + thick + _GUARD_SINGLE)
    f = e * ((along_a - along_b) * (_ONE + thick * e) + _HALF * core * (along_a * ra * ra - along_b * rb * rb))
    return f * cx, f * cy, f * cz


@cached_njit(parallel=True, fastmath=True, error_model="numpy")
def _induce_kernel_single(points: Any, start: Any, end: Any, strength: Any, core: Any, out: Array) -> None:
    zero = np.float32(0.0)
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        sx, sy, sz = zero, zero, zero
        for k in range(start.shape[1]):
            vx, vy, vz = _segment_velocity_single(
                px, py, pz, start[0, k], start[1, k], start[2, k], end[0, k], end[1, k], end[2, k], core[k]
            )
            sx += strength[k] * vx
            sy += strength[k] * vy
            sz += strength[k] * vz
        out[i, 0], out[i, 1], out[i, 2] = sx, sy, sz


@cached_njit(parallel=True, fastmath=True, error_model="numpy")
def _induce_kernel(points: Array, start: Array, end: Array, strength: Array, core: Array, out: Array) -> None:
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(start.shape[1]):
            vx, vy, vz = _segment_velocity(
                px, py, pz, start[0, k], start[1, k], start[2, k], end[0, k], end[1, k], end[2, k], core[k]
            )
            sx += strength[k] * vx
            sy += strength[k] * vy
            sz += strength[k] * vz
        out[i, 0], out[i, 1], out[i, 2] = sx, sy, sz


@cached_njit(parallel=True, fastmath=True, error_model="numpy")
def _influence_kernel(points: Array, paths: Array, core: Array, out: Array) -> None:
    # paths (3, filaments, points): coordinates apart, so that neighbouring segments fill vector registers
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        for j in range(paths.shape[1]):
            x, y, z, c = paths[0, j], paths[1, j], paths[2, j], core[j]
            sx, sy, sz = 0.0, 0.0, 0.0
            for k in range(core.shape[1]):
                vx, vy, vz = _segment_velocity(px, py, pz, x[k], y[k], z[k], x[k + 1], y[k + 1], z[k + 1], c[k])
                sx += vx
                sy += vy
                sz += vz
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = sx, sy, sz


def make_segments(paths: Array, core: Array, strength: Array) -> tuple[Array, Array, Array, Array]:
    """Split filaments into segments for :func:`induce_velocity`.

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
        Circulation over 4 pi (m^2/s).
    core : (n,) array
        s^2 (m2).
    """
    start = np.ascontiguousarray(paths[:, :-1].reshape(-1, 3).T)
    end = np.ascontiguousarray(paths[:, 1:].reshape(-1, 3).T)
    strengths = np.repeat(strength / _FOUR_PI, paths.shape[1] - 1)
    return start, end, strengths, (_CORE_WIDTH_FACTOR * core.ravel()) ** 2 + SINGULARITY_GUARD_M2


class SingleSegments(NamedTuple):
    """Segments of :func:`make_segments` in single precision; lengths are over ``length_m``, against underflow."""

    length_m: float
    arrays: tuple[Any, Any, Any, Any]


def convert_to_single(segments: tuple[Array, Array, Array, Array]) -> SingleSegments:
    """Return segments in single precision for :func:`induce_velocity`."""
    start, end, strength, core = segments
    length = max(float(np.abs(start).max(initial=0.0)), 1e-30)
    parts = (start / length, end / length, strength / length, core / length**2)
    a, b, c, d = (np.ascontiguousarray(v, dtype=np.float32) for v in parts)
    return SingleSegments(length, (a, b, c, d))


def induce_velocity(points: Array, segments: tuple[Array, Array, Array, Array] | SingleSegments) -> Array:
    """Return the velocity (m/s) at points (m, 3) due to the segments of :func:`make_segments`.

    Segments of :func:`convert_to_single` take half the time; the error is 1e-5 of the greatest velocity.
    """
    out = np.empty((points.shape[0], 3))
    if isinstance(segments, SingleSegments):
        _induce_kernel_single((points / segments.length_m).astype(np.float32), *segments.arrays, out)
    else:
        _induce_kernel(np.ascontiguousarray(points), *segments, out)
    return out


def filament_influence(points: Array, paths: Array, core: Array) -> Array:
    """Return the velocity at points due to each filament of unit circulation.

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
    _influence_kernel(
        np.ascontiguousarray(points),
        np.ascontiguousarray(paths.transpose(2, 0, 1)),
        (_CORE_WIDTH_FACTOR * core) ** 2 + SINGULARITY_GUARD_M2,
        out,
    )
    return out / _FOUR_PI
