#include "link.h"

#include <stddef.h>

#include "parameters.h"
#include "rc.h"
#include "text.h"
#include "user_requests.h"

#define VEHICLE_SYSTEM 1U
#define VEHICLE_COMPONENT 1U
#define COMMANDER_TIMEOUT_S REAL(5.0)
#define REPEAT_WINDOW_S REAL(0.8)
#define CONFIRMATION_WINDOW_S REAL(10.0)
#define FORCE_MAGIC REAL(21196.0)
#define PARAM_TYPE_REAL32 9U
#define FRAME_LOCAL_NED 1U
#define LOCAL_SCALE REAL(1e4) /* of x and y in COMMAND_INT and MISSION_ITEM_INT */
#define LOAD_RETRY_S REAL(0.5)
#define LOAD_TIMEOUT_S REAL(5.0)
#define UNSUPPORTED 3
#define TEXT_CHUNK 50
#define FAILED 4

enum { STREAM_HEARTBEAT, STREAM_SYS_STATUS, STREAM_BATTERY, STREAM_EXTENDED, STREAM_MISSION, STREAM_ATTITUDE,
       STREAM_POSITION, STREAM_ESTIMATOR };

/* Message and interval (s) of each stream, as in telemetry_streams.py of mufly.link. */
static const struct {
    uint32_t message;
    real_t interval_s;
} streams[LINK_STREAMS] = {
    {MSG_HEARTBEAT, REAL(1.0)}, {MSG_SYS_STATUS, REAL(0.5)}, {MSG_BATTERY_STATUS, REAL(1.0)},
    {MSG_EXTENDED_SYS_STATE, REAL(0.5)}, {MSG_MISSION_CURRENT, REAL(0.5)}, {MSG_ATTITUDE, REAL(0.05)},
    {MSG_LOCAL_POSITION_NED, REAL(0.05)}, {MSG_ESTIMATOR_STATUS, REAL(1.0)},
};

static const user_request_t no_request;

void link_start(link_t *k)
{
    static const link_t none;

    *k = none;
    for (int32_t i = 0; i < LINK_STREAMS; i++) {
        k->due_s[i] = (real_t)i / (real_t)mufly_rate_Hz; /* a period apart, here and in all that follow */
    }
}

/* Output */

static int32_t next_output(int32_t place)
{
    return ((place + 1) < LINK_OUTPUT) ? (place + 1) : 0;
}

static bool send_message(link_t *k, mavlink_message_t *m)
{
    uint8_t frame[MAVLINK_FRAME];
    int32_t length;
    bool fits;

    m->system = VEHICLE_SYSTEM;
    m->component = VEHICLE_COMPONENT;
    length = mavlink_encode(m, k->sequence, frame);
    fits = (k->output_count + length) <= LINK_OUTPUT;
    if (fits) {
        int32_t to = (k->output_first + k->output_count) % LINK_OUTPUT;

        for (int32_t i = 0; i < length; i++) {
            k->output[to] = frame[i];
            to = next_output(to);
        }
        k->output_count += length;
        k->sequence = (uint8_t)((k->sequence + 1U) & 0xFFU);
    } else {
        k->dropped++;
    }
    return fits;
}

int32_t link_waiting(const link_t *k, uint8_t *to, int32_t most)
{
    const int32_t count = (k->output_count < most) ? k->output_count : most;
    int32_t from = k->output_first;

    for (int32_t i = 0; i < count; i++) {
        to[i] = k->output[from];
        from = next_output(from);
    }
    return count;
}

void link_sent(link_t *k, int32_t count)
{
    const int32_t taken = (count < k->output_count) ? count : k->output_count;

    k->output_first = (k->output_first + taken) % LINK_OUTPUT;
    k->output_count -= taken;
    k->sent_count = taken;
}

/* A number as an unsigned field; unknown where it does not fit. */
static uint32_t to_field(real_t value, real_t most, uint32_t unknown)
{
    return ((value >= REAL(0.0)) && (value <= most)) ? (uint32_t)value : unknown;
}

