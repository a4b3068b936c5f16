"""A companion that sees where the vehicle is, against the vehicle: what it hears, and what it tells."""

import math

import numpy as np
import pytest
from link_rig import Rig

from mufly.link.codec import FrameEncoder, mavlink
from mufly.link.companion import VisionCompanion
from mufly.slam import TrackingResult


def test_it_hears_tilt_and_height_and_the_vehicle_takes_its_places() -> None:
    """Both on clocks of their own; what one says reaches the other after 20 ms."""
    rig = Rig(sensors="fitted", seed=4, outside=True)
    companion, late_s = VisionCompanion(), 0.02

    def ours() -> float:
        return rig.now_s + 1.7e9

    there, back, due_s = [], [], 0.0
    rig.link.add_peer(rig.now_s, "slam")
    while rig.flight.time_s < 4.0:
        now_s = ours()
        there += [(now_s + late_s, data) for data in companion.take_due_messages(now_s)]
        if now_s >= due_s and companion.frame_info_at(now_s - 0.1) is not None:
            due_s = now_s + 0.05
            t = rig.flight.truth
            answer = TrackingResult(now_s, True, "", t.position.copy(), float(t.attitude[2]), 1e-4 * np.eye(4))
            there.append((now_s + late_s, companion.encode_position(answer)))
            assert companion.encode_position(TrackingResult(now_s, False, "lost")) is None
        while there and there[0][0] <= now_s:
            rig.link.process_bytes(rig.now_s, "slam", there.pop(0)[1])
        rig.flight.step_period()
        back += [(now_s + late_s, out.data) for out in rig.link.take_due_frames(rig.now_s) if out.peer == "slam"]
        while back and back[0][0] <= now_s:
            companion.process_bytes(now_s, back.pop(0)[1])
        rig.now_s += rig.flight.period_s
    assert companion.system == 1
    assert companion.clock_offset_s == pytest.approx(rig.flight.time_s - ours(), abs=0.006)
    told = companion.frame_info_at(ours() - 0.1)
    truth = rig.flight.truth
    assert (told.roll, told.pitch) == pytest.approx(tuple(truth.attitude[:2]), abs=0.02)
    assert told.height_m == pytest.approx(-truth.position[2], abs=0.03)
    assert told.place == pytest.approx([*truth.position[:2], truth.attitude[2]], abs=0.05)
    assert told.velocity == pytest.approx(truth.velocity, abs=0.05)
    assert 0.0 < told.place_sigma[0] < 0.1
    stood = companion.stationary_result(1.0, told)
    assert stood.trusted
    assert np.append(stood.position, stood.heading) == pytest.approx(
        np.append(truth.position, truth.attitude[2]), abs=0.1
    )
    fix = rig.flight.readings["position_fix"]
    assert 0.0 < rig.flight.time_s - fix.time_s < 0.09
    assert np.diag(fix.covariance) == pytest.approx([1e-4] * 4, rel=1e-6)
    assert not rig.flight.autopilot.list_arming_faults()


def test_what_is_old_or_of_another_is_not_told() -> None:
    companion, encode, other = VisionCompanion(), FrameEncoder(1, 1), FrameEncoder(7, 1)
    beat = mavlink.MAVLink_heartbeat_message(3, 12, 0, 0, 4, 3)
    assert companion.take_due_messages(0.0) == []
    assert companion.frame_info_at(0.0) is None
    companion.process_bytes(0.0, encode(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    assert companion.system is None  # a station is no vehicle
    companion.process_bytes(0.0, encode(beat))
    assert len(companion.take_due_messages(0.0)) == 5
    for k in range(20):
        now_s = 0.05 * k
        for source, roll in ((encode, 0.1), (other, 0.5)):
            message = mavlink.MAVLink_attitude_message(round(1000 * now_s) + 500, roll, 0.0, 0.0, 0.0, 0.0, 0.0)
            companion.process_bytes(now_s, source(message))
        height = mavlink.MAVLink_distance_sensor_message(round(1000 * now_s) + 500, 2, 300, 120, 0, 0, 25, 0)
        companion.process_bytes(now_s, encode(height))
    assert companion.clock_offset_s == pytest.approx(0.5)
    told = companion.frame_info_at(0.8)
    assert (told.roll, told.height_m) == pytest.approx((0.1, 1.2))
    assert companion.frame_info_at(1.6) is None
    assert companion.frame_info_at(-1.0) is None
    companion.process_bytes(1.0, encode(mavlink.MAVLink_raw_rpm_message(1, -4200.0)))
    assert companion.frame_info_at(0.8).rotor_speed == pytest.approx([0.0, 2 * math.pi * 70])
    lost = TrackingResult(0.8, True, "", np.zeros(3), math.nan, np.eye(4))
    assert companion.encode_position(lost) is not None


def test_a_clock_that_is_set_is_followed() -> None:
    """A vehicle that is simulated gives up time where its machine is too slow."""
    companion, encode = VisionCompanion(), FrameEncoder(1, 1)
    companion.process_bytes(0.0, encode(mavlink.MAVLink_heartbeat_message(3, 12, 0, 0, 4, 3)))
    for k, (theirs_s, way_s) in enumerate(((7.0, 0.004), (7.0, 0.04), (6.0, 0.05), (6.0, 0.03))):
        sent_s = 1.0 + k
        there_s = sent_s + 0.5 * way_s + theirs_s
        message = mavlink.MAVLink_timesync_message(round(1e9 * there_s), round(1e9 * sent_s))
        companion.process_bytes(sent_s + way_s, encode(message))
        assert companion.clock_offset_s == pytest.approx(theirs_s, abs=1e-6)
