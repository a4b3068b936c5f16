"""Inputs, outputs and memory of the mission state machine: states, signals, references."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.logs.mcap import FlightEvent
from mufly.mission.avoidance import EMPTY_PATH_CHECK, BeamRing, ObstacleMap, PathCheck, make_beam_ring
from mufly.mission.detour import Detour
from mufly.mission.files.mission_schema import Mission
from mufly.mission.machine.log_messages import LogTemplate
from mufly.mission.machine.offboard import SetPoint
from mufly.mission.trajectory import BrakingMotion, Trajectory, TrajectoryLimits, TrajectoryPoint, Triple
from mufly.vehicle import Vehicle

Motors = Literal["off", "spin_up", "fly", "ramp_down", "blind"]


class State(StrEnum):
    """States of the mission: those of the dissertation's Fig. 6.15, and ``offboard`` for a program's set-points."""

    INIT = "init"
    TAKE_OFF = "take-off"
    HOVER = "hover"
    WAYPOINT = "waypoint"
    OBSTACLE = "obstacle"
    LANDING = "landing"
    RC = "rc"
    OFFBOARD = "offboard"


@dataclass(frozen=True, slots=True)
class Command:
    """Requests of the user at one step; by default none.

    Attributes
    ----------
    start : bool
        Take off and fly the mission; resume it in a hover after a user's waypoint, a pause or RC.
    first_waypoint : int or None
        With ``start``: the waypoint (from 0) to fly to first; also during the mission.
    take_off_height : float or None
        Take off to this height above the floor (m) and hold; the mission waits.
    pause : bool
        Stop and hover; ``start`` resumes.
    waypoint : (3,) tuple or None
        Fly to this position (N, E, D; m) and hold; the mission waits.
    heading : float or None
        Heading (rad) during the flight to ``waypoint`` and there; without a waypoint: turn to it.
    return_requested : bool
        Fly to above the take-off position and land.
    land : bool
        Land at once.
    motor_stop_reason : str
        Stop the motors at once, in any state; the text is the reason. "" is no signal.
    rc_active : bool
        The pilot controls the vehicle while this is set.
    pilot_roll, pilot_pitch : float
        Pilot's attitude (rad).
    pilot_yaw_rate, pilot_climb_rate : float
        Pilot's yaw rate (rad/s) and climb rate (m/s, positive up).
    program_set_point : SetPoint or None
        Set-point of a program, which controls the vehicle while there is one.
    """

    start: bool = False
    first_waypoint: int | None = None
    take_off_height: float | None = None
    pause: bool = False
    waypoint: Triple | None = None
    heading: float | None = None
    return_requested: bool = False
    land: bool = False
    motor_stop_reason: str = ""
    rc_active: bool = False
    pilot_roll: float = 0.0
    pilot_pitch: float = 0.0
    pilot_yaw_rate: float = 0.0
    pilot_climb_rate: float = 0.0
    program_set_point: SetPoint | None = None


NO_COMMAND = Command()
"""Command without any signal."""


@dataclass(frozen=True, slots=True)
class Reference:
    """Reference motion that the controllers track, and the mode of the motors.

    Attributes
    ----------
    position, velocity, acceleration : (3,) arrays
        N-E-D (m, m/s, m/s2).
    heading, heading_rate : float
        Continuous heading (rad; not wrapped, near the measured one) and its rate (rad/s).
    motors : {"off", "spin_up", "fly", "ramp_down", "blind"}
        Mode of the motors.
    rc_active : bool
        Whether roll and pitch come from the pilot instead of the position controller; height and heading are controlled
        as usual.
    pilot_roll, pilot_pitch : float
        Pilot's attitude (rad).
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    heading: float
    heading_rate: float
    motors: Motors
    rc_active: bool = False
    roll: float = 0.0
    pitch: float = 0.0


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """Input of the state machine: a mission, and the data of the vehicle that it needs, in SI units.

    Attributes
    ----------
    mission : Mission
        The mission.
    beam_ring : BeamRing
        The vehicle's range beams.
    low_battery_V : float
        Voltage below which the vehicle lands (V).
    """

    mission: Mission
    beam_ring: BeamRing
    low_battery_V: float

    @property
    def trajectory_limits(self) -> TrajectoryLimits:
        """Limits of the mission's trajectories."""
        return self.mission.trajectory_limits

    @property
    def avoids_obstacles(self) -> bool:
        """Whether the vehicle detects and avoids obstacles."""
        return self.mission.avoidance.enabled

    @property
    def scans_by_yawing(self) -> bool:
        """Whether the vehicle yaws to and fro to scan for obstacles."""
        return self.mission.scans_by_yawing


