#include "mission/machine/mission_state.h"

void copy_vector(const real_t from[3], real_t to[3])
{
    for (int32_t i = 0; i < 3; i++) {
        to[i] = from[i];
    }
}

void zero_vector(real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = REAL(0.0);
    }
}

real_t distance_between(const real_t a[3], const real_t b[3])
{
    const real_t off[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};

    return real_vector_length(off);
}

void log_event_as(mission_t *s, int32_t state, const message_t *what, int32_t level)
{
    log_entry_t *e = &s->log[s->logged_event_count % MISSION_LOG];

    e->time_s = s->time_s;
    e->state = state;
    e->level = level;
    e->message = *what;
    s->logged_event_count = (s->logged_event_count < (INT32_MAX - 1)) ? (s->logged_event_count + 1) : MISSION_LOG;
}

void log_event(mission_t *s, const message_t *what, int32_t level)
{
    log_event_as(s, s->state, what, level);
}

void enter_state(mission_t *s, int32_t state, const message_t *why, int32_t level)
{
    log_event_as(s, state, why, level);
    s->state = state;
    s->state_entered_s = s->time_s;
    s->motion_clock_s = REAL(0.0);
    s->course.kind = COURSE_NONE;
    s->has_set_point_reference = false;
    s->hover_after_take_off = false;
}

void enter_hover(mission_t *s, const message_t *why, const real_t at[3], real_t heading, int32_t level)
{
    enter_state(s, STATE_HOVER, why, level);
    copy_vector(at, s->hold_position);
    copy_vector(at, s->goal);
    s->hold_heading = heading;
}

void fail_mission(mission_t *s, const message_t *why)
{
    if (s->outcome != OUTCOME_FAILED) {
        s->outcome = OUTCOME_FAILED;
        s->reason = *why;
    }
}

void succeed_mission(mission_t *s, int32_t code)
{
    s->outcome = OUTCOME_SUCCEEDED;
    s->reason = make_message(code);
}

void clear_mission(mission_t *s)
{
    s->state = STATE_INIT;
    s->state_entered_s = REAL(0.0);
    s->motion_clock_s = REAL(0.0);
    s->step_duration_s = REAL(0.0);
    s->motors = MOTORS_OFF;
    s->waypoint_index = 0;
    s->outcome = OUTCOME_OPEN;
    s->reason = make_message(SAY_NO_MESSAGE);
    s->finished = false;
    s->user_in_control = false;
    s->has_taken_off = false;
    s->mission_begun = false;
    s->reached_waypoint_count = 0;
    s->abort_reason = make_message(SAY_NO_MESSAGE);
    s->returning_home = false;
    zero_vector(s->home_position);
    zero_vector(s->hold_position);
    zero_vector(s->goal);
    s->hold_heading = REAL(0.0);
    s->course.kind = COURSE_NONE;
    s->hover_until_s = REAL(0.0);
    s->descent_rate = REAL(0.0);
    s->descent_acceleration = REAL(0.0);
    s->rest_duration_s = REAL(0.0);
    s->touchdown_speed = REAL(0.0);
    s->low_battery_duration_s = REAL(0.0);
    s->obstacle_map.point_count = 0;
    s->obstacle_map.next_replaced_row = 0;
    s->next_beam = 0;
    begin_path_check(s->goal, s->goal, PATH_LOOK_AHEAD_M, &s->path_check);
    s->has_detour = false;
    s->state_after_detour = STATE_HOVER;
    s->detour_duration_s = REAL(0.0);
    s->resumed_after_detour = false;
    s->scan_duration_s = REAL(0.0);
    s->has_requested_heading = false;
    s->requested_heading = REAL(0.0);
    s->has_set_point_reference = false;
    s->hover_after_take_off = false;
}

void initial_mission_state(mission_t *s, const estimate_t *m)
{
    const message_t ready = make_message(SAY_READY_FOR_MISSION);

    clear_mission(s);
    clear_obstacle_map(&s->obstacle_map);
    s->logged_event_count = 0;
    s->time_s = m->time_s;
    s->state_entered_s = m->time_s;
    copy_vector(m->motion.position, s->hold_position);
    copy_vector(m->motion.position, s->home_position);
    s->hold_heading = m->motion.attitude[2];
    s->battery_V = m->motion.voltage;
    log_event(s, &ready, LEVEL_INFO);
}
