"""Fusion of a fix of position and heading: noise and bias of the fix, its agreement with the sonar, its reset.

The fix measures the position p + v dt + b and the heading psi + b_h. The velocity v moves the position from the horizon
to the time of the fix, dt later. The biases b and b_h are Gauss-Markov processes. The variances of biases and noise are
estimated from the innovations. A reset inflates variances, so the correlations of the errors stay.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import portable_atan2, wrap_angle
from mufly.estimate.filter.filter_records import (
    AID_HEADING,
    AID_POSITION,
    ERROR_ATTITUDE,
    ERROR_FIX_BIAS,
    ERROR_FIX_HEADING,
    ERROR_GYRO_BIAS,
    ERROR_POSITION,
    ERROR_VELOCITY,
    FIX_COMPONENT_COUNT,
    FIX_DOWN,
    FIX_EAST,
    FIX_HEADING,
    FIX_NORTH,
    NOMINAL_ATTITUDE,
    NOMINAL_FIX_BIAS,
    NOMINAL_FIX_HEADING,
    NOMINAL_VELOCITY,
    PHASE_LIFTING_OFF,
    READING_POSITION_FIX,
    READING_RANGE_RING,
    READING_RATES,
    READING_SONAR,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.measurements.scalar_fusion import (
    INNOVATION_GATE,
    MAX_INNOVATION_RATIO_PRODUCT,
    MAX_NOISE_SCALE,
    MAX_SQUARED_INNOVATION_RATIO,
    NOISE_GAIN_HEADING,
    NOISE_GAIN_POSITION,
    adapt_noise_scale,
    fuse_scalar,
    h_row_add,
    h_row_begin,
    innovation_ratio,
    log_innovation,
    reject_measurement,
    reset_timeout_expired,
)
from mufly.estimate.filter.measurements.sensor_checks import (
    REASON_FUSED_THOUGH_OFFSET,
    REASON_HEIGHT_CONFLICT,
    REASON_INNOVATION,
    REASON_LARGE_BIAS,
    REASON_NONE,
    REASON_RESET,
    STATUS_FAULTY,
    STATUS_FUSED,
    STATUS_REJECTED,
    inflate_variances_on_divergence,
    mark_fused,
    set_fault,
)
from mufly.estimate.filter.ud_filter import gauss_markov_update, inflate_variance

_Array = NDArray[np.float64]

FIX_MEAN_SQUARE_GATE = 11.0
"""Mean square of the worst of the fix's four ratios over half a second; 2.4 is usual."""
DIVERGENCE_MEAN_SQUARE = 5.0
"""Mean square of the ratios above which a rejected fix is not treated as a jump of the fix."""
FIX_CHECK_SETTLING_TIME_S = 3.0
"""Time in flight before which no ratio of the fix accuses the filter, whose state is well known at rest (s)."""
LASTING_FIX_INNOVATION_RATIO = 1.0
"""Mean of a ratio of the fix over half a second above which the filter, not the noise, is the cause (1)."""
MAX_FIX_BIAS_SIGMAS = 5.5
"""Largest bias of the fix in standard deviations a. A Gauss-Markov bias of time constant tau passes a on either side
2 a phi(a) / tau times a second (phi: normal density; Pickands, 1969). Three axes with tau of 2 s pass 5.5 deviations
0.06 times in ten hours, and 5 deviations 0.8 times."""
MAX_GYRO_BIAS_SIGMAS = 8.0
"""Deviations of the initial gyroscope bias beyond which the gyroscopes are unusable for long."""
REJECTED_INNOVATION_BIAS_SIGMAS = 3.0
"""An innovation of the fix at rest beyond the gate counts as this many deviations of its bias."""


@cached_njit(error_model="numpy")
def _fix_h_row(m: FilterMemory, i: int, ahead: float) -> None:
    """Write the row H (derivative by the error state) of component ``i`` of a fix: N, E, D or heading.

    The fix was taken ``ahead`` (s) after the horizon; a negative ``ahead`` means before it.

    The rows of N and E contain the velocity. Without this term a late fix would correct the present position by a past
    error, and a filter of uncertain attitude, as in a turn, would oscillate. The sonar determines the vertical
    velocity, so the row of D needs no such term.
    """
    if i < FIX_HEADING:
        h_row_begin(m, ERROR_POSITION + i, 1.0)
        h_row_add(m, ERROR_FIX_BIAS + i, 1.0)
        if i < FIX_DOWN:
            h_row_add(m, ERROR_VELOCITY + i, ahead)
    else:
        h_row_begin(m, ERROR_ATTITUDE + 2, 1.0)
        h_row_add(m, ERROR_FIX_HEADING, 1.0)


