/* Reference of the mission for the controllers: the point of the present motion, and the swing of the nose. */
#ifndef MUFLY_MISSION_REFERENCE_H
#define MUFLY_MISSION_REFERENCE_H

#include "mission/machine/mission_state.h"

/* Reference at present, without the swing of the nose; and at the end of this step. */
void current_reference(const mission_t *s, trajectory_point_t *out);
void predict_step_end_reference(const mission_t *s, trajectory_point_t *out);
bool has_departed(const mission_t *s);
bool is_scanning(const plan_t *plan, const mission_t *s);
void compute_scan_yaw(const plan_t *plan, const mission_t *s, real_t *angle, real_t *rate);

void make_reference(const plan_t *plan, const mission_t *s, const estimate_t *m, const command_t *c,
                      reference_t *out);

#endif