static uint32_t time_ms(const link_vehicle_t *v)
{
    return to_field(v->belief->time_s * REAL(1000.0), REAL(4e9), 0U);
}

static void send_text(link_t *k, const char *text, int32_t length, uint32_t severity)
{
    const int32_t chunks = (length > TEXT_CHUNK) ? 2 : 1;

    k->text_id = (k->text_id % 0xFFFFU) + 1U;
    for (int32_t c = 0; c < chunks; c++) {
        mavlink_message_t m;

        mavlink_begin(&m, MSG_STATUSTEXT, 54);
        mavlink_put(&m, 0, 1, severity);
        for (int32_t i = 0; (i < TEXT_CHUNK) && (((c * TEXT_CHUNK) + i) < length); i++) {
            m.payload[1 + i] = (uint8_t)text[(c * TEXT_CHUNK) + i];
        }
        if (chunks > 1) {
            mavlink_put(&m, 51, 2, k->text_id);
            mavlink_put(&m, 53, 1, (uint32_t)c);
        }
        (void)send_message(k, &m);
    }
}

static void send_words(link_t *k, const char *text, uint32_t severity)
{
    int32_t length = 0;

    while (text[length] != '\0') {
        length++;
    }
    send_text(k, text, length, severity);
}

/* Custom mode of PX4 for a state: main mode, sub mode. */
static uint32_t custom_mode(const mission_t *x)
{
    static const uint8_t sub[MISSION_STATE_COUNT] = {1U, 2U, 3U, 4U, 4U, 6U, 0U, 0U};
    uint32_t main_mode = 4U;
    uint32_t sub_mode = sub[x->state];

    if (x->returning_home) {
        sub_mode = 5U;
    } else if (x->state == STATE_RC) {
        main_mode = 2U;
    } else if (x->state == STATE_OFFBOARD) {
        main_mode = 6U;
    } else if (x->manual && ((x->state == STATE_WAYPOINT) || (x->state == STATE_OBSTACLE))) {
        sub_mode = 3U;
    } else {
        /* by the state alone */
    }
    return (main_mode << 16U) | (sub_mode << 24U);
}

static void make_heartbeat(const link_vehicle_t *v, mavlink_message_t *m)
{
    const mission_t *x = &v->software->mission;
    const bool low = x->battery_V < v->plan->low_voltage;
    uint32_t base = 1U + 16U + ((x->state == STATE_RC) ? 64U : 12U);
    uint32_t status = v->supervisor->armed ? 4U : 3U;

    base += v->supervisor->armed ? 128U : 0U;
    status = (low && supervisor_in_air(v->software, v->belief)) ? 5U : status;
    mavlink_begin(m, MSG_HEARTBEAT, 9);
    mavlink_put(m, 0, 4, custom_mode(x));
    mavlink_put(m, 4, 1, 3U);  /* MAV_TYPE_COAXIAL */
    mavlink_put(m, 5, 1, 12U); /* MAV_AUTOPILOT_PX4: its modes */
    mavlink_put(m, 6, 1, base);
    mavlink_put(m, 7, 1, status);
    mavlink_put(m, 8, 1, 3U);
}

static void make_sys_status(const link_vehicle_t *v, mavlink_message_t *m)
{
    /* gyroscopes, accelerometers; rate, attitude, yaw, height and position control; motors; battery; AHRS; arming check */
    const uint32_t here = 1U + 2U + 0x400U + 0x800U + 0x1000U + 0x2000U + 0x4000U + 0x8000U + 0x200000U + 0x2000000U + 0x10000000U;
    const bool ready = v->supervisor->armed || (supervisor_arming_faults(v->supervisor, v->setup, v->belief) == 0U);
    uint32_t well = here;

    well -= ready ? 0U : 0x10000000U;
    well -= v->belief->valid ? 0U : 0x200000U;
    mavlink_begin(m, MSG_SYS_STATUS, 31);
    mavlink_put(m, 0, 4, here);
    mavlink_put(m, 4, 4, here);
    mavlink_put(m, 8, 4, well);
    mavlink_put(m, 14, 2, to_field(v->belief->motion.voltage * REAL(1e3), REAL(65534.0), 65535U));
    mavlink_put(m, 16, 2, 0xFFFFU); /* current unknown */
    mavlink_put(m, 30, 1, 0xFFU);   /* charge unknown */
}

