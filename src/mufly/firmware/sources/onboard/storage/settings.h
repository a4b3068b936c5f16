/* What a restart keeps: parameters, calibration and mission, each a record of onboard/storage/storage.h. Flash is written on the
 * floor with motors off, since an erase stops the processor; what is set in flight is stored after the landing. */
#ifndef MUFLY_SETTINGS_H
#define MUFLY_SETTINGS_H

#include "onboard/storage/parameters.h"
#include "onboard/storage/storage.h"

#define MAX_COORDINATE_M REAL(1e4) /* of a waypoint from the origin */

/* Faults, as bits. */
#define SETTINGS_NOT_STORED 1U    /* the flash is worn, or too small */
#define SETTINGS_OTHER_VERSION 2U /* a record has another format and is not read */
#define SETTINGS_REFUSED 4U       /* a stored value is out of its bounds or has an unknown name; the others count */
#define SETTINGS_OTHER_MISSION 8U /* the stored mission replaced that of another image; that of this image counts */

typedef struct {
    storage_t storage;
    calibration_t calibration;
    bool changed[PARAMETERS]; /* parameters that were set, here or before a restart; only these are stored */
    bool owes_parameters, owes_calibration; /* records that are not stored yet */
    bool has_failed;          /* storing failed: tried again after the next change, or on request */
    uint32_t faults;          /* SETTINGS_..., until they are sent as text */
} settings_t;

enum { SETTING_DONE, SETTING_OUT_OF_BOUNDS, SETTING_ON_FLOOR_ONLY };

/* Open the storage and load all it holds into the values of the image. */
void settings_begin(settings_t *s, const tunables_t *t);

/* Set a parameter; on the floor, with motors off, store it too. Return SETTING_... */
int32_t settings_set(settings_t *s, const tunables_t *t, int32_t k, real_t value, bool on_floor);

/* Store the records that are not stored yet; return whether all are stored. Call on the floor only. */
bool settings_store(settings_t *s, const tunables_t *t);

/* Whether a record waits to be stored whose last attempt did not fail. */
bool settings_are_due(const settings_t *s);

/* Return parameters or calibration to the values of the image, without storing. */
void settings_reset(settings_t *s, const tunables_t *t, bool parameters, bool calibration);

/* Load parameters and calibration as they are stored. */
void settings_reload(settings_t *s, const tunables_t *t);

/* Store the mission of a plan; return whether it is stored, or the board has no storage. Call on the floor only. */
bool settings_store_mission(settings_t *s, const plan_t *plan);

/* Return to the mission of the image, without storing. */
void settings_reset_mission(plan_t *plan);

#endif
