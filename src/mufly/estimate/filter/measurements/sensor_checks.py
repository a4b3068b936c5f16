"""Check readings by themselves and against the models, and maintain the status of each sensor.

| fault | sign | detected after |
|---|---|---|
| NaN, or beyond all limits | value | one reading |
| frozen | equal bit for bit, of a sensor with noise | three readings |
| doubled | equal bit for bit, sooner than the sensor can measure | two readings; repeated ones are never used |
| late | older than latency and jitter allow | one reading; used if the horizon can be corrected with it |
| invalid time | no age, a negative age, or above 10 s | one reading; never used |
| silent | no reading for six periods (:attr:`FilterSettings.timeout`) | that time |
| gyroscope spike | a change of rates that the model's moments do not explain | at once; replaced by the model's rate |

The sonar rounds to centimetres and the battery monitor to 10 mV, so equal readings in a row are usual; innovations
detect a stuck sonar. One rejected reading is no alarm: a healthy sonar receives a false echo every 16 s. Rejections are
counted in a score that decays by 7 % with every fused reading. A score above :data:`REJECT_ALARM_SCORE` is reported
(:data:`SONAR_REJECT_ALARM_SCORE` for the sonar: four of 14).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import MODEL_SPEED_UPPER
from mufly.estimate.filter.filter_records import (
    ERROR_ATTITUDE,
    ERROR_GYRO_BIAS,
    ERROR_POSITION,
    ERROR_VELOCITY,
    PHASE_FLYING,
    PHASE_LIFTING_OFF,
    READING_ACCELERATION,
    READING_BATTERY,
    READING_POSITION_FIX,
    READING_RANGE_RING,
    READING_RATES,
    READING_ROTOR_SPEED,
    READING_SONAR,
    READING_STARTS,
    ROTOR_ANG_ACCEL,
    ROTOR_FORCE_HISTORY,
    SENSOR_COUNT,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.ud_filter import inflate_variance

_Array = NDArray[np.float64]

ACTUATOR_START = READING_STARTS[-1]
CLIPPING_START = ACTUATOR_START + 4
INPUT_VALUE_COUNT = CLIPPING_START + 3
STATUS_WAITING, STATUS_FUSED, STATUS_REJECTED, STATUS_MISSING, STATUS_FAULTY = range(5)
"""Codes of a sensor's status."""
(
    REASON_NONE,
    REASON_NO_READING,
    REASON_TIMEOUT,
    REASON_LATE,
    REASON_OUT_OF_RANGE,
    REASON_FROZEN,
    REASON_DUPLICATED,
    REASON_INNOVATION,
    REASON_CLIPPING,
    REASON_TERRAIN_STEP,
    REASON_RESET,
    REASON_NO_ECHO,
    REASON_WALLS_TOO_FAR,
    REASON_NO_WALL,
    REASON_SPIKES,
    REASON_JUMP,
    REASON_TERRAIN_SLOPE,
    REASON_FUSED_THOUGH_OFFSET,
    REASON_HEIGHT_CONFLICT,
    REASON_STUCK,
    REASON_LARGE_BIAS,
    REASON_FORCE_CONFLICT,
    REASON_MODEL_WRONG,
    REASON_LEVELLED,
    REASON_FIELD_STRENGTH,
) = range(25)
"""Codes of the reason; :mod:`mufly.estimate.sensor_status` has the texts."""
REJECT_ALARM_SCORE, SONAR_REJECT_ALARM_SCORE, REJECT_SCORE_DECAY = 1.5, 3.0, 0.93
FAULT_HOLD_S = 0.5
"""Time for which a fault of one reading is reported (s)."""
_MAX_READING_AGE_S = 10.0
"""Age above which a reading is rejected (s); negative and NaN ages are rejected, too."""
_GYRO_SPIKE_RATE_RAD_S, _GYRO_SPIKE_AGREEMENT_RAD_S = 0.12, 0.06  # rad/s within a period, relative to the model
_GYRO_JUMP_REPEATS = 3
"""Agreeing spikes in a row that are a jump. Outliers in a quarter of the readings, uniform within 0.6 rad/s on three
axes, agree twice in a row every 80 s, and three times in a row every few days."""
_MAX_GYRO_OFFSET_RAD_S = 5.0  # rad/s: largest offset; repeated jumps beyond it indicate a diverging model
_GYRO_RESIDUAL_CARRY_FRACTION = 0.7  # fraction of the residual of the previous period
_GYRO_SPIKE_RESIDUAL_FACTOR = 3.0  # of the mean residual over some 50 ms
_ANG_ACCEL_BIAS_GAIN = 0.02  # fraction of a residual that is attributed to the model's moments
_MIN_CLIP_FRACTION = 0.02  # fraction of clipped samples that is reported
DIVERGED_GYRO_BIAS_WALK, POST_DIVERGENCE_DURATION_S, POST_DIVERGENCE_GYRO_BIAS_WALK = 0.1, 3.0, 0.03
"""Random walk of the gyroscopes' bias after a divergence of the filter (rad/s in a second), its duration (s), and the
random walk afterwards, since a drift may continue."""
DIVERGED_GYRO_BIAS_SIGMA_RAD_S, DIVERGED_ATTITUDE_SIGMA_RAD, DIVERGED_SPEED_SIGMA_M_S = 0.15, 0.06, 0.3
"""Standard deviations of bias (rad/s), attitude (rad) and speed (m/s) after a divergence."""
_ROTOR_SPEED_GATE, _ROTOR_SPEED_RECOVERY_GATE = 0.08, 0.02  # fractions of the hover speed; the second after a rejection
_MAX_SPIN_ACCEL_BIAS_CHANGE, _SPIN_ACCEL_BIAS_AVERAGING_S, _SPIN_ACCEL_BIAS_SETTLING_S = 0.03, 4.0, 1.0
"""Permitted deviation of the motor equations' error from its mean (fraction of the hover speed per second), averaging
time (s), and settling time after lift-off (s); flights in gusts need a fifth of the limit."""
_BATTERY_VOLTAGE_GATE_V = 0.6
DIAGNOSIS_AGREE, DIAGNOSIS_UNDECIDED, DIAGNOSIS_ACCEL_WRONG, DIAGNOSIS_MODEL_WRONG, DIAGNOSIS_FLOOR_CONTACT = range(5)
"""Codes of a conflict between accelerometers and rotor model: none, not decided, which is wrong, floor contact."""
_FORCE_CONFLICT_GATE, _FORCE_CONFLICT_END_GATE = 6.0, 2.0
"""Deviations between accelerometers and model at which a conflict begins and ends."""
_CONFLICT_MIN_FIX_RATIO, _CONFLICT_FIX_AGE_S, _CONFLICT_TIMEOUT_S = 1.0, 0.5, 1.0
"""Mean ratio of the fix that decides a conflict (1), largest age of the fix (s), and the time without such a ratio
after which the model, which the filter follows, is right (s)."""
_FLOOR_CONTACT_HEIGHT_M = 0.03
"""Height (m) below which legs may touch the surface, beyond three deviations of the height."""


