"""How values are written, and how a rotor is reshaped."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.rotor import load_rotor
from mufly.study import parse_parameter_and_values, parse_parameter_settings, parse_parameter_value, reshape_rotor
from mufly.study.study_setup import modify_naca_name

ROTOR = load_rotor("naca4412-r60-c20")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("chord=10:30:5mm", (0.010, 0.015, 0.020, 0.025, 0.030)),
        ("pitch=6:8:1deg", tuple(math.radians(p) for p in (6, 7, 8))),
        ("speed=3000rpm", (100 * math.pi,)),
        ("blades=2:4", (2, 3, 4)),
        ("taper=100,50%", (1.0, 0.5)),
        ("pitch=-2:2:2deg", tuple(math.radians(p) for p in (-2, 0, 2))),
        ("thickness=6:12:3%", (0.06, 0.09, 0.12)),
        ("voltage=7.2V", (7.2,)),
        ("viscosity=18.1uPa s", (18.1e-6,)),
        ("chord=0.1:0.3:0.1cm", (0.001, 0.002, 0.003)),
    ],
)
def test_values_are_read_in_si(text: str, expected: tuple[float, ...]) -> None:
    assert parse_parameter_and_values(text)[1] == pytest.approx(expected, rel=1e-12)


def test_names_are_kept() -> None:
    assert parse_parameter_and_values("airfoil=goe394, naca4412") == ("airfoil", ("goe394", "naca4412"))
    assert parse_parameter_and_values("gear=adapted") == ("gear", ("adapted",))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("chord=10:30:5", "has no unit; use one of: m, cm, mm"),
        ("chord=10:30:5deg", "cannot become m; use one of"),
        ("cord=10mm", "did you mean 'chord'"),
        ("chord", "NAME=VALUES"),
        ("chord=mm", "is not a number"),
        ("chord=30:10:5mm", "contains no value"),
        ("chord=10:30:-5mm", "contains no value"),
        ("chord=1:2:3:4mm", "is not a range"),
        ("chord=-5mm", "out of range"),
        ("blades=2.5", "not a whole number"),
        ("chord=1:1e9:1mm", "larger steps"),
    ],
)
def test_faults_are_named(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_parameter_and_values(text)


def test_one_parameter_twice_is_refused() -> None:
    with pytest.raises(InputError, match="twice"):
        parse_parameter_settings(["pitch=6deg", "pitch=7deg"])
    with pytest.raises(InputError, match="2 values"):
        parse_parameter_value("pitch", "6,7deg")


@given(taper=st.floats(0.1, 3.0), chord=st.floats(0.005, 0.03))
def test_taper_keeps_the_area_and_gives_its_ratio(taper: float, chord: float) -> None:
    r = reshape_rotor(ROTOR, {"chord": chord, "taper": taper})
    assert r.blade_area_m2 == pytest.approx(chord * 0.85 * 0.06, rel=1e-9)
    assert float(r.chord_m(1.0)) / float(r.chord_m(0.15)) == pytest.approx(taper, rel=1e-9)


def test_taper_3505_is_the_dissertations() -> None:
    r = reshape_rotor(ROTOR, {"taper": 5 / 35})
    assert float(r.chord_m(0.15)) == pytest.approx(0.035)
    assert float(r.chord_m(1.0)) == pytest.approx(0.005)


def test_twist_is_straight_and_zero_at_the_tip() -> None:
    r = reshape_rotor(ROTOR, {"twist": math.radians(10)})
    x = np.array([0.15, 0.575, 1.0])
    np.testing.assert_allclose(np.degrees(r.twist_rad(x)), [10, 5, 0], atol=1e-9)
    np.testing.assert_allclose(r.chord_m(x), 0.02)


def test_radius_leaves_the_chord() -> None:
    r = reshape_rotor(ROTOR, {"radius": 0.08, "blades": 3.0})
    assert (r.radius_m, r.blades) == (0.08, 3)
    assert float(r.chord_m(0.5)) == 0.02


def test_naca_digits() -> None:
    assert modify_naca_name("naca4412", {"thickness": 0.06}) == "naca4406"
    assert modify_naca_name("naca4412", {"camber": 0.0}) == "naca0012"
    assert modify_naca_name("naca0012", {"camber": 0.02}) == "naca2412"
    assert modify_naca_name("NACA 4412", {"camber_position": 0.7}) == "naca4712"
    with pytest.raises(InputError, match="not a four-digit"):
        modify_naca_name("goe394", {"camber": 0.02})
    with pytest.raises(InputError, match="not in the NACA four-digit series"):
        modify_naca_name("naca4412", {"camber": 0.025})
