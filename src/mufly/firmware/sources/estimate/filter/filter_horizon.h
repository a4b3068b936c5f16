/* Horizon of the filter: its queue of measurements, its steps, and its tasks within the work of a period. */
#ifndef MUFLY_FILTER_HORIZON_H
#define MUFLY_FILTER_HORIZON_H

#include "estimate/filter/records.h"

/* Predict the bias whose turn it is, except those of the fix. */
void predict_next_bias(estimator_t *m, const estimator_settings_t *s);

/* Start new means of accelerometers and model. */
void clear_block_forces(estimator_t *m);

/* Run the next task at the horizon if it costs no more than left; return its cost, 0 if none was run. */
int32_t run_next_task(estimator_t *m, const estimator_settings_t *s, int32_t left);

/* Queue the new measurements of this period. */
void queue_new_measurements(estimator_t *m, const estimator_settings_t *s, const real_t z[INPUT_VALUE_COUNT],
                     const int32_t fresh[SENSOR_COUNT], const real_t age[SENSOR_COUNT]);

#endif
