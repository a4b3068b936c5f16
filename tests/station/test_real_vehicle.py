"""Stations against the real vehicle link and a simulated helicopter, over damaged channels, in stepped time."""

from __future__ import annotations

import numpy as np
import pytest
from mock_vehicle import Channel

from mufly.control import design_flight_controller
from mufly.flight import Flight, read_recording
from mufly.flight.tunable_parameters import TUNABLE_PARAMETERS
from mufly.link import VehicleLink
from mufly.logs import read_log
from mufly.mission import Mission, parse_mission
from mufly.mission.files.mission_items import MissionItem
from mufly.station import GroundLink, StationRecorder
from mufly.vehicle import load_vehicle

OURS = (251, 190)
WORST = {"loss": 0.3, "delay_s": 0.3, "doubles": 0.2}
SQUARE = {
    "name": "two points",
    "take_off": {"height_m": 0.6, "wait_s": 0.5},
    "waypoint": [
        {"position_m": [0.6, 0.0, -0.6], "wait_s": 0.5, "heading_deg": 90.0},
        {"position_m": [0.6, 0.4, -0.8]},
    ],
}


@pytest.fixture(scope="module")
def helicopter():
    vehicle = load_vehicle("mufly-1.1")
    return vehicle, design_flight_controller(vehicle)


class Scene:
    """One simulated vehicle and stations around it, each behind channels of its own."""

    def __init__(self, helicopter, stations=1, seed=0, mission=None, **damage):
        vehicle, controller = helicopter
        self.flight = Flight(vehicle, mission or Mission(), controller=controller, keep=False)
        self.link = VehicleLink(self.flight)
        self.stations = [GroundLink((OURS[0] + k, OURS[1])) for k in range(stations)]
        self.up = [Channel(seed + 2 * k, **damage) for k in range(stations)]
        self.down = [Channel(seed + 2 * k + 1, **damage) for k in range(stations)]
        self.t = 50.0
        for k in range(stations):
            self.link.add_peer(self.t, f"station {k}")

    def run(self, seconds, until=None):
        begin = self.t
        while self.t < begin + seconds:
            self.t += self.flight.period_s
            for k in range(len(self.stations)):
                for data in self.up[k].arrived(self.t):
                    self.link.process_bytes(self.t, f"station {k}", data)
            self.flight.step_period()
            for peer, data in self.link.take_due_frames(self.t):
                self.down[int(str(peer).split()[1])].send(self.t, data)
            for k, station in enumerate(self.stations):
                for data in self.down[k].arrived(self.t):
                    station.process_bytes(self.t, "vehicle", data)
                for _, data in station.take_due_frames(self.t):
                    self.up[k].send(self.t, data)
            if until is not None and until():
                return self.t - begin
        assert until is None, f"it did not come in {seconds} s"
        return seconds

    def vehicle(self, k=0, seconds=40.0):
        def ready():
            found = self.stations[k].vehicles
            return (
                found
                and found[0].parameters
                and not found[0].missing_parameter_count
                and (found[0].transfers.items is not None)
            )

        self.run(seconds, ready)
        return self.stations[k].vehicles[0]

    def answer(self, request, seconds=30.0):
        self.run(seconds, lambda: request.is_done)
        return request.outcome.value, request.answer


