/* How state and errors move between two instants (strapdown equations), and the force that the rotors make. */
#ifndef MUFLY_MOTION_H
#define MUFLY_MOTION_H

#include "records.h"

/* Matrix, by rows, that turns body vectors into N-E-D; q: quaternion w x y z. */
void turn_matrix(const real_t q[4], real_t r[9]);

/* Turn the attitude in a state by a small turn (rad), about body axes if `own`, else about N, E, D. */
void turned(real_t x[STATES], real_t t_x, real_t t_y, real_t t_z, bool own);

/* Carry a state on by a time dt of inputs e; r is left with the attitude in its middle, a with the acceleration but for
 * gravity, N-E-D, and the force in body axes that the model made. */
void advance_state(real_t x[STATES], const real_t e[INPUTS], real_t dt, real_t r[9], real_t a[6]);

/* How position, velocity and attitude depend on errors after a step of so long (s): what the gyroscopes' bias does to the
 * attitude (9), the accelerometers' bias (9), velocity through the air (9), the thrust's scale (3) to the velocity, and
 * what turns do (3). e, r, a: inputs, attitude and acceleration of the step. */
void transition_of(const real_t e[INPUTS], real_t span, const real_t r[9], const real_t a[3],
                   real_t out[TRANSITION]);

/* Carry what the rotors remember on by a period, and write the force that they and the air make: per mass, without
 * motion, rest, slope over the velocity; and angular acceleration. air: velocity through it, body axes (m/s). */
void model_force(estimator_t *m, const estimator_settings_t *s, const flight_model_t *p, const real_t air[3],
                 real_t out[12]);

#endif
