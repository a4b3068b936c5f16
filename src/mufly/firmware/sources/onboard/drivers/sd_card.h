/* SD card on SPI (SDHC or SDXC; SD Physical Layer Simplified Specification, chapter 7): identity, capacity, blocks of 512 bytes. No
 * call waits; each ends and begins at most one transfer of the board's bus. A card of version 1 or below 2 GB is refused. */
#ifndef MUFLY_SD_CARD_H
#define MUFLY_SD_CARD_H

#include "hal.h"

#define SD_BYTES 20

/* Begin to exchange bytes with the card. out: NULL sends 0xFF; in: NULL drops what comes. selected: whether the card is selected,
 * during the transfer and after it. The memory belongs to the bus until sd_bus_poll returns another value than BLOCK_BUSY. Functions of
 * the board, with a clock of 400 kHz at most until fast is called for. */
bool sd_bus_begin(bool selected, const uint8_t out[], uint8_t in[], int32_t count);
int32_t sd_bus_poll(void);
void sd_bus_speed(bool fast);

/* Faults: no answer, an error in an answer, an unsupported card, timeout. */
enum { SD_GOOD, SD_SILENT, SD_REFUSES, SD_UNKNOWN, SD_SLOW };

typedef struct {
    int32_t phase;
    int32_t command;        /* of the start: place in its sequence; else of the operation */
    bool is_ready;          /* identity and capacity are known */
    bool is_running;        /* a transfer is under way */
    bool begins;            /* an operation is asked for */
    int32_t result;         /* BLOCK_... of the latest operation */
    int32_t fault;          /* SD_... of the latest failure */
    int32_t tries;
    uint32_t since_us;      /* begin of the present command or wait */
    uint32_t begun_us;      /* begin of the start */
    int32_t blocks;
    bool writes;
    uint32_t argument;
    uint8_t *data;          /* of the operation */
    int32_t size, got;      /* bytes of the data, and those that are here */
    uint8_t frame[SD_BYTES], answer[SD_BYTES];
    uint8_t registers[16];  /* CSD */
} sd_card_t;

void sd_card_start(sd_card_t *c, uint32_t now_us);

/* Advance; call often. */
void sd_card_step(sd_card_t *c, uint32_t now_us);

/* Begin to read or write a block; its result is BLOCK_BUSY until the operation is over. false: busy, not ready, or no such block. */
bool sd_card_begin(sd_card_t *c, int32_t block, uint32_t memory[BLOCK_WORDS], bool writes);

#endif
