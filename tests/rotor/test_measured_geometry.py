"""Effective pitch and measured geometry: priors, caliper and protractor tables, tunnel points of a fit."""

import io
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.cli.aero import measure as measure_command
from mufly.errors import InputError
from mufly.rotor import (
    RotorMeasurements,
    add_zero_load_points,
    estimate_pitch_offset_prior,
    fit_rotor,
    format_rotor_toml,
    load_rotor,
    make_rotor,
    predict_interval,
    prepare_blading,
    replace_rotor,
    solve_rotor_batch,
)
from mufly.rotor.blades.measured_geometry import GeometryReadings, rotor_from_readings

DEG = math.radians(1.0)
X = np.array([0.25, 0.4, 0.55, 0.7, 0.85, 0.95])
TRUE_ANGLE = np.radians([30.0, 22.0, 17.0, 13.5, 11.5, 10.5])
CHORD = np.array([11.0, 13.0, 12.5, 11.0, 9.0, 7.0]) * 1e-3
RADIUS = 0.06


def measured(angle, tip_height=None, **how):
    readings = GeometryReadings(X * RADIUS, CHORD, angle, tip_height)
    return rotor_from_readings(readings, radius_m=RADIUS, blades=2, name="blade", **how)


def test_stated_pitch_and_photograph_are_weighted_by_their_variances():
    rotor = make_rotor(name="r", radius_m=0.06, chord_m=0.01, twist_rad=15.0 * DEG)
    plain = estimate_pitch_offset_prior(rotor)
    assert (plain.offset_mean_rad, plain.offset_std_rad) == (0.0, pytest.approx(0.5 * DEG))
    pitch = 1.5 * math.pi * 0.06 * math.tan(11.1 * DEG)
    photo = replace_rotor(rotor, {"blade.geometry": "photograph", "nominal_pitch": pitch})
    prior = estimate_pitch_offset_prior(photo)
    assert prior.offset_mean_rad == pytest.approx(-3.9 * DEG * 4.0 / 13.0)
    assert prior.offset_std_rad == pytest.approx(DEG / math.sqrt(1 / 4 + 1 / 9))
    near, far = prepare_blading(photo).twist_rad[0], prepare_blading(rotor).twist_rad[0]
    np.testing.assert_allclose(near - far, prior.offset_mean_rad)
    spread = [
        predict_interval(r, pitch_rad=0.0, speed_rad_s=500.0).thrust_relative_std_by_cause["pitch"][0]
        for r in (rotor, photo)
    ]
    assert spread[1] > 2.0 * spread[0]


def test_calipers_and_protractor_find_the_angles_and_state_honest_errors():
    rng = np.random.default_rng(41)
    off, stated = [], []
    for _ in range(200):
        common, single = rng.normal(0.0, DEG / math.sqrt(2.0), 2)[0], rng.normal(0.0, DEG / math.sqrt(2.0), X.size)
        height = CHORD[-1] * math.sin(TRUE_ANGLE[-1] + rng.normal(0.0, 0.5 * DEG)) + rng.normal(0.0, 2e-4)
        found = measured(TRUE_ANGLE + common + single, height)
        off.append(np.mean(np.interp(X, found.rotor.blade.r_over_R.value, found.rotor.blade.twist.value) - TRUE_ANGLE))
        stated.append(found.common_pitch_std_rad)
    assert np.std(off) == pytest.approx(np.mean(stated), rel=0.2)
    assert abs(np.mean(off)) < 0.2 * np.mean(stated)


def test_readings_of_two_blades_are_averaged_and_their_scatter_counts():
    two = GeometryReadings(
        np.tile(X * RADIUS, 2), np.tile(CHORD, 2), np.concatenate((TRUE_ANGLE + 3 * DEG, TRUE_ANGLE - 3 * DEG))
    )
    found = rotor_from_readings(two, radius_m=RADIUS, blades=2, name="two")
    np.testing.assert_allclose(found.rotor.blade.twist.value[:-1], TRUE_ANGLE)
    assert found.common_pitch_std_rad > 2.0 * DEG
    assert "scatter by 4.24 degrees" in found.notes[0]


@pytest.mark.parametrize("k", [1, 4])
def test_a_misread_angle_and_a_wrong_height_are_noted(k):
    wrong = TRUE_ANGLE.copy()
    wrong[k] += 20.0 * DEG
    assert any(f"at {X[k]:.2f} R" in note for note in measured(wrong).notes)
    assert any("disagree" in note for note in measured(TRUE_ANGLE, 6e-3).notes)
    with pytest.raises(InputError, match="tip height"):
        measured(TRUE_ANGLE, 8e-3)


