#include "dynamics/flight_model.h"

#define FULL_FRICTION_SPEED REAL(1.0) /* speed (rad/s) above which Coulomb friction acts in full */

/* Thrust and torque over the squared speed. */
typedef struct {
    real_t thrust_up;
    real_t thrust_dw;
    real_t torque_up;
    real_t torque_dw;
} rotor_loads_t;

static int32_t min_int(int32_t a, int32_t b)
{
    return (b < a) ? b : a;
}

static real_t clip_with_nan(real_t value, real_t low, real_t high)
{
    return real_min(real_max(value, low), high);
}

#if MAP_NODES > 1 /* omitted for a vehicle without a map */
/* First of four neighbouring points of n, and their weights. */
typedef struct {
    int32_t first;
    real_t weight[4];
} cubic_weights_t;

static int32_t max_int(int32_t a, int32_t b)
{
    return (b > a) ? b : a;
}

static cubic_weights_t cubic_weights(real_t at, int32_t n)
{
    const real_t x = real_min(real_max(at, REAL(0.0)), (real_t)n - REAL(1.0));
    const int32_t i = min_int(real_floor_int(x), n - 2);
    const real_t t = x - (real_t)i;
    real_t a = t * (REAL(-0.5) + (t * (REAL(1.0) - (REAL(0.5) * t))));
    real_t b = REAL(1.0) + ((t * t) * (REAL(-2.5) + (REAL(1.5) * t)));
    real_t c = t * (REAL(0.5) + (t * (REAL(2.0) - (REAL(1.5) * t))));
    real_t d = (t * t) * (REAL(-0.5) + (REAL(0.5) * t));
    cubic_weights_t found;

    if (i == 0) {
        b = b + (REAL(2.0) * a);
        c = c - a;
        a = REAL(0.0);
    }
    if (i == (n - 2)) {
        c = c + (REAL(2.0) * d);
        b = b - d;
        d = REAL(0.0);
    }
    found.first = i - 1;
    found.weight[0] = a;
    found.weight[1] = b;
    found.weight[2] = c;
    found.weight[3] = d;
    return found;
}

static real_t interpolate_climb(const real_t table[MAP_NODES], const int32_t at[4], const real_t weight[4])
{
    return (((weight[0] * table[at[0]]) + (weight[1] * table[at[1]])) + (weight[2] * table[at[2]])) +
           (weight[3] * table[at[3]]);
}

/* Coefficient map over mean speed, speed ratio and climb. */
static void loads_from_map(const real_t x[MODEL_STATES], const real_t wind[3], const flight_model_t *p, rotor_loads_t *out)
{
    const real_t up_n = REAL(-2.0) * ((x[MODEL_ATTITUDE + 1] * x[MODEL_ATTITUDE + 3]) + (x[MODEL_ATTITUDE] * x[MODEL_ATTITUDE + 2]));
    const real_t up_e = REAL(-2.0) * ((x[MODEL_ATTITUDE + 2] * x[MODEL_ATTITUDE + 3]) - (x[MODEL_ATTITUDE] * x[MODEL_ATTITUDE + 1]));
    const real_t up_d = (REAL(2.0) * ((x[MODEL_ATTITUDE + 1] * x[MODEL_ATTITUDE + 1]) + (x[MODEL_ATTITUDE + 2] * x[MODEL_ATTITUDE + 2]))) - REAL(1.0);
    const real_t climb = ((up_n * (x[MODEL_VELOCITY] - wind[0])) + (up_e * (x[MODEL_VELOCITY + 1] - wind[1]))) + (up_d * (x[MODEL_VELOCITY + 2] - wind[2]));
    const real_t up = real_abs(x[MODEL_SPEED_UPPER]);
    const real_t dw = real_abs(x[MODEL_SPEED_LOWER]);
    const real_t mean = REAL(0.5) * (up + dw);
    const real_t ratio = dw / real_max(up, MIN_ROTOR_SPEED_RAD_S);
    const real_t climb_ratio = climb / (real_max(mean, MIN_ROTOR_SPEED_RAD_S) * p->map_radius);
    const int32_t speeds = p->map_size[0];
    const int32_t ratios = p->map_size[1];
    const int32_t climbs = p->map_size[2];
    const real_t fraction = real_min(
        real_max((mean - p->map_start[0]) * p->map_inverse_steps[0], REAL(0.0)), (real_t)speeds - REAL(1.0));
    const int32_t k0 = min_int(real_floor_int(fraction), max_int(speeds - 2, 0));
    const real_t s = fraction - (real_t)k0;
    const cubic_weights_t by_ratio = cubic_weights((ratio - p->map_start[1]) * p->map_inverse_steps[1], ratios);
    const cubic_weights_t by_climb = cubic_weights((climb_ratio - p->map_start[2]) * p->map_inverse_steps[2], climbs);

    out->thrust_up = REAL(0.0);
    out->thrust_dw = REAL(0.0);
    out->torque_up = REAL(0.0);
    out->torque_dw = REAL(0.0);
    for (int32_t k = 0; k < 2; k++) {
        const real_t w = (k == 1) ? s : (REAL(1.0) - s);

        if (w != REAL(0.0)) {
            for (int32_t j = 0; j < 4; j++) {
                const real_t v = w * by_ratio.weight[j];
                const int32_t row =
                    (((k0 + k) * ratios) + min_int(max_int(by_ratio.first + j, 0), ratios - 1)) * climbs;
                const int32_t at[4] = {row + max_int(by_climb.first, 0), row + by_climb.first + 1,
                                       row + by_climb.first + 2,
                                       row + min_int(by_climb.first + 3, climbs - 1)};

                out->thrust_up += v * interpolate_climb(p->thrust_over_speed2_table_up, at, by_climb.weight);
                out->torque_up += v * interpolate_climb(p->torque_over_speed2_table_up, at, by_climb.weight);
                out->thrust_dw += v * interpolate_climb(p->thrust_over_speed2_table_dw, at, by_climb.weight);
                out->torque_dw += v * interpolate_climb(p->torque_over_speed2_table_dw, at, by_climb.weight);
            }
        }
    }
}
#endif

