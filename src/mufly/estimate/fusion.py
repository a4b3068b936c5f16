"""Fusion of each measurement: its model, its gate and its reset.

A scalar measurement z = h(x) + n has an innovation of variance S = H P H^T + r. It is fused if the innovation lies
within :data:`INNOVATION_GATE` standard deviations; a measurement of several numbers if all of them do.

| measurement | h(x) | reset after rejections that agree with each other |
|---|---|---|
| position_fix | p + v dt + b, heading + b_h | after a second: variance of position and heading inflated |
| ground_distance | -(p + R r)_D - terrain | three in a row: a step of the terrain, its variance inflated |
| ranges | distance to the nearest wall of the room along the beam | none: the beams see no wall |
| pressure | rho g p_D + b + the rotors' part | after a second: variance of its bias inflated |
| magnetic_field | heading + b, and tilt by the field's dip | after a second: variance of its bias inflated |

A reset adds variance before the measurement is fused, so the correlations between the errors stay.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.estimate.filter_records import (
    AID_HEADING,
    AID_MAGNETIC,
    AID_PLACE,
    AID_PRESSURE,
    AID_SONAR,
    ERROR_STATE_COUNT,
    EX_ACCEL_BIAS,
    EX_ATT,
    EX_FIX_BIAS,
    EX_FIX_HEADING,
    EX_GYRO_BIAS,
    EX_MAG_BIAS,
    EX_POS,
    EX_PRESSURE_BIAS,
    EX_TERRAIN,
    EX_THRUST_SCALE,
    EX_VEL,
    EX_WIND,
    MAX_FLOOR_HEIGHT,
    PHASE_COASTING,
    PHASE_LIGHT,
    PHASE_STANDING,
    R_ACCELERATION,
    R_FIX,
    R_MAGNET,
    R_PRESSURE,
    R_RATES,
    R_RING,
    R_SONAR,
    SX_ACCEL_BIAS,
    SX_ATT,
    SX_FIX_BIAS,
    SX_FIX_HEADING,
    SX_GYRO_BIAS,
    SX_MAG_BIAS,
    SX_POS,
    SX_PRESSURE_BIAS,
    SX_TERRAIN,
    SX_THRUST_SCALE,
    SX_VEL,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.sensor_checks import (
    REASON_FUSED_THOUGH_OFFSET,
    REASON_HEIGHT_CONFLICT,
    REASON_INNOVATION,
    REASON_LARGE_BIAS,
    REASON_NO_WALL,
    REASON_NONE,
    REASON_OUT_OF_RANGE,
    REASON_RESET,
    REASON_STUCK,
    REASON_TERRAIN_SLOPE,
    REASON_TERRAIN_STEP,
    REASON_WALLS_TOO_FAR,
    STATUS_FAULTY,
    STATUS_FUSED,
    STATUS_REJECTED,
    STATUS_WAITING,
    check_accel_model,
    mark_fused,
    mark_rejected,
    reset_on_divergence,
    set_fault,
)
from mufly.estimate.strapdown import rotate_attitude, rotation_matrix
from mufly.estimate.ud_filter import (
    gauss_markov_update,
    inflate_variance,
    innovation_variance,
    state_variance,
    ud_measurement_update,
)
from mufly.numba_cache import cached_njit
from mufly.portable_math import portable_atan2, wrap_angle
from mufly.units import GRAVITY

_Array = NDArray[np.float64]

INNOVATION_GATE = 5.0
"""Gate in standard deviations: one healthy reading in two million is rejected."""
SONAR_MEAN_GATE = PRESSURE_MEAN_GATE = 2.2
"""Mean of five ratios or so of the sonar, and of the pressure: six and a half deviations."""
FIELD_GATE = 5.0
"""Deviations of the magnetic field from the earth's, across and along the vertical, above which a field is no heading.
A healthy sensor exceeds them at one place in 270 000 (chi-square of two)."""
FIX_MEAN_SQUARE_GATE = 11.0
"""Mean square of the worst of the fix's four ratios over half a second; 2.4 is usual."""
DIVERGENCE_MEAN_SQUARE = 5.0
"""Mean square of the ratios above which a rejected fix is not treated as a jump of the fix."""
SETTLING_TIME_S = 3.0
"""Time in flight before which no ratio of the fix accuses the filter, whose state is well known at rest (s)."""
LASTING_RATIO = 1.0
"""Mean of a ratio of the fix over half a second above which the filter, not the noise, is the cause (1)."""
_RESET_TIMEOUT_S = 1.0
BIAS_RANGE_SIGMAS = 5.5
"""Largest bias of the fix in standard deviations a. A Gauss-Markov bias of time constant tau passes a on either side
2 a phi(a) / tau times a second (phi: normal density; Pickands, 1969). Three axes with tau of 2 s pass 5.5 deviations
0.06 times in ten hours, and 5 deviations 0.8 times."""
GYRO_BIAS_RANGE_SIGMAS = 8.0
"""Deviations of the initial gyroscope bias beyond which the gyroscopes are unusable for long."""
MAX_STUCK_CHANCE = 1e-11
"""Probability that a healthy sonar repeats a reading for so long."""
LEG_CLEARANCE_HEIGHT = 0.15
"""Height (m) above which no leg touches the floor; angular accelerations are then in the flight model."""
HEIGHT_RESET_SPEED, HEIGHT_RESET_ACCEL, HEIGHT_RESET_THRUST, HEIGHT_RESET_WINDOW_S = 0.3, 0.3, 0.1, 1.0
"""Standard deviations of speed (m/s), accelerometer bias (m/s^2) and thrust scale (1) set by a second height reset
within ``HEIGHT_RESET_WINDOW_S`` (s)."""
TERRAIN_STEP_GATE, MAX_TERRAIN_STEPS = 3.0, 8
"""Innovation ratio of the sonar above which the surface below steps at an edge (1); largest number of such steps."""
LIFTOFF_THRUST_RATIO, LIFTOFF_THRUST_SIGMA = 1.08, 0.08
"""Lift over weight as the sonar shows lift-off (1), and its standard deviation (1)."""
_BEAM_GATE = 4.0
NOISE_GAIN_PLACE, NOISE_GAIN_HEADING, NOISE_GAIN_AID = 0.004, 0.008, 0.03
"""Gain of the estimated variances of a fix, per component of a fix, and of another aid, per reading."""
MAX_SQUARED_RATIO, MAX_RATIO_PRODUCT = 9.0, 3.0
"""A larger squared innovation ratio, or product of two, counts as this."""
WIDENED_SIGMAS = 3.0
"""An innovation of the fix at rest beyond the gate counts as this many deviations of its bias."""
MIN_NOISE_SCALE, MAX_NOISE_SCALE = 0.25, 25.0
"""Bounds of the estimated variances over those of the file."""
COST_FIX_BIAS, COST_FIX = 1, 4
"""Cost of a bias step of the fix and of a fix, in scalar measurements."""
MIN_TERRAIN_HEIGHT = -0.1
"""Lowest floor height (m): no surface lies below the floor."""


