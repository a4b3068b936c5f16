#include "boards/board.h"

#include <stddef.h>

static void set_idle(actuators_t *out)
{
    for (int32_t i = 0; i < 2; i++) {
        out->motor_input[i] = REAL(0.0);
        out->servo_input[i] = REAL(0.0);
    }
}

void board_start(board_t *b, uint32_t fitted, int32_t restart)
{
    estimator_reset(&b->estimator, &mufly_settings);
    software_reset(&mufly_setup, &b->software);
    set_idle(&b->acting);
    set_idle(&b->sent);
    for (int32_t k = 0; k < 3; k++) {
        for (int32_t i = 0; i < MAX_BEAMS; i++) {
            b->pictures[k][i] = mufly_plan.beam_ring.max_range;
        }
    }
    for (int32_t i = 0; i < MAX_BEAMS; i++) {
        b->belief.ranges[i] = mufly_plan.beam_ring.max_range;
    }
    b->fitted = fitted;
    b->period_count = 0;
    b->plan = mufly_plan;
    link_start(&b->link);
    flight_log_start(&b->log);
    supervisor_start(&b->supervisor, &mufly_supervisor,
                     (restart == RESTART_IN_FLIGHT) ? INTERRUPTION_RESET : INTERRUPTION_NONE);
    {
        const tunables_t tunables = {&b->plan, &b->supervisor.settings, &b->settings.calibration, &b->rc.settings};

        rc_start(&b->rc, RC_NONE);
        settings_begin(&b->settings, &tunables);
    }
}

/* Constants of the flight, with the mission as loaded. */
static flight_setup_t present_setup(const board_t *b)
{
    flight_setup_t setup = mufly_setup;

    setup.plan = &b->plan;
    return setup;
}

/* Median of the last three readings of each beam: it removes a single wrong reading. */
static void filter_ranges(board_t *b, const real_t ranges[])
{
    for (int32_t i = 0; i < mufly_plan.beam_ring.count; i++) {
        const real_t a = b->pictures[1][i];
        const real_t m = b->pictures[2][i];
        const real_t c = real_is_finite(ranges[i]) ? ranges[i] : mufly_plan.beam_ring.max_range;

        b->pictures[0][i] = a;
        b->pictures[1][i] = m;
        b->pictures[2][i] = c;
        b->belief.ranges[i] = real_max(real_min(a, m), real_min(real_max(a, m), c));
    }
}

/* Covariance and sensor statuses; the flight software gets them only when the covariance is computed. */
static void publish_status(board_t *b)
{
    const estimator_t *e = &b->estimator;
    estimate_t *m = &b->belief;

    for (int32_t i = 0; i < 3; i++) {
        m->position_variance[i] = e->covariance_output[i][i];
        m->attitude_variance[i] = e->covariance_output[6 + i][6 + i];
    }
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        const bool there = (b->fitted & (1UL << (uint32_t)k)) != 0U;

        m->checks[k].status = there ? e->status[k] : SENSOR_NOT_FITTED;
        m->checks[k].why = e->reason[k];
        m->checks[k].number = e->reason_number[k];
    }
}

static void fill_estimate(board_t *b, bool valid, real_t time_s)
{
    const estimator_t *e = &b->estimator;
    const real_t voltage = b->readings.z[READING_STARTS[READING_BATTERY]];
    estimate_t *m = &b->belief;

    m->time_s = time_s;
    m->valid = valid;
    m->judged = true;
    m->motion.voltage = (voltage > REAL(0.0)) ? voltage : REAL_NAN; /* zero: no reading yet */
    for (int32_t i = 0; i < 3; i++) {
        m->motion.position[i] = e->x_output[i];
        m->motion.velocity[i] = e->x_output[3 + i];
        m->motion.attitude[i] = e->angles_output[i];
        m->motion.rates[i] = e->rates_output[i];
        m->specific_force[i] = b->readings.z[READING_STARTS[READING_ACCELERATION] + i];
    }
}

