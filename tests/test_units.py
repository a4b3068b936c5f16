"""One table of units and one of quantities, which every room reads."""

import math

import pytest

from mufly.bench import parse_column_header
from mufly.errors import InputError
from mufly.quantities.quantity_table import (
    DIMENSION_LABELS,
    QUANTITIES,
    find_quantity,
    list_mavlink_field_columns,
    parse_column_name,
    quantities_recorded_in,
    split_signal_name,
)
from mufly.quantities.units import (
    STANDARD_GRAVITY_M_S2,
    find_conversion_factor,
    list_compatible_units,
    normalise_unit,
    unit_conversion,
)
from mufly.study import parse_parameter_value
from mufly.vehicle import load_vehicle


@pytest.mark.parametrize(
    ("header", "text", "si"),
    [
        ("speed (rpm)", ("speed", "1rpm"), "rad/s"),
        ("pitch_deg", ("pitch", "1deg"), "rad"),
        ("thrust_mN", ("thrust", "1mN"), "N"),
    ],
)
def test_bench_study_and_table_agree_to_the_last_bit(header, text, si):
    unit = header.replace("(", "_").replace(")", "").replace(" ", "").partition("_")[2]
    assert parse_column_header(header).factor == find_conversion_factor(unit, si) == parse_parameter_value(*text)


def test_a_vehicle_file_takes_every_unit_of_the_table(tmp_path):
    text = tmp_path / "v.toml"
    for unit in list_compatible_units("m"):
        value = load_vehicle("mufly-1.1").rotors.radius.value / find_conversion_factor(unit)
        text.write_text(_with_radius(value, unit), encoding="utf-8")
        assert float(load_vehicle(text).rotors.radius) == pytest.approx(0.0875)


def _with_radius(value, unit):
    from importlib.resources import files

    source = (files("mufly.vehicle") / "builtin" / "mufly-1.1.toml").read_text(encoding="utf-8")
    lines = source.splitlines()
    k = next(i for i, line in enumerate(lines) if line.startswith("radius"))
    lines[k] = f'radius = {{ value = {value!r}, unit = "{unit}", source = "measured" }}'
    return "\n".join(lines)


def test_load_cells_in_grams_weigh_with_the_standard_gravity():
    assert find_conversion_factor("gf") == pytest.approx(STANDARD_GRAVITY_M_S2 / 1000)
    assert unit_conversion("g", "N")[1] == unit_conversion("gf")[1] == parse_column_header("T(g)").factor
    assert unit_conversion("g")[0] == "kg"


def test_capitals_do_not_matter_where_the_dimension_is_known():
    assert normalise_unit("nmm", "N m") == "N mm"
    assert normalise_unit("RAD_S", "rad/s") == "rad/s"
    assert normalise_unit("nmm") == ""
    assert unit_conversion("K", "degC")[1:] == (1.0, -273.15)
    with pytest.raises(InputError, match="cannot become"):
        unit_conversion("mm", "s")


def test_names_are_unique_and_every_quantity_is_found_by_its_name_and_columns():
    assert len({q.name for q in QUANTITIES}) == len(QUANTITIES)
    for q in QUANTITIES:
        assert find_quantity(q.name) is q
        assert (
            q.dim is None or q.dim in ("beam", "channel", "actuator") or q.component_labels == DIMENSION_LABELS[q.dim]
        )
        for label in q.component_labels or ([] if q.dim is None else ["1"]):
            assert parse_column_name(f"{q.name}_{label}") == (q.name, str(label))
            assert split_signal_name(f"{q.name}.{label}", "here") == (q, q.name, str(label))
    assert find_quantity("reference_rates").long_name == "reference body rates"
    assert find_quantity("flap") is None


def test_a_station_keeps_what_a_flight_keeps_in_the_same_order():
    station = [q for q in quantities_recorded_in("flight", "station") if q.recording_kinds == "flight"]
    assert tuple(station) == quantities_recorded_in("flight")


def test_the_mavlink_fields_of_the_table_are_in_the_dialect_with_these_units():
    import os

    os.environ["MAVLINK20"] = "1"
    from pymavlink.dialects.v20 import common

    messages = {m.msgname: m for m in common.mavlink_map.values()}
    for q in QUANTITIES:
        for wire in q.mavlink_sources:
            message = messages[wire.message]
            for field in wire.fields.split():
                name = field.partition("[")[0]
                assert name in message.fieldnames, (q.name, field)
                assert message.fieldunits_by_name.get(name, "1") in (wire.unit, "1"), (q.name, field)


def test_a_message_tells_columns_with_their_factors():
    assert list_mavlink_field_columns("ATTITUDE")[0] == ("roll", "estimated_attitude_roll", 1.0)
    assert list_mavlink_field_columns("RAW_RPM")[1] == ("frequency", "measured_rotor_speed_lower", math.pi / 30)
    assert list_mavlink_field_columns("RC_CHANNELS")[7][:2] == ("chan8_raw", "pilot_input_8")


@pytest.mark.parametrize(
    ("spelt", "unit", "si", "one"),
    [
        ("lbf", "lbf", "N", 4.4482216), ("ozf", "ozf", "N", 0.27801385), ("mg", "mgf", "N", 9.80665e-6),
        ("in-lbf", "lbf in", "N m", 0.11298483), ("lb·in", "lbf in", "N m", 0.11298483),
        ("IN_LB", "lbf in", "N m", 0.11298483), ("ozf-in", "ozf in", "N m", 7.0615518e-3),
        ("in oz", "ozf in", "N m", 7.0615518e-3), ("ft-lbf", "lbf ft", "N m", 1.3558179),
        ("kg-cm", "kgf cm", "N m", 0.0980665), ("kgf.cm", "kgf cm", "N m", 0.0980665),
        ("g*cm", "gf cm", "N m", 9.80665e-5),
        ("kgf m", "kgf m", "N m", 9.80665), ("n·mm", "N mm", "N m", 1e-3), ("mph", "mph", "m/s", 0.44704),
        ("slug/ft^3", "slug/ft3", "kg/m3", 515.37882), ("psi", "psi", "Pa", 6894.7573),
        ("inHg", "inHg", "Pa", 3386.3886),
        ("°F", "degF", "K", 255.92777), ("deg C", "degC", "K", 274.15), ("r/min", "rpm", "rad/s", math.pi / 30),
        ("1/s", "rps", "rad/s", 2 * math.pi), ("degree s-1", "deg/s", "rad/s", math.pi / 180),
        ("m s**-2", "m/s^2", "m/s^2", 1),
        ("kg m⁻³", "kg/m3", "kg/m3", 1), ("µNm", "uN m", "N m", 1e-6), ("G", "gee", "m/s^2", 9.80665),
    ],
)  # fmt: skip
def test_units_of_the_field_are_known_in_their_usual_spellings(spelt, unit, si, one):
    assert normalise_unit(spelt, si) == unit
    reached, factor, offset = unit_conversion(spelt, si)
    assert (reached, factor + offset) == (si, pytest.approx(one))


@pytest.mark.parametrize("other", ["S", "M", "furlong", "N/A", "G", "MHz", "millipascals of mercury"])
def test_a_capital_of_another_meaning_is_no_unit(other):
    assert normalise_unit(other) == ""


def test_a_unit_that_capitals_leave_open_is_unknown():
    assert (normalise_unit("mPa", "Pa"), normalise_unit("MPa", "Pa"), normalise_unit("MPA", "Pa")) == (
        "mPa",
        "MPa",
        "",
    )
