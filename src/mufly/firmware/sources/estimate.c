#include "estimate.h"

#include "factors.h"
#include "flight_model.h"
#include "fusing.h"
#include "guards.h"
#include "motion.h"

void estimator_begin(estimator_t *m, const estimator_settings_t *s)
{
    uint8_t *bytes = (uint8_t *)m;

    for (uint32_t i = 0U; i < (uint32_t)sizeof(*m); i++) {
        bytes[i] = 0U;
    }
    for (int32_t i = 0; i < STATES; i++) {
        m->x[i] = s->start[i];
        m->way[i] = s->start[i];
        m->come[i] = s->start[i];
    }
    for (int32_t i = 0; i < ERRORS; i++) {
        m->d[i] = (s->sigma[i] * s->sigma[i]) + REAL(1e-12);
        m->ut[i][i] = REAL(1.0);
    }
    for (int32_t i = 0; i < WAITING; i++) {
        m->due[i] = -1;
    }
    m->stage = DONE;
    m->out[6] = REAL(1.0);
    m->rotor[6] = REAL(1.0);
    m->rotor[20] = REAL(1.0);
    m->rotor[2] = REAL(-1000.0); /* far above the floor */
    m->rotor[17] = REAL(-1.0);
    for (int32_t k = 0; k < 3; k++) {
        m->scatter[k] = SCATTER;
        m->slow[k] = SCATTER;
    }
}

/* Let a measurement of tick `at` wait until the horizon has come to it; false if that is over for too long, or no place
 * is left. */
static bool queue(estimator_t *m, const estimator_settings_t *s, int32_t kind, real_t at, const real_t *z)
{
    const int32_t nearest = s->block * real_whole((at / (real_t)s->block) + REAL(0.5));
    /* By what it moves and turns, the next end of a block will do. */
    const int32_t due = (nearest <= m->horizon) ? (m->horizon + s->block) : nearest;
    const real_t ahead = (at - (real_t)due) * s->dt;
    bool waits = false;

    if (!(-ahead > BACK_S)) {
        for (int32_t i = 0; (i < WAITING) && !waits; i++) {
            if (m->due[i] < 0) {
                waits = true;
                m->due[i] = due;
                m->what[i] = kind;
                m->ahead[i] = ahead;
                for (int32_t j = 0; j < (STARTS[kind + 1] - STARTS[kind]); j++) {
                    m->value[i][j] = z[j];
                }
            }
        }
    }
    return waits;
}

/* Whether it stands, flies or is about to: by what the rotors lift and how high it is. What the model lifts (of the
 * weight) in the period in which the sonar says that it leaves the floor, else 0. */
static real_t judge_mode(estimator_t *m, const estimator_settings_t *s, const real_t z[VALUES])
{
    const real_t lift =
        (s->model > 0) ? ((-m->force[cycle(m->tick, MODELLED)][2] * m->x[23]) / GRAVITY) : REAL(1.0);
    const real_t height = height_over(m->out, s);
    const bool off = (z[ACTING] + z[ACTING + 1]) < REAL(0.02);
    /* Rotors that lift more than the model says fly sooner, others later. */
    const real_t doubt = (s->model > 0) ? (MOST_DOUBT * m->sigma[THRUST_]) : REAL(0.0);
    /* What the sonar says is fresher than the height that is believed; but not one that sees below the floor. */
    const bool says = (m->code[R_SONAR] == FUSED) && (height < BELIEVED_LOW) && (m->x[16] > LEAST_FLOOR);
    const bool near = says && (m->last[STARTS[R_SONAR]] <= (s->sonar_min + (REAL(0.5) * s->sonar_step)));
    const bool clear = says && (m->last[STARTS[R_SONAR]] > (s->sonar_min + LIFTED));

    real_t rises = REAL(0.0);

    m->low = near ? 1 : 0;
    if (m->mode <= RUNNING) {
        m->mode = (off && ((m->rotor[18] + m->rotor[19]) < (REAL(0.2) * (s->hover[0] + s->hover[1])))) ? STANDING
                                                                                                       : RUNNING;
        if (((lift * (REAL(1.0) + doubt)) > REAL(0.9)) && (m->mode == RUNNING)) {
            m->mode = LIGHT;
            m->lifted = m->tick;
        }
    } else if (m->mode == LIGHT) {
        if (((height > (REAL(0.03) + real_min(REAL(2.0) * m->sigma[P_ + 2], REAL(0.1)))) && !near) || clear ||
            (lift > (REAL(1.1) + doubt))) {
            m->mode = FLYING;
            rises = (says && !near && (s->model > 0)) ? (lift / m->x[23]) : REAL(0.0);
        } else if (((lift * (REAL(1.0) + doubt)) < REAL(0.85)) && (height < REAL(0.02))) {
            m->mode = RUNNING;
        } else {
            /* still light */
        }
    } else if (((height < REAL(0.015)) && (lift < REAL(0.9)) && !clear) || (near && (lift < (REAL(1.1) + doubt)))) {
        m->mode = LIGHT;
    } else {
        /* flies on */
    }
    if (off && (m->mode >= LIGHT) && (height < REAL(0.05)) && (m->rotor[18] < (REAL(0.3) * s->hover[0]))) {
        m->mode = RUNNING;
    }
    if (m->mode != FLYING) {
        m->since[R_ACCELERATION] = m->tick;
    }
    return rises;
}

