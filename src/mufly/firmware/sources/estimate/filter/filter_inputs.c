#include "estimate/filter/filter_inputs.h"

#include "dynamics/flight_model.h"
#include "estimate/filter/filter_horizon.h"
#include "estimate/filter/measurements/fusion.h"
#include "estimate/filter/measurements/sensor_checks.h"
#include "estimate/filter/output_predictor.h"
#include "estimate/filter/strapdown.h"
#include "estimate/filter/ud_filter.h"

/* Update the flight phase from the rotors' lift and the height. */
static real_t update_flight_phase(estimator_t *m, const estimator_settings_t *s, const real_t z[INPUT_VALUE_COUNT])
{
    const real_t lift =
        (s->has_rotor_model > 0) ? ((-m->rotor_model_rows[wrap_index(m->tick, ROTOR_FORCE_HISTORY)][ROTOR_THRUST_ACCEL + 2] * m->x[NOMINAL_THRUST_SCALE]) / GRAVITY) : REAL(1.0);
    const real_t height = height_above_ground(m->x_output, s);
    const bool off = (z[ACTUATOR_START] + z[ACTUATOR_START + 1]) < REAL(0.02);
    /* Rotors with more lift than modelled leave the floor earlier, others later. */
    const real_t doubt = (s->has_rotor_model > 0) ? (LIFTOFF_THRUST_SIGMA_LIMIT * m->sigma_output[ERROR_THRUST_SCALE]) : REAL(0.0);
    /* The sonar is newer than the estimated height, except below the floor. */
    const bool says = (m->status[READING_SONAR] == STATUS_FUSED) && (height < MAX_SONAR_LIFTOFF_HEIGHT_M) && (m->x[NOMINAL_TERRAIN] > MIN_TERRAIN_HEIGHT_M);
    const bool near = says && (m->last_value[READING_STARTS[READING_SONAR]] <= (m->sonar_effective_min_range + (REAL(0.5) * s->sonar_resolution)));
    const bool clear = says && (m->last_value[READING_STARTS[READING_SONAR]] > (m->sonar_effective_min_range + SONAR_LIFTOFF_EXCESS_M));

    real_t rises = REAL(0.0);

    m->is_sonar_at_minimum = near ? 1 : 0;
    if (m->flight_phase <= PHASE_MOTORS_RUNNING) {
        const real_t turning = m->flight_model_state[MODEL_SPEED_UPPER] + m->flight_model_state[MODEL_SPEED_LOWER];
        const bool stands = turning <= (STOPPED_ROTOR_SPEED_FRACTION * (s->hover_speed[0] + s->hover_speed[1]));

        m->flight_phase = stands ? PHASE_STANDING : PHASE_ROTORS_COASTING;
        if (!off) {
            m->flight_phase = PHASE_MOTORS_RUNNING;
        }
        if (((lift * (REAL(1.0) + doubt)) > REAL(0.9)) && (m->flight_phase == PHASE_MOTORS_RUNNING)) {
            m->flight_phase = PHASE_LIFTING_OFF;
            m->is_initialised = 1;
        }
    } else if (m->flight_phase == PHASE_LIFTING_OFF) {
        if (((height > (REAL(0.03) + real_min(REAL(2.0) * m->sigma_output[ERROR_POSITION + 2], REAL(0.1)))) && !near) || clear ||
            (lift > (REAL(1.1) + doubt))) {
            m->flight_phase = PHASE_FLYING;
            rises = (says && !near && (s->has_rotor_model > 0)) ? (lift / m->x[NOMINAL_THRUST_SCALE]) : REAL(0.0);
        } else if (((lift * (REAL(1.0) + doubt)) < REAL(0.85)) && (height < REAL(0.02))) {
            m->flight_phase = PHASE_MOTORS_RUNNING;
        } else {
            /* still light */
        }
    } else if (((height < REAL(0.015)) && (lift < REAL(0.9)) && !clear) || (near && (lift < (REAL(1.1) + doubt)))) {
        m->flight_phase = PHASE_LIFTING_OFF;
    } else {
        /* flies on */
    }
    if (off && (m->flight_phase >= PHASE_LIFTING_OFF) && (height < REAL(0.05)) && (m->flight_model_state[MODEL_SPEED_UPPER] < (REAL(0.3) * s->hover_speed[0]))) {
        m->flight_phase = PHASE_MOTORS_RUNNING;
    }
    if (m->flight_phase != PHASE_FLYING) {
        m->last_grounded_tick = m->tick;
    }
    return rises;
}

