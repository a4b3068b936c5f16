#include "onboard/log/block_log.h"

#include "onboard/storage/storage.h"

#define PAYLOAD_BITS 0xFFFFU
#define MAX_BAD_IN_ROW 16     /* more than the blocks of a sector of flash that a cut left half-written */
#define SPARE_PLACES 32       /* a session ends so many places before its own first block, which an erase must not reach */
#define PATIENCE_S 2          /* silence after which the device counts as failed */
#define FLUSHES_PER_S 4       /* while data are written; half as many while more data wait */

#define SUM_WORDS 64          /* words of a checksum in one period, to bound the period's length */

enum { IDLE, READS, SUMS, WRITES, READS_BACK, FLUSHES };

void block_log_start(block_log_t *l)
{
    static const block_log_t none;

    *l = none;
    l->blocks = hal_block_count();
    l->state = (int32_t)((l->blocks >= LEAST_BLOCKS) ? BLOCK_LOG_SEARCHES : BLOCK_LOG_ABSENT);
    l->stride = 2 * MAX_BAD_IN_ROW; /* a search must reach beyond a row of worn blocks */
    while ((l->stride * l->stride) < l->blocks) {
        l->stride *= 2;
    }
}

static void fail(block_log_t *l)
{
    l->state = (int32_t)BLOCK_LOG_FAILED;
    l->faults = LOG_FAILED; /* worn blocks are already reported */
}

static int32_t next_place(const block_log_t *l, int32_t place)
{
    return ((place + 1) < l->blocks) ? (place + 1) : 0;
}

/* Search */

static bool is_whole(const uint32_t block[BLOCK_WORDS])
{
    return (block[0] == BLOCK_MAGIC) && (storage_crc(block, BLOCK_WORDS - 1) == block[BLOCK_WORDS - 1]);
}

static void begin_session(block_log_t *l)
{
    l->state = (int32_t)BLOCK_LOG_WRITES;
    l->place = l->found ? next_place(l, l->newest_place) : 0;
    l->bad_in_row = 0;
    l->session++;
    l->sequence++;
}

/* Every stride-th block first; then, from the latest of them on, block by block until a whole stride brings no later one. */
static void search_on(block_log_t *l, bool was_read)
{
    const bool whole = was_read && is_whole(l->check);

    l->bad_in_row = was_read ? 0 : (l->bad_in_row + 1);
    l->older++;
    if (whole && (!l->found || (l->check[3] > l->sequence))) {
        l->found = true;
        l->newest_place = l->place;
        l->session = l->check[1];
        l->sequence = l->check[3];
        l->older = 0;
    }
    if (l->bad_in_row > MAX_BAD_IN_ROW) {
        fail(l);
    } else if (l->is_fine) {
        l->place = next_place(l, l->place);
        if (l->older >= l->stride) {
            begin_session(l);
        }
    } else if ((l->place + l->stride) < l->blocks) {
        l->place += l->stride;
    } else if (l->found) {
        l->is_fine = true;
        l->older = 0;
        l->place = next_place(l, l->newest_place);
    } else {
        begin_session(l);
    }
}

/* Buffers */

static int32_t filled_buffer(const block_log_t *l)
{
    return (l->first + l->full_count) % BLOCK_BUFFERS;
}

int32_t block_log_room(const block_log_t *l)
{
    return ((BLOCK_BUFFERS - l->full_count) * BLOCK_PAYLOAD) - l->fill;
}

static void clear_buffer(uint32_t buffer[BLOCK_WORDS])
{
    for (int32_t i = 0; i < BLOCK_WORDS; i++) {
        buffer[i] = 0U;
    }
    buffer[4] = BLOCK_NO_START << 16U;
}

static void close_buffer(block_log_t *l)
{
    uint32_t *buffer = l->buffers[filled_buffer(l)];

    buffer[0] = BLOCK_MAGIC;
    buffer[1] = l->session;
    buffer[2] = l->index;
    buffer[4] |= (uint32_t)l->fill;
    l->index++;
    l->full_count++;
    l->fill = 0;
}

bool block_log_append(block_log_t *l, const uint8_t bytes[], int32_t count, bool begins)
{
    const bool fits = (l->state == (int32_t)BLOCK_LOG_WRITES) && (count < block_log_room(l));
    int32_t taken = 0;

    while (fits && (taken < count)) {
        uint32_t *buffer = l->buffers[filled_buffer(l)];
        const int32_t room = BLOCK_PAYLOAD - l->fill;
        const int32_t part = ((count - taken) < room) ? (count - taken) : room;

        if (l->fill == 0) {
            clear_buffer(buffer);
        }
        if (begins && (taken == 0) && ((buffer[4] >> 16U) == BLOCK_NO_START)) {
            buffer[4] = (uint32_t)l->fill << 16U;
        }
        for (int32_t i = 0; i < part; i++) {
            const uint32_t at = (uint32_t)l->fill + (uint32_t)i;

            buffer[(uint32_t)BLOCK_HEADER + (at / 4U)] |= (uint32_t)bytes[taken + i] << (8U * (at % 4U));
        }
        taken += part;
        l->fill += part;
        if (l->fill == BLOCK_PAYLOAD) {
            close_buffer(l);
        }
    }
    l->lost_messages += fits ? 0U : 1U;
    return fits;
}

