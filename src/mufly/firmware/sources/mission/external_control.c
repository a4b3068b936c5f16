#include "mission/external_control.h"

#include "mission/machine/ground_phases.h"
#include "mission/machine/mission_reference.h"
#include "mission/machine/phases.h"
#include "mission/user_requests.h"

/* Manual control (RC) */

void enter_manual(mission_t *s, const estimate_t *m)
{
    const message_t why = make_message(SAY_RC_ON);

    enter_state(s, STATE_RC, &why, LEVEL_INFO);
    copy_vector(m->motion.position, s->hold_position);
    s->hold_heading = m->motion.attitude[2];
    s->has_detour = false;
    s->returning_home = false;
    s->descent_rate = REAL(0.0);
}

/* Whether the pilot asks for a start that the estimate permits. */
static bool may_start(mission_t *s, const estimate_t *m, const command_t *c)
{
    const bool asks = !(c->pilot_climb_rate <= REAL(0.0));
    const message_t fault = describe_start_fault(m);

    if (asks && (fault.code != SAY_NO_MESSAGE)) {
        log_start_refusal(s, &fault);
    }
    return asks && (fault.code == SAY_NO_MESSAGE);
}

void step_manual(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt)
{
    const real_t *x = m->motion.position;

    if ((s->motors == MOTORS_OFF) && !may_start(s, m, c)) {
        copy_vector(x, s->hold_position);
        s->hold_heading = m->motion.attitude[2];
        s->descent_rate = REAL(0.0);
    } else if (s->motors == MOTORS_OFF) {
        s->has_taken_off = true;
        s->mission_begun = false;
        s->user_in_control = true;
        s->waypoint_index = 0;
        s->reached_waypoint_count = 0;
        copy_vector(x, s->home_position);
        s->outcome = OUTCOME_OPEN;
        s->reason = make_message(SAY_NO_MESSAGE);
        s->abort_reason = make_message(SAY_NO_MESSAGE);
        s->finished = false;
        s->motors = MOTORS_SPIN_UP;
        s->motion_clock_s = REAL(0.0);
        copy_vector(x, s->hold_position);
    } else if (s->motors == MOTORS_SPIN_UP) {
        if (has_spun_up(s, m)) {
            s->motors = MOTORS_FLY;
        }
    } else {
        /* The reference stays near the helicopter, so that it responds to the sticks at once. */
        const real_t climb = limit_manual_climb(s->home_position[2] - x[2], m->motion.velocity, plan->touchdown, c->pilot_climb_rate);

        s->hold_position[2] = real_min(real_max(s->hold_position[2] - (climb * dt), x[2] - REAL(0.5)), x[2] + REAL(0.5));
        s->hold_position[0] = x[0];
        s->hold_position[1] = x[1];
        s->hold_heading = s->hold_heading + (c->pilot_yaw_rate * dt);
        s->descent_rate = -climb;
    }
}

static bool is_on_floor(const mission_t *s, const estimate_t *m)
{
    return (m->motion.position[2] > (s->home_position[2] - REAL(0.1))) &&
           (real_abs(m->motion.velocity[2]) < REAL(0.1));
}

static void end_control_on_floor(mission_t *s, int32_t code)
{
    const message_t why = make_message(code);
    const bool running = s->motors != MOTORS_OFF;

    enter_state(s, STATE_INIT, &why, LEVEL_INFO);
    s->motors = running ? MOTORS_RAMP_DOWN : MOTORS_OFF;
    s->finished = (s->outcome != OUTCOME_OPEN) && !running;
}

