/* FMI 3.0 co-simulation unit of a coaxial micro helicopter.

   flight_model.h holds the equations of motion and is generated from mufly's Python source. vehicle_data.h holds the numbers of
   one vehicle. This file is the same for all vehicles. An instance is one block of memory; nothing else is allocated but states
   that the importer asks for. There are no variables outside instances, so that any number of instances can run at once.

   With sensors (HAS_SENSORS) the unit samples them and steps the filter at the end of every period of the flight software,
   1 / SENSOR_RATE_HZ, whatever the communication steps are. The filter is the flight software's (filter_unit.c).

   The numbers equal those of mufly.dynamics.integrate_state, to the last bit, where sin and cos are those of the same C library
   and the compiler does not contract multiplication and addition (-ffp-contract=off). */

#ifdef _MSC_VER
#pragma fp_contract(off)
#elif defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3.h"

#include "vehicle_data.h"

/* Phases of an instance. */
typedef enum { INSTANTIATED, INITIALISATION, STEPPING, TERMINATED } unit_phase;

/* What fmi3GetFMUState copies. The model's parameters follow from the values. */
typedef struct {
    unit_phase phase;
    double time;
    double values[SETTABLE_COUNT]; /* inputs, start of the state, step, parameters */
    double state[STATE_SIZE];
#if HAS_SENSORS
    int64_t periods;        /* since the start */
    double since_period;    /* time since the end of the last one (s) */
    double attitude[3];     /* roll, pitch, continuous yaw (rad) */
    sensor_set sensors;
    filter_unit filter;
#endif
} unit_state;

typedef struct {
    unit_state now;
    model_parameters parameters;
    double outputs[OUTPUT_COUNT];
    bool is_output_valid;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log_message;
} unit_instance;

/* Bytes before a state in its serialised form, to tell it from that of another unit. */
#define STATE_MARK_SIZE 64

static void report_error(const unit_instance *unit, const char *form, ...)
{
    if (unit == NULL || unit->log_message == NULL) {
        return;
    }
    char text[256];
    va_list arguments;
    va_start(arguments, form);
    vsnprintf(text, sizeof text, form, arguments);
    va_end(arguments);
    unit->log_message(unit->environment, fmi3Error, "logStatusError", text);
}

static fmi3Status refuse_call(fmi3Instance instance, const char *function)
{
    report_error(instance, "%s: not supported by this unit, see its model description", function);
    return fmi3Error;
}

#if HAS_SENSORS
static size_t unit_seed(const unit_instance *unit) { return (size_t)unit->now.values[SEED_VARIABLE]; }
#endif

/* Compute the model's parameters from the values of the unit's parameters. */
static void apply_parameters(unit_instance *unit)
{
    model_parameters *p = &unit->parameters;
    *p = NOMINAL_PARAMETERS;
#if HAS_SENSORS
    for (size_t k = 0; k < SEEDED_PARAMETER_COUNT; k++) {
        memcpy((char *)p + 8 * SEEDED_PARAMETER_PLACES[k], &SEEDED_PARAMETERS[unit_seed(unit)][k], 8);
    }
#endif
    for (size_t k = 0; k < sizeof PARAMETER_EFFECTS / sizeof PARAMETER_EFFECTS[0]; k++) {
        const parameter_effect *effect = &PARAMETER_EFFECTS[k];
        const double value = unit->now.values[effect->variable], start = START_VALUES[effect->variable];
        if (value == start) {
            continue;
        }
        double *field = (double *)((char *)p + effect->offset);
        for (size_t i = 0; i < effect->count; i++) {
            switch (effect->kind) {
            case EFFECT_EQUAL: field[i] = value; break;
            case EFFECT_INVERSE: field[i] = 1.0 / value; break;
            case EFFECT_SCALED: field[i] = value * effect->factor; break;
            case EFFECT_RATIO: field[i] *= value / start; break;
            }
        }
    }
}

/* Compute the state from the start values. Start values that depend on the seed are those of the seed, unless they are set. */
static void apply_start(unit_instance *unit)
{
    double start[PARAMETER_FIRST - START_FIRST];
    memcpy(start, unit->now.values + START_FIRST, sizeof start);
#if HAS_SENSORS
    for (size_t k = 0; k < SEEDED_START_COUNT; k++) {
        const size_t at = SEEDED_START_PLACES[k];
        if (start[at] == START_VALUES[START_FIRST + at]) {
            start[at] = SEEDED_STARTS[unit_seed(unit)][k];
        }
    }
#endif
    write_start_state(start, unit->now.state);
}

