"""What QGroundControl asks of a vehicle, by a scripted peer, for the program itself needs a screen.

The order of questions at connect is that of its ``InitialConnectStateMachine``, the orders are those of its
``PX4FirmwarePlugin`` (mavlink/qgroundcontrol, src/Vehicle and src/FirmwarePlugin/PX4). Each has to get the message
it asks for or a refusal that QGroundControl reads as "not supported"; silence costs its user up to a minute.
"""

import math

import numpy as np
import pytest
from link_rig import Rig, waypoint

from mufly.link import mavlink as m

REQUEST = m.MAV_CMD_REQUEST_MESSAGE
OK, UNSUPPORTED = m.MAV_RESULT_ACCEPTED, m.MAV_RESULT_UNSUPPORTED
ORIGIN = (47.3769, 8.5417, 408.0)
AVAILABLE_MODES, COMPONENT_METADATA, COMPONENT_INFORMATION, GIMBAL_MANAGER, PROTOCOL_VERSION = (
    435,
    397,
    395,
    280,
    300,
)
NAN = math.nan


@pytest.fixture
def qgc():
    rig = Rig(origin=ORIGIN)
    station = rig.station("qgc", 255, 190)
    rig.run(1.5)
    station.rig = rig
    return station


def answer(qgc, command):
    """The acknowledgement of a command, within half a second."""
    assert qgc.rig.run(0.5, lambda: any(a.command == command for a in qgc.all("COMMAND_ACK"))), command
    return qgc.last("COMMAND_ACK").result


def test_the_heartbeat_names_a_vehicle_that_it_knows(qgc):
    beat = qgc.last("HEARTBEAT")
    assert (beat.type, beat.autopilot) == (m.MAV_TYPE_COAXIAL, m.MAV_AUTOPILOT_PX4)
    assert beat.base_mode & m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    assert beat.get_srcComponent() == m.MAV_COMP_ID_AUTOPILOT1


def test_autopilot_version_says_what_to_ask_for(qgc):
    qgc.command(REQUEST, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    assert answer(qgc, REQUEST) == OK
    can = qgc.last("AUTOPILOT_VERSION").capabilities
    for bit in ("MISSION_INT", "COMMAND_INT", "MAVLINK2", "SET_POSITION_TARGET_LOCAL_NED"):
        assert can & getattr(m, f"MAV_PROTOCOL_CAPABILITY_{bit}"), bit
    # What it lacks it does not promise: QGroundControl then leaves rally points and files alone.
    for bit in ("MISSION_RALLY", "FTP"):
        assert not can & getattr(m, f"MAV_PROTOCOL_CAPABILITY_{bit}"), bit


@pytest.mark.parametrize(
    "number",
    [AVAILABLE_MODES, COMPONENT_METADATA, COMPONENT_INFORMATION, GIMBAL_MANAGER, PROTOCOL_VERSION, 259],
)
def test_what_it_does_not_have_is_refused_at_once(qgc, number):
    qgc.command(REQUEST, number, 1)
    assert answer(qgc, REQUEST) == UNSUPPORTED


def test_parameters_for_all_components(qgc):
    qgc.say(m.MAVLink_param_request_list_message(1, 0))
    qgc.rig.run(1.0)
    values = qgc.all("PARAM_VALUE")
    count = values[0].param_count
    assert {v.param_index for v in values} == set(range(count))
    assert len({v.param_id for v in values}) == count
    qgc.say(m.MAVLink_param_request_read_message(1, 1, b"", 3))
    qgc.rig.run(0.2)
    assert qgc.last("PARAM_VALUE").param_index == 3
    # The cache of PX4's parameters: asked for by name, not there, and said so.
    qgc.say(m.MAVLink_param_request_read_message(1, 0, b"_HASH_CHECK", -1))
    qgc.rig.run(0.2)
    assert qgc.last("PARAM_ERROR").param_id == "_HASH_CHECK"


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_lists_of_missions_fences_and_rally_points(qgc, kind):
    qgc.say(m.MAVLink_mission_request_list_message(1, 1, kind))
    qgc.rig.run(0.3)
    count = qgc.last("MISSION_COUNT")
    assert (count.count, count.mission_type) == (0, kind)
    qgc.say(m.MAVLink_mission_clear_all_message(1, 1, kind))
    qgc.rig.run(0.3)
    ack = qgc.last("MISSION_ACK")
    assert (ack.type, ack.mission_type) == (m.MAV_MISSION_ACCEPTED, kind)


def test_home_is_told_and_streams_are_set(qgc):
    qgc.command(REQUEST, m.MAVLINK_MSG_ID_HOME_POSITION)
    assert answer(qgc, REQUEST) == OK
    home = qgc.last("HOME_POSITION")
    assert home.latitude == pytest.approx(ORIGIN[0] * 1e7, abs=2)
    qgc.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, 50_000)
    assert answer(qgc, m.MAV_CMD_SET_MESSAGE_INTERVAL) == OK
    assert math.isfinite(qgc.last("ALTITUDE").altitude_amsl)  # without it "vehicle position not known"


