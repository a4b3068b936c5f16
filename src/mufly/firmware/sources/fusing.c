#include "fusing.h"

#include "factors.h"
#include "guards.h"
#include "motion.h"

/* A measurement of h times a state; and of h times another. */
static void of_state(estimator_t *m, int32_t state, real_t h)
{
    m->terms = 1;
    m->at[0] = state;
    m->h[0] = h;
}

static void and_state(estimator_t *m, int32_t state, real_t h)
{
    m->at[m->terms] = state;
    m->h[m->terms] = h;
    m->terms += 1;
}

/* Move a state by errors that it had a span (s) ago, since when `push` has changed its velocity, but for gravity. */
static void move(real_t x[STATES], const real_t by[ERRORS], real_t span, const real_t push[3])
{
    real_t v[3] = {by[3], by[4], by[5]};

    if (span > REAL(0.0)) {
        v[0] += (by[7] * push[2]) - (by[8] * push[1]);
        v[1] += (by[8] * push[0]) - (by[6] * push[2]);
        v[2] += (by[6] * push[1]) - (by[7] * push[0]);
    }
    for (int32_t i = 0; i < 3; i++) {
        x[i] += by[i] + ((REAL(0.5) * span) * (by[3 + i] + v[i]));
        x[3 + i] += v[i];
    }
    turned(x, by[6], by[7], by[8], false);
    for (int32_t i = GYRO; i < ERRORS; i++) {
        x[i + 1] += by[i];
    }
}

/* Take a measurement in whose m->f is known from ratio_of; what the state is carried on to moves with it. */
static void take_expected(estimator_t *m, real_t innovation, real_t variance)
{
    factors_observe(m, variance);
    for (int32_t i = 0; i < ERRORS; i++) {
        m->gain[i] *= innovation;
    }
    move(m->x, m->gain, REAL(0.0), &m->way_sum[3]);
    move(m->way, m->gain, m->way_span, &m->way_sum[3]);
    move(m->come, m->gain, m->span, &m->come_sum[3]);
}

/* Take a measurement in, whatever it says; its row is in m->h. */
static void take(estimator_t *m, real_t innovation, real_t variance)
{
    (void)factors_expected(m);
    take_expected(m, innovation, variance);
}

/* Innovation over what is expected of it. */
static real_t ratio_of(estimator_t *m, real_t innovation, real_t variance)
{
    return innovation / real_sqrt(factors_expected(m) + variance);
}

static void note(estimator_t *m, int32_t k, real_t innovation, real_t ratio)
{
    m->innovation[k] = innovation;
    m->spread[k] = (ratio != REAL(0.0)) ? real_abs(innovation / ratio) : REAL(0.0);
}

/* Note that a reading does not fit; that it says nearly what the one before said is counted in m->agree. */
static void turn_away(estimator_t *m, const estimator_settings_t *s, int32_t k, real_t innovation, const real_t *z,
                      int32_t count, real_t near)
{
    bool alike = m->rejected[k] > 0;

    for (int32_t j = 0; j < count; j++) {
        alike = alike && (real_abs(z[j] - m->suspect[k][j]) < near);
        m->suspect[k][j] = z[j];
    }
    if (alike) {
        m->agree[k] += 1;
    } else {
        m->agree[k] = 0;
        m->since[k] = m->horizon;
    }
    if ((k != R_SONAR) && (real_abs(innovation) > ((REAL(2.0) * GATE) * m->spread[k]))) {
        m->doubt[k] += REAL(1.0); /* by so much nothing healthy is off, but for a sonar that hears a second surface */
    }
    misfits(m, s, k, OFF, innovation);
}

/* Whether a reading that does not fit has agreed with itself for long enough. */
static bool taken_over(const estimator_t *m, const estimator_settings_t *s, int32_t k)
{
    return (m->agree[k] >= 3) && (((real_t)(m->horizon - m->since[k]) * s->dt) >= AGREE_S);
}

