"""The nonlinear model, with saturation, sagging battery and one period of delay, under the law."""

from __future__ import annotations

import pickle
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from mufly.control import FlightController
from mufly.dynamics import initial_state, integrate_state, model_parameters, standing_height
from mufly.results import to_plain_data
from mufly.vehicle import Vehicle
from mufly.vehicle import replace_parameters as altered


def smooth(t: float, duration: float) -> tuple[float, float, float]:
    """Minimum-jerk path from 0 to 1, its speed and acceleration."""
    s = min(max(t / duration, 0.0), 1.0)
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2 / duration,
        60 * s * (1 - s) * (1 - 2 * s) / duration**2,
    )


@pytest.mark.parametrize("charge", [1.0, 0.5, 0.2])
def test_heave_step(vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType, charge: float) -> None:
    """Fig 6.10: half a metre up. Settled to 2 % within 2.5 s, overshoot below 1 %, yaw below 0.02 rad, no rail."""
    up = closed_loop.Reference(position=(0.0, 0.0, -1.5))
    flight = closed_loop.fly(vehicle, controller, lambda t: up, 5.0, charge=charge)
    climbed = -1.0 - flight.position[:, 2]
    outside = np.abs(climbed - 0.5) > 0.01
    assert flight.time[np.nonzero(outside)[0][-1]] < 2.5
    assert climbed.max() < 0.505
    assert np.abs(flight.attitude[:, 2]).max() < 0.02
    assert flight.railed() < 0.1


@pytest.mark.parametrize("charge", [1.0, 0.2])
def test_a_smooth_climb_is_followed_without_lag(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType, charge: float
) -> None:
    """A metre in three seconds, given with its speed: the lead makes up for the loop's lag of 0.2 s."""

    def climb(t: float):
        s, v, _ = smooth(t - 0.5, 3.0)
        return closed_loop.Reference(
            position=(0.0, 0.0, -1.0 - s), velocity=(0.0, 0.0, -v), heading=0.8 * s, heading_rate=0.8 * v
        )

    flight = closed_loop.fly(vehicle, controller, climb, 6.0, charge=charge)
    wanted = np.array([climb(t).position[2] for t in flight.time])
    turned = np.array([climb(t).heading for t in flight.time])
    assert np.abs(flight.position[:, 2] - wanted).max() < 0.03
    assert np.abs(flight.attitude[:, 2] - turned).max() < 0.03
    assert (wanted[-1] - flight.position[:, 2]).max() < 0.01
    assert flight.railed() < 0.1


def test_yaw_step(vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType) -> None:
    turn = closed_loop.Reference(heading=1.5)
    flight = closed_loop.fly(vehicle, controller, lambda t: turn, 5.0)
    assert flight.attitude[-1, 2] == pytest.approx(1.5, abs=5e-3)
    assert flight.attitude[:, 2].max() < 1.515
    assert np.abs(flight.position[:, 2] + 1).max() < 0.01


def test_pitch_reference_is_followed(vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType) -> None:
    """Fig 6.12: ramps and plateaus of about 0.1 rad. The servos' use is that without drag of the rotors: at the 5 m/s
    that it ends with, that takes them nearly whole."""
    times, angles = (0, 1, 1.5, 3, 3.5, 4.5, 6, 6.5, 10), (0, 0, -0.1, -0.1, -0.05, -0.12, -0.12, 0, 0)
    reference = np.interp
    for v, most in ((vehicle, 0.9), (altered(vehicle, {"rotors.inplane_drag": 0.0}), 0.5)):
        flight = closed_loop.fly(
            v,
            controller,
            lambda t: closed_loop.Reference(tilt=(0.0, float(reference(t, times, angles)))),
            8.0,
        )
        error = flight.attitude[:, 1] - np.interp(flight.time, times, angles)
        assert np.abs(error).max() < 0.02
        assert np.sqrt(np.mean(error**2)) < 0.007
        assert np.abs(flight.attitude[:, 0]).max() < 2e-3
        assert np.abs(flight.servo).max() < most


def test_pitch_step_rails_the_servo_and_recovers(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType
) -> None:
    flight = closed_loop.fly(
        vehicle, controller, lambda t: closed_loop.Reference(tilt=(0.0, -0.1 if t > 0.5 else 0.0)), 4.0
    )
    late = flight.time > 1.5
    assert np.abs(flight.servo).max() == pytest.approx(1.0)
    assert flight.railed() < 0.1
    assert np.abs(flight.attitude[late, 1] + 0.1).max() < 0.006


def test_a_tilt_that_rails_the_servos_ends_like_a_small_one(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType
) -> None:
    """0.1 rad at once (the size of Fig 6.12) and back: both edges rail the servo, and nothing is left of it."""

    def response(size: float):
        flight = closed_loop.fly(
            vehicle,
            controller,
            lambda t: closed_loop.Reference(tilt=(0.0, -size if 0.5 < t < 1.0 else 0.0)),
            3.0,
        )
        return flight, -flight.attitude[:, 1] / size

    small, linear = response(0.01)
    large, saturated = response(0.1)
    assert np.abs(small.servo).max() < 0.5
    assert np.abs(large.servo).max() == pytest.approx(1.0)
    assert saturated.max() < linear.max() + 0.03
    assert saturated.min() > linear.min() - 0.03