@cached_njit(error_model="numpy")
def _fix_innovation(m: FilterMemory, z: _Array, i: int, ahead: float) -> float:
    """Return the innovation (m or rad) of component ``i`` of a fix ``z``, taken ``ahead`` (s) after the horizon."""
    x = m.x
    if i < FIX_HEADING:
        return z[i] - x[i] - ahead * x[NOMINAL_VELOCITY + i] - x[NOMINAL_FIX_BIAS + i]
    yaw = portable_atan2(
        2 * (x[NOMINAL_ATTITUDE] * x[NOMINAL_ATTITUDE + 3] + x[NOMINAL_ATTITUDE + 1] * x[NOMINAL_ATTITUDE + 2]),
        1 - 2 * (x[NOMINAL_ATTITUDE + 2] * x[NOMINAL_ATTITUDE + 2] + x[NOMINAL_ATTITUDE + 3] * x[NOMINAL_ATTITUDE + 3]),
    )
    off = z[FIX_HEADING] - yaw - ahead * m.yaw_rate - x[NOMINAL_FIX_HEADING]
    return wrap_angle(off)


@cached_njit(error_model="numpy")
def _fix_variance(m: FilterMemory, s: FilterSettings, i: int) -> float:
    """Return the estimated variance of component ``i`` of the fix."""
    return (
        s.fix_variance * m.noise_scale[AID_POSITION]
        if i < FIX_HEADING
        else s.fix_heading_variance * m.noise_scale[AID_HEADING]
    )


@cached_njit(error_model="numpy")
def _fix_bias_variance(m: FilterMemory, s: FilterSettings, i: int) -> float:
    """Return the estimated variance of the bias of component ``i`` of the fix."""
    sigma = s.initial_sigma[ERROR_FIX_BIAS + i]
    return sigma * sigma * m.bias_walk_scale[AID_POSITION if i < FIX_HEADING else AID_HEADING]


@cached_njit(error_model="numpy")
def _estimate_fix_noise(m: FilterMemory, i: int) -> None:
    """Estimate the variances of noise and bias of component ``i`` of the fix from its innovation ratio.

    If the sum of both variances is right, the mean square of the ratio is 1. If their proportion is right, the mean
    product of two successive ratios is 0; a negative mean shows that the noise is larger than assumed, a positive one
    that the bias is (correlation of innovations, Mehra 1970). Both variances follow by stochastic approximation. A
    ratio with a lasting mean shows an error of the filter and does not change the variances.
    """
    aid = AID_POSITION if i < FIX_HEADING else AID_HEADING
    gain = NOISE_GAIN_POSITION if i < FIX_HEADING else NOISE_GAIN_HEADING
    ratio = m.fix_ratio[i]
    excess = min(ratio * ratio, MAX_SQUARED_INNOVATION_RATIO) - 1.0
    pair = max(min(ratio * m.fix_ratio_prev[i], MAX_INNOVATION_RATIO_PRODUCT), -MAX_INNOVATION_RATIO_PRODUCT)
    if m.is_heading_aligned != 0 and abs(m.fix_ratio_mean[i]) < LASTING_FIX_INNOVATION_RATIO:
        adapt_noise_scale(m.noise_scale, aid, gain, excess - pair)
        adapt_noise_scale(m.bias_walk_scale, aid, gain, excess + pair)
    m.fix_ratio_prev[i] = ratio
    m.fix_ratio_mean[i] += 0.15 * (ratio - m.fix_ratio_mean[i])


@cached_njit(error_model="numpy")
def _largest_mean_ratio(m: FilterMemory) -> float:
    """Return the largest mean of the innovation ratios of N, E and heading."""
    return max(
        max(abs(m.fix_ratio_mean[FIX_NORTH]), abs(m.fix_ratio_mean[FIX_EAST])), abs(m.fix_ratio_mean[FIX_HEADING])
    )


@cached_njit(error_model="numpy")
def _compute_fix_bias_limit_ratio(m: FilterMemory, s: FilterSettings, i: int) -> float:
    """Return the estimated bias of component ``i`` of the fix, divided by the largest bias that its model allows.

    A Gauss-Markov process of deviation sigma exceeds 5 sigma once in two million correlation times. Innovations do
    not show such an error, because the bias follows it.
    """
    return abs(m.x[NOMINAL_FIX_BIAS + i]) / (
        MAX_FIX_BIAS_SIGMAS * math.sqrt(_fix_bias_variance(m, s, i) + _fix_variance(m, s, i))
    )


