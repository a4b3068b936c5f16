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
