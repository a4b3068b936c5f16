"""MAVLink of a board in C: frames equal pymavlink's; stations read, set, command and load missions."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path

os.environ.setdefault("MAVLINK20", "1")

import numpy as np
import pytest
from board_station import Station, mission_item
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from mufly.control import design_flight_controller
from mufly.firmware import describe_missing_tools, export_firmware
from mufly.firmware.emulated.board_flight import BoardEstimator, make_board_software
from mufly.firmware.emulated.board_link import run_linked_board
from mufly.firmware.emulated.image_build import build_host_board
from mufly.flight import Flight
from mufly.flight.tunable_parameters import TUNABLE_PARAMETERS
from mufly.link.codec import pack_custom_mode, px4_mode_from_state
from mufly.link.parameter_protocol import LINK_PARAMETERS
from mufly.link.telemetry_streams import MESSAGE_STREAMS
from mufly.mission import LogTemplate, State, load_mission
from mufly.vehicle import load_vehicle

COMPILERS = [c for c in ("cc", "gcc", "clang") if shutil.which(c)]
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler: install gcc or clang")
needs_qemu = pytest.mark.skipif(bool(describe_missing_tools()), reason=describe_missing_tools())
_NAMES = (
    "HEARTBEAT SYS_STATUS PARAM_REQUEST_READ PARAM_REQUEST_LIST PARAM_VALUE PARAM_SET ATTITUDE LOCAL_POSITION_NED "
    "MISSION_CURRENT MISSION_REQUEST_LIST MISSION_COUNT MISSION_CLEAR_ALL MISSION_ACK MISSION_REQUEST_INT "
    "MANUAL_CONTROL MISSION_ITEM_INT COMMAND_INT COMMAND_LONG COMMAND_ACK SET_POSITION_TARGET_LOCAL_NED BATTERY_STATUS "
    "AUTOPILOT_VERSION ESTIMATOR_STATUS EXTENDED_SYS_STATE STATUSTEXT"
)
MESSAGES = _NAMES.split()
SOURCES = Path(__file__).parents[2] / "src" / "mufly" / "firmware" / "sources"


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def library(vehicle):
    return build_host_board(vehicle, design_flight_controller(vehicle), load_mission("demonstration"), single=False)


def _random_frame(name, rng, codec):
    """Return id and bytes of a message with a random payload, some of them ending in zeros, which are not sent."""
    kind = getattr(mavlink, f"MAVLink_{name.lower()}_message")
    payload = bytearray(rng.bytes(kind.unpacker.size))
    payload[len(payload) - int(rng.integers(0, len(payload))) :] = b""
    payload += bytes(kind.unpacker.size - len(payload))
    message = mavlink.MAVLink_message(kind.id, name)
    return kind.id, bytes(message._pack(codec, kind.crc_extra, bytes(payload)))


def test_frames_are_those_of_pymavlink(library) -> None:
    ffi, lib = library
    rng = np.random.default_rng(1)
    parser, out = ffi.new("mavlink_parser_t *"), ffi.new("mavlink_message_t *")
    codec, frame = mavlink.MAVLink(None, srcSystem=7, srcComponent=9), ffi.new("uint8_t[280]")
    header = (SOURCES / "onboard/link/mavlink.h").read_text(encoding="utf-8")
    ids = {name: int(number) for name, number in re.findall(r"^#define MSG_(\w+) (\d+)U", header, re.MULTILINE)}
    assert ids == {name: getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for name in MESSAGES}
    for name in MESSAGES * 3:
        number, sent = _random_frame(name, rng, codec)
        noise = bytes(rng.integers(0, 250, 5, dtype=np.uint8))
        taken = [lib.mavlink_parse(parser, byte, out) for byte in noise.replace(b"\xfd", b"") + sent]
        assert taken.index(True) == len(taken) - 1, name
        assert (out.message, out.system, out.component, out.length) == (number, 7, 9, sent[1])
        assert bytes(out.payload)[: sent[1]] == bytes(sent[10 : 10 + sent[1]])
        assert not any(out.payload[k] for k in range(sent[1], len(out.payload)))
        count = lib.mavlink_encode(out, sent[4], frame)
        assert bytes(ffi.buffer(frame, count)) == bytes(sent)
        # One wrong bit is noticed.
        spoilt = bytearray(sent)
        spoilt[10 + int(rng.integers(sent[1]))] ^= 1 << int(rng.integers(8))
        assert not any(lib.mavlink_parse(parser, byte, out) for byte in spoilt)


def test_log_templates_become_text(library) -> None:
    ffi, lib = library
    out = ffi.new("char[100]")
    for code, message in enumerate(LogTemplate):
        numbers = (1.26, -0.6, 12.0, 3.0)
        lib.write_message_text(ffi.new("message_t *", lib.make_message_4(code, *numbers)), out)
        text = ffi.string(out).decode()
        if "{}" not in message.value:
            assert text == message(*numbers)[:99], message


def test_telemetry_has_the_rates_of_the_simulated_vehicle(library) -> None:
    s = Station(library)
    for _ in range(2000):
        s.step()
    rates = {m.message_name: m.default_rate_Hz for m in MESSAGE_STREAMS}
    kinds = [m.get_type() for m in s.heard]
    for name in (
        "HEARTBEAT", "SYS_STATUS", "BATTERY_STATUS", "EXTENDED_SYS_STATE", "MISSION_CURRENT", "ATTITUDE",
        "LOCAL_POSITION_NED", "ESTIMATOR_STATUS",
    ):  # fmt: skip
        assert kinds.count(name) == pytest.approx(10.0 * rates[name], abs=2), name
    assert s.board.record.link.dropped == 0
    beat = s.wait_for("HEARTBEAT")
    assert (beat.type, beat.autopilot, beat.system_status) == (mavlink.MAV_TYPE_COAXIAL, 12, mavlink.MAV_STATE_STANDBY)
    assert s.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148) == 0
    assert bytes(s.wait_for("AUTOPILOT_VERSION").flight_custom_version[:5]) == b"mufly"


def _requested(s, name):
    """Return a stream's message of the vehicle as it is, without another period."""
    assert s.lib.request_stream(s.ffi.addressof(s.board.record, "link"), getattr(mavlink, f"MAVLINK_MSG_ID_{name}"))
    told = [m for _ in range(10) for m in s.decode.parse_buffer(s.board.exchange_bytes(b"")) or []]
    return [m for m in told if m.get_type() == name][-1]


