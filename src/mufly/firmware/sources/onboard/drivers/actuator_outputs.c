#include "onboard/drivers/actuator_outputs.h"

#define DSHOT_LEAST 48 /* lower values are commands, not throttles */
#define DSHOT_MOST 2047
#define ADC_MOST 4095U

uint16_t dshot_frame(real_t share)
{
    uint32_t throttle = 0U;
    uint32_t value;

    if (share > REAL(0.0)) {
        const real_t most = real_min(share, REAL(1.0));

        throttle = (uint32_t)DSHOT_LEAST + (uint32_t)((most * (real_t)(DSHOT_MOST - DSHOT_LEAST)) + REAL(0.5));
    }
    value = throttle << 1U; /* without a request for telemetry */
    return (uint16_t)((value << 4U) | ((value ^ (value >> 4U) ^ (value >> 8U)) & 0xFU));
}

void dshot_compare_values(uint16_t frame, uint32_t period_ticks, uint32_t out[DSHOT_BITS])
{
    for (uint32_t i = 0U; i < 16U; i++) {
        const bool one = ((frame >> (15U - i)) & 1U) != 0U;

        out[i] = (period_ticks * (one ? 6U : 3U)) / 8U;
    }
    out[16] = 0U;
}

uint32_t servo_pulse_us(real_t deflection)
{
    uint32_t pulse = 1500U;

    if ((deflection >= REAL(-1.0)) && (deflection <= REAL(1.0))) {
        pulse = (uint32_t)(REAL(1500.5) + (REAL(500.0) * deflection));
    } else if (deflection > REAL(1.0)) {
        pulse = 2000U;
    } else if (deflection < REAL(-1.0)) {
        pulse = 1000U;
    } else {
        /* not a number */
    }
    return pulse;
}

real_t battery_voltage(uint32_t count, real_t reference_V, real_t divider)
{
    return (count <= ADC_MOST) ? (((real_t)count / (real_t)ADC_MOST) * reference_V * divider) : REAL(-1.0);
}
