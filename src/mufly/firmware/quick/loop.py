"""The compiled loop of many periods: plant, sensors, filter and flight software, one after the other in each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.calling import call_at, lent
from mufly.compiled import compiled
from mufly.dynamics.state import RS_POS, RS_RATES, RS_VEL, STATE_SIZE
from mufly.estimate import sensor_checks as g
from mufly.estimate.layout import (
    ERRORS,
    EX_ATT,
    EX_GYRO_BIAS,
    R_ACCELERATION,
    R_BATTERY,
    R_FIX,
    R_MAGNET,
    R_PRESSURE,
    R_RATES,
    R_RING,
    R_ROTOR,
    R_SONAR,
    SENSORS,
    STARTS,
    STATES,
    SX_POS,
    SX_VEL,
    WIDTHS,
)
from mufly.estimate.output_predictor import TOLD_EVERY
from mufly.estimate.sensor_checks import ACTING, CLIPPING
from mufly.flight.plant import plant_period, touched, true_attitude
from mufly.sensors.drawing import normals
from mufly.sensors.imu import GYRO, imu_period
from mufly.sensors.periodic import STANDS, TAKEN, VALUES
from mufly.sensors.pressure import STANDARD_PRESSURE_PA
from mufly.sensors.readings import see
from mufly.sensors.together import ask

_Array = NDArray[np.float64]

MOST = 1024
"""Periods of one call at most."""

# Why the loop came back
DONE, SENSE, TELL, SAID, TOUCHED, BROKEN, VALID, HEARD = range(8)
# Where it goes on in a period
ADVANCE, SENSED, TOLD = range(3)
# Whole numbers that it keeps
(
    C_PHASE, C_TICK, C_STOP, C_BLOWN, C_RING, C_LOOK, C_EVERY, C_ARMED, C_VALID, C_UNTIL_VALID, C_TELLS, C_PERIODS,
    C_ROWS, C_DUE, C_DREW, C_STEPS, C_LISTEN, C_HEARD, C_LOOKED, C_BEAMS, C_TOLD_ROWS, C_HEARD_ROWS, C_CALM, COUNTS,
) = range(24)  # fmt: skip
# Numbers that it keeps
F_RATE, F_STEP_S, F_RADIUS, F_HOVER_A, F_CURRENT_A, F_BLEND, F_WAKE_S, F_DRAWN_S, F_ASK_S, NUMBERS = range(10)
# Where things lie in the records of C, in units of eight, four or one byte
(
    _B_TIME, _B_MOTION, _B_VALID, _S_MOTORS, _S_LATE, _S_LOGGED, _S_FINISHED, _S_STATE, _S_POSITION, _S_VELOCITY,
    _S_HEADING, _S_TURN, _S_TILT, _B_RANGES, _B_PLACE_VARIANCE, _B_TURN_VARIANCE,
    _B_CHECKS, _B_CHECK, _B_STATUS, _B_WHY,
) = range(20)  # fmt: skip
_MOTORS_OFF, _MOTORS_FLY = 0, 2
# First columns of what is kept of a period: time, state, attitude, wind, battery, what acts, reference, mission; beams
# follow
ROW_TIME, ROW_STATE, ROW_ATT, ROW_WIND, ROW_SUPPLY, ROW_MOTORS, ROW_SERVOS = 0, 1, 22, 25, 28, 30, 32
ROW_REF_POS, ROW_REF_VEL, ROW_REF_ATT, ROW_MISSION, ROW_WIDE = 34, 37, 40, 43, 44
# First numbers of C's record of motion (controllers.h)
_M_POS, _M_VEL, _M_ATT, _M_RATES, _M_VOLTAGE = 0, 3, 6, 9, 12
# Where the addresses of each function of C start
_TO_SOFTWARE, _TO_FILTER = 0, 6
_ACC, _RATE_AT, _VOLT = STARTS[R_ACCELERATION], STARTS[R_RATES], STARTS[R_BATTERY]
# Of what is told every so often (:data:`mufly.estimate.fitted.SHOWN`), a row: covariance (9, 9), deviations, then of
# each sensor seven numbers, the component of the fix that its fault is of, and the period
DEVIATIONS = EX_GYRO_BIAS**2
OF_SENSORS = DEVIATIONS + ERRORS
_STATUS, _REASON, _NUMBER, _INNOVATION, _SPREAD, _FUSED, _NEW, SENSOR_WIDE = range(8)
COMPONENT_AT = OF_SENSORS + SENSOR_WIDE * SENSORS
PERIOD_AT = COMPONENT_AT + 1
SHOWN_WIDE = PERIOD_AT + 1
# Of what somebody hears, a row: period, whether valid, battery (V), rows told before; wind, supply, state, attitude,
# nominal state, rates, angles; ranges follow
HEARD_TICK, HEARD_VALID, HEARD_VOLTS, HEARD_TOLD, HEARD_WIND, HEARD_SUPPLY, HEARD_STATE = 0, 1, 2, 3, 4, 7, 9
HEARD_ATT = HEARD_STATE + STATE_SIZE
HEARD_OUT = HEARD_ATT + 3
HEARD_RATES = HEARD_OUT + STATES
HEARD_ANGLES = HEARD_RATES + 3
HEARD_WIDE = HEARD_ANGLES + 3
# Places of the sensors of ``ask`` in the filter's tables
_PLACES = (R_SONAR, R_RING, R_PRESSURE, R_MAGNET, R_ROTOR, R_BATTERY, R_FIX)


@compiled(error_model="numpy")
def _lay(
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
    """Lay what sensors said into the filter's row (:meth:`KalmanEstimator.hear`); whether it was a picture."""
    seen = False
    for k in range(7):
        r = _PLACES[k]
        if came[k] == 0 or fitted[r] == 0 or told[k, TAKEN] == taken[r]:
            continue
        row = told[k]
        taken[r] = row[TAKEN]
        age[r], new[r] = t - row[TAKEN], 1 if row[STANDS] != 0.0 else 2
        start = STARTS[r]
        if r == R_RING:
            seen = True
            for j in range(used.size):
                z[start + j] = row[VALUES + used[j]]
            for j in range(ranges.size):
                pictures[0, j], pictures[1, j], pictures[2, j] = (
                    pictures[1, j],
                    pictures[2, j],
                    row[VALUES + j],
                )
                a, b, c = pictures[0, j], pictures[1, j], pictures[2, j]
                ranges[j] = max(min(a, b), min(max(a, b), c))
        elif r == R_PRESSURE:
            z[start] = row[VALUES] - STANDARD_PRESSURE_PA
        else:
            for j in range(WIDTHS[r]):
                z[start + j] = row[VALUES + j]
    return seen


