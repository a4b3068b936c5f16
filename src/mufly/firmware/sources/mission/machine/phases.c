#include "mission/machine/phases.h"

#include <stddef.h>

#include "mission/machine/ground_phases.h"
#include "mission/machine/mission_reference.h"

#define HOVER_BEFORE_LANDING_S REAL(2.0)
#define SETTLED_DISTANCE_M REAL(0.002)
#define SETTLED_SPEED_M_S REAL(0.01)
#define SETTLED_HEADING_RAD REAL(0.01)
#define MIN_DISTANCE_FOR_TURN_M REAL(0.3)

void start_flight(const plan_t *plan, mission_t *s, const estimate_t *m, const real_t *height, int32_t first)
{
    const real_t up = (height == NULL) ? plan->take_off_height : *height;
    const message_t why = (height == NULL) ? make_message(SAY_START_SIGNAL) : make_message_1(SAY_TAKE_OFF_SIGNAL, up);

    reset_mission(s, m);
    s->mission_begun = height == NULL;
    s->user_in_control = height != NULL;
    s->waypoint_index = first;
    copy_vector(s->home_position, s->goal);
    s->goal[2] = -up;
    enter_state(s, STATE_TAKE_OFF, &why, LEVEL_INFO);
    s->motors = MOTORS_SPIN_UP;
    plan_straight(s->home_position, s->goal, s->hold_heading, &plan->limits, NULL, REAL(0.0), &s->course.way);
    s->course.kind = COURSE_TRAJECTORY;
}

static void detect_obstacle(const plan_t *plan, mission_t *s);

static void hover_until(mission_t *s, const message_t *why, real_t ready_s)
{
    trajectory_point_t at;
    real_t goal[3];

    current_reference(s, &at);
    copy_vector(s->goal, goal);
    enter_hover(s, why, goal, at.heading, LEVEL_INFO);
    s->hover_until_s = ready_s;
}

/* Whether the vehicle is as near its goal, and as slow, as a reached waypoint asks. */
static bool is_at_goal(const plan_t *plan, const mission_t *s, const estimate_t *m)
{
    return (distance_between(m->motion.position, s->goal) < plan->reach) && (real_vector_length(m->motion.velocity) < plan->reach_speed);
}

static void step_take_off(const plan_t *plan, mission_t *s, const estimate_t *m)
{
    const real_t z = m->motion.position[2];

    if (s->motors == MOTORS_SPIN_UP) {
        if (has_spun_up(s, m)) {
            s->motors = MOTORS_FLY;
            s->motion_clock_s = REAL(0.0);
            s->state_entered_s = s->time_s;
        }
    } else {
        const real_t late = s->motion_clock_s - s->course.way.duration_s;
        const real_t gained = s->home_position[2] - z;
        const bool overdue = late > (REAL(8.0) + (REAL(0.5) * s->course.way.duration_s));
        const bool high = (real_abs(z - s->goal[2]) < plan->reach) &&
                          (real_abs(m->motion.velocity[2]) < plan->reach_speed);
        message_t why;

        if ((late >= REAL(0.0)) && high && (overdue || is_at_goal(plan, s, m))) {
            why = make_message_1(SAY_ALTITUDE_REACHED, -z);
            hover_until(s, &why, s->time_s + plan->take_off_wait_s);
        } else if ((late >= REAL(0.0)) && (late > REAL(3.0)) && (gained < REAL(0.1))) {
            why = make_message_2(SAY_TAKE_OFF_FAILED, gained, s->motion_clock_s);
            fail_mission(s, &why);
            why = s->reason;
            enter_state(s, STATE_INIT, &why, LEVEL_ERROR);
            s->motors = MOTORS_RAMP_DOWN;
        } else if (overdue) {
            why = make_message_2(SAY_TAKE_OFF_SHORT, -z, -s->goal[2]);
            fail_mission(s, &why);
            start_landing(s, &why, LEVEL_WARNING);
        } else if (z < (s->home_position[2] - REAL(0.2))) { /* on its legs the vehicle cannot avoid obstacles */
            detect_obstacle(plan, s);
        } else {
            /* climbing on its legs */
        }
    }
}

/* Hover and waypoint */

void plan_braking(const plan_t *plan, const mission_t *s, braking_motion_t *out)
{
    trajectory_point_t now;

    predict_step_end_reference(s, &now);
    plan_stop(now.position, now.velocity, now.heading, DETOUR_ACCELERATION_M_S2, now.heading_rate, plan->limits.yaw_acceleration,
              out);
}

