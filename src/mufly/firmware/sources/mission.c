#include "mission.h"

#include <stddef.h>

#include "phases.h"

#define TIPPED (REAL(60.0) * DEGREE)
#define LOW_FOR_S REAL(1.0)
#define VOLTAGE_LAG_S REAL(0.5)
#define GATE_HEIGHT_M REAL(0.1)
#define GATE_HEADING (REAL(8.0) * DEGREE)
#define LOOK_AROUND_S REAL(3.0)
#define LONGEST_STEP_S REAL(0.5)
#define FARTHEST_M REAL(1e4)
#define GO_AROUND_M REAL(0.4)
#define OFF_FLOOR_M REAL(0.2)
#define PER_DEGREE (REAL(180.0) / REAL_PI)

/* What may be asked in which state */

typedef enum { NEVER, ALWAYS, AT_REST, GROUNDED, ARMED, SEEN, KNOWS, HIGH, LIFTED, STILL, WAITS } condition_t;

static const condition_t table[ASK_COUNT][STATE_COUNT] = {
    /* init, take-off, hover, waypoint, obstacle, landing, rc, offboard */
    {AT_REST, AT_REST, AT_REST, AT_REST, AT_REST, AT_REST, AT_REST, AT_REST},                         /* arm */
    {GROUNDED, GROUNDED, GROUNDED, GROUNDED, GROUNDED, GROUNDED, GROUNDED, GROUNDED},                 /* disarm */
    {ARMED, NEVER, NEVER, NEVER, NEVER, NEVER, NEVER, NEVER},                                         /* take-off */
    {ARMED, KNOWS, KNOWS, KNOWS, KNOWS, NEVER, NEVER, LIFTED},                                        /* start */
    {NEVER, KNOWS, KNOWS, KNOWS, KNOWS, HIGH, NEVER, LIFTED},                                         /* pause */
    {NEVER, LIFTED, KNOWS, KNOWS, KNOWS, NEVER, NEVER, LIFTED},                                       /* go-to */
    {NEVER, LIFTED, KNOWS, KNOWS, KNOWS, NEVER, NEVER, LIFTED},                                       /* return */
    {NEVER, KNOWS, KNOWS, KNOWS, KNOWS, ALWAYS, NEVER, KNOWS},                                        /* land */
    {ALWAYS, LIFTED, KNOWS, KNOWS, KNOWS, NEVER, NEVER, ALWAYS},                                      /* offboard */
    {SEEN, SEEN, SEEN, SEEN, SEEN, SEEN, SEEN, SEEN},                                                 /* sticks */
    {STILL, WAITS, WAITS, WAITS, WAITS, NEVER, NEVER, NEVER},                                         /* load */
    {ALWAYS, ALWAYS, ALWAYS, ALWAYS, ALWAYS, ALWAYS, ALWAYS, ALWAYS},                                 /* stop */
};

bool mission_may(int32_t ask, const mission_t *s, real_t height, bool armed, bool flying)
{
    const bool off = s->motors == MOTORS_OFF;
    const bool seen = s->motors != MOTORS_BLIND;
    const bool knows = seen && (s->outcome != OUTCOME_FAILED);
    bool can = false;

    switch (table[ask][s->state]) {
    case ALWAYS:
        can = true;
        break;
    case AT_REST:
        can = armed || off;
        break;
    case GROUNDED:
        can = !flying;
        break;
    case ARMED:
        can = armed && off;
        break;
    case SEEN:
        can = seen;
        break;
    case KNOWS:
        can = knows;
        break;
    case HIGH: /* still high enough for a landing to be broken off */
        can = knows && (s->motors == MOTORS_FLY) && !(height <= GO_AROUND_M);
        break;
    case LIFTED: /* off the floor for good */
        can = knows && (s->motors != MOTORS_SPIN_UP) && !(height < OFF_FLOOR_M);
        break;
    case STILL:
        can = off;
        break;
    case WAITS: /* it hovers or flies where it was sent, and no mission is being flown */
        can = knows && s->manual && ((s->motors == MOTORS_SPIN_UP) || (s->motors == MOTORS_FLY));
        break;
    default:
        can = false;
        break;
    }
    return can;
}

