"""Convert the records of one instance of the exported flight software, through cffi.

Inputs (estimate, command, mission) are copied into the records of the C headers. Outputs (mission state, log,
reference, actuators) are converted to the objects of the simulation. A log entry on board is a template with numbers
(:mod:`mufly.mission.machine.log_messages`); this module formats the same text as Python. Input texts, such as the
reason of a stop or of a sensor fault, are represented on board by a number.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.control import FlightController
from mufly.estimate import Estimate, SensorStatus
from mufly.estimate.filter.filter_records import ERROR_ATTITUDE, ERROR_GYRO_BIAS, ERROR_POSITION, ERROR_VELOCITY
from mufly.estimate.sensor_status import REASON_COUNT, SUSPICIOUS_REASONS, describe_reason
from mufly.firmware.export.plan_tables import HOST_MAX_WAYPOINTS, collect_plan_fields, collect_setup_fields
from mufly.firmware.host_build import Firmware, FirmwareControllers
from mufly.flight.controllers import Actuators
from mufly.flight.estimator_health import describe_sensor_status, find_sensor_name
from mufly.flight.oscillation_detector import ACTUATOR_INPUT_NAMES, Oscillation
from mufly.logs.mcap import FlightEvent
from mufly.mission import (
    NO_COMMAND,
    Command,
    LogTemplate,
    MissionPlan,
    MissionState,
    Reference,
    State,
)
from mufly.mission.avoidance import MAP_CAPACITY, ObstacleMap, PathCheck
from mufly.mission.detour import Detour
from mufly.mission.machine.mission_state import LOG_CAPACITY
from mufly.mission.trajectory import (
    BrakingMotion,
    MotionProfile,
    PendingCurve,
    TimedSpline,
    Trajectory,
    TrajectoryPoint,
)
from mufly.quantities.quantity_table import READINGS_WITH_FUSION_STATUS

if TYPE_CHECKING:
    from cffi import FFI

MISSION_STATES = tuple(State)
MOTOR_MODES: tuple[Any, ...] = ("off", "spin_up", "fly", "ramp_down", "blind")
_MISSION_OUTCOMES: tuple[Any, ...] = ("", "succeeded", "failed")
_LOG_LEVELS = ("info", "warning", "error")
_SENSOR_STATUSES = ("waiting", "fused", "rejected", "missing", "faulty")
_STATUS_NOT_FITTED = len(_SENSOR_STATUSES)
_REQUIRED_ESTIMATES = ("position", "velocity", "attitude", "rates")
_MESSAGE_TEMPLATES = tuple(LogTemplate)


class TextNumberTable:
    """Table of the texts that the C code represents by a number."""

    def __init__(self) -> None:
        self._texts_by_number: list[str] = [""]
        self._numbers_by_text: dict[str, int] = {"": 0}

    def assign_number(self, text: str) -> int:
        """Return the number of a text, adding the text if new; the empty text has number 0."""
        if text not in self._numbers_by_text:
            self._numbers_by_text[text] = len(self._texts_by_number)
            self._texts_by_number.append(text)
        return self._numbers_by_text[text]

    def look_up_text(self, number: int) -> str:
        """Return the text that the C code represents by a number."""
        return self._texts_by_number[number]


class SoftwareInstance:
    """A ``software_t`` record with its plan, driven from Python.

    Parameters
    ----------
    firmware : Firmware
    controller : FlightController
    plan : MissionPlan
    """

    def __init__(self, firmware: Firmware, controller: FlightController, plan: MissionPlan) -> None:
        f = self.firmware = firmware
        self.text_table = TextNumberTable()
        self.estimate_record, self.command_record = f.ffi.new("estimate_t *"), f.ffi.new("command_t *")
        self.actuators_record, self.software_record = f.ffi.new("actuators_t *"), f.ffi.new("software_t *")
        self._plan_record, self.setup_record = f.ffi.new("plan_t *"), f.ffi.new("flight_setup_t *")
        for name, value in collect_setup_fields(controller).items():
            setattr(self.setup_record, name, value)
        self.setup_record.plan = self._plan_record
        self.setup_record.gains = self._gains_record = (
            f.make_gains(controller) if f.is_generic else f.ffi.addressof(f.lib.mufly_gains)
        )
        self._last_command: Command | None = None
        self.write_mission_plan(plan)
        self.reset_software()

    def reset_software(self) -> None:
        """Reset the software to its state before the first period."""
        self.firmware.lib.software_reset(self.setup_record, self.software_record)
        self._events: tuple[FlightEvent, ...] = ()
        self._log_count = 0

    def write_mission_plan(self, plan: MissionPlan) -> None:
        """Write the numbers of a mission into the plan."""
        ffi = self.firmware.ffi
        numbers = collect_plan_fields(plan, HOST_MAX_WAYPOINTS)
        fresh = ffi.new("plan_t *", numbers)
        ffi.memmove(self._plan_record, fresh, ffi.sizeof("plan_t"))
        self._mission_name = plan.mission.name

    def reset_mission_state(self, name: str) -> None:
        """Reset the mission state for a newly loaded mission, which waits for a start command."""
        self._mission_name = name or "a mission"
        self.firmware.lib.reset_for_loaded_mission(
            self._plan_record, self.firmware.ffi.addressof(self.software_record, "mission")
        )
        self.read_log()

    def step(self, m: Estimate, command: Command) -> Actuators:
        """Compute one control period and return the actuator commands."""
        self.write_estimate(m)
        self._write_command_record(command)
        self.firmware.lib.software_step(
            self.setup_record,
            self.software_record,
            self.estimate_record,
            self.command_record,
            self.actuators_record,
        )
        self.read_log()
        out = self.actuators_record
        return Actuators(np.array(list(out.motor_input)), np.array(list(out.servo_input)))

    # Inputs

    def write_estimate(self, m: Estimate) -> None:
        """Copy an estimate into the C record that the software reads."""
        b = self.estimate_record
        b.time_s, b.valid = m.time_s, m.valid
        now = b.motion
        now.position, now.velocity = m.position.tolist(), m.velocity.tolist()
        now.attitude, now.rates, now.voltage = m.attitude.tolist(), m.rates.tolist(), m.battery_voltage
        self.write_ranges(m.ranges)
        b.judged = m.auxiliary_states is not None
        if m.auxiliary_states is None:
            return
        b.specific_force = m.auxiliary_states.specific_force.tolist()
        variance = m.covariance.diagonal().tolist()
        b.position_variance, b.attitude_variance = (
            variance[ERROR_POSITION:ERROR_VELOCITY],
            variance[ERROR_ATTITUDE:ERROR_GYRO_BIAS],
        )
        for one in b.checks:
            one.status = _STATUS_NOT_FITTED
        for check in m.auxiliary_states.checks:
            one = b.checks[READINGS_WITH_FUSION_STATUS.index(check.name)]
            one.status, one.why = (
                _SENSOR_STATUSES.index(check.status),
                self.text_table.assign_number(check.reason),
            )

    def write_ranges(self, ranges: NDArray[np.floating[Any]]) -> None:
        """Copy the range readings (m) into the estimate's record; missing beams get the maximum range."""
        ring = self._plan_record.beam_ring
        count = min(len(ranges), ring.count)
        self.estimate_record.ranges[0 : ring.count] = [
            *ranges.tolist()[:count],
            *[ring.max_range] * (ring.count - count),
        ]

    def list_reason_text_numbers(self) -> NDArray[np.int64]:
        """Return the text number of each reason of the filter's sensor checks
        (:mod:`mufly.estimate.filter.measurements.sensor_checks`).

        The number is -1 if the text contains a value, or if the reason must be reported.
        """
        words = [
            (
                describe_reason(why, 1.0, 0),
                why not in SUSPICIOUS_REASONS and describe_reason(why, 1.0, 0) == describe_reason(why, 2.0, 0),
            )
            for why in range(REASON_COUNT)
        ]
        return np.array([self.text_table.assign_number(text) if plain else -1 for text, plain in words])

    @property
    def beam_count(self) -> int:
        """Return the number of beams of the range ring."""
        return int(self._plan_record.beam_ring.count)

    def prepare_compiled_periods(self, law: FirmwareControllers) -> None:
        """Prepare the records for the compiled loop: set the current gains and an empty command."""
        self.setup_record.gains = law.advance_gains()
        self._write_command_record(NO_COMMAND)

    def _write_command_record(self, c: Command) -> None:
        if c is NO_COMMAND and self._last_command is NO_COMMAND:
            return
        self._last_command = c
        to = self.command_record
        to.start, to.pause, to.return_requested, to.land, to.rc_active = (
            c.start,
            c.pause,
            c.return_requested,
            c.land,
            c.rc_active,
        )
        to.has_first_waypoint, to.first_waypoint = c.first_waypoint is not None, c.first_waypoint or 0
        to.has_take_off_height, to.take_off_height = c.take_off_height is not None, c.take_off_height or 0.0
        to.has_waypoint, to.waypoint = c.waypoint is not None, c.waypoint or (0.0, 0.0, 0.0)
        to.has_heading, to.heading = c.heading is not None, c.heading or 0.0
        to.motor_stop_reason = self.text_table.assign_number(c.motor_stop_reason)
        to.pilot_roll, to.pilot_pitch = c.pilot_roll, c.pilot_pitch
        to.pilot_yaw_rate, to.pilot_climb_rate = c.pilot_yaw_rate, c.pilot_climb_rate
        to.has_program_set_point = c.program_set_point is not None
        if c.program_set_point is not None:
            nan = (math.nan, math.nan, math.nan)
            p = c.program_set_point
            to.program_set_point.position, to.program_set_point.velocity = p.position_m or nan, p.velocity_m_s or nan
            to.program_set_point.heading = math.nan if p.heading_rad is None else p.heading_rad
            to.program_set_point.yaw_rate = math.nan if p.yaw_rate_rad_s is None else p.yaw_rate_rad_s

    # Outputs

    def read_log(self) -> None:
        """Read the log entries since the last call."""
        s = self.software_record.mission
        kept = len(s.log)
        if s.logged_event_count < self._log_count:
            self._events, self._log_count = (), 0
        for k in range(max(self._log_count, s.logged_event_count - kept), s.logged_event_count):
            e = s.log[k % kept]
            self._events = (
                *self._events[1 - LOG_CAPACITY :],
                FlightEvent(
                    e.time_s,
                    str(MISSION_STATES[e.state]),
                    self.format_message(e.message),
                    _LOG_LEVELS[e.level],
                ),
            )
        self._log_count = s.logged_event_count

    def read_sensor_reason(self, b: Any) -> str:
        """Return the reason for the status in a ``message_sensor_t`` as a text."""
        return self.text_table.look_up_text(b.why)

    def format_message(self, message: Any) -> str:
        """Return the text of a log entry (``message_t``)."""
        word, numbers = _MESSAGE_TEMPLATES[message.code], list(message.number)
        wrong = [
            SensorStatus(
                READINGS_WITH_FUSION_STATUS[b.sensor],
                _SENSOR_STATUSES[b.status],  # type: ignore[arg-type]
                reason=self.read_sensor_reason(b),
            )
            for b in message.faulty_sensors
            if b.sensor >= 0
        ]
        because = f" ({'; '.join(describe_sensor_status(c) for c in wrong)})" if wrong else ""
        if word is LogTemplate.GIVEN_TEXT:
            return describe_sensor_status(wrong[0]) if wrong else self.text_table.look_up_text(int(numbers[0]))
        if word is LogTemplate.READY_FOR_MISSION:
            return word(self._mission_name)
        if word in (LogTemplate.WAYPOINTS_LOADED, LogTemplate.ONE_WAYPOINT_LOADED):
            return word(self._mission_name, numbers[0])
        if word is LogTemplate.MEASUREMENT_LOST:
            names = [name for k, name in enumerate(_REQUIRED_ESTIMATES) if int(numbers[0]) >> k & 1]
            return word(" and ".join(names) or "all, which is frozen")
        if word is LogTemplate.ATTITUDE_CONTRADICTED:
            return word(" and ".join(find_sensor_name(c.name) for c in wrong))
        if word is LogTemplate.POSITION_UNCERTAIN_TOO_LONG:
            return word(numbers[0], because, numbers[1])
        return word(*numbers) + because

    @property
    def state(self) -> MissionState:
        """Return the state of the mission logic."""
        s = self.software_record.mission
        return MissionState(
            state=MISSION_STATES[s.state],
            time_s=s.time_s,
            state_entered_s=s.state_entered_s,
            motion_clock_s=s.motion_clock_s,
            step_duration_s=s.step_duration_s,
            motors=MOTOR_MODES[s.motors],
            waypoint_index=s.waypoint_index,
            outcome=_MISSION_OUTCOMES[s.outcome],
            reason=self.format_message(s.reason),
            finished=s.finished,
            user_in_control=s.user_in_control,
            has_taken_off=s.has_taken_off,
            mission_begun=s.mission_begun,
            reached_waypoint_count=s.reached_waypoint_count,
            abort_reason=self.format_message(s.abort_reason),
            returning_home=s.returning_home,
            events=self._events,
            logged_event_count=self._log_count,
            home_position=tuple(s.home_position),
            hold_position=tuple(s.hold_position),
            goal=tuple(s.goal),
            hold_heading=s.hold_heading,
            motion=read_active_motion(s.course),
            hover_until_s=s.hover_until_s,
            descent_rate=s.descent_rate,
            descent_acceleration=s.descent_acceleration,
            rest_duration_s=s.rest_duration_s,
            touchdown_speed=s.touchdown_speed,
            battery_V=s.battery_V,
            low_battery_duration_s=s.low_battery_duration_s,
            obstacle_map=self._read_obstacle_map(s.obstacle_map),
            next_beam=s.next_beam,
            path_check=read_path_check(s.path_check),
            detour=read_detour(s.detour) if s.has_detour else None,
            state_after_detour=MISSION_STATES[s.state_after_detour],
            detour_duration_s=s.detour_duration_s,
            resumed_after_detour=s.resumed_after_detour,
            scan_duration_s=s.scan_duration_s,
            requested_heading=s.requested_heading if s.has_requested_heading else None,
            set_point_reference=read_trajectory_point(s.set_point_reference) if s.has_set_point_reference else None,
            hover_after_take_off=s.hover_after_take_off,
        )

    def _read_obstacle_map(self, m: FFI.CData) -> ObstacleMap:
        raw = np.frombuffer(self.firmware.ffi.buffer(m.points), dtype=self.firmware.real_dtype)
        return ObstacleMap(raw.reshape(MAP_CAPACITY, 4).astype(np.float64), m.point_count, m.next_replaced_row)

    @property
    def reference(self) -> Reference:
        """Return the present reference of the controllers."""
        r = self.software_record.reference
        p = r.path
        return Reference(
            np.array(list(p.position)), np.array(list(p.velocity)), np.array(list(p.acceleration)), r.heading,
            r.heading_rate, MOTOR_MODES[r.motors], rc_active=r.rc_active, roll=r.roll, pitch=r.pitch,
        )  # fmt: skip

    @property
    def oscillation(self) -> Oscillation | None:
        """Return the detected oscillation of an actuator; None without one."""
        o = self.software_record.oscillation
        if not o.is_present:
            return None
        return Oscillation(ACTUATOR_INPUT_NAMES[o.input_name], o.start_s, o.duration_s, o.swing, o.frequency_Hz)


