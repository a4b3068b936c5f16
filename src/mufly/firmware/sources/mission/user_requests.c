#include "mission/user_requests.h"

#include <stddef.h>

#include "mission/machine/ground_phases.h"
#include "mission/machine/mission_reference.h"
#include "mission/machine/phases.h"

#define MAX_COORDINATE_M REAL(1e4)
#define PER_DEGREE (REAL(180.0) / REAL_PI)
#define SAME_POSITION_TOLERANCE_M REAL(0.01)
#define SAME_HEADING_TOLERANCE_RAD (REAL(0.5) * DEGREE)
#define TARGET_LOG_INTERVAL_S REAL(1.0)
#define STOP_AT_GOAL_MARGIN_M REAL(0.3)

void stop_motors(mission_t *s, const message_t *why)
{
    if ((s->state != STATE_INIT) || (s->motors != MOTORS_OFF)) {
        if (s->has_taken_off || s->mission_begun) {
            fail_mission(s, why);
        }
        enter_state(s, STATE_INIT, why, LEVEL_ERROR);
        s->motors = MOTORS_OFF;
        s->has_detour = false;
        s->finished = s->outcome != OUTCOME_OPEN;
    }
}

message_t describe_user_waypoint_fault(const command_t *c)
{
    message_t fault = make_message(SAY_NO_MESSAGE);
    const real_t *where = c->waypoint;

    if (c->has_heading && !real_is_finite(c->heading)) {
        fault = make_message_1(SAY_HEADING_REFUSED, c->heading);
    } else if (c->has_waypoint) {
        const bool finite = real_is_finite(where[0]) && real_is_finite(where[1]) && real_is_finite(where[2]);

        if (!finite || (where[2] > -MIN_WAYPOINT_HEIGHT_M)) {
            fault = make_message_4(SAY_USER_WAYPOINT_TOO_LOW, where[0], where[1], where[2], -MIN_WAYPOINT_HEIGHT_M);
        } else if ((where[2] < -MAX_HEIGHT_M) || (real_hypot(where[0], where[1]) > MAX_COORDINATE_M)) {
            fault = make_message_4(SAY_USER_WAYPOINT_TOO_FAR, where[0], where[1], where[2], -MAX_HEIGHT_M);
        } else {
            /* valid */
        }
    } else {
        /* turns on the spot */
    }
    return fault;
}

static real_t compass_deg(real_t heading)
{
    const real_t deg = real_wrap_angle(heading) * PER_DEGREE;

    return deg + ((deg < REAL(0.0)) ? REAL(360.0) : REAL(0.0));
}

static bool is_same_place(const real_t a[3], const real_t b[3])
{
    bool same = true;

    for (int32_t i = 0; i < 3; i++) {
        same = same && (real_abs(a[i] - b[i]) <= SAME_POSITION_TOLERANCE_M);
    }
    return same;
}

/* Whether the vehicle already does what the user requests. */
static bool is_already_requested(const mission_t *s, const command_t *c)
{
    const bool heading = c->has_heading
                             ? (s->has_requested_heading && (real_abs(c->heading - s->requested_heading) <= SAME_HEADING_TOLERANCE_RAD))
                             : !s->has_requested_heading;

    return s->user_in_control && !s->returning_home && heading && (!c->has_waypoint || is_same_place(c->waypoint, s->goal));
}

/* Whether the reference may as well stop at the goal of the present leg for a turn. */
static bool can_stop_at_goal(const mission_t *s)
{
    trajectory_point_t now;
    real_t off[3];
    real_t speed;
    real_t lasts;

    current_reference(s, &now);
    for (int32_t i = 0; i < 3; i++) {
        off[i] = now.position[i] - s->goal[i];
    }
    speed = real_abs(real_vector_length(now.velocity));
    lasts = ((REAL(15.0) / REAL(8.0)) * speed) / DETOUR_ACCELERATION_M_S2;
    return (s->state == STATE_WAYPOINT) && (real_vector_length(off) <= (((REAL(0.5) * speed) * lasts) + STOP_AT_GOAL_MARGIN_M));
}

void fly_to_user_waypoint(const plan_t *plan, mission_t *s, const command_t *c)
{
    message_t what = describe_user_waypoint_fault(c);

    if (what.code != SAY_NO_MESSAGE) {
        const log_entry_t *last = &s->log[(s->logged_event_count - 1) % MISSION_LOG];

        if (!is_same_message(&last->message, &what)) {
            log_event(s, &what, LEVEL_WARNING);
        }
    } else if (!is_already_requested(s, c)) {
        leg_request_t errand = {LEG_TO_USER_WAYPOINT, false, {REAL(0.0), REAL(0.0), REAL(0.0)}, false, REAL(0.0)};

        errand.has_goal = c->has_waypoint;
        copy_vector(c->waypoint, errand.goal);
        errand.has_heading = c->has_heading;
        errand.heading = c->heading;
        if (!c->has_waypoint) {
            what = make_message_1(SAY_TURNING_TO_HEADING, compass_deg(c->heading));
        } else if (c->has_heading) {
            what = make_message_4(SAY_TO_USER_WAYPOINT_WITH_HEADING, c->waypoint[0], c->waypoint[1], c->waypoint[2],
                         c->heading * PER_DEGREE);
        } else {
            what = make_message_3(SAY_TO_USER_WAYPOINT, c->waypoint[0], c->waypoint[1], c->waypoint[2]);
        }
        if (s->user_in_control && !s->returning_home && ((s->state == STATE_WAYPOINT) || (s->state == STATE_OBSTACLE)) &&
            (c->has_waypoint || can_stop_at_goal(s))) {
            if (!c->has_waypoint) {
                copy_vector(s->goal, errand.goal);
            }
            change_leg_goal(plan, s, &what, errand.goal, c->has_heading ? &errand.heading : NULL,
                            (s->time_s - s->state_entered_s) < TARGET_LOG_INTERVAL_S);
        } else {
            start_leg(plan, s, &what, &errand);
        }
    } else {
        /* already flies there */
    }
}

