#include "mission/machine/ground_phases.h"

#include "mission/machine/mission_reference.h"

#define DESCENT_LAG_S REAL(0.15)
#define NEAR_FLOOR_HEIGHT_M REAL(0.1)
#define MAX_DESCENT_LAG_M REAL(0.25)
#define REST_DURATION_ON_FLOOR_S REAL(0.3)
#define STANDING_HEIGHT_M REAL(0.02) /* standing on the floor by the estimate: height below this, */
#define PRESS_DOWN_DEPTH_M REAL(0.03) /* reference below the estimate by this, */
#define PRESS_DOWN_DURATION_S REAL(0.05) /* for this time, */
#define MAX_HEIGHT_SIGMA_M REAL(0.05)   /* with this height deviation at most */
#define DRIFT_CHECK_HEIGHT_M REAL(0.6)
#define DRIFT_SPEED_M_S REAL(0.3)
#define SLOW_LANDING_HEIGHT_M REAL(0.4)
#define HARD_TOUCHDOWN_M_S REAL(0.3)
#define MAX_START_TILT_DEG REAL(6.0)

void start_landing(mission_t *s, const message_t *why, int32_t level)
{
    const message_t reason = *why; /* why may point to the message stored in s */

    if (s->motors == MOTORS_SPIN_UP) {
        if (s->mission_begun) {
            fail_mission(s, &reason);
        }
        enter_state(s, STATE_INIT, &reason, level);
        s->motors = MOTORS_RAMP_DOWN;
    } else {
        trajectory_point_t now;
        trajectory_point_t next;
        trajectory_point_t foot;
        braking_motion_t brake;

        current_reference(s, &now);
        predict_step_end_reference(s, &next);
        next.velocity[0] = now.velocity[0];
        next.velocity[1] = now.velocity[1];
        next.velocity[2] = REAL(0.0);
        plan_stop(next.position, next.velocity, now.heading, DETOUR_ACCELERATION_M_S2, REAL(0.0), REAL_INFINITY, &brake);
        braking_evaluate(&brake, REAL_INFINITY, &foot);
        enter_state(s, STATE_LANDING, &reason, level);
        s->course.kind = COURSE_STOP;
        s->course.brake = brake;
        copy_vector(foot.position, s->hold_position);
        s->hold_position[2] = now.position[2];
        copy_vector(foot.position, s->goal);
        s->goal[2] = s->home_position[2];
        s->hold_heading = now.heading;
        s->descent_rate = now.velocity[2];
        s->descent_acceleration = now.acceleration[2];
        s->motors = MOTORS_FLY;
        s->rest_duration_s = REAL(0.0);
        s->touchdown_speed = REAL(0.0);
    }
}

static void log_touchdown(mission_t *s)
{
    message_t what = make_message(SAY_TOUCHDOWN);

    if (s->touchdown_speed <= HARD_TOUCHDOWN_M_S) {
        log_event(s, &what, LEVEL_INFO);
    } else {
        what = make_message_2(SAY_HARD_TOUCHDOWN, s->touchdown_speed, HARD_TOUCHDOWN_M_S);
        log_event(s, &what, LEVEL_WARNING);
    }
    s->motors = MOTORS_RAMP_DOWN;
    s->motion_clock_s = REAL(0.0);
}

/* Set the outcome of the flight after landing. */
static void judge_outcome(mission_t *s)
{
    if (s->outcome == OUTCOME_OPEN) {
        if (s->abort_reason.code != SAY_NO_MESSAGE) {
            fail_mission(s, &s->abort_reason);
        } else {
            succeed_mission(s, s->mission_begun ? SAY_MISSION_COMPLETE : SAY_LANDED);
        }
    }
}

void step_landing(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    const real_t a = plan->limits.climb_acceleration;
    const real_t z = m->motion.position[2];
    const real_t w = m->motion.velocity[2];
    real_t above;
    real_t wanted;
    real_t ask;
    bool lying;
    bool stands;
    bool near;

    if (s->motors == MOTORS_RAMP_DOWN) {
        if (!(s->motion_clock_s < ROTOR_RUN_DOWN_TIME_S)) {
            const message_t down = make_message(SAY_LANDED);

            judge_outcome(s);
            enter_state(s, STATE_INIT, &down, LEVEL_INFO);
            s->motors = MOTORS_OFF;
            s->finished = true;
        }
    } else {
        above = s->home_position[2] - s->hold_position[2];
        wanted = real_min(plan->limits.descent, real_sqrt((plan->touchdown * plan->touchdown) +
                                                          (real_max(REAL(0.0), above - SLOW_LANDING_HEIGHT_M) * a)));
        if (above < REAL(-0.3)) {
            wanted = REAL(0.0);
        } else if ((above > REAL(0.0)) && (above < DRIFT_CHECK_HEIGHT_M) &&
                   (((m->motion.velocity[0] * m->motion.velocity[0]) +
                     (m->motion.velocity[1] * m->motion.velocity[1])) > (DRIFT_SPEED_M_S * DRIFT_SPEED_M_S))) {
            wanted = real_min(wanted, DRIFTING_DESCENT_RATE_M_S);
        } else {
            /* full rate */
        }
        ask = real_min(real_max((wanted - s->descent_rate) / DESCENT_LAG_S, -a), a);
        s->descent_acceleration = s->descent_acceleration + ((ask - s->descent_acceleration) * real_min(REAL(1.0), dt / REAL(0.1)));
        s->descent_rate = s->descent_rate + (s->descent_acceleration * dt);
        s->hold_position[2] = s->hold_position[2] + (s->descent_rate * dt);
        lying = (z > (s->home_position[2] - REAL(0.03))) && (s->hold_position[2] > (s->home_position[2] + REAL(0.1)));
        lying = lying || (s->hold_position[2] > (z + MAX_DESCENT_LAG_M)); /* on an object, or lower than estimated */
        /* With unknown drift the vehicle must not be steered with a leg on the floor. */
        stands = m->judged && (z > (s->home_position[2] - STANDING_HEIGHT_M)) && (s->hold_position[2] > (z + PRESS_DOWN_DEPTH_M)) &&
                 (m->position_variance[2] < (MAX_HEIGHT_SIGMA_M * MAX_HEIGHT_SIGMA_M));
        if (stands || (lying && (real_abs(w) < REAL(0.05)))) {
            s->rest_duration_s = s->rest_duration_s + dt;
        } else {
            s->rest_duration_s = REAL(0.0);
        }
        near = z > (s->home_position[2] - NEAR_FLOOR_HEIGHT_M);
        if (m->judged) { /* a filter that has not detected the floor keeps falling for a moment */
            near = near && (z < (s->home_position[2] - LIFT_OFF_HEIGHT_M));
        }
        if (near) {
            s->touchdown_speed = real_max(s->touchdown_speed, w);
        }
        if (s->rest_duration_s > (stands ? PRESS_DOWN_DURATION_S : REST_DURATION_ON_FLOOR_S)) {
            log_touchdown(s);
        }
    }
}

