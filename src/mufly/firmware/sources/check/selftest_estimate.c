/* The estimator on a hop that its own flight model makes up, in the middle of a room: it stands, lifts off, hovers. All that
 * it tells is taken into a digest; the last lines tell what a period costs, of flight alone. */
#include "ekf_step.h"
#include "flight_model.h"
#include "made_up.h"
#include "platform.h"

#define PERIODS 2400
#define STANDS 400
#define LINES 40

typedef struct {
    real_t height; /* m, of the legs */
    real_t climb;  /* m/s */
    real_t force;  /* m/s2, along the mast */
    real_t motor[2];
} hop_t;

static void move(hop_t *hop, const estimator_t *m, int32_t k)
{
    const estimator_settings_t *s = &mufly_settings;
    const real_t wanted = REAL(1.0) + ((REAL(0.05) * (REAL(1.0) - hop->height)) - (REAL(0.08) * hop->climb));
    real_t gain;

    for (int32_t i = 0; i < 2; i++) {
        const real_t off = ((wanted * s->hover_speed[i]) - m->rotor_state[RS_SPEED_UPPER + i]) / s->hover_speed[i];

        hop->motor[i] = (k < STANDS) ? REAL(0.0) : real_clip(REAL(0.75) + (REAL(4.0) * off), REAL(0.0), REAL(1.0));
    }
    hop->force = m->rotor_force[cycle(m->tick, MODELLED)][RF_STATIC + 2];
    gain = -hop->force - GRAVITY;
    if ((hop->height <= REAL(0.0)) && (gain < REAL(0.0))) {
        hop->climb = REAL(0.0);
        hop->force = -GRAVITY;
    } else {
        hop->climb += s->dt * gain;
        hop->height += s->dt * hop->climb;
    }
}

/* Distance to the nearest wall of the room along a beam from its middle. */
static real_t wall(const real_t beam[3])
{
    real_t best = mufly_settings.ring_max;

    for (int32_t i = 0; i < 2; i++) {
        if (real_abs(beam[i]) > REAL(0.01)) {
            const real_t plane = mufly_settings.wall_planes[(2 * i) + ((beam[i] > REAL(0.0)) ? 1 : 0)];

            best = real_min(best, plane / beam[i]);
        }
    }
    return best;
}

static bool due(int32_t sensor, int32_t k)
{
    const int32_t every = real_whole((mufly_settings.period[sensor] / mufly_settings.dt) + REAL(0.5));

    return (mufly_settings.fitted[sensor] != 0) && ((k % ((every > 0) ? every : 1)) == 0);
}

static void feel(const hop_t *hop, const estimator_t *m, int32_t k, real_t z[VALUES], int32_t fresh[SENSORS],
                 real_t age[SENSORS])
{
    const estimator_settings_t *s = &mufly_settings;
    const real_t down = -(hop->height + s->ground_clearance);
    real_t voltage;
    real_t current;

    for (int32_t i = 0; i < SENSORS; i++) {
        fresh[i] = due(i, k) ? 1 : 0;
        age[i] = s->latency[i];
    }
    age[R_SONAR] = REAL(0.02);
    for (int32_t i = 0; i < 3; i++) {
        z[STARTS[R_ACCELERATION] + i] = any(REAL(0.1));
        z[STARTS[R_RATES] + i] = any(REAL(0.005));
        z[STARTS[R_MAGNET] + i] = s->earth[i] + any(REAL(1e-7));
        z[STARTS[R_FIX] + i] = any(REAL(0.02));
        z[CLIPPING + i] = REAL(0.0);
    }
    z[2] += hop->force;
    z[STARTS[R_SONAR]] = real_max(s->sonar_min, -down - s->sonar_place[2]) + any(REAL(0.01));
    for (int32_t b = 0; b < BEAMS; b++) {
        z[STARTS[R_RING] + b] = wall(s->beam_direction[b]) + any(REAL(0.02));
    }
    z[STARTS[R_PRESSURE]] = (s->pressure_slope * down) + any(REAL(2.0));
    z[STARTS[R_FIX] + 2] += down;
    z[STARTS[R_FIX] + 3] = any(REAL(0.02));
    battery(m->rotor_state, hop->motor[0], hop->motor[1], &mufly_flight_model, &voltage, &current);
    z[STARTS[R_BATTERY]] = voltage + any(REAL(0.05));
    for (int32_t i = 0; i < 2; i++) {
        z[STARTS[R_ROTOR] + i] = m->rotor_state[RS_SPEED_UPPER + i] + any(REAL(2.0));
        z[ACTING + i] = hop->motor[i];
        z[ACTING + 2 + i] = any(REAL(0.05));
    }
}

int main(void)
{
    static estimator_t m;
    static hop_t hop;
    real_t z[VALUES];
    real_t age[SENSORS];
    int32_t fresh[SENSORS];
    uint64_t digest = DIGEST_START;
    uint32_t spent = 0U;
    uint32_t worst = 0U;
    uint32_t flown = 0U;

    platform_start();
    estimator_reset(&m, &mufly_settings);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;
        uint32_t took;

        move(&hop, &m, k);
        feel(&hop, &m, k, z, fresh, age);
        before = platform_count();
        (void)estimator_step(&m, &mufly_settings, &mufly_flight_model, z, fresh, age);
        took = platform_count() - before;
        if (m.flight_phase == FLYING) {
            flown += 1U;
            spent += took;
            worst = (took > worst) ? took : worst;
        }
        take_all(&digest, m.x_output, STATES);
        take_all(&digest, m.angles_output, 3);
        take_all(&digest, m.sigma_output, ERRORS);
        take_all(&digest, m.innovation, SENSORS);
        if ((k % (PERIODS / LINES)) == 0) {
            platform_say("outputs ", digest);
        }
    }
    platform_say("outputs ", digest);
    platform_say("memory ", sizeof(m));
    platform_say("periods ", flown);
    platform_say("ticks ", spent);
    platform_say("worst ", worst);
    platform_end();
    return 0;
}