def test_a_misread_value_of_one_of_two_blades_is_named():
    noise = np.random.default_rng(41).normal(0.0, 0.4 * DEG, 2 * X.size)
    angle, chord = np.tile(TRUE_ANGLE, 2) + noise, np.tile(CHORD, 2)

    def notes_of(chord, angle, blades=2):
        readings = GeometryReadings(np.tile(X * RADIUS, 2), chord, angle)
        found = rotor_from_readings(readings, radius_m=RADIUS, blades=blades, name="two")
        return [note for note in found.notes if "check it" in note]

    assert notes_of(chord, angle) == []
    wrong, narrow = angle.copy(), chord.copy()
    wrong[8] += 20.0 * DEG
    narrow[3] = 1.1e-3
    (angle_note,) = notes_of(chord, wrong)
    assert angle_note.startswith(f"the angle of blade 2 at 0.55 R, {wrong[8] / DEG:.4g} degrees, is +")
    (chord_note,) = notes_of(narrow, angle)
    assert chord_note.startswith("the chord of blade 1 at 0.70 R, 1.1 mm, is -")
    wrong[4] -= 8.0 * DEG
    assert [note.partition(" R,")[0] for note in notes_of(narrow, wrong, blades=3)] == [
        "the angle of reading 2 at 0.55", "the angle of reading 1 at 0.85", "the chord of reading 1 at 0.70",
    ]  # fmt: skip


def test_measure_command_writes_a_rotor_that_loads(tmp_path):
    def run(*words):
        done = CliRunner().invoke(app, ["rotor", "measure", "--diameter", "120mm", *map(str, words)])
        assert done.exit_code == 0, done.exception
        return done.stdout

    table, out = tmp_path / "readings.csv", tmp_path / "mine.toml"
    run("--template", table)
    lines = table.read_text().splitlines()
    rows = [line for line in lines if line[0].isdigit()]
    filled = [
        f"{row.split(',')[0]},{1e3 * c:.2f},{a / DEG:.2f},{120 * c:.2f}"
        for row, c, a in zip(rows, CHORD, TRUE_ANGLE, strict=True)
    ]
    table.write_text("\n".join([*lines[: -len(rows)], *filled[:-1], rows[-1]]))  # the last row is left empty
    answer = json.loads(run(table, "--stated-pitch", "70mm", "--out", out, "--json"))
    rotor = load_rotor(out)
    assert rotor.blade.geometry == "caliper"
    assert rotor.stated_thickness(0.7) == pytest.approx(0.12, rel=1e-3)
    assert float(rotor.nominal_pitch) == pytest.approx(0.07)
    assert estimate_pitch_offset_prior(rotor).offset_std_rad == pytest.approx(answer["effective_pitch_std_rad"])
    assert rotor.twist_rad(0.7) == pytest.approx(TRUE_ANGLE[3], abs=0.05 * DEG)
    done = CliRunner().invoke(app, ["rotor", "measure", str(table)])
    assert isinstance(done.exception, InputError)
    assert "--diameter" in str(done.exception)


def test_a_mistyped_reading_at_the_terminal_is_asked_for_again(monkeypatch, capsys):
    station = ["11", "33", ""]
    terminal = io.StringIO("\n".join(["abc", "-3", *station, *station * 5, "90", "1.2", "left"]))
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr("sys.stdin", terminal)
    r, chord, angle, thickness, height = measure_command._ask_readings(RADIUS, None)
    assert chord == pytest.approx(6 * [0.011])
    assert np.isnan(thickness).all()
    assert (r[0], angle[0], height) == pytest.approx((0.25 * RADIUS, 33.0 * DEG, 1.2e-3))
    said = "".join(capsys.readouterr())
    assert said.count("Error") == 3
    assert "'abc' is not a number" in said
    assert terminal.read() == "left"


@pytest.fixture(scope="module")
def turned():
    """A rotor whose blades stand 2 degrees below its file, and what a bench and a tunnel measure on it."""
    rotor = replace_rotor(
        make_rotor(name="t", radius_m=0.06, chord_m=0.015, twist_rad=14.0 * DEG, airfoils="naca4412"),
        {"blade.geometry": "photograph"},
    )
    blading = prepare_blading(rotor)
    speed = np.array([450.0, 600.0])
    out = solve_rotor_batch(blading, pitch_rad=-2.0 * DEG, speed_rad_s=speed)
    climb = np.linspace(0.0, 14.0, 60)
    tunnel = solve_rotor_batch(blading, pitch_rad=-2.0 * DEG, speed_rad_s=520.0, climb_m_s=climb)
    ratio = [float(np.interp(0.0, -v, climb)) * math.pi / (520.0 * 0.06) for v in (tunnel.thrust_N, tunnel.torque_Nm)]
    return rotor, RotorMeasurements(np.zeros(2), speed, out.thrust_N, out.torque_Nm, "bench"), ratio


