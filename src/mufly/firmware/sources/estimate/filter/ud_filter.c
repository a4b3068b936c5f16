#include "estimate/filter/ud_filter.h"

/* Python processes single columns. Here groups of columns share registers: the same operations on each number, with a
 * third fewer instructions. */
#define COLUMN_GROUP 5
#if (ERROR_STATE_COUNT % COLUMN_GROUP) != 0
#error "columns go together in fives"
#endif

real_t innovation_variance(estimator_t *m)
{
    real_t spread = REAL(0.0);

    for (int32_t j = 0; j < ERROR_STATE_COUNT; j += COLUMN_GROUP) {
        real_t(*const u)[ERROR_STATE_COUNT] = &m->u_transposed[j];
        real_t s0 = REAL(0.0);
        real_t s1 = REAL(0.0);
        real_t s2 = REAL(0.0);
        real_t s3 = REAL(0.0);
        real_t s4 = REAL(0.0);

        for (int32_t t = 0; t < m->h_term_count; t++) {
            const real_t h = m->h_value[t];
            const int32_t i = m->h_state_index[t];

            s0 += h * u[0][i];
            s1 += h * u[1][i];
            s2 += h * u[2][i];
            s3 += h * u[3][i];
            s4 += h * u[4][i];
        }
        m->u_transposed_h[j] = s0;
        m->u_transposed_h[j + 1] = s1;
        m->u_transposed_h[j + 2] = s2;
        m->u_transposed_h[j + 3] = s3;
        m->u_transposed_h[j + 4] = s4;
    }
    for (int32_t j = 0; j < ERROR_STATE_COUNT; j++) {
        spread += (m->ud_diagonal[j] * m->u_transposed_h[j]) * m->u_transposed_h[j];
    }
    return spread;
}

/* One entry of U and gain. */
static inline real_t update_gain(real_t *of_u, real_t gain, real_t step, real_t v)
{
    const real_t u = *of_u;

    *of_u = u + (step * gain);
    return gain + (u * v);
}

/* Pass the gain through all columns. */
static void update_columns(estimator_t *m, const real_t step[ERROR_STATE_COUNT], const real_t v[ERROR_STATE_COUNT])
{
    for (int32_t i = 0; i < ERROR_STATE_COUNT; i += COLUMN_GROUP) {
        real_t g0 = v[i];
        real_t g1 = v[i + 1];
        real_t g2 = v[i + 2];
        real_t g3 = v[i + 3];
        real_t g4 = v[i + 4];

        g0 = update_gain(&m->u_transposed[i + 1][i], g0, step[i + 1], v[i + 1]);
        g0 = update_gain(&m->u_transposed[i + 2][i], g0, step[i + 2], v[i + 2]);
        g1 = update_gain(&m->u_transposed[i + 2][i + 1], g1, step[i + 2], v[i + 2]);
        g0 = update_gain(&m->u_transposed[i + 3][i], g0, step[i + 3], v[i + 3]);
        g1 = update_gain(&m->u_transposed[i + 3][i + 1], g1, step[i + 3], v[i + 3]);
        g2 = update_gain(&m->u_transposed[i + 3][i + 2], g2, step[i + 3], v[i + 3]);
        g0 = update_gain(&m->u_transposed[i + 4][i], g0, step[i + 4], v[i + 4]);
        g1 = update_gain(&m->u_transposed[i + 4][i + 1], g1, step[i + 4], v[i + 4]);
        g2 = update_gain(&m->u_transposed[i + 4][i + 2], g2, step[i + 4], v[i + 4]);
        g3 = update_gain(&m->u_transposed[i + 4][i + 3], g3, step[i + 4], v[i + 4]);
        for (int32_t j = i + COLUMN_GROUP; j < ERROR_STATE_COUNT; j++) {
            real_t *u = &m->u_transposed[j][i];

            g0 = update_gain(&u[0], g0, step[j], v[j]);
            g1 = update_gain(&u[1], g1, step[j], v[j]);
            g2 = update_gain(&u[2], g2, step[j], v[j]);
            g3 = update_gain(&u[3], g3, step[j], v[j]);
            g4 = update_gain(&u[4], g4, step[j], v[j]);
        }
        m->gain[i] = g0;
        m->gain[i + 1] = g1;
        m->gain[i + 2] = g2;
        m->gain[i + 3] = g3;
        m->gain[i + 4] = g4;
    }
}

