"""Absolute pressure sensor, from which the height is computed.

In a room the pressure falls by rho g per metre of height. Weather and doors change it by far more within minutes (a
first-order Gauss-Markov process). Near the rotors the port senses a share k of the disc loading T / A of the downwash.
The sensor's own filter delays the reading:

    p = p_0 + rho g D + k T / A + drift,     tau dy/dt = p - y,     reading = y + n

D is the down coordinate. A share k of 0.05 of a disc loading of 4 mN/cm2 already gives an error of two centimetres: a
barometer alone cannot hold hover.
Own derivation; the sensor is that of Sec. 2.1.2 of the dissertation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import MODEL_POSITION, MODEL_SPEED_LOWER, MODEL_SPEED_UPPER
from mufly.quantities.sensor_table import READINGS
from mufly.quantities.units import GRAVITY
from mufly.sensors.periodic import (
    ROW_FIRST_VALUE_INDEX,
    ROW_IS_VALID_INDEX,
    PeriodicSensor,
    draw_stationary_gauss_markov,
    propagate_gauss_markov,
)
from mufly.sensors.readings import Truth
from mufly.sensors.rng import draw_normals
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import PressureSensorParameters
from mufly.world import World

_Array = NDArray[np.float64]

STANDARD_PRESSURE_PA = READINGS["pressure"].filter_datum
# Indices of the parameters: noise (Pa), delay, time constant of the drift (s), weight of air (N/m3), share of the disc
# loading, loading of each disc over the square of its speed
(
    _NOISE_INDEX,
    _DELAY_INDEX,
    _DRIFT_TIME_INDEX,
    _AIR_WEIGHT_INDEX,
    _DOWNWASH_FRACTION_INDEX,
    _UPPER_DISC_LOADING_INDEX,
    _LOWER_DISC_LOADING_INDEX,
) = range(7)


@cached_njit(error_model="numpy")
def _sample_pressure(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[_Array, _Array, _Array, _Array],
    row: _Array,
) -> float:
    # parameters, standard deviation and memory of the drift, filter state and its time (s)
    numbers, sigma, memory, felt = parts
    delay, n = numbers[_DELAY_INDEX], np.empty(1)
    propagate_gauss_markov(t, sigma, numbers[_DRIFT_TIME_INDEX], memory, source)
    draw_normals(source, n)
    upper, lower = x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER]
    loading = numbers[_UPPER_DISC_LOADING_INDEX] * (upper * upper) + numbers[_LOWER_DISC_LOADING_INDEX] * (
        lower * lower
    )
    true = (
        STANDARD_PRESSURE_PA
        + numbers[_AIR_WEIGHT_INDEX] * x[MODEL_POSITION + 2]
        + numbers[_DOWNWASH_FRACTION_INDEX] * loading
        + memory[1]
    )
    if math.isnan(felt[0]) or delay == 0.0:
        felt[0] = true
    else:
        felt[0] += (true - felt[0]) * (1.0 - math.exp(-(t - felt[1]) / delay))
    felt[1] = t
    row[ROW_IS_VALID_INDEX], row[ROW_FIRST_VALUE_INDEX] = 1.0, felt[0] + numbers[_NOISE_INDEX] * n[0]
    return 0.0


class PressureSensor(PeriodicSensor):
    """Sensor of the absolute air pressure, ``pressure`` (Pa)."""

    published_readings = {"pressure": 0}  # noqa: RUF012
    sample_function = _sample_pressure
    argument_dimensions = (1, 1, 1, 1)

    def __init__(
        self, table: PressureSensorParameters, vehicle: Vehicle, world: World, rng: np.random.Generator
    ) -> None:
        p = table
        density, radius = float(vehicle.air.density), float(vehicle.rotors.radius)
        # T / A = rho c_T R^2 Omega^2 of each rotor, by the definition of c_T
        both = (vehicle.rotors.upper, vehicle.rotors.lower)
        loading = density * radius**2 * np.array([float(r.thrust_coefficient) for r in both])
        self._air_weight = density * GRAVITY
        numbers = [
            float(p.noise),
            float(p.filter_delay),
            float(p.drift_correlation_time),
            self._air_weight,
            float(p.downwash_coefficient),
            *loading,
        ]
        self._sigma, self._memory, self._rotor_pressure = np.array([float(p.drift)]), np.empty(2), np.empty(2)
        super().__init__(float(p.period), rng, (np.array(numbers), self._sigma, self._memory, self._rotor_pressure))

    def reset(self) -> None:
        super().reset()
        draw_stationary_gauss_markov(self._rng, self._sigma, self._memory)
        self._rotor_pressure[:] = math.nan, 0.0

    def error_free_readings(self, truth: Truth) -> dict[str, float]:
        return {"pressure": STANDARD_PRESSURE_PA + self._air_weight * float(truth.position[2])}
