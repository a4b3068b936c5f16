#include "boards/board.h"

#include <stddef.h>

#define SENT_AT_ONCE 64 /* bytes handed to the UART in a period */

/* Exchange bytes with the UARTs of receiver and link. */
static void exchange_bytes(board_t *b)
{
    uint8_t out[SENT_AT_ONCE];
    int32_t count;

    b->rc.input_count = hal_read_rc(b->rc.input, RC_INPUT);
    b->link.input_count = hal_read_bytes(b->link.input, LINK_INPUT);
    board_link(b);
    count = link_waiting(&b->link, out, SENT_AT_ONCE);
    link_sent(&b->link, hal_write_bytes(out, count));
}

void board_run(board_t *b, fault_record_t *kept)
{
    static hal_command_t command;

    rc_start(&b->rc, hal_rc_kind());
    for (;;) {
        const int32_t missed = hal_wait_period();

        hal_write_actuators(&b->sent);
        hal_read_sensors(&b->readings);
        board_estimate(b, hal_time_s(), missed);
        board_control(b, hal_read_command(&command) ? &command : NULL);
        exchange_bytes(b);
        fault_record_update(kept, b->software.motors != MOTORS_OFF, b->software.mission.state, b->belief.time_s);
        hal_feed_watchdog();
    }
}
