"""Rotor coefficients from a bench: exact data, drift and calibration carried along, trends, pairs, measurements."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.bench import (
    BenchTable,
    compute_loads,
    fit_cell_calibration,
    predict_loads,
    read_bench_file,
    resolve_air_density,
)
from mufly.errors import InputError
from mufly.identify import fit_rotor_coefficients
from mufly.identify.fit_pictures import draw_rotor_coefficients
from mufly.identify.rotor_coefficients import assign_rotor_side, describe_rotor_interference
from mufly.rotor import load_rotor, prepare_blading, solve_rotor_batch
from mufly.vehicle import load_vehicle

C_T, C_Q, R, RHO = 0.0138, 0.0025, 0.0875, 1.2
DATA = Path(__file__).resolve().parents[2] / ".." / "shared" / "data" / "aero"
measured = pytest.mark.skipif(not DATA.exists(), reason="measured data are not at hand")
PAIR = {
    "speed_lower": "RPM", "thrust_lower": "T_A(N)", "torque_lower": "Q_A(Nm)", "speed_upper": "RPM_B(rpm)",
    "thrust_upper": "T_B(N)", "torque_upper": "Q_B(Nm)",
}  # fmt: skip


def table(columns, unitless=()):
    n = len(next(iter(columns.values())))
    return BenchTable("bench.csv", columns, {k: k for k in columns}, np.arange(2, 2 + n), unitless)


def single(rng=None, noise=0.0, exponent=0.0, speed=None):
    speed = np.linspace(150, 450, 20) if speed is None else speed
    unit = RHO * math.pi * R**4 * speed**2 * (speed / 300) ** exponent
    y = np.column_stack([C_T * unit, C_Q * R * unit])
    if rng is not None:
        y = y * (1 + noise * rng.standard_normal(y.shape))
    return {"speed": speed, "thrust": y[:, 0], "torque": y[:, 1]}


def fit(columns, **kw):
    (result,) = fit_rotor_coefficients(compute_loads(table(columns)), radius_m=R, density_kg_m3=RHO, **kw)
    return result


def test_exact_readings_give_the_exact_coefficients():
    result = fit(single())
    assert [e.symbol for e in result.estimates] == ["cT", "cQ"]
    assert_allclose([e.value for e in result.estimates], [C_T, C_Q], rtol=1e-12)
    assert not result.coaxial


def test_intervals_hold_the_truth():
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(100):
        result = fit(single(rng, 0.01))
        inside += sum(e.low <= t <= e.high for e, t in zip(result.estimates, (C_T, C_Q), strict=True))
    assert 0.90 <= inside / 200 <= 0.99


def test_a_trend_is_told_from_none():
    rng = np.random.default_rng(0)
    order = rng.permutation(20)
    speed = np.linspace(150, 450, 20)[order]
    false_alarms = sum(fit(single(rng, 0.01, speed=speed)).fits[0].trends[0].is_significant for _ in range(60))
    assert false_alarms <= 8
    result = fit(single(rng, 0.005, exponent=0.15, speed=speed))
    trend = result.fits[0].trends[0]
    assert trend.is_significant
    assert "is not constant" in trend.describe_trend()
    change, half = trend.relative_change()
    assert abs(change - (3**0.15 - 1)) < 2 * half
    assert trend.coefficient_at(300.0) == pytest.approx(C_T, rel=0.01)
    at = fit(single(rng, 0.005, exponent=0.15, speed=speed), at_speed_rad_s=450.0).find_estimate("cT")
    assert abs(at.value - C_T * 1.5**0.15) < 3 * at.std
    assert "constant within its error" in fit(single(rng, 0.01, speed=speed)).fits[0].trends[0].describe_trend()


def test_one_number_for_a_changing_coefficient_covers_the_change():
    result = fit(single(np.random.default_rng(1), 0.001, exponent=0.2))
    e = result.find_estimate("cT")
    assert e.low < C_T * (300 / 300) ** 0.2 < e.high
    assert e.std / e.value > 0.015
    assert "drift during the measurement would look the same" in result.fits[0].trends[0].describe_trend()


def test_an_offset_is_named_as_the_rival():
    columns = single(np.random.default_rng(4), 0.002)
    columns["thrust"] = columns["thrust"] + 0.03
    words = fit(columns).fits[0].trends[0].describe_trend()
    assert "an offset of the load cell of 0.0299" in words
    assert "read the zero of the load cell at rest" in words


def with_zeros(columns, drift, rng=None, noise=0.0):
    """Put three zero readings before, in the middle of and after the runs, on a drifting thrust cell."""
    n = columns["speed"].size
    at = [0] * 3 + [n // 2] * 3 + [n] * 3
    out = {k: np.insert(v, at, 0.0) for k, v in columns.items()}
    time = np.arange(n + 9.0)
    out["time"] = time
    out["thrust"] = out["thrust"] + drift(time) + (0 if rng is None else noise * rng.standard_normal(n + 9))
    return out


def test_a_drifting_zero_is_taken_off():
    rng = np.random.default_rng(5)
    columns = with_zeros(single(), lambda t: 0.05 + 0.004 * t, rng, 0.002)
    loads = compute_loads(table(columns))
    (result,) = fit_rotor_coefficients(loads, radius_m=R, density_kg_m3=RHO)
    e = result.find_estimate("cT")
    assert len(loads.turning_lines) == 20
    assert loads.zero_drifts["thrust"].rest_block_count == 3
    assert abs(e.value - C_T) < 3 * e.std
    assert e.value == pytest.approx(C_T, rel=0.01)
    assert any("followed as a straight line" in n for n in loads.notes)
    raw = fit({k: v[columns["speed"] > 0] for k, v in columns.items()}).find_estimate("cT")
    assert abs(raw.value - C_T) > 5 * abs(e.value - C_T)


def test_doubt_of_zero_and_calibration_matches_the_scatter():
    rng = np.random.default_rng(6)
    s = np.array([[2.0, 5.0], [0.01, 150.0]])
    weights = np.array([[f, m] for f in (0.0, 0.5, 1.0) for m in (0.0, 0.005, 0.01)])
    truth = single()
    true_loads = np.column_stack([truth["thrust"], truth["torque"]])
    found, stated, shares = [], [], []
    for _ in range(80):
        y = weights @ s.T + [0.1, -0.2] + rng.standard_normal((9, 2)) * [0.03, 0.03]
        cal = fit_cell_calibration(
            table(
                {
                    "thrust": weights[:, 0],
                    "torque": weights[:, 1],
                    "thrust_raw": y[:, 0],
                    "torque_raw": y[:, 1],
                }
            )
        )
        columns = {"speed": np.r_[0.0, 0.0, truth["speed"], 0.0, 0.0], "time": np.arange(24.0)}
        reading = np.pad(true_loads @ s.T, ((2, 2), (0, 0))) + np.array([0.3, 0.1])
        reading = reading + rng.standard_normal((24, 2)) * [0.005, 0.005]
        loads = compute_loads(table({**columns, "thrust_raw": reading[:, 0], "torque_raw": reading[:, 1]}), cal)
        (result,) = fit_rotor_coefficients(loads, radius_m=R, density_kg_m3=RHO)
        found.append([e.value for e in result.estimates])
        stated.append([e.std for e in result.estimates])
        shares.append(result.systematic_variance_fractions()["cT"])
    assert_allclose(np.mean(stated, axis=0), np.std(found, axis=0), rtol=0.3)
    assert_allclose(np.mean(found, axis=0), [C_T, C_Q], rtol=0.02)
    assert np.mean(shares) > 0.8


def test_doubt_of_air_and_radius_is_passed_on():
    e = fit(single(), density_std_kg_m3=0.012, radius_std_m=R * 1e-3).estimates
    assert e[0].std / e[0].value == pytest.approx(math.hypot(0.01, 4e-3), rel=1e-6)
    assert e[1].std / e[1].value == pytest.approx(math.hypot(0.01, 5e-3), rel=1e-6)


def pair(ratio):
    up = np.linspace(150, 400, 16)
    down = up * ratio
    unit = RHO * math.pi * R**4
    return {"speed_upper": up, "speed_lower": down, "thrust": unit * (0.0138 * up**2 + 0.0117 * down**2)}


def test_total_thrust_of_a_pair():
    result = fit(pair(1.0 + 0.3 * np.sin(np.arange(16))))
    assert_allclose([e.value for e in result.estimates], [0.0138, 0.0117], rtol=1e-9)
    assert [e.symbol for e in result.estimates] == ["cT_up", "cT_dw"]
    blind = fit(pair(1.18))
    assert all(math.isinf(e.std) for e in blind.estimates)
    assert "only a weighted sum is determined" in blind.undetermined[0]


def test_pitch_settings_are_kept_apart():
    columns = single()
    columns["pitch"] = np.radians(np.repeat([12.0, 16.0], 10))
    columns["thrust"] = columns["thrust"] * np.repeat([1.0, 1.5], 10)
    low, high = fit_rotor_coefficients(compute_loads(table(columns)), radius_m=R, density_kg_m3=RHO)
    assert math.degrees(high.stated_pitch_rad) == pytest.approx(16)
    assert high.find_estimate("cT").value == pytest.approx(1.5 * low.find_estimate("cT").value)


def test_units_of_speed():
    columns = single()
    rpm = {**columns, "speed": columns["speed"] * 30 / math.pi}
    (guessed,) = fit_rotor_coefficients(compute_loads(table(rpm, ("speed",))), radius_m=R, density_kg_m3=RHO)
    assert guessed.find_estimate("cT").value == pytest.approx(C_T)
    assert any("speed has no unit: taken as rpm" in n for n in guessed.notes)
    assert any("check the units" in n for n in fit(rpm).notes)


def test_density_of_the_air():
    t = table({"speed": np.ones(2), "temperature": np.full(2, 20.0), "pressure": np.full(2, 101325.0)})
    assert resolve_air_density(t, None)[0][0] == pytest.approx(1.204, abs=1e-3)
    assert resolve_air_density(t, 1.1)[0][0] == 1.1
    assert "assumed" in resolve_air_density(table({"speed": np.ones(2)}), None)[1]


@pytest.mark.parametrize(
    ("columns", "what"),
    [
        ({"speed": np.ones(3), "pitch": np.ones(3)}, "thrust: is not among the columns"),
        ({"thrust": np.ones(3)}, "speed: is not among the columns"),
        ({"speed": np.ones(3), "thrust_raw": np.ones(3)}, "is a reading without a calibration"),
        ({"speed": np.array([0.0, 0.0, 1.0]), "thrust": np.ones(3)}, "1 points with a turning rotor"),
    ],
)
def test_wrong_input(columns, what):
    with pytest.raises(InputError, match=what):
        fit(columns)


def test_a_single_rotor_takes_its_place_in_a_vehicle():
    vehicle = load_vehicle("mufly-1.1")
    result = assign_rotor_side(fit(single()), "upper", vehicle)
    assert result.estimates[0].symbol == "cT_up"
    assert result.estimates[0].key == "rotors.upper.thrust_coefficient"
    assert result.estimates[0].start == 0.0138


def test_predictions_stand_beside_what_they_predict():
    blading = prepare_blading(load_rotor("naca0012-r60-c20"))
    speed, pitch = np.array([500.0, 700.0]), np.full(2, math.radians(12))
    out = solve_rotor_batch(blading, pitch_rad=pitch, speed_rad_s=speed)
    loads = compute_loads(
        table({"speed": speed, "pitch": pitch, "thrust": out.thrust_N / 1.1, "torque": out.torque_Nm})
    )
    p = predict_loads(loads, blading, density_kg_m3=1.2)
    assert_allclose(p.relative_error["thrust"], 0.1, rtol=1e-9)
    assert_allclose(p.relative_error["torque"], 0.0, atol=1e-9)
    with pytest.raises(InputError, match="spacing_m"):
        predict_loads(compute_loads(table(pair(1.1))), blading, density_kg_m3=1.2)
    two = {k: v[:2] for k, v in pair(1.1).items()}
    both = predict_loads(compute_loads(table(two)), blading, density_kg_m3=1.2, pitch_rad=0.2, spacing_m=0.04)
    assert both.load["thrust"].shape == (2,)


@measured
def test_a_measured_pair_and_its_single_rotor():
    """University of Stavanger's 28 inch rotor: the upper one keeps its thrust, the lower one loses 40 %."""
    alone = compute_loads(read_bench_file(DATA / "tmotor28_single.csv"))
    together = compute_loads(read_bench_file(DATA / "tmotor28_coaxial.csv", columns=PAIR))
    fits = [
        *fit_rotor_coefficients(alone, radius_m=0.3556),
        *fit_rotor_coefficients(together, radius_m=0.3556),
    ]
    assert fits[0].find_estimate("cT").value == pytest.approx(0.0089, rel=0.03)
    assert fits[1].find_estimate("cT_up").value == pytest.approx(0.0089, rel=0.03)
    assert 0.5 < fits[1].find_estimate("cT_dw").value / fits[0].find_estimate("cT").value < 0.7
    words = describe_rotor_interference(fits)
    assert any(w.startswith("cT_up") and "unaffected" in w for w in words)
    assert fits[0].fits[0].trends[0].is_significant  # from 0.0079 to 0.0089: plain in the readings
    figure = draw_rotor_coefficients(fits)
    assert all(ax.get_ylabel() for ax in figure.axes)