void ud_measurement_update(estimator_t *m, real_t variance)
{
    real_t step[ERROR_STATE_COUNT];
    real_t v[ERROR_STATE_COUNT];
    real_t a = variance;

    for (int32_t j = 0; j < ERROR_STATE_COUNT; j++) {
        const real_t before = a;

        v[j] = m->ud_diagonal[j] * m->u_transposed_h[j];
        a = before + (m->u_transposed_h[j] * v[j]);
        m->ud_diagonal[j] *= before / a;
        step[j] = -m->u_transposed_h[j] / before;
    }
    update_columns(m, step, v);
    for (int32_t j = 0; j < ERROR_STATE_COUNT; j++) {
        m->gain[j] /= a;
    }
}

/* Add to the variance of column k; return the share of the rest of v that its entries take. */
static real_t update_diagonal(estimator_t *m, int32_t k, real_t *c)
{
    const real_t v = m->u_transposed_h[k];
    const real_t old = m->ud_diagonal[k];
    const real_t fresh = old + ((*c * v) * v);
    real_t share = REAL(0.0);

    if (!(fresh <= MIN_UD_DIAGONAL)) {
        share = (*c * v) / fresh;
        *c *= old / fresh;
        m->ud_diagonal[k] = fresh;
    } else {
        m->u_transposed_h[k] = REAL(0.0); /* no variance, no contribution */
    }
    return share;
}

/* One entry of U; return the rest of v. */
static inline real_t update_entry(real_t *of_u, real_t v, real_t by, real_t share)
{
    const real_t u = *of_u;
    const real_t rest = v - (by * u);

    *of_u = u + (share * rest);
    return rest;
}

/* Add c v v^T to P, v zero behind last (Agee and Turner 1972); v is overwritten. */
static void rank_one_update(estimator_t *m, int32_t last, real_t much)
{
    real_t *v = m->u_transposed_h;
    real_t c = much;
    int32_t k = last;

    for (; k > 2; k -= 4) {
        real_t *u0 = m->u_transposed[k];
        real_t *u1 = m->u_transposed[k - 1];
        real_t *u2 = m->u_transposed[k - 2];
        real_t *u3 = m->u_transposed[k - 3];
        const real_t share0 = update_diagonal(m, k, &c);
        const real_t by0 = v[k];
        real_t share1;
        real_t by1;
        real_t share2;
        real_t by2;
        real_t share3;
        real_t by3;

        v[k - 1] = update_entry(&u0[k - 1], v[k - 1], by0, share0);
        share1 = update_diagonal(m, k - 1, &c);
        by1 = v[k - 1];
        v[k - 2] = update_entry(&u1[k - 2], update_entry(&u0[k - 2], v[k - 2], by0, share0), by1, share1);
        share2 = update_diagonal(m, k - 2, &c);
        by2 = v[k - 2];
        v[k - 3] = update_entry(&u2[k - 3], update_entry(&u1[k - 3], update_entry(&u0[k - 3], v[k - 3], by0, share0), by1, share1), by2, share2);
        share3 = update_diagonal(m, k - 3, &c);
        by3 = v[k - 3];
        for (int32_t i = 0; i < (k - 3); i++) {
            real_t rest = update_entry(&u0[i], v[i], by0, share0);

            rest = update_entry(&u1[i], rest, by1, share1);
            rest = update_entry(&u2[i], rest, by2, share2);
            v[i] = update_entry(&u3[i], rest, by3, share3);
        }
    }
    for (; k >= 0; k--) {
        const real_t share = update_diagonal(m, k, &c);
        const real_t by = v[k];

        for (int32_t i = 0; i < k; i++) {
            v[i] = update_entry(&m->u_transposed[k][i], v[i], by, share);
        }
    }
}

