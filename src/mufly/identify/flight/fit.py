"""From records to a fit: windows that grow, noise that is learnt, uncertainty, and a look at records not used.

1. Hover (eq. 5.1) alone, with the priors: thrust carries the weight, torques balance.
2. Windows of 0.1, 0.4 and 1.5 s with the measured voltage: from starts 50 % off to a few per cent.
3. The batteries' charges are set so that the model's mean voltage is the measured one; windows of 3 and 6 s.
4. The whole record (or the windows that are asked for), with rotor speeds, bar and charge at the start free.
5. The noise of every output is taken from the residuals, and 4 repeated, until it stays (Maine and Iliff's relaxation).

Held-out records are predicted with the estimates; only their start values are sought in them, because a height that
is an integral of an integral cannot be predicted from a start that is off by a millimetre per second.

Where a fit stands is kept on disk, written after every iteration, so that a stopped fit goes on from its last one: a
JSON file beside the result, replaced as a whole each time (a crash in mid-write leaves the one before). It holds a
digest of the problem, so that a fit does not go on from another one's.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from mufly.errors import ArgumentError, InputError
from mufly.identify.flight.doubts import ABOVE, above_noise, held_in_words, notes_of
from mufly.identify.flight.minimise import (
    Course,
    Linearised,
    Point,
    bend_of_valley,
    descend,
    evolve,
    moved_by_held,
    straightness,
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
from mufly.identify.flight.starts import LEAST_GAIN, beginnings, settled
from mufly.identify.record import (
    INPUTS,
    Record,
    difference_noise,
    units_of,
)
from mufly.identify.result import (
    FAR_OFF,
    Estimate,
    Fit,
    RecordFit,
    coloured_covariance,
    correlation_of,
    relative_covariance,
    unseen_combinations,
    with_estimates,
)
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]
Method = Literal["lm", "cma"]

_CHARGING_WINDOW_S = 1.5  # in which the voltage is simulated that sets the battery's charge
_NORMAL_95 = 1.959964
_SHORT = (0.1, 0.4, 1.5)
_LONG = (3.0, 6.0)
_FEWEST_SAMPLES = 8
_FORGET_S = (
    2.0  # in which rotors forget the speed that they began with, which is a guess while parameters are
)
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


def fit_flights(
    vehicle: Vehicle, free: Sequence[Free], records: Sequence[Record], *, held_out: Sequence[Record] = (),
    part: Part = "both", outputs: Sequence[str] | None = None, voltage: str | float = "model", delay_s: float = 0.0,
    prior: bool = True, held_exact: bool = False, window_s: float | None = None, method: Method = "lm", seed: int = 0,
    restarts: int = 0, checkpoint: Path | None = None, on_progress: Callable[[Progress], None] | None = None,
) -> Fit:  # fmt: skip
    """Fit the flight model to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, their provenance, and all that is not free.
    free : sequence of Free
        See :func:`mufly.identify.choose_free`.
    records, held_out : sequence of Record
        To fit, and to predict afterwards.
    part, outputs, delay_s, prior
        See :func:`mufly.identify.flight.problem.make_problem`.
    voltage : {"model", "measured", "nominal"} or float
        Likewise; "model" is "nominal" where no voltage was recorded, and "measured" for a vehicle whose battery model
        is constant.
    held_exact : bool
        Take what is not free to be known exactly, instead of to its stated standard deviation or that of its source.
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

    Raises
    ------
    InputError
        If no record is given, the records do not hold what is asked for, or the checkpoint is another fit's.

    Thesis: Fig. 5.2; Sec. 5.3.
    """
    if not records:
        raise InputError("records", "", "none is given", "give one at least")
    start = time.perf_counter()
    voltage = _possible_voltage(voltage, vehicle, records)
    options: dict[str, Any] = {"part": part, "outputs": outputs, "delay_s": delay_s, "prior": prior}
    final = make_problem(vehicle, free, records, voltage=voltage, **options)
    known = "measured" if voltage == "model" else voltage
    early = make_problem(vehicle, free, records, voltage=known, **options)
    digest = _digest(final, f"{method} {voltage} {window_s} {seed} {restarts}")
    run = _Run(final, early, _stages(final.records, method, window_s), method, seed, restarts, on_progress)
    run.keep_at(checkpoint, digest)
    # Matrices here are tall and thin: threads of the linear algebra would only wait for those of the simulations.
    with threadpool_limits(limits=1, user_api="blas"):
        point, problem, converged = run.go()
        fit = _outcome(problem, point, run.state.history, _NAMES[method], converged, held_exact)
        held = tuple(_predicted(problem, point.theta, r, voltage, outputs) for r in held_out)
    return replace(fit, records=fit.records + held, seconds=time.perf_counter() - start)


def _possible_voltage(voltage: str | float, vehicle: Vehicle, records: Sequence[Record]) -> str | float:
    """Return ``voltage`` or, where that cannot be had, the next best."""
    if voltage == "model" and any(r.voltage is None for r in records):
        return "nominal"
    return "measured" if voltage == "model" and vehicle.battery.model == "constant" else voltage


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


@dataclass
class _State:
    """What a checkpoint holds of the course of a fit."""

    stage: int = 0
    round: int = 0
    iteration: int = 0
    history: list[dict[str, Any]] = field(default_factory=list)
    point: Point | None = None
    noise: list[_Array] | None = None
    charge: list[float] | None = None
    begin: list[_Array] | None = None
    course: Course | None = None


class _Run:
    """The course of one fit."""

    def __init__(
        self, final: Problem, early: Problem, stages: list[_Stage], method: Method, seed: int, restarts: int,
        on_progress: Callable[[Progress], None] | None,
    ) -> None:  # fmt: skip
        self._final, self._early, self._stages, self._method = final, early, stages, method
        self._seed, self._restarts, self._on_progress = seed, restarts, on_progress
        self._shortest_s = min(float(r.time_s[-1] - r.time_s[0]) for r in final.records)
        self._place: Path | None = None
        self._digest = ""
        self.state = _State()

    def keep_at(self, place: Path | None, digest: str) -> None:
        """Keep a checkpoint there, and take up what it holds."""
        self._place, self._digest = place, digest
        kept = None if place is None else _read_checkpoint(place, digest)
        if kept is not None:
            self.state = _State(**{f.name: kept[f.name] for f in fields(_State)})
            self.state.point = _point_from(kept["point"])
            if kept["noise"] is not None:
                self.state.noise = [np.array(n) for n in kept["noise"]]
            if kept["begin"] is not None:
                self.state.begin = [np.array(b) for b in kept["begin"]]
            if (c := kept["course"]) is not None:
                self.state.course = Course(c["told"], _point_from(c["reference"]), _point_from(c["origin"]))

    def go(self) -> tuple[Point, Problem, bool]:
        """Run from where it stands to the end."""
        state, final, converged = self.state, self._final, True
        theta = self._hover_start() if state.point is None else state.point.theta
        point = Point(theta, [], np.inf)
        flown = 0 if state.point is None else state.point.simulations
        if state.charge is not None:
            final = final.charged(state.charge)
        for k in range(state.stage, len(self._stages)):
            stage = self._stages[k]
            resumed = state.point is not None and k == state.stage
            if not resumed and not stage.early and any("voltage" in r.outputs for r in final.records):
                final = final.in_windows(_CHARGING_WINDOW_S).with_charge(theta).in_windows(None)
                state.charge = [f.charge for f in final.flights]
            last = k == len(self._stages) - 1
            problem = (self._early if stage.early else final).in_windows(stage.window_s, hover=stage.hover)
            if not last:
                problem = problem.with_noise(_slack(problem))
            if k == 0 and not last:
                problem = replace(problem, blind_s=min(_FORGET_S, self._shortest_s / 4))
            rounds = 1 + (_RELAXATIONS if last else 0)
            for r in range(state.round if k == state.stage else 0, rounds):
                if last and state.noise is not None:
                    problem = problem.with_noise(state.noise)
                if stage.window_s is not None and k > 0:
                    if not resumed or state.begin is None:
                        state.begin = beginnings(problem, theta)
                    problem = problem.begun(state.begin)
                if state.point is not None and state.stage == k:
                    point = state.point
                else:
                    states = problem.rest()
                    if stage.window_s is None:
                        found = settled(problem, theta)
                        states, flown = found.states, flown + found.simulations
                    point = Point(theta, states, np.inf, 1e-2, flown)
                resumed = False
                state.stage, state.round = k, r
                point, converged = self._solve(problem, point, stage, k)
                if last and stage.window_s is None and max(above_noise(problem).values()) > ABOVE:
                    point, converged = self._again(problem, point, stage, k, converged)
                state.course, state.iteration, state.point = None, 0, point
                theta, flown = point.theta, point.simulations
                if last and r + 1 < rounds:
                    state.noise = _learnt_noise(problem, point)
        return point, problem, converged

    def _again(
        self, problem: Problem, point: Point, stage: _Stage, k: int, converged: bool
    ) -> tuple[Point, bool]:
        """Solve again if the starts of the records are better sought anew at the parameters that were found."""
        found = settled(problem, point.theta)
        cost = float(problem.cost(point.theta[None], [s[None] for s in found.states])[0])
        flown = point.simulations + found.simulations
        if not cost < point.cost - 1.0:
            return replace(point, simulations=flown), converged
        return self._solve(problem, Point(point.theta, found.states, cost, 1e-2, flown), stage, k)

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
        return np.clip(least_squares(lacks, np.zeros(len(low)), bounds=bounds).x, low, high)

    def _solve(self, problem: Problem, point: Point, stage: _Stage, k: int) -> tuple[Point, bool]:
        def reached(now: Point, course: Course | None = None) -> None:
            state = self.state
            state.iteration, state.point, state.course = state.iteration + 1, now, course
            values = physical(problem.free, now.theta).tolist()
            named = dict(zip([f.symbol for f in problem.free], values, strict=True))
            row = {"iteration": len(state.history) + 1, "cost": now.cost, "stage": stage.what, **named}
            state.history.append(row)
            if self._place is not None:
                _write_checkpoint(self._place, self._digest, state)
            if self._on_progress is not None:
                at, stages = (k + 1, len(self._stages)), stage.iterations
                self._on_progress(Progress(*at, stage.what, state.iteration, stages, now.cost, named))

        if self._method == "lm":
            left = max(2, stage.iterations - self.state.iteration)
            return descend(
                problem, replace(point, damping=min(point.damping, 1e-2)), iterations=left,
                tolerance=stage.tolerance, least_gain=LEAST_GAIN, on_iteration=reached,
            )  # fmt: skip
        return evolve(
            problem, point, seed=self._seed + k, generations=stage.iterations, course=self.state.course,
            restarts=self._restarts, tolerance=1.0 if stage.window_s is not None else 0.01, on_generation=reached,
        )  # fmt: skip


def _slack(problem: Problem) -> list[_Array]:
    return [
        f.noise * np.array([_VOLTAGE_SLACK if o == "voltage" else 1.0 for o in f.record.outputs])
        for f in problem.flights
    ]


def _learnt_noise(problem: Problem, point: Point) -> list[_Array]:
    """Return the noise of every output from the residuals of all records that measure it."""
    square: dict[str, float] = {}
    count: dict[str, int] = {}
    unknown = len(point.theta) + sum(s.size for s in point.states)
    for i, f in enumerate(problem.flights):
        e = problem.residual(i, point.theta[None], point.states[i][None])[0] * f.noise
        for k, o in enumerate(f.record.outputs):
            square[o] = square.get(o, 0.0) + float(e[:, k] @ e[:, k])
            count[o] = count.get(o, 0) + int(np.isfinite(f.record.measured[:, k]).sum())
    keep = 1.0 - min(0.5, unknown / max(sum(count.values()), 1))
    return [np.sqrt([max(square[o], 1e-18) / (count[o] * keep) for o in r.outputs]) for r in problem.records]


def _digest(problem: Problem, method: str) -> str:
    """Return a digest of everything that the course of a fit depends on."""
    h = hashlib.sha256(f"{method} {problem.part} {problem.prior} {problem.delay_s} {problem.free}".encode())
    h.update(problem.vehicle.model_dump_json().encode())
    for r in problem.records:
        h.update(" ".join(r.outputs).encode())
        for a in (r.time_s, r.inputs, r.measured):
            h.update(np.ascontiguousarray(a).tobytes())
    return h.hexdigest()[:32]


def _write_checkpoint(path: Path, digest: str, state: _State) -> None:
    """Write where a fit stands; InputError if the file cannot be written."""
    text = json.dumps({"digest": digest, **asdict(state)}, default=lambda a: a.tolist())
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise InputError(str(path), "", f"cannot be written ({error})", "give another place") from error


def _read_checkpoint(path: Path, digest: str) -> dict[str, Any] | None:
    """Return where the fit of this digest stood, None if it never ran; InputError for a damaged or another's file."""
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


