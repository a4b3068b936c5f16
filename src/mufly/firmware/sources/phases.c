#include "phases.h"

#include <stddef.h>

#define SWEEP_PERIOD_S REAL(4.0)
#define OMEGA (REAL(0x1.921fb54442d18p+2) / SWEEP_PERIOD_S)
#define SINK_LAG_S REAL(0.15)
#define NEAR_FLOOR_M REAL(0.1)
#define STAYS_M REAL(0.25)
#define STILL_S REAL(0.3)
#define STANDS_M REAL(0.02) /* on an estimate: lower than, */
#define PRESSED_M REAL(0.03) /* told to be lower by, */
#define PRESSED_S REAL(0.05) /* for, */
#define KNOWN_M REAL(0.05)   /* its height as certain (standard deviation) */
#define DRIFTS_BELOW_M REAL(0.6)
#define DRIFTS_M_S REAL(0.3)
#define DRIFTING_M_S REAL(0.05)
#define SLOW_FROM_M REAL(0.4)
#define HARD_TOUCHDOWN_M_S REAL(0.3)
#define SETTLE_BEFORE_LANDING_S REAL(2.0)

void phases_copy(const real_t from[3], real_t to[3])
{
    for (int32_t i = 0; i < 3; i++) {
        to[i] = from[i];
    }
}

static void zero(real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = REAL(0.0);
    }
}

static real_t away(const real_t a[3], const real_t b[3])
{
    const real_t off[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};

    return real_length(off);
}

/* The log, and how a state is entered */

void phases_log_as(mission_t *s, int32_t state, const message_t *what, int32_t level)
{
    entry_t *e = &s->log[s->logged % MISSION_LOG];

    e->time_s = s->time_s;
    e->state = state;
    e->level = level;
    e->message = *what;
    s->logged = (s->logged < (INT32_MAX - 1)) ? (s->logged + 1) : MISSION_LOG;
}

void mission_log(mission_t *s, const message_t *what, int32_t level)
{
    phases_log_as(s, s->state, what, level);
}

void phases_enter(mission_t *s, int32_t state, const message_t *why, int32_t level)
{
    phases_log_as(s, state, why, level);
    s->state = state;
    s->entered_s = s->time_s;
    s->clock_s = REAL(0.0);
    s->course.kind = COURSE_NONE;
    s->has_tracker = false;
    s->halt = false;
}

void phases_rest(mission_t *s, const message_t *why, const real_t at[3], real_t heading, int32_t level)
{
    phases_enter(s, STATE_HOVER, why, level);
    phases_copy(at, s->hold);
    phases_copy(at, s->goal);
    s->heading = heading;
}

void phases_fail(mission_t *s, const message_t *why)
{
    if (s->outcome != OUTCOME_FAILED) {
        s->outcome = OUTCOME_FAILED;
        s->reason = *why;
    }
}

static void succeed(mission_t *s, int32_t code)
{
    s->outcome = OUTCOME_SUCCEEDED;
    s->reason = say(code);
}

/* The reference */

static void held(const real_t at[3], real_t heading, point_t *out)
{
    phases_copy(at, out->position);
    zero(out->velocity);
    zero(out->acceleration);
    out->heading = heading;
    out->heading_rate = REAL(0.0);
}

void phases_point(const mission_t *s, point_t *out)
{
    if (s->state == STATE_OBSTACLE) {
        phases_copy(s->detour.position, out->position);
        phases_copy(s->detour.velocity, out->velocity);
        phases_copy(s->detour.acceleration, out->acceleration);
        out->heading = s->heading;
        out->heading_rate = REAL(0.0);
    } else if ((s->state == STATE_OFFBOARD) && s->has_tracker) {
        *out = s->tracker;
    } else if ((s->course.kind == COURSE_NONE) || (s->motors == MOTORS_SPIN_UP)) {
        held(s->hold, s->heading, out);
    } else {
        if (s->course.kind == COURSE_TRAJECTORY) {
            trajectory_at(&s->course.way, s->clock_s, out);
        } else {
            stop_at(&s->course.brake, s->clock_s, out);
        }
        if (s->state == STATE_LANDING) {
            out->position[2] = s->hold[2];
            out->velocity[2] = s->sink;
            out->acceleration[2] = s->sink_rate;
        }
    }
}

