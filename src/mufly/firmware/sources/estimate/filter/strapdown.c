#include "estimate/filter/strapdown.h"

#include "dynamics/flight_model.h"

void rotation_matrix(const real_t q[4], real_t r[9])
{
    const real_t w = q[0];
    const real_t x = q[1];
    const real_t y = q[2];
    const real_t z = q[3];

    r[0] = REAL(1.0) - (REAL(2.0) * ((y * y) + (z * z)));
    r[1] = REAL(2.0) * ((x * y) - (w * z));
    r[2] = REAL(2.0) * ((x * z) + (w * y));
    r[3] = REAL(2.0) * ((x * y) + (w * z));
    r[4] = REAL(1.0) - (REAL(2.0) * ((x * x) + (z * z)));
    r[5] = REAL(2.0) * ((y * z) - (w * x));
    r[6] = REAL(2.0) * ((x * z) - (w * y));
    r[7] = REAL(2.0) * ((y * z) + (w * x));
    r[8] = REAL(1.0) - (REAL(2.0) * ((x * x) + (y * y)));
}

/* Quaternion of a small turn: real part, and factor of the vector part. */
typedef struct {
    real_t c;
    real_t a;
    real_t b;
    real_t d;
} delta_quaternion_t;

/* Return the quaternion of a small turn. */
static delta_quaternion_t half_angle_quaternion(real_t t_x, real_t t_y, real_t t_z)
{
    const real_t square = ((t_x * t_x) + (t_y * t_y)) + (t_z * t_z);
    delta_quaternion_t by;
    real_t k = (REAL(0.5) - (square / REAL(48.0))) + ((square * square) / REAL(3840.0));

    by.c = (REAL(1.0) - (square / REAL(8.0))) + ((square * square) / REAL(384.0));
    if (square > REAL(1.0)) {
        const real_t angle = real_sqrt(square);

        sine_cosine(REAL(0.5) * angle, &k, &by.c);
        k = k / angle;
    }
    by.a = k * t_x;
    by.b = k * t_y;
    by.d = k * t_z;
    return by;
}

/* Multiply a quaternion by a small turn, from the right (s = 1) or the left (s = -1), and normalise it. */
static void multiply_quaternion(real_t q[4], const delta_quaternion_t *by, real_t s)
{
    const real_t w = q[0];
    const real_t x = q[1];
    const real_t y = q[2];
    const real_t z = q[3];
    const real_t n_w = (((w * by->c) - (x * by->a)) - (y * by->b)) - (z * by->d);
    const real_t n_x = ((x * by->c) + (w * by->a)) + (s * ((y * by->d) - (z * by->b)));
    const real_t n_y = ((y * by->c) + (w * by->b)) + (s * ((z * by->a) - (x * by->d)));
    const real_t n_z = ((z * by->c) + (w * by->d)) + (s * ((x * by->b) - (y * by->a)));
    const real_t size =
        REAL(1.0) / real_sqrt((((n_w * n_w) + (n_x * n_x)) + (n_y * n_y)) + (n_z * n_z));

    q[0] = n_w * size;
    q[1] = n_x * size;
    q[2] = n_y * size;
    q[3] = n_z * size;
}

void rotate_attitude(real_t x[STATE_COUNT], real_t t_x, real_t t_y, real_t t_z, bool own)
{
    const delta_quaternion_t by = half_angle_quaternion(t_x, t_y, t_z);

    multiply_quaternion(&x[NOMINAL_ATTITUDE], &by, own ? REAL(1.0) : REAL(-1.0));
}

