"""CMA-ES on an output-error problem (Hansen 2001; the dissertation's Sec. 5.3.1), with pycma.

The same problem as Levenberg-Marquardt's, in the same windows. Start values of the windows are eliminated as there:
for every trial the best start values follow from the derivatives at the best point so far, by linear least squares;
that point and its derivatives are renewed each generation. Away from the solution this is an approximation, at the
solution it is exact, so both methods have the same minimum.

Search starts in coordinates in which the linearised problem is a sphere (``theta = theta_0 + R^-1 z`` with the
triangular factor of the Jacobian there), as far as the prior is not narrower. Bounds: trials are brought back to the
box and pay for how far they were out. Restarts double the population (Auger and Hansen 2005).

A run can be repeated from the costs it was told, without a simulation: random numbers come from a seeded generator
of the run's own. A checkpoint therefore holds these costs, and the point that start values are counted from.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.identify.levenberg import Point, Reduced, reduce_record, stacked_jacobian
from mufly.identify.problem import Problem

__all__ = ["Course", "evolve"]

_Array = NDArray[np.float64]


@dataclass
class Course:
    """What a run was told: costs of every generation (restart by restart), and its reference point."""

    told: list[list[list[float]]] = field(default_factory=lambda: [[]])
    reference: Point | None = None
    origin: Point | None = None


def evolve(
    problem: Problem,
    point: Point,
    *,
    seed: int,
    generations: int,
    restarts: int = 0,
    population: int | None = None,
    tolerance: float = 0.05,
    course: Course | None = None,
    on_generation: Callable[[Point, Course], None] | None = None,
) -> tuple[Point, bool]:
    """Run CMA-ES.

    Parameters
    ----------
    problem : Problem
    point : Point
        Where to start.
    seed : int
    generations : int
        At most this many a restart.
    restarts : int
        How often to start again from the best point with twice the population.
    population : int, optional
        Trials a generation; ``4 + 3 ln t`` by default, at least 16.
    tolerance : float
        Stop when the cost has not changed by more.
    course : Course, optional
        What an earlier run of the same problem was told; it is repeated first.
    on_generation : callable, optional
        Called with the best point and the course after every generation.

    Returns
    -------
    point : Point
    converged : bool
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pycma warns that optional plotting is not there
        import cma

    t = len(problem.free)
    course = course or Course()
    if course.origin is None:
        cost = float(problem.cost(point.theta[None], [s[None] for s in point.states])[0])
        course.origin = Point(point.theta, point.states, cost, simulations=point.simulations)
    best = course.reference or course.origin
    size = population or max(16, 4 + int(3 * np.log(t)))
    converged = False
    for restart in range(restarts + 1):
        if restart == len(course.told):
            course.told.append([])
            course.origin = best
        if restart < len(course.told) - 1:
            continue
        told = course.told[restart]
        reduced = _reduced(problem, course.origin)
        spread = np.linalg.inv(np.linalg.qr(_with_prior(problem, course.origin, reduced), mode="r"))
        random = np.random.default_rng([seed, restart])
        options = {
            "popsize": size * 2**restart, "verbose": -9, "maxiter": generations, "tolfun": tolerance,
            "tolfunhist": tolerance, "tolx": 1e-4, "seed": np.nan,
            "randn": lambda *shape, g=random: g.standard_normal(shape),
        }  # fmt: skip
        strategy = cma.CMAEvolutionStrategy(np.zeros(t), 3.0, options)
        for before in told:
            strategy.tell(strategy.ask(), before)
        reduced = _reduced(problem, best)
        while not strategy.stop():
            z = strategy.ask()
            wanted = course.origin.theta + np.array(z) @ spread.T
            low, high = problem.bounds
            theta = np.clip(wanted, low, high)
            out = np.sum(((wanted - theta) / 0.1) ** 2, axis=1)
            costs, states = _profile(problem, theta, best, reduced)
            flown = best.simulations + len(theta) * len(problem.records)
            k = int(np.argmin(costs))
            # Is the best trial as good as it seems? Then start values are counted from there.
            if costs[k] < best.cost:
                own = [s[k] for s in states]
                cost = float(problem.cost(theta[k][None], [s[None] for s in own])[0])
                flown += len(problem.records)
                if cost < best.cost:
                    best = Point(theta[k], own, cost, best.damping, flown)
                    reduced = _reduced(problem, best)
                    flown += sum(1 + s.shape[1] for s in own)
            best = Point(best.theta, best.states, best.cost, best.damping, flown)
            pay = [float(c) for c in costs + out]
            strategy.tell(z, pay)
            told.append(pay)
            course.reference = best
            if on_generation is not None:
                on_generation(best, course)
        reasons = strategy.stop()
        converged = "maxiter" not in reasons
    return best, converged


def _reduced(problem: Problem, point: Point) -> list[Reduced]:
    return [
        reduce_record(problem, i, problem.linearise(i, point.theta, s), s) for i, s in enumerate(point.states)
    ]  # fmt: skip


def _with_prior(problem: Problem, point: Point, reduced: list[Reduced]) -> _Array:
    """Return the Jacobian with a row a parameter that keeps the first step below a factor of e or so."""
    return np.vstack([stacked_jacobian(problem, point.theta, reduced), np.eye(len(point.theta))])


def _profile(
    problem: Problem, theta: _Array, best: Point, reduced: list[Reduced]
) -> tuple[_Array, list[_Array]]:
    """Return costs (b,) at the best start values of the linearised problem, and those, (b, windows, k) a record."""
    b = len(theta)
    costs = 0.5 * np.sum((theta / problem.prior_std) ** 2, axis=1)
    costs = costs + 0.5 * np.sum(problem.hover_residual(theta) ** 2, axis=1)
    none, found = np.zeros(theta.shape[1]), []
    for i, (s, r) in enumerate(zip(best.states, reduced, strict=True)):
        e = problem.residual(i, theta, np.repeat(s[None], b, axis=0))
        states = np.empty((b, *s.shape))
        for c in range(b):
            rows = r.rows(e[c], s)
            rest = r.project(rows)
            costs[c] += 0.5 * float(rest @ rest)
            states[c] = s + r.states(rows, none)
        found.append(states)
    return costs, found
