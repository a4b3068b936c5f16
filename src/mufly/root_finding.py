"""Vectorised root finding for functions of a positive unknown.

The search runs in the logarithm of the unknown, because powers of the speed, such as thrust and torque, are nearly
linear there. From a guess the bracket grows by factors until the sign changes. Illinois steps (regula falsi with the
stale end halved), with a bisection at every third step, then close it. Converged cases need no further evaluations. Own
derivation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_BRACKET_LOG_STEPS = (0.05, 0.2, 0.5, 1.0)  # logarithms; the last value repeats
_MAX_ITERATIONS = 200


def find_rising_root(
    function: Callable[[Array, Integers], Array],
    guess: ArrayLike,
    *,
    lowest: float,
    highest: ArrayLike,
    tolerance: float = 1e-11,
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the roots at which functions of a positive unknown change from negative to positive.

    Parameters
    ----------
    function : callable
        ``function(x, case)`` returns the values at ``x`` (m,) of the cases with the indices ``case`` (m,).
    guess : (n,) array_like
        First guess, clipped to the limits.
    lowest, highest : float, (n,) array_like
        Limits of the unknown.
    tolerance : float
        Relative error of the root.

    Returns
    -------
    root : (n,) array
        Roots; nan where there is none.
    found : (n,) array of bool
    """
    top = np.log(np.broadcast_to(np.asarray(highest, dtype=np.float64), np.shape(guess)).astype(np.float64))
    bottom = np.log(lowest)
    x = np.clip(np.log(np.asarray(guess, dtype=np.float64)), bottom, top)
    every = np.arange(x.size, dtype=np.int64)
    f = function(np.exp(x), every)
    root = np.where(f == 0.0, x, np.nan)
    # (a, fa) is the end with f < 0, (b, fb) the end with f >= 0; they coincide until the first sign change.
    a, b, fa, fb = x.copy(), x.copy(), f.copy(), f.copy()
    rising = f < 0.0
    seek = every[(f != 0.0) & np.isfinite(f)]
    for step in range(_MAX_ITERATIONS):
        if seek.size == 0:
            break
        grow, low = _BRACKET_LOG_STEPS[min(step, len(_BRACKET_LOG_STEPS) - 1)], rising[seek]
        at = np.where(low, np.minimum(a[seek] + grow, top[seek]), np.maximum(b[seek] - grow, bottom))
        value = function(np.exp(at), seek)
        below = value < 0.0
        a[seek[below]], fa[seek[below]] = at[below], value[below]
        b[seek[~below]], fb[seek[~below]] = at[~below], value[~below]
        at_limit = np.where(low, at >= top[seek], at <= bottom)
        seek = seek[(below == low) & ~at_limit & np.isfinite(value)]
    todo = every[np.isnan(root) & (fa < 0.0) & (fb >= 0.0)]
    side = np.zeros(x.size, dtype=np.int64)
    for step in range(_MAX_ITERATIONS):
        if todo.size == 0:
            break
        pa, pb, va, vb = a[todo], b[todo], fa[todo], fb[todo]
        at = 0.5 * (pa + pb) if step % 3 == 2 else pb - vb * (pb - pa) / (vb - va)
        value = function(np.exp(at), todo)
        up = value > 0.0
        b[todo[up]], fb[todo[up]] = at[up], value[up]
        a[todo[~up]], fa[todo[~up]] = at[~up], value[~up]
        fa[todo[up & (side[todo] == 1)]] *= 0.5
        fb[todo[~up & (side[todo] == -1)]] *= 0.5
        moved = np.abs(at - np.where(np.abs(at - pa) < np.abs(at - pb), pa, pb))
        side[todo] = np.where(up, 1, -1)
        good = (b[todo] - a[todo] < tolerance) | (value == 0.0) | (moved < 0.1 * tolerance)
        root[todo[good]] = at[good]
        todo = todo[~good & np.isfinite(value)]
    return np.exp(root), np.isfinite(root)
