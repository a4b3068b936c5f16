"""What each reading tells of the state, and whether it is believed.

A measurement of one number z = h(x) + n is expected with the innovation's variance S = H P H^T + r. It is taken in
if it lies within :data:`GATE` standard deviations; readings of several numbers if all of them do.

| reading | h(x) | not believed for long, but in agreement with itself |
|---|---|---|
| position_fix | p + v dt + b, heading + b_h | after a second: position and heading are loosened |
| ground_distance | -(p + R r)_D - floor | three in a row: the floor below has a step, its height is loosened |
| ranges | distance to the nearest wall of the room along the beam | left alone: what they see is no wall |
| pressure | rho g p_D + b + what the rotors add | after a second: its bias is loosened |
| magnetic_field | heading + b, and tilt by the field's dip | after a second: its bias is loosened |

Loosening adds variance before the measurement is taken in; so all that is known of how the errors hang together
holds on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.estimate.factors import expected, loosen, observe, variance
from mufly.estimate.guards import (
    AWAY,
    FAULTY,
    FINE,
    FUSED,
    NO_WALL,
    NOTHING,
    OFF,
    REJECTED,
    SLOPE,
    STEP,
    STRAINED,
    STUCK_,
    TAKEN_OVER,
    TOO_FAR,
    WANDERS,
    felt_fits,
    fits,
    flag,
    go_astray,
    misfits,
)
from mufly.estimate.layout import (
    ACCEL,
    ERRORS,
    FIX,
    FLOOR,
    GYRO,
    HEADING,
    LOW,
    MAGNET_,
    PRESSURE_,
    R_ACCELERATION,
    R_FIX,
    R_MAGNET,
    R_PRESSURE,
    R_RATES,
    R_RING,
    R_SONAR,
    THRUST_,
    TURN,
    WIND,
    P,
    V,
)
from mufly.estimate.motion import turn_matrix, turned
from mufly.trigonometry import direction, wrapped
from mufly.units import GRAVITY

_Array = NDArray[np.float64]

GATE = 5.0
"""Standard deviations: one healthy reading in two million is turned away."""
LEAN = 2.2
"""Mean of five ratios or so of the sonar: six and a half deviations."""
STRAIN = 11.0
"""Mean square of the worst of the fix's four ratios over half a second; 2.4 is usual."""
LED_AWAY = 5.0
"""... from which on a fix that does not fit is no fix that jumps."""
_AGREE_S = 1.0
RANGE = 5.5
"""Deviations a of a wandering beyond which it is no wandering. One of time constant tau goes beyond them, to either
side, 2 a phi(a) / tau times a second (phi: normal density; Pickands, 1969): three axes with tau of 2 s do so 0.06 times
in ten hours (5: 0.8 times, and once it was seen)."""
GYRO_RANGE = 8.0
"""Deviations of the gyroscopes' bias at the start beyond which they cannot be flown on for long."""
STUCK = 1e-11
"""Chance that a sonar that works repeats itself for so long."""
CLEAR = 0.15
"""Height (m) above which no leg touches: what turns it then is in the flight model."""
LED_SPEED, LED_FORCE, LED_THRUST, LED_S = 0.3, 0.3, 0.1, 1.0
"""What speed (m/s), accelerometers (m/s^2) and thrust (1) may be off by where the height is led away
again within ``LED_S`` (s)."""
SUDDEN, MOST_STEPS = 3.0, 8
"""Deviations of the sonar beyond which it is the surface that jumps, over an edge; how often it may."""
LIFTS, LIFTS_OFF = 1.08, 0.08
"""What rotors lift, of the weight, as the sonar says that it leaves the floor, and what share of it that is off by."""
_BEAM_GATE = 4.0
LEAST_FLOOR = -0.1
"""A room has nothing below its floor (m)."""


@compiled(error_model="numpy")
def _of(m: Any, i: int, h: float) -> None:
    """A measurement of ``h`` times state ``i``."""
    m.terms = 1
    m.at[0] = i
    m.h[0] = h


@compiled(error_model="numpy")
def _and(m: Any, i: int, h: float) -> None:
    """... and of ``h`` times state ``i``."""
    m.at[m.terms] = i
    m.h[m.terms] = h
    m.terms += 1