@cached_njit(error_model="numpy")
def set_fault(m: FilterMemory, s: FilterSettings, k: int, code: int, why: int, number: float) -> None:
    """Set status and reason of a sensor for :data:`FAULT_HOLD_S`."""
    m.status[k] = code
    m.reason[k] = why
    m.reason_number[k] = number
    m.fault_until_tick[k] = m.tick + int(FAULT_HOLD_S / s.dt)
    if k == READING_POSITION_FIX:
        m.fix_fault_component = m.worst_fix_component


@cached_njit(error_model="numpy")
def mark_fused(m: FilterMemory, k: int) -> None:
    """Mark reading ``k`` as fused: reset its rejection counts, and clear a fault whose hold time has passed."""
    m.last_fused_tick[k] = m.tick
    m.reject_count[k] = 0
    m.agreeing_reject_count[k] = 0
    m.reject_score[k] *= REJECT_SCORE_DECAY
    if m.tick >= m.fault_until_tick[k] and m.reject_score[k] < 1.0:
        m.status[k] = STATUS_FUSED
        m.reason[k] = REASON_NONE
    elif m.status[k] == STATUS_REJECTED and m.tick >= m.fault_until_tick[k]:
        m.status[k] = STATUS_FUSED


@cached_njit(error_model="numpy")
def mark_rejected(m: FilterMemory, s: FilterSettings, k: int, why: int, number: float) -> None:
    """Count a rejected reading; set the sensor's status to rejected when its rejection score exceeds the alarm."""
    m.reject_count[k] += 1
    m.reject_score[k] += 1.0
    if m.reject_score[k] > (SONAR_REJECT_ALARM_SCORE if k == READING_SONAR else REJECT_ALARM_SCORE):
        set_fault(m, s, k, STATUS_REJECTED, why, number)


