#include "motion.h"

#include "flight_model.h"

void turn_matrix(const real_t q[4], real_t r[9])
{
    const real_t w = q[0];
    const real_t x = q[1];
    const real_t y = q[2];
    const real_t z = q[3];

    r[0] = REAL(1.0) - (REAL(2.0) * ((y * y) + (z * z)));
    r[1] = REAL(2.0) * ((x * y) - (w * z));
    r[2] = REAL(2.0) * ((x * z) + (w * y));
    r[3] = REAL(2.0) * ((x * y) + (w * z));
    r[4] = REAL(1.0) - (REAL(2.0) * ((x * x) + (z * z)));
    r[5] = REAL(2.0) * ((y * z) - (w * x));
    r[6] = REAL(2.0) * ((x * z) - (w * y));
    r[7] = REAL(2.0) * ((y * z) + (w * x));
    r[8] = REAL(1.0) - (REAL(2.0) * ((x * x) + (y * y)));
}

/* Half the turn's size in the quaternion: its real part, and the three others. */
typedef struct {
    real_t c;
    real_t a;
    real_t b;
    real_t d;
} small_turn_t;

static small_turn_t small_turn(real_t t_x, real_t t_y, real_t t_z)
{
    const real_t square = ((t_x * t_x) + (t_y * t_y)) + (t_z * t_z);
    small_turn_t by;
    real_t k = (REAL(0.5) - (square / REAL(48.0))) + ((square * square) / REAL(3840.0));

    by.c = (REAL(1.0) - (square / REAL(8.0))) + ((square * square) / REAL(384.0));
    if (square > REAL(1.0)) {
        const real_t angle = real_sqrt(square);

        sine_cosine(REAL(0.5) * angle, &k, &by.c);
        k = k / angle;
    }
    by.a = k * t_x;
    by.b = k * t_y;
    by.d = k * t_z;
    return by;
}

static void turn_by(real_t q[4], const small_turn_t *by, real_t s)
{
    const real_t w = q[0];
    const real_t x = q[1];
    const real_t y = q[2];
    const real_t z = q[3];
    const real_t n_w = (((w * by->c) - (x * by->a)) - (y * by->b)) - (z * by->d);
    const real_t n_x = ((x * by->c) + (w * by->a)) + (s * ((y * by->d) - (z * by->b)));
    const real_t n_y = ((y * by->c) + (w * by->b)) + (s * ((z * by->a) - (x * by->d)));
    const real_t n_z = ((z * by->c) + (w * by->d)) + (s * ((x * by->b) - (y * by->a)));
    const real_t size =
        REAL(1.0) / real_sqrt((((n_w * n_w) + (n_x * n_x)) + (n_y * n_y)) + (n_z * n_z));

    q[0] = n_w * size;
    q[1] = n_x * size;
    q[2] = n_y * size;
    q[3] = n_z * size;
}

void turned(real_t x[STATES], real_t t_x, real_t t_y, real_t t_z, bool own)
{
    const small_turn_t by = small_turn(t_x, t_y, t_z);

    turn_by(&x[6], &by, own ? REAL(1.0) : REAL(-1.0));
}

void advance_state(real_t x[STATES], const real_t e[INPUTS], real_t dt, real_t r[9], real_t a[6])
{
    const real_t t_x = dt * (e[0] - x[10]);
    const real_t t_y = dt * (e[1] - x[11]);
    const real_t t_z = dt * (e[2] - x[12]);
    const small_turn_t half = small_turn(REAL(0.5) * t_x, REAL(0.5) * t_y, REAL(0.5) * t_z);
    real_t n;
    real_t o;
    real_t d;
    real_t f[3];

    turn_by(&x[6], &half, REAL(1.0));
    turn_matrix(&x[6], r);
    turn_by(&x[6], &half, REAL(1.0));
    n = x[3] - x[21];
    o = x[4] - x[22];
    d = x[5];
    for (int32_t k = 0; k < 3; k++) {
        const real_t along = ((r[k] * n) + (r[3 + k] * o)) + (r[6 + k] * d);
        const real_t made = ((x[23] * e[6 + k]) + e[9 + k]) + (e[12 + k] * along);
        const real_t share = e[15 + k];

        a[3 + k] = made;
        f[k] = (share * (e[3 + k] - x[13 + k])) + ((REAL(1.0) - share) * made);
    }
    for (int32_t k = 0; k < 3; k++) {
        real_t gain;

        a[k] = ((r[3 * k] * f[0]) + (r[(3 * k) + 1] * f[1])) + (r[(3 * k) + 2] * f[2]);
        gain = a[k] + ((k == 2) ? GRAVITY : REAL(0.0));
        x[k] += dt * (x[3 + k] + ((REAL(0.5) * dt) * gain));
        x[3 + k] += dt * gain;
    }
}

