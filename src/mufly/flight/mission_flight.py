"""Flight of a whole mission on the simulated helicopter, as fast as possible or in real time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mufly.control import FlightController
from mufly.dynamics.model_state import MODEL_CHARGE, NED_POSITION_SLICE
from mufly.estimate import Estimate, Estimator
from mufly.flight.fixes.camera_sensor import CameraConfig
from mufly.flight.flight_software import ControlImplementation
from mufly.flight.record.live_view import LiveViewConfig
from mufly.flight.simulated_flight import Flight
from mufly.logs.mcap import FlightEvent
from mufly.mission import Mission, MissionEstimate, check_mission_for_vehicle, load_mission
from mufly.sensors import Fault, SensorSet, Truth
from mufly.vehicle import Vehicle, load_vehicle

ALIGNMENT_TIMEOUT_S = 15.0
"""Longest wait on the floor for a valid estimate (s)."""

PROGRESS_INTERVAL_S = 0.1  # wall-clock time between two calls of on_progress
RECORDED_AFTER_END_S = 0.5  # recorded after the mission has ended


@dataclass(frozen=True, slots=True)
class FlightProgress:
    """Progress of a flight, for a display; times in s, position N, E, D in m."""

    time_s: float
    expected_s: float
    state: str
    position: NDArray[np.float64]
    battery_V: float
    battery_charge: float
    realtime_factor: float


def fly_mission(
    vehicle: Vehicle | str | Path,
    mission: Mission | str | Path = "demonstration",
    *,
    controller: FlightController | None = None,
    wind: ArrayLike | None = None,
    gust: float | None = None,
    seed: int = 0,
    realtime: bool = False,
    path: str | Path | None = None,
    on_progress: Callable[[FlightProgress], None] | None = None,
    on_event: Callable[[FlightEvent], None] | None = None,
    sensors: SensorSet | Literal["ideal", "fitted"] = "ideal",
    estimator: Estimator | None = None,
    faults: Sequence[Fault] = (),
    controllers: ControlImplementation | None = None,
    designed_for: Vehicle | None = None,
    brief: bool = False,
    eye: CameraConfig | None = None,
    on_tick: Callable[[Truth, Estimate], None] | None = None,
    tick_every: int = 1,
    views: Sequence[LiveViewConfig] = (),
) -> xr.Dataset:
    """Fly a mission on the full nonlinear model.

    Parameters
    ----------
    vehicle : Vehicle, str or Path
        Vehicle, or its name or file.
    mission : Mission, str or Path
        Mission, or its name or file.
    controller, wind, gust, seed, path, sensors, estimator, faults, controllers, designed_for, brief, eye : optional
        See :class:`Flight`; without a path the recording is in memory only.
    realtime : bool
        Fly in real time instead of as fast as possible.
    on_progress : callable, optional
        Called with a :class:`FlightProgress` about ten times a second.
    on_event : callable, optional
        Called with every :class:`FlightEvent`: changes of the mission's state with their reasons, and faults.
    on_tick : callable, optional
        Called with truth and estimate after every ``tick_every``-th period.
    tick_every : int
        Number of periods between two calls of ``on_tick``.
    views : sequence of LiveViewConfig
        Live views.

    Returns
    -------
    xarray.Dataset
        The recording (docs/reference/recordings.md). ``attrs["outcome"]`` is ``"succeeded"`` or ``"failed"``, with
        ``attrs["reason"]``.

    Raises
    ------
    MuflyError
        If vehicle or mission is invalid, before the flight. A failed flight raises no error.
    """
    if not isinstance(vehicle, Vehicle):
        vehicle = load_vehicle(vehicle)
    if not isinstance(mission, Mission):
        mission = load_mission(mission)
    # The checks use the vehicle of the design; the flight shows whether the true vehicle can fly.
    check_mission_for_vehicle(vehicle if designed_for is None else designed_for, mission)
    with Flight(
        vehicle,
        mission,
        controller=controller,
        wind=wind,
        gust=gust,
        seed=seed,
        path=path,
        sensors=sensors,
        estimator=estimator,
        faults=faults,
        controllers=controllers,
        designed_for=designed_for,
        brief=brief,
        eye=eye,
    ) as flight:
        if on_event is not None:
            flight.autopilot.listeners.append(on_event)
        shown = [view.open_view(flight) for view in views]
        for line in filter(None, (flight.outside_model_note, flight.missing_sensors_note)):
            flight.log_event(line, "warning")
        slower = flight.autopilot.software.slowdown_note
        expected = check_mission_for_vehicle(
            vehicle if designed_for is None else designed_for, flight.autopilot.software.plan.mission
        )
        if slower:
            flight.log_event(f"limits reduced to those of the controllers: {slower}", "warning")
        wall_s = _run_flight(
            flight, expected, _time_limit(mission, expected), realtime, on_progress,
            None if on_tick is None else (on_tick, tick_every),
        )  # fmt: skip
        outcome, reason = _judge_mission(flight)
        for one in shown:
            one.close()
        flight.close(outcome, reason, realtime_factor=flight.time_s / max(wall_s, 1e-9))
    return flight.recorder.to_dataset()


def _time_limit(mission: Mission, expected: MissionEstimate) -> float:
    """Return the time limit of a flight (s); a longer flight counts as failed."""
    limit = 3.0 * expected.duration_s + 60.0 + len(mission.waypoint) * mission.avoidance.give_up_s
    # A mission that ends in a hover lasts until the battery is low.
    return limit + expected.duration_s / expected.charge_fraction if mission.at_end == "hover" else limit


def _run_flight(
    flight: Flight,
    expected: MissionEstimate,
    time_limit: float,
    realtime: bool,
    on_progress: Callable[[FlightProgress], None] | None,
    heard: tuple[Callable[[Truth, Estimate], None], int] | None,
) -> float:
    """Fly until the mission's end, a crash or the time limit; return the wall-clock time (s)."""
    software, plant = flight.autopilot.software, flight.plant
    began = shown = time.perf_counter()
    ended_at = math.inf
    if flight.uses_fitted_sensors:
        refused = await_estimate_and_start(flight)
        if refused:
            ended_at = flight.time_s
    else:
        # The preflight check covers the mission; the arming checks concern flights on sensors.
        flight.autopilot.arm(force=True, quiet=True)
        flight.autopilot.start_mission()
    if heard is not None:
        flight.listener, flight.listener_periods = heard
    while flight.time_s < ended_at + RECORDED_AFTER_END_S:
        end = min(time_limit, ended_at + RECORDED_AFTER_END_S)
        flight.advance_until(plant.period_count + 1 if realtime else math.floor(end * plant.rate_Hz))
        if flight.listener_periods and plant.period_count % flight.listener_periods == 0:
            flight.listener(flight.truth, flight.estimate)
        now = time.perf_counter()
        if on_progress is not None and now - shown > PROGRESS_INTERVAL_S:
            shown = now
            on_progress(_make_progress(flight, expected.duration_s, now - began))
        if realtime and flight.time_s > now - began:
            time.sleep(flight.time_s - (now - began))
        if ended_at == math.inf and (software.finished or plant.crash_cause or flight.time_s > time_limit):
            ended_at = flight.time_s
    return time.perf_counter() - began


