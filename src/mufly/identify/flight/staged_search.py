"""Staged search for the minimum of a flight fit: growing windows, estimation of noise, two starts.

1. Hover (eq. 5.1) alone, with the priors: thrust equals weight, and the torques balance.
2. Windows of 0.1, 0.4, 1.5, 3 and 6 s. Before each stage the batteries' charges are set so that the model's mean
   voltage equals the measured mean.
3. The whole record (or windows of a given length), with free initial rotor speeds, bar tilt and charge.
4. The noise of every output is estimated from the residuals and stage 3 repeated (Maine and Iliff's relaxation).

At the true parameters the residuals of every stage are sensor noise, so each stage has its minimum near the truth.
The reason is that no initial state of a window is wrong by more than noise. Rotors, battery and bar continue through
all windows, and the horizontal velocity follows from the measured attitude. The motor voltage comes from the model:
the smoothed and delayed measured voltage does not follow the sag under a chirp of 3 Hz.

**Exchanged rotors.** A second minimum exists, because the two rotors differ mainly in their inertias (poles at
-1.5 rad/s for the upper rotor with the bar, -4 rad/s for the lower rotor). Common motor input causes heave by the sum
of the two lags, which an exchange does not change. It causes yaw by their difference, whose sign the yaw inertia, the
reaction torque and the delay can imitate over 0.1 s. In windows of 0.1 s the two costs differ by 50 of 12 000, in
windows of 0.4 s by about a hundred. Descent does not pass from one minimum to the other, so the search follows both:
the vehicle from the first windows, and the same vehicle with exchanged rotor inertias. It stops the worse search when
the costs differ decisively. If they never do, the fit reports the ambiguity and the other estimates.

A checkpoint on disk holds the state of the search after every iteration, so that a stopped fit can resume. It is a
JSON file beside the result and is replaced atomically. It holds a digest of the problem, so that a fit does not
resume from the checkpoint of another fit. The search from the exchanged vehicle is not stored and is repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.errors import InputError
from mufly.files.answer_store import hash_inputs, read_stored_result, write_stored_result
from mufly.identify.flight.estimate_notes import MAX_RESIDUAL_NOISE_RATIO, residual_over_noise
from mufly.identify.flight.free_parameters import theta_to_values
from mufly.identify.flight.initial_states import MIN_COST_DECREASE, find_initial_offsets, find_initial_states
from mufly.identify.flight.minimisers import EvolutionHistory, FitPoint, levenberg_marquardt, run_cma_es
from mufly.identify.flight.output_error_problem import OutputErrorProblem
from mufly.identify.flight_record import FlightRecord

_Array = NDArray[np.float64]
FitMethod = Literal["lm", "cma"]

CHARGE_MATCHING_WINDOW_S = 1.5  # window length of the simulated voltage that sets the battery charge
_WINDOW_LENGTHS_S = (0.1, 0.4, 1.5, 3.0, 6.0)
_MIN_WINDOW_SAMPLES = 8
_ROTOR_TRANSIENT_S = 2.0  # decay time of errors of the initial rotor speeds
_VOLTAGE_NOISE_FACTOR = 5.0  # factor on the voltage noise while the battery charge is not an unknown
_NOISE_UPDATE_COUNT = 2
_SWAPPABLE_ROTOR_INERTIAS = (("Jdrive_up", "Jdrive_dw"), ("Jrot_up", "Jrot_dw"))
_DECISIVE_LIKELIHOOD_DIFFERENCE = 25.0
"""Decisive difference of the negative log-likelihood, per mean square whitened residual."""
_SAME_MINIMUM_THETA_TOLERANCE = 0.02  # largest difference in theta of equal minima


@dataclass(frozen=True)
class FitProgress:
    """Progress of a fit: stage ``stage`` of ``stage_count``, ``iteration`` of at most ``max_iterations`` in it."""

    stage: int
    stage_count: int
    stage_name: str
    iteration: int
    max_iterations: int
    cost: float
    values: dict[str, float]


@dataclass(frozen=True)
class _SearchStage:
    name: str
    window_s: float | None
    with_hover_residual: bool
    max_iterations: int
    tolerance: float


def plan_stages(records: Sequence[FlightRecord], method: FitMethod, window_s: float | None) -> list[_SearchStage]:
    shortest = min(float(r.time_s[-1] - r.time_s[0]) for r in records)
    slowest = max(r.sample_s for r in records)
    top = shortest / 2 if window_s is None else window_s
    iterations = 30 if method == "lm" else 400
    found: list[_SearchStage] = []
    for length in _WINDOW_LENGTHS_S if method == "lm" else (0.4, 3.0):
        use = max(length, _MIN_WINDOW_SAMPLES * slowest)
        if use < top and not (found and use <= (found[-1].window_s or 0.0)):
            found.append(_SearchStage(f"windows of {use:.2g} s", use, length < 1.0, iterations, 1e-3))
    name = "whole records" if window_s is None else f"windows of {window_s:.3g} s"
    return [*found, _SearchStage(name, window_s, False, 2 * iterations, 1e-7)]


@dataclass
class _StageResult:
    """Result of a stage: negative log-likelihood, mean square of the whitened residuals, and parameters ``theta``."""

    negative_log_likelihood: float
    scale: float
    theta: list[float]

    @classmethod
    def from_point(cls, problem: OutputErrorProblem, point: FitPoint) -> _StageResult:
        count = sum(int(np.isfinite(r.measured).sum()) for r in problem.records)
        noise = sum(
            float(np.isfinite(f.record.measured).sum(axis=0) @ np.log(f.noise_std)) for f in problem.prepared_records
        )
        return cls(point.cost + noise, 2.0 * point.cost / count, point.theta.tolist())


@dataclass
class _SearchState:
    """Progress and intermediate results of a search, which a checkpoint stores for its resumption."""

    stage: int = 0
    round: int = 0
    iteration: int = 0
    is_within_stage: bool = False  # within a stage, not at its beginning
    first_stage_theta: list[float] | None = None  # theta after the first stage, until the exchanged vehicle is excluded
    is_exchange_excluded: bool = False  # the exchanged vehicle is excluded or was never a candidate
    stage_results: list[_StageResult] = field(default_factory=list)  # results of the finished stages
    history: list[dict[str, Any]] = field(default_factory=list)
    point: FitPoint | None = None
    noise: list[_Array] | None = None
    initial_charges: list[float] | None = None
    initial_offsets: list[_Array] | None = None
    evolution: EvolutionHistory | None = None


class StagedSearch:
    """Staged search of one fit, with checkpoints."""

    def __init__(
        self, final: OutputErrorProblem, stages: list[_SearchStage], method: FitMethod, seed: int, restarts: int,
        on_progress: Callable[[FitProgress], None] | None,
    ) -> None:  # fmt: skip
        self._final_problem, self._stages, self._method = final, stages, method
        self._seed, self._restarts, self._on_progress = seed, restarts, on_progress
        self._shortest_record_s = min(float(r.time_s[-1] - r.time_s[0]) for r in final.records)
        self._checkpoint_path: Path | None = None
        self._problem_digest = ""
        self._last_result = (FitPoint(np.zeros(0), [], np.inf), final, False)
        self.state = _SearchState()

    def use_checkpoint(self, place: Path | None, digest: str) -> None:
        """Write checkpoints to ``place``, and resume from an existing one."""
        self._checkpoint_path, self._problem_digest = place, digest
        kept = (
            None
            if place is None
            else read_stored_result(place, digest, damaged=_DAMAGED_CHECKPOINT_MESSAGE, other=_OTHER_FIT_MESSAGE)
        )
        if kept is not None:
            self.state = _SearchState(**{f.name: kept[f.name] for f in fields(_SearchState)})
            self.state.point = _point_from_json(kept["point"])
            self.state.stage_results = [_StageResult(**e) for e in kept["stage_results"]]
            if kept["noise"] is not None:
                self.state.noise = [np.array(n) for n in kept["noise"]]
            if kept["initial_offsets"] is not None:
                self.state.initial_offsets = [np.array(b) for b in kept["initial_offsets"]]
            if (c := kept["evolution"]) is not None:
                self.state.evolution = EvolutionHistory(
                    c["costs"], _point_from_json(c["reference"]), _point_from_json(c["origin"])
                )

    def search_minimum(self) -> tuple[FitPoint, OutputErrorProblem, bool, tuple[str, ...]]:
        """Run all stages, in two searches if the rotors' inertias are free: the second starts with them exchanged.

        Once the costs rule out one search, only the other continues.

        Return the point, the last problem, whether the search converged, and descriptions of remaining ambiguities.
        """
        doubt = ""
        if len(self._stages) > 1 and self._method == "lm" and not self.state.is_exchange_excluded:
            if self.state.first_stage_theta is None:
                self.state.first_stage_theta = self.run_stages(1)[0].theta.tolist()
            other = self._with_rotors_exchanged(np.array(self.state.first_stage_theta))
            for k in range(len(self._stages)):
                if other is None or self.state.is_exchange_excluded:
                    break
                self.run_stages(k + 1)
                other.run_stages(k + 1)
                doubt = self._keep_better_run(other, k)
        point, problem, converged = self.run_stages()
        return point, problem, converged, (doubt,) if doubt else ()

    def _with_rotors_exchanged(self, theta: _Array) -> StagedSearch | None:
        """Return a search from exchanged inertias of upper and lower rotor; None if no such pair of parameters is
        free.
        """
        at = {f.symbol: k for k, f in enumerate(self._final_problem.free_parameters)}
        pairs = [(at[a], at[b]) for a, b in _SWAPPABLE_ROTOR_INERTIAS if a in at and b in at]
        if not pairs:
            return None
        low, high = self._final_problem.theta_bounds
        values = theta_to_values(self._final_problem.free_parameters, theta)
        free = self._final_problem.free_parameters
        there = theta.copy()
        for up, dw in pairs:
            there[up], there[dw] = free[up].value_to_theta(values[dw]), free[dw].value_to_theta(values[up])
        other = StagedSearch(
            self._final_problem, self._stages, self._method, self._seed, self._restarts, self._on_progress
        )
        other.state.point = FitPoint(np.clip(there, low, high), [], np.inf)
        return other

    def _keep_better_run(self, other: StagedSearch, k: int) -> str:
        """Compare two searches after stage ``k``; if one is clearly better, continue with it alone.

        The searches also end as one if both reach the same minimum, and after the last stage.

        Return the ambiguity that remains after the last stage.
        """
        mine, its = self.state.stage_results[k], other.state.stage_results[k]
        rise = its.negative_log_likelihood - mine.negative_log_likelihood
        there, last = np.array(its.theta) - np.array(mine.theta), k + 1 == len(self._stages)
        same = float(np.max(np.abs(there))) < _SAME_MINIMUM_THETA_TOLERANCE
        apart = k > 0 and abs(rise) > _DECISIVE_LIKELIHOOD_DIFFERENCE * max(1.0, mine.scale, its.scale)
        if not (same or apart or last):
            return ""
        flown = sum(r.state.point.simulations for r in (self, other) if r.state.point is not None)
        if rise < 0.0:
            self.state, self._last_result = other.state, other._last_result
        self.state.is_exchange_excluded = True
        if self.state.point is not None:
            self.state.point = replace(self.state.point, simulations=flown)
            self._last_result = (self.state.point, *self._last_result[1:])
        if same or apart:
            return ""
        free, worse = self._final_problem.free_parameters, np.array((mine if rise < 0.0 else its).theta)
        moved = [k for k, d in enumerate(there) if abs(d) > _SAME_MINIMUM_THETA_TOLERANCE]
        values = ", ".join(
            f"{free[k].symbol} {v:.4g}" for k, v in zip(moved, theta_to_values(free, worse)[moved], strict=True)
        )
        return (
            f"two minima that these records cannot distinguish (log likelihoods {abs(rise):.1f} apart): the "
            f"other one has {values}, and no interval contains it; fly one motor alone and measure yaw, "
            "`mufly identify plan --channel yaw`"
        )

    def run_stages(self, stages: int | None = None) -> tuple[FitPoint, OutputErrorProblem, bool]:
        """Run the remaining stages, up to ``stages`` in total."""
        for k in range(self.state.stage, len(self._stages) if stages is None else stages):
            self._last_result = self._run_stage(k)
            self.state.stage, self.state.round, self.state.is_within_stage = k + 1, 0, False
        return self._last_result

    def _run_stage(self, k: int) -> tuple[FitPoint, OutputErrorProblem, bool]:
        """Run stage ``k``, resumed from its last iteration if it was interrupted."""
        state, stage, final = self.state, self._stages[k], self._final_problem
        last, left = k == len(self._stages) - 1, state.is_within_stage
        theta = self._solve_hover() if state.point is None else state.point.theta
        flown = 0 if state.point is None else state.point.simulations
        if state.initial_charges is not None:
            final = final.with_charges(state.initial_charges)
        if not left and any("voltage" in r.output_names for r in final.records):
            final = final.with_windows(CHARGE_MATCHING_WINDOW_S).with_matched_charge(theta).with_windows(None)
            state.initial_charges = [f.initial_charge for f in final.prepared_records]
        problem = final.with_windows(stage.window_s, hover=stage.with_hover_residual)
        if not last:
            problem = problem.with_noise(_enlarge_voltage_noise(problem))
        if k == 0 and not last:
            problem = replace(problem, ignored_start_s=min(_ROTOR_TRANSIENT_S, self._shortest_record_s / 4))
        rounds = 1 + (_NOISE_UPDATE_COUNT if last else 0)
        for r in range(state.round, rounds):
            if last and state.noise is not None:
                problem = problem.with_noise(state.noise)
            if stage.window_s is not None and k > 0:
                if not left or state.initial_offsets is None:
                    state.initial_offsets = find_initial_offsets(problem, theta)
                problem = problem.with_initial_offset(state.initial_offsets)
            if state.is_within_stage and state.point is not None:
                point = state.point
            else:
                states = problem.make_zero_initial_states()
                if stage.window_s is None:
                    found = find_initial_states(problem, theta)
                    states, flown = found.initial_states, flown + found.simulation_count
                point = FitPoint(theta, states, np.inf, 1e-2, flown)
            state.round, state.is_within_stage, left = r, True, False
            point, converged = self._minimise_stage(problem, point, stage, k)
            if (
                last
                and stage.window_s is None
                and max(residual_over_noise(problem).values()) > MAX_RESIDUAL_NOISE_RATIO
            ):
                point, converged = self._resolve_from_new_starts(problem, point, stage, k, converged)
            state.evolution, state.iteration, state.point = None, 0, point
            theta, flown = point.theta, point.simulations
            if last and r + 1 < rounds:
                state.noise = _noise_from_residuals(problem, point)
        state.stage_results.append(_StageResult.from_point(problem, point))
        return point, problem, converged

    def _resolve_from_new_starts(
        self, problem: OutputErrorProblem, point: FitPoint, stage: _SearchStage, k: int, converged: bool
    ) -> tuple[FitPoint, bool]:
        """Search for the initial states again, and repeat the minimisation from them if they lower the cost."""
        found = find_initial_states(problem, point.theta)
        cost = float(problem.compute_cost(point.theta[None], [s[None] for s in found.initial_states])[0])
        flown = point.simulations + found.simulation_count
        if not cost < point.cost - 1.0:
            return replace(point, simulations=flown), converged
        return self._minimise_stage(problem, FitPoint(point.theta, found.initial_states, cost, 1e-2, flown), stage, k)

    def _solve_hover(self) -> _Array:
        hover = self._final_problem.with_windows(None, hover=True)
        if hover.dynamics_part == "roll-pitch":
            return np.zeros(len(hover.free_parameters))
        low, high = hover.theta_bounds
        # Wide priors keep the parameters that hover does not determine at their start values.
        std = np.minimum(hover.prior_std, 1.0)

        def hover_and_prior_residual(t: _Array) -> _Array:
            return np.concatenate([hover.hover_residual(t[None])[0], t / std])

        bounds = (np.minimum(low, -1e-9), np.maximum(high, 1e-9))
        return np.clip(least_squares(hover_and_prior_residual, np.zeros(len(low)), bounds=bounds).x, low, high)

    def _minimise_stage(
        self, problem: OutputErrorProblem, point: FitPoint, stage: _SearchStage, k: int
    ) -> tuple[FitPoint, bool]:
        def record_iteration(now: FitPoint, course: EvolutionHistory | None = None) -> None:
            state = self.state
            state.iteration, state.point, state.evolution = state.iteration + 1, now, course
            values = theta_to_values(problem.free_parameters, now.theta).tolist()
            named = dict(zip([f.symbol for f in problem.free_parameters], values, strict=True))
            row = {"iteration": len(state.history) + 1, "cost": now.cost, "stage": stage.name, **named}
            state.history.append(row)
            if self._checkpoint_path is not None:
                write_stored_result(self._checkpoint_path, self._problem_digest, asdict(state))
            if self._on_progress is not None:
                at, stages = (k + 1, len(self._stages)), stage.max_iterations
                self._on_progress(FitProgress(*at, stage.name, state.iteration, stages, now.cost, named))

        if self._method == "lm":
            left = max(2, stage.max_iterations - self.state.iteration)
            return levenberg_marquardt(
                problem, replace(point, damping=min(point.damping, 1e-2)), iterations=left,
                tolerance=stage.tolerance, least_gain=MIN_COST_DECREASE, on_iteration=record_iteration,
            )  # fmt: skip
        return run_cma_es(
            problem,
            point,
            seed=self._seed + k,
            generations=stage.max_iterations,
            course=self.state.evolution,
            restarts=self._restarts,
            tolerance=1.0 if stage.window_s is not None else 0.01,
            on_generation=record_iteration,
        )


def _enlarge_voltage_noise(problem: OutputErrorProblem) -> list[_Array]:
    return [
        f.noise_std * np.array([_VOLTAGE_NOISE_FACTOR if o == "voltage" else 1.0 for o in f.record.output_names])
        for f in problem.prepared_records
    ]


def _noise_from_residuals(problem: OutputErrorProblem, point: FitPoint) -> list[_Array]:
    """Estimate the noise of every output from the residuals of all records in which it is measured."""
    square: dict[str, float] = {}
    count: dict[str, int] = {}
    unknown = len(point.theta) + sum(s.size for s in point.states)
    for i, f in enumerate(problem.prepared_records):
        e = problem.record_residual(i, point.theta[None], point.states[i][None])[0] * f.noise_std
        for k, o in enumerate(f.record.output_names):
            square[o] = square.get(o, 0.0) + float(e[:, k] @ e[:, k])
            count[o] = count.get(o, 0) + int(np.isfinite(f.record.measured[:, k]).sum())
    keep = 1.0 - min(0.5, unknown / max(sum(count.values()), 1))
    return [np.sqrt([max(square[o], 1e-18) / (count[o] * keep) for o in r.output_names]) for r in problem.records]


def hash_fit_problem(problem: OutputErrorProblem, method: str) -> str:
    """Return a hash of all inputs that determine the course of a fit."""
    parts: list[object] = [
        method,
        problem.dynamics_part,
        problem.with_prior,
        problem.delay_s,
        f"{problem.free_parameters}",
    ]
    for r in problem.records:
        parts += [r.output_names, r.time_s, r.inputs, r.measured]
    return hash_inputs(*parts, problem.vehicle.model_dump_json())


_DAMAGED_CHECKPOINT_MESSAGE = ("is not a checkpoint of a fit", "delete it to start again")
_OTHER_FIT_MESSAGE = ("belongs to a fit of other records, parameters or method", "delete it to start again")


def _point_from_json(d: dict[str, Any] | None) -> FitPoint:
    if d is None:
        raise InputError("checkpoint", "", "contains no result of the fit", "delete it to start again")
    states = [np.array(s) for s in d["states"]]
    return FitPoint(np.array(d["theta"]), states, d["cost"], d["damping"], d["simulations"])
