"""Telemetry of several speakers: whose signals they are, on whose clock, and in which order."""

import struct

import numpy as np
import pytest

from mufly.logs import read_raw_log

BEGIN_US = 1_700_000_000_000_000


class Speaker:
    """One component on one link: it numbers its packets."""

    def __init__(self, mavlink, system=1, component=1, version=2, key=None):
        self.mavlink, self.version = mavlink, version
        self.link = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        if key:
            self.link.signing.secret_key = key
            self.link.signing.sign_outgoing = True
            self.link.signing.link_id = 1

    def __call__(self, message):
        version = 1 + self.link.seq % 2 if self.version == "both" else self.version
        packet = message.pack(self.link, force_mavlink1=version == 1)
        self.link.seq = (self.link.seq + 1) % 256
        return bytes(packet)

    def attitude(self, clock_s, roll=0.1):
        return self(self.mavlink.MAVLink_attitude_message(round(1e3 * clock_s), roll, 0, 0, 0, 0, 0))

    def heartbeat(self, kind=2, autopilot=3):
        return self(self.mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3))

    def image(self, clock_s, index=0):
        return self(
            self.mavlink.MAVLink_camera_image_captured_message(
                round(1e3 * clock_s), 0, 0, 0, 0, 0, 0, [1.0, 0.0, 0.0, 0.0], index, 1, b""
            )
        )


@pytest.fixture
def read(tmp_path):
    """Read packets, each with the time of its arrival (s), in the order of the list."""

    def reading(packets):
        path = tmp_path / "link.tlog"
        path.write_bytes(b"".join(struct.pack(">Q", BEGIN_US + round(1e6 * t)) + p for t, p in packets))
        return read_raw_log(path)

    return reading


def flight(vehicle, until_s=20.0, begin_s=0.0, boot_s=-5.0, step_s=0.1, beats=True):
    """Attitude at 10 Hz of a vehicle that started at ``boot_s``; roll tells the time at which it was sent."""
    out = []
    for k in range(round((until_s - begin_s) / step_s)):
        t = begin_s + step_s * k
        out.append((t, vehicle.attitude(t - boot_s, 1e-3 * t)))
        if beats and k % 10 == 0:
            out.append((t, vehicle.heartbeat()))
    return out


def in_order(packets):
    return sorted(packets, key=lambda p: p[0])


def sent_at(raw, topic="ATTITUDE"):
    """Whether every row stands at the time at which it was sent (ms)."""
    table = raw[topic]
    return table.time == pytest.approx(1e3 * table.fields["roll"], abs=2e-3)


def test_a_camera_with_a_clock_of_its_own_moves_nothing(read, mavlink):
    vehicle, camera = Speaker(mavlink), Speaker(mavlink, component=100)
    packets = flight(vehicle)
    packets += [(t, camera.heartbeat(30, 8)) for t in range(20)]
    packets += [(t + 0.05, camera.image(t + 300.0, t)) for t in range(0, 20, 2)]
    raw = read(in_order(packets))
    assert sent_at(raw)
    assert raw.notes == ()
    assert raw["CAMERA_IMAGE_CAPTURED@1.100"].time == pytest.approx(np.arange(0, 20, 2) + 0.05)
    # A clock that counts since 1970, as cameras with a GPS have it.
    stamp = [self_s * 1e6 + 1.6e15 for self_s in range(20)]
    packets = flight(vehicle) + [
        (t + 0.3 * (t % 3 > 0), camera(mavlink.MAVLink_raw_imu_message(int(stamp[t]), *[1] * 9))) for t in range(20)
    ]
    raw = read(in_order(packets))
    assert sent_at(raw)
    assert raw.notes == ()
    assert np.diff(raw["RAW_IMU@1.100"].time) == pytest.approx(1.0)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("late_s", [0.3, 1.2, 4.0])
def test_packets_that_come_late_are_no_start(read, mavlink, version, late_s):
    vehicle = Speaker(mavlink, version=version)
    packets = flight(vehicle, boot_s=-0.5)  # the log begins with the vehicle
    late = {33, 60, 61, 62, 130}
    packets = in_order([(t + late_s * (k in late), p) for k, (t, p) in enumerate(packets)])
    raw = read(packets)
    assert sent_at(raw)
    assert (np.diff(raw["ATTITUDE"].time) > 0).all()
    assert len(raw.notes) == 1
    assert "packets arrived out of order" in raw.notes[0]


def test_what_has_no_clock_is_put_in_order_by_its_number(read, mavlink):
    vehicle = Speaker(mavlink)
    packets = []
    for k in range(300):
        status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 7000 + k, 210, 80, 0, 0, 0, 0, 0, 0)
        packets.append((0.1 * k + 1.5 * (k in (100, 250)), vehicle(status)))
    raw = read(in_order(packets))
    assert (np.diff(raw["SYS_STATUS"].fields["voltage_battery"]) > 0).all()
    assert raw["SYS_STATUS"].time == pytest.approx(0.1 * np.arange(300), abs=0.11)


