#include "flight/flight_software.h"

#include <stddef.h>

#include "flight/failsafe.h"
#include "mission/machine/ground_phases.h"
#include "mission/machine/state_machine.h"
#include "mission/user_requests.h"

#define ESTIMATE_TIMEOUT_S REAL(0.5)
#define MAX_MOTOR_INPUT_STEP REAL(0.1)
#define MAX_SERVO_INPUT_STEP REAL(0.2)
#define HOVER_VOLTAGE_FILTER_S REAL(1.0)
#define BATTERY_FILTER_S REAL(0.5) /* time constant of the battery filter during spin-up */
#define TOUCHDOWN_HEIGHT_M REAL(0.03) /* height below which the vehicle counts as landed */
#define RAMP_DOWN_SKIPPED_FRACTION REAL(0.8) /* fraction of the ramp-down that is skipped after a certain touchdown */

static void set_pair(real_t a, real_t b, real_t out[2])
{
    out[0] = a;
    out[1] = b;
}

static void stop_reference(reference_t *r)
{
    for (int32_t i = 0; i < 3; i++) {
        r->path.velocity[i] = REAL(0.0);
    }
    r->heading_rate = REAL(0.0);
}

static void idle_actuators(actuators_t *out)
{
    set_pair(REAL(0.0), REAL(0.0), out->motor_input);
    set_pair(REAL(0.0), REAL(0.0), out->servo_input);
}

static void clear_command(command_t *c)
{
    c->start = false;
    c->has_first_waypoint = false;
    c->first_waypoint = 0;
    c->has_take_off_height = false;
    c->take_off_height = REAL(0.0);
    c->pause = false;
    c->has_waypoint = false;
    c->has_heading = false;
    c->heading = REAL(0.0);
    c->return_requested = false;
    c->land = false;
    c->motor_stop_reason = 0;
    c->rc_active = false;
    c->pilot_roll = REAL(0.0);
    c->pilot_pitch = REAL(0.0);
    c->pilot_yaw_rate = REAL(0.0);
    c->pilot_climb_rate = REAL(0.0);
    c->has_program_set_point = false;
    for (int32_t i = 0; i < 3; i++) {
        c->waypoint[i] = REAL(0.0);
        c->program_set_point.position[i] = REAL_NAN;
        c->program_set_point.velocity[i] = REAL_NAN;
    }
    c->program_set_point.heading = REAL_NAN;
    c->program_set_point.yaw_rate = REAL_NAN;
}

static bool is_any_signal(const command_t *c)
{
    const bool sticks = c->rc_active || (real_abs(c->pilot_roll) > REAL(0.0)) || (real_abs(c->pilot_pitch) > REAL(0.0)) ||
                        (real_abs(c->pilot_yaw_rate) > REAL(0.0)) || (real_abs(c->pilot_climb_rate) > REAL(0.0));

    return c->start || c->has_first_waypoint || c->has_take_off_height || c->pause || c->has_waypoint || c->has_heading || c->return_requested ||
           c->land || (c->motor_stop_reason != 0) || sticks || c->has_program_set_point;
}

void software_reset(const flight_setup_t *setup, software_t *s)
{
    (void)setup;
    s->reference.motors = MOTORS_OFF;
    s->reference.rc_active = false;
    s->reference.roll = REAL(0.0);
    s->reference.pitch = REAL(0.0);
    s->reference.heading = REAL(0.0);
    for (int32_t i = 0; i < 3; i++) {
        s->reference.path.position[i] = REAL(0.0);
        s->reference.path.acceleration[i] = REAL(0.0);
    }
    stop_reference(&s->reference);
    clear_command(&s->command);
    s->tick = 0;
    s->motors = MOTORS_OFF;
    s->motors_since_s = REAL(0.0);
    set_pair(REAL(0.0), REAL(0.0), s->motor_input);
    set_pair(REAL(0.0), REAL(0.0), s->tilt);
    set_pair(REAL(0.0), REAL(0.0), s->released_motor_input);
    s->is_lifted = false;
    s->since_mission_step_s = REAL(0.0);
    estimate_monitor_start(&s->watch);
    oscillation_detector_reset(&s->oscillations);
    s->oscillation.is_present = false;
    health_monitor_reset(&s->doubts, REAL(0.0));
    s->is_holding = false;
    s->resumes_mission = false;
    correction_smoother_reset(&s->smooth);
    idle_actuators(&s->limited_actuators);
    set_pair(REAL(0.0), REAL(0.0), s->hover_voltages);
    s->height_trusted_until_s = REAL(0.0);
    s->filtered_battery_V = REAL(0.0);
    position_init(&s->controllers.position);
}

