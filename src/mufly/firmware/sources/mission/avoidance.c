#include "mission/avoidance.h"

#include <stddef.h>

#define POINT_LIFETIME_S REAL(30.0) /* a point is removed after this time without a hit */
#define POINT_MERGE_DISTANCE_M REAL(0.05)
#define REPLACE_CANDIDATE_COUNT 8
#define FLOOR_POINT_HEIGHT_M REAL(0.12)
#define POINT_MERGE_HEIGHT_M REAL(0.15)
#define MAX_HEIGHT_DIFFERENCE_M REAL(0.5) /* points further above or below are ignored */
#define NEAREST_POINT_RANGE_M REAL(2.0)
#define SECTOR_BOUNDARY_SLOPE REAL(0x1.a827999fcef34p-2) /* tan(pi / 8) */
#define BLOCKED_PATH_MARGIN_M REAL(0.05)
#define CLEAR_PATH_MARGIN_M REAL(0.08)
#define FOLLOW_CONTOUR_MARGIN_M REAL(0.15)
#define APPROACH_BARRIER_MARGIN_M REAL(0.06)
#define APPROACH_SPEED_PER_DISTANCE_1_S REAL(0.8) /* 1/s */
#define REPULSION_GAIN REAL(0.15)
#define CONTOUR_CONVERGENCE_DISTANCE_M REAL(0.4)
#define VELOCITY_LAG_S REAL(0.2)
#define ACCELERATION_LAG_S REAL(0.08)
#define SIDE_CHANGE_DEVIATION_M REAL(3.0)
#define STUCK_TIME_S REAL(5.0)
#define ON_CONTOUR_MARGIN_M REAL(0.15)
#define PROJECTION_SWEEPS 8
#define CLEAR_PATH_TO_LEAVE_M (PATH_LOOK_AHEAD_M + REAL(0.3)) /* length of clear path required to leave a contour */

static real_t planar_distance(const real_t a[], const real_t b[])
{
    return real_hypot(a[0] - b[0], a[1] - b[1]);
}

void clear_obstacle_map(obstacle_map_t *memory)
{
    for (int32_t k = 0; k < MAP_CAPACITY; k++) {
        for (int32_t i = 0; i < 4; i++) {
            memory->points[k][i] = REAL(0.0);
        }
    }
    memory->point_count = 0;
    memory->next_replaced_row = 0;
}

/* Confirm the stored points near a hit, or store it in a free row, else in that of the oldest of a few, in turn. */
static void insert_hit(obstacle_map_t *memory, const real_t hit[3], real_t time_s)
{
    bool known = false;

    for (int32_t k = 0; k < memory->point_count; k++) {
        real_t *const p = memory->points[k];
        const real_t n = p[0] - hit[0];
        const real_t e = p[1] - hit[1];

        if ((((n * n) + (e * e)) < (POINT_MERGE_DISTANCE_M * POINT_MERGE_DISTANCE_M)) && (real_abs(p[2] - hit[2]) < POINT_MERGE_HEIGHT_M)) {
            p[3] = time_s;
            known = true;
        }
    }
    if (!known) {
        int32_t row = 0;

        if (memory->point_count < MAP_CAPACITY) {
            row = memory->point_count;
            memory->point_count++;
        } else {
            row = memory->next_replaced_row;
            for (int32_t k = memory->next_replaced_row; k < (memory->next_replaced_row + REPLACE_CANDIDATE_COUNT); k++) {
                row = (memory->points[k][3] < memory->points[row][3]) ? k : row;
            }
            memory->next_replaced_row = ((memory->next_replaced_row + REPLACE_CANDIDATE_COUNT) < MAP_CAPACITY)
                                            ? (memory->next_replaced_row + REPLACE_CANDIDATE_COUNT)
                                            : 0;
        }
        memory->points[row][0] = hit[0];
        memory->points[row][1] = hit[1];
        memory->points[row][2] = hit[2];
        memory->points[row][3] = time_s;
    }
}

