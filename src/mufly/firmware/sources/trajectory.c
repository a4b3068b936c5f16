#include "trajectory.h"

#include <stddef.h>

#define PEAK REAL(1.875)
#define SPOT REAL(1e-3) /* ways shorter than this are no ways: there is no direction to look in (m) */
#define TINY REAL(1e-9)
#define SLOWEST REAL(0.05) /* of a curve (m/s) */
#define NODES 3
#define HALVINGS 5 /* of a step, around each worst point of a curve */
#define ROOT_2 REAL(0x1.6a09e667f3bcdp+0)

/* Gauss-Legendre of three points. */
static const real_t nodes[NODES] = {REAL(-0x1.8c97ef43f7248p-1), REAL(0x0.0p+0), REAL(0x1.8c97ef43f7248p-1)};
static const real_t weights[NODES] = {REAL(0x1.1c71c71c71c72p-1), REAL(0x1.c71c71c71c71cp-1),
                                      REAL(0x1.1c71c71c71c72p-1)};

static void copied(const real_t from[3], real_t to[3])
{
    for (int32_t i = 0; i < 3; i++) {
        to[i] = from[i];
    }
}

static void zero(real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = REAL(0.0);
    }
}

/* Profiles: the quintic step of the speed */

void profile_make(real_t way, real_t speed, real_t acceleration, profile_t *out)
{
    out->way = REAL(0.0);
    out->speed = REAL(0.0);
    out->ramp_s = REAL(0.0);
    out->cruise_s = REAL(0.0);
    if (way > REAL(0.0)) {
        out->way = way;
        out->speed = real_min(speed, real_sqrt((acceleration * way) / PEAK));
        out->ramp_s = (PEAK * out->speed) / acceleration;
        out->cruise_s = real_max(REAL(0.0), (way / out->speed) - out->ramp_s);
    }
}

real_t profile_duration(const profile_t *p)
{
    return (REAL(2.0) * p->ramp_s) + p->cruise_s;
}

void profile_at(const profile_t *p, real_t t, real_t out[3])
{
    const real_t ramp = p->ramp_s;
    const real_t left = profile_duration(p) - t;

    zero(out);
    if (t <= REAL(0.0)) {
        /* at its start */
    } else if ((ramp <= REAL(0.0)) || (left <= REAL(0.0))) {
        out[0] = p->way;
    } else if ((t >= ramp) && (left >= ramp)) {
        out[0] = p->speed * (t - (REAL(0.5) * ramp));
        out[1] = p->speed;
    } else {
        const real_t x = real_min(t, left) / ramp;
        const real_t x2 = x * x;
        const real_t back = REAL(1.0) - x;
        const real_t way = (((p->speed * ramp) * x2) * x2) * ((REAL(2.5) - (REAL(3.0) * x)) + x2);
        const real_t speed = ((p->speed * x2) * x) * ((REAL(10.0) - (REAL(15.0) * x)) + (REAL(6.0) * x2));
        const real_t acceleration = (((p->speed / ramp) * REAL(30.0)) * x2) * (back * back);

        out[0] = (t < left) ? way : (p->way - way);
        out[1] = speed;
        out[2] = (t < left) ? acceleration : -acceleration;
    }
}

/* Coming to rest */

/* From 1 to 0 over x in 0..1: value, slope, integral from 0. */
static void step_down(real_t x, real_t out[3])
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

void stop_make(const real_t position[3], const real_t velocity[3], real_t heading, real_t acceleration,
               real_t heading_rate, real_t yaw_acceleration, stop_t *out)
{
    copied(position, out->start);
    copied(velocity, out->velocity);
    out->heading = heading;
    out->duration_s = (PEAK * real_length(velocity)) / acceleration;
    out->heading_rate = heading_rate;
    out->turn_s = (PEAK * real_abs(heading_rate)) / yaw_acceleration;
}

real_t stop_rest_s(const stop_t *brake)
{
    return real_max(brake->duration_s, brake->turn_s);
}

