"""The small parts of the link, each by itself: streams, parameters, modes, sticks, set-points, texts, failsafe, log."""

import math
import struct
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from link_rig import Rig

from mufly.estimate import Estimate
from mufly.link import (
    INTEGER_RANGES,
    MESSAGE_STREAMS,
    Command,
    FrameDecoder,
    FrameEncoder,
    StatusTextAssembler,
    StatusTextSplitter,
    decode_parameter_value,
    encode_parameter_value,
    pack_custom_mode,
    parse_command,
    px4_mode_from_state,
    unpack_custom_mode,
)
from mufly.link import mavlink as m
from mufly.link.clients import MAX_CLIENTS, MAX_STREAM_HZ, Clients, StreamSchedule, next_link_loss_stage
from mufly.link.codec import action_for_mode
from mufly.link.command_protocol import answer_message_request
from mufly.link.steering_input import parse_manual_control, parse_rc_override, parse_set_point
from mufly.logs import detect_log_format
from mufly.logs.tlog import TlogWriter
from mufly.mission import State
from mufly.sensors import Reading, Readings

# streams


def rates(wishes, seconds=10.0, step=0.005, start=50.0):
    """Messages a second, by name."""
    count = dict.fromkeys((s.message_name for s in MESSAGE_STREAMS), 0)
    for k in range(round(seconds / step)):
        for place in wishes.take_due_streams(start + k * step):
            count[MESSAGE_STREAMS[place].message_name] += 1
    return {name: n / seconds for name, n in count.items()}


def test_who_asks_for_nothing_gets_the_default_rates():
    got = rates(StreamSchedule(50.0))
    for s in MESSAGE_STREAMS:
        assert got[s.message_name] == pytest.approx(s.default_rate_Hz, abs=0.2), s.message_name


def test_a_wish_is_granted_up_to_a_limit():
    wishes = StreamSchedule(50.0)
    assert wishes.set_message_interval(50.0, m.MAVLINK_MSG_ID_ATTITUDE, 10_000)
    assert wishes.set_message_interval(50.0, m.MAVLINK_MSG_ID_RAW_RPM, 1.0)
    assert wishes.set_message_interval(50.0, m.MAVLINK_MSG_ID_SYS_STATUS, -1)
    assert not wishes.set_message_interval(50.0, 11, 1000.0)
    assert not wishes.set_message_interval(50.0, m.MAVLINK_MSG_ID_ATTITUDE, math.nan)
    got = rates(wishes)
    assert got["ATTITUDE"] == pytest.approx(100.0, abs=0.2)
    assert got["RAW_RPM"] <= MAX_STREAM_HZ + 0.2
    assert got["SYS_STATUS"] == 0
    assert wishes.interval_us(m.MAVLINK_MSG_ID_ATTITUDE) == 10_000
    assert wishes.interval_us(m.MAVLINK_MSG_ID_SYS_STATUS) == -1
    wishes.set_message_interval(60.0, m.MAVLINK_MSG_ID_SYS_STATUS, 0)
    assert wishes.interval_us(m.MAVLINK_MSG_ID_SYS_STATUS) == 500_000


def test_after_a_stall_there_is_no_burst():
    wishes = StreamSchedule(0.0)
    list(wishes.take_due_streams(0.0))
    late = [MESSAGE_STREAMS[k].message_name for k in wishes.take_due_streams(100.0)]
    assert len(late) == len(set(late))
    assert len(list(wishes.take_due_streams(100.001))) == 0


def test_who_is_silent_is_sent_nothing_more_but_whom_it_was_told_to_call_is():
    clients = Clients(1, 1)
    clients.add_client(0.0, "told to", fixed=True)
    for k in range(3):
        clients.mark_heard(5.0 * k, k)
    assert clients.drop_silent_clients(14.0) == []
    assert clients.drop_silent_clients(16.0) == [0]
    for k in range(MAX_CLIENTS):
        clients.mark_heard(17.0, f"stranger {k}")
    assert clients.drop_silent_clients(17.0) == [1, 2, "stranger 0"]  # the longest silent make room
    assert (len(clients), clients.find_client("told to") is not None) == (MAX_CLIENTS, True)


