"""What goes in and out of the mission state machine, and what it remembers: states, signals, references, memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.logs.layout import Event
from mufly.mission.avoidance import Detour, Memory, Ring, ring
from mufly.mission.offboard import SetPoint
from mufly.mission.schema import Mission
from mufly.mission.trajectory import Limits, Point, Stop, Trajectory, Triple
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
    first : int or None
        With ``start``: the waypoint (from 0) to fly to first; also while the mission is being flown.
    take_off : float or None
        Take off to this height above the floor (m) and hold; the mission waits.
    pause : bool
        Stop and hover; ``start`` goes on.
    waypoint : (3,) tuple or None
        Fly there (N, E, D; m) and hold; the mission waits.
    heading : float or None
        Heading (rad) on the way to ``waypoint`` and there; without a waypoint: turn to it.
    home : bool
        Fly to above where it took off, and land.
    land : bool
        Land now.
    stop : str
        Motors off at once, whatever the state; the text says why. "" is no signal.
    rc : bool
        The pilot flies, for as long as this is set.
    roll, pitch : float
        Pilot's attitude (rad).
    yaw_rate, climb : float
        Pilot's rate of turn (rad/s) and of climb (m/s, positive up).
    set_point : SetPoint or None
        A program flies, for as long as there is one.
    """

    start: bool = False
    first: int | None = None
    take_off: float | None = None
    pause: bool = False
    waypoint: Triple | None = None
    heading: float | None = None
    home: bool = False
    land: bool = False
    stop: str = ""
    rc: bool = False
    roll: float = 0.0
    pitch: float = 0.0
    yaw_rate: float = 0.0
    climb: float = 0.0
    set_point: SetPoint | None = None


NO_SIGNAL = Command()
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
    rc : bool
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
    rc: bool = False
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
    low_V : float
        Voltage below which it lands (V).
    """

    mission: Mission
    ring: Ring
    low_V: float

    @property
    def limits(self) -> Limits:
        """The mission's limits on trajectories."""
        return self.mission.trajectory_limits

    @property
    def avoid(self) -> bool:
        """Whether it avoids obstacles."""
        return self.mission.avoidance.enabled

    @property
    def scan(self) -> bool:
        """Whether it swings its nose to see them."""
        return self.mission.scans


def prepare(mission: Mission, vehicle: Vehicle) -> MissionPlan:
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
    beams = ring(r.count, float(r.first_angle), float(r.max_range))
    return MissionPlan(mission, beams, float(vehicle.battery.low_voltage) if low is None else low)


_ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class MissionState:
    """All that the state machine remembers from one step to the next.

    Attributes
    ----------
    state : State
        State of Fig. 6.15.
    time_s, entered_s, clock_s : float
        Time of the last step; when the state was entered; time on the present motion, which a gate can hold (s).
    step_s : float
        Length of the last step (s).
    motors : str
        What the motors are to do.
    index : int
        The waypoint that is flown to or comes next (from 0).
    outcome, reason : str
        "" while it is open, then "succeeded" or "failed", and why.
    finished : bool
        Back on the floor with the motors off, after a mission.
    manual : bool
        The user's signals have interrupted the mission; ``start`` goes on with it.
    started : bool
        It has taken off, so that ``standing`` is where it comes home to.
    begun : bool
        The waypoints of the mission have been asked for.
    reached : int
        How many of its waypoints were reached since take-off.
    quit : str
        Why the user broke the mission off; counts once it is down.
    homing : bool
        The leg leads home, where it lands.
    events : tuple of Event
        Log, the latest `LOG_KEPT` entries.
    logged : int
        How many entries there have been.
    standing, hold, goal : (3,) tuples
        Where it stood before take-off; where it stays when it has no motion; where the state wants to be (m).
    heading : float
        Heading to keep when there is no motion (rad).
    motion : Trajectory, Stop or None
        What it follows.
    ready_s : float
        When a hover has lasted long enough (s).
    sink, sink_rate : float
        Rate of descent of a landing's reference and its change (m/s, m/s2).
    still_s : float
        For how long it has lain still on the floor (s).
    battery_V, low_s : float
        Filtered voltage; for how long it has been low (s).
    memory : Memory
        Points that the beams have hit.
    detour : Detour or None
        Way around an obstacle, or the last one on this leg.
    back : State
        Where to go once it is avoided.
    avoided_s : float
        Time spent on detours on this leg (s).
    resumed : bool
        The leg goes on after a detour.
    swing : float
        For how long the nose has been swinging (s, at most 3; it counts down from 1 to stop).
    asked_heading : float or None
        Heading that the user's waypoint asks for (rad).
    tracker : Point or None
        Reference that follows set-points.
    """

    state: State = State.INIT
    time_s: float = 0.0
    entered_s: float = 0.0
    clock_s: float = 0.0
    step_s: float = 0.0
    motors: Motors = "off"
    index: int = 0
    outcome: Literal["", "succeeded", "failed"] = ""
    reason: str = ""
    finished: bool = False
    manual: bool = False
    started: bool = False
    begun: bool = False
    reached: int = 0
    quit: str = ""
    homing: bool = False
    events: tuple[Event, ...] = ()
    logged: int = 0
    standing: Triple = _ORIGIN
    hold: Triple = _ORIGIN
    goal: Triple = _ORIGIN
    heading: float = 0.0
    motion: Trajectory | Stop | None = None
    ready_s: float = 0.0
    sink: float = 0.0
    sink_rate: float = 0.0
    still_s: float = 0.0
    battery_V: float = math.inf
    low_s: float = 0.0
    memory: Memory = field(default_factory=Memory.empty)
    detour: Detour | None = None
    back: State = State.HOVER
    avoided_s: float = 0.0
    resumed: bool = False
    swing: float = 0.0
    asked_heading: float | None = None
    tracker: Point | None = None


def begin(plan: MissionPlan, estimate: Estimate) -> MissionState:
    """State before the start signal: on the floor, motors off.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare`.
    estimate : Estimate
        Where it stands.
    """
    n, e, d = estimate.position.tolist()
    return MissionState(
        time_s=estimate.time_s,
        entered_s=estimate.time_s,
        hold=(n, e, d),
        standing=(n, e, d),
        heading=float(estimate.attitude[2]),
        battery_V=float(estimate.battery_voltage),
        events=(Event(estimate.time_s, str(State.INIT), f"ready for {plan.mission.name}"),),
        logged=1,
    )


LOG_KEPT = 256
"""Entries of the log that are kept; it stays that short in a flight of hours."""


def log(s: MissionState, text: str, state: State | None = None, level: str = "info") -> MissionState:
    """The state with one more entry in its log."""
    entry = Event(s.time_s, str(state or s.state), text, level)
    return replace(s, events=(*s.events[1 - LOG_KEPT :], entry), logged=s.logged + 1)


def enter(s: MissionState, state: State, why: str, *, level: str = "info", **changes: object) -> MissionState:
    """Change state, with the reason, and start the clock of its motion, which it has not unless one is given."""
    fresh = {"state": state, "entered_s": s.time_s, "clock_s": 0.0, "motion": None, "tracker": None}
    return replace(log(s, why, state, level), **(fresh | changes))  # type: ignore[arg-type]


def rest(
    s: MissionState, why: str, at: Triple, heading: float, *, level: str = "info", **changes: object
) -> MissionState:
    """Enter a hover at a place (N, E, D; m), with a heading (rad)."""
    return enter(s, State.HOVER, why, level=level, hold=at, goal=at, heading=heading, **changes)


def fail(s: MissionState, why: str) -> MissionState:
    """The mission has failed; the first reason stays."""
    return s if s.outcome == "failed" else replace(s, outcome="failed", reason=why)
