/* Synthetic inputs and output digests of the self-tests, equal on all machines. */
#ifndef MUFLY_MADE_UP_H
#define MUFLY_MADE_UP_H

#include "real.h"

#define DIGEST_START 14695981039346656037ULL

static uint32_t seed = 2463534242U;

/* xorshift (Marsaglia 2003); a number in -1..1 with 24 bits, exact in both precisions. */
static real_t random_number(real_t size)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return size * (((real_t)(int32_t)(seed >> 8) - REAL(8388608.0)) * REAL(0x1p-23));
}

static uint64_t real_bits(real_t x)
{
    union {
        real_t number;
        uint8_t bytes[sizeof(real_t)];
    } as;
    uint64_t sum = 0U;

    as.number = x;
    for (uint32_t i = sizeof(real_t); i > 0U; i--) {
        sum = (sum << 8) | as.bytes[i - 1U];
    }
    return sum;
}

/* FNV-1a over the bits of every output so far */
static inline void digest_bits(uint64_t *digest, uint64_t what)
{
    *digest = (*digest ^ what) * 1099511628211ULL;
}

static inline void digest_all(uint64_t *digest, const real_t *numbers, int32_t count)
{
    for (int32_t i = 0; i < count; i++) {
        digest_bits(digest, real_bits(numbers[i]));
    }
}

#endif
