"""From messages to signals: tables, masks, clocks, frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mufly.link import MISSION_STATES, mavlink
from mufly.quantities.quantity_table import list_mavlink_field_columns
from mufly.station import SignalHistory
from mufly.station.remote.remote_commands import StatusTextLog
from mufly.station.remote.vehicle_telemetry import TABLE_MESSAGES, MonotonicVehicleClock, VehicleTelemetry
from mufly.station.signal_history import SIGNAL_TIMEOUT_S
from mufly.vehicle_types import flight_mode_name


def sent(message):
    """A message as it comes off the wire: values in the precision of their fields."""
    link = mavlink.MAVLink(None)
    return link.decode(bytearray(message.pack(link)))


def told(*messages, telemetry=None, now_s=1.0):
    telemetry = telemetry or VehicleTelemetry(SignalHistory(seconds=10.0))
    for message in messages:
        telemetry.handle_message(now_s, sent(message))
    return telemetry


def attitude(boot_ms, yaw=0.0):
    return mavlink.MAVLink_attitude_message(boot_ms, 0.1, 0.2, yaw, 0.3, 0.4, 0.5)


def test_every_field_of_the_table_is_a_field_of_its_message_and_a_signal_of_the_history():
    names = set(SignalHistory(seconds=1.0).names)
    for name in TABLE_MESSAGES:
        fields = mavlink.mavlink_map[getattr(mavlink, f"MAVLINK_MSG_ID_{name}")].fieldnames
        for field, signal, _ in list_mavlink_field_columns(name):
            assert field in fields
            assert signal in names


def test_what_was_measured_in_one_instant_stands_in_one_row():
    t = told(
        attitude(1000),
        mavlink.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 0.1, 0.2, 0.3),
        mavlink.MAVLink_raw_rpm_message(1, 3000.0),
        attitude(1010),
    )
    times, values = t.history.rows_since(
        0.0, ["estimated_attitude_pitch", "estimated_position_D", "measured_rotor_speed_lower"]
    )
    assert times.tolist() == [1.0]
    np.testing.assert_allclose(values[0], [0.2, -3.0, 3000.0 * math.pi / 30.0], rtol=1e-6)
    t.clear_expired_signals(1.2)  # nothing follows: the last row is finished all the same
    assert len(t.history) == 2


def test_a_message_that_comes_late_is_passed_over():
    t = told(attitude(1000, 0.1), attitude(1020, 0.3), attitude(1010, 0.2), attitude(1030, 0.4))
    times, values = t.history.rows_since(0.0, ["estimated_attitude_yaw"])
    np.testing.assert_allclose(times, [1.0, 1.02])
    np.testing.assert_allclose(values[:, 0], [0.1, 0.3], rtol=1e-6)


@pytest.mark.parametrize("factor", [1.0, 0.95, 0.3, 2.0])
def test_a_clock_that_goes_slow_is_measured_through_a_link_that_delays(factor):
    """Packets take from 20 to 220 ms, at random, and one in three is lost."""
    random, t, sent_s = (
        np.random.default_rng(1),
        VehicleTelemetry(SignalHistory(seconds=1.0)),
        np.arange(0.0, 20.0, 0.02),
    )
    due = sorted((s + 0.02 + 0.2 * random.random(), s) for s in sent_s if random.random() < 2 / 3)
    for now_s, s in due:
        t.handle_message(now_s, sent(attitude(round(5000 + 1000 * factor * s))))
        known = t.real_time_factor(now_s)
        if now_s < 4.0:
            assert math.isnan(known)
        elif now_s > 7.0:
            assert known == pytest.approx(factor, abs=0.03)
    assert math.isnan(t.real_time_factor(30.0))  # it is not heard any more
    # What the vehicle tells itself goes before, while it tells.
    assert t.slip_count is None
    t.handle_message(20.3, sent(mavlink.MAVLink_named_value_float_message(1, b"rtfactor", 0.19)))
    t.handle_message(20.3, sent(mavlink.MAVLink_named_value_int_message(1, b"slips", 3)))
    assert t.slip_count == 3
    assert t.real_time_factor(20.4) == pytest.approx(0.19)
    assert math.isnan(t.real_time_factor(30.0))


def test_a_clock_is_measured_anew_after_a_restart():
    t = VehicleTelemetry(SignalHistory(seconds=1.0))
    for k in range(1000):
        t.handle_message(0.02 * k, sent(attitude(100_000 + 20 * k)))
    assert t.real_time_factor(20.0) == pytest.approx(1.0)
    for k in range(1000):
        t.handle_message(50.0 + 0.02 * k, sent(attitude(100 + 10 * k)))
        assert k > 500 or not t.real_time_factor(50.0 + 0.02 * k) > 0.6
    assert t.clock.restart_count == 1
    assert t.real_time_factor(70.0) == pytest.approx(0.5, abs=0.01)


def test_a_vehicle_is_started_anew_when_three_stamps_go_on_from_its_beginning():
    clock = MonotonicVehicleClock()
    assert clock.to_monotonic_time(100_000, 50.0) == 100.0
    assert math.isnan(clock.to_monotonic_time(1_000, 60.0))
    assert math.isnan(clock.to_monotonic_time(1_020, 60.02))  # two may be late, or damaged
    assert clock.restart_count == 0
    assert clock.to_monotonic_time(1_040, 60.04) == pytest.approx(100.0 + 10.04)
    assert clock.restart_count == 1
    assert clock.to_monotonic_time(2_040, 61.04) == pytest.approx(111.04)


def test_the_first_fix_is_the_origin_and_heights_are_above_home():
    t = VehicleTelemetry(SignalHistory(seconds=1.0))
    fix = [mavlink.MAVLink_global_position_int_message(k, 473769000, 85417000 + dx, 508_000, 10_000, 10, -20, 30, 0)
           for k, dx in ((1000, 0), (1020, 1000))]  # fmt: skip
    told(*fix, telemetry=t)
    assert t.origin.alt_m == pytest.approx(498.0)
    n, e, d = t.present_value("estimated_position")
    assert (n, d) == (pytest.approx(0.0, abs=1e-3), pytest.approx(-10.0, abs=1e-3))
    assert e == pytest.approx(7.54, abs=0.05)  # 1e-4 deg of longitude at 47.4 deg
    assert t.present_value("estimated_velocity") == pytest.approx([0.1, -0.2, 0.3])


def test_headings_are_carried_on_past_south():
    turns = np.linspace(0.0, 15.0, 100)
    t = VehicleTelemetry(SignalHistory(seconds=10.0))
    for k, angle in enumerate(turns):
        q = (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))
        told(
            attitude(1000 + 10 * k, math.remainder(angle, math.tau)),
            mavlink.MAVLink_attitude_target_message(1000 + 10 * k, 0, q, 0, 0, 0, 0),
            telemetry=t,
        )
    _, values = t.history.rows_since(0.0, ["estimated_attitude_yaw", "reference_attitude_yaw"])
    np.testing.assert_allclose(values, np.column_stack([turns, turns])[: len(values)], atol=1e-5)


def test_what_is_masked_out_of_a_reference_is_not_known():
    mask = 0b000011
    t = told(mavlink.MAVLink_position_target_local_ned_message(1000, 1, mask, 1, 2, -3, 4, 5, 6, 0, 0, 0, 0, 0))
    np.testing.assert_array_equal(t.present_value("reference_position"), [math.nan, math.nan, -3.0])
    np.testing.assert_array_equal(t.present_value("reference_velocity"), [4.0, 5.0, 6.0])


def test_what_is_not_told_any_more_is_not_known_any_more():
    t = told(attitude(1000), mavlink.MAVLink_raw_rpm_message(0, 3000.0))
    t.clear_expired_signals(1.0 + SIGNAL_TIMEOUT_S - 0.1)
    assert np.isfinite(t.present_value("estimated_attitude")).all()
    t.clear_expired_signals(1.0 + SIGNAL_TIMEOUT_S + 0.3)
    assert np.isnan(t.present_value("estimated_attitude")).all()
    assert np.isnan(t.present_value("measured_rotor_speed")).all()


def test_a_ring_of_beams_from_the_nose_and_from_north():
    distances = [100, 401, 65535, 50] + [65535] * 68
    body = mavlink.MAVLink_obstacle_distance_message(0, 0, distances, 90, 10, 400, 90.0, 45.0, 12)
    t = told(body)
    np.testing.assert_array_equal(t.ranges.distances_m, [1.0, 4.0, math.nan, 0.5])
    np.testing.assert_allclose(t.ranges.angles_rad, np.radians([45.0, 135.0, 225.0, 315.0]))
    assert t.ranges.max_range_m == 4.0
    north = mavlink.MAVLink_obstacle_distance_message(0, 0, distances, 90, 10, 400, 90.0, 45.0, 0)
    t = told(attitude(1000, math.radians(30.0)), north)
    np.testing.assert_allclose(t.ranges.angles_rad, np.radians([15.0, 105.0, 195.0, 285.0]), atol=1e-6)


def test_eight_distance_sensors_make_a_ring():
    t = VehicleTelemetry(SignalHistory(seconds=1.0))
    for k in (0, 2, 4):
        told(mavlink.MAVLink_distance_sensor_message(0, 10, 400, 100 + k, 0, k, k, 0), telemetry=t)
    np.testing.assert_array_equal(t.ranges.distances_m[[0, 2, 4]], [1.0, 1.02, 1.04])
    assert np.isnan(t.ranges.distances_m[[1, 3, 5, 6, 7]]).all()


def test_a_place_on_the_globe_becomes_metres_from_the_first_fix():
    def fix(boot_ms, lat, lon, alt):
        at = (round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), round((alt - 400.0) * 1e3))
        return mavlink.MAVLink_global_position_int_message(boot_ms, *at, 100, -50, 25, 0)

    t = told(fix(1000, 47.0, 8.0, 400.0), fix(1100, 47.0009, 8.0009, 410.0))
    n, e, d = t.present_value("estimated_position")
    # At 47 degrees on WGS 84 a degree of latitude is 111.17 km, one of longitude 76.05 km; 400 m up a little more.
    assert n == pytest.approx(100.06, abs=0.02)
    assert e == pytest.approx(68.45, abs=0.02)
    assert d == pytest.approx(-10.0)
    np.testing.assert_allclose(t.present_value("estimated_velocity"), [1.0, -0.5, 0.25])


def test_metres_that_the_vehicle_tells_are_preferred_to_the_globe():
    t = told(
        mavlink.MAVLink_local_position_ned_message(1000, 1.0, 2.0, -3.0, 0, 0, 0),
        mavlink.MAVLink_global_position_int_message(1000, 470000000, 80000000, 0, 0, 0, 0, 0, 0),
    )
    assert t.present_value("estimated_position").tolist() == [1.0, 2.0, -3.0]


def test_batteries_say_what_they_know():
    t = told(mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 7400, 320, 81, 0, 0, 0, 0, 0, 0))
    assert [float(t.present_value(f"battery_{k}")[0]) for k in ("voltage", "current", "charge")] == [
        7.4,
        3.2,
        0.81,
    ]
    cells = [3700, 3600] + [65535] * 8
    message = mavlink.MAVLink_battery_status_message(0, 0, 0, 0, cells, -1, 0, 0, -1, 300)
    told(message, telemetry=t)
    assert float(t.present_value("battery_voltage")[0]) == 7.3
    assert np.isnan(t.present_value("battery_current")[0])
    assert t.battery_left_s == 300.0


def test_only_the_battery_that_flies_it_counts_and_cells_beyond_ten_do_too():
    def battery(number, ext=(0,) * 4):
        return mavlink.MAVLink_battery_status_message(
            number, 0, 0, 0, [4000] * 10, 250, 0, 0, 55, 0, voltages_ext=list(ext)
        )

    t = told(battery(1))
    assert np.isnan(t.present_value("battery_voltage")[0])
    told(battery(0, (3900, 3800, 0, 0)), telemetry=t)
    assert float(t.present_value("battery_voltage")[0]) == pytest.approx(47.7)
    assert float(t.present_value("battery_charge")[0]) == 0.55
    assert float(t.present_value("battery_current")[0]) == 2.5
    assert math.isnan(t.battery_left_s)  # 0: it does not know
    unknown = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 65535, -1, -1, 0, 0, 0, 0, 0, 0)
    t = told(unknown)
    assert np.isnan([float(t.present_value(f"battery_{k}")[0]) for k in ("voltage", "current", "charge")]).all()


@pytest.mark.parametrize("angles", [(0.3, -0.4, 1.1), (-1.0, 0.7, -2.5), (0.0, 0.0, 0.0)])
def test_a_quaternion_is_the_rotation_of_its_angles(angles):
    from mufly.dynamics import quaternion_from_euler

    q = quaternion_from_euler(*angles)
    for size in (1.0, 0.8, 1.6):  # a filter of single precision lets it grow
        t = told(mavlink.MAVLink_attitude_quaternion_message(1000, *(size * q), 0.1, 0.2, 0.3))
        assert t.present_value("estimated_attitude") == pytest.approx(angles, abs=1e-6)
        assert t.present_value("estimated_rates") == pytest.approx([0.1, 0.2, 0.3])
        told(mavlink.MAVLink_attitude_target_message(1000, 0, list(size * q), 0, 0, 0, 0), telemetry=t)
        assert t.present_value("reference_attitude") == pytest.approx(angles, abs=1e-6)
    told(mavlink.MAVLink_attitude_target_message(1010, 128, list(q), 0, 0, 0, 0), telemetry=t)
    assert np.isnan(t.present_value("reference_attitude")).all()
    none = told(mavlink.MAVLink_attitude_quaternion_message(1000, 0, 0, 0, 0, 0, 0, 0))
    assert np.isnan(none.present_value("estimated_attitude")).all()


def test_where_north_east_and_down_are_0_is_what_the_vehicle_says_and_no_place_that_is_none():
    def place(boot_ms, lat, lon):
        return mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, 500_000, 10_000, 0, 0, 0, 0)

    def home(lat):
        return mavlink.MAVLink_home_position_message(lat, 80000000, 490_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)

    t = told(place(1000, 0, 0), place(1010, 910000000, 0), place(1020, 1, 1900000000), home(910000000))
    assert t.origin is None
    assert np.isnan(t.present_value("estimated_position")).all()
    told(home(470000000), telemetry=t)  # better than the first fix
    told(home(480000000), telemetry=t)  # which does not move because it took off elsewhere
    assert (t.origin.lat_deg, t.origin.lon_deg, t.origin.alt_m) == (47.0, 8.0, 490.0)
    told(place(1100, 470000000, 80000000), telemetry=t)
    assert t.present_value("estimated_position") == pytest.approx([0.0, 0.0, -10.0])
    told(mavlink.MAVLink_gps_global_origin_message(-455000000, 91000000, 480_000), telemetry=t)
    assert (t.origin.lat_deg, t.origin.lon_deg, t.origin.alt_m) == (-45.5, 9.1, 480.0)


def test_outputs_are_ours_only_where_their_order_is_known():
    def outputs(kind, active=4):
        values = [0.1, 0.2, -0.3, 0.4] + [0.0] * 28
        return told(
            mavlink.MAVLink_heartbeat_message(kind, 12, 1, 0, 4, 3),
            mavlink.MAVLink_actuator_output_status_message(1_000_000, active, values),
        )

    t = outputs(3)
    assert t.present_value("motor_input") == pytest.approx([0.1, 0.2])
    assert t.present_value("servo_input") == pytest.approx([-0.3, 0.4])
    for other in (outputs(2), outputs(3, active=3)):
        assert np.isnan(other.present_value("motor_input")).all()
    pulses = (1250, 0, *[1500] * 6)
    for port, expected in ((0, [0.25, math.nan]), (1, [math.nan] * 2)):
        t = told(mavlink.MAVLink_servo_output_raw_message(0, port, *pulses))
        np.testing.assert_allclose(t.present_value("motor_input"), expected)
    rpm = told(*(mavlink.MAVLink_raw_rpm_message(k, 60.0 * (k + 1)) for k in range(3)))
    assert rpm.present_value("measured_rotor_speed") == pytest.approx([math.tau, 2 * math.tau])
    sticks = told(mavlink.MAVLink_rc_channels_message(1000, 4, *[1500, 65535], *[1600] * 16, 255))
    np.testing.assert_allclose(sticks.present_value("pilot_input")[:3], [1500, math.nan, 1600])


def test_whether_it_flies_is_what_it_says_or_else_what_its_height_tells():
    def at(down, armed=True):
        return told(
            mavlink.MAVLink_heartbeat_message(3, 12, 1 | armed << 7, 0, 4, 3),
            mavlink.MAVLink_local_position_ned_message(1000, 0, 0, down, 0, 0, 0),
        )

    assert [at(d).is_flying for d in (0.0, -0.05, -0.2)] == [False, False, True]
    assert not at(-2.0, armed=False).is_flying  # it stands on a table
    for landed, flying in ((1, False), (2, True), (3, True), (4, True)):
        t = told(mavlink.MAVLink_extended_sys_state_message(0, landed), telemetry=at(-2.0 if landed == 1 else 0.0))
        assert t.is_flying is flying


def test_a_state_of_its_own_is_believed_while_it_is_told():
    beat = mavlink.MAVLink_heartbeat_message(3, 12, 129, 4 << 16 | 3 << 24, 4, 3)
    t = told(beat, mavlink.MAVLink_named_value_int_message(0, b"mstate", 99))
    assert t.mission_state_or_mode == "state 99"  # of a later version
    told(beat, telemetry=t, now_s=3.5)
    assert t.mission_state_or_mode == "state 99"
    told(beat, telemetry=t, now_s=4.5)
    assert t.mission_state_or_mode == "hold"


def test_the_truth_is_taken_apart():
    values = [float(k) for k in range(17)] + [0.0] * 41
    t = told(mavlink.MAVLink_debug_float_array_message(0, b"truth", 0, values))
    assert t.present_value("truth_velocity").tolist() == [3.0, 4.0, 5.0]
    assert t.present_value("truth_rotor_speed").tolist() == [12.0, 13.0]
    assert t.present_value("wind").tolist() == [14.0, 15.0, 16.0]
    assert t.is_simulated


def test_states_and_modes_are_told_in_words():
    t = told(mavlink.MAVLink_heartbeat_message(3, 12, 129, 4 << 16 | 4 << 24, 4, 3))
    assert (t.mission_state_or_mode, t.armed) == ("mission", True)
    told(mavlink.MAVLink_named_value_int_message(0, b"mstate", MISSION_STATES.index("hover")), telemetry=t)
    assert t.mission_state_or_mode == "hover"
    assert flight_mode_name(3, 4, 1, 4) == "guided"
    assert flight_mode_name(3, 4, 0, 4) == ""
    assert flight_mode_name(12, 2, 1, 3 << 16) == "position control"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3e38])
def test_absurd_numbers_raise_nothing(value):
    with np.errstate(all="raise"):
        t = told(
            mavlink.MAVLink_attitude_message(1000, value, value, value, value, value, value),
            mavlink.MAVLink_attitude_target_message(1000, 0, [value] * 4, 0, 0, 0, 0),
            mavlink.MAVLink_obstacle_distance_message(0, 0, [0] * 72, 0, 0, 0, value, value, 0),
            mavlink.MAVLink_raw_rpm_message(0, value),
            mavlink.MAVLink_debug_float_array_message(0, b"truth", 0, [value] * 58),
            attitude(1010),
        )
    assert len(t.history) == 1


# The clock


def test_the_clock_goes_on_over_a_wrap():
    clock, wrap = MonotonicVehicleClock(), 2**32
    times = [clock.to_monotonic_time((wrap - 50 + 10 * k) % wrap, 0.01 * k) for k in range(20)]
    np.testing.assert_allclose(np.diff(times), 0.01, atol=1e-6)
    assert clock.to_monotonic_time(wrap - 10, 0.2) == pytest.approx(times[4], abs=1e-6)  # from before it, late
    assert clock.restart_count == 0


@pytest.mark.parametrize("uptime_s", [10.0, 1e6, 3e6])
def test_the_clock_goes_on_over_a_restart(uptime_s):
    clock = MonotonicVehicleClock()
    clock.to_monotonic_time(round(uptime_s * 1e3), 100.0)
    placed = [clock.to_monotonic_time(round(1e3 * t), 103.0 + t) for t in (0.1, 0.12, 0.14, 0.16)]
    assert clock.restart_count == 1
    assert math.isnan(placed[0])
    assert placed[3] == pytest.approx(uptime_s + 3.16, abs=0.1)


def test_one_stamp_that_is_far_behind_is_no_restart():
    clock = MonotonicVehicleClock()
    for k in range(5):
        clock.to_monotonic_time(10_000 + 10 * k, 0.01 * k)
        assert math.isnan(clock.to_monotonic_time(500, 0.01 * k))
    assert clock.restart_count == 0


# Texts


def text(content, number=0, chunk=0):
    return sent(mavlink.MAVLink_statustext_message(4, content, number, chunk))


def test_a_long_text_is_put_together_in_any_order():
    texts, words = (
        StatusTextLog(),
        b"a text that is so long that it comes in more than one piece, and then some more",
    )
    texts.handle_status_text(1.0, 5.0, text(words[50:], 7, 1))
    assert not texts.messages
    texts.handle_status_text(1.0, 5.0, text(words[:50], 7, 0))
    assert texts.messages[-1].text == words.decode()
    assert (texts.messages[-1].level, texts.messages[-1].time_s) == ("warning", 5.0)


def test_a_text_whose_piece_was_lost_is_told_with_a_gap():
    texts = StatusTextLog()
    texts.handle_status_text(1.0, 5.0, text(b"the end", 7, 1))
    texts.add_overdue_texts(4.0, 8.0)
    assert texts.messages[-1].text == "...the end"


def test_messages_are_bounded():
    texts = StatusTextLog()
    for k in range(2000):
        texts.handle_status_text(1.0, 5.0, text(b"x" * 50, 1 + k % 65535, 0))
        texts.handle_status_text(1.0, 5.0, text(b"%d" % k))
    assert len(texts.messages) == 500
    assert len(texts._pieces._waiting) <= 8
