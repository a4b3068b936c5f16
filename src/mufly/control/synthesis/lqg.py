"""LQG with integral action, and loop transfer recovery (LTR) at the plant's input.

The plant ``xdot = A x + B u``, ``y = C x`` is scaled. Integrals ``xi`` of the errors ``y_r - r`` join the state. State
feedback minimises the integral of weighted squares of errors, rates, integrals and inputs. A Kalman filter estimates
``x`` from ``y`` with process noise ``q^2 B B'`` at the input and measurement noise of the stated deviations:

    u = -F_x (xhat - N r) - F_i xi,   xhat' = A xhat + B u + L (y - C xhat),   xi' = y_r - r.

The loop of state feedback has S_u of at most 0 dB. As ``q`` grows the loop with the filter approaches it, if the plant
has no zero in the right half plane (Doyle and Stein, IEEE Trans. Autom. Control 26, 1981). The filter's poles grow with
``q``. The bilinear rule distorts poles beyond the sampling rate, so :func:`find_largest_ltr_parameter` bounds ``q``
by them.

``N`` is the equilibrium of a referenced output, for a controller that reads references and errors apart. A controller
that reads only errors applies filter and integrators to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np
from scipy import linalg

from mufly.control.linear_systems import Array, ComplexArray, state_space
from mufly.errors import ArgumentError, MuflyError
from mufly.results import result

_INTEGRATOR_LEAK_RATE_RAD_S = 1e-3  # rad/s, of the integrators: far below every loop, but stable
_STATE_NOISE = 1e-4  # process noise on every state, so that no mode of the plant is without noise
_STATE_WEIGHT = 1e-9  # weight on every state, so that modes that no weighted output shows have one


@dataclass(frozen=True)
class LqgWeights:
    """Weights of LQG in scaled units.

    Attributes
    ----------
    error, rate, integral : tuple of float
        Weights of the squared errors, of their squared rates and of their squared integrals, for each referenced
        output.
    control : float
        Weight of every squared input.
    noise : tuple of float
        Intensities of the measurement noise (deviations), for each output.
    process_noise : float
        Intensity ``q`` of the noise at the plant's input for plain LQG.
    recovery : float
        The same for LTR; bounded by the sampling rate.
    """

    error: tuple[float, ...]
    rate: tuple[float, ...]
    integral: tuple[float, ...]
    control: float
    noise: tuple[float, ...]
    process_noise: float = 0.05
    recovery: float = 10.0


@result
class LqgResult:
    """An LQG controller with its state feedback and its Kalman filter.

    Attributes
    ----------
    controller : control.StateSpace
        Controller from references (if any) and errors to controls, ``u = K [r; e]``.
    state_gain : array, shape (inputs, states + integrals)
        Gain of the state feedback.
    filter_gain : array, shape (states, outputs)
        Gain of the Kalman filter.
    anti_windup_matrix : array, shape (controller states, inputs)
        Effect of actuation beyond the command on the controller's states, for anti-windup.
    regulator_poles, filter_poles : array
        Poles of state feedback and filter (rad/s); together those of the closed loop, but for the integrators' leak.
    recovery : float
        Intensity ``q`` used.
    """

    controller: control.StateSpace
    state_gain: Array
    filter_gain: Array
    anti_windup_matrix: Array
    regulator_poles: ComplexArray
    filter_poles: ComplexArray
    recovery: float


def augment_integrators(plant: control.StateSpace, references: Sequence[int]) -> tuple[Array, Array]:
    """Return A and B of the plant, extended by the leaky integrals of the outputs ``references`` as states."""
    n, k = plant.nstates, len(references)
    A = np.block([[plant.A, np.zeros((n, k))], [plant.C[list(references)], -_INTEGRATOR_LEAK_RATE_RAD_S * np.eye(k)]])
    return A, np.vstack([plant.B, np.zeros((k, plant.ninputs))])


def lqr_gain(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Return the gain F of the state feedback ``u = -F x`` with the least integral of ``x'Q x + u'R u``.

    Raises
    ------
    MuflyError
        If the Riccati equation has no stabilising solution.
    """
    try:
        X = linalg.solve_continuous_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise MuflyError(
            f"LQG: the Riccati equation has no stabilising solution ({error}); check that every unstable mode "
            "is controllable, observable and weighted"
        ) from None
    gain: Array = np.linalg.solve(R, B.T @ X)
    return gain


def kalman_gain(plant: control.StateSpace, intensity: float, noise: Array) -> Array:
    """Return the gain of the Kalman filter for noise ``intensity`` at every input and ``noise`` on the outputs."""
    process = intensity**2 * plant.B @ plant.B.T + _STATE_NOISE**2 * np.eye(plant.nstates)
    return lqr_gain(plant.A.T, plant.C.T, process, np.diag(np.square(noise))).T


