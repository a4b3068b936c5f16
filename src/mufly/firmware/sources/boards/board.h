/* One vehicle on a board: estimator and flight software, period by period. */
#ifndef MUFLY_BOARD_H
#define MUFLY_BOARD_H

#include "hal.h"
#include "onboard/link/vehicle_link.h"
#include "onboard/log/flight_log.h"
#include "onboard/receiver/rc.h"
#include "onboard/storage/fault_record.h"
#include "onboard/storage/settings.h"
#include "onboard/supervisor/supervisor.h"

typedef struct {
    estimator_t estimator;
    software_t software;
    estimate_t belief;
    hal_readings_t readings;
    actuators_t acting;                /* actuator inputs of the period that has just ended */
    actuators_t sent;                  /* actuator inputs of the next period */
    real_t pictures[3][MAX_BEAMS];   /* last three readings of the ring (m) */
    uint32_t fitted;                   /* bits of the fitted sensors */
    int32_t period_count;              /* periods of the estimator */
    supervisor_t supervisor;
    plan_t plan;                       /* the mission as loaded: that of plan.c or of the settings */
    settings_t settings;
    link_t link;
    rc_t rc;
    flight_log_t log;
} board_t;

/* Periods without a feed after which the watchdog stops the processor (50 ms). */
#define MAX_MISSED_PERIODS_PER_UPDATE 10

/* fitted: bits 1 << R_... of the fitted sensors; restart: RESTART_... of fault_record.h. The motors are off, whatever
 * happened before the start; after a restart in flight the first request to arm is refused. Loads the stored settings. */
void board_start(board_t *b, uint32_t fitted, int32_t restart);

/* First half of a period: from the readings in b->readings to the estimate in b->belief. missed: periods lost before it; the
   filter repeats them with the inertial readings of this period, at most MAX_MISSED_PERIODS_PER_UPDATE. */
void board_estimate(board_t *b, real_t time_s, int32_t missed);

/* Second half: from the estimate to b->sent, the actuator inputs of the next period; zero unless armed; appends to the log.
 * given: NULL for the command and arming of the supervisor. */
void board_control(board_t *b, const hal_command_t *given);

/* After both halves: handle the bytes in b->rc.input and b->link.input, and queue telemetry. */
void board_link(board_t *b);

/* Run periods without end; kept: memory that a reset does not clear. */
void board_run(board_t *b, fault_record_t *kept);

#endif
