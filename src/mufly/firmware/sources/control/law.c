#include "control/law.h"

#include "control/linear.h"
#include "control/mixer.h"

/* value += change; the rounding error is added the next time. */
static void add_with_rounding_error(real_t *value, real_t *dropped, real_t change)
{
    const real_t more = change + *dropped;
    const real_t total = *value + more;

    *dropped = more - (total - *value);
    *value = total;
}

#if ROLL_PITCH_SCHEDULED
/* Add the share of the outputs that belong to the scheduled speed; none of it for a speed that is no number. */
static void add_scheduled_output(const roll_pitch_gains_t *g, const real_t x[ROLL_PITCH_ORDER],
                                 const real_t e[ROLL_PITCH_ERRORS], real_t speed, real_t u[OUTPUT_PAIR])
{
    real_t share = g->schedule * (speed * speed);

    if (share > REAL(0.0)) {
        real_t forward[OUTPUT_PAIR];

        share = (share > REAL(1.0)) ? REAL(1.0) : share;
        linear_output(ROLL_PITCH_ORDER, ROLL_PITCH_ERRORS, &g->C_forward_change[0][0], &g->D_forward_change[0][0], x, e, forward);
        for (int32_t i = 0; i < OUTPUT_PAIR; i++) {
            u[i] += share * forward[i];
        }
    }
}
#endif

/* Step a reference filter: critically damped near the target, on a braking parabola far from it. */
static void filter_reference(real_t *value, real_t *dropped, real_t *rate, real_t target, real_t target_rate,
                  real_t bandwidth, real_t acceleration, real_t speed, real_t period)
{
    const real_t gap = target - *value;
    const real_t braking = REAL(0.5) * acceleration; /* half the acceleration brakes in time */
    const real_t slope = REAL(0.5) * bandwidth;
    const real_t linear = braking / (slope * slope);
    real_t wanted = slope * gap;

    if (real_abs(gap) > linear) {
        wanted = real_copysign(real_sqrt((REAL(2.0) * braking) * (real_abs(gap) - (REAL(0.5) * linear))), gap);
    }
    wanted = real_clip(wanted + target_rate, -speed, speed);
    *rate += period * real_clip((REAL(2.0) * bandwidth) * (wanted - *rate), -acceleration, acceleration);
    add_with_rounding_error(value, dropped, period * *rate);
}

/* rate limited to the range between zero and whole. */
static real_t limit_lead_rate(real_t rate, real_t whole)
{
    return (whole > REAL(0.0)) ? real_clip(rate, REAL(0.0), whole) : real_clip(rate, whole, REAL(0.0));
}

/* A reading far from the design voltage is a sensor fault. */
static real_t limit_voltage(const heave_yaw_gains_t *g, real_t voltage)
{
    return real_clip(voltage, REAL(0.5) * g->design_voltage, REAL(1.5) * g->design_voltage);
}

void heave_yaw_init(const heave_yaw_gains_t *g, heave_yaw_state_t *state, const real_t measured[3],
                     const real_t motor_input[OUTPUT_PAIR], real_t voltage)
{
    const real_t volts = limit_voltage(g, voltage);
    const real_t e[HEAVE_YAW_ERRORS] = {REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), -measured[2]};
    real_t u[OUTPUT_PAIR];

    for (int32_t i = 0; i < OUTPUT_PAIR; i++) { /* lower, upper */
        u[i] = ((motor_input[1 - i] * volts) / g->design_voltage) - g->trim[i];
    }
    linear_init(HEAVE_YAW_ORDER, HEAVE_YAW_ERRORS, &g->E[0][0], &g->U[0][0], e, u, state->x);
    for (int32_t i = 0; i < HEAVE_YAW_ORDER; i++) {
        state->dropped[i] = REAL(0.0);
    }
    state->dropped_z = REAL(0.0);
    state->dropped_psi = REAL(0.0);
    state->shaped_z = measured[0];
    state->shaped_w = REAL(0.0);
    state->shaped_psi = measured[1];
    state->shaped_r = REAL(0.0);
    state->origin_z = measured[0];
    state->origin_psi = measured[1];
    state->voltage = volts;
}

void limit_heave_reference(const heave_yaw_gains_t *g, heave_yaw_state_t *state, real_t z)
{
    const real_t trails = z - state->shaped_z;
    const real_t left = REAL(1.0) - (real_abs(trails) / g->heave_tracking_error_limit);
    const real_t fastest = (left > REAL(0.0)) ? (g->heave_speed * left) : REAL(0.0);
    const real_t away = (trails < REAL(0.0)) ? state->shaped_w : -state->shaped_w;

    if (left < REAL(0.0)) {
        state->shaped_z = z - real_copysign(g->heave_tracking_error_limit, trails);
        state->dropped_z = REAL(0.0);
    }
    if ((left < REAL(0.0)) || (away > fastest)) {
        const real_t brake = (REAL(2.0) * g->heave_acceleration) * g->period;
        const real_t less = real_clip(away - fastest, REAL(0.0), brake);

        state->shaped_w += (trails < REAL(0.0)) ? -less : less;
    }
}

