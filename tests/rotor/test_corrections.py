"""What the corrections do, one at a time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mufly.errors import InputError
from mufly.rotor import TEXTBOOK_CORRECTIONS, Corrections, PolarTable, Rotor, prepare_blading, solve_rotor
from mufly.rotor.blading import find_zero_lift_angle, stall_delay_strength
from mufly.rotor.sections.polar_table import ALPHA_GRID

KINDS = ["dumitrescu-cardos", "snel", "chaviaropoulos-hansen", "none"]


def table(cl, cd=0.02) -> PolarTable:
    shape = (3, ALPHA_GRID.size)
    zero = np.zeros(shape)
    return PolarTable(
        "s",
        ALPHA_GRID,
        np.array([1e2, 1e4, 1e6]),
        zero + cl,
        zero + cd,
        zero,
        np.tile([-0.2, 0.2], (3, 1)),
        "made up",
    )


STALLING = np.where(np.abs(ALPHA_GRID) < 0.15, 5.7 * ALPHA_GRID, 0.855 * np.sign(np.sin(2 * ALPHA_GRID)))


def solved(cl, corrections, pitch=0.35, chord=0.3):
    def q(value, unit):
        return {"value": value, "unit": unit, "source": "specified"}

    rotor = Rotor(
        name="t", blades=2, radius=q(1.0, "m"), hub_cutout=q(0.15, "1"),
        blade={"r_over_R": q((0.15, 1.0), "1"), "chord": q((chord, chord), "m"), "twist": q((0.0, 0.0), "rad"),
               "airfoils": ("s",)},
    )  # fmt: skip
    return solve_rotor(
        prepare_blading(rotor, {"s": table(cl)}, corrections=corrections), pitch_rad=pitch, speed_rad_s=20.0
    )


@given(ratio=st.floats(0.0, 3.0), kind=st.sampled_from(KINDS))
def test_rotation_is_a_share(ratio, kind):
    g = stall_delay_strength(kind, np.array([ratio]))[0]
    assert 0.0 <= g <= 1.0
    assert g <= stall_delay_strength(kind, np.array([ratio + 0.1]))[0]
    assert stall_delay_strength(kind, np.array([0.0]))[0] == 0.0


@pytest.mark.parametrize("kind", KINDS[:3])
def test_rotation_returns_lift_where_the_polar_has_stalled_normal_to_the_chord(kind):
    base = Corrections(lifting_surface=False, stall_delay="none")
    still, turning = (
        solved(STALLING, base),
        solved(STALLING, Corrections(lifting_surface=False, stall_delay=kind)),
    )
    assert turning.thrust_N > still.thrust_N
    assert turning.cl.max() > 1.05 * still.cl.max()
    gain = turning.cl - np.interp(turning.alpha_rad, ALPHA_GRID, STALLING)
    assert_allclose((turning.cd - 0.02)[2:-2], (gain * np.tan(turning.alpha_rad))[2:-2], atol=3e-3)


def test_rotation_leaves_attached_potential_flow_alone():
    potential = 2 * np.pi * np.sin(ALPHA_GRID) * np.cos(ALPHA_GRID) ** 2
    for kind in KINDS[:3]:
        with_, without = (
            solved(potential, Corrections(stall_delay=kind)),
            solved(potential, Corrections(stall_delay="none")),
        )
        assert_allclose(with_.thrust_N, without.thrust_N, rtol=1e-4)
        assert_allclose(with_.torque_Nm, without.torque_Nm, rtol=1e-4)


def test_finite_chord_takes_thrust_the_more_the_wider_the_blade():
    lost = []
    for chord in (0.05, 0.15, 0.3):
        wide = solved(5.7 * np.sin(ALPHA_GRID), Corrections(stall_delay="none"), pitch=0.2, chord=chord)
        line = solved(5.7 * np.sin(ALPHA_GRID), TEXTBOOK_CORRECTIONS, pitch=0.2, chord=chord)
        lost.append(1.0 - wide.thrust_N / line.thrust_N)
    assert 0.0 < lost[0] < lost[1] < lost[2] < 0.3


def test_factors_scale_the_section():
    once, twice = solved(STALLING, TEXTBOOK_CORRECTIONS, pitch=0.1), solved(STALLING, Corrections(
        lifting_surface=False, stall_delay="none", drag_factor=2.0), pitch=0.1)  # fmt: skip
    assert_allclose(twice.cd, 2 * once.cd, rtol=1e-9)
    assert_allclose(twice.cl, once.cl, rtol=1e-9)
    assert twice.calibrated
    assert not once.calibrated


def test_zero_lift_angle_is_found_where_it_is():
    assert_allclose(find_zero_lift_angle(table(np.sin(ALPHA_GRID + 0.07))), -0.07, atol=1e-5)
    assert find_zero_lift_angle(table(np.zeros(721) + 0.3)) == 0.0


@pytest.mark.parametrize(
    "bad", [{"stall_delay": "x"}, {"tip_loss": "x"}, {"drag_factor": 0.0}, {"lift_factor": math.inf}]
)
def test_odd_switches_are_refused(bad):
    with pytest.raises(InputError):
        Corrections(**bad)