def prepare_mission_plan(mission: Mission, vehicle: Vehicle) -> MissionPlan:
    """Return the plan of a mission for a vehicle.

    Parameters
    ----------
    mission : Mission
        Checked mission, as `load_mission` returns it.
    vehicle : Vehicle
        Source of range ring and battery limit.

    Raises
    ------
    InputError
        If the mission's landing voltage is above the battery's nominal voltage.
    """
    low = mission.battery.low_V
    if low is not None and low > float(vehicle.battery.nominal_voltage):
        raise InputError(
            mission.name,
            "battery.low_V",
            f"{low:g} V is above the nominal {float(vehicle.battery.nominal_voltage):g} V of the battery",
            f"leave it out to land at {float(vehicle.battery.low_voltage):g} V",
        )
    r = vehicle.range_ring
    beams = make_beam_ring(r.count, float(r.first_angle), float(r.max_range))
    return MissionPlan(mission, beams, float(vehicle.battery.low_voltage) if low is None else low)


_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class MissionState:
    """State of the mission state machine between steps.

    Attributes
    ----------
    state : State
        State of Fig. 6.15.
    time_s, state_entered_s, motion_clock_s : float
        Time of the last step; time of entry to the state; time on the present motion, which a gate can hold (s).
    step_duration_s : float
        Length of the last step (s).
    motors : str
        Mode of the motors.
    waypoint_index : int
        Present or next waypoint (from 0).
    outcome, reason : str
        "" while undecided, then "succeeded" or "failed", and the reason.
    finished : bool
        On the floor with the motors off, after a mission.
    user_in_control : bool
        The user's signals have interrupted the mission; ``start`` resumes it.
    has_taken_off : bool
        The vehicle has taken off, so ``home_position`` is valid.
    mission_begun : bool
        The mission's waypoints have been requested.
    reached_waypoint_count : int
        Number of waypoints reached since take-off.
    abort_reason : str
        Reason for the user's abort; counts after landing.
    returning_home : bool
        The present leg leads home, to a landing.
    events : tuple of FlightEvent
        Log, the latest `LOG_CAPACITY` entries.
    logged_event_count : int
        Number of entries ever logged.
    home_position, hold_position, goal : (3,) tuples
        Position before take-off; position held without a motion; goal of the state (m).
    hold_heading : float
        Heading held without a motion (rad).
    motion : Trajectory, BrakingMotion or None
        Present motion.
    hover_until_s : float
        End time of a hover (s).
    descent_rate, descent_acceleration : float
        Descent rate of a landing's reference and its derivative (m/s, m/s2).
    rest_duration_s : float
        Time at rest on the floor (s).
    touchdown_speed : float
        Greatest descent rate near the floor in this landing (m/s).
    battery_V, low_battery_duration_s : float
        Filtered voltage; time for which it has been low (s).
    obstacle_map : ObstacleMap
        Points that the beams have hit.
    next_beam : int
        Next beam to be processed.
    path_check : PathCheck
        Check of the path against the points processed since the last step.
    detour : Detour or None
        Detour around an obstacle, or the last one on this leg.
    state_after_detour : State
        State to resume after a detour.
    detour_duration_s : float
        Time spent on detours on this leg (s).
    resumed_after_detour : bool
        The leg continues after a detour.
    scan_duration_s : float
        Duration of the nose swing (s, at most 3; it counts down from 1 to stop).
    requested_heading : float or None
        Heading of the user's waypoint (rad).
    set_point_reference : TrajectoryPoint or None
        Reference that follows set-points.
    hover_after_take_off : bool
        A pause was requested before lift-off and follows the take-off.
    """

    state: State = State.INIT
    time_s: float = 0.0
    state_entered_s: float = 0.0
    motion_clock_s: float = 0.0
    step_duration_s: float = 0.0
    motors: Motors = "off"
    waypoint_index: int = 0
    outcome: Literal["", "succeeded", "failed"] = ""
    reason: str = ""
    finished: bool = False
    user_in_control: bool = False
    has_taken_off: bool = False
    mission_begun: bool = False
    reached_waypoint_count: int = 0
    abort_reason: str = ""
    returning_home: bool = False
    events: tuple[FlightEvent, ...] = ()
    logged_event_count: int = 0
    home_position: Triple = _ORIGIN
    hold_position: Triple = _ORIGIN
    goal: Triple = _ORIGIN
    hold_heading: float = 0.0
    motion: Trajectory | BrakingMotion | None = None
    hover_until_s: float = 0.0
    descent_rate: float = 0.0
    descent_acceleration: float = 0.0
    rest_duration_s: float = 0.0
    touchdown_speed: float = 0.0
    battery_V: float = math.inf
    low_battery_duration_s: float = 0.0
    obstacle_map: ObstacleMap = field(default_factory=ObstacleMap.make_empty_map)
    next_beam: int = 0
    path_check: PathCheck = EMPTY_PATH_CHECK
    detour: Detour | None = None
    state_after_detour: State = State.HOVER
    detour_duration_s: float = 0.0
    resumed_after_detour: bool = False
    scan_duration_s: float = 0.0
    requested_heading: float | None = None
    set_point_reference: TrajectoryPoint | None = None
    hover_after_take_off: bool = False


