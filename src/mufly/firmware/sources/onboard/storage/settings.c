#include "onboard/storage/settings.h"

#define VERSION 1U
#define NAME_WORDS 4
#define ENTRY (NAME_WORDS + 1)
#define MISSION_HEAD 3 /* digest of the image's mission; count, end and shape; take-off height */
#define WAYPOINT 7
#define MAX_WAIT_S REAL(3600.0)

typedef union {
    float number;
    uint32_t bits;
} stored_bits_t;

static uint32_t to_bits(real_t value)
{
    stored_bits_t as;

    as.number = (float)value;
    return as.bits;
}

static real_t from_bits(uint32_t bits)
{
    stored_bits_t as;

    as.bits = bits;
    return (real_t)as.number;
}

/* Parameters and calibration */

/* Values of the image. */
static real_t default_value(int32_t k)
{
    plan_t plan = mufly_plan;
    supervisor_settings_t supervisor = mufly_supervisor;
    calibration_t calibration;
    rc_settings_t rc;
    const tunables_t t = {&plan, &supervisor, &calibration, &rc};

    calibration_reset(&calibration);
    rc_reset_settings(&rc);
    return parameter_get(&t, k);
}

void settings_reset(settings_t *s, const tunables_t *t, bool parameters, bool calibration)
{
    for (int32_t k = 0; k < (int32_t)PARAMETERS; k++) {
        if (parameter_calibrates(k) ? calibration : parameters) {
            (void)parameter_set(t, k, default_value(k));
            s->changed[k] = false;
        }
    }
    s->owes_parameters = s->owes_parameters || parameters;
    s->owes_calibration = s->owes_calibration || calibration;
}

static bool store_values(settings_t *s, const tunables_t *t, int32_t kind)
{
    uint32_t payload[ENTRY * PARAMETERS];
    int32_t count = 0;
    int32_t answer;

    for (int32_t k = 0; k < (int32_t)PARAMETERS; k++) {
        if (s->changed[k] && (parameter_calibrates(k) == (kind == (int32_t)STORED_CALIBRATION))) {
            const char *name = parameter_name(k);
            bool ended = false;

            for (int32_t i = 0; i < PARAMETER_NAME; i++) {
                const int32_t at = count + (i / 4);
                const uint32_t shift = 8U * ((uint32_t)i % 4U);

                ended = ended || (name[i] == '\0');
                payload[at] = ((shift == 0U) ? 0U : payload[at]) | ((ended ? 0U : (uint32_t)(uint8_t)name[i]) << shift);
            }
            payload[count + NAME_WORDS] = to_bits(parameter_get(t, k));
            count += ENTRY;
        }
    }
    answer = storage_write(&s->storage, kind, VERSION, payload, count);
    if ((answer != STORAGE_DONE) && (answer != STORAGE_ABSENT)) {
        s->faults |= SETTINGS_NOT_STORED;
    }
    return (answer == STORAGE_DONE) || (answer == STORAGE_ABSENT);
}

static void load_values(settings_t *s, const tunables_t *t, int32_t kind)
{
    uint32_t payload[ENTRY * PARAMETERS];
    const int32_t count = storage_read(&s->storage, kind, VERSION, payload, (int32_t)(ENTRY * PARAMETERS));

    if ((count < 0) && (s->storage.place[kind] > 0)) {
        s->faults |= SETTINGS_OTHER_VERSION;
    }
    for (int32_t at = 0; (at + ENTRY) <= count; at += ENTRY) {
        uint8_t name[PARAMETER_NAME];
        int32_t k;

        for (int32_t i = 0; i < PARAMETER_NAME; i++) {
            name[i] = (uint8_t)((payload[at + (i / 4)] >> (8U * ((uint32_t)i % 4U))) & 0xFFU);
        }
        k = parameter_find(name);
        if ((k >= 0) && (parameter_calibrates(k) == (kind == (int32_t)STORED_CALIBRATION)) &&
            parameter_set(t, k, from_bits(payload[at + NAME_WORDS]))) {
            s->changed[k] = true;
        } else {
            s->faults |= SETTINGS_REFUSED;
        }
    }
}

