"""Propagate and update a covariance in factors: P = U D U^T, U unit upper triangular, D diagonal.

Only U and D are stored, and no step subtracts covariances. Rounding therefore cannot make P unsymmetric or indefinite,
as it can in a plain Kalman filter in single precision. No square root is needed.

Measurement update with a scalar z = h x + n, variance r of n (Bierman 1977, Factorization Methods for Discrete
Sequential Estimation, ch. V): with f = U^T h, v = D f, and a_0 = r, for j = 1..n

    a_j = a_(j-1) + f_j v_j         d_j' = d_j a_(j-1) / a_j        U'_ij = U_ij - f_j / a_(j-1) K_i,    K_i += U_ij v_j

starting from K_j = v_j; the gain is K / a_n, and a_n = h P h^T + r.

Time update. The motion (position, velocity, attitude: the first :data:`MOTION_STATE_COUNT` states) depends on biases
that evolve independently. The update therefore has two parts (Bierman 1977, ch. VII): :func:`ud_time_update` propagates
the motion with constant biases, and :func:`gauss_markov_update` propagates single biases as x' = keep x + w.

The first part does not change the rows of biases. U stays triangular except for the three columns of the velocity,
which drag couples. They are orthogonalised from the last to the first (Thornton 1976, modified weighted Gram-Schmidt).
Noise is added as P + c v v^T, one term at a time (Agee and Turner 1972).

U is stored by columns, ``ut[j, i] = U_ij``, so that inner loops access contiguous memory; the unit diagonal and the
zeros are stored, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.estimate.filter.filter_records import (
    ERROR_ACCEL_BIAS,
    ERROR_ATTITUDE,
    ERROR_GYRO_BIAS,
    ERROR_POSITION,
    ERROR_THRUST_SCALE,
    ERROR_VELOCITY,
    ERROR_WIND,
    TRANSITION_ACCEL,
    TRANSITION_ATTITUDE,
    TRANSITION_GYRO,
    TRANSITION_THRUST,
    TRANSITION_WIND,
)

_Array = NDArray[np.float64]

MOTION_STATE_COUNT = 9
_MIN_UD_DIAGONAL = 1e-20


@cached_njit(error_model="numpy")
def innovation_variance(ut: _Array, d: _Array, at: NDArray[np.int32], h: _Array, terms: int, f: _Array) -> float:
    """Write f = U^T h and return h P h^T; the ``terms`` nonzero elements ``h[t]`` belong to the states ``at[t]``."""
    spread = 0.0
    for j in range(d.shape[0]):
        s = 0.0
        for t in range(terms):
            s += h[t] * ut[j, at[t]]
        f[j] = s
        spread += d[j] * s * s
    return spread


@cached_njit(error_model="numpy")
def ud_measurement_update(ut: _Array, d: _Array, f: _Array, r: float, gain: _Array) -> None:
    """Update U and D by a measurement of variance ``r``, with ``f`` of :func:`innovation_variance`; write its gain."""
    n = d.shape[0]
    a = r
    for j in range(n):
        v = d[j] * f[j]
        before = a
        a = before + f[j] * v
        d[j] *= before / a
        step = -f[j] / before
        gain[j] = v
        for i in range(j):
            u = ut[j, i]
            ut[j, i] = u + step * gain[i]
            gain[i] += u * v
    for j in range(n):
        gain[j] /= a


@cached_njit(error_model="numpy")
def _rank_one_update(ut: _Array, d: _Array, last: int, c: float, v: _Array) -> None:
    """Add c v v^T to P (Agee and Turner 1972); ``v`` is zero after index ``last`` and is overwritten."""
    for k in range(last, -1, -1):
        old = d[k]
        new = old + c * v[k] * v[k]
        if new <= _MIN_UD_DIAGONAL:
            continue
        b = c * v[k] / new
        for i in range(k):
            v[i] -= v[k] * ut[k, i]
            ut[k, i] += b * v[i]
        c *= old / new
        d[k] = new


@cached_njit(error_model="numpy")
def propagate_error_column(u: _Array, span: float, a: _Array, out: _Array) -> None:
    """Propagate the errors of position, velocity and attitude in column ``u`` (n,) by a step; ``out`` may be ``u``."""
    g_x, g_y, g_z = u[ERROR_GYRO_BIAS], u[ERROR_GYRO_BIAS + 1], u[ERROR_GYRO_BIAS + 2]
    r_x = a[TRANSITION_GYRO] * g_x + a[TRANSITION_GYRO + 1] * g_y + a[TRANSITION_GYRO + 2] * g_z
    r_y = a[TRANSITION_GYRO + 3] * g_x + a[TRANSITION_GYRO + 4] * g_y + a[TRANSITION_GYRO + 5] * g_z
    r_z = a[TRANSITION_GYRO + 6] * g_x + a[TRANSITION_GYRO + 7] * g_y + a[TRANSITION_GYRO + 8] * g_z
    t_x, t_y, t_z = u[ERROR_ATTITUDE] - 0.5 * r_x, u[ERROR_ATTITUDE + 1] - 0.5 * r_y, u[ERROR_ATTITUDE + 2] - 0.5 * r_z
    b_x, b_y, b_z = u[ERROR_ACCEL_BIAS], u[ERROR_ACCEL_BIAS + 1], u[ERROR_ACCEL_BIAS + 2]
    n, e, o = u[ERROR_VELOCITY] - u[ERROR_WIND], u[ERROR_VELOCITY + 1] - u[ERROR_WIND + 1], u[ERROR_VELOCITY + 2]
    k = u[ERROR_THRUST_SCALE]
    x = (
        a[TRANSITION_ACCEL] * b_x
        + a[TRANSITION_ACCEL + 1] * b_y
        + a[TRANSITION_ACCEL + 2] * b_z
        + a[TRANSITION_WIND] * n
        + a[TRANSITION_WIND + 1] * e
        + a[TRANSITION_WIND + 2] * o
        + a[TRANSITION_THRUST] * k
    )
    y = (
        a[TRANSITION_ACCEL + 3] * b_x
        + a[TRANSITION_ACCEL + 4] * b_y
        + a[TRANSITION_ACCEL + 5] * b_z
        + a[TRANSITION_WIND + 3] * n
        + a[TRANSITION_WIND + 4] * e
        + a[TRANSITION_WIND + 5] * o
        + a[TRANSITION_THRUST + 1] * k
    )
    z = (
        a[TRANSITION_ACCEL + 6] * b_x
        + a[TRANSITION_ACCEL + 7] * b_y
        + a[TRANSITION_ACCEL + 8] * b_z
        + a[TRANSITION_WIND + 6] * n
        + a[TRANSITION_WIND + 7] * e
        + a[TRANSITION_WIND + 8] * o
        + a[TRANSITION_THRUST + 2] * k
    )
    x += a[TRANSITION_ATTITUDE + 2] * t_y - a[TRANSITION_ATTITUDE + 1] * t_z
    y += a[TRANSITION_ATTITUDE] * t_z - a[TRANSITION_ATTITUDE + 2] * t_x
    z += a[TRANSITION_ATTITUDE + 1] * t_x - a[TRANSITION_ATTITUDE] * t_y
    out[ERROR_POSITION] = u[ERROR_POSITION] + span * (u[ERROR_VELOCITY] + 0.5 * x)
    out[ERROR_POSITION + 1] = u[ERROR_POSITION + 1] + span * (u[ERROR_VELOCITY + 1] + 0.5 * y)
    out[ERROR_POSITION + 2] = u[ERROR_POSITION + 2] + span * (u[ERROR_VELOCITY + 2] + 0.5 * z)
    out[ERROR_VELOCITY] = u[ERROR_VELOCITY] + x
    out[ERROR_VELOCITY + 1] = u[ERROR_VELOCITY + 1] + y
    out[ERROR_VELOCITY + 2] = u[ERROR_VELOCITY + 2] + z
    out[ERROR_ATTITUDE] = u[ERROR_ATTITUDE] - r_x
    out[ERROR_ATTITUDE + 1] = u[ERROR_ATTITUDE + 1] - r_y
    out[ERROR_ATTITUDE + 2] = u[ERROR_ATTITUDE + 2] - r_z


@cached_njit(error_model="numpy")
def _propagate_motion_column(u: _Array, span: float, a: _Array) -> None:
    """Propagate a column in place as :func:`propagate_error_column`, if its biases, wind and thrust scale are zero."""
    n, e, o = u[ERROR_VELOCITY], u[ERROR_VELOCITY + 1], u[ERROR_VELOCITY + 2]
    x = a[TRANSITION_WIND] * n + a[TRANSITION_WIND + 1] * e + a[TRANSITION_WIND + 2] * o
    y = a[TRANSITION_WIND + 3] * n + a[TRANSITION_WIND + 4] * e + a[TRANSITION_WIND + 5] * o
    z = a[TRANSITION_WIND + 6] * n + a[TRANSITION_WIND + 7] * e + a[TRANSITION_WIND + 8] * o
    x += a[TRANSITION_ATTITUDE + 2] * u[ERROR_ATTITUDE + 1] - a[TRANSITION_ATTITUDE + 1] * u[ERROR_ATTITUDE + 2]
    y += a[TRANSITION_ATTITUDE] * u[ERROR_ATTITUDE + 2] - a[TRANSITION_ATTITUDE + 2] * u[ERROR_ATTITUDE]
    z += a[TRANSITION_ATTITUDE + 1] * u[ERROR_ATTITUDE] - a[TRANSITION_ATTITUDE] * u[ERROR_ATTITUDE + 1]
    u[ERROR_POSITION] += span * (n + 0.5 * x)
    u[ERROR_POSITION + 1] += span * (e + 0.5 * y)
    u[ERROR_POSITION + 2] += span * (o + 0.5 * z)
    u[ERROR_VELOCITY] = n + x
    u[ERROR_VELOCITY + 1] = e + y
    u[ERROR_VELOCITY + 2] = o + z


@cached_njit(error_model="numpy")
def ud_time_update(ut: _Array, d: _Array, span: float, transition: _Array, q: _Array, w: _Array, v: _Array) -> None:
    """Propagate the factors U and D of the covariance by a step of the motion (position, velocity, attitude).

    Parameters
    ----------
    ut, d : (n, n), (n,) arrays
        Factors of the covariance, replaced.
    span : float
        Duration of the step (s).
    transition : (33,) array
        Output of :func:`mufly.estimate.filter.strapdown.error_transition`.
    q : (9,) array
        Noise variance of each state of motion; velocity noise also changes the position, by half the span.
    w, v : (3, 6), (n,) arrays
        Work arrays.
    """
    for k in range(ERROR_VELOCITY, MOTION_STATE_COUNT):
        _propagate_motion_column(ut[k], span, transition)
    for k in range(MOTION_STATE_COUNT, d.shape[0]):
        propagate_error_column(ut[k], span, transition, ut[k])
    for k in range(3):
        for i in range(ERROR_ATTITUDE):
            w[k, i] = ut[ERROR_VELOCITY + k, i]
    for j in range(ERROR_ATTITUDE - 1, ERROR_VELOCITY - 1, -1):
        total = 0.0
        for k in range(3):
            total += d[ERROR_VELOCITY + k] * w[k, j] * w[k, j]
        size = total if total > _MIN_UD_DIAGONAL else _MIN_UD_DIAGONAL
        v[j] = size
        for i in range(j):
            s = 0.0
            for k in range(3):
                s += d[ERROR_VELOCITY + k] * w[k, j] * w[k, i]
            s /= size
            ut[j, i] = s
            for k in range(3):
                w[k, i] -= w[k, j] * s
        ut[j, j] = 1.0
        for i in range(j + 1, ERROR_ATTITUDE):
            ut[j, i] = 0.0
    for j in range(ERROR_VELOCITY, ERROR_ATTITUDE):
        d[j] = v[j]
    for j in range(MOTION_STATE_COUNT):
        for i in range(j):
            v[i] = 0.0
        v[j] = 1.0
        if ERROR_VELOCITY <= j < ERROR_ATTITUDE:
            v[j - ERROR_VELOCITY] = 0.5 * span
        _rank_one_update(ut, d, j, q[j], v)


@cached_njit(error_model="numpy")
def gauss_markov_update(ut: _Array, d: _Array, j: int, keep: float, q: float, v: _Array) -> None:
    """Predict one bias, x' = keep x + w, with variance ``q`` of w; ``v`` (n,) is work space."""
    for k in range(j + 1, d.shape[0]):
        ut[k, j] *= keep
    old = d[j]
    new = keep * keep * old + q
    d[j] = new
    by = keep * old / new
    for i in range(j):
        v[i] = ut[j, i]
        ut[j, i] = by * v[i]
    _rank_one_update(ut, d, j - 1, old * q / new, v)


@cached_njit(error_model="numpy")
def inflate_variance(ut: _Array, d: _Array, j: int, variance: float, v: _Array) -> None:
    """Add a variance to state ``j``; ``v`` (n,) is work space."""
    for i in range(j):
        v[i] = 0.0
    v[j] = 1.0
    _rank_one_update(ut, d, j, variance, v)


@cached_njit(error_model="numpy")
def state_variance(ut: _Array, d: _Array, i: int) -> float:
    """Return the variance of error state ``i`` from the factors U and D."""
    s = d[i]
    for k in range(i + 1, d.shape[0]):
        s += d[k] * ut[k, i] * ut[k, i]
    return s
