#include "estimate/filter/measurements/fusion.h"

#include "estimate/filter/measurements/fix_fusion.h"
#include "estimate/filter/measurements/scalar_fusion.h"
#include "estimate/filter/measurements/sensor_checks.h"
#include "estimate/filter/strapdown.h"
#include "estimate/filter/ud_filter.h"

real_t height_above_ground(const real_t x[STATE_COUNT], const estimator_settings_t *s)
{
    return (-x[NOMINAL_POSITION + 2] - real_max(x[NOMINAL_TERRAIN], REAL(0.0))) - s->ground_clearance;
}

/* Write the row H of the sonar; return the sonar's place below the centre of gravity (m). */
static real_t sonar_h_row(estimator_t *m, const estimator_settings_t *s, real_t r[9])
{
    const real_t *at = s->sonar_position;
    real_t n;
    real_t e;

    rotation_matrix(&m->x[NOMINAL_ATTITUDE], r);
    h_row_begin(m, ERROR_POSITION + 2, REAL(-1.0));
    h_row_add(m, ERROR_TERRAIN, REAL(-1.0));
    /* (exp(t) R r)_D = (R r)_D + t_N (R r)_E - t_E (R r)_N */
    n = ((r[0] * at[0]) + (r[1] * at[1])) + (r[2] * at[2]);
    e = ((r[3] * at[0]) + (r[4] * at[1])) + (r[5] * at[2]);
    h_row_add(m, ERROR_ATTITUDE, -e);
    h_row_add(m, ERROR_ATTITUDE + 1, n);
    return ((r[6] * at[0]) + (r[7] * at[1])) + (r[8] * at[2]);
}

/* Reset the height after innovations nu of the sonar. */
static void reset_height(estimator_t *m, const estimator_settings_t *s, real_t nu)
{
    const int32_t before = m->height_reset_tick;

    inflate_by_sigma(m, ERROR_POSITION + 2, nu); /* the sonar may have measured the foot of a wall in its cone */
    m->height_reset_tick = m->horizon_tick;
    if (!((before > 0) && (((real_t)(m->horizon_tick - before) * s->dt) < SECOND_HEIGHT_RESET_WINDOW_S))) {
        return;
    }
    inflate_by_sigma(m, ERROR_VELOCITY + 2, SECOND_HEIGHT_RESET_SPEED_SIGMA);
    inflate_by_sigma(m, ERROR_ACCEL_BIAS + 2, SECOND_HEIGHT_RESET_ACCEL_BIAS_SIGMA);
    inflate_by_sigma(m, ERROR_THRUST_SCALE, SECOND_HEIGHT_RESET_THRUST_SCALE_SIGMA);
}

/* Decide whether terrain or height is wrong after rejected ranges; return whether the range may be fused. */
static bool reset_to_sonar(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t nu, real_t nearest)
{
    const int32_t k = READING_SONAR;
    bool taken = true;
    real_t floor_height;
    bool step;

    reject_measurement(m, s, k, nu, z, 1, REAL(0.02) + (REAL(1.5) * s->sensor_period[k]), REASON_INNOVATION);
    floor_height = m->x[NOMINAL_TERRAIN] - nu;
    step = (m->agreeing_reject_count[k] >= 2) && (floor_height > MIN_TERRAIN_HEIGHT_M);
    if ((m->flight_phase <= PHASE_MOTORS_RUNNING) && (nu > REAL(0.0)) && (z[0] > nearest)) {
        /* On its legs the vehicle is at a known height: the sonar cannot measure ranges below this one. */
        if (m->agreeing_reject_count[k] >= 2) {
            m->sonar_effective_min_range = z[0];
        }
        taken = false;
    } else if (step && (m->terrain_steps >= MAX_TERRAIN_STEPS)) {
        /* Repeated steps: the height is wrong, not the terrain. */
        inflate_by_sigma(m, ERROR_POSITION + 2, nu);
        inflate_variance(m, ERROR_VELOCITY + 2, REAL(0.1));
        inflate_variance(m, ERROR_THRUST_SCALE, REAL(0.01));
        set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu);
    } else if (step && (nu > REAL(0.0))) {
        reset_height(m, s, nu); /* no surface lies below the floor */
        set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_SLOPE, nu);
    } else if (step) {
        inflate_by_sigma(m, ERROR_TERRAIN, nu);
        m->reject_score[k] = REAL(0.0);
        set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_STEP, floor_height);
        m->terrain_edge_weight = REAL(1.0);
    } else if (reset_timeout_expired(m, s, k)) {
        if ((((real_t)(m->tick - m->last_fused_tick[READING_POSITION_FIX]) * s->dt) < RESET_TIMEOUT_S) && (m->last_fused_tick[READING_POSITION_FIX] > 0)) {
            inflate_by_sigma(m, ERROR_TERRAIN, nu); /* the fix holds the height */
        } else {
            inflate_by_sigma(m, ERROR_POSITION + 2, nu);
            inflate_variance(m, ERROR_VELOCITY + 2, REAL(0.1) + (nu * nu));
        }
        set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu);
    } else {
        if (m->agreeing_reject_count[k] >= 2) {
            set_fault(m, s, k, STATUS_REJECTED, REASON_INNOVATION, nu); /* a consistent range below the room's floor */
        }
        taken = false;
    }
    return taken;
}

