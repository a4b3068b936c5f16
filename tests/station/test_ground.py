"""A station's end of a link against vehicles that a test steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mock_vehicle import MockVehicle, World, as_float

from mufly.link import Endpoint, FrameEncoder, GlobalOrigin, MissionItem, mavlink, parse_endpoint
from mufly.mission import parse_mission
from mufly.mission.files.mission_items import mission_to_items
from mufly.station import GroundLink, RequestOutcome
from mufly.station.ground_station import choose_telemetry_rate
from mufly.station.mission_rows import DEFAULT_SPEED_TEXT, is_same_mission, rows_from_items
from mufly.station.remote.remote_commands import StatusTextLog
from mufly.station.remote.remote_transfers import RemoteParameters

MISSION = parse_mission(
    {
        "name": "two points",
        "take_off": {"height_m": 1.0},
        "waypoint": [
            {"position_m": [1.0, 0.5, -1.25], "heading_deg": 90.0, "wait_s": 2.0, "speed_m_s": 0.4},
            {"position_m": [2.0, -0.5, -1.0], "speed_m_s": 0.4},
        ],
        "at_end": "land",
    }
)
ITEMS = mission_to_items(MISSION).items


def met(world, seconds=40.0):
    """Run until the station has found a vehicle and read its parameters and mission."""
    world.run(seconds, lambda: world.seen and ready(world.seen[0]))
    return world.seen[0]


def ready(vehicle):
    return vehicle.parameters and not vehicle.missing_parameter_count and vehicle.transfers.items is not None


def test_a_vehicle_is_found_by_its_heartbeat_and_asked_for_what_it_is():
    world = World(MockVehicle(ours=True, parameters={f"P{k}": (float(k), 9) for k in range(40)}))
    vehicle = met(world, 5.0)
    world.run(1.0)
    assert (vehicle.display_name, vehicle.kind) == ("mufly, system 1", "mufly")
    assert len(vehicle.parameters) == 40
    assert vehicle.mission_rows == []
    wishes = {m.param1: m.param2 for m in world.vehicles[0].commands if m.command == 511}
    # What stands in one row of the history comes at one rate; a ring of beams is slower anyway.
    for name in (
        "ATTITUDE",
        "LOCAL_POSITION_NED",
        "POSITION_TARGET_LOCAL_NED",
        "ATTITUDE_TARGET",
        "ACTUATOR_OUTPUT_STATUS",
    ):
        assert wishes[getattr(mavlink, f"MAVLINK_MSG_ID_{name}")] == pytest.approx(1e4), name
    assert wishes[mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE] == pytest.approx(4e4)
    assert wishes[mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR] == -1  # the ring says it all


def test_ground_stations_and_peripherals_are_no_vehicles():
    link = GroundLink()
    for kind, autopilot in ((6, 8), (26, 8), (18, 8)):
        message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 0, 3)
        link.process_bytes(1.0, "a", FrameEncoder(1, 100)(message))
    assert link.vehicles == []


def heartbeat(kind, autopilot, component, system=1):
    message = mavlink.MAVLink_heartbeat_message(kind, autopilot, 128, 0, 4, 3)
    return FrameEncoder(system, component)(message)


@pytest.mark.parametrize(
    ("kind", "autopilot", "component"),
    [
        (18, 0, 191),  # a companion computer that calls its autopilot GENERIC
        (18, 3, 191),
        (26, 0, 154),
        (0, 0, 154),  # a gimbal of no type
        (30, 0, 100),
        (5, 3, 1),  # an antenna tracker with ArduPilot
        (27, 0, 156),
        (36, 0, 180),
        (37, 0, 161),
        (6, 3, 190),
    ],
)
def test_equipment_that_speaks_first_is_never_the_vehicle(kind, autopilot, component):
    notices = []
    link = GroundLink(on_notice=notices.append)
    for k in range(80):
        now = 0.1 * k
        if k % 5 == 0:
            link.process_bytes(now, "a", heartbeat(kind, autopilot, component, 1 if component != 1 else 2))
        link.take_due_frames(now)
    assert link.vehicles == []
    assert len(notices) == (kind != 6)
    link.process_bytes(9.0, "a", heartbeat(2, 12, 1))
    (vehicle,) = link.vehicles
    assert (vehicle.system, vehicle.component, vehicle.telemetry.vehicle_type) == (1, 1, 2)


def test_the_autopilot_takes_over_from_a_companion_that_calls_itself_a_quadrotor():
    mock = MockVehicle(parameters={"A": (1.0, 9)})
    world = World(mock)
    world.station.process_bytes(world.t, "peer 0", heartbeat(2, 3, 191))
    (vehicle,) = world.seen
    assert vehicle.component == 191
    early = vehicle.arm()
    vehicle.telemetry.clock.to_monotonic_time(9_000_000, world.t)  # the companion's clock is hours ahead
    world.run(8.0, lambda: ready(vehicle))
    assert world.seen == [vehicle]
    assert (vehicle.component, vehicle.firmware_kind) == (1, "PX4")
    assert early.outcome is RequestOutcome.TIMED_OUT
    assert any("component 1 is the autopilot" in m.text for m in vehicle.status_messages)
    assert vehicle.parameters["A"].value == 1.0
    assert world.answer(vehicle.arm())[0] == "accepted"
    assert {m.target_component for m in mock.commands} == {1}
    world.run(1.0)
    times, _ = vehicle.history.recent_rows(100.0)
    assert times[-1] - times[0] < 60.0
    world.station.process_bytes(world.t, "peer 0", heartbeat(2, 3, 191))  # the companion goes on
    assert vehicle.component == 1


def test_equipment_with_the_vehicles_own_numbers_does_not_disarm_it():
    mock = MockVehicle()
    mock.armed, mock.custom_mode = True, 4 << 16 | 4 << 24
    world = World(mock)
    vehicle = met(world)
    idle = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    world.station.process_bytes(world.t, "peer 0", FrameEncoder(1, 1)(idle))
    assert (vehicle.telemetry.armed, vehicle.telemetry.mode) == (True, "mission")
    assert vehicle.telemetry.vehicle_type == 13


def test_a_vehicle_whose_companion_goes_on_is_lost_all_the_same():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    world.down[0].cut = True
    for _ in range(8):
        world.run(0.5)
        world.station.process_bytes(world.t, "peer 0", heartbeat(18, 0, 191))
    assert not vehicle.snapshot.connected
    assert "communication lost" in vehicle.status_messages[-1].text


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
    request, begun = vehicle.set_parameter("FIXED", 5.0), world.t
    assert world.answer(request) == ("refused", "the vehicle keeps 2")
    assert world.t - begun > 1.0  # the old value may belong to a list that was under way
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
    assert world.answer(vehicle.set_parameter("N", 1.5)) == ("refused", "integer required")


@pytest.mark.parametrize("seed", range(4))
def test_missions_go_there_and_back_over_the_worst_link(seed):
    mock = MockVehicle()
    world = World(mock, seed=10 * seed, loss=0.3, delay_s=0.3, doubles=0.2)
    vehicle = met(world, 90.0)
    assert world.answer(vehicle.upload_mission(MISSION), 120.0) == ("accepted", "5 items")
    assert len(mock.mission) == 5
    request = vehicle.download_mission()
    assert world.answer(request, 120.0)[0] == "accepted"
    assert is_same_mission(request.result, mock.mission)
    back = vehicle.mission_rows
    assert [row.action for row in back] == ["take off", "speed", "waypoint", "waypoint", "land"]
    places = [(0.0, 0.0, -1.0), (np.nan,) * 3, (1.0, 0.5, -1.25), (2.0, -0.5, -1.0), (2.0, -0.5, 0.0)]
    np.testing.assert_allclose([r.position for r in back], places)
    assert back[2].heading_rad == pytest.approx(math.pi / 2)
    assert math.isnan(back[3].heading_rad)
    assert (back[2].wait_s, back[1].text) == (2.0, "0.4 m/s")
    assert world.answer(vehicle.clear_mission())[0] == "accepted"
    assert mock.mission == ()
    assert vehicle.mission_rows == []


def test_a_mission_that_cannot_be_sent_is_refused_before_anything_is_sent():
    world = World(MockVehicle())
    vehicle = met(world)
    assert vehicle.upload_mission("no-such-mission.toml").outcome is RequestOutcome.REFUSED


def test_items_become_rows_and_what_has_no_place_has_none():
    at = GlobalOrigin(47.0, 8.0, 400.0)
    lat, lon, _ = at.to_global(10.0, -5.0, 0.0)
    x, y = round(lat * 1e7), round(lon * 1e7)
    items = [
        *ITEMS,
        MissionItem(5, 1, 178, params=(1.0, -2.0, -1.0, 0.0)),
        MissionItem(6, 1, 115, params=(-45.0, 0.0, 0.0, 0.0)),
        MissionItem(7, 1, 20),
    ]
    assert [i.command for i in items[:5]] == [22, 178, 16, 16, 21]
    back = rows_from_items(items, reached=2)
    assert [r.reached for r in back] == [True, True, *[False] * 6]
    assert (back[5].text, back[6].heading_rad) == (DEFAULT_SPEED_TEXT, pytest.approx(math.radians(-45.0)))
    assert np.isnan([back[k].position for k in (1, 5, 6, 7)]).all()
    foreign = [
        MissionItem(0, 0, 16, params=(2.5, 0, 0, math.nan), x=x, y=y, z=401.5),
        MissionItem(1, 3, 19, params=(4.0, 0, 0, math.nan), x=x, y=y, z=1.5),
        MissionItem(2, 3, 16, params=(math.nan, 0, 0, math.nan), x=0, y=0, z=1.5),
        MissionItem(3, 2, 201, params=(1.0, 2.0, 0, 0)),
    ]
    a, b, nowhere, unknown = rows_from_items(foreign, at)
    for row in (a, b):
        assert row.position == pytest.approx((10.0, -5.0, -1.5), abs=0.01)
    assert [r.wait_s for r in (a, b, nowhere)] == [2.5, 4.0, 0.0]
    assert [r.action for r in (a, b, unknown)] == ["waypoint", "loiter (time)", "command 201"]
    assert np.isnan(nowhere.position).all()
    assert unknown.text.startswith("1 2 0 0")
    assert rows_from_items(foreign[:1])[0].text == f"{lat:.6f} {lon:.6f} deg, 401.5 m"


def test_why_a_mission_is_refused_is_said_even_if_the_vehicle_gives_a_number_only():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    for result, words in (
        (8, "parameter 3 of an item is invalid"),
        (4, "too many items"),
        (99, "result 99"),
    ):
        mock.mission_result = result
        assert world.answer(vehicle.upload_mission(MISSION)) == ("refused", words)


def test_a_mission_that_another_station_sends_or_clears_is_fetched():
    """MISSION_CURRENT counts the items: 0 does not count, 65535 is "there is none"."""
    mock = MockVehicle(ours=True)
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(MISSION))
    for held, total, shown in ((ITEMS[:3], 0, 5), (ITEMS[:3], 3, 3), ((), 65535, 0)):
        mock.mission = held
        mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=total))
        world.run(1.0)
        assert len(vehicle.mission_rows) == shown, total


def test_parameters_that_do_not_come_are_counted():
    for count, came, words in ((0, 0, "all parameters"), (5, 2, "3 parameters")):
        parameters = RemoteParameters(StatusTextLog(), (1, 1))
        request, asked = parameters.request_all_parameters(), []
        for k in range(60):
            asked += parameters.take_due_messages(float(k))
            for j in range(came if k == 0 else 0):
                parameters.handle_parameter_value(
                    0.0, sent(mavlink.MAVLink_param_value_message(b"P%d" % j, 1.0, 9, count, j))
                )
        assert (request.outcome, request.answer) == (
            RequestOutcome.TIMED_OUT,
            f"{words} are missing; press Refresh",
        )
        assert asked[0].get_type() == "PARAM_REQUEST_LIST"
        wanted = {m.param_index for m in asked if m.get_type() == "PARAM_REQUEST_READ"}
        assert wanted == set(range(came, count))


def sent(message):
    """A message as it comes off the wire."""
    link = mavlink.MAVLink(None)
    return link.decode(bytearray(message.pack(link)))


@pytest.mark.parametrize(("autopilot", "raw"), [(12, as_float("<i", -7)), (3, -7.0)])
def test_a_vehicle_that_does_not_say_what_it_is_is_read_as_its_kind_does_it(autopilot, raw):
    """PX4 puts whole numbers there byte by byte, ArduPilot as numbers; nobody waits for an answer for ever."""
    mock = MockVehicle(autopilot=autopilot, parameters={"N": (raw, 6)})
    mock.silent_on.add(512)
    world = World(mock)
    took = world.run(6.0, lambda: world.seen and world.seen[0].parameters)
    assert 2.5 < took < 4.5
    assert world.seen[0].parameters["N"].value == -7.0


def test_a_station_is_heard_once_a_second_and_after_a_stall_too():
    link = GroundLink()
    beats = [t for t in (0.1 * k for k in range(100)) if link.take_due_frames(t, ["a"])]
    assert len(beats) == 10
    assert np.diff(beats) == pytest.approx(1.0)
    late = [t for t in (60.0 + 0.1 * k for k in range(50)) if link.take_due_frames(t, ["a"])]
    assert np.diff(late) == pytest.approx(1.0)


def test_a_line_is_asked_for_what_it_carries():
    """A radio of 57600 baud carries 5.8 kB/s; all streams at 100 Hz are 45."""
    assert choose_telemetry_rate(parse_endpoint("udp:127.0.0.1:14550", "station"), 80.0) == 80.0
    radio = choose_telemetry_rate(Endpoint("serial", "/dev/ttyUSB0", 57600))
    assert 0.5 < radio / 100 * 45_000 / 5760 < 0.7  # room for commands, missions and parameters
    assert choose_telemetry_rate(Endpoint("serial", "/dev/ttyUSB0", 115200)) == pytest.approx(2 * radio)
    assert choose_telemetry_rate(Endpoint("serial", "/dev/ttyACM0", 3_000_000)) == 100.0
    assert choose_telemetry_rate(Endpoint("serial", "/dev/ttyUSB0", 1200)) == 1.0


def test_progress_follows_current_and_reached_items():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(MISSION))
    for message, behind in (
        (mavlink.MAVLink_mission_current_message(2, total=5), 2),
        (mavlink.MAVLink_mission_item_reached_message(2), 3),
        (mavlink.MAVLink_mission_current_message(3, total=5), 3),
        (mavlink.MAVLink_mission_current_message(0, total=5), 0),
    ):
        mock.extra.append(message)
        world.run(0.1)
        assert [row.reached for row in vehicle.mission_rows] == [k < behind for k in range(5)]
    assert vehicle.snapshot.mission_row == 0


def test_a_mission_that_somebody_else_sent_is_fetched():
    mock = MockVehicle()
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(MISSION))
    mock.mission = mock.mission[:3]
    mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=3))
    world.run(5.0, lambda: len(vehicle.mission_rows) == 3)


def test_the_home_in_an_ardupilot_s_mission_is_not_missed_again_and_again():
    """Its list begins with home, which MISSION_CURRENT leaves out of the total."""
    mock = MockVehicle(autopilot=3)
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(MISSION))
    mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=4))
    world.run(0.2)
    assert not vehicle.transfers.is_busy
    mock.mission = mock.mission[:4]
    mock.extra.append(mavlink.MAVLink_mission_current_message(0, total=3))
    world.run(5.0, lambda: len(vehicle.mission_rows) == 4)
    assert len(vehicle.mission_rows) == 4


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
    assert waiting.outcome is RequestOutcome.REFUSED
    assert not stop.is_done


@pytest.mark.parametrize("autopilot", [12, 3])
@pytest.mark.parametrize("ours", [True, False])
@pytest.mark.parametrize("after_s", [0.05, 0.9, 2.0])
def test_nothing_that_was_asked_for_before_follows_an_emergency_stop(autopilot, ours, after_s):
    """Take-off pressed twice over a link that is bad just now, then the stop: it must not arm when the link is back."""
    mock = MockVehicle(ours=ours, autopilot=autopilot, parameters={"MIS_TAKEOFF_ALT": (1.0, 9)})
    world = World(mock)
    vehicle = met(world)
    world.answer(vehicle.upload_mission(MISSION))
    mock.silent_on = {400, 176}
    mock.refuse["MIS_TAKEOFF_ALT"] = True  # so that the chain waits there
    asked = [vehicle.take_off(1.5), vehicle.take_off(2.0), vehicle.start_mission(), vehicle.arm()]
    world.run(after_s)
    mock.commands.clear()
    stop = vehicle.emergency_stop()
    world.run(0.02)
    mock.silent_on, mock.refuse = set(), {}
    world.run(4.0)
    assert stop.outcome is RequestOutcome.ACCEPTED
    assert all(request.is_done for request in asked)
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
    assert 3.0 < vehicle.snapshot.silent_s < 4.0
    assert "communication lost" in vehicle.status_messages[-1].text
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
    assert (waiting.outcome, waiting.answer) == (RequestOutcome.TIMED_OUT, "the vehicle has restarted")
    times, _ = vehicle.history.recent_rows(100.0)
    assert (np.diff(times) > 0).all()
    assert before < times[-1] < before + 4.0
    assert any("has restarted" in m.text for m in vehicle.status_messages)


def test_vehicles_with_one_number_at_two_addresses_are_kept_apart():
    a, b = MockVehicle(parameters={"A": (1.0, 9)}), MockVehicle(parameters={"A": (2.0, 9)})
    world = World(a, b)
    world.run(6.0, lambda: len(world.seen) == 2 and all(map(ready, world.seen)))
    assert [v.parameters["A"].value for v in world.seen] == [1.0, 2.0]
    world.answer(world.seen[1].arm())
    assert (a.armed, b.armed) == (False, True)
    assert [v.color for v in world.seen] == [0, 1]


def test_a_foreign_vehicle_is_asked_for_what_changes_quickly_most_often():
    mock = MockVehicle()
    world = World(mock)
    met(world)
    world.run(1.0)
    asked = {m.param1: 1e6 / m.param2 for m in mock.commands if m.command == 511 and m.param2 > 0}
    rates = {
        "ATTITUDE": 100,
        "VISION_POSITION_ESTIMATE": 50,
        "RAW_RPM": 50,
        "DEBUG_FLOAT_ARRAY": 50,
        "ODOMETRY": 20,
    }
    rates |= {"OBSTACLE_DISTANCE": 25, "SERVO_OUTPUT_RAW": 10, "RC_CHANNELS": 5, "ESTIMATOR_STATUS": 4}
    rates |= {"EXTENDED_SYS_STATE": 2, "BATTERY_STATUS": 1}
    for name, rate in rates.items():
        assert asked[getattr(mavlink, f"MAVLINK_MSG_ID_{name}")] == pytest.approx(rate, rel=1e-4), name


def test_a_vehicle_that_knows_no_intervals_gets_the_older_request():
    mock = MockVehicle(autopilot=3, vehicle_type=4)
    mock.refuse[511] = (3, "")
    got = []
    receive = mock._message
    mock._message = lambda now_s, m: (got.append(m.get_type()), receive(now_s, m))
    world = World(mock)
    world.run(6.0, lambda: "REQUEST_DATA_STREAM" in got)
    assert world.seen[0].display_name == "ArduPilot helicopter, system 1"


def test_the_link_is_measured():
    world = World(MockVehicle(), loss=0.3, seed=3)
    world.run(20.0)
    s = world.seen[0].snapshot
    losses = world.seen[0].history.recent_rows(15.0, ["link_loss"])[1]
    assert 0.2 < np.nanmean(losses) < 0.4
    assert 20.0 < s.link_rate_Hz < 41.0
    world.down[0].loss = 0.7  # more is lost than comes
    world.run(20.0)
    losses = world.seen[0].history.recent_rows(15.0, ["link_loss"])[1]
    assert 0.6 < np.nanmean(losses) < 0.8
    world.down[0].cut = True
    world.run(2.5)
    assert world.seen[0].snapshot.link_loss == 1.0


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
    found = {check.name: check.ok for check in vehicle.preflight_checks}
    assert found["heartbeat"] is True
    assert found["position"] is True
    assert found["level and at rest"] is False  # it flies past at 1 m/s
    assert found["battery"] is None
    assert found["recording"] is None


def test_a_fault_in_one_vehicle_does_not_silence_the_others():
    a, b = MockVehicle(system=1), MockVehicle(system=2)
    world = World(a, b)
    world.run(2.0, lambda: len(world.seen) == 2)

    def fail(*_):
        raise RuntimeError("broken")

    world.seen[0].handle_message = fail
    world.run(2.0)
    assert world.seen[1].snapshot.connected
    assert [m.text for m in world.seen[0].status_messages if "broken" in m.text]
    assert len(world.seen[0].status_messages) < 10


def with_land_asked(**how):
    """A vehicle that does not answer to Land, which it has just been asked for, and how often it heard of it."""
    mock = MockVehicle(ours=True, **how)
    mock.armed = True
    world = World(mock)
    vehicle = met(world)
    world.run(2.0)
    mock.silent_on.add(mavlink.MAV_CMD_NAV_LAND)
    mock.commands.clear()
    return world, mock, vehicle, vehicle.land()


def heard_of(mock, number=mavlink.MAV_CMD_NAV_LAND):
    return sum(c.command == number for c in mock.commands)


@pytest.mark.parametrize("seconds", [1.2, 10.0, 100.0])
def test_after_a_stop_of_the_station_nothing_that_was_asked_before_is_done(seconds):
    """Its process was stopped, or its machine slept: the clock jumps, and all is repeated or goes on, but for this."""
    world, mock, vehicle, land = with_land_asked(parameters={"GAIN": (1.0, 9)})
    mock.silent_on.add(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    gain, sent, taken = (
        vehicle.set_parameter("GAIN", 2.0),
        vehicle.upload_mission(MISSION),
        vehicle.request_operator_control(),
    )
    vehicle.sticks.set_deflections(0.0, 0.0, 0.0, 0.0)
    by_hand = vehicle.fly_manually()  # and gives up to land
    stop = vehicle.emergency_stop()
    world.run(0.3)
    vehicle.sticks.set_deflections(0.5, 0.0, 0.0, 0.0)
    mock.commands.clear()
    world.up[0].cut = True
    world.t += seconds
    mock.step(world.t)
    world.station.take_due_frames(world.t)
    world.up[0].cut = False
    world.run(12.0)
    for request in (land, gain, sent, taken, by_hand, stop):
        assert request.is_done, request.text
    assert [r.outcome.value for r in (land, by_hand, stop)] == ["refused"] * 3
    assert "the station stalled" in stop.answer
    assert [c.command for c in mock.commands if c.command not in (511, 512)] == []
    assert not vehicle.sticks.is_held
    assert any("the station stalled" in m.text for m in vehicle.status_messages)
    assert vehicle.land().outcome is RequestOutcome.WAITING  # what is asked now is asked


@pytest.mark.parametrize("seconds", [1.5, 10.0, 100.0])
def test_what_waits_while_the_link_is_cut_is_not_done_when_it_is_back_but_a_stop_is_sent(seconds):
    world, mock, vehicle, land = with_land_asked(rate_Hz=50.0)
    world.run(0.1)
    assert heard_of(mock) == 1
    for channel in (world.up[0], world.down[0]):
        channel.cut = True
    world.run(1.3)
    assert land.outcome is RequestOutcome.REFUSED
    assert "no message from the vehicle for 1.0 s" in land.answer
    again, stop = vehicle.land(), vehicle.emergency_stop()
    world.run(seconds - 1.3)
    for channel in (world.up[0], world.down[0]):
        channel.cut = False
    mock.commands.clear()
    world.run(5.0)
    assert again.is_done
    assert heard_of(mock) == 0
    assert stop.outcome is (RequestOutcome.ACCEPTED if seconds <= 10.0 else RequestOutcome.TIMED_OUT)


def test_a_vehicle_that_speaks_seldom_is_not_given_up_between_two_words():
    """Of a slow radio: a message a second, of which one is lost."""
    world, _, vehicle, _ = with_land_asked(rate_Hz=0.5)
    world.run(60.0, step_s=0.02)  # what it is asked for at the beginning is over
    land = vehicle.land()
    world.run(5.0)
    assert land.outcome is RequestOutcome.WAITING


def test_a_later_command_gives_up_one_that_waits_for_its_answer():
    """Else its repetition undoes the later one: a Resume was swallowed by the Hover before it."""
    mock = MockVehicle(ours=True)
    mock.armed, mock.mission = True, ITEMS
    world = World(mock)
    vehicle = met(world)
    mock.silent_on.add(mavlink.MAV_CMD_DO_PAUSE_CONTINUE)  # its answers are lost
    mock.commands.clear()
    hover = vehicle.pause()
    assert vehicle.pause() is hover  # two presses are one request
    world.run(0.3)
    resume = vehicle.start_mission()
    assert hover.outcome is RequestOutcome.REFUSED
    assert hover.answer == "superseded by: start the mission"
    assert world.answer(resume) == ("accepted", "")
    world.run(5.0)
    asked = [c.command for c in mock.commands if c.command not in (511, 512)]
    assert asked == [mavlink.MAV_CMD_DO_PAUSE_CONTINUE, mavlink.MAV_CMD_MISSION_START]
    # A chain that was given up goes on with nothing: no take-off follows a landing.
    mock.armed = False
    mock.silent_on.add(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    world.run(1.5)
    up = vehicle.take_off(1.0)
    world.run(0.1)
    land = vehicle.land()
    mock.silent_on.clear()
    world.run(3.0)
    assert (up.outcome, land.outcome) == (RequestOutcome.REFUSED, RequestOutcome.ACCEPTED)
    assert heard_of(mock, mavlink.MAV_CMD_NAV_TAKEOFF) == 0


def test_vehicles_of_one_number_have_keys_of_their_own_and_noise_is_told_as_that():
    link = GroundLink(name="udp:x")
    beat = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    for k, peer in enumerate(("a", "b")):
        link.process_bytes(10.0 + k, peer, FrameEncoder(1, 1)(beat))
    assert [v.key for v in link.vehicles] == ["1@udp:x", "1@udp:x#2"]
    assert link.unread_bytes == 0
    link.process_bytes(12.0, "a", bytes(range(250)) * 20)  # as of a serial line at another baud rate
    assert link.unread_bytes == 5000


def test_a_heading_that_none_can_have_carries_no_later_one_with_it():
    world = World(MockVehicle())
    vehicle = met(world)
    boot_ms = round((world.t - world.vehicles[0].boot_s) * 1e3)
    world.vehicles[0].extra.append(mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 1e30, 0.0, 0.0, 0.0))
    world.run(2.0)
    assert abs(vehicle.snapshot.estimate.attitude[2]) < 10.0
