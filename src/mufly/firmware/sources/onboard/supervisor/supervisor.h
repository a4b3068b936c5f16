/* Arming, the user's requests with their timeouts, and the failsafe of a lost link: between a link and the flight software.
 * The twin of Autopilot (autopilot.py of mufly.flight) and of the link failsafe (clients.py of mufly.link), without what
 * needs the map of the surroundings: obstacles, geofence, battery needed for a mission. */
#ifndef MUFLY_SUPERVISOR_H
#define MUFLY_SUPERVISOR_H

#include "flight/flight_software.h"

/* Reasons against arming, as bits. */
#define ARMING_NOT_MEASURED 1U      /* position, velocity, attitude or rates are not finite */
#define ARMING_STALE 2U             /* the clock of the estimate stands still */
#define ARMING_NO_VOLTAGE 4U
#define ARMING_BATTERY_LOW 8U
#define ARMING_NOT_VALID 16U
#define ARMING_TILTED 32U
#define ARMING_MOVED 64U
#define ARMING_INTERRUPTED 128U     /* the last flight was interrupted; the next request acknowledges it */
#define ARMING_CLIMB_STICK 256U
#define ARMING_NOT_STANDING 512U    /* the estimate is at another height above the floor than the standing vehicle */

/* Reasons of an interrupted flight. */
enum { INTERRUPTION_NONE, INTERRUPTION_TIPPED, INTERRUPTION_BLIND, INTERRUPTION_STOPPED, INTERRUPTION_RESET };

/* Reasons in motor_stop_reason of command_t. */
enum { STOP_NONE, STOP_DISARMED, STOP_EMERGENCY };

/* Answers, with the numbers of MAV_RESULT. */
enum { ANSWER_ACCEPTED = 0, ANSWER_REJECTED_FOR_NOW = 1, ANSWER_DENIED = 2 };

enum { USER_ARM, USER_DISARM, USER_START, USER_TAKE_OFF, USER_PAUSE, USER_GO_TO, USER_RETURN, USER_LAND, USER_STICKS,
       USER_RELEASE_STICKS, USER_SET_POINT, USER_OFFBOARD, USER_END_OFFBOARD, USER_REQUESTS };

/* A request of the user; fields that its kind does not name are ignored. */
typedef struct {
    int32_t kind;
    bool force;               /* arm: without checks; disarm: stop the motors in any state */
    bool repeated;            /* arm: repeats an answered request, which acknowledges nothing */
    bool has_first;
    int32_t first;            /* start: the first waypoint, from 0 */
    bool has_height;
    real_t height;            /* take-off: above the floor (m) */
    bool has_position;
    real_t position[3];       /* go to: N, E, D (m) */
    bool has_heading;
    real_t heading;           /* go to: rad */
    real_t roll, pitch, yaw_rate, climb_rate; /* sticks */
    set_point_t set_point;
} user_request_t;

typedef struct {
    real_t stick_tilt, stick_yaw_rate, stick_climb; /* commands at full deflection (rad, rad/s, m/s) */
    real_t link_loss_s, link_land_s;                /* COM_DL_LOSS_T and COM_DL_LAND_T (s) */
    real_t standing_m;                              /* height of the standing vehicle's centre of gravity above the floor (m) */
} supervisor_settings_t;

enum { LINK_HEARD, LINK_HOVER, LINK_LAND };

typedef struct {
    supervisor_settings_t settings;
    real_t now_s, heard_s, stale_s; /* clock, last time of the estimate, time since it advanced */
    real_t floor_m; /* estimated height of the floor (m); NaN: unknown */
    bool begun, ran;
    bool armed;
    real_t armed_s;
    int32_t interruption;
    bool interruption_told;
    command_t pending;
    bool is_pending;
    bool has_sticks;
    command_t sticks;
    real_t sticks_s;
    bool has_set_point, offboard;
    set_point_t set_point;
    real_t set_point_s;
    uint32_t arming_faults; /* of the last request to arm */
    bool has_commander;
    real_t commander_heard_s;
    int32_t link_stage, link_owed;
} supervisor_t;

/* Constants of the exported vehicle: plan.c. */
extern const supervisor_settings_t mufly_supervisor;

/* interruption: reason of an interrupted flight before the start (INTERRUPTION_RESET after a reset in flight). */
void supervisor_start(supervisor_t *s, const supervisor_settings_t *settings, int32_t interruption);

/* Update the clock with the estimate of a period. floor_m: estimated height of the floor (m); NaN: unknown. */
void supervisor_observe(supervisor_t *s, const flight_setup_t *setup, const estimate_t *m, real_t floor_m);

/* Answer a request at once; it takes effect in the next step of the mission logic. */
int32_t supervisor_request(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m,
                           const user_request_t *ask);

/* Reasons against arming now. */
uint32_t supervisor_arming_faults(const supervisor_t *s, const flight_setup_t *setup, const estimate_t *m);

/* Record a sign of life of the commander of the vehicle; the first command makes its sender the commander. */
void supervisor_hear_commander(supervisor_t *s);

/* Hover, then land, when the commander is silent in flight. */
void supervisor_step_link(supervisor_t *s, const flight_setup_t *setup, const software_t *software, const estimate_t *m);

/* Command of this period for the flight software. */
void supervisor_collect(supervisor_t *s, const software_t *software, command_t *out);

/* Disarm after a landing or without a take-off; call after each step of the flight software. due: whether it ran the
 * mission logic. */
void supervisor_conclude(supervisor_t *s, const software_t *software, bool due);

/* Whether the vehicle is off the floor, by its motors, height and speed. */
bool supervisor_in_air(const software_t *software, const estimate_t *m);

#endif
