"""Sections against their own definitions: NACA's formulas, thin-airfoil theory, and files good and bad."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.rotor import list_database_airfoils, load_airfoil
from mufly.rotor.sections.airfoil import naca_contour, split_sides
from mufly.rotor.sections.contour_file import SectionChangeWarning


def mean_line(digits, n=4001):
    """x and y of the mean line, from the contour of a section 1 % thick."""
    contour = naca_contour(digits, n)
    upper, lower = contour[:n][::-1], contour[n - 1 :]
    return 0.5 * (upper[:, 0] + lower[:, 0]), 0.5 * (upper[:, 1] + lower[:, 1])


def thin_airfoil(digits):
    """Design lift and moment about the quarter chord by thin-airfoil theory (Glauert 1926): c_l,i = pi A1,
    c_m = -pi/4 (A1 - A2), A_n = 2/pi int dz/dx cos(n theta) dtheta, x = (1 - cos theta)/2."""
    x, y = mean_line(digits)
    theta = np.linspace(0.0, math.pi, 2001)[1:-1]
    slope = np.interp(0.5 * (1 - np.cos(theta)), 0.5 * (x[1:] + x[:-1]), np.diff(y) / np.diff(x))
    a1, a2 = (2 / math.pi * np.trapezoid(slope * np.cos(n * theta), theta) for n in (1, 2))
    return math.pi * a1, -math.pi / 4 * (a1 - a2)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(2, 7), st.integers(6, 24))
def test_four_digits_mean_what_they_say(m, p, t):
    x, y = mean_line(f"{m}{p}01")
    assert y.max() == pytest.approx(m / 100, rel=1e-4)
    assert x[np.argmax(y)] == pytest.approx(p / 10, abs=2e-3)
    section = load_airfoil(f"naca{m}{p}{t:02d}")
    # The thickness is laid off normal to the mean line, so across the x axis it is a little more.
    assert t / 100 * 0.999 < section.thickness_ratio < t / 100 * 1.06


def test_published_ordinates_of_naca_4412_and_0012():
    """NACA Report 460 / Abbott and von Doenhoff, appendix III: per cent of chord."""
    upper, lower = split_sides(load_airfoil("naca4412").coordinates)
    for x, y_upper, y_lower in ((10, 6.59, -2.86), (30, 9.76, -2.26), (60, 8.14, -1.00), (90, 2.71, -0.22)):
        assert np.interp(x / 100, *upper.T) * 100 == pytest.approx(y_upper, abs=0.02)
        assert np.interp(x / 100, *lower.T) * 100 == pytest.approx(y_lower, abs=0.02)
    upper, _ = split_sides(load_airfoil("NACA 0012").coordinates)
    assert np.interp(0.30, *upper.T) * 100 == pytest.approx(6.002, abs=0.005)


def test_symmetric_section_is_its_own_mirror_image():
    contour = load_airfoil("naca0009").coordinates
    assert np.allclose(contour[::-1] * [1, -1], contour, atol=1e-15)


@pytest.mark.parametrize(("place", "digits"), [(0.10, "22001"), (0.15, "23001"), (0.20, "24001"), (0.25, "25001")])
def test_five_digits_place_camber_and_give_the_design_lift(place, digits):
    x, y = mean_line(digits)
    assert x[np.argmax(y)] == pytest.approx(place, abs=3e-3)
    assert thin_airfoil(digits)[0] == pytest.approx(0.30, rel=0.02)


@pytest.mark.parametrize("digits", ["22101", "23101", "24101", "25101"])
def test_reflexed_lines_have_no_moment(digits):
    lift, moment = thin_airfoil(digits)
    assert lift == pytest.approx(0.30, rel=0.03)
    assert abs(moment) < 0.002
    assert thin_airfoil(digits[:2] + "001")[1] < -0.005


def test_design_lift_scales_with_the_first_digit():
    assert thin_airfoil("43001")[0] == pytest.approx(2 * thin_airfoil("23001")[0], rel=1e-6)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("naca25516", "mean line 255 is unknown"),
        ("naca4400", "thickness of 0%"),
        ("naca0412", "camber without position"),
        ("naca26012", "second digit be one of 1, 2, 3, 4, 5"),
        ("naca21112", "second digit be one of 2, 3, 4, 5"),
        ("goe39", "did you mean"),
        ("nothing at all", "no such airfoil or file"),
        ("naca0012+gurney0", "a height above 0 and up to 8"),
        ("naca0012+gurneyx", "Gurney flap of 'x' %"),
    ],
)
def test_unknown_names_are_answered_with_one_line(name, words):
    with pytest.raises(InputError, match="; ") as fault:
        load_airfoil(name)
    assert words in str(fault.value)
    assert "\n" not in str(fault.value)


def test_database_is_sound():
    """Of some 2 170 contours all load but two whose tails gape; the loader says so."""
    names = list_database_airfoils()
    assert len(names) > 2000
    faults = {}
    for name in names:
        try:
            section = load_airfoil(name)
        except InputError as fault:
            faults[name] = str(fault)
            continue
        assert 0.005 < section.thickness_ratio < 0.85, name
        assert section.coordinates[:, 0].min() == pytest.approx(0, abs=0.02), name
    assert set(faults) <= {"ah93w480b", "mh112"}
    assert all("is open" in line for line in faults.values())


def test_table_3_3_names_are_there():
    for name in ("goe394", "goe342", "gm15sm", "goe142", "lnv109a", "n64015", "naca6415"):
        assert load_airfoil(name).thickness_ratio > 0.04
    assert load_airfoil("naca66-018").source.startswith("AeroSandbox")  # series 6, not five digits


def written(tmp_path, text, name="wing.dat"):
    path = tmp_path / name
    path.write_text(text)
    return path


def rows(points):
    return "\n".join(f" {x:.6f}  {y:.6f}" for x, y in points)


def test_selig_lednicer_and_reversed_files_agree(tmp_path):
    contour = naca_contour("4412", 40)
    selig = load_airfoil(written(tmp_path, f"a wing\n{rows(contour)}\nfrom a book, 1933\n", "selig.dat"))
    upper, lower = contour[:40][::-1], contour[39:]
    blocks = f"a wing\n  40.  40.\n\n{rows(upper)}\n\n{rows(lower)}\n"
    lednicer = load_airfoil(written(tmp_path, blocks, "lednicer.dat"))
    backwards = load_airfoil(written(tmp_path, rows(contour[::-1]), "reversed.dat"))
    with pytest.warns(SectionChangeWarning, match="scaled by 0.05"):
        in_mm = load_airfoil(written(tmp_path, rows(contour * 20.0), "mm.dat"))
    for other in (lednicer, backwards, in_mm):
        assert np.allclose(other.coordinates, selig.coordinates, atol=2e-6)
    assert selig.name == "selig"


def turned(points, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ np.array([[c, s], [-s, c]])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p + np.array([0.25, 0.1]), "moved by (-0.25, -0.1) chords"),
        (lambda p: p * 80.0 + [-20.0, 5.0], "scaled by 0.0125"),
        (lambda p: 100.0 * p, "scaled by 0.01"),
        (lambda p: turned(p, -10.0), "turned by"),
        (lambda p: turned(p, 12.0) + np.array([0.4, -0.3]), "turned by"),
        (lambda p: p * [-1.0, 1.0], "mirrored"),
        (lambda p: 0.06 * (p * [-1.0, 1.0] + [0.25, 0.03]), "mirrored"),
    ],
)
def test_a_contour_anywhere_in_the_plane_is_put_on_its_chord_and_said(tmp_path, change, words):
    path = written(tmp_path, f"a wing\n{rows(change(naca_contour('4412', 40)))}\n")
    with pytest.warns(SectionChangeWarning) as told:
        section = load_airfoil(path)
    assert len(told) == 1
    assert "wing.dat" in str(told[0].message)
    assert words in str(told[0].message)
    assert words in section.source
    assert section.camber == pytest.approx(0.04, abs=6e-4)
    assert section.thickness_ratio == pytest.approx(0.12, abs=1e-3)
    assert np.ptp(section.coordinates[:, 0]) == pytest.approx(1.0)


def test_a_flat_underside_keeps_the_frame_of_its_catalogue_and_its_tilt_is_said(tmp_path):
    """Catalogues lay flat undersides along x: up to 3.9 degrees among UIUC's."""
    pivot = turned(naca_contour("4412", 40), -3.0)
    with pytest.warns(SectionChangeWarning, match=r"stands \+3.0 degrees to the x axis"):
        section = load_airfoil(written(tmp_path, rows(pivot - [0.0, pivot[0, 1]])))
    assert section.camber == pytest.approx(0.04 + 0.6 * math.sin(math.radians(3.0)), abs=3e-3)


