"""States with which the control law starts: without a bump, whatever the actuators do at the moment.

The controller's state is the one whose output is the present input and which moves least from there: least squares of
``(I - A) x - B e`` subject to ``C x + D e = output``. The slow modes then carry the offset.
"""

from __future__ import annotations

import numpy as np

from mufly.control.gains import (
    HEAVE_YAW_ORDER,
    HEAVE_YAW_STATE,
    ORIGIN_PSI,
    ORIGIN_Z,
    SHAPED_PSI,
    SHAPED_Z,
    VOLTAGE,
)
from mufly.control.linear import Array

__all__ = ["heave_yaw_initial", "position_initial", "roll_pitch_initial"]


def _at_rest(gains: np.void, e: Array, output: Array) -> Array:
    """Controller state whose output is ``output`` at input ``e`` and which moves least from there."""
    A, B, C, D = (np.asarray(gains[name]) for name in "ABCD")
    used = np.nonzero(np.any(A != 0, axis=1) | np.any(B != 0, axis=1) | np.any(C != 0, axis=0))[0]
    A, B, C = A[np.ix_(used, used)], B[used], C[:, used]
    F = np.eye(used.size) - A
    m = C.shape[0]
    system = np.block([[F.T @ F, C.T], [C, np.zeros((m, m))]])
    x = np.zeros(gains["A"].shape[0])
    x[used] = np.linalg.lstsq(system, np.concatenate([F.T @ B @ e, output - D @ e]), rcond=None)[0][
        : used.size
    ]
    return x


def heave_yaw_initial(gains: np.void, measurement: Array, motor_input: Array, voltage: float) -> Array:
    """State that engages heave-yaw without a bump.

    Parameters
    ----------
    gains : record of type ``HEAVE_YAW_GAINS``
    measurement : (3,) array
        z (m), psi (rad), r (rad/s) at the moment; the references start from there.
    motor_input : (2,) array
        Upper, lower (0..1) that the motors have at the moment, on the ground say.
    voltage : float
        Measured battery voltage (V).

    Returns
    -------
    (17,) array
        State for the first ``heave_yaw_step``; with the reference at the measurement its output is ``motor_input``.
    """
    z, psi, r = (float(v) for v in measurement)
    design = float(gains["design_voltage"])
    believed = min(max(float(voltage), 0.5 * design), 1.5 * design)
    command = np.array([motor_input[1], motor_input[0]], dtype=float) * believed / design
    state = np.zeros(HEAVE_YAW_STATE)
    state[:HEAVE_YAW_ORDER] = _at_rest(gains, np.array([0.0, 0.0, 0.0, 0.0, -r]), command - gains["trim"])
    state[SHAPED_Z], state[SHAPED_PSI], state[ORIGIN_Z], state[ORIGIN_PSI] = z, psi, z, psi
    state[VOLTAGE] = believed
    return state


def roll_pitch_initial(
    gains: np.void, measurement: Array | None = None, servo_input: Array | None = None
) -> Array:
    """State that engages roll-pitch without a bump: level and at trim by default.

    Parameters
    ----------
    gains : record of type ``ROLL_PITCH_GAINS``
    measurement : (4,) array, optional
        phi, theta (rad), p, q (rad/s); the reference is taken to be level.
    servo_input : (2,) array, optional
        Servo inputs at the moment.

    Returns
    -------
    (8,) array
    """
    e = np.zeros(4) if measurement is None else -np.asarray(measurement, dtype=float)
    servo = np.asarray(gains["trim"]) if servo_input is None else np.asarray(servo_input, dtype=float)
    return _at_rest(gains, e, servo - gains["trim"])


def position_initial(gains: np.void) -> Array:
    """State of the position cascade at rest.

    Returns
    -------
    (6,) array
    """
    return np.zeros(gains["A"].shape[0])
