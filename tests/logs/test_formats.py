"""Other people's logs: made here by the published formats, and the PX4 sample where the measured data are at hand."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.logs import detect_log_format, read_log, read_raw_log
from mufly.logs.tlog import TlogWriter

SAMPLE = Path(__file__).resolve().parents[3] / "shared/data/flight/pyulog/sample.ulg"

TIME = np.arange(0, 4, 0.02)
ROLL, YAW = 10 * np.sin(2 * TIME), 350 + 20 * TIME  # deg; yaw passes north


def flight_log(dataflash, units=None):
    us = np.rint(1e6 * (5 + TIME)).astype(int).tolist()
    attitude = [(t, round(100 * r), round(100 * (y % 360)), 7.4) for t, r, y in zip(us, ROLL, YAW, strict=True)]
    gyro = [(t, k, 0.1 * (k + 1), 0.0, -0.2) for t in us[::2] for k in (0, 1)]
    said = [(us[0], b"ArduCopter V4.5"), (us[50], b"Arming motors")]
    gps = [(us[10], 3, 2300, 300_000_000)]
    return dataflash(
        [
            (10, "ATT", "QcHf", "TimeUS,Roll,Yaw,Aux", attitude),
            (11, "IMU", "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ", gyro),
            (12, "MSG", "QZ", "TimeUS,Message", said),
            (13, "GPS", "QBHI", "TimeUS,Status,GWk,GMS", gps),
        ],
        units,
    )


@pytest.fixture
def bin_file(tmp_path, make_dataflash):
    path = tmp_path / "00000001.xyz"
    units = {"labels": {"s": "s", "E": "rad/s", "#": "instance"}, "ids": {"IMU": "s#EEE"}}
    path.write_bytes(flight_log(make_dataflash, units))
    return path


def test_dataflash_is_told_by_content_and_unpacked(bin_file):
    raw = read_raw_log(bin_file)
    assert detect_log_format(bin_file) == "DataFlash"
    assert raw["ATT"].time == pytest.approx(TIME, abs=1e-6)
    assert raw["ATT"].fields["Roll"] == pytest.approx(np.round(ROLL, 2))  # letter c: hundredths
    assert raw.messages[1] == (1.0, "info", "Arming motors")
    assert raw.is_complete
    # Week 2300 and 300 000 s of GPS time, less 18 leap seconds and the 0.2 s since the start.
    assert raw.start_time == "2024-02-07T11:19:41.800+00:00"


def test_instances_become_topics_and_units_are_those_of_the_file(bin_file):
    raw = read_raw_log(bin_file)
    assert {"IMU", "IMU:1"} <= set(raw)
    assert raw["IMU:1"].fields["GyrX"] == pytest.approx(0.2)
    assert raw["IMU"].units["GyrX"] == "rad/s"


def test_multipliers_of_the_file_make_its_units(tmp_path, make_dataflash):
    path = tmp_path / "log"
    units = {
        "labels": {"v": "V", "A": "A", "#": "instance", "s": "s"},
        "factors": {"C": 1e-3, "B": 1e-2, "-": 0.0, "F": 1e-6, "X": 42.0},
        "ids": {"CURR": "svAv", "ODD": "#A-"},
        "multipliers": {"CURR": "FCBX"},
    }
    rows = [(20_000 * k, 15_740, 1250, 3) for k in range(50)]
    odd = [(20_000 * k, 7, 7) for k in range(50)]
    kinds = [(10, "CURR", "QHHH", "TimeUS,Volt,Curr,Res", rows), (11, "ODD", "QBB", "TimeUS,a,b", odd)]
    content = make_dataflash(kinds, units)
    path.write_bytes(content)
    raw = read_raw_log(path)
    assert raw["CURR"].units == {"Volt": "mV", "Curr": "cA"}  # a factor that no prefix names is none
    assert raw["ODD"].fields["b"].tolist() == [7] * 50  # a file that counts its clock as instances
    data = read_log(path)
    assert data.battery_voltage.values == pytest.approx(15.74)
    assert data.battery_current.values == pytest.approx(12.5)
    given = read_log(path, columns={"battery_voltage": "CURR/Volt(cV)"})  # the user knows better than the file
    assert given.battery_voltage.values == pytest.approx(157.4)
    middle = content.rindex(b"\xa3\x95\x0a", 0, len(content) // 2)
    path.write_bytes(content[:middle] + b"\x00\xa3\x01" + content[middle:])
    raw = read_raw_log(path)
    assert not raw.is_complete
    assert len(raw["CURR"].time) == 50  # what follows the damage is found again


def test_a_position_without_weeks_tells_no_wall_time(tmp_path, make_dataflash):
    path = tmp_path / "log"
    path.write_bytes(make_dataflash([(10, "GPS", "QB", "TimeUS,Status", [(k, 3) for k in range(20)])]))
    assert read_raw_log(path).start_time == ""


def test_every_field_is_what_pymavlinks_own_reader_gives(bin_file):
    from pymavlink.DFReader import DFReader_binary

    raw, theirs = read_raw_log(bin_file), {}
    reader = DFReader_binary(str(bin_file), zero_time_base=True)
    while (message := reader.recv_msg()) is not None:
        theirs.setdefault(message.get_type(), []).append(message.to_dict())
    for topic in ("ATT", "GPS"):
        for name, values in raw[topic].fields.items():
            assert values.tolist() == pytest.approx([m[name] for m in theirs[topic]]), name


def test_ardupilot_signals_have_our_names_and_units(bin_file):
    columns = {"signal": [{"name": "measured_attitude.roll", "topic": "ATT", "columns": ["Roll"], "unit": "deg"}]}
    data = read_log(bin_file, columns=columns)
    roll = data.measured_attitude.sel(angle="roll")
    assert np.nanmax(roll) == pytest.approx(np.radians(10), rel=1e-3)
    assert data.measured_rates.sel(rate="p").mean() == pytest.approx(0.1)
    assert data.measured_rates.attrs["source"] == "IMU/GyrX"


def test_yaw_that_passes_north_does_not_jump(tmp_path, make_dataflash):
    path = tmp_path / "log"
    us = np.rint(1e6 * TIME).astype(int).tolist()
    rows = [(t, round(100 * r), 0, round(100 * (y % 360))) for t, r, y in zip(us, ROLL, YAW, strict=True)]
    path.write_bytes(make_dataflash([(10, "ATT", "QccH", "TimeUS,Roll,Pitch,Yaw", rows)]))
    # H is an integer, so the yaw is in hundredths of a degree here; the map of the user says so.
    columns = {"measured_attitude.yaw": "ATT/Yaw(cdeg)"}
    yaw = read_log(path, columns=columns).measured_attitude.sel(angle="yaw").values
    assert np.abs(np.diff(yaw)).max() < 0.02
    assert yaw[-1] - yaw[0] == pytest.approx(np.radians(YAW[-1] - YAW[0]), abs=1e-3)


def test_a_dataflash_log_cut_off_loses_only_its_end(tmp_path, bin_file):
    path = tmp_path / "cut"
    whole = bin_file.read_bytes()
    path.write_bytes(whole[: int(0.9 * len(whole))])
    raw = read_raw_log(path)
    assert not raw.is_complete
    n = len(raw["ATT"].time)
    assert 0.7 * len(TIME) < n < len(TIME)
    assert raw["ATT"].fields["Roll"] == pytest.approx(np.round(ROLL, 2)[:n])


def test_the_text_form_of_dataflash(tmp_path):
    path = tmp_path / "flight.log"
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 10, 20, ATT, Qccf, TimeUS,Roll,Pitch,Yaw",
        "FMT, 11, 75, MSG, QZ, TimeUS,Message",
        "MSG, 1000000, Frame: QUAD, of sorts",
    ]
    lines += [f"ATT, {1000000 + 20000 * k}, {k}.5, -1.25, 90" for k in range(40)]
    path.write_text("\r\n".join(lines) + "\r\n")
    raw = read_raw_log(path)
    assert raw.format_name == "DataFlash"
    assert raw["ATT"].fields["Roll"][2] == 2.5
    assert raw.messages[0][2] == "Frame: QUAD, of sorts"
    attitude = read_log(path).measured_attitude
    assert attitude.sel(angle="pitch").values == pytest.approx(np.radians(-1.25))


def tlog(mavlink, *, reset_at=None, version=2, late=0.0):
    """A telemetry log of 20 s at 10 Hz: the link adds up to 80 ms, the vehicle's clock is right."""
    rng = np.random.default_rng(1)
    link = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
    ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    out, booted = b"", 100_000  # ms
    for k in range(200):
        sent_s = 0.1 * k
        if reset_at is not None and k == reset_at:
            booted = 500 - 100 * k
        stamp = int(1.7e15 + 1e6 * (sent_s + late + rng.uniform(0, 0.08) * (k % 5 != 0)))
        clock = booted + 100 * k
        messages = [(link, link.attitude_encode(clock, 0.1 * np.sin(sent_s), 0.05, 3.1, 0.0, 0.0, 0.0))]
        if k % 10 == 0:
            messages.append((link, link.heartbeat_encode(mavlink.MAV_TYPE_COAXIAL, 3, 0, 0, 0)))
            messages.append((ground, ground.heartbeat_encode(mavlink.MAV_TYPE_GCS, 8, 0, 0, 0)))
            messages.append((link, link.sys_status_encode(0, 0, 0, 0, 7400, 210, 80, 0, 0, 0, 0, 0, 0)))
        if k == 30:
            messages.append((link, link.statustext_encode(4, b"low battery")))
        for who, message in messages:
            out += struct.pack(">Q", stamp) + message.pack(who, force_mavlink1=version == 1)
    return out


