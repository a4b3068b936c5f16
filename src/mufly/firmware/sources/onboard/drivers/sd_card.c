#include "onboard/drivers/sd_card.h"

#include <stddef.h>

#define ANSWER_FROM 6         /* byte of a command's transfer at which an answer may begin */
#define NO_ANSWER 0x80U
#define IDLE_BIT 1U
#define DATA_TOKEN 0xFEU
#define HIGH_CAPACITY 0x40U   /* CCS and not busy, in the first byte of OCR */
#define WAKE_CLOCKS 10        /* bytes: 80 clocks */
#define MOST_TRIES 5
#define START_US 1000000U     /* ACMD41, after the specification */
#define TOKEN_US 200000U
#define BUSY_US 500000U

enum { WAKES, COMMANDS, FINDS_TOKEN, TAKES_DATA, TAKES_SUM, SENDS_TOKEN, SENDS_DATA, SENDS_SUM, IS_BUSY, RELEASES, RESTS, FAILED };

/* Commands of the start, in this order, and those of the operations. */
enum { GO_IDLE, SEND_IF_COND, APP, APP_OP_COND, READ_OCR, SEND_CSD, READ_BLOCK, WRITE_BLOCK };

static const struct {
    uint8_t number, sum; /* the checksum counts for the first two only */
    uint32_t argument;
} commands[] = {
    {0U, 0x95U, 0U}, {8U, 0x87U, 0x1AAU}, {55U, 1U, 0U}, {41U, 1U, 0x40000000U}, {58U, 1U, 0U}, {9U, 1U, 0U}, {17U, 1U, 0U},
    {24U, 1U, 0U},
};

static void begin_phase(sd_card_t *c, int32_t phase, uint32_t now_us)
{
    c->phase = phase;
    c->since_us = now_us;
}

static void begin_command(sd_card_t *c, int32_t command, uint32_t argument, uint32_t now_us)
{
    c->command = command;
    c->argument = argument;
    c->tries = 0;
    begin_phase(c, (int32_t)COMMANDS, now_us);
}

void sd_card_start(sd_card_t *c, uint32_t now_us)
{
    static const sd_card_t none;

    *c = none;
    c->begun_us = now_us;
    c->result = (int32_t)BLOCK_ERROR;
    sd_bus_speed(false);
    begin_phase(c, (int32_t)WAKES, now_us);
}

/* End an operation, or the start, after a fault, once the card is deselected. */
static void give_up(sd_card_t *c, int32_t fault, uint32_t now_us)
{
    c->fault = fault;
    begin_phase(c, (int32_t)RELEASES, now_us);
}

static bool starts(const sd_card_t *c)
{
    return c->command <= (int32_t)SEND_CSD;
}

static bool begin_transfer(sd_card_t *c)
{
    int32_t count = SD_BYTES;
    bool selected = true;
    bool begun;

    for (int32_t i = 0; i < SD_BYTES; i++) {
        c->frame[i] = 0xFFU;
    }
    if (c->phase == (int32_t)TAKES_DATA) {
        begun = sd_bus_begin(true, NULL, &c->data[c->got], c->size - c->got);
    } else if (c->phase == (int32_t)SENDS_DATA) {
        begun = sd_bus_begin(true, c->data, NULL, c->size);
    } else {
        if (c->phase == (int32_t)WAKES) {
            count = WAKE_CLOCKS;
            selected = false;
        } else if (c->phase == (int32_t)RELEASES) {
            count = 1; /* the card releases its line a byte after its deselection */
            selected = false;
        } else if (c->phase == (int32_t)COMMANDS) {
            c->frame[0] = (uint8_t)(0x40U | commands[c->command].number);
            for (uint32_t i = 0U; i < 4U; i++) {
                c->frame[1U + i] = (uint8_t)((c->argument >> (24U - (8U * i))) & 0xFFU);
            }
            c->frame[5] = commands[c->command].sum;
        } else if (c->phase == (int32_t)SENDS_TOKEN) {
            c->frame[1] = DATA_TOKEN;
            count = 2;
        } else if (c->phase == (int32_t)TAKES_SUM) {
            count = 2;
        } else {
            /* reads */
        }
        begun = sd_bus_begin(selected, c->frame, c->answer, count);
    }
    return begun;
}

/* Place of the answer's first byte; -1: there is none. */
static int32_t find_answer(const sd_card_t *c)
{
    int32_t at = -1;

    for (int32_t i = ANSWER_FROM; (at < 0) && (i < (ANSWER_FROM + 9)); i++) {
        at = ((c->answer[i] & NO_ANSWER) == 0U) ? i : -1;
    }
    return at;
}

