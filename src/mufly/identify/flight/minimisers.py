"""Minimisers of an output-error problem: Levenberg-Marquardt and CMA-ES, with eliminated initial states.

The linearised residual of one window is ``e + J d_theta + S d_s``. The initial state of a window affects no other
window, so the thin factorisation ``S = Q R`` eliminates it exactly::

    (1 - Q Q^T) (e + J d_theta)   least squares in theta alone,      d_s = -R^-1 Q^T (e + J d_theta)

(variable projection; the priors of ``s`` are rows of ``S`` and ``e``). The remaining problem has only the free
parameters as unknowns, for any number of windows.

**Levenberg-Marquardt** (:func:`levenberg_marquardt`). Marquardt's damping scales with the diagonal of ``J^T J``; four
dampings are evaluated as one batch. A parameter that reaches a bound is held there, and released when the gradient
points inwards. The step in ``theta`` is limited to a factor of two, the step of the initial states to a quarter of
their prior standard deviation.

Height and yaw of a whole record integrate the rotor forces twice. The balance of the two torques is therefore
determined ten thousand times better than other directions, and the cost has a narrow curved valley. A step along the
valley leaves its floor by the square of the step length. Each trial is therefore corrected with the present Jacobian
(chord steps), which cost one simulation each.

**CMA-ES** (:func:`run_cma_es`; Hansen 2001; the dissertation's Sec. 5.3.1), with pycma, on the same windows. The best
initial states of every trial follow by linear least squares from the derivatives at the best point found. That point
and its derivatives are updated each generation. The approximation is exact at the solution, so both methods have the
same minimum. The search uses coordinates in which the linearised problem is a sphere (``theta = theta_0 + R^-1 z``
with the triangular factor of the Jacobian), unless the prior is narrower. Trials outside the bounds are projected onto
them, with a penalty for the distance. Restarts double the population (Auger and Hansen 2005). Random numbers come from
a seeded generator of the run, so a run can be repeated from its costs without a simulation. A checkpoint therefore
holds these costs and the reference point of the initial states.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mufly.identify.flight.output_error_problem import OutputErrorProblem

_Array = NDArray[np.float64]

_MAX_THETA_STEP = np.log(2.0)
_DAMPING_FACTORS = np.array([0.1, 1.0, 10.0, 1000.0])
_MIN_DAMPING, _MAX_DAMPING = 1e-9, 1e9
_MIN_STEP_FRACTION = 1e-4
_MAX_STATE_STEP_SIGMAS = 0.25
_MAX_CHORD_STEPS, _MAX_WINDOWS_FOR_CHORDS = 3, 100
_CURVATURE_CHORD_STEPS = 4
_MIN_DETERMINED_SINGULAR_VALUE = 2.0  # singular value above which an axis counts as determined: standard deviation 0.5
_MAX_CHORD_COST_RATIO = 1e6  # cost ratio above which a trial is not corrected


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Values reached by a fit: parameters, initial states and their cost.

    Attributes
    ----------
    theta : (t,) array
        Scaled free parameters.
    states : list of (windows, k) array
        Initial states, one array per record.
    cost : float
    damping : float
        Marquardt damping of the next step.
    simulations : int
        Number of simulated records so far.
    """

    theta: _Array
    states: list[_Array]
    cost: float
    damping: float = 1e-3
    simulations: int = 0


