"""Bad messages to a helicopter in flight: short runs.

A long run, six minutes, printed: ``pytest -s tests/link/test_fuzz.py --fuzz-messages 1000000 [--fuzz-seed N]``.
"""

from __future__ import annotations

import fuzz_link
import pytest

RATES, TURN = (0.1, 1.0, 8.0), 800


def run(config: pytest.Config, role: str, short: int, seed: int, others: int) -> fuzz_link.Findings:
    """Send bad messages, the short way or as many as ``--fuzz-messages``, and check what holds for both roles."""
    long, commander = config.getoption("--fuzz-messages"), role == "commander"
    if long:
        found = fuzz_link.fuzz(long, config.getoption("--fuzz-seed"), commander)
        fuzz_link.report(role, found)
    else:
        found = fuzz_link.fuzz(short, seed, commander, rates=RATES, turn=TURN, others=others, samples=4)
    assert found.faults == []
    assert found.motor[1] > 0.6  # it flew
    assert fuzz_link.growth_MB(found.rss_MB) < 5.0
    return found


def test_others_do_not_move_a_helicopter_that_a_station_flies(request: pytest.FixtureRequest) -> None:
    found = run(request.config, "beside", 11_000, 7, others=2)
    assert 0.0 < found.off_m < 0.05  # reached a place, and stayed there
    assert found.bytes_out / found.seconds / found.peers < 200e3


def test_a_mad_commander_gets_no_unsafe_output(request: pytest.FixtureRequest) -> None:
    found = run(request.config, "commander", 9_000, 8, others=5)
    assert found.tilt_ref_rad > 0.0  # it was off the floor and was tilted


def test_the_judge_sees_what_must_not_be() -> None:
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
