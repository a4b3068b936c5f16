#include "estimate.h"

#include "factors.h"
#include "flight_model.h"
#include "fusing.h"
#include "guards.h"
#include "motion.h"

static void clear_top(real_t top[MOVING][ERRORS])
{
    for (int32_t i = 0; i < MOVING; i++) {
        for (int32_t j = 0; j < ERRORS; j++) {
            top[i][j] = (i == j) ? REAL(1.0) : REAL(0.0);
        }
    }
}

/* Begin a block. */
static void start_block(estimator_t *m)
{
    clear_top(m->top);
    for (int32_t j = 0; j < ERRORS; j++) {
        m->decay[j] = REAL(1.0);
        m->q[j] = REAL(0.0);
    }
    m->middle = 0;
}

void estimator_begin(estimator_t *m, const estimator_settings_t *s)
{
    uint8_t *bytes = (uint8_t *)m;

    for (uint32_t i = 0U; i < (uint32_t)sizeof(*m); i++) {
        bytes[i] = 0U;
    }
    for (int32_t i = 0; i < STATES; i++) {
        m->x[i] = s->start[i];
    }
    for (int32_t i = 0; i < ERRORS; i++) {
        m->d[i] = (s->sigma[i] * s->sigma[i]) + REAL(1e-12);
    }
    for (int32_t i = 0; i < WAITING; i++) {
        m->due[i] = -1;
    }
    start_block(m);
    m->out[6] = REAL(1.0);
    m->rotor[6] = REAL(1.0);
    m->rotor[20] = REAL(1.0);
    m->rotor[2] = REAL(-1000.0); /* far above the floor */
    m->rotor[17] = REAL(-1.0);
    for (int32_t k = 0; k < 3; k++) {
        m->scatter[k] = SCATTER;
    }
}

