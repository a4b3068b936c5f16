/* Effects of the user's requests: stop, waypoints, pause, resumption, return and landing. */
#ifndef MUFLY_USER_REQUESTS_H
#define MUFLY_USER_REQUESTS_H

#include "mission/machine/mission_state.h"

/* Stop the motors in any state. */
void stop_motors(mission_t *s, const message_t *why);

/* Reason to refuse a user's waypoint; SAY_NO_MESSAGE if it is valid. */
message_t describe_user_waypoint_fault(const command_t *c);

/* Stop, fly to the command's waypoint and hold; the mission waits. Without a waypoint only turn on the spot. */
void fly_to_user_waypoint(const plan_t *plan, mission_t *s, const command_t *c);

/* Stop and hover; the mission waits. Resume it, or fly to waypoint *first. */
void pause_mission(const plan_t *plan, mission_t *s, const message_t *why);
void resume_mission(const plan_t *plan, mission_t *s, const int32_t *first);

/* Change to another plan, which is flown from its first waypoint at the next start. */
void reset_for_loaded_mission(const plan_t *plan, mission_t *s);

/* Let the mission follow the take-off, from waypoint first (from 0). */
void queue_mission_after_take_off(mission_t *s, int32_t first);

/* Fly to above the take-off position and land; or land here. */
void return_on_request(const plan_t *plan, mission_t *s);
void land_on_request(const plan_t *plan, mission_t *s);

#endif
