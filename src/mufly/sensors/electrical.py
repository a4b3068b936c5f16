"""Electrical sensors: rotor speed from back-EMF, and voltage and current of the battery.

The undriven phase of a brushless motor shows its back-EMF, e = kE i_gear Omega. The motor controller samples it with
noise and divides by the constant of the vehicle file, which has a relative error eps:

    speed = Omega (1 + eps) + n / (kE i_gear)

The battery monitor quantises the terminal voltage and measures the current with a scale error.

Sec. 6.1.9 of the dissertation proposes rotor speed control by back-EMF.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import MODEL_SPEED_UPPER
from mufly.sensors.periodic import ROW_FIRST_VALUE_INDEX, ROW_IS_VALID_INDEX, PeriodicSensor
from mufly.sensors.readings import Truth
from mufly.sensors.rng import draw_normals
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import BatteryMonitorParameters, RotorSpeedSensorParameters
from mufly.world import World

_Array = NDArray[np.float64]
# Indices of the parameters: scales of both speeds, noise (rad/s); of voltage and current (V, A)
_SPEED_SCALE_INDEX, _SPEED_NOISE_INDEX = 0, 2
_VOLTAGE_NOISE_INDEX, _VOLTAGE_RESOLUTION_INDEX, _CURRENT_SCALE_INDEX, _CURRENT_NOISE_INDEX = range(4)


@cached_njit(error_model="numpy")
def _sample_rotor_speeds(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[_Array],
    row: _Array,
) -> float:
    (numbers,) = parts
    n = np.empty(2)
    draw_normals(source, n)
    row[ROW_IS_VALID_INDEX] = 1.0
    for k in range(2):
        row[ROW_FIRST_VALUE_INDEX + k] = max(
            x[MODEL_SPEED_UPPER + k] * numbers[_SPEED_SCALE_INDEX + k] + numbers[_SPEED_NOISE_INDEX] * n[k], 0.0
        )
    return 0.0


class BackEmfSensor(PeriodicSensor):
    """Sensor of ``rotor_speed`` (2,), upper and lower (rad/s)."""

    published_readings = {"rotor_speed": slice(0, 2)}  # noqa: RUF012
    sample_function = _sample_rotor_speeds
    argument_dimensions = (1,)

    def __init__(
        self, table: RotorSpeedSensorParameters, vehicle: Vehicle, world: World, rng: np.random.Generator
    ) -> None:
        s = table
        noise = float(s.voltage_noise) / (float(vehicle.motor.back_emf_constant) * float(vehicle.gear.ratio))
        scale = 1.0 + float(s.back_emf_constant_error) * rng.standard_normal(2)
        super().__init__(float(s.period), rng, (np.array([*scale, noise]),))

    def error_free_readings(self, truth: Truth) -> dict[str, Any]:
        return {"rotor_speed": truth.rotor_speed}


@cached_njit(error_model="numpy")
def _sample_battery(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[_Array],
    row: _Array,
) -> float:
    (numbers,) = parts
    n = np.empty(2)
    draw_normals(source, n)
    volts, step = supply[0] + numbers[_VOLTAGE_NOISE_INDEX] * n[0], numbers[_VOLTAGE_RESOLUTION_INDEX]
    if step > 0.0:
        volts = np.rint(volts / step) * step
    row[ROW_IS_VALID_INDEX], row[ROW_FIRST_VALUE_INDEX] = 1.0, max(volts, 0.0)
    row[ROW_FIRST_VALUE_INDEX + 1] = supply[1] * numbers[_CURRENT_SCALE_INDEX] + numbers[_CURRENT_NOISE_INDEX] * n[1]
    return 0.0


class BatterySensor(PeriodicSensor):
    """Sensor of ``battery_voltage`` (V) and ``battery_current`` (A)."""

    published_readings = {"battery_voltage": 0, "battery_current": 1}  # noqa: RUF012
    sample_function = _sample_battery
    argument_dimensions = (1,)

    def __init__(
        self, table: BatteryMonitorParameters, vehicle: Vehicle, world: World, rng: np.random.Generator
    ) -> None:
        b = table
        scale = 1.0 + float(b.current_scale_error) * float(rng.standard_normal())
        numbers = [float(b.voltage_noise), float(b.voltage_resolution), scale, float(b.current_noise)]
        super().__init__(float(b.period), rng, (np.array(numbers),))

    def error_free_readings(self, truth: Truth) -> dict[str, Any]:
        return {"battery_voltage": truth.battery_voltage_V, "battery_current": truth.battery_current_A}
