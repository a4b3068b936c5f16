"""Compute the filter's output: the state at the horizon propagated to the present, its covariance, a smooth position.

The propagation is spread over several periods (PX4's output predictor); :mod:`mufly.estimate.filter.ekf_step` explains
it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import floor_int, portable_atan2, sine_cosine
from mufly.estimate.filter.filter_records import (
    ERROR_ATTITUDE,
    ERROR_STATE_COUNT,
    ERROR_VELOCITY,
    FULL_TURN_RAD,
    INPUT_ACCEL_WEIGHT,
    INPUT_HISTORY_BLOCKS,
    INPUT_NOISE_DENSITY,
    MAX_FLOOR_HEIGHT_M,
    NOMINAL_ATTITUDE,
    NOMINAL_GYRO_BIAS,
    NOMINAL_POSITION,
    NOMINAL_TERRAIN,
    NOMINAL_VELOCITY,
    PHASE_FLYING,
    ROTOR_ANG_ACCEL,
    ROTOR_FORCE_HISTORY,
    STATE_COUNT,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.strapdown import error_transition, predict_state, rotate_attitude
from mufly.estimate.filter.ud_filter import propagate_error_column, state_variance
from mufly.quantities.units import GRAVITY

_Array = NDArray[np.float64]

FORCE_MEAN_TICKS = 8
"""Number of periods over which measured and modelled forces are averaged."""
COVARIANCE_INTERVAL_TICKS = 20
"""Number of periods between two published covariances."""
OUTPUT_JUMP_M, OUTPUT_JUMP_DECAY_S = 0.05, 0.4
"""Jump of the position from which on a share of it is smoothed, at twice its size the whole (m), and decay time (s)."""


@cached_njit(error_model="numpy")
def velocity_noise_density(r: _Array, k: int, e: _Array) -> float:
    """Return the spectral density of the velocity noise along axis ``k`` of N-E-D (m^2/s^3)."""
    spread = 0.0
    for i in range(3):
        spread += r[3 * k + i] * r[3 * k + i] * e[INPUT_NOISE_DENSITY + i]
    return spread


@cached_njit(error_model="numpy")
def _smooth_output(m: FilterMemory, s: FilterSettings) -> None:
    """Spread a large jump of the output's position over :data:`OUTPUT_JUMP_DECAY_S`, by an offset that decays.

    The share of the jump that is spread grows with the jump from zero, so small differences have small effects."""
    x = m.x_output
    for k in range(3):
        jump = x[k] - (m.position_prev[k] + s.dt * x[NOMINAL_VELOCITY + k])
        if m.is_initialised > 0 and abs(jump) > OUTPUT_JUMP_M:
            m.position_jump_remainder[k] -= jump * min(abs(jump) / OUTPUT_JUMP_M - 1.0, 1.0)
        m.position_prev[k] = x[k]
        m.position_jump_remainder[k] -= s.dt / OUTPUT_JUMP_DECAY_S * m.position_jump_remainder[k]
        x[k] += m.position_jump_remainder[k]


@cached_njit(error_model="numpy")
def _write_output_angles(m: FilterMemory) -> None:
    """Write roll, pitch and yaw of the output."""
    w, x, y, z = (
        m.x_output[NOMINAL_ATTITUDE],
        m.x_output[NOMINAL_ATTITUDE + 1],
        m.x_output[NOMINAL_ATTITUDE + 2],
        m.x_output[NOMINAL_ATTITUDE + 3],
    )
    sine = min(max(2 * (w * y - z * x), -1.0), 1.0)
    m.angles_output[0] = portable_atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    m.angles_output[1] = portable_atan2(sine, math.sqrt((1 - sine) * (1 + sine)))
    yaw = portable_atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    m.angles_output[2] = yaw + FULL_TURN_RAD * floor_int((m.angles_output[2] - yaw) / FULL_TURN_RAD + 0.5)


@cached_njit(error_model="numpy")
def _propagate_covariance(m: FilterMemory, s: FilterSettings, r: _Array) -> None:
    """Propagate the covariance of position, velocity and attitude over the delay, F P F^T + Q, in one step."""
    span = m.x_now_span
    for k in range(3):
        m.axis_work[k] = m.now_velocity_change[k] / span
    error_transition(m.inputs_now, span, r, m.axis_work, m.transition_work)
    for i in range(9):
        for j in range(i, 9):
            m.covariance_output[i, j] = 0.0
    for k in range(ERROR_STATE_COUNT):
        propagate_error_column(m.u_transposed[k], span, m.transition_work, m.gain)
        for i in range(9):
            c = m.ud_diagonal[k] * m.gain[i]
            for j in range(i, 9):
                m.covariance_output[i, j] += c * m.gain[j]
    for k in range(3):
        m.covariance_output[k, k] += m.now_added_velocity_variance[k] * span * span / 3.0
        m.covariance_output[k, ERROR_VELOCITY + k] += m.now_added_velocity_variance[k] * span / 2.0
        m.covariance_output[ERROR_VELOCITY + k, ERROR_VELOCITY + k] += m.now_added_velocity_variance[k]
        for i in range(3):
            # The filter integrates the vibration of the accelerometers
            share = r[3 * k + i] * m.inputs_now[INPUT_ACCEL_WEIGHT + i]
            m.covariance_output[ERROR_VELOCITY + k, ERROR_VELOCITY + k] += (
                share * share * m.vibration_velocity_variance[i]
            )
        m.covariance_output[ERROR_ATTITUDE + k, ERROR_ATTITUDE + k] += s.gyro_noise_density * span


@cached_njit(error_model="numpy")
def _write_output_covariance(m: FilterMemory) -> None:
    """Write the output's covariance (attitude as roll, pitch, yaw) and standard deviations (attitude about N, E, D)."""
    for i in range(9):
        for j in range(i):
            m.covariance_output[i, j] = m.covariance_output[j, i]
    for i in range(9, ERROR_STATE_COUNT):
        m.sigma_output[i] = math.sqrt(state_variance(m.u_transposed, m.ud_diagonal, i))
    for i in range(9):
        if i < 3:
            # If the heights of fix and sonar differ, the fix may have the same error in any direction
            m.covariance_output[i, i] += (
                m.position_jump_remainder[i] * m.position_jump_remainder[i]
                + m.fix_sonar_height_difference * m.fix_sonar_height_difference
            )
        m.sigma_output[i] = math.sqrt(m.covariance_output[i, i])
    # Turns about N, E, D to roll, pitch and yaw
    x = m.x_output
    sine = min(
        max(
            2 * (x[NOMINAL_ATTITUDE] * x[NOMINAL_ATTITUDE + 2] - x[NOMINAL_ATTITUDE + 3] * x[NOMINAL_ATTITUDE + 1]),
            -1.0,
        ),
        1.0,
    )
    cosine = max(math.sqrt(1 - sine * sine), 0.05)
    t, c = sine_cosine(m.angles_output[2])
    for j in range(9):
        n_, e_ = m.covariance_output[ERROR_ATTITUDE, j], m.covariance_output[ERROR_ATTITUDE + 1, j]
        m.covariance_output[ERROR_ATTITUDE, j] = (c * n_ + t * e_) / cosine
        m.covariance_output[ERROR_ATTITUDE + 1, j] = -t * n_ + c * e_
        m.covariance_output[ERROR_ATTITUDE + 2, j] += sine / cosine * (c * n_ + t * e_)
    for j in range(9):
        n_, e_ = m.covariance_output[j, ERROR_ATTITUDE], m.covariance_output[j, ERROR_ATTITUDE + 1]
        m.covariance_output[j, ERROR_ATTITUDE] = (c * n_ + t * e_) / cosine
        m.covariance_output[j, ERROR_ATTITUDE + 1] = -t * n_ + c * e_
        m.covariance_output[j, ERROR_ATTITUDE + 2] += sine / cosine * (c * n_ + t * e_)