def read_motion_profile(p: FFI.CData) -> MotionProfile:
    return MotionProfile(p.distance, p.peak_speed, p.ramp_s, p.cruise_s)


def read_braking_motion(b: FFI.CData) -> BrakingMotion:
    return BrakingMotion(tuple(b.start), tuple(b.velocity), b.heading, b.duration_s, b.heading_rate, b.turn_duration_s)


def read_trajectory_point(p: FFI.CData) -> TrajectoryPoint:
    return TrajectoryPoint(tuple(p.position), tuple(p.velocity), tuple(p.acceleration), p.heading, p.heading_rate)


def read_active_motion(c: FFI.CData) -> Trajectory | BrakingMotion | None:
    if c.kind == 0:
        return None
    if c.kind == 2:
        return read_braking_motion(c.brake)
    w, curve = c.way, None
    if w.has_spline_curve:
        curve = TimedSpline(
            tuple(tuple(row) for row in w.spline_curve.coefficients),
            tuple(w.spline_curve.arc_lengths),
            read_motion_profile(w.spline_curve.speed_profile),
        )
    return Trajectory(
        tuple(w.start),
        tuple(w.goal),
        w.start_heading,
        w.turn_angle,
        read_motion_profile(w.height_profile),
        read_motion_profile(w.yaw_profile),
        read_motion_profile(w.path_profile),
        w.path_start_s,
        w.duration_s,
        curve,
        read_braking_motion(w.initial_braking) if w.has_initial_braking else None,
        PendingCurve(tuple(tuple(row) for row in w.spline_curve.coefficients), *w.curve_limits)
        if w.pending_parts
        else None,
    )


