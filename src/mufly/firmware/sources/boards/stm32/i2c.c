/* I2C 1 by interrupts, as its only controller, at 100 kHz (RM0090, section 27.3.3): ranging. */
#include "boards/stm32/pins.h"
#include "boards/stm32/stm32f405.h"
#include "onboard/drivers/sensors/register_device.h"

#include <stddef.h>

#define BAUD 100000U
#define PATIENCE 1000U /* turns of a wait of HALF_CLOCK_US */
#define HALF_CLOCK_US 5U
#define RECOVERY_CLOCKS 9

enum { RESTS, ADDRESSES, SENDS, TURNS, ADDRESSES_TO_READ, RECEIVES, ENDS, FAILED };

static volatile int32_t state;
static uint32_t bus_clock_Hz;
static uint32_t device_address;
static const uint8_t *sending;
static uint8_t *receiving;
static int32_t send_count, sent, receive_count, received;

static void set_up(void)
{
    register_set(I2C1 + I2C_CR1, I2C_SWRST); /* releases the lines and clears all flags */
    register_set(I2C1 + I2C_CR1, 0U);
    register_set(I2C1 + I2C_CR2, bus_clock_Hz / 1000000U);
    register_set(I2C1 + I2C_CCR, bus_clock_Hz / (2U * BAUD));
    register_set(I2C1 + I2C_TRISE, (bus_clock_Hz / 1000000U) + 1U); /* 1 us */
    register_set(I2C1 + I2C_CR1, I2C_PE);
    state = (int32_t)RESTS;
}

void i2c_start(uint32_t bus_Hz)
{
    bus_clock_Hz = bus_Hz;
    register_change(I2C_PORT + GPIO_OTYPER, 0U, (1UL << I2C_SCL_PIN) | (1UL << I2C_SDA_PIN));
    set_up();
    register_set(NVIC_ISER + (4U * (IRQ_I2C1_EVENT / 32U)), 1UL << (IRQ_I2C1_EVENT % 32U));
    register_set(NVIC_ISER + (4U * (IRQ_I2C1_ERROR / 32U)), 1UL << (IRQ_I2C1_ERROR % 32U));
}

static void wait_half_clock(void)
{
    const uint32_t begun_us = timer_us();

    for (uint32_t n = 0U; (n < PATIENCE) && ((timer_us() - begun_us) < HALF_CLOCK_US); n++) {
    }
}

static void drive(uint32_t pin, bool high)
{
    pin_set(I2C_PORT, pin, high);
    wait_half_clock();
}

/* A device that was interrupted while it sends holds the data line: clock its byte out, and end with a stop. */
static void free_bus(void)
{
    const uint32_t modes = (3UL << (2U * I2C_SCL_PIN)) | (3UL << (2U * I2C_SDA_PIN));

    register_set(I2C1 + I2C_CR1, 0U);
    pin_set(I2C_PORT, I2C_SDA_PIN, true);
    drive(I2C_SCL_PIN, true);
    register_change(I2C_PORT + GPIO_MODER, modes, (1UL << (2U * I2C_SCL_PIN)) | (1UL << (2U * I2C_SDA_PIN)));
    for (int32_t i = 0; i < RECOVERY_CLOCKS; i++) {
        drive(I2C_SCL_PIN, false);
        drive(I2C_SCL_PIN, true);
    }
    drive(I2C_SCL_PIN, false);
    drive(I2C_SDA_PIN, false);
    drive(I2C_SCL_PIN, true);
    drive(I2C_SDA_PIN, true);
    register_change(I2C_PORT + GPIO_MODER, modes, (2UL << (2U * I2C_SCL_PIN)) | (2UL << (2U * I2C_SDA_PIN)));
    set_up();
}

bool i2c_begin(uint32_t address, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count)
{
    const bool rests = (state == (int32_t)RESTS) && (out_count > 0) && (in_count >= 0);
    const bool is_free = (register_get(I2C1 + I2C_SR2) & I2C_BUSY) == 0U;

    if (rests && is_free) {
        device_address = address;
        sending = out;
        receiving = in;
        send_count = out_count;
        receive_count = in_count;
        sent = 0;
        received = 0;
        state = (int32_t)ADDRESSES;
        register_change(I2C1 + I2C_CR2, I2C_ITBUFEN, I2C_ITEVTEN | I2C_ITERREN);
        register_change(I2C1 + I2C_CR1, I2C_POS, I2C_ACK | I2C_START);
    } else if (rests) {
        free_bus();
    } else {
        /* one at a time */
    }
    return rests && is_free;
}

/* Interrupts off; a stop has been asked for. */
static void end_with(int32_t next)
{
    register_change(I2C1 + I2C_CR2, I2C_ITBUFEN | I2C_ITEVTEN | I2C_ITERREN, 0U);
    state = next;
}