@cached_njit(error_model="numpy")
def _h_row_begin(m: FilterMemory, i: int, h: float) -> None:
    """Begin the row H of a measurement with ``h`` times error state ``i``."""
    m.h_terms = 1
    m.h_state[0] = i
    m.h[0] = h


@cached_njit(error_model="numpy")
def _h_row_add(m: FilterMemory, i: int, h: float) -> None:
    """Add ``h`` times error state ``i`` to the row H."""
    m.h_state[m.h_terms] = i
    m.h[m.h_terms] = h
    m.h_terms += 1


@cached_njit(error_model="numpy")
def _shift_state(x: _Array, by: _Array, span: float, push: _Array) -> None:
    """Add an error to a state, propagated over ``span`` (s), in which ``push`` (3,) was added to the velocity without
    gravity."""
    v_x = by[EX_VEL] + (by[EX_ATT + 1] * push[2] - by[EX_ATT + 2] * push[1] if span > 0.0 else 0.0)
    v_y = by[EX_VEL + 1] + (by[EX_ATT + 2] * push[0] - by[EX_ATT] * push[2] if span > 0.0 else 0.0)
    v_z = by[EX_VEL + 2] + (by[EX_ATT] * push[1] - by[EX_ATT + 1] * push[0] if span > 0.0 else 0.0)
    x[SX_POS] += by[EX_POS] + 0.5 * span * (by[EX_VEL] + v_x)
    x[SX_POS + 1] += by[EX_POS + 1] + 0.5 * span * (by[EX_VEL + 1] + v_y)
    x[SX_POS + 2] += by[EX_POS + 2] + 0.5 * span * (by[EX_VEL + 2] + v_z)
    x[SX_VEL] += v_x
    x[SX_VEL + 1] += v_y
    x[SX_VEL + 2] += v_z
    rotate_attitude(x, by[EX_ATT], by[EX_ATT + 1], by[EX_ATT + 2], False)
    for i in range(9, ERROR_STATE_COUNT):
        x[i + 1] += by[i]


@cached_njit(error_model="numpy")
def _apply_correction(m: FilterMemory, innovation: float, r: float) -> None:
    """Fuse a scalar measurement whose ``m.f`` is known; correct the horizon's state and those propagated from it."""
    ud_measurement_update(m.u_transposed, m.d, m.f, r, m.gain)
    for i in range(ERROR_STATE_COUNT):
        m.gain[i] *= innovation
    _shift_state(m.x, m.gain, 0.0, m.repropagating_velocity_gain)
    _shift_state(m.x_repropagating, m.gain, m.repropagating_span, m.repropagating_velocity_gain)
    _shift_state(m.x_now, m.gain, m.now_span, m.now_velocity_gain)


@cached_njit(error_model="numpy")
def _fuse_scalar(m: FilterMemory, innovation: float, r: float) -> None:
    """Fuse a scalar measurement of variance ``r`` without a gate; its row is in ``m.h``."""
    innovation_variance(m.u_transposed, m.d, m.h_state, m.h, m.h_terms, m.f)
    _apply_correction(m, innovation, r)


@cached_njit(error_model="numpy")
def _innovation_ratio(m: FilterMemory, innovation: float, r: float) -> float:
    """Return the innovation over its standard deviation."""
    return innovation / math.sqrt(innovation_variance(m.u_transposed, m.d, m.h_state, m.h, m.h_terms, m.f) + r)


@cached_njit(error_model="numpy")
def _log_innovation(m: FilterMemory, k: int, innovation: float, ratio: float) -> None:
    """Record innovation and standard deviation of a sensor."""
    m.innovation[k] = innovation
    m.innovation_sigma[k] = abs(innovation / ratio) if ratio != 0.0 else 0.0


@cached_njit(error_model="numpy")
def _reject_measurement(
    m: FilterMemory, s: FilterSettings, k: int, innovation: float, z: _Array, count: int, near: float, why: int
) -> None:
    """Reject a reading for reason ``why``; count in ``m.agree_count`` whether it agrees with the last rejected one."""
    alike = m.reject_count[k] > 0
    for j in range(count):
        alike = alike and abs(z[j] - m.rejected_value[k, j]) < near
        m.rejected_value[k, j] = z[j]
    if alike:
        m.agree_count[k] += 1
    else:
        m.agree_count[k] = 0
        m.reject_since_tick[k] = m.horizon_tick
    if k != R_SONAR and abs(innovation) > 2.0 * INNOVATION_GATE * m.innovation_sigma[k]:
        m.reject_score[k] += 1.0  # by so much nothing healthy is off, but for a sonar that hears a second surface
    mark_rejected(m, s, k, why, innovation)


@cached_njit(error_model="numpy")
def _reset_timeout_expired(m: FilterMemory, s: FilterSettings, k: int) -> bool:
    """Return whether rejected readings have agreed with each other for :data:`_RESET_TIMEOUT_S`."""
    return m.agree_count[k] >= 3 and (m.horizon_tick - m.reject_since_tick[k]) * s.dt >= _RESET_TIMEOUT_S


