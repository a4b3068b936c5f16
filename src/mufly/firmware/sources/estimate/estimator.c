#include "estimate/estimator.h"

#define VITAL_COUNT 4
#define MAX_ESTIMATE_VALUE REAL(1e6) /* m, m/s, rad, rad/s; squares of larger values overflow later */

void estimate_monitor_start(estimate_monitor_t *w)
{
    w->begun = false;
    w->lost_s = REAL(0.0);
    w->what = 0;
}

static bool is_same_number(real_t a, real_t b)
{
    return (a <= b) && (a >= b);
}

static void list_values(const motion_estimate_t *m, real_t out[12])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = m->position[i];
        out[3 + i] = m->velocity[i];
        out[6 + i] = m->attitude[i];
        out[9 + i] = m->rates[i];
    }
}

/* Replace values that are not finite, or too large, by the last good ones; return the replaced groups. An estimate with
 * replaced values is not valid: motors do not start with it. */
static int32_t replace_bad_values(bool begun, const real_t values[12], const real_t last[12], estimate_t *out)
{
    real_t *to[VITAL_COUNT] = {out->motion.position, out->motion.velocity, out->motion.attitude, out->motion.rates};
    int32_t bad = 0;

    for (int32_t k = 0; k < VITAL_COUNT; k++) {
        bool right = out->valid;

        for (int32_t i = 0; i < 3; i++) {
            right = right && (real_abs(values[(3 * k) + i]) < MAX_ESTIMATE_VALUE);
        }
        if (!right) {
            bad += (int32_t)(1U << (uint32_t)k);
            for (int32_t i = 0; i < 3; i++) {
                to[k][i] = begun ? last[(3 * k) + i] : REAL(0.0);
            }
        }
    }
    out->valid = out->valid && (bad == 0);
    return bad;
}

void copy_estimate(const estimate_t *from, int32_t beams, estimate_t *to)
{
    to->time_s = from->time_s;
    to->motion = from->motion;
    to->valid = from->valid;
    to->judged = from->judged;
    for (int32_t i = 0; i < 3; i++) {
        to->position_variance[i] = from->position_variance[i];
        to->attitude_variance[i] = from->attitude_variance[i];
        to->specific_force[i] = from->specific_force[i];
    }
    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        to->checks[k] = from->checks[k];
    }
    for (int32_t i = 0; i < beams; i++) {
        to->ranges[i] = from->ranges[i];
    }
}

void check_estimate(estimate_monitor_t *w, const estimate_t *m, real_t period_s, const beam_ring_t *ring)
{
    estimate_t *const good = &w->good;
    real_t values[12];
    real_t last[12];
    const real_t last_s = w->begun ? good->time_s : REAL(0.0);
    const real_t last_voltage = w->begun ? good->motion.voltage : REAL(1.0);
    bool frozen = w->begun;
    int32_t bad;

    list_values(&m->motion, values);
    list_values(&good->motion, last);
    copy_estimate(m, ring->count, good);
    for (int32_t i = 0; i < 12; i++) {
        frozen = frozen && is_same_number(values[i], w->values[i]);
    }
    bad = replace_bad_values(w->begun, values, last, good);
    if (!real_is_finite(m->time_s) || (w->begun && (m->time_s <= last_s))) {
        good->time_s = last_s + period_s;
    }
    for (int32_t i = 0; i < ring->count; i++) {
        if (!real_is_finite(good->ranges[i])) {
            good->ranges[i] = ring->max_range;
        }
    }
    if (!((m->motion.voltage > REAL(0.0)) && real_is_finite(m->motion.voltage))) {
        good->motion.voltage = last_voltage;
    }
    if ((bad == 0) && !frozen) {
        w->lost_s = REAL(0.0);
    } else {
        w->lost_s = (w->begun ? w->lost_s : REAL(0.0)) + period_s;
    }
    w->what = bad;
    w->begun = true;
    for (int32_t i = 0; i < 12; i++) {
        w->values[i] = values[i];
    }
}
