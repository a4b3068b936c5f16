"""Commands of a ground station, per autopilot firmware.

MAVLink has one command for most actions, but autopilots differ in its use. A mufly vehicle takes metres in LOCAL_NED
and needs no modes. PX4 and ArduPilot fly by modes (DO_SET_MODE); ArduPilot takes positions in its mode "guided".
ArduPilot's copters, planes, rovers, submarines and airships number their modes differently. Commands: https://mavlink.io/en/messages/common.html#mav_commands.
"""

from __future__ import annotations

import math
from typing import Literal

from mufly.link.codec import GlobalOrigin, mavlink
from mufly.link.command_protocol import FORCE_DISARM_MAGIC, Command
from mufly.vehicle_types import MAV_AUTOPILOT_ARDUPILOT, MAV_AUTOPILOT_PX4, ModeFamily, ardupilot_mode_number

NAN = math.nan

FirmwareKind = Literal["mufly", "PX4", "ArduPilot", "other"]


def identify_firmware(autopilot: int, ours: bool) -> FirmwareKind:
    """Return the firmware kind, which selects the commands of a vehicle.

    Parameters
    ----------
    autopilot : int
        MAV_AUTOPILOT.
    ours : bool
        Whether the vehicle identifies itself as a mufly vehicle.
    """
    if ours:
        return "mufly"
    return "PX4" if autopilot == MAV_AUTOPILOT_PX4 else "ArduPilot" if autopilot == MAV_AUTOPILOT_ARDUPILOT else "other"


def _make_command(number: int, *params: float) -> Command:
    return Command(number, (*params, *(0.0,) * (7 - len(params))))


def _make_set_mode_command(main: int, sub: int = 0) -> Command:
    return _make_command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, main, sub)


ARM_COMMAND, DISARM_COMMAND = (
    _make_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0),
    _make_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM),
)  # COMPONENT_ARM_DISARM; disarming is refused in flight
EMERGENCY_STOP_COMMAND = _make_command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, FORCE_DISARM_MAGIC)
"""Forced disarming: the motors stop at once."""
REBOOT_COMMAND = _make_command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
"""PREFLIGHT_REBOOT_SHUTDOWN of the autopilot; a simulation restarts."""

CommandTable = dict[str, tuple[Command, ...]]


def _make_ardupilot_mode_rows(modes: dict[ModeFamily, str], *before: Command) -> CommandTable:
    """Return rows for ArduPilot: for each family the commands ``before``, then the change to its mode in ``modes``."""
    return {
        f"ArduPilot {family}": (*before, _make_set_mode_command(ardupilot_mode_number(family, words)))
        for family, words in modes.items()
    }


_HOVER_MODES: dict[ModeFamily, str] = {
    "copter": "brake", "plane": "loiter", "rover": "hold", "submarine": "position hold", "airship": "loiter",
}  # fmt: skip
_AUTO_MODES: dict[ModeFamily, str] = {"copter": "auto", "plane": "auto", "rover": "auto", "submarine": "auto"}
_MANUAL_MODES: dict[ModeFamily, str] = {
    "copter": "loiter", "plane": "fly by wire A", "rover": "manual", "submarine": "position hold",
    "airship": "velocity",
}  # fmt: skip
_RETURN_MODES: dict[ModeFamily, str] = {
    "copter": "return", "plane": "return", "rover": "return", "airship": "return",
}  # fmt: skip
PRE_ARM_COMMANDS: CommandTable = {**_make_ardupilot_mode_rows({"copter": "guided"}), "": ()}
"""Commands before arming for a take-off: ArduPilot's copters must be in their mode "guided"."""
START_MISSION_COMMANDS: CommandTable = {
    "PX4": (_make_set_mode_command(4, 4),),
    **_make_ardupilot_mode_rows(_AUTO_MODES, _make_command(mavlink.MAV_CMD_MISSION_START)),
    "": (_make_command(mavlink.MAV_CMD_MISSION_START),),
}
"""Make an armed vehicle start or resume its mission."""
PAUSE_COMMANDS: CommandTable = {
    "PX4": (_make_set_mode_command(4, 3),),
    **_make_ardupilot_mode_rows(_HOVER_MODES),
    "": (_make_command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE),),
}
"""Stop and hover; a plane circles."""
MANUAL_CONTROL_COMMANDS: CommandTable = {
    "PX4": (_make_set_mode_command(3),),
    **_make_ardupilot_mode_rows(_MANUAL_MODES),
    "": (_make_set_mode_command(2),),
}
"""Fly by sticks: the mode in which the vehicle stops or flies level with centred sticks."""
RELEASE_STICKS_COMMANDS: CommandTable = {**_make_ardupilot_mode_rows(_HOVER_MODES), "": (_make_set_mode_command(4, 3),)}
"""End flight by sticks and hover in place; a mode is set because it is accepted on the ground too."""
RETURN_COMMANDS: CommandTable = {
    **_make_ardupilot_mode_rows(_RETURN_MODES),
    "": (_make_command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),),
}
"""Return to the take-off position and land."""
LAND_COMMANDS: CommandTable = {
    **_make_ardupilot_mode_rows({"copter": "landing", "airship": "landing"}),
    "": (Command(mavlink.MAV_CMD_NAV_LAND, (0.0, 0.0, 0.0, NAN, NAN, NAN, NAN)),),
}
"""Land at the present position."""


