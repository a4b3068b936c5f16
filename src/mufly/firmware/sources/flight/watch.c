#include "flight/watch.h"

#include <stddef.h>

/* Bridging */

#define VITAL_COUNT 4

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

/* Replace values that are not finite by the last good ones; return the replaced groups. An estimate with replaced values is
 * not valid: motors do not start with it. */
static int32_t replace_bad_values(bool begun, const real_t values[12], const real_t last[12], estimate_t *out)
{
    real_t *to[VITAL_COUNT] = {out->motion.position, out->motion.velocity, out->motion.attitude, out->motion.rates};
    int32_t bad = 0;

    for (int32_t k = 0; k < VITAL_COUNT; k++) {
        bool right = out->valid;

        for (int32_t i = 0; i < 3; i++) {
            right = right && real_is_finite(values[(3 * k) + i]);
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

/* Smoothing */

#define CORRECTION_TIME_S REAL(0.3)
#define MAX_CORRECTION_M_S REAL(0.5)
#define MAX_CORRECTION_RAD_S REAL(0.5)

void correction_smoother_reset(correction_smoother_t *s)
{
    s->begun = false;
    s->last_s = REAL(0.0);
    s->smoothed_heading = REAL(0.0);
    for (int32_t i = 0; i < 3; i++) {
        s->last_velocity[i] = REAL(0.0);
        s->smoothed_position[i] = REAL(0.0);
    }
}

void correction_smoother_step(correction_smoother_t *s, estimate_t *m, bool anew)
{
    motion_estimate_t *now = &m->motion;
    const real_t dt = m->time_s - s->last_s;
    const bool follows = s->begun && !anew && (dt < REAL(0.1));
    real_t sr;
    real_t cr;
    real_t sp;
    real_t cp;

    for (int32_t i = 0; i < 3; i++) {
        const real_t velocity = now->velocity[i];

        if (follows) {
            const real_t v = REAL(0.5) * (s->last_velocity[i] + velocity);
            const real_t off = ((now->position[i] - s->smoothed_position[i]) - (dt * v)) / CORRECTION_TIME_S;

            s->smoothed_position[i] = s->smoothed_position[i] + (dt * (v + real_min(real_max(off, -MAX_CORRECTION_M_S), MAX_CORRECTION_M_S)));
            now->position[i] = s->smoothed_position[i];
        } else {
            s->smoothed_position[i] = now->position[i];
        }
        s->last_velocity[i] = velocity;
    }
    if (follows) {
        real_t turn;
        real_t off;

        sine_cosine(now->attitude[0], &sr, &cr);
        sine_cosine(now->attitude[1], &sp, &cp);
        turn = ((sr * now->rates[1]) + (cr * now->rates[2])) / real_max(cp, REAL(0.1));
        off = ((now->attitude[2] - s->smoothed_heading) - (dt * turn)) / CORRECTION_TIME_S;
        s->smoothed_heading = s->smoothed_heading + (dt * (turn + real_min(real_max(off, -MAX_CORRECTION_RAD_S), MAX_CORRECTION_RAD_S)));
        now->attitude[2] = s->smoothed_heading;
    } else {
        s->smoothed_heading = now->attitude[2];
    }
    s->begun = true;
    s->last_s = m->time_s;
}

/* Estimator health */

#define HOLD_SIGMA_M REAL(0.25)
#define RESUME_SIGMA_M REAL(0.15)
#define LAND_SIGMA_M REAL(0.6)
#define RESUME_DELAY_S REAL(1.0)
#define HEIGHT_DELAY_S REAL(0.3)
#define MAX_HOLD_S REAL(10.0)
#define GYRO_LOSS_DELAY_S REAL(0.1)
#define CONTRADICTION_DELAY_S REAL(0.15)
#define MAX_TILT_SIGMA (REAL(8.0) * DEGREE)
#define MAX_HEADING_SIGMA (REAL(30.0) * DEGREE)
#define PER_DEGREE (REAL(180.0) / REAL_PI)
#define ATTITUDE_AID_COUNT 3

static const int32_t attitude_aids[ATTITUDE_AID_COUNT] = {SENSOR_FIX, SENSOR_SONAR, SENSOR_MAGNETIC};

void health_monitor_reset(health_monitor_t *d, real_t stood)
{
    d->verdict.action = FAILSAFE_NONE;
    d->verdict.reason = make_message(SAY_NO_MESSAGE);
    d->floor_variance_m2 = stood;
    d->hold_since_s = REAL(0.0);
    d->is_certain = false;
    d->certain_since_s = REAL(0.0);
    d->height_uncertain = false;
    d->height_uncertain_since_s = REAL(0.0);
    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        d->has_fault[k] = false;
        d->fault_since_s[k] = REAL(0.0);
    }
}

static void add_faulty_sensor(message_t *m, int32_t k, const sensor_status_t *check)
{
    bool named = false;

    for (int32_t i = 0; (i < MESSAGE_SENSORS) && !named; i++) {
        if (m->faulty_sensors[i].sensor < 0) {
            m->faulty_sensors[i].sensor = (int16_t)k;
            m->faulty_sensors[i].status = (int16_t)check->status;
            m->faulty_sensors[i].why = check->why;
            m->faulty_sensors[i].number = check->number;
            named = true;
        }
    }
}

static bool is_sensor_faulty(const sensor_status_t *check)
{
    return (check->status == SENSOR_MISSING) || (check->status == SENSOR_REJECTED) ||
           (check->status == SENSOR_FAULTY);
}

/* Message with the faults of the sensors that measure the quantity; sensors: their bits. */
static health_verdict_t make_verdict(int32_t demand, int32_t code, real_t number, const estimate_t *m, uint32_t sensors)
{
    health_verdict_t found;

    found.action = demand;
    found.reason = make_message_1(code, number);
    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        if (((sensors & (1UL << (uint32_t)k)) != 0U) && is_sensor_faulty(&m->checks[k])) {
            add_faulty_sensor(&found.reason, k, &m->checks[k]);
        }
    }
    return found;
}

#define SENSOR_BIT(k) (1UL << (uint32_t)(k))

static real_t position_std_growth(const estimate_t *m, real_t stood)
{
    const real_t most = real_max(real_max(m->position_variance[0], m->position_variance[1]), stood);

    return real_sqrt(most - stood);
}

/* height_counts: whether the height has been uncertain long enough to require landing. */
static health_verdict_t judge_estimate(const estimate_t *m, real_t stood, bool height_counts)
{
    const real_t place = position_std_growth(m, stood);
    const real_t height = real_sqrt(m->position_variance[2]);
    const real_t tilt = real_sqrt(real_max(m->attitude_variance[0], m->attitude_variance[1]));
    const real_t heading = real_sqrt(m->attitude_variance[2]);
    health_verdict_t found;

    found.action = FAILSAFE_NONE;
    found.reason = make_message(SAY_NO_MESSAGE);
    if (tilt > MAX_TILT_SIGMA) {
        found = make_verdict(FAILSAFE_SINK, SAY_ATTITUDE_UNCERTAIN, tilt * PER_DEGREE, m,
                      (uint32_t)(SENSOR_BIT(SENSOR_RATES) | SENSOR_BIT(SENSOR_ACCELERATION)));
    } else if (heading > MAX_HEADING_SIGMA) {
        found = make_verdict(FAILSAFE_LAND, SAY_HEADING_UNCERTAIN, heading * PER_DEGREE, m,
                      (uint32_t)(SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_MAGNETIC) | SENSOR_BIT(SENSOR_RATES)));
    } else if (m->checks[SENSOR_RATES].status == SENSOR_REJECTED) { /* bias beyond the range of the gyroscopes */
        found.action = FAILSAFE_LAND;
        found.reason = make_message(SAY_GIVEN_TEXT);
        add_faulty_sensor(&found.reason, SENSOR_RATES, &m->checks[SENSOR_RATES]);
    } else if ((height > MAX_HEIGHT_SIGMA_M) && height_counts) {
        found = make_verdict(FAILSAFE_LAND, SAY_HEIGHT_UNCERTAIN, height, m,
                      (uint32_t)(SENSOR_BIT(SENSOR_SONAR) | SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_PRESSURE)));
    } else if (place > HOLD_SIGMA_M) {
        found = make_verdict((place > LAND_SIGMA_M) ? FAILSAFE_LAND : FAILSAFE_HOLD, SAY_POSITION_UNCERTAIN, place, m,
                      (uint32_t)(SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_RANGES)));
    } else {
        /* sufficient for all actions */
    }
    return found;
}

