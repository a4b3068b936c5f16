#include "factors.h"

/* Python goes column by column. Here some go together, so that what they share stays in registers: the same operations on
 * each number, a third less instructions. */
#define GROUP 5
#if (ERRORS % GROUP) != 0
#error "columns go together in fives"
#endif

real_t factors_expected(estimator_t *m)
{
    real_t spread = REAL(0.0);

    for (int32_t j = 0; j < ERRORS; j += GROUP) {
        real_t(*const u)[ERRORS] = &m->ut[j];
        real_t s0 = REAL(0.0);
        real_t s1 = REAL(0.0);
        real_t s2 = REAL(0.0);
        real_t s3 = REAL(0.0);
        real_t s4 = REAL(0.0);

        for (int32_t t = 0; t < m->terms; t++) {
            const real_t h = m->h[t];
            const int32_t i = m->at[t];

            s0 += h * u[0][i];
            s1 += h * u[1][i];
            s2 += h * u[2][i];
            s3 += h * u[3][i];
            s4 += h * u[4][i];
        }
        m->f[j] = s0;
        m->f[j + 1] = s1;
        m->f[j + 2] = s2;
        m->f[j + 3] = s3;
        m->f[j + 4] = s4;
    }
    for (int32_t j = 0; j < ERRORS; j++) {
        spread += (m->d[j] * m->f[j]) * m->f[j];
    }
    return spread;
}

static inline real_t learn(real_t *of_u, real_t gain, real_t step, real_t v)
{
    const real_t u = *of_u;

    *of_u = u + (step * gain);
    return gain + (u * v);
}

/* Every gain passes through the columns behind its own. */
static void learn_all(estimator_t *m, const real_t step[ERRORS], const real_t v[ERRORS])
{
    for (int32_t i = 0; i < ERRORS; i += GROUP) {
        real_t g0 = v[i];
        real_t g1 = v[i + 1];
        real_t g2 = v[i + 2];
        real_t g3 = v[i + 3];
        real_t g4 = v[i + 4];

        g0 = learn(&m->ut[i + 1][i], g0, step[i + 1], v[i + 1]);
        g0 = learn(&m->ut[i + 2][i], g0, step[i + 2], v[i + 2]);
        g1 = learn(&m->ut[i + 2][i + 1], g1, step[i + 2], v[i + 2]);
        g0 = learn(&m->ut[i + 3][i], g0, step[i + 3], v[i + 3]);
        g1 = learn(&m->ut[i + 3][i + 1], g1, step[i + 3], v[i + 3]);
        g2 = learn(&m->ut[i + 3][i + 2], g2, step[i + 3], v[i + 3]);
        g0 = learn(&m->ut[i + 4][i], g0, step[i + 4], v[i + 4]);
        g1 = learn(&m->ut[i + 4][i + 1], g1, step[i + 4], v[i + 4]);
        g2 = learn(&m->ut[i + 4][i + 2], g2, step[i + 4], v[i + 4]);
        g3 = learn(&m->ut[i + 4][i + 3], g3, step[i + 4], v[i + 4]);
        for (int32_t j = i + GROUP; j < ERRORS; j++) {
            real_t *u = &m->ut[j][i];

            g0 = learn(&u[0], g0, step[j], v[j]);
            g1 = learn(&u[1], g1, step[j], v[j]);
            g2 = learn(&u[2], g2, step[j], v[j]);
            g3 = learn(&u[3], g3, step[j], v[j]);
            g4 = learn(&u[4], g4, step[j], v[j]);
        }
        m->gain[i] = g0;
        m->gain[i + 1] = g1;
        m->gain[i + 2] = g2;
        m->gain[i + 3] = g3;
        m->gain[i + 4] = g4;
    }
}

void factors_observe(estimator_t *m, real_t variance)
{
    real_t step[ERRORS];
    real_t v[ERRORS];
    real_t a = variance;

    for (int32_t j = 0; j < ERRORS; j++) {
        const real_t before = a;

        v[j] = m->d[j] * m->f[j];
        a = before + (m->f[j] * v[j]);
        m->d[j] *= before / a;
        step[j] = -m->f[j] / before;
    }
    learn_all(m, step, v);
    for (int32_t j = 0; j < ERRORS; j++) {
        m->gain[j] /= a;
    }
}

