"""Classification of MAVLink senders, and names of vehicle types and flight modes.

Senders on a link are vehicles, their equipment (companion computers, cameras, gimbals, radios, ...), antenna trackers
and ground stations. A HEARTBEAT identifies its sender by ``type`` (MAV_TYPE), ``autopilot`` (MAV_AUTOPILOT) and the
component number of the packet (MAV_COMPONENT); an autopilot is component 1 by convention. Many companions and gimbals
set their autopilot to GENERIC instead of INVALID, so the autopilot alone is not conclusive. Sources: mavlink.io,
"Heartbeat/Connection Protocol" and the enumerations of common.xml; flight modes: ArduPilot's ``mode.h`` of each vehicle
and PX4's ``px4_custom_mode.h``.
"""

from __future__ import annotations

from typing import Literal

AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
MAV_AUTOPILOT_PX4, MAV_AUTOPILOT_ARDUPILOT = 12, 3
_MAV_AUTOPILOT_INVALID = 8  # MAV_AUTOPILOT_INVALID
_MAV_TYPE_ANTENNA_TRACKER, _MAV_TYPE_GENERIC = 5, 0

VEHICLE_TYPE_NAMES: dict[int, str] = {
    1: "aeroplane", 2: "quadrotor", 3: "coaxial helicopter", 4: "helicopter", 7: "airship", 8: "balloon", 9: "rocket",
    10: "rover", 11: "boat", 12: "submarine", 13: "hexarotor", 14: "octorotor", 15: "tricopter", 16: "ornithopter",
    17: "kite", 19: "VTOL", 20: "VTOL", 21: "VTOL", 22: "VTOL", 23: "VTOL", 24: "VTOL", 25: "VTOL", 28: "parafoil",
    29: "dodecarotor", 35: "decarotor", 43: "multirotor", 45: "spacecraft", 46: "quadruped", 47: "gyrodyne",
}  # fmt: skip
"""Names of the MAV_TYPEs of vehicles."""
EQUIPMENT_TYPE_NAMES: dict[int, str] = {
    5: "antenna tracker", 6: "ground station", 18: "companion computer", 26: "gimbal", 27: "ADSB receiver",
    30: "camera", 31: "charging station", 32: "FLARM receiver", 33: "servo", 34: "Open Drone ID", 36: "battery",
    37: "parachute", 38: "logger", 39: "OSD", 40: "IMU", 41: "GPS receiver", 42: "winch", 44: "illuminator",
    48: "gripper",
}  # fmt: skip
"""Names of the MAV_TYPEs of equipment."""
# MAV_COMPONENT numbers of cameras, servos, gimbals, peripherals, batteries, computers, sensors, bridges.
_EQUIPMENT_COMPONENT_IDS = (*range(100, 106), *range(140, 200), *range(200, 251))


def vehicle_rank(vehicle_type: int, autopilot: int, component: int) -> int:
    """Return the vehicle rank of the sender of a HEARTBEAT; the sender with the highest rank is the vehicle.

    Parameters
    ----------
    vehicle_type, autopilot, component : int
        MAV_TYPE, MAV_AUTOPILOT, and the component number of the packet.

    Returns
    -------
    int
        3: autopilot of a vehicle (component 1). 2: another component with a vehicle type. 1: antenna tracker, which has
        an autopilot but is no vehicle. 0: equipment or ground station.

    Examples
    --------
    >>> vehicle_rank(2, 12, 1), vehicle_rank(18, 0, 191), vehicle_rank(5, 3, 1)
    (3, 0, 1)
    """
    if vehicle_type == _MAV_TYPE_ANTENNA_TRACKER:
        return 0 if autopilot == _MAV_AUTOPILOT_INVALID else 1
    if vehicle_type in EQUIPMENT_TYPE_NAMES or autopilot == _MAV_AUTOPILOT_INVALID:
        return 0
    if component == AUTOPILOT_COMPONENT:
        return 3
    if vehicle_type not in VEHICLE_TYPE_NAMES and component in _EQUIPMENT_COMPONENT_IDS:
        return 0
    return 2


def is_vehicle(vehicle_type: int, autopilot: int, component: int) -> bool:
    """Return True if the sender of a HEARTBEAT is shown and commanded as a vehicle (see :func:`vehicle_rank`)."""
    return vehicle_rank(vehicle_type, autopilot, component) >= 2


def vehicle_type_name(vehicle_type: int) -> str:
    """Return the name of a MAV_TYPE; "" for the generic and unknown types."""
    return VEHICLE_TYPE_NAMES.get(vehicle_type) or EQUIPMENT_TYPE_NAMES.get(vehicle_type, "")


_SHAPE_BY_TYPE: dict[int, str] = {
    3: "coaxial", 4: "helicopter", 47: "helicopter", 10: "rover", 11: "boat", 12: "submarine", 15: "tricopter",
    2: "quadrotor", 43: "quadrotor", 20: "quadrotor", 13: "hexarotor", 14: "octorotor", 29: "dodecarotor",
    35: "octorotor", **dict.fromkeys((1, 16, 17, 19, 21, 22, 23, 24, 25, 28), "plane"),
}  # fmt: skip


