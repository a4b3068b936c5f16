"""The designs reach what was asked for, and the procedure holds on other vehicles."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import mufly
from mufly.control import (
    DEFAULT_CONTROL_RATE_HZ,
    DesignSettings,
    FlightController,
    TransferFunction,
    TwoDegreeWeights,
    design_flight_controller,
)
from mufly.control.designs import compute_heave_acceleration_limit, design_heave_yaw, design_roll_pitch
from mufly.dynamics import linearise_vehicle
from mufly.errors import InputError, MuflyError
from mufly.results import to_plain_data
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters


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
    # The thesis's plant has no drag of the rotors in their planes; with it the loop is no less robust.
    bare = replace_parameters(load_vehicle(controller.vehicle_name), {"rotors.inplane_drag": 0.0})
    published = design_roll_pitch(linearise_vehicle(bare).roll_pitch, controller.settings, controller.period_s)
    assert min(published.full_loop.crossovers) >= 36.0
    assert min(d.full_loop.crossovers) >= 35.0
    for one in (d, published):
        assert one.full_loop.complementary_peak_dB <= 1.9
        assert one.reduced.nstates <= 8
        assert one.sampled_loop.sensitivity_peak_dB <= 4.5
        assert one.sampled_loop.complementary_peak_dB <= 4.5
    for margin in ("gain_margin_dB", "phase_margin_deg", "delay_margin_s"):
        assert getattr(d.sampled_loop, margin) > 0.99 * getattr(published.sampled_loop, margin), margin


def test_the_cascade_holds_with_the_real_attitude_loop(controller: FlightController) -> None:
    c = controller.cascade_loop
    assert c.stable
    assert c.sensitivity_peak_dB < 3.5
    assert c.phase_margin_deg > 45
    assert c.delay_margin_s > 0.1


def documented(about: str) -> dict[str, list[list[float]]]:
    """Numbers of a table of control.md: by the first words of a row, those of each of its other cells."""
    text = (Path(__file__).parents[2] / "docs" / "explanation" / "control.md").read_text(encoding="utf-8")
    lines = iter(text.splitlines())
    next(line for line in lines if line.startswith(f"| {about} |"))
    rows = {}
    for line in lines:
        if not line.startswith("|"):
            return rows
        head, *cells = line.strip("| ").split("|")
        name = re.split(r"[,(:]| of |/ norm", head)[0].strip()
        rows[name] = [[float(v) for v in re.findall(r"-?[0-9]+(?:[.][0-9]+)?", cell)] for cell in cells]
    return rows


@pytest.mark.parametrize("name", ["heave-yaw", "roll-pitch"])
def test_what_came_out_is_what_the_docs_say(controller: FlightController, name: str) -> None:
    """Every figure of the tables at the head of control.md, to its last digit; the thesis's beside them."""
    said = documented(name)
    d = next(x for x in controller.all_designs if x.name == name)
    reduced = f"after reduction to order {d.reduced.nstates}"
    assert said["gamma claimed"][0] == pytest.approx([d.gamma, d.norm], abs=6e-4)
    assert said["crossovers"][0] == pytest.approx(d.full_loop.crossovers, abs=0.06)
    for row, loop in (
        ("peaks", d.full_loop),
        (reduced, d.reduced_loop),
        ("sampled at 200 Hz", d.sampled_loop),
    ):
        assert said[row][0] == pytest.approx([loop.sensitivity_peak_dB, loop.complementary_peak_dB], abs=6e-3)
    margins = [d.sampled_loop.phase_margin_deg, 1e3 * d.sampled_loop.delay_margin_s]
    assert said["phase margin"][0] == pytest.approx(margins, abs=0.6)
    p = d.published
    for row, printed in (
        ("gamma claimed", [p.gamma]),
        ("crossovers", [p.crossover]),
        ("peaks", [p.sensitivity_peak_dB, p.complementary_peak_dB]),
        (reduced, [p.order]),
    ):
        assert (said[row] + [[], []])[2] == pytest.approx([v for v in printed if v is not None], abs=6e-3)


def test_what_came_out_of_the_cascade_is_what_the_docs_say(controller: FlightController) -> None:
    said, v, c = documented("position"), controller.velocity.full_loop, controller.cascade_loop
    assert said["velocity loop on eq. 6.10"][0] == [
        pytest.approx(v.crossovers[0], abs=0.06),
        pytest.approx(v.sensitivity_peak_dB, abs=6e-3),
        pytest.approx(v.complementary_peak_dB, abs=6e-3),
    ]
    peaks = [c.sensitivity_peak_dB, c.complementary_peak_dB]
    assert said["whole cascade with the sampled attitude loop"][0] == pytest.approx(peaks, abs=6e-3)
    assert said["phase margin"][0] == [
        pytest.approx(c.phase_margin_deg, abs=0.6),
        pytest.approx(1e3 * c.delay_margin_s, abs=6.0),
    ]
    text = str(controller)
    assert f"delay margin {1e3 * c.delay_margin_s:.0f} ms" in text
    rows = [line.split() for line in text.splitlines() if line.startswith("delay margin (ms)")]
    delays = [1e3 * d.sampled_loop.delay_margin_s for d in controller.all_designs]
    assert [float(row[-2]) for row in rows] == pytest.approx(delays, abs=0.51)