/* Whether the sonar repeats a reading more often than its noise and the vehicle's motion allow. */
static bool sonar_stuck(estimator_t *m, const estimator_settings_t *s, real_t z, real_t nu)
{
    const bool same = (z <= m->sonar_range_prev) && (z >= m->sonar_range_prev);

    m->sonar_range_prev = z;
    if ((!same) || ((height_above_ground(m->x, s) - m->fix_sonar_height_difference) < LEG_CLEARANCE_HEIGHT_M)) {
        m->sonar_repeat_chance = REAL(1.0);
    } else {
        /* The height's variance is not included: the height may be more accurate. */
        const real_t sigma = REAL(1.3) * real_sqrt(s->sonar_variance);
        const real_t likely = ((REAL(0.399) * s->sonar_resolution) / sigma) /
                              (REAL(1.0) + (REAL(0.5) * real_min((nu * nu) / (sigma * sigma), REAL(9.0))));

        m->sonar_repeat_chance *= real_min(likely, REAL(1.0));
    }
    return (m->sonar_repeat_chance < SONAR_STUCK_PROBABILITY) && same;
}

/* Fuse the range to the surface below; a step that no other sensor sees belongs to the terrain. */
static void fuse_sonar_range(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead)
{
    const int32_t k = READING_SONAR;
    real_t r[9];
    const real_t down = sonar_h_row(m, s, r);
    const real_t nearest = m->sonar_effective_min_range + REAL(0.005);
    const real_t standing = s->ground_clearance - s->sonar_position[2];
    real_t said = z[0];
    real_t variance = s->sonar_variance * m->noise_scale[AID_SONAR];
    real_t expect;
    real_t nu;
    real_t ratio;
    bool over;

    if ((r[8] < s->sonar_cone_cosine) || (z[0] >= s->sonar_max_range)) {
        return;
    }
    expect = (-(m->x[NOMINAL_POSITION + 2] + (ahead * m->x[NOMINAL_VELOCITY + 2])) - down) - m->x[NOMINAL_TERRAIN];
    if ((z[0] <= nearest) && (standing < nearest)) {
        /* Below the minimum range: uniform between that range and the range on the floor. */
        said = REAL(0.5) * (nearest + standing);
        variance = ((nearest - standing) * (nearest - standing)) / REAL(12.0);
        if (expect < nearest) {
            fuse_scalar(m, said - expect, REAL(100.0) * variance); /* weight of a hundredth: the errors of such readings are correlated */
            mark_fused(m, k);
            return;
        }
    }
    nu = said - expect;
    ratio = innovation_ratio(m, nu, variance);
    log_innovation(m, k, nu, ratio);
    if (sonar_stuck(m, s, z[0], nu)) {
        set_fault(m, s, k, STATUS_FAULTY, REASON_STUCK, z[0]);
        return;
    }
    over = (m->terrain_edge_weight > REAL(0.0)) || (real_abs(m->x[NOMINAL_TERRAIN]) > MAX_FLOOR_HEIGHT_M);
    /* Innovations of one sign: over an edge the surface is wrong, else the height, since surfaces are level. */
    if (real_abs(ratio) < INNOVATION_GATE) {
        m->sonar_ratio_lp += REAL(0.2) * (ratio - m->sonar_ratio_lp);
        if (!over) {
            estimate_noise(m, AID_SONAR, ratio);
        }
    }
    if (real_abs(m->sonar_ratio_lp) > SONAR_MEAN_GATE) {
        m->sonar_ratio_lp = REAL(0.0);
        set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_SLOPE, nu);
        if (over || (nu < REAL(0.0))) {
            m->terrain_edge_weight = REAL(1.0);
        } else {
            reset_height(m, s, nu);
            (void)sonar_h_row(m, s, r);
        }
    }
    if (over && (real_abs(ratio) > TERRAIN_STEP_GATE) && (m->terrain_steps < MAX_TERRAIN_STEPS) && ((m->x[NOMINAL_TERRAIN] - nu) > MIN_TERRAIN_HEIGHT_M)) {
        /* Over an object the surface steps. */
        m->terrain_steps += 1;
        m->terrain_edge_weight = REAL(1.0);
        inflate_by_sigma(m, ERROR_TERRAIN, nu);
        (void)sonar_h_row(m, s, r);
    } else if (real_abs(ratio) > INNOVATION_GATE) {
        if (!reset_to_sonar(m, s, z, nu, nearest)) {
            return;
        }
        (void)sonar_h_row(m, s, r);
    } else {
        /* as expected */
    }
    fuse_scalar(m, nu, variance);
    mark_fused(m, k);
}

