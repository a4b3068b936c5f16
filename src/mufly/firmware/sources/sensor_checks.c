#include "sensor_checks.h"

#include "ud_filter.h"

void set_fault(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t code, int32_t why, real_t number)
{
    m->status[k] = code;
    m->reason[k] = why;
    m->fault_number[k] = number;
    m->fault_until_tick[k] = m->tick + (int32_t)(LASTS_S / s->dt);
    if (k == R_FIX) {
        m->fault_component = m->fix_component;
    }
}

void mark_fused(estimator_t *m, int32_t k)
{
    m->last_fused_tick[k] = m->tick;
    m->reject_count[k] = 0;
    m->agree_count[k] = 0;
    m->reject_score[k] *= FORGET;
    if ((m->tick >= m->fault_until_tick[k]) && (m->reject_score[k] < REAL(1.0))) {
        m->status[k] = FUSED;
        m->reason[k] = FINE;
    } else if ((m->status[k] == REJECTED) && (m->tick >= m->fault_until_tick[k])) {
        m->status[k] = FUSED;
    } else {
        /* told of for a while yet */
    }
}

void mark_rejected(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t why, real_t number)
{
    m->reject_count[k] += 1;
    m->reject_score[k] += REAL(1.0);
    if (m->reject_score[k] > ((k == R_SONAR) ? SONAR_ALARM : ALARM)) {
        set_fault(m, s, k, REJECTED, why, number);
    }
}

/* Return whether a reading equals the last one to the last bit although the sensor has noise. */
static bool is_repeated(const estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count)
{
    bool same = (s->has_noise[k] != 0) && (m->last_new_tick[k] != 0);
    bool told = false;

    /* A camera that hangs may still turn with the gyroscopes. */
    for (int32_t j = 0; (j < ((k == R_FIX) ? 3 : count)) && same; j++) {
        same = !(z[j] != m->last_value[STARTS[k] + j]);
        told = told || (((k != R_ROTOR) || (z[j] != REAL(0.0))) &&
                        ((k != R_RING) || (z[j] < (REAL(0.995) * s->ring_max))));
    }
    return same && told;
}

