"""Pre-flight checks: what is good, what is bad, and what cannot be judged."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mock_vehicle import MockVehicle, World

from mufly.estimate import Estimate
from mufly.flight import TunableParameter
from mufly.link import mavlink
from mufly.link import mission_to_items as items_of_mission
from mufly.link.mission_transfer import MissionItem
from mufly.mission import compute_mission_timing, load_mission, parse_mission
from mufly.mission.files.mission_items import GlobalOrigin
from mufly.station import SignalHistory, VehicleSnapshot
from mufly.station.mission_endurance import estimate_mission_duration
from mufly.station.mission_rows import rows_from_items
from mufly.station.preflight_checks import StationContext, run_preflight_checks
from mufly.station.remote.remote_commands import StatusTextLog
from mufly.station.remote.remote_transfers import RemoteMission, RemoteParameters
from mufly.station.remote.vehicle_telemetry import VehicleTelemetry

PREARM = 268435456
NAMES = [
    "heartbeat", "link", "operator control", "vehicle's pre-arm checks", "battery", "level and at rest", "position",
    "mission", "endurance", "parameters", "recording", "free disk space",
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
    return next(c for c in world.seen[0].preflight_checks if c.name == name)


def status(health, voltage=7400, charge=80):
    return mavlink.MAVLink_sys_status_message(PREARM, PREARM, health, 0, voltage, 300, charge, 0, 0, 0, 0, 0, 0)


def test_all_checks_stand_in_the_order_of_a_list(world):
    assert [c.name for c in world.seen[0].preflight_checks] == NAMES
    assert all(c.text for c in world.seen[0].preflight_checks)


def test_the_vehicles_own_checks_carry_its_reason(world):
    say(world, mavlink.MAVLink_statustext_message(4, b"battery low: charge it"), status(0))
    assert check(world, "vehicle's pre-arm checks").ok is False
    assert "battery low: charge it" in check(world, "vehicle's pre-arm checks").text
    say(world, status(PREARM))
    assert check(world, "vehicle's pre-arm checks").ok is True


@pytest.mark.parametrize(("charge", "ok"), [(80, True), (31, True), (29, False), (-1, None)])
def test_a_battery_needs_charge(world, charge, ok):
    say(world, status(PREARM, charge=charge))
    assert check(world, "battery").ok is ok


def test_a_vehicle_that_is_silent_is_not_heard(world):
    assert check(world, "heartbeat").ok is True
    world.down[0].cut = True
    world.run(4.0)
    assert check(world, "heartbeat").ok is False


def test_the_mission_shown_has_to_be_the_one_in_the_vehicle(world):
    mission = parse_mission({"name": "m", "waypoint": [{"position_m": [1.0, 0.0, -1.0]}]})
    vehicle = world.seen[0]
    vehicle.set_shown_mission(mission)
    assert check(world, "mission").ok is False
    assert world.answer(vehicle.upload_mission(mission))[0] == "accepted"
    assert check(world, "mission").ok is True


def test_a_mission_that_takes_longer_than_the_battery_lasts(world):
    mission = parse_mission({"name": "m", "waypoint": [{"position_m": [10.0, 0.0, -1.0], "wait_s": 5.0}]})
    world.answer(world.seen[0].upload_mission(mission))
    assert check(world, "endurance").ok is None
    for left_s, ok in ((90, True), (35, False)):
        say(
            world,
            mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [7400] + [65535] * 9, 0, 0, 0, 80, left_s),
        )
        assert check(world, "endurance").ok is ok


def limits_told(vehicle_limits):
    """Parameters of a vehicle of mufly, as a station knows them."""
    return {name: TunableParameter(name, value) for name, value in vehicle_limits.items()}


def test_the_check_reckons_as_mission_check_does():
    """Whatever of a mission its items carry, and with the mission file that the vehicle was started with, all of it."""
    for tables in (
        {"waypoint": [{"position_m": [2.0, 1.0, -1.5], "wait_s": 3.0}, {"position_m": [0.0, 1.0, -1.0]}]},
        {"waypoint": [{"position_m": [3.0, 0.0, -1.0]}], "at_end": "return", "path": {"kind": "spline"}},
        load_mission("box-on-leg").model_dump(exclude_none=True),
    ):
        mission = parse_mission({"name": "m", **tables})
        items = items_of_mission(mission).items
        lim = {"LIM_SPEED": mission.limits.speed_m_s, "LIM_CLIMB": mission.limits.climb_m_s}
        at = replace(Estimate(), position=np.array([*mission.start_m, 0.0]), attitude=np.zeros(3))
        plan = estimate_mission_duration(items, VehicleSnapshot(estimate=at), limits_told(lim), base=mission)
        assert plan.duration_s == pytest.approx(compute_mission_timing(mission).landed_s, abs=0.1)
        assert plan.assumptions == ""


def test_a_mission_under_way_needs_what_is_left_of_it():
    mission = parse_mission({"waypoint": [{"position_m": [4.0, 0.0, -1.0]}, {"position_m": [0.0, 0.0, -1.0]}]})
    items = items_of_mission(mission).items
    timing = compute_mission_timing(mission)
    for row, gone in (
        (1, timing.take_off_done_s),
        (2, timing.legs[0].wait_end_s),
        (3, timing.legs[1].wait_end_s),
    ):
        s = VehicleSnapshot(flying=True, mission_running=True, mission_row=row)
        assert estimate_mission_duration(items, s, {}, base=mission).duration_s == pytest.approx(timing.landed_s - gone)


def test_another_autopilots_mission_is_reckoned_with_its_own_speeds():
    """PX4 tells them in m/s, ArduPilot in cm/s; where none is told, what is assumed is said."""
    way = [
        MissionItem(0, 3, 22, x=470000000, y=80000000, z=10.0),
        MissionItem(1, 3, 16, x=470010000, y=80000000, z=10.0),
        MissionItem(2, 3, 82, x=470010000, y=80010000, z=10.0),
        MissionItem(3, 3, 21, x=470010000, y=80010000),
    ]
    s = VehicleSnapshot()
    px4 = estimate_mission_duration(way, s, limits_told({"MPC_XY_CRUISE": 5.0, "MPC_ACC_HOR": 3.0}))
    ardupilot = estimate_mission_duration(way, s, limits_told({"WPNAV_SPEED": 500.0, "WPNAV_ACCEL": 300.0}))
    assert px4.duration_s == pytest.approx(ardupilot.duration_s)
    assert px4.assumptions == ""
    length = 111.2 + 76.0
    assert length / 5.0 < px4.duration_s - 60.0 < length / 5.0 + 25.0  # 10 m up and down at 0.5 and 0.4 m/s
    unknown = estimate_mission_duration(way, s, {})
    assert unknown.assumptions == "0.6 m/s assumed"
    assert unknown.duration_s > length / 0.6


def test_jumps_and_circles_take_their_time():
    """Two rounds more of a square are two rounds more; an endless jump is said."""
    square = [MissionItem(k, 1, 16, x=round(1e4 * n), y=round(1e4 * e), z=-1.0, params=(2.0, 0, 0, math.nan))
              for k, (n, e) in enumerate([(0, 0), (3, 0), (3, 3), (0, 3)])]  # fmt: skip
    once = estimate_mission_duration(square, VehicleSnapshot(), {}).duration_s

    def with_last(command, *params):
        return estimate_mission_duration(
            [*square, MissionItem(4, 1, command, params=params, x=0, y=0, z=-1.0)], VehicleSnapshot(), {}
        )

    jumped = with_last(177, 0.0, 2.0, 0.0, 0.0)
    legs = 3.0 / 0.6 + 1.5 + 2.0  # and turns
    assert once + 8 * legs < jumped.duration_s < once + 8 * (legs + 6.0)
    assert with_last(177, 0.0, -1.0, 0.0, 0.0).assumptions == "0.6 m/s assumed, endless jump omitted"
    circles = with_last(18, 2.0, 0.0, 1.0, 0.0).duration_s - with_last(16, 0.0, 0.0, 0.0, math.nan).duration_s
    assert circles == pytest.approx(2.0 * math.tau / 0.6, abs=1.0)


def test_disk_and_recorder_are_looked_at(world):
    around = world.seen[0].station_context
    around.is_recording, around.free_disk_bytes = False, 1e6
    assert (check(world, "recording").ok, check(world, "free disk space").ok) == (False, False)
    around.is_recording, around.free_disk_bytes = True, 1e10
    assert (check(world, "recording").ok, check(world, "free disk space").ok) == (True, True)


def test_rows_say_what_a_mission_file_says():
    mission = parse_mission(
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
    rows = rows_from_items(items)
    first = next(row for row in rows if row.action == "waypoint")
    assert first.position == (1.0, 0.5, -1.2)
    assert first.heading_rad == pytest.approx(math.radians(30.0))
    assert first.wait_s == 2.0


def judged(name, *, around=None, told=None, items=None, **changes):
    """What a check says of a vehicle that is well but for what is given: ok, and its words."""
    texts = StatusTextLog()
    telemetry, mission = VehicleTelemetry(SignalHistory(seconds=1.0)), RemoteMission(texts, (1, 1))
    mission.items = items
    for key, value in (told or {}).items():
        setattr(telemetry, key, value)
    still = replace(Estimate(), attitude=np.zeros(3), velocity=np.zeros(3), battery_voltage=7.4)
    s = VehicleSnapshot(connected=True, silent_s=0.1, link_loss=0.0, link_rate_Hz=50.0, battery_charge=0.9)
    s = replace(s, estimate=replace(still, **changes.pop("estimate", {})), **changes)
    parameters = RemoteParameters(texts, (1, 1))
    found = run_preflight_checks(s, telemetry, texts, mission, parameters, around or StationContext())
    return next((c.ok, c.text) for c in found if c.name == name)


WAY = (
    MissionItem(0, 1, 22, params=(0.0, 0.0, 0.0, math.nan), z=-2.0),
    MissionItem(1, 1, 16, params=(3.0, 0.0, 0.0, math.nan), x=100_000, z=-1.0),
)


@pytest.mark.parametrize(
    ("name", "given", "ok", "says"),
    [
        # One packet in ten may be lost, but some have to come.
        ("link", {"link_loss": 0.1}, True, "10 % packet loss, 50 messages/s"),
        ("link", {"link_loss": 0.12}, False, "12 %"),
        ("link", {"link_rate_Hz": 0.0}, False, "0 messages/s"),
        ("link", {"link_loss": math.nan}, None, "not yet measured"),
        ("heartbeat", {"silent_s": math.inf}, False, "no message received"),
        ("battery", {"battery_charge": 0.3}, True, "30 %, 7.40 V"),
        ("battery", {"battery_charge": math.nan}, None, "7.40 V"),
        ("level and at rest", {"estimate": {"attitude": np.radians([3.9, 2.9, 90.0])}}, True, "tilt 4.9 deg"),
        ("level and at rest", {"estimate": {"attitude": np.radians([3.9, -3.9, 0.0])}}, False, "tilt 5.5 deg"),
        ("level and at rest", {"estimate": {"velocity": np.array([0.05, 0.05, 0.05])}}, True, "0.09 m/s"),
        ("level and at rest", {"estimate": {"velocity": np.array([0.0, 0.08, 0.08])}}, False, "0.11 m/s"),
        ("level and at rest", {"flying": True}, None, "in flight"),
        # Up 2 m, down 1 m, 10 m at 0.6 m/s, 5.5 s of waiting, down: 45 s, and a fifth of the battery is left.
        (
            "endurance",
            {"items": WAY, "battery_left_s": 57.5},
            True,
            "about 0:45 (0.6 m/s assumed), battery 0:58",
        ),
        ("endurance", {"items": WAY, "battery_left_s": 55.0}, False, "20% reserve needed; charge the battery"),
        ("endurance", {"items": WAY}, None, "battery time not reported"),
        ("endurance", {}, None, "no mission"),
        ("free disk space", {"around": StationContext(free_disk_bytes=200e6)}, True, "0.2 GB free"),
        ("free disk space", {"around": StationContext(free_disk_bytes=199e6)}, False, "0.2 GB free"),
        ("free disk space", {}, None, "unknown"),
        ("recording", {}, None, "no recorder"),
        ("operator control", {"told": {"commander_id": None}}, None, "not reported"),
        ("operator control", {"told": {"commander_id": 0}}, True, "no station has control"),
        ("operator control", {"told": {"commander_id": 300}, "commander": "station 1"}, False, "station 1 has control"),
        ("operator control", {"told": {"commander_id": 300}, "in_command": True}, True, "this station has control"),
        # Sensors present and enabled that are not healthy; those switched off do not count.
        ("vehicle's pre-arm checks", {"told": {"health": (7, 5, 3)}}, False, "1 sensors unhealthy"),
        ("vehicle's pre-arm checks", {"told": {"health": (7, 3, 3)}}, True, "sensors healthy"),
        ("vehicle's pre-arm checks", {}, None, "not reported"),
    ],
)
def test_where_good_ends(name, given, ok, says):
    found, text = judged(name, **given)
    assert found is ok or (ok is not None and found is not None and bool(found) == ok), text
    assert says in text


def test_heights_above_the_terrain_are_shown_as_what_they_are():
    """Nobody here knows how high the terrain lies, so they are no heights over home."""
    origin = GlobalOrigin(47.0, 8.0, 400.0)
    for frame in (10, 11):
        (row,) = rows_from_items([MissionItem(0, frame, 16, x=470000000, y=80000000, z=12.0)], origin)
        assert row.position[:2] == pytest.approx((0.0, 0.0))
        assert math.isnan(row.position[2])
        assert row.text == "12 m above the terrain"
    (home,) = rows_from_items([MissionItem(0, 3, 16, x=470000000, y=80000000, z=12.0)], origin)
    assert home.position[2] == -12.0


def test_rows_give_a_place_and_a_heading_to_items_that_have_them():
    def row(command, *params, frame=1):
        (found,) = rows_from_items([MissionItem(0, frame, command, params=params, x=20000, y=-10000, z=-1.5)])
        return found

    assert math.isnan(row(93, 4.0, -1.0, -1.0, -1.0).position[0])  # a delay is nowhere
    assert row(93, 4.0, -1.0, -1.0, -1.0).wait_s == 4.0
    assert math.isnan(row(19, 4.0, 0.0, 0.0, 1.0).heading_rad)
    assert row(17, 0.0, 0.0, 0.0, 90.0).heading_rad == pytest.approx(math.pi / 2)
    assert row(16, 0.0, 0.0, 0.0, math.nan, frame=4).position == (-1.0, 2.0, 1.5)
    assert row(178, 1.0, -1.0, -1.0, 0.0).text == "unchanged"
    assert row(178, 3.0, 1.5, -1.0, 0.0).text == "descent 1.5 m/s"


def test_of_a_vehicle_that_is_not_heard_no_check_stays_green(world):
    """It may have fallen: what it said last is told as that, and judged no more."""
    say(world, status(PREARM))
    assert check(world, "battery").ok
    world.down[0].cut = True
    world.run(5.0)
    told = {c.name: (c.ok, c.text) for c in world.seen[0].preflight_checks}
    assert [told["heartbeat"][0], told["link"][0]] == [False, False]
    ours = ("heartbeat", "link", "recording", "free disk space")
    assert {ok for name, (ok, _) in told.items() if name not in ours} == {None}
    assert told["battery"][1].startswith("no message for ")
    assert "last value: 80 %" in told["battery"][1]
    world.down[0].cut = False
    world.run(1.0)
    assert check(world, "parameters").ok
