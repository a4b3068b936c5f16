/* What is made of an estimate before it is flown by, and of actuators: bridging, smoothing, doubts, oscillation.
 *
 * What it does and why: estimate.py of mufly.estimate; trust.py, oscillation.py of mufly.flight. */
#ifndef MUFLY_WATCH_H
#define MUFLY_WATCH_H

#include "belief.h"
#include "words.h"

/* Height uncertain by more is not known (m). */
#define MAX_HEIGHT_SIGMA_M REAL(0.3)

/* An estimate that cannot be right is bridged for a moment, then reported as lost. */
typedef struct {
    bool begun;
    real_t values[12]; /* position, velocity, attitude and rates as they came last */
    estimate_t good;     /* finite, and on a clock that moves on */
    real_t lost_s;     /* for how long they have been missing or frozen */
    int32_t what;      /* which: 1 position, 2 velocity, 4 attitude, 8 rates; 0: all, frozen */
} estimate_monitor_t;

void estimate_monitor_start(estimate_monitor_t *w);
void check_estimate(estimate_monitor_t *w, const estimate_t *m, real_t period_s, const beam_ring_t *ring);

/* Position and heading without the steps of a filter's corrections. */
typedef struct {
    bool begun;
    real_t last_s;
    real_t last_velocity[3]; /* the last one */
    real_t smoothed_position[3];
    real_t smoothed_heading;
} correction_smoother_t;

void correction_smoother_reset(correction_smoother_t *s);

/* Change an estimate to the one to control by; anew: nothing is controlled yet. */
void correction_smoother_step(correction_smoother_t *s, estimate_t *m, bool anew);

/* What an estimate is not good enough for: go on, hold, land, sink. */
enum { FAILSAFE_NONE, FAILSAFE_HOLD, FAILSAFE_LAND, FAILSAFE_SINK };

typedef struct {
    int32_t action;
    message_t reason;
} health_verdict_t;

typedef struct {
    health_verdict_t verdict;
    real_t floor_variance_m2; /* variance of the horizontal position on the floor (m2) */
    bool has_fault[ESTIMATE_SENSORS];
    real_t fault_since_s[ESTIMATE_SENSORS]; /* since when */
    real_t hold_since_s;
    bool is_certain;
    real_t certain_since_s;
    bool height_uncertain; /* the height is uncertain */
    real_t height_uncertain_since_s;
} health_monitor_t;

/* Whether the rates of turn are those of the rotor model, as gyroscopes say nothing that can be right. */
bool gyro_unavailable(const estimate_t *m);

void health_monitor_reset(health_monitor_t *d, real_t stood);

/* Judge an estimate in the air; true if what is doubted has been said anew. */
bool health_monitor_step(health_monitor_t *d, const estimate_t *m);

/* Whether actuators oscillate: even periods of half of an input's range, on end, that nobody asked for. */
#define OSCILLATION_INPUTS 4
#define STEERING_SIGNALS 6

typedef struct {
    real_t reversal_threshold;
    bool is_rising;
    real_t last_extreme, extreme_time_s;
    int32_t turn_count; /* of those below */
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

/* Take one more instant. asked: velocity N, E, D, rate of turn, roll, pitch that somebody asks for; NULL: nobody. */
void oscillation_detector_step(oscillation_detector_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out);

#endif
