"""What goes in and out of the mission state machine, and what it remembers: states, signals, references, memory."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.logs.mcap import FlightEvent
from mufly.mission.avoidance import EMPTY_PATH_CHECK, BeamRing, ObstacleMap, PathCheck, make_beam_ring
from mufly.mission.detour import Detour
from mufly.mission.log_messages import LogMessage
from mufly.mission.mission_schema import Mission
from mufly.mission.offboard import SetPoint
from mufly.mission.trajectory import BrakingMotion, Trajectory, TrajectoryLimits, TrajectoryPoint, Triple
from mufly.vehicle import Vehicle

Motors = Literal["off", "spin_up", "fly", "ramp_down", "blind"]


class State(StrEnum):
    """States of Fig. 6.15, and ``offboard``, which it does not have: a program streams set-points."""

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
    """The user's signals at one step; the default is no signal.

    Attributes
    ----------
    start : bool
        Take off and fly the mission; in a hover after a user's waypoint, a pause or RC, go on with it.
    first_waypoint : int or None
        With ``start``: the waypoint (from 0) to fly to first; also while the mission is being flown.
    take_off_height : float or None
        Take off to this height above the floor (m) and hold; the mission waits.
    pause : bool
        Stop and hover; ``start`` goes on.
    waypoint : (3,) tuple or None
        Fly there (N, E, D; m) and hold; the mission waits.
    heading : float or None
        Heading (rad) on the way to ``waypoint`` and there; without a waypoint: turn to it.
    return_requested : bool
        Fly to above where it took off, and land.
    land : bool
        Land now.
    stop_reason : str
        Motors off at once, whatever the state; the text says why. "" is no signal.
    rc_active : bool
        The pilot flies, for as long as this is set.
    roll, pitch : float
        Pilot's attitude (rad).
    yaw_rate, climb_rate : float
        Pilot's rate of turn (rad/s) and of climb (m/s, positive up).
    program_set_point : SetPoint or None
        A program flies, for as long as there is one.
    """

    start: bool = False
    first_waypoint: int | None = None
    take_off_height: float | None = None
    pause: bool = False
    waypoint: Triple | None = None
    heading: float | None = None
    return_requested: bool = False
    land: bool = False
    stop_reason: str = ""
    rc_active: bool = False
    roll: float = 0.0
    pitch: float = 0.0
    yaw_rate: float = 0.0
    climb_rate: float = 0.0
    program_set_point: SetPoint | None = None


NO_COMMAND = Command()
"""The usual one: nothing is asked for."""


@dataclass(frozen=True, slots=True)
class Reference:
    """What the controllers have to follow.

    Attributes
    ----------
    position, velocity, acceleration : (3,) arrays
        N-E-D (m, m/s, m/s2).
    heading, heading_rate : float
        Continuous heading (rad; not wrapped, near the measured one) and its rate (rad/s).
    motors : {"off", "spin_up", "fly", "ramp_down", "blind"}
        What the motors are to do.
    rc_active : bool
        Whether roll and pitch come from the pilot in place of the position controller; height and heading are
        followed as ever.
    roll, pitch : float
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
    """A mission with what its state machine has to know of the vehicle, all in SI units.

    Attributes
    ----------
    mission : Mission
        The mission.
    ring : Ring
        The vehicle's range beams.
    low_battery_V : float
        Voltage below which it lands (V).
    """

    mission: Mission
    ring: BeamRing
    low_battery_V: float

    @property
    def trajectory_limits(self) -> TrajectoryLimits:
        """The mission's limits on trajectories."""
        return self.mission.trajectory_limits

    @property
    def avoids_obstacles(self) -> bool:
        """Whether it avoids obstacles."""
        return self.mission.avoidance.enabled

    @property
    def scans_with_nose(self) -> bool:
        """Whether it swings its nose to see them."""
        return self.mission.scans_with_nose