@cached_njit(error_model="numpy")
def _fix_h_row(m: FilterMemory, i: int) -> None:
    """Write the row H of component ``i`` of the fix."""
    if i < 3:
        _h_row_begin(m, EX_POS + i, 1.0)
        _h_row_add(m, EX_FIX_BIAS + i, 1.0)
    else:
        _h_row_begin(m, EX_ATT + 2, 1.0)
        _h_row_add(m, EX_FIX_HEADING, 1.0)


@cached_njit(error_model="numpy")
def _fix_innovation(m: FilterMemory, z: _Array, i: int, ahead: float) -> float:
    """Return the innovation of component ``i`` of the fix."""
    x = m.x
    if i < 3:
        return z[i] - x[i] - ahead * x[SX_VEL + i] - x[SX_FIX_BIAS + i]
    yaw = portable_atan2(
        2 * (x[SX_ATT] * x[SX_ATT + 3] + x[SX_ATT + 1] * x[SX_ATT + 2]),
        1 - 2 * (x[SX_ATT + 2] * x[SX_ATT + 2] + x[SX_ATT + 3] * x[SX_ATT + 3]),
    )
    off = z[3] - yaw - ahead * m.yaw_rate - x[SX_FIX_HEADING]
    return wrap_angle(off)


@cached_njit(error_model="numpy")
def _fix_variance(m: FilterMemory, s: FilterSettings, i: int) -> float:
    """Return the estimated variance of component ``i`` of the fix."""
    return s.fix_variance * m.noise_scale[AID_PLACE] if i < 3 else s.heading_variance * m.noise_scale[AID_HEADING]


@cached_njit(error_model="numpy")
def _fix_bias_variance(m: FilterMemory, s: FilterSettings, i: int) -> float:
    """Return the estimated variance of the bias of component ``i`` of the fix."""
    sigma = s.initial_sigma[EX_FIX_BIAS + i]
    return sigma * sigma * m.bias_walk_scale[AID_PLACE if i < 3 else AID_HEADING]


@cached_njit(error_model="numpy")
def _scale_variance(scale: _Array, aid: int, gain: float, change: float) -> None:
    """Change an estimated variance by ``gain * change`` within its bounds.

    Changes in both directions count in full: a limit on one of them alone would bias the estimate."""
    scale[aid] = max(min(scale[aid] * (1.0 + gain * change), MAX_NOISE_SCALE), MIN_NOISE_SCALE)


@cached_njit(error_model="numpy")
def _estimate_fix_noise(m: FilterMemory, i: int) -> None:
    """Estimate noise and random walk of component ``i`` of the fix from its innovation ratio.

    The mean square of the ratio is 1 where the sum of noise and random walk is right. The mean product of two
    successive ratios is 0 where their proportion is right: it is negative where the noise is larger than assumed, and
    positive where the random walk is (correlation of innovations, Mehra 1970). Both variances follow by stochastic
    approximation. Ratios with a lasting mean say that the filter errs: they do not change the variances."""
    aid = AID_PLACE if i < 3 else AID_HEADING
    gain = NOISE_GAIN_PLACE if i < 3 else NOISE_GAIN_HEADING
    ratio = m.fix_ratio[i]
    excess = min(ratio * ratio, MAX_SQUARED_RATIO) - 1.0
    pair = max(min(ratio * m.fix_ratio_prev[i], MAX_RATIO_PRODUCT), -MAX_RATIO_PRODUCT)
    if m.is_heading_aligned != 0 and abs(m.fix_ratio_mean[i]) < LASTING_RATIO:
        _scale_variance(m.noise_scale, aid, gain, excess - pair)
        _scale_variance(m.bias_walk_scale, aid, gain, excess + pair)
    m.fix_ratio_prev[i] = ratio
    m.fix_ratio_mean[i] += 0.15 * (ratio - m.fix_ratio_mean[i])


@cached_njit(error_model="numpy")
def _estimate_noise(m: FilterMemory, aid: int, ratio: float) -> None:
    """Estimate the noise of an aid that measures one component from its innovation ratio."""
    _scale_variance(m.noise_scale, aid, NOISE_GAIN_AID, min(ratio * ratio, MAX_SQUARED_RATIO) - 1.0)


@cached_njit(error_model="numpy")
def _largest_mean_ratio(m: FilterMemory) -> float:
    """Return the largest mean of the innovation ratios of N, E and heading."""
    return max(max(abs(m.fix_ratio_mean[0]), abs(m.fix_ratio_mean[1])), abs(m.fix_ratio_mean[3]))


@cached_njit(error_model="numpy")
def height_above_ground(x: _Array, s: FilterSettings) -> float:
    """Return the height of the legs above the surface below (m); the surface is at least as high as the floor."""
    return -x[SX_POS + 2] - max(x[SX_TERRAIN], 0.0) - s.ground_clearance


@cached_njit(error_model="numpy")
def _fix_bias_ratio(m: FilterMemory, s: FilterSettings, i: int) -> float:
    """Return the estimated bias of component ``i`` of the fix over the largest that its model allows.

    A Gauss-Markov process of deviation sigma exceeds 5 sigma once in two million correlation times. Innovations do
    not show such an error, because the bias follows it."""
    return abs(m.x[SX_FIX_BIAS + i]) / (
        BIAS_RANGE_SIGMAS * math.sqrt(_fix_bias_variance(m, s, i) + _fix_variance(m, s, i))
    )


@cached_njit(error_model="numpy")
def _widen_fix_bias(m: FilterMemory, s: FilterSettings, i: int, nu: float, ratio: float) -> float:
    """Raise the random walk of the fix until it explains an innovation ``nu`` at rest; return the new ratio.

    A vehicle at rest knows its velocity, so that an innovation beyond the gate is an error of the fix. One beyond
    the largest random walk remains a jump."""
    sigma = s.initial_sigma[EX_FIX_BIAS + i]
    spread = nu / WIDENED_SIGMAS
    scale = spread * spread / (sigma * sigma)
    aid = AID_PLACE if i < 3 else AID_HEADING
    if not scale < MAX_NOISE_SCALE:
        return ratio
    m.bias_walk_scale[aid] = max(m.bias_walk_scale[aid], scale)
    inflate_variance(m.u_transposed, m.d, EX_FIX_BIAS + i, spread * spread, m.f)
    return _innovation_ratio(m, nu, _fix_variance(m, s, i))


