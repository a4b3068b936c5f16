"""Safety of the flight software on a board, equal in C and Python: starts, arming, missed periods, resets."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from mufly.control import design_flight_controller
from mufly.estimate import KalmanEstimator
from mufly.firmware import FirmwareSoftware
from mufly.firmware.compiled_software import diff_fields
from mufly.flight import Flight
from mufly.flight.flight_software import FlightSoftware
from mufly.mission import NO_COMMAND, Command, load_mission
from mufly.vehicle import load_vehicle

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler: install gcc or clang"
)
AROUND = 24
"""Periods before and after the first valid estimate in which a start is asked for."""


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle):
    return design_flight_controller(vehicle)


@pytest.fixture(scope="module")
def aligning(vehicle, controller):
    """Estimates of a filter on the floor, from AROUND periods before the first valid one to as many after it."""
    found = []
    with Flight(vehicle, "demonstration", controller=controller, sensors="fitted", seed=2) as flight:
        assert isinstance(flight.estimator, KalmanEstimator)
        while len(found) < AROUND or not found[-AROUND].valid:
            flight.step_period()
            found.append(flight.estimate)
    return found[-2 * AROUND :]


def _both(vehicle, controller):
    mission = load_mission("demonstration")
    return FlightSoftware(vehicle, controller, mission), FirmwareSoftware(vehicle, controller, mission)


WAYS = {
    "start": Command(start=True),
    "take-off": Command(take_off_height=0.5),
    "sticks": Command(rc_active=True, climb_rate=0.3),
}


@pytest.mark.parametrize("way", WAYS)
def test_no_start_before_the_first_valid_estimate(vehicle, controller, aligning, way) -> None:
    first = next(k for k, m in enumerate(aligning) if m.valid)
    python, c = _both(vehicle, controller)
    started = []
    for asked in range(2 * AROUND - 4):
        python.reset()
        c.reset()
        # Sticks are repeated by their sender, a request is not.
        until = 2 * AROUND if way == "sticks" else asked + 1
        for k, m in enumerate(aligning):
            command = WAYS[way] if asked <= k < until else NO_COMMAND
            one, other = python.step(m, command), c.step(m, command)
            assert one.input_array.tobytes() == other.input_array.tobytes()
            assert m.valid or python.motors == c.motors == "off"
        s = python.mission_state
        assert diff_fields(s, c.mission_state) == []
        started.append(python.motors != "off")
        assert any("not valid" in e.text for e in s.events) == (not started[-1] or asked < first - 3)
        if started[-1]:
            assert abs(s.home_position[2] - float(aligning[-1].position[2])) < 0.01
    if way == "sticks":
        assert all(started)
    else:
        # A request in the four periods of a mission step is handled at the end of the step.
        assert started == [False] * sum(not one for one in started) + [True] * sum(started)
        assert first - 4 <= started.index(True) <= first


@pytest.mark.parametrize("name", ["position", "velocity", "attitude", "rates"])
def test_no_start_with_a_valid_estimate_that_lacks_a_quantity(vehicle, controller, aligning, name) -> None:
    python, c = _both(vehicle, controller)
    for k in range(12):
        m = replace(aligning[-12 + k], **{name: np.array([0.0, np.nan, 0.0])})
        assert m.valid
        for software in (python, c):
            software.step(m, Command(start=True) if k == 4 else NO_COMMAND)
            assert software.motors == "off"
    assert diff_fields(python.mission_state, c.mission_state) == []
    assert any("not valid" in e.text for e in python.mission_state.events)
