/* Self-test of the estimator on a simulated hop in the middle of a room: stand, lift off, hover. The digest covers all its
 * outputs; the last lines give the cost of a period in flight. */
#include "check/programs/made_up.h"
#include "dynamics/flight_model.h"
#include "estimate/filter/ekf_step.h"

#define PERIODS 2400
#define STANDING_PERIODS 400

typedef struct {
    real_t height; /* height of the legs (m) */
    real_t climb;  /* m/s */
    real_t force;  /* m/s2, along the mast */
    real_t motor[2];
} hop_t;

static void move_along_hop(hop_t *hop, const estimator_t *m, int32_t k)
{
    const estimator_settings_t *s = &mufly_settings;
    const real_t wanted = REAL(1.0) + ((REAL(0.05) * (REAL(1.0) - hop->height)) - (REAL(0.08) * hop->climb));
    real_t gain;

    for (int32_t i = 0; i < 2; i++) {
        const real_t off = ((wanted * s->hover_speed[i]) - m->flight_model_state[MODEL_SPEED_UPPER + i]) / s->hover_speed[i];

        hop->motor[i] = (k < STANDING_PERIODS) ? REAL(0.0) : real_clip(REAL(0.75) + (REAL(4.0) * off), REAL(0.0), REAL(1.0));
    }
    hop->force = m->rotor_model_rows[wrap_index(m->tick, ROTOR_FORCE_HISTORY)][ROTOR_THRUST_ACCEL + 2];
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
static real_t wall_range(const real_t beam[3])
{
    real_t best = mufly_settings.ring_max_range;

    for (int32_t i = 0; i < 2; i++) {
        if (real_abs(beam[i]) > REAL(0.01)) {
            const real_t plane = mufly_settings.wall_planes[(2 * i) + ((beam[i] > REAL(0.0)) ? 1 : 0)];

            best = real_min(best, plane / beam[i]);
        }
    }
    return best;
}

static bool is_due(int32_t sensor, int32_t k)
{
    const int32_t every = real_floor_int((mufly_settings.sensor_period[sensor] / mufly_settings.dt) + REAL(0.5));

    return (mufly_settings.is_fitted[sensor] != 0) && ((k % ((every > 0) ? every : 1)) == 0);
}

static void make_readings(const hop_t *hop, const estimator_t *m, int32_t k, real_t z[INPUT_VALUE_COUNT], int32_t fresh[SENSOR_COUNT],
                 real_t age[SENSOR_COUNT])
{
    const estimator_settings_t *s = &mufly_settings;
    const real_t down = -(hop->height + s->ground_clearance);
    real_t voltage;
    real_t current;

    for (int32_t i = 0; i < SENSOR_COUNT; i++) {
        fresh[i] = is_due(i, k) ? 1 : 0;
        age[i] = s->latency[i];
    }
    age[READING_SONAR] = REAL(0.02);
    for (int32_t i = 0; i < 3; i++) {
        z[READING_STARTS[READING_ACCELERATION] + i] = random_number(REAL(0.1));
        z[READING_STARTS[READING_RATES] + i] = random_number(REAL(0.005));
        z[READING_STARTS[READING_MAGNETIC_FIELD] + i] = s->earth_field[i] + random_number(REAL(1e-7));
        z[READING_STARTS[READING_POSITION_FIX] + i] = random_number(REAL(0.02));
        z[CLIPPING_START + i] = REAL(0.0);
    }
    z[2] += hop->force;
    z[READING_STARTS[READING_SONAR]] = real_max(s->sonar_min_range, -down - s->sonar_position[2]) + random_number(REAL(0.01));
    for (int32_t b = 0; b < MAX_FUSED_BEAMS; b++) {
        z[READING_STARTS[READING_RANGE_RING] + b] = wall_range(s->beam_directions[b]) + random_number(REAL(0.02));
    }
    z[READING_STARTS[READING_PRESSURE]] = (s->pressure_gradient_down * down) + random_number(REAL(2.0));
    z[READING_STARTS[READING_POSITION_FIX] + 2] += down;
    z[READING_STARTS[READING_POSITION_FIX] + 3] = random_number(REAL(0.02));
    compute_battery_supply(m->flight_model_state, hop->motor[0], hop->motor[1], &mufly_flight_model, &voltage, &current);
    z[READING_STARTS[READING_BATTERY]] = voltage + random_number(REAL(0.05));
    for (int32_t i = 0; i < 2; i++) {
        z[READING_STARTS[READING_ROTOR_SPEED] + i] = m->flight_model_state[MODEL_SPEED_UPPER + i] + random_number(REAL(2.0));
        z[ACTUATOR_START + i] = hop->motor[i];
        z[ACTUATOR_START + 2 + i] = random_number(REAL(0.05));
    }
}

int main(void)
{
    static estimator_t m;
    static hop_t hop;
    real_t z[INPUT_VALUE_COUNT];
    real_t age[SENSOR_COUNT];
    int32_t fresh[SENSOR_COUNT];
    uint64_t digest = DIGEST_START;
    cost_t cost = {0U, 0U, 0U};

    platform_start();
    estimator_reset(&m, &mufly_settings);
    for (int32_t k = 0; k < PERIODS; k++) {
        uint32_t before;
        uint32_t took;

        move_along_hop(&hop, &m, k);
        make_readings(&hop, &m, k, z, fresh, age);
        before = platform_count();
        (void)estimator_step(&m, &mufly_settings, &mufly_flight_model, z, fresh, age);
        took = platform_count() - before;
        if (m.flight_phase == PHASE_FLYING) {
            add_cost(&cost, took);
        }
        digest_all(&digest, m.x_output, STATE_COUNT);
        digest_all(&digest, m.angles_output, 3);
        digest_all(&digest, m.sigma_output, ERROR_STATE_COUNT);
        digest_all(&digest, m.innovation, SENSOR_COUNT);
        print_digest(digest, k, PERIODS);
    }
    platform_print("outputs ", digest);
    platform_print("memory ", sizeof(m));
    print_cost(&cost);
    return 0;
}
