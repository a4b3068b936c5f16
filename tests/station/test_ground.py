"""A station's end of a link against vehicles that a test steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mock_vehicle import MockVehicle, World, as_float

from mufly.link import Encoder, mavlink
from mufly.station import GroundLink, MissionRow, Outcome
from mufly.station.transfers import same_mission

ROWS = [
    MissionRow("take off", (0.0, 0.0, -1.0)),
    MissionRow("speed", text="0.4 m/s"),
    MissionRow("waypoint", (1.0, 0.5, -1.25), math.radians(90.0), 2.0),
    MissionRow("waypoint", (2.0, -0.5, -1.0)),
    MissionRow("land", (2.0, -0.5, 0.0)),
]


def met(world, seconds=40.0):
    """Run until the station has found a vehicle and read its parameters and mission."""
    world.run(seconds, lambda: world.seen and ready(world.seen[0]))
    return world.seen[0]


def ready(vehicle):
    return vehicle.parameters and not vehicle.parameters_missing and vehicle.transfers.items is not None


def test_a_vehicle_is_found_by_its_heartbeat_and_asked_for_what_it_is():
    world = World(MockVehicle(ours=True, parameters={f"P{k}": (float(k), 9) for k in range(40)}))
    vehicle = met(world, 5.0)
    world.run(1.0)
    assert (vehicle.name, vehicle.kind) == ("mufly, system 1", "mufly")
    assert len(vehicle.parameters) == 40
    assert vehicle.mission == []
    wishes = {m.param1: m.param2 for m in world.vehicles[0].commands if m.command == 511}
    assert wishes[mavlink.MAVLINK_MSG_ID_ATTITUDE] == pytest.approx(1e4)
    assert wishes[mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE] == pytest.approx(4e4)


def test_ground_stations_and_peripherals_are_no_vehicles():
    link = GroundLink()
    for kind, autopilot in ((6, 8), (26, 8), (18, 8)):
        message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 0, 3)
        link.receive(1.0, "a", Encoder(1, 100)(message))
    assert link.vehicles == []


@pytest.mark.parametrize("seed", range(4))
def test_all_parameters_come_over_a_link_that_loses_three_of_ten(seed):
    parameters = {f"P{k}": (k / 8.0, 9) for k in range(120)}
    vehicle = met(World(MockVehicle(parameters=parameters), seed=seed, loss=0.3, delay_s=0.3, doubles=0.2))
    assert {n: p.value for n, p in vehicle.parameters.items()} == {n: v for n, (v, _) in parameters.items()}


def test_a_parameter_is_set_when_the_vehicle_says_so_and_refused_in_its_words():
    mock = MockVehicle(parameters={"GAIN": (1.0, 9), "FIXED": (2.0, 9)})
    world = World(mock)
    vehicle = met(world)
    assert world.answer(vehicle.set_parameter("GAIN", 1.1)) == ("accepted", "")
    assert vehicle.parameters["GAIN"].value == 1.1
    mock.refuse["FIXED"] = True
    assert world.answer(vehicle.set_parameter("FIXED", 5.0)) == ("refused", "the vehicle keeps 2")
    mock.parameters["GAIN"] = (3.0, 9)
    mock.extra.append(mock._value(0))  # another station has set it
    world.run(0.5)
    assert vehicle.parameters["GAIN"].value == 3.0


@pytest.mark.parametrize(("bytewise", "capabilities"), [(True, 16), (False, 131072)])
def test_whole_numbers_travel_as_the_vehicle_says(bytewise, capabilities):
    raw = as_float("<i", -7) if bytewise else -7.0
    mock = MockVehicle(parameters={"N": (raw, 6)})
    mock.capabilities = capabilities
    world = World(mock)
    vehicle = met(world)
    assert vehicle.parameters["N"].value == -7.0
    assert world.answer(vehicle.set_parameter("N", 1234))[0] == "accepted"
    assert mock.parameters["N"][0] == (as_float("<i", 1234) if bytewise else 1234.0)
    assert world.answer(vehicle.set_parameter("N", 1.5)) == ("refused", "a whole number is needed")


@pytest.mark.parametrize("seed", range(4))
def test_missions_go_there_and_back_over_the_worst_link(seed):
    mock = MockVehicle()
    world = World(mock, seed=10 * seed, loss=0.3, delay_s=0.3, doubles=0.2)
    vehicle = met(world, 90.0)
    assert world.answer(vehicle.upload_mission(ROWS), 120.0)[0] == "accepted"
    assert len(mock.mission) == 5
    request = vehicle.download_mission()
    assert world.answer(request, 120.0)[0] == "accepted"
    assert same_mission(request.result, mock.mission)
    back = vehicle.mission
    assert [row.action for row in back] == [row.action for row in ROWS]
    np.testing.assert_allclose([r.position for r in back], [r.position for r in ROWS])
    assert back[2].heading_rad == pytest.approx(math.pi / 2)
    assert math.isnan(back[3].heading_rad)
    assert (back[2].wait_s, back[1].text) == (2.0, "0.4 m/s")
    assert world.answer(vehicle.clear_mission())[0] == "accepted"
    assert mock.mission == ()
    assert vehicle.mission == []


def test_a_mission_that_cannot_be_sent_is_refused_before_anything_is_sent():
    world = World(MockVehicle())
    vehicle = met(world)
    request = vehicle.upload_mission([MissionRow("dance")])
    assert request.outcome is Outcome.REFUSED
    assert "row 1" in request.answer
    assert vehicle.upload_mission("no-such-mission.toml").outcome is Outcome.REFUSED


def test_progress_follows_current_and_reached_items():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(ROWS))
    for message, behind in (
        (mavlink.MAVLink_mission_current_message(2, total=5), 2),
        (mavlink.MAVLink_mission_item_reached_message(2), 3),
        (mavlink.MAVLink_mission_current_message(3, total=5), 3),
        (mavlink.MAVLink_mission_current_message(0, total=5), 0),
    ):
        mock.extra.append(message)
        world.run(0.1)
        assert [row.reached for row in vehicle.mission] == [k < behind for k in range(5)]
    assert vehicle.snapshot.mission_row == 0


def test_a_mission_that_somebody_else_sent_is_fetched():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(ROWS))
    mock.mission = mock.mission[:3]
    mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=3))
    world.run(5.0, lambda: len(vehicle.mission) == 3)


def test_the_home_in_an_ardupilot_s_mission_is_not_missed_again_and_again():
    """Its list begins with home, which MISSION_CURRENT leaves out of the total."""
    mock = MockVehicle(autopilot=3)
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(ROWS))
    mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=4))
    world.run(0.2)
    assert not vehicle.transfers.busy
    mock.mission = mock.mission[:4]
    mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=3))
    world.run(5.0, lambda: len(vehicle.mission) == 4)
    assert len(vehicle.mission) == 4


def test_take_off_arms_first_and_carries_the_reason_of_a_refusal():
    mock = MockVehicle(ours=True)
    world = World(mock)
    vehicle = met(world)
    mock.refuse[22] = (1, "not level; put it on level ground")
    outcome, answer = world.answer(vehicle.take_off(1.5))
    assert (outcome, answer) == ("refused", "take off: not level; put it on level ground")
    assert mock.armed
    del mock.refuse[22]
    world.run(1.5)  # the heartbeat says that it is armed
    mock.commands.clear()
    assert world.answer(vehicle.take_off(1.5)) == ("accepted", "")
    (order,) = mock.commands
    assert (order.get_type(), order.frame, order.z) == ("COMMAND_INT", 1, -1.5)


def test_a_command_is_repeated_with_its_number_counted_up_and_given_up_in_the_end():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    mock.silent_on.add(21)
    outcome, answer = world.answer(vehicle.land())
    assert outcome == "timed out"
    assert "no answer in 10 s" in answer
    assert [m.confirmation for m in mock.commands if m.command == 21] == list(range(12))


@pytest.mark.parametrize("seed", range(6))
def test_commands_get_through_the_worst_link(seed):
    mock = MockVehicle(ours=True)
    world = World(mock, seed=7 * seed, loss=0.3, delay_s=0.3, doubles=0.2)
    vehicle = met(world, 90.0)
    assert world.answer(vehicle.take_off(1.0), 60.0)[0] == "accepted"
    assert mock.armed


def test_an_emergency_stop_goes_out_at_once_whatever_waits():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    mock.silent_on.add(400)
    waiting = vehicle.arm()
    world.run(0.3)
    mock.commands.clear()
    stop = vehicle.emergency_stop()
    world.run(0.03)
    assert (mock.commands[0].command, mock.commands[0].param1, mock.commands[0].param2) == (400, 0.0, 21196.0)
    assert waiting.outcome is Outcome.REFUSED
    assert not stop.done


@pytest.mark.parametrize("autopilot", [12, 3])
@pytest.mark.parametrize("ours", [True, False])
@pytest.mark.parametrize("after_s", [0.05, 0.9, 2.0])
def test_nothing_that_was_asked_for_before_follows_an_emergency_stop(autopilot, ours, after_s):
    """Take-off pressed twice over a link that is bad just now, then the stop: it must not arm when the link is back."""
    mock = MockVehicle(ours=ours, autopilot=autopilot, parameters={"MIS_TAKEOFF_ALT": (1.0, 9)})
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(ROWS))
    mock.silent_on = {400, 176}
    mock.refuse["MIS_TAKEOFF_ALT"] = True  # so that the chain waits there
    asked = [vehicle.take_off(1.5), vehicle.take_off(2.0), vehicle.start_mission(), vehicle.arm()]
    world.run(after_s)
    mock.commands.clear()
    stop = vehicle.emergency_stop()
    world.run(0.02)
    mock.silent_on, mock.refuse = set(), {}
    world.run(4.0)
    assert stop.outcome is Outcome.ACCEPTED
    assert all(request.done for request in asked)
    acts = [m for m in mock.commands if m.command not in (511, 512)]
    assert {(m.command, m.param1, m.param2) for m in acts} == {(400, 0.0, 21196.0)}
    assert not mock.armed
    assert world.answer(vehicle.arm())[0] == "accepted"  # when it is asked for anew


def test_a_vehicle_that_falls_silent_is_lost_and_comes_back_from_another_address():
    mock = MockVehicle(ours=True)
    world = World(mock)
    vehicle = met(world)
    world.down[0].cut = True
    world.run(3.5)
    assert not vehicle.snapshot.connected
    assert vehicle.snapshot.silent_s > 3.0
    assert "is not heard any more" in vehicle.messages[-1].text
    world.down[0].cut = False
    world.peer = lambda k: f"elsewhere {k}"
    mock.commands.clear()
    world.run(3.0, lambda: any(m.command == 511 for m in mock.commands))
    assert world.seen == [vehicle]
    assert vehicle.snapshot.connected


def test_a_vehicle_that_is_started_anew_is_asked_anew_and_its_history_goes_on():
    mock = MockVehicle(ours=True, parameters={"A": (1.0, 9)})
    world = World(mock)
    vehicle = met(world)
    world.run(5.0)
    before = vehicle.history.newest_s
    mock.restart()
    mock.parameters = {"A": (2.0, 9)}
    mock.silent_on.add(21)
    waiting = vehicle.land()
    world.run(3.0, lambda: vehicle.parameters["A"].value == 2.0)
    assert (waiting.outcome, waiting.answer) == (Outcome.TIMED_OUT, "the vehicle was started anew")
    times, _ = vehicle.history.window(100.0)
    assert (np.diff(times) > 0).all()
    assert before < times[-1] < before + 4.0
    assert any("started anew" in m.text for m in vehicle.messages)


def test_vehicles_with_one_number_at_two_addresses_are_kept_apart():
    a, b = MockVehicle(parameters={"A": (1.0, 9)}), MockVehicle(parameters={"A": (2.0, 9)})
    world = World(a, b)
    world.run(6.0, lambda: len(world.seen) == 2 and all(map(ready, world.seen)))
    assert [v.parameters["A"].value for v in world.seen] == [1.0, 2.0]
    world.answer(world.seen[1].arm())
    assert (a.armed, b.armed) == (False, True)
    assert [v.color for v in world.seen] == [0, 1]


def test_a_vehicle_that_knows_no_intervals_gets_the_older_request():
    mock = MockVehicle(autopilot=3, vehicle_type=4)
    mock.refuse[511] = (3, "")
    got = []
    receive = mock._message
    mock._message = lambda now_s, m: (got.append(m.get_type()), receive(now_s, m))
    world = World(mock)
    world.run(6.0, lambda: "REQUEST_DATA_STREAM" in got)
    assert world.seen[0].name == "ArduPilot helicopter, system 1"


def test_the_link_is_measured():
    world = World(MockVehicle(), loss=0.3, seed=3)
    world.run(20.0)
    s = world.seen[0].snapshot
    losses = world.seen[0].history.window(15.0, ["link_loss"])[1]
    assert 0.2 < np.nanmean(losses) < 0.4
    assert 20.0 < s.link_rate_Hz < 41.0


def test_who_commands_is_told():
    mock = MockVehicle(ours=True)
    mock.commander = 7 * 256 + 190
    world = World(mock)
    vehicle = met(world)
    assert not vehicle.snapshot.in_command
    assert vehicle.snapshot.commander == "station 7 (component 190)"
    mock.commander = 255 * 256 + 190
    world.run(1.5)
    assert vehicle.snapshot.in_command


def test_the_checks_of_a_vehicle_that_tells_little_judge_little():
    vehicle = met(World(MockVehicle()))
    found = {check.name: check.ok for check in vehicle.checks}
    assert found["heard"] is True
    assert found["position"] is True
    assert found["level and still"] is False  # it flies past at 1 m/s
    assert found["battery"] is None
    assert found["recording"] is None


def test_a_fault_in_one_vehicle_does_not_silence_the_others():
    a, b = MockVehicle(system=1), MockVehicle(system=2)
    world = World(a, b)
    world.run(2.0, lambda: len(world.seen) == 2)

    def fail(*_):
        raise RuntimeError("broken")

    world.seen[0].handle = fail
    world.run(2.0)
    assert world.seen[1].snapshot.connected
    assert [m.text for m in world.seen[0].messages if "broken" in m.text]
    assert len(world.seen[0].messages) < 10