/* Add to the variance of column k what v says; the share of what is left of v that the column is changed by. */
static real_t share_of(estimator_t *m, int32_t k, real_t *c)
{
    const real_t v = m->f[k];
    const real_t old = m->d[k];
    const real_t fresh = old + ((*c * v) * v);
    real_t share = REAL(0.0);

    if (!(fresh <= TINY)) {
        share = (*c * v) / fresh;
        *c *= old / fresh;
        m->d[k] = fresh;
    } else {
        m->f[k] = REAL(0.0); /* where nothing varies nothing is taken either */
    }
    return share;
}

static inline real_t left(real_t *of_u, real_t v, real_t by, real_t share)
{
    const real_t u = *of_u;
    const real_t rest = v - (by * u);

    *of_u = u + (share * rest);
    return rest;
}

/* P + c v v^T, v = m->f and zero behind `last`; factor by factor from there (Agee and Turner). */
static void add(estimator_t *m, int32_t last, real_t much)
{
    real_t *v = m->f;
    real_t c = much;
    int32_t k = last;

    for (; k > 2; k -= 4) {
        real_t *u0 = m->ut[k];
        real_t *u1 = m->ut[k - 1];
        real_t *u2 = m->ut[k - 2];
        real_t *u3 = m->ut[k - 3];
        const real_t share0 = share_of(m, k, &c);
        const real_t by0 = v[k];
        real_t share1;
        real_t by1;
        real_t share2;
        real_t by2;
        real_t share3;
        real_t by3;

        v[k - 1] = left(&u0[k - 1], v[k - 1], by0, share0);
        share1 = share_of(m, k - 1, &c);
        by1 = v[k - 1];
        v[k - 2] = left(&u1[k - 2], left(&u0[k - 2], v[k - 2], by0, share0), by1, share1);
        share2 = share_of(m, k - 2, &c);
        by2 = v[k - 2];
        v[k - 3] = left(&u2[k - 3], left(&u1[k - 3], left(&u0[k - 3], v[k - 3], by0, share0), by1, share1), by2, share2);
        share3 = share_of(m, k - 3, &c);
        by3 = v[k - 3];
        for (int32_t i = 0; i < (k - 3); i++) {
            real_t rest = left(&u0[i], v[i], by0, share0);

            rest = left(&u1[i], rest, by1, share1);
            rest = left(&u2[i], rest, by2, share2);
            v[i] = left(&u3[i], rest, by3, share3);
        }
    }
    for (; k >= 0; k--) {
        const real_t share = share_of(m, k, &c);
        const real_t by = v[k];

        for (int32_t i = 0; i < k; i++) {
            v[i] = left(&m->ut[k][i], v[i], by, share);
        }
    }
}

void factors_carry_column(const real_t u[ERRORS], real_t span, const real_t transition[TRANSITION], real_t out[MOVING])
{
    const real_t *a = transition;
    const real_t *turning = &a[30];
    const real_t air[3] = {u[3] - u[20], u[4] - u[21], u[5]};
    real_t turn[3];
    real_t half[3];
    real_t gain[3];

    for (int32_t i = 0; i < 3; i++) {
        const real_t *g = &a[3 * i];

        turn[i] = ((g[0] * u[9]) + (g[1] * u[10])) + (g[2] * u[11]);
        half[i] = u[6 + i] - (REAL(0.5) * turn[i]);
    }
    for (int32_t i = 0; i < 3; i++) {
        const real_t *b = &a[9 + (3 * i)];
        const real_t *w = &a[18 + (3 * i)];

        gain[i] = ((((((b[0] * u[12]) + (b[1] * u[13])) + (b[2] * u[14])) + (w[0] * air[0])) + (w[1] * air[1])) +
                   (w[2] * air[2])) + (a[27 + i] * u[22]);
    }
    gain[0] += (turning[2] * half[1]) - (turning[1] * half[2]);
    gain[1] += (turning[0] * half[2]) - (turning[2] * half[0]);
    gain[2] += (turning[1] * half[0]) - (turning[0] * half[1]);
    for (int32_t i = 0; i < 3; i++) {
        out[i] = u[i] + (span * (u[3 + i] + (REAL(0.5) * gain[i])));
        out[3 + i] = u[3 + i] + gain[i];
        out[6 + i] = u[6 + i] - turn[i];
    }
}

