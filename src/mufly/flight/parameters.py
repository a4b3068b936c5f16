"""The numbers of :mod:`mufly.flight.parameter_table`, read and changed while the helicopter flies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mufly.control import FlightController
from mufly.errors import InputError
from mufly.flight.controllers import able, copied
from mufly.flight.parameter_table import DEG, TABLE, Parameter, Row
from mufly.flight.software import FlightSoftware
from mufly.mission import SHARE, Mission
from mufly.vehicle import Vehicle

__all__ = ["Parameters", "Sticks"]


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
