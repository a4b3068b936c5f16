"""Logs of other times and habits: old units, mixed clocks, stamps never set, values that say 'unknown'."""

import struct
import warnings

import numpy as np
import pytest
import xarray as xr

from mufly.errors import InputError
from mufly.logs import LogWarning, examine_log, read_log, read_raw_log, write_log

TIME = np.arange(0, 8, 0.02)
ROLL, RATE = 0.3 * np.sin(2 * TIME), 0.6 * np.cos(2 * TIME)


def quietly(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        return read_log(path, **options)


def old_copter(dataflash, *, clock="TimeMS", said=b"ArduCopter V3.2.1 (abc)", whole=True, gyro=False, rates=100.0):
    """A flight as ArduCopter of 2014 and 2015 logged it: no units, times of the week in GPS, MSG without a time."""
    tick, letter = (1, "I") if clock == "TimeMS" else (1000, "Q")
    ms = np.rint(1e3 * (100 + TIME)).astype(int).tolist()
    attitude = [(tick * t, round(100 * a), 0, 18_000) for t, a in zip(ms, np.degrees(ROLL), strict=True)]
    rate = [(tick * t, rates * r, 0.0, 0.0) for t, r in zip(ms, np.degrees(RATE), strict=True)]
    volt = 1574 if whole else 15.74
    battery = [(tick * t, volt, volt) for t in ms[::10]]
    gps = [(3, 319_000_000 + t - ms[0], 1830, t) for t in ms[::10]]
    kind = "hh" if whole else "ff"
    parts = [
        (10, "ATT", letter + "ccC", f"{clock},Roll,Pitch,Yaw", attitude),
        (11, "RATE", letter + "fff", f"{clock},R,P,Y", rate),
        (12, "CURR", letter + kind, f"{clock},Volt,Curr", battery),
        (13, "GPS", "BIHI", "Status,TimeMS,Week,T", gps),
        (14, "MSG", "Z", "@Message", [(ms[0] - 1, b"Frame: QUAD"), (ms[200], said)]),
        (15, "PARM", "Nf", "@Name,Value", [(ms[0] - 1, b"RATE_P", 0.15)]),
    ]
    if gyro:
        body = [(tick * t, r, 0.0, 0.0) for t, r in zip(ms, RATE, strict=True)]
        parts.append((16, "IMU", letter + "fff", f"{clock},GyrX,GyrY,GyrZ", body))
    return dataflash(parts)


@pytest.fixture
def write(tmp_path):
    def writer(content, name="log"):
        path = tmp_path / name
        path.write_bytes(content)
        return path

    return writer


def test_a_log_of_2014_has_the_units_and_the_clock_of_its_time(write, make_dataflash):
    path = write(old_copter(make_dataflash))
    raw = read_raw_log(path)
    assert raw.time_span == (pytest.approx(0, abs=1e-6), pytest.approx(TIME[-1], abs=1e-6))
    assert raw["GPS"].fields["TimeMS"][0] == 319_000_000
    # Week 1830 and 319 000 s of GPS time, less 18 leap seconds.
    assert raw.start_time == "2015-02-04T16:36:24.000+00:00"
    assert raw.info["system"] == "ArduCopter V3.2.1 (abc)"
    assert raw.info["parameters"] == {"RATE_P": pytest.approx(0.15)}
    assert raw.messages[1] == (pytest.approx(TIME[200], abs=1e-6), "info", "ArduCopter V3.2.1 (abc)")
    data = quietly(path)
    for battery in (data.battery_voltage, data.battery_current):
        assert [np.nanmin(battery), np.nanmax(battery)] == pytest.approx([15.74, 15.74])
    assert np.nanmax(data.measured_rates.sel(rate="p")) == pytest.approx(0.6, rel=1e-3)
    assert np.nanmax(np.abs(data.measured_attitude.sel(angle="yaw"))) == pytest.approx(np.pi)
    notes = " ".join(data.attrs["notes"])
    assert "hundredths of a degree per second" in notes
    assert "whole hundredths" in notes
    assert "looks like" not in notes


@pytest.mark.parametrize(
    ("options", "peak"),
    [
        ({"said": b"ArduCopter V3.3.3 (acf9493)"}, 0.6),
        ({"said": b"APM:Copter V3.3-rc5"}, 0.6),
        (
            {"said": b"ArduCopter V3.4.6 (e707341b)"},
            60.0,
        ),  # in degrees: what it says is a hundred times as much
        ({"said": b"nothing of the kind", "gyro": True}, 0.6),
        ({"said": b"nothing of the kind", "gyro": True, "rates": 1.0}, 0.6),
        ({"said": b"ArduPlane V3.3.0", "rates": 1.0}, 0.6),
    ],
)
def test_rates_are_in_what_the_version_or_the_gyroscope_says(write, make_dataflash, options, peak):
    path = write(old_copter(make_dataflash, clock="TimeUS", whole=False, **options))
    data = quietly(path, signals=["RATE/R"] if peak < 1 else ["RATE/R", "measured_attitude"])
    assert np.nanmax(data.RATE_R) == pytest.approx(peak, rel=1e-3)
    assert np.nanmax(quietly(path).battery_voltage) == pytest.approx(15.74)


def test_what_cannot_be_understood_is_examined_all_the_same_and_named(write):
    rows = "".join(f"{0.1 * k:.1f},{k}\n" for k in range(50))
    report = examine_log(write(f"t_s,battery_voltage [rad]\n{rows}".encode(), "a.csv"))
    assert report.notes == ["battery_voltage: the unit 'rad' cannot become V; use one of: V, mV, cV, uV, kV"]
    assert report.signals == []
    assert [c.samples for c in report.clocks.values()] == [50]


def test_the_signal_that_is_wrong_is_the_one_that_is_named(write, make_dataflash):
    path = write(old_copter(make_dataflash, clock="TimeUS", said=b"ArduCopter V4.0.0"))
    notes = " ".join(examine_log(path).notes)
    assert "do not belong together" in notes
    assert "measured_rates by its size" in notes
    assert "ATT/Roll) is said" not in notes


def csv(write, head, *columns):
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.column_stack([TIME, *columns]))
    return write(f"{head}\n{rows}\n".encode(), "log.csv")


