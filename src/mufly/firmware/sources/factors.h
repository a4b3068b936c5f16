/* The covariance of the errors as U D U^T, U unit upper triangular: it cannot become negative by rounding. */
#ifndef MUFLY_FACTORS_H
#define MUFLY_FACTORS_H

#include "records.h"

/* f = U^T h of the row h; gives h P h^T. */
real_t factors_expected(estimator_t *m);

/* Take a measurement of this variance in (Bierman), with f of factors_expected; the gain is left in m->gain. */
void factors_observe(estimator_t *m, real_t variance);

/* Step in time over the block that has gathered in top, decay and q (Thornton). Noise of a velocity moves its
 * position too, by `middle` (s) times itself. */
void factors_carry(estimator_t *m, real_t middle);

/* Column k of F U, of its first rows `top`. */
void factors_times(const estimator_t *m, real_t top[MOVING][ERRORS], int32_t k, real_t out[MOVING]);

/* Add a variance to a state: something may have happened to it. */
void factors_loosen(estimator_t *m, int32_t state, real_t variance);

/* Standard deviation of every state into m->sigma. */
void factors_sigmas(estimator_t *m);

#endif
