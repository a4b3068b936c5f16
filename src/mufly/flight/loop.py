"""The closed loop: the flight model and the flight software, each at its own rate, and the recorder beside them.

One period of the flight software at time ``t_k``::

    measurement(t_k) --> software.step --> actuators a_k          takes effect at t_(k+1)
    plant integrated from t_k to t_(k+1) under a_(k-1) and the wind

The delay of one period is that of a processor that needs the period to compute.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

import mufly
from mufly.control import FlightController, design
from mufly.dynamics import (
    DEFAULT_STEP_S,
    DrydenWind,
    advance,
    battery_state,
    initial_state,
    lowest_point,
    model_parameters,
    standing_height,
    trim,
)
from mufly.errors import MuflyError
from mufly.flight.layout import standard_layout
from mufly.flight.recorder import Recorder
from mufly.flight.software import Actuators, FlightSoftware
from mufly.mission import Command, Mission, check_mission, dump_mission, load_mission
from mufly.sensors import Measurement, beam_directions, ideal_measurement, ideal_ranges
from mufly.vehicle import Vehicle, load_vehicle, vehicle_toml
from mufly.world import distance

__all__ = ["Progress", "fly"]

RECORD_HZ = 100.0
RING_HZ = 25.0
PROGRESS_S = 0.1  # wall-clock time between two calls of on_progress
REST_S = 0.5  # recorded after the mission has ended
GUST_LENGTH_M = 1.0


@dataclass(frozen=True, slots=True)
class Progress:
    """What is happening, for a display. Times in s, position N, E, D in m."""

    time_s: float
    expected_s: float
    state: str
    position: NDArray[np.float64]
    battery_V: float
    battery_charge: float
    realtime_factor: float


def fly(
    vehicle: Vehicle | str | Path,
    mission: Mission | str | Path = "demonstration",
    *,
    controller: FlightController | None = None,
    wind: ArrayLike | None = None,
    gust: float | None = None,
    seed: int = 0,
    realtime: bool = False,
    path: str | Path | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> xr.Dataset:
    """Fly a mission on the full nonlinear model.

    Parameters
    ----------
    vehicle : Vehicle, str or Path
        Or the name or file of one.
    mission : Mission, str or Path
        Or the name or file of one.
    controller : FlightController, optional
        By default ``mufly.control.design(vehicle)``.
    wind : (3,) array_like, optional
        Steady wind N-E-D (m/s), instead of the mission's.
    gust : float, optional
        Standard deviation of the gusts (m/s), instead of the mission's.
    seed : int
        Seed of everything random (today: the gusts).
    realtime : bool
        Keep pace with the clock instead of flying as fast as the machine can.
    path : str or Path, optional
        MCAP file to record to, block by block as it flies; in memory only without it.
    on_progress : callable, optional
        Called with a :class:`Progress` about ten times a second.

    Returns
    -------
    xarray.Dataset
        The recording (docs/recordings.md). ``attrs["outcome"]`` is ``"succeeded"`` or ``"failed"``, with
        ``attrs["reason"]``.

    Raises
    ------
    MuflyError
        Before anything runs, if vehicle or mission is impossible. A flight that fails raises nothing.
    """
    if not isinstance(vehicle, Vehicle):
        vehicle = load_vehicle(vehicle)
    if not isinstance(mission, Mission):
        mission = load_mission(mission)
    hover = trim(vehicle, charge=0.5)
    estimate = check_mission(
        mission, hover_current_A=hover.current_A, capacity_Ah=float(vehicle.battery.capacity) / 3600.0
    )
    controller = design(vehicle) if controller is None else controller
    steady = np.asarray(mission.wind.steady_m_s if wind is None else wind, dtype=np.float64)
    gust = mission.wind.gust_m_s if gust is None else gust
    air = DrydenWind(steady, gust, step_s=1.0 / controller.rate_Hz, length_m=GUST_LENGTH_M, seed=seed)
    plant = _Plant(vehicle, mission, air, controller.rate_Hz)
    software = FlightSoftware(vehicle, controller, mission)
    recorder = Recorder(
        path,
        {
            "vehicle": vehicle.name,
            "mission": mission.name,
            "seed": seed,
            "wind_m_s": steady.tolist(),
            "gust_m_s": gust,
            "rate_Hz": controller.rate_Hz,
            "version": mufly.__version__,
        },
        layout=standard_layout(vehicle.range_ring.count),
        attachments={"vehicle.toml": vehicle_toml(vehicle), "mission.toml": dump_mission(mission)},
        scene_view={
            "world": mission.world,
            "waypoints": [w.position_m for w in mission.waypoint],
            "rotor_radius": float(vehicle.rotors.radius),
        },
    )
    time_limit = 3.0 * estimate.duration_s + 60.0 + len(mission.waypoint) * mission.avoidance.give_up_s
    with recorder:
        wall_s = _run(plant, software, recorder, estimate.duration_s, time_limit, realtime, on_progress)
        outcome, reason = _judge(software, plant)
        recorder.finish(outcome, reason, realtime_factor=plant.time_s / max(wall_s, 1e-9))
    return recorder.dataset()


def _run(
    plant: _Plant,
    software: FlightSoftware,
    recorder: Recorder,
    expected_s: float,
    time_limit: float,
    realtime: bool,
    on_progress: Callable[[Progress], None] | None,
) -> float:
    """Fly until the mission has ended, the vehicle has crashed or time is up; return the wall time (s)."""
    record = _rows(recorder, plant, software)
    every = max(1, round(plant.rate_Hz / RECORD_HZ))
    look = max(1, round(plant.rate_Hz / RING_HZ))
    began = shown = time.perf_counter()
    ended_at = math.inf
    command = Command(start=True)
    pending = Actuators.idle()
    k = events = 0
    while True:
        if k % look == 0:
            plant.look()
        measured = plant.measure()
        actuators = software.step(measured, command)
        command = Command()
        if k % every == 0:
            record(measured, pending)
            for event in software.events[events:]:
                recorder.event(event.time_s, event.state, event.text)
            events = len(software.events)
            now = time.perf_counter()
            if on_progress is not None and now - shown > PROGRESS_S:
                shown = now
                on_progress(plant.progress(software.state, expected_s, now - began))
            if realtime and plant.time_s > now - began:
                time.sleep(plant.time_s - (now - began))
        if ended_at == math.inf and (software.finished or plant.crashed or plant.time_s > time_limit):
            ended_at = plant.time_s
            if plant.crashed:
                recorder.event(plant.time_s, software.state, plant.crashed, level="error")
        if plant.time_s >= ended_at + REST_S:
            break
        plant.advance(pending)
        pending = actuators
        k += 1
    return time.perf_counter() - began


def _judge(software: FlightSoftware, plant: _Plant) -> tuple[str, str]:
    if plant.crashed:
        return "failed", plant.crashed
    if not software.finished:
        return "failed", f"the mission was not over after {plant.time_s:.0f} s (state: {software.state})"
    return software.outcome, software.reason


class _Plant:
    """The true helicopter in its world: state, wind and clock."""

    def __init__(self, vehicle: Vehicle, mission: Mission, air: DrydenWind, rate_Hz: float) -> None:
        self.rate_Hz = rate_Hz
        self.world = mission.world
        self.parameters = model_parameters(vehicle)
        self.state = initial_state(
            position=(*mission.start_m, -standing_height(vehicle)),
            attitude=(0.0, 0.0, math.radians(mission.start_heading_deg)),
        )
        self.ticks = 0
        self.wind = np.zeros(3)
        self.voltage, self.current = battery_state(self.state, 0.0, 0.0, self.parameters)
        self.crashed = ""
        self._air = _stream(air, max(1, round(rate_Hz)))
        self._steps = math.ceil(1.0 / rate_Hz / DEFAULT_STEP_S - 1e-9)
        self._step_s = 1.0 / rate_Hz / self._steps
        self._directions = beam_directions(vehicle)
        self._ring = vehicle.range_ring
        self._ranges = np.full(vehicle.range_ring.count, float(vehicle.range_ring.max_range))
        self._legs = len(vehicle.contact.legs.value)
        self._radius = float(vehicle.rotors.radius)
        self._yaw = math.radians(mission.start_heading_deg)

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
                f"the simulation became unstable at {self.time_s:.3f} s; the vehicle's fastest mode is too fast for "
                f"steps of {self._step_s * 1e3:g} ms (legs too stiff, or swash plate too quick?)"
            )

    def progress(self, state: str, expected_s: float, wall_s: float) -> Progress:
        return Progress(
            time_s=self.time_s,
            expected_s=expected_s,
            state=state,
            position=self.state[0:3].copy(),
            battery_V=float(self.voltage),
            battery_charge=float(self.state[20]),
            realtime_factor=self.time_s / max(wall_s, 1e-9),
        )


def _stream(air: DrydenWind, block: int) -> Iterator[NDArray[np.float64]]:
    while True:
        yield from air.block(block)


def _rows(
    recorder: Recorder, plant: _Plant, software: FlightSoftware
) -> Callable[[Measurement, Actuators], None]:
    """Return the function that writes one row: what is true, measured, wanted and done at this instant."""
    columns = recorder.layout.columns
    row = np.full(recorder.layout.width, np.nan)

    def part(name: str) -> NDArray[np.float64]:
        return row[columns[name]]

    truth = [part(f"truth_{name}") for name in ("position", "velocity", "attitude", "rates", "rotor_speed")]
    seen = [part(f"measured_{name}") for name in ("position", "velocity", "attitude", "rates")]
    wanted = [part(f"reference_{name}") for name in ("position", "velocity", "attitude")]
    wind, motor, servo, beams = part("wind"), part("motor_input"), part("servo_input"), part("range")
    voltage, current, charge = part("battery_voltage"), part("battery_current"), part("battery_charge")

    def record(m: Measurement, actuators: Actuators) -> None:
        x = plant.state
        row[0] = m.time_s
        for target, value in zip(
            truth, (x[0:3], x[3:6], m.attitude, x[10:13], x[18:20]), strict=True
        ):  # fmt: skip
            target[:] = value
        for target, value in zip(seen, (m.position, m.velocity, m.attitude, m.rates), strict=True):
            target[:] = value
        for target, value in zip(wanted, software.reference, strict=True):
            target[:] = value
        wind[:], motor[:], servo[:] = plant.wind, actuators.motor_input, actuators.servo_input
        voltage[:], current[:], charge[:] = plant.voltage, plant.current, x[20]
        beams[:] = m.ranges
        recorder.append(row, software.state)

    return record
