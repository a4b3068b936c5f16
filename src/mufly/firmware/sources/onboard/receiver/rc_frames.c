#include "onboard/receiver/rc_frames.h"

#define CRSF_SYNC 0xC8U
#define CRSF_SYNC_HANDSET 0xEEU
#define CRSF_LEAST 2  /* type and checksum */
#define CRSF_MOST 62
#define CRSF_LINK_STATISTICS 0x14U
#define CRSF_CHANNELS 0x16U
#define CRSF_POLYNOMIAL 0xD5U
#define SBUS_START 0x0FU
#define SBUS_LENGTH 25
#define SBUS_FLAGS 23
#define SBUS_UNUSED 0xF0U /* flags that no receiver sets */
#define SBUS_FRAME_LOST 4U
#define SBUS_FAILSAFE 8U
#define CHANNEL_BYTES 22

static void unpack_channels(rc_decoder_t *d, int32_t from)
{
    uint32_t bits = 0U;
    uint32_t held = 0U;
    int32_t channel = 0;

    for (int32_t i = 0; i < CHANNEL_BYTES; i++) {
        bits |= (uint32_t)d->frame[from + i] << held;
        held += 8U;
        if (held >= 11U) {
            d->channel[channel] = (int32_t)(bits & 0x7FFU);
            channel++;
            bits >>= 11U;
            held -= 11U;
        }
    }
}

/* CRC-8/DVB-S2 of the bytes from type to payload. */
static uint32_t compute_crc(const rc_decoder_t *d, int32_t end)
{
    uint32_t crc = 0U;

    for (int32_t i = 2; i < end; i++) {
        crc ^= (uint32_t)d->frame[i];
        for (int32_t bit = 0; bit < 8; bit++) {
            crc = ((crc << 1U) ^ (((crc & 0x80U) != 0U) ? CRSF_POLYNOMIAL : 0U)) & 0xFFU;
        }
    }
    return crc;
}

static bool is_start(const rc_decoder_t *d)
{
    const uint32_t first = d->frame[0];
    bool good;

    if (d->kind == (int32_t)RC_SBUS) {
        good = first == SBUS_START;
    } else {
        good = (first == CRSF_SYNC) || (first == CRSF_SYNC_HANDSET);
        if (good && (d->length > 1)) {
            good = (d->frame[1] >= (uint8_t)CRSF_LEAST) && (d->frame[1] <= (uint8_t)CRSF_MOST);
        }
    }
    return good;
}

/* Bytes of the frame that begins here. */
static int32_t expected_length(const rc_decoder_t *d)
{
    int32_t expected = SBUS_LENGTH;

    if (d->kind == (int32_t)RC_CRSF) {
        expected = (d->length > 1) ? (2 + (int32_t)d->frame[1]) : RC_FRAME;
    }
    return expected;
}

/* End bytes: 0x00, or of receivers with telemetry slots 0x04, 0x14, 0x24, 0x34. */
static bool is_sbus_frame(const rc_decoder_t *d)
{
    const uint32_t end = d->frame[SBUS_LENGTH - 1];

    return ((d->frame[SBUS_FLAGS] & SBUS_UNUSED) == 0U) && ((end == 0U) || ((end & 0xCFU) == 4U));
}

/* Read a whole frame; return whether it has channels that count. */
static bool read_frame(rc_decoder_t *d)
{
    bool has_channels = false;

    if (d->kind == (int32_t)RC_SBUS) {
        has_channels = d->follows;
        if (has_channels) {
            unpack_channels(d, 1);
            d->frame_lost = (d->frame[SBUS_FLAGS] & SBUS_FRAME_LOST) != 0U;
            d->failsafe = (d->frame[SBUS_FLAGS] & SBUS_FAILSAFE) != 0U;
        }
        d->follows = true;
    } else if ((d->frame[2] == CRSF_CHANNELS) && (d->frame[1] == (uint8_t)(CHANNEL_BYTES + CRSF_LEAST))) {
        unpack_channels(d, 3);
        has_channels = true;
    } else if ((d->frame[2] == CRSF_LINK_STATISTICS) && (d->frame[1] == (uint8_t)(10 + CRSF_LEAST))) {
        d->failsafe = d->frame[5] == 0U; /* quality of the link from the transmitter (%) */
    } else {
        /* a frame for another purpose */
    }
    return has_channels;
}

/* Drop the first bytes. */
static void drop_bytes(rc_decoder_t *d, int32_t count)
{
    d->length -= count;
    for (int32_t i = 0; i < d->length; i++) {
        d->frame[i] = d->frame[count + i];
    }
}

static void skip_byte(rc_decoder_t *d)
{
    drop_bytes(d, 1);
    d->follows = false;
    d->skipped_count++;
}

bool rc_decode(rc_decoder_t *d, uint8_t byte)
{
    bool complete = false;
    bool more = d->kind != (int32_t)RC_NONE;

    if (more) {
        d->frame[d->length] = byte;
        d->length++;
    }
    while (more && (d->length > 0)) {
        if (!is_start(d)) {
            skip_byte(d);
        } else if (d->length < expected_length(d)) {
            more = false;
        } else {
            const int32_t length = expected_length(d);
            const bool good = (d->kind == (int32_t)RC_SBUS) ? is_sbus_frame(d)
                                                            : (compute_crc(d, length - 1) == (uint32_t)d->frame[length - 1]);

            if (good) {
                const bool has_channels = read_frame(d);

                d->frame_count += has_channels ? 1U : 0U;
                complete = complete || has_channels;
                drop_bytes(d, length);
            } else {
                skip_byte(d); /* the frame may begin at a later byte */
            }
        }
    }
    return complete;
}