@pytest.mark.parametrize("beats", [True, False])
@pytest.mark.parametrize(
    ("kind", "autopilot", "component"), [(18, 0, 191), (18, 3, 192), (26, 0, 154), (30, 0, 100), (36, 0, 180)]
)
def test_equipment_is_never_the_vehicle(read, mavlink, kind, autopilot, component, beats):
    vehicle, other = Speaker(mavlink), Speaker(mavlink, component=component)
    packets = [(0.2 * k - 2.0, other.heartbeat(kind, autopilot)) for k in range(110)]
    packets += [(0.05 * k, other.attitude(900 + 0.05 * k, 2.0)) for k in range(400)]
    packets += flight(vehicle, beats=beats)
    raw = read(in_order(packets))
    assert raw["ATTITUDE"].fields["roll"].max() < 0.1
    assert raw["ATTITUDE"].time[0] == pytest.approx(2.0)
    assert raw.info["system"].endswith("system 1.1")
    assert raw.notes == ()


def test_a_tracker_heard_longer_is_not_the_vehicle_and_alone_is_named(read, mavlink):
    tracker = Speaker(mavlink, system=2)
    packets = [(t, tracker.heartbeat(5, 3)) for t in range(60)]
    packets += [(t + 0.5, tracker.attitude(t + 7.0, 1.0)) for t in range(60)]
    raw = read(in_order(packets + flight(Speaker(mavlink), 30.0, 20.0)))
    assert raw.info["system"] == "quadrotor, ardupilotmega, system 1.1"
    assert raw["ATTITUDE"].fields["roll"].max() < 0.1
    raw = read(in_order(packets))
    assert raw["ATTITUDE"].fields["roll"].min() == 1.0
    assert raw.notes == ("the log holds no vehicle; the signals are those of the antenna tracker 2.1",)


def test_of_several_vehicles_the_choice_is_told(read, mavlink):
    a, b = Speaker(mavlink, system=3), Speaker(mavlink, system=4)
    raw = read(in_order(flight(a, 10.0) + flight(b, 20.0, boot_s=-700.0)))
    assert raw.info["system"].endswith("system 4.1")
    assert sent_at(raw)
    assert sent_at(raw, "ATTITUDE@3.1")
    assert len(raw.notes) == 1
    assert "the log holds several vehicles" in raw.notes[0]
    assert "quadrotor 3.1" in raw.notes[0]


def test_a_companion_with_the_vehicles_numbers_is_not_its_type(read, mavlink):
    vehicle, idle = Speaker(mavlink), Speaker(mavlink)
    auto = mavlink.MAVLink_heartbeat_message(2, 3, 129, 3, 4, 3)
    packets = flight(vehicle, beats=False) + [(t + 0.01, idle.heartbeat(18, 8)) for t in range(20)]
    packets += [(t - 0.01, vehicle(auto)) for t in range(20)]
    raw = read(in_order(packets))
    assert raw.info["system"] == "quadrotor, ardupilotmega, system 1.1"
    assert set(raw["HEARTBEAT"].fields["mode"]) == {"auto"}


@pytest.mark.parametrize("same_numbers", [True, False])
def test_what_comes_by_two_links_is_there_once(read, mavlink, same_numbers):
    vehicle = Speaker(mavlink)
    first = flight(vehicle)
    vehicle.link.seq = 0 if same_numbers else 77
    second = [(t + 0.03 + 0.3 * (k % 7 == 0), p) for k, (t, p) in enumerate(flight(vehicle))]
    raw = read(in_order(first + second))
    assert len(raw["ATTITUDE"].time) == 200
    assert sent_at(raw)
    assert not [n for n in raw.notes if "anew" in n]
    assert any("duplicate packets" in n for n in raw.notes)


def test_lost_packets_both_versions_and_signatures_make_no_start(read, mavlink):
    vehicle = Speaker(mavlink, version="both", key=bytes(range(32)))
    rng = np.random.default_rng(2)
    packets = [
        (t, p)
        for t, p in flight(vehicle, 60.0, step_s=0.02)
        if t == 0.0 or (rng.random() > 0.4 and not 10.0 < t < 17.0)  # and an outage of 350 packets
    ]
    raw = read(packets)
    assert sent_at(raw)
    assert raw.notes == ()
    # Old and new packets of a router that forwards both.
    old, new = Speaker(mavlink, version=1), Speaker(mavlink, version=2)
    raw = read(in_order(flight(old, 20.0) + flight(new, 20.05, 0.05)))
    assert len(raw["ATTITUDE"].time) == 400
    assert sent_at(raw)
    assert raw.notes == ()


