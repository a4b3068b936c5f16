/* Sensors of a board: advances their drivers and fills in the readings of a period. */
#ifndef MUFLY_SENSOR_SUITE_H
#define MUFLY_SENSOR_SUITE_H

#include "hal.h"
#include "onboard/drivers/sensors/bmp280.h"
#include "onboard/drivers/sensors/icm42688.h"
#include "onboard/drivers/sensors/srf10.h"
#include "onboard/drivers/sensors/vl53l1x.h"

/* What measures the range downwards: READING_SONAR of the readings. */
enum { RANGING_SRF10, RANGING_VL53L1X };

typedef struct {
    icm42688_t imu;
    bmp280_t barometer;
    int32_t ranging;
    srf10_t sonar;
    vl53l1x_t laser;
} sensor_suite_t;

void sensor_suite_start(sensor_suite_t *s, bool barometer_on_spi, int32_t ranging, uint32_t now_us);

/* Take new readings, without waiting. A sensor without an echo is invalid; one with a fault gives no reading, and the filter counts
 * the silence. voltage_V: of the battery; negative: no reading. */
void sensor_suite_read(sensor_suite_t *s, uint32_t now_us, real_t voltage_V, hal_readings_t *readings);

#endif
