"""How a fitted linear model does: low-passed, against the angle, a time ahead, and beside models found otherwise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from mufly.errors import InputError
from mufly.identify.covariance import correlation_of, relative, unseen_combinations
from mufly.identify.linear.check import (
    CrossValidation,
    Disturbance,
    NoiseFloor,
    Subspace,
    cross_validate,
    disturbance_model,
    equation_error,
    noise_floor,
    predict_ahead,
    subspace,
)
from mufly.identify.linear.fit import Ahead, LinearFit, LinearResult, fit_linear, predict_linear
from mufly.identify.linear.frequency import SpectralFit, fit_spectral
from mufly.identify.linear.structure import Structure, model_named
from mufly.identify.record import Columns, lowpassed
from mufly.identify.residuals import Quality, qualities, quality, what_is_missing
from mufly.identify.result import Estimate, Fit, RecordFit
from mufly.logs import guess_angle_units

Array = NDArray[np.float64]

HORIZONS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def slow_quality(
    y: Array, simulated: Array, dt: float, cut_hz: float, floors: tuple[NoiseFloor, ...]
) -> tuple[Quality, ...]:
    a, b = lowpassed(y, dt, cut_hz), lowpassed(simulated, dt, cut_hz)
    return tuple(quality(a[:, k], b[:, k], f.below) for k, f in enumerate(floors))


def ceilings(
    y: Array, dt: float, slow: float, floors: tuple[NoiseFloor, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Fit of a model whose error is the noise floor, as recorded and low-passed."""
    spread, spread_slow = y.std(axis=0), lowpassed(y, dt, slow).std(axis=0)
    known = [f.below > 0.0 for f in floors]
    return (
        tuple(100.0 * (1.0 - f.total / float(s)) for f, s in zip(floors, spread, strict=True)),
        tuple(
            100.0 * (1.0 - f.below / float(s)) if k else float("nan")
            for f, s, k in zip(floors, spread_slow, known, strict=True)
        ),
    )


def against_angle(
    angles: list[Array | None], part: slice, simulated: Array, dt: float, slow: float
) -> tuple[float, ...]:
    """Fit of simulated rates against the derivative of measured angles, both low-passed."""
    found = []
    for k, angle in enumerate(angles):
        if angle is None:
            found.append(float("nan"))
            continue
        both = lowpassed(np.column_stack([np.gradient(angle[part], dt), simulated[part, k]]), dt, slow)
        found.append(quality(both[:, 0], both[:, 1]).fit_percent)
    return tuple(found)


def ahead(
    linear: LinearFit, disturbance: Disturbance, y: Array, simulated: Array, dt: float, cut: int, slow: float,
    floors: Mapping[str, tuple[NoiseFloor, ...]],
) -> tuple[Ahead, ...]:  # fmt: skip
    if "held out" not in floors:
        return ()
    found = []
    noise = [f.total for f in floors["held out"]]
    target, m = lowpassed(y[cut:], dt, slow), y.shape[1]
    # Unfiltered, persistence would carry the vibration along; a filter that sees the future would cheat.
    causal = np.asarray(sosfilt(butter(1, slow, fs=1.0 / dt, output="sos"), y, axis=0))
    for horizon in (*HORIZONS_S, float("inf")):
        steps = max(1, round(horizon / dt)) if np.isfinite(horizon) else 0
        if steps > min(cut, len(y) - cut) // 2:
            continue
        predicted = (
            simulated if steps == 0 else predict_ahead(linear, disturbance, y, simulated, dt, horizon)
        )[cut:]
        smooth = lowpassed(predicted, dt, slow)
        kept = causal[cut - steps : len(y) - steps]
        found.append(
            Ahead(
                horizon,
                tuple(quality(y[cut:, k], predicted[:, k]).fit_percent for k in range(m)),
                tuple(quality(target[:, k], smooth[:, k]).fit_percent for k in range(m)),
                tuple(quality(y[cut:, k], predicted[:, k], noise[k]).rms_over_noise for k in range(m)),
                tuple(
                    quality(target[:, k], kept[:, k]).fit_percent if steps else float("nan") for k in range(m)
                ),
            )
        )
    return tuple(found)


