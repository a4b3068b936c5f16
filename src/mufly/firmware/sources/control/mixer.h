/* Allocation of the available voltage to two motors that request more than it. */
#ifndef MUFLY_MIXER_H
#define MUFLY_MIXER_H

#include "real.h"

/* asked: lower, upper, as fractions of the design voltage; top: voltage of the battery. Yaw has priority: half the
 * difference (upper less lower) is kept as far as possible, and the mean is reduced. */
void mixer_allocate(const real_t asked[2], real_t top, real_t *mean, real_t *half);

#endif