/* The flight model's forces now, corrected by the rotor speeds and the voltage that are read. */
static void model_now(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                      const int32_t *fresh)
{
    model_force(m, s, p, m->row, m->force[cycle(m->tick, MODELLED)]);
    for (int32_t k = 0; k < 2; k++) {
        m->rotor[18 + k] += s->dt * m->motor_off[k];
    }
    if (fresh[R_ROTOR] == 1) {
        const real_t *speed = &z[STARTS[R_ROTOR]];

        if (rotor_fits(m, s, speed)) {
            for (int32_t k = 0; k < 2; k++) {
                const real_t off = speed[k] - m->rotor[18 + k];

                m->rotor[18 + k] += s->rotor_gain * off;
                m->motor_off[k] += s->rotor_drift * off;
            }
        }
    }
    if (fresh[R_BATTERY] == 1) {
        real_t voltage;
        real_t current;
        real_t off;

        battery(m->rotor, m->acting[0], m->acting[1], p, &voltage, &current);
        off = z[STARTS[R_BATTERY]] - voltage;
        if (voltage_fits(m, s, off)) {
            const real_t fast = (((real_t)m->tick * s->dt) < REAL(1.0)) ? REAL(0.2) : REAL(0.02);

            m->rotor[20] =
                real_min(real_max(m->rotor[20] + (fast * off), REAL(0.0)), REAL(1.0));
        }
    }
}

/* The row of inputs of the block that begins behind a tick. */
static real_t *inputs_from(estimator_t *m, const estimator_settings_t *s, int32_t tick)
{
    return m->inputs[cycle(tick / s->block, KEPT)];
}

/* The mean over the block so far. */
static void average(estimator_t *m, const estimator_settings_t *s)
{
    real_t *into = inputs_from(m, s, m->tick - 1);
    const int32_t count = cycle(m->tick - 1, s->block) + 1;
    const real_t share = REAL(1.0) / (real_t)count;

    for (int32_t j = 0; j < (INPUTS - 1); j++) {
        into[j] = (count == 1) ? m->now[j] : (into[j] + (share * (m->now[j] - into[j])));
    }
    into[INPUTS - 1] = m->now[INPUTS - 1];
}

/* On the legs, or just off them: density of what the force may be off by that the rotors (m/s2, of the model, down)
 * beside the legs make, the less the farther the rotors are from lifting the weight. */
static real_t lightness(const estimator_t *m, real_t force)
{
    const real_t spread =
        (m->low == 1) ? LEAST_SPREAD : real_max(m->sigma[THRUST_] * -force, LEAST_SPREAD);
    const real_t over = (((-m->out[23]) * force) - GRAVITY) / spread;
    const real_t may = real_min(real_max(REAL(1.0) + (over / MOST_DOUBT), REAL(0.0)), REAL(1.0)) * spread;

    return (TOGETHER * may) * may;
}

/* What acted over the period that has just ended: a row of inputs. Returns what judge_mode does. */
static real_t gather(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                   const int32_t *fresh)
{
    const int32_t now = cycle(m->tick, MODELLED);
    const int32_t a = cycle(now - s->lag_ticks, MODELLED);
    const int32_t b = cycle((now - s->lag_ticks) - 1, MODELLED);
    real_t *row = m->now;
    real_t r[9];
    real_t n;
    real_t e;
    real_t d;
    real_t rises;

    for (int32_t j = 0; j < 4; j++) {
        const real_t sent = z[ACTING + j];

        m->acting[j] = (sent == sent) ? real_min(real_max(sent, REAL(-1.0)), REAL(1.0)) : REAL(0.0);
    }
    turn_matrix(&m->out[6], r);
    n = m->out[3] - m->out[21];
    e = m->out[4] - m->out[22];
    d = m->out[5];
    for (int32_t k = 0; k < 3; k++) {
        m->row[k] = ((r[k] * n) + (r[3 + k] * e)) + (r[6 + k] * d);
        m->rotor[10 + k] = m->rates[k] - m->out[10 + k];
    }
    if (s->model > 0) {
        model_now(m, s, p, z, fresh);
    }
    rises = judge_mode(m, s, z);
    for (int32_t k = 0; k < 3; k++) {
        const real_t clip = (m->clipped[k] * CLIPPED) * s->felt_range;
        /* Without what a shaking leaves; but whose attitude is not known knows the force of the air better. */
        const real_t noise = (m->code[R_RATES] < MISSING) ? m->slow[k] : m->scatter[k];
        real_t felt = ((s->model > 0) ? real_max(s->felt_density, noise) : s->felt_density) + ((TOGETHER * clip) * clip);
        real_t made = s->model_density[k];
        real_t share;

        row[k] = REAL(0.5) * (m->rates[k] + m->before[k]);
        row[3 + k] = z[k];
        for (int32_t g = 0; g < 3; g++) {
            row[6 + (3 * g) + k] = ((REAL(1.0) - s->lag_share) * m->force[a][(3 * g) + k]) +
                                   (s->lag_share * m->force[b][(3 * g) + k]);
        }
        if (m->mode <= RUNNING) {
            row[6 + k] = REAL(0.0);
            row[9 + k] = -GRAVITY * r[6 + k];
            row[12 + k] = REAL(0.0);
            felt = REAL(1e6);
            made = REAL(1e-3);
        } else if (m->mode == LIGHT) {
            /* Legs may carry what the rotors do not: nothing is learnt of these. */
            row[9 + k] += m->out[23] * row[6 + k];
            if (k == 2) {
                row[11] = (m->low == 1) ? (-GRAVITY * r[8]) : real_min(row[11], -GRAVITY * r[8]);
            }
            made = REAL(0.05);
            if (k == 2) {
                made += lightness(m, row[8]);
            }
            row[6 + k] = REAL(0.0);
        } else if (s->model > 0) {
            /* Until the thrust is known, which takes the delay and more, it flies by the accelerometers. */
            const real_t unknown = real_max(m->sigma[THRUST_] - KNOWN_THRUST, REAL(0.0)) * row[6 + k];

            made += (UNKNOWN_S * unknown) * unknown;
        } else {
            /* flies without a model */
        }
        if ((s->model <= 0) && (m->mode > RUNNING)) {
            row[6 + k] = REAL(0.0);
            row[9 + k] = (k == 2) ? -GRAVITY : REAL(0.0);
            row[12 + k] = REAL(0.0);
            made = REAL(10.0);
        }
        if ((m->code[R_ACCELERATION] >= MISSING) || (m->disowned == 1) || (s->fitted[R_ACCELERATION] == 0)) {
            felt = REAL(1e6);
        }
        share = made / (felt + made);
        row[15 + k] = share;
        row[18 + k] = felt * share;
    }
    row[INPUTS - 1] = (real_t)m->mode;
    average(m, s);
    return rises;
}

