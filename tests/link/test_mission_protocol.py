"""The vehicle's side of the mission protocol, message by message; the helicopter stands unless a test flies it."""

import pytest
from link_rig import Rig, waypoint

from mufly.flight import FlightState
from mufly.link import MissionItem
from mufly.link import mavlink as m
from mufly.link.mission_transfer import MAX_ITEMS

MISSION = {"name": "three", "waypoint": [{"position_m": [k, 0, -1]} for k in (0.0, 0.5)]}


def after(station, kind, do, seconds=0.1):
    """What of a kind a station hears within some time after it did something."""
    known = len(station.all(kind))
    do()
    station.rig.run(seconds)
    return station.all(kind)[known:]


def test_a_list_that_was_never_fetched_does_not_outlive_its_mission():
    rig = Rig(MISSION)
    gcs, other = rig.station(), rig.station("other", 254)
    rig.run(0.1)

    def ask(station):
        return after(station, "MISSION_COUNT", lambda: station.say(m.MAVLink_mission_request_list_message(1, 1)))

    (first,) = ask(gcs)
    assert first.count == len(rig.link._missions.plan.items) == 4
    ask(other)
    gcs.upload([waypoint(0, 0, -1), waypoint(0.5, 0, -1)])
    rig.run(1.0)
    assert gcs.last("MISSION_ACK").type == 0
    gcs.giver = None
    assert [c.count for c in ask(gcs)] == [2]
    # Another that goes on with the list it was offered gets all of that one, or nothing; never some of each.
    heard = after(other, "MISSION_ITEM_INT", lambda: other.say(m.MAVLink_mission_request_int_message(1, 1, 0)))
    assert [i.command for i in heard] == [22]
    assert [c.count for c in ask(other)] == [2]
    assert not after(other, "MISSION_ITEM_INT", lambda: other.say(m.MAVLink_mission_request_int_message(1, 1, 1)))
    # The same list asked for twice is one download: its Count was lost.
    after(gcs, "MISSION_ITEM_INT", lambda: gcs.say(m.MAVLink_mission_request_int_message(1, 1, 0)))
    assert [c.count for c in ask(gcs)] == [2]
    assert after(gcs, "MISSION_ITEM_INT", lambda: gcs.say(m.MAVLink_mission_request_int_message(1, 1, 1)))


def test_what_is_reached_and_what_comes_next_at_every_stage_of_a_flight():
    """An item is reached when it is done, none twice, and one that was given up never."""
    rig = Rig()
    gcs = rig.station()
    speed = MissionItem(0, 2, 178, params=(1.0, 0.4, -1.0, 0.0))
    items = [waypoint(0, 0, -1, command=22), waypoint(1, 0, -1), speed, waypoint(2, 0, -1, wait=1.0)]
    protocol = rig.link._missions
    waits, active, paused, complete = 2, 3, 4, 5  # MISSION_STATE
    running = {"mission_begun": True, "flying": True, "mission_running": True}
    flown = [
        ({"state": "init"}, 0, waits, []),
        ({"state": "take-off", **running}, 0, active, []),
        ({"state": "waypoint", **running}, 1, active, [0]),
        ({"state": "hover", "waypoint_index": 1, **running}, 3, active, [1]),
        ({"state": "waypoint", "waypoint_index": 1, **running}, 3, active, [2]),
        ({"state": "obstacle", "waypoint_index": 1, **running}, 3, active, []),
    ]
    for end, last in (
        (
            waypoint(2, 0, 0, command=21),
            [
                ({"state": "hover", "waypoint_index": 2, **running}, 4, active, []),
                ({"state": "landing", "waypoint_index": 2, **running}, 4, active, [3]),
                (
                    {"state": "init", "waypoint_index": 2, "mission_begun": True, "outcome": "succeeded"},
                    4,
                    complete,
                    [4],
                ),
            ],
        ),
        (
            MissionItem(0, 2, 93, params=(2.0, 0, 0, 0)),
            [
                ({"state": "hover", "waypoint_index": 2, **running}, 4, active, []),
                ({"state": "hover", "waypoint_index": 2, "mission_begun": True, "flying": True}, 4, complete, [3, 4]),
            ],
        ),
        (
            waypoint(2, 0, 0, command=21),
            [
                ({"state": "hover", "waypoint_index": 1, "mission_begun": True, "flying": True}, 3, paused, []),
                # Told to land where it is, it lands well; the mission was not flown to its end.
                ({"state": "landing", "waypoint_index": 1, "mission_begun": True, "flying": True}, 3, paused, []),
                ({"state": "init", "waypoint_index": 1, "mission_begun": True, "outcome": "succeeded"}, 3, waits, []),
            ],
        ),
    ):
        gcs.heard.clear()
        gcs.upload([*items, end])
        assert rig.run(1.0, lambda: gcs.last("MISSION_ACK")), gcs.words
        for stage, current, state, reached in [*flown, *last]:
            status = FlightState(**stage)
            now = protocol.mission_progress(status)
            assert (now.current_item, now.item_count, now.mission_state, now.mission_mode) == (
                current,
                5,
                state,
                1 if state == active else 2,
            ), stage
            assert protocol.take_reached_items(status) == reached, stage
        rig.now_s += 10.0


