/* Clock, resets, watchdog, timers, pins. */
#include "boards/stm32/pins.h"
#include "boards/stm32/stm32f405.h"
#include "onboard/storage/fault_record.h"

#define PATIENCE 200000U /* iterations of a wait; the crystal takes 2 ms of the 16 MHz at the start */
#define INTERNAL_HZ 16000000U
#define INTERNAL_MHZ 16U
#define WATCHDOG_TICKS 400U /* of 32 kHz / 4: 50 ms */

static bool wait_for(uint32_t address, uint32_t mask, uint32_t value)
{
    bool there = false;

    for (uint32_t n = 0U; !there && (n < PATIENCE); n++) {
        there = (register_get(address) & mask) == value;
    }
    return there;
}

uint32_t clock_start(void)
{
    bool crystal;
    bool runs;

    register_change(RCC_CR, 0U, CR_HSEON);
    crystal = wait_for(RCC_CR, CR_HSERDY, CR_HSERDY);
    /* 1 MHz * 336 / 2 = 168 MHz, / 7 = 48 MHz */
    register_set(RCC_PLLCFGR, (crystal ? (PLLCFGR_HSE | CRYSTAL_MHZ) : INTERNAL_MHZ) | (336UL << 6U) | (7UL << 24U));
    register_change(RCC_CR, 0U, CR_PLLON);
    runs = wait_for(RCC_CR, CR_PLLRDY, CR_PLLRDY);
    if (runs) {
        register_set(FLASH_ACR, ACR_168_MHZ); /* before the clock rises */
        register_change(RCC_CFGR, 0xFCF3U, CFGR_PPRE1_4 | CFGR_PPRE2_2 | CFGR_SW_PLL);
        runs = wait_for(RCC_CFGR, CFGR_SWS, CFGR_SWS_PLL);
    }
    if (!runs) {
        register_change(RCC_CFGR, 0xFCF3U, 0U);
    }
    register_change(RCC_AHB1ENR, 0U, AHB1_GPIO_ABC | AHB1_DMA_BOTH);
    register_change(RCC_APB1ENR, 0U, APB1_TIM2 | APB1_TIM3 | APB1_TIM5 | APB1_SPI3 | APB1_USART2 | APB1_I2C1);
    register_change(RCC_APB2ENR, 0U, APB2_TIM8 | APB2_USART1 | APB2_ADC1 | APB2_SPI1);
    return runs ? FULL_SPEED_HZ : INTERNAL_HZ;
}

/* A reset sets PINRSTF in every case, and a power-up sets BORRSTF too: the more specific flag counts. */
uint32_t reset_cause(void)
{
    const uint32_t flags = register_get(RCC_CSR);
    uint32_t cause = RESET_BY_PIN;

    if ((flags & CSR_PORRSTF) != 0U) {
        cause = RESET_BY_POWER;
    } else if ((flags & CSR_BORRSTF) != 0U) {
        cause = RESET_BY_BROWN_OUT;
    } else if ((flags & CSR_IWDGRSTF) != 0U) {
        cause = RESET_BY_WATCHDOG;
    } else if ((flags & CSR_SFTRSTF) != 0U) {
        cause = RESET_BY_SOFTWARE;
    } else {
        /* the pin alone */
    }
    register_change(RCC_CSR, 0U, CSR_RMVF);
    return cause;
}

void reset_processor(void)
{
    register_set(SCB_AIRCR, AIRCR_RESET);
}

void watchdog_start(void)
{
    register_set(IWDG_KR, IWDG_START);
    register_set(IWDG_KR, IWDG_UNLOCK);
    register_set(IWDG_PR, 0U);
    register_set(IWDG_RLR, WATCHDOG_TICKS - 1U);
    (void)wait_for(IWDG_SR, 3U, 0U);
    watchdog_feed();
}

void watchdog_feed(void)
{
    register_set(IWDG_KR, IWDG_FEED);
}

/* Timers of a divided bus run at twice its clock. */
static uint32_t timer_clock(uint32_t clock_Hz)
{
    return (clock_Hz == FULL_SPEED_HZ) ? (clock_Hz / 2U) : clock_Hz;
}

static void start_timer(uint32_t base, uint32_t clock_Hz, uint32_t reload)
{
    register_set(base + TIM_PSC, (timer_clock(clock_Hz) / 1000000U) - 1U);
    register_set(base + TIM_ARR, reload);
    register_set(base + TIM_EGR, TIM_UPDATE); /* take over the divider */
    register_set(base + TIM_SR, 0U);
    register_set(base + TIM_CR1, TIM_CEN);
}

void timers_start(uint32_t clock_Hz, uint32_t rate_Hz)
{
    start_timer(TIM2, clock_Hz, 0xFFFFFFFFU);
    start_timer(TIM5, clock_Hz, (1000000U / rate_Hz) - 1U);
    register_set(TIM5 + TIM_DIER, TIM_UPDATE);
    register_set(NVIC_ISER + (4U * (IRQ_TIM5 / 32U)), 1UL << (IRQ_TIM5 % 32U));
}

uint32_t timer_us(void)
{
    return register_get(TIM2 + TIM_CNT);
}

void timer_end_interrupt(void)
{
    register_set(TIM5 + TIM_SR, 0U);
}

void pin_set(uint32_t port, uint32_t pin, bool high)
{
    register_set(port + GPIO_BSRR, 1UL << (high ? pin : (pin + 16U)));
}

void pins_start(void)
{
    static const pin_t pins[] = PIN_TABLE;

    pin_set(IMU_SELECT_PORT, IMU_SELECT_PIN, true);
    pin_set(BAROMETER_SELECT_PORT, BAROMETER_SELECT_PIN, true);
    pin_set(CARD_SELECT_PORT, CARD_SELECT_PIN, true);
    for (uint32_t i = 0U; i < (sizeof(pins) / sizeof(pins[0])); i++) {
        const pin_t *p = &pins[i];
        const uint32_t function = p->port + GPIO_AFRL + (4U * (p->pin / 8U));

        register_change(function, 15UL << (4U * (p->pin % 8U)), p->function << (4U * (p->pin % 8U)));
        register_change(p->port + GPIO_OSPEEDR, 3UL << (2U * p->pin), 2UL << (2U * p->pin));
        register_change(p->port + GPIO_MODER, 3UL << (2U * p->pin), p->mode << (2U * p->pin));
    }
}