def await_estimate_and_start(flight: Flight) -> str:
    """Wait on the floor for a valid estimate, arm and start the mission; return the reason of a failure, or ""."""
    autopilot, why = flight.autopilot, ["nothing is measured yet"]
    last = math.floor(ALIGNMENT_TIMEOUT_S * flight.plant.rate_Hz)
    while why and flight.time_s < ALIGNMENT_TIMEOUT_S:
        if flight.estimate.valid:
            flight.step_period()
        else:
            flight.advance_until(last, until_valid=True)  # arming needs a valid estimate
        if autopilot.software.is_mission_step_due:
            why = autopilot.list_arming_faults()
    answer = autopilot.arm(quiet=True)
    if answer:
        flight.log_event(f"estimate valid after {flight.time_s:.1f} s")
        answer = autopilot.start_mission()
    if answer:
        return ""
    flight.refusal_reason = f"the estimate was not ready within {ALIGNMENT_TIMEOUT_S:g} s: {answer.reason}"
    flight.log_event(flight.refusal_reason, "error")
    return flight.refusal_reason


def _make_progress(flight: Flight, expected_s: float, wall_s: float) -> FlightProgress:
    plant = flight.plant
    return FlightProgress(
        time_s=flight.time_s,
        expected_s=expected_s,
        state=str(flight.autopilot.software.mission_state.state),
        position=plant.state[NED_POSITION_SLICE].copy(),
        battery_V=float(plant.voltage),
        battery_charge=float(plant.state[MODEL_CHARGE]),
        realtime_factor=flight.time_s / max(wall_s, 1e-9),
    )


def _judge_mission(flight: Flight) -> tuple[str, str]:
    outcome, reason = flight.judge_outcome()
    if outcome == "unfinished":
        state = flight.autopilot.software.mission_state.state
        return "failed", f"the mission was not over after {flight.time_s:.0f} s (state: {state})"
    return outcome, reason