/* Density of the velocity's noise along an axis of N-E-D. */
static real_t spread_along(const real_t r[9], int32_t k, const real_t e[INPUTS])
{
    real_t spread = REAL(0.0);

    for (int32_t i = 0; i < 3; i++) {
        spread += (r[(3 * k) + i] * r[(3 * k) + i]) * e[18 + i];
    }
    return spread;
}

/* Over an edge that the sonar's cone has met what is nearest moves along an arc; it is passed as one flies on. */
static void pass_edge(estimator_t *m, const estimator_settings_t *s, real_t span)
{
    const real_t away = real_max(-m->x[2] - m->x[16], REAL(0.1));
    const real_t speed = real_sqrt((m->x[3] * m->x[3]) + (m->x[4] * m->x[4]));
    const real_t arc = s->sonar_arc * away;
    const real_t passed =
        span * real_max(speed / real_max(s->sonar_reach * away, REAL(0.05)), REAL(1.0) / EDGE_S);

    factors_loosen(m, FLOOR, (arc * arc) * passed);
    m->edge = real_max(m->edge - passed, REAL(0.0));
    if (!(m->edge > REAL(0.0))) {
        m->steps = 0;
    }
}

/* Bring the horizon a block on. */
static void advance(estimator_t *m, const estimator_settings_t *s)
{
    const real_t span = (real_t)s->block * s->dt;
    const real_t *e = inputs_from(m, s, m->horizon);
    real_t r[9];
    real_t a[6];
    real_t q[MOVING];
    real_t transition[TRANSITION];
    real_t all;

    m->horizon += s->block;
    m->stage = 0;
    advance_state(m->x, e, span, r, a);
    for (int32_t k = 0; k < 3; k++) {
        m->turning[k] += (span / REAL(1.5)) * ((e[k] - m->x[10 + k]) - m->turning[k]);
        m->felt[k] += e[3 + k];
        m->modelled[k] += a[3 + k];
        m->sum[k] += e[k];
        m->lever[k][0] += e[6 + k];
        m->lever[k][1] += e[12 + k];
    }
    all = ((m->turning[0] * m->turning[0]) + (m->turning[1] * m->turning[1])) + (m->turning[2] * m->turning[2]);
    m->spin = REAL(0.0);
    for (int32_t k = 0; k < 3; k++) {
        real_t spread = s->gyro_density + ((m->code[R_RATES] >= MISSING) ? BLIND_TURN : REAL(0.0));

        m->spin += r[6 + k] * (e[k] - m->x[10 + k]);
        q[k] = s->noise[k];
        q[3 + k] = spread_along(r, k, e) * span;
        for (int32_t i = 0; i < 3; i++) {
            const real_t own = m->turning[i] * m->turning[i];

            spread += (r[(3 * k) + i] * r[(3 * k) + i]) *
                      ((s->gyro_off[0] * (all - own)) + (s->gyro_off[1] * own));
        }
        q[6 + k] = spread * span;
    }
    transition_of(e, span, r, a, transition);
    factors_carry(m, span, transition, q);
    if (m->edge > REAL(0.0)) {
        pass_edge(m, s, span);
    }
    m->felt_count += s->block;
}