def read_path_check(s: FFI.CData) -> PathCheck:
    n, e, d = s.from_point
    goal_n, goal_e = s.goal_point
    block_n, block_e = s.nearest_blocking_point
    return PathCheck(
        n,
        e,
        d,
        goal_n,
        goal_e,
        s.look_ahead_m,
        s.checked_point_count,
        s.path_clearance_sq,
        s.path_start_clearance_sq,
        s.goal_clearance_sq,
        s.lateral_offset_sum,
        s.blocking_point_count,
        s.nearest_blocking_distance_sq,
        block_n,
        block_e,
        np.array([list(row) for row in s.nearest_point_by_sector]),
    )


def read_detour(d: FFI.CData) -> Detour:
    return Detour(
        tuple(d.position),
        tuple(d.velocity),
        tuple(d.acceleration),
        d.passing_side,
        tuple(d.hit_point),
        d.hit_goal_distance,
        obstacle_count=d.obstacle_count,
        side_change_deviation_m=d.side_change_deviation_m,
        path_clear_duration_s=d.path_clear_duration_s,
        stuck_check_point=tuple(d.stuck_check_point),
        stuck_duration_s=d.stuck_duration_s,
        lap_start_point=tuple(d.lap_start_point) if d.has_lap_start else None,
        lap_count=d.lap_count,
        lap_distance_m=d.lap_distance_m,
        lap_min_goal_distance_m=d.lap_min_goal_distance_m,
        is_leaving_contour=d.is_leaving_contour,
        obstacle_point=tuple(d.obstacle_point),
    )
