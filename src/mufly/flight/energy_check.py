"""Checks of a mission and of a flight to a position against the charge of the battery."""

from __future__ import annotations

import math

import numpy as np

from mufly.drive import find_charge_from_idle_voltage
from mufly.dynamics import hover_current_A
from mufly.estimate import Estimate
from mufly.flight.arming import describe_refused_start
from mufly.mission import Mission
from mufly.mission.files.mission_timing import compute_time_to_land_at
from mufly.vehicle import Vehicle

MIN_FULL_CHARGE = 0.97
"""Charge (0..1) above which the battery counts as full: the voltage at rest is known to a few hundredths of a volt."""

_REST_VOLTAGE_FILTER_S = 1.0  # time constant of the filtered voltage at rest


class EnergyCheck:
    """Estimate the charge from the battery's voltage at rest, and check whether it suffices for a flight.

    Parameters
    ----------
    vehicle : Vehicle

    Attributes
    ----------
    hover_current_A : float
        Battery current in hover (A).

    Raises
    ------
    InputError
        If the vehicle cannot hover.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.hover_current_A = hover_current_A(vehicle)
        self._battery = vehicle.battery
        self._capacity_Ah = float(vehicle.battery.capacity) / 3600.0
        self.reset()

    def reset(self) -> None:
        """Discard the filtered voltage and the cached result."""
        self._rest_V = math.nan
        self._checked: tuple[Mission | None, tuple[float, ...], str] = (None, (), "")

    def observe_rest_voltage(self, voltage_V: float, dt_s: float) -> None:
        """Filter a voltage that was measured with the motors off."""
        blend = min(1.0, dt_s / _REST_VOLTAGE_FILTER_S)
        self._rest_V = voltage_V if math.isnan(self._rest_V) else self._rest_V + blend * (voltage_V - self._rest_V)

    @property
    def charge_from_rest_voltage(self) -> float:
        """Charge of the battery (0..1) from its voltage at rest, in steps of 0.01; 1 if full or unknown."""
        if math.isnan(self._rest_V):
            return 1.0
        charge = round(find_charge_from_idle_voltage(self._battery, self._rest_V), 2)
        return 1.0 if charge >= MIN_FULL_CHARGE else charge

    def find_start_refusal(self, mission: Mission, standing: tuple[float, float], heading: float) -> str:
        """Return why the mission must not start at N, E (m) with a heading (rad); "" if the mission may start."""
        return describe_refused_start(
            mission,
            standing,
            heading,
            hover_current_A=self.hover_current_A,
            capacity_Ah=self._capacity_Ah,
            charge=self.charge_from_rest_voltage,
        )

    def find_start_refusal_here(self, mission: Mission, m: Estimate) -> str:
        """Return :meth:`find_start_refusal` at the estimated position, cached by mission, place and charge."""
        north, east = round(float(m.position[0]), 2), round(float(m.position[1]), 2)
        heading = round(float(m.attitude[2]), 1) if math.isfinite(m.attitude[2]) else 0.0
        where = (north, east, heading, self.charge_from_rest_voltage)
        if self._checked[0] is not mission or self._checked[1] != where:
            self._checked = (mission, where, self.find_start_refusal(mission, (north, east), heading))
        return self._checked[2]

    def find_reach_refusal(self, mission: Mission, m: Estimate | None, place: tuple[float, float, float]) -> str:
        """Return why a position is out of reach of a full battery (flight and landing); "" if it is in reach."""
        if m is None or not np.isfinite(m.position).all():
            return ""
        needed = compute_time_to_land_at(mission, m.position, place)
        lasts = 3600.0 * mission.battery.usable * self._capacity_Ah / self.hover_current_A
        if needed <= lasts:
            return ""
        return f"out of reach: flight and landing take {needed:.0f} s, a full battery lasts {lasts:.0f} s"
