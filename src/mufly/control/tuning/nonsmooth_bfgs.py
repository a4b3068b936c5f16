"""Minimisation of functions with kinks: BFGS with a weak Wolfe line search by bisection.

Largest eigenvalues and norms are smooth almost everywhere, but not at their minima, where several of them coincide.
BFGS with the true gradient and a line search that asks only for the weak Wolfe conditions converges there in practice,
with no choice of parameters (Lewis and Overton, Math. Program. 141, 2013). The function returns ``inf`` outside its
domain, for example for a loop that is not stable; a step never ends there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mufly.control.linear_systems import Array

Objective = Callable[[Array], tuple[float, Array]]
_ARMIJO_CONSTANT, _WOLFE_CONSTANT = 1e-4, 0.5


class Minimum(NamedTuple):
    """The best point found, its value and the number of steps."""

    x: Array
    value: float
    steps: int


def minimise_nonsmooth(
    objective: Objective,
    start: Array,
    *,
    max_steps: int = 500,
    tolerance: float = 1e-6,
    window: int = 20,
    first_step: float = 1.0,
    budget_s: float = np.inf,
    enough: float = -np.inf,
) -> Minimum:
    """Minimise a function with kinks from a start in its domain.

    Parameters
    ----------
    objective : callable
        Value and gradient at a point (n,); ``inf`` with any gradient outside the domain.
    start : array, shape (n,)
        Start point.
    max_steps : int
    tolerance : float
        Relative decrease over ``window`` steps below which the search ends.
    window : int
        Number of steps over which ``tolerance`` applies.
    first_step : float
        Length of the first trial step; later steps adapt their length.
    budget_s : float
        Processor time after which the search ends (s).
    enough : float
        Value at which the search ends.

    Returns
    -------
    Minimum
        Never worse than the start.
    """
    x = np.array(start, dtype=float)
    f, g = objective(x)
    if not np.isfinite(f):
        return Minimum(x, float(f), 0)
    eye = np.eye(x.size)
    H = eye * min(1.0, first_step / max(float(np.linalg.norm(g)), 1e-300))
    history, began, fresh = [f], time.process_time(), True
    for step in range(1, max_steps + 1):
        d = -H @ g
        slope = float(g @ d)
        if slope > -1e-15 * max(1.0, abs(f)):
            return Minimum(x, f, step - 1)
        low, high, t, found = 0.0, np.inf, 1.0, None
        for _ in range(50):
            fn, gn = objective(x + t * d)
            if not fn <= f + _ARMIJO_CONSTANT * t * slope:
                high = t
            elif float(gn @ d) < _WOLFE_CONSTANT * slope:
                low, found = t, (t, fn, gn)
            else:
                found = (t, fn, gn)
                break
            t = 2.0 * low if not np.isfinite(high) else 0.5 * (low + high)
            if high - low < 1e-14 * high:
                break
        if found is None:
            if fresh:
                return Minimum(x, f, step - 1)
            H, fresh = eye * min(1.0, first_step / max(float(np.linalg.norm(g)), 1e-300)), True  # steepest descent
            continue
        t, fn, gn = found
        s, y = t * d, gn - g
        curvature = float(s @ y)
        if curvature > 0.0:
            if fresh:
                H = eye * (curvature / float(y @ y))
            Hy = H @ y
            H = H + np.outer(s, s) * ((curvature + float(y @ Hy)) / curvature**2)
            H = H - (np.outer(Hy, s) + np.outer(s, Hy)) / curvature
        x, f, g, fresh = x + s, fn, gn, False
        history.append(f)
        if len(history) > window and history[-window - 1] - f < tolerance * abs(f):
            break
        if f <= enough or time.process_time() - began > budget_s:
            break
    return Minimum(x, f, step)
