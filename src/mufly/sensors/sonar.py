"""Ultrasonic range finder below the fuselage (SRF10): distance to the nearest surface in its cone.

A pulse spreads in a cone, and the first echo from any surface counts. This surface may be the floor below, also when
the vehicle tilts by less than the half angle (the shortest path is the perpendicular). It may be the edge of a box that
enters the cone from the side: the reading then jumps before the vehicle is above the box. The pulse takes 2 l / c.

    reading = quantised(l + n),     no reading beyond l_max or without an echo;
    a share of the echoes is reflected by a second surface: their path is longer, at most doubled.

Rays sample the cone: one along z and rings of them at a third, two thirds and all of its half angle. The perpendicular
to the floor is added, since the rays miss its distance by at most l (1 - cos).

Source: Sec. 2.1.2 of the dissertation; own derivation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics import body_to_ned_matrix, standing_attitude, standing_height
from mufly.dynamics.model_state import ATTITUDE_SLICE
from mufly.sensors.periodic import ROW_FIRST_VALUE_INDEX, ROW_IS_VALID_INDEX, PeriodicSensor
from mufly.sensors.readings import Truth
from mufly.sensors.rng import draw_normals, draw_uniforms
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import SonarParameters
from mufly.world import World, compute_first_hit_distance

_Array = NDArray[np.float64]
SPEED_OF_SOUND_M_S = 343.2  # dry air of 20 degC
_GROUNDED_RANGE_MARGIN_SIGMAS = (
    3.0  # deviations that readings of a standing vehicle are above the distance of the floor
)
_CONE_RAY_RINGS = ((1 / 3, 6), (2 / 3, 12), (1.0, 18))  # share of the half angle, number of rays


@cached_njit(error_model="numpy")
def _nearest_distance_in_cone(
    x: _Array, place: _Array, rays: _Array, upright: float, boxes: _Array, cylinders: _Array, limits: _Array
) -> float:
    """Return the distance to the nearest surface in the cone (m); ``upright`` is the cosine of its half angle."""
    turn, here = body_to_ned_matrix(x[ATTITUDE_SLICE]), np.empty(3)
    for j in range(3):
        here[j] = x[j] + (turn[j, 0] * place[0] + turn[j, 1] * place[1] + turn[j, 2] * place[2])
    best = math.inf
    for k in range(rays.shape[0]):
        a, b, c = rays[k, 0], rays[k, 1], rays[k, 2]
        n = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c
        e = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c
        d = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c
        best = compute_first_hit_distance(here, n, e, d, best, boxes, cylinders, limits)
    if turn[2, 2] >= upright:  # the perpendicular lies in the cone
        best = compute_first_hit_distance(here, 0.0, 0.0, 1.0, best, boxes, cylinders, limits)
    return best


@cached_njit(error_model="numpy")
def _sample_echo(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    source: NDArray[np.uint64],
    parts: tuple[_Array, _Array, _Array, _Array, _Array, _Array],
    row: _Array,
) -> float:
    numbers, place, rays, boxes, cylinders, limits = parts
    noise, dropout, multipath, longest, least, step, upright = (
        numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5], numbers[6],
    )  # fmt: skip
    share, n = np.empty(2), np.empty(1)
    draw_uniforms(source, share)
    draw_normals(source, n)
    heard, doubled = share[0], share[1]
    way = _nearest_distance_in_cone(x, place, rays, upright, boxes, cylinders, limits)
    if doubled < multipath:
        draw_uniforms(source, share[:1])
        way *= 1.0 + share[0]
    wait = 2.0 * min(way, longest) / SPEED_OF_SOUND_M_S
    if heard < dropout or way > longest:
        row[ROW_IS_VALID_INDEX], row[ROW_FIRST_VALUE_INDEX] = 0.0, math.nan
        return wait
    told = max(way + noise * n[0], least)
    if step > 0.0:
        told = np.rint(told / step) * step
    row[ROW_IS_VALID_INDEX], row[ROW_FIRST_VALUE_INDEX] = 1.0, min(told, longest)
    return wait


class UltrasonicSensor(PeriodicSensor):
    """Sensor of ``ground_distance`` (m); not valid without an echo."""

    published_readings = {"ground_distance": 0}  # noqa: RUF012
    sample_function = _sample_echo
    argument_dimensions = (1, 1, 2, 2, 2, 1)

    def __init__(self, table: SonarParameters, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        s, half = table, 0.5 * float(table.cone_angle)
        longest = float(s.max_range)
        self._upright = math.cos(half)
        numbers = [
            float(q)
            for q in (s.noise, s.dropout_probability, s.multipath_probability, longest, s.min_range, s.resolution)
        ]
        parts = (
            np.array([*numbers, self._upright]),
            s.position.to_array()[0].copy(),
            cone_rays(half),
            *world.packed_tables,
        )
        super().__init__(float(s.period), rng, parts, 2.0 * longest / SPEED_OF_SOUND_M_S)

    def error_free_readings(self, truth: Truth) -> dict[str, float]:
        """Return the distance to the nearest surface in the cone (m); infinite if there is none."""
        _, place, rays, *world = self.sample_arguments
        return {"ground_distance": float(_nearest_distance_in_cone(truth.state, place, rays, self._upright, *world))}


def standing_sonar_range(vehicle: Vehicle) -> float:
    """Return the distance (m) from the sonar to the floor on which the vehicle stands; NaN without a sonar."""
    sonar = vehicle.sensors.sonar if vehicle.sensors is not None else None
    if sonar is None:
        return math.nan
    roll, pitch = standing_attitude(vehicle)
    down = (-math.sin(pitch), math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch))
    return standing_height(vehicle) - float(sonar.position.to_array()[0] @ down)


def max_standing_sonar_range(vehicle: Vehicle) -> float:
    """Return the greatest range (m) that the sonar may read while the vehicle stands on the floor.

    Rounding of the reading to the sonar's resolution is not included.

    A sonar low on the fuselage reads its least range on the floor. A higher one reads the floor's distance, with noise.
    """
    sonar = vehicle.sensors.sonar if vehicle.sensors is not None else None
    if sonar is None:
        return 0.0
    return max(
        float(sonar.min_range), standing_sonar_range(vehicle) + _GROUNDED_RANGE_MARGIN_SIGMAS * float(sonar.noise)
    )


def cone_rays(half_angle: float) -> _Array:
    """Return unit vectors (n, 3) that sample a cone around z, from its half angle (rad)."""
    rays = [[0.0, 0.0, 1.0]]
    for share, count in _CONE_RAY_RINGS:
        off = share * half_angle
        for k in range(count):
            around = 2 * math.pi * k / count
            rays.append([math.sin(off) * math.cos(around), math.sin(off) * math.sin(around), math.cos(off)])
    return np.array(rays)
