/* An STM32F4, without any vendor's code: the drivers of onboard/drivers on the buses and timers of your board. Every TODO is a
 * register or a buffer of it.
 *
 * SPI and I2C transfers go by DMA; the motors' timer takes DShot frames by DMA; servos are a timer's pulses; MAVLink comes and goes by
 * a UART with DMA; the independent watchdog resets the processor when the loop stops. */
#include "../board.h"
#include "actuator_outputs.h"
#include "sensor_suite.h"

#define BAROMETER_ON_SPI true
#define DSHOT_BIT_TICKS 280U  /* DShot300 of a timer at 84 MHz */
#define ADC_REFERENCE_V REAL(3.3)
#define BATTERY_DIVIDER REAL(11.0)

int main(void);

/* Set by interrupts. */
static volatile uint32_t periods;     /* of the loop's timer */
static volatile uint32_t microseconds; /* of a free-running 32-bit timer; TODO: TIM2->CNT */

static sensor_suite_t sensors;
static uint32_t dshot[2][DSHOT_BITS]; /* compare values of both motors, for the DMA of their timer */
static uint32_t servo_us[2];          /* TODO: TIMx->CCRy of a timer that counts microseconds, 20 ms a frame */

/* TODO: the timer's interrupt at mufly_rate_Hz calls this. */
void stm32_period(void);
void stm32_period(void)
{
    periods++;
}

bool bus_begin(int32_t device, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count)
{
    (void)device; /* TODO: chip select of the device and DMA on its SPI, or its address and DMA on I2C */
    (void)out;
    (void)out_count;
    (void)in;
    (void)in_count;
    return false;
}

int32_t bus_poll(int32_t device)
{
    (void)device; /* TODO: BUS_BUSY until the DMA is over; BUS_ERROR by OVR and MODF, or AF, BERR and ARLO */
    return (int32_t)BUS_ERROR;
}

void bus_abort(int32_t device)
{
    (void)device; /* TODO: SPI: DMA off, deselect; I2C: SWRST, nine clocks on SCL as a pin, stop */
}

static uint32_t read_battery_count(void)
{
    return 0xFFFFU; /* TODO: ADC1->DR; what is above 12 bits counts as no reading */
}

int32_t hal_wait_period(void)
{
    static uint32_t last;
    uint32_t missed;

    while (periods == last) {
        /* TODO: __WFI() */
    }
    missed = (periods - last) - 1U;
    last = periods;
    return (int32_t)missed;
}

real_t hal_time_s(void)
{
    static uint32_t before;
    static real_t seconds;
    const uint32_t now = microseconds;

    seconds += (real_t)(now - before) * REAL(1e-6);
    before = now;
    return seconds;
}

void hal_read_sensors(hal_readings_t *readings)
{
    const real_t voltage = battery_voltage(read_battery_count(), ADC_REFERENCE_V, BATTERY_DIVIDER);

    sensor_suite_read(&sensors, microseconds, voltage, readings);
    /* TODO: ring, compass, rotor speeds, position fix, where fitted. */
}

void hal_write_actuators(const actuators_t *out)
{
    for (int32_t i = 0; i < 2; i++) {
        dshot_compare_values(dshot_frame(out->motor_input[i]), DSHOT_BIT_TICKS, dshot[i]);
        servo_us[i] = servo_pulse_us(out->servo_input[i]);
    }
    /* TODO: start the DMA of both motors */
}

bool hal_read_command(hal_command_t *command)
{
    (void)command;
    return false; /* the supervisor commands, by the link */
}

int32_t hal_read_bytes(uint8_t *to, int32_t most)
{
    (void)to; /* TODO: from the ring that the UART's DMA fills */
    (void)most;
    return 0;
}

int32_t hal_write_bytes(const uint8_t *from, int32_t count)
{
    (void)from; /* TODO: into the ring that the UART's DMA empties; what fits counts */
    return count;
}

int32_t hal_rc_kind(void)
{
    return RC_NONE; /* TODO: RC_CRSF or RC_SBUS */
}

int32_t hal_read_rc(uint8_t *to, int32_t most)
{
    (void)to; /* TODO: from the ring that the receiver's DMA fills */
    (void)most;
    return 0;
}

int32_t hal_flash_words(void)
{
    return 0; /* TODO: 4096, with sectors 2 and 3 (16 kB each) left out of the linker script */
}

uint32_t hal_flash_read(int32_t sector, int32_t word)
{
    (void)sector; /* TODO: *(volatile uint32_t *)(0x08008000 + (sector * 0x4000) + (4 * word)) */
    (void)word;
    return 0xFFFFFFFFU;
}

bool hal_flash_program(int32_t sector, int32_t word, uint32_t value)
{
    (void)sector; /* TODO: FLASH->KEYR, FLASH->CR with PG and PSIZE of 32 bits, the word, FLASH->SR until not BSY, its errors */
    (void)word;
    (void)value;
    return false;
}

bool hal_flash_erase(int32_t sector)
{
    (void)sector; /* TODO: FLASH->CR with SER, SNB and STRT, from a function in RAM that resets the watchdog until not BSY */
    return false;
}

int32_t hal_block_count(void)
{
    return 0; /* TODO: blocks of 512 bytes of an SD card, or of a flash that erases a sector at its first block */
}

bool hal_block_read(int32_t block, uint32_t to[BLOCK_WORDS])
{
    (void)block; /* TODO: begin by DMA */
    (void)to;
    return false;
}

bool hal_block_write(int32_t block, const uint32_t from[BLOCK_WORDS])
{
    (void)block; /* TODO: begin by DMA */
    (void)from;
    return false;
}

bool hal_block_flush(void)
{
    return false; /* TODO: true where the device holds nothing back */
}

int32_t hal_block_poll(void)
{
    return (int32_t)BLOCK_ERROR; /* TODO: BLOCK_BUSY, BLOCK_DONE */
}

void hal_feed_watchdog(void)
{
    /* TODO: IWDG->KR = 0xAAAA, with a reload that leaves 50 ms */
}

/* TODO: the linker script puts this section where the start-up code does not clear it. */
static fault_record_t kept __attribute__((section(".noinit")));

/* TODO: the handlers of HardFault, BusFault, MemManage and UsageFault call this with the stacked program counter. */
void stm32_fault(uint32_t address);
void stm32_fault(uint32_t address)
{
    fault_record_fault(&kept, address, 0U); /* TODO: SCB->CFSR */
    for (;;) {
        /* TODO: NVIC_SystemReset(); the motors' timers stop with the reset */
    }
}

int main(void)
{
    static board_t board;
    const uint32_t cause = RESET_BY_POWER; /* TODO: from RCC->CSR: BORRSTF, IWDGRSTF, SFTRSTF, PINRSTF; then clear it */

    /* TODO: clocks, floating unit, timers, DMA, UART, watchdog. */
    sensor_suite_start(&sensors, BAROMETER_ON_SPI, microseconds);
    board_start(&board,
                (1UL << R_ACCELERATION) | (1UL << R_RATES) | (1UL << R_SONAR) | (1UL << R_PRESSURE) | (1UL << R_BATTERY),
                fault_record_begin(&kept, cause));
    board_run(&board, &kept);
    return 0;
}