def test_the_older_form_of_a_wish():
    wishes = StreamSchedule(50.0)
    wishes.set_group_rate(50.0, 0, 4)
    got = rates(wishes)
    assert got["ATTITUDE"] == pytest.approx(4.0, abs=0.2)
    assert got["HEARTBEAT"] == pytest.approx(1.0, abs=0.2)  # not a matter of taste
    assert got["DEBUG_FLOAT_ARRAY"] == 0


def test_messages_are_requested():
    wishes = StreamSchedule(0.0)
    list(wishes.take_due_streams(0.0))
    result, _ = answer_message_request(0.0, Command(512, (148.0, *[0.0] * 6), None), wishes, False)
    assert result == 0
    assert [MESSAGE_STREAMS[k].message_name for k in wishes.take_due_streams(0.001)] == ["AUTOPILOT_VERSION"]
    for number, expected in ((242.0, 2), (99999.0, 3), (math.nan, 3), (-5.0, 3), (math.inf, 3)):
        result, _ = answer_message_request(0.0, Command(512, (number, *[0.0] * 6), None), wishes, False)
        assert result == expected
    _, (answer,) = answer_message_request(0.0, Command(510, (30.0, *[0.0] * 6), None), wishes, False)
    assert (answer.message_id, answer.interval_us) == (30, 50_000)


# parameters


def test_numbers_of_seven_digits_are_what_was_meant():
    assert decode_parameter_value(float(np.float32(0.6)), m.MAV_PARAM_TYPE_REAL32) == 0.6
    as_bytes = struct.unpack("<f", struct.pack("<i", -7))[0]
    assert decode_parameter_value(as_bytes, m.MAV_PARAM_TYPE_INT32) == -7
    assert decode_parameter_value(struct.unpack("<f", b"\xff\0\0\0")[0], m.MAV_PARAM_TYPE_INT8) == -1


@pytest.mark.parametrize("kind", range(m.MAV_PARAM_TYPE_UINT8, m.MAV_PARAM_TYPE_REAL32 + 1))
@pytest.mark.parametrize("bytewise", [True, False])
def test_what_one_end_encodes_the_other_decodes(kind, bytewise):
    least, greatest = INTEGER_RANGES.get(kind, (-5, 5))
    for value in (least, 0, 1, 100, greatest):
        if kind in INTEGER_RANGES or abs(value) < 10:
            there = decode_parameter_value(
                float(np.float32(encode_parameter_value(value, kind, bytewise))), kind, bytewise
            )
            assert there == (value if bytewise else pytest.approx(value, rel=1e-6))


