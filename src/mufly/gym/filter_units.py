"""Vehicles with their own sensors and filter (units), for ``sensors="fitted"`` of the environments.

A unit is a vehicle with the sensors of its file and the filter of :mod:`mufly.estimate`, as in a flight. Before the
first episode, :func:`prepare_hover_starts` flies units with the flight software into hover and stores them at several
instants. An episode starts as a copy of a stored unit with new random numbers. The filter is therefore settled, and
biases, mounting errors and the wander of the position fix are those of a flight.

Units have no ring of range beams (:func:`remove_range_ring`): it costs as much as all other sensors, and the filter
uses it only with walls known in advance, which no task has. The distances that ``Obstacle`` observes are exact.

All arrays of a unit stand in one row of bytes, so that a start copies one row. Compiled code finds a unit by the
address of its arrays (:func:`mufly.compiled.numba_intrinsics.store_tuple`): one call steps all units, period by period
of the flight software, with the compiled functions of a flight (:mod:`mufly.firmware.quick.compiled_loop`) and the
filter in C.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import call_c_function, refer_at, store_tuple, tuple_size
from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import PARAMETER_DTYPE, STATE_SIZE
from mufly.dynamics.model_state import MODEL_ATTITUDE, MODEL_CHARGE, MODEL_POSITION, MODEL_RATES, MODEL_VELOCITY
from mufly.errors import ArgumentError, MuflyError
from mufly.estimate import KalmanEstimator
from mufly.estimate.filter.filter_records import (
    NOMINAL_ATTITUDE,
    NOMINAL_POSITION,
    NOMINAL_VELOCITY,
    READING_BATTERY,
    READING_STARTS,
)
from mufly.estimate.filter_backend import explain_numba_choice
from mufly.firmware import GenericFirmwareSoftware
from mufly.firmware.quick.compiled_flight import make_filter_arrays
from mufly.firmware.quick.compiled_loop import (
    LOOP_CLOCK_DTYPE,
    RECORD_OFFSETS_DTYPE,
    FilterArrays,
    LoopClock,
    PlantArrays,
    SensorArrays,
    SoftwareArrays,
    advance_plant,
    sample_sensors,
)
from mufly.flight.mission_flight import await_estimate_and_start
from mufly.flight.period_stages import CONTINUE_LOOP, LOOP_DONE, make_stage_loop
from mufly.flight.simulated_flight import Flight
from mufly.gym.fleet import MIN_START_CHARGE, Fleet
from mufly.gym.tasks import OBSTACLE_START_NORTH_M, OBSTACLE_TARGET_HEIGHT_M, TASK_OBSTACLE
from mufly.mission import Mission, State
from mufly.sensors import FittedSensors, Imu
from mufly.sensors.faults import FaultySensor
from mufly.sensors.rng import draw_uniforms
from mufly.sensors.sampling import SAMPLED_SENSORS, collect_sampling_arguments
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]
_Ints = NDArray[np.int64]
_Bytes = NDArray[np.uint8]

STARTS_PER_FLIGHT, START_INTERVAL_S = 4, 1.0
"""Instants of a flight in hover that episodes start from, and the time between them."""
HOVER_HEIGHT_RANGE_M = (0.7, 1.5)
"""Least and greatest height of these flights; those of Obstacle are at 1 m."""
_SETTLING_S, _FLIGHT_TIMEOUT_S = 3.0, 40.0
_MAX_DRAW_ATTEMPTS = 20
_NO_REASON_TEXTS = np.zeros(1, np.int64)  # nobody reads the reasons of a unit's sensor checks
_ARRAY_ALIGNMENT_BYTES = 64  # bytes, of every array
_VOLTAGE_READING_INDEX = READING_STARTS[READING_BATTERY]
_UNIFORM_INTEGER_RANGE, _UNIFORM_BIT_SHIFT, _SEED_STRIDE = 2.0**53, np.uint64(11), np.uint64(0x9E3779B97F4A7C15)


class UnitLoopArguments(NamedTuple):
    """Arrays of a unit (vehicle with sensors and filter) for the stages of
    :mod:`mufly.firmware.quick.compiled_loop`.
    """

    clock: LoopClock
    plant: PlantArrays
    software: SoftwareArrays  # no software runs; it has the room that the stages write to
    ranges: _Array
    sensors: SensorArrays
    filter: FilterArrays
    step_inputs: _Array  # (2, 4): inputs of the preceding step and of this one
    delay_periods: _Ints  # (1,): periods until the inputs of this step are sent


@dataclass(frozen=True, eq=False)
class HoverStarts:
    """Units (vehicles with sensors and filter) stored in hover, as starts of episodes.

    Attributes
    ----------
    packed_units : (s, bytes) array
        All arrays of each unit.
    template : UnitLoopArguments
        Arrays of one unit: their types, shapes and order are those of all.
    fleet : Fleet
        Parameters, states and inputs of the units; ``fleet.wind_series_index`` is the wind that each has flown in.
    period_s : float
        Period of the flight software.
    keep_alive : tuple
        Objects that own the memory of the filter's settings.
    """

    packed_units: _Bytes
    template: UnitLoopArguments
    fleet: Fleet
    period_s: float
    keep_alive: tuple[Any, ...]


# ----------------------------------------------------------------------------
# Compiled periods of many units


@cached_njit(error_model="numpy")
def _begin_period(p: UnitLoopArguments) -> int:
    return LOOP_DONE if p.clock.tick >= p.clock.stop_tick else CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _do_nothing(p: UnitLoopArguments) -> int:
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _step_filter(p: UnitLoopArguments) -> int:
    p.clock.is_estimate_valid = call_c_function(p.filter.addresses[0], p.filter.addresses[1:]) & 1
    p.clock.filter_periods_run += 1
    return CONTINUE_LOOP


@cached_njit(error_model="numpy")
def _send_command(p: UnitLoopArguments) -> int:
    """Set the actuator inputs: those of the present action once its delay has passed, else those of the preceding one.

    Return ``CONTINUE_LOOP``.
    """
    row = 1 if p.clock.tick - p.clock.start_tick >= p.delay_periods[0] else 0
    for i in range(4):
        p.plant.acting_inputs[2, i] = p.step_inputs[row, i]
    return CONTINUE_LOOP


_step_unit = cached_njit(
    make_stage_loop(
        _begin_period, advance_plant, _do_nothing, sample_sensors, _step_filter, _send_command, _do_nothing, _do_nothing
    ),
    inline="always", error_model="numpy",
)  # fmt: skip


@cached_njit(error_model="numpy")
def _read_unit_states(p: UnitLoopArguments, state: _Array, estimate: _Array) -> float:
    """Write true and estimated state (21,) of a unit; return the measured voltage (V), NaN without a reading."""
    f = p.filter
    for i in range(state.size):
        state[i] = p.plant.state[i]
    for i in range(3):
        estimate[MODEL_POSITION + i], estimate[MODEL_VELOCITY + i] = (
            f.state[NOMINAL_POSITION + i],
            f.state[NOMINAL_VELOCITY + i],
        )
        estimate[MODEL_RATES + i] = f.rates[i]
    for i in range(4):
        estimate[MODEL_ATTITUDE + i] = f.state[NOMINAL_ATTITUDE + i]
    volts = f.values[_VOLTAGE_READING_INDEX]
    return volts if volts > 0.0 else math.nan


@cached_njit(error_model="numpy", nogil=True)
def _step_units(
    addresses: _Ints, like: UnitLoopArguments, before: _Array, inputs: _Array, delay: _Ints, wind: _Array, periods: int,
    state: _Array, estimate: _Array, volts: _Array,
) -> None:  # fmt: skip
    """Advance the units at ``addresses`` (n,) by some periods or none; write their states, estimates and voltages.

    ``before`` and ``inputs`` (n, 4) are the actuator inputs before and after the ``delay`` (n,); ``like`` is any unit.
    """
    for k in range(addresses.size):
        p = refer_at(addresses[k], like)
        c = p.clock
        if periods > 0:
            c.stage, c.start_tick, c.stop_tick, c.wind_samples = 0, c.tick, c.tick + periods, 0
            for j in range(periods):
                for i in range(3):
                    p.plant.wind[j, i] = wind[k, i]
            for i in range(4):
                p.step_inputs[0, i], p.step_inputs[1, i] = before[k, i], inputs[k, i]
            p.delay_periods[0] = delay[k]
            _send_command(p)
            _step_unit(p)
        volts[k] = _read_unit_states(p, state[k], estimate[k])


@cached_njit(error_model="numpy")
def _store_unit(p: UnitLoopArguments, address: int) -> None:
    store_tuple(p, address)


@cached_njit(error_model="numpy")
def _measure_tuple_size(p: UnitLoopArguments) -> int:
    return tuple_size(p)


@cached_njit(error_model="numpy", nogil=True)
def _reseed_sensors(source: NDArray[np.uint64], sources: NDArray[np.uint64]) -> None:
    """Reseed the random generators of a unit's sensors from the random generator of its environment."""
    r = np.empty(2)
    for k in range(sources.size):
        draw_uniforms(source, r)
        sources[k] = (np.uint64(r[0] * _UNIFORM_INTEGER_RANGE) << _UNIFORM_BIT_SHIFT) ^ (
            np.uint64(r[1] * _UNIFORM_INTEGER_RANGE) * _SEED_STRIDE
        )


