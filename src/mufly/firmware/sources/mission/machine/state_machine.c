#include "mission/machine/state_machine.h"

#include <stddef.h>

#include "mission/external_control.h"
#include "mission/machine/ground_phases.h"
#include "mission/machine/mission_reference.h"
#include "mission/machine/phases.h"
#include "mission/request_checks.h"
#include "mission/user_requests.h"

#define TIPPED_OVER_ANGLE_RAD (REAL(60.0) * DEGREE)
#define LOW_BATTERY_DURATION_S REAL(1.0)
#define VOLTAGE_LAG_S REAL(0.5)
#define DEPARTURE_HEIGHT_TOLERANCE_M REAL(0.1)
#define DEPARTURE_HEADING_TOLERANCE_RAD (REAL(8.0) * DEGREE)
#define SCAN_TIME_BEFORE_DEPARTURE_S REAL(3.0)
#define LONGEST_STEP_S REAL(0.5)

static bool is_in_flight(const mission_t *s)
{
    return (s->state != STATE_INIT) && (s->state != STATE_LANDING) && (s->state != STATE_RC);
}

/* Clocks, battery, obstacle map */

/* Whether height and heading are reached in fact, and the beams have scanned. */
static bool may_depart(const plan_t *plan, const mission_t *s, const estimate_t *m)
{
    const trajectory_t *way = &s->course.way;
    trajectory_point_t at;
    real_t angle;
    real_t rate;

    trajectory_evaluate(way, way->path_start_s, &at);
    compute_scan_yaw(plan, s, &angle, &rate);
    return (real_abs(m->motion.position[2] - at.position[2]) < DEPARTURE_HEIGHT_TOLERANCE_M) &&
           (real_abs((m->motion.attitude[2] - at.heading) - angle) < (DEPARTURE_HEADING_TOLERANCE_RAD + real_abs(angle))) &&
           (!plan->scan || s->resumed_after_detour || !(way->path_profile.distance > REAL(0.0)) ||
            (s->scan_duration_s >= SCAN_TIME_BEFORE_DEPARTURE_S));
}

static bool sees_anything(const plan_t *plan, const estimate_t *m)
{
    real_t least = REAL_INFINITY;

    for (int32_t i = 0; i < plan->beam_ring.count; i++) {
        least = real_min(least, m->ranges[i]);
    }
    return least < plan->beam_ring.max_range;
}

static void update_clocks(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    real_t clock = s->motion_clock_s + dt;
    const bool scanning = is_scanning(plan, s);

    if ((s->state == STATE_WAYPOINT) && !s->has_set_point_reference) {
        const real_t gate = s->course.way.path_start_s;

        if ((s->motion_clock_s <= gate) && (gate < clock) && !may_depart(plan, s, m)) {
            clock = gate;
        }
    }
    s->battery_V = s->battery_V + ((m->motion.voltage - s->battery_V) * real_min(REAL(1.0), dt / VOLTAGE_LAG_S));
    if (scanning) {
        s->scan_duration_s = real_min(SCAN_TIME_BEFORE_DEPARTURE_S, s->scan_duration_s + dt);
    } else {
        s->scan_duration_s = real_max(REAL(0.0), real_min(REAL(1.0), s->scan_duration_s) - dt);
    }
    s->time_s = m->time_s;
    s->motion_clock_s = clock;
    s->step_duration_s = dt;
    s->low_battery_duration_s = (s->battery_V < plan->low_voltage) ? (s->low_battery_duration_s + dt) : REAL(0.0);
}

/* User requests that the state permits */

static void pause_or_defer_pause(const plan_t *plan, mission_t *s, const estimate_t *m)
{
    message_t what;

    if ((s->state == STATE_TAKE_OFF) && !is_request_permitted(REQUEST_GO_TO, s, m)) {
        if (!s->hover_after_take_off) {
            what = make_message(SAY_WILL_HOVER_AFTER_TAKE_OFF);
            log_event(s, &what, LEVEL_INFO);
            s->hover_after_take_off = true;
            s->user_in_control = true;
        }
    } else {
        what = make_message((s->state == STATE_LANDING) ? SAY_LANDING_ABORTED : SAY_MISSION_PAUSED);
        pause_mission(plan, s, &what);
    }
}

static void handle_request(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c)
{
    const int32_t first = (c->has_first_waypoint && (c->first_waypoint > 0)) ? c->first_waypoint : 0;
    bool waits = true; /* whether no request has been handled yet */
    bool fresh;

    if (c->land && (s->state != STATE_LANDING) && is_request_permitted(REQUEST_LAND, s, m)) {
        land_on_request(plan, s);
        waits = false;
    }
    if (waits && (s->state == STATE_OFFBOARD) && !c->has_program_set_point) {
        exit_offboard(plan, s, m);
        waits = s->state != STATE_INIT;
    }
    fresh = s->user_in_control || c->has_first_waypoint;
    if (waits && (s->state == STATE_INIT) && (c->start || c->has_take_off_height) && is_request_permitted(REQUEST_START, s, m)) {
        const message_t fault = describe_start_fault(m);

        if (fault.code != SAY_NO_MESSAGE) {
            log_start_refusal(s, &fault);
            waits = false;
        }
    }
    if (!waits) {
        /* done */
    } else if (c->start && (s->state == STATE_INIT) && is_request_permitted(REQUEST_START, s, m)) {
        start_flight(plan, s, m, NULL, first);
    } else if (c->start && (s->state == STATE_TAKE_OFF) && fresh && is_request_permitted(REQUEST_START, s, m)) {
        queue_mission_after_take_off(s, first);
    } else if (c->has_take_off_height && is_request_permitted(REQUEST_TAKE_OFF, s, m)) {
        start_flight(plan, s, m, &c->take_off_height, 0);
    } else if ((c->pause || s->hover_after_take_off) && is_request_permitted(REQUEST_PAUSE, s, m)) {
        pause_or_defer_pause(plan, s, m);
    } else if (c->return_requested && is_request_permitted(REQUEST_RETURN, s, m)) {
        return_on_request(plan, s);
    } else if (c->has_program_set_point && is_request_permitted(REQUEST_OFFBOARD, s, m)) {
        if (s->state != STATE_OFFBOARD) {
            enter_offboard(s, m, &c->program_set_point);
        }
    } else if ((c->has_waypoint || c->has_heading) && is_request_permitted(REQUEST_GO_TO, s, m)) {
        fly_to_user_waypoint(plan, s, c);
    } else if (c->start && fresh && is_request_permitted(REQUEST_START, s, m)) {
        resume_mission(plan, s, c->has_first_waypoint ? &first : NULL);
    } else {
        /* no request, or none permitted */
    }
}

