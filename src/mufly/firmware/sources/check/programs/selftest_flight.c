/* Self-test of the flight software: plan.c is flown for a vehicle model that follows the references with a lag. Estimates
 * are sometimes bad, walls and user signals are random. The program prints digests of outputs and log, then the cost of a
 * period. */
#include "check/programs/made_up.h"
#include "flight/flight_software.h"

#define PERIODS 16000
#define UNDISTURBED_PERIODS 8400 /* periods of the mission without user signals */

static int32_t random_below(int32_t count)
{
    (void)random_number(REAL(1.0));
    return (int32_t)((seed >> 8) % (uint32_t)count);
}

static void clear_command(command_t *c)
{
    static const command_t none;

    *c = none;
}

static void add_random_command(command_t *c, int32_t what)
{
    switch (what) {
    case 0:
        c->start = true;
        break;
    case 1:
        c->has_waypoint = true;
        c->waypoint[0] = random_number(REAL(2.0));
        c->waypoint[1] = random_number(REAL(2.0));
        c->waypoint[2] = REAL(-1.2) + random_number(REAL(0.5));
        break;
    case 2:
        c->pause = true;
        break;
    case 3:
        c->return_requested = true;
        break;
    case 4:
        c->has_program_set_point = true;
        c->program_set_point.position[0] = random_number(REAL(2.0));
        c->program_set_point.position[1] = random_number(REAL(2.0));
        c->program_set_point.position[2] = REAL(-1.0);
        c->program_set_point.velocity[0] = REAL_NAN;
        c->program_set_point.velocity[1] = REAL_NAN;
        c->program_set_point.velocity[2] = REAL_NAN;
        c->program_set_point.heading = random_number(REAL(3.0));
        c->program_set_point.yaw_rate = REAL_NAN;
        break;
    case 5:
        c->land = true;
        break;
    default:
        c->rc_active = true;
        c->pilot_climb_rate = random_number(REAL(0.5));
        c->pilot_yaw_rate = random_number(REAL(0.5));
        break;
    }
}

/* Move towards the reference; at times, with walls in the north and the east. */
static void follow_reference(const software_t *s, estimate_t *b)
{
    motion_estimate_t *now = &b->motion;
    const bool up = (s->motors == MOTORS_FLY) || (s->motors == MOTORS_BLIND);

    b->time_s += mufly_setup.period_s;
    for (int32_t i = 0; i < 3; i++) {
        now->velocity[i] = up ? real_clip(REAL(2.0) * (s->reference.path.position[i] - now->position[i]), REAL(-0.8),
                                          REAL(0.8))
                              : REAL(0.0);
        now->position[i] += (mufly_setup.period_s * now->velocity[i]) + random_number(REAL(1e-4));
        now->attitude[i] = (i == 2) ? s->reference.heading : random_number(REAL(0.02));
        now->rates[i] = random_number(REAL(0.02));
    }
    if (now->position[2] > REAL(-0.07)) {
        now->position[2] = REAL(-0.07) + random_number(REAL(1e-4));
        now->velocity[2] = REAL(0.0);
    }
    for (int32_t i = 0; i < mufly_plan.beam_ring.count; i++) {
        const real_t to = (i < 2) ? (REAL(2.2) - now->position[i]) : REAL(9.0);

        b->ranges[i] = real_clip(to, REAL(0.2), mufly_plan.beam_ring.max_range);
    }
}

int main(void)
{
    static software_t s;
    static estimate_t b;
    static command_t command;
    static actuators_t out;
    uint64_t digest = DIGEST_START;
    cost_t cost = {0U, 0U, 0U};
    int32_t held = -1;

    platform_start();
    b.valid = true;
    b.judged = true;
    b.motion.voltage = REAL(7.4);
    b.motion.position[2] = REAL(-0.07);
    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        b.checks[k].status = SENSOR_FUSED;
    }
    software_reset(&mufly_setup, &s);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;

        follow_reference(&s, &b);
        clear_command(&command);
        if (k == 0) {
            add_random_command(&command, 0);
        } else if ((k >= UNDISTURBED_PERIODS) && ((k % 600) == 0)) {
            held = random_below(9);
            b.position_variance[0] = (random_below(4) == 0) ? REAL(0.1) : REAL(1e-4);
            add_random_command(&command, random_below(6));
        } else if ((held == 4) || (held == 6)) {
            add_random_command(&command, held);
        } else {
            /* no user signal */
        }
        before = platform_count();
        software_step(&mufly_setup, &s, &b, &command, &out);
        add_cost(&cost, platform_count() - before);
        for (int32_t i = 0; i < 2; i++) {
            digest_bits(&digest, real_bits(out.motor_input[i]));
            digest_bits(&digest, real_bits(out.servo_input[i]));
        }
        digest_bits(&digest, (uint64_t)s.mission.logged_event_count);
        digest_bits(&digest, real_bits(s.reference.path.position[0]));
        print_digest(digest, k, PERIODS);
    }
    platform_print("outputs ", digest);
    platform_print("state ", sizeof(software_t));
    platform_print("entries ", (uint64_t)s.mission.logged_event_count);
    print_cost(&cost);
    return 0;
}
