/* Conversion of set-points streamed by a program, or of a pilot's sticks, to what the helicopter can follow.
 *
 * Explanation: offboard.py of mufly.mission. */
#ifndef MUFLY_OFFBOARD_H
#define MUFLY_OFFBOARD_H

#include "mission/avoidance.h"
#include "mission/trajectory.h"

#define MIN_WAYPOINT_HEIGHT_M REAL(0.2)
#define MAX_HEIGHT_M REAL(50.0)
#define DRIFTING_DESCENT_RATE_M_S REAL(0.05) /* descent rate near the floor at a level speed that is too high for a touchdown */

/* Set-point of a program; NaN leaves an axis free. N, E, D (m, m/s); rad, rad/s. */
typedef struct {
    real_t position[3], velocity[3];
    real_t heading, yaw_rate;
} set_point_t;

/* Whether a set-point is valid: not empty, and within all bounds. */
bool is_set_point_valid(const set_point_t *wanted);

/* Whether a helicopter at rest at standing must lift off for it. */
bool needs_lift_off(const set_point_t *wanted, const real_t standing[3]);

/* Propagate the reference by dt (s); measured: position of the helicopter. sight: points to keep at clearance (m), or
   NULL. */
void follow_set_point(trajectory_point_t *tracker, const set_point_t *wanted, const trajectory_limits_t *limits, const real_t measured[3],
                     real_t dt, const path_check_t *sight, real_t clearance);

/* Limit the pilot's roll and pitch (rad) near the floor; height above the standing position, velocity N, E. */
void limit_manual_tilt(real_t height, const real_t velocity[2], real_t yaw, real_t *roll, real_t *pitch);

/* The pilot's climb rate, its descent limited near the floor. */
real_t limit_manual_climb(real_t height, const real_t velocity[2], real_t touchdown, real_t climb);

#endif
