/* Fuzz arbitrary bytes as readings, estimates, commands and missions: no crash, no undefined behaviour, outputs in range.
 *
 * For libFuzzer with sanitizers (clang -fsanitize=fuzzer,address,undefined,float-cast-overflow). The first byte selects
 * the part, unless -DFUZZ_ONLY names it. Numbers are arbitrary bits, special values, or physical values ("tame"). A part that requires finite inputs
 * must keep its outputs in range for finite inputs only. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "flight/controllers.h"
#include "mission/avoidance.h"
#ifdef FUZZ_FIXED
#include "fixed_point/fixed_point_law.h"
#endif
#ifdef FUZZ_MISSION
#include "flight/flight_software.h"
#endif
#ifdef FUZZ_ESTIMATE
#include "estimate/filter/ekf_step.h"
#endif
#ifdef FUZZ_LINK
#include "boards/board.h"
#include "check/models/flash_model.h"
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static const uint8_t *at;
static size_t left;
static bool input_is_unphysical;  /* whether an unphysical number was drawn */
static bool limit_inputs; /* whether to draw physical values only */

static uint8_t next_byte(void)
{
    uint8_t b = 0U;

    if (left > 0U) {
        b = *at;
        at++;
        left--;
    }
    return b;
}

static void fill_raw(void *to, size_t size)
{
    for (size_t i = 0U; i < size; i++) {
        ((uint8_t *)to)[i] = next_byte();
    }
}

static int32_t next_int(void)
{
    int32_t v;

    fill_raw(&v, sizeof v);
    return v;
}

/* Mostly within -size..size. */
static real_t next_number(real_t size)
{
    static const real_t special[] = {
        REAL(0.0), REAL(-0.0), REAL(1e-30), REAL(-1e-30), REAL(1e5), REAL(-1e5), REAL(2147483648.0), REAL(-2147483649.0),
        REAL(1e30), REAL(-1e30),
    };
    const uint8_t how = next_byte();
    real_t v;

    if (limit_inputs || (how < 200U)) {
        int16_t share;
        fill_raw(&share, sizeof share);
        v = size * ((real_t)share / REAL(32768.0));
    } else if (how < 220U) {
        fill_raw(&v, sizeof v);
        input_is_unphysical = true;
    } else if (how < 235U) {
        v = special[next_byte() % (sizeof special / sizeof special[0])];
        input_is_unphysical = true;
    } else if (how < 245U) {
        v = (how % 2U) ? REAL_INFINITY : -REAL_INFINITY;
        input_is_unphysical = true;
    } else {
        v = REAL_NAN;
        input_is_unphysical = true;
    }
    return v;
}

/* Positive numbers, as the check of mission files ensures. */
static real_t next_positive(real_t size)
{
    return REAL(0.01) + real_abs(next_number(size));
}

static void fill_numbers(int32_t n, real_t size, real_t out[])
{
    for (int32_t i = 0; i < n; i++) {
        out[i] = next_number(size);
    }
}

static void require_true(bool right)
{
    if (!right) {
        abort();
    }
}

static bool is_between(real_t v, real_t low, real_t high)
{
    return (v >= low) && (v <= high);
}

static void check_actuators(const actuators_t *out)
{
    for (int32_t i = 0; i < 2; i++) {
        require_true(is_between(out->motor_input[i], REAL(0.0), REAL(1.0)));
        require_true(is_between(out->servo_input[i], REAL(-1.0), REAL(1.0)));
    }
}

static void any_motion(motion_estimate_t *m)
{
    fill_numbers(3, REAL(5.0), m->position);
    fill_numbers(3, REAL(3.0), m->velocity);
    fill_numbers(2, REAL(1.5), m->attitude);
    m->attitude[2] = next_number(REAL(100.0));
    fill_numbers(3, REAL(10.0), m->rates);
    m->voltage = next_number(REAL(10.0));
}

