/* Floating-point type and mathematical functions of the flight software.
 *
 * Double precision by default; single with -DMUFLY_FLOAT, for a processor with a single-precision unit. REAL(0x1.8p+0) is
 * a constant of that type. Build with -ffp-contract=off: a fused multiply-add rounds once instead of twice, and results
 * would differ from those of the simulation. */
#ifndef MUFLY_REAL_H
#define MUFLY_REAL_H

#ifndef MUFLY_DECLARATIONS /* set for cffi, which reads declarations only */
#include <stdbool.h>
#include <stdint.h>
#endif

#ifdef MUFLY_FLOAT
typedef float real_t;
#define REAL(x) (x##F)
#define REAL_INFINITY __builtin_inff()
#define REAL_NAN __builtin_nanf("")
#else
typedef double real_t;
#define REAL(x) (x)
#define REAL_INFINITY __builtin_inf()
#define REAL_NAN __builtin_nan("") /* not a number */
#endif

#define REAL_PI REAL(0x1.921fb54442d18p+1)
#define DEGREE REAL(0x1.1df46a2529d39p-6) /* rad */

#ifndef MUFLY_DECLARATIONS
#ifdef MUFLY_FLOAT
#define SQRT __builtin_sqrtf
#define ABS __builtin_fabsf
#else
#define SQRT __builtin_sqrt
#define ABS __builtin_fabs
#endif

/* Correctly rounded square root, and magnitude; single instructions where available. */
static inline real_t real_sqrt(real_t x)
{
    return SQRT(x);
}

static inline real_t real_abs(real_t x)
{
    return ABS(x);
}

/* Minimum and maximum; the first argument if both are equal, or if the second is NaN. */
static inline real_t real_min(real_t a, real_t b)
{
    return (b < a) ? b : a;
}

static inline real_t real_max(real_t a, real_t b)
{
    return (b > a) ? b : a;
}
#endif

/* A number with the sign of another; a number limited to bounds (NaN passes). */
real_t real_copysign(real_t size, real_t sign);
real_t real_clip(real_t value, real_t low, real_t high);

/* Whether a number is NaN, and whether it is finite. */
bool real_is_nan(real_t x);
bool real_is_finite(real_t x);

/* Largest integer not above x, zero for NaN or beyond 1e9; k modulo n, from 0 to n - 1. */
int32_t real_floor_int(real_t x);
int32_t wrap_index(int32_t k, int32_t n);

/* Length of a vector; the squares are added from left to right. */
real_t real_hypot(real_t x, real_t y);
real_t real_vector_length(const real_t v[3]);

/* Angle (rad) from the first axis to (x, y); zero for a zero vector. */
real_t real_atan2(real_t y, real_t x);

/* Angle wrapped to -pi to pi (rad). */
real_t real_wrap_angle(real_t angle);

/* Sine and cosine of an angle (rad), equal bit for bit on all machines. Beyond 1e5 rad: those of zero. */
void sine_cosine(real_t angle, real_t *sine, real_t *cosine);

/* exp(-x) for x >= 0, equal bit for bit on all machines; 1 for x < 0, 0 beyond 40. */
real_t exp_decay(real_t x);

#endif
