#include "guards.h"

#include "factors.h"

void flag(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t code, int32_t why, real_t number)
{
    m->code[k] = code;
    m->why[k] = why;
    m->number[k] = number;
    m->until[k] = m->tick + (int32_t)(LASTS_S / s->dt);
}

void fits(estimator_t *m, int32_t k)
{
    m->used[k] = m->tick;
    m->rejected[k] = 0;
    m->agree[k] = 0;
    m->doubt[k] *= FORGET;
    if ((m->tick >= m->until[k]) && (m->doubt[k] < REAL(1.0))) {
        m->code[k] = FUSED;
        m->why[k] = FINE;
    } else if ((m->code[k] == REJECTED) && (m->tick >= m->until[k])) {
        m->code[k] = FUSED;
    } else {
        /* told of for a while yet */
    }
}

void misfits(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t why, real_t number)
{
    m->rejected[k] += 1;
    m->doubt[k] += REAL(1.0);
    if (m->doubt[k] > ((k == R_SONAR) ? SONAR_ALARM : ALARM)) {
        flag(m, s, k, REJECTED, why, number);
    }
}

/* Whether a reading is the one before to the last bit, and that cannot be. */
static bool repeated(const estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count)
{
    bool same = (s->noisy[k] != 0) && (m->came[k] != 0);
    bool told = false;

    /* A camera that hangs may still turn with the gyroscopes. */
    for (int32_t j = 0; (j < ((k == R_FIX) ? 3 : count)) && same; j++) {
        same = !(z[j] != m->last[STARTS[k] + j]);
        told = told || (((k != R_ROTOR) || (z[j] != REAL(0.0))) &&
                        ((k != R_RING) || (z[j] < (REAL(0.995) * s->ring_max))));
    }
    return same && told;
}

/* Of two readings that are the same the second counts only if it came in its own time. Whether it counts. */
static bool counts(estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count)
{
    const bool early = ((real_t)(m->tick - m->came[k]) * s->dt) < (REAL(0.6) * s->period[k]);
    bool usable = true;

    if (repeated(m, s, z, k, count)) {
        usable = false;
        if (early) {
            m->twice[k] += 1;
            if (m->twice[k] >= 2) {
                flag(m, s, k, m->code[k], DOUBLED, REAL(0.0));
            }
        } else {
            m->same[k] += 1;
            m->came[k] = m->tick;
            m->twice[k] = 0;
            if (m->same[k] >= 2) {
                flag(m, s, k, FAULTY, FROZEN, (real_t)m->same[k] * s->period[k]);
            }
        }
    } else {
        m->same[k] = 0;
        if (((s->noisy[k] == 0) || (k == R_RING)) && (m->came[k] > 0) && early) {
            usable = false;
            m->twice[k] += 1;
            if (m->twice[k] >= 3) {
                flag(m, s, k, m->code[k], DOUBLED, REAL(0.0));
            }
        }
    }
    return usable;
}

/* A reading that is believed so far. Whether it may be used. */
static bool keep(estimator_t *m, const estimator_settings_t *s, const real_t *z, int32_t k, int32_t count, real_t age)
{
    bool usable = true;

    m->came[k] = m->tick;
    m->silent[k] = 0;
    bool again = (m->code[k] >= MISSING) && (m->tick >= m->until[k]);
    if (again || ((m->code[k] == NOTHING) && (k != R_RING))) {
        /* Whether a ring that sees is of use is said by what it sees: in a large room it sees no wall. */
        m->code[k] = (k == R_RING) ? NOTHING : FUSED;
        m->why[k] = FINE;
    }
    if (age > (s->latency[k] + s->slack[k])) {
        flag(m, s, k, FAULTY, LATE, age);
        if ((k <= R_RATES) || (k == R_ROTOR) || (k == R_BATTERY)) {
            usable = false;
        }
    }
    if (s->every[k] > 1) {
        m->turns[k] += 1;
        m->skip[k] = ((m->turns[k] % s->every[k]) != 0) ? 1 : 0;
    }
    for (int32_t j = 0; j < count; j++) {
        m->last[STARTS[k] + j] = z[j];
    }
    if ((k <= R_RATES) || (k == R_RING)) {
        m->used[k] = m->tick;
    }
    return usable;
}

static void inspect_clipping(estimator_t *m, const estimator_settings_t *s, const real_t share[3])
{
    real_t clip = REAL(0.0);

    for (int32_t k = 0; k < 3; k++) {
        const bool possible = (share[k] >= REAL(0.0)) && (share[k] <= REAL(1.0));

        m->clipped[k] += REAL(0.1) * ((possible ? share[k] : REAL(1.0)) - m->clipped[k]);
        clip = real_max(clip, m->clipped[k]);
    }
    if ((clip > SHARE) && (m->code[R_ACCELERATION] == FUSED)) {
        flag(m, s, R_ACCELERATION, FUSED, CLIPS, clip);
    }
}