#if HAS_SENSORS
/* Set the sensors to their state at the start. */
static void reset_sensors(unit_instance *unit)
{
    sensor_set *sensors = &unit->now.sensors;
    memset(sensors, 0, sizeof *sensors);
    for (size_t k = 0; k < sizeof SENSOR_WORDS / sizeof SENSOR_WORDS[0]; k++) {
        memcpy((char *)sensors + 8 * (size_t)SENSOR_WORDS[k].place, &SENSOR_WORDS[k].bits, 8);
    }
    for (size_t k = 0; k < SEEDED_WORD_COUNT; k++) {
        memcpy((char *)sensors + 8 * (size_t)SEEDED_WORD_PLACES[k], &SEEDED_WORDS[unit_seed(unit)][k], 8);
    }
    reset_filter(&unit->now.filter);
    unit->now.periods = 0;
    unit->now.since_period = 0.0;
    memset(unit->now.attitude, 0, sizeof unit->now.attitude);
}

/* Sample the sensors and step the filter at the end of a period in which these inputs of the actuators acted. */
static void run_sensors(unit_instance *unit, const double *actuators)
{
    unit_state *now = &unit->now;
    const double up = smaller(greater(actuators[0], 0.0), 1.0), down = smaller(greater(actuators[1], 0.0), 1.0);
    const tuple_rr battery = compute_battery_supply(now->state, up, down, &unit->parameters);
    const double supply[2] = {battery.f0, battery.f1};
    write_true_attitude(now->state, now->attitude);
    sample_sensors((double)now->periods / SENSOR_RATE_HZ, now->state, now->attitude, supply, &now->sensors, &now->filter);
    step_filter(&now->filter, actuators);
}
#endif

static void reset_unit(unit_instance *unit)
{
    unit->now.phase = INSTANTIATED;
    unit->now.time = 0.0;
    memcpy(unit->now.values, START_VALUES, sizeof START_VALUES);
    apply_start(unit);
    apply_parameters(unit);
#if HAS_SENSORS
    reset_sensors(unit); /* outputs of sensors and filter are zero until the end of initialisation */
#endif
    unit->is_output_valid = false;
}

/* Integrate the state over a part of a communication step (s). */
static void integrate_span(unit_instance *unit, double span)
{
    const double *in = unit->now.values;
    const double count = ceil(span / in[STEP_VARIABLE] - 1e-9);
    const int64_t steps = count < 1.0 ? 1 : (int64_t)count;
    integrate_state(unit->now.state, in, in + WIND_FIRST, &unit->parameters, span / (double)steps, steps);
}

FMI3_EXPORT const char *fmi3GetVersion(void) { return fmi3Version; }

FMI3_EXPORT fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean is_on, size_t count, const fmi3String categories[])
{
    return instance == NULL ? fmi3Error : fmi3OK; /* errors are always reported, and there is nothing else to report */
}

FMI3_EXPORT fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resource_path, fmi3Boolean is_visible, fmi3Boolean is_logging,
    fmi3Boolean uses_event_mode, fmi3Boolean may_return_early, const fmi3ValueReference intermediate[],
    size_t intermediate_count, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message,
    fmi3IntermediateUpdateCallback update)
{
    unit_instance temporary = {.environment = environment, .log_message = log_message};
    if (token == NULL || strcmp(token, INSTANTIATION_TOKEN) != 0) {
        report_error(&temporary, "the instantiation token is not that of this unit: use its own modelDescription.xml");
        return NULL;
    }
    if (uses_event_mode || intermediate_count > 0) {
        report_error(&temporary, "this unit has neither event mode nor intermediate variables");
        return NULL;
    }
    unit_instance *unit = calloc(1, sizeof *unit);
    if (unit == NULL) {
        report_error(&temporary, "no memory for an instance");
        return NULL;
    }
    unit->environment = environment;
    unit->log_message = log_message;
    reset_unit(unit);
    return unit;
}

FMI3_EXPORT fmi3Instance fmi3InstantiateModelExchange(
    fmi3String name, fmi3String token, fmi3String resource_path, fmi3Boolean is_visible, fmi3Boolean is_logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message)
{
    unit_instance temporary = {.environment = environment, .log_message = log_message};
    refuse_call(&temporary, "fmi3InstantiateModelExchange");
    return NULL;
}

FMI3_EXPORT fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String name, fmi3String token, fmi3String resource_path, fmi3Boolean is_visible, fmi3Boolean is_logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message, fmi3ClockUpdateCallback update,
    fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock)
{
    unit_instance temporary = {.environment = environment, .log_message = log_message};
    refuse_call(&temporary, "fmi3InstantiateScheduledExecution");
    return NULL;
}

