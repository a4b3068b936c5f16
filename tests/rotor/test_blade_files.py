"""Blades as others write them: UIUC's, APC's, calipers'; in foreign units, with what must be refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError, MuflyError
from mufly.rotor import format_rotor_toml, import_rotor, load_rotor, make_rotor
from mufly.rotor.sections.airfoil import load_airfoil, split_sides

UIUC = """  r/R     c/R     beta
 0.15   0.160   31.68
 0.50   0.200   20.00
 1.00   0.080    9.00
"""
# Layout of APC's files; the numbers are made up.
APC = """     5x4-PERF.PE0           5x4

  STATION      CHORD     PITCH     PITCH     PITCH      SWEEP  {rake}  THICKNESS  TWIST    MAX-THICK  CROSS-SECTION
    (IN)       (IN)    (QUOTED)   (LE-TE)  (PRATHER)    (IN)   {inch}    RATIO    (DEG)      (IN)        (IN**2)

    0.5000     0.5000    4.0000    3.9000    3.8000    0.2000  {zero}   0.2000    51.8500     0.1000      0.0300
    1.5000     0.6000    4.0000    3.9000    3.8000    0.2000  {zero}   0.1200    22.9900     0.0720      0.0300
    2.4000     0.3000    4.0000    3.9000    3.8000    0.1000  {zero}   0.1000    14.8600     0.0300      0.0060
    2.5000     0.0000    4.0000    3.9000    3.8000    0.0000  {zero}   0.1000    14.2800     0.0000      0.0000

 RADIUS:      2.50   PROPELLER RADIUS (IN)
 HUBTRA:      0.60   HUB TRANSITION (IN)
 BLADES:         3   NUMBER OF BLADES
 AIRFOIL1:    0.80, E63
 AIRFOIL2:    1.60, APC12
"""


def written(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_uiucs_geometry_with_its_diameter(tmp_path):
    r, notes = import_rotor(written(tmp_path, "p.txt", UIUC), radius_m=0.0635, airfoil="clarky")
    assert (r.blades, r.airfoil_names(), r.radius_m) == (2, ("clarky",), 0.0635)
    assert_allclose(r.chord_m([0.15, 0.5, 1.0]), [0.0635 * 0.16, 0.0635 * 0.2, 0.0635 * 0.08])
    assert_allclose(r.twist_rad([0.5]), math.radians(20))
    assert any("two blades" in note for note in notes)
    again = written(tmp_path, "p.toml", format_rotor_toml(r))
    assert load_rotor(again).blade == r.blade


@pytest.mark.parametrize("newer", [False, True])
def test_apcs_own_file_old_and_new(tmp_path, newer):
    """The newer layout has one column more (rake), before those that count."""
    text = APC.format(
        **({"rake": "RAKE", "inch": "(IN)", "zero": "0.0"} if newer else dict.fromkeys(("rake", "inch", "zero"), ""))
    )
    r, notes = import_rotor(written(tmp_path, "5x4-PERF.PE0", text))
    assert (r.blades, r.airfoil_names()) == (3, ("e63+thick20", "e63+blend90-naca4412+thick12", "naca4412+thick10"))
    assert_allclose(r.radius_m, 2.5 * 0.0254)
    assert_allclose(r.blade.r_over_R.value, [0.2, 0.6, 0.96, 1.0])
    assert_allclose(r.chord_m(0.6), 0.6 * 0.0254)
    assert_allclose(r.twist_rad(0.6), math.radians(22.99))
    assert any("APC12" in note for note in notes)
    assert any("e63 blends into naca4412 from 20.3 to 40.6 mm" in note for note in notes)


def test_contours_of_an_apc_file_blend_linearly_between_its_airfoils(tmp_path):
    """Halfway between both radii the mean lines of both airfoils are averaged, at the file's thickness."""
    text = APC.format(rake="", inch="", zero="").replace("1.5000     0.6", "1.2000     0.6")
    r, _ = import_rotor(written(tmp_path, "p.PE0", text))
    middle = load_airfoil(r.airfoil_names()[1])
    x = np.linspace(0.05, 0.95, 10)

    def mean_line(airfoil):
        upper, lower = split_sides(airfoil.coordinates)
        return 0.5 * (np.interp(x, *upper.T) + np.interp(x, *lower.T))

    inner, outer = load_airfoil("e63"), load_airfoil("naca4412")
    assert middle.thickness_ratio == pytest.approx(0.12, abs=1e-3)
    assert_allclose(mean_line(middle), 0.5 * (mean_line(inner) + mean_line(outer)), atol=3e-4)
    assert np.max(np.abs(mean_line(inner) - mean_line(outer))) > 0.01