void phases_onward(const mission_t *s, point_t *out)
{
    phases_point(s, out);
    if (s->state == STATE_LANDING) {
        out->position[2] += s->step_s * out->velocity[2];
    } else if ((s->state == STATE_OBSTACLE) || (s->state == STATE_OFFBOARD)) {
        for (int32_t i = 0; i < 3; i++) {
            out->position[i] += s->step_s * out->velocity[i];
        }
    } else {
        /* a motion's clock has been moved on already */
    }
    if ((s->state == STATE_LANDING) || (s->state == STATE_OBSTACLE) || (s->state == STATE_OFFBOARD)) {
        out->heading += s->step_s * out->heading_rate;
    }
}

bool phases_at_gate(const mission_t *s)
{
    return s->clock_s >= s->course.way.gate_s;
}

bool phases_scanning(const plan_t *plan, const mission_t *s)
{
    return (s->state == STATE_OBSTACLE) || (plan->scan && (s->state == STATE_WAYPOINT) && phases_at_gate(s));
}

void phases_swing(const plan_t *plan, const mission_t *s, real_t *angle, real_t *rate)
{
    *angle = REAL(0.0);
    *rate = REAL(0.0);
    if (s->swing > REAL(0.0)) {
        const real_t x = real_min(s->swing, REAL(1.0));
        const real_t most = REAL(0.5) * plan->ring.spacing;
        const real_t size = ((most * x) * x) * (REAL(3.0) - (REAL(2.0) * x));
        const real_t grows = phases_scanning(plan, s) ? REAL(1.0) : REAL(-1.0);
        const real_t growth = (((most * REAL(6.0)) * x) * (REAL(1.0) - x)) * grows;
        real_t since = s->time_s;
        real_t sine;
        real_t cosine;

        if (real_abs(since) < REAL(4e9)) {
            since -= SWEEP_PERIOD_S * (real_t)(int32_t)(since / SWEEP_PERIOD_S);
        }
        sine_cosine(OMEGA * since, &sine, &cosine);
        *angle = size * sine;
        *rate = (growth * sine) + ((size * OMEGA) * cosine);
    }
}

void phases_reference(const plan_t *plan, const mission_t *s, const belief_t *m, const command_t *c,
                      reference_t *out)
{
    const motion_t *now = &m->motion;

    out->motors = s->motors;
    out->rc = false;
    out->roll = REAL(0.0);
    out->pitch = REAL(0.0);
    zero(out->path.velocity);
    zero(out->path.acceleration);
    out->heading_rate = REAL(0.0);
    if (s->state == STATE_RC) {
        for (int32_t i = 0; i < 2; i++) {
            out->path.position[i] = now->position[i];
            out->path.velocity[i] = now->velocity[i];
        }
        out->path.position[2] = s->hold[2];
        out->path.velocity[2] = s->sink;
        out->heading = s->heading;
        if (s->motors == MOTORS_FLY) {
            out->heading_rate = c->yaw_rate;
        }
        out->rc = true;
        out->roll = c->roll;
        out->pitch = c->pitch;
    } else if (s->state == STATE_INIT) {
        phases_copy(now->position, out->path.position);
        out->heading = now->attitude[2];
    } else {
        point_t at;
        real_t angle;
        real_t rate;

        phases_point(s, &at);
        phases_swing(plan, s, &angle, &rate);
        phases_copy(at.position, out->path.position);
        phases_copy(at.velocity, out->path.velocity);
        phases_copy(at.acceleration, out->path.acceleration);
        out->heading = at.heading + angle;
        out->heading_rate = at.heading_rate + rate;
    }
}

/* Down to the floor */

void phases_land(mission_t *s, const message_t *why, int32_t level)
{
    const message_t reason = *why; /* it may be the one that is kept in s */

    if (s->motors == MOTORS_SPIN_UP) {
        if (s->begun) {
            phases_fail(s, &reason);
        }
        phases_enter(s, STATE_INIT, &reason, level);
        s->motors = MOTORS_RAMP_DOWN;
    } else {
        point_t now;
        point_t next;
        point_t foot;
        stop_t brake;

        phases_point(s, &now);
        phases_onward(s, &next);
        next.velocity[0] = now.velocity[0];
        next.velocity[1] = now.velocity[1];
        next.velocity[2] = REAL(0.0);
        stop_make(next.position, next.velocity, now.heading, BRAKE_M_S2, REAL(0.0), REAL_INFINITY, &brake);
        stop_at(&brake, REAL_INFINITY, &foot);
        phases_enter(s, STATE_LANDING, &reason, level);
        s->course.kind = COURSE_STOP;
        s->course.brake = brake;
        phases_copy(foot.position, s->hold);
        s->hold[2] = now.position[2];
        phases_copy(foot.position, s->goal);
        s->goal[2] = s->standing[2];
        s->heading = now.heading;
        s->sink = now.velocity[2];
        s->sink_rate = now.acceleration[2];
        s->motors = MOTORS_FLY;
        s->still_s = REAL(0.0);
        s->impact = REAL(0.0);
    }
}