def test_a_telemetry_log_on_its_way_to_the_disk_is_a_second_old_at_most(tmp_path, monkeypatch, mavlink):
    """What is behind when the process is killed; and not every packet is a call of the system."""
    now_s = 500.0
    monkeypatch.setattr("mufly.logs.tlog.time.monotonic", lambda: now_s)
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    packet = link.attitude_encode(5, 0.1, 0.2, 0.3, 0, 0, 0).pack(link)
    path = tmp_path / "link.tlog"
    log, kept = TlogWriter(path), []
    for _ in range(6):
        now_s += 0.4
        log.write_packet(packet, 1_700_000_000_000_000)
        kept.append(path.stat().st_size // (8 + len(packet)))
    log.close()
    assert kept == [0, 0, 3, 3, 3, 6]


@pytest.mark.parametrize("version", [1, 2])
def test_a_telemetry_log_has_the_vehicles_clock_not_the_links(tmp_path, mavlink, version):
    path = tmp_path / "flight"
    path.write_bytes(tlog(mavlink, version=version))
    raw = read_raw_log(path)
    assert raw.format_name == "MAVLink tlog"
    assert np.diff(raw["ATTITUDE"].time) == pytest.approx(0.1, abs=1e-6)
    assert "HEARTBEAT@255.190" in raw
    assert raw.messages[0][1:] == ("warning", "low battery")
    data = read_log(path)
    assert data.measured_attitude.sel(angle="roll").values[10] == pytest.approx(0.1 * np.sin(1.0), abs=1e-6)
    assert data.battery_voltage.attrs["units"] == "V"
    assert np.nanmean(data.battery_voltage) == pytest.approx(7.4)
    assert np.nanmean(data.battery_current) == pytest.approx(2.1)
    assert np.nanmean(data.battery_charge) == pytest.approx(0.8)


def test_a_vehicle_that_starts_anew_keeps_one_clock(tmp_path, mavlink):
    path = tmp_path / "flight"
    path.write_bytes(tlog(mavlink, reset_at=120))
    raw = read_raw_log(path)
    assert np.diff(raw["ATTITUDE"].time) == pytest.approx(0.1, abs=1e-3)
    assert "started anew at 12 s" in raw.notes[0]


def test_damaged_packets_are_left_out_and_counted(tmp_path, mavlink):
    path = tmp_path / "flight"
    whole = bytearray(tlog(mavlink))
    whole[30] ^= 0xFF  # inside the first attitude
    middle = len(whole) // 2
    path.write_bytes(whole[:middle] + b"\x00\x01\x02" + whole[middle:])
    raw = read_raw_log(path)
    assert not raw.is_complete
    assert "damaged or unknown" in raw.notes[0]
    assert 195 < len(raw["ATTITUDE"].time) < 200


needs_sample = pytest.mark.skipif(not SAMPLE.exists(), reason="the measured data are not beside the project")


@needs_sample
def test_the_px4_sample_has_attitude_from_the_quaternion():
    from pyulog import ULog

    log = ULog(str(SAMPLE), ["vehicle_attitude"])
    q = np.stack([log.data_list[0].data[f"q[{k}]"] for k in range(4)]).astype(float)
    stamp = log.data_list[0].data["timestamp"]
    raw, data = read_raw_log(SAMPLE), read_log(SAMPLE, signals=["measured_attitude"])
    assert raw["vehicle_attitude"].time[-1] == pytest.approx((int(stamp[-1]) - 112500176) / 1e6)
    # The body's z axis, from the quaternion and from the angles.
    down = np.stack([2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1])])
    at = np.searchsorted(raw["vehicle_attitude"].time, 30.0)
    roll, pitch, yaw = data.measured_attitude.interp(time=raw["vehicle_attitude"].time[at]).values
    x = np.cos(roll) * np.sin(pitch) * np.cos(yaw) + np.sin(roll) * np.sin(yaw)
    y = np.cos(roll) * np.sin(pitch) * np.sin(yaw) - np.sin(roll) * np.cos(yaw)
    assert [x, y] == pytest.approx(down[:, at].tolist(), abs=1e-3)