/* Look for the token from this byte of the answer on; what follows it are data. */
static void find_token(sd_card_t *c, int32_t from, uint32_t now_us)
{
    bool found = false;
    bool wrong = false;

    for (int32_t i = from; !wrong && (i < SD_BYTES); i++) {
        if (found && (c->got < c->size)) {
            c->data[c->got] = c->answer[i];
            c->got++;
        } else if (!found && (c->answer[i] == DATA_TOKEN)) {
            found = true;
        } else {
            wrong = !found && (c->answer[i] != 0xFFU);
        }
    }
    if (wrong) {
        give_up(c, (int32_t)SD_REFUSES, now_us);
    } else if (found) {
        begin_phase(c, (int32_t)((c->got < c->size) ? TAKES_DATA : RELEASES), now_us);
    } else if (c->phase != (int32_t)FINDS_TOKEN) {
        begin_phase(c, (int32_t)FINDS_TOKEN, now_us);
    } else if ((now_us - c->since_us) > TOKEN_US) {
        give_up(c, (int32_t)SD_SLOW, now_us);
    } else {
        /* not yet */
    }
}

static void begin_data(sd_card_t *c, uint8_t *data, int32_t size, int32_t from, uint32_t now_us)
{
    c->data = data;
    c->size = size;
    c->got = 0;
    find_token(c, from, now_us);
}

static void conclude_start_command(sd_card_t *c, int32_t at, uint32_t now_us)
{
    const uint8_t answer = c->answer[at];
    const bool wrong = (answer & ~IDLE_BIT) != 0U;

    if (c->command == (int32_t)GO_IDLE) {
        if (answer == IDLE_BIT) {
            begin_command(c, (int32_t)SEND_IF_COND, commands[SEND_IF_COND].argument, now_us);
        } else {
            c->tries++; /* the card may still be busy */
            if (c->tries > MOST_TRIES) {
                give_up(c, (int32_t)SD_REFUSES, now_us);
            }
        }
    } else if (c->command == (int32_t)SEND_IF_COND) {
        if (wrong || (c->answer[at + 3] != 1U) || (c->answer[at + 4] != 0xAAU)) {
            give_up(c, (int32_t)SD_UNKNOWN, now_us);
        } else {
            begin_command(c, (int32_t)APP, 0U, now_us);
        }
    } else if (wrong) {
        give_up(c, (int32_t)SD_REFUSES, now_us);
    } else if (c->command == (int32_t)APP) {
        begin_command(c, (int32_t)APP_OP_COND, commands[APP_OP_COND].argument, now_us);
    } else if (c->command == (int32_t)APP_OP_COND) {
        if (answer == 0U) {
            begin_command(c, (int32_t)READ_OCR, 0U, now_us);
        } else if ((now_us - c->begun_us) > START_US) {
            give_up(c, (int32_t)SD_SLOW, now_us);
        } else {
            begin_command(c, (int32_t)APP, 0U, now_us);
        }
    } else if (c->command == (int32_t)READ_OCR) {
        if ((c->answer[at + 1] & HIGH_CAPACITY) == 0U) {
            give_up(c, (int32_t)SD_UNKNOWN, now_us);
        } else {
            begin_command(c, (int32_t)SEND_CSD, 0U, now_us);
        }
    } else {
        begin_data(c, c->registers, 16, at + 1, now_us);
    }
}

static void conclude_command(sd_card_t *c, uint32_t now_us)
{
    const int32_t at = find_answer(c);

    if (at < 0) {
        c->tries++;
        if (!starts(c) || (c->tries > MOST_TRIES)) {
            give_up(c, (int32_t)SD_SILENT, now_us);
        }
    } else if (starts(c)) {
        conclude_start_command(c, at, now_us);
    } else if (c->answer[at] != 0U) {
        give_up(c, (int32_t)SD_REFUSES, now_us);
    } else if (c->writes) {
        begin_phase(c, (int32_t)SENDS_TOKEN, now_us);
    } else {
        find_token(c, at + 1, now_us);
    }
}

/* Capacity by CSD version 2: (C_SIZE + 1) * 512 kB; a block's number is at most 2^31. */
static void conclude_start(sd_card_t *c)
{
    const uint32_t size = (((uint32_t)c->registers[7] & 0x3FU) << 16U) | ((uint32_t)c->registers[8] << 8U) | c->registers[9];
    const bool version_2 = (c->registers[0] >> 6U) == 1U;
    const bool plausible = version_2 && (size < 0x1FFFFFU);

    c->blocks = plausible ? (int32_t)((size + 1U) * 1024U) : 0;
    c->is_ready = plausible;
    c->fault = (int32_t)(plausible ? SD_GOOD : SD_UNKNOWN);
    if (plausible) {
        sd_bus_speed(true);
    }
}