def by_sticks(scene, vehicle):
    """A pilot's sticks: followed while they are held, let go with a word, or without one when they fall silent."""
    assert scene.answer(vehicle.fly_manually()) == ("refused", "no stick input")

    def holding(*at, until):
        return lambda: vehicle.sticks.set_deflections(*at) and until(vehicle.snapshot)

    def take_up():
        vehicle.sticks.set_deflections(0.0, 0.0, 0.0, 0.0)
        request = vehicle.fly_manually()
        scene.run(3.0, holding(0, 0, 0, 0, until=lambda s: s.state == "rc" and request.is_done))
        assert request.outcome.value == "accepted"

    take_up()
    east, tilt = vehicle.snapshot.estimate.position[1], vehicle.parameters["STK_TILT"].value
    half = holding(0.5, 0, 0, 0, until=lambda s: s.estimate.position[1] > east + 0.1)
    scene.run(6.0, half)
    asked = np.degrees(vehicle.snapshot.reference_attitude[0])  # a middle of 3 % is dead
    yaw = vehicle.snapshot.estimate.attitude[2]
    assert asked == pytest.approx(tilt * (0.5 - 0.03) / 0.97, abs=0.1)
    assert abs(yaw - 0.5) < 0.2  # it looks ahead, so right is about east
    down = vehicle.snapshot.estimate.position[2]
    scene.run(6.0, holding(0, 0, -0.5, 0, until=lambda s: s.estimate.position[2] > down + 0.1))
    assert not vehicle.sticks.set_deflections(0.0, np.nan, 0.0, 0.0)
    request = vehicle.release_sticks()
    assert scene.answer(request) == ("accepted", "")
    assert vehicle.release_sticks() is None
    scene.run(1.0, lambda: vehicle.snapshot.state == "hover")

    take_up()
    assert 0.3 < scene.run(1.5, lambda: vehicle.snapshot.state == "hover") < 1.0  # sooner than its own time-out
    assert "stick input lost" in vehicle.status_messages[-2].text + vehicle.status_messages[-1].text
    scene.run(1.0)
    assert vehicle.snapshot.state == "hover"


def test_a_flight_by_hand(helicopter, tmp_path):
    scene = Scene(helicopter)
    recorder = StationRecorder(tmp_path)
    recorder.start_recording()
    scene.stations[0]._on_vehicle = recorder.attach_vehicle
    scene.stations[0]._on_packet = recorder.record_packet
    vehicle = scene.vehicle()
    assert vehicle.kind == "mufly"
    assert set(TUNABLE_PARAMETERS) <= set(vehicle.parameters)
    assert vehicle.parameters["LIM_SPEED"].unit == "m/s"
    scene.run(2.0)
    failed = [c for c in vehicle.preflight_checks if c.ok is False]
    assert failed == []

    assert scene.answer(vehicle.take_off(0.7)) == ("accepted", "")
    scene.run(10.0, lambda: vehicle.snapshot.state == "hover")
    scene.run(1.0)
    s = vehicle.snapshot
    assert (s.flying, s.armed, s.in_command, s.commander) == (True, True, True, "this station")
    assert s.estimate.position[2] == pytest.approx(-0.7, abs=0.1)
    assert (s.actuators.motor_input > 0.5).all()
    assert (s.rotor_speed > 300.0).all()
    assert len(s.estimate.ranges) == 8
    assert 100.0 < s.link_rate_Hz < 1500.0
    assert s.link_loss == 0.0

    assert scene.answer(vehicle.go_to((0.5, -0.3, -0.8), 0.5)) == ("accepted", "")
    vehicle.add_mark("half way")
    scene.run(15.0, lambda: np.linalg.norm(vehicle.snapshot.estimate.position - [0.5, -0.3, -0.8]) < 0.05)
    by_sticks(scene, vehicle)
    assert scene.answer(vehicle.land()) == ("accepted", "")
    scene.run(15.0, lambda: not vehicle.snapshot.armed)
    assert not vehicle.snapshot.flying
    recorder.stop_recording()

    times, values = vehicle.history.recent_rows(
        600.0, ["estimated_position_N", "truth_position_N", "measured_position_N"]
    )
    assert np.median(np.diff(times)) == pytest.approx(0.01, abs=0.002)
    steady = np.isfinite(values).all(axis=1)
    assert steady.mean() > 0.9
    assert np.abs(values[steady] - values[steady][:, :1]).max() < 0.02

    data = read_recording(recorder.path / "station.mcap")
    assert data.attrs["complete"]
    assert any("half way" in text for text in data["event_text"].values.tolist())
    assert float(data["estimated_position"].sel(axis="D").min()) == pytest.approx(-0.8, abs=0.1)
    assert "landing" in data["mission_state"].values.tolist()
    log = read_log(recorder.path / "station.tlog")
    assert "measured_position" in log


