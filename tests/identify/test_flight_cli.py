"""``mufly identify flight`` and ``demo`` as a user runs them."""

import json

import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError
from mufly.identify.flight.identification_demo import fly_demo_flights, run_identification_demo
from mufly.identify.flight_record import record_to_dataset
from mufly.logs import write_log
from mufly.vehicle import load_vehicle

OPTIONS = ["--part", "roll-pitch", "--delay", "25", "--free", "l_up,Tf_up"]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    fit, held = fly_demo_flights(load_vehicle("mufly-1.1"), seed=1, seconds=5.0)
    for r in (*fit, *held):
        write_log(record_to_dataset(r), folder / f"{r.name}.mcap")
    return folder


def run(*arguments):
    return CliRunner().invoke(app, ["identify", *map(str, arguments)])


def test_flight_writes_vehicle_report_and_numbers(logs, tmp_path):
    out, report = tmp_path / "new.toml", tmp_path / "report"
    result = run(
        "flight", logs / "demo-roll.mcap", "--hold-out", logs / "demo-mixed.mcap", *OPTIONS, "--out", out,
        "--report", report, "--json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["converged"]
    assert [r["role"] for r in found["records"]] == ["fit", "held out"]
    new = load_vehicle(out)
    assert float(new.stabiliser_bar.linkage) == pytest.approx(0.48, rel=0.08)
    assert "demo-roll.mcap" in new.stabiliser_bar.linkage.note
    assert (report / "report.html").stat().st_size > 10_000
    assert not list(tmp_path.glob("*checkpoint*"))


def test_without_a_held_out_log_the_end_of_the_record_is_held_out(logs):
    result = run("flight", logs / "demo-roll.mcap", *OPTIONS)
    assert result.exit_code == 0, result.output
    assert "held out" in result.output
    assert "Converged" in result.output


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["--free", "l_upp"], "did you mean 'l_up'"),
        (["--part", "roll"], "use one of: both"),
        (["--method", "simplex"], "use one of: lm, cma"),
        (["--voltage", "high"], "is not a number"),
        (["--outputs", "rotor"], "'rotor' is unknown"),
        (["--prefix", "seen"], "'seen' is unknown"),
        (["--delay", "-5"], "-5 ms is out of range"),
        (["--window", "0"], "0 s is not a length"),
        (["--out", "no-such-folder/new.toml"], "its folder does not exist"),
        (["--report", "/dev/null/report"], "cannot be created"),
        (["--hold-out-share", "2"], "is not a share"),
    ],
)
def test_bad_options_give_one_line(logs, changes, words):
    with pytest.raises(InputError, match=words):
        CliRunner().invoke(
            app,
            ["identify", "flight", str(logs / "demo-roll.mcap"), *OPTIONS, *changes],
            catch_exceptions=False,
        )


def test_degrees_in_a_csv_log_are_said(logs, tmp_path):
    fit, _ = fly_demo_flights(load_vehicle("mufly-1.1"), seed=1, seconds=5.0)
    data = record_to_dataset(fit[2])
    data["measured_attitude"] = data["measured_attitude"] * 57.29578
    data["measured_attitude"].attrs["units"] = "rad"
    path = tmp_path / "wrong.nc"
    write_log(data, path)
    with pytest.raises(InputError, match="degrees"):
        CliRunner().invoke(app, ["identify", "flight", str(path), *OPTIONS], catch_exceptions=False)


def test_demo_finds_the_truth_from_rotors_exchanged_and_says_so(monkeypatch):
    """Before: at twice the noise of yaw and r, inertias off by 2.5 and 0.6, "converged"; also from records at rest."""
    shown = []
    monkeypatch.setattr(
        "mufly.identify.run_identification_demo",
        lambda **given: shown.append(run_identification_demo(**given)) or shown[-1],
    )
    result = run("demo", "--seed", 300, "--moving", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    (demo,) = shown
    assert found["converged"]
    assert demo.fit.converged
    start = {p["symbol"]: p["start"] for p in found["parameters"]}
    assert len(start) == 12
    assert all(abs(p["start"] / p["truth"] - 1) == pytest.approx(0.5) for p in found["parameters"])
    assert start["Jdrive_up"] < 1.5 * start["Jdrive_dw"]
    assert "minima" not in found["message"]
    assert sum(p["inside"] for p in found["parameters"]) >= 9
    assert max(abs(p["estimate"] / p["truth"] - 1) for p in found["parameters"]) < 0.05
    assert found["held_out_error_over_noise_floor"] < 1.05
    assert demo.fit.records[-1].converged
    assert demo.fit.records[-1].doubt == ""


def test_the_flight_is_cut_out_of_a_log_with_stopped_motors(logs, tmp_path):
    fit, _ = fly_demo_flights(load_vehicle("mufly-1.1"), seed=1, seconds=5.0)
    roll = record_to_dataset(next(r for r in fit if "roll" in r.name))
    inputs = roll["motor_input"].values.copy()
    times = roll["time"].values
    inputs[times < times[0] + 1.0] = 0.0
    path = tmp_path / "standing.mcap"
    write_log(roll.assign(motor_input=(roll["motor_input"].dims, inputs)), path)
    whole = run("flight", path, *OPTIONS, "--as-is")
    assert "a motor is off in 20% of the record" in " ".join(whole.output.split())
    cut = run("flight", path, *OPTIONS, "--from", f"{times[0] + 1.0:.3f}", "--to", f"{times[-1]:.3f}", "--json")
    assert cut.exit_code == 0, cut.output
    found = json.loads(cut.stdout)
    assert found["converged"]
    assert "a motor is off" not in cut.output
    short = run("flight", path, *OPTIONS, "--from", f"{times[-1] - 0.1:.3f}")
    assert isinstance(short.exception, InputError)
    assert "between these times" in str(short.exception)
