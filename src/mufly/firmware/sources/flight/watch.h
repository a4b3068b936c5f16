/* Monitors of estimate and actuators: bridging of gaps, smoothing, estimator health, oscillation.
 *
 * Explanation: estimate.py of mufly.estimate; estimator_health.py, oscillation_detector.py of mufly.flight. */
#ifndef MUFLY_WATCH_H
#define MUFLY_WATCH_H

#include "estimate/estimate.h"
#include "mission/machine/log_messages.h"

/* Height deviation above which the height counts as unknown (m). */
#define MAX_HEIGHT_SIGMA_M REAL(0.3)

/* Bridge an implausible estimate for a moment, then report it as lost. */
typedef struct {
    bool begun;
    real_t values[12]; /* last position, velocity, attitude and rates */
    estimate_t good;     /* last estimate with finite values and an advancing clock */
    real_t lost_s;     /* duration of the gap (s) */
    int32_t what;      /* missing values: 1 position, 2 velocity, 4 attitude, 8 rates; 0: frozen */
} estimate_monitor_t;

void estimate_monitor_start(estimate_monitor_t *w);
void check_estimate(estimate_monitor_t *w, const estimate_t *m, real_t period_s, const beam_ring_t *ring);

/* Smoothed position and heading, without the steps of filter corrections. */
typedef struct {
    bool begun;
    real_t last_s;
    real_t last_velocity[3]; /* previous velocity */
    real_t smoothed_position[3];
    real_t smoothed_heading;
} correction_smoother_t;

void correction_smoother_reset(correction_smoother_t *s);

/* Smooth an estimate in place; anew: restart, as no controller is active yet. */
void correction_smoother_step(correction_smoother_t *s, estimate_t *m, bool anew);

/* Required action for the estimate's quality: continue, hold, land, descend. */
enum { FAILSAFE_NONE, FAILSAFE_HOLD, FAILSAFE_LAND, FAILSAFE_SINK };

typedef struct {
    int32_t action;
    message_t reason;
} health_verdict_t;

typedef struct {
    health_verdict_t verdict;
    real_t floor_variance_m2; /* variance of the horizontal position on the floor (m2) */
    bool has_fault[ESTIMATE_SENSORS];
    real_t fault_since_s[ESTIMATE_SENSORS]; /* start time of each fault */
    real_t hold_since_s;
    bool is_certain;
    real_t certain_since_s;
    bool height_uncertain; /* the height is uncertain */
    real_t height_uncertain_since_s;
} health_monitor_t;

/* Whether the angular rates come from the rotor model, since the gyroscopes are faulty. */
bool gyro_unavailable(const estimate_t *m);

void health_monitor_reset(health_monitor_t *d, real_t stood);

/* Evaluate an estimate in flight; return whether the message has changed. */
bool health_monitor_step(health_monitor_t *d, const estimate_t *m);

/* Detector of actuator oscillations: sustained equal periods over half of an input's range, not commanded. */
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
    real_t start_s, duration_s, amplitude, frequency_Hz;
} oscillation_t;

void oscillation_detector_reset(oscillation_detector_t *o);

/* Process one instant. asked: commanded velocity N, E, D, yaw rate, roll, pitch; NULL without a command. */
void oscillation_detector_step(oscillation_detector_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out);

#endif
