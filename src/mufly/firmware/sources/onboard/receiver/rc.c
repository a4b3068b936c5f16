#include "onboard/receiver/rc.h"

#define DEADBAND REAL(0.03)
#define SWITCH_ON REAL(0.4)  /* deflection */
#define SWITCH_FRAMES 3      /* frames until a switch counts as moved */
#define MICROSECONDS REAL(0.625) /* of a step of a channel */
#define HALF_RANGE REAL(500.0)   /* us */

static const user_request_t no_request;

void rc_reset_settings(rc_settings_t *s)
{
    s->roll = REAL(1.0);
    s->pitch = REAL(2.0);
    s->throttle = REAL(3.0);
    s->yaw = REAL(4.0);
    s->switches[RC_SWITCH_ARM] = REAL(5.0);
    s->switches[RC_SWITCH_MANUAL] = REAL(6.0);
    s->switches[RC_SWITCH_KILL] = REAL(7.0);
    s->loss_s = REAL(0.5);
}

void rc_start(rc_t *rc, int32_t kind)
{
    static const rc_t none;
    const rc_settings_t kept = rc->settings;

    *rc = none;
    rc->settings = kept;
    rc->decoder.kind = kind;
}

real_t apply_deadband(real_t value)
{
    const real_t size = real_max(REAL(0.0), real_abs(value) - DEADBAND) / (REAL(1.0) - DEADBAND);

    return (value < REAL(0.0)) ? -size : size;
}

/* Deflection of a channel, from -1 to 1; 0 for one that is not mapped. */
static real_t deflection(const rc_t *rc, real_t number)
{
    const bool mapped = (number >= REAL(0.5)) && (number < ((real_t)RC_CHANNELS + REAL(0.5)));
    real_t value = REAL(0.0);

    if (mapped) {
        const int32_t raw = rc->decoder.channel[(int32_t)(number + REAL(0.5)) - 1];

        value = real_clip(((real_t)(raw - RC_MIDDLE) * MICROSECONDS) / HALF_RANGE, REAL(-1.0), REAL(1.0));
    }
    return value;
}

static int32_t send_pilot_request(const rc_vehicle_t *v, int32_t kind, bool force)
{
    user_request_t ask = no_request;

    ask.kind = kind;
    ask.force = force;
    return supervisor_request(v->supervisor, v->setup, v->software, v->belief, &ask);
}

/* A switch has moved. Disarming is refused in the air, where only the kill switch stops the motors. */
static void handle_switch(rc_t *rc, const rc_vehicle_t *v, int32_t which)
{
    const bool on = rc->is_on[which];

    if (which == (int32_t)RC_SWITCH_ARM) {
        if (!on) {
            (void)send_pilot_request(v, USER_DISARM, false);
        } else if (rc->was_off && !rc->is_on[RC_SWITCH_KILL]) {
            rc->tells_faults = send_pilot_request(v, USER_ARM, false) != ANSWER_ACCEPTED;
        } else {
            /* on since the start, or killed */
        }
    } else if ((which == (int32_t)RC_SWITCH_MANUAL) && !on) {
        rc->steers = false;
        (void)send_pilot_request(v, USER_RELEASE_STICKS, false);
    } else {
        /* the kill switch acts in every period, the sticks in every frame */
    }
}

static void read_switches(rc_t *rc, const rc_vehicle_t *v)
{
    for (int32_t i = 0; i < RC_SWITCHES; i++) {
        const bool on = deflection(rc, rc->settings.switches[i]) > SWITCH_ON;

        rc->agreeing[i] = (on != rc->is_on[i]) ? (rc->agreeing[i] + 1) : 0;
        if (rc->agreeing[i] >= SWITCH_FRAMES) {
            rc->agreeing[i] = 0;
            rc->is_on[i] = on;
            handle_switch(rc, v, i);
        }
        if ((i == (int32_t)RC_SWITCH_ARM) && !on && !rc->is_on[i]) {
            rc->was_off = true;
        }
    }
}

static void send_sticks(const rc_t *rc, const rc_vehicle_t *v)
{
    const supervisor_settings_t *most = &v->supervisor->settings;
    user_request_t ask = no_request;

    ask.kind = USER_STICKS;
    ask.roll = apply_deadband(deflection(rc, rc->settings.roll)) * most->stick_tilt;
    ask.pitch = apply_deadband(deflection(rc, rc->settings.pitch)) * most->stick_tilt;
    ask.climb_rate = apply_deadband(deflection(rc, rc->settings.throttle)) * most->stick_climb;
    ask.yaw_rate = apply_deadband(deflection(rc, rc->settings.yaw)) * most->stick_yaw_rate;
    (void)supervisor_request(v->supervisor, v->setup, v->software, v->belief, &ask);
}

/* Take a frame with channels. */
static void handle_frame(rc_t *rc, const rc_vehicle_t *v)
{
    if (!rc->decoder.failsafe && !rc->decoder.frame_lost) {
        rc->was_heard = true;
        rc->heard_s = v->supervisor->now_s;
        rc->is_alive = true;
        rc->owes_landing = false;
        read_switches(rc, v);
        rc->steers = (rc->settings.switches[RC_SWITCH_MANUAL] < REAL(0.5)) || rc->is_on[RC_SWITCH_MANUAL];
        if (rc->steers && !rc->is_on[RC_SWITCH_KILL]) {
            send_sticks(rc, v);
        }
    }
}

/* The receiver is lost: release the sticks, so that the vehicle hovers, and land later. */
static void handle_loss(rc_t *rc, const rc_vehicle_t *v)
{
    const supervisor_t *s = v->supervisor;
    const real_t silent = s->now_s - rc->heard_s;
    const bool commanded = s->has_commander && ((s->now_s - s->commander_heard_s) < s->settings.link_loss_s);

    if (rc->is_alive) {
        rc->is_alive = false;
        rc->owes_landing = rc->steers;
        if (rc->steers) {
            rc->steers = false;
            (void)send_pilot_request(v, USER_RELEASE_STICKS, false);
        }
    }
    if (!supervisor_in_air(v->software, v->belief) || commanded) {
        rc->owes_landing = false; /* on the floor, or a station decides */
    }
    if (rc->owes_landing && (silent >= (rc->settings.loss_s + s->settings.link_land_s))) {
        if (send_pilot_request(v, USER_LAND, false) == ANSWER_ACCEPTED) {
            rc->owes_landing = false;
        }
    }
}

void rc_step(rc_t *rc, const rc_vehicle_t *v)
{
    for (int32_t i = 0; i < rc->input_count; i++) {
        if (rc_decode(&rc->decoder, rc->input[i])) {
            handle_frame(rc, v);
        }
    }
    if (rc->was_heard && (rc->decoder.failsafe || ((v->supervisor->now_s - rc->heard_s) > rc->settings.loss_s))) {
        handle_loss(rc, v);
    }
    if (rc->is_alive && rc->is_on[RC_SWITCH_KILL] && (v->supervisor->armed || (v->software->motors != MOTORS_OFF))) {
        (void)send_pilot_request(v, USER_DISARM, true);
    }
}
