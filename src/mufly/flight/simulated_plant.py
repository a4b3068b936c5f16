"""Simulated helicopter in its air and world: time steps, collisions, rows of a recording, step responses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit, view_record_as_array
from mufly.compiled.portable_math import portable_atan2
from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import (
    DEFAULT_STEP_S,
    DrydenWind,
    compute_battery_supply,
    find_deepest_contact,
    find_longest_stable_step,
    find_step_limiting_parameter,
    find_trim,
    integrate_state,
    model_parameters,
)
from mufly.dynamics.model_state import (
    BODY_RATE_SLICE,
    MODEL_ATTITUDE,
    MODEL_CHARGE,
    MODEL_POSITION,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
    ROTOR_SPEED_SLICE,
    U_MOTOR_LOWER,
    U_MOTOR_UPPER,
)
from mufly.errors import InputError, MuflyError
from mufly.estimate import IdealEstimator
from mufly.flight.controllers import Actuators, Controllers
from mufly.flight.record.recorder import FlightRecorder
from mufly.sensors import Readings, Truth, make_ideal_sensors
from mufly.vehicle import Vehicle
from mufly.world import World, compute_packed_obstacle_distances, find_nearest_obstacle

MIN_INTEGRATION_STEP_S = 1e-5
COLLISION_CAUSE_TEXT, TIP_OVER_CAUSE_TEXT = "a rotor hit the", "tipped over"
"""First words of the cause of a crash: collision with an obstacle, and tip-over."""
_WIND_BLOCK_S = 20.0  # duration of wind drawn at once (s); no effect on the wind


@cached_njit(error_model="numpy")
def advance_period(x: _Array, u: _Array, wind: _Array, parameters: Any, dt: float, steps: int, supply: _Array) -> None:
    """Advance the state by one period; write the battery's final voltage (V) and current (A) into ``supply`` (2,)."""
    p = parameters[0]
    integrate_state(x, u, wind, p, dt, steps)
    supply[0], supply[1] = compute_battery_supply(x, u[U_MOTOR_UPPER], u[U_MOTOR_LOWER], p)


@cached_njit(error_model="numpy")
def write_true_attitude(x: _Array, attitude: _Array) -> None:
    """Write roll, pitch, yaw (rad) of a state into ``attitude`` (3,); yaw continues from its value there.

    :mod:`mufly.compiled.portable_math` gives equal results on every processor.
    """
    w, i, j, k = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    sine = min(max(2.0 * (w * j - k * i), -1.0), 1.0)
    yaw = portable_atan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k))
    attitude[0] = portable_atan2(2.0 * (w * i + j * k), 1.0 - 2.0 * (i * i + j * j))
    attitude[1] = portable_atan2(sine, math.sqrt((1.0 - sine) * (1.0 + sine)))
    attitude[2] = yaw + 2.0 * math.pi * np.rint((attitude[2] - yaw) / (2.0 * math.pi))


@cached_njit(error_model="numpy")
def classify_collision(
    x: _Array,
    parameters: Any,
    legs: int,
    radius: float,
    obstacles: bool,
    boxes: _Array,
    cylinders: _Array,
    limits: _Array,
) -> int:
    """Return the kind of a collision: 0 none, 1 with an obstacle, 2 of a rotor with the floor."""
    p = parameters[0]
    if (
        obstacles
        and compute_packed_obstacle_distances(x[NED_POSITION_SLICE].reshape(1, 3), boxes, cylinders, limits)[0][0]
        < radius
    ):
        return 1
    if x[MODEL_POSITION + 2] + p.contact_reach > 0.0:
        depth, point = find_deepest_contact(x, p)
        if depth > 0.0 and point >= legs:
            return 2
    return 0


