/* What is believed at one instant: what an estimator hands over, and what the flight software goes by. */
#ifndef MUFLY_BELIEF_H
#define MUFLY_BELIEF_H

#include "avoid.h"
#include "controllers.h"

/* Sensors, in the order of CHECKED (layout.py of mufly.estimate). */
enum {
    BELIEF_ACCELERATION,
    BELIEF_RATES,
    BELIEF_SONAR,
    BELIEF_RANGES,
    BELIEF_PRESSURE,
    BELIEF_MAGNETIC,
    BELIEF_ROTOR_SPEED,
    BELIEF_FIX,
    BELIEF_BATTERY,
    BELIEF_SENSORS
};

/* What is thought of a sensor, in the order of sensor_checks.py of mufly.estimate; NOT_FITTED: it is not on board. */
enum { BELIEF_WAITING, BELIEF_FUSED, BELIEF_REJECTED, BELIEF_MISSING, BELIEF_FAULTY, BELIEF_NOT_FITTED };

typedef struct {
    int32_t status;
    int32_t why;   /* the reason as a code of sensor_checks.py, with its number */
    real_t number;
} check_t;

typedef struct {
    real_t time_s;
    motion_t motion;              /* not a number: not known */
    real_t ranges[AVOID_BEAMS];   /* of the ring's beams (m) */
    bool valid;                   /* whether the estimator stands by it */
    bool judged;                  /* whether the rest is given: not by one that is told the truth */
    real_t position_variance[3];  /* N, E, D (m2) */
    real_t attitude_variance[3];  /* roll, pitch, yaw (rad2) */
    check_t checks[BELIEF_SENSORS];
} belief_t;

/* All of it, with as many ranges as there are beams. */
void belief_copy(const belief_t *from, int32_t beams, belief_t *to);

#endif
