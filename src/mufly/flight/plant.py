"""The other side of the loop: the true helicopter, its air and its world."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.compiled import boxed, compiled
from mufly.control import FlightController, design
from mufly.dynamics import (
    DEFAULT_STEP_S,
    DrydenWind,
    advance,
    battery_state,
    euler_from_quaternion,
    fastest_part,
    longest_step,
    lowest_point,
    model_parameters,
    trim,
)
from mufly.errors import InputError, MuflyError
from mufly.estimate import IdealEstimator
from mufly.flight.recorder import Recorder
from mufly.flight.software import Actuators, Controllers
from mufly.sensors import Readings, Truth, ideal_sensors, nearest_turn
from mufly.vehicle import Vehicle
from mufly.world import World, distance

SHORTEST_STEP_S = 1e-5


@compiled(error_model="numpy")
def _period(x, u, wind, parameters, dt, steps, supply):  # type: ignore[no-untyped-def]
    """Advance the state by one period; write voltage and current of the battery at its end into ``supply`` (2,)."""
    p = parameters[0]
    advance(x, u, wind, p, dt, steps)
    supply[0], supply[1] = battery_state(x, u[0], u[1], p)


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
        self._box, self._supply = boxed(self.parameters), np.empty(2)
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
                f"flight; it is that of {fastest_part(self.parameters)}"
            )
        self._steps = math.ceil(1.0 / rate_Hz / longest - 1e-9)
        self._step_s = 1.0 / rate_Hz / self._steps
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

    def collide(self) -> None:
        """See whether anything was hit."""
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

    @property
    def truth(self) -> Truth:
        """All that there is to know of this instant; the state is copied."""
        attitude = euler_from_quaternion(self.state[6:10])
        self._yaw = attitude[2] = nearest_turn(float(attitude[2]), self._yaw)
        return Truth(
            self.time_s, self.ticks, self.state.copy(), attitude, self.wind, self.voltage, self.current
        )

    def advance(self, actuators: Actuators) -> None:
        """Advance by one period."""
        self.wind = next(self._air)
        _period(self.state, actuators.array, self.wind, self._box, self._step_s, self._steps, self._supply)
        self.voltage, self.current = self._supply.tolist()
        self.ticks += 1
        if not math.isfinite(self.state[2]):
            raise MuflyError(
                f"the simulation became unstable at {self.time_s:.3f} s with steps of {self._step_s * 1e3:g} ms; "
                "check the vehicle's parameters with `mufly vehicle check`"
            )


def _stream(air: DrydenWind, block: int) -> Iterator[NDArray[np.float64]]:
    while True:
        yield from air.block(block)


# ----------------------------------------------------------------------------
# One row of a recording: what is true, measured, wanted and done at one instant.


_Array = NDArray[np.float64]


def row_writer(
    recorder: Recorder, *, measured: bool = True
) -> Callable[[Truth, Readings, Actuators, tuple[_Array, _Array, _Array], str], None]:
    """Return the function that appends a row: ``write(truth, readings, actuators, reference, state)``.

    ``reference`` is position and velocity (N-E-D) and attitude; ``state`` the state of the mission. What the table
    of quantities holds beyond that stays NaN, and so does what no sensor reads, or all of it without ``measured``.
    """
    row, part = blank_row(recorder)
    fill = common_writer(part)
    seen = {name: part[f"measured_{name}"] for name in ("position", "velocity", "attitude", "rates")}
    seen["ranges"] = part["range"]
    if not measured:
        seen = {}

    def write(
        truth: Truth,
        readings: Readings,
        actuators: Actuators,
        reference: tuple[_Array, _Array, _Array],
        state: str,
    ) -> None:
        row[0] = truth.time_s
        fill(truth, actuators, reference)
        for name, target in seen.items():
            target[:] = readings[name].value if name in readings else math.nan
        recorder.append(row, state)

    return write


def blank_row(recorder: Recorder) -> tuple[_Array, dict[str, _Array]]:
    """A row of a recording where nothing is known yet, and its parts by the names of the quantities."""
    row = np.full(recorder.layout.width, np.nan)
    return row, {name: row[column] for name, column in recorder.layout.columns.items()}


def common_writer(
    part: Mapping[str, _Array],
) -> Callable[[Truth, Actuators, tuple[_Array, _Array, _Array]], None]:
    """Return what fills the part of a row that every flight has: truth, reference, actuators, battery."""
    position, velocity, attitude, rates, speed = (
        part[f"truth_{name}"] for name in ("position", "velocity", "attitude", "rates", "rotor_speed")
    )
    place, way, turned = (part[f"reference_{name}"] for name in ("position", "velocity", "attitude"))
    wind, motor, servo = part["wind"], part["motor_input"], part["servo_input"]
    charge, voltage, current = (part[f"battery_{name}"] for name in ("charge", "voltage", "current"))

    def fill(truth: Truth, actuators: Actuators, reference: tuple[_Array, _Array, _Array]) -> None:
        x = truth.state
        position[:], velocity[:], attitude[:], rates[:], speed[:] = (
            x[0:3],
            x[3:6],
            truth.attitude,
            x[10:13],
            x[18:20],
        )
        place[:], way[:], turned[:] = reference
        wind[:], motor[:], servo[:] = truth.wind, actuators.motor_input, actuators.servo_input
        charge[0], voltage[0], current[0] = x[20], truth.voltage, truth.current

    return fill


# ----------------------------------------------------------------------------
# Step responses: the controllers alone on the nonlinear model, without a mission (Figs 6.10 and 6.12).


START_HEIGHT_M = 5.0  # out of the floor's reach for any sensible step


@dataclass(frozen=True, slots=True)
class Demand:
    """What the low-level controllers have to follow: z (m, down, from the start), angles (rad)."""

    z: float = 0.0
    heading: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0


def respond(
    vehicle: Vehicle,
    demand: Callable[[float], Demand],
    *,
    duration_s: float,
    controller: FlightController | None = None,
    charge: float = 0.8,
    wind: DrydenWind | None = None,
) -> xr.Dataset:
    """Let the low-level controllers follow a reference on the full nonlinear model, from hover.

    Inputs saturate, the battery sags, and the actuators act one period after the measurement, as in flight.

    Parameters
    ----------
    vehicle : Vehicle
    demand : callable
        From time (s) to :class:`Demand`.
    duration_s : float
        (s).
    controller : FlightController, optional
        By default ``mufly.control.design(vehicle)``.
    charge : float
        Battery charge at the start (fraction).
    wind : DrydenWind, optional
        Sampled at the controller's rate; still air by default.

    Returns
    -------
    xarray.Dataset
        A recording in memory, a row every period; positions count from the start.

    Raises
    ------
    InputError
        If the duration is not positive.
    """
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise InputError("respond", "duration_s", f"{duration_s} s", "give a positive time")
    controller = design(vehicle) if controller is None else controller
    hover = trim(vehicle, charge=charge)
    start = hover.state.copy()
    start[2] = -START_HEIGHT_M
    air = DrydenWind(step_s=controller.period_s) if wind is None else wind
    plant = Plant(vehicle, World(), air, controller.rate_Hz, start)
    plant.voltage, plant.current = hover.voltage_V, hover.current_A
    controllers = Controllers(controller)
    recorder = Recorder(None, {"vehicle": vehicle.name, "rate_Hz": controller.rate_Hz})
    write = row_writer(recorder)
    sensors, estimator = ideal_sensors(vehicle, World(), round(controller.rate_Hz)), IdealEstimator()
    start_estimate = estimator.update(sensors.read(plant.truth))
    controllers.engage(start_estimate, hover.motor_input)
    controllers.lift_off(start_estimate)
    pending = Actuators(hover.motor_input, hover.servo_input)
    zero = np.zeros(3)
    for _ in range(round(duration_s * controller.rate_Hz) + 1):
        truth = plant.truth
        readings = sensors.read(truth)
        s = demand(truth.time_s)
        z = s.z - START_HEIGHT_M
        actuators = controllers.step(
            estimator.update(readings), np.array([z, s.heading, 0.0, 0.0]), np.array([s.roll, s.pitch])
        )
        wanted = np.array([0.0, 0.0, z]), zero, np.array([s.roll, s.pitch, s.heading])
        write(truth, readings, pending, wanted, "follow")
        plant.advance(pending)
        pending = actuators
    recorder.finish("succeeded")
    recorder.close()
    dataset = recorder.dataset()
    for name in ("truth_position", "measured_position", "reference_position"):
        dataset[name][:, 2] += START_HEIGHT_M
    return dataset