def test_what_cannot_be_is_said_of_named_units_and_left_out_of_assumed_ones(write, make_dataflash):
    path = csv(write, "t_s,battery_voltage [V]", 1574 + TIME)
    with pytest.warns(LogWarning, match=r"battery_voltage .*reaches 1582 V, but 28 lithium cells"):
        assert read_log(path).battery_voltage.values == pytest.approx(1574 + TIME)
    us = np.rint(1e6 * TIME).astype(int).tolist()
    rows = [(t, 1574.0 + k, 12.0) for k, t in enumerate(us)]
    path = write(make_dataflash([(10, "BAT", "Qff", "TimeUS,Volt,Curr", rows)]))
    with pytest.warns(LogWarning, match=r"BAT/Volt\) reaches 1973 V, but 28 lithium cells .*not used; give its unit"):
        data = read_log(path)
    assert "battery_voltage" not in data
    given = quietly(path, columns={"battery_voltage": "BAT/Volt(cV)"})
    assert given.battery_voltage.values == pytest.approx(15.74 + 0.01 * np.arange(len(TIME)))
    rows = [(t, 1574.0 if k in (50, 70) else 15.0, 12.0) for k, t in enumerate(us)]
    path = write(make_dataflash([(10, "BAT", "Qff", "TimeUS,Volt,Curr", rows)]))
    with pytest.warns(LogWarning, match=r"2 values are implausible .1574 V"):
        data = read_log(path)
    assert np.flatnonzero(np.isnan(data.battery_voltage)).tolist() == [50, 70]


