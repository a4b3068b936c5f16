"""Every number that may be tuned while the helicopter flies: name, unit, bounds, where it is kept.

Names are those of a MAVLink parameter: at most 16 characters. Values at this edge are in the unit that the table
names (degrees, not radians); inside they stay SI. Three kinds:

- of the mission (``MIS_``, ``LIM_``, ``AVD_``, ``BAT_``): keys of a mission file (docs/missions.md), with its bounds.
  A limit is never above 80 % of what the controllers can follow (:mod:`mufly.mission.check`), so its greatest value
  moves with the controllers'.
- of the control law (``CTL_``): limits of the reference filters, and the one gain outside of the H-infinity
  controllers. They are gone over to within half a second (:class:`mufly.flight.software.Controllers`).
- of the pilot's sticks (``STK_``): what a stick at its end asks for.

Bounds of the control law. The position gain closes a loop: with it between 0.2 and 2 1/s the cascade of both built-in
vehicles keeps its sensitivities below 4.9 dB and a phase margin above 36 degrees (at 2.5 1/s they pass 6 dB);
``tests/flight/test_parameters.py`` asks ``analyse_cascade`` again. The others are limits and filters in front of the
loops, which cannot make them unstable; between their bounds simulated steps still settle (same test).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mufly.control import FlightController
from mufly.errors import InputError
from mufly.flight.software import FlightSoftware, able, copied
from mufly.mission import SHARE, Mission
from mufly.vehicle import Vehicle

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


# ----------------------------------------------------------------------------
# The numbers of :mod:`mufly.flight.parameters`, read and changed while the helicopter flies.


@dataclass(slots=True)
class Sticks:
    """What the pilot's sticks ask for at their ends: tilt (rad), rate of turn (rad/s), climb (m/s)."""

    tilt: float = math.radians(8.0)
    yaw_rate: float = math.radians(60.0)
    climb: float = 0.4


_ABLE = {
    "speed_m_s": ("speed", 1.0),
    "climb_m_s": ("climb", 1.0),
    "descent_m_s": ("descent", 1.0),
    "acceleration_m_s2": ("acceleration", 1.0),
    "climb_acceleration_m_s2": ("climb_acceleration", 1.0),
    "yaw_rate_deg_s": ("yaw_rate", DEG),
    "yaw_acceleration_deg_s2": ("yaw_acceleration", DEG),
}
_CLOSE = 1e-6
"""A value that travelled in single precision may miss a bound by this share."""


class Parameters(Mapping[str, Parameter]):
    """The numbers that may be tuned, as they are now.

    Parameters
    ----------
    vehicle : Vehicle
        Its battery bounds the low voltage.
    controller : FlightController
        The design; tuned copies of it go to the flight software.
    software : FlightSoftware
        Which they act on.
    """

    def __init__(self, vehicle: Vehicle, controller: FlightController, software: FlightSoftware) -> None:
        self.sticks = Sticks()
        self._vehicle = vehicle
        self._controller = controller
        self._software = software
        self._rows = {row.name: row for row in TABLE}

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __getitem__(self, name: str) -> Parameter:
        row = self._rows[name]
        least, greatest = self._bounds(row)
        return Parameter(name, self._value(row), row.unit, least, greatest, row.help, row.whole)

    def set(self, name: str, value: float) -> str:
        """Change one.

        Returns
        -------
        str
            Why not, in words; "" if it is done.
        """
        row = self._rows.get(name)
        if row is None:
            return f"there is no parameter {name[:40]!r}; the list names them all"
        least, greatest = self._bounds(row)
        slack = _CLOSE * max(abs(least), abs(greatest), 1.0)
        if not (math.isfinite(value) and least - slack <= value <= greatest + slack):
            return f"{name} {value:g} refused: give {least:g} to {greatest:g} {row.unit}".rstrip()
        if row.whole and abs(value - round(value)) > _CLOSE:
            return f"{name} {value:g} refused: give a whole number, {least:g} to {greatest:g}"
        value = min(max(value, least), greatest)
        try:
            self._keep(row, value / row.scale)
        except InputError as error:
            return f"{name} {value:g} refused: {error.problem}; {error.remedy}"
        return ""

    def _bounds(self, row: Row) -> tuple[float, float]:
        if row.key == "low_V":
            nominal = float(self._vehicle.battery.nominal_voltage)
            return 0.5 * nominal, nominal
        if row.key in _ABLE and row.table == "limits":
            name, scale = _ABLE[row.key]
            most = SHARE * scale * float(getattr(able(self._controller), name))
            return min(row.least, most), min(row.greatest, most)
        return row.least, row.greatest

    def _value(self, row: Row) -> float:
        if row.table == "sticks":
            return float(getattr(self.sticks, row.key)) * row.scale
        if row.table in ("position", "heave_yaw"):
            return float(self._record(row)[row.key]) * row.scale
        if row.key == "low_V":
            return self._software.plan.low_V
        return float(getattr(getattr(self._software.plan.mission, row.table), row.key)) * row.scale

    def _record(self, row: Row) -> np.void:
        c = self._controller
        return c.position_gains if row.table == "position" else c.heave_yaw_gains

    def _keep(self, row: Row, value: float) -> None:
        if row.table == "sticks":
            setattr(self.sticks, row.key, value)
        elif row.table in ("position", "heave_yaw"):
            record = copied(self._record(row))
            record[row.key] = value
            fields = {f"{row.table}_gains": record}
            self._controller = _replaced(self._controller, fields)
            self._software.retune(self._controller)
        else:
            given: float | bool = bool(round(value)) if row.whole else value
            self._software.change(with_value(self._software.asked, row.table, row.key, given))


def _replaced(controller: FlightController, fields: Mapping[str, np.void]) -> FlightController:
    return replace(controller, **fields)  # type: ignore[arg-type]


def with_value(mission: Mission, table: str, key: str, value: float | bool) -> Mission:
    """The same mission with one key of one of its tables changed; checked, and derived anew."""
    parts = {name: getattr(mission, name) for name in Mission.model_fields}
    held = getattr(mission, table)
    parts[table] = type(held)(**{**held.model_dump(), key: value})
    return Mission(**parts)
