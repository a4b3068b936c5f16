"""A mission flown to its end: a :class:`mufly.flight.Flight` that is armed, started and ticked until it is over."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mufly.control import FlightController
from mufly.flight.flight import Flight
from mufly.logs.layout import Event
from mufly.mission import Estimate, Mission, load_mission, preflight
from mufly.vehicle import Vehicle, load_vehicle

__all__ = ["Progress", "fly"]

PROGRESS_S = 0.1  # wall-clock time between two calls of on_progress
REST_S = 0.5  # recorded after the mission has ended


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
    with Flight(
        vehicle, mission, controller=controller, wind=wind, gust=gust, seed=seed, path=path
    ) as flight:
        if on_event is not None:
            flight.autopilot.listeners.append(on_event)
        slower = flight.autopilot.software.slower
        if slower:
            flight.note(f"slower than asked, as the controllers can: {slower}", "warning")
        wall_s = _run(flight, estimate, _time_limit(mission, estimate), realtime, on_progress)
        outcome, reason = _judge(flight)
        flight.close(outcome, reason, realtime_factor=flight.time_s / max(wall_s, 1e-9))
    return flight.recorder.dataset()


def _time_limit(mission: Mission, estimate: Estimate) -> float:
    """When a flight is taken to be stuck (s)."""
    limit = 3.0 * estimate.duration_s + 60.0 + len(mission.waypoint) * mission.avoidance.give_up_s
    # One that holds at the end does so until its battery is low.
    return limit + estimate.duration_s / estimate.fraction if mission.at_end == "hover" else limit


def _run(
    flight: Flight,
    estimate: Estimate,
    time_limit: float,
    realtime: bool,
    on_progress: Callable[[Progress], None] | None,
) -> float:
    """Fly until the mission has ended, the vehicle has crashed or time is up; return the wall time (s)."""
    # The mission was checked as a whole (preflight); whether to arm is a question for a real one.
    flight.autopilot.arm(force=True, quiet=True)
    flight.autopilot.start_mission()
    software, plant = flight.autopilot.software, flight.plant
    began = shown = time.perf_counter()
    ended_at = math.inf
    while flight.time_s < ended_at + REST_S:
        flight.tick()
        now = time.perf_counter()
        if on_progress is not None and now - shown > PROGRESS_S:
            shown = now
            on_progress(_progress(flight, estimate.duration_s, now - began))
        if realtime and flight.time_s > now - began:
            time.sleep(flight.time_s - (now - began))
        if ended_at == math.inf and (software.finished or plant.crashed or flight.time_s > time_limit):
            ended_at = flight.time_s
    return time.perf_counter() - began


def _progress(flight: Flight, expected_s: float, wall_s: float) -> Progress:
    plant = flight.plant
    return Progress(
        time_s=flight.time_s,
        expected_s=expected_s,
        state=flight.autopilot.software.state,
        position=plant.state[0:3].copy(),
        battery_V=float(plant.voltage),
        battery_charge=float(plant.state[20]),
        realtime_factor=flight.time_s / max(wall_s, 1e-9),
    )


def _judge(flight: Flight) -> tuple[str, str]:
    outcome, reason = flight.judge()
    if outcome == "unfinished":
        state = flight.autopilot.software.state
        return "failed", f"the mission was not over after {flight.time_s:.0f} s (state: {state})"
    return outcome, reason
