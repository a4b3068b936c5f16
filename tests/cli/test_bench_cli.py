"""``mufly bench``: from a plan to files that the fits read, and how it says what is wrong."""

import json

import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError

runner = CliRunner()
NACA = "naca0012-r60-c20"


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


def output(*arguments):
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def refused(*arguments):
    result = runner.invoke(app, arguments)
    assert isinstance(result.exception, InputError), result.exception
    return str(result.exception)


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    plan = folder / "plan.toml"
    words = ("--pitch", "12", "--rpm", "3000:7000:2000", "--reference-pitch", "10", "--warm-up", "60")
    said = json.loads(output("bench", "plan", "--rotor", NACA, *words, "--out", str(plan), "--json"))
    assert said["points"] == 12
    assert "already exists" in refused("bench", "plan", "--rotor", NACA, "--out", str(plan))
    said = output("bench", "run", str(plan), "--out", str(folder / "s"), "--seed", "2")
    assert "12 points on simulated" in said
    assert "Done" in output("bench", "run", str(plan), "--out", str(folder / "s"), "--seed", "2")
    return folder


def test_results_go_through_the_fits(series):
    said = output("bench", "analyse", str(series / "s"))
    assert "95 % intervals" in said
    assert "of 6 intervals contain the truth" in said
    results = series / "s" / "results"
    found = json.loads((results / "summary.json").read_text(encoding="utf-8"))
    density = f"{found['settings'][0]['density_kg_m3']:.4f}"
    said = output("rotor", "compare", NACA, str(results / f"{NACA}-upper.csv"), "--density", density, "--json")
    assert abs(json.loads(said)["mean_thrust_error"]) < 0.03
    said = output("identify", "rotor", str(results / f"{NACA}-upper-points.csv"), "--radius", "0.06")
    assert "cT" in said
    output("identify", "motor", str(results / "motor-upper.csv"))
    assert "of 6 differ by more" in output("bench", "compare", str(series / "s"))
    assert (series / "s" / "live.html").read_text(encoding="utf-8").endswith("</html>")


def test_a_series_that_cannot_be_trusted_ends_with_status_1_and_no_results(series):
    plan = str(series / "plan.toml")
    output("bench", "run", plan, "--out", str(series / "bad"), "--fault", "reference")
    assert "fails its checks (reference)" in refused("bench", "analyse", str(series / "bad"))
    assert not (series / "bad" / "results").exists()


def test_what_is_wrong_is_said_before_anything_turns(series):
    plan = str(series / "plan.toml")
    assert "no such plan" in refused("bench", "run", "nowhere.toml")
    assert "no such bench" in refused("bench", "run", plan, "--rig", "nowhere.toml", "--out", str(series / "x"))
    assert "is not a number" in refused("bench", "plan", "--rotor", NACA, "--rpm", "fast")
    assert "no such rotor" in refused("bench", "plan", "--rotor", "nobody")
    assert "unknown" in refused("bench", "plan", "--rotor", NACA, "--axis", "middle")
    assert "contains no raw.jsonl" in refused("bench", "analyse", str(series))
