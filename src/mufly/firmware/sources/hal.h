/* What a board has to give: readings in, actuators out, time, words. The flight software calls none of it; the loop of
 * boards/board.c does. */
#ifndef MUFLY_HAL_H
#define MUFLY_HAL_H

#include "ekf_step.h"
#include "software.h"

/* What has come since the period before. Values one after another as STARTS of records.h says; a reading that has not
 * come anew is not looked at. */
typedef struct {
    real_t z[VALUE_COUNT];          /* the four inputs that acted over the period (ACTING) and clipped shares are filled by the loop
                                  and the board: z[CLIPPING], three shares of samples at full scale */
    int32_t fresh[SENSOR_COUNT];    /* 0 nothing new, 1 a new reading, 2 one that says of itself that it is none */
    real_t age[SENSOR_COUNT];       /* since it was measured (s) */
    real_t ranges[MAX_BEAMS]; /* all beams of the ring (m), when fresh[R_RING] is set */
} hal_readings_t;

/* Waits for the next period (1 / mufly_rate_Hz); returns how many were missed since the last call: 0 when in time. */
int32_t hal_wait_period(void);

/* Time since it was switched on (s); it never goes back. In single precision periods of 5 ms are told apart for some hours:
 * the board is to be switched on again after that. */
real_t hal_time_s(void);

/* Everything that the sensors have said since the last call. It does not wait. */
void hal_read_sensors(hal_readings_t *readings);

/* Motor inputs 0..1 (upper, lower), servo inputs -1..1, at once. */
void hal_write_actuators(const actuators_t *out);

/* Signals of a user that came since the last call; all zero where none did. Sticks and set-points are repeated here for
 * as long as they hold, and forgotten a second, or half of one, after they came last. Values are bounded here. */
void hal_read_command(command_t *command);

/* Whether the motors may run: armed by the user, and not disarmed since. */
bool hal_is_armed(void);

/* An entry of the log, to be sent down: numbers, of which the ground makes words. It does not wait. */
void hal_send_log_entry(const log_entry_t *entry);

/* The loop is alive; without this call for 50 ms the board stops the motors by hardware. */
void hal_feed_watchdog(void);

#endif
