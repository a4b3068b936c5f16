"""The seam: sensors give readings, an estimator makes an estimate of them, and the flight software flies by that."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.estimate import ZERO_COVARIANCE, Estimate, Estimator, IdealEstimator, check_estimate
from mufly.flight import Flight, fly_mission
from mufly.mission import parse_mission
from mufly.sensors import (
    IdealBatterySensor,
    IdealMotionSensor,
    IdealRangeRing,
    Reading,
    Readings,
    Sensor,
    SensorSet,
    Truth,
    make_ideal_sensors,
)
from mufly.vehicle import Vehicle, load_vehicle
from mufly.world import World

HOP = parse_mission({"waypoint": [{"position_m": [0.5, 0.0, -1.0], "wait_s": 0.5}]})


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


def readings(time: float = 1.0, **changes: object) -> Readings:
    latest = {
        "position": Reading(np.array([1.0, 2.0, -3.0]), time),
        "velocity": Reading(np.array([0.1, 0.2, 0.3]), time),
        "attitude": Reading(np.array([0.01, 0.02, 7.0]), time),
        "rates": Reading(np.array([0.4, 0.5, 0.6]), time),
        "ranges": Reading(np.full(8, 1.5), time),
        "battery_voltage": Reading(7.4, time),
    }
    return Readings(time, {k: v for k, v in (latest | changes).items() if v is not None})


def test_the_ideal_estimator_passes_on_what_it_is_told() -> None:
    given = readings()
    e = IdealEstimator().update(given)
    for name in ("position", "velocity", "attitude", "rates", "ranges", "battery_voltage"):
        assert getattr(e, name) is given[name].value
    assert (e.time_s, e.valid) == (1.0, True)
    assert e.covariance is ZERO_COVARIANCE


def test_what_no_sensor_reads_is_lost_and_what_is_not_valid_is_not_believed() -> None:
    good = check_estimate(None, IdealEstimator().update(readings()), 0.005, 1.5)
    missing = IdealEstimator().update(readings(1.005, velocity=None, ranges=None))
    w = check_estimate(good, missing, 0.005, 1.5)
    assert (w.lost_quantities, w.lost_s) == ("velocity", 0.005)
    np.testing.assert_array_equal(w.last_good.velocity, [0.1, 0.2, 0.3])
    assert (w.last_good.ranges == 1.5).all()
    doubted = IdealEstimator().update(readings(1.005, position=Reading(np.full(3, 9.0), 1.005, valid=False)))
    assert not doubted.valid
    w = check_estimate(good, doubted, 0.005, 1.5)
    assert w.lost_s == 0.005
    np.testing.assert_array_equal(w.last_good.position, [1.0, 2.0, -3.0])


@pytest.mark.parametrize("value", [1e6, -1e197, math.inf, math.nan])
def test_a_value_beyond_any_flight_is_replaced_as_a_missing_one(value: float) -> None:
    """The square of a velocity of 1e197 m/s is infinite, and a reference that stops from it is no number."""
    good = check_estimate(None, IdealEstimator().update(readings()), 0.005, 1.5)
    absurd = IdealEstimator().update(readings(1.005, velocity=Reading(np.array([0.1, value, 0.3]), 1.005)))
    w = check_estimate(good, absurd, 0.005, 1.5)
    assert (w.lost_quantities, w.lost_s) == ("velocity", 0.005)
    np.testing.assert_array_equal(w.last_good.velocity, [0.1, 0.2, 0.3])
    fast = IdealEstimator().update(readings(1.005, velocity=Reading(np.array([0.1, 9e5, 0.3]), 1.005)))
    assert check_estimate(good, fast, 0.005, 1.5).lost_s == 0.0


def test_nothing_is_known_of_an_estimate_that_was_not_made() -> None:
    e = Estimate()
    assert math.isnan(e.time_s)
    assert np.isnan([*e.position, *e.velocity, *e.attitude, *e.rates, e.battery_voltage]).all()


class RangeFinder(Sensor):
    """An ultrasonic sensor under the belly: height above the floor (m), with noise, ten times a second."""

    def __init__(self, noise_m: float) -> None:
        self._noise_m, self._random = noise_m, np.random.default_rng(3)

    def read(self, truth: Truth) -> dict[str, Reading]:
        if truth.tick % 20 == 0:
            height = -truth.position[2] + self._noise_m * self._random.normal()
            self._last = Reading(height, truth.time_s)
        return {"height": self._last}


class HeightFilter(Estimator):
    """Height by the range finder, carried on by the vertical speed in between; all else as it is told."""

    def __init__(self, gain: float) -> None:
        self._gain, self._ideal = gain, IdealEstimator()
        self._height, self._time_s, self._seen_s = math.nan, 0.0, -1.0

    def update(self, readings: Readings, acting: np.ndarray | None = None) -> Estimate:
        told = self._ideal.update(readings)
        heard = readings["height"]
        if math.isnan(self._height):
            self._height = heard.value
        self._height -= (readings.time_s - self._time_s) * told.velocity[2]
        if heard.time_s > self._seen_s:
            self._height += self._gain * (heard.value - self._height)
            self._seen_s = heard.time_s
        self._time_s = readings.time_s
        covariance = np.zeros((12, 12))
        covariance[2, 2] = 1e-4
        position = np.array([*told.position[:2], -self._height])
        return replace(told, position=position, covariance=covariance)


def test_a_sensor_with_noise_and_its_estimator_fly(vehicle: Vehicle, controller: FlightController) -> None:
    """What a new sensor and a new estimator take: one class each, and a flight that is given them."""
    sensors = SensorSet(
        IdealMotionSensor(), IdealRangeRing(vehicle, World(), 8), IdealBatterySensor(), RangeFinder(0.02)
    )
    with Flight(vehicle, HOP, controller=controller, sensors=sensors, estimator=HeightFilter(0.2)) as flight:
        flight.autopilot.arm(force=True)
        flight.autopilot.start_mission()
        for _ in range(round(15.0 / flight.period_s)):
            flight.step_period()
        now = flight.status
        assert now.truth is not None
        assert now.readings is not None
        assert now.estimate.covariance[2, 2] == 1e-4
        off = now.estimate.position[2] - now.truth.position[2]
        assert 0.0 < abs(off) < 0.03
        assert now.readings["height"].time_s == pytest.approx(now.time_s, abs=0.11)
    recording = flight.recorder.to_dataset()
    # The truth is recorded as the truth, and the readings as the readings, whatever the estimator makes of them.
    np.testing.assert_array_equal(recording.truth_position.values, recording.measured_position.values)


def test_the_default_pair_is_the_ideal_one(vehicle: Vehicle, controller: FlightController) -> None:
    one = fly_mission(vehicle, HOP, controller=controller, gust=0.3, seed=4)
    two = fly_mission(
        vehicle,
        HOP,
        controller=controller,
        gust=0.3,
        seed=4,
        sensors=make_ideal_sensors(vehicle, HOP.world, 8),
        estimator=IdealEstimator(),
    )
    np.testing.assert_array_equal(one.truth_position.values, two.truth_position.values)


class Broken(IdealEstimator):
    """Stands by nothing after a while."""

    def update(self, readings: Readings, acting: np.ndarray | None = None) -> Estimate:
        return replace(super().update(readings), valid=readings.time_s < 8.0)


def test_an_estimator_that_gives_up_ends_the_flight(vehicle: Vehicle, controller: FlightController) -> None:
    flown = fly_mission(vehicle, HOP, controller=controller, estimator=Broken())
    assert flown.attrs["outcome"] == "failed"
    assert "measurement lost" in flown.attrs["reason"]
