#include "onboard/supervisor/supervisor.h"

#include <stddef.h>

#include "mission/machine/ground_phases.h"
#include "mission/request_checks.h"
#include "mission/user_requests.h"

#define BATTERY_MARGIN_V REAL(0.2)
#define MAX_ARMING_SPEED_M_S REAL(0.1)
#define MAX_ARMING_RATE_RAD_S REAL(0.2)
#define MAX_ESTIMATE_AGE_S REAL(0.5)
#define MAX_STANDING_HEIGHT_ERROR_M REAL(0.05)
#define DISARM_WITHOUT_TAKE_OFF_S REAL(10.0)
#define SET_POINT_TIMEOUT_S REAL(0.5)
#define STICKS_TIMEOUT_S REAL(1.0)
#define FALL_HEIGHT_M REAL(0.1)
#define RECENT_ENTRIES 4

static const command_t no_command;

void supervisor_start(supervisor_t *s, const supervisor_settings_t *settings, int32_t interruption)
{
    static const supervisor_t none;

    *s = none;
    s->settings = *settings;
    s->heard_s = -REAL_INFINITY;
    s->set_point_s = -REAL_INFINITY;
    s->interruption = interruption;
}

void supervisor_observe(supervisor_t *s, const flight_setup_t *setup, const estimate_t *m, real_t floor_m)
{
    const real_t t = m->time_s;
    const bool alive = real_is_finite(t) && ((t < s->heard_s) || (t > s->heard_s));

    s->stale_s = alive ? REAL(0.0) : (s->stale_s + setup->period_s);
    s->now_s = (alive && (t >= s->now_s)) ? t : (s->now_s + setup->period_s);
    if (alive) {
        s->heard_s = t;
    }
    s->floor_m = floor_m;
    s->begun = true;
}

static bool are_finite(const real_t x[3])
{
    return real_is_finite(x[0]) && real_is_finite(x[1]) && real_is_finite(x[2]);
}

uint32_t supervisor_arming_faults(const supervisor_t *s, const flight_setup_t *setup, const estimate_t *m)
{
    const motion_estimate_t *now = &m->motion;
    const bool known = s->begun && are_finite(now->position) && are_finite(now->velocity) && are_finite(now->attitude) &&
                       are_finite(now->rates);
    uint32_t why = 0U;

    if (!known) {
        why |= ARMING_NOT_MEASURED;
    }
    if (s->stale_s > MAX_ESTIMATE_AGE_S) {
        why |= ARMING_STALE;
    }
    if (!(now->voltage > REAL(0.0)) || !real_is_finite(now->voltage)) {
        why |= ARMING_NO_VOLTAGE;
    } else if (now->voltage < (setup->plan->low_voltage + BATTERY_MARGIN_V)) {
        why |= ARMING_BATTERY_LOW;
    } else {
        /* charged */
    }
    if (known) {
        const real_t height = -now->position[2] - s->floor_m;
        real_t fastest = REAL(0.0);

        for (int32_t i = 0; i < 3; i++) {
            fastest = real_max(fastest, real_abs(now->rates[i]));
        }
        why |= (real_abs(height - s->settings.standing_m) > MAX_STANDING_HEIGHT_ERROR_M) ? ARMING_NOT_STANDING : 0U; /* NaN: unchecked */
        why |= m->valid ? 0U : ARMING_NOT_VALID;
        why |= stands_tilted(m) ? ARMING_TILTED : 0U;
        why |= ((real_vector_length(now->velocity) > MAX_ARMING_SPEED_M_S) || (fastest > MAX_ARMING_RATE_RAD_S)) ? ARMING_MOVED
                                                                                                         : 0U;
    }
    if (s->interruption != INTERRUPTION_NONE) {
        why |= ARMING_INTERRUPTED;
    }
    if (s->has_sticks && (s->sticks.pilot_climb_rate > REAL(0.0))) {
        why |= ARMING_CLIMB_STICK;
    }
    return why;
}

static bool is_stopping(const supervisor_t *s)
{
    return s->is_pending && (s->pending.motor_stop_reason != STOP_NONE);
}

bool supervisor_in_air(const software_t *software, const estimate_t *m)
{
    const real_t height = software->mission.home_position[2] - m->motion.position[2];
    real_t fastest = REAL(0.0);

    for (int32_t i = 0; i < 3; i++) {
        fastest = real_max(fastest, real_abs(m->motion.velocity[i]));
    }
    return software_flying(software) && !((height < REAL(0.05)) && (fastest < REAL(0.1)));
}

