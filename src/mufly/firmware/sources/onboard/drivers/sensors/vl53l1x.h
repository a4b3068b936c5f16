/* Laser ranging ST VL53L1X on I2C, address 0x29 (data sheet DS12385; register names and settings: ST's driver STSW-IMG007 and
 * STSW-IMG009, since the data sheet lists three registers only): range downwards, 0.04 to 3.6 m, 15 values a second. */
#ifndef MUFLY_VL53L1X_H
#define MUFLY_VL53L1X_H

#include "onboard/drivers/sensors/register_device.h"

typedef struct {
    register_device_t device;
    int32_t waits;  /* for the present measurement, after its budget */
    real_t range;   /* m */
    bool has_echo;  /* false: no target within its range */
} vl53l1x_t;

void vl53l1x_start(vl53l1x_t *s, uint32_t now_us);

/* Advance; return whether there is a new answer. */
bool vl53l1x_step(vl53l1x_t *s, uint32_t now_us);

#endif