static void fuzz_controllers(void)
{
    static controllers_t c;
    motion_estimate_t now;
    path_t path;
    actuators_t out;
    real_t tilt[2] = {REAL(0.0), REAL(0.0)};
    real_t wanted[4];
    real_t motors[2];

    (void)memset(&c, 0, sizeof c);
    any_motion(&now);
    fill_numbers(2, REAL(1.0), motors);
    controllers_engage_heave_yaw(&mufly_gains, &c, &now, motors);
    controllers_engage_roll_pitch(&mufly_gains, &c, &now);
    while (left > 0U) {
        const uint8_t what = next_byte();
        any_motion(&now);
        if ((what & 1U) != 0U) {
            fill_numbers(3, REAL(5.0), path.position);
            fill_numbers(3, REAL(2.0), path.velocity);
            fill_numbers(3, REAL(2.0), path.acceleration);
            controllers_compute_tilt_command(&mufly_gains, &c, &now, &path, tilt);
        }
        if ((what & 2U) != 0U) {
            controllers_engage_roll_pitch(&mufly_gains, &c, &now);
        }
        fill_numbers(4, REAL(5.0), wanted);
        controllers_step(&mufly_gains, &c, &now, wanted, (what & 4U) != 0U, tilt, &out);
        if (!input_is_unphysical) {
            check_actuators(&out);
        }
    }
}

static void any_ring(beam_ring_t *ring)
{
    ring->count = (int32_t)(next_byte() % (MAX_BEAMS + 1U));
    fill_numbers(MAX_BEAMS, REAL(1.0), ring->cos);
    fill_numbers(MAX_BEAMS, REAL(1.0), ring->sin);
    ring->max_range = next_number(REAL(3.0));
    ring->first_angle = next_number(REAL(3.2));
    ring->spacing = next_number(REAL(3.2));
}

