"""What real clients stumbled over, each as a test without the client."""

from __future__ import annotations

import pytest
from link_rig import Rig, waypoint

from mufly.link import MissionItem
from mufly.link import mavlink as m

SET_MODE = m.MAV_CMD_DO_SET_MODE


def test_the_last_item_is_reached_when_nothing_of_the_mission_is_left():
    """MAVSDK takes the mission for finished then, and clears it: it must not be told while the wait goes on."""
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    gcs.upload([waypoint(0.2, 0, -1.0), waypoint(0.2, 0.2, -1.0, wait=2.0)])
    assert rig.run(3.0, lambda: gcs.giver.result == 0)
    gcs.mode(4, 4)
    assert rig.run(20.0, lambda: rig.status.waypoint_index == 2)
    rig.run(1.0)
    assert [x.seq for x in gcs.all("MISSION_ITEM_REACHED")] == [0]
    assert rig.run(5.0, lambda: len(gcs.all("MISSION_ITEM_REACHED")) == 2)
    # By then the mission has said that it is complete, and at once it may be cleared.
    kinds = [x.get_type() for x in gcs.heard]
    reached = max(k for k, kind in enumerate(kinds) if kind == "MISSION_ITEM_REACHED")
    complete = [k for k, x in enumerate(gcs.heard) if kinds[k] == "MISSION_CURRENT" and x.mission_state == 5]
    assert complete[0] < reached
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
    assert abs(at.altitude_relative - (height + rig.status.home_position[2])) < 0.05


def test_altitude_above_the_sea_is_not_made_up():
    rig = Rig()
    gcs = rig.station()
    rig.run(1.0)
    at = gcs.last("ALTITUDE")
    assert at.altitude_amsl != at.altitude_amsl  # not a number
    assert at.altitude_terrain < -1000.0
    assert 0.0 <= at.altitude_local < 0.2


def test_a_delay_is_a_longer_wait_and_is_reached():
    """MAVSDK's mission plugin writes a loiter time as NAV_DELAY behind the waypoint."""
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    delay = MissionItem(0, 2, m.MAV_CMD_NAV_DELAY, params=(1.0, -1.0, -1.0, -1.0))
    gcs.upload([waypoint(0.2, 0, -1.0), delay, waypoint(0.2, 0.2, -1.0, wait=0.5), delay])
    assert rig.run(3.0, lambda: gcs.giver.result == 0)
    assert [w.wait_s for w in rig.status.mission.waypoint] == [1.0, 1.5]
    gcs.mode(4, 4)
    assert rig.run(30.0, lambda: len(gcs.all("MISSION_ITEM_REACHED")) == 4), gcs.words
    assert [x.seq for x in gcs.all("MISSION_ITEM_REACHED")] == [0, 1, 2, 3]
    assert gcs.last("MISSION_CURRENT").mission_state == 5


def test_a_parameter_that_is_not_there_is_answered():
    """MAVSDK asks for PX4's RTL_RETURN_ALT, six times when nobody answers."""
    rig = Rig()
    gcs = rig.station()
    gcs.say(m.MAVLink_param_request_read_message(1, 1, b"RTL_RETURN_ALT", -1))
    gcs.say(m.MAVLink_param_set_message(1, 1, b"RTL_RETURN_ALT", 1.0, m.MAV_PARAM_TYPE_REAL32))
    gcs.say(m.MAVLink_param_request_read_message(1, 1, b"", 999))
    rig.run(0.1)
    errors = [(x.param_id, x.param_index, x.error) for x in gcs.all("PARAM_ERROR")]
    assert errors == [("RTL_RETURN_ALT", -1, 1), ("RTL_RETURN_ALT", -1, 1), ("", 999, 1)]


def test_who_may_not_set_a_parameter_is_told_its_value():
    rig = Rig()
    gcs, other = rig.station(), rig.station("other", 254)
    gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    rig.run(0.1)
    other.say(m.MAVLink_param_set_message(1, 1, b"LIM_SPEED", 0.4, m.MAV_PARAM_TYPE_REAL32))
    rig.run(0.1)
    now = rig.flight.autopilot.parameters["LIM_SPEED"].value
    assert [(x.param_id, x.param_value) for x in other.all("PARAM_VALUE")] == [("LIM_SPEED", pytest.approx(now))]
    assert now != pytest.approx(0.4)
    other.say(m.MAVLink_param_set_message(1, 1, b"\xff\xfeSPEED", 0.4, m.MAV_PARAM_TYPE_REAL32))
    rig.run(0.1)
    assert other.last("PARAM_ERROR").error == m.MAV_PARAM_ERROR_DOES_NOT_EXIST


def test_a_mode_chosen_on_the_floor_begins_when_it_is_armed():
    """QGroundControl's "start mission" and "take off" choose the mode, wait until it shows, and arm."""
    rig = Rig()
    gcs = rig.station()
    rig.run(0.1)
    gcs.mode(4, 4)
    rig.run(0.1)
    assert gcs.acks == [(SET_MODE, m.MAV_RESULT_DENIED)]
    assert "no mission" in gcs.words
    gcs.upload([waypoint(0.2, 0, -1.0)])
    assert rig.run(3.0, lambda: gcs.giver.result == 0)
    gcs.mode(4, 4)
    rig.run(0.5)
    assert gcs.last("HEARTBEAT").custom_mode == 4 << 16 | 4 << 24
    assert not rig.status.armed
    assert rig.flight.status.actuators.motor_input.max() == 0.0
    gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert rig.run(30.0, lambda: rig.status.waypoint_index == 1), gcs.words


def test_what_was_chosen_on_the_floor_is_forgotten():
    rig = Rig()
    gcs = rig.station()
    for forget in (lambda: rig.run(11.0), lambda: gcs.mode(4, 3)):
        gcs.mode(4, 2)
        rig.run(0.5)
        assert gcs.last("HEARTBEAT").custom_mode == 4 << 16 | 2 << 24
        forget()
        rig.run(1.0)
        assert gcs.last("HEARTBEAT").custom_mode == 4 << 16 | 1 << 24
        gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        rig.run(5.0)
        assert rig.status.state == "init"
        gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        rig.run(0.5)
    gcs.mode(4, 2)
    gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert rig.run(15.0, lambda: rig.status.state == "hover")


def test_no_fence_is_broken_where_there_is_none():
    """MAVProxy says "fence breach" to whoever does not set the bit."""
    rig = Rig()
    gcs = rig.station()
    rig.run(1.0)
    status = gcs.last("SYS_STATUS")
    assert status.onboard_control_sensors_health & m.MAV_SYS_STATUS_GEOFENCE
    assert not status.onboard_control_sensors_present & m.MAV_SYS_STATUS_GEOFENCE


def test_the_land_of_mavproxy():
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs, 0.6)
    gcs.say(m.MAVLink_command_long_message(1, 0, m.MAV_CMD_DO_LAND_START, 0, *[0.0] * 7))
    assert rig.run(20.0, lambda: not rig.status.armed)
    assert rig.status.outcome == "succeeded"