def test_a_plan_of_its_own(qgc):
    """Take-off, speed, waypoints and return, as its plan view writes them: frames 3 and 2, degrees."""
    rig = qgc.rig
    lat, lon = (lambda n: round((ORIGIN[0] + n / 111_200) * 1e7)), round(ORIGIN[1] * 1e7)
    take_off = waypoint(0, 0, 1.0, command=22, frame=3)
    items = [
        take_off.__class__(0, 3, 22, 1, 1, (0.0, 0.0, 0.0, NAN), lat(0), lon, 1.0),
        take_off.__class__(1, 2, 178, 0, 1, (1.0, 0.5, -1.0, 0.0), 0, 0, 0.0),
        take_off.__class__(2, 3, 16, 0, 1, (0.0, 0.0, 0.0, NAN), lat(0.5), lon, 1.0),
        take_off.__class__(3, 2, 20, 0, 1, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0),
    ]
    qgc.upload(items)
    assert rig.run(3.0, lambda: qgc.giver.result is not None)
    assert qgc.giver.result == 0, qgc.words
    # "Start mission": choose the mode, wait until it shows, arm.
    qgc.mode(4, 4)
    assert rig.run(1.5, lambda: qgc.last("HEARTBEAT").custom_mode == 4 << 16 | 4 << 24)
    qgc.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    assert rig.run(40.0, lambda: rig.status.waypoint_index == 1), qgc.words
    assert rig.position[0] == pytest.approx(0.5, abs=0.1)
    assert rig.run(40.0, lambda: not rig.status.armed)
    assert np.linalg.norm(rig.position[:2]) < 0.1


def test_guided_orders(qgc):
    rig = qgc.rig
    lat, lon = round(ORIGIN[0] * 1e7), round(ORIGIN[1] * 1e7)
    qgc.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    rig.run(0.2)
    # Take-off to an altitude above the sea.
    qgc.command(m.MAV_CMD_NAV_TAKEOFF, -1, 0, 0, NAN, NAN, NAN, ORIGIN[2] + 1.0)
    assert rig.run(15.0, lambda: rig.status.state == "hover"), qgc.words
    assert -rig.position[2] == pytest.approx(1.0, abs=0.1)
    # A place on the map, then "pause" on the way: a reposition that gives nothing.
    qgc.command_int(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, frame=0, x=lat + 180, y=lon, z=ORIGIN[2] + 1.0)
    assert rig.run(10.0, lambda: rig.flight.status.truth.velocity[0] > 0.2), qgc.words
    qgc.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, NAN, NAN, NAN)
    rig.run(4.0)
    assert np.linalg.norm(rig.flight.status.truth.velocity) < 0.05
    held = rig.position.copy()
    assert held[0] < 1.5
    # Another height, another heading, another speed.
    qgc.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, NAN, NAN, NAN, ORIGIN[2] + 1.4)
    assert rig.run(10.0, lambda: abs(-rig.position[2] - 1.4) < 0.06), qgc.words
    assert np.linalg.norm(rig.position[:2] - held[:2]) < 0.1
    qgc.command(m.MAV_CMD_DO_REPOSITION, -1, 1, 0, math.pi / 2, NAN, NAN, NAN)
    assert rig.run(10.0, lambda: abs(rig.flight.status.truth.attitude[2] - math.pi / 2) < 0.05), qgc.words
    qgc.command(m.MAV_CMD_DO_CHANGE_SPEED, 1, 0.4, -1, 0, NAN, NAN, NAN)
    assert answer(qgc, m.MAV_CMD_DO_CHANGE_SPEED) == OK
    for mode, state in (((4, 5), "return"), ((4, 6), "landing")):
        qgc.mode(*mode)
        rig.run(1.1)  # a heartbeat comes once a second
        assert qgc.last("HEARTBEAT").custom_mode == mode[0] << 16 | mode[1] << 24, state
    assert rig.run(30.0, lambda: not rig.status.armed)


def test_its_emergency_stop(qgc):
    qgc.rig.airborne(qgc, 0.6)
    qgc.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196)
    qgc.rig.run(0.1)
    assert not qgc.rig.status.armed
    assert qgc.rig.flight.status.actuators.motor_input.max() == 0.0
