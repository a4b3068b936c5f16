"""Measurement files, comparison, calibration, intervals; and the measurements themselves where they are at hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from mufly.bench import read_measurements
from mufly.cli import app
from mufly.errors import InputError, MuflyError
from mufly.rotor import (
    InputUncertainty,
    RotorMeasurements,
    calibrate_blading,
    compare_measurements,
    fit_rotor,
    load_rotor,
    predict_interval,
    prepare_blading,
    solve_for_thrust,
    solve_rotor,
    solve_rotor_batch,
)
from mufly.rotor.measured.uncertainty import THRUST_TORQUE_ERROR_SCALES, interval_quantile
from mufly.study.benchmark import load_cases, parse_code, score_codes, tabulate_by_group

ROOT = Path(__file__).resolve().parents[2]
TEXT = "# a bench\npitch_deg,speed_rpm,thrust_N,torque_Nm\n12,5000,0.15,0.0015\n16, 7000, 0.42,\n"


@pytest.fixture(scope="module")
def case():
    return prepare_blading(load_rotor("naca0012-r60-c20"))


def made(case, pitch_deg=(12.0, 16.0), rpm=(5000.0, 7000.0), lift=1.0, drag=1.0) -> RotorMeasurements:
    scaled = replace(case, corrections=replace(case.corrections, lift_factor=lift, drag_factor=drag))
    pitch, speed = np.radians(pitch_deg), np.array(rpm) * math.pi / 30
    out = solve_rotor_batch(scaled, pitch_rad=pitch, speed_rad_s=speed)
    return RotorMeasurements(pitch, speed, out.thrust_N, out.torque_Nm, "made up")


def test_a_file_is_read(tmp_path, case):
    path = tmp_path / "bench.csv"
    path.write_text(TEXT)
    bench = read_measurements(path)
    assert_allclose(bench.pitch_rad, np.radians([12, 16]))
    assert_allclose(bench.speed_rad_s * 30 / math.pi, [5000, 7000])
    assert np.isnan(bench.torque_Nm[1])
    out = compare_measurements(case, bench)
    assert_allclose(out.thrust_error, out.thrust_N / [0.15, 0.42] - 1)
    assert out.thrust_N[0] == solve_rotor(case, pitch_rad=bench.pitch_rad[0], speed_rad_s=bench.speed_rad_s[0]).thrust_N
    assert "not calibrated" in str(out)
    assert "mean absolute error" in str(out)
    assert len(str(out).splitlines()) == 5


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffpitch_deg,speed_rpm,thrust_N,torque_Nm\n12,5000,0.151,0.0015\n",  # as Excel begins a file
        "pitch_deg;speed_rpm;thrust_N;torque_Nm\n12;5000;0,151;0,0015\n",  # as it writes one in most of Europe
        "  RPM   pitch_deg  thrust_N   torque_mNm\n 5000   12   0.151  1.5\n",  # as propeller data sites set theirs
    ],
)
def test_files_from_elsewhere(tmp_path, text):
    path = tmp_path / "bench.csv"
    path.write_text(text)
    bench = read_measurements(path)
    assert_allclose(bench.pitch_rad, np.radians([12]))
    assert_allclose((bench.thrust_N[0], bench.torque_Nm[0]), (0.151, 0.0015))


def test_axial_flight_is_read_and_compared(tmp_path, case):
    path = tmp_path / "tunnel.csv"
    path.write_text("pitch_deg,speed_rpm,thrust_N,J\n12,5000,0.15,0.2\n12,5000,0.05,0.4\n12,5000,0.0,0.6\n")
    bench = read_measurements(path, diameter_m=0.12)
    assert_allclose(bench.climb_m_s, 0.12 * 5000 / 60 * np.array([0.2, 0.4, 0.6]))
    out = compare_measurements(case, bench)
    wanted = solve_rotor(case, pitch_rad=bench.pitch_rad[1], speed_rad_s=bench.speed_rad_s[1], climb_m_s=4.0).thrust_N
    assert out.thrust_N[1] == wanted
    assert "axial (m/s)" in str(out)
    with pytest.raises(InputError, match="nowhere above 0"):
        fit_rotor(case.rotors[0], replace(bench, thrust_N=-bench.thrust_N))
    with pytest.raises(InputError, match="J: needs the rotor's diameter"):
        read_measurements(path)


def test_a_rotor_will_do_where_a_blading_does(case):
    rotor = load_rotor("naca0012-r60-c20")
    kw = {"pitch_rad": 0.2, "speed_rad_s": 500.0}
    assert (
        solve_rotor(rotor, **kw).thrust_N == solve_rotor(case, **kw).thrust_N == solve_rotor_batch(rotor, **kw).thrust_N
    )
    assert (
        solve_for_thrust(rotor, thrust_N=0.3, pitch_rad=0.2).speed_rad_s
        == solve_for_thrust(case, thrust_N=0.3, pitch_rad=0.2).speed_rad_s
    )
    assert compare_measurements(rotor, made(case)).mean_thrust_error < 1e-12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pitch_deg,speed_rpm\n1,2\n", "thrust: is not among the columns"),
        ("pitch_deg,speed_rpm,thrust_N\n", "contains no measurements"),
        ("pitch_deg,speed_rpm,thrust_N\n1,2,x\n", "line 2, thrust_N: 'x' is not a number"),
        ("pitch_deg,speed_rpm,thrust_N\n1,nan,3\n", "line 2, speed_rpm: is nan"),
        ("pitch_deg,speed_rpm,thrust_N\n400,2,3\n", "line 2, pitch_deg: is 400 degrees; it must lie within 90 degrees"),
        ("speed_rpm,thrust_N,torque_Nm\n5000,3,1\n5000,3,-1\n", "line 3, torque_Nm: is -1 N m; it must be above 0"),
        ("pitch_deg,speed_rpm,thrust_N\n1,0,3\n", "line 2, speed_rpm: is 0 rpm; it must be above 0"),
    ],
)
def test_faults_in_a_file_are_one_line(tmp_path, text, message):
    path = tmp_path / "bench.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_measurements(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_measurements(tmp_path / "none.csv")


def test_calibration_finds_the_factors_that_made_the_data(case):
    found = calibrate_blading(case, made(case, lift=0.9, drag=1.4))
    assert_allclose(found.corrections.lift_factor, 0.9, rtol=1e-5)
    assert_allclose(found.corrections.drag_factor, 1.4, rtol=1e-4)
    out = compare_measurements(found, made(case, lift=0.9, drag=1.4))
    assert out.calibrated
    assert "calibrated on measurements" in str(out)
    assert out.mean_thrust_error < 1e-4


def test_calibration_without_torque_scales_lift_only(case):
    bench = made(case, lift=0.9)
    found = calibrate_blading(case, replace(bench, torque_Nm=np.full(2, np.nan)), point=1)
    assert_allclose(found.corrections.lift_factor, 0.9, rtol=1e-5)
    assert found.corrections.drag_factor == 1.0


def test_calibration_that_cannot_be_says_so(case):
    bench = made(case)
    with pytest.raises(MuflyError, match="check the rotor and the units"):
        calibrate_blading(case, replace(bench, thrust_N=1000 * bench.thrust_N))


def test_interval_holds_the_prediction_and_grows_with_doubt():
    rotor = load_rotor("naca0012-r60-c20")
    kw = {"pitch_rad": np.radians([12.0, 16.0]), "speed_rad_s": 600.0}
    known, guess = predict_interval(rotor, **kw), predict_interval(rotor, section="guessed", **kw)
    assert np.all((known.thrust_low_N < known.thrust_N) & (known.thrust_N < known.thrust_high_N))
    assert np.all(guess.thrust_high_N > known.thrust_high_N)
    assert np.all(guess.torque_high_Nm - guess.torque_low_Nm > known.torque_high_Nm - known.torque_low_Nm)
    narrow = predict_interval(rotor, level=0.5, **kw)
    assert_allclose(
        (narrow.thrust_high_N - narrow.thrust_N) / (known.thrust_high_N - known.thrust_N), 0.7649 / 2.3534, rtol=1e-4
    )
    total = np.sqrt(sum(np.square(v) for v in known.thrust_relative_std_by_cause.values()))
    assert_allclose(
        THRUST_TORQUE_ERROR_SCALES[0] * interval_quantile(0.9) * total, known.thrust_high_N / known.thrust_N - 1
    )
    sure = InputUncertainty(
        n_crit_cases=(), lift=0, drag=0, camber=0, thickness=0, pitch_rad=0, method_thrust=0, method_torque=0
    )
    assert_allclose(predict_interval(rotor, doubt=sure, **kw).thrust_high_N, known.thrust_N)
    with pytest.raises(InputError, match="its sections have no measurement"):
        predict_interval(rotor, section="measured", **kw)
    with pytest.raises(InputError, match="family"):
        predict_interval(rotor, section="guessed", family="paper", **kw)
    with pytest.raises(InputError, match="band"):
        predict_interval(rotor, level=0.7, **kw)


DATA = ROOT.parent / "shared" / "data" / "aero"


@pytest.fixture(scope="module")
def measured():
    if not DATA.is_dir():
        pytest.skip("the measurements (../shared/data/aero, outside the project) are not here")
    return {case.name: case for case in load_cases(DATA)[0]}


def test_table_3_2_untuned_within_10_and_15_percent(measured):
    thesis = measured["naca0012-r60-c20"]
    out = compare_measurements(prepare_blading(thesis.rotor), thesis.measured)
    assert np.all(np.abs(out.thrust_error) < 0.10)
    assert np.all(np.abs(out.torque_error) < 0.15)


def test_table_3_2_calibrated_on_its_first_point_within_5_and_10_percent(measured):
    thesis = measured["naca0012-r60-c20"]
    out = compare_measurements(calibrate_blading(prepare_blading(thesis.rotor), thesis.measured), thesis.measured)
    assert np.all(np.abs(out.thrust_error) < 0.05)
    assert np.all(np.abs(out.torque_error) < 0.10)


def test_propellers_within_12_and_15_percent_on_average(measured):
    cases = [case for case in measured.values() if case.group == "UIUC micro"]
    assert len(cases) == 17
    (row,) = tabulate_by_group(score_codes(cases, [parse_code("bemt")]))
    assert row.thrust < 0.12
    assert row.torque < 0.15


def test_other_names_of_columns_and_coefficients(tmp_path):
    """UIUC's CT and CP (revolutions a second, diameter), and power in place of torque."""
    path = tmp_path / "bench.csv"
    path.write_text("RPM,T(N),P(W)\n6000,0.5,3.0\n")
    bench = read_measurements(path)
    assert bench.pitch_rad[0] == 0.0
    assert_allclose(bench.torque_Nm, 3.0 / (200 * math.pi))
    path.write_text("rpm,CT,CP\n6000,0.1,0.05\n")
    bench = read_measurements(path, diameter_m=0.2, density_kg_m3=1.2)
    assert_allclose(bench.thrust_N, 0.1 * 1.2 * 100**2 * 0.2**4)
    assert_allclose(bench.torque_Nm * bench.speed_rad_s, 0.05 * 1.2 * 100**3 * 0.2**5)
    with pytest.raises(InputError, match="is a coefficient"):
        read_measurements(path)