static void make_battery(const link_vehicle_t *v, mavlink_message_t *m)
{
    mavlink_begin(m, MSG_BATTERY_STATUS, 41);
    mavlink_put(m, 0, 4, 0xFFFFFFFFU);
    mavlink_put(m, 4, 4, 0xFFFFFFFFU);
    mavlink_put(m, 8, 2, 32767U);
    mavlink_put(m, 10, 2, to_field(v->belief->motion.voltage * REAL(1e3), REAL(65534.0), 65535U));
    for (int32_t i = 1; i < 10; i++) {
        mavlink_put(m, 10 + (2 * i), 2, 65535U);
    }
    mavlink_put(m, 30, 2, 0xFFFFU);
    mavlink_put(m, 33, 1, 1U); /* MAV_BATTERY_FUNCTION_ALL */
    mavlink_put(m, 34, 1, 1U); /* MAV_BATTERY_TYPE_LIPO */
    mavlink_put(m, 35, 1, 0xFFU);
    mavlink_put(m, 40, 1, (v->software->mission.battery_V < v->plan->low_voltage) ? 2U : 1U);
}

static void make_extended(const link_vehicle_t *v, mavlink_message_t *m)
{
    const software_t *s = v->software;
    uint32_t landed = 2U;

    if ((s->motors == MOTORS_OFF) || (s->motors == MOTORS_RAMP_DOWN)) {
        landed = 1U;
    } else if (s->mission.state == STATE_TAKE_OFF) {
        landed = 3U;
    } else if (s->mission.state == STATE_LANDING) {
        landed = 4U;
    } else {
        /* in the air */
    }
    mavlink_begin(m, MSG_EXTENDED_SYS_STATE, 2);
    mavlink_put(m, 1, 1, landed);
}

static void make_motion(const link_vehicle_t *v, mavlink_message_t *m, bool attitude)
{
    const motion_estimate_t *now = &v->belief->motion;

    mavlink_begin(m, attitude ? MSG_ATTITUDE : MSG_LOCAL_POSITION_NED, 28);
    mavlink_put(m, 0, 4, time_ms(v));
    for (int32_t i = 0; i < 3; i++) {
        const real_t angle = (i == 2) ? real_wrap_angle(now->attitude[i]) : now->attitude[i];

        mavlink_put_real(m, 4 + (4 * i), attitude ? angle : now->position[i]);
        mavlink_put_real(m, 16 + (4 * i), attitude ? now->rates[i] : now->velocity[i]);
    }
}

static void make_estimator_status(const link_vehicle_t *v, mavlink_message_t *m)
{
    const estimate_t *b = v->belief;
    const real_t level = real_sqrt(real_max(REAL(0.0), b->position_variance[0] + b->position_variance[1]));
    const real_t height = real_sqrt(real_max(REAL(0.0), b->position_variance[2]));
    const real_t tilt = real_max(b->attitude_variance[0], b->attitude_variance[1]);
    uint32_t flags = 0U;

    if (b->valid) {
        flags += (tilt < (REAL(100.0) * DEGREE * DEGREE)) ? 1U : 0U;
        flags += (level < REAL(0.5)) ? (8U + 16U + 256U + 512U) : 0U;
        flags += (height < REAL(0.5)) ? 32U : 0U;
        flags += (b->checks[SENSOR_SONAR].status == SENSOR_FUSED) ? 64U : 0U;
    }
    mavlink_begin(m, MSG_ESTIMATOR_STATUS, 42);
    mavlink_put(m, 0, 4, time_ms(v) * 1000U);
    mavlink_put_real(m, 32, level);
    mavlink_put_real(m, 36, height);
    mavlink_put(m, 40, 2, flags);
}

