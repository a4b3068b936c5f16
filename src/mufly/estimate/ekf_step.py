"""One period of the filter, compiled: readings in, the state of now out, with a bounded amount of work.

The filter runs ``delay_ticks`` periods behind now, at the *horizon*, as PX4's EKF2 does. The delay is the usual latency
of the slowest sensor. A measurement waits in a queue until the horizon reaches the time at which it was taken, so
measurements are fused in the order of their time. A measurement that comes later than that is moved to the next end of
a block by velocity and yaw rate.

The output is the state of the horizon, propagated to now through the inputs since (:mod:`output_predictor`).

Inputs are averaged over blocks of :data:`mufly.estimate.filter_records.INPUT_BLOCK_S`, and the horizon moves from the
end of one block to the end of the next. A measurement counts at the nearest end of a block (10 ms away at most).

Work is bounded: a period has time for ``work_limit`` scalar measurements (:func:`_run_next_task`). With more work the
horizon falls behind; from :data:`mufly.estimate.filter_records.MAX_LAG_BLOCKS` blocks on, measurements that are due are
dropped. Each period predicts one bias, in turn. The bias of the fix is predicted when a fix is fused, over the time
since the last one.

The inertial unit's filter delays its output by ``lag``: a state belongs to ``lag`` before its tick."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.model_state import (
    RS_ATT,
    RS_BAR,
    RS_CHARGE,
    RS_POS,
    RS_RATES,
    RS_SPEED_LOWER,
    RS_SPEED_UPPER,
    ModelParameters,
)
from mufly.estimate.filter_records import (
    AID_COUNT,
    BIAS_CYCLE_TICKS,
    ERROR_STATE_COUNT,
    EX_ACCEL_BIAS,
    EX_ATT,
    EX_FIX_BIAS,
    EX_FIX_HEADING,
    EX_GYRO_BIAS,
    EX_POS,
    EX_TERRAIN,
    EX_THRUST_SCALE,
    EX_VEL,
    FLOOR_SETTLED_SIGMA,
    IN_ACCEL,
    IN_NOISE,
    IN_PHASE,
    IN_RATES,
    IN_REST,
    IN_SHARE,
    IN_SLOPE,
    IN_STATIC,
    INPUT_BLOCK_COUNT,
    INPUT_ROW_SIZE,
    MAX_FLOOR_HEIGHT,
    MAX_LAG_BLOCKS,
    MODEL_ACCEL,
    PHASE_COASTING,
    PHASE_FLYING,
    PHASE_LIGHT,
    PHASE_RUNNING,
    PHASE_STANDING,
    QUEUE_SIZE,
    QUEUED_READINGS,
    R_ACCELERATION,
    R_BATTERY,
    R_FIX,
    R_RATES,
    R_ROTOR,
    R_SONAR,
    READING_STARTS,
    RF_ANG_ACCEL,
    RF_STATIC,
    ROTOR_FORCE_HISTORY,
    STATE_COUNT,
    SX_ACCEL_BIAS,
    SX_ATT,
    SX_GYRO_BIAS,
    SX_POS,
    SX_TERRAIN,
    SX_THRUST_SCALE,
    SX_VEL,
    SX_WIND,
    TERRAIN_EDGE_S,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.fusion import (
    LEG_CLEARANCE_HEIGHT,
    LIFTOFF_THRUST_SIGMA,
    MIN_TERRAIN_HEIGHT,
    fuse_accel_residual,
    fuse_ground_contact,
    fuse_liftoff_thrust,
    fuse_measurement,
    fuse_zero_motion,
    height_above_ground,
    measurement_cost,
    reset_terrain,
)
from mufly.estimate.output_predictor import (
    COVARIANCE_INTERVAL_TICKS,
    FORCE_MEAN_TICKS,
    predict_output,
    velocity_noise_density,
)
from mufly.estimate.sensor_checks import (
    ACTUATOR_START,
    DIVERGED_BIAS_WALK,
    FORCE_MODEL_WRONG,
    LATER_BIAS_WALK,
    REASON_LATE,
    REASON_LEVELLED,
    REASON_NONE,
    STATUS_FAULTY,
    STATUS_FUSED,
    STATUS_MISSING,
    STATUS_REJECTED,
    battery_voltage_consistent,
    check_readings,
    replace_gyro_spikes,
    rotor_speed_consistent,
    set_fault,
)
from mufly.estimate.strapdown import (
    error_transition,
    predict_rotor_force,
    predict_state,
    predict_terminal_voltage,
    rotation_matrix,
)
from mufly.estimate.ud_filter import gauss_markov_update, inflate_variance, state_variance, ud_time_update
from mufly.numba_cache import cached_njit
from mufly.portable_math import floor_int
from mufly.units import GRAVITY

_Array = NDArray[np.float64]

MAX_BACKDATE_S = 0.25
"""Largest time by which a measurement is older than the horizon (s). Velocity and yaw rate move it to the horizon; an
acceleration of 0.3 m/s^2 meanwhile is an error of 1 cm."""
SLOW_NOISE_TICKS = 32
"""Periods over which low-frequency force noise is estimated."""
COST_COVARIANCE, COST_HORIZON_STEP, COST_REST_AXIS = 3, 2, 3
"""Cost of publishing a covariance, of a step of the horizon, and of an axis on the floor, in scalar measurements."""
STAGE_TERRAIN, STAGE_FORCE_MEANS, STAGE_AXES, STAGE_GROUND_CONTACT, STAGE_DONE = 1, 2, 3, 6, 7
"""Stages of the work at the horizon; measurements that wait come first, in the order of their kinds."""
_INITIAL_REST_S = 0.8
_GYRO_OUTAGE_S = 0.1  # without gyroscopes
GYRO_OUTAGE_DENSITY = 0.002
"""Density of the angular rate (rad^2/s) without gyroscopes: the stabiliser bar keeps the rotors level."""
LEVEL_TIME_S, LEVEL_RATE, LEVEL_GATE = 0.5, 0.1, 3.0
LEAK_RATE = 0.25
"""Yaw rate (rad/s) above which an axis error of the inertial unit is estimated."""
"""Time at rest in which the tilt of the inertial unit is measured (s), largest rate meanwhile (rad/s), and deviations
of the standing tilt beyond which the unit is taken for tilted (1)."""
STOPPED_SPEED_SHARE = 0.02
"""Share of the speeds in hover below which rotors stand. Those that run down with the motors off turn the vehicle."""
LIFTOFF_SIGMA_LIMIT = 2.5
"""Deviations of the thrust scale by which lift-off may come earlier or later than modelled."""
MODELLED_THRUST_SIGMA, THRUST_ERROR_TIME_S = 0.03, 0.02
"""Deviation of the thrust scale without added noise (1); correlation time of larger errors (s)."""
ERROR_TIME_TWICE_S = 0.3
"""Twice the correlation time (s) of an acceleration error; over the filter's delay it changes the velocity."""
CLIPPING_ERROR_SHARE = 0.25
"""Error of the mean of clipping accelerometers over range times share of clipped samples (1); 0.1 to 0.3 is usual."""
GROUND_FORCE_ERROR = 1.0
"""Joint error of rotor and leg forces on the floor (m/s^2)."""
SONAR_LIFTOFF_HEIGHT, LIFTOFF_CLEARANCE = 0.3, 0.015
"""Height (m) up to which the sonar decides about lift-off; excess over its least reading (m) that shows lift-off."""
INITIAL_ACCEL_DENSITY = 5.0
"""Initial density of the accelerometer noise (m^2/s^3), so large that the model has the higher weight."""
MAX_MODEL_DISAGREEMENT = 0.4
"""Largest mean difference of accelerometers and model over 160 ms without added noise (m/s^2). Two standard deviations
of the thrust scale are added to it; the excess counts as accelerometer noise that is correlated over a second."""
WRONG_MODEL_DENSITY = 10.0
"""Density of the force's error (m^2/s^3) while the rotor model contradicts accelerometers and fix."""
_Z = READING_STARTS


