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

from mufly.compiled.numba_cache import cached_njit

Array = NDArray[np.float64]

SINGULARITY_GUARD_M2 = 1e-30  # m^2; keeps the velocity finite at the ends of a segment
_SINGULARITY_GUARD_M4 = 1e-60
_CORE_WIDTH_FACTOR = 1.1  # s over the core radius
_FOUR_PI = 4.0 * math.pi


def evaluate_biot_savart_kernel(px, py, pz, x0, y0, z0, x1, y1, z1, core):  # type: ignore[no-untyped-def]
    """Return 4 pi times the velocity at a point due to a segment of unit circulation; ``core`` is the width squared.

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


_evaluate_biot_savart_kernel = njit(inline="always", fastmath=True, error_model="numpy")(evaluate_biot_savart_kernel)
SEGMENT_QUANTITY_COUNT = 10
(
    SEGMENT_X,
    SEGMENT_Y,
    SEGMENT_Z,
    SEGMENT_DX,
    SEGMENT_DY,
    SEGMENT_DZ,
    SEGMENT_LENGTH_2,
    SEGMENT_CORE,
    SEGMENT_LENGTH_CORE_2,
    SEGMENT_STRENGTH,
) = range(SEGMENT_QUANTITY_COUNT)
"""Rows of a segment in single precision: start, vector to the end, its squared length, squared core radius, the product
of both, circulation."""
_ONE_FLOAT32, _HALF_FLOAT32, _SINGULARITY_GUARD_FLOAT32 = np.float32(1.0), np.float32(0.5), 1e-30


@cached_njit(parallel=True, fastmath=True, error_model="numpy")
def _grouped_kernel_single_precision(points: Any, rows: Any, out: Array) -> None:
    # As evaluate_biot_savart_kernel, but the terms of the segment alone are given: 61 operations instead of 77. The
    # cross product a x b = l x a is free of cancellation between distant points.
    zero = np.float32(0.0)
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        for j in range(rows.shape[1]):
            sx, sy, sz = zero, zero, zero
            for k in range(rows.shape[2]):
                ax, ay, az = px - rows[SEGMENT_X, j, k], py - rows[SEGMENT_Y, j, k], pz - rows[SEGMENT_Z, j, k]
                lx, ly, lz = rows[SEGMENT_DX, j, k], rows[SEGMENT_DY, j, k], rows[SEGMENT_DZ, j, k]
                core, thick = rows[SEGMENT_CORE, j, k], rows[SEGMENT_LENGTH_CORE_2, j, k]
                cx, cy, cz = az * ly - ay * lz, ax * lz - az * lx, ay * lx - ax * ly
                along_a = lx * ax + ly * ay + lz * az
                along_b = along_a - rows[SEGMENT_LENGTH_2, j, k]
                bx, by, bz = ax - lx, ay - ly, az - lz
                ra = _ONE_FLOAT32 / np.sqrt(ax * ax + ay * ay + az * az + core)
                rb = _ONE_FLOAT32 / np.sqrt(bx * bx + by * by + bz * bz + core)
                e = _ONE_FLOAT32 / (cx * cx + cy * cy + cz * cz + thick)
                g, h = _ONE_FLOAT32 + thick * e, _HALF_FLOAT32 * core
                f = (
                    rows[SEGMENT_STRENGTH, j, k]
                    * e
                    * (along_a * ra * (g + h * ra * ra) - along_b * rb * (g + h * rb * rb))
                )
                sx += f * cx
                sy += f * cy
                sz += f * cz
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = sx, sy, sz


@cached_njit(parallel=True, fastmath=True, error_model="numpy")
def _induced_velocity_kernel(points: Array, start: Array, end: Array, strength: Array, core: Array, out: Array) -> None:
    for i in prange(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        sx, sy, sz = 0.0, 0.0, 0.0
        for k in range(start.shape[1]):
            vx, vy, vz = _evaluate_biot_savart_kernel(
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
                vx, vy, vz = _evaluate_biot_savart_kernel(
                    px, py, pz, x[k], y[k], z[k], x[k + 1], y[k + 1], z[k + 1], c[k]
                )
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
        Ends of the segments (m).
    strength : (n,) array
        Circulation over 4 pi (m^2/s).
    core : (n,) array
        s^2 (m2).
    """
    start = np.ascontiguousarray(paths[:, :-1].reshape(-1, 3).T)
    end = np.ascontiguousarray(paths[:, 1:].reshape(-1, 3).T)
    strengths = np.repeat(strength / _FOUR_PI, paths.shape[1] - 1)
    return start, end, strengths, (_CORE_WIDTH_FACTOR * core.ravel()) ** 2 + SINGULARITY_GUARD_M2