FMI3_EXPORT void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

FMI3_EXPORT fmi3Status fmi3Reset(fmi3Instance instance)
{
    if (instance == NULL) {
        return fmi3Error;
    }
    reset_unit(instance);
    return fmi3OK;
}

static fmi3Status change_phase(unit_instance *unit, unit_phase from, unit_phase to, const char *function)
{
    if (unit == NULL) {
        return fmi3Error;
    }
    if (unit->now.phase != from) {
        report_error(unit, "%s: not allowed in this state of the instance", function);
        return fmi3Error;
    }
    unit->now.phase = to;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3EnterInitializationMode(
    fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start_time,
    fmi3Boolean has_stop_time, fmi3Float64 stop_time)
{
    unit_instance *unit = instance;
    const fmi3Status status = change_phase(unit, INSTANTIATED, INITIALISATION, "fmi3EnterInitializationMode");
    if (status == fmi3OK) {
        unit->now.time = start_time;
    }
    return status;
}

FMI3_EXPORT fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    const fmi3Status status = change_phase(instance, INITIALISATION, STEPPING, "fmi3ExitInitializationMode");
#if HAS_SENSORS
    if (status == fmi3OK) {
        static const double NO_INPUT[WIND_FIRST] = {0.0};
        unit_instance *unit = instance;
        reset_sensors(unit);
        run_sensors(unit, NO_INPUT);
        unit->is_output_valid = false;
    }
#endif
    return status;
}

FMI3_EXPORT fmi3Status fmi3Terminate(fmi3Instance instance)
{
    return change_phase(instance, STEPPING, TERMINATED, "fmi3Terminate");
}

