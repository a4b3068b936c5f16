"""The comparison of methods: figures of the loops as they fly, the verdict's criteria, and the command with flights."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.control import app
from mufly.control import DesignSettings, FlightController, design_flight_controller
from mufly.control.comparison import (
    ControllerComparison,
    FlightFigures,
    MethodFigures,
    judge_comparison,
    loop_figures,
    sensor_noise,
)
from mufly.errors import InputError
from mufly.flight.monte_carlo import Campaign
from mufly.mission import load_mission
from mufly.vehicle import Vehicle


@pytest.fixture(scope="module")
def row(vehicle: Vehicle, controller: FlightController) -> MethodFigures:
    loops = [loop_figures(vehicle, d, (0.6, 0.5)) for d in (controller.heave_yaw, controller.roll_pitch)]
    return MethodFigures("hinf", loops[0], loops[1], controller.cascade.sensitivity_peak_dB)


def _judge(*rows: MethodFigures) -> ControllerComparison:
    return judge_comparison("vehicle", 200.0, rows)


def test_figures_are_those_of_the_sampled_loop(
    vehicle: Vehicle, controller: FlightController, row: MethodFigures
) -> None:
    loop = row.roll_pitch
    assert loop.sampled is controller.roll_pitch.sampled_loop
    assert (loop.order, loop.multiply_adds) == (8, 72)
    assert loop.disk.margin == pytest.approx(0.83, abs=0.01)
    assert loop.input_noise == pytest.approx(0.0264, abs=2e-4)
    # 0.03 deg/s/sqrt(Hz) behind 60 Hz.
    assert np.degrees(sensor_noise(vehicle, ("phi", "p"))) == pytest.approx([0.1, 0.03 * np.sqrt(60 * np.pi / 2)])


def test_the_verdict_names_what_decided_it(row: MethodFigures) -> None:
    quiet = replace(row, method="ltr", roll_pitch=replace(row.roll_pitch, input_noise=0.005))
    found = _judge(row, quiet)
    assert found.recommended == "ltr"
    assert "decided by servo activity of 0.50 %" in found.verdict
    wide = replace(
        row,
        method="h2",
        roll_pitch=replace(row.roll_pitch, disk=replace(row.roll_pitch.disk, margin=1.2)),
        heave_yaw=replace(row.heave_yaw, disk=replace(row.heave_yaw.disk, margin=1.1)),
    )
    found = _judge(row, quiet, wide)
    assert found.recommended == "h2"
    assert "the disk margin of its weaker loop, 1.10" in found.verdict
    fragile = replace(wide, roll_pitch=replace(wide.roll_pitch, mu_upper=1.3))
    found = _judge(row, fragile)
    assert found.recommended == "hinf"
    assert "H2 is out: roll-pitch has mu up to 1.30" in found.verdict
    flown = [
        replace(quiet, flights=FlightFigures(100, 60, 0.5, 0.69, 0.2)),
        replace(row, flights=FlightFigures(100, 99, 0.95, 1.0, 0.1)),
    ]
    found = _judge(*flown)
    assert found.recommended == "hinf"
    assert "LQG/LTR succeeds in fewer flights" in found.verdict
    assert "99 of 100" in str(found)
    assert "no method meets" in _judge(fragile).verdict


def test_another_method_is_another_campaign(vehicle: Vehicle) -> None:
    mission = load_mission("box-on-leg")
    plain = Campaign.create_checked(vehicle, mission)
    ltr = design_flight_controller(vehicle, settings=DesignSettings(method="ltr"))
    other = Campaign.create_checked(vehicle, mission, controller=ltr)
    assert other.controller is ltr
    assert plain.settings_hash != other.settings_hash


def test_command_compares_and_writes(tmp_path: Path) -> None:
    arguments = ["compare", "--methods", "ltr", "--frequencies", "5"]
    result = CliRunner().invoke(app, [*arguments, "--json", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["recommended"] == "ltr"
    (method,) = content["methods"]
    assert method["flights"] is None
    assert method["roll_pitch"]["disk"]["margin"] > 0.93
    assert (tmp_path / "compare.png").stat().st_size > 5000
    assert json.loads((tmp_path / "compare.json").read_text())["verdict"] == content["verdict"]
    with pytest.raises(InputError, match="--methods"):
        CliRunner().invoke(app, ["compare", "--methods", "pid"], catch_exceptions=False)