@pytest.mark.parametrize("silence_s", [0.3, 12.0])
def test_a_start_of_the_vehicle_is_its_own_while_the_camera_goes_on(read, mavlink, silence_s):
    vehicle, camera = Speaker(mavlink), Speaker(mavlink, component=100)
    before = flight(vehicle, 20.0, boot_s=-5.0)
    vehicle.link.seq = 0
    again = 20.0 + silence_s
    after = flight(vehicle, 60.0, again, boot_s=again - min(1.5, silence_s) if silence_s < 1 else again - 11.0)
    # One packet of the first run is late over the start.
    _, last = before.pop()
    packets = [*before, (again + 0.25, last), *after]
    packets += [(t + 0.02, camera.image(t + 900.0, t)) for t in range(60)]
    raw = read(in_order(packets))
    assert sent_at(raw)
    starts = [n for n in raw.notes if "anew" in n]
    assert len(starts) == 1
    assert starts[0].startswith(f"the vehicle started anew at {again:.0f} s")
    assert raw["CAMERA_IMAGE_CAPTURED@1.100"].time == pytest.approx(np.arange(60) + 0.02)


def test_a_clock_that_is_set_back_is_tied_anew_and_is_no_start(read, mavlink):
    vehicle = Speaker(mavlink)
    raw = read(flight(vehicle, 20.0, boot_s=-500.0) + flight(vehicle, 40.0, 20.0, boot_s=-400.0))
    assert sent_at(raw)
    assert "the vehicle had its clock set back at 20 s" in raw.notes[0]


def test_packets_stored_over_an_outage_and_sent_afterwards_are_no_start(read, mavlink):
    packets = flight(Speaker(mavlink), 60.0)
    out = []
    for k, (t, p) in enumerate(packets):
        stored = 20.0 <= t < 30.0
        out.append((32.0 + 0.4 * (t - 20.0) + 1e-4 * k if stored else t, p))
    raw = read(in_order(out))
    assert sent_at(raw)
    assert not [n for n in raw.notes if "anew" in n or "set back" in n]


@pytest.mark.parametrize("by_s", [3600.0, 30.0, -3600.0, -30.0])
def test_a_recording_computer_whose_clock_is_set_does_not_move_the_flight(read, mavlink, by_s):
    vehicle, camera = Speaker(mavlink), Speaker(mavlink, component=100)
    packets = flight(vehicle) + [(t + 0.05, camera.heartbeat(30, 8)) for t in range(20)]
    raw = read([(t + by_s * (t > 12.0), p) for t, p in in_order(packets)])
    assert sent_at(raw)
    assert raw["HEARTBEAT@1.100"].time == pytest.approx(np.arange(20) + 0.05, abs=0.11)
    assert len(raw.notes) == 1
    assert ("jumps by" if by_s > 0 else "was set back once") in raw.notes[0]
    assert raw.start_time.startswith("2023-11-14T22:13:20")


def test_single_times_of_arrival_out_of_line_are_mended(read, mavlink):
    packets = flight(Speaker(mavlink))
    raw = read([(t + {50: 7200.0, 120: -400.0}.get(k, 0.0), p) for k, (t, p) in enumerate(packets)])
    assert sent_at(raw)
    assert "2 packets have a time of arrival far from" in raw.notes[0]


def test_a_clock_of_32_bits_wraps_after_49_days(read, mavlink):
    vehicle = Speaker(mavlink)
    packets = []
    for k in range(200):
        t = 0.1 * k
        clock_ms = (2**32 - 9_950 + 100 * k) % 2**32
        message = mavlink.MAVLink_attitude_message(clock_ms, 1e-3 * t, 0, 0, 0, 0, 0)
        packets.append((t + 0.5 * (k == 97), vehicle(message)))
    raw = read(in_order(packets))
    assert sent_at(raw)
    assert len(raw.notes) == 1
    assert "arrived out of order" in raw.notes[0]


def test_parameters_belong_to_their_component_and_px4s_whole_numbers_are_whole(read, mavlink):
    vehicle, gimbal = Speaker(mavlink), Speaker(mavlink, component=154)
    whole = struct.unpack("<f", struct.pack("<i", -7))[0]

    def value(speaker, name, number, kind):
        return speaker(mavlink.MAVLink_param_value_message(name, number, kind, 2, 0))

    packets = [
        (0.0, vehicle.heartbeat(2, 12)),
        (0.1, value(vehicle, b"GAIN", 0.25, 9)),
        (0.2, value(gimbal, b"GAIN", 0.75, 9)),
        (0.3, value(vehicle, b"MODE", whole, 6)),
    ]
    raw = read(packets)
    assert raw.info["parameters"] == {"GAIN": 0.25, "MODE": -7.0}
    assert raw.info["parameters@1.154"] == {"GAIN": 0.75}
    packets[0] = (0.0, vehicle.heartbeat(2, 3))  # ArduPilot sends them as numbers
    packets[3] = (0.3, value(vehicle, b"MODE", -7.0, 6))
    assert read(packets).info["parameters"]["MODE"] == -7.0
