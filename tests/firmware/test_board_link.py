"""MAVLink of a board in C: frames equal pymavlink's; stations read, set, command and load missions."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import threading
import time

os.environ.setdefault("MAVLINK20", "1")

import numpy as np
import pytest
from board_station import Station, mission_item
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from mufly.control import design_flight_controller
from mufly.firmware import describe_missing_tools, export_firmware
from mufly.firmware.emulated.board_link import run_linked_board
from mufly.firmware.emulated.image_build import build_host_board
from mufly.flight.tunable_parameters import TUNABLE_PARAMETERS
from mufly.link.parameter_protocol import LINK_PARAMETERS
from mufly.link.telemetry_streams import MESSAGE_STREAMS
from mufly.mission import LogMessage, load_mission
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
    assert {n for n in dir(lib) if n.startswith("MSG_")} <= {f"MSG_{n}" for n in MESSAGES}
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
    for code, message in enumerate(LogMessage):
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
