/* What each state of the mission does by itself, and how it is entered: what mission.c and phases.c share. */
#ifndef MUFLY_PHASES_H
#define MUFLY_PHASES_H

#include "mission.h"

#define BRAKE_M_S2 REAL(1.0)

/* Where a leg leads: set by whoever sets out. */
enum { ERRAND_WAYPOINT, ERRAND_USER, ERRAND_HOME };
typedef struct {
    int32_t kind;
    bool has_goal; /* of the user: without one, turn on the spot */
    real_t goal[3];
    bool has_heading;
    real_t heading;
} errand_t;

void phases_copy(const real_t from[3], real_t to[3]);
void phases_log_as(mission_t *s, int32_t state, const message_t *what, int32_t level);
void phases_enter(mission_t *s, int32_t state, const message_t *why, int32_t level);
void phases_rest(mission_t *s, const message_t *why, const real_t at[3], real_t heading, int32_t level);
void phases_fail(mission_t *s, const message_t *why);

/* The reference now, without the swing of the nose; and once this step is over. */
void phases_point(const mission_t *s, point_t *out);
void phases_onward(const mission_t *s, point_t *out);
bool phases_at_gate(const mission_t *s);
bool phases_scanning(const plan_t *plan, const mission_t *s);
void phases_swing(const plan_t *plan, const mission_t *s, real_t *angle, real_t *rate);

bool phases_spun_up(const mission_t *s, const belief_t *m);
void phases_anew(mission_t *s, const belief_t *m);
void phases_start(const plan_t *plan, mission_t *s, const belief_t *m, const real_t *height, int32_t first);
void phases_land(mission_t *s, const message_t *why, int32_t level);
void phases_braking(const plan_t *plan, const mission_t *s, stop_t *out);
void phases_set_out(const plan_t *plan, mission_t *s, const message_t *why, const errand_t *errand);
void phases_go_home(const plan_t *plan, mission_t *s, const message_t *why);

/* One step of what the present state is busy with. */
void phases_step(const plan_t *plan, mission_t *s, const belief_t *m, real_t dt);

void phases_reference(const plan_t *plan, const mission_t *s, const belief_t *m, const command_t *c,
                      reference_t *out);

#endif
