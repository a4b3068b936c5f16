#include "mission/trajectory.h"

#include <stddef.h>

#define PEAK_SPEED_RATIO REAL(1.875)
#define MIN_DISTANCE_M REAL(1e-3) /* distance below which a path has no direction (m) */
#define MIN_DENOMINATOR REAL(1e-9)
#define MIN_CURVE_SPEED_M_S REAL(0.05) /* least speed of a curve (m/s) */
#define GAUSS_NODE_COUNT 3
#define EXTREME_REFINEMENT_COUNT 5 /* of a step, around each extreme point of a curve */
#define ROOT_2 REAL(0x1.6a09e667f3bcdp+0)

/* Three-point Gauss-Legendre rule. */
static const real_t gauss_nodes[GAUSS_NODE_COUNT] = {REAL(-0x1.8c97ef43f7248p-1), REAL(0x0.0p+0), REAL(0x1.8c97ef43f7248p-1)};
static const real_t gauss_weights[GAUSS_NODE_COUNT] = {REAL(0x1.1c71c71c71c72p-1), REAL(0x1.c71c71c71c71cp-1),
                                      REAL(0x1.1c71c71c71c72p-1)};

static void copy_triple(const real_t from[3], real_t to[3])
{
    for (int32_t i = 0; i < 3; i++) {
        to[i] = from[i];
    }
}

static void zero_triple(real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = REAL(0.0);
    }
}

/* Profiles: the quintic step of the speed */

void make_motion_profile(real_t way, real_t speed, real_t acceleration, motion_profile_t *out)
{
    out->distance = REAL(0.0);
    out->peak_speed = REAL(0.0);
    out->ramp_s = REAL(0.0);
    out->cruise_s = REAL(0.0);
    if (way > REAL(0.0)) {
        out->distance = way;
        out->peak_speed = real_min(speed, real_sqrt((acceleration * way) / PEAK_SPEED_RATIO));
        out->ramp_s = (PEAK_SPEED_RATIO * out->peak_speed) / acceleration;
        out->cruise_s = real_max(REAL(0.0), (way / out->peak_speed) - out->ramp_s);
    }
}

real_t profile_duration_s(const motion_profile_t *p)
{
    return (REAL(2.0) * p->ramp_s) + p->cruise_s;
}

void profile_evaluate(const motion_profile_t *p, real_t t, real_t out[3])
{
    const real_t ramp = p->ramp_s;
    const real_t left = profile_duration_s(p) - t;

    zero_triple(out);
    if (t <= REAL(0.0)) {
        /* at the start */
    } else if ((ramp <= REAL(0.0)) || (left <= REAL(0.0))) {
        out[0] = p->distance;
    } else if ((t >= ramp) && (left >= ramp)) {
        out[0] = p->peak_speed * (t - (REAL(0.5) * ramp));
        out[1] = p->peak_speed;
    } else {
        const real_t x = real_min(t, left) / ramp;
        const real_t x2 = x * x;
        const real_t back = REAL(1.0) - x;
        const real_t way = (((p->peak_speed * ramp) * x2) * x2) * ((REAL(2.5) - (REAL(3.0) * x)) + x2);
        const real_t speed = ((p->peak_speed * x2) * x) * ((REAL(10.0) - (REAL(15.0) * x)) + (REAL(6.0) * x2));
        const real_t acceleration = (((p->peak_speed / ramp) * REAL(30.0)) * x2) * (back * back);

        out[0] = (t < left) ? way : (p->distance - way);
        out[1] = speed;
        out[2] = (t < left) ? acceleration : -acceleration;
    }
}

/* Braking to rest */

/* Smooth step from 1 to 0 over x in 0..1: value, slope, integral from 0. */
static void smooth_step_down(real_t x, real_t out[3])
{
    if (x <= REAL(0.0)) {
        out[0] = REAL(1.0);
        out[1] = REAL(0.0);
        out[2] = REAL(0.0);
    } else if (x >= REAL(1.0)) {
        out[0] = REAL(0.0);
        out[1] = REAL(0.0);
        out[2] = REAL(0.5);
    } else {
        const real_t x2 = x * x;
        const real_t back = REAL(1.0) - x;

        out[0] = REAL(1.0) - ((x2 * x) * ((REAL(10.0) - (REAL(15.0) * x)) + (REAL(6.0) * x2)));
        out[1] = (REAL(-30.0) * x2) * (back * back);
        out[2] = x - ((x2 * x2) * ((REAL(2.5) - (REAL(3.0) * x)) + x2));
    }
}