static void fix_row(estimator_t *m, int32_t i)
{
    if (i < 3) {
        of_state(m, P_ + i, REAL(1.0));
        and_state(m, FIX + i, REAL(1.0));
    } else {
        of_state(m, TURN + 2, REAL(1.0));
        and_state(m, HEADING, REAL(1.0));
    }
}

static real_t fix_innovation(const estimator_t *m, const real_t z[4], int32_t i, real_t ahead)
{
    const real_t *x = m->x;
    real_t off;

    if (i < 3) {
        off = ((z[i] - x[i]) - (ahead * x[3 + i])) - x[17 + i];
    } else {
        const real_t yaw = real_atan2(REAL(2.0) * ((x[6] * x[9]) + (x[7] * x[8])),
                                       REAL(1.0) - (REAL(2.0) * ((x[8] * x[8]) + (x[9] * x[9]))));

        off = real_wrapped(((z[3] - yaw) - (ahead * m->spin)) - x[20]);
    }
    return off;
}

static real_t fix_variance(const estimator_settings_t *s, int32_t i)
{
    return (i < 3) ? s->fix_variance : s->heading_variance;
}

real_t height_over(const real_t x[STATES], const estimator_settings_t *s)
{
    return (-x[2] - real_max(x[16], REAL(0.0))) - s->stands;
}

/* What a component of the fix is believed to be off by, over the most that its model allows. */
static real_t out_of_range(const estimator_t *m, const estimator_settings_t *s, int32_t i)
{
    const real_t sigma = s->sigma[FIX + i];

    return real_abs(m->x[17 + i]) / (RANGE * real_sqrt((sigma * sigma) + fix_variance(s, i)));
}

/* Whether the sonar tells the height, over a floor that is known. */
static bool sonar_holds(const estimator_t *m, const estimator_settings_t *s)
{
    const int32_t k = R_SONAR;
    const bool fresh = (m->used[k] > 0) && (((real_t)(m->tick - m->used[k]) * s->dt) < REAL(0.3));

    return fresh && (m->code[k] == FUSED) && (m->why[k] == FINE) && !(m->edge > REAL(0.0));
}

/* Whether fix and sonar agree on the height; if not, what they are apart by is kept in m->suspect[R_FIX][3]. */
static bool agrees_down(estimator_t *m, const estimator_settings_t *s, real_t nu, real_t ratio)
{
    const int32_t k = R_FIX;
    const real_t apart = real_abs(nu + m->x[19]);
    const real_t off = real_abs(ratio);

    if (m->suspect[k][3] > REAL(0.0)) {
        const bool blind = ((real_t)(m->tick - m->used[R_SONAR]) * s->dt) > REAL(0.3);

        m->suspect[k][3] = (blind || (off < REAL(2.5))) ? REAL(0.0) : apart;
    } else if (sonar_holds(m, s) &&
               ((out_of_range(m, s, 2) > REAL(1.0)) || ((off > GATE) && taken_over(m, s, k)))) {
        m->suspect[k][3] = apart;
    } else {
        /* they agree */
    }
    return !(m->suspect[k][3] != REAL(0.0));
}

/* The fix is believed anew; what other sensors hold is not given up: the fix is off there. */
static void loosen_for_fix(estimator_t *m, const real_t z[4], real_t ahead)
{
    const bool height_held = m->code[R_SONAR] == FUSED;
    const bool place_held = m->code[R_RING] == FUSED;
    real_t nu;

    for (int32_t i = 0; i < 3; i++) {
        nu = fix_innovation(m, z, i, ahead);
        if ((i == 2) ? height_held : place_held) {
            factors_loosen(m, FIX + i, nu * nu);
        } else {
            factors_loosen(m, P_ + i, nu * nu);
            factors_loosen(m, V_ + i, REAL(0.01) + ((REAL(0.1) * nu) * nu));
        }
    }
    nu = fix_innovation(m, z, 3, ahead);
    factors_loosen(m, TURN + 2, nu * nu);
}

