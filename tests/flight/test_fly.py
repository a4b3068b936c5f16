"""Whole flights: the demonstration mission and what can go wrong, against the numbers that a user is promised."""

import math
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr

import mufly
from mufly.control import FlightController, design_flight_controller
from mufly.flight import (
    FlightProgress,
    fly_mission,
    read_attachments,
    read_events,
    read_recording,
    summarise_flight,
)
from mufly.mission import Mission, load_mission, parse_mission
from mufly.vehicle import Vehicle, load_vehicle, replace_parameters


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


@pytest.fixture(scope="module")
def demonstration(vehicle, controller, tmp_path_factory):
    """One flight of the demonstration: (mission, dataset, recording, progress reports)."""
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    seen: list[FlightProgress] = []
    mission = load_mission("demonstration")
    dataset = fly_mission(vehicle, mission, controller=controller, path=path, on_progress=seen.append)
    return mission, dataset, path, seen


def summary_of(mission: Mission, dataset: xr.Dataset):
    return summarise_flight(
        dataset,
        [w.position_m for w in mission.waypoint],
        read_events(dataset),
        take_off=(*mission.start_m, -mission.take_off.height_m),
        reach_m=mission.limits.reach_m,
        world=mission.world,
    )


def test_demonstration_keeps_its_promises(demonstration) -> None:
    mission, dataset, _, _ = demonstration
    s = summary_of(mission, dataset)
    assert (s.outcome, s.reason) == ("succeeded", "mission complete")
    assert s.waypoints_reached == 4
    for w in s.waypoints:
        assert w.distance_at_reach_m <= 0.05
        assert w.overshoot_m <= 0.03
    assert s.touchdown_speed_m_s < 0.3
    assert s.landing_distance_m < 0.10
    assert s.longest_railed_s <= 0.1


def test_states_follow_each_other_as_in_figure_6_15(demonstration) -> None:
    _, dataset, _, _ = demonstration
    states = dataset.mission_state.values
    changes = [str(states[0]), *(str(b) for a, b in pairwise(states) if a != b)]
    assert changes == ["take-off", "hover", *["waypoint", "hover"] * 4, "landing", "init"]


def test_waits_last_as_long_as_the_mission_says(demonstration) -> None:
    mission, dataset, _, _ = demonstration
    events = read_events(dataset)
    waits = [after.time_s - before.time_s for before, after in pairwise(events) if before.state == "hover"]
    wanted = [mission.take_off.wait_s, *(w.wait_s for w in mission.waypoint)]
    assert waits == pytest.approx(wanted, abs=0.021)  # the mission logic runs every 20 ms


def test_recording_on_disk_is_the_one_in_memory(demonstration) -> None:
    _, dataset, path, _ = demonstration
    read = read_recording(path)
    assert read.attrs["complete"] is True
    assert read.attrs["vehicle"] == "mufly-1.1"
    xr.testing.assert_equal(read, dataset)
    texts = read_attachments(path)
    assert set(texts) == {"mission.toml", "vehicle.toml"}


def test_attached_files_fly_the_same_flight(demonstration, tmp_path) -> None:
    _, dataset, path, _ = demonstration
    for name, text in read_attachments(path).items():
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    again = fly_mission(tmp_path / "vehicle.toml", tmp_path / "mission.toml")
    xr.testing.assert_equal(again.drop_attrs(), dataset.drop_attrs())


def test_charge_used_is_the_current_drawn(demonstration, vehicle) -> None:
    _, dataset, _, _ = demonstration
    used = np.trapezoid(dataset.battery_current.values, dataset.time.values)
    left = dataset.battery_charge.values
    assert used / float(vehicle.battery.capacity) == pytest.approx(left[0] - left[-1], rel=2e-3)


def test_progress_is_reported(demonstration) -> None:
    _, _, _, seen = demonstration
    assert len(seen) >= 3
    assert [p.time_s for p in seen] == sorted(p.time_s for p in seen)
    assert seen[-1].realtime_factor > 1
    assert all(0 < p.battery_charge <= 1 for p in seen)
    assert {p.state for p in seen} <= {"init", "take-off", "hover", "waypoint", "landing"}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("wind", [(0.5, 0.0, 0.0), (-0.3, 0.4, 0.0)])
def test_it_lands_in_wind_and_gusts(vehicle, controller, seed: int, wind) -> None:
    mission = load_mission("demonstration")
    dataset = fly_mission(vehicle, mission, controller=controller, wind=wind, gust=0.3, seed=seed)
    s = summary_of(mission, dataset)
    assert s.outcome == "succeeded"
    assert s.touchdown_speed_m_s < 0.3
    assert s.landing_distance_m < 0.10
    assert np.std(dataset.wind.values[:, 0]) > 0.1