/* Update the rotor model by a period, and correct it by measured rotor speeds and voltage. */
static void update_rotor_model(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                      const int32_t *fresh)
{
    predict_rotor_force(m, s, p, m->axis_work, m->rotor_model_rows[wrap_index(m->tick, ROTOR_FORCE_HISTORY)]);
    for (int32_t k = 0; k < 2; k++) {
        m->flight_model_state[MODEL_SPEED_UPPER + k] += s->dt * m->rotor_spin_accel_bias[k];
    }
    if (fresh[READING_ROTOR_SPEED] == 1) {
        const real_t *speed = &z[READING_STARTS[READING_ROTOR_SPEED]];

        if (check_rotor_speed(m, s, speed)) {
            for (int32_t k = 0; k < 2; k++) {
                const real_t off = speed[k] - m->flight_model_state[MODEL_SPEED_UPPER + k];

                m->flight_model_state[MODEL_SPEED_UPPER + k] += s->rotor_speed_filter_gain * off;
                m->rotor_spin_accel_bias[k] += s->rotor_spin_accel_bias_gain * off;
            }
        }
    }
    if (fresh[READING_BATTERY] == 1) {
        real_t voltage;
        real_t current;
        real_t off;

        compute_battery_supply(m->flight_model_state, m->actuator_inputs[0], m->actuator_inputs[1], p, &voltage, &current);
        off = z[READING_STARTS[READING_BATTERY]] - voltage;
        if (check_battery_voltage(m, s, off)) {
            const real_t fast = (((real_t)m->tick * s->dt) < REAL(1.0)) ? REAL(0.2) : REAL(0.02);

            m->flight_model_state[MODEL_CHARGE] =
                real_min(real_max(m->flight_model_state[MODEL_CHARGE] + (fast * off), REAL(0.0)), REAL(1.0));
        }
    }
}

/* Average the inputs of this period into their block. */
static void average_inputs(estimator_t *m, const estimator_settings_t *s)
{
    real_t *into = input_block(m, s, m->tick - 1);
    const int32_t count = wrap_index(m->tick - 1, s->block_ticks) + 1;
    const real_t share = REAL(1.0) / (real_t)count;

    for (int32_t j = 0; j < (INPUT_ROW_SIZE - 1); j++) {
        into[j] = (count == 1) ? m->inputs_now[j] : (into[j] + (share * (m->inputs_now[j] - into[j])));
    }
    into[INPUT_ROW_SIZE - 1] = m->inputs_now[INPUT_ROW_SIZE - 1];
}

/* Return the density of the force's error on the legs or just off them (m2/s3). */
static real_t ground_force_noise(const estimator_t *m, real_t force)
{
    const real_t spread =
        (m->is_sonar_at_minimum == 1) ? GROUND_FORCE_ERROR_M_S2 : real_max(m->sigma_output[ERROR_THRUST_SCALE] * -force, GROUND_FORCE_ERROR_M_S2);
    const real_t over = (((-m->x_output[NOMINAL_THRUST_SCALE]) * force) - GRAVITY) / spread;
    const real_t may = real_min(real_max(REAL(1.0) + (over / LIFTOFF_THRUST_SIGMA_LIMIT), REAL(0.0)), REAL(1.0)) * spread;

    return (TWICE_ACCEL_ERROR_CORRELATION_S * may) * may;
}

