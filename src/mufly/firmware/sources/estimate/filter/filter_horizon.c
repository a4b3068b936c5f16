#include "estimate/filter/filter_horizon.h"

#include "estimate/filter/measurements/fusion.h"
#include "estimate/filter/measurements/sensor_checks.h"
#include "estimate/filter/output_predictor.h"
#include "estimate/filter/strapdown.h"
#include "estimate/filter/ud_filter.h"

/* Queue a measurement of tick at until the horizon reaches it. */
static bool queue_measurement(estimator_t *m, const estimator_settings_t *s, int32_t kind, real_t at, const real_t *z)
{
    const int32_t nearest = s->block_ticks * real_floor_int((at / (real_t)s->block_ticks) + REAL(0.5));
    /* Velocity and yaw rate move the measurement to the next end of a block. */
    const int32_t due = (nearest <= m->horizon_tick) ? (m->horizon_tick + s->block_ticks) : nearest;
    const real_t ahead = (at - (real_t)due) * s->dt;
    bool waits = false;

    if (!(-ahead > MAX_BACKDATE_S)) {
        for (int32_t i = 0; (i < QUEUE_SIZE) && !waits; i++) {
            if (m->queue_due[i] < 0) {
                waits = true;
                m->queue_due[i] = due;
                m->queue_sensor[i] = kind;
                m->queue_time_in_period[i] = ahead;
                for (int32_t j = 0; j < (READING_STARTS[kind + 1] - READING_STARTS[kind]); j++) {
                    m->queue_value[i][j] = z[j];
                }
            }
        }
    }
    return waits;
}

/* Inflate the terrain's variance while the sonar's cone passes over an edge: the nearest point moves along an arc. */
static void inflate_terrain_at_edge(estimator_t *m, const estimator_settings_t *s, real_t span)
{
    const real_t away = real_max(-m->x[NOMINAL_POSITION + 2] - m->x[NOMINAL_TERRAIN], REAL(0.1));
    const real_t speed = real_sqrt((m->x[NOMINAL_VELOCITY] * m->x[NOMINAL_VELOCITY]) + (m->x[NOMINAL_VELOCITY + 1] * m->x[NOMINAL_VELOCITY + 1]));
    const real_t arc = s->sonar_cone_edge_excess * away;
    const real_t passed =
        span * real_max(speed / real_max(s->sonar_cone_radius_ratio * away, REAL(0.05)), REAL(1.0) / TERRAIN_EDGE_DURATION_S);

    inflate_variance(m, ERROR_TERRAIN, (arc * arc) * passed);
    m->terrain_edge_weight = real_max(m->terrain_edge_weight - passed, REAL(0.0));
    if (!(m->terrain_edge_weight > REAL(0.0))) {
        m->terrain_steps = 0;
    }
}

/* Advance the horizon by a block: state and covariance. */
static void advance_horizon(estimator_t *m, const estimator_settings_t *s)
{
    const real_t span = (real_t)s->block_ticks * s->dt;
    const real_t *e = input_block(m, s, m->horizon_tick);
    const real_t spread = s->gyro_noise_density + ((m->status[READING_RATES] >= STATUS_MISSING) ? GYRO_OUTAGE_RATE_DENSITY : REAL(0.0));
    real_t r[9];
    real_t a[6];
    real_t q[MOTION_STATE_COUNT];
    real_t transition[TRANSITION_SIZE];

    m->horizon_tick += s->block_ticks;
    m->task_stage = 0;
    predict_state(m->x, e, span, r, a);
    for (int32_t k = 0; k < 3; k++) {
        m->accel_mean[k] += e[INPUT_ACCEL + k];
        m->model_accel_mean[k] += a[ACCEL_WORK_MODEL + k];
        m->gyro_mean[k] += e[k];
        m->accel_per_thrust_scale[k] += e[INPUT_THRUST_ACCEL + k];
        m->accel_per_air_velocity[k] += e[INPUT_ACCEL_PER_VELOCITY + k];
    }
    m->yaw_rate = REAL(0.0);
    for (int32_t k = 0; k < 3; k++) {
        m->yaw_rate += r[6 + k] * (e[k] - m->x[NOMINAL_GYRO_BIAS + k]);
        q[k] = s->process_variance[k];
        q[ERROR_VELOCITY + k] = velocity_noise_density(r, k, e) * span;
        q[ERROR_ATTITUDE + k] = spread * span;
    }
    error_transition(e, span, r, a, transition);
    ud_time_update(m, span, transition, q);
    if (m->terrain_edge_weight > REAL(0.0)) {
        inflate_terrain_at_edge(m, s, span);
    }
    m->block_mean_ticks += s->block_ticks;
}

