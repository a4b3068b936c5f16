#include "software.h"

#include <stddef.h>

#include "failsafe.h"

#define LOST_S REAL(0.5)
#define STEP_MOTOR REAL(0.1)
#define STEP_SERVO REAL(0.2)
#define LEARN_S REAL(1.0)
#define VOLTS_S REAL(0.5) /* in which the battery's reading counts while the rotors speed up */
#define TOUCHES_M REAL(0.03) /* height from which it counts as down */
#define DOWN_SHARE REAL(0.8) /* of the motors' running down that is left out where it is known to be down */

static void pair(real_t a, real_t b, real_t out[2])
{
    out[0] = a;
    out[1] = b;
}

static void still(reference_t *r)
{
    for (int32_t i = 0; i < 3; i++) {
        r->path.velocity[i] = REAL(0.0);
    }
    r->heading_rate = REAL(0.0);
}

static void idle(actuators_t *out)
{
    pair(REAL(0.0), REAL(0.0), out->motor_input);
    pair(REAL(0.0), REAL(0.0), out->servo_input);
}

static void no_command(command_t *c)
{
    c->start = false;
    c->has_first = false;
    c->first = 0;
    c->has_take_off = false;
    c->take_off = REAL(0.0);
    c->pause = false;
    c->has_waypoint = false;
    c->has_heading = false;
    c->heading = REAL(0.0);
    c->home = false;
    c->land = false;
    c->stop = 0;
    c->rc = false;
    c->roll = REAL(0.0);
    c->pitch = REAL(0.0);
    c->yaw_rate = REAL(0.0);
    c->climb = REAL(0.0);
    c->has_set_point = false;
    for (int32_t i = 0; i < 3; i++) {
        c->waypoint[i] = REAL(0.0);
        c->set_point.position[i] = REAL_NONE;
        c->set_point.velocity[i] = REAL_NONE;
    }
    c->set_point.heading = REAL_NONE;
    c->set_point.yaw_rate = REAL_NONE;
}

static bool anything(const command_t *c)
{
    const bool sticks = c->rc || (real_abs(c->roll) > REAL(0.0)) || (real_abs(c->pitch) > REAL(0.0)) ||
                        (real_abs(c->yaw_rate) > REAL(0.0)) || (real_abs(c->climb) > REAL(0.0));

    return c->start || c->has_first || c->has_take_off || c->pause || c->has_waypoint || c->has_heading || c->home ||
           c->land || (c->stop != 0) || sticks || c->has_set_point;
}

void software_start(const setup_t *setup, software_t *s)
{
    (void)setup;
    s->reference.motors = MOTORS_OFF;
    s->reference.rc = false;
    s->reference.roll = REAL(0.0);
    s->reference.pitch = REAL(0.0);
    s->reference.heading = REAL(0.0);
    for (int32_t i = 0; i < 3; i++) {
        s->reference.path.position[i] = REAL(0.0);
        s->reference.path.acceleration[i] = REAL(0.0);
    }
    still(&s->reference);
    no_command(&s->command);
    s->tick = 0;
    s->motors = MOTORS_OFF;
    s->since_s = REAL(0.0);
    pair(REAL(0.0), REAL(0.0), s->motor_input);
    pair(REAL(0.0), REAL(0.0), s->tilt);
    pair(REAL(0.0), REAL(0.0), s->released);
    s->lifted = false;
    s->late_s = REAL(0.0);
    watch_start(&s->watch);
    oscillations_start(&s->oscillations);
    s->oscillation.there = false;
    doubts_start(&s->doubts, REAL(0.0));
    s->holds = false;
    s->waits = false;
    smooth_start(&s->smooth);
    idle(&s->given);
    pair(REAL(0.0), REAL(0.0), s->held_up);
    s->trusts_until_s = REAL(0.0);
    s->volts = REAL(0.0);
    position_start(&s->controllers.position);
}

bool software_flying(const software_t *s)
{
    return s->lifted && ((s->motors == MOTORS_FLY) || (s->motors == MOTORS_BLIND));
}

static void stop_at_once(software_t *s, int32_t why, const belief_t *m)
{
    const message_t what = say_1(SAY_GIVEN, (real_t)why);

    s->mission.time_s = m->time_s;
    mission_stop_at_once(&s->mission, &what);
    still(&s->reference);
    s->reference.motors = MOTORS_OFF;
    s->reference.rc = false;
    no_command(&s->command);
    s->motors = MOTORS_OFF;
    s->lifted = false;
    s->late_s = REAL(0.0);
    idle(&s->given);
    pair(REAL(0.0), REAL(0.0), s->motor_input);
    pair(REAL(0.0), REAL(0.0), s->tilt);
}

