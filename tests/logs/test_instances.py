"""ArduPilot's instances, lanes and estimators, flight modes and leap seconds, in the binary form and in text."""

import warnings

import numpy as np
import pytest

from mufly.logs import LogWarning, read_log, read_raw_log
from mufly.logs.raw_log import format_wall_time, gps_to_unix

KINDS = {
    "ATT": "QffffffB TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF",
    "XKF1": "QBffffff TimeUS,C,VN,VE,VD,PN,PE,PD",
    "XKF4": "QBb TimeUS,C,PI",
    "NKF1": "QBffffff TimeUS,C,VN,VE,VD,PN,PE,PD",
    "NKF4": "QBb TimeUS,C,PI",
    "OLD1": "Qffffff TimeUS,VN,VE,VD,PN,PE,PD",
    "OLD4": "Qb TimeUS,PI",
    "SIM2": "Qffffff TimeUS,PN,PE,PD,VN,VE,VD",
    "EAHR": "Qfff TimeUS,VN,VE,VD",
    "BAT": "QBff TimeUS,Inst,Volt,Curr",
    "GPS": "QBBIHff TimeUS,I,Status,GMS,GWk,Lat,Lng",
    "BARO": "QBff TimeUS,I,Alt,Press",
    "ESC": "QBff TimeUS,Instance,RPM,Volt",
    "PIDR": "Qfff TimeUS,P,I,D",
    "PARM": "QNf TimeUS,Name,Value",
    "MODE": "QMB TimeUS,Mode,ModeNum",
    "MSG": "QZ TimeUS,Message",
    "VER": "QBB TimeUS,BT,BU",
}


def text_log(rows, *, marked=()):
    """The text form of (kind, values): ``marked`` kinds have their instance field marked in FMTU."""
    names = {name: name for name in KINDS}
    names |= {"NKF6": "OLD1", "NKF11": "OLD1", "NKF9": "OLD4"}
    used = dict.fromkeys(kind for kind, _ in rows)
    old = {"NKF6", "NKF9"} & set(used)
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    lines += ["FMT, 129, 44, FMTU, QBNN, TimeUS,FmtType,UnitIds,MultIds"]
    for number, kind in enumerate(used, 140):
        like = {"NKF1": "OLD1", "NKF4": "OLD4"}.get(kind, names[kind]) if old else names[kind]
        letters, columns = KINDS[like].split()
        lines.append(f"FMT, {number}, 50, {kind}, {letters}, {columns}")
        if kind in marked:
            lines.append(f"FMTU, 0, {number}, s#{'-' * (len(letters) - 2)}, F{'-' * (len(letters) - 1)}")
    lines += [f"{kind}, {', '.join(map(str, values))}" for kind, values in rows]
    return "\n".join(lines) + "\n"


