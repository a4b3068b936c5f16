"""The designs reach what was asked for, and the procedure holds on other vehicles."""

from __future__ import annotations

import json
from types import ModuleType

import numpy as np
import pytest

import mufly
from mufly.control import (
    DEFAULT_RATE_HZ,
    FlightController,
    Settings,
    TransferFunction,
    TwoDegreeWeights,
    design,
)
from mufly.control.designs import design_heave_yaw, design_roll_pitch
from mufly.dynamics import linearise
from mufly.errors import InputError, MuflyError
from mufly.vehicle import Vehicle


def test_heave_yaw_reaches_its_targets(controller: FlightController) -> None:
    d = controller.heave_yaw
    assert d.gamma <= 1.0
    assert d.norm <= d.gamma
    assert d.full_loop.sensitivity_peak_dB <= 3.3
    assert d.full_loop.complementary_peak_dB <= 3.3
    assert d.reduced.nstates <= 10
    assert d.sampled_loop.sensitivity_peak_dB <= 4.0
    assert d.sampled_loop.complementary_peak_dB <= 4.0


def test_roll_pitch_reaches_its_targets(controller: FlightController) -> None:
    d = controller.roll_pitch
    assert d.full_loop.complementary_peak_dB <= 1.9
    assert min(d.full_loop.crossovers) >= 36.0
    assert d.reduced.nstates <= 8
    assert d.sampled_loop.sensitivity_peak_dB <= 4.5
    assert d.sampled_loop.complementary_peak_dB <= 4.5


def test_the_cascade_holds_with_the_real_attitude_loop(controller: FlightController) -> None:
    c = controller.cascade
    assert c.stable
    assert c.sensitivity_peak_dB < 3.5
    assert c.phase_margin_deg > 45
    assert c.delay_margin_s > 0.1


def test_the_thesis_weights_give_what_design_md_says(appendix_b: ModuleType) -> None:
    """Eq. 6.4 with W_r but for its factor 1e-4: gamma below 1 where the thesis has 1.38."""
    linear = appendix_b.linear()
    d = design_heave_yaw(linear.heave_yaw, Settings(heave_yaw_weights=TwoDegreeWeights(auxiliary=0.0)), 0.005)
    assert d.gamma < 1.0
    assert d.full_loop.sensitivity_peak_dB < 3.74
    assert d.full_loop.complementary_peak_dB < 3.93


def test_with_the_printed_w_r_nothing_makes_it_follow(appendix_b: ModuleType) -> None:
    printed = TwoDegreeWeights(
        auxiliary=0.0, model_matching=TransferFunction((1e-4, 15e-4, 14e-4), (1.0, 14.0, 0.0014))
    )
    linear = appendix_b.linear()
    d = design_heave_yaw(linear.heave_yaw, Settings(heave_yaw_weights=printed), 0.005)
    closed = np.eye(3) + linear.heave_yaw(0.01j) @ d.feedback()(0.01j)
    response = np.linalg.solve(closed, linear.heave_yaw(0.01j) @ d.controller(0.01j)[:, :2])
    assert abs(response[0, 0]) < 0.2  # a height reference at 0.01 rad/s is followed to a fifth at most


def test_appendix_b_and_the_flight_model_give_one_design(
    appendix_b: ModuleType, controller: FlightController
) -> None:
    linear = appendix_b.linear()
    heave_yaw = design_heave_yaw(linear.heave_yaw, Settings(), 0.005)
    roll_pitch = design_roll_pitch(linear.roll_pitch, Settings(), 0.005)
    assert heave_yaw.gamma == pytest.approx(controller.heave_yaw.gamma, rel=1e-3)
    assert roll_pitch.gamma == pytest.approx(controller.roll_pitch.gamma, rel=1e-3)
    assert heave_yaw.full_loop.crossovers == pytest.approx(
        controller.heave_yaw.full_loop.crossovers, rel=1e-2
    )


def test_plant_crossovers(controller: FlightController) -> None:
    assert controller.heave_yaw.plant_crossovers == pytest.approx([2.94, 645], rel=5e-3)


@pytest.mark.parametrize("voltage", [6.0, 6.4, 7.6, 8.4])
def test_any_voltage_gives_the_same_loop(
    vehicle: Vehicle, controller: FlightController, voltage: float
) -> None:
    """The scaling follows the motors' authority, so the scaled plant hardly changes."""
    d = design(vehicle, voltage=voltage).heave_yaw
    assert d.full_loop.crossovers == pytest.approx(controller.heave_yaw.full_loop.crossovers, rel=0.02)
    assert d.sampled_loop.sensitivity_peak_dB < 4.0


