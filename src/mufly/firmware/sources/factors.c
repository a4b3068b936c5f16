#include "factors.h"

real_t factors_expected(estimator_t *m)
{
    real_t spread = REAL(0.0);

    for (int32_t j = 0; j < ERRORS; j++) {
        const real_t *u = m->ut[j];
        real_t s = m->h[j];

        for (int32_t i = 0; i < j; i++) {
            s += u[i] * m->h[i];
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
        real_t *of_j = m->ut[j];
        real_t step;

        a = before + (m->f[j] * v);
        m->d[j] *= before / a;
        step = -m->f[j] / before;
        m->gain[j] = v;
        for (int32_t i = 0; i < j; i++) {
            const real_t u = of_j[i];
            const real_t gain = m->gain[i];

            of_j[i] = u + (step * gain);
            m->gain[i] = gain + (u * v);
        }
    }
    for (int32_t j = 0; j < ERRORS; j++) {
        m->gain[j] /= a;
    }
}

void factors_times(const estimator_t *m, real_t top[MOVING][ERRORS], int32_t k, real_t out[MOVING])
{
    const real_t *u = m->ut[k];

    for (int32_t i = 0; i < MOVING; i += 3) { /* three sums at a time share what is read */
        const real_t *first = top[i];
        const real_t *second = top[i + 1];
        const real_t *third = top[i + 2];
        real_t a = first[k];
        real_t b = second[k];
        real_t c = third[k];

        for (int32_t j = 0; j < k; j++) {
            const real_t by = u[j];

            a += first[j] * by;
            b += second[j] * by;
            c += third[j] * by;
        }
        out[i] = a;
        out[i + 1] = b;
        out[i + 2] = c;
    }
}

/* The rows [F U, G] of which Thornton's method makes U and D, with their weights. */
static void stack_up(estimator_t *m, real_t middle)
{
    for (int32_t k = 0; k < ERRORS; k++) {
        real_t *above = m->w[k];
        real_t *below = m->w[ERRORS + k];

        factors_times(m, m->top, k, above);
        for (int32_t i = 0; i < MOVING; i++) {
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

/* Rows of w in which column j is not zero, from `low` on in either half, and their entries there. */
static int32_t rows_of(const estimator_t *m, int32_t j, int32_t low, int32_t rows[2 * ERRORS], real_t entry[2 * ERRORS])
{
    int32_t count = 0;

    for (int32_t half = 0; half < 2; half++) {
        for (int32_t k = (half * ERRORS) + low; k < ((half + 1) * ERRORS); k++) {
            const real_t c = m->w[k][j];

            if (c != REAL(0.0)) {
                rows[count] = k;
                entry[count] = c;
                count += 1;
            }
        }
    }
    return count;
}

/* Four columns at a time stay in registers; each sum runs over the rows in their order, whatever the blocks are. The last
 * block reaches beyond column j, into columns that are done with. */
#define BLOCK 4

static void project(const estimator_t *m, int32_t j, int32_t count, const int32_t rows[2 * ERRORS],
                    const real_t weighted[2 * ERRORS], real_t row[ERRORS + BLOCK])
{
    for (int32_t i = 0; i < j; i += BLOCK) {
        real_t a = REAL(0.0);
        real_t b = REAL(0.0);
        real_t c = REAL(0.0);
        real_t d = REAL(0.0);

        for (int32_t n = 0; n < count; n++) {
            const real_t *w = &m->w[rows[n]][i];
            const real_t by = weighted[n];

            a += by * w[0];
            b += by * w[1];
            c += by * w[2];
            d += by * w[3];
        }
        row[i] = a;
        row[i + 1] = b;
        row[i + 2] = c;
        row[i + 3] = d;
    }
}

static void take_away(estimator_t *m, int32_t j, int32_t count, const int32_t rows[2 * ERRORS],
                      const real_t entry[2 * ERRORS], const real_t row[ERRORS + BLOCK])
{
    int32_t i = 0;

    for (; (i + BLOCK) <= j; i += BLOCK) {
        const real_t a = row[i];
        const real_t b = row[i + 1];
        const real_t c = row[i + 2];
        const real_t d = row[i + 3];

        for (int32_t n = 0; n < count; n++) {
            real_t *w = &m->w[rows[n]][i];
            const real_t by = entry[n];

            w[0] -= by * a;
            w[1] -= by * b;
            w[2] -= by * c;
            w[3] -= by * d;
        }
    }
    for (; i < j; i++) {
        for (int32_t n = 0; n < count; n++) {
            m->w[rows[n]][i] -= entry[n] * row[i];
        }
    }
}

void factors_carry(estimator_t *m, real_t middle)
{
    int32_t rows[2 * ERRORS];
    real_t entry[2 * ERRORS];
    real_t weighted[2 * ERRORS];
    real_t row[ERRORS + BLOCK];

    stack_up(m, middle);
    for (int32_t j = ERRORS - 1; j >= 0; j--) {
        const int32_t count = rows_of(m, j, (j >= MOVING) ? j : 0, rows, entry);
        real_t total = REAL(0.0);

        for (int32_t n = 0; n < count; n++) {
            const real_t c = m->weight[rows[n]] * entry[n];

            total += c * entry[n];
            weighted[n] = c;
        }
        project(m, j, count, rows, weighted, row);
        m->d[j] = (total > TINY) ? total : TINY;
        for (int32_t i = 0; i < j; i++) {
            m->row[i] = row[i] / m->d[j];
            m->ut[j][i] = m->row[i];
            row[i] = m->row[i];
        }
        take_away(m, j, count, rows, entry, row);
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