void plan_stop(const real_t position[3], const real_t velocity[3], real_t heading, real_t acceleration,
               real_t heading_rate, real_t yaw_acceleration, braking_motion_t *out)
{
    copy_triple(position, out->start);
    copy_triple(velocity, out->velocity);
    out->heading = heading;
    out->duration_s = (PEAK_SPEED_RATIO * real_vector_length(velocity)) / acceleration;
    out->heading_rate = heading_rate;
    out->turn_duration_s = (PEAK_SPEED_RATIO * real_abs(heading_rate)) / yaw_acceleration;
}

real_t braking_rest_time_s(const braking_motion_t *brake)
{
    return real_max(brake->duration_s, brake->turn_duration_s);
}

void braking_evaluate(const braking_motion_t *brake, real_t t, trajectory_point_t *out)
{
    const real_t span = brake->duration_s;
    real_t step[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    real_t slope = REAL(0.0);
    real_t s;

    if (span > REAL(0.0)) {
        smooth_step_down(t / span, step);
        slope = step[1] / span;
    }
    s = step[2] * span;
    for (int32_t i = 0; i < 3; i++) {
        out->position[i] = brake->start[i] + (brake->velocity[i] * s);
        out->velocity[i] = brake->velocity[i] * step[0];
        out->acceleration[i] = brake->velocity[i] * slope;
    }
    out->heading = brake->heading;
    out->heading_rate = REAL(0.0);
    if (brake->turn_duration_s > REAL(0.0)) {
        smooth_step_down(t / brake->turn_duration_s, step);
        out->heading = brake->heading + ((brake->heading_rate * brake->turn_duration_s) * step[2]);
        out->heading_rate = brake->heading_rate * step[0];
    }
}

/* Curves: cubic splines */

static real_t cubic_derivative(const real_t c[4], real_t u)
{
    return ((((REAL(3.0) * c[0]) * u) + (REAL(2.0) * c[1])) * u) + c[2];
}

static real_t cubic_second_derivative(const real_t c[4], real_t u)
{
    return ((REAL(6.0) * c[0]) * u) + (REAL(2.0) * c[1]);
}

static void spline_tangent(const timed_spline_t *c, real_t u, real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = cubic_derivative(c->coefficients[i], u);
    }
}

static real_t squared_length(const real_t v[3])
{
    return ((v[0] * v[0]) + (v[1] * v[1])) + (v[2] * v[2]);
}

static void cross_product(const real_t a[3], const real_t b[3], real_t out[3])
{
    out[0] = (a[1] * b[2]) - (a[2] * b[1]);
    out[1] = (a[2] * b[0]) - (a[0] * b[2]);
    out[2] = (a[0] * b[1]) - (a[1] * b[0]);
}

static real_t tangent_length(const timed_spline_t *c, real_t u)
{
    real_t tangent[3];

    spline_tangent(c, u, tangent);
    return real_vector_length(tangent);
}

/* Arc length by the Gauss-Legendre rule from u to u plus twice half. */
static real_t arc_length(const timed_spline_t *c, real_t u, real_t half)
{
    real_t total = REAL(0.0);

    for (int32_t j = 0; j < GAUSS_NODE_COUNT; j++) {
        total += gauss_weights[j] * tangent_length(c, u + (half * (REAL(1.0) + gauss_nodes[j])));
    }
    return half * total;
}

static void tabulate_arc_length(timed_spline_t *c)
{
    const real_t half = REAL(0.5) / (real_t)ARC_PIECE_COUNT;

    c->arc_lengths[0] = REAL(0.0);
    for (int32_t k = 0; k < ARC_PIECE_COUNT; k++) {
        c->arc_lengths[k + 1] = c->arc_lengths[k] + arc_length(c, (real_t)k / (real_t)ARC_PIECE_COUNT, half);
    }
}

/* Squared tangent length; squared level, climbing and descending shares of speed, and curvature. */
static real_t evaluate_speed_and_curvature(const timed_spline_t *c, real_t u, real_t out[CURVE_DEMAND_COUNT])
{
    real_t tangent[3];
    real_t size;

    spline_tangent(c, u, tangent);
    size = squared_length(tangent);
    for (int32_t j = 0; j < CURVE_DEMAND_COUNT; j++) {
        out[j] = REAL(0.0);
    }
    if (!(size <= REAL(1e-12))) {
        real_t second[3];
        real_t across[3];

        for (int32_t i = 0; i < 3; i++) {
            second[i] = cubic_second_derivative(c->coefficients[i], u);
        }
        cross_product(tangent, second, across);
        out[0] = ((tangent[0] * tangent[0]) + (tangent[1] * tangent[1])) / size;
        out[2] = (tangent[2] * real_abs(tangent[2])) / size;
        out[1] = -out[2];
        out[3] = squared_length(across) / ((size * size) * size);
    }
    return size;
}