def test_an_apc_file_without_airfoils_keeps_its_thickness(tmp_path):
    text = "".join(line for line in APC.splitlines(True) if "AIRFOIL" not in line)
    r, notes = import_rotor(written(tmp_path, "p.PE0", text.format(rake="", inch="", zero="")))
    assert_allclose(r.stated_thickness([0.2, 0.6, 0.96]), [0.20, 0.12, 0.10])
    assert r.airfoil_names() == ("naca4412+thick20", "naca4412+thick17.33", "naca4412+thick14.67",
                                 "naca4412+thick12", "naca4412+thick10")  # fmt: skip
    assert any("naca4412 with the file's thickness assumed" in note for note in notes)


def test_calipers_in_inches_with_sections_and_commas(tmp_path):
    path = written(tmp_path, "c.csv", "\ufeffr (in);chord_mm;beta;section\n0,5;10;30;clarky\n2,5;6;10,5;naca4412\n")
    r, _ = import_rotor(path, blades=4)
    assert_allclose((r.radius_m, r.chord_m(0.2), float(r.twist_rad(1.0))), (0.0635, 0.010, math.radians(10.5)))
    assert (r.blades, r.airfoil_names()) == (4, ("clarky", "naca4412"))


@pytest.mark.parametrize(
    ("header", "rows"),
    [
        ("r_mm,chord_mm,twist_rad", ("10,10,0.5236", "60,6,0.1745329")),
        ("r [m],c [m],theta (rad)", ("0.010,0.010,0.5236", "0.060,0.006,0.1745329")),
        ("r_mm,chord_mm,twist", ("60,6,10", "10,10,30")),
        ("r_mm,chord_mm,twist (°)", ("1.0D1,1.0D+01,3.0D1", "6.0d1,6.0D+00,1.0D+01")),
        ("radius (cm);chord (in);beta (mrad)", ("1;0,393701;523,6", "6;0,23622;174,53")),
    ],
)
def test_units_and_directions_of_a_table(tmp_path, header, rows):
    path = tmp_path / "t.csv"
    for raw in ("\n".join((header, *rows)).encode(), "\r".join((header, *rows)).encode("utf-16")):
        path.write_bytes(raw)
        r, notes = import_rotor(path, blades=2, airfoil="naca4412")
        assert_allclose(r.radius_m, 0.06)
        assert_allclose(r.chord_m([1 / 6, 1.0]), [0.010, 0.006], rtol=1e-5)
        assert_allclose(r.twist_rad([1 / 6, 1.0]), [math.pi / 6, math.pi / 18], rtol=1e-4)
        assert any("from tip to hub" in note for note in notes) == rows[0].startswith("60")


def test_an_untwisted_blade_needs_no_unit_and_shares_in_per_cent_are_refused(tmp_path):
    r, _ = import_rotor(written(tmp_path, "u.csv", "r_mm,chord_mm,beta\n10,2,0\n20,2,0\n"))
    assert float(r.twist_rad(0.75)) == 0.0
    text = "r/R,c/R,beta\n15,16,30\n100,8,10\n"
    with pytest.raises(InputError, match="r/R: reaches 100: not a share of the radius"):
        import_rotor(written(tmp_path, "p.csv", text), radius_m=0.06)
    with pytest.raises(InputError, match="c/R: reaches 16: not a share of the radius"):
        import_rotor(written(tmp_path, "p.csv", text.replace("15,", "0.15,").replace("100,", "1,")), radius_m=0.06)


