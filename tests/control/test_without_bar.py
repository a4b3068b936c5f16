"""A helicopter without a stabiliser bar: its poles, its design, and the servos that it needs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.control import app
from mufly.control import DesignSettings, disk_margin, sample_plant
from mufly.control.analysis.servo_map import SAFE_DISK_MARGIN, compute_servo_map, scale_roll_pitch_bandwidth
from mufly.control.designs import design_roll_pitch
from mufly.control.synthesis.weighting_schemes import ROLL_PITCH_WEIGHTS, fill_missing_weights
from mufly.dynamics import initial_state, linearise_vehicle, model_parameters
from mufly.dynamics.equations_of_motion import state_derivative
from mufly.dynamics.linearisation import LINEAR_INPUTS, extract_submodel
from mufly.errors import InputError
from mufly.vehicle import (
    Vehicle,
    find_unusual_parameters,
    format_vehicle_toml,
    list_parameters,
    load_vehicle,
    replace_parameters,
)

WITHOUT = {"stabiliser_bar.fitted": False}


@pytest.fixture(scope="module")
def bare(vehicle: Vehicle) -> Vehicle:
    return replace_parameters(vehicle, WITHOUT)


def test_a_file_without_a_bar_needs_no_parameters_of_it(vehicle: Vehicle, tmp_path: Path) -> None:
    text = format_vehicle_toml(replace_parameters(vehicle, WITHOUT))
    start, end = text.index("[stabiliser_bar.time_constant]"), text.index("[motor.")
    file = tmp_path / "bare.toml"
    file.write_text(text[:start] + text[end:])
    read = load_vehicle(file)
    assert not read.stabiliser_bar.fitted
    assert not any(p.key.startswith("stabiliser_bar") for p in list_parameters(read))
    assert any(p.key == "stabiliser_bar.linkage" for p in list_parameters(vehicle))
    assert [u.key for u in find_unusual_parameters(read)] == ["stabiliser_bar.fitted"]
    assert find_unusual_parameters(vehicle) == []


def test_the_bar_that_is_not_there_has_no_effect(bare: Vehicle, vehicle: Vehicle) -> None:
    rates = []
    for v in (bare, vehicle):
        for bar in ((0.0, 0.0), (0.2, -0.1)):
            x = initial_state(position=(0, 0, -5), bar_attitude=bar, rotor_speed=(350.0, 400.0))
            dx = np.empty_like(x)
            state_derivative(x, np.array([0.6, 0.6, 0.1, 0.1]), np.zeros(3), model_parameters(v), dx)
            rates.append(dx[6:13].copy())
    assert np.array_equal(rates[0], rates[1])
    assert not np.allclose(rates[2], rates[3], atol=1.0)


def test_without_the_bar_it_falls_over_and_with_it_it_swings(bare: Vehicle, vehicle: Vehicle) -> None:
    """Poles 1.83 +- 3.54j and 1.96 +- 3.84j (1/s): rotor drag above the centre of gravity, no restoring moment."""
    lateral = ["u", "v", "phi", "theta", "p", "q", "a_dw", "b_dw"]
    full = linearise_vehicle(bare).full
    poles = np.linalg.eigvals(extract_submodel(full, lateral, LINEAR_INPUTS[2:], ["phi"]).A)
    unstable = np.sort_complex(poles[poles.real > 0.0])
    assert unstable[[0, 2]] == pytest.approx([1.83 - 3.54j, 1.96 - 3.84j], abs=0.01)
    full = linearise_vehicle(vehicle).full
    poles = np.linalg.eigvals(extract_submodel(full, [*lateral, "bar_roll", "bar_pitch"], LINEAR_INPUTS[2:], ["phi"]).A)
    assert poles.real.max() < 0.0
    assert linearise_vehicle(bare).roll_pitch.nstates == 6


@pytest.mark.parametrize(("lag_ms", "least"), [(1, 1.0), (30, 0.95), (80, 0.7)])
def test_weights_follow_the_bar_and_hold_slow_servos(bare: Vehicle, lag_ms: float, least: float) -> None:
    slow = replace_parameters(bare, {"swash_plate.time_constant": lag_ms / 1e3})
    margins = []
    for settings in (
        fill_missing_weights(DesignSettings(), slow),
        DesignSettings(roll_pitch_weights=ROLL_PITCH_WEIGHTS),
    ):
        d = design_roll_pitch(linearise_vehicle(slow).roll_pitch, settings, 1 / 200)
        loop = sample_plant(d.plant, 1 / 200, 1), d.feedback_controller(d.discrete.to_state_space())
        margins.append(disk_margin(*loop).margin)
    assert margins[0] >= least
    assert margins[0] > 1.8 * margins[1]  # the weights of a vehicle with a bar ask for too much


def test_settings_that_state_weights_keep_them(bare: Vehicle, vehicle: Vehicle) -> None:
    own = replace(ROLL_PITCH_WEIGHTS, auxiliary=0.1)
    assert fill_missing_weights(DesignSettings(roll_pitch_weights=own), bare).roll_pitch_weights is own
    assert fill_missing_weights(DesignSettings(), vehicle).roll_pitch_weights == ROLL_PITCH_WEIGHTS
    s = fill_missing_weights(DesignSettings(), bare)
    assert scale_roll_pitch_bandwidth(s, 1.0) == s


def test_servo_map_knows_lag_frame_and_rate(bare: Vehicle) -> None:
    found = compute_servo_map(bare, lags_s=[0.01, 0.08], rates_Hz=[50.0, 400.0], frames_s=[0.0, 0.02])
    margin, speed = found.table.disk_margin, found.table.swash_plate_rate_rad_s
    assert (margin.sel(frame_s=0.0, rate_Hz=400.0) >= SAFE_DISK_MARGIN).all()
    assert (margin.sel(frame_s=0.02, rate_Hz=50.0) < SAFE_DISK_MARGIN).all()  # 40 ms of dead time
    assert found.longest_safe_servo_lag_s(0.0, 400.0) == 0.08
    assert np.isnan(found.longest_safe_servo_lag_s(0.02, 50.0))
    assert (speed > 0.1).all()
    assert (found.table.gust_tilt_rad > 0.0).all()
    record = found.as_record()
    assert record["bar"] is False
    assert np.shape(record["disk_margin"]) == (2, 2, 2)


def test_servo_map_by_command(tmp_path: Path) -> None:
    arguments = ["servo-map", "--no-bar", "--lag", "30", "--rate", "200", "--frame", "0", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    record = json.loads((tmp_path / "servo-map.json").read_text())
    assert record["disk_margin"][0][0][0] > 0.9
    assert (tmp_path / "servo-map.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="--rate: 3 Hz is out of range"):
        CliRunner().invoke(app, ["servo-map", "--rate", "3"], catch_exceptions=False)
