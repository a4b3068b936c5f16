"""Actuators that oscillate are noticed, told and end the mission; those that work hard, or are asked to, are not."""

import math
from collections import deque
from dataclasses import replace as replaced

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.estimate import IdealEstimator
from mufly.flight import fly_mission, read_events, summarise_flight, summary_rows
from mufly.flight.oscillation_detector import ACTUATOR_INPUT_NAMES, OscillationDetector, steering_demands
from mufly.mission import parse_mission
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

HOP = parse_mission({"waypoint": [{"position_m": [0.5, 0.0, -1.0], "wait_s": 1.0}]})


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


def watched(signal, *, seconds=12.0, which=2, asked=None, rate=50.0):
    """What is found at each instant when one input follows a signal of time."""
    watch, found = OscillationDetector(), []
    for k in range(int(seconds * rate)):
        inputs = [0.5, 0.5, 0.0, 0.0]
        inputs[which] = signal(k / rate)
        found.append(watch.find_oscillation(k / rate, inputs, asked(k / rate) if asked else None))
    return found


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("hertz", [0.4, 1.0, 5.0])
def test_a_steady_swing_is_found_with_its_size_and_frequency(which: int, hertz: float) -> None:
    # A little more than half of the range, to and fro.
    middle, size = (0.5, 0.275) if which < 2 else (0.0, 0.55)
    found = watched(lambda t: middle + size * math.sin(math.tau * hertz * t), which=which, seconds=16.0)
    first = next(k for k, one in enumerate(found) if one) / 50.0
    assert max(4.0 / hertz, 2.0) <= first <= max(4.0 / hertz, 2.0) + 2.0 / hertz
    last = found[-1]
    assert last.input_name == ACTUATOR_INPUT_NAMES[which]
    assert last.swing == pytest.approx(2 * size, rel=0.05)
    assert last.frequency_Hz == pytest.approx(hertz, rel=0.1)
    assert last.start_s + last.duration_s <= 16.0
    assert last.duration_s == pytest.approx(16.0 - last.start_s, abs=1.0 / hertz)


def test_what_is_small_slow_short_or_uneven_is_no_oscillation() -> None:
    random = np.random.default_rng(0)
    gusts = np.interp(np.arange(0.0, 60.0, 0.02), np.cumsum(random.uniform(0.1, 1.5, 100)), random.uniform(-1, 1, 100))
    for signal in (
        lambda t: 0.45 * math.sin(math.tau * t),
        lambda t: math.sin(math.tau * 0.2 * t),
        lambda t: math.sin(math.tau * 2.0 * t) if t < 1.8 else 0.0,
        lambda t: float(gusts[int(t * 50)]),
        lambda t: math.copysign(1.0, math.sin(math.tau * t)) if t < 3.4 else 1.0,
    ):
        assert not any(watched(signal, seconds=50.0))


def test_it_ends_when_the_actuator_rests() -> None:
    found = watched(lambda t: math.sin(math.tau * t) if t < 8.0 else 0.0, seconds=16.0)
    assert found[round(8.0 * 50)]
    assert not found[-1]


@pytest.mark.parametrize("order", [1, -1])
def test_of_several_that_which_lasts_longest_is_told(order: int) -> None:
    watch, early, late = OscillationDetector(), *(1, 3)[::order]
    for k in range(800):
        t, inputs = k / 50.0, [0.5, 0.5, 0.0, 0.0]
        inputs[early] += (0.4 if early == 1 else 0.8) * math.sin(math.tau * t)
        inputs[late] += (0.4 if late == 1 else 0.8) * math.sin(math.tau * t) * (t > 4.0)
        found = watch.find_oscillation(t, inputs)
        if t > 10.0:
            assert found.input_name == ACTUATOR_INPUT_NAMES[early]
            assert found.duration_s == pytest.approx(t - found.start_s, abs=1.0)


@pytest.mark.parametrize("axis", range(6))
def test_only_what_is_asked_for_clearly_is_steering(axis: int) -> None:
    """To and fro by 11 cm/s, 12 deg/s or 3 deg it is; what is a fifth less is a hand that trembles."""

    def asked(share):
        size = 0.5 * share * (0.11, 0.11, 0.11, math.radians(12.5), math.radians(3.1), math.radians(3.1))[axis]
        return lambda t: tuple(size * math.sin(math.tau * 0.7 * t) * (k == axis) for k in range(6))

    def swing(t):
        return math.sin(math.tau * 0.7 * t - 0.4)

    assert not any(watched(swing, asked=asked(1.0)))
    assert watched(swing, asked=asked(0.8))[-1]