class ReducedRecord:
    """Record linearised at a point, with initial states eliminated as in the module's docstring.

    Attributes
    ----------
    whitened_residual : (n, m) array
        (simulated - measured) / noise, zero without a measurement.
    jacobian : (rows, t) array
        ``(1 - Q Q^T) J``, window after window; each window has its samples in order, then its priors.
    window_rows : list of (rows,) array
        ``e`` of every window.
    """

    def __init__(self, problem: OutputErrorProblem, i: int, point: FitPoint) -> None:
        linear = problem.linearise_record(i, point.theta, point.states[i])
        n, m, t = linear.theta_jacobian.shape
        self._initial_state_std = problem.initial_state_std(i)
        self.whitened_residual = linear.whitened_residual
        jacobians = []
        # Per window: first sample, sample after the last, and the factors Q, R, Q^T J of the initial state.
        self._window_factors: list[tuple[int, int, _Array, _Array, _Array]] = []
        for a, b in zip(problem.window_starts[i], [*problem.window_starts[i][1:], n], strict=True):
            s = np.vstack(
                [linear.initial_state_jacobian[a:b].reshape((b - a) * m, -1), np.diag(1.0 / self._initial_state_std)]
            )
            j = np.vstack([linear.theta_jacobian[a:b].reshape(-1, t), np.zeros((len(self._initial_state_std), t))])
            q, r = np.linalg.qr(s)
            qj = q.T @ j
            jacobians.append(j - q @ qj)
            self._window_factors.append((int(a), int(b), q, r, qj))
        self.jacobian = np.vstack(jacobians)
        self.window_rows = self.make_window_residuals(linear.whitened_residual, point.states[i])

    def make_window_residuals(self, residual: _Array, states: _Array) -> list[_Array]:
        """Return the residual vector ``e`` of every window (see the module's docstring).

        It joins the window's part of ``residual`` (n, m) with its initial states, from ``states`` (windows, k), divided
        by their prior standard deviations.
        """
        return [
            np.concatenate([residual[a:b].ravel(), s / self._initial_state_std])
            for (a, b, *_), s in zip(self._window_factors, states, strict=True)
        ]

    def remove_initial_state_part(self, rows: list[_Array]) -> _Array:
        """Return ``(1 - Q Q^T) e`` of all windows: their residual vectors ``rows`` without the part that initial states
        can explain.
        """
        return np.concatenate(
            [e - q @ (q.T @ e) for (_, _, q, _, _), e in zip(self._window_factors, rows, strict=True)]
        )

    def initial_state_change(self, rows: Sequence[_Array | float], step: _Array) -> _Array:
        """Return the change of the initial states (windows, k) that minimises the linearised residual after a step.

        ``rows`` are the residual vectors ``e`` of the windows, ``step`` (t,) is the step in theta.
        """
        found = []
        for (_, _, q, r, j), e in zip(self._window_factors, rows, strict=True):
            found.append(-np.linalg.solve(r, q.T @ e + j @ step))
        return np.array(found)

    def state_change_of_theta(self, step: _Array) -> _Array:
        """Return the change of the initial states (windows, k) caused by a step in theta alone."""
        return np.array([-np.linalg.solve(r, j @ step) for _, _, _, r, j in self._window_factors])

    def relative_state_step(self, moved: _Array) -> float:
        """Return the largest ratio of an initial state's change to its prior standard deviation."""
        return float(np.max(np.abs(moved / self._initial_state_std)))

    def sample_sensitivities(self) -> _Array:
        """Return the Jacobian (n, m, t) of the samples, without the prior rows."""
        m, at, found = self.whitened_residual.shape[1], 0, []
        for a, b, *_ in self._window_factors:
            found.append(self.jacobian[at : at + (b - a) * m].reshape(b - a, m, -1))
            at += (b - a) * m + len(self._initial_state_std)
        return np.concatenate(found)


class LinearisedProblem:
    """Problem linearised at a point: records with eliminated initial states, priors, and the hover equations."""

    def __init__(self, problem: OutputErrorProblem, point: FitPoint) -> None:
        self.problem, self.point = problem, point
        self.reduced_records = [ReducedRecord(problem, i, point) for i in range(len(point.states))]
        self.simulation_count = sum(1 + len(point.theta) + s.shape[1] for s in point.states)

    @cached_property
    def jacobian(self) -> _Array:
        """Jacobian of the residual with respect to theta: rows of records, priors and hover."""
        problem, theta = self.problem, self.point.theta
        jacobians = [r.jacobian for r in self.reduced_records] + [np.diag(1.0 / problem.prior_std)]
        if problem.with_hover_residual:
            h = problem.hover_residual(np.vstack([theta, theta + 1e-5 * np.eye(len(theta))]))
            jacobians.append((h[1:] - h[0]).T / 1e-5)
        return np.vstack(jacobians)

    def projected_residual(self, theta: _Array, rows: Sequence[list[_Array]]) -> _Array:
        """Return the residual with eliminated initial states, in the row order of the Jacobian."""
        parts = [r.remove_initial_state_part(e) for r, e in zip(self.reduced_records, rows, strict=True)]
        hover = self.problem.hover_residual(theta[None])[0]
        return np.concatenate([*parts, theta / self.problem.prior_std, hover])

    def make_trial_residuals(self, b: int, residuals: Sequence[_Array], states: Sequence[_Array]) -> list[list[_Array]]:
        """Return the residual vectors ``e`` of each record's windows for trial ``b`` of a batch of simulations."""
        return [
            r.make_window_residuals(e[b], s[b]) for r, e, s in zip(self.reduced_records, residuals, states, strict=True)
        ]

    @cached_property
    def residual_at_point(self) -> _Array:
        """Residual at the point of linearisation, with eliminated initial states."""
        return self.projected_residual(self.point.theta, [r.window_rows for r in self.reduced_records])

    def predicted_cost_decrease(self) -> float:
        """Return the decrease of the linearised cost to its minimum, with parameters at a bound held."""
        low, high = self.problem.theta_bounds
        free = (self.point.theta > low) & (self.point.theta < high)
        if not free.any():
            return 0.0
        q, triangle = self.qr_factors
        return 0.5 * float(np.sum((np.linalg.qr(triangle[:, free])[0].T @ (q.T @ self.residual_at_point)) ** 2))

    @cached_property
    def qr_factors(self) -> tuple[_Array, _Array]:
        """QR factors of the Jacobian; normal equations would square the condition number."""
        q, triangle = np.linalg.qr(self.jacobian)
        return q, triangle


