/* Vector table, start and faults of the STM32F405. */
#include <stddef.h>

#include "boards/stm32/registers.h"
#include "boards/stm32/stm32f405.h"

#define INTERRUPTS 82

extern uint32_t stack_top, data_load, data_begin, data_end, bss_begin, bss_end;

int main(void);
void stm32_period(void);
void stm32_link_interrupt(void);
void stm32_receiver_interrupt(void);
void stm32_fault(uint32_t address);
void start_processor(void);
void handle_fault(void);
void handle_unexpected(void);

/* Copy initialised data and the functions in RAM, clear the rest but .noinit, switch the floating-point unit on. */
void start_processor(void)
{
    const volatile uint32_t *from = &data_load;

    register_change(SCB_CPACR, 0U, 0xFUL << 20U);
    __asm__ volatile("dsb\n isb");
    for (volatile uint32_t *to = &data_begin; to < &data_end; to++) {
        *to = *from;
        from++;
    }
    for (volatile uint32_t *to = &bss_begin; to < &bss_end; to++) {
        *to = 0U;
    }
    (void)main();
    for (;;) {
    }
}

/* The stacked program counter is the seventh word of the frame, on the main stack. */
__attribute__((naked)) void handle_fault(void)
{
    __asm__ volatile("mrs r0, msp\n ldr r0, [r0, #24]\n b stm32_fault");
}

void handle_unexpected(void)
{
    stm32_fault(0U);
}

typedef struct {
    const uint32_t *stack;
    void (*core[15])(void);
    void (*interrupts[INTERRUPTS])(void);
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    &stack_top,
    {start_processor, handle_unexpected, handle_fault, handle_fault, handle_fault, handle_fault, NULL, NULL, NULL, NULL,
     handle_unexpected, handle_unexpected, NULL, handle_unexpected, handle_unexpected},
    {[IRQ_I2C1_EVENT] = i2c_event_interrupt, [IRQ_I2C1_ERROR] = i2c_error_interrupt, [IRQ_USART1] = stm32_link_interrupt,
     [IRQ_USART2] = stm32_receiver_interrupt, [IRQ_TIM5] = stm32_period},
};
