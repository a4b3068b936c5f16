"""Predict the helicopter's state between two instants, and how errors of this state propagate.

Attitude and velocity follow the strapdown equations (Groves, 2nd ed., ch. 5), from rates w and specific force f in
body axes:

    dR/dt = R [w - b_w]x,       dv/dt = R f + g e_D,       dp/dt = v

The specific force has two sources: the accelerometers measure it, and the flight model predicts it from rotors and
drag (:func:`mufly.dynamics.state_derivative`, evaluated in body axes, far above the floor). With the noise densities
q_a and q_m of the two, the weighted mean is

    f = W (a - b_a) + (1 - W) m(x),         W = q_m / (q_a + q_m),

Since W q_a - (1 - W) q_m = 0, the noise of f is uncorrelated with that of the difference a - m. The filter propagates
the state with f and fuses a - m as a measurement of the accelerometers' bias, the thrust's scale and the wind; no
information is used twice. Clipping reduces the weight of the accelerometers to zero; the model then acts alone.

    m(x) = k f_0 + c + J u,      u = R^T (v - wind)

f_0 is the force without motion through the air, k the scale of the thrust, and c + J u the drag, linearised at the
estimated u. J is diagonal: the drag along an axis depends on the speed along it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import sine_cosine
from mufly.dynamics import compute_battery_supply
from mufly.dynamics.equations_of_motion import _clip_value, state_derivative_from_tilt_sines
from mufly.dynamics.model_state import (
    MODEL_BAR_NORMAL,
    MODEL_CHARGE,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    U_MOTOR_LOWER,
    U_MOTOR_UPPER,
    U_SERVO_1,
    U_SERVO_2,
    ModelParameters,
)
from mufly.estimate.filter.filter_records import (
    ACCEL_WORK_MODEL,
    INPUT_ACCEL,
    INPUT_ACCEL_PER_VELOCITY,
    INPUT_ACCEL_WEIGHT,
    INPUT_FLIGHT_PHASE,
    INPUT_NON_THRUST_ACCEL,
    INPUT_RATES,
    INPUT_THRUST_ACCEL,
    NOMINAL_ACCEL_BIAS,
    NOMINAL_ATTITUDE,
    NOMINAL_GYRO_BIAS,
    NOMINAL_THRUST_SCALE,
    NOMINAL_VELOCITY,
    NOMINAL_WIND,
    PHASE_MOTORS_RUNNING,
    ROTOR_ACCEL_PER_VELOCITY,
    ROTOR_ANG_ACCEL,
    ROTOR_NON_THRUST_ACCEL,
    ROTOR_THRUST_ACCEL,
    TRANSITION_ACCEL,
    TRANSITION_ATTITUDE,
    TRANSITION_THRUST,
    TRANSITION_WIND,
    FilterMemory,
    FilterSettings,
)
from mufly.quantities.units import GRAVITY

_Array = NDArray[np.float64]

_DRAG_SLOPE_STEP_M_S = 0.05  # m/s, for the slope of drag


@cached_njit(error_model="numpy")
def rotation_matrix(q: _Array, r: _Array) -> None:
    """Write the matrix (9 numbers, by rows) from body axes to N-E-D; ``q`` (4,) is w x y z."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    r[0], r[1], r[2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r[3], r[4], r[5] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r[6], r[7], r[8] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@cached_njit(error_model="numpy")
def rotate_attitude(x: _Array, t_x: float, t_y: float, t_z: float, own: bool) -> None:
    """Rotate the attitude in state ``x`` by a small turn (rad), about body axes if ``own``, else about N, E, D."""
    square = t_x * t_x + t_y * t_y + t_z * t_z
    c = 1.0 - square / 8.0 + square * square / 384.0
    k = 0.5 - square / 48.0 + square * square / 3840.0
    if square > 1.0:
        angle = math.sqrt(square)
        k, c = sine_cosine(0.5 * angle)
        k = k / angle
    a, b, d = k * t_x, k * t_y, k * t_z
    w, q_x, q_y, q_z = x[NOMINAL_ATTITUDE], x[NOMINAL_ATTITUDE + 1], x[NOMINAL_ATTITUDE + 2], x[NOMINAL_ATTITUDE + 3]
    s = 1.0 if own else -1.0
    n_w = w * c - q_x * a - q_y * b - q_z * d
    n_x = q_x * c + w * a + s * (q_y * d - q_z * b)
    n_y = q_y * c + w * b + s * (q_z * a - q_x * d)
    n_z = q_z * c + w * d + s * (q_x * b - q_y * a)
    size = 1.0 / math.sqrt(n_w * n_w + n_x * n_x + n_y * n_y + n_z * n_z)
    x[NOMINAL_ATTITUDE], x[NOMINAL_ATTITUDE + 1], x[NOMINAL_ATTITUDE + 2], x[NOMINAL_ATTITUDE + 3] = (
        n_w * size,
        n_x * size,
        n_y * size,
        n_z * size,
    )


