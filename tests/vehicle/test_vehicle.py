"""Vehicle files: what the thesis says comes out, what is wrong is named."""

import math
import tomllib

import pytest
import tomli_w

import mufly
from mufly.vehicle import (
    format_vehicle_toml,
    list_builtin_vehicles,
    list_parameters,
    load_vehicle,
    replace_parameters,
)


@pytest.fixture
def text() -> str:
    return format_vehicle_toml(load_vehicle("mufly-1.1"))


def test_table_5_3_is_carried() -> None:
    v = mufly.load_vehicle("mufly-1.1")
    assert float(v.body.mass) == 0.095
    assert float(v.rotors.radius) == 0.0875
    assert float(v.swash_plate.max_tilt) == pytest.approx(math.radians(15))
    assert float(v.battery.capacity) == pytest.approx(0.25 * 3600)
    # Errata 5: the time constant of 1 ms is the lower rotor's, 0.24 s the bar's.
    assert float(v.swash_plate.time_constant) == 0.001
    assert float(v.stabiliser_bar.time_constant) == 0.24


@pytest.mark.parametrize("name", list_builtin_vehicles())
def test_every_parameter_has_unit_source_and_meaning(name: str) -> None:
    rows = list_parameters(load_vehicle(name))
    assert len(rows) > 40
    assert all(r.unit and r.source and r.description and r.symbol for r in rows)
    assert len({r.key for r in rows}) == len(rows)


@pytest.mark.parametrize("name", list_builtin_vehicles())
def test_mass_budget_adds_up(name: str) -> None:
    v = load_vehicle(name)
    assert v.mass_budget is not None
    assert sum(float(q) for _, q in v.mass_budget) == pytest.approx(float(v.body.mass), abs=1e-9)


def test_written_vehicle_reads_back_the_same(tmp_path, text: str) -> None:
    path = tmp_path / "copy.toml"
    path.write_text(text)
    assert load_vehicle(path) == load_vehicle("mufly-1.1")


def test_vehicle_is_frozen() -> None:
    v = load_vehicle("mufly-1.1")
    with pytest.raises(ValueError, match="frozen"):
        v.body.mass.value = 1.0


FAULTS = [
    ('inertia_xx = { value = 1e-4, unit = "kg m2", source = "CAD" }', "mass =", "body.mass", "mass"),
    ('mas = { value = 0.1, unit = "kg", source = "measured" }', "mass =", "body.mas", "did you mean 'mass'"),
    ('mass = { value = 0.1, source = "measured" }', "mass =", "body.mass", "unit is missing"),
    ("mass = 0.095", "mass =", "body.mass", "neither unit"),
    ('mass = { value = -1, unit = "kg", source = "measured" }', "mass =", "body.mass", "at least 0.001"),
    ('mass = { value = nan, unit = "kg", source = "measured" }', "mass =", "body.mass", "out of range"),
    ('mass = { value = 95, unit = "stone", source = "measured" }', "mass =", "body.mass", "use one of: kg, g"),
    ('mass = { value = "x", unit = "kg", source = "measured" }', "mass =", "body.mass", "not a number"),
    ('mass = { value = 0.095, unit = "kg", source = "guess" }', "mass =", "body.mass.source", "guess"),
    ('mass = { value = 0.085, unit = "kg", source = "measured" }', "mass =", "mass_budget", "add up to 95.0 g"),
]  # fmt: skip


@pytest.mark.parametrize(("new", "old", "key", "words"), FAULTS)
def test_bad_input_is_named(tmp_path, text: str, new: str, old: str, key: str, words: str) -> None:
    # The written file has one table per parameter; put the faulty line into [body] instead of [body.mass].
    tables = tomllib.loads(text)
    wrong = tomllib.loads(new)
    if key.split(".")[-1] == "mas" or "inertia_xx" in wrong:
        del tables["body"]["mass"]
    tables["body"].update(wrong)
    path = tmp_path / "bad.toml"
    path.write_text(tomli_w.dumps(tables))
    with pytest.raises(mufly.InputError) as caught:
        load_vehicle(path)
    message = str(caught.value)
    assert message.count("\n") == 0
    assert str(path) in message
    assert caught.value.key == key
    assert words in message


def test_not_toml_and_no_such_file(tmp_path) -> None:
    path = tmp_path / "x.toml"
    path.write_text("a = = 1")
    with pytest.raises(mufly.InputError, match=r"line 1: .* is not valid TOML"):
        load_vehicle(path)
    with pytest.raises(mufly.InputError, match=r"mufly-1\.1"):
        load_vehicle("mufly-9")


def test_curve_must_span_the_charge(tmp_path, text: str) -> None:
    path = tmp_path / "bad.toml"
    tables = tomllib.loads(text)
    tables["battery"]["open_circuit_voltage"]["fraction"][0] = 0.01
    path.write_text(tomli_w.dumps(tables))
    with pytest.raises(mufly.InputError, match="rising from 0"):
        load_vehicle(path)


def test_replace_changes_one_number_and_checks_it() -> None:
    v = load_vehicle("mufly-1.1")
    lighter = replace_parameters(v, {"body.mass": 0.08, "battery.model": "constant"})
    assert float(lighter.body.mass) == 0.08
    assert lighter.battery.model == "constant"
    assert lighter.body.inertia_xx == v.body.inertia_xx
    with pytest.raises(mufly.InputError, match="no such parameter"):
        replace_parameters(v, {"body.weight": 1.0})
    with pytest.raises(mufly.InputError, match=r"at least 0\.001"):
        replace_parameters(v, {"body.mass": 0.0})
