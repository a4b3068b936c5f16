/* The same numbers everywhere? A run of the controllers over made-up inputs, whose outputs are told bit by bit.
 *
 * Built for this machine and for a processor, both have to print the same outputs; the last lines tell what a period costs.
 * Inputs come from a generator of 32-bit integers, so that they are the same whatever the platform's library is. */
#include "controllers.h"
#include "platform.h"

#define PERIODS 4000
#define LINES 40

static uint32_t seed = 2463534242U;

/* xorshift (Marsaglia 2003); a number in -1..1 of 24 bits, which either precision holds. */
static real_t any(real_t size)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return size * (((real_t)(int32_t)(seed >> 8) - REAL(8388608.0)) * REAL(0x1p-23));
}

static void any_three(real_t size, real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = any(size);
    }
}

static uint64_t bits(real_t x)
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
static void take(uint64_t *digest, const actuators_t *out)
{
    const real_t all[4] = {out->motor_input[0], out->motor_input[1], out->servo_input[0], out->servo_input[1]};

    for (int32_t i = 0; i < 4; i++) {
        *digest = (*digest ^ bits(all[i])) * 1099511628211ULL;
    }
}

static void any_motion(motion_t *now)
{
    any_three(REAL(0.5), now->position);
    any_three(REAL(0.5), now->velocity);
    any_three(REAL(0.3), now->attitude);
    now->attitude[2] *= REAL(40.0);
    any_three(REAL(1.0), now->rates);
    now->voltage = REAL(7.0) + any(REAL(1.5));
}

int main(void)
{
    static controllers_t c;
    static motion_t now;
    static path_t path;
    static actuators_t out;
    real_t tilt[2] = {REAL(0.0), REAL(0.0)};
    real_t wanted[4];
    const real_t engaged[2] = {REAL(0.5), REAL(0.5)};
    uint64_t digest = 14695981039346656037ULL;
    uint32_t spent = 0U;
    uint32_t worst = 0U;

    platform_start();
    any_motion(&now);
    controllers_engage(&mufly_gains, &c, &now, engaged);
    controllers_lift_off(&mufly_gains, &c, &now);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;
        uint32_t took;

        any_motion(&now);
        any_three(REAL(1.0), path.position);
        any_three(REAL(0.5), path.velocity);
        any_three(REAL(1.0), path.acceleration);
        for (int32_t i = 0; i < 4; i++) {
            wanted[i] = any(REAL(0.5));
        }
        before = platform_count();
        if ((k % mufly_position_divider) == 0) {
            controllers_tilt(&mufly_gains, &c, &now, &path, tilt);
        }
        controllers_step(&mufly_gains, &c, &now, wanted, true, tilt, &out);
        took = platform_count() - before;
        spent += took;
        worst = (took > worst) ? took : worst;
        take(&digest, &out);
        if ((k % (PERIODS / LINES)) == 0) {
            platform_say("outputs ", digest);
        }
    }
    platform_say("outputs ", digest);
    platform_say("periods ", PERIODS);
    platform_say("ticks ", spent);
    platform_say("worst ", worst);
    platform_end();
    return 0;
}
