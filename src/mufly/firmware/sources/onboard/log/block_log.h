/* Append-only log on a block device (SD card, or flash), as a ring: each start of the board appends a session after the
 * latest one, and overwrites the oldest blocks. Nothing waits for the device: a step ends one operation and begins another.
 *
 * A block has 128 words: BLOCK_MAGIC, session, index in the session, sequence of all blocks ever tried, count of payload bytes
 * | offset of the first message that begins in it << 16 (BLOCK_NO_START: none), payload, CRC-32 of all before. Each block is read
 * back; one that does not hold its words is written anew to the next place. A power cut loses at most the bytes that wait in the
 * buffers and what the device holds back between two flushes, 0.5 s. */
#ifndef MUFLY_BLOCK_LOG_H
#define MUFLY_BLOCK_LOG_H

#include "hal.h"

#define BLOCK_MAGIC 0x676F6C6DU
#define BLOCK_HEADER 5   /* words before the payload */
#define BLOCK_PAYLOAD 488 /* bytes */
#define BLOCK_NO_START 0xFFFFU
#define BLOCK_BUFFERS 6
#define LEAST_BLOCKS 64

/* State: no device; the place of the next session is searched for; records are taken; the session fills the device; the
 * device refuses, is worn or does not answer. The last two take no more records. */
#define LOG_FILLED 1U /* faults, as bits */
#define LOG_FAILED 2U
#define LOG_WORN 4U
enum { BLOCK_LOG_ABSENT, BLOCK_LOG_SEARCHES, BLOCK_LOG_WRITES, BLOCK_LOG_FULL, BLOCK_LOG_FAILED };

typedef struct {
    int32_t state, operation;
    int32_t blocks;           /* of the device */
    int32_t place;            /* next block to read or write */
    int32_t waited;           /* periods since the operation began */
    int32_t bad_in_row;
    uint32_t faults;          /* LOG_...: what is not reported yet */
    uint32_t bad_blocks;      /* since the start of the session */
    uint32_t lost_messages;   /* messages without room in the buffers */
    /* search */
    int32_t stride, newest_place;
    int32_t older; /* blocks read since the newest one, one after the other */
    bool found, is_fine;
    /* session */
    uint32_t session, sequence, index;
    int32_t used_places;      /* of the device, by this session */
    uint32_t buffers[BLOCK_BUFFERS][BLOCK_WORDS];
    uint32_t check[BLOCK_WORDS]; /* block that is read */
    uint32_t sum;             /* checksum of the first half of the block to write */
    int32_t first, full_count;  /* full buffers, from the oldest */
    int32_t fill;             /* bytes in the buffer after them */
    int32_t since_flush;      /* periods */
    bool owes_flush, is_closed; /* is_closed: the buffer in use was closed for the flush that is due */
} block_log_t;

void block_log_start(block_log_t *l);

/* Append a message as a whole, if the buffers have room for it; return whether they had. begins: false for bytes that continue the
 * ones before. */
bool block_log_append(block_log_t *l, const uint8_t bytes[], int32_t count, bool begins);

/* Free bytes of the buffers. */
int32_t block_log_room(const block_log_t *l);

/* Count a period; if it may work on the device, end the present operation, if it is over, and begin another. Call once a period. */
void block_log_step(block_log_t *l, bool may_work);

#endif
