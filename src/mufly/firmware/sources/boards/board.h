/* One vehicle on a board: estimator and flight software, a period at a time. */
#ifndef MUFLY_BOARD_H
#define MUFLY_BOARD_H

#include "hal.h"

typedef struct {
    estimator_t estimator;
    software_t software;
    estimate_t belief;
    actuators_t acting;                /* what acted over the period that has just ended */
    actuators_t sent;
    real_t pictures[3][MAX_BEAMS];   /* the ring's last three */
    uint32_t fitted;                   /* bits of the sensors that are on board */
    int32_t told;                      /* entries of the log that have been sent down */
} board_t;

/* fitted: bits 1 << R_..., of the sensors that are on board. */
void board_start(board_t *b, uint32_t fitted);

/* One period, with what the hardware gives. */
void board_step(board_t *b, hal_readings_t *readings, const command_t *command, real_t time_s, bool armed);

/* For ever. */
void board_run(board_t *b);

#endif
