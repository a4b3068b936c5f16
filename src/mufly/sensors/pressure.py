"""The absolute pressure sensor, from which a height follows.

In a room the pressure falls by rho g h; weather and doors move it by far more than a metre's worth in minutes (a
first-order Gauss-Markov process), and near the rotors the port feels a share k of the disc loading T / A that the
downwash builds up. The sensor's own filter delays it:

    p = p_0 + rho g D + k T / A + wandering,     tau dy/dt = p - y,     reading = y + n

D counts down. A share of 0.05 in hover of 4 mN/cm2 already is two centimetres: a barometer alone holds no hover.
Own derivation; the sensor is that of Sec. 2.1.2 of the dissertation.
"""

from __future__ import annotations

import math

import numpy as np

from mufly.sensors.readings import Periodic, Reading, Truth, Wander
from mufly.units import GRAVITY
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import Pressure

STANDARD_PRESSURE_PA = 101_325.0


class PressureSensor(Periodic):
    """Reads ``pressure`` (Pa)."""

    def __init__(self, table: Pressure, vehicle: Vehicle, rng: np.random.Generator) -> None:
        p = table
        self._rng, self._noise, self._delay = rng, float(p.noise), float(p.delay)
        self._density, self._share = float(vehicle.air.density), float(p.downwash)
        radius = float(vehicle.rotors.radius)
        # T / A = rho c_T R^2 Omega^2 of each rotor, by the definition of c_T
        both = (vehicle.rotors.upper, vehicle.rotors.lower)
        self._loading = self._density * radius**2 * np.array([float(r.thrust_coefficient) for r in both])
        self._drift, self._drift_time = float(p.drift), float(p.drift_time)
        super().__init__(float(p.period))

    def reset(self) -> None:
        super().reset()
        self._wander = Wander(self._rng, self._drift, self._drift_time)
        self._felt = math.nan
        self._felt_s = 0.0

    def right(self, truth: Truth) -> dict[str, float]:
        return {"pressure": STANDARD_PRESSURE_PA + self._density * GRAVITY * float(truth.position[2])}

    def measure(self, truth: Truth) -> tuple[float, dict[str, Reading]]:
        t = truth.time_s
        true = (
            self.right(truth)["pressure"]
            + self._share * float(self._loading @ truth.rotor_speed**2)
            + float(self._wander.at(t)[0])
        )
        if math.isnan(self._felt) or self._delay == 0.0:
            self._felt = true
        else:
            self._felt += (true - self._felt) * (1.0 - math.exp(-(t - self._felt_s) / self._delay))
        self._felt_s = t
        return 0.0, {"pressure": Reading(self._felt + self._noise * self._rng.standard_normal(), t)}
