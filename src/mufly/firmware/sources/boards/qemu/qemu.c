/* hal.h for QEMU's mps2-an386 (Cortex-M4F). The simulation of mufly takes the place of sensors and actuators: it writes
 * readings and commands to this program's input, and reads the whole memory of the board from its output, twice a period.
 * MAVLink goes through UART 0, the bytes of a pilot's receiver come through UART 1.
 *
 * The exchange goes through semihosting, on the standard input and output of QEMU: one call moves a whole record, while a
 * UART of the emulated board takes one byte per turn of QEMU's main loop. The program ends when its input ends. */
#include "boards/board.h"
#include "boards/qemu/exchange.h"
#include "check/platforms/platform.h"
#include "check/platforms/semihosting.h"

#define HANDLE_NONE 0xFFFFFFFFU
#define MODE_READ 1U  /* "rb" */
#define MODE_WRITE 5U /* "wb" */

/* UARTs 0 and 1 (CMSDK APB UART); their interrupts of reception have the numbers 0 and 2. */
#define UART_FULL 1U
#define UART_RECEIVED 2U
#define UART_ENABLED 3U
#define UART_RX_INTERRUPT 8U
#define UART_RX_PENDING 2U
#define UART_RX_INTERRUPTS 5U /* bits of NVIC_ENABLE */
#define NVIC_ENABLE (*(volatile uint32_t *)0xE000E100U)
#define NVIC_DISABLE (*(volatile uint32_t *)0xE000E180U)
#define RECEIVED_SIZE 512U

/* Timer 0 (CMSDK APB timer, 25 MHz) and its interrupt, which ends a pause of 20 us. */
#define TIMER_CTRL (*(volatile uint32_t *)0x40000000U)
#define TIMER_VALUE (*(volatile uint32_t *)0x40000004U)
#define TIMER_RELOAD (*(volatile uint32_t *)0x40000008U)
#define TIMER_CLEAR (*(volatile uint32_t *)0x4000000CU)
#define TIMER_RUNS 9U /* enabled, with its interrupt */
#define TIMER_PAUSE 500U
#define PAUSE_PERIODS 4U /* a pause in every fourth period costs no speed, and the link needs no more */
#define TIMER_INTERRUPT 256U /* bit of NVIC_ENABLE and NVIC_FORGET */
#define NVIC_FORGET (*(volatile uint32_t *)0xE000E280U)

/* Two sectors of flash, which this machine has as memory that outlasts the program; where that is new, no bit need be set. */
#define FLASH ((volatile uint32_t *)0x21000000U)
#define FLASH_SECTOR_WORDS 4096

/* Kind of the receiver, in the same memory: RC_... of rc_frames.h. */
#define RECEIVER_KIND (*(volatile int32_t *)0x21080000U)

/* Block device of the log, in the same memory. */
#define LOG_MEMORY ((volatile uint32_t *)0x21100000U)
#define LOG_BLOCK_COUNT 30720

/* SysTick: ticks of 40 ns; with -icount shift=0 an instruction takes 1 ns. It counts down. */
#define TICKS_CTRL (*(volatile uint32_t *)0xE000E010U)
#define TICKS_RELOAD (*(volatile uint32_t *)0xE000E014U)
#define TICKS (*(volatile uint32_t *)0xE000E018U)
#define TICKS_MASK 0xFFFFFFU
#define TICKS_ENABLED 5U

int main(void);
void interrupt_0(void);
void interrupt_2(void);

typedef struct {
    volatile uint32_t data, state, ctrl, interrupt, baud_divider;
} uart_registers_t;

typedef struct {
    uart_registers_t *uart;
    volatile uint32_t head, tail;
    uint8_t bytes[RECEIVED_SIZE];
} receiver_t;

static receiver_t link = {(uart_registers_t *)0x40004000U, 0U, 0U, {0U}};
static receiver_t pilot = {(uart_registers_t *)0x40005000U, 0U, 0U, {0U}};
static board_t board;
static fault_record_t kept; /* the emulation has no reset */
static board_period_t period;
static board_request_t request;
static uint32_t input;
static uint32_t output;
static uint32_t spent_ticks; /* in this period, without the exchange */
static uint32_t resumed_at;

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

static void pause_ticks(void)
{
    spent_ticks += (resumed_at - TICKS) & TICKS_MASK;
}

/* The pending bit is cleared first: a byte that comes meanwhile sets it again. Without room the UART keeps its byte, and the
 * sender waits, until take_bytes has made room. */
static void keep_bytes(receiver_t *r)
{
    r->uart->interrupt = UART_RX_PENDING;
    while (((r->uart->state & UART_RECEIVED) != 0U) && ((r->head - r->tail) < RECEIVED_SIZE)) {
        r->bytes[r->head % RECEIVED_SIZE] = (uint8_t)(r->uart->data & 0xFFU);
        r->head++;
    }
}

void interrupt_0(void)
{
    keep_bytes(&link);
}