def test_scales_and_limits_are_what_the_docs_say(controller: FlightController) -> None:
    """What control.md tells of mufly-1.1: units of its scaled plants, and what its references may ask for."""
    heave_yaw, roll_pitch, velocity = (d.scaling for d in controller.all_designs)
    assert heave_yaw.inputs == pytest.approx([0.22] * 2, abs=6e-3)
    assert heave_yaw.outputs == pytest.approx([1.0, 4.0, 20.0], rel=0.03)
    assert sorted(roll_pitch.inputs) == pytest.approx([0.86, 1.09], abs=6e-3)
    assert roll_pitch.outputs == (0.5, 0.5, 5.0, 5.0)
    assert (velocity.outputs, velocity.inputs) == ((1.0, 1.0), (0.08, 0.08))
    heave, position = controller.heave_yaw_gains, controller.position_gains
    assert float(heave["heave_acceleration"]) == pytest.approx(0.81, abs=6e-3)
    assert float(heave["heave_lead"]) == pytest.approx(0.225, abs=6e-4)
    assert float(heave["yaw_lead"]) == pytest.approx(0.2, abs=6e-3)
    assert float(heave["heave_bandwidth"]) == 8.0
    assert float(heave["heave_speed"]) == 1.0
    assert [float(position[k]) for k in ("position_gain", "speed_limit", "tilt_limit")] == [1.0, 1.5, 0.15]
    # The voltage is filtered with 50 ms: after that long nine steps of ten have covered two thirds of a step.
    assert (1.0 - float(heave["voltage_blend"])) ** 10 == pytest.approx(np.exp(-1.0), rel=0.05)


@pytest.mark.parametrize(("mass", "thrust", "most"), [(1.45, 1.0, 0.1), (0.8, 1.55, 1.5)])
def test_a_reference_of_height_asks_for_something_and_not_too_much(
    vehicle: Vehicle, mass: float, thrust: float, most: float
) -> None:
    """Of a vehicle that hovers with nothing to spare, and of one that could leap."""
    now = {p.key: float(p.value) for p in list_parameters(vehicle) if p.key.endswith(("mass", "thrust_coefficient"))}
    factor = {
        "body.mass": mass,
        "rotors.upper.thrust_coefficient": thrust,
        "rotors.lower.thrust_coefficient": thrust,
    }
    other = replace_parameters(vehicle, {key: now[key] * share for key, share in factor.items()})
    assert compute_heave_acceleration_limit(other, linearise_vehicle(other), DesignSettings()) == most


def test_the_thesis_weights_give_what_design_md_says(appendix_b: ModuleType) -> None:
    """Eq. 6.4 with W_r but for its factor 1e-4: gamma below 1 where the thesis has 1.38."""
    linear = appendix_b.linear()
    d = design_heave_yaw(linear.heave_yaw, DesignSettings(heave_yaw_weights=TwoDegreeWeights(auxiliary=0.0)), 0.005)
    assert d.gamma < 1.0
    assert d.full_loop.sensitivity_peak_dB < 3.74
    assert d.full_loop.complementary_peak_dB < 3.93


def test_with_the_printed_w_r_nothing_makes_it_follow(appendix_b: ModuleType) -> None:
    printed = TwoDegreeWeights(
        auxiliary=0.0, model_matching=TransferFunction((1e-4, 15e-4, 14e-4), (1.0, 14.0, 0.0014))
    )
    linear = appendix_b.linear()
    d = design_heave_yaw(linear.heave_yaw, DesignSettings(heave_yaw_weights=printed), 0.005)
    closed = np.eye(3) + linear.heave_yaw(0.01j) @ d.feedback_controller()(0.01j)
    response = np.linalg.solve(closed, linear.heave_yaw(0.01j) @ d.controller(0.01j)[:, :2])
    assert abs(response[0, 0]) < 0.2  # a height reference at 0.01 rad/s is followed to a fifth at most


def test_appendix_b_and_the_flight_model_give_one_design(appendix_b: ModuleType, controller: FlightController) -> None:
    linear = appendix_b.linear()
    heave_yaw = design_heave_yaw(linear.heave_yaw, DesignSettings(), 0.005)
    roll_pitch = design_roll_pitch(linear.roll_pitch, DesignSettings(), 0.005)
    assert heave_yaw.gamma == pytest.approx(controller.heave_yaw.gamma, rel=1e-3)
    assert roll_pitch.gamma == pytest.approx(controller.roll_pitch.gamma, rel=1e-3)
    assert heave_yaw.full_loop.crossovers == pytest.approx(controller.heave_yaw.full_loop.crossovers, rel=1e-2)