static void touched_down(mission_t *s)
{
    message_t what = say(SAY_TOUCHDOWN);

    if (s->impact <= HARD_TOUCHDOWN_M_S) {
        mission_log(s, &what, LEVEL_INFO);
    } else {
        what = say_2(SAY_HARD_TOUCHDOWN, s->impact, HARD_TOUCHDOWN_M_S);
        mission_log(s, &what, LEVEL_WARNING);
    }
    s->motors = MOTORS_RAMP_DOWN;
    s->clock_s = REAL(0.0);
}

/* How the flight went, now that it is down. */
static void judged(mission_t *s)
{
    if (s->outcome == OUTCOME_OPEN) {
        if (s->quit.code != SAY_NOTHING) {
            phases_fail(s, &s->quit);
        } else {
            succeed(s, s->begun ? SAY_COMPLETE : SAY_LANDED);
        }
    }
}

static void sink(const plan_t *plan, mission_t *s, const belief_t *m, real_t dt)
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
        if (!(s->clock_s < RAMP_DOWN_S)) {
            const message_t down = say(SAY_LANDED);

            judged(s);
            phases_enter(s, STATE_INIT, &down, LEVEL_INFO);
            s->motors = MOTORS_OFF;
            s->finished = true;
        }
    } else {
        above = s->standing[2] - s->hold[2];
        wanted = real_min(plan->limits.descent, real_sqrt((plan->touchdown * plan->touchdown) +
                                                          (real_max(REAL(0.0), above - SLOW_FROM_M) * a)));
        if (above < REAL(-0.3)) {
            wanted = REAL(0.0);
        } else if ((above > REAL(0.0)) && (above < DRIFTS_BELOW_M) &&
                   (((m->motion.velocity[0] * m->motion.velocity[0]) +
                     (m->motion.velocity[1] * m->motion.velocity[1])) > (DRIFTS_M_S * DRIFTS_M_S))) {
            wanted = real_min(wanted, DRIFTING_M_S);
        } else {
            /* as fast as it may */
        }
        ask = real_min(real_max((wanted - s->sink) / SINK_LAG_S, -a), a);
        s->sink_rate = s->sink_rate + ((ask - s->sink_rate) * real_min(REAL(1.0), dt / REAL(0.1)));
        s->sink = s->sink + (s->sink_rate * dt);
        s->hold[2] = s->hold[2] + (s->sink * dt);
        lying = (z > (s->standing[2] - REAL(0.03))) && (s->hold[2] > (s->standing[2] + REAL(0.1)));
        lying = lying || (s->hold[2] > (z + STAYS_M)); /* on something, or lower than it believes */
        /* Who does not know how fast it drifts must not steer with a leg on the floor. */
        stands = m->judged && (z > (s->standing[2] - STANDS_M)) && (s->hold[2] > (z + PRESSED_M)) &&
                 (m->position_variance[2] < (KNOWN_M * KNOWN_M));
        if (stands || (lying && (real_abs(w) < REAL(0.05)))) {
            s->still_s = s->still_s + dt;
        } else {
            s->still_s = REAL(0.0);
        }
        near = z > (s->standing[2] - NEAR_FLOOR_M);
        if (m->judged) { /* a filter that does not know of the floor yet goes on falling for a moment */
            near = near && (z < (s->standing[2] - LIFT_OFF_M));
        }
        if (near) {
            s->impact = real_max(s->impact, w);
        }
        if (s->still_s > (stands ? PRESSED_S : STILL_S)) {
            touched_down(s);
        }
    }
}

void mission_blind(mission_t *s, real_t time_s, const message_t *why)
{
    s->time_s = time_s;
    phases_fail(s, why);
    phases_enter(s, STATE_LANDING, why, LEVEL_ERROR);
    s->motors = MOTORS_BLIND;
    s->has_detour = false;
}

