"""The magnetometer: the earth's field, what steel in walls and floor makes of it, and the motors' own.

    m = R^T (B + d(x)) + h + k I + n

B has the strength and inclination of the vehicle file and points to the north of the room. d is a smooth random field
in space (a Gaussian process of the given length, by random Fourier features: d_i = sigma sqrt(2 / K) sum_k cos(w_k x
+ p_k), w_k normal with deviation 1 / L; Rahimi and Recht, NIPS 2007). h is the hard iron that calibration left, k I
the field of the supply current in its wires. A hover current of 2 A at 5 uT/A turns the heading by tens of degrees:
that is why heading from a magnetometer near motors wants this calibrated."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import rotation
from mufly.sensors.readings import Periodic, Reading, Truth
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import Magnetometer

_Array = NDArray[np.float64]
_FEATURES = 64


class MagnetometerSensor(Periodic):
    """Reads ``magnetic_field`` (3,) in body axes (T)."""

    def __init__(self, table: Magnetometer, vehicle: Vehicle, rng: np.random.Generator) -> None:
        m = table
        self._rng, self._noise = rng, float(m.noise)
        self.earth = earth_field(float(m.field), float(m.inclination))
        self._waves = rng.standard_normal((_FEATURES, 3)) / float(m.distortion_length)
        self._shifts = rng.uniform(0.0, 2 * math.pi, (_FEATURES, 3))
        self._strength = float(m.distortion) * math.sqrt(2.0 / _FEATURES)
        self.hard_iron = float(m.hard_iron) * rng.standard_normal(3)
        self.per_ampere = float(m.motor_field) * rng.standard_normal(3)
        super().__init__(float(m.period))

    def distortion(self, position: _Array) -> _Array:
        """The field (T, N-E-D) that the surroundings add at a place."""
        return self._strength * np.cos((self._waves @ position)[:, None] + self._shifts).sum(axis=0)

    def right(self, truth: Truth) -> dict[str, _Array]:
        return {"magnetic_field": rotation(truth.state[6:10]).T @ self.earth}

    def measure(self, truth: Truth) -> tuple[float, dict[str, Reading]]:
        there = rotation(truth.state[6:10]).T @ (self.earth + self.distortion(truth.position))
        noise = self._noise * self._rng.standard_normal(3)
        return 0.0, {
            "magnetic_field": Reading(
                there + self.hard_iron + self.per_ampere * truth.current + noise, truth.time_s
            )
        }


def earth_field(strength_T: float, inclination: float) -> _Array:
    """Field in N-E-D (T), of a strength and an inclination below the horizon (rad)."""
    return strength_T * np.array([math.cos(inclination), 0.0, math.sin(inclination)])
