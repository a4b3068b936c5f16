"""Readings that cannot be right in themselves, whatever the state, and how long a doubt lasts.

| what | how it shows | noticed after |
|---|---|---|
| no number, or beyond all bounds | at once | one reading |
| frozen | the same to the last bit, of a sensor that has noise | three readings |
| doubled | the same to the last bit, sooner than the sensor can measure | two readings; none that repeats is used |
| late | older than latency and jitter allow | one reading; used as long as the horizon has not passed it |
| of no time | no age, one of the future, or of more than ten seconds | one reading; never used |
| silent | nothing for six periods (:data:`Settings.patience`) | that |
| spikes of the gyroscopes | a change of rates that the moments of the flight model do not make | at once; replaced
by the model's |

The sonar rounds to centimetres and the battery monitor to 10 mV, so that they may say the same for long; a stuck
one is found by what it should say. One reading that does not fit is no alarm: the sonar of a healthy vehicle hears
a second surface every 16 s. Rejections are counted, forgotten by 7 % with every reading that fits, and told of
once they come to :data:`ALARM` (:data:`SONAR_ALARM` for the sonar: four within 14).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.estimate.factors import loosen
from mufly.estimate.layout import (
    FLYING,
    GYRO,
    LIGHT,
    MODELLED,
    R_ACCELERATION,
    R_BATTERY,
    R_FIX,
    R_RATES,
    R_RING,
    R_ROTOR,
    R_SONAR,
    SENSORS,
    STARTS,
    TURN,
    V,
)

_Array = NDArray[np.float64]

ACTING = STARTS[-1]
CLIPPING = ACTING + 4
VALUES = CLIPPING + 3
NOTHING, FUSED, REJECTED, MISSING, FAULTY = range(5)
"""Status of a sensor, as a number."""
(
    FINE, NOTHING_YET, SILENT, LATE, INSANE, FROZEN, DOUBLED, OFF, CLIPS, STEP, TAKEN_OVER, NO_ECHO, TOO_FAR, NO_WALL,
    SPIKES, JUMPED, SLOPE, STRAINED, AWAY, STUCK_, WANDERS,
) = range(21)  # fmt: skip
"""Why, as a number; the words are in :mod:`mufly.estimate.beliefs`."""
ALARM, SONAR_ALARM, FORGET = 1.5, 3.0, 0.93
LASTS_S = 0.5
"""A fault that shows for one reading is told of for this long (s)."""
_OLDEST_S = 10.0
"""Age beyond which a reading is none, as is one of the future or of no time."""
_SPIKE, _ALIKE = 0.12, 0.06  # rad/s within a period, beyond what the model says
_LARGEST_SHIFT = (
    5.0  # rad/s: no gyroscope is off by more; what jumps on and on follows a model that runs away
)
_LINGERS = 0.7  # of what was off in the period before
_ROUGH = 3.0  # of the mean difference of some 50 ms
_TURN_OFF = 0.02  # of a difference that is taken for an error of the model's moments
_SHARE = 0.02  # of clipped samples that is told of
ADRIFT, ADRIFT_S, ONCE_ADRIFT = 0.1, 3.0, 0.03
"""What the gyroscopes' bias may do once they have carried the filter astray (rad/s in a second), for how long, and what
from then on: one that has drifted drifts."""
ASTRAY_BIAS, ASTRAY_TURN, ASTRAY_SPEED = 0.15, 0.06, 0.3
"""By how much bias (rad/s), attitude (rad) and speed (m/s) may be off by then."""
_ROTOR_OFF, _ROTOR_SURE = 0.08, 0.02  # of the hover speed; of one that was off just now
_ROTOR_LED, _ROTOR_MEAN_S, _ROTOR_KNOWN_S = 0.03, 4.0, 1.0
"""By what acceleration (of the hover speed, 1/s) the motors' equations may be off more than in the mean over so long
(s), and how long after lift-off that is known (s); flights in gusts need a fifth."""
_VOLTS_OFF = 0.6


@compiled(error_model="numpy")
def flag(m: Any, s: Any, k: int, code: int, why: int, number: float) -> None:
    """Note what is wrong with a sensor, for a while."""
    m.code[k] = code
    m.why[k] = why
    m.number[k] = number
    m.until[k] = m.tick + int(LASTS_S / s.dt)


@compiled(error_model="numpy")
def fits(m: Any, k: int) -> None:
    """A reading has been used."""
    m.used[k] = m.tick
    m.rejected[k] = 0
    m.agree[k] = 0
    m.doubt[k] *= FORGET
    if m.tick >= m.until[k] and m.doubt[k] < 1.0:
        m.code[k] = FUSED
        m.why[k] = FINE
    elif m.code[k] == REJECTED and m.tick >= m.until[k]:
        m.code[k] = FUSED


@compiled(error_model="numpy")
def misfits(m: Any, s: Any, k: int, why: int, number: float) -> None:
    """A reading does not fit."""
    m.rejected[k] += 1
    m.doubt[k] += 1.0
    if m.doubt[k] > (SONAR_ALARM if k == R_SONAR else ALARM):
        flag(m, s, k, REJECTED, why, number)


@compiled(error_model="numpy")
def _repeated(m: Any, s: Any, z: _Array, k: int, start: int, count: int) -> bool:
    """Whether a reading is the one before to the last bit, and that cannot be."""
    if s.noisy[k] == 0 or m.came[k] == 0:
        return False
    told = False
    for j in range(3 if k == R_FIX else count):  # a camera that hangs may still turn with the gyroscopes
        if z[start + j] != m.last[start + j]:
            return False
        told = told or (
            (k != R_ROTOR or z[start + j] != 0.0) and (k != R_RING or z[start + j] < 0.995 * s.ring_max)
        )
    return told


@compiled(error_model="numpy")
def inspect(m: Any, s: Any, z: _Array, new: NDArray[np.int32], age: _Array) -> None:
    """Judge what has come; what is unusable is marked in ``new`` as not new and replaced by what came before."""
    for k in range(SENSORS):
        if s.fitted[k] == 0:
            new[k] = 0
            continue
        start, count = STARTS[k], STARTS[k + 1] - STARTS[k]
        m.skip[k] = 0
        if new[k] == 2:
            m.silent[k] += 1
            new[k] = 0
        if new[k] == 1:
            for j in range(count):
                if not (abs(z[start + j]) < s.bound[k]):
                    new[k] = 0
            if new[k] == 0:
                flag(m, s, k, FAULTY, INSANE, 0.0)
            elif not (-s.dt <= age[k] <= _OLDEST_S):
                new[k] = 0
                flag(m, s, k, FAULTY, LATE, 0.0)
        elif new[k] != 0:
            new[k] = 0
            flag(m, s, k, FAULTY, INSANE, 0.0)
        if new[k] == 1 and _repeated(m, s, z, k, start, count):
            # Nothing new was measured: taken for new it would be the past, believed to be now.
            new[k] = 0
            if (m.tick - m.came[k]) * s.dt < 0.6 * s.period[k]:
                m.twice[k] += 1
                if m.twice[k] >= 2:
                    flag(m, s, k, m.code[k], DOUBLED, 0.0)
            else:
                m.same[k] += 1
                m.came[k] = m.tick
                m.twice[k] = 0
                if m.same[k] >= 2:
                    flag(m, s, k, FAULTY, FROZEN, m.same[k] * s.period[k])
        elif new[k] == 1:
            m.same[k] = 0
            if (
                (s.noisy[k] == 0 or k == R_RING)
                and m.came[k] > 0
                and (m.tick - m.came[k]) * s.dt < 0.6 * s.period[k]
            ):
                new[k] = 0
                m.twice[k] += 1
                if m.twice[k] >= 3:
                    flag(m, s, k, m.code[k], DOUBLED, 0.0)
        if new[k] == 1:
            m.came[k] = m.tick
            m.silent[k] = 0
            again = m.code[k] >= MISSING and m.tick >= m.until[k]
            if again or (m.code[k] == NOTHING and k != R_RING):
                # Whether a ring that sees is of use is said by what it sees: in a large room it sees no wall.
                m.code[k], m.why[k] = NOTHING if k == R_RING else FUSED, FINE
            if age[k] > s.latency[k] + s.slack[k]:
                flag(m, s, k, FAULTY, LATE, age[k])
                if k <= R_RATES or k in (R_ROTOR, R_BATTERY):
                    new[k] = 0
            if s.every[k] > 1:
                m.turns[k] += 1
                m.skip[k] = 1 if m.turns[k] % s.every[k] else 0
            for j in range(count):
                m.last[start + j] = z[start + j]
            if k <= R_RATES or k == R_RING:
                m.used[k] = m.tick
        if new[k] == 0:
            for j in range(count):
                z[start + j] = m.last[start + j]
            if m.came[k] > 0 and (m.tick - m.came[k]) * s.dt > s.patience[k]:
                m.code[k] = MISSING
                m.why[k] = NO_ECHO if m.silent[k] > 2 else SILENT
                m.number[k] = (m.tick - m.came[k]) * s.dt
    clip = 0.0
    for k in range(3):
        share = z[CLIPPING + k]
        m.clipped[k] += 0.1 * ((share if 0.0 <= share <= 1.0 else 1.0) - m.clipped[k])
        clip = max(clip, m.clipped[k])
    if clip > _SHARE and m.code[R_ACCELERATION] == FUSED:
        flag(m, s, R_ACCELERATION, FUSED, CLIPS, clip)


@compiled(error_model="numpy")
def go_astray(m: Any, s: Any) -> None:
    """Something carries the filter astray that it does not know, most likely the gyroscopes."""
    if m.adrift <= 1:
        for k in range(3):
            loosen(m.ut, m.d, GYRO + k, ASTRAY_BIAS * ASTRAY_BIAS, m.f)
            loosen(m.ut, m.d, TURN + k, ASTRAY_TURN * ASTRAY_TURN, m.f)
        for k in range(2):
            loosen(m.ut, m.d, V + k, ASTRAY_SPEED * ASTRAY_SPEED, m.f)
    m.adrift = int(ADRIFT_S / s.dt)


@compiled(error_model="numpy")
def smooth_rates(m: Any, s: Any, flying: bool) -> None:
    """Put what the model says in the place of a spike of the gyroscopes, and take off a jump; ``m.rates`` are the
    new, ``m.before`` the old."""
    now = (m.tick - 1) % MODELLED
    worst, led = 0.0, 0.0
    for k in range(3):
        m.row[k] = m.before[k] + s.dt * m.force[now, 9 + k] + m.turn_off[k]
        off = m.rates[k] - m.row[k]
        worst = max(worst, abs(off))
        # A spike may come in two steps, of which each would pass.
        led = max(led, abs(_LINGERS * m.suspect[R_RATES, k] + off))
        # What its moments are off by, in flight and on the legs
        m.turn_off[k] += _TURN_OFF * min(max(off, -_SPIKE), _SPIKE) if m.mode >= LIGHT else 0.0
    # A model that is off again and again cannot tell a spike from a motion.
    most = _SPIKE + _ROUGH * m.rough
    m.rough += 0.1 * (min(worst, _SPIKE) - m.rough)
    m.adrift = max(m.adrift - 1, min(m.adrift, 1))  # once astray, it remembers
    if not flying or s.model == 0:
        m.spikes = 0
        return
    alike = m.spikes > 0
    for k in range(3):
        alike = alike and abs(m.rates[k] - m.spike[k]) < _ALIKE
        m.spike[k] = m.rates[k]
    fine = max(worst, led) < most
    for k in range(3):
        m.suspect[R_RATES, k] *= _LINGERS
        if fine:
            m.suspect[R_RATES, k] += m.rates[k] - m.row[k]
    if fine:
        m.spikes = m.wild = 0
        return
    m.wild += 1
    m.spikes = m.spikes + 1 if alike else 1
    if m.wild == 1:
        m.doubt[R_RATES] = m.doubt[R_RATES] * FORGET + 1.0
        if m.doubt[R_RATES] > 3.0:
            flag(m, s, R_RATES, FUSED, SPIKES, worst)
    small = True
    for k in range(3):
        small = small and abs(m.shift[k] + (m.rates[k] - m.row[k])) < _LARGEST_SHIFT
    if m.spikes >= 2 and small:
        # Twice the same: an offset that came at once is no motion. It is taken off from now on.
        for k in range(3):
            off = m.rates[k] - m.row[k]
            m.shift[k] += off
            loosen(m.ut, m.d, GYRO + k, 0.1 * off * (0.1 * off), m.f)
        m.spikes = m.wild = 0
        flag(m, s, R_RATES, FUSED, JUMPED, worst)
    elif m.wild > 8:
        m.wild = 0
        return
    for k in range(3):
        m.rates[k] = m.row[k]


@compiled(error_model="numpy")
def rotor_fits(m: Any, s: Any, z: _Array, start: int) -> bool:
    """Whether the speeds that are read are those that the motors' equations make.

    What these are off by, an acceleration of each motor, is learnt within a second, and with it a reading that is led
    away slowly; but in flight it hardly changes. ``m.suspect`` has its mean over some seconds.
    """
    worst, away = 0.0, 0.0
    k = R_ROTOR
    flown = (m.tick - m.since[R_ACCELERATION]) * s.dt
    for j in range(2):
        worst = max(worst, abs(z[start + j] - m.rotor[18 + j]) / s.hover[j])
        away = max(away, abs(m.motor_off[j] - m.suspect[k, j]) / s.hover[j])
    # On the floor it is the equations that have to learn.
    if m.mode == FLYING:
        if flown > _ROTOR_KNOWN_S and away > _ROTOR_LED:
            for j in range(2):
                m.motor_off[j] = m.suspect[k, j]
            misfits(m, s, k, OFF, worst * s.hover[0])
            return False
        if worst > (_ROTOR_SURE if m.doubt[k] > 0.5 else _ROTOR_OFF):
            misfits(m, s, k, OFF, worst * s.hover[0])
            return False
    share = s.period[k] / max(min(flown, _ROTOR_MEAN_S), s.period[k])
    for j in range(2):
        m.suspect[k, j] += share * (m.motor_off[j] - m.suspect[k, j])
    fits(m, k)
    return True


@compiled(error_model="numpy")
def voltage_fits(m: Any, s: Any, off: float) -> bool:
    """Whether the voltage is what the battery's model has."""
    if abs(off) > _VOLTS_OFF and m.tick * s.dt > 1.0:
        misfits(m, s, R_BATTERY, OFF, off)
        return False
    fits(m, R_BATTERY)
    return True


@compiled(error_model="numpy")
def felt_fits(m: Any, s: Any, nu: float, variance: float, known: float, i: int) -> None:
    """Mean of accelerometers less model over some 0.4 s against what is expected of it; ``nu`` of axis ``i`` of a
    block, ``variance`` of its noise and ``known`` of what is known of it before."""
    m.drift[i] += 0.1 * (nu - m.drift[i])
    k = R_ACCELERATION
    if i == 2:
        worst = 0.0
        for j in range(3):
            worst = max(worst, abs(m.drift[j]) / m.drift_sigma[j]) if m.drift_sigma[j] > 0.0 else worst
        if m.disowned == 0 and worst > 6.0:
            m.disowned = 1
        elif m.disowned == 1 and worst < 2.0:
            m.disowned = 0
        if m.disowned == 1:
            flag(m, s, k, FAULTY, OFF, m.drift[2])
    # The mean of 0.1-weighted blocks keeps 0.1 / (2 - 0.1) of their variance.
    m.drift_sigma[i] = math.sqrt(variance * 0.0526 + known + 0.04)