def prepare_plan(mission: Mission, vehicle: Vehicle) -> MissionPlan:
    """Join a mission and the vehicle that is to fly it.

    Parameters
    ----------
    mission : Mission
        Checked, as `load_mission` returns it.
    vehicle : Vehicle
        Its range ring and battery limit are used.

    Raises
    ------
    InputError
        The mission says to land at a voltage above the nominal one of the battery.
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
    """All that the state machine remembers from one step to the next.

    Attributes
    ----------
    state : State
        State of Fig. 6.15.
    time_s, state_entered_s, motion_clock_s : float
        Time of the last step; when the state was entered; time on the present motion, which a gate can hold (s).
    step_duration_s : float
        Length of the last step (s).
    motors : str
        What the motors are to do.
    waypoint_index : int
        The waypoint that is flown to or comes next (from 0).
    outcome, reason : str
        "" while it is open, then "succeeded" or "failed", and why.
    finished : bool
        Back on the floor with the motors off, after a mission.
    manual : bool
        The user's signals have interrupted the mission; ``start`` goes on with it.
    has_taken_off : bool
        It has taken off, so that ``home_position`` is where it comes home to.
    mission_begun : bool
        The waypoints of the mission have been asked for.
    reached_count : int
        How many of its waypoints were reached since take-off.
    abort_reason : str
        Why the user broke the mission off; counts once it is down.
    returning_home : bool
        The leg leads home, where it lands.
    events : tuple of Event
        Log, the latest `LOG_CAPACITY` entries.
    logged_count : int
        How many entries there have been.
    home_position, hold_position, goal : (3,) tuples
        Where it stood before take-off; where it stays when it has no motion; where the state wants to be (m).
    hold_heading : float
        Heading to keep when there is no motion (rad).
    motion : Trajectory, Stop or None
        What it follows.
    hover_until_s : float
        When a hover has lasted long enough (s).
    descent_rate, descent_acceleration : float
        Rate of descent of a landing's reference and its change (m/s, m/s2).
    still_duration_s : float
        For how long it has lain still on the floor (s).
    touchdown_speed : float
        Greatest rate of descent near the floor in this landing (m/s).
    battery_V, low_battery_duration_s : float
        Filtered voltage; for how long it has been low (s).
    obstacle_map : Memory
        Points that the beams have hit.
    next_beam : int
        The beam that is taken next.
    path_check : Sight
        What the points mean for where it goes, as far as they have been gone through since the last step.
    detour : Detour or None
        Way around an obstacle, or the last one on this leg.
    resume_state : State
        Where to go once it is avoided.
    detour_duration_s : float
        Time spent on detours on this leg (s).
    resumed_after_detour : bool
        The leg goes on after a detour.
    scan_duration_s : float
        For how long the nose has been swinging (s, at most 3; it counts down from 1 to stop).
    requested_heading : float or None
        Heading that the user's waypoint asks for (rad).
    set_point_reference : TrajectoryPoint or None
        Reference that follows set-points.
    hover_after_take_off : bool
        It was told to stop before it was off the floor, and does so once it is.
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
    manual: bool = False
    has_taken_off: bool = False
    mission_begun: bool = False
    reached_count: int = 0
    abort_reason: str = ""
    returning_home: bool = False
    events: tuple[FlightEvent, ...] = ()
    logged_count: int = 0
    home_position: Triple = _ORIGIN
    hold_position: Triple = _ORIGIN
    goal: Triple = _ORIGIN
    hold_heading: float = 0.0
    motion: Trajectory | BrakingMotion | None = None
    hover_until_s: float = 0.0
    descent_rate: float = 0.0
    descent_acceleration: float = 0.0
    still_duration_s: float = 0.0
    touchdown_speed: float = 0.0
    battery_V: float = math.inf
    low_battery_duration_s: float = 0.0
    obstacle_map: ObstacleMap = field(default_factory=ObstacleMap.empty)
    next_beam: int = 0
    path_check: PathCheck = EMPTY_PATH_CHECK
    detour: Detour | None = None
    resume_state: State = State.HOVER
    detour_duration_s: float = 0.0
    resumed_after_detour: bool = False
    scan_duration_s: float = 0.0
    requested_heading: float | None = None
    set_point_reference: TrajectoryPoint | None = None
    hover_after_take_off: bool = False


def initial_mission_state(plan: MissionPlan, estimate: Estimate) -> MissionState:
    """State before the start signal: on the floor, motors off.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare_plan`.
    estimate : Estimate
        Where it stands.
    """
    n, e, d = estimate.position.tolist()
    return MissionState(
        time_s=estimate.time_s,
        state_entered_s=estimate.time_s,
        hold_position=(n, e, d),
        home_position=(n, e, d),
        hold_heading=float(estimate.attitude[2]),
        battery_V=float(estimate.battery_voltage),
        events=(FlightEvent(estimate.time_s, str(State.INIT), LogMessage.READY_FOR_MISSION(plan.mission.name)),),
        logged_count=1,
    )


LOG_CAPACITY = 256
"""Entries of the log that are kept; it stays that short in a flight of hours."""


def log_event(s: MissionState, text: str, state: State | None = None, level: str = "info") -> MissionState:
    """The state with one more entry in its log."""
    entry = FlightEvent(s.time_s, str(state or s.state), text, level)
    return replace(s, events=(*s.events[1 - LOG_CAPACITY :], entry), logged_count=s.logged_count + 1)


def enter_state(s: MissionState, state: State, why: str, *, level: str = "info", **changes: object) -> MissionState:
    """Change state, with the reason, and start the clock of its motion, which it has not unless one is given."""
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
    """Enter a hover at a place (N, E, D; m), with a heading (rad)."""
    return enter_state(s, State.HOVER, why, level=level, hold_position=at, goal=at, hold_heading=heading, **changes)


