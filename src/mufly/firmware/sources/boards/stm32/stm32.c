/* Stubs for an STM32F4: what hal.h asks for, without any vendor's code. Every TODO is a register or a buffer of your board.
 *
 * The inertial unit is read by DMA into two halves of a buffer, in turns; PWM is a timer's; MAVLink comes and goes by a UART
 * with DMA; the independent watchdog resets the processor when the loop stops. */
#include "../board.h"

#define UPPER_CHANNEL 0
#define LOWER_CHANNEL 1
#define SERVO_1_CHANNEL 2
#define SERVO_2_CHANNEL 3

int main(void);

/* Set by interrupts. */
static volatile uint32_t periods;     /* of the loop's timer */
static volatile uint32_t microseconds; /* of a free-running 32-bit timer; TODO: TIM2->CNT */
static volatile bool imu_is_new;
static volatile real_t imu[6];        /* specific force (m/s2), rates (rad/s); body axes forward, right, down */

/* TODO: the timer's interrupt at mufly_rate_Hz calls this. */
void stm32_period(void);
void stm32_period(void)
{
    periods++;
}

/* TODO: the DMA's half and full transfer interrupts call this with what the unit said, scaled, in body axes. */
void stm32_imu(const real_t force[3], const real_t rates[3]);
void stm32_imu(const real_t force[3], const real_t rates[3])
{
    for (int32_t i = 0; i < 3; i++) {
        imu[i] = force[i];
        imu[3 + i] = rates[i];
    }
    imu_is_new = true;
}

static void write_pwm(int32_t channel, real_t share)
{
    (void)channel; /* TODO: TIMx->CCRy = (uint32_t)(share * TIMx->ARR) */
    (void)share;
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
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        readings->fresh[k] = 0;
        readings->age[k] = REAL(0.0);
    }
    for (int32_t i = 0; i < 3; i++) {
        readings->z[CLIPPING_START + i] = REAL(0.0); /* TODO: the share of samples at full scale */
    }
    if (imu_is_new) {
        imu_is_new = false; /* TODO: with interrupts off, or from the half of the buffer that DMA does not write */
        for (int32_t i = 0; i < 3; i++) {
            readings->z[READING_STARTS[R_ACCELERATION] + i] = imu[i];
            readings->z[READING_STARTS[R_RATES] + i] = imu[3 + i];
        }
        readings->fresh[R_ACCELERATION] = 1;
        readings->fresh[R_RATES] = 1;
    }
    /* TODO: sonar, ring, pressure (less 101325 Pa), compass, rotor speeds, position fix, battery voltage. */
}

void hal_write_actuators(const actuators_t *out)
{
    write_pwm(UPPER_CHANNEL, out->motor_input[0]);
    write_pwm(LOWER_CHANNEL, out->motor_input[1]);
    /* Servos: 1 to 2 ms of a 20 ms frame, the middle at rest. */
    write_pwm(SERVO_1_CHANNEL, (REAL(1.5) + (REAL(0.5) * out->servo_input[0])) / REAL(20.0));
    write_pwm(SERVO_2_CHANNEL, (REAL(1.5) + (REAL(0.5) * out->servo_input[1])) / REAL(20.0));
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
    board_start(&board, (1UL << R_ACCELERATION) | (1UL << R_RATES) | (1UL << R_SONAR) | (1UL << R_BATTERY),
                fault_record_begin(&kept, cause));
    board_run(&board, &kept);
    return 0;
}