static bool granted(int32_t ask, const mission_t *s, const belief_t *m)
{
    return mission_may(ask, s, s->standing[2] - m->motion.position[2], true, s->state != STATE_INIT);
}

static bool in_flight(const mission_t *s)
{
    return (s->state != STATE_INIT) && (s->state != STATE_LANDING) && (s->state != STATE_RC);
}

/* Clocks, battery, what the beams see */

/* Whether height and heading are adapted in fact, and the beams have had a look around. */
static bool gate_open(const plan_t *plan, const mission_t *s, const belief_t *m)
{
    const trajectory_t *way = &s->course.way;
    point_t at;
    real_t angle;
    real_t rate;

    trajectory_at(way, way->gate_s, &at);
    phases_swing(plan, s, &angle, &rate);
    return (real_abs(m->motion.position[2] - at.position[2]) < GATE_HEIGHT_M) &&
           (real_abs((m->motion.attitude[2] - at.heading) - angle) < (GATE_HEADING + real_abs(angle))) &&
           (!plan->scan || s->resumed || !(way->way.way > REAL(0.0)) || (s->swing >= LOOK_AROUND_S));
}

static bool anything_near(const plan_t *plan, const belief_t *m)
{
    real_t least = REAL_INFINITY;

    for (int32_t i = 0; i < plan->ring.count; i++) {
        least = real_min(least, m->ranges[i]);
    }
    return least < plan->ring.max_range;
}

static void sense(const plan_t *plan, mission_t *s, const belief_t *m, real_t dt)
{
    real_t clock = s->clock_s + dt;
    const bool scanning = phases_scanning(plan, s);

    if (s->state == STATE_WAYPOINT) {
        const real_t gate = s->course.way.gate_s;

        if ((s->clock_s <= gate) && (gate < clock) && !gate_open(plan, s, m)) {
            clock = gate;
        }
    }
    s->voltage = s->voltage + ((m->motion.voltage - s->voltage) * real_min(REAL(1.0), dt / VOLTAGE_LAG_S));
    if (scanning) {
        s->swing = real_min(LOOK_AROUND_S, s->swing + dt);
    } else {
        s->swing = real_max(REAL(0.0), real_min(REAL(1.0), s->swing) - dt);
    }
    s->time_s = m->time_s;
    s->clock_s = clock;
    s->step_s = dt;
    s->low_s = (s->voltage < plan->low_voltage) ? (s->low_s + dt) : REAL(0.0);
}

/* The user: stop, waypoints, pause, home */

void mission_stop_at_once(mission_t *s, const message_t *why)
{
    if ((s->state != STATE_INIT) || (s->motors != MOTORS_OFF)) {
        if (s->started || s->begun) {
            phases_fail(s, why);
        }
        phases_enter(s, STATE_INIT, why, LEVEL_ERROR);
        s->motors = MOTORS_OFF;
        s->has_detour = false;
        s->finished = s->outcome != OUTCOME_OPEN;
    }
}

/* Why a user's waypoint is refused; SAY_NOTHING if it is not. */
static message_t waypoint_fault(const command_t *c)
{
    message_t fault = say(SAY_NOTHING);
    const real_t *where = c->waypoint;

    if (c->has_heading && !real_finite(c->heading)) {
        fault = say_1(SAY_HEADING_REFUSED, c->heading);
    } else if (c->has_waypoint) {
        const bool finite = real_finite(where[0]) && real_finite(where[1]) && real_finite(where[2]);

        if (!finite || (where[2] > -LOWEST_M)) {
            fault = say_4(SAY_TOO_LOW, where[0], where[1], where[2], -LOWEST_M);
        } else if ((where[2] < -HIGHEST_M) || (real_hypot(where[0], where[1]) > FARTHEST_M)) {
            fault = say_4(SAY_TOO_FAR, where[0], where[1], where[2], -HIGHEST_M);
        } else {
            /* it can be flown to */
        }
    } else {
        /* it turns on the spot */
    }
    return fault;
}

