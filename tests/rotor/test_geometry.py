"""Rotors: closed forms of their areas, files that read back, and every fault named in one line."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError, MuflyError
from mufly.rotor import (
    blade_thickness_m,
    format_rotor_toml,
    list_builtin_rotors,
    load_rotor,
    make_rotor,
    replace_rotor,
    rotor_from_tables,
)


def test_rectangular_blade_has_the_textbook_solidity():
    r = make_rotor(name="r", radius_m=0.06, chord_m=0.02, hub_cutout=0.0)
    sigma = 2 * 0.02 / (math.pi * 0.06)
    assert r.solidity == pytest.approx(sigma)
    assert r.thrust_solidity == pytest.approx(sigma)
    assert r.aspect_ratio == pytest.approx(3.0)
    assert r.disc_area_m2 == pytest.approx(math.pi * 0.06**2)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(0.01, 0.5),
    st.floats(0.0, 0.6),
    st.lists(st.tuples(st.floats(0.05, 1.0), st.floats(0.01, 1.0)), min_size=2, max_size=8),
)
def test_areas_are_the_integrals_of_the_chord(radius, cutout, table):
    x = np.cumsum([t[0] for t in table])
    x = np.append(0.0, x / x[-1])
    chord = radius * np.append(table[0][1], [t[1] for t in table])
    r = make_rotor(name="r", radius_m=radius, chord_m=chord, r_over_R=x, hub_cutout=cutout, blades=3)
    fine = np.linspace(cutout, 1.0, 200001)
    area = radius * np.trapezoid(r.chord_m(fine), fine)
    assert r.blade_area_m2 == pytest.approx(area, rel=1e-6)
    weighted = 3 * 3 / (math.pi * radius) * np.trapezoid(r.chord_m(fine) * fine**2, fine)
    assert r.thrust_solidity == pytest.approx(weighted, rel=1e-6)


def test_sections_mix_airfoils_linearly_between_stations():
    r = make_rotor(
        name="r",
        radius_m=0.1,
        chord_m=[0.03, 0.02, 0.01],
        twist_rad=[0.3, 0.2, 0.0],
        r_over_R=[0.2, 0.6, 1.0],
        airfoils=["naca4412", "naca4412", "goe394"],
    )
    s = r.sections_at([0.0, 0.2, 0.4, 0.8, 1.0])
    assert s.airfoil_names == ("naca4412", "goe394")
    assert np.allclose(s.chord_m, [0.03, 0.03, 0.025, 0.015, 0.01])
    assert np.allclose(s.twist_rad, [0.3, 0.3, 0.25, 0.1, 0.0])
    assert np.allclose(s.second_weight, [0.0, 0.0, 0.0, 0.5, 1.0])
    assert s.first_airfoil.tolist() == [0, 0, 0, 0, 0]
    assert s.second_airfoil.tolist() == [0, 0, 0, 1, 1]
    thick = blade_thickness_m(r, [0.2, 0.8, 1.0])
    assert thick[0] == pytest.approx(0.03 * 0.1202, rel=2e-3)
    assert thick[2] == pytest.approx(0.01 * 0.0610, rel=5e-3)
    assert thick[1] == pytest.approx(0.015 * (0.1202 + 0.0610) / 2, rel=5e-3)


def test_built_in_rotors_are_those_of_the_source():
    assert list_builtin_rotors() == ["naca0012-r60-c20", "naca4412-r60-c20", "walkera-5g6"]
    r = load_rotor("naca0012-r60-c20")
    assert (r.blades, r.radius_m, r.airfoil_names()) == (2, pytest.approx(0.06), ("naca0012",))
    assert r.hub_cutout.source == "estimated"
    assert r.aspect_ratio == pytest.approx(2.55)
    walkera = load_rotor("walkera-5g6")
    assert walkera.radius_m == pytest.approx(0.0875)
    assert {walkera.blade.chord.source, walkera.blade.twist.source, walkera.hub_cutout.source} == {"estimated"}


@pytest.mark.parametrize("name", list_builtin_rotors())
def test_written_rotor_reads_back_equal(tmp_path, name):
    r = load_rotor(name)
    path = tmp_path / "r.toml"
    path.write_text(format_rotor_toml(r))
    assert load_rotor(path) == r


def test_airfoil_files_are_sought_beside_the_rotor_file(tmp_path):
    text = format_rotor_toml(load_rotor("naca4412-r60-c20")).replace('"naca4412"', '"own.dat"')
    (tmp_path / "own.dat").write_text("")
    (tmp_path / "r.toml").write_text(text)
    assert load_rotor(tmp_path / "r.toml").airfoil_names() == (str(tmp_path / "own.dat"),)


GOOD = {"name": "r", "radius_m": 0.06, "chord_m": 0.02}


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ({"blades": 0}, "blades", "at least 1"),
        ({"blades": 2.5}, "blades", "whole number"),
        ({"chord_m": [0.02, 0.02, 0.02]}, "blade.chord", "3 values for 2 stations"),
        ({"chord_m": -0.02}, "blade.chord", "above 0"),
        ({"chord_m": math.nan}, "blade.chord", "out of range"),
        ({"r_over_R": (1.0, 0.2)}, "blade.r_over_R", "hub to tip"),
        ({"r_over_R": (0.2, 0.2, 1.0)}, "blade.r_over_R", "is not beyond station 1"),
        ({"r_over_R": (0.1, 0.9)}, "blade.r_over_R", "the tip, 1"),
        ({"r_over_R": (1.0,)}, "blade.r_over_R", "at least two stations"),
        ({"radius_m": 0.0}, "radius", "above 0"),
        ({"radius_m": 0.00006}, "blade.chord", "more than the radius"),
        ({"hub_cutout": 1.0}, "hub_cutout", "below 1"),
        ({"hub_cutout": 0.95}, "hub_cutout", "leaves no blade"),
        ({"airfoils": ["a", "b", "c"]}, "blade.airfoils", "3 airfoils for 2 stations"),
        ({"airfoils": []}, "blade.airfoils", ""),
    ],
)
def test_faults_are_named(change, key, words):
    with pytest.raises(InputError) as fault:
        make_rotor(**{**GOOD, **change})
    assert fault.value.key == key
    assert words in str(fault.value)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("blads = 2", "blads: unknown key; did you mean 'blades'?"),
        ("blades = 2", "radius: is missing"),
        ("blades = 2\nradius = 60", "60 states neither unit nor source"),
        ("blades = 2\nradius = { value = 60, unit = 'kg', source = 'measured' }", "use one of: m, cm, mm"),
        ("radius = ", "ends inside a value; close its brackets or quotes"),
    ],
)
def test_faults_in_files_are_named(tmp_path, text, words):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(InputError) as fault:
        load_rotor(path)
    assert words in str(fault.value)
    assert str(path) in str(fault.value)
    with pytest.raises(InputError, match="no such rotor or file"):
        load_rotor("naca0012-r61")


def test_every_corruption_is_a_rotor_or_one_line():
    odd = [math.nan, -1.0, 0.0, 1e300, "x", "", True, [], [1.0], {}, {"value": 1}, None]
    tables = load_rotor("walkera-5g6").toml_tables()
    places = [(k,) for k in tables] + [("blade", k) for k in tables["blade"]]
    places += [("blade", k, i) for k in ("r_over_R", "chord", "twist") for i in ("value", "unit", "source")]
    lines = []
    for place in places:
        for value in odd:
            changed = load_rotor("walkera-5g6").toml_tables()
            table = changed
            for key in place[:-1]:
                table = table[key]
            if value is None:
                del table[place[-1]]
            else:
                table[place[-1]] = value
            try:
                rotor_from_tables(changed)
            except MuflyError as fault:
                lines.append(str(fault))
    assert len(lines) > 100
    assert not any("\n" in line for line in lines)


def test_replace_changes_what_it_says_and_nothing_else():
    r = load_rotor("naca4412-r60-c20")
    changed = replace_rotor(r, {"blade.chord": 0.03, "blades": 3, "blade.airfoils": "goe394"})
    assert np.allclose(changed.chord_m([0.3, 0.9]), 0.03)
    assert changed.blade.chord.source == "specified"
    assert (changed.blades, changed.airfoil_names(), changed.radius_m) == (3, ("goe394",), r.radius_m)
    assert replace_rotor(r, {}) == r
    with pytest.raises(InputError, match="no such key"):
        replace_rotor(r, {"blade.cord": 0.03})
    with pytest.raises(InputError, match="above 0"):
        replace_rotor(r, {"blade.chord": 0.0})
