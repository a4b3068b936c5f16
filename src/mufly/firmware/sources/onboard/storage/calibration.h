/* Calibration of the inertial unit and of the ranging sensors, applied to each new reading: (reading - offset) * scale. */
#ifndef MUFLY_CALIBRATION_H
#define MUFLY_CALIBRATION_H

#include "hal.h"

typedef struct {
    real_t acceleration_offset[3]; /* body axes (m/s2) */
    real_t acceleration_scale[3];
    real_t rate_offset[3];         /* body axes (rad/s) */
    real_t ring_offset, ring_scale;   /* all beams of the ring; offset in m */
    real_t sonar_offset, sonar_scale; /* the sensor downwards; offset in m */
} calibration_t;

/* No offset, scale one. */
void calibration_reset(calibration_t *c);

/* Calibrate the new readings of a period; call once a period. */
void calibrate_readings(const calibration_t *c, hal_readings_t *r);

#endif
