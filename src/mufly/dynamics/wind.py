"""Wind: a steady part and Dryden turbulence.

Dryden's spectra (MIL-F-8785C) come from white noise through

    longitudinal  H = sigma sqrt(2 T / pi) / (1 + T s)                        T = L / V
    lateral, vertical  H = sigma sqrt(T / pi) (1 + sqrt(3) T s) / (1 + T s)^2

for turbulence of length scale ``L`` carried past at speed ``V`` (Taylor's hypothesis). The standard's low-altitude
scales are meant for aeroplanes above 10 ft; in a room the eddies are as large as the furniture, so ``L`` is given
(1 m by default) and ``V`` is the steady wind speed, at least 0.5 m/s. The filters are sampled exactly (matrix
exponential and stationary covariance; own derivation), so the variance is ``sigma^2`` at any time step.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cholesky, expm, solve_continuous_lyapunov

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
    T = time_constant_s
    A = np.array([[0.0, 1.0], [-1.0 / T**2, -2.0 / T]])
    B = np.array([[0.0], [1.0]])
    C = np.array([1.0, math.sqrt(3.0) * T]) / T**2
    covariance = solve_continuous_lyapunov(A, -B @ B.T)
    C = C / math.sqrt(C @ covariance @ C)
    transition = expm(A * step_s)
    step_covariance = covariance - transition @ covariance @ transition.T
    return transition, cholesky(step_covariance, lower=True), C, cholesky(covariance, lower=True)


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
        self._u = float(self._random.standard_normal())
        self._vw = self._lateral[3] @ self._random.standard_normal((2, 2))

    def block(self, n: int) -> NDArray[np.float64]:
        """Return the next ``n`` samples of the wind, N-E-D (m/s), shape (n, 3)."""
        if self._gust == 0.0:
            return np.tile(self.steady, (n, 1))
        noise = self._random.standard_normal((n, 5))
        gusts = np.empty((n, 3))
        transition, scale, output, _ = self._lateral
        step = math.sqrt(1.0 - self._decay**2)
        for k in range(n):
            gusts[k, 0] = self._u
            gusts[k, 1:] = output @ self._vw
            self._u = self._decay * self._u + step * noise[k, 0]
            self._vw = transition @ self._vw + scale @ noise[k, 1:].reshape(2, 2)
        return self.steady + self._gust * gusts @ self._axes.T