void propagate_error_column(const real_t u[ERROR_STATE_COUNT], real_t span, const real_t transition[TRANSITION_SIZE], real_t out[MOTION_STATE_COUNT])
{
    const real_t *a = transition;
    const real_t *turning = &a[TRANSITION_ATTITUDE];
    const real_t air[3] = {u[ERROR_VELOCITY] - u[ERROR_WIND], u[ERROR_VELOCITY + 1] - u[ERROR_WIND + 1], u[ERROR_VELOCITY + 2]};
    real_t turn[3];
    real_t half[3];
    real_t gain[3];

    for (int32_t i = 0; i < 3; i++) {
        const real_t *g = &a[3 * i];

        turn[i] = ((g[0] * u[ERROR_GYRO_BIAS]) + (g[1] * u[ERROR_GYRO_BIAS + 1])) + (g[2] * u[ERROR_GYRO_BIAS + 2]);
        half[i] = u[ERROR_ATTITUDE + i] - (REAL(0.5) * turn[i]);
    }
    for (int32_t i = 0; i < 3; i++) {
        const real_t *b = &a[TRANSITION_ACCEL + (3 * i)];
        const real_t *w = &a[TRANSITION_WIND + (3 * i)];

        gain[i] = ((((((b[0] * u[ERROR_ACCEL_BIAS]) + (b[1] * u[ERROR_ACCEL_BIAS + 1])) + (b[2] * u[ERROR_ACCEL_BIAS + 2])) + (w[0] * air[0])) + (w[1] * air[1])) +
                   (w[2] * air[2])) + (a[TRANSITION_THRUST + i] * u[ERROR_THRUST_SCALE]);
    }
    gain[0] += (turning[2] * half[1]) - (turning[1] * half[2]);
    gain[1] += (turning[0] * half[2]) - (turning[2] * half[0]);
    gain[2] += (turning[1] * half[0]) - (turning[0] * half[1]);
    for (int32_t i = 0; i < 3; i++) {
        out[i] = u[i] + (span * (u[ERROR_VELOCITY + i] + (REAL(0.5) * gain[i])));
        out[ERROR_VELOCITY + i] = u[ERROR_VELOCITY + i] + gain[i];
        out[ERROR_ATTITUDE + i] = u[ERROR_ATTITUDE + i] - turn[i];
    }
}

/* Do the same as propagate_error_column, in place, for a column without biases. */
static void propagate_motion_column(real_t u[MOTION_STATE_COUNT], real_t span, const real_t transition[TRANSITION_SIZE])
{
    const real_t *turning = &transition[TRANSITION_ATTITUDE];
    const real_t velocity[3] = {u[ERROR_VELOCITY], u[ERROR_VELOCITY + 1], u[ERROR_VELOCITY + 2]};
    real_t gain[3];

    for (int32_t i = 0; i < 3; i++) {
        const real_t *w = &transition[TRANSITION_WIND + (3 * i)];

        gain[i] = ((w[0] * velocity[0]) + (w[1] * velocity[1])) + (w[2] * velocity[2]);
    }
    gain[0] += (turning[2] * u[ERROR_ATTITUDE + 1]) - (turning[1] * u[ERROR_ATTITUDE + 2]);
    gain[1] += (turning[0] * u[ERROR_ATTITUDE + 2]) - (turning[2] * u[ERROR_ATTITUDE]);
    gain[2] += (turning[1] * u[ERROR_ATTITUDE]) - (turning[0] * u[ERROR_ATTITUDE + 1]);
    for (int32_t i = 0; i < 3; i++) {
        u[i] += span * (velocity[i] + (REAL(0.5) * gain[i]));
        u[ERROR_VELOCITY + i] = velocity[i] + gain[i];
    }
}

