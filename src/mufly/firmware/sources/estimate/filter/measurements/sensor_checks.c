#include "estimate/filter/measurements/sensor_checks.h"

#include "estimate/filter/ud_filter.h"

void set_fault(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t code, int32_t why, real_t number)
{
    m->status[k] = code;
    m->reason[k] = why;
    m->reason_number[k] = number;
    m->fault_until_tick[k] = m->tick + (int32_t)(FAULT_HOLD_S / s->dt);
    if (k == READING_POSITION_FIX) {
        m->fix_fault_component = m->worst_fix_component;
    }
}

void mark_fused(estimator_t *m, int32_t k)
{
    m->last_fused_tick[k] = m->tick;
    m->reject_count[k] = 0;
    m->agreeing_reject_count[k] = 0;
    m->reject_score[k] *= REJECT_SCORE_DECAY;
    if ((m->tick >= m->fault_until_tick[k]) && (m->reject_score[k] < REAL(1.0))) {
        m->status[k] = STATUS_FUSED;
        m->reason[k] = REASON_NONE;
    } else if ((m->status[k] == STATUS_REJECTED) && (m->tick >= m->fault_until_tick[k])) {
        m->status[k] = STATUS_FUSED;
    } else {
        /* reported for a minimum time */
    }
}

void mark_rejected(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t why, real_t number)
{
    m->reject_count[k] += 1;
    m->reject_score[k] += REAL(1.0);
    if (m->reject_score[k] > ((k == READING_SONAR) ? SONAR_REJECT_ALARM_SCORE : REJECT_ALARM_SCORE)) {
        set_fault(m, s, k, STATUS_REJECTED, why, number);
    }
}

/* Return whether a reading equals the last one to the last bit although the sensor has noise. */
static bool is_repeated(const estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count)
{
    bool same = (s->has_noise[k] != 0) && (m->last_new_tick[k] != 0);
    bool told = false;

    /* A frozen camera may still follow the gyroscopes in heading. */
    for (int32_t j = 0; (j < ((k == READING_POSITION_FIX) ? 3 : count)) && same; j++) {
        same = !(z[j] != m->last_value[READING_STARTS[k] + j]);
        told = told || (((k != READING_ROTOR_SPEED) || (z[j] != REAL(0.0))) &&
                        ((k != READING_RANGE_RING) || (z[j] < (REAL(0.995) * s->ring_max_range))));
    }
    return same && told;
}

/* Return whether a reading is new; the second of two equal readings must come after a full period. */
static bool is_new_sample(estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count)
{
    const bool early = ((real_t)(m->tick - m->last_new_tick[k]) * s->dt) < (REAL(0.6) * s->sensor_period[k]);
    bool usable = true;

    if (is_repeated(m, s, z, k, count)) {
        usable = false;
        if (early) {
            m->duplicate_count[k] += 1;
            if (m->duplicate_count[k] >= 2) {
                set_fault(m, s, k, m->status[k], REASON_DUPLICATED, REAL(0.0));
            }
        } else {
            m->repeat_count[k] += 1;
            m->last_new_tick[k] = m->tick;
            m->duplicate_count[k] = 0;
            if (m->repeat_count[k] >= 2) {
                set_fault(m, s, k, STATUS_FAULTY, REASON_FROZEN, (real_t)m->repeat_count[k] * s->sensor_period[k]);
            }
        }
    } else {
        m->repeat_count[k] = 0;
        if (((s->has_noise[k] == 0) || (k == READING_RANGE_RING)) && (m->last_new_tick[k] > 0) && early) {
            usable = false;
            m->duplicate_count[k] += 1;
            if (m->duplicate_count[k] >= 3) {
                set_fault(m, s, k, m->status[k], REASON_DUPLICATED, REAL(0.0));
            }
        }
    }
    return usable;
}

