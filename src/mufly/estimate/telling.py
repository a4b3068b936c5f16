"""What the filter tells: the horizon's state carried on to now, its errors, and no jumps.

How the horizon is carried on, and why not all of it in every period, is told in :mod:`mufly.estimate.kernel`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.estimate.factors import carry_column, variance
from mufly.estimate.layout import ERRORS, FLYING, KEPT, LOW, MODELLED, R_FIX, STATES, TURN_RAD
from mufly.estimate.motion import advance_state, transition, turned
from mufly.trigonometry import direction, sine_cosine, whole
from mufly.units import GRAVITY

_Array = NDArray[np.float64]

LONGEST = 8
"""Periods over which forces are compared."""
TOLD_EVERY = 20
"""Periods between two covariances that are told."""
JUMP, SLIP_S = 0.05, 0.4
"""A jump of the state of more than this (m) is told over some time (s)."""


@compiled(error_model="numpy")
def spread_along(r: _Array, k: int, e: _Array) -> float:
    """Density of the velocity's noise along an axis of N-E-D."""
    spread = 0.0
    for i in range(3):
        spread += r[3 * k + i] * r[3 * k + i] * e[18 + i]
    return spread


@compiled(error_model="numpy")
def _carry_on(m: Any, s: Any, r: _Array, a: _Array) -> None:
    """Carry the horizon's state on towards now, some blocks a period; ``m.come`` is at now."""
    for _ in range(s.work):
        e = m.inputs[m.way_tick // s.block % KEPT]
        periods = min(s.block - m.way_tick % s.block, m.tick - m.way_tick)
        span = periods * s.dt
        advance_state(m.way, e, span, r, a)
        for k in range(3):
            m.way_sum[k] += spread_along(r, k, e) * span
            m.way_sum[3 + k] += a[k] * span
        m.way_tick += periods
        m.way_span += span
        if m.way_tick == m.tick:
            for k in range(6):
                m.come_sum[k] = m.way_sum[k]
                m.way_sum[k] = 0.0
            m.span = m.way_span
            m.way_span = 0.0
            for i in range(STATES):
                m.come[i] = m.way[i]
                m.way[i] = m.x[i]
            m.way_tick = m.horizon
            return
    advance_state(m.come, m.now, s.dt, r, a)


@compiled(error_model="numpy")
def tell(m: Any, s: Any, r: _Array, a: _Array) -> None:
    """Tell the state of now; now and then its covariance too."""
    _carry_on(m, s, r, a)
    x = m.out
    for i in range(STATES):
        x[i] = m.come[i]
    much = m.tick % TOLD_EVERY == 0
    if much:
        _told_errors(m, s, r)
    # States belong to `lag` before the tick: the last bit with the last rates and acceleration.
    a[2] += GRAVITY
    for k in range(3):
        x[k] += s.lag * (x[3 + k] + 0.5 * s.lag * a[k])
        x[3 + k] += s.lag * a[k]
        m.out_rates[k] = m.rates[k] - x[10 + k]
        if s.model > 0 and m.mode == FLYING:
            m.out_rates[k] += s.lag * m.force[m.tick % MODELLED, 9 + k]
    turned(x, s.lag * m.out_rates[0], s.lag * m.out_rates[1], s.lag * m.out_rates[2], True)
    if s.model > 0 and x[16] < LOW:
        # Legs do not go into the floor on the way either, nor on.
        lowest = -(max(x[16], 0.0) + s.stands)
        if x[2] >= lowest:
            x[2] = lowest
            x[5] = min(x[5], 0.0)
    _smooth(m, s)
    _angles(m)
    if much:
        _tell_covariance(m)


@compiled(error_model="numpy")
def _angles(m: Any) -> None:
    """Roll, pitch and yaw of the attitude that is told."""
    w, x, y, z = m.out[6], m.out[7], m.out[8], m.out[9]
    sine = min(max(2 * (w * y - z * x), -1.0), 1.0)
    m.angles[0] = direction(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    m.angles[1] = direction(sine, math.sqrt((1 - sine) * (1 + sine)))
    yaw = direction(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    m.angles[2] = yaw + TURN_RAD * whole((m.angles[2] - yaw) / TURN_RAD + 0.5)


@compiled(error_model="numpy")
def _smooth(m: Any, s: Any) -> None:
    """Let what is told follow a jump of the state within a second, so that none goes to the actuators."""
    x = m.out
    for k in range(3):
        jump = x[k] - (m.told[k] + s.dt * x[3 + k])
        if m.lifted > 0 and abs(jump) > JUMP:
            m.slip[k] -= jump
        m.told[k] = x[k]
        m.slip[k] -= s.dt / SLIP_S * m.slip[k]
        x[k] += m.slip[k]


@compiled(error_model="numpy")
def _told_errors(m: Any, s: Any, r: _Array) -> None:
    """Covariance of what moves over the delay, F P F^T + Q, in one step by the mean acceleration on the way."""
    span = m.span
    for k in range(3):
        m.row[k] = m.come_sum[3 + k] / span
    transition(m.now, span, r, m.row, m.transition)
    for i in range(9):
        for j in range(i, 9):
            m.out_cov[i, j] = 0.0
    for k in range(ERRORS):
        carry_column(m.ut[k], span, m.transition, m.gain)
        for i in range(9):
            c = m.d[k] * m.gain[i]
            for j in range(i, 9):
                m.out_cov[i, j] += c * m.gain[j]
    for k in range(3):
        m.out_cov[k, k] += m.come_sum[k] * span * span / 3.0
        m.out_cov[k, 3 + k] += m.come_sum[k] * span / 2.0
        m.out_cov[3 + k, 3 + k] += m.come_sum[k]
        for i in range(3):
            # A shaking is in the velocity for half a turn; what stays in means over blocks tells how much.
            share = r[3 * k + i] * m.now[15 + i]
            shaking = max(m.scatter[i] - m.slow[i], 0.0)
            m.out_cov[3 + k, 3 + k] += share * share * ((LONGEST * s.dt) * shaking)
        m.out_cov[6 + k, 6 + k] += s.gyro_density * span


@compiled(error_model="numpy")
def _tell_covariance(m: Any) -> None:
    """What is told of the errors, of the attitude as roll, pitch and yaw."""
    for i in range(9):
        for j in range(i):
            m.out_cov[i, j] = m.out_cov[j, i]
    for i in range(9, ERRORS):
        m.sigma[i] = math.sqrt(variance(m.ut, m.d, i))
    for i in range(9):
        if i < 3:
            # Whoever is off in height, fix or sonar, the fix may be off by as much in any direction
            m.out_cov[i, i] += m.slip[i] * m.slip[i] + m.suspect[R_FIX, 3] * m.suspect[R_FIX, 3]
        m.sigma[i] = math.sqrt(m.out_cov[i, i])
    # Turns about N, E, D to roll, pitch and yaw
    x = m.out
    sine = min(max(2 * (x[6] * x[8] - x[9] * x[7]), -1.0), 1.0)
    cosine = max(math.sqrt(1 - sine * sine), 0.05)
    t, c = sine_cosine(m.angles[2])
    for j in range(9):
        n_, e_ = m.out_cov[6, j], m.out_cov[7, j]
        m.out_cov[6, j] = (c * n_ + t * e_) / cosine
        m.out_cov[7, j] = -t * n_ + c * e_
        m.out_cov[8, j] += sine / cosine * (c * n_ + t * e_)
    for j in range(9):
        n_, e_ = m.out_cov[j, 6], m.out_cov[j, 7]
        m.out_cov[j, 6] = (c * n_ + t * e_) / cosine
        m.out_cov[j, 7] = -t * n_ + c * e_
        m.out_cov[j, 8] += sine / cosine * (c * n_ + t * e_)
