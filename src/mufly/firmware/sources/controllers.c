#include "controllers.h"

static void heave_yaw_of(const motion_t *now, real_t measured[3])
{
    measured[0] = now->position[2];
    measured[1] = now->attitude[2];
    measured[2] = now->rates[2];
}

static void roll_pitch_of(const motion_t *now, real_t measured[ROLL_PITCH_ERRORS])
{
    measured[0] = now->attitude[0];
    measured[1] = now->attitude[1];
    measured[2] = now->rates[0];
    measured[3] = now->rates[1];
}

void controllers_engage(const gains_t *g, controllers_t *c, const motion_t *now, const real_t motor_input[2])
{
    real_t measured[3];

    heave_yaw_of(now, measured);
    heave_yaw_start(&g->heave_yaw, &c->heave_yaw, measured, motor_input, now->voltage);
}

void controllers_lift_off(const gains_t *g, controllers_t *c, const motion_t *now)
{
    real_t measured[ROLL_PITCH_ERRORS];

    roll_pitch_of(now, measured);
    roll_pitch_start(&g->roll_pitch, &c->roll_pitch, measured);
    position_start(&c->position);
}

void controllers_tilt(const gains_t *g, controllers_t *c, const motion_t *now, const path_t *reference,
                      real_t tilt[2])
{
    position_step(&g->position, &c->position, reference, now->position, now->velocity, now->attitude[2], tilt);
}

void controllers_step(const gains_t *g, controllers_t *c, const motion_t *now, const real_t heave_yaw[4],
                      bool flying, const real_t tilt[2], actuators_t *out)
{
    real_t measured[3];
    real_t tilted[ROLL_PITCH_ERRORS];

    out->servo_input[0] = REAL(0.0);
    out->servo_input[1] = REAL(0.0);
    if (flying) {
        heave_wait(&g->heave_yaw, &c->heave_yaw, now->position[2]);
        roll_pitch_of(now, tilted);
        roll_pitch_step(&g->roll_pitch, &c->roll_pitch, tilt, tilted, out->servo_input);
    }
    heave_yaw_of(now, measured);
    heave_yaw_step(&g->heave_yaw, &c->heave_yaw, heave_yaw, measured, now->voltage, out->motor_input);
}