def subspace_check(
    linear: LinearFit, uf: Array, yf: Array, dtf: float, u: Array, y: Array, dt: float, cut: int,
    rate_hz: float | None, slow: float,
) -> tuple[Subspace | None, tuple[float, ...]]:  # fmt: skip
    past = int(np.clip(round(2.0 / dtf), 5, 50))
    try:
        model = subspace(uf, yf, dtf, order=min(len(linear.structure.states), 8), past=past)
    except InputError:
        return None, ()
    if np.abs(np.linalg.eigvals(model.a)).max() > 1.0 + 1e-6 or cut >= len(y):
        return model, ()
    step = max(1, round(dtf / dt))
    # Without a look at the held-out part: the state runs on from the fitted one.
    whole = model.simulate(u[::step], model.initial_state(uf[: 2 * past], yf[: 2 * past]))
    last = -(-cut // step)
    target = lowpassed(y, dt, slow)[::step][last:]
    return model, tuple(quality(target[:, k], whole[last:, k]).fit_percent for k in range(y.shape[1]))


def spectral_check(linear: LinearFit, uf: Array, yf: Array, dtf: float, slow: float) -> SpectralFit | None:
    try:
        return fit_spectral(
            linear.structure, uf, yf, dtf, first=linear.values, segment_s=dtf * len(uf) / 5.0,
            high_hz=min(slow, 0.4 / dtf),
        )  # fmt: skip
    except InputError:
        return None


# ----------------------------------------------------------------------------
# Linear models from flight records, start to finish: choose a structure, fit it, predict what it has not seen.
#
# The fit sees the first part of the record only: so do the choice of the structure (blocked cross-validation inside
# that
# part), the disturbance model and the noise floor. The second part is predicted by one pure simulation that runs on
# from
# the first without a look at the measurements, and, beside it, a stated time ahead from past measurements. Low-pass
# and
# decimation for the fit are applied to inputs and outputs alike, to the first part alone.


CANDIDATES = (
    "first-order", "first-order-coupled", "second-order", "second-order-coupled", "hybrid", "hybrid-coupled",
    "first-order-coupled-collective", "first-order-skew", "first-order-coupled-skew",
)  # fmt: skip
_BLOCKS = 4
_FEWEST = 100  # samples of a held-out part worth the name
_ANGLE = {"p": "phi", "q": "theta"}


def identify_linear(
    record: Columns, inputs: Mapping[str, str], outputs: Mapping[str, str], *, model: str = "auto",
    candidates: Sequence[str] = CANDIDATES, split: float = 0.5, split_at_s: float | None = None,
    lowpass_hz: float | None = 5.0,
    rate_hz: float | None = 25.0, starts: int = 6, seed: int = 0, hold: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> LinearResult:  # fmt: skip
    """Identify a linear model on the first part of a record and predict the rest.

    Parameters
    ----------
    record : Columns
    inputs, outputs : dict
        Our names (lat, lon, ped, col; p, q, r, phi, theta, u, v, w) to columns; ``-`` before a column turns its sign.
    model : str
        See :func:`mufly.identify.model_named`; ``"auto"`` cross-validates ``candidates`` and takes the best.
    candidates : sequence of str
    split : float
        Share of the record that the fit may see; 1 for all of it.
    split_at_s : float, optional
        The same as a time (s); goes before ``split``.
    lowpass_hz, rate_hz : float, optional
        For the fit alone; None leaves the record as it is.
    starts, seed, hold
        See :func:`mufly.identify.fit_linear`.
    progress : callable, optional
        Called with (steps done, steps).

    Raises
    ------
    InputError
        If columns are missing, nothing moves, or no structure can be fitted.
    """
    if not 0.1 <= split <= 1.0:
        raise InputError("--split", "", f"{split:g} is no share of the record", "give 0.1 to 1")
    us = _columns(record, inputs, "--inputs")
    y = _columns(record, outputs, "--outputs")
    _check_radians(record, outputs, y)
    cut = round(split * len(y)) if split_at_s is None else int((record.time_s < split_at_s).sum())
    if not 100 <= cut <= len(y):
        raise InputError("--split", "", f"leaves {cut} samples for the fit", "leave at least 100")
    notes = list(record.notes)
    moving = [
        k
        for k in range(us.shape[1])
        if np.std(us[:cut, k]) > 1e-9 * max(1.0, float(np.abs(us[:cut, k]).max()))
    ]
    for k, name in enumerate(inputs):
        if k not in moving:
            notes.append(
                f"{name} never moved in the fitted part and was left out: the data say nothing about it"
            )
    if not moving:
        raise InputError(
            "--inputs", ",".join(inputs), "never move in the fitted part", "use another part or record"
        )
    u, names = us[:, moving], tuple(n for k, n in enumerate(inputs) if k in moving)
    outs, dt = tuple(outputs), record.dt
    slow = 5.0 if lowpass_hz is None else lowpass_hz
    slow = min(slow, 0.4 / dt)
    uf, yf, dtf = _thinned(u[:cut], y[:cut], dt, lowpass_hz, rate_hz)
    tried: list[CrossValidation] = []
    first: Array | None = None
    steps = (len(candidates) if model == "auto" else 0) + starts + 4
    done = 0

    def tick(now: int, _: int = 0) -> None:
        if progress is not None:
            progress(min(done + now, steps), steps)

    if model == "auto":
        best: tuple[float, Structure, LinearFit] | None = None
        for name in candidates:
            structure = model_named(name, names, outs)
            if structure.name not in {t.name for t in tried}:
                score, trial = cross_validate(structure, uf, yf, dtf, blocks=_BLOCKS, starts=2, hold=hold)
                tried.append(score)
                if best is None or score.left_out < best[0]:
                    best = (score.left_out, structure, trial)
            tick(1)
            done += 1
        assert best is not None
        structure, first = best[1], best[2].values
    else:
        structure = model_named(model, names, outs)
    linear = fit_linear(
        structure, uf, yf, dtf, starts=starts, seed=seed, hold=hold, first=first, progress=tick
    )
    simulated, _ = predict_linear(linear, u, dt)
    angles = [_angle(record, name, outs, y) for name in outs]
    parts = {"fit": slice(0, cut), "held out": slice(cut, len(y))}
    if len(y) - cut < _FEWEST:
        del parts["held out"]
    floors = {
        role: tuple(
            noise_floor(y[s, k], u[s], dt, split_hz=slow, angle=None if a is None else a[s])
            for k, a in enumerate(angles)
        )
        for role, s in parts.items()
    }
    if "held out" in parts:
        for k, name in enumerate(outs):
            moved = [float(lowpassed(y[s, [k]], dt, slow).std()) for s in parts.values()]
            if moved[1] < 0.05 * moved[0]:
                notes.append(
                    f"{name} hardly moves in the held-out part ({moved[1]:.2g} against {moved[0]:.2g} rms): its fit "
                    "there means nothing; use --from, --to and --split-at"
                )
    disturbance = disturbance_model(linear, (y - simulated)[:cut], dt)
    tick(starts + 4)
    records = _records(record, parts, linear, y, simulated, floors, us, tuple(inputs))
    check, percent = subspace_check(linear, uf, yf, dtf, u, y, dt, cut, rate_hz, slow)
    rates = [k for k, o in enumerate(outs) if o in ("p", "q", "r")]
    regressed = (
        equation_error(
            y[:cut, rates],
            u[:cut],
            dt,
            rate_names=tuple(outs[k] for k in rates),
            input_names=names,
            cut_hz=slow,
        )
        if rates
        else {}
    )
    quality_slow, ceiling, ceiling_slow, against = {}, {}, {}, {}
    for role, s in parts.items():
        quality_slow[role] = slow_quality(y[s], simulated[s], dt, slow, floors[role])
        ceiling[role], ceiling_slow[role] = ceilings(y[s], dt, slow, floors[role])
        against[role] = against_angle(angles, s, simulated, dt, slow)
    tried.sort(key=lambda t: t.left_out)
    return LinearResult(
        _fit(linear, records, tuple(notes)), linear, tuple(_relative(tried)), floors, disturbance,
        ahead(linear, disturbance, y, simulated, dt, cut, slow, floors),
        {str(r.role): qualities(r) for r in records}, quality_slow, ceiling, ceiling_slow, against, slow,
        what_is_missing(records[0]), regressed,
        check, percent, spectral_check(linear, uf, yf, dtf, slow), tuple(notes),
    )  # fmt: skip


def _columns(record: Columns, wanted: Mapping[str, str], option: str) -> Array:
    columns = []
    for name, column in wanted.items():
        sign = -1.0 if column.startswith("-") else 1.0
        columns.append(sign * record.find(column.lstrip("-") or name, option))
    if not columns:
        raise InputError(option, "", "names nothing", "give names from the log, such as p,q")
    return np.column_stack(columns)


def _check_radians(record: Columns, outputs: Mapping[str, str], y: Array) -> None:
    """Refuse angles and rates in degrees, which would be fitted as well but mean something else."""
    names = list(outputs)
    for angle, rate in (("phi", "p"), ("theta", "q"), ("", "r")):
        pair = [
            y[:, names.index(n)] if n in names else record.columns.get(n) if n else None
            for n in (angle, rate)
        ]
        guess = guess_angle_units(record.time_s, *pair)
        for name, unit, label in ((angle, guess.angle, "deg"), (rate, guess.rate, "deg/s")):
            if unit == "deg" and name in names:
                raise InputError(
                    record.name, outputs[name], f"seems to be in {label} ({guess.reason})",
                    f"convert it to {label.replace('deg', 'rad')}, or name the unit in the header of a CSV: "
                    f"{name} ({label})",
                )  # fmt: skip


def _angle(record: Columns, name: str, outs: tuple[str, ...], y: Array) -> Array | None:
    angle = _ANGLE.get(name)
    if angle is None:
        return None
    if angle in outs:
        return np.asarray(y[:, outs.index(angle)])
    return record.columns.get(angle)


def _thinned(
    u: Array, y: Array, dt: float, lowpass_hz: float | None, rate_hz: float | None
) -> tuple[Array, Array, float]:
    if lowpass_hz is not None:
        u, y = lowpassed(u, dt, min(lowpass_hz, 0.45 / dt)), lowpassed(y, dt, min(lowpass_hz, 0.45 / dt))
    step = 1 if rate_hz is None else max(1, round(1.0 / (rate_hz * dt)))
    if step > 1 and (lowpass_hz is None or lowpass_hz > 0.45 / (dt * step)):
        raise InputError(
            "--rate",
            "",
            f"{1.0 / (dt * step):g} Hz would fold what lies above it",
            "give --lowpass below 0.45 of it",
        )
    return u[::step], y[::step], dt * step


def _records(
    record: Columns, parts: Mapping[str, slice], linear: LinearFit, y: Array, simulated: Array,
    floors: Mapping[str, tuple[NoiseFloor, ...]], u: Array, names: tuple[str, ...],
) -> tuple[RecordFit, ...]:  # fmt: skip
    made = []
    for role, part in parts.items():
        t, noise = record.time_s[part], np.array([max(f.total, 1e-12) for f in floors[role]])
        made.append(
            RecordFit(
                f"{record.name}, {t[0]:.1f} to {t[-1]:.1f} s", "fit" if role == "fit" else "held out", t,
                linear.structure.outputs, linear.structure.units, y[part], simulated[part], noise, u[part], names,
            )
        )  # fmt: skip
    return tuple(made)


def _relative(tried: list[CrossValidation]) -> list[CrossValidation]:
    from dataclasses import replace

    aic, bic = min((t.aic for t in tried), default=0.0), min((t.bic for t in tried), default=0.0)
    return [replace(t, aic=t.aic - aic, bic=t.bic - bic) for t in tried]


def _fit(linear: LinearFit, records: tuple[RecordFit, ...], notes: tuple[str, ...]) -> Fit:
    std = np.sqrt(np.maximum(np.diag(linear.covariance), 0.0))
    correlation = correlation_of(linear.covariance)
    estimates = tuple(
        Estimate.of(p.symbol, "", p.unit, float(s), float(v), float(d), quantile=1.96, at_bound=bool(b))
        for p, s, v, d, b in zip(
            linear.structure.parameters, linear.start, linear.values, std, linear.at_bound, strict=True
        )
    )
    free = np.flatnonzero(~linear.at_bound)
    unseen = unseen_combinations(
        [linear.structure.symbols[k] for k in free],
        relative(linear.covariance, linear.values)[np.ix_(free, free)],
    )
    return Fit(
        linear.structure.name, estimates, linear.covariance, correlation,
        unseen + tuple(n for n in notes if "never moved" in n), linear.history[-1]["cost"], linear.history,
        "output error, maximum likelihood, pure simulation of the whole record, "
        f"{len(linear.costs)} starts; initial state, trims and biases eliminated",
        linear.simulations, linear.seconds, linear.converged, linear.message, records,
    )  # fmt: skip