@compiled(error_model="numpy")
def _correct(m: Any, innovation: float) -> None:
    """Move the state by the gain, and what that is carried on to."""
    for i in range(ERRORS):
        m.gain[i] *= innovation
    _move(m.x, m.gain, 0.0, m.way_sum)
    _move(m.way, m.gain, m.way_span, m.way_sum)
    _move(m.come, m.gain, m.span, m.come_sum)


@compiled(error_model="numpy")
def _move(x: _Array, by: _Array, span: float, push: _Array) -> None:
    """Move a state by errors that it had a span (s) ago, since when ``push`` has changed its velocity (behind the third
    number; but for gravity)."""
    v_x = by[3] + (by[7] * push[5] - by[8] * push[4] if span > 0.0 else 0.0)
    v_y = by[4] + (by[8] * push[3] - by[6] * push[5] if span > 0.0 else 0.0)
    v_z = by[5] + (by[6] * push[4] - by[7] * push[3] if span > 0.0 else 0.0)
    x[0] += by[0] + 0.5 * span * (by[3] + v_x)
    x[1] += by[1] + 0.5 * span * (by[4] + v_y)
    x[2] += by[2] + 0.5 * span * (by[5] + v_z)
    x[3] += v_x
    x[4] += v_y
    x[5] += v_z
    turned(x, by[6], by[7], by[8], False)
    for i in range(9, ERRORS):
        x[i + 1] += by[i]


@compiled(error_model="numpy")
def _take(m: Any, innovation: float, r: float) -> None:
    """Take a measurement in, whatever it says; its row is in ``m.h``."""
    expected(m.ut, m.d, m.at, m.h, m.terms, m.f)
    observe(m.ut, m.d, m.f, r, m.gain)
    _correct(m, innovation)


@compiled(error_model="numpy")
def _ratio(m: Any, innovation: float, r: float) -> float:
    """Innovation over what is expected of it."""
    return innovation / math.sqrt(expected(m.ut, m.d, m.at, m.h, m.terms, m.f) + r)


@compiled(error_model="numpy")
def _note(m: Any, k: int, innovation: float, ratio: float) -> None:
    m.innovation[k] = innovation
    m.spread[k] = abs(innovation / ratio) if ratio != 0.0 else 0.0


@compiled(error_model="numpy")
def _reject(m: Any, s: Any, k: int, innovation: float, z: _Array, count: int, near: float) -> None:
    """Note that a reading does not fit; that it says nearly what the one before said is counted in ``m.agree``."""
    alike = m.rejected[k] > 0
    for j in range(count):
        alike = alike and abs(z[j] - m.suspect[k, j]) < near
        m.suspect[k, j] = z[j]
    if alike:
        m.agree[k] += 1
    else:
        m.agree[k] = 0
        m.since[k] = m.horizon
    if k != R_SONAR and abs(innovation) > 2.0 * GATE * m.spread[k]:
        m.doubt[k] += 1.0  # by so much nothing healthy is off, but for a sonar that hears a second surface
    misfits(m, s, k, OFF, innovation)


@compiled(error_model="numpy")
def _taken_over(m: Any, s: Any, k: int) -> bool:
    """Whether a reading that does not fit has agreed with itself for long enough."""
    return m.agree[k] >= 3 and (m.horizon - m.since[k]) * s.dt >= _AGREE_S


@compiled(error_model="numpy")
def _fix_row(m: Any, i: int) -> None:
    if i < 3:
        _of(m, P + i, 1.0)
        _and(m, FIX + i, 1.0)
    else:
        _of(m, TURN + 2, 1.0)
        _and(m, HEADING, 1.0)


@compiled(error_model="numpy")
def _fix_innovation(m: Any, z: _Array, i: int, ahead: float) -> float:
    x = m.x
    if i < 3:
        return z[i] - x[i] - ahead * x[3 + i] - x[17 + i]
    yaw = direction(2 * (x[6] * x[9] + x[7] * x[8]), 1 - 2 * (x[8] * x[8] + x[9] * x[9]))
    off = z[3] - yaw - ahead * m.spin - x[20]
    return wrapped(off)


@compiled(error_model="numpy")
def height_over(x: _Array, s: Any) -> float:
    """How high the legs are above what lies below (m); that is not lower than the floor, whatever the sonar says."""
    return -x[2] - max(x[16], 0.0) - s.stands


