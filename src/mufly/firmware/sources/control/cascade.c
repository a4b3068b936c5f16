#include "control/cascade.h"

#include "control/linear.h"

void position_init(position_state_t *state)
{
    for (int32_t i = 0; i < VELOCITY_ORDER; i++) {
        state->x[i] = REAL(0.0);
    }
}

void position_step(const position_gains_t *g, position_state_t *state, const path_t *reference,
                   const real_t position[3], const real_t velocity[3], real_t heading, real_t tilt[2])
{
    real_t wanted[2];
    real_t e[VELOCITY_ERRORS];
    real_t excess[2];
    real_t change[VELOCITY_ORDER];
    real_t speed;
    real_t phi;
    real_t theta;
    real_t size;
    real_t factor = REAL(1.0);
    real_t sine;
    real_t cosine;

    for (int32_t i = 0; i < 2; i++) {
        wanted[i] = reference->velocity[i] + (g->position_gain * (reference->position[i] - position[i]));
    }
    speed = real_sqrt((wanted[0] * wanted[0]) + (wanted[1] * wanted[1]));
    if (speed > g->speed_limit) {
        wanted[0] = (wanted[0] * g->speed_limit) / speed;
        wanted[1] = (wanted[1] * g->speed_limit) / speed;
    }
    e[0] = wanted[0] - velocity[0];
    e[1] = wanted[1] - velocity[1];
    linear_output(VELOCITY_ORDER, VELOCITY_ERRORS, &g->C[0][0], &g->D[0][0], state->x, e, tilt);
    phi = tilt[0] + (reference->acceleration[1] / g->gravity);
    theta = tilt[1] - (reference->acceleration[0] / g->gravity);
    size = real_sqrt((phi * phi) + (theta * theta));
    if (size > g->tilt_limit) {
        factor = g->tilt_limit / size;
    }
    excess[0] = (factor - REAL(1.0)) * phi;
    excess[1] = (factor - REAL(1.0)) * theta;
    /* North and east to forward and right. */
    sine_cosine(heading, &sine, &cosine);
    sine = factor * sine;
    cosine = factor * cosine;
    tilt[0] = (cosine * phi) + (sine * theta);
    tilt[1] = (cosine * theta) - (sine * phi);
    linear_change(VELOCITY_ORDER, VELOCITY_ERRORS, &g->F[0][0], &g->B[0][0], &g->M[0][0], state->x, e, excess,
                  change);
    for (int32_t i = 0; i < VELOCITY_ORDER; i++) {
        state->x[i] += change[i];
    }
}
