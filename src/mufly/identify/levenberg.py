"""Levenberg-Marquardt on an output-error problem, with the start values of the windows eliminated.

Linearised, the residual of one window is ``e + J d_theta + S d_s``. Its own start values enter no other window, so
with the thin factorisation ``S = Q R`` they are removed first and exactly::

    (1 - Q Q^T) (e + J d_theta)   least squares in theta alone,      d_s = -R^-1 Q^T (e + J d_theta)

(variable projection; the priors of ``s`` are rows of ``S`` and ``e``). What is left has as many unknowns as free
parameters, however many windows there are. Marquardt's damping scales with the diagonal of ``J^T J``; four dampings
are tried at once, as a batch. A parameter that runs into a bound is held there, and let go when the slope points
inwards. The step in ``theta`` is limited to a factor of two, that of the start values to a quarter of their spread.

A whole record holds height and yaw, which integrate the rotors' forces twice: one direction (the balance of the two
torques) is seen ten thousand times better than others, along a valley that is curved. A step along the valley leaves
it by the square of its length, so each trial is followed by corrections with the Jacobian at hand (chord steps),
which cost one flight each and bring it back to the valley's floor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mufly.identify.problem import Linear, Problem

__all__ = ["Point", "Reduced", "descend", "reduce_record", "stacked_jacobian"]

_Array = NDArray[np.float64]

_LONGEST_STEP = np.log(2.0)
_DAMPINGS = np.array([0.1, 1.0, 10.0, 1000.0])
_LEAST, _GREATEST = 1e-9, 1e9
_LEAST_SHARE = 1e-4
_REACH = 0.25
_CHORDS, _MANY_WINDOWS = 3, 100
_HOPELESS = 1e6  # a trial that is worse by this is not worth correcting


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
    back : list of (a, b, Q, R, Q^T J)
        One a window: its first sample and the one after its last, and what start values follow from.
    spread : (k,) array
        Of the start values.
    """

    jacobian: _Array
    residual: _Array
    back: list[tuple[int, int, _Array, _Array, _Array]]
    spread: _Array

    def rows(self, residual: _Array, states: _Array) -> list[_Array]:
        """Return the rows ``e`` of every window for a residual (n, m) at start values (windows, k)."""
        return [
            np.concatenate([residual[a:b].ravel(), s / self.spread])
            for (a, b, *_), s in zip(self.back, states, strict=True)
        ]

    def project(self, rows: list[_Array]) -> _Array:
        """Return ``(1 - Q Q^T) e``, window after window."""
        return np.concatenate([e - q @ (q.T @ e) for (_, _, q, _, _), e in zip(self.back, rows, strict=True)])

    def states(self, rows: list[_Array], step: _Array) -> _Array:
        """Return the change of the start values (windows, k) that belongs to a step in theta."""
        return np.array(
            [
                -np.linalg.solve(r, q.T @ e + j @ step)
                for (_, _, q, r, j), e in zip(self.back, rows, strict=True)
            ]
        )


def reduce_record(problem: Problem, i: int, linear: Linear, states: _Array) -> Reduced:
    """Eliminate the start values of record ``i``."""
    n, m, t = linear.by_theta.shape
    spread = problem.spread(i)
    ends = [*problem.starts[i][1:], n]
    jacobians, back = [], []
    for a, b in zip(problem.starts[i], ends, strict=True):
        s = np.vstack([linear.by_state[a:b].reshape((b - a) * m, -1), np.diag(1.0 / spread)])
        j = np.vstack([linear.by_theta[a:b].reshape(-1, t), np.zeros((len(spread), t))])
        q, r = np.linalg.qr(s)
        qj = q.T @ j
        jacobians.append(j - q @ qj)
        back.append((int(a), int(b), q, r, qj))
    reduced = Reduced(np.vstack(jacobians), np.zeros(0), back, spread)
    return replace(reduced, residual=reduced.project(reduced.rows(linear.residual, states)))


