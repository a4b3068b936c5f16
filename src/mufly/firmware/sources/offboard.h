/* Conversion of set-points streamed by a program to a reference that the helicopter can follow.
 *
 * Explanation: offboard.py of mufly.mission. */
#ifndef MUFLY_OFFBOARD_H
#define MUFLY_OFFBOARD_H

#include "avoid.h"
#include "trajectory.h"

#define MIN_WAYPOINT_HEIGHT_M REAL(0.2)
#define MAX_HEIGHT_M REAL(50.0)

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

#endif
