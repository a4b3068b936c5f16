/* Log messages of the mission: a template and its numbers. The ground formats the texts with the templates of
 * log_messages.py of mufly.mission, in this order. */
#ifndef MUFLY_LOG_MESSAGES_H
#define MUFLY_LOG_MESSAGES_H

#include "real.h"

enum {
    SAY_NO_MESSAGE,
    SAY_GIVEN_TEXT,
    SAY_READY_FOR_MISSION,
    SAY_WAYPOINTS_LOADED,
    SAY_ONE_WAYPOINT_LOADED,
    SAY_START_SIGNAL,
    SAY_TAKE_OFF_SIGNAL,
    SAY_ALTITUDE_REACHED,
    SAY_TAKE_OFF_FAILED,
    SAY_TAKE_OFF_SHORT,
    SAY_TO_WAYPOINT,
    SAY_MISSION_COMPLETE,
    SAY_MISSION_COMPLETE_HOLDING,
    SAY_MISSION_COMPLETE_RETURNING,
    SAY_WAYPOINT_REACHED,
    SAY_USER_WAYPOINT_REACHED,
    SAY_HOME_REACHED,
    SAY_WAYPOINT_MISSED,
    SAY_USER_WAYPOINT_MISSED,
    SAY_HOME_MISSED,
    SAY_OBSTACLE_AHEAD,
    SAY_OBSTACLE_NEAR,
    SAY_BLOCKED_BY_OBSTACLE,
    SAY_OBSTACLE_AVOIDED,
    SAY_TOUCHDOWN,
    SAY_HARD_TOUCHDOWN,
    SAY_LANDED,
    SAY_TIPPED_OVER,
    SAY_TIPPED_MOTORS_OFF,
    SAY_BATTERY_LOW,
    SAY_BATTERY_LOW_PILOT,
    SAY_WILL_HOVER_AFTER_TAKE_OFF,
    SAY_LANDING_ABORTED,
    SAY_MISSION_PAUSED,
    SAY_HEADING_REFUSED,
    SAY_USER_WAYPOINT_TOO_LOW,
    SAY_USER_WAYPOINT_TOO_FAR,
    SAY_TO_USER_WAYPOINT,
    SAY_TO_USER_WAYPOINT_WITH_HEADING,
    SAY_TURNING_TO_HEADING,
    SAY_MISSION_CONTINUES,
    SAY_MISSION_BEGINS,
    SAY_ON_TO_WAYPOINT,
    SAY_MISSION_AFTER_TAKE_OFF,
    SAY_MISSION_AFTER_TAKE_OFF_FROM,
    SAY_RETURN_SIGNAL,
    SAY_LAND_SIGNAL,
    SAY_RETURN_BEFORE_LAST_WAYPOINT,
    SAY_RETURN_WITH_WAYPOINTS_LEFT,
    SAY_LAND_BEFORE_LAST_WAYPOINT,
    SAY_LAND_WITH_WAYPOINTS_LEFT,
    SAY_RC_ON,
    SAY_RC_OFF,
    SAY_RC_OFF_ON_FLOOR,
    SAY_LANDED_BY_PILOT,
    SAY_OFFBOARD_ON,
    SAY_OFFBOARD_TAKE_OFF,
    SAY_OFFBOARD_OFF,
    SAY_OFFBOARD_OFF_ON_FLOOR,
    SAY_MOTORS_OFF_AFTER_DESCENT,
    SAY_MEASUREMENT_LOST,
    SAY_WAITING_FOR_POSITION,
    SAY_POSITION_KNOWN_AGAIN,
    SAY_OSCILLATES_UPPER,
    SAY_OSCILLATES_LOWER,
    SAY_OSCILLATES_SERVO_1,
    SAY_OSCILLATES_SERVO_2,
    SAY_ATTITUDE_UNCERTAIN,
    SAY_HEADING_UNCERTAIN,
    SAY_HEIGHT_UNCERTAIN,
    SAY_POSITION_UNCERTAIN,
    SAY_POSITION_UNCERTAIN_TOO_LONG,
    SAY_ATTITUDE_CONTRADICTED,
    SAY_ESTIMATE_NOT_VALID,
    SAY_STANDS_TILTED,
    SAY_COUNT
};

enum { LEVEL_INFO, LEVEL_WARNING, LEVEL_ERROR };

#define MESSAGE_NUMBERS 4
#define MESSAGE_SENSORS 3

/* Fault of a sensor: index, status and reason as in estimator.h. */
typedef struct {
    int16_t sensor; /* -1: none */
    int16_t status;
    int32_t why;
    real_t number;
} message_sensor_t;

typedef struct {
    int32_t code;
    real_t number[MESSAGE_NUMBERS];
    message_sensor_t faulty_sensors[MESSAGE_SENSORS];
} message_t;

message_t make_message(int32_t code);
message_t make_message_1(int32_t code, real_t a);
message_t make_message_2(int32_t code, real_t a, real_t b);
message_t make_message_3(int32_t code, real_t a, real_t b, real_t c);
message_t make_message_4(int32_t code, real_t a, real_t b, real_t c, real_t d);

/* Whether two messages have equal templates and numbers. */
bool is_same_message(const message_t *a, const message_t *b);

#endif