def test_turns_that_were_counted_and_references_are_no_degrees(write):
    """A helicopter that rolled over twice, and a controller whose rates answer to errors of attitude."""
    roll = np.cumsum(np.where((TIME > 2) & (TIME < 4), 6.5, 0.01 * np.sin(9 * TIME))) * 0.02
    rate = np.gradient(roll, TIME)
    names = [
        f"{who}_{what}" for who in ("measured", "reference") for what in ("attitude_roll [rad]", "rates_p [rad/s]")
    ]
    head = ",".join(["t_s", *names])
    path = csv(write, head, roll, rate, 0.3 * np.sin(TIME), 30 * np.cos(TIME))
    assert roll.max() > 4 * np.pi
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_log(path)
    path = csv(write, "t_s,measured_attitude_pitch [rad]", 20 * np.sin(TIME))  # no pitch is steeper than a quarter turn
    with pytest.warns(LogWarning, match="looks like deg"):
        read_log(path)


def ulog(topics, *, header=0, messages=(), dropouts=()):
    """A ULog file of topics {name: (stamps in us, {field: values})}, all doubles; ``x[0]``, ``x[1]`` are one array."""

    def message(kind, body):
        return struct.pack("<H", len(body)) + kind + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", header) + message(b"B", bytes(40))
    for name, (_, fields) in topics.items():
        names = [f.partition("[")[0] for f in fields]
        sizes = {n: f"[{names.count(n)}]" if f"{n}[0]" in fields else "" for n in names}
        declared = ";".join(["uint64_t timestamp", *(f"double{size} {n}" for n, size in sizes.items())])
        out += message(b"F", f"{name}:{declared};".encode())
    for k, name in enumerate(topics):
        out += message(b"A", struct.pack("<BH", 0, k) + name.encode())
    for k, (stamps, fields) in enumerate(topics.values()):
        for row, stamp in enumerate(stamps):
            values = [float(v[row]) for v in fields.values()]
            out += message(b"D", struct.pack(f"<HQ{len(values)}d", k, int(stamp), *values))
    for stamp, level, text in messages:
        out += message(b"L", bytes([level]) + struct.pack("<Q", stamp) + text)
    for duration in dropouts:
        out += message(b"O", struct.pack("<H", duration))
    return out


BOOT_US = 1_700_000_000_000_000


def px4(start_us, **more):
    us = start_us + np.rint(1e6 * TIME).astype(np.int64)
    return {
        "vehicle_angular_velocity": (us, {"xyz[0]": RATE, "xyz[1]": 0 * RATE, "xyz[2]": 0 * RATE}),
        **more,
    }


def test_one_stamp_never_set_does_not_make_a_log_of_54_years(write, tmp_path):
    us = BOOT_US + np.array([0, 3_000_000, 6_000_000])
    events = (np.r_[0, us], {"id": [1, 2, 3, 4]})
    path = write(ulog(px4(BOOT_US, event=events), header=BOOT_US, messages=[(0, 54, b"hello"), (us[1], 52, b"wind")]))
    raw = read_raw_log(path)
    assert raw.time_span == (pytest.approx(0), pytest.approx(TIME[-1]))
    assert np.isnan(raw["event"].time).tolist() == [True, False, False, False]
    assert raw["event"].time[2] == pytest.approx(3.0)
    assert any("event: 1 of 4 time stamps were never set" in n for n in raw.notes)
    assert [m[1:] for m in raw.messages] == [("info", "hello"), ("warning", "wind")]
    assert raw.messages[1][0] == pytest.approx(3.0)
    data = quietly(path)
    assert (data.time.values[0], data.time.values[-1]) == (pytest.approx(0), pytest.approx(TIME[-1]))
    back = quietly(write_log(data, tmp_path / "out.csv"))
    assert back.time.values == pytest.approx(data.time.values)