def test_heartbeats_show_the_mode_of_the_simulated_vehicle(library) -> None:
    s = Station(library)
    s.step()
    x, supervisor = s.board.record.software.mission, s.board.record.supervisor
    for k, state in enumerate(State):
        x.state = k
        for x.user_in_control, x.returning_home in ((False, False), (True, False), (True, True)):
            mode = px4_mode_from_state(state, x.user_in_control, x.returning_home)
            assert _requested(s, "HEARTBEAT").custom_mode == pack_custom_mode(mode), (state, mode)
    always = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    auto = always | mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
    x.state = s.lib.STATE_HOVER
    s.board.record.software.is_lifted, s.board.record.software.motors = True, s.lib.MOTORS_FLY
    x.home_position[2] = s.board.record.belief.motion.position[2] + 1.0
    for armed, volts, status in (
        (False, 8.0, mavlink.MAV_STATE_STANDBY), (True, 8.0, mavlink.MAV_STATE_ACTIVE),
        (True, 0.1, mavlink.MAV_STATE_CRITICAL),
    ):  # fmt: skip
        supervisor.armed, x.battery_V = armed, volts
        beat = _requested(s, "HEARTBEAT")
        assert beat.base_mode == auto | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
        assert (beat.system_status, beat.mavlink_version) == (status, 3)
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_LOW if volts < 1.0 else mavlink.MAV_BATTERY_CHARGE_STATE_OK
        assert _requested(s, "BATTERY_STATUS").charge_state == charge
    x.state = s.lib.STATE_RC
    by_hand = always | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert _requested(s, "HEARTBEAT").base_mode == by_hand


def test_telemetry_shows_the_vehicle_as_it_is(library) -> None:
    s = Station(library)
    s.step()
    record, lib = s.board.record, s.lib
    m, checks = record.belief, record.belief.checks
    names = (
        "SENSOR_3D_GYRO", "SENSOR_3D_ACCEL", "SENSOR_ANGULAR_RATE_CONTROL", "SENSOR_ATTITUDE_STABILIZATION",
        "SENSOR_YAW_POSITION", "SENSOR_Z_ALTITUDE_CONTROL", "SENSOR_XY_POSITION_CONTROL", "SENSOR_MOTOR_OUTPUTS",
        "SENSOR_BATTERY", "AHRS", "PREARM_CHECK",
    )  # fmt: skip
    here = sum(getattr(mavlink, f"MAV_SYS_STATUS_{name}") for name in names)
    ahrs, ready = mavlink.MAV_SYS_STATUS_AHRS, mavlink.MAV_SYS_STATUS_PREARM_CHECK
    m.motion.voltage = 7.6543
    for valid, armed, may_arm in itertools.product((True, False), repeat=3):
        m.valid, record.supervisor.armed = valid, armed
        record.supervisor.interruption = lib.INTERRUPTION_NONE if may_arm else lib.INTERRUPTION_RESET
        told = _requested(s, "SYS_STATUS")
        assert told.onboard_control_sensors_present == told.onboard_control_sensors_enabled == here
        lost = (0 if valid else ahrs) + (0 if armed or (valid and may_arm) else ready)
        assert here - told.onboard_control_sensors_health == lost
        assert (told.voltage_battery, told.current_battery, told.battery_remaining) == (7654, -1, -1)
    battery = _requested(s, "BATTERY_STATUS")
    assert battery.voltages == [7654, *[65535] * 9]
    assert (battery.current_battery, battery.temperature, battery.battery_remaining) == (-1, 32767, -1)
    for state, motors, landed in (
        (lib.STATE_HOVER, lib.MOTORS_OFF, 1), (lib.STATE_HOVER, lib.MOTORS_RAMP_DOWN, 1),
        (lib.STATE_HOVER, lib.MOTORS_FLY, 2), (lib.STATE_TAKE_OFF, lib.MOTORS_SPIN_UP, 3),
        (lib.STATE_LANDING, lib.MOTORS_BLIND, 4),
    ):  # fmt: skip
        record.software.mission.state, record.software.motors = state, motors
        assert _requested(s, "EXTENDED_SYS_STATE").landed_state == landed
    numbers = np.arange(1.0, 13.0) / 8.0  # exact in single precision
    m.motion.position, m.motion.velocity, m.motion.attitude, m.motion.rates = numbers.reshape(4, 3).tolist()
    record.software.mission.waypoint_index = 1
    place, turn = _requested(s, "LOCAL_POSITION_NED"), _requested(s, "ATTITUDE")
    assert [place.x, place.y, place.z, place.vx, place.vy, place.vz] == numbers[:6].tolist()
    assert [turn.roll, turn.pitch, turn.yaw, turn.rollspeed, turn.pitchspeed, turn.yawspeed] == numbers[6:].tolist()
    m.motion.attitude[2] = 4.0
    assert _requested(s, "ATTITUDE").yaw == pytest.approx(4.0 - 2.0 * np.pi)
    assert place.time_boot_ms == turn.time_boot_ms == int(1000.0 * m.time_s)
    item = _requested(s, "MISSION_CURRENT")
    assert (item.seq, item.total) == (1, record.plan.count)
    # Each flag of the estimator depends on its accuracy alone.
    level = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
    level |= mavlink.ESTIMATOR_PRED_POS_HORIZ_REL | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
    every = level | mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_POS_VERT_ABS | mavlink.ESTIMATOR_POS_VERT_AGL
    for change, lost in (
        ({}, 0), ({"tilt": 10.1}, mavlink.ESTIMATOR_ATTITUDE), ({"tilt": 9.9}, 0), ({"level": 0.51}, level),
        ({"level": 0.49}, 0), ({"height": 0.51}, mavlink.ESTIMATOR_POS_VERT_ABS), ({"height": 0.49}, 0),
        ({"sonar": lib.SENSOR_REJECTED}, mavlink.ESTIMATOR_POS_VERT_AGL), ({"valid": False}, every),
    ):  # fmt: skip
        is_so = {"tilt": 1.0, "level": 0.1, "height": 0.2, "sonar": lib.SENSOR_FUSED, "valid": True, **change}
        for axis in (0, 1):
            m.attitude_variance[axis], m.attitude_variance[1 - axis] = np.radians(is_so["tilt"]) ** 2, 0.0
            m.position_variance = [0.5 * is_so["level"] ** 2] * 2 + [is_so["height"] ** 2]
            m.valid, checks[lib.SENSOR_SONAR].status = is_so["valid"], is_so["sonar"]
            told = _requested(s, "ESTIMATOR_STATUS")
            assert every - told.flags == lost, change
            assert told.pos_horiz_accuracy == pytest.approx(is_so["level"], rel=1e-6)
            assert told.pos_vert_accuracy == pytest.approx(is_so["height"], rel=1e-6)


