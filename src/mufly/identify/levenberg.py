"""Levenberg-Marquardt on an output-error problem, with the start values of the windows eliminated.

Linearised, the residual of one window is ``e + J d_theta + S d_s``. Its own start values enter no other window, so
with the thin factorisation ``S = Q R`` they are removed first and exactly::

    (1 - Q Q^T) (e + J d_theta)   least squares in theta alone,      d_s = -R^-1 Q^T (e + J d_theta)

(variable projection; the priors of ``s`` are rows of ``S`` and ``e``). What is left has as many unknowns as free
parameters, however many windows there are. Marquardt's damping scales with the diagonal of ``J^T J``; four dampings
are tried at once, as a batch. A parameter that runs into a bound is held there, and let go when the slope points
inwards. The step in ``theta`` is limited to a factor of two.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.identify.problem import Linear, Problem

__all__ = ["Point", "Reduced", "descend", "reduce_record"]

_Array = NDArray[np.float64]

_LONGEST_STEP = np.log(2.0)
_DAMPINGS = np.array([0.1, 1.0, 10.0, 1000.0])
_LEAST, _GREATEST = 1e-9, 1e9


@dataclass(frozen=True, eq=False)
class Point:
    """Where a fit stands.

    Attributes
    ----------
    theta : (t,) array
    states : list of (windows, k) array
        One a record.
    cost : float
    damping : float
        Marquardt's, for the next step.
    simulations : int
        Records flown on the way here.
    """

    theta: _Array
    states: list[_Array]
    cost: float
    damping: float = 1e-3
    simulations: int = 0


@dataclass(frozen=True, eq=False)
class Reduced:
    """A linearised record without its start values.

    Attributes
    ----------
    jacobian : (rows, t) array
        ``(1 - Q Q^T) J``; rows of one window after the other, in a window sample after sample, its priors last.
    residual : (rows,) array
    back : list of (R, Q^T J, Q^T e)
        From which the start values of each window follow.
    """

    jacobian: _Array
    residual: _Array
    back: list[tuple[_Array, _Array, _Array]]

    def states(self, step: _Array) -> _Array:
        """Return the change of the start values (windows, k) that belongs to a step in theta."""
        return np.array([-np.linalg.solve(r, e + j @ step) for r, j, e in self.back])


def reduce_record(problem: Problem, i: int, linear: Linear, states: _Array) -> Reduced:
    """Eliminate the start values of record ``i``."""
    n, m, t = linear.by_theta.shape
    spread = problem.spread(i)
    ends = [*problem.starts[i][1:], n]
    jacobians, residuals, back = [], [], []
    for w, (a, b) in enumerate(zip(problem.starts[i], ends, strict=True)):
        s = np.vstack([linear.by_state[a:b].reshape((b - a) * m, -1), np.diag(1.0 / spread)])
        j = np.vstack([linear.by_theta[a:b].reshape(-1, t), np.zeros((len(spread), t))])
        e = np.concatenate([linear.residual[a:b].ravel(), states[w] / spread])
        q, r = np.linalg.qr(s)
        qj, qe = q.T @ j, q.T @ e
        jacobians.append(j - q @ qj)
        residuals.append(e - q @ qe)
        back.append((r, qj, qe))
    return Reduced(np.vstack(jacobians), np.concatenate(residuals), back)


def descend(
    problem: Problem,
    point: Point,
    *,
    iterations: int,
    tolerance: float = 1e-5,
    on_iteration: Callable[[Point], None] | None = None,
) -> tuple[Point, bool]:
    """Run Levenberg-Marquardt.

    Parameters
    ----------
    problem : Problem
    point : Point
        Where to start; its cost is computed here.
    iterations : int
        At most this many.
    tolerance : float
        Stop when the cost falls by less than this share, or by less than this.
    on_iteration : callable, optional
        Called with every point that is reached.

    Returns
    -------
    point : Point
    converged : bool
        False if the iterations ran out.
    """
    cost = float(problem.cost(point.theta[None], [s[None] for s in point.states])[0])
    count = len(problem.records)
    now = Point(point.theta, point.states, cost, point.damping, point.simulations + count)
    small = 0
    for _ in range(iterations):
        reduced = []
        flown = now.simulations
        for i in range(count):
            linear = problem.linearise(i, now.theta, now.states[i])
            reduced.append(reduce_record(problem, i, linear, now.states[i]))
            flown += 1 + len(now.theta) + now.states[i].shape[1]
        jacobian, residual = _stacked(problem, now.theta, reduced)
        trial, flown = _best_step(problem, now, reduced, jacobian, residual, flown)
        if trial is None:
            return Point(now.theta, now.states, now.cost, now.damping, flown), True
        fall = now.cost - trial.cost
        now = trial
        if on_iteration is not None:
            on_iteration(now)
        small = small + 1 if fall < tolerance * max(now.cost, 1.0) else 0
        if small >= 2:
            return now, True
    return now, False


def _stacked(problem: Problem, theta: _Array, reduced: Sequence[Reduced]) -> tuple[_Array, _Array]:
    """Return Jacobian and residual of the problem in theta alone: records, priors, hover."""
    t = len(theta)
    jacobians, residuals = [r.jacobian for r in reduced], [r.residual for r in reduced]
    jacobians.append(np.diag(1.0 / problem.prior_std))
    residuals.append(theta / problem.prior_std)
    if problem.hover:
        h = problem.hover_residual(np.vstack([theta, theta + 1e-5 * np.eye(t)]))
        jacobians.append((h[1:] - h[0]).T / 1e-5)
        residuals.append(h[0])
    return np.vstack(jacobians), np.concatenate(residuals)


def _best_step(
    problem: Problem,
    now: Point,
    reduced: Sequence[Reduced],
    jacobian: _Array,
    residual: _Array,
    flown: int,
) -> tuple[Point | None, int]:
    normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
    damping = now.damping
    while damping <= _GREATEST:
        dampings = np.clip(damping * _DAMPINGS, _LEAST, _GREATEST)
        steps = np.array([_step(problem, now.theta, normal, slope, d) for d in dampings])
        thetas = now.theta + steps
        states = [
            np.array([s + r.states(step) for step in steps])
            for s, r in zip(now.states, reduced, strict=True)
        ]  # fmt: skip
        costs = problem.cost(thetas, states)
        flown += len(steps) * len(reduced)
        k = int(np.nanargmin(costs))
        if costs[k] < now.cost:
            return Point(thetas[k], [s[k] for s in states], float(costs[k]), float(dampings[k]), flown), flown
        damping = float(dampings[-1]) * 10.0
    return None, flown


def _step(problem: Problem, theta: _Array, normal: _Array, slope: _Array, damping: float) -> _Array:
    low, high = problem.bounds
    scale = np.diag(normal) + 1e-12 * np.max(np.diag(normal)) + 1e-300
    step = np.zeros(len(theta))
    held = ((theta <= low) & (slope > 0)) | ((theta >= high) & (slope < 0))
    for _ in range(len(theta)):
        free = ~held
        if not free.any():
            break
        rhs = -slope[free] - normal[np.ix_(free, held)] @ step[held]
        a = normal[np.ix_(free, free)] + damping * np.diag(scale[free])
        step[free] = np.linalg.lstsq(a, rhs, rcond=None)[0]
        longest = float(np.max(np.abs(step[free])))
        if longest > _LONGEST_STEP:
            step *= _LONGEST_STEP / longest
        out = free & ((theta + step < low) | (theta + step > high))
        if not out.any():
            break
        step[out] = np.clip(theta + step, low, high)[out] - theta[out]
        held |= out
    return np.clip(theta + step, low, high) - theta
