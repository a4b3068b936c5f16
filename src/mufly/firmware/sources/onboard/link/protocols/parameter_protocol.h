/* Parameter protocol: lists, reads and sets of the tunable values. */
#ifndef MUFLY_PARAMETER_PROTOCOL_H
#define MUFLY_PARAMETER_PROTOCOL_H

#include "onboard/link/vehicle_link.h"
#include "onboard/storage/parameters.h"

/* The values behind the parameters. */
tunables_t link_tunables(const link_vehicle_t *v);

void handle_parameter(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands);

/* Send the next value of a list that was requested; return whether there was one. */
bool send_listed_parameter(link_t *k, const link_vehicle_t *v);

#endif
