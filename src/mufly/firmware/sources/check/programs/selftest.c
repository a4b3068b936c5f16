/* Self-test of the controllers: prints digests of the outputs for synthetic inputs.
 *
 * Builds for this machine and for a board must print equal digests; the last lines give the cost of a period. A generator
 * of 32-bit integers makes the inputs independent of the platform's library. */
#include "check/programs/made_up.h"
#include "flight/controllers.h"

#define PERIODS 4000

static void any_three(real_t size, real_t out[3])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = random_number(size);
    }
}

static void digest_actuators(uint64_t *digest, const actuators_t *out)
{
    const real_t all[4] = {out->motor_input[0], out->motor_input[1], out->servo_input[0], out->servo_input[1]};

    digest_all(digest, all, 4);
}

static void any_motion(motion_estimate_t *now)
{
    any_three(REAL(0.5), now->position);
    any_three(REAL(0.5), now->velocity);
    any_three(REAL(0.3), now->attitude);
    now->attitude[2] *= REAL(40.0);
    any_three(REAL(1.0), now->rates);
    now->voltage = REAL(7.0) + random_number(REAL(1.5));
}

int main(void)
{
    static controllers_t c;
    static motion_estimate_t now;
    static path_t path;
    static actuators_t out;
    real_t tilt[2] = {REAL(0.0), REAL(0.0)};
    real_t wanted[4];
    const real_t engaged[2] = {REAL(0.5), REAL(0.5)};
    uint64_t digest = DIGEST_START;
    cost_t cost = {0U, 0U, 0U};

    platform_start();
    any_motion(&now);
    controllers_engage_heave_yaw(&mufly_gains, &c, &now, engaged);
    controllers_engage_roll_pitch(&mufly_gains, &c, &now);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;

        any_motion(&now);
        any_three(REAL(1.0), path.position);
        any_three(REAL(0.5), path.velocity);
        any_three(REAL(1.0), path.acceleration);
        for (int32_t i = 0; i < 4; i++) {
            wanted[i] = random_number(REAL(0.5));
        }
        before = platform_count();
        if ((k % mufly_position_divider) == 0) {
            controllers_compute_tilt_command(&mufly_gains, &c, &now, &path, tilt);
        }
        controllers_step(&mufly_gains, &c, &now, wanted, true, tilt, &out);
        add_cost(&cost, platform_count() - before);
        digest_actuators(&digest, &out);
        print_digest(digest, k, PERIODS);
    }
    platform_print("outputs ", digest);
    print_cost(&cost);
    return 0;
}
