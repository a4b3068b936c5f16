/* Any bytes as readings, beliefs, commands and missions: no crash, nothing undefined, no output out of range.
 *
 * For libFuzzer, with the sanitizers of addresses and of what C leaves undefined (clang -fsanitize=fuzzer,address,undefined,
 * float-cast-overflow). The first byte says which part; numbers come as they are (any bits), as special ones, or within
 * what happens ("tame"). A part that is promised finite numbers has to keep its outputs in range only if it gets them. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "avoid.h"
#include "controllers.h"
#ifdef FUZZ_FIXED
#include "fixed_law.h"
#endif
#ifdef FUZZ_MISSION
#include "software.h"
#endif
#ifdef FUZZ_ESTIMATE
#include "ekf_step.h"
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const uint8_t *at;
static size_t left;
static bool wild;  /* whether something came that does not happen */
static bool tamed; /* whether everything is to be as it happens */

static uint8_t byte(void)
{
    uint8_t b = 0U;

    if (left > 0U) {
        b = *at;
        at++;
        left--;
    }
    return b;
}

static void raw(void *to, size_t size)
{
    for (size_t i = 0U; i < size; i++) {
        ((uint8_t *)to)[i] = byte();
    }
}

static int32_t whole(void)
{
    int32_t v;

    raw(&v, sizeof v);
    return v;
}

/* Mostly within -size..size. */
static real_t number(real_t size)
{
    static const real_t special[] = {
        REAL(0.0), REAL(-0.0), REAL(1e-30), REAL(-1e-30), REAL(1e5), REAL(-1e5), REAL(2147483648.0), REAL(-2147483649.0),
        REAL(1e30), REAL(-1e30),
    };
    const uint8_t how = byte();
    real_t v;

    if (tamed || (how < 200U)) {
        int16_t share;
        raw(&share, sizeof share);
        v = size * ((real_t)share / REAL(32768.0));
    } else if (how < 220U) {
        raw(&v, sizeof v);
        wild = true;
    } else if (how < 235U) {
        v = special[byte() % (sizeof special / sizeof special[0])];
        wild = true;
    } else if (how < 245U) {
        v = (how % 2U) ? REAL_INFINITY : -REAL_INFINITY;
        wild = true;
    } else {
        v = REAL_NONE;
        wild = true;
    }
    return v;
}

/* More than nothing, as a mission's file is checked to be. */
static real_t some(real_t size)
{
    return REAL(0.01) + real_abs(number(size));
}

static void numbers(int32_t n, real_t size, real_t out[])
{
    for (int32_t i = 0; i < n; i++) {
        out[i] = number(size);
    }
}

static void check(bool right)
{
    if (!right) {
        abort();
    }
}

static bool between(real_t v, real_t low, real_t high)
{
    return (v >= low) && (v <= high);
}

static void check_actuators(const actuators_t *out)
{
    for (int32_t i = 0; i < 2; i++) {
        check(between(out->motor_input[i], REAL(0.0), REAL(1.0)));
        check(between(out->servo_input[i], REAL(-1.0), REAL(1.0)));
    }
}

static void any_motion(motion_t *m)
{
    numbers(3, REAL(5.0), m->position);
    numbers(3, REAL(3.0), m->velocity);
    numbers(2, REAL(1.5), m->attitude);
    m->attitude[2] = number(REAL(100.0));
    numbers(3, REAL(10.0), m->rates);
    m->voltage = number(REAL(10.0));
}

