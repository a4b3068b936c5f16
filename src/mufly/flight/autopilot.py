"""Autopilot of a vehicle: requests of a pilot, a program or a link, with arming, timeouts, geofence and events.

The autopilot steps the flight software and converts requests to commands of the flight software. A request is answered
at once and takes effect in the next step of the mission's state machine (:mod:`mufly.mission.machine.state_machine`),
within 20 ms. :mod:`mufly.mission.machine.mission_state` defines the requests that each state permits. The autopilot
takes its time from the estimates. This module depends neither on MAVLink nor on the simulator.

The geofence is checked here, not in the flight software's C code: like arming, the fence acts by requests. A breach
triggers the fence's action once; targets outside the fence are refused.

Motors run only while the vehicle is armed. The vehicle disarms after landing, and ten seconds after arming without a
take-off. Sticks time out after a second and set-points after half a second; the vehicle then stops and hovers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mufly.control import FlightController
from mufly.dynamics import standing_height
from mufly.errors import InputError
from mufly.estimate import Estimate, SensorStatus
from mufly.flight.arming import describe_blocked_climb, describe_obstacle_too_near, find_arming_faults
from mufly.flight.controllers import Actuators
from mufly.flight.energy_check import EnergyCheck
from mufly.flight.estimator_health import SensorEventReporter, describe_missing_position_sensor
from mufly.flight.flight_software import FlightSoftware
from mufly.flight.flight_state import FlightState
from mufly.flight.tunable_parameters import TunableParameter, TunableParameters
from mufly.logs.mcap import FlightEvent
from mufly.mission import (
    MAX_HEIGHT_M,
    MIN_WAYPOINT_HEIGHT_M,
    MOTORS_STOPPING_REASON,
    NO_COMMAND,
    REQUEST_ACCEPTED,
    Command,
    Fence,
    LogTemplate,
    Mission,
    RequestAnswer,
    SetPoint,
    State,
    VehicleRequest,
    deny_request,
    describe_fence_violation,
    describe_path_fence_violation,
    describe_set_point_fault,
    describe_start_fault,
    describe_user_waypoint_fault,
    distance_inside_fence,
    reject_temporarily,
)
from mufly.mission.files.geofence import FENCE_MARGIN_M
from mufly.vehicle import Vehicle

DISARM_WITHOUT_TAKE_OFF_S = 10.0
"""Time from arming to disarming without a take-off (s)."""

SET_POINT_TIMEOUT_S, STICKS_TIMEOUT_S = 0.5, 1.0
"""Timeouts of a set-point and of the sticks (s)."""

FENCE_RETURN_MARGIN_M, FENCE_REPEAT_DEPTH_M = 0.1, 1.0
"""Distance inside the fence that ends a breach, and additional distance outside that repeats the action (m)."""

STICKS_BLOCKED_AFTER_BREACH_S = 2.0
"""Time after a breach during which sticks are refused (s); the vehicle comes to rest in it."""

_MIN_FALL_HEIGHT_M = 0.1  # height above the standing position from which stopped motors mean a fall
_INTERRUPTING_MESSAGES = (LogTemplate.TIPPED_MOTORS_OFF(), LogTemplate.MOTORS_OFF_AFTER_DESCENT())

POSITION_SOURCE_REFUSED_TEXT = "position by link refused: "
_IDLE_ACTUATORS = Actuators.make_zero_inputs()


class Autopilot:
    """Arming and commands of one vehicle's flight software.

    ``listeners`` are called with every event. A simulation sets ``crash_cause``. ``excused_sensors`` returns the
    readings that may be missing at present without a report, ``source_fault`` the fault of a source of positions.

    Parameters
    ----------
    vehicle : Vehicle
    controller : FlightController
        Design from :func:`mufly.control.design_flight_controller`.
    mission : Mission
        Checked mission; without waypoints it supplies limits and surroundings only.
    software : class
        :class:`mufly.flight.flight_software.FlightSoftware`, or a subclass that runs other code.

    Raises
    ------
    InputError
        If the mission does not suit the vehicle, or the vehicle cannot hover.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        software: type[FlightSoftware] = FlightSoftware,
    ) -> None:
        self.software = software(vehicle, controller, mission)
        self.listeners: list[Callable[[FlightEvent], None]] = []
        self.excused_sensors: Callable[[], Collection[str]] = lambda: ()
        self.source_fault: Callable[[], str] = lambda: ""
        self.energy_check = EnergyCheck(vehicle)
        self._radius_m = float(vehicle.rotors.radius)
        self._standing_m = standing_height(vehicle)
        self._period_s = 1.0 / controller.rate_Hz
        self._parameters = TunableParameters(vehicle, controller, self.software)
        self._reset_flight()

    def _reset_flight(self) -> None:
        self.crash_cause = ""
        self._armed, self._armed_s = False, 0.0
        self._interruption, self._interruption_told = "", False
        self.refused_source = ""  # fault of a source of positions that was refused in flight
        self.energy_check.reset()
        self._ran = False
        self._sent = _IDLE_ACTUATORS
        self._command = NO_COMMAND
        self._sticks: Command | None = None
        self._sticks_s = 0.0
        self._set_point: SetPoint | None = None
        self._set_point_s = -math.inf
        self._offboard = False
        self._estimate: Estimate | None = None
        self._now, self._heard_s = 0.0, -math.inf
        self._stale_s = 0.0
        self._sensors = SensorEventReporter()
        self._logged = 0
        self._breach, self._breaches, self._breach_s = "", 0, math.nan
        self._breach_depth = 0.0

    def reset(self) -> None:
        """Return to the disarmed state before a flight; mission and parameters stay."""
        self.software.reset()
        self._reset_flight()

    # one period

    def store_estimate(self, estimate: Estimate) -> None:
        """Store an estimate without a step, for the arming checks before the first step."""
        t = estimate.time_s
        # A clock that was set back still counts as running; a stopped clock makes the estimate stale.
        alive = math.isfinite(t) and t != self._heard_s
        self._stale_s = 0.0 if alive else self._stale_s + self._period_s
        # Timeouts count periods when the estimate's clock stops or goes back.
        self._now = t if alive and t >= self._now else self._now + self._period_s
        if alive:
            self._heard_s = t
        self._estimate = estimate
        volts = estimate.battery_voltage
        if self.software.motors == "off" and 0.0 < volts < math.inf:
            self.energy_check.observe_rest_voltage(volts, self._period_s)

    def step(self, estimate: Estimate) -> Actuators:
        """Advance by one period.

        Parameters
        ----------
        estimate : Estimate

        Returns
        -------
        Actuators
            Zero while the vehicle is not armed.
        """
        self.store_estimate(estimate)
        software = self.software
        if software.commands_itself:
            return self._step_self_arming_software(estimate)
        due = software.is_mission_step_due
        software.is_armed = self._armed
        actuators = software.step(
            estimate, self._collect_operator_command() if due or self._command.motor_stop_reason else NO_COMMAND
        )
        if estimate.auxiliary_states is not None:
            for text, level in self._sensors.collect_new_reports(
                estimate.auxiliary_states.checks, self._period_s, self.excused_sensors()
            ):
                self.log_event(text, level)
        if due:
            self._react_to_mission_step()
        # With the motors off the software's inputs are zero, too.
        self._sent = actuators if self._armed or software.motors == "off" else _IDLE_ACTUATORS
        return self._sent

    def _step_self_arming_software(self, estimate: Estimate) -> Actuators:
        """Step a flight software that arms and commands itself (exported C), and copy its arming state and its log."""
        software = self.software
        self._sent = software.step(estimate, NO_COMMAND)
        self._armed = software.is_armed
        if software.logged_event_count != self._logged:
            self._forward_mission_events()
        return self._sent

    # many periods of the compiled loop (mufly.firmware.quick)

    @property
    def has_pending_input(self) -> bool:
        """Whether the next period has to handle a request, sticks, set-points or a fence."""
        fenced = self.software.requested_mission.fence is not None
        return self._command is not NO_COMMAND or self._sticks is not None or self._offboard or fenced

    @property
    def armed(self) -> bool:
        """Whether the motors may run."""
        return self._armed

    def has_no_sensor_events(self, checks: Sequence[SensorStatus]) -> bool:
        """Whether these sensor statuses cause no report, neither now nor in later periods with the same statuses."""
        return self._sensors.has_nothing_to_report(checks)

    def report_sensor_checks(self, checks: Sequence[SensorStatus], time_s: float, state: str) -> None:
        """Report changes of the sensors' statuses in one period."""
        for text, level in self._sensors.collect_new_reports(checks, self._period_s):
            self._emit_event(FlightEvent(time_s, state, text, level))

    def update_after_compiled_periods(
        self, estimate: Estimate | None, sent: Actuators, *, ran: bool | None, due: bool
    ) -> None:
        """Update the autopilot after the compiled loop has run periods in which no request was pending.

        Parameters
        ----------
        estimate : Estimate or None
            Estimate of the last period; None: the software was not stepped in it.
        sent : Actuators
            Last inputs.
        ran : bool or None
            Whether the motors ran at the last step of the mission logic before the last period; None without such a
            step.
        due : bool
            Whether the mission logic ran in the last period.
        """
        if estimate is not None:
            self.store_estimate(estimate)
        self._sent = sent
        if ran is not None:
            self._ran = ran
        if due:
            self._react_to_mission_step()

    def _collect_operator_command(self) -> Command:
        """Return the command for the mission logic: a single request, or repeated sticks or set-points."""
        c, self._command = self._command, NO_COMMAND
        if self._sticks is not None:
            if self._now - self._sticks_s > STICKS_TIMEOUT_S:
                self._sticks = None
                self.log_event(f"sticks lost: no message for {STICKS_TIMEOUT_S:g} s", "warning")
            else:
                climb = self._sticks.pilot_climb_rate if self._armed else min(self._sticks.pilot_climb_rate, 0.0)
                c = replace(self._sticks, pilot_climb_rate=climb, motor_stop_reason=c.motor_stop_reason)
        if self._offboard:
            if self._now - self._set_point_s > SET_POINT_TIMEOUT_S:
                self._offboard = False
                self.log_event(f"set-points lost: no message for {SET_POINT_TIMEOUT_S:g} s", "warning")
            elif self._armed:
                c = replace(c, program_set_point=self._set_point)
        return c

    def _react_to_mission_step(self) -> None:
        """React to a step of the mission logic: forward events, enforce the fence, end offboard control, and disarm."""
        software = self.software
        if software.logged_event_count != self._logged:
            self._forward_mission_events()
        ran, self._ran = self._ran, software.motors != "off"
        if self._offboard and software.state not in ("offboard", "init"):
            self._offboard = False
        self._enforce_fence()
        self._land_on_position_source_fault()
        if not self._armed:
            return
        if ran and not self._ran:
            ends = [e.text for e in software.mission_state.events[-4:] if e.time_s >= self._armed_s]
            self._store_interruption(next((text for text in ends if text in _INTERRUPTING_MESSAGES), ""))
            self._set_disarmed()
        elif not self._ran and self._now - self._armed_s > DISARM_WITHOUT_TAKE_OFF_S:
            self._set_disarmed()
            self.log_event(f"disarmed: no take-off within {DISARM_WITHOUT_TAKE_OFF_S:g} s")

    def _enforce_fence(self) -> None:
        """Execute the fence's action at a breach; repeat it each :data:`FENCE_REPEAT_DEPTH_M` (m) farther outside."""
        fence, m = self.software.requested_mission.fence, self._estimate
        if fence is None or m is None or not self.software.flying or not np.isfinite(m.position).all():
            self._breach = ""
            return
        before = self._breach
        self._breach = describe_fence_violation(fence, m.position, FENCE_RETURN_MARGIN_M if before else 0.0)
        if before and not self._breach:
            self.log_event("inside the fence again")
        depth = distance_inside_fence(fence, m.position) if self._breach else 0.0
        if not self._breach or (before and depth > self._breach_depth - FENCE_REPEAT_DEPTH_M):
            return
        self._breach_depth = depth
        self._breaches, self._breach_s = self._breaches + 1, self._now
        act = {"hold": self.pause, "return": self.return_home, "land": self.land}[fence.action]
        words = {"hold": "holding", "return": "returning", "land": "landing"}[fence.action]
        by_hand = self._sticks is not None
        self._sticks = None
        landing = self.software.mission_state.state == State.LANDING
        answer = REQUEST_ACCEPTED if landing else act()
        if by_hand and not answer:
            answer = self._send_command(Command(land=True) if fence.action == "land" else Command(pause=True))
        done = "landing" if landing else words if answer else f"action refused: {answer.reason}"
        self.log_event(f"fence breached, {self._breach}: {done}", "error")

    def _land_on_position_source_fault(self) -> None:
        """Land when the external position source is refused in flight; under stick control only inform the pilot."""
        fault, before = self.source_fault() if self._ran else "", self.refused_source
        self.refused_source = fault or before
        if fault and not before:
            lands = self._sticks is None and self.land()
            self.log_event(f"{POSITION_SOURCE_REFUSED_TEXT}{fault}{': landing' if lands else ''}", "error")

    def _set_disarmed(self) -> None:
        self._armed = self._offboard = False
        self._command = NO_COMMAND

    def _store_interruption(self, what: str) -> None:
        """Store how a flight was interrupted; arming requires its acknowledgement."""
        if what:
            self._interruption, self._interruption_told = what, False

    # arming

    def list_arming_faults(self) -> list[str]:
        """Return why the vehicle must not arm, each reason with its remedy; an empty list if arming is allowed."""
        plan = self.software.plan
        m = self._estimate
        why = find_arming_faults(
            m, self._stale_s, plan.low_battery_V, plan.mission.world, self._radius_m, self.crash_cause,
            standing_m=self._standing_m,
        )  # fmt: skip
        if m is not None and not self.crash_cause and np.isfinite(m.position).all():
            fault = self.energy_check.find_start_refusal_here(plan.mission, m)
            why += [fault] if fault else []
        if fault := self.source_fault():
            why.append(f"{POSITION_SOURCE_REFUSED_TEXT}{fault}; check the program that sends the positions")
        if self._interruption and not self.crash_cause:
            why.insert(0, f"last flight interrupted: {self._interruption}; inspect the vehicle, then arm again")
        return why

    def arm(self, *, force: bool = False, quiet: bool = False, repeated: bool = False) -> RequestAnswer:
        """Arm the vehicle, so that the motors may run.

        After an interrupted flight (motors stopped in the air, tip-over, blind descent) the first request is refused
        with the reason; the next request acknowledges it.

        Parameters
        ----------
        force : bool
            Skip all checks except for a crash.
        quiet : bool
            Log no event of the arming.
        repeated : bool
            Whether a link repeats an answered request; a repetition does not acknowledge an interrupted flight.
        """
        if self._armed:
            return REQUEST_ACCEPTED
        answer = (
            reject_temporarily(MOTORS_STOPPING_REASON)
            if self._is_motor_stop_pending
            else self.status.check_request(VehicleRequest.ARM)
        )
        if not answer:
            return answer
        if self._interruption and (force or (self._interruption_told and not repeated)):
            self.log_event(f"acknowledged: {self._interruption}", "warning")
            self._interruption = ""
        self._interruption_told = True
        self.refused_source = ""
        why = self.list_arming_faults() if not force else [self.crash_cause] if self.crash_cause else []
        if self._sticks is not None and self._sticks.pilot_climb_rate > 0.0:
            why.append("the climb stick is up; lower it first")
        if why:
            more = f" (and {len(why) - 1} more)" if len(why) > 1 else ""
            return reject_temporarily(why[0] + more)
        self._armed, self._armed_s = True, self._now
        m, ring = self._estimate, self.software.plan.beam_ring
        if m is not None and (beware := describe_missing_position_sensor(m, ring.max_range)):
            self.log_event(beware, "warning")
        if not quiet:
            self.log_event("armed, by force" if force else "armed")
        return REQUEST_ACCEPTED

    def disarm(self, force: bool = False) -> RequestAnswer:
        """Disarm the vehicle; refused in flight, except with ``force``, which is an emergency stop."""
        if force:
            return self.emergency_stop()
        if not self._armed:
            return REQUEST_ACCEPTED
        answer = self.status.check_request(VehicleRequest.DISARM)
        if answer:
            self._disarm_and_stop("disarmed")
        return answer

    def emergency_stop(self) -> RequestAnswer:
        """Stop the motors at once; always accepted. In flight the vehicle then falls."""
        self._disarm_and_stop("emergency stop, motors off")
        return REQUEST_ACCEPTED

    @property
    def _is_motor_stop_pending(self) -> bool:
        """Whether the next step stops the motors."""
        return bool(self._command.motor_stop_reason)

    def _disarm_and_stop(self, why: str) -> None:
        idle = self.software.motors == "off" and self.software.mission_state.state == "init"
        self._set_disarmed()
        self._sticks = None
        if idle:
            self.log_event(why, "error" if "stop" in why else "info")
        else:
            m, s = self._estimate, self.software.mission_state
            height = 0.0 if m is None else s.home_position[2] - float(m.position[2])
            if self.software.flying and height > _MIN_FALL_HEIGHT_M:
                self._store_interruption(f"{why} {height:.1f} m above the floor")
            self._command = Command(motor_stop_reason=why)

    def _is_in_air(self) -> bool:
        """Whether the vehicle is off the floor, judged by the mode of its motors and by its height and speed."""
        m, s = self._estimate, self.software.mission_state
        if not self.software.flying or m is None:
            return False
        height = s.home_position[2] - float(m.position[2])
        return not (height < 0.05 and float(np.abs(m.velocity).max()) < 0.1)

    @property
    def parameters(self) -> Mapping[str, TunableParameter]:
        """All tunable parameters, by name."""
        return self._parameters

    def set_parameter(self, name: str, value: float) -> RequestAnswer:
        """Set a parameter, with immediate effect."""
        fault = self._parameters.set_value(name, float(value))
        return deny_request(fault) if fault else REQUEST_ACCEPTED

    # status and events

    @property
    def status(self) -> FlightState:
        """Present state of the flight, as known on board."""
        software = self.software
        s = software.mission_state
        in_air = s.state not in (State.INIT, State.RC)
        position, velocity, attitude = software.reference
        estimate = self._estimate or Estimate()
        return FlightState(
            time_s=estimate.time_s,
            armed=self._armed,
            flying=self._is_in_air(),
            landed=software.motors in ("off", "ramp_down"),
            state=str(s.state),
            motors=software.motors,
            mission_running=s.mission_begun and not s.user_in_control and in_air and not s.outcome,
            mission_begun=s.mission_begun,
            user_in_control=s.user_in_control,
            returning_home=s.returning_home,
            waypoint_index=s.waypoint_index,
            reached_waypoint_count=s.reached_waypoint_count,
            offboard_active=self._offboard,
            sticks_active=self._sticks is not None,
            outcome=s.outcome,
            reason=s.reason,
            oscillation=str(software.oscillation or ""),
            crash_cause=self.crash_cause,
            fence_breach_text=self._breach,
            fence_breach_count=self._breaches,
            fence_breach_time_s=self._breach_s,
            mission=software.requested_mission,
            home_position=s.home_position if s.has_taken_off else None,
            goal=s.goal if in_air else None,
            estimate=estimate,
            reference_position=position,
            reference_velocity=velocity,
            reference_attitude=attitude,
            actuators=self._sent,
        )

    def log_event(self, text: str, level: str = "info") -> None:
        """Append an event to the log; ``level`` is "info", "warning" or "error"."""
        self._emit_event(FlightEvent(self._now, str(self.software.mission_state.state), text, level))

    def _forward_mission_events(self) -> None:
        events, logged = self.software.mission_state.events, self.software.mission_state.logged_event_count
        fresh = min(logged - self._logged, len(events)) if logged > self._logged else len(events)
        self._logged = logged
        for e in events[len(events) - fresh :]:
            self._emit_event(e)

    def _emit_event(self, event: FlightEvent) -> None:
        for listener in self.listeners:
            listener(event)

    # flight

    def take_off(self, height_m: float | None = None) -> RequestAnswer:
        """Take off to a height above the floor (m; default parameter MIS_TAKEOFF_ALT) and hover."""
        if height_m is None:
            height_m = self.software.plan.mission.take_off.height_m
        if not (math.isfinite(height_m) and MIN_WAYPOINT_HEIGHT_M <= height_m <= MAX_HEIGHT_M):
            return deny_request(
                f"take-off height {height_m:g} m refused: give {MIN_WAYPOINT_HEIGHT_M:g} to {MAX_HEIGHT_M:g} m"
            )
        answer = self._check_take_off(VehicleRequest.TAKE_OFF, height_m)
        return self._send_command(Command(take_off_height=float(height_m))) if answer else answer

    def _check_take_off(self, ask: VehicleRequest, height_m: float) -> RequestAnswer:
        """Accept a take-off to ``height_m`` (m), or reject it because of state, attitude, obstacle above or fence."""
        answer = self.status.check_request(ask)
        if not answer:
            return answer
        m, mission = self._estimate, self.software.plan.mission
        fault = "" if m is None or not np.isfinite(m.attitude).all() else describe_start_fault(m)
        if fault:
            return reject_temporarily(fault)
        if m is not None and np.isfinite(m.position).all():
            place = (float(m.position[0]), float(m.position[1]), float(m.position[2]))
            fault = describe_blocked_climb(mission.world, place, height_m, mission.avoidance.clearance_m)
            fault = fault or describe_fence_violation(mission.fence, (*place[:2], -height_m), FENCE_MARGIN_M)
            if fault:
                return reject_temporarily(f"no take-off to {height_m:g} m here: {fault}")
        return REQUEST_ACCEPTED

    def start_mission(self, first: int | None = None) -> RequestAnswer:
        """Take off and fly the mission; in the air, resume it. ``first`` is the first waypoint (from 0)."""
        n = len(self.software.plan.mission.waypoint)
        if n == 0:
            return reject_temporarily("no mission loaded; load one first")
        if first is not None and not 0 <= first < n:
            return deny_request(f"waypoint {first} refused: the mission has the waypoints 0 to {n - 1}")
        if self.software.mission_state.state == "init":
            answer = self._check_take_off(VehicleRequest.START, self.software.plan.mission.take_off.height_m)
            if answer and self._estimate is not None:
                fault = self.energy_check.find_start_refusal_here(self.software.plan.mission, self._estimate)
                answer = reject_temporarily(fault) if fault else answer
        else:
            answer = self.status.check_request(VehicleRequest.START)
        return self._send_command(Command(start=True, first_waypoint=first)) if answer else answer

    def pause(self) -> RequestAnswer:
        """Stop and hover; :meth:`start_mission` resumes the mission. Above 0.4 m this aborts a landing.

        A take-off below 0.2 m continues to that height first.
        """
        return self._request_command(VehicleRequest.PAUSE, Command(pause=True))

    def go_to(self, position_m: Sequence[float], heading_rad: float | None = None) -> RequestAnswer:
        """Fly to a position (N, E, D; m) and hold it, with a heading (rad) if given; the mission waits."""
        if len(position_m) != 3:
            return deny_request("a position needs three numbers: N, E, D in m")
        place = (float(position_m[0]), float(position_m[1]), float(position_m[2]))
        heading = None if heading_rad is None or math.isnan(heading_rad) else float(heading_rad)
        fault = describe_user_waypoint_fault(place, heading)
        if fault:
            return deny_request(fault)
        mission = self.software.plan.mission
        here = place if self._estimate is None else self._estimate.position
        fault = (
            describe_obstacle_too_near(mission.world, place, mission.avoidance.clearance_m)
            or describe_fence_violation(mission.fence, place, FENCE_MARGIN_M)
            or describe_path_fence_violation(mission.fence, here, place)
            or self.energy_check.find_reach_refusal(mission, self._estimate, place)
        )
        if fault:
            return deny_request(f"[{place[0]:g}, {place[1]:g}, {place[2]:g}] refused: {fault}")
        return self._request_command(VehicleRequest.GO_TO, Command(waypoint=place, heading=heading))

    def turn_to(self, heading_rad: float) -> RequestAnswer:
        """Stop and turn on the spot to a heading (rad, from north to east)."""
        fault = describe_user_waypoint_fault(None, heading_rad)
        if fault:
            return deny_request(fault)
        return self._request_command(VehicleRequest.GO_TO, Command(heading=float(heading_rad)))

    def set_speed(self, speed_m_s: float) -> RequestAnswer:
        """Set the horizontal speed (m/s; parameter LIM_SPEED), effective from the next leg."""
        answer = self.set_parameter("LIM_SPEED", speed_m_s)
        underway = answer and self.software.mission_state.state in ("waypoint", "obstacle")
        return RequestAnswer(True, "from the next leg on") if underway else answer

    def return_home(self) -> RequestAnswer:
        """Fly to above the take-off position without descending, and land there."""
        return self._request_command(VehicleRequest.RETURN, Command(return_requested=True))

    def land(self) -> RequestAnswer:
        """Brake to a hover and land there."""
        if self.software.mission_state.state == "landing":
            return REQUEST_ACCEPTED
        return self._request_command(VehicleRequest.LAND, Command(land=True))

    def _send_command(self, command: Command) -> RequestAnswer:
        """Store a command for the mission logic; refused while a stop of the motors is pending."""
        if self._is_motor_stop_pending:
            return reject_temporarily(MOTORS_STOPPING_REASON)
        self._offboard = False
        self._command = command
        return REQUEST_ACCEPTED

    def _request_command(self, ask: VehicleRequest, command: Command) -> RequestAnswer:
        answer = self.status.check_request(ask)
        return self._send_command(command) if answer else answer

    # set-points and sticks

    def send_set_point(self, s: SetPoint) -> RequestAnswer:
        """Store a set-point, which the vehicle follows while :meth:`set_offboard` is on."""
        fault = describe_set_point_fault(s)
        fence, place = self.software.requested_mission.fence, s.position_m
        if not fault and fence is not None and place is not None and self._estimate is not None:
            here = self._estimate.position.tolist()
            fault = describe_fence_violation(
                fence, [h if math.isnan(p) else p for p, h in zip(place, here, strict=True)]
            )
        if fault:
            return deny_request(f"set-point refused: {fault}")
        self._set_point, self._set_point_s = s, self._now
        return REQUEST_ACCEPTED

    def set_offboard(self, on: bool) -> RequestAnswer:
        """Start or end offboard control; the start requires a set-point of the last half second."""
        if not on:
            self._offboard = False
            return REQUEST_ACCEPTED
        if self._now - self._set_point_s > SET_POINT_TIMEOUT_S or self._set_point is None:
            return reject_temporarily(f"no set-point in the last {SET_POINT_TIMEOUT_S:g} s; stream them first")
        if self._is_motor_stop_pending:
            return reject_temporarily(MOTORS_STOPPING_REASON)
        answer = self.status.check_request(VehicleRequest.OFFBOARD)
        self._offboard = self._offboard or answer.accepted
        return answer

    def set_sticks(self, roll_rad: float, pitch_rad: float, yaw_rate_rad_s: float, climb_m_s: float) -> RequestAnswer:
        """Set the pilot's sticks, clipped to the parameters ``STK_...``; the mission's state becomes RC."""
        values = (roll_rad, pitch_rad, yaw_rate_rad_s, climb_m_s)
        if not all(math.isfinite(v) for v in values):
            return deny_request("sticks refused: give finite numbers")
        answer = self.status.check_request(VehicleRequest.STICKS)
        if answer and self._breach and self._now - self._breach_s < STICKS_BLOCKED_AFTER_BREACH_S:
            answer = reject_temporarily("the vehicle has just left its fence; wait until it hovers, then fly it back")
        if not answer:
            return answer
        most = self._parameters.stick_ranges
        roll, pitch, turn, climb = (
            min(max(float(v), -limit), limit)
            for v, limit in zip(values, (most.tilt, most.tilt, most.yaw_rate, most.climb), strict=True)
        )
        self._offboard = False
        self._sticks = Command(
            rc_active=True, pilot_roll=roll, pilot_pitch=pitch, pilot_yaw_rate=turn, pilot_climb_rate=climb
        )
        self._sticks_s = self._now
        return REQUEST_ACCEPTED

    def release_sticks(self) -> RequestAnswer:
        """End stick control; the vehicle hovers or stays on the floor."""
        self._sticks = None
        return REQUEST_ACCEPTED

    # mission and parameters

    def load_fence(self, fence: Fence | None) -> RequestAnswer:
        """Load another fence, or none; refused while the vehicle is outside."""
        m = self._estimate
        if m is not None and np.isfinite(m.position).all() and (fault := describe_fence_violation(fence, m.position)):
            return reject_temporarily(f"fence refused: the vehicle is {fault}")
        self.software.apply_mission_limits(self.software.requested_mission.replace_parts(fence=fence))
        return REQUEST_ACCEPTED

    def load_mission(self, mission: Mission) -> RequestAnswer:
        """Load another mission, which waits for its start; refused during a mission and for a faulty mission."""
        software = self.software
        answer = self.status.check_request(VehicleRequest.LOAD)
        if not answer:
            return answer
        if self._command is not NO_COMMAND:
            return reject_temporarily("another request is being carried out; repeat the request")
        m = self._estimate
        known = m is not None and bool(np.isfinite(m.position).all())
        n, e = (float(m.position[0]), float(m.position[1])) if m is not None and known else mission.start_m
        heading = float(m.attitude[2]) if m is not None and known else 0.0
        fault = self.energy_check.find_start_refusal(software.limit_mission(mission), (n, e), heading)
        if fault:
            return deny_request(fault)
        try:
            software.load_mission(mission)
        except InputError as error:
            return deny_request(str(error))
        return REQUEST_ACCEPTED
