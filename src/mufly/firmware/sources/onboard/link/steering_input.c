#include "onboard/link/steering_input.h"

#include "onboard/link/protocols/command_protocol.h"
#include "onboard/link/protocols/mission_protocol.h"
#include "onboard/receiver/rc.h"

static const user_request_t no_request;

static real_t stick_axis(const mavlink_message_t *m, int32_t at)
{
    const int32_t raw = (int32_t)mavlink_get(m, at, 2);
    const int32_t wide = (raw < 32768) ? raw : (raw - 65536);
    const real_t value = (raw == 32767) ? REAL(0.0) : real_clip((real_t)wide / REAL(1000.0), REAL(-1.0), REAL(1.0));

    return value;
}

void handle_steering(const link_t *k, const link_vehicle_t *v, const mavlink_message_t *m)
{
    const supervisor_settings_t *most = &v->supervisor->settings;
    user_request_t ask = no_request;

    if (m->message == MSG_MANUAL_CONTROL) {
        const real_t up = (mavlink_get(m, 4, 2) == 32767U) ? REAL(0.0) : ((REAL(2.0) * stick_axis(m, 4)) - REAL(1.0));

        ask.kind = USER_STICKS;
        ask.roll = most->stick_tilt * apply_deadband(stick_axis(m, 2));
        ask.pitch = -most->stick_tilt * apply_deadband(stick_axis(m, 0));
        ask.climb_rate = most->stick_climb * apply_deadband(real_clip(up, REAL(-1.0), REAL(1.0)));
        ask.yaw_rate = most->stick_yaw_rate * apply_deadband(stick_axis(m, 6));
        if (k->by_hand) {
            (void)send_request(v, &ask);
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
        (void)send_request(v, &ask);
    } else {
        /* a frame that this vehicle does not follow */
    }
}