static real_t compass_deg(real_t heading)
{
    const real_t deg = real_wrapped(heading) * PER_DEGREE;

    return deg + ((deg < REAL(0.0)) ? REAL(360.0) : REAL(0.0));
}

static bool same_place(const real_t a[3], const real_t b[3])
{
    bool same = true;

    for (int32_t i = 0; i < 3; i++) {
        same = same && (a[i] <= b[i]) && (a[i] >= b[i]);
    }
    return same;
}

/* What the user asks for is what it does already. */
static bool asked_already(const mission_t *s, const command_t *c)
{
    const bool heading = c->has_heading
                             ? (s->has_asked_heading && (c->heading <= s->asked_heading) && (c->heading >= s->asked_heading))
                             : !s->has_asked_heading;

    return s->manual && !s->homing && heading && (!c->has_waypoint || same_place(c->waypoint, s->goal));
}

static void to_users_waypoint(const plan_t *plan, mission_t *s, const command_t *c)
{
    message_t what = waypoint_fault(c);

    if (what.code != SAY_NOTHING) {
        const entry_t *last = &s->log[(s->logged - 1) % MISSION_LOG];

        if (!say_same(&last->message, &what)) {
            mission_log(s, &what, LEVEL_WARNING);
        }
    } else if (!asked_already(s, c)) {
        errand_t errand = {ERRAND_USER, false, {REAL(0.0), REAL(0.0), REAL(0.0)}, false, REAL(0.0)};

        errand.has_goal = c->has_waypoint;
        phases_copy(c->waypoint, errand.goal);
        errand.has_heading = c->has_heading;
        errand.heading = c->heading;
        if (!c->has_waypoint) {
            what = say_1(SAY_TURNING, compass_deg(c->heading));
        } else if (c->has_heading) {
            what = say_4(SAY_USERS_WAYPOINT_HEADING, c->waypoint[0], c->waypoint[1], c->waypoint[2],
                         c->heading * PER_DEGREE);
        } else {
            what = say_3(SAY_USERS_WAYPOINT, c->waypoint[0], c->waypoint[1], c->waypoint[2]);
        }
        phases_set_out(plan, s, &what, &errand);
    } else {
        /* it goes there already */
    }
}

void mission_pause(const plan_t *plan, mission_t *s, const message_t *why)
{
    if (s->state == STATE_HOVER) {
        if (!s->manual) {
            mission_log(s, why, LEVEL_INFO);
            s->manual = true;
            s->quit = say(SAY_NOTHING);
        }
    } else {
        stop_t brake;
        point_t at;

        phases_braking(plan, s, &brake);
        stop_at(&brake, REAL_INFINITY, &at);
        if (s->state == STATE_LANDING) {
            at.position[2] = real_min(at.position[2], -LOWEST_M);
        }
        phases_rest(s, why, at.position, at.heading, LEVEL_INFO);
        s->course.kind = COURSE_STOP;
        s->course.brake = brake;
        s->ready_s = s->time_s;
        s->manual = true;
        s->homing = false;
        s->quit = say(SAY_NOTHING);
        s->has_asked_heading = false;
        s->motors = MOTORS_FLY;
    }
}

void mission_go_on(const plan_t *plan, mission_t *s, const int32_t *first)
{
    const bool over = (s->outcome == OUTCOME_SUCCEEDED) || (s->index >= plan->count);
    int32_t index = over ? 0 : s->index;

    if (first != NULL) {
        index = *first;
    }
    if ((s->state != STATE_WAYPOINT) || s->manual || (index != s->index)) {
        message_t why = (s->begun && !over) ? say(SAY_GOES_ON) : say(SAY_BEGINS);

        if (first != NULL) {
            why = say_1(SAY_ON_TO, (real_t)(*first + 1));
        }
        if (s->state == STATE_HOVER) {
            mission_log(s, &why, LEVEL_INFO);
            s->ready_s = s->time_s;
        } else {
            mission_pause(plan, s, &why);
        }
        s->manual = false;
        s->begun = true;
        s->index = index;
        s->outcome = OUTCOME_OPEN;
        s->reason = say(SAY_NOTHING);
        s->quit = say(SAY_NOTHING);
    }
}

