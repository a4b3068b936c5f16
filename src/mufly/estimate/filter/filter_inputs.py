"""Inputs of the filter from the readings of a period: rates and accelerations, the rotors' force, and their noise.

Inputs are averaged over blocks of :data:`mufly.estimate.filter.filter_records.INPUT_BLOCK_S`. The flight phase decides
which force model holds: legs on the floor, or rotors alone. The difference of accelerometers and force model gives the
noise of the accelerometers. At rest, the specific force shows the tilt of the inertial unit."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import MODEL_CHARGE, MODEL_RATES, MODEL_SPEED_LOWER, MODEL_SPEED_UPPER, ModelParameters
from mufly.estimate.filter.filter_horizon import STAGE_DONE, clear_block_forces
from mufly.estimate.filter.filter_records import (
    ERROR_ACCEL_BIAS,
    ERROR_ATTITUDE,
    ERROR_POSITION,
    ERROR_THRUST_SCALE,
    INPUT_ACCEL,
    INPUT_ACCEL_PER_VELOCITY,
    INPUT_ACCEL_WEIGHT,
    INPUT_FLIGHT_PHASE,
    INPUT_HISTORY_BLOCKS,
    INPUT_NOISE_DENSITY,
    INPUT_NON_THRUST_ACCEL,
    INPUT_RATES,
    INPUT_ROW_SIZE,
    INPUT_THRUST_ACCEL,
    NOMINAL_ACCEL_BIAS,
    NOMINAL_ATTITUDE,
    NOMINAL_GYRO_BIAS,
    NOMINAL_TERRAIN,
    NOMINAL_THRUST_SCALE,
    NOMINAL_VELOCITY,
    NOMINAL_WIND,
    PHASE_FLYING,
    PHASE_LIFTING_OFF,
    PHASE_MOTORS_RUNNING,
    PHASE_ROTORS_COASTING,
    PHASE_STANDING,
    READING_ACCELERATION,
    READING_BATTERY,
    READING_RATES,
    READING_ROTOR_SPEED,
    READING_SONAR,
    READING_STARTS,
    ROTOR_FORCE_HISTORY,
    ROTOR_THRUST_ACCEL,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.measurements.fusion import MIN_TERRAIN_HEIGHT_M, height_above_ground
from mufly.estimate.filter.measurements.sensor_checks import (
    ACTUATOR_START,
    DIAGNOSIS_MODEL_WRONG,
    REASON_LEVELLED,
    REASON_NONE,
    STATUS_FUSED,
    STATUS_MISSING,
    STATUS_REJECTED,
    check_battery_voltage,
    check_rotor_speed,
    set_fault,
)
from mufly.estimate.filter.output_predictor import FORCE_MEAN_TICKS
from mufly.estimate.filter.strapdown import predict_rotor_force, predict_terminal_voltage, rotation_matrix
from mufly.estimate.filter.ud_filter import inflate_variance
from mufly.quantities.units import GRAVITY

_Array = NDArray[np.float64]

SLOW_NOISE_WINDOW_TICKS = 32
"""Periods over which low-frequency force noise is estimated."""
VIBRATION_HIGH_PASS_S, VIBRATION_VARIANCE_GAIN = 0.04, 0.002
"""Time constant of the high pass that separates the velocity of vibration from other errors (s), some revolutions of
the rotors; gain of its mean square per period (1). A fast gain would take a fault of the accelerometers for vibration.
"""
LEVELLING_REST_S, LEVELLING_MAX_RATE_RAD_S, LEVELLING_GATE_SIGMAS = 0.5, 0.1, 3.0
"""Time at rest in which the tilt of the inertial unit is measured (s), largest rate meanwhile (rad/s), and deviations
of the standing tilt beyond which the unit is taken for tilted (1)."""
STOPPED_ROTOR_SPEED_FRACTION = 0.02
"""Fraction of the hover speeds below which rotors stand. Those that run down with the motors off turn the vehicle."""
LIFTOFF_THRUST_SIGMA_LIMIT = 2.5
"""Deviations of the thrust scale by which lift-off may come earlier or later than modelled."""
MODELLED_THRUST_SIGMA, THRUST_ERROR_CORRELATION_S = 0.03, 0.02
"""Deviation of the thrust scale without added noise (1); correlation time of larger errors (s)."""
TWICE_ACCEL_ERROR_CORRELATION_S = 0.3
"""Twice the correlation time (s) of an acceleration error; over the filter's delay it changes the velocity."""
CLIPPING_ERROR_FRACTION = 0.25
"""Error of the mean of clipping accelerometers over range times fraction of clipped samples; 0.1 to 0.3 is usual."""
GROUND_FORCE_ERROR_M_S2 = 1.0
"""Joint error of rotor and leg forces on the floor (m/s^2)."""
MAX_SONAR_LIFTOFF_HEIGHT_M, SONAR_LIFTOFF_EXCESS_M = 0.3, 0.015
"""Height (m) up to which the sonar decides about lift-off; excess over its least reading (m) that shows lift-off."""
MAX_MODEL_DISAGREEMENT_M_S2 = 0.4
"""Largest mean difference of accelerometers and model over 160 ms without added noise (m/s^2). Two standard deviations
of the thrust scale are added to it; the excess counts as accelerometer noise that is correlated over a second."""
WRONG_MODEL_NOISE_DENSITY = 10.0
"""Density of the force's error (m^2/s^3) while the rotor model contradicts accelerometers and fix."""


