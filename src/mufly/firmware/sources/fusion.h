/* Fusion of each measurement, with its gate and its reset. z: the measurement; ahead: its time after the horizon (s). */
#ifndef MUFLY_FUSION_H
#define MUFLY_FUSION_H

#include "records.h"

/* Fuse position and heading of a fix; no height while it disagrees with the sonar. */
void fuse_position_fix(estimator_t *m, const estimator_settings_t *s, const real_t z[4], real_t ahead);
/* Fuse the range to the surface below; a step that no other sensor sees belongs to the terrain. */
void fuse_sonar_range(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead);
/* Fuse at most this many beams; return whether that was the last. */
bool fuse_wall_ranges(estimator_t *m, const estimator_settings_t *s, const real_t z[MAX_FUSED_BEAMS], real_t ahead, int32_t most);
/* Fuse the pressure less the standard one and less the rotors' part. */
void fuse_pressure_height(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead);
/* Fuse the heading by the direction of the magnetic field. */
void fuse_magnetic_heading(estimator_t *m, const estimator_settings_t *s, const real_t z[3], real_t ahead);

/* Fuse accelerometers less model along axis i, a mean over count periods: biases, thrust, wind, velocity. */
void fuse_accel_residual(estimator_t *m, const estimator_settings_t *s, int32_t count, int32_t i);

/* Fuse zero velocity and rate along axis i on the floor; with the motors off (still) also gravity. */
void fuse_zero_motion(estimator_t *m, const estimator_settings_t *s, int32_t count, int32_t mode, int32_t i);

/* Return the height of the legs above the surface below (m); that surface is not below the floor. */
real_t height_above_ground(const real_t x[STATE_COUNT], const estimator_settings_t *s);

/* Reset the terrain to the floor's height. */
void reset_terrain(estimator_t *m);
/* Fuse the thrust's scale at lift-off, where the rotors lift the weight; lift: the model's lift over it. */
void fuse_liftoff_thrust(estimator_t *m, real_t lift);
/* Keep the legs above the surface below, and stop a fall into it; return whether they were below. */
bool fuse_ground_contact(estimator_t *m, const estimator_settings_t *s);

#endif
