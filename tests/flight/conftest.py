"""A made-up flight for the tests of recorder, pictures and summary: take-off, a square, landing.

Nothing is simulated: the track is the reference path through the waypoints, smoothed, and what else a recording
holds is invented around it, with known numbers where a test needs them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from mufly.logs import FlightEvent, RecordingLayout, make_flight_row_layout, rows_to_dataset

WAYPOINTS = ((-3.0, 0.0, -1.0), (-3.0, 3.0, -2.0), (0.0, 3.0, -1.0), (0.0, 0.0, -2.0))
STANDING_M = 0.07
WAIT_S = 2.5


@dataclass(frozen=True)
class Flight:
    rows: NDArray[np.float64]
    states: list[str]
    events: list[FlightEvent]
    layout: RecordingLayout
    waypoints: tuple[tuple[float, float, float], ...] = WAYPOINTS

    def dataset(self) -> xr.Dataset:
        return rows_to_dataset(self.rows, self.states, self.layout, events=self.events)


def blend(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """0 to 1 with vanishing first and second derivative at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def square(rate_hz: float = 50.0, seed: int = 0, lag_s: float = 0.25) -> Flight:
    """Take off to 1 m, fly the square of the thesis's Sec. 6.2.4, land."""
    layout = make_flight_row_layout(8)
    points = [(0.0, 0.0, -STANDING_M), (0.0, 0.0, -1.0), *WAYPOINTS, (0.0, 0.0, -STANDING_M)]
    legs: list[tuple[float, float, tuple[float, ...], tuple[float, ...], str]] = []
    events = [FlightEvent(0.0, "init", "on the ground")]
    now = 1.0
    for number, (a, b) in enumerate(pairwise(points)):
        name = "take-off" if number == 0 else "landing" if number == len(points) - 2 else "waypoint"
        duration = max(2.0, float(np.linalg.norm(np.subtract(b, a))) / 0.8)
        legs.append((now, now + duration, a, b, name))
        goal = "start" if number == 0 else "descend" if name == "landing" else f"to waypoint {number}"
        events.append(FlightEvent(now, name, goal))
        now += duration
        if name != "landing":
            text = "altitude reached" if number == 0 else f"waypoint {number} reached"
            events.append(FlightEvent(now + 2 * lag_s, "hover", text))
            now += WAIT_S + 2 * lag_s
    events.append(FlightEvent(now, "init", "landed"))
    time = np.arange(0.0, now + 1.0, 1.0 / rate_hz)

    def path(t: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.tile(np.array(points[0]), (len(t), 1))
        for start, stop, a, b, _ in legs:
            part = blend((t - start) / (stop - start))[:, None]
            out = np.where((t >= start)[:, None], np.array(a) + part * np.subtract(b, a), out)
        return out

    reference, truth = path(time), path(time - lag_s)
    velocity = np.gradient(truth, time, axis=0)
    acceleration = np.gradient(velocity, time, axis=0)
    rng = np.random.default_rng(seed)
    rows = np.zeros((len(time), layout.column_count))
    rows[:, 0] = time

    def put(name: str, values: object) -> None:
        block = np.asarray(values, dtype=float)
        rows[:, layout.column_slices[name]] = block[:, None] if block.ndim == 1 else block

    tilt = np.column_stack(
        (acceleration[:, 1] / 9.81, -acceleration[:, 0] / 9.81, np.zeros(len(time)))
    ) + 0.004 * rng.normal(size=(len(time), 3)).cumsum(axis=0) / np.sqrt(len(time))
    rates = np.gradient(tilt, time, axis=0)
    flying = blend(time / 1.0) - blend((time - now) / 0.8)
    speed = flying[:, None] * (np.array([399.0, 471.0]) - 18.0 * acceleration[:, 2:])
    current = flying * 2.6 + 0.2
    charge = 1.0 - np.concatenate(([0.0], np.cumsum(0.5 * (current[1:] + current[:-1]) * np.diff(time)))) / 1728.0
    put("truth_position", truth)
    put("truth_velocity", velocity)
    put("truth_attitude", tilt)
    put("truth_rates", rates)
    put("truth_rotor_speed", speed)
    put("wind", np.tile([0.0, 0.5, 0.0], (len(time), 1)))
    for name, true, noise in (
        ("position", truth, 0.005),
        ("velocity", velocity, 0.02),
        ("attitude", tilt, 0.003),
        ("rates", rates, 0.02),
    ):
        put(f"measured_{name}", true + noise * rng.normal(size=true.shape))
    put("reference_position", reference)
    put("reference_velocity", np.gradient(reference, time, axis=0))
    put("reference_attitude", np.roll(tilt, -3, axis=0))
    put("motor_input", flying[:, None] * (np.array([0.70, 0.78]) - 0.05 * acceleration[:, 2:]))
    put("servo_input", np.column_stack((2.0 * tilt[:, 1], 2.0 * tilt[:, 0])))
    put("battery_voltage", 8.3 - 0.25 * current - 0.9 * (1.0 - charge))
    put("battery_current", current)
    put("battery_charge", charge)
    put("range", np.minimum(1.5, 0.4 + np.abs(np.sin(time[:, None] / 3 + np.arange(8) * np.pi / 4))))
    states = ["init"] * len(time)
    for event in events:
        for k in range(int(np.searchsorted(time, event.time_s)), len(time)):
            states[k] = event.state
    return Flight(rows, states, events, layout)


@pytest.fixture(scope="session")
def flight() -> Flight:
    """The square at 50 rows a second."""
    return square()


@pytest.fixture(scope="session")
def short_flight() -> Flight:
    """Its first six seconds at 20 rows a second, for tests that go over every byte."""
    whole = square(rate_hz=20.0)
    early = [event for event in whole.events if event.time_s < 6.0]
    return Flight(whole.rows[:120], whole.states[:120], early, whole.layout)