void exit_manual(mission_t *s, const estimate_t *m)
{
    const real_t *x = m->motion.position;
    real_t v[3];
    const real_t psi = m->motion.attitude[2];
    message_t why;

    if ((s->motors != MOTORS_FLY) || is_on_floor(s, m)) {
        why = make_message(SAY_LANDED_BY_PILOT);
        if (s->mission_begun && (s->outcome == OUTCOME_OPEN)) {
            fail_mission(s, &why);
        } else if (s->has_taken_off && (s->outcome == OUTCOME_OPEN)) {
            s->outcome = OUTCOME_SUCCEEDED;
            s->reason = why;
        } else {
            /* outcome already set, or never in the air */
        }
        end_control_on_floor(s, SAY_RC_OFF_ON_FLOOR);
    } else {
        braking_motion_t brake;
        trajectory_point_t at;

        copy_vector(m->motion.velocity, v);
        plan_stop(x, v, psi, DETOUR_ACCELERATION_M_S2, REAL(0.0), REAL_INFINITY, &brake);
        braking_evaluate(&brake, REAL_INFINITY, &at);
        if (at.position[2] > s->home_position[2]) {
            /* The descent is too fast to stop above the floor: the stopping height goes with w sqrt(u^2 + w^2). */
            const real_t u = real_hypot(v[0], v[1]);
            const real_t w = v[2];
            const real_t most = ((real_max(REAL(0.0), s->home_position[2] - x[2]) / (at.position[2] - x[2])) * w) *
                                real_hypot(u, w);

            v[2] = real_sqrt(REAL(0.5) * (real_hypot(u * u, REAL(2.0) * most) - (u * u)));
            plan_stop(x, v, psi, DETOUR_ACCELERATION_M_S2, REAL(0.0), REAL_INFINITY, &brake);
            braking_evaluate(&brake, REAL_INFINITY, &at);
        }
        why = make_message(SAY_RC_OFF);
        enter_hover(s, &why, at.position, psi, LEVEL_INFO);
        s->course.kind = COURSE_STOP;
        s->course.brake = brake;
        s->user_in_control = true;
    }
}

/* Set-points of a program */

void enter_offboard(mission_t *s, const estimate_t *m, const set_point_t *wanted)
{
    message_t why = make_message(SAY_OFFBOARD_ON);

    if (!is_set_point_valid(wanted)) {
        /* invalid set-point */
    } else if (s->state != STATE_INIT) {
        trajectory_point_t at;

        predict_step_end_reference(s, &at);
        enter_state(s, STATE_OFFBOARD, &why, LEVEL_INFO);
        s->set_point_reference = at;
        s->has_set_point_reference = true;
        s->has_detour = false;
        s->user_in_control = true;
        s->returning_home = false;
    } else if (needs_lift_off(wanted, m->motion.position)) {
        why = describe_start_fault(m);
        if (why.code != SAY_NO_MESSAGE) {
            log_start_refusal(s, &why);
        } else {
            why = make_message(SAY_OFFBOARD_TAKE_OFF);
            reset_mission(s, m);
            s->user_in_control = true;
            enter_state(s, STATE_OFFBOARD, &why, LEVEL_INFO);
            s->motors = MOTORS_SPIN_UP;
        }
    } else {
        /* stays on the floor */
    }
}

void step_offboard(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt)
{
    bool ready = true;

    if (s->motors == MOTORS_SPIN_UP) {
        ready = has_spun_up(s, m);
        if (ready) {
            s->motors = MOTORS_FLY;
            s->course.kind = COURSE_NONE;
            s->has_set_point_reference = false;
            current_reference(s, &s->set_point_reference);
            s->has_set_point_reference = true;
        }
    }
    /* The reference is predicted for the end of the step of entry. */
    if (ready && (s->state_entered_s < s->time_s) && is_set_point_valid(&c->program_set_point)) {
        track_set_point(plan, s, &c->program_set_point, m, dt);
        copy_vector(s->set_point_reference.position, s->hold_position);
        copy_vector(s->set_point_reference.position, s->goal);
        s->hold_heading = s->set_point_reference.heading;
    }
}

void exit_offboard(const plan_t *plan, mission_t *s, const estimate_t *m)
{
    if ((s->motors != MOTORS_FLY) || is_on_floor(s, m)) {
        if (s->outcome == OUTCOME_OPEN) {
            s->outcome = OUTCOME_SUCCEEDED;
            s->reason = make_message(SAY_LANDED);
        }
        end_control_on_floor(s, SAY_OFFBOARD_OFF_ON_FLOOR);
    } else {
        const message_t why = make_message(SAY_OFFBOARD_OFF);

        pause_mission(plan, s, &why);
    }
}