void predict_state(real_t x[STATE_COUNT], const real_t e[INPUT_ROW_SIZE], real_t dt, real_t r[9], real_t a[6])
{
    const real_t t_x = dt * (e[INPUT_RATES] - x[NOMINAL_GYRO_BIAS]);
    const real_t t_y = dt * (e[INPUT_RATES + 1] - x[NOMINAL_GYRO_BIAS + 1]);
    const real_t t_z = dt * (e[INPUT_RATES + 2] - x[NOMINAL_GYRO_BIAS + 2]);
    const delta_quaternion_t half = half_angle_quaternion(REAL(0.5) * t_x, REAL(0.5) * t_y, REAL(0.5) * t_z);
    real_t n;
    real_t o;
    real_t d;
    real_t f[3];

    multiply_quaternion(&x[NOMINAL_ATTITUDE], &half, REAL(1.0));
    rotation_matrix(&x[NOMINAL_ATTITUDE], r);
    multiply_quaternion(&x[NOMINAL_ATTITUDE], &half, REAL(1.0));
    n = x[NOMINAL_VELOCITY] - x[NOMINAL_WIND];
    o = x[NOMINAL_VELOCITY + 1] - x[NOMINAL_WIND + 1];
    d = x[NOMINAL_VELOCITY + 2];
    for (int32_t k = 0; k < 3; k++) {
        const real_t along = ((r[k] * n) + (r[3 + k] * o)) + (r[6 + k] * d);
        const real_t made = ((x[NOMINAL_THRUST_SCALE] * e[INPUT_THRUST_ACCEL + k]) + e[INPUT_NON_THRUST_ACCEL + k]) + (e[INPUT_ACCEL_PER_VELOCITY + k] * along);
        const real_t share = e[INPUT_ACCEL_WEIGHT + k];

        a[ACCEL_WORK_MODEL + k] = made;
        f[k] = (share * (e[INPUT_ACCEL + k] - x[NOMINAL_ACCEL_BIAS + k])) + ((REAL(1.0) - share) * made);
    }
    for (int32_t k = 0; k < 3; k++) {
        real_t gain;

        a[k] = ((r[3 * k] * f[0]) + (r[(3 * k) + 1] * f[1])) + (r[(3 * k) + 2] * f[2]);
        gain = a[k] + ((k == 2) ? GRAVITY : REAL(0.0));
        x[k] += dt * (x[NOMINAL_VELOCITY + k] + ((REAL(0.5) * dt) * gain));
        x[NOMINAL_VELOCITY + k] += dt * gain;
    }
}

void error_transition(const real_t e[INPUT_ROW_SIZE], real_t span, const real_t r[9], const real_t a[3],
                   real_t out[TRANSITION_SIZE])
{
    const real_t rest[3] = {REAL(1.0) - e[INPUT_ACCEL_WEIGHT], REAL(1.0) - e[INPUT_ACCEL_WEIGHT + 1], REAL(1.0) - e[INPUT_ACCEL_WEIGHT + 2]};
    const real_t slope[3] = {rest[0] * e[INPUT_ACCEL_PER_VELOCITY], rest[1] * e[INPUT_ACCEL_PER_VELOCITY + 1], rest[2] * e[INPUT_ACCEL_PER_VELOCITY + 2]};
    const bool stands = (int32_t)e[INPUT_FLIGHT_PHASE] <= PHASE_MOTORS_RUNNING;

    for (int32_t i = 0; i < 3; i++) {
        real_t thrust = REAL(0.0);

        for (int32_t j = 0; j < 3; j++) {
            const real_t own = span * r[(3 * i) + j];

            out[(3 * i) + j] = own;
            out[TRANSITION_ACCEL + (3 * i) + j] = -own * e[INPUT_ACCEL_WEIGHT + j];
            thrust += own * (rest[j] * e[INPUT_THRUST_ACCEL + j]);
        }
        out[TRANSITION_THRUST + i] = thrust;
        out[TRANSITION_ATTITUDE + i] = stands ? REAL(0.0) : (span * a[i]); /* the floor's force is vertical at any tilt */
    }
    for (int32_t i = 0; i < 3; i++) {
        for (int32_t j = i; j < 3; j++) {
            real_t drag = REAL(0.0);

            for (int32_t k = 0; k < 3; k++) {
                drag += (out[(3 * i) + k] * slope[k]) * r[(3 * j) + k];
            }
            out[TRANSITION_WIND + (3 * i) + j] = drag;
            out[TRANSITION_WIND + (3 * j) + i] = drag;
        }
    }
}

