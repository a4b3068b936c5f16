"""Steady flight: hover in numbers, climb, translation, wind, and what cannot fly."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.dynamics import (
    euler_from_quaternion,
    find_trim,
    model_parameters,
    simulate_open_loop,
    state_derivative,
)
from mufly.errors import InputError, MuflyError
from mufly.vehicle import load_vehicle, replace_parameters


def test_hover_in_numbers(vehicle) -> None:
    at_7_2, at_6_4 = find_trim(vehicle), find_trim(vehicle, voltage=6.4)
    assert_allclose(at_7_2.rotor_speed, [376.4, 443.6], atol=0.05)
    assert_allclose(at_6_4.rotor_speed, at_7_2.rotor_speed, rtol=1e-9)
    assert_allclose(at_7_2.motor_input, [0.667, 0.733], atol=5e-4)
    assert_allclose(at_6_4.motor_input, [0.750, 0.824], atol=5e-4)
    assert_allclose(at_7_2.servo_input, 0.0, atol=1e-12)
    assert at_7_2.thrust_N.sum() == pytest.approx(0.095 * 9.81 + 0.009, rel=1e-10)
    assert at_7_2.battery_power_W == pytest.approx(19.46, abs=0.01)  # with 2.9 W for the electronics


VELOCITIES = [(0, 0, 0), (0, 0, -0.5), (0, 0, 1.0), (1, 0, 0), (0, -2, 0), (3, 1, -1), (4, 0, 0)]


@pytest.mark.parametrize("velocity", VELOCITIES)
@pytest.mark.parametrize("wind", [(0, 0, 0), (0.5, -0.3, 0.1)])
@pytest.mark.parametrize("charge", [None, 0.7])
def test_nothing_accelerates_at_a_trim(vehicle, velocity, wind, charge) -> None:
    t = find_trim(vehicle, velocity=velocity, wind=wind, heading=0.9, charge=charge)
    x, dx = t.state.copy(), np.empty(21)
    x[2] = -100.0
    state_derivative(x, t.input, t.wind, model_parameters(vehicle, t.constant_voltage_V), dx)
    assert_allclose(dx[0:3], velocity, atol=1e-12)
    assert_allclose(dx[3:20], 0.0, atol=1e-6)
    assert euler_from_quaternion(t.state[6:10])[2] == pytest.approx(0.9, abs=1e-9)


@pytest.mark.parametrize("velocity", VELOCITIES)
def test_a_flight_from_a_trim_stays(vehicle, velocity) -> None:
    wind = (0.5, -0.3, 0.1)
    t = find_trim(vehicle, velocity=velocity, wind=wind)
    x = t.state.copy()
    x[2] = -100.0
    flight = simulate_open_loop(vehicle, x, t.input, duration_s=5.0, wind=wind, voltage=7.2)
    assert_allclose(flight.truth_velocity.values, np.tile(velocity, (501, 1)), atol=1e-8)
    assert np.ptp(flight.truth_attitude.values, axis=0).max() < 1e-8


def test_tilt_and_servo_in_forward_flight_balance_drag_and_its_moment(vehicle, published) -> None:
    drag, weight = 0.5 * 1.2 * 0.004 * 2.0**2, 0.095 * 9.81
    for v, c_H in ((published, 0.0), (vehicle, float(vehicle.rotors.inplane_drag))):
        t = find_trim(v, velocity=(2.0, 0, 0))
        roll, pitch, _ = euler_from_quaternion(t.state[6:10])
        H = c_H * 1.2 * np.pi * 0.0875**3 * t.rotor_speed * 2.0  # upper, lower
        tilt = (H @ [0.091, 0.051]) / (
            0.051 * t.thrust_N[1]
        )  # the lower disc's, against the moment of the rotors' drag
        assert roll == pytest.approx(0, abs=1e-12)
        assert pitch == pytest.approx(-(drag + H.sum() - t.thrust_N[1] * tilt) / weight, rel=0.02, abs=1e-4)
        assert t.servo_input[0] == pytest.approx(tilt / (0.77 * np.radians(15)), rel=0.02, abs=1e-12)


def test_hovering_in_wind_is_flying_in_still_air(vehicle) -> None:
    in_wind, moving = (
        find_trim(vehicle, wind=(1.0, 0.5, 0.2)),
        find_trim(vehicle, velocity=(-1.0, -0.5, -0.2)),
    )
    assert_allclose(in_wind.input, moving.input, atol=1e-9)
    assert_allclose(in_wind.state[6:20], moving.state[6:20], rtol=1e-8, atol=1e-9)


def test_an_emptier_battery_takes_more_input(vehicle) -> None:
    full, half = find_trim(vehicle, charge=1.0), find_trim(vehicle, charge=0.5)
    assert half.battery_voltage_V < full.battery_voltage_V
    assert np.all(half.motor_input > full.motor_input)
    assert half.battery_power_W == pytest.approx(half.battery_voltage_V * half.battery_current_A, rel=1e-12)
    constant = find_trim(vehicle, voltage=half.battery_voltage_V)
    assert_allclose(constant.input, half.input, atol=1e-9)
    # A fifth of the charge left: the 6.4 V at which the thesis's linear model was made (errata, point 6).
    assert find_trim(vehicle, charge=0.2).battery_voltage_V == pytest.approx(6.4, abs=0.03)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"voltage": 5.0}, "too heavy to hover: 95 g"),
        ({"velocity": (0, 0, -40)}, "no steady flight at velocity"),
        ({"velocity": (0, 0, 60)}, "no steady flight at velocity"),
    ],
)
def test_what_cannot_fly_says_so_in_one_line(vehicle, arguments, words) -> None:
    with pytest.raises(MuflyError, match=words) as caught:
        find_trim(vehicle, **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "key"),
    [
        ({"voltage": 0.0}, "voltage"),
        ({"voltage": float("nan")}, "voltage"),
        ({"charge": 1.1}, "charge"),
        ({"charge": 0.5, "voltage": 7.0}, "voltage"),
        ({"velocity": (1, 0)}, "velocity"),
        ({"wind": (float("nan"), 0, 0)}, "wind"),
    ],
)
def test_impossible_arguments_are_named(vehicle, arguments, key) -> None:
    with pytest.raises(InputError) as caught:
        find_trim(vehicle, **arguments)
    assert caught.value.key == key


def test_too_heavy(vehicle) -> None:
    with pytest.raises(MuflyError, match=r"mufly-1\.1: body\.mass: too heavy to hover: 160 g .*; lower it"):
        find_trim(replace_parameters(vehicle, {"body.mass": 0.16}))


def test_a_trim_prints_itself_usefully() -> None:
    text = str(find_trim(load_vehicle("mufly-1.1")))
    assert "motor input 0.667 upper, 0.733 lower" in text
    assert "19.5 W" in text
