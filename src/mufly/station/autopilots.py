"""Flight modes in words, for the autopilots that people have."""

from __future__ import annotations

import math
from typing import Literal

from mufly.link.conventions import Origin
from mufly.station.commands import Order

PX4, ARDUPILOT = 12, 3  # MAV_AUTOPILOT
_CUSTOM_MODE_ENABLED = 1  # MAV_MODE_FLAG

# PX4, src/modules/commander/px4_custom_mode.h
_PX4_MAIN = {
    1: "manual",
    2: "altitude control",
    3: "position control",
    5: "acro",
    6: "offboard",
    7: "stabilised",
    8: "rattitude",
    9: "simple",
    10: "termination",
}
_PX4_AUTO = {
    1: "ready",
    2: "take-off",
    3: "hold",
    4: "mission",
    5: "return",
    6: "landing",
    8: "follow me",
    9: "precision landing",
    10: "transition",
}
# ArduPilot, ArduCopter/mode.h: multicopters and helicopters
_COPTER = {
    0: "stabilise",
    1: "acro",
    2: "altitude hold",
    3: "auto",
    4: "guided",
    5: "loiter",
    6: "return",
    7: "circle",
    9: "landing",
    11: "drift",
    13: "sport",
    14: "flip",
    15: "autotune",
    16: "position hold",
    17: "brake",
    18: "throw",
    19: "avoid aircraft",
    20: "guided without GPS",
    21: "smart return",
    22: "flow hold",
    23: "follow",
    24: "zigzag",
    25: "system identification",
    26: "autorotation",
    27: "auto return",
    28: "turtle",
}
_ROTORCRAFT = (2, 3, 4, 13, 14, 15, 29, 35, 43)  # MAV_TYPE


def mode_words(autopilot: int, vehicle_type: int, base_mode: int, custom_mode: int) -> str:
    """Return the flight mode of a HEARTBEAT in words; "" where the autopilot has none that we know.

    Parameters
    ----------
    autopilot, vehicle_type : int
        MAV_AUTOPILOT, MAV_TYPE.
    base_mode, custom_mode : int
    """
    if not base_mode & _CUSTOM_MODE_ENABLED:
        return ""
    if autopilot == PX4:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        if main == 4:
            return _PX4_AUTO.get(sub, f"auto {sub}")
        return _PX4_MAIN.get(main, f"mode {main}") if main else ""
    if autopilot == ARDUPILOT and vehicle_type in _ROTORCRAFT:
        return _COPTER.get(custom_mode, f"mode {custom_mode}")
    return f"mode {custom_mode}"


# ----------------------------------------------------------------------------
# What is asked of a vehicle, in the words of its autopilot.
#
# MAVLink has one command for most things, but autopilots differ in how they want to be asked: a mufly vehicle takes
# metres in LOCAL_NED and needs no modes; PX4 and ArduPilot fly by modes (DO_SET_MODE), ArduPilot takes points in its
# mode "guided". Commands: https://mavlink.io/en/messages/common.html#mav_commands; modes: see
# :mod:`mufly.station.autopilots`.


Dialect = Literal["mufly", "PX4", "ArduPilot", "other"]
NAN = math.nan
LOCAL_NED, GLOBAL = 1, 0
FORCE = 21196.0
"""MAVLink's number for disarming in flight."""


def dialect_of(autopilot: int, ours: bool) -> Dialect:
    """Return how a vehicle wants to be asked.

    Parameters
    ----------
    autopilot : int
        MAV_AUTOPILOT.
    ours : bool
        Whether it says of itself that it is a mufly vehicle.
    """
    if ours:
        return "mufly"
    return "PX4" if autopilot == PX4 else "ArduPilot" if autopilot == ARDUPILOT else "other"


def arm() -> Order:
    """COMPONENT_ARM_DISARM."""
    return Order(400, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def disarm() -> Order:
    """COMPONENT_ARM_DISARM; refused in flight."""
    return Order(400, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def emergency_stop() -> Order:
    """COMPONENT_ARM_DISARM by force: the motors stop at once."""
    return Order(400, (0.0, FORCE, 0.0, 0.0, 0.0, 0.0, 0.0), urgent=True)


def take_off(dialect: Dialect, height_m: float) -> list[Order]:
    """What makes an armed vehicle take off to a height above where it stands; PX4 takes the height from a parameter."""
    if dialect == "mufly":
        return [Order(22, (NAN, NAN, NAN, NAN, NAN, NAN, -height_m), frame=LOCAL_NED)]
    if dialect == "PX4":
        return [Order(22, (NAN,) * 7)]
    return [Order(22, (0.0, 0.0, 0.0, NAN, 0.0, 0.0, height_m))]


def before_arming(dialect: Dialect) -> list[Order]:
    """What has to come before arming for a take-off: ArduPilot must be in its mode "guided"."""
    return [_mode(4)] if dialect == "ArduPilot" else []


def mission_start(dialect: Dialect) -> list[Order]:
    """What makes an armed vehicle fly its mission, or go on with it."""
    if dialect == "PX4":
        return [_mode(4, 4)]
    if dialect == "ArduPilot":
        return [Order(300, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)), _mode(3)]
    return [Order(300, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))]


def pause(dialect: Dialect) -> Order:
    """Stop and hover."""
    if dialect == "PX4":
        return _mode(4, 3)
    return _mode(17) if dialect == "ArduPilot" else Order(193, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def go_to(
    dialect: Dialect,
    position_m: tuple[float, float, float],
    heading_rad: float,
    origin: Origin | None,
) -> Order | str:
    """Fly to N, E, D and hold; text if that cannot be asked of this vehicle.

    Parameters
    ----------
    dialect : str
    position_m : (3,) tuple
    heading_rad : float
        NaN: as the vehicle likes.
    origin : Origin or None
        Where N, E, D are 0, as far as the vehicle has told.
    """
    if dialect == "mufly":
        return Order(192, (-1.0, 0.0, 0.0, heading_rad, *position_m), frame=LOCAL_NED)
    if origin is None:
        return "this autopilot flies to places on the globe only, and has told no origin"
    # Flag 1: change to the mode that it takes.
    return Order(192, (-1.0, 1.0, 0.0, heading_rad, *origin.to_global(*position_m)), frame=GLOBAL)


def home(dialect: Dialect) -> Order:
    """Return to where it took off and land."""
    return _mode(6) if dialect == "ArduPilot" else Order(20, (0.0,) * 7)


def land(dialect: Dialect) -> Order:
    """Land here."""
    return _mode(9) if dialect == "ArduPilot" else Order(21, (0.0, 0.0, 0.0, NAN, NAN, NAN, NAN))


def reboot() -> Order:
    """PREFLIGHT_REBOOT_SHUTDOWN of the autopilot; a simulation begins anew."""
    return Order(246, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def request_message(number: int) -> Order:
    """REQUEST_MESSAGE."""
    return Order(512, (float(number), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def interval(number: int, rate_Hz: float) -> Order:
    """SET_MESSAGE_INTERVAL; a rate of 0 is never."""
    return Order(511, (float(number), 1e6 / rate_Hz if rate_Hz > 0 else -1.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def _mode(main: int, sub: int = 0) -> Order:
    return Order(176, (1.0, float(main), float(sub), 0.0, 0.0, 0.0, 0.0))