/* Search the least tangent and the greatest demands over a curve in equal steps, */
static void find_extreme_speed_and_curvature(const timed_spline_t *c, curve_extremes_t *worst)
{
    real_t asks[CURVE_DEMAND_COUNT];

    worst->least_squared_tangent = REAL_INFINITY;
    for (int32_t j = 0; j < CURVE_DEMAND_COUNT; j++) {
        worst->demands[j] = REAL(0.0);
        worst->demand_parameters[j] = REAL(0.0);
    }
    for (int32_t k = 0; k <= ARC_PIECE_COUNT; k++) {
        const real_t u = (real_t)k / (real_t)ARC_PIECE_COUNT;

        worst->least_squared_tangent = real_min(worst->least_squared_tangent, evaluate_speed_and_curvature(c, u, asks));
        for (int32_t j = 0; j < CURVE_DEMAND_COUNT; j++) {
            if (asks[j] > worst->demands[j]) {
                worst->demands[j] = asks[j];
                worst->demand_parameters[j] = u;
            }
        }
    }
}

/* then by halving the step around each best point. */
static void refine_extreme_demands(const timed_spline_t *c, curve_extremes_t *worst)
{
    real_t asks[CURVE_DEMAND_COUNT];

    for (int32_t j = 0; j < CURVE_DEMAND_COUNT; j++) {
        real_t step = REAL(1.0) / (real_t)ARC_PIECE_COUNT;

        for (int32_t h = 0; (h < EXTREME_REFINEMENT_COUNT) && (worst->demands[j] > REAL(0.0)); h++) {
            const real_t middle = worst->demand_parameters[j];

            step *= REAL(0.5);
            for (int32_t side = -1; side <= 1; side += 2) {
                const real_t u = middle + ((real_t)side * step);
                const real_t size = evaluate_speed_and_curvature(c, u, asks);

                if ((u >= REAL(0.0)) && (u <= REAL(1.0)) && (asks[j] > worst->demands[j])) {
                    worst->least_squared_tangent = real_min(worst->least_squared_tangent, size);
                    worst->demands[j] = asks[j];
                    worst->demand_parameters[j] = u;
                }
            }
        }
    }
}

/* Time the curve; false if it has a point without tangent or too tight a bend. */
static bool compute_timed_spline(timed_spline_t *c, const curve_extremes_t *worst, const real_t pace[4])
{
    const real_t share = pace[3] / ROOT_2;
    const real_t whole = c->arc_lengths[ARC_PIECE_COUNT];
    bool can = false;

    if (!(real_sqrt(worst->least_squared_tangent) < (REAL(0.05) * real_max(whole, MIN_DENOMINATOR)))) {
        real_t peak = pace[0] / real_max(real_sqrt(worst->demands[0]), MIN_DENOMINATOR);

        peak = real_min(peak, pace[1] / real_max(real_sqrt(worst->demands[1]), MIN_DENOMINATOR));
        peak = real_min(peak, pace[2] / real_max(real_sqrt(worst->demands[2]), MIN_DENOMINATOR));
        peak = real_min(peak, real_sqrt(share / real_max(real_sqrt(worst->demands[3]), MIN_DENOMINATOR)));
        if (peak >= MIN_CURVE_SPEED_M_S) {
            make_motion_profile(whole, peak, share, &c->speed_profile);
            can = true;
        }
    }
    return can;
}

static real_t arc_length_at(const timed_spline_t *c, int32_t k, real_t u)
{
    const real_t start = (real_t)k / (real_t)ARC_PIECE_COUNT;

    return c->arc_lengths[k] + arc_length(c, start, REAL(0.5) * (u - start));
}

