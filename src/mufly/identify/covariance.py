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

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, fftconvolve

from mufly.identify.flight.problem import Free

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


# ----------------------------------------------------------------------------
# Combinations of parameters that data do not tell apart, in words; pairs are :mod:`mufly.identify.covariance`'s.
#
# With the covariance C of parameters in relative terms, C_ij = cov_ij / (theta_i theta_j), the eigenvectors of C with
# large eigenvalues are the directions that the data hardly see: moving all parameters along one of them, each by its
# share, changes nothing that was measured by more than its error. A direction is named if its standard deviation
# exceeds ``WIDE`` and it is not one parameter alone, or if a single parameter is known no better than that.


WIDE = 0.5  # relative standard deviation from which a direction counts as unseen
_NO_BOUND = 100.0  # relative standard deviation that says nothing
_SHARE = 0.15  # of the largest part of a direction, below which a parameter is left out of the sentence


def relative_covariance(information: Array, values: Array) -> Array:
    """Return the covariance of relative parameters from a Fisher information in SI units.

    Directions without information get a relative standard deviation of 1e6 instead of infinity.

    Parameters
    ----------
    information : (p, p) array
    values : (p,) array
        Parameters, not zero.
    """
    relative = information * np.outer(values, values)
    size, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    return (vectors / np.maximum(size, 1e-12)) @ vectors.T


def direction_in_words(symbols: Sequence[str], direction: Array, std: float) -> str:
    """Describe one direction of relative changes."""
    largest = int(np.argmax(np.abs(direction)))
    share = direction / direction[largest]
    parts = [k for k in np.argsort(-np.abs(share)) if abs(share[k]) >= _SHARE]
    if len(parts) == 1:
        if std > _NO_BOUND:
            return f"{symbols[largest]} is not seen at all"
        return f"{symbols[largest]} is hardly seen: {_percent(std)} of its value"
    if len(parts) == 2:
        other = parts[1]
        if abs(abs(share[other]) - 1.0) < 0.2:
            kind = "ratio" if share[other] > 0 else "product"
            return f"only the {kind} of {symbols[largest]} and {symbols[other]} is seen ({_percent(std)} along it)"
    moves = " with ".join(f"{symbols[k]} {10 * share[k]:+.0f} %" for k in parts)
    return f"{moves} changes nothing that the data show ({_percent(std)} along it)"


def _percent(std: float) -> str:
    return "no bound" if std > _NO_BOUND else f"standard deviation {100 * std:.0f} %"


def unseen_combinations(symbols: Sequence[str], covariance: Array, *, wide: float = WIDE) -> tuple[str, ...]:
    """Name the directions that data do not determine.

    Parameters
    ----------
    symbols : sequence of str
    covariance : (p, p) array
        Of the relative parameters.
    wide : float
        Relative standard deviation from which a direction is named.
    """
    size, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return tuple(
        direction_in_words(symbols, vectors[:, k], float(np.sqrt(size[k])))
        for k in np.argsort(-size)
        if size[k] > wide**2
    )


# ----------------------------------------------------------------------------
# How sure are the estimates, and which directions in their space do the data not see?
#
# With whitened sensitivities ``S`` (start values eliminated), residual ``e`` and the priors' information ``P``::
#
#     H = S^T S + P                                                Cramer-Rao: covariance H^-1 for white residuals
#     covariance = H^-1 (sum_ij S_i^T R(i - j) S_j + P) H^-1       coloured residuals, R their autocorrelation
#
# (Maine and Iliff, NASA RP 1168, Sec. 8.2; Klein and Morelli, Sec. 6.3). ``R`` is estimated from the residuals with
# Parzen's window, which reaches twice as far as the autocorrelation stands out of its noise (3.9 deviations); where
# none does, the residual counts as white, because the estimate of a correlation that is not there only adds noise.
# No variance is taken to be smaller than Cramer-Rao's.
#
# Directions come from the singular values of ``S`` alone: along a singular vector with value ``s`` the data leave
# ``theta`` open by ``1/s``. ``theta`` is a logarithm, so 0.5 means a factor of 1.6.


_Array = NDArray[np.float64]

_OPEN = 0.5  # a direction that the data leave open by more is not seen
_CLOSE = 0.98  # correlation of a pair that is hardly told apart ...
_MATTERS = 0.005  # ... if that leaves each of them open by more than this
_QUIET_LAGS = 10
_STANDS_OUT = 3.9  # deviations; some 300 lags of a fit are looked at, and none should by chance


def colour_reach(residual: _Array, longest: int) -> int:
    """Return the lag up to which the autocorrelation of a residual (n,) stands out of its noise; 0 if white."""
    e = residual - residual.mean()
    n, power = len(e), float(e @ e)
    if power <= 0.0:
        return 0
    full = np.asarray(np.fft.irfft(np.abs(np.fft.rfft(e, 2 * n)) ** 2)[: longest + 1], np.float64) / power
    reach = 0
    for lag in range(1, len(full)):
        if abs(full[lag]) > _STANDS_OUT / np.sqrt(n):
            reach = lag
        elif lag - reach >= _QUIET_LAGS:
            break
    return reach


