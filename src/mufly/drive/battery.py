"""Battery: open-circuit voltage over charge, internal resistance, the loads that hang on it, how long it lasts.

Loads are the electronics (constant current ``I_el``) and motors that draw ``duty * I_A`` (see
:mod:`mufly.drive.train`). The supply current is linear in the terminal voltage, so voltage and current follow in
closed form (own derivation)::

    I = I_el + G U - S,   G = sum(duty^2) / R,   S = sum(duty * kE * i * Omega) / R
    U = U_oc - R_bat I    =>   U = (U_oc + R_bat (S - I_el)) / (1 + R_bat G)

Motors of constant power: n motors that draw P each and electronics I_el at the terminal voltage U make U = U_oc - R_b
(n P / U + I_el), hence

    U = (E + sqrt(E^2 - 4 R_b n P)) / 2,       E = U_oc - R_b I_el,

and the battery breaks down where the root has no value. With given duty instead, the terminal voltage is the closed
form of :func:`terminal_voltage`.

How long a battery holds a hover. It needs the same speed and torque to the end, so the motors need the same power P
and the same motor voltage U_m. With z the charge left (1 to 0) and C the capacity

    -C dz/dt = I(z) = P / U(z) + I_el,       U(z) = U_oc(z) - R_b I(z)            (:func:`battery_voltage`)
    t = C int_z_end^1 dz / I(z)

U_oc is linear between the points of its table, and the integrand is smooth on each piece: eight Gauss points a
piece are exact to rounding. The hover ends when the terminal voltage falls to the larger of the battery's low
voltage and U_m (then duty is 1), or to sqrt(R_b P), where the battery breaks down; by the same balance that is
at

    U_oc,end = U_end + R_b (P / U_end + I_el).

Own derivation. Limit without resistance and with flat U_oc: t = C / (P / U_oc + I_el).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled import compiled
from mufly.errors import InputError, MuflyError
from mufly.results import result
from mufly.vehicle.schema import Battery


@compiled(error_model="numpy")
def interpolate(table, fraction):  # type: ignore[no-untyped-def]
    """Interpolate ``table`` (n values at equal steps from 0 to 1) linearly; the ends hold outside."""
    last = table.shape[0] - 1
    position = min(max(fraction, 0.0), 1.0) * last
    k = min(int(position), last - 1)
    return table[k] + (position - k) * (table[k + 1] - table[k])


@compiled(error_model="numpy")
def terminal_voltage(open_circuit, resistance, conductance, source_current, electronics_current):  # type: ignore[no-untyped-def]
    """Return the terminal voltage (V) under load; never below zero (equation above)."""
    voltage = (open_circuit + resistance * (source_current - electronics_current)) / (
        1.0 + resistance * conductance
    )
    return max(voltage, 0.0)


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


_POINTS = 8


@result
class Endurance:
    """How long a hover lasts from a full battery.

    Attributes
    ----------
    time_s : float
    charge_left : float
        Fraction of the charge at the end.
    ends_by : str
        ``"low voltage"``, ``"full duty"``, ``"breakdown"`` or ``"empty"``.
    voltage_full_V, voltage_end_V : float
        At the battery's terminals.
    mean_current_A : float
        Of the battery.
    """

    time_s: float
    charge_left: float
    ends_by: Literal["low voltage", "full duty", "breakdown", "empty"]
    voltage_full_V: float
    voltage_end_V: float
    mean_current_A: float


def hover_endurance(battery: Battery, *, power_W: float, motor_voltage_V: float) -> Endurance:
    """Return how long a battery feeds motors of constant power.

    Parameters
    ----------
    battery : Battery
        Of a drive or a vehicle.
    power_W : float
        Of all motors together, at the battery.
    motor_voltage_V : float
        The highest mean voltage that a motor needs.

    Raises
    ------
    MuflyError
        If not even the full battery can.
    """
    r, electronics = internal_resistance(battery), float(battery.electronics_current)
    ends: dict[Literal["low voltage", "full duty", "breakdown"], float] = {
        "low voltage": 0.0 if battery.model == "constant" else float(battery.low_voltage),
        "full duty": motor_voltage_V,
        "breakdown": math.sqrt(r * power_W),
    }
    by = max(ends, key=lambda key: ends[key])
    end = ends[by]
    rest_end = end + r * (power_W / end + electronics) if end > 0 else 0.0
    if battery.model == "constant":
        charge, rest = np.array([0.0, 1.0]), np.full(2, open_circuit_voltage(battery, 1.0))
    else:
        charge = np.array(battery.open_circuit_voltage.fraction)
        rest = np.array(battery.open_circuit_voltage.value)
    if rest[-1] < rest_end - 1e-12:
        raise MuflyError(
            f"the full battery cannot hold this hover: it needs {end:.3g} V under {power_W:.3g} W and "
            f"{electronics:.2g} A ({by}), so {rest_end:.3g} V at rest, but has {rest[-1]:.3g} V"
        )
    below = np.flatnonzero(rest < rest_end)
    if below.size:
        k = int(below[-1])
        left = float(charge[k] + (rest_end - rest[k]) / (rest[k + 1] - rest[k]) * (charge[k + 1] - charge[k]))
        charge, rest = np.r_[left, charge[k + 1 :]], np.r_[rest_end, rest[k + 1 :]]
    node, weight = np.polynomial.legendre.leggauss(_POINTS)
    half, middle = 0.5 * np.diff(charge)[:, None], 0.5 * (charge[1:] + charge[:-1])[:, None]
    at = middle + half * node
    current = power_W / battery_voltage(battery, np.interp(at, charge, rest), power_W) + electronics
    time = float(battery.capacity) * float(np.sum(half * weight / current))
    return Endurance(
        time_s=time,
        charge_left=float(charge[0]),
        ends_by=by if below.size else "empty",
        voltage_full_V=float(battery_voltage(battery, rest[-1], power_W)),
        voltage_end_V=float(battery_voltage(battery, max(rest[0], rest_end), power_W)),
        mean_current_A=float(battery.capacity) * (1.0 - float(charge[0])) / time if time > 0 else math.nan,
    )
