/* The law of a coaxial helicopter on four motors: what to make of two motor inputs and two servo inputs. */
#ifndef MUFLY_FOUR_MOTORS_H
#define MUFLY_FOUR_MOTORS_H

#include "controllers.h"

/* How much of a motor's input full yaw (the difference of both motors is 1), pitch and roll take. */
typedef struct {
    real_t yaw, pitch, roll;
} four_motors_t;

/* Inputs 0..1 of front left, front right, rear right, rear left; front left and rear right turn clockwise from above.
 * Where a motor is asked for more than it has, the mean gives way first, then all of tilt and yaw alike. */
void four_motors_mix(const four_motors_t *g, const actuators_t *in, real_t out[4]);

#endif