static void take_byte(void)
{
    receiving[received] = (uint8_t)(register_get(I2C1 + I2C_DR) & 0xFFU);
    received++;
}

/* The address is acknowledged. What the peripheral answers to the first bytes has to be set before SR2 is read, which lets the
 * clock go on. */
static void begin_to_receive(void)
{
    register_change(I2C1 + I2C_CR1, (receive_count <= 2) ? I2C_ACK : 0U, (receive_count == 2) ? I2C_POS : 0U);
    (void)register_get(I2C1 + I2C_SR2);
    if (receive_count == 1) {
        register_change(I2C1 + I2C_CR1, 0U, I2C_STOP);
    }
    if ((receive_count == 1) || (receive_count > 3)) {
        register_change(I2C1 + I2C_CR2, 0U, I2C_ITBUFEN);
    }
    state = (int32_t)RECEIVES;
}

/* The last three bytes are taken while the clock stands still, so that neither acknowledge nor stop come late. */
static void receive(uint32_t flags)
{
    const int32_t left = receive_count - received;

    if ((receive_count == 1) || (left > 3)) {
        if ((flags & I2C_RXNE) != 0U) {
            take_byte();
            if (receive_count == 1) {
                end_with((int32_t)ENDS);
            } else if (left == 4) {
                register_change(I2C1 + I2C_CR2, I2C_ITBUFEN, 0U);
            } else {
                /* more */
            }
        }
    } else if ((flags & I2C_BTF) == 0U) {
        /* the next byte is still on its way */
    } else if (left == 3) {
        register_change(I2C1 + I2C_CR1, I2C_ACK, 0U);
        take_byte();
    } else {
        register_change(I2C1 + I2C_CR1, 0U, I2C_STOP);
        take_byte();
        take_byte();
        end_with((int32_t)ENDS);
    }
}

static void send(uint32_t flags)
{
    if ((sent < send_count) && ((flags & I2C_TXE) != 0U)) {
        register_set(I2C1 + I2C_DR, sending[sent]);
        sent++;
        if (sent == send_count) {
            register_change(I2C1 + I2C_CR2, I2C_ITBUFEN, 0U);
        }
    } else if ((sent == send_count) && ((flags & I2C_BTF) != 0U)) {
        if (receive_count > 0) {
            state = (int32_t)TURNS;
            register_change(I2C1 + I2C_CR1, 0U, I2C_START);
        } else {
            register_change(I2C1 + I2C_CR1, 0U, I2C_STOP);
            end_with((int32_t)ENDS);
        }
    } else {
        /* not yet */
    }
}

void i2c_event_interrupt(void)
{
    const uint32_t flags = register_get(I2C1 + I2C_SR1);

    if (((state == (int32_t)ADDRESSES) || (state == (int32_t)TURNS)) && ((flags & I2C_SB) != 0U)) {
        const bool reads = state == (int32_t)TURNS;

        register_set(I2C1 + I2C_DR, (device_address << 1U) | (reads ? 1U : 0U));
        state = reads ? (int32_t)ADDRESSES_TO_READ : (int32_t)SENDS;
    } else if ((flags & I2C_ADDR) != 0U) {
        if (state == (int32_t)ADDRESSES_TO_READ) {
            begin_to_receive();
        } else {
            (void)register_get(I2C1 + I2C_SR2);
            register_change(I2C1 + I2C_CR2, 0U, I2C_ITBUFEN);
        }
    } else if (state == (int32_t)SENDS) {
        send(flags);
    } else if (state == (int32_t)RECEIVES) {
        receive(flags);
    } else {
        /* the flag of the byte before a repeated start */
    }
}

void i2c_error_interrupt(void)
{
    register_change(I2C1 + I2C_SR1, I2C_ERRORS, 0U);
    register_change(I2C1 + I2C_CR1, 0U, I2C_STOP);
    end_with((int32_t)FAILED);
}

/* Done when the stop is on the bus, so that the next transfer may begin. */
int32_t i2c_poll(void)
{
    int32_t answer = (int32_t)BUS_BUSY;

    if ((state == (int32_t)RESTS) || (state == (int32_t)FAILED)) {
        answer = (int32_t)BUS_ERROR;
        state = (int32_t)RESTS;
    } else if ((state == (int32_t)ENDS) && ((register_get(I2C1 + I2C_SR2) & I2C_BUSY) == 0U)) {
        answer = (int32_t)BUS_DONE;
        state = (int32_t)RESTS;
    } else {
        /* under way */
    }
    return answer;
}

void i2c_abort(void)
{
    end_with((int32_t)RESTS);
    free_bus();
}
