"""``mufly coax`` and ``--method wake``: what they print, what they write, and how they say what is wrong."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli.coax import app
from mufly.cli.rotor import app as rotor_app
from mufly.errors import MuflyError
from mufly.rotor import load_rotor
from mufly.study import read_study_results

runner = CliRunner()
RPM = math.pi / 30.0
COARSE = [
    part
    for text in ("chord_deg=15", "turns=2", "far_turns=6", "stations=10", "tolerance=0.01")
    for part in ("--wake-set", text)
]


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def output(*arguments: str, of=app) -> str:
    result = runner.invoke(of, arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def fault(*arguments: str, of=app) -> str:
    result = runner.invoke(of, arguments)
    assert isinstance(result.exception, MuflyError), result.exception
    assert "\n" not in str(result.exception)
    return str(result.exception)


def test_hover_by_the_wake_prints_json_and_writes_pictures(tmp_path) -> None:
    answer = json.loads(output("hover", *COARSE, "--json", "--out", str(tmp_path)))
    upper, lower = answer["upper"], answer["lower"]
    assert upper["speed_rad_s"] == pytest.approx(6000 * RPM)
    assert lower["speed_rad_s"] == pytest.approx(6650 * RPM)
    assert answer["thrust_N"] == pytest.approx(upper["thrust_N"] + lower["thrust_N"])
    assert answer["power_W"] == pytest.approx(sum(r["torque_Nm"] * r["speed_rad_s"] for r in (upper, lower)))
    assert upper["thrust_N"] == pytest.approx(sum(upper["stations"]["dT_N"]))
    alone = answer["isolated"]["lower"]
    assert answer["change_from_isolated"]["lower_thrust"] == pytest.approx(lower["thrust_N"] / alone["thrust_N"] - 1)
    assert answer["wake"]["converged"]
    assert answer["wake"]["settings"]["chord_deg"] == 15
    for name in ("loads.png", "history.png", "wake.png", "air.png", "air-instant.png", "history.csv"):
        assert str(tmp_path / name) in answer["files"]
        assert (tmp_path / name).stat().st_size > 1000
    rows = np.genfromtxt(tmp_path / "history.csv", delimiter=",", names=True)
    assert rows.size == answer["wake"]["iterations"]
    assert rows["upper_thrust_N"][-1] == pytest.approx(upper["thrust_N"], rel=1e-6)


def test_hover_by_blade_elements_prints_a_table() -> None:
    arguments = (
        "hover",
        "naca0012-r60-c20",
        "naca4412-r60-c20",
        "--method",
        "bemt",
        "--pitch",
        "14,12",
        "--spacing",
        "3cm",
    )
    answer = json.loads(output(*arguments, "--json"))
    assert answer["lower"]["rotor"] == "naca4412-r60-c20"
    assert answer["lower"]["pitch_rad"] == pytest.approx(math.radians(12))
    assert answer["spacing_m"] == pytest.approx(0.03)
    assert answer["wake"] is None
    text = output(*arguments)
    assert f"{answer['upper']['thrust_N']:.4g}" in text
    assert "upper alone" in text
    assert "upper alone" not in output(*arguments, "--no-isolated")
    climbing = json.loads(output(*arguments, "--climb", "2", "--json"))
    assert climbing["thrust_N"] < answer["thrust_N"]
    flat = output("hover", "--pitch", "0", "--rpm", "6000", "--method", "bemt").splitlines()
    heads = next(k for k, line in enumerate(flat) if "upper thrust (%)" in line)
    assert flat[heads + 1].split() == ["-", "+0.0", "-", "+0.0", "-", "+0.0", "-"]


def test_trim_cancels_torques_by_speed_and_by_pitch() -> None:
    by_speed = json.loads(output("trim", "--rpm", "6000", "--method", "bemt", "--json"))
    assert by_speed["upper"]["speed_rad_s"] == pytest.approx(6000 * RPM)
    by_thrust = json.loads(output("trim", "--thrust", "0.9", "--method", "bemt", "--json"))
    assert by_thrust["thrust_N"] == pytest.approx(0.9, rel=1e-6)
    by_pitch = json.loads(output("trim", "--rpm", "6000,6300", "--free", "lower-pitch", "--method", "bemt", "--json"))
    assert by_pitch["lower_over_upper"]["speed"] == pytest.approx(1.05)
    for answer in (by_speed, by_thrust, by_pitch):
        assert answer["lower_over_upper"]["torque"] == pytest.approx(1.0, rel=1e-6)
        assert answer["isolated"] is None


def test_sweep_writes_tables_and_a_picture(tmp_path) -> None:
    arguments = (
        "sweep", "--method", "bemt", "--vary", "spacing=4,20mm", "--vary", "lower_rpm=5500:6500:500", "--set",
        "upper_rpm=6000", "--over", "lower_speed", "--plot", "lower_thrust_N", "--out", str(tmp_path),
    )  # fmt: skip
    text = output(*arguments)
    assert "6 cases, 3 failed" in text
    assert "overlap" in text
    data = read_study_results(tmp_path / "sweep.nc")
    np.testing.assert_allclose(data.lower_speed, [5500 * RPM, 6000 * RPM, 6500 * RPM])
    assert (np.diff(data.lower_thrust_N.values[1]) > 0).all()
    assert (tmp_path / "lower_thrust_N.png").exists()
    again = json.loads(output(*arguments, "--json"))
    assert again["data_vars"]["lower_thrust_N"]["data"][1][0] == pytest.approx(float(data.lower_thrust_N[1, 0]))
    assert "spacing" in output("parameters")


def test_optimise_writes_rotor_files_that_give_the_power_it_printed(tmp_path) -> None:
    answer = json.loads(
        output(
            "optimise", "--thrust", "0.4", "--vary", "upper_pitch,lower_pitch", "--generations", "2", "--no-check",
            "--wake-set", "stations=10", "--json", "--out", str(tmp_path),
        )
    )  # fmt: skip
    start, best = answer["bemt"]["start"], answer["bemt"]["optimum"]
    assert best["power_W"] < start["power_W"]
    assert best["thrust_N"] == pytest.approx(0.4, rel=1e-6)
    assert answer["wake"] is None
    assert load_rotor(tmp_path / "upper.toml").radius_m == pytest.approx(0.06)
    pitch = ",".join(f"{math.degrees(best[s]['pitch_rad']):.12g}" for s in ("upper", "lower"))
    trimmed = json.loads(
        output(
            "trim", str(tmp_path / "upper.toml"), str(tmp_path / "lower.toml"), "--thrust", "0.4", "--pitch", pitch,
            "--method", "bemt", "--wake-set", "stations=10", "--json",
        )
    )  # fmt: skip
    assert trimmed["power_W"] == pytest.approx(best["power_W"], rel=1e-6)


def test_a_wake_that_does_not_converge_is_an_error_and_keeps_its_history(tmp_path) -> None:
    message = fault("hover", *COARSE, "--wake-set", "iterations=7", "--out", str(tmp_path))
    assert "not converged in 7 iterations" in message
    assert str(tmp_path) in message
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 8
    message = fault("trim", *COARSE, "--wake-set", "iterations=7", "--out", str(tmp_path / "trim"))
    assert "not converged" in message
    rows = np.genfromtxt(tmp_path / "trim" / "progress.csv", delimiter=",", names=True)
    assert rows["iteration"].max() == 7
    assert (rows["thrust_N"] > 0).all()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("hover", "--spacing", "3mm"), "overlap"),
        (("hover", "--spacing", "0mm"), "out of range"),
        (("hover", "--spacing", "20"), "out of range"),
        (("hover", "--rpm", "6000,0"), "out of range"),
        (("hover", "--rpm", "1,2,3"), "UPPER,LOWER"),
        (("hover", "--pitch", "x"), "--pitch"),
        (("hover", "--method", "magic"), "bemt, tubes, wake"),
        (("hover", "--wake", "stiff"), "free, prescribed"),
        (("hover", "--method", "bemt", "--wake", "prescribed"), "--method wake"),
        (("hover", "--wake-set", "step_deg=90"), "too coarse"),
        (("hover", "--wake-set", "nothing=1"), "is unknown"),
        (("hover", "--wake-set", "turns=many"), "not a number"),
        (("trim", "--thrust", "-1"), "above 0"),
        (("trim", "--thrust", "1", "--rpm", "6000"), "--rpm"),
        (("trim", "--rpm", "6000,6000"), "contains the lower speed"),
        (("trim", "--free", "upper-pitch"), "lower-speed or lower-pitch"),
        (("sweep",), "nothing is varied"),
        (("sweep", "--vary", "spacing=10:30:10mm", "--set", "spacing=1cm"), "varied too"),
        (("sweep", "--vary", "gap=10:30:10mm"), "cannot be varied"),
        (("sweep", "--vary", "spacing=20mm", "--plot", "beauty"), "not a result"),
        (("sweep", "--vary", "spacing=20mm", "--over", "pitch"), "not varied"),
        (("optimise", "--vary", "upper_radius"), "cannot be free"),
        (("optimise", "--limit", "upper_chord"), "not a limit"),
        (("optimise", "--thrust", "0"), "above 0"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(arguments: tuple[str, ...], said: str) -> None:
    assert said in fault(*arguments)


def test_rotor_hover_and_compare_by_the_wake(tmp_path) -> None:
    arguments = ("hover", "naca0012-r60-c20", "--pitch", "14", "--rpm", "6000", "--method", "wake", *COARSE)
    answer = json.loads(output(*arguments, "--json", "--drive", "mufly", "--out", str(tmp_path), of=rotor_app))
    assert answer["method"] == "wake"
    assert answer["wake"]["converged"]
    assert answer["drive"]["mechanical_power_W"] == pytest.approx(answer["power_W"], rel=1e-3)
    for name in ("wake.png", "air.png", "history.csv", "stations.csv"):
        assert (tmp_path / name).exists()
    table = tmp_path / "bench.csv"
    table.write_text(f"pitch_deg,speed_rpm,thrust_N,torque_Nm\n14,6000,{answer['thrust_N']},{answer['torque_Nm']}\n")
    beside = json.loads(
        output("compare", "naca0012-r60-c20", str(table), "--method", "wake", *COARSE, "--json", of=rotor_app)
    )
    assert beside["method"] == "wake"
    assert abs(beside["points"][0]["thrust_error"]) < 1e-6
    short = ("--wake-set", "iterations=5")
    text = output("compare", "naca0012-r60-c20", str(table), "--method", "wake", *COARSE, *short, of=rotor_app)
    assert "not converged in 5 iterations" in text
    assert "not converged" in fault(*arguments, *short, of=rotor_app)
    band = json.loads(output(*arguments, "--band", "0.9", "--json", of=rotor_app))["band"]
    assert band["mean_thrust_N"] == pytest.approx(answer["thrust_N"])
    assert band["thrust_N"][0] < answer["thrust_N"] < band["thrust_N"][1]
    assert "--calibrate" in fault(
        "compare", "naca0012-r60-c20", str(table), "--method", "wake", "--calibrate", "1", of=rotor_app
    )


def test_rotor_sweep_by_the_wake_marks_what_does_not_converge() -> None:
    arguments = (
        "sweep", "naca0012-r60-c20", "--vary", "pitch=12,14deg", "--set", "speed=6000rpm", "--method", "wake", *COARSE,
    )  # fmt: skip
    answer = json.loads(output(*arguments, "--json", of=rotor_app))
    thrust = answer["data_vars"]["thrust_N"]["data"]
    assert 0.1 < thrust[0] < thrust[1] < 0.4
    assert answer["attrs"]["method"] == "wake, free"
    failed = json.loads(output(*arguments, "--wake-set", "iterations=5", "--json", of=rotor_app))
    assert all("not converged in 5" in f for f in failed["data_vars"]["fault"]["data"])
    assert failed["data_vars"]["thrust_N"]["data"] == [None, None]


def test_forward_prints_both_rotors_over_airspeed(tmp_path) -> None:
    found = runner.invoke(app, ["forward", "--speed", "3", "--flap-frequency-ratio", "1.6", "--out", str(tmp_path)])
    assert found.exit_code == 0, found.output
    assert "walkera-5g6 over walkera-5g6" in found.output
    assert {f.name for f in tmp_path.iterdir()} == {"forward.png", "disc-upper.png", "disc-lower.png"}


@pytest.mark.parametrize("command", ["hover", "trim"])
def test_a_pair_is_printed_with_its_interval(command: str) -> None:
    arguments = (command, "--method", "bemt", "--band", "0.9")
    answer = json.loads(output(*arguments, "--json"))
    for side in ("upper", "lower"):
        low, high = answer["band"][side]["thrust_N"]
        assert low < answer[side]["thrust_N"] < high
    assert "lower torque (N m)" in output(*arguments)
    assert "band" not in json.loads(output(command, "--method", "bemt", "--json"))
    assert "add --band" in fault(command, "--section", "guessed")
