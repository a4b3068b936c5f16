"""The delayed horizon of the filter: its queue of measurements, its steps, and the division of its work over periods.

The horizon lies ``horizon_delay_ticks`` periods behind now. The delay is the usual latency of the slowest sensor. A
measurement waits in a queue until the horizon reaches the time at which it was taken, so measurements are fused in the
order of their time. A measurement that arrives after the horizon has passed its time is moved to the next end of a
block by velocity and yaw rate.

The horizon moves from the end of one block of averaged inputs to the end of the next. A measurement is fused at the
nearest end of a block (10 ms away at most).

Work is bounded: a period has time for ``fusion_budget`` scalar measurements (:func:`run_next_task`). With more work the
horizon falls behind; from :data:`mufly.estimate.filter.filter_records.MAX_LAG_BLOCKS` blocks on, measurements that are
due are dropped. Each period predicts one bias, in turn. The bias of the fix is predicted when a fix is fused, over the
time since the last one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import floor_int
from mufly.estimate.filter.filter_records import (
    ACCEL_WORK_MODEL,
    BIAS_CYCLE_TICKS,
    ERROR_ATTITUDE,
    ERROR_FIX_BIAS,
    ERROR_FIX_HEADING,
    ERROR_GYRO_BIAS,
    ERROR_TERRAIN,
    ERROR_VELOCITY,
    INPUT_ACCEL,
    INPUT_ACCEL_PER_VELOCITY,
    INPUT_ACCEL_WEIGHT,
    INPUT_FLIGHT_PHASE,
    INPUT_HISTORY_BLOCKS,
    INPUT_NOISE_DENSITY,
    INPUT_THRUST_ACCEL,
    MAX_FLOOR_HEIGHT_M,
    MAX_LAG_BLOCKS,
    MIN_FLOOR_RESET_SIGMA_M,
    NOMINAL_GYRO_BIAS,
    NOMINAL_POSITION,
    NOMINAL_TERRAIN,
    NOMINAL_VELOCITY,
    PHASE_FLYING,
    PHASE_MOTORS_RUNNING,
    PHASE_STANDING,
    QUEUE_SIZE,
    READING_ACCELERATION,
    READING_RATES,
    TERRAIN_EDGE_DURATION_S,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.measurements.fusion import (
    fuse_accel_residual,
    fuse_ground_contact,
    fuse_measurement,
    fuse_zero_motion,
    measurement_cost,
    reset_terrain,
)
from mufly.estimate.filter.measurements.sensor_checks import (
    DIVERGED_GYRO_BIAS_WALK,
    POST_DIVERGENCE_GYRO_BIAS_WALK,
    STATUS_MISSING,
)
from mufly.estimate.filter.output_predictor import FORCE_MEAN_TICKS, velocity_noise_density
from mufly.estimate.filter.strapdown import error_transition, predict_state
from mufly.estimate.filter.ud_filter import gauss_markov_update, inflate_variance, state_variance, ud_time_update

_Array = NDArray[np.float64]

MAX_BACKDATE_S = 0.25
"""Largest time by which a measurement is older than the horizon (s). Velocity and yaw rate move it to the horizon; an
acceleration of 0.3 m/s^2 meanwhile is an error of 1 cm."""
COST_COVARIANCE_OUTPUT, COST_HORIZON_STEP, COST_ZERO_MOTION_AXIS = 3, 2, 3
"""Cost of publishing a covariance, of a step of the horizon, and of an axis on the floor, in scalar measurements."""
STAGE_TERRAIN, STAGE_FORCE_MEANS, STAGE_FORCE_AXES, STAGE_GROUND_CONTACT, STAGE_DONE = 1, 2, 3, 6, 7
"""Stages of the work at the horizon; measurements that wait come first, in the order of their kinds."""
GYRO_OUTAGE_RATE_DENSITY = 0.002
"""Density of the angular rate (rad^2/s) without gyroscopes: the stabiliser bar keeps the rotors level."""
MIN_CROSS_AXIS_YAW_RATE_RAD_S = 0.25
"""Yaw rate (rad/s) above which an axis error of the inertial unit is estimated."""


@cached_njit(error_model="numpy")
def queue_measurement(
    m: FilterMemory, s: FilterSettings, kind: int, at: float, z: _Array, start: int, count: int
) -> bool:
    """Queue a measurement, taken in period ``at``, to be fused when the delayed horizon reaches that period.

    Returns False if the horizon has passed it by more than :data:`MAX_BACKDATE_S`, or the queue is full."""
    due = s.block_ticks * floor_int(at / s.block_ticks + 0.5)
    if due <= m.horizon_tick:
        due = m.horizon_tick + s.block_ticks  # velocity and yaw rate move it to the next end of a block
    ahead = (at - due) * s.dt
    if -ahead > MAX_BACKDATE_S:
        return False
    for i in range(QUEUE_SIZE):
        if m.queue_due[i] < 0:
            m.queue_due[i] = due
            m.queue_sensor[i] = kind
            m.queue_time_in_period[i] = ahead
            for j in range(count):
                m.queue_value[i, j] = z[start + j]
            return True
    return False


@cached_njit(error_model="numpy")
def _inflate_terrain_at_edge(m: FilterMemory, s: FilterSettings, span: float) -> None:
    """Inflate the terrain's variance while the sonar's cone passes over an edge, where the range changes gradually,
    along an arc.
    """
    away = max(-m.x[NOMINAL_POSITION + 2] - m.x[NOMINAL_TERRAIN], 0.1)
    speed = math.sqrt(
        m.x[NOMINAL_VELOCITY] * m.x[NOMINAL_VELOCITY] + m.x[NOMINAL_VELOCITY + 1] * m.x[NOMINAL_VELOCITY + 1]
    )
    arc = s.sonar_cone_edge_excess * away
    passed = span * max(speed / max(s.sonar_cone_radius_ratio * away, 0.05), 1.0 / TERRAIN_EDGE_DURATION_S)
    inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_TERRAIN, arc * arc * passed, m.u_transposed_h)
    m.terrain_edge_weight = max(m.terrain_edge_weight - passed, 0.0)
    if not m.terrain_edge_weight > 0.0:
        m.terrain_steps = 0


@cached_njit(error_model="numpy")
def _advance_horizon(m: FilterMemory, s: FilterSettings, r: _Array, a: _Array) -> None:
    """Propagate the state and covariance at the delayed horizon by one input block."""
    span = s.block_ticks * s.dt
    e = m.input_blocks[m.horizon_tick // s.block_ticks % INPUT_HISTORY_BLOCKS]
    m.horizon_tick += s.block_ticks
    m.task_stage = 0
    predict_state(m.x, e, span, r, a)
    for k in range(3):
        m.accel_mean[k] += e[INPUT_ACCEL + k]
        m.model_accel_mean[k] += a[ACCEL_WORK_MODEL + k]
        m.gyro_mean[k] += e[k]
        m.accel_per_thrust_scale[k] += e[INPUT_THRUST_ACCEL + k]
        m.accel_per_air_velocity[k] += e[INPUT_ACCEL_PER_VELOCITY + k]
    spread = s.gyro_noise_density + (GYRO_OUTAGE_RATE_DENSITY if m.status[READING_RATES] >= STATUS_MISSING else 0.0)
    m.yaw_rate = 0.0
    for k in range(3):
        m.yaw_rate += r[6 + k] * (e[k] - m.x[NOMINAL_GYRO_BIAS + k])
        m.q_work[k] = s.process_variance[k]
        m.q_work[ERROR_VELOCITY + k] = velocity_noise_density(r, k, e) * span
        m.q_work[ERROR_ATTITUDE + k] = spread * span
    error_transition(e, span, r, a, m.transition_work)
    ud_time_update(m.u_transposed, m.ud_diagonal, span, m.transition_work, m.q_work, m.w_work, m.u_transposed_h)
    if m.terrain_edge_weight > 0.0:
        _inflate_terrain_at_edge(m, s, span)
    m.block_mean_ticks += s.block_ticks


@cached_njit(error_model="numpy")
def predict_next_bias(m: FilterMemory, s: FilterSettings) -> None:
    """Predict one bias state per call, the next in a fixed cycle.

    The biases of the position fix are left to :func:`predict_fix_bias`.

    An axis error e of the inertial unit leaks the yaw rate r into the measured rates: e_y r into the roll rate and -e_x
    r into the pitch rate. A scale error leaks r into the yaw rate. At rest the accelerometers show only the sum of e
    and their own bias. In a turn the gyroscope bias contains the leak: its change and its variance follow the yaw rate,
    and both return to their former values when the turn ends.
    """
    k = ERROR_GYRO_BIAS + m.tick % BIAS_CYCLE_TICKS
    if k >= ERROR_FIX_BIAS:
        k += ERROR_FIX_HEADING + 1 - ERROR_FIX_BIAS
    origin, keep, q = s.initial_state[k + 1], s.decay[k], s.process_variance[k]
    if k < ERROR_GYRO_BIAS + 3 and m.divergence_recovery_ticks_left > 0:
        may = DIVERGED_GYRO_BIAS_WALK if m.divergence_recovery_ticks_left > 1 else POST_DIVERGENCE_GYRO_BIAS_WALK
        q += may * may * (BIAS_CYCLE_TICKS * s.dt)
    elif k == ERROR_TERRAIN:
        q *= math.sqrt(
            m.x[NOMINAL_VELOCITY] * m.x[NOMINAL_VELOCITY] + m.x[NOMINAL_VELOCITY + 1] * m.x[NOMINAL_VELOCITY + 1]
        )  # the terrain changes with distance, not with time
    if k < ERROR_GYRO_BIAS + 3:
        i = k - ERROR_GYRO_BIAS
        turning = m.yaw_rate if abs(m.yaw_rate) > MIN_CROSS_AXIS_YAW_RATE_RAD_S else 0.0
        if m.yaw_rate_in_gyro_bias[i] != 0.0:
            keep = turning / m.yaw_rate_in_gyro_bias[i]
            q += m.gyro_bias_at_zero_yaw_rate_variance[i] if turning == 0.0 else 0.0
        else:
            m.gyro_bias_at_zero_yaw_rate[i] = m.x[k + 1]
            m.gyro_bias_at_zero_yaw_rate_variance[i] = state_variance(m.u_transposed, m.ud_diagonal, k)
            q += (s.gyro_axis_variance[i] + m.mount_variance[i]) * (turning * turning)
        origin = m.gyro_bias_at_zero_yaw_rate[i]
        m.yaw_rate_in_gyro_bias[i] = turning
    m.x[k + 1] = origin + (m.x[k + 1] - origin) * keep
    if q > 0.0:
        gauss_markov_update(m.u_transposed, m.ud_diagonal, k, keep, q, m.u_transposed_h)


@cached_njit(error_model="numpy")
def _fuse_next_measurement(m: FilterMemory, s: FilterSettings, r: _Array, left: int) -> int:
    """Fuse the next queued measurement whose time the horizon has reached; return its cost in scalar measurements.

    The cost is 0 if ``left`` is too small, and -1 if no such measurement is queued.
    """
    behind = m.tick - s.horizon_delay_ticks - m.horizon_tick >= MAX_LAG_BLOCKS * s.block_ticks
    i = -1
    for j in range(QUEUE_SIZE if m.task_stage == 0 else 0):
        if m.queue_due[j] == m.horizon_tick:
            if behind:
                m.late_count[m.queue_sensor[j]] += 1
                m.next_beam = 0
                m.queue_due[j] = -1
            elif i < 0 or m.queue_sensor[j] < m.queue_sensor[i]:
                i = j
    if i >= 0:
        cost = measurement_cost(m, s, m.queue_sensor[i], left)
        if cost > left:
            return 0
        if fuse_measurement(m, s, i, r, cost):
            m.queue_due[i] = -1
        return cost
    return -1


@cached_njit(error_model="numpy")
def _average_block_forces(m: FilterMemory, s: FilterSettings) -> None:
    """Average the measured and the modelled specific force since their last comparison."""
    e = m.input_blocks[(m.horizon_tick // s.block_ticks - 1) % INPUT_HISTORY_BLOCKS]
    n = m.block_mean_ticks // s.block_ticks
    for k in range(3):
        m.accel_mean[k] /= n
        m.model_accel_mean[k] /= n
        m.gyro_mean[k] /= n
        m.accel_per_thrust_scale[k] /= n
        m.accel_per_air_velocity[k] /= n
        # Noise density of the difference at the horizon, from the weights used there. The mean of a vibration is the
        # difference of two velocities over the time between them; the lag at least doubles the output's variance.
        share = max(e[INPUT_ACCEL_WEIGHT + k], 1e-9)
        m.accel_residual_density[k] = e[INPUT_NOISE_DENSITY + k] / share / max(1 - share, 1e-9) + (
            m.vibration_velocity_variance[k] / (m.block_mean_ticks * s.dt)
        )


@cached_njit(error_model="numpy")
def clear_block_forces(m: FilterMemory) -> None:
    """Restart the averages of the measured and of the modelled specific force."""
    for k in range(3):
        m.accel_mean[k] = m.model_accel_mean[k] = m.gyro_mean[k] = 0.0
        m.accel_per_thrust_scale[k] = m.accel_per_air_velocity[k] = 0.0
    m.max_accel_model_ratio = 0.0
    m.block_mean_ticks = 0


@cached_njit(error_model="numpy")
def run_next_task(m: FilterMemory, s: FilterSettings, r: _Array, a: _Array, left: int) -> int:
    """Run the next task at the horizon if the remaining work ``left`` of the period suffices; return its cost.

    Such tasks fuse a queued measurement, the mean difference of accelerometers and model, zero motion at rest, or
    ground contact. ``left`` and the cost count scalar measurements; the cost is 0 if no task was run.
    """
    cost = _fuse_next_measurement(m, s, r, left)
    if cost >= 0:
        return cost
    if m.task_stage == 0:
        m.task_stage = STAGE_TERRAIN
    if m.task_stage == STAGE_TERRAIN:
        m.task_stage = STAGE_FORCE_MEANS
        if not m.terrain_edge_weight > 0.0 and abs(m.x[NOMINAL_TERRAIN]) < MAX_FLOOR_HEIGHT_M:
            sure = state_variance(m.u_transposed, m.ud_diagonal, ERROR_TERRAIN)
            if (
                sure > MIN_FLOOR_RESET_SIGMA_M * MIN_FLOOR_RESET_SIGMA_M
                and m.x[NOMINAL_TERRAIN] * m.x[NOMINAL_TERRAIN] < 9.0 * sure
            ):
                reset_terrain(m)
                return 1
    if m.task_stage == STAGE_FORCE_MEANS:
        m.task_stage = STAGE_DONE
        if m.block_mean_ticks >= FORCE_MEAN_TICKS:
            _average_block_forces(m, s)
            m.task_stage = STAGE_FORCE_AXES
    mode = int(m.input_blocks[(m.horizon_tick // s.block_ticks - 1) % INPUT_HISTORY_BLOCKS, INPUT_FLIGHT_PHASE])
    while STAGE_FORCE_AXES <= m.task_stage < STAGE_GROUND_CONTACT:
        i = m.task_stage - STAGE_FORCE_AXES
        cost = 0
        if mode <= PHASE_MOTORS_RUNNING:
            cost = COST_ZERO_MOTION_AXIS
            if cost > left:
                return 0
            fuse_zero_motion(m, s, r, m.block_mean_ticks, mode, i)
            m.standing_ticks += m.block_mean_ticks if mode == PHASE_STANDING and i == 0 else 0
        elif mode == PHASE_FLYING and s.has_rotor_model > 0 and s.is_fitted[READING_ACCELERATION] > 0:
            cost = 1
            fuse_accel_residual(m, s, r, m.block_mean_ticks, i)
        m.task_stage += 1
        if cost > 0:
            return cost
    if m.task_stage == STAGE_GROUND_CONTACT:
        m.task_stage = STAGE_DONE
        cost = 1 if mode > PHASE_MOTORS_RUNNING and fuse_ground_contact(m, s) else 0
        clear_block_forces(m)
        if cost > 0:
            return cost
    if m.horizon_tick + s.block_ticks > m.tick - s.horizon_delay_ticks or left < COST_HORIZON_STEP:
        return 0
    _advance_horizon(m, s, r, a)
    return COST_HORIZON_STEP