def find_largest_ltr_parameter(plant: control.StateSpace, weights: LqgWeights, fastest: float) -> float:
    """Return the largest LTR parameter q (recovery) whose filter poles are at most as fast as ``fastest`` (rad/s).

    The result lies between the process noise and the recovery of ``weights``.

    Poles that the plant has itself (a fast servo) do not count: the filter leaves them where they are.
    """
    own = np.linalg.eigvals(plant.A)

    def fastest_filter_pole(q: float) -> float:
        poles = np.linalg.eigvals(plant.A - kalman_gain(plant, q, np.array(weights.noise)) @ plant.C)
        moved = np.abs(poles[:, None] - own).min(axis=1) > 0.1 * np.abs(poles)
        return float(np.abs(poles[moved]).max(initial=0.0))

    if fastest_filter_pole(weights.recovery) <= fastest:
        return weights.recovery
    low, high = 0.0, weights.recovery
    for _ in range(30):
        middle = float(np.sqrt(low * high)) if low else high / 10.0
        if middle < weights.process_noise:
            return weights.process_noise
        low, high = (middle, high) if fastest_filter_pole(middle) <= fastest else (low, middle)
        if low > 0.999 * high:
            break
    return low


def design_lqg(
    plant: control.StateSpace,
    references: Sequence[int],
    weights: LqgWeights,
    *,
    recovery: float | None = None,
    two_degrees: bool = False,
) -> LqgResult:
    """Design an LQG controller with integral action.

    Parameters
    ----------
    plant : control.StateSpace
        Scaled plant without feedthrough, continuous time.
    references : sequence of int
        Outputs with a reference; their errors are integrated.
    weights : LqgWeights
    recovery : float, optional
        Intensity ``q`` of the noise at the plant's input; ``weights.process_noise`` by default.
    two_degrees : bool
        Whether the controller reads references and errors apart; otherwise only errors.

    Returns
    -------
    LqgResult

    Raises
    ------
    ArgumentError
        If the number of weights does not fit the plant.
    MuflyError
        If a Riccati equation has no stabilising solution.
    """
    rows, (p, m), n = list(references), plant.D.shape, plant.nstates
    for name, wanted in (("error", len(rows)), ("rate", len(rows)), ("integral", len(rows)), ("noise", p)):
        given = len(getattr(weights, name))
        if given != wanted:
            raise ArgumentError("weights", name, f"{given} numbers", f"give {wanted}")
    q = weights.process_noise if recovery is None else recovery
    A, B = augment_integrators(plant, rows)
    shown = plant.C[rows]
    rates = shown @ plant.A
    Qx = shown.T @ np.diag(weights.error) @ shown + rates.T @ np.diag(weights.rate) @ rates
    Q = linalg.block_diag(Qx, np.diag(weights.integral))
    F = lqr_gain(A, B, Q + _STATE_WEIGHT * np.eye(len(A)), weights.control * np.eye(m))
    L = kalman_gain(plant, q, np.array(weights.noise))
    Fx, Fi = F[:, :n], F[:, n:]
    S = np.zeros((len(rows), p))
    S[range(len(rows)), rows] = 1.0
    Ak = np.block([[plant.A - plant.B @ Fx - L @ plant.C, -plant.B @ Fi], [np.zeros((len(rows), n)), A[n:, n:]]])
    Bk, Ck, Dk = np.vstack([-L, -S]), -F, np.zeros((m, p))
    inputs = [f"error[{i}]" for i in plant.output_labels]
    if two_degrees:
        target = _find_equilibrium_states(plant, rows)
        feed = Fx @ target
        Bk = np.hstack([np.vstack([plant.B @ feed, -np.eye(len(rows))]), Bk])
        Dk = np.hstack([feed, Dk])
        inputs = [*(f"reference[{plant.output_labels[i]}]" for i in rows), *inputs]
    return LqgResult(
        state_space(Ak, Bk, Ck, Dk, inputs=inputs, outputs=plant.input_labels),
        F,
        L,
        np.vstack([plant.B, np.zeros((len(rows), m))]),
        np.linalg.eigvals(A - B @ F).astype(complex),
        np.linalg.eigvals(plant.A - L @ plant.C).astype(complex),
        q,
    )


def _find_equilibrium_states(plant: control.StateSpace, rows: Sequence[int]) -> Array:
    """Return, for each output of ``rows``, the state nearest to equilibrium (zero input) with this output at one."""
    n = plant.nstates
    system = np.vstack([plant.A, 1e3 * plant.C[list(rows)]])
    right = np.vstack([np.zeros((n, len(rows))), 1e3 * np.eye(len(rows))])
    solved: Array = np.linalg.lstsq(system, right, rcond=None)[0]
    return solved
