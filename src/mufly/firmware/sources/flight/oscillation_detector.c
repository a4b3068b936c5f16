#include "flight/oscillation_detector.h"

#include <stddef.h>

#define MIN_SWING_INPUT_FRACTION REAL(0.5)
#define MIN_OSCILLATION_PERIODS 4
#define MIN_OSCILLATION_DURATION_S REAL(2.0)
#define MAX_OSCILLATION_PERIOD_S REAL(4.0)
#define MAX_PERIOD_RATIO REAL(1.6)

static void turning_points_reset(turning_points_t *t, real_t back)
{
    t->reversal_threshold = back;
    t->is_rising = true;
    t->last_extreme = -REAL_INFINITY;
    t->extreme_time_s = REAL(0.0);
    t->turn_count = 0;
}

void oscillation_detector_reset(oscillation_detector_t *o)
{
    static const real_t ranges[OSCILLATION_INPUTS] = {REAL(1.0), REAL(1.0), REAL(2.0), REAL(2.0)};
    static const real_t asked[STEERING_SIGNALS] = {REAL(0.1), REAL(0.1),  REAL(0.1),
                                                    REAL(0.2), REAL(0.05), REAL(0.05)};

    for (int32_t i = 0; i < OSCILLATION_INPUTS; i++) {
        turning_points_reset(&o->inputs[i].turning_points, MIN_SWING_INPUT_FRACTION * ranges[i]);
        o->inputs[i].start_s = REAL(0.0);
        o->inputs[i].half_period_count = 0;
        o->inputs[i].period_s = REAL(0.0);
        o->inputs[i].lowest_value = REAL(0.0);
        o->inputs[i].highest_value = REAL(0.0);
    }
    for (int32_t i = 0; i < STEERING_SIGNALS; i++) {
        turning_points_reset(&o->asked[i], asked[i]);
    }
}

static bool turning_points_step(turning_points_t *t, real_t time_s, real_t value)
{
    const real_t ahead = t->is_rising ? (value - t->last_extreme) : (t->last_extreme - value);
    bool turned = false;

    if (ahead > REAL(0.0)) {
        t->last_extreme = value;
        t->extreme_time_s = time_s;
    } else if (!(-ahead < t->reversal_threshold)) {
        if (t->turn_count == 3) {
            t->turn_times_s[0] = t->turn_times_s[1];
            t->turn_times_s[1] = t->turn_times_s[2];
            t->turn_count = 2;
        }
        t->turn_times_s[t->turn_count] = t->extreme_time_s;
        t->turn_count++;
        t->is_rising = !t->is_rising;
        t->last_extreme = value;
        t->extreme_time_s = time_s;
        turned = true;
    } else {
        /* returning */
    }
    return turned;
}

static void clear_half_periods(input_oscillation_t *s)
{
    s->half_period_count = 0;
    s->period_s = REAL(0.0);
    s->turning_points.turn_count = 0;
}

static void add_turning_point(input_oscillation_t *s, real_t value)
{
    if (s->turning_points.turn_count == 3) {
        const real_t period = s->turning_points.turn_times_s[2] - s->turning_points.turn_times_s[0];
        const bool even = (period <= (MAX_PERIOD_RATIO * s->period_s)) && (s->period_s <= (MAX_PERIOD_RATIO * period));

        if ((period > MAX_OSCILLATION_PERIOD_S) || ((s->half_period_count > 0) && !even)) {
            clear_half_periods(s);
        } else if (s->half_period_count > 0) {
            s->half_period_count++;
            s->period_s = period;
        } else {
            s->half_period_count = 2;
            s->period_s = period;
            s->start_s = s->turning_points.turn_times_s[0];
            s->lowest_value = value;
            s->highest_value = value;
        }
    }
}

void oscillation_detector_step(oscillation_detector_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out)
{
    bool steered = false;

    out->is_present = false;
    out->input_name = 0;
    out->start_s = REAL(0.0);
    out->duration_s = REAL(0.0);
    out->swing = REAL(0.0);
    out->frequency_Hz = REAL(0.0);
    if (asked != NULL) {
        for (int32_t i = 0; i < STEERING_SIGNALS; i++) {
            const bool turned = turning_points_step(&o->asked[i], time_s, asked[i]);

            steered = steered || turned;
        }
    }
    for (int32_t i = 0; i < OSCILLATION_INPUTS; i++) {
        input_oscillation_t *s = &o->inputs[i];
        bool turned;
        real_t lasting = REAL(0.0);

        if (steered) {
            clear_half_periods(s);
        }
        turned = turning_points_step(&s->turning_points, time_s, inputs[i]);
        if (s->half_period_count > 0) {
            s->lowest_value = real_min(s->lowest_value, inputs[i]);
            s->highest_value = real_max(s->highest_value, inputs[i]);
        }
        if (turned) {
            add_turning_point(s, inputs[i]);
        } else if ((s->half_period_count > 0) && ((time_s - s->turning_points.turn_times_s[s->turning_points.turn_count - 1]) > MAX_OSCILLATION_PERIOD_S)) {
            clear_half_periods(s);
        } else {
            /* continues */
        }
        if (s->half_period_count > 0) {
            lasting = s->turning_points.turn_times_s[s->turning_points.turn_count - 1] - s->start_s;
        }
        if ((s->half_period_count >= (2 * MIN_OSCILLATION_PERIODS)) && (lasting >= MIN_OSCILLATION_DURATION_S) && (!out->is_present || (lasting > out->duration_s))) {
            out->is_present = true;
            out->input_name = i;
            out->start_s = s->start_s;
            out->duration_s = lasting;
            out->swing = s->highest_value - s->lowest_value;
            out->frequency_Hz = REAL(1.0) / s->period_s;
        }
    }
}