def log_event(s: MissionState, text: str, state: State | None = None, level: str = "info") -> MissionState:
    """Return the mission state with a new log entry."""
    entry = FlightEvent(s.time_s, str(state or s.state), text, level)
    return replace(s, events=(*s.events[1 - LOG_CAPACITY :], entry), logged_event_count=s.logged_event_count + 1)


LOG_CAPACITY = 256
"""Number of log entries kept, also on flights of hours."""


def enter_state(s: MissionState, state: State, why: str, *, level: str = "info", **changes: object) -> MissionState:
    """Return the mission in another state, with the reason in its log and the time of the motion restarted at 0.

    The present motion ends unless ``changes`` contains one.
    """
    fresh = {
        "state": state,
        "state_entered_s": s.time_s,
        "motion_clock_s": 0.0,
        "motion": None,
        "set_point_reference": None,
        "hover_after_take_off": False,
    }
    return replace(log_event(s, why, state, level), **(fresh | changes))  # type: ignore[arg-type]


def enter_hover(
    s: MissionState, why: str, at: Triple, heading: float, *, level: str = "info", **changes: object
) -> MissionState:
    """Enter a hover at a position (N, E, D; m) with a heading (rad)."""
    return enter_state(s, State.HOVER, why, level=level, hold_position=at, goal=at, hold_heading=heading, **changes)


def fail_mission(s: MissionState, why: str) -> MissionState:
    """Mark the mission as failed; the first reason stays."""
    return s if s.outcome == "failed" else replace(s, outcome="failed", reason=why)


def initial_mission_state(plan: MissionPlan, estimate: Estimate) -> MissionState:
    """Return the state before the start signal: on the floor, motors off.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare_mission_plan`.
    estimate : Estimate
        Present position.
    """
    n, e, d = estimate.position.tolist()
    return MissionState(
        time_s=estimate.time_s,
        state_entered_s=estimate.time_s,
        hold_position=(n, e, d),
        home_position=(n, e, d),
        hold_heading=float(estimate.attitude[2]),
        battery_V=float(estimate.battery_voltage),
        events=(FlightEvent(estimate.time_s, str(State.INIT), LogTemplate.READY_FOR_MISSION(plan.mission.name)),),
        logged_event_count=1,
    )