class SimulatedPlant:
    """The true helicopter in its world: state, wind and clock.

    Parameters
    ----------
    vehicle : Vehicle
    world : World
    air : DrydenWind
        Wind, sampled at ``rate_Hz``.
    rate_Hz : float
        Rate of the flight software, of measurements and of actuator updates (Hz).
    state : (21,) array
        Initial state.
    """

    def __init__(
        self, vehicle: Vehicle, world: World, air: DrydenWind, rate_Hz: float, state: NDArray[np.float64]
    ) -> None:
        self.rate_Hz = rate_Hz
        self.world = world
        self.parameters = model_parameters(vehicle)
        self.packed_parameters, self.battery_output = view_record_as_array(self.parameters), np.empty(2)
        self.state = state.copy()
        self.period_count = 0
        self.wind = np.zeros(3)
        self.voltage, self.current = compute_battery_supply(self.state, 0.0, 0.0, self.parameters)
        self.crash_cause = ""
        self._air, self._block = air, max(1, round(_WIND_BLOCK_S * rate_Hz))
        self._coming, self._blown = air.draw_wind_samples(self._block), 0
        longest = min(DEFAULT_STEP_S, find_longest_stable_step(self.parameters))
        if longest < MIN_INTEGRATION_STEP_S:
            raise MuflyError(
                f"{vehicle.name}: the fastest mode ({find_step_limiting_parameter(self.parameters)}) needs steps of "
                f"{longest * 1e6:.2g} us, too short to simulate a flight"
            )
        self.step_count = math.ceil(1.0 / rate_Hz / longest - 1e-9)
        self.step_s = 1.0 / rate_Hz / self.step_count
        self.collision_shape = (
            len(vehicle.contact.legs.value),
            float(vehicle.rotors.radius),
            not world.is_empty,
            *world.packed_tables,
        )
        self.attitude = np.zeros(3)
        write_true_attitude(self.state, self.attitude)

    def reset(self, state: NDArray[np.float64]) -> None:
        """Replace the state, discard a crash and advance the clock by one period; the wind continues."""
        self.state[:] = state
        self.period_count += 1
        self.crash_cause = ""
        self.voltage, self.current = compute_battery_supply(self.state, 0.0, 0.0, self.parameters)
        self.attitude[:] = 0.0
        write_true_attitude(self.state, self.attitude)

    @property
    def time_s(self) -> float:
        return self.period_count / self.rate_Hz

    def detect_collision(self) -> None:
        """Detect a collision and store its cause."""
        if self.crash_cause:
            return
        hit = classify_collision(self.state, self.packed_parameters, *self.collision_shape)
        if hit == 1:
            _, name = find_nearest_obstacle(self.world, self.state[NED_POSITION_SLICE])
            self.crash_cause = f"{COLLISION_CAUSE_TEXT} {name} at {self._describe_position()}"
        elif hit == 2:
            self.crash_cause = f"{TIP_OVER_CAUSE_TEXT}: a rotor touched the floor at {self._describe_position()}"

    def _describe_position(self) -> str:
        n, e, d = self.state[NED_POSITION_SLICE]
        return f"[{n:.2f}, {e:.2f}, {d:.2f}] m, {self.time_s:.1f} s"

    @property
    def truth(self) -> Truth:
        """Truth at this instant, with a copy of the state."""
        write_true_attitude(self.state, self.attitude)
        return Truth(
            self.time_s,
            self.period_count,
            self.state.copy(),
            self.attitude.copy(),
            self.wind,
            self.voltage,
            self.current,
        )

    def advance_period(self, actuators: Actuators) -> None:
        """Advance the true helicopter by one control period."""
        self.advance_wind(self.upcoming_wind(1)[0], 1)
        advance_period(
            self.state,
            actuators.input_array,
            self.wind,
            self.packed_parameters,
            self.step_s,
            self.step_count,
            self.battery_output,
        )
        self.advance_clock(1)

    def upcoming_wind(self, most: int) -> NDArray[np.float64]:
        """Return the wind of the next n periods (n, 3; m/s).

        n is at least 1 and at most ``most``; the wind is drawn in blocks, and n ends with the present block.
        """
        if self._blown == self._block:
            self._coming, self._blown = self._air.draw_wind_samples(self._block), 0
        return self._coming[self._blown : self._blown + most]

    def advance_wind(self, wind: NDArray[np.float64], periods: int) -> None:
        """Advance the wind by some periods; ``wind`` (3,) is that of the last period (m/s)."""
        self.wind = wind
        self._blown += periods

    def advance_clock(self, periods: int) -> None:
        """Advance the clock by some periods, for which the state is already integrated; store battery voltage and
        current.
        """
        self.voltage, self.current = self.battery_output.tolist()
        self.period_count += periods
        if not math.isfinite(self.state[MODEL_POSITION + 2]):
            raise MuflyError(
                f"the simulation became unstable at {self.time_s:.3f} s with steps of {self.step_s * 1e3:g} ms; "
                "check the vehicle's parameters with `mufly vehicle check`"
            )


