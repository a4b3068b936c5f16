"""Exact simulation of a linear model over a sampled record, with what enters linearly kept apart.

Between samples the inputs are joined by straight lines (or held), which a matrix exponential integrates exactly
(Franklin, Powell and Workman, *Digital Control of Dynamic Systems*, Sec. 4.3):

    x_(k+1) = Phi x_k + G_1 u_k + G_2 (u_(k+1) - u_k) / dt

Initial state, trim of the inputs and bias of the outputs enter the prediction linearly; :func:`responses` returns what
one unit of each would add, so that a fit can solve for them exactly instead of searching (variable projection, Golub
and Pereyra 1973).
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from mufly.identify.linear_structure import Structure

__all__ = ["delayed", "discretise", "responses", "simulate_linear"]

Array = NDArray[np.float64]


def discretise(a: Array, b: Array, dt: float, *, hold: bool = False) -> tuple[Array, Array, Array]:
    """Return Phi, G_1, G_2 of one sample; ``G_2`` is zero for held inputs.

    Raises
    ------
    FloatingPointError
        If the model is so unstable that it overflows within a sample.
    """
    n, k = b.shape
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k], block[n : n + k, n + k :] = a, b, np.eye(k)
    e = expm(block * dt)
    if not np.isfinite(e).all():
        raise FloatingPointError("the model overflows within one sample")
    g2 = np.zeros((n, k)) if hold else e[:n, n + k :]
    return e[:n, :n], e[:n, n : n + k], g2


def delayed(u: Array, delay_s: Array, dt: float, *, hold: bool = False) -> Array:
    """Return the inputs (n, k), each ``delay_s`` later; before the record they stand at their first value."""
    if hold:
        shift = np.rint(delay_s / dt).astype(int)
        index = np.maximum(np.arange(len(u))[:, None] - shift[None, :], 0)
        return np.take_along_axis(u, index, axis=0)
    t = dt * np.arange(len(u))
    columns = [np.interp(t - delay_s[j], t, u[:, j]) for j in range(u.shape[1])]
    return np.column_stack(columns)


@nb.njit(cache=True)
def _march(phi: Array, drive: Array, x0: Array) -> Array:  # pragma: no cover (compiled)
    n, nx = drive.shape[0] + 1, phi.shape[0]
    x = np.empty((n, nx))
    x[0] = x0
    for k in range(n - 1):
        for i in range(nx):
            total = drive[k, i]
            for j in range(nx):
                total += phi[i, j] * x[k, j]
            x[k + 1, i] = total
    return x


@nb.njit(cache=True)
def _free_motion(phi: Array, c: Array, first: Array, constant: Array, n: int) -> Array:  # pragma: no cover
    """Outputs (n, ny, m) of m motions that start at ``first`` (nx, m) under constant increments (nx, m)."""
    ny, nx, m = c.shape[0], phi.shape[0], first.shape[1]
    y = np.empty((n, ny, m))
    x, new = first.copy(), np.empty((nx, m))
    for k in range(n):
        for o in range(ny):
            for l in range(m):
                total = 0.0
                for i in range(nx):
                    total += c[o, i] * x[i, l]
                y[k, o, l] = total
        for i in range(nx):
            for l in range(m):
                total = constant[i, l]
                for j in range(nx):
                    total += phi[i, j] * x[j, l]
                new[i, l] = total
        x, new = new, x
    return y


def simulate_linear(
    structure: Structure, values: Array, u: Array, dt: float, *, x0: Array | None = None, hold: bool = False
) -> tuple[Array, Array]:
    """Simulate from inputs alone.

    Parameters
    ----------
    structure : Structure
    values : (p,) array
    u : (n, inputs) array
        Deviations from trim.
    dt : float
        (s).
    x0 : (states,) array, optional
        Default zero.
    hold : bool
        Inputs are held between samples; default straight lines.

    Returns
    -------
    y : (n, outputs) array
    x : (n, states) array
    """
    a, b, c, d, delay = structure.matrices(values)
    phi, g1, g2 = discretise(a, b, dt, hold=hold)
    ud = delayed(u, delay, dt, hold=hold)
    drive = ud[:-1] @ g1.T + np.diff(ud, axis=0) @ g2.T / dt
    x = _march(phi, np.ascontiguousarray(drive), np.zeros(len(a)) if x0 is None else x0)
    return x @ c.T + ud @ d.T, x


def responses(structure: Structure, values: Array, n: int, dt: float) -> Array:
    """Return what one unit of each initial state, input trim and output bias adds to the outputs.

    Returns
    -------
    (n, outputs, states + inputs + outputs) array
    """
    a, b, c, d, _ = structure.matrices(values)
    phi, g1, _ = discretise(a, b, dt)
    nx, nu, ny = len(a), b.shape[1], len(c)
    first = np.hstack([np.eye(nx), np.zeros((nx, nu))])
    constant = np.hstack([np.zeros((nx, nx)), -g1])
    moved = _free_motion(phi, np.ascontiguousarray(c), first, constant, n)
    moved[:, :, nx:] -= d
    return np.concatenate([moved, np.broadcast_to(np.eye(ny), (n, ny, ny))], axis=2)