@cached_njit(error_model="numpy")
def _update_flight_phase(m: FilterMemory, s: FilterSettings, z: _Array) -> float:
    """Update the flight phase from the rotors' lift and the height.

    Returns the ratio of the model's lift to the weight in the period in which the sonar detects lift-off, else 0.
    """
    lift = (
        -m.rotor_model_rows[m.tick % ROTOR_FORCE_HISTORY, ROTOR_THRUST_ACCEL + 2] * m.x[NOMINAL_THRUST_SCALE] / GRAVITY
        if s.has_rotor_model > 0
        else 1.0
    )
    height = height_above_ground(m.x_output, s)
    off = z[ACTUATOR_START] + z[ACTUATOR_START + 1] < 0.02
    # Rotors with more lift than modelled leave the floor earlier, others later.
    doubt = LIFTOFF_THRUST_SIGMA_LIMIT * m.sigma_output[ERROR_THRUST_SCALE] if s.has_rotor_model > 0 else 0.0
    # The sonar is newer than the estimated height, except below the floor.
    says = (
        m.status[READING_SONAR] == STATUS_FUSED
        and height < MAX_SONAR_LIFTOFF_HEIGHT_M
        and m.x[NOMINAL_TERRAIN] > MIN_TERRAIN_HEIGHT_M
    )
    near = (
        says and m.last_value[READING_STARTS[READING_SONAR]] <= m.sonar_effective_min_range + 0.5 * s.sonar_resolution
    )
    clear = says and m.last_value[READING_STARTS[READING_SONAR]] > m.sonar_effective_min_range + SONAR_LIFTOFF_EXCESS_M
    rises = 0.0
    m.is_sonar_at_minimum = 1 if near else 0
    if m.flight_phase <= PHASE_MOTORS_RUNNING:
        turning = m.flight_model_state[MODEL_SPEED_UPPER] + m.flight_model_state[MODEL_SPEED_LOWER]
        stands = turning <= STOPPED_ROTOR_SPEED_FRACTION * (s.hover_speed[0] + s.hover_speed[1])
        m.flight_phase = PHASE_MOTORS_RUNNING if not off else PHASE_STANDING if stands else PHASE_ROTORS_COASTING
        if lift * (1.0 + doubt) > 0.9 and m.flight_phase == PHASE_MOTORS_RUNNING:
            m.flight_phase = PHASE_LIFTING_OFF
            m.is_initialised = 1
    elif m.flight_phase == PHASE_LIFTING_OFF:
        up = height > 0.03 + min(2.0 * m.sigma_output[ERROR_POSITION + 2], 0.1) and not near
        if up or clear or lift > 1.1 + doubt:
            m.flight_phase = PHASE_FLYING
            if says and not near and s.has_rotor_model > 0:
                rises = lift / m.x[NOMINAL_THRUST_SCALE]
        elif lift * (1.0 + doubt) < 0.85 and height < 0.02:
            m.flight_phase = PHASE_MOTORS_RUNNING
    elif (height < 0.015 and lift < 0.9 and not clear) or (near and lift < 1.1 + doubt):
        m.flight_phase = PHASE_LIFTING_OFF
    if (
        off
        and m.flight_phase >= PHASE_LIFTING_OFF
        and height < 0.05
        and m.flight_model_state[MODEL_SPEED_UPPER] < 0.3 * s.hover_speed[0]
    ):
        m.flight_phase = PHASE_MOTORS_RUNNING
    if m.flight_phase != PHASE_FLYING:
        m.last_grounded_tick = m.tick
    return rises


