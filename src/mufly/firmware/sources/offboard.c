#include "offboard.h"

#include <stddef.h>

#define BANDWIDTH REAL(3.0)
#define STEP_S REAL(0.02)
#define TRAILS_M REAL(0.5)
#define SMOOTH_S REAL(0.08)
#define FAR_M REAL(1e4)
#define FAST_M_S REAL(50.0)
#define FAST_RAD_S REAL(50.0)

/* A number that is given and beyond its bound sets this. */
static void within(real_t value, real_t most, bool *said, bool *right)
{
    *said = *said || !real_missing(value);
    *right = *right && !(real_abs(value) > most);
}

bool offboard_right(const set_point_t *wanted)
{
    bool said = false;
    bool right = true;

    for (int32_t i = 0; i < 3; i++) {
        within(wanted->position[i], FAR_M, &said, &right);
        within(wanted->velocity[i], FAST_M_S, &said, &right);
    }
    within(wanted->heading, FAR_M, &said, &right);
    within(wanted->yaw_rate, FAST_RAD_S, &said, &right);
    return said && right;
}

bool offboard_wants_up(const set_point_t *wanted, const real_t standing[3])
{
    const bool higher = wanted->position[2] < real_min(standing[2] - REAL(0.1), -LOWEST_M + REAL(1e-9));

    return higher || (wanted->velocity[2] < REAL(-0.01));
}

static real_t or_zero(real_t x)
{
    return real_missing(x) ? REAL(0.0) : x;
}

static real_t gap_to(real_t target, real_t at)
{
    return real_missing(target) ? REAL(0.0) : (target - at);
}

/* Speed from which half the acceleration brakes in time. */
static real_t approach(real_t gap, real_t acceleration)
{
    const real_t half = REAL(0.5) * acceleration;
    const real_t slope = REAL(0.5) * BANDWIDTH;
    const real_t linear = half / (slope * slope);

    return (gap < linear) ? (slope * gap) : real_sqrt((REAL(2.0) * half) * (gap - (REAL(0.5) * linear)));
}

/* Velocity with which a bound at gap (m, down) may be approached, or has to be returned to. */
static real_t toward(real_t gap, const limits_t *limits)
{
    return real_with_sign(approach(real_abs(gap), limits->climb_acceleration), gap);
}

/* What a change of velocity is multiplied with: at most this acceleration, and never past it. */
static real_t gain_of(real_t dx, real_t dy, real_t most, real_t dt)
{
    const real_t gain = real_min(REAL(2.0) * BANDWIDTH, REAL(1.0) / dt);
    const real_t size = gain * real_hypot(dx, dy);

    return gain * ((size > most) ? (most / size) : REAL(1.0));
}

static void part(point_t *t, const set_point_t *wanted, const limits_t *limits, const real_t measured[3], real_t dt,
                 const sight_t *sight, real_t clearance)
{
    const real_t off[3] = {t->position[0] - measured[0], t->position[1] - measured[1],
                           t->position[2] - measured[2]};
    const real_t share = real_min(REAL(1.0), real_max(REAL(0.0), REAL(2.0) - (real_length(off) / TRAILS_M)));
    const real_t blend = REAL(1.0) - decay(dt / SMOOTH_S);
    const real_t gn = gap_to(wanted->position[0], t->position[0]);
    const real_t ge = gap_to(wanted->position[1], t->position[1]);
    const real_t gap = real_hypot(gn, ge);
    real_t pace = REAL(0.0);
    real_t level[2];
    real_t fast;
    real_t slow = share;
    real_t change[2];
    real_t gain;
    real_t a[3];
    real_t gd = REAL(0.0);
    real_t wd;
    real_t turn;
    real_t rate;

    if (gap > REAL(0.0)) {
        pace = real_min(approach(gap, limits->acceleration), limits->speed) / gap;
    }
    level[0] = or_zero(wanted->velocity[0]) + (pace * gn);
    level[1] = or_zero(wanted->velocity[1]) + (pace * ge);
    if (sight != NULL) {
        avoid_hold_off(sight, measured, clearance, level);
    }
    fast = real_hypot(level[0], level[1]);
    if (fast > limits->speed) {
        slow = share * (limits->speed / fast);
    }
    for (int32_t i = 0; i < 2; i++) {
        change[i] = (slow * level[i]) - t->velocity[i];
    }
    gain = gain_of(change[0], change[1], limits->acceleration, dt);
    a[0] = gain * change[0];
    a[1] = gain * change[1];

    /* The greatest height first: where both are broken (a mad estimate), down is wrong and up is worse. */
    if (!real_missing(wanted->position[2])) {
        gd = real_min(real_max(wanted->position[2], -HIGHEST_M), -LOWEST_M) - t->position[2];
    }
    wd = or_zero(wanted->velocity[2]) + toward(gd, limits);
    wd = real_min(real_max(wd, -limits->climb), limits->descent);
    wd = real_min(real_max(wd, toward(-HIGHEST_M - t->position[2], limits)),
                  toward(-LOWEST_M - t->position[2], limits));
    change[0] = (share * wd) - t->velocity[2];
    a[2] = gain_of(change[0], REAL(0.0), limits->climb_acceleration, dt) * change[0];

    turn = real_missing(wanted->heading) ? REAL(0.0) : real_wrapped(wanted->heading - t->heading);
    rate = or_zero(wanted->yaw_rate) + real_with_sign(approach(real_abs(turn), limits->yaw_acceleration), turn);
    rate = real_min(real_max(rate, -limits->yaw_rate), limits->yaw_rate);
    change[0] = rate - t->heading_rate;
    t->heading_rate += dt * (gain_of(change[0], REAL(0.0), limits->yaw_acceleration, dt) * change[0]);
    t->heading += dt * t->heading_rate;

    for (int32_t i = 0; i < 3; i++) {
        t->acceleration[i] += blend * (a[i] - t->acceleration[i]);
        t->velocity[i] += dt * a[i];
        t->position[i] += dt * t->velocity[i];
    }
}

void offboard_follow(point_t *tracker, const set_point_t *wanted, const limits_t *limits, const real_t measured[3],
                     real_t dt, const sight_t *sight, real_t clearance)
{
    if (dt > REAL(0.0)) {
        const real_t steps = (dt / STEP_S) - REAL(1e-9);
        int32_t parts = (int32_t)steps;

        if ((real_t)parts < steps) {
            parts++;
        }
        parts = (parts < 1) ? 1 : parts;
        for (int32_t i = 0; i < parts; i++) {
            part(tracker, wanted, limits, measured, dt / (real_t)parts, sight, clearance);
        }
    }
}
