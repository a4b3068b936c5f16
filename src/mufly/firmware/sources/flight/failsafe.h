/* Open-loop motor inputs: spin-up and ramp-down on the floor, and blind descent without a valid estimate. */
#ifndef MUFLY_FAILSAFE_H
#define MUFLY_FAILSAFE_H

#include "real.h"

/* Inputs (upper, lower; 0..1) during spin-up, elapsed (s) after its start; hover: hover voltages. */
void spin_up_motor_input(const real_t hover_V[2], real_t elapsed_s, real_t battery_V, real_t out[2]);

/* Ramp-down after touchdown: from released to zero within a second. */
void ramp_down_motor_input(const real_t released[2], real_t elapsed_s, real_t out[2]);

/* Blind descent without a height: fraction of the hover voltages. */
#define BLIND_DESCENT_VOLTAGE_FRACTION REAL(0.98)

/* Blind descent: inputs for a fraction of the hover voltages (V), to zero in the last second. */
void blind_descent_motor_input(const real_t held_up_V[2], real_t share, real_t left_s, real_t battery_V, real_t out[2]);

/* Fraction for a known height (m) and rate of descent (m/s). */
real_t blind_descent_voltage_fraction(real_t height, real_t descent);

/* Duration of a blind descent from a height (m), with a reserve of one second. */
real_t blind_descent_time_s(real_t height, real_t gravity);

#endif