void inspect(estimator_t *m, const estimator_settings_t *s, real_t z[VALUES], int32_t fresh[SENSORS],
             const real_t age[SENSORS])
{
    for (int32_t k = 0; k < SENSORS; k++) {
        real_t *value = &z[STARTS[k]];
        const int32_t count = STARTS[k + 1] - STARTS[k];

        if (s->fitted[k] == 0) {
            fresh[k] = 0;
            continue;
        }
        m->skip[k] = 0;
        if (fresh[k] == 2) {
            m->silent[k] += 1;
            fresh[k] = 0;
        }
        if (fresh[k] == 1) {
            for (int32_t j = 0; j < count; j++) {
                if (!(real_abs(value[j]) < s->bound[k])) {
                    fresh[k] = 0;
                }
            }
            if (fresh[k] == 0) {
                flag(m, s, k, FAULTY, INSANE, REAL(0.0));
            } else if (!((age[k] >= -s->dt) && (age[k] <= OLDEST_S))) {
                fresh[k] = 0;
                flag(m, s, k, FAULTY, LATE, REAL(0.0));
            } else {
                /* it is looked at */
            }
        } else if (fresh[k] != 0) {
            fresh[k] = 0;
            flag(m, s, k, FAULTY, INSANE, REAL(0.0));
        } else {
            /* nothing new */
        }
        if (fresh[k] == 1) {
            if (!counts(m, s, value, k, count)) {
                fresh[k] = 0;
            } else if (!keep(m, s, value, k, count, age[k])) {
                fresh[k] = 0;
            } else {
                /* it is used */
            }
        }
        if (fresh[k] == 0) {
            const real_t since = (real_t)(m->tick - m->came[k]) * s->dt;

            for (int32_t j = 0; j < count; j++) {
                value[j] = m->last[STARTS[k] + j];
            }
            if ((m->came[k] > 0) && (since > s->patience[k])) {
                m->code[k] = MISSING;
                m->why[k] = (m->silent[k] > 2) ? NO_ECHO : SILENT;
                m->number[k] = since;
            }
        }
    }
    inspect_clipping(m, s, &z[CLIPPING]);
}

void go_astray(estimator_t *m, const estimator_settings_t *s)
{
    if (m->adrift <= 1) {
        for (int32_t k = 0; k < 3; k++) {
            factors_loosen(m, GYRO + k, ASTRAY_BIAS * ASTRAY_BIAS);
            factors_loosen(m, TURN + k, ASTRAY_TURN * ASTRAY_TURN);
        }
        factors_loosen(m, V_, ASTRAY_SPEED * ASTRAY_SPEED);
        factors_loosen(m, V_ + 1, ASTRAY_SPEED * ASTRAY_SPEED);
    }
    m->adrift = (int32_t)(ADRIFT_S / s->dt);
}

void smooth_rates(estimator_t *m, const estimator_settings_t *s, bool flying)
{
    const int32_t now = cycle(m->tick - 1, MODELLED);
    real_t worst = REAL(0.0);
    real_t led = REAL(0.0);
    real_t most;
    bool alike = m->spikes > 0;
    bool small = true;
    bool fine;

    for (int32_t k = 0; k < 3; k++) {
        real_t off;

        m->row[k] = (m->before[k] + (s->dt * m->force[now][9 + k])) + m->turn_off[k];
        off = m->rates[k] - m->row[k];
        worst = real_max(worst, real_abs(off));
        /* A spike may come in two steps, of which each would pass. */
        led = real_max(led, real_abs((LINGERS * m->suspect[R_RATES][k]) + off));
        /* What its moments are off by, in flight and on the legs */
        m->turn_off[k] += (m->mode >= LIGHT) ? (TURN_OFF * real_min(real_max(off, -SPIKE), SPIKE)) : REAL(0.0);
    }
    /* A model that is off again and again cannot tell a spike from a motion. */
    most = SPIKE + (ROUGH * m->rough);
    m->rough += REAL(0.1) * (real_min(worst, SPIKE) - m->rough);
    m->adrift = (m->adrift > 1) ? (m->adrift - 1) : m->adrift; /* once astray, it remembers */
    if ((!flying) || (s->model == 0)) {
        m->spikes = 0;
        return;
    }
    for (int32_t k = 0; k < 3; k++) {
        alike = alike && (real_abs(m->rates[k] - m->spike[k]) < ALIKE);
        m->spike[k] = m->rates[k];
    }
    fine = real_max(worst, led) < most;
    for (int32_t k = 0; k < 3; k++) {
        m->suspect[R_RATES][k] *= LINGERS;
        if (fine) {
            m->suspect[R_RATES][k] += m->rates[k] - m->row[k];
        }
    }
    if (fine) {
        m->spikes = 0;
        m->wild = 0;
        return;
    }
    m->wild += 1;
    m->spikes = alike ? (m->spikes + 1) : 1;
    if (m->wild == 1) {
        m->doubt[R_RATES] = (m->doubt[R_RATES] * FORGET) + REAL(1.0);
        if (m->doubt[R_RATES] > REAL(3.0)) {
            flag(m, s, R_RATES, FUSED, SPIKES, worst);
        }
    }
    for (int32_t k = 0; k < 3; k++) {
        small = small && (real_abs(m->shift[k] + (m->rates[k] - m->row[k])) < LARGEST_SHIFT);
    }
    if ((m->spikes >= 2) && small) {
        /* Twice the same: an offset that came at once is no motion. It is taken off from now on. */
        for (int32_t k = 0; k < 3; k++) {
            const real_t off = m->rates[k] - m->row[k];

            m->shift[k] += off;
            factors_loosen(m, GYRO + k, (REAL(0.1) * off) * (REAL(0.1) * off));
        }
        m->spikes = 0;
        m->wild = 0;
        flag(m, s, R_RATES, FUSED, JUMPED, worst);
    } else if (m->wild > 8) {
        m->wild = 0;
        return;
    } else {
        /* a spike */
    }
    for (int32_t k = 0; k < 3; k++) {
        m->rates[k] = m->row[k];
    }
}