bool gyro_unavailable(const estimate_t *m)
{
    const int32_t status = m->checks[SENSOR_RATES].status;

    return (status == SENSOR_MISSING) || (status == SENSOR_FAULTY) || (status == SENSOR_REJECTED);
}

/* Status of the sensors that determine the attitude: contradicted, or replaced by the model. */
static health_verdict_t judge_attitude_sensors(health_monitor_t *d, const estimate_t *m)
{
    message_t both = make_message(SAY_ATTITUDE_CONTRADICTED);
    health_verdict_t found;
    int32_t against = 0;

    found.action = FAILSAFE_NONE;
    found.reason = make_message(SAY_NO_MESSAGE);

    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        const int32_t status = m->checks[k].status;
        const bool counts = (k == SENSOR_RATES) || (k == SENSOR_FIX) || (k == SENSOR_SONAR) || (k == SENSOR_MAGNETIC);
        const bool bad = (k == SENSOR_RATES) ? ((status == SENSOR_MISSING) || (status == SENSOR_FAULTY))
                                             : (status == SENSOR_REJECTED);

        if (!bad) {
            d->has_fault[k] = false;
        } else if (counts && !d->has_fault[k]) {
            d->has_fault[k] = true;
            d->fault_since_s[k] = m->time_s;
        } else {
            /* unchanged */
        }
    }
    for (int32_t i = 0; i < ATTITUDE_AID_COUNT; i++) {
        const int32_t k = attitude_aids[i];

        if (d->has_fault[k] && ((m->time_s - d->fault_since_s[k]) > CONTRADICTION_DELAY_S)) {
            add_faulty_sensor(&both, k, &m->checks[k]);
            against++;
        }
    }
    if (against > 1) {
        found.action = FAILSAFE_SINK;
        found.reason = both;
    } else if (d->has_fault[SENSOR_RATES] && ((m->time_s - d->fault_since_s[SENSOR_RATES]) > GYRO_LOSS_DELAY_S)) {
        found.action = FAILSAFE_LAND;
        found.reason = make_message(SAY_GIVEN_TEXT);
        add_faulty_sensor(&found.reason, SENSOR_RATES, &m->checks[SENSOR_RATES]);
    } else {
        /* no such fault */
    }
    return found;
}

