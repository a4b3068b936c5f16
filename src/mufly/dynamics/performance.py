"""What a vehicle's hover costs and how much more its rotors can lift.

Endurance is the time that hovering takes to use up the battery: ``C d(charge)/dt = -I(charge)``, with the current of
the trim at each charge, down to the charge at which the terminal voltage falls to ``battery.low_voltage`` or the
motors reach full input. Thrust to weight is that of both motors at full input once their rotors have settled, the
battery sagging under the load. Own derivation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from mufly.dynamics.loads import rotor_loads
from mufly.dynamics.model import derivative
from mufly.dynamics.parameters import GRAVITY, model_parameters
from mufly.dynamics.state import STATE_SIZE, initial_state
from mufly.dynamics.trim import trim
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle

__all__ = ["HoverPerformance", "hover_performance"]

_CHARGES = 21


@dataclass(frozen=True)
class HoverPerformance:
    """Hover on a half-full battery, and its reserves.

    Attributes
    ----------
    rotor_speed_rad_s, motor_input, thrust_N : (float, float)
        Upper, lower.
    voltage_V, current_A, power_W : float
        At the battery's terminals, electronics included.
    endurance_s : float
        Hovering time from a full battery.
    thrust_to_weight_full, thrust_to_weight_half : float
        Both motors at full input, on a full and on a half-full battery.
    """

    rotor_speed_rad_s: tuple[float, float]
    motor_input: tuple[float, float]
    thrust_N: tuple[float, float]
    voltage_V: float
    current_A: float
    power_W: float
    endurance_s: float
    thrust_to_weight_full: float
    thrust_to_weight_half: float


def hover_performance(vehicle: Vehicle) -> HoverPerformance:
    """Return hover point, endurance and greatest thrust of a vehicle with its own battery model.

    Raises
    ------
    MuflyError
        If the vehicle is too heavy to hover on a half-full battery.
    """
    t = trim(vehicle, charge=0.5)
    return HoverPerformance(
        rotor_speed_rad_s=(float(t.rotor_speed[0]), float(t.rotor_speed[1])),
        motor_input=(float(t.motor_input[0]), float(t.motor_input[1])),
        thrust_N=(float(t.thrust_N[0]), float(t.thrust_N[1])),
        voltage_V=t.voltage_V,
        current_A=t.current_A,
        power_W=t.power_W,
        endurance_s=_endurance(vehicle),
        thrust_to_weight_full=_thrust_to_weight(vehicle, 1.0),
        thrust_to_weight_half=_thrust_to_weight(vehicle, 0.5),
    )


def _endurance(vehicle: Vehicle) -> float:
    charges = np.linspace(1.0, 0.0, _CHARGES)
    seconds_per_charge: list[float] = []
    for charge in charges:
        try:
            t = trim(vehicle, charge=float(charge))
        except MuflyError:
            break
        if t.voltage_V < float(vehicle.battery.low_voltage):
            break
        seconds_per_charge.append(float(vehicle.battery.capacity) / t.current_A)
    y = np.array(seconds_per_charge)
    return float(np.sum((y[1:] + y[:-1]) / 2) / (_CHARGES - 1))


def _thrust_to_weight(vehicle: Vehicle, charge: float) -> float:
    p, rates = model_parameters(vehicle), np.empty(STATE_SIZE)
    full, calm = np.array([1.0, 1.0, 0.0, 0.0]), np.zeros(3)

    def acceleration(speed: NDArray[np.float64]) -> NDArray[np.float64]:
        x = initial_state(position=(0, 0, -1e3), rotor_speed=speed, charge=charge)
        derivative(x, full, calm, p, rates)
        return rates[18:20].copy()

    start = trim(vehicle, charge=0.5).rotor_speed
    up, dw = root(acceleration, start, tol=1e-10).x
    thrust_up, thrust_dw, _, _ = rotor_loads(p, up, dw)
    return float((thrust_up + thrust_dw) / (p["mass"] * GRAVITY))