static void fuzz_controllers(void)
{
    static controllers_t c;
    motion_t now;
    path_t path;
    actuators_t out;
    real_t tilt[2] = {REAL(0.0), REAL(0.0)};
    real_t wanted[4];
    real_t motors[2];

    (void)memset(&c, 0, sizeof c);
    any_motion(&now);
    numbers(2, REAL(1.0), motors);
    controllers_engage(&mufly_gains, &c, &now, motors);
    controllers_lift_off(&mufly_gains, &c, &now);
    while (left > 0U) {
        const uint8_t what = byte();
        any_motion(&now);
        if ((what & 1U) != 0U) {
            numbers(3, REAL(5.0), path.position);
            numbers(3, REAL(2.0), path.velocity);
            numbers(3, REAL(2.0), path.acceleration);
            controllers_tilt(&mufly_gains, &c, &now, &path, tilt);
        }
        if ((what & 2U) != 0U) {
            controllers_lift_off(&mufly_gains, &c, &now);
        }
        numbers(4, REAL(5.0), wanted);
        controllers_step(&mufly_gains, &c, &now, wanted, (what & 4U) != 0U, tilt, &out);
        if (!wild) {
            check_actuators(&out);
        }
    }
}

static void any_ring(ring_t *ring)
{
    ring->count = (int32_t)(byte() % (AVOID_BEAMS + 1U));
    numbers(AVOID_BEAMS, REAL(1.0), ring->cos);
    numbers(AVOID_BEAMS, REAL(1.0), ring->sin);
    ring->max_range = number(REAL(3.0));
    ring->first_angle = number(REAL(3.2));
    ring->spacing = number(REAL(3.2));
}

static void fuzz_avoid(void)
{
    static memory_t memory;
    static ring_t ring;
    real_t ranges[AVOID_BEAMS];
    real_t position[3];
    real_t attitude[3];
    real_t goal[3];
    real_t velocity[3];
    sight_t sight;
    detour_t detour;
    bool under_way = false;

    avoid_forget(&memory);
    any_ring(&ring);
    while (left > 0U) {
        const uint8_t what = byte();
        numbers(AVOID_BEAMS, REAL(2.0), ranges);
        numbers(3, REAL(5.0), position);
        numbers(3, REAL(5.0), goal);
        numbers(3, REAL(1.0), attitude);
        numbers(3, REAL(1.0), velocity);
        avoid_observe(&memory, &ring, number(REAL(100.0)), position, attitude, ranges, 0, ring.count);
        check((memory.used >= 0) && (memory.used <= AVOID_CAPACITY));
        if (!under_way || ((what & 2U) != 0U)) {
            avoid_begin_sight(position, goal, number(REAL(2.0)), &sight);
        }
        avoid_look_around(&memory, &sight, number(REAL(100.0)), number(REAL(1.0)), 1 + (int32_t)(what >> 6U), 4);
        check((memory.used >= 0) && (sight.row <= AVOID_CAPACITY));
        (void)avoid_blocked(&sight, number(REAL(1.0)));
        if (!under_way || ((what & 1U) != 0U)) {
            avoid_begin(&detour, position, velocity, attitude, goal, &sight, under_way ? &detour : NULL);
            under_way = true;
        }
        avoid_go_round(&detour, &sight, &ring, position, attitude[2], ranges, goal, some(REAL(0.5)),
                       some(REAL(0.5)), some(REAL(0.5)));
        (void)avoid_done(&detour);
        if (!wild) {
            check(between(detour.position[0], REAL(-1e6), REAL(1e6)));
            check(between(detour.velocity[0], REAL(-1e6), REAL(1e6)));
        }
    }
}

#ifdef FUZZ_FIXED
static void fuzz_fixed(void)
{
    static fixed_controllers_t c;
    fixed_motion_t now;
    fixed_path_t path;
    fixed_actuators_t out;
    int32_t tilt[2] = {0, 0};
    int32_t wanted[4];
    int32_t motors[2];

    (void)memset(&c, 0, sizeof c);
    raw(&now, sizeof now);
    raw(motors, sizeof motors);
    fixed_engage(&mufly_fixed_gains, &c, &now, motors);
    fixed_lift_off(&mufly_fixed_gains, &c, &now);
    while (left > 0U) {
        const uint8_t what = byte();
        raw(&now, sizeof now);
        if ((what & 1U) != 0U) {
            raw(&path, sizeof path);
            fixed_tilt(&mufly_fixed_gains, &c, &now, &path, tilt);
        }
        if ((what & 2U) != 0U) {
            raw(tilt, sizeof tilt);
        }
        raw(wanted, sizeof wanted);
        fixed_step(&mufly_fixed_gains, &c, &now, wanted, (what & 4U) != 0U, tilt, &out);
        for (int32_t i = 0; i < 2; i++) {
            check((out.motor_input[i] >= 0) && (out.motor_input[i] <= FIXED_ONE));
            check((out.servo_input[i] >= -FIXED_ONE) && (out.servo_input[i] <= FIXED_ONE));
        }
        check(c.overflows == 0U); /* by the proof */
    }
}
#endif