real_t compute_prediction_inputs(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                   const int32_t *fresh)
{
    const int32_t now = wrap_index(m->tick, ROTOR_FORCE_HISTORY);
    const int32_t a = wrap_index(now - s->imu_lag_ticks, ROTOR_FORCE_HISTORY);
    const int32_t b = wrap_index((now - s->imu_lag_ticks) - 1, ROTOR_FORCE_HISTORY);
    real_t *row = m->inputs_now;
    real_t r[9];
    real_t n;
    real_t e;
    real_t d;
    real_t rises;

    for (int32_t j = 0; j < 4; j++) {
        const real_t sent = z[ACTUATOR_START + j];

        m->actuator_inputs[j] = (sent == sent) ? real_min(real_max(sent, REAL(-1.0)), REAL(1.0)) : REAL(0.0);
    }
    rotation_matrix(&m->x_output[NOMINAL_ATTITUDE], r);
    n = m->x_output[NOMINAL_VELOCITY] - m->x_output[NOMINAL_WIND];
    e = m->x_output[NOMINAL_VELOCITY + 1] - m->x_output[NOMINAL_WIND + 1];
    d = m->x_output[NOMINAL_VELOCITY + 2];
    for (int32_t k = 0; k < 3; k++) {
        m->axis_work[k] = ((r[k] * n) + (r[3 + k] * e)) + (r[6 + k] * d);
        m->flight_model_state[MODEL_RATES + k] = m->gyro_rates[k] - m->x_output[NOMINAL_GYRO_BIAS + k];
    }
    if (s->has_rotor_model > 0) {
        update_rotor_model(m, s, p, z, fresh);
    }
    rises = update_flight_phase(m, s, z);
    for (int32_t k = 0; k < 3; k++) {
        const real_t clip = (m->clipped_fraction[k] * CLIPPING_ERROR_FRACTION) * s->accel_range;
        /* Without vibration; but if the attitude is unknown, the model's force is the better one. */
        const real_t noise = (m->status[READING_RATES] < STATUS_MISSING)
                                 ? m->accel_low_frequency_noise_density[k]
                                 : (m->vibration_velocity_variance[k] / ((real_t)FORCE_MEAN_TICKS * s->dt));
        real_t felt = ((s->has_rotor_model > 0) ? real_max(s->accel_noise_density, noise) : s->accel_noise_density) + ((TWICE_ACCEL_ERROR_CORRELATION_S * clip) * clip);
        real_t made = s->model_accel_noise_density[k];
        real_t share;

        row[k] = REAL(0.5) * (m->gyro_rates[k] + m->gyro_rates_prev[k]);
        row[INPUT_ACCEL + k] = z[k];
        for (int32_t g = 0; g < 3; g++) {
            row[INPUT_THRUST_ACCEL + (3 * g) + k] = ((REAL(1.0) - s->imu_lag_remainder) * m->rotor_model_rows[a][ROTOR_THRUST_ACCEL + (3 * g) + k]) +
                                   (s->imu_lag_remainder * m->rotor_model_rows[b][ROTOR_THRUST_ACCEL + (3 * g) + k]);
        }
        if (m->flight_phase <= PHASE_MOTORS_RUNNING) {
            row[INPUT_THRUST_ACCEL + k] = REAL(0.0);
            row[INPUT_NON_THRUST_ACCEL + k] = -GRAVITY * r[6 + k];
            row[INPUT_ACCEL_PER_VELOCITY + k] = REAL(0.0);
            felt = REAL(1e6);
            made = REAL(1e-3);
        } else if (m->flight_phase == PHASE_LIFTING_OFF) {
            /* Legs may support the weight that the rotors do not: no thrust is estimated. */
            row[INPUT_NON_THRUST_ACCEL + k] += m->x_output[NOMINAL_THRUST_SCALE] * row[INPUT_THRUST_ACCEL + k];
            if (k == 2) {
                row[INPUT_NON_THRUST_ACCEL + 2] = (m->is_sonar_at_minimum == 1) ? (-GRAVITY * r[8]) : real_min(row[INPUT_NON_THRUST_ACCEL + 2], -GRAVITY * r[8]);
            }
            made = REAL(0.05);
            if (k == 2) {
                made += ground_force_noise(m, row[INPUT_THRUST_ACCEL + 2]);
            }
            row[INPUT_THRUST_ACCEL + k] = REAL(0.0);
        } else if (s->has_rotor_model > 0) {
            /* Until the thrust is known, after more than the delay, the accelerometers have the higher weight. */
            const real_t unknown = real_max(m->sigma_output[ERROR_THRUST_SCALE] - MODELLED_THRUST_SIGMA, REAL(0.0)) * row[INPUT_THRUST_ACCEL + k];

            made += (THRUST_ERROR_CORRELATION_S * unknown) * unknown;
        } else {
            /* flight without a model */
        }
        if ((s->has_rotor_model <= 0) && (m->flight_phase > PHASE_MOTORS_RUNNING)) {
            row[INPUT_THRUST_ACCEL + k] = REAL(0.0);
            row[INPUT_NON_THRUST_ACCEL + k] = (k == 2) ? -GRAVITY : REAL(0.0);
            row[INPUT_ACCEL_PER_VELOCITY + k] = REAL(0.0);
            made = REAL(10.0);
        }
        if (m->accel_model_diagnosis == DIAGNOSIS_MODEL_WRONG) {
            made = real_max(made, WRONG_MODEL_NOISE_DENSITY);
        } else if (m->is_accel_distrusted == 1) {
            felt = REAL(1e6);
        } else {
            /* both are used */
        }
        if ((m->status[READING_ACCELERATION] >= STATUS_MISSING) || (s->is_fitted[READING_ACCELERATION] == 0)) {
            felt = REAL(1e6);
        }
        share = made / (felt + made);
        row[INPUT_ACCEL_WEIGHT + k] = share;
        row[INPUT_NOISE_DENSITY + k] = felt * share;
    }
    row[INPUT_ROW_SIZE - 1] = (real_t)m->flight_phase;
    average_inputs(m, s);
    return rises;
}

