/* hal.h for QEMU's mps2-an386 (Cortex-M4F). The simulation of mufly takes the place of sensors and actuators: it writes
 * readings and commands to this program's input, and reads the whole memory of the board from its output, twice a period.
 *
 * The exchange goes through semihosting, on the standard input and output of QEMU: one call moves a whole record, while a
 * UART of the emulated board takes one byte per turn of QEMU's main loop. The program ends when its input ends. */
#include "../../check/platform.h"
#include "../../check/semihosting.h"
#include "../board.h"
#include "exchange.h"

#define HANDLE_NONE 0xFFFFFFFFU
#define MODE_READ 1U  /* "rb" */
#define MODE_WRITE 5U /* "wb" */

int main(void);

static board_t board;
static fault_record_t kept; /* the emulation has no reset */
static board_period_t period;
static board_request_t request;
static uint32_t input;
static uint32_t output;

static uint32_t open_stream(const char *name, uint32_t length, uint32_t mode)
{
    const uint32_t with[3] = {(uint32_t)name, mode, length};

    return ask_host(HOST_OPEN, with);
}

/* Read all bytes; at the end of the input, end the program. */
static void receive(void *to, uint32_t size)
{
    uint32_t left = size;

    while (left > 0U) {
        const uint32_t with[3] = {input, (uint32_t)to + (size - left), left};
        const uint32_t still = ask_host(HOST_READ, with);

        if (still >= left) {
            platform_end();
        }
        left = still;
    }
}

static void transmit(const void *from, uint32_t size)
{
    uint32_t left = size;

    while (left > 0U) {
        const uint32_t with[3] = {output, (uint32_t)from + (size - left), left};
        const uint32_t still = ask_host(HOST_WRITE, with);

        if (still >= left) {
            platform_end();
        }
        left = still;
    }
}

int32_t hal_wait_period(void)
{
    static bool began;

    if (began) {
        transmit(&board, sizeof(board)); /* after the second half of the period that has just ended */
    }
    began = true;
    receive(&period, sizeof(period));
    return period.missed;
}

real_t hal_time_s(void)
{
    return period.time_s;
}

void hal_read_sensors(hal_readings_t *readings)
{
    merge_readings(readings, &period.readings);
}

bool hal_read_command(hal_command_t *out)
{
    transmit(&board, sizeof(board)); /* after the first half */
    receive(&request, sizeof(request));
    *out = request.given;
    return request.is_given;
}

void hal_write_actuators(const actuators_t *out)
{
    (void)out; /* the simulation takes them from the memory of the board */
}

void hal_send_log_entry(const log_entry_t *entry)
{
    (void)entry; /* likewise */
}

void hal_feed_watchdog(void)
{
}

int main(void)
{
    static const board_sizes_t sizes = {sizeof(board_t), sizeof(board_period_t), sizeof(board_request_t),
                                        sizeof(estimator_t), sizeof(software_t)};
    uint32_t fitted = 0U;

    input = open_stream("/dev/stdin", 10U, MODE_READ);
    output = open_stream("/dev/stdout", 11U, MODE_WRITE);
    if ((input == HANDLE_NONE) || (output == HANDLE_NONE)) {
        platform_end();
    }
    for (uint32_t k = 0U; k < (uint32_t)SENSOR_COUNT; k++) {
        fitted |= (mufly_settings.is_fitted[k] != 0) ? (1UL << k) : 0U;
    }
    transmit(&sizes, sizeof(sizes));
    board_start(&board, fitted, fault_record_begin(&kept, RESET_BY_POWER));
    board_run(&board, &kept);
    return 0;
}
