"""How people write numbers with units: accepted in any unit of the dimension, refused with option, value and remedy."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import (
    parse_column_map_lines,
    parse_integer,
    parse_interval,
    parse_quantity,
    parse_rotor_pair_values,
    parse_stepped_range,
    parse_time_span,
    parse_value_with_std,
    parse_values,
    parse_vector,
)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("6000", "rpm", 6000.0),
        ("6000rpm", "rpm", 6000.0),
        ("6000 1/min", "rpm", 6000.0),
        ("100Hz", "rpm", 6000.0),
        ("628.3185307179587rad/s", "rpm", 6000.0),
        ("6 krpm", "rpm", 6000.0),
        ("0.12kg", "g", 120.0),
        ("-14°", "deg", -14.0),
        ("0.24rad", "deg", math.degrees(0.24)),
        ("100gf", "N", 0.980665),
        ("100g", "N", 0.980665),  # as load cells say it
        ("20mm", "m", 0.02),
        ("5in", "m", 0.127),
        ("1.2kg/m^3", "kg/m3", 1.2),
        ("1.2 kg/m³", "kg/m3", 1.2),
        ("3.6km/h", "m/s", 1.0),
        ("1.5min", "s", 90.0),
        ("0.25Ah", "mA h", 250.0),
        ("1e3", "N", 1000.0),
        ("+.5", "N", 0.5),
        ("\u22122", "m/s", -2.0),
        ("50%", "1", 0.5),
        ("5%", "%", 5.0),
        ("2", "%", 2.0),
        ("300mΩ", "ohm", 0.3),
        ("18.1µPa s", "uPa s", 18.1),
        ("100 1/s", "rpm", 6000.0),
        ("20 Deg", "deg", 20.0),
        ("0.7", "", 0.7),
    ],
)
def test_a_quantity_is_read_in_any_unit_of_its_dimension(text: str, unit: str, value: float) -> None:
    assert parse_quantity("--x", text, unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit", "message"),
    [
        ("0,9", "N", "--x: '0,9' has a decimal comma; write 0.9"),
        ("0,9 N", "N", "--x: '0,9 N' has a decimal comma; write 0.9 N"),
        ("0.9V", "N", "--x: '0.9V' is in V, which cannot become N; use one of: N, mN, kN, gf, kgf"),
        ("0.9 parsec", "m", "--x: unit 'parsec' in '0.9 parsec' is unknown; use one of: m, cm, mm"),
        ("", "N", "--x: is empty; give a number, bare in N or with a unit: N, mN, kN, gf, kgf"),
        (" ", "N", "is empty"),
        ("nan", "N", "'nan' is not finite"),
        ("-inf", "N", "'-inf' is not finite"),
        ("1e999", "N", "'1e999' is not finite"),
        ("abc", "rpm", "'abc' is not a number; give a number, bare in rpm or with a unit: rpm, rad/s"),
        ("1.2.3", "N", "'1.2.3' is not a number"),
        ("60 00", "rpm", "'60 00' is not a number"),
        ("5-6", "N", "'5-6' is not a number"),
        ("5Mm", "m", "unit 'Mm' in '5Mm' is unknown"),  # not millimetres
        ("3MN", "N", "unit 'MN' in '3MN' is unknown"),
        ("5m", "", "'5m' has a unit, 'm'; give the number alone, it takes none"),
        ("5m", "1", "'5m' is in m, which cannot become a plain number; use one of: %"),
    ],
)
def test_what_is_none_is_refused_with_value_and_remedy(text: str, unit: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        parse_quantity("--x", text, unit)


def test_a_bare_number_is_refused_where_a_unit_is_needed() -> None:
    with pytest.raises(InputError, match=re.escape("'20' has no unit; use one of: m, cm, mm")):
        parse_quantity("spacing=20", "20", "m", bare=False)


@pytest.mark.parametrize(
    ("text", "unit", "values"),
    [
        ("5000,6000", "rpm", (5000.0, 6000.0)),
        ("3000:4000:500rpm", "rpm", (3000.0, 3500.0, 4000.0)),
        ("40:60:10Hz", "rpm", (2400.0, 3000.0, 3600.0)),
        ("1cm:30mm:5mm", "mm", (10.0, 15.0, 20.0, 25.0, 30.0)),
        ("10,15,2cm", "mm", (100.0, 150.0, 20.0)),  # a unit at the end holds for bare numbers before it
        ("10mm,2cm", "mm", (10.0, 20.0)),
        ("-2:2:2deg", "deg", (-2.0, 0.0, 2.0)),
        ("0.1:0.3:0.1", "1", (0.1, 0.2, 0.3)),
        ("2:4", "1", (2.0, 3.0, 4.0)),
    ],
)
def test_lists_and_ranges(text: str, unit: str, values: tuple[float, ...]) -> None:
    assert parse_values("--x", text, unit) == pytest.approx(values, rel=1e-12)


def test_other_forms() -> None:
    assert parse_rotor_pair_values("--x", "14", "deg") == (14.0,)
    assert parse_rotor_pair_values("--x", "14,12deg", "deg") == (14.0, 12.0)
    assert parse_stepped_range("--x", "-1:3:0.5m/s", "m/s") == (-1.0, 3.0, 0.5)
    assert parse_stepped_range("--x", "2500:6000", "rpm") == (2500.0, 6000.0, None)
    assert parse_stepped_range("--x", "2500", "rpm") == (2500.0, None, None)
    assert parse_interval("--x", "60:180rpm", "Hz") == pytest.approx((1.0, 3.0))
    assert parse_vector("--x", "0.5", "m/s") == (0.5,)
    assert parse_vector("--x", "1.8,0,0km/h", "m/s") == pytest.approx((0.5, 0.0, 0.0))
    assert parse_value_with_std("--x", "0.06", "m") == (0.06, 0.0)
    assert parse_value_with_std("--x", "60±0.2mm", "m") == pytest.approx((0.06, 0.0002))
    assert parse_value_with_std("--x", "1.2+-1%", "kg/m3") == pytest.approx((1.2, 0.012))
    assert parse_time_span("--x", "0.5min+2s") == (30.0, 32.0)
    assert parse_time_span("--x", "") == (0.0, math.inf)
    assert (parse_integer("--x", "12"), parse_integer("--x", "1e3"), parse_integer("--x", str(2**62))) == (
        12,
        1000,
        2**62,
    )


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (parse_values, "3000:1000:500", "contains no value"),
        (parse_values, "1:2:3:4", "is not a range"),
        (parse_values, "1:1e9:1", "larger steps"),
        (parse_values, "5,,6", "'5,,6' lacks a number"),
        (parse_rotor_pair_values, "1,2,3", "neither one value nor two"),
        (parse_stepped_range, "3:1", "contains no two values"),
        (parse_interval, "3", "is not a frequency band; write LOW:HIGH (Hz)"),
        (parse_vector, "0,5", "'0,5' holds 2 numbers"),
        (parse_value_with_std, "1+--2", "negative standard deviation"),
    ],
)
def test_other_forms_are_refused(read, text: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        read("--x", text, "Hz")
    with pytest.raises(InputError, match=re.escape("'2.5' is not a whole number")):
        parse_integer("--x", "2.5")


@given(st.floats(-1e6, 1e6, allow_subnormal=False), st.sampled_from(["rpm", "mm", "deg", "gf", "mA h", "%"]))
def test_a_bare_number_is_the_number_to_the_last_bit(value: float, unit: str) -> None:
    assert parse_quantity("--x", repr(value), unit) == value
    assert parse_quantity("--x", f"{value!r}{unit}", unit) == value


@given(st.text(alphabet="0123456789.,:+-eE nNmM/%°µ^()x\t", max_size=14))
def test_any_text_is_a_number_or_an_input_error(text: str) -> None:
    for read in (
        parse_quantity,
        parse_values,
        parse_stepped_range,
        parse_value_with_std,
        parse_vector,
        parse_interval,
    ):
        try:
            found = read("--x", text, "N")
        except InputError:
            continue
        numbers = found if isinstance(found, tuple) else (found,)
        assert all(x is None or math.isfinite(x) for x in numbers)


def test_a_name_is_suggested() -> None:
    assert suggest_name("demonstraton", ["demonstration", "box-on-leg"]) == "did you mean 'demonstration'?"
    assert suggest_name("CTDW", ["cT_dw", "cT_up", "Ixx"]) == "did you mean 'cT_dw'?"
    assert suggest_name("zzz", ["a", "b"]) == "use one of: a, b"
    assert suggest_name("zzz", ["a", "b"], "give a file") == "give a file"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("speed_upper=RPM(rpm)", ("speed_upper", ("RPM",), (1.0,), "", "rpm")),
        ("time = t [ms]", ("time", ("t",), (1.0,), "", "ms")),
        ("p=-imu/x", ("p", ("x",), (-1.0,), "imu", "")),
        ("measured_position=x,-y,-z(m)", ("measured_position", ("x", "y", "z"), (1.0, -1.0, -1.0), "", "m")),
        ("u=pwm[3]", ("u", ("pwm[3]",), (1.0,), "", "")),  # an index, no unit
        ("j=V/nD", ("j", ("nD",), (1.0,), "V", "")),
    ],
)
def test_a_line_of_a_column_map(text, line):
    assert tuple(parse_column_map_lines([text])[0]) == line
    name, _, column = text.partition("=")
    assert tuple(parse_column_map_lines({name: column})[0]) == line
    with pytest.raises(InputError, match="columns: nonsense: does not say which column; write NAME=COLUMN"):
        parse_column_map_lines(["nonsense"])