def test_the_same_seed_flies_the_same_flight(vehicle, controller) -> None:
    short = parse_mission({"name": "hop", "waypoint": [{"position_m": [0.5, 0.0, -1.0]}]})
    flights = [fly_mission(vehicle, short, controller=controller, gust=0.3, seed=k) for k in (3, 3, 4)]
    assert np.array_equal(flights[0].truth_position.values, flights[1].truth_position.values)
    n = min(flights[0].sizes["time"], flights[2].sizes["time"])
    assert not np.array_equal(flights[0].truth_position.values[:n], flights[2].truth_position.values[:n])


def test_it_keeps_away_from_a_box_and_still_arrives(vehicle, controller) -> None:
    mission = load_mission("box-on-leg")
    s = summary_of(mission, fly_mission(vehicle, mission, controller=controller))
    assert s.outcome == "succeeded"
    assert s.waypoints_reached == s.waypoints_asked
    assert s.least_clearance_m >= 0.3


def test_a_blocked_way_is_said(vehicle, controller) -> None:
    walls = [
        {"name": "wall", "start_m": [1.5, -1.5], "end_m": [1.5, 1.5], "height_m": 2.0},
    ]
    room = {"north_m": [-1.5, 4.0], "east_m": [-1.5, 1.5]}
    mission = parse_mission(
        {
            "name": "closed",
            "waypoint": [{"position_m": [3.0, 0.0, -1.0]}],
            "wall": walls,
            "room": room,
            "avoidance": {"give_up_s": 20.0},
        }
    )
    dataset = fly_mission(vehicle, mission, controller=controller)
    assert dataset.attrs["outcome"] == "failed"
    assert "blocked by an obstacle" in dataset.attrs["reason"]
    s = summary_of(mission, dataset)
    assert s.least_clearance_m >= 0.3
    assert s.touchdown_speed_m_s < 0.3  # and it landed nevertheless


def test_flying_blind_into_a_box_is_a_crash(vehicle, controller) -> None:
    mission = load_mission("box-on-leg")
    blind = mission.model_copy(update={"avoidance": mission.avoidance.model_copy(update={"enabled": False})})
    dataset = fly_mission(vehicle, blind, controller=controller)
    assert dataset.attrs["outcome"] == "failed"
    assert "hit the crate" in dataset.attrs["reason"]


def test_low_battery_lands(vehicle, controller) -> None:
    mission = parse_mission(
        {"name": "thirsty", "waypoint": [{"position_m": [3.0, 0.0, -1.0]}], "battery": {"low_V": 7.19}}
    )
    tired = replace_parameters(vehicle, {"battery.internal_resistance": 0.45})
    dataset = fly_mission(tired, mission, controller=controller)
    assert dataset.attrs["outcome"] == "failed"
    assert "battery low" in dataset.attrs["reason"]
    assert abs(dataset.truth_position.values[-1, 2]) < 0.1  # on its legs


def test_stopping_leaves_a_readable_recording(vehicle, controller, tmp_path) -> None:
    path = tmp_path / "flight.mcap"

    def stop(progress: FlightProgress) -> None:
        if progress.time_s > 3.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fly_mission(vehicle, "demonstration", controller=controller, path=path, on_progress=stop)
    read = read_recording(path)
    assert read.attrs["outcome"] == "interrupted"
    assert read.time.values[-1] > 2.9


def test_realtime_keeps_pace_with_the_clock(vehicle, controller) -> None:
    import time

    hop = parse_mission(
        {
            "name": "hop",
            "take_off": {"height_m": 0.3, "wait_s": 0.0},
            "waypoint": [{"position_m": [0.0, 0.0, -0.3]}],
        }
    )
    began = time.perf_counter()
    dataset = fly_mission(vehicle, hop, controller=controller, realtime=True)
    assert time.perf_counter() - began >= dataset.time.values[-1] - 0.05


