/* Two sectors of flash in memory, with their faults: the power that is cut in the middle of an operation, words and sectors
 * that are worn. Functions hal_flash_... of this machine. */
#ifndef MUFLY_FLASH_MODEL_H
#define MUFLY_FLASH_MODEL_H

#include "real.h"

typedef struct {
    int32_t sector_words;
    uint32_t *words;       /* of both sectors */
    uint32_t *weak;        /* bits of each word that a cut left undecided */
    uint32_t operations;   /* programmed words and erased sectors since the start */
    int32_t cut_after;     /* the power is cut in the operation after so many; negative: never */
    bool is_off;
    uint32_t noise;        /* state of the random generator; not 0 */
    int32_t worn_word;     /* a word, counted over both sectors, of which ... */
    uint32_t worn_bits;    /* ... these bits stay 1 */
    int32_t worn_sector;   /* a sector that an erase leaves as it is; negative: none */
} flash_model_t;

/* The flash of the following calls; NULL: none. */
void flash_model_attach(flash_model_t *flash);

/* Switch the power on: undecided bits read 0 or 1, by chance, until the power is off again. */
void flash_model_start(flash_model_t *flash);

#endif
