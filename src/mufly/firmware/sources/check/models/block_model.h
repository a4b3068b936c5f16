/* A block device in memory, with its faults: a cache that a power cut loses, a block that the cut leaves half-written, blocks that are
 * worn, long writes, refusal, silence. Functions hal_block_... of this machine. */
#ifndef MUFLY_BLOCK_MODEL_H
#define MUFLY_BLOCK_MODEL_H

#include "hal.h"

#define MODEL_CACHE 64 /* blocks that wait for a flush, at most */

typedef struct {
    int32_t blocks;
    uint32_t *words;       /* of all blocks */
    const uint8_t *worn;   /* for each block: 1 keeps its words, 2 reports an error; NULL: none */
    bool caches;           /* blocks last after a flush only */
    uint32_t cached[MODEL_CACHE][BLOCK_WORDS];
    int32_t cached_block[MODEL_CACHE];
    int32_t cached_count;
    int32_t write_polls;   /* polls until a write or a flush ends */
    int32_t polls_left, answer;
    uint32_t operations;   /* writes and flushes since the start */
    int32_t cut_after;     /* the power is cut in the operation after so many; negative: never */
    uint32_t outside;      /* requested operations on blocks that do not exist */
    bool is_off, refuses, is_silent;
    uint32_t noise;        /* state of the random generator; not 0 */
} block_model_t;

/* The device of the following calls; NULL: none. */
void block_model_attach(block_model_t *device);

/* Switch the power on. */
void block_model_start(block_model_t *device);

#endif
