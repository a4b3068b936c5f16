/* The covariance as U D U^T, U unit upper triangular: rounding cannot make it negative. */
#ifndef MUFLY_UD_FILTER_H
#define MUFLY_UD_FILTER_H

#include "estimate/filter/records.h"

/* Write f = U^T h of the row H in m->h_value, and return h P h^T. */
real_t innovation_variance(estimator_t *m);

/* Update U and D by a measurement of this variance (Bierman), with f of innovation_variance; write m->gain. */
void ud_measurement_update(estimator_t *m, real_t variance);

/* Predict the moving states over a span (s), with error_transition and the variances q of the noise (Bierman, Thornton). */
void ud_time_update(estimator_t *m, real_t span, const real_t transition[TRANSITION_SIZE], const real_t q[MOTION_STATE_COUNT]);

/* Write the first nine errors of column u (n,) after a step; out may be u. */
void propagate_error_column(const real_t u[ERROR_STATE_COUNT], real_t span, const real_t transition[TRANSITION_SIZE], real_t out[MOTION_STATE_COUNT]);

/* Predict one bias, x' = keep x + w, with variance q of w. */
void gauss_markov_update(estimator_t *m, int32_t state, real_t keep, real_t q);

/* Add a variance to a state. */
void inflate_variance(estimator_t *m, int32_t state, real_t variance);

/* The same by a standard deviation. */
void inflate_by_sigma(estimator_t *m, int32_t state, real_t sigma);

/* Return the variance of a state. */
real_t state_variance(const estimator_t *m, int32_t state);

#endif
