"""How far do second-order terms widen the estimates' spread?

Cramer-Rao takes the valley in which the cost lies to be straight. Whole records see one direction ten thousand times
better than others, and there a valley that bends by a ten-thousandth within the spread of the others matters. In
coordinates ``z`` in which the linearised cost is ``|z|^2 / 2`` the floor of the valley along axis ``k`` is, to second
order, ``theta(z_k) = theta + a_k z_k + c_k z_k^2``. It is found at ``z_k = +1`` and ``-1`` by correcting all other
coordinates (chord steps), and, ``z_k`` being normal,

    covariance = sum_k a_k a_k^T + 2 sum_k c_k c_k^T                       (own derivation; the variance of z^2 is 2)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mufly.identify.levenberg import Point, Reduced, stacked_jacobian
from mufly.identify.problem import Problem

__all__ = ["bend_of_valley", "flights_of"]

_Array = NDArray[np.float64]
_CHORDS = 4


def flights_of(problem: Problem) -> int:
    """Return how many flights :func:`bend_of_valley` takes."""
    return _CHORDS * (2 * len(problem.free) + 1) * len(problem.records)


def bend_of_valley(problem: Problem, point: Point, reduced: Sequence[Reduced]) -> _Array:
    """Return ``c_k`` as rows, (t, t), at a minimum.

    Parameters
    ----------
    problem : Problem
    point : Point
        The minimum.
    reduced : sequence of Reduced
        Its records, linearised there, without their start values.
    """
    u, s, vt = np.linalg.svd(stacked_jacobian(problem, point.theta, reduced), full_matrices=False)
    t = len(point.theta)
    axes = vt.T / np.maximum(s, 2.0)  # an axis that is hardly seen is followed for half its unit at most
    # The last one has nothing held: it goes to the minimum itself, from which bends are counted.
    sides = np.concatenate([np.eye(t), -np.eye(t), np.zeros((1, t))])
    low, high = problem.bounds

    def linear_states(theta: _Array) -> list[_Array]:
        return [
            np.array([x - _back(r, step) for step in theta - point.theta])
            for r, x in zip(reduced, point.states, strict=True)
        ]

    thetas = point.theta + sides @ axes.T
    states = linear_states(thetas)
    hold = sides != 0.0
    for _ in range(_CHORDS):
        residuals = [problem.residual(i, thetas, x) for i, x in enumerate(states)]
        for b in range(2 * t + 1):
            rows = [r.rows(e[b], x[b]) for r, e, x in zip(reduced, residuals, states, strict=True)]
            parts = [r.project(e) for r, e in zip(reduced, rows, strict=True)]
            rest = np.concatenate(
                [*parts, thetas[b] / problem.prior_std, problem.hover_residual(thetas[b][None])[0]]
            )
            step = -(u.T @ rest) * np.where(hold[b], 0.0, 1.0)
            move = (vt.T / s) @ step
            thetas[b] = np.clip(thetas[b] + move, low, high)
            for r, e, x in zip(reduced, rows, states, strict=True):
                x[b] += r.states(e, move)
    bend = 0.5 * (thetas[:t] + thetas[t : 2 * t]) - thetas[-1]
    return np.where(np.all(np.isfinite(bend), axis=1, keepdims=True), bend, 0.0)


def _back(r: Reduced, step: _Array) -> _Array:
    """Return how start values answer a step in theta, with the sign of :meth:`Reduced.states` turned."""
    return np.array([np.linalg.solve(tri, j @ step) for _, _, _, tri, j in r.back])
