#include "flight/estimator_health.h"

/* Smoothing */

#define CORRECTION_TIME_CONSTANT_S REAL(0.3)
#define MAX_CORRECTION_SPEED_M_S REAL(0.5)
#define MAX_CORRECTION_TURN_RATE_RAD_S REAL(0.5)

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
            const real_t off = ((now->position[i] - s->smoothed_position[i]) - (dt * v)) / CORRECTION_TIME_CONSTANT_S;

            s->smoothed_position[i] = s->smoothed_position[i] + (dt * (v + real_min(real_max(off, -MAX_CORRECTION_SPEED_M_S), MAX_CORRECTION_SPEED_M_S)));
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
        off = ((now->attitude[2] - s->smoothed_heading) - (dt * turn)) / CORRECTION_TIME_CONSTANT_S;
        s->smoothed_heading = s->smoothed_heading + (dt * (turn + real_min(real_max(off, -MAX_CORRECTION_TURN_RATE_RAD_S), MAX_CORRECTION_TURN_RATE_RAD_S)));
        now->attitude[2] = s->smoothed_heading;
    } else {
        s->smoothed_heading = now->attitude[2];
    }
    s->begun = true;
    s->last_s = m->time_s;
}

/* Estimator health */

#define HOLD_POSITION_SIGMA_M REAL(0.25)
#define RESUME_POSITION_SIGMA_M REAL(0.15)
#define LAND_POSITION_SIGMA_M REAL(0.6)
#define RESUME_DELAY_S REAL(1.0)
#define HEIGHT_UNCERTAIN_DELAY_S REAL(0.3)
#define MAX_HOLD_S REAL(10.0)
#define GYRO_LOSS_DELAY_S REAL(0.1)
#define ATTITUDE_CONTRADICTION_DELAY_S REAL(0.15)
#define MAX_TILT_SIGMA_RAD (REAL(8.0) * DEGREE)
#define MAX_HEADING_SIGMA_RAD (REAL(30.0) * DEGREE)
#define PER_DEGREE (REAL(180.0) / REAL_PI)
#define SENSOR_BIT(k) (1UL << (uint32_t)(k))
#define ATTITUDE_AIDS (uint32_t)(SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_SONAR) | SENSOR_BIT(SENSOR_MAGNETIC))

static void set_verdict(health_verdict_t *found, int32_t action, int32_t code, real_t number)
{
    found->action = action;
    found->reason = make_message_1(code, number);
}

void health_monitor_reset(health_monitor_t *d, real_t stood)
{
    set_verdict(&d->verdict, FAILSAFE_NONE, SAY_NO_MESSAGE, REAL(0.0));
    d->standing_position_variance_m2 = stood;
    d->hold_since_s = REAL(0.0);
    d->is_certain = false;
    d->position_certain_since_s = REAL(0.0);
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

/* Set a verdict with the faults of sensors that concern it; sensors: their bits. */
static void set_explained_verdict(health_verdict_t *found, int32_t action, int32_t code, real_t number, const estimate_t *m, uint32_t sensors)
{
    set_verdict(found, action, code, number);
    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        if (((sensors & SENSOR_BIT(k)) != 0U) && is_sensor_faulty(&m->checks[k])) {
            add_faulty_sensor(&found->reason, k, &m->checks[k]);
        }
    }
}

static real_t compute_added_position_std(const estimate_t *m, real_t stood)
{
    const real_t most = real_max(real_max(m->position_variance[0], m->position_variance[1]), stood);

    return real_sqrt(most - stood);
}