def test_parameters_are_read_and_set_within_the_bounds_of_python(library) -> None:
    s = Station(library)
    s.send(mavlink.MAVLink_param_request_list_message(1, 1))
    names = [s.wait_for("PARAM_VALUE").param_id for _ in range(32)]
    assert names == sorted(names)
    assert len(set(names)) == 32
    names = [n for n in names if not n.startswith(("CAL_", "RC_", "COM_RC_"))]
    known = {**TUNABLE_PARAMETERS, **LINK_PARAMETERS}

    def set_parameter(name, value) -> float:
        s.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, 9))
        told = s.wait_for("PARAM_VALUE")
        assert told.param_id == name
        return float(told.param_value)

    for name in names:
        least, most = known[name].minimum, min(known[name].maximum, 60.0 if name == "BAT_LOW_V" else np.inf)
        for bound, beyond in ((least, least - 0.01 * most), (most, 1.01 * most)):
            assert set_parameter(name, bound) == pytest.approx(bound, rel=1e-6)
            assert set_parameter(name, beyond) == pytest.approx(bound, rel=1e-6)
        assert set_parameter(name, float("nan")) == pytest.approx(most, rel=1e-6)
    s.send(mavlink.MAVLink_param_request_read_message(1, 1, b"COM_DL_LOSS_T", -1))
    assert s.wait_for("PARAM_VALUE").param_value == 300.0
    assert s.board.record.supervisor.settings.link_loss_s == 300.0
    s.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1))
    s.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    s.step()
    assert not any(m.get_type() == "PARAM_VALUE" for m in s.heard)


def test_commands_are_answered(library) -> None:
    s = Station(library)
    assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mavlink.MAV_RESULT_TEMPORARILY_REJECTED
    assert "not measured" in s.wait_for("STATUSTEXT").text + s.wait_for("STATUSTEXT").text
    assert s.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 99.0) == mavlink.MAV_RESULT_DENIED
    assert s.command(mavlink.MAV_CMD_DO_SET_SERVO, 1, 1500) == mavlink.MAV_RESULT_UNSUPPORTED
    # Another station is refused while the commander is heard, and may stop the motors all the same.
    assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, system=254) == mavlink.MAV_RESULT_DENIED
    assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0, system=254) == mavlink.MAV_RESULT_ACCEPTED
    for _ in range(1100):
        s.step()
    assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, system=254) == mavlink.MAV_RESULT_ACCEPTED
    # Commands for other vehicles are none of its business.
    s.heard.clear()
    s.send(mavlink.MAVLink_command_long_message(2, 1, 400, 0, 1.0, *[0.0] * 6))
    s.step()
    assert not any(m.get_type() == "COMMAND_ACK" for m in s.heard)


def test_a_repeated_command_is_answered_and_not_executed_again(library) -> None:
    s = Station(library)

    def set_height(value) -> None:
        s.send(mavlink.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", value, 9))
        s.wait_for("PARAM_VALUE")

    height, reset = s.board.record.plan.take_off_height, (mavlink.MAV_CMD_PREFLIGHT_STORAGE, 2.0)
    for pause_s, confirmation, executed in ((0.0, 0, False), (1.0, 0, True), (1.0, 1, False), (10.0, 1, True)):
        assert s.command(*reset) == mavlink.MAV_RESULT_ACCEPTED
        for _ in range(round(pause_s * 200)):
            s.step()
        set_height(0.95)
        assert s.command(*reset, confirmation=confirmation) == mavlink.MAV_RESULT_ACCEPTED
        expected = height if executed else 0.95
        assert s.board.record.plan.take_off_height == pytest.approx(expected), (pause_s, confirmation)
        for _ in range(2200):  # longer than the window of a confirmation
            s.step()
    # Another parameter, another command, another sender: none is a repetition.
    assert s.command(*reset) == mavlink.MAV_RESULT_ACCEPTED
    set_height(0.95)
    assert s.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 4.0) == mavlink.MAV_RESULT_ACCEPTED
    assert s.board.record.plan.take_off_height == pytest.approx(height)


def test_missions_go_both_ways(library) -> None:
    s = Station(library)
    items = [
        mission_item(0, 22, z=-0.7),
        mission_item(1, 16, 0.5, -0.25, -0.8, p1=2.0),
        mission_item(2, 16, -1.0, 1.5, -1.2, p4=90.0),
        mission_item(3, 20),
    ]
    s.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), 0))
    for k, item in enumerate(items):
        assert s.wait_for("MISSION_REQUEST_INT").seq == k
        if k == 1:  # a lost item is asked for again
            assert s.wait_for("MISSION_REQUEST_INT", 150).seq == k
        s.send(item)
    assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_ACCEPTED
    plan = s.board.record.plan
    assert (plan.count, plan.at_end, round(plan.take_off_height, 5)) == (2, 2, 0.7)
    s.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert s.wait_for("MISSION_COUNT").count == 4
    for k, item in enumerate(items):
        s.send(mavlink.MAVLink_mission_request_int_message(1, 1, k))
        told = s.wait_for("MISSION_ITEM_INT")
        assert (told.seq, told.command, told.frame, told.current) == (k, item.command, 1, int(k == 0))
        if item.command == 16:
            assert (told.x, told.y, told.param1) == (item.x, item.y, item.param1)
            assert told.z == pytest.approx(item.z)
            assert told.param4 == pytest.approx(item.param4, nan_ok=True)
    before = bytes(s.ffi.buffer(s.ffi.addressof(s.board.record, "plan")))
    for wrong in (mission_item(0, 16, z=0.5), mission_item(0, 16, frame=3), mission_item(0, 17), mission_item(0, 20)):
        s.heard.clear()
        s.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 0))
        s.wait_for("MISSION_REQUEST_INT")
        s.send(wrong)
        assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_UNSUPPORTED
    for count, answer in ((0, 4), (35, 4)):
        s.send(mavlink.MAVLink_mission_count_message(1, 1, count, 0))
        assert s.wait_for("MISSION_ACK").type == answer
    # An upload that breaks off leaves the mission as it was.
    s.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    for _ in range(1200):
        s.step()
    assert not s.board.record.link.loads
    assert bytes(s.ffi.buffer(s.ffi.addressof(s.board.record, "plan"))) == before


