"""How level a helicopter stands: legs of unlike length, what truth shows of them, and what the filter is told."""

import math
from itertools import pairwise

import numpy as np
import pytest

from mufly.dynamics import (
    body_to_ned_matrix,
    initial_state,
    quaternion_from_euler,
    standing_attitude,
    standing_height,
)
from mufly.estimate import KalmanEstimator
from mufly.estimate.filter.filter_records import ERROR_ACCEL_BIAS, make_filter_settings
from mufly.flight import Flight
from mufly.quantities.units import GRAVITY
from mufly.sensors import Truth, make_fitted_sensors, randomise_leg_lengths
from mufly.vehicle import load_vehicle, replace_parameters
from mufly.world import World

VEHICLE = load_vehicle("mufly-2.0")


def legs(vehicle, tips):
    kept = vehicle.contact.legs.model_copy(update={"value": tuple(map(tuple, np.asarray(tips).tolist()))})
    return vehicle.model_copy(update={"contact": vehicle.contact.model_copy(update={"legs": kept})})


def test_legs_of_one_length_stand_upright():
    assert standing_attitude(VEHICLE) == (0.0, 0.0)


@pytest.mark.parametrize(("roll", "pitch"), [(0.02, 0.0), (0.0, -0.03), (0.1, 0.2)])
def test_turned_legs_stand_as_they_are_turned(roll, pitch):
    turned = legs(
        VEHICLE, VEHICLE.contact.legs.to_array() @ body_to_ned_matrix(quaternion_from_euler(roll, pitch, 0.0))
    )
    assert standing_attitude(turned) == pytest.approx((roll, pitch), abs=1e-12)
    assert standing_height(turned) == pytest.approx(standing_height(VEHICLE), abs=1e-12)


def test_tips_in_no_plane_are_taken_to_stand_upright():
    tips = VEHICLE.contact.legs.to_array()
    tips[0, 2] += 1e-3
    assert standing_attitude(legs(VEHICLE, tips)) == (0.0, 0.0)


def test_units_stand_as_level_as_the_file_says():
    stood = np.array([standing_attitude(randomise_leg_lengths(VEHICLE, seed=k)) for k in range(400)])
    told = float(VEHICLE.sensors.imu.standing_tilt_error)
    assert told == pytest.approx(math.radians(0.12))
    assert stood.std(axis=0) == pytest.approx([told, told], rel=0.1)
    assert np.abs(stood.mean(axis=0)).max() < 3 * told / math.sqrt(400)
    exact = replace_parameters(VEHICLE, {"sensors.imu.standing_tilt_error": 0.0})
    assert randomise_leg_lengths(exact, seed=3) is exact


def test_it_stands_still_as_it_leans_and_the_filter_does_not_know():
    lean = standing_attitude(randomise_leg_lengths(VEHICLE, seed=5))
    with Flight(VEHICLE, "demonstration", seed=5, sensors="fitted", keep=False) as flight:
        stands = []
        for _ in range(400):
            flight.step_period()
            stands.append(flight.status.truth)
        estimate = flight.status.estimate
    for before, after in pairwise(stands):
        assert np.abs(after.attitude - before.attitude).max() < 1e-6
    assert stands[-1].attitude[:2] == pytest.approx(lean, abs=2e-5)
    told = make_filter_settings(VEHICLE, World(), 200.0)
    level, bias = told["rest_tilt_sigma"], told["initial_sigma"][ERROR_ACCEL_BIAS] / GRAVITY
    assert level == float(VEHICLE.sensors.imu.standing_tilt_error)
    # Of what accelerometers say, bias and lean in one, it takes for lean what is to be expected of that.
    assert np.abs(estimate.attitude[:2]).max() < 3.0 * level**2 / np.hypot(level, bias)


def test_ideal_flights_stand_upright():
    with Flight(VEHICLE, "demonstration", seed=5, keep=False) as flight:
        flight.step_period()
        assert not flight.status.truth.attitude[:2].any()


def test_a_tilt_on_the_floor_is_off_by_the_lean_and_told_to_be() -> None:
    """The floor alone knows how it leans: that it does not move, however long, tells nothing of the tilt."""
    filter_, off, told = KalmanEstimator(VEHICLE, World(), 200.0), [], []
    for seed in range(16):
        unit = randomise_leg_lengths(VEHICLE, seed=seed)
        attitude = np.array([*standing_attitude(unit), 0.3])
        state = initial_state(position=(0.0, 0.0, -standing_height(unit)), attitude=attitude)
        sensors = make_fitted_sensors(unit, World(), seed=seed)
        filter_.reset()
        for k in range(300):
            truth = Truth(k / 200, k, state, attitude, np.zeros(3), 8.0, 0.1)
            m = filter_.update(sensors.read(truth), np.zeros(4))
        assert m.valid
        off.append(m.attitude[:2] - attitude[:2])
        told.append(m.covariance.diagonal()[6:8])
    leans = np.array([standing_attitude(randomise_leg_lengths(VEHICLE, seed=k)) for k in range(16)])
    # Its accelerometers' biases, 0.63 degrees, move it by 3.5 % of that, 0.18 of the lean
    assert np.corrcoef(np.ravel(off), -np.ravel(leans))[0, 1] > 0.85
    assert 0.98 < np.sqrt(np.mean(told)) / float(VEHICLE.sensors.imu.standing_tilt_error) < 1.05
    assert 0.5 < np.mean(np.square(off) / told) < 1.6
