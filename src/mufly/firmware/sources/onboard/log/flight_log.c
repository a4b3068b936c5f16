#include "onboard/log/flight_log.h"

#include "onboard/link/text.h"

#define ROWS_PER_S 50
#define MESSAGE_HEAD 3 /* bytes of size and type before each message */
#define ROW_SIZE (MESSAGE_HEAD + 2 + 8 + (4 * LOG_NUMBERS) + 2)
#define TEXT_HEAD (MESSAGE_HEAD + 1 + 8)

/* A message in the making. */
typedef struct {
    uint8_t bytes[ROW_SIZE];
    int32_t count;
} log_message_t;

void flight_log_start(flight_log_t *g)
{
    static const flight_log_t none;

    *g = none;
    block_log_start(&g->device);
}

static void put_unsigned(log_message_t *m, uint32_t value, int32_t size)
{
    uint32_t left = value;

    for (int32_t i = 0; i < size; i++) {
        m->bytes[m->count] = (uint8_t)(left & 0xFFU);
        left >>= 8U;
        m->count++;
    }
}

/* A number in single precision; every processor of these boards holds it so. */
static void put_number(log_message_t *m, real_t value)
{
    const union {
        float number;
        uint32_t bits;
    } packed = {(float)value};

    put_unsigned(m, packed.bits, 4);
}

static void put_numbers(log_message_t *m, const real_t values[], int32_t count)
{
    for (int32_t i = 0; i < count; i++) {
        put_number(m, values[i]);
    }
}

/* Time in microseconds; zero for an invalid time. */
static void put_stamp(log_message_t *m, real_t time_s)
{
    const real_t time = ((time_s > REAL(0.0)) && (time_s < REAL(4e6))) ? time_s : REAL(0.0);
    const uint32_t whole = (uint32_t)time;
    const uint32_t part = (uint32_t)(((time - (real_t)whole) * REAL(1e6)) + REAL(0.5));
    const uint64_t stamp = ((uint64_t)whole * 1000000U) + part;

    put_unsigned(m, (uint32_t)(stamp & 0xFFFFFFFFU), 4);
    put_unsigned(m, (uint32_t)(stamp >> 32U), 4);
}

static void begin_message(log_message_t *m, int32_t size, char kind)
{
    m->count = 0;
    put_unsigned(m, (uint32_t)(size - MESSAGE_HEAD), 2);
    put_unsigned(m, (uint32_t)(uint8_t)kind, 1);
}

static uint32_t time_ms(const flight_log_vehicle_t *v)
{
    const real_t time_s = v->belief->time_s;

    return ((time_s > REAL(0.0)) && (time_s < REAL(4e6))) ? (uint32_t)(time_s * REAL(1000.0)) : 0U;
}

/* Note how long rows were dropped, before the first row that fits again. */
static bool append_dropout(flight_log_t *g, const flight_log_vehicle_t *v)
{
    const uint32_t ms = time_ms(v) - g->dropout_since_ms;
    log_message_t m;

    begin_message(&m, MESSAGE_HEAD + 2, 'O');
    put_unsigned(&m, (ms < 0xFFFFU) ? ms : 0xFFFFU, 2);
    return block_log_append(&g->device, m.bytes, m.count, true);
}

static bool append_row(flight_log_t *g, const flight_log_vehicle_t *v)
{
    const estimate_t *e = v->belief;
    const mission_t *mission = &v->software->mission;
    const reference_t *r = &v->software->reference;
    log_message_t m;

    begin_message(&m, ROW_SIZE, 'D');
    put_unsigned(&m, 0U, 2);
    put_stamp(&m, e->time_s);
    put_numbers(&m, e->motion.position, 3);
    put_numbers(&m, e->motion.velocity, 3);
    put_numbers(&m, e->motion.attitude, 3);
    put_numbers(&m, e->motion.rates, 3);
    put_number(&m, e->valid ? REAL(1.0) : REAL(0.0));
    put_numbers(&m, e->specific_force, 3);
    put_numbers(&m, r->path.position, 3);
    put_numbers(&m, r->path.velocity, 3);
    put_numbers(&m, v->acting->motor_input, 2);
    put_numbers(&m, v->acting->servo_input, 2);
    put_number(&m, e->motion.voltage);
    put_unsigned(&m, (uint32_t)mission->state, 2);
    return block_log_append(&g->device, m.bytes, m.count, true);
}