def bench_of(case, rpm=(4000.0, 5000.0, 6000.0)):
    made_ = made(case, (14.0,) * len(rpm), rpm)
    return made_.speed_rad_s * 30 / math.pi, made_.thrust_N, made_.torque_Nm


def text_of(heads, *columns):
    return heads + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)) + "\n"


@pytest.mark.parametrize(
    ("heads", "thrust", "torque", "words"),
    [
        ("RPM,Thrust (g),Torque (in-lbf)", 1 / 9.80665e-3, 1 / 0.112984829, ""),
        ("RPM,T_gf,torque_mNm", 1 / 9.80665e-3, 1e3, ""),
        ("RPM;Thrust (ozf);Torque (kg-cm)", 1 / 0.278013851, 1 / 0.0980665, ""),
        ("RPM,Thrust (lbf),Torque (ozf-in)", 1 / 4.4482216152605, 1 / 7.0615518e-3, ""),
        ("RPM,thrust,torque_Nm", 1.0, 1.0, "thrust: no unit is written, taken as N (c_T near"),
        ("RPM,thrust,torque_Nm", 1 / 9.80665, 1.0, "thrust: no unit is written, taken as kgf"),
        ("RPM,Thrust,torque", 1 / 9.80665e-3, 1e3, "Thrust: no unit is written, taken as gf"),
        ("RPM,Thrust (N),Torque (N·m)", -1.0, 1.0, "turned round: the sign of the load cell"),
        ("RPM,Thrust (N),Torque (N·m)", 1.0, -1.0, "turned round: the sign of the sense of rotation"),
    ],
)
def test_units_and_signs_of_loads(tmp_path, case, heads, thrust, torque, words):
    speed, t, q = bench_of(case)
    text = text_of(heads, speed, thrust * t, torque * q)
    (tmp_path / "b.csv").write_text(text.replace(",", ";") if ";" in heads else text, encoding="utf-8")
    bench = read_measurements(tmp_path / "b.csv", diameter_m=0.12, pitch_rad=math.radians(14))
    assert_allclose(bench.thrust_N, t, rtol=1e-6)
    assert_allclose(bench.torque_Nm, q, rtol=1e-6)
    assert any(words in n for n in bench.notes) or not words