/* height_counts: whether the height has been uncertain long enough to require landing. */
static void judge_estimate(health_verdict_t *found, const estimate_t *m, real_t stood, bool height_counts)
{
    const real_t place = compute_added_position_std(m, stood);
    const real_t height = real_sqrt(m->position_variance[2]);
    const real_t tilt = real_sqrt(real_max(m->attitude_variance[0], m->attitude_variance[1]));
    const real_t heading = real_sqrt(m->attitude_variance[2]);

    if (tilt > MAX_TILT_SIGMA_RAD) {
        set_explained_verdict(found, FAILSAFE_SINK, SAY_ATTITUDE_UNCERTAIN, tilt * PER_DEGREE, m,
                              (uint32_t)(SENSOR_BIT(SENSOR_RATES) | SENSOR_BIT(SENSOR_ACCELERATION)));
    } else if (heading > MAX_HEADING_SIGMA_RAD) {
        set_explained_verdict(found, FAILSAFE_LAND, SAY_HEADING_UNCERTAIN, heading * PER_DEGREE, m,
                              (uint32_t)(SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_MAGNETIC) | SENSOR_BIT(SENSOR_RATES)));
    } else if (m->checks[SENSOR_RATES].status == SENSOR_REJECTED) { /* bias beyond the range of the gyroscopes */
        set_explained_verdict(found, FAILSAFE_LAND, SAY_GIVEN_TEXT, REAL(0.0), m, SENSOR_BIT(SENSOR_RATES));
    } else if ((height > MAX_HEIGHT_SIGMA_M) && height_counts) {
        set_explained_verdict(found, FAILSAFE_LAND, SAY_HEIGHT_UNCERTAIN, height, m,
                              (uint32_t)(SENSOR_BIT(SENSOR_SONAR) | SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_PRESSURE)));
    } else if (place > HOLD_POSITION_SIGMA_M) {
        set_explained_verdict(found, (place > LAND_POSITION_SIGMA_M) ? FAILSAFE_LAND : FAILSAFE_HOLD, SAY_POSITION_UNCERTAIN, place, m,
                              (uint32_t)(SENSOR_BIT(SENSOR_FIX) | SENSOR_BIT(SENSOR_RANGES)));
    } else {
        set_verdict(found, FAILSAFE_NONE, SAY_NO_MESSAGE, REAL(0.0)); /* sufficient for all actions */
    }
}

bool is_gyro_unavailable(const estimate_t *m)
{
    const int32_t status = m->checks[SENSOR_RATES].status;

    return (status == SENSOR_MISSING) || (status == SENSOR_FAULTY) || (status == SENSOR_REJECTED);
}

/* Judge the sensors that determine the attitude: contradicted, or replaced by the model. */
static void judge_attitude_sensors(health_verdict_t *found, health_monitor_t *d, const estimate_t *m)
{
    uint32_t against = 0U;

    for (int32_t k = 0; k < ESTIMATE_SENSORS; k++) {
        const int32_t status = m->checks[k].status;
        const bool bad = (k == SENSOR_RATES) ? ((status == SENSOR_MISSING) || (status == SENSOR_FAULTY))
                                             : (status == SENSOR_REJECTED);

        if (!bad || !d->has_fault[k]) {
            d->fault_since_s[k] = m->time_s;
        }
        d->has_fault[k] = bad;
        if (((ATTITUDE_AIDS & SENSOR_BIT(k)) != 0U) && ((m->time_s - d->fault_since_s[k]) > ATTITUDE_CONTRADICTION_DELAY_S)) {
            against |= SENSOR_BIT(k);
        }
    }
    if (found->action == FAILSAFE_SINK) {
        /* an uncertain attitude explains more */
    } else if ((against & (against - 1U)) != 0U) { /* two or more */
        set_explained_verdict(found, FAILSAFE_SINK, SAY_ATTITUDE_CONTRADICTED, REAL(0.0), m, against);
    } else if ((m->time_s - d->fault_since_s[SENSOR_RATES]) > GYRO_LOSS_DELAY_S) {
        set_explained_verdict(found, FAILSAFE_LAND, SAY_GIVEN_TEXT, REAL(0.0), m, SENSOR_BIT(SENSOR_RATES));
    } else {
        /* no such fault */
    }
}

bool health_monitor_step(health_monitor_t *d, const estimate_t *m)
{
    const real_t t = m->time_s;
    const bool high = real_sqrt(m->position_variance[2]) > MAX_HEIGHT_SIGMA_M;
    const real_t high_s = d->height_uncertain ? d->height_uncertain_since_s : t;
    health_verdict_t found;
    bool said = false;

    judge_estimate(&found, m, d->standing_position_variance_m2, high && ((t - high_s) >= HEIGHT_UNCERTAIN_DELAY_S));
    judge_attitude_sensors(&found, d, m);
    d->height_uncertain = high;
    d->height_uncertain_since_s = high_s;
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
            if (compute_added_position_std(m, d->standing_position_variance_m2) >= RESUME_POSITION_SIGMA_M) {
                d->is_certain = false;
            } else if (!d->is_certain) {
                d->is_certain = true;
                d->position_certain_since_s = t;
            } else if ((t - d->position_certain_since_s) >= RESUME_DELAY_S) {
                set_verdict(&found, FAILSAFE_NONE, SAY_NO_MESSAGE, REAL(0.0));
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
