"""Covariance of estimates when residuals are coloured, and what the data cannot tell apart, in words.

An output-error fit minimises ``sum_i e_i^T W e_i`` with sensitivities ``S_i = d y_i / d theta``. If the residuals
were white with covariance ``W^-1`` the covariance of the estimates would be the Cramer-Rao bound ``M^-1``,
``M = sum_i S_i^T W S_i``. Residuals of flight data are not white (vibration, wind, what the model leaves out), and the
bound is then too small by a factor of 5 to 10 in standard deviation. With the residuals' autocorrelation
``R(k) = <e_i e_(i+k)^T>`` the covariance of the same estimate is (Morelli and Klein 1997, "Accuracy of aerodynamic
model parameters estimated from flight test data", J. Guidance 20(1); Klein and Morelli, Sec. 6.3)

    Cov = M^-1 [ sum_i sum_j S_i^T W R(i - j) W S_j ] M^-1

``R`` is estimated from the residuals themselves with a Parzen lag window, which keeps the bracket positive
semi-definite. Convolution makes the double sum an FFT.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, fftconvolve

__all__ = ["coloured_covariance", "correlation_of", "parzen", "unseen_directions"]

Array = NDArray[np.float64]


def parzen(lags: int) -> Array:
    """Return Parzen's lag window at lags -lags..lags; its transform is never negative."""
    x = np.abs(np.arange(-lags, lags + 1)) / max(lags, 1)
    return np.where(x <= 0.5, 1.0 - 6.0 * x**2 + 6.0 * x**3, 2.0 * np.clip(1.0 - x, 0.0, None) ** 3)


def coloured_covariance(
    sensitivity: Array, residual: Array, weight: Array, *, max_lag: int | None = None
) -> tuple[Array, Array]:
    """Return the covariance of an output-error estimate, corrected for coloured residuals, and the plain bound.

    Parameters
    ----------
    sensitivity : (n, m, p) array
        Of the ``m`` outputs to the ``p`` parameters; zero where nothing was measured.
    residual : (n, m) array
        Zero where nothing was measured.
    weight : (m,) array
        Inverse variances used in the fit.
    max_lag : int, optional
        Of the autocorrelation, in samples; default a fifth of the record.

    Returns
    -------
    covariance : (p, p) array
        Never smaller than the plain bound on its diagonal.
    bound : (p, p) array
        Cramer-Rao bound for white residuals.
    """
    n, m, p = sensitivity.shape
    weighted = sensitivity * weight[None, :, None]
    information = np.einsum("nmp,nmq->pq", sensitivity, weighted)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-13, hermitian=True)
    bound = inverse / np.outer(scale, scale)
    lags = min(n - 1, max(1, n // 5 if max_lag is None else max_lag))
    window = parzen(lags)
    middle = np.zeros((p, p))
    for a in range(m):
        for b in range(m):
            r = np.asarray(correlate(residual[:, b], residual[:, a], mode="full", method="fft")) / n
            r = r[n - 1 - lags : n + lags] * window
            # sum_ij S_i,a r_ab(j - i) S_j,b
            spread = fftconvolve(
                weighted[:, b, :], r[::-1, None], mode="same" if n > r.size else "full", axes=0
            )
            if spread.shape[0] != n:
                start = (spread.shape[0] - n) // 2
                spread = spread[start : start + n]
            middle += weighted[:, a, :].T @ spread
    middle = 0.5 * (middle + middle.T)
    covariance = bound @ middle @ bound
    # A few correlated samples can make the estimate of R smaller than white noise would be: keep the larger.
    d, d0 = np.diag(covariance), np.diag(bound)
    factor = np.sqrt(np.maximum(1.0, d0 / np.maximum(d, 1e-300)))
    return covariance * np.outer(factor, factor), bound


def correlation_of(covariance: Array) -> Array:
    """Return the correlation matrix of a covariance."""
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return np.clip(covariance / np.outer(std, std), -1.0, 1.0)


def unseen_directions(
    symbols: tuple[str, ...],
    values: Array,
    std: Array,
    correlation: Array,
    *,
    close: float = 0.98,
    wide: float = 1.0,
) -> tuple[str, ...]:
    """Say which parameters, or combinations, the data do not determine.

    Parameters
    ----------
    symbols : tuple of str
    values, std : (p,) array
    correlation : (p, p) array
    close : float
        Pairs with a larger correlation cannot be told apart.
    wide : float
        A parameter whose standard deviation exceeds this share of its size is not determined.
    """
    said = []
    for i, j in zip(*np.triu_indices(len(symbols), 1), strict=True):
        c = float(correlation[i, j])
        if abs(c) >= close:
            what = "difference (or ratio)" if c > 0.0 else "sum (or product)"
            said.append(
                f"{symbols[i]} and {symbols[j]} cannot be told apart (correlation {c:+.3f}): the data see "
                f"their {what}, not each"
            )
    for symbol, value, s in zip(symbols, values, std, strict=True):
        if not np.isfinite(s):
            said.append(f"{symbol} is not seen by the data at all")
        elif s > wide * max(abs(value), 1e-12):
            said.append(f"{symbol} is not determined: {value:.3g} with a standard deviation of {s:.2g}")
    return tuple(said)