bool software_flying(const software_t *s)
{
    return s->is_lifted && ((s->motors == MOTORS_FLY) || (s->motors == MOTORS_BLIND));
}

static void stop_motors_at_once(software_t *s, int32_t why, const estimate_t *m)
{
    const message_t what = make_message_1(SAY_GIVEN_TEXT, (real_t)why);

    s->mission.time_s = m->time_s;
    stop_motors(&s->mission, &what);
    stop_reference(&s->reference);
    s->reference.motors = MOTORS_OFF;
    s->reference.rc_active = false;
    clear_command(&s->command);
    s->motors = MOTORS_OFF;
    s->is_lifted = false;
    s->since_mission_step_s = REAL(0.0);
    idle_actuators(&s->limited_actuators);
    set_pair(REAL(0.0), REAL(0.0), s->motor_input);
    set_pair(REAL(0.0), REAL(0.0), s->tilt);
}

/* Whether the vehicle flies without position and velocity; this state is final. */
static bool is_estimate_lost(const software_t *s)
{
    const bool running = (s->motors == MOTORS_SPIN_UP) || (s->motors == MOTORS_FLY);
    const real_t running_s = running ? (s->watch.good.time_s - s->motors_since_s) : REAL(0.0);

    return (s->motors == MOTORS_BLIND) || (real_min(s->watch.lost_s, running_s) > ESTIMATE_TIMEOUT_S);
}

static void hold_and_wait(const flight_setup_t *setup, software_t *s)
{
    mission_t *x = &s->mission;
    const message_t holds = make_message(SAY_WAITING_FOR_POSITION);

    s->is_holding = true;
    s->resumes_mission = x->mission_begun && !x->user_in_control && (x->outcome == OUTCOME_OPEN);
    log_event(x, &s->doubts.verdict.reason, LEVEL_WARNING);
    pause_mission(setup->plan, x, &holds);
}

/* Hold or land if the estimate's quality requires it; return whether to descend at once. */
static bool act_on_health(const flight_setup_t *setup, software_t *s, const estimate_t *m)
{
    const message_t known = make_message(SAY_POSITION_KNOWN_AGAIN);
    mission_t *x = &s->mission;
    bool sinks = false;

    if (!(s->is_lifted && (s->motors == MOTORS_FLY))) {
        health_monitor_reset(&s->doubts, real_max(m->position_variance[0], m->position_variance[1]));
        s->is_holding = false;
        s->resumes_mission = false;
    } else {
        const bool anew = health_monitor_step(&s->doubts, m);
        const health_verdict_t *now = &s->doubts.verdict;
        const bool can_wait =
            (x->state == STATE_WAYPOINT) || (x->state == STATE_OBSTACLE) || (x->state == STATE_HOVER);

        if ((now->action == FAILSAFE_SINK) ||
            ((now->action == FAILSAFE_LAND) && is_gyro_unavailable(m) &&
             ((x->home_position[2] - m->motion.position[2]) < TOUCHDOWN_HEIGHT_M))) {
            sinks = true;
        } else if ((now->action == FAILSAFE_HOLD) && !s->is_holding && can_wait) {
            hold_and_wait(setup, s);
        } else if (anew && (now->action == FAILSAFE_LAND)) {
            fail_and_land(x, &now->reason);
        } else if (anew && (x->state == STATE_RC)) {
            log_event(x, (now->action == FAILSAFE_NONE) ? &known : &now->reason, LEVEL_WARNING);
        } else if (s->is_holding && (now->action == FAILSAFE_NONE)) {
            const bool goes_on = s->resumes_mission && (x->state == STATE_HOVER) && x->user_in_control;

            s->is_holding = false;
            s->resumes_mission = false;
            if (goes_on) {
                log_event(x, &known, LEVEL_INFO);
                resume_mission(setup->plan, x, NULL);
            }
        } else {
            /* continue */
        }
    }
    return sinks;
}

