#include "control/mixer.h"

void mixer_allocate(const real_t asked[2], real_t top, real_t *mean, real_t *half)
{
    *half = real_clip(REAL(0.5) * (asked[1] - asked[0]), REAL(-0.5) * top, REAL(0.5) * top);
    *mean = real_clip(REAL(0.5) * (asked[1] + asked[0]), real_abs(*half), top - real_abs(*half));
}
