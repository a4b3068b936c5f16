/* Signals of motors, servos and battery: DShot frames as compare values of a timer, pulses of servos, voltage of a divider. */
#ifndef MUFLY_ACTUATOR_OUTPUTS_H
#define MUFLY_ACTUATOR_OUTPUTS_H

#include "real.h"

#define DSHOT_BITS 17 /* 16 bits, and a compare value of 0 that ends the last pulse */

/* Frame of DShot: 11 bits of throttle, telemetry request, 4 bits of checksum. share: 0 to 1 of full speed; 0 and NaN stop. */
uint16_t dshot_frame(real_t share);

/* Compare values of a timer whose period is a bit: 3/4 of it for a one, 3/8 for a zero; the most significant bit first. */
void dshot_compare_values(uint16_t frame, uint32_t period_ticks, uint32_t out[DSHOT_BITS]);

/* Length of a servo's pulse (us): 1000 to 2000, 1500 for 0 and for NaN. */
uint32_t servo_pulse_us(real_t deflection);

/* Voltage of a battery behind a divider, from counts of an ADC of 12 bits; negative for an invalid count. */
real_t battery_voltage(uint32_t count, real_t reference_V, real_t divider);

#endif
