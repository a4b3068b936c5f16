/* Strapdown equations of state and errors between two instants, and the force of the rotors. */
#ifndef MUFLY_STRAPDOWN_H
#define MUFLY_STRAPDOWN_H

#include "estimate/filter/records.h"

/* Write the matrix (9 numbers, by rows) from body axes to N-E-D; q: w x y z. */
void rotation_matrix(const real_t q[4], real_t r[9]);

/* Rotate the attitude in state x by a small turn (rad), about body axes if own, else about N, E, D. */
void rotate_attitude(real_t x[STATE_COUNT], real_t t_x, real_t t_y, real_t t_z, bool own);

/* Predict the state x over dt (s) with a row of inputs e. r returns the attitude in the middle of the step, a the
 * acceleration without gravity in N-E-D and the model's force per mass in body axes. */
void predict_state(real_t x[STATE_COUNT], const real_t e[INPUT_ROW_SIZE], real_t dt, real_t r[9], real_t a[6]);

/* Error transition over a step (s): effect of the gyroscopes' bias on the
 * attitude (9); of the accelerometers' bias (9), the velocity through the air (9) and the thrust's scale (3) on the
 * velocity; of turns (3). e, r, a: inputs, attitude and acceleration of the step. */
void error_transition(const real_t e[INPUT_ROW_SIZE], real_t span, const real_t r[9], const real_t a[3],
                   real_t out[TRANSITION_SIZE]);

/* Advance the rotor state by a period, and write the force of rotors and air per mass: without motion, the remainder,
 * and the slope over the velocity; also the angular acceleration. air: velocity through the air, body axes (m/s). */
void predict_rotor_force(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t air[3],
                 real_t out[12]);

#endif
