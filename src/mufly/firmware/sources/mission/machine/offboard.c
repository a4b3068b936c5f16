#include "mission/machine/offboard.h"

#include <stddef.h>

#define TRACKER_BANDWIDTH_RAD_S REAL(3.0)
#define MAX_TIME_STEP_S REAL(0.02)
#define SLOWING_TRACKING_ERROR_M REAL(0.5)
#define ACCELERATION_LAG_S REAL(0.08)
#define MAX_POSITION_M REAL(1e4)
#define MAX_SPEED_M_S REAL(50.0)
#define MAX_YAW_RATE_RAD_S REAL(50.0)
#define STANDARD_GRAVITY REAL(9.81)
#define STICK_LIMIT_HEIGHT_M REAL(1.0)
#define FULL_TILT_HEIGHT_M REAL(0.3)
#define MIN_TILT_FRACTION REAL(0.2)
#define MAX_HORIZONTAL_SPEED_AT_FLOOR_M_S REAL(0.3)
#define MAX_HORIZONTAL_SPEED_SLOPE_1_S REAL(1.2)
#define BRAKING_TIME_S REAL(0.5)
#define MAX_BRAKING_TILT_RAD REAL(0.09)
#define FLARE_TIME_S REAL(1.0)

/* Set said if a number is given, and clear right if it is beyond its bound. */
static void check_bound(real_t value, real_t most, bool *said, bool *right)
{
    *said = *said || !real_is_nan(value);
    *right = *right && !(real_abs(value) > most);
}

bool is_set_point_valid(const set_point_t *wanted)
{
    bool said = false;
    bool right = true;

    for (int32_t i = 0; i < 3; i++) {
        check_bound(wanted->position[i], MAX_POSITION_M, &said, &right);
        check_bound(wanted->velocity[i], MAX_SPEED_M_S, &said, &right);
    }
    check_bound(wanted->heading, MAX_POSITION_M, &said, &right);
    check_bound(wanted->yaw_rate, MAX_YAW_RATE_RAD_S, &said, &right);
    return said && right;
}

bool needs_lift_off(const set_point_t *wanted, const real_t standing[3])
{
    const bool higher = wanted->position[2] < real_min(standing[2] - REAL(0.1), -MIN_WAYPOINT_HEIGHT_M + REAL(1e-9));

    return higher || (wanted->velocity[2] < REAL(-0.01));
}

static real_t zero_if_nan(real_t x)
{
    return real_is_nan(x) ? REAL(0.0) : x;
}

static real_t distance_to_target(real_t target, real_t at)
{
    return real_is_nan(target) ? REAL(0.0) : (target - at);
}

/* Speed from which half the acceleration brakes in time. */
static real_t approach_speed(real_t gap, real_t acceleration)
{
    const real_t half = REAL(0.5) * acceleration;
    const real_t slope = REAL(0.5) * TRACKER_BANDWIDTH_RAD_S;
    const real_t linear = half / (slope * slope);

    return (gap < linear) ? (slope * gap) : real_sqrt((REAL(2.0) * half) * (gap - (REAL(0.5) * linear)));
}

/* Permitted velocity towards a bound at gap (m, down), or velocity back to it. */
static real_t max_velocity_towards_bound(real_t gap, const trajectory_limits_t *limits)
{
    return real_copysign(approach_speed(real_abs(gap), limits->climb_acceleration), gap);
}

/* Gain from a change of velocity to an acceleration of at most most, without overshoot. */
static real_t limited_gain(real_t dx, real_t dy, real_t most, real_t dt)
{
    const real_t gain = real_min(REAL(2.0) * TRACKER_BANDWIDTH_RAD_S, REAL(1.0) / dt);
    const real_t size = gain * real_hypot(dx, dy);

    return gain * ((size > most) ? (most / size) : REAL(1.0));
}

