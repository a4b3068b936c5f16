"""Compiled loop over simulation periods: plant, sensors, filter and flight software in each period."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.model_state import RS_POS, RS_RATES, RS_VEL, STATE_SIZE
from mufly.estimate import sensor_checks as g
from mufly.estimate.filter_records import (
    ERROR_STATE_COUNT,
    EX_ATT,
    EX_GYRO_BIAS,
    R_ACCELERATION,
    R_BATTERY,
    R_RATES,
    R_RING,
    READING_OFFSETS,
    READING_STARTS,
    READING_WIDTHS,
    SENSOR_COUNT,
    STATE_COUNT,
    SX_POS,
    SX_VEL,
)
from mufly.estimate.output_predictor import COVARIANCE_INTERVAL_TICKS
from mufly.estimate.sensor_checks import ACTUATOR_START, CLIPPING_START
from mufly.flight.simulated_plant import advance_period, find_collision, true_attitude
from mufly.numba_cache import cached_njit
from mufly.numba_intrinsics import borrow_arrays, call_c_function
from mufly.sensors.imu import GYRO, simulate_imu_period
from mufly.sensors.periodic import FIRST_VALUE, IS_VALID, MEASURED_TIME
from mufly.sensors.readings import measure_ranges
from mufly.sensors.rng import draw_normals
from mufly.sensors.sampling import SAMPLED_READINGS, sample_all

_Array = NDArray[np.float64]

MAX_PERIODS_PER_CALL = 1024
"""Maximum number of periods per call."""

# Reasons for the return to Python
(
    EXIT_DONE,
    EXIT_SAMPLE_SENSORS,
    EXIT_UPDATE_STATUS,
    EXIT_LOG_OR_MODE_CHANGED,
    EXIT_CONTACT,
    EXIT_NOT_FINITE,
    EXIT_ESTIMATE_VALID,
    EXIT_CALL_LISTENER,
) = range(8)
# Phases of a period, for resumption
PHASE_ADVANCE_PLANT, PHASE_ESTIMATE, PHASE_CONTROL = range(3)
# Indices of the integer state
(
    C_LOOP_PHASE,
    C_TICK,
    C_STOP_TICK,
    C_WIND_SAMPLES,
    C_RING_INTERVAL,
    C_CONTACT_INTERVAL,
    C_RECORD_INTERVAL,
    C_IS_ARMED,
    C_IS_VALID,
    C_STOP_WHEN_VALID,
    C_FILTER_PERIODS,
    C_PERIODS_RUN,
    C_LOG_ROWS,
    C_LAST_DUE_TICK,
    C_IMU_SAMPLED,
    C_PLANT_STEPS,
    C_LISTEN_INTERVAL,
    C_LAST_LISTEN_TICK,
    C_LAST_RING_TICK,
    C_BEAM_COUNT,
    C_STATUS_ROWS,
    C_LISTENER_ROWS,
    C_IS_UNTROUBLED,
    C_SIZE,
) = range(24)
# Indices of the floating-point state
(
    F_RATE_HZ,
    F_STEP_S,
    F_CONTACT_RADIUS,
    F_HOVER_CURRENT_A,
    F_CURRENT_A,
    F_CURRENT_BLEND,
    F_NEXT_PYTHON_SAMPLE_S,
    F_LAST_IMU_S,
    F_NEXT_SAMPLE_S,
    F_SIZE,
) = range(10)
# Offsets in the C records, in units of eight, four or one byte
(
    _B_TIME, _B_MOTION, _B_VALID, _S_MOTORS, _S_LATE_S, _S_LOG_COUNT, _S_FINISHED, _S_STATE, _S_POSITION, _S_VELOCITY,
    _S_HEADING, _S_HEADING_RATE, _S_TILT, _B_RANGES, _B_POSITION_VARIANCE, _B_ATTITUDE_VARIANCE,
    _B_SPECIFIC_FORCE, _B_CHECKS, _B_CHECK, _SENSOR_STATUS_CODE_OFFSET, _B_REASON,
) = range(21)  # fmt: skip
_MOTORS_OFF, _MOTORS_FLY = 0, 2
# First columns of a log row: time, state, attitude, wind, battery, active actuators, reference, mission state; the
# ranges follow
ROW_TIME, ROW_STATE, ROW_ATT, ROW_WIND, ROW_SUPPLY, ROW_MOTORS, ROW_SERVOS = 0, 1, 22, 25, 28, 30, 32
ROW_REF_POS, ROW_REF_VEL, ROW_REF_ATT, ROW_MISSION, LOG_ROW_SIZE = 34, 37, 40, 43, 44
# Offsets in the C record of motion (controllers.h)
_M_POS, _M_VEL, _M_ATT, _M_RATES, _M_VOLTAGE = 0, 3, 6, 9, 12
# First address of each C function and its arguments
_TO_SOFTWARE, _TO_FILTER = 0, 6
_ACCEL_START, _RATES_START, _VOLTAGE_START = (
    READING_STARTS[R_ACCELERATION],
    READING_STARTS[R_RATES],
    READING_STARTS[R_BATTERY],
)
# Status row (:data:`mufly.estimate.kalman_estimator.PUBLISHED_FIELDS`): covariance (9, 9), standard deviations, seven
# numbers of each sensor, the faulty component of the position fix, and the period
SIGMA_START = EX_GYRO_BIAS**2
SENSOR_STATUS_START = SIGMA_START + ERROR_STATE_COUNT
_STATUS, _REASON, _NUMBER, _INNOVATION, _SPREAD, _FUSED, _NEW, SENSOR_WIDE = range(8)
FAULT_COMPONENT_INDEX = SENSOR_STATUS_START + SENSOR_WIDE * SENSOR_COUNT
TICK_INDEX = FAULT_COMPONENT_INDEX + 1
STATUS_ROW_SIZE = TICK_INDEX + 1
# Listener row: period, validity, battery (V), index of the status row; wind, supply, accelerometer reading, state,
# attitude, nominal state, rates, angles; the ranges follow
HEARD_TICK, HEARD_VALID, HEARD_VOLTS, HEARD_TOLD, HEARD_WIND, HEARD_SUPPLY, HEARD_FORCE, HEARD_STATE = (
    0,
    1,
    2,
    3,
    4,
    7,
    9,
    12,
)
HEARD_ATT = HEARD_STATE + STATE_SIZE
HEARD_OUT = HEARD_ATT + 3
HEARD_RATES = HEARD_OUT + STATE_COUNT
HEARD_ANGLES = HEARD_RATES + 3
LISTENER_ROW_SIZE = HEARD_ANGLES + 3


@cached_njit(error_model="numpy")
def _fill_readings(
    t: float,
    came: NDArray[np.uint8],
    told: _Array,
    z: _Array,
    new: NDArray[np.int32],
    age: _Array,
    fitted: NDArray[np.uint8],
    taken: _Array,
    pictures: _Array,
    used: NDArray[np.int64],
    ranges: _Array,
) -> bool:
    """Copy sensor readings into the filter's input row; return whether a range picture was among them."""
    seen = False
    for k in range(len(SAMPLED_READINGS)):
        r = SAMPLED_READINGS[k]
        if came[k] == 0 or r < 0 or fitted[r] == 0 or told[k, MEASURED_TIME] == taken[r]:
            continue
        row = told[k]
        taken[r] = row[MEASURED_TIME]
        age[r], new[r] = t - row[MEASURED_TIME], 1 if row[IS_VALID] != 0.0 else 2
        start = READING_STARTS[r]
        if r == R_RING:
            seen = True
            for j in range(used.size):
                z[start + j] = row[FIRST_VALUE + used[j]]
            for j in range(ranges.size):
                pictures[0, j], pictures[1, j], pictures[2, j] = (
                    pictures[1, j],
                    pictures[2, j],
                    row[FIRST_VALUE + j],
                )
                a, b, c = pictures[0, j], pictures[1, j], pictures[2, j]
                ranges[j] = max(min(a, b), min(max(a, b), c))
        else:
            for j in range(READING_WIDTHS[r]):
                z[start + j] = row[FIRST_VALUE + j] - READING_OFFSETS[r]
    return seen


