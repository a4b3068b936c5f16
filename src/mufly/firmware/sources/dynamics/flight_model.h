/* Flight model of the simulation: forces of rotors and air, far above the floor. */
#ifndef MUFLY_FLIGHT_MODEL_H
#define MUFLY_FLIGHT_MODEL_H

#include "estimate/filter/records.h"

/* Sine and cosine of the tilt of the swash plate about x and y. */
typedef struct {
    real_t sin_a;
    real_t cos_a;
    real_t sin_b;
    real_t cos_b;
} swash_t;

/* Time derivative of the state x: position, velocity N-E-D, attitude (quaternion), rates, tilt of the swash plate, normal
 * of the bar, rotor speeds, charge. u: motors upper, lower (0..1), servos; wind N-E-D (m/s). */
void flight_model(const real_t x[MODEL_STATES], const real_t u[4], const real_t wind[3], const flight_model_t *p,
                  const swash_t *swash, real_t dx[MODEL_STATES]);

/* Terminal voltage (V) and supply current (A) of the battery. */
void compute_battery_supply(const real_t x[MODEL_STATES], real_t motor_up, real_t motor_dw, const flight_model_t *p,
             real_t *voltage, real_t *current);

#endif