@cached_njit(error_model="numpy")
def _inflate_fix_bias_walk(m: FilterMemory, s: FilterSettings, i: int, nu: float, ratio: float) -> float:
    """Raise the bias variance of the fix until it explains an innovation ``nu`` at rest; return the new innovation
    ratio.

    The velocity of a vehicle at rest is known, so an innovation beyond the gate is an error of the fix. An innovation
    that the largest bias variance does not explain remains a jump.
    """
    sigma = s.initial_sigma[ERROR_FIX_BIAS + i]
    spread = nu / REJECTED_INNOVATION_BIAS_SIGMAS
    scale = spread * spread / (sigma * sigma)
    aid = AID_POSITION if i < FIX_HEADING else AID_HEADING
    if not scale < MAX_NOISE_SCALE:
        return ratio
    m.bias_walk_scale[aid] = max(m.bias_walk_scale[aid], scale)
    inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_FIX_BIAS + i, spread * spread, m.u_transposed_h)
    return innovation_ratio(m, nu, _fix_variance(m, s, i))


@cached_njit(error_model="numpy")
def _sonar_height_valid(m: FilterMemory, s: FilterSettings) -> bool:
    """Return whether the sonar measures the height over a known floor."""
    k = READING_SONAR
    fresh = m.last_fused_tick[k] > 0 and (m.tick - m.last_fused_tick[k]) * s.dt < 0.3
    return fresh and m.status[k] == STATUS_FUSED and m.reason[k] == REASON_NONE and not m.terrain_edge_weight > 0.0


@cached_njit(error_model="numpy")
def _fix_height_consistent(m: FilterMemory, s: FilterSettings, nu: float, ratio: float) -> bool:
    """Return whether fix and sonar agree on the height; if not, write the gap to ``m.fix_sonar_height_difference``.

    The filter cannot decide which of the two is wrong, because the pressure drifts by as much as they differ. The
    height follows the sonar, and the gap is added to the standard deviation of the position.
    """
    k = READING_POSITION_FIX
    off = abs(ratio)
    whole = abs(nu + m.x[NOMINAL_FIX_BIAS + 2])
    if m.fix_sonar_height_difference > 0.0:
        blind = (m.tick - m.last_fused_tick[READING_SONAR]) * s.dt > 0.3
        m.fix_sonar_height_difference = 0.0 if blind or off < 2.5 else whole
    elif _sonar_height_valid(m, s) and (
        _compute_fix_bias_limit_ratio(m, s, 2) > 1.0 or (off > INNOVATION_GATE and reset_timeout_expired(m, s, k))
    ):
        m.fix_sonar_height_difference = whole
    return m.fix_sonar_height_difference == 0.0


@cached_njit(error_model="numpy")
def _is_only_height_rejected(m: FilterMemory) -> bool:
    """Return whether the height is the only component of the fix outside the gate."""
    off = max(max(abs(m.fix_ratio[FIX_NORTH]), abs(m.fix_ratio[FIX_EAST])), abs(m.fix_ratio[FIX_HEADING]))
    return m.worst_fix_component == FIX_DOWN and off < INNOVATION_GATE


@cached_njit(error_model="numpy")
def _mark_fix_height_faulty(m: FilterMemory) -> None:
    """Change the status of a fix from rejected to faulty if only its height is rejected.

    A fix of wrong height does not contradict the attitude.
    """
    if m.status[READING_POSITION_FIX] == STATUS_REJECTED and _is_only_height_rejected(m):
        m.status[READING_POSITION_FIX] = STATUS_FAULTY


