/* Who gets the voltage: two motors that together ask for more than there is. */
#ifndef MUFLY_MIXER_H
#define MUFLY_MIXER_H

#include "real.h"

/* asked: lower, upper, as fractions of the design voltage; top: what the battery has. Yaw goes first: half the
 * difference (upper less lower) is kept as far as it goes, the mean of both gives way. */
void mixer_allocate(const real_t asked[2], real_t top, real_t *mean, real_t *half);

#endif
