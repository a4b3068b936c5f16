"""``mufly log``, as a user calls it."""

import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError
from mufly.logs import read_log

SAMPLE = Path(__file__).resolve().parents[3] / "shared/data/flight/pyulog/sample.ulg"
TIME = 0.01 * np.arange(3000)


def run(*arguments):
    result = CliRunner().invoke(app, ["log", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture
def log(tmp_path):
    """A bench log with a gap, an outlier, a constant channel and an angle whose unit nobody names."""
    roll = 20 * np.sin(2 * TIME)
    rate = np.radians(40 * np.cos(2 * TIME))
    rate[700] = 9.0
    rate += 0.001 * np.random.default_rng(0).standard_normal(len(TIME))
    keep = np.r_[0:1000, 1100:3000]
    table = np.column_stack([1e3 * TIME, roll, rate, np.full(len(TIME), 7.4)])[keep]
    path = tmp_path / "bench.csv"
    np.savetxt(path, table, delimiter=",", header="t (ms),measured_attitude_roll,p,U (V)", comments="", fmt="%.9g")
    return path


COLUMNS = (
    "-c",
    "measured_rates.p=p(rad/s)",
    "-c",
    "battery_voltage=U",
    "-c",
    "measured_attitude.roll=measured_attitude_roll",
)


def test_info_says_what_is_wrong(log):
    text = " ".join(run("info", log, *COLUMNS).output.split())
    assert "CSV, 29.99 s" in text
    assert "taken to be in deg" in text
    assert "1 gap, 1.01 s in all" in text
    assert "measured_rates.p: 1 outlier, at 7.00 s" in text
    assert "constant throughout: battery_voltage (7.4 V)" in text


def test_info_in_json_holds_the_same(log):
    found = json.loads(run("info", log, *COLUMNS, "--json").stdout)
    assert found["format"] == "CSV"
    assert found["topics"][0]["gaps_s"] == [[pytest.approx(9.99), pytest.approx(11.0)]]
    signals = {s["name"]: s for s in found["signals"]}
    assert signals["measured_rates.p"]["outlier_times_s"] == [pytest.approx(7.0)]
    assert signals["measured_attitude.roll"]["largest"] == pytest.approx(np.radians(20), rel=1e-3)
    assert any(d["response"] == "measured_rates.p" for d in found["delays"]) or found["delays"] == []


def test_info_of_a_sound_log_says_so(tmp_path):
    path = tmp_path / "sound.csv"
    np.savetxt(path, np.column_stack([TIME, np.sin(TIME)]), delimiter=",", header="t_s,x_m", comments="")
    assert "No faults found." in run("info", path).output


def test_plot_writes_pictures_of_each_kind_and_spectra(log, tmp_path):
    out = tmp_path / "pictures"
    run("plot", log, *COLUMNS, "--out", out)
    run("plot", log, "measured_rates.p", "table/U", *COLUMNS, "--out", out, "--spectrum", "--from", 12)
    names = {p.name for p in out.iterdir()}
    assert {"bench-attitude.png", "bench-attitude.svg", "bench-rates.png", "bench-battery.png"} <= names
    assert "bench-rates-spectrum.png" in names
    svg = (out / "bench-attitude.svg").read_text()
    assert "(deg)" in svg
    assert "Time (s)" in svg


def test_plot_refuses_what_is_not_there(log):
    with pytest.raises(InputError, match="there is no such signal"):
        run("plot", log, "measured_altitude")
    with pytest.raises(InputError, match="has no such field"):
        run("plot", log, "table/V")
    with pytest.raises(InputError, match="has no data in this time span"):
        run("plot", log, "--from", 100, "--out", "nowhere")


@pytest.mark.parametrize("ending", ["csv", "nc", "mcap", "ulg", "parquet"])
def test_convert_resamples_and_keeps_gaps(log, tmp_path, ending):
    out = tmp_path / f"out.{ending}"
    said = run("convert", log, out, *COLUMNS, "--rate", 50, "--from", 5, "--to", 20)
    assert "3 signals, 751 instants" in " ".join(said.output.split())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = read_log(out)
    assert np.diff(data.time) == pytest.approx(0.02)
    known = {s["name"] for s in json.loads(run("info", out, "--json").stdout)["signals"]}
    assert {"measured_rates.p", "battery_voltage"} <= known
    gap = data.battery_voltage.sel(time=slice(10.01, 10.99))
    assert np.isnan(gap).all()
    assert np.nanmax(data.battery_voltage) == pytest.approx(7.4)


def test_export_is_convert_and_replaces_only_by_force(log, tmp_path):
    out = tmp_path / "out.csv"
    run("export", log, out, *COLUMNS)
    with pytest.raises(InputError, match="already exists"):
        run("export", log, out, *COLUMNS)
    run("export", log, out, *COLUMNS, "--force", "-s", "battery_voltage")
    assert list(read_log(out)) == ["battery_voltage"]
    with pytest.raises(InputError, match="ending"):
        run("convert", log, tmp_path / "out.doc")


def test_a_wrong_file_gives_one_line_and_status_1(tmp_path):
    path = tmp_path / "letter.txt"
    path.write_text("Dear reader")
    done = subprocess.run(
        [sys.executable, "-c", "from mufly.cli import main; main()", "log", "info", str(path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1].startswith(f"mufly: {path}: is not a log")
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not SAMPLE.exists(), reason="the measured data are not beside the project")
def test_the_px4_sample_loads_plots_and_converts(tmp_path):
    found = json.loads(run("info", SAMPLE, "--json").stdout)
    assert found["to_s"] == pytest.approx(68.99, abs=0.01)
    assert len(found["dropouts"]) == 4
    topics = {t["name"]: t for t in found["topics"]}
    assert len(topics["sensor_combined"]["gaps_s"]) == 6
    run("plot", SAMPLE, "measured_attitude", "sensor_combined/gyro_rad[0]", "--out", tmp_path)
    assert {"sample-attitude.png", "sample-sensor_combined.png"} <= {p.name for p in tmp_path.iterdir()}
    run("convert", SAMPLE, tmp_path / "sample.ulg", "--rate", 100)
    back = read_log(tmp_path / "sample.ulg")
    assert back.sizes["time"] == pytest.approx(6892, abs=3)  # from the first sample, at 0.07 s
    assert np.nanmax(back.measured_attitude.sel(angle="roll")) == pytest.approx(0.371, abs=0.003)


def test_convert_to_a_bag_of_ros_and_back(log, tmp_path):
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'mufly[rosbag]'")
    recording, bag, back = tmp_path / "a.mcap", tmp_path / "a.rosbag2", tmp_path / "back.csv"
    assert run("convert", log, recording, "-c", "time=t (ms)", "-c", "battery_voltage=U (V)").exit_code == 0
    assert "2 topics, " in run("convert", recording, bag, "--rate", 10).output  # and the state
    assert run("convert", bag, back).exit_code == 0
    assert np.allclose(read_log(back).battery_voltage.dropna("time"), 7.4)