def test_a_command_is_the_same_at_both_ends():
    for command in (
        Command(400, (0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        Command(192, (-1.0, 0.0, 0.0, math.nan, 1.5, -2.25, -1.0), frame=1),
        Command(192, (-1.0, 1.0, 0.0, math.nan, 47.25, math.nan, 408.0), frame=0),
    ):
        assert parse_command(command.to_message(1, 1)).identity_bytes == command.identity_bytes
    assert Command(400, (0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0)).is_emergency_stop
    assert not Command(400, (1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0)).is_emergency_stop
    assert parse_command(Command(400, (1.0,) * 7).to_message(1, 1, confirmation=3)).confirmation == 3


def test_parameters_are_listed_read_and_set():
    rig = Rig()
    gcs = rig.station()
    gcs.say(m.MAVLink_param_request_list_message(1, 1))
    rig.run(0.2)
    # A hundred a second, so that a slow radio has time; whatever the period of the flight software is.
    assert len(gcs.all("PARAM_VALUE")) == pytest.approx(20, abs=2)
    rig.run(0.8)
    listed = gcs.all("PARAM_VALUE")
    assert [p.param_index for p in listed] == list(range(listed[0].param_count))
    names = [p.param_id for p in listed]
    assert names == sorted(names)
    assert {"MIS_TAKEOFF_ALT", "COM_DL_LOSS_T", "CTL_POS_GAIN"} <= set(names)
    assert all(p.param_type == m.MAV_PARAM_TYPE_REAL32 for p in listed)
    waits = {p.param_id: p.param_value for p in listed if p.param_id.startswith("COM_")}
    assert waits == {"COM_DL_LOSS_T": 10.0, "COM_DL_LAND_T": 20.0}
    for name, asked_for, expected in (
        ("LIM_SPEED", 0.4, 0.4),
        ("LIM_SPEED", 1e9, 0.4),
        ("LIM_SPEED", math.nan, 0.4),
        ("COM_DL_LOSS_T", 4.0, 4.0),
        ("COM_DL_LOSS_T", -1.0, 4.0),
        ("COM_DL_LOSS_T", math.nan, 4.0),
        ("COM_DL_LOSS_T", 0.9, 4.0),
        ("COM_DL_LOSS_T", 301.0, 4.0),
        ("COM_DL_LAND_T", 3601.0, 20.0),
    ):
        gcs.heard.clear()
        gcs.say(m.MAVLink_param_set_message(1, 1, name.encode(), asked_for, 9))
        rig.run(0.05)
        assert gcs.last("PARAM_VALUE").param_value == pytest.approx(expected)
        assert ("LIM_SPEED" in gcs.words or "COM_DL_L" in gcs.words) == (asked_for != expected)
    gcs.heard.clear()
    gcs.say(m.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    gcs.say(m.MAVLink_param_request_read_message(1, 1, b"\xff\xfe", -1))
    gcs.say(m.MAVLink_param_request_read_message(1, 1, b"", 9999))
    gcs.say(m.MAVLink_param_request_read_message(1, 1, b"", 3))
    rig.run(0.05)
    assert [p.param_index for p in gcs.all("PARAM_VALUE")] == [3]
    assert "NO_SUCH" in gcs.words
    missing = [(e.param_id, e.param_index) for e in gcs.all("PARAM_ERROR")]
    assert [index for _, index in missing] == [-1, -1, 9999]
    assert missing[0][0] == "NO_SUCH"
    # By name; the bounds themselves are taken; the last one of the list and none behind it.
    gcs.heard.clear()
    for value in (1.0, 300.0):
        gcs.say(m.MAVLink_param_set_message(1, 1, b"COM_DL_LOSS_T", value, 9))
    gcs.say(m.MAVLink_param_request_read_message(1, 1, b"COM_DL_LAND_T", -1))
    for index in (listed[0].param_count - 1, listed[0].param_count):
        gcs.say(m.MAVLink_param_request_read_message(1, 1, b"", index))
    rig.run(0.05)
    assert [p.param_value for p in gcs.all("PARAM_VALUE")] == [1.0, 300.0, 20.0, listed[-1].param_value]
    assert gcs.last("PARAM_VALUE").param_id == names[-1]
    assert gcs.last("PARAM_ERROR").param_index == listed[0].param_count
    # What was changed by something else than a PARAM_SET is told within half a second, once.
    gcs.heard.clear()
    assert rig.link.autopilot.set_parameter("LIM_SPEED", 0.3)
    rig.run(0.6)
    assert [(p.param_id, p.param_value) for p in gcs.all("PARAM_VALUE")] == [("LIM_SPEED", pytest.approx(0.3))]
    # A list that is asked for anew begins anew; sixteen at a time.
    gcs.heard.clear()
    gcs.say(m.MAVLink_param_request_list_message(1, 1))
    rig.run(0.06)
    gcs.say(m.MAVLink_param_request_list_message(1, 1))
    rig.run(0.06)
    again = [p.param_index for p in gcs.all("PARAM_VALUE")]
    assert again.count(0) == 2
    assert again == [*range(again.index(0, 1)), *range(len(again) - again.index(0, 1))]


# modes, set-points, sticks


def test_every_state_has_a_mode_and_numbers_go_both_ways():
    for state in State:
        mode = px4_mode_from_state(state)
        assert unpack_custom_mode(pack_custom_mode(mode)) == mode
    for word in ("take-off", "hover", "mission", "return", "land", "rc", "offboard"):
        assert word in {
            action_for_mode(unpack_custom_mode(main << 16 | sub << 24)) for main in range(9) for sub in range(9)
        }
    assert action_for_mode(unpack_custom_mode(0xFFFFFFFF)) == ""


def measured(yaw=0.0):
    return Estimate(0.0, np.array([1.0, 2.0, -3.0]), np.zeros(3), np.array([0, 0, yaw]), np.zeros(3), np.zeros(8), 7.4)


def local(frame, mask, *fields):
    return m.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *fields)


def test_set_points_in_their_frames():
    here = measured(math.pi / 2)
    nothing = (0.0,) * 3
    place = parse_set_point(local(1, 0xFF8, 1, 2, -1, *nothing, *nothing, 0, 0), here, None)
    assert place.position_m == (1, 2, -1)
    assert (place.velocity_m_s, place.heading_rad, place.yaw_rate_rad_s) == (None, None, None)
    assert parse_set_point(local(7, 0xFF8, 1, 0, 0, *nothing, *nothing, 0, 0), here, None).position_m == (
        2,
        2,
        -3,
    )
    ahead = parse_set_point(local(8, 0xBC0, 1, 0, 0, 0.5, 0, 0, *nothing, 0.1, 0), here, None)
    assert ahead.position_m == pytest.approx((1, 3, -3))
    assert ahead.velocity_m_s == pytest.approx((0, 0.5, 0))
    assert ahead.heading_rad == pytest.approx(math.pi / 2 + 0.1)
    height = parse_set_point(local(1, 0xFFB, 9, 9, -1, *nothing, *nothing, 0, 0), here, None).position_m
    assert math.isnan(height[0])
    assert height[2] == -1
    for yaw in (0.4, 2.0, -2.5):  # turned with the nose, as a number of the plane north + i east is
        there = parse_set_point(local(9, 0x000, 1.5, -0.5, 0.2, 0.3, 0.1, -0.2, *nothing, 0, 0), measured(yaw), None)
        turn = complex(math.cos(yaw), math.sin(yaw))
        for found, told, start in (
            (there.position_m, (1.5, -0.5, 0.2), (1, 2, -3)),
            (there.velocity_m_s, (0.3, 0.1, -0.2), (0, 0, 0)),
        ):
            on = complex(*start[:2]) + turn * complex(*told[:2])
            assert found == pytest.approx((on.real, on.imag, start[2] + told[2]))


@pytest.mark.parametrize(
    "message",
    [
        local(1, 0xFFF, *[0.0] * 11),
        local(1, 0xE3F, *[1.0] * 11),  # an acceleration only
        local(1, 0x1FF8, *[0.0] * 11),  # a bit that means something else to somebody else
        local(1, 0x000, *[math.nan] * 11),
        local(0, 0xFF8, *[1.0] * 11),
        m.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0xFF8, 1, 1, 1, *[0.0] * 8),
    ],
)
def test_messages_that_ask_for_nothing(message):
    assert parse_set_point(message, measured(), None) is None


def channels(*us):
    return m.MAVLink_rc_channels_override_message(1, 1, *us, 0, 0, 0, 0)


def test_sticks():
    assert parse_rc_override(channels(0, 65535, 0, 65535)) is None
    full = parse_rc_override(channels(2000, 1000, 9999, 1500))
    assert (full.roll, full.pitch, full.climb, full.yaw) == (1, -1, 1, 0)
    beyond = parse_rc_override(channels(2300, 700, 1500, 1500))  # a radio that is not trimmed
    assert (beyond.roll, beyond.pitch) == (1, -1)
    assert parse_rc_override(channels(1510, 1490, 1500, 0)) == parse_rc_override(channels(1500, 1500, 1500, 1500))
    still = parse_manual_control(m.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0))
    assert (still.roll, still.pitch, still.climb, still.yaw) == (0, 0, 0, 0)
    forward = parse_manual_control(m.MAVLink_manual_control_message(1, 1000, 32767, 32767, 32767, 0))
    assert (forward.roll, forward.pitch, forward.climb, forward.yaw) == (0, -1, 0, 0)  # nose down