void mission_loaded(const plan_t *plan, mission_t *s)
{
    const message_t what = say_1((plan->count == 1) ? SAY_LOADED_ONE : SAY_LOADED, (real_t)plan->count);

    mission_log(s, &what, LEVEL_INFO);
    s->index = 0;
    s->begun = false;
    if (s->state != STATE_INIT) { /* a flight that goes on is one without a mission until that is started */
        s->outcome = OUTCOME_OPEN;
        s->reason = say(SAY_NOTHING);
        s->manual = true;
        s->quit = say(SAY_NOTHING);
    }
}

static void go_on_after_take_off(mission_t *s, int32_t first)
{
    const message_t what = (first > 0) ? say_1(SAY_FOLLOWS_FROM, (real_t)(first + 1)) : say(SAY_FOLLOWS);

    mission_log(s, &what, LEVEL_INFO);
    s->manual = false;
    s->begun = true;
    s->index = first;
    s->quit = say(SAY_NOTHING);
    s->halt = false;
}

static void broken_off(const plan_t *plan, mission_t *s, int32_t last, int32_t early)
{
    const int32_t left = plan->count - s->index;

    if (s->begun && (left > 0)) {
        s->quit = say_1((left > 1) ? early : last, (real_t)left);
    }
}

/* A pilot */

static void to_hand(mission_t *s, const belief_t *m)
{
    const message_t why = say(SAY_RC_ON);

    phases_enter(s, STATE_RC, &why, LEVEL_INFO);
    phases_copy(m->motion.position, s->hold);
    s->heading = m->motion.attitude[2];
    s->has_detour = false;
    s->homing = false;
    s->sink = REAL(0.0);
}

static void by_hand(mission_t *s, const belief_t *m, const command_t *c, real_t dt)
{
    const real_t *x = m->motion.position;

    if ((s->motors == MOTORS_OFF) && (c->climb <= REAL(0.0))) {
        phases_copy(x, s->hold);
        s->heading = m->motion.attitude[2];
        s->sink = REAL(0.0);
    } else if (s->motors == MOTORS_OFF) {
        s->started = true;
        s->begun = false;
        s->manual = true;
        s->index = 0;
        s->reached = 0;
        phases_copy(x, s->standing);
        s->outcome = OUTCOME_OPEN;
        s->reason = say(SAY_NOTHING);
        s->quit = say(SAY_NOTHING);
        s->finished = false;
        s->motors = MOTORS_SPIN_UP;
        s->clock_s = REAL(0.0);
        phases_copy(x, s->hold);
    } else if (s->motors == MOTORS_SPIN_UP) {
        if (phases_spun_up(s, m)) {
            s->motors = MOTORS_FLY;
        }
    } else {
        /* The reference stays near the helicopter, so that the sticks answer at once. */
        s->hold[2] = real_min(real_max(s->hold[2] - (c->climb * dt), x[2] - REAL(0.5)), x[2] + REAL(0.5));
        s->hold[0] = x[0];
        s->hold[1] = x[1];
        s->heading = s->heading + (c->yaw_rate * dt);
        s->sink = -c->climb;
    }
}

static bool lies(const mission_t *s, const belief_t *m)
{
    return (m->motion.position[2] > (s->standing[2] - REAL(0.1))) &&
           (real_abs(m->motion.velocity[2]) < REAL(0.1));
}

static void down(mission_t *s, int32_t code)
{
    const message_t why = say(code);
    const bool running = s->motors != MOTORS_OFF;

    phases_enter(s, STATE_INIT, &why, LEVEL_INFO);
    s->motors = running ? MOTORS_RAMP_DOWN : MOTORS_OFF;
    s->finished = (s->outcome != OUTCOME_OPEN) && !running;
}

