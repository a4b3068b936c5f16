"""Covariance of a least-squares estimate with correlated errors of neighbouring readings.

The linearised residual is ``r = r0 + J (theta - theta0)``, with rows divided by their expected error. For errors with
covariance ``s^2 V(rho)`` the estimate of ordinary least squares has

    cov = s^2 (J'J)^-1 J' V J (J'J)^-1,      s^2 = r'r / tr(M V),      M = I - J (J'J)^-1 J'

(the divisor makes ``s^2`` unbiased). The data choose between three patterns of V:

* white: V = I, the textbook case;
* a drift along the order of measurement: V_ij = rho^|i - j| between readings of the same channel in the same run;
* one error per setting: V_ij = rho between readings of one group (repeats of a setting share their error).

``rho`` maximises the restricted likelihood (Patterson and Thompson, Biometrika 58, 1971), which accounts for the
fitted parameters. A pattern is accepted only if it raises twice the log-likelihood by more than 2.71, the one-sided
5 % point. Intervals use Student's t with Satterthwaite's degrees of freedom
``tr(MV)^2 / tr(MVMV)`` (Biometrics Bull. 2, 1946).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from mufly.results import result

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_MIN_LIKELIHOOD_GAIN = 2.71
_MIN_PATTERN_DEGREES_OF_FREEDOM = 8  # degrees of freedom below which a pattern is not distinguishable from chance


@result(eq=False)
class CovarianceEstimate:
    """Covariance of least-squares estimates, and how the errors of neighbouring or repeated readings are correlated.

    Attributes
    ----------
    covariance : (p, p) array
        Covariance of the estimates, in products of their units.
    residual_std_ratio : float
        Ratio s of observed to expected residuals; 1 if the expected errors are correct.
    dof : float
        Degrees of freedom of the intervals.
    pattern : str
        ``"white"``, ``"drift"`` or ``"repeats"``.
    rho : float
        Correlation of neighbours or repeats; 0 if white.
    """

    covariance: Array
    residual_std_ratio: float
    dof: float
    pattern: str
    rho: float

    @property
    def t_quantile_95(self) -> float:
        """Ratio of the half width of the 95 % interval to the standard deviation (quantile of Student's t)."""
        return float(stats.t.ppf(0.975, max(self.dof, 1.0)))

    def describe_error_correlation(self) -> str:
        """Return a text on how the errors of the readings are correlated."""
        if self.pattern == "drift":
            return (
                f"neighbouring readings have correlated errors (correlation {self.rho:.2f}); intervals "
                "are widened for it"
            )
        if self.pattern == "repeats":
            return (
                f"readings of one setting have correlated errors (correlation {self.rho:.2f}); intervals "
                "are widened "
                "for it"
            )
        return "residuals scatter without pattern"


def estimate_parameter_covariance(
    jacobian: Array, residual: Array, *, channel: Integers | None = None, run: Integers | None = None,
    group: Integers | None = None, known_scale: bool = False,
) -> CovarianceEstimate:  # fmt: skip
    """Return the covariance of a least-squares estimate.

    Parameters
    ----------
    jacobian : (n, p) array
        Jacobian of the residuals over expected errors, rows in the order of measurement; full rank, n > p.
    residual : (n,) array
        Residuals over expected errors at the estimate.
    channel, run, group : (n,) int arrays, optional
        Channel, run and setting of a row. Rows of different channels or runs have independent errors; rows of one
        channel and setting may share an error. Default: one channel, one run, no repeats.
    known_scale : bool
        Whether expected errors are absolute: the residuals then scale the covariance only if larger than expected.
    """
    n, p = jacobian.shape
    zeros = np.zeros(n, dtype=np.int64)
    channel, run = zeros if channel is None else channel, zeros if run is None else run
    q, _ = np.linalg.qr(jacobian)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    series, repeats = _group_rows(channel, run), _group_rows(channel, zeros if group is None else group)
    patterns: dict[str, list[Integers]] = {}
    if n - p >= _MIN_PATTERN_DEGREES_OF_FREEDOM:
        patterns["drift"] = series
        if group is not None and len(repeats) < n:
            patterns["repeats"] = repeats
    pattern, rho, likelihood = "white", 0.0, _twice_restricted_log_likelihood("drift", 0.0, series, jacobian, residual)
    threshold = likelihood + _MIN_LIKELIHOOD_GAIN
    for name, parts in patterns.items():
        found = minimize_scalar(
            lambda r, name=name, parts=parts: -_twice_restricted_log_likelihood(name, r, parts, jacobian, residual),
            bounds=(0.02, 0.98),
            method="bounded",
            options={"xatol": 5e-3},
        )
        if -found.fun > max(likelihood, threshold):
            pattern, rho, likelihood = name, float(found.x), -float(found.fun)
    v = np.eye(n)
    for part in patterns.get(pattern, []):
        steps = np.abs(np.subtract.outer(np.arange(part.size), np.arange(part.size)))
        v[np.ix_(part, part)] = rho ** (steps if pattern == "drift" else np.minimum(steps, 1))
    mv = v - q @ (q.T @ v)
    trace = float(np.trace(mv))
    dof = trace**2 / float(np.sum(mv * mv.T))
    scale2 = float(residual @ residual) / trace
    used = max(scale2, 1.0) if known_scale else scale2
    middle = jacobian.T @ v @ jacobian
    return CovarianceEstimate(used * inverse @ middle @ inverse, float(np.sqrt(scale2)), dof, pattern, rho)


def _group_rows(first: Integers, second: Integers) -> list[Integers]:
    """Group the rows with equal ``first`` and equal ``second``; return the row indices of each group, ascending."""
    label = np.unique(np.column_stack([first, second]), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _twice_restricted_log_likelihood(
    pattern: str, rho: float, parts: list[Integers], jacobian: Array, residual: Array
) -> float:
    """Return twice the restricted log-likelihood of the correlation pattern "drift" or "repeats", up to a constant.

    Each part is whitened: a drift by differences ``(x_k - rho x_(k-1)) / sqrt(1 - rho^2)``, repeats by scaling their
    mean by ``1 / sqrt(1 + (m - 1) rho)`` and their deviations from the mean by ``1 / sqrt(1 - rho)``.
    """
    rows = np.column_stack([jacobian, residual])
    white, log = np.empty_like(rows), 0.0
    for part in parts:
        x, m = rows[part], part.size
        if pattern == "drift":
            white[part[0]] = x[0]
            white[part[1:]] = (x[1:] - rho * x[:-1]) / np.sqrt(1.0 - rho**2)
            log += (m - 1) * np.log(1.0 - rho**2)
        else:
            mean = x.mean(axis=0)
            white[part] = (x - mean) / np.sqrt(1.0 - rho) + mean / np.sqrt(1.0 + (m - 1) * rho)
            log += (m - 1) * np.log(1.0 - rho) + np.log(1.0 + (m - 1) * rho)
    n, p = jacobian.shape
    q, upper = np.linalg.qr(white[:, :p])
    r = white[:, p] - q @ (q.T @ white[:, p])
    log += 2 * np.sum(np.log(np.abs(np.diag(upper))))
    return float(-log - (n - p) * np.log(max(float(r @ r), 1e-300)))


def join_covariances(*blocks: NDArray[np.floating[Any]]) -> Array:
    """Return the block-diagonal covariance of independent estimates."""
    return np.asarray(block_diag(*blocks), dtype=np.float64)