def test_actuators_act_one_period_after_their_measurement(vehicle, controller, monkeypatch) -> None:
    from mufly.flight import FlightSoftware, SimulatedPlant

    sent, acted = [], []
    step, advance = FlightSoftware.step, SimulatedPlant.advance_period

    def spy_step(self, measured, command):
        sent.append(step(self, measured, command))
        return sent[-1]

    def spy_advance(self, actuators):
        acted.append(actuators)
        advance(self, actuators)

    monkeypatch.setattr(FlightSoftware, "step", spy_step)
    monkeypatch.setattr(SimulatedPlant, "advance_period", spy_advance)
    hop = parse_mission({"take_off": {"height_m": 0.2, "wait_s": 0.0}, "waypoint": [{"position_m": [0.0, 0.0, -0.2]}]})
    dataset = fly_mission(vehicle, hop, controller=controller)
    assert np.all(acted[0].input_array == 0.0)
    assert all(a is b for a, b in zip(acted[1:], sent, strict=False))
    # The recording shows what acts, and half a second of rest.
    np.testing.assert_array_equal(dataset.motor_input.values[100], acted[200].motor_input)
    finished = next(
        t for t, text in zip(dataset.event_time.values, dataset.event_text.values, strict=True) if text == "landed"
    )
    assert dataset.time.values[-1] - finished == pytest.approx(0.5, abs=0.05)


def test_other_start_and_heading(vehicle, controller) -> None:
    mission = parse_mission(
        {
            "name": "elsewhere",
            "start_m": [2.0, -1.0],
            "start_heading_deg": 170.0,
            "waypoint": [{"position_m": [2.0, -2.0, -1.2], "heading_deg": -170.0, "wait_s": 1.0}],
        }
    )
    dataset = fly_mission(vehicle, mission, controller=controller)
    s = summary_of(mission, dataset)
    assert s.outcome == "succeeded"
    yaw = dataset.truth_attitude.values[:, 2]
    assert yaw[0] == pytest.approx(math.radians(170.0))
    assert yaw[-1] == pytest.approx(math.radians(190.0), abs=0.02)  # the short way round
    assert dataset.reference_attitude.values[-1, 2] == pytest.approx(yaw[-1], abs=0.05)


def test_the_lighter_prototype_flies_too() -> None:
    mission = load_mission("demonstration")
    s = summary_of(mission, fly_mission("mufly-2.0", mission))
    assert s.outcome == "succeeded"
    assert max(w.overshoot_m for w in s.waypoints) <= 0.03


IMPOSSIBLE = [
    ({"body.mass": 0.2}, "too heavy to hover"),
    ({"battery.capacity": 20.0}, "the battery lasts"),
]


@pytest.mark.parametrize(("change", "words"), IMPOSSIBLE)
def test_what_cannot_fly_is_refused_before_anything_runs(vehicle, tmp_path, change, words: str) -> None:
    path = tmp_path / "flight.mcap"
    with pytest.raises(mufly.MuflyError, match=words) as caught:
        fly_mission(replace_parameters(vehicle, change), "demonstration", path=path)
    assert "\n" not in str(caught.value)
    assert not path.exists()


def test_unreachable_height_is_refused(vehicle) -> None:
    high = parse_mission({"name": "high", "waypoint": [{"position_m": [0.0, 0.0, -500.0]}]})
    with pytest.raises(mufly.InputError, match=r"waypoint\[1\]"):
        fly_mission(vehicle, high)


def test_quick_parts_get_shorter_steps_and_absurd_ones_are_refused(vehicle) -> None:
    hop = parse_mission({"name": "hop", "waypoint": [{"position_m": [0.0, 0.0, -1.0]}]})
    quick = replace_parameters(vehicle, {"swash_plate.time_constant": 2e-4})
    assert fly_mission(quick, hop).attrs["outcome"] == "succeeded"
    with pytest.raises(mufly.MuflyError, match="too short to simulate"):
        fly_mission(replace_parameters(vehicle, {"swash_plate.time_constant": 1e-6}), hop)


def test_a_mission_that_returns_lands_where_it_stood(vehicle, controller) -> None:
    mission = parse_mission(
        {"name": "there and back", "waypoint": [{"position_m": [1.0, 0.5, -0.8]}], "at_end": "return"}
    )
    s = summary_of(mission, fly_mission(vehicle, mission, controller=controller))
    assert (s.outcome, s.reason, s.waypoints_reached) == ("succeeded", "mission complete", 1)
    assert s.landing_distance_m < 0.03


def test_a_mission_that_holds_does_so_until_the_battery_is_low(vehicle, controller) -> None:
    mission = parse_mission(
        {
            "name": "hold",
            "take_off": {"wait_s": 0.0},
            "waypoint": [{"position_m": [0.0, 0.0, -0.8]}],
            "at_end": "hover",
        }
    )
    used = replace_parameters(vehicle, {"battery.capacity": 0.1 * float(vehicle.battery.capacity)})
    dataset = fly_mission(used, mission, controller=controller)
    assert (dataset.attrs["outcome"], dataset.attrs["reason"]) == ("succeeded", "mission complete")
    assert any("battery low" in str(t) for t in dataset.event_text.values)
