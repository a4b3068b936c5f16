/* Cortex-M4 with floating-point unit, emulated by QEMU with -icount shift=0. An instruction takes a nanosecond, so SysTick
 * measures instructions: 40 a tick at the 25 MHz of mps2-an386. Output goes through semihosting. */
#include "boards/memory.h"
#include "check/platforms/platform.h"
#include "check/platforms/semihosting.h"

#define CPACR (*(volatile uint32_t *)0xE000ED88U)
#define SYST_CSR (*(volatile uint32_t *)0xE000E010U)
#define SYST_RVR (*(volatile uint32_t *)0xE000E014U)
#define SYST_CVR (*(volatile uint32_t *)0xE000E018U)

extern uint32_t stack_top, data_load, data_begin, data_end, bss_begin, bss_end;
int main(void);
void reset(void);
void trap_fault(void);
void interrupt_0(void) __attribute__((weak, alias("trap_fault"))); /* of the board, if it has one */
void interrupt_2(void) __attribute__((weak, alias("trap_fault")));

uint32_t ask_host(uint32_t what, const void *with)
{
    register uint32_t r0 __asm__("r0") = what;
    register const void *r1 __asm__("r1") = with;

    __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

void reset(void)
{
    CPACR |= 0xFU << 20; /* enable the floating-point unit before its first use */
    __asm__ volatile("dsb\n isb");
    (void)memcpy(&data_begin, &data_load, (uint32_t)((uint8_t *)&data_end - (uint8_t *)&data_begin));
    (void)memset(&bss_begin, 0, (uint32_t)((uint8_t *)&bss_end - (uint8_t *)&bss_begin));
    (void)main();
    for (;;) {
    }
}

void trap_fault(void)
{
    (void)ask_host(HOST_PRINT, "trap: the processor met a fault\n");
    (void)ask_host(HOST_EXIT, (const void *)0x20023U);
    for (;;) {
    }
}

typedef struct {
    const uint32_t *stack;
    void (*called[18])(void);
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    &stack_top,
    {reset, trap_fault, trap_fault, trap_fault, trap_fault, trap_fault, trap_fault, trap_fault, trap_fault, trap_fault,
     trap_fault, trap_fault, trap_fault, trap_fault, trap_fault, interrupt_0, trap_fault, interrupt_2},
};

void platform_start(void)
{
    SYST_RVR = 0xFFFFFFU;
    SYST_CVR = 0U;
    SYST_CSR = 5U;
}

/* 24-bit down counter; the self-test reads it before it wraps. */
uint32_t platform_count(void)
{
    static uint32_t last = 0U;
    static uint32_t ticks = 0U;
    const uint32_t now = 0xFFFFFFU - SYST_CVR;

    ticks += (now - last) & 0xFFFFFFU;
    last = now;
    return ticks;
}

void platform_print(const char *what, uint64_t number)
{
    char line[20];

    for (uint32_t i = 0U; i < 16U; i++) {
        line[i] = "0123456789abcdef"[(number >> (60U - (4U * i))) & 0xFU];
    }
    line[16] = '\n';
    line[17] = '\0';
    (void)ask_host(HOST_PRINT, what);
    (void)ask_host(HOST_PRINT, line);
}

void platform_end(void)
{
    (void)ask_host(HOST_EXIT, (const void *)0x20026U); /* regular exit */
}
