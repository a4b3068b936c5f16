/* Random numbers of sensors, equal to those of mufly.sensors.rng to the last bit.

   A source is a counter, whose bits splitmix64 mixes (Steele, Lea, Flood, OOPSLA 2014); two uniform numbers give two normal
   numbers (Box and Muller, Ann. Math. Stat. 29, 1958). The series are those of the Python source. */

#ifndef RANDOM_NUMBERS_H
#define RANDOM_NUMBERS_H

#define COUNTER_STEP UINT64_C(0x9E3779B97F4A7C15)
#define EXPONENT_OF_ONE UINT64_C(0x3FF0000000000000) /* exponent bits of numbers from 1 to 2 */

static double bits_to_real(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static uint64_t real_to_bits(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* A uniform number from 1 to 2 for a counter. */
static double uniform_1_to_2(uint64_t counter)
{
    uint64_t z = (counter ^ (counter >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return bits_to_real(((z ^ (z >> 31)) >> 12) | EXPONENT_OF_ONE);
}

/* Two standard normal numbers from two uniform numbers between 1 and 2. */
static void normal_pair(double a, double b, double *first, double *second)
{
    const uint64_t bits = real_to_bits(2.0 - a); /* above 0, up to 1 */
    double power = bits_to_real(UINT64_C(0x4330000000000000) | (bits >> 52)) - 4503599627371519.0; /* 2^52 + 1023 */
    double m = bits_to_real((bits & UINT64_C(0x000FFFFFFFFFFFFF)) | EXPONENT_OF_ONE);
    if (m > 0x1.6a09e667f3bcdp+0) { /* the root of 2 */
        m = 0.5 * m;
        power = power + 1.0;
    }
    const double s = (m - 1.0) / (m + 1.0), q = s * s;
    const double series = 1.0 + q * (1.0 / 3 + q * (1.0 / 5 + q * (1.0 / 7 + q * (1.0 / 9 + q * (1.0 / 11 + q * (1.0 / 13 +
        q * (1.0 / 15)))))));
    const double far_off = sqrt(-(power * 0x1.62e42fefa39efp-1 + 2.0 * s * series)); /* ln 2 */
    const double x = b - 1.5, y = (x > 0.0 ? x : -x) - 0.25; /* turns */
    const double t = 2.0 * 0x1.921fb54442d18p+1 * ((y > 0.0 ? y : -y) - 0.125), p = t * t;
    const double sine = t * (1.0 + p * (-1.0 / 6 + p * (1.0 / 120 + p * (-1.0 / 5040 + p * (1.0 / 362880 + p * (
        -1.0 / 39916800 + p * (1.0 / 6227020800)))))));
    const double cosine = 1.0 + p * (-1.0 / 2 + p * (1.0 / 24 + p * (-1.0 / 720 + p * (1.0 / 40320 + p * (-1.0 / 3628800 +
        p * (1.0 / 479001600 + p * (-1.0 / 87178291200)))))));
    const double low = far_off * (cosine - sine), high = far_off * (cosine + sine);
    *first = x > 0.0 ? low : -low;
    *second = y > 0.0 ? high : -high;
}

/* Write the next normal numbers of a source. */
static void draw_normals(uint64_t *source, double *out, int64_t size)
{
    const uint64_t start = *source;
    const int64_t half = size / 2;
    double unused;
    *source = start + (uint64_t)(size + size % 2) * COUNTER_STEP;
    for (int64_t i = 0; i < half + size % 2; i++) {
        const uint64_t at = start + (uint64_t)(2 * i) * COUNTER_STEP;
        double *first = i < half ? out + i : out + 2 * half, *second = i < half ? out + half + i : &unused;
        normal_pair(uniform_1_to_2(at), uniform_1_to_2(at + COUNTER_STEP), first, second);
    }
}

/* Write the next uniform numbers of a source, in [0, 1). */
static void draw_uniforms(uint64_t *source, double *out, int64_t size)
{
    const uint64_t start = *source;
    *source = start + (uint64_t)size * COUNTER_STEP;
    for (int64_t i = 0; i < size; i++) {
        out[i] = uniform_1_to_2(start + (uint64_t)i * COUNTER_STEP) - 1.0;
    }
}

#endif
