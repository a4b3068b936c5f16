"""Zero drift: what the load cells read when nothing turns, before, between and after the runs.

Readings at zero speed come in blocks (consecutive lines at rest). Over the time ``t`` of the measurement, or the
number of the line where no time was kept, a polynomial

    zero(t) = a_0 + a_1 tau + ... + a_d tau^d,      tau = (t - middle) / half the span of the zeros

is fitted to them. Its degree, at most one less than the number of blocks and at most 3, has the least AICc (Hurvich
and Tsai, Biometrika 76, 1989) of the readings; the covariance of ``a`` is that of :mod:`mufly.bench.covariance`, with
readings of one block allowed to err alike. From a single block the zero is constant by assumption, which is said.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.bench.covariance import Spread, spread

__all__ = ["ZeroDrift", "fit_drift"]

Array = NDArray[np.float64]

_HIGHEST = 3


@dataclass(frozen=True, eq=False)
class ZeroDrift:
    """Reading of one sensor without load, over time.

    Attributes
    ----------
    coefficients : (d + 1,) array
        a of the module docstring, in units of the reading.
    spread : Spread
        Covariance of the coefficients; ``scale`` is the scatter of the zero readings.
    middle, half : float
        Of the time.
    blocks : int
        How often the zero was read.
    change : float
        Zero at the end less zero at the beginning of the span.
    """

    coefficients: Array
    spread: Spread
    middle: float
    half: float
    blocks: int
    change: float

    def basis(self, time: Array) -> Array:
        """Return powers of tau, (n, d + 1)."""
        return np.vander((time - self.middle) / self.half, self.coefficients.size, increasing=True)

    def at(self, time: Array) -> Array:
        """Return the zero reading (n,) at times (n,)."""
        return self.basis(time) @ self.coefficients

    def std_at(self, time: Array) -> Array:
        """Return the standard deviation (n,) of the zero."""
        b = self.basis(time)
        return np.sqrt(np.einsum("ij,jk,ik->i", b, self.spread.covariance, b))


def fit_drift(time: Array, reading: Array, at_rest: NDArray[np.bool_]) -> ZeroDrift | None:
    """Fit the zero of a sensor.

    Parameters
    ----------
    time : (n,) array
        Of all readings, in the order of measurement.
    reading : (n,) array
    at_rest : (n,) array of bool
        Which were taken without load.

    Returns
    -------
    ZeroDrift or None
        None without a reading at rest.
    """
    if not at_rest.any():
        return None
    starts = np.diff(np.r_[False, at_rest].astype(int)) == 1
    block = np.cumsum(starts)[at_rest].astype(np.int64)
    t, y = time[at_rest], reading[at_rest]
    blocks = int(block.max())
    middle, half = 0.5 * (t.max() + t.min()), max(0.5 * float(np.ptp(t)), 1e-9)
    tau, n = (t - middle) / half, y.size
    chosen, least = 0, np.inf
    for degree in range(min(_HIGHEST, blocks - 1, n - 3) + 1 if n > 3 else 1):
        a = np.vander(tau, degree + 1, increasing=True)
        rest = y - a @ np.linalg.lstsq(a, y, rcond=None)[0]
        k = degree + 2
        if n - k - 1 <= 0:
            break
        score = n * np.log(max(float(rest @ rest) / n, 1e-300)) + 2 * k + 2 * k * (k + 1) / (n - k - 1)
        if score < least:
            chosen, least = degree, score
    if n <= 3 and blocks >= 2:
        chosen = 1  # before and after: a straight line, and no reading left over to judge it by
    a = np.vander(tau, chosen + 1, increasing=True)
    solution = np.asarray(np.linalg.lstsq(a, y, rcond=None)[0], dtype=np.float64)
    if n > chosen + 1:
        s = spread(a, y - a @ solution, group=block)
    else:
        s = Spread(np.zeros((chosen + 1, chosen + 1)), 0.0, 1.0, "white", 0.0)
    ends = np.vander(np.array([-1.0, 1.0]), chosen + 1, increasing=True) @ solution
    return ZeroDrift(solution, s, float(middle), half, blocks, float(ends[1] - ends[0]))
