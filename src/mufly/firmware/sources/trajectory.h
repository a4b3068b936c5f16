/* How to move along a line or a curve in time, rest to rest, and how to come to rest.
 *
 * What it does and why: trajectory.py of mufly.mission. N, E, D (m, m/s, m/s2); rad, s. State belongs to the caller. */
#ifndef MUFLY_TRAJECTORY_H
#define MUFLY_TRAJECTORY_H

#include "real.h"

#define CURVE_PIECES 32 /* of the table of arc lengths; also the steps in which its worst points are sought */

#define CURVE_ASKS 4
#define CURVE_PARTS 3 /* of the work on it, each in a period of its own */

/* What a trajectory may ask for. */
typedef struct {
    real_t speed, climb, descent;            /* horizontal, up, down (m/s) */
    real_t acceleration, climb_acceleration; /* (m/s2) */
    real_t yaw_rate, yaw_acceleration;       /* (rad/s, rad/s2) */
} limits_t;

/* Way over time: m or rad. */
typedef struct {
    real_t way;
    real_t speed; /* at its peak */
    real_t ramp_s, cruise_s;
} profile_t;

/* A trajectory at one instant. */
typedef struct {
    real_t position[3], velocity[3], acceleration[3];
    real_t heading, heading_rate;
} point_t;

/* A cubic spline with its timing. */
typedef struct {
    real_t coefficients[3][4]; /* A, B, C, D of each axis */
    real_t arc[CURVE_PIECES + 1];
    profile_t timing;
} curve_t;

/* What the points of a curve ask: share of the speed that is level, up, down; curvature; all squared. */
typedef struct {
    real_t least;                         /* square of the tangent's length */
    real_t asks[CURVE_ASKS];              /* the greatest of each, */
    real_t where[CURVE_ASKS];             /* and where that is */
} worst_t;

/* Coming to rest along the velocity's own direction; likewise turning. */
typedef struct {
    real_t start[3], velocity[3];
    real_t heading;
    real_t duration_s;
    real_t heading_rate;
    real_t turn_s;
} stop_t;

/* On the spot to a height and a heading, then along a line or a curve; a braking may come first. */
typedef struct {
    real_t start[3], goal[3];
    real_t heading, turn;
    profile_t rise, yaw, way;
    real_t gate_s;     /* when the part on the spot ends, */
    real_t duration_s; /* when all is done; both with the braking */
    bool has_curve, has_lead;
    int32_t making; /* parts of the work on its curve that are left; until then it is a line */
    real_t pace[4]; /* of the curve: horizontal speed, up, down (m/s), acceleration (m/s2) */
    worst_t worst;
    curve_t curve;
    stop_t lead;
} trajectory_t;

void profile_make(real_t way, real_t speed, real_t acceleration, profile_t *out);
real_t profile_duration(const profile_t *p);

/* Way, speed, acceleration at time t; at rest before 0 and after the end. */
void profile_at(const profile_t *p, real_t t, real_t out[3]);

/* Heading and height first, then a straight level line. final_heading: NULL is along the line. */
void trajectory_straight(const real_t start[3], const real_t goal[3], real_t heading, const limits_t *limits,
                         const real_t *final_heading, real_t nose_offset, trajectory_t *out);

/* Heading first, then a spline that leaves and arrives in given directions; its curve is to be made. */
void trajectory_begin_curved(const real_t start[3], const real_t goal[3], const real_t leaving[3],
                       const real_t arriving[3], real_t heading, const limits_t *limits,
                       const real_t *final_heading, real_t nose_offset, trajectory_t *out);

/* A part of the work on a curve, if any is left; a line remains where no curve can be flown. */
void trajectory_go_on(trajectory_t *way);

/* A braking comes first, which has to end where it starts. */
void trajectory_after(trajectory_t *way, const stop_t *brake);

void trajectory_at(const trajectory_t *way, real_t t, point_t *out);

/* Brake with at most acceleration (m/s2); a heading rate with at most yaw_acceleration (rad/s2, may be infinite). */
void stop_make(const real_t position[3], const real_t velocity[3], real_t heading, real_t acceleration,
               real_t heading_rate, real_t yaw_acceleration, stop_t *out);
real_t stop_rest_s(const stop_t *brake);

/* At time t after its start; at rest after its end (REAL_INFINITY: where it comes to rest). */
void stop_at(const stop_t *brake, real_t t, point_t *out);

#endif
