"""Limit cycles of a sampled loop with saturated actuators, by a describing function."""

from __future__ import annotations

import control
import numpy as np

from mufly.control.linear_systems import Array


def saturated_gain_limit(
    plant: control.StateSpace,
    law: tuple[Array, Array, Array, Array, Array],
    direction: Array,
    *,
    points: int = 1500,
) -> tuple[float, float]:
    """Return the largest gain N below 1 of saturated actuators at which a sampled loop has a limit cycle.

    The actuators saturate together, along ``direction`` d: the command ``u`` becomes ``u + d (v - m)``, where
    ``m = d.u / d.d`` and ``v`` is its saturated value. Everything else is linear: with the anti-windup the controller
    runs as ``x+ = A x + B e + M d (v - m)``, and ``L`` from ``v`` to ``-m`` follows. A saturation passes an oscillation
    of ``m`` with a gain N that falls from 1 to 0 as the amplitude grows (describing function, Khalil, *Nonlinear
    Systems*, Sec. 7.2; a limit cycle has ``N L = -1``). So, within this approximation, a loop that is stable for every
    N in (0, 1] recovers from any state.

    Parameters
    ----------
    plant : control.StateSpace
        Sampled plant (:func:`mufly.control.sample_plant`); the loop is ``u = C x + D e``, ``e = -y``.
    law : tuple of array
        A, B, C, D, M of the controller, B and D with the columns of the errors only.
    direction : array, shape (inputs,)
    points : int
        Number of frequencies, from 0.05 rad/s to the sampling rate's limit.

    Returns
    -------
    share : float
        Largest N below 1 with a limit cycle; 0 if there is none.
    frequency : float
        Frequency of that limit cycle (rad/s); nan if there is none.

    Notes
    -----
    Since ``1 + L = closed(z) / (saturated(z) open(z))``, with the characteristic polynomials of the closed loop, of
    ``A - M d d' C / d.d`` and of the plant, M determines the poles of the saturated loop.
    """
    A, B, C, D, M = law
    d = np.asarray(direction, dtype=float)
    n, k = plant.nstates, A.shape[0]
    u = np.hstack([-D @ plant.C, C])
    m = d @ u / (d @ d)
    loop = np.block([[plant.A, np.zeros((n, k))], [-B @ plant.C, A]])
    loop[:n] += plant.B @ (u - np.outer(d, m))
    loop[n:] -= np.outer(M @ d, m)
    driven = np.concatenate([plant.B @ d, M @ d])
    frequency = np.geomspace(0.05, np.pi / plant.dt, points)
    z = np.exp(1j * frequency * plant.dt)
    states = np.linalg.solve(z[:, None, None] * np.eye(n + k) - loop, driven[:, None])[..., 0]
    L = -states @ m
    share, at = 0.0, np.nan
    for i in np.flatnonzero(np.diff(np.sign(L.imag))):
        part = L[i].imag / (L[i].imag - L[i + 1].imag)
        crossing = L[i].real + part * (L[i + 1].real - L[i].real)
        if crossing < -1.0 and -1.0 / crossing > share:
            share, at = -1.0 / crossing, float(frequency[i])
    return float(share), at
