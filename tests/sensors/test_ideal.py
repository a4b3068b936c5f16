"""Ideal sensors against plane geometry."""

import math

import numpy as np
import pytest

from mufly import load_vehicle
from mufly.dynamics import initial_state
from mufly.sensors import beam_angles, beam_directions, ideal_measurement, ideal_ranges, nearest_turn
from mufly.vehicle import replace
from mufly.world import Box, World


def test_beams_look_as_in_figure_6_18() -> None:
    vehicle = load_vehicle("mufly-2.0")
    assert beam_angles(vehicle) == pytest.approx([i * math.pi / 4 + math.pi / 8 for i in range(8)])
    assert np.linalg.norm(beam_directions(vehicle), axis=1) == pytest.approx(1.0)


def test_a_beam_ahead_sees_the_wall_ahead_and_turns_with_the_heading() -> None:
    vehicle = replace(load_vehicle("mufly-2.0"), {"range_ring.first_angle": 0.0})
    directions = beam_directions(vehicle)
    world = World(boxes=(Box((1.5, 0.0, -1.0), (1.0, 10.0, 2.0)),))  # its face is at N = 1
    limits = {"min_range_m": 0.3, "max_range_m": 1.5}
    ahead = ideal_ranges(initial_state(position=(0, 0, -1)), world, directions, **limits)
    assert ahead[0] == pytest.approx(1.0)
    assert ahead[1] == pytest.approx(math.sqrt(2.0))
    assert ahead[4] == 1.5
    turned = ideal_ranges(
        initial_state(position=(0, 0, -1), attitude=(0, 0, math.pi / 4)), world, directions, **limits
    )
    assert turned[7] == pytest.approx(1.0)
    tilted = ideal_ranges(
        initial_state(position=(0, 0, -1), attitude=(0, math.radians(20), 0)), world, directions, **limits
    )
    assert tilted[0] == pytest.approx(1.0 / math.cos(math.radians(20)))
    close = ideal_ranges(initial_state(position=(0.9, 0, -1)), world, directions, **limits)
    assert close[0] == 0.3


def test_measured_yaw_is_continuous() -> None:
    assert nearest_turn(-3.1, 3.1) == pytest.approx(2 * math.pi - 3.1)
    state = initial_state(attitude=(0.0, 0.0, -3.1))
    m = ideal_measurement(0.0, state, ranges=np.ones(8), battery_voltage=7.0, last_yaw=3.1)
    assert m.attitude[2] == pytest.approx(2 * math.pi - 3.1)
    state[0] = 99.0
    assert m.position[0] == 0.0  # a measurement does not change afterwards