@cached_njit(error_model="numpy")
def fuse_position_fix(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float) -> None:
    """Fuse position and heading of a fix; leave out its height while fix and sonar disagree."""
    k, worst, at = READING_POSITION_FIX, 0.0, 0.0
    down = True
    for i in range(FIX_COMPONENT_COUNT):
        _fix_h_row(m, i, ahead)
        nu = _fix_innovation(m, z, i, ahead)
        ratio = innovation_ratio(m, nu, _fix_variance(m, s, i))
        if abs(ratio) > INNOVATION_GATE and m.is_heading_aligned != 0 and m.flight_phase < PHASE_LIFTING_OFF:
            ratio = _inflate_fix_bias_walk(m, s, i, nu, ratio)
        if i == FIX_DOWN:
            down = _fix_height_consistent(m, s, nu, ratio)
            if not down:
                continue
        elif m.is_heading_aligned == 0 and abs(ratio) > INNOVATION_GATE:
            # The initial position is unknown: the first fix sets it.
            inflate_variance(
                m.u_transposed,
                m.ud_diagonal,
                ERROR_POSITION + i if i < FIX_HEADING else ERROR_ATTITUDE + 2,
                nu * nu,
                m.u_transposed_h,
            )
            ratio = innovation_ratio(m, nu, _fix_variance(m, s, i))
        m.fix_ratio[i] = ratio
        if abs(ratio) > abs(worst):
            worst, at = ratio, nu
            m.worst_fix_component = i
    log_innovation(m, k, at, worst)
    # Growing ratios of one sign show that the filter diverges, not that the fix jumps. Without a rotor model the
    # variances are a guess, and the filter would follow a record with wrong axes from fix to fix.
    settled = (m.tick - m.last_grounded_tick) * s.dt > FIX_CHECK_SETTLING_TIME_S
    lasting = settled and _largest_mean_ratio(m) > LASTING_FIX_INNOVATION_RATIO
    led = (
        s.has_rotor_model > 0
        and lasting
        and m.fix_max_ratio_squared_lp > DIVERGENCE_MEAN_SQUARE
        and INNOVATION_GATE < abs(worst) < 2.0 * INNOVATION_GATE
    )
    if abs(worst) > INNOVATION_GATE and not led:
        # A height that differs from the sonar's does not show which of the two is wrong.
        apart = _is_only_height_rejected(m) and m.status[READING_SONAR] == STATUS_FUSED
        why = REASON_HEIGHT_CONFLICT if apart else REASON_INNOVATION
        near = 2.0 * s.sensor_period[k] + 8 * math.sqrt(_fix_variance(m, s, 0)) + 0.05
        reject_measurement(m, s, k, at, z, 3, near, why)
        _mark_fix_height_faulty(m)
        if not reset_timeout_expired(m, s, k):
            return
        # Components that other sensors hold are kept: there the bias of the fix is reset.
        held = m.status[READING_SONAR] == STATUS_FUSED, m.status[READING_RANGE_RING] == STATUS_FUSED
        for i in range(3):
            nu = _fix_innovation(m, z, i, ahead)
            if held[0] if i == FIX_DOWN else held[1]:
                inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_FIX_BIAS + i, nu * nu, m.u_transposed_h)
            else:
                inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_POSITION + i, nu * nu, m.u_transposed_h)
                inflate_variance(
                    m.u_transposed, m.ud_diagonal, ERROR_VELOCITY + i, 0.01 + 0.1 * nu * nu, m.u_transposed_h
                )
        nu = _fix_innovation(m, z, FIX_HEADING, ahead)
        inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_ATTITUDE + 2, nu * nu, m.u_transposed_h)
        nu = at
        set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)
        _mark_fix_height_faulty(m)
    # Large ratios of one sign show an unmodelled error of the filter, for example drifting gyroscopes.
    m.fix_max_ratio_squared_lp += 0.15 * (worst * worst - m.fix_max_ratio_squared_lp)
    for i in range(FIX_COMPONENT_COUNT):
        if i != FIX_DOWN or down:
            _estimate_fix_noise(m, i)
    out = max(
        _compute_fix_bias_limit_ratio(m, s, FIX_NORTH),
        _compute_fix_bias_limit_ratio(m, s, FIX_EAST),
        _compute_fix_bias_limit_ratio(m, s, FIX_HEADING),
    )
    if led or (lasting and m.fix_max_ratio_squared_lp > FIX_MEAN_SQUARE_GATE) or (out > 1.0 and settled):
        inflate_variances_on_divergence(m, s)
        set_fault(m, s, k, STATUS_FUSED, REASON_FUSED_THOUGH_OFFSET, at)
    for i in range(FIX_COMPONENT_COUNT):
        if i == FIX_DOWN and not down:
            continue
        _fix_h_row(m, i, ahead)
        fuse_scalar(m, _fix_innovation(m, z, i, ahead), _fix_variance(m, s, i))
    for i in range(3):
        most = MAX_GYRO_BIAS_SIGMAS * s.initial_sigma[ERROR_GYRO_BIAS + i] + 2.0 * m.sigma_output[ERROR_GYRO_BIAS + i]
        if abs(m.gyro_bias_at_zero_yaw_rate[i]) > most and m.status[READING_RATES] == STATUS_FUSED and down:
            set_fault(m, s, READING_RATES, STATUS_REJECTED, REASON_LARGE_BIAS, m.gyro_bias_at_zero_yaw_rate[i])
    mark_fused(m, k)
    if not down:
        set_fault(m, s, k, STATUS_FAULTY, REASON_HEIGHT_CONFLICT, m.fix_sonar_height_difference)
    m.is_heading_aligned = 1


@cached_njit(error_model="numpy")
def predict_fix_bias(m: FilterMemory, s: FilterSettings) -> None:
    """Predict the biases of the position fix up to the delayed horizon.

    N and E have equal intervals.
    """
    for k in range(ERROR_FIX_BIAS, ERROR_FIX_HEADING + 1):
        keep, by = 1.0, s.decay[k]
        blocks = (m.horizon_tick - m.fix_bias_tick) // s.block_ticks
        while blocks > 0:
            if blocks % 2 == 1:
                keep *= by
            by *= by
            blocks //= 2
        m.x[k + 1] *= keep
        q = _fix_bias_variance(m, s, k - ERROR_FIX_BIAS) * (1.0 - keep * keep)
        if q > 0.0:
            gauss_markov_update(m.u_transposed, m.ud_diagonal, k, keep, q, m.u_transposed_h)
    m.fix_bias_tick = m.horizon_tick
