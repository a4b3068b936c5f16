"""Items as missions and back: nothing is lost, nothing is guessed, the field to blame is named."""

import math

import pytest
from link_rig import waypoint

from mufly.link import (
    GlobalOrigin,
    MissionItem,
    MissionRefusedError,
    MissionResultCode,
    mission_from_items,
    mission_to_items,
)
from mufly.link.codec import mavlink
from mufly.mission import Mission, list_builtin_missions, load_mission
from mufly.mission.files.mission_items import FRAME_LOCAL_ENU, FRAME_LOCAL_NED, MissionCommand

BASE = Mission(name="base")
ZURICH = GlobalOrigin(47.3769, 8.5417, 408.0)


def numbered(*items):
    return tuple(MissionItem(k, i.frame, i.command, 0, 1, i.params, i.x, i.y, i.z) for k, i in enumerate(items))


def test_commands_and_frames_have_mavlinks_numbers():
    """The mission room has its own table: it does not import pymavlink."""
    assert {c.name: c.value for c in MissionCommand} == {
        c.name: getattr(mavlink, f"MAV_CMD_{c.name}") for c in MissionCommand
    }
    assert (FRAME_LOCAL_NED, FRAME_LOCAL_ENU) == (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_ENU)


@pytest.mark.parametrize("name", list_builtin_missions())
def test_every_mission_survives_the_way_there_and_back(name):
    mission = load_mission(name)
    again = mission_from_items(mission_to_items(mission).items, mission, None)
    assert again.mission.at_end == mission.at_end
    assert again.mission.take_off == mission.take_off
    for a, b in zip(again.mission.waypoint, mission.waypoint, strict=True):
        assert a.position_m == pytest.approx(b.position_m, abs=5e-5)
        assert (a.wait_s, a.heading_deg, a.speed_m_s) == (b.wait_s, b.heading_deg, b.speed_m_s)
    assert again.waypoint_item_index == mission_to_items(mission).waypoint_item_index


def test_speeds_and_headings_go_to_the_legs_that_follow():
    speed = MissionItem(0, 2, 178, params=(1, 0.3, -1, 0))
    own, same = (MissionItem(0, 2, 178, params=(1, v, -1, 0)) for v in (-2, -1))
    turn = MissionItem(0, 2, 115, params=(90, 0, 0, 0))
    plan = mission_from_items(
        numbered(
            waypoint(0, 0, -1),
            speed,
            waypoint(1, 0, -1),
            turn,
            waypoint(1, 1, -1),
            own,
            waypoint(0, 1, -1),
            speed,
            same,
            waypoint(0, 0, -1),
        ),
        BASE,
        None,
    )
    w = plan.mission.waypoint
    assert [x.speed_m_s for x in w] == [None, 0.3, 0.3, None, 0.3]
    assert [x.heading_deg for x in w] == [None, None, 90.0, None, None]
    assert plan.waypoint_item_index == (0, 2, 4, 6, 9)
    assert [plan.first_waypoint_from_item(k) for k in range(11)] == [0, 1, 1, 2, 2, 3, 3, 4, 4, 4, None]
    # Told again, a speed is that over ground (1), and the throttle stays as it is (-1), as the specification has it.
    told = [i.params for i in mission_to_items(plan.mission).items if i.command == 178]
    assert told == [(1.0, 0.3, -1.0, 0.0), (1.0, -2.0, -1.0, 0.0), (1.0, 0.3, -1.0, 0.0)]


def test_a_delay_is_a_longer_wait_at_the_waypoint_before_it_or_after_the_take_off():
    delay = MissionItem(0, 2, 93, params=(3.0, -1, -1, -1))
    up = waypoint(0, 0, -1.5, command=22)
    for items, climb, first in (
        ((up, delay, delay, waypoint(1, 0, -1, wait=0.5)), 6.0, 0.5),
        ((delay, waypoint(1, 0, -1), delay), 3.0, 3.0),
    ):
        mission = mission_from_items(numbered(*items), BASE, None).mission
        assert mission.take_off.wait_s == BASE.take_off.wait_s + climb
        assert mission.waypoint[0].wait_s == first


