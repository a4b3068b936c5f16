#include "fixed_point/fixed_point_law.h"

#define EXCESS_SHIFT 4U        /* from 2^-20 to 2^-16 */
#define SIGNAL_LIMIT 1073741824       /* 2^30: 1024 m/s or rad, beyond physical values; its square fits 64 bits */
#define FEEDFORWARD_LIMIT 67108864 /* 64 m/s2 */

/* w: states, errors, saturation excess. x: the next states. */
static void write_next_state(int32_t n, int32_t inputs, const fixed_coefficient_t update[], const uint8_t down[], int32_t kept,
                    const int32_t w[], int32_t x[], uint32_t *overflows)
{
    for (int32_t i = 0; i < n; i++) {
        const int64_t more = fixed_dot(inputs, &update[i * inputs], w, down[i]);
        x[i] = fixed_saturate_int32(((int64_t)kept * w[i]) + more, overflows);
    }
}

static void initialise_state(int32_t n, int32_t inputs, const fixed_coefficient_t start[], const uint8_t down[], const int32_t w[],
                  int32_t x[], uint32_t *overflows)
{
    for (int32_t i = 0; i < n; i++) {
        x[i] = fixed_saturate_int32(fixed_dot(inputs, &start[i * inputs], w, down[i]), overflows);
    }
}

static int32_t clip_symmetric(int64_t value, int32_t limit)
{
    return (int32_t)fixed_clip(value, -(int64_t)limit, limit);
}

static void copy_states(int32_t n, const int32_t from[], int32_t to[])
{
    for (int32_t i = 0; i < n; i++) {
        to[i] = from[i];
    }
}

/* Reference filter: critically damped near the target, on a braking parabola far from it. */
static void filter_reference(const fixed_reference_filter_t *g, int32_t period, fixed_reference_t *s, int32_t target, int32_t target_rate,
                  uint32_t *overflows)
{
    const int64_t gap = target - fixed_round_shift(s->value, 20U);
    int64_t wanted = fixed_multiply_shift(g->slope, gap, FIXED_BITS);
    int64_t rate;

    if (fixed_abs(gap) > g->linear) {
        const int64_t root = fixed_integer_sqrt(g->braking * (fixed_abs(gap) - (g->linear / 2)));
        wanted = (gap < 0) ? -root : root;
    }
    wanted = 16 * fixed_clip(wanted + target_rate, -(int64_t)g->speed, g->speed);
    rate = fixed_clip(fixed_multiply_shift(g->bandwidth, wanted - s->rate, FIXED_BITS), -(int64_t)g->acceleration,
                      g->acceleration);
    s->rate = fixed_saturate_int32(s->rate + fixed_multiply_shift(period, rate, 36U), overflows);
    s->value += fixed_multiply_shift(period, s->rate, 20U);
}

/* Limit a rate to the range between zero and whole. */
static int64_t limit_lead_rate(int64_t rate, int32_t whole)
{
    return (whole > 0) ? fixed_clip(rate, 0, whole) : fixed_clip(rate, whole, 0);
}

static int64_t lead_reference(const fixed_reference_filter_t *g, const fixed_reference_t *s, int32_t target_rate)
{
    const int64_t rate = limit_lead_rate(fixed_round_shift(s->rate, 4U), target_rate);

    return fixed_round_shift(s->value, 20U) + fixed_multiply_shift(g->lead, rate, FIXED_BITS);
}

/* A reading far from the design voltage is a sensor fault. 2^-24 V. */
static int64_t limit_voltage(const fixed_heave_yaw_t *g, int32_t voltage)
{
    const int64_t design = g->design_voltage;

    return 16 * fixed_clip(voltage, design / 2, design + (design / 2));
}

void fixed_engage_heave_yaw(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                  const int32_t motor_input[2])
{
    const fixed_heave_yaw_t *const h = &g->heave_yaw;
    int32_t w[FIXED_HEAVE_YAW_ERRORS + FIXED_OUTPUT_PAIR] = {0};

    c->voltage = (int32_t)limit_voltage(h, now->voltage);
    w[4] = clip_symmetric(-(int64_t)now->rates[2], h->limit[4]);
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) { /* lower, upper */
        const int64_t volts = fixed_multiply_shift(fixed_clip(motor_input[1 - i], 0, FIXED_ONE), c->voltage, FIXED_BITS);
        w[5 + i] = (int32_t)(fixed_multiply_shift(volts, h->per_volt, 34U) - h->trim[i]);
    }
    initialise_state(FIXED_HEAVE_YAW_ORDER, FIXED_HEAVE_YAW_ERRORS + FIXED_OUTPUT_PAIR, &h->start[0][0], h->start_down, w, c->heave_yaw,
          &c->overflows);
    c->origin_z = now->position[2];
    c->origin_psi = now->attitude[2];
    c->height.value = (int64_t)now->position[2] * FIXED_ONE;
    c->heading.value = (int64_t)now->attitude[2] * FIXED_ONE;
    c->height.rate = 0;
    c->heading.rate = 0;
}