/* Device */

/* Go on to the next place; if the block at this place holds the oldest buffer, release the buffer. */
static void conclude_block(block_log_t *l, bool holds)
{
    l->place = next_place(l, l->place);
    l->sequence++;
    l->used_places++;
    if (holds) {
        l->first = (l->first + 1) % BLOCK_BUFFERS;
        l->full_count--;
        l->bad_in_row = 0;
    } else {
        l->faults |= (l->bad_blocks == 0U) ? LOG_WORN : 0U;
        l->bad_blocks++;
        l->bad_in_row++;
    }
    if (l->bad_in_row > MAX_BAD_IN_ROW) {
        fail(l);
    } else if (l->used_places >= (l->blocks - SPARE_PLACES)) {
        l->state = (int32_t)BLOCK_LOG_FULL;
        l->faults |= LOG_FILLED;
        l->owes_flush = true;
    } else {
        /* go on */
    }
}

static void conclude_operation(block_log_t *l, bool done)
{
    const int32_t operation = l->operation;

    l->operation = (int32_t)IDLE;
    if (operation == (int32_t)READS) {
        search_on(l, done);
    } else if (operation == (int32_t)WRITES) {
        if (done && hal_block_read(l->place, l->check)) {
            l->operation = (int32_t)READS_BACK;
            l->waited = 0;
        } else {
            conclude_block(l, false);
        }
    } else if (operation == (int32_t)READS_BACK) {
        bool holds = done;

        for (int32_t i = 0; i < BLOCK_WORDS; i++) {
            holds = holds && (l->check[i] == l->buffers[l->first][i]);
        }
        conclude_block(l, holds);
    } else {
        l->bad_in_row += done ? 0 : 1;
    }
}

/* A block takes two periods before its write: one each for half of its checksum. */
static void begin_sum(block_log_t *l)
{
    uint32_t *buffer = l->buffers[l->first];

    buffer[3] = l->sequence;
    l->sum = storage_crc_on(0U, buffer, SUM_WORDS);
    l->operation = (int32_t)SUMS;
}

static void begin_write(block_log_t *l)
{
    uint32_t *buffer = l->buffers[l->first];

    buffer[BLOCK_WORDS - 1] = storage_crc_on(l->sum, &buffer[SUM_WORDS], (BLOCK_WORDS - 1) - SUM_WORDS);
    l->owes_flush = true;
    if (hal_block_write(l->place, buffer)) {
        l->operation = (int32_t)WRITES;
    } else {
        l->operation = (int32_t)IDLE;
        conclude_block(l, false);
    }
}

static void begin_flush(block_log_t *l)
{
    l->since_flush = 0;
    l->owes_flush = false;
    l->is_closed = false;
    if (hal_block_flush()) {
        l->operation = (int32_t)FLUSHES;
    } else {
        l->bad_in_row++;
    }
}

static void begin_operation(block_log_t *l)
{
    const int32_t interval = mufly_rate_Hz / FLUSHES_PER_S;
    const bool due = l->since_flush >= interval;

    l->waited = 0;
    if (due && !l->is_closed && (l->full_count == 0)) {
        if (l->fill > 0) {
            close_buffer(l);
        }
        l->is_closed = (l->full_count > 0) || l->owes_flush;
        l->since_flush = l->is_closed ? l->since_flush : 0; /* nothing to flush */
    }
    if (l->state == (int32_t)BLOCK_LOG_SEARCHES) {
        if (hal_block_read(l->place, l->check)) {
            l->operation = (int32_t)READS;
        } else {
            search_on(l, false);
        }
    } else if (l->owes_flush && ((l->since_flush >= (2 * interval)) || (due && (l->full_count == 0)))) {
        begin_flush(l);
    } else if ((l->full_count > 0) && (l->state == (int32_t)BLOCK_LOG_WRITES)) {
        begin_sum(l);
    } else {
        /* nothing to do */
    }
}

static void work_on_device(block_log_t *l)
{
    if (l->operation == (int32_t)SUMS) {
        begin_write(l);
    } else if (l->operation != (int32_t)IDLE) {
        const int32_t now = hal_block_poll();

        if (now != (int32_t)BLOCK_BUSY) {
            conclude_operation(l, now == (int32_t)BLOCK_DONE);
        } else if (l->waited > (PATIENCE_S * mufly_rate_Hz)) {
            fail(l);
        } else {
            /* wait */
        }
    } else {
        /* idle */
    }
    if ((l->operation == (int32_t)IDLE) && (l->state != (int32_t)BLOCK_LOG_FAILED)) {
        begin_operation(l);
    }
}

void block_log_step(block_log_t *l, bool may_work)
{
    if ((l->state != (int32_t)BLOCK_LOG_ABSENT) && (l->state != (int32_t)BLOCK_LOG_FAILED)) {
        l->since_flush++;
        l->waited++;
        if (may_work) {
            work_on_device(l);
        }
    }
}
