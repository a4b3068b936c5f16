#include "onboard/link/protocols/command_protocol.h"

#include <stddef.h>

#include "mission/user_requests.h"
#include "onboard/link/link_output.h"
#include "onboard/link/protocols/mission_protocol.h"
#include "onboard/link/protocols/parameter_protocol.h"
#include "onboard/link/protocols/telemetry_streams.h"

#define REPEAT_WINDOW_S REAL(0.8)
#define CONFIRMATION_WINDOW_S REAL(10.0)
#define FORCE_DISARM_MAGIC REAL(21196.0)
#define RESULT_UNSUPPORTED 3
#define RESULT_FAILED 4

static const user_request_t no_request;

int32_t send_request(const link_vehicle_t *v, const user_request_t *ask)
{
    return supervisor_request(v->supervisor, v->setup, v->software, v->belief, ask);
}

static int32_t send_request_kind(const link_vehicle_t *v, int32_t kind)
{
    user_request_t ask = no_request;

    ask.kind = kind;
    return send_request(v, &ask);
}

static int32_t set_mode(link_t *k, const link_vehicle_t *v, const real_t p[7])
{
    const int32_t main_mode = ((p[1] >= REAL(0.0)) && (p[1] < REAL(16.0))) ? (int32_t)p[1] : -1;
    const int32_t sub_mode = ((p[2] >= REAL(0.0)) && (p[2] < REAL(16.0))) ? (int32_t)p[2] : -1;
    const bool manual = (main_mode == 1) || (main_mode == 2) || (main_mode == 3) || (main_mode == 7);
    int32_t answer = ANSWER_DENIED;

    k->by_hand = manual;
    if (manual) {
        answer = ANSWER_ACCEPTED;
    } else if (main_mode == 6) {
        answer = send_request_kind(v, USER_OFFBOARD);
    } else if (main_mode == 4) {
        static const int32_t kinds[7] = {-1, -1, USER_TAKE_OFF, USER_PAUSE, USER_START, USER_RETURN, USER_LAND};

        if ((sub_mode >= 2) && (sub_mode <= 6)) {
            (void)send_request_kind(v, USER_RELEASE_STICKS);
            answer = send_request_kind(v, kinds[sub_mode]);
        }
    } else {
        /* not known here */
    }
    return answer;
}

static int32_t do_reposition(const link_vehicle_t *v, const mavlink_message_t *m, const real_t p[7])
{
    user_request_t ask = no_request;
    int32_t answer = ANSWER_DENIED;

    ask.kind = USER_GO_TO;
    ask.has_heading = real_is_finite(p[3]);
    ask.heading = p[3];
    if ((m->message == MSG_COMMAND_INT) && (m->payload[32] == FRAME_LOCAL_NED)) {
        ask.has_position = true;
        ask.position[0] = (real_t)mavlink_get_int(m, 16) / LOCAL_SCALE;
        ask.position[1] = (real_t)mavlink_get_int(m, 20) / LOCAL_SCALE;
        ask.position[2] = p[6];
        answer = send_request(v, &ask);
    }
    return answer;
}

static int32_t answer_message_request(link_t *k, const real_t p[7])
{
    const uint32_t message = to_unsigned_field(p[0], REAL(16777215.0), 0xFFFFFFFFU);
    int32_t answer = RESULT_UNSUPPORTED;

    if (message == MSG_AUTOPILOT_VERSION) {
        mavlink_message_t m;

        autopilot_version_message(&m);
        answer = send_message(k, &m) ? ANSWER_ACCEPTED : ANSWER_REJECTED_FOR_NOW;
    }
    if (request_stream(k, message)) {
        answer = ANSWER_ACCEPTED;
    }
    return answer;
}

/* PREFLIGHT_STORAGE: parameters and calibration (p[0]: 0 load, 1 store, 2 to 4 reset), mission (p[1]: 1 store, 2 reset; a load
 * changes nothing, since each upload is stored). */
static int32_t store_or_reset_settings(const link_vehicle_t *v, const real_t p[7])
{
    const tunables_t t = link_tunables(v);
    const uint32_t values = to_unsigned_field(p[0], REAL(4.0), 5U);
    const uint32_t mission = to_unsigned_field(p[1], REAL(2.0), 3U);
    bool stored = true;
    int32_t answer = ANSWER_REJECTED_FOR_NOW;

    if (may_load(v)) {
        if (values == 0U) {
            settings_reload(v->settings, &t);
        } else if (values <= 4U) {
            settings_reset(v->settings, &t, (values == 2U) || (values == 4U), values >= 3U);
            stored = settings_store(v->settings, &t);
        } else {
            /* nothing to do */
        }
        if (mission == 2U) {
            settings_reset_mission(v->plan);
            reset_for_loaded_mission(v->plan, &v->software->mission);
        }
        if ((mission == 1U) || (mission == 2U)) {
            stored = settings_store_mission(v->settings, v->plan) && stored;
        }
        answer = stored ? ANSWER_ACCEPTED : RESULT_FAILED;
    }
    return answer;
}