def test_the_first_position_fix_tells_the_wall_time_of_the_instant_0(write):
    """The receiver knows no time of day at first; the fix comes two seconds after the header's stamp."""
    us = BOOT_US + np.array([1_000_000, 2_000_000, 3_000_000])
    utc = {"time_utc_usec": [0, 1_740_830_402_000_000, 1_740_830_403_000_000]}
    for topic in ("vehicle_gps_position", "sensor_gps"):
        raw = read_raw_log(write(ulog(px4(BOOT_US, **{topic: (us, utc)}), header=BOOT_US)))
        assert raw.start_time == "2025-03-01T12:00:00.000+00:00"


def test_topics_on_another_clock_are_said_and_the_bulk_decides(write):
    other = (np.rint(1e6 * TIME).astype(np.int64) + 1_000_000, {"x": TIME})
    gps = (BOOT_US + np.rint(1e6 * TIME).astype(np.int64), {"x": TIME})
    path = write(ulog(px4(1_000_000, a=other, b=other, clock_of_gps=gps), header=1_000_000))
    raw = read_raw_log(path)
    assert raw.time_span == (pytest.approx(0, abs=1e-9), pytest.approx(TIME[-1]))
    assert np.isnan(raw["clock_of_gps"].time).all()
    assert any(n.startswith("clock_of_gps: 400 time stamps of 400 ignored (from another clock") for n in raw.notes)
    assert "topic clock_of_gps: no message has a time stamp" in examine_log(path).list_faults()


def test_a_header_in_the_middle_is_the_instant_0_and_one_far_away_is_not(write):
    """What was published before the logger started lies before 0; a header of another clock says nothing."""
    raw = read_raw_log(write(ulog(px4(50_000_000), header=54_000_000, dropouts=[30])))
    assert raw.time_span[0] == pytest.approx(-4.0)
    assert raw.dropouts[0][1] == pytest.approx(0.03)
    assert read_raw_log(write(ulog(px4(50_000_000), header=649_000_000))).time_span[0] == pytest.approx(-599.0)
    assert read_raw_log(write(ulog(px4(50_000_000), header=900_000_000))).time_span[0] == pytest.approx(0)
    assert read_raw_log(write(ulog(px4(700_000_000), header=99_000_000))).time_span[0] == pytest.approx(0)


def test_a_log_that_begins_before_0_is_shifted_for_formats_that_know_no_sign(write, tmp_path):
    path = write(ulog(px4(50_000_000), header=54_000_000))
    data = quietly(path)
    with pytest.raises(InputError, match=r"begins at -4 s, and ULog has no time before 0; give start_s=0"):
        write_log(data, tmp_path / "out.ulg")
    moved = quietly(path, start_s=0)
    assert moved.time.values == pytest.approx(data.time.values + 4.0)
    back = quietly(write_log(moved, tmp_path / "out.ulg"))
    assert np.array_equal(back.time, moved.time)
    with pytest.raises(InputError, match="is not a time"):
        read_log(path, start_s=np.nan)


def test_shifting_the_clock_moves_events_and_wall_time_along(tmp_path, data):
    path = write_log(data, tmp_path / "log.nc")
    moved = quietly(path, from_s=2.0, start_s=10.0)
    assert moved.time.values[0] == 10.0
    assert moved.event_time.values == pytest.approx(data.event_time.values + 8.0)
    assert moved.attrs["start_time"] == "2025-03-01T11:59:52.000+00:00"


def test_a_wild_stamp_is_left_out_and_its_neighbours_stay(write):
    time = TIME.copy()
    time[100], time[250] = 1083.7, -40.0
    rows = "\n".join(f"{t:.6f},{k}" for k, t in enumerate(time))
    with pytest.warns(LogWarning, match="2 samples have time stamps far from their neighbours"):
        data = read_log(write(f"t_s,U_V\n{rows}\n".encode(), "a.csv"))
    assert data.U.values.tolist() == [k for k in range(400) if k not in (100, 250)]
    time = TIME + 1.7e9
    time[0] = 0.0
    rows = "\n".join(f"{t:.6f},{k}" for k, t in enumerate(time))
    path = write(f"t_s,U_V\n{rows}\n".encode(), "b.csv")
    raw = read_raw_log(path)
    assert "1 time stamp of 400 ignored (never set)" in raw.notes[0]
    assert raw.start_time.startswith("2023-11-14")
    assert quietly(path).time.values[-1] == pytest.approx(TIME[-1] - TIME[1])
    stamps = [f"2025-03-01T12:00:{k / 10:04.1f}Z" for k in range(50)]
    stamps[0] = "1970-01-01T00:00:00Z"
    rows = "\n".join(f"{t},{k}" for k, t in enumerate(stamps))
    assert read_raw_log(write(f"time,U_V\n{rows}\n".encode(), "c.csv")).start_time.startswith("2025-03-01T12:00:00.1")


