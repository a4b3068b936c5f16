/* hal.h for a flight controller with an STM32F405, without any vendor's code: the drivers of onboard/drivers on its buses and
 * timers. What is left to the board is marked TODO; what nobody connects answers as absent. */
#include "boards/board.h"
#include "boards/stm32/pins.h"
#include "boards/stm32/stm32f405.h"
#include "onboard/drivers/actuator_outputs.h"
#include "onboard/drivers/sd_card.h"
#include "onboard/drivers/sensor_suite.h"

#define LINK_BAUD 115200U
#define SBUS_BAUD 100000U
#define CRSF_BAUD 420000U
#define RECEIVER_KIND RC_CRSF
#define RANGING RANGING_SRF10 /* or RANGING_VL53L1X */
#define SRF10_ADDRESS 0x70U
#define VL53L1X_ADDRESS 0x29U
#define ADC_REFERENCE_V REAL(3.3)
#define BATTERY_DIVIDER REAL(11.0)
#define CALLS_OF_CARD 8
#define CARD_START_US 1500000U

int main(void);
void stm32_period(void);
void stm32_link_interrupt(void);
void stm32_receiver_interrupt(void);
void stm32_fault(uint32_t address);

static volatile uint32_t periods; /* of the loop's timer */
static serial_port_t link_port;
static serial_port_t receiver_port;
static sensor_suite_t sensors;
static sd_card_t card;
static uint32_t dshot[2][DSHOT_BITS];
/* The linker script puts this section where the start-up code does not clear it. */
static fault_record_t kept __attribute__((section(".noinit")));

void stm32_period(void)
{
    timer_end_interrupt();
    periods++;
}

void stm32_link_interrupt(void)
{
    serial_interrupt(&link_port);
}

void stm32_receiver_interrupt(void)
{
    serial_interrupt(&receiver_port);
}

static bool is_on_i2c(int32_t device)
{
    return (device == (int32_t)DEVICE_SONAR) || (device == (int32_t)DEVICE_LASER);
}

bool bus_begin(int32_t device, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count)
{
    bool begun = false;

    if (is_on_i2c(device)) {
        begun = i2c_begin((device == (int32_t)DEVICE_SONAR) ? SRF10_ADDRESS : VL53L1X_ADDRESS, out, out_count, in, in_count);
    } else if (device == (int32_t)DEVICE_IMU) {
        begun = spi_begin(IMU_SELECT_PORT, IMU_SELECT_PIN, out, out_count, in, in_count);
    } else if (device == (int32_t)DEVICE_BAROMETER) {
        begun = spi_begin(BAROMETER_SELECT_PORT, BAROMETER_SELECT_PIN, out, out_count, in, in_count);
    } else {
        /* no such device */
    }
    return begun;
}

int32_t bus_poll(int32_t device)
{
    return is_on_i2c(device) ? i2c_poll() : spi_poll();
}

void bus_abort(int32_t device)
{
    if (is_on_i2c(device)) {
        i2c_abort();
    } else {
        spi_abort();
    }
}

int32_t hal_wait_period(void)
{
    static uint32_t last;
    uint32_t missed;

    interrupts_hold(true); /* an interrupt between the comparison and the sleep wakes the processor all the same */
    while (periods == last) {
        sleep_until_interrupt();
        interrupts_hold(false);
        interrupts_hold(true);
    }
    interrupts_hold(false);
    missed = (periods - last) - 1U;
    last = periods;
    return (int32_t)missed;
}

real_t hal_time_s(void)
{
    static uint32_t before;
    static real_t seconds;
    const uint32_t now = timer_us();

    seconds += (real_t)(now - before) * REAL(1e-6);
    before = now;
    return seconds;
}

void hal_read_sensors(hal_readings_t *readings)
{
    sensor_suite_read(&sensors, timer_us(), battery_voltage(adc_read(), ADC_REFERENCE_V, BATTERY_DIVIDER), readings);
    /* TODO: ring, compass, rotor speeds, position fix, where fitted. */
}

void hal_write_actuators(const actuators_t *out)
{
    for (int32_t i = 0; i < 2; i++) {
        dshot_compare_values(dshot_frame(out->motor_input[i]), DSHOT_BIT_TICKS, dshot[i]);
    }
    motors_send(dshot[0], dshot[1], DSHOT_BITS);
    servos_set(servo_pulse_us(out->servo_input[0]), servo_pulse_us(out->servo_input[1]));
}