static void make_version(mavlink_message_t *m)
{
    mavlink_begin(m, MSG_AUTOPILOT_VERSION, 60);
    /* MISSION_INT, COMMAND_INT, SET_POSITION_TARGET_LOCAL_NED, MAVLINK2 */
    mavlink_put(m, 0, 4, 4U + 8U + 0x80U + 0x2000U);
    m->payload[36] = (uint8_t)'m';
    m->payload[37] = (uint8_t)'u';
    m->payload[38] = (uint8_t)'f';
    m->payload[39] = (uint8_t)'l';
    m->payload[40] = (uint8_t)'y';
}

static void make_stream(const link_vehicle_t *v, int32_t which, mavlink_message_t *m)
{
    switch (which) {
    case STREAM_HEARTBEAT:
        make_heartbeat(v, m);
        break;
    case STREAM_SYS_STATUS:
        make_sys_status(v, m);
        break;
    case STREAM_BATTERY:
        make_battery(v, m);
        break;
    case STREAM_EXTENDED:
        make_extended(v, m);
        break;
    case STREAM_MISSION:
        mavlink_begin(m, MSG_MISSION_CURRENT, 6);
        mavlink_put(m, 0, 2, (uint32_t)v->software->mission.waypoint_index);
        mavlink_put(m, 2, 2, (uint32_t)v->plan->count);
        break;
    case STREAM_ATTITUDE:
        make_motion(v, m, true);
        break;
    case STREAM_POSITION:
        make_motion(v, m, false);
        break;
    default:
        make_estimator_status(v, m);
        break;
    }
}

/* Whether missions and settings may change: on the floor, with motors off. */
static bool may_load(const link_vehicle_t *v)
{
    return !v->supervisor->armed && (v->software->motors == MOTORS_OFF) && (v->software->mission.state == STATE_INIT);
}

/* Parameters */

static tunables_t tunables_of(const link_vehicle_t *v)
{
    const tunables_t t = {v->plan, &v->supervisor->settings, &v->settings->calibration, v->rc};

    return t;
}

static void send_parameter(link_t *k, const link_vehicle_t *v, int32_t which)
{
    const char *name = parameter_name(which);
    const tunables_t t = tunables_of(v);
    mavlink_message_t m;

    mavlink_begin(&m, MSG_PARAM_VALUE, 25);
    mavlink_put_real(&m, 0, parameter_get(&t, which));
    mavlink_put(&m, 4, 2, (uint32_t)PARAMETERS);
    mavlink_put(&m, 6, 2, (uint32_t)which);
    for (int32_t i = 0; (i < PARAMETER_NAME) && (name[i] != '\0'); i++) {
        m.payload[8 + i] = (uint8_t)name[i];
    }
    mavlink_put(&m, 24, 1, PARAM_TYPE_REAL32);
    (void)send_message(k, &m);
}

static void handle_parameters(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands)
{
    if (m->message == MSG_PARAM_REQUEST_LIST) {
        k->lists = true;
        k->listed = 0;
    } else if (m->message == MSG_PARAM_REQUEST_READ) {
        const uint32_t index = mavlink_get(m, 0, 2);
        const int32_t which = (index < (uint32_t)PARAMETERS) ? (int32_t)index : parameter_find(&m->payload[4]);

        if (which >= 0) {
            send_parameter(k, v, which);
        }
    } else {
        const int32_t which = parameter_find(&m->payload[6]);

        if (which >= 0) {
            if (commands) {
                const tunables_t t = tunables_of(v);
                const int32_t answer = settings_set(v->settings, &t, which, mavlink_get_real(m, 0), may_load(v));

                if (answer == SETTING_OUT_OF_BOUNDS) {
                    send_words(k, "parameter out of its bounds; it stays", 4U);
                } else if (answer == SETTING_ON_FLOOR_ONLY) {
                    send_words(k, "calibration needs motors off; it stays", 4U);
                } else {
                    /* set */
                }
            }
            send_parameter(k, v, which); /* the value that counts */
        }
    }
}

