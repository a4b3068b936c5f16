/* The filter of a unit: memory, inputs of a period, estimate. Readings come from sample_sensors of flight_model.h. */

#ifndef FILTER_UNIT_H
#define FILTER_UNIT_H

#include <stdbool.h>
#include <stdint.h>

#include "filter_sizes.h"

typedef struct {
    double memory[FILTER_MEMORY_WORDS]; /* estimator_t of estimate/filter/records.h */
    double values[FILTER_VALUE_COUNT];  /* readings, actuator inputs, shares of clipped samples */
    double ages[FILTER_SENSOR_COUNT], reading_times[FILTER_SENSOR_COUNT]; /* s */
    double scans[3][FILTER_BEAM_COUNT], ranges[FILTER_BEAM_COUNT]; /* last scans of the laser ring, and their median (m) */
    double state[FILTER_STATE_COUNT], rates[3], angles[3];
    double deviations[FILTER_DEVIATION_COUNT]; /* published every FILTER_PUBLISH_INTERVAL periods */
    int64_t is_valid, periods;
    int32_t is_new[FILTER_SENSOR_COUNT]; /* 1 new, 2 new and marked invalid */
} filter_unit;

/* Reset the filter: the vehicle stands on the floor. */
void reset_filter(filter_unit *f);

/* Note a reading of a sensor and its time of measurement (s), for the period that ends at a time (s); return whether it is
   new, so that its values are needed. */
bool begin_reading(filter_unit *f, int sensor, double time, double measured, double is_valid);

/* Process the readings of a period; actuators (4) are the inputs that acted in it. */
void step_filter(filter_unit *f, const double *actuators);

#endif