@pytest.mark.parametrize(("last", "end"), [(17, "hover"), (20, "return"), (21, "land"), (16, "hover")])
def test_how_it_ends(last, end):
    assert (
        mission_from_items(numbered(waypoint(0, 0, -1), waypoint(1, 0, -1, command=last)), BASE, None).mission.at_end
        == end
    )


def test_a_landing_elsewhere_is_flown_to():
    plan = mission_from_items(numbered(waypoint(0, 0, -1.2), waypoint(1, 0, 0, command=21)), BASE, None)
    assert [w.position_m for w in plan.mission.waypoint] == [(0, 0, -1.2), (1, 0, -1.2)]
    assert plan.waypoint_item_index == (0, 1)
    nowhere = MissionItem(0, 1, 21, x=2**31 - 1, y=2**31 - 1)
    assert len(mission_from_items(numbered(waypoint(0, 0, -1.2), nowhere), BASE, None).mission.waypoint) == 1
    for end in ("hover", "land", "return"):
        mission = plan.mission.model_copy(update={"at_end": end})
        again = mission_from_items(mission_to_items(mission).items, BASE, None).mission
        assert (again.at_end, again.waypoint) == (end, mission.waypoint)


def test_places_on_the_globe():
    lat, lon, alt = ZURICH.to_global(3.0, -4.0, -1.5)
    x, y = round(lat * 1e7), round(lon * 1e7)
    for frame, z in ((0, alt), (5, alt), (3, 1.5), (6, 1.5)):
        item = MissionItem(0, frame, 16, params=(0, 0, 0, math.nan), x=x, y=y, z=z)
        (w,) = mission_from_items((item,), BASE, ZURICH).mission.waypoint
        assert w.position_m == pytest.approx((3.0, -4.0, -1.5), abs=0.012)
        with pytest.raises(MissionRefusedError, match="needs a global origin") as caught:
            mission_from_items((item,), BASE, None)
        assert caught.value.result is MissionResultCode.UNSUPPORTED_FRAME


def test_east_north_up():
    (w,) = mission_from_items((waypoint(1, 2, 1.5, frame=4),), BASE, None).mission.waypoint
    assert w.position_m == (2, 1, -1.5)


@pytest.mark.parametrize(
    ("items", "result"),
    [
        ([waypoint(0, 0, 1.0)], MissionResultCode.INVALID_PARAM7),
        ([waypoint(0, 0, -0.1)], MissionResultCode.INVALID_PARAM7),
        ([waypoint(0, 0, math.nan)], MissionResultCode.INVALID_PARAM7),
        ([waypoint(0, 0, -1, wait=-1)], MissionResultCode.INVALID_PARAM1),
        ([waypoint(0, 0, -1, wait=math.inf)], MissionResultCode.INVALID_PARAM1),
        ([waypoint(0, 0, -1, heading=400)], MissionResultCode.INVALID_PARAM4),
        ([waypoint(0, 0, -1, frame=7)], MissionResultCode.UNSUPPORTED_FRAME),
        ([waypoint(0, 0, -1, command=18)], MissionResultCode.UNSUPPORTED),
        ([waypoint(0, 0, -1, command=82)], MissionResultCode.UNSUPPORTED),
        ([MissionItem(0, 1, 16, x=2**31 - 1, z=-1.0)], MissionResultCode.INVALID_PARAM5_X),
        ([MissionItem(0, 1, 16, y=2**31 - 1, z=-1.0)], MissionResultCode.INVALID_PARAM6_Y),
        ([waypoint(0, 0, -1), waypoint(0, 0, -1, command=22)], MissionResultCode.INVALID_SEQUENCE),
        (
            [waypoint(0, 0, -1), waypoint(0, 0, 0, command=21), waypoint(0, 0, -1)],
            MissionResultCode.INVALID_SEQUENCE,
        ),
        ([waypoint(0, 0, -60, command=22), waypoint(0, 0, -1)], MissionResultCode.INVALID_PARAM7),
        ([waypoint(0, 0, -1, command=22)], MissionResultCode.INVALID),
        ([MissionItem(0, 2, 178, params=(2, 1, 0, 0)), waypoint(0, 0, -1)], MissionResultCode.INVALID_PARAM1),
        (
            [MissionItem(0, 2, 178, params=(1, math.nan, 0, 0)), waypoint(0, 0, -1)],
            MissionResultCode.INVALID_PARAM2,
        ),
        ([MissionItem(0, 2, 115, params=(9, 0, 0, 1)), waypoint(0, 0, -1)], MissionResultCode.INVALID_PARAM4),
        ([waypoint(0, 0, -1), MissionItem(0, 2, 115, params=(9, 0, 0, 0))], MissionResultCode.INVALID_SEQUENCE),
    ],
)
def test_what_cannot_be_flown_is_refused_with_the_field_to_blame(items, result):
    with pytest.raises(MissionRefusedError) as caught:
        mission_from_items(numbered(*items), BASE, None)
    assert caught.value.result is result
    assert "mission" in str(caught.value)


