"""Magnetometer: the earth's field, its distortion by steel in walls and floor, and the field of the motors.

    m = R^T (B + d(x)) + h + k I + n

B has the strength and inclination of the vehicle file and points to the north of the room. d is a smooth random field
in space: a Gaussian process of a given length, approximated by random Fourier features, d_i = sigma sqrt(2 / K) sum_k
cos(w_k x + p_k), w_k normal with deviation 1 / L (Rahimi and Recht, NIPS 2007). h is the hard iron after calibration,
k I the field of the supply current. A hover current of 2 A at 5 uT/A turns the heading by tens of
degrees, so a magnetometer near motors needs calibration of this term."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import sine_cosine
from mufly.dynamics import body_to_ned_matrix
from mufly.dynamics.model_state import ATTITUDE_SLICE
from mufly.sensors.periodic import ROW_FIRST_VALUE_INDEX, ROW_IS_VALID_INDEX, PeriodicSensor
from mufly.sensors.readings import Truth
from mufly.sensors.rng import draw_normals
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import MagnetometerParameters
from mufly.world import World

_Array = NDArray[np.float64]
_FIELD_DISTORTION_WAVE_COUNT = 64
# Indices of the parameters: earth's field, hard iron, field of an ampere (3 each), strength of the distortion, noise
# (T)
_EARTH_FIELD_INDEX, _HARD_IRON_INDEX, _FIELD_PER_AMPERE_INDEX, _DISTORTION_STRENGTH_INDEX, _NOISE_INDEX = 0, 3, 6, 9, 10


@cached_njit(error_model="numpy", inline="always")
def _add_distortion(x: _Array, waves: _Array, shifts: _Array, strength: float, field: _Array) -> None:
    """Add the surroundings' magnetic field at a position to the earth's field (3,) in ``field``.

    ``shifts`` (n, 3, 2) are sines and cosines of the phase shifts, so that each wave needs one sine and cosine.
    """
    a = b = c = 0.0
    for k in range(waves.shape[0]):
        sine, cosine = sine_cosine(waves[k, 0] * x[0] + waves[k, 1] * x[1] + waves[k, 2] * x[2])
        a += cosine * shifts[k, 0, 1] - sine * shifts[k, 0, 0]
        b += cosine * shifts[k, 1, 1] - sine * shifts[k, 1, 0]
        c += cosine * shifts[k, 2, 1] - sine * shifts[k, 2, 0]
    field[0] += strength * a
    field[1] += strength * b
    field[2] += strength * c


@cached_njit(error_model="numpy")
def _sample_magnetic_field(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[_Array, _Array, _Array],
    row: _Array,
) -> float:
    numbers, waves, shifts = parts
    there, n, turn = np.empty(3), np.empty(3), body_to_ned_matrix(x[ATTITUDE_SLICE])
    for j in range(3):  # a slice assignment would compile the error message for unequal shapes: 2 s
        there[j] = numbers[_EARTH_FIELD_INDEX + j]
    _add_distortion(x, waves, shifts, numbers[_DISTORTION_STRENGTH_INDEX], there)
    draw_normals(source, n)
    row[ROW_IS_VALID_INDEX] = 1.0
    for j in range(3):
        felt = turn[0, j] * there[0] + turn[1, j] * there[1] + turn[2, j] * there[2]
        row[ROW_FIRST_VALUE_INDEX + j] = (
            felt
            + numbers[_HARD_IRON_INDEX + j]
            + numbers[_FIELD_PER_AMPERE_INDEX + j] * supply[1]
            + numbers[_NOISE_INDEX] * n[j]
        )
    return 0.0


class MagnetometerSensor(PeriodicSensor):
    """Sensor of ``magnetic_field`` (3,) in body axes (T)."""

    published_readings = {"magnetic_field": slice(0, 3)}  # noqa: RUF012
    sample_function = _sample_magnetic_field
    argument_dimensions = (1, 2, 3)

    def __init__(self, table: MagnetometerParameters, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        m = table
        self.earth_field_T = earth_field(float(m.field_strength), float(m.inclination))
        self._waves = rng.standard_normal((_FIELD_DISTORTION_WAVE_COUNT, 3)) / float(m.distortion_correlation_length)
        shifts = rng.uniform(0.0, 2 * math.pi, (_FIELD_DISTORTION_WAVE_COUNT, 3))
        self._wave_phases = np.array([[sine_cosine(p) for p in row] for row in shifts])
        self._strength = float(m.distortion) * math.sqrt(2.0 / _FIELD_DISTORTION_WAVE_COUNT)
        self.hard_iron = float(m.hard_iron) * rng.standard_normal(3)
        self.motor_field_per_ampere = float(m.field_per_current) * rng.standard_normal(3)
        numbers = [
            *self.earth_field_T,
            *self.hard_iron,
            *self.motor_field_per_ampere,
            self._strength,
            float(m.noise),
        ]
        super().__init__(float(m.period), rng, (np.array(numbers), self._waves, self._wave_phases))

    def error_free_readings(self, truth: Truth) -> dict[str, _Array]:
        return {"magnetic_field": body_to_ned_matrix(truth.state[ATTITUDE_SLICE]).T @ self.earth_field_T}


def earth_field(strength_T: float, inclination: float) -> _Array:
    """Return the earth's field (3,) (T, N-E-D) from its strength (T) and inclination below the horizon (rad)."""
    return strength_T * np.array([math.cos(inclination), 0.0, math.sin(inclination)])
