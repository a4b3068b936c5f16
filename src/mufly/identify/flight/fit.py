"""From the point where a fit ended to its result: noise, intervals, what is not seen, warnings, predictions."""

from __future__ import annotations

import hashlib
import json
import os
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
from mufly.identify.covariance import (
    coloured_covariance,
    correlation_of,
    relative_covariance,
    unseen_combinations,
)
from mufly.identify.flight.minimise import (
    Course,
    Point,
    bend_of_valley,
    descend,
    evolve,
    flights_of,
    reduce_record,
    stacked_jacobian,
)
from mufly.identify.flight.problem import (
    HEAVE_YAW,
    PART_OUTPUTS,
    ROLL_PITCH,
    Free,
    Part,
    Problem,
    make_problem,
    physical,
)
from mufly.identify.record import INPUTS, Record, difference_noise, units_of
from mufly.identify.result import Estimate, Fit, RecordFit, with_estimates
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]

LEAST_GAIN = 0.01  # of cost: a tenth of a standard deviation
CHARGING_WINDOW_S = 1.5  # in which the voltage is simulated that sets the battery's charge
_NORMAL_95 = 1.959964


def possible_voltage(voltage: str | float, vehicle: Vehicle, records: Sequence[Record]) -> str | float:
    """Return ``voltage`` or, where that cannot be had, the next best."""
    if voltage == "model" and any(r.voltage is None for r in records):
        return "nominal"
    return "measured" if voltage == "model" and vehicle.battery.model == "constant" else voltage


def learnt_noise(problem: Problem, point: Point) -> list[_Array]:
    """Return the noise of every output from the residuals of all records that measure it."""
    square: dict[str, float] = {}
    count: dict[str, int] = {}
    total = unknown = 0
    for i, r in enumerate(problem.records):
        e = problem.residual(i, point.theta[None], point.states[i][None])[0] * problem.noise[i]
        unknown += point.states[i].size
        for k, o in enumerate(r.outputs):
            n = int(np.isfinite(r.measured[:, k]).sum())
            square[o] = square.get(o, 0.0) + float(e[:, k] @ e[:, k])
            count[o] = count.get(o, 0) + n
            total += n
    keep = 1.0 - min(0.5, (unknown + len(point.theta)) / max(total, 1))
    return [np.sqrt([max(square[o], 1e-18) / (count[o] * keep) for o in r.outputs]) for r in problem.records]


def outcome(
    problem: Problem,
    point: Point,
    history: Sequence[dict[str, Any]],
    method: str,
    converged: bool,
    seconds: float,
) -> Fit:
    """Return the result of a fit that ended at ``point``; ``method`` in words."""
    free, sensitivities, residuals, reduced, records = problem.free, [], [], [], []
    for i, _r in enumerate(problem.records):
        linear = problem.linearise(i, point.theta, point.states[i])
        red = reduce_record(problem, i, linear, point.states[i])
        reduced.append(red)
        _n, m = linear.residual.shape
        rows, k = [], 0
        for a, b, *_ in red.back:
            rows.append(red.jacobian[k : k + (b - a) * m].reshape(b - a, m, -1))
            k += (b - a) * m + len(red.spread)
        sensitivities.append(np.concatenate(rows))
        residuals.append(linear.residual)
        records.append(_record_fit(problem, i, point, "fit"))
    covariance, _, coloured = coloured_covariance(sensitivities, residuals, problem.prior_std)
    bend = bend_of_valley(problem, point, reduced)
    flown = point.simulations + flights_of(problem)
    flown += sum(1 + len(free) + s.shape[1] for s in point.states)
    covariance = covariance + 2.0 * bend.T @ bend
    data = np.concatenate([s.reshape(-1, len(free)) for s in sensitivities])
    # What Gauss and Newton would still gain: at a minimum nothing.
    jacobian = stacked_jacobian(problem, point.theta, reduced)
    rest = np.concatenate([*(r.residual for r in reduced), point.theta / problem.prior_std])
    low, high = problem.bounds
    at_bound = (point.theta <= low + 1e-9) | (point.theta >= high - 1e-9)
    q = np.linalg.qr(jacobian[:, ~at_bound])[0]
    gain = 0.5 * float(np.sum((q.T @ rest) ** 2))
    notes = _notes(problem, point, free, at_bound, coloured)
    settled = gain < 10 * LEAST_GAIN
    if not settled:
        notes.insert(0, f"not at a minimum: a linear step promises {gain:.2g} of cost {point.cost:.6g}")
    std = np.sqrt(np.diag(covariance))
    values = physical(free, point.theta)
    ends = [physical(free, point.theta + side * _NORMAL_95 * std) for side in (-1, 1)]
    slope = np.array([v if f.scale == 0.0 else f.scale for f, v in zip(free, values, strict=True)])
    estimates = tuple(
        Estimate(
            f.symbol, f.key, f.unit, f.start, float(values[k]), float(abs(slope[k]) * std[k]),
            float(min(ends[0][k], ends[1][k])), float(max(ends[0][k], ends[1][k])), bool(at_bound[k]),
        )
        for k, f in enumerate(free)
    )  # fmt: skip
    return Fit(
        vehicle=problem.vehicle.name,
        estimates=estimates,
        covariance=covariance * np.outer(slope, slope),
        correlation=correlation_of(covariance) * np.sign(np.outer(slope, slope)),
        unseen=unseen_combinations([f.symbol for f in free], relative_covariance(data.T @ data), covariance),
        cost=point.cost,
        history=tuple(history),
        method=f"output error, {method}, {problem.part}",
        simulations=flown,
        seconds=seconds,
        converged=converged and settled,
        message="; ".join(notes) if notes else "converged",
        records=tuple(records),
    )