def select_action_commands(
    table: CommandTable, firmware: FirmwareKind, family: ModeFamily = "copter"
) -> tuple[Command, ...] | str:
    """Return the commands that make a vehicle do one action, or a text if its firmware has no mode for the action.

    Parameters
    ----------
    table : dict
        One of this module's command tables.
    firmware : str
    family : str
        Family of an ArduPilot vehicle (:func:`mufly.vehicle_types.ardupilot_family`).
    """
    if firmware == "ArduPilot":
        what = f"ArduPilot's {family}" if family else "an ArduPilot vehicle of this type"
        return table.get(f"ArduPilot {family}", f"{what} has no flight mode for this; use its own transmitter")
    return table.get(firmware, table[""])


def make_take_off_command(firmware: FirmwareKind, height_m: float) -> Command:
    """Return the take-off command to a height above the ground position (m); PX4 takes the height from a parameter."""
    if firmware == "mufly":
        return Command(mavlink.MAV_CMD_NAV_TAKEOFF, (NAN,) * 6 + (-height_m,), frame=mavlink.MAV_FRAME_LOCAL_NED)
    return (
        Command(mavlink.MAV_CMD_NAV_TAKEOFF)
        if firmware == "PX4"
        else _make_command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, NAN, 0.0, 0.0, height_m)
    )


def make_go_to_command(
    firmware: FirmwareKind,
    position_m: tuple[float, float, float],
    heading_rad: float,
    origin: GlobalOrigin | None,
) -> Command | str:
    """Return the command to fly to a position and hold it; a text if this vehicle has no such command.

    Parameters
    ----------
    firmware : str
    position_m : (3,) tuple
        N, E, D (m).
    heading_rad : float
        NaN: chosen by the vehicle.
    origin : GlobalOrigin or None
        Global position of N, E, D = 0, if the vehicle has reported it.
    """
    if firmware == "mufly":
        return Command(
            mavlink.MAV_CMD_DO_REPOSITION, (-1.0, 0.0, 0.0, heading_rad, *position_m), frame=mavlink.MAV_FRAME_LOCAL_NED
        )
    if origin is None:
        return "this autopilot accepts global positions only and has not reported its origin"
    # Flag 1: the vehicle changes to the mode that it needs.
    return Command(
        mavlink.MAV_CMD_DO_REPOSITION,
        (-1.0, 1.0, 0.0, heading_rad, *origin.to_global(*position_m)),
        frame=mavlink.MAV_FRAME_GLOBAL,
    )


def make_request_message_command(number: int) -> Command:
    """Return the command REQUEST_MESSAGE, which requests a message by its number once."""
    return _make_command(mavlink.MAV_CMD_REQUEST_MESSAGE, number)


def make_inject_failure_command(unit: int, kind: int, amount: float = NAN, duration_s: float = NAN) -> Command:
    """Return INJECT_FAILURE for a FAILURE_UNIT and FAILURE_TYPE of :data:`mufly.link.command_protocol.FAILURE_NAMES`.

    Type 0 clears all failures. Parameters 5 and 6, which the specification leaves open, are the amount and the duration
    (s); NaN: the usual amount, no end.
    """
    return _make_command(mavlink.MAV_CMD_INJECT_FAILURE, float(unit), float(kind), 0.0, 0.0, amount, duration_s)


def make_message_interval_command(number: int, rate_Hz: float) -> Command:
    """Return SET_MESSAGE_INTERVAL; a rate of 0 Hz disables the message."""
    return _make_command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_Hz if rate_Hz > 0 else -1.0)
