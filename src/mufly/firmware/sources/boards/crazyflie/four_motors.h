/* The law of a coaxial helicopter on four motors: a mixer from two motor and two servo inputs to four motors. */
#ifndef MUFLY_FOUR_MOTORS_H
#define MUFLY_FOUR_MOTORS_H

#include "flight/controllers.h"

/* Change of a motor's input by full yaw (the difference of both motors is 1), pitch and roll. */
typedef struct {
    real_t yaw, pitch, roll;
} four_motors_t;

/* Inputs 0..1 of front left, front right, rear right, rear left; front left and rear right turn clockwise from above.
 * If an input would leave 0..1, the mean is shifted first; then tilt and yaw are scaled down together. */
void four_motors_mix(const four_motors_t *g, const actuators_t *in, real_t out[4]);

#endif