/* Whether it flies without knowing where it is or how it moves; it does not come back from that. */
static bool lost(const software_t *s)
{
    const bool running = (s->motors == MOTORS_SPIN_UP) || (s->motors == MOTORS_FLY);
    const real_t running_s = running ? (s->watch.good.time_s - s->since_s) : REAL(0.0);

    return (s->motors == MOTORS_BLIND) || (real_min(s->watch.lost_s, running_s) > LOST_S);
}

static void wait_here(const setup_t *setup, software_t *s)
{
    mission_t *x = &s->mission;
    const message_t holds = say(SAY_HOLDS);

    s->holds = true;
    s->waits = x->begun && !x->manual && (x->outcome == OUTCOME_OPEN);
    mission_log(x, &s->doubts.now.why, LEVEL_WARNING);
    mission_pause(setup->plan, x, &holds);
}

/* Hold or land where the estimate is not good enough for more; true if it has to sink at once. */
static bool doubted(const setup_t *setup, software_t *s, const belief_t *m)
{
    const message_t known = say(SAY_KNOWN);
    mission_t *x = &s->mission;
    bool sinks = false;

    if (!(s->lifted && (s->motors == MOTORS_FLY))) {
        doubts_start(&s->doubts, real_max(m->position_variance[0], m->position_variance[1]));
        s->holds = false;
        s->waits = false;
    } else {
        const bool anew = doubts_step(&s->doubts, m);
        const doubt_t *now = &s->doubts.now;
        const bool can_wait =
            (x->state == STATE_WAYPOINT) || (x->state == STATE_OBSTACLE) || (x->state == STATE_HOVER);

        if ((now->demand == DEMAND_SINK) ||
            ((now->demand == DEMAND_LAND) && turns_unfelt(m) &&
             ((x->standing[2] - m->motion.position[2]) < TOUCHES_M))) {
            sinks = true;
        } else if ((now->demand == DEMAND_HOLD) && !s->holds && can_wait) {
            wait_here(setup, s);
        } else if (anew && (now->demand == DEMAND_LAND)) {
            mission_come_down(x, &now->why);
        } else if (anew && (x->state == STATE_RC)) {
            mission_log(x, (now->demand == DEMAND_NONE) ? &known : &now->why, LEVEL_WARNING);
        } else if (s->holds && (now->demand == DEMAND_NONE)) {
            const bool goes_on = s->waits && (x->state == STATE_HOVER) && x->manual;

            s->holds = false;
            s->waits = false;
            if (goes_on) {
                mission_log(x, &known, LEVEL_INFO);
                mission_go_on(setup->plan, x, NULL);
            }
        } else {
            /* it goes on as it does */
        }
    }
    return sinks;
}

/* Whether an estimate that is lost as a whole still tells the height above where it stood. */
static bool height_known(const software_t *s, const belief_t *told, real_t *height)
{
    *height = s->mission.standing[2] - told->motion.position[2];
    return told->judged && (told->position_variance[2] < (HEIGHT_M * HEIGHT_M)) &&
           ((real_abs(*height) + real_abs(told->motion.velocity[2])) < REAL(1e3));
}

static void sink_blindly(const setup_t *setup, software_t *s, const belief_t *told, const message_t *why,
                         actuators_t *out)
{
    const belief_t *good = &s->watch.good;
    const real_t gravity = setup->gains->position.gravity;
    const real_t now = good->time_s;
    real_t height;
    real_t left_s;
    bool knows = height_known(s, told, &height);
    bool down;

    if (s->motors != MOTORS_BLIND) {
        s->motors = MOTORS_BLIND;
        left_s = s->lifted ? failsafe_way_down_s(s->mission.standing[2] - good->motion.position[2], gravity)
                           : REAL(0.0);
        s->since_s = now + left_s;
        s->trusts_until_s = now + (REAL(2.0) * left_s);
        mission_blind(&s->mission, now, why);
        s->reference.motors = MOTORS_BLIND;
        still(&s->reference);
        pair(REAL(0.0), REAL(0.0), s->tilt);
        no_command(&s->command);
    }
    down = knows && (height <= TOUCHES_M);
    knows = s->lifted && (now < s->trusts_until_s) && knows && (height > TOUCHES_M);
    if (knows) { /* should that end, it goes on from here */
        s->since_s = now + failsafe_way_down_s(height, gravity);
    } else if (down) { /* on its legs nothing holds a rotor that still lifts */
        s->since_s = real_min(s->since_s, now - (DOWN_SHARE * RAMP_DOWN_S));
    } else {
        /* it comes down by the time that takes */
    }
    left_s = (s->since_s + RAMP_DOWN_S) - now;
    if (left_s <= REAL(0.0)) {
        mission_down_blind(&s->mission, now);
        s->reference.motors = MOTORS_OFF;
        s->motors = MOTORS_OFF;
        pair(REAL(0.0), REAL(0.0), s->motor_input);
    } else {
        failsafe_sink(s->held_up, knows ? failsafe_sink_share(height, told->motion.velocity[2]) : SINK_SHARE, left_s,
                      good->motion.voltage, s->motor_input);
    }
    pair(s->motor_input[0], s->motor_input[1], out->motor_input);
    pair(REAL(0.0), REAL(0.0), out->servo_input);
}

