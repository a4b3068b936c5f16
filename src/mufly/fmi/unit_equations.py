"""Initial state and outputs of a co-simulation unit; the unit's C functions are translated from this source.

:mod:`mufly.fmi.c_translation` translates these functions together with the equations of motion that they call. They
are not compiled for Python.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.edgewise_loads import edgewise_load_factors
from mufly.dynamics.equations_of_motion import (
    compute_axial_climb_velocity,
    compute_battery_supply,
    ground_effect_thrust_increment,
    interpolate_coefficient_map,
    state_derivative,
)
from mufly.dynamics.model_state import (
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MODEL_CHARGE,
    MODEL_POSITION,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    STATE_SIZE,
    U_MOTOR_LOWER,
    U_MOTOR_UPPER,
    ModelParameters,
    rotation_entries,
)
from mufly.quantities.units import GRAVITY
from mufly.rotations import quaternion_from_euler

_Array = NDArray[np.float64]

# Indices of the start values.
START_POSITION_INDEX, START_VELOCITY_INDEX, START_ATTITUDE_INDEX, START_RATES_INDEX = 0, 3, 6, 9
START_SWASH_ROLL_INDEX, START_SWASH_PITCH_INDEX, START_BAR_ROLL_INDEX, START_BAR_PITCH_INDEX = 12, 13, 14, 15
START_SPEED_UPPER_INDEX, START_SPEED_LOWER_INDEX, START_CHARGE_INDEX = 16, 17, 18
START_COUNT = 19
# Indices of the outputs: the state, and then
OUT_ROLL = STATE_SIZE
OUT_PITCH, OUT_YAW, OUT_THRUST_UPPER, OUT_THRUST_LOWER, OUT_VOLTAGE, OUT_CURRENT, OUT_SPECIFIC_FORCE = range(
    OUT_ROLL + 1, OUT_ROLL + 8
)
OUTPUT_COUNT = OUT_SPECIFIC_FORCE + 3


def write_start_state(start: _Array, x: _Array) -> None:
    """Write the initial state for given start values, as :func:`mufly.dynamics.initial_state` does.

    Parameters
    ----------
    start : (19,) array
        Start values at the indices ``START_...``: attitude as roll, pitch, yaw (rad), the bar's disc by its roll and
        pitch at that yaw (rad).
    x : (21,) array
        Output: state.
    """
    for i in range(3):
        x[MODEL_POSITION + i] = start[START_POSITION_INDEX + i]
        x[MODEL_VELOCITY + i] = start[START_VELOCITY_INDEX + i]
        x[MODEL_RATES + i] = start[START_RATES_INDEX + i]
    q = quaternion_from_euler(
        start[START_ATTITUDE_INDEX], start[START_ATTITUDE_INDEX + 1], start[START_ATTITUDE_INDEX + 2]
    )
    x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3] = q[0], q[1], q[2], q[3]
    x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH] = start[START_SWASH_ROLL_INDEX], start[START_SWASH_PITCH_INDEX]
    w, i, j, k = quaternion_from_euler(
        start[START_BAR_ROLL_INDEX], start[START_BAR_PITCH_INDEX], start[START_ATTITUDE_INDEX + 2]
    )
    _, _, n, _, _, e, _, _, d = rotation_entries(w, i, j, k)
    x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2] = -n, -e, -d
    x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER], x[MODEL_CHARGE] = (
        start[START_SPEED_UPPER_INDEX],
        start[START_SPEED_LOWER_INDEX],
        start[START_CHARGE_INDEX],
    )


def write_outputs(x: _Array, u: _Array, wind: _Array, p: ModelParameters, out: _Array) -> None:
    """Write the outputs of a unit at a state: the state itself, then the quantities with indices ``OUT_...``.

    Parameters
    ----------
    x : (21,) array
        State.
    u : (4,) array
        Motor upper, motor lower, servo 1, servo 2.
    wind : (3,) array
        N-E-D (m/s).
    p : record of :class:`~mufly.dynamics.ModelParameters`
    out : (31,) array
        Output: state; roll, pitch, yaw (rad); thrust of upper and lower rotor with ground effect and edgewise flow (N);
        voltage (V) and current (A) of the battery; specific force of the centre of gravity in body axes (m/s^2). An
        ideal accelerometer measures the specific force.
    """
    for i in range(STATE_SIZE):
        out[i] = x[i]
    qw, qx, qy, qz = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    out[OUT_ROLL] = math.atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))
    out[OUT_PITCH] = math.asin(min(max(2 * (qw * qy - qz * qx), -1.0), 1.0))
    out[OUT_YAW] = math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))

    a00, a01, a02, a10, a11, a12, a20, a21, a22 = rotation_entries(qw, qx, qy, qz)
    speed_up, speed_dw = x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER]
    kT_up, kT_dw = p.thrust_up, p.thrust_dw
    if p.map_node_count > 0:
        kT_up, kT_dw, _, _ = interpolate_coefficient_map(speed_up, speed_dw, compute_axial_climb_velocity(x, wind), p)
    free_up, free_dw = kT_up * speed_up * speed_up, kT_dw * speed_dw * speed_dw
    thrust_up, thrust_dw = free_up, free_dw
    if p.flight_map_node_count > 0:
        factors = edgewise_load_factors(x, wind, p)
        thrust_up, thrust_dw = factors[0][0] * free_up, factors[1][0] * free_dw
    if p.ground_effect > 0.0:
        v_n, v_e = x[MODEL_VELOCITY] - wind[0], x[MODEL_VELOCITY + 1] - wind[1]
        across, height = v_n * v_n + v_e * v_e, -x[MODEL_POSITION + 2]
        thrust_up += ground_effect_thrust_increment(free_up, height - a22 * p.z_up, across, p)
        thrust_dw += ground_effect_thrust_increment(free_dw, height - a22 * p.z_dw, across, p)
    out[OUT_THRUST_UPPER], out[OUT_THRUST_LOWER] = thrust_up, thrust_dw

    motor_up, motor_dw = min(max(u[U_MOTOR_UPPER], 0.0), 1.0), min(max(u[U_MOTOR_LOWER], 0.0), 1.0)
    voltage, current = compute_battery_supply(x, motor_up, motor_dw, p)
    out[OUT_VOLTAGE], out[OUT_CURRENT] = voltage, current

    dx = np.empty(x.shape[0])
    state_derivative(x, u, wind, p, dx)
    f_n, f_e, f_d = dx[MODEL_VELOCITY], dx[MODEL_VELOCITY + 1], dx[MODEL_VELOCITY + 2] - GRAVITY
    out[OUT_SPECIFIC_FORCE] = a00 * f_n + a10 * f_e + a20 * f_d
    out[OUT_SPECIFIC_FORCE + 1] = a01 * f_n + a11 * f_e + a21 * f_d
    out[OUT_SPECIFIC_FORCE + 2] = a02 * f_n + a12 * f_e + a22 * f_d