# ----------------------------------------------------------------------------
# Rows of bytes


def _list_arrays(parts: Any) -> Iterator[NDArray[Any]]:
    """Yield the arrays and records of a tuple of tuples, in order."""
    if isinstance(parts, tuple):
        for part in parts:
            yield from _list_arrays(part)
    elif isinstance(parts, (np.ndarray, np.record)):
        yield np.asarray(parts) if isinstance(parts, np.ndarray) else np.ndarray((1,), parts.dtype, parts.data)


class UnitMemoryLayout:
    """Positions of all arrays of a unit in one row of bytes."""

    def __init__(self, like: UnitLoopArguments, memory: NDArray[np.void], filtered: KalmanEstimator) -> None:
        self._like, self._filter = like, filtered
        self._shapes = [(a.shape, a.dtype) for a in self._list_unit_arrays(like, memory)]
        sizes = [math.prod(shape) * kind.itemsize for shape, kind in self._shapes]
        self._starts = np.concatenate(
            [[0], np.cumsum([-(-n // _ARRAY_ALIGNMENT_BYTES) * _ARRAY_ALIGNMENT_BYTES for n in sizes])]
        ).astype(int)
        self.size = int(self._starts[-1])
        self.sources = [k for k, (_, kind) in enumerate(self._shapes) if kind == np.uint64]

    @staticmethod
    def _list_unit_arrays(p: UnitLoopArguments, memory: NDArray[np.void]) -> list[NDArray[Any]]:
        """Return the arrays of a unit in the order of their row: memory of the filter, its readings, then all
        others.
        """
        f = p.filter
        rest = (p.clock, p.plant, p.software, p.ranges, p.sensors, p.step_inputs, p.delay_periods)
        return [memory, f.values, f.is_new, f.age, f.reading_times, f.ring_scans, *_list_arrays(rest)]

    def row_views(self, row: _Bytes) -> list[NDArray[Any]]:
        """Return the arrays in a row."""
        return [
            np.ndarray(shape, kind, row.data, int(start))
            for (shape, kind), start in zip(self._shapes, self._starts[:-1], strict=True)
        ]

    def write_row(self, p: UnitLoopArguments, memory: NDArray[np.void], row: _Bytes) -> None:
        """Copy all arrays of a unit into a row.

        Raises
        ------
        MuflyError
            If its arrays have other sizes.
        """
        given = self._list_unit_arrays(p, memory)
        if [(a.shape, a.dtype) for a in given] != self._shapes:
            raise MuflyError(
                "the drawn vehicles need records of different sizes; do not vary delays or numbers of beams"
            )
        for to, of in zip(self.row_views(row), given, strict=True):
            to[...] = of

    def unit_from_row(self, row: _Bytes) -> UnitLoopArguments:
        """Return a unit whose arrays are views of a memory row."""
        memory, values, is_new, age, times, scans, *rest = self.row_views(row)
        found = iter(rest)

        def replace_arrays(parts: Any) -> Any:
            if isinstance(parts, tuple):
                inside = [replace_arrays(part) for part in parts]
                return type(parts)(*inside) if hasattr(parts, "_fields") else tuple(inside)
            if isinstance(parts, np.ndarray):
                return next(found)
            return next(found).view(np.recarray)[0] if isinstance(parts, np.record) else parts

        like = self._like
        clock, plant, software, ranges, sensors, command, delay = (
            replace_arrays(part)
            for part in (
                like.clock,
                like.plant,
                like.software,
                like.ranges,
                like.sensors,
                like.step_inputs,
                like.delay_periods,
            )
        )
        own = make_filter_arrays(self._filter, _NO_REASON_TEXTS, (memory, values, is_new, age, times, scans))
        return UnitLoopArguments(clock, plant, software, ranges, sensors, own, command, delay)


# ----------------------------------------------------------------------------
# Flights into hover


def remove_range_ring(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle without the sensor of the range beams."""
    if vehicle.sensors is None:
        return vehicle
    return vehicle.model_copy(update={"sensors": vehicle.sensors.model_copy(update={"ring_camera": None})})


def make_hover_mission(kind: int, height_m: float, heading_deg: float) -> Mission:
    """Return a mission that takes off to ``height_m`` (m) and hovers where the task with index ``kind`` starts."""
    north = OBSTACLE_START_NORTH_M if kind == TASK_OBSTACLE else 0.0
    return Mission.model_validate({
        "name": "hover", "start_m": [north, 0.0], "start_heading_deg": heading_deg,
        "take_off": {"height_m": height_m, "wait_s": 0.0}, "at_end": "hover", "avoidance": {"enabled": False},
        "waypoint": [{"position_m": [north, 0.0, -height_m], "heading_deg": heading_deg}],
    })  # fmt: skip


def extract_unit_arrays(flight: Flight, steps_per_period: int) -> tuple[UnitLoopArguments, NDArray[np.void]]:
    """Return the arrays of a simulated flight in the form of a unit, and the memory of its filter."""
    plant, filtered, sensors = flight.plant, flight.estimator, flight.sensors
    assert isinstance(filtered, KalmanEstimator)
    assert isinstance(sensors, FittedSensors)
    inside = [one.sensor for one in sensors.sensors if isinstance(one, FaultySensor)]
    imu = next(one for one in inside if isinstance(one, Imu))
    sampled: dict[int, Any] = {k: one for k, kind in enumerate(SAMPLED_SENSORS) for one in inside if type(one) is kind}
    quiet, has_come, readings, of_sensors = collect_sampling_arguments(sampled)
    for k, one in sampled.items():
        quiet[k] = one.next_sample_s
    clock = np.zeros(1, LOOP_CLOCK_DTYPE).view(np.recarray)[0]
    clock.tick, clock.rate_Hz, clock.step_s = plant.period_count, plant.rate_Hz, plant.step_s
    clock.steps_per_period, clock.beam_count = plant.step_count, len(filtered.ranges)
    clock.next_python_sample_s, clock.next_sample_s = math.inf, -math.inf
    acting = np.zeros((3, 4))
    acting[:] = [a.input_array for a in (flight.acting_actuators, flight.acting_actuators, flight.sent_actuators)]
    legs, _, obstacles, *tables = plant.collision_shape
    room = np.zeros(max(len(filtered.ranges), 1))
    software = SoftwareArrays(
        room, np.zeros(1, np.int32), np.zeros(1, np.uint8), room, np.zeros(1, np.int32), np.zeros(1, np.uint8),
        np.zeros(4), np.zeros(1, RECORD_OFFSETS_DTYPE).view(np.recarray)[0], (0,),
    )  # fmt: skip
    on_plant = PlantArrays(
        plant.state, plant.packed_parameters, plant.attitude, plant.battery_output, np.zeros((steps_per_period, 3)),
        acting, legs, obstacles, *tables,
    )  # fmt: skip
    unit = UnitLoopArguments(
        clock, on_plant, software, filtered.ranges,
        SensorArrays(imu.sampling_arguments(flight.period_s), quiet, has_come, readings, of_sensors),
        make_filter_arrays(filtered, _NO_REASON_TEXTS),
        np.zeros((2, 4)), np.zeros(1, np.int64),
    )  # fmt: skip
    return unit, filtered.memory_array


def fly_to_hover(
    vehicle: Vehicle, believed: Vehicle, controller: FlightController, mission: Mission, wind: _Array, charge: float,
    seed: int,
) -> Flight | None:  # fmt: skip
    """Return a simulated flight that holds its position in hover; None if the vehicle does not reach hover."""
    flight = Flight(
        vehicle, mission, controller=controller, wind=wind, gust=0.0, seed=seed, keep=False, sensors="fitted",
        controllers=GenericFirmwareSoftware, designed_for=believed, brief=True,
    )  # fmt: skip
    flight.plant.state[MODEL_CHARGE] = charge
    if await_estimate_and_start(flight):
        return None
    while flight.time_s < _FLIGHT_TIMEOUT_S and not flight.plant.crash_cause:
        if flight.autopilot.software.state == State.HOVER:
            _advance_flight(flight, _SETTLING_S)
            return flight
        flight.advance_until(flight.plant.period_count + round(0.1 * flight.plant.rate_Hz))
    return None


def _advance_flight(flight: Flight, time_s: float) -> None:
    until = flight.plant.period_count + round(time_s * flight.plant.rate_Hz)
    while flight.plant.period_count < until:
        flight.advance_until(until)


def prepare_hover_starts(
    nominal: Vehicle, fleet: Fleet, kind: int, winds: _Array, period_s: float, count: int, seed: int
) -> tuple[HoverStarts, UnitMemoryLayout]:
    """Fly the vehicles of a fleet into hover, and return their units, each stored at several instants.

    Controllers and filter are designed for the nominal vehicle. Each flight has a sensor error, a heading, a battery
    charge and a steady wind of its own.

    Parameters
    ----------
    nominal : Vehicle
    fleet : Fleet
    kind : int
        Index of the task.
    winds : (w, samples, 3) array
        Winds of the episodes (m/s).
    period_s : float
        Time of a step of the environments.
    count : int
        Number of flights.
    seed : int

    Raises
    ------
    ArgumentError
        If the vehicle has no sensors, or a step is no whole number of periods of the flight software.
    MuflyError
        If there is no C compiler, or nearly no flight reaches hover.
    """
    if nominal.sensors is None or nominal.sensors.imu is None:
        raise ArgumentError("sensors", "", f"{nominal.name} has no sensors.imu", "use 'ideal' sensors")
    if why := explain_numba_choice(nominal):
        raise MuflyError(f"sensors='fitted' needs the filter in C, but {why}; use 'noisy' sensors")
    nominal, controller = remove_range_ring(nominal), design_flight_controller(nominal)
    periods = round(period_s * controller.rate_Hz)
    if periods < 1 or abs(periods / controller.rate_Hz - period_s) > 1e-9:
        whole = 1e3 / controller.rate_Hz
        raise ArgumentError("period_s", "", f"{period_s} s", f"give a multiple of {whole:g} ms, the filter's period")
    rng = np.random.default_rng([seed, 2])
    rows: list[_Bytes] = []
    parts: list[tuple[Any, _Array, _Array, int, Vehicle]] = []
    room: UnitMemoryLayout | None = None
    like: UnitLoopArguments | None = None
    kept: Any = None
    flights, attempts_left = 0, _MAX_DRAW_ATTEMPTS + 2 * count
    while flights < count:
        if (attempts_left := attempts_left - 1) < 0:
            raise MuflyError(f"only {flights} of {count} vehicles reach hover on their sensors; vary less")
        vehicle = remove_range_ring(fleet.vehicles[flights % len(fleet.vehicles)])
        height = OBSTACLE_TARGET_HEIGHT_M if kind == TASK_OBSTACLE else float(rng.uniform(*HOVER_HEIGHT_RANGE_M))
        mission = make_hover_mission(kind, height, float(rng.uniform(-180.0, 180.0)))
        charge = MIN_START_CHARGE + (1.0 - MIN_START_CHARGE) * float(rng.random())
        wind = winds[flights % len(winds)].mean(axis=0)
        flight = fly_to_hover(vehicle, nominal, controller, mission, wind, charge, int(rng.integers(2**31)))
        if flight is None:
            continue
        for k in range(STARTS_PER_FLIGHT):
            unit, memory = extract_unit_arrays(flight, periods)
            if room is None:
                room, like, kept = UnitMemoryLayout(unit, memory, cast(KalmanEstimator, flight.estimator)), unit, flight
            row = np.zeros(room.size, np.uint8)
            room.write_row(unit, memory, row)
            rows.append(row)
            inputs = np.array(flight.acting_actuators.input_array, dtype=np.float64)
            parts.append((flight.plant.parameters, flight.plant.state.copy(), inputs, flights % len(winds), vehicle))
            if k + 1 < STARTS_PER_FLIGHT:
                _advance_flight(flight, START_INTERVAL_S)
        flights += 1
    assert room is not None
    assert like is not None
    records, states, acting, wind_indices, vehicles = zip(*parts, strict=True)
    parameters = np.zeros(len(parts), PARAMETER_DTYPE)
    for k, record in enumerate(records):
        parameters[k] = record
    of_units = Fleet(
        parameters, np.array(states), np.array(acting), fleet.nominal_hover_inputs,
        fleet.nominal_voltage_V, vehicles, np.array(wind_indices, dtype=np.int64),
    )  # fmt: skip
    return HoverStarts(np.array(rows), like, of_units, 1.0 / controller.rate_Hz, (kept,)), room


class FilteredVehicles:
    """Vehicles with sensors and filter (units), one for each environment of a vector.

    Parameters
    ----------
    starts : HoverStarts
    room : UnitMemoryLayout
    count : int
        Number of environments.
    periods : int
        Periods of the flight software in a step.
    threads : int
        Cores that step the units.

    Attributes
    ----------
    estimate : (n, 21) array
        Estimates in the layout of the flight model's state; bar, rotor speeds and charge are 0.
    volts : (n,) array
        Measured voltage (V).
    """

    def __init__(self, starts: HoverStarts, room: UnitMemoryLayout, count: int, periods: int, threads: int) -> None:
        self._starts, self._periods = starts, periods
        self._rows = np.zeros((count, room.size), np.uint8)
        self._rows[:] = starts.packed_units[0]
        self._units = [room.unit_from_row(row) for row in self._rows]
        self._sources = [[room.row_views(row)[k] for k in room.sources] for row in self._rows]
        size = _measure_tuple_size(self._units[0])
        self._stored = np.zeros((count, -(-size // _ARRAY_ALIGNMENT_BYTES) * _ARRAY_ALIGNMENT_BYTES), np.uint8)
        self._addresses = self._stored.ctypes.data + self._stored.shape[1] * np.arange(count, dtype=np.int64)
        for unit, address in zip(self._units, self._addresses.tolist(), strict=True):
            _store_unit(unit, address)
        self.estimate, self.volts = np.zeros((count, STATE_SIZE)), np.full(count, math.nan)
        cuts = np.linspace(0, count, min(threads, count) + 1).astype(int)
        self._parts = [slice(a, b) for a, b in pairwise(cuts)]
        self._pool = ThreadPoolExecutor(len(self._parts)) if len(self._parts) > 1 else None

    def start_units(self, e: Any, which: NDArray[np.bool_]) -> None:
        """Copy stored units of indices ``e.vehicle_index`` (n,) into the environments that ``which`` selects."""
        for k in np.flatnonzero(which).tolist():
            self._rows[k] = self._starts.packed_units[e.vehicle_index[k]]
            fresh = np.empty(len(self._sources[k]), np.uint64)
            _reseed_sensors(e.random_source[k : k + 1], fresh)
            for own, value in zip(self._sources[k], fresh, strict=True):
                own[:] = value
        self._step(e, 0)

    def advance_units(self, e: Any) -> None:
        """Advance all units by one step of the environments, and write ``e.state`` (n, 21)."""
        self._step(e, self._periods)

    def _step(self, e: Any, periods: int) -> None:
        def step_batch_part(part: slice) -> None:
            _step_units(
                self._addresses[part], self._starts.template, e.previous_inputs[part], e.inputs[part],
                e.delay_steps[part], e.wind_velocity[part], periods, e.state[part], self.estimate[part],
                self.volts[part],
            )  # fmt: skip

        run: Callable[[Callable[[slice], None], Sequence[slice]], Any] = map if self._pool is None else self._pool.map
        list(run(step_batch_part, self._parts))