/* Missions */

static void send_mission_ack(link_t *k, const mavlink_message_t *to, uint32_t result)
{
    mavlink_message_t m;

    mavlink_begin(&m, MSG_MISSION_ACK, 4);
    mavlink_put(&m, 0, 1, to->system);
    mavlink_put(&m, 1, 1, to->component);
    mavlink_put(&m, 2, 1, result);
    (void)send_message(k, &m);
}

static void ask_for_item(link_t *k, const link_vehicle_t *v)
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
static bool take_item(link_t *k, const mavlink_message_t *m)
{
    const uint32_t command = mavlink_get(m, 30, 2);
    const real_t x = (real_t)mavlink_get_int(m, 16) / LOCAL_SCALE;
    const real_t y = (real_t)mavlink_get_int(m, 20) / LOCAL_SCALE;
    const real_t z = mavlink_get_real(m, 24);
    const bool first = k->load_next == 0;
    const bool last = k->load_next == (k->load_count - 1);
    const bool local = m->payload[34] == FRAME_LOCAL_NED;
    const bool placed = local && (z <= -MIN_WAYPOINT_HEIGHT_M) && (z >= -MAX_HEIGHT_M) && (real_hypot(x, y) <= MAX_EXTENT_M);
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
        ask_for_item(k, v);
    }
}

static void handle_mission(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands)
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
            ask_for_item(k, v);
        } else if (!take_item(k, m)) {
            k->loads = false;
            send_mission_ack(k, m, 3U); /* MAV_MISSION_UNSUPPORTED */
        } else {
            k->load_next++;
            k->load_begun_s = v->supervisor->now_s;
            if (k->load_next < k->load_count) {
                ask_for_item(k, v);
            } else {
                finish_upload(k, v, m);
            }
        }
    } else {
        send_mission_ack(k, m, 3U);
    }
}

/* Commands */

static int32_t request(const link_vehicle_t *v, const user_request_t *ask)
{
    return supervisor_request(v->supervisor, v->setup, v->software, v->belief, ask);
}

static int32_t request_kind(const link_vehicle_t *v, int32_t kind)
{
    user_request_t ask = no_request;

    ask.kind = kind;
    return request(v, &ask);
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
        answer = request_kind(v, USER_OFFBOARD);
    } else if (main_mode == 4) {
        static const int32_t kinds[7] = {-1, -1, USER_TAKE_OFF, USER_PAUSE, USER_START, USER_RETURN, USER_LAND};

        if ((sub_mode >= 2) && (sub_mode <= 6)) {
            (void)request_kind(v, USER_RELEASE_STICKS);
            answer = request_kind(v, kinds[sub_mode]);
        }
    } else {
        /* not known here */
    }
    return answer;
}

static int32_t reposition(const link_vehicle_t *v, const mavlink_message_t *m, const real_t p[7])
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
        answer = request(v, &ask);
    }
    return answer;
}

static int32_t request_message(link_t *k, const real_t p[7])
{
    const uint32_t message = to_field(p[0], REAL(16777215.0), 0xFFFFFFFFU);
    int32_t answer = UNSUPPORTED;

    if (message == MSG_AUTOPILOT_VERSION) {
        mavlink_message_t m;

        make_version(&m);
        answer = send_message(k, &m) ? ANSWER_ACCEPTED : ANSWER_REJECTED_FOR_NOW;
    }
    for (int32_t i = 0; i < LINK_STREAMS; i++) {
        if (streams[i].message == message) {
            k->once[i] = true;
            answer = ANSWER_ACCEPTED;
        }
    }
    return answer;
}

/* PREFLIGHT_STORAGE: parameters and calibration (p[0]: 0 load, 1 store, 2 to 4 reset), mission (p[1]: 1 store, 2 reset; a load
 * changes nothing, since each upload is stored). */