def test_rows_days_apart_are_no_foreign_clock(write):
    """A table of a test that lasts weeks, one row every two days: no clock has the half of the rows."""
    rows = "\n".join(f"{172_800 * k},{k}" for k in range(30))
    assert len(quietly(write(f"t_s,U_V\n{rows}\n".encode(), "log.csv")).time) == 30


def entry(link, message, stamp_s, version=2):
    return struct.pack(">Q", int(1.7e15 + 1e6 * stamp_s)) + message.pack(link, force_mavlink1=version == 1)


def test_what_mavlink_says_of_the_unknown_is_missing(write, mavlink):
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    out = entry(link, link.heartbeat_encode(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 0), 0)
    cells = [3700, 3710, 65535, 65535, 65535, 65535, 65535, 65535, 65535, 65535]
    for k in range(40):
        known = k % 2
        boot = 1000 + 100 * k
        out += entry(
            link,
            link.sys_status_encode(
                0,
                0,
                0,
                0,
                7400 if known else 65535,
                210 if known else -1,
                80 if known else -1,
                0,
                0,
                0,
                0,
                0,
                0,
            ),
            0.1 * k,
        )
        out += entry(link, link.battery_status_encode(0, 0, 0, 32767, cells, -1, -1, -1, -1), 0.1 * k)
        out += entry(link, link.gps_raw_int_encode(1000 * boot, 3, 0, 0, 0, 65535, 120, 65535, 65535, 255), 0.1 * k)
        out += entry(link, link.rc_channels_encode(boot, 4, *[1500] * 4, *[65535] * 14, 255), 0.1 * k)
    path = write(out)
    raw = read_raw_log(path)
    assert raw.info["system"] == "quadrotor, px4, system 1.1"
    status = raw["SYS_STATUS"].fields
    for name, value in (("voltage_battery", 7400), ("current_battery", 210), ("battery_remaining", 80)):
        assert np.isnan(status[name][::2]).all(), name
        assert (status[name][1::2] == value).all(), name
    battery = raw["BATTERY_STATUS"].fields
    assert np.isnan(battery["temperature"]).all()
    assert battery["voltages[1]"].tolist() == [3710] * 40
    assert np.isnan(battery["voltages[2]"]).all()
    gps = raw["GPS_RAW_INT"].fields
    assert np.isnan(gps["eph"]).all()
    assert gps["epv"].tolist() == [120] * 40
    assert np.isnan(gps["satellites_visible"]).all()
    assert np.isnan(raw["RC_CHANNELS"].fields["chan5_raw"]).all()
    data = quietly(path)
    assert np.nanmin(data.battery_current) == pytest.approx(2.1)
    assert np.nanmin(data.battery_charge) == pytest.approx(0.8)
    assert data.channel.values.tolist() == [1, 2, 3, 4]


def test_one_packet_is_a_log_and_a_part_of_one_is_lost(write, mavlink):
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    one = entry(link, link.attitude_encode(0, 0.5, 0, 0, 0, 0, 0), 0)
    raw = read_raw_log(write(one))
    assert raw["ATTITUDE"].fields["roll"].tolist() == [0.5]
    assert raw.is_complete
    raw = read_raw_log(write(one + one[:-3]))
    assert len(raw["ATTITUDE"].time) == 1
    assert not raw.is_complete


