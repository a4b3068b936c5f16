"""Run many periods of a flight in one compiled call: the stages of :mod:`mufly.flight.period_stages` on arrays.

There are two executors: :func:`run_ideal_periods` for a flight on the truth, :func:`run_sensed_periods` for a flight on
sensors with errors and the filter. Both call the same compiled functions and C code as a flight in Python: plant,
sensors, filter and flight software.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import call_c_function, refer_to
from mufly.compiled.record_fields import int_or_array_field, make_record_dtype, real_or_array_field
from mufly.dynamics.model_state import MODEL_POSITION, MODEL_RATES, MODEL_VELOCITY, STATE_SIZE
from mufly.estimate.filter.filter_records import (
    ERROR_ATTITUDE,
    ERROR_GYRO_BIAS,
    ERROR_STATE_COUNT,
    NOMINAL_POSITION,
    NOMINAL_VELOCITY,
    READING_ACCELERATION,
    READING_BATTERY,
    READING_RANGE_RING,
    READING_RATES,
    READING_STARTS,
    READING_WIDTHS,
    SENSOR_COUNT,
    STATE_COUNT,
    SUBTRACTED_READING_OFFSETS,
)
from mufly.estimate.filter.measurements import sensor_checks as g
from mufly.estimate.filter.measurements.sensor_checks import ACTUATOR_START, CLIPPING_START
from mufly.estimate.filter.output_predictor import COVARIANCE_INTERVAL_TICKS
from mufly.estimate.kalman_estimator import median_filter_ring_scan
from mufly.flight.period_stages import CONTINUE_LOOP, FIRST_EXECUTOR_CODE, LOOP_DONE, make_stage_loop
from mufly.flight.simulated_plant import advance_period, classify_collision, write_true_attitude
from mufly.sensors.imu import FIRST_GYRO_AXIS, sample_imu
from mufly.sensors.periodic import ROW_FIRST_VALUE_INDEX, ROW_IS_VALID_INDEX, ROW_MEASURED_TIME_INDEX
from mufly.sensors.readings import measure_ranges
from mufly.sensors.sampling import SAMPLED_READING_INDICES, sample_all

_Array = NDArray[np.float64]

MAX_PERIODS_PER_CALL = 4096
"""Maximum number of periods per call."""

# Codes of the stages: reasons for the return to Python
(
    STOP_TO_SAMPLE_SENSORS,
    STOP_TO_UPDATE_STATUS,
    STOP_LOG_OR_MODE_CHANGED,
    STOP_ON_CONTACT,
    STOP_NOT_FINITE,
    STOP_ESTIMATE_VALID,
    STOP_TO_CALL_LISTENER,
) = range(FIRST_EXECUTOR_CODE, FIRST_EXECUTOR_CODE + 7)


class LoopClock:
    """Next stage, counters, intervals and constants of one call of the compiled loop."""

    stage: int = int_or_array_field("stage due next")
    tick: int = int_or_array_field("periods of the plant since its start")
    start_tick: int = int_or_array_field("period in which this call began")
    stop_tick: int = int_or_array_field("period in which this call ends")
    contact_interval: int = int_or_array_field("periods between two checks of contacts")
    record_interval: int = int_or_array_field("periods between two rows of the recording")
    ring_interval: int = int_or_array_field("periods between two readings of an ideal ring")
    listener_interval: int = int_or_array_field("periods between two calls of the listener; 0: no listener")
    wind_samples: int = int_or_array_field("samples of the wind used")
    steps_per_period: int = int_or_array_field("Runge-Kutta steps of a period")
    beam_count: int = int_or_array_field("beams of the ring in the flight software")
    is_armed: int = int_or_array_field("1: armed")
    is_estimate_valid: int = int_or_array_field("1: the estimate is valid")
    stop_when_valid: int = int_or_array_field("1: the call ends when the estimate becomes valid")
    has_no_sensor_fault: int = int_or_array_field("1: no sensor is suspected and none was reported")
    log_or_motors_changed: int = int_or_array_field("1: log or motors changed in this period")
    periods_run: int = int_or_array_field("periods of the flight software")
    filter_periods_run: int = int_or_array_field("periods of the filter")
    last_mission_tick: int = int_or_array_field("last period in which the mission's logic was due; -1: none")
    log_rows: int = int_or_array_field("rows of the recording written")
    status_rows: int = int_or_array_field("rows of sensor status written")
    listener_rows: int = int_or_array_field("rows for the listener written")
    rate_Hz: float = real_or_array_field("rate of the flight software", unit="Hz")
    step_s: float = real_or_array_field("step of the integration", unit="s")
    rotor_radius: float = real_or_array_field("radius of a rotor", unit="m")
    hover_current_A: float = real_or_array_field("current in hover", unit="A")
    current_A: float = real_or_array_field("mean current", unit="A")
    current_filter_weight: float = real_or_array_field("share of a new value in the mean current")
    next_python_sample_s: float = real_or_array_field("next sample of the sensors that Python samples", unit="s")
    next_sample_s: float = real_or_array_field("next sample of the other sensors", unit="s")


LOOP_CLOCK_DTYPE = make_record_dtype(LoopClock, int_kind=np.int64)


class RecordOffsets:
    """Offsets of fields in the C records, counted in elements of the field's type."""

    time: int = int_or_array_field("time of the estimate")
    motion: int = int_or_array_field("motion of the estimate")
    valid: int = int_or_array_field("validity of the estimate")
    motors: int = int_or_array_field("state of the motors")
    late_s: int = int_or_array_field("time that the period is late")
    log_count: int = int_or_array_field("entries of the log")
    finished: int = int_or_array_field("end of the mission")
    state: int = int_or_array_field("state of the mission")
    reference_position: int = int_or_array_field("reference position")
    reference_velocity: int = int_or_array_field("reference velocity")
    reference_heading: int = int_or_array_field("reference heading")
    reference_heading_rate: int = int_or_array_field("reference rate of the heading")
    reference_tilt: int = int_or_array_field("reference tilt")
    ranges: int = int_or_array_field("ranges of the ring")
    position_variance: int = int_or_array_field("variance of the position")
    attitude_variance: int = int_or_array_field("variance of the attitude")
    specific_force: int = int_or_array_field("reading of the accelerometers")
    checks: int = int_or_array_field("checks of the sensors")
    check_size: int = int_or_array_field("size of a check")
    check_status: int = int_or_array_field("status in a check")
    check_reason: int = int_or_array_field("reason in a check")