def test_a_mission_over_the_worst_link(helicopter):
    scene = Scene(helicopter, seed=5, **WORST)
    vehicle = scene.vehicle(seconds=120.0)
    assert scene.answer(vehicle.upload_mission(parse_mission(SQUARE)), 120.0)[0] == "accepted"
    assert [row.action for row in vehicle.mission_rows] == ["take off", "waypoint", "waypoint", "land"]
    assert scene.answer(vehicle.start_mission(), 60.0)[0] == "accepted"
    scene.run(5.0, lambda: vehicle.snapshot.mission_running)  # already while the rotors come up to speed
    assert not vehicle.snapshot.flying
    scene.run(60.0, lambda: vehicle.snapshot.state == "hover" and vehicle.passed_row_count == 1)
    assert vehicle.snapshot.mission_running  # a wait of the mission's own is no pause
    assert scene.answer(vehicle.pause(), 60.0)[0] == "accepted"
    scene.run(5.0, lambda: vehicle.snapshot.mission_begun and not vehicle.snapshot.mission_running)
    assert scene.answer(vehicle.start_mission(), 60.0)[0] == "accepted"
    scene.run(60.0, lambda: vehicle.passed_row_count >= 3)
    scene.run(30.0, lambda: not vehicle.snapshot.armed)
    scene.run(5.0, lambda: not vehicle.snapshot.mission_begun)
    assert scene.flight.autopilot.status.outcome == "succeeded"
    assert scene.answer(vehicle.clear_mission(), 60.0)[0] == "accepted"
    scene.run(3.0)
    assert vehicle.mission_rows == []


def test_a_mission_that_cannot_be_flown_is_refused_in_the_vehicles_words(helicopter):
    scene = Scene(helicopter)
    vehicle = scene.vehicle()
    outcome, answer = scene.answer(
        vehicle.transfers.upload_items([MissionItem(0, 1, 22, z=-1.0), MissionItem(1, 1, 16, x=10_000, z=3.0)])
    )
    assert outcome == "refused"
    assert "height" in answer


def test_a_second_station_watches_and_takes_over_after_release(helicopter):
    scene = Scene(helicopter, stations=2)
    first, second = scene.vehicle(0), scene.vehicle(1)
    assert scene.answer(first.take_off(0.6)) == ("accepted", "")
    scene.run(1.5)
    assert first.snapshot.in_command
    assert not second.snapshot.in_command
    assert second.snapshot.commander == "station 251 (component 190)"
    outcome, answer = scene.answer(second.land())
    assert outcome == "refused"
    assert "has operator control" in answer
    assert scene.answer(second.request_operator_control())[0] == "refused"
    assert scene.answer(first.release_operator_control())[0] == "accepted"
    assert scene.answer(second.request_operator_control())[0] == "accepted"
    scene.run(1.5)
    assert second.snapshot.in_command
    assert not first.snapshot.in_command
    scene.run(10.0, lambda: second.snapshot.state == "hover")
    assert scene.answer(second.land())[0] == "accepted"
    assert scene.answer(first.emergency_stop())[0] == "accepted"  # from anyone
    scene.run(0.5)
    assert (scene.flight.status.actuators.motor_input == 0.0).all()


def test_a_parameter_is_tuned_and_its_bounds_hold(helicopter):
    scene = Scene(helicopter)
    vehicle = scene.vehicle()
    assert scene.answer(vehicle.set_parameter("LIM_SPEED", 0.3)) == ("accepted", "")
    assert scene.flight.autopilot.parameters["LIM_SPEED"].value == 0.3
    assert scene.answer(vehicle.set_parameter("LIM_SPEED", 50.0))[0] == "refused"
    assert vehicle.parameters["LIM_SPEED"].value == 0.3


def test_a_simulation_begins_anew(helicopter):
    scene = Scene(helicopter)
    vehicle = scene.vehicle()
    scene.run(4.0)
    assert scene.answer(vehicle.reboot())[0] == "accepted"
    scene.run(6.0)
    assert vehicle.snapshot.connected
    times, _ = vehicle.history.recent_rows(600.0)
    assert (np.diff(times) > 0).all()
    assert np.isfinite(vehicle.snapshot.estimate.position).all()
