/* Sums run from left to right, as in law.py, for equal rounding. */
#include "control/linear.h"

static real_t add_row(real_t sum, int32_t columns, const real_t row[], const real_t by[])
{
    real_t s = sum;
    for (int32_t j = 0; j < columns; j++) {
        s += row[j] * by[j];
    }
    return s;
}

void linear_output(int32_t n, int32_t m, const real_t C[], const real_t D[], const real_t x[], const real_t e[],
                   real_t u[LINEAR_OUTPUTS])
{
    for (int32_t i = 0; i < LINEAR_OUTPUTS; i++) {
        u[i] = add_row(add_row(REAL(0.0), n, &C[i * n], x), m, &D[i * m], e);
    }
}

void linear_change(int32_t n, int32_t m, const real_t F[], const real_t B[], const real_t M[], const real_t x[],
                   const real_t e[], const real_t excess[LINEAR_OUTPUTS], real_t change[])
{
    for (int32_t i = 0; i < n; i++) {
        const real_t driven = add_row(add_row(REAL(0.0), n, &F[i * n], x), m, &B[i * m], e);
        change[i] = add_row(driven, LINEAR_OUTPUTS, &M[i * LINEAR_OUTPUTS], excess);
    }
}

void linear_init(int32_t n, int32_t m, const real_t E[], const real_t U[], const real_t e[],
                  const real_t u[LINEAR_OUTPUTS], real_t x[])
{
    for (int32_t i = 0; i < n; i++) {
        x[i] = add_row(add_row(REAL(0.0), m, &E[i * m], e), LINEAR_OUTPUTS, &U[i * LINEAR_OUTPUTS], u);
    }
}
