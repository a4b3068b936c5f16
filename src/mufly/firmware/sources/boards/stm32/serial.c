/* Serial ports, by interrupts: QEMU's STM32F405 has no DMA, and the same driver runs there. */
#include "boards/stm32/stm32f405.h"

static void enable_interrupt(uint32_t number)
{
    register_set(NVIC_ISER + (4U * (number / 32U)), 1UL << (number % 32U));
}

void serial_start(serial_port_t *s, uint32_t base, uint32_t bus_Hz, uint32_t baud, bool sbus)
{
    s->base = base;
    s->head = 0U;
    s->tail = 0U;
    s->send_head = 0U;
    s->send_tail = 0U;
    s->errors = 0U;
    register_set(base + USART_CR1, 0U);
    register_set(base + USART_BRR, (bus_Hz + (baud / 2U)) / baud);
    register_set(base + USART_CR2, sbus ? CR2_STOP_2 : 0U);
    register_set(base + USART_CR1, CR1_UE | CR1_RE | CR1_TE | CR1_RXNEIE | (sbus ? (CR1_M | CR1_PCE) : 0U));
    enable_interrupt((base == USART1) ? IRQ_USART1 : IRQ_USART2);
}

/* Give the port bytes as long as it takes some. */
static void send_on(serial_port_t *s)
{
    while ((s->send_tail != s->send_head) && ((register_get(s->base + USART_SR) & SR_TXE) != 0U)) {
        register_set(s->base + USART_DR, s->sending[s->send_tail % SERIAL_RING]);
        s->send_tail++;
    }
}

/* Reading the status and then the data clears RXNE and the errors. */
void serial_interrupt(serial_port_t *s)
{
    const uint32_t state = register_get(s->base + USART_SR);

    if ((state & (SR_RXNE | SR_ORE)) != 0U) {
        const uint32_t data = register_get(s->base + USART_DR);
        const bool good = (state & (SR_PE | SR_FE | SR_NE)) == 0U;
        const bool has_room = (s->head - s->tail) < SERIAL_RING;

        if (((state & SR_RXNE) != 0U) && good && has_room) {
            s->received[s->head % SERIAL_RING] = (uint8_t)(data & 0xFFU);
            s->head++;
        }
        s->errors += (good && has_room && ((state & SR_ORE) == 0U)) ? 0U : 1U;
    }
    if ((register_get(s->base + USART_CR1) & CR1_TXEIE) != 0U) {
        send_on(s);
        if (s->send_tail == s->send_head) {
            register_change(s->base + USART_CR1, CR1_TXEIE, 0U);
        }
    }
}

int32_t serial_read(serial_port_t *s, uint8_t *to, int32_t most)
{
    int32_t count = 0;

    while ((count < most) && (s->tail != s->head)) {
        to[count] = s->received[s->tail % SERIAL_RING];
        s->tail++;
        count++;
    }
    return count;
}

int32_t serial_write(serial_port_t *s, const uint8_t *from, int32_t count)
{
    int32_t taken = 0;

    register_change(s->base + USART_CR1, CR1_TXEIE, 0U); /* the interrupt leaves the ring alone meanwhile */
    while ((taken < count) && ((s->send_head - s->send_tail) < SERIAL_RING)) {
        s->sending[s->send_head % SERIAL_RING] = from[taken];
        s->send_head++;
        taken++;
    }
    send_on(s);
    if (s->send_tail != s->send_head) {
        register_change(s->base + USART_CR1, 0U, CR1_TXEIE);
    }
    return taken;
}