@needs_sample
def test_every_field_of_the_px4_sample_is_what_pyulog_gives():
    from pyulog import ULog

    raw, log = read_raw_log(SAMPLE), ULog(str(SAMPLE))
    assert raw.is_complete
    assert len(raw) == len(log.data_list)
    for theirs in log.data_list:
        ours = raw[theirs.name if theirs.multi_id == 0 else f"{theirs.name}:{theirs.multi_id}"]
        for name, values in theirs.data.items():
            if name in ours.fields and ours.fields[name].dtype.kind in "iu":
                assert np.array_equal(ours.fields[name], values), name
    assert [m.message for m in log.logged_messages] == [text for _, _, text in raw.messages]
    assert raw.info["parameters"] == log.initial_parameters
    assert [d.duration / 1e3 for d in log.dropouts] == [d for _, d in raw.dropouts]


@needs_sample
def test_the_px4_samples_rates_are_the_derivative_of_its_attitude():
    from mufly.logs import estimate_channel_delays, read_log

    data = read_log(SAMPLE, signals=["measured_attitude", "measured_rates"], rate_hz=100)
    found = {d.response: d.delay for d in estimate_channel_delays(data)}
    for axis in "pqr":
        assert found[f"measured_rates.{axis}"].correlation > 0.99
        assert abs(found[f"measured_rates.{axis}"].delay_s) < 0.005


