"""Readings as the onboard processor receives them, and ideal sensors, which sample the truth.

A sensor converts the :class:`Truth` of a simulation to :class:`Reading` objects. Their names are those of the table of
quantities ("position", "ranges", "battery_voltage", ...) or the sensor's own. All readings of one instant form the
:class:`Readings`, the input of an estimator (:mod:`mufly.estimate`). Sensor models with noise, delay and clipping can
replace ideal ones one by one: of two sensors with the same reading the later one counts.

The beams of the range ring (Fig. 6.18) turn and tilt with the fuselage: beam ``i`` of ``n`` points along
``alpha_i = alpha_0 + 2 pi i / n`` from x towards y, in the x-y plane of the body.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics import body_to_ned_matrix
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    BODY_RATE_SLICE,
    MODEL_CHARGE,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
    ROTOR_SPEED_SLICE,
)
from mufly.vehicle import Vehicle
from mufly.world import World, compute_first_hit_distance

_Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Truth:
    """True values of one instant, known in simulation only.

    Attributes
    ----------
    time_s : float
    tick : int
        Periods of the flight software since the start.
    state : (21,) array
        State of the flight model (:mod:`mufly.dynamics.model_state`); never changed in place.
    attitude : (3,) array
        Roll, pitch, yaw of the state (rad); yaw is continuous (it does not jump at +-pi).
    wind : (3,) array
        Velocity of the air, N-E-D (m/s).
    battery_voltage_V, battery_current_A : float
        Voltage and current of the battery (V, A).
    """

    time_s: float
    tick: int
    state: _Array
    attitude: _Array
    wind: _Array
    battery_voltage_V: float
    battery_current_A: float

    @property
    def position(self) -> _Array:
        """Position of the centre of gravity, N, E, D (m)."""
        return self.state[NED_POSITION_SLICE]

    @property
    def velocity(self) -> _Array:
        """Velocity, N, E, D (m/s)."""
        return self.state[NED_VELOCITY_SLICE]

    @property
    def rates(self) -> _Array:
        """Angular rates p, q, r (rad/s), body axes."""
        return self.state[BODY_RATE_SLICE]

    @property
    def rotor_speed(self) -> _Array:
        """Speeds of the upper and lower rotor (rad/s)."""
        return self.state[ROTOR_SPEED_SLICE]

    @property
    def battery_charge(self) -> float:
        """State of charge of the battery (0..1)."""
        return float(self.state[MODEL_CHARGE])


class Reading(NamedTuple):
    """Last published value of one sensor (SI units), its time of measurement (s) and its validity.

    ``covariance`` is that of the value's components, if the sensor published one.
    """

    value: Any
    time_s: float
    valid: bool = True
    covariance: _Array | None = None


@dataclass(frozen=True, slots=True)
class Readings:
    """Latest readings of all sensors at one instant.

    Attributes
    ----------
    time_s : float
        The processor's clock.
    latest : mapping
        Name to :class:`Reading`; without a new sample it is the same object as in the previous period.
    """

    time_s: float
    latest: Mapping[str, Reading]

    def __getitem__(self, name: str) -> Reading:
        return self.latest[name]

    def __contains__(self, name: str) -> bool:
        return name in self.latest


class Sensor:
    """One sensor, or several in one housing."""

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        """Return the readings at this instant, by name; called in every period of the flight software."""
        raise NotImplementedError

    @property
    def latest_readings(self) -> Mapping[str, Reading] | None:
        """Last readings by name; None for a sensor that :func:`mufly.sensors.sampling.sample_all` cannot sample."""
        return None

    def error_free_readings(self, truth: Truth) -> Mapping[str, Any]:
        """Return the readings without errors, by name."""
        raise NotImplementedError

    def reset(self) -> None:
        """Reset the sensor to the start of the simulation."""


class SensorSet:
    """All sensors of a vehicle."""

    def __init__(self, *sensors: Sensor) -> None:
        self.sensors = sensors

    def read(self, truth: Truth) -> Readings:
        """Read all sensors at the present instant; return their latest readings."""
        latest: dict[str, Reading] = {}
        for sensor in self.sensors:
            latest |= sensor.read(truth)
        return Readings(truth.time_s, latest)

    def gather_latest_readings(self, time_s: float) -> Readings:
        """Return the last readings after :func:`mufly.sensors.sampling.sample_all` has sampled up to a time (s)."""
        latest: dict[str, Reading] = {}
        for sensor in self.sensors:
            latest |= sensor.latest_readings or {}
        return Readings(time_s, latest)

    def reset(self) -> None:
        """Reset all sensors to the start of the simulation."""
        for sensor in self.sensors:
            sensor.reset()


# Ideal sensors


def make_ideal_sensors(vehicle: Vehicle, world: World, ring_every: int = 1) -> SensorSet:
    """Return ideal sensors for all inputs of the flight software; the range ring reads every ``ring_every`` periods."""
    return SensorSet(IdealMotionSensor(), IdealRangeRing(vehicle, world, ring_every), IdealBatterySensor())


class IdealMotionSensor(Sensor):
    """Ideal sensor of position, velocity, attitude and rates."""

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t, x = truth.time_s, truth.state
        return {
            "position": Reading(x[NED_POSITION_SLICE], t),
            "velocity": Reading(x[NED_VELOCITY_SLICE], t),
            "attitude": Reading(truth.attitude, t),
            "rates": Reading(x[BODY_RATE_SLICE], t),
        }


class IdealBatterySensor(Sensor):
    """Ideal sensor of the terminal voltage (V)."""

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        return {"battery_voltage": Reading(truth.battery_voltage_V, truth.time_s)}


class IdealRangeRing(Sensor):
    """Ideal sensor of the distances along the range ring's beams (m); its maximum range where there is no surface.

    ``ranges`` (n,) and ``clock`` (1,) are the last distances (m) and their time (s); a compiled loop writes to them.
    """

    def __init__(self, vehicle: Vehicle, world: World, every: int = 1) -> None:
        self._world, self.read_interval = world, every
        self._directions = beam_directions(vehicle)
        ring = vehicle.range_ring
        self._limits = {"min_range_m": float(ring.min_range), "max_range_m": float(ring.max_range)}
        self.ranges, self.clock = np.empty(ring.count), np.empty(1)
        self._reading: Reading | None = None
        self.reset()

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        if math.isnan(self.clock.item()) or truth.tick % self.read_interval == 0:
            measure_ranges(truth.state, *self.range_arguments, self.ranges)
            self.clock[0], self._reading = truth.time_s, None
        return self.latest_readings

    @property
    def latest_readings(self) -> Mapping[str, Reading]:
        last = self._reading
        if last is None or last.time_s != self.clock.item():
            last = self._reading = Reading(self.ranges.copy(), self.clock.item())
        return {"ranges": last}

    def reset(self) -> None:
        self.clock[0], self._reading = math.nan, None

    @property
    def range_arguments(self) -> tuple[Any, ...]:
        """Arguments of :func:`measure_ranges` from ``directions`` to ``limits``: beams, range limits and obstacles."""
        return self._directions, *self._limits.values(), *self._world.packed_tables


def beam_angles(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the direction of each beam of the range ring from x towards y (rad), shape (n,).

    Thesis: Fig. 6.18.
    """
    ring = vehicle.range_ring
    return float(ring.first_angle) + 2 * np.pi * np.arange(ring.count) / ring.count


def beam_directions(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the unit vectors of the beams in body axes, shape (n, 3)."""
    angle = beam_angles(vehicle)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])


@cached_njit(error_model="numpy")
def measure_ranges(
    x: _Array,
    directions: _Array,
    least: float,
    most: float,
    boxes: _Array,
    cylinders: _Array,
    limits: _Array,
    out: _Array,
) -> None:
    """Write the distances along beams (n, 3; body axes), clipped to ``least`` and ``most`` (m), to ``out`` (n,)."""
    turn = body_to_ned_matrix(x[ATTITUDE_SLICE])
    for k in range(directions.shape[0]):
        a, b, c = directions[k, 0], directions[k, 1], directions[k, 2]
        n = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c
        e = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c
        d = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c
        out[k] = max(compute_first_hit_distance(x, n, e, d, most, boxes, cylinders, limits), least)
