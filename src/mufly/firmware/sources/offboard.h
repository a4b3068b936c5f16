/* From set-points that a program streams to a reference that the helicopter can follow.
 *
 * What it does and why: offboard.py of mufly.mission. */
#ifndef MUFLY_OFFBOARD_H
#define MUFLY_OFFBOARD_H

#include "avoid.h"
#include "trajectory.h"

#define LOWEST_M REAL(0.2)
#define HIGHEST_M REAL(50.0)

/* What a program wants at this moment; not a number says nothing. N, E, D (m, m/s); rad, rad/s. */
typedef struct {
    real_t position[3], velocity[3];
    real_t heading, yaw_rate;
} set_point_t;

/* Whether nothing is wrong with it: it says something, and nothing beyond all bounds. */
bool offboard_right(const set_point_t *wanted);

/* Whether a helicopter that stands there has to lift off for it. */
bool offboard_wants_up(const set_point_t *wanted, const real_t standing[3]);

/* Advance the reference by dt (s); measured: where the helicopter is. sight: what to keep clearance (m) from, or NULL. */
void offboard_follow(point_t *tracker, const set_point_t *wanted, const limits_t *limits, const real_t measured[3],
                     real_t dt, const sight_t *sight, real_t clearance);

#endif