void reset_terrain(estimator_t *m)
{
    fuse_error_state(m, ERROR_TERRAIN, -m->x[NOMINAL_TERRAIN], REAL(2.5e-5));
}

void fuse_liftoff_thrust(estimator_t *m, real_t lift)
{
    const real_t scale = LIFTOFF_THRUST_RATIO / lift;
    const real_t spread = LIFTOFF_THRUST_SIGMA * scale;

    fuse_error_state(m, ERROR_THRUST_SCALE, scale - m->x[NOMINAL_THRUST_SCALE], spread * spread);
}

bool fuse_ground_contact(estimator_t *m, const estimator_settings_t *s)
{
    const real_t height = height_above_ground(m->x, s);
    const bool below = height < REAL(0.0);

    if (below) {
        h_row_begin(m, ERROR_POSITION + 2, REAL(-1.0));
        if (m->x[NOMINAL_TERRAIN] > REAL(0.0)) {
            h_row_add(m, ERROR_TERRAIN, REAL(-1.0));
        }
        fuse_scalar(m, -height, REAL(2.5e-5));
        if (m->x[NOMINAL_VELOCITY + 2] > REAL(0.0)) {
            fuse_error_state(m, ERROR_VELOCITY + 2, -m->x[NOMINAL_VELOCITY + 2], REAL(1e-3));
        }
    }
    return below;
}

/* Return the distance to the first wall along u; the axis is -1 if there is none. */
static real_t nearest_wall(const estimator_t *m, const estimator_settings_t *s, real_t ahead, const real_t u[3],
                           int32_t *axis)
{
    real_t best = REAL(1e9);

    *axis = -1;
    for (int32_t i = 0; i < 3; i++) {
        if (real_abs(u[i]) > REAL(0.3)) {
            const real_t plane = (u[i] > REAL(0.0)) ? s->wall_planes[(2 * i) + 1] : s->wall_planes[2 * i];
            const real_t far = (plane - (m->x[i] + (ahead * m->x[NOMINAL_VELOCITY + i]))) / u[i];

            if ((far > REAL(0.0)) && (far < best)) {
                best = far;
                *axis = i;
            }
        }
    }
    return best;
}