@compiled(error_model="numpy")
def _out_of_range(m: Any, s: Any, i: int) -> float:
    """What a component of the fix is believed to be off by, over the most that its model allows.

    A wandering of deviation sigma is believed to be off by 5 sigma once in two million times its correlation's time.
    Innovations do not show such an error, because the bias follows it.
    """
    noise = s.fix_variance if i < 3 else s.heading_variance
    return abs(m.x[17 + i]) / (RANGE * math.sqrt(s.sigma[FIX + i] * s.sigma[FIX + i] + noise))


@compiled(error_model="numpy")
def _sonar_holds(m: Any, s: Any) -> bool:
    """Whether the sonar tells the height, over a floor that is known."""
    k = R_SONAR
    fresh = m.used[k] > 0 and (m.tick - m.used[k]) * s.dt < 0.3
    return fresh and m.code[k] == FUSED and m.why[k] == FINE and not m.edge > 0.0


@compiled(error_model="numpy")
def _agrees_down(m: Any, s: Any, z: _Array, ahead: float) -> bool:
    """Whether fix and sonar agree on the height; if not, what they are apart by is kept in ``m.suspect[R_FIX, 3]``.

    Which of them is wrong nobody knows: pressure wanders by as much. The height goes on by the sonar, and what they
    are apart by is added to what is told of the uncertainty of the place.
    """
    k = R_FIX
    nu = _fix_innovation(m, z, 2, ahead)
    _fix_row(m, 2)
    off = abs(_ratio(m, nu, s.fix_variance))
    whole = abs(nu + m.x[19])
    if m.suspect[k, 3] > 0.0:
        blind = (m.tick - m.used[R_SONAR]) * s.dt > 0.3
        m.suspect[k, 3] = 0.0 if blind or off < 2.5 else whole
    elif _sonar_holds(m, s) and (_out_of_range(m, s, 2) > 1.0 or (off > GATE and _taken_over(m, s, k))):
        m.suspect[k, 3] = whole
    return m.suspect[k, 3] == 0.0


@compiled(error_model="numpy")
def fuse_fix(m: Any, s: Any, z: _Array, ahead: float) -> None:
    """Position and heading; no height where that is not the sonar's."""
    k, worst, at = R_FIX, 0.0, 0.0
    down = _agrees_down(m, s, z, ahead)
    for i in range(4):
        if i == 2 and not down:
            continue
        _fix_row(m, i)
        r = s.fix_variance if i < 3 else s.heading_variance
        nu = _fix_innovation(m, z, i, ahead)
        ratio = _ratio(m, nu, r)
        if abs(ratio) > abs(worst):
            worst, at = ratio, nu
    _note(m, k, at, worst)
    # Off by more and more, it is not a fix that jumps: the filter is led away. Without a rotor model its
    # deviations are a guess, and a record whose axes are wrong would be followed from fix to fix.
    led = s.model > 0 and m.strain > LED_AWAY and GATE < abs(worst) < 2.0 * GATE
    if abs(worst) > GATE and not led:
        _reject(m, s, k, at, z, 3, 2.0 * s.period[k] + 8 * math.sqrt(s.fix_variance) + 0.05)
        if not _taken_over(m, s, k):
            return
        # What other sensors hold is not given up: the fix is off there.
        held = m.code[R_SONAR] == FUSED, m.code[R_RING] == FUSED
        for i in range(3):
            nu = _fix_innovation(m, z, i, ahead)
            if held[0] if i == 2 else held[1]:
                loosen(m.ut, m.d, FIX + i, nu * nu, m.f)
            else:
                loosen(m.ut, m.d, P + i, nu * nu, m.f)
                loosen(m.ut, m.d, V + i, 0.01 + 0.1 * nu * nu, m.f)
        nu = _fix_innovation(m, z, 3, ahead)
        loosen(m.ut, m.d, TURN + 2, nu * nu, m.f)
        nu = at
        flag(m, s, k, REJECTED, TAKEN_OVER, nu)
    # Off by much again and again: something carries the filter astray that it does not know, as gyroscopes that drift.
    m.strain += 0.15 * (worst * worst - m.strain)
    out = max(_out_of_range(m, s, 0), _out_of_range(m, s, 1), _out_of_range(m, s, 3))
    if led or m.strain > STRAIN or out > 1.0:
        go_astray(m, s)
        flag(m, s, k, FUSED, STRAINED, at)
    for i in range(4):
        if i == 2 and not down:
            continue
        _fix_row(m, i)
        _take(m, _fix_innovation(m, z, i, ahead), s.fix_variance if i < 3 else s.heading_variance)
    for i in range(3):
        most = GYRO_RANGE * s.sigma[GYRO + i] + 2.0 * m.sigma[GYRO + i]
        if abs(m.x[10 + i]) > most and m.code[R_RATES] == FUSED:
            flag(m, s, R_RATES, REJECTED, WANDERS, m.x[10 + i])
    fits(m, k)
    if not down:
        flag(m, s, k, FAULTY, AWAY, m.suspect[k, 3])
    m.aligned = 1