@pytest.mark.parametrize(
    ("unit", "newton_metres", "suits"),
    [
        ("ozf in", 7.0615518e-3, "N cm or ozf in"),
        ("N cm", 1e-2, "N cm or ozf in"),
        ("lbf in", 0.112984829, "kgf cm or lbf in"),
        ("kgf cm", 0.0980665, "kgf cm or lbf in"),
        ("gf cm", 9.80665e-5, ""),
        ("mN m", 1e-3, ""),
        ("N m", 1.0, ""),
    ],
)
def test_a_torque_without_unit_is_read_if_one_unit_alone_suits(tmp_path, case, unit, newton_metres, suits):
    speed, t, q = bench_of(case)
    text = text_of("RPM,thrust_N,torque", speed, t, q / newton_metres)
    (tmp_path / "b.csv").write_text(text)
    if suits:
        with pytest.raises(InputError, match=rf"torque: has no unit, and its size suits {suits}; name its unit"):
            read_measurements(tmp_path / "b.csv", diameter_m=0.12)
        (tmp_path / "b.csv").write_text(text.replace("torque", f"torque ({unit})"))  # as the error suggests
    bench = read_measurements(tmp_path / "b.csv", diameter_m=0.12)
    assert_allclose(bench.torque_Nm, q, rtol=1e-6)
    assert any(f"taken as {unit}" in note for note in bench.notes) != bool(suits)