/* Fuse at most this many beams; return whether all beams are fused. */
static bool fuse_wall_ranges(estimator_t *m, const estimator_settings_t *s, const real_t z[MAX_FUSED_BEAMS], real_t ahead, int32_t most)
{
    const int32_t k = READING_RANGE_RING;
    const int32_t last_beam = ((m->next_beam + most) < s->beam_count) ? (m->next_beam + most) : s->beam_count;
    const bool all = last_beam >= s->beam_count;
    real_t r[9];

    rotation_matrix(&m->x[NOMINAL_ATTITUDE], r);
    if (m->next_beam == 0) {
        m->beams_seen = 0;
        m->beams_fused = 0;
        /* all scans together hold at most wall_info_limit; a scan adds the information lost since the last one */
        for (int32_t i = 0; i < 2; i++) {
            const real_t told = m->wall_info_limit[i] * state_variance(m, ERROR_POSITION + i);

            m->wall_info_fraction[i] = (told > REAL(1.0)) ? (REAL(1.0) - (REAL(1.0) / told)) : REAL(0.0);
            m->wall_info_limit[i] = REAL(0.0);
        }
    }
    for (int32_t b = m->next_beam; b < last_beam; b++) {
        const real_t *beam = s->beam_directions[b];
        real_t u[3];
        int32_t axis;
        real_t best;

        if (!((z[b] > REAL(0.0)) && (z[b] < (REAL(0.995) * s->ring_max_range)))) {
            continue;
        }
        m->beams_seen += 1;
        for (int32_t i = 0; i < 3; i++) {
            u[i] = ((r[3 * i] * beam[0]) + (r[(3 * i) + 1] * beam[1])) + (r[(3 * i) + 2] * beam[2]);
        }
        best = nearest_wall(m, s, ahead, u, &axis);
        if ((axis >= 0) && (axis != 2) && !(best > (REAL(1.1) * s->ring_max_range))) {
            /* l = (c - p_i) / u_i; they contain no heading, whose error is one more constant: du = t x u */
            const real_t h = REAL(-1.0) / u[axis];
            const real_t across = ((h * best) * ((axis == 0) ? u[1] : u[0])) * m->sigma_output[ERROR_ATTITUDE + 2];
            const real_t slope = (best * best) + (s->ring_baseline * s->ring_baseline);
            const real_t lasts = ((slope * slope) * s->ring_constant_variance) + (across * across);
            const real_t away = (slope * best) * best;
            const real_t scatters = away * (away * s->ring_noise_variance);
            const real_t nu = z[b] - best;
            real_t ratio;

            h_row_begin(m, ERROR_POSITION + axis, h);
            ratio = innovation_ratio(m, nu, scatters + lasts);
            if (real_abs(ratio) < BEAM_INNOVATION_GATE) {
                log_innovation(m, k, nu, ratio);
                m->beams_fused += 1;
                m->wall_info_limit[axis] += (h * h) / lasts;
                if (m->wall_info_fraction[axis] > REAL(0.0)) {
                    apply_correction(m, nu, scatters + (lasts / m->wall_info_fraction[axis]));
                    rotation_matrix(&m->x[NOMINAL_ATTITUDE], r);
                }
            }
        }
    }
    m->next_beam = all ? 0 : last_beam;
    if (!all) {
        /* the other beams follow */
    } else if (m->beams_fused > 0) {
        mark_fused(m, k);
    } else if (m->tick >= m->fault_until_tick[k]) {
        m->status[k] = STATUS_WAITING;
        m->reason[k] = (m->beams_seen == 0) ? REASON_WALLS_TOO_FAR : REASON_NO_WALL;
    } else {
        /* the fault is still reported */
    }
    return all;
}

/* Free the bias of an aid after consistent innovations nu. */
static void reset_aid_bias(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t bias, real_t nu)
{
    inflate_by_sigma(m, bias, nu);
    set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu);
}

/* Fuse an aid with one bias; free that bias after a second of consistent rejections. */
static void fuse_drifting_aid(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t bias, real_t nu, real_t variance,
                              const real_t *z, int32_t count, real_t near)
{
    const real_t ratio = innovation_ratio(m, nu, variance);

    log_innovation(m, k, nu, ratio);
    estimate_noise(m, (k == READING_PRESSURE) ? AID_PRESSURE : AID_MAGNETIC, ratio);
    if (real_abs(ratio) > INNOVATION_GATE) {
        reject_measurement(m, s, k, nu, z, count, near, REASON_INNOVATION);
        if (!reset_timeout_expired(m, s, k)) {
            return;
        }
        reset_aid_bias(m, s, k, bias, nu);
    } else if (k == READING_PRESSURE) {
        /* A bias that drifts faster than modelled causes innovations of one sign. */
        m->pressure_ratio_lp += REAL(0.2) * (ratio - m->pressure_ratio_lp);
        if (real_abs(m->pressure_ratio_lp) > PRESSURE_MEAN_GATE) {
            m->pressure_ratio_lp = REAL(0.0);
            reset_aid_bias(m, s, k, bias, nu);
        }
    } else {
        /* the motors' field gives the magnetometer's ratios a mean other than zero */
    }
    fuse_scalar(m, nu, variance);
    mark_fused(m, k);
}

