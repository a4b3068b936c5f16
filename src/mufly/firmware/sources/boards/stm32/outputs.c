/* Motors by DShot300 (timer 8 with DMA 2, streams 2 and 3), servos (timer 3), battery (ADC 1). */
#include "boards/stm32/pins.h"
#include "boards/stm32/stm32f405.h"

#define SERVO_FRAME_US 20000U
#define SERVO_MIDDLE_US 1500U

static void start_motor(uint32_t stream, uint32_t compare, const uint32_t values[], uint32_t count)
{
    register_set(stream + DMA_CR, 0U); /* the frame before ended 4.9 ms ago; a stream that still ran would end here */
    register_set(stream + DMA_PAR, TIM8 + compare);
    register_set(stream + DMA_M0AR, memory_address(values));
    register_set(stream + DMA_NDTR, count);
    register_set(stream + DMA_CR, DMA_CHANNEL(7U) | DMA_MINC | DMA_WORDS | DMA_TO_PERIPHERAL | DMA_EN);
}

void outputs_start(uint32_t clock_Hz)
{
    const uint32_t bit_ticks = (uint32_t)(((uint64_t)clock_Hz * DSHOT_BIT_TICKS) / FULL_SPEED_HZ);
    const uint32_t timer_MHz = ((clock_Hz == FULL_SPEED_HZ) ? (clock_Hz / 2U) : clock_Hz) / 1000000U;

    register_set(TIM8 + TIM_PSC, 0U);
    register_set(TIM8 + TIM_ARR, bit_ticks - 1U);
    register_set(TIM8 + TIM_CCMR1, TIM_PWM_BOTH);
    register_set(TIM8 + TIM_CCR1, 0U);
    register_set(TIM8 + TIM_CCR2, 0U);
    register_set(TIM8 + TIM_CCER, 0x11U);
    register_set(TIM8 + TIM_BDTR, TIM_MOE);
    register_set(TIM8 + TIM_DIER, TIM_CC1DE | TIM_CC2DE);
    register_set(TIM8 + TIM_EGR, TIM_UPDATE);
    register_set(TIM8 + TIM_CR1, TIM_CEN);
    register_set(TIM3 + TIM_PSC, timer_MHz - 1U);
    register_set(TIM3 + TIM_ARR, SERVO_FRAME_US - 1U);
    register_set(TIM3 + TIM_CCMR2, TIM_PWM_BOTH);
    servos_set(SERVO_MIDDLE_US, SERVO_MIDDLE_US);
    register_set(TIM3 + TIM_CCER, 0x1100U);
    register_set(TIM3 + TIM_EGR, TIM_UPDATE);
    register_set(TIM3 + TIM_CR1, TIM_CEN);
}

void motors_send(uint32_t first[], uint32_t second[], uint32_t count)
{
    register_set(DMA2 + DMA_LIFCR, DMA_S2_ALL | DMA_S3_ALL);
    start_motor(DMA2 + DMA_STREAM(2U), TIM_CCR1, first, count);
    start_motor(DMA2 + DMA_STREAM(3U), TIM_CCR2, second, count);
}

void servos_set(uint32_t first_us, uint32_t second_us)
{
    register_set(TIM3 + TIM_CCR3, first_us);
    register_set(TIM3 + TIM_CCR4, second_us);
}

void adc_start(void)
{
    register_set(ADC_SMPR1, 7UL << (3U * (BATTERY_CHANNEL - 10U))); /* 480 cycles */
    register_set(ADC_SQR3, BATTERY_CHANNEL);
    register_set(ADC_CR2, ADC_ADON);
}

/* Read the conversion that the previous call started. */
uint32_t adc_read(void)
{
    uint32_t count = 0xFFFFU;

    if ((register_get(ADC_SR) & ADC_EOC) != 0U) {
        count = register_get(ADC_DR);
    }
    register_set(ADC_CR2, ADC_ADON | ADC_SWSTART);
    return count;
}
