"""Position and heading now and then, late, and with errors that stay for seconds: what visual SLAM gives.

    fix(t) = x(t) + wandering(t) + n,     known at t + latency + |jitter|

The wandering (first-order Gauss-Markov, one for each axis and the heading) is what a camera that tracks the same
features does: fixes agree with each other and are wrong together. A filter that takes them for independent thinks
itself better than it is, and its innovations do not show it. Jitter lets fixes overtake each other; a share never
comes.

Source: Sec. 2.1.2 of the dissertation (down-looking camera, V-SLAM on the ground station, position sent back by radio).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mufly.sensors.readings import Periodic, Reading, Truth, Wander
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import PositionFix


class PositionFixSensor(Periodic):
    """Reads ``position_fix`` (4,): N, E, D (m) and heading (rad)."""

    def __init__(self, table: PositionFix, vehicle: Vehicle, rng: np.random.Generator) -> None:
        f = table
        self._rng, self._fix = rng, f
        self._white = np.array([*[float(f.noise)] * 3, float(f.heading_noise)])
        super().__init__(float(f.period))

    def reset(self) -> None:
        super().reset()
        f = self._fix
        sigma = np.array([*[float(f.wander)] * 3, float(f.heading_wander)])
        self._wander = Wander(self._rng, sigma, float(f.wander_time), 4)

    def right(self, truth: Truth) -> dict[str, Any]:
        return {"position_fix": np.append(truth.position, truth.attitude[2])}

    def measure(self, truth: Truth) -> tuple[float, dict[str, Reading]] | None:
        rng, f = self._rng, self._fix
        lost, late = rng.uniform() < float(f.dropout), abs(float(f.jitter) * rng.standard_normal())
        error = self._wander.at(truth.time_s) + self._white * rng.standard_normal(4)
        if lost:
            return None
        told = self.right(truth)["position_fix"] + error
        return float(f.latency) + late, {"position_fix": Reading(told, truth.time_s)}
