"""Feedback that holds a hover while a signal is added to the inputs, and simulated flights in its closed loop.

It is a linear-quadratic state feedback, designed on the sampled linear model of the whole vehicle. Inputs delayed in
the loop are further states::

    minimise  sum (x' W_x x + u' W_u u),      W = diag(1 / tolerable deviation^2)        (Bryson's rule)

with the tolerable deviations of ``_LQR_STATE_TOLERANCES``. The feedback is weak, so that it does not cancel the
excitation. It receives the true state; a real controller needs an observer for rotor speeds and bar tilt. A plan
uses only the inputs that would be recorded, which depend little on the controller. The design is an own choice; the
dissertation (Sec. 5.3.2) uses a PID and does not state its gains.

Directions of the motor inputs: with settled rotor speeds ``W = -A_WW^-1 B_W u``, the motors cause the accelerations
``(dw/dt, dr/dt) = G u``. The columns of ``G^-1`` are the inputs that change only climb or only yaw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics import (
    PARAMETER_DTYPE,
    Trim,
    body_to_ned_matrix,
    compute_battery_supply,
    find_trim,
    integrate_state,
    linearise_vehicle,
    model_parameters,
)
from mufly.dynamics.linearisation import (
    LINEAR_ATTITUDE,
    LINEAR_BAR_PITCH,
    LINEAR_BAR_ROLL,
    LINEAR_CHARGE,
    LINEAR_POSITION,
    LINEAR_RATES,
    LINEAR_SPEED_LOWER,
    LINEAR_SPEED_UPPER,
    LINEAR_TILT_PITCH,
    LINEAR_TILT_ROLL,
    LINEAR_VELOCITY,
)
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    INPUT_SIZE,
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MODEL_POSITION,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    SWAPPED_MOTOR_INPUT_INDICES,
    ModelParameters,
)
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle

Array = NDArray[np.floating[Any]]
_Floats = NDArray[np.float64]

# State deviations with the same cost as 0.1 of the motor range or 0.3 of the servo range.
_LQR_STATE_TOLERANCES = {
    "x": 1.0, "y": 1.0, "z": 1.0, "u": 1.0, "v": 1.0, "w": 1.5, "phi": 0.25, "theta": 0.25, "psi": 2.0,
    "p": 2.0, "q": 2.0, "r": 8.0, "a_dw": 10.0, "b_dw": 10.0, "bar_roll": 10.0, "bar_pitch": 10.0,
    "Omega_dw": 1e4, "Omega_up": 1e4,
}  # fmt: skip
_LQR_INPUT_TOLERANCES = np.array([0.1, 0.1, 0.3, 0.3])
_SIMULATION_STEP_S = 1e-3
_HOVER_HEIGHT_M, _HOVER_BATTERY_CHARGE = 2.0, 0.7  # height of the hover; state of charge


@dataclass(frozen=True, eq=False)
class HoverFeedback:
    """Hover state of a vehicle, and the feedback that stabilises the vehicle during a planned flight.

    Attributes
    ----------
    hover : Trim
    feedback_gain : (4, 18 + 4 d) array
        Gain to the inputs (upper motor, lower motor, servo 1, servo 2), which are subtracted from the trim. Columns:
        states of the linear model without the charge, in heading axes, then delayed inputs, oldest last.
    collective_direction, differential_direction : (2,) array
        Directions of the motor inputs (upper, lower) that change only climb or only yaw; largest component 1.
    sample_s, delay_s : float
        Sample time and delay of the loop (s).
    """

    hover: Trim
    feedback_gain: Array
    collective_direction: Array
    differential_direction: Array
    sample_s: float
    delay_s: float


def design_hover_feedback(vehicle: Vehicle, *, sample_s: float = 0.01, delay_s: float = 0.02) -> HoverFeedback:
    """Design the hover feedback of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    sample_s, delay_s : float
        Period of the loop, and delay from measurement to input, a multiple of the period (s).

    Raises
    ------
    MuflyError
        If the vehicle cannot hover, or the hover cannot be stabilised.
    """
    hover = find_trim(vehicle, charge=_HOVER_BATTERY_CHARGE)
    full = linearise_vehicle(vehicle, hover).full
    names = list(full.state_labels)
    A, B = full.A, full.B[:, SWAPPED_MOTOR_INPUT_INDICES]

    def state_positions(*states: str) -> list[int]:
        return [names.index(s) for s in states]

    turning = state_positions("Omega_up", "Omega_dw")
    settled = -np.linalg.solve(A[np.ix_(turning, turning)], B[turning, :2])
    inverse = np.linalg.inv(
        A[np.ix_(state_positions("w", "r"), turning)] @ settled + B[np.ix_(state_positions("w", "r"), [0, 1])]
    )
    keep = [k for k, name in enumerate(names) if name != "charge"]
    late = round(delay_s / sample_s)
    a, b = _discretise_with_delay(A[np.ix_(keep, keep)], B[keep], sample_s, late)
    weight = np.r_[[1.0 / _LQR_STATE_TOLERANCES[names[k]] ** 2 for k in keep], np.full(4 * late, 1e-9)]
    try:
        P = solve_discrete_are(a, b, np.diag(weight), np.diag(1.0 / _LQR_INPUT_TOLERANCES**2))
    except (LinAlgError, ValueError) as error:
        raise MuflyError(f"{vehicle.name}: no feedback stabilises the hover; excitation cannot be planned") from error
    gain = np.linalg.solve(np.diag(1.0 / _LQR_INPUT_TOLERANCES**2) + b.T @ P @ b, b.T @ P @ a)
    collective, differential = (v / np.max(np.abs(v)) for v in (-inverse[:, 0], inverse[:, 1]))
    return HoverFeedback(hover, gain, collective, differential, sample_s, delay_s)


def _discretise_with_delay(A: Array, B: Array, sample_s: float, late: int) -> tuple[Array, Array]:
    """Return the sampled model with an input delay of ``late`` samples; the delayed inputs are states, newest first."""
    n = A.shape[0]
    step = expm(sample_s * np.block([[A, B], [np.zeros((INPUT_SIZE, n + INPUT_SIZE))]]))
    if late == 0:
        return step[:n, :n], step[:n, n:]
    size = n + INPUT_SIZE * late
    a, b = np.zeros((size, size)), np.zeros((size, INPUT_SIZE))
    a[:n, :n] = step[:n, :n]
    a[:n, size - INPUT_SIZE :] = step[:n, n:]
    a[n + INPUT_SIZE :, n : size - INPUT_SIZE] = np.eye(INPUT_SIZE * (late - 1))
    b[n : n + INPUT_SIZE] = np.eye(INPUT_SIZE)
    return a, b


@cached_njit(error_model="numpy")
def _subtract_hover_state(x: _Floats, hover: _Floats, height: float, yaw: float, off: _Floats) -> None:
    """Write the linear model's state (without the charge) into ``off``: the state ``x`` minus the hover state.

    Its horizontal axes are turned to the heading ``yaw`` (rad).
    """
    a = body_to_ned_matrix(x[ATTITUDE_SLICE])
    roll, pitch = math.atan2(a[2, 1], a[2, 2]), math.asin(min(max(-a[2, 0], -1.0), 1.0))
    c, s = math.cos(yaw), math.sin(yaw)
    off[LINEAR_POSITION] = c * x[MODEL_POSITION] + s * x[MODEL_POSITION + 1]
    off[LINEAR_POSITION + 1] = c * x[MODEL_POSITION + 1] - s * x[MODEL_POSITION]
    off[LINEAR_POSITION + 2] = x[MODEL_POSITION + 2] + height
    for k in range(3):
        off[LINEAR_VELOCITY + k] = (
            a[0, k] * x[MODEL_VELOCITY] + a[1, k] * x[MODEL_VELOCITY + 1] + a[2, k] * x[MODEL_VELOCITY + 2]
        )
        off[LINEAR_RATES + k] = x[MODEL_RATES + k]
    off[LINEAR_ATTITUDE], off[LINEAR_ATTITUDE + 1], off[LINEAR_ATTITUDE + 2] = roll, pitch, yaw
    off[LINEAR_TILT_PITCH] = -x[MODEL_SWASH_PITCH] + hover[MODEL_SWASH_PITCH]
    off[LINEAR_TILT_ROLL] = x[MODEL_SWASH_ROLL] - hover[MODEL_SWASH_ROLL]
    off[LINEAR_BAR_ROLL] = math.asin(min(max(c * x[MODEL_BAR_NORMAL + 1] - s * x[MODEL_BAR_NORMAL], -1.0), 1.0))
    off[LINEAR_BAR_PITCH] = math.atan2(
        -(c * x[MODEL_BAR_NORMAL] + s * x[MODEL_BAR_NORMAL + 1]), -x[MODEL_BAR_NORMAL + 2]
    )
    off[LINEAR_SPEED_LOWER] = x[MODEL_SPEED_LOWER] - hover[MODEL_SPEED_LOWER]
    off[LINEAR_SPEED_UPPER] = x[MODEL_SPEED_UPPER] - hover[MODEL_SPEED_UPPER]


@cached_njit(error_model="numpy")
def _fly_closed_loop(
    x: _Floats,
    hover: _Floats,
    trimmed: _Floats,
    gain: _Floats,
    added: _Floats,
    p: ModelParameters,
    late: int,
    dt: float,
    steps: int,
    height: float,
    states: _Floats,
    inputs: _Floats,
    voltage: _Floats,
) -> None:
    n, calm, off, yaw = added.shape[0], np.zeros(3), np.zeros(gain.shape[1]), 0.0
    for k in range(n):
        states[k] = x
        qw, qx, qy, qz = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
        heading = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        yaw = heading + 2 * math.pi * round((yaw - heading) / (2 * math.pi))
        _subtract_hover_state(x, hover, height, yaw, off)
        for j in range(late):
            for i in range(4):
                off[LINEAR_CHARGE + 4 * j + i] = inputs[k - 1 - j, i] - trimmed[i] if k > j else 0.0
        for i in range(4):
            u = trimmed[i] + added[k, i]
            for m in range(off.shape[0]):
                u -= gain[i, m] * off[m]
            inputs[k, i] = min(max(u, 0.0 if i < 2 else -1.0), 1.0)
        now = inputs[k - late] if k >= late else trimmed
        voltage[k] = compute_battery_supply(x, now[0], now[1], p)[0]
        integrate_state(x, now, calm, p, dt, steps)


@cached_njit(parallel=True, error_model="numpy")
def _fly_batch_closed_loop(
    x: _Floats,
    hover: _Floats,
    trimmed: _Floats,
    gain: _Floats,
    added: _Floats,
    p: NDArray[np.void],
    late: int,
    dt: float,
    steps: int,
    height: float,
    states: _Floats,
    inputs: _Floats,
    voltage: _Floats,
) -> None:
    for b in prange(x.shape[0]):
        one = states[b], inputs[b], voltage[b]
        _fly_closed_loop(x[b], hover, trimmed, gain, added[b], p[b], late, dt, steps, height, *one)


def simulate_closed_loop_flights(
    vehicle: Vehicle, support: HoverFeedback, added: Array
) -> tuple[_Floats, _Floats, _Floats]:  # fmt: skip
    """Simulate the whole model in closed loop, one flight for each signal.

    Parameters
    ----------
    vehicle : Vehicle
    support : HoverFeedback
    added : (b, n, 4) array
        Signals added to upper motor, lower motor, servo 1 and servo 2.

    Returns
    -------
    states : (b, n, 21) array
        States (:mod:`mufly.dynamics.model_state`).
    inputs : (b, n, 4) array
        Commanded inputs, clipped to the actuator ranges.
    voltage : (b, n) array
        Battery voltage (V).
    """
    b, n, _ = added.shape
    x = np.repeat(support.hover.state[None], b, axis=0)
    x[:, 2] = -_HOVER_HEIGHT_M
    states, inputs, voltage = np.empty((b, n, x.shape[1])), np.empty((b, n, 4)), np.empty((b, n))
    p = np.full(b, np.array(model_parameters(vehicle), dtype=PARAMETER_DTYPE))
    late, steps = round(support.delay_s / support.sample_s), round(support.sample_s / _SIMULATION_STEP_S)
    _fly_batch_closed_loop(
        x,
        support.hover.state,
        support.hover.input,
        support.feedback_gain,
        np.ascontiguousarray(added),
        p,
        late,
        _SIMULATION_STEP_S,
        steps,
        _HOVER_HEIGHT_M,
        states,
        inputs,
        voltage,
    )
    return states, inputs, voltage