@cached_njit(error_model="numpy")
def _write_filter_status(
    memory: tuple[Any, ...],
    fitted: NDArray[np.uint8],
    calm: int,
    texts: NDArray[np.int64],
    before: _Array,
    row: _Array,
    said: NDArray[np.int32],
    at: NDArray[np.int64],
) -> bool:
    """Write the filter's status into a row and the C record; return whether Python need not format texts.

    ``texts`` are the text numbers of the reasons, -1 for texts that contain a value. ``calm``: waiting and fused
    sensors need no report.
    """
    covariance, sigma, code, why, number, innovation, spread, used, came, component, tick = memory
    for j in range(EX_GYRO_BIAS):
        for k in range(EX_GYRO_BIAS):
            row[EX_GYRO_BIAS * j + k] = covariance[j, k]
    for k in range(ERROR_STATE_COUNT):
        row[SIGMA_START + k] = sigma[k]
    row[FAULT_COMPONENT_INDEX], row[TICK_INDEX] = component[0], tick[0]
    same = True
    for k in range(SENSOR_COUNT):
        start = SENSOR_STATUS_START + SENSOR_WIDE * k
        of, was = row[start : start + SENSOR_WIDE], before[start : start + SENSOR_WIDE]
        of[_STATUS], of[_REASON], of[_NUMBER], of[_INNOVATION] = code[k], why[k], number[k], innovation[k]
        of[_SPREAD], of[_FUSED], of[_NEW] = spread[k], used[k], came[k]
        if fitted[k] == 0:
            continue
        text = texts[why[k]]
        if code[k] == g.STATUS_WAITING and why[k] == g.REASON_NONE and came[k] == 0:
            text = texts[g.REASON_NO_READING]
        quiet = (
            calm != 0 and (code[k] == g.STATUS_WAITING or code[k] == g.STATUS_FUSED) and was[_STATUS] == was[_STATUS]
        )
        if quiet and text >= 0:
            one = at[_B_CHECKS] + k * at[_B_CHECK]
            said[one + at[_SENSOR_STATUS_CODE_OFFSET]], said[one + at[_B_REASON]] = code[k], text
        else:
            same = same and of[_STATUS] == was[_STATUS] and of[_REASON] == was[_REASON]
            same = same and (text >= 0 or of[_NUMBER] == was[_NUMBER])
            same = same and (text >= 0 or row[FAULT_COMPONENT_INDEX] == before[FAULT_COMPONENT_INDEX])
    return same


