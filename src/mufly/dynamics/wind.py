"""Wind: a steady part and Dryden turbulence.

Dryden's spectra (MIL-F-8785C) come from white noise through

    longitudinal  H = sigma sqrt(2 T / pi) / (1 + T s)                        T = L / V
    lateral, vertical  H = sigma sqrt(T / pi) (1 + sqrt(3) T s) / (1 + T s)^2

for turbulence of length scale ``L`` carried past at speed ``V`` (Taylor's hypothesis). The standard's low-altitude
scales are meant for aeroplanes above 10 ft; in a room the eddies are as large as the furniture, so ``L`` is given
(1 m by default) and ``V`` is the steady wind speed, at least 0.5 m/s.

The filters are sampled exactly, so the variance is ``sigma^2`` at any time step (own derivation). In the time unit
``T`` the lateral filter for unit variance is

    d/dt (s1, s2) = (s2, -s1 - 2 s2 + 2 n)      gust = (s1 + sqrt(3) s2) / 2      covariance of (s1, s2): identity

and over a step ``h`` the state moves by ``F = exp(-h) [[1 + h, h], [-h, 1 - h]]`` and gains noise of covariance
``Q = I - F F^T``, written below without the cancellation that spoils it for small ``h``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter
from scipy.special import gammainc

from mufly.errors import InputError

__all__ = ["DrydenWind", "dryden_filter"]

_LEAST_SPEED = 0.5  # m/s


def dryden_filter(time_constant_s: float, step_s: float) -> tuple[NDArray[np.float64], ...]:
    """Return the exactly sampled lateral Dryden filter for unit variance.

    Returns
    -------
    transition : (2, 2) array
    noise : (2, 2) array
        Lower triangular: ``x[k+1] = transition x[k] + noise n[k]`` with unit white ``n``.
    output : (2,) array
    start : (2, 2) array
        ``x[0] = start n`` makes the process stationary from the first sample.
    """
    h = step_s / time_constant_s
    decay = math.exp(-h)
    transition = decay * np.array([[1.0 + h, h], [-h, 1.0 - h]])
    q11 = float(gammainc(3, 2 * h))  # 1 - exp(-2h) (1 + 2h + 2h^2)
    q12 = 2 * h * h * decay**2
    q22 = -math.expm1(-2 * h) + 2 * h * (1 - h) * decay**2
    l11 = math.sqrt(q11)
    l21 = q12 / l11
    noise = np.array([[l11, 0.0], [l21, math.sqrt(q22 - l21 * l21)]])
    return transition, noise, np.array([0.5, math.sqrt(0.75)]), np.eye(2)


class DrydenWind:
    """A wind that a simulation can ask for, step after step.

    Parameters
    ----------
    steady : (3,) array_like
        Mean wind, N-E-D (m/s).
    gust : float
        Standard deviation of each gust component (m/s); 0 for none.
    step_s : float
        Time between samples (s).
    length_m : float
        Length scale of the turbulence (m).
    seed : int
        Seed of the random numbers.

    Raises
    ------
    InputError
        If a number is negative or not finite.
    """

    def __init__(
        self,
        steady: ArrayLike = (0.0, 0.0, 0.0),
        gust: float = 0.0,
        *,
        step_s: float,
        length_m: float = 1.0,
        seed: int = 0,
    ) -> None:
        self.steady = np.asarray(steady, dtype=np.float64)
        if self.steady.shape != (3,) or not np.all(np.isfinite(self.steady)):
            raise InputError("wind", "steady", f"{steady!r}", "give three finite numbers N, E, D in m/s")
        for name, value in (("gust", gust), ("length_m", length_m), ("step_s", step_s)):
            if not math.isfinite(value) or value < 0 or (value == 0 and name != "gust"):
                raise InputError("wind", name, f"{value}", "give a finite number that is not negative")
        if seed < 0:
            raise InputError("wind", "seed", f"{seed}", "give a whole number that is not negative")
        self._gust = gust
        self._random = np.random.default_rng(seed)
        speed = max(float(np.linalg.norm(self.steady)), _LEAST_SPEED)
        T = length_m / speed
        self._decay = math.exp(-step_s / T)
        self._lateral = dryden_filter(T, step_s)
        # Axes of the turbulence: along the mean wind (horizontal), across it, down.
        along = self.steady * [1.0, 1.0, 0.0]
        along = along / np.linalg.norm(along) if np.linalg.norm(along) > 0 else np.array([1.0, 0.0, 0.0])
        self._axes = np.column_stack([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
        self._along, self._s1 = self._random.standard_normal(1), self._random.standard_normal(2)
        self._both = self._s1 + self._random.standard_normal(2)

    def block(self, n: int) -> NDArray[np.float64]:
        """Return the next ``n`` samples of the wind, N-E-D (m/s), shape (n, 3)."""
        if self._gust == 0.0:
            return np.tile(self.steady, (n, 1))
        noise = self._random.standard_normal((n, 5))
        transition, scale, output, _ = self._lateral
        along = self._chain(self._along, math.sqrt(1.0 - self._decay**2) * noise[:, 0:1])
        # s1 + s2 decays like exp(-h) by itself and drives s1, so two first-order recursions do.
        n1, n2 = noise[:, 1:3], noise[:, 3:5]
        first, second = scale[0, 0] * n1, scale[1, 0] * n1 + scale[1, 1] * n2
        both = self._chain(self._both, first + second)
        s1 = self._chain(self._s1, transition[0, 1] * both[:n] + first)
        self._along, self._both, self._s1 = along[n], both[n], s1[n]
        across = output[0] * s1 + output[1] * (both - s1)
        a, b, c = self._gust * along[:n], self._gust * across[:n, :1], self._gust * across[:n, 1:]
        return self.steady + a * self._axes[:, 0] + b * self._axes[:, 1] + c * self._axes[:, 2]

    def _chain(self, start: NDArray[np.float64], driven: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the n + 1 values of ``y[k+1] = decay y[k] + driven[k]`` from ``y[0] = start``, by columns."""
        rest, _ = lfilter([1.0], [1.0, -self._decay], driven, axis=0, zi=self._decay * start[None])
        return np.vstack([start, rest])
