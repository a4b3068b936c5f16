/* Motors without a controller: speeding up and running down on the floor, and coming down when the estimate is lost. */
#ifndef MUFLY_FAILSAFE_H
#define MUFLY_FAILSAFE_H

#include "real.h"

/* Inputs (upper, lower; 0..1) while the rotors speed up, elapsed (s) after they began; hover: voltages of hover. */
void spin_up_motor_input(const real_t hover_V[2], real_t elapsed_s, real_t battery_V, real_t out[2]);

/* After touchdown, from released to zero within a second. */
void ramp_down_motor_input(const real_t released[2], real_t elapsed_s, real_t out[2]);

/* On a blind way down: the share of what held it up (V) where no height is known. */
#define DESCENT_VOLTAGE_SHARE REAL(0.98)

/* On a blind way down: a share of what held it up (V), to zero in its last second. */
void descent_motor_input(const real_t held_up_V[2], real_t share, real_t left_s, real_t battery_V, real_t out[2]);

/* That share where height (m) and rate of descent (m/s) are known. */
real_t descent_voltage_share(real_t height, real_t descent);

/* How long a blind way down takes from a height (m), with a second to spare. */
real_t descent_time_s(real_t height, real_t gravity);

#endif