/* Accept a new reading; return whether it may be used. */
static bool accept_sample(estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count, real_t age)
{
    bool usable = true;

    m->last_new_tick[k] = m->tick;
    m->invalid_count[k] = 0;
    bool again = (m->status[k] >= STATUS_MISSING) && (m->tick >= m->fault_until_tick[k]);
    if (again || ((m->status[k] == STATUS_WAITING) && (k != READING_RANGE_RING))) {
        /* The ring's readings decide about its use: in a large room it detects no wall. */
        m->status[k] = (k == READING_RANGE_RING) ? STATUS_WAITING : STATUS_FUSED;
        m->reason[k] = REASON_NONE;
    }
    if (age > (s->latency[k] + s->latency_slack[k])) {
        /* The others wait for the horizon, which decides whether they can be fused. */
        set_fault(m, s, k, m->status[k], REASON_LATE, age);
        if ((k <= READING_RATES) || (k == READING_ROTOR_SPEED) || (k == READING_BATTERY)) {
            set_fault(m, s, k, STATUS_FAULTY, REASON_LATE, age);
            usable = false;
        }
    }
    if (s->reading_decimation[k] > 1) {
        m->decimation_count[k] += 1;
        m->is_skipped_by_decimation[k] = ((m->decimation_count[k] % s->reading_decimation[k]) != 0) ? 1 : 0;
    }
    for (int32_t j = 0; j < count; j++) {
        m->last_value[READING_STARTS[k] + j] = z[j];
    }
    if ((k <= READING_RATES) || (k == READING_RANGE_RING)) {
        m->last_fused_tick[k] = m->tick;
    }
    return usable;
}

/* Filter the share of clipped samples, and report it. */
static void check_clipping(estimator_t *m, const estimator_settings_t *s, const real_t share[3])
{
    real_t clip = REAL(0.0);

    for (int32_t k = 0; k < 3; k++) {
        const bool possible = (share[k] >= REAL(0.0)) && (share[k] <= REAL(1.0));

        m->clipped_fraction[k] += REAL(0.1) * ((possible ? share[k] : REAL(1.0)) - m->clipped_fraction[k]);
        clip = real_max(clip, m->clipped_fraction[k]);
    }
    if ((clip > MIN_CLIP_FRACTION) && (m->status[READING_ACCELERATION] == STATUS_FUSED)) {
        set_fault(m, s, READING_ACCELERATION, STATUS_FUSED, REASON_CLIPPING, clip);
    }
}

void check_readings(estimator_t *m, const estimator_settings_t *s, real_t z[INPUT_VALUE_COUNT], int32_t fresh[SENSOR_COUNT],
             const real_t age[SENSOR_COUNT])
{
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        real_t *value = &z[READING_STARTS[k]];
        const int32_t count = READING_STARTS[k + 1] - READING_STARTS[k];

        if (s->is_fitted[k] == 0) {
            fresh[k] = 0;
            continue;
        }
        m->is_skipped_by_decimation[k] = 0;
        if (fresh[k] == 2) {
            m->invalid_count[k] += 1;
            fresh[k] = 0;
        }
        if (fresh[k] == 1) {
            for (int32_t j = 0; j < count; j++) {
                if (!(real_abs(value[j]) < s->value_limit[k])) {
                    fresh[k] = 0;
                }
            }
            if (fresh[k] == 0) {
                set_fault(m, s, k, STATUS_FAULTY, REASON_OUT_OF_RANGE, REAL(0.0));
            } else if (!((age[k] >= -s->dt) && (age[k] <= MAX_READING_AGE_S))) {
                fresh[k] = 0;
                set_fault(m, s, k, STATUS_FAULTY, REASON_LATE, REAL(0.0));
            } else {
                /* evaluated below */
            }
        } else if (fresh[k] != 0) {
            fresh[k] = 0;
            set_fault(m, s, k, STATUS_FAULTY, REASON_OUT_OF_RANGE, REAL(0.0));
        } else {
            /* no new reading */
        }
        if (fresh[k] == 1) {
            if (!is_new_sample(m, s, value, k, count)) {
                fresh[k] = 0;
            } else if (!accept_sample(m, s, value, k, count, age[k])) {
                fresh[k] = 0;
            } else {
                /* usable */
            }
        }
        if (fresh[k] == 0) {
            const real_t since = (real_t)(m->tick - m->last_new_tick[k]) * s->dt;

            for (int32_t j = 0; j < count; j++) {
                value[j] = m->last_value[READING_STARTS[k] + j];
            }
            if ((m->last_new_tick[k] > 0) && (since > s->timeout[k])) {
                m->status[k] = STATUS_MISSING;
                m->reason[k] = (m->invalid_count[k] > 2) ? REASON_NO_ECHO : REASON_TIMEOUT;
                m->reason_number[k] = since;
            }
        }
    }
    check_clipping(m, s, &z[CLIPPING_START]);
}