/* Step one bias, whose turn it is; those of the fix have none. */
static void wander(estimator_t *m, const estimator_settings_t *s)
{
    const int32_t turn = GYRO + cycle(m->tick, TURNS);
    const int32_t k = (turn >= FIX) ? (turn + ((HEADING + 1) - FIX)) : turn;
    const bool adrift = (k < (GYRO + 3)) && (m->adrift > 0);
    const real_t may = (m->adrift > 1) ? ADRIFT : ONCE_ADRIFT;
    real_t q = s->noise[k] + (adrift ? ((may * may) * ((real_t)TURNS * s->dt)) : REAL(0.0));

    if (k == FLOOR) {
        q *= real_sqrt((m->x[3] * m->x[3]) + (m->x[4] * m->x[4])); /* another floor lies elsewhere, not later */
    }
    m->x[k + 1] = s->start[k + 1] + ((m->x[k + 1] - s->start[k + 1]) * s->keep[k]);
    if (q > REAL(0.0)) {
        factors_wander(m, k, s->keep[k], q);
    }
}

/* Step what the fix is off by to the horizon, N and E by the same time, which turns would not. */
static void wander_fix(estimator_t *m, const estimator_settings_t *s)
{
    for (int32_t k = FIX; k <= HEADING; k++) {
        real_t keep = REAL(1.0);
        real_t by = s->keep[k];
        real_t q;

        for (int32_t blocks = (m->horizon - m->wandered) / s->block; blocks > 0; blocks /= 2) {
            if ((blocks % 2) == 1) {
                keep *= by;
            }
            by *= by;
        }
        m->x[k + 1] *= keep;
        q = (s->sigma[k] * s->sigma[k]) * (REAL(1.0) - (keep * keep));
        if (q > REAL(0.0)) {
            factors_wander(m, k, keep, q);
        }
    }
    m->wandered = m->horizon;
}

/* What a measurement costs, in scalar ones; of the ring so many beams as there is time for. */
static int32_t cost_of(const estimator_t *m, const estimator_settings_t *s, int32_t kind, int32_t left)
{
    const int32_t beams = s->beams - m->beam;
    int32_t cost = 1;

    if (kind == R_FIX) {
        cost = (m->wandered < m->horizon) ? WANDERING : FIXING;
    } else if (kind == R_RING) {
        cost = (beams < left) ? beams : left;
        cost = (cost > 1) ? cost : 1;
    } else {
        /* a scalar one */
    }
    return cost;
}

/* Whether all of it has been taken in. */
static bool fuse_one(estimator_t *m, const estimator_settings_t *s, int32_t i, int32_t cost)
{
    const real_t *z = m->value[i];
    const real_t ahead = m->ahead[i];
    bool all = true;

    switch (m->what[i]) {
    case R_FIX:
        if (m->wandered < m->horizon) {
            wander_fix(m, s);
            all = false;
        } else {
            fuse_fix(m, s, z, ahead);
        }
        break;
    case R_SONAR:
        fuse_sonar(m, s, z, ahead);
        break;
    case R_RING:
        all = fuse_ring(m, s, z, ahead, cost);
        break;
    case R_PRESSURE:
        fuse_pressure(m, s, z, ahead);
        break;
    default:
        fuse_magnet(m, s, z, ahead);
        break;
    }
    return all;
}

/* The measurement that is due at the horizon and comes first, by its kind; -1 if there is none. What is due is left out
 * where the horizon is too far behind. */
static int32_t next_due(estimator_t *m, const estimator_settings_t *s)
{
    const bool behind = ((m->tick - s->delay) - m->horizon) >= (LAG * s->block);
    int32_t next = -1;

    for (int32_t i = 0; i < WAITING; i++) {
        if (m->due[i] == m->horizon) {
            if (behind) {
                m->late[m->what[i]] += 1;
                m->beam = 0;
                m->due[i] = -1;
            } else if ((next < 0) || (m->what[i] < m->what[next])) {
                next = i;
            } else {
                /* its turn comes */
            }
        }
    }
    return next;
}

/* Take in the next measurement that is due at the horizon: what it cost, 0 if there is no time, -1 if there is none. */
static int32_t measured(estimator_t *m, const estimator_settings_t *s, int32_t left)
{
    const int32_t i = (m->stage == 0) ? next_due(m, s) : -1;
    int32_t cost = -1;

    if (i >= 0) {
        cost = cost_of(m, s, m->what[i], left);
        if (cost > left) {
            cost = 0;
        } else if (fuse_one(m, s, i, cost)) {
            m->due[i] = -1;
        } else {
            /* more of it comes */
        }
    }
    return cost;
}

/* What was felt and made since forces were compared last. */
static void average_forces(estimator_t *m, const estimator_settings_t *s)
{
    const real_t *e = inputs_from(m, s, m->horizon - s->block);
    const real_t n = (real_t)(m->felt_count / s->block);

    for (int32_t k = 0; k < 3; k++) {
        /* Density of the whole difference at the horizon, from what was weighed there */
        const real_t share = real_max(e[15 + k], REAL(1e-9));

        m->felt[k] /= n;
        m->modelled[k] /= n;
        m->sum[k] /= n;
        m->lever[k][0] /= n;
        m->lever[k][1] /= n;
        m->lever[k][2] =
            ((e[18 + k] / share) / real_max(REAL(1.0) - share, REAL(1e-9))) + m->scatter[k];
    }
}