/* Index of the table piece that contains the arc length s. */
static int32_t find_arc_piece(const timed_spline_t *c, real_t s)
{
    int32_t low = 0;
    int32_t high = ARC_PIECE_COUNT;

    while ((high - low) > 1) {
        const int32_t middle = (low + high) / 2;
        if (c->arc_lengths[middle] <= s) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

static void timed_spline_evaluate(const timed_spline_t *c, real_t t, trajectory_point_t *out)
{
    real_t s[3];
    real_t tangent[3];
    real_t second[3];
    real_t size;
    real_t along;
    real_t f;
    real_t g;
    real_t u;
    int32_t k;

    profile_evaluate(&c->speed_profile, t, s);
    k = find_arc_piece(c, s[0]);
    u = ((real_t)k + ((s[0] - c->arc_lengths[k]) / (c->arc_lengths[k + 1] - c->arc_lengths[k]))) / (real_t)ARC_PIECE_COUNT;
    /* The table inverts the arc length linearly; a Newton step makes the result smooth. */
    u -= (arc_length_at(c, k, u) - s[0]) / tangent_length(c, u);
    spline_tangent(c, u, tangent);
    for (int32_t i = 0; i < 3; i++) {
        second[i] = cubic_second_derivative(c->coefficients[i], u);
    }
    size = squared_length(tangent);
    along = (((tangent[0] * second[0]) + (tangent[1] * second[1])) + (tangent[2] * second[2])) / size;
    f = s[2] / real_sqrt(size);
    g = (s[1] * s[1]) / size;
    for (int32_t i = 0; i < 3; i++) {
        const real_t *p = c->coefficients[i];

        out->position[i] = (((((p[0] * u) + p[1]) * u) + p[2]) * u) + p[3];
        out->velocity[i] = (s[1] * tangent[i]) / real_sqrt(size);
        out->acceleration[i] = (f * tangent[i]) + (g * (second[i] - (along * tangent[i])));
    }
}

/* Trajectories */

void plan_straight(const real_t start[3], const real_t goal[3], real_t heading, const trajectory_limits_t *limits,
                         const real_t *final_heading, real_t nose_offset, trajectory_t *out)
{
    const real_t n = goal[0] - start[0];
    const real_t e = goal[1] - start[1];
    const real_t fall = goal[2] - start[2];
    real_t way = real_hypot(n, e);

    copy_triple(start, out->start);
    copy_triple(goal, out->goal);
    out->start_heading = heading;
    if (final_heading != NULL) {
        out->turn_angle = real_wrap_angle(*final_heading - heading);
    } else if (way < MIN_DISTANCE_M) {
        out->turn_angle = REAL(0.0);
    } else {
        out->turn_angle = real_wrap_angle((real_atan2(e, n) + nose_offset) - heading);
    }
    if (way < MIN_DISTANCE_M) {
        way = REAL(0.0);
        out->goal[0] = start[0];
        out->goal[1] = start[1];
    }
    make_motion_profile(real_abs(fall), (fall > REAL(0.0)) ? limits->descent : limits->climb, limits->climb_acceleration,
                 &out->height_profile);
    make_motion_profile(real_abs(out->turn_angle), limits->yaw_rate, limits->yaw_acceleration, &out->yaw_profile);
    make_motion_profile(way, limits->speed, limits->acceleration, &out->path_profile);
    out->path_start_s = real_max(profile_duration_s(&out->height_profile), profile_duration_s(&out->yaw_profile));
    out->duration_s = out->path_start_s + profile_duration_s(&out->path_profile);
    out->has_spline_curve = false;
    out->has_initial_braking = false;
    out->pending_parts = 0;
}

/* Derivative at an end: unit direction times the distance of both ends. */
static void end_derivative(const real_t direction[3], real_t reach, const real_t chord[3], real_t out[3])
{
    const real_t size = real_vector_length(direction);

    for (int32_t i = 0; i < 3; i++) {
        out[i] = (size > MIN_DENOMINATOR) ? ((direction[i] / size) * reach) : chord[i];
    }
}

void plan_pending_curve(const real_t start[3], const real_t goal[3], const real_t leaving[3],
                             const real_t arriving[3], real_t heading, const trajectory_limits_t *limits,
                             const real_t *final_heading, real_t nose_offset, trajectory_t *out)
{
    real_t chord[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    real_t first[3];
    real_t last[3];
    real_t reach;
    real_t acceleration = limits->acceleration;

    plan_straight(start, goal, heading, limits, final_heading, nose_offset, out);
    for (int32_t i = 0; i < 3; i++) {
        chord[i] = out->goal[i] - out->start[i];
    }
    reach = real_vector_length(chord);
    if (reach >= MIN_DISTANCE_M) {
        timed_spline_t *c = &out->spline_curve;

        end_derivative(leaving, reach, chord, first);
        end_derivative(arriving, reach, chord, last);
        for (int32_t i = 0; i < 3; i++) {
            const real_t p = out->start[i];
            const real_t g = out->goal[i];

            c->coefficients[i][0] = ((REAL(2.0) * (p - g)) + first[i]) + last[i];
            c->coefficients[i][1] = ((REAL(3.0) * (g - p)) - (REAL(2.0) * first[i])) - last[i];
            c->coefficients[i][2] = first[i];
            c->coefficients[i][3] = p;
        }
        /* On a climbing or descending curve the total acceleration keeps the vertical limit. */
        if ((real_abs(chord[2]) > REAL(0.0)) || (real_abs(first[2]) > REAL(0.0)) || (real_abs(last[2]) > REAL(0.0))) {
            acceleration = real_min(limits->acceleration, limits->climb_acceleration);
        }
        out->curve_limits[0] = limits->speed;
        out->curve_limits[1] = limits->climb;
        out->curve_limits[2] = limits->descent;
        out->curve_limits[3] = acceleration;
        out->pending_parts = CURVE_WORK_PARTS;
    }
}

void advance_pending_curve(trajectory_t *way)
{
    timed_spline_t *c = &way->spline_curve;

    if (way->pending_parts == CURVE_WORK_PARTS) {
        tabulate_arc_length(c);
    } else if (way->pending_parts == (CURVE_WORK_PARTS - 1)) {
        find_extreme_speed_and_curvature(c, &way->curve_extremes);
    } else if (way->pending_parts == 1) {
        refine_extreme_demands(c, &way->curve_extremes);
        if (compute_timed_spline(c, &way->curve_extremes, way->curve_limits)) {
            way->has_spline_curve = true;
            make_motion_profile(REAL(0.0), REAL(1.0), REAL(1.0), &way->height_profile);
            way->path_profile = c->speed_profile;
            way->path_start_s = profile_duration_s(&way->yaw_profile);
            way->duration_s = way->path_start_s + profile_duration_s(&c->speed_profile);
            if (way->has_initial_braking) {
                way->path_start_s = way->path_start_s + braking_rest_time_s(&way->initial_braking);
                way->duration_s = way->duration_s + braking_rest_time_s(&way->initial_braking);
            }
        }
    } else {
        /* no work left */
    }
    way->pending_parts = (way->pending_parts > 0) ? (way->pending_parts - 1) : 0;
}

void add_initial_braking(trajectory_t *way, const braking_motion_t *brake)
{
    const real_t t = braking_rest_time_s(brake);

    way->initial_braking = *brake;
    way->has_initial_braking = true;
    way->path_start_s = way->path_start_s + t;
    way->duration_s = way->duration_s + t;
}

static void evaluate_turn(const trajectory_t *way, real_t t, trajectory_point_t *out)
{
    real_t s[3];

    out->heading = way->start_heading + way->turn_angle;
    out->heading_rate = REAL(0.0);
    if (t < profile_duration_s(&way->yaw_profile)) {
        const real_t sign = real_copysign(REAL(1.0), way->turn_angle);

        profile_evaluate(&way->yaw_profile, t, s);
        out->heading = way->start_heading + (sign * s[0]);
        out->heading_rate = sign * s[1];
    }
}

void trajectory_evaluate(const trajectory_t *way, real_t t, trajectory_point_t *out)
{
    real_t s[3];
    real_t gate = way->path_start_s;
    real_t time = t;

    if (way->has_initial_braking) {
        time = t - braking_rest_time_s(&way->initial_braking);
        gate = way->path_start_s - braking_rest_time_s(&way->initial_braking);
    }
    if (way->has_initial_braking && (t < braking_rest_time_s(&way->initial_braking))) {
        braking_evaluate(&way->initial_braking, t, out);
    } else if (way->has_spline_curve) {
        evaluate_turn(way, time, out);
        timed_spline_evaluate(&way->spline_curve, time - gate, out);
    } else {
        evaluate_turn(way, time, out);
        zero_triple(out->velocity);
        zero_triple(out->acceleration);
        if (time < gate) {
            const real_t sign = (way->goal[2] > way->start[2]) ? REAL(1.0) : REAL(-1.0);

            profile_evaluate(&way->height_profile, time, s);
            copy_triple(way->start, out->position);
            out->position[2] = way->start[2] + (sign * s[0]);
            out->velocity[2] = sign * s[1];
            out->acceleration[2] = sign * s[2];
        } else {
            copy_triple(way->goal, out->position);
            if (way->path_profile.distance > REAL(0.0)) {
                profile_evaluate(&way->path_profile, time - gate, s);
                for (int32_t i = 0; i < 2; i++) {
                    const real_t u = (way->goal[i] - way->start[i]) / way->path_profile.distance;

                    out->position[i] = way->start[i] + (s[0] * u);
                    out->velocity[i] = s[1] * u;
                    out->acceleration[i] = s[2] * u;
                }
            }
        }
    }
}