void mission_come_down(mission_t *s, const message_t *why)
{
    if ((s->state == STATE_INIT) || (s->state == STATE_RC)) {
        mission_log(s, why, LEVEL_ERROR);
    } else {
        phases_fail(s, why);
        if (s->state == STATE_LANDING) {
            mission_log(s, why, LEVEL_ERROR);
        } else {
            phases_land(s, why, LEVEL_ERROR);
        }
    }
}

void mission_down_blind(mission_t *s, real_t time_s)
{
    const message_t why = say(SAY_CAME_DOWN);

    s->time_s = time_s;
    phases_enter(s, STATE_INIT, &why, LEVEL_INFO);
    s->motors = MOTORS_OFF;
    s->finished = true;
}

/* On the floor and up */

bool mission_lifted_off(const mission_t *s, const belief_t *m)
{
    return m->motion.position[2] < (s->standing[2] - LIFT_OFF_M);
}

bool mission_tips(const belief_t *m)
{
    return real_max(real_abs(m->motion.rates[0]), real_abs(m->motion.rates[1])) > TIPS_RAD_S;
}

bool phases_spun_up(const mission_t *s, const belief_t *m)
{
    return (s->clock_s >= SPIN_UP_S) || mission_lifted_off(s, m);
}

static void stand(mission_t *s)
{
    if ((s->motors == MOTORS_RAMP_DOWN) && (s->clock_s > RAMP_DOWN_S)) {
        s->motors = MOTORS_OFF;
        s->finished = s->outcome != OUTCOME_OPEN;
    }
}

/* All but the log, the clock and the battery as before the first flight. */
static void blank(mission_t *s)
{
    s->state = STATE_INIT;
    s->entered_s = REAL(0.0);
    s->clock_s = REAL(0.0);
    s->step_s = REAL(0.0);
    s->motors = MOTORS_OFF;
    s->index = 0;
    s->outcome = OUTCOME_OPEN;
    s->reason = say(SAY_NOTHING);
    s->finished = false;
    s->manual = false;
    s->started = false;
    s->begun = false;
    s->reached = 0;
    s->quit = say(SAY_NOTHING);
    s->homing = false;
    zero(s->standing);
    zero(s->hold);
    zero(s->goal);
    s->heading = REAL(0.0);
    s->course.kind = COURSE_NONE;
    s->ready_s = REAL(0.0);
    s->sink = REAL(0.0);
    s->sink_rate = REAL(0.0);
    s->still_s = REAL(0.0);
    s->impact = REAL(0.0);
    s->low_s = REAL(0.0);
    s->memory.used = 0;
    s->memory.turn = 0;
    s->beam = 0;
    avoid_begin_sight(s->goal, s->goal, AVOID_LOOK_M, &s->sight);
    s->has_detour = false;
    s->back = STATE_HOVER;
    s->avoided_s = REAL(0.0);
    s->resumed = false;
    s->swing = REAL(0.0);
    s->has_asked_heading = false;
    s->asked_heading = REAL(0.0);
    s->has_tracker = false;
    s->halt = false;
}

void mission_begin(mission_t *s, const belief_t *m)
{
    const message_t ready = say(SAY_READY);

    blank(s);
    avoid_forget(&s->memory);
    s->logged = 0;
    s->time_s = m->time_s;
    s->entered_s = m->time_s;
    phases_copy(m->motion.position, s->hold);
    phases_copy(m->motion.position, s->standing);
    s->heading = m->motion.attitude[2];
    s->voltage = m->motion.voltage;
    mission_log(s, &ready, LEVEL_INFO);
}

void phases_anew(mission_t *s, const belief_t *m)
{
    blank(s);
    s->started = true;
    phases_copy(m->motion.position, s->hold);
    phases_copy(m->motion.position, s->standing);
    s->heading = m->motion.attitude[2];
}

void phases_start(const plan_t *plan, mission_t *s, const belief_t *m, const real_t *height, int32_t first)
{
    const real_t up = (height == NULL) ? plan->take_off_height : *height;
    const message_t why = (height == NULL) ? say(SAY_START_SIGNAL) : say_1(SAY_TAKE_OFF_SIGNAL, up);

    phases_anew(s, m);
    s->begun = height == NULL;
    s->manual = height != NULL;
    s->index = first;
    phases_copy(s->standing, s->goal);
    s->goal[2] = -up;
    phases_enter(s, STATE_TAKE_OFF, &why, LEVEL_INFO);
    s->motors = MOTORS_SPIN_UP;
    trajectory_straight(s->standing, s->goal, s->heading, &plan->limits, NULL, REAL(0.0), &s->course.way);
    s->course.kind = COURSE_TRAJECTORY;
}

