"""What is asked of a vehicle, in the words of its autopilot.

MAVLink has one command for most things, but autopilots differ in how they want to be asked: a mufly vehicle takes
metres in LOCAL_NED and needs no modes; PX4 and ArduPilot fly by modes (DO_SET_MODE), ArduPilot takes points in its
mode "guided". Commands: https://mavlink.io/en/messages/common.html#mav_commands; modes: see
:mod:`mufly.station.modes`.
"""

from __future__ import annotations

import math
from typing import Literal

from mufly.link.geodesy import Origin
from mufly.station.modes import ARDUPILOT, PX4
from mufly.station.requests import Order

__all__ = [
    "Dialect", "arm", "before_arming", "dialect_of", "disarm", "emergency_stop", "go_to", "home", "interval", "land",
    "mission_start", "pause", "reboot", "request_message", "take_off",
]  # fmt: skip

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