def test_orders_of_other_programs_agree(tmp_path):
    """From the nose around, both sides from the nose without counts, doubled points, closed or not, flat in 3-D."""
    contour = naca_contour("4412", 40)
    selig = load_airfoil(written(tmp_path, rows(contour), "selig.dat")).coordinates
    upper, lower = contour[:40][::-1], contour[39:]
    sharp = np.concatenate((contour, contour[:1]))
    around = np.concatenate((contour[39:], contour[:40]))  # nose, lower side, upper side, nose
    for k, points in enumerate((around, around[:-1], around[::-1], np.concatenate((upper, lower)),
                                np.repeat(contour, 2, axis=0))):  # fmt: skip
        section = load_airfoil(written(tmp_path, f"made\n{rows(points)}\n", f"{k}.dat"))
        assert section.camber == pytest.approx(0.04, abs=2e-4), k
        assert np.allclose(section.coordinates[[0, 39, -1]], selig[[0, 39, -1]], atol=3e-3), k
    closed = load_airfoil(written(tmp_path, rows(np.roll(sharp[:-1], 30, axis=0)), "rolled.dat"))
    assert closed.camber == pytest.approx(0.04, abs=2e-4)
    flat = "\n".join(f"{x:.6f} {y:.6f} 0.0" for x, y in contour)
    assert np.allclose(load_airfoil(written(tmp_path, flat, "cad.dat")).coordinates, selig, atol=2e-6)


