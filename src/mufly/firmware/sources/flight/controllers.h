/* All controllers of the vehicle: from an estimate and references to actuators, one call per period. */
#ifndef MUFLY_CONTROLLERS_H
#define MUFLY_CONTROLLERS_H

#include "control/cascade.h"
#include "control/law.h"
#include "real.h"

/* Measured motion for the controllers. */
typedef struct {
    real_t position[3]; /* N, E, D (m) */
    real_t velocity[3]; /* N, E, D (m/s) */
    real_t attitude[3]; /* roll, pitch, yaw (rad); yaw is continuous at half a turn */
    real_t rates[3];    /* p, q, r (rad/s) */
    real_t voltage;     /* battery voltage (V) */
} motion_estimate_t;

typedef struct {
    heave_yaw_gains_t heave_yaw;
    roll_pitch_gains_t roll_pitch;
    position_gains_t position;
} gains_t;

typedef struct {
    heave_yaw_state_t heave_yaw;
    roll_pitch_state_t roll_pitch;
    position_state_t position;
} controllers_t;

typedef struct {
    real_t motor_input[2]; /* upper, lower; 0..1 */
    real_t servo_input[2]; /* pitch (positive: nose down), roll; -1..1 */
} actuators_t;

/* Constants of the exported vehicle: tables.c. */
extern const gains_t mufly_gains;
extern const int32_t mufly_rate_Hz;          /* rate of controllers_step */
extern const int32_t mufly_position_divider; /* periods per call of controllers_compute_tilt_command, which precedes the step */

/* Engage heave-yaw bumplessly on the floor, with motors running at motor_input. */
void controllers_engage_heave_yaw(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const real_t motor_input[2]);

/* Engage roll-pitch and position at lift-off, with servos at trim. */
void controllers_engage_roll_pitch(const gains_t *g, controllers_t *c, const motion_estimate_t *now);

/* Run the position cascade: references of phi and theta (rad). */
void controllers_compute_tilt_command(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const path_t *reference,
                      real_t tilt[2]);

/* Run one period. heave_yaw: references of z (m, down), psi (rad) and their rates; flying: whether the vehicle is off
 * the floor and tilt is controlled. On the legs the servos stay neutral, since a tilt controller would wind up. */
void controllers_step(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const real_t heave_yaw[4],
                      bool flying, const real_t tilt[2], actuators_t *out);

#endif