# texts, failsafe, log


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 1000])
def test_long_lines_come_in_pieces_that_fit_together(length):
    text = ("abcdefghi " * 101)[:length].strip()
    pieces = StatusTextSplitter()(text, "warning")
    assert "".join(p.text for p in pieces) == text[:400]
    assert [p.chunk_seq for p in pieces] == list(range(len(pieces)))
    assert len({p.id for p in pieces}) == 1
    assert (pieces[0].id == 0) == (len(pieces) == 1)
    if len(pieces) > 1:
        assert len(pieces[-1].text) < 50


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 100, 400])
def test_what_one_end_cuts_the_other_puts_together(length):
    text = ("abcdefghi " * 101)[:length].strip()
    whole = StatusTextAssembler()
    packed = [
        FrameDecoder().decode_bytes(0.0, "v", FrameEncoder(1, 1)(p))[0] for p in StatusTextSplitter()(text, "error")
    ]
    assert [line for p in packed for line in whole.add_chunk(0.0, p)] == [(m.MAV_SEVERITY_ERROR, text)]
    lossy = StatusTextAssembler()
    for p in packed[1:]:
        assert lossy.add_chunk(0.0, p) == []
    said = lossy.take_overdue(10.0)
    assert said == ([(m.MAV_SEVERITY_ERROR, "..." + text[50:])] if len(packed) > 1 else [])
    assert lossy.take_overdue(20.0) == []


