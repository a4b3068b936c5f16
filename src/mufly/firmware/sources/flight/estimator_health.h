/* Monitor of the estimate in flight, and its position and heading without the steps of corrections.
 *
 * Explanation: estimator_health.py of mufly.flight. */
#ifndef MUFLY_ESTIMATOR_HEALTH_H
#define MUFLY_ESTIMATOR_HEALTH_H

#include "estimate/estimator.h"
#include "mission/machine/log_messages.h"

/* Height deviation above which the height counts as unknown (m). */
#define MAX_HEIGHT_SIGMA_M REAL(0.3)

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
    real_t standing_position_variance_m2; /* variance of the horizontal position on the floor (m2) */
    bool has_fault[ESTIMATE_SENSORS];
    real_t fault_since_s[ESTIMATE_SENSORS]; /* start time of each fault */
    real_t hold_since_s;
    bool is_certain;
    real_t position_certain_since_s;
    bool height_uncertain; /* the height is uncertain */
    real_t height_uncertain_since_s;
} health_monitor_t;

/* Whether the angular rates come from the rotor model, since the gyroscopes are faulty. */
bool is_gyro_unavailable(const estimate_t *m);

void health_monitor_reset(health_monitor_t *d, real_t stood);

/* Evaluate an estimate in flight; return whether the message has changed. */
bool health_monitor_step(health_monitor_t *d, const estimate_t *m);

#endif
