/* H-infinity control law of heave-yaw and roll-pitch. Explanation: law.py of mufly.control.
 *
 * A controller is  u = C x + D e,  x+ = x + F x + B e + M (sat(u) - u);  it starts at  x = E e + U u.
 * Units SI and radians; motor inputs 0..1 as (upper, lower), servo inputs -1..1. The caller owns all state. */
#ifndef MUFLY_LAW_H
#define MUFLY_LAW_H

#include "control/schedule.h"
#include "real.h"

#define HEAVE_YAW_ORDER 10
#define HEAVE_YAW_ERRORS 5
#define ROLL_PITCH_ORDER 8
#define ROLL_PITCH_ERRORS 4
#define ROLL_PITCH_MEASURED (ROLL_PITCH_ERRORS + ROLL_PITCH_SCHEDULED)
#define OUTPUT_PAIR 2 /* both motors, both servos */

typedef struct {
    real_t F[HEAVE_YAW_ORDER][HEAVE_YAW_ORDER];
    real_t B[HEAVE_YAW_ORDER][HEAVE_YAW_ERRORS];
    real_t C[OUTPUT_PAIR][HEAVE_YAW_ORDER];
    real_t D[OUTPUT_PAIR][HEAVE_YAW_ERRORS];
    real_t M[HEAVE_YAW_ORDER][OUTPUT_PAIR];
    real_t E[HEAVE_YAW_ORDER][HEAVE_YAW_ERRORS];
    real_t U[HEAVE_YAW_ORDER][OUTPUT_PAIR];
    real_t trim[OUTPUT_PAIR]; /* lower, upper; fraction of the design voltage */
    real_t design_voltage;
    real_t voltage_blend;
    real_t period;
    real_t heave_bandwidth;
    real_t heave_acceleration;
    real_t heave_speed;
    real_t heave_lead;
    real_t heave_tracking_error_limit;
    real_t yaw_bandwidth;
    real_t yaw_acceleration;
    real_t yaw_rate;
    real_t yaw_lead;
} heave_yaw_gains_t;

typedef struct {
    real_t x[HEAVE_YAW_ORDER];
    real_t shaped_z, shaped_w, shaped_psi, shaped_r; /* filtered references and their rates */
    real_t origin_z, origin_psi;                     /* height and heading at engagement */
    real_t voltage;                                  /* of the battery, filtered */
    real_t dropped[HEAVE_YAW_ORDER];                 /* rounding errors of x and of the references */
    real_t dropped_z, dropped_psi;
} heave_yaw_state_t;

typedef struct {
    real_t F[ROLL_PITCH_ORDER][ROLL_PITCH_ORDER];
    real_t B[ROLL_PITCH_ORDER][ROLL_PITCH_ERRORS];
    real_t C[OUTPUT_PAIR][ROLL_PITCH_ORDER];
    real_t D[OUTPUT_PAIR][ROLL_PITCH_ERRORS];
    real_t M[ROLL_PITCH_ORDER][OUTPUT_PAIR];
    real_t E[ROLL_PITCH_ORDER][ROLL_PITCH_ERRORS];
    real_t U[ROLL_PITCH_ORDER][OUTPUT_PAIR];
    real_t trim[OUTPUT_PAIR]; /* servo 1, servo 2 */
    real_t tilt_limit;
#if ROLL_PITCH_SCHEDULED
    real_t C_forward_change[OUTPUT_PAIR][ROLL_PITCH_ORDER]; /* change of C and D from hover to the scheduled speed */
    real_t D_forward_change[OUTPUT_PAIR][ROLL_PITCH_ERRORS];
    real_t schedule; /* inverse square of that speed (s2/m2); 0: none */
#endif
} roll_pitch_gains_t;

typedef struct {
    real_t x[ROLL_PITCH_ORDER];
} roll_pitch_state_t;

/* Engage heave-yaw bumplessly from motors at motor_input; measured: z (m, down), psi, r; battery voltage (V). */
void heave_yaw_init(const heave_yaw_gains_t *g, heave_yaw_state_t *state, const real_t measured[3],
                     const real_t motor_input[OUTPUT_PAIR], real_t voltage);

/* In flight: make the filtered reference wait for a height z (m, down) that trails it by more than the slack. */
void limit_heave_reference(const heave_yaw_gains_t *g, heave_yaw_state_t *state, real_t z);

/* Run one period. reference: z, psi and their rates; measured: z, psi, r; voltage (V). */
void heave_yaw_step(const heave_yaw_gains_t *g, heave_yaw_state_t *state, const real_t reference[4],
                    const real_t measured[3], real_t voltage, real_t motor_input[OUTPUT_PAIR]);

/* Engage roll-pitch with servos at trim; measured: phi, theta, p, q. */
void roll_pitch_init(const roll_pitch_gains_t *g, roll_pitch_state_t *state,
                      const real_t measured[ROLL_PITCH_ERRORS]);

/* Run one period. reference: phi, theta; measured: phi, theta, p, q, and with a schedule the forward speed (m/s). */
void roll_pitch_step(const roll_pitch_gains_t *g, roll_pitch_state_t *state, const real_t reference[OUTPUT_PAIR],
                     const real_t measured[ROLL_PITCH_MEASURED], real_t servo_input[OUTPUT_PAIR]);

#endif