@cached_njit(error_model="numpy")
def _copy_to_row(row: _Array, at: int, values: _Array) -> int:
    """Copy values into a row from an index on; return the index behind them.

    (An assignment to a slice adds 2 s of compilation, for the text of its shape error.)
    """
    for k in range(values.size):
        row[at + k] = values[k]
    return at + values.size


@cached_njit(error_model="numpy")
def run_until_event(
    c: NDArray[np.int64],
    f: _Array,
    x: _Array,
    parameters: Any,
    wind: _Array,
    supply: _Array,
    attitude: _Array,
    packed: tuple[int, bool, _Array, _Array, _Array],
    acting: _Array,
    software: tuple[_Array, NDArray[np.int32], NDArray[np.uint8]],
    belief: tuple[_Array, NDArray[np.int32], NDArray[np.uint8]],
    out: _Array,
    at: NDArray[np.int64],
    to: NDArray[np.int64],
    log: _Array,
    seen: _Array,
    ring: Any,
    filtered: Any,
    imu: Any,
    asked: Any,
    shown: _Array,
    heard: _Array,
) -> int:
    """Advance until an event that Python handles; return the reason.

    Parameters
    ----------
    c, f : int64 and float64 arrays
        Integer and floating-point state, by the indices above.
    x, parameters, wind, supply, attitude
        State and parameters of the plant; ``wind`` (n, 3) of the coming periods (m/s).
    packed : tuple
        Legs, presence of obstacles, and the tables of the world.
    acting : (3, 4) array
        Actuator inputs of the last period, of this period, and last sent.
    software, belief : tuples of float64, int32 and uint8 arrays
        Views of the C records.
    out : (4,) array
        Actuator commands of the software.
    at : int64 array
        Offsets in the C records.
    to : int64 array
        Addresses of software_step with five arguments and of estimator_step with six.
    log : (n, columns) array
        Log row of each recorded period.
    seen : (n,) array
        Ranges of the ring, as published (m).
    ring : None, or tuple
        Arguments of :func:`mufly.sensors.readings.measure_ranges` after the state, for an ideal ring.
    filtered : None, or tuple of arrays
        Output of the filter (state, rates, angles); its readings with flags of new ones and ages; fitted sensors,
        sampling times, range pictures and beams in use; published fields of its memory; text numbers of the reasons.
    imu : None, or tuple
        Previous state; random generator and buffer of normal numbers; reading and clipping counts (6,); remaining
        arguments of ``simulate_imu_period``.
    asked : None, or tuple
        Arguments of :func:`mufly.sensors.sampling.sample_all` after the supply; required with a filter, as ``imu`` is.
    shown, heard : (n, columns) arrays
        Status rows, the first being the previous one; listener rows.
    """
    # The caller owns all arrays and waits, so borrowing is safe.
    c, f, x, parameters, wind, supply, attitude = borrow_arrays((c, f, x, parameters, wind, supply, attitude))
    packed, acting, at, to, out, log, seen = borrow_arrays((packed, acting, at, to, out, log, seen))
    shown, heard = borrow_arrays((shown, heard))
    legs, obstacles, boxes, cylinders, limits = packed
    sd, si, sb = borrow_arrays(software)
    bd, bi, bb = borrow_arrays(belief)
    now = at[_B_MOTION]
    if ring is not None:
        eyes = borrow_arrays(ring)
    if filtered is not None:
        told, rates, angles, z, new, age, fitted, taken, pictures, used, memory, texts = borrow_arrays(filtered)
        was, source, normal, read, clipped, unit = borrow_arrays(imu)
        quiet, came, said, all_parts = borrow_arrays(asked)
        covariance = memory[0]
    while True:
        if c[C_LOOP_PHASE] == PHASE_ADVANCE_PLANT:
            if c[C_TICK] >= c[C_STOP_TICK] or c[C_WIND_SAMPLES] >= wind.shape[0] or c[C_LOG_ROWS] >= log.shape[0]:
                return EXIT_DONE
            if (
                c[C_LISTEN_INTERVAL] > 0
                and c[C_TICK] % c[C_LISTEN_INTERVAL] == 0
                and c[C_TICK] != c[C_LAST_LISTEN_TICK]
            ):
                c[C_LAST_LISTEN_TICK] = c[C_TICK]
                if filtered is None:
                    return EXIT_CALL_LISTENER
                else:  # Numba omits the unreachable branch
                    row = heard[c[C_LISTENER_ROWS]]
                    c[C_LISTENER_ROWS] += 1
                    row[HEARD_TICK], row[HEARD_VALID] = c[C_TICK], c[C_IS_VALID]
                    row[HEARD_VOLTS], row[HEARD_TOLD] = z[_VOLTAGE_START], c[C_STATUS_ROWS]
                    n = _copy_to_row(row, HEARD_WIND, wind[c[C_WIND_SAMPLES] - 1])
                    n = _copy_to_row(row, _copy_to_row(row, n, supply), z[_ACCEL_START : _ACCEL_START + 3])
                    n = _copy_to_row(row, _copy_to_row(row, n, x), attitude)
                    n = _copy_to_row(row, _copy_to_row(row, _copy_to_row(row, n, told), rates), angles)
                    _copy_to_row(row, n, seen)
            if filtered is not None:
                _copy_to_row(was, 0, x)
            advance_period(x, acting[1], wind[c[C_WIND_SAMPLES]], parameters, f[F_STEP_S], c[C_PLANT_STEPS], supply)
            c[C_WIND_SAMPLES] += 1
            c[C_TICK] += 1
            for k in range(4):
                acting[0, k], acting[1, k] = acting[1, k], acting[2, k]
            if not math.isfinite(x[RS_POS + 2]):
                return EXIT_NOT_FINITE
            t = c[C_TICK] / f[F_RATE_HZ]
            if c[C_TICK] % c[C_CONTACT_INTERVAL] == 0:
                if find_collision(x, parameters, legs, f[F_CONTACT_RADIUS], obstacles, boxes, cylinders, limits):
                    return EXIT_CONTACT
                drawn = supply[1] if si[at[_S_MOTORS]] == _MOTORS_FLY else f[F_HOVER_CURRENT_A]
                f[F_CURRENT_A] += f[F_CURRENT_BLEND] * (drawn - f[F_CURRENT_A])
            true_attitude(x, attitude)
            c[C_LOOP_PHASE] = PHASE_ESTIMATE
            if filtered is not None:
                for k in range(new.size):
                    new[k] = 0
                for k in range(4):
                    z[ACTUATOR_START + k] = acting[0, k]
                c[C_IMU_SAMPLED] += 1
                draw_normals(source, normal)
                simulate_imu_period(was, x, t - f[F_LAST_IMU_S], t, normal, *unit, read, clipped)
                f[F_LAST_IMU_S] = t
                for k in range(3):
                    z[_ACCEL_START + k], z[_RATES_START + k], z[CLIPPING_START + k] = (
                        read[k],
                        read[GYRO + k],
                        clipped[k],
                    )
                new[R_ACCELERATION] = new[R_RATES] = 1
                age[R_ACCELERATION] = age[R_RATES] = 0.0
                if t >= f[F_NEXT_SAMPLE_S]:
                    f[F_NEXT_SAMPLE_S] = sample_all(t, x, attitude, supply, quiet, came, said, all_parts)
                    if _fill_readings(t, came, said, z, new, age, fitted, taken, pictures, used, seen):
                        for k in range(c[C_BEAM_COUNT]):
                            bd[at[_B_RANGES] + k] = seen[k]
            if ring is not None and c[C_TICK] % c[C_RING_INTERVAL] == 0:
                measure_ranges(x, *eyes, seen)
                c[C_LAST_RING_TICK] = c[C_TICK]
                for k in range(c[C_BEAM_COUNT]):
                    bd[at[_B_RANGES] + k] = seen[k]
            if t >= f[F_NEXT_PYTHON_SAMPLE_S]:
                return EXIT_SAMPLE_SENSORS
        t = c[C_TICK] / f[F_RATE_HZ]
        if c[C_LOOP_PHASE] == PHASE_ESTIMATE:
            bd[at[_B_TIME]] = t
            if filtered is None:
                for k in range(3):
                    bd[now + _M_POS + k], bd[now + _M_VEL + k] = x[RS_POS + k], x[RS_VEL + k]
                    bd[now + _M_ATT + k], bd[now + _M_RATES + k] = attitude[k], x[RS_RATES + k]
                bd[now + _M_VOLTAGE] = supply[0]
            else:
                i = _TO_FILTER
                valid = call_c_function(to[i], (to[i + 1], to[i + 2], to[i + 3], to[i + 4], to[i + 5], to[i + 6])) & 1
                for k in range(3):
                    bd[now + _M_POS + k], bd[now + _M_VEL + k] = told[SX_POS + k], told[SX_VEL + k]
                    bd[now + _M_ATT + k], bd[now + _M_RATES + k] = angles[k], rates[k]
                    bd[at[_B_SPECIFIC_FORCE] + k] = z[_ACCEL_START + k]
                volts = z[_VOLTAGE_START]
                bd[now + _M_VOLTAGE] = volts if volts != 0.0 else math.nan
                bb[at[_B_VALID]] = c[C_IS_VALID] = valid
                c[C_FILTER_PERIODS] += 1
            c[C_LOOP_PHASE] = PHASE_CONTROL
            if filtered is not None and c[C_FILTER_PERIODS] % COVARIANCE_INTERVAL_TICKS == 0:
                n = c[C_STATUS_ROWS]
                c[C_STATUS_ROWS] += 1
                if not _write_filter_status(memory, fitted, c[C_IS_UNTROUBLED], texts, shown[n], shown[n + 1], bi, at):
                    return EXIT_UPDATE_STATUS
                for k in range(3):
                    bd[at[_B_POSITION_VARIANCE] + k] = covariance[k, k]
                    bd[at[_B_ATTITUDE_VARIANCE] + k] = covariance[EX_ATT + k, EX_ATT + k]
        logged, motors, finished = si[at[_S_LOG_COUNT]], si[at[_S_MOTORS]], sb[at[_S_FINISHED]]
        i = _TO_SOFTWARE
        call_c_function(to[i], (to[i + 1], to[i + 2], to[i + 3], to[i + 4], to[i + 5]))
        runs = c[C_IS_ARMED] > 0 or si[at[_S_MOTORS]] == _MOTORS_OFF
        for k in range(4):
            acting[2, k] = out[k] if runs else 0.0
        late = sd[at[_S_LATE_S]]
        if late == 0.0:
            c[C_LAST_DUE_TICK] = c[C_TICK]
        c[C_PERIODS_RUN] += 1
        if c[C_TICK] % c[C_RECORD_INTERVAL] == 0:
            row = log[c[C_LOG_ROWS]]
            c[C_LOG_ROWS] += 1
            row[ROW_TIME] = t
            n = _copy_to_row(
                row, _copy_to_row(row, _copy_to_row(row, ROW_STATE, x), attitude), wind[c[C_WIND_SAMPLES] - 1]
            )
            _copy_to_row(row, _copy_to_row(row, n, supply), acting[1])
            for k in range(3):
                way = sd[at[_S_VELOCITY] + k]
                row[ROW_REF_POS + k] = sd[at[_S_POSITION] + k] + late * way
                row[ROW_REF_VEL + k] = way
            row[ROW_REF_ATT], row[ROW_REF_ATT + 1] = sd[at[_S_TILT]], sd[at[_S_TILT] + 1]
            row[ROW_REF_ATT + 2] = sd[at[_S_HEADING]] + late * sd[at[_S_HEADING_RATE]]
            row[ROW_MISSION] = si[at[_S_STATE]]
            _copy_to_row(row, LOG_ROW_SIZE, seen)
        c[C_LOOP_PHASE] = PHASE_ADVANCE_PLANT
        if si[at[_S_LOG_COUNT]] != logged or si[at[_S_MOTORS]] != motors or sb[at[_S_FINISHED]] != finished:
            return EXIT_LOG_OR_MODE_CHANGED
        if c[C_STOP_WHEN_VALID] > 0 and c[C_IS_VALID] > 0:
            return EXIT_ESTIMATE_VALID
