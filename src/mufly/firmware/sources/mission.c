#include "mission.h"

#include <stddef.h>

#include "ground_phases.h"
#include "mission_reference.h"
#include "mission_state.h"
#include "phases.h"

#define TIPPED_ANGLE (REAL(60.0) * DEGREE)
#define LOW_BATTERY_S REAL(1.0)
#define VOLTAGE_LAG_S REAL(0.5)
#define DEPARTURE_HEIGHT_TOLERANCE_M REAL(0.1)
#define DEPARTURE_HEADING_TOLERANCE (REAL(8.0) * DEGREE)
#define LOOK_AROUND_TIME_S REAL(3.0)
#define LONGEST_STEP_S REAL(0.5)
#define MAX_EXTENT_M REAL(1e4)
#define GO_AROUND_HEIGHT_M REAL(0.4)
#define OFF_FLOOR_HEIGHT_M REAL(0.2)
#define PER_DEGREE (REAL(180.0) / REAL_PI)
#define SAME_PLACE_M REAL(0.01)
#define SAME_HEADING (REAL(0.5) * DEGREE)
#define TARGET_STREAM_S REAL(1.0)
#define STOP_PLACE_M REAL(0.3)

/* Permitted requests in each state */

typedef enum { DENY, ALLOW_ALWAYS, ALLOW_AT_REST, ALLOW_GROUNDED, ALLOW_ARMED, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_FAILED, ALLOW_GO_AROUND, ALLOW_LIFTED, ALLOW_MOTORS_OFF, ALLOW_MISSION_WAITING } condition_t;

static const condition_t request_table[REQUEST_COUNT][MISSION_STATE_COUNT] = {
    /* init, take-off, hover, waypoint, obstacle, landing, rc, offboard */
    {ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST},                         /* arm */
    {ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED},                 /* disarm */
    {ALLOW_ARMED, DENY, DENY, DENY, DENY, DENY, DENY, DENY},                                         /* take-off */
    {ALLOW_ARMED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_LIFTED},                                        /* start */
    {DENY, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_GO_AROUND, DENY, ALLOW_LIFTED},                                         /* pause */
    {DENY, ALLOW_LIFTED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_LIFTED},                                       /* go-to */
    {DENY, ALLOW_LIFTED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_LIFTED},                                       /* return */
    {DENY, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_ALWAYS, DENY, ALLOW_UNLESS_FAILED},                                        /* land */
    {ALLOW_ALWAYS, ALLOW_LIFTED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_ALWAYS},                                      /* offboard */
    {ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND},                                                 /* sticks */
    {ALLOW_MOTORS_OFF, ALLOW_MISSION_WAITING, ALLOW_MISSION_WAITING, ALLOW_MISSION_WAITING, ALLOW_MISSION_WAITING, DENY, DENY, DENY},                                         /* load */
    {ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS},                                 /* stop */
};

bool check_request(int32_t ask, const mission_t *s, real_t height, bool armed, bool flying)
{
    const bool off = s->motors == MOTORS_OFF;
    const bool seen = s->motors != MOTORS_BLIND;
    const bool knows = seen && (s->outcome != OUTCOME_FAILED);
    bool can = false;

    switch (request_table[ask][s->state]) {
    case ALLOW_ALWAYS:
        can = true;
        break;
    case ALLOW_AT_REST:
        can = armed || off;
        break;
    case ALLOW_GROUNDED:
        can = !flying;
        break;
    case ALLOW_ARMED:
        can = armed && off;
        break;
    case ALLOW_UNLESS_BLIND:
        can = seen;
        break;
    case ALLOW_UNLESS_FAILED:
        can = knows;
        break;
    case ALLOW_GO_AROUND: /* high enough to abort a landing */
        can = knows && (s->motors == MOTORS_FLY) && !(height <= GO_AROUND_HEIGHT_M);
        break;
    case ALLOW_LIFTED: /* safely off the floor */
        can = knows && (s->motors != MOTORS_SPIN_UP) && !(height < OFF_FLOOR_HEIGHT_M);
        break;
    case ALLOW_MOTORS_OFF:
        can = off;
        break;
    case ALLOW_MISSION_WAITING: /* hovers or flies by user signals, no mission in progress */
        can = knows && s->manual && ((s->motors == MOTORS_SPIN_UP) || (s->motors == MOTORS_FLY));
        break;
    default:
        can = false;
        break;
    }
    return can;
}