def _point_from(d: dict[str, Any] | None) -> Point:
    if d is None:
        raise InputError("checkpoint", "", "holds no point", "delete it to start anew")
    states = [np.array(s) for s in d["states"]]
    return Point(np.array(d["theta"]), states, d["cost"], d["damping"], d["simulations"])


def _outcome(
    problem: Problem,
    point: Point,
    history: Sequence[dict[str, Any]],
    method: str,
    converged: bool,
    held_exact: bool,
) -> Fit:
    """Return the result of a fit that ended at ``point``; ``method`` in words."""
    free, linear = problem.free, Linearised(problem, point)
    sensitivities = [r.sensitivities() for r in linear.records]
    covariance, _, coloured = coloured_covariance(
        sensitivities, [r.raw for r in linear.records], problem.prior_std
    )
    bend, flown = bend_of_valley(linear)
    covariance = covariance + 2.0 * bend.T @ bend
    held: tuple[Free, ...] = ()
    from_data, moved = np.diag(covariance), np.zeros((len(free), 0))
    if not held_exact:
        moved, wider = moved_by_held(linear)
        covariance, held = covariance + moved @ moved.T, wider.free[len(free) :]
    data = np.concatenate([s.reshape(-1, len(free)) for s in sensitivities])
    # What Gauss and Newton would still gain: at a minimum nothing.
    least, most = problem.bounds
    at_bound = (point.theta <= least + 1e-9) | (point.theta >= most - 1e-9)
    q = np.linalg.qr(linear.jacobian[:, ~at_bound])[0]
    gain = 0.5 * float(np.sum((q.T @ linear.here) ** 2))
    rise, more = straightness(linear)
    notes = notes_of(problem, at_bound, coloured, linear, rise)
    above = above_noise(problem)
    there = gain < 10 * LEAST_GAIN
    if not there:
        notes.insert(0, f"not at a minimum: a linear step promises {gain:.2g} of cost {point.cost:.6g}")
    elif max(above.values()) > FAR_OFF:
        there = False
        notes.insert(0, "the minimum that was found is not that of a flight with this noise")
    std = np.sqrt(np.diag(covariance))
    values = physical(free, point.theta)
    ends = np.sort([physical(free, point.theta + side * _NORMAL_95 * std) for side in (-1, 1)], axis=0)
    slope = np.array([v if f.scale == 0.0 else f.scale for f, v in zip(free, values, strict=True)])
    numbers = np.column_stack([values, np.abs(slope) * std, *ends]).tolist()
    estimates = tuple(
        Estimate(f.symbol, f.key, f.unit, f.start, value, doubt, low, high, bool(held))
        for f, (value, doubt, low, high), held in zip(free, numbers, at_bound, strict=True)
    )
    return Fit(
        vehicle=problem.vehicle.name,
        estimates=estimates,
        covariance=covariance * np.outer(slope, slope),
        correlation=correlation_of(covariance) * np.sign(np.outer(slope, slope)),
        unseen=unseen_combinations([f.symbol for f in free], relative_covariance(data.T @ data), covariance),
        cost=point.cost,
        history=tuple(history),
        method=f"output error, {method}, {problem.part}",
        simulations=point.simulations + flown + more + linear.flights,
        seconds=0.0,
        converged=converged and there,
        message="; ".join(notes) if notes else "converged",
        records=tuple(_record_fit(problem, i, point, "fit") for i in range(len(problem.flights))),
        held=held_in_words(free, held, moved, from_data),
    )


