/* Sine and cosine: the angle is brought into a quarter turn around zero by taking away n times pi/2, in three pieces of
 * which the first two are short enough for the products to be exact; there the series of Taylor does. Which of the two
 * it is, with which sign, says the quadrant. Decay: two to the power of -n, times the series. */
#include "real.h"

#define GREATEST REAL(1e5)
#define TWO_OVER_PI REAL(0x1.45f306dc9c883p-1)
#define PER_LN2 REAL(0x1.71547652b82fep+0)
#ifdef MUFLY_FLOAT
#define PI_HALF_1 REAL(0x1.92p+0)
#define PI_HALF_2 REAL(0x1.fbp-12)
#define PI_HALF_3 REAL(0x1.5110b4p-22)
#define LN2_1 REAL(0x1.62e3p-1)
#define LN2_2 REAL(0x1.2fefa2p-17)
#else
#define PI_HALF_1 REAL(0x1.921fb54400000p+0)
#define PI_HALF_2 REAL(0x1.0b4611a600000p-34)
#define PI_HALF_3 REAL(0x1.3198a2e037073p-69)
#define LN2_1 REAL(0x1.62e42fee00000p-1)
#define LN2_2 REAL(0x1.a39ef35793c76p-33)
#endif

#ifdef MUFLY_FLOAT
#define SQRT __builtin_sqrtf
#define ABS __builtin_fabsf
#define WITH_SIGN __builtin_copysignf
#else
#define SQRT __builtin_sqrt
#define ABS __builtin_fabs
#define WITH_SIGN __builtin_copysign
#endif

real_t real_sqrt(real_t x)
{
    return SQRT(x);
}

real_t real_abs(real_t x)
{
    return ABS(x);
}

real_t real_with_sign(real_t size, real_t sign)
{
    return WITH_SIGN(size, sign);
}

real_t real_clip(real_t value, real_t low, real_t high)
{
    real_t held = value;
    if (value < low) {
        held = low;
    } else if (value > high) {
        held = high;
    } else {
        /* within bounds */
    }
    return held;
}

void sine_cosine(real_t angle, real_t *sine, real_t *cosine)
{
    *sine = REAL(0.0);
    *cosine = REAL(1.0);
    if (real_abs(angle) < GREATEST) {
        const real_t half = (angle >= REAL(0.0)) ? REAL(0.5) : REAL(-0.5);
        const int32_t n = (int32_t)((angle * TWO_OVER_PI) + half);
        const real_t turns = (real_t)n;
        const real_t r = ((angle - (turns * PI_HALF_1)) - (turns * PI_HALF_2)) - (turns * PI_HALF_3);
        const real_t q = r * r;
        real_t s = REAL(1.0) / REAL(355687428096000.0);
        real_t c = REAL(1.0) / REAL(20922789888000.0);
        int32_t quadrant = n % 4;

        s = (REAL(-1.0) / REAL(1307674368000.0)) + (q * s);
        s = (REAL(1.0) / REAL(6227020800.0)) + (q * s);
        s = (REAL(-1.0) / REAL(39916800.0)) + (q * s);
        s = (REAL(1.0) / REAL(362880.0)) + (q * s);
        s = (REAL(-1.0) / REAL(5040.0)) + (q * s);
        s = (REAL(1.0) / REAL(120.0)) + (q * s);
        s = (REAL(-1.0) / REAL(6.0)) + (q * s);
        s = r + (r * (q * s));
        c = (REAL(-1.0) / REAL(87178291200.0)) + (q * c);
        c = (REAL(1.0) / REAL(479001600.0)) + (q * c);
        c = (REAL(-1.0) / REAL(3628800.0)) + (q * c);
        c = (REAL(1.0) / REAL(40320.0)) + (q * c);
        c = (REAL(-1.0) / REAL(720.0)) + (q * c);
        c = (REAL(1.0) / REAL(24.0)) + (q * c);
        c = REAL(-0.5) + (q * c);
        c = REAL(1.0) + (q * c);

        if (quadrant < 0) {
            quadrant += 4;
        }
        switch (quadrant) {
        case 0:
            *sine = s;
            *cosine = c;
            break;
        case 1:
            *sine = c;
            *cosine = -s;
            break;
        case 2:
            *sine = -s;
            *cosine = -c;
            break;
        default:
            *sine = -c;
            *cosine = s;
            break;
        }
    }
}

real_t decay(real_t x)
{
    real_t s = REAL(1.0);

    if (x > REAL(40.0)) {
        s = REAL(0.0);
    } else if (x > REAL(0.0)) {
        const int32_t n = (int32_t)((x * PER_LN2) + REAL(0.5));
        const real_t halvings = (real_t)n;
        const real_t r = (x - (halvings * LN2_1)) - (halvings * LN2_2);

        s = REAL(-1.0) / REAL(6227020800.0);
        s = (REAL(1.0) / REAL(479001600.0)) + (r * s);
        s = (REAL(-1.0) / REAL(39916800.0)) + (r * s);
        s = (REAL(1.0) / REAL(3628800.0)) + (r * s);
        s = (REAL(-1.0) / REAL(362880.0)) + (r * s);
        s = (REAL(1.0) / REAL(40320.0)) + (r * s);
        s = (REAL(-1.0) / REAL(5040.0)) + (r * s);
        s = (REAL(1.0) / REAL(720.0)) + (r * s);
        s = (REAL(-1.0) / REAL(120.0)) + (r * s);
        s = (REAL(1.0) / REAL(24.0)) + (r * s);
        s = (REAL(-1.0) / REAL(6.0)) + (r * s);
        s = REAL(0.5) + (r * s);
        s = REAL(1.0) - (r * (REAL(1.0) - (r * s)));
        for (int32_t k = 0; k < n; k++) {
            s = REAL(0.5) * s;
        }
    } else {
        /* nothing has passed */
    }
    return s;
}
