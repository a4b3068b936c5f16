#include "estimate/filter/output_predictor.h"

#include "estimate/filter/strapdown.h"
#include "estimate/filter/ud_filter.h"

real_t *input_block(estimator_t *m, const estimator_settings_t *s, int32_t tick)
{
    return m->input_blocks[wrap_index(tick / s->block_ticks, INPUT_HISTORY_BLOCKS)];
}

real_t velocity_noise_density(const real_t r[9], int32_t k, const real_t e[INPUT_ROW_SIZE])
{
    real_t spread = REAL(0.0);

    for (int32_t i = 0; i < 3; i++) {
        spread += (r[(3 * k) + i] * r[(3 * k) + i]) * e[INPUT_NOISE_DENSITY + i];
    }
    return spread;
}

/* Remove a large jump of the output's position and let it decay over OUTPUT_JUMP_DECAY_S. */
static void smooth_output(estimator_t *m, const estimator_settings_t *s)
{
    real_t *x = m->x_output;

    for (int32_t k = 0; k < 3; k++) {
        const real_t jump = x[k] - (m->position_prev[k] + (s->dt * x[NOMINAL_VELOCITY + k]));

        if ((m->is_initialised > 0) && (real_abs(jump) > OUTPUT_JUMP_M)) {
            m->position_jump_remainder[k] -= jump * real_min((real_abs(jump) / OUTPUT_JUMP_M) - REAL(1.0), REAL(1.0));
        }
        m->position_prev[k] = x[k];
        m->position_jump_remainder[k] -= (s->dt / OUTPUT_JUMP_DECAY_S) * m->position_jump_remainder[k];
        x[k] += m->position_jump_remainder[k];
    }
}

/* Write roll, pitch and yaw of the output. */
static void write_output_angles(estimator_t *m)
{
    const real_t w = m->x_output[NOMINAL_ATTITUDE];
    const real_t x = m->x_output[NOMINAL_ATTITUDE + 1];
    const real_t y = m->x_output[NOMINAL_ATTITUDE + 2];
    const real_t z = m->x_output[NOMINAL_ATTITUDE + 3];
    const real_t sine =
        real_min(real_max(REAL(2.0) * ((w * y) - (z * x)), REAL(-1.0)), REAL(1.0));
    const real_t yaw = real_atan2(REAL(2.0) * ((w * z) + (x * y)),
                                   REAL(1.0) - (REAL(2.0) * ((y * y) + (z * z))));

    m->angles_output[0] = real_atan2(REAL(2.0) * ((w * x) + (y * z)),
                               REAL(1.0) - (REAL(2.0) * ((x * x) + (y * y))));
    m->angles_output[1] = real_atan2(sine, real_sqrt((REAL(1.0) - sine) * (REAL(1.0) + sine)));
    m->angles_output[2] = yaw + (FULL_TURN_RAD * (real_t)real_floor_int(((m->angles_output[2] - yaw) / FULL_TURN_RAD) + REAL(0.5)));
}

/* Convert a row or column from turns about N, E, D to roll, pitch and yaw. */
static void turns_to_angles(real_t *north, real_t *east, real_t *down, real_t c, real_t t, real_t sine, real_t cosine)
{
    const real_t n = *north;
    const real_t e = *east;

    *north = ((c * n) + (t * e)) / cosine;
    *east = (-t * n) + (c * e);
    *down += (sine / cosine) * ((c * n) + (t * e));
}