static bool has_tipped_over(const mission_t *s, const estimate_t *m)
{
    const bool near = m->motion.position[2] > (s->home_position[2] - REAL(0.3));

    return near && (s->motors != MOTORS_OFF) &&
           (real_max(real_abs(m->motion.attitude[0]), real_abs(m->motion.attitude[1])) > TIPPED_OVER_ANGLE_RAD);
}

static void land_on_low_battery(const plan_t *plan, mission_t *s)
{
    const message_t why = make_message_2(SAY_BATTERY_LOW, s->battery_V, plan->low_voltage);

    /* A completed mission that holds does not fail by using up its battery. */
    if (s->outcome != OUTCOME_SUCCEEDED) {
        fail_mission(s, &why);
    }
    start_landing(s, &why, LEVEL_WARNING);
}

/* Transitions that are possible in any state. */
static void apply_any_state_transitions(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt)
{
    message_t what;

    if (c->motor_stop_reason != 0) {
        what = make_message_1(SAY_GIVEN_TEXT, (real_t)c->motor_stop_reason);
        stop_motors(s, &what);
    } else if ((s->state != STATE_INIT) && has_tipped_over(s, m)) {
        what = make_message(SAY_TIPPED_OVER);
        fail_mission(s, &what);
        what = make_message(SAY_TIPPED_MOTORS_OFF);
        stop_motors(s, &what);
    } else if (c->rc_active && (s->motors != MOTORS_RAMP_DOWN)) {
        /* Rotors that run down after touchdown stop first: centred sticks must not restart them. */
        if (s->state != STATE_RC) {
            enter_manual(s, m);
        }
        if ((s->motors == MOTORS_FLY) && ((s->low_battery_duration_s - dt) <= LOW_BATTERY_DURATION_S) &&
            (LOW_BATTERY_DURATION_S < s->low_battery_duration_s)) {
            what = make_message_2(SAY_BATTERY_LOW_PILOT, s->battery_V, plan->low_voltage); /* the pilot decides */
            log_event(s, &what, LEVEL_WARNING);
        }
        step_manual(plan, s, m, c, dt);
    } else if (s->state == STATE_RC) {
        exit_manual(s, m);
    } else if (is_in_flight(s) && (s->low_battery_duration_s > LOW_BATTERY_DURATION_S)) {
        land_on_low_battery(plan, s);
    } else if ((s->state == STATE_INIT) && (s->motors != MOTORS_OFF)) {
        /* motors run down */
    } else {
        handle_request(plan, s, m, c);
    }
}

/* Whether the vehicle has just begun a curve whose computation is not complete. */
static bool has_pending_curve(const mission_t *s)
{
    return (s->course.kind == COURSE_TRAJECTORY) && (s->course.way.pending_parts > 0);
}

void step_mission(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *command, reference_t *out)
{
    const real_t dt = real_min(real_max(m->time_s - s->time_s, REAL(0.0)), LONGEST_STEP_S);

    while (has_pending_curve(s)) { /* a period was skipped */
        advance_pending_curve(&s->course.way);
    }
    update_clocks(plan, s, m, dt);
    apply_any_state_transitions(plan, s, m, command, dt);
    if (s->state == STATE_OFFBOARD) {
        step_offboard(plan, s, m, command, dt);
    }
    step_phase(plan, s, m, dt);
    make_reference(plan, s, m, command, out);
    if (plan->avoid && is_in_flight(s)) {
        const bool sent = (s->state == STATE_WAYPOINT) || (s->state == STATE_OBSTACLE);

        begin_path_check(out->path.position, sent ? s->goal : out->path.position,
                          (s->state == STATE_OBSTACLE) ? REAL_INFINITY : PATH_LOOK_AHEAD_M, &s->path_check);
    }
}

void update_obstacle_map(const plan_t *plan, mission_t *s, const estimate_t *m, int32_t part, int32_t parts)
{
    if (has_pending_curve(s)) { /* the vehicle stands or brakes */
        advance_pending_curve(&s->course.way);
    } else if (plan->avoid && is_in_flight(s) && ((s->obstacle_map.point_count > 0) || sees_anything(plan, m))) {
        const int32_t count = (plan->beam_ring.count + 7) / 8;

        insert_beam_hits(&s->obstacle_map, &plan->beam_ring, m->time_s, m->motion.position, m->motion.attitude, m->ranges, s->next_beam,
                      count);
        check_map_part(&s->obstacle_map, &s->path_check, m->time_s, plan->clearance, part, parts);
        s->next_beam += count;
        if (s->next_beam >= plan->beam_ring.count) {
            s->next_beam -= plan->beam_ring.count;
        }
    } else {
        /* nothing to check */
    }
}