static void forget_forces(estimator_t *m)
{
    for (int32_t k = 0; k < 3; k++) {
        m->felt[k] = REAL(0.0);
        m->modelled[k] = REAL(0.0);
        m->sum[k] = REAL(0.0);
        m->lever[k][0] = REAL(0.0);
        m->lever[k][1] = REAL(0.0);
    }
    m->lever[0][3] = REAL(0.0);
    m->felt_count = 0;
}

/* Back over the floor, if it is: what that cost. */
static int32_t leave_edge(estimator_t *m)
{
    int32_t cost = 0;

    if (!(m->edge > REAL(0.0)) && (real_abs(m->x[16]) < LOW)) {
        const real_t sure = factors_variance(m, FLOOR);

        if ((sure > (SETTLED * SETTLED)) && ((m->x[16] * m->x[16]) < (REAL(9.0) * sure))) {
            settle_floor(m);
            cost = 1;
        }
    }
    return cost;
}

/* The next axis of the forces: what it cost; 0 if there is no time for it, or nothing to do (then the stage is LEGS). */
static int32_t compare(estimator_t *m, const estimator_settings_t *s, int32_t mode, int32_t left)
{
    const int32_t i = m->stage - AXES;
    int32_t cost = 0;

    if (mode <= RUNNING) {
        if (RESTING <= left) {
            cost = RESTING;
            fuse_rest(m, s, m->felt_count, mode == STANDING, i);
            if ((mode == STANDING) && (i == 0)) {
                m->standing += m->felt_count;
            }
            m->stage += 1;
        }
    } else if ((mode == FLYING) && (s->model > 0) && (s->fitted[R_ACCELERATION] > 0)) {
        cost = 1;
        fuse_force(m, s, m->felt_count, i);
        m->stage += 1;
    } else {
        m->stage = LEGS; /* light: neither stands nor flies */
    }
    return cost;
}

/* What is next at the horizon, if it costs no more than `left`: what it cost; 0 if nothing was done. */
static int32_t task(estimator_t *m, const estimator_settings_t *s, int32_t left)
{
    int32_t cost = measured(m, s, left);
    bool decided = cost >= 0;

    if ((!decided) && (m->stage == 0)) {
        m->stage = EDGES;
    }
    if ((!decided) && (m->stage == EDGES)) {
        m->stage = MEANS;
        cost = leave_edge(m);
        decided = cost > 0;
    }
    if ((!decided) && (m->stage == MEANS)) {
        m->stage = DONE;
        if (m->felt_count >= LONGEST) {
            average_forces(m, s);
            m->stage = AXES;
        }
    }
    if (!decided) {
        const int32_t mode = (int32_t)inputs_from(m, s, m->horizon - s->block)[INPUTS - 1];

        if ((m->stage >= AXES) && (m->stage < LEGS)) {
            cost = compare(m, s, mode, left);
            decided = (cost > 0) || (m->stage < LEGS);
        }
        if ((!decided) && (m->stage == LEGS)) {
            m->stage = DONE;
            decided = (mode > RUNNING) && fuse_floor(m, s);
            forget_forces(m);
            cost = 1;
        }
    }
    if (!decided) {
        cost = 0;
        if (((m->horizon + s->block) <= (m->tick - s->delay)) && (left >= STEPPING)) {
            advance(m, s);
            cost = STEPPING;
        }
    }
    return cost;
}

/* What is known of the accelerometers' noise now holds for what the horizon has not come to yet, too. */
static void doubt_felt(estimator_t *m, const estimator_settings_t *s, int32_t k)
{
    for (int32_t at = m->horizon; at < m->tick; at += s->block) {
        real_t *e = inputs_from(m, s, at);
        const real_t share = real_max(e[15 + k], REAL(1e-9));
        const real_t felt = real_max(e[18 + k] / share, m->slow[k]);
        const real_t made = e[18 + k] / real_max(REAL(1.0) - share, REAL(1e-9));

        e[15 + k] = made / (felt + made);
        e[18 + k] = felt * e[15 + k];
    }
}

/* How much the accelerometers scatter about the model: means over blocks, which a shaking leaves something in, and
 * means with weights that rise and fall, which it leaves nothing in: what stays of it in the velocity. */
