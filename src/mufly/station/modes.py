"""Flight modes in words, for the autopilots that people have."""

from __future__ import annotations

__all__ = ["mode_words"]

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