static void from_hand(mission_t *s, const belief_t *m)
{
    const real_t *x = m->motion.position;
    real_t v[3];
    const real_t psi = m->motion.attitude[2];
    message_t why;

    if ((s->motors != MOTORS_FLY) || lies(s, m)) {
        why = say(SAY_BY_PILOT);
        if (s->begun && (s->outcome == OUTCOME_OPEN)) {
            phases_fail(s, &why);
        } else if (s->started && (s->outcome == OUTCOME_OPEN)) {
            s->outcome = OUTCOME_SUCCEEDED;
            s->reason = why;
        } else {
            /* judged already, or never in the air */
        }
        down(s, SAY_RC_OFF_FLOOR);
    } else {
        stop_t brake;
        point_t at;

        phases_copy(m->motion.velocity, v);
        stop_make(x, v, psi, BRAKE_M_S2, REAL(0.0), REAL_INFINITY, &brake);
        stop_at(&brake, REAL_INFINITY, &at);
        if (at.position[2] > s->standing[2]) {
            /* It falls too fast to stop above the floor: a way down goes with w sqrt(u^2 + w^2). */
            const real_t u = real_hypot(v[0], v[1]);
            const real_t w = v[2];
            const real_t most = ((real_max(REAL(0.0), s->standing[2] - x[2]) / (at.position[2] - x[2])) * w) *
                                real_hypot(u, w);

            v[2] = real_sqrt(REAL(0.5) * (real_hypot(u * u, REAL(2.0) * most) - (u * u)));
            stop_make(x, v, psi, BRAKE_M_S2, REAL(0.0), REAL_INFINITY, &brake);
            stop_at(&brake, REAL_INFINITY, &at);
        }
        why = say(SAY_RC_OFF);
        phases_rest(s, &why, at.position, psi, LEVEL_INFO);
        s->course.kind = COURSE_STOP;
        s->course.brake = brake;
        s->manual = true;
    }
}

/* A program's set-points */

static void to_set_points(mission_t *s, const belief_t *m, const set_point_t *wanted)
{
    message_t why = say(SAY_OFFBOARD);

    if (!offboard_right(wanted)) {
        /* nothing to follow */
    } else if (s->state != STATE_INIT) {
        point_t at;

        phases_onward(s, &at);
        phases_enter(s, STATE_OFFBOARD, &why, LEVEL_INFO);
        s->tracker = at;
        s->has_tracker = true;
        s->has_detour = false;
        s->manual = true;
        s->homing = false;
    } else if (offboard_wants_up(wanted, m->motion.position)) {
        why = say(SAY_OFFBOARD_UP);
        phases_anew(s, m);
        s->manual = true;
        phases_enter(s, STATE_OFFBOARD, &why, LEVEL_INFO);
        s->motors = MOTORS_SPIN_UP;
    } else {
        /* it stays on the floor */
    }
}

/* Follow the set-point, no faster than the mission's limits and into nothing that the beams have seen. */
static void track(const plan_t *plan, mission_t *s, const belief_t *m, const command_t *c, real_t dt)
{
    bool ready = true;

    if (s->motors == MOTORS_SPIN_UP) {
        ready = phases_spun_up(s, m);
        if (ready) {
            s->motors = MOTORS_FLY;
            s->course.kind = COURSE_NONE;
            s->has_tracker = false;
            phases_point(s, &s->tracker);
            s->has_tracker = true;
        }
    }
    /* It was begun for the end of the step in which it was entered. */
    if (ready && (s->entered_s < s->time_s) && offboard_right(&c->set_point)) {
        const bool guard = plan->avoid && (s->memory.used > 0);

        offboard_follow(&s->tracker, &c->set_point, &plan->limits, m->motion.position, dt,
                        guard ? &s->sight : NULL, plan->clearance);
        phases_copy(s->tracker.position, s->hold);
        phases_copy(s->tracker.position, s->goal);
        s->heading = s->tracker.heading;
    }
}