@cached_njit(error_model="numpy")
def estimator_reset(m: FilterMemory, s: FilterSettings) -> None:
    """Set the memory to the state at the reset."""
    for i in range(STATE_COUNT):
        m.x[i] = m.x_repropagating[i] = m.x_now[i] = s.initial_state[i]
    for i in range(ERROR_STATE_COUNT):
        m.d[i] = s.initial_sigma[i] * s.initial_sigma[i] + 1e-12
        for j in range(ERROR_STATE_COUNT):
            m.u_transposed[i, j] = 1.0 if i == j else 0.0
    for i in range(QUEUE_SIZE):
        m.queue_due[i] = -1
    for i in range(AID_COUNT):
        m.noise_scale[i] = m.bias_walk_scale[i] = 1.0
    m.task_stage = STAGE_DONE
    m.x_output[SX_ATT] = m.rotor_state[RS_ATT] = m.rotor_state[RS_CHARGE] = 1.0
    m.rotor_state[RS_POS + 2] = -1000.0  # far above the floor
    m.rotor_state[RS_BAR + 2] = -1.0
    for k in range(3):
        m.accel_noise[k] = m.accel_noise_slow[k] = INITIAL_ACCEL_DENSITY


@cached_njit(error_model="numpy")
def _queue_measurement(
    m: FilterMemory, s: FilterSettings, kind: int, at: float, z: _Array, start: int, count: int
) -> bool:
    """Queue a measurement of tick ``at`` until the horizon reaches it.

    Returns False if the horizon has passed it by more than :data:`MAX_BACKDATE_S`, or the queue is full."""
    due = s.block_ticks * floor_int(at / s.block_ticks + 0.5)
    if due <= m.horizon_tick:
        due = m.horizon_tick + s.block_ticks  # by what it moves and turns, the next end of a block will do
    ahead = (at - due) * s.dt
    if -ahead > MAX_BACKDATE_S:
        return False
    for i in range(QUEUE_SIZE):
        if m.queue_due[i] < 0:
            m.queue_due[i] = due
            m.queue_sensor[i] = kind
            m.queue_ahead[i] = ahead
            for j in range(count):
                m.queue_value[i, j] = z[start + j]
            return True
    return False


