#include "onboard/storage/calibration.h"

void calibration_reset(calibration_t *c)
{
    for (int32_t i = 0; i < 3; i++) {
        c->acceleration_offset[i] = REAL(0.0);
        c->acceleration_scale[i] = REAL(1.0);
        c->rate_offset[i] = REAL(0.0);
    }
    c->ring_offset = REAL(0.0);
    c->ring_scale = REAL(1.0);
    c->sonar_offset = REAL(0.0);
    c->sonar_scale = REAL(1.0);
}

void calibrate_readings(const calibration_t *c, hal_readings_t *r)
{
    if (r->fresh[READING_ACCELERATION] != 0) {
        real_t *z = &r->z[READING_STARTS[READING_ACCELERATION]];

        for (int32_t i = 0; i < 3; i++) {
            z[i] = (z[i] - c->acceleration_offset[i]) * c->acceleration_scale[i];
        }
    }
    if (r->fresh[READING_RATES] != 0) {
        real_t *z = &r->z[READING_STARTS[READING_RATES]];

        for (int32_t i = 0; i < 3; i++) {
            z[i] = z[i] - c->rate_offset[i];
        }
    }
    if (r->fresh[READING_SONAR] != 0) {
        real_t *z = &r->z[READING_STARTS[READING_SONAR]];

        z[0] = (z[0] - c->sonar_offset) * c->sonar_scale;
    }
    if (r->fresh[READING_RANGE_RING] == 1) {
        for (int32_t i = 0; i < MAX_BEAMS; i++) {
            r->ranges[i] = (r->ranges[i] - c->ring_offset) * c->ring_scale;
        }
    }
}
