#include "fixed_point/fixed_point.h"

#define TWO_OVER_PI 683565276LL   /* 2^-30 */
#define HALF_PI 1727108826179LL   /* 2^-40 */

int64_t fixed_round_shift(int64_t value, uint32_t bits)
{
    int64_t rounded = value;

    if (bits > 0U) {
        const uint64_t half = (uint64_t)1U << (bits - 1U);
        if (value >= 0) {
            rounded = (int64_t)(((uint64_t)value + half) >> bits);
        } else {
            rounded = -(int64_t)(((uint64_t)(-value) + half) >> bits);
        }
    }
    return rounded;
}

int64_t fixed_multiply_shift(int64_t a, int64_t b, uint32_t bits)
{
    return fixed_round_shift(a * b, bits);
}

int64_t fixed_clip(int64_t value, int64_t low, int64_t high)
{
    int64_t held = value;

    if (value < low) {
        held = low;
    } else if (value > high) {
        held = high;
    } else {
        /* within bounds */
    }
    return held;
}

int64_t fixed_abs(int64_t value)
{
    return (value < 0) ? -value : value;
}

int32_t fixed_saturate_int32(int64_t value, uint32_t *overflows)
{
    const int64_t held = fixed_clip(value, INT32_MIN, INT32_MAX);

    if (held != value) {
        *overflows += 1U;
    }
    return (int32_t)held;
}

int64_t fixed_integer_sqrt(int64_t value)
{
    uint64_t left = (value > 0) ? (uint64_t)value : 0U;
    uint64_t root = 0U;
    uint64_t bit = (uint64_t)1U << 62U;

    while (bit > left) {
        bit >>= 2U;
    }
    while (bit != 0U) {
        if (left >= (root + bit)) {
            left -= root + bit;
            root = (root >> 1U) + bit;
        } else {
            root >>= 1U;
        }
        bit >>= 2U;
    }
    return (int64_t)root;
}

/* Subtract n quarter turns from the angle, then evaluate the Taylor series. */
void fixed_sine_cosine(int32_t angle, int32_t *sine, int32_t *cosine)
{
    const int64_t n = fixed_multiply_shift(angle, TWO_OVER_PI, 50U);
    const int64_t r = fixed_round_shift(((int64_t)angle * FIXED_ONE) - (n * HALF_PI), 10U);
    const int64_t q = fixed_multiply_shift(r, r, 30U);
    int64_t s = 2959; /* 1/9! */
    int64_t c = -296; /* -1/10! */
    int32_t quadrant = (int32_t)(n % 4);

    s = -213044 + fixed_multiply_shift(q, s, 30U);
    s = 8947849 + fixed_multiply_shift(q, s, 30U);
    s = -178956971 + fixed_multiply_shift(q, s, 30U);
    s = r + fixed_multiply_shift(r, fixed_multiply_shift(q, s, 30U), 30U);
    c = 26631 + fixed_multiply_shift(q, c, 30U);
    c = -1491308 + fixed_multiply_shift(q, c, 30U);
    c = 44739243 + fixed_multiply_shift(q, c, 30U);
    c = -536870912 + fixed_multiply_shift(q, c, 30U);
    c = FIXED_UNIT + fixed_multiply_shift(q, c, 30U);
    if (quadrant < 0) {
        quadrant += 4;
    }
    switch (quadrant) {
    case 0:
        *sine = (int32_t)s;
        *cosine = (int32_t)c;
        break;
    case 1:
        *sine = (int32_t)c;
        *cosine = (int32_t)-s;
        break;
    case 2:
        *sine = (int32_t)-s;
        *cosine = (int32_t)-c;
        break;
    default:
        *sine = (int32_t)-c;
        *cosine = (int32_t)s;
        break;
    }
}

int64_t fixed_dot(int32_t count, const fixed_coefficient_t row[], const int32_t by[], uint32_t down)
{
    int64_t sum = 0;

    for (int32_t j = 0; j < count; j++) {
        if (row[j].c != 0) { /* most are zero in modal form */
            sum += ((int64_t)row[j].c * by[j]) * (int64_t)((uint64_t)1U << row[j].up);
        }
    }
    return fixed_round_shift(sum, down);
}