static int32_t store_or_reset(const link_vehicle_t *v, const real_t p[7])
{
    const tunables_t t = tunables_of(v);
    const uint32_t values = to_field(p[0], REAL(4.0), 5U);
    const uint32_t mission = to_field(p[1], REAL(2.0), 3U);
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
        answer = stored ? ANSWER_ACCEPTED : FAILED;
    }
    return answer;
}

static int32_t execute(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, uint32_t command, const real_t p[7],
                       bool repeated)
{
    user_request_t ask = no_request;
    int32_t answer = UNSUPPORTED;

    switch (command) {
    case 400U: /* COMPONENT_ARM_DISARM */
        ask.kind = (p[0] > REAL(0.5)) ? USER_ARM : USER_DISARM;
        ask.force = (p[1] >= FORCE_MAGIC) && (p[1] <= FORCE_MAGIC);
        ask.repeated = repeated;
        answer = request(v, &ask);
        k->tells_faults = (ask.kind == USER_ARM) && (answer != ANSWER_ACCEPTED);
        break;
    case 185U: /* DO_FLIGHTTERMINATION */
        ask.kind = USER_DISARM;
        ask.force = true;
        answer = (p[0] > REAL(0.5)) ? request(v, &ask) : ANSWER_DENIED;
        break;
    case 22U: /* NAV_TAKEOFF, NAV_TAKEOFF_LOCAL */
    case 24U:
        ask.kind = USER_TAKE_OFF;
        ask.height = (command == 24U) ? -p[6] : p[6];
        ask.has_height = real_is_finite(ask.height) && (real_abs(ask.height) > REAL(0.0));
        answer = request(v, &ask);
        break;
    case 21U: /* NAV_LAND, NAV_LAND_LOCAL, DO_LAND_START */
    case 23U:
    case 189U:
        answer = request_kind(v, USER_LAND);
        break;
    case 20U: /* NAV_RETURN_TO_LAUNCH */
        answer = request_kind(v, USER_RETURN);
        break;
    case 300U: /* MISSION_START */
        answer = request_kind(v, USER_START);
        break;
    case 193U: /* DO_PAUSE_CONTINUE */
        answer = request_kind(v, (p[0] < REAL(0.5)) ? USER_PAUSE : USER_START);
        break;
    case 192U: /* DO_REPOSITION */
        answer = reposition(v, m, p);
        break;
    case 245U: /* PREFLIGHT_STORAGE */
        answer = store_or_reset(v, p);
        break;
    case 176U: /* DO_SET_MODE */
        answer = set_mode(k, v, p);
        break;
    default:
        answer = UNSUPPORTED;
        break;
    }
    return answer;
}

static bool is_same_value(real_t a, real_t b)
{
    return ((a <= b) && (a >= b)) || (real_is_nan(a) && real_is_nan(b));
}

/* The latest of the remembered commands that equals this one; NULL: none. */
static link_command_t *find_command(link_t *k, const mavlink_message_t *m, uint32_t command, const real_t p[7])
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

static void remember(link_t *k, const mavlink_message_t *m, uint32_t command, const real_t p[7], real_t now_s, bool accepted,
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

static void handle_command(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands)
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
    stops = (command == 185U) || ((command == 400U) && (p[0] < REAL(0.5)) && (p[1] >= FORCE_MAGIC));
    before = find_command(k, m, command, p);
    repeated = (before != NULL) && ((now_s - before->time_s) < (confirmed ? CONFIRMATION_WINDOW_S : REPEAT_WINDOW_S));
    if ((command == 512U) || (command == 520U)) { /* REQUEST_MESSAGE, REQUEST_AUTOPILOT_CAPABILITIES: of any station */
        p[0] = (command == 520U) ? REAL(148.0) : p[0];
        answer = request_message(k, p);
    } else if (!commands && !stops) {
        answer = ANSWER_DENIED;
        send_words(k, "denied: another station commands", 4U);
    } else if (repeated && before->accepted && !stops) {
        answer = ANSWER_ACCEPTED;
    } else {
        answer = execute(k, v, m, command, p, repeated);
        remember(k, m, command, p, now_s, answer == ANSWER_ACCEPTED, before);
    }
    mavlink_begin(&ack, MSG_COMMAND_ACK, 10);
    mavlink_put(&ack, 0, 2, command);
    mavlink_put(&ack, 2, 1, (uint32_t)answer);
    mavlink_put(&ack, 8, 1, m->system);
    mavlink_put(&ack, 9, 1, m->component);
    (void)send_message(k, &ack);
}

