"""What the residuals say is missing from a model, in words.

One sentence a finding, the largest first, each with the number behind it. How a finding is read:

| seen in the residual of an output | said |
|---|---|
| correlation with an input at lags from 0 to a few samples | gain, direct path or delay of that input is wrong |
| correlation with an input that lasts over many lags | a lag or a slow mode driven by that input is missing |
| correlation at negative lags, weaker at positive ones | feedback from output to input, no fault of the model |
| spectral line that stands far out of its surroundings | vibration at that frequency, not caused by the inputs |
| autocorrelation that dies slowly | disturbance (wind) or a slow state is missing |
| mean off (Theil's bias part); slope of measured over predicted not 1 | bias not modelled; gain wrong |

Sources: Ljung, Sec. 16.6; Jategaonkar, ch. 11; the sentences are judgements, the numbers in them are not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import welch

from mufly.identify.residuals import autocorrelation, cross_correlation, qualities
from mufly.identify.result import RecordFit

__all__ = ["spectral_lines", "what_is_missing"]

Array = NDArray[np.float64]

_SHORT_S = 0.05
_VIBRATION_HZ = 3.0
_LINE = 25.0  # a line has this many times the density around it


def what_is_missing(
    record: RecordFit, *, max_lag_s: float = 2.0, confidence: float = 0.99, least: float = 0.1
) -> tuple[str, ...]:
    """Say in words what the residuals of a record show.

    Parameters
    ----------
    record : RecordFit
        Evenly sampled.
    max_lag_s : float
        How far correlations are looked at (s).
    confidence : float
        Of the bounds; the largest correlation over all lags is held against a bound widened for the number of
        independent looks (Bonferroni).
    least : float
        Correlations below this size are not worth a word, however certain.

    Returns
    -------
    tuple of str
        Empty if nothing stands out.
    """
    dt = float(np.median(np.diff(record.time_s)))
    found: list[tuple[float, str]] = []
    for k, output in enumerate(record.outputs):
        e = record.residual[:, k]
        if np.isfinite(e).sum() < 20 or np.nanstd(e) == 0.0:
            continue
        for j, name in enumerate(record.input_names):
            found += _of_input(name, record.inputs[:, j], output, e, dt, max_lag_s, confidence, least)
        found += _of_colour(output, e, dt, max_lag_s)
        found += _of_lines(output, e, dt)
    found += _of_size(record)
    return tuple(dict.fromkeys(text for _, text in sorted(found, key=lambda f: -f[0])))


def _of_input(
    name: str, u: Array, output: str, e: Array, dt: float, max_lag_s: float, confidence: float, least: float
) -> list[tuple[float, str]]:
    if np.std(u) == 0.0:
        return [(0.05, f"{name} never moved in this record, so it says nothing about the response to it")]
    looks = max(1.0, 2.0 * max_lag_s / _correlation_time(u, dt))
    c = cross_correlation(u, e, dt, max_lag_s=max_lag_s, confidence=1.0 - (1.0 - confidence) / looks)
    middle = c.lag_s.size // 2
    ahead, behind = np.abs(c.value[middle:]), np.abs(c.value[:middle])
    if max(ahead.max(), behind.max(initial=0.0)) < max(c.bound, least):
        return []
    # A pilot who answers leaves his mark before lag 0; what reaches past it is the colour of the disturbance.
    if ahead.max() < max(c.bound, least) or behind.max(initial=0.0) > 1.5 * ahead.max():
        lag = -c.lag_s[int(behind.argmax())]
        return [
            (
                0.3 * float(behind.max()),
                f"residual of {output} leads {name} by {lag:.2g} s (correlation {behind.max():.2f}): feedback from "
                f"{output} to {name}, which says nothing against the model",
            )
        ]
    best = int(ahead.argmax())
    size, lag = float(c.value[middle + best]), float(c.lag_s[middle + best])
    lasting = dt * float(np.sum(ahead > max(c.bound, least)))
    own = _correlation_time(u, dt)
    if lag <= _SHORT_S:
        cause = f"the gain, the direct path or the delay of {name} is off"
    elif lasting > 2.0 * own:
        cause = f"a lag or a slow mode between {name} and {output} is missing"
    else:
        cause = f"the delay or the damping between {name} and {output} is off"
    text = f"residual of {output} correlates with {name} at {lag:.2g} s lag ({size:+.2f}, bound {c.bound:.2f}): {cause}"
    return [(abs(size), text)]


def _correlation_time(signal: Array, dt: float) -> float:
    """Lag (s) at which the autocorrelation has fallen to 1/e."""
    r = autocorrelation(signal, dt, max_lag_s=dt * signal.size / 2).value
    below = np.flatnonzero(r < np.exp(-1.0))
    return dt * float(below[0] if below.size else r.size)


def _of_colour(output: str, e: Array, dt: float, max_lag_s: float) -> list[tuple[float, str]]:
    # A line hides the slow part of the autocorrelation, so its half-second means are looked at.
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
            f"{100 * share:.0f} % of the residual's power of {output} varies slower than {width * dt:.2g} s and is "
            f"remembered for {time:.2g} s: a disturbance (wind, gusts) or a slow state is missing",
        )
    ]


def _of_lines(output: str, e: Array, dt: float) -> list[tuple[float, str]]:
    power = float(np.nanvar(e))
    return [
        (
            0.4 * share / power,
            f"residual of {output} has a line at {frequency:.1f} Hz with {100 * share / power:.0f} % of its power: "
            + (
                "vibration, not caused by the inputs"
                if frequency >= _VIBRATION_HZ
                else "an oscillation that the inputs do not drive; a feedback inside the vehicle is missing"
            ),
        )
        for frequency, share in spectral_lines(e, dt)
        if share > 0.05 * power
    ]


def spectral_lines(signal: Array, dt: float) -> list[tuple[float, float]]:
    """Find narrow lines in a spectrum.

    Parameters
    ----------
    signal : (n,) array
        NaN counts as zero.
    dt : float
        Sample time (s).

    Returns
    -------
    list of (frequency in Hz, power in the signal's unit squared)
        Strongest first.
    """
    good = np.where(np.isfinite(signal), signal - np.nanmean(signal), 0.0)
    segment = min(good.size, max(64, round(10.0 / dt)))
    frequency, density = welch(good, 1.0 / dt, nperseg=segment)
    step = float(frequency[1] - frequency[0])
    around = median_filter(density, size=max(11, 2 * (density.size // 30) + 1), mode="nearest")
    high = density > _LINE * np.maximum(around, 1e-300)
    high[: max(2, int(0.5 / step))] = False  # the slow end of a coloured residual is no line
    lines = []
    edges = np.flatnonzero(np.diff(np.r_[0, high.astype(int), 0]))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        peak = a + int(density[a:b].argmax())
        lines.append((float(frequency[peak]), float(density[a:b].sum() * step)))
    return sorted(lines, key=lambda line: -line[1])


def _of_size(record: RecordFit) -> list[tuple[float, str]]:
    found = []
    for name, unit, q in zip(record.outputs, record.units, qualities(record), strict=True):
        if not np.isfinite(q.theil):
            continue
        if q.bias > 0.3:
            text = (
                f"{100 * q.bias:.0f} % of the mean square error of {name} is a constant offset: "
                "a bias is not modelled"
            )
            found.append((q.bias * q.theil, text))
        gain = _gain(record, name)
        if q.r2 > 0.05 and abs(gain - 1.0) > 0.25:
            text = (
                f"{name} moves {gain:.2f} times as far as predicted where both move together: its gain is predicted "
                f"too {'small' if gain > 1.0 else 'large'}"
            )
            found.append((abs(gain - 1.0) * max(q.r2, 0.0), text))
        if q.fit_percent < 0.0:
            text = (
                f"{name} is predicted worse than by its mean (fit {q.fit_percent:.0f} %, rms {q.rms:.3g} {unit}): "
                "what drives it is not among the inputs, or drifts"
            )
            found.append((1.0, text))
    return found


def _gain(record: RecordFit, name: str) -> float:
    """Slope of the measurement over the prediction."""
    k = record.outputs.index(name)
    z, y = record.measured[:, k], record.predicted[:, k]
    good = np.isfinite(z) & np.isfinite(y)
    y = y[good] - y[good].mean()
    power = float(y @ y)
    return float(y @ z[good]) / power if power > 0.0 else 1.0
