"""Units in a container's metadata: NetCDF by the CF conventions, Parquet and Feather by Arrow's types and fields."""

import warnings

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from mufly.errors import InputError
from mufly.logs import LogWarning, read_log, read_raw_log, write_log

N = 150
SECONDS = 0.02 * np.arange(N)
ROLL = 12.0 * np.sin(SECONDS)
STAMPS = pd.Timestamp("2023-05-06 07:08:09") + pd.to_timedelta(np.arange(N) * 20, unit="ms")


def quietly(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        return read_log(path)


def netcdf(path, time, attrs=None, dim="time", **units):
    data = {"roll": (dim, ROLL, {"units": units.get("roll", "degrees")}), "ax": (dim, ROLL, {"units": "g"})}
    xr.Dataset(data, {dim: (dim, time, attrs or {})}).to_netcdf(path, engine="scipy")
    return path


@pytest.mark.parametrize(
    ("unit", "scale", "start"),
    [
        ("milliseconds since 2023-05-06 07:08:09", 1e3, "2023-05-06T07:08:09"),
        ("hours since 2023-05-06", 1 / 3600, "2023-05-06T00:00:00"),
        ("seconds since 2023-05-06T09:08:09+02:00", 1.0, "2023-05-06T07:08:09"),
        ("us", 1e6, ""),
        ("min", 1 / 60, ""),
    ],
)
def test_the_unit_of_a_netcdf_files_time_is_the_one_that_it_names(tmp_path, unit, scale, start):
    """Before: 149 steps of 20 ms were read as 2980 s, whatever the attribute said."""
    raw = read_raw_log(netcdf(tmp_path / "a.nc", SECONDS * scale, {"units": unit}))
    assert raw["table"].time == pytest.approx(SECONDS, abs=1e-8)
    assert raw.start_time.startswith(start)
    assert bool(raw.start_time) == bool(start)
    data = quietly(tmp_path / "a.nc")
    assert np.nanmax(data["roll"]) == pytest.approx(np.radians(ROLL.max()))
    assert data["roll"].attrs["units"] == "rad"
    assert np.nanmax(data.ax) == pytest.approx(ROLL.max() * 9.80665)


def test_what_xarray_writes_of_datetimes_and_timedeltas_is_read(tmp_path):
    for time, start in ((STAMPS, "2023-05-06T07:08:09"), (pd.to_timedelta(SECONDS, unit="s"), "")):
        xr.Dataset({"x": ("time", ROLL)}, {"time": time}).to_netcdf(tmp_path / "a.nc", engine="scipy")
        raw = read_raw_log(tmp_path / "a.nc")
        assert raw["table"].time == pytest.approx(SECONDS, abs=1e-8)
        assert raw.start_time.startswith(start)


def test_a_netcdf_time_of_another_name_is_found_and_of_an_unknown_unit_refused(tmp_path):
    path = netcdf(tmp_path / "a.nc", 1e3 * SECONDS, {"units": "ms"}, dim="sample_time")
    assert read_raw_log(path)["table"].time == pytest.approx(SECONDS)
    with pytest.raises(InputError, match=r"time: 'fortnights' is not a unit of time"):
        read_raw_log(netcdf(tmp_path / "b.nc", SECONDS, {"units": "fortnights"}))
    far = read_raw_log(netcdf(tmp_path / "far.nc", 1e18 + 1e15 * SECONDS, {"units": "s since 2020-01-01"}))
    assert far.start_time == ""
    with pytest.raises(InputError, match="'the flood' is not a date"):
        read_raw_log(netcdf(tmp_path / "c.nc", SECONDS, {"units": "days since the flood"}))


def test_a_unit_that_is_not_known_or_contradicts_the_name_is_said(tmp_path):
    path = netcdf(tmp_path / "a.nc", SECONDS, {"units": "s"}, roll="smoot")
    with pytest.warns(LogWarning, match=r"unknown units, values unchanged: smoot \(roll\)"):
        read_log(path)
    data = {"roll_rad": ("time", ROLL, {"units": "degrees"}), "x": ("time", ROLL, {"units": "g"})}
    xr.Dataset(data, {"time": ("time", SECONDS, {"units": "s"})}).to_netcdf(tmp_path / "b.nc", engine="scipy")
    notes = " ".join(read_raw_log(tmp_path / "b.nc").notes)
    assert "roll_rad: the metadata state degrees, the name rad: the metadata are used" in notes
    assert "x: its unit 'g' fits two quantities or none" in notes
    assert np.nanmax(quietly(tmp_path / "b.nc").roll_rad) == pytest.approx(np.radians(ROLL.max()))


def arrow(path, time, fields=(), **options):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import feather, parquet

    arrays = {"time": time, "roll": pa.array(ROLL), "gyro_x": pa.array(ROLL)}
    known = {"roll": {"units": "degrees"}, "gyro_x": {"unit": "deg/s"}, "time": options.get("unit", {})}
    schema = pa.schema([pa.field(k, a.type, metadata=known[k]) for k, a in arrays.items()])
    table = pa.Table.from_arrays(list(arrays.values()), schema=schema)
    if path.suffix == ".feather":
        feather.write_feather(table, path)
    else:
        parquet.write_table(table, path)
    return path


@pytest.mark.parametrize("ending", [".parquet", ".feather"])
@pytest.mark.parametrize("kind", ["ms", "us UTC", "ns zone", "duration", "integer", "integer since"])
def test_arrows_times_have_their_unit_and_zone(tmp_path, ending, kind):
    """Before: a column of timestamps was text, and integers with their unit in the metadata were seconds."""
    pa = pytest.importorskip("pyarrow")
    ms = 20 * np.arange(N)
    time = {
        "ms": pa.array(STAMPS.astype("datetime64[ms]")),
        "us UTC": pa.array(STAMPS, pa.timestamp("us", "UTC")),
        "ns zone": pa.array(STAMPS, pa.timestamp("ns", "Europe/Zurich")),
        "duration": pa.array(ms, pa.duration("ms")),
        "integer": pa.array(ms),
        "integer since": pa.array(ms),
    }[kind]
    unit = {"integer": "ms", "integer since": "milliseconds since 2023-05-06 07:08:09"}.get(kind)
    raw = read_raw_log(arrow(tmp_path / f"a{ending}", time, unit={"units": unit} if unit else {}))
    assert raw["table"].time == pytest.approx(SECONDS, abs=1e-9)
    assert raw.start_time.startswith("" if kind in ("duration", "integer") else "2023-05-06T07:08:09")
    assert ("names no time zone" in " ".join(raw.notes)) == (kind == "ms")
    data = quietly(tmp_path / f"a{ending}")
    assert np.nanmax(data["roll"]) == pytest.approx(np.radians(ROLL.max()))
    assert np.nanmax(data.gyro_x) == pytest.approx(np.radians(ROLL.max()))


def test_a_frame_of_pandas_keeps_its_index_its_units_and_its_times(tmp_path):
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame({"roll": ROLL, "fix": STAMPS + pd.Timedelta("1s"), "mode": "hover"}, index=STAMPS)
    frame.attrs["units"] = {"roll": "deg"}
    frame.to_parquet(tmp_path / "a.parquet")
    raw = read_raw_log(tmp_path / "a.parquet")
    assert raw["table"].time == pytest.approx(SECONDS, abs=1e-9)
    assert raw["table"].units["roll"] == "deg"
    assert raw["table"].fields["fix"][0] == pytest.approx(STAMPS[0].timestamp() + 1.0)
    assert set(raw["table"].fields["mode"]) == {"hover"}


def test_nanoseconds_since_1970_lose_no_digit(tmp_path):
    pa = pytest.importorskip("pyarrow")
    ns = 1_723_197_600_000_000_001 + 100 * np.arange(N)
    raw = read_raw_log(arrow(tmp_path / "a.parquet", pa.array(ns)))
    assert np.diff(raw["table"].time) == pytest.approx(1e-7, rel=1e-6)


def test_what_was_converted_once_comes_back_as_it_was(tmp_path, data):
    for ending in (".nc", ".parquet"):
        back = quietly(write_log(data, tmp_path / f"a{ending}"))
        assert np.array_equal(back.time, data.time)
        for name in data.data_vars:
            assert back[name].attrs.get("units") == data[name].attrs.get("units")
            assert back[name].equals(data[name])
