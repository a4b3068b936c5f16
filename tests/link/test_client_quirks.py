"""What real clients stumbled over, each as a test without the client."""

from __future__ import annotations

from link_rig import Rig, waypoint

from mufly.link.dialect import mavlink as m


def test_the_last_item_is_reached_when_nothing_of_the_mission_is_left():
    """MAVSDK takes the mission for finished then, and clears it: it must not be told while the wait goes on."""
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    gcs.upload([waypoint(0.2, 0, -1.0), waypoint(0.2, 0.2, -1.0, wait=2.0)])
    assert rig.run(3.0, lambda: gcs.giver.result == 0)
    gcs.mode(4, 4)
    assert rig.run(20.0, lambda: rig.status.waypoint == 2)
    rig.run(1.0)
    assert [x.seq for x in gcs.all("MISSION_ITEM_REACHED")] == [0]
    assert rig.run(5.0, lambda: len(gcs.all("MISSION_ITEM_REACHED")) == 2)
    # It is told before the mission says that it is complete, and at once the mission may be cleared.
    kinds = [x.get_type() for x in gcs.heard]
    reached = max(k for k, kind in enumerate(kinds) if kind == "MISSION_ITEM_REACHED")
    complete = [k for k, x in enumerate(gcs.heard) if kinds[k] == "MISSION_CURRENT" and x.mission_state == 5]
    assert not complete or reached < complete[0]
    gcs.say(m.MAVLink_mission_clear_all_message(1, 1, 0))
    rig.run(0.1)
    assert gcs.last("MISSION_ACK").type == m.MAV_MISSION_ACCEPTED


def test_quaternion_and_altitude_come_unasked():
    """MAVSDK's telemetry waits for them without asking."""
    rig = Rig(origin=(47.0, 8.0, 400.0))
    gcs = rig.station()
    rig.airborne(gcs, 0.8)
    rig.run(1.0)
    assert len(gcs.all("ATTITUDE_QUATERNION")) > 10
    at, height = gcs.last("ALTITUDE"), -rig.position[2]
    assert abs(at.altitude_amsl - 400.0 - height) < 0.05
    assert abs(at.altitude_local - height) < 0.05
    assert abs(at.altitude_relative - (height + rig.status.home[2])) < 0.05


def test_altitude_above_the_sea_is_not_made_up():
    rig = Rig()
    gcs = rig.station()
    rig.run(1.0)
    at = gcs.last("ALTITUDE")
    assert at.altitude_amsl != at.altitude_amsl  # not a number
    assert at.altitude_terrain < -1000.0
    assert 0.0 <= at.altitude_local < 0.2
