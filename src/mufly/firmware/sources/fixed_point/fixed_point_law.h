/* Fixed-point control law, equivalent to law.c, cascade.c and controllers.c, for processors without floating-point unit.
 *
 * Signals are int32_t in 2^-20 of m, m/s, m/s2, rad, rad/s, V or full throw. fixed_point_design.py of mufly.firmware bounds
 * every state and sum, so nothing overflows; the tables state the largest bounds. The caller owns all state. */
#ifndef MUFLY_FIXED_POINT_LAW_H
#define MUFLY_FIXED_POINT_LAW_H

#include "fixed_point/fixed_point.h"

#define FIXED_HEAVE_YAW_ORDER 10
#define FIXED_HEAVE_YAW_ERRORS 5
#define FIXED_ROLL_PITCH_ORDER 8
#define FIXED_ROLL_PITCH_ERRORS 4
#define FIXED_POSITION_ORDER 6
#define FIXED_POSITION_ERRORS 2
#define FIXED_OUTPUT_PAIR 2
#define FIXED_MAX_INPUTS 17 /* states, errors and saturation excess of heave-yaw */
#define FIXED_MAX_STATES 10

/* Reference filter: 2^-20, rates and accelerations 2^-24. */
typedef struct {
    int32_t slope;         /* half the bandwidth (1/s) */
    int32_t bandwidth;     /* twice the bandwidth (1/s) */
    int32_t braking;       /* braking acceleration (m/s2 or rad/s2) */
    int32_t linear;        /* gap of the linear range (m or rad) */
    int32_t acceleration;  /* 2^-24 */
    int32_t speed;
    int32_t lead; /* s */
} fixed_reference_filter_t;

typedef struct {
    fixed_coefficient_t update[FIXED_HEAVE_YAW_ORDER][17];
    fixed_coefficient_t output[FIXED_OUTPUT_PAIR][15];
    fixed_coefficient_t start[FIXED_HEAVE_YAW_ORDER][7];
    uint8_t update_down[FIXED_HEAVE_YAW_ORDER];
    uint8_t output_down[FIXED_OUTPUT_PAIR];
    uint8_t start_down[FIXED_HEAVE_YAW_ORDER];
    int32_t kept; /* 1: the sum is added to the state (delta form); 0: the sum is the state */
    int32_t limit[FIXED_HEAVE_YAW_ERRORS];
    int32_t trim[FIXED_OUTPUT_PAIR];
    fixed_reference_filter_t height, heading;
    int32_t slack;          /* m */
    int32_t period;         /* 2^-36 s */
    int32_t design_voltage; /* V */
    int32_t per_volt;       /* 2^-30 of 1 / design_voltage */
    int32_t voltage_blend;  /* 2^-30 */
} fixed_heave_yaw_t;

typedef struct {
    fixed_coefficient_t update[FIXED_ROLL_PITCH_ORDER][14];
    fixed_coefficient_t output[FIXED_OUTPUT_PAIR][12];
    fixed_coefficient_t start[FIXED_ROLL_PITCH_ORDER][6];
    uint8_t update_down[FIXED_ROLL_PITCH_ORDER];
    uint8_t output_down[FIXED_OUTPUT_PAIR];
    uint8_t start_down[FIXED_ROLL_PITCH_ORDER];
    int32_t kept;
    int32_t limit[FIXED_ROLL_PITCH_ERRORS];
    int32_t trim[FIXED_OUTPUT_PAIR];
    int32_t tilt_limit;
} fixed_roll_pitch_t;

typedef struct {
    fixed_coefficient_t update[FIXED_POSITION_ORDER][10];
    fixed_coefficient_t output[FIXED_OUTPUT_PAIR][8];
    uint8_t update_down[FIXED_POSITION_ORDER];
    uint8_t output_down[FIXED_OUTPUT_PAIR];
    int32_t kept;
    int32_t limit[FIXED_POSITION_ERRORS];
    int32_t position_gain;
    int32_t speed_limit;
    int32_t tilt_limit;
    int32_t per_gravity; /* 2^-30 s2/m */
} fixed_position_t;

typedef struct {
    fixed_heave_yaw_t heave_yaw;
    fixed_roll_pitch_t roll_pitch;
    fixed_position_t position;
} fixed_gains_t;

typedef struct {
    int64_t value; /* filtered reference, 2^-40 */
    int32_t rate;  /* 2^-24 */
} fixed_reference_t;

typedef struct {
    int32_t heave_yaw[FIXED_HEAVE_YAW_ORDER];
    int32_t roll_pitch[FIXED_ROLL_PITCH_ORDER];
    int32_t position[FIXED_POSITION_ORDER];
    fixed_reference_t height, heading;
    int32_t origin_z, origin_psi;
    int32_t voltage;    /* filtered, 2^-24 V */
    uint32_t overflows; /* number of overflows; zero by the proof */
} fixed_controllers_t;

typedef struct {
    int32_t position[3], velocity[3], attitude[3], rates[3], voltage; /* as motion_estimate_t of controllers.h */
} fixed_motion_t;

typedef struct {
    int32_t position[3], velocity[3], acceleration[3];
} fixed_path_t;

typedef struct {
    int32_t motor_input[2]; /* upper, lower; 0..FIXED_ONE */
    int32_t servo_input[2]; /* -FIXED_ONE..FIXED_ONE */
} fixed_actuators_t;

/* Constants of the exported vehicle: tables_fixed.c. */
extern const fixed_gains_t mufly_fixed_gains;
extern const int32_t mufly_fixed_rate_Hz;
extern const int32_t mufly_fixed_position_divider;

/* As the functions in controllers.h. Initialise a fixed_controllers_t with zeros. */
void fixed_engage_heave_yaw(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                  const int32_t motor_input[2]);
void fixed_engage_roll_pitch(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now);
void fixed_compute_tilt_command(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                const fixed_path_t *reference, int32_t tilt[2]);
void fixed_step(const fixed_gains_t *g, fixed_controllers_t *c, const fixed_motion_t *now,
                const int32_t heave_yaw[4], bool flying, const int32_t tilt[2], fixed_actuators_t *out);

#endif
