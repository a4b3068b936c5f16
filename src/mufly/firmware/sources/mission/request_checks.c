#include "mission/request_checks.h"

#define MIN_GO_AROUND_HEIGHT_M REAL(0.4)
#define MIN_TAKE_OFF_ABORT_HEIGHT_M REAL(0.2)

typedef enum { DENY, ALLOW_ALWAYS, ALLOW_AT_REST, ALLOW_GROUNDED, ALLOW_ARMED, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_FAILED, ALLOW_GO_AROUND, ALLOW_LIFTED, ALLOW_MOTORS_OFF, ALLOW_MISSION_WAITING } condition_t;

static const condition_t request_table[REQUEST_COUNT][MISSION_STATE_COUNT] = {
    /* init, take-off, hover, waypoint, obstacle, landing, rc, offboard */
    {ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST, ALLOW_AT_REST},                         /* arm */
    {ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED, ALLOW_GROUNDED},                 /* disarm */
    {ALLOW_ARMED, DENY, DENY, DENY, DENY, DENY, DENY, DENY},                                         /* take-off */
    {ALLOW_ARMED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_LIFTED},                                        /* start */
    {DENY, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_GO_AROUND, DENY, ALLOW_LIFTED},                                         /* pause */
    {DENY, ALLOW_LIFTED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_LIFTED},                                       /* go-to */
    {DENY, ALLOW_LIFTED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_LIFTED},                                       /* return */
    {DENY, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_ALWAYS, DENY, ALLOW_UNLESS_FAILED},                                        /* land */
    {ALLOW_ALWAYS, ALLOW_LIFTED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, ALLOW_UNLESS_FAILED, DENY, DENY, ALLOW_ALWAYS},                                      /* offboard */
    {ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND, ALLOW_UNLESS_BLIND},                                                 /* sticks */
    {ALLOW_MOTORS_OFF, ALLOW_MISSION_WAITING, ALLOW_MISSION_WAITING, ALLOW_MISSION_WAITING, ALLOW_MISSION_WAITING, DENY, DENY, DENY},                                         /* load */
    {ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS, ALLOW_ALWAYS},                                 /* stop */
};

bool check_request(int32_t ask, const mission_t *s, real_t height, bool armed, bool flying)
{
    const bool off = s->motors == MOTORS_OFF;
    const bool seen = s->motors != MOTORS_BLIND;
    const bool knows = seen && (s->outcome != OUTCOME_FAILED);
    bool can = false;

    switch (request_table[ask][s->state]) {
    case ALLOW_ALWAYS:
        can = true;
        break;
    case ALLOW_AT_REST:
        can = armed || off;
        break;
    case ALLOW_GROUNDED:
        can = !flying;
        break;
    case ALLOW_ARMED:
        can = armed && off;
        break;
    case ALLOW_UNLESS_BLIND:
        can = seen;
        break;
    case ALLOW_UNLESS_FAILED:
        can = knows;
        break;
    case ALLOW_GO_AROUND: /* high enough to abort a landing */
        can = knows && (s->motors == MOTORS_FLY) && !(height <= MIN_GO_AROUND_HEIGHT_M);
        break;
    case ALLOW_LIFTED: /* safely off the floor */
        can = knows && (s->motors != MOTORS_SPIN_UP) && !(height < MIN_TAKE_OFF_ABORT_HEIGHT_M);
        break;
    case ALLOW_MOTORS_OFF:
        can = off;
        break;
    case ALLOW_MISSION_WAITING: /* hovers or flies by user signals, no mission in progress */
        can = knows && s->user_in_control && ((s->motors == MOTORS_SPIN_UP) || (s->motors == MOTORS_FLY));
        break;
    default:
        can = false;
        break;
    }
    return can;
}

bool is_request_permitted(int32_t ask, const mission_t *s, const estimate_t *m)
{
    return check_request(ask, s, s->home_position[2] - m->motion.position[2], true, s->state != STATE_INIT);
}
