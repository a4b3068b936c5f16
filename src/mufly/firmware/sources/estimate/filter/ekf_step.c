#include "estimate/filter/ekf_step.h"

#include "estimate/filter/filter_horizon.h"
#include "estimate/filter/filter_inputs.h"
#include "estimate/filter/measurements/fusion.h"
#include "estimate/filter/measurements/sensor_checks.h"
#include "estimate/filter/output_predictor.h"

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
        m->ud_diagonal[i] = (s->initial_sigma[i] * s->initial_sigma[i]) + REAL(1e-12);
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
    m->sonar_effective_min_range = s->sonar_min_range;
    m->x_output[NOMINAL_ATTITUDE] = REAL(1.0);
    m->flight_model_state[MODEL_ATTITUDE] = REAL(1.0);
    m->flight_model_state[MODEL_CHARGE] = REAL(1.0);
    m->flight_model_state[MODEL_POSITION + 2] = REAL(-1000.0); /* far above the floor */
    m->flight_model_state[MODEL_BAR_NORMAL + 2] = REAL(-1.0);
    for (int32_t k = 0; k < 3; k++) {
        m->accel_low_frequency_noise_density[k] = INITIAL_ACCEL_NOISE_DENSITY;
    }
}

bool estimator_step(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, real_t z[INPUT_VALUE_COUNT],
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
        if (m->status[READING_RATES] < STATUS_MISSING) {
            m->gyro_rates[k] = z[READING_STARTS[READING_RATES] + k] - m->gyro_offset_jump[k];
        } else if ((s->has_rotor_model > 0) && (m->flight_phase >= PHASE_LIFTING_OFF)) {
            /* Rates of the rotor model. The stabiliser bar keeps the rotors level, so only yaw drifts. */
            m->gyro_rates[k] =
                (m->gyro_rates_prev[k] + (s->dt * m->rotor_model_rows[(m->tick - 1) % ROTOR_FORCE_HISTORY][ROTOR_ANG_ACCEL + k])) + m->model_rate_step_bias[k];
        } else {
            m->gyro_rates[k] = m->x_output[NOMINAL_GYRO_BIAS + k];
        }
    }
    /* The height may be wrong by the depth of a surface below the floor, or by the gap of fix and sonar. */
    doubt = m->fix_sonar_height_difference - real_min(m->x_output[NOMINAL_TERRAIN], REAL(0.0));
    replace_gyro_spikes(m, s, (m->flight_phase == PHASE_FLYING) && (height_above_ground(m->x_output, s) > (LEG_CLEARANCE_HEIGHT_M + doubt)));
    rises = compute_prediction_inputs(m, s, p, z, fresh);
    if ((s->has_rotor_model > 0) && (m->flight_phase >= PHASE_MOTORS_RUNNING) && (m->status[READING_ACCELERATION] < STATUS_MISSING)) {
        estimate_accel_noise(m, s, z);
    }
    queue_new_measurements(m, s, z, fresh, age);
    predict_next_bias(m, s);
    left = s->fusion_budget - (((m->tick % COVARIANCE_INTERVAL_TICKS) == 0) ? COST_COVARIANCE_OUTPUT : 0);
    if ((rises > REAL(0.0)) && (m->sigma_output[ERROR_THRUST_SCALE] > LIFTOFF_THRUST_SIGMA)) {
        fuse_liftoff_thrust(m, rises);
        left -= 1;
    }
    while (left > 0) {
        const int32_t cost = run_next_task(m, s, left);

        left = (cost > 0) ? (left - cost) : 0;
    }
    predict_output(m, s);
    found = (s->is_fitted[READING_POSITION_FIX] == 0) || (m->is_heading_aligned > 0);
    if ((m->is_initialised == 0) && found &&
        ((((real_t)m->standing_ticks * s->dt) >= INITIAL_REST_S) || (((real_t)m->tick * s->dt) > REAL(3.0)))) {
        m->is_initialised = 1;
    }
    turns = (s->has_rotor_model > 0) && (m->flight_phase >= PHASE_LIFTING_OFF);
    seen = (m->status[READING_RATES] < STATUS_MISSING) || turns || (((real_t)(m->tick - m->last_fused_tick[READING_RATES]) * s->dt) < GYRO_OUTAGE_S);
    for (int32_t k = 0; k < 3; k++) {
        /* Invalid inputs may make the model diverge: rates beyond the gyroscopes' range are no estimate. */
        if (!(real_abs(m->rates_output[k]) < (REAL(2.0) * s->value_limit[READING_RATES]))) {
            seen = false;
        }
    }
    if (m->has_levelling_rotation == 1) {
        for (int32_t k = READING_STARTS[READING_ACCELERATION]; k < (READING_STARTS[READING_RATES] + 3); k++) {
            z[k] = m->last_value[k];
        }
    }
    return (m->is_initialised > 0) && seen;
}