def quietly(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        return read_log(path, **options)


@pytest.fixture
def write(tmp_path, make_dataflash):
    """Write rows as text or as the binary form; returns the path."""

    def writing(rows, form="text", **options):
        path = tmp_path / "log"
        if form == "text":
            path.write_text(text_log(rows, **options))
            return path
        used = dict.fromkeys(kind for kind, _ in rows)
        messages, ids = [], {}
        for number, kind in enumerate(used, 140):
            letters, columns = KINDS[kind].split()
            values = [tuple(v.encode() if isinstance(v, str) else v for v in row) for name, row in rows if name == kind]
            messages.append((number, kind, letters.replace("M", "B"), columns, values))
            if kind in options.get("marked", ()):
                ids[kind] = "s#" + "-" * (len(letters) - 2)
        units = {"labels": {"s": "s", "#": "instance"}, "ids": ids}
        path.write_bytes(make_dataflash(messages, units))
        return path

    return writing


def lanes(kind="XKF", offsets=(0.0, 35.0), *, seconds=20.0, primary=lambda t: 0):
    """Position at 10 Hz of as many cores as there are offsets (N = 0.5 t + offset), and the primary core."""
    rows = []
    for k in range(round(10 * seconds)):
        t = 0.1 * k
        for core, offset in enumerate(offsets):
            us = 1_000_000 + 100_000 * k
            rows.append((f"{kind}1", (us, core, 0.5, 0, 0, round(0.5 * t + offset, 3), offset, -2)))
            rows.append((f"{kind}4", (us, core, primary(t))))
    return rows


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize("marked", [(), ("XKF1", "XKF4", "BAT", "GPS", "BARO", "ESC")])
def test_instances_are_told_apart_marked_or_not(write, form, marked):
    rows = lanes()
    for k in range(50):
        us = 1_000_000 + 400_000 * k
        rows += [("BAT", (us, i, v, 1 + i)) for i, v in ((0, 11.4), (1, 5.0), (2, 22.0))]
        rows += [("BARO", (us, i, 100.0 + 7 * i, 1e5)) for i in (0, 1)]
        rows += [("ESC", (us, i, 1000.0 * (i + 1), 11.0)) for i in range(4)]
        rows += [("GPS", (us, i, 3, 1000 * k, 2200, 47.0 + i, 8.0)) for i in (0, 1)]
        rows.append(("PIDR", (us, 0.1, 0.01 * k, 0.2)))  # its I is the integral part
    path = write(rows, form, marked=marked)
    raw = read_raw_log(path)
    for topic, field, value in (
        ("BAT", "Volt", 11.4), ("BAT:1", "Volt", 5.0), ("BAT:2", "Volt", 22.0), ("BARO:1", "Alt", 107.0),
        ("ESC", "RPM", 1000.0), ("ESC:3", "RPM", 4000.0), ("GPS:1", "Lat", 48.0),
    ):  # fmt: skip
        assert raw[topic].fields[field] == pytest.approx(np.full(50, value)), topic
        assert len(raw[topic].time) == 50
    assert len(raw["PIDR"].fields["I"]) == 50
    assert "PIDR:1" not in raw
    data = quietly(path)
    assert np.nanmax(data.battery_voltage) == pytest.approx(11.4, rel=1e-6)
    assert np.nanmax(data.measured_position.sel(axis="E")) == 0.0
    assert raw.notes == ()


@pytest.mark.parametrize("form", ["text", "binary"])
def test_position_follows_the_active_lane(write, form):
    def primary(t):
        return -1 if t < 0.5 else 1 if 8.0 <= t < 14.0 else 0

    path = write(lanes(primary=primary), form)
    raw = read_raw_log(path)
    (note,) = raw.notes
    assert "XKF1 from 0.0 s, XKF1:1 from 8.0 s, XKF1 from 14.0 s" in note
    data = quietly(path)
    away = data.measured_position.sel(axis="E").values
    t = data.time.values
    assert away == pytest.approx(np.where((t >= 8.0) & (t < 14.0), 35.0, 0.0), abs=1e-3)
    assert len(raw["XKF1"].time) == len(raw["XKF1:1"].time) == 200
    whole = quietly(write(lanes(primary=lambda t: 1), form))
    assert whole.measured_position.sel(axis="E").values == pytest.approx(np.full(200, 35.0))


def test_cores_of_2018_have_messages_of_their_own(write):
    rows = []
    for k in range(100):
        us = 1_000_000 + 100_000 * k
        rows += [("NKF1", (us, 0, 0, 0, 0.1 * k, 0, -1)), ("NKF6", (us, 0, 0, 0, 0.1 * k, 20, -1))]
        rows += [("NKF4", (us, int(k >= 60))), ("NKF9", (us, int(k >= 60)))]
    path = write(rows)
    assert "NKF1 from 0.0 s, NKF6 from 6.0 s" in read_raw_log(path).notes[0]
    east = quietly(path).measured_position.sel(axis="E").values
    assert east == pytest.approx(np.where(np.arange(100) >= 60, 20.0, 0.0))


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize(("kind", "east"), [(2, 100.0), (3, 0.0), (10, 7.0)])
def test_the_estimator_is_that_of_ahrs_ekf_type(write, form, kind, east):
    rows = [("PARM", (1_000_000, "AHRS_EKF_TYPE", kind)), ("PARM", (1_000_000, "EK2_ENABLE", 1))]
    rows += [*lanes("XKF", (0.0,)), *lanes("NKF", (100.0,))]
    rows += [("SIM2", (1_000_000 + 100_000 * k, 0.0, 7.0, -2.0, 0.0, 0.0, 0.0)) for k in range(200)]
    path = write(rows, form)
    assert quietly(path).measured_position.sel(axis="E").values == pytest.approx(np.full(200, east))


def test_the_estimator_that_was_active_counts_and_dcm_leaves_a_gap(write):
    rows = [("PARM", (1_000_000, "AHRS_EKF_TYPE", 3))]
    rows += [*lanes("XKF", (0.0,)), *lanes("NKF", (100.0,))]
    for k in range(200):
        active = 3 if k < 80 else 0 if k < 120 else 2
        rows.append(("ATT", (1_000_000 + 100_000 * k, 0, 1, 0, 1, 0, 10, active)))
    path = write(rows)
    (note,) = read_raw_log(path).notes
    assert "XKF1 from 0.0 s, NKF1 from 12.0 s; none while DCM was active" in note
    east = quietly(path).measured_position.sel(axis="E").values
    assert east[:80] == pytest.approx(np.zeros(80))
    assert np.isnan(east[82:118]).all()
    assert east[120:] == pytest.approx(np.full(80, 100.0))


def test_an_external_estimator_has_a_velocity_and_no_local_position(write):
    rows = [("PARM", (1_000_000, "AHRS_EKF_TYPE", 11)), *lanes("XKF", (0.0,))]
    rows += [("EAHR", (1_000_000 + 100_000 * k, 3.0, 0.0, 0.0)) for k in range(200)]
    data = quietly(write(rows))
    assert data.measured_velocity.sel(axis="N").values == pytest.approx(np.full(200, 3.0))
    assert np.isnan(data.measured_position).all()
    missing = read_raw_log(write([row for row in rows if row[0] != "EAHR"]))
    assert "the external AHRS was active, but the log has no position of it; the position of EKF3" in missing.notes[0]
    (note,) = read_raw_log(write([("PARM", (1_000_000, "AHRS_EKF_TYPE", 0)), *lanes("XKF", (0.0,))])).notes
    assert note == "the log has no position of the active estimator; position and velocity are those of XKF1"
    raw = read_raw_log(write(lanes(offsets=(0.0,), primary=lambda t: int(t >= 5.0))))
    assert raw.notes[0] == "core 1 of EKF3 was active but is not in the log"
    assert raw["EKF:active"].time[-1] < 5.0


@pytest.mark.parametrize(
    ("firmware", "number", "word"),
    [
        ("ArduCopter V4.5.1 (abc)", 5, "loiter"),
        ("ArduPlane V4.5.1", 5, "fly by wire A"),
        ("ArduRover V4.2", 4, "hold"),
        ("ArduSub V4.1", 19, "manual"),
        ("Blimp V4.3", 3, "loiter"),
        ("APM:Copter V3.4.6", 9, "landing"),
        ("", 5, "mode 5"),
        (3, 5, "fly by wire A"),  # no message, but the type of the build
    ],
)
@pytest.mark.parametrize("form", ["text", "binary"])
def test_flight_modes_have_the_words_of_their_firmware(write, form, firmware, number, word):
    first = ("VER", (1_000_000, 2, firmware)) if isinstance(firmware, int) else ("MSG", (1_000_000, firmware or "-"))
    rows = [
        first,
        ("MODE", (1_000_000, 0, 0)),
        ("MODE", (2_000_000, number, number)),
        ("MODE", (2_001_000, 0, 0)),
    ]
    rows += [("ATT", (1_000_000 + 100_000 * k, 0, 1, 0, 1, 0, 10, 3)) for k in range(30)]
    path = write(rows, form)
    raw = read_raw_log(path)
    assert raw["MODE"].fields["Name"][1] == word
    assert raw["MODE"].fields["Mode"].tolist() == [0, number, 0]
    data = quietly(path)
    assert data.rate_hz == pytest.approx(10.0)  # two changes in a millisecond are no rate
    assert data.sizes["time"] == 30


def test_flight_modes_that_are_text_stay(write):
    rows = [("MODE", (1_000_000, "Stabilize", 0)), ("MODE", (2_000_000, "Loiter", 5))]
    rows += [("ATT", (1_000_000 + 100_000 * k, 0, 1, 0, 1, 0, 10, 3)) for k in range(30)]
    path = write(rows)
    assert read_raw_log(path)["MODE"].fields["Mode"].tolist() == ["Stabilize", "Loiter"]
    state = quietly(path).mission_state.values
    assert state.tolist() == ["Stabilize"] * 10 + ["Loiter"] * 20


@pytest.mark.parametrize(
    ("week", "second", "utc"),
    [
        (0, 0.0, "1980-01-06T00:00:00.000"),
        (77, 259_200.0 + 0.5, "1981-06-30T23:59:60"),  # the first leap second itself
        (1356, 0.0, "2005-12-31T23:59:47.000"),
        (1800, 0.0, "2014-07-05T23:59:44.000"),
        (1851, 259_200.0 + 15.0, "2015-06-30T23:59:59.000"),
        (1851, 259_200.0 + 17.0, "2015-07-01T00:00:00.000"),
        (1930, 0.0, "2016-12-31T23:59:43.000"),
        (1930, 18.0, "2017-01-01T00:00:00.000"),
        (2400, 0.0, "2026-01-03T23:59:42.000"),
    ],
)
def test_gps_time_has_the_leap_seconds_of_its_date(week, second, utc):
    if ":60" not in utc:
        assert format_wall_time(gps_to_unix(week, second)).startswith(utc)
    else:
        assert gps_to_unix(week, second) == pytest.approx(362_793_600.5, abs=1.0)


def test_units_of_a_text_log_are_those_that_it_names(tmp_path):
    path = tmp_path / "log"
    path.write_text(
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
        "FMT, 129, 44, FMTU, QBNN, TimeUS,FmtType,UnitIds,MultIds\n"
        "FMT, 130, 44, UNIT, QbZ, TimeUS,Id,Label\nFMT, 131, 44, MULT, Qbd, TimeUS,Id,Mult\n"
        "FMT, 150, 44, ABC, QBHf, TimeUS,Number,Volt,Len\n"
        "UNIT, 0, 118, V\nUNIT, 0, m, m\nUNIT, 0, 35, instance\nMULT, 0, 67, 0.001\nMULT, 0, 48, 1\n"
        "FMTU, 0, 150, s#vm, F-C0\n"
        "ABC, 1000, 4, 11400, 1.5\nABC, 1000, 9, 5000, 2.5\nABC, 2000, 4, 11300, 1.5\n"
    )
    raw = read_raw_log(path)
    assert raw["ABC"].units == {"Volt": "mV", "Len": "m"}
    assert raw["ABC"].fields["Volt"].tolist() == [11400, 11300]
    assert raw["ABC:9"].fields["Len"].tolist() == [2.5]
