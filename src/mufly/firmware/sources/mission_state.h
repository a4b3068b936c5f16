/* State of the mission: its log, and the transitions between states. */
#ifndef MUFLY_MISSION_STATE_H
#define MUFLY_MISSION_STATE_H

#include "mission.h"

void copy_vector(const real_t from[3], real_t to[3]);
void zero_vector(real_t out[3]);
real_t distance_between(const real_t a[3], const real_t b[3]);

void log_event_as(mission_t *s, int32_t state, const message_t *what, int32_t level);
void enter_state(mission_t *s, int32_t state, const message_t *why, int32_t level);
void enter_hover(mission_t *s, const message_t *why, const real_t at[3], real_t heading, int32_t level);
void fail_mission(mission_t *s, const message_t *why);
void succeed_mission(mission_t *s, int32_t code);

/* Reset all but the log, the clock and the battery. */
void clear_mission(mission_t *s);

#endif
