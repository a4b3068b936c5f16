"""Whole flights through the link, in stepped time: what a station asks for is what the helicopter does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from link_rig import Rig, waypoint

from mufly.link import FrameEncoder, encode_transfer_message
from mufly.link import mavlink as m

ARM, TAKE_OFF, LAND = m.MAV_CMD_COMPONENT_ARM_DISARM, m.MAV_CMD_NAV_TAKEOFF, m.MAV_CMD_NAV_LAND


def on_the_wire(item):
    return FrameEncoder(1, 1)(encode_transfer_message(item, 1, 1))


def test_arm_take_off_mission_land():
    rig = Rig()
    gcs = rig.station()
    items = [
        waypoint(0, 0, -0.8, command=22),
        waypoint(0.4, 0, -0.8, wait=0.5),
        waypoint(0.4, 0.3, -1.0),
        waypoint(0.4, 0.3, 0, command=21),
    ]
    rig.run(1.2)
    assert gcs.last("HEARTBEAT").base_mode & 0x80 == 0
    assert gcs.last("SYS_STATUS").onboard_control_sensors_health & m.MAV_SYS_STATUS_PREARM_CHECK
    gcs.upload(items)
    assert rig.run(3.0, lambda: gcs.giver.result == 0)
    got = gcs.download()
    assert rig.run(3.0, lambda: got)
    # Equal to the last bit, NaN included.
    assert [on_the_wire(i) for i in got[0]] == [on_the_wire(replace(i, seq=k)) for k, i in enumerate(items)]
    gcs.command(ARM, 1)
    rig.run(0.1)
    gcs.mode(4, 4)
    assert rig.run(60.0, lambda: not rig.status.armed and rig.status.outcome), gcs.words
    assert rig.status.outcome == "succeeded"
    assert [x.seq for x in gcs.all("MISSION_ITEM_REACHED")] == [0, 1, 2, 3]
    currents = [x.seq for x in gcs.all("MISSION_CURRENT")]
    assert sorted(set(currents)) == [0, 1, 2, 3]
    assert currents == sorted(currents)
    states = [x.landed_state for x in gcs.all("EXTENDED_SYS_STATE")]
    assert list(dict.fromkeys(states)) == [1, 3, 2, 4]  # on the ground, take-off, in the air, landing
    assert states[-1] == 1
    modes = list(dict.fromkeys((x.custom_mode >> 16 & 255, x.custom_mode >> 24) for x in gcs.all("HEARTBEAT")))
    assert modes == [(4, 1), (4, 2), (4, 3), (4, 4), (4, 6)]
    at = gcs.last("LOCAL_POSITION_NED")
    assert math.hypot(at.x - 0.4, at.y - 0.3) < 0.1
    assert gcs.acks == [(ARM, 0), (m.MAV_CMD_DO_SET_MODE, 0)]


def test_go_to_pause_return():
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs, 0.8)
    assert rig.position[2] == pytest.approx(-0.8, abs=0.1)
    gcs.command_int(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, math.nan, x=4000, y=-2000, z=-1.0)
    assert rig.run(15.0, lambda: np.linalg.norm(rig.position - [0.4, -0.2, -1.0]) < 0.06)
    gcs.command_int(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, math.nan, x=30000, y=0, z=-1.0)
    rig.run(3.0)
    gcs.command(m.MAV_CMD_DO_PAUSE_CONTINUE, 0)
    rig.run(5.0)
    assert rig.status.state == "hover"
    assert np.linalg.norm(rig.flight.status.truth.velocity) < 0.05
    gcs.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    rig.run(1.0)
    last = gcs.last("HEARTBEAT").custom_mode
    assert (last >> 16 & 255, last >> 24) == (4, 5)
    assert rig.run(40.0, lambda: not rig.status.armed)
    assert np.linalg.norm(rig.position[:2]) < 0.1
    assert all(result == 0 for _, result in gcs.acks), gcs.words


def test_offboard_square():
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    gcs.mode(6)
    rig.run(0.2)
    assert gcs.acks[-1] == (m.MAV_CMD_DO_SET_MODE, m.MAV_RESULT_TEMPORARILY_REJECTED)
    for n, e in ((0.4, 0.0), (0.4, 0.4), (0.0, 0.0)):
        gcs.every = [
            m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x9F8, n, e, -1.0, 0, 0, 0, 0, 0, 0, 0, 0)
        ]
        if rig.status.state != "offboard":
            rig.run(0.2)
            gcs.mode(6)
        assert rig.run(20.0, lambda n=n, e=e: np.linalg.norm(rig.position - [n, e, -1.0]) < 0.06), gcs.words
        assert rig.status.state == "offboard"
    gcs.every = []
    assert rig.run(2.0, lambda: rig.status.state == "hover")
    assert "set-points lost" in gcs.words


def test_velocity_in_body_axes_goes_where_the_nose_points():
    rig = Rig({**{"name": "x"}, "start_heading_deg": 90.0})
    gcs = rig.station()
    rig.airborne(gcs)
    gcs.every = [m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0xDC7, 0, 0, 0, 0.2, 0, 0, 0, 0, 0, 0, 0)]
    rig.run(0.2)
    gcs.mode(6)
    rig.run(4.0)
    assert rig.flight.status.truth.velocity[1] == pytest.approx(0.2, abs=0.05)
    assert abs(rig.flight.status.truth.velocity[0]) < 0.05


def test_sticks_by_override_and_by_mode():
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    gcs.every = [m.MAVLink_rc_channels_override_message(1, 1, 1500, 1500, 1800, 1500, 0, 0, 0, 0)]
    before = rig.position[2]
    rig.run(2.0)
    assert rig.status.state == "rc"
    assert rig.position[2] < before - 0.2
    gcs.every = [m.MAVLink_rc_channels_override_message(1, 1, 0, 0, 0, 0, 0, 0, 0, 0)]
    rig.run(1.0)
    assert rig.status.state == "hover"
    # A joystick alone does nothing until a mode for flying by hand is asked for.
    gcs.every = [m.MAVLink_manual_control_message(1, 0, 0, 500, 800, 0)]
    rig.run(1.0)
    assert rig.status.state == "hover"
    yaw = rig.flight.status.truth.attitude[2]
    gcs.mode(2)
    rig.run(1.5)
    assert rig.status.state == "rc"
    assert rig.flight.status.truth.attitude[2] > yaw + 0.3  # to the right
    gcs.command(LAND)  # though the joystick goes on talking
    assert rig.run(20.0, lambda: not rig.status.armed), gcs.words
    assert gcs.acks[-1] == (LAND, 0)


def test_emergency_stop_by_a_bystander():
    rig = Rig()
    gcs, other = rig.station(), rig.station("other", 7)
    rig.airborne(gcs)
    other.command(ARM, 0)
    rig.run(0.2)
    assert other.acks == [(ARM, m.MAV_RESULT_DENIED)]
    assert "system 255" in other.words
    assert rig.status.armed
    other.command(ARM, 0, 21196)
    rig.run(0.2)
    assert not rig.status.armed
    assert not rig.flight.status.actuators.motor_input.any()
    assert other.acks[-1] == (ARM, 0)


def test_reset_after_a_crash():
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    gcs.command(m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    rig.run(0.2)
    assert gcs.acks[-1][1] == m.MAV_RESULT_TEMPORARILY_REJECTED
    gcs.command(m.MAV_CMD_DO_FLIGHTTERMINATION, 1)
    rig.run(3.0)
    gcs.command(m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    rig.run(1.0)
    assert gcs.acks[-1] == (m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0)
    rig.airborne(gcs)


def test_repositions_at_20_hz_move_the_vehicle():
    """Every one is another place, as a program that follows something sends them."""
    rig = Rig()
    gcs = rig.station()
    rig.airborne(gcs)
    for k in range(120):
        north = round(1e4 * (0.5 + 0.015 * k))
        gcs.command_int(m.MAV_CMD_DO_REPOSITION, -1.0, 0.0, 0.0, math.nan, x=north, z=-1.0)
        rig.run(0.05)
    assert [ack for ack in gcs.acks if ack[0] == m.MAV_CMD_DO_REPOSITION] == [(m.MAV_CMD_DO_REPOSITION, 0)] * 120
    assert rig.position[0] > 1.5
