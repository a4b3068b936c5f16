/* SPI 1 by DMA 2, streams 0 and 5: bytes out, then bytes in, in one selection of the device. */
#include "register_device.h"
#include "stm32f405.h"

#define RX DMA_STREAM(0U)
#define TX DMA_STREAM(5U)
#define PATIENCE 1000U

static uint8_t sent[SPI_BYTES];
static uint8_t heard[SPI_BYTES];
static uint8_t *taker;       /* of the bytes in; NULL between transfers */
static int32_t skipped, taken;
static bool is_running;
static uint32_t select_port, select_pin;

void spi_start(void)
{
    register_set(SPI1 + SPI_CR1, SPI_MODE_3 | SPI_MSTR | SPI_BR_16 | SPI_SSI_SSM | SPI_SPE);
    is_running = false;
}

static void stop_stream(uint32_t stream)
{
    register_change(stream + DMA_CR, DMA_EN, 0U);
    for (uint32_t n = 0U; (n < PATIENCE) && ((register_get(stream + DMA_CR) & DMA_EN) != 0U); n++) {
    }
}

static void end_transfer(void)
{
    stop_stream(TX);
    stop_stream(RX);
    register_set(SPI1 + SPI_CR2, 0U);
    pin_set(select_port, select_pin, true);
    is_running = false;
}

bool spi_begin(uint32_t port, uint32_t pin, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count)
{
    const int32_t count = out_count + in_count;
    const bool can = !is_running && (out_count > 0) && (in_count >= 0) && (count <= SPI_BYTES);

    if (can) {
        for (int32_t i = 0; i < count; i++) {
            sent[i] = (i < out_count) ? out[i] : 0U;
        }
        taker = in;
        skipped = out_count;
        taken = in_count;
        select_port = port;
        select_pin = pin;
        is_running = true;
        (void)register_get(SPI1 + SPI_DR); /* what an aborted transfer left, and its overrun */
        (void)register_get(SPI1 + SPI_SR);
        register_set(DMA_LIFCR, DMA_S0_ALL);
        register_set(DMA_HIFCR, DMA_S5_ALL);
        pin_set(port, pin, false);
        register_set(RX + DMA_PAR, SPI1 + SPI_DR);
        register_set(RX + DMA_M0AR, memory_address(heard));
        register_set(RX + DMA_NDTR, (uint32_t)count);
        register_set(RX + DMA_CR, DMA_CHANNEL(3U) | DMA_MINC | DMA_EN);
        register_set(TX + DMA_PAR, SPI1 + SPI_DR);
        register_set(TX + DMA_M0AR, memory_address(sent));
        register_set(TX + DMA_NDTR, (uint32_t)count);
        register_set(TX + DMA_CR, DMA_CHANNEL(3U) | DMA_MINC | DMA_TO_PERIPHERAL | DMA_EN);
        register_set(SPI1 + SPI_CR2, SPI_DMA_BOTH);
    }
    return can;
}

int32_t spi_poll(void)
{
    int32_t state = (int32_t)BUS_BUSY;

    if (!is_running) {
        state = (int32_t)BUS_ERROR;
    } else if (((register_get(DMA_LISR) & DMA_S0_ERRORS) != 0U) ||
               ((register_get(SPI1 + SPI_SR) & (SPI_SR_MODF | SPI_SR_OVR)) != 0U)) {
        end_transfer();
        state = (int32_t)BUS_ERROR;
    } else if (((register_get(DMA_LISR) & DMA_S0_DONE) != 0U) && ((register_get(SPI1 + SPI_SR) & SPI_SR_BSY) == 0U)) {
        end_transfer();
        for (int32_t i = 0; i < taken; i++) {
            taker[i] = heard[skipped + i];
        }
        state = (int32_t)BUS_DONE;
    } else {
        /* under way */
    }
    return state;
}

/* Switching the peripheral off and on clears its shift register and its errors. */
void spi_abort(void)
{
    if (is_running) {
        end_transfer();
    }
    register_change(SPI1 + SPI_CR1, SPI_SPE, 0U);
    register_change(SPI1 + SPI_CR1, 0U, SPI_SPE);
}
