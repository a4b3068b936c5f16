"""Pre-flight checks: what is good, what is bad, and what cannot be judged."""

from __future__ import annotations

import math

import pytest
from mock_vehicle import MockVehicle, World

from mufly.link import items_of as items_of_mission
from mufly.link import mavlink
from mufly.mission import mission_from
from mufly.station import MissionRow
from mufly.station.checks import flight_time
from mufly.station.transfers import items_of, rows_of, same_mission

PREARM = 268435456
NAMES = [
    "heard", "link", "command", "vehicle's own checks", "battery", "level and still", "position", "mission",
    "time to fly", "parameters", "recording", "disk",
]  # fmt: skip


@pytest.fixture
def world():
    world = World(MockVehicle(ours=True))
    world.run(3.0)
    return world


def say(world, *messages):
    world.vehicles[0].extra += messages
    world.run(0.1)


def check(world, name):
    return next(c for c in world.seen[0].checks if c.name == name)


def status(health, voltage=7400, charge=80):
    return mavlink.MAVLink_sys_status_message(
        PREARM, PREARM, health, 0, voltage, 300, charge, 0, 0, 0, 0, 0, 0
    )


def test_all_checks_stand_in_the_order_of_a_list(world):
    assert [c.name for c in world.seen[0].checks] == NAMES
    assert all(c.text for c in world.seen[0].checks)


def test_the_vehicles_own_checks_carry_its_reason(world):
    say(world, mavlink.MAVLink_statustext_message(4, b"battery low: charge it"), status(0))
    assert check(world, "vehicle's own checks").ok is False
    assert "battery low: charge it" in check(world, "vehicle's own checks").text
    say(world, status(PREARM))
    assert check(world, "vehicle's own checks").ok is True


@pytest.mark.parametrize(("charge", "ok"), [(80, True), (31, True), (29, False), (-1, None)])
def test_a_battery_needs_charge(world, charge, ok):
    say(world, status(PREARM, charge=charge))
    assert check(world, "battery").ok is ok


def test_a_vehicle_that_is_silent_is_not_heard(world):
    assert check(world, "heard").ok is True
    world.down[0].cut = True
    world.run(4.0)
    assert check(world, "heard").ok is False


def test_the_mission_shown_has_to_be_the_one_in_the_vehicle(world):
    mission = mission_from({"name": "m", "waypoint": [{"position_m": [1.0, 0.0, -1.0]}]})
    vehicle = world.seen[0]
    vehicle.show_mission(mission)
    assert check(world, "mission").ok is False
    assert world.answer(vehicle.upload_mission(mission))[0] == "accepted"
    assert check(world, "mission").ok is True


def test_a_mission_that_takes_longer_than_the_battery_lasts(world):
    rows = [MissionRow("take off", (0, 0, -1.0)), MissionRow("waypoint", (10.0, 0.0, -1.0), wait_s=5.0)]
    world.answer(world.seen[0].upload_mission(rows))
    assert check(world, "time to fly").ok is None
    for left_s, ok in ((60, True), (20, False)):
        say(
            world,
            mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [7400] + [65535] * 9, 0, 0, 0, 80, left_s),
        )
        assert check(world, "time to fly").ok is ok


def test_the_time_of_a_mission_is_that_of_its_ways_climbs_and_waits():
    rows = [
        MissionRow("take off", (0.0, 0.0, -1.0)),
        MissionRow("waypoint", (3.0, 4.0, -1.0), wait_s=2.0),
        MissionRow("speed", text="0.25 m/s"),
        MissionRow("waypoint", (3.0, 5.0, -2.0)),
        MissionRow("land", (3.0, 5.0, 0.0)),
    ]
    climbs = (1.0 + 1.0 + 2.0) / 0.4
    assert flight_time(rows, 0.5) == pytest.approx(5.0 / 0.5 + 1.0 / 0.25 + climbs + 2.0)
    assert flight_time([]) == 0.0


def test_disk_and_recorder_are_looked_at(world):
    around = world.seen[0].surroundings
    around.recording, around.free_bytes = False, 1e6
    assert (check(world, "recording").ok, check(world, "disk").ok) == (False, False)
    around.recording, around.free_bytes = True, 1e10
    assert (check(world, "recording").ok, check(world, "disk").ok) == (True, True)


def test_rows_and_items_of_a_mission_file_say_the_same():
    mission = mission_from(
        {
            "name": "m",
            "take_off": {"height_m": 0.8},
            "waypoint": [
                {"position_m": [1.0, 0.5, -1.2], "wait_s": 2.0, "heading_deg": 30.0, "speed_m_s": 0.3},
                {"position_m": [0.0, 0.5, -1.2]},
            ],
        }
    )
    items = items_of_mission(mission).items
    rows = rows_of(items)
    first = next(row for row in rows if row.action == "waypoint")
    assert first.position == (1.0, 0.5, -1.2)
    assert first.heading_rad == pytest.approx(math.radians(30.0))
    assert first.wait_s == 2.0
    assert same_mission(tuple(items_of(rows)), tuple(items))