static void fuzz_avoid(void)
{
    static obstacle_map_t memory;
    static beam_ring_t ring;
    real_t ranges[MAX_BEAMS];
    real_t position[3];
    real_t attitude[3];
    real_t goal[3];
    real_t velocity[3];
    path_check_t sight;
    detour_t detour;
    bool under_way = false;

    clear_obstacle_map(&memory);
    any_ring(&ring);
    while (left > 0U) {
        const uint8_t what = next_byte();
        fill_numbers(MAX_BEAMS, REAL(2.0), ranges);
        fill_numbers(3, REAL(5.0), position);
        fill_numbers(3, REAL(5.0), goal);
        fill_numbers(3, REAL(1.0), attitude);
        fill_numbers(3, REAL(1.0), velocity);
        insert_beam_hits(&memory, &ring, next_number(REAL(100.0)), position, attitude, ranges, 0, ring.count);
        require_true((memory.point_count >= 0) && (memory.point_count <= MAP_CAPACITY));
        if (!under_way || ((what & 2U) != 0U)) {
            begin_path_check(position, goal, next_number(REAL(2.0)), &sight);
        }
        check_map_part(&memory, &sight, next_number(REAL(100.0)), next_number(REAL(1.0)), 1 + (int32_t)(what >> 6U), 4);
        require_true((memory.point_count >= 0) && (sight.checked_point_count <= MAP_CAPACITY));
        (void)is_path_blocked(&sight, next_number(REAL(1.0)));
        if (!under_way || ((what & 1U) != 0U)) {
            begin_detour(&detour, position, velocity, attitude, goal, &sight, under_way ? &detour : NULL);
            under_way = true;
        }
        follow_contour(&detour, &sight, &ring, position, attitude[2], ranges, goal, next_positive(REAL(0.5)),
                       next_positive(REAL(0.5)), next_positive(REAL(0.5)));
        (void)is_detour_finished(&detour);
        if (!input_is_unphysical) {
            require_true(is_between(detour.position[0], REAL(-1e6), REAL(1e6)));
            require_true(is_between(detour.velocity[0], REAL(-1e6), REAL(1e6)));
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
    fill_raw(&now, sizeof now);
    fill_raw(motors, sizeof motors);
    fixed_engage_heave_yaw(&mufly_fixed_gains, &c, &now, motors);
    fixed_engage_roll_pitch(&mufly_fixed_gains, &c, &now);
    while (left > 0U) {
        const uint8_t what = next_byte();
        fill_raw(&now, sizeof now);
        if ((what & 1U) != 0U) {
            fill_raw(&path, sizeof path);
            fixed_compute_tilt_command(&mufly_fixed_gains, &c, &now, &path, tilt);
        }
        if ((what & 2U) != 0U) {
            fill_raw(tilt, sizeof tilt);
        }
        fill_raw(wanted, sizeof wanted);
        fixed_step(&mufly_fixed_gains, &c, &now, wanted, (what & 4U) != 0U, tilt, &out);
        for (int32_t i = 0; i < 2; i++) {
            require_true((out.motor_input[i] >= 0) && (out.motor_input[i] <= FIXED_ONE));
            require_true((out.servo_input[i] >= -FIXED_ONE) && (out.servo_input[i] <= FIXED_ONE));
        }
        require_true(c.overflows == 0U); /* guaranteed by the proof */
    }
}
#endif

#ifdef FUZZ_MISSION
/* Mission numbers are drawn within the limits that the file reader checks. */
static void any_plan(plan_t *p)
{
    const bool as_it_was = limit_inputs;

    limit_inputs = true;
    (void)memset(p, 0, sizeof *p);
    p->count = (int32_t)(next_byte() % (MISSION_WAYPOINTS + 1U));
    for (int32_t i = 0; i < p->count; i++) {
        waypoint_t *const w = &p->waypoint[i];
        fill_numbers(3, REAL(5.0), w->position);
        w->wait_s = real_abs(next_number(REAL(2.0)));
        w->speed = next_positive(REAL(1.0));
        w->has_heading = (next_byte() & 1U) != 0U;
        w->heading = next_number(REAL(7.0));
    }
    p->at_end = (int32_t)(next_byte() % 3U);
    p->spline = (next_byte() & 1U) != 0U;
    fill_numbers(2, REAL(2.0), p->start);
    p->take_off_height = next_positive(REAL(2.0));
    p->take_off_wait_s = real_abs(next_number(REAL(2.0)));
    p->limits.speed = next_positive(REAL(1.0));
    p->limits.climb = next_positive(REAL(1.0));
    p->limits.descent = next_positive(REAL(1.0));
    p->limits.acceleration = next_positive(REAL(1.0));
    p->limits.climb_acceleration = next_positive(REAL(1.0));
    p->limits.yaw_rate = next_positive(REAL(2.0));
    p->limits.yaw_acceleration = next_positive(REAL(4.0));
    p->touchdown = next_positive(REAL(0.5));
    p->reach = next_positive(REAL(0.5));
    p->reach_speed = next_positive(REAL(0.5));
    p->avoid = (next_byte() & 1U) != 0U;
    p->scan = (next_byte() & 1U) != 0U;
    p->clearance = next_positive(REAL(0.5));
    p->avoid_speed = next_positive(REAL(0.5));
    p->give_up_s = next_positive(REAL(60.0));
    p->nose_offset = next_number(REAL(3.0));
    p->low_voltage = next_number(REAL(7.0));
    any_ring(&p->beam_ring);
    limit_inputs = as_it_was;
}

static void any_belief(estimate_t *m, real_t time_s)
{
    m->time_s = ((next_byte() & 63U) == 0U) ? next_number(REAL(100.0)) : time_s;
    any_motion(&m->motion);
    fill_numbers(MAX_BEAMS, REAL(2.0), m->ranges);
    m->valid = (next_byte() & 7U) != 0U;
    m->judged = (next_byte() & 1U) != 0U;
    fill_numbers(3, REAL(0.5), m->position_variance);
    fill_numbers(3, REAL(0.5), m->attitude_variance);
    for (int32_t i = 0; i < ESTIMATE_SENSORS; i++) {
        m->checks[i].status = (int32_t)(next_byte() % 6U);
        m->checks[i].why = (int32_t)(next_byte() % 16U);
        m->checks[i].number = next_number(REAL(10.0));
    }
}

static void any_command(command_t *c)
{
    const uint8_t a = next_byte();
    const uint8_t b = next_byte();
    const bool as_it_was = limit_inputs;

    (void)memset(c, 0, sizeof *c);
    c->start = (a & 1U) != 0U;
    c->has_first_waypoint = (a & 2U) != 0U;
    c->first_waypoint = (b < 250U) ? (int32_t)(b % 4U) : next_int();
    c->has_take_off_height = (a & 4U) != 0U;
    c->pause = (a & 24U) == 24U;
    c->has_waypoint = (a & 96U) == 96U;
    fill_numbers(3, REAL(5.0), c->waypoint);
    c->has_heading = (b & 1U) != 0U;
    c->heading = next_number(REAL(7.0));
    c->return_requested = (b & 6U) == 6U;
    c->land = (b & 24U) == 24U;
    c->motor_stop_reason = ((b & 224U) == 224U) ? (int32_t)(next_byte() % 8U) : 0;
    c->rc_active = (a & 160U) == 160U;
    /* The caller checks sticks and heights: autopilot.py, or on a board the code that fills command_t. */
    limit_inputs = true;
    c->pilot_roll = next_number(REAL(0.5));
    c->pilot_pitch = next_number(REAL(0.5));
    c->pilot_yaw_rate = next_number(REAL(2.0));
    c->pilot_climb_rate = next_number(REAL(1.0));
    c->take_off_height = next_positive(REAL(2.0));
    limit_inputs = as_it_was;
    c->has_program_set_point = (a & 136U) == 136U;
    fill_numbers(3, REAL(5.0), c->program_set_point.position);
    fill_numbers(3, REAL(1.0), c->program_set_point.velocity);
    c->program_set_point.heading = next_number(REAL(7.0));
    c->program_set_point.yaw_rate = next_number(REAL(2.0));
}

/* The whole flight software: actuators stay in range for any estimate and command. */
static void fuzz_software(void)
{
    static software_t s;
    static plan_t plan;
    static flight_setup_t setup;
    estimate_t belief;
    command_t command;
    actuators_t out;
    real_t time_s = REAL(0.0);
    uint8_t repeat;

    any_plan(&plan);
    setup.gains = &mufly_gains;
    setup.plan = &plan;
    setup.period_s = REAL(0.005);
    setup.mission_step_periods = 4;
    setup.hover_V[0] = REAL(4.8);
    setup.hover_V[1] = REAL(4.8);
    software_reset(&setup, &s);
    while (left > 0U) {
        any_belief(&belief, time_s);
        any_command(&command);
        repeat = next_byte();
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
/* The estimator: a valid estimate is finite for any readings. */
static void fuzz_estimate(void)
{
    static estimator_t m;
    real_t z[INPUT_VALUE_COUNT];
    int32_t fresh[SENSOR_COUNT];
    real_t age[SENSOR_COUNT];

    estimator_reset(&m, &mufly_settings);
    while (left > 0U) {
        const uint8_t repeat = next_byte();
        real_t kept[INPUT_VALUE_COUNT];
        int32_t came[SENSOR_COUNT];

        fill_numbers(INPUT_VALUE_COUNT, REAL(20.0), kept);
        for (int32_t i = 0; i < SENSOR_COUNT; i++) {
            const uint8_t how = next_byte();

            came[i] = (how < 240U) ? (int32_t)(how % 3U) : ((int32_t)how - 247);
            age[i] = ((how & 12U) != 0U) ? real_abs(next_number(REAL(0.2))) : next_number(REAL(20.0));
        }
        for (uint32_t k = 0U; k <= (repeat % 32U); k++) {
            (void)memcpy(z, kept, sizeof z);
            (void)memcpy(fresh, came, sizeof fresh);
            if (estimator_step(&m, &mufly_settings, &mufly_flight_model, z, fresh, age)) {
                for (int32_t i = 0; i < 3; i++) {
                    require_true(is_between(m.angles_output[i], REAL(-1e9), REAL(1e9)));
                    require_true(is_between(m.rates_output[i], REAL(-1e9), REAL(1e9)));
                }
            }
        }
    }
}
#endif

#ifdef FUZZ_LINK
#define FUZZ_FLASH_WORDS 256

/* Flash with any words, records with any payload, and wear. */
static void any_flash(void)
{
    static uint32_t words[2 * FUZZ_FLASH_WORDS];
    static uint32_t weak[2 * FUZZ_FLASH_WORDS];
    static flash_model_t flash;
    const uint8_t how = next_byte();
    storage_t storage;

    (void)memset(words, ((how & 1U) != 0U) ? 0 : 0xFF, sizeof words);
    (void)memset(weak, 0, sizeof weak);
    if ((how & 2U) != 0U) {
        fill_raw(words, (size_t)(how >> 2U) * sizeof words[0]);
    }
    flash.sector_words = FUZZ_FLASH_WORDS;
    flash.words = words;
    flash.weak = weak;
    flash.operations = 0U;
    flash.cut_after = -1;
    flash.noise = 1U;
    flash.worn_word = -1;
    flash.worn_sector = -1;
    flash_model_attach(&flash);
    flash_model_start(&flash);
    storage_open(&storage);
    for (int32_t n = (int32_t)(next_byte() % 4U); n > 0; n--) {
        uint32_t payload[64] = {0U};
        const int32_t count = (int32_t)(next_byte() % 64U);

        fill_raw(payload, (size_t)count * sizeof payload[0]);
        (void)storage_write(&storage, (int32_t)(next_byte() % (uint8_t)STORED_KINDS), next_byte() % 3U, payload, count);
    }
    flash.cut_after = ((how & 4U) != 0U) ? ((int32_t)flash.operations + (int32_t)next_byte()) : -1;
    flash.worn_word = ((how & 8U) != 0U) ? (2 * (int32_t)next_byte()) : -1;
    flash.worn_bits = 0xFFFFFFFFU;
    flash.worn_sector = ((how & 16U) != 0U) ? (int32_t)(next_byte() % 2U) : -1;
}

/* Bytes of a receiver; of SBUS often two frames, of CRSF often one with a right checksum. */
static void any_receiver(rc_t *rc)
{
    rc->input_count = (int32_t)(next_byte() % (RC_INPUT + 1U));
    fill_raw(rc->input, (size_t)rc->input_count);
    if ((rc->decoder.kind == (int32_t)RC_SBUS) && (rc->input_count >= 50)) {
        for (int32_t i = 0; i < 50; i += 25) {
            rc->input[i] = 0x0FU;
            rc->input[i + 23] &= 0x0FU;
            rc->input[i + 24] = 0U;
        }
    } else if ((rc->decoder.kind == (int32_t)RC_CRSF) && (rc->input_count >= 26)) {
        uint32_t crc = 0U;

        rc->input[0] = 0xC8U;
        rc->input[1] = 24U;
        rc->input[2] = 0x16U;
        for (int32_t i = 2; i < 25; i++) {
            crc ^= rc->input[i];
            for (int32_t bit = 0; bit < 8; bit++) {
                crc = ((crc & 0x80U) != 0U) ? (((crc << 1U) ^ 0xD5U) & 0xFFU) : (crc << 1U);
            }
        }
        rc->input[25] = (uint8_t)crc;
    } else {
        /* any bytes */
    }
}

static void check_board(const board_t *board)
{
    const supervisor_t *s = &board->supervisor;
    const calibration_t *c = &board->settings.calibration;

    require_true((board->link.output_count >= 0) && (board->link.output_count <= LINK_OUTPUT));
    require_true((board->plan.count >= 0) && (board->plan.count <= MISSION_WAYPOINTS));
    require_true((board->rc.decoder.length >= 0) && (board->rc.decoder.length < RC_FRAME));
    for (int32_t i = 0; i < RC_CHANNELS; i++) {
        require_true((board->rc.decoder.channel[i] >= 0) && (board->rc.decoder.channel[i] < 2048));
    }
    require_true(is_between(s->settings.stick_tilt, REAL(0.0), REAL(0.3)));
    require_true(is_between(s->sticks.pilot_roll, REAL(-0.3), REAL(0.3)));
    require_true(is_between(c->rate_offset[0], REAL(-0.51), REAL(0.51)));
    for (int32_t k = 0; k < board->plan.count; k++) {
        require_true(is_between(board->plan.waypoint[k].position[2], REAL(-51.0), REAL(0.0)));
    }
}

/* Messages that the board handles, with the place of the target's system; commands that it executes. */
static const struct {
    uint8_t number, target;
} handled[] = {
    {MSG_COMMAND_LONG, 30U}, {MSG_COMMAND_INT, 30U}, {MSG_PARAM_REQUEST_READ, 2U}, {MSG_PARAM_REQUEST_LIST, 0U},
    {MSG_PARAM_SET, 4U}, {MSG_MISSION_REQUEST_LIST, 0U}, {MSG_MISSION_COUNT, 2U}, {MSG_MISSION_REQUEST_INT, 2U},
    {MSG_MISSION_ITEM_INT, 32U}, {MSG_MANUAL_CONTROL, 10U}, {MSG_SET_POSITION_TARGET_LOCAL_NED, 50U},
};
static const uint16_t commands[] = {400U, 185U, 22U, 24U, 21U, 23U, 189U, 20U, 300U, 193U, 192U, 245U, 176U, 512U, 520U};

#define COUNT(list) (sizeof(list) / sizeof((list)[0]))

/* Any message of one of four stations, mostly a handled one to this board, with physical numbers or any bits. */
static void any_message(mavlink_message_t *m)
{
    const uint8_t which = next_byte();
    const uint8_t how = next_byte();
    const size_t k = which % COUNT(handled);

    if (which < 220U) {
        const int32_t target = (int32_t)handled[k].target;

        mavlink_begin(m, handled[k].number, 60);
        for (int32_t i = 0; i < 60; i += 4) {
            if ((how & 4U) != 0U) {
                const float number = (float)next_number(REAL(4.0));
                (void)memcpy(&m->payload[i], &number, sizeof number);
            } else {
                fill_raw(&m->payload[i], 4U);
            }
        }
        if ((how & 8U) != 0U) {
            m->payload[target] = 1U;
            m->payload[target + 1] = 1U;
        }
        if (target == 30) {
            const uint16_t command = commands[next_byte() % COUNT(commands)];
            m->payload[28] = (uint8_t)(command & 0xFFU);
            m->payload[29] = (uint8_t)(command >> 8U);
        } else if (m->message == MSG_PARAM_SET) {
            const char *name = parameter_name((int32_t)(next_byte() % PARAMETERS));
            (void)memcpy(&m->payload[6], name, strlen(name) + 1U);
        } else {
            /* every bit is drawn */
        }
    } else {
        mavlink_begin(m, next_byte(), (int32_t)(next_byte() % 60U) + 1);
        fill_raw(m->payload, (size_t)m->length);
    }
    m->system = (uint8_t)(1U + (how & 3U));
}

/* A board with its link: any bytes at the UART and of a receiver, any flash, in a flight without readings. */
static void fuzz_link(void)
{
    static board_t board;
    uint8_t out[LINK_OUTPUT];
    real_t time_s = REAL(0.0);

    (void)memset(&board, 0, sizeof board);
    any_flash();
    board_start(&board, 1U << READING_ACCELERATION, (int32_t)(next_byte() % 3U));
    rc_start(&board.rc, (int32_t)(next_byte() % 3U));
    while (left > 0U) {
        const uint8_t how = next_byte();

        time_s += REAL(0.005) * (real_t)(1U + (how & 7U));
        board.belief.time_s = time_s;
        board.supervisor.now_s = time_s;
        board.supervisor.armed = board.supervisor.armed || ((how & 0xC0U) == 0xC0U);
        board.link.input_count = 0;
        board.rc.input_count = 0;
        if ((how & 0x30U) == 0x30U) {
            any_receiver(&board.rc);
        }
        if ((how & 8U) != 0U) { /* a frame with a right checksum */
            mavlink_message_t m;
            uint8_t frame[MAVLINK_FRAME];
            int32_t length;

            any_message(&m);
            length = mavlink_encode(&m, 0U, frame);
            for (int32_t i = 0; i < length; i++) {
                board.link.input[board.link.input_count] = frame[i];
                board.link.input_count++;
                if (board.link.input_count == LINK_INPUT) {
                    board_link(&board);
                    board.link.input_count = 0;
                }
            }
        } else {
            while (board.link.input_count < (int32_t)(how % (LINK_INPUT + 1U))) {
                board.link.input[board.link.input_count] = next_byte();
                board.link.input_count++;
            }
        }
        board_link(&board);
        check_board(&board);
        link_sent(&board.link, link_waiting(&board.link, out, (int32_t)how));
    }
}
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    void (*const parts[])(void) = {
#ifdef FUZZ_ONLY
        FUZZ_ONLY,
#else
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
#ifdef FUZZ_LINK
        fuzz_link,
#endif
#endif
    };
    uint8_t first;

    at = data;
    left = size;
    input_is_unphysical = false;
    first = next_byte();
    limit_inputs = (first & 128U) != 0U;
    parts[(first & 127U) % (sizeof parts / sizeof parts[0])]();
    return 0;
}