/* Apply the new noise of an accelerometer to buffered inputs that the horizon has not reached. */
static void backdate_accel_noise(estimator_t *m, const estimator_settings_t *s, int32_t k)
{
    for (int32_t at = m->horizon_tick; at < m->tick; at += s->block_ticks) {
        real_t *e = input_block(m, s, at);
        const real_t share = real_max(e[INPUT_ACCEL_WEIGHT + k], REAL(1e-9));
        const real_t felt = real_max(e[INPUT_NOISE_DENSITY + k] / share, m->accel_low_frequency_noise_density[k]);
        const real_t made = e[INPUT_NOISE_DENSITY + k] / real_max(REAL(1.0) - share, REAL(1e-9));

        e[INPUT_ACCEL_WEIGHT + k] = made / (felt + made);
        e[INPUT_NOISE_DENSITY + k] = felt * e[INPUT_ACCEL_WEIGHT + k];
    }
}

void estimate_accel_noise(estimator_t *m, const estimator_settings_t *s, const real_t z[3])
{
    const real_t *row = m->inputs_now;
    real_t weight;

    m->slow_residual_count += 1;
    weight = (real_t)((m->slow_residual_count <= (SLOW_NOISE_WINDOW_TICKS / 2)) ? m->slow_residual_count : ((SLOW_NOISE_WINDOW_TICKS + 1) - m->slow_residual_count));
    for (int32_t k = 0; k < 3; k++) {
        real_t off = z[k] - ((m->x[NOMINAL_THRUST_SCALE] * row[INPUT_THRUST_ACCEL + k]) + row[INPUT_NON_THRUST_ACCEL + k]);
        real_t vibrating;

        off -= row[INPUT_ACCEL_PER_VELOCITY + k] * m->axis_work[k];
        m->slow_residual_sum[k] += weight * off;
        off -= m->slow_residual_mean_prev[k];
        m->vibration_velocity[k] += s->dt * (off - (m->vibration_velocity[k] / VIBRATION_HIGH_PASS_S));
        vibrating = m->vibration_velocity[k] + (s->imu_lag * off);
        m->vibration_velocity_variance[k] += VIBRATION_VARIANCE_GAIN * ((vibrating * vibrating) - m->vibration_velocity_variance[k]);
    }
    if (m->slow_residual_count >= SLOW_NOISE_WINDOW_TICKS) {
        const real_t half = (real_t)(SLOW_NOISE_WINDOW_TICKS / 2);
        const real_t span = (REAL(0.75) * (real_t)SLOW_NOISE_WINDOW_TICKS) * s->dt;
        /* After lift-off the modelled force changes, and the thrust scale has to converge first. */
        const bool settled = (m->flight_phase != PHASE_FLYING) || ((m->tick - m->last_grounded_tick) > (2 * SLOW_NOISE_WINDOW_TICKS));

        for (int32_t k = 0; k < 3; k++) {
            const real_t mean = m->slow_residual_sum[k] / (half * (half + REAL(1.0)));
            /* The model's uncertainty, large at lift-off, is not noise of the accelerometers. */
            const real_t unknown = (REAL(2.0) * m->sigma_output[ERROR_THRUST_SCALE]) * real_abs(row[INPUT_THRUST_ACCEL + k]);
            const real_t step = real_max(real_abs(mean - m->slow_residual_mean_prev[k]) - unknown, REAL(0.0));
            const real_t made = row[INPUT_NOISE_DENSITY + k] / real_max(REAL(1.0) - row[INPUT_ACCEL_WEIGHT + k], REAL(1e-9));
            real_t density = real_max((((REAL(0.5) * step) * step) * span) - made, REAL(0.0));
            real_t most;

            if ((m->flight_phase == PHASE_FLYING) && settled) {
                const real_t apart = real_abs(mean - m->x[NOMINAL_ACCEL_BIAS + k]) - (MAX_MODEL_DISAGREEMENT_M_S2 + (unknown + (REAL(2.0) * m->sigma_output[ERROR_ACCEL_BIAS + k])));

                density += real_max(apart, REAL(0.0)) * real_max(apart, REAL(0.0));
                if (apart > ((((m->clipped_fraction[0] + m->clipped_fraction[1]) + m->clipped_fraction[2]) * CLIPPING_ERROR_FRACTION) * s->accel_range)) {
                    m->accel_model_difference_tick = m->tick;
                }
            }
            density = real_min(density, REAL(100.0));
            most = real_max((density > m->accel_low_frequency_noise_density[k]) ? REAL(0.6) : REAL(0.2),
                            REAL(1.0) / (real_t)(m->slow_residual_mean_count + 1));
            m->slow_residual_mean_prev[k] = mean;
            m->slow_residual_sum[k] = REAL(0.0);
            if (settled) {
                m->accel_low_frequency_noise_density[k] += most * (density - m->accel_low_frequency_noise_density[k]);
                if (density > made) {
                    backdate_accel_noise(m, s, k);
                }
            }
        }
        m->slow_residual_count = 0;
        m->slow_residual_mean_count += 1;
        if ((m->status[READING_ACCELERATION] == STATUS_REJECTED) && (m->tick >= m->fault_until_tick[READING_ACCELERATION])) {
            m->status[READING_ACCELERATION] = STATUS_FUSED;
            m->reason[READING_ACCELERATION] = REASON_NONE;
        }
    }
}

