"""Flight software that runs on board: mission logic and controllers, independent of the simulator.

``step(estimate, command) -> actuators`` is called at the rate of the control design. Every n-th step runs the mission
logic and the position cascade (50 Hz). The mission logic sets the reference and the mode of the motors:

=========== =========================================================================================
off         motors and servos at rest
spin_up     motor inputs rise to 0.9 of hover, too little to lift off; servos at trim. A vehicle lighter than its
            design may lift off nevertheless, and changes to ``fly`` at once
fly         heave-yaw controller; from 2 cm above the floor, or once the vehicle tips on its legs, also roll-pitch
            and, every n-th step, position
ramp_down   after touchdown motor inputs fall to zero
blind       descent without an estimate. With servos at trim the stabiliser bar keeps a level attitude. Motor voltages
            start from the mean of the last second of flight. Until touchdown they control the rate of descent
            while the height is known, and are slightly lower otherwise
=========== =========================================================================================

Between two steps of the mission logic the reference is propagated at the reference velocity. A mission that exceeds
the limits of the controllers is flown more slowly (:mod:`mufly.mission.files.mission_checks`). Missing or frozen
estimates are bridged for half a second (:func:`mufly.estimate.check_estimate`); then the flight software descends in
mode ``blind``. :mod:`mufly.flight.estimator_health` handles uncertain estimates. Oscillating actuators
(:mod:`mufly.flight.oscillation_detector`) also end the mission.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.control import FlightController
from mufly.estimate import Estimate, EstimateCheckState, check_estimate
from mufly.flight.controllers import Actuators, Controllers, derive_trajectory_limits
from mufly.flight.estimator_health import (
    MAX_HEIGHT_SIGMA_M,
    CorrectionSmoother,
    HealthMonitor,
    is_gyro_unavailable,
)
from mufly.flight.oscillation_detector import Oscillation, OscillationDetector, steering_demands
from mufly.mission import (
    NO_COMMAND,
    ROTOR_RUN_DOWN_TIME_S,
    ROTOR_SPIN_UP_TIME_S,
    Command,
    LogTemplate,
    Mission,
    MissionState,
    Reference,
    State,
    enter_blind_descent,
    fail_and_land,
    finish_blind_descent,
    has_lifted_off,
    initial_mission_state,
    is_tipping,
    log_event,
    pause_mission,
    prepare_mission_plan,
    reduce_mission_limits,
    resume_mission,
    step_mission,
    stop_motors,
    update_obstacle_map,
)
from mufly.quantities.units import GRAVITY
from mufly.vehicle import Vehicle

_Array = NDArray[np.floating[Any]]

ESTIMATE_TIMEOUT_S = 0.5
"""Longest time without a new estimate in flight (s)."""

RAMP_DOWN_SKIPPED_FRACTION = 0.8
"""Fraction of the motors' ramp-down that is skipped if the touchdown is certain."""

MAX_MOTOR_INPUT_STEP, MAX_SERVO_INPUT_STEP = 0.1, 0.2
"""Largest change of an input in a period on a filter's estimate: twice the 0.999 quantile of flights in gusts."""

_HOVER_VOLTAGE_FILTER_S = 1.0
_BATTERY_FILTER_S = 0.5  # time constant of the battery voltage during spin-up, with a filter's estimate


