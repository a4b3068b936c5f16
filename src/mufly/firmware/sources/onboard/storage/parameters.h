/* Parameters that a station may read and set: those of tunable_parameters.py of mufly.flight and parameter_protocol.py of
 * mufly.link that act on plan and supervisor at once, the calibration of the sensors, and the channels of a receiver. */
#ifndef MUFLY_PARAMETERS_H
#define MUFLY_PARAMETERS_H

#include "onboard/receiver/rc.h"
#include "onboard/storage/calibration.h"
#include "onboard/supervisor/supervisor.h"

#define PARAMETER_NAME 16

enum { PARAM_AVD_CLEARANCE, PARAM_AVD_SPEED, PARAM_BAT_LOW_V, PARAM_CAL_ACC0_XOFF, PARAM_CAL_ACC0_XSCALE, PARAM_CAL_ACC0_YOFF,
       PARAM_CAL_ACC0_YSCALE, PARAM_CAL_ACC0_ZOFF, PARAM_CAL_ACC0_ZSCALE, PARAM_CAL_GYRO0_XOFF, PARAM_CAL_GYRO0_YOFF,
       PARAM_CAL_GYRO0_ZOFF, PARAM_CAL_RING_OFF, PARAM_CAL_RING_SCALE, PARAM_CAL_SONAR_OFF, PARAM_CAL_SONAR_SCALE,
       PARAM_COM_DL_LAND_T, PARAM_COM_DL_LOSS_T, PARAM_COM_RC_LOSS_T, PARAM_LIM_REACH, PARAM_LIM_TOUCHDOWN,
       PARAM_MIS_TAKEOFF_ALT, PARAM_RC_MAP_ARM_SW, PARAM_RC_MAP_KILL_SW, PARAM_RC_MAP_MAN_SW, PARAM_RC_MAP_PITCH,
       PARAM_RC_MAP_ROLL, PARAM_RC_MAP_THROTTLE, PARAM_RC_MAP_YAW, PARAM_STK_CLIMB, PARAM_STK_TILT, PARAM_STK_YAWRATE, PARAMETERS };

/* What the parameters are values of. */
typedef struct {
    plan_t *plan;
    supervisor_settings_t *supervisor;
    calibration_t *calibration;
    rc_settings_t *rc;
} tunables_t;

const char *parameter_name(int32_t k);
real_t parameter_get(const tunables_t *t, int32_t k);

/* Set a parameter within its bounds; return whether it was set. */
bool parameter_set(const tunables_t *t, int32_t k, real_t value);

/* Whether a parameter calibrates a sensor: set and stored on the floor only. */
bool parameter_calibrates(int32_t k);

/* Index of a name of at most 16 characters; -1: there is none. */
int32_t parameter_find(const uint8_t name[PARAMETER_NAME]);

#endif
