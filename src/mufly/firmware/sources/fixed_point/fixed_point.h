/* Fixed-point arithmetic: signals are multiples of 2^-20 (m, rad, V, full throw) in 32 bits.
 *
 * Rounding is to the nearest, halves away from zero; divisions truncate. No negative number is shifted, so C99 defines all
 * operations. Numbers beyond 32 bits saturate and are counted; the proof excludes them. */
#ifndef MUFLY_FIXED_POINT_H
#define MUFLY_FIXED_POINT_H

#ifndef MUFLY_DECLARATIONS /* set for cffi, which reads declarations only */
#include <stdbool.h>
#include <stdint.h>
#endif

#define FIXED_ONE 1048576 /* 1.0 */
#define FIXED_BITS 20
#define FIXED_UNIT 1073741824 /* 1.0 of a sine, 2^30 */

/* A 16-bit coefficient, and the shift that aligns its products within the row. */
typedef struct {
    int16_t c;
    uint8_t up;
} fixed_coefficient_t;

/* value / 2^bits, rounded; bits below 63. */
int64_t fixed_round_shift(int64_t value, uint32_t bits);

/* a b / 2^bits, rounded. */
int64_t fixed_multiply_shift(int64_t a, int64_t b, uint32_t bits);

int64_t fixed_clip(int64_t value, int64_t low, int64_t high);
int64_t fixed_abs(int64_t value);

/* Saturate to 32 bits; count an overflow in *overflows. */
int32_t fixed_saturate_int32(int64_t value, uint32_t *overflows);

/* Integer square root, rounded down; 0 for negative numbers. */
int64_t fixed_integer_sqrt(int64_t value);

/* Sine and cosine (2^-30) of an angle (2^-20 rad). */
void fixed_sine_cosine(int32_t angle, int32_t *sine, int32_t *cosine);

/* Row of a controller: sum of products, shifted right by down bits with rounding. */
int64_t fixed_dot(int32_t count, const fixed_coefficient_t row[], const int32_t by[], uint32_t down);

#endif