def test_numbers_that_cannot_be_written_become_question_marks(library) -> None:
    ffi, lib = library
    out, message = ffi.new("char[100]"), ffi.new("message_t *")

    def write(code, number) -> str:
        message.code = code
        message.number = [number] * 4
        count = lib.write_message_text(message, out)
        text = ffi.string(out).decode()
        assert len(text) == count
        return text

    for code in (-1, lib.SAY_COUNT, 2**31 - 1):
        assert write(code, 1.0) == ""
    for code, template in enumerate(LogTemplate):
        for number in (float("nan"), float("inf"), 1e6):
            assert write(code, number).count("?") == template.value.count("{"), template
        assert "-" not in write(code, -1e-9).replace(write(code, 0.0), ""), template  # no minus before a zero
    assert len(write(lib.SAY_USER_WAYPOINT_TOO_FAR, -999999.126)) == 99  # the rest has no room


def _signed(sent: bytes, flags: int) -> bytes:
    """Return a frame with other incompatibility flags, its checksum, and a signature if the flags ask for one."""
    frame = bytearray(sent[:-2])
    frame[2] = flags
    crc = mavutil.x25crc(bytes(frame[1:]))
    crc.accumulate_str(bytes([mavlink.mavlink_map[int.from_bytes(frame[7:10], "little")].crc_extra]))
    return bytes(frame) + crc.crc.to_bytes(2, "little") + bytes(13 if flags & 1 else 0)


def test_signed_frames_are_read_and_unknown_ones_are_not(library) -> None:
    ffi, lib = library
    parser, out = ffi.new("mavlink_parser_t *"), ffi.new("mavlink_message_t *")
    codec = mavlink.MAVLink(None, srcSystem=7, srcComponent=9)
    sent = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(codec))
    for flags, known in ((0, True), (1, True), (2, False), (3, False)):
        data = _signed(sent, flags)
        taken = [lib.mavlink_parse(parser, byte, out) for byte in data]
        assert taken == [False] * (len(data) - 1) + [known], flags
    unknown = bytes(mavlink.MAVLink_raw_imu_message(1, *[2] * 9).pack(codec))
    assert not any(lib.mavlink_parse(parser, byte, out) for byte in unknown)
    assert parser.bad_count == 0  # none was damaged


def test_messages_for_other_vehicles_are_ignored_and_broadcasts_are_handled(library) -> None:
    m = mavlink
    kinds = {
        "COMMAND_ACK": lambda s, c: m.MAVLink_command_long_message(s, c, 520, 0, *[0.0] * 7),
        "AUTOPILOT_VERSION": lambda s, c: m.MAVLink_command_int_message(s, c, 0, 512, 0, 0, 148.0, *[0] * 6),
        "PARAM_VALUE": lambda s, c: m.MAVLink_param_request_read_message(s, c, b"", 3),
        "PARAM_VALUE ": lambda s, c: m.MAVLink_param_request_list_message(s, c),
        "PARAM_VALUE  ": lambda s, c: m.MAVLink_param_set_message(s, c, b"STK_TILT", 8.0, 9),
        "MISSION_COUNT": lambda s, c: m.MAVLink_mission_request_list_message(s, c),
        "MISSION_ACK": lambda s, c: m.MAVLink_mission_count_message(s, c, 0, 0),
        "MISSION_ITEM_INT": lambda s, c: m.MAVLink_mission_request_int_message(s, c, 0),
        "MISSION_ACK ": lambda s, c: m.MAVLink_mission_item_int_message(s, c, 0, 1, 16, 0, 1, *[0.0] * 4, 0, 0, -1.0),
    }
    s = Station(library)
    for name, make in kinds.items():
        for target, handled in (((0, 0), True), ((1, 1), True), ((1, 0), True), ((2, 1), False), ((1, 2), False)):
            for _ in range(40):
                s.step()
            s.heard.clear()
            s.send(make(*target))
            for _ in range(3):
                s.step()
            assert any(k.get_type() == name.strip() for k in s.heard) == handled, (name, target)
    supervisor, link = s.board.record.supervisor, s.board.record.link
    link.by_hand = True
    for target, handled in ((2, False), (0, True), (1, True)):
        supervisor.has_sticks = False
        s.send(m.MAVLink_manual_control_message(target, 0, 0, 500, 0, 0))
        assert bool(supervisor.has_sticks) == handled, target
    for target, handled in (((2, 1), False), ((1, 2), False), ((0, 0), True)):
        supervisor.has_set_point = False
        s.send(m.MAVLink_set_position_target_local_ned_message(0, *target, 1, 0, *[0.0] * 11))
        assert bool(supervisor.has_set_point) == handled, target
    # Of another station while the commander is heard, neither counts.
    s.codec.srcSystem = 254
    supervisor.has_sticks = supervisor.has_set_point = False
    s.send(m.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0))
    s.send(m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0, *[0.0] * 11))
    assert not supervisor.has_sticks
    assert not supervisor.has_set_point
    s.send(m.MAVLink_mission_count_message(1, 1, 2, 0))
    assert s.wait_for("MISSION_ACK").type == m.MAV_MISSION_ERROR
    s.send(m.MAVLink_param_set_message(1, 1, b"STK_TILT", 3.0, 9))
    assert s.wait_for("PARAM_VALUE").param_value == pytest.approx(8.0)
    # A component of the commander's system is another station, and it does not keep the link alive.
    s.codec.srcSystem, s.codec.srcComponent = 255, 191
    heard_s = supervisor.commander_heard_s
    assert s.command(mavlink.MAV_CMD_NAV_LAND) == mavlink.MAV_RESULT_DENIED
    s.send(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    assert supervisor.commander_heard_s == heard_s


def test_sticks_and_set_points_have_the_units_of_their_messages(library) -> None:
    s = Station(library)
    s.board.record.link.by_hand = True
    supervisor = s.board.record.supervisor
    most = supervisor.settings

    def deadband(v) -> float:
        return float(np.sign(v) * max(0.0, abs(v) - 0.03) / 0.97)

    unknown = 32767
    for x, y, z, r in (
        (500, -1000, 500, 1000),
        (-250, 0, 0, -20),
        (unknown, unknown, unknown, unknown),
        (0, 0, 1000, 0),
    ):
        s.send(mavlink.MAVLink_manual_control_message(1, x, y, z, r, 0))
        pitch, roll, yaw = (0.0 if v == unknown else deadband(v / 1000) for v in (x, y, r))
        climb = 0.0 if z == unknown else deadband(2 * z / 1000 - 1)
        sticks = supervisor.sticks
        assert (sticks.pilot_roll, sticks.pilot_pitch) == pytest.approx(
            (roll * most.stick_tilt, -pitch * most.stick_tilt)
        )
        assert (sticks.pilot_yaw_rate, sticks.pilot_climb_rate) == pytest.approx(
            (yaw * most.stick_yaw_rate, climb * most.stick_climb)
        )
    values = (0.5, -0.25, -1.0, 0.1, 0.2, -0.3, 0.0, 0.0, 0.0, 1.5, 0.125)

    def send_set_point(mask, frame=1) -> list[float]:
        s.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values))
        p = supervisor.set_point
        return [*p.position, *p.velocity, p.heading, p.yaw_rate]

    nan = float("nan")
    given = [*values[:6], *values[9:]]
    for mask, known in (
        (0, range(8)),
        (0x007, range(3, 8)),
        (0x038, (0, 1, 2, 6, 7)),
        (0x400, (0, 1, 2, 3, 4, 5, 7)),
        (0x804, (0, 1, 3, 4, 5, 6)),
    ):
        expected = [v if k in known else nan for k, v in enumerate(given)]
        assert send_set_point(mask) == pytest.approx(expected, nan_ok=True), mask
    before = send_set_point(0)
    assert send_set_point(0x7, frame=8) == before  # in body axes: not followed


