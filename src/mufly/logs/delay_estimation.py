"""Delay between two signals by cross-correlation, to a fraction of a sample, with a confidence interval.

Model: y(t) = a x(t - tau) + e(t). The least-squares delay, with a free gain a, is at the greatest absolute value of the
normalised cross-correlation of x and y. The correlation is computed at whole samples and interpolated by a windowed
sinc, which is exact for signals without content above half the sampling rate. Interpolating the signals instead would
smooth their noise by an amount that depends on the fraction, and bias the delay towards a whole or a half sample.

Uncertainty: the record is cut into twelve blocks, and the delay is estimated with each block left out. The variance is
that of the delete-one-block jackknife, (K - 1) / K sum (tau_k - mean)^2, with Student's quantile for K - 1 degrees of
freedom (Kuensch 1989, "The jackknife and the bootstrap for general stationary observations"). The jackknife
needs no model of the residual, which in flight data is neither white nor stationary. The model is a pure delay: for a
response that is filtered instead, tau is the delay that fits best.

A record does not determine the delay in three cases:

* The delay explains less than a quarter of the response's power (a correlation below 0.5).
* Another lag, outside the half-width of the peak, fits equally well within the jackknife's interval (in an
  oscillation, the lag one period later).
* The best lag is the longest that was tried.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import correlate, detrend
from scipy.special import stdtrit

from mufly.errors import InputError
from mufly.logs.raw_log import examine_time_stamps, unwrap_angle
from mufly.results import result

_Array = NDArray[np.float64]
# Number of blocks of the record, reduced where a block would have fewer samples than the second number.
_JACKKNIFE_PIECES, _MIN_PIECE_SAMPLES = 12, 3
_MIN_CORRELATION = 0.5
# Number of lags on either side of the peak that the windowed sinc uses.
_SINC_HALF_WIDTH = 24


@result
class DelayEstimate:
    """Estimated delay with its confidence interval.

    Attributes
    ----------
    delay_s : float
        Delay of the response (s); negative if it leads.
    std_s : float
        Standard deviation by the jackknife (s).
    correlation : float
        Correlation of the two signals after removal of the delay; negative if their signs are opposite.
    at_limit : bool
        Whether the best delay is the longest that was tried, which is no result.
    sampling_step_s : float
        Sampling step (s).
    second_peak_delay_s : float
        Another delay that fits as well (s); NaN without one.
    degrees_of_freedom : int
        Degrees of degrees_of_freedom of ``std_s``.
    """

    delay_s: float
    std_s: float
    correlation: float
    at_limit: bool
    sampling_step_s: float
    second_peak_delay_s: float = math.nan
    degrees_of_freedom: int = _JACKKNIFE_PIECES - 1

    @property
    def is_determined(self) -> bool:
        """True if the estimate is reliable: a single clear peak of the correlation inside the search range."""
        return not self.at_limit and abs(self.correlation) >= _MIN_CORRELATION and math.isnan(self.second_peak_delay_s)

    @property
    def low_s(self) -> float:
        """Lower end of the 95 % interval (s)."""
        return self.delay_s - self._half_interval_s

    @property
    def high_s(self) -> float:
        """Upper end of the 95 % interval (s)."""
        return self.delay_s + self._half_interval_s

    @property
    def _half_interval_s(self) -> float:
        return _student_quantile(self.degrees_of_freedom) * self.std_s

    def describe_delay(self) -> str:
        """Return the delay as one line of text."""
        if self.at_limit:
            longest = 1e3 * self.delay_s
            return f"no delay found (correlation {self.correlation:.2f} still grows at {longest:.4g} ms)"
        if abs(self.correlation) < _MIN_CORRELATION:
            share = 100 * self.correlation**2
            little = f"a delay explains {share:.2g} % of the response"
            return f"not determined (correlation {self.correlation:.2f}: {little})"
        if not math.isnan(self.second_peak_delay_s):
            second_ms = 1e3 * self.second_peak_delay_s
            return f"not determined ({1e3 * self.delay_s:.1f} ms and {second_ms:.0f} ms fit equally well)"
        spread = 1e3 * self._half_interval_s
        return f"{1e3 * self.delay_s:.1f} +- {spread:.1f} ms (95 %), correlation {self.correlation:.2f}"


def _student_quantile(degrees_of_freedom: int) -> float:
    """Return Student's t quantile for a 95 % interval."""
    return float(stdtrit(degrees_of_freedom, 0.975))