@cached_njit(error_model="numpy")
def _update_flight_phase(m: FilterMemory, s: FilterSettings, z: _Array) -> float:
    """Update the flight phase from the rotors' lift and the height.

    Returns the model's lift over the weight in the period in which the sonar sees it leave the floor, else 0.
    """
    lift = (
        -m.rotor_force[m.tick % ROTOR_FORCE_HISTORY, RF_STATIC + 2] * m.x[SX_THRUST_SCALE] / GRAVITY
        if s.has_rotor_model > 0
        else 1.0
    )
    height = height_above_ground(m.x_output, s)
    off = z[ACTUATOR_START] + z[ACTUATOR_START + 1] < 0.02
    # Rotors with more lift than modelled leave the floor earlier, others later.
    doubt = LIFTOFF_SIGMA_LIMIT * m.sigma_output[EX_THRUST_SCALE] if s.has_rotor_model > 0 else 0.0
    # The sonar is newer than the estimated height, except below the floor.
    says = m.status[R_SONAR] == STATUS_FUSED and height < SONAR_LIFTOFF_HEIGHT and m.x[SX_TERRAIN] > MIN_TERRAIN_HEIGHT
    near = says and m.last_value[_Z[R_SONAR]] <= s.sonar_min + 0.5 * s.sonar_resolution
    clear = says and m.last_value[_Z[R_SONAR]] > s.sonar_min + LIFTOFF_CLEARANCE
    rises = 0.0
    m.is_sonar_at_minimum = 1 if near else 0
    if m.flight_phase <= PHASE_RUNNING:
        turning = m.rotor_state[RS_SPEED_UPPER] + m.rotor_state[RS_SPEED_LOWER]
        stands = turning <= STOPPED_SPEED_SHARE * (s.hover_speed[0] + s.hover_speed[1])
        m.flight_phase = PHASE_RUNNING if not off else PHASE_STANDING if stands else PHASE_COASTING
        if lift * (1.0 + doubt) > 0.9 and m.flight_phase == PHASE_RUNNING:
            m.flight_phase = PHASE_LIGHT
            m.is_initialised = 1
    elif m.flight_phase == PHASE_LIGHT:
        up = height > 0.03 + min(2.0 * m.sigma_output[EX_POS + 2], 0.1) and not near
        if up or clear or lift > 1.1 + doubt:
            m.flight_phase = PHASE_FLYING
            if says and not near and s.has_rotor_model > 0:
                rises = lift / m.x[SX_THRUST_SCALE]
        elif lift * (1.0 + doubt) < 0.85 and height < 0.02:
            m.flight_phase = PHASE_RUNNING
    elif (height < 0.015 and lift < 0.9 and not clear) or (near and lift < 1.1 + doubt):
        m.flight_phase = PHASE_LIGHT
    if (
        off
        and m.flight_phase >= PHASE_LIGHT
        and height < 0.05
        and m.rotor_state[RS_SPEED_UPPER] < 0.3 * s.hover_speed[0]
    ):
        m.flight_phase = PHASE_RUNNING
    if m.flight_phase != PHASE_FLYING:
        m.grounded_tick = m.tick
    return rises


@cached_njit(error_model="numpy")
def _ground_force_noise(m: FilterMemory, force: float) -> float:
    """Return the density of the force's error on the legs or just off them (m^2/s^3).

    ``force`` is the rotors' force per mass, down (m/s^2). The error shrinks as the rotors lift more or less than the
    weight."""
    spread = (
        GROUND_FORCE_ERROR
        if m.is_sonar_at_minimum == 1
        else max(m.sigma_output[EX_THRUST_SCALE] * -force, GROUND_FORCE_ERROR)
    )
    over = (-m.x_output[SX_THRUST_SCALE] * force - GRAVITY) / spread
    may = min(max(1.0 + over / LIFTOFF_SIGMA_LIMIT, 0.0), 1.0) * spread
    return ERROR_TIME_TWICE_S * may * may