static void step_set_point_reference(trajectory_point_t *t, const set_point_t *wanted, const trajectory_limits_t *limits,
                                     const real_t measured[3], real_t dt,
                 const path_check_t *sight, real_t clearance)
{
    const real_t off[3] = {t->position[0] - measured[0], t->position[1] - measured[1],
                           t->position[2] - measured[2]};
    const real_t share = real_min(REAL(1.0), real_max(REAL(0.0), REAL(2.0) - (real_vector_length(off) / SLOWING_TRACKING_ERROR_M)));
    const real_t blend = REAL(1.0) - exp_decay(dt / ACCELERATION_LAG_S);
    const real_t gn = distance_to_target(wanted->position[0], t->position[0]);
    const real_t ge = distance_to_target(wanted->position[1], t->position[1]);
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
        pace = real_min(approach_speed(gap, limits->acceleration), limits->speed) / gap;
    }
    level[0] = zero_if_nan(wanted->velocity[0]) + (pace * gn);
    level[1] = zero_if_nan(wanted->velocity[1]) + (pace * ge);
    if (sight != NULL) {
        limit_approach_velocity(sight, measured, clearance, level);
    }
    fast = real_hypot(level[0], level[1]);
    if (fast > limits->speed) {
        slow = share * (limits->speed / fast);
    }
    for (int32_t i = 0; i < 2; i++) {
        change[i] = (slow * level[i]) - t->velocity[i];
    }
    gain = limited_gain(change[0], change[1], limits->acceleration, dt);
    a[0] = gain * change[0];
    a[1] = gain * change[1];

    /* The height limit comes first: if both are violated (a wild estimate), descending is the lesser risk. */
    if (!real_is_nan(wanted->position[2])) {
        gd = real_min(real_max(wanted->position[2], -MAX_HEIGHT_M), -MIN_WAYPOINT_HEIGHT_M) - t->position[2];
    }
    wd = zero_if_nan(wanted->velocity[2]) + max_velocity_towards_bound(gd, limits);
    wd = real_min(real_max(wd, -limits->climb), limits->descent);
    wd = real_min(real_max(wd, max_velocity_towards_bound(-MAX_HEIGHT_M - t->position[2], limits)),
                  max_velocity_towards_bound(-MIN_WAYPOINT_HEIGHT_M - t->position[2], limits));
    change[0] = (share * wd) - t->velocity[2];
    a[2] = limited_gain(change[0], REAL(0.0), limits->climb_acceleration, dt) * change[0];

    turn = real_is_nan(wanted->heading) ? REAL(0.0) : real_wrap_angle(wanted->heading - t->heading);
    rate = zero_if_nan(wanted->yaw_rate) + real_copysign(approach_speed(real_abs(turn), limits->yaw_acceleration), turn);
    rate = real_min(real_max(rate, -limits->yaw_rate), limits->yaw_rate);
    change[0] = rate - t->heading_rate;
    t->heading_rate += dt * (limited_gain(change[0], REAL(0.0), limits->yaw_acceleration, dt) * change[0]);
    t->heading += dt * t->heading_rate;

    for (int32_t i = 0; i < 3; i++) {
        t->acceleration[i] += blend * (a[i] - t->acceleration[i]);
        t->velocity[i] += dt * a[i];
        t->position[i] += dt * t->velocity[i];
    }
}

void follow_set_point(trajectory_point_t *tracker, const set_point_t *wanted, const trajectory_limits_t *limits, const real_t measured[3],
                     real_t dt, const path_check_t *sight, real_t clearance)
{
    if (dt > REAL(0.0)) {
        const real_t steps = (dt / MAX_TIME_STEP_S) - REAL(1e-9);
        int32_t parts = (int32_t)steps;

        if ((real_t)parts < steps) {
            parts++;
        }
        parts = (parts < 1) ? 1 : parts;
        for (int32_t i = 0; i < parts; i++) {
            step_set_point_reference(tracker, wanted, limits, measured, dt / (real_t)parts, sight, clearance);
        }
    }
}

/* A pilot's sticks near the floor */

static real_t max_horizontal_speed_near_floor(real_t height)
{
    return MAX_HORIZONTAL_SPEED_AT_FLOOR_M_S + (MAX_HORIZONTAL_SPEED_SLOPE_1_S * real_max(REAL(0.0), height));
}

void limit_manual_tilt(real_t height, const real_t velocity[2], real_t yaw, real_t *roll, real_t *pitch)
{
    if (height < STICK_LIMIT_HEIGHT_M) {
        const real_t share = real_min(real_max(height / FULL_TILT_HEIGHT_M, MIN_TILT_FRACTION), REAL(1.0));
        const real_t speed = real_hypot(velocity[0], velocity[1]);

        *roll = share * *roll;
        *pitch = share * *pitch;
        if (speed > REAL(0.0)) {
            const real_t most = real_max((max_horizontal_speed_near_floor(height) - speed) / (STANDARD_GRAVITY * BRAKING_TIME_S), -MAX_BRAKING_TILT_RAD);
            real_t sine;
            real_t cosine;
            real_t ahead;
            real_t right;
            real_t along;

            sine_cosine(yaw, &sine, &cosine);
            ahead = ((cosine * velocity[0]) + (sine * velocity[1])) / speed;
            right = ((cosine * velocity[1]) - (sine * velocity[0])) / speed;
            along = (right * *roll) - (ahead * *pitch);
            if (along > most) {
                *roll = *roll + ((most - along) * right);
                *pitch = *pitch - ((most - along) * ahead);
            }
        }
    }
}

real_t limit_manual_climb(real_t height, const real_t velocity[2], real_t touchdown, real_t climb)
{
    real_t least = -(touchdown + (real_max(REAL(0.0), height) / FLARE_TIME_S));

    if ((height < STICK_LIMIT_HEIGHT_M) && (real_hypot(velocity[0], velocity[1]) > max_horizontal_speed_near_floor(height))) {
        least = -DRIFTING_DESCENT_RATE_M_S;
    }
    return real_max(climb, least);
}
