/* What the mission says in its log: a template and its numbers. The templates are in words.py of mufly.mission, in this
 * order: the ground makes the texts. */
#ifndef MUFLY_WORDS_H
#define MUFLY_WORDS_H

#include "real.h"

enum {
    SAY_NOTHING,
    SAY_GIVEN,
    SAY_READY,
    SAY_LOADED,
    SAY_LOADED_ONE,
    SAY_START_SIGNAL,
    SAY_TAKE_OFF_SIGNAL,
    SAY_ALTITUDE,
    SAY_TAKE_OFF_FAILED,
    SAY_TAKE_OFF_SHORT,
    SAY_TO_WAYPOINT,
    SAY_COMPLETE,
    SAY_COMPLETE_HOLDS,
    SAY_COMPLETE_RETURNS,
    SAY_REACHED,
    SAY_REACHED_USERS,
    SAY_REACHED_HOME,
    SAY_MISSED,
    SAY_MISSED_USERS,
    SAY_MISSED_HOME,
    SAY_OBSTACLE_AHEAD,
    SAY_OBSTACLE_NEAR,
    SAY_BLOCKED,
    SAY_AVOIDED,
    SAY_TOUCHDOWN,
    SAY_HARD_TOUCHDOWN,
    SAY_LANDED,
    SAY_TIPPED_OVER,
    SAY_TIPPED_OFF,
    SAY_BATTERY_LOW,
    SAY_BATTERY_LOW_PILOT,
    SAY_WILL_HOVER,
    SAY_LANDING_BROKEN_OFF,
    SAY_PAUSED,
    SAY_HEADING_REFUSED,
    SAY_TOO_LOW,
    SAY_TOO_FAR,
    SAY_USERS_WAYPOINT,
    SAY_USERS_WAYPOINT_HEADING,
    SAY_TURNING,
    SAY_GOES_ON,
    SAY_BEGINS,
    SAY_ON_TO,
    SAY_FOLLOWS,
    SAY_FOLLOWS_FROM,
    SAY_RETURN_SIGNAL,
    SAY_LAND_SIGNAL,
    SAY_RETURN_EARLY_LAST,
    SAY_RETURN_EARLY,
    SAY_LAND_EARLY_LAST,
    SAY_LAND_EARLY,
    SAY_RC_ON,
    SAY_RC_OFF,
    SAY_RC_OFF_FLOOR,
    SAY_BY_PILOT,
    SAY_OFFBOARD,
    SAY_OFFBOARD_UP,
    SAY_OFFBOARD_OFF,
    SAY_OFFBOARD_OFF_FLOOR,
    SAY_CAME_DOWN,
    SAY_LOST,
    SAY_HOLDS,
    SAY_KNOWN,
    SAY_OSCILLATES_UPPER,
    SAY_OSCILLATES_LOWER,
    SAY_OSCILLATES_SERVO_1,
    SAY_OSCILLATES_SERVO_2,
    SAY_TILT_DOUBT,
    SAY_HEADING_DOUBT,
    SAY_HEIGHT_DOUBT,
    SAY_PLACE_DOUBT,
    SAY_PLACE_WAITED,
    SAY_CONTRADICTED,
    SAY_COUNT
};

enum { LEVEL_INFO, LEVEL_WARNING, LEVEL_ERROR };

#define SAID_NUMBERS 4
#define SAID_SENSORS 3

/* What is wrong with a sensor: its place, status and reason in belief.h. */
typedef struct {
    int16_t sensor; /* -1: none */
    int16_t status;
    int32_t why;
    real_t number;
} said_t;

typedef struct {
    int32_t code;
    real_t number[SAID_NUMBERS];
    said_t because[SAID_SENSORS];
} message_t;

message_t say(int32_t code);
message_t say_1(int32_t code, real_t a);
message_t say_2(int32_t code, real_t a, real_t b);
message_t say_3(int32_t code, real_t a, real_t b, real_t c);
message_t say_4(int32_t code, real_t a, real_t b, real_t c, real_t d);

/* The same template with the same numbers. */
bool say_same(const message_t *a, const message_t *b);

#endif