static void watch_scatter(estimator_t *m, const estimator_settings_t *s, const real_t z[3])
{
    const real_t *row = m->now;
    real_t weight;

    m->blocks += 1;
    m->slow_blocks += 1;
    weight = (real_t)((m->slow_blocks <= (SLOWLY / 2)) ? m->slow_blocks : ((SLOWLY + 1) - m->slow_blocks));
    for (int32_t k = 0; k < 3; k++) {
        const real_t off = z[k] - ((m->x[23] * row[6 + k]) + row[9 + k]);

        m->mean[k] += off;
        m->slow_mean[k] += weight * (off - (row[12 + k] * m->row[k]));
    }
    if (m->slow_blocks >= SLOWLY) {
        const real_t half = (real_t)(SLOWLY / 2);
        const real_t span = (REAL(0.75) * (real_t)SLOWLY) * s->dt;
        /* Off the floor the model has another force, and the thrust's scale is found. */
        const bool settled = (m->mode != FLYING) || ((m->tick - m->since[R_ACCELERATION]) > (2 * SLOWLY));

        for (int32_t k = 0; k < 3; k++) {
            const real_t mean = m->slow_mean[k] / (half * (half + REAL(1.0)));
            /* What the model may be off by, at lift-off by much, is not the accelerometers'. */
            const real_t unknown = (REAL(2.0) * m->sigma[THRUST_]) * real_abs(row[6 + k]);
            const real_t step = real_max(real_abs(mean - m->slow_last[k]) - unknown, REAL(0.0));
            const real_t made = row[18 + k] / real_max(REAL(1.0) - row[15 + k], REAL(1e-9));
            real_t density = real_max((((REAL(0.5) * step) * step) * span) - made, REAL(0.0));
            real_t most;

            if ((m->mode == FLYING) && settled) {
                const real_t apart = real_abs(mean - m->x[13 + k]) - (ASUNDER + unknown);

                density += real_max(apart, REAL(0.0)) * real_max(apart, REAL(0.0));
                if (apart > ((((m->clipped[0] + m->clipped[1]) + m->clipped[2]) * CLIPPED) * s->felt_range)) {
                    flag(m, s, R_ACCELERATION, REJECTED, OFF, mean - m->x[13 + k]);
                }
            }
            density = real_min(density, REAL(100.0));
            most = real_max((density > m->slow[k]) ? REAL(0.6) : REAL(0.2),
                            REAL(1.0) / (real_t)(m->slow_count + 1));
            m->slow_last[k] = mean;
            m->slow_mean[k] = REAL(0.0);
            if (settled) {
                m->slow[k] += most * (density - m->slow[k]);
                if (density > made) {
                    doubt_felt(m, s, k);
                }
            }
        }
        m->slow_blocks = 0;
        m->slow_count += 1;
        if ((m->code[R_ACCELERATION] == REJECTED) && (m->tick >= m->until[R_ACCELERATION])) {
            m->code[R_ACCELERATION] = FUSED;
            m->why[R_ACCELERATION] = FINE;
        }
    }
    if (m->blocks >= LONGEST) {
        const real_t span = (real_t)m->blocks * s->dt;

        for (int32_t k = 0; k < 3; k++) {
            const real_t mean = m->mean[k] / (real_t)m->blocks;
            const real_t step = mean - m->suspect[R_ACCELERATION][k];
            real_t density =
                real_max((((REAL(0.5) * step) * step) * span) - s->model_density[k], REAL(0.0));

            m->suspect[R_ACCELERATION][k] = mean;
            density = real_min(density, REAL(100.0));
            m->scatter[k] += ((density > m->scatter[k]) ? REAL(0.2) : REAL(0.05)) * (density - m->scatter[k]);
            m->mean[k] = REAL(0.0);
        }
        m->blocks = 0;
    }
}

/* Let what is told follow a jump of the state within a second, so that none goes to the actuators. */
static void smooth(estimator_t *m, const estimator_settings_t *s)
{
    real_t *x = m->out;

    for (int32_t k = 0; k < 3; k++) {
        const real_t jump = x[k] - (m->told[k] + (s->dt * x[3 + k]));

        if ((m->lifted > 0) && (real_abs(jump) > JUMP)) {
            m->slip[k] -= jump;
        }
        m->told[k] = x[k];
        m->slip[k] -= (s->dt / SLIP_S) * m->slip[k];
        x[k] += m->slip[k];
    }
}

/* Roll, pitch and yaw of the attitude that is told. */
static void tell_angles(estimator_t *m)
{
    const real_t w = m->out[6];
    const real_t x = m->out[7];
    const real_t y = m->out[8];
    const real_t z = m->out[9];
    const real_t sine =
        real_min(real_max(REAL(2.0) * ((w * y) - (z * x)), REAL(-1.0)), REAL(1.0));
    const real_t yaw = real_atan2(REAL(2.0) * ((w * z) + (x * y)),
                                   REAL(1.0) - (REAL(2.0) * ((y * y) + (z * z))));

    m->angles[0] = real_atan2(REAL(2.0) * ((w * x) + (y * z)),
                               REAL(1.0) - (REAL(2.0) * ((x * x) + (y * y))));
    m->angles[1] = real_atan2(sine, real_sqrt((REAL(1.0) - sine) * (REAL(1.0) + sine)));
    m->angles[2] = yaw + (TURN_RAD * (real_t)real_whole(((m->angles[2] - yaw) / TURN_RAD) + REAL(0.5)));
}

/* Turns about N, E, D to roll, pitch and yaw, of one row or column. */
static void to_angles(real_t *north, real_t *east, real_t *down, real_t c, real_t t, real_t sine, real_t cosine)
{
    const real_t n = *north;
    const real_t e = *east;

    *north = ((c * n) + (t * e)) / cosine;
    *east = (-t * n) + (c * e);
    *down += (sine / cosine) * ((c * n) + (t * e));
}