#ifdef FUZZ_MISSION
/* Of a mission's numbers those come that its file may hold: they are checked where it is read. */
static void any_plan(plan_t *p)
{
    const bool as_it_was = tamed;

    tamed = true;
    (void)memset(p, 0, sizeof *p);
    p->count = (int32_t)(byte() % (MISSION_WAYPOINTS + 1U));
    for (int32_t i = 0; i < p->count; i++) {
        waypoint_t *const w = &p->waypoint[i];
        numbers(3, REAL(5.0), w->position);
        w->wait_s = real_abs(number(REAL(2.0)));
        w->speed = some(REAL(1.0));
        w->has_heading = (byte() & 1U) != 0U;
        w->heading = number(REAL(7.0));
    }
    p->at_end = (int32_t)(byte() % 3U);
    p->spline = (byte() & 1U) != 0U;
    numbers(2, REAL(2.0), p->start);
    p->take_off_height = some(REAL(2.0));
    p->take_off_wait_s = real_abs(number(REAL(2.0)));
    p->limits.speed = some(REAL(1.0));
    p->limits.climb = some(REAL(1.0));
    p->limits.descent = some(REAL(1.0));
    p->limits.acceleration = some(REAL(1.0));
    p->limits.climb_acceleration = some(REAL(1.0));
    p->limits.yaw_rate = some(REAL(2.0));
    p->limits.yaw_acceleration = some(REAL(4.0));
    p->touchdown = some(REAL(0.5));
    p->reach = some(REAL(0.5));
    p->reach_speed = some(REAL(0.5));
    p->avoid = (byte() & 1U) != 0U;
    p->scan = (byte() & 1U) != 0U;
    p->clearance = some(REAL(0.5));
    p->avoid_speed = some(REAL(0.5));
    p->give_up_s = some(REAL(60.0));
    p->nose_offset = number(REAL(3.0));
    p->low_voltage = number(REAL(7.0));
    any_ring(&p->ring);
    tamed = as_it_was;
}

static void any_belief(belief_t *m, real_t time_s)
{
    m->time_s = ((byte() & 63U) == 0U) ? number(REAL(100.0)) : time_s;
    any_motion(&m->motion);
    numbers(AVOID_BEAMS, REAL(2.0), m->ranges);
    m->valid = (byte() & 7U) != 0U;
    m->judged = (byte() & 1U) != 0U;
    numbers(3, REAL(0.5), m->position_variance);
    numbers(3, REAL(0.5), m->attitude_variance);
    for (int32_t i = 0; i < BELIEF_SENSORS; i++) {
        m->checks[i].status = (int32_t)(byte() % 6U);
        m->checks[i].why = (int32_t)(byte() % 16U);
        m->checks[i].number = number(REAL(10.0));
    }
}

