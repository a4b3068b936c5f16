#include "onboard/storage/parameters.h"

#include <stddef.h>

typedef struct {
    const char *name;
    real_t least, most, unit; /* bounds, and SI units of one unit */
} parameter_t;

static const parameter_t parameters[PARAMETERS] = {
    {"AVD_CLEARANCE", REAL(0.15), REAL(1.0), REAL(1.0)},
    {"AVD_SPEED", REAL(0.06), REAL(1.0), REAL(1.0)},
    {"BAT_LOW_V", REAL(0.0), REAL(60.0), REAL(1.0)},
    {"CAL_ACC0_XOFF", REAL(-2.0), REAL(2.0), REAL(1.0)},
    {"CAL_ACC0_XSCALE", REAL(0.8), REAL(1.2), REAL(1.0)},
    {"CAL_ACC0_YOFF", REAL(-2.0), REAL(2.0), REAL(1.0)},
    {"CAL_ACC0_YSCALE", REAL(0.8), REAL(1.2), REAL(1.0)},
    {"CAL_ACC0_ZOFF", REAL(-2.0), REAL(2.0), REAL(1.0)},
    {"CAL_ACC0_ZSCALE", REAL(0.8), REAL(1.2), REAL(1.0)},
    {"CAL_GYRO0_XOFF", REAL(-0.5), REAL(0.5), REAL(1.0)},
    {"CAL_GYRO0_YOFF", REAL(-0.5), REAL(0.5), REAL(1.0)},
    {"CAL_GYRO0_ZOFF", REAL(-0.5), REAL(0.5), REAL(1.0)},
    {"CAL_RING_OFF", REAL(-0.2), REAL(0.2), REAL(1.0)},
    {"CAL_RING_SCALE", REAL(0.8), REAL(1.2), REAL(1.0)},
    {"CAL_SONAR_OFF", REAL(-0.2), REAL(0.2), REAL(1.0)},
    {"CAL_SONAR_SCALE", REAL(0.8), REAL(1.2), REAL(1.0)},
    {"COM_DL_LAND_T", REAL(0.0), REAL(3600.0), REAL(1.0)},
    {"COM_DL_LOSS_T", REAL(1.0), REAL(300.0), REAL(1.0)},
    {"COM_RC_LOSS_T", REAL(0.1), REAL(5.0), REAL(1.0)},
    {"LIM_REACH", REAL(0.01), REAL(1.0), REAL(1.0)},
    {"LIM_TOUCHDOWN", REAL(0.05), REAL(0.25), REAL(1.0)},
    {"MIS_TAKEOFF_ALT", REAL(0.2), REAL(50.0), REAL(1.0)},
    {"RC_MAP_ARM_SW", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"RC_MAP_KILL_SW", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"RC_MAP_MAN_SW", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"RC_MAP_PITCH", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"RC_MAP_ROLL", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"RC_MAP_THROTTLE", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"RC_MAP_YAW", REAL(0.0), REAL(16.0), REAL(1.0)},
    {"STK_CLIMB", REAL(0.1), REAL(1.0), REAL(1.0)},
    {"STK_TILT", REAL(1.0), REAL(15.0), DEGREE},
    {"STK_YAWRATE", REAL(5.0), REAL(110.0), DEGREE},
};

static real_t *place(const tunables_t *t, int32_t k)
{
    plan_t *plan = t->plan;
    supervisor_settings_t *settings = t->supervisor;
    calibration_t *c = t->calibration;
    rc_settings_t *rc = t->rc;
    real_t *const places[PARAMETERS] = {
        &plan->clearance, &plan->avoid_speed, &plan->low_voltage, &c->acceleration_offset[0], &c->acceleration_scale[0],
        &c->acceleration_offset[1], &c->acceleration_scale[1], &c->acceleration_offset[2], &c->acceleration_scale[2],
        &c->rate_offset[0], &c->rate_offset[1], &c->rate_offset[2], &c->ring_offset, &c->ring_scale, &c->sonar_offset,
        &c->sonar_scale, &settings->link_land_s, &settings->link_loss_s, &rc->loss_s, &plan->reach,
        &plan->touchdown, &plan->take_off_height, &rc->switches[RC_SWITCH_ARM], &rc->switches[RC_SWITCH_KILL],
        &rc->switches[RC_SWITCH_MANUAL], &rc->pitch, &rc->roll, &rc->throttle, &rc->yaw, &settings->stick_climb, &settings->stick_tilt, &settings->stick_yaw_rate,
    };

    return places[k];
}

const char *parameter_name(int32_t k)
{
    return parameters[k].name;
}

bool parameter_calibrates(int32_t k)
{
    return (k >= (int32_t)PARAM_CAL_ACC0_XOFF) && (k <= (int32_t)PARAM_CAL_SONAR_SCALE);
}

real_t parameter_get(const tunables_t *t, int32_t k)
{
    return *place(t, k) / parameters[k].unit;
}

bool parameter_set(const tunables_t *t, int32_t k, real_t value)
{
    const real_t slack = REAL(1e-6) * real_max(real_abs(parameters[k].least), real_abs(parameters[k].most));
    const bool fits = (value >= (parameters[k].least - slack)) && (value <= (parameters[k].most + slack));

    if (fits) {
        *place(t, k) = value * parameters[k].unit;
    }
    return fits;
}

int32_t parameter_find(const uint8_t name[PARAMETER_NAME])
{
    int32_t found = -1;

    for (int32_t k = 0; k < (int32_t)PARAMETERS; k++) {
        const char *is = parameters[k].name;
        bool same = true;
        bool ended = false;

        for (int32_t i = 0; i < PARAMETER_NAME; i++) {
            if (!ended) {
                same = same && (name[i] == (uint8_t)is[i]);
                ended = (is[i] == '\0');
            }
        }
        found = same ? k : found;
    }
    return found;
}