def test_the_vehicle_is_no_ground_station_however_much_that_says(write, mavlink):
    vehicle = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
    ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    out = b""
    out += entry(ground, ground.statustext_encode(6, b"Hello"), 0.05)
    out += entry(ground, ground.param_value_encode(b"OWN", 1.0, 9, 1, 0), 0.05)
    for k in range(30):
        out += entry(ground, ground.heartbeat_encode(mavlink.MAV_TYPE_GCS, 0, 0, 0, 0), 0.1 * k)
        if k % 10 == 0:
            out += entry(vehicle, vehicle.heartbeat_encode(mavlink.MAV_TYPE_COAXIAL, 0, 0, 0, 0), 0.1 * k)
    # A long text comes in chunks; the number 0 is no chunk's.
    for at, text, number, chunk in (
        (1, b"a" * 50, 7, 0),
        (1.1, b"bc", 7, 1),
        (2, b"x", 0, 0),
        (2.1, b"y", 0, 0),
    ):
        out += entry(vehicle, vehicle.statustext_encode(4, text, number, chunk), at)
    raw = read_raw_log(write(out))
    assert [m[1:] for m in raw.messages] == [
        ("info", "255.190: Hello"), ("warning", "a" * 50 + "bc"), ("warning", "x"), ("warning", "y"),
    ]  # fmt: skip
    assert raw.info["parameters"] == {}
    assert raw.info["system"] == "coaxial, system 3.1"
    assert len(raw["HEARTBEAT"].time) == 3
    assert len(raw["HEARTBEAT@255.190"].time) == 30


def test_whoever_speaks_first_after_a_start_has_the_new_clock(write, mavlink):
    """Two topics on the vehicle's clock, which starts anew at 20 s; the one in microseconds comes 30 ms earlier."""
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    out = b""
    for k in range(300):
        boot_s = 0.1 * k if k < 200 else 0.5 + 0.1 * (k - 200)  # a simulation's clock may begin at 0
        out += entry(link, link.highres_imu_encode(int(1e6 * boot_s), *[0.0] * 13, 0), 0.1 * k)
        out += entry(link, link.attitude_encode(int(1e3 * boot_s + 30), 0, 0, 0, 0, 0, 0), 0.1 * k + 0.03)
    raw = read_raw_log(write(out))
    for topic in ("HIGHRES_IMU", "ATTITUDE"):
        assert np.diff(raw[topic].time) == pytest.approx(0.1, abs=2e-3), topic


def test_an_array_is_unknown_as_a_whole_if_its_first_element_says_so():
    from mufly.logs.mavlink_unknown_values import _parse_unknown_value, replace_unknown_values

    assert _parse_unknown_value("[NaN:]") is None
    assert _parse_unknown_value("") is None
    assert _parse_unknown_value("MAV_LANDED_STATE_UNDEFINED") is None
    assert _parse_unknown_value("[UINT16_MAX]") == (65535.0, False)
    assert _parse_unknown_value("[0:]") == (0.0, True)
    assert _parse_unknown_value("0xFFFF") == (65535.0, False)
    assert _parse_unknown_value("INT8_MAX") == (127.0, False)
    fields = {
        "current_a": np.array([-1.0, 2.0]),
        "remaining": np.array([0.5, -1.0]),
        "id": np.array([-1, -1]),
    }
    known = replace_unknown_values("battery_status", fields)
    assert np.isnan(known["current_a"]).tolist() == [True, False]
    assert np.isnan(known["remaining"]).tolist() == [False, True]
    assert known["id"].tolist() == [-1, -1]


def test_packets_that_arrived_on_another_day_are_left_out(write, mavlink):
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    stamps = [0.1 * k for k in range(50)]
    stamps[20] = 4e7
    out = b"".join(entry(link, link.attitude_encode(0, 0.01 * k, 0, 0, 0, 0, 0), t) for k, t in enumerate(stamps))
    raw = read_raw_log(write(out))
    assert "1 packets that arrived on another day" in raw.notes[0]
    assert raw.time_span == (0.0, pytest.approx(4.9))