void inflate_variances_on_divergence(estimator_t *m, const estimator_settings_t *s)
{
    if (m->divergence_recovery_ticks_left <= 1) {
        for (int32_t k = 0; k < 3; k++) {
            inflate_by_sigma(m, ERROR_GYRO_BIAS + k, DIVERGED_GYRO_BIAS_SIGMA_RAD_S);
            inflate_by_sigma(m, ERROR_ATTITUDE + k, DIVERGED_ATTITUDE_SIGMA_RAD);
        }
        inflate_by_sigma(m, ERROR_VELOCITY, DIVERGED_SPEED_SIGMA_M_S);
        inflate_by_sigma(m, ERROR_VELOCITY + 1, DIVERGED_SPEED_SIGMA_M_S);
    }
    m->divergence_recovery_ticks_left = (int32_t)(POST_DIVERGENCE_DURATION_S / s->dt);
}

void replace_gyro_spikes(estimator_t *m, const estimator_settings_t *s, bool flying)
{
    const int32_t now = wrap_index(m->tick - 1, ROTOR_FORCE_HISTORY);
    real_t worst = REAL(0.0);
    real_t led = REAL(0.0);
    real_t most;
    bool alike = m->equal_spike_count > 0;
    bool small = true;
    bool fine;

    for (int32_t k = 0; k < 3; k++) {
        real_t off;

        m->axis_work[k] = (m->gyro_rates_prev[k] + (s->dt * m->rotor_model_rows[now][ROTOR_ANG_ACCEL + k])) + m->model_rate_step_bias[k];
        off = m->gyro_rates[k] - m->axis_work[k];
        worst = real_max(worst, real_abs(off));
        /* A spike may consist of two steps that would each pass. */
        led = real_max(led, real_abs((GYRO_RESIDUAL_CARRY_FRACTION * m->spike_residual_carry[k]) + off));
        /* Error of the model's moments, in flight and on the legs */
        m->model_rate_step_bias[k] +=
            (m->flight_phase >= PHASE_LIFTING_OFF) ? (ANG_ACCEL_BIAS_GAIN * real_min(real_max(off, -GYRO_SPIKE_RATE_RAD_S), GYRO_SPIKE_RATE_RAD_S)) : REAL(0.0);
    }
    for (int32_t k = 0; k < 3; k++) {
        alike = alike && (real_abs(m->gyro_rates[k] - m->rates_with_spikes[k]) < GYRO_SPIKE_AGREEMENT_RAD_S);
        m->rates_with_spikes[k] = m->gyro_rates[k];
    }
    /* A model with repeated errors cannot distinguish a spike from a motion. Agreeing spikes are one error. */
    most = GYRO_SPIKE_RATE_RAD_S + (GYRO_SPIKE_RESIDUAL_FACTOR * m->rate_residual_lp);
    m->rate_residual_lp += alike ? REAL(0.0) : (REAL(0.1) * (real_min(worst, GYRO_SPIKE_RATE_RAD_S) - m->rate_residual_lp));
    /* A past divergence is remembered. */
    m->divergence_recovery_ticks_left =
        (m->divergence_recovery_ticks_left > 1) ? (m->divergence_recovery_ticks_left - 1) : m->divergence_recovery_ticks_left;
    if ((!flying) || (s->has_rotor_model == 0)) {
        m->equal_spike_count = 0;
        return;
    }
    fine = real_max(worst, led) < most;
    for (int32_t k = 0; k < 3; k++) {
        m->spike_residual_carry[k] *= GYRO_RESIDUAL_CARRY_FRACTION;
        if (fine) {
            m->spike_residual_carry[k] += m->gyro_rates[k] - m->axis_work[k];
        }
    }
    if (fine) {
        m->equal_spike_count = 0;
        m->spike_count = 0;
        return;
    }
    m->spike_count += 1;
    m->equal_spike_count = alike ? (m->equal_spike_count + 1) : 1;
    if (m->spike_count == 1) {
        m->reject_score[READING_RATES] = (m->reject_score[READING_RATES] * REJECT_SCORE_DECAY) + REAL(1.0);
        if (m->reject_score[READING_RATES] > REAL(3.0)) {
            set_fault(m, s, READING_RATES, STATUS_FUSED, REASON_SPIKES, worst);
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        small = small && (real_abs(m->gyro_offset_jump[k] + (m->gyro_rates[k] - m->axis_work[k])) < MAX_GYRO_OFFSET_RAD_S);
    }
    if ((m->equal_spike_count >= GYRO_JUMP_REPEATS) && small) {
        /* A sudden offset is no motion. It is subtracted from the following readings. */
        for (int32_t k = 0; k < 3; k++) {
            const real_t off = m->gyro_rates[k] - m->axis_work[k];

            m->gyro_offset_jump[k] += off;
            inflate_by_sigma(m, ERROR_GYRO_BIAS + k, REAL(0.1) * off);
        }
        m->equal_spike_count = 0;
        m->spike_count = 0;
        set_fault(m, s, READING_RATES, STATUS_FUSED, REASON_JUMP, worst);
    } else if (m->spike_count > 8) {
        m->spike_count = 0;
        return;
    } else {
        /* a spike */
    }
    for (int32_t k = 0; k < 3; k++) {
        m->gyro_rates[k] = m->axis_work[k];
    }
}

bool check_rotor_speed(estimator_t *m, const estimator_settings_t *s, const real_t speed[2])
{
    const real_t flown = (real_t)(m->tick - m->last_grounded_tick) * s->dt;
    real_t *mean = m->rotor_spin_accel_bias_mean; /* mean error of the motor equations */
    real_t worst = REAL(0.0);
    real_t away = REAL(0.0);
    bool led;
    bool off;

    for (int32_t k = 0; k < 2; k++) {
        worst = real_max(worst, real_abs(speed[k] - m->flight_model_state[MODEL_SPEED_UPPER + k]) / s->hover_speed[k]);
        away = real_max(away, real_abs(m->rotor_spin_accel_bias[k] - mean[k]) / s->hover_speed[k]);
    }
    /* On the floor the motor equations are adapted. */
    led = (m->flight_phase == PHASE_FLYING) && (flown > SPIN_ACCEL_BIAS_SETTLING_S) && (away > MAX_SPIN_ACCEL_BIAS_CHANGE);
    off = (m->flight_phase == PHASE_FLYING) && (worst > ((m->reject_score[READING_ROTOR_SPEED] > REAL(0.5)) ? ROTOR_SPEED_RECOVERY_GATE : ROTOR_SPEED_GATE));
    if (led || off) {
        if (led) {
            m->rotor_spin_accel_bias[0] = mean[0];
            m->rotor_spin_accel_bias[1] = mean[1];
        }
        mark_rejected(m, s, READING_ROTOR_SPEED, REASON_INNOVATION, worst * s->hover_speed[0]);
    } else {
        const real_t period = s->sensor_period[READING_ROTOR_SPEED];
        const real_t share = period / real_max(real_min(flown, SPIN_ACCEL_BIAS_AVERAGING_S), period);

        for (int32_t k = 0; k < 2; k++) {
            mean[k] += share * (m->rotor_spin_accel_bias[k] - mean[k]);
        }
        mark_fused(m, READING_ROTOR_SPEED);
    }
    return !(led || off);
}

bool check_battery_voltage(estimator_t *m, const estimator_settings_t *s, real_t off)
{
    bool believed = true;

    if ((real_abs(off) > BATTERY_VOLTAGE_GATE_V) && (((real_t)m->tick * s->dt) > REAL(1.0))) {
        if ((s->is_fitted[READING_ROTOR_SPEED] == 0) || (m->status[READING_ROTOR_SPEED] == STATUS_FUSED)) {
            mark_rejected(m, s, READING_BATTERY, REASON_INNOVATION, off);
        }
        believed = false;
    } else {
        mark_fused(m, READING_BATTERY);
    }
    return believed;
}

/* Return the mean innovation ratio of the fix along the difference of accelerometers and model: a positive value
 * contradicts the model, a negative one the accelerometers. */
static real_t mean_fix_ratio_along(const estimator_t *m, const real_t r[9], const real_t along[3])
{
    real_t dot = REAL(0.0);
    real_t square = REAL(1e-12);

    for (int32_t j = 0; j < 3; j++) {
        const real_t part = ((r[3 * j] * along[0]) + (r[(3 * j) + 1] * along[1])) + (r[(3 * j) + 2] * along[2]);

        dot += part * m->fix_ratio_mean[j];
        square += part * part;
    }
    return dot / real_sqrt(square);
}

/* Decide which of accelerometers and rotor model is wrong, where worst deviations lie between them. */
static void update_force_conflict(estimator_t *m, const estimator_settings_t *s, const real_t r[9], real_t height,
                                  real_t worst)
{
    bool apart;

    if ((m->is_accel_distrusted == 0) && (worst > FORCE_CONFLICT_GATE)) {
        m->is_accel_distrusted = 1;
    } else if ((m->is_accel_distrusted == 1) && (worst < FORCE_CONFLICT_END_GATE)) {
        m->is_accel_distrusted = 0;
    } else {
        /* unchanged */
    }
    apart = (m->accel_model_difference_tick > 0) && (((real_t)(m->tick - m->accel_model_difference_tick) * s->dt) < FAULT_HOLD_S);
    if ((m->is_accel_distrusted == 0) && !apart) {
        m->accel_model_diagnosis = DIAGNOSIS_AGREE;
    } else {
        const bool has_fix = (m->status[READING_POSITION_FIX] == STATUS_FUSED) &&
                             (((real_t)(m->tick - m->last_fused_tick[READING_POSITION_FIX]) * s->dt) < CONFLICT_FIX_AGE_S);
        const real_t evidence = has_fix ? mean_fix_ratio_along(m, r, m->accel_residual_lp) : REAL(0.0);

        if (m->accel_model_diagnosis == DIAGNOSIS_AGREE) {
            m->accel_model_diagnosis = DIAGNOSIS_UNDECIDED;
            m->accel_model_conflict_start_tick = m->tick;
        }
        if ((m->accel_residual_lp[2] < REAL(0.0)) &&
            (height < (FLOOR_CONTACT_HEIGHT_M + (REAL(3.0) * m->sigma_output[ERROR_POSITION + 2])))) {
            m->accel_model_diagnosis = DIAGNOSIS_FLOOR_CONTACT;
        } else if (((s->is_fitted[READING_ROTOR_SPEED] > 0) && (m->status[READING_ROTOR_SPEED] != STATUS_FUSED)) || (evidence > CONFLICT_MIN_FIX_RATIO)) {
            m->accel_model_diagnosis = DIAGNOSIS_MODEL_WRONG;
        } else if (evidence < -CONFLICT_MIN_FIX_RATIO) {
            m->accel_model_diagnosis = DIAGNOSIS_ACCEL_WRONG;
        } else if (m->accel_model_diagnosis == DIAGNOSIS_FLOOR_CONTACT) {
            m->accel_model_diagnosis = DIAGNOSIS_UNDECIDED;
            m->accel_model_conflict_start_tick = m->tick;
        } else if ((m->accel_model_diagnosis == DIAGNOSIS_UNDECIDED) && has_fix &&
                   (((real_t)(m->tick - m->accel_model_conflict_start_tick) * s->dt) > CONFLICT_TIMEOUT_S)) {
            m->accel_model_diagnosis = DIAGNOSIS_ACCEL_WRONG;
        } else {
            /* unchanged */
        }
    }
}

void check_accel_model(estimator_t *m, const estimator_settings_t *s, const real_t r[9], real_t height, real_t nu,
                       real_t variance, real_t known, int32_t i)
{
    m->accel_residual_lp[i] += REAL(0.1) * (nu - m->accel_residual_lp[i]);
    if (i == 2) {
        real_t worst = REAL(0.0);
        int32_t axis = 2;
        int32_t code = STATUS_FUSED;
        int32_t why = REASON_NONE;
        bool rejected;

        for (int32_t j = 0; j < 3; j++) {
            if (m->accel_residual_sigma[j] > REAL(0.0)) {
                const real_t ratio = real_abs(m->accel_residual_lp[j]) / m->accel_residual_sigma[j];

                if (ratio > worst) {
                    worst = ratio;
                    axis = j;
                }
            }
        }
        update_force_conflict(m, s, r, height, worst);
        if (m->accel_model_diagnosis == DIAGNOSIS_MODEL_WRONG) {
            why = REASON_MODEL_WRONG;
        } else if (m->accel_model_diagnosis != DIAGNOSIS_FLOOR_CONTACT) {
            code = (m->is_accel_distrusted == 1) ? STATUS_FAULTY : STATUS_REJECTED;
            why = (m->accel_model_diagnosis == DIAGNOSIS_UNDECIDED) ? REASON_FORCE_CONFLICT : REASON_INNOVATION;
        } else {
            /* floor contact: neither is wrong */
        }
        rejected = (m->status[READING_ACCELERATION] == STATUS_REJECTED) || (m->status[READING_ACCELERATION] == STATUS_FAULTY);
        if ((m->accel_model_diagnosis != DIAGNOSIS_AGREE) && ((why != REASON_NONE) || rejected)) {
            set_fault(m, s, READING_ACCELERATION, code, why, m->accel_residual_lp[axis]);
        }
    }
    /* The mean of 0.1-weighted blocks keeps 0.1 / (2 - 0.1) of their variance. */
    m->accel_residual_sigma[i] = real_sqrt(((variance * REAL(0.0526)) + known) + REAL(0.04));
}
