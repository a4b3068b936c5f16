#include "board.h"

static void set_idle(actuators_t *out)
{
    for (int32_t i = 0; i < 2; i++) {
        out->motor_input[i] = REAL(0.0);
        out->servo_input[i] = REAL(0.0);
    }
}

void board_start(board_t *b, uint32_t fitted)
{
    estimator_reset(&b->estimator, &mufly_settings);
    software_reset(&mufly_setup, &b->software);
    set_idle(&b->acting);
    set_idle(&b->sent);
    for (int32_t k = 0; k < 3; k++) {
        for (int32_t i = 0; i < MAX_BEAMS; i++) {
            b->pictures[k][i] = mufly_plan.ring.max_range;
        }
    }
    for (int32_t i = 0; i < MAX_BEAMS; i++) {
        b->belief.ranges[i] = mufly_plan.ring.max_range;
    }
    b->fitted = fitted;
    b->told = 0;
}

/* Median of the last three readings of each beam: a spot seen once is noise. */
static void filter_ranges(board_t *b, const real_t ranges[])
{
    for (int32_t i = 0; i < mufly_plan.ring.count; i++) {
        const real_t a = b->pictures[1][i];
        const real_t m = b->pictures[2][i];
        const real_t c = real_is_finite(ranges[i]) ? ranges[i] : mufly_plan.ring.max_range;

        b->pictures[0][i] = a;
        b->pictures[1][i] = m;
        b->pictures[2][i] = c;
        b->belief.ranges[i] = real_max(real_min(a, m), real_min(real_max(a, m), c));
    }
}

static void fill_estimate(board_t *b, bool valid, real_t time_s, real_t voltage)
{
    const estimator_t *e = &b->estimator;
    estimate_t *m = &b->belief;

    m->time_s = time_s;
    m->valid = valid;
    m->judged = true;
    m->motion.voltage = voltage;
    for (int32_t i = 0; i < 3; i++) {
        m->motion.position[i] = e->x_output[i];
        m->motion.velocity[i] = e->x_output[3 + i];
        m->motion.attitude[i] = e->angles_output[i];
        m->motion.rates[i] = e->rates_output[i];
        m->position_variance[i] = e->covariance_output[i][i];
        m->attitude_variance[i] = e->covariance_output[6 + i][6 + i];
    }
    for (int32_t k = 0; k < SENSOR_COUNT; k++) {
        const bool there = (b->fitted & (1UL << (uint32_t)k)) != 0U;

        m->checks[k].status = there ? e->status[k] : SENSOR_NOT_FITTED;
        m->checks[k].why = e->reason[k];
        m->checks[k].number = e->fault_number[k];
    }
}

void board_step(board_t *b, hal_readings_t *readings, const command_t *command, real_t time_s, bool armed)
{
    const real_t voltage = readings->z[READING_STARTS[R_BATTERY]];
    actuators_t out;
    bool valid;

    if (readings->fresh[R_RING] == 1) {
        filter_ranges(b, readings->ranges);
    }
    for (int32_t i = 0; i < 2; i++) {
        readings->z[ACTUATOR_START + i] = b->acting.motor_input[i];
        readings->z[ACTUATOR_START + 2 + i] = b->acting.servo_input[i];
    }
    valid = estimator_step(&b->estimator, &mufly_settings, &mufly_flight_model, readings->z, readings->fresh,
                           readings->age);
    fill_estimate(b, valid, time_s, voltage);
    for (int32_t i = 0; i < 3; i++) {
        b->belief.specific_force[i] = readings->z[READING_STARTS[R_ACCELERATION] + i];
    }
    software_step(&mufly_setup, &b->software, &b->belief, command, &out);
    b->acting = b->sent;
    b->sent = out;
    if (!armed) {
        set_idle(&b->sent);
    }
}

void board_run(board_t *b)
{
    static hal_readings_t readings;
    static command_t command;

    for (;;) {
        (void)hal_wait_period();
        hal_read_sensors(&readings);
        hal_read_command(&command);
        board_step(b, &readings, &command, hal_time_s(), hal_is_armed());
        hal_write_actuators(&b->sent);
        while (b->told < b->software.mission.logged_count) {
            if ((b->software.mission.logged_count - b->told) > MISSION_LOG) {
                b->told = b->software.mission.logged_count - MISSION_LOG; /* older entries are lost */
            }
            hal_send_log_entry(&b->software.mission.log[b->told % MISSION_LOG]);
            b->told++;
        }
        hal_feed_watchdog();
    }
}
