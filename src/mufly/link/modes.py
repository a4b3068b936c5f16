"""States of the mission as flight modes of PX4, whose words MAVLink programs know, and back.

MAVLink leaves ``custom_mode`` to each autopilot. PX4 puts a main mode in its third byte and a sub mode in its fourth
(PX4-Autopilot, ``src/modules/commander/px4_custom_mode.h``).

============= ==================== =============================================================================
mission state PX4's mode           asked for, it means
============= ==================== =============================================================================
init          AUTO READY (4, 1)    (not a thing to ask for)
take-off      AUTO TAKEOFF (4, 2)  take off
hover         AUTO LOITER (4, 3)   stop and hover
waypoint      AUTO MISSION (4, 4)  fly the mission, or go on with it; AUTO LOITER while a single point is flown to
obstacle      the one it returns to
landing       AUTO LAND (4, 6)     land
(return)      AUTO RTL (4, 5)      above where it took off, then land
rc            ALTCTL (2, 0)        fly by sticks; MANUAL, POSCTL and STABILIZED mean the same here
offboard      OFFBOARD (6, 0)      follow the stream of set-points
============= ==================== =============================================================================
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from mufly.mission import State

__all__ = [
    "LOITER",
    "MISSION",
    "TAKE_OFF",
    "Ask",
    "Mode",
    "asked",
    "custom_mode",
    "mode_of",
    "mode_of_custom",
]

Ask = Literal["take-off", "hover", "mission", "return", "land", "rc", "offboard", ""]


class Mode(NamedTuple):
    """Main and sub mode."""

    main: int
    sub: int


READY, TAKE_OFF, LOITER, MISSION, RETURN, LAND = (Mode(4, sub) for sub in range(1, 7))
ALTITUDE, OFFBOARD = Mode(2, 0), Mode(6, 0)

_ASKED: dict[Mode, Ask] = {
    TAKE_OFF: "take-off",
    LOITER: "hover",
    MISSION: "mission",
    RETURN: "return",
    LAND: "land",
    OFFBOARD: "offboard",
}
_BY_HAND = (1, 2, 3, 7)
_OF_STATE: dict[str, Mode] = {
    State.INIT: READY,
    State.TAKE_OFF: TAKE_OFF,
    State.HOVER: LOITER,
    State.WAYPOINT: MISSION,
    State.OBSTACLE: MISSION,
    State.LANDING: LAND,
    State.RC: ALTITUDE,
    State.OFFBOARD: OFFBOARD,
}


def mode_of(state: str, manual: bool = False, returning: bool = False) -> Mode:
    """Return the mode that shows a state of the mission.

    Parameters
    ----------
    state : str
        A text of :class:`mufly.mission.State`.
    manual : bool
        Whether it flies on a user's signal instead of the mission.
    returning : bool
        Whether it is on its way home.
    """
    if returning and state in (State.WAYPOINT, State.OBSTACLE):
        return RETURN
    if manual and state in (State.WAYPOINT, State.OBSTACLE):
        return LOITER
    return _OF_STATE[state]


def custom_mode(mode: Mode) -> int:
    """Return the number that a heartbeat carries."""
    return mode.main << 16 | mode.sub << 24


def mode_of_custom(number: int) -> Mode:
    """Inverse of :func:`custom_mode`."""
    return Mode(number >> 16 & 0xFF, number >> 24 & 0xFF)


def asked(mode: Mode) -> Ask:
    """Return what to do when a mode is asked for; "" if there is no such thing here."""
    if mode.main in _BY_HAND:
        return "rc"
    return _ASKED.get(Mode(6, 0) if mode.main == 6 else mode, "")
