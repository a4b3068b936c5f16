#include "factors.h"

real_t factors_expected(estimator_t *m)
{
    real_t spread = REAL(0.0);

    for (int32_t j = 0; j < ERRORS; j++) {
        real_t s = m->h[j];

        for (int32_t i = 0; i < j; i++) {
            s += m->ut[j][i] * m->h[i];
        }
        m->f[j] = s;
        spread += (m->d[j] * s) * s;
    }
    return spread;
}

void factors_observe(estimator_t *m, real_t variance)
{
    real_t a = variance;

    for (int32_t j = 0; j < ERRORS; j++) {
        const real_t v = m->d[j] * m->f[j];
        const real_t before = a;
        real_t step;

        a = before + (m->f[j] * v);
        m->d[j] *= before / a;
        step = -m->f[j] / before;
        m->gain[j] = v;
        for (int32_t i = 0; i < j; i++) {
            const real_t u = m->ut[j][i];

            m->ut[j][i] = u + (step * m->gain[i]);
            m->gain[i] += u * v;
        }
    }
    for (int32_t j = 0; j < ERRORS; j++) {
        m->gain[j] /= a;
    }
}

/* The rows [F U, G] of which Thornton's method makes U and D, with their weights. */
static void stack_up(estimator_t *m, real_t middle)
{
    for (int32_t k = 0; k < ERRORS; k++) {
        real_t *above = m->w[k];
        real_t *below = m->w[ERRORS + k];

        for (int32_t i = 0; i < MOVING; i++) {
            real_t s = m->top[i][k];

            for (int32_t j = 0; j < k; j++) {
                s += m->top[i][j] * m->ut[k][j];
            }
            above[i] = s;
            below[i] = REAL(0.0);
        }
        for (int32_t i = MOVING; i < ERRORS; i++) {
            above[i] = (i < k) ? (m->decay[i] * m->ut[k][i]) : REAL(0.0);
            below[i] = REAL(0.0);
        }
        if (k >= MOVING) {
            above[k] = m->decay[k];
        }
        below[k] = REAL(1.0);
        if ((k >= V_) && (k < TURN)) {
            below[k - V_] = middle;
        }
        m->weight[k] = m->d[k];
        m->weight[ERRORS + k] = m->q[k];
    }
}

void factors_carry(estimator_t *m, real_t middle)
{
    stack_up(m, middle);
    for (int32_t j = ERRORS - 1; j >= 0; j--) {
        const int32_t low = (j >= MOVING) ? j : 0;
        real_t total = REAL(0.0) * m->d[j];

        for (int32_t i = 0; i < j; i++) {
            m->row[i] = REAL(0.0);
        }
        for (int32_t half = 0; half < 2; half++) {
            for (int32_t k = (half * ERRORS) + low; k < ((half + 1) * ERRORS); k++) {
                const real_t *w = m->w[k];
                const real_t c = m->weight[k] * w[j];

                if (c != REAL(0.0)) {
                    total += c * w[j];
                    for (int32_t i = 0; i < j; i++) {
                        m->row[i] += c * w[i];
                    }
                }
            }
        }
        m->d[j] = (total > TINY) ? total : TINY;
        for (int32_t i = 0; i < j; i++) {
            m->row[i] /= m->d[j];
            m->ut[j][i] = m->row[i];
        }
        for (int32_t half = 0; half < 2; half++) {
            for (int32_t k = (half * ERRORS) + low; k < ((half + 1) * ERRORS); k++) {
                real_t *w = m->w[k];
                const real_t c = w[j];

                if (c != REAL(0.0)) {
                    for (int32_t i = 0; i < j; i++) {
                        w[i] -= c * m->row[i];
                    }
                }
            }
        }
    }
}

void factors_loosen(estimator_t *m, int32_t state, real_t variance)
{
    real_t *v = m->f;
    real_t c = variance;

    for (int32_t i = 0; i < state; i++) {
        v[i] = REAL(0.0);
    }
    v[state] = REAL(1.0);
    for (int32_t k = state; k >= 0; k--) { /* Agee and Turner */
        const real_t old = m->d[k];
        const real_t fresh = old + ((c * v[k]) * v[k]);

        if (!(fresh <= TINY)) {
            const real_t b = (c * v[k]) / fresh;

            for (int32_t i = 0; i < k; i++) {
                v[i] -= v[k] * m->ut[k][i];
                m->ut[k][i] += b * v[i];
            }
            c *= old / fresh;
            m->d[k] = fresh;
        }
    }
}

void factors_sigmas(estimator_t *m)
{
    for (int32_t i = 0; i < ERRORS; i++) {
        real_t s = m->d[i];

        for (int32_t k = i + 1; k < ERRORS; k++) {
            s += (m->d[k] * m->ut[k][i]) * m->ut[k][i];
        }
        m->sigma[i] = real_sqrt(s);
    }
}
