/* Inertial unit TDK ICM-42688-P on SPI (data sheet DS-000347, register map of bank 0): 16 g, 2000 degrees/s, 1 kHz, one sample a call.
 * Readings in body axes forward, right, down, for a chip with x forward, y to the left, z up. */
#ifndef MUFLY_ICM42688_H
#define MUFLY_ICM42688_H

#include "onboard/drivers/sensors/register_device.h"

typedef struct {
    register_device_t device;
    real_t acceleration[3]; /* specific force (m/s2) */
    real_t rates[3];        /* rad/s */
    real_t temperature;     /* K */
    real_t clipping[3];     /* 1 where the accelerometer is at full scale, else 0 */
    uint8_t last[14];
    int32_t repeated;       /* samples in a row that are equal to the last bit */
} icm42688_t;

void icm42688_start(icm42688_t *imu, uint32_t now_us);

/* Advance; return whether there is a new sample. */
bool icm42688_step(icm42688_t *imu, uint32_t now_us);

#endif
