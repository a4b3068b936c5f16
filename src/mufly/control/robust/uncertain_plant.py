"""The generalised plant of a vehicle with its uncertainty, for synthesis by D-K iteration.

With the parameters' derivatives ``E_i = L_i R_i`` the plant is

    xdot = A x + B u + L d,   q = R [x; u],   d = Delta q,

where the scalars in Delta count as complex and independent, so that mu covers more than the parameters. Each plant
input has an uncertainty of its own besides, ``u = (1 + W_I Delta_I) u0``, for what the linear model leaves out of
servos, rotors and sampling: ``W_I = g (s + w) / (g s / 4 + w)`` grows from g at low frequency to 4 at high frequency.
The performance is that of the generalised plant, as one full block.
"""

from __future__ import annotations

from collections.abc import Sequence

import control
import numpy as np
from scipy import linalg

from mufly.control.linear_systems import Array, state_space
from mufly.control.robust.dk_iteration import UncertaintyChannel
from mufly.control.robust.parameter_spreads import factor_derivatives

_INPUT_UNCERTAINTY_CORNER_RAD_S = 20.0  # rad/s, at which W_I begins to grow
_HIGH_FREQUENCY_INPUT_UNCERTAINTY = 4.0  # gain of W_I at high frequency


def add_uncertainty(
    generalised: control.StateSpace,
    plant: control.StateSpace,
    n_measurements: int,
    derivatives: Sequence[Array],
    input_uncertainty: float,
) -> tuple[control.StateSpace, list[UncertaintyChannel]]:
    """Add the uncertainty of a plant to its generalised plant; return the extended plant and its channels.

    Parameters
    ----------
    generalised : control.StateSpace
        Plant with weights, perhaps with a delay at its inputs; its first states are those of ``plant``.
    plant : control.StateSpace
        Plant without weights and delay; its input matrix has full column rank, its feedthrough is zero.
    n_measurements : int
        Number of the controller's inputs.
    derivatives : sequence of array, shape (states, states + inputs)
        Derivatives ``[dA dB]`` of the plant, by one spread each.
    input_uncertainty : float
        Gain g of W_I; 0 leaves the inputs certain.

    Returns
    -------
    plant : control.StateSpace
        Inputs and outputs: parameters, plant inputs, performance, controller.
    channels : list of UncertaintyChannel
        One of size 1 for every scalar, then that of the performance.
    """
    P, n, k = generalised, plant.nstates, plant.ninputs
    factors = factor_derivatives(derivatives, float(np.linalg.norm(plant.A)))
    L = np.hstack([np.zeros((n, 0)), *(left for left, _ in factors)])
    R = np.vstack([np.zeros((0, n + k)), *(right for _, right in factors)])
    rest, m = P.nstates - n, L.shape[1]
    # The plant's input as the states and inputs of the generalised plant make it.
    inverse = np.linalg.pinv(plant.B)
    Ux, Uw = inverse @ (P.A[:n] - np.hstack([plant.A, np.zeros((n, rest))])), inverse @ P.B[:n]
    Rx, Ru = R[:, :n], R[:, n:]
    i = k if input_uncertainty > 0.0 else 0
    g, pole, eye = (
        input_uncertainty,
        _HIGH_FREQUENCY_INPUT_UNCERTAINTY * _INPUT_UNCERTAINTY_CORNER_RAD_S / (input_uncertainty or 1.0),
        np.eye(k)[:i],
    )
    A = linalg.block_diag(P.A, -pole * np.eye(i))
    A[P.nstates :, : P.nstates] = eye @ Ux
    B = np.block(
        [[np.vstack([np.hstack([L, plant.B[:, :i]]), np.zeros((rest, m + i))]), P.B], [np.zeros((i, m + i)), eye @ Uw]]
    )
    C = np.vstack(
        [
            np.hstack([np.hstack([Rx, np.zeros((m, rest))]) + Ru @ Ux, np.zeros((m, i))]),
            np.hstack(
                [
                    _HIGH_FREQUENCY_INPUT_UNCERTAINTY * eye @ Ux,
                    (g - _HIGH_FREQUENCY_INPUT_UNCERTAINTY) * pole * np.eye(i),
                ]
            ),
            np.hstack([P.C, np.zeros((P.noutputs, i))]),
        ]
    )
    D = np.block(
        [
            [np.zeros((m, m)), Ru[:, :i], Ru @ Uw],
            [np.zeros((i, m + i)), _HIGH_FREQUENCY_INPUT_UNCERTAINTY * eye @ Uw],
            [np.zeros((P.noutputs, m + i)), P.D],
        ]
    )
    names = [f"parameter[{j}]" for j in range(m)] + [f"input[{j}]" for j in range(i)]
    whole = state_space(
        A, B, C, D,
        inputs=[*(f"w_{name}" for name in names), *P.input_labels],
        outputs=[*(f"z_{name}" for name in names), *P.output_labels],
    )  # fmt: skip
    return whole, [UncertaintyChannel(1, 1)] * (m + i) + [
        UncertaintyChannel(P.noutputs - n_measurements, P.ninputs - k)
    ]
