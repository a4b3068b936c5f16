"""What the mission state machine knows and remembers: the mission with the vehicle's numbers, and its own state."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from mufly.errors import InputError
from mufly.mission.avoidance import Detour
from mufly.mission.obstacles import Memory, Ring, ring
from mufly.mission.offboard import Tracker
from mufly.mission.schema import Mission
from mufly.mission.signals import Event, Motors, State, Triple
from mufly.mission.trajectory import Limits, Stop, Trajectory
from mufly.sensors import Measurement
from mufly.vehicle import Vehicle

__all__ = ["LOG_KEPT", "MissionPlan", "MissionState", "begin", "enter", "fail", "log", "prepare"]


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """A mission with what its state machine has to know of the vehicle, all in SI units.

    Attributes
    ----------
    mission : Mission
        The mission.
    limits : Limits
        Its limits on trajectories.
    ring : Ring
        The vehicle's range beams.
    low_V : float
        Voltage below which it lands (V).
    avoid, scan : bool
        Whether it avoids obstacles, and swings its nose to see them.
    """

    mission: Mission
    limits: Limits
    ring: Ring
    low_V: float
    avoid: bool
    scan: bool


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
    return MissionPlan(
        mission,
        mission.trajectory_limits,
        ring(r.count, float(r.first_angle), float(r.max_range)),
        float(vehicle.battery.low_voltage) if low is None else low,
        mission.avoidance.enabled,
        mission.scans,
    )


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
    tracker : Tracker or None
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
    tracker: Tracker | None = None


def begin(plan: MissionPlan, measured: Measurement) -> MissionState:
    """State before the start signal: on the floor, motors off.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare`.
    measured : Measurement
        Where it stands.
    """
    n, e, d = measured.position.tolist()
    return MissionState(
        time_s=measured.time_s,
        entered_s=measured.time_s,
        hold=(n, e, d),
        standing=(n, e, d),
        heading=float(measured.attitude[2]),
        battery_V=float(measured.battery_voltage),
        events=(Event(measured.time_s, State.INIT, f"ready for {plan.mission.name}"),),
        logged=1,
    )


LOG_KEPT = 256
"""Entries of the log that are kept; it stays that short in a flight of hours."""


def log(s: MissionState, text: str, state: State | None = None, level: str = "info") -> MissionState:
    """The state with one more entry in its log."""
    entry = Event(s.time_s, state or s.state, text, level)
    return replace(s, events=(*s.events[1 - LOG_KEPT :], entry), logged=s.logged + 1)


def enter(s: MissionState, state: State, why: str, *, level: str = "info", **changes: object) -> MissionState:
    """Change state, with the reason, and start the clock of its motion."""
    return replace(
        log(s, why, state, level),
        state=state,
        entered_s=s.time_s,
        clock_s=0.0,
        **changes,  # type: ignore[arg-type]
    )


def fail(s: MissionState, why: str) -> MissionState:
    """The mission has failed; the first reason stays."""
    return s if s.outcome == "failed" else replace(s, outcome="failed", reason=why)