def test_inches_at_a_names_end_and_an_airfoil_of_ones_own(tmp_path):
    path = written(tmp_path, "i.csv", "r_in,chord_in,beta_deg\n0.5,0.6,20\n2.5,0.3,6\n")
    r, notes = import_rotor(path, blades=2, airfoil="clarky")
    assert_allclose((r.radius_m, r.chord_m(1.0)), (0.0635, 0.3 * 0.0254))
    assert not any("names none" in note for note in notes)
    with pytest.raises(InputError, match="nosuchfoil: no such airfoil"):
        import_rotor(path, airfoil="nosuchfoil")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", UIUC, "radius: is not known: the file gives ratios"),
        ("a.csv", "r,chord_mm,beta\n1,2,3\n2,2,3\n", "a.csv: r: has no unit"),
        ("a.csv", "r_mm,chord_mm\n10,2\n20,2\n", "twist: is not among the columns"),
        ("a.csv", "r_mm,chord_mm,beta\n10,2,x\n20,2,3\n", "line 2, beta: 'x' is not a number"),
        ("a.csv", "r_mm,chord_mm,beta\n10,2,3\n", "fewer than two stations"),
        ("a.csv", "r_mm,chord_mm,beta\n10,2,3\n20,2,3\n15,2,3\n", "not beyond|hub to tip"),
        ("a.csv", "r_mm,chord_mm,beta\n10,2,0.5\n20,2,0.2\n", "beta: goes from 0.2 to 0.5 without a unit"),
        (
            "a.csv",
            "r_mm;chord_mm;angle\n10;2;-0,1\n20;2;-0,3\n",
            "angle: goes from -0.3 to 0.3 without a unit",
        ),
        ("a.csv", "r_mm,chord_mm,pitch (in)\n10,2,4\n20,2,4\n", r"pitch \(in\): has the unit 'in'"),
        ("a.csv", "r_mm,chord_mm,twist [grad]\n10,2,4\n20,2,4\n", "has the unit 'grad'"),
        ("a.csv", "r_mm,chord_mm,beta\n0.01,0.002,30\n0.06,0.002,10\n", "the radius would be 0.06 mm"),
        ("a.csv", "r_m,chord_m,beta\n10,20,14\n60,20,8\n", "the radius would be 6e\\+04 mm"),
        ("a.csv", "r_mm,chord_mm,beta\n10,0.02,14\n60,0.02,8\n", "chord: is at most 0.02 mm"),
        ("a.csv", "r_mm,chord_mm,beta\n10,2,nan\n20,2,3\n", "line 2, beta: is nan; give a finite number"),
        ("a.csv", "r_mm,chord_mm,beta\n10,2,30\n20,10\n", "line 3: has 2 cells, the header 3"),
        ("a.PE0", "STATION CHORD\n1 2\n", "no RADIUS"),
        ("a.PE0", APC.format(rake="RAKE", inch="", zero=""), "10 numbers"),
    ],
)
def test_what_cannot_be_is_one_line(tmp_path, name, text, message):
    with pytest.raises((InputError, MuflyError), match=message) as caught:
        import_rotor(written(tmp_path, name, text))
    assert "\n" not in str(caught.value)


_TABLE = "r_mm,chord_mm,beta_deg\n{0}\n30,12,20\n40,11,16\n{1}\n"


