/* Self-test of the fixed-point law in fixed_point/, as selftest.c. */
#include "check/programs/made_up.h"
#include "fixed_point/fixed_point_law.h"

#define PERIODS 4000

/* Within -size..size, size in 2^-20. */
static int32_t random_int(int32_t size)
{
    return (int32_t)((((int64_t)random_bits() - 2147483648LL) * size) / 2147483648LL);
}

static void any_three(int32_t size, int32_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = random_int(size);
    }
}

static void digest_actuators(uint64_t *digest, const fixed_actuators_t *out)
{
    const int32_t all[4] = {out->motor_input[0], out->motor_input[1], out->servo_input[0], out->servo_input[1]};

    for (int32_t i = 0; i < 4; i++) {
        digest_bits(digest, (uint32_t)all[i]);
    }
}

static void any_motion(fixed_motion_t *now)
{
    any_three(FIXED_ONE / 2, now->position);
    any_three(FIXED_ONE / 2, now->velocity);
    any_three(FIXED_ONE / 4, now->attitude);
    now->attitude[2] *= 40;
    any_three(FIXED_ONE, now->rates);
    now->voltage = (7 * FIXED_ONE) + random_int(FIXED_ONE + (FIXED_ONE / 2));
}

int main(void)
{
    static fixed_controllers_t c;
    static fixed_motion_t now;
    static fixed_path_t path;
    static fixed_actuators_t out;
    int32_t tilt[2] = {0, 0};
    int32_t wanted[4];
    const int32_t engaged[2] = {FIXED_ONE / 2, FIXED_ONE / 2};
    uint64_t digest = DIGEST_START;
    cost_t cost = {0U, 0U, 0U};

    platform_start();
    any_motion(&now);
    fixed_engage_heave_yaw(&mufly_fixed_gains, &c, &now, engaged);
    fixed_engage_roll_pitch(&mufly_fixed_gains, &c, &now);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;

        any_motion(&now);
        any_three(FIXED_ONE, path.position);
        any_three(FIXED_ONE / 2, path.velocity);
        any_three(FIXED_ONE, path.acceleration);
        for (int32_t i = 0; i < 4; i++) {
            wanted[i] = random_int(FIXED_ONE / 2);
        }
        before = platform_count();
        if ((k % mufly_fixed_position_divider) == 0) {
            fixed_compute_tilt_command(&mufly_fixed_gains, &c, &now, &path, tilt);
        }
        fixed_step(&mufly_fixed_gains, &c, &now, wanted, true, tilt, &out);
        add_cost(&cost, platform_count() - before);
        digest_actuators(&digest, &out);
        print_digest(digest, k, PERIODS);
    }
    platform_print("outputs ", digest);
    platform_print("overflows ", c.overflows);
    print_cost(&cost);
    return 0;
}
