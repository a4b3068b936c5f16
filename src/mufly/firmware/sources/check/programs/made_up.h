/* Synthetic inputs, output digests and costs of the self-tests, equal on all machines. */
#ifndef MUFLY_MADE_UP_H
#define MUFLY_MADE_UP_H

#include "check/platforms/platform.h"
#include "real.h"

#define DIGEST_START 14695981039346656037ULL
#define DIGEST_LINES 40

static uint32_t seed = 2463534242U;

/* xorshift (Marsaglia 2003) */
static inline uint32_t random_bits(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed;
}

/* A number in -size..size with 24 bits, exact in both precisions. */
static inline real_t random_number(real_t size)
{
    return size * (((real_t)(int32_t)(random_bits() >> 8) - REAL(8388608.0)) * REAL(0x1p-23));
}

static inline uint64_t real_bits(real_t x)
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

/* Print the digest after period k, if a line is due. */
static inline void print_digest(uint64_t digest, int32_t k, int32_t periods)
{
    if ((k % (periods / DIGEST_LINES)) == 0) {
        platform_print("outputs ", digest);
    }
}

/* Cost of periods, in ticks of the platform's clock. */
typedef struct {
    uint32_t periods;
    uint32_t spent;
    uint32_t worst;
} cost_t;

static inline void add_cost(cost_t *cost, uint32_t ticks)
{
    cost->periods += 1U;
    cost->spent += ticks;
    cost->worst = (ticks > cost->worst) ? ticks : cost->worst;
}

/* Print the cost and end the program. */
static inline void print_cost(const cost_t *cost)
{
    platform_print("periods ", cost->periods);
    platform_print("ticks ", cost->spent);
    platform_print("worst ", cost->worst);
    platform_end();
}

#endif
