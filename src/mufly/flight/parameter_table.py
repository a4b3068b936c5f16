"""Every number that may be tuned while the helicopter flies: name, unit, bounds, where it is kept.

Names are those of a MAVLink parameter: at most 16 characters. Values at this edge are in the unit that the table
names (degrees, not radians); inside they stay SI. Three kinds:

- of the mission (``MIS_``, ``LIM_``, ``AVD_``, ``BAT_``): keys of a mission file (docs/missions.md), with its bounds.
  A limit is never above 80 % of what the controllers can follow (:mod:`mufly.mission.pace`), so its greatest value
  moves with the controllers'.
- of the control law (``CTL_``): limits of the reference filters, and the one gain outside of the H-infinity
  controllers. They are gone over to within half a second (:class:`mufly.flight.controllers.Controllers`).
- of the pilot's sticks (``STK_``): what a stick at its end asks for.

Bounds of the control law. The position gain closes a loop: with it between 0.2 and 2 1/s the cascade of both built-in
vehicles keeps its sensitivities below 4.9 dB and a phase margin above 36 degrees (at 2.5 1/s they pass 6 dB);
``tests/flight/test_parameters.py`` asks ``analyse_cascade`` again. The others are limits and filters in front of the
loops, which cannot make them unstable; between their bounds simulated steps still settle (same test).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["DEG", "TABLE", "Parameter", "Row"]

DEG = math.degrees(1.0)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number that may be tuned, as a vehicle offers it and a station shows it.

    Attributes
    ----------
    name : str
        At most 16 characters.
    value : float
        In ``unit``.
    unit : str
        "" for a pure number, or where it is not known.
    least, greatest : float
        Bounds, themselves permitted; infinite where none are known.
    help : str
    whole : bool
        A whole number.
    """

    name: str
    value: float
    unit: str = ""
    least: float = -math.inf
    greatest: float = math.inf
    help: str = ""
    whole: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """Where a parameter is kept: ``table`` and ``key``; what is shown is ``scale`` times what is kept."""

    name: str
    unit: str
    least: float
    greatest: float
    help: str
    table: str
    key: str
    scale: float = 1.0
    whole: bool = False


TABLE: tuple[Row, ...] = (
    Row("MIS_TAKEOFF_ALT", "m", 0.2, 50.0, "height to take off to", "take_off", "height_m"),
    Row("LIM_SPEED", "m/s", 0.05, 3.0, "horizontal speed", "limits", "speed_m_s"),
    Row("LIM_CLIMB", "m/s", 0.05, 2.0, "rate of climb", "limits", "climb_m_s"),
    Row("LIM_DESCENT", "m/s", 0.05, 1.0, "rate of descent", "limits", "descent_m_s"),
    Row(
        "LIM_TOUCHDOWN",
        "m/s",
        0.05,
        0.25,
        "rate of descent over the last 0.4 m before the floor",
        "limits",
        "touchdown_m_s",
    ),
    Row("LIM_ACCEL", "m/s2", 0.05, 2.0, "horizontal acceleration", "limits", "acceleration_m_s2"),
    Row(
        "LIM_CLIMB_ACC",
        "m/s2",
        0.05,
        2.0,
        "acceleration of climb and descent",
        "limits",
        "climb_acceleration_m_s2",
    ),
    Row("LIM_YAWRATE", "deg/s", 1.0, 360.0, "rate of turn", "limits", "yaw_rate_deg_s"),
    Row("LIM_YAWACC", "deg/s2", 5.0, 1000.0, "acceleration of a turn", "limits", "yaw_acceleration_deg_s2"),
    Row("LIM_REACH", "m", 0.01, 1.0, "a waypoint counts as reached from this near", "limits", "reach_m"),
    Row(
        "AVD_ENABLE",
        "",
        0.0,
        1.0,
        "1: look out for obstacles and avoid them",
        "avoidance",
        "enabled",
        whole=True,
    ),
    Row(
        "AVD_CLEARANCE",
        "m",
        0.15,
        1.0,
        "distance to keep from obstacles, from the centre",
        "avoidance",
        "clearance_m",
    ),
    Row("AVD_SPEED", "m/s", 0.06, 1.0, "speed around an obstacle", "avoidance", "speed_m_s"),
    Row("BAT_LOW_V", "V", 0.0, math.inf, "land below this voltage", "battery", "low_V"),
    Row("CTL_POS_GAIN", "1/s", 0.2, 2.0, "velocity asked for a metre off place", "position", "position_gain"),
    Row(
        "CTL_SPEED_MAX",
        "m/s",
        0.3,
        3.0,
        "greatest velocity that the position loop asks for",
        "position",
        "speed_limit",
    ),
    Row(
        "CTL_TILT_MAX",
        "deg",
        3.0,
        15.0,
        "greatest tilt that the position loop asks for",
        "position",
        "tilt_limit",
        DEG,
    ),
    Row(
        "CTL_HEAVE_BW",
        "rad/s",
        2.0,
        16.0,
        "bandwidth of the reference filter of height",
        "heave_yaw",
        "heave_bandwidth",
    ),
    Row(
        "CTL_HEAVE_SPD",
        "m/s",
        0.2,
        2.0,
        "greatest speed of the reference of height",
        "heave_yaw",
        "heave_speed",
    ),
    Row(
        "CTL_HEAVE_ACC",
        "m/s2",
        0.1,
        1.5,
        "greatest acceleration of the reference of height",
        "heave_yaw",
        "heave_acceleration",
    ),
    Row(
        "CTL_YAW_BW",
        "rad/s",
        2.0,
        16.0,
        "bandwidth of the reference filter of heading",
        "heave_yaw",
        "yaw_bandwidth",
    ),
    Row(
        "CTL_YAW_RATE",
        "deg/s",
        10.0,
        200.0,
        "greatest rate of the reference of heading",
        "heave_yaw",
        "yaw_rate",
        DEG,
    ),
    Row(
        "CTL_YAW_ACC",
        "deg/s2",
        30.0,
        600.0,
        "greatest acceleration of the reference of heading",
        "heave_yaw",
        "yaw_acceleration",
        DEG,
    ),
    Row("STK_TILT", "deg", 1.0, 15.0, "tilt at the end of a stick", "sticks", "tilt", DEG),
    Row("STK_YAWRATE", "deg/s", 5.0, 110.0, "rate of turn at the end of a stick", "sticks", "yaw_rate", DEG),
    Row("STK_CLIMB", "m/s", 0.1, 1.0, "climb at the end of a stick", "sticks", "climb"),
)
