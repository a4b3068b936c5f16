#include "onboard/link/protocols/telemetry_streams.h"

#include "onboard/link/link_output.h"

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

static uint32_t boot_time_ms(const link_vehicle_t *v)
{
    return to_unsigned_field(v->belief->time_s * REAL(1000.0), REAL(4e9), 0U);
}

/* Custom mode of PX4 for a state: main mode, sub mode. */
static uint32_t displayed_mode(const mission_t *x)
{
    static const uint8_t sub[MISSION_STATE_COUNT] = {1U, 2U, 3U, 4U, 4U, 6U, 0U, 0U};
    const bool on_leg = (x->state == STATE_WAYPOINT) || (x->state == STATE_OBSTACLE);
    uint32_t main_mode = 4U;
    uint32_t sub_mode = sub[x->state];

    if (x->returning_home && on_leg) {
        sub_mode = 5U;
    } else if (x->state == STATE_RC) {
        main_mode = 2U;
    } else if (x->state == STATE_OFFBOARD) {
        main_mode = 6U;
    } else if (x->user_in_control && on_leg) {
        sub_mode = 3U;
    } else {
        /* by the state alone */
    }
    return (main_mode << 16U) | (sub_mode << 24U);
}

static void heartbeat_message(const link_vehicle_t *v, mavlink_message_t *m)
{
    const mission_t *x = &v->software->mission;
    const bool low = x->battery_V < v->plan->low_voltage;
    uint32_t base = 1U + 16U + ((x->state == STATE_RC) ? 64U : 12U);
    uint32_t status = v->supervisor->armed ? 4U : 3U;

    base += v->supervisor->armed ? 128U : 0U;
    status = (low && supervisor_in_air(v->software, v->belief)) ? 5U : status;
    mavlink_begin(m, MSG_HEARTBEAT, 9);
    mavlink_put(m, 0, 4, displayed_mode(x));
    mavlink_put(m, 4, 1, 3U);  /* MAV_TYPE_COAXIAL */
    mavlink_put(m, 5, 1, 12U); /* MAV_AUTOPILOT_PX4: its modes */
    mavlink_put(m, 6, 1, base);
    mavlink_put(m, 7, 1, status);
    mavlink_put(m, 8, 1, 3U);
}

static void sys_status_message(const link_vehicle_t *v, mavlink_message_t *m)
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
    mavlink_put(m, 14, 2, to_unsigned_field(v->belief->motion.voltage * REAL(1e3), REAL(65534.0), 65535U));
    mavlink_put(m, 16, 2, 0xFFFFU); /* current unknown */
    mavlink_put(m, 30, 1, 0xFFU);   /* charge unknown */
}

static void battery_status_message(const link_vehicle_t *v, mavlink_message_t *m)
{
    mavlink_begin(m, MSG_BATTERY_STATUS, 41);
    mavlink_put(m, 0, 4, 0xFFFFFFFFU);
    mavlink_put(m, 4, 4, 0xFFFFFFFFU);
    mavlink_put(m, 8, 2, 32767U);
    mavlink_put(m, 10, 2, to_unsigned_field(v->belief->motion.voltage * REAL(1e3), REAL(65534.0), 65535U));
    for (int32_t i = 1; i < 10; i++) {
        mavlink_put(m, 10 + (2 * i), 2, 65535U);
    }
    mavlink_put(m, 30, 2, 0xFFFFU);
    mavlink_put(m, 33, 1, 1U); /* MAV_BATTERY_FUNCTION_ALL */
    mavlink_put(m, 34, 1, 1U); /* MAV_BATTERY_TYPE_LIPO */
    mavlink_put(m, 35, 1, 0xFFU);
    mavlink_put(m, 40, 1, (v->software->mission.battery_V < v->plan->low_voltage) ? 2U : 1U);
}

static void extended_state_message(const link_vehicle_t *v, mavlink_message_t *m)
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

static void motion_message(const link_vehicle_t *v, mavlink_message_t *m, bool attitude)
{
    const motion_estimate_t *now = &v->belief->motion;

    mavlink_begin(m, attitude ? MSG_ATTITUDE : MSG_LOCAL_POSITION_NED, 28);
    mavlink_put(m, 0, 4, boot_time_ms(v));
    for (int32_t i = 0; i < 3; i++) {
        const real_t angle = (i == 2) ? real_wrap_angle(now->attitude[i]) : now->attitude[i];

        mavlink_put_real(m, 4 + (4 * i), attitude ? angle : now->position[i]);
        mavlink_put_real(m, 16 + (4 * i), attitude ? now->rates[i] : now->velocity[i]);
    }
}

static void estimator_status_message(const link_vehicle_t *v, mavlink_message_t *m)
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
    mavlink_put(m, 0, 4, boot_time_ms(v) * 1000U);
    mavlink_put_real(m, 32, level);
    mavlink_put_real(m, 36, height);
    mavlink_put(m, 40, 2, flags);
}

void autopilot_version_message(mavlink_message_t *m)
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

static void stream_message(const link_vehicle_t *v, int32_t which, mavlink_message_t *m)
{
    switch (which) {
    case STREAM_HEARTBEAT:
        heartbeat_message(v, m);
        break;
    case STREAM_SYS_STATUS:
        sys_status_message(v, m);
        break;
    case STREAM_BATTERY:
        battery_status_message(v, m);
        break;
    case STREAM_EXTENDED:
        extended_state_message(v, m);
        break;
    case STREAM_MISSION:
        mavlink_begin(m, MSG_MISSION_CURRENT, 6);
        mavlink_put(m, 0, 2, (uint32_t)v->software->mission.waypoint_index);
        mavlink_put(m, 2, 2, (uint32_t)v->plan->count);
        break;
    case STREAM_ATTITUDE:
        motion_message(v, m, true);
        break;
    case STREAM_POSITION:
        motion_message(v, m, false);
        break;
    default:
        estimator_status_message(v, m);
        break;
    }
}

bool request_stream(link_t *k, uint32_t message)
{
    bool found = false;

    for (int32_t i = 0; i < LINK_STREAMS; i++) {
        if (streams[i].message == message) {
            k->once[i] = true;
            found = true;
        }
    }
    return found;
}

void send_stream(link_t *k, const link_vehicle_t *v)
{
    const real_t now_s = v->supervisor->now_s;
    bool sent = false;

    for (int32_t i = 0; (i < LINK_STREAMS) && !sent; i++) {
        sent = k->once[i] || (now_s >= k->due_s[i]);
        if (sent) {
            mavlink_message_t m;

            stream_message(v, i, &m);
            (void)send_message(k, &m);
            if (now_s >= k->due_s[i]) {
                k->due_s[i] = real_max(k->due_s[i] + streams[i].interval_s, now_s);
            }
            k->once[i] = false;
        }
    }
}