void compute_battery_supply(const real_t x[MODEL_STATES], real_t motor_up, real_t motor_dw, const flight_model_t *p,
             real_t *voltage, real_t *current)
{
    const int32_t last = CURVE_POINTS - 1;
    const real_t emf = p->kE * p->gear_ratio;
    const real_t conductance = ((motor_up * motor_up) + (motor_dw * motor_dw)) / p->R_ohm;
    const real_t source = (((motor_up * emf) * x[MODEL_SPEED_UPPER]) + ((motor_dw * emf) * x[MODEL_SPEED_LOWER])) / p->R_ohm;
    const real_t position = clip_with_nan(x[MODEL_CHARGE], REAL(0.0), REAL(1.0)) * (real_t)last;
    const int32_t k = min_int(real_floor_int(position), last - 1);
    const real_t open = p->battery_curve[k] +
                        ((position - (real_t)k) * (p->battery_curve[k + 1] - p->battery_curve[k]));
    const real_t loaded = (open + (p->battery_resistance * (source - p->electronics_current))) /
                          (REAL(1.0) + (p->battery_resistance * conductance));

    *voltage = real_max(loaded, REAL(0.0));
    *current = (p->electronics_current + (conductance * *voltage)) - source;
}

static real_t rotor_acceleration(const flight_model_t *p, real_t duty, real_t voltage, real_t speed, real_t drag,
                                 real_t inertia)
{
    const real_t current = ((duty * voltage) - ((p->kE * p->gear_ratio) * speed)) / p->R_ohm;
    const real_t turning =
        (real_abs(speed + FULL_FRICTION_SPEED) - real_abs(speed - FULL_FRICTION_SPEED)) / (REAL(2.0) * FULL_FRICTION_SPEED);
    const real_t drive = (((p->kM * current) / p->gear_ratio) - (p->dR * speed)) - ((p->Mf / p->gear_ratio) * turning);

    return (drive - (drag / ((p->gear_ratio * p->gear_ratio) * p->gear_efficiency))) / inertia;
}

/* Drag of a rotor in its disc plane, added to its force. */
static void add_inplane_drag(const real_t n[3], const real_t air[3], const real_t x[MODEL_STATES], real_t hub_z, real_t slope,
                        real_t force[3])
{
    const real_t much = real_abs(slope);
    const real_t forward = air[0] + (x[MODEL_RATES + 1] * hub_z);
    const real_t right = air[1] - (x[MODEL_RATES] * hub_z);
    const real_t along = ((n[0] * forward) + (n[1] * right)) + (n[2] * air[2]);

    force[0] = force[0] + (much * ((along * n[0]) - forward));
    force[1] = force[1] + (much * ((along * n[1]) - right));
    force[2] = force[2] + (much * ((along * n[2]) - air[2]));
}

