#include "filter_unit.h"

#include <math.h>
#include <string.h>

#include "estimate/filter/ekf_step.h"

typedef char memory_fits[sizeof(estimator_t) <= 8 * FILTER_MEMORY_WORDS ? 1 : -1];

void reset_filter(filter_unit *f)
{
    memset(f, 0, sizeof *f);
    estimator_reset((estimator_t *)f->memory, &mufly_settings);
    for (int k = 0; k < FILTER_SENSOR_COUNT; k++) {
        f->reading_times[k] = NAN;
    }
    for (int k = 0; k < FILTER_BEAM_COUNT; k++) {
        f->scans[0][k] = f->scans[1][k] = f->scans[2][k] = f->ranges[k] = FILTER_MAX_RANGE;
    }
}

bool begin_reading(filter_unit *f, int sensor, double time, double measured, double is_valid)
{
    if (measured == f->reading_times[sensor]) {
        return false;
    }
    f->reading_times[sensor] = measured;
    f->ages[sensor] = time - measured;
    f->is_new[sensor] = is_valid != 0.0 ? 1 : 2;
    return true;
}

void step_filter(filter_unit *f, const double *actuators)
{
    estimator_t *memory = (estimator_t *)f->memory;
    memcpy(f->values + FILTER_ACTUATORS, actuators, 4 * sizeof(double));
    f->is_valid = estimator_step(memory, &mufly_settings, &mufly_flight_model, f->values, f->is_new, f->ages) ? 1 : 0;
    memset(f->is_new, 0, sizeof f->is_new);
    f->periods += 1;
    memcpy(f->state, memory->x_output, sizeof f->state);
    memcpy(f->rates, memory->rates_output, sizeof f->rates);
    memcpy(f->angles, memory->angles_output, sizeof f->angles);
    if (f->periods == 1 || f->periods % FILTER_PUBLISH_INTERVAL == 0) {
        memcpy(f->deviations, memory->sigma_output, sizeof f->deviations);
        for (int k = FILTER_ATTITUDE; k < FILTER_ATTITUDE + 3; k++) { /* of roll, pitch, yaw; sigma_output: about N, E, D */
            f->deviations[k] = sqrt(memory->covariance_output[k][k]);
        }
    }
}
