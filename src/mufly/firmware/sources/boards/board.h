/* One vehicle on a board: estimator and flight software, period by period. */
#ifndef MUFLY_BOARD_H
#define MUFLY_BOARD_H

#include "hal.h"

typedef struct {
    estimator_t estimator;
    software_t software;
    estimate_t belief;
    actuators_t acting;                /* actuator inputs of the period that has just ended */
    actuators_t sent;
    real_t pictures[3][MAX_BEAMS];   /* last three readings of the ring (m) */
    uint32_t fitted;                   /* bits of the fitted sensors */
    int32_t told;                      /* number of log entries sent */
} board_t;

/* fitted: bits 1 << R_... of the fitted sensors. */
void board_start(board_t *b, uint32_t fitted);

/* Run one period on the hardware's data. */
void board_step(board_t *b, hal_readings_t *readings, const command_t *command, real_t time_s, bool armed);

/* Run periods without end. */
void board_run(board_t *b);

#endif