/* Whether a lost estimate still contains the height above the standing position. */
static bool height_if_known(const software_t *s, const estimate_t *told, real_t *height)
{
    *height = s->mission.home_position[2] - told->motion.position[2];
    return told->judged && (told->position_variance[2] < (MAX_HEIGHT_SIGMA_M * MAX_HEIGHT_SIGMA_M)) &&
           ((real_abs(*height) + real_abs(told->motion.velocity[2])) < REAL(1e3));
}

static void step_blind_descent(const flight_setup_t *setup, software_t *s, const estimate_t *told, const message_t *why,
                         actuators_t *out)
{
    const estimate_t *good = &s->watch.good;
    const real_t gravity = setup->gains->position.gravity;
    const real_t now = good->time_s;
    real_t height;
    real_t left_s;
    bool knows = height_if_known(s, told, &height);
    bool down;

    if (s->motors != MOTORS_BLIND) {
        s->motors = MOTORS_BLIND;
        left_s = s->is_lifted ? blind_descent_time_s(s->mission.home_position[2] - good->motion.position[2], gravity)
                           : REAL(0.0);
        s->motors_since_s = now + left_s;
        s->height_trusted_until_s = now + (REAL(2.0) * left_s);
        enter_blind_descent(&s->mission, now, why);
        s->reference.motors = MOTORS_BLIND;
        stop_reference(&s->reference);
        set_pair(REAL(0.0), REAL(0.0), s->tilt);
        clear_command(&s->command);
    }
    down = knows && (height <= TOUCHDOWN_HEIGHT_M);
    knows = s->is_lifted && (now < s->height_trusted_until_s) && knows && (height > TOUCHDOWN_HEIGHT_M);
    if (knows) { /* starting point in case the height is lost */
        s->motors_since_s = now + blind_descent_time_s(height, gravity);
    } else if (down) { /* on the legs, a rotor that still lifts can tip the vehicle over */
        s->motors_since_s = real_min(s->motors_since_s, now - (RAMP_DOWN_SKIPPED_FRACTION * ROTOR_RUN_DOWN_TIME_S));
    } else {
        /* descend for the calculated duration */
    }
    left_s = (s->motors_since_s + ROTOR_RUN_DOWN_TIME_S) - now;
    if (left_s <= REAL(0.0)) {
        finish_blind_descent(&s->mission, now);
        s->reference.motors = MOTORS_OFF;
        s->motors = MOTORS_OFF;
        set_pair(REAL(0.0), REAL(0.0), s->motor_input);
    } else {
        blind_descent_motor_input(s->hover_voltages, knows ? blind_descent_voltage_fraction(height, told->motion.velocity[2]) : BLIND_DESCENT_VOLTAGE_FRACTION, left_s,
                      good->motion.voltage, s->motor_input);
    }
    set_pair(s->motor_input[0], s->motor_input[1], out->motor_input);
    set_pair(REAL(0.0), REAL(0.0), out->servo_input);
}

/* Engage or release the controllers bumplessly. */
static void switch_motors(const flight_setup_t *setup, software_t *s, int32_t motors, const estimate_t *m)
{
    if (motors == MOTORS_FLY) {
        controllers_engage_heave_yaw(setup->gains, &s->controllers, &m->motion, s->motor_input);
        s->is_lifted = false;
        oscillation_detector_reset(&s->oscillations);
        s->oscillation.is_present = false;
        set_pair(setup->hover_V[0], setup->hover_V[1], s->hover_voltages);
    } else if (motors == MOTORS_SPIN_UP) {
        set_pair(REAL(0.0), REAL(0.0), s->hover_voltages);
        s->is_lifted = false;
    } else {
        /* off, or ramp-down */
    }
    s->motors = motors;
    s->motors_since_s = m->time_s;
    set_pair(s->motor_input[0], s->motor_input[1], s->released_motor_input);
}

