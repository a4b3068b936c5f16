#include "board.h"

#include <stddef.h>

/* Send the log entries since the last call. */
static void send_log(const mission_t *x)
{
    static int32_t told;

    if ((x->logged_count - told) > MISSION_LOG) {
        told = x->logged_count - MISSION_LOG; /* older entries are lost */
    }
    while (told < x->logged_count) {
        hal_send_log_entry(&x->log[told % MISSION_LOG]);
        told++;
    }
}

void board_run(board_t *b, fault_record_t *kept)
{
    static hal_command_t command;

    for (;;) {
        const int32_t missed = hal_wait_period();

        hal_write_actuators(&b->sent);
        hal_read_sensors(&b->readings);
        board_estimate(b, hal_time_s(), missed);
        board_control(b, hal_read_command(&command) ? &command : NULL);
        fault_record_update(kept, b->software.motors != MOTORS_OFF, b->software.mission.state, b->belief.time_s);
        send_log(&b->software.mission);
        hal_feed_watchdog();
    }
}