def _record_fit(problem: Problem, i: int, point: Point, role: Literal["fit", "held out"]) -> RecordFit:
    r = problem.records[i]
    predicted = problem.simulate(i, point.theta[None], point.states[i][None])[0]
    return RecordFit(
        r.name, role, r.time_s, r.outputs, units_of(r.outputs), r.measured, predicted, difference_noise(r),
        r.inputs, INPUTS,
    )  # fmt: skip


def _predicted(
    problem: Problem, theta: _Array, record: Record, voltage: str | float, outputs: Sequence[str] | None
) -> RecordFit:
    """Predict a record that the fit did not use, as one window; only its start values are sought in it."""
    own = make_problem(
        problem.vehicle, problem.free, [record], part=problem.part, outputs=outputs, delay_s=problem.delay_s,
        voltage=_possible_voltage(voltage, problem.vehicle, [record]), prior=False,
    )  # fmt: skip
    noise = {
        o: n for f in (*own.flights, *problem.flights) for o, n in zip(f.record.outputs, f.noise, strict=True)
    }
    own = own.with_noise([np.array([noise[o] for o in own.records[0].outputs])])
    own = own.in_windows(_CHARGING_WINDOW_S).with_charge(theta).in_windows(None)
    found = settled(own, theta)
    predicted = _record_fit(own, 0, Point(theta, found.states, np.inf), "held out")
    ratios, doubt = predicted.rms_over_noise(), ""
    worst = int(np.argmax(ratios))
    if not found.converged[0]:
        doubt = f"{record.name}: its start values were not found, so that its prediction says nothing"
    elif ratios[worst] > FAR_OFF:
        doubt = (
            f"{record.name}: {predicted.outputs[worst]} is predicted with an error of {ratios[worst]:.0f} times the "
            "sensor's noise, at the best start that was found; wind or the model"
        )
    return replace(predicted, converged=found.converged[0], doubt=doubt)


