"""How sure are the estimates, and which directions in their space do the data not see?

With whitened sensitivities ``S`` (start values eliminated), residual ``e`` and the priors' information ``P``::

    H = S^T S + P                                                Cramer-Rao: covariance H^-1 for white residuals
    covariance = H^-1 (sum_ij S_i^T R(i - j) S_j + P) H^-1       coloured residuals, R their autocorrelation

(Maine and Iliff, NASA RP 1168, Sec. 8.2; Klein and Morelli, Sec. 6.3). ``R`` is estimated from the residuals with
Parzen's window, which reaches twice as far as the autocorrelation stands out of its noise (3.9 deviations); where
none does, the residual counts as white, because the estimate of a correlation that is not there only adds noise.
No variance is taken to be smaller than Cramer-Rao's.

Directions come from the singular values of ``S`` alone: along a singular vector with value ``s`` the data leave
``theta`` open by ``1/s``. ``theta`` is a logarithm, so 0.5 means a factor of 1.6.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from mufly.identify.free import Free
from mufly.identify.uncertainty import parzen

__all__ = ["colour_reach", "covariance_of", "unseen_in_words"]

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
