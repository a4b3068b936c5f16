/* Fusion of one scalar measurement: its row H, its gate, its rejection, and the estimate of its noise. */
#ifndef MUFLY_SCALAR_FUSION_H
#define MUFLY_SCALAR_FUSION_H

#include "estimate/filter/records.h"

/* Begin the row H of a measurement with h times error state i. */
void h_row_begin(estimator_t *m, int32_t state, real_t h);

/* Add h times error state i to the row H. */
void h_row_add(estimator_t *m, int32_t state, real_t h);

/* Fuse a scalar measurement whose m->u_transposed_h is known; correct the horizon's state and those propagated from it. */
void apply_correction(estimator_t *m, real_t innovation, real_t variance);

/* Fuse a scalar measurement of variance r without a gate; its row is in m->h_value. */
void fuse_scalar(estimator_t *m, real_t innovation, real_t variance);

/* Fuse a measurement of error state i itself, of variance r, without a gate. */
void fuse_error_state(estimator_t *m, int32_t i, real_t innovation, real_t variance);

/* Return the innovation over its standard deviation. */
real_t innovation_ratio(estimator_t *m, real_t innovation, real_t variance);

/* Record innovation and standard deviation of a sensor. */
void log_innovation(estimator_t *m, int32_t k, real_t innovation, real_t ratio);

/* Reject a reading, and count in m->agreeing_reject_count whether it agrees with the one rejected before. */
void reject_measurement(estimator_t *m, const estimator_settings_t *s, int32_t k, real_t innovation, const real_t *z,
                      int32_t count, real_t near, int32_t why);

/* Return whether rejected readings have agreed with each other for RESET_TIMEOUT_S. */
bool reset_timeout_expired(const estimator_t *m, const estimator_settings_t *s, int32_t k);

/* Change an estimated variance by gain * change within its bounds. */
void adapt_noise_scale(real_t *scale, real_t gain, real_t change);

/* Estimate the noise of an aid that measures one component from its innovation ratio. */
void estimate_noise(estimator_t *m, int32_t aid, real_t ratio);

#endif
