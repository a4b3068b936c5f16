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
#define RAMP_DOWN_S REAL(1.0)
#define LIFT_OFF_M REAL(0.02)
#define TIPS_RAD_S REAL(0.15)

enum { STATE_INIT, STATE_TAKE_OFF, STATE_HOVER, STATE_WAYPOINT, STATE_OBSTACLE, STATE_LANDING, STATE_RC, STATE_OFFBOARD,
       STATE_COUNT };
enum { MOTORS_OFF, MOTORS_SPIN_UP, MOTORS_FLY, MOTORS_RAMP_DOWN, MOTORS_BLIND };
enum { OUTCOME_OPEN, OUTCOME_SUCCEEDED, OUTCOME_FAILED };
enum { AT_END_LAND, AT_END_HOVER, AT_END_RETURN };
enum { ASK_ARM, ASK_DISARM, ASK_TAKE_OFF, ASK_START, ASK_PAUSE, ASK_GO_TO, ASK_RETURN, ASK_LAND, ASK_OFFBOARD,
       ASK_STICKS, ASK_LOAD, ASK_STOP, ASK_COUNT };

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
    limits_t limits;
    real_t touchdown;         /* rate of descent near the floor (m/s) */
    real_t reach, reach_speed; /* a place counts as reached from this near, when slower than this */
    bool avoid, scan;         /* whether it minds obstacles; swings its nose to see them */
    real_t clearance;
    real_t avoid_speed;
    real_t give_up_s;
    real_t nose_offset;       /* of the nose from the way (rad): one beam looks along it */
    real_t low_voltage;
    ring_t ring;
} plan_t;

/* The user's signals at one step; all zero is none. */
typedef struct {
    bool start;
    bool has_first;
    int32_t first; /* with start: the waypoint (from 0) to fly to first */
    bool has_take_off;
    real_t take_off; /* to this height, and hold */
    bool pause;
    bool has_waypoint;
    real_t waypoint[3];
    bool has_heading;
    real_t heading;
    bool home, land;
    int32_t stop; /* motors off at once; 0 is no signal, else what the log says */
    bool rc;
    real_t roll, pitch, yaw_rate, climb; /* of the pilot */
    bool has_set_point;
    set_point_t set_point;
} command_t;

/* What the controllers have to follow. */
typedef struct {
    path_t path;
    real_t heading, heading_rate;
    int32_t motors;
    bool rc; /* roll and pitch come from the pilot */
    real_t roll, pitch;
} reference_t;

typedef struct {
    real_t time_s;
    int32_t state, level;
    message_t message;
} entry_t;

enum { COURSE_NONE, COURSE_TRAJECTORY, COURSE_STOP };

/* What it follows: nothing, a trajectory, or a braking. */
typedef struct {
    int32_t kind;
    trajectory_t way;
    stop_t brake;
} course_t;

typedef struct {
    int32_t state;
    real_t time_s, entered_s, clock_s, step_s;
    int32_t motors;
    int32_t index; /* the waypoint that is flown to or comes next (from 0) */
    int32_t outcome;
    message_t reason;
    bool finished, manual, started, begun;
    int32_t reached;
    message_t quit; /* why the user broke the mission off; counts once it is down */
    bool homing;
    entry_t log[MISSION_LOG];
    int32_t logged; /* entries so far; the latest is log[(logged - 1) % MISSION_LOG] */
    real_t standing[3], hold[3], goal[3];
    real_t heading;
    course_t course;
    real_t ready_s;
    real_t sink, sink_rate, still_s, impact;
    real_t voltage, low_s;
    memory_t memory;
    int32_t beam; /* that is taken next */
    sight_t sight; /* what the points mean for where it goes */
    bool has_detour;
    detour_t detour;
    int32_t back;
    real_t avoided_s;
    bool resumed;
    real_t swing;
    bool has_asked_heading;
    real_t asked_heading;
    bool has_tracker;
    point_t tracker;
    bool halt;
} mission_t;

/* Before the start signal: on the floor, motors off. */
void mission_begin(mission_t *s, const belief_t *m);

/* Another plan is flown from now on, from its first waypoint when it is started. */
void mission_loaded(const plan_t *plan, mission_t *s);

/* One step of the logic, 50 times a second or so. */
void mission_step(const plan_t *plan, mission_t *s, const belief_t *m, const command_t *command, reference_t *out);

/* Between two steps, in a part (from 1) of parts: beams, and the points that the next step goes by. */
void mission_watch_out(const plan_t *plan, mission_t *s, const belief_t *m, int32_t part, int32_t parts);

/* Whether its state lets it do what is asked. height: above where it stood (m). */
bool mission_may(int32_t ask, const mission_t *s, real_t height, bool armed, bool flying);

/* Motors off, whatever the state. */
void mission_stop_at_once(mission_t *s, const message_t *why);

/* Stop and hover; the mission waits. Go on with it, or with waypoint *first. */
void mission_pause(const plan_t *plan, mission_t *s, const message_t *why);
void mission_go_on(const plan_t *plan, mission_t *s, const int32_t *first);

/* Measurements are lost in flight; it cannot go on; by now it has come down. */
void mission_blind(mission_t *s, real_t time_s, const message_t *why);
void mission_come_down(mission_t *s, const message_t *why);
void mission_down_blind(mission_t *s, real_t time_s);

void mission_log(mission_t *s, const message_t *what, int32_t level);

/* Off the floor. */
bool mission_lifted_off(const mission_t *s, const belief_t *m);
/* Whether it turns on its legs, light as it is by now. */
bool mission_tips(const belief_t *m);

#endif
