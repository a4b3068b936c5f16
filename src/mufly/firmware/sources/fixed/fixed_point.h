/* Whole numbers for a processor without a floating unit: signals are multiples of 2^-20 (m, rad, V, full throw) in 32 bits.
 *
 * Rounding is to the nearest, halves away from zero; a division drops what is left. Nothing negative is shifted, so all of
 * it is defined by C99. What does not fit 32 bits is held at their ends and counted; docs and tables say why none does. */
#ifndef MUFLY_FIXED_POINT_H
#define MUFLY_FIXED_POINT_H

#ifndef MUFLY_DECLARATIONS /* set to read the declarations alone, as cffi does */
#include <stdbool.h>
#include <stdint.h>
#endif

#define FIXED_ONE 1048576 /* 1.0 */
#define FIXED_BITS 20
#define FIXED_UNIT 1073741824 /* 1.0 of a sine, 2^30 */

/* A coefficient of 16 bits, and the power of two that brings its products to the one of its row. */
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

/* Held within 32 bits; one more in *overflows where it was not. */
int32_t fixed_saturate_int32(int64_t value, uint32_t *overflows);

/* The greatest whole number whose square is no more; 0 for negative ones. */
int64_t fixed_integer_sqrt(int64_t value);

/* Sine and cosine (2^-30) of an angle (2^-20 rad). */
void fixed_sine_cosine(int32_t angle, int32_t *sine, int32_t *cosine);

/* A row of a controller: the sum of its products, rounded by down bits. */
int64_t fixed_dot(int32_t count, const fixed_coefficient_t row[], const int32_t by[], uint32_t down);

#endif
