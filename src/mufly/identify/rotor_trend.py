"""Is a rotor's coefficient constant over speed? The Reynolds trend, and the offset that looks like it.

With ``x = ln(W / W_0)`` and ``W_0`` the weighted geometric mean of the speeds,

    load = q (p_0 + p_1 x + p_2 x^2)

is linear in p; its degree, up to 2, has the least AICc (Hurvich and Tsai, Biometrika 76, 1989), and the coefficient
is not constant if ``p_1, p_2`` differ from zero by Wald's test at 5 %. With the Reynolds number proportional to the
speed, ``p_1 / p_0`` is the power with which the coefficient goes with Re. The rival ``load = c q + F_0`` is a load
cell that does not read zero; which of the two the data prefer is said, and that is all that they can say. Where the
speed rose or fell all through the measurement, a drift of the sensors would look like a trend as well; that too is
said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mufly.bench import Spread, spread

__all__ = ["Trend", "fit_trend"]

Array = NDArray[np.float64]

_RPM = math.pi / 30.0
_ORDERED = 0.8  # rank correlation of speed and order from which drift and trend cannot be told apart
_ALIKE = 0.02  # speeds closer than this share show no bend between them
_AS_WELL = 2.0  # differences of AICc below which two explanations fit equally well


@dataclass(frozen=True, eq=False)
class Trend:
    """A coefficient over speed.

    Attributes
    ----------
    channel, symbol : str
    reference_rad_s : float
        W_0.
    coefficients : (d + 1,) array
        p_0 ... p_d.
    spread : Spread
        Their covariance.
    significant : bool
        Whether the coefficient changes with speed by more than its error.
    offset, offset_std : float
        F_0 of the rival explanation (N or N m).
    against_offset : float
        AICc of the rival less that of the trend: positive if the trend explains more.
    range_rad_s : (float, float)
    ordered : bool
        Speeds rose or fell all through the measurement.
    """

    channel: str
    symbol: str
    reference_rad_s: float
    coefficients: Array
    spread: Spread
    significant: bool
    offset: float
    offset_std: float
    against_offset: float
    range_rad_s: tuple[float, float]
    ordered: bool

    def _basis(self, speed_rad_s: float | Array) -> Array:
        x = np.log(np.abs(np.asarray(speed_rad_s, dtype=np.float64)) / self.reference_rad_s)
        return np.stack([x**k for k in range(self.coefficients.size)], axis=-1)

    def value_at(self, speed_rad_s: float | Array) -> Array:
        """Return the coefficient at speeds."""
        return np.asarray(self._basis(speed_rad_s) @ self.coefficients)

    def std_at(self, speed_rad_s: float | Array) -> Array:
        """Return the standard deviation of the coefficient at speeds."""
        b = self._basis(speed_rad_s)
        return np.sqrt(np.einsum("...i,ij,...j->...", b, self.spread.covariance, b))

    def change(self) -> tuple[float, float]:
        """Return the change from the lowest to the highest speed, relative, and half its 95 % interval."""
        low, high = (self._basis(w) for w in self.range_rad_s)
        start, end = float(low @ self.coefficients), float(high @ self.coefficients)
        slope = high / start - low * end / start**2
        return end / start - 1.0, self.spread.quantile * math.sqrt(
            float(slope @ self.spread.covariance @ slope)
        )

    def in_words(self) -> str:
        """Say whether the coefficient is constant within its error."""
        low, high = self.range_rad_s
        change, doubt = self.change()
        over = f"{100 * change:+.1f} +- {100 * doubt:.1f} % from {low / _RPM:.0f} to {high / _RPM:.0f} rpm"
        if not self.significant:
            return f"{self.symbol} is constant within its error over a speed range of {high / low:.2g} : 1 ({over})"
        speeds = (low, math.sqrt(low * high), high)
        shape = ", ".join(f"{float(self.value_at(w)):.5f} at {w / _RPM:.0f} rpm" for w in speeds)
        text = f"{self.symbol} is not constant: {over} ({shape})"
        unit = "N" if self.channel.startswith("thrust") else "N m"
        offset = f"an offset of the load cell of {self.offset:.3g} +- {2 * self.offset_std:.2g} {unit}"
        if self.against_offset < -_AS_WELL:
            text += f"; but {offset} would explain more: read its zero at rest"
        elif self.against_offset < _AS_WELL:
            text += f"; {offset} would explain it as well: read its zero at rest"
        else:
            text += "; a Reynolds trend explains more than an offset of the load cell"
        return text + (", and a drift during the measurement would look the same" if self.ordered else "")


def fit_trend(
    channel: str, symbol: str, speed: Array, unit: Array, load: Array, expected: Array,
    run: NDArray[np.int64] | None = None,
) -> Trend:  # fmt: skip
    """Fit a coefficient over speed, and its rival.

    Parameters
    ----------
    channel, symbol : str
        Names in words.
    speed, unit, load, expected : (n,) array
        rad/s; q; N or N m; expected error of the load, up to a factor. In the order of measurement, five or more.
    run : (n,) int array, optional
    """
    n = load.size
    weight = (unit / expected) ** 2
    speed = np.abs(speed)
    reference = float(np.exp(np.sum(weight * np.log(speed)) / np.sum(weight)))
    x = np.log(speed / reference)
    ordered = (
        abs(float(stats.spearmanr(np.arange(n), speed).statistic)) > _ORDERED if np.ptp(speed) > 0 else False
    )
    chosen, least = 1, math.inf
    bends = n >= 8 and np.unique(np.round(x / _ALIKE)).size >= 4
    for degree in range(1, 3 if bends else 2):
        score = _aicc(_columns(unit, x, degree, expected), load / expected)
        if score < least - (_AS_WELL if degree > 1 else 0.0):
            chosen, least = degree, score
    a = _columns(unit, x, chosen, expected)
    p = np.asarray(np.linalg.lstsq(a, load / expected, rcond=None)[0], dtype=np.float64)
    # Correlated errors along an ordered measurement and a trend over speed are one and the same to the data.
    found = spread(a, load / expected - a @ p, run=np.arange(n) if ordered else run)
    tail = found.covariance[1:, 1:]
    wald = float(p[1:] @ np.linalg.solve(tail, p[1:])) / chosen if np.all(np.diag(tail) > 0) else 0.0
    b = np.column_stack([unit, np.ones(n)]) / expected[:, None]
    both = np.linalg.lstsq(b, load / expected, rcond=None)[0]
    rival = spread(b, load / expected - b @ both, run=np.arange(n) if ordered else run)
    return Trend(
        channel, symbol, reference, p, found, wald > float(stats.f.ppf(0.95, chosen, max(found.dof, 1.0))),
        float(both[1]), math.sqrt(rival.covariance[1, 1]), _aicc(b, load / expected) - least,
        (float(speed.min()), float(speed.max())), ordered,
    )  # fmt: skip


def _columns(unit: Array, x: Array, degree: int, expected: Array) -> Array:
    return np.vander(x, degree + 1, increasing=True) * (unit / expected)[:, None]


def _aicc(a: Array, b: Array) -> float:
    n, k = a.shape[0], a.shape[1] + 1
    rest = b - a @ np.linalg.lstsq(a, b, rcond=None)[0]
    return n * math.log(max(float(rest @ rest), 1e-300)) + 2 * k + 2 * k * (k + 1) / max(n - k - 1, 0.5)
