#include "watch.h"

#include <stddef.h>

/* Bridging */

#define VITAL 4

void watch_start(watch_t *w)
{
    w->begun = false;
    w->lost_s = REAL(0.0);
    w->what = 0;
}

static bool same_number(real_t a, real_t b)
{
    return (a <= b) && (a >= b);
}

static void values_of(const motion_t *m, real_t out[12])
{
    for (int32_t i = 0; i < 3; i++) {
        out[i] = m->position[i];
        out[3 + i] = m->velocity[i];
        out[6 + i] = m->attitude[i];
        out[9 + i] = m->rates[i];
    }
}

/* Put the last good values in place of those that are not finite; which they were. */
static int32_t mended(bool begun, const real_t values[12], const real_t last[12], belief_t *out)
{
    real_t *to[VITAL] = {out->motion.position, out->motion.velocity, out->motion.attitude, out->motion.rates};
    int32_t bad = 0;

    for (int32_t k = 0; k < VITAL; k++) {
        bool right = out->valid;

        for (int32_t i = 0; i < 3; i++) {
            right = right && real_finite(values[(3 * k) + i]);
        }
        if (!right) {
            bad += (int32_t)(1U << (uint32_t)k);
            for (int32_t i = 0; i < 3; i++) {
                to[k][i] = begun ? last[(3 * k) + i] : REAL(0.0);
            }
        }
    }
    return bad;
}

void belief_copy(const belief_t *from, int32_t beams, belief_t *to)
{
    to->time_s = from->time_s;
    to->motion = from->motion;
    to->valid = from->valid;
    to->judged = from->judged;
    for (int32_t i = 0; i < 3; i++) {
        to->position_variance[i] = from->position_variance[i];
        to->attitude_variance[i] = from->attitude_variance[i];
    }
    for (int32_t k = 0; k < BELIEF_SENSORS; k++) {
        to->checks[k] = from->checks[k];
    }
    for (int32_t i = 0; i < beams; i++) {
        to->ranges[i] = from->ranges[i];
    }
}