def test_a_mission_that_somebody_else_loads_is_the_one_that_is_told():
    rig = Rig(MISSION)
    gcs = rig.station()
    rig.run(0.1)
    for change, commands in (
        ({}, [22, 16, 16, 21]),
        ({"at_end": "return"}, [22, 16, 16, 20]),
        ({"waypoint": ()}, []),
    ):
        mission = rig.status.mission.model_copy(update=change)
        assert rig.link.autopilot.load_mission(mission)
        rig.run(0.1)
        got = gcs.download()
        assert rig.run(1.0, lambda got=got: got)
        assert [i.command for i in got[0]] == commands


def test_an_upload_of_a_peer_that_has_gone_makes_room_for_the_next():
    rig = Rig()
    gcs, other = rig.station(), rig.station("other", 254)
    rig.run(0.05)
    gcs.say(m.MAVLink_mission_count_message(1, 1, 3, 0))
    rig.run(0.05)
    for peer, busy in (("other", True), ("gcs", False)):
        rig.link._missions.forget_peer(peer)
        assert (rig.link._missions._receiver.peer is not None) is busy
    assert other.acks == []


@pytest.mark.parametrize(
    ("count", "kind", "result", "why"),
    [
        (MAX_ITEMS + 1, 0, 4, "more than 500 items"),
        (1, 2, 3, "no rally points"),
        (1, 9, 3, "no rally points"),
    ],
)
def test_a_mission_that_is_refused_before_its_items_come_is_refused_with_words(count, kind, result, why):
    rig = Rig()
    gcs, other = rig.station(), rig.station("other", 254)
    (ack,) = after(gcs, "MISSION_ACK", lambda: gcs.say(m.MAVLink_mission_count_message(1, 1, count, kind)))
    assert (ack.type, ack.mission_type) == (result, kind)
    assert why in gcs.words
    assert why not in other.words
    # Of nothing there is nothing to refuse.
    if kind != 9:
        (ack,) = after(gcs, "MISSION_ACK", lambda: gcs.say(m.MAVLink_mission_count_message(1, 1, 0, kind)))
        assert ack.type == 0


