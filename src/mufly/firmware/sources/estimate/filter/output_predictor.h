/* Output of the filter: the state at the horizon propagated to the present, its covariance, and a position without jumps. */
#ifndef MUFLY_OUTPUT_PREDICTOR_H
#define MUFLY_OUTPUT_PREDICTOR_H

#include "estimate/filter/records.h"

/* Return the row of inputs of the block that begins after a tick. */
real_t *input_block(estimator_t *m, const estimator_settings_t *s, int32_t tick);

/* Return the spectral density of the velocity noise along axis k of N-E-D (m2/s3); e: a row of inputs. */
real_t velocity_noise_density(const real_t r[9], int32_t k, const real_t e[INPUT_ROW_SIZE]);

/* Write the present state; every COVARIANCE_INTERVAL_TICKS periods also its covariance. */
void predict_output(estimator_t *m, const estimator_settings_t *s);

#endif