def test_each_command_has_its_answer_on_the_floor(library) -> None:
    s, nan = Station(library), float("nan")
    accepted, later, denied, unsupported = 0, 1, 2, 3
    cases = [
        (185, (0.0,), denied), (185, (1.0,), accepted), (400, (0.0, 30000.0), accepted), (400, (0.0,), accepted),
        (24, (0, 0, 0, 0, 0, 0, -0.5), later), (24, (0, 0, 0, 0, 0, 0, 0.5), denied), (22, (0,) * 7, later),
        (22, (0, 0, 0, 0, 0, 0, nan), later), (22, (0, 0, 0, 0, 0, 0, 0.1), denied), (21, (), later), (23, (), later),
        (189, (), later), (20, (), later), (300, (), later), (193, (0.0,), later), (193, (1.0,), later),
        (192, (0, 0, 0, 0, 0, 0, -1.0), denied), (31, (), unsupported), (512, (148.0,), accepted),
        (512, (30.0,), accepted), (512, (77.0,), unsupported), (512, (-1.0,), unsupported),
        (512, (1e9,), unsupported), (520, (), accepted),
        *((176, (1.0, mode, 0.0), accepted) for mode in (1.0, 2.0, 3.0, 7.0)),
        *((176, (1.0, mode, 3.0), denied) for mode in (0.0, 5.0, -1.0, 16.0, nan)),
        *((176, (1.0, 4.0, sub), later) for sub in (2.0, 3.0, 4.0, 5.0, 6.0)),
        *((176, (1.0, 4.0, sub), denied) for sub in (0.0, 1.0, 7.0, -1.0, 16.0, nan)), (176, (1.0, 6.0), later),
        *((245, (values, mission), accepted) for values in (-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 9.0, nan)
          for mission in (0.0, 1.0, 2.0, 7.0)),
    ]  # fmt: skip
    for number, params, expected in cases:
        assert s.command(number, *params) == expected, (number, params)
        for _ in range(200):  # no repetition of the one before
            s.step()
    for frame, x, expected in ((3, 4000, denied), (1, 4000, later), (1, 2 * 10**8, denied)):
        s.send(mavlink.MAVLink_command_int_message(1, 1, frame, 192, 0, 0, -1.0, 1.0, 0.0, 0.5, x, 0, -1.0))
        assert s.wait_for("COMMAND_ACK").result == expected, (frame, x)
    assert not s.board.record.supervisor.armed


def test_a_command_with_other_numbers_is_no_repetition(library) -> None:
    s, nan = Station(library), float("nan")
    link = s.board.record.link
    for k, value in enumerate((1.0, 2.0, 1.0, nan, nan, 1.0)):
        s.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1.0, value)
        remembered = sorted(c.params[1] for c in link.last if c.used)
        assert len([v for v in remembered if v == v]) == min(k + 1, 2)
        assert len(remembered) == (1, 2, 2, 3, 3, 3)[k]
    for component in (191, 192):
        s.codec.srcComponent = component
        s.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1.0, 2.0)
    assert [c.component for c in link.last if c.used] == [190, 190, 190]  # refused ones are not remembered
    # A stop of the motors is executed each time.
    s.codec.srcComponent = 190
    for _ in range(2):
        s.board.record.supervisor.armed = True
        assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0) == mavlink.MAV_RESULT_ACCEPTED
        assert not s.board.record.supervisor.armed


def _upload(s, items, count=None) -> int:
    """Upload items; return the answer."""
    s.heard.clear()
    s.send(mavlink.MAVLink_mission_count_message(1, 1, len(items) if count is None else count, 0))
    for item in items:
        if not any(m.get_type() == "MISSION_ACK" for m in s.heard):
            s.wait_for("MISSION_REQUEST_INT")
            s.send(item)
    return int(s.wait_for("MISSION_ACK").type)


