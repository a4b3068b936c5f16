/* Sensors of a board: advances their drivers and fills in the readings of a period. */
#ifndef MUFLY_SENSOR_SUITE_H
#define MUFLY_SENSOR_SUITE_H

#include "bmp280.h"
#include "hal.h"
#include "icm42688.h"
#include "srf10.h"

typedef struct {
    icm42688_t imu;
    bmp280_t barometer;
    srf10_t sonar;
} sensor_suite_t;

void sensor_suite_start(sensor_suite_t *s, bool barometer_on_spi, uint32_t now_us);

/* Take new readings, without waiting. A sensor without an echo is invalid; one with a fault gives no reading, and the filter counts
 * the silence. voltage_V: of the battery; negative: no reading. */
void sensor_suite_read(sensor_suite_t *s, uint32_t now_us, real_t voltage_V, hal_readings_t *readings);

#endif