@cached_njit(error_model="numpy")
def _is_repeated(m: FilterMemory, s: FilterSettings, z: _Array, k: int, start: int, count: int) -> bool:
    """Return whether a reading that has noise equals the preceding one bit for bit, so that the sensor seems frozen."""
    if s.has_noise[k] == 0 or m.last_new_tick[k] == 0:
        return False
    told = False
    for j in range(3 if k == READING_POSITION_FIX else count):  # a frozen camera may follow the gyroscopes in heading
        if z[start + j] != m.last_value[start + j]:
            return False
        told = told or (
            (k != READING_ROTOR_SPEED or z[start + j] != 0.0)
            and (k != READING_RANGE_RING or z[start + j] < 0.995 * s.ring_max_range)
        )
    return told


@cached_njit(error_model="numpy")
def check_readings(m: FilterMemory, s: FilterSettings, z: _Array, new: NDArray[np.int32], age: _Array) -> None:
    """Check new readings for limits, age, repetition and silence.

    A reading that cannot be used is marked in ``new`` as not new and replaced by the last one."""
    for k in range(SENSOR_COUNT):
        if s.is_fitted[k] == 0:
            new[k] = 0
            continue
        start, count = READING_STARTS[k], READING_STARTS[k + 1] - READING_STARTS[k]
        m.is_skipped_by_decimation[k] = 0
        if new[k] == 2:
            m.invalid_count[k] += 1
            new[k] = 0
        if new[k] == 1:
            for j in range(count):
                if not (abs(z[start + j]) < s.value_limit[k]):
                    new[k] = 0
            if new[k] == 0:
                set_fault(m, s, k, STATUS_FAULTY, REASON_OUT_OF_RANGE, 0.0)
            elif not (-s.dt <= age[k] <= _MAX_READING_AGE_S):
                new[k] = 0
                set_fault(m, s, k, STATUS_FAULTY, REASON_LATE, 0.0)
        elif new[k] != 0:
            new[k] = 0
            set_fault(m, s, k, STATUS_FAULTY, REASON_OUT_OF_RANGE, 0.0)
        if new[k] == 1 and _is_repeated(m, s, z, k, start, count):
            # A repeated reading contains no new measurement and would be fused with a wrong time.
            new[k] = 0
            if (m.tick - m.last_new_tick[k]) * s.dt < 0.6 * s.sensor_period[k]:
                m.duplicate_count[k] += 1
                if m.duplicate_count[k] >= 2:
                    set_fault(m, s, k, m.status[k], REASON_DUPLICATED, 0.0)
            else:
                m.repeat_count[k] += 1
                m.last_new_tick[k] = m.tick
                m.duplicate_count[k] = 0
                if m.repeat_count[k] >= 2:
                    set_fault(m, s, k, STATUS_FAULTY, REASON_FROZEN, m.repeat_count[k] * s.sensor_period[k])
        elif new[k] == 1:
            m.repeat_count[k] = 0
            if (
                (s.has_noise[k] == 0 or k == READING_RANGE_RING)
                and m.last_new_tick[k] > 0
                and (m.tick - m.last_new_tick[k]) * s.dt < 0.6 * s.sensor_period[k]
            ):
                new[k] = 0
                m.duplicate_count[k] += 1
                if m.duplicate_count[k] >= 3:
                    set_fault(m, s, k, m.status[k], REASON_DUPLICATED, 0.0)
        if new[k] == 1:
            m.last_new_tick[k] = m.tick
            m.invalid_count[k] = 0
            again = m.status[k] >= STATUS_MISSING and m.tick >= m.fault_until_tick[k]
            if again or (m.status[k] == STATUS_WAITING and k != READING_RANGE_RING):
                # The ring's readings decide about its use: in a large room it detects no wall.
                m.status[k], m.reason[k] = STATUS_WAITING if k == READING_RANGE_RING else STATUS_FUSED, REASON_NONE
            if age[k] > s.latency[k] + s.latency_slack[k]:
                # The others wait for the horizon, which decides whether they can be fused.
                set_fault(m, s, k, m.status[k], REASON_LATE, age[k])
                if k <= READING_RATES or k in (READING_ROTOR_SPEED, READING_BATTERY):
                    set_fault(m, s, k, STATUS_FAULTY, REASON_LATE, age[k])
                    new[k] = 0
            if s.reading_decimation[k] > 1:
                m.decimation_count[k] += 1
                m.is_skipped_by_decimation[k] = 1 if m.decimation_count[k] % s.reading_decimation[k] else 0
            for j in range(count):
                m.last_value[start + j] = z[start + j]
            if k <= READING_RATES or k == READING_RANGE_RING:
                m.last_fused_tick[k] = m.tick
        if new[k] == 0:
            for j in range(count):
                z[start + j] = m.last_value[start + j]
            if m.last_new_tick[k] > 0 and (m.tick - m.last_new_tick[k]) * s.dt > s.timeout[k]:
                m.status[k] = STATUS_MISSING
                m.reason[k] = REASON_NO_ECHO if m.invalid_count[k] > 2 else REASON_TIMEOUT
                m.reason_number[k] = (m.tick - m.last_new_tick[k]) * s.dt
    clip = 0.0
    for k in range(3):
        share = z[CLIPPING_START + k]
        m.clipped_fraction[k] += 0.1 * ((share if 0.0 <= share <= 1.0 else 1.0) - m.clipped_fraction[k])
        clip = max(clip, m.clipped_fraction[k])
    if clip > _MIN_CLIP_FRACTION and m.status[READING_ACCELERATION] == STATUS_FUSED:
        set_fault(m, s, READING_ACCELERATION, STATUS_FUSED, REASON_CLIPPING, clip)


