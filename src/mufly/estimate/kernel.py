"""One period of the filter, compiled: readings in, the state of now out, with a bounded amount of work.

The filter itself runs ``delay`` periods behind, as far as the slowest reading usually takes to come (as in the EKF2 of
PX4): each waits for the horizon to come to the instant at which it was measured, so readings are taken in in the order
of their measurement, and none is fused twice or with another's state. One that comes later, by the jitter of a radio
link, is carried to the next end of a block by speed and turning; were the horizon to wait for all of these, every
reading would tell of now by as much later. What is told is the
horizon's state carried on to now through the inputs since, with what the filter believes of biases and wind: what it
would say had it run without delay on the readings that were due. That goes some blocks a period: it takes about five
periods to come to now, then the next is on its way; meanwhile the last one is carried on by every period. Both are
moved by what is learnt on the way.

Inputs are averaged over a block of periods (:data:`mufly.estimate.layout.BLOCK_S`), and the horizon goes from the end
of one to the end of the next; a measurement counts at the nearest of them, carried there by the velocity and the
turning (10 ms at most). Between two steps of the horizon there is time for what is due: in every period as much as
``work`` allows, counted in scalar measurements (:func:`_task`), so that no period takes much longer than another. If
more comes than there is time for the horizon falls behind, and from :data:`mufly.estimate.layout.LAG` blocks on what
is due is left out. Biases step one a period, in turn; what the fix is off by, which tells of nothing but fixes,
steps when one is used, by the time since the last.

The inertial unit's filter makes it late by ``lag``: states belong to ``lag`` before their tick.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.estimate.factors import carry, loosen, variance, wander
from mufly.estimate.fusing import (
    CLEAR,
    LEAST_FLOOR,
    LIFTS_OFF,
    fuse_fix,
    fuse_floor,
    fuse_force,
    fuse_lift,
    fuse_magnet,
    fuse_pressure,
    fuse_rest,
    fuse_ring,
    fuse_sonar,
    height_over,
    settle_floor,
)
from mufly.estimate.guards import (
    ACTING,
    ADRIFT,
    FAULTY,
    FINE,
    FUSED,
    LATE,
    MISSING,
    OFF,
    ONCE_ADRIFT,
    REJECTED,
    flag,
    inspect,
    rotor_fits,
    smooth_rates,
    voltage_fits,
)
from mufly.estimate.layout import (
    EDGE_S,
    ERRORS,
    FIX,
    FLOOR,
    FLYING,
    GYRO,
    HEADING,
    INPUTS,
    KEPT,
    LAG,
    LIGHT,
    LOW,
    MODELLED,
    R_ACCELERATION,
    R_BATTERY,
    R_FIX,
    R_PRESSURE,
    R_RATES,
    R_RING,
    R_ROTOR,
    R_SONAR,
    RUNNING,
    SETTLED,
    STANDING,
    STARTS,
    STATES,
    THRUST_,
    TURNS,
    WAITING,
    P,
)
from mufly.estimate.motion import (
    advance_state,
    model_force,
    terminal_voltage_believed,
    transition,
    turn_matrix,
)
from mufly.estimate.telling import LONGEST, TOLD_EVERY, spread_along, tell
from mufly.trigonometry import whole
from mufly.units import GRAVITY

_Array = NDArray[np.float64]

BACK_S = 0.1
"""How long before the horizon a measurement may have been made: speed and turning carry it there, and what they change
by meanwhile, 1 m/s^2, moves it by 5 mm."""
SLOWLY = 32
"""Periods over which the noise of forces at low frequencies is looked at."""
TELLING, STEPPING, WANDERING, FIXING, RESTING = 3, 2, 1, 4, 3
"""What a covariance that is told costs, a step of the horizon, one of what the fix is off by, a fix, and an axis on the
floor, in scalar measurements."""
EDGES, MEANS, AXES, LEGS, DONE = 1, 2, 3, 6, 7
"""Stages of the work at the horizon; measurements that wait come first, in the order of their kinds."""
_ALIGNED_S = 0.8
_BLIND_S = 0.1  # without gyroscopes
BLIND_TURN = 0.002
"""Density of the turning (rad^2/s) that is not known without them: the stabiliser bar keeps the rotors level."""
MOST_DOUBT = 2.5
"""Deviations of the thrust's scale by which lift-off may come sooner or later."""
KNOWN_THRUST, UNKNOWN_S = 0.03, 0.02
"""Deviation of the thrust's scale that the filter bears; what is beyond makes noise, together over so long (s)."""
TOGETHER = 0.3
"""Twice the time (s) for which an error counts as one, so that over the delay it moves the velocity by what it is."""
CLIPPED = 0.25
"""What means of accelerometers that clip are off by, of the range times the share of clipped samples (0.1 to 0.3), and
for how long together."""
LEAST_SPREAD = 1.0
"""What rotors and legs together may be off by (m/s^2)."""
BELIEVED_LOW, LIFTED = 0.3, 0.015
"""Heights (m) up to which the sonar has a say in whether it flies, and beyond its least reading that say so."""
SCATTER = 5.0
"""Density of the accelerometers' noise before it is known, m^2/s^3: none would be believed more than the model."""
ASUNDER = 0.4
"""What accelerometers and model may be apart by over 160 ms (m/s^2), beside two deviations of the thrust's scale; what
is beyond is noise, together over a second."""
_Z = STARTS


