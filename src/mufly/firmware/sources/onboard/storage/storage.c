#include "storage.h"

#include <stddef.h>

#define BLANK 0xFFFFFFFFU
#define FILLER 0U
#define CRC_START 0xFFFFFFFFU
#define MOST_COUNT 0xFFFF
#define ERASE_TRIES 2

/* A record to be written. */
typedef struct {
    int32_t kind;
    uint32_t version;
    int32_t count;
    const uint32_t *payload; /* NULL: payload of the sector in use, from this word on */
    int32_t from;
} record_t;

/* CRC-32, reflected, four bits at a time. */
static uint32_t add_to_crc(uint32_t crc, uint32_t word)
{
    static const uint32_t table[16] = {
        0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U, 0x4DB26158U, 0x5005713CU,
        0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU, 0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU,
    };
    uint32_t c = crc ^ word;

    for (int32_t i = 0; i < 8; i++) {
        c = (c >> 4U) ^ table[c & 15U];
    }
    return c;
}

uint32_t storage_crc(const uint32_t words[], int32_t count)
{
    uint32_t crc = CRC_START;

    for (int32_t i = 0; i < count; i++) {
        crc = add_to_crc(crc, words[i]);
    }
    return ~crc;
}

/* Open */

/* Generation of a sector, and the end of the records that it took over; false: its first words are not whole. */
static bool read_header(int32_t sector, uint32_t *generation, uint32_t *taken)
{
    const uint32_t head[STORAGE_HEADER] = {hal_flash_read(sector, 0), hal_flash_read(sector, 1), hal_flash_read(sector, 2),
                                           hal_flash_read(sector, 3), hal_flash_read(sector, 4)};

    *generation = head[2];
    *taken = head[3];
    return (head[0] == STORAGE_MAGIC) && (head[1] == STORAGE_LAYOUT) && (storage_crc(head, 4) == head[4]);
}

static int32_t count_of(const storage_t *s, int32_t at)
{
    return (int32_t)(hal_flash_read(s->active, at) >> 16U);
}

/* Whether a whole record begins at a word of the sector in use. */
static bool is_record(const storage_t *s, int32_t at)
{
    const int32_t last = (at + STORAGE_FRAME + count_of(s, at)) - 1;
    bool good = last < s->words;

    if (good) {
        uint32_t crc = CRC_START;

        for (int32_t i = at; i < last; i++) {
            crc = add_to_crc(crc, hal_flash_read(s->active, i));
        }
        good = (hal_flash_read(s->active, last) == ~crc) && (hal_flash_read(s->active, at + 1) > s->sequence);
    }
    return good;
}

static void find_records(storage_t *s)
{
    bool more = true;

    s->sequence = 0U;
    s->spoilt = false;
    for (int32_t k = 0; k < (int32_t)STORED_KINDS; k++) {
        s->place[k] = 0;
    }
    s->end = STORAGE_HEADER;
    while (more && ((s->end + 1) < s->words)) {
        const uint32_t head = hal_flash_read(s->active, s->end);

        if (head == FILLER) {
            s->end++;
        } else if ((head != BLANK) && is_record(s, s->end)) {
            const uint32_t kind = head & 0xFFU;

            if (kind < (uint32_t)STORED_KINDS) {
                s->place[kind] = s->end;
            }
            s->sequence = hal_flash_read(s->active, s->end + 1);
            s->end += STORAGE_FRAME + (int32_t)(head >> 16U);
        } else {
            more = false;
        }
    }
    for (int32_t i = s->end; i < s->words; i++) {
        s->spoilt = s->spoilt || (hal_flash_read(s->active, i) != BLANK);
    }
}

static bool program_word(storage_t *s, int32_t sector, int32_t at, uint32_t value)
{
    const bool done = hal_flash_program(sector, at, value);
    const bool took = done && (hal_flash_read(sector, at) == value);

    s->bad_words += took ? 0U : 1U;
    return took;
}

/* Write */

static uint32_t payload_word(const storage_t *s, const record_t *r, int32_t i)
{
    return (r->payload != NULL) ? r->payload[i] : hal_flash_read(s->active, r->from + i);
}

