"""Residual analysis of a model: statistics, and descriptions of model deficiencies.

**Statistics: whiteness, correlation with the inputs, and size of the residuals.**

With residual ``e`` (measured less predicted, mean removed) and input ``u`` of ``N`` samples,

    r_e(k)  = sum e_i e_(i+k) / sum e_i^2                                   autocorrelation
    Q       = N (N + 2) sum_(k=1)^h r_e(k)^2 / (N - k)  ~  chi^2(h)         Ljung and Box (1978)
    r_ue(k) = sum u_i e_(i+k) / sqrt(sum u^2 sum e^2)                       the input leads by k samples

If the model is complete ``e`` is independent of ``u`` at every lag ``k >= 0``. For two independent but coloured
signals Bartlett's formula gives ``var r_ue(k) = sum_j r_e(j) r_u(j) / N`` (Box and Jenkins 1976, Sec. 11.1; Ljung,
*System Identification*, 2nd ed., Sec. 16.6). The bounds use this formula, so that two slowly varying signals do not
count as correlated only because both are slow. Correlation at negative lags indicates feedback from output to input,
not a fault of the model (Ljung, Sec. 16.6).

Sizes, with measured ``z`` and predicted ``y``::

    fit   = 100 (1 - |z - y| / |z - mean z|)            NRMSE fit, per cent (Ljung; 100 is exact, 0 is the mean)
    R2    = 1 - |z - y|^2 / |z - mean z|^2              coefficient of determination (Klein and Morelli, Sec. 5.1)
    TIC   = rms(z - y) / (rms z + rms y)                Theil's inequality coefficient: 0 exact, 1 worst
    1     = U_bias + U_variance + U_covariance          of the mean square error: means, spreads, the rest

Jategaonkar (*Flight Vehicle System Identification*, 2nd ed., ch. 11) accepts TIC below 0.25 to 0.3 with most of the
error in the covariance part, and compares models by the determinant of the residuals' covariance.

**Descriptions of model deficiencies.**

Each finding is one sentence with its number; the largest comes first:

| seen in the residual of an output | description |
|---|---|
| correlation with an input at lags from 0 to a few samples | gain, direct path or delay of that input is wrong |
| correlation with an input that lasts over many lags | a lag or a slow mode driven by that input is missing |
| correlation at negative lags, weaker at positive ones | feedback from output to input, no fault of the model |
| spectral line far above its surroundings | vibration at that frequency, not caused by the inputs |
| autocorrelation that decays slowly | disturbance (wind) or a slow state is missing |
| nonzero mean (Theil's bias part); slope of measured over predicted not 1 | bias not modelled; gain wrong |

Sources: Ljung, Sec. 16.6; Jategaonkar, ch. 11. The interpretations are heuristic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import correlate, welch
from scipy.stats import chi2, norm

from mufly.identify.fit_result import RecordPrediction
from mufly.results import result

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LagCorrelation:
    """Correlation of two signals over lags, with the confidence bound for uncorrelated signals.

    Attributes
    ----------
    lag_s : (k,) array
        Lags (s); positive: the second signal is later.
    value : (k,) array
        Correlation, between -1 and 1.
    confidence_bound : float
        Bound of the absolute correlation at one lag.
    """

    lag_s: Array
    value: Array
    confidence_bound: float


@dataclass(frozen=True)
class WhitenessTest:
    """Test of Ljung and Box: small ``p_value`` means that the residual is not white.

    Attributes
    ----------
    statistic : float
        Statistic Q.
    degrees_of_freedom : int
        Number of lags.
    p_value : float
        Probability of a larger Q for a white residual.
    """

    statistic: float
    degrees_of_freedom: int
    p_value: float


@result
class PredictionQuality:
    """Measures of how well a model predicts one output; the module docstring has the formulas.

    Attributes
    ----------
    fit_percent, r2 : float
        NRMSE fit (per cent) and coefficient of determination; minus infinity for a constant measurement.
    theil, bias, variance, covariance : float
        Theil's coefficient and the three shares of the mean square error (they sum to 1).
    rms : float
        RMS residual, in the unit of the output.
    rms_over_noise : float
        RMS residual over the noise floor; 1 is the optimum, NaN for unknown noise.
    """

    fit_percent: float
    r2: float
    theil: float
    bias: float
    variance: float
    covariance: float
    rms: float
    rms_over_noise: float


def _remove_mean(signal: Array) -> Array:
    """Remove the mean; gaps (NaN) become zeros, which do not contribute to a sum of products."""
    good = np.isfinite(signal)
    mean = signal[good].mean() if good.any() else 0.0
    return np.where(good, signal - mean, 0.0)


def _sum_lagged_products(a: Array, b: Array, lags: int) -> Array:
    """Return the sums of a_i b_(i+k) for k = -lags..lags."""
    full = correlate(b, a, mode="full", method="fft")
    middle = a.size - 1
    return np.asarray(full[middle - lags : middle + lags + 1])


def compute_residual_autocorrelation(residual: Array, dt: float, *, max_lag_s: float) -> LagCorrelation:
    """Return the autocorrelation of a residual at lags 0 to ``max_lag_s``, with the 95 % bound for white noise.

    Parameters
    ----------
    residual : (n,) array
        Residual; NaN without a measurement.
    dt : float
        Sample time (s).
    max_lag_s : float
        Largest lag (s), limited by the record.
    """
    e = _remove_mean(np.asarray(residual, dtype=np.float64))
    lags = _lag_count(e.size, dt, max_lag_s)
    r = _sum_lagged_products(e, e, lags)[lags:]
    power = r[0] if r[0] > 0.0 else 1.0
    bound = float(norm.ppf(0.975)) / np.sqrt(max(np.isfinite(residual).sum(), 1))
    return LagCorrelation(np.asarray(dt * np.arange(lags + 1), dtype=np.float64), r / power, float(bound))


def compute_input_cross_correlation(
    signal: Array, residual: Array, dt: float, *, max_lag_s: float, confidence: float = 0.95
) -> LagCorrelation:
    """Return the correlation of a residual with an input, at lags from ``-max_lag_s`` to ``max_lag_s``.

    Parameters
    ----------
    signal, residual : (n,) array
        Input and residual; at a positive lag the residual is later.
    dt : float
        Sample time (s).
    max_lag_s : float
        Largest lag (s), limited by the record.
    confidence : float
        Confidence of Bartlett's bound at one lag for independent signals with these spectra.

    Returns
    -------
    LagCorrelation
        Correlation; zero everywhere for a constant signal.
    """
    u = _remove_mean(np.asarray(signal, dtype=np.float64))
    e = _remove_mean(np.asarray(residual, dtype=np.float64))
    lags = _lag_count(e.size, dt, max_lag_s)
    times = np.asarray(dt * np.arange(-lags, lags + 1), dtype=np.float64)
    scale = float(np.sqrt((u @ u) * (e @ e)))
    count = int((np.isfinite(signal) & np.isfinite(residual)).sum())
    if scale == 0.0 or count < 2:
        return LagCorrelation(times, np.zeros(times.size), 1.0)
    # Bartlett's sum ends at a quarter of the record, because the estimates of r at larger lags are noise.
    far = max(1, e.size // 4)
    r_u = _sum_lagged_products(u, u, far) / (u @ u)
    r_e = _sum_lagged_products(e, e, far) / (e @ e)
    taper = 1.0 - np.abs(np.arange(-far, far + 1)) / (far + 1.0)
    variance = max(float(np.sum(taper * r_u * r_e)), 1.0) / count
    bound = float(norm.ppf(0.5 + 0.5 * confidence)) * np.sqrt(variance)
    return LagCorrelation(times, _sum_lagged_products(u, e, lags) / scale, float(bound))


def _lag_count(size: int, dt: float, max_lag_s: float) -> int:
    return max(1, min(round(max_lag_s / dt), size - 1))


def ljung_box_test(residual: Array, *, lags: int) -> WhitenessTest:
    """Test whether a residual is white.

    Parameters
    ----------
    residual : (n,) array
        Residual; NaN without a measurement.
    lags : int
        Number of lags, usually 20 to n / 5.
    """
    n = int(np.isfinite(residual).sum())
    r = compute_residual_autocorrelation(residual, 1.0, max_lag_s=lags).value[1:]
    k = np.arange(1, r.size + 1)
    statistic = float(n * (n + 2.0) * np.sum(r**2 / np.maximum(n - k, 1)))
    return WhitenessTest(statistic, r.size, float(chi2.sf(statistic, r.size)))


def assess_prediction(measured: Array, predicted: Array, noise_std: float = float("nan")) -> PredictionQuality:
    """Compute the prediction quality of one output.

    Parameters
    ----------
    measured, predicted : (n,) array
        Measurement and prediction; non-finite samples are omitted.
    noise_std : float
        Standard deviation of the measurement noise, in the output's unit; NaN if unknown.

    Returns
    -------
    PredictionQuality
        Quality; all NaN without samples.
    """
    good = np.isfinite(measured) & np.isfinite(predicted)
    z, y = np.asarray(measured)[good], np.asarray(predicted)[good]
    if z.size == 0:
        return PredictionQuality(*(float("nan"),) * 8)
    square = float(np.mean((z - y) ** 2))
    spread = float(np.mean((z - z.mean()) ** 2))
    ratio = square / spread if spread > 0.0 else float("inf") if square > 0.0 else 0.0
    size = float(np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(y**2)))
    s_z, s_y = float(z.std()), float(y.std())
    bias = float(z.mean() - y.mean()) ** 2
    variance = (s_z - s_y) ** 2
    shares = (bias / square, variance / square) if square > 0.0 else (0.0, 0.0)
    return PredictionQuality(
        fit_percent=100.0 * (1.0 - np.sqrt(ratio)),
        r2=1.0 - ratio,
        theil=float(np.sqrt(square)) / size if size > 0.0 else 0.0,
        bias=shares[0],
        variance=shares[1],
        covariance=max(0.0, 1.0 - shares[0] - shares[1]),
        rms=float(np.sqrt(square)),
        rms_over_noise=float(np.sqrt(square)) / noise_std if noise_std > 0.0 else float("nan"),
    )


def assess_record_predictions(record: RecordPrediction) -> tuple[PredictionQuality, ...]:
    """Return the prediction quality of every output of a record."""
    return tuple(
        assess_prediction(record.measured[:, k], record.predicted[:, k], float(record.noise_std[k]))
        for k in range(len(record.output_names))
    )


def residual_determinant(records: tuple[RecordPrediction, ...] | list[RecordPrediction]) -> float:
    """Return Jategaonkar's goodness of fit: the determinant of the residuals' covariance over all records.

    Only ratios between models of the same outputs are meaningful; smaller is better. Samples with a missing output are
    omitted.
    """
    residual = np.concatenate([r.residual for r in records])
    residual = residual[np.isfinite(residual).all(axis=1)]
    return float(np.linalg.det(np.atleast_2d(residual.T @ residual / max(len(residual), 1))))


def estimate_high_frequency_noise(signal: Array, dt: float, *, above_hz: float) -> float:
    """Estimate measurement noise from a signal's content above the bandwidth of the vehicle.

    The filter is a fourth-order Butterworth high-pass, applied forwards and backwards. White noise has the same density
    at lower frequencies, so the result is a lower bound of the noise in the whole band.

    Parameters
    ----------
    signal : (n,) array
        Signal without gaps.
    dt : float
        Sample time (s).
    above_hz : float
        Cut-off frequency, below the Nyquist frequency.

    Returns
    -------
    float
        Standard deviation, in the signal's unit.
    """
    from scipy.signal import butter, sosfiltfilt

    return float(np.std(sosfiltfilt(butter(4, above_hz, "highpass", fs=1.0 / dt, output="sos"), signal)))


_CORRELATION_BOUND_CONFIDENCE = 0.99
"""Confidence of the bound of the largest correlation, widened for the number of independent lags (Bonferroni)."""
_MIN_REPORTED_CORRELATION = 0.1  # least correlation that is reported
_MAX_DIRECT_INPUT_LAG_S = 0.05
_MIN_VIBRATION_HZ = 3.0
_MIN_SPECTRAL_LINE_RATIO = 25.0  # least ratio of a line's density to the density around it


def describe_model_deficiencies(record: RecordPrediction, *, max_lag_s: float = 2.0) -> tuple[str, ...]:
    """Describe the model deficiencies visible in the residuals of a record.

    Parameters
    ----------
    record : RecordPrediction
        Uniformly sampled record.
    max_lag_s : float
        Largest lag of correlations (s).

    Returns
    -------
    tuple of str
        Findings; empty if none is significant.
    """
    dt = float(np.median(np.diff(record.time_s)))
    found: list[tuple[float, str]] = []
    for k, output in enumerate(record.output_names):
        e = record.residual[:, k]
        if np.isfinite(e).sum() < 20 or np.nanstd(e) == 0.0:
            continue
        for j, name in enumerate(record.input_names):
            found += _describe_input_correlation(name, record.inputs[:, j], output, e, dt, max_lag_s)
        found += _describe_slow_residual(output, e, dt, max_lag_s)
        found += _describe_spectral_lines(output, e, dt)
    found += _describe_bias_gain_and_misfit(record)
    return tuple(dict.fromkeys(text for _, text in sorted(found, key=lambda f: -f[0])))


def _describe_input_correlation(
    name: str, u: Array, output: str, e: Array, dt: float, max_lag_s: float
) -> list[tuple[float, str]]:
    if np.std(u) == 0.0:
        return [
            (0.05, f"{name} never moved in this record, so the record holds no information about the response to it")
        ]
    looks = max(1.0, 2.0 * max_lag_s / _correlation_time(u, dt))
    c = compute_input_cross_correlation(
        u, e, dt, max_lag_s=max_lag_s, confidence=1.0 - (1.0 - _CORRELATION_BOUND_CONFIDENCE) / looks
    )
    middle = c.lag_s.size // 2
    ahead, behind = np.abs(c.value[middle:]), np.abs(c.value[:middle])
    if max(ahead.max(), behind.max(initial=0.0)) < max(c.confidence_bound, _MIN_REPORTED_CORRELATION):
        return []
    # Feedback by a pilot appears at negative lags; its extension to positive lags is the colour of the disturbance.
    if ahead.max() < max(c.confidence_bound, _MIN_REPORTED_CORRELATION) or behind.max(initial=0.0) > 1.5 * ahead.max():
        lag = -c.lag_s[int(behind.argmax())]
        return [
            (
                0.3 * float(behind.max()),
                f"residual of {output} leads {name} by {lag:.2g} s (correlation {behind.max():.2f}): feedback from "
                f"{output} to {name}, which does not contradict the model",
            )
        ]
    best = int(ahead.argmax())
    size, lag = float(c.value[middle + best]), float(c.lag_s[middle + best])
    lasting = dt * float(np.sum(ahead > max(c.confidence_bound, _MIN_REPORTED_CORRELATION)))
    own = _correlation_time(u, dt)
    if lag <= _MAX_DIRECT_INPUT_LAG_S:
        cause = f"the gain, the direct path or the delay of {name} is off"
    elif lasting > 2.0 * own:
        cause = f"a lag or a slow mode between {name} and {output} is missing"
    else:
        cause = f"the delay or the damping between {name} and {output} is off"
    text = (
        f"residual of {output} correlates with {name} at {lag:.2g} s lag ({size:+.2f}, bound "
        f"{c.confidence_bound:.2f}): {cause}"
    )
    return [(abs(size), text)]


def _correlation_time(signal: Array, dt: float) -> float:
    """Return the lag (s) at which the autocorrelation has decayed to 1/e."""
    r = compute_residual_autocorrelation(signal, dt, max_lag_s=dt * signal.size / 2).value
    below = np.flatnonzero(r < np.exp(-1.0))
    return dt * float(below[0] if below.size else r.size)


def _describe_slow_residual(output: str, e: Array, dt: float, max_lag_s: float) -> list[tuple[float, str]]:
    # A spectral line masks slow autocorrelation, so block means are tested.
    width = max(1, round(0.25 / dt))
    good = np.where(np.isfinite(e), e - np.nanmean(e), 0.0)
    slow = np.convolve(good, np.ones(width) / width, mode="same")
    share = float(np.var(slow) / max(np.var(good), 1e-300))
    time = _correlation_time(slow, dt)
    if share < 0.15 or time <= 2.0 * width * dt / 2.0:
        return []
    return [
        (
            0.5 * share,
            f"{100 * share:.0f} % of the residual's power of {output} varies slower than {width * dt:.2g} s "
            f"and is correlated over {time:.2g} s: a disturbance (wind, gusts) or a slow state is missing",
        )
    ]


def _describe_spectral_lines(output: str, e: Array, dt: float) -> list[tuple[float, str]]:
    power = float(np.nanvar(e))
    return [
        (
            0.4 * share / power,
            f"residual of {output} has a line at {frequency:.1f} Hz with {100 * share / power:.0f} % of its power: "
            + (
                "vibration, not caused by the inputs"
                if frequency >= _MIN_VIBRATION_HZ
                else "an oscillation that the inputs do not drive; a feedback inside the vehicle is missing"
            ),
        )
        for frequency, share in find_spectral_lines(e, dt)
        if share > 0.05 * power
    ]


def find_spectral_lines(signal: Array, dt: float) -> list[tuple[float, float]]:
    """Return frequency and power of the narrow lines in the spectrum of a signal.

    Parameters
    ----------
    signal : (n,) array
        Signal; NaN counts as zero.
    dt : float
        Sample time (s).

    Returns
    -------
    list of (frequency in Hz, power in the signal's unit squared)
        Lines, strongest first.
    """
    good = np.where(np.isfinite(signal), signal - np.nanmean(signal), 0.0)
    segment = min(good.size, max(64, round(10.0 / dt)))
    frequency, density = welch(good, 1.0 / dt, nperseg=segment)
    step = float(frequency[1] - frequency[0])
    around = median_filter(density, size=max(11, 2 * (density.size // 30) + 1), mode="nearest")
    high = density > _MIN_SPECTRAL_LINE_RATIO * np.maximum(around, 1e-300)
    high[: max(2, int(0.5 / step))] = False  # excludes the slow part of a coloured residual
    lines = []
    edges = np.flatnonzero(np.diff(np.r_[0, high.astype(int), 0]))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        peak = a + int(density[a:b].argmax())
        lines.append((float(frequency[peak]), float(density[a:b].sum() * step)))
    return sorted(lines, key=lambda line: -line[1])


def _describe_bias_gain_and_misfit(record: RecordPrediction) -> list[tuple[float, str]]:
    found = []
    for name, unit, q in zip(record.output_names, record.units, assess_record_predictions(record), strict=True):
        if not np.isfinite(q.theil):
            continue
        if q.bias > 0.3:
            text = (
                f"{100 * q.bias:.0f} % of the mean square error of {name} is a constant offset: a bias is not modelled"
            )
            found.append((q.bias * q.theil, text))
        gain = _regress_measured_on_predicted(record, name)
        if q.r2 > 0.05 and abs(gain - 1.0) > 0.25:
            text = (
                f"{name} moves {gain:.2f} times as far as predicted where both move together: its gain is predicted "
                f"too {'small' if gain > 1.0 else 'large'}"
            )
            found.append((abs(gain - 1.0) * max(q.r2, 0.0), text))
        if q.fit_percent < 0.0:
            text = (
                f"{name} is predicted worse than by its mean (fit {q.fit_percent:.0f} %, rms {q.rms:.3g} {unit}): "
                "its cause is not among the inputs, or it drifts"
            )
            found.append((1.0, text))
    return found


def _regress_measured_on_predicted(record: RecordPrediction, name: str) -> float:
    """Return the regression slope of the measurement on the prediction."""
    k = record.output_names.index(name)
    z, y = record.measured[:, k], record.predicted[:, k]
    good = np.isfinite(z) & np.isfinite(y)
    y = y[good] - y[good].mean()
    power = float(y @ y)
    return float(y @ z[good]) / power if power > 0.0 else 1.0