/* Plan the trajectory from any start to waypoint index. */
static void plan_leg_trajectory(const plan_t *plan, int32_t index, const real_t from[3], real_t heading, trajectory_t *out)
{
    const waypoint_t *w = &plan->waypoint[index];
    const real_t above_start[3] = {plan->start[0], plan->start[1], -plan->take_off_height};
    const real_t *final_heading = w->has_heading ? &w->heading : NULL;
    trajectory_limits_t limits = plan->limits;

    limits.speed = w->speed;
    if (!plan->spline) {
        plan_straight(from, w->position, heading, &limits, final_heading, plan->nose_offset, out);
    } else {
        /* Directions through the neighbours give a curve without kinks at waypoints. */
        const real_t *before = (index > 0) ? plan->waypoint[index - 1].position : above_start;
        const real_t *further = (index > 1) ? plan->waypoint[index - 2].position : above_start;
        const real_t *after = ((index + 1) < plan->count) ? plan->waypoint[index + 1].position : w->position;
        real_t leaving[3];
        real_t arriving[3];

        for (int32_t i = 0; i < 3; i++) {
            leaving[i] = w->position[i] - ((index > 0) ? further[i] : before[i]);
            arriving[i] = after[i] - before[i];
        }
        plan_pending_curve(from, w->position, leaving, arriving, heading, &limits, final_heading,
                                plan->nose_offset, out);
    }
}

static void plan_requested_leg(const plan_t *plan, const mission_t *s, const leg_request_t *errand, const trajectory_point_t *at,
                       trajectory_t *out)
{
    real_t goal[3];

    if (errand->kind == LEG_TO_WAYPOINT) {
        plan_leg_trajectory(plan, s->waypoint_index, at->position, at->heading, out);
    } else if (errand->kind == LEG_TO_USER_WAYPOINT) {
        copy_vector(errand->has_goal ? errand->goal : at->position, goal);
        plan_straight(at->position, goal, at->heading, &plan->limits,
                            errand->has_heading ? &errand->heading : NULL, REAL(0.0), out);
    } else {
        copy_vector(s->home_position, goal);
        goal[2] = real_min(at->position[2], -MIN_WAYPOINT_HEIGHT_M);
        plan_straight(at->position, goal, at->heading, &plan->limits, NULL, plan->nose_offset, out);
    }
}

void start_leg(const plan_t *plan, mission_t *s, const message_t *why, const leg_request_t *errand)
{
    trajectory_point_t at;
    braking_motion_t brake;
    bool moving;

    current_reference(s, &at);
    moving = (real_vector_length(at.velocity) > REAL(0.01)) || (real_abs(at.heading_rate) > REAL(0.01));
    if (moving) {
        plan_braking(plan, s, &brake);
        braking_evaluate(&brake, REAL_INFINITY, &at);
    }
    plan_requested_leg(plan, s, errand, &at, &s->course.way);
    if (moving) {
        add_initial_braking(&s->course.way, &brake);
    }
    enter_state(s, STATE_WAYPOINT, why, LEVEL_INFO);
    s->course.kind = COURSE_TRAJECTORY;
    s->has_detour = false;
    s->detour_duration_s = REAL(0.0);
    s->resumed_after_detour = false;
    s->user_in_control = errand->kind != LEG_TO_WAYPOINT;
    s->returning_home = errand->kind == LEG_TO_HOME;
    s->has_requested_heading = (errand->kind == LEG_TO_USER_WAYPOINT) && errand->has_heading;
    s->requested_heading = errand->heading;
    copy_vector(s->course.way.goal, s->goal);
}

void start_leg_home(const plan_t *plan, mission_t *s, const message_t *why)
{
    const leg_request_t home = {LEG_TO_HOME, false, {REAL(0.0), REAL(0.0), REAL(0.0)}, false, REAL(0.0)};

    start_leg(plan, s, why, &home);
}

/* Finish the mission after the last wait, as its file states. */
static void complete_mission(const plan_t *plan, mission_t *s)
{
    message_t why;

    if (plan->at_end == AT_END_HOVER) {
        why = make_message(SAY_MISSION_COMPLETE_HOLDING);
        log_event(s, &why, LEVEL_INFO);
        s->user_in_control = true;
        succeed_mission(s, SAY_MISSION_COMPLETE);
    } else if (plan->at_end == AT_END_RETURN) {
        why = make_message(SAY_MISSION_COMPLETE_RETURNING);
        start_leg_home(plan, s, &why);
    } else {
        why = make_message(SAY_MISSION_COMPLETE);
        start_landing(s, &why, LEVEL_INFO);
    }
}