/* Engage or release the controllers without a bump. */
static void change_over(const setup_t *setup, software_t *s, int32_t motors, const belief_t *m)
{
    if (motors == MOTORS_FLY) {
        controllers_engage(setup->gains, &s->controllers, &m->motion, s->motor_input);
        s->lifted = false;
        oscillations_start(&s->oscillations);
        s->oscillation.there = false;
        pair(setup->hover_V[0], setup->hover_V[1], s->held_up);
    } else if (motors == MOTORS_SPIN_UP) {
        pair(REAL(0.0), REAL(0.0), s->held_up);
        s->lifted = false;
    } else {
        /* off, or running down */
    }
    s->motors = motors;
    s->since_s = m->time_s;
    pair(s->motor_input[0], s->motor_input[1], s->released);
}

static void on_the_floor(const setup_t *setup, software_t *s, const belief_t *m, actuators_t *out)
{
    const real_t elapsed = m->time_s - s->since_s;
    const bool filters = (s->motors == MOTORS_SPIN_UP) && m->judged;

    if (filters) {
        s->volts += (setup->period_s / VOLTS_S) * (m->motion.voltage - s->volts);
    } else {
        s->volts = m->motion.voltage;
    }
    if (s->motors == MOTORS_SPIN_UP) {
        failsafe_spin_up(setup->hover_V, elapsed, s->volts, s->motor_input);
    } else if (s->motors == MOTORS_RAMP_DOWN) {
        /* It may slide where it goes by an estimate, and a rotor that still lifts tips it over. */
        failsafe_ramp_down(s->released, m->judged ? (elapsed + (DOWN_SHARE * RAMP_DOWN_S)) : elapsed, s->motor_input);
    } else {
        pair(REAL(0.0), REAL(0.0), s->motor_input);
    }
    pair(REAL(0.0), REAL(0.0), s->tilt);
    pair(s->motor_input[0], s->motor_input[1], out->motor_input);
    pair(REAL(0.0), REAL(0.0), out->servo_input);
}

static void look_for_oscillations(software_t *s, const actuators_t *out, real_t time_s)
{
    static const int32_t words[OSCILLATION_INPUTS] = {SAY_OSCILLATES_UPPER, SAY_OSCILLATES_LOWER,
                                                      SAY_OSCILLATES_SERVO_1, SAY_OSCILLATES_SERVO_2};
    const real_t inputs[OSCILLATION_INPUTS] = {out->motor_input[0], out->motor_input[1], out->servo_input[0],
                                               out->servo_input[1]};
    const reference_t *r = &s->reference;
    const bool by_hand = s->mission.state == STATE_RC;
    const bool steered = by_hand || (s->mission.state == STATE_OFFBOARD);
    const bool before = s->oscillation.there;
    const real_t asked[OSCILLATION_ASKED] = {
        by_hand ? REAL(0.0) : r->path.velocity[0],
        by_hand ? REAL(0.0) : r->path.velocity[1],
        r->path.velocity[2],
        r->heading_rate,
        by_hand ? r->roll : REAL(0.0),
        by_hand ? r->pitch : REAL(0.0),
    };

    oscillations_step(&s->oscillations, time_s, inputs, steered ? asked : NULL, &s->oscillation);
    if (s->oscillation.there && !before) {
        const message_t why = say_2(words[s->oscillation.input], s->oscillation.size, s->oscillation.frequency_Hz);

        mission_come_down(&s->mission, &why);
    }
}