bool hal_read_command(hal_command_t *command)
{
    (void)command;
    return false; /* the supervisor commands, by the link */
}

int32_t hal_read_bytes(uint8_t *to, int32_t most)
{
    return serial_read(&link_port, to, most);
}

int32_t hal_write_bytes(const uint8_t *from, int32_t count)
{
    return serial_write(&link_port, from, count);
}

int32_t hal_rc_kind(void)
{
    return RECEIVER_KIND;
}

int32_t hal_read_rc(uint8_t *to, int32_t most)
{
    return serial_read(&receiver_port, to, most);
}

int32_t hal_flash_words(void)
{
    return FLASH_SECTOR_WORDS;
}

uint32_t hal_flash_read(int32_t sector, int32_t word)
{
    return internal_flash_read(sector, word);
}

bool hal_flash_program(int32_t sector, int32_t word, uint32_t value)
{
    return internal_flash_program(sector, word, value);
}

bool hal_flash_erase(int32_t sector)
{
    return internal_flash_erase(sector);
}

/* SD card. A call of hal_block_poll goes on as long as transfers end at once. */
int32_t hal_block_count(void)
{
    return card.is_ready ? card.blocks : 0;
}

bool hal_block_read(int32_t block, uint32_t to[BLOCK_WORDS])
{
    return sd_card_begin(&card, block, to, false);
}

bool hal_block_write(int32_t block, const uint32_t from[BLOCK_WORDS])
{
    return sd_card_begin(&card, block, (uint32_t *)(uintptr_t)from, true); /* a write does not change the memory */
}

/* A card that is not busy has written everything. */
bool hal_block_flush(void)
{
    const bool rests = card.result != (int32_t)BLOCK_BUSY;

    card.result = rests ? (int32_t)BLOCK_DONE : card.result;
    return rests;
}

int32_t hal_block_poll(void)
{
    for (int32_t n = 0; (n < CALLS_OF_CARD) && (card.result == (int32_t)BLOCK_BUSY); n++) {
        sd_card_step(&card, timer_us());
    }
    return card.result;
}

static void start_card(void)
{
    const uint32_t begun_us = timer_us();

    card_bus_start();
    sd_card_start(&card, begun_us);
    while (!card.is_ready && (card.fault == (int32_t)SD_GOOD) && ((timer_us() - begun_us) < CARD_START_US)) {
        sd_card_step(&card, timer_us());
    }
}

void hal_feed_watchdog(void)
{
    watchdog_feed();
}

/* The motors' timers stop with the reset. */
void stm32_fault(uint32_t address)
{
    fault_record_fault(&kept, address, register_get(SCB_CFSR));
    reset_processor();
    for (;;) {
    }
}

int main(void)
{
    static board_t board;
    const uint32_t clock_Hz = clock_start();
    const bool full_speed = clock_Hz == FULL_SPEED_HZ;
    const bool crsf = RECEIVER_KIND == RC_CRSF;
    uint32_t fitted = 0U; /* none at half speed: then no estimate is ever valid, and no motor starts */

    pins_start();
    outputs_start(clock_Hz);
    adc_start();
    spi_start();
    serial_start(&link_port, USART1, full_speed ? (clock_Hz / 2U) : clock_Hz, LINK_BAUD, false);
    serial_start(&receiver_port, USART2, full_speed ? (clock_Hz / 4U) : clock_Hz, crsf ? CRSF_BAUD : SBUS_BAUD, !crsf);
    timers_start(clock_Hz, (uint32_t)mufly_rate_Hz);
    i2c_start(full_speed ? (clock_Hz / 4U) : clock_Hz);
    sensor_suite_start(&sensors, true, RANGING, timer_us());
    start_card();
    if (full_speed) {
        fitted = (1UL << READING_ACCELERATION) | (1UL << READING_RATES) | (1UL << READING_SONAR) | (1UL << READING_PRESSURE) | (1UL << READING_BATTERY);
    }
    board_start(&board, fitted, fault_record_begin(&kept, reset_cause()));
    watchdog_start();
    board_run(&board, &kept);
    return 0;
}
