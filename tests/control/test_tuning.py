"""Tuning of fixed order: exact gradients, monotone descent, and the goals reached by a design."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.control import (
    DesignSettings,
    FlightController,
    compute_input_noise_std,
    compute_lower_lft,
    design_flight_controller,
    disk_margin,
    hinf_norm,
    hinfsyn,
    sample_plant,
)
from mufly.control.designs import design_roll_pitch
from mufly.control.robust import analyse_parameter_robustness
from mufly.control.synthesis.weighting_schemes import make_one_dof_generalised_plant, scale_plant
from mufly.control.tuning import make_flight_goals, reduce_start_controllers, tune_controller
from mufly.control.tuning.fixed_order import add_input_delay, evaluate_goal_norms, stack_controller_matrices
from mufly.control.tuning.loop_tuning import (
    GoalLevels,
    find_start_controllers,
    make_loop_tuning_problem,
    settings_with_tuned_controller,
)
from mufly.control.tuning.tuned_loop import load_tuned_settings, tune_loop
from mufly.dynamics import linearise_vehicle
from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.vehicle import Vehicle

LEVELS = {"weighted": 0.62, "sensitivity": 1.35, "complementary": 1.26, "noise": 0.05}


@pytest.fixture(scope="module")
def problem(controller: FlightController):
    d = controller.roll_pitch
    plant = add_input_delay(scale_plant(d.plant, d.scaling), 1.5 * controller.period_s)
    generalised = make_one_dof_generalised_plant(plant, ("phi", "theta"), controller.settings.roll_pitch_weights)
    noise = np.radians([0.1, 0.1, 0.3, 0.3]) / np.array(d.scaling.outputs)
    full = hinfsyn(generalised, 4, 2, relaxation=1.2).controller
    return generalised, make_flight_goals(generalised, plant, 4, noise, LEVELS, controller.period_s), full


def test_norms_are_those_of_the_closed_loop(problem) -> None:
    generalised, goals, full = problem
    norms = evaluate_goal_norms(goals, full)
    assert norms["weighted"] == pytest.approx(hinf_norm(compute_lower_lft(generalised, full))[0], rel=1e-5)
    assert norms["sensitivity"] > 1.0


def test_gradient_is_exact(problem) -> None:
    generalised, goals, full = problem
    rng = np.random.default_rng(0)
    checked = 0
    for start in reduce_start_controllers(generalised, [full], 4):
        K = stack_controller_matrices(start)
        for goal in goals:
            loop = goal.make_loop_norm(4)
            norm, gradient = loop.norm_and_gradient(K)
            if not np.isfinite(norm):
                continue
            for _ in range(3):
                step = 1e-4 * np.abs(K) * rng.normal(size=K.shape)
                by_difference = (loop.norm_and_gradient(K + step)[0] - loop.norm_and_gradient(K - step)[0]) / 2
                assert by_difference == pytest.approx(np.sum(gradient * step), rel=3e-3, abs=1e-7)
                checked += 1
    assert checked >= 30


def test_gradients_of_disk_activity_and_mu_are_exact(vehicle: Vehicle, controller: FlightController) -> None:
    spreads = {"body.inertia_xx": 2e-5, "swash_plate.linkage": 0.2, "stabiliser_bar.time_constant": 0.07}
    goals = GoalLevels(disk_margin=0.9, activity=1.0, mu=0.3)
    noise = np.radians([0.1, 0.1, 0.3, 0.3])
    p = make_loop_tuning_problem(vehicle, controller, "roll-pitch", goals, noise, spreads)
    assert [a.name for a in p.goals] == ["disk", "activity", "mu"]
    K = find_start_controllers(p, ["delay"], 4)[0]
    gain = stack_controller_matrices(K)
    bound = p.mu.update_scalings(gain, 4)
    rng = np.random.default_rng(3)
    for goal in p.goals:
        loop = goal.make_loop_norm(4)
        norm, gradient = loop.norm_and_gradient(gain)
        # Along the signs of the gradient no terms cancel; fourth-order differences remove the curvature of mu.
        step = 1e-6 * np.abs(gain) * np.sign(gradient) * rng.uniform(0.5, 1.5, size=gain.shape)
        norms_at = [loop.norm_and_gradient(gain + k * step)[0] for k in (-2, -1, 1, 2)]
        by_difference = np.dot([1.0, -8.0, 8.0, -1.0], norms_at) / 12.0
        assert by_difference == pytest.approx(np.sum(gradient * step), rel=1e-3)
        assert norm == pytest.approx(bound, rel=1e-6) or goal.name != "mu"
    # The activity is the deviation of the sampled loop's inputs, the disk its margin, and mu the analysis's bound.
    flown = design_flight_controller(vehicle, settings=settings_with_tuned_controller(DesignSettings(), p, K))
    d = flown.roll_pitch
    loop = sample_plant(d.plant, flown.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    norms = evaluate_goal_norms(p.goals, K)
    deviation = compute_input_noise_std(*loop, noise) / np.array(d.scaling.inputs)
    assert norms["activity"] == pytest.approx(np.linalg.norm(deviation), rel=0.1)
    assert 1 / norms["disk"] == pytest.approx(disk_margin(*loop).margin, rel=0.05)
    judged = analyse_parameter_robustness(vehicle, flown, spreads, points=12).roll_pitch
    assert 0.9 * judged.peak_lower_bound <= bound <= 1.05 * judged.peak  # the two have frequencies of their own


def test_tuned_loop_is_continued_flown_and_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    path = tmp_path / "roll-pitch.json"
    goals = GoalLevels(sensitivity_dB=2.6, complementary_dB=2.4)
    more = {"starts": ["delay"], "steps": 3, "spreads": {"swash_plate.linkage": 0.2}, "path": path}
    calls: list[int] = []
    first = tune_loop(vehicle, "roll-pitch", 2, goals, rounds=1, progress=lambda a, b: calls.append(a), **more)
    kept = json.loads(path.read_text())
    again = tune_loop(vehicle, "roll-pitch", 2, goals, rounds=1, progress=lambda a, b: calls.append(-1), **more)
    assert calls == list(range(1, len(calls) + 1))  # the second call finds its rounds done
    assert json.loads(path.read_text()) == kept
    assert again.objective == first.objective
    settings = load_tuned_settings([path])
    flown = design_flight_controller(vehicle, settings=settings)
    assert flown.roll_pitch.method == "fixed"
    assert flown.heave_yaw.method == "hinf"
    assert np.array_equal(flown.roll_pitch.discrete.A, first.controller_design.discrete.A)
    with pytest.raises(InputError, match="contains the results of another tuning"):
        tune_loop(vehicle, "roll-pitch", 3, goals, rounds=1, **more)
    with pytest.raises(InputError, match="a second controller for roll-pitch"):
        load_tuned_settings([path, path])
    with pytest.raises(ArgumentError, match="give 2 to 10 for heave-yaw"):
        tune_loop(vehicle, "heave-yaw", 11, goals)
    other = tmp_path / "other.json"
    other.write_text("{}")
    with pytest.raises(InputError, match="is not a tuned controller"):
        load_tuned_settings([other])


def test_descent_is_never_above_its_start(problem) -> None:
    generalised, goals, full = problem
    starts = reduce_start_controllers(generalised, [full], 2)
    found = tune_controller(goals, starts, descents=1, max_steps=4)
    assert found.objective <= found.start_objective
    assert found.objective == pytest.approx(max(found.norms[a.name] / a.level for a in goals), rel=1e-6)
    assert found.controller.nstates == 2
    with pytest.raises(MuflyError, match="no starting controller has this order"):
        tune_controller(goals, reduce_start_controllers(generalised, [full], 30))


def test_order_two_reaches_the_margins(vehicle: Vehicle, controller: FlightController) -> None:
    settings = DesignSettings(method="fixed")
    settings = replace(settings, roll_pitch_goals=replace(settings.roll_pitch_goals, order=2, descents=1))
    d = design_roll_pitch(linearise_vehicle(vehicle).roll_pitch, settings, controller.period_s)
    assert d.discrete.order == 2
    assert d.sampled_loop.sensitivity_peak_dB <= 3.0
    assert d.sampled_loop.complementary_peak_dB <= 2.5
    loop = sample_plant(d.plant, controller.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    assert disk_margin(*loop).margin >= 0.92
    assert compute_input_noise_std(*loop, np.radians([0.1, 0.1, 0.3, 0.3])).max() < 0.03


def test_order_out_of_range_is_refused(vehicle: Vehicle) -> None:
    settings = DesignSettings(method="fixed")
    with pytest.raises(ArgumentError, match="give 2 to 8"):
        design_flight_controller(
            vehicle, settings=replace(settings, roll_pitch_goals=replace(settings.roll_pitch_goals, order=9))
        )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("control", "tune", "--start", "pid"),
            "--start: pid: is neither a synthesis method nor a file; give one of hinf, h2, lqg, ltr, delay",
        ),
        (("control", "tune", "--order", "9"), "give 2 to 8 for roll-pitch"),
        (("control", "tune", "--only"), "no goal is given"),
        (("control", "design", "--tuned", "absent.json"), "absent.json: No such file"),
    ],
)
def test_commands_refuse_in_one_line(words: tuple[str, ...], message: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    error = CliRunner().invoke(app, words).exception
    assert isinstance(error, InputError)
    assert message in str(error)
    assert "\n" not in str(error)


@pytest.mark.parametrize(("name", "published"), [("AC2", 0.1115), ("AC17", 6.6124)])
def test_static_gains_reach_the_norms_of_hifoo_and_hinfstruct(name: str, published: float) -> None:
    """Two plants of COMPleib; `benchmarks/published_plants.py` has the others and their sources."""
    file = Path(__file__).parents[2] / "benchmarks" / "published_plants.py"
    spec = importlib.util.spec_from_file_location("published_plants", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    plant = module.PLANTS[name]
    norm, K = module.tuned_norm(plant)
    assert norm == pytest.approx(published, rel=1e-3)
    P = plant.partitioned
    closed = control.ss(
        P.A + P.B2 @ K @ P.C2, P.B1 + P.B2 @ K @ P.D21, P.C1 + P.D12 @ K @ P.C2, P.D12 @ K @ P.D21
    )  # fmt: skip
    assert hinf_norm(closed)[0] == pytest.approx(norm, rel=1e-3)  # by Hamiltonian bisection
