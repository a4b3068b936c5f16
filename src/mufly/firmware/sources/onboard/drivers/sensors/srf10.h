/* Ultrasonic ranging Devantech SRF10 on I2C, address 0x70 (robot-electronics.co.uk, SRF10 technical specification): range downwards,
 * 0.03 to 3 m, one value in 30 ms. */
#ifndef MUFLY_SRF10_H
#define MUFLY_SRF10_H

#include "onboard/drivers/sensors/register_device.h"

typedef struct {
    register_device_t device;
    real_t range;  /* m */
    bool has_echo; /* false: nothing within its range */
} srf10_t;

void srf10_start(srf10_t *s, uint32_t now_us);

/* Advance; return whether there is a new answer. */
bool srf10_step(srf10_t *s, uint32_t now_us);

#endif
