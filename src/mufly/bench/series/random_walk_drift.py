"""Linear model with random-walk drift and independent reading errors, for drifting zeros and gains.

    y_i = x_i' beta + W(t_i) + e_i,     cov W(s), W(t) = q (min(s, t) - t_0),     var e_i = kappa u_i^2

beta (p,) is unknown without prior, q >= 0 is the variance rate of the walk, u_i the stated uncertainty of a reading,
and kappa >= 1 the inflation of its variance. With V = q K + kappa U the restricted likelihood of (q, kappa) is

    -2 ln L = ln |V| + ln |X' V^-1 X| + r' V^-1 r,      r = y - X beta_hat      (Patterson and Thompson 1971)

and, given both, the prediction of ``x*' beta + W(t*)`` is that of kriging with a fitted mean (Rasmussen and Williams,
Gaussian Processes for Machine Learning, 2006, sec. 2.7):

    m* = x*' b + k*' V^-1 r,     C* = K** - k*' V^-1 k* + g (X' V^-1 X)^-1 g',    g = x* - X' V^-1 k*

A few zeros do not determine q. Their best values of q and kappa would understate the uncertainty, so the prediction is
the mean and covariance of a mixture over a grid, weighted by likelihood and prior. The prior of kappa is 1 / kappa. The
prior of the drift over the span, ``d = sqrt(q span)``, is uniform in ln d below the scatter s of the readings and
falls as ``1 / (1 + d^2 / s^2)`` beyond. Between two exact readings with one q this is the Brownian bridge: linear
interpolation with variance ``q (t - t1)(t2 - t) / (t2 - t1)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]

_DRIFT_GRID_POINT_COUNT = 14  # number of grid values of the drift
_VARIANCE_INFLATION_GRID = (1.0, 2.0, 4.0, 8.0, 16.0, 64.0)


@dataclass(frozen=True, eq=False)
class RandomWalkDrift:
    """Linear model with random-walk drift, fitted to readings.

    Attributes
    ----------
    time_s, reading, reading_std : (n,) arrays
        Fitted readings with time and standard uncertainty.
    design_matrix : (n, p) array
        Rows x_i of the linear model.
    start_time : float
        Time t_0 at which the drift is zero.
    hyperparameter_weights : (g,) array
        Posterior weights of the nodes.
    hyperparameter_nodes : (g, 2) array
        q (squared unit of the reading per second) and kappa.
    """

    time_s: Array
    reading: Array
    reading_std: Array
    design_matrix: Array
    start_time: float
    hyperparameter_weights: Array
    hyperparameter_nodes: Array

    def _solve_at_grid_node(self, q: float, kappa: float) -> tuple[Array, Array, Array, Array, Array]:
        v = q * self._walk_covariance(self.time_s, self.time_s) + np.diag(kappa * self.reading_std**2)
        factor = cho_factor(v, lower=True)
        vx = cho_solve(factor, self.design_matrix)
        a: Array = np.linalg.inv(self.design_matrix.T @ vx).astype(np.float64)
        b = a @ (vx.T @ self.reading)
        return (
            b,
            a,
            cho_solve(factor, self.reading - self.design_matrix @ b),
            cho_solve(factor, np.eye(v.shape[0])),
            vx,
        )

    def _walk_covariance(self, s: Array, t: Array) -> Array:
        return np.maximum(np.minimum.outer(s, t) - self.start_time, 0.0)

    def predict_model_and_drift(self, time: Array, design: Array) -> tuple[Array, Array]:
        """Predict model plus drift at times (m,) with design rows (m, p); return mean (m,) and covariance (m, m)."""
        means, parts = [], []
        for (q, kappa), w in zip(self.hyperparameter_nodes, self.hyperparameter_weights, strict=True):
            if w < 1e-4:
                continue
            b, a, vr, vi, vx = self._solve_at_grid_node(float(q), float(kappa))
            k = q * self._walk_covariance(time, self.time_s)
            g = design - k @ vx
            means.append((w, design @ b + k @ vr))
            parts.append(w * (q * self._walk_covariance(time, time) - k @ vi @ k.T + g @ a @ g.T))
        total = sum(w for w, _ in means)
        mean = np.sum([w * m for w, m in means], axis=0) / total
        cov = np.sum(parts, axis=0) / total
        for w, m in means:
            cov += w / total * np.outer(m - mean, m - mean)
        return mean, 0.5 * (cov + cov.T)

    def predict_drift(self, time: Array) -> tuple[Array, Array]:
        """Return mean (m,) and covariance (m, m) of the drift since ``start_time``, without the linear model."""
        return self.predict_model_and_drift(time, np.zeros((time.size, self.design_matrix.shape[1])))

    def estimate_coefficients(self) -> tuple[Array, Array]:
        """Return the coefficients beta (p,) of the linear model and their covariance (p, p)."""
        p = self.design_matrix.shape[1]
        return self.predict_model_and_drift(np.full(p, self.start_time), np.eye(p))

    @property
    def mean_variance_inflation(self) -> float:
        """Return the mean of kappa, the ratio of the readings' variance to their stated variance."""
        return float(self.hyperparameter_weights @ self.hyperparameter_nodes[:, 1])