@cached_njit(error_model="numpy")
def _sonar_height_valid(m: FilterMemory, s: FilterSettings) -> bool:
    """Return whether the sonar measures the height, over a known floor."""
    k = R_SONAR
    fresh = m.last_fused_tick[k] > 0 and (m.tick - m.last_fused_tick[k]) * s.dt < 0.3
    return fresh and m.status[k] == STATUS_FUSED and m.reason[k] == REASON_NONE and not m.terrain_edge_weight > 0.0


@cached_njit(error_model="numpy")
def _fix_height_consistent(m: FilterMemory, s: FilterSettings, nu: float, ratio: float) -> bool:
    """Return whether fix and sonar agree on the height; if not, write the gap to ``m.fix_height_gap``.

    The faulty one of the two is unknown: the pressure drifts by as much. The height follows the sonar, and the gap is
    added to the standard deviation of the position."""
    k = R_FIX
    off = abs(ratio)
    whole = abs(nu + m.x[SX_FIX_BIAS + 2])
    if m.fix_height_gap > 0.0:
        blind = (m.tick - m.last_fused_tick[R_SONAR]) * s.dt > 0.3
        m.fix_height_gap = 0.0 if blind or off < 2.5 else whole
    elif _sonar_height_valid(m, s) and (
        _fix_bias_ratio(m, s, 2) > 1.0 or (off > INNOVATION_GATE and _reset_timeout_expired(m, s, k))
    ):
        m.fix_height_gap = whole
    return m.fix_height_gap == 0.0


@cached_njit(error_model="numpy")
def _is_height_alone_off(m: FilterMemory) -> bool:
    """Return whether the height is the one component of the fix that lies outside the gate."""
    off = max(max(abs(m.fix_ratio[0]), abs(m.fix_ratio[1])), abs(m.fix_ratio[3]))
    return m.fix_component == 2 and off < INNOVATION_GATE


@cached_njit(error_model="numpy")
def _clear_attitude_evidence(m: FilterMemory) -> None:
    """Mark a fix that is rejected for its height alone as faulty: a height does not contradict the attitude."""
    if m.status[R_FIX] == STATUS_REJECTED and _is_height_alone_off(m):
        m.status[R_FIX] = STATUS_FAULTY


@cached_njit(error_model="numpy")
def fuse_position_fix(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float) -> None:
    """Fuse position and heading of a fix; no height while it disagrees with the sonar."""
    k, worst, at = R_FIX, 0.0, 0.0
    down = True
    for i in range(4):
        _fix_h_row(m, i)
        nu = _fix_innovation(m, z, i, ahead)
        ratio = _innovation_ratio(m, nu, _fix_variance(m, s, i))
        if abs(ratio) > INNOVATION_GATE and m.is_heading_aligned != 0 and m.flight_phase < PHASE_LIGHT:
            ratio = _widen_fix_bias(m, s, i, nu, ratio)
        if i == 2:
            down = _fix_height_consistent(m, s, nu, ratio)
            if not down:
                continue
        elif m.is_heading_aligned == 0 and abs(ratio) > INNOVATION_GATE:
            # The place of the start is unknown: the first fix gives it.
            inflate_variance(m.u_transposed, m.d, EX_POS + i if i < 3 else EX_ATT + 2, nu * nu, m.f)
            ratio = _innovation_ratio(m, nu, _fix_variance(m, s, i))
        m.fix_ratio[i] = ratio
        if abs(ratio) > abs(worst):
            worst, at = ratio, nu
            m.fix_component = i
    _log_innovation(m, k, at, worst)
    # Growing ratios of one sign show that the filter diverges, not that the fix jumps. Without a rotor model the
    # variances are a guess, and the filter would follow a record with wrong axes from fix to fix.
    settled = (m.tick - m.grounded_tick) * s.dt > SETTLING_TIME_S
    lasting = settled and _largest_mean_ratio(m) > LASTING_RATIO
    led = (
        s.has_rotor_model > 0
        and lasting
        and m.fix_ratio_lp > DIVERGENCE_MEAN_SQUARE
        and INNOVATION_GATE < abs(worst) < 2.0 * INNOVATION_GATE
    )
    if abs(worst) > INNOVATION_GATE and not led:
        # A height off the sonar's accuses neither of the two.
        apart = _is_height_alone_off(m) and m.status[R_SONAR] == STATUS_FUSED
        why = REASON_HEIGHT_CONFLICT if apart else REASON_INNOVATION
        near = 2.0 * s.sensor_period[k] + 8 * math.sqrt(_fix_variance(m, s, 0)) + 0.05
        _reject_measurement(m, s, k, at, z, 3, near, why)
        _clear_attitude_evidence(m)
        if not _reset_timeout_expired(m, s, k):
            return
        # What other sensors hold is not given up: the fix is off there.
        held = m.status[R_SONAR] == STATUS_FUSED, m.status[R_RING] == STATUS_FUSED
        for i in range(3):
            nu = _fix_innovation(m, z, i, ahead)
            if held[0] if i == 2 else held[1]:
                inflate_variance(m.u_transposed, m.d, EX_FIX_BIAS + i, nu * nu, m.f)
            else:
                inflate_variance(m.u_transposed, m.d, EX_POS + i, nu * nu, m.f)
                inflate_variance(m.u_transposed, m.d, EX_VEL + i, 0.01 + 0.1 * nu * nu, m.f)
        nu = _fix_innovation(m, z, 3, ahead)
        inflate_variance(m.u_transposed, m.d, EX_ATT + 2, nu * nu, m.f)
        nu = at
        set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)
        _clear_attitude_evidence(m)
    # Large ratios of one sign show an unmodelled error of the filter, for example drifting gyroscopes.
    m.fix_ratio_lp += 0.15 * (worst * worst - m.fix_ratio_lp)
    for i in range(4):
        if i != 2 or down:
            _estimate_fix_noise(m, i)
    out = max(_fix_bias_ratio(m, s, 0), _fix_bias_ratio(m, s, 1), _fix_bias_ratio(m, s, 3))
    if led or (lasting and m.fix_ratio_lp > FIX_MEAN_SQUARE_GATE) or (out > 1.0 and settled):
        reset_on_divergence(m, s)
        set_fault(m, s, k, STATUS_FUSED, REASON_FUSED_THOUGH_OFFSET, at)
    for i in range(4):
        if i == 2 and not down:
            continue
        _fix_h_row(m, i)
        _fuse_scalar(m, _fix_innovation(m, z, i, ahead), _fix_variance(m, s, i))
    for i in range(3):
        most = GYRO_BIAS_RANGE_SIGMAS * s.initial_sigma[EX_GYRO_BIAS + i] + 2.0 * m.sigma_output[EX_GYRO_BIAS + i]
        if abs(m.leak_origin[i]) > most and m.status[R_RATES] == STATUS_FUSED and down:
            set_fault(m, s, R_RATES, STATUS_REJECTED, REASON_LARGE_BIAS, m.leak_origin[i])
    mark_fused(m, k)
    if not down:
        set_fault(m, s, k, STATUS_FAULTY, REASON_HEIGHT_CONFLICT, m.fix_height_gap)
    m.is_heading_aligned = 1


