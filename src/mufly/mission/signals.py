"""What goes in and out of the mission state machine: its states, the user's signals, the reference, the log."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.mission.offboard import SetPoint

__all__ = ["NO_SIGNAL", "Command", "Event", "Motors", "Reference", "State", "Triple"]

Motors = Literal["off", "spin_up", "fly", "ramp_down", "blind"]
Triple = tuple[float, float, float]


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
class Event:
    """One entry of the mission's log: when, the state from then on, why, and "info", "warning" or "error"."""

    time_s: float
    state: State
    text: str
    level: str = "info"
