"""Tuning of fixed order: exact gradients, monotone descent, and the aims reached by a design."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mufly.control import (
    DesignSettings,
    FlightController,
    close_loop,
    design_flight_controller,
    disk_margin,
    hinf_norm,
    hinfsyn,
    input_noise,
    sample_plant,
)
from mufly.control.designs import design_roll_pitch
from mufly.control.tuning import flight_aims, reduced_starts, tune_controller
from mufly.control.tuning.fixed_order import _gain, _StaticLoop, add_delay, aim_norms
from mufly.control.weighting_schemes import one_degree_plant, scale_plant
from mufly.dynamics import linearise_vehicle
from mufly.errors import ArgumentError, MuflyError
from mufly.vehicle import Vehicle

LEVELS = {"weighted": 0.62, "sensitivity": 1.35, "complementary": 1.26, "noise": 0.05}


@pytest.fixture(scope="module")
def problem(controller: FlightController):
    d = controller.roll_pitch
    plant = add_delay(scale_plant(d.plant, d.scaling), 1.5 * controller.period_s)
    generalised = one_degree_plant(plant, ("phi", "theta"), controller.settings.roll_pitch_weights)
    noise = np.radians([0.1, 0.1, 0.3, 0.3]) / np.array(d.scaling.outputs)
    full = hinfsyn(generalised, 4, 2, relaxation=1.2).controller
    return generalised, flight_aims(generalised, plant, 4, noise, LEVELS), full


def test_norms_are_those_of_the_closed_loop(problem) -> None:
    generalised, aims, full = problem
    norms = aim_norms(aims, full)
    assert norms["weighted"] == pytest.approx(hinf_norm(close_loop(generalised, full))[0], rel=1e-5)
    assert norms["sensitivity"] > 1.0


def test_gradient_is_exact(problem) -> None:
    generalised, aims, full = problem
    rng = np.random.default_rng(0)
    checked = 0
    for start in reduced_starts(generalised, [full], 4):
        K = _gain(start)
        for aim in aims:
            loop = _StaticLoop(aim.plant, 4)
            norm, gradient = loop.norm_and_gradient(K)
            if not np.isfinite(norm):
                continue
            for _ in range(3):
                step = 1e-4 * np.abs(K) * rng.normal(size=K.shape)
                by_difference = (loop.norm_and_gradient(K + step)[0] - loop.norm_and_gradient(K - step)[0]) / 2
                assert by_difference == pytest.approx(np.sum(gradient * step), rel=3e-3, abs=1e-7)
                checked += 1
    assert checked >= 30


def test_descent_is_never_above_its_start(problem) -> None:
    generalised, aims, full = problem
    starts = reduced_starts(generalised, [full], 2)
    found = tune_controller(aims, starts, descents=1, max_steps=4)
    assert found.objective <= found.start_objective
    assert found.objective == pytest.approx(max(found.norms[a.name] / a.level for a in aims), rel=1e-6)
    assert found.controller.nstates == 2
    with pytest.raises(MuflyError, match="no start of this order"):
        tune_controller(aims, reduced_starts(generalised, [full], 30))


def test_order_two_reaches_the_margins(vehicle: Vehicle, controller: FlightController) -> None:
    settings = DesignSettings(method="fixed")
    settings = replace(settings, roll_pitch_aims=replace(settings.roll_pitch_aims, order=2, descents=1))
    d = design_roll_pitch(linearise_vehicle(vehicle).roll_pitch, settings, controller.period_s)
    assert d.discrete.order == 2
    assert d.sampled_loop.sensitivity_peak_dB <= 3.0
    assert d.sampled_loop.complementary_peak_dB <= 2.5
    loop = sample_plant(d.plant, controller.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    assert disk_margin(*loop).margin >= 0.92
    assert input_noise(*loop, np.radians([0.1, 0.1, 0.3, 0.3])).max() < 0.03


def test_order_out_of_range_is_refused(vehicle: Vehicle) -> None:
    settings = DesignSettings(method="fixed")
    with pytest.raises(ArgumentError, match="give 2 to 8"):
        design_flight_controller(
            vehicle, settings=replace(settings, roll_pitch_aims=replace(settings.roll_pitch_aims, order=9))
        )