def test_the_80_gram_prototype() -> None:
    c = design(mufly.load_vehicle("mufly-2.0"))
    assert c.heave_yaw.sampled_loop.sensitivity_peak_dB < 4.0
    assert c.roll_pitch.sampled_loop.sensitivity_peak_dB < 4.5
    assert c.cascade.sensitivity_peak_dB < 3.5
    assert c.warnings == ()


@pytest.mark.parametrize("seed", range(8))
def test_parameters_off_by_up_to_30_per_cent(appendix_b: ModuleType, seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = (
        "Ixx",
        "Iyy",
        "Izz",
        "cT_dw",
        "cT_up",
        "cQ_dw",
        "cQ_up",
        "J_dw",
        "J_up",
        "R_ohm",
        "kM",
        "Tf_up",
        "l_dw",
    )
    linear = appendix_b.linear(appendix_b.scaled(**{name: rng.uniform(0.7, 1.3) for name in names}))
    heave_yaw = design_heave_yaw(linear.heave_yaw, Settings(), 0.005)
    roll_pitch = design_roll_pitch(linear.roll_pitch, Settings(), 0.005)
    for d, most in ((heave_yaw, 10), (roll_pitch, 8)):
        assert d.norm <= d.gamma * (1 + 1e-6)
        assert d.reduced.nstates <= most
        assert d.sampled_loop.stable
        assert d.sampled_loop.sensitivity_peak_dB < 6.0
        assert d.sampled_loop.complementary_peak_dB < 6.0


@pytest.mark.parametrize("seed", range(4))
def test_the_design_holds_a_vehicle_that_is_not_the_one_designed_for(
    appendix_b: ModuleType, controller: FlightController, seed: int
) -> None:
    """Ten per cent on every parameter: still stable, with margin."""
    from mufly.control import analyse, sample_plant
    from mufly.control.linear import feedback_part

    rng = np.random.default_rng(seed)
    names = (
        "m",
        "Ixx",
        "Iyy",
        "Izz",
        "cT_dw",
        "cT_up",
        "cQ_dw",
        "cQ_up",
        "J_dw",
        "J_up",
        "R_ohm",
        "kM",
        "Tf_up",
        "l_dw",
    )
    linear = appendix_b.linear(appendix_b.scaled(**{name: rng.uniform(0.9, 1.1) for name in names}))
    for d, plant in ((controller.heave_yaw, linear.heave_yaw), (controller.roll_pitch, linear.roll_pitch)):
        K = feedback_part(d.discrete.system(), plant, d.feedback_inputs)
        loop = analyse(sample_plant(plant, controller.period_s, 1), K)
        assert loop.stable
        assert loop.sensitivity_peak_dB < 6.0


def test_impossible_requests_are_named(vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match=r"rate_Hz: 5 Hz is out of range; give 20 to 5000 Hz"):
        design(vehicle, rate_Hz=5)
    for volts in (-1.0, 5.9, 8.5, 1000.0, float("nan")):
        with pytest.raises(InputError, match=rf"voltage: {volts:g} V is out of .*give 6 V \(.*\) to 8\.4 V"):
            design(vehicle, voltage=volts)
    with pytest.raises(InputError, match="rate_Hz"):
        design(vehicle, rate_Hz=float("nan"))


def test_a_rate_that_loses_the_loop_says_which_and_why(vehicle: Vehicle) -> None:
    with pytest.raises(
        MuflyError, match=r"roll-pitch design.*not at 40 Hz with one sample of delay .*raise the rate"
    ):
        design(vehicle, rate_Hz=40)


def test_a_rate_that_hurts_the_loop_is_warned_of(vehicle: Vehicle) -> None:
    warnings = design(vehicle, rate_Hz=100).warnings
    assert any(text.startswith("roll-pitch: sampled at 100 Hz") for text in warnings)


def test_a_weight_at_fault_is_named(vehicle: Vehicle) -> None:
    plant = linearise(vehicle).heave_yaw
    faulty = Settings(heave_yaw_weights=TwoDegreeWeights(control=TransferFunction((0.0,)), auxiliary=0.0))
    with pytest.raises(MuflyError, match=r"heave-yaw design.*D12.*motor"):
        design_heave_yaw(plant, faulty, 0.005)


def test_summaries(controller: FlightController) -> None:
    text = str(controller)
    for word in ("heave-yaw", "roll-pitch", "velocity", "gamma", "200 Hz", "cascade"):
        assert word in text
    data = json.loads(json.dumps(controller.to_dict(), allow_nan=False))
    assert data["rate_Hz"] == DEFAULT_RATE_HZ
    assert [d["name"] for d in data["designs"]] == ["heave-yaw", "roll-pitch", "velocity"]
    assert data["designs"][0]["thesis"]["gamma"] == 1.38