/* Write a record with the next sequence; return whether all its words took their values. */
static bool write_record(storage_t *s, int32_t sector, int32_t at, const record_t *r, uint32_t sequence)
{
    const uint32_t head[2] = {(uint32_t)r->kind | (r->version << 8U) | ((uint32_t)r->count << 16U), sequence};
    uint32_t crc = CRC_START;
    bool took = true;

    for (int32_t i = 0; took && (i < 2); i++) {
        crc = add_to_crc(crc, head[i]);
        took = program_word(s, sector, at + i, head[i]);
    }
    for (int32_t i = 0; took && (i < r->count); i++) {
        const uint32_t word = payload_word(s, r, i);

        crc = add_to_crc(crc, word);
        took = program_word(s, sector, at + 2 + i, word);
    }
    if (took) {
        took = program_word(s, sector, at + 2 + r->count, ~crc);
    }
    return took;
}

static bool erase_sector(storage_t *s, int32_t sector)
{
    bool blank = false;

    for (int32_t n = 0; !blank && (n < ERASE_TRIES); n++) {
        blank = hal_flash_erase(sector);
        for (int32_t i = 0; i < s->words; i++) {
            blank = blank && (hal_flash_read(sector, i) == BLANK);
        }
        s->bad_erases += blank ? 0U : 1U;
    }
    return blank;
}

/* The record of another kind that comes next after a word of the sector in use; -1: none. */
static int32_t next_kind(const storage_t *s, int32_t kind, int32_t after)
{
    int32_t next = -1;

    for (int32_t k = 0; k < (int32_t)STORED_KINDS; k++) {
        if ((k != kind) && (s->place[k] > after) && ((next < 0) || (s->place[k] < s->place[next]))) {
            next = k;
        }
    }
    return next;
}

/* Copy the other kinds to the other sector, write the new record (kind -1: none) after them, then the sector's first
 * words. */
static bool hand_over(storage_t *s, const record_t *r)
{
    const int32_t to = (s->active == 0) ? 1 : 0;
    storage_t new = *s;
    uint32_t head[STORAGE_HEADER] = {STORAGE_MAGIC, STORAGE_LAYOUT, s->generation + 1U, 0U, 0U};
    int32_t kind = next_kind(s, r->kind, 0);
    bool took = erase_sector(s, to);

    new.active = to;
    new.end = STORAGE_HEADER;
    new.generation = head[2];
    new.spoilt = false;
    for (int32_t n = 0; took && (n < (int32_t)STORED_KINDS) && (kind >= 0); n++) {
        const int32_t from = s->place[kind];
        const uint32_t version = (hal_flash_read(s->active, from) >> 8U) & 0xFFU;
        const record_t old = {kind, version, count_of(s, from), NULL, from + 2};

        new.sequence++;
        new.place[kind] = new.end;
        took = write_record(s, to, new.end, &old, new.sequence);
        new.end += STORAGE_FRAME + old.count;
        kind = next_kind(s, r->kind, from);
    }
    if (took && (r->kind >= 0)) {
        new.sequence++;
        new.place[r->kind] = new.end;
        took = write_record(s, to, new.end, r, new.sequence);
        new.end += STORAGE_FRAME + r->count;
    }
    head[3] = (uint32_t)new.end;
    head[4] = storage_crc(head, 4);
    for (int32_t i = 0; took && (i < STORAGE_HEADER); i++) {
        took = program_word(s, to, i, head[i]);
    }
    if (took) {
        new.bad_words = s->bad_words;
        new.bad_erases = s->bad_erases;
        *s = new;
    }
    return took;
}

static bool append(storage_t *s, const record_t *r)
{
    const bool took = write_record(s, s->active, s->end, r, s->sequence + 1U);

    if (took) {
        s->sequence++;
        s->place[r->kind] = s->end;
        s->end += STORAGE_FRAME + r->count;
    } else {
        s->spoilt = true;
    }
    return took;
}