def test_a_full_stick_asks_for_what_the_parameters_say():
    rig = Rig()
    asked = []
    rig.link.autopilot.set_sticks = lambda *values: asked.append(values)
    for name, value in (("STK_TILT", 8.0), ("STK_YAWRATE", 40.0), ("STK_CLIMB", 0.3)):
        assert rig.link.autopilot.set_parameter(name, value)
    manual = rig.link._stick_input
    manual.handle_rc_override(m.MAVLink_rc_channels_override_message(1, 1, 2000, 1000, 1750, 1250, 0, 0, 0, 0))
    half = (0.5 - 0.03) / 0.97
    assert asked[-1] == pytest.approx((math.radians(8.0), -math.radians(8.0), -half * math.radians(40.0), half * 0.3))
    # MANUAL_CONTROL counts while it is fresh, once a mode for flying by hand is asked for.
    manual.handle_rc_override(m.MAVLink_rc_channels_override_message(1, 1, *[65535] * 8))
    manual.handle_manual_control(10.0, m.MAVLink_manual_control_message(1, 1000, 0, 500, 0, 0))
    assert manual.enter_manual_mode(11.5).is_temporary
    count = len(asked)
    manual.handle_manual_control(11.6, m.MAVLink_manual_control_message(1, 1000, 0, 500, 0, 0))
    assert len(asked) == count
    manual.enter_manual_mode(12.5)
    assert asked[-1] == pytest.approx((0.0, -math.radians(8.0), 0.0, 0.0))


def test_failsafe_once_each():
    f, said = "", []
    for k in range(400):
        silent = k * 0.1 if k < 350 else 0.0
        f, order = next_link_loss_stage(f, silent_s=silent, flying=True, ending=False, loss_s=10.0, land_s=20.0)
        said += [(order, round(silent))] if order else []
    assert said == [("hover", 10), ("land", 30), ("back", 0)]
    f, order = next_link_loss_stage("", silent_s=99.0, flying=False, ending=False, loss_s=10.0, land_s=20.0)
    assert order == ""
    f, order = next_link_loss_stage("", silent_s=99.0, flying=True, ending=True, loss_s=10.0, land_s=20.0)
    assert order == ""


def test_a_telemetry_log_is_one(tmp_path):
    encode = FrameEncoder(1, 1)
    path = tmp_path / "deep" / "link.tlog"
    with TlogWriter(path) as log:
        for k in range(5):
            log.write_packet(encode(m.MAVLink_attitude_message(k, 0, 0, 0, 0, 0, 0)), 1_700_000_000_000_000 + k)
    data = path.read_bytes()
    assert detect_log_format(path) == "MAVLink tlog"
    assert struct.unpack(">Q", data[:8])[0] == 1_700_000_000_000_000