bool health_monitor_step(health_monitor_t *d, const estimate_t *m)
{
    const real_t t = m->time_s;
    const bool high = real_sqrt(m->position_variance[2]) > MAX_HEIGHT_SIGMA_M;
    const real_t high_s = d->height_uncertain ? d->height_uncertain_since_s : t;
    health_verdict_t found = judge_estimate(m, d->floor_variance_m2, high && ((t - high_s) >= HEIGHT_DELAY_S));
    const health_verdict_t contrary = judge_attitude_sensors(d, m);
    bool said = false;

    d->height_uncertain = high;
    d->height_uncertain_since_s = high_s;
    if ((contrary.action != FAILSAFE_NONE) && (found.action != FAILSAFE_SINK)) {
        found = contrary;
    }
    if (d->verdict.action == FAILSAFE_LAND) {
        said = found.action == FAILSAFE_SINK;
    } else if ((found.action == FAILSAFE_LAND) || (found.action == FAILSAFE_SINK)) {
        said = true;
    } else {
        if (found.action == FAILSAFE_HOLD) {
            d->is_certain = false;
            if (d->verdict.action != FAILSAFE_HOLD) {
                d->hold_since_s = t;
                said = true;
            }
        } else if (d->verdict.action == FAILSAFE_HOLD) {
            if (position_std_growth(m, d->floor_variance_m2) >= RESUME_SIGMA_M) {
                d->is_certain = false;
            } else if (!d->is_certain) {
                d->is_certain = true;
                d->certain_since_s = t;
            } else if ((t - d->certain_since_s) >= RESUME_DELAY_S) {
                found.action = FAILSAFE_NONE;
                found.reason = make_message(SAY_NO_MESSAGE);
                said = true;
            } else {
                /* certain, but not for long enough */
            }
        } else {
            /* no limitation */
        }
        if (!said && (d->verdict.action == FAILSAFE_HOLD) && ((t - d->hold_since_s) > MAX_HOLD_S)) {
            if (found.reason.code == SAY_NO_MESSAGE) {
                found.reason = d->verdict.reason;
            }
            found.action = FAILSAFE_LAND;
            found.reason.code = SAY_POSITION_UNCERTAIN_TOO_LONG;
            found.reason.number[1] = MAX_HOLD_S;
            said = true;
        }
    }
    if (said) {
        d->verdict = found;
    }
    return said;
}

/* Oscillation */

#define MIN_SWING_SHARE REAL(0.5)
#define MIN_PERIOD_COUNT 4
#define MIN_DURATION_S REAL(2.0)
#define MAX_PERIOD_S REAL(4.0)
#define MAX_PERIOD_RATIO REAL(1.6)

static void turning_points_reset(turning_points_t *t, real_t back)
{
    t->reversal_threshold = back;
    t->is_rising = true;
    t->last_extreme = -REAL_INFINITY;
    t->extreme_time_s = REAL(0.0);
    t->turn_count = 0;
}