def levenberg_marquardt(
    problem: OutputErrorProblem, point: FitPoint, *, iterations: int, tolerance: float = 1e-5, least_gain: float = 0.0,
    on_iteration: Callable[[FitPoint], None] | None = None,
) -> tuple[FitPoint, bool]:  # fmt: skip
    """Minimise the cost by Levenberg-Marquardt.

    Parameters
    ----------
    problem : OutputErrorProblem
    point : FitPoint
        Start point; its cost is computed here.
    iterations : int
        Largest number of iterations.
    tolerance : float
        Stop after three successive relative cost decreases below this value.
    least_gain : float
        Stop if the predicted cost decrease of a linear step is below this value.
    on_iteration : callable, optional
        Called with the point after every iteration.

    Returns
    -------
    point : FitPoint
    converged : bool
        False if the iterations are exhausted.
    """
    cost = float(problem.compute_cost(point.theta[None], [s[None] for s in point.states])[0])
    now = replace(point, cost=cost, simulations=point.simulations + len(problem.records))
    small = 0
    for _ in range(iterations):
        linear = LinearisedProblem(problem, now)
        trial, flown = _try_damped_steps(linear)
        if trial is None or linear.predicted_cost_decrease() < least_gain:
            return replace(now, simulations=flown), True
        fall = now.cost - trial.cost
        now = trial
        if on_iteration is not None:
            on_iteration(now)
        small = small + 1 if fall < tolerance * max(now.cost, 1.0) else 0
        if small >= 3:
            return now, True
    return now, False


def _try_damped_steps(linear: LinearisedProblem) -> tuple[FitPoint | None, int]:
    """Return the best point among damped trial steps (None if no step lowers the cost), and the number of
    simulations.
    """
    problem, now, reduced = linear.problem, linear.point, linear.reduced_records
    q, triangle = linear.qr_factors
    start = q.T @ linear.residual_at_point
    flown = now.simulations + linear.simulation_count
    chords = _MAX_CHORD_STEPS if sum(len(s) for s in problem.window_starts) <= _MAX_WINDOWS_FOR_CHORDS else 0
    damping, share = now.damping, 1.0
    while damping <= _MAX_DAMPING and share > _MIN_STEP_FRACTION:
        dampings = np.clip(damping * _DAMPING_FACTORS, _MIN_DAMPING, _MAX_DAMPING)
        steps = [_damped_step(problem, now.theta, triangle, start, d) for d in dampings]
        moves = [[r.initial_state_change(r.window_rows, step) for step in steps] for r in reduced]
        # No initial state changes by more than a quarter of its prior standard deviation.
        parts = [
            share
            * min(
                1.0,
                _MAX_STATE_STEP_SIGMAS / max(r.relative_state_step(m[c]) for m, r in zip(moves, reduced, strict=True)),
            )
            for c in range(len(steps))
        ]
        thetas = np.array([now.theta + part * step for part, step in zip(parts, steps, strict=True)])
        states = [
            np.array([s + part * move for part, move in zip(parts, m, strict=True)])
            for s, m in zip(now.states, moves, strict=True)
        ]
        best = FitPoint(now.theta, now.states, np.inf)
        for chord in range(chords + 1):
            residuals = problem.all_residuals(thetas, states)
            costs = problem.cost_of_residuals(thetas, states, residuals)
            flown += len(steps) * len(reduced)
            k = int(np.nanargmin(costs))
            if costs[k] < best.cost:
                best = FitPoint(thetas[k], [s[k] for s in states], float(costs[k]), float(dampings[k]))
            if chord == chords or not np.any(costs < _MAX_CHORD_COST_RATIO * max(now.cost, 1.0)):
                break
            for c, d in enumerate(dampings):
                at = linear.make_trial_residuals(c, residuals, states)
                step = _damped_step(problem, thetas[c], triangle, q.T @ linear.projected_residual(thetas[c], at), d)
                thetas[c] += step
                for s, r, e in zip(states, reduced, at, strict=True):
                    s[c] += r.initial_state_change(e, step)
        if best.cost < now.cost:
            return replace(best, simulations=flown), flown
        # Initial states follow theta undamped; a fraction of the step lowers the cost if the whole step does not.
        damping, share = damping * 10.0, share * 0.3
    return None, flown