void fuse_fix(estimator_t *m, const estimator_settings_t *s, const real_t z[4], real_t ahead)
{
    const int32_t k = R_FIX;
    bool down = true;
    real_t worst = REAL(0.0);
    real_t at = REAL(0.0);
    real_t out;
    bool led;

    for (int32_t i = 0; i < 4; i++) {
        real_t nu;
        real_t ratio;

        fix_row(m, i);
        nu = fix_innovation(m, z, i, ahead);
        ratio = ratio_of(m, nu, fix_variance(s, i));
        if (i == 2) {
            down = agrees_down(m, s, nu, ratio);
        }
        if (((i != 2) || down) && (real_abs(ratio) > real_abs(worst))) {
            worst = ratio;
            at = nu;
        }
    }
    note(m, k, at, worst);
    /* Off by more and more, it is not a fix that jumps: the filter is led away. */
    led = (s->model > 0) && (m->strain > LED_AWAY) && (real_abs(worst) > GATE) &&
          (real_abs(worst) < (REAL(2.0) * GATE));
    if ((real_abs(worst) > GATE) && !led) {
        turn_away(m, s, k, at, z, 3,
                  ((REAL(2.0) * s->period[k]) + (REAL(8.0) * real_sqrt(s->fix_variance))) + REAL(0.05));
        if (!taken_over(m, s, k)) {
            return;
        }
        loosen_for_fix(m, z, ahead);
        flag(m, s, k, REJECTED, TAKEN_OVER, at);
    }
    /* Off by much again and again: something carries the filter astray that it does not know. */
    m->strain += REAL(0.15) * ((worst * worst) - m->strain);
    out = real_max(real_max(out_of_range(m, s, 0), out_of_range(m, s, 1)), out_of_range(m, s, 3));
    if (led || (m->strain > STRAIN) || (out > REAL(1.0))) {
        go_astray(m, s);
        flag(m, s, k, FUSED, STRAINED, at);
    }
    for (int32_t i = 0; i < 4; i++) {
        if ((i != 2) || down) {
            fix_row(m, i);
            take(m, fix_innovation(m, z, i, ahead), fix_variance(s, i));
        }
    }
    for (int32_t i = 0; i < 3; i++) {
        const real_t most = (GYRO_RANGE * s->sigma[GYRO + i]) + (REAL(2.0) * m->sigma[GYRO + i]);

        if ((real_abs(m->x[10 + i]) > most) && (m->code[R_RATES] == FUSED)) {
            flag(m, s, R_RATES, REJECTED, WANDERS, m->x[10 + i]);
        }
    }
    fits(m, k);
    if (!down) {
        flag(m, s, k, FAULTY, AWAY, m->suspect[k][3]);
    }
    m->aligned = 1;
}

static real_t sonar_row(estimator_t *m, const estimator_settings_t *s, real_t r[9])
{
    const real_t *at = s->sonar_place;
    real_t n;
    real_t e;

    turn_matrix(&m->x[6], r);
    of_state(m, P_ + 2, REAL(-1.0));
    and_state(m, FLOOR, REAL(-1.0));
    /* (exp(t) R r)_D = (R r)_D + t_N (R r)_E - t_E (R r)_N */
    n = ((r[0] * at[0]) + (r[1] * at[1])) + (r[2] * at[2]);
    e = ((r[3] * at[0]) + (r[4] * at[1])) + (r[5] * at[2]);
    and_state(m, TURN, -e);
    and_state(m, TURN + 1, n);
    return ((r[6] * at[0]) + (r[7] * at[1])) + (r[8] * at[2]);
}

/* The height is led away by nu, and if again within a while by a force that is not as it is believed. */
static void led_away(estimator_t *m, const estimator_settings_t *s, real_t nu)
{
    const real_t before = m->suspect[R_SONAR][3];

    factors_loosen(m, P_ + 2, nu * nu); /* the foot of a wall in the cone may have been taken for the floor */
    m->suspect[R_SONAR][3] = (real_t)m->horizon;
    if (!((before > REAL(0.0)) && ((((real_t)m->horizon - before) * s->dt) < LED_S))) {
        return;
    }
    factors_loosen(m, V_ + 2, LED_SPEED * LED_SPEED);
    factors_loosen(m, ACCEL + 2, LED_FORCE * LED_FORCE);
    factors_loosen(m, THRUST_, LED_THRUST * LED_THRUST);
}

