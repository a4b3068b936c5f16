"""A covariance that stays one, in single precision too: P = U D U^T, U unit upper triangular, D diagonal.

Only U and D are kept, and no step subtracts a covariance from another, so P cannot lose its symmetry or become
negative by rounding, which a plain Kalman filter in 32 bits does. No square root is taken.

Measurement of one number, z = h x + n, variance r of n (Bierman 1977, Factorization Methods for Discrete Sequential
Estimation, ch. V): with f = U^T h, v = D f, and a_0 = r, for j = 1..n

    a_j = a_(j-1) + f_j v_j         d_j' = d_j a_(j-1) / a_j        U'_ij = U_ij - f_j / a_(j-1) K_i,    K_i += U_ij v_j

starting from K_j = v_j; the gain is K / a_n, and a_n = h P h^T + r.

Step in time. What moves (position, velocity, attitude: the first :data:`MOVING` states) is pushed by biases that carry
on by themselves, so the factors are stepped in two parts (Bierman 1977, ch. VII): the moving states with the biases
held (:func:`carry`), and one bias after the other as x' = keep x + w (:func:`wander`). Rows of biases stay as they are
in the first, so U stays triangular but for the three columns of the velocity, which drag turns into each other: they
are made orthogonal from the last to the first (Thornton 1976, modified weighted Gram-Schmidt). Noise is added as
P + c v v^T, factor by factor (Agee and Turner 1972).

U is held by columns: ``ut[j, i] = U_ij``, so that inner loops run over neighbours; ones on its diagonal and zeros
behind it are there to be read.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled

_Array = NDArray[np.float64]

MOVING = 9
_TINY = 1e-20


@compiled(error_model="numpy")
def expected(ut: _Array, d: _Array, at: NDArray[np.int32], h: _Array, terms: int, f: _Array) -> float:
    """Write f = U^T h and return h P h^T; ``h[t]`` belongs to state ``at[t]``, and there are so many terms."""
    spread = 0.0
    for j in range(d.shape[0]):
        s = 0.0
        for t in range(terms):
            s += h[t] * ut[j, at[t]]
        f[j] = s
        spread += d[j] * s * s
    return spread


@compiled(error_model="numpy")
def observe(ut: _Array, d: _Array, f: _Array, r: float, gain: _Array) -> None:
    """Take a measurement of variance ``r`` in, with ``f`` of :func:`expected`; write its gain."""
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


@compiled(error_model="numpy")
def carry(ut: _Array, d: _Array, span: float, transition: _Array, q: _Array, w: _Array, v: _Array) -> None:
    """Step the moving states in time.

    Parameters
    ----------
    ut, d : (n, n), (n,) arrays
        Replaced.
    span : float
        Of the step (s).
    transition : (33,) array
        Of :func:`mufly.estimate.motion.transition`.
    q : (9,) array
        Variance of the noise of each moving state; that of a velocity also moves its position, by half the span.
    w, v : (3, 6), (n,) arrays
        Work space.
    """
    for k in range(3, MOVING):
        _carry_moving(ut[k], span, transition)
    for k in range(MOVING, d.shape[0]):
        carry_column(ut[k], span, transition, ut[k])
    for k in range(3):
        for i in range(6):
            w[k, i] = ut[3 + k, i]
    for j in range(5, 2, -1):
        total = 0.0
        for k in range(3):
            total += d[3 + k] * w[k, j] * w[k, j]
        size = total if total > _TINY else _TINY
        v[j] = size
        for i in range(j):
            s = 0.0
            for k in range(3):
                s += d[3 + k] * w[k, j] * w[k, i]
            s /= size
            ut[j, i] = s
            for k in range(3):
                w[k, i] -= w[k, j] * s
        ut[j, j] = 1.0
        for i in range(j + 1, 6):
            ut[j, i] = 0.0
    for j in range(3, 6):
        d[j] = v[j]
    for j in range(MOVING):
        for i in range(j):
            v[i] = 0.0
        v[j] = 1.0
        if 3 <= j < 6:
            v[j - 3] = 0.5 * span
        _add(ut, d, j, q[j], v)


@compiled(error_model="numpy")
def carry_column(u: _Array, span: float, a: _Array, out: _Array) -> None:
    """Write the first nine of the errors ``u`` (n,) after a step; ``out`` may be ``u``."""
    g_x, g_y, g_z = u[9], u[10], u[11]
    r_x = a[0] * g_x + a[1] * g_y + a[2] * g_z
    r_y = a[3] * g_x + a[4] * g_y + a[5] * g_z
    r_z = a[6] * g_x + a[7] * g_y + a[8] * g_z
    t_x, t_y, t_z = u[6] - 0.5 * r_x, u[7] - 0.5 * r_y, u[8] - 0.5 * r_z
    b_x, b_y, b_z = u[12], u[13], u[14]
    n, e, o = u[3] - u[20], u[4] - u[21], u[5]
    k = u[22]
    x = a[9] * b_x + a[10] * b_y + a[11] * b_z + a[18] * n + a[19] * e + a[20] * o + a[27] * k
    y = a[12] * b_x + a[13] * b_y + a[14] * b_z + a[21] * n + a[22] * e + a[23] * o + a[28] * k
    z = a[15] * b_x + a[16] * b_y + a[17] * b_z + a[24] * n + a[25] * e + a[26] * o + a[29] * k
    x += a[32] * t_y - a[31] * t_z
    y += a[30] * t_z - a[32] * t_x
    z += a[31] * t_x - a[30] * t_y
    out[0] = u[0] + span * (u[3] + 0.5 * x)
    out[1] = u[1] + span * (u[4] + 0.5 * y)
    out[2] = u[2] + span * (u[5] + 0.5 * z)
    out[3] = u[3] + x
    out[4] = u[4] + y
    out[5] = u[5] + z
    out[6] = u[6] - r_x
    out[7] = u[7] - r_y
    out[8] = u[8] - r_z


@compiled(error_model="numpy")
def _carry_moving(u: _Array, span: float, a: _Array) -> None:
    """As :func:`carry_column`, in place, of a column of what moves: no bias stands in it yet."""
    n, e, o = u[3], u[4], u[5]
    x = a[18] * n + a[19] * e + a[20] * o
    y = a[21] * n + a[22] * e + a[23] * o
    z = a[24] * n + a[25] * e + a[26] * o
    x += a[32] * u[7] - a[31] * u[8]
    y += a[30] * u[8] - a[32] * u[6]
    z += a[31] * u[6] - a[30] * u[7]
    u[0] += span * (n + 0.5 * x)
    u[1] += span * (e + 0.5 * y)
    u[2] += span * (o + 0.5 * z)
    u[3] = n + x
    u[4] = e + y
    u[5] = o + z


@compiled(error_model="numpy")
def wander(ut: _Array, d: _Array, j: int, keep: float, q: float, v: _Array) -> None:
    """Step one bias in time: x' = keep x + w, variance ``q`` of w; ``v`` (n,) is for work."""
    for k in range(j + 1, d.shape[0]):
        ut[k, j] *= keep
    old = d[j]
    new = keep * keep * old + q
    d[j] = new
    by = keep * old / new
    for i in range(j):
        v[i] = ut[j, i]
        ut[j, i] = by * v[i]
    _add(ut, d, j - 1, old * q / new, v)