def _damped_step(
    problem: OutputErrorProblem, theta: _Array, triangle: _Array, target: _Array, damping: float
) -> _Array:
    """Return the damped step in theta: least squares with ``triangle d = -target``, within bounds."""
    low, high = problem.theta_bounds
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
        if longest > _MAX_THETA_STEP:
            step *= _MAX_THETA_STEP / longest
        out = free & ((theta + step < low) | (theta + step > high))
        if not out.any():
            break
        step[out] = np.clip(theta + step, low, high)[out] - theta[out]
        held |= out
    return np.clip(theta + step, low, high) - theta


def compute_held_parameter_sensitivity(linear: LinearisedProblem) -> tuple[_Array, OutputErrorProblem]:
    """Return the change of each estimate per standard deviation of each held (not fitted) parameter.

    The linearised problem ``|e + J d_theta + C d_c|^2`` has eliminated initial states and priors among the rows of
    ``J``. At its minimum an error ``d_c`` of a held parameter changes the estimates by

        d_theta = -J^+ C d_c,      covariance += (J^+ C) diag(doubt^2) (J^+ C)^T

    (the *consider* covariance of Schmidt 1966; Tapley, Schutz and Born, Statistical Orbit Determination, ch. 6).

    Returns
    -------
    moved : (t, h) array
        Change of each estimate (``theta``) per standard deviation of each held parameter.
    problem : OutputErrorProblem
        Problem with the held parameters appended to the free ones, in column order.
    """
    problem, point = linear.problem, linear.point
    wider, t = problem.with_held_parameters()
    h = len(wider.free_parameters) - t
    delta = 1e-7
    at = np.concatenate([point.theta, np.zeros(h)])
    thetas = np.vstack([at, at + delta * np.eye(t + h)[t:]])
    residuals = [
        wider.record_residual(i, thetas, np.repeat(s[None], h + 1, axis=0)) for i, s in enumerate(point.states)
    ]
    columns = []
    for c in range(1, h + 1):
        rows = [
            r.make_window_residuals((e[c] - e[0]) / delta, np.zeros_like(s))
            for r, e, s in zip(linear.reduced_records, residuals, point.states, strict=True)
        ]
        parts = [r.remove_initial_state_part(x) for r, x in zip(linear.reduced_records, rows, strict=True)]
        below = len(linear.jacobian) - sum(len(p) for p in parts)
        columns.append(np.concatenate([*parts, np.zeros(below)]))
    if not columns:
        return np.zeros((t, 0)), wider
    u, s, vt = np.linalg.svd(linear.jacobian, full_matrices=False)
    moved = -(vt.T / s) @ (u.T @ np.column_stack(columns))
    return moved * np.array([f.prior_std for f in wider.free_parameters[t:]]), wider