/* A sonar that does not fit: the floor has a step, or the height is wrong. Whether it is taken in after all. */
static bool sonar_anew(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t nu)
{
    const int32_t k = R_SONAR;
    bool taken = true;
    real_t floor_height;
    bool step;

    turn_away(m, s, k, nu, z, 1, REAL(0.02) + (REAL(1.5) * s->period[k]));
    floor_height = m->x[16] - nu;
    step = (m->agree[k] >= 2) && (floor_height > LEAST_FLOOR);
    if (step && (m->steps >= MOST_STEPS)) {
        /* Step after step: it is not the floor that goes, it is the height. */
        factors_loosen(m, P_ + 2, nu * nu);
        factors_loosen(m, V_ + 2, REAL(0.1));
        factors_loosen(m, THRUST_, REAL(0.01));
        flag(m, s, k, REJECTED, TAKEN_OVER, nu);
    } else if (step && (nu > REAL(0.0))) {
        led_away(m, s, nu); /* lower than the floor nothing lies; over an edge it was the surface that jumped */
        flag(m, s, k, FUSED, SLOPE, nu);
    } else if (step) {
        factors_loosen(m, FLOOR, nu * nu);
        m->doubt[k] = REAL(0.0);
        flag(m, s, k, FUSED, STEP, floor_height);
        m->edge = REAL(1.0);
    } else if (taken_over(m, s, k)) {
        if ((((real_t)(m->tick - m->used[R_FIX]) * s->dt) < AGREE_S) && (m->used[R_FIX] > 0)) {
            factors_loosen(m, FLOOR, nu * nu); /* the fix holds the height */
        } else {
            factors_loosen(m, P_ + 2, nu * nu);
            factors_loosen(m, V_ + 2, REAL(0.1) + (nu * nu));
        }
        flag(m, s, k, REJECTED, TAKEN_OVER, nu);
    } else {
        if (m->agree[k] >= 2) {
            flag(m, s, k, REJECTED, OFF, nu); /* below the room's floor, and not by chance */
        }
        taken = false;
    }
    return taken;
}

/* Whether the sonar repeats itself for longer than its noise and the vehicle's moving allow. */
static bool repeats(estimator_t *m, const estimator_settings_t *s, real_t z, real_t nu)
{
    real_t *kept = m->suspect[R_SONAR];
    const bool same = (z <= kept[1]) && (z >= kept[1]);

    kept[1] = z;
    if ((!same) || (height_over(m->x, s) < CLEAR)) {
        kept[2] = REAL(1.0);
    } else {
        /* A height that is hardly known has no part in it: it may be better than believed. */
        const real_t sigma = REAL(1.3) * real_sqrt(s->sonar_variance);
        const real_t likely = ((REAL(0.399) * s->sonar_step) / sigma) /
                              (REAL(1.0) + (REAL(0.5) * real_min((nu * nu) / (sigma * sigma), REAL(9.0))));

        kept[2] *= real_min(likely, REAL(1.0));
    }
    return (kept[2] < STUCK) && same;
}