@compiled(error_model="numpy")
def begin(m: Any, s: Any) -> None:
    """Forget everything."""
    for i in range(STATES):
        m.x[i] = m.way[i] = m.come[i] = s.start[i]
    for i in range(ERRORS):
        m.d[i] = s.sigma[i] * s.sigma[i] + 1e-12
        for j in range(ERRORS):
            m.ut[i, j] = 1.0 if i == j else 0.0
    for i in range(WAITING):
        m.due[i] = -1
    m.stage = DONE
    m.out[6] = m.rotor[6] = m.rotor[20] = 1.0
    m.rotor[2] = -1000.0  # far above the floor
    m.rotor[17] = -1.0
    for k in range(3):
        m.scatter[k] = m.slow[k] = SCATTER


@compiled(error_model="numpy")
def _queue(m: Any, s: Any, kind: int, at: float, z: _Array, start: int, count: int) -> bool:
    """Let a measurement of tick ``at`` wait until the horizon has come to it; False if that is over for too long, or
    no place is left."""
    due = s.block * whole(at / s.block + 0.5)
    if due <= m.horizon:
        due = m.horizon + s.block  # by what it moves and turns, the next end of a block will do
    ahead = (at - due) * s.dt
    if -ahead > BACK_S:
        return False
    for i in range(WAITING):
        if m.due[i] < 0:
            m.due[i] = due
            m.what[i] = kind
            m.ahead[i] = ahead
            for j in range(count):
                m.value[i, j] = z[start + j]
            return True
    return False


@compiled(error_model="numpy")
def _mode(m: Any, s: Any, z: _Array) -> float:
    """Whether it stands, flies or is about to: by what the rotors lift and how high it is.

    Returns what the model lifts (of the weight) in the period in which the sonar says that it leaves the floor, else 0.
    """
    lift = -m.force[m.tick % MODELLED, 2] * m.x[23] / GRAVITY if s.model > 0 else 1.0
    height = height_over(m.out, s)
    off = z[ACTING] + z[ACTING + 1] < 0.02
    # Rotors that lift more than the model says fly sooner, others later.
    doubt = MOST_DOUBT * m.sigma[THRUST_] if s.model > 0 else 0.0
    # What the sonar says is fresher than the height that is believed; but not one that sees below the floor.
    says = m.code[R_SONAR] == FUSED and height < BELIEVED_LOW and m.x[16] > LEAST_FLOOR
    near = says and m.last[_Z[R_SONAR]] <= s.sonar_min + 0.5 * s.sonar_step
    clear = says and m.last[_Z[R_SONAR]] > s.sonar_min + LIFTED
    rises = 0.0
    m.low = 1 if near else 0
    if m.mode <= RUNNING:
        m.mode = STANDING if off and m.rotor[18] + m.rotor[19] < 0.2 * (s.hover[0] + s.hover[1]) else RUNNING
        if lift * (1.0 + doubt) > 0.9 and m.mode == RUNNING:
            m.mode = LIGHT
            m.lifted = m.tick
    elif m.mode == LIGHT:
        up = height > 0.03 + min(2.0 * m.sigma[P + 2], 0.1) and not near
        if up or clear or lift > 1.1 + doubt:
            m.mode = FLYING
            if says and not near and s.model > 0:
                rises = lift / m.x[23]
        elif lift * (1.0 + doubt) < 0.85 and height < 0.02:
            m.mode = RUNNING
    elif (height < 0.015 and lift < 0.9 and not clear) or (near and lift < 1.1 + doubt):
        m.mode = LIGHT
    if off and m.mode >= LIGHT and height < 0.05 and m.rotor[18] < 0.3 * s.hover[0]:
        m.mode = RUNNING
    if m.mode != FLYING:
        m.since[R_ACCELERATION] = m.tick
    return rises