@cached_njit(error_model="numpy")
def _sonar_h_row(m: FilterMemory, s: FilterSettings, r: _Array) -> float:
    """Write the row H of the sonar; return the sonar's place below the centre of gravity (m)."""
    rotation_matrix(m.x[SX_ATT : SX_ATT + 4], r)
    _h_row_begin(m, EX_POS + 2, -1.0)
    _h_row_add(m, EX_TERRAIN, -1.0)
    # (exp(t) R r)_D = (R r)_D + t_N (R r)_E - t_E (R r)_N
    n = r[0] * s.sonar_position[0] + r[1] * s.sonar_position[1] + r[2] * s.sonar_position[2]
    e = r[3] * s.sonar_position[0] + r[4] * s.sonar_position[1] + r[5] * s.sonar_position[2]
    d = r[6] * s.sonar_position[0] + r[7] * s.sonar_position[1] + r[8] * s.sonar_position[2]
    _h_row_add(m, EX_ATT, -e)
    _h_row_add(m, EX_ATT + 1, n)
    return d


@cached_njit(error_model="numpy")
def _reset_height(m: FilterMemory, s: FilterSettings, nu: float) -> None:
    """Reset the height after innovations ``nu`` of the sonar.

    The foot of a wall in the sonar's cone gives a wrong height once. A second reset within
    :data:`HEIGHT_RESET_WINDOW_S` says that a force is wrong: then the vertical speed, the accelerometer's bias and the
    thrust's scale are freed too."""
    inflate_variance(m.u_transposed, m.d, EX_POS + 2, nu * nu, m.f)
    before = m.height_reset_tick
    m.height_reset_tick = m.horizon_tick
    if not (before > 0 and (m.horizon_tick - before) * s.dt < HEIGHT_RESET_WINDOW_S):
        return
    inflate_variance(m.u_transposed, m.d, EX_VEL + 2, HEIGHT_RESET_SPEED * HEIGHT_RESET_SPEED, m.f)
    inflate_variance(m.u_transposed, m.d, EX_ACCEL_BIAS + 2, HEIGHT_RESET_ACCEL * HEIGHT_RESET_ACCEL, m.f)
    inflate_variance(m.u_transposed, m.d, EX_THRUST_SCALE, HEIGHT_RESET_THRUST * HEIGHT_RESET_THRUST, m.f)


@cached_njit(error_model="numpy")
def _sonar_stuck(m: FilterMemory, s: FilterSettings, z: float, nu: float) -> bool:
    """Whether the sonar repeats itself for longer than its noise and the vehicle's moving allow.

    A reading in steps of h is the one before with a chance of about h / (sqrt(2 pi) sigma) exp(-nu^2 / (2 sigma^2)),
    sigma of the innovation nu; exp(-x) <= 1 / (1 + x). A vehicle that may stand on the floor, by the fix's height,
    shows nothing.
    """
    same = z == m.sonar_prev
    m.sonar_prev = z
    if not same or height_above_ground(m.x, s) - m.fix_height_gap < LEG_CLEARANCE_HEIGHT:
        m.sonar_repeat_chance = 1.0
        return False
    # A height that is hardly known has no part in it: it may be better than believed.
    sigma = 1.3 * math.sqrt(s.sonar_variance)
    likely = 0.399 * s.sonar_resolution / sigma / (1.0 + 0.5 * min(nu * nu / (sigma * sigma), 9.0))
    m.sonar_repeat_chance *= min(likely, 1.0)
    return m.sonar_repeat_chance < MAX_STUCK_CHANCE


