/* Records that the simulation and the board on an emulated processor exchange. */
#ifndef MUFLY_EXCHANGE_H
#define MUFLY_EXCHANGE_H

#include "hal.h"

/* Start of a period, to the board. */
typedef struct {
    real_t time_s;
    int32_t missed;
    hal_readings_t readings;
} board_period_t;

/* Answer to the estimate, to the board. */
typedef struct {
    bool is_given; /* whether the simulation commands; otherwise the board's link does */
    hal_command_t given;
} board_request_t;

/* Sizes of records in the image, from the board before its first period: those of the host must be equal. */
typedef struct {
    uint32_t board, period, request, estimator, software;
} board_sizes_t;

/* Take over the new readings of a period, as a board's drivers write them; the others stay. */
void merge_readings(hal_readings_t *to, const hal_readings_t *from);

#endif