static void step_floor_motors(const flight_setup_t *setup, software_t *s, const estimate_t *m, actuators_t *out)
{
    const real_t elapsed = m->time_s - s->motors_since_s;
    const bool filters = (s->motors == MOTORS_SPIN_UP) && m->judged;

    if (filters) {
        s->filtered_battery_V += (setup->period_s / BATTERY_FILTER_S) * (m->motion.voltage - s->filtered_battery_V);
    } else {
        s->filtered_battery_V = m->motion.voltage;
    }
    if (s->motors == MOTORS_SPIN_UP) {
        spin_up_motor_input(setup->hover_V, elapsed, s->filtered_battery_V, s->motor_input);
    } else if (s->motors == MOTORS_RAMP_DOWN) {
        /* The vehicle may slide with an estimate's error, and a rotor that still lifts can tip it over. */
        ramp_down_motor_input(s->released_motor_input,
                              m->judged ? (elapsed + (RAMP_DOWN_SKIPPED_FRACTION * ROTOR_RUN_DOWN_TIME_S)) : elapsed, s->motor_input);
    } else {
        set_pair(REAL(0.0), REAL(0.0), s->motor_input);
    }
    set_pair(REAL(0.0), REAL(0.0), s->tilt);
    set_pair(s->motor_input[0], s->motor_input[1], out->motor_input);
    set_pair(REAL(0.0), REAL(0.0), out->servo_input);
}

static void detect_oscillation(software_t *s, const actuators_t *out, real_t time_s)
{
    static const int32_t words[OSCILLATION_INPUTS] = {SAY_OSCILLATES_UPPER, SAY_OSCILLATES_LOWER,
                                                      SAY_OSCILLATES_SERVO_1, SAY_OSCILLATES_SERVO_2};
    const real_t inputs[OSCILLATION_INPUTS] = {out->motor_input[0], out->motor_input[1], out->servo_input[0],
                                               out->servo_input[1]};
    const reference_t *r = &s->reference;
    const bool by_hand = s->mission.state == STATE_RC;
    const bool tracks = (s->mission.state == STATE_WAYPOINT) && s->mission.has_set_point_reference;
    const bool steered = by_hand || (s->mission.state == STATE_OFFBOARD) || tracks;
    const bool before = s->oscillation.is_present;
    const real_t asked[STEERING_SIGNALS] = {
        by_hand ? REAL(0.0) : r->path.velocity[0],
        by_hand ? REAL(0.0) : r->path.velocity[1],
        r->path.velocity[2],
        r->heading_rate,
        by_hand ? r->roll : REAL(0.0),
        by_hand ? r->pitch : REAL(0.0),
    };

    oscillation_detector_step(&s->oscillations, time_s, inputs, steered ? asked : NULL, &s->oscillation);
    if (s->oscillation.is_present && !before) {
        const message_t why = make_message_2(words[s->oscillation.input_name], s->oscillation.swing, s->oscillation.frequency_Hz);

        fail_and_land(&s->mission, &why);
    }
}

static void step_control(const flight_setup_t *setup, software_t *s, const estimate_t *m, actuators_t *out)
{
    const reference_t *r = &s->reference;
    const bool due = !(s->since_mission_step_s > REAL(0.0));
    const real_t wanted[4] = {r->path.position[2] + (s->since_mission_step_s * r->path.velocity[2]),
                              r->heading + (s->since_mission_step_s * r->heading_rate), r->path.velocity[2], r->heading_rate};

    if (!s->is_lifted && (has_lifted_off(&s->mission, m) || is_tipping(m))) {
        s->is_lifted = true;
        controllers_engage_roll_pitch(setup->gains, &s->controllers, &m->motion);
    }
    if (!s->is_lifted) {
        set_pair(REAL(0.0), REAL(0.0), s->tilt);
    } else if (r->rc_active) {
        set_pair(r->roll, r->pitch, s->tilt);
    } else if (due) {
        controllers_compute_tilt_command(setup->gains, &s->controllers, &m->motion, &r->path, s->tilt);
    } else {
        /* the tilt holds until the position cascade runs again */
    }
    controllers_step(setup->gains, &s->controllers, &m->motion, wanted, s->is_lifted, s->tilt, out);
    set_pair(out->motor_input[0], out->motor_input[1], s->motor_input);
    if (due) {
        const real_t blend = ((real_t)setup->mission_step_periods * setup->period_s) / HOVER_VOLTAGE_FILTER_S;

        for (int32_t i = 0; i < 2; i++) {
            s->hover_voltages[i] += blend * ((out->motor_input[i] * m->motion.voltage) - s->hover_voltages[i]);
        }
        detect_oscillation(s, out, m->time_s);
    }
}