@compiled(error_model="numpy")
def _lightness(m: Any, force: float) -> float:
    """On the legs, or just off them: density of what the force may be off by that rotors (``force`` of the model, m/s^2
    down) and legs make, the less the farther the rotors are from lifting the weight."""
    spread = LEAST_SPREAD if m.low == 1 else max(m.sigma[THRUST_] * -force, LEAST_SPREAD)
    over = (-m.out[23] * force - GRAVITY) / spread
    may = min(max(1.0 + over / MOST_DOUBT, 0.0), 1.0) * spread
    return TOGETHER * may * may


@compiled(error_model="numpy")
def _force(m: Any, s: Any, p: Any, z: _Array, new: NDArray[np.int32], r: _Array) -> float:
    """What acted over the period that has just ended: a row of inputs. Returns what :func:`_mode` does."""
    now = m.tick % MODELLED
    for j in range(4):
        sent = z[ACTING + j]
        m.acting[j] = min(max(sent, -1.0), 1.0) if sent == sent else 0.0
    turn_matrix(m.out[6:10], r)
    n, e, d = m.out[3] - m.out[21], m.out[4] - m.out[22], m.out[5]
    for k in range(3):
        m.row[k] = r[k] * n + r[3 + k] * e + r[6 + k] * d
        m.rotor[10 + k] = m.rates[k] - m.out[10 + k]
    if s.model > 0:
        model_force(m, s, p, m.row, m.force[now])
        for k in range(2):
            m.rotor[18 + k] += s.dt * m.motor_off[k]
        if new[R_ROTOR] == 1:
            a = _Z[R_ROTOR]
            if rotor_fits(m, s, z, a):
                for k in range(2):
                    off = z[a + k] - m.rotor[18 + k]
                    m.rotor[18 + k] += s.rotor_gain * off
                    m.motor_off[k] += s.rotor_drift * off
        if new[R_BATTERY] == 1:
            off = z[_Z[R_BATTERY]] - terminal_voltage_believed(m, p)
            if voltage_fits(m, s, off):
                fast = 0.2 if m.tick * s.dt < 1.0 else 0.02
                m.rotor[20] = min(max(m.rotor[20] + fast * off, 0.0), 1.0)
    rises = _mode(m, s, z)
    a, b = (now - s.lag_ticks) % MODELLED, (now - s.lag_ticks - 1) % MODELLED
    row = m.now
    model = s.model > 0
    for k in range(3):
        row[k] = 0.5 * (m.rates[k] + m.before[k])
        row[3 + k] = z[k]
        for g in range(3):
            row[6 + 3 * g + k] = (1 - s.lag_share) * m.force[a, 3 * g + k] + s.lag_share * m.force[
                b, 3 * g + k
            ]
        clip = m.clipped[k] * CLIPPED * s.felt_range
        # Without what a shaking leaves; but whose attitude is not known knows the force of the air better.
        noise = m.slow[k] if m.code[R_RATES] < MISSING else m.scatter[k]
        felt = (max(s.felt_density, noise) if s.model > 0 else s.felt_density) + TOGETHER * clip * clip
        made = s.model_density[k]
        if m.mode <= RUNNING:
            row[6 + k], row[9 + k], row[12 + k] = 0.0, -GRAVITY * r[6 + k], 0.0
            felt, made = 1e6, 1e-3
        elif m.mode == LIGHT:
            # Legs may carry what the rotors do not: nothing is learnt of these.
            row[9 + k] += m.out[23] * row[6 + k]
            if k == 2:
                row[11] = -GRAVITY * r[8] if m.low == 1 else min(row[11], -GRAVITY * r[8])
            made = 0.05
            if k == 2:
                made += _lightness(m, row[8])
            row[6 + k] = 0.0
        elif model:
            # Until the thrust is known, which takes the delay and more, it flies by the accelerometers.
            unknown = max(m.sigma[THRUST_] - KNOWN_THRUST, 0.0) * row[6 + k]
            made += UNKNOWN_S * unknown * unknown
        if not model and m.mode > RUNNING:
            row[6 + k], row[9 + k], row[12 + k] = 0.0, -GRAVITY if k == 2 else 0.0, 0.0
            made = 10.0
        if m.code[R_ACCELERATION] >= MISSING or m.disowned == 1 or s.fitted[R_ACCELERATION] == 0:
            felt = 1e6
        share = made / (felt + made)
        row[15 + k] = share
        row[18 + k] = felt * share
    row[21] = m.mode
    # Mean over the block so far
    into = m.inputs[(m.tick - 1) // s.block % KEPT]
    share = 1.0 / ((m.tick - 1) % s.block + 1)
    for j in range(INPUTS - 1):
        into[j] = row[j] if share == 1.0 else into[j] + share * (row[j] - into[j])
    into[21] = m.mode
    return rises


@compiled(error_model="numpy")
def _pass_edge(m: Any, s: Any, span: float) -> None:
    """Over an edge that the sonar's cone has met what is nearest moves along an arc; it is passed as one flies on."""
    away = max(-m.x[2] - m.x[16], 0.1)
    speed = math.sqrt(m.x[3] * m.x[3] + m.x[4] * m.x[4])
    arc = s.sonar_arc * away
    passed = span * max(speed / max(s.sonar_reach * away, 0.05), 1.0 / EDGE_S)
    loosen(m.ut, m.d, FLOOR, arc * arc * passed, m.f)
    m.edge = max(m.edge - passed, 0.0)
    if not m.edge > 0.0:
        m.steps = 0


@compiled(error_model="numpy")
def _advance(m: Any, s: Any, r: _Array, a: _Array) -> None:
    """Bring the horizon a block on."""
    span = s.block * s.dt
    e = m.inputs[m.horizon // s.block % KEPT]
    m.horizon += s.block
    m.stage = 0
    advance_state(m.x, e, span, r, a)
    for k in range(3):
        m.turning[k] += span / 1.5 * (e[k] - m.x[10 + k] - m.turning[k])
        m.felt[k] += e[3 + k]
        m.modelled[k] += a[3 + k]
        m.sum[k] += e[k]
        m.lever[k, 0] += e[6 + k]
        m.lever[k, 1] += e[12 + k]
    all_ = m.turning[0] ** 2 + m.turning[1] ** 2 + m.turning[2] ** 2
    m.spin = 0.0
    for k in range(3):
        m.spin += r[6 + k] * (e[k] - m.x[10 + k])
        m.q[k] = s.noise[k]
        m.q[3 + k] = spread_along(r, k, e) * span
        spread = s.gyro_density + (BLIND_TURN if m.code[R_RATES] >= MISSING else 0.0)
        for i in range(3):
            own = m.turning[i] ** 2
            spread += r[3 * k + i] * r[3 * k + i] * (s.gyro_off[0] * (all_ - own) + s.gyro_off[1] * own)
        m.q[6 + k] = spread * span
    transition(e, span, r, a, m.transition)
    carry(m.ut, m.d, span, m.transition, m.q, m.w, m.f)
    if m.edge > 0.0:
        _pass_edge(m, s, span)
    m.felt_count += s.block


@compiled(error_model="numpy")
def _wander(m: Any, s: Any) -> None:
    """Step one bias, whose turn it is; those of the fix have none."""
    k = GYRO + m.tick % TURNS
    if k >= FIX:
        k += HEADING + 1 - FIX
    m.x[k + 1] = s.start[k + 1] + (m.x[k + 1] - s.start[k + 1]) * s.keep[k]
    q = s.noise[k]
    if k < GYRO + 3 and m.adrift > 0:
        may = ADRIFT if m.adrift > 1 else ONCE_ADRIFT
        q += may * may * (TURNS * s.dt)
    elif k == FLOOR:
        q *= math.sqrt(m.x[3] * m.x[3] + m.x[4] * m.x[4])  # another floor lies elsewhere, not later
    if q > 0.0:
        wander(m.ut, m.d, k, s.keep[k], q, m.f)


@compiled(error_model="numpy")
def _wander_fix(m: Any, s: Any) -> None:
    """Step what the fix is off by to the horizon, N and E by the same time, which turns would not."""
    for k in range(FIX, HEADING + 1):
        keep, by = 1.0, s.keep[k]
        blocks = (m.horizon - m.wandered) // s.block
        while blocks > 0:
            if blocks % 2 == 1:
                keep *= by
            by *= by
            blocks //= 2
        m.x[k + 1] *= keep
        q = s.sigma[k] * s.sigma[k] * (1.0 - keep * keep)
        if q > 0.0:
            wander(m.ut, m.d, k, keep, q, m.f)
    m.wandered = m.horizon


@compiled(error_model="numpy")
def _measured(m: Any, s: Any, r: _Array, left: int) -> int:
    """Take in the next measurement that is due at the horizon, if any; return what it cost, 0 if there is no time."""
    behind = m.tick - s.delay - m.horizon >= LAG * s.block
    i = -1
    for j in range(WAITING if m.stage == 0 else 0):
        if m.due[j] == m.horizon:
            if behind:
                m.late[m.what[j]] += 1
                m.beam = 0
                m.due[j] = -1
            elif i < 0 or m.what[j] < m.what[i]:
                i = j
    if i >= 0:
        kind, z, ahead = m.what[i], m.value[i], m.ahead[i]
        cost = 1
        if kind == R_FIX:
            cost = WANDERING if m.wandered < m.horizon else FIXING
        elif kind == R_RING:
            cost = max(min(s.beams - m.beam, left), 1)
        if cost > left:
            return 0
        done = True
        if kind == R_FIX and m.wandered < m.horizon:
            _wander_fix(m, s)
            done = False
        elif kind == R_FIX:
            fuse_fix(m, s, z, ahead)
        elif kind == R_SONAR:
            fuse_sonar(m, s, z, ahead, r)
        elif kind == R_RING:
            done = fuse_ring(m, s, z, ahead, r, cost)
        elif kind == R_PRESSURE:
            fuse_pressure(m, s, z, ahead)
        else:
            fuse_magnet(m, s, z, ahead, r)
        if done:
            m.due[i] = -1
        return cost
    return -1


@compiled(error_model="numpy")
def _means(m: Any, s: Any) -> None:
    """What was felt and made since forces were compared last."""
    e = m.inputs[(m.horizon // s.block - 1) % KEPT]
    n = m.felt_count // s.block
    for k in range(3):
        m.felt[k] /= n
        m.modelled[k] /= n
        m.sum[k] /= n
        m.lever[k, 0] /= n
        m.lever[k, 1] /= n
        # Density of the whole difference at the horizon, from what was weighed there
        share = max(e[15 + k], 1e-9)
        m.lever[k, 2] = e[18 + k] / share / max(1 - share, 1e-9) + m.scatter[k]


@compiled(error_model="numpy")
def _task(m: Any, s: Any, r: _Array, a: _Array, left: int) -> int:
    """Do what is next at the horizon if it costs no more than ``left``; return the cost, 0 if nothing was done."""
    cost = _measured(m, s, r, left)
    if cost >= 0:
        return cost
    if m.stage == 0:
        m.stage = EDGES
    if m.stage == EDGES:
        m.stage = MEANS
        if not m.edge > 0.0 and abs(m.x[16]) < LOW:
            sure = variance(m.ut, m.d, FLOOR)
            if sure > SETTLED * SETTLED and m.x[16] * m.x[16] < 9.0 * sure:
                settle_floor(m)
                return 1
    if m.stage == MEANS:
        m.stage = DONE
        if m.felt_count >= LONGEST:
            _means(m, s)
            m.stage = AXES
    mode = int(m.inputs[(m.horizon // s.block - 1) % KEPT, 21])
    while AXES <= m.stage < LEGS:
        i = m.stage - AXES
        cost = 0
        if mode <= RUNNING:
            cost = RESTING
            if cost > left:
                return 0
            fuse_rest(m, s, r, m.felt_count, mode == STANDING, i)
            m.standing += m.felt_count if mode == STANDING and i == 0 else 0
        elif mode == FLYING and s.model > 0 and s.fitted[R_ACCELERATION] > 0:
            cost = 1
            fuse_force(m, s, r, m.felt_count, i)
        m.stage += 1
        if cost > 0:
            return cost
    if m.stage == LEGS:
        m.stage = DONE
        cost = 1 if mode > RUNNING and fuse_floor(m, s) else 0
        for k in range(3):
            m.felt[k] = m.modelled[k] = m.sum[k] = m.lever[k, 0] = m.lever[k, 1] = 0.0
        m.lever[0, 3] = 0.0
        m.felt_count = 0
        if cost > 0:
            return cost
    if m.horizon + s.block > m.tick - s.delay or left < STEPPING:
        return 0
    _advance(m, s, r, a)
    return STEPPING


@compiled(error_model="numpy")
def _doubt_felt(m: Any, s: Any, k: int) -> None:
    """What is known of the accelerometers' noise now holds for what the horizon has not come to yet, too."""
    for at in range(m.horizon, m.tick, s.block):
        e = m.inputs[at // s.block % KEPT]
        share = max(e[15 + k], 1e-9)
        felt = max(e[18 + k] / share, m.slow[k])
        made = e[18 + k] / max(1.0 - share, 1e-9)
        e[15 + k] = made / (felt + made)
        e[18 + k] = felt * e[15 + k]


@compiled(error_model="numpy")
def _scatter(m: Any, s: Any, z: _Array) -> None:
    """How much the accelerometers scatter about the model: means over blocks, which a shaking leaves something in, and
    means with weights that rise and fall, which it leaves nothing in: what stays of it in the velocity."""
    row = m.now
    m.blocks += 1
    m.slow_blocks += 1
    weight = m.slow_blocks if m.slow_blocks <= SLOWLY // 2 else SLOWLY + 1 - m.slow_blocks
    for k in range(3):
        off = z[k] - (m.x[23] * row[6 + k] + row[9 + k])
        m.mean[k] += off
        m.slow_mean[k] += weight * (off - row[12 + k] * m.row[k])
    if m.slow_blocks >= SLOWLY:
        half = float(SLOWLY // 2)
        span = 0.75 * SLOWLY * s.dt
        # Off the floor the model has another force, and the thrust's scale is found.
        settled = m.mode != FLYING or m.tick - m.since[R_ACCELERATION] > 2 * SLOWLY
        for k in range(3):
            mean = m.slow_mean[k] / (half * (half + 1.0))
            # What the model may be off by, at lift-off by much, is not the accelerometers'.
            unknown = 2.0 * m.sigma[THRUST_] * abs(row[6 + k])
            step = max(abs(mean - m.slow_last[k]) - unknown, 0.0)
            made = row[18 + k] / max(1.0 - row[15 + k], 1e-9)
            density = max(0.5 * step * step * span - made, 0.0)
            if m.mode == FLYING and settled:
                apart = abs(mean - m.x[13 + k]) - (ASUNDER + unknown)
                density += max(apart, 0.0) * max(apart, 0.0)
                if apart > (m.clipped[0] + m.clipped[1] + m.clipped[2]) * CLIPPED * s.felt_range:
                    flag(m, s, R_ACCELERATION, REJECTED, OFF, mean - m.x[13 + k])
            density = min(density, 100.0)
            most = max(0.6 if density > m.slow[k] else 0.2, 1.0 / (m.slow_count + 1))
            m.slow_last[k] = mean
            m.slow_mean[k] = 0.0
            if settled:
                m.slow[k] += most * (density - m.slow[k])
                if density > made:
                    _doubt_felt(m, s, k)
        m.slow_blocks = 0
        m.slow_count += 1
        if m.code[R_ACCELERATION] == REJECTED and m.tick >= m.until[R_ACCELERATION]:
            m.code[R_ACCELERATION], m.why[R_ACCELERATION] = FUSED, FINE
    if m.blocks >= LONGEST:
        span = m.blocks * s.dt
        for k in range(3):
            mean = m.mean[k] / m.blocks
            step = mean - m.suspect[R_ACCELERATION, k]
            m.suspect[R_ACCELERATION, k] = mean
            density = max(0.5 * step * step * span - s.model_density[k], 0.0)
            density = min(density, 100.0)
            m.scatter[k] += (0.2 if density > m.scatter[k] else 0.05) * (density - m.scatter[k])
            m.mean[k] = 0.0
        m.blocks = 0


@compiled(error_model="numpy")
def step(m: Any, s: Any, p: Any, z: _Array, new: NDArray[np.int32], age: _Array) -> bool:
    """One period.

    Parameters
    ----------
    m, s, p : records
        Memory, settings, parameters of the flight model.
    z : (n,) array
        Readings, in the order of :data:`mufly.estimate.layout.CHECKED`, then what acted (4) and the share of clipped
        samples (3).
    new : (9,) array of int
        0: nothing new; 1: a new reading; 2: one that says of itself that it is none.
    age : (9,) array
        Of each (s).
    """
    m.tick += 1
    inspect(m, s, z, new, age)
    r, a = m.attitude, m.push
    for k in range(3):
        m.before[k] = m.rates[k]
        if m.code[R_RATES] < MISSING:
            m.rates[k] = z[_Z[R_RATES] + k] - m.shift[k]
        elif s.model > 0 and m.mode >= LIGHT:
            # What the model turns: the bar holds it to the rotors, so it does not drift but about the mast.
            m.rates[k] = m.before[k] + s.dt * m.force[(m.tick - 1) % MODELLED, 9 + k] + m.turn_off[k]
        else:
            m.rates[k] = m.out[10 + k]
    # A floor below the room's, or a fix that is apart from the sonar: the height is off by as much
    doubt = m.suspect[R_FIX, 3] - min(m.out[16], 0.0)
    smooth_rates(m, s, m.mode == FLYING and height_over(m.out, s) > CLEAR + doubt)
    rises = _force(m, s, p, z, new, r)
    if s.model > 0 and m.mode >= RUNNING and m.code[R_ACCELERATION] < MISSING:
        _scatter(m, s, z)
    for kind in range(R_SONAR, R_FIX + 1):
        if kind == R_ROTOR or new[kind] != 1 or m.skip[kind] > 0:
            continue
        # The state of tick k belongs to k dt - lag.
        at = m.tick + (s.lag - age[kind] - s.latency[kind] * (1 if kind == R_PRESSURE else 0)) / s.dt
        if not _queue(m, s, kind, at, z, STARTS[kind], STARTS[kind + 1] - STARTS[kind]):
            m.late[kind] += 1
            # One alone is no fault: jitter has a longer tail than the horizon waits for.
            if (m.tick - m.used[kind]) * s.dt > s.patience[kind]:
                flag(m, s, kind, FAULTY, LATE, age[kind])
    left = s.work - (TELLING if m.tick % TOLD_EVERY == 0 else 0)
    _wander(m, s)
    if rises > 0.0 and m.sigma[THRUST_] > LIFTS_OFF:
        fuse_lift(m, rises)
        left -= 1
    while left > 0:
        cost = _task(m, s, r, a, left)
        if cost == 0:
            break
        left -= cost
    tell(m, s, r, a)
    found = s.fitted[R_FIX] == 0 or m.aligned > 0
    if m.lifted == 0 and found and (m.standing * s.dt >= _ALIGNED_S or m.tick * s.dt > 3.0):
        m.lifted = 1
    turns = s.model > 0 and m.mode >= LIGHT
    seen = m.code[R_RATES] < MISSING or turns or (m.tick - m.used[R_RATES]) * s.dt < _BLIND_S
    for k in range(3):
        # Nonsense may have the model run away: what no gyroscope could say is no estimate.
        if not abs(m.out_rates[k]) < 2.0 * s.bound[R_RATES]:
            seen = False
    return m.lifted > 0 and seen
