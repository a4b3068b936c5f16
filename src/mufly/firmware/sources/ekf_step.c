#include "ekf_step.h"

#include "ud_filter.h"
#include "flight_model.h"
#include "fusion.h"
#include "output_predictor.h"
#include "sensor_checks.h"
#include "strapdown.h"

void estimator_reset(estimator_t *m, const estimator_settings_t *s)
{
    uint8_t *bytes = (uint8_t *)m;

    for (uint32_t i = 0U; i < (uint32_t)sizeof(*m); i++) {
        bytes[i] = 0U;
    }
    for (int32_t i = 0; i < STATE_COUNT; i++) {
        m->x[i] = s->initial_state[i];
        m->x_repropagating[i] = s->initial_state[i];
        m->x_now[i] = s->initial_state[i];
    }
    for (int32_t i = 0; i < ERROR_STATE_COUNT; i++) {
        m->d[i] = (s->initial_sigma[i] * s->initial_sigma[i]) + REAL(1e-12);
        m->u_transposed[i][i] = REAL(1.0);
    }
    for (int32_t i = 0; i < QUEUE_SIZE; i++) {
        m->queue_due[i] = -1;
    }
    for (int32_t i = 0; i < AID_COUNT; i++) {
        m->noise_scale[i] = REAL(1.0);
        m->bias_walk_scale[i] = REAL(1.0);
    }
    m->task_stage = STAGE_DONE;
    m->x_output[SX_ATT] = REAL(1.0);
    m->rotor_state[RS_ATT] = REAL(1.0);
    m->rotor_state[RS_CHARGE] = REAL(1.0);
    m->rotor_state[RS_POS + 2] = REAL(-1000.0); /* far above the floor */
    m->rotor_state[RS_BAR + 2] = REAL(-1.0);
    for (int32_t k = 0; k < 3; k++) {
        m->accel_noise[k] = INITIAL_ACCEL_DENSITY;
        m->accel_noise_slow[k] = INITIAL_ACCEL_DENSITY;
    }
}

/* Queue a measurement of tick at until the horizon reaches it. */
static bool queue_measurement(estimator_t *m, const estimator_settings_t *s, int32_t kind, real_t at, const real_t *z)
{
    const int32_t nearest = s->block_ticks * real_floor_int((at / (real_t)s->block_ticks) + REAL(0.5));
    /* By what it moves and turns, the next end of a block will do. */
    const int32_t due = (nearest <= m->horizon_tick) ? (m->horizon_tick + s->block_ticks) : nearest;
    const real_t ahead = (at - (real_t)due) * s->dt;
    bool waits = false;

    if (!(-ahead > MAX_BACKDATE_S)) {
        for (int32_t i = 0; (i < QUEUE_SIZE) && !waits; i++) {
            if (m->queue_due[i] < 0) {
                waits = true;
                m->queue_due[i] = due;
                m->queue_sensor[i] = kind;
                m->queue_ahead[i] = ahead;
                for (int32_t j = 0; j < (READING_STARTS[kind + 1] - READING_STARTS[kind]); j++) {
                    m->queue_value[i][j] = z[j];
                }
            }
        }
    }
    return waits;
}

/* Update the flight phase from the rotors' lift and the height. */
static real_t update_flight_phase(estimator_t *m, const estimator_settings_t *s, const real_t z[VALUE_COUNT])
{
    const real_t lift =
        (s->has_rotor_model > 0) ? ((-m->rotor_force[wrap_index(m->tick, ROTOR_FORCE_HISTORY)][RF_STATIC + 2] * m->x[SX_THRUST_SCALE]) / GRAVITY) : REAL(1.0);
    const real_t height = height_above_ground(m->x_output, s);
    const bool off = (z[ACTUATOR_START] + z[ACTUATOR_START + 1]) < REAL(0.02);
    /* Rotors with more lift than modelled leave the floor earlier, others later. */
    const real_t doubt = (s->has_rotor_model > 0) ? (LIFTOFF_SIGMA_LIMIT * m->sigma_output[EX_THRUST_SCALE]) : REAL(0.0);
    /* The sonar is newer than the estimated height, except below the floor. */
    const bool says = (m->status[R_SONAR] == STATUS_FUSED) && (height < SONAR_LIFTOFF_HEIGHT) && (m->x[SX_TERRAIN] > MIN_TERRAIN_HEIGHT);
    const bool near = says && (m->last_value[READING_STARTS[R_SONAR]] <= (s->sonar_min + (REAL(0.5) * s->sonar_resolution)));
    const bool clear = says && (m->last_value[READING_STARTS[R_SONAR]] > (s->sonar_min + LIFTOFF_CLEARANCE));

    real_t rises = REAL(0.0);

    m->is_sonar_at_minimum = near ? 1 : 0;
    if (m->flight_phase <= PHASE_RUNNING) {
        const real_t turning = m->rotor_state[RS_SPEED_UPPER] + m->rotor_state[RS_SPEED_LOWER];
        const bool stands = turning <= (STOPPED_SPEED_SHARE * (s->hover_speed[0] + s->hover_speed[1]));

        m->flight_phase = stands ? PHASE_STANDING : PHASE_COASTING;
        if (!off) {
            m->flight_phase = PHASE_RUNNING;
        }
        if (((lift * (REAL(1.0) + doubt)) > REAL(0.9)) && (m->flight_phase == PHASE_RUNNING)) {
            m->flight_phase = PHASE_LIGHT;
            m->is_initialised = 1;
        }
    } else if (m->flight_phase == PHASE_LIGHT) {
        if (((height > (REAL(0.03) + real_min(REAL(2.0) * m->sigma_output[EX_POS + 2], REAL(0.1)))) && !near) || clear ||
            (lift > (REAL(1.1) + doubt))) {
            m->flight_phase = PHASE_FLYING;
            rises = (says && !near && (s->has_rotor_model > 0)) ? (lift / m->x[SX_THRUST_SCALE]) : REAL(0.0);
        } else if (((lift * (REAL(1.0) + doubt)) < REAL(0.85)) && (height < REAL(0.02))) {
            m->flight_phase = PHASE_RUNNING;
        } else {
            /* still light */
        }
    } else if (((height < REAL(0.015)) && (lift < REAL(0.9)) && !clear) || (near && (lift < (REAL(1.1) + doubt)))) {
        m->flight_phase = PHASE_LIGHT;
    } else {
        /* flies on */
    }
    if (off && (m->flight_phase >= PHASE_LIGHT) && (height < REAL(0.05)) && (m->rotor_state[RS_SPEED_UPPER] < (REAL(0.3) * s->hover_speed[0]))) {
        m->flight_phase = PHASE_RUNNING;
    }
    if (m->flight_phase != PHASE_FLYING) {
        m->grounded_tick = m->tick;
    }
    return rises;
}