static void step_hover(const plan_t *plan, mission_t *s)
{
    if (s->outcome == OUTCOME_FAILED) {
        if (s->time_s >= s->hover_until_s) {
            start_landing(s, &s->reason, LEVEL_WARNING);
        }
    } else {
        detect_obstacle(plan, s);
        if ((s->state == STATE_HOVER) && !s->user_in_control && !(s->time_s < s->hover_until_s)) {
            if (s->waypoint_index >= plan->count) {
                complete_mission(plan, s);
            } else {
                const message_t why = make_message_1(SAY_TO_WAYPOINT, (real_t)(s->waypoint_index + 1));
                const leg_request_t next = {LEG_TO_WAYPOINT, false, {REAL(0.0), REAL(0.0), REAL(0.0)}, false, REAL(0.0)};

                start_leg(plan, s, &why, &next);
            }
        }
    }
}

/* Brake to a hover, from which the vehicle lands. */
static void fail_and_hover(mission_t *s, const message_t *why)
{
    trajectory_point_t now;
    trajectory_point_t at;
    braking_motion_t brake;

    current_reference(s, &now);
    plan_stop(now.position, now.velocity, now.heading, DETOUR_ACCELERATION_M_S2, REAL(0.0), REAL_INFINITY, &brake);
    braking_evaluate(&brake, REAL_INFINITY, &at);
    fail_mission(s, why);
    enter_hover(s, why, at.position, now.heading, LEVEL_WARNING);
    s->course.kind = COURSE_STOP;
    s->course.brake = brake;
    s->hover_until_s = (s->time_s + brake.duration_s) + HOVER_BEFORE_LANDING_S;
}

/* Changed goals of a user's leg */

void change_leg_goal(const plan_t *plan, mission_t *s, const message_t *why, const real_t goal[3], const real_t *heading, bool quiet)
{
    const bool known = s->has_set_point_reference;
    const real_t *aim = heading;
    trajectory_point_t now;

    now = s->set_point_reference;
    if (!known) {
        predict_step_end_reference(s, &now);
        enter_state(s, STATE_WAYPOINT, why, LEVEL_INFO);
        s->has_detour = false;
        s->detour_duration_s = REAL(0.0);
        s->resumed_after_detour = false;
        s->set_point_reference = now;
        s->has_set_point_reference = true;
    } else if (!quiet) {
        log_event(s, why, LEVEL_INFO);
    } else {
        /* a stream of goals */
    }
    if ((heading == NULL) && (real_hypot(goal[0] - now.position[0], goal[1] - now.position[1]) < MIN_DISTANCE_FOR_TURN_M)) {
        aim = &now.heading;
    }
    plan_straight(now.position, goal, now.heading, &plan->limits, aim, REAL(0.0), &s->course.way);
    s->course.kind = COURSE_TRAJECTORY;
    copy_vector(goal, s->goal);
    s->has_requested_heading = heading != NULL;
    if (heading != NULL) {
        s->requested_heading = *heading;
    }
    s->state_entered_s = s->time_s;
}

void track_set_point(const plan_t *plan, mission_t *s, const set_point_t *wanted, const estimate_t *m, real_t dt)
{
    const bool guard = plan->avoid && (s->obstacle_map.point_count > 0);

    follow_set_point(&s->set_point_reference, wanted, &plan->limits, m->motion.position, dt, guard ? &s->path_check : NULL,
                     plan->clearance);
}

/* Propagate the reference towards a changed goal; in the step of the change it is predicted already. */
static void track_changed_goal(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    if (s->has_set_point_reference && (real_abs(s->motion_clock_s) > REAL(0.0))) {
        set_point_t wanted;

        for (int32_t i = 0; i < 3; i++) {
            wanted.position[i] = s->goal[i];
            wanted.velocity[i] = REAL_NAN;
        }
        wanted.heading = s->course.way.start_heading + s->course.way.turn_angle;
        wanted.yaw_rate = REAL_NAN;
        track_set_point(plan, s, &wanted, m, dt);
    }
}

/* Whether the reference rests at the changed goal of a leg. */
static bool has_settled_at_goal(const mission_t *s)
{
    const trajectory_point_t *at = &s->set_point_reference;
    const real_t turn = (s->course.way.start_heading + s->course.way.turn_angle) - at->heading;

    return (distance_between(at->position, s->goal) < SETTLED_DISTANCE_M) && (real_vector_length(at->velocity) < SETTLED_SPEED_M_S) &&
           (real_abs(real_wrap_angle(turn)) < SETTLED_HEADING_RAD) && (real_abs(at->heading_rate) < SETTLED_HEADING_RAD);
}