def test_the_origin_goes_there_and_back():
    for lat in (-80.0, 0.0, 47.4, 84.0):
        origin = GlobalOrigin(lat, 179.9999, 100.0)
        place = origin.to_global(120.0, -340.0, -7.0)
        assert origin.to_local(*place) == pytest.approx((120.0, -340.0, -7.0), abs=1e-6)


def test_a_degree_of_latitude_is_as_long_as_the_ellipsoid_says():
    # Lengths of one degree at 0 and 60 degrees: 110.574 and 111.412 km; of longitude: 111.320 and 55.800 km.
    for lat, north, east in ((0.0, 110_574, 111_320), (60.0, 111_412, 55_800)):
        n, e, _ = GlobalOrigin(lat, 0.0, 0.0).to_local(lat + 0.001, 0.001, 0.0)
        assert n == pytest.approx(north / 1000, rel=2e-5)
        assert e == pytest.approx(east / 1000, rel=2e-5)


@pytest.mark.parametrize("p4", [0.0, 1.0, -1.0, 90.0, math.nan])
def test_where_a_fixed_wing_leaves_a_loiter_turns_no_nose(p4):
    """Parameter 4 of NAV_LOITER_TIME is no heading; that of a waypoint, an endless hover and a landing is one."""
    loiter = MissionItem(0, 1, 19, params=(5.0, 0.0, 0.0, p4), x=10000, y=10000, z=-1.0)
    second = mission_from_items(numbered(waypoint(1, 0, -1), loiter), BASE, None).mission.waypoint[1]
    assert (second.wait_s, second.heading_deg) == (5.0, None)
    for command in (16, 17, 21):
        item = MissionItem(0, 1, command, params=(0.0, 0.0, 0.0, p4), x=10000, y=10000, z=-1.0)
        last = mission_from_items(numbered(waypoint(1, 0, -1), item), BASE, None).mission.waypoint[-1]
        assert last.heading_deg == (None if math.isnan(p4) else p4)


@pytest.mark.parametrize(
    ("item", "result", "words"),
    [
        (MissionItem(0, 10, 16, x=473769000, y=85417000, z=2.0), MissionResultCode.UNSUPPORTED_FRAME, "terrain"),
        (MissionItem(0, 11, 22, z=2.0), MissionResultCode.UNSUPPORTED_FRAME, "terrain"),
        (MissionItem(0, 2, 93, params=(-1.0, 12.0, 0.0, 0.0)), MissionResultCode.INVALID_PARAM1, "time of day"),
        (MissionItem(0, 2, 115, params=(90.0, 0.0, 0.0, 0.5)), MissionResultCode.INVALID_PARAM4, "absolute"),
        (MissionItem(0, 2, 206), MissionResultCode.UNSUPPORTED, "DO_SET_CAM_TRIGG_DIST"),
    ],
)
def test_what_an_item_cannot_say_here_is_named(item, result, words):
    items = numbered(item, waypoint(0, 0, -1)) if item.command in (16, 22) else numbered(waypoint(0, 0, -1), item)
    with pytest.raises(MissionRefusedError, match=words) as caught:
        mission_from_items(items, BASE, ZURICH)
    assert caught.value.result == result


def test_a_landing_on_the_globe_without_a_place_is_where_it_is():
    land = MissionItem(0, 3, 21, params=(0.0, 0.0, 0.0, math.nan))
    plan = mission_from_items(numbered(waypoint(1, 0, -1), land), BASE, ZURICH)
    assert (len(plan.mission.waypoint), plan.mission.at_end) == (1, "land")