@cached_njit(error_model="numpy")
def inflate_variances_on_divergence(m: FilterMemory, s: FilterSettings) -> None:
    """Inflate the variances of gyroscope bias, attitude and velocity after lasting, large innovations of the fix."""
    if m.divergence_recovery_ticks_left <= 1:
        for k in range(3):
            inflate_variance(
                m.u_transposed,
                m.ud_diagonal,
                ERROR_GYRO_BIAS + k,
                DIVERGED_GYRO_BIAS_SIGMA_RAD_S * DIVERGED_GYRO_BIAS_SIGMA_RAD_S,
                m.u_transposed_h,
            )
            inflate_variance(
                m.u_transposed,
                m.ud_diagonal,
                ERROR_ATTITUDE + k,
                DIVERGED_ATTITUDE_SIGMA_RAD * DIVERGED_ATTITUDE_SIGMA_RAD,
                m.u_transposed_h,
            )
        for k in range(2):
            inflate_variance(
                m.u_transposed,
                m.ud_diagonal,
                ERROR_VELOCITY + k,
                DIVERGED_SPEED_SIGMA_M_S * DIVERGED_SPEED_SIGMA_M_S,
                m.u_transposed_h,
            )
    m.divergence_recovery_ticks_left = int(POST_DIVERGENCE_DURATION_S / s.dt)


