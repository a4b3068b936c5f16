/* All controllers of the vehicle, from an estimate and references to actuators, one call a period. */
#ifndef MUFLY_CONTROLLERS_H
#define MUFLY_CONTROLLERS_H

#include "cascade.h"
#include "law.h"
#include "real.h"

/* What the controllers go by. */
typedef struct {
    real_t position[3]; /* N, E, D (m) */
    real_t velocity[3]; /* N, E, D (m/s) */
    real_t attitude[3]; /* roll, pitch, yaw (rad); yaw does not jump at half a turn */
    real_t rates[3];    /* p, q, r (rad/s) */
    real_t voltage;     /* of the battery (V) */
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

/* The numbers of the vehicle this was made for: tables.c. */
extern const gains_t mufly_gains;
extern const int32_t mufly_rate_Hz;          /* of controllers_step */
extern const int32_t mufly_position_divider; /* of these, every so many call controllers_tilt_for first */

/* On the floor, motors running at motor_input: heave-yaw takes over without a bump. */
void controllers_engage(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const real_t motor_input[2]);

/* Off the floor: roll-pitch and position take over, servos at trim. */
void controllers_lift_off(const gains_t *g, controllers_t *c, const motion_estimate_t *now);

/* The position cascade: phi, theta to hold (rad). */
void controllers_tilt_for(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const path_t *reference,
                      real_t tilt[2]);

/* heave_yaw: z (m, down), psi (rad) and their rates to follow; flying: whether it is off the floor, where tilt is
 * held; before that the servos stay neutral, since on its legs it cannot tilt and a controller that tries winds up. */
void controllers_step(const gains_t *g, controllers_t *c, const motion_estimate_t *now, const real_t heave_yaw[4],
                      bool flying, const real_t tilt[2], actuators_t *out);

#endif