void oscillation_detector_reset(oscillation_detector_t *o)
{
    static const real_t ranges[OSCILLATION_INPUTS] = {REAL(1.0), REAL(1.0), REAL(2.0), REAL(2.0)};
    static const real_t asked[STEERING_SIGNALS] = {REAL(0.1), REAL(0.1),  REAL(0.1),
                                                    REAL(0.2), REAL(0.05), REAL(0.05)};

    for (int32_t i = 0; i < OSCILLATION_INPUTS; i++) {
        turning_points_reset(&o->inputs[i].turning_points, MIN_SWING_SHARE * ranges[i]);
        o->inputs[i].start_s = REAL(0.0);
        o->inputs[i].half_period_count = 0;
        o->inputs[i].period_s = REAL(0.0);
        o->inputs[i].lowest_value = REAL(0.0);
        o->inputs[i].highest_value = REAL(0.0);
    }
    for (int32_t i = 0; i < STEERING_SIGNALS; i++) {
        turning_points_reset(&o->asked[i], asked[i]);
    }
}

static bool turning_points_step(turning_points_t *t, real_t time_s, real_t value)
{
    const real_t ahead = t->is_rising ? (value - t->last_extreme) : (t->last_extreme - value);
    bool turned = false;

    if (ahead > REAL(0.0)) {
        t->last_extreme = value;
        t->extreme_time_s = time_s;
    } else if (!(-ahead < t->reversal_threshold)) {
        if (t->turn_count == 3) {
            t->turn_times_s[0] = t->turn_times_s[1];
            t->turn_times_s[1] = t->turn_times_s[2];
            t->turn_count = 2;
        }
        t->turn_times_s[t->turn_count] = t->extreme_time_s;
        t->turn_count++;
        t->is_rising = !t->is_rising;
        t->last_extreme = value;
        t->extreme_time_s = time_s;
        turned = true;
    } else {
        /* returning */
    }
    return turned;
}

static void reset_count(input_oscillation_t *s)
{
    s->half_period_count = 0;
    s->period_s = REAL(0.0);
    s->turning_points.turn_count = 0;
}

static void add_turn(input_oscillation_t *s, real_t value)
{
    if (s->turning_points.turn_count == 3) {
        const real_t period = s->turning_points.turn_times_s[2] - s->turning_points.turn_times_s[0];
        const bool even = (period <= (MAX_PERIOD_RATIO * s->period_s)) && (s->period_s <= (MAX_PERIOD_RATIO * period));

        if ((period > MAX_PERIOD_S) || ((s->half_period_count > 0) && !even)) {
            reset_count(s);
        } else if (s->half_period_count > 0) {
            s->half_period_count++;
            s->period_s = period;
        } else {
            s->half_period_count = 2;
            s->period_s = period;
            s->start_s = s->turning_points.turn_times_s[0];
            s->lowest_value = value;
            s->highest_value = value;
        }
    }
}

void oscillation_detector_step(oscillation_detector_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out)
{
    bool steered = false;

    out->is_present = false;
    out->input_name = 0;
    out->start_s = REAL(0.0);
    out->duration_s = REAL(0.0);
    out->amplitude = REAL(0.0);
    out->frequency_Hz = REAL(0.0);
    if (asked != NULL) {
        for (int32_t i = 0; i < STEERING_SIGNALS; i++) {
            const bool turned = turning_points_step(&o->asked[i], time_s, asked[i]);

            steered = steered || turned;
        }
    }
    for (int32_t i = 0; i < OSCILLATION_INPUTS; i++) {
        input_oscillation_t *s = &o->inputs[i];
        bool turned;
        real_t lasting = REAL(0.0);

        if (steered) {
            reset_count(s);
        }
        turned = turning_points_step(&s->turning_points, time_s, inputs[i]);
        if (s->half_period_count > 0) {
            s->lowest_value = real_min(s->lowest_value, inputs[i]);
            s->highest_value = real_max(s->highest_value, inputs[i]);
        }
        if (turned) {
            add_turn(s, inputs[i]);
        } else if ((s->half_period_count > 0) && ((time_s - s->turning_points.turn_times_s[s->turning_points.turn_count - 1]) > MAX_PERIOD_S)) {
            reset_count(s);
        } else {
            /* continues */
        }
        if (s->half_period_count > 0) {
            lasting = s->turning_points.turn_times_s[s->turning_points.turn_count - 1] - s->start_s;
        }
        if ((s->half_period_count >= (2 * MIN_PERIOD_COUNT)) && (lasting >= MIN_DURATION_S) && (!out->is_present || (lasting > out->duration_s))) {
            out->is_present = true;
            out->input_name = i;
            out->start_s = s->start_s;
            out->duration_s = lasting;
            out->amplitude = s->highest_value - s->lowest_value;
            out->frequency_Hz = REAL(1.0) / s->period_s;
        }
    }
}