void insert_beam_hits(obstacle_map_t *memory, const beam_ring_t *beams, real_t time_s, const real_t position[3],
                   const real_t attitude[3], const real_t ranges[], int32_t first, int32_t count)
{
    real_t sr;
    real_t cr;
    real_t sp;
    real_t cp;
    real_t sy;
    real_t cy;

    sine_cosine(attitude[0], &sr, &cr);
    sine_cosine(attitude[1], &sp, &cp);
    sine_cosine(attitude[2], &sy, &cy);
    for (int32_t turn = first; turn < (first + count); turn++) {
        const int32_t i = (turn < beams->count) ? turn : (turn - beams->count);
        const real_t reach = ranges[i];
        if (!(reach >= beams->max_range) && (reach > REAL(0.0))) {
            /* Body x and y in N-E-D are the first two columns of the rotation matrix (yaw, pitch, roll). */
            const real_t c = beams->cos[i];
            const real_t s = beams->sin[i];
            const real_t hit[3] = {
                position[0] + (reach * (((c * cp) * cy) + (s * (((sr * sp) * cy) - (cr * sy))))),
                position[1] + (reach * (((c * cp) * sy) + (s * (((sr * sp) * sy) + (cr * cy))))),
                position[2] + (reach * ((-c * sp) + ((s * sr) * cp))),
            };
            if (!(hit[2] > -FLOOR_POINT_HEIGHT_M)) {
                insert_hit(memory, hit, time_s);
            }
        }
    }
}

/* Signed distance before or after a stretch; 0 within it. */
static inline real_t distance_outside_interval(real_t along, real_t stretch)
{
    real_t past = (along > stretch) ? (along - stretch) : REAL(0.0);

    return (along < REAL(0.0)) ? along : past;
}

void begin_path_check(const real_t position[3], const real_t goal[2], real_t ahead, path_check_t *out)
{
    for (int32_t i = 0; i < 3; i++) {
        out->from_point[i] = position[i];
    }
    for (int32_t i = 0; i < 2; i++) {
        out->goal_point[i] = goal[i];
        out->nearest_blocking_point[i] = REAL(0.0);
    }
    out->look_ahead_m = ahead;
    out->checked_point_count = 0;
    out->path_clearance_sq = REAL_INFINITY;
    out->path_start_clearance_sq = REAL_INFINITY;
    out->goal_clearance_sq = REAL_INFINITY;
    out->lateral_offset_sum = REAL(0.0);
    out->blocking_point_count = 0;
    out->nearest_blocking_distance_sq = REAL_INFINITY;
    for (int32_t k = 0; k < SECTOR_COUNT; k++) {
        out->nearest_point_by_sector[k][0] = REAL_INFINITY;
        out->nearest_point_by_sector[k][1] = REAL_INFINITY;
    }
}

/* Index of one of sixteen directions, in arbitrary order. */
static inline int32_t sector_index(real_t n, real_t e)
{
    const real_t an = real_abs(n);
    const real_t ae = real_abs(e);
    const bool steep = an < ae;
    const bool slanted = (steep ? an : ae) > (SECTOR_BOUNDARY_SLOPE * (steep ? ae : an));

    return (((n < REAL(0.0)) ? 1 : 0) + ((e < REAL(0.0)) ? 2 : 0)) + ((steep ? 4 : 0) + (slanted ? 8 : 0));
}

/* Keep a point if it is the nearest in its direction. */
static inline void keep_nearest(path_check_t *s, const real_t p[4], real_t qn, real_t qe, real_t square)
{
    real_t *const near = s->nearest_point_by_sector[sector_index(qn, qe)];
    const real_t n = near[0] - s->from_point[0];
    const real_t e = near[1] - s->from_point[1];

    if (square < ((n * n) + (e * e))) {
        near[0] = p[0];
        near[1] = p[1];
    }
}

/* Distance of a point from a place (m), and the unit vector towards the place. */
static real_t distance_and_unit_vector(const real_t point[], const real_t place[], real_t from[2])
{
    const real_t n = place[0] - point[0];
    const real_t e = place[1] - point[1];
    const real_t far = real_hypot(n, e);

    from[0] = REAL(0.0);
    from[1] = REAL(0.0);
    if (far > REAL(1e-9)) {
        from[0] = n / far;
        from[1] = e / far;
    }
    return far;
}