void interrupt_2(void)
{
    keep_bytes(&pilot);
}

/* Sleep until QEMU's main loop has run and has brought no byte. It cannot run while this processor waits for the simulation in a
 * call of the host, and a busy machine may not let it run while this processor computes: bytes would be late by hundreds of
 * periods. The timer's interrupt stays masked: it only ends the sleep. */
static void let_bytes_come(void)
{
    uint32_t before;

    do {
        before = link.head + pilot.head;
        __asm__ volatile("cpsid i");
        TIMER_VALUE = TIMER_PAUSE;
        TIMER_CTRL = TIMER_RUNS;
        __asm__ volatile("dsb\n wfi");
        TIMER_CTRL = 0U;
        TIMER_CLEAR = 1U;
        NVIC_FORGET = TIMER_INTERRUPT;
        __asm__ volatile("cpsie i\n isb" ::: "memory");
    } while ((link.head + pilot.head) != before);
}

int32_t hal_wait_period(void)
{
    static uint32_t periods;

    if (periods > 0U) {
        pause_ticks();
        transmit(&board, sizeof(board)); /* after the second half of the period that has just ended */
        transmit(&spent_ticks, sizeof(spent_ticks));
    }
    if ((periods % PAUSE_PERIODS) == 0U) {
        let_bytes_come();
    }
    periods++;
    receive(&period, sizeof(period));
    spent_ticks = 0U;
    resumed_at = TICKS;
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
    pause_ticks();
    transmit(&board, sizeof(board)); /* after the first half */
    receive(&request, sizeof(request));
    resumed_at = TICKS;
    *out = request.given;
    return request.is_given;
}

void hal_write_actuators(const actuators_t *out)
{
    (void)out; /* the simulation takes them from the memory of the board */
}

static int32_t take_bytes(receiver_t *r, uint8_t *to, int32_t most)
{
    int32_t count = 0;

    NVIC_DISABLE = UART_RX_INTERRUPTS;
    keep_bytes(r);
    while ((count < most) && (r->tail != r->head)) {
        to[count] = r->bytes[r->tail % RECEIVED_SIZE];
        r->tail++;
        count++;
    }
    NVIC_ENABLE = UART_RX_INTERRUPTS;
    return count;
}

static void start_uart(const receiver_t *r)
{
    r->uart->baud_divider = 16U;
    r->uart->ctrl = UART_ENABLED | UART_RX_INTERRUPT;
}

int32_t hal_read_bytes(uint8_t *to, int32_t most)
{
    return take_bytes(&link, to, most);
}

int32_t hal_write_bytes(const uint8_t *from, int32_t count)
{
    int32_t sent = 0;

    while ((sent < count) && ((link.uart->state & UART_FULL) == 0U)) {
        link.uart->data = from[sent];
        sent++;
    }
    return sent;
}

int32_t hal_rc_kind(void)
{
    return RECEIVER_KIND;
}

int32_t hal_read_rc(uint8_t *to, int32_t most)
{
    return take_bytes(&pilot, to, most);
}

int32_t hal_flash_words(void)
{
    return FLASH_SECTOR_WORDS;
}

uint32_t hal_flash_read(int32_t sector, int32_t word)
{
    return FLASH[(sector * FLASH_SECTOR_WORDS) + word];
}

bool hal_flash_program(int32_t sector, int32_t word, uint32_t value)
{
    FLASH[(sector * FLASH_SECTOR_WORDS) + word] &= value;
    return true;
}

bool hal_flash_erase(int32_t sector)
{
    for (int32_t i = 0; i < FLASH_SECTOR_WORDS; i++) {
        FLASH[(sector * FLASH_SECTOR_WORDS) + i] = 0xFFFFFFFFU;
    }
    return true;
}

int32_t hal_block_count(void)
{
    return LOG_BLOCK_COUNT;
}

bool hal_block_read(int32_t block, uint32_t to[BLOCK_WORDS])
{
    for (int32_t i = 0; i < BLOCK_WORDS; i++) {
        to[i] = LOG_MEMORY[(block * BLOCK_WORDS) + i];
    }
    return true;
}

bool hal_block_write(int32_t block, const uint32_t from[BLOCK_WORDS])
{
    for (int32_t i = 0; i < BLOCK_WORDS; i++) {
        LOG_MEMORY[(block * BLOCK_WORDS) + i] = from[i];
    }
    return true;
}

bool hal_block_flush(void)
{
    return true;
}

int32_t hal_block_poll(void)
{
    return (int32_t)BLOCK_DONE;
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
    TICKS_RELOAD = TICKS_MASK;
    TICKS_CTRL = TICKS_ENABLED;
    start_uart(&link);
    start_uart(&pilot);
    TIMER_RELOAD = TIMER_PAUSE;
    NVIC_ENABLE = UART_RX_INTERRUPTS | TIMER_INTERRUPT;
    board_start(&board, fitted, fault_record_begin(&kept, RESET_BY_POWER));
    board_run(&board, &kept);
    return 0;
}