def curvature_correction(linear: LinearisedProblem) -> tuple[_Array, int]:
    """Return terms that correct the covariance for a curved valley of the cost, and the number of simulations.

    The terms are the vectors ``c_k`` below, the rows of an array (t, t).

    The Cramer-Rao bound assumes a straight valley of the cost. Whole records determine one direction ten thousand
    times better than others, so a relative curvature of 1e-4 within the standard deviation of the others matters.
    In coordinates ``z`` with the linearised cost ``|z|^2 / 2`` the valley floor along axis ``k`` is, to second order,
    ``theta(z_k) = theta + a_k z_k + c_k z_k^2``. It is found at ``z_k = +1`` and ``-1`` by correction of all other
    coordinates (chord steps). With normally distributed ``z_k``,

        covariance = sum_k a_k a_k^T + 2 sum_k c_k c_k^T                   (own derivation; the variance of z^2 is 2)

    Parameters
    ----------
    linear : LinearisedProblem
        Problem linearised at the minimum.
    """
    t = len(linear.point.theta)
    # The last row holds no coordinate and converges to the minimum, the reference of the curvature.
    sides = np.concatenate([np.eye(t), -np.eye(t), np.zeros((1, t))])
    thetas, _ = _follow_valley_floor(linear, sides, _CURVATURE_CHORD_STEPS)
    bend = 0.5 * (thetas[:t] + thetas[t : 2 * t]) - thetas[-1]
    bend = np.where(np.all(np.isfinite(bend), axis=1, keepdims=True), bend, 0.0)
    return bend, _CURVATURE_CHORD_STEPS * len(sides) * len(linear.reduced_records)


def cost_rise_along_axes(linear: LinearisedProblem) -> tuple[_Array, int]:
    """Return the rise of the profiled cost at two standard deviations along every axis, divided by that of a
    quadratic cost.

    An interval of two standard deviations assumes a quadratic cost, which rises by ``z^2 / 2 = 2`` there. If the
    profile (all other coordinates corrected) rises by much more or less, intervals from the covariance are invalid
    (Bates and Watts, Nonlinear Regression Analysis, ch. 6: profile t).

    Returns
    -------
    rise : (t, 2) array
        Relative rise at both sides of every right singular vector; NaN at a bound, or if only the prior determines
        the axis.
    flights : int
        Number of simulations.
    """
    problem, t = linear.problem, len(linear.point.theta)
    sides = 2.0 * np.concatenate([np.eye(t), -np.eye(t)])
    thetas, states = _follow_valley_floor(linear, sides, 2 * _CURVATURE_CHORD_STEPS)
    rise = (problem.compute_cost(thetas, states) - linear.point.cost) / 2.0
    low, high = problem.theta_bounds
    rise[np.any((thetas <= low) | (thetas >= high), axis=1)] = np.nan
    rise = rise.reshape(2, t).T
    rise[np.linalg.svd(linear.jacobian, compute_uv=False) < _MIN_DETERMINED_SINGULAR_VALUE] = np.nan
    return rise, (2 * _CURVATURE_CHORD_STEPS + 1) * len(sides) * len(linear.reduced_records)


def _follow_valley_floor(linear: LinearisedProblem, sides: _Array, chords: int) -> tuple[_Array, list[_Array]]:
    """Minimise the cost at b points with the coordinates in ``sides`` fixed; return theta (b, t) and initial states.

    The coordinates are those in which the linearised cost is a sphere. ``sides`` (b, t) holds the fixed ones; its zeros
    are free. ``chords`` correction steps with the present Jacobian are made.
    """
    problem, point = linear.problem, linear.point
    u, s, vt = np.linalg.svd(linear.jacobian, full_matrices=False)
    axes = vt.T / np.maximum(s, _MIN_DETERMINED_SINGULAR_VALUE)  # a weakly determined axis is followed for at most 0.5
    low, high = problem.theta_bounds
    thetas = np.clip(point.theta + sides @ axes.T, low, high)
    states = [
        np.array([x + r.state_change_of_theta(step) for step in thetas - point.theta])
        for r, x in zip(linear.reduced_records, point.states, strict=True)
    ]
    for _ in range(chords):
        residuals = problem.all_residuals(thetas, states)
        for b in range(len(sides)):
            rows = linear.make_trial_residuals(b, residuals, states)
            step = -(u.T @ linear.projected_residual(thetas[b], rows)) * np.where(sides[b] != 0.0, 0.0, 1.0)
            move = (vt.T / s) @ step
            thetas[b] = np.clip(thetas[b] + move, low, high)
            for r, e, x in zip(linear.reduced_records, rows, states, strict=True):
                x[b] += r.initial_state_change(e, move)
    return thetas, states


@dataclass
class EvolutionHistory:
    """History of a CMA-ES run: costs of every generation, by restart, and the reference point."""

    costs: list[list[list[float]]] = field(default_factory=lambda: [[]])
    reference: FitPoint | None = None
    origin: FitPoint | None = None


