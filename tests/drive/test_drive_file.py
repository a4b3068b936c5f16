"""Drive files: both ways to give a motor, round trip, faults."""

import tomllib

import numpy as np
import pytest
import tomli_w

from mufly.drive import (
    drive_to_toml,
    find_operating_point,
    list_builtin_drives,
    load_drive,
    make_coefficient_load,
)
from mufly.errors import InputError
from mufly.vehicle import format_vehicle_toml, list_builtin_coefficient_maps, load_vehicle


def q(value, unit, source="datasheet"):
    return {"value": value, "unit": unit, "source": source}


def tables():
    whole = tomllib.loads(drive_to_toml(load_drive("mufly")))
    del whole["motor"]
    whole["datasheet"] = {
        "speed_constant": q(2000, "rpm/V"),
        "resistance": q(120, "mohm"),
        "no_load_current": q(0.6, "A"),
        "no_load_voltage": q(8, "V"),
    }
    whole["controller"] = {"on_resistance": q(10, "mohm"), "efficiency": q(98, "%")}
    return whole


def written(tmp_path, content):
    path = tmp_path / "drive.toml"
    path.write_text(tomli_w.dumps(content), encoding="utf-8")
    return path


def test_built_in_drives_load() -> None:
    for name in list_builtin_drives():
        assert load_drive(name).rotors == 2


def test_vehicle_file_gives_its_drive(tmp_path) -> None:
    path = tmp_path / "v.toml"
    path.write_text(format_vehicle_toml(load_vehicle("mufly-2.0")), encoding="utf-8")
    assert load_drive(path) == load_drive("mufly-2.0")


def test_round_trip(tmp_path) -> None:
    drive = load_drive(written(tmp_path, tables()))
    again = load_drive(written(tmp_path, tomllib.loads(drive_to_toml(drive))))
    assert again == drive


def test_data_sheet_motor_does_what_its_sheet_says(tmp_path) -> None:
    drive = load_drive(written(tmp_path, tables()))
    c = drive.motor_constants(gear_ratio=1.0, gear_efficiency=1.0)
    assert 60 / (2 * np.pi * c.back_emf_V_s) == pytest.approx(2000)
    assert c.torque_Nm_A == c.back_emf_V_s
    assert c.resistance_ohm == pytest.approx(0.13)
    assert c.controller_efficiency == pytest.approx(0.98)
    # Free at 8 V behind the motor's own 0.12 ohm: 0.6 A.
    speed = (8 - 0.12 * 0.6) / c.back_emf_V_s
    assert c.friction_Nm_s * speed == pytest.approx(c.torque_Nm_A * 0.6)
    almost_free = make_coefficient_load(1e-9, 1e-9, radius_m=0.05)
    point = find_operating_point(drive, almost_free, motor_voltage_V=8 + 0.01 * 0.6, supply_V=9.0, gear_ratio=1.0)
    assert point.motor_current_A == pytest.approx(0.6, rel=1e-3)
    assert point.motor_speed_rad_s == pytest.approx(speed, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("datasheet"), r"motor: neither \[motor\] nor \[datasheet\] is given"),
        (lambda t: t["gear"].update(ratio=q(-1, "1")), "gear.ratio: -1 1 is out of range"),
        (lambda t: t["gear"].pop("efficiency"), "gear.efficiency: is missing"),
        (lambda t: t["datasheet"]["speed_constant"].update(unit="rpm"), "datasheet.speed_constant.*rpm/V"),
        (lambda t: t["datasheet"]["speed_constant"].update(value="fast"), "'fast' is out of range"),
        (lambda t: t["datasheet"].update(no_load_current=q(90, "A")), "resistance alone takes 10.8 V"),
        (lambda t: t.update(rotors=0), "rotors: 0"),
        (lambda t: t.update(colour="red"), "colour: unknown key"),
    ],
)
def test_faults_are_named(tmp_path, change, message) -> None:
    content = tables()
    change(content)
    with pytest.raises(InputError, match=message) as caught:
        load_drive(written(tmp_path, content))
    assert "\n" not in str(caught.value)


def test_unknown_drive_is_named() -> None:
    with pytest.raises(InputError, match="no such drive or vehicle or file"):
        load_drive("turbine")


def test_a_vehicle_file_that_names_a_map_gives_its_drive(tmp_path) -> None:
    content = tomllib.loads(format_vehicle_toml(load_vehicle("mufly-1.1")))
    content["rotors"]["coefficient_map"] = list_builtin_coefficient_maps()[0]
    assert load_drive(written(tmp_path, content)) == load_drive("mufly-1.1")