@compiled(error_model="numpy")
def _sonar_row(m: Any, s: Any, r: _Array) -> float:
    turn_matrix(m.x[6:10], r)
    _of(m, P + 2, -1.0)
    _and(m, FLOOR, -1.0)
    # (exp(t) R r)_D = (R r)_D + t_N (R r)_E - t_E (R r)_N
    n = r[0] * s.sonar_place[0] + r[1] * s.sonar_place[1] + r[2] * s.sonar_place[2]
    e = r[3] * s.sonar_place[0] + r[4] * s.sonar_place[1] + r[5] * s.sonar_place[2]
    d = r[6] * s.sonar_place[0] + r[7] * s.sonar_place[1] + r[8] * s.sonar_place[2]
    _and(m, TURN, -e)
    _and(m, TURN + 1, n)
    return d


@compiled(error_model="numpy")
def _repeats(m: Any, s: Any, z: float, nu: float) -> bool:
    """Whether the sonar repeats itself for longer than its noise and the vehicle's moving allow.

    A reading in steps of h is the one before with a chance of about h / (sqrt(2 pi) sigma) exp(-nu^2 / (2 sigma^2)),
    sigma of the innovation nu; exp(-x) <= 1 / (1 + x).
    """
    same = z == m.suspect[R_SONAR, 1]
    m.suspect[R_SONAR, 1] = z
    if not same or height_over(m.x, s) < CLEAR:
        m.suspect[R_SONAR, 2] = 1.0
        return False
    # A height that is hardly known has no part in it: it may be better than believed.
    sigma = 1.3 * math.sqrt(s.sonar_variance)
    likely = 0.399 * s.sonar_step / sigma / (1.0 + 0.5 * min(nu * nu / (sigma * sigma), 9.0))
    m.suspect[R_SONAR, 2] *= min(likely, 1.0)
    return m.suspect[R_SONAR, 2] < STUCK


@compiled(error_model="numpy")
def _led_away(m: Any, s: Any, nu: float) -> None:
    """The height is led away by ``nu``.

    A wall beside it may have done so, whose foot in the sonar's cone was taken for the floor: then the height is off,
    and that is all. If it is off again soon, a force leads it that is not as it is believed.
    """
    loosen(m.ut, m.d, P + 2, nu * nu, m.f)
    before = m.suspect[R_SONAR, 3]
    m.suspect[R_SONAR, 3] = m.horizon
    if not (before > 0.0 and (m.horizon - before) * s.dt < LED_S):
        return
    loosen(m.ut, m.d, V + 2, LED_SPEED * LED_SPEED, m.f)
    loosen(m.ut, m.d, ACCEL + 2, LED_FORCE * LED_FORCE, m.f)
    loosen(m.ut, m.d, THRUST_, LED_THRUST * LED_THRUST, m.f)