/* Propagate the covariance of position, velocity and attitude over the delay, F P F^T + Q, in one step. */
static void propagate_covariance(estimator_t *m, const estimator_settings_t *s, const real_t r[9])
{
    const real_t span = m->x_now_span;
    real_t transition[TRANSITION_SIZE];

    for (int32_t k = 0; k < 3; k++) {
        m->axis_work[k] = m->now_velocity_change[k] / span;
    }
    error_transition(m->inputs_now, span, r, m->axis_work, transition);
    for (int32_t i = 0; i < MOTION_STATE_COUNT; i++) {
        for (int32_t j = i; j < MOTION_STATE_COUNT; j++) {
            m->covariance_output[i][j] = REAL(0.0);
        }
    }
    for (int32_t k = 0; k < ERROR_STATE_COUNT; k++) {
        propagate_error_column(m->u_transposed[k], span, transition, m->gain);
        for (int32_t i = 0; i < MOTION_STATE_COUNT; i++) {
            const real_t c = m->ud_diagonal[k] * m->gain[i];

            for (int32_t j = i; j < MOTION_STATE_COUNT; j++) {
                m->covariance_output[i][j] += c * m->gain[j];
            }
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        m->covariance_output[k][k] += ((m->now_added_velocity_variance[k] * span) * span) / REAL(3.0);
        m->covariance_output[k][ERROR_VELOCITY + k] += (m->now_added_velocity_variance[k] * span) / REAL(2.0);
        m->covariance_output[ERROR_VELOCITY + k][ERROR_VELOCITY + k] += m->now_added_velocity_variance[k];
        for (int32_t i = 0; i < 3; i++) {
            /* The filter integrates the vibration of the accelerometers */
            const real_t share = r[(3 * k) + i] * m->inputs_now[INPUT_ACCEL_WEIGHT + i];

            m->covariance_output[ERROR_VELOCITY + k][ERROR_VELOCITY + k] += (share * share) * m->vibration_velocity_variance[i];
        }
        m->covariance_output[ERROR_ATTITUDE + k][ERROR_ATTITUDE + k] += s->gyro_noise_density * span;
    }
}

/* Write covariance and deviations of the output, those of the attitude for roll, pitch and yaw. */
static void write_output_covariance(estimator_t *m)
{
    const real_t *x = m->x_output;
    const real_t sine =
        real_min(real_max(REAL(2.0) * ((x[NOMINAL_ATTITUDE] * x[NOMINAL_ATTITUDE + 2]) - (x[NOMINAL_ATTITUDE + 3] * x[NOMINAL_ATTITUDE + 1])), REAL(-1.0)), REAL(1.0));
    const real_t cosine = real_max(real_sqrt(REAL(1.0) - (sine * sine)), REAL(0.05));
    real_t c;
    real_t t;

    for (int32_t i = 0; i < MOTION_STATE_COUNT; i++) {
        for (int32_t j = 0; j < i; j++) {
            m->covariance_output[i][j] = m->covariance_output[j][i];
        }
    }
    for (int32_t i = MOTION_STATE_COUNT; i < ERROR_STATE_COUNT; i++) {
        m->sigma_output[i] = real_sqrt(state_variance(m, i));
    }
    for (int32_t i = 0; i < MOTION_STATE_COUNT; i++) {
        if (i < 3) {
            /* If the heights of fix and sonar differ, the fix may have the same error in any direction. */
            m->covariance_output[i][i] += (m->position_jump_remainder[i] * m->position_jump_remainder[i]) + (m->fix_sonar_height_difference * m->fix_sonar_height_difference);
        }
        m->sigma_output[i] = real_sqrt(m->covariance_output[i][i]);
    }
    sine_cosine(m->angles_output[2], &t, &c);
    for (int32_t j = 0; j < MOTION_STATE_COUNT; j++) {
        turns_to_angles(&m->covariance_output[ERROR_ATTITUDE][j], &m->covariance_output[ERROR_ATTITUDE + 1][j], &m->covariance_output[ERROR_ATTITUDE + 2][j], c, t, sine, cosine);
    }
    for (int32_t j = 0; j < MOTION_STATE_COUNT; j++) {
        turns_to_angles(&m->covariance_output[j][ERROR_ATTITUDE], &m->covariance_output[j][ERROR_ATTITUDE + 1], &m->covariance_output[j][ERROR_ATTITUDE + 2], c, t, sine, cosine);
    }
}

/* Propagate the horizon's state towards the present by some blocks; m->x_now is the last complete result. */
static void repropagate_state(estimator_t *m, const estimator_settings_t *s, real_t r[9], real_t a[6])
{
    bool come = false;

    for (int32_t n = 0; (n < s->fusion_budget) && !come; n++) {
        const real_t *e = input_block(m, s, m->repropagating_tick);
        const int32_t rest = s->block_ticks - wrap_index(m->repropagating_tick, s->block_ticks);
        const int32_t periods = (rest < (m->tick - m->repropagating_tick)) ? rest : (m->tick - m->repropagating_tick);
        const real_t span = (real_t)periods * s->dt;

        predict_state(m->x_repropagating, e, span, r, a);
        for (int32_t k = 0; k < 3; k++) {
            m->repropagating_added_velocity_variance[k] += velocity_noise_density(r, k, e) * span;
            m->repropagating_velocity_change[k] += a[k] * span;
        }
        m->repropagating_tick += periods;
        m->repropagating_span += span;
        come = m->repropagating_tick == m->tick;
    }
    if (come) {
        for (int32_t k = 0; k < 3; k++) {
            m->now_added_velocity_variance[k] = m->repropagating_added_velocity_variance[k];
            m->now_velocity_change[k] = m->repropagating_velocity_change[k];
            m->repropagating_added_velocity_variance[k] = REAL(0.0);
            m->repropagating_velocity_change[k] = REAL(0.0);
        }
        m->x_now_span = m->repropagating_span;
        m->repropagating_span = REAL(0.0);
        for (int32_t i = 0; i < STATE_COUNT; i++) {
            m->x_now[i] = m->x_repropagating[i];
            m->x_repropagating[i] = m->x[i];
        }
        m->repropagating_tick = m->horizon_tick;
    } else {
        predict_state(m->x_now, m->inputs_now, s->dt, r, a);
    }
}

void predict_output(estimator_t *m, const estimator_settings_t *s)
{
    const bool much = (m->tick % COVARIANCE_INTERVAL_TICKS) == 0;
    real_t *x = m->x_output;
    real_t r[9];
    real_t a[6];

    repropagate_state(m, s, r, a);
    for (int32_t i = 0; i < STATE_COUNT; i++) {
        x[i] = m->x_now[i];
    }
    if (much) {
        propagate_covariance(m, s, r);
    }
    /* The states lag the tick by `lag`: the last rates and acceleration bridge the difference. */
    a[2] += GRAVITY;
    for (int32_t k = 0; k < 3; k++) {
        x[k] += s->imu_lag * (x[NOMINAL_VELOCITY + k] + ((REAL(0.5) * s->imu_lag) * a[k]));
        x[NOMINAL_VELOCITY + k] += s->imu_lag * a[k];
        m->rates_output[k] = m->gyro_rates[k] - x[NOMINAL_GYRO_BIAS + k];
        if ((s->has_rotor_model > 0) && (m->flight_phase == PHASE_FLYING)) {
            m->rates_output[k] += s->imu_lag * m->rotor_model_rows[wrap_index(m->tick, ROTOR_FORCE_HISTORY)][ROTOR_ANG_ACCEL + k];
        }
    }
    rotate_attitude(x, s->imu_lag * m->rates_output[0], s->imu_lag * m->rates_output[1], s->imu_lag * m->rates_output[2], true);
    if ((s->has_rotor_model > 0) && (x[NOMINAL_TERRAIN] < MAX_FLOOR_HEIGHT_M)) {
        /* The legs must not enter the floor during or after the propagation. */
        const real_t lowest = -(real_max(x[NOMINAL_TERRAIN], REAL(0.0)) + s->ground_clearance);

        if (x[NOMINAL_POSITION + 2] >= lowest) {
            x[NOMINAL_POSITION + 2] = lowest;
            x[NOMINAL_VELOCITY + 2] = real_min(x[NOMINAL_VELOCITY + 2], REAL(0.0));
        }
    }
    smooth_output(m, s);
    write_output_angles(m);
    if (much) {
        write_output_covariance(m);
    }
}
