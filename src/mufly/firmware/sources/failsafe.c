#include "failsafe.h"

#include "mission.h"

#define SPIN_UP_SHARE REAL(0.9)
#define SINK_M_S REAL(0.9)
#define TOUCH_M_S REAL(0.5)
#define SINK_GAIN (REAL(1.0) / (REAL(2.0) * REAL(9.81) * REAL(0.4)))
#define SINK_LEAST REAL(0.92)
#define SINK_MOST REAL(1.08)
#define MARGIN_S REAL(1.0)

void failsafe_spin_up(const real_t hover_V[2], real_t elapsed_s, real_t battery_V, real_t out[2])
{
    const real_t share = SPIN_UP_SHARE * real_min(REAL(1.0), (REAL(2.0) * elapsed_s) / SPIN_UP_S);

    for (int32_t i = 0; i < 2; i++) {
        out[i] = real_min((share * hover_V[i]) / battery_V, REAL(1.0));
    }
}

void failsafe_ramp_down(const real_t released[2], real_t elapsed_s, real_t out[2])
{
    const real_t share = real_max(REAL(0.0), REAL(1.0) - (elapsed_s / RAMP_DOWN_S));

    for (int32_t i = 0; i < 2; i++) {
        out[i] = released[i] * share;
    }
}

void failsafe_sink(const real_t held_up_V[2], real_t share, real_t left_s, real_t battery_V, real_t out[2])
{
    const real_t faded = share * real_min(REAL(1.0), left_s / RAMP_DOWN_S);

    for (int32_t i = 0; i < 2; i++) {
        out[i] = real_min((faded * held_up_V[i]) / battery_V, REAL(1.0));
    }
}

real_t failsafe_sink_share(real_t height, real_t descent)
{
    const real_t wanted = real_min(real_max(height, TOUCH_M_S), SINK_M_S);

    return real_min(real_max(REAL(1.0) + (SINK_GAIN * (descent - wanted)), SINK_LEAST), SINK_MOST);
}

real_t failsafe_way_down_s(real_t height, real_t gravity)
{
    const real_t falls = (REAL(1.0) - (SINK_SHARE * SINK_SHARE)) * gravity;

    return real_sqrt((REAL(2.0) * real_max(REAL(0.0), height)) / falls) + MARGIN_S;
}