/* Turn two vectors, one after the other, from the axes of a tilted inertial unit to those of the vehicle. */
static void rotate_to_level(const estimator_t *m, real_t v[6])
{
    const real_t *r = m->levelling_rotation;

    for (int32_t i = 0; i < 6; i += 3) {
        const real_t x = v[i];
        const real_t y = v[i + 1];
        const real_t z = v[i + 2];

        for (int32_t k = 0; k < 3; k++) {
            v[i + k] = ((r[3 * k] * x) + (r[(3 * k) + 1] * y)) + (r[(3 * k) + 2] * z);
        }
    }
}

/* Reset a state to level attitude and no bias of the accelerometers. */
static void restart_level_state(real_t x[STATE_COUNT])
{
    const real_t turn = real_sqrt((x[NOMINAL_ATTITUDE] * x[NOMINAL_ATTITUDE]) + (x[NOMINAL_ATTITUDE + 3] * x[NOMINAL_ATTITUDE + 3]));

    x[NOMINAL_ATTITUDE] /= turn;
    x[NOMINAL_ATTITUDE + 3] /= turn;
    for (int32_t k = 0; k < 3; k++) {
        x[NOMINAL_ACCEL_BIAS + k] = REAL(0.0);
    }
    x[NOMINAL_ATTITUDE + 1] = REAL(0.0);
    x[NOMINAL_ATTITUDE + 2] = REAL(0.0);
}

