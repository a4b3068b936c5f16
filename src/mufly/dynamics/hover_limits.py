"""Limits of a hover that the flight model does not contain: tip Mach number, disc loading, power of motors and battery.

The flight model uses the same coefficients at every tip speed, and motors and batteries of any mass deliver any power.
A vehicle may therefore hover in the model and not in reality. The limits are own estimates for vehicles up to 100 kg,
from data sheets of small motors and lithium-polymer cells (2025) and from full-size helicopters; each constant states
its value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from mufly.dynamics.linearisation import HoverPerformance
from mufly.quantities.units import GRAVITY, RPM
from mufly.vehicle import UnusualParameter, Vehicle

SPEED_OF_SOUND_M_S = 343.2
"""Speed of sound in dry air of 20 degC (m/s)."""
MAX_TIP_MACH = 1.0
"""Tip Mach number from which no hover is credible."""
_MAX_USUAL_TIP_MACH = 0.6  # wave drag of thick blades begins; coefficients depend on the Mach number above
_DISC_LOADING_RANGE = 3.0, 250.0  # N/m2: human-powered helicopters; unmanned helicopters of 200 kg
_MAX_ACTUATOR_POWER_W_KG = 3000.0  # electrical power of small motors with controllers, for minutes
_MAX_DISCHARGE_RATE_PER_H = 30.0  # current in hover over capacity; cells give twice that in bursts
_MIN_ENDURANCE_S = 60.0


def compute_tip_mach_number(vehicle: Vehicle, hover: HoverPerformance) -> float:
    """Return the Mach number of the faster rotor's tips in hover."""
    return max(hover.rotor_speed_rad_s) * float(vehicle.rotors.radius) / SPEED_OF_SOUND_M_S


def judge_hover(vehicle: Vehicle, hover: HoverPerformance) -> Iterator[UnusualParameter]:
    """Yield the limits that a vehicle exceeds in hover, each with its parameter and a remedy."""
    radius, mass = float(vehicle.rotors.radius), float(vehicle.body.mass)
    mach, rpm = compute_tip_mach_number(vehicle, hover), max(hover.rotor_speed_rad_s) / RPM
    if mach > _MAX_USUAL_TIP_MACH:
        yield UnusualParameter(
            "rotors.radius",
            f"the tips run at Mach {mach:.2f} in hover ({rpm:.0f} rpm), and constant coefficients hold up to "
            f"Mach {_MAX_USUAL_TIP_MACH:g}",
            "give larger rotors or less mass",
        )
    disc = math.pi * radius**2
    loading, (low, high) = mass * GRAVITY / disc, _DISC_LOADING_RANGE
    if not low <= loading <= high:
        yield UnusualParameter(
            "rotors.radius",
            f"the disc loading is {loading:.3g} N/m2 ({1e3 * mass:.4g} g on rotors of {1e3 * radius:.4g} mm); "
            f"helicopters up to 100 kg have {low:g} to {high:g} N/m2",
            "give larger rotors or less mass" if loading > high else "give smaller rotors or more mass",
        )
    if vehicle.mass_budget is not None and float(vehicle.mass_budget.actuators) > 0.0:
        actuators = float(vehicle.mass_budget.actuators)
        power = hover.battery_power_W - hover.battery_voltage_V * float(vehicle.battery.electronics_current)
        if power > _MAX_ACTUATOR_POWER_W_KG * actuators:
            yield UnusualParameter(
                "mass_budget.actuators",
                f"{1e3 * actuators:.3g} g take {power:.3g} W in hover, {1e-3 * power / actuators:.2g} W/g; small "
                f"motors with controllers take up to {1e-3 * _MAX_ACTUATOR_POWER_W_KG:g} W/g",
                "give heavier motors, larger rotors or less mass",
            )
    rate = hover.battery_current_A * 3600.0 / float(vehicle.battery.capacity)
    if vehicle.battery.model != "constant" and rate > _MAX_DISCHARGE_RATE_PER_H:
        yield UnusualParameter(
            "battery.capacity",
            f"{float(vehicle.battery.capacity) / 3.6:.4g} mA h give {hover.battery_current_A:.3g} A in hover, "
            f"{rate:.0f} times the capacity an hour; cells give up to {_MAX_DISCHARGE_RATE_PER_H:g}",
            "give more capacity or less mass",
        )
    if hover.endurance_s < _MIN_ENDURANCE_S:
        yield UnusualParameter(
            "battery.capacity",
            f"hover lasts {hover.endurance_s:.0f} s from a full battery",
            "give more capacity or less mass",
        )
