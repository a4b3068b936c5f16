/* MAVLink 2 frames: a parser fed byte by byte, and an encoder. A codec of our own: the headers of pymavlink's generator are
 * 6 MB of code for all messages, with copies of packed structs, and are not MISRA-clean; this vehicle needs 24 messages.
 * https://mavlink.io/en/guide/serialization.html */
#ifndef MUFLY_MAVLINK_H
#define MUFLY_MAVLINK_H

#include "real.h"

#define MAVLINK_PAYLOAD 64 /* bytes of a message that are kept: more than any message below has */
#define MAVLINK_FRAME 280 /* largest frame, without a signature */

#define MSG_HEARTBEAT 0U
#define MSG_SYS_STATUS 1U
#define MSG_PARAM_REQUEST_READ 20U
#define MSG_PARAM_REQUEST_LIST 21U
#define MSG_PARAM_VALUE 22U
#define MSG_PARAM_SET 23U
#define MSG_ATTITUDE 30U
#define MSG_LOCAL_POSITION_NED 32U
#define MSG_MISSION_CURRENT 42U
#define MSG_MISSION_REQUEST_LIST 43U
#define MSG_MISSION_COUNT 44U
#define MSG_MISSION_CLEAR_ALL 45U
#define MSG_MISSION_ACK 47U
#define MSG_MISSION_REQUEST_INT 51U
#define MSG_MANUAL_CONTROL 69U
#define MSG_MISSION_ITEM_INT 73U
#define MSG_COMMAND_INT 75U
#define MSG_COMMAND_LONG 76U
#define MSG_COMMAND_ACK 77U
#define MSG_SET_POSITION_TARGET_LOCAL_NED 84U
#define MSG_BATTERY_STATUS 147U
#define MSG_AUTOPILOT_VERSION 148U
#define MSG_ESTIMATOR_STATUS 230U
#define MSG_EXTENDED_SYS_STATE 245U
#define MSG_STATUSTEXT 253U

typedef struct {
    uint8_t system, component;
    uint32_t message;
    int32_t length;
    uint8_t payload[MAVLINK_PAYLOAD]; /* of a received message zero beyond length */
} mavlink_message_t;

typedef struct {
    int32_t position; /* bytes of the present frame */
    int32_t expected; /* bytes of the whole frame; 0: not known yet */
    uint8_t frame[MAVLINK_FRAME];
    uint32_t bad_count; /* frames with a wrong checksum */
} mavlink_parser_t;

/* Feed one byte; return whether it completes a valid frame of a message above, which is written to *out. */
bool mavlink_parse(mavlink_parser_t *p, uint8_t byte, mavlink_message_t *out);

/* Encode a message; return the number of bytes written to frame. The payload may end in zeros, which are not sent. */
int32_t mavlink_encode(const mavlink_message_t *m, uint8_t sequence, uint8_t frame[MAVLINK_FRAME]);

/* Fields of a payload, at an offset; little-endian. */
uint32_t mavlink_get(const mavlink_message_t *m, int32_t at, int32_t width);
int32_t mavlink_get_int(const mavlink_message_t *m, int32_t at);
real_t mavlink_get_real(const mavlink_message_t *m, int32_t at);
void mavlink_put(mavlink_message_t *m, int32_t at, int32_t width, uint32_t value);
void mavlink_put_real(mavlink_message_t *m, int32_t at, real_t value);

/* Begin a message whose payload has so many bytes. */
void mavlink_begin(mavlink_message_t *m, uint32_t message, int32_t length);

#endif
