/* Estimator: from readings to the present state, once a period. An error-state Kalman filter runs at a horizon,
 * `horizon_delay_ticks` periods behind the present, so that late measurements are fused in the order of their time. The output is
 * the state at the horizon, propagated to the present. */
#ifndef MUFLY_EKF_STEP_H
#define MUFLY_EKF_STEP_H

#include "estimate/filter/records.h"

/* Constants of the exported vehicle: estimate_tables.c. */
extern const estimator_settings_t mufly_settings;
extern const flight_model_t mufly_flight_model;

/* Initialise the memory to the reset state. */
void estimator_reset(estimator_t *m, const estimator_settings_t *s);

/* Run one period. z: the readings in sequence (STARTS in records.h), the actuator inputs of the period that has just
 * ended (4), the share of clipped samples (3). fresh: 0 no new reading, 1 a new reading, 2 a reading that its sensor marks
 * invalid. age: age of each reading (s). Return whether the estimate may be used for flight. The estimate is in
 * m->x_output (STATES), m->angles_output (roll, pitch, yaw, rad) and m->rates_output (rad/s); its covariance is updated
 * every COVARIANCE_INTERVAL_TICKS periods in m->covariance_output and m->sigma_output. z and fresh are overwritten. */
bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[INPUT_VALUE_COUNT],
                    int32_t fresh[SENSOR_COUNT], const real_t age[SENSOR_COUNT]);

#endif
