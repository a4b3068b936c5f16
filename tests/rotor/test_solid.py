"""Blades as bodies: closed, of the right volume, and found again by cutting."""

import re
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError
from mufly.rotor import load_rotor, make_rotor
from mufly.rotor.bemt import solve_rotor_batch
from mufly.rotor.blades.blade_solid import (
    blade_contours,
    join_solids,
    loft_solid,
    make_hub_solid,
    mirror_solid,
    read_stl,
    rotate_about_shaft,
    write_stl,
)
from mufly.rotor.blades.body_import import rotor_from_body, slice_blade
from mufly.rotor.blading import prepare_blading
from mufly.rotor.sections.airfoil import load_airfoil


def section_area(name):
    x, y = load_airfoil(name).coordinates.T
    return abs(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


@pytest.fixture(scope="module")
def rotor():
    return make_rotor(
        name="p", radius_m=0.06, chord_m=[0.012, 0.018, 0.008], twist_rad=np.radians([30.0, 18.0, 9.0]),
        r_over_R=[0.2, 0.5, 1.0], airfoils=["clarky", "clarky", "naca4409"], hub_cutout=0.2,
    )  # fmt: skip


@pytest.mark.parametrize("tail_m", [0.0, 4e-4])
def test_closed_and_of_the_volume_of_its_sections(tail_m):
    r = load_rotor("naca0012-r60-c20")
    blade = loft_solid(blade_contours(r, tail_m=tail_m))
    assert blade.count_open_edges() == 0
    span = r.radius_m * (1.0 - float(r.hub_cutout))
    missing = tail_m - 0.02 * np.ptp(load_airfoil("naca0012").coordinates[[0, -1], 1])
    wedge = 0.5 * 0.02 * max(missing, 0.0)  # what opens the tail grows along the chord
    assert_allclose(blade.volume_m3, span * (section_area("naca0012") * 0.02**2 + wedge), rtol=3e-3)
    torn = type(blade)(blade.points_m, blade.triangles[1:])
    assert torn.count_open_edges() == 3
    other = mirror_solid(blade)
    assert_allclose((other.count_open_edges(), other.volume_m3), (0, blade.volume_m3))


def test_hub_and_all_blades(rotor, tmp_path):
    ring, disc = make_hub_solid(0.006, 0.001, -0.003, 0.003), make_hub_solid(0.006, 0.0, -0.003, 0.003)
    assert ring.count_open_edges() == disc.count_open_edges() == 0
    assert_allclose([ring.volume_m3, disc.volume_m3], np.pi * np.array([35e-6, 36e-6]) * 0.006, rtol=2e-3)
    blade = loft_solid(blade_contours(rotor, along=25, per_side=24))
    whole = join_solids([blade, rotate_about_shaft(blade, np.pi), ring])
    assert whole.count_open_edges() == 0
    assert_allclose(whole.volume_m3, 2 * blade.volume_m3 + ring.volume_m3)
    write_stl(tmp_path / "p.stl", whole)
    data = (tmp_path / "p.stl").read_bytes()
    assert struct.unpack_from("<I", data, 80)[0] == len(whole.triangles)
    assert_allclose(read_stl(tmp_path / "p.stl"), whole.points_m[whole.triangles], atol=1e-8)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("tail_m", [0.0, 3e-4])
def test_a_body_is_cut_into_the_stations_that_it_was_made_of(rotor, tmp_path, tail_m, way):
    blade = loft_solid(blade_contours(rotor, tail_m=tail_m))
    body = join_solids([rotate_about_shaft(blade, 2.0 * np.pi * k / 3.0) for k in range(3)])
    write_stl(tmp_path / "p.stl", body if way > 0 else mirror_solid(body))
    x = np.array([0.25, 0.4, 0.6, 0.8, 0.95])
    cut = slice_blade(read_stl(tmp_path / "p.stl"), 0.06 * x)
    assert_allclose([s.chord_m for s in cut], rotor.chord_m(x), rtol=5e-3)
    assert_allclose([s.twist_rad for s in cut], rotor.twist_rad(x), atol=np.radians(0.4))
    again, notes = rotor_from_body(tmp_path / "p.stl", folder=tmp_path, blades=3)
    assert_allclose(again.chord_m(x), rotor.chord_m(x), rtol=2e-2)
    assert_allclose(again.twist_rad(x), rotor.twist_rad(x), atol=np.radians(0.7))
    assert (again.blades, len(notes)) == (3, 1)
    camber = load_airfoil(again.blade.airfoils[5]).camber
    assert_allclose(camber, load_airfoil("clarky").camber, atol=5e-3)


def test_a_scan_of_a_whole_rotor_is_turned_and_its_hub_left_out(rotor, tmp_path):
    blade = loft_solid(blade_contours(rotor, along=25, per_side=24))
    whole = join_solids([blade, rotate_about_shaft(blade, np.pi), make_hub_solid(0.006, 0.001, -0.003, 0.003)])
    plain, _ = rotor_from_body(_saved(tmp_path / "one.stl", blade), folder=tmp_path)
    x = np.linspace(0.25, 0.98, 20)
    for angle in (0.0, 50.0):
        turned = rotate_about_shaft(whole, np.radians(angle))
        found, notes = rotor_from_body(_saved(tmp_path / "p.stl", turned), folder=tmp_path)
        assert float(found.hub_cutout) == pytest.approx(0.2, abs=0.02)
        assert_allclose(found.chord_m(x), plain.chord_m(x), rtol=0.01)
        assert_allclose(found.twist_rad(x), plain.twist_rad(x), atol=np.radians(0.3))
        assert any("turned by" in note for note in notes) == (angle != 0.0)
    tilted = type(blade)(blade.points_m[:, [0, 2, 1]] * [1.0, -1.0, 1.0], blade.triangles)
    with pytest.raises(InputError, match="chord along z"):
        rotor_from_body(_saved(tmp_path / "p.stl", tilted), folder=tmp_path)


def _saved(file, body):
    write_stl(file, body)
    return file


@pytest.mark.parametrize(("unit_m", "unit"), [(1.0, "m"), (0.0254, "in"), (1e-6, "um")])
def test_a_body_in_another_unit_than_mm_is_asked_for_its_unit(rotor, tmp_path, unit_m, unit):
    """STL files know no unit: in mm these rotors would have radii of 0.06 mm, 2.4 mm and 60 m."""
    body = loft_solid(blade_contours(rotor))
    write_stl(tmp_path / "p.stl", type(body)(body.points_m * 1e-3 / unit_m, body.triangles))
    with pytest.raises(InputError, match=rf"is not known: p.stl reaches .* as unit={unit} \(R 60 mm"):
        rotor_from_body(tmp_path / "p.stl", folder=tmp_path)
    found, _ = rotor_from_body(tmp_path / "p.stl", folder=tmp_path, unit_m=unit_m)
    assert found.radius_m == pytest.approx(0.06, rel=1e-3)


def test_the_command_that_imports_a_body_takes_its_unit(rotor, tmp_path):
    body = loft_solid(blade_contours(rotor))
    write_stl(tmp_path / "p.stl", type(body)(body.points_m * 1e-3, body.triangles))
    run = ["rotor", "import", str(tmp_path / "p.stl"), "--out", str(tmp_path / "p.toml")]
    fault = CliRunner().invoke(app, run).exception
    assert isinstance(fault, InputError)
    assert "--unit m (R 60 mm)" in str(fault)
    assert CliRunner().invoke(app, [*run, "--unit", "m"]).exit_code == 0
    assert load_rotor(tmp_path / "p.toml").radius_m == pytest.approx(0.06, rel=1e-3)
    wrong = CliRunner().invoke(app, [*run, "--unit", "bananas"]).exception
    assert "'bananas' is not a length" in str(wrong)


def test_what_is_no_body_is_said(rotor, tmp_path):
    (tmp_path / "a.stl").write_text("hello")
    with pytest.raises(InputError, match="is not an STL file"):
        read_stl(tmp_path / "a.stl")
    (tmp_path / "b.stl").write_text("solid\n" + "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n" * 3)
    with pytest.raises(InputError, match="no closed sections"):
        rotor_from_body(tmp_path / "b.stl", folder=tmp_path)
    with pytest.raises(InputError, match="tail"):
        blade_contours(rotor, tail_m=0.01)


def _noisy(body, std_mm, seed, missing=0.0):
    rng = np.random.default_rng(seed)
    points = body.points_m + 1e-3 * std_mm * rng.standard_normal(body.points_m.shape)
    return type(body)(points, body.triangles[rng.random(len(body.triangles)) >= missing])


def _thrust_and_torque(rotor):
    found = solve_rotor_batch(
        prepare_blading(rotor), pitch_rad=np.radians(10.0), speed_rad_s=628.0, climb_m_s=0.0
    )  # fmt: skip
    return np.array([float(found.thrust_N), float(found.torque_Nm)])


@pytest.fixture(scope="module")
def wide_blade(tmp_path_factory):
    """Return a blade with a chord of 20 mm and a tail of 0.5 mm, and the rotor of its exact body."""
    folder = tmp_path_factory.mktemp("exact")
    blade = loft_solid(blade_contours(load_rotor("naca4412-r60-c20"), tail_m=5e-4))
    exact, _ = rotor_from_body(_saved(folder / "p.stl", blade), folder=folder)
    return blade, exact


@pytest.mark.parametrize(
    ("std_mm", "seed", "missing", "limit"),
    [(0.01, 1, 0.0, 0.01), (0.03, 2, 0.0, 0.035), (0.05, 1, 0.0, 0.05), (0.0, 1, 0.03, 0.005), (0.03, 2, 0.03, 0.035)],
)
def test_noisy_scans_with_gaps_have_the_loads_of_the_exact_blade(wide_blade, tmp_path, std_mm, seed, missing, limit):
    blade, truth = wide_blade
    exact = _thrust_and_torque(truth)
    scan = _saved(tmp_path / "p.stl", _noisy(blade, std_mm, seed, missing))
    found, notes = rotor_from_body(scan, folder=tmp_path)
    assert np.max(np.abs(_thrust_and_torque(found) / exact - 1.0)) < limit
    assert float(found.hub_cutout) == pytest.approx(0.15, abs=0.01)
    said = "\n".join(notes)
    assert "degrees of the angle" in said
    if std_mm > 0.0:
        angle_std = float(re.search(r"([\d.]+) degrees of the angle", said)[1])
        x = np.linspace(0.4, 0.9, 11)
        wrong = np.degrees(found.twist_rad(x) - truth.twist_rad(x))
        assert 0.25 * angle_std < np.std(wrong) < 4.0 * angle_std  # about the mean: chord lines of noses differ
    assert ("gaps of the surface were closed" in said) == (missing > 0.0)


def test_a_rotor_off_its_shaft_or_upside_down_is_moved(rotor, tmp_path):
    blade = loft_solid(blade_contours(rotor, along=25, per_side=24))
    whole = join_solids([rotate_about_shaft(blade, 2.0 * np.pi * k / 3.0) for k in range(3)])
    plain, notes = rotor_from_body(_saved(tmp_path / "p.stl", whole), folder=tmp_path)
    assert plain.blades == 3
    assert any("the body has 3 blades" in note for note in notes)
    x = np.linspace(0.25, 0.95, 8)
    for points, words in (
        (whole.points_m + np.array([0.03, -0.012, 0.005]), r"axis of symmetry lies at (30.00, -12.00) mm"),
        (whole.points_m * [1.0, -1.0, -1.0], "upside down"),
    ):
        found, notes = rotor_from_body(
            _saved(tmp_path / "p.stl", type(whole)(points, whole.triangles)), folder=tmp_path
        )  # fmt: skip
        assert any(words in note for note in notes)
        assert found.radius_m == pytest.approx(0.06, rel=1e-3)
        assert_allclose(found.chord_m(x), plain.chord_m(x), rtol=0.01)
        assert_allclose(found.twist_rad(x), plain.twist_rad(x), atol=np.radians(0.3))
    kept, notes = rotor_from_body(tmp_path / "p.stl", folder=tmp_path, axis="z", blades=2)
    assert float(kept.twist_rad(0.7)) < 0.0
    said = "\n".join(notes)
    assert "is negative at mid-span" in said
    assert "3 blades, not 2" in said
    on_side = type(whole)(whole.points_m[:, [2, 0, 1]], whole.triangles)
    with pytest.raises(InputError, match="give --axis with the direction of the thrust"):
        rotor_from_body(_saved(tmp_path / "p.stl", on_side), folder=tmp_path)
    turned, _ = rotor_from_body(tmp_path / "p.stl", folder=tmp_path, axis="x")
    assert_allclose(turned.twist_rad(x), plain.twist_rad(x), atol=np.radians(0.3))


def test_a_single_blade_beside_the_shaft_is_refused_until_its_centre_is_given(rotor, tmp_path):
    blade = loft_solid(blade_contours(rotor, along=25, per_side=24))
    scan = _saved(tmp_path / "p.stl", type(blade)(blade.points_m + np.array([0.03, -0.012, 0.005]), blade.triangles))
    with pytest.raises(InputError, match=r"passes the shaft .* give --centre X,Y"):
        rotor_from_body(scan, folder=tmp_path)
    run = ["rotor", "import", str(scan), "--out", str(tmp_path / "p.toml"), "--centre", "30,-12"]
    assert CliRunner().invoke(app, run).exit_code == 0
    assert load_rotor(tmp_path / "p.toml").radius_m == pytest.approx(0.06, rel=1e-3)
    shifted = _saved(tmp_path / "p.stl", type(blade)(blade.points_m + np.array([0.03, 0.0, 0.0]), blade.triangles))
    _, notes = rotor_from_body(shifted, folder=tmp_path)
    assert any("is the shaft at the origin" in note for note in notes)


def test_a_unit_that_makes_no_rotor_is_refused(rotor, tmp_path):
    scan = _saved(tmp_path / "p.stl", loft_solid(blade_contours(rotor)))
    with pytest.raises(InputError, match=r"radius of 6e\+04 mm; give its unit, as unit=.*mm \(R 60 mm\)"):
        rotor_from_body(scan, folder=tmp_path, unit_m=1.0)