static void from_set_points(const plan_t *plan, mission_t *s, const belief_t *m)
{
    if ((s->motors != MOTORS_FLY) || lies(s, m)) {
        if (s->outcome == OUTCOME_OPEN) {
            s->outcome = OUTCOME_SUCCEEDED;
            s->reason = say(SAY_LANDED);
        }
        down(s, SAY_OFFBOARD_OFF_FLOOR);
    } else {
        const message_t why = say(SAY_OFFBOARD_OFF);

        mission_pause(plan, s, &why);
    }
}

/* What the user wants, where the state lets it */

static void stop_or_wait(const plan_t *plan, mission_t *s, const belief_t *m)
{
    message_t what;

    if ((s->state == STATE_TAKE_OFF) && !granted(ASK_GO_TO, s, m)) {
        if (!s->halt) {
            what = say(SAY_WILL_HOVER);
            mission_log(s, &what, LEVEL_INFO);
            s->halt = true;
            s->manual = true;
        }
    } else {
        what = say((s->state == STATE_LANDING) ? SAY_LANDING_BROKEN_OFF : SAY_PAUSED);
        mission_pause(plan, s, &what);
    }
}

static void asked(const plan_t *plan, mission_t *s, const belief_t *m, const command_t *c)
{
    const message_t land = say(SAY_LAND_SIGNAL);
    const message_t home = say(SAY_RETURN_SIGNAL);
    const int32_t first = (c->has_first && (c->first > 0)) ? c->first : 0;
    bool waits = true; /* for what is asked */
    bool fresh;

    if (c->land && (s->state != STATE_LANDING) && granted(ASK_LAND, s, m)) {
        broken_off(plan, s, SAY_LAND_EARLY_LAST, SAY_LAND_EARLY);
        phases_land(s, &land, LEVEL_INFO);
        waits = false;
    }
    if (waits && (s->state == STATE_OFFBOARD) && !c->has_set_point) {
        from_set_points(plan, s, m);
        waits = s->state != STATE_INIT;
    }
    fresh = s->manual || c->has_first;
    if (!waits) {
        /* done */
    } else if (c->start && (s->state == STATE_INIT) && granted(ASK_START, s, m)) {
        phases_start(plan, s, m, NULL, first);
    } else if (c->start && (s->state == STATE_TAKE_OFF) && fresh && granted(ASK_START, s, m)) {
        go_on_after_take_off(s, first);
    } else if (c->has_take_off && granted(ASK_TAKE_OFF, s, m)) {
        phases_start(plan, s, m, &c->take_off, 0);
    } else if ((c->pause || s->halt) && granted(ASK_PAUSE, s, m)) {
        stop_or_wait(plan, s, m);
    } else if (c->home && granted(ASK_RETURN, s, m)) {
        if (!s->homing) {
            broken_off(plan, s, SAY_RETURN_EARLY_LAST, SAY_RETURN_EARLY);
            phases_go_home(plan, s, &home);
        }
    } else if (c->has_set_point && granted(ASK_OFFBOARD, s, m)) {
        if (s->state != STATE_OFFBOARD) {
            to_set_points(s, m, &c->set_point);
        }
    } else if ((c->has_waypoint || c->has_heading) && granted(ASK_GO_TO, s, m)) {
        to_users_waypoint(plan, s, c);
    } else if (c->start && fresh && granted(ASK_START, s, m)) {
        mission_go_on(plan, s, c->has_first ? &first : NULL);
    } else {
        /* nothing, or nothing that it may do */
    }
}

static bool tipped_over(const mission_t *s, const belief_t *m)
{
    const bool near = m->motion.position[2] > (s->standing[2] - REAL(0.3));

    return near && (s->motors != MOTORS_OFF) &&
           (real_max(real_abs(m->motion.attitude[0]), real_abs(m->motion.attitude[1])) > TIPPED);
}