@measured
def test_table_3_2():
    loads = compute_loads(
        read_bench_file(DATA / "thesis_table_3_2.csv", columns={"thrust": "T_meas_N", "torque": "Q_meas_Nm"})
    )
    low, high = fit_rotor_coefficients(loads, radius_m=0.06)
    assert low.find_estimate("cT").value == pytest.approx(0.01134, rel=0.01)
    assert high.find_estimate("cT").value == pytest.approx(0.0162, rel=0.01)


def test_one_speed_shows_no_trend_and_says_so():
    result = fit(single(np.random.default_rng(0), 0.01, speed=np.full(10, 300.0)))
    assert result.find_estimate("cT").value == pytest.approx(C_T, rel=0.02)
    assert not result.fits[0].trends
    assert any("one speed only" in note for note in result.notes)


def test_two_speeds_show_a_slope_and_no_bend():
    result = fit(single(np.random.default_rng(0), 0.01, speed=np.repeat([200.0, 400.0], 6)))
    assert result.fits[0].trends[0].coefficients.size == 2
    assert math.isfinite(result.find_estimate("cT").std)


def test_a_load_cell_the_other_way_round_is_said():
    columns = single()
    result = fit({**columns, "thrust": -columns["thrust"]})
    assert result.find_estimate("cT").value == pytest.approx(C_T)
    assert any("thrust is negative and was inverted" in note for note in result.notes)