void fuse_sonar(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead)
{
    const int32_t k = R_SONAR;
    real_t r[9];
    const real_t down = sonar_row(m, s, r);
    const real_t nearest = s->sonar_min + REAL(0.005);
    const real_t standing = s->stands - s->sonar_place[2];
    real_t said = z[0];
    real_t variance = s->sonar_variance;
    real_t expect;
    real_t nu;
    real_t ratio;
    bool over;

    if ((r[8] < s->sonar_cone) || (z[0] >= s->sonar_max)) {
        return;
    }
    expect = (-(m->x[2] + (ahead * m->x[5])) - down) - m->x[16];
    if ((z[0] <= nearest) && (standing < nearest)) {
        /* Nearer than it can tell: anywhere between there and where it stands. */
        said = REAL(0.5) * (nearest + standing);
        variance = ((nearest - standing) * (nearest - standing)) / REAL(12.0);
        if (expect < nearest) {
            take(m, said - expect, REAL(100.0) * variance); /* as so many that are off alike */
            fits(m, k);
            return;
        }
    }
    nu = said - expect;
    ratio = ratio_of(m, nu, variance);
    note(m, k, nu, ratio);
    if (repeats(m, s, z[0], nu)) {
        flag(m, s, k, FAULTY, STUCK_, z[0]);
        return;
    }
    over = (m->edge > REAL(0.0)) || (real_abs(m->x[16]) > LOW);
    /* Always off to the same side: over an edge it is the surface. Tops are flat, so else it is the height. */
    if (real_abs(ratio) < GATE) {
        m->lean += REAL(0.2) * (ratio - m->lean);
    }
    if (real_abs(m->lean) > LEAN) {
        m->lean = REAL(0.0);
        flag(m, s, k, FUSED, SLOPE, nu);
        if (over || (nu < REAL(0.0))) {
            m->edge = REAL(1.0);
        } else {
            led_away(m, s, nu);
            (void)sonar_row(m, s, r);
        }
    }
    if (over && (real_abs(ratio) > SUDDEN) && (m->steps < MOST_STEPS) && ((m->x[16] - nu) > LEAST_FLOOR)) {
        /* Over an object it is the surface that jumps. */
        m->steps += 1;
        m->edge = REAL(1.0);
        factors_loosen(m, FLOOR, nu * nu);
        (void)sonar_row(m, s, r);
    } else if (real_abs(ratio) > GATE) {
        if (!sonar_anew(m, s, z, nu)) {
            return;
        }
        (void)sonar_row(m, s, r);
    } else {
        /* as expected */
    }
    take(m, nu, variance);
    fits(m, k);
}

void settle_floor(estimator_t *m)
{
    of_state(m, FLOOR, REAL(1.0));
    take(m, -m->x[16], REAL(2.5e-5));
}

void fuse_lift(estimator_t *m, real_t lift)
{
    const real_t scale = LIFTS / lift;
    const real_t spread = LIFTS_OFF * scale;

    of_state(m, THRUST_, REAL(1.0));
    take(m, scale - m->x[23], spread * spread);
}

bool fuse_floor(estimator_t *m, const estimator_settings_t *s)
{
    const real_t height = height_over(m->x, s);
    const bool below = height < REAL(0.0);

    if (below) {
        of_state(m, P_ + 2, REAL(-1.0));
        if (m->x[16] > REAL(0.0)) {
            and_state(m, FLOOR, REAL(-1.0));
        }
        take(m, -height, REAL(2.5e-5));
        if (m->x[5] > REAL(0.0)) {
            of_state(m, V_ + 2, REAL(1.0));
            take(m, -m->x[5], REAL(1e-3));
        }
    }
    return below;
}

/* The wall of the room that a beam along u meets first: its distance; the axis is -1 if there is none. */
static real_t nearest_wall(const estimator_t *m, const estimator_settings_t *s, real_t ahead, const real_t u[3],
                           int32_t *axis)
{
    real_t best = REAL(1e9);

    *axis = -1;
    for (int32_t i = 0; i < 3; i++) {
        if (real_abs(u[i]) > REAL(0.3)) {
            const real_t plane = (u[i] > REAL(0.0)) ? s->walls[(2 * i) + 1] : s->walls[2 * i];
            const real_t far = (plane - (m->x[i] + (ahead * m->x[3 + i]))) / u[i];

            if ((far > REAL(0.0)) && (far < best)) {
                best = far;
                *axis = i;
            }
        }
    }
    return best;
}