@cached_njit(error_model="numpy")
def predict_state(x: _Array, e: _Array, dt: float, r: _Array, a: _Array) -> None:
    """Predict the state ``x`` over ``dt`` (s) with a row of inputs ``e``.

    ``r`` (9,) returns the attitude in the middle of the step, ``a`` (6,) the acceleration without gravity in N-E-D
    and the model's force per mass in body axes."""
    t_x, t_y, t_z = (
        dt * (e[INPUT_RATES] - x[NOMINAL_GYRO_BIAS]),
        dt * (e[INPUT_RATES + 1] - x[NOMINAL_GYRO_BIAS + 1]),
        dt * (e[INPUT_RATES + 2] - x[NOMINAL_GYRO_BIAS + 2]),
    )
    rotate_attitude(x, 0.5 * t_x, 0.5 * t_y, 0.5 * t_z, True)
    rotation_matrix(x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    rotate_attitude(x, 0.5 * t_x, 0.5 * t_y, 0.5 * t_z, True)
    n, o, d = (
        x[NOMINAL_VELOCITY] - x[NOMINAL_WIND],
        x[NOMINAL_VELOCITY + 1] - x[NOMINAL_WIND + 1],
        x[NOMINAL_VELOCITY + 2],
    )
    for k in range(3):
        along = r[k] * n + r[3 + k] * o + r[6 + k] * d
        made = (
            x[NOMINAL_THRUST_SCALE] * e[INPUT_THRUST_ACCEL + k]
            + e[INPUT_NON_THRUST_ACCEL + k]
            + e[INPUT_ACCEL_PER_VELOCITY + k] * along
        )
        share = e[INPUT_ACCEL_WEIGHT + k]
        a[ACCEL_WORK_MODEL + k] = made
        r_f = share * (e[INPUT_ACCEL + k] - x[NOMINAL_ACCEL_BIAS + k]) + (1 - share) * made
        if k == 0:
            f_x = r_f
        elif k == 1:
            f_y = r_f
        else:
            f_z = r_f
    for k in range(3):
        a[k] = r[3 * k] * f_x + r[3 * k + 1] * f_y + r[3 * k + 2] * f_z
        gain = a[k] + (GRAVITY if k == 2 else 0.0)
        x[k] += dt * (x[NOMINAL_VELOCITY + k] + 0.5 * dt * gain)
        x[NOMINAL_VELOCITY + k] += dt * gain


@cached_njit(error_model="numpy")
def error_transition(e: _Array, span: float, r: _Array, push: _Array, out: _Array) -> None:
    """Write the sensitivities of attitude and velocity after a step to the error states before the step.

    With the attitude error t about N, E, D at the middle of the step, corrected for the gyroscopes' bias, and
    u = R^T (v - wind):

        dv' = t x a - R W db_a + R (1 - W) (f_0 dk + J R^T (dv - dw)),     dt' = -R db_w,     dp' = dv

    The effect of the attitude on the drag through R^T is neglected; it is J |u| / g, some percent, of that on gravity.
    On the legs, the floor's force is vertical at any tilt: a = (0, 0, -g) does not depend on the attitude, and t x a is
    zero. (Otherwise a zero velocity would be a measurement of the tilt.)

    Parameters
    ----------
    e : (21,) array
        Inputs, mean over the step.
    span : float
        Duration of the step (s).
    r : (9,) array
        Attitude in the middle of the step, as a rotation matrix by rows.
    push : (3,) array
        Acceleration without gravity, mean over the step, N-E-D (m/s^2).
    out : (33,) array
        Sensitivities over the step, by rows: of the attitude to the gyroscopes' bias (9); of the velocity to the
        accelerometers' bias (9), to the velocity through the air (9), to the thrust's scale (3) and to turns (3).
        Input of :func:`mufly.estimate.filter.ud_filter.propagate_error_column`.
    """
    for i in range(3):
        k_ = 0.0
        for j in range(3):
            own = span * r[3 * i + j]
            out[3 * i + j] = own
            out[TRANSITION_ACCEL + 3 * i + j] = -own * e[INPUT_ACCEL_WEIGHT + j]
            k_ += own * ((1 - e[INPUT_ACCEL_WEIGHT + j]) * e[INPUT_THRUST_ACCEL + j])
        out[TRANSITION_THRUST + i] = k_
        out[TRANSITION_ATTITUDE + i] = 0.0 if e[INPUT_FLIGHT_PHASE] <= PHASE_MOTORS_RUNNING else span * push[i]
    for i in range(3):
        for j in range(i, 3):
            s = 0.0
            for k in range(3):
                s += out[3 * i + k] * ((1 - e[INPUT_ACCEL_WEIGHT + k]) * e[INPUT_ACCEL_PER_VELOCITY + k]) * r[3 * j + k]
            out[TRANSITION_WIND + 3 * i + j] = s
            out[TRANSITION_WIND + 3 * j + i] = s


@cached_njit(error_model="numpy", inline="never")
def _compute_state_derivative(
    x: _Array,
    u: _Array,
    still: _Array,
    p: ModelParameters,
    sin_a: float,
    cos_a: float,
    sin_b: float,
    cos_b: float,
    dx: _Array,
) -> None:
    state_derivative_from_tilt_sines(x, u, still, p, sin_a, cos_a, sin_b, cos_b, False, dx)


@cached_njit(error_model="numpy")
def predict_rotor_force(m: FilterMemory, s: FilterSettings, p: ModelParameters, air: _Array, out: _Array) -> None:
    """Propagate the rotor state by a period, and write the specific force and angular acceleration by rotors and air.

    Parameters
    ----------
    m : record
        Memory; ``m.flight_model_state`` is the flight model's state in body axes: rates, swash plate, bar, rotor
        speeds, charge.
    s, p : records
        Settings; parameters of the flight model.
    air : (3,) array
        Velocity through the air, body axes (m/s).
    out : (12,) array
        Force per mass: without motion, remainder, slope (m/s^2, m/s^2, 1/s); angular acceleration (rad/s^2).
    """
    x, dx, u, dt = m.flight_model_state, m.derivative_work, m.actuator_inputs, s.dt
    # The swash plate settles within the period; its mean is used.
    settled, mean = s.swash_lag_decay, s.swash_lag_decay_mean
    to_roll = p.swash_gain * _clip_value(u[U_SERVO_2], -1.0, 1.0)
    to_pitch = -p.swash_gain * _clip_value(u[U_SERVO_1], -1.0, 1.0)
    roll, pitch = x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH]
    x[MODEL_SWASH_ROLL] = to_roll + (roll - to_roll) * mean
    x[MODEL_SWASH_PITCH] = to_pitch + (pitch - to_pitch) * mean
    x[MODEL_VELOCITY] = x[MODEL_VELOCITY + 1] = x[MODEL_VELOCITY + 2] = 0.0
    sin_a, cos_a = sine_cosine(x[MODEL_SWASH_ROLL])
    sin_b, cos_b = sine_cosine(x[MODEL_SWASH_PITCH])
    _compute_state_derivative(x, u, m.zero_wind, p, sin_a, cos_a, sin_b, cos_b, dx)
    up, dw = dx[MODEL_SPEED_UPPER], dx[MODEL_SPEED_LOWER]
    x[MODEL_SPEED_UPPER] += 0.5 * dt * up
    x[MODEL_SPEED_LOWER] += 0.5 * dt * dw
    b_x, b_y, b_z = x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2]
    # The bar in rotating body axes: minus the rotation of the fuselage.
    s_x = b_x + dt * (dx[MODEL_BAR_NORMAL] - (x[MODEL_RATES + 1] * b_z - x[MODEL_RATES + 2] * b_y))
    s_y = b_y + dt * (dx[MODEL_BAR_NORMAL + 1] - (x[MODEL_RATES + 2] * b_x - x[MODEL_RATES] * b_z))
    s_z = b_z + dt * (dx[MODEL_BAR_NORMAL + 2] - (x[MODEL_RATES] * b_y - x[MODEL_RATES + 1] * b_x))
    size = 1.0 / math.sqrt(s_x * s_x + s_y * s_y + s_z * s_z)
    x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2] = (
        0.5 * (b_x + s_x),
        0.5 * (b_y + s_y),
        0.5 * (b_z + s_z),
    )
    _compute_state_derivative(x, u, m.zero_wind, p, sin_a, cos_a, sin_b, cos_b, dx)
    f_x, f_y, f_z = dx[MODEL_VELOCITY], dx[MODEL_VELOCITY + 1], dx[MODEL_VELOCITY + 2] - GRAVITY
    out[ROTOR_THRUST_ACCEL], out[ROTOR_THRUST_ACCEL + 1], out[ROTOR_THRUST_ACCEL + 2] = f_x, f_y, f_z
    for k in range(3):
        x[MODEL_VELOCITY + k] = air[k]
    _compute_state_derivative(x, u, m.zero_wind, p, sin_a, cos_a, sin_b, cos_b, dx)
    for k in range(3):
        out[ROTOR_ANG_ACCEL + k] = dx[MODEL_RATES + k]
    d_x, d_y, d_z = dx[MODEL_VELOCITY], dx[MODEL_VELOCITY + 1], dx[MODEL_VELOCITY + 2] - GRAVITY
    for k in range(3):
        x[MODEL_VELOCITY + k] = air[k] + _DRAG_SLOPE_STEP_M_S
    _compute_state_derivative(x, u, m.zero_wind, p, sin_a, cos_a, sin_b, cos_b, dx)
    out[ROTOR_ACCEL_PER_VELOCITY] = min((dx[MODEL_VELOCITY] - d_x) / _DRAG_SLOPE_STEP_M_S, 0.0)
    out[ROTOR_ACCEL_PER_VELOCITY + 1] = min((dx[MODEL_VELOCITY + 1] - d_y) / _DRAG_SLOPE_STEP_M_S, 0.0)
    out[ROTOR_ACCEL_PER_VELOCITY + 2] = min((dx[MODEL_VELOCITY + 2] - GRAVITY - d_z) / _DRAG_SLOPE_STEP_M_S, 0.0)
    out[ROTOR_NON_THRUST_ACCEL] = d_x - f_x - out[ROTOR_ACCEL_PER_VELOCITY] * air[0]
    out[ROTOR_NON_THRUST_ACCEL + 1] = d_y - f_y - out[ROTOR_ACCEL_PER_VELOCITY + 1] * air[1]
    out[ROTOR_NON_THRUST_ACCEL + 2] = d_z - f_z - out[ROTOR_ACCEL_PER_VELOCITY + 2] * air[2]
    x[MODEL_SWASH_ROLL] = to_roll + (roll - to_roll) * settled
    x[MODEL_SWASH_PITCH] = to_pitch + (pitch - to_pitch) * settled
    x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2] = s_x * size, s_y * size, s_z * size
    x[MODEL_SPEED_UPPER] = max(x[MODEL_SPEED_UPPER] + 0.5 * dt * up, 0.0)
    x[MODEL_SPEED_LOWER] = max(x[MODEL_SPEED_LOWER] + 0.5 * dt * dw, 0.0)
    x[MODEL_CHARGE] = min(max(x[MODEL_CHARGE] + dt * dx[MODEL_CHARGE], 0.0), 1.0)
    m.supply_current = max(0.0, -p.battery_capacity * dx[MODEL_CHARGE])


@cached_njit(error_model="numpy")
def predict_terminal_voltage(m: FilterMemory, p: ModelParameters) -> float:
    """Return the terminal voltage (V) of the battery model at the estimated charge and rotor speeds."""
    return compute_battery_supply(
        m.flight_model_state, m.actuator_inputs[U_MOTOR_UPPER], m.actuator_inputs[U_MOTOR_LOWER], p
    )[0]
