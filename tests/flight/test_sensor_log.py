"""Listening to a vehicle's sensors: the flight is that of ideal ones, and errors are told against what is true."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError
from mufly.flight import (
    compute_reading_errors,
    draw_sensor_readings,
    fly_and_log_sensors,
    fly_mission,
    write_sensor_logs,
)
from mufly.flight.record.sensor_log import ReadingLog
from mufly.mission import load_mission
from mufly.sensors import parse_fault
from mufly.vehicle import load_vehicle


@pytest.fixture(scope="module")
def hop(tmp_path_factory):
    """Up, a step aside, down."""
    file = tmp_path_factory.mktemp("hop") / "hop.toml"
    file.write_text(
        "[take_off]\nheight_m = 0.6\nwait_s = 0.0\n[[waypoint]]\nposition_m = [0.2, 0.0, -0.6]\nwait_s = 0.0\n"
    )
    return load_mission(file)


@pytest.fixture(scope="module")
def logs(hop):
    faults = [parse_fault("sonar.jump=0.5@3s"), parse_fault("position.late=0.3@0s")]
    return fly_and_log_sensors(load_vehicle("mufly-1.1"), hop, seed=2, faults=faults, gust=0.1)


def test_listening_leaves_the_flight_as_it_was(hop, logs) -> None:
    alone = fly_mission("mufly-1.1", hop, seed=2, gust=0.1)
    true = np.array(logs["rotor_speed"].true)
    taken = np.array(logs["rotor_speed"].measured_s)
    flown = alone["truth_rotor_speed"].sel(time=taken[10:100], method="nearest", tolerance=1e-6)
    np.testing.assert_array_equal(flown.values, true[10:100])


def test_errors_are_those_of_the_sensors(logs) -> None:
    rates, fix, sonar = (compute_reading_errors(logs[name]) for name in ("rates", "position_fix", "ground_distance"))
    assert rates.rate_Hz == pytest.approx(200.0, rel=0.01)
    assert 0.0 < rates.deviation < 0.02
    assert fix.delay_s == pytest.approx(0.5, abs=0.05)
    assert fix.worst < 0.2
    assert sonar.worst > 0.45  # the jump
    assert sonar.unit == "m"


def test_headings_are_compared_around_the_circle() -> None:
    log = ReadingLog("position_fix", [0.0, 1.0], [0.0, 1.0], [np.array([0, 0, 0, 3.1])] * 2,
                    [np.array([0, 0, 0, -3.1])] * 2, [True, True])  # fmt: skip
    assert compute_reading_errors(log).worst < 0.1


def test_everything_is_drawn_and_written(logs, tmp_path) -> None:
    files = write_sensor_logs(logs, tmp_path)
    assert {f.stem for f in files} == set(logs)
    table = np.genfromtxt(tmp_path / "rates.csv", delimiter=",", skip_header=2)
    assert table.shape == (len(logs["rates"].arrival_s), 9)
    figure = draw_sensor_readings(logs)
    assert len(figure.axes) == len(logs)
    assert all("(" in ax.get_ylabel() for ax in figure.axes if ax.get_ylabel() != "clipping")


def test_the_command_tells_the_same_as_json_and_refuses_in_one_line(tmp_path, hop) -> None:
    from mufly.mission import format_mission_toml

    file = tmp_path / "hop.toml"
    file.write_text(format_mission_toml(hop))
    runner = CliRunner()
    said = runner.invoke(app, ["sensors", "simulate", str(file), "--json", "--fault", "gyro.stuck=0@1s"])
    readings = {r["name"]: r for r in json.loads(said.stdout)["readings"]}
    assert readings["rates"]["unit"] == "rad/s"
    assert runner.invoke(app, ["sensors", "show"]).exit_code == 0
    assert "outliers" in runner.invoke(app, ["sensors", "faults"]).stdout
    wrong = runner.invoke(app, ["sensors", "simulate", "--fault", "gyro.melt"]).exception
    assert isinstance(wrong, InputError)
    assert "melt: is not a fault" in str(wrong)
