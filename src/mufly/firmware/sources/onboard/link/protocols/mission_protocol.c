#include "onboard/link/protocols/mission_protocol.h"

#include "mission/user_requests.h"
#include "onboard/link/link_output.h"

#define LOAD_RETRY_S REAL(0.5)
#define LOAD_TIMEOUT_S REAL(5.0)

bool may_load(const link_vehicle_t *v)
{
    return !v->supervisor->armed && (v->software->motors == MOTORS_OFF) && (v->software->mission.state == STATE_INIT);
}

static void send_mission_ack(link_t *k, const mavlink_message_t *to, uint32_t result)
{
    mavlink_message_t m;

    mavlink_begin(&m, MSG_MISSION_ACK, 4);
    mavlink_put(&m, 0, 1, to->system);
    mavlink_put(&m, 1, 1, to->component);
    mavlink_put(&m, 2, 1, result);
    (void)send_message(k, &m);
}

static void request_item(link_t *k, const link_vehicle_t *v)
{
    mavlink_message_t m;

    mavlink_begin(&m, MSG_MISSION_REQUEST_INT, 5);
    mavlink_put(&m, 0, 2, (uint32_t)k->load_next);
    mavlink_put(&m, 2, 1, k->load_system);
    mavlink_put(&m, 3, 1, k->load_component);
    (void)send_message(k, &m);
    k->load_asked_s = v->supervisor->now_s;
}

/* Take an item into the mission that is being loaded; return whether it is a valid one. */
static bool accept_item(link_t *k, const mavlink_message_t *m)
{
    const uint32_t command = mavlink_get(m, 30, 2);
    const real_t x = (real_t)mavlink_get_int(m, 16) / LOCAL_SCALE;
    const real_t y = (real_t)mavlink_get_int(m, 20) / LOCAL_SCALE;
    const real_t z = mavlink_get_real(m, 24);
    const bool first = k->load_next == 0;
    const bool last = k->load_next == (k->load_count - 1);
    const bool local = m->payload[34] == FRAME_LOCAL_NED;
    const bool placed = local && (z <= -MIN_WAYPOINT_HEIGHT_M) && (z >= -MAX_HEIGHT_M) && (real_hypot(x, y) <= MAX_COORDINATE_M);
    plan_t *p = &k->loaded;
    bool good = false;

    if ((command == 16U) && placed && (p->count < MISSION_WAYPOINTS)) {
        const real_t wait_s = mavlink_get_real(m, 0);
        const real_t heading_deg = mavlink_get_real(m, 12);
        waypoint_t *w = &p->waypoint[p->count];

        w->position[0] = x;
        w->position[1] = y;
        w->position[2] = z;
        w->wait_s = ((wait_s >= REAL(0.0)) && (wait_s < REAL(3600.0))) ? wait_s : REAL(0.0);
        w->speed = p->limits.speed;
        w->has_heading = real_is_finite(heading_deg) && (real_abs(heading_deg) <= REAL(360.0));
        w->heading = w->has_heading ? (heading_deg * DEGREE) : REAL(0.0);
        p->count++;
        good = true;
    } else if (((command == 22U) || (command == 24U)) && first && placed) {
        p->take_off_height = -z;
        good = true;
    } else if (((command == 21U) || (command == 23U)) && last) {
        p->at_end = AT_END_LAND;
        good = true;
    } else if ((command == 20U) && last) {
        p->at_end = AT_END_RETURN;
        good = true;
    } else {
        /* an item that this vehicle cannot fly */
    }
    return good;
}

static void finish_upload(link_t *k, const link_vehicle_t *v, const mavlink_message_t *to)
{
    k->loads = false;
    if (may_load(v) && (k->loaded.count > 0) && settings_store_mission(v->settings, &k->loaded)) {
        *v->plan = k->loaded;
        reset_for_loaded_mission(v->plan, &v->software->mission);
        send_mission_ack(k, to, 0U);
    } else {
        send_mission_ack(k, to, 1U);
    }
}