@pytest.mark.parametrize(
    ("first", "last", "message"),
    [
        ("20,-12,25", "50,10,12", r"station 1 at r = 20 mm, chord: is -12 mm; give a chord above 0"),
        ("20,12,25", "50,-10,12", r"station 4 at r = 50 mm, chord: is -10 mm"),
        ("20,12,25\n25,0.02,22", "50,10,12", r"station at r = 25 mm, chord: is 0\.02 mm between wider chords"),
        ("20,12,25\n25,0,22", "50,10,12", r"station at r = 25 mm, chord: is 0 mm between wider chords"),
        ("20,12,25\n25,0.1,22", "50,10,12", r"blade\.chord: 0\.1 mm at station 2 \(0\.5 R\) does not fit"),
        ("20,0.1,25", "50,10,12", r"blade\.chord: 0\.1 mm at station 1 \(0\.4 R\) does not fit"),
    ],
)
def test_an_impossible_chord_is_named_with_its_station(tmp_path, first, last, message):
    with pytest.raises(InputError, match=r"p\.csv: " + message):
        import_rotor(written(tmp_path, "p.csv", _TABLE.format(first, last)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.6000    4", "-0.600    4", r"station 2 at r = 38\.1 mm, chord: is -15\.24 mm; give a chord above 0"),
        ("0.6000    4", "nan       4", r"station 2 at r = 38\.1 mm, chord: is nan mm; give a chord above 0"),
        ("22.9900", "nan    ", r"station 2 at r = 38\.1 mm, angle: is nan degrees; give a finite number"),
        ("0.1200 ", "nan    ", r"station 2 at r = 38\.1 mm, thickness: is nan %; give a finite number"),
        ("1.5000  ", "nan     ", r"station 2, radius: is nan mm; give a finite number"),
    ],
)
def test_an_impossible_value_of_an_apc_file_is_named_with_its_station(tmp_path, old, new, message):
    text = APC.format(rake="", inch="", zero="")
    assert old in text
    with pytest.raises(InputError, match=r"5x4-PERF\.PE0: " + message):
        import_rotor(written(tmp_path, "5x4-PERF.PE0", text.replace(old, new)))


def test_pointed_tips_and_blades_that_begin_at_the_shaft_are_kept(tmp_path):
    r, notes = import_rotor(written(tmp_path, "p.csv", _TABLE.format("0,0,0\n20,12,25", "49,2,12\n50,0,12")))
    assert_allclose(r.chord_m([0.4, 0.98, 1.0]), [0.012, 0.002, 0.002])
    assert "2 station(s) beyond the tip or without chord omitted" in notes
    pointed = make_rotor(name="p", radius_m=0.05, r_over_R=(0.2, 0.6, 1.0), chord_m=(0.01, 0.01, 2e-5))
    assert pointed.chord_m(1.0) == 2e-5


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("maker_5x3_geom.txt", UIUC), ("maker_5x3.txt", UIUC),
        ("maker_5x3.csv", "# UIUC Propeller Data Site\nr/R,c/R,beta_deg\n0.15,0.16,31\n1,0.08,9\n"),
    ],
)  # fmt: skip
def test_a_table_of_uiuc_is_a_photograph_with_the_pitch_of_its_name(tmp_path, file, text):
    path = written(tmp_path, file, text)
    r, notes = import_rotor(path, radius_m=0.0635)
    assert r.blade.geometry == "photograph"
    assert float(r.nominal_pitch) == pytest.approx(0.0762)
    assert any("photographs" in note for note in notes)
    assert any("a pitch of 76.2 mm" in note for note in notes)
    out = tmp_path / "own.toml"
    words = ["--diameter", "5in", "--geometry", "caliper", "--nominal-pitch", "2.5in", "--out", str(out)]
    done = CliRunner().invoke(app, ["rotor", "import", str(path), *words])
    assert done.exit_code == 0, done.exception
    assert "photograph" not in done.stdout
    own = load_rotor(out)
    assert (own.blade.geometry, float(own.nominal_pitch)) == ("caliper", pytest.approx(0.0635))


def test_a_table_of_one_s_own_and_an_angle_in_a_name(tmp_path):
    own, _ = import_rotor(written(tmp_path, "mine_5x3.csv", "r_mm,chord_mm,beta\n10,9,30\n60,6,9\n"))
    assert (own.blade.geometry, own.nominal_pitch) == (None, None)
    turned, _ = import_rotor(written(tmp_path, "p_5_15deg_geom.txt", UIUC), radius_m=0.06)
    assert float(turned.nominal_pitch) == pytest.approx(1.5 * math.pi * 0.06 * math.tan(math.radians(15.0)))
    plain, _ = import_rotor(written(tmp_path, "p_0x3_geom.txt", UIUC), radius_m=0.06)
    assert (plain.blade.geometry, plain.nominal_pitch) == ("photograph", None)
