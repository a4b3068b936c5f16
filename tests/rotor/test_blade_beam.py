"""The blade as a beam: closed forms, published tables of rotating beams, sections, rotor files and the command."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner
from uniform_beam import uniform_beam

from mufly.cli import app
from mufly.errors import InputError
from mufly.rotor import (
    BladeStructure,
    compute_campbell,
    compute_flap_mode,
    format_rotor_toml,
    load_rotor,
    rotor_from_tables,
)
from mufly.rotor.structure.blade_beam import compute_modes, mass_matrix, stiffness_matrices
from mufly.rotor.structure.cross_section import section_geometry, shear_centre, thickness_and_camber_lines
from mufly.rotor.structure.flap_modes import make_blade_beam, select_campbell_frequencies, with_free_flap_hinge
from mufly.rotor.structure.materials import MATERIALS

LENGTH, MASS, EI, GJ, INERTIA = 0.07, 0.0095, 2.3e-3, 6e-4, 2.5e-7
UNIT = math.sqrt(EI / MASS) / LENGTH**2


def beam(**changes):
    values = {"mass_kg_m": MASS, "flap_EI": EI, "lag_EI": 0.5, "torsion_GJ": GJ, "lag_inertia": INERTIA, "elements": 16}
    return uniform_beam(LENGTH, **(values | changes))


def first(found, kind, count):
    return np.array([found.frequency_rad_s[found.find_mode(kind, k)] for k in range(1, count + 1)])


def test_cantilever_has_the_closed_frequencies():
    found = compute_modes(beam(), 0.0, count=12)
    assert first(found, "flap", 3) / UNIT == pytest.approx([3.516015, 22.034492, 61.697214], rel=1e-4)
    torsion = first(found, "torsion", 2) * LENGTH / math.sqrt(GJ / INERTIA)
    assert torsion == pytest.approx([math.pi / 2, 3 * math.pi / 2], rel=1e-4)


def test_free_hinge_at_the_shaft_flaps_at_one_per_revolution():
    found = compute_modes(beam(flap_EI=1e-12, flap_root_N_m=0.0), 444.0)
    assert first(found, "flap", 2) / 444.0 == pytest.approx([1.0, math.sqrt(6.0)], rel=1e-4)


@pytest.mark.parametrize(
    ("rate", "values"),
    [  # Wright, Smith, Thresher and Wang, J. Appl. Mech. 49 (1982) 197: first two flap modes, no hub radius
        (1.0, (3.6816, 22.1810)), (3.0, (4.7973, 23.3203)), (6.0, (7.3604, 26.8091)), (12.0, (13.1702, 37.6031)),
    ],
)  # fmt: skip
def test_rotating_cantilever_agrees_with_the_tables(rate, values):
    found = compute_modes(beam(), rate * UNIT, count=6)
    assert first(found, "flap", 2) / UNIT == pytest.approx(values, rel=1e-3)


def test_lag_frequency_is_flap_frequency_less_rotor_speed():
    b = beam(lag_EI=EI, lag_inertia=0.0, flap_inertia=INERTIA)
    found = compute_modes(b, 5 * UNIT, count=12)
    difference = first(found, "flap", 1) ** 2 - first(found, "lag", 1) ** 2
    assert difference == pytest.approx((5 * UNIT) ** 2, rel=1e-8)


def test_hinge_spring_and_offset_have_the_closed_form():
    e, r0, stiff = 0.004, 0.01, 30.0
    b = beam(flap_EI=stiff, lag_EI=stiff, root_radius_m=r0, flap_root_N_m=0.02, hinge_radius_m=e)
    arm = b.gauss_radii_m - e
    inertia = b.integrate_over_span(MASS * arm**2)
    expected = (0.02 + 400.0**2 * b.integrate_over_span(MASS * arm * b.gauss_radii_m)) / inertia
    assert first(compute_modes(b, 400.0), "flap", 1)[0] ** 2 == pytest.approx(expected, rel=1e-4)


def test_free_hinge_of_a_twisted_tapered_blade_flaps_with_the_disc():
    rotor = load_rotor("walkera-5g6")
    b = make_blade_beam(rotor, with_free_flap_hinge(rotor.blade.structure))
    assert np.ptp(b.twist_rad) > 0.1
    assert np.ptp(b.centroid_behind_m) > 5e-4
    found = compute_modes(b, 443.6, pitch_rad=0.2)
    assert first(found, "flap", 1)[0] / 443.6 == pytest.approx(1.0, abs=2e-4)


def test_rayleigh_quotient_is_the_square_of_the_frequency():
    b, speed, pitch = make_blade_beam(load_rotor("walkera-5g6")), 443.6, 0.2
    found = compute_modes(b, speed, pitch_rad=pitch)
    elastic, centrifugal = stiffness_matrices(b, pitch)
    stiff, mass = elastic + speed**2 * centrifugal, mass_matrix(b, pitch)
    for x, w in zip(found.shape, found.frequency_rad_s, strict=True):
        assert (x @ stiff @ x) / (x @ mass @ x) == pytest.approx(w**2, rel=1e-6)


def test_doubled_elements_leave_the_frequencies():
    rotor = load_rotor("walkera-5g6")
    coarse, fine = (make_blade_beam(rotor, elements=n) for n in (20, 40))
    pair = [select_campbell_frequencies(compute_modes(b, 443.6, pitch_rad=0.2, count=9)) for b in (coarse, fine)]
    assert pair[0] == pytest.approx(pair[1], rel=1e-4)


def test_centrifugal_matrices_are_symmetric_and_scale_with_the_speed():
    b = make_blade_beam(load_rotor("walkera-5g6"))
    for matrix in (*stiffness_matrices(b, 0.2), mass_matrix(b, 0.2)):
        assert np.allclose(matrix, matrix.T, rtol=0, atol=1e-12 * np.abs(matrix).max())
    soft = replace(b, flap_EI=1e-9 * b.flap_EI, lag_EI=1e-9 * b.lag_EI, torsion_GJ=1e-9 * b.torsion_GJ)
    one, two = (compute_modes(soft, w).frequency_rad_s for w in (300.0, 600.0))
    assert two[:4] == pytest.approx(2.0 * one[:4], rel=1e-3, abs=1e-2)


def arc(half_angle, radius=1.0, n=2001):
    a = np.linspace(-half_angle, half_angle, n)
    return radius * np.cos(a), radius * np.sin(a)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.2, 1.57), st.floats(0.0, 6.28))
def test_shear_centre_of_a_thin_arc(half, turn):
    x, y = arc(half)
    c, s = math.cos(turn), math.sin(turn)
    found = shear_centre(c * x - s * y, s * x + c * y, np.full(x.size, 1e-5))
    # Timoshenko: distance from the centre of the circle
    distance = 2.0 * (math.sin(half) - half * math.cos(half)) / (half - math.sin(half) * math.cos(half))
    assert found == pytest.approx((c * distance, s * distance), abs=2e-4)


def test_shear_centre_of_a_semicircle_and_of_flat_sections():
    x, y = arc(math.pi / 2)
    assert shear_centre(x, y, np.full(x.size, 1e-6))[0] == pytest.approx(4.0 / math.pi, rel=1e-5)
    x = np.linspace(0.0, 1.0, 401)
    assert shear_centre(x, 0 * x, np.full(x.size, 0.03))[0] == pytest.approx(0.5, abs=1e-9)
    t = 0.1 * (1.0 - x) + 1e-6
    assert shear_centre(x, 0 * x, t)[0] == pytest.approx(0.2, abs=1e-3)  # int x t^3 / int t^3


def test_section_constants_of_a_flat_plate():
    chord, t = np.array([0.02]), 0.001
    flat = np.zeros((1, thickness_and_camber_lines("naca0012")[0].size))
    k = section_geometry(chord, flat, flat, t)
    assert k.area_m2[0] == pytest.approx(2e-5)
    assert k.flap_inertia_m4[0] == pytest.approx(0.02 * t**3 / 12)
    assert k.lag_inertia_m4[0] == pytest.approx(t * 0.02**3 / 12, rel=1e-3)
    assert k.torsion_constant_m4[0] == pytest.approx(0.02 * t**3 / 3, rel=0.01)
    assert k.centroid_m[0] == pytest.approx(0.01)


def structured(**structure):
    tables = load_rotor("walkera-5g6").toml_tables()
    tables["blade"]["structure"] = {"material": "abs", **structure}
    return rotor_from_tables(tables, "blade.toml")


def quantity(value, unit, **more):
    return {"value": value, "unit": unit, "source": "measured", **more}


def test_measured_values_set_mass_and_stiffness():
    rotor = structured(
        mass=quantity(0.8, "g"), flap_stiffness=quantity(3.0, "N mm2"),
        torsion_stiffness=quantity(9e-4, "N m2"),
    )  # fmt: skip
    b = make_blade_beam(rotor)
    at = 0.75 * rotor.radius_m
    assert b.blade_mass_kg == pytest.approx(8e-4)
    assert np.interp(at, b.gauss_radii_m.ravel(), b.flap_EI.ravel()) == pytest.approx(3e-6, rel=1e-3)
    assert np.interp(at, b.gauss_radii_m.ravel(), b.torsion_GJ.ravel()) == pytest.approx(9e-4, rel=1e-3)


def test_band_of_the_flap_frequency():
    wide = compute_flap_mode(structured(), 443.6)
    clamped = compute_flap_mode(structured(root="clamped"), 443.6)
    sharp = compute_flap_mode(
        structured(
            root="clamped", flap_stiffness=quantity(2e-3, "N m2", std=0.0), mass=quantity(0.64, "g", std=0.0),
            thickness=quantity(0.5, "mm", std=0.0), elastic_axis=quantity(0.4, "1", std=0.0),
        ),
        443.6,
    )  # fmt: skip
    assert wide.ratio == clamped.ratio
    assert wide.ratio_low == pytest.approx(1.0, abs=1e-3)
    assert 1.5 < clamped.ratio_low < clamped.ratio < clamped.ratio_high < 1.8
    assert sharp.ratio_high - sharp.ratio_low < 0.1 * (clamped.ratio_high - clamped.ratio_low)
    assert clamped.shape[-1] == 1.0
    assert clamped.shape[0] == 0.0
    assert np.all(np.diff(clamped.shape) > 0)
    assert clamped.lock_number == pytest.approx(3.64, abs=0.1)
    bare = compute_flap_mode(load_rotor("naca0012-r60-c20"), 600.0)
    assert not bare.known
    assert "assumed" in bare.assumptions
    assert wide.known


def test_hingeless_blade_of_the_vehicle_and_its_diagram():
    found = compute_campbell(load_rotor("walkera-5g6"), [0.0, 443.6], structure=BladeStructure(material="abs"))
    assert found.frequency_rad_s[1, 0] / 443.6 == pytest.approx(1.65, abs=0.05)
    assert np.all(found.low_rad_s <= found.frequency_rad_s)
    assert np.all(found.high_rad_s >= found.frequency_rad_s)
    assert found.centroid == pytest.approx(0.47, abs=0.01)
    assert found.shear_centre == pytest.approx(0.38, abs=0.02)
    assert len(found.plot().axes) == 1


def test_structure_survives_a_rotor_file(tmp_path):
    rotor = structured(thickness=quantity(0.8, "mm", std=0.05), root="hinged", flap_spring=quantity(3, "mN m/rad"))
    file = tmp_path / "blade.toml"
    file.write_text(format_rotor_toml(rotor), encoding="utf-8")
    again = load_rotor(file)
    assert again.blade.structure == rotor.blade.structure
    assert float(again.blade.structure.thickness) == pytest.approx(8e-4)
    assert "structure" not in load_rotor("naca0012-r60-c20").toml_tables()["blade"]


@pytest.mark.parametrize(
    ("structure", "words"),
    [
        ({"material": "oak"}, ("blade.structure.material", "oak", "use one of")),
        ({"hinge_radius": quantity(1, "mm")}, ("blade.structure.hinge_radius", "unknown", 'root = "hinged"')),
        ({"thickness": 0.8}, ("blade.structure.thickness", "0.8", "unit")),
        ({"thickness": quantity(-1, "mm")}, ("blade.structure.thickness", "-0.001", "above 0")),
        ({"stiffness": 3}, ("blade.structure.stiffness",)),
    ],
)
def test_faults_of_a_structure_are_one_line(structure, words):
    with pytest.raises(InputError) as error:
        structured(**structure)
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith("blade.toml: ")
    assert all(w in text for w in words)


def test_faults_of_a_blade_are_one_line():
    with pytest.raises(InputError, match="beyond the cut-out"):
        make_blade_beam(structured(root="hinged", hinge_radius=quantity(30, "mm")))
    with pytest.raises(InputError, match=r"blade\.structure: is missing.*add \[blade\.structure\]"):
        make_blade_beam(load_rotor("naca0012-r60-c20"))
    with pytest.raises(InputError, match="speed_rad_s"):
        compute_flap_mode(load_rotor("walkera-5g6"), 0.0)


def test_command_prints_and_draws(tmp_path):
    ask = ["rotor", "beam", "walkera-5g6", "--rpm", "0:6000:3000", "--out", str(tmp_path)]
    told = CliRunner().invoke(app, ask)
    assert told.exit_code == 0
    assert "Lock number" in told.output
    assert "root is not known" in told.output
    assert (tmp_path / "campbell.png").stat().st_size > 5000
    lines = (tmp_path / "campbell.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 4
    assert lines[0].startswith("speed_rpm,flap_1_value_Hz,flap_1_low_Hz")
    listed = CliRunner().invoke(app, ["rotor", "beam", "--materials"])
    assert all(name in listed.output for name in MATERIALS)