static void step_leg(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    const real_t duration = s->course.way.duration_s;
    const real_t spent = s->time_s - s->state_entered_s;
    const real_t off = distance_between(m->motion.position, s->goal);
    bool there;
    const real_t number = (real_t)(s->waypoint_index + 1);
    message_t why;

    track_changed_goal(plan, s, m, dt);
    there = (s->has_set_point_reference ? has_settled_at_goal(s) : (s->motion_clock_s >= duration)) && is_at_goal(plan, s, m);
    if (there && s->returning_home) {
        why = make_message_1(SAY_HOME_REACHED, REAL(100.0) * off);
        start_landing(s, &why, LEVEL_INFO);
    } else if (there && s->user_in_control) {
        why = make_message_1(SAY_USER_WAYPOINT_REACHED, REAL(100.0) * off);
        if (s->has_set_point_reference) { /* no jump of the reference */
            copy_vector(s->set_point_reference.position, s->goal);
        }
        hover_until(s, &why, s->time_s);
    } else if (there) {
        why = make_message_2(SAY_WAYPOINT_REACHED, number, REAL(100.0) * off);
        hover_until(s, &why, s->time_s + plan->waypoint[s->waypoint_index].wait_s);
        s->waypoint_index = s->waypoint_index + 1;
        s->reached_waypoint_count = s->reached_waypoint_count + 1;
    } else if (spent > ((REAL(2.0) * duration) + REAL(20.0))) {
        if (s->returning_home) {
            why = make_message_2(SAY_HOME_MISSED, spent, off);
        } else if (s->user_in_control) {
            why = make_message_2(SAY_USER_WAYPOINT_MISSED, spent, off);
        } else {
            why = make_message_3(SAY_WAYPOINT_MISSED, number, spent, off);
        }
        fail_and_hover(s, &why);
    } else {
        detect_obstacle(plan, s);
    }
}

/* Obstacles */

static bool is_path_check_to(const path_check_t *sight, const real_t goal[3])
{
    bool same = true;

    for (int32_t i = 0; i < 2; i++) {
        same = same && (sight->goal_point[i] <= goal[i]) && (sight->goal_point[i] >= goal[i]);
    }
    return same;
}

static void detect_obstacle(const plan_t *plan, mission_t *s)
{
    if (plan->avoid && (s->obstacle_map.point_count > 0)) {
        /* Only a level path has a direction of flight; otherwise the obstacle must come near. */
        const bool underway = (s->state == STATE_WAYPOINT) && has_departed(s);
        const path_check_t *sight = &s->path_check;
        trajectory_point_t at;
        real_t from_it[2];
        real_t far;
        bool there;

        current_reference(s, &at);
        if (underway) { /* the check covers this path from the step after the goal changed */
            far = real_sqrt(sight->path_clearance_sq);
            there = is_path_check_to(sight, s->goal) && is_path_blocked(sight, plan->clearance);
        } else {
            far = find_nearest_point_distance(sight, at.position, from_it);
            there = far < plan->clearance;
        }
        if (there) {
            const message_t why = make_message_1(underway ? SAY_OBSTACLE_AHEAD : SAY_OBSTACLE_NEAR, far);
            const int32_t from = s->state;

            begin_detour(&s->detour, at.position, at.velocity, at.acceleration, s->goal, sight,
                        s->has_detour ? &s->detour : NULL);
            enter_state(s, STATE_OBSTACLE, &why, LEVEL_INFO);
            s->state_after_detour = from;
            s->has_detour = true;
            s->hold_heading = at.heading;
        }
    }
}

static void step_detour(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    message_t why;

    follow_contour(&s->detour, &s->path_check, &plan->beam_ring, m->motion.position, m->motion.attitude[2], m->ranges, s->goal,
                   plan->clearance, plan->avoid_speed, dt);
    s->detour_duration_s = s->detour_duration_s + dt;
    if (s->detour_duration_s > plan->give_up_s) {
        why = make_message_3(SAY_BLOCKED_BY_OBSTACLE, s->detour.obstacle_point[0], s->detour.obstacle_point[1], plan->give_up_s);
        fail_and_hover(s, &why);
    } else if (is_detour_finished(&s->detour)) {
        why = make_message(SAY_OBSTACLE_AVOIDED);
        enter_state(s, s->state_after_detour, &why, LEVEL_INFO);
        plan_straight(s->detour.position, s->goal, s->hold_heading, &plan->limits, &s->hold_heading, REAL(0.0),
                            &s->course.way);
        s->course.kind = COURSE_TRAJECTORY;
        s->resumed_after_detour = true;
    } else {
        /* on the detour */
    }
}

void step_phase(const plan_t *plan, mission_t *s, const estimate_t *m, real_t dt)
{
    switch (s->state) {
    case STATE_INIT:
        step_on_floor(s);
        break;
    case STATE_TAKE_OFF:
        step_take_off(plan, s, m);
        break;
    case STATE_HOVER:
        step_hover(plan, s);
        break;
    case STATE_WAYPOINT:
        step_leg(plan, s, m, dt);
        break;
    case STATE_OBSTACLE:
        step_detour(plan, s, m, dt);
        break;
    case STATE_LANDING:
        step_landing(plan, s, m, dt);
        break;
    default: /* controlled by a pilot or a program */
        break;
    }
}