/* Update the rotor model by a period, and correct it by measured rotor speeds and voltage. */
static void update_rotor_model(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
                      const int32_t *fresh)
{
    predict_rotor_force(m, s, p, m->axis_work, m->rotor_force[wrap_index(m->tick, ROTOR_FORCE_HISTORY)]);
    for (int32_t k = 0; k < 2; k++) {
        m->rotor_state[RS_SPEED_UPPER + k] += s->dt * m->motor_accel_bias[k];
    }
    if (fresh[R_ROTOR] == 1) {
        const real_t *speed = &z[READING_STARTS[R_ROTOR]];

        if (rotor_speed_consistent(m, s, speed)) {
            for (int32_t k = 0; k < 2; k++) {
                const real_t off = speed[k] - m->rotor_state[RS_SPEED_UPPER + k];

                m->rotor_state[RS_SPEED_UPPER + k] += s->rotor_speed_gain * off;
                m->motor_accel_bias[k] += s->motor_error_gain * off;
            }
        }
    }
    if (fresh[R_BATTERY] == 1) {
        real_t voltage;
        real_t current;
        real_t off;

        battery_state(m->rotor_state, m->actuators[0], m->actuators[1], p, &voltage, &current);
        off = z[READING_STARTS[R_BATTERY]] - voltage;
        if (battery_voltage_consistent(m, s, off)) {
            const real_t fast = (((real_t)m->tick * s->dt) < REAL(1.0)) ? REAL(0.2) : REAL(0.02);

            m->rotor_state[RS_CHARGE] =
                real_min(real_max(m->rotor_state[RS_CHARGE] + (fast * off), REAL(0.0)), REAL(1.0));
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
        (m->is_sonar_at_minimum == 1) ? GROUND_FORCE_ERROR : real_max(m->sigma_output[EX_THRUST_SCALE] * -force, GROUND_FORCE_ERROR);
    const real_t over = (((-m->x_output[SX_THRUST_SCALE]) * force) - GRAVITY) / spread;
    const real_t may = real_min(real_max(REAL(1.0) + (over / LIFTOFF_SIGMA_LIMIT), REAL(0.0)), REAL(1.0)) * spread;

    return (ERROR_TIME_TWICE_S * may) * may;
}

/* Write the row of inputs of the period that has just ended, and average it into its block. */
static real_t sample_inputs(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t *z,
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

        m->actuators[j] = (sent == sent) ? real_min(real_max(sent, REAL(-1.0)), REAL(1.0)) : REAL(0.0);
    }
    rotation_matrix(&m->x_output[SX_ATT], r);
    n = m->x_output[SX_VEL] - m->x_output[SX_WIND];
    e = m->x_output[SX_VEL + 1] - m->x_output[SX_WIND + 1];
    d = m->x_output[SX_VEL + 2];
    for (int32_t k = 0; k < 3; k++) {
        m->axis_work[k] = ((r[k] * n) + (r[3 + k] * e)) + (r[6 + k] * d);
        m->rotor_state[RS_RATES + k] = m->gyro_rates[k] - m->x_output[SX_GYRO_BIAS + k];
    }
    if (s->has_rotor_model > 0) {
        update_rotor_model(m, s, p, z, fresh);
    }
    rises = update_flight_phase(m, s, z);
    for (int32_t k = 0; k < 3; k++) {
        const real_t clip = (m->clip_share[k] * CLIPPING_ERROR_SHARE) * s->accel_range;
        /* Without what a shaking leaves; but whose attitude is not known knows the force of the air better. */
        const real_t noise = (m->status[R_RATES] < STATUS_MISSING) ? m->accel_noise_slow[k] : m->accel_noise[k];
        real_t felt = ((s->has_rotor_model > 0) ? real_max(s->accel_density, noise) : s->accel_density) + ((ERROR_TIME_TWICE_S * clip) * clip);
        real_t made = s->model_accel_density[k];
        real_t share;

        row[k] = REAL(0.5) * (m->gyro_rates[k] + m->gyro_rates_prev[k]);
        row[IN_ACCEL + k] = z[k];
        for (int32_t g = 0; g < 3; g++) {
            row[IN_STATIC + (3 * g) + k] = ((REAL(1.0) - s->imu_lag_share) * m->rotor_force[a][RF_STATIC + (3 * g) + k]) +
                                   (s->imu_lag_share * m->rotor_force[b][RF_STATIC + (3 * g) + k]);
        }
        if (m->flight_phase <= PHASE_RUNNING) {
            row[IN_STATIC + k] = REAL(0.0);
            row[IN_REST + k] = -GRAVITY * r[6 + k];
            row[IN_SLOPE + k] = REAL(0.0);
            felt = REAL(1e6);
            made = REAL(1e-3);
        } else if (m->flight_phase == PHASE_LIGHT) {
            /* Legs may support the weight that the rotors do not: no thrust is estimated. */
            row[IN_REST + k] += m->x_output[SX_THRUST_SCALE] * row[IN_STATIC + k];
            if (k == 2) {
                row[IN_REST + 2] = (m->is_sonar_at_minimum == 1) ? (-GRAVITY * r[8]) : real_min(row[IN_REST + 2], -GRAVITY * r[8]);
            }
            made = REAL(0.05);
            if (k == 2) {
                made += ground_force_noise(m, row[IN_STATIC + 2]);
            }
            row[IN_STATIC + k] = REAL(0.0);
        } else if (s->has_rotor_model > 0) {
            /* Until the thrust is known, which takes the delay and more, it flies by the accelerometers. */
            const real_t unknown = real_max(m->sigma_output[EX_THRUST_SCALE] - MODELLED_THRUST_SIGMA, REAL(0.0)) * row[IN_STATIC + k];

            made += (THRUST_ERROR_TIME_S * unknown) * unknown;
        } else {
            /* flies without a model */
        }
        if ((s->has_rotor_model <= 0) && (m->flight_phase > PHASE_RUNNING)) {
            row[IN_STATIC + k] = REAL(0.0);
            row[IN_REST + k] = (k == 2) ? -GRAVITY : REAL(0.0);
            row[IN_SLOPE + k] = REAL(0.0);
            made = REAL(10.0);
        }
        if (m->force_verdict == FORCE_MODEL_WRONG) {
            made = real_max(made, WRONG_MODEL_DENSITY);
        } else if (m->is_accel_distrusted == 1) {
            felt = REAL(1e6);
        } else {
            /* both are used */
        }
        if ((m->status[R_ACCELERATION] >= STATUS_MISSING) || (s->is_fitted[R_ACCELERATION] == 0)) {
            felt = REAL(1e6);
        }
        share = made / (felt + made);
        row[IN_SHARE + k] = share;
        row[IN_NOISE + k] = felt * share;
    }
    row[INPUT_ROW_SIZE - 1] = (real_t)m->flight_phase;
    average_inputs(m, s);
    return rises;
}

/* Inflate the terrain's variance while the sonar's cone passes over an edge: the nearest point moves along an arc. */
static void pass_terrain_edge(estimator_t *m, const estimator_settings_t *s, real_t span)
{
    const real_t away = real_max(-m->x[SX_POS + 2] - m->x[SX_TERRAIN], REAL(0.1));
    const real_t speed = real_sqrt((m->x[SX_VEL] * m->x[SX_VEL]) + (m->x[SX_VEL + 1] * m->x[SX_VEL + 1]));
    const real_t arc = s->sonar_arc * away;
    const real_t passed =
        span * real_max(speed / real_max(s->sonar_cone_slope * away, REAL(0.05)), REAL(1.0) / TERRAIN_EDGE_S);

    inflate_variance(m, EX_TERRAIN, (arc * arc) * passed);
    m->terrain_edge_weight = real_max(m->terrain_edge_weight - passed, REAL(0.0));
    if (!(m->terrain_edge_weight > REAL(0.0))) {
        m->terrain_steps = 0;
    }
}

/* Move the horizon on by a block: state and covariance. */
static void advance_horizon(estimator_t *m, const estimator_settings_t *s)
{
    const real_t span = (real_t)s->block_ticks * s->dt;
    const real_t *e = input_block(m, s, m->horizon_tick);
    const real_t spread = s->gyro_density + ((m->status[R_RATES] >= STATUS_MISSING) ? GYRO_OUTAGE_DENSITY : REAL(0.0));
    real_t r[9];
    real_t a[6];
    real_t q[MOTION_STATE_COUNT];
    real_t transition[TRANSITION_SIZE];

    m->horizon_tick += s->block_ticks;
    m->task_stage = 0;
    predict_state(m->x, e, span, r, a);
    for (int32_t k = 0; k < 3; k++) {
        m->accel_mean[k] += e[IN_ACCEL + k];
        m->model_accel_mean[k] += a[MODEL_ACCEL + k];
        m->gyro_mean[k] += e[k];
        m->thrust_slope[k] += e[IN_STATIC + k];
        m->velocity_slope[k] += e[IN_SLOPE + k];
    }
    m->yaw_rate = REAL(0.0);
    for (int32_t k = 0; k < 3; k++) {
        m->yaw_rate += r[6 + k] * (e[k] - m->x[SX_GYRO_BIAS + k]);
        q[k] = s->process_variance[k];
        q[EX_VEL + k] = velocity_noise_density(r, k, e) * span;
        q[EX_ATT + k] = spread * span;
    }
    error_transition(e, span, r, a, transition);
    ud_time_update(m, span, transition, q);
    if (m->terrain_edge_weight > REAL(0.0)) {
        pass_terrain_edge(m, s, span);
    }
    m->block_mean_ticks += s->block_ticks;
}

/* Predict the bias whose turn it is, except those of the fix. */
static void predict_bias(estimator_t *m, const estimator_settings_t *s)
{
    const int32_t turn = EX_GYRO_BIAS + wrap_index(m->tick, BIAS_CYCLE_TICKS);
    const int32_t k = (turn >= EX_FIX_BIAS) ? (turn + ((EX_FIX_HEADING + 1) - EX_FIX_BIAS)) : turn;
    const bool adrift = (k < (EX_GYRO_BIAS + 3)) && (m->divergence_ticks > 0);
    const real_t may = (m->divergence_ticks > 1) ? DIVERGED_BIAS_WALK : LATER_BIAS_WALK;
    real_t origin = s->initial_state[k + 1];
    real_t keep = s->decay[k];
    real_t q = s->process_variance[k] + (adrift ? ((may * may) * ((real_t)BIAS_CYCLE_TICKS * s->dt)) : REAL(0.0));

    if (k == EX_TERRAIN) {
        q *= real_sqrt((m->x[SX_VEL] * m->x[SX_VEL]) + (m->x[SX_VEL + 1] * m->x[SX_VEL + 1])); /* another floor lies elsewhere, not later */
    }
    if (k < (EX_GYRO_BIAS + 3)) {
        const int32_t i = k - EX_GYRO_BIAS;
        const real_t turning = (real_abs(m->yaw_rate) > LEAK_RATE) ? m->yaw_rate : REAL(0.0);

        if (m->leaked_yaw_rate[i] != REAL(0.0)) {
            keep = turning / m->leaked_yaw_rate[i];
            q += (turning == REAL(0.0)) ? m->leak_origin_variance[i] : REAL(0.0);
        } else {
            m->leak_origin[i] = m->x[k + 1];
            m->leak_origin_variance[i] = state_variance(m, k);
            q += (s->gyro_axis_variance[i] + m->mount_variance[i]) * (turning * turning);
        }
        origin = m->leak_origin[i];
        m->leaked_yaw_rate[i] = turning;
    }
    m->x[k + 1] = origin + ((m->x[k + 1] - origin) * keep);
    if (q > REAL(0.0)) {
        gauss_markov_update(m, k, keep, q);
    }
}

/* Return the first queued measurement of the horizon by its sensor, -1 without one; drop those due if it lags too
 * far. */
static int32_t next_measurement(estimator_t *m, const estimator_settings_t *s)
{
    const bool behind = ((m->tick - s->delay_ticks) - m->horizon_tick) >= (MAX_LAG_BLOCKS * s->block_ticks);
    int32_t next = -1;

    for (int32_t i = 0; i < QUEUE_SIZE; i++) {
        if (m->queue_due[i] == m->horizon_tick) {
            if (behind) {
                m->late_count[m->queue_sensor[i]] += 1;
                m->next_beam = 0;
                m->queue_due[i] = -1;
            } else if ((next < 0) || (m->queue_sensor[i] < m->queue_sensor[next])) {
                next = i;
            } else {
                /* its turn comes */
            }
        }
    }
    return next;
}

/* Fuse the next queued measurement of the horizon; return its cost, 0 without time for it, -1 without any. */
static int32_t fuse_next_measurement(estimator_t *m, const estimator_settings_t *s, int32_t left)
{
    const int32_t i = (m->task_stage == 0) ? next_measurement(m, s) : -1;
    int32_t cost = -1;

    if (i >= 0) {
        cost = measurement_cost(m, s, m->queue_sensor[i], left);
        if (cost > left) {
            cost = 0;
        } else if (fuse_measurement(m, s, i, cost)) {
            m->queue_due[i] = -1;
        } else {
            /* more of it comes */
        }
    }
    return cost;
}

/* Average accelerometers and model since the last comparison. */
static void average_block_forces(estimator_t *m, const estimator_settings_t *s)
{
    const real_t *e = input_block(m, s, m->horizon_tick - s->block_ticks);
    const real_t n = (real_t)(m->block_mean_ticks / s->block_ticks);

    for (int32_t k = 0; k < 3; k++) {
        /* Density of the whole difference at the horizon, from what was weighed there */
        const real_t share = real_max(e[IN_SHARE + k], REAL(1e-9));

        m->accel_mean[k] /= n;
        m->model_accel_mean[k] /= n;
        m->gyro_mean[k] /= n;
        m->thrust_slope[k] /= n;
        m->velocity_slope[k] /= n;
        m->residual_density[k] =
            ((e[IN_NOISE + k] / share) / real_max(REAL(1.0) - share, REAL(1e-9))) + m->accel_noise[k];
    }
}

/* Start new means of accelerometers and model. */
static void clear_block_forces(estimator_t *m)
{
    for (int32_t k = 0; k < 3; k++) {
        m->accel_mean[k] = REAL(0.0);
        m->model_accel_mean[k] = REAL(0.0);
        m->gyro_mean[k] = REAL(0.0);
        m->thrust_slope[k] = REAL(0.0);
        m->velocity_slope[k] = REAL(0.0);
    }
    m->residual_ratio = REAL(0.0);
    m->block_mean_ticks = 0;
}

/* Reset the terrain to the floor once the vehicle is back over it; return the cost. */
static int32_t settle_terrain(estimator_t *m)
{
    int32_t cost = 0;

    if (!(m->terrain_edge_weight > REAL(0.0)) && (real_abs(m->x[SX_TERRAIN]) < MAX_FLOOR_HEIGHT)) {
        const real_t sure = state_variance(m, EX_TERRAIN);

        if ((sure > (FLOOR_SETTLED_SIGMA * FLOOR_SETTLED_SIGMA)) && ((m->x[SX_TERRAIN] * m->x[SX_TERRAIN]) < (REAL(9.0) * sure))) {
            reset_terrain(m);
            cost = 1;
        }
    }
    return cost;
}

/* Fuse the next axis of the means; return the cost, 0 without time for it or work (then the stage is LEGS). */
static int32_t fuse_block_axis(estimator_t *m, const estimator_settings_t *s, int32_t mode, int32_t left)
{
    const int32_t i = m->task_stage - STAGE_AXES;
    int32_t cost = 0;

    if (mode <= PHASE_RUNNING) {
        if (COST_REST_AXIS <= left) {
            cost = COST_REST_AXIS;
            fuse_zero_motion(m, s, m->block_mean_ticks, mode, i);
            if ((mode == PHASE_STANDING) && (i == 0)) {
                m->standing_ticks += m->block_mean_ticks;
            }
            m->task_stage += 1;
        }
    } else if ((mode == PHASE_FLYING) && (s->has_rotor_model > 0) && (s->is_fitted[R_ACCELERATION] > 0)) {
        cost = 1;
        fuse_accel_residual(m, s, m->block_mean_ticks, i);
        m->task_stage += 1;
    } else {
        m->task_stage = STAGE_GROUND_CONTACT; /* light: neither stands nor flies */
    }
    return cost;
}

/* Run the next task at the horizon if it costs no more than left; return its cost, 0 if none was run. */
static int32_t run_next_task(estimator_t *m, const estimator_settings_t *s, int32_t left)
{
    int32_t cost = fuse_next_measurement(m, s, left);
    bool decided = cost >= 0;

    if ((!decided) && (m->task_stage == 0)) {
        m->task_stage = STAGE_TERRAIN;
    }
    if ((!decided) && (m->task_stage == STAGE_TERRAIN)) {
        m->task_stage = STAGE_FORCE_MEANS;
        cost = settle_terrain(m);
        decided = cost > 0;
    }
    if ((!decided) && (m->task_stage == STAGE_FORCE_MEANS)) {
        m->task_stage = STAGE_DONE;
        if (m->block_mean_ticks >= FORCE_MEAN_TICKS) {
            average_block_forces(m, s);
            m->task_stage = STAGE_AXES;
        }
    }
    if (!decided) {
        const int32_t mode = (int32_t)input_block(m, s, m->horizon_tick - s->block_ticks)[INPUT_ROW_SIZE - 1];

        if ((m->task_stage >= STAGE_AXES) && (m->task_stage < STAGE_GROUND_CONTACT)) {
            cost = fuse_block_axis(m, s, mode, left);
            decided = (cost > 0) || (m->task_stage < STAGE_GROUND_CONTACT);
        }
        if ((!decided) && (m->task_stage == STAGE_GROUND_CONTACT)) {
            m->task_stage = STAGE_DONE;
            decided = (mode > PHASE_RUNNING) && fuse_ground_contact(m, s);
            clear_block_forces(m);
            cost = 1;
        }
    }
    if (!decided) {
        cost = 0;
        if (((m->horizon_tick + s->block_ticks) <= (m->tick - s->delay_ticks)) && (left >= COST_HORIZON_STEP)) {
            advance_horizon(m, s);
            cost = COST_HORIZON_STEP;
        }
    }
    return cost;
}

/* Apply the new noise of an accelerometer to buffered inputs that the horizon has not reached. */
static void backdate_accel_noise(estimator_t *m, const estimator_settings_t *s, int32_t k)
{
    for (int32_t at = m->horizon_tick; at < m->tick; at += s->block_ticks) {
        real_t *e = input_block(m, s, at);
        const real_t share = real_max(e[IN_SHARE + k], REAL(1e-9));
        const real_t felt = real_max(e[IN_NOISE + k] / share, m->accel_noise_slow[k]);
        const real_t made = e[IN_NOISE + k] / real_max(REAL(1.0) - share, REAL(1e-9));

        e[IN_SHARE + k] = made / (felt + made);
        e[IN_NOISE + k] = felt * e[IN_SHARE + k];
    }
}

/* Estimate the noise of accelerometers less model from means over short and over long blocks. */
static void estimate_accel_noise(estimator_t *m, const estimator_settings_t *s, const real_t z[3])
{
    const real_t *row = m->inputs_now;
    real_t weight;

    m->accel_noise_count += 1;
    m->slow_count += 1;
    weight = (real_t)((m->slow_count <= (SLOW_NOISE_TICKS / 2)) ? m->slow_count : ((SLOW_NOISE_TICKS + 1) - m->slow_count));
    for (int32_t k = 0; k < 3; k++) {
        const real_t off = z[k] - ((m->x[SX_THRUST_SCALE] * row[IN_STATIC + k]) + row[IN_REST + k]);

        m->accel_noise_sum[k] += off;
        m->slow_sum[k] += weight * (off - (row[IN_SLOPE + k] * m->axis_work[k]));
    }
    if (m->slow_count >= SLOW_NOISE_TICKS) {
        const real_t half = (real_t)(SLOW_NOISE_TICKS / 2);
        const real_t span = (REAL(0.75) * (real_t)SLOW_NOISE_TICKS) * s->dt;
        /* Off the floor the model has another force, and the thrust's scale is found. */
        const bool settled = (m->flight_phase != PHASE_FLYING) || ((m->tick - m->grounded_tick) > (2 * SLOW_NOISE_TICKS));

        for (int32_t k = 0; k < 3; k++) {
            const real_t mean = m->slow_sum[k] / (half * (half + REAL(1.0)));
            /* What the model may be off by, at lift-off by much, is not the accelerometers'. */
            const real_t unknown = (REAL(2.0) * m->sigma_output[EX_THRUST_SCALE]) * real_abs(row[IN_STATIC + k]);
            const real_t step = real_max(real_abs(mean - m->slow_mean_prev[k]) - unknown, REAL(0.0));
            const real_t made = row[IN_NOISE + k] / real_max(REAL(1.0) - row[IN_SHARE + k], REAL(1e-9));
            real_t density = real_max((((REAL(0.5) * step) * step) * span) - made, REAL(0.0));
            real_t most;

            if ((m->flight_phase == PHASE_FLYING) && settled) {
                const real_t apart = real_abs(mean - m->x[SX_ACCEL_BIAS + k]) - (MAX_MODEL_DISAGREEMENT + (unknown + (REAL(2.0) * m->sigma_output[EX_ACCEL_BIAS + k])));

                density += real_max(apart, REAL(0.0)) * real_max(apart, REAL(0.0));
                if (apart > ((((m->clip_share[0] + m->clip_share[1]) + m->clip_share[2]) * CLIPPING_ERROR_SHARE) * s->accel_range)) {
                    m->force_apart_tick = m->tick;
                }
            }
            density = real_min(density, REAL(100.0));
            most = real_max((density > m->accel_noise_slow[k]) ? REAL(0.6) : REAL(0.2),
                            REAL(1.0) / (real_t)(m->slow_mean_count + 1));
            m->slow_mean_prev[k] = mean;
            m->slow_sum[k] = REAL(0.0);
            if (settled) {
                m->accel_noise_slow[k] += most * (density - m->accel_noise_slow[k]);
                if (density > made) {
                    backdate_accel_noise(m, s, k);
                }
            }
        }
        m->slow_count = 0;
        m->slow_mean_count += 1;
        if ((m->status[R_ACCELERATION] == STATUS_REJECTED) && (m->tick >= m->fault_until_tick[R_ACCELERATION])) {
            m->status[R_ACCELERATION] = STATUS_FUSED;
            m->reason[R_ACCELERATION] = REASON_NONE;
        }
    }
    if (m->accel_noise_count >= FORCE_MEAN_TICKS) {
        const real_t span = (real_t)m->accel_noise_count * s->dt;

        for (int32_t k = 0; k < 3; k++) {
            const real_t mean = m->accel_noise_sum[k] / (real_t)m->accel_noise_count;
            const real_t step = mean - m->accel_noise_mean[k];
            real_t density =
                real_max((((REAL(0.5) * step) * step) * span) - s->model_accel_density[k], REAL(0.0));

            m->accel_noise_mean[k] = mean;
            density = real_min(density, REAL(100.0));
            m->accel_noise[k] += ((density > m->accel_noise[k]) ? REAL(0.2) : REAL(0.05)) * (density - m->accel_noise[k]);
            m->accel_noise_sum[k] = REAL(0.0);
        }
        m->accel_noise_count = 0;
    }
}

/* Queue the new measurements of this period. */
static void queue_new_measurements(estimator_t *m, const estimator_settings_t *s, const real_t z[VALUE_COUNT],
                     const int32_t fresh[SENSOR_COUNT], const real_t age[SENSOR_COUNT])
{
    for (int32_t i = 0; i < QUEUED_COUNT; i++) {
        const int32_t kind = QUEUED_READINGS[i];

        if ((fresh[kind] == 1) && (m->is_decimated[kind] <= 0)) {
            /* The state of tick k belongs to k dt - lag. */
            const real_t at = (real_t)m->tick + ((s->imu_lag - age[kind]) / s->dt);

            if (!queue_measurement(m, s, kind, at, &z[READING_STARTS[kind]])) {
                m->late_count[kind] += 1;
                /* One alone is no fault: jitter has a longer tail than the horizon waits for. */
                if (((real_t)(m->tick - m->last_fused_tick[kind]) * s->dt) > s->timeout[kind]) {
                    set_fault(m, s, kind, STATUS_FAULTY, REASON_LATE, age[kind]);
                }
            }
        }
    }
}

/* Turn two vectors, one after the other, from the axes of a tilted inertial unit to those of the vehicle. */
static void turn_level(const estimator_t *m, real_t v[6])
{
    const real_t *r = m->level_rotation;

    for (int32_t i = 0; i < 6; i += 3) {
        const real_t x = v[i];
        const real_t y = v[i + 1];
        const real_t z = v[i + 2];

        for (int32_t k = 0; k < 3; k++) {
            v[i + k] = ((r[3 * k] * x) + (r[(3 * k) + 1] * y)) + (r[(3 * k) + 2] * z);
        }
    }
}

/* Begin a state anew with level attitude and no bias of the accelerometers. */
static void restart_level_state(real_t x[STATE_COUNT])
{
    const real_t turn = real_sqrt((x[SX_ATT] * x[SX_ATT]) + (x[SX_ATT + 3] * x[SX_ATT + 3]));

    x[SX_ATT] /= turn;
    x[SX_ATT + 3] /= turn;
    for (int32_t k = 0; k < 3; k++) {
        x[SX_ACCEL_BIAS + k] = REAL(0.0);
    }
    x[SX_ATT + 1] = REAL(0.0);
    x[SX_ATT + 2] = REAL(0.0);
}

/* Turn the inputs since the horizon level, and begin anew with level attitude and no bias of the accelerometers. */
static void restart_level(estimator_t *m, const estimator_settings_t *s)
{
    real_t *const states[4] = {m->x, m->x_repropagating, m->x_now, m->x_output};

    for (int32_t b = 0; b < INPUT_BLOCK_COUNT; b++) {
        turn_level(m, &m->input_blocks[b][IN_RATES]);
    }
    clear_block_forces(m);
    m->task_stage = STAGE_DONE;
    for (int32_t i = 0; i < 4; i++) {
        restart_level_state(states[i]);
    }
    for (int32_t k = 0; k < 3; k++) {
        const real_t tilt = s->initial_sigma[EX_ATT + k];
        const real_t bias = s->initial_sigma[EX_ACCEL_BIAS + k];

        if (k < 2) {
            inflate_variance(m, EX_ATT + k, tilt * tilt);
        }
        inflate_variance(m, EX_ACCEL_BIAS + k, bias * bias);
    }
}

/* Decide by the accelerometers' sum at rest whether the inertial unit is tilted, and begin anew if it is. */
static void decide_level(estimator_t *m, const estimator_settings_t *s)
{
    const real_t size = real_sqrt(((m->level_sum[0] * m->level_sum[0]) + (m->level_sum[1] * m->level_sum[1])) +
                                  (m->level_sum[2] * m->level_sum[2]));
    const real_t x = -m->level_sum[1] / size;
    const real_t y = m->level_sum[0] / size;
    const real_t d = -m->level_sum[2] / size;
    const real_t tilt = s->initial_sigma[EX_ACCEL_BIAS] / GRAVITY;
    const real_t q = (x * x) + (y * y);

    m->mount_variance[0] = REAL(0.5) * q;
    m->mount_variance[1] = REAL(0.5) * q;
    if ((q > ((LEVEL_GATE * LEVEL_GATE) * ((s->rest_tilt_sigma * s->rest_tilt_sigma) + (tilt * tilt)))) && (d > REAL(0.875))) {
        const real_t half = real_sqrt((REAL(0.5) * d) + REAL(0.5));
        const real_t turn[4] = {half, (REAL(0.5) * x) / half, (REAL(0.5) * y) / half, REAL(0.0)};

        rotation_matrix(turn, m->level_rotation);
        m->is_levelled = 1;
        restart_level(m, s);
        set_fault(m, s, R_ACCELERATION, STATUS_FUSED, REASON_LEVELLED, real_sqrt(q));
    }
}

/* Measure the tilt of the inertial unit at rest before the first flight, and turn its readings level. */
static void level_inertial_unit(estimator_t *m, const estimator_settings_t *s, real_t z[VALUE_COUNT])
{
    const int32_t needed = (int32_t)(LEVEL_TIME_S / s->dt);

    if (m->level_ticks < needed) {
        bool still = (m->flight_phase == PHASE_STANDING) && (m->status[R_ACCELERATION] == STATUS_FUSED);

        for (int32_t k = 0; k < 3; k++) {
            still = still && (real_abs(z[READING_STARTS[R_RATES] + k]) < LEVEL_RATE);
        }
        if ((m->flight_phase > PHASE_STANDING) || (s->has_rotor_model == 0)) {
            m->level_ticks = needed;
        } else if (!still) {
            m->level_ticks = 0;
            m->level_sum[0] = REAL(0.0);
            m->level_sum[1] = REAL(0.0);
            m->level_sum[2] = REAL(0.0);
        } else {
            m->level_ticks += 1;
            for (int32_t k = 0; k < 3; k++) {
                m->level_sum[k] += z[READING_STARTS[R_ACCELERATION] + k];
            }
            if (m->level_ticks == needed) {
                decide_level(m, s);
            }
        }
    }
    if (m->is_levelled == 1) {
        turn_level(m, &z[READING_STARTS[R_ACCELERATION]]);
    }
}

bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[VALUE_COUNT],
                    int32_t fresh[SENSOR_COUNT], const real_t age[SENSOR_COUNT])
{
    real_t doubt;
    real_t rises;
    int32_t left;
    bool found;
    bool turns;
    bool seen;

    m->tick += 1;
    check_readings(m, s, z, fresh, age);
    level_inertial_unit(m, s, z);
    for (int32_t k = 0; k < 3; k++) {
        m->gyro_rates_prev[k] = m->gyro_rates[k];
        if (m->status[R_RATES] < STATUS_MISSING) {
            m->gyro_rates[k] = z[READING_STARTS[R_RATES] + k] - m->gyro_offset[k];
        } else if ((s->has_rotor_model > 0) && (m->flight_phase >= PHASE_LIGHT)) {
            /* What the model turns: the bar holds it to the rotors, so it does not drift but about the mast. */
            m->gyro_rates[k] =
                (m->gyro_rates_prev[k] + (s->dt * m->rotor_force[(m->tick - 1) % ROTOR_FORCE_HISTORY][RF_ANG_ACCEL + k])) + m->ang_accel_bias[k];
        } else {
            m->gyro_rates[k] = m->x_output[SX_GYRO_BIAS + k];
        }
    }
    /* A floor below the room's, or a fix that is apart from the sonar: the height is off by as much. */
    doubt = m->fix_height_gap - real_min(m->x_output[SX_TERRAIN], REAL(0.0));
    replace_gyro_spikes(m, s, (m->flight_phase == PHASE_FLYING) && (height_above_ground(m->x_output, s) > (LEG_CLEARANCE_HEIGHT + doubt)));
    rises = sample_inputs(m, s, p, z, fresh);
    if ((s->has_rotor_model > 0) && (m->flight_phase >= PHASE_RUNNING) && (m->status[R_ACCELERATION] < STATUS_MISSING)) {
        estimate_accel_noise(m, s, z);
    }
    queue_new_measurements(m, s, z, fresh, age);
    predict_bias(m, s);
    left = s->work_limit - (((m->tick % COVARIANCE_INTERVAL_TICKS) == 0) ? COST_COVARIANCE : 0);
    if ((rises > REAL(0.0)) && (m->sigma_output[EX_THRUST_SCALE] > LIFTOFF_THRUST_SIGMA)) {
        fuse_liftoff_thrust(m, rises);
        left -= 1;
    }
    while (left > 0) {
        const int32_t cost = run_next_task(m, s, left);

        left = (cost > 0) ? (left - cost) : 0;
    }
    predict_output(m, s);
    found = (s->is_fitted[R_FIX] == 0) || (m->is_heading_aligned > 0);
    if ((m->is_initialised == 0) && found &&
        ((((real_t)m->standing_ticks * s->dt) >= INITIAL_REST_S) || (((real_t)m->tick * s->dt) > REAL(3.0)))) {
        m->is_initialised = 1;
    }
    turns = (s->has_rotor_model > 0) && (m->flight_phase >= PHASE_LIGHT);
    seen = (m->status[R_RATES] < STATUS_MISSING) || turns || (((real_t)(m->tick - m->last_fused_tick[R_RATES]) * s->dt) < GYRO_OUTAGE_S);
    for (int32_t k = 0; k < 3; k++) {
        /* Nonsense may have the model run away: what no gyroscope could say is no estimate. */
        if (!(real_abs(m->rates_output[k]) < (REAL(2.0) * s->value_limit[R_RATES]))) {
            seen = false;
        }
    }
    if (m->is_levelled == 1) {
        for (int32_t k = READING_STARTS[R_ACCELERATION]; k < (READING_STARTS[R_RATES] + 3); k++) {
            z[k] = m->last_value[k];
        }
    }
    return (m->is_initialised > 0) && seen;
}
