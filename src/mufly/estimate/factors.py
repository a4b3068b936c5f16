"""A covariance that stays one, in single precision too: P = U D U^T, U unit upper triangular, D diagonal.

Only U and D are kept, and no step subtracts a covariance from another, so P cannot lose its symmetry or become
negative by rounding, which a plain Kalman filter in 32 bits does. No square root is taken.

Measurement of one number, z = h x + n, variance r of n (Bierman 1977, Factorization Methods for Discrete Sequential
Estimation, ch. V): with f = U^T h, v = D f, and a_0 = r, for j = 1..n

    a_j = a_(j-1) + f_j v_j         d_j' = d_j a_(j-1) / a_j        U'_ij = U_ij - f_j / a_(j-1) K_i,    K_i += U_ij v_j

starting from K_j = v_j; the gain is K / a_n, and a_n = h P h^T + r.

Step in time, x' = F x + G w, variances q of w (Thornton 1976; the modified weighted Gram-Schmidt procedure): the
rows of
W = [F U, G] are made orthogonal with the weights [D, q] from the last to the first. ``F`` differs from a diagonal in
its first rows only (:data:`MOVING`, what moves: position, velocity, attitude); every bias carries on by itself and has
one noise of its own. Rows of biases are zero left of their diagonal, which halves the work.

U is held by columns: ``ut[j, i] = U_ij``, i < j, so that inner loops run over neighbours.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled

MOVING = 9
_TINY = 1e-20


@compiled(error_model="numpy")
def expected(ut, d, h, f):  # type: ignore[no-untyped-def]
    """Write f = U^T h and return h P h^T."""
    n = d.shape[0]
    spread = 0.0
    for j in range(n):
        s = h[j]
        for i in range(j):
            s += ut[j, i] * h[i]
        f[j] = s
        spread += d[j] * s * s
    return spread


@compiled(error_model="numpy")
def observe(ut, d, f, r, gain):  # type: ignore[no-untyped-def]
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
def carry(ut, d, top, decay, q, middle, w, weight, row):  # type: ignore[no-untyped-def]
    """Step in time.

    Parameters
    ----------
    ut, d : (n, n), (n,) arrays
        Replaced.
    top : (9, n) array
        First rows of F.
    decay : (n,) array
        Diagonal of F for the others.
    q : (n,) array
        Variance of the noise of each state over the step.
    middle : float
        The noise of a velocity also moves its position, by this times itself (s).
    w, weight, row : (2 n, n), (2 n,), (n,) arrays
        Work space.
    """
    n = d.shape[0]
    for k in range(n):
        for i in range(MOVING):
            s = top[i, k]
            for m in range(k):
                s += top[i, m] * ut[k, m]
            w[k, i] = s
            w[n + k, i] = 0.0
        for i in range(MOVING, n):
            w[k, i] = decay[i] * ut[k, i] if i < k else 0.0
            w[n + k, i] = 0.0
        if k >= MOVING:
            w[k, k] = decay[k]
        w[n + k, k] = 1.0
        if 3 <= k < 6:
            w[n + k, k - 3] = middle
        weight[k] = d[k]
        weight[n + k] = q[k]
    for j in range(n - 1, -1, -1):
        low = j if j >= MOVING else 0
        total = 0.0 * d[j]
        for i in range(j):
            row[i] = 0.0
        for half in range(2):
            for k in range(half * n + low, (half + 1) * n):
                c = weight[k] * w[k, j]
                if c != 0.0:
                    total += c * w[k, j]
                    for i in range(j):
                        row[i] += c * w[k, i]
        d[j] = total if total > _TINY else _TINY
        for i in range(j):
            row[i] /= d[j]
            ut[j, i] = row[i]
        for half in range(2):
            for k in range(half * n + low, (half + 1) * n):
                c = w[k, j]
                if c != 0.0:
                    for i in range(j):
                        w[k, i] -= c * row[i]


@compiled(error_model="numpy")
def _add(ut, d, last, c, v):  # type: ignore[no-untyped-def]
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
def loosen(ut, d, j, variance, v):  # type: ignore[no-untyped-def]
    """Add a variance to state ``j``: something may have happened to it.

    ``v`` (n,) is for work.
    """
    for i in range(j):
        v[i] = 0.0
    v[j] = 1.0
    _add(ut, d, j, variance, v)


@compiled(error_model="numpy")
def forget(ut, d, j, variance, v):  # type: ignore[no-untyped-def]
    """Make state ``j`` what it is by itself, of this variance, as if nothing had been learnt about it.

    Row ``j`` of U is cut off and what it carried goes, so that no other state changes.
    """
    n = d.shape[0]
    # Column j feeds the states before it: their variance stays if what it gave them is given back one by one.
    kept = d[j]
    for i in range(n):
        v[i] = 0.0
    for i in range(j):
        v[i] = ut[j, i]
        ut[j, i] = 0.0
    for k in range(j + 1, n):
        ut[k, j] = 0.0
    d[j] = variance
    _add(ut, d, j - 1, kept, v)


@compiled(error_model="numpy")
def sigmas(ut, d, out):  # type: ignore[no-untyped-def]
    """Write the standard deviation of every state."""
    n = d.shape[0]
    for i in range(n):
        s = d[i]
        for k in range(i + 1, n):
            s += d[k] * ut[k, i] * ut[k, i]
        out[i] = math.sqrt(s)


@compiled(error_model="numpy")
def block(ut, d, size, out):  # type: ignore[no-untyped-def]
    """Write the covariance of the first ``size`` states."""
    n = d.shape[0]
    for i in range(size):
        for j in range(i, size):
            s = d[j] * (ut[j, i] if i < j else 1.0)
            for k in range(j + 1, n):
                s += d[k] * ut[k, i] * ut[k, j]
            out[i, j] = s
            out[j, i] = s


def factorise(covariance: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return ``ut`` and ``d`` of a positive definite covariance (n, n)."""
    p = np.array(covariance, dtype=np.float64)
    n = len(p)
    ut, d = np.zeros((n, n)), np.zeros(n)
    for j in range(n - 1, -1, -1):
        d[j] = p[j, j]
        ut[j, :j] = p[:j, j] / d[j]
        p[:j, :j] -= d[j] * np.outer(ut[j, :j], ut[j, :j])
    return ut, d


def assembled(ut: NDArray[np.floating], d: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return P = U D U^T."""
    u = np.eye(len(d)) + np.tril(ut, -1).T
    return (u * d) @ u.T
