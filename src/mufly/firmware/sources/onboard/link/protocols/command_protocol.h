/* Command protocol: COMMAND_LONG and COMMAND_INT with their answers, repetitions recognised. */
#ifndef MUFLY_COMMAND_PROTOCOL_H
#define MUFLY_COMMAND_PROTOCOL_H

#include "onboard/link/vehicle_link.h"

/* Pass a user's request to the supervisor; return the answer. */
int32_t send_request(const link_vehicle_t *v, const user_request_t *ask);

void handle_command(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands);

#endif