void predict_next_bias(estimator_t *m, const estimator_settings_t *s)
{
    const int32_t turn = ERROR_GYRO_BIAS + wrap_index(m->tick, BIAS_CYCLE_TICKS);
    const int32_t k = (turn >= ERROR_FIX_BIAS) ? (turn + ((ERROR_FIX_HEADING + 1) - ERROR_FIX_BIAS)) : turn;
    const bool adrift = (k < (ERROR_GYRO_BIAS + 3)) && (m->divergence_recovery_ticks_left > 0);
    const real_t may = (m->divergence_recovery_ticks_left > 1) ? DIVERGED_GYRO_BIAS_WALK : POST_DIVERGENCE_GYRO_BIAS_WALK;
    real_t origin = s->initial_state[k + 1];
    real_t keep = s->decay[k];
    real_t q = s->process_variance[k] + (adrift ? ((may * may) * ((real_t)BIAS_CYCLE_TICKS * s->dt)) : REAL(0.0));

    if (k == ERROR_TERRAIN) {
        /* the terrain changes with distance, not with time */
        q *= real_sqrt((m->x[NOMINAL_VELOCITY] * m->x[NOMINAL_VELOCITY]) + (m->x[NOMINAL_VELOCITY + 1] * m->x[NOMINAL_VELOCITY + 1]));
    }
    if (k < (ERROR_GYRO_BIAS + 3)) {
        const int32_t i = k - ERROR_GYRO_BIAS;
        const real_t turning = (real_abs(m->yaw_rate) > MIN_CROSS_AXIS_YAW_RATE_RAD_S) ? m->yaw_rate : REAL(0.0);

        if (m->yaw_rate_in_gyro_bias[i] != REAL(0.0)) {
            keep = turning / m->yaw_rate_in_gyro_bias[i];
            q += (turning == REAL(0.0)) ? m->gyro_bias_at_zero_yaw_rate_variance[i] : REAL(0.0);
        } else {
            m->gyro_bias_at_zero_yaw_rate[i] = m->x[k + 1];
            m->gyro_bias_at_zero_yaw_rate_variance[i] = state_variance(m, k);
            q += (s->gyro_axis_variance[i] + m->mount_variance[i]) * (turning * turning);
        }
        origin = m->gyro_bias_at_zero_yaw_rate[i];
        m->yaw_rate_in_gyro_bias[i] = turning;
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
    const bool behind = ((m->tick - s->horizon_delay_ticks) - m->horizon_tick) >= (MAX_LAG_BLOCKS * s->block_ticks);
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
                /* it is fused later */
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
            /* the rest follows */
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
        /* Noise density of the difference at the horizon, from the weights used there */
        const real_t share = real_max(e[INPUT_ACCEL_WEIGHT + k], REAL(1e-9));

        m->accel_mean[k] /= n;
        m->model_accel_mean[k] /= n;
        m->gyro_mean[k] /= n;
        m->accel_per_thrust_scale[k] /= n;
        m->accel_per_air_velocity[k] /= n;
        m->accel_residual_density[k] =
            ((e[INPUT_NOISE_DENSITY + k] / share) / real_max(REAL(1.0) - share, REAL(1e-9))) +
            (m->vibration_velocity_variance[k] / ((real_t)m->block_mean_ticks * s->dt));
    }
}

void clear_block_forces(estimator_t *m)
{
    for (int32_t k = 0; k < 3; k++) {
        m->accel_mean[k] = REAL(0.0);
        m->model_accel_mean[k] = REAL(0.0);
        m->gyro_mean[k] = REAL(0.0);
        m->accel_per_thrust_scale[k] = REAL(0.0);
        m->accel_per_air_velocity[k] = REAL(0.0);
    }
    m->max_accel_model_ratio = REAL(0.0);
    m->block_mean_ticks = 0;
}

