/* The estimator: readings in, what is believed out, once a period. An error-state Kalman filter that runs `delay` periods
 * behind, so that late readings are taken in in the order of their measurement; what is told is the horizon's state
 * carried on to now. */
#ifndef MUFLY_ESTIMATE_H
#define MUFLY_ESTIMATE_H

#include "records.h"

/* The numbers of the vehicle this was made for: tables.c. */
extern const estimator_settings_t mufly_settings;
extern const flight_model_t mufly_flight_model;

/* Forget everything; m: any memory. */
void estimator_begin(estimator_t *m, const estimator_settings_t *s);

/* One period. z: the readings one after another (STARTS in records.h), what acted over the period that has just ended
 * (4), the share of clipped samples (3). fresh: 0 nothing new, 1 a new reading, 2 one that says of itself that it is
 * none. age: of each (s). Gives whether the estimate can be flown by; it is in m->out (STATES), m->angles (roll, pitch,
 * yaw, rad), m->out_rates (rad/s), every TOLD_EVERY periods in m->out_cov and m->sigma. z and fresh are used up. */
bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[VALUES],
                    int32_t fresh[SENSORS], const real_t age[SENSORS]);

#endif