static bool is_permitted(const supervisor_t *s, const software_t *software, const estimate_t *m, int32_t ask)
{
    const mission_t *x = &software->mission;
    const real_t height = x->has_taken_off ? (x->home_position[2] - m->motion.position[2]) : REAL_NAN;

    return check_request(ask, x, height, s->armed, supervisor_in_air(software, m));
}

static void set_disarmed(supervisor_t *s)
{
    s->armed = false;
    s->offboard = false;
    s->is_pending = false;
}

static void store_interruption(supervisor_t *s, int32_t what)
{
    s->interruption = what;
    s->interruption_told = false;
}

static int32_t send_command(supervisor_t *s, const command_t *command)
{
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (!is_stopping(s)) {
        s->offboard = false;
        s->pending = *command;
        s->is_pending = true;
        answer = ANSWER_ACCEPTED;
    }
    return answer;
}

static void stop_the_motors(supervisor_t *s, const software_t *software, const estimate_t *m, int32_t why)
{
    const bool idle = (software->motors == MOTORS_OFF) && (software->mission.state == STATE_INIT);

    set_disarmed(s);
    s->has_sticks = false;
    if (!idle) {
        const real_t height = software->mission.home_position[2] - m->motion.position[2];

        if (software_flying(software) && (height > FALL_HEIGHT_M)) {
            store_interruption(s, INTERRUPTION_STOPPED);
        }
        s->pending = no_command;
        s->pending.motor_stop_reason = why;
        s->is_pending = true;
    }
}

static int32_t arm(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m,
                   const user_request_t *ask)
{
    int32_t answer = ANSWER_ACCEPTED;

    if (s->armed) {
        /* as it is */
    } else if (is_stopping(s) || !is_permitted(s, software, m, REQUEST_ARM)) {
        answer = ANSWER_REJECTED_FOR_NOW;
    } else {
        if ((s->interruption != INTERRUPTION_NONE) && (ask->force || (s->interruption_told && !ask->repeated))) {
            s->interruption = INTERRUPTION_NONE;
        }
        s->interruption_told = true;
        s->arming_faults = supervisor_arming_faults(s, setup, m);
        if (ask->force) {
            s->arming_faults &= ARMING_CLIMB_STICK;
        }
        if (s->arming_faults != 0U) {
            answer = ANSWER_REJECTED_FOR_NOW;
        } else {
            s->armed = true;
            s->armed_s = s->now_s;
        }
    }
    return answer;
}

static int32_t disarm(supervisor_t *s, const software_t *software, const estimate_t *m, bool force)
{
    int32_t answer = ANSWER_ACCEPTED;

    if (force) {
        stop_the_motors(s, software, m, STOP_EMERGENCY);
    } else if (!s->armed) {
        /* as it is */
    } else if (is_permitted(s, software, m, REQUEST_DISARM)) {
        stop_the_motors(s, software, m, STOP_DISARMED);
    } else {
        answer = ANSWER_REJECTED_FOR_NOW;
    }
    return answer;
}

/* Whether the motors may start for a climb. */
static bool may_climb(const supervisor_t *s, const software_t *software, const estimate_t *m, int32_t ask)
{
    return is_permitted(s, software, m, ask) &&
           (!are_finite(m->motion.attitude) || (describe_start_fault(m).code == SAY_NO_MESSAGE));
}

static int32_t take_off(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m,
                        const user_request_t *ask)
{
    const real_t height = ask->has_height ? ask->height : setup->plan->take_off_height;
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (!(real_is_finite(height) && (height >= MIN_WAYPOINT_HEIGHT_M) && (height <= MAX_HEIGHT_M))) {
        answer = ANSWER_DENIED;
    } else if (may_climb(s, software, m, REQUEST_TAKE_OFF)) {
        command_t c = no_command;

        c.has_take_off_height = true;
        c.take_off_height = height;
        answer = send_command(s, &c);
    } else {
        /* not now */
    }
    return answer;
}

static int32_t start_mission(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m,
                             const user_request_t *ask)
{
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (setup->plan->count == 0) {
        /* no mission */
    } else if (ask->has_first && ((ask->first < 0) || (ask->first >= setup->plan->count))) {
        answer = ANSWER_DENIED;
    } else if ((software->mission.state == STATE_INIT) ? may_climb(s, software, m, REQUEST_START)
                                                     : is_permitted(s, software, m, REQUEST_START)) {
        command_t c = no_command;

        c.start = true;
        c.has_first_waypoint = ask->has_first;
        c.first_waypoint = ask->has_first ? ask->first : 0;
        answer = send_command(s, &c);
    } else {
        /* not now */
    }
    return answer;
}