def _notes(
    problem: Problem, point: Point, free: Sequence[Free], at_bound: NDArray[np.bool_], coloured: bool
) -> list[str]:
    """Return what a reader of the estimates has to know."""
    notes = [
        f"{f.symbol} stopped at its bound: its interval does not hold"
        for f, b in zip(free, at_bound, strict=True) if b
    ]  # fmt: skip
    ratios: dict[str, float] = {}
    for r, n in zip(problem.records, problem.noise, strict=True):
        for o, ratio in zip(r.outputs, n / difference_noise(r), strict=True):
            ratios[o] = max(ratios.get(o, 0.0), float(ratio))
    large = [f"{o} ({v:.1f} times)" for o, v in ratios.items() if v > 1.5]
    if large:
        notes.append(
            f"residuals above the sensor noise: {', '.join(large)}; wind or the model; try --window 3"
        )
    if coloured:
        notes.append("residuals are coloured; the intervals account for it")
    return notes


def _record_fit(problem: Problem, i: int, point: Point, role: Literal["fit", "held out"]) -> RecordFit:
    r = problem.records[i]
    predicted = problem.simulate(i, point.theta[None], point.states[i][None])[0]
    return RecordFit(
        r.name, role, r.time_s, r.outputs, units_of(r.outputs), r.measured, predicted, difference_noise(r),
        r.inputs, INPUTS,
    )  # fmt: skip


def predict(
    problem: Problem, theta: _Array, record: Record, voltage: str | float, outputs: Sequence[str] | None
) -> RecordFit:
    """Predict a record that the fit did not use, as one window; only its start values are sought in it.

    Parameters
    ----------
    problem : Problem
        Of the fit: parameters, part, noise.
    theta : (t,) array
    record : Record
    voltage, outputs
        As in :func:`fit_flights`.
    """
    voltage = possible_voltage(voltage, problem.vehicle, [record])
    own = make_problem(
        problem.vehicle, problem.free, [record], part=problem.part, outputs=outputs, voltage=voltage,
        delay_s=problem.delay_s, prior=False, longest_step_s=problem.longest_step_s,
    )  # fmt: skip
    noise = {
        o: n
        for r, ns in zip(problem.records, problem.noise, strict=True)
        for o, n in zip(r.outputs, ns, strict=True)
    }
    guess = dict(zip(own.records[0].outputs, own.noise[0], strict=True))
    own = own.with_noise([np.array([noise.get(o, guess[o]) for o in own.records[0].outputs])])
    own = own.in_windows(CHARGING_WINDOW_S).with_charge(theta).in_windows(None)
    held = replace(
        own, free=tuple(replace(f, low=t, high=t) for f, t in zip(own.free, theta, strict=True))
    )  # fmt: skip
    point, _ = descend(held, Point(theta, held.rest(), np.inf), iterations=25, tolerance=1e-6)
    return _record_fit(held, 0, point, "held out")


# ----------------------------------------------------------------------------
# Where a fit stands, on disk: written after every iteration, so that a stopped fit goes on from its last one.
#
# A JSON file beside the result, replaced as a whole each time (a crash in mid-write leaves the one before). It holds
# a
# digest of the problem, so that a fit does not go on from another one's.


def digest_of(problem: Problem, method: str) -> str:
    """Return a digest of everything that the course of a fit depends on."""
    h = hashlib.sha256(f"{method} {problem.part} {problem.prior} {problem.delay_s} {problem.free}".encode())
    h.update(problem.vehicle.model_dump_json().encode())
    for r in problem.records:
        h.update(" ".join(r.outputs).encode())
        for a in (r.time_s, r.inputs, r.measured):
            h.update(np.ascontiguousarray(a).tobytes())
    return h.hexdigest()[:32]


