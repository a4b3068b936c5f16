#include "mission/machine/mission_reference.h"


#define NOSE_SWING_PERIOD_S REAL(4.0)
#define NOSE_SWING_RATE_RAD_S (REAL(0x1.921fb54442d18p+2) / NOSE_SWING_PERIOD_S)

static void hold_reference(const real_t at[3], real_t heading, trajectory_point_t *out)
{
    copy_vector(at, out->position);
    zero_vector(out->velocity);
    zero_vector(out->acceleration);
    out->heading = heading;
    out->heading_rate = REAL(0.0);
}

void current_reference(const mission_t *s, trajectory_point_t *out)
{
    if (s->state == STATE_OBSTACLE) {
        copy_vector(s->detour.position, out->position);
        copy_vector(s->detour.velocity, out->velocity);
        copy_vector(s->detour.acceleration, out->acceleration);
        out->heading = s->hold_heading;
        out->heading_rate = REAL(0.0);
    } else if (((s->state == STATE_OFFBOARD) || (s->state == STATE_WAYPOINT)) && s->has_set_point_reference) {
        *out = s->set_point_reference;
    } else if ((s->course.kind == COURSE_NONE) || (s->motors == MOTORS_SPIN_UP)) {
        hold_reference(s->hold_position, s->hold_heading, out);
    } else {
        if (s->course.kind == COURSE_TRAJECTORY) {
            trajectory_evaluate(&s->course.way, s->motion_clock_s, out);
        } else {
            braking_evaluate(&s->course.brake, s->motion_clock_s, out);
        }
        if (s->state == STATE_LANDING) {
            out->position[2] = s->hold_position[2];
            out->velocity[2] = s->descent_rate;
            out->acceleration[2] = s->descent_acceleration;
        }
    }
}

void predict_step_end_reference(const mission_t *s, trajectory_point_t *out)
{
    const bool integrates = (s->state == STATE_OBSTACLE) || (s->state == STATE_OFFBOARD) || s->has_set_point_reference;

    current_reference(s, out);
    if (s->state == STATE_LANDING) {
        out->position[2] += s->step_duration_s * out->velocity[2];
    } else if (integrates) {
        for (int32_t i = 0; i < 3; i++) {
            out->position[i] += s->step_duration_s * out->velocity[i];
        }
    } else {
        /* a motion's clock is already advanced */
    }
    if ((s->state == STATE_LANDING) || integrates) {
        out->heading += s->step_duration_s * out->heading_rate;
    }
}

bool has_departed(const mission_t *s)
{
    return s->has_set_point_reference || (s->motion_clock_s >= s->course.way.path_start_s);
}

bool is_scanning(const plan_t *plan, const mission_t *s)
{
    return (s->state == STATE_OBSTACLE) || (plan->scan && (s->state == STATE_WAYPOINT) && has_departed(s));
}

void compute_scan_yaw(const plan_t *plan, const mission_t *s, real_t *angle, real_t *rate)
{
    *angle = REAL(0.0);
    *rate = REAL(0.0);
    if (s->scan_duration_s > REAL(0.0)) {
        const real_t x = real_min(s->scan_duration_s, REAL(1.0));
        const real_t most = REAL(0.5) * plan->beam_ring.spacing;
        const real_t size = ((most * x) * x) * (REAL(3.0) - (REAL(2.0) * x));
        const real_t grows = is_scanning(plan, s) ? REAL(1.0) : REAL(-1.0);
        const real_t growth = (((most * REAL(6.0)) * x) * (REAL(1.0) - x)) * grows;
        real_t since = s->time_s;
        real_t sine;
        real_t cosine;

        if (real_abs(since) < REAL(4e9)) {
            since -= NOSE_SWING_PERIOD_S * (real_t)(int32_t)(since / NOSE_SWING_PERIOD_S);
        }
        sine_cosine(NOSE_SWING_RATE_RAD_S * since, &sine, &cosine);
        *angle = size * sine;
        *rate = (growth * sine) + ((size * NOSE_SWING_RATE_RAD_S) * cosine);
    }
}

void make_reference(const plan_t *plan, const mission_t *s, const estimate_t *m, const command_t *c,
                      reference_t *out)
{
    const motion_estimate_t *now = &m->motion;

    out->motors = s->motors;
    out->rc_active = false;
    out->roll = REAL(0.0);
    out->pitch = REAL(0.0);
    zero_vector(out->path.velocity);
    zero_vector(out->path.acceleration);
    out->heading_rate = REAL(0.0);
    if (s->state == STATE_RC) {
        for (int32_t i = 0; i < 2; i++) {
            out->path.position[i] = now->position[i];
            out->path.velocity[i] = now->velocity[i];
        }
        out->path.position[2] = s->hold_position[2];
        out->path.velocity[2] = s->descent_rate;
        out->heading = s->hold_heading;
        if (s->motors == MOTORS_FLY) {
            out->heading_rate = c->pilot_yaw_rate;
        }
        out->rc_active = true;
        out->roll = c->pilot_roll;
        out->pitch = c->pilot_pitch;
        limit_manual_tilt(s->home_position[2] - now->position[2], now->velocity, now->attitude[2], &out->roll, &out->pitch);
    } else if (s->state == STATE_INIT) {
        copy_vector(now->position, out->path.position);
        out->heading = now->attitude[2];
    } else {
        trajectory_point_t at;
        real_t angle;
        real_t rate;

        current_reference(s, &at);
        compute_scan_yaw(plan, s, &angle, &rate);
        copy_vector(at.position, out->path.position);
        copy_vector(at.velocity, out->path.velocity);
        copy_vector(at.acceleration, out->path.acceleration);
        out->heading = at.heading + angle;
        out->heading_rate = at.heading_rate + rate;
    }
}