void pause_mission(const plan_t *plan, mission_t *s, const message_t *why)
{
    if (s->state == STATE_HOVER) {
        if (!s->user_in_control) {
            log_event(s, why, LEVEL_INFO);
            s->user_in_control = true;
            s->abort_reason = make_message(SAY_NO_MESSAGE);
        }
    } else {
        braking_motion_t brake;
        trajectory_point_t at;

        plan_braking(plan, s, &brake);
        braking_evaluate(&brake, REAL_INFINITY, &at);
        if (s->state == STATE_LANDING) {
            at.position[2] = real_min(at.position[2], -MIN_WAYPOINT_HEIGHT_M);
        }
        enter_hover(s, why, at.position, at.heading, LEVEL_INFO);
        s->course.kind = COURSE_STOP;
        s->course.brake = brake;
        s->hover_until_s = s->time_s;
        s->user_in_control = true;
        s->returning_home = false;
        s->abort_reason = make_message(SAY_NO_MESSAGE);
        s->has_requested_heading = false;
        s->motors = MOTORS_FLY;
    }
}

void resume_mission(const plan_t *plan, mission_t *s, const int32_t *first)
{
    const bool over = (s->outcome == OUTCOME_SUCCEEDED) || (s->waypoint_index >= plan->count);
    int32_t index = over ? 0 : s->waypoint_index;

    if (first != NULL) {
        index = *first;
    }
    if ((s->state != STATE_WAYPOINT) || s->user_in_control || (index != s->waypoint_index)) {
        message_t why = (s->mission_begun && !over) ? make_message(SAY_MISSION_CONTINUES) : make_message(SAY_MISSION_BEGINS);

        if (first != NULL) {
            why = make_message_1(SAY_ON_TO_WAYPOINT, (real_t)(*first + 1));
        }
        if (s->state == STATE_HOVER) {
            log_event(s, &why, LEVEL_INFO);
            s->hover_until_s = s->time_s;
        } else {
            pause_mission(plan, s, &why);
        }
        s->user_in_control = false;
        s->mission_begun = true;
        s->waypoint_index = index;
        s->outcome = OUTCOME_OPEN;
        s->reason = make_message(SAY_NO_MESSAGE);
        s->abort_reason = make_message(SAY_NO_MESSAGE);
    }
}

void reset_for_loaded_mission(const plan_t *plan, mission_t *s)
{
    const message_t what = make_message_1((plan->count == 1) ? SAY_ONE_WAYPOINT_LOADED : SAY_WAYPOINTS_LOADED, (real_t)plan->count);

    log_event(s, &what, LEVEL_INFO);
    s->waypoint_index = 0;
    s->mission_begun = false;
    if (s->state != STATE_INIT) { /* a flight in progress continues without a mission until the new one starts */
        s->outcome = OUTCOME_OPEN;
        s->reason = make_message(SAY_NO_MESSAGE);
        s->user_in_control = true;
        s->abort_reason = make_message(SAY_NO_MESSAGE);
    }
}

void queue_mission_after_take_off(mission_t *s, int32_t first)
{
    const message_t what = (first > 0) ? make_message_1(SAY_MISSION_AFTER_TAKE_OFF_FROM, (real_t)(first + 1)) : make_message(SAY_MISSION_AFTER_TAKE_OFF);

    log_event(s, &what, LEVEL_INFO);
    s->user_in_control = false;
    s->mission_begun = true;
    s->waypoint_index = first;
    s->abort_reason = make_message(SAY_NO_MESSAGE);
    s->hover_after_take_off = false;
}

static void set_abort_reason(const plan_t *plan, mission_t *s, int32_t last, int32_t early)
{
    const int32_t left = plan->count - s->waypoint_index;

    if (s->mission_begun && (left > 0)) {
        s->abort_reason = make_message_1((left > 1) ? early : last, (real_t)left);
    }
}

void return_on_request(const plan_t *plan, mission_t *s)
{
    const message_t home = make_message(SAY_RETURN_SIGNAL);

    if (!s->returning_home) {
        set_abort_reason(plan, s, SAY_RETURN_BEFORE_LAST_WAYPOINT, SAY_RETURN_WITH_WAYPOINTS_LEFT);
        start_leg_home(plan, s, &home);
    }
}

void land_on_request(const plan_t *plan, mission_t *s)
{
    const message_t land = make_message(SAY_LAND_SIGNAL);

    set_abort_reason(plan, s, SAY_LAND_BEFORE_LAST_WAYPOINT, SAY_LAND_WITH_WAYPOINTS_LEFT);
    start_landing(s, &land, LEVEL_INFO);
}
