/* Estimate at one instant, output of the estimator and input of the flight software, and its monitor: bridging of gaps.
 *
 * Explanation: estimator.py of mufly.estimate. */
#ifndef MUFLY_ESTIMATOR_H
#define MUFLY_ESTIMATOR_H

#include "flight/controllers.h"
#include "mission/avoidance.h"

/* Sensors, in the order of READINGS_WITH_FUSION_STATUS (quantity_table.py of mufly.quantities). */
enum {
    SENSOR_ACCELERATION,
    SENSOR_RATES,
    SENSOR_SONAR,
    SENSOR_RANGES,
    SENSOR_PRESSURE,
    SENSOR_MAGNETIC,
    SENSOR_ROTOR_SPEED,
    SENSOR_FIX,
    SENSOR_BATTERY,
    ESTIMATE_SENSORS
};

/* Status of a sensor, in the order of sensor_checks.py of mufly.estimate; NOT_FITTED: the vehicle lacks the sensor. */
enum { SENSOR_WAITING, SENSOR_FUSED, SENSOR_REJECTED, SENSOR_MISSING, SENSOR_FAULTY, SENSOR_NOT_FITTED };

typedef struct {
    int32_t status;
    int32_t why;   /* reason as a code of sensor_checks.py, with its number */
    real_t number;
} sensor_status_t;

typedef struct {
    real_t time_s;
    motion_estimate_t motion;              /* NaN: unknown */
    real_t ranges[MAX_BEAMS];   /* ranges of the ring's beams (m) */
    bool valid;                   /* whether the estimate may be used for flight */
    bool judged;                  /* whether the following fields are set; an ideal estimator does not */
    real_t position_variance[3];  /* N, E, D (m2) */
    real_t attitude_variance[3];  /* roll, pitch, yaw (rad2) */
    sensor_status_t checks[ESTIMATE_SENSORS];
    real_t specific_force[3];     /* last reading of the accelerometers (m/s2) */
} estimate_t;

/* Copy an estimate, with as many ranges as there are beams. */
void copy_estimate(const estimate_t *from, int32_t beams, estimate_t *to);

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

#endif
