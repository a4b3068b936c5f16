"""Bad messages to a helicopter in flight: the short form of `benchmarks/fuzz_link.py`, which sends a million."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
RATES, TURN = (0.1, 1.0, 8.0), 800


@pytest.fixture(scope="module")
def fuzz_link() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz_link", BENCHMARKS / "fuzz_link.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["fuzz_link"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_others_do_not_move_a_helicopter_that_a_station_flies(fuzz_link: ModuleType) -> None:
    found = fuzz_link.fuzz(11_000, 7, commander=False, rates=RATES, turn=TURN, others=2, samples=4)
    assert found.faults == []
    assert found.motor[1] > 0.6  # it flew
    assert 0.0 < found.off_m < 0.05  # reached a place, and stayed there
    assert fuzz_link.growth_MB(found.rss_MB) < 5.0
    assert found.bytes_out / found.seconds / found.peers < 200e3


def test_a_mad_commander_gets_no_unsafe_output(fuzz_link: ModuleType) -> None:
    found = fuzz_link.fuzz(9_000, 8, commander=True, rates=RATES, turn=TURN, samples=4)
    assert found.faults == []
    assert found.motor[1] > 0.6
    assert found.tilt_ref_rad > 0.0  # it was off the floor and was tilted
    assert fuzz_link.growth_MB(found.rss_MB) < 5.0


def test_the_judge_sees_what_must_not_be(fuzz_link: ModuleType) -> None:
    """A check that cannot fail would prove nothing: outputs out of range and motors that run unarmed are seen."""
    import numpy as np

    from mufly.flight import Actuators, Flight
    from mufly.mission import Mission

    flight, found = Flight("mufly-1.1", Mission(), keep=False), fuzz_link.Findings()
    for _ in range(4):
        flight.step_period()
        fuzz_link.check(flight, found)
    assert found.faults == []
    for motors, servos, word in (
        ((0.1, 0.1), (0.0, 0.0), "not armed"),
        ((1.0 + 1e-15, 0.0), (0.0, 0.0), "out of range"),
        ((0.0, 0.0), (0.0, np.nan), "actuators"),
    ):
        found.faults.clear()
        flight.acting_actuators = Actuators(np.array(motors), np.array(servos))
        fuzz_link.check(flight, found)
        assert any(word in fault for fault in found.faults)


def test_no_motor_runs_that_is_not_armed_whatever_the_flight_software_wants() -> None:
    """The last gate before the motors: it must hold even where everything before it has gone wrong."""
    from mufly.flight import Flight
    from mufly.mission import Mission

    flight = Flight("mufly-1.1", Mission(), keep=False)
    flight.step_period()
    assert flight.autopilot.arm()
    assert flight.autopilot.take_off(1.0)
    for _ in range(400):
        flight.step_period()
    assert flight.status.actuators.motor_input.min() > 0.1
    flight.autopilot._armed = False  # a fault that nothing else has noticed
    for _ in range(3):
        flight.step_period()
    assert flight.status.actuators.motor_input.max() == 0.0
