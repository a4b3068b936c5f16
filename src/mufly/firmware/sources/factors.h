/* The covariance of the errors as U D U^T, U unit upper triangular: it cannot become negative by rounding. */
#ifndef MUFLY_FACTORS_H
#define MUFLY_FACTORS_H

#include "records.h"

/* f = U^T h of the terms m->h, of the states m->at; gives h P h^T. */
real_t factors_expected(estimator_t *m);

/* Take a measurement of this variance in (Bierman), with f of factors_expected; the gain is left in m->gain. */
void factors_observe(estimator_t *m, real_t variance);

/* Step what moves over a span (s), with a transition of motion.h and the variances of its noise (Bierman, Thornton). */
void factors_carry(estimator_t *m, real_t span, const real_t transition[TRANSITION], const real_t q[MOVING]);

/* What becomes of the first of these errors; `out` may be `u`. */
void factors_carry_column(const real_t u[ERRORS], real_t span, const real_t transition[TRANSITION], real_t out[MOVING]);

/* Step one bias, x' = keep x + w, variance q of w. */
void factors_wander(estimator_t *m, int32_t state, real_t keep, real_t q);

/* Add a variance to a state: something may have happened to it. */
void factors_loosen(estimator_t *m, int32_t state, real_t variance);

/* Variance of a state. */
real_t factors_variance(const estimator_t *m, int32_t state);

#endif
