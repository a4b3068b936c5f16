/* A pilot's transmitter: sticks and switches of a receiver, and what happens when it falls silent. Sticks become the same
 * requests as those of MANUAL_CONTROL and RC_CHANNELS_OVERRIDE (steering_input.py of mufly.link). */
#ifndef MUFLY_RC_H
#define MUFLY_RC_H

#include "onboard/receiver/rc_frames.h"
#include "onboard/supervisor/supervisor.h"

#define RC_INPUT 192 /* bytes taken in a period */
#define RC_SWITCHES 3

enum { RC_SWITCH_ARM, RC_SWITCH_KILL, RC_SWITCH_MANUAL };

/* Numbers of channels from 1; 0: none. */
typedef struct {
    real_t roll, pitch, throttle, yaw;
    real_t switches[RC_SWITCHES]; /* arm, kill, manual */
    real_t loss_s;                /* silence until the receiver counts as lost (s) */
} rc_settings_t;

typedef struct {
    rc_settings_t settings;
    rc_decoder_t decoder;
    uint8_t input[RC_INPUT]; /* bytes of this period */
    int32_t input_count;
    bool was_heard;          /* since the start */
    real_t heard_s;          /* time of the latest frame of a receiver with its transmitter */
    bool is_alive;
    int32_t agreeing[RC_SWITCHES]; /* frames that agree on another position of a switch */
    bool is_on[RC_SWITCHES];
    bool was_off;            /* the arm switch was off since the start: only then does it arm */
    bool steers;             /* sticks are in use */
    bool owes_landing;
    bool tells_faults;       /* a request to arm was refused: reasons are to be sent as text */
} rc_t;

/* The vehicle behind a receiver. */
typedef struct {
    supervisor_t *supervisor;
    const flight_setup_t *setup;
    const software_t *software;
    const estimate_t *belief;
} rc_vehicle_t;

/* Channels in the order roll, pitch, throttle, yaw, arm, manual, kill; lost after 0.5 s. */
void rc_reset_settings(rc_settings_t *s);

/* kind: RC_NONE, RC_CRSF or RC_SBUS. Keeps the settings. */
void rc_start(rc_t *rc, int32_t kind);

/* Handle the bytes in rc->input. Call once a period. */
void rc_step(rc_t *rc, const rc_vehicle_t *v);

/* Deflection beyond a dead band of 3 %, from -1 to 1. */
real_t apply_deadband(real_t value);

#endif