@cached_njit(error_model="numpy")
def _sample_inputs(
    m: FilterMemory, s: FilterSettings, p: ModelParameters, z: _Array, new: NDArray[np.int32], r: _Array
) -> float:
    """Write the row of inputs of the period that has just ended, and average it into its block.

    Returns the same as :func:`_update_flight_phase`."""
    now = m.tick % ROTOR_FORCE_HISTORY
    for j in range(4):
        sent = z[ACTUATOR_START + j]
        m.actuators[j] = min(max(sent, -1.0), 1.0) if sent == sent else 0.0
    rotation_matrix(m.x_output[SX_ATT : SX_ATT + 4], r)
    n, e, d = (
        m.x_output[SX_VEL] - m.x_output[SX_WIND],
        m.x_output[SX_VEL + 1] - m.x_output[SX_WIND + 1],
        m.x_output[SX_VEL + 2],
    )
    for k in range(3):
        m.axis_work[k] = r[k] * n + r[3 + k] * e + r[6 + k] * d
        m.rotor_state[RS_RATES + k] = m.gyro_rates[k] - m.x_output[SX_GYRO_BIAS + k]
    if s.has_rotor_model > 0:
        predict_rotor_force(m, s, p, m.axis_work, m.rotor_force[now])
        for k in range(2):
            m.rotor_state[RS_SPEED_UPPER + k] += s.dt * m.motor_accel_bias[k]
        if new[R_ROTOR] == 1:
            a = _Z[R_ROTOR]
            if rotor_speed_consistent(m, s, z, a):
                for k in range(2):
                    off = z[a + k] - m.rotor_state[RS_SPEED_UPPER + k]
                    m.rotor_state[RS_SPEED_UPPER + k] += s.rotor_speed_gain * off
                    m.motor_accel_bias[k] += s.motor_error_gain * off
        if new[R_BATTERY] == 1:
            off = z[_Z[R_BATTERY]] - predict_terminal_voltage(m, p)
            if battery_voltage_consistent(m, s, off):
                fast = 0.2 if m.tick * s.dt < 1.0 else 0.02
                m.rotor_state[RS_CHARGE] = min(max(m.rotor_state[RS_CHARGE] + fast * off, 0.0), 1.0)
    rises = _update_flight_phase(m, s, z)
    a, b = (now - s.imu_lag_ticks) % ROTOR_FORCE_HISTORY, (now - s.imu_lag_ticks - 1) % ROTOR_FORCE_HISTORY
    row = m.inputs_now
    model = s.has_rotor_model > 0
    for k in range(3):
        row[k] = 0.5 * (m.gyro_rates[k] + m.gyro_rates_prev[k])
        row[IN_ACCEL + k] = z[k]
        for g in range(3):
            row[IN_STATIC + 3 * g + k] = (1 - s.imu_lag_share) * m.rotor_force[
                a, RF_STATIC + 3 * g + k
            ] + s.imu_lag_share * m.rotor_force[b, RF_STATIC + 3 * g + k]
        clip = m.clip_share[k] * CLIPPING_ERROR_SHARE * s.accel_range
        # Without what a shaking leaves; but whose attitude is not known knows the force of the air better.
        noise = m.accel_noise_slow[k] if m.status[R_RATES] < STATUS_MISSING else m.accel_noise[k]
        felt = (
            max(s.accel_density, noise) if s.has_rotor_model > 0 else s.accel_density
        ) + ERROR_TIME_TWICE_S * clip * clip
        made = s.model_accel_density[k]
        if m.flight_phase <= PHASE_RUNNING:
            row[IN_STATIC + k], row[IN_REST + k], row[IN_SLOPE + k] = 0.0, -GRAVITY * r[6 + k], 0.0
            felt, made = 1e6, 1e-3
        elif m.flight_phase == PHASE_LIGHT:
            # Legs may support the weight that the rotors do not: no thrust is estimated.
            row[IN_REST + k] += m.x_output[SX_THRUST_SCALE] * row[IN_STATIC + k]
            if k == 2:
                row[IN_REST + 2] = (
                    -GRAVITY * r[8] if m.is_sonar_at_minimum == 1 else min(row[IN_REST + 2], -GRAVITY * r[8])
                )
            made = 0.05
            if k == 2:
                made += _ground_force_noise(m, row[IN_STATIC + 2])
            row[IN_STATIC + k] = 0.0
        elif model:
            # Until the thrust is known, which takes the delay and more, it flies by the accelerometers.
            unknown = max(m.sigma_output[EX_THRUST_SCALE] - MODELLED_THRUST_SIGMA, 0.0) * row[IN_STATIC + k]
            made += THRUST_ERROR_TIME_S * unknown * unknown
        if not model and m.flight_phase > PHASE_RUNNING:
            row[IN_STATIC + k], row[IN_REST + k], row[IN_SLOPE + k] = 0.0, -GRAVITY if k == 2 else 0.0, 0.0
            made = 10.0
        if m.force_verdict == FORCE_MODEL_WRONG:
            made = max(made, WRONG_MODEL_DENSITY)
        elif m.is_accel_distrusted == 1:
            felt = 1e6
        if m.status[R_ACCELERATION] >= STATUS_MISSING or s.is_fitted[R_ACCELERATION] == 0:
            felt = 1e6
        share = made / (felt + made)
        row[IN_SHARE + k] = share
        row[IN_NOISE + k] = felt * share
    row[IN_PHASE] = m.flight_phase
    # Mean over the block so far
    into = m.input_blocks[(m.tick - 1) // s.block_ticks % INPUT_BLOCK_COUNT]
    share = 1.0 / ((m.tick - 1) % s.block_ticks + 1)
    for j in range(INPUT_ROW_SIZE - 1):
        into[j] = row[j] if share == 1.0 else into[j] + share * (row[j] - into[j])
    into[IN_PHASE] = m.flight_phase
    return rises


@cached_njit(error_model="numpy")
def _pass_terrain_edge(m: FilterMemory, s: FilterSettings, span: float) -> None:
    """Inflate the terrain's variance while the sonar's cone passes over an edge: the nearest point moves along an
    arc."""
    away = max(-m.x[SX_POS + 2] - m.x[SX_TERRAIN], 0.1)
    speed = math.sqrt(m.x[SX_VEL] * m.x[SX_VEL] + m.x[SX_VEL + 1] * m.x[SX_VEL + 1])
    arc = s.sonar_arc * away
    passed = span * max(speed / max(s.sonar_cone_slope * away, 0.05), 1.0 / TERRAIN_EDGE_S)
    inflate_variance(m.u_transposed, m.d, EX_TERRAIN, arc * arc * passed, m.f)
    m.terrain_edge_weight = max(m.terrain_edge_weight - passed, 0.0)
    if not m.terrain_edge_weight > 0.0:
        m.terrain_steps = 0


@cached_njit(error_model="numpy")
def _advance_horizon(m: FilterMemory, s: FilterSettings, r: _Array, a: _Array) -> None:
    """Advance the horizon by a block: state and covariance."""
    span = s.block_ticks * s.dt
    e = m.input_blocks[m.horizon_tick // s.block_ticks % INPUT_BLOCK_COUNT]
    m.horizon_tick += s.block_ticks
    m.task_stage = 0
    predict_state(m.x, e, span, r, a)
    for k in range(3):
        m.accel_mean[k] += e[IN_ACCEL + k]
        m.model_accel_mean[k] += a[MODEL_ACCEL + k]
        m.gyro_mean[k] += e[k]
        m.thrust_slope[k] += e[IN_STATIC + k]
        m.velocity_slope[k] += e[IN_SLOPE + k]
    spread = s.gyro_density + (GYRO_OUTAGE_DENSITY if m.status[R_RATES] >= STATUS_MISSING else 0.0)
    m.yaw_rate = 0.0
    for k in range(3):
        m.yaw_rate += r[6 + k] * (e[k] - m.x[SX_GYRO_BIAS + k])
        m.q_work[k] = s.process_variance[k]
        m.q_work[EX_VEL + k] = velocity_noise_density(r, k, e) * span
        m.q_work[EX_ATT + k] = spread * span
    error_transition(e, span, r, a, m.transition_work)
    ud_time_update(m.u_transposed, m.d, span, m.transition_work, m.q_work, m.w_work, m.f)
    if m.terrain_edge_weight > 0.0:
        _pass_terrain_edge(m, s, span)
    m.block_mean_ticks += s.block_ticks


@cached_njit(error_model="numpy")
def _predict_bias(m: FilterMemory, s: FilterSettings) -> None:
    """Predict one bias in cyclic order; those of the fix are predicted when a fix is fused.

    An axis error e of the inertial unit leaks the yaw rate r into the measured rates: e_y r into that of roll, -e_x r
    into that of pitch, and a scale error into that of yaw. Accelerometers at rest tell e and their own bias only
    together. In a turn the bias of the gyroscopes carries the leak: its deviation and its variance follow the yaw rate
    and return to their values when the turn ends."""
    k = EX_GYRO_BIAS + m.tick % BIAS_CYCLE_TICKS
    if k >= EX_FIX_BIAS:
        k += EX_FIX_HEADING + 1 - EX_FIX_BIAS
    origin, keep, q = s.initial_state[k + 1], s.decay[k], s.process_variance[k]
    if k < EX_GYRO_BIAS + 3 and m.divergence_ticks > 0:
        may = DIVERGED_BIAS_WALK if m.divergence_ticks > 1 else LATER_BIAS_WALK
        q += may * may * (BIAS_CYCLE_TICKS * s.dt)
    elif k == EX_TERRAIN:
        q *= math.sqrt(
            m.x[SX_VEL] * m.x[SX_VEL] + m.x[SX_VEL + 1] * m.x[SX_VEL + 1]
        )  # another floor lies elsewhere, not later
    if k < EX_GYRO_BIAS + 3:
        i = k - EX_GYRO_BIAS
        turning = m.yaw_rate if abs(m.yaw_rate) > LEAK_RATE else 0.0
        if m.leaked_yaw_rate[i] != 0.0:
            keep = turning / m.leaked_yaw_rate[i]
            q += m.leak_origin_variance[i] if turning == 0.0 else 0.0
        else:
            m.leak_origin[i] = m.x[k + 1]
            m.leak_origin_variance[i] = state_variance(m.u_transposed, m.d, k)
            q += (s.gyro_axis_variance[i] + m.mount_variance[i]) * (turning * turning)
        origin = m.leak_origin[i]
        m.leaked_yaw_rate[i] = turning
    m.x[k + 1] = origin + (m.x[k + 1] - origin) * keep
    if q > 0.0:
        gauss_markov_update(m.u_transposed, m.d, k, keep, q, m.f)


@cached_njit(error_model="numpy")
def _fuse_next_measurement(m: FilterMemory, s: FilterSettings, r: _Array, left: int) -> int:
    """Fuse the next queued measurement of the horizon; return its cost, 0 without time for it, -1 without any."""
    behind = m.tick - s.delay_ticks - m.horizon_tick >= MAX_LAG_BLOCKS * s.block_ticks
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
    """Average accelerometers and model since the last comparison."""
    e = m.input_blocks[(m.horizon_tick // s.block_ticks - 1) % INPUT_BLOCK_COUNT]
    n = m.block_mean_ticks // s.block_ticks
    for k in range(3):
        m.accel_mean[k] /= n
        m.model_accel_mean[k] /= n
        m.gyro_mean[k] /= n
        m.thrust_slope[k] /= n
        m.velocity_slope[k] /= n
        # Density of the whole difference at the horizon, from what was weighed there
        share = max(e[IN_SHARE + k], 1e-9)
        m.residual_density[k] = e[IN_NOISE + k] / share / max(1 - share, 1e-9) + m.accel_noise[k]


@cached_njit(error_model="numpy")
def _clear_block_forces(m: FilterMemory) -> None:
    """Start new means of accelerometers and model."""
    for k in range(3):
        m.accel_mean[k] = m.model_accel_mean[k] = m.gyro_mean[k] = 0.0
        m.thrust_slope[k] = m.velocity_slope[k] = 0.0
    m.residual_ratio = 0.0
    m.block_mean_ticks = 0


@cached_njit(error_model="numpy")
def _run_next_task(m: FilterMemory, s: FilterSettings, r: _Array, a: _Array, left: int) -> int:
    """Run the next task at the horizon if it costs no more than ``left``; return its cost, 0 if none was run."""
    cost = _fuse_next_measurement(m, s, r, left)
    if cost >= 0:
        return cost
    if m.task_stage == 0:
        m.task_stage = STAGE_TERRAIN
    if m.task_stage == STAGE_TERRAIN:
        m.task_stage = STAGE_FORCE_MEANS
        if not m.terrain_edge_weight > 0.0 and abs(m.x[SX_TERRAIN]) < MAX_FLOOR_HEIGHT:
            sure = state_variance(m.u_transposed, m.d, EX_TERRAIN)
            if sure > FLOOR_SETTLED_SIGMA * FLOOR_SETTLED_SIGMA and m.x[SX_TERRAIN] * m.x[SX_TERRAIN] < 9.0 * sure:
                reset_terrain(m)
                return 1
    if m.task_stage == STAGE_FORCE_MEANS:
        m.task_stage = STAGE_DONE
        if m.block_mean_ticks >= FORCE_MEAN_TICKS:
            _average_block_forces(m, s)
            m.task_stage = STAGE_AXES
    mode = int(m.input_blocks[(m.horizon_tick // s.block_ticks - 1) % INPUT_BLOCK_COUNT, IN_PHASE])
    while STAGE_AXES <= m.task_stage < STAGE_GROUND_CONTACT:
        i = m.task_stage - STAGE_AXES
        cost = 0
        if mode <= PHASE_RUNNING:
            cost = COST_REST_AXIS
            if cost > left:
                return 0
            fuse_zero_motion(m, s, r, m.block_mean_ticks, mode, i)
            m.standing_ticks += m.block_mean_ticks if mode == PHASE_STANDING and i == 0 else 0
        elif mode == PHASE_FLYING and s.has_rotor_model > 0 and s.is_fitted[R_ACCELERATION] > 0:
            cost = 1
            fuse_accel_residual(m, s, r, m.block_mean_ticks, i)
        m.task_stage += 1
        if cost > 0:
            return cost
    if m.task_stage == STAGE_GROUND_CONTACT:
        m.task_stage = STAGE_DONE
        cost = 1 if mode > PHASE_RUNNING and fuse_ground_contact(m, s) else 0
        _clear_block_forces(m)
        if cost > 0:
            return cost
    if m.horizon_tick + s.block_ticks > m.tick - s.delay_ticks or left < COST_HORIZON_STEP:
        return 0
    _advance_horizon(m, s, r, a)
    return COST_HORIZON_STEP


@cached_njit(error_model="numpy")
def _backdate_accel_noise(m: FilterMemory, s: FilterSettings, k: int) -> None:
    """Apply the new noise of an accelerometer to buffered inputs that the horizon has not reached."""
    for at in range(m.horizon_tick, m.tick, s.block_ticks):
        e = m.input_blocks[at // s.block_ticks % INPUT_BLOCK_COUNT]
        share = max(e[IN_SHARE + k], 1e-9)
        felt = max(e[IN_NOISE + k] / share, m.accel_noise_slow[k])
        made = e[IN_NOISE + k] / max(1.0 - share, 1e-9)
        e[IN_SHARE + k] = made / (felt + made)
        e[IN_NOISE + k] = felt * e[IN_SHARE + k]


@cached_njit(error_model="numpy")
def _estimate_accel_noise(m: FilterMemory, s: FilterSettings, z: _Array) -> None:
    """Estimate the noise of accelerometers less model from means over short and over long blocks.

    Short means hold what vibration leaves in the velocity; the triangular weights of the long ones suppress vibration.
    """
    row = m.inputs_now
    m.accel_noise_count += 1
    m.slow_count += 1
    weight = m.slow_count if m.slow_count <= SLOW_NOISE_TICKS // 2 else SLOW_NOISE_TICKS + 1 - m.slow_count
    for k in range(3):
        off = z[k] - (m.x[SX_THRUST_SCALE] * row[IN_STATIC + k] + row[IN_REST + k])
        m.accel_noise_sum[k] += off
        m.slow_sum[k] += weight * (off - row[IN_SLOPE + k] * m.axis_work[k])
    if m.slow_count >= SLOW_NOISE_TICKS:
        half = float(SLOW_NOISE_TICKS // 2)
        span = 0.75 * SLOW_NOISE_TICKS * s.dt
        # Off the floor the model has another force, and the thrust's scale is found.
        settled = m.flight_phase != PHASE_FLYING or m.tick - m.grounded_tick > 2 * SLOW_NOISE_TICKS
        for k in range(3):
            mean = m.slow_sum[k] / (half * (half + 1.0))
            # What the model may be off by, at lift-off by much, is not the accelerometers'.
            unknown = 2.0 * m.sigma_output[EX_THRUST_SCALE] * abs(row[IN_STATIC + k])
            step = max(abs(mean - m.slow_mean_prev[k]) - unknown, 0.0)
            made = row[IN_NOISE + k] / max(1.0 - row[IN_SHARE + k], 1e-9)
            density = max(0.5 * step * step * span - made, 0.0)
            if m.flight_phase == PHASE_FLYING and settled:
                unknown += 2.0 * m.sigma_output[EX_ACCEL_BIAS + k]
                apart = abs(mean - m.x[SX_ACCEL_BIAS + k]) - (MAX_MODEL_DISAGREEMENT + unknown)
                density += max(apart, 0.0) * max(apart, 0.0)
                if apart > (m.clip_share[0] + m.clip_share[1] + m.clip_share[2]) * CLIPPING_ERROR_SHARE * s.accel_range:
                    m.force_apart_tick = m.tick
            density = min(density, 100.0)
            most = max(0.6 if density > m.accel_noise_slow[k] else 0.2, 1.0 / (m.slow_mean_count + 1))
            m.slow_mean_prev[k] = mean
            m.slow_sum[k] = 0.0
            if settled:
                m.accel_noise_slow[k] += most * (density - m.accel_noise_slow[k])
                if density > made:
                    _backdate_accel_noise(m, s, k)
        m.slow_count = 0
        m.slow_mean_count += 1
        if m.status[R_ACCELERATION] == STATUS_REJECTED and m.tick >= m.fault_until_tick[R_ACCELERATION]:
            m.status[R_ACCELERATION], m.reason[R_ACCELERATION] = STATUS_FUSED, REASON_NONE
    if m.accel_noise_count >= FORCE_MEAN_TICKS:
        span = m.accel_noise_count * s.dt
        for k in range(3):
            mean = m.accel_noise_sum[k] / m.accel_noise_count
            step = mean - m.accel_noise_mean[k]
            m.accel_noise_mean[k] = mean
            density = max(0.5 * step * step * span - s.model_accel_density[k], 0.0)
            density = min(density, 100.0)
            m.accel_noise[k] += (0.2 if density > m.accel_noise[k] else 0.05) * (density - m.accel_noise[k])
            m.accel_noise_sum[k] = 0.0
        m.accel_noise_count = 0


@cached_njit(error_model="numpy")
def _turn_level(m: FilterMemory, v: _Array, start: int) -> None:
    """Turn the two vectors from ``start`` on from the axes of a tilted inertial unit to those of the vehicle."""
    r = m.level_rotation
    for i in (start, start + 3):
        x, y, z = v[i], v[i + 1], v[i + 2]
        for k in range(3):
            v[i + k] = r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z


@cached_njit(error_model="numpy")
def _restart_level(m: FilterMemory, s: FilterSettings) -> None:
    """Turn the inputs since the horizon level, and begin anew with level attitude and no bias of the accelerometers."""
    for b in range(INPUT_BLOCK_COUNT):
        _turn_level(m, m.input_blocks[b], IN_RATES)
    _clear_block_forces(m)
    m.task_stage = STAGE_DONE
    for x in (m.x, m.x_repropagating, m.x_now, m.x_output):
        turn = math.sqrt(x[SX_ATT] * x[SX_ATT] + x[SX_ATT + 3] * x[SX_ATT + 3])
        x[SX_ATT] /= turn
        x[SX_ATT + 3] /= turn
        x[SX_ATT + 1] = x[SX_ATT + 2] = 0.0
        for k in range(3):
            x[SX_ACCEL_BIAS + k] = 0.0
    for k in range(3):
        tilt, bias = s.initial_sigma[EX_ATT + k], s.initial_sigma[EX_ACCEL_BIAS + k]
        if k < 2:
            inflate_variance(m.u_transposed, m.d, EX_ATT + k, tilt * tilt, m.f)
        inflate_variance(m.u_transposed, m.d, EX_ACCEL_BIAS + k, bias * bias, m.f)


@cached_njit(error_model="numpy")
def _decide_level(m: FilterMemory, s: FilterSettings) -> None:
    """Decide by the accelerometers' sum at rest whether the inertial unit is tilted, and begin anew if it is.

    The smallest rotation that turns a / |a| to (0, 0, -1) has the axis (-a_y, a_x, 0) and the cosine -a_z / |a|."""
    x, y, d = m.level_sum[0], m.level_sum[1], m.level_sum[2]
    size = math.sqrt(x * x + y * y + d * d)
    x, y, d = -y / size, x / size, -d / size
    tilt = s.initial_sigma[EX_ACCEL_BIAS] / GRAVITY
    q = x * x + y * y
    m.mount_variance[0] = m.mount_variance[1] = 0.5 * q  # the tilt may be a bias, a lean or the unit's
    if q > LEVEL_GATE * LEVEL_GATE * (s.rest_tilt_sigma * s.rest_tilt_sigma + tilt * tilt) and d > 0.875:
        half = math.sqrt(0.5 * d + 0.5)
        turn = np.array((half, 0.5 * x / half, 0.5 * y / half, 0.0))
        rotation_matrix(turn, m.level_rotation)
        m.is_levelled = 1
        _restart_level(m, s)
        set_fault(m, s, R_ACCELERATION, STATUS_FUSED, REASON_LEVELLED, math.sqrt(q))


@cached_njit(error_model="numpy")
def _level_inertial_unit(m: FilterMemory, s: FilterSettings, z: _Array) -> None:
    """Measure the tilt of the inertial unit at rest before the first flight, and turn its readings level.

    The vehicle stands level but for ``rest_tilt_sigma``. A specific force that is tilted by more than legs and bias
    explain shows a tilted unit, whose attitude would err by twice the tilt after half a turn about the mast."""
    needed = int(LEVEL_TIME_S / s.dt)
    if m.level_ticks < needed:
        still = m.flight_phase == PHASE_STANDING and m.status[R_ACCELERATION] == STATUS_FUSED
        for k in range(3):
            still = still and abs(z[_Z[R_RATES] + k]) < LEVEL_RATE
        if m.flight_phase > PHASE_STANDING or s.has_rotor_model == 0:
            m.level_ticks = needed
        elif not still:
            m.level_ticks = 0
            m.level_sum[0] = m.level_sum[1] = m.level_sum[2] = 0.0
        else:
            m.level_ticks += 1
            for k in range(3):
                m.level_sum[k] += z[_Z[R_ACCELERATION] + k]
            if m.level_ticks == needed:
                _decide_level(m, s)
    if m.is_levelled == 1:
        _turn_level(m, z, _Z[R_ACCELERATION])


@cached_njit(error_model="numpy")
def estimator_step(
    m: FilterMemory, s: FilterSettings, p: ModelParameters, z: _Array, new: NDArray[np.int32], age: _Array
) -> bool:
    """Run one period of the filter.

    Parameters
    ----------
    m, s, p : records
        Memory, settings, parameters of the flight model.
    z : (n,) array
        Readings, in the order of :data:`mufly.quantities.CHECKED_READINGS`, then what acted (4) and the share
        of clipped samples (3).
    new : (9,) array of int
        0: nothing new; 1: a new reading; 2: a reading marked invalid by its sensor.
    age : (9,) array
        Age of each reading (s).
    age : (9,) array
        Of each (s).
    """
    m.tick += 1
    check_readings(m, s, z, new, age)
    _level_inertial_unit(m, s, z)
    r, a = m.rotation_work, m.accel_work
    for k in range(3):
        m.gyro_rates_prev[k] = m.gyro_rates[k]
        if m.status[R_RATES] < STATUS_MISSING:
            m.gyro_rates[k] = z[_Z[R_RATES] + k] - m.gyro_offset[k]
        elif s.has_rotor_model > 0 and m.flight_phase >= PHASE_LIGHT:
            # What the model turns: the bar holds it to the rotors, so it does not drift but about the mast.
            m.gyro_rates[k] = (
                m.gyro_rates_prev[k]
                + s.dt * m.rotor_force[(m.tick - 1) % ROTOR_FORCE_HISTORY, RF_ANG_ACCEL + k]
                + m.ang_accel_bias[k]
            )
        else:
            m.gyro_rates[k] = m.x_output[SX_GYRO_BIAS + k]
    # A floor below the room's, or a fix that is apart from the sonar: the height is off by as much
    doubt = m.fix_height_gap - min(m.x_output[SX_TERRAIN], 0.0)
    replace_gyro_spikes(
        m,
        s,
        m.flight_phase == PHASE_FLYING and height_above_ground(m.x_output, s) > LEG_CLEARANCE_HEIGHT + doubt,
    )
    rises = _sample_inputs(m, s, p, z, new, r)
    if s.has_rotor_model > 0 and m.flight_phase >= PHASE_RUNNING and m.status[R_ACCELERATION] < STATUS_MISSING:
        _estimate_accel_noise(m, s, z)
    for kind in QUEUED_READINGS:
        if new[kind] != 1 or m.is_decimated[kind] > 0:
            continue
        # The state of tick k belongs to k dt - lag.
        at = m.tick + (s.imu_lag - age[kind]) / s.dt
        if not _queue_measurement(
            m, s, kind, at, z, READING_STARTS[kind], READING_STARTS[kind + 1] - READING_STARTS[kind]
        ):
            m.late_count[kind] += 1
            # One alone is no fault: jitter has a longer tail than the horizon waits for.
            if (m.tick - m.last_fused_tick[kind]) * s.dt > s.timeout[kind]:
                set_fault(m, s, kind, STATUS_FAULTY, REASON_LATE, age[kind])
    left = s.work_limit - (COST_COVARIANCE if m.tick % COVARIANCE_INTERVAL_TICKS == 0 else 0)
    _predict_bias(m, s)
    if rises > 0.0 and m.sigma_output[EX_THRUST_SCALE] > LIFTOFF_THRUST_SIGMA:
        fuse_liftoff_thrust(m, rises)
        left -= 1
    while left > 0:
        cost = _run_next_task(m, s, r, a, left)
        if cost == 0:
            break
        left -= cost
    predict_output(m, s, r, a)
    found = s.is_fitted[R_FIX] == 0 or m.is_heading_aligned > 0
    if m.is_initialised == 0 and found and (m.standing_ticks * s.dt >= _INITIAL_REST_S or m.tick * s.dt > 3.0):
        m.is_initialised = 1
    turns = s.has_rotor_model > 0 and m.flight_phase >= PHASE_LIGHT
    seen = m.status[R_RATES] < STATUS_MISSING or turns or (m.tick - m.last_fused_tick[R_RATES]) * s.dt < _GYRO_OUTAGE_S
    for k in range(3):
        # Invalid inputs may make the model diverge: rates beyond the gyroscopes' range are no estimate.
        if not abs(m.rates_output[k]) < 2.0 * s.value_limit[R_RATES]:
            seen = False
    if m.is_levelled == 1:
        for k in range(_Z[R_ACCELERATION], _Z[R_RATES] + 3):
            z[k] = m.last_value[k]
    return m.is_initialised > 0 and seen