class FlightSoftware:
    """Mission logic and controllers of one vehicle.

    ``requested_mission`` is the mission as loaded, ``plan`` the mission as flown, within the limits of the
    controllers. ``slowdown_note`` describes the reduced limits. ``mission_state`` is the state of the mission's
    state machine, and ``oscillation`` the detected oscillation of an actuator, if any.

    Parameters
    ----------
    vehicle : Vehicle
        Supplies range ring and battery limit.
    controller : FlightController
        Design from :func:`mufly.control.design_flight_controller`.
    mission : Mission
        Checked mission.

    Raises
    ------
    InputError
        If the mission does not suit the vehicle.
    """

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        self._vehicle = vehicle
        self._controller = controller
        self.commands_itself = False  # whether it takes its requests and arms by itself, as a board with its own link
        self.is_armed = False  # of the next step; set by the autopilot, for boards that idle their outputs themselves
        self._make: Callable[[FlightController], Controllers] = Controllers
        self.apply_mission_limits(mission)
        self.reset()

    def reset(self) -> None:
        """Return to the state before the first step of a flight."""
        controller = self._controller
        self._period_s = 1.0 / controller.rate_Hz
        self._every = controller.position_divider
        self.mission_state = MissionState()
        self._reference = Reference(np.zeros(3), np.zeros(3), np.zeros(3), 0.0, 0.0, "off")
        self._command = NO_COMMAND
        self._ticks = 0
        self._motors = "off"
        self._since_s = 0.0
        self._motor_input: _Array = np.zeros(2)
        self._tilt: _Array = np.zeros(2)
        self._controllers = self._make(controller)
        self._released: _Array = np.zeros(2)
        self._lifted = False
        self._late_s = 0.0
        self._watch: EstimateCheckState | None = None
        self._oscillations = OscillationDetector()
        self.oscillation: Oscillation | None = None
        self._doubts, self._held, self._waits = HealthMonitor(), False, False
        self._smooth = CorrectionSmoother()
        self._given = Actuators.make_zero_inputs()
        # Motor voltages, averaged over the last second of flight (V)
        self._held_up: _Array = np.zeros(2)
        self._trusts_until_s = 0.0
        self._volts = 0.0

    def replace_controllers(self, make: Callable[[FlightController], Controllers]) -> None:
        """Replace the implementation of the control law, for example by a board's code. Call before the first step."""
        self._make = make
        self.reset()

    def apply_mission_limits(self, mission: Mission) -> None:
        """Apply the limits of a mission with the same waypoints as the present one.

        Raises
        ------
        InputError
            If the mission does not suit the vehicle; the present mission stays.
        """
        flown, slower = reduce_mission_limits(mission, derive_trajectory_limits(self._controller))
        self.plan = prepare_mission_plan(flown, self._vehicle)
        self.requested_mission, self.slowdown_note = mission, slower

    def limit_mission(self, mission: Mission) -> Mission:
        """Return a mission with its limits reduced to those of the controllers."""
        return reduce_mission_limits(mission, derive_trajectory_limits(self._controller))[0]

    def load_mission(self, mission: Mission) -> None:
        """Load another mission, which begins at its first waypoint when started.

        Raises
        ------
        InputError
            If the mission does not suit the vehicle; the present mission stays.
        """
        self.apply_mission_limits(mission)
        if self._watch is not None:
            n = len(mission.waypoint)
            loaded = LogTemplate.ONE_WAYPOINT_LOADED if n == 1 else LogTemplate.WAYPOINTS_LOADED
            s = log_event(self.mission_state, loaded(mission.name or "a mission", n))
            s = replace(s, waypoint_index=0, mission_begun=False)
            # A flight in progress continues in manual mode until the new mission is started.
            flying = s.state is not State.INIT
            self.mission_state = (
                replace(s, outcome="", reason="", user_in_control=True, abort_reason="") if flying else s
            )

    def retune_controllers(self, controller: FlightController) -> None:
        """Change gains and limits of the control law without a step in its output."""
        self._controller = controller
        self._controllers.retune_gains(controller)
        self.apply_mission_limits(self.requested_mission)

    @property
    def is_mission_step_due(self) -> bool:
        """Whether the next step runs the mission logic, which handles the user's commands."""
        return self._ticks % self._every == 0

    @property
    def mission_step_periods(self) -> int:
        """Number of periods between two steps of the mission logic."""
        return self._every

    def make_batch_runner(self, flight: Any) -> Callable[..., bool] | None:
        """Return the function ``run(until)`` that advances a flight by many periods in one call; None if there is none.

        Implementations in other code override this method.
        """
        return None

    @property
    def motors(self) -> str:
        """Mode of the motors: one of the modes in the table of this module."""
        return self._motors

    @property
    def state(self) -> State:
        """Present state of the mission's state machine."""
        return self.mission_state.state

    @property
    def logged_event_count(self) -> int:
        """Number of entries in the mission's log."""
        return self.mission_state.logged_event_count

    @property
    def finished(self) -> bool:
        """Whether the mission is over."""
        return self.mission_state.finished

    @property
    def flying(self) -> bool:
        """Whether the vehicle is off the floor."""
        return self._lifted and self._motors in ("fly", "blind")

    @property
    def reference(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Reference position (m) and velocity (m/s), both N-E-D, and roll, pitch, yaw (rad); (3,) each."""
        r = self._reference
        heading = r.heading + self._late_s * r.heading_rate
        return r.position + self._late_s * r.velocity, r.velocity, np.array([*self._tilt, heading])

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Advance by one period.

        Parameters
        ----------
        estimate : Estimate
        command : Command
            The user's command; stored until the next step of the mission logic.

        Returns
        -------
        Actuators
        """
        first = self._watch is None
        self._watch = check_estimate(self._watch, estimate, self._period_s, self.plan.beam_ring.max_range)
        m = self._watch.last_good
        if m.auxiliary_states is not None:
            m = self._smooth.smooth_estimate(m, anew=self._motors == "off")
        if first:
            self.mission_state = initial_mission_state(self.plan, m)
        if command is not NO_COMMAND and command != NO_COMMAND:
            self._command = command
        if command.motor_stop_reason:
            return self._stop_motors_at_once(command.motor_stop_reason, m)
        self._late_s = (self._ticks % self._every) * self._period_s
        self._ticks += 1
        if self._is_estimate_lost(self._watch):
            return self._limit_actuator_rates(
                m,
                self._step_blind_descent(
                    self._watch, estimate, LogTemplate.MEASUREMENT_LOST(self._watch.lost_quantities)
                ),
            )
        if self._late_s == 0.0 and m.auxiliary_states is not None:
            doubt = self._act_on_health(m)
            if doubt:
                return self._limit_actuator_rates(m, self._step_blind_descent(self._watch, estimate, doubt))
        if self._late_s == 0.0:
            self.mission_state, self._reference = step_mission(self.plan, self.mission_state, m, self._command)
            self._command = NO_COMMAND
        self._update_map_part(m)
        r = self._reference
        if r.motors != self._motors:
            self._change_motor_mode(r.motors, m)
        if r.motors == "fly":
            return self._limit_actuator_rates(m, self._step_control(r, m))
        self._given = self._step_floor_motors(r.motors, m)
        return self._given

    def _update_map_part(self, m: Estimate) -> None:
        """Update the obstacle map from a part of the beams; two steps of the mission cover all beams."""
        parts = max(1, self._every - 1)
        part = (self._ticks - 1) % self._every if self._every > 1 else 1
        if part > 0:
            self.mission_state = update_obstacle_map(self.plan, self.mission_state, m, part, parts)

    def _limit_actuator_rates(self, m: Estimate, wanted: Actuators) -> Actuators:
        """Limit the change of motor and servo inputs per period if the estimate comes from the filter.

        The limits are :data:`MAX_MOTOR_INPUT_STEP` and :data:`MAX_SERVO_INPUT_STEP`.
        """
        if m.auxiliary_states is not None:
            before = self._given
            motor, servo = _limit_actuator_step(
                before.motor_input, before.servo_input, wanted.motor_input, wanted.servo_input
            )
            wanted = Actuators(motor, servo)
        self._given = wanted
        return wanted

    def _stop_motors_at_once(self, why: str, m: Estimate) -> Actuators:
        self._ticks += 1
        self.mission_state = stop_motors(replace(self.mission_state, time_s=m.time_s), why)
        self._reference = replace(
            self._reference, velocity=np.zeros(3), heading_rate=0.0, motors="off", rc_active=False
        )
        self._command, self._motors, self._lifted, self._late_s = NO_COMMAND, "off", False, 0.0
        self._given = Actuators.make_zero_inputs()
        self._motor_input, self._tilt = np.zeros(2), np.zeros(2)
        return Actuators.make_zero_inputs()

    def _is_estimate_lost(self, w: EstimateCheckState) -> bool:
        """Whether the estimate is lost in flight; always True during a blind descent."""
        if self._motors == "blind":
            return True
        # With the motors off the vehicle stands still, and a repeated measurement is no fault.
        running_s = w.last_good.time_s - self._since_s if self._motors in ("spin_up", "fly") else 0.0
        return min(w.lost_s, running_s) > ESTIMATE_TIMEOUT_S

    def _act_on_health(self, m: Estimate) -> str:
        """Hold or land on an uncertain estimate; return the reason of an immediate blind descent, "" without one."""
        s = self.mission_state
        if not (self._lifted and self._motors == "fly"):
            stood = max(m.covariance[0, 0], m.covariance[1, 1])
            self._doubts, self._held, self._waits = (
                HealthMonitor(standing_position_variance_m2=float(stood)),
                False,
                False,
            )
            return ""
        before, now = self._doubts.verdict, self._doubts.decide_failsafe(m)
        if now.action == "sink" or (
            now.action == "land" and is_gyro_unavailable(m) and self._height_above_home(m) < TOUCHDOWN_HEIGHT_M
        ):
            return now.reason
        if now.action == "hold" and not self._held and s.state in (State.WAYPOINT, State.OBSTACLE, State.HOVER):
            self._held, self._waits = True, s.mission_begun and not s.user_in_control and s.outcome == ""
            s = log_event(s, now.reason, level="warning")
            self.mission_state = pause_mission(self.plan, s, LogTemplate.WAITING_FOR_POSITION())
        elif now is not before and now.action == "land":
            self.mission_state = fail_and_land(s, now.reason)
        elif now is not before and s.state is State.RC:
            self.mission_state = log_event(s, now.reason or LogTemplate.POSITION_KNOWN_AGAIN(), level="warning")
        elif self._held and now.action == "":
            goes_on = self._waits and s.state is State.HOVER and s.user_in_control
            self._held = self._waits = False
            if goes_on:
                self.mission_state = resume_mission(self.plan, log_event(s, LogTemplate.POSITION_KNOWN_AGAIN()), None)
        return ""

    def _step_blind_descent(self, w: EstimateCheckState, told: Estimate, why: str) -> Actuators:
        now = w.last_good.time_s
        height = self._height_or_infinite(told)
        if self._motors != "blind":
            self._motors = "blind"
            span = self._blind_descent_time_s(self._height_above_home(w.last_good)) if self._lifted else 0.0
            self._since_s, self._trusts_until_s = now + span, now + 2.0 * span
            self.mission_state = enter_blind_descent(self.mission_state, now, why)
            self._reference = replace(self._reference, motors="blind", velocity=np.zeros(3), heading_rate=0.0)
            self._tilt, self._command = np.zeros(2), NO_COMMAND
        knows = self._lifted and now < self._trusts_until_s and TOUCHDOWN_HEIGHT_M < height < math.inf
        if knows:  # the timed descent continues from here if the height is lost
            self._since_s = now + self._blind_descent_time_s(height)
        elif height <= TOUCHDOWN_HEIGHT_M:  # touchdown: thrust on the legs would tip the vehicle over
            self._since_s = min(self._since_s, now - RAMP_DOWN_SKIPPED_FRACTION * ROTOR_RUN_DOWN_TIME_S)
        left_s = self._since_s + ROTOR_RUN_DOWN_TIME_S - now
        if left_s <= 0.0:
            self.mission_state = finish_blind_descent(self.mission_state, now)
            self._reference = replace(self._reference, motors="off")
            self._motors, self._motor_input = "off", np.zeros(2)
        else:
            share = (
                blind_descent_voltage_fraction(height, float(told.velocity[2]))
                if knows
                else BLIND_DESCENT_VOLTAGE_FRACTION
            )
            self._motor_input = blind_descent_motor_input(self._held_up, share, left_s, w.last_good.battery_voltage)
        return Actuators(self._motor_input, np.zeros(2))

    def _height_above_home(self, m: Estimate) -> float:
        return float(self.mission_state.home_position[2] - m.position[2])

    def _height_or_infinite(self, m: Estimate) -> float:
        """Return the height above home (m) while the rest of the estimate is lost; infinite if the height is lost,
        too.
        """
        certain = m.auxiliary_states is not None and m.covariance[2, 2] < MAX_HEIGHT_SIGMA_M * MAX_HEIGHT_SIGMA_M
        height = self._height_above_home(m)
        return height if certain and abs(height) + abs(float(m.velocity[2])) < 1e3 else math.inf

    def _blind_descent_time_s(self, height: float) -> float:
        return blind_descent_time_s(height, float(self._controller.position_gains["gravity"]))

    def _change_motor_mode(self, motors: str, m: Estimate) -> None:
        """Change the mode of the motors; engage the controllers with a bumpless transfer."""
        if motors == "fly":
            self._controllers.engage_heave_yaw(m, self._motor_input)
            self._lifted = False
            self._oscillations, self.oscillation = OscillationDetector(), None
            self._held_up = self._controller.motor_trim * self._controller.voltage_V
        elif motors == "spin_up":
            self._held_up, self._lifted = np.zeros(2), False
        self._motors, self._since_s = motors, m.time_s
        self._released = self._motor_input

    def _step_floor_motors(self, motors: str, m: Estimate) -> Actuators:
        elapsed = m.time_s - self._since_s
        if motors == "spin_up" and m.auxiliary_states is not None:
            self._volts += self._period_s / _BATTERY_FILTER_S * (m.battery_voltage - self._volts)
        else:
            self._volts = m.battery_voltage
        if motors == "spin_up":
            hover_V = self._controller.motor_trim * self._controller.voltage_V
            self._motor_input = spin_up_motor_input(hover_V, elapsed, self._volts)
        elif motors == "ramp_down":
            known = m.auxiliary_states is None  # else the vehicle may slide, and remaining thrust tip it over
            ahead = 0.0 if known else RAMP_DOWN_SKIPPED_FRACTION * ROTOR_RUN_DOWN_TIME_S
            self._motor_input = ramp_down_motor_input(self._released, elapsed + ahead)
        else:
            self._motor_input = np.zeros(2)
        self._tilt = np.zeros(2)
        return Actuators(self._motor_input, np.zeros(2))

    def _step_control(self, r: Reference, m: Estimate) -> Actuators:
        if not self._lifted and (has_lifted_off(self.mission_state, m) or is_tipping(m)):
            self._lifted = True
            self._controllers.engage_roll_pitch(m)
        if not self._lifted:
            self._tilt = np.zeros(2)
        elif r.rc_active:
            self._tilt = np.array([r.roll, r.pitch])
        elif self._late_s == 0.0:
            self._tilt = self._controllers.compute_tilt_command(m, r.position, r.velocity, r.acceleration)
        down, turn = float(r.velocity[2]), r.heading_rate
        heave_yaw = np.array([r.position[2] + self._late_s * down, r.heading + self._late_s * turn, down, turn])
        actuators = self._controllers.step(m, heave_yaw, self._tilt if self._lifted else None)
        self._motor_input = actuators.motor_input
        if self._late_s == 0.0:
            blend = self._every * self._period_s / _HOVER_VOLTAGE_FILTER_S
            self._held_up += blend * (actuators.motor_input * m.battery_voltage - self._held_up)
            self._detect_oscillation(actuators, r, m.time_s)
        return actuators

    def _detect_oscillation(self, actuators: Actuators, r: Reference, time_s: float) -> None:
        before = self.oscillation
        s = self.mission_state
        tracks = s.state is State.WAYPOINT and s.set_point_reference is not None
        asked = steering_demands(
            State.OFFBOARD if tracks else s.state, r.velocity.tolist(), r.heading_rate, r.roll, r.pitch
        )
        self.oscillation = self._oscillations.find_oscillation(time_s, actuators.input_array.tolist(), asked)
        if self.oscillation is not None and before is None:
            self.mission_state = fail_and_land(self.mission_state, str(self.oscillation))


@cached_njit
def _limit_actuator_step(
    motor: _Array, servo: _Array, wanted_motor: _Array, wanted_servo: _Array
) -> tuple[_Array, _Array]:
    """Return motor inputs (2,) and servo inputs (2,), moved towards the commanded ones by at most the largest step."""
    return (
        motor + np.minimum(np.maximum(wanted_motor - motor, -MAX_MOTOR_INPUT_STEP), MAX_MOTOR_INPUT_STEP),
        servo + np.minimum(np.maximum(wanted_servo - servo, -MAX_SERVO_INPUT_STEP), MAX_SERVO_INPUT_STEP),
    )


ControlImplementation = Callable[[FlightController], Controllers] | type[FlightSoftware]
"""Other implementation of the control law, or of the whole flight software."""


# Open-loop motor inputs: spin-up and ramp-down on the floor, and the descent with a lost estimate
#
# At a fraction s of the hover voltages the rotors have s times the speed and s^2 times the thrust of hover. A spin-up
# to 0.9 leaves a fifth of the weight on the legs. A blind descent at 0.98 lacks 0.04 of the thrust: it accelerates at
# 0.04 g and touches down from 2 m at 1.3 m/s (without drag). With known height and rate of descent, s controls the
# rate: the acceleration (1 - s^2) g reaches the wanted rate with a time constant of 0.4 s.


SPIN_UP_VOLTAGE_FRACTION = 0.9
BLIND_DESCENT_VOLTAGE_FRACTION = 0.98
TOUCHDOWN_HEIGHT_M = 0.03
"""Height below which the vehicle has touched down (m)."""
_MAX_DESCENT_M_S, _TOUCHDOWN_DESCENT_M_S = (
    0.9,
    0.5,
)  # limits of the rate of descent; a slow descent drifts farther
_DESCENT_RATE_GAIN_S_M = 1.0 / (2.0 * GRAVITY * 0.4)  # voltage fraction per rate of descent (s/m)
_MIN_DESCENT_VOLTAGE_FRACTION, _MAX_DESCENT_VOLTAGE_FRACTION = 0.92, 1.08
_BLIND_DESCENT_MARGIN_S = 1.0


def spin_up_motor_input(hover_V: _Array, elapsed_s: float, battery_V: float) -> _Array:
    """Return the motor inputs (2,) while the rotors spin up before lift-off.

    The inputs rise over half of the spin-up time; the slow upper rotor follows in the other half.

    Parameters
    ----------
    hover_V : (2,) array
        Motor voltages of hover (V).
    elapsed_s : float
        Time since the beginning of the spin-up (s).
    battery_V : float
        Battery voltage (V).
    """
    share = SPIN_UP_VOLTAGE_FRACTION * min(1.0, 2.0 * elapsed_s / ROTOR_SPIN_UP_TIME_S)
    return np.minimum(share * hover_V / battery_V, 1.0)


def ramp_down_motor_input(released: _Array, elapsed_s: float) -> _Array:
    """Return the motor inputs (2,) after touchdown, from ``released`` (2,) to zero within a second."""
    return released * max(0.0, 1.0 - elapsed_s / ROTOR_RUN_DOWN_TIME_S)


def blind_descent_motor_input(held_up_V: _Array, share: float, left_s: float, battery_V: float) -> _Array:
    """Return the motor inputs (2,) of a descent without measurements, from a fraction of the hover voltages.

    They are the fraction ``share`` of the hover voltages ``held_up_V`` (2,), and fall to zero in the last second.
    """
    return np.minimum(share * min(1.0, left_s / ROTOR_RUN_DOWN_TIME_S) * held_up_V / battery_V, 1.0)


def blind_descent_voltage_fraction(height_m: float, descent_m_s: float) -> float:
    """Return the fraction of the hover voltages that brings the rate of descent to its target at a height (m)."""
    wanted = min(max(height_m, _TOUCHDOWN_DESCENT_M_S), _MAX_DESCENT_M_S)
    return min(
        max(1.0 + _DESCENT_RATE_GAIN_S_M * (descent_m_s - wanted), _MIN_DESCENT_VOLTAGE_FRACTION),
        _MAX_DESCENT_VOLTAGE_FRACTION,
    )


def blind_descent_time_s(height_m: float, gravity: float) -> float:
    """Return the duration (s) of a descent without measurements from a height (m), with a margin of 1 s; ``gravity``
    in m/s2.
    """
    return (
        math.sqrt(
            2.0
            * max(0.0, height_m)
            / ((1.0 - BLIND_DESCENT_VOLTAGE_FRACTION * BLIND_DESCENT_VOLTAGE_FRACTION) * gravity)
        )
        + _BLIND_DESCENT_MARGIN_S
    )