/* Use the later of the two sectors that is whole; return which are not. */
static void choose_sector(storage_t *s, bool is_broken[2])
{
    uint32_t generation[2];
    uint32_t taken[2];
    int32_t first;

    for (int32_t i = 0; i < 2; i++) {
        is_broken[i] = !read_header(i, &generation[i], &taken[i]);
    }
    first = (!is_broken[1] && (is_broken[0] || (generation[1] > generation[0]))) ? 1 : 0;
    for (int32_t n = 0; n < 2; n++) {
        const int32_t sector = (n == 0) ? first : (1 - first);

        if (!is_broken[sector] && (s->active < 0)) {
            s->active = sector;
            s->generation = generation[sector];
            find_records(s);
            if ((uint32_t)s->end < taken[sector]) {
                is_broken[sector] = true;
                s->active = -1;
            }
        }
    }
    if (s->active < 0) {
        s->generation = 0U;
        s->sequence = 0U;
        for (int32_t k = 0; k < (int32_t)STORED_KINDS; k++) {
            s->place[k] = 0;
        }
    }
}

void storage_open(storage_t *s)
{
    static const storage_t none;
    static const record_t no_record = {-1, 0U, 0, NULL, 0};
    bool is_broken[2];

    *s = none;
    s->words = hal_flash_words();
    s->active = -1;
    if (s->words > STORAGE_HEADER) {
        choose_sector(s, is_broken);
        for (int32_t i = 0; (s->active >= 0) && (i < s->end); i++) {
            (void)program_word(s, s->active, i, hal_flash_read(s->active, i));
        }
        for (int32_t sector = 0; sector < 2; sector++) {
            bool blank = true;

            for (int32_t i = 0; i < STORAGE_HEADER; i++) {
                blank = blank && (hal_flash_read(sector, i) == BLANK);
            }
            if (is_broken[sector] && !blank) {
                (void)erase_sector(s, sector);
            }
        }
        if (s->active < 0) {
            /* the first record chooses a sector */
        } else if (s->spoilt) {
            (void)hand_over(s, &no_record);
        } else if (s->end < s->words) {
            s->spoilt = !program_word(s, s->active, s->end, FILLER);
            s->end++;
        } else {
            /* full */
        }
    }
}

/* Whether the latest record of all is equal to a new one; an older one has to be written again, since the order counts. */
static bool is_latest(const storage_t *s, const record_t *r)
{
    const int32_t at = s->place[r->kind];
    bool same = (at > 0) && (next_kind(s, r->kind, at) < 0) &&
                (hal_flash_read(s->active, at) == ((uint32_t)r->kind | (r->version << 8U) | ((uint32_t)r->count << 16U)));

    for (int32_t i = 0; same && (i < r->count); i++) {
        same = hal_flash_read(s->active, at + 2 + i) == r->payload[i];
    }
    return same;
}

/* Words that a sector needs for a record and those of the other kinds. */
static int32_t words_needed(const storage_t *s, const record_t *r)
{
    int32_t needed = STORAGE_HEADER + STORAGE_FRAME + r->count;

    for (int32_t k = 0; k < (int32_t)STORED_KINDS; k++) {
        if ((k != r->kind) && (s->place[k] > 0)) {
            needed += STORAGE_FRAME + count_of(s, s->place[k]);
        }
    }
    return needed;
}

int32_t storage_write(storage_t *s, int32_t kind, uint32_t version, const uint32_t payload[], int32_t count)
{
    const record_t r = {kind, version & 0xFFU, count, payload, 0};
    int32_t answer = STORAGE_DONE;

    if (s->words <= STORAGE_HEADER) {
        answer = STORAGE_ABSENT;
    } else if ((count < 0) || (count > MOST_COUNT) || (words_needed(s, &r) > s->words)) {
        answer = STORAGE_TOO_LARGE;
    } else if (is_latest(s, &r)) {
        /* as it is */
    } else {
        const int32_t room = s->words - s->end;
        bool took = false;

        if ((s->active >= 0) && !s->spoilt && (room >= (STORAGE_FRAME + count))) {
            took = append(s, &r);
        }
        if (!took) {
            took = hand_over(s, &r);
        }
        answer = took ? STORAGE_DONE : STORAGE_WORN;
    }
    return answer;
}

int32_t storage_read(const storage_t *s, int32_t kind, uint32_t version, uint32_t payload[], int32_t most)
{
    const int32_t at = s->place[kind];
    int32_t count = -1;

    if ((at > 0) && (((hal_flash_read(s->active, at) >> 8U) & 0xFFU) == version) && (count_of(s, at) <= most)) {
        count = count_of(s, at);
        for (int32_t i = 0; i < count; i++) {
            payload[i] = hal_flash_read(s->active, at + 2 + i);
        }
    }
    return count;
}