def test_anti_windup_of_heave(vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType) -> None:
    """A raw step, past the reference filter, rails the motors; without it, it overshoots by as much again."""
    overshoot = []
    for share, railed in ((1.0, 0.1), (0.0, 0.5)):
        gains = controller.heave_yaw_gains.copy()
        gains["M"] *= share
        gains["heave_acceleration"] = gains["heave_speed"] = 1e3
        gains["heave_bandwidth"] = 100.0
        raw = replace(controller, heave_yaw_gains=gains)
        flight = closed_loop.fly(
            vehicle, raw, lambda t: closed_loop.Reference(position=(0.0, 0.0, -1.5)), 8.0, charge=1.0
        )
        assert flight.railed() > railed
        assert np.abs(flight.attitude[:, :2]).max() < 0.01
        overshoot.append(-1.5 - flight.position[:, 2].min())
    assert overshoot[0] < 0.04
    assert overshoot[1] > 0.3


def test_a_great_tilt_at_once_rails_the_servos_and_hardly_overshoots(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType
) -> None:
    """0.3 rad: twice what the servos can hold against the stabiliser bar at first. With the observer's, 17 %."""
    flight = closed_loop.fly(
        vehicle, controller, lambda t: closed_loop.Reference(tilt=(0.0, -0.3 if t > 0.5 else 0.0)), 3.0
    )
    assert np.abs(flight.servo).max() == pytest.approx(1.0)
    assert -flight.attitude[:, 1].min() < 1.05 * 0.3


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_a_leg_of_three_metres(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType, heading: float
) -> None:
    def leg(t: float):
        s, v, a = smooth(t - 1.0, 5.0)
        return closed_loop.Reference(
            position=(3 * s, 0.0, -1.0),
            velocity=(3 * v, 0.0, 0.0),
            acceleration=(3 * a, 0.0, 0.0),
            heading=heading,
        )

    flight = closed_loop.fly(vehicle, controller, leg, 8.0)
    wanted = np.array([leg(t).position for t in flight.time])
    error = flight.position - wanted
    assert np.linalg.norm(error, axis=1).max() < 0.1
    assert flight.position[:, 0].max() < 3.03
    assert np.linalg.norm(error[-1]) < 0.01
    assert flight.railed() < 0.1


def test_wind_is_held_off_through_a_turn(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType
) -> None:
    """The integrators stay with the wind while the fuselage turns under them."""
    flight = closed_loop.fly(
        vehicle,
        controller,
        lambda t: closed_loop.Reference(heading=2.5 if t > 4 else 0.0),
        9.0,
        wind=(1.0, -0.5, 0.0),
    )
    assert np.linalg.norm(flight.position[:, :2], axis=1).max() < 0.05


@pytest.mark.parametrize("motors", [(0.6, 0.66), (0.0, 0.0)])
def test_take_off_from_the_ground(
    vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType, motors: tuple[float, float]
) -> None:
    """Engaged while standing, with the motors turning or still; then a climb of a metre in four seconds."""
    p = model_parameters(vehicle)
    x = initial_state(position=(0.0, 0.0, -standing_height(vehicle)))
    integrate_state(x, np.array([*motors, 0.0, 0.0]), np.zeros(3), p, 1e-3, 2000)
    ground = float(x[2])

    def climb(t: float):
        s, v, _ = smooth(t - 0.5, 4.0)
        return closed_loop.Reference(position=(0.0, 0.0, ground - s), velocity=(0.0, 0.0, -v))

    flight = closed_loop.fly(vehicle, controller, climb, 9.0, state=x, motor_input=motors, charge=1.0)
    climbed = ground - flight.position[:, 2]
    np.testing.assert_allclose(flight.motor[0], motors, atol=2e-3)
    assert climbed.max() < 1.04
    assert climbed[-1] == pytest.approx(1.0, abs=0.01)
    assert np.abs(flight.attitude[:, :2]).max() < 0.02
    assert np.abs(flight.attitude[:, 2]).max() < 0.1


def test_landing(vehicle: Vehicle, controller: FlightController, closed_loop: ModuleType) -> None:
    """Down at 0.2 m/s, reference on below the floor: touches at that speed and unloads the motors."""
    flight = closed_loop.fly(
        vehicle,
        controller,
        lambda t: closed_loop.Reference(
            position=(0.0, 0.0, -1.0 + 0.2 * max(t - 0.5, 0.0)), velocity=(0.0, 0.0, 0.2 if t > 0.5 else 0.0)
        ),
        9.0,
    )
    stands = -standing_height(vehicle)
    touch = int(np.argmax(flight.position[:, 2] > stands - 0.001))
    assert touch > 0
    assert flight.velocity[touch - 60 : touch, 2].max() < 0.21
    assert np.abs(flight.attitude[:, :2]).max() < 0.02
    assert flight.motor[-1].mean() < 0.5


def test_a_flight_controller_travels_to_another_process(controller: FlightController) -> None:
    there = pickle.loads(pickle.dumps(controller))
    assert to_plain_data(there) == to_plain_data(controller)
    for mine, its in (
        (controller.heave_yaw.reduced, there.heave_yaw.reduced),
        (controller.velocity.plant, there.velocity.plant),
    ):
        for name in ("A", "B", "C", "D"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(its, name))
        assert (mine.input_labels, mine.output_labels, mine.state_labels) == (
            its.input_labels, its.output_labels, its.state_labels)  # fmt: skip
        assert mine.dt == its.dt
    assert there.heave_yaw_gains == controller.heave_yaw_gains
