"""mufly mission list, show, check."""

import json
import tomllib

import pytest
from typer.testing import CliRunner

from mufly.cli.mission import app
from mufly.errors import InputError
from mufly.mission import list_builtin_missions, load_mission, parse_mission

RUN = CliRunner()


def output(*words):
    result = RUN.invoke(app, list(words))
    assert result.exit_code == 0, result.output
    return result.stdout


def test_list():
    text = output("list")
    assert all(name in text for name in list_builtin_missions())
    rows = json.loads(output("list", "--json"))
    assert [r["name"] for r in rows] == list_builtin_missions()
    assert next(r for r in rows if r["name"] == "demonstration")["way_m"] == pytest.approx(15.0)


def test_show():
    text = output("show", "demonstration")
    assert "-3.00 m" in text
    assert "along the way" in text
    answer = json.loads(output("show", "demonstration", "--json"))
    assert answer["waypoints"][0]["position_m"] == [-3.0, 0.0, -1.0]
    assert "crate" in output("show", "box-on-leg")


def test_show_as_toml_is_the_mission():
    assert parse_mission(tomllib.loads(output("show", "box-on-leg", "--toml"))) == load_mission("box-on-leg")


def test_check():
    assert "can be flown by mufly-1.1" in " ".join(output("check", "demonstration").split())
    answer = json.loads(output("check", "demonstration", "--vehicle", "mufly-2.0", "--json"))
    assert answer["vehicle"] == "mufly-2.0"
    assert 0.0 < answer["charge_fraction"] < 0.8


def test_check_refuses(tmp_path):
    file = tmp_path / "far.toml"
    file.write_text("[[waypoint]]\nposition_m = [500.0, 0.0, -1.0]\n")
    result = RUN.invoke(app, ["check", str(file)])
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith(f"{file}: waypoint[1].position_m: is out of reach")


def test_help_is_good_enough_to_work_from():
    for words in (["--help"], ["show", "--help"], ["check", "--help"]):
        text = " ".join(output(*words).split())
        assert "mission" in text
    assert "docs/reference/missions.md" in output("--help")


def test_show_tells_the_speed_of_a_leg_and_what_happens_at_the_end(tmp_path):
    file = tmp_path / "slow.toml"
    file.write_text('at_end = "return"\n[[waypoint]]\nposition_m = [1.0, 0.0, -1.0]\nspeed_m_s = 0.25\n')
    text = " ".join(output("show", str(file)).split())
    assert "0.25 m/s" in text
    assert "at the end it returns and lands" in text
    answer = json.loads(output("show", str(file), "--json"))
    assert (answer["at_end"], answer["waypoints"][0]["speed_m_s"]) == ("return", 0.25)