def test_items_of_a_mission_are_judged_one_by_one(library) -> None:
    s = Station(library)
    good, unsupported, failed = mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_UNSUPPORTED, mavlink.MAV_MISSION_ERROR
    start, end = mission_item(0, 22, z=-0.7), mission_item(2, 20)
    before = bytes(s.ffi.buffer(s.ffi.addressof(s.board.record, "plan")))
    nan = float("nan")
    for item in (
        mission_item(1, 16, z=-0.05), mission_item(1, 16, z=-60.0), mission_item(1, 16, z=nan), mission_item(1, 22),
        mission_item(1, 16, x=1.1e4), mission_item(1, 24), mission_item(1, 21), mission_item(1, 23),
        mission_item(1, 20),
    ):  # fmt: skip
        assert _upload(s, [start, item, end]) == unsupported, (item.command, item.x, item.z)
    for first in (mission_item(0, 24, z=0.5), mission_item(0, 22, frame=3)):
        assert _upload(s, [first, mission_item(1, 16), end]) == unsupported
    assert _upload(s, [start, mission_item(1, 20)]) == failed  # without a waypoint
    assert _upload(s, [mission_item(k, 16) for k in range(34)]) == unsupported  # more waypoints than a board holds
    assert bytes(s.ffi.buffer(s.ffi.addressof(s.board.record, "plan"))) == before
    plan = s.board.record.plan
    for wait_s, heading, waits, has_heading in (
        (-1.0, nan, 0.0, False), (2.0, 400.0, 2.0, False), (3600.0, -90.0, 0.0, True), (nan, float("inf"), 0.0, False),
    ):  # fmt: skip
        items = [mission_item(0, 24, z=-0.7), mission_item(1, 16, p1=wait_s, p4=heading), mission_item(2, 23)]
        assert _upload(s, items) == good
        w = plan.waypoint[0]
        assert (w.wait_s, bool(w.has_heading), plan.at_end) == (waits, has_heading, s.lib.AT_END_LAND)
        assert w.heading == pytest.approx(np.radians(-90.0) if has_heading else 0.0)
    s.send(mavlink.MAVLink_mission_request_int_message(1, 1, 2))
    assert s.wait_for("MISSION_ITEM_INT").command == 21
    assert _upload(s, [mission_item(0, 16), mission_item(1, 21)]) == good  # neither is needed
    s.send(mavlink.MAVLink_mission_request_int_message(1, 1, 9))
    assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_INVALID_SEQUENCE
    for kind, count in ((0, 3), (1, 0), (2, 0)):  # the mission; neither fence nor rally points
        s.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))
        told = s.wait_for("MISSION_COUNT")
        assert (told.mission_type, told.count) == (kind, count)


def test_an_upload_takes_items_in_their_order_from_its_sender_while_the_motors_are_off(library) -> None:
    s = Station(library)
    s.send(mission_item(0, 16))
    assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_UNSUPPORTED  # no upload has begun
    s.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 0))
    assert s.wait_for("MISSION_REQUEST_INT").seq == 0
    s.send(mission_item(1, 16))
    assert s.wait_for("MISSION_REQUEST_INT").seq == 0  # asked for again
    s.send(mission_item(0, 16))
    assert s.wait_for("MISSION_REQUEST_INT").seq == 1
    # When another station may command, the upload of the first is not continued with its items.
    link, supervisor = s.board.record.link, s.board.record.supervisor
    supervisor.commander_heard_s -= 5.0
    s.codec.srcSystem = 254
    s.heard.clear()
    s.send(mission_item(1, 16))
    assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_UNSUPPORTED
    assert link.load_next == 1
    # Armed meanwhile, it is not taken over.
    s.send(mavlink.MAVLink_mission_count_message(1, 1, 1, 0))
    s.wait_for("MISSION_REQUEST_INT")
    s.board.record.supervisor.armed = True
    s.send(mission_item(0, 16))
    assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_ERROR
    s.board.record.supervisor.armed = False
    # With sticks the state is no longer that of rest, though nothing is armed and the motors are off.
    link.by_hand = True
    for _ in range(8):
        s.send(mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0))
    assert s.board.record.software.mission.state == s.lib.STATE_RC
    s.send(mavlink.MAVLink_mission_count_message(1, 1, 1, 0))
    assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_ERROR


def test_a_line_that_takes_no_bytes_loses_messages_and_counts_them(library) -> None:
    """Lists and texts wait for room, streams are dropped; afterwards all goes on."""
    s = Station(library)
    link = s.board.record.link
    for _ in range(600):  # texts of the start
        s.step()
    entries = s.board.record.software.mission
    link.lists = True
    for k in range(400):
        entries.logged_event_count += 3 * (k == 100)
        link.input_count = 0
        s.period.time_s = 3.0 + 0.005 * k
        s.board.compute_estimate(s.period)
        s.board.compute_control(s.request)
        s.lib.board_link(s.board.record)
        if k == 99:
            assert link.lists  # no room for all of them
            assert link.output_count > 512
    assert link.dropped > 20
    assert link.output_count > 1024 - 64
    assert link.told < entries.logged_event_count
    s.k = 1000
    s.heard.clear()
    for _ in range(300):
        s.step()
    assert not link.lists
    assert link.told == entries.logged_event_count
    assert s.decode.total_receive_errors == 0  # frames of the ring are whole


def test_long_texts_come_in_two_parts_and_old_entries_of_a_full_log_are_passed_over(library) -> None:
    s = Station(library)
    for _ in range(300):
        s.step()
    mission = s.board.record.software.mission
    for k in range(40):  # more than the log keeps
        entry = mission.log[(mission.logged_event_count + k) % 16]
        entry.message.code = s.lib.SAY_USER_WAYPOINT_TOO_FAR
        entry.message.number = [k, 0.0, 0.0, 1.0]
        entry.level = k % 5 - 1
    mission.logged_event_count += 40
    s.heard.clear()
    for _ in range(300):
        s.step()
    parts = [m for m in s.heard if m.get_type() == "STATUSTEXT" and m.id]
    assert [m.chunk_seq for m in parts] == [0, 1] * 16
    texts = [a.text + b.text for a, b in zip(parts[::2], parts[1::2], strict=True)]
    assert [int(t[17:].split(",")[0]) for t in texts] == list(range(24, 40))
    assert texts[0].endswith("D has to be at least 1 m")
    severities = {-1: 6, 0: 6, 1: 4, 2: 3, 3: 6}  # an unknown level is information
    assert [m.severity for m in parts[::2]] == [severities[k % 5 - 1] for k in range(24, 40)]


