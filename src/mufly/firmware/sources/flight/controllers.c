#include "flight/controllers.h"

static void measure_heave_yaw(const motion_estimate_t *now, real_t measured[3])
{
    measured[0] = now->position[2];
    measured[1] = now->attitude[2];
    measured[2] = now->rates[2];
}

static void measure_roll_pitch(const motion_estimate_t *now, real_t measured[ROLL_PITCH_MEASURED])
{
#if ROLL_PITCH_SCHEDULED
    real_t sine;
    real_t cosine;

    sine_cosine(now->attitude[2], &sine, &cosine);
    measured[ROLL_PITCH_ERRORS] = (cosine * now->velocity[0]) + (sine * now->velocity[1]);
#endif
    measured[0] = now->attitude[0];
    measured[1] = now->attitude[1];
    measured[2] = now->rates[0];
    measured[3] = now->rates[1];
}

void controllers_engage_heave_yaw(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const real_t motor_input[2])
{
    real_t measured[3];

    measure_heave_yaw(now, measured);
    heave_yaw_init(&g->heave_yaw, &c->heave_yaw, measured, motor_input, now->voltage);
}

void controllers_engage_roll_pitch(const gains_t *g, controllers_t *c, const motion_estimate_t *now)
{
    real_t measured[ROLL_PITCH_MEASURED];

    measure_roll_pitch(now, measured);
    roll_pitch_init(&g->roll_pitch, &c->roll_pitch, measured);
    position_init(&c->position);
}

void controllers_compute_tilt_command(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const path_t *reference,
                      real_t tilt[2])
{
    position_step(&g->position, &c->position, reference, now->position, now->velocity, now->attitude[2], tilt);
}

void controllers_step(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const real_t heave_yaw[4],
                      bool flying, const real_t tilt[2], actuators_t *out)
{
    real_t measured[3];
    real_t tilted[ROLL_PITCH_MEASURED];

    out->servo_input[0] = REAL(0.0);
    out->servo_input[1] = REAL(0.0);
    if (flying) {
        limit_heave_reference(&g->heave_yaw, &c->heave_yaw, now->position[2]);
        measure_roll_pitch(now, tilted);
        roll_pitch_step(&g->roll_pitch, &c->roll_pitch, tilt, tilted, out->servo_input);
    }
    measure_heave_yaw(now, measured);
    heave_yaw_step(&g->heave_yaw, &c->heave_yaw, heave_yaw, measured, now->voltage, out->motor_input);
}
