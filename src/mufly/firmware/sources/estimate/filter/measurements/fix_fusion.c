#include "estimate/filter/measurements/fix_fusion.h"

#include "estimate/filter/measurements/scalar_fusion.h"
#include "estimate/filter/measurements/sensor_checks.h"
#include "estimate/filter/ud_filter.h"

/* Write the row H of component i of a fix taken ahead (s) after the horizon. */
static void fix_h_row(estimator_t *m, int32_t i, real_t ahead)
{
    if (i < FIX_HEADING) {
        h_row_begin(m, ERROR_POSITION + i, REAL(1.0));
        h_row_add(m, ERROR_FIX_BIAS + i, REAL(1.0));
        if (i < FIX_DOWN) {
            h_row_add(m, ERROR_VELOCITY + i, ahead);
        }
    } else {
        h_row_begin(m, ERROR_ATTITUDE + 2, REAL(1.0));
        h_row_add(m, ERROR_FIX_HEADING, REAL(1.0));
    }
}

/* Return the innovation of component i of the fix. */
static real_t fix_innovation(const estimator_t *m, const real_t z[4], int32_t i, real_t ahead)
{
    const real_t *x = m->x;
    real_t off;

    if (i < FIX_HEADING) {
        off = ((z[i] - x[i]) - (ahead * x[NOMINAL_VELOCITY + i])) - x[NOMINAL_FIX_BIAS + i];
    } else {
        const real_t yaw = real_atan2(REAL(2.0) * ((x[NOMINAL_ATTITUDE] * x[NOMINAL_ATTITUDE + 3]) + (x[NOMINAL_ATTITUDE + 1] * x[NOMINAL_ATTITUDE + 2])),
                                       REAL(1.0) - (REAL(2.0) * ((x[NOMINAL_ATTITUDE + 2] * x[NOMINAL_ATTITUDE + 2]) + (x[NOMINAL_ATTITUDE + 3] * x[NOMINAL_ATTITUDE + 3]))));

        off = real_wrap_angle(((z[FIX_HEADING] - yaw) - (ahead * m->yaw_rate)) - x[NOMINAL_FIX_HEADING]);
    }
    return off;
}

/* Return the estimated variance of component i of the fix. */
static real_t fix_variance(const estimator_t *m, const estimator_settings_t *s, int32_t i)
{
    return (i < FIX_HEADING) ? (s->fix_variance * m->noise_scale[AID_POSITION]) : (s->fix_heading_variance * m->noise_scale[AID_HEADING]);
}

/* Return the estimated variance of the bias of component i of the fix. */
static real_t fix_bias_variance(const estimator_t *m, const estimator_settings_t *s, int32_t i)
{
    const real_t sigma = s->initial_sigma[ERROR_FIX_BIAS + i];

    return (sigma * sigma) * m->bias_walk_scale[(i < FIX_HEADING) ? AID_POSITION : AID_HEADING];
}

/* Estimate noise and random walk of component i of the fix from its innovation ratio. */
static void estimate_fix_noise(estimator_t *m, int32_t i)
{
    const int32_t aid = (i < FIX_HEADING) ? AID_POSITION : AID_HEADING;
    const real_t gain = (i < FIX_HEADING) ? NOISE_GAIN_POSITION : NOISE_GAIN_HEADING;
    const real_t ratio = m->fix_ratio[i];
    const real_t excess = real_min(ratio * ratio, MAX_SQUARED_INNOVATION_RATIO) - REAL(1.0);
    const real_t pair = real_max(real_min(ratio * m->fix_ratio_prev[i], MAX_INNOVATION_RATIO_PRODUCT), -MAX_INNOVATION_RATIO_PRODUCT);

    if ((m->is_heading_aligned != 0) && (real_abs(m->fix_ratio_mean[i]) < LASTING_FIX_INNOVATION_RATIO)) {
        adapt_noise_scale(&m->noise_scale[aid], gain, excess - pair);
        adapt_noise_scale(&m->bias_walk_scale[aid], gain, excess + pair);
    }
    m->fix_ratio_prev[i] = ratio;
    m->fix_ratio_mean[i] += REAL(0.15) * (ratio - m->fix_ratio_mean[i]);
}

