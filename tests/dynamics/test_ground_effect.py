"""Rotors near the floor: how much more they lift, and a flight that finds it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.dynamics import (
    GRAVITY,
    find_trim,
    initial_state,
    model_parameters,
    simulate_open_loop,
    state_derivative,
)
from mufly.vehicle import replace_parameters


@pytest.fixture(scope="module")
def near(vehicle):
    return replace_parameters(vehicle, {"rotors.ground_effect": 1.0})


def rates(p, x, wind=(0.0, 0.0, 0.0)):
    dx = np.empty(21)
    state_derivative(x, np.array([0.7, 0.7, 0.2, -0.1]), np.array(wind), p, dx)
    return dx


def hovering(vehicle, height, **attitude):
    p = model_parameters(vehicle, 7.2)
    up, dw = find_trim(vehicle, voltage=7.2).rotor_speed
    x = initial_state(position=(0.0, 0.0, -height), rotor_speed=(up, dw), **attitude)
    x[13:15] = 0.05, -0.03
    return p, x


def test_it_is_the_published_gain_of_each_rotor_and_nothing_else(vehicle, near) -> None:
    """Same as other thrust coefficients: each rotor at its own height, along its own disc's normal."""
    wind, radius, rho = (0.8, -0.3, 0.0), 0.0875, 1.2
    p, x = hovering(near, 0.11, attitude=(0.1, -0.2, 0.4), bar_attitude=(0.05, 0.02))
    free, _ = hovering(vehicle, 0.11)
    with_gain = np.array(free)
    tilt = np.cos(0.1) * np.cos(-0.2)
    for side, z, speed in (("up", -0.091, x[18]), ("dw", -0.051, x[19])):
        thrust = float(free[f"thrust_{side}"]) * speed**2
        induced = thrust / (2 * rho * np.pi * radius**2)
        s = (radius / (4 * (0.11 - tilt * z))) ** 2 / (1 + (0.8**2 + 0.3**2) / induced)
        assert 0.005 < s < 0.05
        with_gain[f"thrust_{side}"] /= 1 - s
    assert_allclose(rates(p, x, wind), rates(with_gain[()], x, wind), rtol=1e-12, atol=1e-12)


def test_it_fades_with_height_and_wind_and_is_held_where_the_image_is_too_near(vehicle, near) -> None:
    def lift(height, wind=(0.0, 0.0, 0.0)):
        (p, x), (free, _) = hovering(near, height), hovering(vehicle, height)
        # From 0 up no leg touches: seen from below, the difference is the rotors'.
        return (rates(free, x, wind)[5] - rates(p, x, wind)[5]) / GRAVITY

    gains = [lift(h) for h in (0.02, 0.1, 0.2, 0.5, 50.0)]
    assert np.all(np.diff(gains) < 0)
    assert gains[1] == pytest.approx(0.0178, abs=0.0005)
    assert abs(gains[-1]) < 1e-6
    assert lift(-0.03) == pytest.approx(lift(-0.02), rel=0.2)  # below R/2 the lower rotor's is held
    assert lift(0.1, (5.0, 0.0, 0.0)) < 0.5 * gains[1]


def test_a_slow_descent_on_hover_inputs_turns_back_on_its_cushion(vehicle, near) -> None:
    start, inputs = find_trim(vehicle, voltage=7.2).state, find_trim(vehicle, voltage=7.2).input
    start[0:3], start[5] = (0.0, 0.0, -0.3), 0.05  # without a coefficient map nothing else damps heave
    free, cushioned = (
        simulate_open_loop(v, start, inputs, duration_s=2.0, voltage=7.2).truth_position.values[:, 2]
        for v in (vehicle, near)
    )
    assert free[-1] == pytest.approx(-0.2, abs=0.005)
    assert -0.28 < cushioned.max() < -0.26
    assert cushioned[-1] < cushioned.max() - 0.005