def test_shares_of_output_are_no_pulses_and_four_motors_have_a_place(write):
    us = np.rint(1e6 * TIME).astype(np.int64) + 1_000_000
    part = np.column_stack([0.5 + 0.1 * np.sin(TIME + k) for k in range(4)])
    fields = {f"output[{k}]": part[:, k] if k < 4 else 0 * TIME for k in range(8)}
    volts = {"voltage_v": 12.0 + 0 * TIME, "current_a": 3.0 + 0 * TIME}
    path = write(ulog({"actuator_outputs": (us, fields), "battery_status": (us, volts)}))
    with pytest.warns(LogWarning, match="holds fractions of the full output instead of pulse lengths"):
        data = read_log(path)
    assert "actuator_output" not in data
    assert data.actuator_command.dims == ("time", "actuator")
    assert data.actuator_command.attrs["units"] == "1"
    assert data.actuator_command.sel(actuator=2).values == pytest.approx(part[:, 1])
    pulses = {f"output[{k}]": 1500 + 100 * np.sin(TIME + k) for k in range(8)}
    data = quietly(write(ulog({"actuator_outputs": (us, pulses)})))
    assert data.actuator_output.attrs["units"] == "us"
    motors = {f"control[{k}]": part[:, k] if k < 4 else np.nan * TIME for k in range(8)}
    data = quietly(write(ulog({"actuator_motors": (us, motors), "actuator_outputs": (us, fields)})))
    assert data.actuator_command.sizes["actuator"] == 8
    assert data.actuator_command.sel(actuator=4).values == pytest.approx(part[:, 3])


def test_a_quadrotors_motors_are_pointed_to_their_name(write):
    path = csv(write, "t_s,m1,m2,m3,m4", *(0.1 * k + 0 * TIME for k in range(4)))
    with pytest.raises(InputError, match="actuator_command has as many components as there are motors"):
        read_log(path, columns={"motor_input": "m1,m2,m3,m4"})
    data = quietly(path, columns={"actuator_command": "m1,m2,m3,m4"})
    assert data.actuator_command.values[0].tolist() == pytest.approx([0, 0.1, 0.2, 0.3])


def test_mcap_messages_stamped_0_do_not_begin_the_log(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "robot.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="imu", encoding="jsonschema", data=b"{}")
        imu, static = (
            writer.register_channel(topic=t, message_encoding="json", schema_id=schema) for t in ("/imu", "/static")
        )
        writer.add_message(static, log_time=0, publish_time=0, data=b'{"a": 1}')
        for k in range(100):
            writer.add_message(imu, log_time=17 * 10**17 + k * 10**7, publish_time=0, data=b'{"x": 1.5}')
        writer.finish()
    raw = read_raw_log(path)
    assert raw.time_span == (0.0, pytest.approx(0.99))
    assert raw.start_time.startswith("2023-11-14")
    assert raw.notes == ("/static: 1 time stamp of 1 ignored (never set)",)


def test_a_packed_table_is_read_and_other_packed_logs_say_what_to_do(write, make_dataflash):
    import gzip

    text = b"t_s,U_V\n" + b"".join(b"%.2f,7.4\n" % (0.01 * k) for k in range(500))
    packed = gzip.compress(text)
    assert quietly(write(packed, "log.csv.gz")).U.values == pytest.approx(7.4)
    assert not read_raw_log(write(packed[:-30], "cut.csv.gz")).is_complete
    with pytest.raises(InputError, match="unpack it: gunzip"):
        read_raw_log(write(gzip.compress(old_copter(make_dataflash)), "log.bin.gz"))


def test_events_of_a_shifted_dataset_without_any_are_left_alone(tmp_path):
    data = xr.Dataset({"flap": ("time", np.ones(5), {"units": "rad"})}, {"time": ("time", np.arange(5.0))})
    assert quietly(write_log(data, tmp_path / "a.nc"), start_s=-2.0).time.values.tolist() == [-2, -1, 0, 1, 2]