@cached_njit(error_model="numpy")
def fuse_sonar_range(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float, r: _Array) -> None:
    """Fuse the range to the surface below; a step that no other sensor sees belongs to the terrain."""
    k = R_SONAR
    down = _sonar_h_row(m, s, r)
    if r[8] < s.sonar_cone or z[0] >= s.sonar_max:
        return
    expect = -(m.x[SX_POS + 2] + ahead * m.x[SX_VEL + 2]) - down - m.x[SX_TERRAIN]
    said, r_ = z[0], s.sonar_variance * m.noise_scale[AID_SONAR]
    nearest, standing = s.sonar_min + 0.005, s.ground_clearance - s.sonar_position[2]
    if z[0] <= nearest and standing < nearest:
        # Nearer than it can tell: anywhere between there and where it stands.
        said = 0.5 * (nearest + standing)
        r_ = (nearest - standing) * (nearest - standing) / 12.0
        if expect < nearest:
            _fuse_scalar(m, said - expect, 100.0 * r_)  # as so many that are off alike
            mark_fused(m, k)
            return
    nu = said - expect
    ratio = _innovation_ratio(m, nu, r_)
    _log_innovation(m, k, nu, ratio)
    if _sonar_stuck(m, s, z[0], nu):
        set_fault(m, s, k, STATUS_FAULTY, REASON_STUCK, z[0])
        return
    floor = m.x[SX_TERRAIN] - nu
    over = m.terrain_edge_weight > 0.0 or abs(m.x[SX_TERRAIN]) > MAX_FLOOR_HEIGHT
    # Always off to the same side: over an edge it is the surface, and nearer may be an object that comes into the cone
    # from the side. Below the floor lies nothing, so else it is the height, which a force carries away that is not as
    # it is believed: the accelerometers' or the model's.
    if abs(ratio) < INNOVATION_GATE:
        m.sonar_ratio_lp += 0.2 * (ratio - m.sonar_ratio_lp)
        if not over:
            _estimate_noise(m, AID_SONAR, ratio)
    if abs(m.sonar_ratio_lp) > SONAR_MEAN_GATE:
        m.sonar_ratio_lp = 0.0
        set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_SLOPE, nu)
        if over or nu < 0.0:
            m.terrain_edge_weight = 1.0
        else:
            _reset_height(m, s, nu)
            _sonar_h_row(m, s, r)
    if over and abs(ratio) > TERRAIN_STEP_GATE and m.terrain_steps < MAX_TERRAIN_STEPS and floor > MIN_TERRAIN_HEIGHT:
        # Over an object it is the surface that jumps.
        m.terrain_steps += 1
        m.terrain_edge_weight = 1.0
        inflate_variance(m.u_transposed, m.d, EX_TERRAIN, nu * nu, m.f)
        _sonar_h_row(m, s, r)
    elif abs(ratio) > INNOVATION_GATE:
        _reject_measurement(m, s, k, nu, z, 1, 0.02 + 1.5 * s.sensor_period[k], REASON_INNOVATION)
        step = m.agree_count[k] >= 2 and floor > MIN_TERRAIN_HEIGHT
        if step and m.terrain_steps >= MAX_TERRAIN_STEPS:
            # Step after step: it is not the floor that goes, it is the height.
            inflate_variance(m.u_transposed, m.d, EX_POS + 2, nu * nu, m.f)
            inflate_variance(m.u_transposed, m.d, EX_VEL + 2, 0.1, m.f)
            inflate_variance(m.u_transposed, m.d, EX_THRUST_SCALE, 0.01, m.f)
            set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)
        elif step and nu > 0.0:
            # Lower than the floor nothing lies; over an edge it was the surface that jumped.
            _reset_height(m, s, nu)
            set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_SLOPE, nu)
        elif step:
            inflate_variance(m.u_transposed, m.d, EX_TERRAIN, nu * nu, m.f)
            m.reject_score[k] = 0.0
            set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_STEP, floor)
            m.terrain_edge_weight = 1.0
        elif _reset_timeout_expired(m, s, k):
            if (m.tick - m.last_fused_tick[R_FIX]) * s.dt < _RESET_TIMEOUT_S and m.last_fused_tick[R_FIX] > 0:
                inflate_variance(m.u_transposed, m.d, EX_TERRAIN, nu * nu, m.f)  # the fix holds the height
            else:
                inflate_variance(m.u_transposed, m.d, EX_POS + 2, nu * nu, m.f)
                inflate_variance(m.u_transposed, m.d, EX_VEL + 2, 0.1 + nu * nu, m.f)
            set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)
        else:
            if m.agree_count[k] >= 2:
                set_fault(m, s, k, STATUS_REJECTED, REASON_INNOVATION, nu)  # below the room's floor, and not by chance
            return
        _sonar_h_row(m, s, r)
    _fuse_scalar(m, nu, r_)
    mark_fused(m, k)


@cached_njit(error_model="numpy")
def reset_terrain(m: FilterMemory) -> None:
    """Reset the terrain to the floor's height."""
    _h_row_begin(m, EX_TERRAIN, 1.0)
    _fuse_scalar(m, -m.x[SX_TERRAIN], 2.5e-5)


@cached_njit(error_model="numpy")
def fuse_liftoff_thrust(m: FilterMemory, lift: float) -> None:
    """Fuse the thrust's scale at lift-off, where thrust equals weight; ``lift``: the model's thrust over the weight."""
    scale = LIFTOFF_THRUST_RATIO / lift
    spread = LIFTOFF_THRUST_SIGMA * scale
    _h_row_begin(m, EX_THRUST_SCALE, 1.0)
    _fuse_scalar(m, scale - m.x[SX_THRUST_SCALE], spread * spread)


@cached_njit(error_model="numpy")
def fuse_ground_contact(m: FilterMemory, s: FilterSettings) -> bool:
    """Keep the legs above the surface below, and stop a fall into it; return whether they were below.

    Below the sonar's minimum range, with less thrust than weight, no other sensor shows that the vehicle stands.
    """
    height = height_above_ground(m.x, s)
    if height >= 0.0:
        return False
    _h_row_begin(m, EX_POS + 2, -1.0)
    if m.x[SX_TERRAIN] > 0.0:
        _h_row_add(m, EX_TERRAIN, -1.0)
    _fuse_scalar(m, -height, 2.5e-5)
    if m.x[SX_VEL + 2] > 0.0:
        _h_row_begin(m, EX_VEL + 2, 1.0)
        _fuse_scalar(m, -m.x[SX_VEL + 2], 1e-3)
    return True


