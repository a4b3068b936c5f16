/* What each reading tells of the state, and whether it is believed. z: the reading; ahead: by how much its instant lies
 * behind the horizon's (s). */
#ifndef MUFLY_FUSING_H
#define MUFLY_FUSING_H

#include "records.h"

void fuse_fix(estimator_t *m, const estimator_settings_t *s, const real_t z[4], real_t ahead);
void fuse_sonar(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead);
/* So many of its beams; whether that was the last. */
bool fuse_ring(estimator_t *m, const estimator_settings_t *s, const real_t z[BEAMS], real_t ahead, int32_t most);
void fuse_pressure(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead);
void fuse_magnet(estimator_t *m, const estimator_settings_t *s, const real_t z[3], real_t ahead);

/* Accelerometers less model along an axis, mean over so many periods. */
void fuse_force(estimator_t *m, const estimator_settings_t *s, int32_t count, int32_t i);

/* Standing: no velocity, no turning along an axis; with the motors off (still) accelerometers feel gravity alone. */
void fuse_rest(estimator_t *m, const estimator_settings_t *s, int32_t count, bool still, int32_t i);

/* How high the legs are above what lies below (m); that is not lower than the floor, whatever the sonar says. */
real_t height_over(const real_t x[STATES], const estimator_settings_t *s);

/* Back at about the height of the floor it is most likely the floor, and that one is known. */
void settle_floor(estimator_t *m);
/* Leaving the floor the rotors lift the weight and what it rises by: the thrust's scale, where the model lifts so much. */
void fuse_lift(estimator_t *m, real_t lift);
/* Legs do not go into what lies below; whether they were believed to. */
bool fuse_floor(estimator_t *m, const estimator_settings_t *s);

#endif