def descend(
    problem: Problem,
    point: Point,
    *,
    iterations: int,
    tolerance: float = 1e-5,
    least_gain: float = 0.0,
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
        Stop when the cost has fallen by less than this share three times running.
    least_gain : float
        Stop when a linear step promises less than this.
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
        reduced, rows = [], []
        flown = now.simulations
        for i in range(count):
            linear = problem.linearise(i, now.theta, now.states[i])
            reduced.append(reduce_record(problem, i, linear, now.states[i]))
            rows.append(reduced[i].rows(linear.residual, now.states[i]))
            flown += 1 + len(now.theta) + now.states[i].shape[1]
        q, triangle = np.linalg.qr(stacked_jacobian(problem, now.theta, reduced))
        trial, flown, gain = _best_step(problem, now, reduced, rows, q, triangle, flown)
        if gain < least_gain:
            return Point(now.theta, now.states, now.cost, now.damping, flown), True
        if trial is None:
            return Point(now.theta, now.states, now.cost, now.damping, flown), True
        fall = now.cost - trial.cost
        now = trial
        if on_iteration is not None:
            on_iteration(now)
        small = small + 1 if fall < tolerance * max(now.cost, 1.0) else 0
        if small >= 3:
            return now, True
    return now, False


def stacked_jacobian(problem: Problem, theta: _Array, reduced: Sequence[Reduced]) -> _Array:
    """Return the Jacobian of the problem in theta alone: records, priors, hover."""
    jacobians = [r.jacobian for r in reduced]
    jacobians.append(np.diag(1.0 / problem.prior_std))
    if problem.hover:
        h = problem.hover_residual(np.vstack([theta, theta + 1e-5 * np.eye(len(theta))]))
        jacobians.append((h[1:] - h[0]).T / 1e-5)
    return np.vstack(jacobians)


def _best_step(
    problem: Problem,
    now: Point,
    reduced: Sequence[Reduced],
    rows: Sequence[list[_Array]],
    q: _Array,
    triangle: _Array,
    flown: int,
) -> tuple[Point | None, int, float]:
    """Return the best trial (None if none is better), flights so far, and what a linear step promises.

    Orthogonal factors ``q, triangle``, not normal equations, which would square the condition number.
    """

    def target(theta: _Array, at: Sequence[list[_Array]]) -> _Array:
        parts = [r.project(e) for r, e in zip(reduced, at, strict=True)]
        return q.T @ np.concatenate(
            [*parts, theta / problem.prior_std, problem.hover_residual(theta[None])[0]]
        )  # fmt: skip

    start = target(now.theta, rows)
    gain = _promise(problem, now.theta, triangle, start)
    chords = _CHORDS if sum(len(s) for s in problem.starts) <= _MANY_WINDOWS else 0
    damping, share = now.damping, 1.0
    while damping <= _GREATEST and share > _LEAST_SHARE:
        dampings = np.clip(damping * _DAMPINGS, _LEAST, _GREATEST)
        steps = [_step(problem, now.theta, triangle, start, d) for d in dampings]
        moves = [[r.states(e, step) for step in steps] for r, e in zip(reduced, rows, strict=True)]
        parts = [share * _within_reach([m[c] / r.spread for m, r in zip(moves, reduced, strict=True)])
                 for c in range(len(steps))]  # fmt: skip
        thetas = np.array([now.theta + part * step for part, step in zip(parts, steps, strict=True)])
        states = [
            np.array([s + part * move for part, move in zip(parts, m, strict=True)])
            for s, m in zip(now.states, moves, strict=True)
        ]
        best = Point(now.theta, now.states, np.inf)
        for chord in range(chords + 1):
            residuals = [problem.residual(i, thetas, s) for i, s in enumerate(states)]
            costs = problem.cost_of(thetas, states, residuals)
            flown += len(steps) * len(reduced)
            k = int(np.nanargmin(costs))
            if costs[k] < best.cost:
                best = Point(thetas[k], [s[k] for s in states], float(costs[k]), float(dampings[k]))
            if chord == chords or not np.any(costs < _HOPELESS * max(now.cost, 1.0)):
                break
            for c, d in enumerate(dampings):
                at = [r.rows(e[c], s[c]) for r, e, s in zip(reduced, residuals, states, strict=True)]
                step = _step(problem, thetas[c], triangle, target(thetas[c], at), d)
                thetas[c] += step
                for s, r, e in zip(states, reduced, at, strict=True):
                    s[c] += r.states(e, step)
        if best.cost < now.cost:
            return replace(best, simulations=flown), flown, gain
        # Start values follow theta undamped; a part of the whole step goes downhill if the step itself does not.
        damping, share = damping * 10.0, share * 0.3
    return None, flown, gain


def _promise(problem: Problem, theta: _Array, triangle: _Array, target: _Array) -> float:
    """Return by how much the linearised cost falls to its minimum, parameters at a bound held there."""
    low, high = problem.bounds
    free = (theta > low) & (theta < high)
    if not free.any():
        return 0.0
    q = np.linalg.qr(triangle[:, free])[0]
    return 0.5 * float(np.sum((q.T @ target) ** 2))


def _within_reach(moves: Sequence[_Array]) -> float:
    """Return the share of a step that moves no start value by more than a quarter of its spread."""
    return min(1.0, _REACH / max(float(np.max(np.abs(m))) for m in moves))


def _step(problem: Problem, theta: _Array, triangle: _Array, target: _Array, damping: float) -> _Array:
    """Return the damped step in theta: least squares with ``triangle d = -target``, within bounds."""
    low, high = problem.bounds
    size = np.linalg.norm(triangle, axis=0)
    scale = np.sqrt(damping) * np.maximum(size, 1e-12 * np.max(size) + 1e-300)
    slope = triangle.T @ target
    step = np.zeros(len(theta))
    held = ((theta <= low) & (slope > 0)) | ((theta >= high) & (slope < 0))
    for _ in range(len(theta)):
        free = ~held
        if not free.any():
            break
        rows = np.vstack([triangle[:, free], np.diag(scale[free])])
        rhs = np.concatenate([-target - triangle[:, held] @ step[held], np.zeros(int(free.sum()))])
        step[free] = np.linalg.lstsq(rows, rhs, rcond=None)[0]
        longest = float(np.max(np.abs(step[free])))
        if longest > _LONGEST_STEP:
            step *= _LONGEST_STEP / longest
        out = free & ((theta + step < low) | (theta + step > high))
        if not out.any():
            break
        step[out] = np.clip(theta + step, low, high)[out] - theta[out]
        held |= out
    return np.clip(theta + step, low, high) - theta