int32_t settings_set(settings_t *s, const tunables_t *t, int32_t k, real_t value, bool on_floor)
{
    const bool calibrates = parameter_calibrates(k);
    int32_t answer = SETTING_DONE;

    if (calibrates && !on_floor) {
        answer = SETTING_ON_FLOOR_ONLY;
    } else if (!parameter_set(t, k, value)) {
        answer = SETTING_OUT_OF_BOUNDS;
    } else {
        s->changed[k] = true;
        s->has_failed = false;
        s->owes_parameters = s->owes_parameters || !calibrates;
        s->owes_calibration = s->owes_calibration || calibrates;
        if (on_floor) {
            (void)settings_store(s, t);
        }
    }
    return answer;
}

bool settings_store(settings_t *s, const tunables_t *t)
{
    if (s->owes_parameters) {
        s->owes_parameters = !store_values(s, t, STORED_PARAMETERS);
    }
    if (s->owes_calibration) {
        s->owes_calibration = !store_values(s, t, STORED_CALIBRATION);
    }
    s->has_failed = s->owes_parameters || s->owes_calibration;
    return !s->has_failed;
}

bool settings_are_due(const settings_t *s)
{
    return (s->owes_parameters || s->owes_calibration) && !s->has_failed;
}

/* Mission */

static int32_t pack_mission(const plan_t *p, uint32_t digest, uint32_t out[MISSION_HEAD + (WAYPOINT * MISSION_WAYPOINTS)])
{
    out[0] = digest;
    out[1] = (uint32_t)p->count | ((uint32_t)p->at_end << 16U) | (p->spline ? (1UL << 24U) : 0U);
    out[2] = to_bits(p->take_off_height);
    for (int32_t k = 0; k < p->count; k++) {
        const waypoint_t *w = &p->waypoint[k];
        uint32_t *to = &out[MISSION_HEAD + (WAYPOINT * k)];

        for (int32_t i = 0; i < 3; i++) {
            to[i] = to_bits(w->position[i]);
        }
        to[3] = to_bits(w->wait_s);
        to[4] = to_bits(w->speed);
        to[5] = w->has_heading ? 1U : 0U;
        to[6] = to_bits(w->heading);
    }
    return MISSION_HEAD + (WAYPOINT * p->count);
}

/* Checksum of the mission of this image: a mission that replaced another one's is not loaded. */
static uint32_t image_digest(void)
{
    uint32_t words[MISSION_HEAD + (WAYPOINT * MISSION_WAYPOINTS)];

    return storage_crc(words, pack_mission(&mufly_plan, 0U, words));
}

static bool is_valid_waypoint(const plan_t *p, const waypoint_t *w)
{
    const bool placed = (w->position[2] <= -MIN_WAYPOINT_HEIGHT_M) && (w->position[2] >= -MAX_HEIGHT_M) &&
                        (real_hypot(w->position[0], w->position[1]) <= MAX_COORDINATE_M);
    const bool timed = (w->wait_s >= REAL(0.0)) && (w->wait_s <= MAX_WAIT_S) && (w->speed > REAL(0.0)) &&
                       (w->speed <= (p->limits.speed * REAL(1.000001)));

    return placed && timed && (real_abs(w->heading) <= REAL(1e3));
}