# -- files of others -------------------------------------------------------------------------------------------------

WIDE = np.linspace(200.0, 500.0, 10)
TURNS, D = WIDE / (2 * math.pi), 2 * R


def written(tmp_path, text):
    (tmp_path / "b.csv").write_text(text, encoding="utf-8")
    return read_bench_file(tmp_path / "b.csv")


def rows(heads, *columns):
    return heads + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)) + "\n"


def loads_of(speed):
    """Thrust (N) and torque (N m) of the truth in air of 1.2 kg/m3."""
    return C_T * RHO * math.pi * R**4 * speed**2, C_Q * RHO * math.pi * R**5 * speed**2


def found(table, **more):
    (result,) = fit_rotor_coefficients(
        compute_loads(table, radius_m=R, density_kg_m3=more.get("density_kg_m3")), radius_m=R, **more
    )
    return result


@pytest.mark.parametrize(
    ("heads", "one", "two", "words"),
    [
        ("RPM,CT,CP", C_T * math.pi**3 / 4, C_Q * math.pi**4 / 4, "the propeller's T / (rho n^2 D^4)"),
        ("RPM,CT,CQ", C_T * math.pi**3 / 4, C_Q * math.pi**3 / 8, "the propeller's Q / (rho n^2 D^5)"),
        ("RPM,c_T,c_Q", C_T, C_Q, "the rotor's T / (rho A (Omega R)^2)"),
        ("RPM,c_T,CP", C_T, C_Q * math.pi**4 / 4, "the propeller's P / (rho n^3 D^5)"),
        ("speed,CT,CP", C_T * math.pi**3 / 4, C_Q * math.pi**4 / 4, "speed has no unit: taken as rpm"),
    ],
)
@pytest.mark.parametrize("density", [None, 1.1])
def test_coefficients_of_propellers_and_rotors(tmp_path, heads, one, two, words, density):
    """c_T = 4 CT / pi^3, c_Q = 4 CP / pi^4, whatever the density and the radius."""
    table = written(tmp_path, rows(heads, WIDE * 30 / math.pi, np.full(10, one), np.full(10, two)))
    result = found(table, density_kg_m3=density)
    assert result.find_estimate("cT").value == pytest.approx(C_T)
    assert result.find_estimate("cQ").value == pytest.approx(C_Q)
    assert any(words in n for n in result.notes)
    assert any("depend on no density" in n for n in result.notes)


