/* Readings that cannot be right in themselves, whatever the state, and how long a doubt lasts. */
#ifndef MUFLY_GUARDS_H
#define MUFLY_GUARDS_H

#include "records.h"

/* Note what is wrong with a sensor, for a while. */
void flag(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t code, int32_t why, real_t number);

/* A reading has been used; one does not fit. */
void fits(estimator_t *m, int32_t k);
void misfits(estimator_t *m, const estimator_settings_t *s, int32_t k, int32_t why, real_t number);

/* Judge what has come; what is unusable is marked as not new and replaced by what came before. */
void inspect(estimator_t *m, const estimator_settings_t *s, real_t z[VALUES], int32_t fresh[SENSORS],
             const real_t age[SENSORS]);

/* Something carries the filter astray that it does not know, most likely the gyroscopes. */
void go_astray(estimator_t *m, const estimator_settings_t *s);

/* Put what the model says in the place of a spike of the gyroscopes, and take off a jump. */
void smooth_rates(estimator_t *m, const estimator_settings_t *s, bool flying);

/* Whether rotor speeds, battery voltage and accelerometers are what the models make. */
bool rotor_fits(estimator_t *m, const estimator_settings_t *s, const real_t speed[2]);
bool voltage_fits(estimator_t *m, const estimator_settings_t *s, real_t off);
void felt_fits(estimator_t *m, const estimator_settings_t *s, real_t nu, real_t variance, real_t known,
               int32_t i);

#endif
