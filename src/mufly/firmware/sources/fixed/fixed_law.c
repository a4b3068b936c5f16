#include "fixed_law.h"

#define REFUSED_DOWN 4U        /* from 2^-20 to 2^-16 */
#define GREAT 1073741824       /* 2^30: 1024 m/s or rad, far beyond what happens; its square fits */
#define MOST_FEEDFORWARD 67108864 /* 64 m/s2 */

/* w: states, errors, refused. x: the next states. */
static void advance(int32_t n, int32_t inputs, const fixed_coefficient_t update[], const uint8_t down[], int32_t kept,
                    const int32_t w[], int32_t x[], uint32_t *overflows)
{
    for (int32_t i = 0; i < n; i++) {
        const int64_t more = fixed_row(inputs, &update[i * inputs], w, down[i]);
        x[i] = fixed_narrow(((int64_t)kept * w[i]) + more, overflows);
    }
}

static void begin(int32_t n, int32_t inputs, const fixed_coefficient_t start[], const uint8_t down[], const int32_t w[],
                  int32_t x[], uint32_t *overflows)
{
    for (int32_t i = 0; i < n; i++) {
        x[i] = fixed_narrow(fixed_row(inputs, &start[i * inputs], w, down[i]), overflows);
    }
}

static int32_t held(int64_t value, int32_t limit)
{
    return (int32_t)fixed_clip(value, -(int64_t)limit, limit);
}

static void copy(int32_t n, const int32_t from[], int32_t to[])
{
    for (int32_t i = 0; i < n; i++) {
        to[i] = from[i];
    }
}

/* A reference filter: critically damped near the target, on a braking parabola far from it. */
static void shape(const fixed_shape_t *g, int32_t period, fixed_shaped_t *s, int32_t target, int32_t target_rate,
                  uint32_t *overflows)
{
    const int64_t gap = target - fixed_rounded(s->value, 20U);
    int64_t wanted = fixed_times(g->slope, gap, FIXED_BITS);
    int64_t rate;

    if (fixed_abs(gap) > g->linear) {
        const int64_t root = fixed_root(g->braking * (fixed_abs(gap) - (g->linear / 2)));
        wanted = (gap < 0) ? -root : root;
    }
    wanted = 16 * fixed_clip(wanted + target_rate, -(int64_t)g->speed, g->speed);
    rate = fixed_clip(fixed_times(g->bandwidth, wanted - s->rate, FIXED_BITS), -(int64_t)g->acceleration,
                      g->acceleration);
    s->rate = fixed_narrow(s->rate + fixed_times(period, rate, 36U), overflows);
    s->value += fixed_times(period, s->rate, 20U);
}

/* What of a rate goes the way of whole, and no further. */
static int64_t share(int64_t rate, int32_t whole)
{
    return (whole > 0) ? fixed_clip(rate, 0, whole) : fixed_clip(rate, whole, 0);
}

static int64_t led(const fixed_shape_t *g, const fixed_shaped_t *s, int32_t target_rate)
{
    const int64_t rate = share(fixed_rounded(s->rate, 4U), target_rate);

    return fixed_rounded(s->value, 20U) + fixed_times(g->lead, rate, FIXED_BITS);
}

/* A reading far off the design voltage is a fault of the sensor, not a battery. 2^-24 V. */
static int64_t believed(const fixed_heave_yaw_t *g, int32_t voltage)
{
    const int64_t design = g->design_voltage;

    return 16 * fixed_clip(voltage, design / 2, design + (design / 2));
}

void fixed_engage(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                  const int32_t motor_input[2])
{
    const fixed_heave_yaw_t *const h = &g->heave_yaw;
    int32_t w[FIXED_HEAVE_YAW_ERRORS + FIXED_PAIR] = {0};

    c->voltage = (int32_t)believed(h, now->voltage);
    w[4] = held(-(int64_t)now->rates[2], h->limit[4]);
    for (int32_t i = 0; i < FIXED_PAIR; i++) { /* lower, upper */
        const int64_t volts = fixed_times(fixed_clip(motor_input[1 - i], 0, FIXED_ONE), c->voltage, FIXED_BITS);
        w[5 + i] = (int32_t)(fixed_times(volts, h->per_volt, 34U) - h->trim[i]);
    }
    begin(FIXED_HEAVE_YAW_ORDER, FIXED_HEAVE_YAW_ERRORS + FIXED_PAIR, &h->start[0][0], h->start_down, w, c->heave_yaw,
          &c->overflows);
    c->origin_z = now->position[2];
    c->origin_psi = now->attitude[2];
    c->height.value = (int64_t)now->position[2] * FIXED_ONE;
    c->heading.value = (int64_t)now->attitude[2] * FIXED_ONE;
    c->height.rate = 0;
    c->heading.rate = 0;
}

