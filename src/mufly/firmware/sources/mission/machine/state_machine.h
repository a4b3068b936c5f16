/* The mission state machine, step by step.
 *
 * Explanation: state_machine.py of mufly.mission, and the modules of the same names as the files here. */
#ifndef MUFLY_STATE_MACHINE_H
#define MUFLY_STATE_MACHINE_H

#include "mission/machine/mission_state.h"

/* Run one step of the state machine, at about 50 Hz. */
void step_mission(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *command, reference_t *out);

/* Process one of several parts (from 1) of beams and points, between two steps. */
void update_obstacle_map(const plan_t *plan, mission_t *s, const estimate_t *m, int32_t part, int32_t parts);

#endif
