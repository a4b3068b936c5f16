"""``mufly drive``: what it prints, what it writes, and how it says what is wrong."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.drive import app
from mufly.errors import MuflyError

runner = CliRunner()


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def output(*arguments: str) -> str:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def test_show_balances_its_power() -> None:
    answer = json.loads(output("show", "--thrust", "0.3", "--thrust", "0.45", "--charge", "0.5", "--json"))
    p = answer["points"]
    losses = sum(np.array(p[f"{k}_loss_W"]) for k in ("copper", "conversion", "friction", "gear", "controller"))
    np.testing.assert_allclose(np.array(p["mechanical_power_W"]) + losses, p["input_power_W"])
    assert p["thrust_N"] == pytest.approx([0.3, 0.45])
    first, second = answer["endurance"]
    assert first["time_s"] > second["time_s"] > 60


def test_show_says_when_the_battery_cannot() -> None:
    text = output("show", "--duty", "1")
    assert text.splitlines()[4].split()[-1] == "-"
    assert "kE 4.5 mV s, kM 3.5 mN m/A" in text


def test_tables_break_no_word_of_a_head_in_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = output("show", "--duty", "0.5")
    words = text.split()
    for word in ("thrust", "efficiency", "current", "endurance*", "(min)", "(N/W)"):
        assert word in words
    assert max(map(len, text.splitlines()[3:-1])) <= 80


def test_show_with_a_rotor_file() -> None:
    answer = json.loads(output("show", "--rotor", "naca4412-r60-c20", "--pitch", "12", "--thrust", "0.3", "--json"))
    assert answer["points"]["thrust_N"] == pytest.approx([0.3])


def test_sweep_gives_the_curves_of_fig_3_7(tmp_path) -> None:
    arguments = ("sweep", "--gear", "0.5:8:0.5", "--thrust", "0.6", "--out", str(tmp_path))
    answer = json.loads(output(*arguments, "--json"))
    assert answer["optima"]["thrust"] == pytest.approx(1.55, abs=0.01)
    assert set(answer["data_vars"]) >= {"input_power_W", "mechanical_power_W", "thrust_N", "efficiency"}
    assert {"gear.nc", "gear.csv", "gear.png"} <= {f.name for f in tmp_path.iterdir()}
    assert "Largest gear ratio that gives 0.6 N: 2.64" in output(*arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("show", "--thrust", "3"), "3 N is out of reach"),
        (("show", "--thrust", "0.3", "--duty", "0.5"), "both --thrust and --duty"),
        (("show", "turbine"), "no such drive"),
        (("show", "--rotor", "naca4412-r60-c20"), "--pitch: is missing"),
        (("show", "--pitch", "12"), "leave it out"),
        (("sweep", "--gear", "8:1:1"), "contains no value"),
        (("sweep", "--gear", "0:8:1"), "--gear: 0 is out of range"),
        (("sweep", "--duty", "1.5"), "0.01 to 1"),
    ],
)
def test_faults_are_one_clear_line(arguments: tuple[str, ...], message: str) -> None:
    result = runner.invoke(app, arguments)
    assert isinstance(result.exception, MuflyError), result.exception
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