/* Return the largest mean of the innovation ratios of N, E and heading. */
static real_t largest_mean_ratio(const estimator_t *m)
{
    return real_max(real_max(real_abs(m->fix_ratio_mean[FIX_NORTH]), real_abs(m->fix_ratio_mean[FIX_EAST])), real_abs(m->fix_ratio_mean[FIX_HEADING]));
}

/* Return the estimated bias of component i of the fix over the largest that its model allows. */
static real_t compute_fix_bias_limit_ratio(const estimator_t *m, const estimator_settings_t *s, int32_t i)
{
    return real_abs(m->x[NOMINAL_FIX_BIAS + i]) / (MAX_FIX_BIAS_SIGMAS * real_sqrt(fix_bias_variance(m, s, i) + fix_variance(m, s, i)));
}

/* Raise the random walk of the fix until it explains an innovation of the vehicle at rest; return the new ratio. */
static real_t inflate_fix_bias_walk(estimator_t *m, const estimator_settings_t *s, int32_t i, real_t nu, real_t ratio)
{
    const real_t sigma = s->initial_sigma[ERROR_FIX_BIAS + i];
    const real_t spread = nu / REJECTED_INNOVATION_BIAS_SIGMAS;
    const real_t scale = (spread * spread) / (sigma * sigma);
    const int32_t aid = (i < FIX_HEADING) ? AID_POSITION : AID_HEADING;

    if (!(scale < MAX_NOISE_SCALE)) {
        return ratio;
    }
    m->bias_walk_scale[aid] = real_max(m->bias_walk_scale[aid], scale);
    inflate_by_sigma(m, ERROR_FIX_BIAS + i, spread);
    return innovation_ratio(m, nu, fix_variance(m, s, i));
}

/* Return whether the sonar measures the height, over a known floor. */
static bool sonar_height_valid(const estimator_t *m, const estimator_settings_t *s)
{
    const int32_t k = READING_SONAR;
    const bool fresh = (m->last_fused_tick[k] > 0) && (((real_t)(m->tick - m->last_fused_tick[k]) * s->dt) < REAL(0.3));

    return fresh && (m->status[k] == STATUS_FUSED) && (m->reason[k] == REASON_NONE) && !(m->terrain_edge_weight > REAL(0.0));
}

/* Return whether fix and sonar agree on the height; if not, write the gap to m->fix_sonar_height_difference. */
static bool fix_height_consistent(estimator_t *m, const estimator_settings_t *s, real_t nu, real_t ratio)
{
    const int32_t k = READING_POSITION_FIX;
    const real_t apart = real_abs(nu + m->x[NOMINAL_FIX_BIAS + 2]);
    const real_t off = real_abs(ratio);

    if (m->fix_sonar_height_difference > REAL(0.0)) {
        const bool blind = ((real_t)(m->tick - m->last_fused_tick[READING_SONAR]) * s->dt) > REAL(0.3);

        m->fix_sonar_height_difference = (blind || (off < REAL(2.5))) ? REAL(0.0) : apart;
    } else if (sonar_height_valid(m, s) &&
               ((compute_fix_bias_limit_ratio(m, s, 2) > REAL(1.0)) || ((off > INNOVATION_GATE) && reset_timeout_expired(m, s, k)))) {
        m->fix_sonar_height_difference = apart;
    } else {
        /* they agree */
    }
    return !(m->fix_sonar_height_difference != REAL(0.0));
}

