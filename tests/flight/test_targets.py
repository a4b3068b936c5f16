"""Targets that change while the vehicle flies to them, and manual flight near the floor."""

import math

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.flight import Flight
from mufly.mission import Mission
from mufly.vehicle import Vehicle, load_vehicle


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


class Hovering:
    """A flight that hovers at a height."""

    def __init__(self, vehicle, controller, height=1.0):
        self.flight = Flight(vehicle, Mission(name="none"), controller=controller, keep=False)
        self.autopilot = self.flight.autopilot
        self.references, self.texts = [], []
        self.autopilot.listeners.append(lambda e: self.texts.append(e.text))
        self.run(0.1)
        assert self.autopilot.arm()
        self.autopilot.take_off(height)
        self.run(20.0, until=lambda: self.status.state == "hover")

    @property
    def status(self):
        return self.flight.status

    def run(self, seconds, until=lambda: False, each=lambda t: None, rate_Hz=20.0):
        begin, count = self.flight.time_s, 0
        while self.flight.time_s < begin + seconds and not until():
            if (self.flight.time_s - begin) * rate_Hz >= count:
                each(self.flight.time_s - begin)
                count += 1
            self.flight.step_period()
            self.references.append(self.status.reference_position)


@pytest.mark.parametrize("rate_Hz", [20.0, 5.0, 0.9])
def test_a_moving_target_is_followed_at_any_rate(vehicle, controller, rate_Hz):
    one = Hovering(vehicle, controller)

    def send(t):
        assert one.autopilot.go_to((0.3 * t + 0.3, 0.1 * t, -1.0))

    one.run(8.0, each=send, rate_Hz=rate_Hz)
    n, e, _ = one.status.truth.position
    assert n > 1.6
    assert e > 0.4
    one.run(10.0, until=lambda: one.status.state == "hover")
    assert one.status.state == "hover"
    assert np.abs(np.diff(one.references[1:], axis=0)).max() < 0.006  # 1.2 m/s: the reference does not jump
    assert "user's waypoint reached" in " ".join(one.texts)
    assert len(one.texts) < 20


def test_a_target_with_noise_is_reached(vehicle, controller):
    one, rng = Hovering(vehicle, controller), np.random.default_rng(3)
    one.run(8.0, each=lambda t: one.autopilot.go_to((1.0 + rng.normal(0, 0.005), rng.normal(0, 0.005), -1.3)))
    assert one.status.truth.position == pytest.approx([1.0, 0.0, -1.3], abs=0.06)


def test_a_turning_heading_is_followed(vehicle, controller):
    one = Hovering(vehicle, controller)
    one.run(5.0, each=lambda t: one.autopilot.turn_to(0.4 * t))
    assert one.status.truth.attitude[2] > 1.2
    assert np.abs(one.status.truth.position[:2]).max() < 0.05


def test_turns_asked_for_on_the_run_stop_it(vehicle, controller):
    one = Hovering(vehicle, controller)
    one.autopilot.go_to((6.0, 0.0, -1.0), 0.0)
    one.run(4.0)
    speed = one.status.truth.velocity[0]
    assert speed > 0.4
    one.run(4.0, each=lambda t: one.autopilot.turn_to(0.4 * t))
    assert np.linalg.norm(one.status.truth.velocity) < 0.05
    assert one.status.truth.position[0] < 4.0


@pytest.mark.parametrize("height", [0.36, 0.8])
def test_full_sticks_near_the_floor_do_not_scrape(vehicle, controller, height):
    one = Hovering(vehicle, controller, height)
    speeds, tilts = [], []

    def hold(t):
        one.autopilot.set_sticks(math.radians(15.0), 0.0, 0.0, -1.0)
        truth = one.status.truth
        tilts.append(math.degrees(math.hypot(*truth.attitude[:2])))
        if -truth.position[2] < 0.1:
            speeds.append(math.hypot(*truth.velocity[:2]))

    one.run(6.0, each=hold)
    assert not one.status.crash_cause
    assert speeds
    assert max(speeds) < 0.7
    assert max(tilts) < 15.0
    assert one.status.motors in ("fly", "off")


def test_sticks_high_up_are_not_limited(vehicle, controller):
    one = Hovering(vehicle, controller, 1.5)
    one.run(2.5, each=lambda t: one.autopilot.set_sticks(math.radians(8.0), 0.0, 0.0, 0.0))
    assert math.hypot(*one.status.truth.velocity[:2]) > 2.5