@cached_njit(error_model="numpy")
def replace_gyro_spikes(m: FilterMemory, s: FilterSettings, flying: bool) -> None:
    """Replace gyroscope rates that contain a spike by the rotor model's rates; subtract a lasting jump as an offset.

    ``m.gyro_rates`` are the new rates, ``m.gyro_rates_prev`` those of the period before."""
    now = (m.tick - 1) % ROTOR_FORCE_HISTORY
    worst, led = 0.0, 0.0
    for k in range(3):
        m.axis_work[k] = (
            m.gyro_rates_prev[k] + s.dt * m.rotor_model_rows[now, ROTOR_ANG_ACCEL + k] + m.model_rate_step_bias[k]
        )
        off = m.gyro_rates[k] - m.axis_work[k]
        worst = max(worst, abs(off))
        # A spike may consist of two steps that would each pass.
        led = max(led, abs(_GYRO_RESIDUAL_CARRY_FRACTION * m.spike_residual_carry[k] + off))
        # Error of the model's moments, in flight and on the legs
        m.model_rate_step_bias[k] += (
            _ANG_ACCEL_BIAS_GAIN * min(max(off, -_GYRO_SPIKE_RATE_RAD_S), _GYRO_SPIKE_RATE_RAD_S)
            if m.flight_phase >= PHASE_LIFTING_OFF
            else 0.0
        )
    alike = m.equal_spike_count > 0
    for k in range(3):
        alike = alike and abs(m.gyro_rates[k] - m.rates_with_spikes[k]) < _GYRO_SPIKE_AGREEMENT_RAD_S
        m.rates_with_spikes[k] = m.gyro_rates[k]
    # A model with repeated errors cannot distinguish a spike from a motion. Agreeing spikes are one error.
    most = _GYRO_SPIKE_RATE_RAD_S + _GYRO_SPIKE_RESIDUAL_FACTOR * m.rate_residual_lp
    m.rate_residual_lp += 0.0 if alike else 0.1 * (min(worst, _GYRO_SPIKE_RATE_RAD_S) - m.rate_residual_lp)
    # A past divergence is remembered.
    left = m.divergence_recovery_ticks_left
    m.divergence_recovery_ticks_left = max(left - 1, min(left, 1))
    if not flying or s.has_rotor_model == 0:
        m.equal_spike_count = 0
        return
    fine = max(worst, led) < most
    for k in range(3):
        m.spike_residual_carry[k] *= _GYRO_RESIDUAL_CARRY_FRACTION
        if fine:
            m.spike_residual_carry[k] += m.gyro_rates[k] - m.axis_work[k]
    if fine:
        m.equal_spike_count = m.spike_count = 0
        return
    m.spike_count += 1
    m.equal_spike_count = m.equal_spike_count + 1 if alike else 1
    if m.spike_count == 1:
        m.reject_score[READING_RATES] = m.reject_score[READING_RATES] * REJECT_SCORE_DECAY + 1.0
        if m.reject_score[READING_RATES] > 3.0:
            set_fault(m, s, READING_RATES, STATUS_FUSED, REASON_SPIKES, worst)
    small = True
    for k in range(3):
        small = small and abs(m.gyro_offset_jump[k] + (m.gyro_rates[k] - m.axis_work[k])) < _MAX_GYRO_OFFSET_RAD_S
    if m.equal_spike_count >= _GYRO_JUMP_REPEATS and small:
        # A sudden offset is no motion. It is subtracted from the following readings.
        for k in range(3):
            off = m.gyro_rates[k] - m.axis_work[k]
            m.gyro_offset_jump[k] += off
            inflate_variance(
                m.u_transposed, m.ud_diagonal, ERROR_GYRO_BIAS + k, 0.1 * off * (0.1 * off), m.u_transposed_h
            )
        m.equal_spike_count = m.spike_count = 0
        set_fault(m, s, READING_RATES, STATUS_FUSED, REASON_JUMP, worst)
    elif m.spike_count > 8:
        m.spike_count = 0
        return
    for k in range(3):
        m.gyro_rates[k] = m.axis_work[k]