/* Steering */

static real_t stick(const mavlink_message_t *m, int32_t at)
{
    const int32_t raw = (int32_t)mavlink_get(m, at, 2);
    const int32_t wide = (raw < 32768) ? raw : (raw - 65536);
    const real_t value = (raw == 32767) ? REAL(0.0) : real_clip((real_t)wide / REAL(1000.0), REAL(-1.0), REAL(1.0));

    return value;
}

static void handle_steering(const link_t *k, const link_vehicle_t *v, const mavlink_message_t *m)
{
    const supervisor_settings_t *most = &v->supervisor->settings;
    user_request_t ask = no_request;

    if (m->message == MSG_MANUAL_CONTROL) {
        const real_t up = (mavlink_get(m, 4, 2) == 32767U) ? REAL(0.0) : ((REAL(2.0) * stick(m, 4)) - REAL(1.0));

        ask.kind = USER_STICKS;
        ask.roll = most->stick_tilt * apply_deadband(stick(m, 2));
        ask.pitch = -most->stick_tilt * apply_deadband(stick(m, 0));
        ask.climb_rate = most->stick_climb * apply_deadband(real_clip(up, REAL(-1.0), REAL(1.0)));
        ask.yaw_rate = most->stick_yaw_rate * apply_deadband(stick(m, 6));
        if (k->by_hand) {
            (void)request(v, &ask);
        }
    } else if (m->payload[52] == FRAME_LOCAL_NED) {
        const uint32_t mask = mavlink_get(m, 48, 2);

        ask.kind = USER_SET_POINT;
        for (int32_t i = 0; i < 3; i++) {
            const bool no_position = (mask & (1UL << (uint32_t)i)) != 0U;
            const bool no_velocity = (mask & (8UL << (uint32_t)i)) != 0U;

            ask.set_point.position[i] = no_position ? REAL_NAN : mavlink_get_real(m, 4 + (4 * i));
            ask.set_point.velocity[i] = no_velocity ? REAL_NAN : mavlink_get_real(m, 16 + (4 * i));
        }
        ask.set_point.heading = ((mask & 0x400U) != 0U) ? REAL_NAN : mavlink_get_real(m, 40);
        ask.set_point.yaw_rate = ((mask & 0x800U) != 0U) ? REAL_NAN : mavlink_get_real(m, 44);
        (void)request(v, &ask);
    } else {
        /* a frame that this vehicle does not follow */
    }
}

/* Whether a station may command; the first that asks becomes the commander. */
static bool may_command(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m)
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

            handle_command(k, v, m, asks_only || may_command(k, v, m));
        }
        break;
    case MSG_PARAM_REQUEST_READ:
        if (is_addressed(m, 2)) {
            handle_parameters(k, v, m, false);
        }
        break;
    case MSG_PARAM_REQUEST_LIST:
        if (is_addressed(m, 0)) {
            handle_parameters(k, v, m, false);
        }
        break;
    case MSG_PARAM_SET:
        if (is_addressed(m, 4)) {
            handle_parameters(k, v, m, may_command(k, v, m));
        }
        break;
    case MSG_MISSION_REQUEST_LIST:
        if (is_addressed(m, 0)) {
            handle_mission(k, v, m, false);
        }
        break;
    case MSG_MISSION_COUNT:
        if (is_addressed(m, 2)) {
            handle_mission(k, v, m, may_command(k, v, m));
        }
        break;
    case MSG_MISSION_REQUEST_INT:
        if (is_addressed(m, 2)) {
            handle_mission(k, v, m, false);
        }
        break;
    case MSG_MISSION_ITEM_INT:
        if (is_addressed(m, 32)) {
            handle_mission(k, v, m, may_command(k, v, m));
        }
        break;
    case MSG_MANUAL_CONTROL:
        if (((m->payload[10] == 0U) || (m->payload[10] == VEHICLE_SYSTEM)) && may_command(k, v, m)) {
            handle_steering(k, v, m);
        }
        break;
    case MSG_SET_POSITION_TARGET_LOCAL_NED:
        if (is_addressed(m, 50) && may_command(k, v, m)) {
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
            send_words(k, words[i], 4U);
            *faults &= ~((uint32_t)1U << i);
        }
    }
    return sent;
}