RECORD_OFFSETS_DTYPE = make_record_dtype(RecordOffsets, int_kind=np.int64)


class PlantArrays(NamedTuple):
    """Arrays of the plant, with its wind and inputs."""

    state: _Array
    parameters: NDArray[np.void]
    attitude: _Array
    supply: _Array  # voltage (V) and current (A) of the battery
    wind: _Array  # (n, 3), of the coming periods (m/s)
    acting_inputs: _Array  # (3, 4): inputs of the last period, of this period, and sent last
    leg_count: int
    has_obstacles: bool
    boxes: _Array
    cylinders: _Array
    limits: _Array


class SoftwareArrays(NamedTuple):
    """Records of the flight software in C, as one array for each type of number."""

    reals: _Array
    ints: NDArray[np.int32]
    bytes: NDArray[np.uint8]
    estimate_reals: _Array
    estimate_ints: NDArray[np.int32]
    estimate_bytes: NDArray[np.uint8]
    actuators: _Array
    offsets: RecordOffsets
    addresses: tuple[int, ...]  # of the step function and its five arguments


class FilterArrays(NamedTuple):
    """Arrays of the filter in C: outputs, readings of a period, and state of :class:`KalmanEstimator`."""

    state: _Array
    rates: _Array
    angles: _Array
    values: _Array
    is_new: NDArray[np.int32]
    age: _Array
    is_fitted: NDArray[np.uint8]
    reading_times: _Array
    ring_scans: _Array
    max_range_m: float
    fused_beams: NDArray[np.int64]  # indices of the fused beams
    status: tuple[_Array, ...]  # PUBLISHED_FIELDS of the memory
    texts: NDArray[np.int64]  # numbers of the reasons' texts
    addresses: tuple[int, ...]  # of the step function and its six arguments


