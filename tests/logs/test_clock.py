"""Time that repeats, swaps, stops or runs backward; gaps; and signals brought onto one clock."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.logs import (
    LogWarning,
    common_clock,
    examine_time_stamps,
    find_gaps,
    read_log,
    read_raw_log,
    resample_signal,
    select_usable_samples,
    write_log,
)
from mufly.logs.raw_log import find_foreign_epoch_stamps

TIME = 0.01 * np.arange(500)


def test_a_sound_clock_has_no_faults():
    report = examine_time_stamps(TIME)
    assert report.describe_faults() == []
    assert report.rate_hz == pytest.approx(100)
    assert report.jitter_ratio < 1e-9


@given(st.lists(st.integers(1, 498), min_size=1, max_size=5, unique=True), st.integers(10, 300))
def test_every_gap_is_found_where_it_is(places, length):
    steps = np.full(499, 0.01)
    steps[places] += 0.01 * length
    time = np.concatenate(([0.0], np.cumsum(steps)))
    gaps = find_gaps(time)
    assert gaps[:, 0] == pytest.approx(time[np.sort(places)])
    assert gaps[:, 1] - gaps[:, 0] == pytest.approx(0.01 * (length + 1))


def test_gaps_are_said():
    time = np.delete(TIME, slice(100, 150))
    words = examine_time_stamps(time).describe_faults()
    assert words == ["1 gap, 0.51 s in all, the longest 0.51 s at 0.99 s (median step 10 ms)"]


def test_repeated_and_swapped_stamps_are_repaired_and_said():
    time = TIME.copy()
    time[50] = time[49]
    time[[200, 201]] = time[[201, 200]]
    time[300] = np.nan
    index, words = select_usable_samples(time, "log", "imu")
    assert (np.diff(time[index]) > 0).all()
    assert len(index) == 498
    assert len(words) == 3
    assert all(w.startswith("imu: ") for w in words)


def test_a_clock_that_was_reset_is_refused():
    time = TIME.copy()
    time[250:] -= 2.4
    with pytest.raises(InputError, match=r"time runs backward once, by 2\.39 s .* sample 250; the clock was reset"):
        select_usable_samples(time, "log.csv", "")


def test_rows_in_disorder_are_refused():
    with pytest.raises(InputError, match="mixed up"):
        select_usable_samples(np.random.default_rng(0).permutation(TIME), "log.csv", "")


def test_a_few_swaps_in_a_long_record_are_no_reset_and_many_are():
    time = 0.01 * np.arange(10_000)
    for swaps, reset in ((195, False), (205, True)):
        places = 40 * np.arange(1, swaps + 1)
        order = np.arange(10_000)
        order[places], order[places + 1] = places + 1, places
        report = examine_time_stamps(time[order])
        assert (report.backward, report.is_reset) == (swaps, reset)
        assert report.longest_step_back_s == pytest.approx(0.01)
        assert report.first_back == 41
    few = np.arange(100)
    few[[10, 11, 20, 21, 30, 31]] = few[[11, 10, 21, 20, 31, 30]]
    assert not examine_time_stamps(time[few]).is_reset  # three may be in any record


def test_the_clock_of_a_log_is_that_of_most_topics_not_of_the_longest():
    board = {name: 10.0 + 0.1 * np.arange(20) for name in ("imu", "baro")}
    utc = {"gps": 1.7e9 + 0.01 * np.arange(5000)}
    foreign, words = find_foreign_epoch_stamps(board | utc)
    assert {name: f.all() for name, f in foreign.items()} == {"imu": False, "baro": False, "gps": True}
    assert len(words) == 1
    assert words[0].startswith("gps: ")
    # Of equals the one with more stamps; where no clock has the half of them nobody can say.
    foreign, _ = find_foreign_epoch_stamps({"imu": board["imu"]} | utc)
    assert foreign["imu"].all()
    assert not foreign["gps"].any()
    foreign, words = find_foreign_epoch_stamps(
        {"imu": board["imu"], "clock": 3e8 + board["imu"], "week": 6e5 + board["imu"]}
    )
    assert not any(f.any() for f in foreign.values())
    assert words == []


def test_a_clock_that_stands_still_says_so():
    assert examine_time_stamps(np.full(100, 3.0)).describe_faults() == ["the clock stands still"]


def test_a_csv_with_a_clock_reset_is_refused_and_a_swap_is_said(tmp_path):
    path = tmp_path / "log.csv"
    lines = [f"{t:.2f},{k}" for k, t in enumerate(TIME)]
    path.write_text("t_s,U_V\n" + "\n".join([*lines, *lines]))
    with pytest.raises(InputError, match="runs backward"):
        read_log(path)
    lines[10], lines[11] = lines[11], lines[10]
    path.write_text("t_s,U_V\n" + "\n".join(lines))
    with pytest.warns(LogWarning, match="wrong order and were sorted"):
        data = read_log(path)
    assert data.U.values == pytest.approx(np.arange(500))


def test_a_straight_line_is_resampled_exactly():
    onto = 0.013 * np.arange(380)
    out = resample_signal(TIME, 3 * TIME - 1, onto)
    assert out == pytest.approx(3 * onto - 1)


def test_a_held_signal_keeps_its_last_value():
    out = resample_signal(
        np.array([0.0, 1.0, 2.0]), np.array([5.0, 6.0, 7.0]), np.array([0.0, 0.5, 1.0, 1.9, 2.0]), hold=True
    )
    assert out.tolist() == [5, 5, 6, 6, 7]
    later = resample_signal(np.arange(100.0, 103.0), np.arange(3.0), np.array([99.5, 102.4, 103.0, 103.5]), hold=True)
    np.testing.assert_array_equal(later, [np.nan, 2.0, 2.0, np.nan])  # the last one for as long as a step


def test_a_gap_stays_a_gap():
    keep = np.r_[0:200, 260:500]
    out = resample_signal(TIME[keep], TIME[keep], TIME)
    assert np.isnan(out[201:259]).all()
    assert np.isfinite(out[:200]).all()
    assert np.isfinite(out[260:]).all()


def test_nothing_is_made_up_before_the_beginning_and_after_the_end():
    out = resample_signal(TIME, TIME, np.array([-0.02, 0.0, 4.99, 5.01]))
    assert np.isnan(out).tolist() == [True, False, False, True]


def test_what_is_faster_than_half_the_new_rate_does_not_fold_down_and_nothing_is_delayed():
    time = 0.001 * np.arange(8000)
    slow, fast = (
        np.sin(2 * np.pi * 1.0 * time),
        np.sin(2 * np.pi * 101.0 * time),
    )  # would fold to 1 Hz at 50 Hz
    onto = 0.02 * np.arange(400)
    inner = slice(20, -20)
    out = resample_signal(time, slow + fast, onto)[inner]
    assert out == pytest.approx(np.sin(2 * np.pi * onto[inner]), abs=5e-3)


def test_a_wild_time_stamp_is_named_before_memory_runs_out():
    with pytest.raises(InputError, match="a time stamp is wrong"):
        common_clock([(0.0, 1e12)], 100.0)


def dataset(time, **columns):
    import xarray as xr

    return xr.Dataset({k: ("time", v, {"units": "1"}) for k, v in columns.items()}, {"time": ("time", time)})


def written(tmp_path, time, **columns):
    path = tmp_path / "log.csv"
    head = ",".join(["t_s", *columns])
    np.savetxt(path, np.column_stack([time, *columns.values()]), delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def test_an_uneven_clock_is_said_be_it_by_jitter_or_by_gaps(tmp_path):
    shaken = TIME + 0.002 * np.sin(np.arange(500))
    with pytest.warns(LogWarning, match=r"clock is uneven \(steps vary by 1\d %\); give a rate"):
        read_log(written(tmp_path, shaken, x_m=TIME))
    holed = np.delete(TIME, slice(100, 150))
    with pytest.warns(LogWarning, match=r"clock is uneven \(1 gap\)"):
        read_log(written(tmp_path, holed, x_m=holed))


def test_a_recording_of_ours_comes_at_another_rate_and_in_order(tmp_path):
    data = dataset(TIME, x=np.sin(TIME), motor_input_like=np.floor(TIME))
    data["mission_state"] = ("time", np.where(TIME < 2.0, "hover", "landing"))
    path = write_log(data, tmp_path / "log.nc")
    data = read_log(path, rate_hz=25)
    # Text keeps its last value, and changes at the very sample at which it did.
    assert data.mission_state.values.tolist() == ["hover"] * 50 + ["landing"] * 75
    assert np.diff(data.time) == pytest.approx(0.04)
    assert data.x.values[2:-2] == pytest.approx(np.sin(data.time.values[2:-2]), abs=1e-3)
    assert data.attrs["rate_hz"] == 25
    order = np.arange(500)
    order[[200, 201]] = [201, 200]
    path = write_log(dataset(TIME[order], x=TIME[order]), tmp_path / "swapped.nc")
    with pytest.warns(LogWarning, match="wrong order and were sorted"):
        assert read_log(path).x.values.tolist() == TIME.tolist()


def two_topics(make_dataflash, tmp_path, first_us, second_us):
    path = tmp_path / "log.bin"
    rows = [[(int(t), k, 0.0, 0.0) for k, t in enumerate(us)] for us in (first_us, second_us)]
    kinds = [(10, "RATE", "Qfff", "TimeUS,R,P,Y", rows[0]), (11, "BAT", "Qfff", "TimeUS,Volt,X,Z", rows[1])]
    path.write_bytes(make_dataflash(kinds))
    return path


@pytest.mark.filterwarnings("ignore::mufly.logs.LogWarning")
def test_topics_of_one_clock_keep_it_and_others_come_to_a_round_rate(tmp_path, make_dataflash):
    us = np.cumsum(np.where(np.arange(100) % 2, 18_000, 22_000))
    data = read_log(two_topics(make_dataflash, tmp_path, us, us))
    assert data.time.values == pytest.approx((us - us[0]) / 1e6)
    us = 20_030 * np.arange(100)  # 49.925 Hz
    data = read_log(two_topics(make_dataflash, tmp_path, us, us[::3] + 5000))
    assert np.diff(data.time) == pytest.approx(0.02)
    us = 810_372 * np.arange(100)  # 1.23400 Hz
    data = read_log(two_topics(make_dataflash, tmp_path, us, us[::3] + 5000))
    assert data.attrs["rate_hz"] == pytest.approx(1.23)


def test_the_reference_of_heading_is_shifted_by_whole_turns_to_the_measurement(tmp_path):
    yaw = np.unwrap(np.mod(3 * TIME, 2 * np.pi))
    path = written(
        tmp_path,
        TIME,
        **{"measured_attitude_yaw [rad]": yaw + 4 * np.pi, "reference_attitude_yaw [rad]": yaw + 0.3},
    )
    data = read_log(path)
    apart = data.reference_attitude.sel(angle="yaw") - data.measured_attitude.sel(angle="yaw")
    assert apart.values == pytest.approx(0.3)


def clocked(tmp_path, stamps, head="timestamp", name="log.csv"):
    path = tmp_path / name
    path.write_text(f"{head},U_V\n" + "\n".join(f"{s},{k % 7}" for k, s in enumerate(stamps)))
    return read_raw_log(path)


@pytest.mark.parametrize("step_s", [60.0, 10.0, 1.0, 0.02, 0.001])
@pytest.mark.parametrize(("unit", "scale"), [("", 1), ("milli", 1e3), ("micro", 1e6), ("nano", 1e9)])
def test_an_epoch_is_told_by_its_magnitude_whatever_the_step(tmp_path, unit, scale, step_s):
    """Before: milliseconds of one row a second were microseconds, and the log of the year 56575."""
    start = 1_683_356_889
    counts = [int(start * scale) + round(k * step_s * scale) for k in range(80)]
    if step_s * scale < 1:
        counts = [f"{start + k * step_s:.3f}" for k in range(80)]
    raw = clocked(tmp_path, counts)
    assert raw["table"].time == pytest.approx(step_s * np.arange(80), abs=1e-5)
    assert raw.start_time.startswith("2023-05-06T07:08:09")
    assert f"{unit}seconds since 1970, 2023-05-06" in raw.notes[0]


def test_counters_of_a_board_that_runs_for_long_are_no_epoch(tmp_path):
    """1.7e9 microseconds are 28 minutes since the start, and 1.7e12 nanoseconds as well."""
    for counts, step in (
        (1_700_000_000 + 4000 * np.arange(99), 0.004),
        (17 * 10**11 + 2_500_000 * np.arange(99), 0.0025),
    ):
        raw = clocked(tmp_path, counts)
        assert np.diff(raw["table"].time) == pytest.approx(step)
        assert raw.start_time == ""


def test_a_named_unit_that_leads_to_no_year_is_believed_and_said(tmp_path):
    raw = clocked(tmp_path, 1_683_356_889_000 + 20 * np.arange(99), head="timestamp (s)")
    assert raw["table"].time == pytest.approx(20.0 * np.arange(99))
    assert raw.start_time == ""
    assert "not in the years of possible logs; in ms they would be of 2023" in raw.notes[0]


@pytest.mark.parametrize(
    ("head", "size", "step", "unit_s"),
    [
        ("t (ms)", 2**32, 20, 1e-3), ("t (us)", 2**32, 2500, 1e-6), ("t (ms)", 2**16, 100, 1e-3),
        ("t (us)", 2**24, 5000, 1e-6),
        ("t (s)", 2**32 / 1e6, 0.02, 1.0), ("t (ms)", 604_800_000, 200, 1e-3), ("t (s)", 86_400, 0.1, 1.0),
    ],
)  # fmt: skip
def test_a_counter_that_wraps_is_counted_on(tmp_path, head, size, step, unit_s):
    """Before: the half before or after the wrap was left out, as from another clock."""
    for turns in (1, 3):
        n = 400 if turns == 1 else max(400, min(int(2.3 * size / step), 4000))
        if turns == 3 and n * step < 2 * size:
            continue
        counts = np.mod(size - 150.5 * step + step * np.arange(n), size)
        counts = counts if isinstance(step, float) else np.floor(counts)
        raw = clocked(tmp_path, [f"{c:.10g}" for c in counts], head=head)
        time = raw["table"].time
        assert time - time[0] == pytest.approx(step * unit_s * np.arange(n), abs=1.01 * unit_s * (step >= 1) + 1e-5)
        wraps = int((np.diff(counts) < 0).sum())
        times = "once" if wraps == 1 else f"{wraps} times"
        assert re.search(rf"(wraps|anew|midnight) {times}, first at", raw.notes[-1])


def test_a_counter_of_a_signed_number_wraps_to_its_least(tmp_path):
    counts = 2**31 - 1000 + 20 * np.arange(200)
    raw = clocked(tmp_path, counts.astype(np.int64).astype(np.int32), head="t (ms)")
    assert np.diff(raw["table"].time) == pytest.approx(0.02)


@pytest.mark.parametrize("last", [3_000_000, 65_000, 2**31])
def test_a_restart_is_no_wrap(tmp_path, last):
    counts = np.r_[last - 20 * np.arange(200)[::-1], 12 + 20 * np.arange(200)]
    path = tmp_path / "log.csv"
    path.write_text("t (ms),U_V\n" + "\n".join(f"{c},1" for c in counts))
    assert "wraps" not in " ".join(read_raw_log(path).notes)
    with pytest.raises(InputError, match="runs backward"):
        select_usable_samples(1e-3 * counts, "log", "")


@pytest.mark.parametrize(
    ("head", "cells", "start"),
    [
        ("Date,Time", ["2024-05-01,23:59:59.{k:03d}", "2024-05-02,00:00:00.{k:03d}"], "2024-05-01T23:59:59"),
        ("Datum;Zeit", ["01.05.2024;23:59:59,{k:03d}", "02.05.2024;00:00:00,{k:03d}"], "2024-05-01T23:59:59"),
        ("Date,Time", ["04/05/2024,23:59:59.{k:03d}", "05/05/2024,00:00:00.{k:03d}"], "2024-05-04T23:59:59"),
        ("Date,Time", ["20240501,23:59:59.{k:03d}", "20240501,00:00:00.{k:03d}"], "2024-05-01T23:59:59"),
        ("Date,Time", ["2024-05-01,11:59:59.{k:03d} PM", "2024-05-02,12:00:00.{k:03d} AM"], "2024-05-01T23:59:59"),
        ("timestamp", ["01.05.2024 23:59:59.{k:03d}", "02.05.2024 00:00:00.{k:03d}"], "2024-05-01T23:59:59"),
        ("time", ["2024-05-01T23:59:59.{k:03d}+02:00", "2024-05-02T00:00:00.{k:03d}+02:00"], "2024-05-01T21:59:59"),
        ("time", ["23:59:59.{k:03d}", "00:00:00.{k:03d}"], ""),
    ],
)  # fmt: skip
def test_a_date_and_a_time_of_the_day_make_a_clock_past_midnight(tmp_path, head, cells, start):
    separator = ";" if ";" in head else ","
    path = tmp_path / "log.csv"
    rows = [cell.format(k=k) for cell in cells for k in range(0, 1000, 100)]
    path.write_text(head + f"{separator}U_V\n" + "\n".join(f"{r}{separator}7" for r in rows))
    raw = read_raw_log(path)
    time = raw["table"].time - raw["table"].time[0]
    assert time == pytest.approx(0.1 * np.arange(20), abs=1e-6)
    assert raw.start_time.startswith(start)
    assert bool(raw.start_time) == bool(start)
    assert list(raw["table"].fields) == ["U"]
    if "+02" not in cells[0]:
        assert "names no time zone" in " ".join(raw.notes) or "without a date" in " ".join(raw.notes)


def test_seconds_and_nanoseconds_of_ros_are_one_clock(tmp_path):
    path = tmp_path / "log.csv"
    ns = 1_683_356_889_990_000_000 + 4_000_000 * np.arange(100)
    path.write_text("stamp.secs,stamp.nsecs,x_m\n" + "\n".join(f"{n // 10**9},{n % 10**9},1" for n in ns.tolist()))
    raw = read_raw_log(path)
    assert np.diff(raw["table"].time) == pytest.approx(0.004, abs=1e-9)
    assert raw.start_time.startswith("2023-05-06T07:08:09.990")
    assert list(raw["table"].fields) == ["x"]


def test_of_two_columns_with_the_name_of_a_clock_the_one_that_runs_is_taken(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("T,time_ms,U_V\n" + "\n".join(f"{20 - k % 3},{20 * k},7" for k in range(60)))
    raw = read_raw_log(path)
    assert raw["table"].time == pytest.approx(0.02 * np.arange(60))
    assert list(raw["table"].fields) == ["T", "U"]
