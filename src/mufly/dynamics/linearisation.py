"""Linear models about a trim, in the thesis's state (eq. 4.30), with the two parts of appendix B.

The Jacobian is that of :func:`mufly.dynamics.model.derivative` by central differences, taken in coordinates without
redundancy: body velocity, Euler angles, and roll and pitch of the bar's disc seen at the trim's heading::

    d(phi, theta, psi)/dt from (p, q, r)  by eq. 4.3, correctly written     (docs/thesis-errata.md, point 4)
    dv_B/dt = A^T dv/dt - W x v_B
    bar normal s = Rz(psi_0) (-sin zeta cos eta, sin eta, -cos zeta cos eta)     eta: bar_roll, zeta: bar_pitch

At hover the parts equal appendix B. ``a_dw`` is the lower rotor's tilt that pitches (-tilt_pitch), ``b_dw`` the one
that rolls (tilt_roll).
"""

from __future__ import annotations

from collections.abc import Sequence

import control
import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.equilibrium import Trim, trim
from mufly.dynamics.model import derivative
from mufly.dynamics.parameters import model_parameters
from mufly.dynamics.state import STATE_SIZE, euler_from_quaternion, quaternion_from_euler, rotation
from mufly.results import result
from mufly.vehicle import Vehicle

STATES = ["x", "y", "z", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r", "a_dw", "b_dw"]
STATES += ["bar_roll", "bar_pitch", "Omega_dw", "Omega_up", "charge"]
INPUTS = ["motor_lower", "motor_upper", "servo_1", "servo_2"]
_SCALE = np.array([1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 400, 400, 1], dtype=np.float64)
_RELATIVE_STEP = 1e-5


@result
class Linearisation:
    """Linear models of one vehicle about one trim.

    Attributes
    ----------
    trim : Trim
        The point of linearisation.
    full : control.StateSpace
        All 19 states, inputs ``motor_lower, motor_upper, servo_1, servo_2``; outputs are the states.
    heave_yaw : control.StateSpace
        States ``z, w, psi, r, Omega_dw, Omega_up``; outputs ``z, psi, r`` (B.1 to B.8).
    roll_pitch : control.StateSpace
        States ``phi, theta, p, q, a_dw, b_dw, bar_roll, bar_pitch``; outputs ``phi, theta, p, q`` (B.9 to B.18).
    """

    trim: Trim
    full: control.StateSpace
    heave_yaw: control.StateSpace
    roll_pitch: control.StateSpace


def linearise(vehicle: Vehicle, at: Trim | None = None, *, voltage: float | None = None) -> Linearisation:
    """Linearise the flight model.

    Parameters
    ----------
    vehicle : Vehicle
    at : Trim, optional
        Point of linearisation; hover by default.
    voltage : float, optional
        Battery voltage (V) for the default hover trim; the nominal voltage by default. The battery of the trim
        holds in the linear model too: constant, or sagging with current and charge.

    Returns
    -------
    Linearisation

    Raises
    ------
    MuflyError
        If the vehicle cannot hover.
    """
    point = trim(vehicle, voltage=voltage) if at is None else at
    p = model_parameters(vehicle, point.constant_voltage_V)
    full_state = point.state.copy()
    full_state[2] = -1e3  # out of the floor's reach; nothing else depends on the place
    heading = float(euler_from_quaternion(full_state[6:10])[2])
    x0 = _minimal(full_state, heading)
    u0 = point.input[[1, 0, 2, 3]]

    def rates(x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return _minimal_rates(x, u, point.wind, p, heading)

    h = _RELATIVE_STEP
    n = len(STATES)
    A, B = np.empty((n, n)), np.empty((n, 4))
    for j in range(n):
        d = np.zeros(n)
        d[j] = h * _SCALE[j]
        A[:, j] = (rates(x0 + d, u0) - rates(x0 - d, u0)) / (2 * d[j])
    for j in range(4):
        d = np.zeros(4)
        d[j] = h
        B[:, j] = (rates(x0, u0 + d) - rates(x0, u0 - d)) / (2 * h)
    # Entries below the differences' own error (round-off, and h drag / m from |v| v around rest) are zeros.
    A[np.abs(A) < 1e-6 * _SCALE[:, None] / _SCALE[None, :]] = 0.0
    B[np.abs(B) < 1e-6 * _SCALE[:, None]] = 0.0

    full = control.ss(
        A, B, np.eye(n), np.zeros((n, 4)), states=STATES, inputs=INPUTS, outputs=STATES, name="full"
    )
    vertical = ["z", "w", "psi", "r", "Omega_dw", "Omega_up"]
    tilting = ["phi", "theta", "p", "q", "a_dw", "b_dw", "bar_roll", "bar_pitch"]
    return Linearisation(
        trim=point,
        full=full,
        heave_yaw=submodel(full, vertical, INPUTS[:2], ["z", "psi", "r"], name="heave_yaw"),
        roll_pitch=submodel(full, tilting, INPUTS[2:], ["phi", "theta", "p", "q"], name="roll_pitch"),
    )


def submodel(
    full: control.StateSpace,
    states: Sequence[str],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    name: str | None = None,
) -> control.StateSpace:
    """Return the part of a linear model that some states and inputs make, the others held; outputs are states."""
    i, j = (
        [known.index(s) for s in some]
        for known, some in ((full.state_labels, states), (full.input_labels, inputs))
    )
    C = np.array([[float(s == o) for s in states] for o in outputs])
    D = np.zeros((len(outputs), len(inputs)))
    labels = {"states": list(states), "inputs": list(inputs), "outputs": list(outputs), "name": name}
    return control.ss(full.A[np.ix_(i, i)], full.B[np.ix_(i, j)], C, D, **labels)


def _minimal(x: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    a = rotation(x[6:10])
    c, s = np.cos(heading), np.sin(heading)
    bar = np.array([c * x[15] + s * x[16], -s * x[15] + c * x[16], x[17]])
    return np.concatenate(
        [
            x[0:3],
            a.T @ x[3:6],
            euler_from_quaternion(x[6:10]),
            x[10:13],
            [-x[14], x[13], np.arcsin(bar[1]), np.arctan2(-bar[0], -bar[2]), x[19], x[18], x[20]],
        ]
    )


def _full(m: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    x = np.empty(STATE_SIZE)
    x[0:3] = m[0:3]
    x[6:10] = quaternion_from_euler(m[6], m[7], m[8])
    x[3:6] = rotation(x[6:10]) @ m[3:6]
    x[10:13] = m[9:12]
    x[13], x[14] = m[13], -m[12]
    x[15:18] = -rotation(quaternion_from_euler(m[14], m[15], heading))[:, 2]
    x[18], x[19], x[20] = m[17], m[16], m[18]
    return x


def _minimal_rates(
    m: NDArray[np.float64], u: NDArray[np.float64], wind: NDArray[np.float64], p: np.void, heading: float
) -> NDArray[np.float64]:
    x, dx = _full(m, heading), np.empty(STATE_SIZE)
    derivative(x, u[[1, 0, 2, 3]], wind, p, dx)
    a = rotation(x[6:10])
    phi, theta = m[6], m[7]
    p_, q_, r_ = m[9:12]
    turn = q_ * np.sin(phi) + r_ * np.cos(phi)
    euler_rates = [p_ + turn * np.tan(theta), q_ * np.cos(phi) - r_ * np.sin(phi), turn / np.cos(theta)]
    c, s = np.cos(heading), np.sin(heading)
    bar_n, bar_e = c * dx[15] + s * dx[16], -s * dx[15] + c * dx[16]
    eta, zeta = m[14], m[15]
    # From s = (-sin zeta cos eta, sin eta, -cos zeta cos eta).
    eta_rate = bar_e / np.cos(eta)
    zeta_rate = (-bar_n * np.cos(zeta) + dx[17] * np.sin(zeta)) / np.cos(eta)
    return np.concatenate(
        [
            dx[0:3],
            a.T @ dx[3:6] - np.cross(m[9:12], m[3:6]),
            euler_rates,
            dx[10:13],
            [-dx[14], dx[13], eta_rate, zeta_rate, dx[19], dx[18], dx[20]],
        ]
    )
