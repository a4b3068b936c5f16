/* Checks of readings by themselves and against the models, and the status of each sensor. */
#ifndef MUFLY_SENSOR_CHECKS_H
#define MUFLY_SENSOR_CHECKS_H

#include "estimate/filter/records.h"

/* Set status and reason of a sensor for FAULT_HOLD_S. */
void set_fault(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t code, int32_t why, real_t number);

/* Mark a reading as fused: reset its rejections and clear a fault that has run out. */
void mark_fused(estimator_t *m, int32_t k);
/* Mark a reading as rejected; report it when the rejections reach the alarm. */
void mark_rejected(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t why, real_t number);

/* Check new readings for limits, age, repetition and silence. */
void check_readings(estimator_t *m, const estimator_settings_t *s, real_t z[INPUT_VALUE_COUNT], int32_t fresh[SENSOR_COUNT],
             const real_t age[SENSOR_COUNT]);

/* Inflate the variances of gyroscope bias, attitude and velocity after persistent innovations of the fix. */
void inflate_variances_on_divergence(estimator_t *m, const estimator_settings_t *s);

/* Replace a spike of the gyroscopes by the model's rate, and remove a jump as an offset. */
void replace_gyro_spikes(estimator_t *m, const estimator_settings_t *s, bool flying);

/* Return whether measured rotor speeds agree with the motors' equations. */
bool check_rotor_speed(estimator_t *m, const estimator_settings_t *s, const real_t speed[2]);
/* Return whether the measured voltage agrees with the battery's model. */
bool check_battery_voltage(estimator_t *m, const estimator_settings_t *s, real_t off);
/* Compare the mean of accelerometers less model over 0.4 s with its expected deviation. */
void check_accel_model(estimator_t *m, const estimator_settings_t *s, const real_t r[9], real_t height, real_t nu,
                       real_t variance, real_t known, int32_t i);

#endif
