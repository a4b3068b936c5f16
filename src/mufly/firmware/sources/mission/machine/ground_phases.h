/* Phases on and near the floor: start, landing, and the descent without an estimate. */
#ifndef MUFLY_GROUND_PHASES_H
#define MUFLY_GROUND_PHASES_H

#include "mission/machine/mission_state.h"

void start_landing(mission_t *s, const message_t *why, int32_t level);
void step_landing(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt);

/* Descend without measurements; fail and land; finish the descent without measurements. */
void enter_blind_descent(mission_t *s, real_t time_s, const message_t *why);
void fail_and_land(mission_t *s, const message_t *why);
void finish_blind_descent(mission_t *s, real_t time_s);

/* Whether the vehicle stands tilted, by its attitude or its accelerometers. */
bool stands_tilted(const estimate_t *m);

/* Reason not to start the motors with this estimate; SAY_NO_MESSAGE if they may start. */
message_t describe_start_fault(const estimate_t *m);

/* Log the refusal of a start once. */
void log_start_refusal(mission_t *s, const message_t *why);

/* Whether the vehicle is off the floor. */
bool has_lifted_off(const mission_t *s, const estimate_t *m);

/* Whether the vehicle, nearly lifted, rotates on its legs. */
bool is_tipping(const estimate_t *m);

bool has_spun_up(const mission_t *s, const estimate_t *m);
void step_on_floor(mission_t *s);
void reset_mission(mission_t *s, const estimate_t *m);

#endif