@cached_njit(error_model="numpy")
def fuse_wall_ranges(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float, r: _Array, most: int) -> bool:
    """Fuse distances to the walls of the room, at most ``most`` beams at a time; return whether all are fused.

    The error of a beam is mostly constant (docs/explanation/estimation.md). The information on a position is therefore
    bounded by J, the sum of h^2 / C over the beams. A picture adds the information lost since the preceding picture,
    J - 1 / P. Each beam has its share, a variance of C J / (J - 1 / P) besides its noise.
    """
    k = R_RING
    rotation_matrix(m.x[SX_ATT : SX_ATT + 4], r)
    if m.next_beam == 0:
        m.beams_seen = m.beams_fused = 0
        for i in range(2):
            told = m.wall_info_limit[i] * state_variance(m.u_transposed, m.d, EX_POS + i)
            m.wall_info_share[i] = 1.0 - 1.0 / told if told > 1.0 else 0.0
            m.wall_info_limit[i] = 0.0
    last = min(m.next_beam + most, s.beam_count)
    for b in range(m.next_beam, last):
        if not (0.0 < z[b] < 0.995 * s.ring_max):
            continue
        m.beams_seen += 1
        n = r[0] * s.beam_directions[b, 0] + r[1] * s.beam_directions[b, 1] + r[2] * s.beam_directions[b, 2]
        e = r[3] * s.beam_directions[b, 0] + r[4] * s.beam_directions[b, 1] + r[5] * s.beam_directions[b, 2]
        d = r[6] * s.beam_directions[b, 0] + r[7] * s.beam_directions[b, 1] + r[8] * s.beam_directions[b, 2]
        best, axis, along = 1e9, -1, 1.0
        for i in range(3):
            u = n if i == 0 else (e if i == 1 else d)
            if abs(u) > 0.3:
                plane = s.wall_planes[2 * i + 1] if u > 0.0 else s.wall_planes[2 * i]
                far = (plane - (m.x[i] + ahead * m.x[SX_VEL + i])) / u
                if 0.0 < far < best:
                    best, axis, along = far, i, u
        if axis < 0 or axis == 2 or best > 1.1 * s.ring_max:
            continue
        # l = (c - p_i) / u_i; of the heading they tell nothing, it is one more constant: du = t x u
        h = -1.0 / along
        across = h * best * (e if axis == 0 else n) * m.sigma_output[EX_ATT + 2]
        slope = best * best + s.ring_baseline * s.ring_baseline
        lasts = slope * slope * s.ring_constant_variance + across * across
        scatters = slope * best * best
        scatters *= scatters * s.ring_noise_variance
        _h_row_begin(m, EX_POS + axis, h)
        nu = z[b] - best
        ratio = _innovation_ratio(m, nu, scatters + lasts)
        if abs(ratio) < _BEAM_GATE:
            _log_innovation(m, k, nu, ratio)
            m.beams_fused += 1
            m.wall_info_limit[axis] += h * h / lasts
            if m.wall_info_share[axis] > 0.0:
                _apply_correction(m, nu, scatters + lasts / m.wall_info_share[axis])
                rotation_matrix(m.x[SX_ATT : SX_ATT + 4], r)
    m.next_beam = last
    if last < s.beam_count:
        return False
    m.next_beam = 0
    if m.beams_fused > 0:
        mark_fused(m, k)
    elif m.tick >= m.fault_until_tick[k]:
        m.status[k] = STATUS_WAITING
        m.reason[k] = REASON_WALLS_TOO_FAR if m.beams_seen == 0 else REASON_NO_WALL
    return True


@cached_njit(error_model="numpy")
def _reset_aid_bias(m: FilterMemory, s: FilterSettings, k: int, bias: int, nu: float) -> None:
    """Free the bias of an aid after consistent innovations ``nu``."""
    inflate_variance(m.u_transposed, m.d, bias, nu * nu, m.f)
    set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)


@cached_njit(error_model="numpy")
def _fuse_drifting_aid(
    m: FilterMemory,
    s: FilterSettings,
    k: int,
    bias: int,
    nu: float,
    variance: float,
    z: _Array,
    count: int,
    near: float,
) -> None:
    """Fuse an aid with one bias; free that bias after a second of consistent rejections."""
    ratio = _innovation_ratio(m, nu, variance)
    _log_innovation(m, k, nu, ratio)
    _estimate_noise(m, AID_PRESSURE if k == R_PRESSURE else AID_MAGNETIC, ratio)
    if abs(ratio) > INNOVATION_GATE:
        _reject_measurement(m, s, k, nu, z, count, near, REASON_INNOVATION)
        if not _reset_timeout_expired(m, s, k):
            return
        _reset_aid_bias(m, s, k, bias, nu)
    elif k == R_PRESSURE:
        # A bias that grows faster than it may drags innovations of one sign behind it.
        m.pressure_ratio_lp += 0.2 * (ratio - m.pressure_ratio_lp)
        if abs(m.pressure_ratio_lp) > PRESSURE_MEAN_GATE:
            m.pressure_ratio_lp = 0.0
            _reset_aid_bias(m, s, k, bias, nu)
    _fuse_scalar(m, nu, variance)
    mark_fused(m, k)


@cached_njit(error_model="numpy")
def fuse_pressure_height(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float) -> None:
    """Fuse the pressure less the standard one and less the rotors' part."""
    variance = s.pressure_variance * m.noise_scale[AID_PRESSURE]
    _h_row_begin(m, EX_POS + 2, s.pressure_slope)
    _h_row_add(m, EX_PRESSURE_BIAS, 1.0)
    nu = z[0] - s.pressure_slope * (m.x[SX_POS + 2] + ahead * m.x[SX_VEL + 2]) - m.x[SX_PRESSURE_BIAS]
    _fuse_drifting_aid(m, s, R_PRESSURE, EX_PRESSURE_BIAS, nu, variance, z, 1, 10 * math.sqrt(variance))


@cached_njit(error_model="numpy")
def fuse_magnetic_heading(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float, r: _Array) -> None:
    """Fuse the heading by the direction of a magnetic field that has the earth's strength across and along the
    vertical."""
    variance = s.mag_heading_variance * m.noise_scale[AID_MAGNETIC]
    rotation_matrix(m.x[SX_ATT : SX_ATT + 4], r)
    north = r[0] * z[0] + r[1] * z[1] + r[2] * z[2]
    east = r[3] * z[0] + r[4] * z[1] + r[5] * z[2]
    across = math.sqrt(north * north + east * east) - s.earth_field[0]
    along = r[6] * z[0] + r[7] * z[1] + r[8] * z[2] - s.earth_field[2]
    if across * across + along * along > FIELD_GATE * FIELD_GATE * s.mag_field_variance:
        set_fault(m, s, R_MAGNET, STATUS_FAULTY, REASON_OUT_OF_RANGE, 0.0)
        return
    _h_row_begin(m, EX_ATT + 2, 1.0)
    _h_row_add(m, EX_ATT, -s.earth_field[2] / s.earth_field[0])
    _h_row_add(m, EX_MAG_BIAS, 1.0)
    off = -portable_atan2(east, north) - ahead * m.yaw_rate - m.x[SX_MAG_BIAS]
    nu = wrap_angle(off)
    _fuse_drifting_aid(m, s, R_MAGNET, EX_MAG_BIAS, nu, variance, z, 3, 1e-5)