static int32_t execute_command(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, uint32_t command, const real_t p[7],
                       bool repeated)
{
    user_request_t ask = no_request;
    int32_t answer = RESULT_UNSUPPORTED;

    switch (command) {
    case 400U: /* COMPONENT_ARM_DISARM */
        ask.kind = (p[0] > REAL(0.5)) ? USER_ARM : USER_DISARM;
        ask.force = (p[1] >= FORCE_DISARM_MAGIC) && (p[1] <= FORCE_DISARM_MAGIC);
        ask.repeated = repeated;
        answer = send_request(v, &ask);
        k->tells_faults = (ask.kind == USER_ARM) && (answer != ANSWER_ACCEPTED);
        break;
    case 185U: /* DO_FLIGHTTERMINATION */
        ask.kind = USER_DISARM;
        ask.force = true;
        answer = (p[0] > REAL(0.5)) ? send_request(v, &ask) : ANSWER_DENIED;
        break;
    case 22U: /* NAV_TAKEOFF, NAV_TAKEOFF_LOCAL */
    case 24U:
        ask.kind = USER_TAKE_OFF;
        ask.height = (command == 24U) ? -p[6] : p[6];
        ask.has_height = real_is_finite(ask.height) && (real_abs(ask.height) > REAL(0.0));
        answer = send_request(v, &ask);
        break;
    case 21U: /* NAV_LAND, NAV_LAND_LOCAL, DO_LAND_START */
    case 23U:
    case 189U:
        answer = send_request_kind(v, USER_LAND);
        break;
    case 20U: /* NAV_RETURN_TO_LAUNCH */
        answer = send_request_kind(v, USER_RETURN);
        break;
    case 300U: /* MISSION_START */
        answer = send_request_kind(v, USER_START);
        break;
    case 193U: /* DO_PAUSE_CONTINUE */
        answer = send_request_kind(v, (p[0] < REAL(0.5)) ? USER_PAUSE : USER_START);
        break;
    case 192U: /* DO_REPOSITION */
        answer = do_reposition(v, m, p);
        break;
    case 245U: /* PREFLIGHT_STORAGE */
        answer = store_or_reset_settings(v, p);
        break;
    case 176U: /* DO_SET_MODE */
        answer = set_mode(k, v, p);
        break;
    default:
        answer = RESULT_UNSUPPORTED;
        break;
    }
    return answer;
}

static bool is_same_value(real_t a, real_t b)
{
    return ((a <= b) && (a >= b)) || (real_is_nan(a) && real_is_nan(b));
}

/* The latest of the remembered commands that equals this one; NULL: none. */
static link_command_t *find_repeated_command(link_t *k, const mavlink_message_t *m, uint32_t command, const real_t p[7])
{
    link_command_t *found = NULL;

    for (int32_t i = 0; i < LINK_TEXTS; i++) {
        link_command_t *c = &k->last[i];
        bool same = c->used && (c->system == m->system) && (c->component == m->component) && (c->command == command);

        for (int32_t n = 0; n < 7; n++) {
            same = same && is_same_value(c->params[n], p[n]);
        }
        if (same && ((found == NULL) || (c->time_s > found->time_s))) {
            found = c;
        }
    }
    return found;
}

static void remember_command(link_t *k, const mavlink_message_t *m, uint32_t command, const real_t p[7], real_t now_s, bool accepted,
                     link_command_t *before)
{
    link_command_t *c = before;

    if (c == NULL) {
        c = &k->last[k->next_last];
        k->next_last = (k->next_last + 1) % LINK_TEXTS;
    }
    c->used = true;
    c->system = m->system;
    c->component = m->component;
    c->command = command;
    for (int32_t n = 0; n < 7; n++) {
        c->params[n] = p[n];
    }
    c->time_s = now_s;
    c->accepted = accepted;
}

void handle_command(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands)
{
    const uint32_t command = mavlink_get(m, 28, 2);
    const bool is_long = m->message == MSG_COMMAND_LONG;
    const bool confirmed = is_long && (m->payload[32] != 0U);
    const real_t now_s = v->supervisor->now_s;
    mavlink_message_t ack;
    link_command_t *before;
    real_t p[7];
    int32_t answer;
    bool stops;
    bool repeated;

    for (int32_t n = 0; n < 7; n++) {
        p[n] = mavlink_get_real(m, 4 * n);
    }
    if (!is_long) {
        p[4] = (real_t)mavlink_get_int(m, 16);
        p[5] = (real_t)mavlink_get_int(m, 20);
        p[6] = mavlink_get_real(m, 24);
    }
    stops = (command == 185U) || ((command == 400U) && (p[0] < REAL(0.5)) && (p[1] >= FORCE_DISARM_MAGIC));
    before = find_repeated_command(k, m, command, p);
    repeated = (before != NULL) && ((now_s - before->time_s) < (confirmed ? CONFIRMATION_WINDOW_S : REPEAT_WINDOW_S));
    if ((command == 512U) || (command == 520U)) { /* REQUEST_MESSAGE, REQUEST_AUTOPILOT_CAPABILITIES: of any station */
        p[0] = (command == 520U) ? REAL(148.0) : p[0];
        answer = answer_message_request(k, p);
    } else if (!commands && !stops) {
        answer = ANSWER_DENIED;
        send_string(k, "denied: another station commands", 4U);
    } else if (repeated && before->accepted && !stops) {
        answer = ANSWER_ACCEPTED;
    } else {
        answer = execute_command(k, v, m, command, p, repeated);
        remember_command(k, m, command, p, now_s, answer == ANSWER_ACCEPTED, before);
    }
    mavlink_begin(&ack, MSG_COMMAND_ACK, 10);
    mavlink_put(&ack, 0, 2, command);
    mavlink_put(&ack, 2, 1, (uint32_t)answer);
    mavlink_put(&ack, 8, 1, m->system);
    mavlink_put(&ack, 9, 1, m->component);
    (void)send_message(k, &ack);
}
