/* Settings in flash, which survive a power cut at any instant: records appended to one of two sectors.
 *
 * A sector begins with five words: MAGIC, layout, generation, the end of the records that it took over from the other
 * one, CRC-32 of the four. They are programmed last, after those records; a sector without them, or with a record less,
 * counts for nothing. Of two sectors the later generation counts. A record is: kind, version << 8 and count << 16 in one
 * word; sequence; count words; CRC-32 of all before. The latest record of a kind counts. A word of zeros between records is
 * a filler.
 *
 * A programming or an erase that was cut off leaves bits that may read either way at each start. Hence an open programs all
 * words again with what they read, adds a filler or, after half a record, changes sectors, and erases what is neither blank
 * nor in use: what one start has read counts at the next one. */
#ifndef MUFLY_STORAGE_H
#define MUFLY_STORAGE_H

#include "hal.h"

#define STORAGE_MAGIC 0x7566756DU
#define STORAGE_LAYOUT 1U
#define STORAGE_HEADER 5 /* words at the start of a sector */
#define STORAGE_FRAME 3  /* words of a record beside its payload */

enum { STORED_PARAMETERS, STORED_CALIBRATION, STORED_MISSION, STORED_KINDS };

enum { STORAGE_DONE, STORAGE_ABSENT, STORAGE_TOO_LARGE, STORAGE_WORN };

typedef struct {
    int32_t words;                 /* in a sector; 0: no storage */
    int32_t active;                /* sector in use; -1: neither holds anything */
    int32_t end;                   /* first free word of it */
    bool spoilt;                   /* the free words are not blank: the next record goes to the other sector */
    uint32_t generation, sequence; /* of the sector in use, and of the latest record */
    int32_t place[STORED_KINDS];   /* first word of the latest record of each kind; 0: none */
    uint32_t bad_words;            /* words that did not take their value */
    uint32_t bad_erases;           /* erases that left a bit at 0 */
} storage_t;

/* Find the sector in use and its records, and settle what a cut power left undecided. */
void storage_open(storage_t *s);

/* Store a record, which counts once this returns STORAGE_DONE; after anything else the record before counts. One that is
 * equal to the latest of all is not written. kind: STORED_...; version: 0 to 255. */
int32_t storage_write(storage_t *s, int32_t kind, uint32_t version, const uint32_t payload[], int32_t count);

/* Read the latest record of a kind and of this version into at most so many words. Return its count; -1: there is none. */
int32_t storage_read(const storage_t *s, int32_t kind, uint32_t version, uint32_t payload[], int32_t most);

/* CRC-32 (IEEE 802.3) of words, as of their bytes in little-endian order. */
uint32_t storage_crc(const uint32_t words[], int32_t count);

/* The same, going on from the CRC-32 of the words before; 0: there are none. */
uint32_t storage_crc_on(uint32_t before, const uint32_t words[], int32_t count);

#endif
