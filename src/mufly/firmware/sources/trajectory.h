/* How to move along a line or a curve in time, rest to rest, and how to come to rest.
 *
 * What it does and why: trajectory.py of mufly.mission. N, E, D (m, m/s, m/s2); rad, s. State belongs to the caller. */
#ifndef MUFLY_TRAJECTORY_H
#define MUFLY_TRAJECTORY_H

#include "real.h"

#define ARC_PIECES 32 /* of the table of arc lengths; also the steps in which its worst points are sought */

#define CURVE_DEMAND_COUNT 4
#define CURVE_WORK_PARTS 3 /* of the work on it, each in a period of its own */

/* What a trajectory may ask for. */
typedef struct {
    real_t speed, climb, descent;            /* horizontal, up, down (m/s) */
    real_t acceleration, climb_acceleration; /* (m/s2) */
    real_t yaw_rate, yaw_acceleration;       /* (rad/s, rad/s2) */
} trajectory_limits_t;

/* Way over time: m or rad. */
typedef struct {
    real_t distance;
    real_t peak_speed; /* at its peak */
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
    real_t arc_lengths[ARC_PIECES + 1];
    motion_profile_t speed_profile;
} timed_spline_t;

/* What the points of a curve ask: share of the speed that is level, up, down; curvature; all squared. */
typedef struct {
    real_t least_squared_tangent;                         /* square of the tangent's length */
    real_t demands[CURVE_DEMAND_COUNT];              /* the greatest of each, */
    real_t demand_parameters[CURVE_DEMAND_COUNT];             /* and where that is */
} curve_extremes_t;

/* Coming to rest along the velocity's own direction; likewise turning. */
typedef struct {
    real_t start[3], velocity[3];
    real_t heading;
    real_t duration_s;
    real_t heading_rate;
    real_t turn_duration_s;
} braking_motion_t;

/* On the spot to a height and a heading, then along a line or a curve; a braking may come first. */
typedef struct {
    real_t start[3], goal[3];
    real_t start_heading, turn_angle;
    motion_profile_t height_profile, yaw_profile, path_profile;
    real_t departure_s;     /* when the part on the spot ends, */
    real_t duration_s; /* when all is done; both with the braking */
    bool has_spline_curve, has_initial_braking;
    int32_t pending_parts; /* parts of the work on its curve that are left; until then it is a line */
    real_t curve_limits[4]; /* of the curve: horizontal speed, up, down (m/s), acceleration (m/s2) */
    curve_extremes_t curve_extremes;
    timed_spline_t spline_curve;
    braking_motion_t initial_braking;
} trajectory_t;

void make_profile(real_t way, real_t speed, real_t acceleration, motion_profile_t *out);
real_t profile_duration_s(const motion_profile_t *p);

/* Way, speed, acceleration at time t; at rest before 0 and after the end. */
void profile_evaluate(const motion_profile_t *p, real_t t, real_t out[3]);

/* Heading and height first, then a straight level line. final_heading: NULL is along the line. */
void plan_straight(const real_t start[3], const real_t goal[3], real_t heading, const trajectory_limits_t *limits,
                         const real_t *final_heading, real_t nose_offset, trajectory_t *out);

/* Heading first, then a spline that leaves and arrives in given directions; its curve is to be made. */
void plan_pending_curve(const real_t start[3], const real_t goal[3], const real_t leaving[3],
                       const real_t arriving[3], real_t heading, const trajectory_limits_t *limits,
                       const real_t *final_heading, real_t nose_offset, trajectory_t *out);

/* A part of the work on a curve, if any is left; a line remains where no curve can be flown. */
void advance_pending_curve(trajectory_t *way);

/* A braking comes first, which has to end where it starts. */
void add_initial_braking(trajectory_t *way, const braking_motion_t *brake);

void trajectory_evaluate(const trajectory_t *way, real_t t, trajectory_point_t *out);

/* Brake with at most acceleration (m/s2); a heading rate with at most yaw_acceleration (rad/s2, may be infinite). */
void plan_stop(const real_t position[3], const real_t velocity[3], real_t heading, real_t acceleration,
               real_t heading_rate, real_t yaw_acceleration, braking_motion_t *out);
real_t braking_rest_time_s(const braking_motion_t *brake);

/* At time t after its start; at rest after its end (REAL_INFINITY: where it comes to rest). */
void braking_evaluate(const braking_motion_t *brake, real_t t, trajectory_point_t *out);

#endif
