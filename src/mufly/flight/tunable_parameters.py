"""Parameters that can be changed in flight: name, unit, bounds and the key that stores each.

A name is a MAVLink parameter name of at most 16 characters. Values at this interface have the unit of the table
(degrees, not radians); stored values are SI. ``docs/make_reference.py`` writes the reference page from this table.
There are three kinds:

- mission (``MIS_``, ``LIM_``, ``AVD_``, ``BAT_``): keys of a mission file (docs/reference/missions.md), with its
  bounds. The maximum of a limit is at most 80 % of the limit of the controllers
  (:mod:`mufly.mission.files.mission_checks`), so this maximum depends on the controller design.
- control law (``CTL_``): limits of the reference filters, and the position gain. A change takes effect with a time
  constant of 0.5 s (:class:`mufly.flight.controllers.Controllers`).
- sticks (``STK_``): command at full stick deflection.

The position gain is the only parameter inside a loop. Between 0.2 and 2 1/s the cascade of both built-in vehicles keeps
its sensitivity peaks below 4.9 dB and a phase margin above 36 degrees; ``tests/flight/test_parameters.py`` evaluates
``analyse_position_cascade`` at the bounds. The other control parameters are limits and filters outside the loops and
cannot make them unstable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from mufly.control import FlightController
from mufly.errors import InputError
from mufly.flight.controllers import copy_record, derive_trajectory_limits
from mufly.flight.flight_software import FlightSoftware
from mufly.mission import MISSION_FRACTION_OF_CONTROL_LIMITS, limits_to_file_units
from mufly.vehicle import Vehicle

DEGREES_PER_RADIAN = math.degrees(1.0)


@dataclass(frozen=True, slots=True)
class TunableParameter:
    """A tunable parameter, as a vehicle reports it and a ground station shows it.

    Attributes
    ----------
    name : str
        At most 16 characters.
    value : float
        Value in ``unit``.
    unit : str
        Unit of value and bounds; "" if dimensionless or unknown.
    minimum, maximum : float
        Inclusive bounds; infinite if unknown.
    description : str
    is_integer : bool
        Whether the value must be an integer.
    """

    name: str
    value: float
    unit: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    description: str = ""
    is_integer: bool = False


_PARAMETER_ROWS = """
MIS_TAKEOFF_ALT m      0.2  50   take_off.height_m              takeoff height above the floor
LIM_SPEED       m/s    0.05 3    limits.speed_m_s               maximum horizontal speed
LIM_CLIMB       m/s    0.05 2    limits.climb_m_s               maximum climb rate
LIM_DESCENT     m/s    0.05 1    limits.descent_m_s             maximum descent rate
LIM_TOUCHDOWN   m/s    0.05 0.25 limits.touchdown_m_s           descent rate over the last 0.4 m above the floor
LIM_ACCEL       m/s2   0.05 2    limits.acceleration_m_s2       maximum horizontal acceleration
LIM_CLIMB_ACC   m/s2   0.05 2    limits.climb_acceleration_m_s2 maximum vertical acceleration
LIM_YAWRATE     deg/s  1    360  limits.yaw_rate_deg_s          maximum yaw rate
LIM_YAWACC      deg/s2 5    1000 limits.yaw_acceleration_deg_s2 maximum yaw acceleration
LIM_REACH       m      0.01 1    limits.reach_m                 acceptance radius of a waypoint
AVD_ENABLE      -      0    1    avoidance.enabled              1: detect and avoid obstacles; 0: ignore them
AVD_CLEARANCE   m      0.15 1    avoidance.clearance_m          minimum distance from the centre to any obstacle
AVD_SPEED       m/s    0.06 1    avoidance.speed_m_s            maximum speed around an obstacle
BAT_LOW_V       V      0    inf  battery.low_V                  battery voltage below which the vehicle lands
CTL_POS_GAIN    1/s    0.2  1.9  position.position_gain         velocity command per metre of position error
CTL_SPEED_MAX   m/s    0.3  3    position.speed_limit           maximum velocity command of the position loop
CTL_TILT_MAX    deg    3    15   position.tilt_limit            maximum tilt command of the position loop
CTL_HEAVE_BW    rad/s  2    16   heave_yaw.heave_bandwidth      bandwidth of the height reference filter
CTL_HEAVE_SPD   m/s    0.2  2    heave_yaw.heave_speed          maximum speed of the height reference
CTL_HEAVE_ACC   m/s2   0.1  1.5  heave_yaw.heave_acceleration   maximum acceleration of the height reference
CTL_YAW_BW      rad/s  2    16   heave_yaw.yaw_bandwidth        bandwidth of the heading reference filter
CTL_YAW_RATE    deg/s  10   200  heave_yaw.yaw_rate             maximum rate of the heading reference
CTL_YAW_ACC     deg/s2 30   600  heave_yaw.yaw_acceleration     maximum acceleration of the heading reference
STK_TILT        deg    1    15   sticks.tilt                    tilt command at full stick deflection
STK_YAWRATE     deg/s  5    110  sticks.yaw_rate                yaw rate command at full stick deflection
STK_CLIMB       m/s    0.1  1    sticks.climb                   climb rate command at full stick deflection
"""


def _parse_rows() -> tuple[dict[str, TunableParameter], dict[str, tuple[str, str]]]:
    rows = [line.split(maxsplit=5) for line in _PARAMETER_ROWS.strip().splitlines()]
    known = {
        name: TunableParameter(
            name, math.nan, unit.strip("-"), float(least), float(greatest), text, is_integer=unit == "-"
        )
        for name, unit, least, greatest, _, text in rows
    }
    keys = {}
    for name, _, _, _, place, _ in rows:
        table, key = place.split(".")
        keys[name] = (table, key)
    return known, keys


TUNABLE_PARAMETERS, STORAGE_KEYS = _parse_rows()
"""Every parameter without its value, by name; the table and key that store each value, by name."""


@dataclass(slots=True)
class StickRanges:
    """Commands at full stick deflection: tilt (rad), yaw rate (rad/s), climb rate (m/s)."""

    tilt: float = math.radians(8.0)
    yaw_rate: float = math.radians(60.0)
    climb: float = 0.4


_BOUND_TOLERANCE = 1e-6
"""Relative tolerance of the bounds, for values transmitted in single precision."""


class TunableParameters(Mapping[str, TunableParameter]):
    """Mapping of names to tunable parameters with their present values.

    Parameters
    ----------
    vehicle : Vehicle
        Its nominal battery voltage bounds ``BAT_LOW_V``.
    controller : FlightController
        Control design; the flight software receives tuned copies of it.
    software : FlightSoftware
        Flight software that is tuned.
    """

    def __init__(self, vehicle: Vehicle, controller: FlightController, software: FlightSoftware) -> None:
        self.stick_ranges = StickRanges()
        self._vehicle = vehicle
        self._controller = controller
        self._software = software

    def __len__(self) -> int:
        return len(TUNABLE_PARAMETERS)

    def __iter__(self) -> Iterator[str]:
        return iter(TUNABLE_PARAMETERS)

    def __getitem__(self, name: str) -> TunableParameter:
        table, key = STORAGE_KEYS[name]
        p = TUNABLE_PARAMETERS[name]
        least, greatest = p.minimum, p.maximum
        most = limits_to_file_units(derive_trajectory_limits(self._controller)).get(key) if table == "limits" else None
        if key == "low_V":
            greatest = float(self._vehicle.battery.nominal_voltage)
            least = 0.5 * greatest
        elif most is not None:
            least, greatest = (
                min(least, MISSION_FRACTION_OF_CONTROL_LIMITS * most),
                min(greatest, MISSION_FRACTION_OF_CONTROL_LIMITS * most),
            )
        return replace(
            p, value=self._stored_value(table, key) * _shown_per_stored_unit(p, table), minimum=least, maximum=greatest
        )

    def set_value(self, name: str, value: float) -> str:
        """Set a parameter's value, in its unit, or return why it is refused.

        Returns
        -------
        str
            Reason of a refusal; "" if the value is set.
        """
        if name not in TUNABLE_PARAMETERS:
            return f"there is no parameter {name[:40]!r}; use a name of the parameter list"
        p = self[name]
        least, greatest = p.minimum, p.maximum
        slack = _BOUND_TOLERANCE * max(abs(least), abs(greatest), 1.0)
        if not (math.isfinite(value) and least - slack <= value <= greatest + slack):
            return f"{name} {value:g} refused: give {least:g} to {greatest:g} {p.unit}".rstrip()
        if p.is_integer and abs(value - round(value)) > _BOUND_TOLERANCE:
            return f"{name} {value:g} refused: give a whole number, {least:g} to {greatest:g}"
        value = min(max(value, least), greatest)
        try:
            self._store_value(p, value)
        except InputError as error:
            return f"{name} {value:g} refused: {error.problem}; {error.remedy}"
        return ""

    def _stored_value(self, table: str, key: str) -> float:
        """Return the stored value, in the unit of its table."""
        if table == "sticks":
            return float(getattr(self.stick_ranges, key))
        if table in _GAIN_RECORDS:
            return float(getattr(self._controller, _GAIN_RECORDS[table])[key])
        if key == "low_V":
            return self._software.plan.low_battery_V
        return float(getattr(getattr(self._software.plan.mission, table), key))

    def _store_value(self, p: TunableParameter, value: float) -> None:
        table, key = STORAGE_KEYS[p.name]
        value /= _shown_per_stored_unit(p, table)
        if table == "sticks":
            setattr(self.stick_ranges, key, value)
        elif table in _GAIN_RECORDS:
            record = copy_record(getattr(self._controller, _GAIN_RECORDS[table]))
            record[key] = value
            self._controller = replace(self._controller, **{_GAIN_RECORDS[table]: record})  # type: ignore[arg-type]
            self._software.retune_controllers(self._controller)
        else:
            asked = self._software.requested_mission
            held = getattr(asked, table)
            given = {**held.model_dump(), key: bool(round(value)) if p.is_integer else value}
            self._software.apply_mission_limits(asked.replace_parts(**{table: type(held)(**given)}))


_GAIN_RECORDS = {"position": "position_gains", "heave_yaw": "heave_yaw_gains"}


def _shown_per_stored_unit(p: TunableParameter, table: str) -> float:
    """Return the factor from the stored unit to the parameter's unit: 180 / pi for degrees stored as radians, else
    1.
    """
    return DEGREES_PER_RADIAN if p.unit.startswith("deg") and table in (*_GAIN_RECORDS, "sticks") else 1.0
