/* Sine and cosine: subtract n times pi/2, in three parts of which the first two give exact products, then evaluate the
 * Taylor series around zero. The quadrant selects sine or cosine and the sign. Decay: 2^-n times the series. */
#include "real.h"

#define MAX_ANGLE REAL(1e5)
#define MAX_ATAN2_COMPONENT REAL(1e30)
#define TWO_OVER_PI REAL(0x1.45f306dc9c883p-1)
#define PER_LN2 REAL(0x1.71547652b82fep+0)
#ifdef MUFLY_FLOAT
#define PI_HALF_1 REAL(0x1.92p+0)
#define PI_HALF_2 REAL(0x1.fbp-12)
#define PI_HALF_3 REAL(0x1.5110b4p-22)
#define FULL_TURN_1 REAL(0x1.92p+2)
#define FULL_TURN_2 REAL(0x1.fb6p-10)
#define LN2_1 REAL(0x1.62e3p-1)
#define LN2_2 REAL(0x1.2fefa2p-17)
#else
#define PI_HALF_1 REAL(0x1.921fb54400000p+0)
#define PI_HALF_2 REAL(0x1.0b4611a600000p-34)
#define PI_HALF_3 REAL(0x1.3198a2e037073p-69)
#define FULL_TURN_1 REAL(0x1.921fb544p+2)
#define FULL_TURN_2 REAL(0x1.0b46p-32)
#define LN2_1 REAL(0x1.62e42fee00000p-1)
#define LN2_2 REAL(0x1.a39ef35793c76p-33)
#endif

#ifdef MUFLY_FLOAT
#define COPYSIGN __builtin_copysignf
#else
#define COPYSIGN __builtin_copysign
#endif

real_t real_copysign(real_t size, real_t sign)
{
    return COPYSIGN(size, sign);
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

bool real_is_nan(real_t x)
{
    return !(x <= REAL(0.0)) && !(x >= REAL(0.0));
}

bool real_is_finite(real_t x)
{
    return ABS(x) < REAL_INFINITY;
}

int32_t real_floor_int(real_t x)
{
    int32_t n = 0;

    if (real_abs(x) < REAL(1e9)) {
        n = (int32_t)x;
        if (x < (real_t)n) {
            n -= 1;
        }
    }
    return n;
}

int32_t wrap_index(int32_t k, int32_t n)
{
    const int32_t rest = k % n;

    return (rest < 0) ? (rest + n) : rest;
}

real_t real_hypot(real_t x, real_t y)
{
    return SQRT((x * x) + (y * y));
}

real_t real_vector_length(const real_t v[3])
{
    return SQRT(((v[0] * v[0]) + (v[1] * v[1])) + (v[2] * v[2]));
}

real_t real_atan2(real_t y, real_t x)
{
    static const real_t of_eighths[9] = {
        REAL(0x0.0p+0),
        REAL(0x1.fd5ba9aac2f6ep-4),
        REAL(0x1.f5b75f92c80ddp-3),
        REAL(0x1.6f61941e4def1p-2),
        REAL(0x1.dac670561bb4fp-2),
        REAL(0x1.1e00babdefeb4p-1),
        REAL(0x1.4978fa3269ee1p-1),
        REAL(0x1.700a7c5784634p-1),
        REAL(0x1.921fb54442d18p-1),
    };
    const real_t a = ABS(x);
    const real_t b = ABS(y);
    const real_t big = (a >= b) ? a : b;
    const real_t small = (a >= b) ? b : a;
    real_t angle = REAL(0.0);

    if ((big > REAL(0.0)) && (big < MAX_ATAN2_COMPONENT) && (small <= big)) {
        const int32_t n = (int32_t)(((REAL(8.0) * small) / big) + REAL(0.5));
        const real_t c = REAL(0.125) * (real_t)n;
        const real_t r = (small - (c * big)) / (big + (c * small));
        const real_t q = r * r;
        real_t s = REAL(1.0) / REAL(13.0);

        s = (REAL(-1.0) / REAL(11.0)) + (q * s);
        s = (REAL(1.0) / REAL(9.0)) + (q * s);
        s = (REAL(-1.0) / REAL(7.0)) + (q * s);
        s = (REAL(1.0) / REAL(5.0)) + (q * s);
        s = (REAL(-1.0) / REAL(3.0)) + (q * s);
        angle = of_eighths[n] + (r + (r * (q * s)));
        if (b > a) {
            angle = (REAL(0.5) * REAL_PI) - angle;
        }
        if (x < REAL(0.0)) {
            angle = REAL_PI - angle;
        }
        angle = COPYSIGN(angle, y);
    }
    return angle;
}

real_t real_wrap_angle(real_t angle)
{
    real_t rest = REAL(0.0);

    if (real_abs(angle) <= REAL_PI) {
        rest = angle;
    } else if (real_abs(angle) < MAX_ANGLE) {
        const real_t half = (angle >= REAL(0.0)) ? REAL(0.5) : REAL(-0.5);
        const real_t turns = (real_t)(int32_t)((angle * (REAL(0.25) * TWO_OVER_PI)) + half);

        rest = (angle - (turns * FULL_TURN_1)) - (turns * FULL_TURN_2);
    } else {
        /* NaN or beyond MAX_ANGLE: the angle counts as zero */
    }
    return rest;
}

void sine_cosine(real_t angle, real_t *sine, real_t *cosine)
{
    *sine = REAL(0.0);
    *cosine = REAL(1.0);
    if (real_abs(angle) < MAX_ANGLE) {
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

real_t exp_decay(real_t x)
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