bool fuse_ring(estimator_t *m, const estimator_settings_t *s, const real_t z[BEAMS], real_t ahead, int32_t most)
{
    const int32_t k = R_RING;
    const int32_t last_beam = ((m->beam + most) < s->beams) ? (m->beam + most) : s->beams;
    const bool all = last_beam >= s->beams;
    real_t r[9];

    turn_matrix(&m->x[6], r);
    if (m->beam == 0) {
        m->seen = 0;
        m->fitting = 0;
        /* no number of readings tells more than `told_most`: of that a picture brings what has been lost since */
        for (int32_t i = 0; i < 2; i++) {
            const real_t told = m->told_most[i] * factors_variance(m, P_ + i);

            m->told_share[i] = (told > REAL(1.0)) ? (REAL(1.0) - (REAL(1.0) / told)) : REAL(0.0);
            m->told_most[i] = REAL(0.0);
        }
    }
    for (int32_t b = m->beam; b < last_beam; b++) {
        const real_t *beam = s->beam[b];
        real_t u[3];
        int32_t axis;
        real_t best;

        if (!((z[b] > REAL(0.0)) && (z[b] < (REAL(0.995) * s->ring_max)))) {
            continue;
        }
        m->seen += 1;
        for (int32_t i = 0; i < 3; i++) {
            u[i] = ((r[3 * i] * beam[0]) + (r[(3 * i) + 1] * beam[1])) + (r[(3 * i) + 2] * beam[2]);
        }
        best = nearest_wall(m, s, ahead, u, &axis);
        if ((axis >= 0) && (axis != 2) && !(best > (REAL(1.1) * s->ring_max))) {
            /* l = (c - p_i) / u_i; of the heading they tell nothing, it is one more constant: du = t x u */
            const real_t h = REAL(-1.0) / u[axis];
            const real_t across = ((h * best) * ((axis == 0) ? u[1] : u[0])) * m->sigma[TURN + 2];
            const real_t slope = (best * best) + (s->ring_baseline * s->ring_baseline);
            const real_t lasts = ((slope * slope) * s->ring_lasts) + (across * across);
            const real_t away = (slope * best) * best;
            const real_t scatters = away * (away * s->ring_scatters);
            const real_t nu = z[b] - best;
            real_t ratio;

            of_state(m, P_ + axis, h);
            ratio = ratio_of(m, nu, scatters + lasts);
            if (real_abs(ratio) < BEAM_GATE) {
                note(m, k, nu, ratio);
                m->fitting += 1;
                m->told_most[axis] += (h * h) / lasts;
                if (m->told_share[axis] > REAL(0.0)) {
                    take_expected(m, nu, scatters + (lasts / m->told_share[axis]));
                    turn_matrix(&m->x[6], r);
                }
            }
        }
    }
    m->beam = all ? 0 : last_beam;
    if (!all) {
        /* the other beams come */
    } else if (m->fitting > 0) {
        fits(m, k);
    } else if (m->tick >= m->until[k]) {
        m->code[k] = NOTHING;
        m->why[k] = (m->seen == 0) ? TOO_FAR : NO_WALL;
    } else {
        /* told of for a while yet */
    }
    return all;
}

/* A reading of one number that drifts: after a second its bias is loosened. Whether it is taken in. */
static bool drifts(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t bias, real_t nu, real_t ratio,
                   const real_t *z, int32_t count, real_t near)
{
    bool taken = true;

    note(m, k, nu, ratio);
    if (real_abs(ratio) > GATE) {
        turn_away(m, s, k, nu, z, count, near);
        taken = taken_over(m, s, k);
        if (taken) {
            factors_loosen(m, bias, nu * nu);
            flag(m, s, k, REJECTED, TAKEN_OVER, nu);
        }
    }
    return taken;
}

void fuse_pressure(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead)
{
    const int32_t k = R_PRESSURE;
    real_t nu;
    real_t ratio;

    of_state(m, P_ + 2, s->pressure_slope);
    and_state(m, PRESSURE_, REAL(1.0));
    nu = (z[0] - (s->pressure_slope * (m->x[2] + (ahead * m->x[5])))) - m->x[24];
    ratio = ratio_of(m, nu, s->pressure_variance);
    if (drifts(m, s, k, PRESSURE_, nu, ratio, z, 1, REAL(10.0) * real_sqrt(s->pressure_variance))) {
        take(m, nu, s->pressure_variance);
        fits(m, k);
    }
}