@compiled(error_model="numpy")
def _add(ut: _Array, d: _Array, last: int, c: float, v: _Array) -> None:
    """P + c v v^T, ``v`` zero behind ``last``; factor by factor from there (Agee and Turner 1972); ``v`` is used up."""
    for k in range(last, -1, -1):
        old = d[k]
        new = old + c * v[k] * v[k]
        if new <= _TINY:
            continue
        b = c * v[k] / new
        for i in range(k):
            v[i] -= v[k] * ut[k, i]
            ut[k, i] += b * v[i]
        c *= old / new
        d[k] = new


@compiled(error_model="numpy")
def loosen(ut: _Array, d: _Array, j: int, variance: float, v: _Array) -> None:
    """Add a variance to state ``j``: something may have happened to it.

    ``v`` (n,) is for work.
    """
    for i in range(j):
        v[i] = 0.0
    v[j] = 1.0
    _add(ut, d, j, variance, v)


@compiled(error_model="numpy")
def variance(ut: _Array, d: _Array, i: int) -> float:
    """Return the variance of a state."""
    s = d[i]
    for k in range(i + 1, d.shape[0]):
        s += d[k] * ut[k, i] * ut[k, i]
    return s


def factorise(covariance: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return ``ut`` and ``d`` of a positive definite covariance (n, n)."""
    p = np.array(covariance, dtype=np.float64)
    n = len(p)
    ut, d = np.eye(n), np.zeros(n)
    for j in range(n - 1, -1, -1):
        d[j] = p[j, j]
        ut[j, :j] = p[:j, j] / d[j]
        p[:j, :j] -= d[j] * np.outer(ut[j, :j], ut[j, :j])
    return ut, d


def assembled(ut: NDArray[np.floating], d: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return P = U D U^T."""
    u = np.eye(len(d)) + np.tril(ut, -1).T
    return (u * d) @ u.T
