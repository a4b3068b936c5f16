/* Motion along a line or a curve in time, from rest to rest, and braking to rest.
 *
 * Explanation: trajectory.py of mufly.mission. N, E, D (m, m/s, m/s2); rad, s. The caller owns all state. */
#ifndef MUFLY_TRAJECTORY_H
#define MUFLY_TRAJECTORY_H

#include "real.h"

#define ARC_PIECE_COUNT 32 /* pieces of the arc length table, and steps of the search for extreme points */

#define CURVE_DEMAND_COUNT 4
#define CURVE_WORK_PARTS 3 /* parts of the computation of a curve, one per period */

/* Limits of a trajectory. */
typedef struct {
    real_t speed, climb, descent;            /* horizontal, up, down (m/s) */
    real_t acceleration, climb_acceleration; /* (m/s2) */
    real_t yaw_rate, yaw_acceleration;       /* (rad/s, rad/s2) */
} trajectory_limits_t;

/* Distance over time: m or rad. */
typedef struct {
    real_t distance;
    real_t peak_speed; /* m/s or rad/s */
    real_t ramp_s, cruise_s;
} motion_profile_t;

/* A trajectory at one instant. */
typedef struct {
    real_t position[3], velocity[3], acceleration[3];
    real_t heading, heading_rate;
} trajectory_point_t;

/* A cubic spline with its timing. */
typedef struct {
    real_t coefficients[3][4]; /* A, B, C, D of each axis */
    real_t arc_lengths[ARC_PIECE_COUNT + 1];
    motion_profile_t speed_profile;
} timed_spline_t;

/* Greatest demands over a curve: level, climbing and descending share of speed; curvature; all squared. */
typedef struct {
    real_t least_squared_tangent;                         /* least squared tangent length */
    real_t demands[CURVE_DEMAND_COUNT];              /* greatest value of each, */
    real_t demand_parameters[CURVE_DEMAND_COUNT];             /* and its parameter */
} curve_extremes_t;

/* Braking along the velocity's own direction; likewise for the yaw rate. */
typedef struct {
    real_t start[3], velocity[3];
    real_t heading;
    real_t duration_s;
    real_t heading_rate;
    real_t turn_duration_s;
} braking_motion_t;

/* Height and heading on the spot, then a line or a curve; a braking may come first. */
typedef struct {
    real_t start[3], goal[3];
    real_t start_heading, turn_angle;
    motion_profile_t height_profile, yaw_profile, path_profile;
    real_t path_start_s; /* end of the part on the spot, */
    real_t duration_s; /* end of the trajectory; both include the braking */
    bool has_spline_curve, has_initial_braking;
    int32_t pending_parts; /* remaining parts of the curve's computation; until then the path is a line */
    real_t curve_limits[4]; /* of the curve: horizontal speed, climb, descent (m/s), acceleration (m/s2) */
    curve_extremes_t curve_extremes;
    timed_spline_t spline_curve;
    braking_motion_t initial_braking;
} trajectory_t;

void make_motion_profile(real_t way, real_t speed, real_t acceleration, motion_profile_t *out);
real_t profile_duration_s(const motion_profile_t *p);

/* Distance, speed, acceleration at time t; at rest before 0 and after the end. */
void profile_evaluate(const motion_profile_t *p, real_t t, real_t out[3]);

/* Plan heading and height first, then a straight level line. final_heading: NULL is along the line. */
void plan_straight(const real_t start[3], const real_t goal[3], real_t heading, const trajectory_limits_t *limits,
                         const real_t *final_heading, real_t nose_offset, trajectory_t *out);

/* Plan heading first, then a spline with given end directions; the curve is computed later. */
void plan_pending_curve(const real_t start[3], const real_t goal[3], const real_t leaving[3],
                       const real_t arriving[3], real_t heading, const trajectory_limits_t *limits,
                       const real_t *final_heading, real_t nose_offset, trajectory_t *out);

/* Compute one part of a pending curve; a line remains if no curve can be flown. */
void advance_pending_curve(trajectory_t *way);

/* Put a braking first, which must end at the trajectory's start. */
void add_initial_braking(trajectory_t *way, const braking_motion_t *brake);

void trajectory_evaluate(const trajectory_t *way, real_t t, trajectory_point_t *out);

/* Plan braking with at most acceleration (m/s2); of a heading rate with at most yaw_acceleration (rad/s2, may be inf).
   */
void plan_stop(const real_t position[3], const real_t velocity[3], real_t heading, real_t acceleration,
               real_t heading_rate, real_t yaw_acceleration, braking_motion_t *out);
real_t braking_rest_time_s(const braking_motion_t *brake);

/* Point at time t after the start; at rest after the end (REAL_INFINITY: point of rest). */
void braking_evaluate(const braking_motion_t *brake, real_t t, trajectory_point_t *out);

#endif