@compiled(error_model="numpy")
def fuse_sonar(m: Any, s: Any, z: _Array, ahead: float, r: _Array) -> None:
    """Height above what lies below; a step that nothing else saw is the floor's."""
    k = R_SONAR
    down = _sonar_row(m, s, r)
    if r[8] < s.sonar_cone or z[0] >= s.sonar_max:
        return
    expect = -(m.x[2] + ahead * m.x[5]) - down - m.x[16]
    said, r_ = z[0], s.sonar_variance
    nearest, standing = s.sonar_min + 0.005, s.stands - s.sonar_place[2]
    if z[0] <= nearest and standing < nearest:
        # Nearer than it can tell: anywhere between there and where it stands.
        said = 0.5 * (nearest + standing)
        r_ = (nearest - standing) * (nearest - standing) / 12.0
        if expect < nearest:
            _take(m, said - expect, 100.0 * r_)  # as so many that are off alike
            fits(m, k)
            return
    nu = said - expect
    ratio = _ratio(m, nu, r_)
    _note(m, k, nu, ratio)
    if _repeats(m, s, z[0], nu):
        flag(m, s, k, FAULTY, STUCK_, z[0])
        return
    floor = m.x[16] - nu
    over = m.edge > 0.0 or abs(m.x[16]) > LOW
    # Always off to the same side: over an edge it is the surface, and nearer may be an object that comes into the cone
    # from the side. Below the floor lies nothing, so else it is the height, which a force carries away that is not as
    # it is believed: the accelerometers' or the model's.
    if abs(ratio) < GATE:
        m.lean += 0.2 * (ratio - m.lean)
    if abs(m.lean) > LEAN:
        m.lean = 0.0
        flag(m, s, k, FUSED, SLOPE, nu)
        if over or nu < 0.0:
            m.edge = 1.0
        else:
            _led_away(m, s, nu)
            _sonar_row(m, s, r)
    if over and abs(ratio) > SUDDEN and m.steps < MOST_STEPS and floor > LEAST_FLOOR:
        # Over an object it is the surface that jumps.
        m.steps += 1
        m.edge = 1.0
        loosen(m.ut, m.d, FLOOR, nu * nu, m.f)
        _sonar_row(m, s, r)
    elif abs(ratio) > GATE:
        _reject(m, s, k, nu, z, 1, 0.02 + 1.5 * s.period[k])
        step = m.agree[k] >= 2 and floor > LEAST_FLOOR
        if step and m.steps >= MOST_STEPS:
            # Step after step: it is not the floor that goes, it is the height.
            loosen(m.ut, m.d, P + 2, nu * nu, m.f)
            loosen(m.ut, m.d, V + 2, 0.1, m.f)
            loosen(m.ut, m.d, THRUST_, 0.01, m.f)
            flag(m, s, k, REJECTED, TAKEN_OVER, nu)
        elif step and nu > 0.0:
            # Lower than the floor nothing lies; over an edge it was the surface that jumped.
            _led_away(m, s, nu)
            flag(m, s, k, FUSED, SLOPE, nu)
        elif step:
            loosen(m.ut, m.d, FLOOR, nu * nu, m.f)
            m.doubt[k] = 0.0
            flag(m, s, k, FUSED, STEP, floor)
            m.edge = 1.0
        elif _taken_over(m, s, k):
            if (m.tick - m.used[R_FIX]) * s.dt < _AGREE_S and m.used[R_FIX] > 0:
                loosen(m.ut, m.d, FLOOR, nu * nu, m.f)  # the fix holds the height
            else:
                loosen(m.ut, m.d, P + 2, nu * nu, m.f)
                loosen(m.ut, m.d, V + 2, 0.1 + nu * nu, m.f)
            flag(m, s, k, REJECTED, TAKEN_OVER, nu)
        else:
            if m.agree[k] >= 2:
                flag(m, s, k, REJECTED, OFF, nu)  # below the room's floor, and not by chance
            return
        _sonar_row(m, s, r)
    _take(m, nu, r_)
    fits(m, k)


@compiled(error_model="numpy")
def settle_floor(m: Any) -> None:
    """Back at about the height of the floor it is most likely the floor, and that one is known."""
    _of(m, FLOOR, 1.0)
    _take(m, -m.x[16], 2.5e-5)


@compiled(error_model="numpy")
def fuse_lift(m: Any, lift: float) -> None:
    """Leaving the floor the rotors lift the weight and what it rises by: the thrust's scale, where the model lifts so
    much (of the weight)."""
    scale = LIFTS / lift
    spread = LIFTS_OFF * scale
    _of(m, THRUST_, 1.0)
    _take(m, scale - m.x[23], spread * spread)