real_t find_nearest_point_distance(const path_check_t *sight, const real_t place[], real_t from[2])
{
    real_t far = REAL_INFINITY;
    int32_t row = -1;

    for (int32_t k = 0; k < SECTOR_COUNT; k++) {
        const real_t n = place[0] - sight->nearest_point_by_sector[k][0];
        const real_t e = place[1] - sight->nearest_point_by_sector[k][1];
        const real_t square = (n * n) + (e * e);

        if (square < far) {
            far = square;
            row = k;
        }
    }
    from[0] = REAL(0.0);
    from[1] = REAL(0.0);
    if (row >= 0) {
        far = distance_and_unit_vector(sight->nearest_point_by_sector[row], place, from);
    }
    return far;
}

void check_map_part(obstacle_map_t *memory, path_check_t *sight, real_t time_s, real_t clearance, int32_t part, int32_t parts)
{
    const int32_t end = (memory->point_count * part) / parts;
    const real_t blocked_at = clearance + BLOCKED_PATH_MARGIN_M;
    const real_t wide = REAL(2.0) * blocked_at;
    const real_t place[3] = {sight->from_point[0], sight->from_point[1], sight->from_point[2]};
    const real_t goal[2] = {sight->goal_point[0], sight->goal_point[1]};
    const real_t far = real_hypot(goal[0] - place[0], goal[1] - place[1]);
    const real_t stretch = (sight->look_ahead_m < far) ? sight->look_ahead_m : far;
    const real_t first = (stretch > CLEAR_PATH_TO_LEAVE_M) ? CLEAR_PATH_TO_LEAVE_M : stretch;
    real_t wn = REAL(1.0);
    real_t we = REAL(0.0);
    int32_t row = sight->checked_point_count;
    real_t least = sight->path_clearance_sq;
    real_t onward = sight->path_start_clearance_sq;
    real_t from_goal = sight->goal_clearance_sq;
    real_t sideways = sight->lateral_offset_sum;
    int32_t blockers = sight->blocking_point_count;

    if (far > REAL(1e-9)) {
        wn = (goal[0] - place[0]) / far;
        we = (goal[1] - place[1]) / far;
    }
    while ((row < end) && (row < memory->point_count)) {
        real_t *const p = memory->points[row];

        if ((time_s - p[3]) > POINT_LIFETIME_S) {
            memory->point_count--;
            for (int32_t i = 0; i < 4; i++) {
                p[i] = memory->points[memory->point_count][i];
            }
        } else {
            row++;
            if (!(real_abs(p[2] - place[2]) > MAX_HEIGHT_DIFFERENCE_M)) {
                const real_t qn = p[0] - place[0];
                const real_t qe = p[1] - place[1];
                const real_t hn = p[0] - goal[0];
                const real_t he = p[1] - goal[1];
                const real_t square = (qn * qn) + (qe * qe);
                const real_t along = (qn * wn) + (qe * we);
                const real_t across = (qe * wn) - (qn * we);

                if (square < (NEAREST_POINT_RANGE_M * NEAREST_POINT_RANGE_M)) {
                    keep_nearest(sight, p, qn, qe, square);
                }
                from_goal = real_min(from_goal, (hn * hn) + (he * he));
                if ((real_abs(across) < wide) && (along > -wide)) { /* else neither on the path nor near it */
                    const real_t past = distance_outside_interval(along, stretch);
                    const real_t past_first = distance_outside_interval(along, first);
                    const real_t off = (past * past) + (across * across);

                    least = real_min(least, off);
                    onward = real_min(onward, (past_first * past_first) + (across * across));
                    if ((off < (blocked_at * blocked_at)) && (square < sight->nearest_blocking_distance_sq)) {
                        sight->nearest_blocking_distance_sq = square;
                        sight->nearest_blocking_point[0] = p[0];
                        sight->nearest_blocking_point[1] = p[1];
                    }
                    /* The whole visible width of a blocker decides the side, not only the part inside the corridor. */
                    if ((along > -blocked_at) && (along < (stretch + blocked_at))) {
                        sideways += across;
                        blockers++;
                    }
                }
            }
        }
    }
    sight->checked_point_count = row;
    sight->path_clearance_sq = least;
    sight->path_start_clearance_sq = onward;
    sight->goal_clearance_sq = from_goal;
    sight->lateral_offset_sum = sideways;
    sight->blocking_point_count = blockers;
}

bool is_path_blocked(const path_check_t *sight, real_t clearance)
{
    const real_t at = clearance + BLOCKED_PATH_MARGIN_M;

    return sight->path_clearance_sq < (at * at);
}

