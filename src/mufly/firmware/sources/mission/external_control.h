/* Control by a pilot (manual, the thesis's state RC) or by a program's set-points (offboard). */
#ifndef MUFLY_EXTERNAL_CONTROL_H
#define MUFLY_EXTERNAL_CONTROL_H

#include "mission/machine/mission_state.h"

/* Give control to the pilot, from any state. */
void enter_manual(mission_t *s, const estimate_t *m);

/* Move the references of height and heading by the pilot's sticks; a climb from the floor starts the rotors. */
void step_manual(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt);

/* End manual control: hover at the present position, or on the floor return to the state init. */
void exit_manual(mission_t *s, const estimate_t *m);

/* Give control to an offboard program: in flight at once, on the floor if its set-point requires lift-off. */
void enter_offboard(mission_t *s, const estimate_t *m, const set_point_t *wanted);

/* Follow the set-point within the mission's limits, away from obstacles that the beams have hit. */
void step_offboard(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt);

/* End offboard control: hover where the reference comes to rest, or stay on the floor. */
void exit_offboard(const plan_t *plan, mission_t *s, const estimate_t *m);

#endif
