"""What the autopilot answers, and how it is: the words between it and whoever commands it."""

from __future__ import annotations

from dataclasses import dataclass

from mufly.mission import Mission

__all__ = ["ACCEPTED", "Answer", "Status", "later", "never"]


@dataclass(frozen=True, slots=True)
class Answer:
    """Whether something asked for is done; ``bool(answer)`` says so.

    Attributes
    ----------
    accepted : bool
    reason : str
        Why not, with the remedy; or what to know about it.
    temporary : bool
        Refused for now; the same may be accepted later.
    """

    accepted: bool
    reason: str = ""
    temporary: bool = False

    def __bool__(self) -> bool:
        return self.accepted


ACCEPTED = Answer(True)


def never(reason: str) -> Answer:
    """Refused, whenever it is asked."""
    return Answer(False, reason)


def later(reason: str) -> Answer:
    """Refused for now."""
    return Answer(False, reason, temporary=True)


@dataclass(frozen=True, slots=True)
class Status:
    """How the vehicle is.

    Attributes
    ----------
    armed : bool
        Whether its motors may run.
    flying : bool
        Whether it is off the floor.
    landed : bool
        On the floor with the motors off or running down.
    state : str
        State of the mission machine ("take-off", "hover", ...; `mufly.mission.State`).
    motors : str
        "off", "spin_up", "fly", "ramp_down" or "blind" (:mod:`mufly.flight.software`).
    mission_running : bool
        Whether the waypoints of the mission are being flown, and nothing has interrupted that.
    begun : bool
        The mission has been started since take-off.
    manual : bool
        The user has taken over from the mission, which waits.
    homing : bool
        It is on its way home.
    waypoint : int
        The one that is flown to or comes next (from 0); the number of waypoints when all are reached.
    reached : int
        How many were reached since take-off.
    offboard, sticks : bool
        Whether a program's set-points, or the pilot's sticks, are in command.
    outcome, reason : str
        Of the flight: "" while it is open, "succeeded" or "failed", and why.
    mission : Mission
        As loaded, with the limits as tuned.
    home : (3,) tuple or None
        Where it took off (N, E, D; m); None before it has.
    goal : (3,) tuple or None
        Where it is going or holds (N, E, D; m); None on the floor and by hand.
    crashed : str
        What it hit; "" if nothing.
    """

    armed: bool
    flying: bool
    landed: bool
    state: str
    motors: str
    mission_running: bool
    begun: bool
    manual: bool
    homing: bool
    waypoint: int
    reached: int
    offboard: bool
    sticks: bool
    outcome: str
    reason: str
    mission: Mission
    home: tuple[float, float, float] | None
    goal: tuple[float, float, float] | None
    crashed: str