static bool is_granted(int32_t ask, const mission_t *s, const estimate_t *m)
{
    return check_request(ask, s, s->home_position[2] - m->motion.position[2], true, s->state != STATE_INIT);
}

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

    trajectory_evaluate(way, way->departure_s, &at);
    scan_yaw(plan, s, &angle, &rate);
    return (real_abs(m->motion.position[2] - at.position[2]) < DEPARTURE_HEIGHT_TOLERANCE_M) &&
           (real_abs((m->motion.attitude[2] - at.heading) - angle) < (DEPARTURE_HEADING_TOLERANCE + real_abs(angle))) &&
           (!plan->scan || s->resumed_after_detour || !(way->path_profile.distance > REAL(0.0)) || (s->scan_duration_s >= LOOK_AROUND_TIME_S));
}

static bool sees_anything(const plan_t *plan, const estimate_t *m)
{
    real_t least = REAL_INFINITY;

    for (int32_t i = 0; i < plan->ring.count; i++) {
        least = real_min(least, m->ranges[i]);
    }
    return least < plan->ring.max_range;
}

static void update_clocks(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    real_t clock = s->motion_clock_s + dt;
    const bool scanning = is_scanning(plan, s);

    if ((s->state == STATE_WAYPOINT) && !s->has_set_point_reference) {
        const real_t gate = s->course.way.departure_s;

        if ((s->motion_clock_s <= gate) && (gate < clock) && !may_depart(plan, s, m)) {
            clock = gate;
        }
    }
    s->battery_V = s->battery_V + ((m->motion.voltage - s->battery_V) * real_min(REAL(1.0), dt / VOLTAGE_LAG_S));
    if (scanning) {
        s->scan_duration_s = real_min(LOOK_AROUND_TIME_S, s->scan_duration_s + dt);
    } else {
        s->scan_duration_s = real_max(REAL(0.0), real_min(REAL(1.0), s->scan_duration_s) - dt);
    }
    s->time_s = m->time_s;
    s->motion_clock_s = clock;
    s->step_duration_s = dt;
    s->low_battery_duration_s = (s->battery_V < plan->low_voltage) ? (s->low_battery_duration_s + dt) : REAL(0.0);
}

/* User signals: stop, waypoints, pause, home */

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

message_t user_waypoint_fault(const command_t *c)
{
    message_t fault = make_message(SAY_NO_MESSAGE);
    const real_t *where = c->waypoint;

    if (c->has_heading && !real_is_finite(c->heading)) {
        fault = make_message_1(SAY_HEADING_REFUSED, c->heading);
    } else if (c->has_waypoint) {
        const bool finite = real_is_finite(where[0]) && real_is_finite(where[1]) && real_is_finite(where[2]);

        if (!finite || (where[2] > -MIN_WAYPOINT_HEIGHT_M)) {
            fault = make_message_4(SAY_USER_WAYPOINT_TOO_LOW, where[0], where[1], where[2], -MIN_WAYPOINT_HEIGHT_M);
        } else if ((where[2] < -MAX_HEIGHT_M) || (real_hypot(where[0], where[1]) > MAX_EXTENT_M)) {
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
        same = same && (real_abs(a[i] - b[i]) <= SAME_PLACE_M);
    }
    return same;
}

/* Whether the vehicle already does what the user requests. */
static bool is_already_requested(const mission_t *s, const command_t *c)
{
    const bool heading = c->has_heading
                             ? (s->has_requested_heading && (real_abs(c->heading - s->requested_heading) <= SAME_HEADING))
                             : !s->has_requested_heading;

    return s->manual && !s->returning_home && heading && (!c->has_waypoint || is_same_place(c->waypoint, s->goal));
}

/* Whether the reference may as well stop at the goal of the present leg for a turn. */
static bool stops_at_goal(const mission_t *s)
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
    return (s->state == STATE_WAYPOINT) && (real_vector_length(off) <= (((REAL(0.5) * speed) * lasts) + STOP_PLACE_M));
}