def test_a_coefficient_beside_a_load_takes_the_density(tmp_path):
    ct = np.full(10, C_T * math.pi**3 / 4)
    result = found(written(tmp_path, rows("RPM,CT,torque_Nm", WIDE * 30 / math.pi, ct, loads_of(WIDE)[1])))
    assert result.find_estimate("cT").value == pytest.approx(C_T)
    assert result.find_estimate("cQ").value == pytest.approx(C_Q)
    assert any("1.2 kg/m3 assumed" in n for n in result.notes)


def test_a_coefficient_that_may_be_either_one_s_is_asked_for(tmp_path):
    text = rows("RPM,CT", WIDE * 30 / math.pi, np.full(10, C_T))
    with pytest.raises(InputError, match=r"CT: is near 0.0138: .* columns=propeller_CT=CT or columns=rotor_CT=CT"):
        found(written(tmp_path, text))
    for name, value in (("rotor_CT", C_T), ("propeller_CT", 4 * C_T / math.pi**3)):
        table = read_bench_file(tmp_path / "b.csv", columns=[f"{name}=CT"])
        assert found(table).find_estimate("cT").value == pytest.approx(value)
    with pytest.raises(InputError, match="CT: is a coefficient"):
        compute_loads(table)


@pytest.mark.parametrize("unit", ["N", "gf", "kgf"])
def test_a_thrust_without_unit_is_decided_by_the_lift_and_said(tmp_path, unit):
    thrust = loads_of(WIDE)[0] / {"N": 1.0, "gf": 9.80665e-3, "kgf": 9.80665}[unit]
    result = found(written(tmp_path, rows("speed_rad_s,thrust", WIDE, thrust)))
    assert result.find_estimate("cT").value == pytest.approx(C_T)
    assert any(f"no unit is written, taken as {unit} (c_T near 0.014" in n for n in result.notes)