void transition_of(const real_t e[INPUTS], real_t span, const real_t r[9], const real_t a[3],
                   real_t out[TRANSITION])
{
    const real_t rest[3] = {REAL(1.0) - e[15], REAL(1.0) - e[16], REAL(1.0) - e[17]};
    const real_t slope[3] = {rest[0] * e[12], rest[1] * e[13], rest[2] * e[14]};
    const bool stands = (int32_t)e[21] <= RUNNING;

    for (int32_t i = 0; i < 3; i++) {
        real_t thrust = REAL(0.0);

        for (int32_t j = 0; j < 3; j++) {
            const real_t own = span * r[(3 * i) + j];

            out[(3 * i) + j] = own;
            out[9 + (3 * i) + j] = -own * e[15 + j];
            thrust += own * (rest[j] * e[6 + j]);
        }
        out[27 + i] = thrust;
        out[30 + i] = stands ? REAL(0.0) : (span * a[i]); /* the floor pushes up however it is tilted */
    }
    for (int32_t i = 0; i < 3; i++) {
        for (int32_t j = i; j < 3; j++) {
            real_t drag = REAL(0.0);

            for (int32_t k = 0; k < 3; k++) {
                drag += (out[(3 * i) + k] * slope[k]) * r[(3 * j) + k];
            }
            out[18 + (3 * i) + j] = drag;
            out[18 + (3 * j) + i] = drag;
        }
    }
}

void model_force(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t air[3],
                 real_t out[12])
{
    real_t *x = m->rotor;
    static const real_t no_wind[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    real_t dx[MODEL_STATES];
    const real_t dt = s->dt;
    const real_t to_roll = p->swash_gain * real_min(real_max(m->acting[3], REAL(-1.0)), REAL(1.0));
    const real_t to_pitch = -p->swash_gain * real_min(real_max(m->acting[2], REAL(-1.0)), REAL(1.0));
    const real_t roll = x[13];
    const real_t pitch = x[14];
    const real_t bar[3] = {x[15], x[16], x[17]};
    swash_t swash;
    real_t up;
    real_t dw;
    real_t normal[3];
    real_t size;
    real_t still[3];
    real_t moving[3];

    /* The swash plate settles within the period: its mean counts. */
    x[13] = to_roll + ((roll - to_roll) * s->swash_mean);
    x[14] = to_pitch + ((pitch - to_pitch) * s->swash_mean);
    x[3] = REAL(0.0);
    x[4] = REAL(0.0);
    x[5] = REAL(0.0);
    sine_cosine(x[13], &swash.sin_a, &swash.cos_a);
    sine_cosine(x[14], &swash.sin_b, &swash.cos_b);
    flight_model(x, m->acting, no_wind, p, &swash, dx);
    up = dx[18];
    dw = dx[19];
    x[18] += (REAL(0.5) * dt) * up;
    x[19] += (REAL(0.5) * dt) * dw;
    /* The bar in axes that turn: less the turning of the fuselage. */
    normal[0] = bar[0] + (dt * (dx[15] - ((x[11] * bar[2]) - (x[12] * bar[1]))));
    normal[1] = bar[1] + (dt * (dx[16] - ((x[12] * bar[0]) - (x[10] * bar[2]))));
    normal[2] = bar[2] + (dt * (dx[17] - ((x[10] * bar[1]) - (x[11] * bar[0]))));
    size = REAL(1.0) /
           real_sqrt(((normal[0] * normal[0]) + (normal[1] * normal[1])) + (normal[2] * normal[2]));
    for (int32_t k = 0; k < 3; k++) {
        x[15 + k] = REAL(0.5) * (bar[k] + normal[k]);
    }
    flight_model(x, m->acting, no_wind, p, &swash, dx);
    still[0] = dx[3];
    still[1] = dx[4];
    still[2] = dx[5] - GRAVITY;
    for (int32_t k = 0; k < 3; k++) {
        out[k] = still[k];
        x[3 + k] = air[k];
    }
    flight_model(x, m->acting, no_wind, p, &swash, dx);
    for (int32_t k = 0; k < 3; k++) {
        out[9 + k] = dx[10 + k];
    }
    moving[0] = dx[3];
    moving[1] = dx[4];
    moving[2] = dx[5] - GRAVITY;
    for (int32_t k = 0; k < 3; k++) {
        x[3 + k] = air[k] + SLOPE_STEP;
    }
    flight_model(x, m->acting, no_wind, p, &swash, dx);
    out[6] = real_min((dx[3] - moving[0]) / SLOPE_STEP, REAL(0.0));
    out[7] = real_min((dx[4] - moving[1]) / SLOPE_STEP, REAL(0.0));
    out[8] = real_min(((dx[5] - GRAVITY) - moving[2]) / SLOPE_STEP, REAL(0.0));
    for (int32_t k = 0; k < 3; k++) {
        out[3 + k] = (moving[k] - still[k]) - (out[6 + k] * air[k]);
        x[15 + k] = normal[k] * size;
    }
    x[13] = to_roll + ((roll - to_roll) * s->swash_settled);
    x[14] = to_pitch + ((pitch - to_pitch) * s->swash_settled);
    x[18] = real_max(x[18] + ((REAL(0.5) * dt) * up), REAL(0.0));
    x[19] = real_max(x[19] + ((REAL(0.5) * dt) * dw), REAL(0.0));
    x[20] = real_min(real_max(x[20] + (dt * dx[20]), REAL(0.0)), REAL(1.0));
}