/* Covariance of what moves over the delay, F P F^T + Q, in one step by the mean acceleration on the way. */
static void told_errors(estimator_t *m, const estimator_settings_t *s, const real_t r[9])
{
    const real_t span = m->span;
    real_t transition[TRANSITION];

    for (int32_t k = 0; k < 3; k++) {
        m->row[k] = m->come_sum[3 + k] / span;
    }
    transition_of(m->now, span, r, m->row, transition);
    for (int32_t i = 0; i < MOVING; i++) {
        for (int32_t j = i; j < MOVING; j++) {
            m->out_cov[i][j] = REAL(0.0);
        }
    }
    for (int32_t k = 0; k < ERRORS; k++) {
        factors_carry_column(m->ut[k], span, transition, m->gain);
        for (int32_t i = 0; i < MOVING; i++) {
            const real_t c = m->d[k] * m->gain[i];

            for (int32_t j = i; j < MOVING; j++) {
                m->out_cov[i][j] += c * m->gain[j];
            }
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        m->out_cov[k][k] += ((m->come_sum[k] * span) * span) / REAL(3.0);
        m->out_cov[k][3 + k] += (m->come_sum[k] * span) / REAL(2.0);
        m->out_cov[3 + k][3 + k] += m->come_sum[k];
        for (int32_t i = 0; i < 3; i++) {
            /* A shaking is in the velocity for half a turn; what stays in means over blocks tells how much. */
            const real_t share = r[(3 * k) + i] * m->now[15 + i];
            const real_t shaking = real_max(m->scatter[i] - m->slow[i], REAL(0.0));

            m->out_cov[3 + k][3 + k] += (share * share) * (((real_t)LONGEST * s->dt) * shaking);
        }
        m->out_cov[6 + k][6 + k] += s->gyro_density * span;
    }
}

/* What is told of the errors, of the attitude as roll, pitch and yaw. */
static void tell_covariance(estimator_t *m)
{
    const real_t *x = m->out;
    const real_t sine =
        real_min(real_max(REAL(2.0) * ((x[6] * x[8]) - (x[9] * x[7])), REAL(-1.0)), REAL(1.0));
    const real_t cosine = real_max(real_sqrt(REAL(1.0) - (sine * sine)), REAL(0.05));
    real_t c;
    real_t t;

    for (int32_t i = 0; i < MOVING; i++) {
        for (int32_t j = 0; j < i; j++) {
            m->out_cov[i][j] = m->out_cov[j][i];
        }
    }
    for (int32_t i = MOVING; i < ERRORS; i++) {
        m->sigma[i] = real_sqrt(factors_variance(m, i));
    }
    for (int32_t i = 0; i < MOVING; i++) {
        if (i < 3) {
            /* Whoever is off in height, fix or sonar, the fix may be off by as much in any direction. */
            m->out_cov[i][i] += (m->slip[i] * m->slip[i]) + (m->suspect[R_FIX][3] * m->suspect[R_FIX][3]);
        }
        m->sigma[i] = real_sqrt(m->out_cov[i][i]);
    }
    sine_cosine(m->angles[2], &t, &c);
    for (int32_t j = 0; j < MOVING; j++) {
        to_angles(&m->out_cov[6][j], &m->out_cov[7][j], &m->out_cov[8][j], c, t, sine, cosine);
    }
    for (int32_t j = 0; j < MOVING; j++) {
        to_angles(&m->out_cov[j][6], &m->out_cov[j][7], &m->out_cov[j][8], c, t, sine, cosine);
    }
}

/* Carry the horizon's state on towards now, some blocks a period; m->come is at now. r, a: of the last step. */
static void carry_on(estimator_t *m, const estimator_settings_t *s, real_t r[9], real_t a[6])
{
    bool come = false;

    for (int32_t n = 0; (n < s->work) && !come; n++) {
        const real_t *e = inputs_from(m, s, m->way_tick);
        const int32_t rest = s->block - cycle(m->way_tick, s->block);
        const int32_t periods = (rest < (m->tick - m->way_tick)) ? rest : (m->tick - m->way_tick);
        const real_t span = (real_t)periods * s->dt;

        advance_state(m->way, e, span, r, a);
        for (int32_t k = 0; k < 3; k++) {
            m->way_sum[k] += spread_along(r, k, e) * span;
            m->way_sum[3 + k] += a[k] * span;
        }
        m->way_tick += periods;
        m->way_span += span;
        come = m->way_tick == m->tick;
    }
    if (come) {
        for (int32_t k = 0; k < 6; k++) {
            m->come_sum[k] = m->way_sum[k];
            m->way_sum[k] = REAL(0.0);
        }
        m->span = m->way_span;
        m->way_span = REAL(0.0);
        for (int32_t i = 0; i < STATES; i++) {
            m->come[i] = m->way[i];
            m->way[i] = m->x[i];
        }
        m->way_tick = m->horizon;
    } else {
        advance_state(m->come, m->now, s->dt, r, a);
    }
}

/* Tell the state of now; now and then its covariance too. */
static void tell(estimator_t *m, const estimator_settings_t *s)
{
    const bool much = (m->tick % TOLD_EVERY) == 0;
    real_t *x = m->out;
    real_t r[9];
    real_t a[6];

    carry_on(m, s, r, a);
    for (int32_t i = 0; i < STATES; i++) {
        x[i] = m->come[i];
    }
    if (much) {
        told_errors(m, s, r);
    }
    /* States belong to `lag` before the tick: the last bit with the last rates and acceleration. */
    a[2] += GRAVITY;
    for (int32_t k = 0; k < 3; k++) {
        x[k] += s->lag * (x[3 + k] + ((REAL(0.5) * s->lag) * a[k]));
        x[3 + k] += s->lag * a[k];
        m->out_rates[k] = m->rates[k] - x[10 + k];
        if ((s->model > 0) && (m->mode == FLYING)) {
            m->out_rates[k] += s->lag * m->force[cycle(m->tick, MODELLED)][9 + k];
        }
    }
    turned(x, s->lag * m->out_rates[0], s->lag * m->out_rates[1], s->lag * m->out_rates[2], true);
    if ((s->model > 0) && (x[16] < LOW)) {
        /* Legs do not go into the floor on the way either, nor on. */
        const real_t lowest = -(real_max(x[16], REAL(0.0)) + s->stands);

        if (x[2] >= lowest) {
            x[2] = lowest;
            x[5] = real_min(x[5], REAL(0.0));
        }
    }
    smooth(m, s);
    tell_angles(m);
    if (much) {
        tell_covariance(m);
    }
}

/* New measurements wait for the horizon to come to their instant. */
static void let_wait(estimator_t *m, const estimator_settings_t *s, const real_t z[VALUES],
                     const int32_t fresh[SENSORS], const real_t age[SENSORS])
{
    for (int32_t kind = R_SONAR; kind <= R_FIX; kind++) {
        if ((kind != R_ROTOR) && (fresh[kind] == 1) && (m->skip[kind] <= 0)) {
            /* The state of tick k belongs to k dt - lag. */
            const real_t settling = (kind == R_PRESSURE) ? s->latency[kind] : REAL(0.0);
            const real_t at = (real_t)m->tick + (((s->lag - age[kind]) - settling) / s->dt);

            if (!queue(m, s, kind, at, &z[STARTS[kind]])) {
                m->late[kind] += 1;
                /* One alone is no fault: jitter has a longer tail than the horizon waits for. */
                if (((real_t)(m->tick - m->used[kind]) * s->dt) > s->patience[kind]) {
                    flag(m, s, kind, FAULTY, LATE, age[kind]);
                }
            }
        }
    }
}

bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[VALUES],
                    int32_t fresh[SENSORS], const real_t age[SENSORS])
{
    real_t doubt;
    real_t rises;
    int32_t left;
    bool found;
    bool turns;
    bool seen;

    m->tick += 1;
    inspect(m, s, z, fresh, age);
    for (int32_t k = 0; k < 3; k++) {
        m->before[k] = m->rates[k];
        if (m->code[R_RATES] < MISSING) {
            m->rates[k] = z[STARTS[R_RATES] + k] - m->shift[k];
        } else if ((s->model > 0) && (m->mode >= LIGHT)) {
            /* What the model turns: the bar holds it to the rotors, so it does not drift but about the mast. */
            m->rates[k] =
                (m->before[k] + (s->dt * m->force[(m->tick - 1) % MODELLED][9 + k])) + m->turn_off[k];
        } else {
            m->rates[k] = m->out[10 + k];
        }
    }
    /* A floor below the room's, or a fix that is apart from the sonar: the height is off by as much. */
    doubt = m->suspect[R_FIX][3] - real_min(m->out[16], REAL(0.0));
    smooth_rates(m, s, (m->mode == FLYING) && (height_over(m->out, s) > (CLEAR + doubt)));
    rises = gather(m, s, p, z, fresh);
    if ((s->model > 0) && (m->mode >= RUNNING) && (m->code[R_ACCELERATION] < MISSING)) {
        watch_scatter(m, s, z);
    }
    let_wait(m, s, z, fresh, age);
    wander(m, s);
    left = s->work - (((m->tick % TOLD_EVERY) == 0) ? TELLING : 0);
    if ((rises > REAL(0.0)) && (m->sigma[THRUST_] > LIFTS_OFF)) {
        fuse_lift(m, rises);
        left -= 1;
    }
    while (left > 0) {
        const int32_t cost = task(m, s, left);

        left = (cost > 0) ? (left - cost) : 0;
    }
    tell(m, s);
    found = (s->fitted[R_FIX] == 0) || (m->aligned > 0);
    if ((m->lifted == 0) && found &&
        ((((real_t)m->standing * s->dt) >= ALIGNED_S) || (((real_t)m->tick * s->dt) > REAL(3.0)))) {
        m->lifted = 1;
    }
    turns = (s->model > 0) && (m->mode >= LIGHT);
    seen = (m->code[R_RATES] < MISSING) || turns || (((real_t)(m->tick - m->used[R_RATES]) * s->dt) < BLIND_S);
    for (int32_t k = 0; k < 3; k++) {
        /* Nonsense may have the model run away: what no gyroscope could say is no estimate. */
        if (!(real_abs(m->out_rates[k]) < (REAL(2.0) * s->bound[R_RATES]))) {
            seen = false;
        }
    }
    return (m->lifted > 0) && seen;
}
