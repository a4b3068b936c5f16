/* Learned policy: a fully connected network in place of the control law. Explanation: policy_network.py and
 * policy_controllers.py of mufly.flight.policy.
 *
 * A layer is  y = act(W x + b). Units SI and radians. The caller owns all state; nothing is allocated. */
#ifndef MUFLY_POLICY_H
#define MUFLY_POLICY_H

#include "flight/controllers.h"
#include "policy/policy_numbers.h"

#define POLICY_ACTION_SIZE 4

typedef enum { POLICY_LINEAR = 0, POLICY_TANH = 1, POLICY_RELU = 2 } policy_activation_t;

/* Numbers of the policy: policy_numbers.c. */
extern const int32_t policy_sizes[POLICY_LAYERS + 1];  /* inputs, then outputs of each layer */
extern const int32_t policy_activations[POLICY_LAYERS]; /* policy_activation_t */
extern const real_t policy_low[POLICY_INPUTS];         /* bounds of the observation */
extern const real_t policy_high[POLICY_INPUTS];
extern const real_t policy_mean[POLICY_INPUTS]; /* normalisation: (x - mean) / scale, within +-limit */
extern const real_t policy_scale[POLICY_INPUTS];
extern const real_t policy_limit;
extern const real_t policy_weights[POLICY_WEIGHTS]; /* layers after each other, by rows */
extern const real_t policy_biases[POLICY_BIASES];
extern const real_t policy_trim[POLICY_ACTION_SIZE]; /* motors upper, lower; servos 1, 2; for an action of zero */
extern const real_t policy_nominal_voltage;          /* V */
extern const real_t policy_period;                   /* s, between two calls of policy_step */

/* Action (-1..1: collective, turn to the right, forward, right) for an observation; NaN counts as zero. */
void policy_evaluate(const real_t observation[POLICY_INPUTS], real_t action[POLICY_ACTION_SIZE]);

#if POLICY_INPUTS == 20 /* the task hover */
/* Observe the error from a reference (position, velocity, heading) and act. action: that of the preceding call, at the
 * start zeros; it is overwritten. */
void policy_step(const motion_estimate_t *now, const path_t *reference, real_t heading,
                 real_t action[POLICY_ACTION_SIZE], actuators_t *out);
#endif

#endif