/* Run one period of the filter on b->readings; return whether its estimate is valid. */
static bool step_filter(board_t *b)
{
    hal_readings_t *r = &b->readings;
    bool valid;

    for (int32_t i = 0; i < 2; i++) {
        r->z[ACTUATOR_START + i] = b->acting.motor_input[i];
        r->z[ACTUATOR_START + 2 + i] = b->acting.servo_input[i];
    }
    valid = estimator_step(&b->estimator, &mufly_settings, &mufly_flight_model, r->z, r->fresh, r->age);
    b->period_count++;
    if ((b->period_count == 1) || ((b->period_count % COVARIANCE_INTERVAL_TICKS) == 0)) {
        publish_status(b);
    }
    return valid;
}

/* Advance the filter by lost periods with the readings of the inertial unit of the period after them. */
static void process_missed_periods(board_t *b, int32_t missed)
{
    const int32_t count = (missed < MAX_MISSED_PERIODS_PER_UPDATE) ? missed : MAX_MISSED_PERIODS_PER_UPDATE;
    hal_readings_t *r = &b->readings;
    real_t z[INPUT_VALUE_COUNT];
    int32_t fresh[SENSOR_COUNT];

    for (int32_t i = 0; i < INPUT_VALUE_COUNT; i++) {
        z[i] = r->z[i];
    }
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        fresh[k] = r->fresh[k];
    }
    for (int32_t n = 0; n < count; n++) {
        for (int32_t k = 0; k < SENSOR_COUNT; k++) {
            r->fresh[k] = (k < READING_SONAR) ? fresh[k] : 0;
        }
        (void)step_filter(b);
        for (int32_t i = 0; i < INPUT_VALUE_COUNT; i++) {
            r->z[i] = z[i];
        }
    }
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        r->fresh[k] = fresh[k];
    }
}

void board_estimate(board_t *b, real_t time_s, int32_t missed)
{
    bool valid;

    calibrate_readings(&b->settings.calibration, &b->readings);
    if (b->readings.fresh[READING_RANGE_RING] == 1) {
        filter_ranges(b, b->readings.ranges);
    }
    if (missed > 0) {
        process_missed_periods(b, missed);
    }
    valid = step_filter(b);
    fill_estimate(b, valid, time_s);
    supervisor_observe(&b->supervisor, &mufly_setup, &b->belief, b->estimator.x_output[NOMINAL_TERRAIN]);
}

void board_control(board_t *b, const hal_command_t *given)
{
    const flight_setup_t setup = present_setup(b);
    supervisor_t *s = &b->supervisor;
    const bool due = b->software.tick == 0;
    command_t command;
    actuators_t out;
    bool armed;

    if (given != NULL) {
        software_step(&setup, &b->software, &b->belief, &given->command, &out);
        armed = given->armed;
    } else {
        supervisor_collect(s, &b->software, &command);
        software_step(&setup, &b->software, &b->belief, &command, &out);
        supervisor_conclude(s, &b->software, due);
        armed = s->armed;
        supervisor_step_link(s, &setup, &b->software, &b->belief);
    }
    b->acting = b->sent;
    b->sent = out;
    if (!armed) {
        set_idle(&b->sent);
    }
    {
        const flight_log_vehicle_t logged = {&b->belief, &b->software, &b->acting, armed};

        flight_log_step(&b->log, &logged);
    }
}

void board_link(board_t *b)
{
    const flight_setup_t setup = present_setup(b);
    const link_vehicle_t vehicle = {&b->supervisor, &b->software, &setup, &b->plan, &b->belief, &b->estimator,
                                    &b->settings, &b->rc.settings, &b->log.device.faults};
    const rc_vehicle_t piloted = {&b->supervisor, &setup, &b->software, &b->belief};

    rc_step(&b->rc, &piloted);
    b->link.tells_faults = b->link.tells_faults || b->rc.tells_faults;
    b->rc.tells_faults = false;
    link_step(&b->link, &vehicle);
}
