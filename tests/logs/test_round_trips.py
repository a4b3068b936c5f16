"""What is written comes back: every format, odd numbers, missing values, cut files."""

import contextlib
import warnings

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mufly.errors import InputError
from mufly.logs import (
    LOG_WRITERS,
    LogWarning,
    detect_log_format,
    read_log,
    read_raw_log,
    read_recording,
    write_log,
)

KINDS = {".csv": "CSV", ".parquet": "Parquet", ".nc": "NetCDF", ".mcap": "MCAP", ".ulg": "ULog"}


def quietly(path, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        return read_log(path, **options)


@pytest.mark.parametrize("ending", LOG_WRITERS)
def test_every_format_brings_back_the_signals_to_the_bit(tmp_path, data, ending):
    path = write_log(data, tmp_path / f"log{ending}")
    assert detect_log_format(path) == KINDS[ending]
    back = read_log(path)
    assert np.array_equal(back.time, data.time)
    for name in ("measured_attitude", "measured_rates", "motor_input", "flap"):
        assert back[name].dims == data[name].dims
        assert np.array_equal(back[name], data[name], equal_nan=True), name
        assert back[name].attrs["units"] == data[name].attrs["units"]
    assert back.mission_state.values.tolist() == data.mission_state.values.tolist()
    assert back.rotor.values.tolist() == ["upper", "lower"]


@pytest.mark.parametrize("ending", [".parquet", ".nc", ".mcap", ".ulg"])
def test_events_and_attributes_come_back_where_the_format_has_room(tmp_path, data, ending):
    back = read_log(write_log(data, tmp_path / f"log{ending}"))
    assert back.event_text.values.tolist() == data.event_text.values.tolist()
    assert back.event_time.values.tolist() == data.event_time.values.tolist()
    assert back.attrs["vehicle"] == "mufly-1.1"
    assert back.attrs["seed"] == 3
    assert back.attrs["tags"] == ["a", "b"]


numbers = st.floats(allow_nan=True, allow_infinity=False, width=64)


@settings(max_examples=25)
@given(
    arrays(np.float64, st.tuples(st.integers(1, 12), st.just(3)), elements=numbers),
    st.sampled_from(sorted(LOG_WRITERS)),
)
def test_any_numbers_come_back(tmp_path_factory, values, ending):
    time = 0.125 * np.arange(len(values))
    data = xr.Dataset(
        {"measured_velocity": (("time", "axis"), values, {"units": "m/s", "long_name": "velocity"})},
        {"time": ("time", time, {"units": "s"}), "axis": ["N", "E", "D"]},
    )
    path = write_log(data, tmp_path_factory.mktemp("any") / f"log{ending}")
    assert np.array_equal(quietly(path).measured_velocity, values, equal_nan=True)


def test_pyulog_itself_reads_what_was_written(tmp_path, data):
    from pyulog import ULog

    log = ULog(str(write_log(data, tmp_path / "log.ulg")))
    table = log.data_list[0].data
    assert not log.file_corruption
    assert np.array_equal(table["timestamp"], np.rint(data.time.values * 1e6).astype(np.uint64))
    assert np.array_equal(table["measured_attitude_pitch"], data.measured_attitude.sel(angle="pitch"))
    assert [m.message for m in log.logged_messages] == [
        "hover: altitude reached",
        "landing: touch-down, softly",
    ]
    assert log.logged_messages[1].log_level_str() == "WARNING"
    assert [m.timestamp for m in log.logged_messages] == np.rint(1e6 * data.event_time.values).tolist()


def test_a_description_longer_than_one_ulog_message_survives(tmp_path, data):
    data.attrs["story"] = "µ" * 70_000
    data["event_text"] = ("event", ["a" * 70_000, "touch-down"])
    path = write_log(data, tmp_path / "log.ulg")
    assert read_log(path).attrs["story"] == "µ" * 70_000
    said = [text for _, _, text in read_raw_log(path).messages]
    assert len(said[0]) > 65_000  # what a message has room for
    assert said[1] == "landing: touch-down"
    wide = {f"x{k}": ("time", np.zeros(2), {"units": "1"}) for k in range(6000)}
    with pytest.raises(InputError, match="6000 columns do not fit one ULog message; choose fewer signals"):
        write_log(xr.Dataset(wide, {"time": ("time", [0.0, 1.0])}), tmp_path / "wide.ulg")


def test_what_becomes_a_recording_is_read_as_one(tmp_path, data):
    back = read_recording(write_log(data, tmp_path / "log.mcap"))
    assert back.attrs["complete"]
    assert np.array_equal(back.measured_attitude, data.measured_attitude)


@settings(max_examples=20)
@given(st.floats(0.02, 1.0))
def test_a_ulog_file_cut_off_anywhere_is_read_up_to_the_cut_or_refused_in_words(tmp_path_factory, make_signals, share):
    folder, data = tmp_path_factory.mktemp("cut"), make_signals()
    whole = write_log(data, folder / "log.ulg").read_bytes()
    path = folder / "cut.ulg"
    path.write_bytes(whole[: int(share * len(whole))])
    if share < 0.1:  # within the definitions
        with contextlib.suppress(InputError):
            quietly(path)
        return
    back = quietly(path)
    n = back.sizes["time"]
    assert 0 < n <= data.sizes["time"]
    assert np.array_equal(back.measured_attitude, data.measured_attitude[:n])


def test_a_file_that_is_there_stays_until_the_new_one_is_whole(tmp_path, data):
    path = write_log(data, tmp_path / "log.ulg")
    before = path.read_bytes()
    with pytest.raises(InputError, match="ULog has no time before 0"):
        write_log(data.assign_coords(time=data.time - 1.0), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["log.ulg"]


def test_an_unknown_ending_is_refused(tmp_path, data):
    with pytest.raises(InputError, match=r"\.csv, \.parquet, \.nc, \.mcap, \.ulg"):
        write_log(data, tmp_path / "log.xlsx")


def test_without_pyarrow_parquet_says_what_to_install(tmp_path, data, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError, match=r"pip install 'mufly\[parquet\]'"):
        write_log(data, tmp_path / "log.parquet")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\x00" * 500, "contains only zeros"),
        (b"\x89HDF\r\n\x1a\n" + b"\x00" * 100, "HDF5"),
        (b"MATLAB 5.0 MAT-file" + b"\x00" * 100, "MATLAB"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 1\n", "Git LFS"),
        (b"ULog\x01\x12\x35\x01" + b"\x00" * 8, "without data"),
        (b"PAR1" + b"\x00" * 40, "damaged Parquet"),
        (b"CDF\x01" + b"\x07" * 40, "damaged NetCDF"),
        (b"Dear reader, this is a letter.", "not a log in a known format"),
        (b"\xa3\x95\x80" + b"\x01" * 100, "DataFlash"),
    ],
)
def test_wrong_files_are_refused_in_one_line(tmp_path, content, words):
    path = tmp_path / "wrong"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_log(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_raw_log(tmp_path / "none.ulg")
