/* Inputs of the filter from the readings of a period: rates and accelerations, the force of the rotors, and noise. */
#ifndef MUFLY_FILTER_INPUTS_H
#define MUFLY_FILTER_INPUTS_H

#include "estimate/filter/records.h"

/* Write the row of inputs of the period that has just ended, and average it into its block. */
real_t compute_prediction_inputs(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                   const int32_t *fresh);

/* Estimate the noise of accelerometers less model from means over short and over long blocks. */
void estimate_accel_noise(estimator_t *m, const estimator_settings_t *s, const real_t z[3]);

/* Measure the tilt of the inertial unit at rest before the first flight, and turn its readings level. */
void level_inertial_unit(estimator_t *m, const estimator_settings_t *s, real_t z[INPUT_VALUE_COUNT]);

#endif
