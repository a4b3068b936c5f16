/* The estimator: readings in, the state of now out, once a period. An error-state Kalman filter runs `delay_ticks` periods
 * behind now, at the horizon, so that late measurements are fused in the order of their time. The output is the horizon's
 * state, propagated to now. */
#ifndef MUFLY_EKF_STEP_H
#define MUFLY_EKF_STEP_H

#include "records.h"

/* The numbers of the vehicle this was made for: tables.c. */
extern const estimator_settings_t mufly_settings;
extern const flight_model_t mufly_flight_model;

/* Set any memory to the state at the reset. */
void estimator_reset(estimator_t *m, const estimator_settings_t *s);

/* Run one period. z: the readings one after another (STARTS in records.h), the actuators over the period that has just
 * ended (4), the share of clipped samples (3). fresh: 0 nothing new, 1 a new reading, 2 one that its sensor marks invalid.
 * age: of each reading (s). Returns whether the estimate may be flown by. It is in m->x_output (STATES), m->angles_output
 * (roll, pitch, yaw, rad) and m->rates_output (rad/s); every COVARIANCE_INTERVAL_TICKS periods its covariance is in
 * m->covariance_output and m->sigma_output. z and fresh are overwritten. */
bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[VALUE_COUNT],
                    int32_t fresh[SENSOR_COUNT], const real_t age[SENSOR_COUNT]);

#endif