void flight_model(const real_t x[MODEL_STATES], const real_t u[4], const real_t wind[3], const flight_model_t *p,
                  const swash_t *swash, real_t dx[MODEL_STATES])
{
    const real_t motor_up = clip_with_nan(u[U_MOTOR_UPPER], REAL(0.0), REAL(1.0));
    const real_t motor_dw = clip_with_nan(u[U_MOTOR_LOWER], REAL(0.0), REAL(1.0));
    const real_t servo_1 = clip_with_nan(u[U_SERVO_1], REAL(-1.0), REAL(1.0));
    const real_t servo_2 = clip_with_nan(u[U_SERVO_2], REAL(-1.0), REAL(1.0));
    const real_t qw = x[MODEL_ATTITUDE];
    const real_t qx = x[MODEL_ATTITUDE + 1];
    const real_t qy = x[MODEL_ATTITUDE + 2];
    const real_t qz = x[MODEL_ATTITUDE + 3];
    const real_t wx = x[MODEL_RATES];
    const real_t wy = x[MODEL_RATES + 1];
    const real_t wz = x[MODEL_RATES + 2];
    const real_t bar_n = x[MODEL_BAR_NORMAL];
    const real_t bar_e = x[MODEL_BAR_NORMAL + 1];
    const real_t bar_d = x[MODEL_BAR_NORMAL + 2];
    const real_t speed_up = x[MODEL_SPEED_UPPER];
    const real_t speed_dw = x[MODEL_SPEED_LOWER];
    const real_t a00 = REAL(1.0) - (REAL(2.0) * ((qy * qy) + (qz * qz)));
    const real_t a01 = REAL(2.0) * ((qx * qy) - (qw * qz));
    const real_t a02 = REAL(2.0) * ((qx * qz) + (qw * qy));
    const real_t a10 = REAL(2.0) * ((qx * qy) + (qw * qz));
    const real_t a11 = REAL(1.0) - (REAL(2.0) * ((qx * qx) + (qz * qz)));
    const real_t a12 = REAL(2.0) * ((qy * qz) - (qw * qx));
    const real_t a20 = REAL(2.0) * ((qx * qz) - (qw * qy));
    const real_t a21 = REAL(2.0) * ((qy * qz) + (qw * qx));
    const real_t a22 = REAL(1.0) - (REAL(2.0) * ((qx * qx) + (qy * qy)));
    rotor_loads_t k = {p->thrust_up, p->thrust_dw, p->torque_up, p->torque_dw};
    real_t voltage;
    real_t current;
    real_t drag_up;
    real_t drag_dw;
    real_t accel_up;
    real_t accel_dw;
    real_t thrust_up;
    real_t thrust_dw;
    real_t n_up[3];
    real_t f_up[3];
    real_t f_dw[3];
    real_t air_n;
    real_t air_e;
    real_t air_d;
    real_t air[3];
    real_t fx;
    real_t fy;
    real_t fz;
    real_t downwash;
    real_t mx;
    real_t my;
    real_t mz;
    real_t f_n;
    real_t f_e;
    real_t f_d;
    real_t along;

#if MAP_NODES > 1
    if (p->map_node_count > 0) {
        loads_from_map(x, wind, p, &k);
    }
#endif
    /* Motors and battery. */
    compute_battery_supply(x, motor_up, motor_dw, p, &voltage, &current);
    drag_up = (k.torque_up * speed_up) * real_abs(speed_up);
    drag_dw = (k.torque_dw * speed_dw) * real_abs(speed_dw);
    accel_up = rotor_acceleration(p, motor_up, voltage, speed_up, drag_up, p->J_up);
    accel_dw = rotor_acceleration(p, motor_dw, voltage, speed_dw, drag_dw, p->J_dw);

    /* Thrust. The swash plate tilts the lower rotor; the bar, times the linkage ratio, tilts the upper rotor. */
    thrust_dw = (k.thrust_dw * speed_dw) * speed_dw;
    f_dw[0] = -swash->sin_b * thrust_dw;
    f_dw[1] = (swash->cos_b * swash->sin_a) * thrust_dw;
    f_dw[2] = (-swash->cos_a * swash->cos_b) * thrust_dw;
    n_up[0] = p->bar_gain * (((a00 * bar_n) + (a10 * bar_e)) + (a20 * bar_d));
    n_up[1] = p->bar_gain * (((a01 * bar_n) + (a11 * bar_e)) + (a21 * bar_d));
    n_up[2] = -real_sqrt(
        real_max((REAL(1.0) - (n_up[0] * n_up[0])) - (n_up[1] * n_up[1]), REAL(0.0)));
    thrust_up = (k.thrust_up * speed_up) * speed_up;
    f_up[0] = n_up[0] * thrust_up;
    f_up[1] = n_up[1] * thrust_up;
    f_up[2] = n_up[2] * thrust_up;

    /* Velocity through the air, body axes. */
    air_n = x[MODEL_VELOCITY] - wind[0];
    air_e = x[MODEL_VELOCITY + 1] - wind[1];
    air_d = x[MODEL_VELOCITY + 2] - wind[2];
    air[0] = ((a00 * air_n) + (a10 * air_e)) + (a20 * air_d);
    air[1] = ((a01 * air_n) + (a11 * air_e)) + (a21 * air_d);
    air[2] = ((a02 * air_n) + (a12 * air_e)) + (a22 * air_d);
    if (p->inplane > REAL(0.0)) {
        const real_t n_dw[3] = {-swash->sin_b, swash->cos_b * swash->sin_a, -swash->cos_a * swash->cos_b};

        add_inplane_drag(n_up, air, x, p->z_up, p->inplane * speed_up, f_up);
        add_inplane_drag(n_dw, air, x, p->z_dw, p->inplane * speed_dw, f_dw);
    }
    fx = (f_up[0] + f_dw[0]) - ((p->drag_over_speed2_x * real_abs(air[0])) * air[0]);
    fy = (f_up[1] + f_dw[1]) - ((p->drag_over_speed2_y * real_abs(air[1])) * air[1]);
    downwash = p->downwash_drag *
               real_min(REAL(1.0), (REAL(2.0) * (thrust_up + thrust_dw)) / (p->mass * GRAVITY));
    fz = ((f_up[2] + f_dw[2]) - ((p->drag_over_speed2_z * real_abs(air[2])) * air[2])) + downwash;
    mx = (-p->z_up * f_up[1]) - (p->z_dw * f_dw[1]);
    my = (p->z_up * f_up[0]) + (p->z_dw * f_dw[0]);
    mz = (drag_up + (p->Jreact_up * accel_up)) - (drag_dw + (p->Jreact_dw * accel_dw));
    f_n = ((a00 * fx) + (a01 * fy)) + (a02 * fz);
    f_e = ((a10 * fx) + (a11 * fy)) + (a12 * fz);
    f_d = ((a20 * fx) + (a21 * fy)) + (a22 * fz);

    dx[MODEL_POSITION] = x[MODEL_VELOCITY];
    dx[MODEL_POSITION + 1] = x[MODEL_VELOCITY + 1];
    dx[MODEL_POSITION + 2] = x[MODEL_VELOCITY + 2];
    dx[MODEL_VELOCITY] = f_n / p->mass;
    dx[MODEL_VELOCITY + 1] = f_e / p->mass;
    dx[MODEL_VELOCITY + 2] = (f_d / p->mass) + GRAVITY;
    dx[MODEL_ATTITUDE] = REAL(0.5) * (((-qx * wx) - (qy * wy)) - (qz * wz));
    dx[MODEL_ATTITUDE + 1] = REAL(0.5) * (((qw * wx) + (qy * wz)) - (qz * wy));
    dx[MODEL_ATTITUDE + 2] = REAL(0.5) * (((qw * wy) - (qx * wz)) + (qz * wx));
    dx[MODEL_ATTITUDE + 3] = REAL(0.5) * (((qw * wz) + (qx * wy)) - (qy * wx));
    dx[MODEL_RATES] = (mx - (((p->Izz - p->Iyy) * wy) * wz)) / p->Ixx;
    dx[MODEL_RATES + 1] = (my - (((p->Ixx - p->Izz) * wz) * wx)) / p->Iyy;
    dx[MODEL_RATES + 2] = (mz - (((p->Iyy - p->Ixx) * wx) * wy)) / p->Izz;
    dx[MODEL_SWASH_ROLL] = p->swash_rate * ((p->swash_gain * servo_2) - x[MODEL_SWASH_ROLL]);
    dx[MODEL_SWASH_PITCH] = p->swash_rate * ((-p->swash_gain * servo_1) - x[MODEL_SWASH_PITCH]);
    along = -(((a02 * bar_n) + (a12 * bar_e)) + (a22 * bar_d));
    dx[MODEL_BAR_NORMAL] = p->bar_rate * (-a02 - (along * bar_n));
    dx[MODEL_BAR_NORMAL + 1] = p->bar_rate * (-a12 - (along * bar_e));
    dx[MODEL_BAR_NORMAL + 2] = p->bar_rate * (-a22 - (along * bar_d));
    dx[MODEL_SPEED_UPPER] = accel_up;
    dx[MODEL_SPEED_LOWER] = accel_dw;
    dx[MODEL_CHARGE] = -current / p->battery_capacity;
}
