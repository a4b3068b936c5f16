/* Steering by messages: sticks of MANUAL_CONTROL, and set-points. */
#ifndef MUFLY_STEERING_INPUT_H
#define MUFLY_STEERING_INPUT_H

#include "onboard/link/vehicle_link.h"

void handle_steering(const link_t *k, const link_vehicle_t *v, const mavlink_message_t *m);

#endif
