#include "estimate/filter/measurements/scalar_fusion.h"

#include "estimate/filter/measurements/sensor_checks.h"
#include "estimate/filter/strapdown.h"
#include "estimate/filter/ud_filter.h"

void h_row_begin(estimator_t *m, int32_t state, real_t h)
{
    m->h_term_count = 1;
    m->h_state_index[0] = state;
    m->h_value[0] = h;
}

void h_row_add(estimator_t *m, int32_t state, real_t h)
{
    m->h_state_index[m->h_term_count] = state;
    m->h_value[m->h_term_count] = h;
    m->h_term_count += 1;
}

/* Add an error to a state, propagated over span (s), in which push was added to the velocity without gravity. */
static void add_propagated_error(real_t x[STATE_COUNT], const real_t by[ERROR_STATE_COUNT], real_t span, const real_t push[3])
{
    real_t v[3] = {by[ERROR_VELOCITY], by[ERROR_VELOCITY + 1], by[ERROR_VELOCITY + 2]};

    if (span > REAL(0.0)) {
        v[0] += (by[ERROR_ATTITUDE + 1] * push[2]) - (by[ERROR_ATTITUDE + 2] * push[1]);
        v[1] += (by[ERROR_ATTITUDE + 2] * push[0]) - (by[ERROR_ATTITUDE] * push[2]);
        v[2] += (by[ERROR_ATTITUDE] * push[1]) - (by[ERROR_ATTITUDE + 1] * push[0]);
    }
    for (int32_t i = 0; i < 3; i++) {
        x[i] += by[i] + ((REAL(0.5) * span) * (by[ERROR_VELOCITY + i] + v[i]));
        x[NOMINAL_VELOCITY + i] += v[i];
    }
    rotate_attitude(x, by[ERROR_ATTITUDE], by[ERROR_ATTITUDE + 1], by[ERROR_ATTITUDE + 2], false);
    for (int32_t i = ERROR_GYRO_BIAS; i < ERROR_STATE_COUNT; i++) {
        x[i + 1] += by[i];
    }
}

void apply_correction(estimator_t *m, real_t innovation, real_t variance)
{
    ud_measurement_update(m, variance);
    for (int32_t i = 0; i < ERROR_STATE_COUNT; i++) {
        m->gain[i] *= innovation;
    }
    add_propagated_error(m->x, m->gain, REAL(0.0), m->repropagating_velocity_change);
    add_propagated_error(m->x_repropagating, m->gain, m->repropagating_span, m->repropagating_velocity_change);
    add_propagated_error(m->x_now, m->gain, m->x_now_span, m->now_velocity_change);
}

void fuse_scalar(estimator_t *m, real_t innovation, real_t variance)
{
    (void)innovation_variance(m);
    apply_correction(m, innovation, variance);
}

void fuse_error_state(estimator_t *m, int32_t i, real_t innovation, real_t variance)
{
    h_row_begin(m, i, REAL(1.0));
    fuse_scalar(m, innovation, variance);
}

real_t innovation_ratio(estimator_t *m, real_t innovation, real_t variance)
{
    return innovation / real_sqrt(innovation_variance(m) + variance);
}

void log_innovation(estimator_t *m, int32_t k, real_t innovation, real_t ratio)
{
    m->innovation[k] = innovation;
    m->innovation_sigma[k] = (ratio != REAL(0.0)) ? real_abs(innovation / ratio) : REAL(0.0);
}

void reject_measurement(estimator_t *m, const estimator_settings_t *s, int32_t k, real_t innovation, const real_t *z,
                      int32_t count, real_t near, int32_t why)
{
    bool alike = m->reject_count[k] > 0;

    for (int32_t j = 0; j < count; j++) {
        alike = alike && (real_abs(z[j] - m->rejected_value[k][j]) < near);
        m->rejected_value[k][j] = z[j];
    }
    if (alike) {
        m->agreeing_reject_count[k] += 1;
    } else {
        m->agreeing_reject_count[k] = 0;
        m->agreeing_reject_since_tick[k] = m->horizon_tick;
    }
    if ((k != READING_SONAR) && (real_abs(innovation) > ((REAL(2.0) * INNOVATION_GATE) * m->innovation_sigma[k]))) {
        m->reject_score[k] += REAL(1.0); /* no healthy sensor but a sonar with a second surface deviates so much */
    }
    mark_rejected(m, s, k, why, innovation);
}

bool reset_timeout_expired(const estimator_t *m, const estimator_settings_t *s, int32_t k)
{
    return (m->agreeing_reject_count[k] >= 3) && (((real_t)(m->horizon_tick - m->agreeing_reject_since_tick[k]) * s->dt) >= RESET_TIMEOUT_S);
}

void adapt_noise_scale(real_t *scale, real_t gain, real_t change)
{
    *scale = real_max(real_min(*scale * (REAL(1.0) + (gain * change)), MAX_NOISE_SCALE), MIN_NOISE_SCALE);
}

void estimate_noise(estimator_t *m, int32_t aid, real_t ratio)
{
    adapt_noise_scale(&m->noise_scale[aid], NOISE_GAIN_AID, real_min(ratio * ratio, MAX_SQUARED_INNOVATION_RATIO) - REAL(1.0));
}