static void send_item(link_t *k, const link_vehicle_t *v, const mavlink_message_t *to)
{
    const int32_t which = (int32_t)mavlink_get(to, 0, 2);
    const plan_t *p = v->plan;
    const int32_t count = p->count + 2; /* take-off, waypoints, end */
    mavlink_message_t m;

    if (which < count) {
        uint32_t command = 16U;
        real_t place[3] = {p->start[0], p->start[1], -p->take_off_height};

        mavlink_begin(&m, MSG_MISSION_ITEM_INT, 38);
        mavlink_put_real(&m, 12, REAL_NAN);
        if (which == 0) {
            command = 22U;
        } else if (which == (count - 1)) {
            command = (p->at_end == AT_END_RETURN) ? 20U : 21U;
            place[2] = REAL(0.0);
        } else {
            const waypoint_t *w = &p->waypoint[which - 1];

            for (int32_t i = 0; i < 3; i++) {
                place[i] = w->position[i];
            }
            mavlink_put_real(&m, 0, w->wait_s);
            if (w->has_heading) {
                mavlink_put_real(&m, 12, w->heading / DEGREE);
            }
        }
        mavlink_put(&m, 16, 4, (uint32_t)(int32_t)(place[0] * LOCAL_SCALE));
        mavlink_put(&m, 20, 4, (uint32_t)(int32_t)(place[1] * LOCAL_SCALE));
        mavlink_put_real(&m, 24, place[2]);
        mavlink_put(&m, 28, 2, (uint32_t)which);
        mavlink_put(&m, 30, 2, command);
        mavlink_put(&m, 32, 1, to->system);
        mavlink_put(&m, 33, 1, to->component);
        mavlink_put(&m, 34, 1, FRAME_LOCAL_NED);
        mavlink_put(&m, 35, 1, (which == 0) ? 1U : 0U); /* the item that a start begins with */
        mavlink_put(&m, 36, 1, 1U);
        (void)send_message(k, &m);
    } else {
        send_mission_ack(k, to, 13U); /* MAV_MISSION_INVALID_SEQUENCE */
    }
}

static void begin_upload(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m)
{
    const int32_t count = (int32_t)mavlink_get(m, 0, 2);

    if (!may_load(v)) {
        send_mission_ack(k, m, 1U);
    } else if ((count < 1) || (count > (MISSION_WAYPOINTS + 2))) {
        send_mission_ack(k, m, 4U); /* MAV_MISSION_NO_SPACE */
    } else {
        k->loads = true;
        k->load_count = count;
        k->load_next = 0;
        k->load_system = m->system;
        k->load_component = m->component;
        k->load_begun_s = v->supervisor->now_s;
        k->loaded = *v->plan;
        k->loaded.count = 0;
        k->loaded.at_end = AT_END_HOVER;
        request_item(k, v);
    }
}

void handle_mission(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands)
{
    mavlink_message_t answer;

    if (m->message == MSG_MISSION_REQUEST_LIST) {
        mavlink_begin(&answer, MSG_MISSION_COUNT, 5);
        if (m->payload[2] == 0U) { /* no fence, no rally points */
            mavlink_put(&answer, 0, 2, (uint32_t)v->plan->count + 2U);
        }
        mavlink_put(&answer, 2, 1, m->system);
        mavlink_put(&answer, 3, 1, m->component);
        mavlink_put(&answer, 4, 1, m->payload[2]);
        (void)send_message(k, &answer);
    } else if (m->message == MSG_MISSION_REQUEST_INT) {
        send_item(k, v, m);
    } else if (!commands) {
        send_mission_ack(k, m, 1U);
    } else if (m->message == MSG_MISSION_COUNT) {
        begin_upload(k, v, m);
    } else if ((m->message == MSG_MISSION_ITEM_INT) && k->loads && (m->system == k->load_system)) {
        if ((int32_t)mavlink_get(m, 28, 2) != k->load_next) {
            request_item(k, v);
        } else if (!accept_item(k, m)) {
            k->loads = false;
            send_mission_ack(k, m, 3U); /* MAV_MISSION_UNSUPPORTED */
        } else {
            k->load_next++;
            k->load_begun_s = v->supervisor->now_s;
            if (k->load_next < k->load_count) {
                request_item(k, v);
            } else {
                finish_upload(k, v, m);
            }
        }
    } else {
        send_mission_ack(k, m, 3U);
    }
}

void step_upload(link_t *k, const link_vehicle_t *v)
{
    const real_t now_s = v->supervisor->now_s;

    if (k->loads && ((now_s - k->load_begun_s) > LOAD_TIMEOUT_S)) {
        k->loads = false;
    } else if (k->loads && ((now_s - k->load_asked_s) > LOAD_RETRY_S)) {
        request_item(k, v);
    } else {
        /* no item is late */
    }
}