@cached_njit(error_model="numpy")
def check_rotor_speed(m: FilterMemory, s: FilterSettings, z: _Array, start: int) -> bool:
    """Return whether measured rotor speeds agree with the motor equations.

    The filter estimates the error of these equations, including a slow sensor drift, within a second. In flight the
    error is nearly constant: ``m.rotor_spin_accel_bias_mean`` is its mean over some seconds."""
    worst, away = 0.0, 0.0
    k = READING_ROTOR_SPEED
    flown = (m.tick - m.last_grounded_tick) * s.dt
    for j in range(2):
        worst = max(worst, abs(z[start + j] - m.flight_model_state[MODEL_SPEED_UPPER + j]) / s.hover_speed[j])
        away = max(away, abs(m.rotor_spin_accel_bias[j] - m.rotor_spin_accel_bias_mean[j]) / s.hover_speed[j])
    # On the floor the motor equations are adapted.
    if m.flight_phase == PHASE_FLYING:
        if flown > _SPIN_ACCEL_BIAS_SETTLING_S and away > _MAX_SPIN_ACCEL_BIAS_CHANGE:
            for j in range(2):
                m.rotor_spin_accel_bias[j] = m.rotor_spin_accel_bias_mean[j]
            mark_rejected(m, s, k, REASON_INNOVATION, worst * s.hover_speed[0])
            return False
        if worst > (_ROTOR_SPEED_RECOVERY_GATE if m.reject_score[k] > 0.5 else _ROTOR_SPEED_GATE):
            mark_rejected(m, s, k, REASON_INNOVATION, worst * s.hover_speed[0])
            return False
    share = s.sensor_period[k] / max(min(flown, _SPIN_ACCEL_BIAS_AVERAGING_S), s.sensor_period[k])
    for j in range(2):
        m.rotor_spin_accel_bias_mean[j] += share * (m.rotor_spin_accel_bias[j] - m.rotor_spin_accel_bias_mean[j])
    mark_fused(m, k)
    return True


@cached_njit(error_model="numpy")
def check_battery_voltage(m: FilterMemory, s: FilterSettings, off: float) -> bool:
    """Return whether the measured voltage agrees with the battery's model.

    Without rotor speeds the model's current is unknown, and a difference is no fault."""
    if abs(off) > _BATTERY_VOLTAGE_GATE_V and m.tick * s.dt > 1.0:
        if s.is_fitted[READING_ROTOR_SPEED] == 0 or m.status[READING_ROTOR_SPEED] == STATUS_FUSED:
            mark_rejected(m, s, READING_BATTERY, REASON_INNOVATION, off)
        return False
    mark_fused(m, READING_BATTERY)
    return True


@cached_njit(error_model="numpy")
def _mean_fix_ratio_along(m: FilterMemory, r: _Array, along: _Array) -> float:
    """Return the component of the fix's mean innovation ratio in the direction of ``along`` (3,), in body axes.

    ``along`` is the specific force of the accelerometers minus that of the model.

    The filter uses one of the two forces. If the vehicle accelerates according to the other force, innovations of the
    fix lie along the difference or against it: a positive value contradicts the model, a negative one the
    accelerometers.
    """
    dot, square = 0.0, 1e-12
    for j in range(3):
        part = r[3 * j] * along[0] + r[3 * j + 1] * along[1] + r[3 * j + 2] * along[2]
        dot += part * m.fix_ratio_mean[j]
        square += part * part
    return dot / math.sqrt(square)


