"""Gain between a measured acceleration and its prediction from the inputs, estimated without bias in closed loop.

In closed loop an input also answers the disturbance ``w`` that it rejects. With ``a = g m + w`` (``m``: predicted
from the inputs) and ``m = -c w``, regression of ``a`` on ``m`` gives ``g - 1/c``: the wrong sign if the loop rejects
a part only. Causality tells the two apart. A disturbance is coloured, and its innovation ``e`` comes after the inputs
that act on the same sample (prediction error method, direct approach; Ljung, *System Identification*, 2nd ed.,
secs 3.2, 13.4)::

    y[k] = g M[k] + b(t[k]) + n[k],      A(q) n[k] = e[k]

``y`` is the change of a measured rate over a block, and ``M`` the prediction, integrated over the block. A measured
position or angle is taken as it is, with the prediction integrated twice from the start. ``b`` is the polynomial of the
unknown initial values and of a constant acceleration. ``A`` is autoregressive. A position is not differenced: its noise
is large, and two differences give it two zeros at 1, which no short ``A`` describes.

Gain and noise are found in turn (Cochrane and Orcutt 1949) at every lag of the input. Two hypotheses compete: the best
fit, and the best fit with the other sign or without the input. Their evidence is ``(n/2) ln(V_other / V_best)``, the
logarithm of the likelihood ratio. It is small if feedback alone drives the input and explains it: no sign is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MIN_BLOCK_S = 0.04  # shortest block: below it sensor noise dominates the difference of a rate
_NOISE_MODEL_MEMORY_S = 0.4  # memory of the noise model: about the period of the fastest loop of a helicopter of 100 g
_GAIN_NOISE_ITERATIONS = 4
_MIN_BLOCKS = 60


@dataclass(frozen=True)
class CausalGain:
    """Gains by which predicted accelerations explain a measured motion, and the evidence for the leading gain's sign.

    The leading gain is that of the prediction that explains most of the motion.

    Attributes
    ----------
    value, std : (k,) array
        Gain of each prediction and its standard deviation.
    lead_samples : int
        Index of the prediction that explains most.
    sign_log_likelihood_ratio : float
        Logarithm of the likelihood ratio of the best fit to the best one whose leading gain has the other sign or is 0.
    """

    value: Array
    std: Array
    lead_samples: int
    sign_log_likelihood_ratio: float


def estimate_causal_gain(
    measured: Array,
    predicted: Array,
    sample_s: float,
    *,
    is_rate: bool,
    beside: Array | None = None,
    skip_s: float = 0.0,
    longest_lag_s: float = 0.0,
) -> CausalGain | None:
    """Estimate the gains by which predicted accelerations explain a measured motion; ``None`` for too short a record.

    Parameters
    ----------
    measured : (n,) array
        Speed or rate, else position or angle, as measured: not smoothed, which would mix in the future.
    predicted : (n, k) array
        Accelerations predicted from the inputs, in the unit of ``measured`` per ``s`` or ``s^2``.
    sample_s : float
        Sample time (s).
    is_rate : bool
        Whether ``measured`` is a speed or rate.
    beside : (n, j) array, optional
        Further accelerations with a gain but no lag of their own.
    skip_s : float
        Time at the start that is not used (s).
    longest_lag_s : float
        Longest lag of the motion behind the prediction (s).
    """
    known = np.flatnonzero(np.isfinite(measured))
    if len(known) < 2 or not np.isfinite(predicted).all():
        return None
    y = np.interp(np.arange(len(measured)), known, measured[known])
    spacing = float(np.median(np.diff(known)))  # in samples: a slow sensor has no value in most of them
    block = max(round(_MIN_BLOCK_S / sample_s), 1 if spacing == 1.0 else 2 * round(spacing))
    first = round(max(skip_s, longest_lag_s) / sample_s)
    blocks = (len(y) - 1 - first) // block
    if blocks < _MIN_BLOCKS:
        return None
    y = y[first : first + blocks * block + 1 : block]
    order = min(max(2, round(_NOISE_MODEL_MEMORY_S / (block * sample_s))), len(y) // 15)
    powers = np.linspace(-1.0, 1.0, len(y))[:, None] ** np.arange(3)
    if is_rate:
        y, powers = np.diff(y), powers[1:, :1]

    def integrate_lagged_acceleration(x: Array, lag: int) -> Array:
        z = x[first - lag : first - lag + blocks * block + 1]
        for _ in range(1 if is_rate else 2):
            z = np.vstack([np.zeros_like(z[:1]), np.cumsum(0.5 * (z[1:] + z[:-1]), axis=0) * sample_s])
        return np.asarray(np.diff(z[::block], axis=0) if is_rate else z[::block])

    k = predicted.shape[1]
    still = powers if beside is None else np.column_stack([integrate_lagged_acceleration(beside, 0), powers])
    none = _fit_gains(y, still, order, np.zeros(still.shape[1]))[2]
    best: tuple[float, Array, Array, int] | None = None
    other = {1: none, -1: none}
    step = max(1, round(0.5 * _MIN_BLOCK_S / sample_s))
    for lag in range(0, round(longest_lag_s / sample_s) + 1, step):
        x = np.column_stack([integrate_lagged_acceleration(predicted, lag), still])
        spread = x[:, :k].std(axis=0)
        ordinary = np.asarray(np.linalg.lstsq(x, y, rcond=None)[0], dtype=np.float64)
        for start in (ordinary, np.zeros_like(ordinary)):
            g, std, variance = _fit_gains(y, x, order, start)
            lead = int(np.argmax(np.abs(g[:k]) * spread))
            side = 1 if g[lead] > 0.0 else -1
            other[side] = min(other[side], variance)
            if best is None or variance < best[0]:
                best = variance, g[:k], std[:k], lead
    assert best is not None
    variance, g, std, lead = best
    rival = other[-1 if g[lead] > 0.0 else 1]
    evidence = 0.5 * (len(y) - order) * float(np.log(max(rival, 1e-300) / max(variance, 1e-300)))
    return CausalGain(g, std, lead, evidence)


def _fit_gains(y: Array, x: Array, order: int, start: Array) -> tuple[Array, Array, float]:
    """Return gains, their standard deviations and the variance of the innovations, with autoregressive noise."""
    g = start
    for _ in range(_GAIN_NOISE_ITERATIONS):
        n = y - x @ g
        past = np.column_stack([n[order - i - 1 : len(n) - i - 1] for i in range(order)])
        a = np.linalg.lstsq(past, n[order:], rcond=None)[0]
        white = [np.convolve(z, np.r_[1.0, -a])[order : len(n)] for z in (y, *x.T)]
        xw = np.column_stack(white[1:])
        g = np.linalg.lstsq(xw, white[0], rcond=None)[0]
    e = white[0] - xw @ g
    variance = float(e @ e) / len(e)
    return g, np.sqrt(np.maximum(np.diag(np.linalg.pinv(xw.T @ xw)) * variance, 0.0)), variance