static void measure_roll_pitch(const fixed_motion_t *now, int64_t measured[FIXED_ROLL_PITCH_ERRORS])
{
    measured[0] = now->attitude[0];
    measured[1] = now->attitude[1];
    measured[2] = now->rates[0];
    measured[3] = now->rates[1];
}

void fixed_engage_roll_pitch(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now)
{
    const fixed_roll_pitch_t *const r = &g->roll_pitch;
    int64_t measured[FIXED_ROLL_PITCH_ERRORS];
    int32_t w[FIXED_ROLL_PITCH_ERRORS + FIXED_OUTPUT_PAIR] = {0};

    measure_roll_pitch(now, measured);
    for (int32_t i = 0; i < FIXED_ROLL_PITCH_ERRORS; i++) {
        w[i] = clip_symmetric(-measured[i], r->limit[i]);
    }
    initialise_state(FIXED_ROLL_PITCH_ORDER, FIXED_ROLL_PITCH_ERRORS + FIXED_OUTPUT_PAIR, &r->start[0][0], r->start_down, w,
          c->roll_pitch, &c->overflows);
    for (int32_t i = 0; i < FIXED_POSITION_ORDER; i++) {
        c->position[i] = 0;
    }
}

/* In flight, hold the filtered reference if the height trails it by more than the slack. */
static void limit_heave_reference(const fixed_heave_yaw_t *h, fixed_controllers_t *c, int32_t z)
{
    const int64_t trails = z - fixed_round_shift(c->height.value, 20U);
    const int64_t left = h->slack - fixed_abs(trails);
    const int64_t fastest = (left > 0) ? (((int64_t)h->height.speed * left) / h->slack) * 16 : 0;
    const int64_t away = (trails < 0) ? c->height.rate : -(int64_t)c->height.rate;
    const int64_t brake = 2 * fixed_multiply_shift(h->period, h->height.acceleration, 36U);
    const int64_t less = fixed_clip(away - fastest, 0, brake);

    if (left < 0) {
        c->height.value = (int64_t)FIXED_ONE * ((trails < 0) ? ((int64_t)z + h->slack) : ((int64_t)z - h->slack));
    }
    c->height.rate += (int32_t)((trails < 0) ? -less : less);
}

static void drive_motors(const fixed_heave_yaw_t *h, fixed_controllers_t *c, const fixed_motion_t *now,
                           const int32_t reference[4], int32_t motor_input[2])
{
    int32_t w[FIXED_MAX_INPUTS];
    int32_t *const e = &w[FIXED_HEAVE_YAW_ORDER];
    int64_t u[FIXED_OUTPUT_PAIR];
    int64_t top;
    int64_t most;
    int64_t sum;
    int64_t lower;
    int64_t upper;

    filter_reference(&h->height, h->period, &c->height, reference[0], reference[2], &c->overflows);
    filter_reference(&h->heading, h->period, &c->heading, reference[1], reference[3], &c->overflows);
    c->voltage += (int32_t)fixed_multiply_shift(h->voltage_blend, limit_voltage(h, now->voltage) - c->voltage, 30U);
    top = fixed_multiply_shift(c->voltage, h->per_volt, 34U);

    copy_states(FIXED_HEAVE_YAW_ORDER, c->heave_yaw, w);
    e[0] = clip_symmetric(lead_reference(&h->height, &c->height, reference[2]) - c->origin_z, h->limit[0]);
    e[1] = clip_symmetric(lead_reference(&h->heading, &c->heading, reference[3]) - c->origin_psi, h->limit[1]);
    e[2] = clip_symmetric((int64_t)c->origin_z - now->position[2], h->limit[2]);
    e[3] = clip_symmetric((int64_t)c->origin_psi - now->attitude[2], h->limit[3]);
    e[4] = clip_symmetric(-(int64_t)now->rates[2], h->limit[4]);
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        u[i] = fixed_dot(15, h->output[i], w, h->output_down[i]) + h->trim[i];
    }
    /* Yaw has priority: the difference (upper minus lower) is kept as far as possible, the sum is reduced. */
    most = fixed_clip(u[1] - u[0], -top, top);
    sum = fixed_clip(u[1] + u[0], fixed_abs(most), (2 * top) - fixed_abs(most));
    lower = (sum - most) / 2;
    upper = (sum + most) / 2;
    e[5] = fixed_saturate_int32(fixed_round_shift(lower - u[0], EXCESS_SHIFT), &c->overflows);
    e[6] = fixed_saturate_int32(fixed_round_shift(upper - u[1], EXCESS_SHIFT), &c->overflows);
    write_next_state(FIXED_HEAVE_YAW_ORDER, FIXED_MAX_INPUTS, &h->update[0][0], h->update_down, h->kept, w, c->heave_yaw,
            &c->overflows);
    motor_input[0] = (int32_t)fixed_clip((upper * FIXED_ONE) / top, 0, FIXED_ONE);
    motor_input[1] = (int32_t)fixed_clip((lower * FIXED_ONE) / top, 0, FIXED_ONE);
}