class SensorArrays(NamedTuple):
    """Arrays of sensors with errors, as arguments of :func:`sample_imu` and :func:`sample_all`."""

    imu: tuple[Any, ...]
    next_sample_times: _Array
    has_new_reading: NDArray[np.uint8]
    rows: _Array
    parts: tuple[Any, ...]


class IdealLoopArguments(NamedTuple):
    """Arguments of :func:`run_ideal_periods`: clock, plant and software of a flight without sensor errors."""

    clock: LoopClock
    plant: PlantArrays
    software: SoftwareArrays
    ranges: _Array
    log: _Array  # (n, LOG_ROW_SIZE + beams)
    ring: tuple[Any, ...]  # arguments of measure_ranges
    ring_clock: _Array


class SensedLoopArguments(NamedTuple):
    """Arguments of :func:`run_sensed_periods`: clock, plant, sensors, filter and software of a flight with sensors."""

    clock: LoopClock
    plant: PlantArrays
    software: SoftwareArrays
    ranges: _Array
    log: _Array  # (n, LOG_ROW_SIZE + beams)
    sensors: SensorArrays
    filter: FilterArrays
    status_rows: _Array  # (n, STATUS_ROW_SIZE); the first row is from before the call
    listener_rows: _Array  # (n, LISTENER_ROW_SIZE + beams)


LoopArguments = IdealLoopArguments | SensedLoopArguments

_MOTORS_OFF, _MOTORS_FLYING = 0, 2
_IMU_OUTPUT_ARGUMENT = 4  # place in the arguments of sample_imu after the time
# First columns of a log row: time, state, attitude, wind, battery, active actuators, reference, mission state; the
# ranges follow
(
    LOG_TIME_COLUMN,
    LOG_STATE_START,
    LOG_ATTITUDE_START,
    LOG_WIND_START,
    LOG_SUPPLY_START,
    LOG_MOTOR_INPUTS_START,
    LOG_SERVO_INPUTS_START,
) = 0, 1, 22, 25, 28, 30, 32
LOG_REF_POSITION_START, LOG_REF_VELOCITY_START, LOG_REF_ATTITUDE_START, LOG_MISSION_STATE_COLUMN, LOG_ROW_SIZE = (
    34,
    37,
    40,
    43,
    44,
)
# Offsets in the C record of motion (controllers.h)
_MOTION_POS_START, _MOTION_VEL_START, _MOTION_ATT_START, _MOTION_RATES_START, _MOTION_VOLTAGE_INDEX = 0, 3, 6, 9, 12
_ACCEL_START, _RATES_START, _VOLTAGE_START = (
    READING_STARTS[READING_ACCELERATION],
    READING_STARTS[READING_RATES],
    READING_STARTS[READING_BATTERY],
)
# Status row (:data:`mufly.estimate.kalman_estimator.PUBLISHED_FIELDS`): covariance (9, 9), standard deviations, seven
# numbers of each sensor, the faulty component of the position fix, and the period
STATUS_SIGMA_START = ERROR_GYRO_BIAS**2
SENSOR_STATUS_START = STATUS_SIGMA_START + ERROR_STATE_COUNT
(
    _STATUS_COLUMN,
    _REASON_COLUMN,
    _REASON_NUMBER_COLUMN,
    _INNOVATION_COLUMN,
    _INNOVATION_SIGMA_COLUMN,
    _LAST_FUSED_TICK_COLUMN,
    _LAST_NEW_TICK_COLUMN,
    SENSOR_STATUS_SIZE,
) = range(8)
STATUS_FAULT_COMPONENT_COLUMN = SENSOR_STATUS_START + SENSOR_STATUS_SIZE * SENSOR_COUNT
STATUS_TICK_COLUMN = STATUS_FAULT_COMPONENT_COLUMN + 1
STATUS_ROW_SIZE = STATUS_TICK_COLUMN + 1
# Listener row: period, validity, battery (V), index of the status row; wind, supply, accelerometer reading, state,
# attitude, nominal state, rates, angles; the ranges follow
(
    LISTENER_TICK_COLUMN,
    LISTENER_VALID_COLUMN,
    LISTENER_VOLTAGE_COLUMN,
    LISTENER_STATUS_ROW_COLUMN,
    LISTENER_WIND_START,
    LISTENER_SUPPLY_START,
    LISTENER_SPECIFIC_FORCE_START,
    LISTENER_STATE_START,
) = (
    0,
    1,
    2,
    3,
    4,
    7,
    9,
    12,
)
LISTENER_ATTITUDE_START = LISTENER_STATE_START + STATE_SIZE
LISTENER_FILTER_STATE_START = LISTENER_ATTITUDE_START + 3
LISTENER_RATES_START = LISTENER_FILTER_STATE_START + STATE_COUNT
LISTENER_ANGLES_START = LISTENER_RATES_START + 3
LISTENER_ROW_SIZE = LISTENER_ANGLES_START + 3