def test_loads_without_units_lean_on_the_figure_of_merit_or_are_asked_for(tmp_path):
    """c_T of 0.003 in newtons would be 0.029 in kilograms: only the torque tells."""
    thrust, torque = 0.003 / C_T * loads_of(WIDE)[0], 0.1 * loads_of(WIDE)[1]
    with pytest.raises(InputError, match="thrust: has no unit, and its size suits N or kgf"):
        found(written(tmp_path, rows("speed_rad_s,thrust", WIDE, thrust)))
    result = found(written(tmp_path, rows("speed_rad_s,thrust,torque_Nm", WIDE, thrust, torque)))
    assert any("taken as N (c_T near 0.003, figure of merit 0.46)" in n for n in result.notes)
    milli = found(written(tmp_path, rows("speed_rad_s,T(N),torque", WIDE, loads_of(WIDE)[0], 1e3 * loads_of(WIDE)[1])))
    assert milli.find_estimate("cQ").value == pytest.approx(C_Q)
    assert any("torque: no unit is written, taken as mN m" in n for n in milli.notes)
    with pytest.raises(InputError, match="thrust: has no unit, and its size suits no unit"):
        found(written(tmp_path, rows("speed_rad_s,thrust", WIDE, 1e6 * thrust)))


@pytest.mark.parametrize("extra", ["", "ESC signal (µs)"])
def test_lines_that_lost_their_speed_tell_no_zero(tmp_path, extra):
    """Some readings of an electrical speed are 0 under load; the real rest, with an offset of the cell, is kept."""
    speed = np.repeat(np.linspace(200.0, 500.0, 8), 2)
    thrust, torque = loads_of(speed)
    seen = np.where(np.arange(16) % 3 == 1, 0.0, speed)
    rest = np.zeros(3)
    columns = [np.r_[rest, v, rest] for v in (seen, thrust, torque)]
    columns[1] = columns[1] + 0.05
    heads = "speed_rad_s,thrust_N,torque_Nm"
    if extra:
        heads += f",{extra}"
        columns.append(np.r_[rest + 1000, 1200 + speed, rest + 1000])
    result = found(written(tmp_path, rows(heads, *columns)))
    assert result.find_estimate("cT").value == pytest.approx(C_T, rel=1e-6)
    assert result.find_estimate("cQ").value == pytest.approx(C_Q, rel=1e-6)
    assert any("5 lines (first: 6) have speed 0 under load" in n for n in result.notes)
    assert any("thrust: zero read 2 times" in n for n in result.notes)