def fit_random_walk(
    time: Array, reading: Array, std: Array, design: Array | None = None, start: float | None = None
) -> RandomWalkDrift:
    """Fit a linear model with random-walk drift.

    Parameters
    ----------
    time : (n,) array
        Time of the readings (s).
    reading, std : (n,) arrays
        Readings and their standard uncertainties, in any one unit.
    design : (n, p) array, optional
        Rows x_i of full rank; default a constant.
    start : float, optional
        Time at which the drift is zero (s); by default the time of the first reading.

    Raises
    ------
    ValueError
        If there are fewer readings than coefficients, or a number is not finite.
    """
    x = np.ones((time.size, 1)) if design is None else design
    if time.size < x.shape[1] or not (np.all(np.isfinite(reading)) and np.all(np.isfinite(std))):
        raise ValueError("too few readings, or readings that are not numbers")
    at = float(time.min()) if start is None else start
    floor = 1e-9 * max(float(np.abs(reading).max()), 1e-12)
    u = np.maximum(std, floor)
    blank = RandomWalkDrift(time, reading, u, x, at, np.ones(1), np.zeros((1, 2)))
    n, p = x.shape
    span = max(float(np.ptp(time)), float(time.max()) - at, 1e-9)
    rest = reading - x @ np.linalg.lstsq(x / u[:, None], reading / u, rcond=None)[0]
    typical = max(float(np.sqrt(np.mean(rest**2))), 0.3 * float(np.median(u)))
    walks = np.concatenate(
        ([0.0], np.geomspace(0.05, 8.0, _DRIFT_GRID_POINT_COUNT) * typical)
    )  # standard deviation over the span
    speeds = walks**2 / span
    nodes = np.array([(q, k) for q in speeds for k in _VARIANCE_INFLATION_GRID])
    if n == p:  # no degrees of freedom: only the prior applies
        nodes = np.array([(0.0, 1.0)])
    log = np.empty(len(nodes))
    kernel = blank._walk_covariance(time, time)
    for i, (q, kappa) in enumerate(nodes):
        factor = np.linalg.cholesky(q * kernel + np.diag(kappa * u**2))
        white = np.linalg.solve(factor, np.column_stack([x, reading]))
        orthogonal, upper = np.linalg.qr(white[:, :p])
        r = white[:, p] - orthogonal @ (orthogonal.T @ white[:, p])
        log[i] = -np.sum(np.log(np.diag(factor))) - np.sum(np.log(np.abs(np.diag(upper)))) - 0.5 * float(r @ r)
        log[i] -= np.log(kappa) + np.log1p(q * span / typical**2)
    weights = np.exp(log - log.max())
    return RandomWalkDrift(time, reading, u, x, at, weights / weights.sum(), nodes)
