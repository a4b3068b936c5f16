/* Mission protocol: upload and download of the waypoints. */
#ifndef MUFLY_MISSION_PROTOCOL_H
#define MUFLY_MISSION_PROTOCOL_H

#include "onboard/link/vehicle_link.h"

#define FRAME_LOCAL_NED 1U
#define LOCAL_SCALE REAL(1e4) /* of x and y in COMMAND_INT and MISSION_ITEM_INT */

/* Whether missions and settings may change: on the floor, with motors off. */
bool may_load(const link_vehicle_t *v);

void handle_mission(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands);

/* Request a late item of an upload again, and give up an upload that has ended. */
void step_upload(link_t *k, const link_vehicle_t *v);

#endif