@cached_njit(error_model="numpy")
def _copy_to_row(row: _Array, at: int, values: _Array) -> int:
    """Copy values into a row from index ``at`` on; return the index after them.

    An assignment to a slice would add 2 s of compilation.
    """
    for k in range(values.size):
        row[at + k] = values[k]
    return at + values.size


# Stages. The executors pass their arrays by address: a copy of some sixty array descriptors costs seconds to compile.


@cached_njit(error_model="numpy")
def _has_ended(p: LoopArguments) -> bool:
    c = p.clock
    return c.tick >= c.stop_tick or c.wind_samples >= p.plant.wind.shape[0] or c.log_rows >= p.log.shape[0]


@cached_njit(error_model="numpy")
def _is_listener_due(p: LoopArguments) -> bool:
    c = p.clock
    return c.listener_interval > 0 and c.tick % c.listener_interval == 0 and c.tick != c.start_tick


@cached_njit(error_model="numpy")
def _begin_ideal_period(p: IdealLoopArguments) -> int:
    if _has_ended(p):
        return LOOP_DONE
    if _is_listener_due(p):
        return STOP_TO_CALL_LISTENER
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _begin_sensed_period(p: SensedLoopArguments) -> int:
    if _has_ended(p):
        return LOOP_DONE
    if _is_listener_due(p):
        c, f = p.clock, p.filter
        row = p.listener_rows[c.listener_rows]
        c.listener_rows += 1
        row[LISTENER_TICK_COLUMN], row[LISTENER_VALID_COLUMN] = c.tick, c.is_estimate_valid
        row[LISTENER_VOLTAGE_COLUMN], row[LISTENER_STATUS_ROW_COLUMN] = f.values[_VOLTAGE_START], c.status_rows
        n = _copy_to_row(row, LISTENER_WIND_START, p.plant.wind[c.wind_samples - 1])
        n = _copy_to_row(row, _copy_to_row(row, n, p.plant.supply), f.values[_ACCEL_START : _ACCEL_START + 3])
        n = _copy_to_row(row, _copy_to_row(row, n, p.plant.state), p.plant.attitude)
        n = _copy_to_row(row, _copy_to_row(row, _copy_to_row(row, n, f.state), f.rates), f.angles)
        _copy_to_row(row, n, p.ranges)
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def advance_plant(p: LoopArguments) -> int:
    c, q = p.clock, p.plant
    acting_inputs = q.acting_inputs
    advance_period(
        q.state, acting_inputs[1], q.wind[c.wind_samples], q.parameters, c.step_s, c.steps_per_period, q.supply
    )
    c.wind_samples += 1
    c.tick += 1
    for k in range(4):
        acting_inputs[0, k], acting_inputs[1, k] = acting_inputs[1, k], acting_inputs[2, k]
    if not math.isfinite(q.state[MODEL_POSITION + 2]):
        return STOP_NOT_FINITE
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _check_contact(p: LoopArguments) -> int:
    c, q = p.clock, p.plant
    if c.tick % c.contact_interval == 0:
        if classify_collision(
            q.state, q.parameters, q.leg_count, c.rotor_radius, q.has_obstacles, q.boxes, q.cylinders, q.limits
        ):
            return STOP_ON_CONTACT
        flies = p.software.ints[p.software.offsets.motors] == _MOTORS_FLYING
        drawn = q.supply[1] if flies else c.hover_current_A
        c.current_A += c.current_filter_weight * (drawn - c.current_A)
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _publish_ranges(p: LoopArguments) -> None:
    for k in range(p.clock.beam_count):
        p.software.estimate_reals[p.software.offsets.ranges + k] = p.ranges[k]