static void any_command(command_t *c)
{
    const uint8_t a = byte();
    const uint8_t b = byte();
    const bool as_it_was = tamed;

    (void)memset(c, 0, sizeof *c);
    c->start = (a & 1U) != 0U;
    c->has_first = (a & 2U) != 0U;
    c->first = (b < 250U) ? (int32_t)(b % 4U) : whole();
    c->has_take_off = (a & 4U) != 0U;
    c->pause = (a & 24U) == 24U;
    c->has_waypoint = (a & 96U) == 96U;
    numbers(3, REAL(5.0), c->waypoint);
    c->has_heading = (b & 1U) != 0U;
    c->heading = number(REAL(7.0));
    c->home = (b & 6U) == 6U;
    c->land = (b & 24U) == 24U;
    c->stop = ((b & 224U) == 224U) ? (int32_t)(byte() % 8U) : 0;
    c->rc = (a & 160U) == 160U;
    /* Sticks and heights are checked where they come in: autopilot.py, on a board whoever fills a command_t. */
    tamed = true;
    c->roll = number(REAL(0.5));
    c->pitch = number(REAL(0.5));
    c->yaw_rate = number(REAL(2.0));
    c->climb = number(REAL(1.0));
    c->take_off = some(REAL(2.0));
    tamed = as_it_was;
    c->has_set_point = (a & 136U) == 136U;
    numbers(3, REAL(5.0), c->set_point.position);
    numbers(3, REAL(1.0), c->set_point.velocity);
    c->set_point.heading = number(REAL(7.0));
    c->set_point.yaw_rate = number(REAL(2.0));
}

/* The whole flight software: whatever is believed and asked, actuators stay within their range. */
static void fuzz_software(void)
{
    static software_t s;
    static plan_t plan;
    static setup_t setup;
    belief_t belief;
    command_t command;
    actuators_t out;
    real_t time_s = REAL(0.0);
    uint8_t repeat;

    any_plan(&plan);
    setup.gains = &mufly_gains;
    setup.plan = &plan;
    setup.period_s = REAL(0.005);
    setup.every = 4;
    setup.hover_V[0] = REAL(4.8);
    setup.hover_V[1] = REAL(4.8);
    software_start(&setup, &s);
    while (left > 0U) {
        any_belief(&belief, time_s);
        any_command(&command);
        repeat = byte();
        for (uint32_t k = 0U; k <= repeat; k++) {
            time_s += setup.period_s;
            belief.time_s += setup.period_s;
            software_step(&setup, &s, &belief, &command, &out);
            check_actuators(&out);
        }
    }
}
#endif

#ifdef FUZZ_ESTIMATE
/* The estimator: any readings; what it stands by is finite. */
static void fuzz_estimate(void)
{
    static estimator_t m;
    real_t z[VALUES];
    int32_t fresh[SENSORS];
    real_t age[SENSORS];

    estimator_reset(&m, &mufly_settings);
    while (left > 0U) {
        const uint8_t repeat = byte();
        real_t kept[VALUES];
        int32_t came[SENSORS];

        numbers(VALUES, REAL(20.0), kept);
        for (int32_t i = 0; i < SENSORS; i++) {
            const uint8_t how = byte();

            came[i] = (how < 240U) ? (int32_t)(how % 3U) : ((int32_t)how - 247);
            age[i] = ((how & 12U) != 0U) ? real_abs(number(REAL(0.2))) : number(REAL(20.0));
        }
        for (uint32_t k = 0U; k <= (repeat % 32U); k++) {
            (void)memcpy(z, kept, sizeof z);
            (void)memcpy(fresh, came, sizeof fresh);
            if (estimator_step(&m, &mufly_settings, &mufly_flight_model, z, fresh, age)) {
                for (int32_t i = 0; i < 3; i++) {
                    check(between(m.angles[i], REAL(-1e9), REAL(1e9)));
                    check(between(m.out_rates[i], REAL(-1e9), REAL(1e9)));
                }
            }
        }
    }
}
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    void (*const parts[])(void) = {
        fuzz_controllers,
        fuzz_avoid,
#ifdef FUZZ_FIXED
        fuzz_fixed,
#endif
#ifdef FUZZ_MISSION
        fuzz_software,
#endif
#ifdef FUZZ_ESTIMATE
        fuzz_estimate,
#endif
    };
    uint8_t first;

    at = data;
    left = size;
    wild = false;
    first = byte();
    tamed = (first & 128U) != 0U;
    parts[(first & 127U) % (sizeof parts / sizeof parts[0])]();
    return 0;
}