/* Unpack a mission into a plan; return whether all of it is within its bounds. */
static bool unpack_mission(const uint32_t words[], int32_t count, plan_t *p)
{
    const uint32_t waypoints = words[1] & 0xFFFFU;
    const uint32_t at_end = (words[1] >> 16U) & 0xFFU;
    const real_t height = from_bits(words[2]);
    bool good = (waypoints <= (uint32_t)MISSION_WAYPOINTS) && (at_end <= (uint32_t)AT_END_RETURN) &&
                (count == (MISSION_HEAD + (WAYPOINT * (int32_t)waypoints))) && (height >= MIN_WAYPOINT_HEIGHT_M) &&
                (height <= MAX_HEIGHT_M);

    if (good) {
        p->count = (int32_t)waypoints;
        p->at_end = (int32_t)at_end;
        p->spline = (words[1] >> 24U) != 0U;
        p->take_off_height = height;
    }
    for (int32_t k = 0; good && (k < p->count); k++) {
        const uint32_t *from = &words[MISSION_HEAD + (WAYPOINT * k)];
        waypoint_t *w = &p->waypoint[k];

        for (int32_t i = 0; i < 3; i++) {
            w->position[i] = from_bits(from[i]);
        }
        w->wait_s = from_bits(from[3]);
        w->speed = from_bits(from[4]);
        w->has_heading = from[5] != 0U;
        w->heading = from_bits(from[6]);
        good = is_valid_waypoint(p, w);
    }
    return good;
}

static void load_mission(settings_t *s, plan_t *plan)
{
    uint32_t words[MISSION_HEAD + (WAYPOINT * MISSION_WAYPOINTS)];
    const int32_t most = MISSION_HEAD + (WAYPOINT * MISSION_WAYPOINTS);
    const int32_t count = storage_read(&s->storage, STORED_MISSION, VERSION, words, most);

    if (count < MISSION_HEAD) {
        s->faults |= (s->storage.place[STORED_MISSION] > 0) ? SETTINGS_OTHER_VERSION : 0U;
    } else if (words[0] != image_digest()) {
        s->faults |= SETTINGS_OTHER_MISSION;
    } else if (!unpack_mission(words, count, plan)) {
        s->faults |= SETTINGS_REFUSED;
        settings_reset_mission(plan);
    } else {
        /* loaded */
    }
}

bool settings_store_mission(settings_t *s, const plan_t *plan)
{
    uint32_t words[MISSION_HEAD + (WAYPOINT * MISSION_WAYPOINTS)];
    const int32_t count = pack_mission(plan, image_digest(), words);
    const int32_t answer = storage_write(&s->storage, STORED_MISSION, VERSION, words, count);

    if ((answer != STORAGE_DONE) && (answer != STORAGE_ABSENT)) {
        s->faults |= SETTINGS_NOT_STORED;
    }
    return (answer == STORAGE_DONE) || (answer == STORAGE_ABSENT);
}

void settings_reset_mission(plan_t *plan)
{
    plan->count = mufly_plan.count;
    for (int32_t k = 0; k < MISSION_WAYPOINTS; k++) {
        plan->waypoint[k] = mufly_plan.waypoint[k];
    }
    plan->at_end = mufly_plan.at_end;
    plan->spline = mufly_plan.spline;
    plan->take_off_height = mufly_plan.take_off_height;
}

void settings_reload(settings_t *s, const tunables_t *t)
{
    settings_reset(s, t, true, true);
    load_values(s, t, STORED_CALIBRATION);
    load_values(s, t, STORED_PARAMETERS);
    s->owes_parameters = false;
    s->owes_calibration = false;
}

/* The later record of mission and parameters counts: both hold the take-off height. */
void settings_begin(settings_t *s, const tunables_t *t)
{
    static const settings_t none;

    *s = none;
    calibration_reset(t->calibration);
    rc_reset_settings(t->rc);
    storage_open(&s->storage);
    if (s->storage.place[STORED_MISSION] < s->storage.place[STORED_PARAMETERS]) {
        load_mission(s, t->plan);
        load_values(s, t, STORED_PARAMETERS);
    } else {
        load_values(s, t, STORED_PARAMETERS);
        load_mission(s, t->plan);
    }
    load_values(s, t, STORED_CALIBRATION);
}