def run_cma_es(
    problem: OutputErrorProblem,
    point: FitPoint,
    *,
    seed: int,
    generations: int,
    restarts: int = 0,
    tolerance: float = 0.05,
    course: EvolutionHistory | None = None,
    on_generation: Callable[[FitPoint, EvolutionHistory], None] | None = None,
) -> tuple[FitPoint, bool]:
    """Minimise the cost by CMA-ES.

    Parameters
    ----------
    problem : OutputErrorProblem
    point : FitPoint
        Start point.
    seed : int
    generations : int
        Largest number of generations per restart.
    restarts : int
        Number of restarts from the best point with doubled population.
    tolerance : float
        Stop if the cost changes by no more than this value.
    course : EvolutionHistory, optional
        History of an earlier run of the same problem, which is repeated first.
    on_generation : callable, optional
        Called with the best point and the history after every generation.

    Returns
    -------
    point : FitPoint
    converged : bool
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pycma warns about missing optional plotting
        import cma

    t = len(problem.free_parameters)
    course = course or EvolutionHistory()
    if course.origin is None:
        cost = float(problem.compute_cost(point.theta[None], [s[None] for s in point.states])[0])
        course.origin = FitPoint(point.theta, point.states, cost, simulations=point.simulations)
    best = course.reference or course.origin
    size = max(16, 4 + int(3 * np.log(t)))  # trials per generation
    converged = False
    for restart in range(restarts + 1):
        if restart == len(course.costs):
            course.costs.append([])
            course.origin = best
        if restart < len(course.costs) - 1:
            continue
        told = course.costs[restart]
        # One unit row per parameter limits the first step to about a factor of e.
        first = np.vstack([LinearisedProblem(problem, course.origin).jacobian, np.eye(t)])
        spread = np.linalg.inv(np.linalg.qr(first, mode="r"))
        random = np.random.default_rng([seed, restart])
        options = {
            "popsize": size * 2**restart, "verbose": -9, "maxiter": generations, "tolfun": tolerance,
            "tolfunhist": tolerance, "tolx": 1e-4, "seed": np.nan,
            "randn": lambda *shape, g=random: g.standard_normal(shape),
        }  # fmt: skip
        strategy = cma.CMAEvolutionStrategy(np.zeros(t), 3.0, options)
        for before in told:
            strategy.tell(strategy.ask(), before)
        linear = LinearisedProblem(problem, best)
        low, high = problem.theta_bounds
        while not strategy.stop():
            z = strategy.ask()
            wanted = course.origin.theta + np.array(z) @ spread.T
            theta = np.clip(wanted, low, high)
            out = np.sum(((wanted - theta) / 0.1) ** 2, axis=1)
            costs, states = _profile_cost(linear, theta)
            flown = best.simulations + len(theta) * len(problem.records)
            k = int(np.argmin(costs))
            # If simulation confirms the cost of the best trial, this trial becomes the reference of the initial states.
            if costs[k] < best.cost:
                own = [s[k] for s in states]
                cost = float(problem.compute_cost(theta[k][None], [s[None] for s in own])[0])
                flown += len(problem.records)
                if cost < best.cost:
                    best = FitPoint(theta[k], own, cost, best.damping, flown)
                    linear = LinearisedProblem(problem, best)
                    flown += sum(1 + s.shape[1] for s in own)
            best = replace(best, simulations=flown)
            pay = [float(c) for c in costs + out]
            strategy.tell(z, pay)
            told.append(pay)
            course.reference = best
            if on_generation is not None:
                on_generation(best, course)
        converged = "maxiter" not in strategy.stop()
    return best, converged


def _profile_cost(linear: LinearisedProblem, theta: _Array) -> tuple[_Array, list[_Array]]:
    """Return the costs (b,) of ``theta`` with initial states from the linearised problem, and these states for each
    record.
    """
    problem, b = linear.problem, len(theta)
    costs = 0.5 * np.sum((theta / problem.prior_std) ** 2, axis=1)
    costs = costs + 0.5 * np.sum(problem.hover_residual(theta) ** 2, axis=1)
    none, found = np.zeros(theta.shape[1]), []
    for i, (s, r) in enumerate(zip(linear.point.states, linear.reduced_records, strict=True)):
        e = problem.record_residual(i, theta, np.repeat(s[None], b, axis=0))
        states = np.empty((b, *s.shape))
        for c in range(b):
            rows = r.make_window_residuals(e[c], s)
            rest = r.remove_initial_state_part(rows)
            costs[c] += 0.5 * float(rest @ rest)
            states[c] = s + r.initial_state_change(rows, none)
        found.append(states)
    return costs, found