static void watch(const plan_t *plan, mission_t *s);

static void hold_at(mission_t *s, const message_t *why, real_t ready_s)
{
    point_t at;
    real_t goal[3];

    phases_point(s, &at);
    phases_copy(s->goal, goal);
    phases_rest(s, why, goal, at.heading, LEVEL_INFO);
    s->ready_s = ready_s;
}

static void take_off(const plan_t *plan, mission_t *s, const belief_t *m)
{
    const real_t z = m->motion.position[2];

    if (s->motors == MOTORS_SPIN_UP) {
        if (phases_spun_up(s, m)) {
            s->motors = MOTORS_FLY;
            s->clock_s = REAL(0.0);
            s->entered_s = s->time_s;
        }
    } else {
        const real_t late = s->clock_s - s->course.way.duration_s;
        const real_t gained = s->standing[2] - z;
        const bool there = (real_abs(z - s->goal[2]) < plan->reach) &&
                           (real_abs(m->motion.velocity[2]) < plan->reach_speed);
        message_t why;

        if ((late >= REAL(0.0)) && there) {
            why = say_1(SAY_ALTITUDE, -z);
            hold_at(s, &why, s->time_s + plan->take_off_wait_s);
        } else if ((late >= REAL(0.0)) && (late > REAL(3.0)) && (gained < REAL(0.1))) {
            why = say_2(SAY_TAKE_OFF_FAILED, gained, s->clock_s);
            phases_fail(s, &why);
            why = s->reason;
            phases_enter(s, STATE_INIT, &why, LEVEL_ERROR);
            s->motors = MOTORS_RAMP_DOWN;
        } else if ((late >= REAL(0.0)) && (late > (REAL(8.0) + (REAL(0.5) * s->course.way.duration_s)))) {
            why = say_2(SAY_TAKE_OFF_SHORT, -z, -s->goal[2]);
            phases_fail(s, &why);
            phases_land(s, &why, LEVEL_WARNING);
        } else if (z < (s->standing[2] - REAL(0.2))) { /* on its legs it cannot slide away from anything */
            watch(plan, s);
        } else {
            /* climbing off its legs */
        }
    }
}

/* Hover and waypoint */

void phases_braking(const plan_t *plan, const mission_t *s, stop_t *out)
{
    point_t now;

    phases_onward(s, &now);
    stop_make(now.position, now.velocity, now.heading, BRAKE_M_S2, now.heading_rate, plan->limits.yaw_acceleration,
              out);
}

/* The way to waypoint index from wherever it is. */
static void leg(const plan_t *plan, int32_t index, const real_t from[3], real_t heading, trajectory_t *out)
{
    const waypoint_t *w = &plan->waypoint[index];
    const real_t above_start[3] = {plan->start[0], plan->start[1], -plan->take_off_height};
    const real_t *final_heading = w->has_heading ? &w->heading : NULL;
    limits_t limits = plan->limits;

    limits.speed = w->speed;
    if (!plan->spline) {
        trajectory_straight(from, w->position, heading, &limits, final_heading, plan->nose_offset, out);
    } else {
        /* Directions through the neighbours, so that the curve has no kink at a waypoint. */
        const real_t *before = (index > 0) ? plan->waypoint[index - 1].position : above_start;
        const real_t *further = (index > 1) ? plan->waypoint[index - 2].position : above_start;
        const real_t *after = ((index + 1) < plan->count) ? plan->waypoint[index + 1].position : w->position;
        real_t leaving[3];
        real_t arriving[3];

        for (int32_t i = 0; i < 3; i++) {
            leaving[i] = w->position[i] - ((index > 0) ? further[i] : before[i]);
            arriving[i] = after[i] - before[i];
        }
        trajectory_begin_curved(from, w->position, leaving, arriving, heading, &limits, final_heading,
                                plan->nose_offset, out);
    }
}

