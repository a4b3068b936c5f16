#include "policy/policy.h"

#define MAX_COLLECTIVE_DUTY_OFFSET REAL(0.3)
#define MAX_YAW_DUTY_OFFSET REAL(0.15)

static real_t policy_tanh(real_t x)
{
    const real_t e = exp_decay(REAL(2.0) * real_abs(x));
    const real_t size = (REAL(1.0) - e) / (REAL(1.0) + e);

    return (x < REAL(0.0)) ? -size : size;
}

static real_t policy_activate(int32_t activation, real_t x)
{
    real_t y = x;

    if (activation == (int32_t)POLICY_TANH) {
        y = policy_tanh(x);
    } else if ((activation == (int32_t)POLICY_RELU) && !(x > REAL(0.0))) {
        y = REAL(0.0);
    } else {
        /* linear */
    }
    return y;
}

void policy_evaluate(const real_t observation[POLICY_INPUTS], real_t action[POLICY_ACTION_SIZE])
{
    real_t x[POLICY_WIDEST];
    real_t y[POLICY_WIDEST];
    int32_t place = 0;
    int32_t row = 0;

    for (int32_t i = 0; i < POLICY_INPUTS; i++) {
        const real_t seen =
            real_is_nan(observation[i]) ? REAL(0.0) : real_clip(observation[i], policy_low[i], policy_high[i]);

        x[i] = real_clip((seen - policy_mean[i]) / policy_scale[i], -policy_limit, policy_limit);
    }
    for (int32_t k = 0; k < POLICY_LAYERS; k++) {
        for (int32_t j = 0; j < policy_sizes[k + 1]; j++) {
            real_t total = policy_biases[row];

            for (int32_t i = 0; i < policy_sizes[k]; i++) {
                total = total + (policy_weights[place] * x[i]);
                place += 1;
            }
            row += 1;
            y[j] = policy_activate(policy_activations[k], total);
        }
        for (int32_t j = 0; j < policy_sizes[k + 1]; j++) {
            x[j] = y[j];
        }
    }
    for (int32_t i = 0; i < POLICY_ACTION_SIZE; i++) {
        action[i] = real_clip(x[i], REAL(-1.0), REAL(1.0));
    }
}

#if POLICY_INPUTS == 20
/* The same angle, in the sine and cosine that the observation needs. */
typedef struct {
    real_t s;
    real_t c;
} direction_t;

static direction_t direction_of(real_t angle)
{
    direction_t d;

    sine_cosine(angle, &d.s, &d.c);
    return d;
}

void policy_step(const motion_estimate_t *now, const path_t *reference, real_t heading,
                 real_t action[POLICY_ACTION_SIZE], actuators_t *out)
{
    const direction_t roll = direction_of(now->attitude[0]);
    const direction_t pitch = direction_of(now->attitude[1]);
    const direction_t yaw = direction_of(now->attitude[2]);
    const direction_t wanted = direction_of(heading);
    real_t error[3];
    real_t relative[3];
    real_t seen[POLICY_INPUTS];
    real_t collective;
    real_t turn;

    for (int32_t i = 0; i < 3; i++) {
        error[i] = reference->position[i] - now->position[i];
        relative[i] = now->velocity[i] - reference->velocity[i];
        seen[9 + i] = now->rates[i];
    }
    seen[0] = (yaw.c * error[0]) + (yaw.s * error[1]);
    seen[1] = (yaw.c * error[1]) - (yaw.s * error[0]);
    seen[2] = error[2];
    seen[3] = (yaw.c * relative[0]) + (yaw.s * relative[1]);
    seen[4] = (yaw.c * relative[1]) - (yaw.s * relative[0]);
    seen[5] = relative[2];
    seen[6] = -pitch.s;
    seen[7] = roll.s * pitch.c;
    seen[8] = roll.c * pitch.c;
    seen[12] = (wanted.s * yaw.c) - (wanted.c * yaw.s);
    seen[13] = (wanted.c * yaw.c) + (wanted.s * yaw.s);
    seen[14] = (now->voltage / policy_nominal_voltage) - REAL(1.0);
    for (int32_t i = 0; i < POLICY_ACTION_SIZE; i++) {
        seen[15 + i] = action[i];
    }
    seen[19] = -now->position[2];
    policy_evaluate(seen, action);
    collective = MAX_COLLECTIVE_DUTY_OFFSET * action[0];
    turn = MAX_YAW_DUTY_OFFSET * action[1];
    out->motor_input[0] = real_clip((policy_trim[0] + collective) + turn, REAL(0.0), REAL(1.0));
    out->motor_input[1] = real_clip((policy_trim[1] + collective) - turn, REAL(0.0), REAL(1.0));
    out->servo_input[0] = action[2];
    out->servo_input[1] = action[3];
}
#endif