def test_telemetry_states_modes_and_uncertainty(library) -> None:
    """One message of each kind for states that flights seldom reach."""
    s = Station(library)
    ffi, lib, record = s.ffi, s.lib, s.board.record
    link, software, belief = ffi.new("link_t *"), ffi.new("software_t *"), ffi.new("estimate_t *")
    lib.link_start(link)
    setup = ffi.addressof(lib, "mufly_setup")
    vehicle = ffi.new("link_vehicle_t *", {
        "supervisor": ffi.addressof(record, "supervisor"), "software": software, "setup": setup, "belief": belief,
        "plan": ffi.addressof(record, "plan"), "estimator": ffi.addressof(record, "estimator"),
        "settings": ffi.addressof(record, "settings"), "rc": ffi.addressof(record, "rc", "settings"),
        "log_faults": ffi.addressof(record, "log", "device", "faults"),
    })  # fmt: skip

    def send(which):
        for k in range(len(link.once)):
            link.once[k], link.due_s[k] = k == which, 1e9
        lib.link_step(link, vehicle)
        out = ffi.new("uint8_t[300]")
        count = lib.link_waiting(link, out, 300)
        lib.link_sent(link, count)
        (message,) = s.decode.parse_buffer(bytes(ffi.buffer(out, count)))
        return message

    mission = software.mission
    modes = {
        "INIT": (4, 1), "TAKE_OFF": (4, 2), "HOVER": (4, 3), "WAYPOINT": (4, 4), "OBSTACLE": (4, 4), "LANDING": (4, 6),
        "RC": (2, 0), "OFFBOARD": (6, 0),
    }  # fmt: skip
    for name, mode in modes.items():
        mission.state = getattr(lib, f"STATE_{name}")
        for by_user in (False, True):
            mission.user_in_control = by_user
            told = send(0).custom_mode
            loiters = by_user and name in ("WAYPOINT", "OBSTACLE")
            assert (told >> 16 & 255, told >> 24) == ((4, 3) if loiters else mode), (name, by_user)
    mission.state, mission.battery_V = lib.STATE_HOVER, record.plan.low_voltage - 0.1
    assert send(0).system_status == mavlink.MAV_STATE_STANDBY  # on the floor
    software.motors, software.is_lifted = lib.MOTORS_FLY, True
    mission.home_position[2], belief.motion.position[2] = 0.0, -1.0
    assert send(0).system_status == mavlink.MAV_STATE_CRITICAL
    belief.valid, belief.checks[lib.SENSOR_SONAR].status = True, lib.SENSOR_FUSED
    attitude, level, height, sonar = 1, 8 + 16 + 256 + 512, 32, 64
    for variances, flags in (
        ((0.0, 0.0), attitude + level + height + sonar), ((1.0, 0.0), level + height + sonar),
        ((0.0, 0.3), attitude + sonar), ((1.0, 0.3), sonar), ((float("nan"), 0.0), level + height + sonar),
    ):  # fmt: skip
        belief.attitude_variance = [variances[0]] * 3
        belief.position_variance = [variances[1]] * 3
        assert send(7).flags == flags, variances
    belief.valid = False
    assert send(7).flags == 0
    # Not armed, with motors that still run: no mission is loaded.
    mission.state = lib.STATE_INIT
    frame = mavlink.MAVLink_mission_count_message(1, 1, 1, 0).pack(s.codec)
    for motors, answer in ((lib.MOTORS_RAMP_DOWN, "MISSION_ACK"), (lib.MOTORS_OFF, "MISSION_REQUEST_INT")):
        software.motors, link.input_count = motors, len(frame)
        ffi.memmove(link.input, frame, len(frame))
        assert send(-1).get_type() == answer
        link.input_count = 0
    link.loads = False
    for volts, told in ((7.5, 7500), (-1.0, 65535), (70.0, 65535), (float("nan"), 65535)):
        belief.motion.voltage = volts
        assert send(1).voltage_battery == told


class FlyingStation(Station):
    """A ground station at the link of a board that flies in the simulation on this machine."""

    def __init__(self, library, vehicle) -> None:
        super().__init__(library)
        controller, mission = design_flight_controller(vehicle), load_mission("demonstration")
        self.flight = Flight(
            vehicle, mission, controller=controller, keep=False, sensors="fitted", seed=3,
            estimator=BoardEstimator(self.board, vehicle, mission.world, controller.rate_Hz),
            controllers=make_board_software(self.board),
        )  # fmt: skip
        self.flight.autopilot.software.commands_itself = True

    def step(self, data=b"") -> None:
        self.flight.step_period()
        self.heard += self.decode.parse_buffer(self.board.exchange_bytes(data)) or []

    def fly_until(self, reached, limit_s, message=None) -> None:
        """Fly until a condition holds; send a message, if given, ten times a second."""
        for k in range(round(limit_s * 200)):
            if reached():
                return
            if message is not None and k % 20 == 0:
                self.send(message)
            else:
                self.step()
        raise AssertionError("the condition was not met in time")

    def latest(self, kind):
        """Return the next message of a kind that is sent from now on."""
        self.heard.clear()
        return self.wait_for(kind, 300)


