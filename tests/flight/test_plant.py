"""The true helicopter in its world: what counts as a crash, and how time passes."""

import re

import numpy as np
import pytest

from mufly.dynamics import DEFAULT_STEP_S, DrydenWind, find_longest_stable_step, initial_state, model_parameters
from mufly.errors import MuflyError
from mufly.flight import Actuators, SimulatedPlant
from mufly.vehicle import load_vehicle, replace_parameters
from mufly.world import Box, World

VEHICLE = load_vehicle("mufly-1.1")
RADIUS = float(VEHICLE.rotors.radius)
EMPTY = World()


def plant_at(position, attitude=(0.0, 0.0, 0.0), world=EMPTY, vehicle=VEHICLE) -> SimulatedPlant:
    state = initial_state(position=position, attitude=attitude)
    return SimulatedPlant(vehicle, world, DrydenWind(step_s=0.005), 200.0, state)


@pytest.mark.parametrize(("gap", "hit"), [(0.9 * RADIUS, True), (1.1 * RADIUS, False)])
def test_a_rotor_nearer_to_a_box_than_its_radius_has_hit_it(gap: float, hit: bool) -> None:
    box = Box((1.0, 0.0, -1.0), (1.0, 1.0, 2.0), 0.0, "crate")
    plant = plant_at((0.5 - gap, 0.0, -1.0), world=World((box,)))
    plant.detect_collision()
    assert ("a rotor hit the crate" in plant.crash_cause) is hit


@pytest.mark.parametrize(("roll", "tipped"), [(np.radians(100.0), True), (np.radians(10.0), False)])
def test_a_rotor_on_the_floor_is_tipped_over(roll: float, tipped: bool) -> None:
    plant = plant_at((0.0, 0.0, -0.07), (roll, 0.0, 0.0))
    plant.detect_collision()
    assert ("tipped over" in plant.crash_cause) is tipped


def test_time_is_counted_in_whole_periods() -> None:
    plant = plant_at((0.0, 0.0, -5.0))
    for _ in range(201):
        plant.advance_period(Actuators.make_zero_inputs())
    assert plant.time_s == 201 / 200
    # Free fall but for the drag of the fuselage.
    assert plant.state[5] == pytest.approx(9.81 * plant.time_s, rel=0.05)


def test_a_simulation_that_fails_says_when_and_with_which_steps() -> None:
    plant = plant_at((0.0, 0.0, np.nan))
    with pytest.raises(MuflyError, match=r"became unstable at 0\.005 s with steps of") as told:
        plant.advance_period(Actuators.make_zero_inputs())
    step_ms = float(re.search(r"steps of (\S+) ms", str(told.value))[1])
    # A whole number of steps makes a period of 5 ms, and with one fewer they would be longer than is sound.
    steps = round(5.0 / step_ms)
    assert 5.0 / step_ms == pytest.approx(steps)
    assert 5.0 / steps <= 1e3 * DEFAULT_STEP_S * (1 + 1e-9) < 5.0 / (steps - 1)
    with pytest.raises(MuflyError, match="too short to simulate") as told:
        plant_at((0.0, 0.0, -1.0), vehicle=replace_parameters(VEHICLE, {"swash_plate.time_constant": 1e-6}))
    # 10 us are the least: a vehicle that needs a tenth less is refused, one that needs a tenth more is simulated.
    per_lag = (
        find_longest_stable_step(model_parameters(replace_parameters(VEHICLE, {"swash_plate.time_constant": 1e-5})))
        / 1e-5
    )
    with pytest.raises(MuflyError, match="too short to simulate"):
        plant_at(
            (0.0, 0.0, -1.0),
            vehicle=replace_parameters(VEHICLE, {"swash_plate.time_constant": 9e-6 / per_lag}),
        )
    fast = plant_at(
        (0.0, 0.0, -1.0), vehicle=replace_parameters(VEHICLE, {"swash_plate.time_constant": 1.1e-5 / per_lag})
    )
    fast.advance_period(Actuators.make_zero_inputs())
    # Runge and Kutta's method of fourth order needs 2.8 steps a time constant at the least.
    assert 0.3 < float(re.search(r"steps of (\S+) us", str(told.value))[1]) < 2.8