def fail_mission(s: MissionState, why: str) -> MissionState:
    """The mission has failed; the first reason stays."""
    return s if s.outcome == "failed" else replace(s, outcome="failed", reason=why)


# ----------------------------------------------------------------------------
# What may be asked of the vehicle in which state: one table for the state machine, the autopilot, links and pages.


REQUEST_TABLE = """
asked     init      take-off  hover     waypoint  obstacle  landing   rc        offboard
arm       at-rest   at-rest   at-rest   at-rest   at-rest   at-rest   at-rest   at-rest
disarm    grounded  grounded  grounded  grounded  grounded  grounded  grounded  grounded
take-off  armed     up        up        up        up        up        up        up
start     armed     knows     knows     knows     knows     lands     by-hand   lifted
pause     floor     knows     knows     knows     knows     high      by-hand   lifted
go-to     floor     lifted    knows     knows     knows     lands     by-hand   lifted
return    floor     lifted    knows     knows     knows     lands     by-hand   lifted
land      floor     knows     knows     knows     knows     yes       by-hand   knows
offboard  yes       lifted    knows     knows     knows     lands     by-hand   yes
sticks    seen      seen      seen      seen      seen      seen      seen      seen
load      still     waits     waits     waits     waits     busy      busy      busy
stop      yes       yes       yes       yes       yes       yes       yes       yes
"""
"""What is asked, over the states of the mission; each word is a condition below, which says why not."""

GO_AROUND_HEIGHT_M = 0.4
"""Height above the floor from which a landing can be broken off (m)."""

OFF_FLOOR_HEIGHT_M = 0.2
"""Height above where it stood from which a take-off can be broken off (m)."""


@dataclass(frozen=True, slots=True)
class RequestAnswer:
    """Whether something asked for is done; ``bool(answer)`` says so.

    Attributes
    ----------
    accepted : bool
    reason : str
        Why not, with the remedy; or what to know about it.
    is_temporary : bool
        Refused for now; the same may be accepted later.
    short_reason : str
        Why not, in two or three words for a button.
    """

    accepted: bool
    reason: str = ""
    is_temporary: bool = False
    short_reason: str = ""

    def __bool__(self) -> bool:
        return self.accepted


REQUEST_ACCEPTED = RequestAnswer(True)


def deny_request(reason: str) -> RequestAnswer:
    """Refused, whenever it is asked."""
    return RequestAnswer(False, reason)


def reject_temporarily(reason: str, brief: str = "") -> RequestAnswer:
    """Refused for now."""
    return RequestAnswer(False, reason, is_temporary=True, short_reason=brief or reason)


class VehicleRequest(StrEnum):
    """What may be asked of a vehicle."""

    ARM = "arm"
    DISARM = "disarm"
    TAKE_OFF = "take-off"
    START = "start"
    PAUSE = "pause"
    GO_TO = "go-to"
    RETURN = "return"
    LAND = "land"
    OFFBOARD = "offboard"
    STICKS = "sticks"
    LOAD = "load"
    STOP = "stop"