def test_a_station_flies_the_board_of_this_machine(vehicle, library) -> None:
    """Take-off, go to, set-points, sticks, mission, pause; then the station is silent: hold, land, disarm."""
    s = FlyingStation(library, vehicle)
    record, lib = s.board.record, s.lib
    mission, supervisor = record.software.mission, record.supervisor
    accepted, rejected = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED

    def distance(*place) -> float:
        return float(np.linalg.norm(np.array(list(record.belief.motion.position)) - place))

    def set_mode(main, sub=0) -> int:
        return s.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, main, sub)

    with s.flight:
        s.fly_until(lambda: record.belief.time_s > 3.0, 5.0)
        assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == accepted
        assert s.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0.5) == accepted
        s.fly_until(lambda: mission.state == lib.STATE_TAKE_OFF and record.software.motors == lib.MOTORS_FLY, 5.0)
        assert s.latest("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_TAKEOFF
        s.fly_until(lambda: mission.state == lib.STATE_HOVER, 15.0)
        assert s.latest("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_IN_AIR
        assert s.latest("HEARTBEAT").base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        # In flight no mission is loaded, nothing is disarmed and nothing is stored.
        s.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 0))
        assert s.wait_for("MISSION_ACK").type == mavlink.MAV_MISSION_ERROR
        assert s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == rejected
        assert s.command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1.0) == rejected

        nan = float("nan")
        s.send(mavlink.MAVLink_command_int_message(1, 1, 1, 192, 0, 0, -1.0, 1.0, 0.0, nan, 4000, 2000, -0.7))
        assert s.wait_for("COMMAND_ACK").result == accepted
        s.fly_until(lambda: mission.state == lib.STATE_WAYPOINT, 1.0)
        assert s.latest("HEARTBEAT").custom_mode >> 24 == 3  # AUTO_LOITER
        s.fly_until(lambda: distance(0.4, 0.2, -0.7) < 0.15, 20.0)

        assert set_mode(6) == rejected  # without set-points
        target = mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0b100111111000, 0.0, 0.2, -0.7, 0, 0, 0, 0, 0, 0, 0, 0.0
        )
        s.send(target)
        assert set_mode(6) == accepted
        s.fly_until(lambda: mission.state == lib.STATE_OFFBOARD, 2.0, target)
        s.fly_until(lambda: distance(0.0, 0.2, -0.7) < 0.15, 20.0, target)
        assert s.latest("HEARTBEAT").custom_mode >> 16 == 6
        s.fly_until(lambda: mission.state == lib.STATE_HOVER, 3.0)

        sticks = mavlink.MAVLink_manual_control_message(1, 300, 0, 500, 0, 0)
        s.send(sticks)
        assert mission.state == lib.STATE_HOVER  # sticks count in a manual mode only
        assert set_mode(2) == accepted
        s.fly_until(lambda: mission.state == lib.STATE_RC, 1.0, sticks)
        assert s.latest("HEARTBEAT").custom_mode >> 16 & 255 == 2
        s.fly_until(lambda: mission.state == lib.STATE_HOVER, 3.0)

        assert s.command(mavlink.MAV_CMD_MISSION_START) == accepted
        s.fly_until(lambda: mission.state == lib.STATE_WAYPOINT, 2.0)
        assert s.latest("HEARTBEAT").custom_mode >> 24 == 4  # AUTO_MISSION
        assert s.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0) == accepted
        s.fly_until(lambda: mission.state == lib.STATE_HOVER, 2.0)
        assert s.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == accepted
        s.fly_until(lambda: mission.returning_home, 2.0)
        assert s.latest("HEARTBEAT").custom_mode >> 24 == 5  # AUTO_RTL
        assert set_mode(4, 3) == accepted  # AUTO_LOITER
        s.fly_until(lambda: mission.state == lib.STATE_HOVER and not mission.returning_home, 2.0)

        for name, seconds in ((b"COM_DL_LOSS_T", 1.0), (b"COM_DL_LAND_T", 1.0)):
            s.send(mavlink.MAVLink_param_set_message(1, 1, name, seconds, 9))
        assert s.command(mavlink.MAV_CMD_MISSION_START) == accepted
        silent_s = record.belief.time_s
        s.fly_until(lambda: mission.state == lib.STATE_WAYPOINT, 0.5)
        s.fly_until(lambda: mission.state == lib.STATE_HOVER, 2.0)
        assert record.belief.time_s - silent_s > 0.9
        s.fly_until(lambda: mission.state == lib.STATE_LANDING, 2.0)
        assert record.belief.time_s - silent_s > 1.9
        assert s.latest("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_LANDING
        s.fly_until(lambda: not supervisor.armed, 15.0)
        assert not s.flight.plant.crash_cause
        assert s.latest("EXTENDED_SYS_STATE").landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND


@needs_qemu
def test_a_station_flies_the_emulated_board_through_its_uart(vehicle) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    over, said, peak = threading.Event(), [], []

    def fly() -> None:
        c = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=255, retries=100)
        c.wait_heartbeat(timeout=30)

        def command(number, *params) -> bool:
            c.mav.command_long_send(1, 1, number, 0, *params, *[0.0] * (7 - len(params)))
            answer = c.recv_match(type="COMMAND_ACK", blocking=True, timeout=10)
            return answer is not None and answer.command == number and answer.result == 0

        def wait(kind, until):
            while not over.is_set():
                c.mav.heartbeat_send(6, 8, 0, 0, 4)
                m = c.recv_match(type=[kind, "STATUSTEXT"], blocking=True, timeout=5)
                if m is not None and m.get_type() == "STATUSTEXT":
                    said.append(m.text)
                elif m is not None and until(m):
                    return

        # Armed without a take-off it disarms after 10 s of its own clock, which a busy machine may take to answer.
        while not (command(400, 1.0) and command(22, 0, 0, 0, 0, 0, 0, 0.4)) and not over.is_set():
            c.recv_match(type="SYS_STATUS", blocking=True, timeout=5)
        wait("LOCAL_POSITION_NED", lambda m: peak.append(-m.z) or -m.z > 0.32)
        while not command(21) and not over.is_set():
            pass
        wait("HEARTBEAT", lambda m: not m.base_mode & 128)
        over.set()

    station = threading.Thread(target=fly, daemon=True)
    flown = run_linked_board(
        vehicle, load_mission("demonstration"), port=port, pace=2.0, on_open=station.start,
        stop=lambda flight: over.is_set() or flight.time_s > 90.0,
    )  # fmt: skip
    assert over.is_set(), (said, peak[-3:], flown.realtime_factor)
    assert max(peak) > 0.32
    assert flown.mismatch_count == 0, flown.first_mismatch
    assert flown.periods > 1500


@needs_qemu
def test_a_fast_emulation_waits_for_the_heartbeats_of_a_station(vehicle) -> None:
    """Heartbeats come once a second of the wall clock, COM_DL_LOSS_T counts seconds of flight."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    over, silence, loss_s = threading.Event(), [0.0], 5.0

    def command() -> None:
        c = mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=255, retries=100)
        c.wait_heartbeat(timeout=30)
        c.mav.param_set_send(1, 1, b"COM_DL_LOSS_T", loss_s, 9)
        for _ in range(3):
            c.mav.heartbeat_send(6, 8, 0, 0, 4)
            time.sleep(1.0)
        over.set()

    def stop(flight) -> bool:
        s = flight.autopilot.software.board.record.supervisor
        if s.has_commander and s.settings.link_loss_s == loss_s:
            silence.append(s.now_s - s.commander_heard_s)
        return over.is_set()

    station = threading.Thread(target=command, daemon=True)
    run_linked_board(vehicle, load_mission("demonstration"), port=port, pace=0.0, on_open=station.start, stop=stop)
    assert len(silence) > 100
    assert max(silence) < loss_s


def test_the_fuzzing_harness_fits_the_sources(vehicle, tmp_path) -> None:
    mission, controller = load_mission("demonstration"), design_flight_controller(vehicle)
    export_firmware(controller, tmp_path / "fw", vehicle, mission.world, mission)
    parts = ("-DFUZZ_MISSION", "-DFUZZ_ESTIMATE", "-DFUZZ_LINK")
    command = [COMPILERS[0], "-std=gnu99", "-fsyntax-only", *parts, "-I."]
    done = subprocess.run([*command, "check/programs/fuzz.c"], cwd=tmp_path / "fw", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