/* Fuse the pressure less the standard one and less the rotors' part. */
static void fuse_pressure(estimator_t *m, const estimator_settings_t *s, const real_t z[1], real_t ahead)
{
    const real_t variance = s->pressure_noise_density * m->noise_scale[AID_PRESSURE];
    real_t nu;

    h_row_begin(m, ERROR_POSITION + 2, s->pressure_gradient_down);
    h_row_add(m, ERROR_PRESSURE_BIAS, REAL(1.0));
    nu = (z[0] - (s->pressure_gradient_down * (m->x[NOMINAL_POSITION + 2] + (ahead * m->x[NOMINAL_VELOCITY + 2])))) - m->x[NOMINAL_PRESSURE_BIAS];
    fuse_drifting_aid(m, s, READING_PRESSURE, ERROR_PRESSURE_BIAS, nu, variance, z, 1, REAL(10.0) * real_sqrt(variance));
}

/* Fuse the heading by the direction of the magnetic field. */
static void fuse_magnetic_heading(estimator_t *m, const estimator_settings_t *s, const real_t z[3], real_t ahead)
{
    const real_t variance = s->mag_heading_variance * m->noise_scale[AID_MAGNETIC];
    real_t r[9];
    real_t north;
    real_t east;
    real_t across;
    real_t along;
    real_t square;
    real_t nu;

    rotation_matrix(&m->x[NOMINAL_ATTITUDE], r);
    north = ((r[0] * z[0]) + (r[1] * z[1])) + (r[2] * z[2]);
    east = ((r[3] * z[0]) + (r[4] * z[1])) + (r[5] * z[2]);
    across = real_sqrt((north * north) + (east * east)) - s->earth_field[0];
    along = (((r[6] * z[0]) + (r[7] * z[1])) + (r[8] * z[2])) - s->earth_field[2];
    square = (across * across) + (along * along);
    if (square > ((MAGNETIC_FIELD_GATE * MAGNETIC_FIELD_GATE) *
                  (s->mag_field_variance + ((s->mag_current_variance * m->supply_current) * m->supply_current)))) {
        set_fault(m, s, READING_MAGNETIC_FIELD, STATUS_FAULTY, REASON_FIELD_STRENGTH, real_sqrt(square));
        return;
    }
    h_row_begin(m, ERROR_ATTITUDE + 2, REAL(1.0));
    h_row_add(m, ERROR_ATTITUDE, -s->earth_field[2] / s->earth_field[0]);
    h_row_add(m, ERROR_MAG_BIAS, REAL(1.0));
    nu = real_wrap_angle((-real_atan2(east, north) - (ahead * m->yaw_rate)) - m->x[NOMINAL_MAG_BIAS]);
    fuse_drifting_aid(m, s, READING_MAGNETIC_FIELD, ERROR_MAG_BIAS, nu, variance, z, 3, REAL(1e-5));
}

int32_t measurement_cost(const estimator_t *m, const estimator_settings_t *s, int32_t kind, int32_t left)
{
    const int32_t beams = s->beam_count - m->next_beam;
    int32_t cost = 1;

    if (kind == READING_POSITION_FIX) {
        cost = (m->fix_bias_tick < m->horizon_tick) ? FIX_BIAS_STEP_COST : FIX_FUSION_COST;
    } else if (kind == READING_RANGE_RING) {
        cost = (beams < left) ? beams : left;
        cost = (cost > 1) ? cost : 1;
    } else {
        /* a scalar measurement */
    }
    return cost;
}

bool fuse_measurement(estimator_t *m, const estimator_settings_t *s, int32_t i, int32_t cost)
{
    const real_t *z = m->queue_value[i];
    const real_t ahead = m->queue_time_in_period[i];
    bool all = true;

    switch (m->queue_sensor[i]) {
    case READING_POSITION_FIX:
        if (m->fix_bias_tick < m->horizon_tick) {
            predict_fix_bias(m, s);
            all = false;
        } else {
            fuse_position_fix(m, s, z, ahead);
        }
        break;
    case READING_SONAR:
        fuse_sonar_range(m, s, z, ahead);
        break;
    case READING_RANGE_RING:
        all = fuse_wall_ranges(m, s, z, ahead, cost);
        break;
    case READING_PRESSURE:
        fuse_pressure(m, s, z, ahead);
        break;
    default:
        fuse_magnetic_heading(m, s, z, ahead);
        break;
    }
    return all;
}

