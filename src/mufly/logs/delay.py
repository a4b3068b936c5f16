"""How much later is one signal than another? By cross-correlation, to a fraction of a sample, with an interval.

Model: y(t) = a x(t - tau) + e(t). The delay that fits in the least-squares sense, with the gain a free, is where the
normalised cross-correlation of x and y is greatest in size. It is computed at whole samples and interpolated between
them by a windowed sinc (exact for signals without content above half the sampling rate), because interpolating the
signals themselves would smooth their noise by an amount that depends on the fraction, and pull the answer towards a
whole or a half sample.

Uncertainty: linearised about the solution, y - a x(t - tau) has the sensitivity s = -a dx/dt to tau, so
var(tau) = s^T R s / (s^T s)^2 with the covariance R of the residual e. R is estimated from the residual's own
autocorrelation, since residuals of flight data are never white (the correction that Klein and Morelli, "Aircraft
System Identification", 2nd ed., Sec. 5.3, use for parameters). It holds for a delay: where the response is filtered
rather than delayed, tau is the delay that looks most like it.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import correlate, detrend

from mufly.errors import InputError
from mufly.logs.topics import check_clock, unwrap
from mufly.results import result

_Array = NDArray[np.float64]
_Z95 = 1.959964
# Lags on either side of the peak that the windowed sinc uses.
_HALF_WIDTH = 24


@result
class Delay:
    """A delay, as it was estimated.

    Attributes
    ----------
    delay_s : float
        By how much the response comes later; negative if it leads.
    std_s : float
        Standard deviation (s), from the residual.
    correlation : float
        Of the two signals with the delay taken out; negative if they run against each other.
    at_limit : bool
        Whether the best delay is the longest that was tried: then it is none.
    step_s : float
        Sampling step (s).
    """

    delay_s: float
    std_s: float
    correlation: float
    at_limit: bool
    step_s: float

    @property
    def low_s(self) -> float:
        """Lower end of the 95 % interval (s)."""
        return self.delay_s - _Z95 * self.std_s

    @property
    def high_s(self) -> float:
        """Upper end of the 95 % interval (s)."""
        return self.delay_s + _Z95 * self.std_s

    def words(self) -> str:
        """The delay in one line."""
        if self.at_limit:
            longest = 1e3 * self.delay_s
            return f"no delay found (correlation {self.correlation:.2f} still grows at {longest:.4g} ms)"
        spread = 1e3 * _Z95 * self.std_s
        return f"{1e3 * self.delay_s:.1f} +- {spread:.1f} ms (95 %), correlation {self.correlation:.2f}"


def estimate_delay(
    time: _Array, reference: _Array, response: _Array, *, longest_s: float = 1.0, causal: bool = False
) -> Delay:
    """Estimate by how much a response comes later than its reference.

    Parameters
    ----------
    time : (n,) array
        Evenly spaced (s).
    reference, response : (n,) arrays
        Any units; NaN is left out. Straight-line trends are taken out first.
    longest_s : float
        Longest delay, of either sign, to try (s); at most a quarter of the record.
    causal : bool
        Look only for a response that follows: it does not come first, and it does not run against its reference.
        Without that, an oscillation fits as well half a period earlier with the other sign.

    Returns
    -------
    Delay

    Raises
    ------
    InputError
        If the clock is uneven, the record shorter than 30 samples, or a signal constant.
    """
    clock = check_clock(time)
    if clock.backward or clock.repeated or clock.jitter > 0.02:
        raise InputError("delay", "time", "is not evenly spaced", "resample first: give a rate")
    both = np.isfinite(reference) & np.isfinite(response)
    if both.sum() < 30:
        raise InputError("delay", "", f"{int(both.sum())} samples in common", "give at least 30")
    step = 1 / clock.rate_hz
    first, last = np.flatnonzero(both)[[0, -1]]
    x, y = _levelled(reference[first : last + 1]), _levelled(response[first : last + 1])
    if not (x.std() > 0 and y.std() > 0):
        raise InputError("delay", "", "a constant signal has no delay", "choose a stretch where both move")
    n = len(x)
    most = max(2, min(round(longest_s / step), n // 4))
    reach = min(most + _HALF_WIDTH, n // 3)
    lags = np.arange(-reach, reach + 1)
    # The response stays within its window while the reference slides past, so every lag is judged by the same
    # samples.
    c = correlate(x, y[reach : n - reach], mode="valid", method="fft")[::-1]
    power = np.concatenate(([0.0], np.cumsum(x * x)))
    size = (power[n - 2 * reach :] - power[: 2 * reach + 1])[::-1]
    c = c / np.sqrt(np.maximum(size, 1e-12 * power[-1]) * float(y[reach : n - reach] @ y[reach : n - reach]))
    inside = (np.abs(lags) <= most) & ((lags >= 0) | (not causal))
    k = int(lags[inside][(c if causal else np.abs(c))[inside].argmax()])
    sign = float(np.sign(c[lags == k][0])) or 1.0
    near = lags[np.abs(lags - k) <= _HALF_WIDTH]
    values = c[np.abs(lags - k) <= _HALF_WIDTH]
    found = minimize_scalar(
        lambda u: -sign * _between(near, values, u), bounds=(k - 1.0, k + 1.0), method="bounded",
        options={"xatol": 1e-5},
    )  # fmt: skip
    lag = float(found.x)
    at_limit = abs(lag) > most - 0.5
    return Delay(lag * step, step * _spread(x, y, lag, reach), sign * -float(found.fun), at_limit, step)


def _levelled(x: _Array) -> _Array:
    """Without its straight-line trend; what is missing becomes zero and so says nothing."""
    known = np.isfinite(x)
    out = np.zeros(len(x))
    index = np.arange(len(x), dtype=np.float64)
    slope, level = np.polyfit(index[known], x[known], 1)
    out[known] = x[known] - (level + slope * index[known])
    if out.std() < 1e-12 * (np.abs(x[known]).max() + 1e-300):
        out[:] = 0.0
    result: _Array = detrend(out, type="constant") if known.all() else out
    return result


def _between(lags: NDArray[np.int64], values: _Array, at: float) -> float:
    """Value between whole lags, by a sinc under a Kaiser window."""
    u = at - lags
    inside = np.clip(1 - (u / (_HALF_WIDTH + 1)) ** 2, 0, None)
    weights = np.sinc(u) * np.i0(6.0 * np.sqrt(inside)) / np.i0(6.0)
    return float(weights @ values)


def _spread(x: _Array, y: _Array, lag: float, edge: int) -> float:
    """Standard deviation of the delay (samples), from all samples but ``edge`` at either end."""
    n = len(x)
    frequency = np.fft.rfftfreq(2 * n)
    spectrum = np.fft.rfft(x, 2 * n) * np.exp(-2j * np.pi * frequency * lag)
    part = slice(edge, n - edge)
    shifted = np.fft.irfft(spectrum)[:n][part]
    rate = np.fft.irfft(spectrum * 2j * np.pi * frequency)[:n][part]
    target = y[part]
    gain = float(shifted @ target / (shifted @ shifted))
    residual = target - gain * shifted
    s = gain * rate
    # The sandwich with the autocorrelation up to a tenth of the record, under a triangle so that it stays positive.
    m = len(residual)
    width = max(10, m // 10)
    r = correlate(residual, residual, mode="full", method="fft")[m - 1 : m - 1 + width] / m
    q = correlate(s, s, mode="full", method="fft")[m - 1 : m - 1 + width]
    weight = 1 - np.arange(width) / width
    middle = r[0] * q[0] + 2 * float(np.sum((weight * r * q)[1:]))
    # Where residual and sensitivity alternate, the estimate can cancel; white residuals are the least to assume then.
    return float(np.sqrt(max(middle, 0.1 * r[0] * q[0])) / q[0])


def body_rates_of_attitude(time: _Array, attitude: _Array) -> _Array:
    """Return the body rates that a changing attitude implies, by central differences.

    Parameters
    ----------
    time : (n,) array
        s.
    attitude : (n, 3) array
        Roll, pitch, yaw (rad), without jumps.

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


