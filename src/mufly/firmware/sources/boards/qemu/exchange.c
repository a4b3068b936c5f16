#include "boards/qemu/exchange.h"

void merge_readings(hal_readings_t *to, const hal_readings_t *from)
{
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        to->fresh[k] = from->fresh[k];
        to->age[k] = from->age[k];
        if (from->fresh[k] != 0) {
            for (int32_t i = 0; i < READING_WIDTHS[k]; i++) {
                to->z[READING_STARTS[k] + i] = from->z[READING_STARTS[k] + i];
            }
        }
    }
    for (int32_t i = 0; i < 3; i++) {
        to->z[CLIPPING_START + i] = from->z[CLIPPING_START + i];
    }
    if (from->fresh[READING_RANGE_RING] == 1) {
        for (int32_t i = 0; i < MAX_BEAMS; i++) {
            to->ranges[i] = from->ranges[i];
        }
    }
}