static void errand_way(const plan_t *plan, const mission_t *s, const errand_t *errand, const point_t *at,
                       trajectory_t *out)
{
    real_t goal[3];

    if (errand->kind == ERRAND_WAYPOINT) {
        leg(plan, s->index, at->position, at->heading, out);
    } else if (errand->kind == ERRAND_USER) {
        phases_copy(errand->has_goal ? errand->goal : at->position, goal);
        trajectory_straight(at->position, goal, at->heading, &plan->limits,
                            errand->has_heading ? &errand->heading : NULL, REAL(0.0), out);
    } else {
        phases_copy(s->standing, goal);
        goal[2] = real_min(at->position[2], -LOWEST_M);
        trajectory_straight(at->position, goal, at->heading, &plan->limits, NULL, plan->nose_offset, out);
    }
}

void phases_set_out(const plan_t *plan, mission_t *s, const message_t *why, const errand_t *errand)
{
    point_t at;
    stop_t brake;
    bool moving;

    phases_point(s, &at);
    moving = (real_length(at.velocity) > REAL(0.01)) || (real_abs(at.heading_rate) > REAL(0.01));
    if (moving) {
        phases_braking(plan, s, &brake);
        stop_at(&brake, REAL_INFINITY, &at);
    }
    errand_way(plan, s, errand, &at, &s->course.way);
    if (moving) {
        trajectory_after(&s->course.way, &brake);
    }
    phases_enter(s, STATE_WAYPOINT, why, LEVEL_INFO);
    s->course.kind = COURSE_TRAJECTORY;
    s->has_detour = false;
    s->avoided_s = REAL(0.0);
    s->resumed = false;
    s->manual = errand->kind != ERRAND_WAYPOINT;
    s->homing = errand->kind == ERRAND_HOME;
    s->has_asked_heading = (errand->kind == ERRAND_USER) && errand->has_heading;
    s->asked_heading = errand->heading;
    phases_copy(s->course.way.goal, s->goal);
}

void phases_go_home(const plan_t *plan, mission_t *s, const message_t *why)
{
    const errand_t home = {ERRAND_HOME, false, {REAL(0.0), REAL(0.0), REAL(0.0)}, false, REAL(0.0)};

    phases_set_out(plan, s, why, &home);
}

/* After the last wait: what the mission says. */
static void complete(const plan_t *plan, mission_t *s)
{
    message_t why;

    if (plan->at_end == AT_END_HOVER) {
        why = say(SAY_COMPLETE_HOLDS);
        mission_log(s, &why, LEVEL_INFO);
        s->manual = true;
        succeed(s, SAY_COMPLETE);
    } else if (plan->at_end == AT_END_RETURN) {
        why = say(SAY_COMPLETE_RETURNS);
        phases_go_home(plan, s, &why);
    } else {
        why = say(SAY_COMPLETE);
        phases_land(s, &why, LEVEL_INFO);
    }
}

static void hover(const plan_t *plan, mission_t *s)
{
    if (s->outcome == OUTCOME_FAILED) {
        if (s->time_s >= s->ready_s) {
            phases_land(s, &s->reason, LEVEL_WARNING);
        }
    } else {
        watch(plan, s);
        if ((s->state == STATE_HOVER) && !s->manual && !(s->time_s < s->ready_s)) {
            if (s->index >= plan->count) {
                complete(plan, s);
            } else {
                const message_t why = say_1(SAY_TO_WAYPOINT, (real_t)(s->index + 1));
                const errand_t next = {ERRAND_WAYPOINT, false, {REAL(0.0), REAL(0.0), REAL(0.0)}, false, REAL(0.0)};

                phases_set_out(plan, s, &why, &next);
            }
        }
    }
}

/* Come to rest in a hover, from which it lands. */
static void give_up(mission_t *s, const message_t *why)
{
    point_t now;
    point_t at;
    stop_t brake;

    phases_point(s, &now);
    stop_make(now.position, now.velocity, now.heading, BRAKE_M_S2, REAL(0.0), REAL_INFINITY, &brake);
    stop_at(&brake, REAL_INFINITY, &at);
    phases_fail(s, why);
    phases_rest(s, why, at.position, now.heading, LEVEL_WARNING);
    s->course.kind = COURSE_STOP;
    s->course.brake = brake;
    s->ready_s = (s->time_s + brake.duration_s) + SETTLE_BEFORE_LANDING_S;
}