bool rotor_fits(estimator_t *m, const estimator_settings_t *s, const real_t speed[2])
{
    const real_t flown = (real_t)(m->tick - m->since[R_ACCELERATION]) * s->dt;
    real_t *mean = m->suspect[R_ROTOR]; /* of what the motors' equations are off by */
    real_t worst = REAL(0.0);
    real_t away = REAL(0.0);
    bool led;
    bool off;

    for (int32_t k = 0; k < 2; k++) {
        worst = real_max(worst, real_abs(speed[k] - m->rotor[18 + k]) / s->hover[k]);
        away = real_max(away, real_abs(m->motor_off[k] - mean[k]) / s->hover[k]);
    }
    /* On the floor it is the equations that have to learn. */
    led = (m->mode == FLYING) && (flown > ROTOR_KNOWN_S) && (away > ROTOR_LED);
    off = (m->mode == FLYING) && (worst > ((m->doubt[R_ROTOR] > REAL(0.5)) ? ROTOR_SURE : ROTOR_OFF));
    if (led || off) {
        if (led) {
            m->motor_off[0] = mean[0];
            m->motor_off[1] = mean[1];
        }
        misfits(m, s, R_ROTOR, OFF, worst * s->hover[0]);
    } else {
        const real_t period = s->period[R_ROTOR];
        const real_t share = period / real_max(real_min(flown, ROTOR_MEAN_S), period);

        for (int32_t k = 0; k < 2; k++) {
            mean[k] += share * (m->motor_off[k] - mean[k]);
        }
        fits(m, R_ROTOR);
    }
    return !(led || off);
}

bool voltage_fits(estimator_t *m, const estimator_settings_t *s, real_t off)
{
    bool believed = true;

    if ((real_abs(off) > VOLTS_OFF) && (((real_t)m->tick * s->dt) > REAL(1.0))) {
        misfits(m, s, R_BATTERY, OFF, off);
        believed = false;
    } else {
        fits(m, R_BATTERY);
    }
    return believed;
}

void felt_fits(estimator_t *m, const estimator_settings_t *s, real_t nu, real_t variance, real_t known, int32_t i)
{
    m->drift[i] += REAL(0.1) * (nu - m->drift[i]);
    if (i == 2) {
        real_t worst = REAL(0.0);

        for (int32_t j = 0; j < 3; j++) {
            if (m->drift_sigma[j] > REAL(0.0)) {
                worst = real_max(worst, real_abs(m->drift[j]) / m->drift_sigma[j]);
            }
        }
        if ((m->disowned == 0) && (worst > REAL(6.0))) {
            m->disowned = 1;
        } else if ((m->disowned == 1) && (worst < REAL(2.0))) {
            m->disowned = 0;
        } else {
            /* as before */
        }
        if (m->disowned == 1) {
            flag(m, s, R_ACCELERATION, FAULTY, OFF, m->drift[2]);
        }
    }
    /* The mean of 0.1-weighted blocks keeps 0.1 / (2 - 0.1) of their variance. */
    m->drift_sigma[i] = real_sqrt(((variance * REAL(0.0526)) + known) + REAL(0.04));
}
