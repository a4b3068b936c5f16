/* Operations of linear controllers. Matrices by rows; n states, m errors, OUTPUT_PAIR outputs. */
#ifndef MUFLY_LINEAR_H
#define MUFLY_LINEAR_H

#include "real.h"

#define LINEAR_OUTPUTS 2

/* u = C x + D e */
void linear_output(int32_t n, int32_t m, const real_t C[], const real_t D[], const real_t x[], const real_t e[],
                   real_t u[LINEAR_OUTPUTS]);

/* change = F x + B e + M excess, the change of x in a period; change must not alias x */
void linear_change(int32_t n, int32_t m, const real_t F[], const real_t B[], const real_t M[], const real_t x[],
                   const real_t e[], const real_t excess[LINEAR_OUTPUTS], real_t change[]);

/* x = E e + U u */
void linear_init(int32_t n, int32_t m, const real_t E[], const real_t U[], const real_t e[],
                  const real_t u[LINEAR_OUTPUTS], real_t x[]);

#endif