/* Make the columns of the velocity orthogonal, from the last to the first (Thornton). */
static void orthogonalise_velocity(estimator_t *m)
{
    real_t w[3][6];
    real_t size[3];

    for (int32_t i = 0; i < 6; i++) {
        w[0][i] = m->u_transposed[ERROR_VELOCITY][i];
        w[1][i] = m->u_transposed[ERROR_VELOCITY + 1][i];
        w[2][i] = m->u_transposed[ERROR_VELOCITY + 2][i];
    }
    for (int32_t j = 5; j >= ERROR_VELOCITY; j--) {
        real_t total = REAL(0.0);

        for (int32_t k = 0; k < 3; k++) {
            total += (m->ud_diagonal[ERROR_VELOCITY + k] * w[k][j]) * w[k][j];
        }
        size[j - ERROR_VELOCITY] = (total > MIN_UD_DIAGONAL) ? total : MIN_UD_DIAGONAL;
        for (int32_t i = 0; i < j; i++) {
            real_t s = REAL(0.0);

            for (int32_t k = 0; k < 3; k++) {
                s += (m->ud_diagonal[ERROR_VELOCITY + k] * w[k][j]) * w[k][i];
            }
            s /= size[j - ERROR_VELOCITY];
            m->u_transposed[j][i] = s;
            for (int32_t k = 0; k < 3; k++) {
                w[k][i] -= w[k][j] * s;
            }
        }
        m->u_transposed[j][j] = REAL(1.0);
        for (int32_t i = j + 1; i < 6; i++) {
            m->u_transposed[j][i] = REAL(0.0);
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        m->ud_diagonal[ERROR_VELOCITY + k] = size[k];
    }
}

void ud_time_update(estimator_t *m, real_t span, const real_t transition[TRANSITION_SIZE], const real_t q[MOTION_STATE_COUNT])
{
    for (int32_t k = ERROR_VELOCITY; k < MOTION_STATE_COUNT; k++) {
        propagate_motion_column(m->u_transposed[k], span, transition);
    }
    for (int32_t k = MOTION_STATE_COUNT; k < ERROR_STATE_COUNT; k++) {
        propagate_error_column(m->u_transposed[k], span, transition, m->u_transposed[k]);
    }
    orthogonalise_velocity(m);
    for (int32_t j = 0; j < MOTION_STATE_COUNT; j++) {
        for (int32_t i = 0; i < j; i++) {
            m->u_transposed_h[i] = REAL(0.0);
        }
        m->u_transposed_h[j] = REAL(1.0);
        if ((j >= ERROR_VELOCITY) && (j < ERROR_ATTITUDE)) {
            m->u_transposed_h[j - ERROR_VELOCITY] = REAL(0.5) * span;
        }
        rank_one_update(m, j, q[j]);
    }
}

void gauss_markov_update(estimator_t *m, int32_t state, real_t keep, real_t q)
{
    const real_t old = m->ud_diagonal[state];
    const real_t fresh = ((keep * keep) * old) + q;
    const real_t by = (keep * old) / fresh;

    for (int32_t k = state + 1; k < ERROR_STATE_COUNT; k++) {
        m->u_transposed[k][state] *= keep;
    }
    m->ud_diagonal[state] = fresh;
    for (int32_t i = 0; i < state; i++) {
        m->u_transposed_h[i] = m->u_transposed[state][i];
        m->u_transposed[state][i] = by * m->u_transposed_h[i];
    }
    rank_one_update(m, state - 1, (old * q) / fresh);
}

void inflate_variance(estimator_t *m, int32_t state, real_t variance)
{
    for (int32_t i = 0; i < state; i++) {
        m->u_transposed_h[i] = REAL(0.0);
    }
    m->u_transposed_h[state] = REAL(1.0);
    rank_one_update(m, state, variance);
}

void inflate_by_sigma(estimator_t *m, int32_t state, real_t sigma)
{
    inflate_variance(m, state, sigma * sigma);
}

real_t state_variance(const estimator_t *m, int32_t state)
{
    real_t s = m->ud_diagonal[state];

    for (int32_t k = state + 1; k < ERROR_STATE_COUNT; k++) {
        s += (m->ud_diagonal[k] * m->u_transposed[k][state]) * m->u_transposed[k][state];
    }
    return s;
}