static bool send_arming_fault(link_t *k, const link_vehicle_t *v)
{
    static const char *const words[9] = {
        "position, velocity, attitude, rates not measured", "measurements are old; check the sensors",
        "battery voltage not measured; check its monitor", "battery low; charge it",
        "estimate not valid; leave the vehicle at rest", "vehicle tilted; set it on level ground",
        "vehicle moves; set it down and wait", "last flight interrupted; inspect it, arm again",
        "the climb stick is up; lower it first",
    };

    if (k->tells_faults) {
        k->tells_faults = false;
        k->untold_faults = v->supervisor->arming_faults;
    }
    return send_one_fault(k, &k->untold_faults, words, 9U);
}

/* Store what was set in flight. */
static void step_settings(const link_vehicle_t *v)
{
    if (settings_are_due(v->settings) && may_load(v)) {
        const tunables_t t = tunables_of(v);

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

    if ((x->logged_count - k->told) > MISSION_LOG) {
        k->told = x->logged_count - MISSION_LOG;
    }
    sends = (k->told < x->logged_count) && (k->output_count < (LINK_OUTPUT / 2));
    if (sends) {
        const log_entry_t *e = &x->log[k->told % MISSION_LOG];
        const int32_t length = write_message_text(&e->message, text);

        send_text(k, text, length, severity[((e->level >= 0) && (e->level < 3)) ? e->level : 0]);
        k->told++;
    }
    return sends;
}

static bool send_listed_parameter(link_t *k, const link_vehicle_t *v)
{
    const bool sends = k->lists && (k->output_count < (LINK_OUTPUT / 2));

    if (sends) {
        send_parameter(k, v, k->listed);
        k->listed++;
        k->lists = k->listed < (int32_t)PARAMETERS;
    }
    return sends;
}

static void send_stream(link_t *k, const link_vehicle_t *v)
{
    const real_t now_s = v->supervisor->now_s;
    bool sent = false;

    for (int32_t i = 0; (i < LINK_STREAMS) && !sent; i++) {
        sent = k->once[i] || (now_s >= k->due_s[i]);
        if (sent) {
            mavlink_message_t m;

            make_stream(v, i, &m);
            (void)send_message(k, &m);
            if (now_s >= k->due_s[i]) {
                k->due_s[i] = real_max(k->due_s[i] + streams[i].interval_s, now_s);
            }
            k->once[i] = false;
        }
    }
}

void link_step(link_t *k, const link_vehicle_t *v)
{
    const real_t now_s = v->supervisor->now_s;
    mavlink_message_t m;
    bool sent;

    for (int32_t i = 0; i < k->input_count; i++) {
        if (mavlink_parse(&k->parser, k->input[i], &m)) {
            handle_message(k, v, &m);
        }
    }
    if (k->loads && ((now_s - k->load_begun_s) > LOAD_TIMEOUT_S)) {
        k->loads = false;
    } else if (k->loads && ((now_s - k->load_asked_s) > LOAD_RETRY_S)) {
        ask_for_item(k, v);
    } else {
        /* nothing is late */
    }
    step_settings(v);
    /* At most one message a period, besides answers: that bounds its length. */
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
