"""A flight that ticks: what it shows, what it records, what it needs of memory."""

import gc
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mufly.control import FlightController, design_flight_controller
from mufly.errors import InputError, MuflyError
from mufly.flight import Flight, fly_mission, read_recording, summarise_flight, summary_rows
from mufly.mission import parse_mission
from mufly.vehicle import Vehicle, load_vehicle

HOP = parse_mission(
    {
        "name": "hop",
        "take_off": {"height_m": 0.4, "wait_s": 0.2},
        "waypoint": [{"position_m": [0.3, 0.0, -0.4]}],
    }
)


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


def run(flight: Flight, seconds: float) -> None:
    for _ in range(round(seconds / flight.period_s)):
        flight.step_period()


def fly_it(flight: Flight) -> None:
    """As `fly_mission` does, from outside."""
    flight.autopilot.arm(force=True, quiet=True)
    assert flight.autopilot.start_mission()
    ended = None
    while ended is None or flight.time_s < ended + 0.5:
        flight.step_period()
        if ended is None and flight.autopilot.software.mission_state.finished:
            ended = flight.time_s


def test_a_flight_that_is_ticked_is_the_one_that_is_flown(vehicle, controller, tmp_path) -> None:
    path = tmp_path / "ticked.mcap"
    with Flight(vehicle, HOP, controller=controller, gust=0.3, seed=5, path=path) as flight:
        fly_it(flight)
    ticked = flight.recorder.to_dataset()
    xr.testing.assert_equal(ticked, read_recording(path))
    flown = fly_mission(vehicle, HOP, controller=controller, gust=0.3, seed=5)
    xr.testing.assert_equal(ticked.drop_attrs(), flown.drop_attrs())
    assert (ticked.attrs["outcome"], ticked.attrs["reason"]) == ("succeeded", "mission complete")


def test_what_is_seen_is_what_is_recorded(vehicle, controller) -> None:
    flight = Flight(vehicle, HOP, controller=controller)
    flight.autopilot.arm(force=True)
    flight.autopilot.start_mission()
    run(flight, 6.0)
    flight.step_period()
    now = flight.status
    flight.close()
    row = flight.recorder.to_dataset().isel(time=-1)
    assert float(row.time) == now.time_s == flight.time_s
    for name, value in {
        "truth_position": now.truth.position,
        "truth_velocity": now.truth.velocity,
        "truth_rates": now.truth.rates,
        "truth_rotor_speed": now.truth.rotor_speed,
        "measured_position": now.readings["position"].value,
        "reference_position": now.reference_position,
        "reference_velocity": now.reference_velocity,
        "reference_attitude": now.reference_attitude,
        "motor_input": now.actuators.motor_input,
        "servo_input": now.actuators.servo_input,
        "battery_voltage": now.truth.battery_voltage_V,
        "battery_charge": now.battery_charge,
        "wind": now.truth.wind,
        "range": now.readings["ranges"].value,
    }.items():
        np.testing.assert_array_equal(row[name].values, value, err_msg=name)
    np.testing.assert_allclose(row.truth_attitude.values, now.truth.attitude, atol=1e-12)


def test_a_state_does_not_change_afterwards(vehicle, controller) -> None:
    flight = Flight(vehicle, HOP, controller=controller, keep=False, gust=0.5)
    flight.step_period()
    now = flight.status
    before = now.truth.state.copy(), now.truth.wind.copy(), now.reference_position.copy()
    run(flight, 0.5)
    for a, b in zip(before, (now.truth.state, now.truth.wind, now.reference_position), strict=True):
        np.testing.assert_array_equal(a, b)


def test_time_left_is_about_what_the_battery_lasts(vehicle, controller) -> None:
    """Predicted at the start of a hover, and again later: the two have to differ by the time in between."""
    flight = Flight(vehicle, HOP, controller=controller, keep=False)
    run(flight, 0.05)
    assert 200.0 < flight.status.battery_left_s < 600.0
    assert flight.autopilot.arm()
    assert flight.autopilot.take_off(1.0)
    run(flight, 40.0)
    first = flight.status.battery_left_s
    run(flight, 60.0)
    assert first - flight.status.battery_left_s == pytest.approx(60.0, abs=12.0)