void watch_step(watch_t *w, const belief_t *m, real_t period_s, const ring_t *ring)
{
    belief_t *const good = &w->good;
    real_t values[12];
    real_t last[12];
    const real_t last_s = w->begun ? good->time_s : REAL(0.0);
    const real_t last_voltage = w->begun ? good->motion.voltage : REAL(1.0);
    bool frozen = w->begun;
    int32_t bad;

    values_of(&m->motion, values);
    values_of(&good->motion, last);
    belief_copy(m, ring->count, good);
    for (int32_t i = 0; i < 12; i++) {
        frozen = frozen && same_number(values[i], w->values[i]);
    }
    bad = mended(w->begun, values, last, good);
    if (!real_finite(m->time_s) || (w->begun && (m->time_s <= last_s))) {
        good->time_s = last_s + period_s;
    }
    for (int32_t i = 0; i < ring->count; i++) {
        if (!real_finite(good->ranges[i])) {
            good->ranges[i] = ring->max_range;
        }
    }
    if (!((m->motion.voltage > REAL(0.0)) && real_finite(m->motion.voltage))) {
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

#define SMOOTH_S REAL(0.3)
#define FASTEST_M_S REAL(0.5)
#define FASTEST_RAD_S REAL(0.5)

void smooth_start(smooth_t *s)
{
    s->begun = false;
    s->last_s = REAL(0.0);
    s->heading = REAL(0.0);
    for (int32_t i = 0; i < 3; i++) {
        s->velocity[i] = REAL(0.0);
        s->place[i] = REAL(0.0);
    }
}

void smooth_step(smooth_t *s, belief_t *m, bool anew)
{
    motion_t *now = &m->motion;
    const real_t dt = m->time_s - s->last_s;
    const bool follows = s->begun && !anew && (dt < REAL(0.1));
    real_t sr;
    real_t cr;
    real_t sp;
    real_t cp;

    for (int32_t i = 0; i < 3; i++) {
        const real_t velocity = now->velocity[i];

        if (follows) {
            const real_t v = REAL(0.5) * (s->velocity[i] + velocity);
            const real_t off = ((now->position[i] - s->place[i]) - (dt * v)) / SMOOTH_S;

            s->place[i] = s->place[i] + (dt * (v + real_min(real_max(off, -FASTEST_M_S), FASTEST_M_S)));
            now->position[i] = s->place[i];
        } else {
            s->place[i] = now->position[i];
        }
        s->velocity[i] = velocity;
    }
    if (follows) {
        real_t turn;
        real_t off;

        sine_cosine(now->attitude[0], &sr, &cr);
        sine_cosine(now->attitude[1], &sp, &cp);
        turn = ((sr * now->rates[1]) + (cr * now->rates[2])) / real_max(cp, REAL(0.1));
        off = ((now->attitude[2] - s->heading) - (dt * turn)) / SMOOTH_S;
        s->heading = s->heading + (dt * (turn + real_min(real_max(off, -FASTEST_RAD_S), FASTEST_RAD_S)));
        now->attitude[2] = s->heading;
    } else {
        s->heading = now->attitude[2];
    }
    s->begun = true;
    s->last_s = m->time_s;
}

/* Doubts */

#define HOLD_M REAL(0.25)
#define CERTAIN_M REAL(0.15)
#define LAND_M REAL(0.6)
#define CERTAIN_S REAL(1.0)
#define HEIGHT_S REAL(0.3)
#define WAIT_S REAL(10.0)
#define GONE_S REAL(0.1)
#define CONTRADICTED_S REAL(0.15)
#define TILT (REAL(8.0) * DEGREE)
#define HEADING (REAL(30.0) * DEGREE)
#define PER_DEGREE (REAL(180.0) / REAL_PI)
#define APART 3

static const int32_t apart[APART] = {BELIEF_FIX, BELIEF_SONAR, BELIEF_MAGNETIC};

void doubts_start(doubts_t *d, real_t stood)
{
    d->now.demand = DEMAND_NONE;
    d->now.why = say(SAY_NOTHING);
    d->stood = stood;
    d->since_s = REAL(0.0);
    d->certain = false;
    d->certain_s = REAL(0.0);
    d->high = false;
    d->high_s = REAL(0.0);
    for (int32_t k = 0; k < BELIEF_SENSORS; k++) {
        d->wrong[k] = false;
        d->wrong_s[k] = REAL(0.0);
    }
}

static void name_sensor(message_t *m, int32_t k, const check_t *check)
{
    bool named = false;

    for (int32_t i = 0; (i < SAID_SENSORS) && !named; i++) {
        if (m->because[i].sensor < 0) {
            m->because[i].sensor = (int16_t)k;
            m->because[i].status = (int16_t)check->status;
            m->because[i].why = check->why;
            m->because[i].number = check->number;
            named = true;
        }
    }
}

static bool disbelieved(const check_t *check)
{
    return (check->status == BELIEF_MISSING) || (check->status == BELIEF_REJECTED) ||
           (check->status == BELIEF_FAULTY);
}

/* A doubt with what is wrong with the sensors that would tell; sensors: bits of them. */
static doubt_t doubt(int32_t demand, int32_t code, real_t number, const belief_t *m, uint32_t sensors)
{
    doubt_t found;

    found.demand = demand;
    found.why = say_1(code, number);
    for (int32_t k = 0; k < BELIEF_SENSORS; k++) {
        if (((sensors & (1UL << (uint32_t)k)) != 0U) && disbelieved(&m->checks[k])) {
            name_sensor(&found.why, k, &m->checks[k]);
        }
    }
    return found;
}

#define BIT(k) (1UL << (uint32_t)(k))

static real_t strayed(const belief_t *m, real_t stood)
{
    const real_t most = real_max(real_max(m->position_variance[0], m->position_variance[1]), stood);

    return real_sqrt(most - stood);
}

/* height_counts: whether an uncertain height has lasted for long enough to land for. */
static doubt_t judge(const belief_t *m, real_t stood, bool height_counts)
{
    const real_t place = strayed(m, stood);
    const real_t height = real_sqrt(m->position_variance[2]);
    const real_t tilt = real_sqrt(real_max(m->attitude_variance[0], m->attitude_variance[1]));
    const real_t heading = real_sqrt(m->attitude_variance[2]);
    doubt_t found;

    found.demand = DEMAND_NONE;
    found.why = say(SAY_NOTHING);
    if (tilt > TILT) {
        found = doubt(DEMAND_SINK, SAY_TILT_DOUBT, tilt * PER_DEGREE, m,
                      (uint32_t)(BIT(BELIEF_RATES) | BIT(BELIEF_ACCELERATION)));
    } else if (heading > HEADING) {
        found = doubt(DEMAND_LAND, SAY_HEADING_DOUBT, heading * PER_DEGREE, m,
                      (uint32_t)(BIT(BELIEF_FIX) | BIT(BELIEF_MAGNETIC) | BIT(BELIEF_RATES)));
    } else if (m->checks[BELIEF_RATES].status == BELIEF_REJECTED) { /* a bias that gyroscopes cannot have */
        found.demand = DEMAND_LAND;
        found.why = say(SAY_GIVEN);
        name_sensor(&found.why, BELIEF_RATES, &m->checks[BELIEF_RATES]);
    } else if ((height > HEIGHT_M) && height_counts) {
        found = doubt(DEMAND_LAND, SAY_HEIGHT_DOUBT, height, m,
                      (uint32_t)(BIT(BELIEF_SONAR) | BIT(BELIEF_FIX) | BIT(BELIEF_PRESSURE)));
    } else if (place > HOLD_M) {
        found = doubt((place > LAND_M) ? DEMAND_LAND : DEMAND_HOLD, SAY_PLACE_DOUBT, place, m,
                      (uint32_t)(BIT(BELIEF_FIX) | BIT(BELIEF_RANGES)));
    } else {
        /* good enough for all */
    }
    return found;
}

bool turns_unfelt(const belief_t *m)
{
    const int32_t status = m->checks[BELIEF_RATES].status;

    return (status == BELIEF_MISSING) || (status == BELIEF_FAULTY) || (status == BELIEF_REJECTED);
}

/* What is thought of sensors that an attitude depends on: it cannot be right, or is told by the model. */
static doubt_t contradicted(doubts_t *d, const belief_t *m)
{
    message_t both = say(SAY_CONTRADICTED);
    doubt_t found;
    int32_t against = 0;

    found.demand = DEMAND_NONE;
    found.why = say(SAY_NOTHING);

    for (int32_t k = 0; k < BELIEF_SENSORS; k++) {
        const int32_t status = m->checks[k].status;
        const bool counts = (k == BELIEF_RATES) || (k == BELIEF_FIX) || (k == BELIEF_SONAR) || (k == BELIEF_MAGNETIC);
        const bool bad = (k == BELIEF_RATES) ? ((status == BELIEF_MISSING) || (status == BELIEF_FAULTY))
                                             : (status == BELIEF_REJECTED);

        if (!bad) {
            d->wrong[k] = false;
        } else if (counts && !d->wrong[k]) {
            d->wrong[k] = true;
            d->wrong_s[k] = m->time_s;
        } else {
            /* as before */
        }
    }
    for (int32_t i = 0; i < APART; i++) {
        const int32_t k = apart[i];

        if (d->wrong[k] && ((m->time_s - d->wrong_s[k]) > CONTRADICTED_S)) {
            name_sensor(&both, k, &m->checks[k]);
            against++;
        }
    }
    if (against > 1) {
        found.demand = DEMAND_SINK;
        found.why = both;
    } else if (d->wrong[BELIEF_RATES] && ((m->time_s - d->wrong_s[BELIEF_RATES]) > GONE_S)) {
        found.demand = DEMAND_LAND;
        found.why = say(SAY_GIVEN);
        name_sensor(&found.why, BELIEF_RATES, &m->checks[BELIEF_RATES]);
    } else {
        /* nothing of the kind */
    }
    return found;
}

bool doubts_step(doubts_t *d, const belief_t *m)
{
    const real_t t = m->time_s;
    const bool high = real_sqrt(m->position_variance[2]) > HEIGHT_M;
    const real_t high_s = d->high ? d->high_s : t;
    doubt_t found = judge(m, d->stood, high && ((t - high_s) >= HEIGHT_S));
    const doubt_t contrary = contradicted(d, m);
    bool said = false;

    d->high = high;
    d->high_s = high_s;
    if ((contrary.demand != DEMAND_NONE) && (found.demand != DEMAND_SINK)) {
        found = contrary;
    }
    if (d->now.demand == DEMAND_LAND) {
        said = found.demand == DEMAND_SINK;
    } else if ((found.demand == DEMAND_LAND) || (found.demand == DEMAND_SINK)) {
        said = true;
    } else {
        if (found.demand == DEMAND_HOLD) {
            d->certain = false;
            if (d->now.demand != DEMAND_HOLD) {
                d->since_s = t;
                said = true;
            }
        } else if (d->now.demand == DEMAND_HOLD) {
            if (strayed(m, d->stood) >= CERTAIN_M) {
                d->certain = false;
            } else if (!d->certain) {
                d->certain = true;
                d->certain_s = t;
            } else if ((t - d->certain_s) >= CERTAIN_S) {
                found.demand = DEMAND_NONE;
                found.why = say(SAY_NOTHING);
                said = true;
            } else {
                /* certain, but not for long enough */
            }
        } else {
            /* nothing is doubted */
        }
        if (!said && (d->now.demand == DEMAND_HOLD) && ((t - d->since_s) > WAIT_S)) {
            if (found.why.code == SAY_NOTHING) {
                found.why = d->now.why;
            }
            found.demand = DEMAND_LAND;
            found.why.code = SAY_PLACE_WAITED;
            found.why.number[1] = WAIT_S;
            said = true;
        }
    }
    if (said) {
        d->now = found;
    }
    return said;
}

/* Oscillation */

#define SHARE REAL(0.5)
#define PERIODS 4
#define LASTING_S REAL(2.0)
#define SLOWEST_S REAL(4.0)
#define EVEN REAL(1.6)

static void turns_start(turns_t *t, real_t back)
{
    t->back = back;
    t->rising = true;
    t->extreme = -REAL_INFINITY;
    t->at_s = REAL(0.0);
    t->count = 0;
}

void oscillations_start(oscillations_t *o)
{
    static const real_t ranges[OSCILLATION_INPUTS] = {REAL(1.0), REAL(1.0), REAL(2.0), REAL(2.0)};
    static const real_t asked[OSCILLATION_ASKED] = {REAL(0.1), REAL(0.1),  REAL(0.1),
                                                    REAL(0.2), REAL(0.05), REAL(0.05)};

    for (int32_t i = 0; i < OSCILLATION_INPUTS; i++) {
        turns_start(&o->inputs[i].turns, SHARE * ranges[i]);
        o->inputs[i].since_s = REAL(0.0);
        o->inputs[i].count = 0;
        o->inputs[i].period_s = REAL(0.0);
        o->inputs[i].low = REAL(0.0);
        o->inputs[i].high = REAL(0.0);
    }
    for (int32_t i = 0; i < OSCILLATION_ASKED; i++) {
        turns_start(&o->asked[i], asked[i]);
    }
}

static bool turns_step(turns_t *t, real_t time_s, real_t value)
{
    const real_t ahead = t->rising ? (value - t->extreme) : (t->extreme - value);
    bool turned = false;

    if (ahead > REAL(0.0)) {
        t->extreme = value;
        t->at_s = time_s;
    } else if (!(-ahead < t->back)) {
        if (t->count == 3) {
            t->turned_s[0] = t->turned_s[1];
            t->turned_s[1] = t->turned_s[2];
            t->count = 2;
        }
        t->turned_s[t->count] = t->at_s;
        t->count++;
        t->rising = !t->rising;
        t->extreme = value;
        t->at_s = time_s;
        turned = true;
    } else {
        /* on its way back */
    }
    return turned;
}

static void forget(swings_t *s)
{
    s->count = 0;
    s->period_s = REAL(0.0);
    s->turns.count = 0;
}

static void turn(swings_t *s, real_t value)
{
    if (s->turns.count == 3) {
        const real_t period = s->turns.turned_s[2] - s->turns.turned_s[0];
        const bool even = (period <= (EVEN * s->period_s)) && (s->period_s <= (EVEN * period));

        if ((period > SLOWEST_S) || ((s->count > 0) && !even)) {
            forget(s);
        } else if (s->count > 0) {
            s->count++;
            s->period_s = period;
        } else {
            s->count = 2;
            s->period_s = period;
            s->since_s = s->turns.turned_s[0];
            s->low = value;
            s->high = value;
        }
    }
}

void oscillations_step(oscillations_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out)
{
    bool steered = false;

    out->there = false;
    out->input = 0;
    out->since_s = REAL(0.0);
    out->lasting_s = REAL(0.0);
    out->size = REAL(0.0);
    out->frequency_Hz = REAL(0.0);
    if (asked != NULL) {
        for (int32_t i = 0; i < OSCILLATION_ASKED; i++) {
            const bool turned = turns_step(&o->asked[i], time_s, asked[i]);

            steered = steered || turned;
        }
    }
    for (int32_t i = 0; i < OSCILLATION_INPUTS; i++) {
        swings_t *s = &o->inputs[i];
        bool turned;
        real_t lasting = REAL(0.0);

        if (steered) {
            forget(s);
        }
        turned = turns_step(&s->turns, time_s, inputs[i]);
        if (s->count > 0) {
            s->low = real_min(s->low, inputs[i]);
            s->high = real_max(s->high, inputs[i]);
        }
        if (turned) {
            turn(s, inputs[i]);
        } else if ((s->count > 0) && ((time_s - s->turns.turned_s[s->turns.count - 1]) > SLOWEST_S)) {
            forget(s);
        } else {
            /* goes on */
        }
        if (s->count > 0) {
            lasting = s->turns.turned_s[s->turns.count - 1] - s->since_s;
        }
        if ((s->count >= (2 * PERIODS)) && (lasting >= LASTING_S) && (!out->there || (lasting > out->lasting_s))) {
            out->there = true;
            out->input = i;
            out->since_s = s->since_s;
            out->lasting_s = lasting;
            out->size = s->high - s->low;
            out->frequency_Hz = REAL(1.0) / s->period_s;
        }
    }
}
