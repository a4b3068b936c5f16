#include "onboard/link/link_output.h"

#define TEXT_CHUNK 50

static int32_t next_output(int32_t place)
{
    return ((place + 1) < LINK_OUTPUT) ? (place + 1) : 0;
}

bool send_message(link_t *k, mavlink_message_t *m)
{
    uint8_t frame[MAVLINK_FRAME];
    int32_t length;
    bool fits;

    m->system = VEHICLE_SYSTEM;
    m->component = VEHICLE_COMPONENT;
    length = mavlink_encode(m, k->sequence, frame);
    fits = (k->output_count + length) <= LINK_OUTPUT;
    if (fits) {
        int32_t to = (k->output_first + k->output_count) % LINK_OUTPUT;

        for (int32_t i = 0; i < length; i++) {
            k->output[to] = frame[i];
            to = next_output(to);
        }
        k->output_count += length;
        k->sequence = (uint8_t)((k->sequence + 1U) & 0xFFU);
    } else {
        k->dropped++;
    }
    return fits;
}

int32_t link_waiting(const link_t *k, uint8_t *to, int32_t most)
{
    const int32_t count = (k->output_count < most) ? k->output_count : most;
    int32_t from = k->output_first;

    for (int32_t i = 0; i < count; i++) {
        to[i] = k->output[from];
        from = next_output(from);
    }
    return count;
}

void link_sent(link_t *k, int32_t count)
{
    const int32_t taken = (count < k->output_count) ? count : k->output_count;

    k->output_first = (k->output_first + taken) % LINK_OUTPUT;
    k->output_count -= taken;
    k->sent_count = taken;
}

uint32_t to_unsigned_field(real_t value, real_t most, uint32_t unknown)
{
    return ((value >= REAL(0.0)) && (value <= most)) ? (uint32_t)value : unknown;
}

void send_text(link_t *k, const char *text, int32_t length, uint32_t severity)
{
    const int32_t chunks = (length > TEXT_CHUNK) ? 2 : 1;

    k->text_id = (k->text_id % 0xFFFFU) + 1U;
    for (int32_t c = 0; c < chunks; c++) {
        mavlink_message_t m;

        mavlink_begin(&m, MSG_STATUSTEXT, 54);
        mavlink_put(&m, 0, 1, severity);
        for (int32_t i = 0; (i < TEXT_CHUNK) && (((c * TEXT_CHUNK) + i) < length); i++) {
            m.payload[1 + i] = (uint8_t)text[(c * TEXT_CHUNK) + i];
        }
        if (chunks > 1) {
            mavlink_put(&m, 51, 2, k->text_id);
            mavlink_put(&m, 53, 1, (uint32_t)c);
        }
        (void)send_message(k, &m);
    }
}

void send_string(link_t *k, const char *text, uint32_t severity)
{
    int32_t length = 0;

    while (text[length] != '\0') {
        length++;
    }
    send_text(k, text, length, severity);
}
