"""Optimisation: limits, repeatability, the walk from the start, optima that are known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mufly.errors import InputError, MuflyError
from mufly.study import StudySetup, evaluate_cases, optimise_rotor, parse_design_limit
from mufly.study.rotor_optimisation import min_thickness_m
from mufly.study.study_parameters import parameter_search_bounds


@pytest.fixture(scope="module")
def start(setup: StudySetup) -> StudySetup:
    """Own gear of 1.5, which any later gear can only better."""
    return replace(setup, fixed_parameters={k: v for k, v in setup.fixed_parameters.items() if k != "gear"})


def test_pitch_alone_finds_the_best_pitch_of_a_scan(start: StudySetup) -> None:
    best = optimise_rotor(start, "thrust-per-power", ["gear"], generations=30)
    scan = evaluate_cases(
        replace(start, fixed_parameters={**start.fixed_parameters, "gear": "best"}),
        [{"pitch": p} for p in np.linspace(0.04, 0.45, 400)],
    )
    assert best.goal_after == pytest.approx(np.nanmax(scan.values["thrust_per_power_N_W"]), rel=1e-4)
    assert best.steps[-1].parameter == "gear"
    assert best.changes["gear"] == best.results["gear_ratio"]


def test_larger_radius_is_taken_to_its_limit(start: StudySetup) -> None:
    best = optimise_rotor(
        start, "thrust-per-power", ["radius", "gear"], limits=[parse_design_limit("radius<=70mm")], generations=40
    )
    assert best.rotor.radius_m == pytest.approx(0.070, rel=2e-3)
    assert best.goal_after > best.goal_before


def test_gains_multiply_to_the_whole_and_the_answer_repeats(start: StudySetup) -> None:
    arguments = {
        "limits": [parse_design_limit("tip_chord_mm>=8"), parse_design_limit("speed_rpm<=7000")],
        "generations": 12,
        "seed": 3,
    }
    best = optimise_rotor(start, "thrust-per-power", ["chord", "taper", "twist"], **arguments)
    assert math.prod(1 + s.gain for s in best.steps) == pytest.approx(best.goal_after / best.goal_before, rel=1e-9)
    assert {s.parameter for s in best.steps} == {"chord", "taper", "twist"}
    assert float(best.rotor.chord_m(1.0)) >= 0.008 * (1 - 1e-6)
    assert best.results["speed_rad_s"] * 30 / math.pi <= 7000 * (1 + 1e-6)
    again = optimise_rotor(start, "thrust-per-power", ["chord", "taper", "twist"], **arguments)
    assert (again.rotor, again.steps, again.goal_after) == (best.rotor, best.steps, best.goal_after)


def test_endurance_is_what_the_battery_gives(start: StudySetup) -> None:
    best = optimise_rotor(start, "endurance", ["gear"], generations=15)
    assert best.goal_after == best.results["endurance_s"]
    # The gear was chosen for the low voltage, so that it is not full duty that ends the hover.
    assert best.results["duty"] <= 1.0 + 1e-9
    per_power = optimise_rotor(start, "thrust-per-power", ["gear"], generations=15)
    assert best.goal_after >= per_power.results["endurance_s"] * (1 - 1e-6)


def test_airfoils_are_chosen_within_the_thickness_limit(setup: StudySetup) -> None:
    free = StudySetup(setup.rotor, setup.drive, {"thrust": 0.4, "gear": "adapted"}, with_outside_share=False)
    thin = optimise_rotor(
        free, "thrust-per-power", ["airfoil"], airfoils=["naca4406", "naca4409", "naca4412"], generations=10
    )
    assert thin.rotor.airfoil_names() == ("naca4406",)
    thick = optimise_rotor(
        free, "thrust-per-power", ["airfoil"], airfoils=["naca4406", "naca4409", "naca4412"], generations=10,
        limits=[parse_design_limit("thickness_mm>=1.7")],
    )  # fmt: skip
    assert thick.rotor.airfoil_names() == ("naca4409",)
    assert min_thickness_m(thick.rotor) == pytest.approx(0.09 * 0.02, rel=2e-3)


def test_limits_are_read_with_units() -> None:
    assert parse_design_limit("radius<=60mm").value == pytest.approx(0.06)
    assert str(parse_design_limit("thickness_mm>=0.8")) == "thickness_mm >= 0.8"
    assert parse_design_limit("thickness_mm >= 0.8").relative_violation(0.4) == pytest.approx(0.5)
    assert parse_design_limit("thickness_mm>=0.8").relative_violation(0.9) == 0.0
    assert parameter_search_bounds(
        "radius", [parse_design_limit("radius<=60mm"), parse_design_limit("radius>=50mm")]
    ) == pytest.approx((0.05, 0.06))
    assert parameter_search_bounds("radius", [parse_design_limit("radius<=30mm")]) == pytest.approx((0.03, 0.03))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("radius<60mm", "is not a limit"),
        ("radius<=60", "has no unit"),
        ("colour>=2", "cannot be limited"),
        ("thickness_mm>=thick", "is not a number"),
    ],
)
def test_faulty_limits_are_named(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_design_limit(text)


def test_what_makes_no_sense_is_refused(start: StudySetup) -> None:
    with pytest.raises(InputError, match="cannot be free"):
        optimise_rotor(start, "thrust-per-power", ["colour"])
    with pytest.raises(InputError, match="is both fixed and to be optimised"):
        optimise_rotor(start, "thrust-per-power", ["airfoil"])
    with pytest.raises(InputError, match="is unknown"):
        optimise_rotor(start, "beauty", ["chord"])
    with pytest.raises(InputError, match="is an empty range"):
        parameter_search_bounds("radius", [parse_design_limit("radius<=50mm"), parse_design_limit("radius>=60mm")])
    with pytest.raises(MuflyError, match=r"no rotor within the limits.*speed_rpm <= 100"):
        optimise_rotor(
            start, "thrust-per-power", ["chord"], limits=[parse_design_limit("speed_rpm<=100")], generations=2
        )