# ----------------------------------------------------------------------------
# Rows of a recording: truth, readings, references and inputs at one instant.


_Array = NDArray[np.float64]


def make_row_writer(
    recorder: FlightRecorder, *, measured: bool = True
) -> Callable[[Truth, Readings, Actuators, tuple[_Array, _Array, _Array], str], None]:
    """Return the function that appends a row: ``write(truth, readings, actuators, reference, state)``.

    ``reference`` is position and velocity (N-E-D) and attitude; ``state`` is the state of the mission. All other
    columns are NaN. Quantities without a reading are NaN, too; without ``measured`` this holds for all readings.
    """
    row, part = make_blank_row(recorder)
    fill = make_common_writer(part)
    seen = {name: part[f"measured_{name}"] for name in ("position", "velocity", "attitude", "rates")}
    seen["ranges"] = part["range"]
    if not measured:
        seen = {}

    def write_row(
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
        recorder.append_row(row, state)

    return write_row


def append_rows(
    recorder: FlightRecorder,
    truth: Truth,
    measured: Mapping[str, _Array],
    actuators: Actuators,
    reference: tuple[_Array, _Array, _Array],
    states: list[str],
) -> None:
    """Append many rows, with the columns of :func:`make_row_writer`.

    All arrays are (n, ...); ``measured`` holds readings by column name.
    """
    rows = np.full((len(states), recorder.layout.column_count), np.nan)
    part = {name: rows[:, column] for name, column in recorder.layout.column_slices.items()}
    rows[:, 0] = truth.time_s
    make_common_writer(part)(truth, actuators, reference)
    for name, value in measured.items():
        part[name][:] = value
    recorder.append_rows(rows, states)


def make_blank_row(recorder: FlightRecorder) -> tuple[_Array, dict[str, _Array]]:
    """Return a row of NaN, and views of its parts by the names of the quantities."""
    row = np.full(recorder.layout.column_count, np.nan)
    return row, {name: row[column] for name, column in recorder.layout.column_slices.items()}


def make_common_writer(
    part: Mapping[str, _Array],
) -> Callable[[Truth, Actuators, tuple[_Array, _Array, _Array]], None]:
    """Return a function that writes truth, references, actuators and battery into one or many rows."""
    position, velocity, attitude, rates, speed = (
        part[f"truth_{name}"] for name in ("position", "velocity", "attitude", "rates", "rotor_speed")
    )
    place, way, turned = (part[f"reference_{name}"] for name in ("position", "velocity", "attitude"))
    wind, motor, servo = part["wind"], part["motor_input"], part["servo_input"]
    charge, voltage, current = (part[f"battery_{name}"] for name in ("charge", "voltage", "current"))

    def fill_row(truth: Truth, actuators: Actuators, reference: tuple[_Array, _Array, _Array]) -> None:
        x = truth.state
        position[:], velocity[:], attitude[:], rates[:], speed[:] = (
            x[..., NED_POSITION_SLICE],
            x[..., NED_VELOCITY_SLICE],
            truth.attitude,
            x[..., BODY_RATE_SLICE],
            x[..., ROTOR_SPEED_SLICE],
        )
        place[:], way[:], turned[:] = reference
        wind[:], motor[:], servo[:] = truth.wind, actuators.motor_input, actuators.servo_input
        charge[..., 0], voltage[..., 0] = x[..., MODEL_CHARGE], truth.battery_voltage_V
        current[..., 0] = truth.battery_current_A

    return fill_row


# ----------------------------------------------------------------------------
# Step responses of the low-level controllers on the nonlinear model (Figs 6.10 and 6.12).


STEP_RESPONSE_HEIGHT_M = 5.0  # out of ground effect for any sensible step


@dataclass(frozen=True, slots=True)
class ControllerReference:
    """References of the low-level controllers: z (m, down, from the start), angles (rad)."""

    down_m: float = 0.0
    heading: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0


def simulate_controller_response(
    vehicle: Vehicle,
    demand: Callable[[float], ControllerReference],
    *,
    duration_s: float,
    controller: FlightController | None = None,
    charge: float = 0.8,
) -> xr.Dataset:
    """Simulate the low-level controllers on a reference, on the full nonlinear model, from hover in still air.

    Inputs saturate, the battery voltage drops, and inputs act one period after the measurement, as in flight.

    Parameters
    ----------
    vehicle : Vehicle
    demand : callable
        Function from time (s) to :class:`ControllerReference`.
    duration_s : float
        Duration (s).
    controller : FlightController, optional
        Control design; default ``mufly.control.design_flight_controller(vehicle)``.
    charge : float
        Battery charge at the start (fraction).

    Returns
    -------
    xarray.Dataset
        A recording in memory, with a row every period; positions count from the start.

    Raises
    ------
    InputError
        If the duration is not positive.
    """
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise InputError("respond", "duration_s", f"{duration_s} s", "give a positive time")
    controller = design_flight_controller(vehicle) if controller is None else controller
    hover = find_trim(vehicle, charge=charge)
    start = hover.state.copy()
    start[2] = -STEP_RESPONSE_HEIGHT_M
    plant = SimulatedPlant(vehicle, World(), DrydenWind(step_s=controller.period_s), controller.rate_Hz, start)
    plant.voltage, plant.current = hover.battery_voltage_V, hover.battery_current_A
    controllers = Controllers(controller)
    recorder = FlightRecorder(None, {"vehicle": vehicle.name, "rate_Hz": controller.rate_Hz})
    write = make_row_writer(recorder)
    sensors, estimator = make_ideal_sensors(vehicle, World(), round(controller.rate_Hz)), IdealEstimator()
    start_estimate = estimator.update(sensors.read(plant.truth))
    controllers.engage_heave_yaw(start_estimate, hover.motor_input)
    controllers.engage_roll_pitch(start_estimate)
    pending = Actuators(hover.motor_input, hover.servo_input)
    zero = np.zeros(3)
    for _ in range(round(duration_s * controller.rate_Hz) + 1):
        truth = plant.truth
        readings = sensors.read(truth)
        s = demand(truth.time_s)
        z = s.down_m - STEP_RESPONSE_HEIGHT_M
        actuators = controllers.step(
            estimator.update(readings), np.array([z, s.heading, 0.0, 0.0]), np.array([s.roll, s.pitch])
        )
        wanted = np.array([0.0, 0.0, z]), zero, np.array([s.roll, s.pitch, s.heading])
        write(truth, readings, pending, wanted, "follow")
        plant.advance_period(pending)
        pending = actuators
    recorder.set_outcome("succeeded")
    recorder.close()
    dataset = recorder.to_dataset()
    for name in ("truth_position", "measured_position", "reference_position"):
        dataset[name][:, 2] += STEP_RESPONSE_HEIGHT_M
    return dataset