@cached_njit(error_model="numpy")
def _measure_truth(p: IdealLoopArguments) -> int:
    c, q = p.clock, p.plant
    write_true_attitude(q.state, q.attitude)
    if c.tick % c.ring_interval == 0:
        measure_ranges(q.state, *p.ring, p.ranges)
        p.ring_clock[0] = c.tick / c.rate_Hz
        _publish_ranges(p)
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _fill_readings(t: float, has_new_reading: NDArray[np.uint8], rows: _Array, f: FilterArrays, ranges: _Array) -> bool:
    """Copy new readings to the filter, as :meth:`KalmanEstimator.write_input_readings`; return if the ring has one."""
    is_ring = False
    for k in range(len(SAMPLED_READING_INDICES)):
        r = SAMPLED_READING_INDICES[k]
        if (
            has_new_reading[k] == 0
            or r < 0
            or f.is_fitted[r] == 0
            or rows[k, ROW_MEASURED_TIME_INDEX] == f.reading_times[r]
        ):
            continue
        row = rows[k]
        f.reading_times[r] = row[ROW_MEASURED_TIME_INDEX]
        f.age[r], f.is_new[r] = t - row[ROW_MEASURED_TIME_INDEX], 1 if row[ROW_IS_VALID_INDEX] != 0.0 else 2
        start = READING_STARTS[r]
        if r == READING_RANGE_RING:
            is_ring = True
            for j in range(f.fused_beams.size):
                f.values[start + j] = row[ROW_FIRST_VALUE_INDEX + f.fused_beams[j]]
            median_filter_ring_scan(row[ROW_FIRST_VALUE_INDEX:], f.max_range_m, f.ring_scans, ranges)
        else:
            for j in range(READING_WIDTHS[r]):
                f.values[start + j] = row[ROW_FIRST_VALUE_INDEX + j] - SUBTRACTED_READING_OFFSETS[r]
    return is_ring