void fuse_accel_residual(estimator_t *m, const estimator_settings_t *s, int32_t count, int32_t i)
{
    const real_t slope = m->accel_per_air_velocity[i];
    const real_t nu = (m->accel_mean[i] - m->model_accel_mean[i]) - m->x[NOMINAL_ACCEL_BIAS + i];
    const real_t variance = m->accel_residual_density[i] / ((real_t)count * s->dt);
    real_t r[9];
    real_t known;
    real_t ratio;

    rotation_matrix(&m->x[NOMINAL_ATTITUDE], r);
    h_row_begin(m, ERROR_ACCEL_BIAS + i, REAL(1.0));
    h_row_add(m, ERROR_THRUST_SCALE, m->accel_per_thrust_scale[i]);
    for (int32_t j = 0; j < 3; j++) {
        h_row_add(m, ERROR_VELOCITY + j, slope * r[(3 * j) + i]);
    }
    h_row_add(m, ERROR_WIND, -slope * r[i]);
    h_row_add(m, ERROR_WIND + 1, -slope * r[3 + i]);
    known = innovation_variance(m);
    ratio = nu / real_sqrt(known + variance);
    check_accel_model(m, s, r, height_above_ground(m->x_output, s), nu, variance, known, i);
    if ((real_abs(ratio) < INNOVATION_GATE) && (m->is_accel_distrusted == 0)) {
        apply_correction(m, nu, variance);
    }
    if ((i == 0) || (real_abs(ratio) > m->max_accel_model_ratio)) {
        log_innovation(m, READING_ACCELERATION, nu, ratio);
        m->max_accel_model_ratio = real_abs(ratio);
    }
}

void fuse_zero_motion(estimator_t *m, const estimator_settings_t *s, int32_t count, int32_t mode, int32_t i)
{
    const bool still = mode == PHASE_STANDING;
    const real_t change = m->gyro_mean[i] - m->gyro_mean_prev[i];
    real_t calm = still ? (((REAL(2.0) * s->rest_gyro_sigma) * s->rest_gyro_sigma) / (real_t)count) : REAL(5e-5);
    real_t off;

    fuse_error_state(m, ERROR_VELOCITY + i, -m->x[NOMINAL_VELOCITY + i], REAL(4e-4));
    if ((mode == PHASE_ROTORS_COASTING) || ((i == 2) && !still)) {
        return; /* rotors turn the vehicle on its legs at a lasting rate, which is no noise */
    }
    calm = real_max(calm, change * change); /* a rate that changes is motion on the legs, not bias */
    m->gyro_mean_prev[i] = m->gyro_mean[i];
    off = m->gyro_mean[i] - m->x[NOMINAL_GYRO_BIAS + i];
    h_row_begin(m, ERROR_GYRO_BIAS + i, REAL(1.0));
    /* With running rotors the vehicle may slide on its legs. */
    if (still || (real_abs(innovation_ratio(m, off, calm)) < INNOVATION_GATE)) {
        fuse_scalar(m, off, calm);
    }
    if (still && (s->is_fitted[READING_ACCELERATION] > 0)) {
        const real_t variance = ((REAL(2.0) * s->rest_accel_sigma) * s->rest_accel_sigma) / (real_t)count;
        real_t r[9];
        real_t nu;

        rotation_matrix(&m->x[NOMINAL_ATTITUDE], r);
        nu = (m->accel_mean[i] + (GRAVITY * r[6 + i])) - m->x[NOMINAL_ACCEL_BIAS + i];
        h_row_begin(m, ERROR_ACCEL_BIAS + i, REAL(1.0));
        /* R^T (-g e_D), and d(R^T u) = R^T (u x t) */
        h_row_add(m, ERROR_ATTITUDE, -r[3 + i] * GRAVITY);
        h_row_add(m, ERROR_ATTITUDE + 1, r[i] * GRAVITY);
        if (real_abs(innovation_ratio(m, nu, variance)) < (REAL(2.0) * INNOVATION_GATE)) {
            apply_correction(m, nu, variance);
        }
    }
}