def write_checkpoint(path: Path, digest: str, state: dict[str, Any]) -> None:
    """Write where a fit stands; arrays become lists.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    text = json.dumps({"digest": digest, **state}, default=lambda a: a.tolist())
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise InputError(str(path), "", f"cannot be written ({error})", "give another place") from error


def read_checkpoint(path: Path, digest: str) -> dict[str, Any] | None:
    """Return where the fit of this digest stood; None if it never ran.

    Raises
    ------
    InputError
        If the file is damaged or belongs to another fit.
    """
    if not path.exists():
        return None
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        found = state["digest"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(str(path), "", "is no checkpoint of a fit", "delete it to start anew") from error
    if found != digest:
        raise InputError(
            str(path), "", "belongs to a fit of other records, parameters or method", "delete it to start anew"
        )  # fmt: skip
    return dict(state)


# ----------------------------------------------------------------------------
# From records to a fit: windows that grow, noise that is learnt, uncertainty, and a look at records not used.
#
# 1. Hover (eq. 5.1) alone, with the priors: thrust carries the weight, torques balance.
# 2. Windows of 0.1, 0.4 and 1.5 s with the measured voltage: from starts 50 % off to a few per cent.
# 3. The batteries' charges are set so that the model's mean voltage is the measured one; windows of 3 and 6 s.
# 4. The whole record (or the windows that are asked for), with rotor speeds, bar and charge at the start free.
# 5. The noise of every output is taken from the residuals, and 4 repeated, until it stays (Maine and Iliff's
# relaxation).
#
# Held-out records are predicted with the estimates; only their start values are sought in them, because a height that
# is an integral of an integral cannot be predicted from a start that is off by a millimetre per second.


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


# ----------------------------------------------------------------------------
# Heave and yaw first, then roll and pitch (thesis Sec. 5.3.3): two small fits instead of one.
#
# Each sees its own outputs and parameters, and takes the other half of the motion to be absent. Roll and pitch start
# from the vehicle that heave and yaw made, because thrusts and their shares come from there; so does the delay.


def _part_of(f: Free) -> str:
    if f.symbol.startswith("bias_"):
        return "heave-yaw" if f.symbol[5:] in PART_OUTPUTS["heave-yaw"] else "roll-pitch"
    if f.symbol in HEAVE_YAW or f.symbol == "delay":
        return "heave-yaw"
    if f.symbol in ROLL_PITCH:
        return "roll-pitch"
    raise InputError(
        "--free", f.symbol, "acts on heave and yaw and on roll and pitch", "fit with --part both"
    )


def fit_split(vehicle: Vehicle, free: Sequence[Free], records: Sequence[Record], **options: Any) -> Fit:
    """Fit heave and yaw, then roll and pitch; parameters and options are those of :func:`fit_flights`.

    Records without an input of the part moving, or without its outputs, are left out of it.

    Raises
    ------
    InputError
        If a parameter acts on both halves.
    """
    fits: list[Fit] = []
    checkpoint = options.pop("checkpoint", None)
    delay = options.pop("delay_s", 0.0)
    held_out = options.pop("held_out", ())
    for part, columns in (("heave-yaw", slice(0, 2)), ("roll-pitch", slice(2, 4))):
        own = [f for f in free if _part_of(f) == part]
        if not own:
            continue

        def shows(r: Record, part: str = part, columns: slice = columns) -> bool:
            moves = float(np.max(np.std(r.inputs[:, columns], axis=0))) > 0.01
            return moves and bool(set(r.outputs) & (set(PART_OUTPUTS[part]) - {"voltage"}))

        used = [r for r in records if shows(r)]
        if not used:
            raise InputError(
                "records", part, "no record moves these inputs", "fly them, or free other parameters"
            )
        fit = fit_flights(
            vehicle, own, used, part=part, delay_s=delay, held_out=[r for r in held_out if shows(r)],  # type: ignore[arg-type]
            checkpoint=None if checkpoint is None else checkpoint.with_name(f"{checkpoint.name}.{part}"), **options,
        )  # fmt: skip
        fits.append(fit)
        if any(e.key for e in fit.estimates):
            vehicle = with_estimates(vehicle, fit.estimates, "heave and yaw")
        delay = next((e.value for e in fit.estimates if e.symbol == "delay"), delay)
    return combined(fits)


def combined(fits: Sequence[Fit]) -> Fit:
    """Return several fits of different parameters as one; parameters of different fits count as independent."""
    if len(fits) == 1:
        return fits[0]
    size = [len(f.estimates) for f in fits]
    covariance, correlation = np.zeros((sum(size), sum(size))), np.eye(sum(size))
    at = 0
    history: list[dict[str, Any]] = []
    for f, n in zip(fits, size, strict=True):
        covariance[at : at + n, at : at + n] = f.covariance
        correlation[at : at + n, at : at + n] = f.correlation
        at += n
        history += [{**row, "iteration": len(history) + k + 1} for k, row in enumerate(f.history)]
    records = [r for f in fits for r in f.records]
    return replace(
        fits[0],
        estimates=tuple(e for f in fits for e in f.estimates),
        covariance=covariance,
        correlation=correlation,
        unseen=tuple(u for f in fits for u in f.unseen),
        cost=sum(f.cost for f in fits),
        history=tuple(history),
        method=" then ".join(f.method for f in fits),
        simulations=sum(f.simulations for f in fits),
        seconds=sum(f.seconds for f in fits),
        converged=all(f.converged for f in fits),
        message="; ".join(dict.fromkeys(f.message for f in fits)),
        records=tuple(sorted(records, key=lambda r: r.role != "fit")),
    )
