"""How a fitted linear model does: low-passed, against the angle, a time ahead, and beside models found otherwise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from mufly.errors import InputError
from mufly.identify.linear_check import Disturbance, NoiseFloor, predict_ahead
from mufly.identify.linear_columns import lowpassed
from mufly.identify.linear_result import Ahead, LinearFit
from mufly.identify.linear_spectral import SpectralFit, fit_spectral
from mufly.identify.linear_subspace import Subspace, subspace
from mufly.identify.residuals import Quality, quality

__all__ = [
    "HORIZONS_S",
    "against_angle",
    "ahead",
    "ceilings",
    "slow_quality",
    "spectral_check",
    "subspace_check",
]

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