@cached_njit(error_model="numpy")
def _predict_fix_bias(m: FilterMemory, s: FilterSettings) -> None:
    """Predict the bias of the fix to the horizon; N and E over the same time."""
    for k in range(EX_FIX_BIAS, EX_FIX_HEADING + 1):
        keep, by = 1.0, s.decay[k]
        blocks = (m.horizon_tick - m.fix_bias_tick) // s.block_ticks
        while blocks > 0:
            if blocks % 2 == 1:
                keep *= by
            by *= by
            blocks //= 2
        m.x[k + 1] *= keep
        q = _fix_bias_variance(m, s, k - EX_FIX_BIAS) * (1.0 - keep * keep)
        if q > 0.0:
            gauss_markov_update(m.u_transposed, m.d, k, keep, q, m.f)
    m.fix_bias_tick = m.horizon_tick


@cached_njit(error_model="numpy")
def measurement_cost(m: FilterMemory, s: FilterSettings, kind: int, left: int) -> int:
    """Return the cost in scalar measurements; for the ring, the number of beams for which there is time."""
    if kind == R_FIX:
        return COST_FIX_BIAS if m.fix_bias_tick < m.horizon_tick else COST_FIX
    return max(min(s.beam_count - m.next_beam, left), 1) if kind == R_RING else 1


@cached_njit(error_model="numpy")
def fuse_measurement(m: FilterMemory, s: FilterSettings, i: int, r: _Array, cost: int) -> bool:
    """Fuse queued measurement ``i``, as far as the budget ``cost`` permits; return whether all of it is fused."""
    kind, z, ahead = m.queue_sensor[i], m.queue_value[i], m.queue_ahead[i]
    if kind == R_FIX and m.fix_bias_tick < m.horizon_tick:
        _predict_fix_bias(m, s)
        return False
    if kind == R_FIX:
        fuse_position_fix(m, s, z, ahead)
    elif kind == R_SONAR:
        fuse_sonar_range(m, s, z, ahead, r)
    elif kind == R_RING:
        return bool(fuse_wall_ranges(m, s, z, ahead, r, cost))
    elif kind == R_PRESSURE:
        fuse_pressure_height(m, s, z, ahead)
    else:
        fuse_magnetic_heading(m, s, z, ahead, r)
    return True


@cached_njit(error_model="numpy")
def fuse_accel_residual(m: FilterMemory, s: FilterSettings, r: _Array, count: int, i: int) -> None:
    """Fuse accelerometers less model along axis ``i``, a mean over ``count`` periods: biases, thrust, wind,
    velocity."""
    rotation_matrix(m.x[SX_ATT : SX_ATT + 4], r)
    slope = m.velocity_slope[i]
    _h_row_begin(m, EX_ACCEL_BIAS + i, 1.0)
    _h_row_add(m, EX_THRUST_SCALE, m.thrust_slope[i])
    for j in range(3):
        _h_row_add(m, EX_VEL + j, slope * r[3 * j + i])
    _h_row_add(m, EX_WIND, -slope * r[i])
    _h_row_add(m, EX_WIND + 1, -slope * r[3 + i])
    nu = m.accel_mean[i] - m.model_accel_mean[i] - m.x[SX_ACCEL_BIAS + i]
    r_ = m.residual_density[i] / (count * s.dt)
    known = innovation_variance(m.u_transposed, m.d, m.h_state, m.h, m.h_terms, m.f)
    ratio = nu / math.sqrt(known + r_)
    check_accel_model(m, s, r, height_above_ground(m.x_output, s), nu, r_, known, i)
    if abs(ratio) < INNOVATION_GATE and m.is_accel_distrusted == 0:
        _fuse_scalar(m, nu, r_)
    if i == 0 or abs(ratio) > m.residual_ratio:
        _log_innovation(m, R_ACCELERATION, nu, ratio)
        m.residual_ratio = abs(ratio)


@cached_njit(error_model="numpy")
def fuse_zero_motion(m: FilterMemory, s: FilterSettings, r: _Array, count: int, mode: int, i: int) -> None:
    """Fuse on the floor zero velocity along axis ``i``, zero rate unless rotors run down, and gravity at rest."""
    _h_row_begin(m, EX_VEL + i, 1.0)
    _fuse_scalar(m, -m.x[SX_VEL + i], 4e-4)
    if mode == PHASE_COASTING:
        return  # such rotors turn the vehicle on its legs: that is no noise, but a rate that lasts
    still = mode == PHASE_STANDING
    _h_row_begin(m, EX_GYRO_BIAS + i, 1.0)
    calm = s.rest_gyro_sigma * s.rest_gyro_sigma / count if still else 2.5e-5
    off = m.gyro_mean[i] - m.x[SX_GYRO_BIAS + i]
    # With its rotors running it may slide and turn on its legs.
    if still or abs(_innovation_ratio(m, off, calm * 2)) < INNOVATION_GATE:
        _fuse_scalar(m, off, calm * 2)
    if still and s.is_fitted[R_ACCELERATION] > 0:
        rotation_matrix(m.x[SX_ATT : SX_ATT + 4], r)
        # R^T (-g e_D), and d(R^T u) = R^T (u x t)
        _h_row_begin(m, EX_ACCEL_BIAS + i, 1.0)
        _h_row_add(m, EX_ATT, -r[3 + i] * GRAVITY)
        _h_row_add(m, EX_ATT + 1, r[i] * GRAVITY)
        nu = m.accel_mean[i] + GRAVITY * r[6 + i] - m.x[SX_ACCEL_BIAS + i]
        r_ = 2 * s.rest_accel_sigma * s.rest_accel_sigma / count
        if abs(_innovation_ratio(m, nu, r_)) < 2 * INNOVATION_GATE:
            _fuse_scalar(m, nu, r_)