/* The same of a column of what moves, in which no bias stands yet. */
static void carry_moving(real_t u[MOVING], real_t span, const real_t transition[TRANSITION])
{
    const real_t *turning = &transition[30];
    const real_t velocity[3] = {u[3], u[4], u[5]};
    real_t gain[3];

    for (int32_t i = 0; i < 3; i++) {
        const real_t *w = &transition[18 + (3 * i)];

        gain[i] = ((w[0] * velocity[0]) + (w[1] * velocity[1])) + (w[2] * velocity[2]);
    }
    gain[0] += (turning[2] * u[7]) - (turning[1] * u[8]);
    gain[1] += (turning[0] * u[8]) - (turning[2] * u[6]);
    gain[2] += (turning[1] * u[6]) - (turning[0] * u[7]);
    for (int32_t i = 0; i < 3; i++) {
        u[i] += span * (velocity[i] + (REAL(0.5) * gain[i]));
        u[3 + i] = velocity[i] + gain[i];
    }
}

/* The columns of the velocity, which drag turns into each other: orthogonal again, from the last to the first. */
static void straighten(estimator_t *m)
{
    real_t w[3][6];
    real_t size[3];

    for (int32_t i = 0; i < 6; i++) {
        w[0][i] = m->ut[V_][i];
        w[1][i] = m->ut[V_ + 1][i];
        w[2][i] = m->ut[V_ + 2][i];
    }
    for (int32_t j = 5; j >= V_; j--) {
        real_t total = REAL(0.0);

        for (int32_t k = 0; k < 3; k++) {
            total += (m->d[V_ + k] * w[k][j]) * w[k][j];
        }
        size[j - V_] = (total > TINY) ? total : TINY;
        for (int32_t i = 0; i < j; i++) {
            real_t s = REAL(0.0);

            for (int32_t k = 0; k < 3; k++) {
                s += (m->d[V_ + k] * w[k][j]) * w[k][i];
            }
            s /= size[j - V_];
            m->ut[j][i] = s;
            for (int32_t k = 0; k < 3; k++) {
                w[k][i] -= w[k][j] * s;
            }
        }
        m->ut[j][j] = REAL(1.0);
        for (int32_t i = j + 1; i < 6; i++) {
            m->ut[j][i] = REAL(0.0);
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        m->d[V_ + k] = size[k];
    }
}

void factors_carry(estimator_t *m, real_t span, const real_t transition[TRANSITION], const real_t q[MOVING])
{
    for (int32_t k = V_; k < MOVING; k++) {
        carry_moving(m->ut[k], span, transition);
    }
    for (int32_t k = MOVING; k < ERRORS; k++) {
        factors_carry_column(m->ut[k], span, transition, m->ut[k]);
    }
    straighten(m);
    for (int32_t j = 0; j < MOVING; j++) {
        for (int32_t i = 0; i < j; i++) {
            m->f[i] = REAL(0.0);
        }
        m->f[j] = REAL(1.0);
        if ((j >= V_) && (j < TURN)) {
            m->f[j - V_] = REAL(0.5) * span;
        }
        add(m, j, q[j]);
    }
}

void factors_wander(estimator_t *m, int32_t state, real_t keep, real_t q)
{
    const real_t old = m->d[state];
    const real_t fresh = ((keep * keep) * old) + q;
    const real_t by = (keep * old) / fresh;

    for (int32_t k = state + 1; k < ERRORS; k++) {
        m->ut[k][state] *= keep;
    }
    m->d[state] = fresh;
    for (int32_t i = 0; i < state; i++) {
        m->f[i] = m->ut[state][i];
        m->ut[state][i] = by * m->f[i];
    }
    add(m, state - 1, (old * q) / fresh);
}

void factors_loosen(estimator_t *m, int32_t state, real_t variance)
{
    for (int32_t i = 0; i < state; i++) {
        m->f[i] = REAL(0.0);
    }
    m->f[state] = REAL(1.0);
    add(m, state, variance);
}

real_t factors_variance(const estimator_t *m, int32_t state)
{
    real_t s = m->d[state];

    for (int32_t k = state + 1; k < ERRORS; k++) {
        s += (m->d[k] * m->ut[k][state]) * m->ut[k][state];
    }
    return s;
}