def test_commands_fly_it_and_the_recording_says_so(vehicle, controller, tmp_path) -> None:
    path = tmp_path / "commanded.mcap"
    with Flight(vehicle, HOP, controller=controller, path=path, keep=False) as flight:
        run(flight, 0.05)
        assert flight.autopilot.arm()
        assert flight.autopilot.take_off(0.5)
        run(flight, 7.0)
        flight.log_event("marked by hand", "warning")
        assert flight.autopilot.land()
        run(flight, 12.0)
    read = read_recording(path)
    texts = [str(t) for t in read.event_text.values]
    assert texts[:3] == ["ready for hop", "armed", "take-off signal, to 0.5 m"]
    assert "marked by hand" in texts
    assert texts[-1] == "landed"
    assert (read.attrs["outcome"], read.attrs["reason"]) == ("succeeded", "landed")
    with pytest.raises(MuflyError, match=r"not kept in memory; read .*commanded\.mcap"):
        flight.recorder.to_dataset()


def test_a_flight_by_hand_is_not_judged_by_the_waypoints_of_the_mission(vehicle, controller) -> None:
    goals = [w.position_m for w in HOP.waypoint]
    for start, asked in ((lambda a: a.take_off(0.4), 0), (lambda a: a.start_mission(), len(goals))):
        with Flight(vehicle, HOP, controller=controller) as flight:
            assert flight.autopilot.arm()
            assert start(flight.autopilot)
            run(flight, 6.0)
            assert flight.autopilot.land()
            run(flight, 6.0)
        summary = summarise_flight(flight.recorder.to_dataset(), goals)
        assert summary.waypoints_asked == asked
        assert (summary.landing_distance_m is None) is (asked == 0)
        assert ("Waypoints reached" in dict(summary_rows(summary))) is (asked > 0)


def test_a_flight_that_is_ended_early_says_so(vehicle, controller, tmp_path) -> None:
    path = tmp_path / "early.mcap"
    with Flight(vehicle, HOP, controller=controller, path=path) as flight:
        flight.autopilot.arm(force=True)
        flight.autopilot.take_off(0.5)
        run(flight, 2.0)
    read = read_recording(path)
    assert read.attrs["outcome"] == "unfinished"
    assert read.attrs["reason"] == "ended in state 'take-off'"
    with pytest.raises(KeyboardInterrupt):
        _interrupted(Flight(vehicle, HOP, controller=controller, path=path))
    assert read_recording(path).attrs["outcome"] == "interrupted"


def _interrupted(flight: Flight) -> None:
    with flight:
        run(flight, 1.5)
        raise KeyboardInterrupt


def test_reset_goes_back_to_the_start_and_the_clock_goes_on(vehicle, controller, tmp_path) -> None:
    path = tmp_path / "reset.mcap"
    with Flight(vehicle, HOP, controller=controller, path=path, keep=False) as flight:
        assert flight.autopilot.set_parameter("LIM_SPEED", 0.3)
        fly_it(flight)
        used = flight.status.battery_charge
        flight.reset()
        run(flight, 0.05)
        assert flight.status.battery_charge > used
        np.testing.assert_allclose(flight.status.truth.position[:2], 0.0, atol=1e-3)
        assert flight.autopilot.parameters["LIM_SPEED"].value == pytest.approx(0.3)
        fly_it(flight)
    read = read_recording(path)
    assert np.all(np.diff(read.time.values) > 0.0)
    assert [str(t) for t in read.event_text.values].count("landed") == 2


def test_memory_stays_flat_without_keeping_rows(vehicle, controller, tmp_path) -> None:
    with Flight(vehicle, HOP, controller=controller, path=tmp_path / "long.mcap", keep=False) as flight:
        flight.autopilot.arm(force=True)
        flight.autopilot.take_off(0.5)
        run(flight, 20.0)
        gc.collect()
        tracemalloc.start()
        run(flight, 4.0)
        gc.collect()
        first, _ = tracemalloc.get_traced_memory()
        run(flight, 16.0)
        gc.collect()
        second, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    # The index of the file grows by some hundred bytes a second; a second of rows alone would be 35 kB.
    assert second - first < 16 * 3000


def test_impossible_input_is_refused_before_anything_is_written(vehicle, controller, tmp_path) -> None:
    thirsty = parse_mission({"waypoint": [{"position_m": [0.0, 0.0, -1.0]}], "battery": {"low_V": 9.0}})
    path = tmp_path / "none.mcap"
    with pytest.raises(InputError, match=r"battery\.low_V"):
        Flight(vehicle, thirsty, controller=controller, path=path)
    assert not path.exists()


def test_the_example_in_the_documentation_flies(tmp_path, monkeypatch, capsys) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "missions.md").read_text(encoding="utf-8")
    example = text.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "docs/reference/missions.md", "exec"), {})
    assert capsys.readouterr().out.count("accepted=True") == 2
    assert read_recording(tmp_path / "flight.mcap").attrs["outcome"] == "succeeded"
