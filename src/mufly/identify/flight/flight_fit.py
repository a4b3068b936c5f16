"""Fit of the flight model to records: search, uncertainty, and prediction of held-out records.

:mod:`mufly.identify.flight.staged_search` describes the search for the minimum. Held-out records are predicted with
the estimates. Only their initial states are fitted, because height is a double integral and an initial velocity
error of 1 mm/s already prevents its prediction.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import (
    MAX_RESIDUAL_OVER_NOISE,
    FitResult,
    ParameterEstimate,
    RecordPrediction,
    apply_estimates,
    coloured_covariance,
    correlation_matrix,
    covariance_from_information,
    describe_undetermined_combinations,
)
from mufly.identify.flight.estimate_notes import (
    describe_estimate_reliability,
    describe_held_parameter_influence,
    residual_over_noise,
)
from mufly.identify.flight.free_parameters import (
    HEAVE_YAW_SYMBOLS,
    ROLL_PITCH_SYMBOLS,
    FreeParameter,
    theta_to_values,
)
from mufly.identify.flight.initial_states import MIN_COST_DECREASE, find_initial_states
from mufly.identify.flight.minimisers import (
    FitPoint,
    LinearisedProblem,
    compute_held_parameter_sensitivity,
    cost_rise_along_axes,
    curvature_correction,
)
from mufly.identify.flight.output_error_problem import (
    PART_OUTPUTS,
    DynamicsPart,
    OutputErrorProblem,
    make_problem,
)
from mufly.identify.flight.staged_search import (
    CHARGE_MATCHING_WINDOW_S,
    FitMethod,
    FitProgress,
    StagedSearch,
    hash_fit_problem,
    plan_stages,
)
from mufly.identify.flight_record import (
    FLIGHT_INPUTS,
    FlightRecord,
    estimate_noise_from_differences,
    output_units,
)
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]

_NORMAL_QUANTILE_95 = 1.959964
_METHOD_NAMES = {"lm": "Levenberg-Marquardt on growing windows", "cma": "CMA-ES on growing windows"}


def fit_flight_records(
    vehicle: Vehicle,
    free: Sequence[FreeParameter],
    records: Sequence[FlightRecord],
    *,
    held_out: Sequence[FlightRecord] = (),
    part: DynamicsPart = "both",
    outputs: Sequence[str] | None = None,
    voltage: str | float = "model",
    delay_s: float = 0.0,
    prior: bool = True,
    held_exact: bool = False,
    window_s: float | None = None,
    method: FitMethod = "lm",
    seed: int = 0,
    restarts: int = 0,
    checkpoint: Path | None = None,
    on_progress: Callable[[FitProgress], None] | None = None,
) -> FitResult:
    """Fit the flight model to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, their provenance, and all parameters that are not free.
    free : sequence of FreeParameter
        See :func:`mufly.identify.choose_free_parameters`.
    records, held_out : sequence of FlightRecord
        Records to fit, and records to predict afterwards.
    part, outputs, delay_s, prior
        See :func:`mufly.identify.flight.output_error_problem.make_problem`.
    voltage : {"model", "measured", "nominal"} or float
        See :func:`mufly.identify.flight.output_error_problem.make_problem`; "model" becomes "nominal" if no voltage
        was recorded, and "measured" for a vehicle with a constant battery model.
    held_exact : bool
        Treat held parameters as exact, instead of with their stated standard deviation or that of their source.
    window_s : float, optional
        Window length (s) of the last stage, instead of whole records.
    method : {"lm", "cma"}
        Levenberg-Marquardt or CMA-ES.
    seed, restarts : int
        Random seed and number of restarts of CMA-ES.
    checkpoint : Path, optional
        File that is written every iteration; an existing file resumes the fit.
    on_progress : callable, optional
        Called every iteration with the progress.

    Raises
    ------
    InputError
        If no record is given, a record holds none of the outputs, or the checkpoint belongs to another fit.

    Thesis: Fig. 5.2; Sec. 5.3.
    """
    if not records:
        raise InputError("records", "", "no record is given", "give at least one")
    start = time.perf_counter()
    voltage = _choose_voltage_source(voltage, vehicle, records)
    options: dict[str, Any] = {"part": part, "outputs": outputs, "delay_s": delay_s, "prior": prior}
    final = make_problem(vehicle, free, records, voltage=voltage, **options)
    digest = hash_fit_problem(final, f"{method} {voltage} {window_s} {seed} {restarts}")
    run = StagedSearch(final, plan_stages(final.records, method, window_s), method, seed, restarts, on_progress)
    run.use_checkpoint(checkpoint, digest)
    # The matrices are tall and thin: BLAS threads would only compete with the simulation threads.
    with threadpool_limits(limits=1, user_api="blas"):
        point, problem, converged, doubt = run.search_minimum()
        fit = _make_fit_result(problem, point, run.state.history, _METHOD_NAMES[method], converged, held_exact, doubt)
        held = tuple(_predict_held_out_record(problem, point.theta, r, voltage, outputs) for r in held_out)
    return replace(fit, records=fit.records + held, computing_time_s=time.perf_counter() - start)


def _choose_voltage_source(voltage: str | float, vehicle: Vehicle, records: Sequence[FlightRecord]) -> str | float:
    """Return the requested voltage source, or another one if the records or the vehicle's battery model do not
    support it.
    """
    if voltage == "model" and any(r.voltage is None for r in records):
        return "nominal"
    return "measured" if voltage == "model" and vehicle.battery.model == "constant" else voltage


def _make_fit_result(
    problem: OutputErrorProblem,
    point: FitPoint,
    history: Sequence[dict[str, Any]],
    method: str,
    converged: bool,
    held_exact: bool,
    doubt: Sequence[str],
) -> FitResult:
    """Return the result of a fit that ended at ``point``; ``doubt`` holds ambiguities that the search left."""
    free, linear = problem.free_parameters, LinearisedProblem(problem, point)
    sensitivities = [r.sample_sensitivities() for r in linear.reduced_records]
    covariance, _, coloured = coloured_covariance(
        sensitivities, [r.whitened_residual for r in linear.reduced_records], problem.prior_std
    )
    bend, flown = curvature_correction(linear)
    covariance = covariance + 2.0 * bend.T @ bend
    held: tuple[FreeParameter, ...] = ()
    from_data, moved = np.diag(covariance), np.zeros((len(free), 0))
    if not held_exact:
        moved, wider = compute_held_parameter_sensitivity(linear)
        covariance, held = covariance + moved @ moved.T, wider.free_parameters[len(free) :]
    data = np.concatenate([s.reshape(-1, len(free)) for s in sensitivities])
    # Cost decrease of a further Gauss-Newton step: zero at a minimum.
    least, most = problem.theta_bounds
    at_bound = (point.theta <= least + 1e-9) | (point.theta >= most - 1e-9)
    q = np.linalg.qr(linear.jacobian[:, ~at_bound])[0]
    gain = 0.5 * float(np.sum((q.T @ linear.residual_at_point) ** 2))
    rise, more = cost_rise_along_axes(linear)
    notes = [*doubt, *describe_estimate_reliability(problem, at_bound, coloured, linear, rise)]
    above = residual_over_noise(problem)
    there = gain < 10 * MIN_COST_DECREASE
    if not there:
        notes.insert(0, f"not at a minimum: a linear step predicts a decrease by {gain:.2g} of cost {point.cost:.6g}")
    elif max(above.values()) > MAX_RESIDUAL_OVER_NOISE:
        there = False
        notes.insert(0, "the minimum that was found is not that of a flight with this noise")
    std = np.sqrt(np.diag(covariance))
    values = theta_to_values(free, point.theta)
    ends = np.sort([theta_to_values(free, point.theta + side * _NORMAL_QUANTILE_95 * std) for side in (-1, 1)], axis=0)
    slope = np.array([v if f.scale == 0.0 else f.scale for f, v in zip(free, values, strict=True)])
    numbers = np.column_stack([values, np.abs(slope) * std, *ends]).tolist()
    estimates = tuple(
        ParameterEstimate(f.symbol, f.key, f.unit, f.start_value, value, doubt, low, high, bool(held))
        for f, (value, doubt, low, high), held in zip(free, numbers, at_bound, strict=True)
    )
    return FitResult(
        vehicle=problem.vehicle.name,
        estimates=estimates,
        covariance=covariance * np.outer(slope, slope),
        correlation=correlation_matrix(covariance) * np.sign(np.outer(slope, slope)),
        undetermined=describe_undetermined_combinations(
            [f.symbol for f in free], covariance_from_information(data.T @ data), covariance
        ),
        cost=point.cost,
        history=tuple(history),
        method=f"output error, {method}, {problem.dynamics_part}",
        simulations=point.simulations + flown + more + linear.simulation_count,
        computing_time_s=0.0,
        converged=converged and there,
        message="; ".join(notes) if notes else "converged",
        records=tuple(_predict_fitted_record(problem, i, point, "fit") for i in range(len(problem.prepared_records))),
        uncertain_from_held_parameters=describe_held_parameter_influence(free, held, moved, from_data),
    )


def _predict_fitted_record(
    problem: OutputErrorProblem, i: int, point: FitPoint, role: Literal["fit", "held out"]
) -> RecordPrediction:
    r = problem.records[i]
    predicted = problem.simulate_record(i, point.theta[None], point.states[i][None])[0]
    return RecordPrediction(
        r.name, role, r.time_s, r.output_names, output_units(r.output_names), r.measured, predicted,
        estimate_noise_from_differences(r), r.inputs, FLIGHT_INPUTS,
    )  # fmt: skip


def _predict_held_out_record(
    problem: OutputErrorProblem,
    theta: _Array,
    record: FlightRecord,
    voltage: str | float,
    outputs: Sequence[str] | None,
) -> RecordPrediction:
    """Predict a held-out record as one window; only its initial state is fitted."""
    own = make_problem(
        problem.vehicle,
        problem.free_parameters,
        [record],
        part=problem.dynamics_part,
        outputs=outputs,
        delay_s=problem.delay_s,
        voltage=_choose_voltage_source(voltage, problem.vehicle, [record]),
        prior=False,
    )
    noise = {
        o: n
        for f in (*own.prepared_records, *problem.prepared_records)
        for o, n in zip(f.record.output_names, f.noise_std, strict=True)
    }
    own = own.with_noise([np.array([noise[o] for o in own.records[0].output_names])])
    own = own.with_windows(CHARGE_MATCHING_WINDOW_S).with_matched_charge(theta).with_windows(None)
    found = find_initial_states(own, theta)
    predicted = _predict_fitted_record(own, 0, FitPoint(theta, found.initial_states, np.inf), "held out")
    ratios, doubt = predicted.rms_over_noise(), ""
    worst = int(np.argmax(ratios))
    if not found.converged[0]:
        doubt = f"{record.name}: the initial state was not found, so the prediction is meaningless"
    elif ratios[worst] > MAX_RESIDUAL_OVER_NOISE:
        doubt = (
            f"{record.name}: {predicted.output_names[worst]} is predicted with an error of "
            f"{ratios[worst]:.0f} times "
            "the sensor's noise, at the best start that was found; wind or the model"
        )
    return replace(predicted, converged=found.converged[0], doubt=doubt)


def _dynamics_part(f: FreeParameter) -> str:
    if f.symbol.startswith("bias_"):
        return "heave-yaw" if f.symbol.removeprefix("bias_") in PART_OUTPUTS["heave-yaw"] else "roll-pitch"
    if f.symbol in HEAVE_YAW_SYMBOLS or f.symbol == "delay":
        return "heave-yaw"
    if f.symbol in ROLL_PITCH_SYMBOLS:
        return "roll-pitch"
    raise ArgumentError("free", f.symbol, "acts on both parts, heave-yaw and roll-pitch", "fit with part=both")


def fit_dynamics_parts_separately(
    vehicle: Vehicle, free: Sequence[FreeParameter], records: Sequence[FlightRecord], **options: Any
) -> FitResult:
    """Fit heave and yaw, then roll and pitch (thesis Sec. 5.3.3): two small fits instead of one.

    Each fit uses its own outputs and parameters, and neglects the other half of the motion. The fit of roll and pitch
    starts from the vehicle and delay identified from heave and yaw, which determine the rotor thrusts. Parameters and
    options are those of :func:`fit_flight_records`. A part skips records in which none of its inputs moves or that
    lack its outputs.

    Raises
    ------
    InputError
        If a parameter acts on both halves.
    """
    fits: list[FitResult] = []
    checkpoint = options.pop("checkpoint", None)
    delay = options.pop("delay_s", 0.0)
    held_out = options.pop("held_out", ())
    for part, columns in (("heave-yaw", slice(0, 2)), ("roll-pitch", slice(2, 4))):
        own = [f for f in free if _dynamics_part(f) == part]
        if not own:
            continue

        def excites_part(r: FlightRecord, part: str = part, columns: slice = columns) -> bool:
            moves = float(np.max(np.std(r.inputs[:, columns], axis=0))) > 0.01
            return moves and bool(set(r.output_names) & (set(PART_OUTPUTS[part]) - {"voltage"}))

        used = [r for r in records if excites_part(r)]
        if not used:
            raise InputError(
                "records", part, "no record both moves these inputs and contains their outputs",
                "fly a record that does, or free no parameter of this part",
            )  # fmt: skip
        fit = fit_flight_records(
            vehicle, own, used, part=part, delay_s=delay, held_out=[r for r in held_out if excites_part(r)],  # type: ignore[arg-type]
            checkpoint=None if checkpoint is None else checkpoint.with_name(f"{checkpoint.name}.{part}"), **options,
        )  # fmt: skip
        fits.append(fit)
        if any(e.key for e in fit.estimates):
            vehicle = apply_estimates(vehicle, fit.estimates, "heave and yaw")
        delay = next((e.value for e in fit.estimates if e.symbol == "delay"), delay)
    return _combine_fits(fits)


def _combine_fits(fits: Sequence[FitResult]) -> FitResult:
    """Combine fits of different parameters into one result; parameters of different fits count as independent."""
    if len(fits) == 1:
        return fits[0]
    history = [row for f in fits for row in f.history]
    records = [r for f in fits for r in f.records]
    return replace(
        fits[0],
        estimates=tuple(e for f in fits for e in f.estimates),
        covariance=block_diag(*[f.covariance for f in fits]),
        correlation=block_diag(*[f.correlation for f in fits]),
        undetermined=tuple(u for f in fits for u in f.undetermined),
        uncertain_from_held_parameters=tuple(h for f in fits for h in f.uncertain_from_held_parameters),
        cost=sum(f.cost for f in fits),
        history=tuple({**row, "iteration": k + 1} for k, row in enumerate(history)),
        method=" then ".join(f.method for f in fits),
        simulations=sum(f.simulations for f in fits),
        computing_time_s=sum(f.computing_time_s for f in fits),
        converged=all(f.converged for f in fits),
        message="; ".join(dict.fromkeys(f.message for f in fits)),
        records=tuple(sorted(records, key=lambda r: r.role != "fit")),
    )