def covariance_of(
    sensitivities: Sequence[_Array], residuals: Sequence[_Array], prior_std: _Array, *, longest: int = 300
) -> tuple[_Array, bool]:
    """Return the covariance of the estimates, corrected for coloured residuals.

    Parameters
    ----------
    sensitivities : sequence of (n, m, t) array
        Whitened, start values eliminated; one a record.
    residuals : sequence of (n, m) array
        Whitened, zero where nothing was measured.
    prior_std : (t,) array
        Infinite for none.
    longest : int
        Greatest lag looked at (samples).

    Returns
    -------
    covariance : (t, t) array
        Of ``theta``.
    coloured : bool
        Whether any residual was.
    """
    prior = np.diag(1.0 / prior_std**2)
    information = prior + sum(np.einsum("nmt,nmu->tu", s, s) for s in sensitivities)
    scale = 1.0 / np.sqrt(np.diag(information))
    bound = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-14, hermitian=True)
    bound = bound * np.outer(scale, scale)
    middle, coloured = prior.copy(), False
    for s, e in zip(sensitivities, residuals, strict=True):
        n, m, _ = s.shape
        reach = [colour_reach(e[:, k], min(longest, n // 4)) for k in range(m)]
        coloured = coloured or any(reach)
        for a in range(m):
            for b in range(m):
                far = max(reach[a], reach[b])
                if a == b and far == 0:
                    middle += s[:, a].T @ s[:, a]
                elif far > 0 and (a == b or (reach[a] and reach[b])):
                    r = _cross(e[:, a], e[:, b], 2 * far) * parzen(2 * far)
                    spread = fftconvolve(s[:, b], r[::-1, None], mode="full", axes=0)[2 * far : 2 * far + n]
                    middle += s[:, a].T @ spread
    middle = 0.5 * (middle + middle.T)
    covariance = bound @ middle @ bound
    grow = np.sqrt(np.maximum(1.0, np.diag(bound) / np.maximum(np.diag(covariance), 1e-300)))
    return covariance * np.outer(grow, grow), coloured


def _cross(a: _Array, b: _Array, far: int) -> _Array:
    """Return ``<a_i b_(i+k)>`` for k = -far..far."""
    n = len(a)
    size = 2 * n
    count = max(int(np.count_nonzero(a)), 1)
    r = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size) / count
    k = np.arange(-far, far + 1)
    return np.where(np.abs(k) < n, r[k % size], 0.0)


def unseen_in_words(free: Sequence[Free], jacobian: _Array, covariance: _Array) -> tuple[str, ...]:
    """Say which parameters and combinations of them the data leave open.

    Parameters
    ----------
    free : sequence of Free
    jacobian : (rows, t) array
        Whitened, without priors.
    covariance : (t, t) array
        Of ``theta``.
    """
    said: list[str] = []
    covered: set[frozenset[str]] = set()
    _, values, vectors = np.linalg.svd(np.linalg.qr(jacobian, mode="r"))
    values = np.concatenate([values, np.zeros(len(free) - len(values))])
    for value, vector in zip(values, vectors, strict=True):
        if value * _OPEN >= 1.0:
            continue
        members = [k for k in np.argsort(-np.abs(vector)) if abs(vector[k]) > 0.25 * np.max(np.abs(vector))]
        names = [free[k].symbol for k in members]
        covered.add(frozenset(names))
        said.append(_in_words(names, vector[members], 1.0 / max(float(value), 1e-9)))
    std = np.sqrt(np.diag(covariance))
    for i in range(len(free)):
        for j in range(i + 1, len(free)):
            c = covariance[i, j] / max(std[i] * std[j], 1e-300)
            pair = frozenset((free[i].symbol, free[j].symbol))
            if abs(c) < _CLOSE or min(std[i], std[j]) < _MATTERS or any(pair <= s for s in covered):
                continue
            seen = "sum" if c < 0 else "ratio"
            said.append(
                f"{free[i].symbol} and {free[j].symbol} are hardly told apart (correlation {c:+.4f}): the data see "
                f"their {seen} {1.0 / np.sqrt(max(1.0 - c * c, 1e-12)):.0f} times better than either"
            )
    return tuple(said)


def _in_words(names: list[str], parts: _Array, gap: float) -> str:
    factor = f"a factor of {np.exp(gap):.2g}" if gap < 5 else "more than a factor of 100"
    if len(names) == 1:
        return f"{names[0]} is not seen: the data leave it open by {factor}; its value is the start's"
    if len(names) == 2:
        same = parts[0] * parts[1] > 0
        seen = f"{names[0]}/{names[1]}" if same else f"{names[0]} and {names[1]} together (product or sum)"
        other = "their common size" if same else "how it is shared"
        return f"only {'the ratio ' if same else ''}{seen} is seen, not {other}: open by {factor}"
    shares = ", ".join(f"{n} {p / parts[0]:+.2f} %" for n, p in zip(names, parts, strict=True))
    return f"{', '.join(names)} are seen only in combination: changing {shares} changes nothing ({factor})"