static int32_t go_to(supervisor_t *s, const software_t *software, const estimate_t *m, const user_request_t *ask)
{
    command_t c = no_command;
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    c.has_waypoint = ask->has_position;
    c.has_heading = ask->has_heading;
    c.heading = ask->has_heading ? ask->heading : REAL(0.0);
    for (int32_t i = 0; i < 3; i++) {
        c.waypoint[i] = ask->has_position ? ask->position[i] : REAL(0.0);
    }
    if ((!ask->has_position && !ask->has_heading) || (describe_user_waypoint_fault(&c).code != SAY_NO_MESSAGE)) {
        answer = ANSWER_DENIED;
    } else if (is_permitted(s, software, m, REQUEST_GO_TO)) {
        answer = send_command(s, &c);
    } else {
        /* not now */
    }
    return answer;
}

static int32_t request_simple(supervisor_t *s, const software_t *software, const estimate_t *m, int32_t kind)
{
    command_t c = no_command;
    int32_t ask = REQUEST_LAND;
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (kind == USER_PAUSE) {
        c.pause = true;
        ask = REQUEST_PAUSE;
    } else if (kind == USER_RETURN) {
        c.return_requested = true;
        ask = REQUEST_RETURN;
    } else {
        c.land = true;
    }
    if (is_permitted(s, software, m, ask)) {
        answer = send_command(s, &c);
    }
    return answer;
}

static int32_t set_sticks(supervisor_t *s, const software_t *software, const estimate_t *m, const user_request_t *ask)
{
    const supervisor_settings_t *most = &s->settings;
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (!(real_is_finite(ask->roll) && real_is_finite(ask->pitch) && real_is_finite(ask->yaw_rate) &&
          real_is_finite(ask->climb_rate))) {
        answer = ANSWER_DENIED;
    } else if (is_permitted(s, software, m, REQUEST_STICKS)) {
        s->offboard = false;
        s->has_sticks = true;
        s->sticks = no_command;
        s->sticks.rc_active = true;
        s->sticks.pilot_roll = real_min(real_max(ask->roll, -most->stick_tilt), most->stick_tilt);
        s->sticks.pilot_pitch = real_min(real_max(ask->pitch, -most->stick_tilt), most->stick_tilt);
        s->sticks.pilot_yaw_rate = real_min(real_max(ask->yaw_rate, -most->stick_yaw_rate), most->stick_yaw_rate);
        s->sticks.pilot_climb_rate = real_min(real_max(ask->climb_rate, -most->stick_climb), most->stick_climb);
        s->sticks_s = s->now_s;
        answer = ANSWER_ACCEPTED;
    } else {
        /* not now */
    }
    return answer;
}

static int32_t start_offboard(supervisor_t *s, const software_t *software, const estimate_t *m)
{
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (s->has_set_point && !((s->now_s - s->set_point_s) > SET_POINT_TIMEOUT_S) && !is_stopping(s) &&
        is_permitted(s, software, m, REQUEST_OFFBOARD)) {
        s->offboard = true;
        answer = ANSWER_ACCEPTED;
    }
    return answer;
}

int32_t supervisor_request(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m,
                           const user_request_t *ask)
{
    int32_t answer = ANSWER_ACCEPTED;

    switch (ask->kind) {
    case USER_ARM:
        answer = arm(s, setup, software, m, ask);
        break;
    case USER_DISARM:
        answer = disarm(s, software, m, ask->force);
        break;
    case USER_START:
        answer = start_mission(s, setup, software, m, ask);
        break;
    case USER_TAKE_OFF:
        answer = take_off(s, setup, software, m, ask);
        break;
    case USER_LAND:
        if (software->mission.state != STATE_LANDING) {
            answer = request_simple(s, software, m, ask->kind);
        }
        break;
    case USER_PAUSE:
    case USER_RETURN:
        answer = request_simple(s, software, m, ask->kind);
        break;
    case USER_GO_TO:
        answer = go_to(s, software, m, ask);
        break;
    case USER_STICKS:
        answer = set_sticks(s, software, m, ask);
        break;
    case USER_RELEASE_STICKS:
        s->has_sticks = false;
        break;
    case USER_SET_POINT:
        if (is_set_point_valid(&ask->set_point)) {
            s->has_set_point = true;
            s->set_point = ask->set_point;
            s->set_point_s = s->now_s;
        } else {
            answer = ANSWER_DENIED;
        }
        break;
    case USER_OFFBOARD:
        answer = start_offboard(s, software, m);
        break;
    case USER_END_OFFBOARD:
        s->offboard = false;
        break;
    default:
        answer = ANSWER_DENIED;
        break;
    }
    return answer;
}