/* Return whether a reading is new; of two equal ones the second must have come in its own time. */
static bool is_new_sample(estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count)
{
    const bool early = ((real_t)(m->tick - m->last_new_tick[k]) * s->dt) < (REAL(0.6) * s->period[k]);
    bool usable = true;

    if (is_repeated(m, s, z, k, count)) {
        usable = false;
        if (early) {
            m->double_count[k] += 1;
            if (m->double_count[k] >= 2) {
                set_fault(m, s, k, m->status[k], DOUBLED, REAL(0.0));
            }
        } else {
            m->repeat_count[k] += 1;
            m->last_new_tick[k] = m->tick;
            m->double_count[k] = 0;
            if (m->repeat_count[k] >= 2) {
                set_fault(m, s, k, FAULTY, FROZEN, (real_t)m->repeat_count[k] * s->period[k]);
            }
        }
    } else {
        m->repeat_count[k] = 0;
        if (((s->has_noise[k] == 0) || (k == R_RING)) && (m->last_new_tick[k] > 0) && early) {
            usable = false;
            m->double_count[k] += 1;
            if (m->double_count[k] >= 3) {
                set_fault(m, s, k, m->status[k], DOUBLED, REAL(0.0));
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
    bool again = (m->status[k] >= MISSING) && (m->tick >= m->fault_until_tick[k]);
    if (again || ((m->status[k] == NOTHING) && (k != R_RING))) {
        /* Whether a ring that sees is of use is said by what it sees: in a large room it sees no wall. */
        m->status[k] = (k == R_RING) ? NOTHING : FUSED;
        m->reason[k] = FINE;
    }
    if (age > (s->latency[k] + s->latency_slack[k])) {
        set_fault(m, s, k, FAULTY, LATE, age);
        if ((k <= R_RATES) || (k == R_ROTOR) || (k == R_BATTERY)) {
            usable = false;
        }
    }
    if (s->decimation[k] > 1) {
        m->decimation_count[k] += 1;
        m->skipped[k] = ((m->decimation_count[k] % s->decimation[k]) != 0) ? 1 : 0;
    }
    for (int32_t j = 0; j < count; j++) {
        m->last_value[STARTS[k] + j] = z[j];
    }
    if ((k <= R_RATES) || (k == R_RING)) {
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

        m->clip_share[k] += REAL(0.1) * ((possible ? share[k] : REAL(1.0)) - m->clip_share[k]);
        clip = real_max(clip, m->clip_share[k]);
    }
    if ((clip > SHARE) && (m->status[R_ACCELERATION] == FUSED)) {
        set_fault(m, s, R_ACCELERATION, FUSED, CLIPS, clip);
    }
}

void check_readings(estimator_t *m, const estimator_settings_t *s, real_t z[VALUES], int32_t fresh[SENSORS],
             const real_t age[SENSORS])
{
    for (int32_t k = 0; k < SENSORS; k++) {
        real_t *value = &z[STARTS[k]];
        const int32_t count = STARTS[k + 1] - STARTS[k];

        if (s->fitted[k] == 0) {
            fresh[k] = 0;
            continue;
        }
        m->skipped[k] = 0;
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
                set_fault(m, s, k, FAULTY, INSANE, REAL(0.0));
            } else if (!((age[k] >= -s->dt) && (age[k] <= OLDEST_S))) {
                fresh[k] = 0;
                set_fault(m, s, k, FAULTY, LATE, REAL(0.0));
            } else {
                /* it is looked at */
            }
        } else if (fresh[k] != 0) {
            fresh[k] = 0;
            set_fault(m, s, k, FAULTY, INSANE, REAL(0.0));
        } else {
            /* nothing new */
        }
        if (fresh[k] == 1) {
            if (!is_new_sample(m, s, value, k, count)) {
                fresh[k] = 0;
            } else if (!accept_sample(m, s, value, k, count, age[k])) {
                fresh[k] = 0;
            } else {
                /* it is used */
            }
        }
        if (fresh[k] == 0) {
            const real_t since = (real_t)(m->tick - m->last_new_tick[k]) * s->dt;

            for (int32_t j = 0; j < count; j++) {
                value[j] = m->last_value[STARTS[k] + j];
            }
            if ((m->last_new_tick[k] > 0) && (since > s->timeout[k])) {
                m->status[k] = MISSING;
                m->reason[k] = (m->invalid_count[k] > 2) ? NO_ECHO : SILENT;
                m->fault_number[k] = since;
            }
        }
    }
    check_clipping(m, s, &z[CLIPPING]);
}

void reset_on_divergence(estimator_t *m, const estimator_settings_t *s)
{
    if (m->divergence_ticks <= 1) {
        for (int32_t k = 0; k < 3; k++) {
            inflate_variance(m, EX_GYRO_BIAS + k, ASTRAY_BIAS * ASTRAY_BIAS);
            inflate_variance(m, EX_ATT + k, ASTRAY_TURN * ASTRAY_TURN);
        }
        inflate_variance(m, EX_VEL, ASTRAY_SPEED * ASTRAY_SPEED);
        inflate_variance(m, EX_VEL + 1, ASTRAY_SPEED * ASTRAY_SPEED);
    }
    m->divergence_ticks = (int32_t)(ADRIFT_S / s->dt);
}

void replace_gyro_spikes(estimator_t *m, const estimator_settings_t *s, bool flying)
{
    const int32_t now = cycle(m->tick - 1, MODELLED);
    real_t worst = REAL(0.0);
    real_t led = REAL(0.0);
    real_t most;
    bool alike = m->spike_repeats > 0;
    bool small = true;
    bool fine;

    for (int32_t k = 0; k < 3; k++) {
        real_t off;

        m->axis_work[k] = (m->gyro_rates_prev[k] + (s->dt * m->rotor_force[now][RF_ANG_ACCEL + k])) + m->ang_accel_bias[k];
        off = m->gyro_rates[k] - m->axis_work[k];
        worst = real_max(worst, real_abs(off));
        /* A spike may come in two steps, of which each would pass. */
        led = real_max(led, real_abs((LINGERS * m->spike_carry[k]) + off));
        /* What its moments are off by, in flight and on the legs */
        m->ang_accel_bias[k] += (m->flight_phase >= LIGHT) ? (TURN_OFF * real_min(real_max(off, -SPIKE), SPIKE)) : REAL(0.0);
    }
    /* A model that is off again and again cannot tell a spike from a motion. */
    most = SPIKE + (ROUGH * m->rate_residual_lp);
    m->rate_residual_lp += REAL(0.1) * (real_min(worst, SPIKE) - m->rate_residual_lp);
    m->divergence_ticks = (m->divergence_ticks > 1) ? (m->divergence_ticks - 1) : m->divergence_ticks; /* once astray, it remembers */
    if ((!flying) || (s->has_rotor_model == 0)) {
        m->spike_repeats = 0;
        return;
    }
    for (int32_t k = 0; k < 3; k++) {
        alike = alike && (real_abs(m->gyro_rates[k] - m->spike_rates[k]) < ALIKE);
        m->spike_rates[k] = m->gyro_rates[k];
    }
    fine = real_max(worst, led) < most;
    for (int32_t k = 0; k < 3; k++) {
        m->spike_carry[k] *= LINGERS;
        if (fine) {
            m->spike_carry[k] += m->gyro_rates[k] - m->axis_work[k];
        }
    }
    if (fine) {
        m->spike_repeats = 0;
        m->spike_count = 0;
        return;
    }
    m->spike_count += 1;
    m->spike_repeats = alike ? (m->spike_repeats + 1) : 1;
    if (m->spike_count == 1) {
        m->reject_score[R_RATES] = (m->reject_score[R_RATES] * FORGET) + REAL(1.0);
        if (m->reject_score[R_RATES] > REAL(3.0)) {
            set_fault(m, s, R_RATES, FUSED, SPIKES, worst);
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        small = small && (real_abs(m->gyro_offset[k] + (m->gyro_rates[k] - m->axis_work[k])) < LARGEST_SHIFT);
    }
    if ((m->spike_repeats >= 2) && small) {
        /* Twice the same: an offset that came at once is no motion. It is taken off from now on. */
        for (int32_t k = 0; k < 3; k++) {
            const real_t off = m->gyro_rates[k] - m->axis_work[k];

            m->gyro_offset[k] += off;
            inflate_variance(m, EX_GYRO_BIAS + k, (REAL(0.1) * off) * (REAL(0.1) * off));
        }
        m->spike_repeats = 0;
        m->spike_count = 0;
        set_fault(m, s, R_RATES, FUSED, JUMPED, worst);
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

bool rotor_speed_consistent(estimator_t *m, const estimator_settings_t *s, const real_t speed[2])
{
    const real_t flown = (real_t)(m->tick - m->grounded_tick) * s->dt;
    real_t *mean = m->motor_accel_mean; /* of what the motors' equations are off by */
    real_t worst = REAL(0.0);
    real_t away = REAL(0.0);
    bool led;
    bool off;

    for (int32_t k = 0; k < 2; k++) {
        worst = real_max(worst, real_abs(speed[k] - m->rotor_state[RS_SPEED_UPPER + k]) / s->hover_speed[k]);
        away = real_max(away, real_abs(m->motor_accel_bias[k] - mean[k]) / s->hover_speed[k]);
    }
    /* On the floor it is the equations that have to learn. */
    led = (m->flight_phase == FLYING) && (flown > ROTOR_KNOWN_S) && (away > ROTOR_LED);
    off = (m->flight_phase == FLYING) && (worst > ((m->reject_score[R_ROTOR] > REAL(0.5)) ? ROTOR_SURE : ROTOR_OFF));
    if (led || off) {
        if (led) {
            m->motor_accel_bias[0] = mean[0];
            m->motor_accel_bias[1] = mean[1];
        }
        mark_rejected(m, s, R_ROTOR, OFF, worst * s->hover_speed[0]);
    } else {
        const real_t period = s->period[R_ROTOR];
        const real_t share = period / real_max(real_min(flown, ROTOR_MEAN_S), period);

        for (int32_t k = 0; k < 2; k++) {
            mean[k] += share * (m->motor_accel_bias[k] - mean[k]);
        }
        mark_fused(m, R_ROTOR);
    }
    return !(led || off);
}

bool battery_voltage_consistent(estimator_t *m, const estimator_settings_t *s, real_t off)
{
    bool believed = true;

    if ((real_abs(off) > VOLTS_OFF) && (((real_t)m->tick * s->dt) > REAL(1.0))) {
        mark_rejected(m, s, R_BATTERY, OFF, off);
        believed = false;
    } else {
        mark_fused(m, R_BATTERY);
    }
    return believed;
}

void check_accel_model(estimator_t *m, const estimator_settings_t *s, real_t nu, real_t variance, real_t known, int32_t i)
{
    m->accel_residual_lp[i] += REAL(0.1) * (nu - m->accel_residual_lp[i]);
    if (i == 2) {
        real_t worst = REAL(0.0);

        for (int32_t j = 0; j < 3; j++) {
            if (m->accel_residual_sigma[j] > REAL(0.0)) {
                worst = real_max(worst, real_abs(m->accel_residual_lp[j]) / m->accel_residual_sigma[j]);
            }
        }
        if ((m->accel_distrusted == 0) && (worst > REAL(6.0))) {
            m->accel_distrusted = 1;
        } else if ((m->accel_distrusted == 1) && (worst < REAL(2.0))) {
            m->accel_distrusted = 0;
        } else {
            /* as before */
        }
        if (m->accel_distrusted == 1) {
            set_fault(m, s, R_ACCELERATION, FAULTY, OFF, m->accel_residual_lp[2]);
        }
    }
    /* The mean of 0.1-weighted blocks keeps 0.1 / (2 - 0.1) of their variance. */
    m->accel_residual_sigma[i] = real_sqrt(((variance * REAL(0.0526)) + known) + REAL(0.04));
}
