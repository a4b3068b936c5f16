"""A better rotor within limits, and what each change of it brought.

Differential evolution (Storn and Price, J. Global Optimization 11, 1997; SciPy's, with a seed, so that it
repeats) over what is free, the pitch always included. A generation is evaluated as one batch. The gear, where
free, costs no search: for every candidate it is the one of least power in closed form (``drive.best_gear``).
Airfoils are numbered in the order of a ranking on the rotor at the start, so that neighbours in number are
neighbours in merit. Cases that fail or break a limit count as worse than every case that does not, the more so
the more they break it.

Goals, at a given thrust of each rotor: ``thrust-per-power`` is thrust over electrical power; ``endurance`` is
the time that the drive's battery holds all its rotors (``drive.hover_endurance``). For endurance the gear is
chosen for the battery's low voltage, not its nominal one, because a motor that needs more voltage ends the
hover sooner.

What each change brought: from the rotor at the start, at its own best pitch, the changes are made one after the
other, each time the one that gains most, and the pitch is set anew (quarter of a degree). The gains depend on
that order; they multiply to the whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from mufly.errors import MuflyError
from mufly.rotor import Rotor, replace_rotor
from mufly.study.limits import Limit
from mufly.study.problem import FREE, Goal, Problem, least_thickness_m
from mufly.study.setup import Setup

__all__ = ["FREE", "Goal", "Optimum", "Step", "optimise"]

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

_GENERATIONS = 60
_POPULATION = 12  # times the number of unknowns


@dataclass(frozen=True)
class Step:
    """One change: the parameter, its value (SI or name), the goal after it, and the pitch (rad) that it is best at."""

    parameter: str
    value: float | str
    goal: float
    gain: float
    pitch_rad: float


@dataclass(frozen=True)
class Optimum:
    """A better rotor.

    Attributes
    ----------
    rotor : Rotor
    pitch_rad : float
    changes : dict
        Parameters that differ from the start, in SI units; the gear as found.
    goal : str
    before, after : float
        The goal (N/W or s) at the start, at its best pitch, and now.
    steps : tuple of Step
        From the start to the end.
    results : dict
        What :func:`mufly.study.evaluate` answers for the better rotor, ``least_thickness_m`` and ``endurance_s``.
    """

    rotor: Rotor
    pitch_rad: float
    changes: dict[str, float | str]
    goal: str
    before: float
    after: float
    steps: tuple[Step, ...]
    results: dict[str, float]


def optimise(
    setup: Setup,
    goal: Goal,
    free: Sequence[str],
    *,
    limits: Sequence[Limit] = (),
    airfoils: Sequence[str] = (),
    seed: int = 0,
    generations: int = _GENERATIONS,
    progress: Progress | None = None,
) -> Optimum:
    """Search for a better rotor.

    Parameters
    ----------
    setup : Setup
        Rotor to start from, drive, and ``thrust`` among what is fixed.
    goal : {'thrust-per-power', 'endurance'}
    free : sequence of str
        What may change, of :data:`FREE`; the pitch always may, unless it is fixed.
    limits : sequence of Limit
        From :func:`mufly.study.limits.parse_limit`; without, the ranges of :data:`mufly.study.limits.RANGES`.
    airfoils : sequence of str
        Candidates, if the airfoil is free.
    seed : int
        Same seed, same answer.
    generations : int
        How long to search.
    progress : callable, optional
        ``progress(done, total)``, in generations.

    Raises
    ------
    InputError
        If something is not free, fixed or limited in a way that makes sense.
    MuflyError
        If no candidate meets the limits.
    """
    problem = Problem(setup, goal, tuple(free), tuple(limits), list(airfoils))
    names, low, high, whole = problem.space()
    done = 0

    def cost(x: Array) -> Array:
        return problem.cost(names, np.atleast_2d(x.T))

    def after_generation(*_: Any, **__: Any) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, generations), generations)

    search: Callable[..., Any] = differential_evolution  # its types know no vectorised function
    found = search(
        cost, list(zip(low, high, strict=True)), integrality=whole, rng=np.random.default_rng(seed),
        maxiter=generations, popsize=_POPULATION, tol=1e-6, mutation=(0.4, 0.9), recombination=0.8, polish=False,
        vectorized=True, updating="deferred", init="sobol", callback=after_generation,
    )  # fmt: skip
    best = problem.case(names, found.x)
    if found.fun >= problem.BROKEN:
        raise MuflyError(f"no rotor within the limits was found; the best one breaks: {problem.why(best)}")
    return _report(problem, best)


def _report(problem: Problem, best: dict[str, float | str]) -> Optimum:
    """Walk from the start to the best case, the greatest gain first."""
    changes = {k: v for k, v in best.items() if k != "pitch"}
    before, _ = problem.at_best_pitch({}, True)
    goal, values, _ = problem.goals([best])
    after = float(goal[0])
    left, at, own = list(changes), before, "gear" in problem.free
    made: dict[str, float | str] = {}
    if own:
        left.append("gear")
    steps: list[Step] = []
    while left:
        tried = []
        for name in left:
            case = made if name == "gear" else {**made, name: changes[name]}
            reached, pitch = problem.at_best_pitch(case, own and name != "gear")
            tried.append((reached if math.isfinite(reached) else -math.inf, name, pitch))
        reached, name, pitch = max(tried, key=lambda t: t[0])
        if len(left) == 1:  # the last step ends where the search ended, at its own pitch
            reached, pitch = after, float(best.get("pitch", pitch))
        value: float | str = float(values["gear_ratio"][0]) if name == "gear" else changes[name]
        steps.append(Step(name, value, reached, reached / at - 1.0 if at > 0 else math.nan, pitch))
        at = reached
        left.remove(name)
        if name == "gear":
            own = False
        else:
            made = {**made, name: changes[name]}
    rotor = replace_rotor(problem.rotor(best), {"name": f"{problem.setup.rotor.name}-optimised"})
    results = {k: float(v[0]) for k, v in values.items() if k != "outside_share"}
    results["least_thickness_m"] = least_thickness_m(rotor)
    if "gear" in problem.free:
        changes["gear"] = results["gear_ratio"]
    pitch = float(best.get("pitch", problem.setup.fixed.get("pitch", math.nan)))
    return Optimum(rotor, pitch, changes, problem.goal, before, after, tuple(steps), results)