@compiled(error_model="numpy")
def _show(
    memory: tuple[Any, ...],
    fitted: NDArray[np.uint8],
    calm: int,
    texts: NDArray[np.int64],
    before: _Array,
    row: _Array,
    said: NDArray[np.int32],
    at: NDArray[np.int64],
) -> bool:
    """Write what is told every so often into a row and the record of C; whether that needs no words of Python.

    ``texts`` are the numbers of the words for a reason, or -1 where there is a number in them; ``calm``: nothing is
    said of a sensor that is waited for or believed.
    """
    covariance, sigma, code, why, number, innovation, spread, used, came, component, tick = memory
    for j in range(EX_GYRO_BIAS):
        for k in range(EX_GYRO_BIAS):
            row[EX_GYRO_BIAS * j + k] = covariance[j, k]
    for k in range(ERRORS):
        row[DEVIATIONS + k] = sigma[k]
    row[COMPONENT_AT], row[PERIOD_AT] = component[0], tick[0]
    same = True
    for k in range(SENSORS):
        start = OF_SENSORS + SENSOR_WIDE * k
        of, was = row[start : start + SENSOR_WIDE], before[start : start + SENSOR_WIDE]
        of[_STATUS], of[_REASON], of[_NUMBER], of[_INNOVATION] = code[k], why[k], number[k], innovation[k]
        of[_SPREAD], of[_FUSED], of[_NEW] = spread[k], used[k], came[k]
        if fitted[k] == 0:
            continue
        text = texts[why[k]]
        if code[k] == g.NOTHING and why[k] == g.FINE and came[k] == 0:
            text = texts[g.NOTHING_YET]
        quiet = calm != 0 and (code[k] == g.NOTHING or code[k] == g.FUSED) and was[_STATUS] == was[_STATUS]
        if quiet and text >= 0:
            one = at[_B_CHECKS] + k * at[_B_CHECK]
            said[one + at[_B_STATUS]], said[one + at[_B_WHY]] = code[k], text
        else:
            same = same and of[_STATUS] == was[_STATUS] and of[_REASON] == was[_REASON]
            same = same and (text >= 0 or of[_NUMBER] == was[_NUMBER])
            same = same and (text >= 0 or row[COMPONENT_AT] == before[COMPONENT_AT])
    return same


@compiled(error_model="numpy")
def _put(row: _Array, at: int, values: _Array) -> int:
    """Put numbers into a row from a place on; return the place after them.

    (An assignment to a slice compiles the message that two shapes differ, with all that strings need: 2 s.)
    """
    for k in range(values.size):
        row[at + k] = values[k]
    return at + values.size