@compiled(error_model="numpy")
def fuse_floor(m: Any, s: Any) -> bool:
    """Legs do not go into what lies below: where they are believed to be there, they stand on it. Whether they were.

    The sonar is too near to tell, the rotors lift less than the weight, and nothing else says that it does not fall.
    """
    height = height_over(m.x, s)
    if height >= 0.0:
        return False
    _of(m, P + 2, -1.0)
    if m.x[16] > 0.0:
        _and(m, FLOOR, -1.0)
    _take(m, -height, 2.5e-5)
    if m.x[5] > 0.0:
        _of(m, V + 2, 1.0)
        _take(m, -m.x[5], 1e-3)
    return True


@compiled(error_model="numpy")
def fuse_ring(m: Any, s: Any, z: _Array, ahead: float, r: _Array, most: int) -> bool:
    """Distances to the walls of the room, beam by beam, ``most`` at a time; returns whether that was all.

    What a beam is off by is mostly constant (docs/estimation.md), so no number of readings tells of a position more
    than J, the sum of h^2 / C over the beams. Of that a picture brings what has been lost since the one before:
    J - 1 / P. Each beam has its share of it, which is a variance of C J / (J - 1 / P) beside what scatters.
    """
    k = R_RING
    turn_matrix(m.x[6:10], r)
    if m.beam == 0:
        m.seen = m.fitting = 0
        for i in range(2):
            told = m.told_most[i] * variance(m.ut, m.d, P + i)
            m.told_share[i] = 1.0 - 1.0 / told if told > 1.0 else 0.0
            m.told_most[i] = 0.0
    last = min(m.beam + most, s.beams)
    for b in range(m.beam, last):
        if not (0.0 < z[b] < 0.995 * s.ring_max):
            continue
        m.seen += 1
        n = r[0] * s.beam[b, 0] + r[1] * s.beam[b, 1] + r[2] * s.beam[b, 2]
        e = r[3] * s.beam[b, 0] + r[4] * s.beam[b, 1] + r[5] * s.beam[b, 2]
        d = r[6] * s.beam[b, 0] + r[7] * s.beam[b, 1] + r[8] * s.beam[b, 2]
        best, axis, along = 1e9, -1, 1.0
        for i in range(3):
            u = n if i == 0 else (e if i == 1 else d)
            if abs(u) > 0.3:
                plane = s.walls[2 * i + 1] if u > 0.0 else s.walls[2 * i]
                far = (plane - (m.x[i] + ahead * m.x[3 + i])) / u
                if 0.0 < far < best:
                    best, axis, along = far, i, u
        if axis < 0 or axis == 2 or best > 1.1 * s.ring_max:
            continue
        # l = (c - p_i) / u_i; of the heading they tell nothing, it is one more constant: du = t x u
        h = -1.0 / along
        across = h * best * (e if axis == 0 else n) * m.sigma[TURN + 2]
        slope = best * best + s.ring_baseline * s.ring_baseline
        lasts = slope * slope * s.ring_lasts + across * across
        scatters = slope * best * best
        scatters *= scatters * s.ring_scatters
        _of(m, P + axis, h)
        nu = z[b] - best
        ratio = _ratio(m, nu, scatters + lasts)
        if abs(ratio) < _BEAM_GATE:
            _note(m, k, nu, ratio)
            m.fitting += 1
            m.told_most[axis] += h * h / lasts
            if m.told_share[axis] > 0.0:
                observe(m.ut, m.d, m.f, scatters + lasts / m.told_share[axis], m.gain)
                _correct(m, nu)
                turn_matrix(m.x[6:10], r)
    m.beam = last
    if last < s.beams:
        return False
    m.beam = 0
    if m.fitting > 0:
        fits(m, k)
    elif m.tick >= m.until[k]:
        m.code[k] = NOTHING
        m.why[k] = TOO_FAR if m.seen == 0 else NO_WALL
    return True