@cached_njit(error_model="numpy")
def sample_sensors(p: SensedLoopArguments) -> int:
    c, q, f, s = p.clock, p.plant, p.filter, p.sensors
    t = c.tick / c.rate_Hz
    write_true_attitude(q.state, q.attitude)
    for k in range(f.is_new.size):
        f.is_new[k] = 0
    for k in range(4):
        f.values[ACTUATOR_START + k] = q.acting_inputs[0, k]
    sample_imu(q.state, t, *s.imu)
    read = s.imu[_IMU_OUTPUT_ARGUMENT]
    for k in range(3):
        f.values[_ACCEL_START + k], f.values[_RATES_START + k] = read[0, k], read[0, FIRST_GYRO_AXIS + k]
        f.values[CLIPPING_START + k] = read[1, k]
    f.is_new[READING_ACCELERATION] = f.is_new[READING_RATES] = 1
    f.age[READING_ACCELERATION] = f.age[READING_RATES] = 0.0
    f.reading_times[READING_ACCELERATION] = f.reading_times[READING_RATES] = t
    if t >= c.next_sample_s:
        c.next_sample_s = sample_all(
            t, q.state, q.attitude, q.supply, s.next_sample_times, s.has_new_reading, s.rows, s.parts
        )
        if _fill_readings(t, s.has_new_reading, s.rows, f, p.ranges):
            _publish_ranges(p)
    if t >= c.next_python_sample_s:
        return STOP_TO_SAMPLE_SENSORS
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _publish_truth(p: IdealLoopArguments) -> int:
    c, q, b, at = p.clock, p.plant, p.software.estimate_reals, p.software.offsets
    b[at.time] = c.tick / c.rate_Hz
    for k in range(3):
        b[at.motion + _MOTION_POS_START + k], b[at.motion + _MOTION_VEL_START + k] = (
            q.state[MODEL_POSITION + k],
            q.state[MODEL_VELOCITY + k],
        )
        b[at.motion + _MOTION_ATT_START + k], b[at.motion + _MOTION_RATES_START + k] = (
            q.attitude[k],
            q.state[MODEL_RATES + k],
        )
    b[at.motion + _MOTION_VOLTAGE_INDEX] = q.supply[0]
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _step_filter(p: SensedLoopArguments) -> int:
    c, f, b, at = p.clock, p.filter, p.software.estimate_reals, p.software.offsets
    b[at.time] = c.tick / c.rate_Hz
    valid = call_c_function(f.addresses[0], f.addresses[1:]) & 1
    for k in range(3):
        b[at.motion + _MOTION_POS_START + k], b[at.motion + _MOTION_VEL_START + k] = (
            f.state[NOMINAL_POSITION + k],
            f.state[NOMINAL_VELOCITY + k],
        )
        b[at.motion + _MOTION_ATT_START + k], b[at.motion + _MOTION_RATES_START + k] = f.angles[k], f.rates[k]
        b[at.specific_force + k] = f.values[_ACCEL_START + k]
    volts = f.values[_VOLTAGE_START]
    b[at.motion + _MOTION_VOLTAGE_INDEX] = volts if volts != 0.0 else math.nan
    p.software.estimate_bytes[at.valid] = valid
    c.is_estimate_valid = valid
    c.filter_periods_run += 1
    if c.filter_periods_run % COVARIANCE_INTERVAL_TICKS == 0:
        n = c.status_rows
        c.status_rows += 1
        if not _write_filter_status(
            f, c.has_no_sensor_fault, p.status_rows[n], p.status_rows[n + 1], p.software.estimate_ints, at
        ):
            return STOP_TO_UPDATE_STATUS
        covariance = f.status[0]
        for k in range(3):
            b[at.position_variance + k] = covariance[k, k]
            b[at.attitude_variance + k] = covariance[ERROR_ATTITUDE + k, ERROR_ATTITUDE + k]
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _write_filter_status(
    f: FilterArrays, calm: int, before: _Array, row: _Array, said: NDArray[np.int32], at: RecordOffsets
) -> bool:
    """Write the filter's covariance and statuses into ``row``, and reasons without a value into the C record ``said``.

    Return False if Python must write the other reasons because a status has changed since the row ``before``.

    ``f.texts`` are the text numbers of the reasons, -1 for texts that contain a value. ``calm``: waiting and fused
    sensors need no report.
    """
    covariance, sigma, code, why, number, innovation, spread, used, came, component, tick = f.status
    for j in range(ERROR_GYRO_BIAS):
        for k in range(ERROR_GYRO_BIAS):
            row[ERROR_GYRO_BIAS * j + k] = covariance[j, k]
    for k in range(ERROR_STATE_COUNT):
        row[STATUS_SIGMA_START + k] = sigma[k]
    row[STATUS_FAULT_COMPONENT_COLUMN], row[STATUS_TICK_COLUMN] = component[0], tick[0]
    same = True
    for k in range(SENSOR_COUNT):
        start = SENSOR_STATUS_START + SENSOR_STATUS_SIZE * k
        of, was = row[start : start + SENSOR_STATUS_SIZE], before[start : start + SENSOR_STATUS_SIZE]
        of[_STATUS_COLUMN], of[_REASON_COLUMN], of[_REASON_NUMBER_COLUMN], of[_INNOVATION_COLUMN] = (
            code[k],
            why[k],
            number[k],
            innovation[k],
        )
        of[_INNOVATION_SIGMA_COLUMN], of[_LAST_FUSED_TICK_COLUMN], of[_LAST_NEW_TICK_COLUMN] = (
            spread[k],
            used[k],
            came[k],
        )
        if f.is_fitted[k] == 0:
            continue
        text = f.texts[why[k]]
        if code[k] == g.STATUS_WAITING and why[k] == g.REASON_NONE and came[k] == 0:
            text = f.texts[g.REASON_NO_READING]
        quiet = (
            calm != 0
            and (code[k] == g.STATUS_WAITING or code[k] == g.STATUS_FUSED)
            and was[_STATUS_COLUMN] == was[_STATUS_COLUMN]
        )
        if quiet and text >= 0:
            one = at.checks + k * at.check_size
            said[one + at.check_status], said[one + at.check_reason] = code[k], text
        else:
            same = same and of[_STATUS_COLUMN] == was[_STATUS_COLUMN] and of[_REASON_COLUMN] == was[_REASON_COLUMN]
            same = same and (text >= 0 or of[_REASON_NUMBER_COLUMN] == was[_REASON_NUMBER_COLUMN])
            same = same and (text >= 0 or row[STATUS_FAULT_COMPONENT_COLUMN] == before[STATUS_FAULT_COMPONENT_COLUMN])
    return same


