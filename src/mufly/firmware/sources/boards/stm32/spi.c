/* SPI by DMA: sensors on SPI 1, an SD card on SPI 3. */
#include "boards/stm32/pins.h"
#include "boards/stm32/stm32f405.h"
#include "onboard/drivers/sd_card.h"
#include "onboard/drivers/sensors/register_device.h"

#include <stddef.h>

#define PATIENCE 1000U

static const uint8_t ones = 0xFFU;
static uint8_t dropped;
static spi_port_t sensor_port;
static spi_port_t card_port;
static uint8_t sent[SPI_BYTES];
static uint8_t heard[SPI_BYTES];
static uint8_t *taker;
static int32_t skipped, taken;

/* The port */

static void stop_stream(uint32_t stream)
{
    register_change(stream + DMA_CR, DMA_EN, 0U);
    for (uint32_t n = 0U; (n < PATIENCE) && ((register_get(stream + DMA_CR) & DMA_EN) != 0U); n++) {
    }
}

static void start_stream(const spi_port_t *s, uint32_t stream, const void *memory, bool steps, uint32_t direction, uint32_t count)
{
    register_set(stream + DMA_PAR, s->base + SPI_DR);
    register_set(stream + DMA_M0AR, memory_address(memory));
    register_set(stream + DMA_NDTR, count);
    register_set(stream + DMA_CR, DMA_CHANNEL(s->channel) | (steps ? DMA_MINC : 0U) | direction | DMA_EN);
}

void spi_port_speed(spi_port_t *s, uint32_t mode, uint32_t divider)
{
    register_set(s->base + SPI_CR1, 0U);
    register_set(s->base + SPI_CR1, mode | SPI_MSTR | divider | SPI_SSI_SSM | SPI_SPE);
}

void spi_port_start(spi_port_t *s, uint32_t base, uint32_t mode, uint32_t divider)
{
    s->base = base;
    s->dma = (base == SPI1) ? DMA2 : DMA1;
    s->channel = (base == SPI1) ? 3U : 0U;
    s->is_running = false;
    spi_port_speed(s, mode, divider);
}

static void end_transfer(spi_port_t *s)
{
    stop_stream(s->dma + DMA_STREAM(5U));
    stop_stream(s->dma + DMA_STREAM(0U));
    register_set(s->base + SPI_CR2, 0U);
    s->is_running = false;
}

bool spi_port_begin(spi_port_t *s, const uint8_t out[], uint8_t in[], int32_t count)
{
    const bool can = !s->is_running && (count > 0);

    if (can) {
        s->is_running = true;
        (void)register_get(s->base + SPI_DR); /* what an aborted transfer left, and its overrun */
        (void)register_get(s->base + SPI_SR);
        register_set(s->dma + DMA_LIFCR, DMA_S0_ALL);
        register_set(s->dma + DMA_HIFCR, DMA_S5_ALL);
        start_stream(s, s->dma + DMA_STREAM(0U), (in != NULL) ? in : &dropped, in != NULL, 0U, (uint32_t)count);
        start_stream(s, s->dma + DMA_STREAM(5U), (out != NULL) ? out : &ones, out != NULL, DMA_TO_PERIPHERAL, (uint32_t)count);
        register_set(s->base + SPI_CR2, SPI_DMA_BOTH);
    }
    return can;
}

int32_t spi_port_poll(spi_port_t *s)
{
    int32_t state = (int32_t)BUS_BUSY;

    if (!s->is_running) {
        state = (int32_t)BUS_ERROR;
    } else {
        const uint32_t streams = register_get(s->dma + DMA_LISR);
        const uint32_t port = register_get(s->base + SPI_SR);

        if (((streams & DMA_S0_ERRORS) != 0U) || ((port & (SPI_SR_MODF | SPI_SR_OVR)) != 0U)) {
            end_transfer(s);
            state = (int32_t)BUS_ERROR;
        } else if (((streams & DMA_S0_DONE) != 0U) && ((port & SPI_SR_BSY) == 0U)) {
            end_transfer(s);
            state = (int32_t)BUS_DONE;
        } else {
            /* under way */
        }
    }
    return state;
}

/* Switching the peripheral off and on clears its shift register and its errors. */
void spi_port_abort(spi_port_t *s)
{
    if (s->is_running) {
        end_transfer(s);
    }
    register_change(s->base + SPI_CR1, SPI_SPE, 0U);
    register_change(s->base + SPI_CR1, 0U, SPI_SPE);
}

/* Sensors */

void spi_start(void)
{
    spi_port_start(&sensor_port, SPI1, SPI_MODE_3, SPI_BR_16);
}

bool spi_begin(uint32_t port, uint32_t pin, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count)
{
    const int32_t count = out_count + in_count;
    const bool can = !sensor_port.is_running && (out_count > 0) && (in_count >= 0) && (count <= SPI_BYTES);

    if (can) {
        for (int32_t i = 0; i < count; i++) {
            sent[i] = (i < out_count) ? out[i] : 0U;
        }
        taker = in;
        skipped = out_count;
        taken = in_count;
        sensor_port.select_port = port;
        sensor_port.select_pin = pin;
        pin_set(port, pin, false);
        (void)spi_port_begin(&sensor_port, sent, heard, count);
    }
    return can;
}

int32_t spi_poll(void)
{
    const bool was_running = sensor_port.is_running;
    const int32_t state = spi_port_poll(&sensor_port);

    if (was_running && (state != (int32_t)BUS_BUSY)) {
        pin_set(sensor_port.select_port, sensor_port.select_pin, true);
    }
    if (state == (int32_t)BUS_DONE) {
        for (int32_t i = 0; i < taken; i++) {
            taker[i] = heard[skipped + i];
        }
    }
    return state;
}

void spi_abort(void)
{
    if (sensor_port.is_running) {
        pin_set(sensor_port.select_port, sensor_port.select_pin, true);
    }
    spi_port_abort(&sensor_port);
}

/* SD card: its clock is 42 MHz / 128 at the start, then 21 MHz. */

void card_bus_start(void)
{
    spi_port_start(&card_port, SPI3, SPI_MODE_0, SPI_BR_128);
}

void sd_bus_speed(bool fast)
{
    spi_port_speed(&card_port, SPI_MODE_0, fast ? SPI_BR_2 : SPI_BR_128);
}

bool sd_bus_begin(bool selected, const uint8_t out[], uint8_t in[], int32_t count)
{
    bool begun = false;

    if (!card_port.is_running) {
        pin_set(CARD_SELECT_PORT, CARD_SELECT_PIN, !selected);
        begun = spi_port_begin(&card_port, out, in, count);
    }
    return begun;
}

int32_t sd_bus_poll(void)
{
    const int32_t state = spi_port_poll(&card_port);

    return (state == (int32_t)BUS_DONE) ? (int32_t)BLOCK_DONE : ((state == (int32_t)BUS_BUSY) ? (int32_t)BLOCK_BUSY : (int32_t)BLOCK_ERROR);
}