@compiled(error_model="numpy")
def fuse_pressure(m: Any, s: Any, z: _Array, ahead: float) -> None:
    """Pressure less the standard one and what the rotors add."""
    k = R_PRESSURE
    _of(m, P + 2, s.pressure_slope)
    _and(m, PRESSURE_, 1.0)
    nu = z[0] - s.pressure_slope * (m.x[2] + ahead * m.x[5]) - m.x[24]
    ratio = _ratio(m, nu, s.pressure_variance)
    _note(m, k, nu, ratio)
    if abs(ratio) > GATE:
        _reject(m, s, k, nu, z, 1, 10 * math.sqrt(s.pressure_variance))
        if not _taken_over(m, s, k):
            return
        loosen(m.ut, m.d, PRESSURE_, nu * nu, m.f)
        flag(m, s, k, REJECTED, TAKEN_OVER, nu)
    _take(m, nu, s.pressure_variance)
    fits(m, k)


@compiled(error_model="numpy")
def fuse_magnet(m: Any, s: Any, z: _Array, ahead: float, r: _Array) -> None:
    """Heading by the field's direction."""
    k = R_MAGNET
    turn_matrix(m.x[6:10], r)
    north = r[0] * z[0] + r[1] * z[1] + r[2] * z[2]
    east = r[3] * z[0] + r[4] * z[1] + r[5] * z[2]
    _of(m, TURN + 2, 1.0)
    _and(m, TURN, -s.earth[2] / s.earth[0])
    _and(m, MAGNET_, 1.0)
    off = -direction(east, north) - ahead * m.spin - m.x[25]
    nu = wrapped(off)
    ratio = _ratio(m, nu, s.magnet_variance)
    _note(m, k, nu, ratio)
    if abs(ratio) > GATE:
        _reject(m, s, k, nu, z, 3, 1e-5)
        if not _taken_over(m, s, k):
            return
        loosen(m.ut, m.d, MAGNET_, nu * nu, m.f)
        flag(m, s, k, REJECTED, TAKEN_OVER, nu)
    _take(m, nu, s.magnet_variance)
    fits(m, k)


@compiled(error_model="numpy")
def fuse_force(m: Any, s: Any, r: _Array, count: int, i: int) -> None:
    """Accelerometers less model along an axis, mean over so many periods: of biases, thrust, wind and velocity."""
    turn_matrix(m.x[6:10], r)
    slope = m.lever[i, 1]
    _of(m, ACCEL + i, 1.0)
    _and(m, THRUST_, m.lever[i, 0])
    for j in range(3):
        _and(m, V + j, slope * r[3 * j + i])
    _and(m, WIND, -slope * r[i])
    _and(m, WIND + 1, -slope * r[3 + i])
    nu = m.felt[i] - m.modelled[i] - m.x[13 + i]
    r_ = m.lever[i, 2] / (count * s.dt)
    known = expected(m.ut, m.d, m.at, m.h, m.terms, m.f)
    ratio = nu / math.sqrt(known + r_)
    felt_fits(m, s, nu, r_, known, i)
    if abs(ratio) < GATE and m.disowned == 0:
        _take(m, nu, r_)
    if i == 0 or abs(ratio) > m.lever[0, 3]:
        _note(m, R_ACCELERATION, nu, ratio)
        m.lever[0, 3] = abs(ratio)


@compiled(error_model="numpy")
def fuse_rest(m: Any, s: Any, r: _Array, count: int, still: bool, i: int) -> None:
    """Standing: no velocity, no turning along an axis; and with the motors off accelerometers that feel gravity
    alone."""
    _of(m, V + i, 1.0)
    _take(m, -m.x[3 + i], 4e-4)
    _of(m, GYRO + i, 1.0)
    calm = s.rest_gyro * s.rest_gyro / count if still else 2.5e-5
    off = m.sum[i] - m.x[10 + i]
    # With its rotors running it may slide and turn on its legs.
    if still or abs(_ratio(m, off, calm * 2)) < GATE:
        _take(m, off, calm * 2)
    if still and s.fitted[R_ACCELERATION] > 0:
        turn_matrix(m.x[6:10], r)
        # R^T (-g e_D), and d(R^T u) = R^T (u x t)
        _of(m, ACCEL + i, 1.0)
        _and(m, TURN, -r[3 + i] * GRAVITY)
        _and(m, TURN + 1, r[i] * GRAVITY)
        nu = m.felt[i] + GRAVITY * r[6 + i] - m.x[13 + i]
        r_ = 2 * s.rest_felt * s.rest_felt / count
        if abs(_ratio(m, nu, r_)) < 2 * GATE:
            _take(m, nu, r_)
