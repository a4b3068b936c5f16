/* Around obstacles: points that the range beams have hit, what they mean for a way, and a way along their contour.
 * What it does and why: avoidance.py of mufly.mission. Metres, seconds, radians; N, E, D. State belongs to the caller. */
#ifndef MUFLY_AVOID_H
#define MUFLY_AVOID_H

#include "real.h"

#define MAP_CAPACITY 160 /* points remembered */
#define MAX_BEAMS 64     /* that a ring has at most */
#define SECTOR_COUNT 16   /* directions in which the nearest point counts */

/* Range beams around the body, all in its x-y plane. */
typedef struct {
    int32_t count;
    real_t cos[MAX_BEAMS]; /* direction of each, from x towards y */
    real_t sin[MAX_BEAMS];
    real_t max_range;   /* what a beam that sees nothing returns (m) */
    real_t first_angle; /* direction of beam 0 (rad) */
    real_t spacing;     /* between neighbours (rad) */
} beam_ring_t;

/* In the first rows: N, E, D (m) of a point and when it was hit last (s). */
typedef struct {
    real_t points[MAP_CAPACITY][4];
    int32_t point_count;
    int32_t replace_index; /* where one is to make room for the next, once all are in use */
} obstacle_map_t;

/* What the points mean for a way, of those that have been gone through since it was begun; lengths are squared (m2). */
typedef struct {
    real_t from_point[3];  /* from where it looks, */
    real_t goal_point[2]; /* and where to (m) */
    real_t look_ahead_m;     /* how much of that way is looked at (m) */
    int32_t points_checked;      /* points gone through */
    real_t path_distance_sq;       /* least distance of any point from the stretch looked at, if that is not much */
    real_t onward_distance_sq;    /* likewise from its first 1.5 m */
    real_t goal_distance_sq; /* of the goal from the point nearest to it */
    real_t lateral_offset_sum;    /* sum of the distances of those that block it from the way, positive to the right (m) */
    int32_t blocker_count; /* how many these are */
    real_t blocker_distance_sq;     /* distance of the nearest that blocks it */
    real_t blocker_point[2];                /* where that is (m) */
    real_t nearest_points[SECTOR_COUNT][2]; /* in each direction the nearest point, infinite where there is none (m) */
} path_check_t;

/* A way around an obstacle, in progress. */
typedef struct {
    real_t position[3], velocity[3], acceleration[3]; /* the reference */
    real_t passing_side;               /* +1 keeps the obstacle on the left, -1 on the right */
    real_t hit_point[2];             /* where it was met (m) */
    real_t hit_goal_distance;       /* from there to the goal (m) */
    int32_t obstacle_count;             /* how many times one was met on this leg */
    real_t max_stray;              /* distance from the straight way at which the other side is tried (m) */
    real_t clear_duration_s;            /* for how long the way has been clear */
    real_t anchor_point[2], anchor_duration_s; /* since when this place has not been left by 0.25 m */
    bool has_lap_start;
    real_t lap_start[2]; /* where it came to the contour (m), if has_lap */
    int32_t lap_count;  /* whole ones flown around it */
    real_t lap_distance, least_goal_distance; /* way flown since, and the least distance to the goal on it (m) */
    bool is_leaving;         /* it brakes, to fly straight on from where it stops */
    real_t obstacle_point[2];   /* the point that was nearest last (m), for messages; no number before there was one */
} detour_t;

/* Nothing seen yet. */
void clear_obstacle_map(obstacle_map_t *memory);

/* Add what beams hit now: count of them from the first on, after the last comes beam 0; ranges of all (m). */
void insert_beam_hits(obstacle_map_t *memory, const beam_ring_t *beams, real_t time_s, const real_t position[3],
                   const real_t attitude[3], const real_t ranges[], int32_t first, int32_t count);

/* Begin to look along the straight level way from position to goal (N, E), ahead metres of it at most. */
void begin_path_check(const real_t position[3], const real_t goal[2], real_t ahead, path_check_t *out);
#define LOOK_AHEAD_M REAL(1.2) /* what ahead usually is */

/* Go through a part of the points (from 1, of parts): drop what has not been hit for long, see what the others mean. */
void check_map_part(obstacle_map_t *memory, path_check_t *sight, real_t time_s, real_t clearance, int32_t part, int32_t parts);

/* Whether something stands in the way. */
bool is_path_blocked(const path_check_t *sight, real_t clearance);

/* Distance of the nearest point from a place (m); the unit vector N, E from that to the place. */
real_t nearest_point(const path_check_t *sight, const real_t place[], real_t from[2]);

/* The velocity N, E nearest to the wanted one that comes near keep (m) of a point only exponentially. */
void limit_approach_velocity(const path_check_t *sight, const real_t position[], real_t keep, real_t velocity[2]);

/* Start a detour from where the reference is; before: the last one on this leg, or NULL; it may be detour itself. */
void begin_detour(detour_t *detour, const real_t position[3], const real_t velocity[3],
                 const real_t acceleration[3], const real_t goal[3], const path_check_t *sight, const detour_t *before);

/* One step of it, dt (s) long. position, heading: measured; speed (m/s). */
void follow_contour(detour_t *detour, const path_check_t *sight, const beam_ring_t *beams, const real_t position[3],
                    real_t heading, const real_t ranges[], const real_t goal[3], real_t clearance, real_t speed,
                    real_t dt);

/* Whether the obstacle is avoided and the reference has come to rest. */
bool is_detour_finished(const detour_t *detour);

#endif
