#include "onboard/drivers/sensor_suite.h"

#define STANDARD_PRESSURE REAL(101325.0) /* readings of pressure are differences to it (Pa) */
#define CALLS_OF_IMU 3 /* begin a transfer and take its data within a period where the bus is fast enough */

void sensor_suite_start(sensor_suite_t *s, bool barometer_on_spi, int32_t ranging, uint32_t now_us)
{
    icm42688_start(&s->imu, now_us);
    bmp280_start(&s->barometer, barometer_on_spi, now_us);
    s->ranging = ranging;
    srf10_start(&s->sonar, now_us);
    vl53l1x_start(&s->laser, now_us);
}

static void take(hal_readings_t *r, int32_t reading, const real_t values[], int32_t freshness)
{
    for (int32_t i = 0; i < READING_WIDTHS[reading]; i++) {
        r->z[READING_STARTS[reading] + i] = values[i];
    }
    r->fresh[reading] = freshness;
}

void sensor_suite_read(sensor_suite_t *s, uint32_t now_us, real_t voltage_V, hal_readings_t *readings)
{
    bool fresh = false;

    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        readings->fresh[k] = 0;
        readings->age[k] = REAL(0.0);
    }
    for (int32_t n = 0; !fresh && (n < CALLS_OF_IMU); n++) {
        fresh = icm42688_step(&s->imu, now_us);
    }
    if (fresh) {
        take(readings, READING_ACCELERATION, s->imu.acceleration, 1);
        take(readings, READING_RATES, s->imu.rates, 1);
    }
    for (int32_t i = 0; i < 3; i++) {
        readings->z[CLIPPING_START + i] = fresh ? s->imu.clipping[i] : REAL(0.0);
    }
    if (bmp280_step(&s->barometer, now_us)) {
        const real_t pressure = s->barometer.pressure - STANDARD_PRESSURE;

        take(readings, READING_PRESSURE, &pressure, 1);
    }
    if (s->ranging == (int32_t)RANGING_VL53L1X) {
        if (vl53l1x_step(&s->laser, now_us)) {
            take(readings, READING_SONAR, &s->laser.range, s->laser.has_echo ? 1 : 2);
        }
    } else if (srf10_step(&s->sonar, now_us)) {
        take(readings, READING_SONAR, &s->sonar.range, s->sonar.has_echo ? 1 : 2);
    } else {
        /* no new range */
    }
    if (voltage_V >= REAL(0.0)) {
        readings->z[READING_STARTS[READING_BATTERY]] = voltage_V;
        readings->fresh[READING_BATTERY] = 1;
    }
}