static void roll_pitch_of(const fixed_motion_t *now, int64_t measured[FIXED_ROLL_PITCH_ERRORS])
{
    measured[0] = now->attitude[0];
    measured[1] = now->attitude[1];
    measured[2] = now->rates[0];
    measured[3] = now->rates[1];
}

void fixed_lift_off(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now)
{
    const fixed_roll_pitch_t *const r = &g->roll_pitch;
    int64_t measured[FIXED_ROLL_PITCH_ERRORS];
    int32_t w[FIXED_ROLL_PITCH_ERRORS + FIXED_PAIR] = {0};

    roll_pitch_of(now, measured);
    for (int32_t i = 0; i < FIXED_ROLL_PITCH_ERRORS; i++) {
        w[i] = held(-measured[i], r->limit[i]);
    }
    begin(FIXED_ROLL_PITCH_ORDER, FIXED_ROLL_PITCH_ERRORS + FIXED_PAIR, &r->start[0][0], r->start_down, w,
          c->roll_pitch, &c->overflows);
    for (int32_t i = 0; i < FIXED_POSITION_ORDER; i++) {
        c->position[i] = 0;
    }
}

/* In flight the filtered reference waits for a height that trails it by more than the slack. */
static void wait_for_height(const fixed_heave_yaw_t *h, fixed_controllers_t *c, int32_t z)
{
    const int64_t trails = z - fixed_rounded(c->height.value, 20U);
    const int64_t left = h->slack - fixed_abs(trails);
    const int64_t fastest = (left > 0) ? (((int64_t)h->height.speed * left) / h->slack) * 16 : 0;
    const int64_t away = (trails < 0) ? c->height.rate : -(int64_t)c->height.rate;
    const int64_t brake = 2 * fixed_times(h->period, h->height.acceleration, 36U);
    const int64_t less = fixed_clip(away - fastest, 0, brake);

    if (left < 0) {
        c->height.value = (int64_t)FIXED_ONE * ((trails < 0) ? ((int64_t)z + h->slack) : ((int64_t)z - h->slack));
    }
    c->height.rate += (int32_t)((trails < 0) ? -less : less);
}