/* Reset the position to the fix; where other sensors hold it, reset the bias of the fix instead. */
static void reset_to_fix(estimator_t *m, const real_t z[4], real_t ahead)
{
    const bool height_held = m->status[READING_SONAR] == STATUS_FUSED;
    const bool place_held = m->status[READING_RANGE_RING] == STATUS_FUSED;
    real_t nu;

    for (int32_t i = 0; i < 3; i++) {
        nu = fix_innovation(m, z, i, ahead);
        if ((i == FIX_DOWN) ? height_held : place_held) {
            inflate_by_sigma(m, ERROR_FIX_BIAS + i, nu);
        } else {
            inflate_by_sigma(m, ERROR_POSITION + i, nu);
            inflate_variance(m, ERROR_VELOCITY + i, REAL(0.01) + ((REAL(0.1) * nu) * nu));
        }
    }
    nu = fix_innovation(m, z, FIX_HEADING, ahead);
    inflate_by_sigma(m, ERROR_ATTITUDE + 2, nu);
}

/* Return whether the height is the one component of the fix that lies outside the gate. */
static bool is_only_height_rejected(const estimator_t *m)
{
    const real_t off = real_max(real_max(real_abs(m->fix_ratio[FIX_NORTH]), real_abs(m->fix_ratio[FIX_EAST])), real_abs(m->fix_ratio[FIX_HEADING]));

    return (m->worst_fix_component == FIX_DOWN) && (off < INNOVATION_GATE);
}

/* Mark a fix that is rejected for its height alone as faulty: a height does not contradict the attitude. */
static void mark_fix_height_faulty(estimator_t *m)
{
    if ((m->status[READING_POSITION_FIX] == STATUS_REJECTED) && is_only_height_rejected(m)) {
        m->status[READING_POSITION_FIX] = STATUS_FAULTY;
    }
}

