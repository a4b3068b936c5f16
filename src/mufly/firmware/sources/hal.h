/* Hardware interface of a board: readings, actuators, clock, log. Only the loop of boards/board.c calls these functions,
 * the flight software does not. */
#ifndef MUFLY_HAL_H
#define MUFLY_HAL_H

#include "estimate/filter/ekf_step.h"
#include "flight/flight_software.h"

/* Readings since the previous period, in sequence at the offsets STARTS of records.h. Readings that are not new are
 * ignored. */
typedef struct {
    real_t z[INPUT_VALUE_COUNT];          /* the loop fills the four actuator inputs of the period (ACTING); the board fills z[CLIPPING], the
                                  three shares of samples at full scale */
    int32_t fresh[SENSOR_COUNT];    /* 0 no new reading, 1 a new reading, 2 a reading that its sensor marks invalid */
    real_t age[SENSOR_COUNT];       /* time since the measurement (s) */
    real_t ranges[MAX_BEAMS]; /* all beams of the ring (m), when fresh[READING_RANGE_RING] is set */
} hal_readings_t;

/* Wait for the next period (1 / mufly_rate_Hz); return the number of periods missed since the last call: the filter makes
 * them up. */
int32_t hal_wait_period(void);

/* Time since power-up (s), monotonic. Single precision resolves periods of 5 ms for some hours; restart the board after
 * that. */
real_t hal_time_s(void);

/* Return all readings since the last call, without waiting. */
void hal_read_sensors(hal_readings_t *readings);

/* Set motor inputs 0..1 (upper, lower) and servo inputs -1..1 at once. The loop calls this at the start of a period, with
 * the inputs that it computed in the period before: the same delay as in the simulation. */
void hal_write_actuators(const actuators_t *out);

/* A command with its arming, from a source that arms by itself; the loop then ignores the supervisor's. */
typedef struct {
    command_t command;
    bool armed;
} hal_command_t;

/* Fill in such a command and return true; a board without such a source (a simulation has one) returns false. */
bool hal_read_command(hal_command_t *out);

/* Take up to most bytes that the link's UART has received; return their number, without waiting. */
int32_t hal_read_bytes(uint8_t *to, int32_t most);

/* Hand bytes to the link's UART; return how many it takes, without waiting. */
int32_t hal_write_bytes(const uint8_t *from, int32_t count);

/* Receiver of a pilot's transmitter, RC_... of onboard/receiver/rc_frames.h: RC_CRSF at 420000 baud, 8N1; RC_SBUS at 100000 baud, 8E2,
 * inverted. */
int32_t hal_rc_kind(void);

/* Take up to most bytes that the receiver's UART has received; return their number, without waiting. */
int32_t hal_read_rc(uint8_t *to, int32_t most);

/* Two sectors of flash for settings (onboard/storage/storage.h). Words in a sector; 0: the board has no such storage. */
int32_t hal_flash_words(void);

/* Word of sector 0 or 1. */
uint32_t hal_flash_read(int32_t sector, int32_t word);

/* Program a word: bits only go from 1 to 0. A word is programmed once between two erases, or again with the value that it
 * reads. Return whether the hardware reports no error. */
bool hal_flash_program(int32_t sector, int32_t word, uint32_t value);

/* Set all bits of a sector to 1. Called on the floor with motors off; may take a second, and resets the watchdog meanwhile. */
bool hal_flash_erase(int32_t sector);

/* Block device of the log (onboard/log/block_log.h): number of blocks; 0: the board has none. A driver of flash erases a sector
 * when its first block is written. */
int32_t hal_block_count(void);

/* Begin to read or write a block of BLOCK_WORDS words, or to make all written blocks last without power; one operation at a time.
 * The memory belongs to the device until hal_block_poll returns another value than BLOCK_BUSY. false: the device refuses. */
#define BLOCK_WORDS 128
bool hal_block_read(int32_t block, uint32_t to[BLOCK_WORDS]);
bool hal_block_write(int32_t block, const uint32_t from[BLOCK_WORDS]);
bool hal_block_flush(void);

/* State of the operation, without waiting. */
enum { BLOCK_DONE, BLOCK_BUSY, BLOCK_ERROR };
int32_t hal_block_poll(void);

/* Reset the watchdog; without a call for 50 ms the hardware stops the motors. */
void hal_feed_watchdog(void);

#endif