def vehicle_shape(vehicle_type: int) -> str:
    """Return the drawing of a MAV_TYPE: "coaxial", "plane", "quadrotor", "rover", ...; "block" if unknown."""
    return _SHAPE_BY_TYPE.get(vehicle_type, "block")


ModeFamily = Literal["copter", "plane", "rover", "submarine", "tracker", "airship", ""]
"""ArduPilot firmwares, each with its own flight modes."""
_FAMILY_OF_TYPE: dict[int, ModeFamily] = {
    **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35, 43), "copter"),
    **dict.fromkeys((1, 16, 19, 20, 21, 22, 23, 24, 25, 28), "plane"),
    **dict.fromkeys((10, 11), "rover"),
    12: "submarine",
    _MAV_TYPE_ANTENNA_TRACKER: "tracker",
    7: "airship",
}


def _index_words(words: str) -> dict[int, str]:
    """Return the words of a comma-separated list by their position, from 0; "-" marks a position without a word."""
    return {k: word for k, word in enumerate(words.split(", ")) if word != "-"}


_PX4_MAIN_MODES = _index_words(
    "-, manual, altitude control, position control, -, acro, offboard, stabilised, rattitude, simple, termination"
)
_PX4_AUTO_MODES = _index_words(
    "-, ready, take-off, hold, mission, return, landing, -, follow me, precision landing, transition"
)
_ARDUPILOT_MODES: dict[ModeFamily, dict[int, str]] = {
    "copter": _index_words(
        "stabilise, acro, altitude hold, auto, guided, loiter, return, circle, -, landing, -, drift, -, sport, flip, "
        "autotune, position hold, brake, throw, avoid aircraft, guided without GPS, smart return, flow hold, follow, "
        "zigzag, system identification, autorotation, auto return, turtle"
    ),
    "plane": _index_words(
        "manual, circle, stabilise, training, acro, fly by wire A, fly by wire B, cruise, autotune, -, auto, return, "
        "loiter, take-off, avoid aircraft, guided, initialising, Q stabilise, Q hover, Q loiter, Q landing, Q return, "
        "Q autotune, Q acro, thermal, loiter to Q landing, auto landing"
    ),
    "rover": _index_words(
        "manual, acro, -, steering, hold, loiter, follow, simple, dock, circle, auto, return, smart return, -, -, "
        "guided, initialising"
    ),
    "submarine": _index_words(
        "stabilise, acro, altitude hold, auto, guided, -, -, circle, -, surface, -, -, -, -, -, -, position hold, -, "
        "-, manual, motor detection, surface tracking"
    ),
    "tracker": _index_words("manual, stop, scan, servo test, guided, -, -, -, -, -, auto, -, -, -, -, -, initialising"),
    "airship": _index_words("landing, manual, velocity, loiter, return"),
}
_CUSTOM_MODE_ENABLED = 1  # MAV_MODE_FLAG


def ardupilot_mode_name(family: ModeFamily, number: int) -> str:
    """Return the name of ArduPilot's flight mode, ``"mode 8"`` for a number that the firmware does not have.

    Examples
    --------
    >>> [ardupilot_mode_name(family, 5) for family in ("copter", "plane", "")]
    ['loiter', 'fly by wire A', 'mode 5']
    """
    return _ARDUPILOT_MODES.get(family, {}).get(number, f"mode {number}")


def ardupilot_mode_number(family: ModeFamily, words: str) -> int:
    """Return the number of ArduPilot's flight mode; KeyError if the firmware has no such mode."""
    return {word: number for number, word in _ARDUPILOT_MODES[family].items()}[words]


def ardupilot_family(vehicle_type: int) -> ModeFamily:
    """Return the ArduPilot firmware of a MAV_TYPE; "" if unknown."""
    return _FAMILY_OF_TYPE.get(vehicle_type, "")


def flight_mode_name(autopilot: int, vehicle_type: int, base_mode: int, custom_mode: int) -> str:
    """Return the name of the flight mode of a HEARTBEAT; "" if the autopilot has none.

    Parameters
    ----------
    autopilot, vehicle_type : int
        MAV_AUTOPILOT, MAV_TYPE.
    base_mode, custom_mode : int
    """
    if not base_mode & _CUSTOM_MODE_ENABLED:
        return ""
    if autopilot == MAV_AUTOPILOT_PX4:
        main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        if main == 4:
            return _PX4_AUTO_MODES.get(sub, f"auto {sub}")
        return _PX4_MAIN_MODES.get(main, f"mode {main}") if main else ""
    family = ardupilot_family(vehicle_type) if autopilot == MAV_AUTOPILOT_ARDUPILOT else ""
    return ardupilot_mode_name(family, custom_mode)
