"""Open-loop simulation: steps that are too long and arguments that are wrong are named."""

import numpy as np
import pytest

from mufly.dynamics import (
    find_longest_stable_step,
    initial_state,
    integrate_state,
    model_parameters,
    simulate_open_loop,
)
from mufly.errors import InputError
from mufly.vehicle import replace_parameters

REST = initial_state(position=(0, 0, -5))


def test_the_longest_step_is_where_the_swash_plate_turns_unstable(vehicle) -> None:
    p = model_parameters(vehicle)
    assert find_longest_stable_step(p) == pytest.approx(2.7e-3)
    for factor, grows in ((0.99, False), (1.06, True)):
        x = REST.copy()
        integrate_state(x, np.array([0, 0, 0.1, 0]), np.zeros(3), p, factor * find_longest_stable_step(p), 2000)
        assert (abs(x[14]) > 1.0) == grows


@pytest.mark.parametrize(
    "values",
    [
        {"swash_plate.time_constant": 1e-4},
        {"rotors.lower.drive_inertia": 1e-8},
        {"contact.damping": 300.0},
        {"contact.stiffness": 1e7},
    ],
)
def test_a_vehicle_too_fast_for_the_step_is_named(vehicle, values) -> None:
    with pytest.raises(InputError, match=r"the fastest mode of mufly-1\.1; give a step below") as caught:
        simulate_open_loop(replace_parameters(vehicle, values), REST, np.zeros(4), duration_s=0.1)
    assert caught.value.key == "step_s"


def test_a_shorter_step_is_taken(vehicle) -> None:
    fast = replace_parameters(vehicle, {"swash_plate.time_constant": 1e-4})
    flight = simulate_open_loop(fast, REST, (0, 0, 0.5, 0), duration_s=0.1, step_s=1e-4)
    assert np.all(np.isfinite(flight.truth_attitude))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"duration_s": 0.0}, "duration_s"),
        ({"sample_s": -1.0}, "sample_s"),
        ({"step_s": float("nan")}, "step_s"),
        ({"state": np.zeros(20)}, "state"),
        ({"state": np.full(21, np.nan)}, "state"),
        ({"inputs": np.zeros(3)}, "inputs"),
        ({"wind": (0, np.inf, 0)}, "wind"),
        ({"voltage": -7.0}, "voltage"),
    ],
)
def test_wrong_arguments_are_named(vehicle, change, key) -> None:
    arguments = {"state": REST, "inputs": np.zeros(4), "duration_s": 0.1, **change}
    with pytest.raises(InputError) as caught:
        simulate_open_loop(vehicle, **arguments)
    assert caught.value.key == key


def test_inputs_are_held_and_recorded(vehicle) -> None:
    inputs = np.array([[0.1, 0.2, 0, 0], [0.9, 1.4, 0.5, -0.5]])
    flight = simulate_open_loop(vehicle, REST, inputs, duration_s=0.05)
    assert flight.motor_input.values[:3].tolist() == [[0.1, 0.2], [0.9, 1.4], [0.9, 1.4]]
    saturated = simulate_open_loop(vehicle, REST, np.minimum(inputs, 1.0), duration_s=0.05)
    np.testing.assert_array_equal(flight.battery_voltage, saturated.battery_voltage)