/* Let a measurement wait until the horizon has come to tick `due`; false if that is over, or no place is left. */
static bool queue(estimator_t *m, int32_t kind, int32_t due, real_t ahead, const real_t *z)
{
    bool waits = false;

    if (due > m->horizon) {
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

/* Whether it stands, flies or is about to: by what the rotors lift and how high it is. */
static void judge_mode(estimator_t *m, const estimator_settings_t *s, const real_t sent[4])
{
    const real_t lift =
        (s->model > 0) ? ((-m->force[cycle(m->tick, MODELLED)][2] * m->x[23]) / GRAVITY) : REAL(1.0);
    const real_t height = height_over(m->out, s);
    const bool off = (sent[0] + sent[1]) < REAL(0.02);

    if (m->mode <= RUNNING) {
        m->mode = (off && ((m->rotor[18] + m->rotor[19]) < (REAL(0.2) * (s->hover[0] + s->hover[1])))) ? STANDING
                                                                                                       : RUNNING;
        if ((lift > REAL(0.9)) && (m->mode == RUNNING)) {
            m->mode = LIGHT;
            m->lifted = m->tick;
        }
    } else if (m->mode == LIGHT) {
        if ((height > REAL(0.03)) || (lift > REAL(1.1))) {
            m->mode = FLYING;
        } else if ((lift < REAL(0.85)) && (height < REAL(0.02))) {
            m->mode = RUNNING;
        } else {
            /* still light */
        }
    } else if ((height < REAL(0.015)) && (lift < REAL(0.9))) {
        m->mode = LIGHT;
    } else {
        /* flies on */
    }
    if (off && (m->mode >= LIGHT) && (height < REAL(0.05)) && (m->rotor[18] < (REAL(0.3) * s->hover[0]))) {
        m->mode = RUNNING;
    }
}

/* The flight model's forces now, corrected by the rotor speeds and the voltage that are read. */
static void model_now(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                      const int32_t *fresh)
{
    model_force(m, s, p, m->row, m->force[cycle(m->tick, MODELLED)]);
    if (fresh[R_ROTOR] == 1) {
        const real_t *speed = &z[STARTS[R_ROTOR]];

        if (rotor_fits(m, s, speed)) {
            for (int32_t k = 0; k < 2; k++) {
                m->rotor[18 + k] += s->rotor_gain * (speed[k] - m->rotor[18 + k]);
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

/* What acted over the period that has just ended: a row of inputs. */
static void gather(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                   const int32_t *fresh)
{
    const int32_t now = cycle(m->tick, MODELLED);
    const int32_t a = cycle(now - s->lag_ticks, MODELLED);
    const int32_t b = cycle((now - s->lag_ticks) - 1, MODELLED);
    real_t *row = m->inputs[cycle(m->tick, KEPT)];
    real_t r[9];
    real_t n;
    real_t e;
    real_t d;

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
    judge_mode(m, s, &z[ACTING]);
    for (int32_t k = 0; k < 3; k++) {
        const real_t clip = (m->clipped[k] * REAL(0.5)) * s->felt_range;
        real_t felt =
            ((s->model > 0) ? real_max(s->felt_density, m->scatter[k]) : s->felt_density) + (clip * clip);
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
            made = (k < 2) ? REAL(0.05) : REAL(0.5);
        } else {
            /* flies */
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
        m->lever[k][2] = felt + made;
    }
    row[21] = (real_t)m->mode;
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

/* Bring the horizon a period on. */
static void advance(estimator_t *m, const estimator_settings_t *s)
{
    const real_t *e;
    real_t r[9];
    real_t a[6];
    real_t all;

    m->horizon += 1;
    e = m->inputs[cycle(m->horizon, KEPT)];
    advance_state(m->x, e, s->dt, r, a);
    advance_errors(m->top, e, s->dt, r, a);
    for (int32_t k = GYRO; k < ERRORS; k++) {
        m->x[k + 1] = s->start[k + 1] + ((m->x[k + 1] - s->start[k + 1]) * s->keep[k]);
        m->decay[k] *= s->keep[k];
        m->q[k] = ((m->q[k] * s->keep[k]) * s->keep[k]) + s->noise[k];
    }
    for (int32_t k = 0; k < 3; k++) {
        m->q[k] += s->noise[k];
        m->turning[k] += (s->dt / REAL(1.5)) * ((e[k] - m->x[10 + k]) - m->turning[k]);
        m->q[3 + k] += spread_along(r, k, e) * s->dt;
        m->felt[k] += e[3 + k];
        m->modelled[k] += a[3 + k];
        m->sum[k] += e[k];
        m->lever[k][0] += e[6 + k];
        m->lever[k][1] += e[12 + k];
    }
    all = ((m->turning[0] * m->turning[0]) + (m->turning[1] * m->turning[1])) + (m->turning[2] * m->turning[2]);
    for (int32_t k = 0; k < 3; k++) {
        real_t spread = s->gyro_density;

        for (int32_t i = 0; i < 3; i++) {
            const real_t own = m->turning[i] * m->turning[i];

            spread += (r[(3 * k) + i] * r[(3 * k) + i]) *
                      ((s->gyro_off[0] * (all - own)) + (s->gyro_off[1] * own));
        }
        m->q[6 + k] += spread * s->dt;
    }
    if ((m->edge > 0) || (real_abs(m->x[16]) > LOW)) {
        m->q[FLOOR] += (EDGE * EDGE) * s->dt;
    }
    m->felt_count += 1;
    m->middle += 1;
}

/* Bring the covariance to the horizon. */
static void settle(estimator_t *m, const estimator_settings_t *s)
{
    if (m->middle > 0) {
        factors_carry(m, (REAL(0.5) * (real_t)m->middle) * s->dt);
        start_block(m);
    }
}

static void fuse_one(estimator_t *m, const estimator_settings_t *s, int32_t i)
{
    const real_t *z = m->value[i];
    const real_t ahead = m->ahead[i];

    switch (m->what[i]) {
    case R_FIX:
        fuse_fix(m, s, z, ahead);
        break;
    case R_SONAR:
        fuse_sonar(m, s, z, ahead);
        break;
    case R_RING:
        fuse_ring(m, s, z);
        break;
    case R_PRESSURE:
        fuse_pressure(m, s, z, ahead);
        break;
    default:
        fuse_magnet(m, s, z);
        break;
    }
}

/* What accelerometers felt over a block, against what was to be expected. */
static void fuse_block(estimator_t *m, const estimator_settings_t *s)
{
    const real_t *e = m->inputs[cycle(m->horizon, KEPT)];
    const real_t n = (real_t)m->felt_count;
    const int32_t mode = (int32_t)e[21];

    for (int32_t k = 0; k < 3; k++) {
        /* Density of the whole difference at the horizon, from what was weighed there */
        const real_t share = real_max(e[15 + k], REAL(1e-9));

        m->felt[k] /= n;
        m->modelled[k] /= n;
        m->sum[k] /= n;
        m->lever[k][0] /= n;
        m->lever[k][1] /= n;
        m->lever[k][2] = (e[18 + k] / share) / real_max(REAL(1.0) - share, REAL(1e-9));
    }
    if (mode <= RUNNING) {
        fuse_rest(m, s, m->felt_count, mode == STANDING);
        if (mode == STANDING) {
            m->standing += m->felt_count;
        }
    } else if ((mode == FLYING) && (s->model > 0) && (s->fitted[R_ACCELERATION] > 0)) {
        fuse_force(m, s, m->felt_count);
    } else {
        /* light: neither stands nor flies */
    }
    if (mode > RUNNING) {
        fuse_floor(m, s);
    }
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

/* Take in what is due at the horizon. */
static void fuse(estimator_t *m, const estimator_settings_t *s)
{
    for (int32_t i = 0; i < WAITING; i++) {
        if (m->due[i] == m->horizon) {
            m->due[i] = -1;
            settle(m, s);
            fuse_one(m, s, i);
        }
    }
    if (m->edge > 0) {
        m->edge -= 1;
        if ((m->edge == 0) && (real_abs(m->x[16]) < LOW)) {
            settle(m, s);
            settle_floor(m);
        }
    }
    if (m->felt_count >= LONGEST) {
        settle(m, s);
        fuse_block(m, s);
    }
}

/* How much the accelerometers scatter about the model, mean over blocks. */
static void watch_scatter(estimator_t *m, const estimator_settings_t *s, const real_t z[3])
{
    const real_t *row = m->inputs[cycle(m->tick, KEPT)];

    m->blocks += 1;
    for (int32_t k = 0; k < 3; k++) {
        m->mean[k] += z[k] - ((m->x[23] * row[6 + k]) + row[9 + k]);
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

/* F P F^T + Q over the delay; noise of the velocity in m->row. */
static void tell_covariance(estimator_t *m, const estimator_settings_t *s)
{
    const real_t *x = m->out;
    const int32_t ticks = m->tick - m->horizon;
    const real_t span = (real_t)((ticks > 0) ? ticks : 0) * s->dt;
    const real_t sine =
        real_min(real_max(REAL(2.0) * ((x[6] * x[8]) - (x[9] * x[7])), REAL(-1.0)), REAL(1.0));
    const real_t cosine = real_max(real_sqrt(REAL(1.0) - (sine * sine)), REAL(0.05));
    real_t c;
    real_t t;

    factors_sigmas(m);
    for (int32_t k = 0; k < ERRORS; k++) {
        factors_times(m, m->top_out, k, m->w[k]);
    }
    for (int32_t i = 0; i < MOVING; i++) {
        for (int32_t j = i; j < MOVING; j++) {
            real_t v = REAL(0.0);

            for (int32_t k = 0; k < ERRORS; k++) {
                v += (m->d[k] * m->w[k][i]) * m->w[k][j];
            }
            if ((i == j) && (i >= TURN)) {
                v += s->gyro_density * span;
            } else if ((i == j) && (i >= V_)) {
                v += m->row[i - V_];
            } else if (i == j) {
                v += ((m->row[i] * span) * span) / REAL(3.0);
            } else if ((j == (i + 3)) && (i < 3)) {
                v += (m->row[i] * span) / REAL(2.0);
            } else {
                /* nothing on top */
            }
            m->out_cov[i][j] = v;
            m->out_cov[j][i] = v;
        }
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
    for (int32_t i = 0; i < 3; i++) {
        for (int32_t j = 0; j < 12; j++) {
            m->out_cov[9 + i][j] = REAL(0.0);
            m->out_cov[j][9 + i] = REAL(0.0);
        }
        m->out_cov[9 + i][9 + i] =
            (m->sigma[GYRO + i] * m->sigma[GYRO + i]) + (s->rest_gyro * s->rest_gyro);
    }
}

/* Carry the horizon's state on to now, through all inputs since; now and then its covariance too. */
static void tell(estimator_t *m, const estimator_settings_t *s)
{
    const bool much = (m->tick % TOLD_EVERY) == 0;
    real_t *x = m->out;
    real_t r[9] = {REAL(0.0)};
    real_t a[6] = {REAL(0.0)};

    for (int32_t i = 0; i < STATES; i++) {
        x[i] = m->x[i];
    }
    if (much) {
        settle(m, s);
        clear_top(m->top_out);
        for (int32_t i = 0; i < 6; i++) {
            m->row[i] = REAL(0.0);
        }
    }
    for (int32_t t = m->horizon + 1; t <= m->tick; t++) {
        const real_t *e = m->inputs[cycle(t, KEPT)];

        advance_state(x, e, s->dt, r, a);
        if (much) {
            advance_errors(m->top_out, e, s->dt, r, a);
            for (int32_t k = 0; k < 3; k++) {
                m->row[k] += spread_along(r, k, e) * s->dt;
            }
        }
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
    smooth(m, s);
    tell_angles(m);
    if (much) {
        tell_covariance(m, s);
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
            const int32_t due = real_whole(at + REAL(0.5));

            if (!queue(m, kind, due, (at - (real_t)due) * s->dt, &z[STARTS[kind]])) {
                m->late[kind] += 1;
                flag(m, s, kind, FAULTY, LATE, age[kind]);
            }
        }
    }
}

bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[VALUES],
                    int32_t fresh[SENSORS], const real_t age[SENSORS])
{
    real_t doubt;
    bool found;
    bool seen;

    m->tick += 1;
    inspect(m, s, z, fresh, age);
    for (int32_t k = 0; k < 3; k++) {
        m->before[k] = m->rates[k];
        m->rates[k] = z[STARTS[R_RATES] + k] - m->shift[k];
    }
    /* A floor below the room's, or a fix that is apart from the sonar: the height is off by as much. */
    doubt = m->suspect[R_FIX][3] - real_min(m->out[16], REAL(0.0));
    smooth_rates(m, s, (m->mode == FLYING) && (height_over(m->out, s) > (CLEAR + doubt)));
    gather(m, s, p, z, fresh);
    if ((s->model > 0) && ((m->mode == FLYING) || (m->mode == RUNNING)) && (m->code[R_ACCELERATION] < MISSING)) {
        watch_scatter(m, s, z);
    }
    let_wait(m, s, z, fresh, age);
    while (m->horizon < (m->tick - s->delay)) {
        advance(m, s);
        fuse(m, s);
        if (m->middle >= LONGEST) {
            settle(m, s);
        }
    }
    tell(m, s);
    found = (s->fitted[R_FIX] == 0) || (m->aligned > 0);
    if ((m->lifted == 0) && found &&
        ((((real_t)m->standing * s->dt) >= ALIGNED_S) || (((real_t)m->tick * s->dt) > REAL(3.0)))) {
        m->lifted = 1;
    }
    seen = (m->code[R_RATES] < MISSING) || (((real_t)(m->tick - m->used[R_RATES]) * s->dt) < BLIND_S);
    return (m->lifted > 0) && seen;
}
