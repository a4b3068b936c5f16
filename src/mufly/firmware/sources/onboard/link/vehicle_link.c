#include "onboard/link/vehicle_link.h"

#include "onboard/link/link_output.h"
#include "onboard/link/protocols/command_protocol.h"
#include "onboard/link/protocols/mission_protocol.h"
#include "onboard/link/protocols/parameter_protocol.h"
#include "onboard/link/protocols/telemetry_streams.h"
#include "onboard/link/steering_input.h"
#include "onboard/link/text.h"

#define COMMANDER_TIMEOUT_S REAL(5.0)

void link_start(link_t *k)
{
    static const link_t none;

    *k = none;
    for (int32_t i = 0; i < LINK_STREAMS; i++) {
        k->due_s[i] = (real_t)i / (real_t)mufly_rate_Hz; /* all fall into different periods */
    }
}

/* Whether a station may command; the first that asks becomes the commander. */
static bool claim_command(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m)
{
    supervisor_t *s = v->supervisor;
    const bool same = (m->system == k->commander_system) && (m->component == k->commander_component);
    const bool may = !s->has_commander || same || ((s->now_s - s->commander_heard_s) >= COMMANDER_TIMEOUT_S);

    if (may) {
        k->commander_system = m->system;
        k->commander_component = m->component;
        supervisor_hear_commander(s);
    }
    return may;
}

static bool is_addressed(const mavlink_message_t *m, int32_t at)
{
    return ((m->payload[at] == 0U) || (m->payload[at] == VEHICLE_SYSTEM)) &&
           ((m->payload[at + 1] == 0U) || (m->payload[at + 1] == VEHICLE_COMPONENT));
}

static void handle_message(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m)
{
    supervisor_t *s = v->supervisor;

    k->is_heard = true;
    if (s->has_commander && (m->system == k->commander_system) && (m->component == k->commander_component)) {
        supervisor_hear_commander(s);
    }
    switch (m->message) {
    case MSG_COMMAND_LONG:
    case MSG_COMMAND_INT:
        if (is_addressed(m, 30)) {
            const uint32_t command = mavlink_get(m, 28, 2);
            const bool asks_only = (command == 512U) || (command == 520U);

            handle_command(k, v, m, asks_only || claim_command(k, v, m));
        }
        break;
    case MSG_PARAM_REQUEST_READ:
        if (is_addressed(m, 2)) {
            handle_parameter(k, v, m, false);
        }
        break;
    case MSG_PARAM_REQUEST_LIST:
        if (is_addressed(m, 0)) {
            handle_parameter(k, v, m, false);
        }
        break;
    case MSG_PARAM_SET:
        if (is_addressed(m, 4)) {
            handle_parameter(k, v, m, claim_command(k, v, m));
        }
        break;
    case MSG_MISSION_REQUEST_LIST:
        if (is_addressed(m, 0)) {
            handle_mission(k, v, m, false);
        }
        break;
    case MSG_MISSION_COUNT:
        if (is_addressed(m, 2)) {
            handle_mission(k, v, m, claim_command(k, v, m));
        }
        break;
    case MSG_MISSION_REQUEST_INT:
        if (is_addressed(m, 2)) {
            handle_mission(k, v, m, false);
        }
        break;
    case MSG_MISSION_ITEM_INT:
        if (is_addressed(m, 32)) {
            handle_mission(k, v, m, claim_command(k, v, m));
        }
        break;
    case MSG_MANUAL_CONTROL:
        if (((m->payload[10] == 0U) || (m->payload[10] == VEHICLE_SYSTEM)) && claim_command(k, v, m)) {
            handle_steering(k, v, m);
        }
        break;
    case MSG_SET_POSITION_TARGET_LOCAL_NED:
        if (is_addressed(m, 50) && claim_command(k, v, m)) {
            handle_steering(k, v, m);
        }
        break;
    default:
        /* a sign of life */
        break;
    }
}

/* Send the text of one of these bits, and clear it; return whether there was one. */
static bool send_one_fault(link_t *k, uint32_t *faults, const char *const words[], uint32_t count)
{
    bool sent = false;

    for (uint32_t i = 0U; (i < count) && !sent; i++) {
        sent = (*faults & (1UL << i)) != 0U;
        if (sent) {
            send_string(k, words[i], 4U);
            *faults &= ~((uint32_t)1U << i);
        }
    }
    return sent;
}

static bool send_arming_fault(link_t *k, const link_vehicle_t *v)
{
    static const char *const words[10] = {
        "position, velocity, attitude, rates not measured", "measurements are old; check the sensors",
        "battery voltage not measured; check its monitor", "battery low; charge it",
        "estimate not valid; leave the vehicle at rest", "vehicle tilted; set it on level ground",
        "vehicle moves; set it down and wait", "last flight interrupted; inspect it, arm again",
        "the climb stick is up; lower it first", "height is not that of standing; check the sonar",
    };

    if (k->tells_faults) {
        k->tells_faults = false;
        k->untold_faults = v->supervisor->arming_faults;
    }
    return send_one_fault(k, &k->untold_faults, words, 10U);
}

/* Store what was set in flight. */
static void step_settings(const link_vehicle_t *v)
{
    if (settings_are_due(v->settings) && may_load(v)) {
        const tunables_t t = link_tunables(v);

        (void)settings_store(v->settings, &t);
    }
}

/* Report a fault of settings or log, once a station is there. */
static bool send_storage_fault(link_t *k, const link_vehicle_t *v)
{
    static const char *const words[4] = {
        "not stored: the flash is worn or full", "stored settings of another version, not used",
        "stored setting out of bounds, not used", "stored mission replaced another one; not used",
    };
    static const char *const log_words[3] = {
        "log full: this flight is recorded no further", "log: the device fails; nothing is recorded",
        "log: blocks of the device are worn",
    };
    bool sent = false;

    if (k->is_heard) {
        sent = send_one_fault(k, &v->settings->faults, words, 4U);
        if (!sent) {
            sent = send_one_fault(k, v->log_faults, log_words, 3U);
        }
    }
    return sent;
}

/* One entry of the mission's log, where there is room. */
static bool send_log_entry(link_t *k, const link_vehicle_t *v)
{
    static const uint8_t severity[3] = {6U, 4U, 3U};
    const mission_t *x = &v->software->mission;
    char text[TEXT_LENGTH];
    bool sends;

    if ((x->logged_event_count - k->told) > MISSION_LOG) {
        k->told = x->logged_event_count - MISSION_LOG;
    }
    sends = (k->told < x->logged_event_count) && (k->output_count < (LINK_OUTPUT / 2));
    if (sends) {
        const log_entry_t *e = &x->log[k->told % MISSION_LOG];
        const int32_t length = write_message_text(&e->message, text);

        send_text(k, text, length, severity[((e->level >= 0) && (e->level < 3)) ? e->level : 0]);
        k->told++;
    }
    return sends;
}

void link_step(link_t *k, const link_vehicle_t *v)
{
    mavlink_message_t m;
    bool sent;

    for (int32_t i = 0; i < k->input_count; i++) {
        if (mavlink_parse(&k->parser, k->input[i], &m)) {
            handle_message(k, v, &m);
        }
    }
    step_upload(k, v);
    step_settings(v);
    /* At most one message a period, besides answers, to bound the period's length. */
    sent = send_arming_fault(k, v);
    if (!sent) {
        sent = send_storage_fault(k, v);
    }
    if (!sent) {
        sent = send_listed_parameter(k, v);
    }
    if (!sent) {
        sent = send_log_entry(k, v);
    }
    if (!sent) {
        send_stream(k, v);
    }
}
