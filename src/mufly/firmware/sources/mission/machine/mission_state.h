/* Inputs, outputs and memory of the mission state machine: states, signals, references; its log and transitions.
 *
 * Explanation: mission_state.py of mufly.mission. The caller owns all state. N, E, D; m, s, rad, V. */
#ifndef MUFLY_MISSION_STATE_H
#define MUFLY_MISSION_STATE_H

#include "estimate/estimator.h"
#include "mission/avoidance.h"
#include "mission/machine/log_messages.h"
#include "mission/machine/offboard.h"
#include "mission/trajectory.h"

#define MISSION_WAYPOINTS 32 /* most waypoints */
#define MISSION_LOG 16       /* log entries kept */

#define ROTOR_SPIN_UP_TIME_S REAL(3.0)
#define ROTOR_RUN_DOWN_TIME_S REAL(1.0)
#define LIFT_OFF_HEIGHT_M REAL(0.02)
#define TIPPING_RATE_RAD_S REAL(0.15)

enum { STATE_INIT, STATE_TAKE_OFF, STATE_HOVER, STATE_WAYPOINT, STATE_OBSTACLE, STATE_LANDING, STATE_RC, STATE_OFFBOARD,
       MISSION_STATE_COUNT };
enum { MOTORS_OFF, MOTORS_SPIN_UP, MOTORS_FLY, MOTORS_RAMP_DOWN, MOTORS_BLIND };
enum { OUTCOME_OPEN, OUTCOME_SUCCEEDED, OUTCOME_FAILED };
enum { AT_END_LAND, AT_END_HOVER, AT_END_RETURN };

typedef struct {
    real_t position[3];
    real_t wait_s;
    real_t speed; /* horizontal speed of the leg */
    bool has_heading;
    real_t heading; /* heading on the leg and at the waypoint */
} waypoint_t;

/* A mission with the vehicle data that the state machine needs. */
typedef struct {
    int32_t count;
    waypoint_t waypoint[MISSION_WAYPOINTS];
    int32_t at_end;
    bool spline;              /* curves instead of lines */
    real_t start[2];          /* start position, N, E */
    real_t take_off_height;
    real_t take_off_wait_s;
    trajectory_limits_t limits;
    real_t touchdown;         /* descent rate near the floor (m/s) */
    real_t reach, reach_speed; /* distance and speed below which a place counts as reached */
    bool avoid, scan;         /* avoids obstacles; scans for them with its nose */
    real_t clearance;
    real_t avoid_speed;
    real_t give_up_s;
    real_t nose_offset;       /* angle of the nose from the path (rad): one beam points along it */
    real_t low_voltage;
    beam_ring_t beam_ring;
} plan_t;

/* The user's signals at one step; all zero is no signal. */
typedef struct {
    bool start;
    bool has_first_waypoint;
    int32_t first_waypoint; /* with start: the waypoint (from 0) to fly to first */
    bool has_take_off_height;
    real_t take_off_height; /* take-off to this height and hold */
    bool pause;
    bool has_waypoint;
    real_t waypoint[3];
    bool has_heading;
    real_t heading;
    bool return_requested, land;
    int32_t motor_stop_reason; /* stops the motors at once; 0 is no signal, other values are logged */
    bool rc_active;
    real_t pilot_roll, pilot_pitch, pilot_yaw_rate, pilot_climb_rate;
    bool has_program_set_point;
    set_point_t program_set_point;
} command_t;

/* Reference for the controllers. */
typedef struct {
    path_t path;
    real_t heading, heading_rate;
    int32_t motors;
    bool rc_active; /* roll and pitch come from the pilot */
    real_t roll, pitch;
} reference_t;

typedef struct {
    real_t time_s;
    int32_t state, level;
    message_t message;
} log_entry_t;

enum { COURSE_NONE, COURSE_TRAJECTORY, COURSE_STOP };

/* Present motion: none, a trajectory, or a braking. */
typedef struct {
    int32_t kind;
    trajectory_t way;
    braking_motion_t brake;
} course_t;

typedef struct {
    int32_t state;
    real_t time_s, state_entered_s, motion_clock_s, step_duration_s;
    int32_t motors;
    int32_t waypoint_index; /* present or next waypoint (from 0) */
    int32_t outcome;
    message_t reason;
    bool finished, user_in_control, has_taken_off, mission_begun;
    int32_t reached_waypoint_count;
    message_t abort_reason; /* reason for the user's abort; counts after landing */
    bool returning_home;
    log_entry_t log[MISSION_LOG];
    int32_t logged_event_count; /* number of entries; the latest is log[(logged_event_count - 1) % MISSION_LOG] */
    real_t home_position[3], hold_position[3], goal[3];
    real_t hold_heading;
    course_t course;
    real_t hover_until_s;
    real_t descent_rate, descent_acceleration, rest_duration_s, touchdown_speed;
    real_t battery_V, low_battery_duration_s;
    obstacle_map_t obstacle_map;
    int32_t next_beam; /* next beam to be processed */
    path_check_t path_check; /* check of the present path */
    bool has_detour;
    detour_t detour;
    int32_t state_after_detour;
    real_t detour_duration_s;
    bool resumed_after_detour;
    real_t scan_duration_s;
    bool has_requested_heading;
    real_t requested_heading;
    bool has_set_point_reference;
    trajectory_point_t set_point_reference;
    bool hover_after_take_off;
} mission_t;

void copy_vector(const real_t from[3], real_t to[3]);
void zero_vector(real_t out[3]);
real_t distance_between(const real_t a[3], const real_t b[3]);

void log_event(mission_t *s, const message_t *what, int32_t level);
void log_event_as(mission_t *s, int32_t state, const message_t *what, int32_t level);
void enter_state(mission_t *s, int32_t state, const message_t *why, int32_t level);
void enter_hover(mission_t *s, const message_t *why, const real_t at[3], real_t heading, int32_t level);
void fail_mission(mission_t *s, const message_t *why);
void succeed_mission(mission_t *s, int32_t code);

/* Reset all but the log, the clock and the battery. */
void clear_mission(mission_t *s);

/* State before the start signal: on the floor, motors off. */
void initial_mission_state(mission_t *s, const estimate_t *m);

#endif