static void fly_to_user_waypoint(const plan_t *plan, mission_t *s, const command_t *c)
{
    message_t what = user_waypoint_fault(c);

    if (what.code != SAY_NO_MESSAGE) {
        const log_entry_t *last = &s->log[(s->logged_count - 1) % MISSION_LOG];

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
        if (s->manual && !s->returning_home && ((s->state == STATE_WAYPOINT) || (s->state == STATE_OBSTACLE)) &&
            (c->has_waypoint || stops_at_goal(s))) {
            if (!c->has_waypoint) {
                copy_vector(s->goal, errand.goal);
            }
            change_leg_goal(plan, s, &what, errand.goal, c->has_heading ? &errand.heading : NULL,
                            (s->time_s - s->state_entered_s) < TARGET_STREAM_S);
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
        if (!s->manual) {
            log_event(s, why, LEVEL_INFO);
            s->manual = true;
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
        s->manual = true;
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
    if ((s->state != STATE_WAYPOINT) || s->manual || (index != s->waypoint_index)) {
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
        s->manual = false;
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
        s->manual = true;
        s->abort_reason = make_message(SAY_NO_MESSAGE);
    }
}

static void resume_after_take_off(mission_t *s, int32_t first)
{
    const message_t what = (first > 0) ? make_message_1(SAY_MISSION_AFTER_TAKE_OFF_FROM, (real_t)(first + 1)) : make_message(SAY_MISSION_AFTER_TAKE_OFF);

    log_event(s, &what, LEVEL_INFO);
    s->manual = false;
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

/* Manual control (RC) */

static void enter_manual(mission_t *s, const estimate_t *m)
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
    const bool asks = !(c->climb_rate <= REAL(0.0));
    const message_t fault = start_fault(m);

    if (asks && (fault.code != SAY_NO_MESSAGE)) {
        refuse_start(s, &fault);
    }
    return asks && (fault.code == SAY_NO_MESSAGE);
}

static void step_manual(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt)
{
    const real_t *x = m->motion.position;

    if ((s->motors == MOTORS_OFF) && !may_start(s, m, c)) {
        copy_vector(x, s->hold_position);
        s->hold_heading = m->motion.attitude[2];
        s->descent_rate = REAL(0.0);
    } else if (s->motors == MOTORS_OFF) {
        s->has_taken_off = true;
        s->mission_begun = false;
        s->manual = true;
        s->waypoint_index = 0;
        s->reached_count = 0;
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
        const real_t climb = limit_manual_climb(s->home_position[2] - x[2], m->motion.velocity, plan->touchdown, c->climb_rate);

        s->hold_position[2] = real_min(real_max(s->hold_position[2] - (climb * dt), x[2] - REAL(0.5)), x[2] + REAL(0.5));
        s->hold_position[0] = x[0];
        s->hold_position[1] = x[1];
        s->hold_heading = s->hold_heading + (c->yaw_rate * dt);
        s->descent_rate = -climb;
    }
}

static bool is_on_floor(const mission_t *s, const estimate_t *m)
{
    return (m->motion.position[2] > (s->home_position[2] - REAL(0.1))) &&
           (real_abs(m->motion.velocity[2]) < REAL(0.1));
}

static void end_on_floor(mission_t *s, int32_t code)
{
    const message_t why = make_message(code);
    const bool running = s->motors != MOTORS_OFF;

    enter_state(s, STATE_INIT, &why, LEVEL_INFO);
    s->motors = running ? MOTORS_RAMP_DOWN : MOTORS_OFF;
    s->finished = (s->outcome != OUTCOME_OPEN) && !running;
}

static void exit_manual(mission_t *s, const estimate_t *m)
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
        end_on_floor(s, SAY_RC_OFF_ON_FLOOR);
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
        s->manual = true;
    }
}

/* Set-points of a program */

static void enter_offboard(mission_t *s, const estimate_t *m, const set_point_t *wanted)
{
    message_t why = make_message(SAY_OFFBOARD_ON);

    if (!is_set_point_valid(wanted)) {
        /* invalid set-point */
    } else if (s->state != STATE_INIT) {
        trajectory_point_t at;

        predict_reference(s, &at);
        enter_state(s, STATE_OFFBOARD, &why, LEVEL_INFO);
        s->set_point_reference = at;
        s->has_set_point_reference = true;
        s->has_detour = false;
        s->manual = true;
        s->returning_home = false;
    } else if (needs_lift_off(wanted, m->motion.position)) {
        why = start_fault(m);
        if (why.code != SAY_NO_MESSAGE) {
            refuse_start(s, &why);
        } else {
            why = make_message(SAY_OFFBOARD_TAKE_OFF);
            reset_mission(s, m);
            s->manual = true;
            enter_state(s, STATE_OFFBOARD, &why, LEVEL_INFO);
            s->motors = MOTORS_SPIN_UP;
        }
    } else {
        /* stays on the floor */
    }
}

/* Follow the set-point within the mission's limits, away from obstacles that the beams have hit. */
static void step_offboard(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt)
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

static void exit_offboard(const plan_t *plan, mission_t *s, const estimate_t *m)
{
    if ((s->motors != MOTORS_FLY) || is_on_floor(s, m)) {
        if (s->outcome == OUTCOME_OPEN) {
            s->outcome = OUTCOME_SUCCEEDED;
            s->reason = make_message(SAY_LANDED);
        }
        end_on_floor(s, SAY_OFFBOARD_OFF_ON_FLOOR);
    } else {
        const message_t why = make_message(SAY_OFFBOARD_OFF);

        pause_mission(plan, s, &why);
    }
}

/* User requests that the state permits */

static void pause_or_defer(const plan_t *plan, mission_t *s, const estimate_t *m)
{
    message_t what;

    if ((s->state == STATE_TAKE_OFF) && !is_granted(REQUEST_GO_TO, s, m)) {
        if (!s->hover_after_take_off) {
            what = make_message(SAY_WILL_HOVER_AFTER_TAKE_OFF);
            log_event(s, &what, LEVEL_INFO);
            s->hover_after_take_off = true;
            s->manual = true;
        }
    } else {
        what = make_message((s->state == STATE_LANDING) ? SAY_LANDING_ABORTED : SAY_MISSION_PAUSED);
        pause_mission(plan, s, &what);
    }
}

static void handle_request(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c)
{
    const message_t land = make_message(SAY_LAND_SIGNAL);
    const message_t home = make_message(SAY_RETURN_SIGNAL);
    const int32_t first = (c->has_first_waypoint && (c->first_waypoint > 0)) ? c->first_waypoint : 0;
    bool waits = true; /* whether no request has been handled yet */
    bool fresh;

    if (c->land && (s->state != STATE_LANDING) && is_granted(REQUEST_LAND, s, m)) {
        set_abort_reason(plan, s, SAY_LAND_BEFORE_LAST_WAYPOINT, SAY_LAND_WITH_WAYPOINTS_LEFT);
        start_landing(s, &land, LEVEL_INFO);
        waits = false;
    }
    if (waits && (s->state == STATE_OFFBOARD) && !c->has_program_set_point) {
        exit_offboard(plan, s, m);
        waits = s->state != STATE_INIT;
    }
    fresh = s->manual || c->has_first_waypoint;
    if (waits && (s->state == STATE_INIT) && (c->start || c->has_take_off_height) && is_granted(REQUEST_START, s, m)) {
        const message_t fault = start_fault(m);

        if (fault.code != SAY_NO_MESSAGE) {
            refuse_start(s, &fault);
            waits = false;
        }
    }
    if (!waits) {
        /* done */
    } else if (c->start && (s->state == STATE_INIT) && is_granted(REQUEST_START, s, m)) {
        start_flight(plan, s, m, NULL, first);
    } else if (c->start && (s->state == STATE_TAKE_OFF) && fresh && is_granted(REQUEST_START, s, m)) {
        resume_after_take_off(s, first);
    } else if (c->has_take_off_height && is_granted(REQUEST_TAKE_OFF, s, m)) {
        start_flight(plan, s, m, &c->take_off_height, 0);
    } else if ((c->pause || s->hover_after_take_off) && is_granted(REQUEST_PAUSE, s, m)) {
        pause_or_defer(plan, s, m);
    } else if (c->return_requested && is_granted(REQUEST_RETURN, s, m)) {
        if (!s->returning_home) {
            set_abort_reason(plan, s, SAY_RETURN_BEFORE_LAST_WAYPOINT, SAY_RETURN_WITH_WAYPOINTS_LEFT);
            start_leg_home(plan, s, &home);
        }
    } else if (c->has_program_set_point && is_granted(REQUEST_OFFBOARD, s, m)) {
        if (s->state != STATE_OFFBOARD) {
            enter_offboard(s, m, &c->program_set_point);
        }
    } else if ((c->has_waypoint || c->has_heading) && is_granted(REQUEST_GO_TO, s, m)) {
        fly_to_user_waypoint(plan, s, c);
    } else if (c->start && fresh && is_granted(REQUEST_START, s, m)) {
        resume_mission(plan, s, c->has_first_waypoint ? &first : NULL);
    } else {
        /* no request, or none permitted */
    }
}

static bool has_tipped_over(const mission_t *s, const estimate_t *m)
{
    const bool near = m->motion.position[2] > (s->home_position[2] - REAL(0.3));

    return near && (s->motors != MOTORS_OFF) &&
           (real_max(real_abs(m->motion.attitude[0]), real_abs(m->motion.attitude[1])) > TIPPED_ANGLE);
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
static void apply_signals(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *c, real_t dt)
{
    message_t what;

    if (c->stop_reason != 0) {
        what = make_message_1(SAY_GIVEN_TEXT, (real_t)c->stop_reason);
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
        if ((s->motors == MOTORS_FLY) && ((s->low_battery_duration_s - dt) <= LOW_BATTERY_S) && (LOW_BATTERY_S < s->low_battery_duration_s)) {
            what = make_message_2(SAY_BATTERY_LOW_PILOT, s->battery_V, plan->low_voltage); /* the pilot decides */
            log_event(s, &what, LEVEL_WARNING);
        }
        step_manual(plan, s, m, c, dt);
    } else if (s->state == STATE_RC) {
        exit_manual(s, m);
    } else if (is_in_flight(s) && (s->low_battery_duration_s > LOW_BATTERY_S)) {
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
    apply_signals(plan, s, m, command, dt);
    if (s->state == STATE_OFFBOARD) {
        step_offboard(plan, s, m, command, dt);
    }
    step_phase(plan, s, m, dt);
    make_reference(plan, s, m, command, out);
    if (plan->avoid && is_in_flight(s)) {
        const bool sent = (s->state == STATE_WAYPOINT) || (s->state == STATE_OBSTACLE);

        begin_path_check(out->path.position, sent ? s->goal : out->path.position,
                          (s->state == STATE_OBSTACLE) ? REAL_INFINITY : LOOK_AHEAD_M, &s->path_check);
    }
}

void update_obstacle_map(const plan_t *plan, mission_t *s, const estimate_t *m, int32_t part, int32_t parts)
{
    if (has_pending_curve(s)) { /* the vehicle stands or brakes */
        advance_pending_curve(&s->course.way);
    } else if (plan->avoid && is_in_flight(s) && ((s->obstacle_map.point_count > 0) || sees_anything(plan, m))) {
        const int32_t count = (plan->ring.count + 7) / 8;

        insert_beam_hits(&s->obstacle_map, &plan->ring, m->time_s, m->motion.position, m->motion.attitude, m->ranges, s->next_beam,
                      count);
        check_map_part(&s->obstacle_map, &s->path_check, m->time_s, plan->clearance, part, parts);
        s->next_beam += count;
        if (s->next_beam >= plan->ring.count) {
            s->next_beam -= plan->ring.count;
        }
    } else {
        /* nothing to check */
    }
}
