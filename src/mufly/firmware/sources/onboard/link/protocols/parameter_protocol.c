#include "onboard/link/protocols/parameter_protocol.h"

#include "onboard/link/link_output.h"
#include "onboard/link/protocols/mission_protocol.h"

#define PARAM_TYPE_REAL32 9U

tunables_t link_tunables(const link_vehicle_t *v)
{
    const tunables_t t = {v->plan, &v->supervisor->settings, &v->settings->calibration, v->rc};

    return t;
}

static void send_parameter(link_t *k, const link_vehicle_t *v, int32_t which)
{
    const char *name = parameter_name(which);
    const tunables_t t = link_tunables(v);
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

void handle_parameter(link_t *k, const link_vehicle_t *v, const mavlink_message_t *m, bool commands)
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
                const tunables_t t = link_tunables(v);
                const int32_t answer = settings_set(v->settings, &t, which, mavlink_get_real(m, 0), may_load(v));

                if (answer == SETTING_OUT_OF_BOUNDS) {
                    send_string(k, "parameter out of its bounds; it stays", 4U);
                } else if (answer == SETTING_ON_FLOOR_ONLY) {
                    send_string(k, "calibration needs motors off; it stays", 4U);
                } else {
                    /* set */
                }
            }
            send_parameter(k, v, which); /* the value that counts */
        }
    }
}

bool send_listed_parameter(link_t *k, const link_vehicle_t *v)
{
    const bool sends = k->lists && (k->output_count < (LINK_OUTPUT / 2));

    if (sends) {
        send_parameter(k, v, k->listed);
        k->listed++;
        k->lists = k->listed < (int32_t)PARAMETERS;
    }
    return sends;
}
