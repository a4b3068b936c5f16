"""One period of the compiled filter: from readings to the present state, with a bounded amount of work.

The filter runs ``horizon_delay_ticks`` periods behind now, at the *horizon* (:mod:`filter_horizon`), as PX4's EKF2
does. The output is the state of the horizon, propagated to now (:mod:`output_predictor`) with the inputs received since
the horizon (:mod:`filter_inputs`).

A period has time for ``fusion_budget`` scalar measurements; with more work the horizon falls behind.

The low-pass filter of the inertial unit delays its output by ``lag``, so a state describes the instant ``lag`` before
its tick.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import MODEL_ATTITUDE, MODEL_BAR_NORMAL, MODEL_CHARGE, MODEL_POSITION, ModelParameters
from mufly.estimate.filter.filter_horizon import (
    COST_COVARIANCE_OUTPUT,
    STAGE_DONE,
    predict_next_bias,
    queue_measurement,
    run_next_task,
)
from mufly.estimate.filter.filter_inputs import compute_prediction_inputs, estimate_accel_noise, level_inertial_unit
from mufly.estimate.filter.filter_records import (
    AID_COUNT,
    ERROR_STATE_COUNT,
    ERROR_THRUST_SCALE,
    NOMINAL_ATTITUDE,
    NOMINAL_GYRO_BIAS,
    NOMINAL_TERRAIN,
    PHASE_FLYING,
    PHASE_LIFTING_OFF,
    PHASE_MOTORS_RUNNING,
    QUEUE_SIZE,
    QUEUED_READING_INDICES,
    READING_ACCELERATION,
    READING_POSITION_FIX,
    READING_RATES,
    READING_STARTS,
    ROTOR_ANG_ACCEL,
    ROTOR_FORCE_HISTORY,
    STATE_COUNT,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.measurements.fusion import (
    LEG_CLEARANCE_HEIGHT_M,
    LIFTOFF_THRUST_SIGMA,
    fuse_liftoff_thrust,
    height_above_ground,
)
from mufly.estimate.filter.measurements.sensor_checks import (
    REASON_LATE,
    STATUS_FAULTY,
    STATUS_MISSING,
    check_readings,
    replace_gyro_spikes,
    set_fault,
)
from mufly.estimate.filter.output_predictor import COVARIANCE_INTERVAL_TICKS, predict_output

_Array = NDArray[np.float64]

_INITIAL_REST_S = 0.8
_GYRO_OUTAGE_S = 0.1  # without gyroscopes
INITIAL_ACCEL_NOISE_DENSITY = 5.0
"""Initial density of the accelerometer noise (m^2/s^3), so large that the model has the higher weight."""


@cached_njit(error_model="numpy")
def estimator_reset(m: FilterMemory, s: FilterSettings) -> None:
    """Set the memory of the filter to its initial values."""
    for i in range(STATE_COUNT):
        m.x[i] = m.x_repropagating[i] = m.x_now[i] = s.initial_state[i]
    for i in range(ERROR_STATE_COUNT):
        m.ud_diagonal[i] = s.initial_sigma[i] * s.initial_sigma[i] + 1e-12
        for j in range(ERROR_STATE_COUNT):
            m.u_transposed[i, j] = 1.0 if i == j else 0.0
    for i in range(QUEUE_SIZE):
        m.queue_due[i] = -1
    for i in range(AID_COUNT):
        m.noise_scale[i] = m.bias_walk_scale[i] = 1.0
    m.task_stage = STAGE_DONE
    m.sonar_effective_min_range = s.sonar_min_range
    m.x_output[NOMINAL_ATTITUDE] = m.flight_model_state[MODEL_ATTITUDE] = m.flight_model_state[MODEL_CHARGE] = 1.0
    m.flight_model_state[MODEL_POSITION + 2] = -1000.0  # far above the floor
    m.flight_model_state[MODEL_BAR_NORMAL + 2] = -1.0
    for k in range(3):
        m.accel_low_frequency_noise_density[k] = INITIAL_ACCEL_NOISE_DENSITY


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
        Readings, in the order of :data:`mufly.quantities.quantity_table.READINGS_WITH_FUSION_STATUS`,
        then the acting inputs (4)
        and the share of clipped samples per axis (3).
    new : (9,) array of int
        0: nothing new; 1: a new reading; 2: a reading marked invalid by its sensor.
    age : (9,) array
        Age of each reading (s).
    """
    m.tick += 1
    check_readings(m, s, z, new, age)
    level_inertial_unit(m, s, z)
    r, a = m.rotation_work, m.accel_work
    for k in range(3):
        m.gyro_rates_prev[k] = m.gyro_rates[k]
        if m.status[READING_RATES] < STATUS_MISSING:
            m.gyro_rates[k] = z[READING_STARTS[READING_RATES] + k] - m.gyro_offset_jump[k]
        elif s.has_rotor_model > 0 and m.flight_phase >= PHASE_LIFTING_OFF:
            # Rates of the rotor model. The stabiliser bar keeps the rotors level, so only yaw drifts.
            m.gyro_rates[k] = (
                m.gyro_rates_prev[k]
                + s.dt * m.rotor_model_rows[(m.tick - 1) % ROTOR_FORCE_HISTORY, ROTOR_ANG_ACCEL + k]
                + m.model_rate_step_bias[k]
            )
        else:
            m.gyro_rates[k] = m.x_output[NOMINAL_GYRO_BIAS + k]
    # The height may be wrong by the depth of a surface below the floor, or by the gap of fix and sonar
    doubt = m.fix_sonar_height_difference - min(m.x_output[NOMINAL_TERRAIN], 0.0)
    replace_gyro_spikes(
        m,
        s,
        m.flight_phase == PHASE_FLYING and height_above_ground(m.x_output, s) > LEG_CLEARANCE_HEIGHT_M + doubt,
    )
    rises = compute_prediction_inputs(m, s, p, z, new, r)
    if (
        s.has_rotor_model > 0
        and m.flight_phase >= PHASE_MOTORS_RUNNING
        and m.status[READING_ACCELERATION] < STATUS_MISSING
    ):
        estimate_accel_noise(m, s, z)
    for kind in QUEUED_READING_INDICES:
        if new[kind] != 1 or m.is_skipped_by_decimation[kind] > 0:
            continue
        # The state of tick k belongs to k dt - lag.
        at = m.tick + (s.imu_lag - age[kind]) / s.dt
        if not queue_measurement(
            m, s, kind, at, z, READING_STARTS[kind], READING_STARTS[kind + 1] - READING_STARTS[kind]
        ):
            m.late_count[kind] += 1
            # A single late reading is no fault: some exceed the delay of the horizon.
            if (m.tick - m.last_fused_tick[kind]) * s.dt > s.timeout[kind]:
                set_fault(m, s, kind, STATUS_FAULTY, REASON_LATE, age[kind])
    left = s.fusion_budget - (COST_COVARIANCE_OUTPUT if m.tick % COVARIANCE_INTERVAL_TICKS == 0 else 0)
    predict_next_bias(m, s)
    if rises > 0.0 and m.sigma_output[ERROR_THRUST_SCALE] > LIFTOFF_THRUST_SIGMA:
        fuse_liftoff_thrust(m, rises)
        left -= 1
    while left > 0:
        cost = run_next_task(m, s, r, a, left)
        if cost == 0:
            break
        left -= cost
    predict_output(m, s, r, a)
    found = s.is_fitted[READING_POSITION_FIX] == 0 or m.is_heading_aligned > 0
    if m.is_initialised == 0 and found and (m.standing_ticks * s.dt >= _INITIAL_REST_S or m.tick * s.dt > 3.0):
        m.is_initialised = 1
    turns = s.has_rotor_model > 0 and m.flight_phase >= PHASE_LIFTING_OFF
    seen = (
        m.status[READING_RATES] < STATUS_MISSING
        or turns
        or (m.tick - m.last_fused_tick[READING_RATES]) * s.dt < _GYRO_OUTAGE_S
    )
    for k in range(3):
        # Invalid inputs may make the model diverge: rates beyond the gyroscopes' range are no estimate.
        if not abs(m.rates_output[k]) < 2.0 * s.value_limit[READING_RATES]:
            seen = False
    if m.has_levelling_rotation == 1:
        for k in range(READING_STARTS[READING_ACCELERATION], READING_STARTS[READING_RATES] + 3):
            z[k] = m.last_value[k]
    return m.is_initialised > 0 and seen