def test_what_a_pilot_or_a_program_asks_for_is_none() -> None:
    def stick(t):
        return 0.1 * math.sin(math.tau * 0.7 * t)

    def swing(t):
        return math.sin(math.tau * 0.7 * t - 0.4)

    def pilot(t):
        return steering_demands("rc", (9.0 * stick(t), 0.0, 0.0), 0.0, stick(t), 0.0)

    assert not any(watched(swing, asked=pilot))
    assert not any(
        watched(swing, asked=lambda t: steering_demands("offboard", (2.0 * stick(t), 0.0, 0.0), 0.0, 0.0, 0.0))
    )
    # Hands that rest ask for nothing, and of the velocity a pilot's reference repeats what is measured.
    assert watched(swing, asked=lambda t: steering_demands("rc", (9.0 * stick(t), 0.0, 0.0), 0.0, 0.0, 0.0))[-1]
    assert steering_demands("hover", (1.0, 2.0, 3.0), 4.0, 5.0, 6.0) is None


class Late:
    """The ideal estimator, some periods late."""

    def __init__(self, periods: int) -> None:
        self.periods, self.inner, self.kept = periods, IdealEstimator(), deque()

    def reset(self) -> None:
        self.inner.reset()
        self.kept.clear()

    def update(self, readings, acting=None):
        now = self.inner.update(readings)
        self.kept.append(now)
        old = self.kept[0] if len(self.kept) <= self.periods else self.kept.popleft()
        return replaced(old, time_s=now.time_s)


def test_too_much_delay_swings_the_servos_and_fails_the_flight(vehicle: Vehicle, controller: FlightController) -> None:
    """25 ms, the delay margin being 21: it flies all the same, which used to count as a success."""
    dataset = fly_mission(vehicle, HOP, controller=controller, estimator=Late(5), wind=(0.5, 0.0, 0.0), gust=0.3)
    summary = summarise_flight(dataset, events=read_events(dataset))
    assert summary.outcome == "failed"
    assert "servo_input" in summary.reason
    assert "oscillates" in summary.reason
    assert summary.longest_oscillation_s > 2.0
    assert "servo_input" in dict(summary_rows(summary))["Longest oscillation"]
    told = [e for e in read_events(dataset) if "oscillates" in e.text]
    assert [(e.state, e.level) for e in told] == [("landing", "error")]


def test_a_vehicle_light_against_its_controller_takes_off_and_flies(
    vehicle: Vehicle, controller: FlightController
) -> None:
    """Hover at an input of 0.51: it lifts off during spin-up, was thrown up a metre, and swung for good."""
    shares = {"body.mass": 0.9, "motor.back_emf_constant": 0.92, "motor.resistance": 0.9}
    shares |= dict.fromkeys(("rotors.upper.thrust_coefficient", "rotors.lower.thrust_coefficient"), 1.1)
    shares |= dict.fromkeys(("rotors.upper.drive_inertia", "rotors.lower.drive_inertia"), 0.9)
    now = {p.key: p.value for p in list_parameters(vehicle)}
    light = replace_parameters(vehicle, {key: float(now[key]) * share for key, share in shares.items()})
    dataset = fly_mission(light, HOP, controller=controller, wind=(0.5, 0.0, 0.0), gust=0.3)
    summary = summarise_flight(dataset, [w.position_m for w in HOP.waypoint])
    assert summary.outcome == "succeeded"
    assert summary.longest_oscillation_s == 0.0
    assert "Longest oscillation" not in dict(summary_rows(summary))
    assert summary.longest_railed_s < 0.2
    height = -dataset.truth_position.sel(axis="D").values
    assert height.max() < 1.05
    # It is caught near the floor: 0.07 m is where it stands, and the climb begins after that.
    before = dataset.time.values < 2.7
    assert height[before].max() < 0.25
    assert (summary.touchdown_speed_m_s or 0.0) < 0.3
