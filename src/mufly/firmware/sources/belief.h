/* What is believed at one instant: what an estimator hands over, and what the flight software goes by. */
#ifndef MUFLY_BELIEF_H
#define MUFLY_BELIEF_H

#include "avoid.h"
#include "controllers.h"

/* Sensors, in the order of CHECKED (layout.py of mufly.estimate). */
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

/* What is thought of a sensor, in the order of sensor_checks.py of mufly.estimate; NOT_FITTED: it is not on board. */
enum { SENSOR_WAITING, SENSOR_FUSED, SENSOR_REJECTED, SENSOR_MISSING, SENSOR_FAULTY, SENSOR_NOT_FITTED };

typedef struct {
    int32_t status;
    int32_t why;   /* the reason as a code of sensor_checks.py, with its number */
    real_t number;
} sensor_status_t;

typedef struct {
    real_t time_s;
    motion_estimate_t motion;              /* not a number: not known */
    real_t ranges[MAX_BEAMS];   /* of the ring's beams (m) */
    bool valid;                   /* whether the estimator stands by it */
    bool judged;                  /* whether the rest is given: not by one that is told the truth */
    real_t position_variance[3];  /* N, E, D (m2) */
    real_t attitude_variance[3];  /* roll, pitch, yaw (rad2) */
    sensor_status_t checks[ESTIMATE_SENSORS];
} estimate_t;

/* All of it, with as many ranges as there are beams. */
void copy_estimate(const estimate_t *from, int32_t beams, estimate_t *to);

#endif
