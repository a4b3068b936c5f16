/* Position cascade: proportional position control and H-infinity velocity control, which command tilt. */
#ifndef MUFLY_CASCADE_H
#define MUFLY_CASCADE_H

#include "real.h"

#define VELOCITY_ORDER 6
#define VELOCITY_ERRORS 2

typedef struct {
    real_t F[VELOCITY_ORDER][VELOCITY_ORDER];
    real_t B[VELOCITY_ORDER][VELOCITY_ERRORS];
    real_t C[2][VELOCITY_ORDER];
    real_t D[2][VELOCITY_ERRORS];
    real_t M[VELOCITY_ORDER][2];
    real_t E[VELOCITY_ORDER][VELOCITY_ERRORS];
    real_t U[VELOCITY_ORDER][2];
    real_t position_gain; /* 1/s */
    real_t speed_limit;   /* m/s */
    real_t tilt_limit;    /* rad */
    real_t gravity;       /* m/s2 */
} position_gains_t;

typedef struct {
    real_t x[VELOCITY_ORDER];
} position_state_t;

/* Position, velocity, acceleration: N, E, D (m, m/s, m/s2). */
typedef struct {
    real_t position[3];
    real_t velocity[3];
    real_t acceleration[3];
} path_t;

/* Start at rest. */
void position_init(position_state_t *state);

/* Run one period. position, velocity: estimated, N, E, D; heading (rad); tilt: phi, theta references (rad). */
void position_step(const position_gains_t *g, position_state_t *state, const path_t *reference,
                   const real_t position[3], const real_t velocity[3], real_t heading, real_t tilt[2]);

#endif