class SinglePrecisionSegments(NamedTuple):
    """Vortex segments in single precision, in groups of equal size; lengths are in units of ``length_unit_m``.

    The unit avoids underflow.

    ``rows``, (10, groups, segments): start, line to the end, its square, s^2, s^2 times that square, circulation.
    """

    length_unit_m: float
    rows: Any


def convert_segments_to_single(segments: tuple[Array, Array, Array, Array], groups: int = 1) -> SinglePrecisionSegments:
    """Return the segments of :func:`make_segments` in single precision, in groups of equal size."""
    start, end, strength, core = segments
    length = max(float(np.abs(start).max(initial=0.0)), 1e-30)
    rows = np.empty((SEGMENT_QUANTITY_COUNT, strength.size), dtype=np.float32)
    rows[:SEGMENT_DX] = start / length
    # Between rounded ends: a point at the end of a segment stays on its line.
    rows[SEGMENT_DX:SEGMENT_LENGTH_2] = (end / length).astype(np.float32) - rows[:SEGMENT_DX]
    rows[SEGMENT_LENGTH_2] = np.sum(rows[SEGMENT_DX:SEGMENT_LENGTH_2].astype(np.float64) ** 2, axis=0)
    rows[SEGMENT_CORE] = core / length**2
    rows[SEGMENT_LENGTH_CORE_2] = rows[SEGMENT_LENGTH_2] * rows[SEGMENT_CORE] + _SINGULARITY_GUARD_FLOAT32
    rows[SEGMENT_STRENGTH] = strength / length
    return SinglePrecisionSegments(length, rows.reshape(SEGMENT_QUANTITY_COUNT, groups, -1))


def induce_velocity(points: Array, segments: tuple[Array, Array, Array, Array] | SinglePrecisionSegments) -> Array:
    """Return the velocity (m/s) at points (m, 3) due to the segments of :func:`make_segments`.

    Segments of :func:`convert_segments_to_single` take a quarter of the time; the error is 1e-5 of the greatest
    velocity.
    """
    if isinstance(segments, SinglePrecisionSegments):
        velocity = induce_velocity_by_group(points, segments)
        return velocity[:, 0] if velocity.shape[1] == 1 else velocity.sum(axis=1)
    out = np.empty((points.shape[0], 3))
    _induced_velocity_kernel(np.ascontiguousarray(points), *segments, out)
    return out


def induce_velocity_by_group(points: Array, segments: SinglePrecisionSegments) -> Array:
    """Return the velocity (m/s) at points (m, 3) due to each group of segments: (m, groups, 3) array."""
    out = np.empty((points.shape[0], segments.rows.shape[1], 3))
    _grouped_kernel_single_precision((points / segments.length_unit_m).astype(np.float32), segments.rows, out)
    return out


def filament_influence(points: Array, paths: Array, core: Array) -> Array:
    """Return the velocity at points due to each filament of unit circulation.

    Parameters
    ----------
    points : (m, 3) array
        Evaluation points (m).
    paths : (filaments, points, 3) array
        Points of each filament (m).
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