void limit_approach_velocity(const path_check_t *sight, const real_t position[], real_t keep, real_t velocity[2])
{
    bool changed = true;

    for (int32_t sweep = 0; changed && (sweep < PROJECTION_SWEEPS); sweep++) {
        changed = false;
        for (int32_t k = 0; k < SECTOR_COUNT; k++) {
            const real_t qn = position[0] - sight->nearest_point_by_sector[k][0];
            const real_t qe = position[1] - sight->nearest_point_by_sector[k][1];
            const real_t dist = real_hypot(qn, qe);

            if (!(dist > REAL(2.0)) && !(dist < REAL(1e-9))) {
                const real_t shortage =
                    (-APPROACH_SPEED_PER_DISTANCE_1_S * (dist - keep)) - (((velocity[0] * qn) + (velocity[1] * qe)) / dist);
                if (shortage > REAL(1e-6)) {
                    velocity[0] += (shortage * qn) / dist;
                    velocity[1] += (shortage * qe) / dist;
                    changed = true;
                }
            }
        }
    }
}

void begin_detour(detour_t *detour, const real_t position[3], const real_t velocity[3],
                 const real_t acceleration[3], const real_t goal[3], const path_check_t *sight, const detour_t *before)
{
    const real_t far = planar_distance(goal, position);
    real_t side = (sight->lateral_offset_sum > REAL(0.0)) ? REAL(-1.0) : REAL(1.0);
    int32_t count = 1;
    real_t stray = SIDE_CHANGE_DEVIATION_M;

    if (before != NULL) {
        count = before->obstacle_count + 1;
        stray = before->side_change_deviation_m;
        if (planar_distance(position, before->position) < REAL(1.5)) {
            side = before->passing_side;
        }
    }
    for (int32_t i = 0; i < 3; i++) {
        detour->position[i] = position[i];
        detour->velocity[i] = velocity[i];
        detour->acceleration[i] = acceleration[i];
    }
    for (int32_t i = 0; i < 2; i++) {
        detour->hit_point[i] = position[i];
        detour->stuck_check_point[i] = position[i];
        detour->lap_start_point[i] = REAL(0.0);
        detour->obstacle_point[i] = REAL_NAN;
    }
    detour->passing_side = side;
    detour->hit_goal_distance = far;
    detour->obstacle_count = count;
    detour->side_change_deviation_m = stray;
    detour->path_clear_duration_s = REAL(0.0);
    detour->stuck_duration_s = REAL(0.0);
    detour->has_lap_start = false;
    detour->lap_count = 0;
    detour->lap_distance_m = REAL(0.0);
    detour->lap_min_goal_distance_m = REAL_INFINITY;
    detour->is_leaving_contour = false;
}

/* Repulsive field of the thesis, eqs 6.14 to 6.17: away from obstacles, along body x and y (1/m). */
static void repulsive_force(const beam_ring_t *beams, const real_t ranges[], real_t threshold, real_t force[2])
{
    force[0] = REAL(0.0);
    force[1] = REAL(0.0);
    for (int32_t i = 0; i < beams->count; i++) {
        const real_t reach = ranges[i];
        if (reach < threshold) {
            const real_t f = (REAL(1.0) / real_max(reach, REAL(0.01))) - (REAL(1.0) / threshold);
            force[0] -= f * beams->cos[i];
            force[1] -= f * beams->sin[i];
        }
    }
}

/* Distance of a point from a line segment (m), in the horizontal plane. */
static real_t distance_from_line(const real_t here[], const real_t start[], const real_t goal[])
{
    const real_t n = goal[0] - start[0];
    const real_t e = goal[1] - start[1];
    const real_t square = (n * n) + (e * e);
    real_t along = REAL(0.0);

    if (square > REAL(0.0)) {
        along = (((here[0] - start[0]) * n) + ((here[1] - start[1]) * e)) / square;
    }
    along = real_min(real_max(along, REAL(0.0)), REAL(1.0));
    return real_hypot((here[0] - start[0]) - (along * n), (here[1] - start[1]) - (along * e));
}