def _part_of(f: Free) -> str:
    if f.symbol.startswith("bias_"):
        return "heave-yaw" if f.symbol[5:] in PART_OUTPUTS["heave-yaw"] else "roll-pitch"
    if f.symbol in HEAVE_YAW or f.symbol == "delay":
        return "heave-yaw"
    if f.symbol in ROLL_PITCH:
        return "roll-pitch"
    raise ArgumentError("free", f.symbol, "acts on heave and yaw and on roll and pitch", "fit with part=both")


def fit_split(vehicle: Vehicle, free: Sequence[Free], records: Sequence[Record], **options: Any) -> Fit:
    """Fit heave and yaw, then roll and pitch (thesis Sec. 5.3.3): two small fits instead of one.

    Each sees its own outputs and parameters, and takes the other half of the motion to be absent. Roll and pitch start
    from the vehicle that heave and yaw made, because thrusts and their shares come from there; so does the delay.
    Parameters and options are those of :func:`fit_flights`. Records without an input of the part moving, or without
    its outputs, are left out of it.

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
    return _combined(fits)


def _combined(fits: Sequence[Fit]) -> Fit:
    """Return several fits of different parameters as one; parameters of different fits count as independent."""
    if len(fits) == 1:
        return fits[0]
    history = [row for f in fits for row in f.history]
    records = [r for f in fits for r in f.records]
    return replace(
        fits[0],
        estimates=tuple(e for f in fits for e in f.estimates),
        covariance=block_diag(*[f.covariance for f in fits]),
        correlation=block_diag(*[f.correlation for f in fits]),
        unseen=tuple(u for f in fits for u in f.unseen),
        held=tuple(h for f in fits for h in f.held),
        cost=sum(f.cost for f in fits),
        history=tuple({**row, "iteration": k + 1} for k, row in enumerate(history)),
        method=" then ".join(f.method for f in fits),
        simulations=sum(f.simulations for f in fits),
        seconds=sum(f.seconds for f in fits),
        converged=all(f.converged for f in fits),
        message="; ".join(dict.fromkeys(f.message for f in fits)),
        records=tuple(sorted(records, key=lambda r: r.role != "fit")),
    )
