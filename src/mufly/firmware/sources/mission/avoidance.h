/* Obstacle avoidance: points that the range beams have hit, path checks, and detours along contours.
 * Explanation: avoidance.py and detour.py of mufly.mission. Metres, seconds, radians; N, E, D. The caller owns all
 * state. */
#ifndef MUFLY_AVOIDANCE_H
#define MUFLY_AVOIDANCE_H

#include "real.h"

#define MAP_CAPACITY 160 /* points in the map */
#define MAX_BEAMS 64     /* most beams of a ring */
#define SECTOR_COUNT 16   /* directions with a nearest point each */

/* Range beams around the body, all in its x-y plane. */
typedef struct {
    int32_t count;
    real_t cos[MAX_BEAMS]; /* direction of each beam, from x towards y */
    real_t sin[MAX_BEAMS];
    real_t max_range;   /* range of a beam that hits nothing (m) */
    real_t first_angle; /* direction of beam 0 (rad) */
    real_t spacing;     /* between neighbouring beams (rad) */
} beam_ring_t;

/* Map of hit points: the first rows hold N, E, D (m) and the time of the last hit (s). */
typedef struct {
    real_t points[MAP_CAPACITY][4];
    int32_t point_count;
    int32_t next_replaced_row; /* row to replace next when the map is full */
} obstacle_map_t;

/* Check of a path against the points processed so far; squared lengths in m2. */
typedef struct {
    real_t from_point[3];  /* start of the path, */
    real_t goal_point[2]; /* and goal (m) */
    real_t look_ahead_m;     /* length of path that is checked (m) */
    int32_t checked_point_count;      /* number of points checked */
    real_t path_clearance_sq;        /* least squared distance of any point from the path, exact if small */
    real_t path_start_clearance_sq;  /* likewise for the first 1.5 m */
    real_t goal_clearance_sq; /* least squared distance of any point from the goal */
    real_t lateral_offset_sum;    /* sum of the lateral offsets of blocking points, positive to the right (m) */
    int32_t blocking_point_count;         /* number of blocking points */
    real_t nearest_blocking_distance_sq;  /* squared distance of the nearest blocking point */
    real_t nearest_blocking_point[2];     /* its position (m) */
    real_t nearest_point_by_sector[SECTOR_COUNT][2]; /* nearest point in each direction, infinite without a point (m) */
} path_check_t;

/* State of a detour around an obstacle. */
typedef struct {
    real_t position[3], velocity[3], acceleration[3]; /* the reference */
    real_t passing_side;               /* +1 keeps the obstacle on the left, -1 on the right */
    real_t hit_point[2];             /* position where the obstacle was met (m) */
    real_t hit_goal_distance;       /* distance from there to the goal (m) */
    int32_t obstacle_count;             /* number of obstacles met on this leg */
    real_t side_change_deviation_m;              /* distance from the line at which the other side is tried (m) */
    real_t path_clear_duration_s;            /* time for which the path has been clear (s) */
    real_t stuck_check_point[2], stuck_duration_s; /* time within 0.25 m of the anchor (s) */
    bool has_lap_start;
    real_t lap_start_point[2]; /* position where the contour was reached (m), if has_lap_start */
    int32_t lap_count;  /* whole laps around the obstacle */
    real_t lap_distance_m, lap_min_goal_distance_m; /* distance flown since then, and the least distance to the goal on it (m) */
    bool is_leaving_contour;         /* the reference brakes, to continue straight from where it stops */
    real_t obstacle_point[2];   /* last nearest point (m), for messages; NaN without one */
} detour_t;

/* Empty the map. */
void clear_obstacle_map(obstacle_map_t *memory);

/* Add the hits of count beams from the first on, in cyclic order; ranges of all beams (m). */
void insert_beam_hits(obstacle_map_t *memory, const beam_ring_t *beams, real_t time_s, const real_t position[3],
                   const real_t attitude[3], const real_t ranges[], int32_t first, int32_t count);

/* Begin the check of the straight level path from position to goal (N, E), over at most ahead metres. */
void begin_path_check(const real_t position[3], const real_t goal[2], real_t ahead, path_check_t *out);
#define PATH_LOOK_AHEAD_M REAL(1.2) /* usual value of ahead */
#define DETOUR_ACCELERATION_M_S2 REAL(1.0)

/* Distance of the nearest point from a place (m), and the unit vector N, E towards the place. */
real_t find_nearest_point_distance(const path_check_t *sight, const real_t place[], real_t from[2]);

/* Check one of several parts of the points (from 1): remove expired points, evaluate the others for the path. */
void check_map_part(obstacle_map_t *memory, path_check_t *sight, real_t time_s, real_t clearance, int32_t part, int32_t parts);

/* Whether a point blocks the path. */
bool is_path_blocked(const path_check_t *sight, real_t clearance);

/* Limit a velocity N, E with the least change so that distance keep (m) is approached only exponentially. */
void limit_approach_velocity(const path_check_t *sight, const real_t position[], real_t keep, real_t velocity[2]);

/* Start a detour at the reference; before: the last one on this leg, or NULL; it may be detour itself. */
void begin_detour(detour_t *detour, const real_t position[3], const real_t velocity[3],
                 const real_t acceleration[3], const real_t goal[3], const path_check_t *sight, const detour_t *before);

/* Run one step of dt (s) of a detour. position, heading: measured; speed (m/s). */
void follow_contour(detour_t *detour, const path_check_t *sight, const beam_ring_t *beams, const real_t position[3],
                    real_t heading, const real_t ranges[], const real_t goal[3], real_t clearance, real_t speed,
                    real_t dt);

/* Whether the obstacle is avoided and the reference has come to rest. */
bool is_detour_finished(const detour_t *detour);

#endif