void supervisor_hear_commander(supervisor_t *s)
{
    s->has_commander = true;
    s->commander_heard_s = s->now_s;
}

void supervisor_step_link(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m)
{
    const real_t silent = s->has_commander ? real_max(REAL(0.0), s->now_s - s->commander_heard_s) : REAL(0.0);
    const bool ending = (software->mission.state == STATE_LANDING) || software->mission.returning_home;
    const bool flying = supervisor_in_air(software, m);
    int32_t order = LINK_HEARD;

    if ((silent < s->settings.link_loss_s) || !flying) {
        s->link_stage = LINK_HEARD;
    } else if ((s->link_stage == LINK_HEARD) && !ending) {
        s->link_stage = LINK_HOVER;
        order = LINK_HOVER;
    } else if ((s->link_stage == LINK_HOVER) && (silent >= (s->settings.link_loss_s + s->settings.link_land_s))) {
        s->link_stage = LINK_LAND;
        order = ending ? LINK_HEARD : LINK_LAND;
    } else {
        /* as before */
    }
    if (order != LINK_HEARD) {
        s->has_sticks = false;
        s->link_owed = order;
    }
    if ((s->link_stage == LINK_HEARD) || ending) {
        s->link_owed = LINK_HEARD;
    }
    if (s->link_owed != LINK_HEARD) { /* repeated until it is accepted */
        user_request_t ask = {0};

        ask.kind = (s->link_owed == LINK_HOVER) ? USER_PAUSE : USER_LAND;
        if (supervisor_request(s, setup, software, m, &ask) == ANSWER_ACCEPTED) {
            s->link_owed = LINK_HEARD;
        }
    }
}

void supervisor_collect(supervisor_t *s, const software_t *software, command_t *out)
{
    *out = no_command;
    if ((software->tick == 0) || is_stopping(s)) {
        if (s->is_pending) {
            *out = s->pending;
            s->is_pending = false;
        }
        if (s->has_sticks && ((s->now_s - s->sticks_s) > STICKS_TIMEOUT_S)) {
            s->has_sticks = false;
        }
        if (s->has_sticks) {
            const int32_t why = out->motor_stop_reason;

            *out = s->sticks;
            out->pilot_climb_rate = s->armed ? out->pilot_climb_rate : real_min(out->pilot_climb_rate, REAL(0.0));
            out->motor_stop_reason = why;
        }
        if (s->offboard) {
            if ((s->now_s - s->set_point_s) > SET_POINT_TIMEOUT_S) {
                s->offboard = false;
            } else if (s->armed) {
                out->has_program_set_point = true;
                out->program_set_point = s->set_point;
            } else {
                /* waits for arming */
            }
        }
    }
}

/* Interruption in one of the latest entries of the log since arming. */
static int32_t find_interruption(const supervisor_t *s, const mission_t *x)
{
    int32_t found = INTERRUPTION_NONE;

    for (int32_t k = x->logged_event_count - RECENT_ENTRIES; (k < x->logged_event_count) && (found == INTERRUPTION_NONE); k++) {
        if (k >= 0) {
            const log_entry_t *e = &x->log[k % MISSION_LOG];

            if (e->time_s >= s->armed_s) {
                if (e->message.code == SAY_TIPPED_MOTORS_OFF) {
                    found = INTERRUPTION_TIPPED;
                } else if (e->message.code == SAY_MOTORS_OFF_AFTER_DESCENT) {
                    found = INTERRUPTION_BLIND;
                } else {
                    /* a usual entry */
                }
            }
        }
    }
    return found;
}

void supervisor_conclude(supervisor_t *s, const software_t *software, bool due)
{
    if (due) {
        const bool ran = s->ran;
        const int32_t state = software->mission.state;

        s->ran = software->motors != MOTORS_OFF;
        if ((state != STATE_OFFBOARD) && (state != STATE_INIT)) {
            s->offboard = false;
        }
        if (s->armed && ran && !s->ran) {
            const int32_t what = find_interruption(s, &software->mission);

            if (what != INTERRUPTION_NONE) {
                store_interruption(s, what);
            }
            set_disarmed(s);
        } else if (s->armed && !s->ran && ((s->now_s - s->armed_s) > DISARM_WITHOUT_TAKE_OFF_S)) {
            set_disarmed(s);
        } else {
            /* as it is */
        }
    }
}
