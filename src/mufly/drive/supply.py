"""The battery as a supply: voltage at rest, resistance, and terminal voltage under motors of constant power.

n motors that draw P each and electronics I_el at the terminal voltage U make U = U_oc - R_b (n P / U + I_el), hence

    U = (E + sqrt(E^2 - 4 R_b n P)) / 2,       E = U_oc - R_b I_el,

and the battery breaks down where the root has no value. With given duty instead, the terminal voltage is the closed
form of ``battery.terminal_voltage``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.drive.battery import interpolate
from mufly.errors import InputError
from mufly.vehicle.schema import Battery

__all__ = ["battery_voltage", "internal_resistance", "open_circuit_voltage"]

Array = NDArray[np.float64]


def open_circuit_voltage(battery: Battery, charge: float) -> float:
    """Return the battery's voltage at rest (V) with ``charge`` (0 to 1) left, as the flight model has it."""
    if not 0.0 <= charge <= 1.0:
        raise InputError("battery", "charge", f"{charge:g} is not possible", "give a fraction from 0 to 1")
    if battery.model == "constant":
        return float(battery.nominal_voltage)
    return float(interpolate(battery.open_circuit_voltage.sample(101), charge))


def internal_resistance(battery: Battery) -> float:
    """Return R_b (ohm): zero for the 'constant' model, which does not sag."""
    return 0.0 if battery.model == "constant" else float(battery.internal_resistance)


def battery_voltage(battery: Battery, open_circuit_V: ArrayLike, power_W: ArrayLike) -> Array:
    """Return the terminal voltage under motors of constant power and the electronics; nan where it breaks down.

    Parameters
    ----------
    battery : Battery
    open_circuit_V : array_like
        Voltage at rest (V).
    power_W : array_like
        Power of all motors together (W).
    """
    r = internal_resistance(battery)
    e = np.asarray(open_circuit_V, dtype=np.float64) - r * float(battery.electronics_current)
    inside = e**2 - 4.0 * r * np.asarray(power_W, dtype=np.float64)
    return np.where((inside >= 0) & (e > 0), 0.5 * (e + np.sqrt(np.maximum(inside, 0.0))), np.nan)