def fortran(points):
    return "\n".join(f"{x * 10:.6f}D-01 {y * 100:.6f}d-2" for x, y in points)


def commas(points, between="\t", end="\n"):
    return end.join(f"{x:.6f}{between}{y:.6f}".replace(".", ",") for x, y in points)


@pytest.mark.parametrize(
    "raw",
    [
        ("\ufeff" + rows(naca_contour("4412", 40))).encode(),
        ("\ufeffNACA 4412\n" + rows(naca_contour("4412", 40))).encode("utf-16-le"),
        rows(naca_contour("4412", 40)).replace("\n", "\r").encode(),
        rows(naca_contour("4412", 40)).replace("\n", "\r\n").encode(),
        b"NACA 4412\n" + commas(naca_contour("4412", 40)).encode(),
        commas(naca_contour("4412", 40), ";", "\r\n").encode(),
        commas(naca_contour("4412", 40), "  ").encode(),
        commas(naca_contour("4412", 40), ", ").encode(),
        b"NACA 4412\n" + rows(naca_contour("4412", 40)).replace("  ", ", ").encode(),
        b"NACA 4412 \xb0\n" + fortran(naca_contour("4412", 40)).encode(),
    ],
    ids=[
        "bom",
        "utf-16",
        "cr",
        "crlf",
        "comma-tab",
        "comma-semicolon",
        "comma-blank",
        "comma-comma",
        "csv",
        "fortran",
    ],
)
def test_text_of_other_machines_keeps_every_point(tmp_path, raw):
    path = tmp_path / "wing.dat"
    path.write_bytes(raw)
    section = load_airfoil(path)
    assert len(section.coordinates) == 79
    assert np.allclose(section.coordinates[[0, -1]], naca_contour("4412", 40)[[0, -1]], atol=4e-4)
    assert section.camber == pytest.approx(0.04, abs=2e-4)