/* Rotate the inputs since the horizon level; reset to level attitude and no bias of the accelerometers. */
static void reset_to_level(estimator_t *m, const estimator_settings_t *s)
{
    real_t *const states[4] = {m->x, m->x_repropagating, m->x_now, m->x_output};

    for (int32_t b = 0; b < INPUT_HISTORY_BLOCKS; b++) {
        rotate_to_level(m, &m->input_blocks[b][INPUT_RATES]);
    }
    clear_block_forces(m);
    m->task_stage = STAGE_DONE;
    for (int32_t i = 0; i < 4; i++) {
        restart_level_state(states[i]);
    }
    for (int32_t k = 0; k < 3; k++) {
        const real_t tilt = s->initial_sigma[ERROR_ATTITUDE + k];
        const real_t bias = s->initial_sigma[ERROR_ACCEL_BIAS + k];

        if (k < 2) {
            inflate_by_sigma(m, ERROR_ATTITUDE + k, tilt);
        }
        inflate_by_sigma(m, ERROR_ACCEL_BIAS + k, bias);
    }
}

/* Decide by the accelerometers' sum at rest whether the inertial unit is tilted; reset the filter if so. */
static void decide_levelling(estimator_t *m, const estimator_settings_t *s)
{
    const real_t size = real_sqrt(((m->levelling_accel_sum[0] * m->levelling_accel_sum[0]) + (m->levelling_accel_sum[1] * m->levelling_accel_sum[1])) +
                                  (m->levelling_accel_sum[2] * m->levelling_accel_sum[2]));
    const real_t x = -m->levelling_accel_sum[1] / size;
    const real_t y = m->levelling_accel_sum[0] / size;
    const real_t d = -m->levelling_accel_sum[2] / size;
    const real_t tilt = s->initial_sigma[ERROR_ACCEL_BIAS] / GRAVITY;
    const real_t q = (x * x) + (y * y);
    const real_t explained = (s->rest_tilt_sigma * s->rest_tilt_sigma) + (tilt * tilt);

    m->mount_variance[0] = REAL(0.5) * q; /* the tilt may be a bias, a lean or the unit's */
    m->mount_variance[1] = m->mount_variance[0];
    if ((q > ((LEVELLING_GATE_SIGMAS * LEVELLING_GATE_SIGMAS) * explained)) && (d > REAL(0.875))) {
        const real_t half = real_sqrt((REAL(0.5) * d) + REAL(0.5));
        const real_t turn[4] = {half, (REAL(0.5) * x) / half, (REAL(0.5) * y) / half, REAL(0.0)};

        rotation_matrix(turn, m->levelling_rotation);
        m->has_levelling_rotation = 1;
        reset_to_level(m, s);
        set_fault(m, s, READING_ACCELERATION, STATUS_FUSED, REASON_LEVELLED, real_sqrt(q));
    }
}

void level_inertial_unit(estimator_t *m, const estimator_settings_t *s, real_t z[INPUT_VALUE_COUNT])
{
    const int32_t needed = (int32_t)(LEVELLING_REST_S / s->dt);

    if (m->levelling_ticks < needed) {
        bool still = (m->flight_phase == PHASE_STANDING) && (m->status[READING_ACCELERATION] == STATUS_FUSED);

        for (int32_t k = 0; k < 3; k++) {
            still = still && (real_abs(z[READING_STARTS[READING_RATES] + k]) < LEVELLING_MAX_RATE_RAD_S);
        }
        if ((m->flight_phase > PHASE_STANDING) || (s->has_rotor_model == 0)) {
            m->levelling_ticks = needed;
        } else if (!still) {
            m->levelling_ticks = 0;
            m->levelling_accel_sum[0] = REAL(0.0);
            m->levelling_accel_sum[1] = REAL(0.0);
            m->levelling_accel_sum[2] = REAL(0.0);
        } else {
            m->levelling_ticks += 1;
            for (int32_t k = 0; k < 3; k++) {
                m->levelling_accel_sum[k] += z[READING_STARTS[READING_ACCELERATION] + k];
            }
            if (m->levelling_ticks == needed) {
                decide_levelling(m, s);
            }
        }
    }
    if (m->has_levelling_rotation == 1) {
        rotate_to_level(m, &z[READING_STARTS[READING_ACCELERATION]]);
    }
}
