"""Thickness along the blade: limits, closed forms, and the same sections in polars, solid, beam and studies."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from mufly.errors import InputError
from mufly.rotor import (
    blade_thickness_m,
    format_rotor_toml,
    import_rotor,
    load_airfoil,
    load_rotor,
    make_rotor,
    prepare_blading,
    replace_rotor,
    solve_rotor_batch,
)
from mufly.rotor.blades.blade_families import list_section_probabilities
from mufly.rotor.blades.blade_solid import blade_contours, loft_solid
from mufly.rotor.sections import neuralfoil_network, polar_engines
from mufly.rotor.structure.blade_structure import BladeStructure
from mufly.rotor.structure.coupled_rounds import add_elastic_twist
from mufly.rotor.structure.flap_modes import make_blade_beam
from mufly.study.study_setup import reshape_rotor

PLAIN = load_rotor("naca4412-r60-c20")
AREA_OVER_THICKNESS = 0.685  # of a four-digit section, over chord squared: integral of y_t / t (Report 460), twice
MISSING = polar_engines.xfoil_unavailable_reason()


def loads(rotor):
    found = solve_rotor_batch(prepare_blading(rotor), pitch_rad=0.2, speed_rad_s=600.0)
    return np.array([found.thrust_N, found.torque_Nm])


def tapered(stations=2, airfoil="naca4412"):
    x = np.linspace(0.0, 1.0, stations)
    return make_rotor(
        name="t", radius_m=0.06, chord_m=0.02, airfoils=airfoil, r_over_R=x, thickness=np.linspace(0.28, 0.12, stations)
    )


def test_the_airfoils_own_thickness_changes_nothing_to_the_last_bit():
    same = replace_rotor(PLAIN, {"blade.thickness": 0.12})
    assert_array_equal(loads(same), loads(PLAIN))
    assert_array_equal(blade_contours(same), blade_contours(PLAIN))
    other = replace_rotor(PLAIN, {"blade.thickness": 0.13})
    assert np.all(loads(other) != loads(PLAIN))
    assert_array_equal(loads(other), loads(replace_rotor(PLAIN, {"blade.airfoils": "naca4412+thick13"})))


def test_two_stations_equal_a_fine_division():
    assert_allclose(loads(tapered()), loads(tapered(33)), rtol=4e-3)
    thick, thin = (loads(replace_rotor(PLAIN, {"blade.thickness": t})) for t in (0.28, 0.12))
    assert np.all((loads(tapered()) - thick) * (loads(tapered()) - thin) < 0.0)


def test_thickness_is_linear_between_stations_and_the_file_reads_back(tmp_path):
    x = np.linspace(0.15, 1.0, 18)
    rotor = tapered()
    assert_allclose(blade_thickness_m(rotor, x), 0.02 * (0.28 - 0.16 * x), rtol=2e-3)
    (tmp_path / "t.toml").write_text(format_rotor_toml(rotor))
    assert load_rotor(tmp_path / "t.toml") == rotor
    contours = blade_contours(rotor, along=9)
    camber = [load_airfoil(f"naca4412+thick{t}").camber for t in (12, 28)]
    assert_allclose(camber[0], camber[1], rtol=1e-3)
    height = np.ptp(contours[:, :, 2], axis=1)
    assert np.all(np.diff(height) < 0.0)


def test_solid_has_the_volume_of_its_sections():
    blade = loft_solid(blade_contours(tapered(airfoil="naca0012")))
    mean = 0.5 * (blade_thickness_m(tapered(), [0.15]) + blade_thickness_m(tapered(), [1.0]))[0]
    assert blade.count_open_edges() == 0
    assert_allclose(blade.volume_m3, 0.85 * 0.06 * AREA_OVER_THICKNESS * 0.02 * mean, rtol=5e-3)


def test_beam_and_study_keep_the_thickness():
    rotor, material = tapered(airfoil="naca0012"), BladeStructure(material="abs")
    beam = make_blade_beam(rotor, material)
    ratio = (0.28 - 0.16 * beam.gauss_radii_m / 0.06) / 0.12
    thin = make_blade_beam(replace_rotor(PLAIN, {"blade.airfoils": "naca0012"}), material)
    assert_allclose(beam.flap_EI / thin.flap_EI[0, 0], ratio**3, rtol=0.01)
    x = np.linspace(0.15, 1.0, 7)
    for changed in (reshape_rotor(rotor, {"taper": 0.5}), reshape_rotor(rotor, {"airfoil": "naca2412"})):
        assert_allclose(changed.stated_thickness(x), rotor.stated_thickness(x), rtol=1e-12)
    assert reshape_rotor(rotor, {"thickness": 0.15}).airfoil_names() == ("naca0015",)
    bent = add_elastic_twist(rotor, beam, np.zeros(beam.edges_m.size))
    assert_allclose(bent.stated_thickness(x), rotor.stated_thickness(x), rtol=1e-12)


def test_a_known_thickness_leaves_the_camber_to_guess():
    listed = list_section_probabilities(tapered())
    assert len(listed) == 5
    assert sum(w for _, w in listed) == pytest.approx(1.0)
    assert {replace_rotor(tapered(), {"blade.airfoils": a}).airfoil_names()[-1][-8:] for a, _ in listed} == {"+thick12"}


@pytest.mark.parametrize(
    ("head", "rows"),
    [
        ("r_mm,chord_mm,beta_deg,t/c", ("10,10,30,0.2", "60,5,10,0.1")),
        ("r_mm,chord_mm,beta_deg,thickness (%)", ("60,5,10,10", "10,10,30,20")),
        ("r_mm,chord_mm,beta_deg,thickness_mm", ("10,10,30,2", "60,5,10,0.5")),
    ],
)
def test_tables_state_thickness_as_ratio_or_length(tmp_path, head, rows):
    (tmp_path / "t.csv").write_text("\n".join((head, *rows)))
    rotor = import_rotor(tmp_path / "t.csv", blades=2).rotor
    assert_allclose(rotor.stated_thickness([1 / 6, 1.0]), [0.2, 0.1])


def test_errors_name_the_key(tmp_path):
    (tmp_path / "t.csv").write_text("r_mm,chord_mm,beta_deg,thickness\n10,10,30,2\n60,5,10,1\n")
    with pytest.raises(InputError, match=r"thickness: has no unit; name it t/c"):
        import_rotor(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("r_mm,chord_mm,beta_deg,thickness_mm\n10,10,30,2\n60,5,10,4\n")
    with pytest.raises(InputError, match="not above 0 and up to 40 % of the chord"):
        import_rotor(tmp_path / "t.csv")
    (tmp_path / "p.csv").write_text("alpha_deg,cl,cd\n-5,-0.5,0.02\n0,0,0.01\n5,0.5,0.02\n")
    with pytest.raises(InputError, match=r"blade.thickness.*table of coefficients"):
        replace_rotor(tapered(), {"blade.airfoils": str(tmp_path / "p.csv")})
    with pytest.raises(InputError, match=r"blade\.thickness"):
        replace_rotor(PLAIN, {"blade.thickness": 0.6})


@pytest.mark.skipif(bool(MISSING), reason=MISSING)
def test_network_follows_xfoil_up_to_thirty_per_cent():
    airfoil, angles = load_airfoil("naca4412+thick30"), np.arange(0.0, 8.5, 2.0)
    theirs = polar_engines.compute_xfoil_polars(airfoil, [5e5], alpha_deg=angles)
    ours = neuralfoil_network.compute_neuralfoil_polars([airfoil], [5e5], n_crit=0.1)[0]
    same = np.isin(np.round(np.rad2deg(ours.alpha_rad), 6), angles)
    assert np.mean(np.abs(ours.cl[0, same] - theirs.cl[0])) < 0.03
    assert np.mean(np.abs(np.log(ours.cd[0, same] / theirs.cd[0]))) < 0.05