class RequestContext(Protocol):
    """What decides: a :class:`MissionState`, or any record of a flight that has these."""

    @property
    def state(self) -> str: ...
    @property
    def motors(self) -> str: ...
    @property
    def outcome(self) -> str: ...
    @property
    def reason(self) -> str: ...
    @property
    def manual(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class _RequestFacts:
    context: RequestContext
    motors: str
    height_m: float
    armed: bool
    flying: bool


MOTORS_STOPPING = "its motors are being stopped; ask again"
"""Why nothing is taken between a stop and the step that carries it out."""

_MEASUREMENTS_LOST = reject_temporarily("measurements are lost; it comes down by itself", "comes down")


def _allow_always(f: _RequestFacts) -> RequestAnswer:
    return REQUEST_ACCEPTED


def _allow_at_rest(f: _RequestFacts) -> RequestAnswer:
    # Armed now, motors that still run would be given back what was taken from them.
    return REQUEST_ACCEPTED if f.armed or f.motors == "off" else reject_temporarily(MOTORS_STOPPING, "motors running")


def _allow_grounded(f: _RequestFacts) -> RequestAnswer:
    return (
        reject_temporarily("it flies; land first, or stop it by force", "in flight") if f.flying else REQUEST_ACCEPTED
    )


def _deny_in_air(f: _RequestFacts) -> RequestAnswer:
    return reject_temporarily(f"it is in state {str(f.context.state)!r} already", "in the air")


def _allow_armed(f: _RequestFacts) -> RequestAnswer:
    if f.motors != "off":
        return _deny_in_air(f)
    return REQUEST_ACCEPTED if f.armed else reject_temporarily("not armed; arm first", "not armed")


def _deny_on_floor(f: _RequestFacts) -> RequestAnswer:
    return reject_temporarily("it does not fly; take off first", "on the floor")


def _allow_unless_blind(f: _RequestFacts) -> RequestAnswer:
    return _MEASUREMENTS_LOST if f.motors == "blind" else REQUEST_ACCEPTED


def _deny_manual(f: _RequestFacts) -> RequestAnswer:
    return _allow_unless_blind(f) and reject_temporarily("the pilot flies; let go of the sticks first", "flown by hand")


def _allow_unless_failed(f: _RequestFacts) -> RequestAnswer:
    """It knows where it is, and has not given up."""
    failed = f.context.outcome == "failed"
    return _allow_unless_blind(f) and (
        reject_temporarily(f"it lands: {f.context.reason}", "landing") if failed else REQUEST_ACCEPTED
    )


def _deny_landing(f: _RequestFacts) -> RequestAnswer:
    return _allow_unless_failed(f) and reject_temporarily(
        f"it lands; pause first (above {GO_AROUND_HEIGHT_M:g} m)", "landing"
    )


def _allow_go_around(f: _RequestFacts) -> RequestAnswer:
    """Still high enough for a landing to be broken off."""
    if f.context.outcome == "failed" or f.motors != "fly":
        return _deny_landing(f)
    low = f.height_m <= GO_AROUND_HEIGHT_M
    return (
        reject_temporarily(f"landing, and below {GO_AROUND_HEIGHT_M:g} m already", "landing")
        if low
        else REQUEST_ACCEPTED
    )


def _allow_lifted(f: _RequestFacts) -> RequestAnswer:
    """Off the floor for good."""
    if f.motors == "spin_up" or f.height_m < OFF_FLOOR_HEIGHT_M:
        return _allow_unless_failed(f) and reject_temporarily(
            f"taking off; wait until it is {OFF_FLOOR_HEIGHT_M:g} m off the floor", "taking off"
        )
    return _allow_unless_failed(f)


def _deny_busy(f: _RequestFacts) -> RequestAnswer:
    return reject_temporarily(
        f"in state {str(f.context.state)!r} no mission is taken; pause or land first", "in flight"
    )


def _allow_motors_off(f: _RequestFacts) -> RequestAnswer:
    return REQUEST_ACCEPTED if f.motors == "off" else _deny_busy(f)


def _allow_mission_waiting(f: _RequestFacts) -> RequestAnswer:
    """It takes off by itself, hovers or flies where it was sent, and no mission is being flown."""
    if f.motors not in ("spin_up", "fly"):
        return _deny_busy(f)
    return (
        _allow_unless_failed(f)
        if f.context.manual
        else reject_temporarily("a mission is being flown; pause it first", "mission under way")
    )


_BY_WORD: dict[str, Callable[[_RequestFacts], RequestAnswer]] = {
    "yes": _allow_always,
    "at-rest": _allow_at_rest,
    "grounded": _allow_grounded,
    "up": _deny_in_air,
    "armed": _allow_armed,
    "floor": _deny_on_floor,
    "seen": _allow_unless_blind,
    "by-hand": _deny_manual,
    "knows": _allow_unless_failed,
    "lands": _deny_landing,
    "high": _allow_go_around,
    "lifted": _allow_lifted,
    "busy": _deny_busy,
    "still": _allow_motors_off,
    "waits": _allow_mission_waiting,
}
"""Conditions by the words of :data:`REQUEST_TABLE`."""


def _make_conditions() -> dict[tuple[str, str], Callable[[_RequestFacts], RequestAnswer]]:
    head, *rows = (line.split() for line in REQUEST_TABLE.strip().splitlines())
    words = {(ask, state): word for ask, *cells in rows for state, word in zip(head[1:], cells, strict=True)}
    return {key: _BY_WORD[word] for key, word in words.items()}


_CONDITIONS = _make_conditions()


def check_request(
    ask: VehicleRequest,
    situation: RequestContext,
    *,
    height_m: float = math.nan,
    armed: bool = True,
    flying: bool | None = None,
) -> RequestAnswer:
    """Whether the state that a vehicle is in lets it do something; what else there is against it is not asked here.

    Parameters
    ----------
    ask : Ask
    situation : Situation
        ``state`` may be one that is not ours (a flight mode of another autopilot): that counts as a hover or as the
        floor. ``motors`` may be "" where it is not known.
    height_m : float
        Above where it stood (m); NaN where it is not known.
    armed : bool
    flying : bool, optional
        Whether it is off the floor; by default its state says so.
    """
    state = situation.state
    up = state not in ("", State.INIT) if flying is None else flying
    condition = _CONDITIONS.get((ask, state)) or _CONDITIONS[ask, State.HOVER if up else State.INIT]
    motors = situation.motors or ("fly" if up else "off")
    return condition(_RequestFacts(situation, motors, height_m, armed, up))
