#include "onboard/storage/storage.h"

#include <stddef.h>

#define CRC_START 0xFFFFFFFFU
#define BLANK 0xFFFFFFFFU
#define FILLER 0U
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

/* CRC-32, reflected, a byte at a time: 1 kB of flash, half the instructions of four bits at a time. */
static const uint32_t crc_table[256] = {
    0x00000000U, 0x77073096U, 0xEE0E612CU, 0x990951BAU, 0x076DC419U, 0x706AF48FU, 0xE963A535U, 0x9E6495A3U,
    0x0EDB8832U, 0x79DCB8A4U, 0xE0D5E91EU, 0x97D2D988U, 0x09B64C2BU, 0x7EB17CBDU, 0xE7B82D07U, 0x90BF1D91U,
    0x1DB71064U, 0x6AB020F2U, 0xF3B97148U, 0x84BE41DEU, 0x1ADAD47DU, 0x6DDDE4EBU, 0xF4D4B551U, 0x83D385C7U,
    0x136C9856U, 0x646BA8C0U, 0xFD62F97AU, 0x8A65C9ECU, 0x14015C4FU, 0x63066CD9U, 0xFA0F3D63U, 0x8D080DF5U,
    0x3B6E20C8U, 0x4C69105EU, 0xD56041E4U, 0xA2677172U, 0x3C03E4D1U, 0x4B04D447U, 0xD20D85FDU, 0xA50AB56BU,
    0x35B5A8FAU, 0x42B2986CU, 0xDBBBC9D6U, 0xACBCF940U, 0x32D86CE3U, 0x45DF5C75U, 0xDCD60DCFU, 0xABD13D59U,
    0x26D930ACU, 0x51DE003AU, 0xC8D75180U, 0xBFD06116U, 0x21B4F4B5U, 0x56B3C423U, 0xCFBA9599U, 0xB8BDA50FU,
    0x2802B89EU, 0x5F058808U, 0xC60CD9B2U, 0xB10BE924U, 0x2F6F7C87U, 0x58684C11U, 0xC1611DABU, 0xB6662D3DU,
    0x76DC4190U, 0x01DB7106U, 0x98D220BCU, 0xEFD5102AU, 0x71B18589U, 0x06B6B51FU, 0x9FBFE4A5U, 0xE8B8D433U,
    0x7807C9A2U, 0x0F00F934U, 0x9609A88EU, 0xE10E9818U, 0x7F6A0DBBU, 0x086D3D2DU, 0x91646C97U, 0xE6635C01U,
    0x6B6B51F4U, 0x1C6C6162U, 0x856530D8U, 0xF262004EU, 0x6C0695EDU, 0x1B01A57BU, 0x8208F4C1U, 0xF50FC457U,
    0x65B0D9C6U, 0x12B7E950U, 0x8BBEB8EAU, 0xFCB9887CU, 0x62DD1DDFU, 0x15DA2D49U, 0x8CD37CF3U, 0xFBD44C65U,
    0x4DB26158U, 0x3AB551CEU, 0xA3BC0074U, 0xD4BB30E2U, 0x4ADFA541U, 0x3DD895D7U, 0xA4D1C46DU, 0xD3D6F4FBU,
    0x4369E96AU, 0x346ED9FCU, 0xAD678846U, 0xDA60B8D0U, 0x44042D73U, 0x33031DE5U, 0xAA0A4C5FU, 0xDD0D7CC9U,
    0x5005713CU, 0x270241AAU, 0xBE0B1010U, 0xC90C2086U, 0x5768B525U, 0x206F85B3U, 0xB966D409U, 0xCE61E49FU,
    0x5EDEF90EU, 0x29D9C998U, 0xB0D09822U, 0xC7D7A8B4U, 0x59B33D17U, 0x2EB40D81U, 0xB7BD5C3BU, 0xC0BA6CADU,
    0xEDB88320U, 0x9ABFB3B6U, 0x03B6E20CU, 0x74B1D29AU, 0xEAD54739U, 0x9DD277AFU, 0x04DB2615U, 0x73DC1683U,
    0xE3630B12U, 0x94643B84U, 0x0D6D6A3EU, 0x7A6A5AA8U, 0xE40ECF0BU, 0x9309FF9DU, 0x0A00AE27U, 0x7D079EB1U,
    0xF00F9344U, 0x8708A3D2U, 0x1E01F268U, 0x6906C2FEU, 0xF762575DU, 0x806567CBU, 0x196C3671U, 0x6E6B06E7U,
    0xFED41B76U, 0x89D32BE0U, 0x10DA7A5AU, 0x67DD4ACCU, 0xF9B9DF6FU, 0x8EBEEFF9U, 0x17B7BE43U, 0x60B08ED5U,
    0xD6D6A3E8U, 0xA1D1937EU, 0x38D8C2C4U, 0x4FDFF252U, 0xD1BB67F1U, 0xA6BC5767U, 0x3FB506DDU, 0x48B2364BU,
    0xD80D2BDAU, 0xAF0A1B4CU, 0x36034AF6U, 0x41047A60U, 0xDF60EFC3U, 0xA867DF55U, 0x316E8EEFU, 0x4669BE79U,
    0xCB61B38CU, 0xBC66831AU, 0x256FD2A0U, 0x5268E236U, 0xCC0C7795U, 0xBB0B4703U, 0x220216B9U, 0x5505262FU,
    0xC5BA3BBEU, 0xB2BD0B28U, 0x2BB45A92U, 0x5CB36A04U, 0xC2D7FFA7U, 0xB5D0CF31U, 0x2CD99E8BU, 0x5BDEAE1DU,
    0x9B64C2B0U, 0xEC63F226U, 0x756AA39CU, 0x026D930AU, 0x9C0906A9U, 0xEB0E363FU, 0x72076785U, 0x05005713U,
    0x95BF4A82U, 0xE2B87A14U, 0x7BB12BAEU, 0x0CB61B38U, 0x92D28E9BU, 0xE5D5BE0DU, 0x7CDCEFB7U, 0x0BDBDF21U,
    0x86D3D2D4U, 0xF1D4E242U, 0x68DDB3F8U, 0x1FDA836EU, 0x81BE16CDU, 0xF6B9265BU, 0x6FB077E1U, 0x18B74777U,
    0x88085AE6U, 0xFF0F6A70U, 0x66063BCAU, 0x11010B5CU, 0x8F659EFFU, 0xF862AE69U, 0x616BFFD3U, 0x166CCF45U,
    0xA00AE278U, 0xD70DD2EEU, 0x4E048354U, 0x3903B3C2U, 0xA7672661U, 0xD06016F7U, 0x4969474DU, 0x3E6E77DBU,
    0xAED16A4AU, 0xD9D65ADCU, 0x40DF0B66U, 0x37D83BF0U, 0xA9BCAE53U, 0xDEBB9EC5U, 0x47B2CF7FU, 0x30B5FFE9U,
    0xBDBDF21CU, 0xCABAC28AU, 0x53B39330U, 0x24B4A3A6U, 0xBAD03605U, 0xCDD70693U, 0x54DE5729U, 0x23D967BFU,
    0xB3667A2EU, 0xC4614AB8U, 0x5D681B02U, 0x2A6F2B94U, 0xB40BBE37U, 0xC30C8EA1U, 0x5A05DF1BU, 0x2D02EF8DU,
};

static uint32_t add_to_crc(uint32_t crc, uint32_t word)
{
    uint32_t c = crc ^ word;

    for (int32_t i = 0; i < 4; i++) {
        c = (c >> 8U) ^ crc_table[c & 255U];
    }
    return c;
}

uint32_t storage_crc_on(uint32_t before, const uint32_t words[], int32_t count)
{
    uint32_t crc = ~before;

    for (int32_t i = 0; i < count; i++) {
        crc = add_to_crc(crc, words[i]);
    }
    return ~crc;
}

uint32_t storage_crc(const uint32_t words[], int32_t count)
{
    return storage_crc_on(0U, words, count);
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
