/* The mission: states, signals, references, and what is remembered from one step to the next.
 *
 * What it does and why: machine.py, phases.py and state.py of mufly.mission. mission.c hears the user's signals, phases.c
 * is what each state does by itself. All state belongs to the caller. N, E, D; m, s, rad, V. */
#ifndef MUFLY_MISSION_H
#define MUFLY_MISSION_H

#include "avoid.h"
#include "belief.h"
#include "offboard.h"
#include "trajectory.h"
#include "words.h"

#define MISSION_WAYPOINTS 32 /* at most */
#define MISSION_LOG 16       /* latest entries that are kept */

#define SPIN_UP_S REAL(3.0)
#define RAMP_DOWN_TIME_S REAL(1.0)
#define LIFT_OFF_HEIGHT_M REAL(0.02)
#define TIPPING_RATE_RAD_S REAL(0.15)

enum { STATE_INIT, STATE_TAKE_OFF, STATE_HOVER, STATE_WAYPOINT, STATE_OBSTACLE, STATE_LANDING, STATE_RC, STATE_OFFBOARD,
       MISSION_STATE_COUNT };
enum { MOTORS_OFF, MOTORS_SPIN_UP, MOTORS_FLY, MOTORS_RAMP_DOWN, MOTORS_BLIND };
enum { OUTCOME_OPEN, OUTCOME_SUCCEEDED, OUTCOME_FAILED };
enum { AT_END_LAND, AT_END_HOVER, AT_END_RETURN };
enum { REQUEST_ARM, REQUEST_DISARM, REQUEST_TAKE_OFF, REQUEST_START, REQUEST_PAUSE, REQUEST_GO_TO, REQUEST_RETURN, REQUEST_LAND, REQUEST_OFFBOARD,
       REQUEST_STICKS, REQUEST_LOAD, REQUEST_STOP, REQUEST_COUNT };

typedef struct {
    real_t position[3];
    real_t wait_s;
    real_t speed; /* horizontal, on the way there */
    bool has_heading;
    real_t heading; /* on the way there and there */
} waypoint_t;

/* A mission with what has to be known of the vehicle. */
typedef struct {
    int32_t count;
    waypoint_t waypoint[MISSION_WAYPOINTS];
    int32_t at_end;
    bool spline;              /* fly curves, not lines */
    real_t start[2];          /* where it begins, N, E */
    real_t take_off_height;
    real_t take_off_wait_s;
    trajectory_limits_t limits;
    real_t touchdown;         /* rate of descent near the floor (m/s) */
    real_t reach, reach_speed; /* a place counts as reached from this near, when slower than this */
    bool avoid, scan;         /* whether it minds obstacles; swings its nose to see them */
    real_t clearance;
    real_t avoid_speed;
    real_t give_up_s;
    real_t nose_offset;       /* of the nose from the way (rad): one beam looks along it */
    real_t low_voltage;
    beam_ring_t ring;
} plan_t;

/* The user's signals at one step; all zero is none. */
typedef struct {
    bool start;
    bool has_first_waypoint;
    int32_t first_waypoint; /* with start: the waypoint (from 0) to fly to first */
    bool has_take_off_height;
    real_t take_off_height; /* to this height, and hold */
    bool pause;
    bool has_waypoint;
    real_t waypoint[3];
    bool has_heading;
    real_t heading;
    bool return_requested, land;
    int32_t stop_reason; /* motors off at once; 0 is no signal, else what the log says */
    bool rc_active;
    real_t roll, pitch, yaw_rate, climb_rate; /* of the pilot */
    bool has_program_set_point;
    set_point_t program_set_point;
} command_t;

/* What the controllers have to follow. */
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

/* What it follows: nothing, a trajectory, or a braking. */
typedef struct {
    int32_t kind;
    trajectory_t way;
    braking_motion_t brake;
} course_t;

typedef struct {
    int32_t state;
    real_t time_s, state_entered_s, motion_clock_s, step_duration_s;
    int32_t motors;
    int32_t waypoint_index; /* the waypoint that is flown to or comes next (from 0) */
    int32_t outcome;
    message_t reason;
    bool finished, manual, has_taken_off, mission_begun;
    int32_t reached_count;
    message_t abort_reason; /* why the user broke the mission off; counts once it is down */
    bool returning_home;
    log_entry_t log[MISSION_LOG];
    int32_t logged_count; /* entries so far; the latest is log[(logged - 1) % MISSION_LOG] */
    real_t home_position[3], hold_position[3], goal[3];
    real_t hold_heading;
    course_t course;
    real_t hover_until_s;
    real_t descent_rate, descent_acceleration, still_duration_s, touchdown_speed;
    real_t battery_V, low_battery_duration_s;
    obstacle_map_t obstacle_map;
    int32_t next_beam; /* that is taken next */
    path_check_t path_check; /* what the points mean for where it goes */
    bool has_detour;
    detour_t detour;
    int32_t resume_state;
    real_t detour_duration_s;
    bool resumed_after_detour;
    real_t scan_duration_s;
    bool has_requested_heading;
    real_t requested_heading;
    bool has_set_point_reference;
    trajectory_point_t set_point_reference;
    bool hover_after_take_off;
} mission_t;

/* Before the start signal: on the floor, motors off. */
void initial_mission_state(mission_t *s, const estimate_t *m);

/* Another plan is flown from now on, from its first waypoint when it is started. */
void reset_for_loaded_mission(const plan_t *plan, mission_t *s);

/* One step of the logic, 50 times a second or so. */
void step_mission(const plan_t *plan, mission_t *s, const estimate_t *m, const command_t *command, reference_t *out);

/* Between two steps, in a part (from 1) of parts: beams, and the points that the next step goes by. */
void update_obstacle_map(const plan_t *plan, mission_t *s, const estimate_t *m, int32_t part, int32_t parts);

/* Whether its state lets it do what is asked. height: above where it stood (m). */
bool check_request(int32_t ask, const mission_t *s, real_t height, bool armed, bool flying);

/* Motors off, whatever the state. */
void stop_motors(mission_t *s, const message_t *why);

/* Stop and hover; the mission waits. Go on with it, or with waypoint *first. */
void pause_mission(const plan_t *plan, mission_t *s, const message_t *why);
void resume_mission(const plan_t *plan, mission_t *s, const int32_t *first);

/* Measurements are lost in flight; it cannot go on; by now it has come down. */
void enter_blind_descent(mission_t *s, real_t time_s, const message_t *why);
void fail_and_land(mission_t *s, const message_t *why);
void finish_blind_descent(mission_t *s, real_t time_s);

void log_event(mission_t *s, const message_t *what, int32_t level);

/* Off the floor. */
bool has_lifted_off(const mission_t *s, const estimate_t *m);
/* Whether it turns on its legs, light as it is by now. */
bool is_tipping(const estimate_t *m);

#endif
