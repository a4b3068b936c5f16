"""The closed loop: the flight model and the flight software, each at its own rate, and the recorder beside them.

One period of the flight software at time ``t_k``::

    measurement(t_k) --> software.step --> actuators a_k          takes effect at t_(k+1)
    plant integrated from t_k to t_(k+1) under a_(k-1) and the wind

The delay of one period is that of a processor that needs the period to compute.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mufly.control import FlightController, design
from mufly.dynamics import (
    DrydenWind,
    initial_state,
    standing_height,
)
from mufly.flight.controllers import Actuators
from mufly.flight.plant import Plant
from mufly.flight.recorder import Recorder
from mufly.flight.rows import row_writer
from mufly.flight.software import FlightSoftware
from mufly.logs.layout import Event, standard_layout
from mufly.mission import Command, Mission, dump_mission, load_mission, preflight
from mufly.vehicle import Vehicle, load_vehicle, vehicle_toml
from mufly.version import __version__

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
    on_event: Callable[[Event], None] | None = None,
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
    on_event : callable, optional
        Called with every :class:`Event`: changes of the mission's state, with the reason, and what went wrong.

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
    estimate = preflight(vehicle, mission)
    controller = design(vehicle) if controller is None else controller
    steady = np.asarray(mission.wind.steady_m_s if wind is None else wind, dtype=np.float64)
    gust = mission.wind.gust_m_s if gust is None else gust
    air = DrydenWind(steady, gust, step_s=1.0 / controller.rate_Hz, length_m=GUST_LENGTH_M, seed=seed)
    plant = Plant(vehicle, mission.world, air, controller.rate_Hz, _at_rest(vehicle, mission))
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
            "version": __version__,
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

        def report(event: Event) -> None:
            recorder.event(event.time_s, event.state, event.text, event.level)
            if on_event is not None:
                on_event(event)

        if software.slower:
            report(
                Event(0.0, "init", f"slower than asked, as the controllers can: {software.slower}", "warning")
            )
        wall_s = _run(
            plant, software, recorder, estimate.duration_s, time_limit, realtime, on_progress, report
        )
        outcome, reason = _judge(software, plant)
        recorder.finish(outcome, reason, realtime_factor=plant.time_s / max(wall_s, 1e-9))
    return recorder.dataset()


def _at_rest(vehicle: Vehicle, mission: Mission) -> NDArray[np.float64]:
    """State in which the mission begins: standing on the floor."""
    return initial_state(
        position=(*mission.start_m, -standing_height(vehicle)),
        attitude=(0.0, 0.0, math.radians(mission.start_heading_deg)),
    )


def _run(
    plant: Plant,
    software: FlightSoftware,
    recorder: Recorder,
    expected_s: float,
    time_limit: float,
    realtime: bool,
    on_progress: Callable[[Progress], None] | None,
    report: Callable[[Event], None],
) -> float:
    """Fly until the mission has ended, the vehicle has crashed or time is up; return the wall time (s)."""
    write = row_writer(recorder, plant)
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
            write(measured, pending, software.reference, software.state)
            for event in software.events[events:]:
                report(Event(event.time_s, event.state, event.text))
            events = len(software.events)
            now = time.perf_counter()
            if on_progress is not None and now - shown > PROGRESS_S:
                shown = now
                on_progress(_progress(plant, software.state, expected_s, now - began))
            if realtime and plant.time_s > now - began:
                time.sleep(plant.time_s - (now - began))
        if ended_at == math.inf and (software.finished or plant.crashed or plant.time_s > time_limit):
            ended_at = plant.time_s
            if plant.crashed:
                report(Event(plant.time_s, software.state, plant.crashed, "error"))
        if plant.time_s >= ended_at + REST_S:
            break
        plant.advance(pending)
        pending = actuators
        k += 1
    return time.perf_counter() - began


def _progress(plant: Plant, state: str, expected_s: float, wall_s: float) -> Progress:
    return Progress(
        time_s=plant.time_s,
        expected_s=expected_s,
        state=state,
        position=plant.state[0:3].copy(),
        battery_V=float(plant.voltage),
        battery_charge=float(plant.state[20]),
        realtime_factor=plant.time_s / max(wall_s, 1e-9),
    )


def _judge(software: FlightSoftware, plant: Plant) -> tuple[str, str]:
    if plant.crashed:
        return "failed", plant.crashed
    if not software.finished:
        return "failed", f"the mission was not over after {plant.time_s:.0f} s (state: {software.state})"
    return software.outcome, software.reason