@cached_njit(error_model="numpy")
def _update_force_conflict(m: FilterMemory, s: FilterSettings, r: _Array, height: float, worst: float) -> None:
    """Diagnose which specific force is wrong when accelerometers and rotor model disagree.

    They differ by ``worst`` standard deviations. The diagnosis goes to ``m.accel_model_diagnosis``.

    If rotor speeds are not fused, the model is wrong. If the floor may carry the vehicle, both may be right, and
    nothing is reported. Otherwise the fix decides (:func:`_mean_fix_ratio_along`). Until it does, the filter uses the
    model, and both are reported. ``height`` is the height above the surface below (m).
    """
    if m.is_accel_distrusted == 0 and worst > _FORCE_CONFLICT_GATE:
        m.is_accel_distrusted = 1
    elif m.is_accel_distrusted == 1 and worst < _FORCE_CONFLICT_END_GATE:
        m.is_accel_distrusted = 0
    apart = m.accel_model_difference_tick > 0 and (m.tick - m.accel_model_difference_tick) * s.dt < FAULT_HOLD_S
    if m.is_accel_distrusted == 0 and not apart:
        m.accel_model_diagnosis = DIAGNOSIS_AGREE
        return
    if m.accel_model_diagnosis == DIAGNOSIS_AGREE:
        m.accel_model_diagnosis = DIAGNOSIS_UNDECIDED
        m.accel_model_conflict_start_tick = m.tick
    has_fix = (
        m.status[READING_POSITION_FIX] == STATUS_FUSED
        and (m.tick - m.last_fused_tick[READING_POSITION_FIX]) * s.dt < _CONFLICT_FIX_AGE_S
    )
    evidence = _mean_fix_ratio_along(m, r, m.accel_residual_lp) if has_fix else 0.0
    if m.accel_residual_lp[2] < 0.0 and height < _FLOOR_CONTACT_HEIGHT_M + 3.0 * m.sigma_output[ERROR_POSITION + 2]:
        m.accel_model_diagnosis = DIAGNOSIS_FLOOR_CONTACT
    elif (
        s.is_fitted[READING_ROTOR_SPEED] > 0 and m.status[READING_ROTOR_SPEED] != STATUS_FUSED
    ) or evidence > _CONFLICT_MIN_FIX_RATIO:
        m.accel_model_diagnosis = DIAGNOSIS_MODEL_WRONG
    elif evidence < -_CONFLICT_MIN_FIX_RATIO:
        m.accel_model_diagnosis = DIAGNOSIS_ACCEL_WRONG
    elif m.accel_model_diagnosis == DIAGNOSIS_FLOOR_CONTACT:
        m.accel_model_diagnosis = DIAGNOSIS_UNDECIDED
        m.accel_model_conflict_start_tick = m.tick
    elif (
        m.accel_model_diagnosis == DIAGNOSIS_UNDECIDED
        and has_fix
        and (m.tick - m.accel_model_conflict_start_tick) * s.dt > _CONFLICT_TIMEOUT_S
    ):
        m.accel_model_diagnosis = DIAGNOSIS_ACCEL_WRONG


@cached_njit(error_model="numpy")
def check_accel_model(
    m: FilterMemory, s: FilterSettings, r: _Array, height: float, nu: float, variance: float, known: float, i: int
) -> None:  # fmt: skip
    """Compare the mean difference of accelerometers and model over 0.4 s with its expected standard deviation.

    ``nu`` is the residual of axis ``i`` over a block, ``variance`` the variance of its noise, ``known`` the variance of
    its prediction. ``r`` is the rotation matrix, ``height`` the height above the surface below (m).
    """
    m.accel_residual_lp[i] += 0.1 * (nu - m.accel_residual_lp[i])
    if i == 2:
        worst, axis = 0.0, 2
        for j in range(3):
            if m.accel_residual_sigma[j] > 0.0:
                ratio = abs(m.accel_residual_lp[j]) / m.accel_residual_sigma[j]
                if ratio > worst:
                    worst, axis = ratio, j
        _update_force_conflict(m, s, r, height, worst)
        code, why = STATUS_FUSED, REASON_NONE
        if m.accel_model_diagnosis == DIAGNOSIS_MODEL_WRONG:
            why = REASON_MODEL_WRONG
        elif m.accel_model_diagnosis != DIAGNOSIS_FLOOR_CONTACT:
            code = STATUS_FAULTY if m.is_accel_distrusted == 1 else STATUS_REJECTED
            why = REASON_FORCE_CONFLICT if m.accel_model_diagnosis == DIAGNOSIS_UNDECIDED else REASON_INNOVATION
        rejected = m.status[READING_ACCELERATION] in (STATUS_REJECTED, STATUS_FAULTY)
        if m.accel_model_diagnosis != DIAGNOSIS_AGREE and (why != REASON_NONE or rejected):
            set_fault(m, s, READING_ACCELERATION, code, why, m.accel_residual_lp[axis])
    # The mean of 0.1-weighted blocks keeps 0.1 / (2 - 0.1) of their variance.
    m.accel_residual_sigma[i] = math.sqrt(variance * 0.0526 + known + 0.04)
