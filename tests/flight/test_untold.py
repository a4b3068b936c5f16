"""Campaigns whose variations the filter knows nothing of: only the truth varies, and endings are classed by it."""

import json
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
import xarray as xr

from mufly.errors import InputError
from mufly.firmware import GenericFirmwareSoftware
from mufly.firmware.export.plan_tables import collect_plan_fields
from mufly.flight import fly_mission
from mufly.flight.monte_carlo import (
    ENDINGS,
    Campaign,
    FlightCase,
    ParameterVariation,
    WorkerPool,
    campaign_to_dict,
    compute_flight_result,
    parse_variations,
    results_dataset,
    run_campaign,
    summarise_outcome,
)
from mufly.flight.monte_carlo.flight_ending import mismodelled_sensors
from mufly.flight.simulated_flight import Flight
from mufly.mission import parse_mission
from mufly.quantities.sensor_table import READINGS
from mufly.sensors import FittedSensors
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

HOP = parse_mission(
    {
        "take_off": {"height_m": 0.4, "wait_s": 0.2},
        "waypoint": [{"position_m": [0.1, 0.0, -0.4], "wait_s": 0.1}],
    }
)
VEHICLE = load_vehicle("mufly-1.1")
(STANDARD,) = parse_variations(["standard"], VEHICLE)
NO_CASE = FlightCase(0, 7, {}, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return Campaign.create_checked(
        VEHICLE, HOP, variations=(STANDARD,), wind=0.2, gust=0.1, seed=4, fast_controllers=GenericFirmwareSoftware
    )


def value_span(variation: ParameterVariation, key: str) -> tuple[float, float]:
    """Least and greatest value of a uniform parameter."""
    k = variation.keys.index(key)
    half = np.abs(variation.spread_matrix[k]).sum()
    return variation.nominal_values[k] - half, variation.nominal_values[k] + half


# Ranges of percent, and the standard set


def test_a_range_of_percent_is_a_share_of_the_vehicles_value() -> None:
    (wander,) = parse_variations(["sensors.position_fix.drift=50:300%"], VEHICLE)
    np.testing.assert_allclose(value_span(wander, "sensors.position_fix.drift"), (0.015, 0.09))
    rng = np.random.default_rng(2)
    drawn = [
        wander.parameter_values(wander.draw_normalised_variables(rng))["sensors.position_fix.drift"]
        for _ in range(4000)
    ]
    np.testing.assert_allclose(np.percentile(drawn, [0, 25, 50, 75, 100]), np.linspace(0.015, 0.09, 5), atol=0.002)
    (hub,) = parse_variations(["rotors.upper.hub_z=50:150%"], VEHICLE)  # negative: above
    np.testing.assert_allclose(value_span(hub, "rotors.upper.hub_z"), (-0.1365, -0.0455))
    # A share also of what has no unit, and of each parameter of a table.
    (lost,) = parse_variations(["sensors.position_fix.dropout_probability=50:100%"], VEHICLE)
    np.testing.assert_allclose(value_span(lost, "sensors.position_fix.dropout_probability"), (0.01, 0.02))
    (sonar,) = parse_variations(["sensors.sonar=50:200%"], VEHICLE)
    assert sonar.variable_count == len(sonar.keys) == 8


def test_equal_ends_give_a_fixed_value_that_draws_nothing() -> None:
    (double,) = parse_variations(["sensors.position_fix.noise=200:200%"], VEHICLE)
    assert double.variable_count == 0
    assert double.parameter_values(np.zeros(0)) == {"sensors.position_fix.noise": pytest.approx(0.01)}


def test_the_standard_set_draws_all_together_and_gives_way_to_what_is_asked_for() -> None:
    told = {p.key: p.value for p in list_parameters(VEHICLE)}
    for key, span in {
        "body.mass": (0.85, 1.15), "rotors.lower.thrust_coefficient": (0.85, 1.15), "sensors.sonar.noise": (0.5, 3.0),
        "sensors.position_fix.period": (1.0, 3.0), "sensors.imu.gyro_noise_density": (0.5, 2.0),
    }.items():  # fmt: skip
        np.testing.assert_allclose(value_span(STANDARD, key), np.multiply(span, told[key]))
    np.testing.assert_allclose(value_span(STANDARD, "sensors.position_fix.latency"), (0.2, 0.35))
    np.testing.assert_allclose(value_span(STANDARD, "sensors.imu.mount_pitch"), np.radians([-3.0, 3.0]))
    drawn = STANDARD.parameter_values(STANDARD.draw_normalised_variables(np.random.default_rng(0)))
    assert all(drawn[key] != told[key] for key in STANDARD.keys)
    standard, mass = parse_variations(["standard", "m=30%"], VEHICLE)
    assert "body.mass" not in standard.keys
    assert mass.keys == ("body.mass",)
    assert VEHICLE.sensors is not None
    deaf = VEHICLE.model_copy(update={"sensors": VEHICLE.sensors.model_copy(update={"sonar": None})})
    (without,) = parse_variations(["standard"], deaf)
    assert set(STANDARD.keys) - set(without.keys) == {
        f"sensors.sonar.{n}" for n in ("noise", "dropout_probability", "multipath_probability")
    }


# Only the truth varies


def software_record(flight: Flight) -> bytes:
    """Everything that filter, fault detection, controllers and mission plan are made of."""
    software, estimator = flight.autopilot.software, cast(Any, flight.estimator)
    gains, settings = software._controller, estimator.backend.settings
    return b"".join([
        *(np.asarray(settings[name]).tobytes() for name in settings.dtype.names),  # without the bytes between fields
        estimator._parameters.tobytes(),
        *(part.tobytes() for part in (gains.heave_yaw_gains, gains.roll_pitch_gains, gains.position_gains)),
        gains.motor_trim.tobytes(),
        json.dumps(collect_plan_fields(software.plan), sort_keys=True,
        default=lambda x: np.asarray(x).tolist()).encode(),
    ])  # fmt: skip


def truth_record(flight: Flight) -> bytes:
    """Everything that the true helicopter and its sensors are made of."""
    found: list[bytes] = [flight.plant.packed_parameters.tobytes(), flight.plant.state.tobytes()]

    def collect(value: Any) -> None:
        if isinstance(value, np.ndarray):
            found.append(value.tobytes())
        elif isinstance(value, tuple):
            for part in value:
                collect(part)

    for faulty in cast(FittedSensors, flight.sensors)._fitted.values():
        for value in vars(faulty.sensor).values():
            collect(value)
    return b"".join(found)


@pytest.fixture(scope="module")
def nominal(campaign: Campaign) -> tuple[bytes, bytes]:
    flight = Flight(**campaign.make_flight_arguments(NO_CASE))
    return software_record(flight), truth_record(flight)


def varied_case(key: str) -> FlightCase:
    return replace(NO_CASE, parameter_values={key: value_span(STANDARD, key)[1]})


@pytest.mark.parametrize("key", STANDARD.keys)
def test_an_untold_parameter_changes_the_truth_and_no_bit_of_the_software(
    campaign: Campaign, nominal: tuple[bytes, bytes], key: str
) -> None:
    flight = Flight(**campaign.make_flight_arguments(varied_case(key)))
    assert software_record(flight) == nominal[0]
    assert truth_record(flight) != nominal[1]


@pytest.mark.parametrize(
    "key", ["body.mass", "sensors.position_fix.drift", "sensors.position_fix.latency", "sensors.sonar.noise"]
)
def test_a_told_parameter_changes_the_software(campaign: Campaign, nominal: tuple[bytes, bytes], key: str) -> None:
    told = replace(campaign, redesign=True, controller=None)
    flight = Flight(**told.make_flight_arguments(varied_case(key)))
    assert software_record(flight) != nominal[0]
    assert key in told.keys_known_on_board
    # The mounting is no parameter of any filter.
    assert told.keys_unknown_on_board == [f"sensors.imu.mount_{axis}" for axis in ("pitch", "roll", "yaw")]


def test_the_campaign_says_what_is_untold(campaign: Campaign) -> None:
    described = campaign_to_dict(campaign)
    assert (described["vary"], described["told"]) == (["standard"], [])
    assert described["untold"] == sorted(STANDARD.keys)
    assert campaign.describe_onboard_knowledge() == "33 varied parameters untold"
    told = replace(campaign, redesign=True)
    assert told.describe_onboard_knowledge() == "3 varied parameters untold and 30 varied parameters told"
    assert told.settings_hash != campaign.settings_hash


def test_a_small_untold_campaign_flies_safely(campaign: Campaign) -> None:
    with WorkerPool(1) as crew:
        flights = run_campaign(campaign, 4, crew=crew)
    assert all(set(f.values) == set(STANDARD.keys) for f in flights)
    assert {f.ending for f in flights} <= {"succeeded", "landed", "not started"}, [
        (f.ending, f.reason) for f in flights
    ]
    told = summarise_outcome(flights, 0.3)
    by_name = {name: (count, high) for name, count, _, high in told.endings}
    count, high = by_name["tipped over"]
    assert count == 0
    assert high == pytest.approx(0.4899, abs=1e-4)  # Wilson: z^2 / (n + z^2)
    table = results_dataset(flights, campaign)
    assert table.ending.values.tolist() == [f.ending for f in flights]
    assert "sensors.imu.mount_roll" in table.attrs["untold"]


# Endings


def ended(data: xr.Dataset, reason: str = "", **last: object) -> xr.Dataset:
    """With another last instant, and failed for a reason."""
    for name, values in last.items():
        other = data[name].values.copy()
        other[-1] = values
        data = data.assign({name: data[name].copy(data=other)})
    return data.assign_attrs(outcome="failed", reason=reason) if reason else data


@pytest.mark.parametrize(("roll", "pitch"), [(0.02, -0.03), (-0.03, 0.06)])  # below and above what is turned level
def test_a_turn_shows_the_axis_error_of_the_inertial_unit(roll: float, pitch: float) -> None:
    """Half a turn at 1 rad/s: the leak of the yaw rate into the other axes is learned, and forgotten with the turn."""
    half_turn = parse_mission(
        {
            "take_off": {"height_m": 0.5, "wait_s": 0.2},
            "waypoint": [{"position_m": [0.0, 0.0, -0.5], "heading_deg": 180.0, "wait_s": 1.0}],
        }
    )
    turning = Campaign.create_checked(
        VEHICLE, half_turn, variations=(STANDARD,), wind=0.2, gust=0.1, seed=5, fast_controllers=GenericFirmwareSoftware
    )
    mount = {"sensors.imu.mount_roll": roll, "sensors.imu.mount_pitch": pitch}
    squares = []  # of a single flight 0.3 to 4
    for seed in range(6):
        flown = fly_mission(**turning.make_flight_arguments(replace(NO_CASE, seed=seed, parameter_values=mount)))
        turned = np.flatnonzero(np.abs(flown.truth_rates[:, 2].to_numpy()) > 0.5)
        flown = flown.isel(time=slice(turned[0], turned[-1] + 200))
        error = (flown.estimated_attitude - flown.truth_attitude).to_numpy()[:, :2]
        squares.append(np.square(error / flown.estimated_attitude_sigma.to_numpy()[:, :2]).mean())
    assert np.mean(squares) < 1.5


def test_endings_are_classed_by_the_truth(campaign: Campaign) -> None:
    data = fly_mission(VEHICLE, HOP, controller=campaign.controller, brief=True)
    common: dict[str, Any] = {"index": 0, "seed": 0, "refused": 0, "wind": None, "values": {}}

    def ending(recording: xr.Dataset, wrong: tuple[str, ...] = ()) -> str:
        flown = compute_flight_result(recording, HOP, 0.3, wrong=wrong, **common)
        assert flown.ending in ENDINGS
        assert flown.success == (flown.ending == "succeeded")
        return flown.ending

    blamed = ended(data, "measurement lost: position (sonar is rejected: differs from the estimate by 0.5 m)")
    assert ending(data) == "succeeded"
    assert ending(blamed, ("sonar",)) == "landed"
    assert ending(blamed, ("gyroscope",)) == "landed, wrong reason"
    assert ending(ended(data, "waypoint 1 not reached within 20 s: 0.40 m away")) == "landed"
    assert (
        ending(ended(data, truth_position=data.truth_position.values[-1] + [1.0, 0.0, 0.0])) == "landed, wrong reason"
    )
    assert ending(ended(data, "tipped over, motors off")) == "landed, wrong reason"  # upright in truth
    assert ending(ended(data, "tipped over: a rotor touched the floor at [0, 0, 0] m, 3 s")) == "tipped over"
    assert ending(ended(blamed, truth_attitude=[0.5, 0.0, 0.0]), ("sonar",)) == "tipped over"
    assert ending(ended(data, "a rotor hit the wall 3 at [1.0, 2.0, 0.0] m, 3 s")) == "hit"
    assert ending(ended(blamed, truth_velocity=[1.0, 0.0, 0.0])) == "lost"
    assert ending(ended(blamed, motor_input=[0.3, 0.3])) == "lost"
    stays = ended(
        data.isel(time=slice(0, 3)), "it was not ready within 15 s", motor_input=[0, 0], truth_velocity=[0, 0, 0]
    )
    assert ending(stays) == "not started"


def test_a_sensor_may_be_accused_if_its_errors_differ_from_the_file() -> None:
    filed = {p.key: p.value for p in list_parameters(VEHICLE)}
    words = {row.source for row in READINGS.values() if row.source}

    def accusable(*faults: str, **values: float) -> frozenset[str]:
        found = mismodelled_sensors(faults, {f"sensors.{k.replace('__', '.')}": v for k, v in values.items()}, filed)
        assert found <= words
        return found

    assert accusable() == frozenset()
    assert accusable("position.jump", "gyro.bias@3s") == {"position fix", "gyroscope"}
    assert accusable(position_fix__drift=0.06) == {"position fix"}
    assert accusable(position_fix__drift=0.03) == frozenset()  # as filed
    assert accusable(imu__gyro_noise_density=1.0, sonar__noise=1.0) == {"gyroscope", "sonar"}
    assert accusable(imu__mount_roll=0.01) == {"accelerometer", "gyroscope"}
    assert mismodelled_sensors((), {"body.mass": 0.2}, filed) == frozenset()


def test_a_mounting_angle_out_of_range_is_refused() -> None:
    with pytest.raises(InputError, match=r"sensors.imu.mount_roll: .*out of range"):
        replace_parameters(VEHICLE, {"sensors.imu.mount_roll": 0.7})


def test_the_vehicles_of_the_documents_have_no_mounting_error() -> None:
    assert isinstance(VEHICLE, Vehicle)
    assert all(p.value == 0.0 for p in list_parameters(VEHICLE) if p.key.startswith("sensors.imu.mount_"))