_FEWEST = 30


@result
class DelayReport:
    """The delay from one channel to another, by name."""

    reference: str
    response: str
    delay: Delay

    def words(self) -> str:
        """In one line."""
        return f"{self.response} after {self.reference}: {self.delay.words()}"


def check_delays(data: xr.Dataset, *, least_correlation: float = 0.3) -> list[DelayReport]:
    """Estimate the delays that a flight's record can show.

    From references to measurements, component by component, and from the derivative of the measured attitude to the
    measured body rates: these two are one motion, so a delay there is one of the instrument or the logger.

    Parameters
    ----------
    data : xarray.Dataset
        On an even clock.
    least_correlation : float
        Pairs that agree less, with the delay taken out, are left out.
    """
    time = data["time"].values
    if len(time) < _FEWEST:
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
                    a, b = unwrap(a), unwrap(b)
                pairs.append((wanted + place, seen + place, a, b, True))
    if "measured_attitude" in data and "measured_rates" in data:
        implied = body_rates_of_attitude(time, unwrap(data["measured_attitude"].values))
        for k, label in enumerate("pqr"):
            name = f"d(measured_attitude)/dt, {label}"
            rate = data["measured_rates"].values[:, k]
            pairs.append((name, f"measured_rates.{label}", implied[:, k], rate, False))
    out = []
    for reference, response, x, y, causal in pairs:
        try:
            found = estimate_delay(time, x.astype(np.float64), y.astype(np.float64), causal=causal)
        except InputError:  # constant, or too short: nothing to say
            continue
        if abs(found.correlation) >= least_correlation and not found.at_limit:
            out.append(DelayReport(reference, response, found))
    return out
