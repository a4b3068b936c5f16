"""The comparison of methods: figures of the loops as they fly, the verdict's criteria, and the command with flights."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
import xarray as xr
from scipy import linalg
from typer.testing import CliRunner

from mufly.cli.control import app
from mufly.control import DesignSettings, FlightController, design_flight_controller, design_store, designs
from mufly.control.analysis import comparison
from mufly.control.analysis.comparison import (
    ControllerComparison,
    FlightMetrics,
    MethodMetrics,
    compare_methods,
    comparison_dataset,
    compute_loop_metrics,
    compute_output_noise_std,
    load_or_compute_mu_bounds,
    recommend_method,
)
from mufly.control.analysis.gust_response import GUST_LENGTH_m, GUST_m_s, compute_gust_tilt_std
from mufly.control.implementation import LATERAL_STATES
from mufly.control.linear_systems import frequency_response
from mufly.control.synthesis.synthesis_methods import (
    GivenController,
    SynthesisedController,
    SynthesisMethod,
    SynthesisProblem,
    synthesise_controller,
)
from mufly.dynamics import dryden_filter, linearise_vehicle
from mufly.errors import InputError
from mufly.firmware import describe_missing_tools
from mufly.flight.monte_carlo import Campaign
from mufly.mission import load_mission
from mufly.vehicle import Vehicle


@pytest.fixture(scope="module")
def row(vehicle: Vehicle, controller: FlightController) -> MethodMetrics:
    loops = [compute_loop_metrics(vehicle, d, (0.6, 0.5)) for d in (controller.heave_yaw, controller.roll_pitch)]
    return MethodMetrics("hinf", loops[0], loops[1], controller.cascade_loop.sensitivity_peak_dB, 0.01)


@pytest.fixture(scope="module")
def ltr(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle, settings=DesignSettings(method="ltr"))


def _judge(*rows: MethodMetrics) -> ControllerComparison:
    return recommend_method("vehicle", 200.0, rows)


def test_figures_are_those_of_the_sampled_loop(
    vehicle: Vehicle, controller: FlightController, row: MethodMetrics
) -> None:
    loop = row.roll_pitch
    assert loop.sampled is controller.roll_pitch.sampled_loop
    assert (loop.order, loop.multiply_adds) == (8, 72)
    assert loop.disk.margin == pytest.approx(0.83, abs=0.01)
    assert loop.input_noise == pytest.approx(0.0264, abs=2e-4)
    # 0.03 deg/s/sqrt(Hz) behind 60 Hz.
    assert np.degrees(compute_output_noise_std(vehicle, ("phi", "p"))) == pytest.approx(
        [0.1, 0.03 * np.sqrt(60 * np.pi / 2)]
    )


def test_tilt_in_gusts_is_the_integral_over_frequency(vehicle: Vehicle, controller: FlightController) -> None:
    """The loop is closed at every frequency, and the spectrum is that of the sampled Dryden filter."""
    linear, T = linearise_vehicle(vehicle, voltage=controller.voltage_V), controller.period_s
    full, of = linear.full, {name: i for i, name in enumerate(LATERAL_STATES)}
    lateral = [list(full.state_labels).index(name) for name in LATERAL_STATES]
    A = full.A[np.ix_(lateral, lateral)]
    gusts = -A[:, [of["u"], of["v"]]]
    gusts[:2] = 0.0  # a place moves with the velocity over ground
    n, w = len(lateral), np.geomspace(1e-4, np.pi / T, 12_000)
    held = linalg.expm(T * np.block([[A, full.B[lateral, 2:], gusts], [np.zeros((4, n + 4))]]))[:n]
    delay = np.exp(-1j * w * T)[:, None, None]
    open_loop = np.linalg.solve(np.eye(n) / delay - held[:, :n], np.broadcast_to(held[:, n:], (w.size, n, 4)))
    velocity = control.sample_system(controller.velocity.reduced, T, method="bilinear")
    outer, inner = (frequency_response(K, w) for K in (velocity, controller.roll_pitch.discrete.to_state_space()))
    picked, mix = np.zeros((4, n)), np.zeros((2, n))
    picked[range(4), [of[name] for name in ("phi", "theta", "p", "q")]] = -1.0
    mix[range(2), [of["x"], of["y"]]] = -controller.settings.position_gain
    mix[range(2), [of["u"], of["v"]]] = -1.0
    feedback = inner @ (picked + np.eye(4, 2) @ outer @ mix)
    state = np.linalg.solve(np.eye(n) - delay * open_loop[:, :, :2] @ feedback, open_loop[:, :, 2:])
    F, scale, output, _ = dryden_filter(GUST_LENGTH_m / 0.5, T)
    gust = GUST_m_s * output @ np.linalg.solve(np.eye(2) / delay - F, np.broadcast_to(scale, (w.size, 2, 2)))
    spectrum = (np.abs(gust) ** 2).sum(axis=1)
    assert np.trapezoid(spectrum, w) * T / np.pi == pytest.approx(GUST_m_s**2, rel=1e-3)
    size = (np.abs(state[:, [of["phi"], of["theta"]]]) ** 2).sum(axis=2) * spectrum[:, None]
    by_frequency = np.sqrt(np.trapezoid(size, w, axis=0) * T / np.pi)
    assert compute_gust_tilt_std(linear, controller) == pytest.approx(by_frequency.max(), rel=1e-3)


def test_the_verdict_names_what_decided_it(row: MethodMetrics) -> None:
    quiet = replace(row, method="ltr", roll_pitch=replace(row.roll_pitch, input_noise=0.005))
    found = _judge(row, quiet)
    assert found.recommended == "ltr"
    assert "decided by servo activity of 0.50 %" in found.verdict
    swaying = replace(quiet, method="mu", gust_tilt_rad=2.0 * row.gust_tilt_rad)
    found = _judge(row, swaying)
    assert found.recommended == "hinf"
    assert "decided by tilt of 0.57 degrees in gusts" in found.verdict
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
    assert "H2 is excluded: roll-pitch has mu up to 1.30" in found.verdict
    flown = [
        replace(quiet, flights=FlightMetrics(100, 60, 0.5, 0.69, 0.2)),
        replace(row, flights=FlightMetrics(100, 99, 0.95, 1.0, 0.1)),
    ]
    found = _judge(*flown)
    assert found.recommended == "hinf"
    assert "LQG/LTR succeeds in fewer flights" in found.verdict
    assert "99 of 100" in str(found)
    assert "no method meets" in _judge(fragile).verdict


def test_another_method_is_another_campaign(vehicle: Vehicle, ltr: FlightController) -> None:
    mission = load_mission("box-on-leg")
    plain = Campaign.create_checked(vehicle, mission)
    other = Campaign.create_checked(vehicle, mission, controller=ltr)
    assert other.controller is ltr
    assert plain.settings_hash != other.settings_hash


def test_command_compares_and_writes(
    vehicle: Vehicle, ltr: FlightController, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["compare", "--methods", "ltr", "--frequencies", "5"]
    result = CliRunner().invoke(app, [*arguments, "--json", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    assert content["recommended"] == "ltr"
    (method,) = content["methods"]
    assert method["flights"] is None
    assert method["roll_pitch"]["disk"]["margin"] > 0.93
    assert (tmp_path / "compare.png").stat().st_size > 5000
    with xr.open_dataset(tmp_path / "compare.nc", engine="scipy") as table:
        disk = float(table.disk_margin.sel(controller="ltr", loop="roll-pitch"))
        assert disk == pytest.approx(method["roll_pitch"]["disk"]["margin"])
        assert float(table.gust_tilt_rad.sel(controller="ltr")) == pytest.approx(method["gust_tilt_rad"])
    assert json.loads((tmp_path / "compare.json").read_text())["verdict"] == content["verdict"]
    if not describe_missing_tools():
        assert 2500 < method["instructions"] < 4500
    # Bounds of mu come from the folder; those at other frequencies are not there.
    monkeypatch.setattr(comparison, "analyse_parameter_robustness", lambda *_, **__: pytest.fail("computed again"))
    assert (
        load_or_compute_mu_bounds(vehicle, ltr, 5, tmp_path / "mu-ltr.json")[1][0] == method["roll_pitch"]["mu_upper"]
    )
    with pytest.raises(pytest.fail.Exception, match="computed again"):
        load_or_compute_mu_bounds(vehicle, ltr, 6, tmp_path / "mu-ltr.json")
    with pytest.raises(InputError, match="--methods"):
        CliRunner().invoke(app, ["compare", "--methods", "pid"], catch_exceptions=False)


def test_a_tuned_loop_is_a_row_of_its_own(vehicle: Vehicle, ltr: FlightController, tmp_path: Path) -> None:
    K = ltr.roll_pitch.reduced
    tuned = replace(DesignSettings(), roll_pitch_given=GivenController.from_matrices(K.A, K.B, K.C, K.D))
    found, controllers = compare_methods(vehicle, [], tuned=[tuned], points=5, folder=tmp_path)
    (row,) = found.methods
    assert row.method_label == f"tuned {K.nstates}"
    assert list(controllers) == [found.recommended] == ["tuned"]
    assert (tmp_path / "mu-tuned.json").exists()
    assert row.roll_pitch.disk.margin == pytest.approx(
        compute_loop_metrics(vehicle, ltr.roll_pitch, (0, 0)).disk.margin
    )
    assert comparison_dataset(found).controller == ["tuned"]


def test_a_slow_synthesis_is_computed_once(
    controller: FlightController, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUFLY_CACHE", str(tmp_path))
    monkeypatch.setattr(design_store, "STORED_METHODS", ("h2",))
    computed = []

    def count(method: SynthesisMethod, problem: SynthesisProblem) -> SynthesisedController:
        computed.append(method)
        return synthesise_controller(method, problem)

    monkeypatch.setattr(designs, "synthesise_controller", count)
    found = [
        designs.design_roll_pitch(controller.roll_pitch.plant, DesignSettings(method=method), 0.005)
        for method in ("h2", "h2", "ltr", "ltr")
    ]
    assert computed == ["h2", "ltr", "ltr"]
    assert found[0].discrete.A.tobytes() == found[1].discrete.A.tobytes()
    assert found[0].controller.input_labels == found[1].controller.input_labels
    faster = replace(DesignSettings(method="h2"), roll_pitch_relaxation=1.3)
    designs.design_roll_pitch(controller.roll_pitch.plant, faster, 0.005)
    assert len(computed) == 4  # another question
