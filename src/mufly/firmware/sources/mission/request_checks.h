/* Permitted requests in each state: one table for the state machine, the supervisor and the link. */
#ifndef MUFLY_REQUEST_CHECKS_H
#define MUFLY_REQUEST_CHECKS_H

#include "mission/machine/mission_state.h"

enum { REQUEST_ARM, REQUEST_DISARM, REQUEST_TAKE_OFF, REQUEST_START, REQUEST_PAUSE, REQUEST_GO_TO, REQUEST_RETURN, REQUEST_LAND, REQUEST_OFFBOARD,
       REQUEST_STICKS, REQUEST_LOAD, REQUEST_STOP, REQUEST_COUNT };

/* Whether the state permits a request. height: above the standing position (m). */
bool check_request(int32_t ask, const mission_t *s, real_t height, bool armed, bool flying);

/* Whether the state permits a request of an armed vehicle at the estimated height. */
bool is_request_permitted(int32_t ask, const mission_t *s, const estimate_t *m);

#endif
