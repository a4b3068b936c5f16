/* Phases on and near the floor: start, landing, and the descent without an estimate. */
#ifndef MUFLY_GROUND_PHASES_H
#define MUFLY_GROUND_PHASES_H

#include "mission.h"

void start_landing(mission_t *s, const message_t *why, int32_t level);
void step_landing(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt);

/* Log the refusal of a start once. */
void refuse_start(mission_t *s, const message_t *why);

bool has_spun_up(const mission_t *s, const estimate_t *m);
void step_on_floor(mission_t *s);
void reset_mission(mission_t *s, const estimate_t *m);

#endif