void stop_at(const stop_t *brake, real_t t, point_t *out)
{
    const real_t span = brake->duration_s;
    real_t step[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    real_t slope = REAL(0.0);
    real_t s;

    if (span > REAL(0.0)) {
        step_down(t / span, step);
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
    if (brake->turn_s > REAL(0.0)) {
        step_down(t / brake->turn_s, step);
        out->heading = brake->heading + ((brake->heading_rate * brake->turn_s) * step[2]);
        out->heading_rate = brake->heading_rate * step[0];
    }
}

/* Curves: cubic splines */

static real_t slope_of(const real_t c[4], real_t u)
{
    return ((((REAL(3.0) * c[0]) * u) + (REAL(2.0) * c[1])) * u) + c[2];
}

static real_t bend_of(const real_t c[4], real_t u)
{
    return ((REAL(6.0) * c[0]) * u) + (REAL(2.0) * c[1]);
}

static void tangent_of(const curve_t *c, real_t u, real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = slope_of(c->coefficients[i], u);
    }
}

static real_t square(const real_t v[3])
{
    return ((v[0] * v[0]) + (v[1] * v[1])) + (v[2] * v[2]);
}

static void cross(const real_t a[3], const real_t b[3], real_t out[3])
{
    out[0] = (a[1] * b[2]) - (a[2] * b[1]);
    out[1] = (a[2] * b[0]) - (a[0] * b[2]);
    out[2] = (a[0] * b[1]) - (a[1] * b[0]);
}

static real_t speed_at(const curve_t *c, real_t u)
{
    real_t tangent[3];

    tangent_of(c, u, tangent);
    return real_length(tangent);
}

/* Arc length by Gauss and Legendre from u on, over twice half. */
static real_t arc_from(const curve_t *c, real_t u, real_t half)
{
    real_t total = REAL(0.0);

    for (int32_t j = 0; j < NODES; j++) {
        total += weights[j] * speed_at(c, u + (half * (REAL(1.0) + nodes[j])));
    }
    return half * total;
}

static void measure(curve_t *c)
{
    const real_t half = REAL(0.5) / (real_t)CURVE_PIECES;

    c->arc[0] = REAL(0.0);
    for (int32_t k = 0; k < CURVE_PIECES; k++) {
        c->arc[k + 1] = c->arc[k] + arc_from(c, (real_t)k / (real_t)CURVE_PIECES, half);
    }
}

/* Square of the tangent's length; shares of the speed that are level, rise and sink, and curvature, all squared. */
static real_t asks_at(const curve_t *c, real_t u, real_t out[CURVE_ASKS])
{
    real_t tangent[3];
    real_t size;

    tangent_of(c, u, tangent);
    size = square(tangent);
    for (int32_t j = 0; j < CURVE_ASKS; j++) {
        out[j] = REAL(0.0);
    }
    if (!(size <= REAL(1e-12))) {
        real_t second[3];
        real_t across[3];

        for (int32_t i = 0; i < 3; i++) {
            second[i] = bend_of(c->coefficients[i], u);
        }
        cross(tangent, second, across);
        out[0] = ((tangent[0] * tangent[0]) + (tangent[1] * tangent[1])) / size;
        out[2] = (tangent[2] * real_abs(tangent[2])) / size;
        out[1] = -out[2];
        out[3] = square(across) / ((size * size) * size);
    }
    return size;
}

/* Least size and greatest of what the points of a curve ask: each is sought in equal steps, */
static void look_along(const curve_t *c, worst_t *worst)
{
    real_t asks[CURVE_ASKS];

    worst->least = REAL_INFINITY;
    for (int32_t j = 0; j < CURVE_ASKS; j++) {
        worst->asks[j] = REAL(0.0);
        worst->where[j] = REAL(0.0);
    }
    for (int32_t k = 0; k <= CURVE_PIECES; k++) {
        const real_t u = (real_t)k / (real_t)CURVE_PIECES;

        worst->least = real_min(worst->least, asks_at(c, u, asks));
        for (int32_t j = 0; j < CURVE_ASKS; j++) {
            if (asks[j] > worst->asks[j]) {
                worst->asks[j] = asks[j];
                worst->where[j] = u;
            }
        }
    }
}

/* and in halves of a step to either side of the best yet. */
static void look_closer(const curve_t *c, worst_t *worst)
{
    real_t asks[CURVE_ASKS];

    for (int32_t j = 0; j < CURVE_ASKS; j++) {
        real_t step = REAL(1.0) / (real_t)CURVE_PIECES;

        for (int32_t h = 0; (h < HALVINGS) && (worst->asks[j] > REAL(0.0)); h++) {
            const real_t middle = worst->where[j];

            step *= REAL(0.5);
            for (int32_t side = -1; side <= 1; side += 2) {
                const real_t u = middle + ((real_t)side * step);
                const real_t size = asks_at(c, u, asks);

                if ((u >= REAL(0.0)) && (u <= REAL(1.0)) && (asks[j] > worst->asks[j])) {
                    worst->least = real_min(worst->least, size);
                    worst->asks[j] = asks[j];
                    worst->where[j] = u;
                }
            }
        }
    }
}

/* Give the curve its timing; false where it has a point without tangent or too tight a bend. */
static bool time_curve(curve_t *c, const worst_t *worst, const real_t pace[4])
{
    const real_t share = pace[3] / ROOT_2;
    const real_t whole = c->arc[CURVE_PIECES];
    bool can = false;

    if (!(real_sqrt(worst->least) < (REAL(0.05) * real_max(whole, TINY)))) {
        real_t peak = pace[0] / real_max(real_sqrt(worst->asks[0]), TINY);

        peak = real_min(peak, pace[1] / real_max(real_sqrt(worst->asks[1]), TINY));
        peak = real_min(peak, pace[2] / real_max(real_sqrt(worst->asks[2]), TINY));
        peak = real_min(peak, real_sqrt(share / real_max(real_sqrt(worst->asks[3]), TINY)));
        if (peak >= SLOWEST) {
            profile_make(whole, peak, share, &c->timing);
            can = true;
        }
    }
    return can;
}

static real_t arc_at(const curve_t *c, int32_t k, real_t u)
{
    const real_t start = (real_t)k / (real_t)CURVE_PIECES;

    return c->arc[k] + arc_from(c, start, REAL(0.5) * (u - start));
}

/* The piece of the table that holds the way s. */
static int32_t piece_at(const curve_t *c, real_t s)
{
    int32_t low = 0;
    int32_t high = CURVE_PIECES;

    while ((high - low) > 1) {
        const int32_t middle = (low + high) / 2;
        if (c->arc[middle] <= s) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

static void curve_at(const curve_t *c, real_t t, point_t *out)
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

    profile_at(&c->timing, t, s);
    k = piece_at(c, s[0]);
    u = ((real_t)k + ((s[0] - c->arc[k]) / (c->arc[k + 1] - c->arc[k]))) / (real_t)CURVE_PIECES;
    /* The table inverts the way linearly; a Newton step makes it smooth. */
    u -= (arc_at(c, k, u) - s[0]) / speed_at(c, u);
    tangent_of(c, u, tangent);
    for (int32_t i = 0; i < 3; i++) {
        second[i] = bend_of(c->coefficients[i], u);
    }
    size = square(tangent);
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

void trajectory_straight(const real_t start[3], const real_t goal[3], real_t heading, const limits_t *limits,
                         const real_t *final_heading, real_t nose_offset, trajectory_t *out)
{
    const real_t n = goal[0] - start[0];
    const real_t e = goal[1] - start[1];
    const real_t fall = goal[2] - start[2];
    real_t way = real_hypot(n, e);

    copied(start, out->start);
    copied(goal, out->goal);
    out->heading = heading;
    if (final_heading != NULL) {
        out->turn = real_wrapped(*final_heading - heading);
    } else if (way < SPOT) {
        out->turn = REAL(0.0);
    } else {
        out->turn = real_wrapped((real_atan2(e, n) + nose_offset) - heading);
    }
    if (way < SPOT) {
        way = REAL(0.0);
        out->goal[0] = start[0];
        out->goal[1] = start[1];
    }
    profile_make(real_abs(fall), (fall > REAL(0.0)) ? limits->descent : limits->climb, limits->climb_acceleration,
                 &out->rise);
    profile_make(real_abs(out->turn), limits->yaw_rate, limits->yaw_acceleration, &out->yaw);
    profile_make(way, limits->speed, limits->acceleration, &out->way);
    out->gate_s = real_max(profile_duration(&out->rise), profile_duration(&out->yaw));
    out->duration_s = out->gate_s + profile_duration(&out->way);
    out->has_curve = false;
    out->has_lead = false;
    out->making = 0;
}

/* The derivative at an end: a direction times the distance of both ends. */
static void end_of(const real_t direction[3], real_t reach, const real_t chord[3], real_t out[3])
{
    const real_t size = real_length(direction);

    for (int32_t i = 0; i < 3; i++) {
        out[i] = (size > TINY) ? ((direction[i] / size) * reach) : chord[i];
    }
}

void trajectory_begin_curved(const real_t start[3], const real_t goal[3], const real_t leaving[3],
                             const real_t arriving[3], real_t heading, const limits_t *limits,
                             const real_t *final_heading, real_t nose_offset, trajectory_t *out)
{
    real_t chord[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    real_t first[3];
    real_t last[3];
    real_t reach;
    real_t acceleration = limits->acceleration;

    trajectory_straight(start, goal, heading, limits, final_heading, nose_offset, out);
    for (int32_t i = 0; i < 3; i++) {
        chord[i] = out->goal[i] - out->start[i];
    }
    reach = real_length(chord);
    if (reach >= SPOT) {
        curve_t *c = &out->curve;

        end_of(leaving, reach, chord, first);
        end_of(arriving, reach, chord, last);
        for (int32_t i = 0; i < 3; i++) {
            const real_t p = out->start[i];
            const real_t g = out->goal[i];

            c->coefficients[i][0] = ((REAL(2.0) * (p - g)) + first[i]) + last[i];
            c->coefficients[i][1] = ((REAL(3.0) * (g - p)) - (REAL(2.0) * first[i])) - last[i];
            c->coefficients[i][2] = first[i];
            c->coefficients[i][3] = p;
        }
        /* One that rises or sinks has its whole acceleration within the vertical limit. */
        if ((real_abs(chord[2]) > REAL(0.0)) || (real_abs(first[2]) > REAL(0.0)) || (real_abs(last[2]) > REAL(0.0))) {
            acceleration = real_min(limits->acceleration, limits->climb_acceleration);
        }
        out->pace[0] = limits->speed;
        out->pace[1] = limits->climb;
        out->pace[2] = limits->descent;
        out->pace[3] = acceleration;
        out->making = CURVE_PARTS;
    }
}

void trajectory_go_on(trajectory_t *way)
{
    curve_t *c = &way->curve;

    if (way->making == CURVE_PARTS) {
        measure(c);
    } else if (way->making == (CURVE_PARTS - 1)) {
        look_along(c, &way->worst);
    } else if (way->making == 1) {
        look_closer(c, &way->worst);
        if (time_curve(c, &way->worst, way->pace)) {
            way->has_curve = true;
            profile_make(REAL(0.0), REAL(1.0), REAL(1.0), &way->rise);
            way->way = c->timing;
            way->gate_s = profile_duration(&way->yaw);
            way->duration_s = way->gate_s + profile_duration(&c->timing);
            if (way->has_lead) {
                way->gate_s = way->gate_s + stop_rest_s(&way->lead);
                way->duration_s = way->duration_s + stop_rest_s(&way->lead);
            }
        }
    } else {
        /* all is done */
    }
    way->making = (way->making > 0) ? (way->making - 1) : 0;
}

void trajectory_after(trajectory_t *way, const stop_t *brake)
{
    const real_t t = stop_rest_s(brake);

    way->lead = *brake;
    way->has_lead = true;
    way->gate_s = way->gate_s + t;
    way->duration_s = way->duration_s + t;
}

static void turned(const trajectory_t *way, real_t t, point_t *out)
{
    real_t s[3];

    out->heading = way->heading + way->turn;
    out->heading_rate = REAL(0.0);
    if (t < profile_duration(&way->yaw)) {
        const real_t sign = real_with_sign(REAL(1.0), way->turn);

        profile_at(&way->yaw, t, s);
        out->heading = way->heading + (sign * s[0]);
        out->heading_rate = sign * s[1];
    }
}

void trajectory_at(const trajectory_t *way, real_t t, point_t *out)
{
    real_t s[3];
    real_t gate = way->gate_s;
    real_t time = t;

    if (way->has_lead) {
        time = t - stop_rest_s(&way->lead);
        gate = way->gate_s - stop_rest_s(&way->lead);
    }
    if (way->has_lead && (t < stop_rest_s(&way->lead))) {
        stop_at(&way->lead, t, out);
    } else if (way->has_curve) {
        turned(way, time, out);
        curve_at(&way->curve, time - gate, out);
    } else {
        turned(way, time, out);
        zero(out->velocity);
        zero(out->acceleration);
        if (time < gate) {
            const real_t sign = (way->goal[2] > way->start[2]) ? REAL(1.0) : REAL(-1.0);

            profile_at(&way->rise, time, s);
            copied(way->start, out->position);
            out->position[2] = way->start[2] + (sign * s[0]);
            out->velocity[2] = sign * s[1];
            out->acceleration[2] = sign * s[2];
        } else {
            copied(way->goal, out->position);
            if (way->way.way > REAL(0.0)) {
                profile_at(&way->way, time - gate, s);
                for (int32_t i = 0; i < 2; i++) {
                    const real_t u = (way->goal[i] - way->start[i]) / way->way.way;

                    out->position[i] = way->start[i] + (s[0] * u);
                    out->velocity[i] = s[1] * u;
                    out->acceleration[i] = s[2] * u;
                }
            }
        }
    }
}