void enter_blind_descent(mission_t *s, real_t time_s, const message_t *why)
{
    s->time_s = time_s;
    fail_mission(s, why);
    enter_state(s, STATE_LANDING, why, LEVEL_ERROR);
    s->motors = MOTORS_BLIND;
    s->has_detour = false;
}

void fail_and_land(mission_t *s, const message_t *why)
{
    if ((s->state == STATE_INIT) || (s->state == STATE_RC)) {
        log_event(s, why, LEVEL_ERROR);
    } else {
        fail_mission(s, why);
        if (s->state == STATE_LANDING) {
            log_event(s, why, LEVEL_ERROR);
        } else {
            start_landing(s, why, LEVEL_ERROR);
        }
    }
}

void finish_blind_descent(mission_t *s, real_t time_s)
{
    const message_t why = make_message(SAY_MOTORS_OFF_AFTER_DESCENT);

    s->time_s = time_s;
    enter_state(s, STATE_INIT, &why, LEVEL_INFO);
    s->motors = MOTORS_OFF;
    s->finished = true;
}

/* On the floor and take-off */

bool has_lifted_off(const mission_t *s, const estimate_t *m)
{
    return m->motion.position[2] < (s->home_position[2] - LIFT_OFF_HEIGHT_M);
}

bool is_tipping(const estimate_t *m)
{
    return real_max(real_abs(m->motion.rates[0]), real_abs(m->motion.rates[1])) > TIPPING_RATE_RAD_S;
}

/* Tilt of a standing vehicle (rad): the greater of that of the estimate and of its accelerometers. */
static real_t compute_standing_tilt(const estimate_t *m)
{
    const real_t *f = m->specific_force;
    real_t sine_roll;
    real_t cosine_roll;
    real_t sine_pitch;
    real_t cosine_pitch;
    real_t tilt;

    sine_cosine(m->motion.attitude[0], &sine_roll, &cosine_roll);
    sine_cosine(m->motion.attitude[1], &sine_pitch, &cosine_pitch);
    tilt = real_atan2(real_hypot(sine_pitch, sine_roll * cosine_pitch), cosine_roll * cosine_pitch);
    return m->judged ? real_max(tilt, real_atan2(real_hypot(f[0], f[1]), -f[2])) : tilt;
}

bool stands_tilted(const estimate_t *m)
{
    return !(compute_standing_tilt(m) <= (MAX_START_TILT_DEG * DEGREE));
}

message_t describe_start_fault(const estimate_t *m)
{
    message_t fault = make_message(SAY_NO_MESSAGE);
    const real_t tilt = compute_standing_tilt(m);

    if (!m->valid) {
        fault = make_message(SAY_ESTIMATE_NOT_VALID);
    } else if (stands_tilted(m)) {
        fault = make_message_2(SAY_STANDS_TILTED, tilt * (REAL(180.0) / REAL_PI), MAX_START_TILT_DEG);
    } else {
        /* may start */
    }
    return fault;
}

void log_start_refusal(mission_t *s, const message_t *why)
{
    if (s->log[(s->logged_event_count - 1) % MISSION_LOG].message.code != why->code) {
        log_event(s, why, LEVEL_WARNING);
    }
}

bool has_spun_up(const mission_t *s, const estimate_t *m)
{
    return (s->motion_clock_s >= ROTOR_SPIN_UP_TIME_S) || has_lifted_off(s, m);
}

void step_on_floor(mission_t *s)
{
    if ((s->motors == MOTORS_RAMP_DOWN) && (s->motion_clock_s > ROTOR_RUN_DOWN_TIME_S)) {
        s->motors = MOTORS_OFF;
        s->finished = s->outcome != OUTCOME_OPEN;
    }
}

void reset_mission(mission_t *s, const estimate_t *m)
{
    clear_mission(s);
    s->has_taken_off = true;
    copy_vector(m->motion.position, s->hold_position);
    copy_vector(m->motion.position, s->home_position);
    s->hold_heading = m->motion.attitude[2];
}
