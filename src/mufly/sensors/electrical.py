"""What the electronics read of motors and battery: rotor speed by back-EMF, voltage and current.

In the phase that is not driven a brushless motor shows its back-EMF, e = kE i_gear Omega. Read with noise and turned
into a speed by the constant that the vehicle file holds, which is off by a share:

    speed = Omega (1 + eps) + n / (kE i_gear)

The battery monitor reads the terminal voltage in steps, and a current whose scale is off.

The dissertation wishes for such a speed control in Sec. 6.1.9.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mufly.sensors.readings import Periodic, Reading, Truth
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import BatteryMonitor, RotorSpeed


class BackEmfSensor(Periodic):
    """Reads ``rotor_speed`` (2,), upper and lower (rad/s)."""

    def __init__(self, table: RotorSpeed, vehicle: Vehicle, rng: np.random.Generator) -> None:
        s = table
        self._rng = rng
        self._noise = float(s.noise) / (float(vehicle.motor.back_emf_constant) * float(vehicle.gear.ratio))
        self._scale = 1.0 + float(s.constant_error) * rng.standard_normal(2)
        super().__init__(float(s.period))

    def right(self, truth: Truth) -> dict[str, Any]:
        return {"rotor_speed": truth.rotor_speed}

    def measure(self, truth: Truth) -> tuple[float, dict[str, Reading]]:
        told = truth.rotor_speed * self._scale + self._noise * self._rng.standard_normal(2)
        return 0.0, {"rotor_speed": Reading(np.maximum(told, 0.0), truth.time_s)}


class BatterySensor(Periodic):
    """Reads ``battery_voltage`` (V) and ``battery_current`` (A)."""

    def __init__(self, table: BatteryMonitor, vehicle: Vehicle, rng: np.random.Generator) -> None:
        b = table
        self._rng, self._step = rng, float(b.voltage_resolution)
        self._noise, self._current_noise = float(b.voltage_noise), float(b.current_noise)
        self._scale = 1.0 + float(b.current_scale) * float(rng.standard_normal())
        super().__init__(float(b.period))

    def right(self, truth: Truth) -> dict[str, Any]:
        return {"battery_voltage": truth.voltage, "battery_current": truth.current}

    def measure(self, truth: Truth) -> tuple[float, dict[str, Reading]]:
        n = self._rng.standard_normal(2)
        volts = truth.voltage + self._noise * float(n[0])
        if self._step > 0.0:
            volts = round(volts / self._step) * self._step
        amps = truth.current * self._scale + self._current_noise * float(n[1])
        return 0.0, {
            "battery_voltage": Reading(max(volts, 0.0), truth.time_s),
            "battery_current": Reading(amps, truth.time_s),
        }
