/* Fusion of each measurement, with its gate and its reset. z: the measurement; ahead: its time after the horizon (s). */
#ifndef MUFLY_FUSION_H
#define MUFLY_FUSION_H

#include "estimate/filter/records.h"

/* Return the cost in scalar measurements; for the ring, the number of beams for which there is time. */
int32_t measurement_cost(const estimator_t *m, const estimator_settings_t *s, int32_t kind, int32_t left);
/* Fuse queued measurement i, as far as the budget cost permits; return whether all of it is fused. */
bool fuse_measurement(estimator_t *m, const estimator_settings_t *s, int32_t i, int32_t cost);

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