void heave_yaw_step(const heave_yaw_gains_t *g, heave_yaw_state_t *state, const real_t reference[4],
                    const real_t measured[3], real_t voltage, real_t motor_input[OUTPUT_PAIR])
{
    real_t e[HEAVE_YAW_ERRORS];
    real_t u[OUTPUT_PAIR];
    real_t excess[OUTPUT_PAIR];
    real_t change[HEAVE_YAW_ORDER];
    real_t top;
    real_t half;
    real_t mean;

    filter_reference(&state->shaped_z, &state->dropped_z, &state->shaped_w, reference[0], reference[2], g->heave_bandwidth,
          g->heave_acceleration, g->heave_speed, g->period);
    filter_reference(&state->shaped_psi, &state->dropped_psi, &state->shaped_r, reference[1], reference[3], g->yaw_bandwidth,
          g->yaw_acceleration, g->yaw_rate, g->period);
    state->voltage += g->voltage_blend * (limit_voltage(g, voltage) - state->voltage);
    top = state->voltage / g->design_voltage;

    /* Lead only on the reference's own rate: a bare step must not be sharpened. */
    e[0] = (state->shaped_z + (g->heave_lead * limit_lead_rate(state->shaped_w, reference[2]))) - state->origin_z;
    e[1] = (state->shaped_psi + (g->yaw_lead * limit_lead_rate(state->shaped_r, reference[3]))) - state->origin_psi;
    e[2] = state->origin_z - measured[0];
    e[3] = state->origin_psi - measured[1];
    e[4] = -measured[2];
    linear_output(HEAVE_YAW_ORDER, HEAVE_YAW_ERRORS, &g->C[0][0], &g->D[0][0], state->x, e, u);
    u[0] += g->trim[0];
    u[1] += g->trim[1];
    mixer_allocate(u, top, &mean, &half);
    excess[0] = (mean - half) - u[0];
    excess[1] = (mean + half) - u[1];
    linear_change(HEAVE_YAW_ORDER, HEAVE_YAW_ERRORS, &g->F[0][0], &g->B[0][0], &g->M[0][0], state->x, e, excess,
                  change);
    for (int32_t i = 0; i < HEAVE_YAW_ORDER; i++) {
        add_with_rounding_error(&state->x[i], &state->dropped[i], change[i]);
    }
    /* By rounding, top - |half| + |half| may exceed top. */
    motor_input[0] = real_clip((mean + half) / top, REAL(0.0), REAL(1.0));
    motor_input[1] = real_clip((mean - half) / top, REAL(0.0), REAL(1.0));
}

void roll_pitch_init(const roll_pitch_gains_t *g, roll_pitch_state_t *state,
                      const real_t measured[ROLL_PITCH_ERRORS])
{
    const real_t u[OUTPUT_PAIR] = {REAL(0.0), REAL(0.0)};
    real_t e[ROLL_PITCH_ERRORS];

    for (int32_t i = 0; i < ROLL_PITCH_ERRORS; i++) {
        e[i] = -measured[i];
    }
    linear_init(ROLL_PITCH_ORDER, ROLL_PITCH_ERRORS, &g->E[0][0], &g->U[0][0], e, u, state->x);
}

void roll_pitch_step(const roll_pitch_gains_t *g, roll_pitch_state_t *state, const real_t reference[OUTPUT_PAIR],
                     const real_t measured[ROLL_PITCH_MEASURED], real_t servo_input[OUTPUT_PAIR])
{
    real_t e[ROLL_PITCH_ERRORS];
    real_t excess[OUTPUT_PAIR];
    real_t change[ROLL_PITCH_ORDER];

    for (int32_t i = 0; i < OUTPUT_PAIR; i++) {
        e[i] = real_clip(reference[i], -g->tilt_limit, g->tilt_limit) - measured[i];
        e[i + 2] = -measured[i + 2];
    }
    linear_output(ROLL_PITCH_ORDER, ROLL_PITCH_ERRORS, &g->C[0][0], &g->D[0][0], state->x, e, servo_input);
#if ROLL_PITCH_SCHEDULED
    add_scheduled_output(g, state->x, e, measured[ROLL_PITCH_ERRORS], servo_input);
#endif
    for (int32_t i = 0; i < OUTPUT_PAIR; i++) {
        const real_t wanted = servo_input[i] + g->trim[i];
        servo_input[i] = real_clip(wanted, REAL(-1.0), REAL(1.0));
        excess[i] = servo_input[i] - wanted;
    }
    linear_change(ROLL_PITCH_ORDER, ROLL_PITCH_ERRORS, &g->F[0][0], &g->B[0][0], &g->M[0][0], state->x, e, excess,
                  change);
    for (int32_t i = 0; i < ROLL_PITCH_ORDER; i++) {
        state->x[i] += change[i];
    }
}
