"""The other side of the loop: the true helicopter, its air and its world."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import (
    DEFAULT_STEP_S,
    DrydenWind,
    advance,
    battery_state,
    euler_from_quaternion,
    longest_step,
    lowest_point,
    model_parameters,
)
from mufly.errors import MuflyError
from mufly.flight.controllers import Actuators
from mufly.sensors import Measurement, beam_directions, ideal_measurement, ideal_ranges
from mufly.vehicle import Vehicle
from mufly.world import World, distance

__all__ = ["Plant"]

SHORTEST_STEP_S = 1e-5


class Plant:
    """The true helicopter in its world: state, wind and clock.

    Parameters
    ----------
    vehicle : Vehicle
    world : World
    air : DrydenWind
        Sampled at ``rate_Hz``.
    rate_Hz : float
        Rate of the flight software: how often it is measured, and for how long actuators are held.
    state : (21,) array
        Where it starts.
    """

    def __init__(
        self, vehicle: Vehicle, world: World, air: DrydenWind, rate_Hz: float, state: NDArray[np.float64]
    ) -> None:
        self.rate_Hz = rate_Hz
        self.world = world
        self.parameters = model_parameters(vehicle)
        self.state = state.copy()
        self.ticks = 0
        self.wind = np.zeros(3)
        self.voltage, self.current = battery_state(self.state, 0.0, 0.0, self.parameters)
        self.crashed = ""
        self._air = _stream(air, max(1, round(rate_Hz)))
        longest = min(DEFAULT_STEP_S, longest_step(self.parameters))
        if longest < SHORTEST_STEP_S:
            raise MuflyError(
                f"{vehicle.name}: its fastest mode needs steps of {longest * 1e6:.2g} us, too short to simulate a "
                "flight; `mufly vehicle check` names the part (legs too stiff, or swash plate too quick?)"
            )
        self._steps = math.ceil(1.0 / rate_Hz / longest - 1e-9)
        self._step_s = 1.0 / rate_Hz / self._steps
        self._directions = beam_directions(vehicle)
        self._ring = vehicle.range_ring
        self._ranges = np.full(vehicle.range_ring.count, float(vehicle.range_ring.max_range))
        self._legs = len(vehicle.contact.legs.value)
        self._radius = float(vehicle.rotors.radius)
        self._yaw = float(euler_from_quaternion(state[6:10])[2])

    def reset(self, state: NDArray[np.float64]) -> None:
        """Put the helicopter somewhere else, whole and at rest, one period later; air and clock go on."""
        self.state[:] = state
        self.ticks += 1
        self.crashed = ""
        self.voltage, self.current = battery_state(self.state, 0.0, 0.0, self.parameters)
        self._yaw = float(euler_from_quaternion(state[6:10])[2])

    @property
    def time_s(self) -> float:
        return self.ticks / self.rate_Hz

    def look(self) -> None:
        """Read the ring of beams, and see whether anything was hit."""
        self._ranges = ideal_ranges(
            self.state,
            self.world,
            self._directions,
            min_range_m=float(self._ring.min_range),
            max_range_m=float(self._ring.max_range),
        )
        if self.crashed:
            return
        if not self.world.empty:
            away, name = distance(self.world, self.state[0:3])
            if away < self._radius:
                self.crashed = f"a rotor hit the {name} at {self._where()}"
        if self.state[2] + self.parameters["contact_reach"] > 0.0:
            depth, point = lowest_point(self.state, self.parameters)
            if depth > 0.0 and point >= self._legs:
                self.crashed = f"tipped over: a rotor touched the floor at {self._where()}"

    def _where(self) -> str:
        n, e, d = self.state[0:3]
        return f"[{n:.2f}, {e:.2f}, {d:.2f}] m, {self.time_s:.1f} s"

    def measure(self) -> Measurement:
        m = ideal_measurement(
            self.time_s, self.state, ranges=self._ranges, battery_voltage=self.voltage, last_yaw=self._yaw
        )
        self._yaw = float(m.attitude[2])
        return m

    def advance(self, actuators: Actuators) -> None:
        self.wind = next(self._air)
        u = actuators.array
        advance(self.state, u, self.wind, self.parameters, self._step_s, self._steps)
        self.voltage, self.current = battery_state(self.state, u[0], u[1], self.parameters)
        self.ticks += 1
        if not math.isfinite(self.state[2]):
            raise MuflyError(
                f"the simulation became unstable at {self.time_s:.3f} s with steps of {self._step_s * 1e3:g} ms; "
                "check the vehicle's parameters with `mufly vehicle check`"
            )


def _stream(air: DrydenWind, block: int) -> Iterator[NDArray[np.float64]]:
    while True:
        yield from air.block(block)
