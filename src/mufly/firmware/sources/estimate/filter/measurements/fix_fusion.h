/* Fusion of a fix of position and heading: noise and bias of the fix, its agreement with the sonar, its reset. */
#ifndef MUFLY_FIX_FUSION_H
#define MUFLY_FIX_FUSION_H

#include "estimate/filter/records.h"

/* Fuse position and heading of a fix; no height while it disagrees with the sonar. */
void fuse_position_fix(estimator_t *m, const estimator_settings_t *s, const real_t z[4], real_t ahead);

/* Predict the bias of the fix to the horizon; N and E over the same time. */
void predict_fix_bias(estimator_t *m, const estimator_settings_t *s);

#endif