static void drive_motors(const fixed_heave_yaw_t *h, fixed_controllers_t *c, const fixed_motion_t *now,
                           const int32_t reference[4], int32_t motor_input[2])
{
    int32_t w[FIXED_MOST_INPUTS];
    int32_t *const e = &w[FIXED_HEAVE_YAW_ORDER];
    int64_t u[FIXED_PAIR];
    int64_t top;
    int64_t most;
    int64_t sum;
    int64_t lower;
    int64_t upper;

    shape(&h->height, h->period, &c->height, reference[0], reference[2], &c->overflows);
    shape(&h->heading, h->period, &c->heading, reference[1], reference[3], &c->overflows);
    c->voltage += (int32_t)fixed_times(h->voltage_blend, believed(h, now->voltage) - c->voltage, 30U);
    top = fixed_times(c->voltage, h->per_volt, 34U);

    copy(FIXED_HEAVE_YAW_ORDER, c->heave_yaw, w);
    e[0] = held(led(&h->height, &c->height, reference[2]) - c->origin_z, h->limit[0]);
    e[1] = held(led(&h->heading, &c->heading, reference[3]) - c->origin_psi, h->limit[1]);
    e[2] = held((int64_t)c->origin_z - now->position[2], h->limit[2]);
    e[3] = held((int64_t)c->origin_psi - now->attitude[2], h->limit[3]);
    e[4] = held(-(int64_t)now->rates[2], h->limit[4]);
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        u[i] = fixed_row(15, h->output[i], w, h->output_down[i]) + h->trim[i];
    }
    /* Yaw goes first: the difference (upper less lower) is kept as far as it goes, the sum gives way. */
    most = fixed_clip(u[1] - u[0], -top, top);
    sum = fixed_clip(u[1] + u[0], fixed_abs(most), (2 * top) - fixed_abs(most));
    lower = (sum - most) / 2;
    upper = (sum + most) / 2;
    e[5] = fixed_narrow(fixed_rounded(lower - u[0], REFUSED_DOWN), &c->overflows);
    e[6] = fixed_narrow(fixed_rounded(upper - u[1], REFUSED_DOWN), &c->overflows);
    advance(FIXED_HEAVE_YAW_ORDER, FIXED_MOST_INPUTS, &h->update[0][0], h->update_down, h->kept, w, c->heave_yaw,
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

    roll_pitch_of(now, measured);
    copy(FIXED_ROLL_PITCH_ORDER, c->roll_pitch, w);
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        e[i] = held(held(tilt[i], r->tilt_limit) - measured[i], r->limit[i]);
        e[i + 2] = held(-measured[i + 2], r->limit[i + 2]);
    }
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        const int64_t wanted = fixed_row(12, r->output[i], w, r->output_down[i]) + r->trim[i];
        servo_input[i] = held(wanted, FIXED_ONE);
        e[4 + i] = fixed_narrow(fixed_rounded(servo_input[i] - wanted, REFUSED_DOWN), &c->overflows);
    }
    advance(FIXED_ROLL_PITCH_ORDER, 14, &r->update[0][0], r->update_down, r->kept, w, c->roll_pitch, &c->overflows);
}

/* Shorten two components to a length, direction kept. */
static void shorten(int64_t v[2], int32_t limit)
{
    const int64_t length = fixed_root((v[0] * v[0]) + (v[1] * v[1]));

    if (length > limit) {
        v[0] = (v[0] * limit) / length;
        v[1] = (v[1] * limit) / length;
    }
}

void fixed_tilt(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
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

    copy(FIXED_POSITION_ORDER, c->position, w);
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        const int64_t gap = (int64_t)reference->position[i] - now->position[i];
        wanted[i] = fixed_clip(reference->velocity[i] + fixed_times(p->position_gain, gap, FIXED_BITS), -GREAT, GREAT);
    }
    shorten(wanted, p->speed_limit);
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        e[i] = held(wanted[i] - now->velocity[i], p->limit[i]);
    }
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        /* phi = a_y / g, theta = -a_x / g */
        const int64_t a = fixed_clip(reference->acceleration[1 - i], -MOST_FEEDFORWARD, MOST_FEEDFORWARD);
        const int64_t lean = fixed_times((i == 0) ? a : -a, p->per_gravity, 30U);
        asked[i] = fixed_row(8, p->output[i], w, p->output_down[i]) + lean;
        given[i] = fixed_clip(asked[i], -GREAT, GREAT);
    }
    shorten(given, p->tilt_limit);
    for (int32_t i = 0; i < FIXED_PAIR; i++) {
        e[2 + i] = fixed_narrow(fixed_rounded(given[i] - asked[i], REFUSED_DOWN), &c->overflows);
    }
    /* North and east to forward and right. */
    fixed_sine_cosine(now->attitude[2], &sine, &cosine);
    tilt[0] = (int32_t)fixed_rounded((cosine * given[0]) + (sine * given[1]), 30U);
    tilt[1] = (int32_t)fixed_rounded((cosine * given[1]) - (sine * given[0]), 30U);
    advance(FIXED_POSITION_ORDER, 10, &p->update[0][0], p->update_down, p->kept, w, c->position, &c->overflows);
}

void fixed_step(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                const int32_t heave_yaw[4], bool flying, const int32_t tilt[2], fixed_actuators_t *out)
{
    out->servo_input[0] = 0;
    out->servo_input[1] = 0;
    if (flying) {
        wait_for_height(&g->heave_yaw, c, now->position[2]);
        drive_servos(&g->roll_pitch, c, now, tilt, out->servo_input);
    }
    drive_motors(&g->heave_yaw, c, now, heave_yaw, out->motor_input);
}
