"""``mufly identify motor``, ``rotor`` and ``plan``: what they print and write, and how they say what is wrong."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.identify.rotor_bench import register_bench_commands
from mufly.cli.options import CommandGroup, NumberOptionParser, parse_value_and_std
from mufly.errors import InputError
from mufly.vehicle import load_vehicle

runner = CliRunner()
app = CommandGroup()
register_bench_commands(app)


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def output(*arguments: str) -> str:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def refused(*arguments: str) -> str:
    result = runner.invoke(app, arguments)
    assert isinstance(result.exception, InputError)
    return str(result.exception)


@pytest.fixture
def motor_file(tmp_path):
    k_e, k_m, r, d = 0.0045, 0.0035, 1.3811, 5.2107e-7
    u = np.repeat([4.0, 7.2], 10)
    torque = np.tile(np.linspace(0.05, 0.8, 10), 2) * k_m * u / r
    speed = (k_m * u / r - torque) / (k_m * k_e / r + d)
    y = np.column_stack([u, (u - k_e * speed) / r, speed * 30 / math.pi, 1e3 * torque])
    y = y * (1 + 0.01 * np.random.default_rng(0).standard_normal(y.shape))
    path = tmp_path / "motor.csv"
    np.savetxt(path, y, delimiter=",", header="voltage_V,current_A,speed_rpm,torque_mNm", comments="")
    return path


def test_motor(motor_file, tmp_path):
    new = tmp_path / "new.toml"
    arguments = (
        "motor",
        str(motor_file),
        "--vehicle",
        "mufly-1.1",
        "--write",
        str(new),
        "--out",
        str(tmp_path / "m"),
    )
    text = output(*arguments)
    assert "kE" in text
    assert "95 % interval" in text
    assert (tmp_path / "m" / "motor.png").is_file()
    assert load_vehicle(new).motor.resistance.source == "identified"
    answer = json.loads(output(*arguments[:2], "--json"))
    assert [e["symbol"] for e in answer["estimates"]] == ["kE", "kM", "Rohm", "dR"]
    assert float(load_vehicle(new).motor.resistance) == pytest.approx(answer["estimates"][2]["value"])
    free = output("motor", str(motor_file), "--gear-efficiency", "free")
    assert "kM*eta_gear" in free
    assert "not observable: kM and dR" in free


def test_motor_refuses(motor_file):
    assert "needs a vehicle" in refused("motor", str(motor_file), "--write", "x.toml")
    assert "--gear-efficiency: 1.2" in refused("motor", str(motor_file), "--gear-efficiency", "1.2")
    assert "--noise: wind" in refused("motor", str(motor_file), "--noise", "wind=1%")
    assert "cannot be read" in refused("motor", "nothing.csv")


def test_rotor_with_calibration_and_prediction(tmp_path):
    speed = np.r_[0.0, np.linspace(3000, 7000, 8), 0.0]
    thrust = 1.2 * math.pi * 0.06**4 * (speed * math.pi / 30) ** 2 * 0.0113
    bench, cells = tmp_path / "bench.csv", tmp_path / "cells.csv"
    rng = np.random.default_rng(0)
    np.savetxt(bench, np.column_stack([speed, 0.1 + 2 * thrust + 1e-3 * rng.standard_normal(10)]), delimiter=",",
               header="speed_rpm,thrust_raw_V", comments="")  # fmt: skip
    weights = np.repeat([0.0, 10.0, 20.0, 40.0], 3)
    reading = 0.3 + 2 * weights * 9.80665e-3 + 1e-3 * rng.standard_normal(12)
    np.savetxt(cells, np.column_stack([weights, reading]), delimiter=",", header="thrust_g,thrust_raw_V", comments="")
    arguments = (
        "rotor",
        str(bench),
        "--calibration",
        str(cells),
        "--rotor",
        "naca0012-r60-c20",
        "--pitch",
        "12",
    )
    text = output(*arguments, "--out", str(tmp_path / "r"))
    assert "gain" in text
    assert "zero read 2 times" in text
    assert "constant within its error" in text
    assert "prediction" in text
    assert (tmp_path / "r" / "rotor.png").is_file()
    answer = json.loads(output(*arguments, "--json"))
    e = answer["results"][0]["estimates"][0]
    assert e["low"] < 0.0113 < e["high"]
    new = tmp_path / "new.toml"
    output(*arguments, "--vehicle", "mufly-1.1", "--as", "upper", "--write", str(new))
    assert float(load_vehicle(new).rotors.upper.thrust_coefficient) == pytest.approx(e["value"])
    assert "--radius" in refused("rotor", str(bench))
    assert "without a calibration" in refused("rotor", str(bench), "--radius", "0.06")
    assert "--as" in refused(*arguments, "--as", "middle")


def test_files_of_several_kinds_with_a_map_each(tmp_path):
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    a.write_text("RPM,F\n1000,1\n2000,4\n3000,9\n")
    b.write_text("RPM,F1,F2\n1000,1,0.6\n2000,4,2.4\n3000,9,5.4\n")
    maps = ("--column", "thrust=F(N)", "-c", "thrust_upper=F1(N)", "-c", "thrust_lower=F2(N)")
    text = output("rotor", str(a), str(b), "--radius", "0.1", *maps)
    assert "cT_up of b.csv is 1.000" in text
    assert "cT_dw of b.csv is 0.600" in text
    told = refused("rotor", str(a), str(b), "--radius", "0.1", "--column", "thrust=G(N)")
    assert "a.csv, b.csv: G: is not among the columns; the header is RPM, F; RPM, F1, F2" in told


def test_plan(tmp_path):
    arguments = (
        "plan",
        "mufly-1.1",
        "--free",
        "Izz,cQ_dw",
        "--channel",
        "yaw",
        "--duration",
        "6",
        "--kind",
        "doublet",
    )
    text = output(*arguments, "--out", str(tmp_path))
    assert "bound by" in text
    assert (tmp_path / "plan_yaw.png").is_file()
    table = np.genfromtxt(tmp_path / "signal_yaw_doublet.csv", delimiter=",", names=True, comments="#", skip_header=1)
    answer = json.loads(output(*arguments, "--json"))
    found = answer["channels"][0]["candidates"][0]
    assert np.max(np.abs(table["signal"])) == pytest.approx(found["amplitude"], rel=1e-4)
    assert set(answer["together"]) == {"Izz", "cQ_dw"}
    narrow = json.loads(output(*arguments, "--limit", "heading_deg=10", "--json"))["channels"][0]["candidates"][0]
    assert narrow["bound_by"] == "heading"
    blind = json.loads(output(*arguments, "--noise", "yaw=none,r=0.3", "--json"))
    assert blind["together"]["Izz"] > 2 * answer["together"]["Izz"]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("--free", "Izzz"), "did you mean"),
        (("--free", "Izz", "--kind", "noise"), "--kind: 'noise' is unknown"),
        (("--free", "Izz", "--limit", "speed=3"), "--limit: speed"),
        (("--free", "Izz", "--limit", "motor=0.6"), "leaves no range"),
        (("--free", "Izz", "--band", "1"), "--band"),
        (("--free", "Izz", "--delay", "0.013"), "--delay"),
        (("--free", "Izz", "--sample", "0.0105"), "--sample"),
        (("--free", "Izz", "--duration", "1"), "--duration"),
        (("--free", "Izz", "--noise", "height=x"), "is not a number"),
    ],
)
def test_plan_refuses(arguments, what):
    assert what in refused("plan", "mufly-1.1", *arguments)


def test_numbers_with_doubt():
    def read(text, unit="1"):
        return parse_value_and_std(
            "--gear", NumberOptionParser(unit, "doubt", ("free",)).parse_option_text("--gear", text)
        )

    assert read("0.84+-0.02") == (0.84, 0.02)
    assert read("1.5") == (1.5, 0.0)
    assert read("free") == parse_value_and_std("--radius", None) == (None, 0.0)
    assert read("60mm+-0.2mm", "m") == pytest.approx((0.06, 0.0002))
    for text in ("x", "-1", "1+-x", "1+--2"):
        with pytest.raises(InputError):
            read(text)