@compiled(error_model="numpy")
def go_on(
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
    """Advance until something is due that Python does; return what.

    Parameters
    ----------
    c, f : int64 and float64 arrays
        Counts and numbers, by the names above.
    x, parameters, wind, supply, attitude
        Of the plant; ``wind`` (n, 3) of the periods to come.
    packed : tuple
        Legs, whether there are obstacles, and the tables of the world.
    acting : (3, 4) array
        What acted in the last period, acts now, was sent last.
    software, belief : tuples of float64, int32 and uint8 arrays
        Views of the records of C.
    out : (4,) array
        What the software wants.
    at : int64 array
        Where things lie in those records.
    to : int64 array
        Addresses: software_step and its five arguments, estimator_step and its six.
    log : (n, columns) array
        A row for every recorded period.
    seen : (n,) array
        Beams of the ring, as told.
    ring : None, or tuple
        What :func:`mufly.sensors.readings.see` takes after the state, for a ring without errors.
    filtered : None, or tuple of arrays
        What the filter tells (state, rates, angles), and its readings, which are new, and their ages; which it takes,
        when they were taken, pictures, which beams; and of its memory what is told every so often.
    imu : None, or tuple
        State before; what to draw from, room for normal numbers, what it reads and how often it clipped (6,), and the
        rest of what ``imu_period`` takes.
    asked : None, or tuple
        What :func:`mufly.sensors.together.ask` takes after the supply. With a filter there are unit and sensors.
    shown, heard : (n, columns) arrays
        Rows of what is told every so often, the first as it was before; and of what somebody hears.
    """
    # All of it is the caller's, who waits.
    c, f, x, parameters, wind, supply, attitude = lent((c, f, x, parameters, wind, supply, attitude))
    packed, acting, at, to, out, log, seen = lent((packed, acting, at, to, out, log, seen))
    shown, heard = lent((shown, heard))
    legs, obstacles, boxes, cylinders, limits = packed
    sd, si, sb = lent(software)
    bd, bi, bb = lent(belief)
    now = at[_B_MOTION]
    if ring is not None:
        eyes = lent(ring)
    if filtered is not None:
        told, rates, angles, z, new, age, fitted, taken, pictures, used, memory, texts = lent(filtered)
        was, source, normal, read, clipped, unit = lent(imu)
        quiet, came, said, all_parts = lent(asked)
        covariance = memory[0]
    while True:
        if c[C_PHASE] == ADVANCE:
            if c[C_TICK] >= c[C_STOP] or c[C_BLOWN] >= wind.shape[0] or c[C_ROWS] >= log.shape[0]:
                return DONE
            if c[C_LISTEN] > 0 and c[C_TICK] % c[C_LISTEN] == 0 and c[C_TICK] != c[C_HEARD]:
                c[C_HEARD] = c[C_TICK]
                if filtered is None:
                    return HEARD
                else:  # Numba leaves out what is never reached
                    row = heard[c[C_HEARD_ROWS]]
                    c[C_HEARD_ROWS] += 1
                    row[HEARD_TICK], row[HEARD_VALID] = c[C_TICK], c[C_VALID]
                    row[HEARD_VOLTS], row[HEARD_TOLD] = z[_VOLT], c[C_TOLD_ROWS]
                    n = _put(row, HEARD_WIND, wind[c[C_BLOWN] - 1])
                    n = _put(row, _put(row, _put(row, n, supply), x), attitude)
                    n = _put(row, _put(row, _put(row, n, told), rates), angles)
                    _put(row, n, seen)
            if filtered is not None:
                _put(was, 0, x)
            plant_period(x, acting[1], wind[c[C_BLOWN]], parameters, f[F_STEP_S], c[C_STEPS], supply)
            c[C_BLOWN] += 1
            c[C_TICK] += 1
            for k in range(4):
                acting[0, k], acting[1, k] = acting[1, k], acting[2, k]
            if not math.isfinite(x[RS_POS + 2]):
                return BROKEN
            t = c[C_TICK] / f[F_RATE]
            if c[C_TICK] % c[C_LOOK] == 0:
                if touched(x, parameters, legs, f[F_RADIUS], obstacles, boxes, cylinders, limits):
                    return TOUCHED
                drawn = supply[1] if si[at[_S_MOTORS]] == _MOTORS_FLY else f[F_HOVER_A]
                f[F_CURRENT_A] += f[F_BLEND] * (drawn - f[F_CURRENT_A])
            true_attitude(x, attitude)
            c[C_PHASE] = SENSED
            if filtered is not None:
                for k in range(new.size):
                    new[k] = 0
                for k in range(4):
                    z[ACTING + k] = acting[0, k]
                c[C_DREW] += 1
                normals(source, normal)
                imu_period(was, x, t - f[F_DRAWN_S], t, normal, *unit, read, clipped)
                f[F_DRAWN_S] = t
                for k in range(3):
                    z[_ACC + k], z[_RATE_AT + k], z[CLIPPING + k] = read[k], read[GYRO + k], clipped[k]
                new[R_ACCELERATION] = new[R_RATES] = 1
                age[R_ACCELERATION] = age[R_RATES] = 0.0
                if t >= f[F_ASK_S]:
                    f[F_ASK_S] = ask(t, x, attitude, supply, quiet, came, said, all_parts)
                    if _lay(t, came, said, z, new, age, fitted, taken, pictures, used, seen):
                        for k in range(c[C_BEAMS]):
                            bd[at[_B_RANGES] + k] = seen[k]
            if ring is not None and c[C_TICK] % c[C_RING] == 0:
                see(x, *eyes, seen)
                c[C_LOOKED] = c[C_TICK]
                for k in range(c[C_BEAMS]):
                    bd[at[_B_RANGES] + k] = seen[k]
            if t >= f[F_WAKE_S]:
                return SENSE
        t = c[C_TICK] / f[F_RATE]
        if c[C_PHASE] == SENSED:
            bd[at[_B_TIME]] = t
            if filtered is None:
                for k in range(3):
                    bd[now + _M_POS + k], bd[now + _M_VEL + k] = x[RS_POS + k], x[RS_VEL + k]
                    bd[now + _M_ATT + k], bd[now + _M_RATES + k] = attitude[k], x[RS_RATES + k]
                bd[now + _M_VOLTAGE] = supply[0]
            else:
                i = _TO_FILTER
                valid = call_at(to[i], (to[i + 1], to[i + 2], to[i + 3], to[i + 4], to[i + 5], to[i + 6])) & 1
                for k in range(3):
                    bd[now + _M_POS + k], bd[now + _M_VEL + k] = told[SX_POS + k], told[SX_VEL + k]
                    bd[now + _M_ATT + k], bd[now + _M_RATES + k] = angles[k], rates[k]
                volts = z[_VOLT]
                bd[now + _M_VOLTAGE] = volts if volts != 0.0 else math.nan
                bb[at[_B_VALID]] = c[C_VALID] = valid
                c[C_TELLS] += 1
            c[C_PHASE] = TOLD
            if filtered is not None and c[C_TELLS] % TOLD_EVERY == 0:
                n = c[C_TOLD_ROWS]
                c[C_TOLD_ROWS] += 1
                if not _show(memory, fitted, c[C_CALM], texts, shown[n], shown[n + 1], bi, at):
                    return TELL
                for k in range(3):
                    bd[at[_B_PLACE_VARIANCE] + k] = covariance[k, k]
                    bd[at[_B_TURN_VARIANCE] + k] = covariance[EX_ATT + k, EX_ATT + k]
        logged, motors, finished = si[at[_S_LOGGED]], si[at[_S_MOTORS]], sb[at[_S_FINISHED]]
        i = _TO_SOFTWARE
        call_at(to[i], (to[i + 1], to[i + 2], to[i + 3], to[i + 4], to[i + 5]))
        runs = c[C_ARMED] > 0 or si[at[_S_MOTORS]] == _MOTORS_OFF
        for k in range(4):
            acting[2, k] = out[k] if runs else 0.0
        late = sd[at[_S_LATE]]
        if late == 0.0:
            c[C_DUE] = c[C_TICK]
        c[C_PERIODS] += 1
        if c[C_TICK] % c[C_EVERY] == 0:
            row = log[c[C_ROWS]]
            c[C_ROWS] += 1
            row[ROW_TIME] = t
            n = _put(row, _put(row, _put(row, ROW_STATE, x), attitude), wind[c[C_BLOWN] - 1])
            _put(row, _put(row, n, supply), acting[1])
            for k in range(3):
                way = sd[at[_S_VELOCITY] + k]
                row[ROW_REF_POS + k] = sd[at[_S_POSITION] + k] + late * way
                row[ROW_REF_VEL + k] = way
            row[ROW_REF_ATT], row[ROW_REF_ATT + 1] = sd[at[_S_TILT]], sd[at[_S_TILT] + 1]
            row[ROW_REF_ATT + 2] = sd[at[_S_HEADING]] + late * sd[at[_S_TURN]]
            row[ROW_MISSION] = si[at[_S_STATE]]
            _put(row, ROW_WIDE, seen)
        c[C_PHASE] = ADVANCE
        if si[at[_S_LOGGED]] != logged or si[at[_S_MOTORS]] != motors or sb[at[_S_FINISHED]] != finished:
            return SAID
        if c[C_UNTIL_VALID] > 0 and c[C_VALID] > 0:
            return VALID
