/* Parameters that a station may read and set: those of tunable_parameters.py of mufly.flight and parameter_protocol.py of
 * mufly.link that act on plan and supervisor at once. */
#ifndef MUFLY_PARAMETERS_H
#define MUFLY_PARAMETERS_H

#include "supervisor.h"

#define PARAMETER_NAME 16

enum { PARAM_AVD_CLEARANCE, PARAM_AVD_SPEED, PARAM_BAT_LOW_V, PARAM_COM_DL_LAND_T, PARAM_COM_DL_LOSS_T, PARAM_LIM_REACH,
       PARAM_LIM_TOUCHDOWN, PARAM_MIS_TAKEOFF_ALT, PARAM_STK_CLIMB, PARAM_STK_TILT, PARAM_STK_YAWRATE, PARAMETERS };

const char *parameter_name(int32_t k);
real_t parameter_get(const plan_t *plan, const supervisor_settings_t *settings, int32_t k);

/* Set a parameter within its bounds; return whether it was set. */
bool parameter_set(plan_t *plan, supervisor_settings_t *settings, int32_t k, real_t value);

/* Index of a name of at most 16 characters; -1: there is none. */
int32_t parameter_find(const uint8_t name[PARAMETER_NAME]);

#endif
