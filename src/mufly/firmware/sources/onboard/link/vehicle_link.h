/* The vehicle's end of a MAVLink: telemetry, commands with their answers, parameters, missions. One station commands. Bytes
 * come in and go out through buffers of fixed size; nothing waits. */
#ifndef MUFLY_VEHICLE_LINK_H
#define MUFLY_VEHICLE_LINK_H

#include "estimate/filter/ekf_step.h"
#include "onboard/link/mavlink.h"
#include "onboard/storage/settings.h"
#include "onboard/supervisor/supervisor.h"

#define LINK_INPUT 64   /* bytes taken in a period */
#define LINK_OUTPUT 1024 /* bytes waiting to be sent */
#define LINK_STREAMS 8
#define LINK_TEXTS 4 /* commands remembered, to recognise repetitions */

typedef struct {
    uint8_t system, component;
    uint32_t command;
    real_t params[7];
    real_t time_s;
    bool used, accepted;
} link_command_t;

typedef struct {
    mavlink_parser_t parser;
    uint8_t input[LINK_INPUT];   /* bytes of this period */
    int32_t input_count;
    uint8_t output[LINK_OUTPUT]; /* ring */
    int32_t output_first, output_count;
    int32_t sent_count;          /* bytes sent after this period */
    uint32_t dropped;            /* messages for which there was no room */
    uint8_t sequence;
    real_t due_s[LINK_STREAMS];
    bool once[LINK_STREAMS];
    int32_t told;                /* log entries sent as text */
    uint32_t text_id;
    int32_t listed;              /* next parameter of a list */
    bool lists;
    link_command_t last[LINK_TEXTS];
    int32_t next_last;
    uint8_t commander_system, commander_component;
    bool by_hand;                /* a manual mode was requested: MANUAL_CONTROL counts */
    bool tells_faults;           /* a request to arm was refused: its reasons are to be sent as text */
    uint32_t untold_faults;      /* reasons that are not sent yet */
    bool is_heard;               /* whether a station has sent anything yet */
    /* upload of a mission */
    bool loads;
    int32_t load_count, load_next;
    uint8_t load_system, load_component;
    real_t load_asked_s, load_begun_s;
    plan_t loaded;
} link_t;

/* The vehicle behind a link. */
typedef struct {
    supervisor_t *supervisor;
    software_t *software;
    const flight_setup_t *setup;
    plan_t *plan;
    const estimate_t *belief;
    const estimator_t *estimator;
    settings_t *settings;
    rc_settings_t *rc;
    uint32_t *log_faults; /* LOG_... bits; the link clears those that it has sent */
} link_vehicle_t;

void link_start(link_t *k);

/* Handle the bytes of link->input, and queue what is due. Call once a period. */
void link_step(link_t *k, const link_vehicle_t *v);

/* Copy up to most bytes that wait to be sent; link_sent takes away those that were sent. */
int32_t link_waiting(const link_t *k, uint8_t *to, int32_t most);
void link_sent(link_t *k, int32_t count);

#endif