def test_plant_crossovers(controller: FlightController) -> None:
    assert controller.heave_yaw.plant_crossovers == pytest.approx([2.94, 645], rel=5e-3)


@pytest.mark.parametrize("voltage", [6.0, 6.4, 7.6, 8.4])
def test_any_voltage_gives_the_same_loop(vehicle: Vehicle, controller: FlightController, voltage: float) -> None:
    """The scaling follows the motors' authority, so the scaled plant hardly changes."""
    d = design_flight_controller(vehicle, voltage=voltage).heave_yaw
    assert d.full_loop.crossovers == pytest.approx(controller.heave_yaw.full_loop.crossovers, rel=0.02)
    assert d.sampled_loop.sensitivity_peak_dB < 4.0
    if voltage == 6.4:  # the one of the thesis's linear model
        assert d.plant_crossovers == pytest.approx(d.published.plant_crossovers, rel=5e-3)


def test_the_80_gram_prototype() -> None:
    c = design_flight_controller(mufly.load_vehicle("mufly-2.0"))
    assert c.heave_yaw.sampled_loop.sensitivity_peak_dB < 4.0
    assert c.roll_pitch.sampled_loop.sensitivity_peak_dB < 4.5
    assert c.cascade_loop.sensitivity_peak_dB < 3.5
    assert c.design_warnings == ()


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
    heave_yaw = design_heave_yaw(linear.heave_yaw, DesignSettings(), 0.005)
    roll_pitch = design_roll_pitch(linear.roll_pitch, DesignSettings(), 0.005)
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
    from mufly.control import analyse_loop, sample_plant
    from mufly.control.linear_systems import extract_feedback_controller

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
        K = extract_feedback_controller(d.discrete.to_state_space(), plant, d.error_inputs)
        loop = analyse_loop(sample_plant(plant, controller.period_s, 1), K)
        assert loop.stable
        assert loop.sensitivity_peak_dB < 6.0


def test_impossible_requests_are_named(vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match=r"rate_Hz: 5 Hz is out of range; give 20 to 5000 Hz"):
        design_flight_controller(vehicle, rate_Hz=5)
    for volts in (-1.0, 5.9, 8.5, 1000.0, float("nan")):
        with pytest.raises(InputError, match=rf"voltage: {volts:g} V is out of .*give 6 V \(.*\) to 8\.4 V"):
            design_flight_controller(vehicle, voltage=volts)
    for rate in (19.0, 5001.0, float("nan")):
        with pytest.raises(InputError, match="rate_Hz"):
            design_flight_controller(vehicle, rate_Hz=rate)


def test_a_rate_that_loses_the_loop_says_which_and_why(vehicle: Vehicle, controller: FlightController) -> None:
    holds = 1e3 * controller.roll_pitch.reduced_loop.delay_margin_s  # whatever the rate
    with pytest.raises(
        MuflyError,
        match=r"roll-pitch design.*not at 40 Hz with one sample of delay "
        rf"\(delay margin {holds:.1f} ms\); raise the rate",
    ):
        design_flight_controller(vehicle, rate_Hz=40)


def test_a_rate_that_hurts_the_loop_is_warned_of(vehicle: Vehicle) -> None:
    """Its sensitivity peaks at 6.26 dB, and the warning is of peaks above 6."""
    (warning,) = design_flight_controller(vehicle, rate_Hz=125).design_warnings
    assert warning.startswith("roll-pitch: sampled at 125 Hz")
    assert "peak at 6.3 dB" in warning


def test_a_weight_at_fault_is_named(vehicle: Vehicle) -> None:
    plant = linearise_vehicle(vehicle).heave_yaw
    faulty = DesignSettings(heave_yaw_weights=TwoDegreeWeights(control=TransferFunction((0.0,)), auxiliary=0.0))
    with pytest.raises(MuflyError, match=r"heave-yaw design.*D12.*motor"):
        design_heave_yaw(plant, faulty, 0.005)


def test_summaries(controller: FlightController) -> None:
    text = str(controller)
    for word in ("heave-yaw", "roll-pitch", "velocity", "gamma", "200 Hz", "cascade"):
        assert word in text
    data = json.loads(json.dumps(to_plain_data(controller), allow_nan=False))
    assert data["rate_Hz"] == DEFAULT_CONTROL_RATE_HZ
    assert [d["name"] for d in data["designs"]] == ["heave-yaw", "roll-pitch", "velocity"]
    assert data["designs"][0]["thesis"]["gamma"] == 1.38
    assert controller.roll_pitch.published.resonance == 14.5  # Sec. 6.1.5
