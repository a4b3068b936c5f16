/* Behaviour of each mission state in the air, and the transitions into it. */
#ifndef MUFLY_PHASES_H
#define MUFLY_PHASES_H

#include "mission/machine/mission_state.h"

/* Goal of a leg, set by the caller that starts it. */
enum { LEG_TO_WAYPOINT, LEG_TO_USER_WAYPOINT, LEG_TO_HOME };
typedef struct {
    int32_t kind;
    bool has_goal; /* for a user's leg: without a goal, turn on the spot */
    real_t goal[3];
    bool has_heading;
    real_t heading;
} leg_request_t;

void start_flight(const plan_t *plan, mission_t *s, const estimate_t *m, const real_t *height, int32_t first);
void plan_braking(const plan_t *plan, const mission_t *s, braking_motion_t *out);
void start_leg(const plan_t *plan, mission_t *s, const message_t *why, const leg_request_t *errand);
void start_leg_home(const plan_t *plan, mission_t *s, const message_t *why);

/* Lead the present user's leg to another goal without a stop; heading: NULL along the way. quiet: do not log it. */
void change_leg_goal(const plan_t *plan, mission_t *s, const message_t *why, const real_t goal[3], const real_t *heading, bool quiet);

/* Follow a set-point within the mission's limits, away from obstacles. */
void track_set_point(const plan_t *plan, mission_t *s, const set_point_t *wanted, const estimate_t *m, real_t dt);

/* Run one step of the present state. */
void step_phase(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt);

#endif