def test_an_advance_ratio_without_thrust_finds_the_pitch(turned):
    rotor, bench, (zero_thrust, zero_torque) = turned
    without = fit_rotor(rotor, bench, section="known")
    points = add_zero_load_points(bench, 0.06, zero_thrust=zero_thrust, zero_torque=zero_torque)
    assert points.thrust_N[2] == 0.0
    assert np.isnan(points.torque_Nm[2])
    found = fit_rotor(rotor, points, section="known")
    assert found.std[0] < 0.7 * without.std[0]
    assert found.change[0] == pytest.approx(-2.0 * DEG, abs=0.5 * DEG)
    alone = add_zero_load_points(bench, 0.06, zero_thrust=zero_thrust).select_points(np.array([2]))
    assert fit_rotor(rotor, alone, section="known").change[0] == pytest.approx(-2.0 * DEG, abs=0.5 * DEG)
    with pytest.raises(InputError, match="zero thrust"):
        add_zero_load_points(bench, 0.06, zero_thrust=-0.2)


def test_copies_of_a_point_count_as_one(turned):
    rotor, bench, _ = turned
    one = bench.select_points(np.array([0]))
    four = bench.select_points(np.zeros(4, dtype=np.intp))
    first, again = (fit_rotor(rotor, m, section="known") for m in (one, four))
    np.testing.assert_allclose(again.std, first.std, rtol=0.05)
    np.testing.assert_allclose(again.change, first.change, atol=0.05 * first.std.max())


def test_copies_neither_widen_an_interval_nor_check_themselves(turned):
    rotor, bench, _ = turned
    one, many = bench.select_points(np.array([0])), bench.select_points(np.zeros(8, dtype=np.intp))
    at = {"pitch_rad": 0.0, "speed_rad_s": 600.0}
    widths = []
    for points in (one, many):
        found = fit_rotor(rotor, points, section="known")
        assert "one point alone" in found.held_out_note
        interval = predict_interval(found.rotor, **at)
        widths.append(interval.torque_high_Nm - interval.torque_low_Nm)
    assert widths[1] == pytest.approx(widths[0], rel=1e-6)


def test_a_windmilling_speed_beside_one_hover_point_is_used(turned):
    rotor, bench, (_, zero_torque) = turned
    one = bench.select_points(np.array([0]))
    found = fit_rotor(rotor, add_zero_load_points(one, 0.06, zero_torque=zero_torque), section="known")
    assert found.change[0] == pytest.approx(-2.0 * DEG, abs=0.5 * DEG)
    assert found.std[0] < fit_rotor(rotor, one, section="known").std[0]
    assert np.isfinite(found.held_out[1])  # the torque of the windmill, predicted by the fit to the hover point


def test_the_family_adds_to_the_doubt_of_the_angle(tmp_path):
    rotor = make_rotor(name="f", radius_m=0.06, chord_m=0.015, twist_rad=14.0 * DEG, airfoils="naca4412")
    toy = replace_rotor(rotor, {"blade.family": "hobby"})
    assert estimate_pitch_offset_prior(rotor).offset_std_rad == pytest.approx(0.5 * DEG)
    assert estimate_pitch_offset_prior(toy).offset_std_rad == pytest.approx(math.hypot(0.5, 1.5) * DEG)
    measured = replace_rotor(toy, {"blade.pitch_std": 0.2 * DEG})
    assert estimate_pitch_offset_prior(measured).offset_std_rad == pytest.approx(0.2 * DEG)
    file = tmp_path / "toy.toml"
    file.write_text(format_rotor_toml(toy))
    again = load_rotor(str(file))
    assert again.blade.family == "hobby"
    at = {"pitch_rad": 0.0, "speed_rad_s": 600.0}
    by_file, by_option = predict_interval(again, **at), predict_interval(rotor, family="hobby", **at)
    assert by_file.thrust_high_N == pytest.approx(by_option.thrust_high_N)
    assert by_file.thrust_high_N > predict_interval(rotor, **at).thrust_high_N
    bench = RotorMeasurements(np.zeros(1), np.array([600.0]), by_file.thrust_N, by_file.torque_Nm, "bench")
    toy_fit, fit = (fit_rotor(r, bench, section="known") for r in (toy, rotor))
    assert toy_fit.prior_std[0] > 1.5 * fit.prior_std[0]