static void drive_servos(const fixed_roll_pitch_t *r, fixed_controllers_t *c, const fixed_motion_t *now,
                            const int32_t tilt[2], int32_t servo_input[2])
{
    int64_t measured[FIXED_ROLL_PITCH_ERRORS];
    int32_t w[14];
    int32_t *const e = &w[FIXED_ROLL_PITCH_ORDER];

    measure_roll_pitch(now, measured);
    copy_states(FIXED_ROLL_PITCH_ORDER, c->roll_pitch, w);
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        e[i] = clip_symmetric(clip_symmetric(tilt[i], r->tilt_limit) - measured[i], r->limit[i]);
        e[i + 2] = clip_symmetric(-measured[i + 2], r->limit[i + 2]);
    }
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        const int64_t wanted = fixed_dot(12, r->output[i], w, r->output_down[i]) + r->trim[i];
        servo_input[i] = clip_symmetric(wanted, FIXED_ONE);
        e[4 + i] = fixed_saturate_int32(fixed_round_shift(servo_input[i] - wanted, EXCESS_SHIFT), &c->overflows);
    }
    write_next_state(FIXED_ROLL_PITCH_ORDER, 14, &r->update[0][0], r->update_down, r->kept, w, c->roll_pitch, &c->overflows);
}

/* Limit the length of a vector, keeping its direction. */
static void limit_length(int64_t v[2], int32_t limit)
{
    const int64_t length = fixed_integer_sqrt((v[0] * v[0]) + (v[1] * v[1]));

    if (length > limit) {
        v[0] = (v[0] * limit) / length;
        v[1] = (v[1] * limit) / length;
    }
}

void fixed_compute_tilt_command(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                const fixed_path_t *reference, int32_t tilt[2])
{
    const fixed_position_t *const p = &g->position;
    int32_t w[10];
    int32_t *const e = &w[FIXED_POSITION_ORDER];
    int64_t wanted[2];
    int64_t asked[2];
    int64_t given[2];
    int32_t sine;
    int32_t cosine;

    copy_states(FIXED_POSITION_ORDER, c->position, w);
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        const int64_t gap = (int64_t)reference->position[i] - now->position[i];
        wanted[i] = fixed_clip(reference->velocity[i] + fixed_multiply_shift(p->position_gain, gap, FIXED_BITS), -SIGNAL_LIMIT, SIGNAL_LIMIT);
    }
    limit_length(wanted, p->speed_limit);
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        e[i] = clip_symmetric(wanted[i] - now->velocity[i], p->limit[i]);
    }
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        /* phi = a_y / g, theta = -a_x / g */
        const int64_t a = fixed_clip(reference->acceleration[1 - i], -FEEDFORWARD_LIMIT, FEEDFORWARD_LIMIT);
        const int64_t lean = fixed_multiply_shift((i == 0) ? a : -a, p->per_gravity, 30U);
        asked[i] = fixed_dot(8, p->output[i], w, p->output_down[i]) + lean;
        given[i] = fixed_clip(asked[i], -SIGNAL_LIMIT, SIGNAL_LIMIT);
    }
    limit_length(given, p->tilt_limit);
    for (int32_t i = 0; i < FIXED_OUTPUT_PAIR; i++) {
        e[2 + i] = fixed_saturate_int32(fixed_round_shift(given[i] - asked[i], EXCESS_SHIFT), &c->overflows);
    }
    /* North and east to forward and right. */
    fixed_sine_cosine(now->attitude[2], &sine, &cosine);
    tilt[0] = (int32_t)fixed_round_shift((cosine * given[0]) + (sine * given[1]), 30U);
    tilt[1] = (int32_t)fixed_round_shift((cosine * given[1]) - (sine * given[0]), 30U);
    write_next_state(FIXED_POSITION_ORDER, 10, &p->update[0][0], p->update_down, p->kept, w, c->position, &c->overflows);
}

void fixed_step(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                const int32_t heave_yaw[4], bool flying, const int32_t tilt[2], fixed_actuators_t *out)
{
    out->servo_input[0] = 0;
    out->servo_input[1] = 0;
    if (flying) {
        limit_heave_reference(&g->heave_yaw, c, now->position[2]);
        drive_servos(&g->roll_pitch, c, now, tilt, out->servo_input);
    }
    drive_motors(&g->heave_yaw, c, now, heave_yaw, out->motor_input);
}