def test_a_speed_that_failed_in_every_line_is_said(tmp_path):
    text = rows("speed_rad_s,thrust_N,duty", np.zeros(6), loads_of(WIDE[:6])[0], np.linspace(0.2, 0.9, 6))
    with pytest.raises(InputError, match="speed_rad_s: is 0 in every line, although there are loads"):
        found(written(tmp_path, text))


def test_coefficients_that_no_rotor_has_are_remarked_and_not_written(tmp_path):
    thrust, torque = loads_of(WIDE)
    heads = "speed_rad_s,thrust_N,torque_Nm"
    down = found(written(tmp_path, rows(heads, WIDE, np.where(WIDE > 420, -3 * thrust, 0.1), torque)))
    assert any("cT = " in u and "negative, which is not physical" in u for u in down.undetermined)
    assert assign_rotor_side(down, "upper", None).estimates[0].symbol == "cT_up"
    light = found(written(tmp_path, rows(heads, WIDE, thrust, torque / 10)))
    assert any("figure of merit of 4.59, above 1" in u for u in light.undetermined)
    assert not any("not physical" in u for u in found(table(single())).undetermined)


def test_lines_in_axial_flight_are_left_out(tmp_path):
    thrust, torque = loads_of(WIDE)
    air = np.where(np.arange(10) % 2 == 0, 0.0, 5.0)
    text = rows("speed_rad_s,thrust_N,torque_Nm,V (m/s)", WIDE, thrust * (1 - 0.1 * air), torque, air)
    result = found(written(tmp_path, text))
    assert result.find_estimate("cT").value == pytest.approx(C_T)
    assert any("5 lines in axial flight are not used; 5 static lines remain" in n for n in result.notes)
    with pytest.raises(InputError, match="has no static line"):
        found(written(tmp_path, rows("speed_rad_s,thrust_N,J", WIDE, thrust, np.full(10, 0.3))))


def test_an_unknown_unit_of_a_load_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"Torque \(bananas\): 'bananas' is not a known unit of torque"):
        found(written(tmp_path, "RPM,T(N),Torque (bananas)\n3000,1,1\n4000,2,1\n"))


def test_one_static_line_of_a_maker_s_file_has_a_value_and_no_scatter():
    made = table(single(speed=np.array([300.0])))
    result = found(replace(made, diameter_m=2 * R), density_kg_m3=RHO)
    assert result.find_estimate("cT").value == pytest.approx(C_T)
    assert math.isnan(result.find_estimate("cT").std)
    assert result.undetermined == ()
    other = found(replace(made, diameter_m=R), density_kg_m3=RHO)
    assert any("the file's rotor has R 43.75 mm" in n for n in other.notes)
