"""Delayed position and heading fixes with correlated errors, like those of visual SLAM.

    fix(t) = x(t) + drift(t) + n,     known at t + latency + |jitter|

The drift (first-order Gauss-Markov, one for each axis and the heading) models a camera that tracks the same features:
successive fixes agree with each other and share an error. A filter that assumes independent fixes is overconfident,
and its innovations do not show this. Jitter changes the order of arrival; a share of the fixes is lost.

Source: Sec. 2.1.2 of the dissertation (down-looking camera, V-SLAM on the ground station, position sent back by radio).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.sensors.periodic import (
    NO_MEASUREMENT_DELAY_S,
    ROW_FIRST_VALUE_INDEX,
    ROW_IS_VALID_INDEX,
    PeriodicSensor,
    draw_stationary_gauss_markov,
    propagate_gauss_markov,
)
from mufly.sensors.readings import Truth
from mufly.sensors.rng import draw_normals, draw_uniforms
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import PositionFixParameters
from mufly.world import World

_Array = NDArray[np.float64]
# Indices of the parameters: dropout probability, jitter, latency, time constant of the drift (s), white noise (4)
_DROPOUT_PROBABILITY_INDEX, _LATENCY_JITTER_INDEX, _LATENCY_INDEX, _DRIFT_TIME_INDEX, _WHITE_NOISE_INDEX = range(5)


@cached_njit(error_model="numpy")
def _sample_position_fix(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[_Array, _Array, _Array],
    row: _Array,
) -> float:
    numbers, sigma, memory = parts
    share, late, n = np.empty(1), np.empty(1), np.empty(4)
    draw_uniforms(source, share)
    draw_normals(source, late)
    propagate_gauss_markov(t, sigma, numbers[_DRIFT_TIME_INDEX], memory, source)
    draw_normals(source, n)
    if share[0] < numbers[_DROPOUT_PROBABILITY_INDEX]:
        return NO_MEASUREMENT_DELAY_S
    row[ROW_IS_VALID_INDEX] = 1.0
    for k in range(4):
        true = x[k] if k < 3 else attitude[2]
        row[ROW_FIRST_VALUE_INDEX + k] = true + (memory[1 + k] + numbers[_WHITE_NOISE_INDEX + k] * n[k])
    return numbers[_LATENCY_INDEX] + abs(numbers[_LATENCY_JITTER_INDEX] * late[0])


class PositionFixSensor(PeriodicSensor):
    """Sensor of ``position_fix`` (4,): N, E, D (m) and heading (rad)."""

    published_readings = {"position_fix": slice(0, 4)}  # noqa: RUF012
    sample_function = _sample_position_fix
    argument_dimensions = (1, 1, 1)

    def __init__(self, table: PositionFixParameters, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        f = table
        jitter, latency = float(f.latency_jitter), float(f.latency)
        white = [*[float(f.noise)] * 3, float(f.heading_noise)]
        numbers = np.array([float(f.dropout_probability), jitter, latency, float(f.drift_correlation_time), *white])
        self._sigma = np.array([*[float(f.drift)] * 3, float(f.heading_drift)])
        self._memory = np.empty(5)
        parts = (numbers, self._sigma, self._memory)
        super().__init__(float(f.period), rng, parts, latency + 6.0 * jitter)

    def reset(self) -> None:
        super().reset()
        draw_stationary_gauss_markov(self._rng, self._sigma, self._memory)

    def error_free_readings(self, truth: Truth) -> dict[str, Any]:
        return {"position_fix": np.append(truth.position, truth.attitude[2])}