@cached_njit(error_model="numpy")
def _step_software(p: LoopArguments) -> int:
    c, s = p.clock, p.software
    at = s.offsets
    logged, motors, finished = s.ints[at.log_count], s.ints[at.motors], s.bytes[at.finished]
    call_c_function(s.addresses[0], s.addresses[1:])
    runs = c.is_armed > 0 or s.ints[at.motors] == _MOTORS_OFF
    for k in range(4):
        p.plant.acting_inputs[2, k] = s.actuators[k] if runs else 0.0
    if s.reals[at.late_s] == 0.0:
        c.last_mission_tick = c.tick
    c.periods_run += 1
    changed = s.ints[at.log_count] != logged or s.ints[at.motors] != motors or s.bytes[at.finished] != finished
    c.log_or_motors_changed = 1 if changed else 0
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _write_log_row(p: LoopArguments) -> int:
    c, q, s = p.clock, p.plant, p.software
    if c.tick % c.record_interval == 0:
        at = s.offsets
        row, late = p.log[c.log_rows], s.reals[at.late_s]
        c.log_rows += 1
        row[LOG_TIME_COLUMN] = c.tick / c.rate_Hz
        n = _copy_to_row(row, _copy_to_row(row, LOG_STATE_START, q.state), q.attitude)
        n = _copy_to_row(row, _copy_to_row(row, n, q.wind[c.wind_samples - 1]), q.supply)
        _copy_to_row(row, n, q.acting_inputs[1])
        for k in range(3):
            way = s.reals[at.reference_velocity + k]
            row[LOG_REF_POSITION_START + k] = s.reals[at.reference_position + k] + late * way
            row[LOG_REF_VELOCITY_START + k] = way
        row[LOG_REF_ATTITUDE_START], row[LOG_REF_ATTITUDE_START + 1] = (
            s.reals[at.reference_tilt],
            s.reals[at.reference_tilt + 1],
        )
        row[LOG_REF_ATTITUDE_START + 2] = s.reals[at.reference_heading] + late * s.reals[at.reference_heading_rate]
        row[LOG_MISSION_STATE_COLUMN] = s.ints[at.state]
        _copy_to_row(row, LOG_ROW_SIZE, p.ranges)
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _end_period(p: LoopArguments) -> int:
    c = p.clock
    if c.log_or_motors_changed != 0:
        return STOP_LOG_OR_MODE_CHANGED
    if c.stop_when_valid > 0 and c.is_estimate_valid > 0:
        return STOP_ESTIMATE_VALID
    return CONTINUE_LOOP


def _compile_stepper(begin: Any, measure: Any, estimate: Any) -> Any:
    stepper = make_stage_loop(
        begin, advance_plant, _check_contact, measure, estimate, _step_software, _write_log_row, _end_period
    )
    return cached_njit(stepper, inline="always", error_model="numpy")


_step_ideal = _compile_stepper(_begin_ideal_period, _measure_truth, _publish_truth)
_step_fitted = _compile_stepper(_begin_sensed_period, sample_sensors, _step_filter)


@cached_njit(error_model="numpy")
def run_ideal_periods(p: IdealLoopArguments) -> int:
    """Run periods of a flight without sensor errors, from stage ``p.clock.stage``; return why the run stopped.

    The result is the code that a stage returned in place of ``CONTINUE_LOOP``.
    """
    return _step_ideal(refer_to(p))


@cached_njit(error_model="numpy")
def run_sensed_periods(p: SensedLoopArguments) -> int:
    """Run periods of a flight with sensors and filter, from stage ``p.clock.stage``; return why the run stopped.

    The result is the code that a stage returned in place of ``CONTINUE_LOOP``.
    """
    return _step_fitted(refer_to(p))
