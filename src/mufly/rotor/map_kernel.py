"""Interpolation in a coefficient map: smooth enough to be linearised, quick enough for every Runge-Kutta stage.

Over ratio and climb: Catmull-Rom cubics, which go through the points and have continuous slopes,

    f(t) = f_0 + t (f_1 - f_-1)/2 + t^2 (f_-1 - 5/2 f_0 + 2 f_1 - f_2/2) + t^3 (3/2 (f_0 - f_1) + (f_2 - f_-1)/2)

with the point that is missing beyond an edge on the line through the last two. Over the mean speed, where little
changes, straight lines. Beyond its edges a map keeps the value that it has there.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mufly.vehicle import CoefficientMap

__all__ = ["at", "interpolate", "packed"]

Array = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def _cubic(x, n):  # type: ignore[no-untyped-def]
    """First of four neighbouring points, and their weights, at ``x`` in steps from the first point of ``n``."""
    x = min(max(x, 0.0), n - 1.0)
    i = min(int(x), n - 2)
    t = x - i
    a = t * (-0.5 + t * (1.0 - 0.5 * t))
    b = 1.0 + t * t * (-2.5 + 1.5 * t)
    c = t * (0.5 + t * (2.0 - 1.5 * t))
    d = t * t * (-0.5 + 0.5 * t)
    if i == 0:
        b, c, a = b + 2.0 * a, c - a, 0.0
    if i == n - 2:
        c, b, d = c + 2.0 * d, b - d, 0.0
    return i - 1, a, b, c, d


@njit(cache=True, error_model="numpy")
def interpolate(upper_t, upper_q, lower_t, lower_q, size, start, per_step, mean, ratio, climb_ratio):  # type: ignore[no-untyped-def]
    """Interpolate four tables at one point.

    Parameters
    ----------
    upper_t, upper_q, lower_t, lower_q : (nodes,) arrays
        Thrust and torque of upper and lower rotor, in the order of C over (mean speed, ratio, climb).
    size : (3,) integer array
    start, per_step : (3,) arrays
        First value of each axis, and one over its step.
    mean, ratio, climb_ratio : float
        Where.

    Returns
    -------
    upper thrust, upper torque, lower thrust, lower torque : float
    """
    ns, nr, nc = size[0], size[1], size[2]
    s = min(max((mean - start[0]) * per_step[0], 0.0), ns - 1.0)
    k0 = min(int(s), max(ns - 2, 0))
    s -= k0
    j0, ra, rb, rc, rd = _cubic((ratio - start[1]) * per_step[1], nr)
    i0, ca, cb, cc, cd = _cubic((climb_ratio - start[2]) * per_step[2], nc)
    # At the edges a neighbour is not there; its weight is zero, so any other will do.
    i_a, i_b, i_c, i_d = max(i0, 0), i0 + 1, i0 + 2, min(i0 + 3, nc - 1)
    ut = uq = lt = lq = 0.0
    for k in range(2):
        w = s if k == 1 else 1.0 - s
        if w == 0.0:
            continue
        for j in range(4):
            v = w * (ra if j == 0 else rb if j == 1 else rc if j == 2 else rd)
            row = ((k0 + k) * nr + min(max(j0 + j, 0), nr - 1)) * nc
            a, b, c, d = row + i_a, row + i_b, row + i_c, row + i_d
            ut += v * (ca * upper_t[a] + cb * upper_t[b] + cc * upper_t[c] + cd * upper_t[d])
            uq += v * (ca * upper_q[a] + cb * upper_q[b] + cc * upper_q[c] + cd * upper_q[d])
            lt += v * (ca * lower_t[a] + cb * lower_t[b] + cc * lower_t[c] + cd * lower_t[d])
            lq += v * (ca * lower_q[a] + cb * lower_q[b] + cc * lower_q[c] + cd * lower_q[d])
    return ut, uq, lt, lq


@lru_cache(maxsize=32)
def packed(coefficients: CoefficientMap) -> tuple[Any, ...]:
    """Return the first seven arguments of :func:`interpolate` for a map; the tables hold c_T and c_Q."""
    t = coefficients.tables()
    axes = (t.mean_speed_rad_s, t.ratio, t.climb_ratio)
    step = [float((a[-1] - a[0]) / (a.size - 1)) if a.size > 1 else np.inf for a in axes]
    return (
        t.cT_upper.ravel(), t.cQ_upper.ravel(), t.cT_lower.ravel(), t.cQ_lower.ravel(),
        np.array(t.shape, dtype=np.int64), np.array([float(a[0]) for a in axes]), 1.0 / np.array(step),
    )  # fmt: skip


def at(
    coefficients: CoefficientMap, mean_speed_rad_s: ArrayLike, ratio: ArrayLike, climb_ratio: ArrayLike
) -> tuple[Array, NDArray[np.bool_]]:
    """Interpolate a map as the flight model does.

    Parameters
    ----------
    coefficients : CoefficientMap
    mean_speed_rad_s, ratio, climb_ratio : array_like
        Points, broadcast against each other (shape ...); axes as in :class:`mufly.vehicle.MapTables`.

    Returns
    -------
    values : (..., 4) array
        c_T upper, c_Q upper, c_T lower, c_Q lower.
    outside : (...) array of bool
        True where a point lies beyond an edge of ratio or climb, or beyond the range of several mean speeds, and the
        value of the edge is returned.
    """
    points = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (mean_speed_rad_s, ratio, climb_ratio))
    )
    arguments = packed(coefficients)
    flat = zip(*(p.ravel().tolist() for p in points), strict=True)
    values = np.array([interpolate(*arguments, *point) for point in flat]).reshape(*points[0].shape, 4)
    outside = np.zeros(points[0].shape, dtype=np.bool_)
    for p, axis in zip(points, coefficients.tables()[:3], strict=True):
        if axis.size > 1:
            slack = 1e-9 * float(axis[-1] - axis[0])
            outside |= (p < axis[0] - slack) | (p > axis[-1] + slack)
    return values, outside
