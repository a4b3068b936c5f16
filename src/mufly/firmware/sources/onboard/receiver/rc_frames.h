/* Frames of radio receivers, byte by byte: CRSF and SBUS. Each has 16 channels of 11 bits: 172, 992 and 1811 are the low,
 * middle and high end, of which 992 -+ 800 are 1000 and 2000 us.
 *
 * CRSF (https://github.com/crsf-wg/crsf/wiki): 0xC8 or 0xEE, length of the rest, type, payload, CRC-8 of type and payload.
 * SBUS: 0x0F, 22 bytes of channels, flags, an end byte; no checksum, so a frame is valid only directly after another one. */
#ifndef MUFLY_RC_FRAMES_H
#define MUFLY_RC_FRAMES_H

#include "real.h"

#define RC_FRAME 64 /* largest frame */
#define RC_CHANNELS 16
#define RC_MIDDLE 992

enum { RC_NONE, RC_CRSF, RC_SBUS };

typedef struct {
    int32_t kind;                 /* RC_NONE, RC_CRSF or RC_SBUS */
    uint8_t frame[RC_FRAME];
    int32_t length;               /* bytes of the present frame */
    bool follows;                 /* SBUS: whether the bytes before it were a frame */
    int32_t channel[RC_CHANNELS]; /* of the latest frame with channels */
    bool frame_lost;              /* it repeats older channels: the receiver missed one by radio */
    bool failsafe;                /* the receiver has lost its transmitter */
    uint32_t frame_count, skipped_count; /* frames with channels; bytes that belong to no frame */
} rc_decoder_t;

/* Feed one byte; return whether it completes a frame with channels. */
bool rc_decode(rc_decoder_t *d, uint8_t byte);

#endif
