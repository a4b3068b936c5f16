"""Margins beyond the classical ones: the disk margin of several inputs at once, and the noise that reaches the inputs.

Disk margin. Every input is multiplied by its own complex factor ``(1 + d/2) / (1 - d/2)``, ``|d| < a``; the margin is
the largest ``a`` for which the loop stays stable. The loop closed by the ``d`` has the response ``M = S_u - I/2``, so
the margin is the inverse of the structured singular value of M for scalar complex blocks. A margin ``a`` permits gains
between ``(2 - a) / (2 + a)`` and its inverse, or phases of ``2 atan(a / 2)``, in all inputs at once (Seiler, Packard
and Gahinet, IEEE Control Syst. Mag. 40, 2020).

For two blocks the structured singular value is the least largest singular value of ``diag(d, 1) M diag(1/d, 1)`` over d
(Doyle 1982). The scaling leaves ``|det M|``, the product of the two singular values. So the largest one falls with the
Frobenius norm, which is least at ``d^2 = |m21 / m12|``: a closed form.
"""

from __future__ import annotations

import control
import numpy as np
from scipy import linalg

from mufly.control.linear_systems import Array, ComplexArray, frequency_response, is_stable_loop
from mufly.errors import MuflyError
from mufly.results import result


@result
class DiskMargin:
    """Disk margin: the largest simultaneous change of gain and phase in all inputs at which the loop stays stable.

    Attributes
    ----------
    margin : float
        Radius ``a``; 0 for an unstable loop.
    gain_dB, phase_deg : float
        Largest change of gain alone (up and down), and of phase alone, within the disk; ``inf`` dB from a radius of
        2 on.
    frequency : float
        Frequency of the least margin (rad/s).
    """

    margin: float
    gain_dB: float
    phase_deg: float
    frequency: float


def scalar_block_mu(M: ComplexArray) -> Array:
    """Return the structured singular value of matrices (..., k, k) for k scalar complex blocks, k of 1 or 2."""
    if M.shape[-1] == 1:
        return np.abs(M[..., 0, 0])
    if M.shape[-1] != 2:
        raise MuflyError(f"disk margin: the loop has {M.shape[-1]} inputs; give a loop with one or two")
    a, b, c, d = (M[..., i, j] for i in (0, 1) for j in (0, 1))
    size = np.abs(a) ** 2 + np.abs(d) ** 2 + 2.0 * np.abs(b * c)
    spread = np.maximum(size**2 - 4.0 * np.abs(a * d - b * c) ** 2, 0.0)
    value: Array = np.sqrt(0.5 * (size + np.sqrt(spread)))
    return value


def disk_margin(plant: control.StateSpace, feedback: control.StateSpace, *, points: int = 600) -> DiskMargin:
    """Return the disk margin at the inputs of the loop ``u = -feedback y``, with an independent disturbance at each
    input.

    Parameters
    ----------
    plant, feedback : control.StateSpace
        Both continuous, or both discrete with the same period.
    points : int
        Frequencies of the grid from 1e-2 rad/s to 1e4 rad/s or the Nyquist frequency; the peak is refined.

    Returns
    -------
    DiskMargin

    Raises
    ------
    MuflyError
        If the plant has more than two inputs.
    """
    if not is_stable_loop(plant, feedback):
        return DiskMargin(0.0, 0.0, 0.0, float("nan"))
    half, eye = 0.5 * np.eye(plant.ninputs), np.eye(plant.ninputs)

    def mu_at_frequency(w: Array) -> Array:
        loop = frequency_response(feedback, w) @ frequency_response(plant, w)
        return scalar_block_mu(np.linalg.inv(eye + loop) - half)

    frequency = np.geomspace(1e-2, 0.999 * np.pi / plant.dt if plant.dt else 1e4, points)
    for _ in range(3):
        size = mu_at_frequency(frequency)
        i = int(np.argmax(size))
        worst, where = float(size[i]), float(frequency[i])
        frequency = np.geomspace(frequency[max(i - 1, 0)], frequency[min(i + 1, frequency.size - 1)], 25)
    a = 1.0 / worst
    gain = 20 * np.log10((2 + a) / (2 - a)) if a < 2.0 else np.inf
    return DiskMargin(a, float(gain), float(2 * np.degrees(np.arctan(a / 2))), where)


def compute_input_noise_std(plant: control.StateSpace, feedback: control.StateSpace, noise: Array) -> Array:
    """Return the standard deviation of each input due to measurement noise in a sampled loop.

    Parameters
    ----------
    plant, feedback : control.StateSpace
        Discrete, with the same period; the plant without feedthrough.
    noise : array, shape (outputs,)
        Standard deviation of each measurement, white from sample to sample.

    Returns
    -------
    array, shape (inputs,)
        In the units of the inputs; ``inf`` for an unstable loop.
    """
    G, K = plant, feedback
    if not is_stable_loop(G, K):
        return np.full(G.ninputs, np.inf)
    A = np.block([[G.A - G.B @ K.D @ G.C, G.B @ K.C], [-K.B @ G.C, K.A]])
    B = np.vstack([-G.B @ K.D, -K.B]) * noise
    C, D = np.hstack([-K.D @ G.C, K.C]), -K.D * noise
    X = linalg.solve_discrete_lyapunov(A, B @ B.T)
    return np.sqrt(np.diag(C @ X @ C.T + D @ D.T))
