/* One vehicle on a board: estimator and flight software, period by period. */
#ifndef MUFLY_BOARD_H
#define MUFLY_BOARD_H

#include "hal.h"

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
} board_t;

/* fitted: bits 1 << R_... of the fitted sensors. */
void board_start(board_t *b, uint32_t fitted);

/* First half of a period: from the readings in b->readings to the estimate in b->belief. */
void board_estimate(board_t *b, real_t time_s);

/* Second half: from the estimate to b->sent, the actuator inputs of the next period; zero unless armed. */
void board_control(board_t *b, const command_t *command, bool armed);

/* Run periods without end. */
void board_run(board_t *b);

#endif
