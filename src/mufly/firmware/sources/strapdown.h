/* How state and errors move between two instants (strapdown equations), and the force that the rotors make. */
#ifndef MUFLY_STRAPDOWN_H
#define MUFLY_STRAPDOWN_H

#include "records.h"

/* Write the matrix (9 numbers, by rows) from body axes to N-E-D; q: w x y z. */
void rotation_matrix(const real_t q[4], real_t r[9]);

/* Rotate the attitude in state x by a small turn (rad), about body axes if own, else about N, E, D. */
void rotate_attitude(real_t x[STATE_COUNT], real_t t_x, real_t t_y, real_t t_z, bool own);

/* Predict the state x over dt (s) with a row of inputs e. r returns the attitude in the middle of the step, a the
 * acceleration without gravity in N-E-D and the model's force per mass in body axes. */
void predict_state(real_t x[STATE_COUNT], const real_t e[INPUT_ROW_SIZE], real_t dt, real_t r[9], real_t a[6]);

/* How position, velocity and attitude depend on errors after a step of so long (s): what the gyroscopes' bias does to the
 * attitude (9), the accelerometers' bias (9), velocity through the air (9), the thrust's scale (3) to the velocity, and
 * what turns do (3). e, r, a: inputs, attitude and acceleration of the step. */
void error_transition(const real_t e[INPUT_ROW_SIZE], real_t span, const real_t r[9], const real_t a[3],
                   real_t out[TRANSITION_SIZE]);

/* Carry what the rotors remember on by a period, and write the force that they and the air make: per mass, without
 * motion, rest, slope over the velocity; and angular acceleration. air: velocity through it, body axes (m/s). */
void predict_rotor_force(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t air[3],
                 real_t out[12]);

#endif
