"""Rotor with elastic blades: limits, closed forms, energy, divergence, and the command."""

import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner
from uniform_beam import uniform_beam

from mufly.cli import app
from mufly.errors import MuflyError
from mufly.quantities.units import RPM
from mufly.rotor import (
    BladeStructure,
    compute_airfoil_polars,
    load_rotor,
    prepare_blading,
    solve_elastic_rotor,
    solve_rotor,
)
from mufly.rotor.structure.blade_beam import stiffness_matrices
from mufly.rotor.structure.elastic_rotor import (
    SpanLoads,
    differentiate_air_loads,
    divergence_speed,
    solve_elastic_equilibrium,
)
from mufly.rotor.structure.flap_modes import make_blade_beam

PITCH = math.radians(13.0)
LENGTH, GJ, CHORD, SLOPE = 0.07, 6e-4, 0.018, 5.7


def strip(**more):
    return uniform_beam(LENGTH, mass_kg_m=0.0095, flap_EI=2.3e-3, lag_EI=0.5, torsion_GJ=GJ, elements=12, **more)


def solve_static(beam, stiff, force):
    root = beam.root_transform
    return root @ np.linalg.solve(root.T @ stiff @ root, root.T @ force)


def constant(beam, axial=0.0, inplane=0.0, moment=0.0):
    return SpanLoads(*(np.full(beam.gauss_radii_m.shape, v) for v in (axial, inplane, moment)))


@pytest.fixture(scope="module")
def walkera():
    rotor = load_rotor("walkera-5g6")
    polars = compute_airfoil_polars(rotor.airfoil_names())
    return rotor, polars, prepare_blading(rotor, polars)


def test_uniform_torque_twists_by_the_closed_form():
    b = strip()
    x = solve_static(b, stiffness_matrices(b, 0.0)[0], constant(b, moment=0.02).load_vector(b))
    assert x[4::6][-1] == pytest.approx(0.02 * LENGTH**2 / (2.0 * GJ), rel=1e-10)


def test_uniform_load_bends_by_the_closed_form():
    b = strip()
    x = solve_static(b, stiffness_matrices(b, 0.0)[0], constant(b, axial=3.0).load_vector(b))
    assert x[2::6][-1] == pytest.approx(3.0 * LENGTH**4 / (8.0 * 2.3e-3), rel=1e-10)


def test_uniform_strip_diverges_at_the_closed_pressure():
    b, arm = strip(), 0.2 * CHORD
    lift = CHORD * SLOPE  # per unit pressure and angle
    turn = differentiate_air_loads(b, constant(b), constant(b, axial=lift, moment=lift * arm), 1.0)
    pressure = divergence_speed(b, stiffness_matrices(b, 0.0)[0], turn) ** 2
    assert pressure == pytest.approx((math.pi / (2.0 * LENGTH)) ** 2 * GJ / (arm * CHORD * SLOPE), rel=1e-6)
    back = differentiate_air_loads(b, constant(b), constant(b, axial=lift, moment=-lift * arm), 1.0)
    assert divergence_speed(b, stiffness_matrices(b, 0.0)[0], back) == math.inf


def test_loads_do_twice_the_energy_of_the_strained_blade_in_work():
    b, speed = strip(lag_inertia=2.5e-7), 443.0
    loads = constant(b, axial=3.0, inplane=-0.4, moment=0.01)
    elastic, centrifugal = stiffness_matrices(b, 0.0)
    x = solve_static(b, elastic + speed**2 * centrifugal, loads.load_vector(b))
    v, w, p = (b.evaluate_shape(name, x) for name in "vwp")
    work = b.integrate_over_span(loads.axial_N_m * w + loads.inplane_N_m * v + loads.elastic_axis_moment_N * p)
    bent = b.flap_EI * b.evaluate_shape("w2", x) ** 2 + b.lag_EI * b.evaluate_shape("v2", x) ** 2
    twisted = b.torsion_GJ * b.evaluate_shape("p1", x) ** 2
    tension = b.tension_over_speed2_kg_m * (
        b.evaluate_shape("w1", x) ** 2
        + b.evaluate_shape("v1", x) ** 2
        + b.gyration_radius2_m2 * b.evaluate_shape("p1", x) ** 2
    )
    field = -b.mass_kg_m * v**2 + b.lag_inertia * p**2
    assert work == pytest.approx(b.integrate_over_span(bent + twisted + speed**2 * (tension + field)), rel=1e-9)


