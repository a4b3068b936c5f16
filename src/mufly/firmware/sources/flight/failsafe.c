#include "flight/failsafe.h"

#include "mission/machine/mission_state.h"

#define SPIN_UP_VOLTAGE_FRACTION REAL(0.9)
#define MAX_DESCENT_M_S REAL(0.9)
#define TOUCHDOWN_DESCENT_M_S REAL(0.5)
#define DESCENT_RATE_GAIN_S_M (REAL(1.0) / (REAL(2.0) * REAL(9.81) * REAL(0.4)))
#define MIN_DESCENT_VOLTAGE_FRACTION REAL(0.92)
#define MAX_DESCENT_VOLTAGE_FRACTION REAL(1.08)
#define DESCENT_MARGIN_S REAL(1.0)

void spin_up_motor_input(const real_t hover_V[2], real_t elapsed_s, real_t battery_V, real_t out[2])
{
    const real_t share = SPIN_UP_VOLTAGE_FRACTION * real_min(REAL(1.0), (REAL(2.0) * elapsed_s) / ROTOR_SPIN_UP_TIME_S);

    for (int32_t i = 0; i < 2; i++) {
        out[i] = real_min((share * hover_V[i]) / battery_V, REAL(1.0));
    }
}

void ramp_down_motor_input(const real_t released[2], real_t elapsed_s, real_t out[2])
{
    const real_t share = real_max(REAL(0.0), REAL(1.0) - (elapsed_s / ROTOR_RUN_DOWN_TIME_S));

    for (int32_t i = 0; i < 2; i++) {
        out[i] = released[i] * share;
    }
}

void blind_descent_motor_input(const real_t held_up_V[2], real_t share, real_t left_s, real_t battery_V, real_t out[2])
{
    const real_t faded = share * real_min(REAL(1.0), left_s / ROTOR_RUN_DOWN_TIME_S);

    for (int32_t i = 0; i < 2; i++) {
        out[i] = real_min((faded * held_up_V[i]) / battery_V, REAL(1.0));
    }
}

real_t blind_descent_voltage_fraction(real_t height, real_t descent)
{
    const real_t wanted = real_min(real_max(height, TOUCHDOWN_DESCENT_M_S), MAX_DESCENT_M_S);

    return real_min(real_max(REAL(1.0) + (DESCENT_RATE_GAIN_S_M * (descent - wanted)), MIN_DESCENT_VOLTAGE_FRACTION), MAX_DESCENT_VOLTAGE_FRACTION);
}

real_t blind_descent_time_s(real_t height, real_t gravity)
{
    const real_t falls = (REAL(1.0) - (BLIND_DESCENT_VOLTAGE_FRACTION * BLIND_DESCENT_VOLTAGE_FRACTION)) * gravity;

    return real_sqrt((REAL(2.0) * real_max(REAL(0.0), height)) / falls) + DESCENT_MARGIN_S;
}