/* Reset the terrain to the floor once the vehicle is back over it; return the cost. */
static int32_t settle_terrain(estimator_t *m)
{
    int32_t cost = 0;

    if (!(m->terrain_edge_weight > REAL(0.0)) && (real_abs(m->x[NOMINAL_TERRAIN]) < MAX_FLOOR_HEIGHT_M)) {
        const real_t sure = state_variance(m, ERROR_TERRAIN);

        if ((sure > (MIN_FLOOR_RESET_SIGMA_M * MIN_FLOOR_RESET_SIGMA_M)) && ((m->x[NOMINAL_TERRAIN] * m->x[NOMINAL_TERRAIN]) < (REAL(9.0) * sure))) {
            reset_terrain(m);
            cost = 1;
        }
    }
    return cost;
}

/* Fuse the next axis of the means; return the cost, 0 without time for it or work (then the stage is LEGS). */
static int32_t fuse_block_axis(estimator_t *m, const estimator_settings_t *s, int32_t mode, int32_t left)
{
    const int32_t i = m->task_stage - STAGE_FORCE_AXES;
    int32_t cost = 0;

    if (mode <= PHASE_MOTORS_RUNNING) {
        if (COST_ZERO_MOTION_AXIS <= left) {
            cost = COST_ZERO_MOTION_AXIS;
            fuse_zero_motion(m, s, m->block_mean_ticks, mode, i);
            if ((mode == PHASE_STANDING) && (i == 0)) {
                m->standing_ticks += m->block_mean_ticks;
            }
            m->task_stage += 1;
        }
    } else if ((mode == PHASE_FLYING) && (s->has_rotor_model > 0) && (s->is_fitted[READING_ACCELERATION] > 0)) {
        cost = 1;
        fuse_accel_residual(m, s, m->block_mean_ticks, i);
        m->task_stage += 1;
    } else {
        m->task_stage = STAGE_GROUND_CONTACT; /* light: neither standing nor flying */
    }
    return cost;
}

int32_t run_next_task(estimator_t *m, const estimator_settings_t *s, int32_t left)
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
            m->task_stage = STAGE_FORCE_AXES;
        }
    }
    if (!decided) {
        const int32_t mode = (int32_t)input_block(m, s, m->horizon_tick - s->block_ticks)[INPUT_ROW_SIZE - 1];

        if ((m->task_stage >= STAGE_FORCE_AXES) && (m->task_stage < STAGE_GROUND_CONTACT)) {
            cost = fuse_block_axis(m, s, mode, left);
            decided = (cost > 0) || (m->task_stage < STAGE_GROUND_CONTACT);
        }
        if ((!decided) && (m->task_stage == STAGE_GROUND_CONTACT)) {
            m->task_stage = STAGE_DONE;
            decided = (mode > PHASE_MOTORS_RUNNING) && fuse_ground_contact(m, s);
            clear_block_forces(m);
            cost = 1;
        }
    }
    if (!decided) {
        cost = 0;
        if (((m->horizon_tick + s->block_ticks) <= (m->tick - s->horizon_delay_ticks)) && (left >= COST_HORIZON_STEP)) {
            advance_horizon(m, s);
            cost = COST_HORIZON_STEP;
        }
    }
    return cost;
}

void queue_new_measurements(estimator_t *m, const estimator_settings_t *s, const real_t z[INPUT_VALUE_COUNT],
                     const int32_t fresh[SENSOR_COUNT], const real_t age[SENSOR_COUNT])
{
    for (int32_t i = 0; i < QUEUED_READING_COUNT; i++) {
        const int32_t kind = QUEUED_READING_INDICES[i];

        if ((fresh[kind] == 1) && (m->is_skipped_by_decimation[kind] <= 0)) {
            /* The state of tick k belongs to k dt - lag. */
            const real_t at = (real_t)m->tick + ((s->imu_lag - age[kind]) / s->dt);

            if (!queue_measurement(m, s, kind, at, &z[READING_STARTS[kind]])) {
                m->late_count[kind] += 1;
                /* A single late reading is no fault: some exceed the delay of the horizon. */
                if (((real_t)(m->tick - m->last_fused_tick[kind]) * s->dt) > s->timeout[kind]) {
                    set_fault(m, s, kind, STATUS_FAULTY, REASON_LATE, age[kind]);
                }
            }
        }
    }
}
