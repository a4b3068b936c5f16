"""The ultrasonic range finder below the fuselage (SRF10): how far the nearest thing in its cone is.

A pulse spreads in a cone and the first echo counts, whichever surface sends it: the floor below, also when the
vehicle tilts by less than half the cone (the shortest way to it is the perpendicular), or the edge of a box that
comes into the cone from the side. So stepping over an object is a jump, and comes early. The way there and back takes
2 l / c.

    reading = quantised(l + n),     nothing beyond l_max, nothing for a pulse that gets no echo,
    and a share of echoes came by a second surface: their way is longer by up to as much again.

What a cone sees is sampled by rays: one along z and rings of them at a third, two thirds and all of its half angle;
the perpendicular to the floor is added, as an exact one would miss it by l (1 - cos) at most.

Source: Sec. 2.1.2 of the dissertation; own derivation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import rotation
from mufly.sensors.readings import Periodic, Reading, Truth
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import Sonar
from mufly.world import World, ranges

_Array = NDArray[np.float64]
SPEED_OF_SOUND_M_S = 343.2  # dry air of 20 degC
_RINGS = ((1 / 3, 6), (2 / 3, 12), (1.0, 18))  # share of the half angle, rays


class UltrasonicSensor(Periodic):
    """Reads ``ground_distance`` (m); not valid without an echo."""

    def __init__(self, table: Sonar, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        self._sonar, self._world, self._rng = table, world, rng
        self._place = self._sonar.place.array()[0]
        self._half = 0.5 * float(self._sonar.cone)
        self._rays = cone_rays(self._half)
        super().__init__(float(self._sonar.period))

    def measure(self, truth: Truth) -> tuple[float, dict[str, Reading]] | None:
        s, rng = self._sonar, self._rng
        heard, doubled = rng.uniform(size=2)
        noise = float(s.noise) * rng.standard_normal()
        way = self.right(truth)["ground_distance"]
        if doubled < float(s.multipath):
            way *= 1.0 + rng.uniform()
        longest = float(s.max_range)
        wait = 2.0 * min(way, longest) / SPEED_OF_SOUND_M_S
        if heard < float(s.dropout) or way > longest:
            return wait, {"ground_distance": Reading(math.nan, truth.time_s, False)}
        told = max(way + noise, float(s.min_range))
        step = float(s.resolution)
        told = round(told / step) * step if step > 0.0 else told
        return wait, {"ground_distance": Reading(min(told, longest), truth.time_s)}

    def right(self, truth: Truth) -> dict[str, float]:
        """Distance to the nearest surface in the cone (m); infinite if there is none."""
        state = truth.state
        turn = rotation(state[6:10])
        here = state[0:3] + turn @ self._place
        rays = self._rays @ turn.T
        if turn[2, 2] >= math.cos(self._half):  # the perpendicular lies in the cone
            rays = np.vstack([rays, [0.0, 0.0, 1.0]])
        return {"ground_distance": float(ranges(self._world, here, rays).min())}


def cone_rays(half_angle: float) -> _Array:
    """Unit vectors (n, 3) that sample a cone around z with this half angle (rad)."""
    rays = [[0.0, 0.0, 1.0]]
    for share, count in _RINGS:
        off = share * half_angle
        for k in range(count):
            around = 2 * math.pi * k / count
            rays.append([math.sin(off) * math.cos(around), math.sin(off) * math.sin(around), math.cos(off)])
    return np.array(rays)