static void append_row_or_drop(flight_log_t *g, const flight_log_vehicle_t *v)
{
    bool fits = block_log_room(&g->device) > (ROW_SIZE + MESSAGE_HEAD + 2);

    if (fits && (g->dropped_rows != g->told_dropped_rows)) {
        fits = append_dropout(g, v);
        g->told_dropped_rows = g->dropped_rows;
    }
    if (fits) {
        (void)append_row(g, v);
    } else {
        g->dropout_since_ms = (g->dropped_rows == g->told_dropped_rows) ? time_ms(v) : g->dropout_since_ms;
        g->dropped_rows++;
    }
}

/* One entry of the mission's log, when there is room for it; return whether there was one. */
static bool append_text(flight_log_t *g, const flight_log_vehicle_t *v)
{
    const mission_t *x = &v->software->mission;
    uint8_t message[TEXT_HEAD + TEXT_LENGTH];
    char text[TEXT_LENGTH];
    log_message_t m;
    bool is_due = false;
    int32_t length;

    if ((x->logged_event_count - g->texts_written) > MISSION_LOG) {
        g->texts_written = x->logged_event_count - MISSION_LOG;
    }
    if ((g->texts_written < x->logged_event_count) && (block_log_room(&g->device) > (TEXT_HEAD + TEXT_LENGTH))) {
        const log_entry_t *e = &x->log[g->texts_written % MISSION_LOG];
        static const char levels[3] = {'6', '4', '3'}; /* info, warning, error */

        length = write_message_text(&e->message, text);
        begin_message(&m, TEXT_HEAD + length, 'L');
        put_unsigned(&m, (uint32_t)(uint8_t)levels[((e->level >= 0) && (e->level < 3)) ? e->level : 2], 1);
        put_stamp(&m, e->time_s);
        for (int32_t i = 0; i < TEXT_HEAD; i++) {
            message[i] = m.bytes[i];
        }
        for (int32_t i = 0; i < length; i++) {
            message[TEXT_HEAD + i] = (uint8_t)text[i];
        }
        (void)block_log_append(&g->device, message, TEXT_HEAD + length, true);
        g->texts_written++;
        is_due = true;
    }
    return is_due;
}

void flight_log_step(flight_log_t *g, const flight_log_vehicle_t *v)
{
    bool appended = false;

    if (g->device.state != (int32_t)BLOCK_LOG_WRITES) {
        /* nothing can be appended */
    } else if (g->head_written < mufly_log_head_size) {
        const int32_t left = mufly_log_head_size - g->head_written;
        const int32_t part = (left < LOG_HEAD_PART) ? left : LOG_HEAD_PART;

        if (block_log_append(&g->device, &mufly_log_head[g->head_written], part, g->head_written == 0)) {
            g->head_written += part;
        }
    } else {
        appended = append_text(g, v);
        if (g->periods_to_row <= 0) {
            g->periods_to_row = v->armed ? (mufly_rate_Hz / ROWS_PER_S) : mufly_rate_Hz;
            append_row_or_drop(g, v);
            appended = true;
        } else if (v->armed && (g->periods_to_row > (mufly_rate_Hz / ROWS_PER_S))) {
            g->periods_to_row = 0; /* just armed */
        } else {
            /* not yet */
        }
        g->periods_to_row--;
    }
    block_log_step(&g->device, !appended); /* a period either appends or works on the device, to bound its length */
}