@cached_njit(error_model="numpy")
def _repropagate_state(m: FilterMemory, s: FilterSettings, r: _Array, a: _Array) -> None:
    """Propagate the state from the horizon towards the present, a limited number of input blocks per call.

    When the present is reached, the result becomes ``m.x_now``.
    """
    for _ in range(s.fusion_budget):
        e = m.input_blocks[m.repropagating_tick // s.block_ticks % INPUT_HISTORY_BLOCKS]
        periods = min(s.block_ticks - m.repropagating_tick % s.block_ticks, m.tick - m.repropagating_tick)
        span = periods * s.dt
        predict_state(m.x_repropagating, e, span, r, a)
        for k in range(3):
            m.repropagating_added_velocity_variance[k] += velocity_noise_density(r, k, e) * span
            m.repropagating_velocity_change[k] += a[k] * span
        m.repropagating_tick += periods
        m.repropagating_span += span
        if m.repropagating_tick == m.tick:
            for k in range(3):
                m.now_added_velocity_variance[k] = m.repropagating_added_velocity_variance[k]
                m.now_velocity_change[k] = m.repropagating_velocity_change[k]
                m.repropagating_added_velocity_variance[k] = m.repropagating_velocity_change[k] = 0.0
            m.x_now_span = m.repropagating_span
            m.repropagating_span = 0.0
            for i in range(STATE_COUNT):
                m.x_now[i] = m.x_repropagating[i]
                m.x_repropagating[i] = m.x[i]
            m.repropagating_tick = m.horizon_tick
            return
    predict_state(m.x_now, m.inputs_now, s.dt, r, a)


@cached_njit(error_model="numpy")
def predict_output(m: FilterMemory, s: FilterSettings, r: _Array, a: _Array) -> None:
    """Write the present state; every :data:`COVARIANCE_INTERVAL_TICKS` periods also its covariance."""
    _repropagate_state(m, s, r, a)
    x = m.x_output
    for i in range(STATE_COUNT):
        x[i] = m.x_now[i]
    much = m.tick % COVARIANCE_INTERVAL_TICKS == 0
    if much:
        _propagate_covariance(m, s, r)
    # The states lag the tick by `imu_lag`: the last rates and acceleration bridge the difference.
    a[2] += GRAVITY
    for k in range(3):
        x[k] += s.imu_lag * (x[NOMINAL_VELOCITY + k] + 0.5 * s.imu_lag * a[k])
        x[NOMINAL_VELOCITY + k] += s.imu_lag * a[k]
        m.rates_output[k] = m.gyro_rates[k] - x[NOMINAL_GYRO_BIAS + k]
        if s.has_rotor_model > 0 and m.flight_phase == PHASE_FLYING:
            m.rates_output[k] += s.imu_lag * m.rotor_model_rows[m.tick % ROTOR_FORCE_HISTORY, ROTOR_ANG_ACCEL + k]
    rotate_attitude(
        x, s.imu_lag * m.rates_output[0], s.imu_lag * m.rates_output[1], s.imu_lag * m.rates_output[2], True
    )
    if s.has_rotor_model > 0 and x[NOMINAL_TERRAIN] < MAX_FLOOR_HEIGHT_M:
        # The legs must not enter the floor during or after the propagation.
        lowest = -(max(x[NOMINAL_TERRAIN], 0.0) + s.ground_clearance)
        if x[NOMINAL_POSITION + 2] >= lowest:
            x[NOMINAL_POSITION + 2] = lowest
            x[NOMINAL_VELOCITY + 2] = min(x[NOMINAL_VELOCITY + 2], 0.0)
    _smooth_output(m, s)
    _write_output_angles(m)
    if much:
        _write_output_covariance(m)
