/* Detector of actuator oscillations: sustained equal periods over half of an input's range, not commanded.
 *
 * Explanation: oscillation_detector.py of mufly.flight. */
#ifndef MUFLY_OSCILLATION_DETECTOR_H
#define MUFLY_OSCILLATION_DETECTOR_H

#include "real.h"

#define OSCILLATION_INPUTS 4
#define STEERING_SIGNALS 6

typedef struct {
    real_t reversal_threshold;
    bool is_rising;
    real_t last_extreme, extreme_time_s;
    int32_t turn_count; /* number of turning points */
    real_t turn_times_s[3];
} turning_points_t;

typedef struct {
    turning_points_t turning_points;
    real_t start_s;
    int32_t half_period_count;
    real_t period_s, lowest_value, highest_value;
} input_oscillation_t;

typedef struct {
    input_oscillation_t inputs[OSCILLATION_INPUTS]; /* motor upper, lower, servo 1, 2 */
    turning_points_t asked[STEERING_SIGNALS];
} oscillation_detector_t;

typedef struct {
    bool is_present;
    int32_t input_name;
    real_t start_s, duration_s, swing, frequency_Hz;
} oscillation_t;

void oscillation_detector_reset(oscillation_detector_t *o);

/* Process one instant. asked: commanded velocity N, E, D, yaw rate, roll, pitch; NULL without a command. */
void oscillation_detector_step(oscillation_detector_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out);

#endif