static void fly_leg(const plan_t *plan, mission_t *s, const belief_t *m)
{
    const real_t duration = s->course.way.duration_s;
    const real_t spent = s->time_s - s->entered_s;
    const real_t off = away(m->motion.position, s->goal);
    const bool there = (s->clock_s >= duration) && (off < plan->reach) &&
                       (real_length(m->motion.velocity) < plan->reach_speed);
    const real_t number = (real_t)(s->index + 1);
    message_t why;

    if (there && s->homing) {
        why = say_1(SAY_REACHED_HOME, REAL(100.0) * off);
        phases_land(s, &why, LEVEL_INFO);
    } else if (there && s->manual) {
        why = say_1(SAY_REACHED_USERS, REAL(100.0) * off);
        hold_at(s, &why, s->time_s);
    } else if (there) {
        why = say_2(SAY_REACHED, number, REAL(100.0) * off);
        hold_at(s, &why, s->time_s + plan->waypoint[s->index].wait_s);
        s->index = s->index + 1;
        s->reached = s->reached + 1;
    } else if (spent > ((REAL(2.0) * duration) + REAL(20.0))) {
        if (s->homing) {
            why = say_2(SAY_MISSED_HOME, spent, off);
        } else if (s->manual) {
            why = say_2(SAY_MISSED_USERS, spent, off);
        } else {
            why = say_3(SAY_MISSED, number, spent, off);
        }
        give_up(s, &why);
    } else {
        watch(plan, s);
    }
}

/* Obstacles */

static bool looks_at(const sight_t *sight, const real_t goal[3])
{
    bool same = true;

    for (int32_t i = 0; i < 2; i++) {
        same = same && (sight->goal[i] <= goal[i]) && (sight->goal[i] >= goal[i]);
    }
    return same;
}

static void watch(const plan_t *plan, mission_t *s)
{
    if (plan->avoid && (s->memory.used > 0)) {
        /* Only on its level way does it head for somewhere; elsewhere an obstacle has to come near. */
        const bool underway = (s->state == STATE_WAYPOINT) && phases_at_gate(s);
        const sight_t *sight = &s->sight;
        point_t at;
        real_t from_it[2];
        real_t far;
        bool there;

        phases_point(s, &at);
        if (underway) { /* it looks along the way since the step after it was sent elsewhere */
            far = real_sqrt(sight->way);
            there = looks_at(sight, s->goal) && avoid_blocked(sight, plan->clearance);
        } else {
            far = avoid_nearest(sight, at.position, from_it);
            there = far < plan->clearance;
        }
        if (there) {
            const message_t why = say_1(underway ? SAY_OBSTACLE_AHEAD : SAY_OBSTACLE_NEAR, far);
            const int32_t from = s->state;

            avoid_begin(&s->detour, at.position, at.velocity, at.acceleration, s->goal, sight,
                        s->has_detour ? &s->detour : NULL);
            phases_enter(s, STATE_OBSTACLE, &why, LEVEL_INFO);
            s->back = from;
            s->has_detour = true;
            s->heading = at.heading;
        }
    }
}

static void go_round(const plan_t *plan, mission_t *s, const belief_t *m, real_t dt)
{
    message_t why;

    avoid_go_round(&s->detour, &s->sight, &plan->ring, m->motion.position, m->motion.attitude[2], m->ranges, s->goal,
                   plan->clearance, plan->avoid_speed, dt);
    s->avoided_s = s->avoided_s + dt;
    if (s->avoided_s > plan->give_up_s) {
        why = say_3(SAY_BLOCKED, s->detour.obstacle[0], s->detour.obstacle[1], plan->give_up_s);
        give_up(s, &why);
    } else if (avoid_done(&s->detour)) {
        why = say(SAY_AVOIDED);
        phases_enter(s, s->back, &why, LEVEL_INFO);
        trajectory_straight(s->detour.position, s->goal, s->heading, &plan->limits, &s->heading, REAL(0.0),
                            &s->course.way);
        s->course.kind = COURSE_TRAJECTORY;
        s->resumed = true;
    } else {
        /* on the way round */
    }
}

void phases_step(const plan_t *plan, mission_t *s, const belief_t *m, real_t dt)
{
    switch (s->state) {
    case STATE_INIT:
        stand(s);
        break;
    case STATE_TAKE_OFF:
        take_off(plan, s, m);
        break;
    case STATE_HOVER:
        hover(plan, s);
        break;
    case STATE_WAYPOINT:
        fly_leg(plan, s, m);
        break;
    case STATE_OBSTACLE:
        go_round(plan, s, m, dt);
        break;
    case STATE_LANDING:
        sink(plan, s, m, dt);
        break;
    default: /* flown by a pilot or a program */
        break;
    }
}
