"""From the point where a fit ended to its result: noise, intervals, what is not seen, warnings, predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.identify.covariance import covariance_of, unseen_in_words
from mufly.identify.curvature import bend_of_valley, flights_of
from mufly.identify.free import Free, physical
from mufly.identify.levenberg import Point, descend, reduce_record, stacked_jacobian
from mufly.identify.problem import Problem, make_problem
from mufly.identify.record import INPUTS, Record, difference_noise, units_of
from mufly.identify.result import Estimate, Fit, RecordFit
from mufly.vehicle import Vehicle

__all__ = ["CHARGING_WINDOW_S", "LEAST_GAIN", "learnt_noise", "outcome", "possible_voltage", "predict"]

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
    covariance, coloured = covariance_of(sensitivities, residuals, problem.prior_std)
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
        correlation=covariance / np.outer(std, std) * np.sign(np.outer(slope, slope)),
        unseen=unseen_in_words(free, data, covariance),
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