@pytest.mark.parametrize(
    ("heads", "scale", "message"),
    [
        ("RPM,thrust", 1.0, "thrust: has no unit; name it with its unit, as thrust_N"),
        ("speed,thrust_N", 1.0, "speed: has no unit; name it with its unit, as speed_rpm"),
        ("RPM,Thrust (bananas)", 1.0, r"Thrust \(bananas\): 'bananas' is not a known unit of thrust"),
    ],
)
def test_loads_whose_unit_nothing_tells_are_asked_for(tmp_path, case, heads, scale, message):
    speed, t, _ = bench_of(case)
    (tmp_path / "b.csv").write_text(text_of(heads, speed, scale * t))
    with pytest.raises(InputError, match=message):
        read_measurements(tmp_path / "b.csv")


def test_a_speed_without_unit_is_decided_by_the_lift(tmp_path, case):
    speed, t, _ = bench_of(case)
    for factor, unit in ((1.0, "rpm"), (math.pi / 30, "rad/s")):
        (tmp_path / "b.csv").write_text(text_of("speed,thrust_N", factor * speed, t))
        bench = read_measurements(tmp_path / "b.csv", diameter_m=0.12)
        assert_allclose(bench.speed_rad_s, speed * math.pi / 30)
        assert any(f"speed has no unit: taken as {unit}" in n for n in bench.notes)


def test_electrical_power_is_no_torque(tmp_path, case):
    """As in motor makers' tables: throttle, voltage, current and their product beside thrust in grams."""
    speed, t, _ = bench_of(case)
    current = np.array([1.0, 2.0, 3.5])
    heads = "Throttle,Voltage(V),Thrust(g),Current(A),RPM,Power(W)"
    columns = ([50, 65, 80], np.full(3, 11.1), t / 9.80665e-3, current, speed, 11.1 * current)
    (tmp_path / "b.csv").write_text(text_of(heads, *columns).replace("50,", "50%,", 1))
    bench = read_measurements(tmp_path / "b.csv", diameter_m=0.12)
    assert_allclose(bench.thrust_N, t, rtol=1e-6)
    assert np.isnan(bench.torque_Nm).all()
    assert any("Power(W) is the product of voltage and current" in n for n in bench.notes)


def test_the_command_tells_what_was_taken_for_granted(tmp_path, case):
    speed, t, q = bench_of(case)
    (tmp_path / "b.csv").write_text(text_of("RPM,thrust,torque_Nm", speed, t, q))
    run = ["rotor", "compare", "naca0012-r60-c20", str(tmp_path / "b.csv"), "--pitch", "14"]
    told = CliRunner().invoke(app, run)
    assert told.exit_code == 0
    assert "note: thrust: no unit is written, taken as N (c_T near" in told.output


def test_measured_values_inside_the_interval_are_counted(tmp_path, case):
    bench = tmp_path / "bench.csv"
    points = solve_rotor_batch(case, pitch_rad=0.21, speed_rad_s=np.array([500.0, 600.0]))
    thrust = points.thrust_N * [1.0, 1.6]
    rows = [f"{math.degrees(0.21)},{w * 30 / math.pi},{t}" for w, t in zip((500, 600), thrust, strict=True)]
    bench.write_text("pitch_deg,speed_rpm,thrust_N\n" + "\n".join(rows) + "\n")
    arguments = ("rotor", "compare", case.rotors[0].name, str(bench), "--band", "0.9")
    text, answer = (CliRunner().invoke(app, [*arguments, *more]) for more in ((), ("--json",)))
    assert "thrust: 1 of 2 measured values inside the 90% interval" in text.stdout
    assert "torque:" not in text.stdout
    found = json.loads(answer.stdout)
    assert found["inside_band"]["thrust"] == [1, 2]
    low, high = found["band"][1]["thrust_N"]
    assert low < points.thrust_N[1] < high < thrust[1]
    refused = CliRunner().invoke(app, [*arguments, "--calibrate", "1"])
    assert refused.exit_code == 1
    assert "leave out --calibrate" in refused.output + str(refused.exception)
