"""Ideal sensors against plane geometry."""

import math

import numpy as np
import pytest

from mufly import load_vehicle
from mufly.dynamics import DrydenWind, initial_state
from mufly.flight import Actuators, SimulatedPlant
from mufly.sensors import beam_angles, beam_directions, make_ideal_sensors
from mufly.sensors.readings import measure_ranges
from mufly.vehicle import replace_parameters
from mufly.world import Box, World


def test_beams_look_as_in_figure_6_18() -> None:
    vehicle = load_vehicle("mufly-2.0")
    assert beam_angles(vehicle) == pytest.approx([i * math.pi / 4 + math.pi / 8 for i in range(8)])
    assert np.linalg.norm(beam_directions(vehicle), axis=1) == pytest.approx(1.0)


def test_a_beam_ahead_sees_the_wall_ahead_and_turns_with_the_heading() -> None:
    vehicle = replace_parameters(load_vehicle("mufly-2.0"), {"range_ring.first_angle": 0.0})
    directions = beam_directions(vehicle)
    world = World(boxes=(Box((1.5, 0.0, -1.0), (1.0, 10.0, 2.0)),))  # its face is at N = 1

    def ranges(**state):
        seen = np.empty(len(directions))
        measure_ranges(initial_state(**state), directions, 0.3, 1.5, *world.packed_tables, seen)
        return seen

    ahead = ranges(position=(0, 0, -1))
    assert ahead[0] == pytest.approx(1.0)
    assert ahead[1] == pytest.approx(math.sqrt(2.0))
    assert ahead[4] == 1.5
    turned = ranges(position=(0, 0, -1), attitude=(0, 0, math.pi / 4))
    assert turned[7] == pytest.approx(1.0)
    tilted = ranges(position=(0, 0, -1), attitude=(0, math.radians(20), 0))
    assert tilted[0] == pytest.approx(1.0 / math.cos(math.radians(20)))
    close = ranges(position=(0.9, 0, -1))
    assert close[0] == 0.3


def test_true_yaw_is_continuous_and_readings_do_not_change_afterwards() -> None:
    vehicle = load_vehicle("mufly-2.0")
    plant = SimulatedPlant(vehicle, World(), DrydenWind(step_s=0.005), 200.0, initial_state(attitude=(0.0, 0.0, 3.1)))
    plant.state[6:10] = initial_state(attitude=(0.0, 0.0, -3.1))[6:10]
    readings = make_ideal_sensors(vehicle, World()).read(plant.truth)
    assert readings["attitude"].value[2] == pytest.approx(2 * math.pi - 3.1)
    plant.state[0] = 99.0
    assert readings["position"].value[0] == 0.0


def test_the_ring_is_read_at_its_own_rate_and_says_when() -> None:
    vehicle = load_vehicle("mufly-2.0")
    plant = SimulatedPlant(vehicle, World(), DrydenWind(step_s=0.005), 200.0, initial_state(position=(0, 0, -1)))
    sensors = make_ideal_sensors(vehicle, World(), ring_every=8)
    seen = []
    for _ in range(17):
        seen.append(sensors.read(plant.truth))
        plant.advance_period(Actuators.make_zero_inputs())
    assert [r["ranges"].time_s for r in seen] == [0.0] * 8 + [0.04] * 8 + [0.08]
    assert seen[1]["ranges"] is seen[0]["ranges"]
    assert all(r["position"].time_s == r.time_s for r in seen)