/* Change sides if stuck or far off; after a whole lap leave at its nearest point to the goal. */
static void choose_passing_side(detour_t *d, const real_t goal[3], real_t to_goal, bool touching, real_t dt)
{
    const real_t before = d->passing_side;

    d->stuck_duration_s += dt;
    if (planar_distance(d->position, d->stuck_check_point) > REAL(0.25)) {
        d->stuck_check_point[0] = d->position[0];
        d->stuck_check_point[1] = d->position[1];
        d->stuck_duration_s = REAL(0.0);
    } else if (d->stuck_duration_s > STUCK_TIME_S) {
        d->passing_side = -d->passing_side;
        d->stuck_duration_s = REAL(0.0);
    } else {
        /* not stuck */
    }
    if (distance_from_line(d->position, d->hit_point, goal) > d->side_change_deviation_m) {
        d->passing_side = -d->passing_side;
        d->side_change_deviation_m = REAL(2.0) * d->side_change_deviation_m;
    }
    d->lap_min_goal_distance_m = real_min(d->lap_min_goal_distance_m, to_goal);
    d->lap_distance_m += real_vector_length(d->velocity) * dt;
    if (!d->has_lap_start || (d->passing_side != before)) {
        d->has_lap_start = touching;
        d->lap_start_point[0] = d->position[0];
        d->lap_start_point[1] = d->position[1];
        d->lap_distance_m = REAL(0.0);
        d->lap_min_goal_distance_m = to_goal;
    } else if ((d->lap_distance_m > REAL(1.5)) && (planar_distance(d->position, d->lap_start_point) < REAL(0.3))) {
        d->hit_goal_distance = d->lap_min_goal_distance_m + REAL(0.25);
        d->lap_count++;
        d->lap_distance_m = REAL(0.0);
        d->lap_min_goal_distance_m = to_goal;
    } else {
        /* lap not complete */
    }
}

/* Step the reference: its velocity follows wanted, with limited, low-pass filtered acceleration. */
static void step_detour_reference(detour_t *d, const real_t wanted[3], real_t dt)
{
    const real_t blend = REAL(1.0) - exp_decay(dt / ACCELERATION_LAG_S);
    real_t ask[3];
    real_t size;
    real_t scale = REAL(0.0);

    for (int32_t i = 0; i < 3; i++) {
        ask[i] = (wanted[i] - d->velocity[i]) / VELOCITY_LAG_S;
    }
    size = real_vector_length(ask);
    if (size > REAL(0.0)) {
        scale = real_min(REAL(1.0), DETOUR_ACCELERATION_M_S2 / size);
    }
    for (int32_t i = 0; i < 3; i++) {
        d->acceleration[i] += blend * ((scale * ask[i]) - d->acceleration[i]);
        d->velocity[i] += dt * d->acceleration[i];
        d->position[i] += dt * d->velocity[i];
    }
}

/* Nearest point of the contour, from the place where the path is planned. */
typedef struct {
    const real_t *at; /* reference, or helicopter if wind has displaced it */
    real_t far;
    real_t from[2]; /* unit vector from the point to at */
    bool touching;
} contour_point_t;

/* Velocity along the contour: with n from the point to the helicopter and t normal to it, V (t cos a - n sin a). */
static void contour_velocity(const detour_t *d, const path_check_t *sight, const contour_point_t *near, bool nearer_goal,
                          real_t distance, real_t speed, real_t wanted[3])
{
    real_t far = near->far;
    real_t n = near->from[0];
    real_t e = near->from[1];
    real_t block_from[2] = {REAL(0.0), REAL(0.0)};
    const real_t block = (sight->nearest_blocking_distance_sq < REAL_INFINITY)
                             ? distance_and_unit_vector(sight->nearest_blocking_point, near->at, block_from)
                             : REAL_INFINITY;
    real_t error;
    real_t slant;
    real_t along;
    real_t inward;
    /* Off any contour, or at a wrong contour's nearest point to the goal: head for the blocking point. */
    const bool lost = (d->lap_count > 0) && nearer_goal && (block > (distance + REAL(0.05)));

    if ((lost || !near->touching) && (block < REAL_INFINITY)) {
        far = block;
        n = block_from[0];
        e = block_from[1];
    }
    error = far - distance;
    slant = real_hypot(error, CONTOUR_CONVERGENCE_DISTANCE_M);
    along = CONTOUR_CONVERGENCE_DISTANCE_M / slant;
    inward = error / slant;
    /* Facing the obstacle, along -n, the right-hand direction is (n_E, -n_N). */
    wanted[0] = speed * (((along * d->passing_side) * e) - (inward * n));
    wanted[1] = speed * (((-along * d->passing_side) * n) - (inward * e));
}

