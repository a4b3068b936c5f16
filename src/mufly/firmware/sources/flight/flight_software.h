/* Flight software of one vehicle, one call per period: from an estimate and user signals to actuators.
 *
 * Explanation: flight_software.py of mufly.flight. The caller owns all state. */
#ifndef MUFLY_FLIGHT_SOFTWARE_H
#define MUFLY_FLIGHT_SOFTWARE_H

#include "flight/controllers.h"
#include "flight/estimator_health.h"
#include "flight/oscillation_detector.h"
#include "mission/machine/mission_state.h"

/* Constants of a flight. */
typedef struct {
    const gains_t *gains;
    const plan_t *plan;
    real_t period_s;
    int32_t mission_step_periods;      /* periods per step of the mission logic */
    real_t hover_V[2];  /* motor voltages of hover; upper, lower */
} flight_setup_t;

typedef struct {
    mission_t mission;
    reference_t reference;
    command_t command; /* stored for the next step of the mission logic */
    int32_t tick;      /* 0 when that step is due */
    int32_t motors;
    real_t motors_since_s;
    real_t motor_input[2];
    real_t tilt[2];
    controllers_t controllers;
    real_t released_motor_input[2];
    bool is_lifted;
    real_t since_mission_step_s;
    estimate_monitor_t watch;
    oscillation_detector_t oscillations;
    oscillation_t oscillation;
    health_monitor_t doubts;
    bool is_holding, resumes_mission;
    correction_smoother_t smooth;
    actuators_t limited_actuators;
    real_t hover_voltages[2]; /* motor voltages, averaged over the last second of flight */
    real_t filtered_battery_V; /* battery voltage, filtered during spin-up */
    real_t height_trusted_until_s; /* blind descent: time until which a known height is used */
} software_t;

/* Constants of the exported vehicle and mission: tables.c and plan.c. */
extern const plan_t mufly_plan;
extern const flight_setup_t mufly_setup;

/* Reset to the state before the first period. */
void software_reset(const flight_setup_t *setup, software_t *s);

/* Run one period. */
void software_step(const flight_setup_t *setup, software_t *s, const estimate_t *belief, const command_t *command,
                   actuators_t *out);

/* Whether the vehicle is off the floor. */
bool software_flying(const software_t *s);

#endif
