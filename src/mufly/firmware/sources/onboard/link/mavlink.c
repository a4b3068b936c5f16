#include "onboard/link/mavlink.h"

#define START_OF_FRAME 0xFDU
#define HEADER 10
#define SIGNED 1U
#define SIGNATURE 13

typedef struct {
    uint32_t message;
    uint8_t extra;     /* CRC_EXTRA of the message's definition */
} definition_t;

static const definition_t definitions[] = {
    {MSG_HEARTBEAT, 50U}, {MSG_SYS_STATUS, 124U}, {MSG_PARAM_REQUEST_READ, 214U}, {MSG_PARAM_REQUEST_LIST, 159U},
    {MSG_PARAM_VALUE, 220U}, {MSG_PARAM_SET, 168U}, {MSG_ATTITUDE, 39U}, {MSG_LOCAL_POSITION_NED, 185U},
    {MSG_MISSION_CURRENT, 28U}, {MSG_MISSION_REQUEST_LIST, 132U}, {MSG_MISSION_COUNT, 221U}, {MSG_MISSION_CLEAR_ALL, 232U},
    {MSG_MISSION_ACK, 153U}, {MSG_MISSION_REQUEST_INT, 196U}, {MSG_MANUAL_CONTROL, 243U}, {MSG_MISSION_ITEM_INT, 38U},
    {MSG_COMMAND_INT, 158U}, {MSG_COMMAND_LONG, 152U}, {MSG_COMMAND_ACK, 143U}, {MSG_SET_POSITION_TARGET_LOCAL_NED, 143U},
    {MSG_BATTERY_STATUS, 154U}, {MSG_AUTOPILOT_VERSION, 178U}, {MSG_ESTIMATOR_STATUS, 163U}, {MSG_EXTENDED_SYS_STATE, 130U},
    {MSG_STATUSTEXT, 83U},
};

/* CRC_EXTRA of a message; -1 for an unknown one, whose checksum cannot be checked. */
static int32_t find_extra(uint32_t message)
{
    int32_t extra = -1;

    for (uint32_t i = 0U; i < (sizeof(definitions) / sizeof(definitions[0])); i++) {
        if (definitions[i].message == message) {
            extra = (int32_t)definitions[i].extra;
        }
    }
    return extra;
}

/* CRC-16/MCRF4XX of a frame and of the byte extra after it. */
static uint32_t compute_crc(const uint8_t frame[MAVLINK_FRAME], int32_t count, uint8_t extra)
{
    uint32_t crc = 0xFFFFU;

    for (int32_t i = 1; i <= count; i++) {
        uint32_t t = (uint32_t)((i < count) ? frame[i] : extra) ^ (crc & 0xFFU);

        t = (t ^ (t << 4U)) & 0xFFU;
        crc = (crc >> 8U) ^ (t << 8U) ^ (t << 3U) ^ (t >> 4U);
    }
    return crc;
}

static bool read_frame(mavlink_parser_t *p, mavlink_message_t *out)
{
    const int32_t length = (int32_t)p->frame[1];
    const uint32_t message = (uint32_t)p->frame[7] | ((uint32_t)p->frame[8] << 8U) | ((uint32_t)p->frame[9] << 16U);
    const int32_t extra = find_extra(message);
    const uint32_t sent = (uint32_t)p->frame[HEADER + length] | ((uint32_t)p->frame[HEADER + length + 1] << 8U);
    bool good = false;

    if ((extra >= 0) && ((p->frame[2] & ~SIGNED) == 0U)) {
        good = compute_crc(p->frame, HEADER + length, (uint8_t)extra) == sent;
        p->bad_count += good ? 0U : 1U;
    }
    if (good) {
        const int32_t held = (length < MAVLINK_PAYLOAD) ? length : MAVLINK_PAYLOAD;

        mavlink_begin(out, message, MAVLINK_PAYLOAD);
        out->length = held;
        out->system = p->frame[5];
        out->component = p->frame[6];
        for (int32_t i = 0; i < held; i++) {
            out->payload[i] = p->frame[HEADER + i];
        }
    }
    return good;
}

bool mavlink_parse(mavlink_parser_t *p, uint8_t byte, mavlink_message_t *out)
{
    bool complete = false;

    if ((p->position > 0) || (byte == START_OF_FRAME)) {
        p->frame[p->position] = byte;
        p->position++;
    }
    if (p->position == 3) {
        p->expected = HEADER + (int32_t)p->frame[1] + 2 + (((p->frame[2] & SIGNED) != 0U) ? SIGNATURE : 0);
    }
    if ((p->position >= HEADER) && (p->position >= p->expected)) {
        complete = read_frame(p, out);
        p->position = 0;
        p->expected = 0;
    }
    return complete;
}

int32_t mavlink_encode(const mavlink_message_t *m, uint8_t sequence, uint8_t frame[MAVLINK_FRAME])
{
    int32_t length = m->length;
    uint32_t crc;

    while ((length > 1) && (m->payload[length - 1] == 0U)) {
        length--;
    }
    frame[0] = START_OF_FRAME;
    frame[1] = (uint8_t)length;
    frame[2] = 0U;
    frame[3] = 0U;
    frame[4] = sequence;
    frame[5] = m->system;
    frame[6] = m->component;
    frame[7] = (uint8_t)(m->message & 0xFFU);
    frame[8] = (uint8_t)((m->message >> 8U) & 0xFFU);
    frame[9] = (uint8_t)((m->message >> 16U) & 0xFFU);
    for (int32_t i = 0; i < length; i++) {
        frame[HEADER + i] = m->payload[i];
    }
    crc = compute_crc(frame, HEADER + length, (uint8_t)find_extra(m->message));
    frame[HEADER + length] = (uint8_t)(crc & 0xFFU);
    frame[HEADER + length + 1] = (uint8_t)(crc >> 8U);
    return HEADER + length + 2;
}

void mavlink_begin(mavlink_message_t *m, uint32_t message, int32_t length)
{
    m->system = 1U;
    m->component = 1U;
    m->message = message;
    m->length = length;
    for (int32_t i = 0; i < length; i++) {
        m->payload[i] = 0U;
    }
}

uint32_t mavlink_get(const mavlink_message_t *m, int32_t at, int32_t width)
{
    uint32_t value = 0U;

    for (int32_t i = width - 1; i >= 0; i--) {
        value = (value << 8U) | (uint32_t)m->payload[at + i];
    }
    return value;
}

int32_t mavlink_get_int(const mavlink_message_t *m, int32_t at)
{
    const uint32_t value = mavlink_get(m, at, 4);

    return (value <= 0x7FFFFFFFU) ? (int32_t)value : (-1 - (int32_t)(0xFFFFFFFFU - value));
}

typedef union {
    float number;
    uint32_t bits;
} float_bits_t;

real_t mavlink_get_real(const mavlink_message_t *m, int32_t at)
{
    float_bits_t as;

    as.bits = mavlink_get(m, at, 4);
    return (real_t)as.number;
}

void mavlink_put(mavlink_message_t *m, int32_t at, int32_t width, uint32_t value)
{
    for (int32_t i = 0; i < width; i++) {
        m->payload[at + i] = (uint8_t)((value >> (8U * (uint32_t)i)) & 0xFFU);
    }
}

void mavlink_put_real(mavlink_message_t *m, int32_t at, real_t value)
{
    float_bits_t as;

    as.number = (float)value;
    mavlink_put(m, at, 4, as.bits);
}