static void conclude_release(sd_card_t *c, uint32_t now_us)
{
    const bool done = (c->fault == (int32_t)SD_GOOD);

    if (starts(c) && done) {
        conclude_start(c);
        begin_phase(c, (int32_t)(c->is_ready ? RESTS : FAILED), now_us);
    } else if (starts(c)) {
        begin_phase(c, (int32_t)FAILED, now_us);
    } else {
        c->result = (int32_t)(done ? BLOCK_DONE : BLOCK_ERROR);
        begin_phase(c, (int32_t)RESTS, now_us);
    }
}

/* The data's answer follows their checksum: xxx0sss1, 010 for data that are accepted. */
static void conclude_sum(sd_card_t *c, uint32_t now_us)
{
    uint8_t answer = 0xFFU;

    for (int32_t i = 2; (answer == 0xFFU) && (i < SD_BYTES); i++) {
        answer = c->answer[i];
    }
    if ((answer & 0x1FU) == 5U) {
        begin_phase(c, (int32_t)((c->answer[SD_BYTES - 1] == 0xFFU) ? RELEASES : IS_BUSY), now_us);
    } else {
        give_up(c, (int32_t)((answer == 0xFFU) ? SD_SILENT : SD_REFUSES), now_us);
    }
}

static void conclude_transfer(sd_card_t *c, uint32_t now_us)
{
    switch (c->phase) {
    case WAKES:
        begin_command(c, (int32_t)GO_IDLE, 0U, now_us);
        break;
    case COMMANDS:
        conclude_command(c, now_us);
        break;
    case FINDS_TOKEN:
        find_token(c, 0, now_us);
        break;
    case TAKES_DATA: /* the blocks of a log carry a checksum of their own */
        begin_phase(c, (int32_t)TAKES_SUM, now_us);
        break;
    case TAKES_SUM:
        begin_phase(c, (int32_t)RELEASES, now_us);
        break;
    case SENDS_TOKEN:
        begin_phase(c, (int32_t)SENDS_DATA, now_us);
        break;
    case SENDS_DATA:
        begin_phase(c, (int32_t)SENDS_SUM, now_us);
        break;
    case SENDS_SUM:
        conclude_sum(c, now_us);
        break;
    case IS_BUSY:
        if (c->answer[SD_BYTES - 1] == 0xFFU) {
            begin_phase(c, (int32_t)RELEASES, now_us);
        } else if ((now_us - c->since_us) > BUSY_US) {
            give_up(c, (int32_t)SD_SLOW, now_us);
        } else {
            /* still programming */
        }
        break;
    default:
        conclude_release(c, now_us);
        break;
    }
}

void sd_card_step(sd_card_t *c, uint32_t now_us)
{
    if (c->is_running) {
        const int32_t state = sd_bus_poll();

        if (state != (int32_t)BLOCK_BUSY) {
            c->is_running = false;
            if (state == (int32_t)BLOCK_DONE) {
                conclude_transfer(c, now_us);
            } else if (c->phase == (int32_t)RELEASES) {
                c->fault = (int32_t)SD_SILENT;
                conclude_release(c, now_us);
            } else {
                give_up(c, (int32_t)SD_SILENT, now_us);
            }
        }
    }
    if (c->begins && (c->phase == (int32_t)RESTS)) {
        c->begins = false;
        c->fault = (int32_t)SD_GOOD;
        begin_command(c, (int32_t)(c->writes ? WRITE_BLOCK : READ_BLOCK), c->argument, now_us);
    }
    if (!c->is_running && (c->phase < (int32_t)RESTS)) {
        c->is_running = begin_transfer(c);
    }
}

bool sd_card_begin(sd_card_t *c, int32_t block, uint32_t memory[BLOCK_WORDS], bool writes)
{
    const bool can = c->is_ready && (c->phase == (int32_t)RESTS) && !c->begins && (block >= 0) && (block < c->blocks);

    if (can) {
        c->data = (uint8_t *)memory;
        c->size = BLOCK_WORDS * 4;
        c->got = 0;
        c->argument = (uint32_t)block;
        c->writes = writes;
        c->begins = true;
        c->result = (int32_t)BLOCK_BUSY;
    }
    return can;
}