def test_stiff_blade_gives_the_rigid_rotor(walkera):
    rotor, polars, blading = walkera
    b = make_blade_beam(rotor)
    stiff = replace(b, torsion_GJ=1e9 * b.torsion_GJ, flap_EI=1e9 * b.flap_EI, lag_EI=1e9 * b.lag_EI)
    point = {"pitch_rad": PITCH, "speed_rad_s": 6000 * RPM}
    found, rigid = solve_elastic_equilibrium(blading, stiff, polars, **point), solve_rotor(blading, **point)
    assert found.rotor.thrust_N == pytest.approx(rigid.thrust_N, rel=1e-9)
    assert found.rotor.torque_Nm == pytest.approx(rigid.torque_Nm, rel=1e-9)
    assert np.abs(found.deflection_m).max() < 1e-9


def test_equilibrium_does_not_depend_on_the_mesh(walkera):
    rotor, polars, blading = walkera
    tips = [
        solve_elastic_equilibrium(
            blading, make_blade_beam(rotor, elements=n), polars, pitch_rad=PITCH, speed_rad_s=6000 * RPM
        ).twist_rad[-1]
        for n in (20, 40)
    ]
    assert tips[0] == pytest.approx(tips[1], rel=2e-3)


def test_elastic_axis_decides_the_sign_for_blades_stiff_in_flap(walkera):
    rotor, polars, blading = walkera
    wood = BladeStructure(material="spruce")

    def twist(shift, axis_structure=wood):
        b = make_blade_beam(rotor, axis_structure, axis_shift=shift)
        return solve_elastic_equilibrium(blading, b, polars, pitch_rad=PITCH, speed_rad_s=6000 * RPM).twist_rad[-1]

    assert twist(-0.13) < math.radians(-2.0) < math.radians(2.0) < twist(0.08)


def test_thin_moulded_blade_gains_thrust_within_a_band(walkera):
    found = solve_elastic_rotor(walkera[0], pitch_rad=PITCH, speed_rad_s=6000 * RPM)
    assert 1.02 < found.elastic.thrust_N / found.rigid.thrust_N < 1.12
    assert found.thrust_low_N < found.elastic.thrust_N < found.thrust_high_N
    assert not found.axis_known
    assert math.radians(1.0) < found.coning_rad < math.radians(5.0)
    assert "elastic axis is not known" in str(found)
    assert len(found.plot().axes) == 3


def test_thick_blade_changes_thrust_little_and_with_the_square_of_the_speed():
    rotor = load_rotor("naca0012-r60-c20")  # 12 % of 20 mm
    polars = compute_airfoil_polars(rotor.airfoil_names())
    blading, b = prepare_blading(rotor, polars), make_blade_beam(rotor, BladeStructure(material="photopolymer"))
    change = []
    for speed in (3000 * RPM, 6000 * RPM):
        found = solve_elastic_equilibrium(blading, b, polars, pitch_rad=PITCH, speed_rad_s=speed)
        change.append(found.rotor.thrust_N / solve_rotor(blading, pitch_rad=PITCH, speed_rad_s=speed).thrust_N - 1.0)
    assert abs(change[0]) < 0.003
    assert change[1] / change[0] == pytest.approx(4.0, rel=0.15)


def test_diverging_blade_is_named_in_one_line(walkera):
    rotor, polars, blading = walkera
    b = make_blade_beam(rotor, BladeStructure(material="spruce"))
    with pytest.raises(MuflyError, match=r"14000 rpm .* diverges.*thicker blade") as error:
        solve_elastic_equilibrium(blading, b, polars, pitch_rad=PITCH, speed_rad_s=14000 * RPM)
    assert "\n" not in str(error.value)


def test_command_prints_both_rotors_and_warns_near_divergence(tmp_path):
    ask = ["rotor", "hover", "walkera-5g6", "--pitch", "13", "--rpm", "7000", "--elastic", "--material", "spruce"]
    ask += ["--thickness", "0.5mm"]
    told = CliRunner().invoke(app, [*ask, "--out", str(tmp_path)])
    assert told.exit_code == 0
    assert "near divergence: " in told.output
    assert (tmp_path / "elastic.png").stat().st_size > 5000
    for more, words in (
        (["--pitch", "13", "--thrust", "1", "--elastic"], "give --pitch and --rpm"),
        (["--pitch", "13", "--rpm", "6000", "--material", "abs"], "add --elastic"),
        (["--pitch", "13", "--rpm", "6000", "--thickness", "0.5mm"], "add --elastic"),
        (["--pitch", "13", "--rpm", "6000", "--elastic", "--method", "wake"], "leave --method"),
    ):
        wrong = CliRunner().invoke(app, ["rotor", "hover", "walkera-5g6", *more])
        assert wrong.exit_code == 1
        assert words in str(wrong.exception)