def estimate_delay(
    time: _Array, reference: _Array, response: _Array, *, longest_s: float = 1.0, causal: bool = False
) -> DelayEstimate:
    """Estimate the delay of a response behind its reference.

    Parameters
    ----------
    time : (n,) array
        Uniform time (s).
    reference, response : (n,) arrays
        Signals in any units; NaN is omitted. Linear trends are removed first.
    longest_s : float
        Largest absolute value of the delay to try (s); at most a quarter of the record.
    causal : bool
        Consider only non-negative delays and positive gains. Otherwise an oscillation fits as well half a period
        earlier with the opposite sign.

    Returns
    -------
    DelayEstimate

    Raises
    ------
    InputError
        If the clock is uneven, the record shorter than 30 samples, or a signal constant.
    """
    clock = examine_time_stamps(time)
    if clock.backward or clock.repeated or clock.jitter_ratio > 0.02:
        raise InputError("delay", "time", "is not evenly spaced", "resample first: give a rate")
    both = np.isfinite(reference) & np.isfinite(response)
    if both.sum() < 30:
        raise InputError(
            "delay", "", f"only {int(both.sum())} samples have both signals", "give a log with at least 30"
        )
    step = 1 / clock.rate_hz
    first, last = np.flatnonzero(both)[[0, -1]]
    x, y = _remove_trend(reference[first : last + 1]), _remove_trend(response[first : last + 1])
    if not (x.std() > 0 and y.std() > 0):
        raise InputError(
            "delay", "", "a constant signal has no delay", "choose a part of the log where both signals change"
        )
    n = len(x)
    most = max(2, min(round(longest_s / step), n // 4))
    reach = min(most + _SINC_HALF_WIDTH, n // 3)
    lags = np.arange(-reach, reach + 1)
    # The response stays within its window while the reference is shifted, so every lag uses the same samples. Products
    # and powers are summed by blocks, so that each block can be left out.
    pieces = min(_JACKKNIFE_PIECES, (n - 2 * reach) // _MIN_PIECE_SAMPLES)
    edges = np.linspace(reach, n - reach, pieces + 1).astype(int)
    power = np.concatenate(([0.0], np.cumsum(x * x)))
    products, sizes, energies = [], [], []
    for start, end in pairwise(edges.tolist()):
        part = y[start:end]
        products.append(correlate(x[start - reach : end + reach], part, mode="valid", method="fft")[::-1])
        sizes.append(power[end - lags] - power[start - lags])
        energies.append(float(part @ part))
    whole = np.sum(products, axis=0), np.sum(sizes, axis=0), sum(energies)
    c = _normalise_correlation(*whole, floor=power[-1])
    without = [
        _normalise_correlation(whole[0] - p, whole[1] - s, whole[2] - e, floor=power[-1])
        for p, s, e in zip(products, sizes, energies, strict=True)
    ]
    inside = (np.abs(lags) <= most) & ((lags >= 0) | (not causal))
    k = int(lags[inside][(c if causal else np.abs(c))[inside].argmax()])
    sign = float(np.sign(c[lags == k][0])) or 1.0
    lag, height = _refine_correlation_peak(lags, sign * c, k)
    at_limit = abs(lag) > most - 0.5
    close = np.abs(lags - k) <= 2 * _SINC_HALF_WIDTH
    others = [
        _refine_correlation_peak(lags, sign * w, int(lags[close][(sign * w)[close].argmax()]))[0] for w in without
    ]
    std = float(np.sqrt((pieces - 1) * np.var(others)))
    rival = _find_second_peak_lag(lags, sign * c, [sign * w for w in without], k, inside)
    second_peak_delay_s = math.nan if rival is None else rival * step
    return DelayEstimate(lag * step, step * std, sign * height, at_limit, step, second_peak_delay_s, pieces - 1)


def _normalise_correlation(product: _Array, size: _Array, energy: float, floor: float) -> _Array:
    out: _Array = product / np.sqrt(np.maximum(size, 1e-12 * floor) * max(energy, 1e-300))
    return out


def _refine_correlation_peak(lags: NDArray[np.int64], values: _Array, k: int) -> tuple[float, float]:
    """Return position and height of the peak near the integer lag ``k``."""
    near = np.abs(lags - k) <= _SINC_HALF_WIDTH
    found = minimize_scalar(
        lambda u: -_interpolate_lag(lags[near], values[near], u), bounds=(k - 1.0, k + 1.0), method="bounded",
        options={"xatol": 1e-5},
    )  # fmt: skip
    return float(found.x), -float(found.fun)


def _find_second_peak_lag(
    lags: NDArray[np.int64], c: _Array, without: list[_Array], k: int, inside: NDArray[np.bool_]
) -> int | None:
    """Return the lag of a second peak that is not significantly lower than the main one; None if there is none.

    It lies outside the half width of the main peak; the jackknife estimates the uncertainty.
    """
    at = int(np.flatnonzero(lags == k)[0])
    low = c < 0.5 * c[at]
    first = at - int(np.argmax(low[at::-1])) if low[: at + 1].any() else 0
    last = at + int(np.argmax(low[at:])) if low[at:].any() else len(c)
    apart = inside & ((np.arange(len(c)) < first) | (np.arange(len(c)) > last))
    if not apart.any():
        return None
    other = int(np.flatnonzero(apart)[c[apart].argmax()])
    lead = np.array([w[at] - w[other] for w in without])
    doubt = _student_quantile(len(lead) - 1) * np.sqrt((len(lead) - 1) * np.var(lead))
    return int(lags[other]) if c[at] - c[other] < doubt else None


def _remove_trend(x: _Array) -> _Array:
    """Remove the linear trend; missing values become zero and have no influence."""
    known = np.isfinite(x)
    out = np.zeros(len(x))
    index = np.arange(len(x), dtype=np.float64)
    slope, level = np.polyfit(index[known], x[known], 1)
    out[known] = x[known] - (level + slope * index[known])
    if out.std() <= 1e-12 * np.abs(x[known]).max():
        out[:] = 0.0
    result: _Array = detrend(out, type="constant") if known.all() else out
    return result


def _interpolate_lag(lags: NDArray[np.int64], values: _Array, at: float) -> float:
    """Interpolate between integer lags by a sinc with a Kaiser window."""
    u = at - lags
    inside = np.clip(1 - (u / (_SINC_HALF_WIDTH + 1)) ** 2, 0, None)
    weights = np.sinc(u) * np.i0(6.0 * np.sqrt(inside)) / np.i0(6.0)
    return float(weights @ values)


def compute_body_rates(time: _Array, attitude: _Array) -> _Array:
    """Return the body rates of a changing attitude, by central differences.

    Parameters
    ----------
    time : (n,) array
        Time (s).
    attitude : (n, 3) array
        Roll, pitch, yaw (rad), unwrapped.

    Returns
    -------
    (n, 3) array
        p, q, r (rad/s): p = dphi - dpsi sin(theta), q = dtheta cos(phi) + dpsi sin(phi) cos(theta),
        r = dpsi cos(phi) cos(theta) - dtheta sin(phi) (Stevens and Lewis, "Aircraft Control and Simulation", eq. 1.4).
    """
    roll, pitch, _ = attitude.T
    d_roll, d_pitch, d_yaw = np.gradient(attitude, time, axis=0).T
    out: _Array = np.column_stack(
        (
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch),
            d_yaw * np.cos(roll) * np.cos(pitch) - d_pitch * np.sin(roll),
        )
    )
    return out


_MIN_DELAY_SAMPLES, _MIN_PAIR_CORRELATION = 30, 0.3


@result
class DelayReport:
    """Estimated delay between two named channels of a log."""

    reference: str
    response: str
    delay: DelayEstimate

    def describe_delay(self) -> str:
        """Return the delay with its channels as one line of text."""
        return f"{self.response} after {self.reference}: {self.delay.describe_delay()}"


def estimate_channel_delays(data: xr.Dataset) -> list[DelayReport]:
    """Estimate the delays between channels of a flight record, pair by pair.

    Delays are estimated from references to measurements, component by component, and from the derivative of the
    measured attitude to the measured body rates. The latter two are one motion, so their delay is one of the instrument
    or the logger.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset on a uniform clock.
    """
    time = data["time"].values
    if len(time) < _MIN_DELAY_SAMPLES:
        return []
    pairs: list[tuple[str, str, _Array, _Array, bool]] = []
    for kind in ("attitude", "rates", "velocity", "position"):
        wanted, seen = f"reference_{kind}", f"measured_{kind}"
        if wanted in data and seen in data and data[wanted].dims == data[seen].dims:
            for label in data[seen][str(data[seen].dims[1])].values.tolist():
                place = f".{label}"
                a = data[wanted].loc[:, label].values
                b = data[seen].loc[:, label].values
                if kind == "attitude":
                    a, b = unwrap_angle(a), unwrap_angle(b)
                pairs.append((wanted + place, seen + place, a, b, True))
    if "measured_attitude" in data and "measured_rates" in data:
        implied = compute_body_rates(time, unwrap_angle(data["measured_attitude"].values))
        for k, label in enumerate("pqr"):
            name = f"d(measured_attitude)/dt, {label}"
            rate = data["measured_rates"].values[:, k]
            pairs.append((name, f"measured_rates.{label}", implied[:, k], rate, False))
    out = []
    for reference, response, x, y, causal in pairs:
        try:
            found = estimate_delay(time, x.astype(np.float64), y.astype(np.float64), causal=causal)
        except InputError:  # constant or too short
            continue
        if abs(found.correlation) >= _MIN_PAIR_CORRELATION and not found.at_limit:
            out.append(DelayReport(reference, response, found))
    return out
