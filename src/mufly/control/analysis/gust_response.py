"""Tilt and servo speed in Dryden gusts, from the stationary covariance of the whole lateral loop.

The linear model depends on the velocity relative to the air. A gust therefore enters through the negative velocity
columns of A, in all rows except those of the position. North and east have the lateral spectrum of
``dynamics.DrydenWind`` with :data:`GUST_m_s`, :data:`GUST_LENGTH_m` and a convection speed of 0.5 m/s. Roll-pitch is
sampled, with whole periods of delay. The velocity controller is sampled at the same rate instead of a quarter of it,
which changes the tilt by 0.8 % (mufly-1.1). The covariance X of the whole loop solves ``X = A X A' + B B'``.
"""

from __future__ import annotations

from itertools import pairwise

import control
import numpy as np
from scipy import linalg

from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import FlightController
from mufly.control.implementation import LATERAL_STATES
from mufly.control.linear_systems import Array, sample_plant, state_space
from mufly.dynamics import Linearisation, dryden_filter
from mufly.results import result

GUST_m_s, GUST_LENGTH_m = 0.5, 1.0
"""Deviation and length scale of the gusts."""


@result
class GustResponse:
    """Standard deviations of tilt and swash plate in gusts while the position is held; ``inf`` for an unstable loop.

    Attributes
    ----------
    tilt_std_rad : float
        Standard deviation of roll or pitch, whichever is larger.
    swash_plate_rate_std_rad_s : float
        Standard deviation of the swash plate's speed about its faster axis: change of tilt in a period, divided by
        the period.
    """

    tilt_std_rad: float
    swash_plate_rate_std_rad_s: float


def compute_gust_tilt_std(linear: Linearisation, controller: FlightController) -> float:
    """Return the larger of the standard deviations of roll and pitch (rad) in gusts.

    The loop has one period of delay and no sensor noise.
    """
    c = controller
    found = compute_lateral_gust_response(linear, c.roll_pitch, c.velocity, c.settings.position_gain)
    return found.tilt_std_rad


def compute_lateral_gust_response(
    linear: Linearisation,
    roll_pitch: ControllerDesign,
    velocity: ControllerDesign,
    position_gain: float,
    *,
    delay_samples: int = 1,
    noise: Array | None = None,
) -> GustResponse:
    """Return the standard deviations of tilt and servo motion of the lateral loop in gusts and sensor noise.

    Parameters
    ----------
    linear : Linearisation
    roll_pitch, velocity : ControllerDesign
    position_gain : float
        Gain of the position loop (1/s).
    delay_samples : int
        Periods between a measurement and its command at the servos; at least 1.
    noise : array, shape (4,), optional
        Deviation of phi, theta (rad), p, q (rad/s) from sample to sample; none by default.
    """
    T, full, design = roll_pitch.discrete.period_s, linear.full, roll_pitch
    names, inputs = list(full.state_labels), list(full.input_labels)
    kept = [names.index(name) for name in LATERAL_STATES]
    gusts = -full.A[np.ix_(kept, [names.index("u"), names.index("v")])]
    gusts[[LATERAL_STATES.index("x"), LATERAL_STATES.index("y")]] = 0.0
    B = np.hstack([full.B[np.ix_(kept, [inputs.index(name) for name in design.plant.input_labels])], gusts])
    plant = state_space(
        full.A[np.ix_(kept, kept)], B, np.eye(len(kept)), np.zeros(B.shape),
        inputs=[*design.plant.input_labels, "gust_u", "gust_v"], outputs=LATERAL_STATES,
    )  # fmt: skip
    held, K = sample_plant(plant, T), design.discrete.to_state_space()
    V = control.sample_system(velocity.reduced, T, method="bilinear")
    F, scale, output, _ = dryden_filter(GUST_LENGTH_m / 0.5, T)
    # Rows that make errors of the velocity controller and of roll-pitch from the state, and from tilt references.
    mix = np.zeros((2, len(kept)))
    for i, (place, speed) in enumerate((("x", "u"), ("y", "v"))):
        mix[i, LATERAL_STATES.index(place)] = -position_gain
        mix[i, LATERAL_STATES.index(speed)] = -1.0
    measured = np.zeros((4, len(kept)))
    measured[range(4), [LATERAL_STATES.index(name) for name in design.plant.output_labels]] = -1.0
    tilt = np.eye(4, 2)
    n, m, c, k = len(kept), 2 * delay_samples, K.nstates, V.nstates
    ends = np.cumsum([0, n, m, c, k, 4])
    x, _, q, v, g = (slice(int(i), int(j)) for i, j in pairwise(ends))
    newest = slice(n + m - 2, n + m)
    gust_inputs, noise_inputs = 4, 4
    A, shocks = np.zeros((ends[-1], ends[-1])), np.zeros((ends[-1], gust_inputs + noise_inputs))
    error = np.zeros((4, ends[-1]))
    error[:, x], error[:, v] = measured + tilt @ V.D @ mix, tilt @ V.C
    A[x, x], A[x, n : n + 2] = held.A, held.B[:, :2]  # the oldest input of the queue acts
    A[x, g] = held.B[:, 2:] @ np.kron(np.eye(2), GUST_m_s * np.asarray(output)[None])
    A[n : n + m - 2, n + 2 : n + m] = np.eye(m - 2)
    A[newest], A[q] = K.D @ error, K.B @ error
    A[newest, q] += K.C
    A[q, q] += K.A
    A[v, v], A[v, x] = V.A, V.B @ mix
    A[g, g], shocks[g, :gust_inputs] = np.kron(np.eye(2), F), np.kron(np.eye(2), scale)
    if noise is not None:
        shocks[newest, gust_inputs:], shocks[q, gust_inputs:] = K.D * noise, K.B * noise
    if np.abs(np.linalg.eigvals(A)).max() >= 1.0:
        return GustResponse(float("inf"), float("inf"))
    X = linalg.solve_discrete_lyapunov(A, shocks @ shocks.T)
    tilts, plates = ([LATERAL_STATES.index(name) for name in pair] for pair in (("phi", "theta"), ("a_dw", "b_dw")))
    steps = A[plates] - np.eye(len(A))[plates]
    moved = np.einsum("ij,jk,ik->i", steps, X, steps)
    return GustResponse(float(np.sqrt(max(X[i, i] for i in tilts))), float(np.sqrt(moved.max()) / T))