def test_a_mission_is_taken_during_a_take_off_and_on_the_way_to_a_place_and_flown_when_started():
    """As PX4 does; and a hold is accepted from the first moment on, and kept once it is off the floor."""
    rig = Rig()
    gcs = rig.station()
    rig.run(0.1)
    gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    rig.run(0.1)
    gcs.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0)
    rig.run(0.1)
    assert rig.status.motors == "spin_up"
    gcs.upload([waypoint(0.3, 0, -0.6)])
    assert rig.run(1.0, lambda: gcs.last("MISSION_ACK")), gcs.words
    assert gcs.last("MISSION_ACK").type == 0
    gcs.command(m.MAV_CMD_DO_PAUSE_CONTINUE, 0)
    rig.run(0.1)
    assert gcs.acks[-1] == (m.MAV_CMD_DO_PAUSE_CONTINUE, 0)
    assert rig.status.state == "take-off"
    assert rig.run(10.0, lambda: rig.status.state == "hover"), gcs.words
    rig.run(1.0)
    assert -0.6 < rig.position[2] < -0.2  # well below the metre that the take-off was to
    gcs.command_int(m.MAV_CMD_DO_REPOSITION, -1, 0, 0, float("nan"), x=20000, y=0, z=-0.6)
    rig.run(0.5)
    assert rig.status.state == "waypoint"
    gcs.heard.clear()
    gcs.upload([waypoint(0.0, 0, -0.6), waypoint(0.2, 0, -0.6)])
    assert rig.run(2.0, lambda: gcs.last("MISSION_ACK")), gcs.words
    assert (gcs.last("MISSION_ACK").type, rig.status.state) == (0, "waypoint")
    gcs.command(m.MAV_CMD_MISSION_START)
    assert rig.run(8.0, lambda: rig.status.reached_waypoint_count == 1), gcs.words
    # While it flies a mission it takes no other.
    gcs.heard.clear()
    gcs.upload([waypoint(0.3, 0, -0.6)])
    assert rig.run(2.0, lambda: gcs.last("MISSION_ACK")), gcs.words
    assert gcs.last("MISSION_ACK").type == 14
    assert "pause it first" in gcs.words


def fence_item(command, first, n, e):
    return MissionItem(0, 1, command, params=(first, 0.0, 0.0, 0.0), x=round(1e4 * n), y=round(1e4 * e), mission_type=1)


def test_a_fence_goes_up_and_comes_down_to_the_bit_and_keeps_its_vehicle():
    rig = Rig()
    gcs = rig.station()
    rig.run(0.6)
    bit = m.MAV_SYS_STATUS_GEOFENCE
    assert not gcs.last("SYS_STATUS").onboard_control_sensors_enabled & bit
    corners = [(-2.0, -2.0), (4.0, -2.0), (4.0, 2.0), (-2.0, 2.0)]
    items = [*(fence_item(5001, 4.0, n, e) for n, e in corners), fence_item(5004, 0.5, 3.0, 1.0)]
    gcs.upload(items, mission_type=1)
    rig.run(1.0)
    assert (gcs.last("MISSION_ACK").type, gcs.last("MISSION_ACK").mission_type) == (0, 1)
    assert rig.status.mission.fence.polygon_m == tuple(corners)
    gcs.giver = None
    got = gcs.download(mission_type=1)
    assert rig.run(1.0, lambda: got)
    assert [(i.command, i.params, i.x, i.y) for i in got[0]] == [(i.command, i.params, i.x, i.y) for i in items]
    gcs.taker = None
    rig.run(1.0)
    rig.run(1.5)
    status, fence = gcs.last("SYS_STATUS"), gcs.last("FENCE_STATUS")
    assert status.onboard_control_sensors_enabled & bit
    assert status.onboard_control_sensors_health & bit
    assert (fence.breach_status, fence.breach_count, fence.breach_type) == (0, 0, m.FENCE_BREACH_NONE)
    # A mission that leads outside of it is refused, with words; without a fence it is taken.
    gcs.upload([waypoint(0, 0, -1), waypoint(6, 0, -1)])
    rig.run(1.0)
    assert gcs.last("MISSION_ACK").type != 0
    assert "outside the fence" in gcs.words
    (ack,) = after(gcs, "MISSION_ACK", lambda: gcs.say(m.MAVLink_mission_clear_all_message(1, 1, 1)))
    assert (ack.type, ack.mission_type) == (0, 1)
    assert rig.status.mission.fence is None