@cached_njit(error_model="numpy")
def _ground_force_noise(m: FilterMemory, force: float) -> float:
    """Return the noise density (m^2/s^3) of the floor's force on the legs, on the floor or just above it.

    ``force`` is the rotors' force per mass, down (m/s^2). The density is largest if the lift equals or exceeds the
    weight, and falls to zero as the lift falls below the weight.
    """
    spread = (
        GROUND_FORCE_ERROR_M_S2
        if m.is_sonar_at_minimum == 1
        else max(m.sigma_output[ERROR_THRUST_SCALE] * -force, GROUND_FORCE_ERROR_M_S2)
    )
    over = (-m.x_output[NOMINAL_THRUST_SCALE] * force - GRAVITY) / spread
    may = min(max(1.0 + over / LIFTOFF_THRUST_SIGMA_LIMIT, 0.0), 1.0) * spread
    return TWICE_ACCEL_ERROR_CORRELATION_S * may * may


@cached_njit(error_model="numpy")
def compute_prediction_inputs(
    m: FilterMemory, s: FilterSettings, p: ModelParameters, z: _Array, new: NDArray[np.int32], r: _Array
) -> float:
    """Compute the inputs of :func:`predict_state` for the period that has just ended.

    They are averaged into the block of several periods that is buffered for the horizon.

    Returns the same as :func:`_update_flight_phase`."""
    now = m.tick % ROTOR_FORCE_HISTORY
    for j in range(4):
        sent = z[ACTUATOR_START + j]
        m.actuator_inputs[j] = min(max(sent, -1.0), 1.0) if sent == sent else 0.0
    rotation_matrix(m.x_output[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    n, e, d = (
        m.x_output[NOMINAL_VELOCITY] - m.x_output[NOMINAL_WIND],
        m.x_output[NOMINAL_VELOCITY + 1] - m.x_output[NOMINAL_WIND + 1],
        m.x_output[NOMINAL_VELOCITY + 2],
    )
    for k in range(3):
        m.axis_work[k] = r[k] * n + r[3 + k] * e + r[6 + k] * d
        m.flight_model_state[MODEL_RATES + k] = m.gyro_rates[k] - m.x_output[NOMINAL_GYRO_BIAS + k]
    if s.has_rotor_model > 0:
        predict_rotor_force(m, s, p, m.axis_work, m.rotor_model_rows[now])
        for k in range(2):
            m.flight_model_state[MODEL_SPEED_UPPER + k] += s.dt * m.rotor_spin_accel_bias[k]
        if new[READING_ROTOR_SPEED] == 1:
            a = READING_STARTS[READING_ROTOR_SPEED]
            if check_rotor_speed(m, s, z, a):
                for k in range(2):
                    off = z[a + k] - m.flight_model_state[MODEL_SPEED_UPPER + k]
                    m.flight_model_state[MODEL_SPEED_UPPER + k] += s.rotor_speed_filter_gain * off
                    m.rotor_spin_accel_bias[k] += s.rotor_spin_accel_bias_gain * off
        if new[READING_BATTERY] == 1:
            off = z[READING_STARTS[READING_BATTERY]] - predict_terminal_voltage(m, p)
            if check_battery_voltage(m, s, off):
                fast = 0.2 if m.tick * s.dt < 1.0 else 0.02
                m.flight_model_state[MODEL_CHARGE] = min(max(m.flight_model_state[MODEL_CHARGE] + fast * off, 0.0), 1.0)
    rises = _update_flight_phase(m, s, z)
    a, b = (now - s.imu_lag_ticks) % ROTOR_FORCE_HISTORY, (now - s.imu_lag_ticks - 1) % ROTOR_FORCE_HISTORY
    row = m.inputs_now
    model = s.has_rotor_model > 0
    for k in range(3):
        row[k] = 0.5 * (m.gyro_rates[k] + m.gyro_rates_prev[k])
        row[INPUT_ACCEL + k] = z[k]
        for g in range(3):
            row[INPUT_THRUST_ACCEL + 3 * g + k] = (1 - s.imu_lag_remainder) * m.rotor_model_rows[
                a, ROTOR_THRUST_ACCEL + 3 * g + k
            ] + s.imu_lag_remainder * m.rotor_model_rows[b, ROTOR_THRUST_ACCEL + 3 * g + k]
        clip = m.clipped_fraction[k] * CLIPPING_ERROR_FRACTION * s.accel_range
        # Without vibration; but if the attitude is unknown, the model's force is the better one.
        noise = m.accel_low_frequency_noise_density[k]
        if m.status[READING_RATES] >= STATUS_MISSING:
            noise = m.vibration_velocity_variance[k] / (FORCE_MEAN_TICKS * s.dt)
        felt = (
            max(s.accel_noise_density, noise) if s.has_rotor_model > 0 else s.accel_noise_density
        ) + TWICE_ACCEL_ERROR_CORRELATION_S * clip * clip
        made = s.model_accel_noise_density[k]
        if m.flight_phase <= PHASE_MOTORS_RUNNING:
            row[INPUT_THRUST_ACCEL + k], row[INPUT_NON_THRUST_ACCEL + k], row[INPUT_ACCEL_PER_VELOCITY + k] = (
                0.0,
                -GRAVITY * r[6 + k],
                0.0,
            )
            felt, made = 1e6, 1e-3
        elif m.flight_phase == PHASE_LIFTING_OFF:
            # Legs may support the weight that the rotors do not: no thrust is estimated.
            row[INPUT_NON_THRUST_ACCEL + k] += m.x_output[NOMINAL_THRUST_SCALE] * row[INPUT_THRUST_ACCEL + k]
            if k == 2:
                row[INPUT_NON_THRUST_ACCEL + 2] = (
                    -GRAVITY * r[8]
                    if m.is_sonar_at_minimum == 1
                    else min(row[INPUT_NON_THRUST_ACCEL + 2], -GRAVITY * r[8])
                )
            made = 0.05
            if k == 2:
                made += _ground_force_noise(m, row[INPUT_THRUST_ACCEL + 2])
            row[INPUT_THRUST_ACCEL + k] = 0.0
        elif model:
            # Until the thrust is known, after more than the delay, the accelerometers have the higher weight.
            unknown = max(m.sigma_output[ERROR_THRUST_SCALE] - MODELLED_THRUST_SIGMA, 0.0) * row[INPUT_THRUST_ACCEL + k]
            made += THRUST_ERROR_CORRELATION_S * unknown * unknown
        if not model and m.flight_phase > PHASE_MOTORS_RUNNING:
            row[INPUT_THRUST_ACCEL + k], row[INPUT_NON_THRUST_ACCEL + k], row[INPUT_ACCEL_PER_VELOCITY + k] = (
                0.0,
                -GRAVITY if k == 2 else 0.0,
                0.0,
            )
            made = 10.0
        if m.accel_model_diagnosis == DIAGNOSIS_MODEL_WRONG:
            made = max(made, WRONG_MODEL_NOISE_DENSITY)
        elif m.is_accel_distrusted == 1:
            felt = 1e6
        if m.status[READING_ACCELERATION] >= STATUS_MISSING or s.is_fitted[READING_ACCELERATION] == 0:
            felt = 1e6
        share = made / (felt + made)
        row[INPUT_ACCEL_WEIGHT + k] = share
        row[INPUT_NOISE_DENSITY + k] = felt * share
    row[INPUT_FLIGHT_PHASE] = m.flight_phase
    # Mean over the block so far
    into = m.input_blocks[(m.tick - 1) // s.block_ticks % INPUT_HISTORY_BLOCKS]
    share = 1.0 / ((m.tick - 1) % s.block_ticks + 1)
    for j in range(INPUT_ROW_SIZE - 1):
        into[j] = row[j] if share == 1.0 else into[j] + share * (row[j] - into[j])
    into[INPUT_FLIGHT_PHASE] = m.flight_phase
    return rises


@cached_njit(error_model="numpy")
def _backdate_accel_noise(m: FilterMemory, s: FilterSettings, k: int) -> None:
    """Apply the new noise of an accelerometer to buffered inputs that the horizon has not reached."""
    for at in range(m.horizon_tick, m.tick, s.block_ticks):
        e = m.input_blocks[at // s.block_ticks % INPUT_HISTORY_BLOCKS]
        share = max(e[INPUT_ACCEL_WEIGHT + k], 1e-9)
        felt = max(e[INPUT_NOISE_DENSITY + k] / share, m.accel_low_frequency_noise_density[k])
        made = e[INPUT_NOISE_DENSITY + k] / max(1.0 - share, 1e-9)
        e[INPUT_ACCEL_WEIGHT + k] = made / (felt + made)
        e[INPUT_NOISE_DENSITY + k] = felt * e[INPUT_ACCEL_WEIGHT + k]


@cached_njit(error_model="numpy")
def estimate_accel_noise(m: FilterMemory, s: FilterSettings, z: _Array) -> None:
    """Estimate the noise of accelerometers minus rotor model: vibration, and noise at low frequencies.

    The integral of the residual contains the effect of vibration on the velocity. Means over long blocks have
    triangular weights, which suppress vibration.
    """
    row = m.inputs_now
    m.slow_residual_count += 1
    weight = (
        m.slow_residual_count
        if m.slow_residual_count <= SLOW_NOISE_WINDOW_TICKS // 2
        else SLOW_NOISE_WINDOW_TICKS + 1 - m.slow_residual_count
    )
    for k in range(3):
        off = z[k] - (m.x[NOMINAL_THRUST_SCALE] * row[INPUT_THRUST_ACCEL + k] + row[INPUT_NON_THRUST_ACCEL + k])
        off -= row[INPUT_ACCEL_PER_VELOCITY + k] * m.axis_work[k]
        m.slow_residual_sum[k] += weight * off
        off -= m.slow_residual_mean_prev[k]
        m.vibration_velocity[k] += s.dt * (off - m.vibration_velocity[k] / VIBRATION_HIGH_PASS_S)
        # The output adds the last acceleration over the lag of the inertial unit.
        vibrating = m.vibration_velocity[k] + s.imu_lag * off
        m.vibration_velocity_variance[k] += VIBRATION_VARIANCE_GAIN * (
            vibrating * vibrating - m.vibration_velocity_variance[k]
        )
    if m.slow_residual_count >= SLOW_NOISE_WINDOW_TICKS:
        half = float(SLOW_NOISE_WINDOW_TICKS // 2)
        span = 0.75 * SLOW_NOISE_WINDOW_TICKS * s.dt
        # After lift-off the modelled force changes, and the thrust scale has to converge first.
        settled = m.flight_phase != PHASE_FLYING or m.tick - m.last_grounded_tick > 2 * SLOW_NOISE_WINDOW_TICKS
        for k in range(3):
            mean = m.slow_residual_sum[k] / (half * (half + 1.0))
            # The model's uncertainty, large at lift-off, is not noise of the accelerometers.
            unknown = 2.0 * m.sigma_output[ERROR_THRUST_SCALE] * abs(row[INPUT_THRUST_ACCEL + k])
            step = max(abs(mean - m.slow_residual_mean_prev[k]) - unknown, 0.0)
            made = row[INPUT_NOISE_DENSITY + k] / max(1.0 - row[INPUT_ACCEL_WEIGHT + k], 1e-9)
            density = max(0.5 * step * step * span - made, 0.0)
            if m.flight_phase == PHASE_FLYING and settled:
                unknown += 2.0 * m.sigma_output[ERROR_ACCEL_BIAS + k]
                apart = abs(mean - m.x[NOMINAL_ACCEL_BIAS + k]) - (MAX_MODEL_DISAGREEMENT_M_S2 + unknown)
                density += max(apart, 0.0) * max(apart, 0.0)
                if (
                    apart
                    > (m.clipped_fraction[0] + m.clipped_fraction[1] + m.clipped_fraction[2])
                    * CLIPPING_ERROR_FRACTION
                    * s.accel_range
                ):
                    m.accel_model_difference_tick = m.tick
            density = min(density, 100.0)
            most = max(
                0.6 if density > m.accel_low_frequency_noise_density[k] else 0.2, 1.0 / (m.slow_residual_mean_count + 1)
            )
            m.slow_residual_mean_prev[k] = mean
            m.slow_residual_sum[k] = 0.0
            if settled:
                m.accel_low_frequency_noise_density[k] += most * (density - m.accel_low_frequency_noise_density[k])
                if density > made:
                    _backdate_accel_noise(m, s, k)
        m.slow_residual_count = 0
        m.slow_residual_mean_count += 1
        if m.status[READING_ACCELERATION] == STATUS_REJECTED and m.tick >= m.fault_until_tick[READING_ACCELERATION]:
            m.status[READING_ACCELERATION], m.reason[READING_ACCELERATION] = STATUS_FUSED, REASON_NONE


@cached_njit(error_model="numpy")
def _rotate_to_level(m: FilterMemory, v: _Array, start: int) -> None:
    """Rotate two vectors of ``v``, at ``start`` and ``start + 3``, from the axes of a tilted inertial unit to those of
    the vehicle.
    """
    r = m.levelling_rotation
    for i in (start, start + 3):
        x, y, z = v[i], v[i + 1], v[i + 2]
        for k in range(3):
            v[i + k] = r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z


@cached_njit(error_model="numpy")
def _reset_to_level(m: FilterMemory, s: FilterSettings) -> None:
    """Reset the filter to level attitude and zero accelerometer bias; rotate buffered inputs to the vehicle's axes."""
    for b in range(INPUT_HISTORY_BLOCKS):
        _rotate_to_level(m, m.input_blocks[b], INPUT_RATES)
    clear_block_forces(m)
    m.task_stage = STAGE_DONE
    for x in (m.x, m.x_repropagating, m.x_now, m.x_output):
        turn = math.sqrt(x[NOMINAL_ATTITUDE] * x[NOMINAL_ATTITUDE] + x[NOMINAL_ATTITUDE + 3] * x[NOMINAL_ATTITUDE + 3])
        x[NOMINAL_ATTITUDE] /= turn
        x[NOMINAL_ATTITUDE + 3] /= turn
        x[NOMINAL_ATTITUDE + 1] = x[NOMINAL_ATTITUDE + 2] = 0.0
        for k in range(3):
            x[NOMINAL_ACCEL_BIAS + k] = 0.0
    for k in range(3):
        tilt, bias = s.initial_sigma[ERROR_ATTITUDE + k], s.initial_sigma[ERROR_ACCEL_BIAS + k]
        if k < 2:
            inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_ATTITUDE + k, tilt * tilt, m.u_transposed_h)
        inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_ACCEL_BIAS + k, bias * bias, m.u_transposed_h)


@cached_njit(error_model="numpy")
def _decide_levelling(m: FilterMemory, s: FilterSettings) -> None:
    """Decide from the summed accelerometer readings at rest whether the inertial unit is tilted; reset the filter if
    so.

    The smallest rotation that turns a / |a| to (0, 0, -1) has the axis (-a_y, a_x, 0) and the cosine -a_z / |a|.
    """
    x, y, d = m.levelling_accel_sum[0], m.levelling_accel_sum[1], m.levelling_accel_sum[2]
    size = math.sqrt(x * x + y * y + d * d)
    x, y, d = -y / size, x / size, -d / size
    tilt = s.initial_sigma[ERROR_ACCEL_BIAS] / GRAVITY
    q = x * x + y * y
    explained = s.rest_tilt_sigma * s.rest_tilt_sigma + tilt * tilt
    m.mount_variance[0] = m.mount_variance[1] = 0.5 * q  # the tilt may be a bias, a lean or the unit's
    if q > LEVELLING_GATE_SIGMAS * LEVELLING_GATE_SIGMAS * explained and d > 0.875:
        half = math.sqrt(0.5 * d + 0.5)
        turn = np.array((half, 0.5 * x / half, 0.5 * y / half, 0.0))
        rotation_matrix(turn, m.levelling_rotation)
        m.has_levelling_rotation = 1
        _reset_to_level(m, s)
        set_fault(m, s, READING_ACCELERATION, STATUS_FUSED, REASON_LEVELLED, math.sqrt(q))


@cached_njit(error_model="numpy")
def level_inertial_unit(m: FilterMemory, s: FilterSettings, z: _Array) -> None:
    """Measure the tilt of the inertial unit at rest before the first flight, and rotate its readings to the vehicle's
    axes.

    The vehicle stands level within ``rest_tilt_sigma``. If the measured specific force is tilted by more than legs and
    accelerometer bias can explain, the unit is mounted at an angle. Without this correction the estimated attitude
    would be wrong by twice the tilt after half a turn about the mast.
    """
    needed = int(LEVELLING_REST_S / s.dt)
    if m.levelling_ticks < needed:
        still = m.flight_phase == PHASE_STANDING and m.status[READING_ACCELERATION] == STATUS_FUSED
        for k in range(3):
            still = still and abs(z[READING_STARTS[READING_RATES] + k]) < LEVELLING_MAX_RATE_RAD_S
        if m.flight_phase > PHASE_STANDING or s.has_rotor_model == 0:
            m.levelling_ticks = needed
        elif not still:
            m.levelling_ticks = 0
            m.levelling_accel_sum[0] = m.levelling_accel_sum[1] = m.levelling_accel_sum[2] = 0.0
        else:
            m.levelling_ticks += 1
            for k in range(3):
                m.levelling_accel_sum[k] += z[READING_STARTS[READING_ACCELERATION] + k]
            if m.levelling_ticks == needed:
                _decide_levelling(m, s)
    if m.has_levelling_rotation == 1:
        _rotate_to_level(m, z, READING_STARTS[READING_ACCELERATION])
