/* The same flight everywhere? The flight software flies plan.c for a stand-in that follows its references with a lag, on
 * estimates that are sometimes bad, among walls that are made up, with signals of a user that come when they like. What
 * it gives and what it logs is told bit by bit; the last lines tell what a period costs. */
#include "made_up.h"
#include "platform.h"
#include "software.h"

#define PERIODS 16000
#define LINES 40
#define ALONE 8400 /* so long it flies its mission undisturbed */

static int32_t one_of(int32_t count)
{
    (void)any(REAL(1.0));
    return (int32_t)((seed >> 8) % (uint32_t)count);
}

static void nothing(command_t *c)
{
    static const command_t none;

    *c = none;
}

static void ask(command_t *c, int32_t what)
{
    switch (what) {
    case 0:
        c->start = true;
        break;
    case 1:
        c->has_waypoint = true;
        c->waypoint[0] = any(REAL(2.0));
        c->waypoint[1] = any(REAL(2.0));
        c->waypoint[2] = REAL(-1.2) + any(REAL(0.5));
        break;
    case 2:
        c->pause = true;
        break;
    case 3:
        c->home = true;
        break;
    case 4:
        c->has_set_point = true;
        c->set_point.position[0] = any(REAL(2.0));
        c->set_point.position[1] = any(REAL(2.0));
        c->set_point.position[2] = REAL(-1.0);
        c->set_point.velocity[0] = REAL_NONE;
        c->set_point.velocity[1] = REAL_NONE;
        c->set_point.velocity[2] = REAL_NONE;
        c->set_point.heading = any(REAL(3.0));
        c->set_point.yaw_rate = REAL_NONE;
        break;
    case 5:
        c->land = true;
        break;
    default:
        c->rc = true;
        c->climb = any(REAL(0.5));
        c->yaw_rate = any(REAL(0.5));
        break;
    }
}

/* It moves after its reference; walls stand to the north and the east of it, sometimes. */
static void follow(const software_t *s, belief_t *b)
{
    motion_t *now = &b->motion;
    const bool up = (s->motors == MOTORS_FLY) || (s->motors == MOTORS_BLIND);

    b->time_s += mufly_setup.period_s;
    for (int32_t i = 0; i < 3; i++) {
        now->velocity[i] = up ? real_clip(REAL(2.0) * (s->reference.path.position[i] - now->position[i]), REAL(-0.8),
                                          REAL(0.8))
                              : REAL(0.0);
        now->position[i] += (mufly_setup.period_s * now->velocity[i]) + any(REAL(1e-4));
        now->attitude[i] = (i == 2) ? s->reference.heading : any(REAL(0.02));
        now->rates[i] = any(REAL(0.02));
    }
    if (now->position[2] > REAL(-0.07)) {
        now->position[2] = REAL(-0.07) + any(REAL(1e-4));
        now->velocity[2] = REAL(0.0);
    }
    for (int32_t i = 0; i < mufly_plan.ring.count; i++) {
        const real_t to = (i < 2) ? (REAL(2.2) - now->position[i]) : REAL(9.0);

        b->ranges[i] = real_clip(to, REAL(0.2), mufly_plan.ring.max_range);
    }
}

int main(void)
{
    static software_t s;
    static belief_t b;
    static command_t command;
    static actuators_t out;
    uint64_t digest = DIGEST_START;
    uint32_t spent = 0U;
    uint32_t worst = 0U;
    int32_t held = -1;

    platform_start();
    b.valid = true;
    b.judged = true;
    b.motion.voltage = REAL(7.4);
    b.motion.position[2] = REAL(-0.07);
    for (int32_t k = 0; k < BELIEF_SENSORS; k++) {
        b.checks[k].status = BELIEF_FUSED;
    }
    software_start(&mufly_setup, &s);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;
        uint32_t took;

        follow(&s, &b);
        nothing(&command);
        if (k == 0) {
            ask(&command, 0);
        } else if ((k >= ALONE) && ((k % 600) == 0)) {
            held = one_of(9);
            b.position_variance[0] = (one_of(4) == 0) ? REAL(0.1) : REAL(1e-4);
            ask(&command, one_of(6));
        } else if ((held == 4) || (held == 6)) {
            ask(&command, held);
        } else {
            /* it flies by itself */
        }
        before = platform_count();
        software_step(&mufly_setup, &s, &b, &command, &out);
        took = platform_count() - before;
        spent += took;
        worst = (took > worst) ? took : worst;
        for (int32_t i = 0; i < 2; i++) {
            take_bits(&digest, bits(out.motor_input[i]));
            take_bits(&digest, bits(out.servo_input[i]));
        }
        take_bits(&digest, (uint64_t)s.mission.logged);
        take_bits(&digest, bits(s.reference.path.position[0]));
        if ((k % (PERIODS / LINES)) == 0) {
            platform_say("outputs ", digest);
        }
    }
    platform_say("outputs ", digest);
    platform_say("state ", sizeof(software_t));
    platform_say("entries ", (uint64_t)s.mission.logged);
    platform_say("periods ", PERIODS);
    platform_say("ticks ", spent);
    platform_say("worst ", worst);
    platform_end();
    return 0;
}
