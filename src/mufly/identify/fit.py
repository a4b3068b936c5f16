"""From records to a fit: windows that grow, noise that is learnt, uncertainty, and a look at records not used.

1. Hover (eq. 5.1) alone, with the priors: thrust carries the weight, torques balance.
2. Windows of 0.1, 0.4 and 1.5 s with the measured voltage: from starts 50 % off to a few per cent.
3. The batteries' charges are set so that the model's mean voltage is the measured one; windows of 3 and 6 s.
4. The whole record (or the windows that are asked for), with rotor speeds, bar and charge at the start free.
5. The noise of every output is taken from the residuals, and 4 repeated, until it stays (Maine and Iliff's relaxation).

Held-out records are predicted with the estimates; only their start values are sought in them, because a height that
is an integral of an integral cannot be predicted from a start that is off by a millimetre per second.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from mufly.errors import InputError
from mufly.identify.checkpoint import digest_of, read_checkpoint, write_checkpoint
from mufly.identify.evolution import Course, evolve
from mufly.identify.free import Free, physical
from mufly.identify.levenberg import Point, descend
from mufly.identify.outcome import (
    CHARGING_WINDOW_S,
    LEAST_GAIN,
    learnt_noise,
    outcome,
    possible_voltage,
    predict,
)
from mufly.identify.problem import Part, Problem, make_problem
from mufly.identify.record import Record
from mufly.identify.result import Fit
from mufly.vehicle import Vehicle

__all__ = ["Method", "Progress", "fit_flights"]

_Array = NDArray[np.float64]
Method = Literal["lm", "cma"]

_SHORT = (0.1, 0.4, 1.5)
_LONG = (3.0, 6.0)
_FEWEST_SAMPLES = 8
_VOLTAGE_SLACK = 5.0  # voltage counts less while the battery's charge is not sought
_RELAXATIONS = 2
_NAMES = {"lm": "Levenberg-Marquardt on growing windows", "cma": "CMA-ES on growing windows"}


@dataclass(frozen=True)
class Progress:
    """Where a fit stands: stage ``stage`` of ``stages``, ``iteration`` in it of at most ``iterations``."""

    stage: int
    stages: int
    what: str
    iteration: int
    iterations: int
    cost: float
    values: dict[str, float]


@dataclass(frozen=True)
class _Stage:
    what: str
    window_s: float | None
    early: bool
    hover: bool
    iterations: int
    tolerance: float


def _stages(records: Sequence[Record], method: Method, window_s: float | None) -> list[_Stage]:
    shortest = min(float(r.time_s[-1] - r.time_s[0]) for r in records)
    slowest = max(r.sample_s for r in records)
    top = shortest / 2 if window_s is None else window_s
    iterations = 30 if method == "lm" else 400
    found: list[_Stage] = []
    for length in (*_SHORT, *_LONG) if method == "lm" else (0.4, 3.0):
        use = max(length, _FEWEST_SAMPLES * slowest)
        if use < top and not (found and use <= (found[-1].window_s or 0.0)):
            early = length <= _SHORT[-1]
            found.append(_Stage(f"windows of {use:.2g} s", use, early, length < 1.0, iterations, 1e-3))
    name = "whole records" if window_s is None else f"windows of {window_s:.3g} s"
    return [*found, _Stage(name, window_s, False, False, 2 * iterations, 1e-7)]


def fit_flights(
    vehicle: Vehicle,
    free: Sequence[Free],
    records: Sequence[Record],
    *,
    held_out: Sequence[Record] = (),
    part: Part = "both",
    outputs: Sequence[str] | None = None,
    voltage: str | float = "model",
    delay_s: float = 0.0,
    prior: bool = True,
    window_s: float | None = None,
    method: Method = "lm",
    seed: int = 0,
    restarts: int = 0,
    checkpoint: Path | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Fit:
    """Fit the flight model to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, their provenance, and all that is not free.
    free : sequence of Free
        See :func:`mufly.identify.choose_free`.
    records, held_out : sequence of Record
        To fit, and to predict afterwards.
    part : {"both", "heave-yaw", "roll-pitch"}
    outputs : sequence of str, optional
        Use these of the measured outputs only.
    voltage : {"model", "measured", "nominal"} or float
        See :func:`mufly.identify.make_problem`. "model" is "nominal" where no voltage was recorded, and "measured"
        for a vehicle whose battery model is constant.
    delay_s : float
        Time from recorded input to vehicle (s).
    prior : bool
        Let the provenance of the start values weigh in.
    window_s : float, optional
        Last stage in windows of this length (s) instead of whole records.
    method : {"lm", "cma"}
        Levenberg-Marquardt or CMA-ES.
    seed, restarts : int
        Of CMA-ES.
    checkpoint : Path, optional
        File that is written every iteration; if it exists the fit goes on from it.
    on_progress : callable, optional
        Called every iteration.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If no record is given, the records do not hold what is asked for, or the checkpoint is another fit's.
    """
    if not records:
        raise InputError("records", "", "none is given", "give one at least")
    start = time.perf_counter()
    voltage = possible_voltage(voltage, vehicle, records)
    options: dict[str, Any] = {"part": part, "outputs": outputs, "delay_s": delay_s, "prior": prior}
    final = make_problem(vehicle, free, records, voltage=voltage, **options)
    early = make_problem(
        vehicle, free, records, voltage="measured" if voltage == "model" else voltage, **options
    )
    digest = digest_of(final, f"{method} {voltage} {window_s} {seed} {restarts}")
    stages = _stages(final.records, method, window_s)
    run = _Run(final, early, stages, method, seed, restarts, checkpoint, digest, on_progress)
    run.resume()
    # Matrices here are tall and thin: threads of the linear algebra would only wait for those of the simulations.
    with threadpool_limits(limits=1, user_api="blas"):
        point, problem, converged = run.go()
        fit = outcome(problem, point, run.history, _NAMES[method], converged, time.perf_counter() - start)
        held = tuple(predict(problem, point.theta, r, voltage, outputs) for r in held_out)
    return replace(fit, records=fit.records + held, seconds=time.perf_counter() - start)


class _Run:
    """The course of one fit: what a checkpoint has to hold."""

    def __init__(
        self, final: Problem, early: Problem, stages: list[_Stage], method: Method, seed: int, restarts: int,
        checkpoint: Path | None, digest: str, on_progress: Callable[[Progress], None] | None,
    ) -> None:  # fmt: skip
        self._final, self._early, self._stages, self._method = final, early, stages, method
        self._seed, self._restarts, self._checkpoint, self._digest = seed, restarts, checkpoint, digest
        self._on_progress = on_progress
        self.history: list[dict[str, Any]] = []
        self.message = ""
        self._stage = self._round = self._iteration = 0
        self._point: Point | None = None
        self._noise: list[_Array] | None = None
        self._course: Course | None = None
        self._charge: list[float] | None = None

    def resume(self) -> None:
        """Take up what a checkpoint holds."""
        state = None if self._checkpoint is None else read_checkpoint(self._checkpoint, self._digest)
        if state is None:
            return
        self._stage, self._round, self._iteration = state["stage"], state["round"], state["iteration"]
        self.history, self._point = state["history"], _point_from(state["point"])
        self._charge = state["charge"]
        if state["noise"] is not None:
            self._noise = [np.array(n) for n in state["noise"]]
        if state["course"] is not None:
            c = state["course"]
            self._course = Course(c["told"], _point_from(c["reference"]), _point_from(c["origin"]))

    def go(self) -> tuple[Point, Problem, bool]:
        """Run from where it stands to the end."""
        theta = self._hover_start() if self._point is None else self._point.theta
        point = Point(theta, [], np.inf)
        flown = 0 if self._point is None else self._point.simulations
        final, converged = self._final, True
        if self._charge is not None:
            final = final.charged(self._charge)
        for k in range(self._stage, len(self._stages)):
            stage = self._stages[k]
            resumed = self._point is not None and k == self._stage
            if not resumed and not stage.early and "voltage" in {o for r in final.records for o in r.outputs}:
                final = final.in_windows(CHARGING_WINDOW_S).with_charge(theta).in_windows(None)
                self._charge = list(final.charge)
            last = k == len(self._stages) - 1
            problem = (self._early if stage.early else final).in_windows(stage.window_s, hover=stage.hover)
            if not last:
                problem = problem.with_noise(_slack(problem))
            rounds = 1 + (_RELAXATIONS if last else 0)
            for r in range(self._round if k == self._stage else 0, rounds):
                if last and self._noise is not None:
                    problem = problem.with_noise(self._noise)
                point = Point(theta, problem.rest(), np.inf, 1e-2, flown)
                if self._point is not None and self._stage == k:
                    point = self._point
                self._stage, self._round = k, r
                point, converged = self._solve(problem, point, stage, k)
                self._course, self._iteration, self._point = None, 0, point
                theta, flown = point.theta, point.simulations
                if last and r + 1 < rounds:
                    self._noise = learnt_noise(problem, point)
        return point, problem, converged

    def _hover_start(self) -> _Array:
        hover = self._early.in_windows(None, hover=True)
        if self._early.part == "roll-pitch":
            return np.zeros(len(hover.free))
        low, high = hover.bounds
        # Wide priors keep what hover does not see where it was.
        std = np.minimum(hover.prior_std, 1.0)

        def lacks(t: _Array) -> _Array:
            return np.concatenate([hover.hover_residual(t[None])[0], t / std])

        bounds = (np.minimum(low, -1e-9), np.maximum(high, 1e-9))
        found = least_squares(lacks, np.zeros(len(low)), bounds=bounds)
        return np.clip(found.x, low, high)

    def _solve(self, problem: Problem, point: Point, stage: _Stage, k: int) -> tuple[Point, bool]:
        def reached(now: Point, course: Course | None = None) -> None:
            self._iteration += 1
            self._point = now
            values = physical(problem.free, now.theta)
            named = {f.symbol: float(v) for f, v in zip(problem.free, values, strict=True)}
            row = {"iteration": len(self.history) + 1, "cost": now.cost, "stage": stage.what, **named}
            self.history.append(row)
            if self._checkpoint is not None:
                write_checkpoint(self._checkpoint, self._digest, self._state(course))
            if self._on_progress is not None:
                self._on_progress(
                    Progress(
                        k + 1,
                        len(self._stages),
                        stage.what,
                        self._iteration,
                        stage.iterations,
                        now.cost,
                        named,
                    )
                )

        if self._method == "lm":
            left = max(2, stage.iterations - self._iteration)
            return descend(
                problem, replace(point, damping=min(point.damping, 1e-2)), iterations=left,
                tolerance=stage.tolerance, least_gain=LEAST_GAIN, on_iteration=reached,
            )  # fmt: skip
        loose = stage.window_s is not None
        return evolve(
            problem, point, seed=self._seed + k, generations=stage.iterations, course=self._course,
            restarts=self._restarts, tolerance=1.0 if loose else 0.01, on_generation=reached,
        )  # fmt: skip

    def _state(self, course: Course | None) -> dict[str, Any]:
        told = None
        if course is not None:
            told = {
                "told": course.told,
                "reference": _plain(course.reference),
                "origin": _plain(course.origin),
            }
        return {
            "stage": self._stage, "round": self._round, "iteration": self._iteration, "history": self.history,
            "point": _plain(self._point), "noise": self._noise, "charge": self._charge, "course": told,
        }  # fmt: skip


def _plain(p: Point | None) -> dict[str, Any] | None:
    return None if p is None else dict(vars(p))


def _point_from(d: dict[str, Any] | None) -> Point:
    if d is None:
        raise InputError("checkpoint", "", "holds no point", "delete it to start anew")
    return Point(
        np.array(d["theta"]), [np.array(s) for s in d["states"]], d["cost"], d["damping"], d["simulations"]
    )


def _slack(problem: Problem) -> list[_Array]:
    return [
        n * np.array([_VOLTAGE_SLACK if o == "voltage" else 1.0 for o in r.outputs])
        for r, n in zip(problem.records, problem.noise, strict=True)
    ]
