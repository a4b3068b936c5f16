"""``mufly vehicle``: what it prints, and how it says what is wrong."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mufly.cli import app as whole
from mufly.cli.vehicle import app
from mufly.errors import InputError, MuflyError
from mufly.mission import load_mission
from mufly.rotor import load_rotor
from mufly.vehicle import (
    format_vehicle_toml,
    list_builtin_vehicles,
    list_parameters,
    load_vehicle,
    replace_parameters,
)

runner = CliRunner()


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def output(*arguments: str) -> str:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def test_list_names_every_vehicle() -> None:
    text = output("list")
    for name in list_builtin_vehicles():
        assert name in text
    assert "95 g" in text
    assert "rotor diameter (mm)" in text
    assert "175" in text
    assert "0.72, 0.79" in text


def test_list_as_json() -> None:
    rows = {row["name"]: row for row in json.loads(output("list", "--json"))}
    assert set(rows) == set(list_builtin_vehicles())
    assert rows["mufly-1.1"]["mass_kg"] == 0.095
    assert rows["mufly-1.1"]["rotor_diameter_m"] == pytest.approx(0.175)


@pytest.mark.parametrize("name", list_builtin_vehicles())
def test_show_prints_every_parameter(name: str) -> None:
    """Those of its sensors by a command of their own."""
    sensors = CliRunner().invoke(whole, ["sensors", "show", name]).stdout
    shown = output("show", name)
    assert "sensors show" in shown
    for row in list_parameters(load_vehicle(name)):
        text = sensors if row.key.startswith("sensors.") else shown
        assert row.key.rpartition(".")[2] in text
        assert row.symbol in text or row.key.startswith("mass_budget")


def test_show_uses_readable_units() -> None:
    lines = output("show", "mufly-1.1").splitlines()

    def line(key: str) -> str:
        return next(x for x in lines if x.split()[:1] == [key])

    assert "95 g" in " ".join(line("mass").split())
    assert "15 deg" in " ".join(line("max_tilt").split())
    assert "250 mA h" in " ".join(line("capacity").split())
    assert "95.0 g" in line("total")


def test_show_as_json_is_in_si() -> None:
    shown = json.loads(output("show", "mufly-1.1", "--json"))
    rows = {row["key"]: row for row in shown["parameters"]}
    assert rows["body.mass"] == {
        "key": "body.mass",
        "symbol": "m",
        "value": 0.095,
        "unit": "kg",
        "source": "measured",
        "std": 0.0005,
        "description": "take-off mass",
        "note": "Table 5.3; on a scale; std: printed to the gram",
    }
    assert len(rows["battery.open_circuit_voltage"]["value"]) == 12


def test_check_prints_the_hover_point() -> None:
    text = output("check", "mufly-1.1")
    assert "3595 upper, 4236 lower rpm" in text
    assert "0.720 upper, 0.791 lower" in text
    assert "endurance from a full battery" in text


def test_check_as_json() -> None:
    hover = json.loads(output("check", "mufly-1.1", "--json"))["hover"]
    assert sum(hover["thrust_N"]) == pytest.approx(0.095 * 9.81 + 0.009)
    assert hover["battery_power_W"] == pytest.approx(hover["battery_voltage_V"] * hover["battery_current_A"])
    # Half the charge at the current of a half-full battery, roughly: 250 mA h at 2.9 A.
    assert hover["endurance_s"] == pytest.approx(900 / hover["battery_current_A"], rel=0.1)
    assert hover["thrust_to_weight_full"] > hover["thrust_to_weight_half"] > 1.2


def test_check_warns(tmp_path) -> None:
    path = tmp_path / "odd.toml"
    odd = replace_parameters(load_vehicle("mufly-1.1"), {"swash_plate.time_constant": 1e-4, "body.mass": 0.112})
    path.write_text(format_vehicle_toml(odd))
    text = output("check", str(path))
    assert "steps below 0.27 ms" in text
    assert "The thrust reserve for climb and gusts is small" in text


def fault(*arguments: str) -> MuflyError:
    result = runner.invoke(app, arguments)
    assert result.exit_code != 0
    assert isinstance(result.exception, MuflyError)  # the top-level command turns it into one line and status 1
    assert "\n" not in str(result.exception)
    assert not result.stdout
    return result.exception


def test_show_writes_a_file_to_start_from(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(output("show", "mufly-2.0", "--toml"))
    assert load_vehicle(path) == load_vehicle("mufly-2.0")


def test_a_wrong_file_is_named(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(format_vehicle_toml(load_vehicle("mufly-1.1")).replace("value = 0.095", "value = -0.095"))
    error = fault("check", str(path))
    assert isinstance(error, InputError)
    assert error.key == "body.mass"
    assert str(path) in str(error)


def test_too_heavy_and_unknown(tmp_path) -> None:
    path = tmp_path / "heavy.toml"
    path.write_text(format_vehicle_toml(replace_parameters(load_vehicle("mufly-1.1"), {"body.mass": 0.2})))
    assert "too heavy to hover: 200 g" in str(fault("check", str(path)))
    assert "mufly-2.0" in str(fault("show", "mufly-3"))


def test_check_warns_of_unusual_values_and_states_a_high_sonar(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    made = {"body.drag_area_x": 0.4, "sensors.sonar.position": [[0.0, 0.0, -0.02]]}
    path.write_text(format_vehicle_toml(replace_parameters(load_vehicle("mufly-1.1"), made)))
    said = output("check", str(path))
    assert "mine.toml: body.drag_area_x: 0.4 m2 is 17 times the rotor disc's area" in " ".join(said.split())
    assert "The sonar is 0.0884 m above the floor on the ground" in said
    assert json.loads(output("check", str(path), "--json"))["warnings"][0].startswith("body.drag_area_x: 0.4 m2")
    assert "The sonar" not in output("check", "mufly-1.1")
    assert json.loads(output("check", "mufly-1.1", "--json"))["warnings"] == []


def test_help_explains_itself() -> None:
    text = output("--help")
    for command in ("list", "show", "check"):
        assert command in text


def test_new_writes_files_that_load_and_marks_guesses(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    given = [
        "new",
        "mine",
        "--mass",
        "120",
        "--radius",
        "90",
        "--kv",
        "1800",
        "--resistance",
        "0.3",
        "--out",
        str(folder),
    ]
    result = runner.invoke(whole, given)
    assert result.exit_code == 0, result.exception
    assert "mufly fly" in result.stdout
    mine = load_vehicle(folder / "vehicle.toml")
    notes = {row.key: row.note for row in list_parameters(mine)}
    assert notes["body.mass"] == notes["rotors.radius"] == notes["motor.resistance"] == "given"
    assert all(notes[key].startswith("guess:") for key in ("body.inertia_xx", "motor.friction", "battery.capacity"))
    assert float(load_rotor(folder / "rotor.toml").radius) == 0.09
    assert load_mission(folder / "mission.toml").waypoint == load_mission("demonstration").waypoint
    with pytest.raises(InputError, match="already exists"):
        runner.invoke(whole, given, catch_exceptions=False)
    given = ["new", "small", "--mass", "500", "--radius", "50", "--out", str(tmp_path / "small")]
    said = " ".join(runner.invoke(whole, given).stdout.split())
    assert "hovers beyond usual limits" in said
    assert "vehicle.toml: rotors.radius: the disc loading is 625 N/m2" in said
    with pytest.raises(InputError, match="--capacity: does not hover"):
        runner.invoke(whole, ["new", "x", "--mass", "100", "--radius", "90", "--capacity", "5"], catch_exceptions=False)
    with pytest.raises(InputError, match="--radius: is missing"):
        runner.invoke(whole, ["new", "other", "--mass", "120"], catch_exceptions=False)
