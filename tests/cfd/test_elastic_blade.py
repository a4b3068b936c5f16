"""Elastic blades in CFD: the rounds, with a stand-in for the solver. No test runs OpenFOAM."""

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from mufly.cfd import solve_elastic_blade
from mufly.errors import InputError, MuflyError
from mufly.rotor import Air, compute_airfoil_polars, load_rotor, prepare_blading, solve_rotor
from mufly.rotor.structure.coupled_rounds import StripLoads, add_elastic_twist, iterate_elastic_twist
from mufly.rotor.structure.elastic_rotor import compute_section_moment_coefficients, solve_elastic_equilibrium
from mufly.rotor.structure.flap_modes import make_blade_beam

POINT = {"pitch_rad": math.radians(13.0), "speed_rad_s": 628.0}
AIR = Air()


@dataclass
class StandIn:
    """Blade elements in place of the solver, with a factor on lift; it counts what it is asked."""

    factor: float = 1.0
    settled: bool = True

    def __post_init__(self):
        self.polars = compute_airfoil_polars(["goe417a"])
        self.starts, self.rotors = [], []

    def strips(self, rotor, twist_rad=None, turn=1):
        self.rotors.append(rotor)
        blading = prepare_blading(rotor, self.polars)
        one = solve_rotor(blading, **POINT, air=AIR)
        wind = one.reynolds * AIR.viscosity_Pa_s / (AIR.density_kg_m3 * one.chord_m)
        moment = (
            0.5
            * AIR.density_kg_m3
            * (wind * one.chord_m) ** 2
            * compute_section_moment_coefficients(one, blading, self.polars)
        )
        width = one.dr_m * rotor.blades
        return StripLoads(one.r_m, self.factor * one.dT_N / width, -one.dQ_Nm / (one.r_m * width), self.factor * moment)

    def __call__(self, folder, rotor, *, neighbour, **given):
        self.starts.append(neighbour)
        loads, n = self.strips(rotor), rotor.blades
        return SimpleNamespace(
            verdict=SimpleNamespace(settled=self.settled, outcome="swings"), r_m=loads.r_m,
            thrust_N_m=loads.axial_N_m * n, torque_Nm_m=-loads.inplane_N_m * n * loads.r_m,
            moment_Nm_m=loads.quarter_chord_moment_N,
        )  # fmt: skip


@pytest.fixture(scope="module")
def rotor():
    return load_rotor("walkera-5g6")


def test_deformed_rotor_has_the_elastic_twist(rotor):
    b = make_blade_beam(rotor)
    twist = 0.05 * (b.edges_m - b.edges_m[0]) / (b.edges_m[-1] - b.edges_m[0])
    bent = add_elastic_twist(rotor, b, twist)
    x = np.linspace(0.25, 1.0, 50)
    assert bent.twist_rad(x) - rotor.twist_rad(x) == pytest.approx(np.interp(x * rotor.radius_m, b.edges_m, twist))
    assert bent.chord_m(x) == pytest.approx(rotor.chord_m(x))
    assert bent.name == rotor.name


def test_rounds_with_blade_elements_end_at_their_equilibrium(rotor):
    b, stand = make_blade_beam(rotor), StandIn()
    blading = prepare_blading(rotor, stand.polars)
    expected = solve_elastic_equilibrium(blading, b, stand.polars, **POINT)
    found = iterate_elastic_twist(rotor, b, stand.strips, **POINT)
    assert found.tip_twist_by_round_rad.size == 2  # one round
    assert found.tip_twist_by_round_rad[-1] == pytest.approx(expected.twist_rad[-1], abs=math.radians(0.05))
    assert found.deflection_m[-1] == pytest.approx(expected.deflection_m[-1], rel=0.01)


def test_rounds_find_the_fixed_point_of_another_solver(rotor):
    b, stand = make_blade_beam(rotor), StandIn(factor=1.25)
    coarse = iterate_elastic_twist(rotor, b, stand.strips, **POINT)
    fine = iterate_elastic_twist(rotor, b, stand.strips, **POINT, tolerance_rad=1e-6)
    assert 2 <= coarse.tip_twist_by_round_rad.size - 1 <= 4
    assert coarse.tip_twist_by_round_rad[-1] == pytest.approx(fine.tip_twist_by_round_rad[-1], abs=math.radians(0.05))
    assert abs(fine.tip_twist_by_round_rad[-1] - fine.tip_twist_by_round_rad[0]) > math.radians(0.1)


def test_cases_of_the_rounds_start_from_the_one_before(rotor, tmp_path):
    stand = StandIn(factor=1.25)
    _, rounds = solve_elastic_blade(tmp_path, rotor, run=stand, **POINT)
    count = rounds.tip_twist_by_round_rad.size - 1
    assert stand.starts == [None, *(tmp_path / f"round-{k}" for k in range(1, count))]
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"round-{k}" for k in range(1, count + 1)]
    again = StandIn(factor=1.25)
    assert np.array_equal(solve_elastic_blade(tmp_path, rotor, run=again, **POINT)[1].twist_rad, rounds.twist_rad)
    with pytest.raises(InputError, match=r"round-1: contains a blade of another twist; give another folder"):
        solve_elastic_blade(tmp_path, rotor, run=again, pitch_rad=0.2, speed_rad_s=628.0)


def test_loads_that_have_not_settled_bend_no_blade(rotor, tmp_path):
    with pytest.raises(MuflyError, match=r"round-1: the loads are not steady.*swings"):
        solve_elastic_blade(tmp_path, rotor, run=StandIn(settled=False), **POINT)
