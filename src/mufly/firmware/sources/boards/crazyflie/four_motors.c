#include "boards/crazyflie/four_motors.h"

void four_motors_mix(const four_motors_t *g, const actuators_t *in, real_t out[4])
{
    /* Servo 1 positive: nose down, more thrust behind; servo 2 positive: to the right, more thrust on the left. The
     * upper rotor of the coaxial pair turns anticlockwise from above, and so the body clockwise, as the other two do. */
    const real_t pitch = g->pitch * in->servo_input[0];
    const real_t roll = g->roll * in->servo_input[1];
    const real_t yaw = g->yaw * (in->motor_input[0] - in->motor_input[1]);
    const real_t moment[4] = {(roll - pitch) - yaw, (-roll - pitch) + yaw, (-roll + pitch) - yaw,
                              (roll + pitch) + yaw};
    real_t mean = REAL(0.5) * (in->motor_input[0] + in->motor_input[1]);
    real_t least = moment[0];
    real_t most = moment[0];
    real_t share = REAL(1.0);

    for (int32_t i = 1; i < 4; i++) {
        least = real_min(least, moment[i]);
        most = real_max(most, moment[i]);
    }
    if ((most - least) > REAL(1.0)) {
        share = REAL(1.0) / (most - least);
    }
    mean = real_clip(mean, -(share * least), REAL(1.0) - (share * most));
    for (int32_t i = 0; i < 4; i++) {
        out[i] = real_clip(mean + (share * moment[i]), REAL(0.0), REAL(1.0));
    }
}
