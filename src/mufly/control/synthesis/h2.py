"""H2 synthesis: the controller with the smallest H2 norm from ``w`` to ``z``, and the H2 norm by both Gramians.

The H2 norm is the root mean square of ``z`` for white noise of unit intensity in ``w``. With the generalised plant of
:mod:`mufly.control.synthesis.hinf` and ``D11 = 0`` two Riccati equations give the optimum (Doyle, Glover, Khargonekar
and Francis, IEEE Trans. Autom. Control 34, 1989):

    X: state feedback, weights C1'C1, D12'D12, C1'D12,     F = -(D12'D12)^-1 (B2'X + D12'C1),

    Y: filter, noises B1 B1', D21 D21', B1 D21',           L = -(Y C2' + B1 D21') (D21 D21')^-1.

The controller is the filter with the state feedback, ``K = (A + B2 F + L C2 + L D22 F, -L, F, 0)``. The poles of the
closed loop are those of ``A + B2 F`` and of ``A + L C2`` (separation), and its norm follows from X and Y alone.
"""

from __future__ import annotations

import control
import numpy as np
from scipy import linalg

from mufly.control.linear_systems import Array, ComplexArray, state_space
from mufly.control.synthesis.hinf import compute_lower_lft, partition_plant, scale_states_diagonally
from mufly.errors import MuflyError
from mufly.results import result


@result
class H2Result:
    """The optimal controller, its norm and its poles.

    Attributes
    ----------
    controller : control.StateSpace
        Controller from measurements to controls, of the plant's order.
    norm : float
        H2 norm of the closed loop, computed from it.
    riccati_norm : float
        The same norm from the two Riccati solutions.
    closed_loop : control.StateSpace
        Closed loop from ``w`` to ``z``.
    anti_windup_matrix : array, shape (states, controls)
        Input matrix of the control in the controller's plant model; see ``hinf.HinfResult.anti_windup_matrix``.
    regulator_poles, filter_poles : array
        Poles of the state feedback and of the filter (rad/s); together those of the closed loop.
    """

    controller: control.StateSpace
    norm: float
    riccati_norm: float
    closed_loop: control.StateSpace
    anti_windup_matrix: Array
    regulator_poles: ComplexArray
    filter_poles: ComplexArray


def h2_norm(system: control.StateSpace) -> tuple[float, float]:
    """Return the H2 norm of a continuous-time system by the Gramian of its inputs and by that of its outputs.

    Parameters
    ----------
    system : control.StateSpace

    Returns
    -------
    by_controllability, by_observability : float
        Equal but for rounding; ``inf`` for an unstable system, or one with feedthrough.
    """
    A, B, C = system.A, system.B, system.C
    if np.any(np.abs(system.D) > 1e-12):
        return np.inf, np.inf
    if not system.nstates:
        return 0.0, 0.0
    if np.linalg.eigvals(A).real.max() >= 0.0:
        return np.inf, np.inf
    P = linalg.solve_continuous_lyapunov(A, -B @ B.T)
    Q = linalg.solve_continuous_lyapunov(A.T, -C.T @ C)
    return float(np.sqrt(np.trace(C @ P @ C.T))), float(np.sqrt(np.trace(B.T @ Q @ B)))


def h2syn(P: control.StateSpace, n_measurements: int, n_controls: int) -> H2Result:
    """Synthesise the controller with the smallest H2 norm from ``w`` to ``z``.

    Parameters
    ----------
    P : control.StateSpace
        Generalised plant, continuous time; its last ``n_measurements`` outputs and ``n_controls`` inputs are those
        of the controller. Its part from ``w`` to ``z`` must have no feedthrough.
    n_measurements, n_controls : int
        Sizes of ``y`` and ``u``.

    Returns
    -------
    H2Result

    Raises
    ------
    MuflyError
        If ``w`` feeds through to ``z``, or a Riccati equation has no stabilising solution.

    Notes
    -----
    Source: Doyle, Glover, Khargonekar and Francis (1989); see the module's docstring.
    """
    even = scale_states_diagonally(P)
    p = partition_plant(even.A, even.B, even.C, even.D, n_measurements, n_controls)
    ny, nu = p.D22.shape
    if p.D11.size and np.abs(p.D11).max() > 1e-12:
        row, column = np.unravel_index(int(np.abs(p.D11).argmax()), p.D11.shape)
        raise MuflyError(
            f"H2 synthesis: {P.input_labels[column]!r} feeds through to {P.output_labels[row]!r}, so the norm is "
            "infinite; give one of their weights a roll-off"
        )
    R, N = p.D12.T @ p.D12, p.D21 @ p.D21.T
    try:
        X = linalg.solve_continuous_are(p.A, p.B2, p.C1.T @ p.C1, R, s=p.C1.T @ p.D12)
        Y = linalg.solve_continuous_are(p.A.T, p.C2.T, p.B1 @ p.B1.T, N, s=p.B1 @ p.D21.T)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise MuflyError(
            f"H2 synthesis: a Riccati equation has no stabilising solution ({error}); weight every control, and give "
            "every measurement noise"
        ) from None
    F = -np.linalg.solve(R, p.B2.T @ X + p.D12.T @ p.C1)
    L = -np.linalg.solve(N, (Y @ p.C2.T + p.B1 @ p.D21.T).T).T
    K = state_space(
        p.A + p.B2 @ F + L @ p.C2 + L @ p.D22 @ F,
        -L,
        F,
        np.zeros((nu, ny)),
        inputs=P.output_labels[-ny:],
        outputs=P.input_labels[-nu:],
    )
    loop = compute_lower_lft(P, K)
    cost = np.trace(p.B1.T @ X @ p.B1) + np.trace(R @ F @ Y @ F.T)
    return H2Result(
        K,
        h2_norm(loop)[0],
        float(np.sqrt(max(cost, 0.0))),
        loop,
        p.B2 + L @ p.D22,
        np.linalg.eigvals(p.A + p.B2 @ F).astype(complex),
        np.linalg.eigvals(p.A + L @ p.C2).astype(complex),
    )