# what is said, whatever the state of the helicopter


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0])
def test_every_message_can_be_packed_whatever_the_numbers(value):
    rig = Rig(origin=(47.3769, 8.5417, 408.0))
    gcs = rig.station()
    rig.run(0.1)
    three, state = np.full(3, value), rig.flight.status
    believed = replace(
        state.estimate,
        position=three, velocity=three, attitude=three, rates=three, ranges=np.full(8, value), battery_voltage=value,
    )  # fmt: skip
    true = replace(
        state.truth,
        state=np.full(21, value),
        attitude=three,
        wind=three,
        battery_voltage_V=value,
        battery_current_A=value,
    )
    readings = Readings(0.0, {name: Reading(three, 0.0) for name in ("position", "attitude")})
    rig.link.flight = SimpleNamespace(
        vehicle=rig.flight.vehicle,
        status=replace(
            state,
            estimate=believed,
            readings=readings,
            truth=true,
            reference_position=three,
            reference_velocity=three,
            reference_attitude=three,
            battery_current=value,
            battery_charge=value,
            battery_left_s=value,
        ),
    )
    rig.link.real_time_factor = 1.0 if math.isnan(value) else value
    for s in MESSAGE_STREAMS:
        rig.link.clients.find_client("gcs").schedule.request_once(s.message_id)
    for out in rig.link.take_due_frames(rig.now_s):
        gcs.hear(out.data)
    heard = {x.get_type() for x in gcs.heard}
    assert {s.message_name.split(" ")[0] for s in MESSAGE_STREAMS} <= heard


def test_what_is_told_with_an_origin_and_what_without():
    rig = Rig(origin=(47.3769, 8.5417, 408.0))
    gcs = rig.station()
    rig.run(1.5)
    at = gcs.last("GLOBAL_POSITION_INT")
    assert (at.lat, at.lon) == pytest.approx((473769000, 85417000), abs=1)
    assert gcs.last("SYS_STATUS").onboard_control_sensors_health & m.MAV_SYS_STATUS_SENSOR_GPS
    assert gcs.last("GPS_RAW_INT").fix_type == 3
    rig = Rig()
    gcs = rig.station()
    rig.run(1.5)
    assert gcs.last("GLOBAL_POSITION_INT") is None
    assert not gcs.last("SYS_STATUS").onboard_control_sensors_present & m.MAV_SYS_STATUS_SENSOR_GPS


def test_the_ring_of_beams_is_told_as_it_stands():
    rig = Rig({"name": "w", "wall": ({"start_m": (1.0, -5.0), "end_m": (1.0, 5.0), "height_m": 3.0},)})
    gcs = rig.station()
    rig.run(0.6)
    ring = gcs.last("OBSTACLE_DISTANCE")
    seen = rig.flight.status.estimate.ranges
    assert ring.increment_f == 45.0
    assert ring.angle_offset == 22.5
    for k, r in enumerate(seen):
        assert ring.distances[k] == (151 if r >= 1.5 else pytest.approx(r * 100, abs=0.51))
    assert set(ring.distances[8:]) == {65535}
    beam = next(x for x in gcs.all("DISTANCE_SENSOR") if x.id == 0)
    assert beam.orientation == m.MAV_SENSOR_ROTATION_CUSTOM
    assert 2 * math.degrees(math.atan2(beam.quaternion[3], beam.quaternion[0])) == pytest.approx(22.5)


def test_time_is_answered():
    rig = Rig()
    gcs = rig.station()
    rig.run(1.0)
    gcs.say(m.MAVLink_timesync_message(0, 12345))
    gcs.say(m.MAVLink_ping_message(5, 7, 0, 0))
    rig.run(0.1)
    answer = gcs.last("TIMESYNC")
    assert answer.ts1 == 12345
    assert answer.tc1 == pytest.approx(1e9 * rig.flight.time_s, abs=0.15e9)  # ns on the vehicle's clock
    assert gcs.last("PING").seq == 7
    gcs.heard.clear()  # what answers somebody is not answered
    gcs.say(m.MAVLink_timesync_message(5, 12345))
    gcs.say(m.MAVLink_ping_message(5, 7, 1, 1))
    rig.run(0.1)
    assert not gcs.all("TIMESYNC")
    assert not gcs.all("PING")


def test_what_changes_is_told_at_once_and_no_more_often():
    rig = Rig()
    gcs = rig.station()
    rig.run(0.6)
    assert gcs.last("SYS_STATUS").onboard_control_sensors_health & m.MAV_SYS_STATUS_PREARM_CHECK
    gcs.heard.clear()
    rig.run(1.0)
    assert len(gcs.all("HEARTBEAT")) == 1
    gcs.heard.clear()
    gcs.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    rig.run(0.03)
    assert [x.base_mode >> 7 for x in gcs.all("HEARTBEAT")] == [1]
