/* Behaviour of each mission state and transitions: functions shared by mission.c and phases.c. */
#ifndef MUFLY_PHASES_H
#define MUFLY_PHASES_H

#include "mission.h"

#define DETOUR_ACCELERATION_M_S2 REAL(1.0)

/* Goal of a leg, set by the caller that starts it. */
enum { LEG_TO_WAYPOINT, LEG_TO_USER_WAYPOINT, LEG_TO_HOME };
typedef struct {
    int32_t kind;
    bool has_goal; /* for a user's leg: without a goal, turn on the spot */
    real_t goal[3];
    bool has_heading;
    real_t heading;
} leg_request_t;

void copy_vector(const real_t from[3], real_t to[3]);
void log_event_as(mission_t *s, int32_t state, const message_t *what, int32_t level);
void enter_state(mission_t *s, int32_t state, const message_t *why, int32_t level);
void enter_hover(mission_t *s, const message_t *why, const real_t at[3], real_t heading, int32_t level);
void fail_mission(mission_t *s, const message_t *why);

/* Reference at present, without the swing of the nose; and at the end of this step. */
void current_reference(const mission_t *s, trajectory_point_t *out);
void predict_reference(const mission_t *s, trajectory_point_t *out);
bool has_departed(const mission_t *s);
bool is_scanning(const plan_t *plan, const mission_t *s);
void scan_yaw(const plan_t *plan, const mission_t *s, real_t *angle, real_t *rate);

bool has_spun_up(const mission_t *s, const estimate_t *m);
void reset_mission(mission_t *s, const estimate_t *m);
void start_flight(const plan_t *plan, mission_t *s, const estimate_t *m, const real_t *height, int32_t first);
void start_landing(mission_t *s, const message_t *why, int32_t level);
void plan_braking(const plan_t *plan, const mission_t *s, braking_motion_t *out);
void start_leg(const plan_t *plan, mission_t *s, const message_t *why, const leg_request_t *errand);
void start_leg_home(const plan_t *plan, mission_t *s, const message_t *why);

/* Log the refusal of a start once. */
void refuse_start(mission_t *s, const message_t *why);

/* Lead the present user's leg to another goal without a stop; heading: NULL along the way. quiet: do not log it. */
void change_leg_goal(const plan_t *plan, mission_t *s, const message_t *why, const real_t goal[3], const real_t *heading, bool quiet);

/* Follow a set-point within the mission's limits, away from obstacles. */
void track_set_point(const plan_t *plan, mission_t *s, const set_point_t *wanted, const estimate_t *m, real_t dt);

/* Run one step of the present state. */
void step_phase(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt);

void make_reference(const plan_t *plan, const mission_t *s, const estimate_t *m, const command_t *c,
                      reference_t *out);

#endif