void follow_contour(detour_t *detour, const path_check_t *sight, const beam_ring_t *beams, const real_t position[3],
                    real_t heading, const real_t ranges[], const real_t goal[3], real_t clearance, real_t speed,
                    real_t dt)
{
    const real_t distance = clearance + FOLLOW_CONTOUR_MARGIN_M;
    const real_t wide = (clearance + CLEAR_PATH_MARGIN_M) * (clearance + CLEAR_PATH_MARGIN_M);
    const real_t to_goal = planar_distance(goal, detour->position);
    real_t wanted[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    contour_point_t near;
    contour_point_t real;
    real_t force[2];
    real_t fast;
    real_t limit;
    bool clear;
    bool nearer_goal;
    bool goal_blocked;

    near.at = detour->position;
    near.far = find_nearest_point_distance(sight, detour->position, near.from);
    real.at = position;
    real.touching = false;
    real.far = find_nearest_point_distance(sight, position, real.from);
    nearer_goal = to_goal < (detour->hit_goal_distance - REAL(0.1));
    clear = (real.far > clearance) &&
            ((nearer_goal && (sight->path_start_clearance_sq > wide)) || ((detour->obstacle_count < 3) && (sight->path_clearance_sq > wide)));
    if (real.far < near.far) {
        near = real;
    }
    near.touching = near.far < (distance + ON_CONTOUR_MARGIN_M);
    detour->path_clear_duration_s = clear ? (detour->path_clear_duration_s + dt) : REAL(0.0);
    detour->is_leaving_contour = detour->path_clear_duration_s > REAL(0.3);
    goal_blocked = (sight->goal_clearance_sq < ((clearance + BLOCKED_PATH_MARGIN_M) * (clearance + BLOCKED_PATH_MARGIN_M))) &&
                   (to_goal < REAL(1.0));
    if (!detour->is_leaving_contour && !goal_blocked) {
        choose_passing_side(detour, goal, to_goal, near.touching, dt);
    }

    if (detour->is_leaving_contour) {
        /* brakes, then continues straight */
    } else if (goal_blocked) {
        const real_t push = real_min(speed, real_max(REAL(0.0), distance - near.far));
        wanted[0] = push * near.from[0];
        wanted[1] = push * near.from[1];
    } else if (near.far < (PATH_LOOK_AHEAD_M + REAL(0.5))) {
        contour_velocity(detour, sight, &near, nearer_goal, distance, speed, wanted);
    } else if (to_goal > REAL(1e-6)) {
        const real_t pace = real_min(speed, REAL(0.5) * to_goal);
        wanted[0] = (pace * (goal[0] - detour->position[0])) / to_goal;
        wanted[1] = (pace * (goal[1] - detour->position[1])) / to_goal;
    } else {
        /* at the goal */
    }

    repulsive_force(beams, ranges, distance, force);
    if ((force[0] != REAL(0.0)) || (force[1] != REAL(0.0))) {
        real_t s;
        real_t c;
        sine_cosine(heading, &s, &c);
        wanted[0] += REPULSION_GAIN * ((c * force[0]) - (s * force[1]));
        wanted[1] += REPULSION_GAIN * ((s * force[0]) + (c * force[1]));
    }
    limit_approach_velocity(sight, near.at, clearance + APPROACH_BARRIER_MARGIN_M, wanted);
    fast = real_hypot(wanted[0], wanted[1]);
    limit = speed * real_max(REAL(0.0), REAL(1.0) - (real_max(REAL(0.0), planar_distance(detour->position, position) - REAL(0.15)) /
                                                 REAL(0.15)));
    if (fast > limit) {
        wanted[0] = (wanted[0] * limit) / fast;
        wanted[1] = (wanted[1] * limit) / fast;
    }
    if (near.far < REAL(2.0)) {
        detour->obstacle_point[0] = near.at[0] - (near.far * near.from[0]);
        detour->obstacle_point[1] = near.at[1] - (near.far * near.from[1]);
    }
    step_detour_reference(detour, wanted, dt);
}

bool is_detour_finished(const detour_t *detour)
{
    return detour->is_leaving_contour && (real_vector_length(detour->velocity) < REAL(0.01)) &&
           (real_vector_length(detour->acceleration) < REAL(0.05));
}
