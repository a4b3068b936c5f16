"""Fusion of one scalar measurement: its row H, its gate, its rejection, and the estimate of its noise.

A scalar measurement z = h(x) + n has an innovation of variance S = H P H^T + r. Few elements of the row H are not zero;
``m.h_state_index`` and ``m.h_value`` hold their indices and values. A correction applies to the state at the horizon
and to those propagated from it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.estimate.filter.filter_records import (
    ERROR_ATTITUDE,
    ERROR_POSITION,
    ERROR_STATE_COUNT,
    ERROR_VELOCITY,
    NOMINAL_POSITION,
    NOMINAL_VELOCITY,
    READING_SONAR,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.measurements.sensor_checks import mark_rejected
from mufly.estimate.filter.strapdown import rotate_attitude
from mufly.estimate.filter.ud_filter import innovation_variance, ud_measurement_update

_Array = NDArray[np.float64]

INNOVATION_GATE = 5.0
"""Gate in standard deviations: one healthy reading in two million is rejected."""
RESET_TIMEOUT_S = 1.0
"""Time over which rejected readings agree with each other before the filter is reset to them (s)."""
NOISE_GAIN_POSITION, NOISE_GAIN_HEADING, NOISE_GAIN_AID = 0.004, 0.008, 0.03
"""Gain of the estimated variances of a fix, per component of a fix, and of another aid, per reading."""
MAX_SQUARED_INNOVATION_RATIO, MAX_INNOVATION_RATIO_PRODUCT = 9.0, 3.0
"""A larger squared innovation ratio, or product of two, counts as this."""
MIN_NOISE_SCALE, MAX_NOISE_SCALE = 0.25, 25.0
"""Bounds of the estimated variances over those of the file."""


@cached_njit(error_model="numpy")
def h_row_begin(m: FilterMemory, i: int, h: float) -> None:
    """Begin the row H of a measurement with the element ``h`` for error state ``i``."""
    m.h_term_count = 1
    m.h_state_index[0] = i
    m.h_value[0] = h


@cached_njit(error_model="numpy")
def h_row_add(m: FilterMemory, i: int, h: float) -> None:
    """Add the element ``h`` for error state ``i`` to the row H."""
    m.h_state_index[m.h_term_count] = i
    m.h_value[m.h_term_count] = h
    m.h_term_count += 1


@cached_njit(error_model="numpy")
def _add_propagated_error(x: _Array, by: _Array, span: float, push: _Array) -> None:
    """Propagate the correction ``by`` (error state at the horizon) over ``span`` (s), and add it to the state ``x``.

    ``push`` (3,) is the change of velocity during ``span`` without gravity.
    """
    v_x = by[ERROR_VELOCITY] + (
        by[ERROR_ATTITUDE + 1] * push[2] - by[ERROR_ATTITUDE + 2] * push[1] if span > 0.0 else 0.0
    )
    v_y = by[ERROR_VELOCITY + 1] + (
        by[ERROR_ATTITUDE + 2] * push[0] - by[ERROR_ATTITUDE] * push[2] if span > 0.0 else 0.0
    )
    v_z = by[ERROR_VELOCITY + 2] + (
        by[ERROR_ATTITUDE] * push[1] - by[ERROR_ATTITUDE + 1] * push[0] if span > 0.0 else 0.0
    )
    x[NOMINAL_POSITION] += by[ERROR_POSITION] + 0.5 * span * (by[ERROR_VELOCITY] + v_x)
    x[NOMINAL_POSITION + 1] += by[ERROR_POSITION + 1] + 0.5 * span * (by[ERROR_VELOCITY + 1] + v_y)
    x[NOMINAL_POSITION + 2] += by[ERROR_POSITION + 2] + 0.5 * span * (by[ERROR_VELOCITY + 2] + v_z)
    x[NOMINAL_VELOCITY] += v_x
    x[NOMINAL_VELOCITY + 1] += v_y
    x[NOMINAL_VELOCITY + 2] += v_z
    rotate_attitude(x, by[ERROR_ATTITUDE], by[ERROR_ATTITUDE + 1], by[ERROR_ATTITUDE + 2], False)
    for i in range(9, ERROR_STATE_COUNT):
        x[i + 1] += by[i]


@cached_njit(error_model="numpy")
def apply_correction(m: FilterMemory, innovation: float, r: float) -> None:
    """Fuse a scalar whose U^T h is in ``m.u_transposed_h``; correct the state at the horizon and the states propagated
    from there.
    """
    ud_measurement_update(m.u_transposed, m.ud_diagonal, m.u_transposed_h, r, m.gain)
    for i in range(ERROR_STATE_COUNT):
        m.gain[i] *= innovation
    _add_propagated_error(m.x, m.gain, 0.0, m.repropagating_velocity_change)
    _add_propagated_error(m.x_repropagating, m.gain, m.repropagating_span, m.repropagating_velocity_change)
    _add_propagated_error(m.x_now, m.gain, m.x_now_span, m.now_velocity_change)


@cached_njit(error_model="numpy")
def fuse_scalar(m: FilterMemory, innovation: float, r: float) -> None:
    """Fuse a scalar measurement of variance ``r`` without a gate; its row is in ``m.h_value``."""
    innovation_variance(m.u_transposed, m.ud_diagonal, m.h_state_index, m.h_value, m.h_term_count, m.u_transposed_h)
    apply_correction(m, innovation, r)


@cached_njit(error_model="numpy")
def fuse_error_state(m: FilterMemory, i: int, innovation: float, r: float) -> None:
    """Fuse a measurement of error state ``i`` itself, of variance ``r``, without a gate."""
    h_row_begin(m, i, 1.0)
    fuse_scalar(m, innovation, r)


@cached_njit(error_model="numpy")
def innovation_ratio(m: FilterMemory, innovation: float, r: float) -> float:
    """Return the innovation over its standard deviation."""
    return innovation / math.sqrt(
        innovation_variance(m.u_transposed, m.ud_diagonal, m.h_state_index, m.h_value, m.h_term_count, m.u_transposed_h)
        + r
    )


@cached_njit(error_model="numpy")
def log_innovation(m: FilterMemory, k: int, innovation: float, ratio: float) -> None:
    """Record the innovation of a sensor and its standard deviation for the innovation checks."""
    m.innovation[k] = innovation
    m.innovation_sigma[k] = abs(innovation / ratio) if ratio != 0.0 else 0.0


@cached_njit(error_model="numpy")
def reject_measurement(
    m: FilterMemory, s: FilterSettings, k: int, innovation: float, z: _Array, count: int, near: float, why: int
) -> None:
    """Reject a reading for reason ``why``; ``m.agreeing_reject_count`` counts agreeing rejected readings in a row."""
    alike = m.reject_count[k] > 0
    for j in range(count):
        alike = alike and abs(z[j] - m.rejected_value[k, j]) < near
        m.rejected_value[k, j] = z[j]
    if alike:
        m.agreeing_reject_count[k] += 1
    else:
        m.agreeing_reject_count[k] = 0
        m.agreeing_reject_since_tick[k] = m.horizon_tick
    if k != READING_SONAR and abs(innovation) > 2.0 * INNOVATION_GATE * m.innovation_sigma[k]:
        m.reject_score[k] += 1.0  # no healthy sensor but a sonar with a second surface deviates so much
    mark_rejected(m, s, k, why, innovation)


@cached_njit(error_model="numpy")
def reset_timeout_expired(m: FilterMemory, s: FilterSettings, k: int) -> bool:
    """Return whether rejected readings have agreed with each other for :data:`RESET_TIMEOUT_S`."""
    return (
        m.agreeing_reject_count[k] >= 3 and (m.horizon_tick - m.agreeing_reject_since_tick[k]) * s.dt >= RESET_TIMEOUT_S
    )


@cached_njit(error_model="numpy")
def adapt_noise_scale(scale: _Array, aid: int, gain: float, change: float) -> None:
    """Multiply the noise scale ``scale[aid]`` by ``1 + gain * change``, and clip it to its permitted range.

    Increases and decreases have no separate limit, because a limit in one direction would bias the estimate.
    """
    scale[aid] = max(min(scale[aid] * (1.0 + gain * change), MAX_NOISE_SCALE), MIN_NOISE_SCALE)


@cached_njit(error_model="numpy")
def estimate_noise(m: FilterMemory, aid: int, ratio: float) -> None:
    """Adapt the noise variance of a sensor with one component (such as the sonar) to its innovation ratio."""
    adapt_noise_scale(m.noise_scale, aid, NOISE_GAIN_AID, min(ratio * ratio, MAX_SQUARED_INNOVATION_RATIO) - 1.0)