@needs_sample
@pytest.mark.parametrize("share", [0.2, 0.4, 0.77])
def test_the_px4_sample_cut_off_is_read_up_to_the_cut(tmp_path, share):
    path = tmp_path / "cut.ulg"
    whole = SAMPLE.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    raw = read_raw_log(path)
    full = read_raw_log(SAMPLE)["sensor_combined"].fields["gyro_rad[0]"]
    part = raw["sensor_combined"].fields["gyro_rad[0]"]
    assert 0 < len(part) < len(full)
    assert np.array_equal(part, full[: len(part)])


def test_other_peoples_mcap_gives_topics_and_takes_a_map(tmp_path):
    import json

    from mcap.writer import Writer

    path = tmp_path / "robot.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="imu", encoding="jsonschema", data=b"{}")
        channel = writer.register_channel(topic="/imu", message_encoding="json", schema_id=schema)
        other = writer.register_channel(topic="/camera", message_encoding="protobuf", schema_id=0)
        for k in range(100):
            message = json.dumps({"gyro": {"x": 57.29577951308232 * np.sin(0.1 * k)}, "name": "a"}).encode()
            writer.add_message(channel, log_time=10**15 + k * 10**7, publish_time=0, data=message)
            writer.add_message(other, log_time=10**15 + k * 10**7, publish_time=0, data=b"\xff\x00")
        writer.finish()
    raw = read_raw_log(path)
    assert raw["/imu"].rate_hz == pytest.approx(100)
    assert "/camera" in raw.notes[0]
    data = read_log(path, columns={"signal": [
        {"name": "measured_rates.p", "topic": "/imu", "columns": ["gyro.x"], "unit": "deg/s"}]})  # fmt: skip
    assert data.measured_rates.sel(rate="p").values == pytest.approx(np.sin(0.1 * np.arange(100)))