void fuse_magnet(estimator_t *m, const estimator_settings_t *s, const real_t z[3], real_t ahead)
{
    const int32_t k = R_MAGNET;
    real_t r[9];
    real_t north;
    real_t east;
    real_t nu;
    real_t ratio;

    turn_matrix(&m->x[6], r);
    north = ((r[0] * z[0]) + (r[1] * z[1])) + (r[2] * z[2]);
    east = ((r[3] * z[0]) + (r[4] * z[1])) + (r[5] * z[2]);
    of_state(m, TURN + 2, REAL(1.0));
    and_state(m, TURN, -s->earth[2] / s->earth[0]);
    and_state(m, MAGNET_, REAL(1.0));
    nu = real_wrapped((-real_atan2(east, north) - (ahead * m->spin)) - m->x[25]);
    ratio = ratio_of(m, nu, s->magnet_variance);
    if (drifts(m, s, k, MAGNET_, nu, ratio, z, 3, REAL(1e-5))) {
        take(m, nu, s->magnet_variance);
        fits(m, k);
    }
}

void fuse_force(estimator_t *m, const estimator_settings_t *s, int32_t count, int32_t i)
{
    const real_t slope = m->lever[i][1];
    const real_t nu = (m->felt[i] - m->modelled[i]) - m->x[13 + i];
    const real_t variance = m->lever[i][2] / ((real_t)count * s->dt);
    real_t r[9];
    real_t known;
    real_t ratio;

    turn_matrix(&m->x[6], r);
    of_state(m, ACCEL + i, REAL(1.0));
    and_state(m, THRUST_, m->lever[i][0]);
    for (int32_t j = 0; j < 3; j++) {
        and_state(m, V_ + j, slope * r[(3 * j) + i]);
    }
    and_state(m, WIND, -slope * r[i]);
    and_state(m, WIND + 1, -slope * r[3 + i]);
    known = factors_expected(m);
    ratio = nu / real_sqrt(known + variance);
    felt_fits(m, s, nu, variance, known, i);
    if ((real_abs(ratio) < GATE) && (m->disowned == 0)) {
        take_expected(m, nu, variance);
    }
    if ((i == 0) || (real_abs(ratio) > m->lever[0][3])) {
        note(m, R_ACCELERATION, nu, ratio);
        m->lever[0][3] = real_abs(ratio);
    }
}

void fuse_rest(estimator_t *m, const estimator_settings_t *s, int32_t count, bool still, int32_t i)
{
    const real_t calm = still ? ((s->rest_gyro * s->rest_gyro) / (real_t)count) : REAL(2.5e-5);
    real_t off;

    of_state(m, V_ + i, REAL(1.0));
    take(m, -m->x[3 + i], REAL(4e-4));
    off = m->sum[i] - m->x[10 + i];
    of_state(m, GYRO + i, REAL(1.0));
    /* With its rotors running it may slide and turn on its legs. */
    if (still || (real_abs(ratio_of(m, off, calm * REAL(2.0))) < GATE)) {
        take(m, off, calm * REAL(2.0));
    }
    if (still && (s->fitted[R_ACCELERATION] > 0)) {
        const real_t variance = ((REAL(2.0) * s->rest_felt) * s->rest_felt) / (real_t)count;
        real_t r[9];
        real_t nu;

        turn_matrix(&m->x[6], r);
        nu = (m->felt[i] + (GRAVITY * r[6 + i])) - m->x[13 + i];
        of_state(m, ACCEL + i, REAL(1.0));
        /* R^T (-g e_D), and d(R^T u) = R^T (u x t) */
        and_state(m, TURN, -r[3 + i] * GRAVITY);
        and_state(m, TURN + 1, r[i] * GRAVITY);
        if (real_abs(ratio_of(m, nu, variance)) < (REAL(2.0) * GATE)) {
            take_expected(m, nu, variance);
        }
    }
}