void fuse_position_fix(estimator_t *m, const estimator_settings_t *s, const real_t z[4], real_t ahead)
{
    const int32_t k = READING_POSITION_FIX;
    bool down = true;
    real_t worst = REAL(0.0);
    real_t at = REAL(0.0);
    real_t out;
    bool settled;
    bool lasting;
    bool led;

    for (int32_t i = 0; i < FIX_COMPONENT_COUNT; i++) {
        real_t nu;
        real_t ratio;

        fix_h_row(m, i, ahead);
        nu = fix_innovation(m, z, i, ahead);
        ratio = innovation_ratio(m, nu, fix_variance(m, s, i));
        if ((real_abs(ratio) > INNOVATION_GATE) && (m->is_heading_aligned != 0) && (m->flight_phase < PHASE_LIFTING_OFF)) {
            ratio = inflate_fix_bias_walk(m, s, i, nu, ratio);
        }
        if (i == FIX_DOWN) {
            down = fix_height_consistent(m, s, nu, ratio);
        } else if ((m->is_heading_aligned == 0) && (real_abs(ratio) > INNOVATION_GATE)) {
            /* The initial position is unknown: the first fix sets it. */
            inflate_by_sigma(m, (i < FIX_HEADING) ? (ERROR_POSITION + i) : (ERROR_ATTITUDE + 2), nu);
            ratio = innovation_ratio(m, nu, fix_variance(m, s, i));
        } else {
            /* within the gate, or judged below */
        }
        if ((i != FIX_DOWN) || down) {
            m->fix_ratio[i] = ratio;
            if (real_abs(ratio) > real_abs(worst)) {
                worst = ratio;
                at = nu;
                m->worst_fix_component = i;
            }
        }
    }
    log_innovation(m, k, at, worst);
    /* Growing ratios of one sign show that the filter diverges, not that the fix jumps. */
    settled = ((real_t)(m->tick - m->last_grounded_tick) * s->dt) > FIX_CHECK_SETTLING_TIME_S;
    lasting = settled && (largest_mean_ratio(m) > LASTING_FIX_INNOVATION_RATIO);
    led = (s->has_rotor_model > 0) && lasting && (m->fix_max_ratio_squared_lp > DIVERGENCE_MEAN_SQUARE) && (real_abs(worst) > INNOVATION_GATE) &&
          (real_abs(worst) < (REAL(2.0) * INNOVATION_GATE));
    if ((real_abs(worst) > INNOVATION_GATE) && !led) {
        /* A height that differs from the sonar's does not show which of the two is wrong. */
        reject_measurement(m, s, k, at, z, 3,
                  ((REAL(2.0) * s->sensor_period[k]) + (REAL(8.0) * real_sqrt(fix_variance(m, s, 0)))) + REAL(0.05),
                  (is_only_height_rejected(m) && (m->status[READING_SONAR] == STATUS_FUSED)) ? REASON_HEIGHT_CONFLICT : REASON_INNOVATION);
        mark_fix_height_faulty(m);
        if (!reset_timeout_expired(m, s, k)) {
            return;
        }
        reset_to_fix(m, z, ahead);
        set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, at);
        mark_fix_height_faulty(m);
    }
    /* Large ratios of one sign show an unmodelled error of the filter. */
    m->fix_max_ratio_squared_lp += REAL(0.15) * ((worst * worst) - m->fix_max_ratio_squared_lp);
    for (int32_t i = 0; i < FIX_COMPONENT_COUNT; i++) {
        if ((i != FIX_DOWN) || down) {
            estimate_fix_noise(m, i);
        }
    }
    out = real_max(real_max(compute_fix_bias_limit_ratio(m, s, FIX_NORTH), compute_fix_bias_limit_ratio(m, s, FIX_EAST)), compute_fix_bias_limit_ratio(m, s, FIX_HEADING));
    if (led || (lasting && (m->fix_max_ratio_squared_lp > FIX_MEAN_SQUARE_GATE)) || ((out > REAL(1.0)) && settled)) {
        inflate_variances_on_divergence(m, s);
        set_fault(m, s, k, STATUS_FUSED, REASON_FUSED_THOUGH_OFFSET, at);
    }
    for (int32_t i = 0; i < FIX_COMPONENT_COUNT; i++) {
        if ((i != FIX_DOWN) || down) {
            fix_h_row(m, i, ahead);
            fuse_scalar(m, fix_innovation(m, z, i, ahead), fix_variance(m, s, i));
        }
    }
    for (int32_t i = 0; i < 3; i++) {
        const real_t most = (MAX_GYRO_BIAS_SIGMAS * s->initial_sigma[ERROR_GYRO_BIAS + i]) + (REAL(2.0) * m->sigma_output[ERROR_GYRO_BIAS + i]);

        if ((real_abs(m->gyro_bias_at_zero_yaw_rate[i]) > most) && (m->status[READING_RATES] == STATUS_FUSED) && down) {
            set_fault(m, s, READING_RATES, STATUS_REJECTED, REASON_LARGE_BIAS, m->gyro_bias_at_zero_yaw_rate[i]);
        }
    }
    mark_fused(m, k);
    if (!down) {
        set_fault(m, s, k, STATUS_FAULTY, REASON_HEIGHT_CONFLICT, m->fix_sonar_height_difference);
    }
    m->is_heading_aligned = 1;
}

void predict_fix_bias(estimator_t *m, const estimator_settings_t *s)
{
    for (int32_t k = ERROR_FIX_BIAS; k <= ERROR_FIX_HEADING; k++) {
        real_t keep = REAL(1.0);
        real_t by = s->decay[k];
        real_t q;

        for (int32_t blocks = (m->horizon_tick - m->fix_bias_tick) / s->block_ticks; blocks > 0; blocks /= 2) {
            if ((blocks % 2) == 1) {
                keep *= by;
            }
            by *= by;
        }
        m->x[k + 1] *= keep;
        q = fix_bias_variance(m, s, k - ERROR_FIX_BIAS) * (REAL(1.0) - (keep * keep));
        if (q > REAL(0.0)) {
            gauss_markov_update(m, k, keep, q);
        }
    }
    m->fix_bias_tick = m->horizon_tick;
}