SECONDS = 0.01 * np.arange(300)
# The example of the deck's documentation, config.txt, as far as it has names here.
VARIABLES = [f"{v}(f)" for v in (
    "stateEstimate.roll", "stateEstimate.pitch", "stateEstimate.yaw", "gyro.x", "gyro.y", "gyro.z", "acc.x", "acc.y",
    "acc.z", "stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "pm.vbat")]  # fmt: skip
MOTORS = [f"motor.m{k}(H)" for k in range(1, 5)]


def crazyflie_rows():
    """Rolls, pitches nose up, yaws left and climbs, in the axes of a Crazyflie: forward, left, up."""
    wave = np.sin(SECONDS)
    rows = [
        20 * wave, 10 * wave, 30 * wave, 20 * np.cos(SECONDS), -10 * np.cos(SECONDS), 30 * np.cos(SECONDS),
        0 * wave, 0 * wave, 1 + 0 * wave, 0.5 * SECONDS, 0.2 * SECONDS, 1.0 * SECONDS, 3.9 - 0.1 * SECONDS,
    ]  # fmt: skip
    return np.column_stack(rows)


@pytest.mark.parametrize("form", ["events, version 1", "events, version 2", "rows of 2018"])
def test_a_crazyflies_micro_sd_log_is_read_in_our_axes(tmp_path, make_micro_sd, form):
    by_events, of_2018 = make_micro_sd
    duty = (6553, 13107, 32768, 65535)
    rows = [(*row, *duty) for row in crazyflie_rows().tolist()]
    if form == "rows of 2018":
        ticks = np.rint(5000 + 1e3 * SECONDS).astype(int).tolist()
        content = of_2018(["tick(I)", *VARIABLES, *MOTORS], [(t, *r) for t, r in zip(ticks, rows, strict=True)])
    else:
        kinds = {0: ("fixedFrequency", [*VARIABLES, *MOTORS]), 7: ("estPosition", ["source(B)"])}
        events = [(0, 5 + t, row) for t, row in zip(SECONDS, rows, strict=True)]
        events[50:50] = [(7, 5.495, (3,))]
        content = by_events(kinds, events, version=int(form[-1]))
    path = tmp_path / "log00"
    path.write_bytes(content)
    assert detect_log_format(path) == "Crazyflie"
    raw = read_raw_log(path)
    assert raw.is_complete
    assert raw["fixedFrequency"].time == pytest.approx(SECONDS, abs=1e-6)
    assert raw["fixedFrequency"].units["acc.z"] == "gee"
    if form != "rows of 2018":
        assert raw["estPosition"].fields["source"].tolist() == [3]
        assert raw["estPosition"].time == pytest.approx([0.495], abs=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # degrees and degrees a second belong together as radians do
        data = read_log(path)
    wave, slope = np.sin(SECONDS), np.cos(SECONDS)
    assert data.measured_attitude.values == pytest.approx(
        np.radians(np.column_stack([20 * wave, 10 * wave, -30 * wave])), abs=1e-6
    )
    # Of one motion: each rate is the derivative of its angle, which the axes of the Crazyflie alone do not give.
    assert data.measured_rates.values == pytest.approx(
        np.radians(np.column_stack([20 * slope, 10 * slope, -30 * slope])), abs=1e-6
    )
    assert data.measured_acceleration.values[:, 2] == pytest.approx(-9.80665)
    assert data.measured_position.values == pytest.approx(
        np.column_stack([0.5 * SECONDS, -0.2 * SECONDS, -SECONDS]), abs=1e-6
    )
    assert data.actuator_command.values[0] == pytest.approx(np.array(duty) / 65535)
    assert data.battery_voltage.values == pytest.approx(3.9 - 0.1 * SECONDS, rel=1e-6)


def test_a_micro_sd_log_that_was_cut_off_is_read_up_to_the_cut(tmp_path, make_micro_sd):
    by_events, of_2018 = make_micro_sd
    kinds = {0: ("fixedFrequency", ["gyro.x(f)"])}
    events = [(0, 0.01 * k, (k,)) for k in range(100)]
    path = tmp_path / "log"

    def read(content):
        path.write_bytes(content)
        raw = read_raw_log(path)
        return raw.is_complete, raw["fixedFrequency"].fields["gyro.x"].tolist()

    whole = by_events(kinds, events)
    assert read(whole) == (True, list(range(100)))
    assert read(by_events(kinds, events, end=False)) == (False, list(range(100)))
    assert read(whole[:-25]) == (False, list(range(98)))
    flipped = bytearray(whole)
    flipped[-40] ^= 1
    assert read(flipped)[0] is False
    flipped = bytearray(whole)
    flipped[-4 - 20 * 14 + 8] ^= 0x10  # in the clock of the 80th event: the log was 7e7 s long
    assert read(flipped) == (False, [*range(80), *range(81, 100)])
    lost = whole[: -4 - 20 * 14] + whole[-4 - 20 * 14 + 5 :]  # five bytes: the next event is found behind them
    assert read(lost)[1] == [*range(80), *range(81, 100)]
    alien = by_events(kinds, events[:50], end=False) + b"\x09\x00" + bytes(30)  # an event of no known kind
    assert read(alien) == (False, list(range(50)))
    old = of_2018(["tick(I)", "gyro.x(f)"], [(10 * k, k) for k in range(100)])
    assert read(old) == (True, list(range(100)))
    assert read(old[:-1]) == (False, list(range(80)))
    flipped = bytearray(old)
    flipped[-30] ^= 1
    assert read(flipped) == (False, list(range(80)))
    flipped = bytearray(old)
    flipped[10] ^= 1  # a letter of a name
    assert read_raw_complete(path, flipped) is False


def read_raw_complete(path, content):
    path.write_bytes(content)
    return read_raw_log(path).is_complete


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xbc\x02\x00\x01\x00\x00\x00fixed", "damaged log of the micro-SD deck"),
        (
            b"\xbc\x02\x00\x01\x00\x00\x00a\x00\x01\x00x(?)\x00" + bytes(40),
            "damaged log of the micro-SD deck",
        ),
        (b"\xbc\x02\x00\x01\x00\x00\x00a\x00\x01\x00x(f)\x00", "without data"),
        (b"\xbc\x07\x00\x01\x00\x00\x00a\x00\x01\x00x(f)\x00", "not a log in a known format"),
        (b"\x03tick(I),x(f),x(f)," + bytes(60), "occurs twice"),
    ],
)
def test_damaged_micro_sd_logs_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "log"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_raw_log(path)
    assert "\n" not in str(caught.value)
