/* What a board keeps over a reset, in memory that its start-up code does not clear (section .noinit): whether the motors ran,
 * and why the processor stopped. A checksum tells kept contents from those of a power-up. */
#ifndef MUFLY_FAULT_RECORD_H
#define MUFLY_FAULT_RECORD_H

#include "real.h"

/* Causes of a reset, from the processor's reset status register. A brown-out counts as RESET_BY_BROWN_OUT. */
enum { RESET_BY_POWER, RESET_BY_BROWN_OUT, RESET_BY_WATCHDOG, RESET_BY_SOFTWARE, RESET_BY_PIN };

/* Kinds of a start. */
enum { RESTART_COLD, RESTART_ON_FLOOR, RESTART_IN_FLIGHT };

typedef struct {
    uint32_t magic;
    uint32_t restarts;      /* since power-up */
    uint32_t in_flight;     /* of these with running motors */
    uint32_t cause;         /* RESET_BY_... of the latest */
    uint32_t motors_ran;    /* whether the motors ran in the last period */
    uint32_t state;         /* STATE_... of that period */
    uint32_t time_ms;       /* of that period, since the start before */
    uint32_t fault_address; /* program counter of a processor fault; 0: none */
    uint32_t fault_status;  /* fault status register */
    uint32_t checksum;
} fault_record_t;

/* Judge the kept memory after a reset, and prepare it for the next one. Return RESTART_...; the record keeps state, time and
 * fault of the run before. */
int32_t fault_record_begin(fault_record_t *r, uint32_t cause);

/* Record a period. */
void fault_record_update(fault_record_t *r, bool motors_run, int32_t state, real_t time_s);

/* Record a processor fault; the handler then resets the processor. */
void fault_record_fault(fault_record_t *r, uint32_t address, uint32_t status);

#endif