static void fly(const setup_t *setup, software_t *s, const belief_t *m, actuators_t *out)
{
    const reference_t *r = &s->reference;
    const bool due = !(s->late_s > REAL(0.0));
    const real_t wanted[4] = {r->path.position[2] + (s->late_s * r->path.velocity[2]),
                              r->heading + (s->late_s * r->heading_rate), r->path.velocity[2], r->heading_rate};

    if (!s->lifted && (mission_lifted_off(&s->mission, m) || mission_tips(m))) {
        s->lifted = true;
        controllers_lift_off(setup->gains, &s->controllers, &m->motion);
    }
    if (!s->lifted) {
        pair(REAL(0.0), REAL(0.0), s->tilt);
    } else if (r->rc) {
        pair(r->roll, r->pitch, s->tilt);
    } else if (due) {
        controllers_tilt(setup->gains, &s->controllers, &m->motion, &r->path, s->tilt);
    } else {
        /* the tilt holds until the position cascade runs again */
    }
    controllers_step(setup->gains, &s->controllers, &m->motion, wanted, s->lifted, s->tilt, out);
    pair(out->motor_input[0], out->motor_input[1], s->motor_input);
    if (due) {
        const real_t blend = ((real_t)setup->every * setup->period_s) / LEARN_S;

        for (int32_t i = 0; i < 2; i++) {
            s->held_up[i] += blend * ((out->motor_input[i] * m->motion.voltage) - s->held_up[i]);
        }
        look_for_oscillations(s, out, m->time_s);
    }
}

/* What is wanted, no faster than an input may move where it comes from an estimate. */
static void steadied(software_t *s, const belief_t *m, actuators_t *out)
{
    if (m->judged) {
        for (int32_t i = 0; i < 2; i++) {
            const real_t motor = out->motor_input[i] - s->given.motor_input[i];
            const real_t servo = out->servo_input[i] - s->given.servo_input[i];

            out->motor_input[i] =
                s->given.motor_input[i] + real_min(real_max(motor, -STEP_MOTOR), STEP_MOTOR);
            out->servo_input[i] =
                s->given.servo_input[i] + real_min(real_max(servo, -STEP_SERVO), STEP_SERVO);
        }
    }
    s->given = *out;
}

/* What the beams see, in parts from one step of the mission to the next. */
static void watch_out(const setup_t *setup, software_t *s, const belief_t *m)
{
    const bool apart = setup->every > 1; /* tick has gone on already */
    const int32_t part = apart ? cycle(s->tick - 1, setup->every) : 1;

    if (part > 0) {
        mission_watch_out(setup->plan, &s->mission, m, part, apart ? (setup->every - 1) : 1);
    }
}

void software_step(const setup_t *setup, software_t *s, const belief_t *belief, const command_t *command,
                   actuators_t *out)
{
    const bool first = !s->watch.begun;
    belief_t m;
    message_t why;

    watch_step(&s->watch, belief, setup->period_s, &setup->plan->ring);
    belief_copy(&s->watch.good, setup->plan->ring.count, &m);
    if (m.judged) {
        smooth_step(&s->smooth, &m, s->motors == MOTORS_OFF);
    }
    if (first) {
        mission_begin(&s->mission, &m);
    }
    if (anything(command)) {
        s->command = *command;
    }
    s->late_s = (real_t)s->tick * setup->period_s;
    s->tick = ((s->tick + 1) < setup->every) ? (s->tick + 1) : 0;
    if (command->stop != 0) {
        stop_at_once(s, command->stop, &m);
        idle(out);
    } else if (lost(s)) {
        why = say_1(SAY_LOST, (real_t)s->watch.what);
        sink_blindly(setup, s, belief, &why, out);
        steadied(s, &m, out);
    } else if (!(s->late_s > REAL(0.0)) && m.judged && doubted(setup, s, &m)) {
        why = s->doubts.now.why;
        sink_blindly(setup, s, belief, &why, out);
        steadied(s, &m, out);
    } else {
        if (!(s->late_s > REAL(0.0))) {
            mission_step(setup->plan, &s->mission, &m, &s->command, &s->reference);
            no_command(&s->command);
        }
        watch_out(setup, s, &m);
        if (s->reference.motors != s->motors) {
            change_over(setup, s, s->reference.motors, &m);
        }
        if (s->reference.motors == MOTORS_FLY) {
            fly(setup, s, &m, out);
            steadied(s, &m, out);
        } else {
            on_the_floor(setup, s, &m, out);
            s->given = *out;
        }
    }
}