void predict_rotor_force(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t air[3],
                 real_t out[12])
{
    real_t *x = m->flight_model_state;
    static const real_t zero_wind[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    real_t dx[MODEL_STATES];
    const real_t dt = s->dt;
    const real_t to_roll = p->swash_gain * real_min(real_max(m->actuator_inputs[U_SERVO_2], REAL(-1.0)), REAL(1.0));
    const real_t to_pitch = -p->swash_gain * real_min(real_max(m->actuator_inputs[U_SERVO_1], REAL(-1.0)), REAL(1.0));
    const real_t roll = x[MODEL_SWASH_ROLL];
    const real_t pitch = x[MODEL_SWASH_PITCH];
    const real_t bar[3] = {x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2]};
    swash_t swash;
    real_t up;
    real_t dw;
    real_t normal[3];
    real_t size;
    real_t still[3];
    real_t moving[3];

    /* The swash plate settles within the period; its mean is used. */
    x[MODEL_SWASH_ROLL] = to_roll + ((roll - to_roll) * s->swash_lag_decay_mean);
    x[MODEL_SWASH_PITCH] = to_pitch + ((pitch - to_pitch) * s->swash_lag_decay_mean);
    x[MODEL_VELOCITY] = REAL(0.0);
    x[MODEL_VELOCITY + 1] = REAL(0.0);
    x[MODEL_VELOCITY + 2] = REAL(0.0);
    sine_cosine(x[MODEL_SWASH_ROLL], &swash.sin_a, &swash.cos_a);
    sine_cosine(x[MODEL_SWASH_PITCH], &swash.sin_b, &swash.cos_b);
    flight_model(x, m->actuator_inputs, zero_wind, p, &swash, dx);
    up = dx[MODEL_SPEED_UPPER];
    dw = dx[MODEL_SPEED_LOWER];
    x[MODEL_SPEED_UPPER] += (REAL(0.5) * dt) * up;
    x[MODEL_SPEED_LOWER] += (REAL(0.5) * dt) * dw;
    /* The bar in rotating body axes: minus the rotation of the fuselage. */
    normal[0] = bar[0] + (dt * (dx[MODEL_BAR_NORMAL] - ((x[MODEL_RATES + 1] * bar[2]) - (x[MODEL_RATES + 2] * bar[1]))));
    normal[1] = bar[1] + (dt * (dx[MODEL_BAR_NORMAL + 1] - ((x[MODEL_RATES + 2] * bar[0]) - (x[MODEL_RATES] * bar[2]))));
    normal[2] = bar[2] + (dt * (dx[MODEL_BAR_NORMAL + 2] - ((x[MODEL_RATES] * bar[1]) - (x[MODEL_RATES + 1] * bar[0]))));
    size = REAL(1.0) /
           real_sqrt(((normal[0] * normal[0]) + (normal[1] * normal[1])) + (normal[2] * normal[2]));
    for (int32_t k = 0; k < 3; k++) {
        x[MODEL_BAR_NORMAL + k] = REAL(0.5) * (bar[k] + normal[k]);
    }
    flight_model(x, m->actuator_inputs, zero_wind, p, &swash, dx);
    still[0] = dx[MODEL_VELOCITY];
    still[1] = dx[MODEL_VELOCITY + 1];
    still[2] = dx[MODEL_VELOCITY + 2] - GRAVITY;
    for (int32_t k = 0; k < 3; k++) {
        out[k] = still[k];
        x[MODEL_VELOCITY + k] = air[k];
    }
    flight_model(x, m->actuator_inputs, zero_wind, p, &swash, dx);
    for (int32_t k = 0; k < 3; k++) {
        out[ROTOR_ANG_ACCEL + k] = dx[MODEL_RATES + k];
    }
    moving[0] = dx[MODEL_VELOCITY];
    moving[1] = dx[MODEL_VELOCITY + 1];
    moving[2] = dx[MODEL_VELOCITY + 2] - GRAVITY;
    for (int32_t k = 0; k < 3; k++) {
        x[MODEL_VELOCITY + k] = air[k] + DRAG_SLOPE_STEP_M_S;
    }
    flight_model(x, m->actuator_inputs, zero_wind, p, &swash, dx);
    out[ROTOR_ACCEL_PER_VELOCITY] = real_min((dx[MODEL_VELOCITY] - moving[0]) / DRAG_SLOPE_STEP_M_S, REAL(0.0));
    out[ROTOR_ACCEL_PER_VELOCITY + 1] = real_min((dx[MODEL_VELOCITY + 1] - moving[1]) / DRAG_SLOPE_STEP_M_S, REAL(0.0));
    out[ROTOR_ACCEL_PER_VELOCITY + 2] = real_min(((dx[MODEL_VELOCITY + 2] - GRAVITY) - moving[2]) / DRAG_SLOPE_STEP_M_S, REAL(0.0));
    for (int32_t k = 0; k < 3; k++) {
        out[ROTOR_NON_THRUST_ACCEL + k] = (moving[k] - still[k]) - (out[ROTOR_ACCEL_PER_VELOCITY + k] * air[k]);
        x[MODEL_BAR_NORMAL + k] = normal[k] * size;
    }
    x[MODEL_SWASH_ROLL] = to_roll + ((roll - to_roll) * s->swash_lag_decay);
    x[MODEL_SWASH_PITCH] = to_pitch + ((pitch - to_pitch) * s->swash_lag_decay);
    x[MODEL_SPEED_UPPER] = real_max(x[MODEL_SPEED_UPPER] + ((REAL(0.5) * dt) * up), REAL(0.0));
    x[MODEL_SPEED_LOWER] = real_max(x[MODEL_SPEED_LOWER] + ((REAL(0.5) * dt) * dw), REAL(0.0));
    x[MODEL_CHARGE] = real_min(real_max(x[MODEL_CHARGE] + (dt * dx[MODEL_CHARGE]), REAL(0.0)), REAL(1.0));
    m->supply_current = real_max(REAL(0.0), -p->battery_capacity * dx[MODEL_CHARGE]);
}