FIGURE_EIGHT = naca_contour("0012", 40) * [1, 1]
FIGURE_EIGHT[60:, 1] *= -2.5


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (naca_contour("0012", 8), "15 points are too few"),
        (naca_contour("0012", 40)[:50], "is open"),
        (naca_contour("0012", 40)[:40], "is open"),
        (FIGURE_EIGHT, "crosses itself near x ="),
        (naca_contour("0012", 40) * [0, 1], "same x"),
        (np.zeros((0, 2)), "0 points are too few"),
        (naca_contour("0012", 40) * [1, 1e-4], "encloses"),
        (
            np.where(np.arange(79)[:, None] == 5, np.nan, naca_contour("0012", 40)),
            "line 7: a coordinate is not a number",
        ),
    ],
)
def test_unsound_contours_are_refused(tmp_path, points, words):
    path = written(tmp_path, f"bad\n{rows(points)}\n")
    with pytest.raises(InputError) as fault:
        load_airfoil(path)
    assert words in str(fault.value)
    assert str(path) in str(fault.value)
    assert "\n" not in str(fault.value)


def test_unreadable_lines_are_named(tmp_path):
    points = naca_contour("0012", 40)
    broken = f"wing\n{rows(points[:20])}\n0.5 abc\n{rows(points[20:])}\n"
    with pytest.raises(InputError, match=r"line 22: '0.5 abc' is not a point"):
        load_airfoil(written(tmp_path, broken))
    with pytest.raises(InputError, match=r"announces 30 \+ 40 points"):
        load_airfoil(written(tmp_path, f"wing\n30. 40.\n{rows(points)}\n"))


def test_gurney_flap_lowers_the_tail_by_its_height():
    clean, flapped = load_airfoil("naca0012"), load_airfoil("naca0012+gurney3")
    assert flapped.name == "naca0012+gurney3"
    _, lower = split_sides(clean.coordinates)
    _, lowered = split_sides(flapped.coordinates)
    assert lowered[-1, 1] == pytest.approx(lower[-1, 1] - 0.03)
    ahead = np.linspace(0.0, 0.95, 50)
    assert np.allclose(np.interp(ahead, *lowered.T), np.interp(ahead, *lower.T), atol=1e-6)
    assert np.allclose(flapped.coordinates[0], clean.coordinates[0])
    assert flapped.contour_hash() != clean.contour_hash()


@pytest.mark.parametrize(("name", "percent"), [("naca4412", 18), ("naca6409", 4), ("e63", 12), ("clarky", 8)])
def test_a_thickness_keeps_the_camber_and_scaled_heights_keep_a_flat_side(name, percent):
    plain, thick, scaled = (load_airfoil(name + s) for s in ("", f"+thick{percent}", f"+scaled{percent}"))
    ratio = percent / 100 / plain.thickness_ratio
    for section in (thick, scaled):
        assert section.thickness_ratio == pytest.approx(percent / 100, rel=2e-3)
    assert thick.camber == pytest.approx(plain.camber, abs=2e-4)
    assert thick.max_camber_position == pytest.approx(plain.max_camber_position, abs=0.02)
    assert scaled.camber == pytest.approx(ratio * plain.camber, rel=1e-6)
    np.testing.assert_allclose(scaled.coordinates[:, 1], ratio * plain.coordinates[:, 1], atol=1e-12)


def test_thickness_of_a_naca_section_is_that_of_its_formula():
    thin, formula = load_airfoil("naca4418+thick9"), load_airfoil("naca4409")
    x = np.linspace(0.1, 0.98, 45)  # laid off normal to the mean line there, to the x axis here: it matters at the nose
    for ours, theirs in zip(split_sides(thin.coordinates), split_sides(formula.coordinates), strict=True):
        np.testing.assert_allclose(np.interp(x, *ours.T), np.interp(x, *theirs.T), atol=2.5e-3)


def test_the_published_section_of_the_da_propellers_is_known_by_name():
    section = load_airfoil("SDA1075")
    assert section.name == load_airfoil("sda1075.dat").name == "sda1075"
    assert section.thickness_ratio == pytest.approx(0.12, abs=2e-3)
    assert "AIAA 2014-2151" in section.source
    with pytest.raises(InputError, match="sda1075"):
        load_airfoil("sda1057")
