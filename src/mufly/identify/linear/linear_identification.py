"""Identification of linear models from flight records: choice of structure, fit, and prediction of held-out data.

The fit uses only the first part of the record; so do the choice of the structure (blocked cross-validation inside that
part), the disturbance model and the noise floor. The second part is predicted in two ways: by one pure simulation that
continues from the first part without measurements, and by predictions over fixed horizons from past measurements.
Low-pass and decimation for the fit apply to inputs and outputs alike, and to the first part only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import (
    FitResult,
    ParameterEstimate,
    RecordPrediction,
    compute_relative_covariance,
    correlation_matrix,
    describe_undetermined_combinations,
)
from mufly.identify.flight_record import UniformLogTable, low_pass
from mufly.identify.linear.equation_error import regress_rate_derivatives
from mufly.identify.linear.frequency_response import FrequencyResponseFit, fit_frequency_response
from mufly.identify.linear.linear_fit import LinearFit, fit_linear_model, simulate_linear_fit
from mufly.identify.linear.linear_structure import LinearStructure, build_structure_by_name
from mufly.identify.linear.model_checks import (
    CrossValidation,
    DisturbanceModel,
    NoiseFloor,
    SubspaceModel,
    cross_validate_structure,
    estimate_noise_floor,
    fit_disturbance_model,
    identify_subspace_model,
    predict_outputs_ahead,
)
from mufly.identify.residual_analysis import PredictionQuality, assess_prediction, describe_model_deficiencies
from mufly.logs import guess_angle_units
from mufly.results import result, select_fields

Array = NDArray[np.float64]

PREDICTION_HORIZONS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
CANDIDATE_MODELS = (
    "first-order", "first-order-coupled", "second-order", "second-order-coupled", "hybrid", "hybrid-coupled",
    "first-order-coupled-collective", "first-order-skew", "first-order-coupled-skew",
)  # fmt: skip
_CROSS_VALIDATION_BLOCKS = 4
_MIN_HOLDOUT_SAMPLES = 100  # least number of samples of a held-out part
_ANGLE_OF_RATE = {"p": "phi", "q": "theta"}


@dataclass(frozen=True)
class AheadPredictionQuality:
    """Prediction quality of every output over one horizon on the held-out part.

    ``horizon_s`` is infinite for the pure simulation. ``fit_percent`` compares with the measurement as recorded,
    ``fit_percent_slow`` compares after low-pass at ``LinearResult.slow_hz``. ``persistence_percent`` is the fit of the
    last measured value, causally low-passed (NaN for the simulation).
    """

    horizon_s: float
    fit_percent: tuple[float, ...]
    fit_percent_slow: tuple[float, ...]
    rms_over_noise: tuple[float, ...]
    persistence_percent: tuple[float, ...]


@dataclass(frozen=True)
class OutputQuality:
    """Simulation quality of one output over one part of the record.

    Attributes
    ----------
    noise_floor : NoiseFloor
        Noise floor of this part.
    quality, slow_quality : PredictionQuality
        Quality as recorded, and after low-pass at ``LinearResult.slow_hz``.
    ceiling_fit_percent, ceiling_slow : float
        Fit (per cent) of a model whose only error is the noise floor, as recorded and below ``slow_hz``; the latter is
        NaN for a rate without measured angle.
    angle_derivative_fit_percent : float
        Fit (per cent) below ``slow_hz`` to the derivative of the measured angle instead of the gyro; NaN without angle.
    """

    noise_floor: NoiseFloor
    quality: PredictionQuality
    slow_quality: PredictionQuality
    ceiling_fit_percent: float
    ceiling_slow: float
    angle_derivative_fit_percent: float


_CHECK_RECORD_FIELDS = {
    "quality": "quality", "quality_slow": "slow_quality", "noise_floor": "noise_floor",
    "ceiling_percent": "ceiling_fit_percent", "ceiling_slow_percent": "ceiling_slow",
    "against_angle_percent": "angle_derivative_fit_percent",
}  # fmt: skip


@result(eq=False)
class LinearResult:
    """Result of a linear identification.

    Attributes
    ----------
    fit : FitResult
        Result for the report, with the fitted and the held-out part.
    linear_fit : LinearFit
        Fitted model.
    candidates : tuple of CrossValidation
        Candidate structures, best first; empty if the structure was given.
    checks : dict of role to tuple of OutputQuality
        Simulation quality of every output.
    disturbance : DisturbanceModel
    ahead : tuple of AheadPredictionQuality
        Predictions over fixed horizons; empty without held-out part.
    slow_hz : float
    model_deficiencies : tuple of str
        Model deficiencies visible in the residuals of the fitted part.
    equation_error : dict of symbol to (value, std)
        Cross-check by equation error; empty without a measured rate.
    subspace : SubspaceModel or None
        Cross-check by a subspace model of the same order, fitted to the same samples.
    subspace_percent : tuple of float
        Fit (per cent) of the subspace model's pure simulation on the held-out part, low-passed.
    spectral_fit : FrequencyResponseFit or None
        Cross-check by a fit to frequency responses; None without sufficient coherence.
    notes : tuple of str
        Notes on the record.
    """

    fit: FitResult
    linear_fit: LinearFit
    candidates: tuple[CrossValidation, ...]
    checks: Mapping[str, tuple[OutputQuality, ...]]
    disturbance: DisturbanceModel
    ahead: tuple[AheadPredictionQuality, ...]
    slow_hz: float
    model_deficiencies: tuple[str, ...]
    equation_error: Mapping[str, tuple[float, float]]
    subspace: SubspaceModel | None
    subspace_percent: tuple[float, ...]
    spectral_fit: FrequencyResponseFit | None
    notes: tuple[str, ...]

    def as_record(self) -> dict[str, Any]:
        """Return the model, notes, and the scores of every output on the fitted and held-out parts, as a dictionary."""
        checks = {
            key: {role: [getattr(c, name) for c in checks] for role, checks in self.checks.items()}
            for key, name in _CHECK_RECORD_FIELDS.items()
        }
        return {
            **select_fields(
                self, "model=fit.vehicle estimates=fit.estimates poles_rad_s=linear_fit.poles candidates "
                "outputs=linear_fit.structure.outputs slow_hz ahead missing=model_deficiencies "
                "undetermined=fit.undetermined notes subspace_fit_percent=subspace_percent message=linear_fit.message",
            ), **checks,
        }  # fmt: skip


def identify_linear_model(
    record: UniformLogTable, inputs: Mapping[str, str], outputs: Mapping[str, str], *, model: str = "auto",
    candidates: Sequence[str] = CANDIDATE_MODELS, split: float = 0.5, split_at_s: float | None = None,
    lowpass_hz: float | None = 5.0,
    rate_hz: float | None = 25.0, starts: int = 6, seed: int = 0, hold: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> LinearResult:  # fmt: skip
    """Identify a linear model on the first part of a record and predict the rest.

    Parameters
    ----------
    record : UniformLogTable
    inputs, outputs : dict
        Model names (lat, lon, ped, col; p, q, r, phi, theta, u, v, w) -> columns; ``-`` before a column inverts its
        sign.
    model : str
        See :func:`mufly.identify.linear.linear_structure.build_structure_by_name`; ``"auto"`` chooses the best of
        ``candidates`` by cross-validation.
    candidates : sequence of str
    split : float
        Share of the record used for the fit; 1 for the whole record.
    split_at_s : float, optional
        End of the fitted part (s); takes precedence over ``split``.
    lowpass_hz, rate_hz : float, optional
        Low-pass and sample rate for the fit only; None leaves the record unchanged.
    starts, seed, hold
        See :func:`mufly.identify.linear.linear_fit.fit_linear_model`.
    progress : callable, optional
        Called with (steps done, steps).

    Raises
    ------
    InputError
        If columns are missing, signals are constant, or no structure can be fitted.
    """
    if not 0.1 <= split <= 1.0:
        raise ArgumentError("split", "", f"{split:g} is not a share of the record", "give 0.1 to 1")
    us, y = record.stack_columns(inputs, "inputs"), record.stack_columns(outputs, "outputs")
    _check_angles_in_radians(record, outputs, y)
    cut = round(split * len(y)) if split_at_s is None else int((record.time_s < split_at_s).sum())
    if not 100 <= cut <= len(y):
        raise ArgumentError("split", "", f"leaves {cut} samples for the fit", "give a split that leaves at least 100")
    notes = record.column_notes(inputs, outputs)
    moving = np.std(us[:cut], axis=0) > 1e-9 * np.maximum(1.0, np.abs(us[:cut]).max(axis=0))
    for name, moves in zip(inputs, moving, strict=True):
        if not moves:
            notes.append(
                f"{name} never moved in the fitted part and is not used: the data contain no information about it"
            )
    if not moving.any():
        raise ArgumentError("inputs", ",".join(inputs), "never move in the fitted part", "use another part or record")
    u, names = us[:, moving], tuple(n for n, moves in zip(inputs, moving, strict=True) if moves)
    outs, dt = tuple(outputs), record.dt
    slow = min(5.0 if lowpass_hz is None else lowpass_hz, 0.4 / dt)
    uf, yf, dtf = _filter_and_decimate(u[:cut], y[:cut], dt, lowpass_hz, rate_hz)
    tried: list[tuple[CrossValidation, LinearStructure, LinearFit]] = []
    first: Array | None = None
    failed: list[Exception] = []
    steps = (len(candidates) if model == "auto" else 0) + starts + 4
    done = 0

    def report_progress(now: int, _: int = 0) -> None:
        if progress is not None:
            progress(min(done + now, steps), steps)

    if model == "auto":
        for name in candidates:
            structure = build_structure_by_name(name, names, outs)
            if structure.name not in {t.name for t, _, _ in tried}:
                try:
                    score, trial = cross_validate_structure(
                        structure, uf, yf, dtf, blocks=_CROSS_VALIDATION_BLOCKS, starts=2, hold=hold
                    )
                except (InputError, FloatingPointError, np.linalg.LinAlgError) as error:
                    failed.append(error)
                    notes.append(f"structure {structure.name} was not compared: {error}")
                else:
                    tried.append((score, structure, trial))
            report_progress(1)
            done += 1
        if not tried:
            raise failed[0]
        tried.sort(key=lambda t: t[0].left_out_error)
        structure, first = tried[0][1], tried[0][2].values
    else:
        structure = build_structure_by_name(model, names, outs)
    linear = fit_linear_model(
        structure, uf, yf, dtf, starts=starts, seed=seed, hold=hold, first=first, progress=report_progress
    )
    simulated, _ = simulate_linear_fit(linear, u, dt)
    angles = [_angle_of_rate(record, name, outs, y) for name in outs]
    parts = {"fit": slice(0, cut), "held out": slice(cut, len(y))}
    if len(y) - cut < _MIN_HOLDOUT_SAMPLES:
        del parts["held out"]
    else:
        notes += _describe_motionless_held_out_outputs(outs, y, cut, dt, slow)
    checks = {
        role: tuple(
            _compare_outputs_with_simulation(
                y[s], simulated[s], u[s], dt, slow, [None if a is None else a[s] for a in angles]
            )
        )
        for role, s in parts.items()
    }
    disturbance = fit_disturbance_model(linear, (y - simulated)[:cut], dt)
    report_progress(starts + 4)
    records = [
        _predict_record_part(record, role, s, linear, y, simulated, checks[role], us, tuple(inputs))
        for role, s in parts.items()
    ]
    model_2, percent = _cross_check_subspace(linear, uf, yf, dtf, u, y, dt, cut, slow)
    rates = [k for k, o in enumerate(outs) if o in ("p", "q", "r")]
    regressed: dict[str, tuple[float, float]] = {}
    if rates:
        chosen = tuple(outs[k] for k in rates)
        regressed = regress_rate_derivatives(
            y[:cut, rates], u[:cut], dt, rate_names=chosen, input_names=names, cut_hz=slow
        )
    return LinearResult(
        fit=_make_fit_result(linear, tuple(records), notes),
        linear_fit=linear,
        candidates=tuple(_subtract_best_criteria([t for t, _, _ in tried])),
        checks=checks,
        disturbance=disturbance,
        ahead=tuple(
            _score_ahead_predictions(linear, disturbance, y, simulated, dt, cut, slow, checks.get("held out", ()))
        ),
        slow_hz=slow,
        model_deficiencies=describe_model_deficiencies(records[0]),
        equation_error=regressed,
        subspace=model_2,
        subspace_percent=percent,
        spectral_fit=_cross_check_spectral(linear, uf, yf, dtf, slow),
        notes=tuple(notes),
    )


def _check_angles_in_radians(record: UniformLogTable, outputs: Mapping[str, str], y: Array) -> None:
    """Raise an error for angles or rates in degrees: a fit would accept them and estimate wrong parameters."""
    names = list(outputs)
    for angle, rate in (("phi", "p"), ("theta", "q"), ("", "r")):
        pair = [y[:, names.index(n)] if n in names else record.columns.get(n) if n else None for n in (angle, rate)]
        guess = guess_angle_units(record.time_s, *pair)
        for name, unit, label in ((angle, guess.angle, "deg"), (rate, guess.rate, "deg/s")):
            if unit == "deg" and name in names:
                raise InputError(
                    record.name, outputs[name], f"seems to be in {label} ({guess.reason})",
                    f"convert it to {label.replace('deg', 'rad')}, or name the unit in the header of a CSV: "
                    f"{name} ({label})",
                )  # fmt: skip


def _angle_of_rate(record: UniformLogTable, name: str, outs: tuple[str, ...], y: Array) -> Array | None:
    angle = _ANGLE_OF_RATE.get(name)
    if angle is None:
        return None
    return np.asarray(y[:, outs.index(angle)]) if angle in outs else record.columns.get(angle)


def _filter_and_decimate(
    u: Array, y: Array, dt: float, lowpass_hz: float | None, rate_hz: float | None
) -> tuple[Array, Array, float]:
    if lowpass_hz is not None:
        u, y = low_pass(u, dt, min(lowpass_hz, 0.45 / dt)), low_pass(y, dt, min(lowpass_hz, 0.45 / dt))
    step = 1 if rate_hz is None else max(1, round(1.0 / (rate_hz * dt)))
    if step > 1 and (lowpass_hz is None or lowpass_hz > 0.45 / (dt * step)):
        problem = f"{1.0 / (dt * step):g} Hz would alias higher frequencies"
        raise ArgumentError("rate_hz", "", problem, "give lowpass_hz=HZ, below 0.45 times this rate")
    return u[::step], y[::step], dt * step


def _describe_motionless_held_out_outputs(
    outs: tuple[str, ...], y: Array, cut: int, dt: float, slow: float
) -> Iterator[str]:
    """Name the outputs with little motion in the held-out part."""
    for k, name in enumerate(outs):
        fitted, held = (float(low_pass(part[:, [k]], dt, slow).std()) for part in (y[:cut], y[cut:]))
        if held < 0.05 * fitted:
            yield (
                f"{name} hardly moves in the held-out part ({held:.2g} against {fitted:.2g} rms): its fit "
                "there is meaningless; choose the split so that it moves in both parts"
            )


def _compare_outputs_with_simulation(
    y: Array, simulated: Array, u: Array, dt: float, slow: float, angles: Sequence[Array | None]
) -> Iterator[OutputQuality]:
    """Compare every output of one part of the record, fitted or held out, with its simulation."""
    y_slow, simulated_slow = low_pass(y, dt, slow), low_pass(simulated, dt, slow)
    for k, angle in enumerate(angles):
        floor = estimate_noise_floor(y[:, k], u, dt, split_hz=slow, angle=angle)
        against = ceiling_slow = float("nan")
        if floor.below > 0.0:
            ceiling_slow = 100.0 * (1.0 - floor.below / float(y_slow.std(axis=0)[k]))
        if angle is not None:
            both = low_pass(np.column_stack([np.gradient(angle, dt), simulated[:, k]]), dt, slow)
            against = assess_prediction(both[:, 0], both[:, 1]).fit_percent
        yield OutputQuality(
            floor, assess_prediction(y[:, k], simulated[:, k], max(floor.total_std, 1e-12)),
            assess_prediction(y_slow[:, k], simulated_slow[:, k], floor.below),
            100.0 * (1.0 - floor.total_std / float(y.std(axis=0)[k])), ceiling_slow, against,
        )  # fmt: skip


def _predict_record_part(
    record: UniformLogTable, role: str, part: slice, linear: LinearFit, y: Array, simulated: Array,
    checks: Sequence[OutputQuality], u: Array, names: tuple[str, ...],
) -> RecordPrediction:  # fmt: skip
    t, noise = record.time_s[part], np.array([max(c.noise_floor.total_std, 1e-12) for c in checks])
    return RecordPrediction(
        f"{record.name}, {t[0]:.1f} to {t[-1]:.1f} s", "fit" if role == "fit" else "held out", t,
        linear.structure.outputs, linear.structure.units, y[part], simulated[part], noise, u[part], names,
    )  # fmt: skip


def _score_ahead_predictions(
    linear: LinearFit, disturbance: DisturbanceModel, y: Array, simulated: Array, dt: float, cut: int, slow: float,
    checks: Sequence[OutputQuality],
) -> Iterator[AheadPredictionQuality]:  # fmt: skip
    if not checks:
        return
    target, m = low_pass(y[cut:], dt, slow), y.shape[1]
    # A causal low-pass removes vibration from the persistence without using future samples.
    causal = np.asarray(sosfilt(butter(1, slow, fs=1.0 / dt, output="sos"), y, axis=0))
    for horizon in (*PREDICTION_HORIZONS_S, float("inf")):
        steps = max(1, round(horizon / dt)) if np.isfinite(horizon) else 0
        if steps > min(cut, len(y) - cut) // 2:
            continue
        whole = simulated if steps == 0 else predict_outputs_ahead(linear, disturbance, y, simulated, dt, horizon)
        predicted = whole[cut:]
        smooth = low_pass(predicted, dt, slow)
        kept = causal[cut - steps : len(y) - steps] if steps else np.full_like(target, np.nan)
        floors = [c.noise_floor.total_std for c in checks]
        as_recorded = [assess_prediction(y[cut:, k], predicted[:, k], floor_std) for k, floor_std in enumerate(floors)]
        yield AheadPredictionQuality(
            horizon,
            tuple(q.fit_percent for q in as_recorded),
            tuple(assess_prediction(target[:, k], smooth[:, k]).fit_percent for k in range(m)),
            tuple(q.rms_over_noise for q in as_recorded),
            tuple(assess_prediction(target[:, k], kept[:, k]).fit_percent for k in range(m)),
        )


def _cross_check_subspace(
    linear: LinearFit, uf: Array, yf: Array, dtf: float, u: Array, y: Array, dt: float, cut: int, slow: float
) -> tuple[SubspaceModel | None, tuple[float, ...]]:
    past = int(np.clip(round(2.0 / dtf), 5, 50))
    try:
        model = identify_subspace_model(uf, yf, dtf, order=min(len(linear.structure.states), 8), past=past)
    except InputError:
        return None, ()
    if np.abs(np.linalg.eigvals(model.a)).max() > 1.0 + 1e-6 or cut >= len(y):
        return model, ()
    step = max(1, round(dtf / dt))
    # The state continues from the fitted part, without measurements of the held-out part.
    whole = model.simulate_outputs(u[::step], model.estimate_initial_state(uf[: 2 * past], yf[: 2 * past]))
    last = -(-cut // step)
    target = low_pass(y, dt, slow)[::step][last:]
    return model, tuple(assess_prediction(target[:, k], whole[last:, k]).fit_percent for k in range(y.shape[1]))


def _cross_check_spectral(
    linear: LinearFit, uf: Array, yf: Array, dtf: float, slow: float
) -> FrequencyResponseFit | None:
    try:
        return fit_frequency_response(
            linear.structure, uf, yf, dtf, first=linear.values, segment_s=dtf * len(uf) / 5.0,
            high_hz=min(slow, 0.4 / dtf),
        )  # fmt: skip
    except InputError:
        return None


def _subtract_best_criteria(tried: list[CrossValidation]) -> list[CrossValidation]:
    aic, bic = min((t.aic for t in tried), default=0.0), min((t.bic for t in tried), default=0.0)
    return [replace(t, aic=t.aic - aic, bic=t.bic - bic) for t in tried]


def _make_fit_result(linear: LinearFit, records: tuple[RecordPrediction, ...], notes: Sequence[str]) -> FitResult:
    std = np.sqrt(np.maximum(np.diag(linear.covariance), 0.0))
    numbers = zip(linear.start.tolist(), linear.values.tolist(), std.tolist(), strict=True)
    estimates = tuple(
        ParameterEstimate.from_std(p.symbol, "", p.unit, *found, quantile=1.96, at_bound=bool(held))
        for p, found, held in zip(linear.structure.parameters, numbers, linear.at_bound, strict=True)
    )
    free = np.flatnonzero(~linear.at_bound)
    seen = compute_relative_covariance(linear.covariance, linear.values)[np.ix_(free, free)]
    undetermined = describe_undetermined_combinations([linear.structure.symbols[k] for k in free], seen)
    return FitResult(
        linear.structure.name, estimates, linear.covariance, correlation_matrix(linear.covariance),
        undetermined + tuple(n for n in notes if "never moved" in n), linear.history[-1]["cost"], linear.history,
        "output error, maximum likelihood, pure simulation of the whole record, "
        f"{len(linear.costs)} starts; initial state, trims and biases eliminated",
        linear.simulations, linear.computing_time_s, linear.converged, linear.message, records,
    )  # fmt: skip