FMI3_EXPORT fmi3Status fmi3GetFloat64(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, fmi3Float64 values[], size_t value_count)
{
    unit_instance *unit = instance;
    if (unit == NULL) {
        return fmi3Error;
    }
    if (value_count != count) {
        report_error(unit, "fmi3GetFloat64: %zu values for %zu scalar variables", value_count, count);
        return fmi3Error;
    }
    for (size_t k = 0; k < count; k++) {
        const fmi3ValueReference reference = references[k];
        if (reference == 0) {
            values[k] = unit->now.time;
        } else if (reference <= SETTABLE_COUNT) {
            values[k] = unit->now.values[reference - 1];
        } else if (reference <= SETTABLE_COUNT + OUTPUT_COUNT) {
            if (!unit->is_output_valid) {
                const double *in = unit->now.values;
                write_outputs(unit->now.state, in, in + WIND_FIRST, &unit->parameters, unit->outputs);
#if HAS_SENSORS
                write_sensed_outputs(&unit->now.sensors, &unit->now.filter, unit->outputs + MODEL_OUTPUT_COUNT);
#endif
                unit->is_output_valid = true;
            }
            values[k] = unit->outputs[reference - 1 - SETTABLE_COUNT];
        } else {
            report_error(unit, "fmi3GetFloat64: there is no value reference %u", (unsigned)reference);
            return fmi3Error;
        }
    }
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetFloat64(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, const fmi3Float64 values[],
    size_t value_count)
{
    unit_instance *unit = instance;
    if (unit == NULL) {
        return fmi3Error;
    }
    if (value_count != count) {
        report_error(unit, "fmi3SetFloat64: %zu values for %zu scalar variables", value_count, count);
        return fmi3Error;
    }
    bool changes_start = false, changes_parameters = false;
    for (size_t k = 0; k < count; k++) {
        const fmi3ValueReference reference = references[k];
        if (reference == 0 || reference > SETTABLE_COUNT) {
            report_error(unit, "fmi3SetFloat64: value reference %u cannot be set", (unsigned)reference);
            return fmi3Error;
        }
        const size_t at = reference - 1;
        const bool is_fixed = at >= START_FIRST && at < PARAMETER_FIRST;
        if (unit->now.phase == TERMINATED || (is_fixed && unit->now.phase == STEPPING)) {
            report_error(unit, "%s: cannot be set after initialisation", VARIABLE_NAMES[at]);
            return fmi3Error;
        }
        if (!(values[k] >= LOWEST_VALUES[at] && values[k] <= HIGHEST_VALUES[at])) {
            report_error(
                unit, "%s: %g is out of range, give %g to %g", VARIABLE_NAMES[at], values[k], LOWEST_VALUES[at],
                HIGHEST_VALUES[at]);
            return fmi3Error;
        }
#if HAS_SENSORS
        if (at == SEED_VARIABLE && values[k] != floor(values[k])) {
            report_error(unit, "%s: %g is no whole number", VARIABLE_NAMES[at], values[k]);
            return fmi3Error;
        }
#endif
        unit->now.values[at] = values[k];
        changes_start |= is_fixed;
        changes_parameters |= at >= PARAMETER_FIRST;
    }
    if (changes_start) {
        apply_start(unit);
    }
    if (changes_parameters || changes_start) { /* the seed is among the start values */
        apply_parameters(unit);
    }
    unit->is_output_valid = false;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3DoStep(
    fmi3Instance instance, fmi3Float64 time, fmi3Float64 step_size, fmi3Boolean keeps_no_state, fmi3Boolean *needs_event,
    fmi3Boolean *terminates, fmi3Boolean *returns_early, fmi3Float64 *last_time)
{
    unit_instance *unit = instance;
    const fmi3Status status = change_phase(unit, STEPPING, STEPPING, "fmi3DoStep");
    if (status != fmi3OK) {
        return status;
    }
    *needs_event = *terminates = *returns_early = fmi3False;
    *last_time = time;
    const double count = ceil(step_size / unit->now.values[STEP_VARIABLE] - 1e-9);
    if (!(step_size > 0.0 && count < 1e15)) {
        report_error(unit, "fmi3DoStep: a communication step of %g s is out of range", step_size);
        return fmi3Error;
    }
#if HAS_SENSORS
    const double period = 1.0 / SENSOR_RATE_HZ, rounding = 1e-9 * period;
    for (double rest = step_size; rest > rounding;) {
        const double to_period = unit->now.since_period == 0.0 ? period : period - unit->now.since_period;
        if (rest >= to_period - rounding) {
            integrate_span(unit, to_period);
            unit->now.periods += 1;
            unit->now.since_period = 0.0;
            run_sensors(unit, unit->now.values);
            rest -= to_period;
        } else {
            integrate_span(unit, rest);
            unit->now.since_period += rest;
            rest = 0.0;
        }
    }
#else
    integrate_span(unit, step_size);
#endif
    unit->now.time = time + step_size;
    unit->is_output_valid = false;
    *last_time = unit->now.time;
    for (int i = 0; i < STATE_SIZE; i++) {
        if (!isfinite(unit->now.state[i])) {
            report_error(
                unit, "the state is not finite at t = %g s: give a smaller %s, or correct the parameters", unit->now.time,
                VARIABLE_NAMES[STEP_VARIABLE]);
            return fmi3Error;
        }
    }
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    const unit_instance *unit = instance;
    if (unit == NULL || state == NULL) {
        return fmi3Error;
    }
    if (*state == NULL) {
        *state = malloc(sizeof(unit_state));
        if (*state == NULL) {
            report_error(unit, "fmi3GetFMUState: no memory for a state");
            return fmi3Error;
        }
    }
    memcpy(*state, &unit->now, sizeof(unit_state));
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    unit_instance *unit = instance;
    if (unit == NULL || state == NULL) {
        return fmi3Error;
    }
    memcpy(&unit->now, state, sizeof(unit_state));
    apply_parameters(unit);
    unit->is_output_valid = false;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    if (state == NULL) {
        return fmi3Error;
    }
    free(*state);
    *state = NULL;
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    *size = STATE_MARK_SIZE + sizeof(unit_state);
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (state == NULL || size != STATE_MARK_SIZE + sizeof(unit_state)) {
        report_error(instance, "fmi3SerializeFMUState: %zu bytes, %zu needed", size, STATE_MARK_SIZE + sizeof(unit_state));
        return fmi3Error;
    }
    memset(bytes, 0, STATE_MARK_SIZE);
    memcpy(bytes, INSTANTIATION_TOKEN, sizeof INSTANTIATION_TOKEN);
    memcpy(bytes + STATE_MARK_SIZE, state, sizeof(unit_state));
    return fmi3OK;
}

FMI3_EXPORT fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    if (state == NULL || size != STATE_MARK_SIZE + sizeof(unit_state) ||
        memcmp(bytes, INSTANTIATION_TOKEN, sizeof INSTANTIATION_TOKEN) != 0) {
        report_error(instance, "fmi3DeserializeFMUState: the bytes are not a state of this unit");
        return fmi3Error;
    }
    if (*state == NULL && (*state = malloc(sizeof(unit_state))) == NULL) {
        report_error(instance, "fmi3DeserializeFMUState: no memory for a state");
        return fmi3Error;
    }
    memcpy(*state, bytes + STATE_MARK_SIZE, sizeof(unit_state));
    return fmi3OK;
}

#include "unsupported_functions.h"
