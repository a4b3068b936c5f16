"""``mufly rotor``: what it prints, what it writes, and how it says what is wrong."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import mufly.cli.aero.export  # noqa: F401  adds a command
from mufly.cli.rotor import app
from mufly.errors import InputError, MuflyError
from mufly.rotor import list_builtin_rotors

runner = CliRunner()


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def output(*arguments: str) -> str:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0, result.exception
    return result.stdout


def fault(*arguments: str) -> str:
    result = runner.invoke(app, arguments)
    assert isinstance(result.exception, MuflyError), result.exception
    assert "\n" not in str(result.exception)
    return str(result.exception)


def test_list_names_every_rotor() -> None:
    text = output("list")
    assert all(name in text for name in list_builtin_rotors())
    assert {r["name"] for r in json.loads(output("list", "--json"))} == set(list_builtin_rotors())


def test_show_gives_geometry_and_reynolds_numbers(tmp_path) -> None:
    answer = json.loads(output("show", "naca0012-r60-c20", "--rpm", "5000", "--json", "--out", str(tmp_path)))
    assert answer["solidity"] == pytest.approx(2 * 0.02 * 0.85 * 0.06 / (np.pi * 0.06**2))
    assert answer["aspect_ratio"] == pytest.approx(2.55)
    tip = answer["stations"]["reynolds"][-1]
    assert tip == pytest.approx(1.2 * 0.06 * 5000 * np.pi / 30 * 0.02 / 1.81e-5)
    assert (tmp_path / "blade.png").stat().st_size > 10_000
    assert "aspect ratio 2.55" in output("show", "naca0012-r60-c20")


def test_show_prints_a_file_that_is_the_same_rotor(tmp_path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(output("show", "walkera-5g6", "--toml"))
    assert output("show", str(mine), "--json") == output("show", "walkera-5g6", "--json")


def test_hover_prints_the_named_fields(tmp_path) -> None:
    answer = json.loads(
        output("hover", "naca0012-r60-c20", "--pitch", "12", "--rpm", "5000", "--json", "--out", str(tmp_path))
    )
    for key in ("thrust_N", "torque_Nm", "power_W", "figure_of_merit", "c_T", "c_Q"):
        assert np.isfinite(answer[key])
    assert answer["power_W"] == pytest.approx(answer["torque_Nm"] * 5000 * np.pi / 30)
    assert answer["thrust_N"] == pytest.approx(sum(answer["stations"]["dT_N"]))
    lines = (tmp_path / "stations.csv").read_text().splitlines()
    assert len(lines) == 1 + len(answer["stations"]["r_m"])
    assert (tmp_path / "stations.png").exists()
    text = output("hover", "naca0012-r60-c20", "--pitch", "12deg", "--rpm", "5000")
    assert f"{answer['thrust_N']:.4g} N" in text


def test_hover_finds_the_third_of_pitch_speed_and_thrust() -> None:
    by_pitch = json.loads(output("hover", "--pitch", "12", "--thrust", "0.4", "--json", "--drive", "mufly"))
    assert by_pitch["thrust_N"] == pytest.approx(0.4)
    rpm = by_pitch["speed_rad_s"] * 30 / np.pi
    by_speed = json.loads(output("hover", "--rpm", str(rpm), "--thrust", "0.4", "--json"))
    assert by_speed["pitch_rad"] == pytest.approx(np.radians(12), rel=1e-6)
    drive = by_pitch["drive"]
    assert drive["mechanical_power_W"] == pytest.approx(by_pitch["power_W"], rel=1e-6)
    assert by_speed["drive"] is None


def test_band_encloses_the_prediction() -> None:
    answer = json.loads(output("hover", "--pitch", "12", "--rpm", "5000", "--band", "0.9", "--json"))
    low, high = answer["band"]["thrust_N"]
    assert 0 < low < answer["thrust_N"] < high
    assert "nominal 90% interval" in output("hover", "--pitch", "12", "--rpm", "5000", "--band", "0.9")


def test_sweep_writes_tables_and_a_picture_and_resumes(tmp_path) -> None:
    arguments = (
        "sweep", "--vary", "chord=15:20:5mm", "--vary", "pitch=10:14:2deg", "--set", "thrust=0.4N",
        "--set", "gear=adapted", "--drive", "mufly", "--out", str(tmp_path),
    )  # fmt: skip
    text = output(*arguments)
    assert "6 cases, 0 failed" in text
    assert {"sweep.nc", "sweep.csv", "thrust_per_power_N_W.png"} <= {f.name for f in tmp_path.iterdir()}
    answer = json.loads(output(*arguments, "--json"))
    assert np.allclose(answer["data_vars"]["thrust_N"]["data"], 0.4)
    assert answer["data_vars"]["thrust_N"]["attrs"]["units"] == "N"


def test_failed_cases_are_counted_with_their_reason() -> None:
    text = output("sweep", "--vary", "pitch=10,14deg", "--vary", "airfoil=naca4412,gibberish", "--set", "speed=5000rpm")
    assert "4 cases, 2 failed" in text
    assert "gibberish: no such airfoil" in text


def test_rank_puts_the_thin_section_first() -> None:
    answer = json.loads(output("rank", "--airfoils", "naca0012,naca4406", "--pitch", "10:18:4deg", "--json"))
    assert [row["airfoil"] for row in answer["ranking"]] == ["naca4406", "naca0012"]
    assert answer["by"] == "thrust_per_power_N_W"
    assert answer["ranking"][0]["thickness_ratio"] == pytest.approx(0.06, abs=2e-3)


def test_compare_says_whether_it_is_calibrated(tmp_path) -> None:
    bench = tmp_path / "bench.csv"
    bench.write_text("pitch_deg,speed_rpm,thrust_N,torque_Nm\n12,5000,0.151,0.0015\n", encoding="utf-8")
    assert "not calibrated" in output("compare", "naca0012-r60-c20", str(bench))
    answer = json.loads(output("compare", "naca0012-r60-c20", str(bench), "--calibrate", "1", "--json"))
    assert answer["calibrated"]
    assert answer["points"][0]["thrust_error"] == pytest.approx(0.0, abs=1e-5)
    told = output("compare", "naca0012-r60-c20", str(bench), "--calibrate", "1")
    assert f"lift is scaled by {answer['lift_factor']:.4f}" in told
    assert "give a number from 1 to 1" in fault("compare", "naca0012-r60-c20", str(bench), "--calibrate", "2")
    assert "give a number from 1 to 1" in fault("fit", "naca0012-r60-c20", str(bench), "--point", "0")


def test_a_bench_without_pitch_is_told_of_or_given_one(tmp_path) -> None:
    with_pitch, without = tmp_path / "with.csv", tmp_path / "without.csv"
    with_pitch.write_text("pitch_deg,speed_rpm,thrust_N,torque_Nm\n12,5000,0.151,0.0015\n", encoding="utf-8")
    without.write_text("speed_rpm,thrust_N,torque_Nm\n5000,0.151,0.0015\n", encoding="utf-8")
    points = [
        json.loads(output("compare", "naca0012-r60-c20", str(file), *more, "--json"))["points"]
        for file, more in ((with_pitch, ()), (without, ("--pitch", "12")))
    ]
    assert points[0] == points[1]
    assert "pitch 0: blade angle of the rotor file" in output("compare", "naca0012-r60-c20", str(without))
    assert "is a column of the file" in fault("compare", "naca0012-r60-c20", str(with_pitch), "--pitch", "12")


def test_a_blade_goes_out_as_a_body_and_comes_in_again(tmp_path) -> None:
    body, table = tmp_path / "b.stl", tmp_path / "b.csv"
    told = json.loads(output("export", "naca0012-r60-c20", str(body), "--whole", "--hub", "10", "--json"))
    assert told["open_edges"] == 0
    assert "closed" in output("export", "naca0012-r60-c20", str(body), "--tail", "0.2", "--clockwise")
    again = json.loads(output("import", str(body), "--out", str(tmp_path / "again.toml"), "--json"))
    assert len(again["airfoils"]) == 15
    output("export", "naca0012-r60-c20", str(table), "--stations", "7")
    assert json.loads(output("import", str(table), "--json"))["airfoils"] == ["naca0012"]
    assert "unknown ending" in fault("export", "naca0012-r60-c20", str(tmp_path / "b.obj"))
    assert "--hub: belongs to a whole" in fault("export", "naca0012-r60-c20", str(body), "--hub", "5")
    assert "--out: is missing" in fault("import", str(body))


def test_forward_flight_states_its_default_hover() -> None:
    given = ("--speed", "0", "--flap-frequency-ratio", "1.1", "--json")
    known = json.loads(output("forward", "walkera-5g6", *given))
    assert "of the upper rotor of mufly-1.1 in hover" in known["flap_basis"]
    assert known["points"][0]["thrust_N"] == pytest.approx(0.432, abs=2e-3)
    other = json.loads(output("forward", "naca0012-r60-c20", *given))
    assert "speed by default, pitch by default" in other["flap_basis"]
    assert other["points"][0]["pitch_rad"] == pytest.approx(math.radians(12.0))
    assert "default" not in json.loads(output("forward", "--pitch", "13", "--rpm", "3600", *given))["flap_basis"]


def test_parameters_are_listed_with_units() -> None:
    listed = json.loads(output("parameters", "--json"))
    assert listed["chord"]["unit"] == "m"
    assert "mm" in listed["chord"]["units"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("hover", "--pitch", "12"), "needs two of"),
        (("forward", "--pitch", "12", "--rpm", "3600", "--thrust", "0.4"), "has all of"),
        (("hover", "--pitch", "steep", "--rpm", "5000"), "--pitch: 'steep' is not a number"),
        (("hover", "--pitch", "12mm", "--rpm", "5000"), "--pitch: '12mm' is in mm, which cannot become deg"),
        (("hover", "propeller", "--pitch", "12", "--rpm", "5000"), "no such rotor"),
        (("hover", "--pitch", "12", "--rpm", "5000", "--model", "magic"), "use one of: full, plain, thesis"),
        (("hover", "--pitch", "-10", "--thrust", "0.4"), "out of reach"),
        (("show", "--rpm", "0"), "--rpm: 0 rpm is out of range"),
        (("sweep",), "nothing is varied"),
        (("sweep", "--vary", "chord=1:2:1", "--set", "speed=5000rpm"), "'1:2:1' has no unit"),
        (("sweep", "--vary", "pitch=6:8:1deg", "--set", "pitch=6deg"), "is varied too"),
        (("sweep", "--vary", "pitch=6:8:1deg", "--set", "thrust=0.1,0.2N"), "vary it with --vary"),
        (("sweep", "--vary", "pitch=6deg", "--set", "speed=5000rpm", "--plot", "beauty"), "is not a result"),
        (("rank", "--set", "pitch=6deg"), "a ranking varies pitch and airfoil"),
        (("compare", "naca0012-r60-c20", "nothing.csv"), "cannot be read"),
        (("hover", "--pitch", "12", "--rpm", "5000", "--section", "guessed"), "add --band"),
        (
            ("hover", "--pitch", "12", "--rpm", "5000", "--family", "apc"),
            "add --band",
        ),
        (("export", "naca0012-r60-c20", "x.stl", "--whole", "--hub", "80"), "is not inside a rotor of 60 mm"),
        (("export", "naca0012-r60-c20", "x.stl", "--pitch", "400"), "is out of range"),
    ],
)
def test_faults_are_one_clear_line(arguments: tuple[str, ...], message: str) -> None:
    assert message in fault(*arguments)


def test_out_folder_that_cannot_be_written_is_named(tmp_path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("x", encoding="utf-8")
    result = runner.invoke(app, ["show", "--out", str(blocked)])
    assert isinstance(result.exception, InputError)
    assert str(blocked) in str(result.exception)


def test_optimise_tells_what_each_change_brought_and_writes_the_rotor(tmp_path) -> None:
    file = tmp_path / "better.toml"
    arguments = ("optimise", "--free", "taper,gear", "--generations", "5", "--limit", "thickness_mm>=0.8")
    text = output(*arguments, "--out", str(file))
    assert "start" in text
    assert "taper" in text
    answer = json.loads(output(*arguments, "--json"))
    assert [s["parameter"] for s in answer["steps"]].count("gear") == 1
    assert answer["results"]["least_thickness_m"] >= 0.8e-3 * (1 - 1e-6)
    shown = json.loads(output("show", str(file), "--json"))
    assert shown["blade_area_m2"] == pytest.approx(0.02 * 0.85 * 0.06, rel=1e-9)


def test_forward_prints_a_band_over_the_flap_frequency(tmp_path) -> None:
    told = ("forward", "walkera-5g6", "--pitch", "13", "--rpm", "3600", "--speed", "0:4:4")
    text = output(*told, "--out", str(tmp_path))
    assert "band of the flap frequency" in text
    assert (tmp_path / "forward.png").stat().st_size > 10_000
    assert (tmp_path / "disc.png").stat().st_size > 10_000
    points = json.loads(output(*told, "--flap-frequency-ratio", "1,1.6", "--json"))["points"]
    assert [p["flap_frequency_ratio"] for p in points] == [1.0, 1.0, 1.6, 1.6]
    assert points[3]["cyclic"]["moment_Nm_rad"] > 0.05
