/* Log of flights in ULog (docs.px4.io, "ULog File Format"): one topic with the signals of mufly's recordings, and the entries of the
 * mission's log as text. With the vehicle armed 50 rows a second, otherwise one. */
#ifndef MUFLY_FLIGHT_LOG_H
#define MUFLY_FLIGHT_LOG_H

#include "onboard/log/block_log.h"

#define LOG_HEAD_PART 96 /* bytes of the definitions in a period */

/* Begin of a log, made by plan_tables.py of mufly.firmware: header, definitions, subscription of topic 0. */
extern const uint8_t mufly_log_head[];
extern const int32_t mufly_log_head_size;

/* Numbers of a row after its time, in the order of the definitions. */
#define LOG_NUMBERS 27

typedef struct {
    block_log_t device;
    int32_t head_written;      /* bytes of the definitions */
    int32_t periods_to_row;
    int32_t texts_written;     /* entries of the mission's log */
    uint32_t dropped_rows, told_dropped_rows;
    uint32_t dropout_since_ms; /* time of the first row dropped since the last that was written */
} flight_log_t;

typedef struct {
    const estimate_t *belief;
    const software_t *software;
    const actuators_t *acting; /* inputs in the period that has just ended */
    bool armed;
} flight_log_vehicle_t;

void flight_log_start(flight_log_t *g);

/* Append what is due, and advance the device. Call once a period. */
void flight_log_step(flight_log_t *g, const flight_log_vehicle_t *v);

#endif
