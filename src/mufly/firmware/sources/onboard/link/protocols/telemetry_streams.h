/* Telemetry: messages of the vehicle's state, each at its interval. */
#ifndef MUFLY_TELEMETRY_STREAMS_H
#define MUFLY_TELEMETRY_STREAMS_H

#include "onboard/link/vehicle_link.h"

void autopilot_version_message(mavlink_message_t *m);

/* Send a stream's message once more, soon; return whether there is such a stream. */
bool request_stream(link_t *k, uint32_t message);

/* Send the first stream that is due. */
void send_stream(link_t *k, const link_vehicle_t *v);

#endif