static void battery_low(const plan_t *plan, mission_t *s)
{
    const message_t why = say_2(SAY_BATTERY_LOW, s->voltage, plan->low_voltage);

    /* A mission that is complete and holds has not failed when its battery is used up. */
    if (s->outcome != OUTCOME_SUCCEEDED) {
        phases_fail(s, &why);
    }
    phases_land(s, &why, LEVEL_WARNING);
}

/* Transitions that do not depend on what the present state is busy with. */
static void signals(const plan_t *plan, mission_t *s, const belief_t *m, const command_t *c, real_t dt)
{
    message_t what;

    if (c->stop != 0) {
        what = say_1(SAY_GIVEN, (real_t)c->stop);
        mission_stop_at_once(s, &what);
    } else if ((s->state != STATE_INIT) && tipped_over(s, m)) {
        what = say(SAY_TIPPED_OVER);
        phases_fail(s, &what);
        what = say(SAY_TIPPED_OFF);
        mission_stop_at_once(s, &what);
    } else if (c->rc && (s->motors != MOTORS_RAMP_DOWN)) {
        /* Rotors that run down after touchdown stop first: sticks in their middle must not start them again. */
        if (s->state != STATE_RC) {
            to_hand(s, m);
        }
        if ((s->motors == MOTORS_FLY) && ((s->low_s - dt) <= LOW_FOR_S) && (LOW_FOR_S < s->low_s)) {
            what = say_2(SAY_BATTERY_LOW_PILOT, s->voltage, plan->low_voltage); /* the pilot's own decision */
            mission_log(s, &what, LEVEL_WARNING);
        }
        by_hand(s, m, c, dt);
    } else if (s->state == STATE_RC) {
        from_hand(s, m);
    } else if (in_flight(s) && (s->low_s > LOW_FOR_S)) {
        battery_low(plan, s);
    } else if ((s->state == STATE_INIT) && (s->motors != MOTORS_OFF)) {
        /* its motors run down */
    } else {
        asked(plan, s, m, c);
    }
}

/* Whether it has just set out along a curve, on which some work is left. */
static bool unmade(const mission_t *s)
{
    return (s->course.kind == COURSE_TRAJECTORY) && (s->course.way.making > 0);
}

void mission_step(const plan_t *plan, mission_t *s, const belief_t *m, const command_t *command, reference_t *out)
{
    const real_t dt = real_min(real_max(m->time_s - s->time_s, REAL(0.0)), LONGEST_STEP_S);

    while (unmade(s)) { /* a period was left out */
        trajectory_go_on(&s->course.way);
    }
    sense(plan, s, m, dt);
    signals(plan, s, m, command, dt);
    if (s->state == STATE_OFFBOARD) {
        track(plan, s, m, command, dt);
    }
    phases_step(plan, s, m, dt);
    phases_reference(plan, s, m, command, out);
    if (plan->avoid && in_flight(s)) {
        const bool sent = (s->state == STATE_WAYPOINT) || (s->state == STATE_OBSTACLE);

        avoid_begin_sight(out->path.position, sent ? s->goal : out->path.position,
                          (s->state == STATE_OBSTACLE) ? REAL_INFINITY : AVOID_LOOK_M, &s->sight);
    }
}

void mission_watch_out(const plan_t *plan, mission_t *s, const belief_t *m, int32_t part, int32_t parts)
{
    if (unmade(s)) { /* it stands or brakes */
        trajectory_go_on(&s->course.way);
    } else if (plan->avoid && in_flight(s) && ((s->memory.used > 0) || anything_near(plan, m))) {
        const int32_t count = (plan->ring.count + 7) / 8;

        avoid_observe(&s->memory, &plan->ring, m->time_s, m->motion.position, m->motion.attitude, m->ranges, s->beam,
                      count);
        avoid_look_around(&s->memory, &s->sight, m->time_s, plan->clearance, part, parts);
        s->beam += count;
        if (s->beam >= plan->ring.count) {
            s->beam -= plan->ring.count;
        }
    } else {
        /* there is nothing to look at */
    }
}
