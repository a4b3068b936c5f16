#include "factors.h"

#define ALONE (ERRORS - (ERRORS % 4)) /* those behind the last four */

real_t factors_expected(estimator_t *m)
{
    real_t spread = REAL(0.0);

    for (int32_t j = 0; j < ERRORS; j++) {
        const real_t *u = m->ut[j];
        real_t s = REAL(0.0) + (m->h[0] * u[m->at[0]]);

        for (int32_t t = 1; t < m->terms; t++) {
            s += m->h[t] * u[m->at[t]];
        }
        m->f[j] = s;
        spread += (m->d[j] * s) * s;
    }
    return spread;
}

static inline real_t learn(real_t *of_u, real_t gain, real_t step, real_t v)
{
    const real_t u = *of_u;

    *of_u = u + (step * gain);
    return gain + (u * v);
}

/* Every gain passes through the columns behind its own. Python goes column by column; here four gains go together, which
 * stay in registers: the same sums of each, two thirds of the instructions. */
static void learn_all(estimator_t *m, const real_t step[ERRORS], const real_t v[ERRORS])
{
    for (int32_t i = 0; i < ALONE; i += 4) {
        real_t g0 = v[i];
        real_t g1 = v[i + 1];
        real_t g2 = v[i + 2];
        real_t g3 = v[i + 3];

        g0 = learn(&m->ut[i + 1][i], g0, step[i + 1], v[i + 1]);
        g0 = learn(&m->ut[i + 2][i], g0, step[i + 2], v[i + 2]);
        g1 = learn(&m->ut[i + 2][i + 1], g1, step[i + 2], v[i + 2]);
        g0 = learn(&m->ut[i + 3][i], g0, step[i + 3], v[i + 3]);
        g1 = learn(&m->ut[i + 3][i + 1], g1, step[i + 3], v[i + 3]);
        g2 = learn(&m->ut[i + 3][i + 2], g2, step[i + 3], v[i + 3]);
        for (int32_t j = i + 4; j < ERRORS; j++) {
            real_t *u = &m->ut[j][i];

            g0 = learn(&u[0], g0, step[j], v[j]);
            g1 = learn(&u[1], g1, step[j], v[j]);
            g2 = learn(&u[2], g2, step[j], v[j]);
            g3 = learn(&u[3], g3, step[j], v[j]);
        }
        m->gain[i] = g0;
        m->gain[i + 1] = g1;
        m->gain[i + 2] = g2;
        m->gain[i + 3] = g3;
    }
    for (int32_t i = ALONE; i < ERRORS; i++) {
        real_t g = v[i];

        for (int32_t j = i + 1; j < ERRORS; j++) {
            g = learn(&m->ut[j][i], g, step[j], v[j]);
        }
        m->gain[i] = g;
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

/* P + c v v^T, v = m->f and zero behind `last`; factor by factor from there (Agee and Turner). */
static void add(estimator_t *m, int32_t last, real_t much)
{
    real_t *v = m->f;
    real_t c = much;

    for (int32_t k = last; k >= 0; k--) {
        const real_t old = m->d[k];
        const real_t fresh = old + ((c * v[k]) * v[k]);

        if (!(fresh <= TINY)) {
            const real_t b = (c * v[k]) / fresh;
            const real_t by = v[k];
            real_t *u = m->ut[k];

            for (int32_t i = 0; i < k; i++) {
                const real_t left = v[i] - (by * u[i]);

                v[i] = left;
                u[i] += b * left;
            }
            c *= old / fresh;
            m->d[k] = fresh;
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

/* The columns of the velocity, which drag turns into each other: orthogonal again, from the last to the first. */
static void straighten(estimator_t *m)
{
    real_t w[3][6];
    real_t size[3];

    for (int32_t k = 0; k < 3; k++) {
        for (int32_t i = 0; i < 6; i++) {
            w[k][i] = m->ut[V_ + k][i];
        }
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
    for (int32_t k = V_; k < ERRORS; k++) {
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
