/* What is made of an estimate before it is flown by, and of actuators: bridging, smoothing, doubts, oscillation.
 *
 * What it does and why: estimate.py of mufly.estimate; trust.py, oscillation.py of mufly.flight. */
#ifndef MUFLY_WATCH_H
#define MUFLY_WATCH_H

#include "belief.h"
#include "words.h"

/* Height uncertain by more is not known (m). */
#define HEIGHT_M REAL(0.3)

/* An estimate that cannot be right is bridged for a moment, then reported as lost. */
typedef struct {
    bool begun;
    real_t values[12]; /* position, velocity, attitude and rates as they came last */
    belief_t good;     /* finite, and on a clock that moves on */
    real_t lost_s;     /* for how long they have been missing or frozen */
    int32_t what;      /* which: 1 position, 2 velocity, 4 attitude, 8 rates; 0: all, frozen */
} watch_t;

void watch_start(watch_t *w);
void watch_step(watch_t *w, const belief_t *m, real_t period_s, const ring_t *ring);

/* Position and heading without the steps of a filter's corrections. */
typedef struct {
    bool begun;
    real_t last_s;
    real_t velocity[3]; /* the last one */
    real_t place[3];
    real_t heading;
} smooth_t;

void smooth_start(smooth_t *s);

/* Change an estimate to the one to control by; anew: nothing is controlled yet. */
void smooth_step(smooth_t *s, belief_t *m, bool anew);

/* What an estimate is not good enough for: go on, hold, land, sink. */
enum { DEMAND_NONE, DEMAND_HOLD, DEMAND_LAND, DEMAND_SINK };

typedef struct {
    int32_t demand;
    message_t why;
} doubt_t;

typedef struct {
    doubt_t now;
    real_t stood; /* variance of the horizontal position on the floor (m2) */
    bool wrong[BELIEF_SENSORS];
    real_t wrong_s[BELIEF_SENSORS]; /* since when */
    real_t since_s;
    bool certain;
    real_t certain_s;
    bool high; /* the height is uncertain */
    real_t high_s;
} doubts_t;

/* Whether the rates of turn are those of the rotor model, as gyroscopes say nothing that can be right. */
bool turns_unfelt(const belief_t *m);

void doubts_start(doubts_t *d, real_t stood);

/* Judge an estimate in the air; true if what is doubted has been said anew. */
bool doubts_step(doubts_t *d, const belief_t *m);

/* Whether actuators oscillate: even periods of half of an input's range, on end, that nobody asked for. */
#define OSCILLATION_INPUTS 4
#define OSCILLATION_ASKED 6

typedef struct {
    real_t back;
    bool rising;
    real_t extreme, at_s;
    int32_t count; /* of those below */
    real_t turned_s[3];
} turns_t;

typedef struct {
    turns_t turns;
    real_t since_s;
    int32_t count;
    real_t period_s, low, high;
} swings_t;

typedef struct {
    swings_t inputs[OSCILLATION_INPUTS]; /* motor upper, lower, servo 1, 2 */
    turns_t asked[OSCILLATION_ASKED];
} oscillations_t;

typedef struct {
    bool there;
    int32_t input;
    real_t since_s, lasting_s, size, frequency_Hz;
} oscillation_t;

void oscillations_start(oscillations_t *o);

/* Take one more instant. asked: velocity N, E, D, rate of turn, roll, pitch that somebody asks for; NULL: nobody. */
void oscillations_step(oscillations_t *o, real_t time_s, const real_t inputs[OSCILLATION_INPUTS],
                       const real_t asked[], oscillation_t *out);

#endif