/* Limit the rate of actuator inputs that depend on an estimate. */
static void limit_actuator_rates(software_t *s, const estimate_t *m, actuators_t *out)
{
    if (m->judged) {
        for (int32_t i = 0; i < 2; i++) {
            const real_t motor = out->motor_input[i] - s->limited_actuators.motor_input[i];
            const real_t servo = out->servo_input[i] - s->limited_actuators.servo_input[i];

            out->motor_input[i] =
                s->limited_actuators.motor_input[i] + real_min(real_max(motor, -MAX_MOTOR_INPUT_STEP), MAX_MOTOR_INPUT_STEP);
            out->servo_input[i] =
                s->limited_actuators.servo_input[i] + real_min(real_max(servo, -MAX_SERVO_INPUT_STEP), MAX_SERVO_INPUT_STEP);
        }
    }
    s->limited_actuators = *out;
}

/* Process the beams in parts between two steps of the mission logic. */
static void update_map_part(const flight_setup_t *setup, software_t *s, const estimate_t *m)
{
    const bool apart = setup->mission_step_periods > 1; /* tick is already advanced */
    const int32_t part = apart ? wrap_index(s->tick - 1, setup->mission_step_periods) : 1;

    if (part > 0) {
        update_obstacle_map(setup->plan, &s->mission, m, part, apart ? (setup->mission_step_periods - 1) : 1);
    }
}

void software_step(const flight_setup_t *setup, software_t *s, const estimate_t *belief, const command_t *command,
                   actuators_t *out)
{
    const bool first = !s->watch.begun;
    estimate_t m;
    message_t why;

    check_estimate(&s->watch, belief, setup->period_s, &setup->plan->beam_ring);
    copy_estimate(&s->watch.good, setup->plan->beam_ring.count, &m);
    if (m.judged) {
        correction_smoother_step(&s->smooth, &m, s->motors == MOTORS_OFF);
    }
    if (first) {
        initial_mission_state(&s->mission, &m);
    }
    if (is_any_signal(command)) {
        s->command = *command;
    }
    s->since_mission_step_s = (real_t)s->tick * setup->period_s;
    s->tick = ((s->tick + 1) < setup->mission_step_periods) ? (s->tick + 1) : 0;
    if (command->motor_stop_reason != 0) {
        stop_motors_at_once(s, command->motor_stop_reason, &m);
        idle_actuators(out);
    } else if (is_estimate_lost(s)) {
        why = make_message_1(SAY_MEASUREMENT_LOST, (real_t)s->watch.what);
        step_blind_descent(setup, s, belief, &why, out);
        limit_actuator_rates(s, &m, out);
    } else if (!(s->since_mission_step_s > REAL(0.0)) && m.judged && act_on_health(setup, s, &m)) {
        why = s->doubts.verdict.reason;
        step_blind_descent(setup, s, belief, &why, out);
        limit_actuator_rates(s, &m, out);
    } else {
        if (!(s->since_mission_step_s > REAL(0.0))) {
            step_mission(setup->plan, &s->mission, &m, &s->command, &s->reference);
            clear_command(&s->command);
        }
        update_map_part(setup, s, &m);
        if (s->reference.motors != s->motors) {
            switch_motors(setup, s, s->reference.motors, &m);
        }
        if (s->reference.motors == MOTORS_FLY) {
            step_control(setup, s, &m, out);
            limit_actuator_rates(s, &m, out);
        } else {
            step_floor_motors(setup, s, &m, out);
            s->limited_actuators = *out;
        }
    }
}
