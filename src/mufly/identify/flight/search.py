"""The way to the minimum: windows that grow, noise that is learnt, and a vehicle with its rotors exchanged.

1. Hover (eq. 5.1) alone, with the priors: thrust carries the weight, torques balance.
2. Windows of 0.1, 0.4, 1.5, 3 and 6 s. Before each the batteries' charges are set so that the model's mean voltage is
   the measured one.
3. The whole record (or the windows that are asked for), with rotor speeds, bar and charge at the start free.
4. The noise of every output is taken from the residuals, and 3 repeated, until it stays (Maine and Iliff's relaxation).

At the true parameters the residuals of every stage are the sensors' noise, so each has its minimum near the truth. That
is so because nothing that a window begins with is wrong by more than noise: rotors, battery and bar run through, the
horizontal velocity follows from the measured attitude, and the motors' voltage is the model's own (the measured one,
smoothed and as late as the inputs, falls short of the sag under a chirp of 3 Hz; yaw rates were then off by three times
their noise).

**Rotors exchanged.** A second minimum stays. The two rotors differ in little but their inertias (the upper one
carries the bar, its pole lies at -1.5 rad/s, the lower one's at -4): common motor input makes heave by the sum of the
two lags, which does not change when they change places, and yaw by their difference, whose sign inertia about the
mast, reaction and delay can imitate over a tenth of a second. In windows of 0.1 s the costs of the two differ by 50
of 12 000, in those of 0.4 s by some hundred. A descent does not pass from one to the other, so both are followed: the
vehicle that the first windows found, and the same with the inertias of its rotors exchanged, until their costs tell
them apart. Where they never do, the fit says so, and names what the other one says.

Where a search stands is kept on disk, written after every iteration, so that a stopped fit goes on from its last one:
a JSON file beside the result, replaced as a whole each time (a crash in mid-write leaves the one before). It holds a
digest of the problem, so that a fit does not go on from another one's. The way from the exchanged vehicle is not
kept: it is gone again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.answer_store import hash_question, read_answer, write_answer
from mufly.errors import InputError
from mufly.identify.flight.doubts import ABOVE, above_noise
from mufly.identify.flight.free import physical
from mufly.identify.flight.minimise import Course, Point, descend, evolve
from mufly.identify.flight.problem import Problem
from mufly.identify.flight.starts import LEAST_GAIN, beginnings, settled
from mufly.identify.record import Record

_Array = NDArray[np.float64]
Method = Literal["lm", "cma"]

CHARGING_WINDOW_S = 1.5  # in which the voltage is simulated that sets the battery's charge
_WINDOWS_S = (0.1, 0.4, 1.5, 3.0, 6.0)
_FEWEST_SAMPLES = 8
_FORGET_S = (
    2.0  # in which rotors forget the speed that they began with, which is a guess while parameters are
)
_VOLTAGE_SLACK = 5.0  # voltage counts less while the battery's charge is not sought
_RELAXATIONS = 2
_EXCHANGED = (("Jdrive_up", "Jdrive_dw"), ("Jrot_up", "Jrot_dw"))
_APART = 25.0  # difference of minus log likelihood that decides, over what residuals are above the noise
_SAME = 0.02  # of theta: two ways have come to one place


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
    hover: bool
    iterations: int
    tolerance: float


def stages_of(records: Sequence[Record], method: Method, window_s: float | None) -> list[_Stage]:
    shortest = min(float(r.time_s[-1] - r.time_s[0]) for r in records)
    slowest = max(r.sample_s for r in records)
    top = shortest / 2 if window_s is None else window_s
    iterations = 30 if method == "lm" else 400
    found: list[_Stage] = []
    for length in _WINDOWS_S if method == "lm" else (0.4, 3.0):
        use = max(length, _FEWEST_SAMPLES * slowest)
        if use < top and not (found and use <= (found[-1].window_s or 0.0)):
            found.append(_Stage(f"windows of {use:.2g} s", use, length < 1.0, iterations, 1e-3))
    name = "whole records" if window_s is None else f"windows of {window_s:.3g} s"
    return [*found, _Stage(name, window_s, False, 2 * iterations, 1e-7)]


@dataclass
class _End:
    """What a stage ended with: minus the logarithm of the likelihood, mean square of the residuals, parameters."""

    unlikely: float
    scale: float
    theta: list[float]

    @classmethod
    def of(cls, problem: Problem, point: Point) -> _End:
        count = sum(int(np.isfinite(r.measured).sum()) for r in problem.records)
        noise = sum(
            float(np.isfinite(f.record.measured).sum(axis=0) @ np.log(f.noise)) for f in problem.flights
        )
        return cls(point.cost + noise, 2.0 * point.cost / count, point.theta.tolist())


@dataclass
class _State:
    """What a checkpoint holds of the course of a fit."""

    stage: int = 0
    round: int = 0
    iteration: int = 0
    inside: bool = False  # of the stage, otherwise at its beginning
    first: list[float] | None = (
        None  # theta after the first stage, as long as the exchanged vehicle is not ruled out
    )
    alone: bool = False  # it is, or never was in question
    ends: list[_End] = field(default_factory=list)  # of the stages
    history: list[dict[str, Any]] = field(default_factory=list)
    point: Point | None = None
    noise: list[_Array] | None = None
    charge: list[float] | None = None
    begin: list[_Array] | None = None
    course: Course | None = None


class Run:
    """The course of one fit."""

    def __init__(
        self, final: Problem, stages: list[_Stage], method: Method, seed: int, restarts: int,
        on_progress: Callable[[Progress], None] | None,
    ) -> None:  # fmt: skip
        self._final, self._stages, self._method = final, stages, method
        self._seed, self._restarts, self._on_progress = seed, restarts, on_progress
        self._shortest_s = min(float(r.time_s[-1] - r.time_s[0]) for r in final.records)
        self._place: Path | None = None
        self._digest = ""
        self._ended = (Point(np.zeros(0), [], np.inf), final, False)
        self.state = _State()

    def keep_at(self, place: Path | None, digest: str) -> None:
        """Keep a checkpoint there, and take up what it holds."""
        self._place, self._digest = place, digest
        kept = None if place is None else read_answer(place, digest, damaged=_DAMAGED, other=_OTHER_FIT)
        if kept is not None:
            self.state = _State(**{f.name: kept[f.name] for f in fields(_State)})
            self.state.point = _point_from(kept["point"])
            self.state.ends = [_End(**e) for e in kept["ends"]]
            if kept["noise"] is not None:
                self.state.noise = [np.array(n) for n in kept["noise"]]
            if kept["begin"] is not None:
                self.state.begin = [np.array(b) for b in kept["begin"]]
            if (c := kept["course"]) is not None:
                self.state.course = Course(c["told"], _point_from(c["reference"]), _point_from(c["origin"]))

    def best(self) -> tuple[Point, Problem, bool, tuple[str, ...]]:
        """Run to the end, from the exchanged vehicle too until costs tell them apart; what stays open, in words."""
        doubt = ""
        if len(self._stages) > 1 and self._method == "lm" and not self.state.alone:
            if self.state.first is None:
                self.state.first = self.go(1)[0].theta.tolist()
            other = self._exchanged(np.array(self.state.first))
            for k in range(len(self._stages)):
                if other is None or self.state.alone:
                    break
                self.go(k + 1)
                other.go(k + 1)
                doubt = self._against(other, k)
        point, problem, converged = self.go()
        return point, problem, converged, (doubt,) if doubt else ()

    def _exchanged(self, theta: _Array) -> Run | None:
        """Return a run that begins with the rotors' inertias exchanged; None where they are not free."""
        at = {f.symbol: k for k, f in enumerate(self._final.free)}
        pairs = [(at[a], at[b]) for a, b in _EXCHANGED if a in at and b in at]
        if not pairs:
            return None
        low, high = self._final.bounds
        values, free, there = physical(self._final.free, theta), self._final.free, theta.copy()
        for up, dw in pairs:
            there[up], there[dw] = free[up].theta(values[dw]), free[dw].theta(values[up])
        other = Run(self._final, self._stages, self._method, self._seed, self._restarts, self._on_progress)
        other.state.point = Point(np.clip(there, low, high), [], np.inf)
        return other

    def _against(self, other: Run, k: int) -> str:
        """Go on with the better of two runs that have ended stage ``k``; what stays open after the last, in words."""
        mine, its = self.state.ends[k], other.state.ends[k]
        rise = its.unlikely - mine.unlikely
        there, last = np.array(its.theta) - np.array(mine.theta), k + 1 == len(self._stages)
        same = float(np.max(np.abs(there))) < _SAME
        apart = k > 0 and abs(rise) > _APART * max(1.0, mine.scale, its.scale)
        if not (same or apart or last):
            return ""
        flown = sum(r.state.point.simulations for r in (self, other) if r.state.point is not None)
        if rise < 0.0:
            self.state, self._ended = other.state, other._ended
        self.state.alone = True
        if self.state.point is not None:
            self.state.point = replace(self.state.point, simulations=flown)
            self._ended = (self.state.point, *self._ended[1:])
        if same or apart:
            return ""
        free, worse = self._final.free, np.array((mine if rise < 0.0 else its).theta)
        moved = [k for k, d in enumerate(there) if abs(d) > _SAME]
        values = ", ".join(
            f"{free[k].symbol} {v:.4g}" for k, v in zip(moved, physical(free, worse)[moved], strict=True)
        )
        return (
            f"two minima that these records do not tell apart (logarithm of the likelihood {abs(rise):.1f} apart): the "
            f"other one has {values}, and no interval holds it; fly one motor alone and measure yaw, "
            "`mufly identify plan --channel yaw`"
        )

    def go(self, stages: int | None = None) -> tuple[Point, Problem, bool]:
        """Run from where it stands to the end, or until so many stages are done."""
        for k in range(self.state.stage, len(self._stages) if stages is None else stages):
            self._ended = self._through(k)
            self.state.stage, self.state.round, self.state.inside = k + 1, 0, False
        return self._ended

    def _through(self, k: int) -> tuple[Point, Problem, bool]:
        """Go through stage ``k``, from where it was left if it was."""
        state, stage, final = self.state, self._stages[k], self._final
        last, left = k == len(self._stages) - 1, state.inside
        theta = self._hover_start() if state.point is None else state.point.theta
        flown = 0 if state.point is None else state.point.simulations
        if state.charge is not None:
            final = final.charged(state.charge)
        if not left and any("voltage" in r.outputs for r in final.records):
            final = final.in_windows(CHARGING_WINDOW_S).with_charge(theta).in_windows(None)
            state.charge = [f.charge for f in final.flights]
        problem = final.in_windows(stage.window_s, hover=stage.hover)
        if not last:
            problem = problem.with_noise(_slack(problem))
        if k == 0 and not last:
            problem = replace(problem, blind_s=min(_FORGET_S, self._shortest_s / 4))
        rounds = 1 + (_RELAXATIONS if last else 0)
        for r in range(state.round, rounds):
            if last and state.noise is not None:
                problem = problem.with_noise(state.noise)
            if stage.window_s is not None and k > 0:
                if not left or state.begin is None:
                    state.begin = beginnings(problem, theta)
                problem = problem.begun(state.begin)
            if state.inside and state.point is not None:
                point = state.point
            else:
                states = problem.rest()
                if stage.window_s is None:
                    found = settled(problem, theta)
                    states, flown = found.states, flown + found.simulations
                point = Point(theta, states, np.inf, 1e-2, flown)
            state.round, state.inside, left = r, True, False
            point, converged = self._solve(problem, point, stage, k)
            if last and stage.window_s is None and max(above_noise(problem).values()) > ABOVE:
                point, converged = self._again(problem, point, stage, k, converged)
            state.course, state.iteration, state.point = None, 0, point
            theta, flown = point.theta, point.simulations
            if last and r + 1 < rounds:
                state.noise = _learnt_noise(problem, point)
        state.ends.append(_End.of(problem, point))
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
        hover = self._final.in_windows(None, hover=True)
        if hover.part == "roll-pitch":
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
                write_answer(self._place, self._digest, asdict(state))
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


def digest_of(problem: Problem, method: str) -> str:
    """Return a digest of everything that the course of a fit depends on."""
    parts: list[object] = [method, problem.part, problem.prior, problem.delay_s, f"{problem.free}"]
    for r in problem.records:
        parts += [r.outputs, r.time_s, r.inputs, r.measured]
    return hash_question(*parts, problem.vehicle.model_dump_json())


_DAMAGED = ("is no checkpoint of a fit", "delete it to start anew")
_OTHER_FIT = ("belongs to a fit of other records, parameters or method", "delete it to start anew")


def _point_from(d: dict[str, Any] | None) -> Point:
    if d is None:
        raise InputError("checkpoint", "", "holds no point", "delete it to start anew")
    states = [np.array(s) for s in d["states"]]
    return Point(np.array(d["theta"]), states, d["cost"], d["damping"], d["simulations"])
