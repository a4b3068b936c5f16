"""Motor constants from a bench: exact data, the dissertation's constants under noise, coverage, and wrong input."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.bench import BenchTable, read_bench_file
from mufly.errors import InputError
from mufly.identify import GearKnowledge, apply_estimates, fit_motor
from mufly.identify.fit_pictures import draw_motor_fit
from mufly.identify.motor_data import ChannelNoise, parse_channel_noise
from mufly.vehicle import load_vehicle

TRUTH = np.array([0.0045, 0.0035, 1.3811, 5.2107e-7])  # kE, kM, R, dR of Table 5.3


def bench(seed=0, noise=0.0, *, voltages=(4.0, 5.5, 7.2), points=12, gear=1.0, efficiency=1.0, full_scale=False):
    """Constant voltage, varied torque (Sec. 5.2), errors in every reading."""
    k_e, k_m, r, d = TRUTH
    u = np.repeat(voltages, points)
    torque = np.concatenate([np.linspace(0.05, 0.85, points) * k_m * v / r for v in voltages])
    speed = (k_m * u / r - torque) / (k_m * k_e / r + d)
    y = np.column_stack([u, (u - k_e * speed) / r, speed / gear, torque * gear * efficiency])
    rng = np.random.default_rng(seed)
    y = y + noise * rng.standard_normal(y.shape) * (np.abs(y).max(axis=0) if full_scale else y)
    columns = dict(zip(("voltage", "current", "speed", "torque"), y.T, strict=True))
    headers = {"voltage": "voltage_V", "current": "current_A", "speed": "speed_rad_s", "torque": "torque_Nm"}
    return BenchTable("bench.csv", columns, headers, np.arange(2, 2 + len(y)))


def values(fit):
    return np.array([e.value for e in fit.estimates])


def test_exact_readings_give_the_exact_constants():
    fit = fit_motor(bench())
    assert_allclose(values(fit), TRUTH, rtol=1e-9)
    assert [e.symbol for e in fit.estimates] == ["kE", "kM", "Rohm", "dR"]
    assert fit.undetermined == ()
    assert_allclose(fit.residual, 0, atol=1e-9)


def test_behind_a_gear():
    table = bench(gear=1.5, efficiency=0.84)
    assert_allclose(values(fit_motor(table, gear=GearKnowledge(1.5, 0.84))), TRUTH, rtol=1e-9)
    assert_allclose(fit_motor(table).effective, [TRUTH[2], 1.5 * TRUTH[0], 1.5 * 0.84 * TRUTH[1],
                    1.5**2 * 0.84 * TRUTH[3], 0], rtol=1e-9)  # fmt: skip


@pytest.mark.parametrize("full_scale", [False, True])
def test_intervals_hold_the_truth_as_often_as_they_say(full_scale):
    trials = 100
    inside, found, stated = np.zeros(4), [], []
    for seed in range(trials):
        fit = fit_motor(bench(seed, 0.01, full_scale=full_scale))
        inside += [e.low <= t <= e.high for e, t in zip(fit.estimates, TRUTH, strict=True)]
        found.append(values(fit))
        stated.append([e.std for e in fit.estimates])
    assert 0.90 <= inside.sum() / (4 * trials) <= 0.99
    assert np.all(inside / trials >= 0.87)
    assert_allclose(np.mean(stated, axis=0), np.std(found, axis=0), rtol=0.25)
    # Errors in current and speed would bias plain least squares; here the mean is right within its own error.
    assert np.all(np.abs(np.mean(found, axis=0) - TRUTH) < 4 * np.std(found, axis=0) / math.sqrt(trials))


def test_what_is_not_known_of_the_gear_is_not_invented():
    table = bench(1, 0.01, gear=1.5, efficiency=0.84)
    fit = fit_motor(table, gear=GearKnowledge(1.5, None))
    assert [e.symbol for e in fit.estimates] == ["kE", "kM*eta_gear", "Rohm", "dR*eta_gear"]
    assert [e.key for e in fit.estimates].count("") == 2
    assert fit.find_estimate("kM*eta_gear").value == pytest.approx(0.84 * TRUTH[1], rel=0.02)
    assert any("kM*eta_gear" in u for u in fit.undetermined)
    both = fit_motor(table, gear=GearKnowledge(None, None))
    assert both.estimates[0].symbol == "kE*igear"
    assert both.estimates[3].value == pytest.approx(1.5**2 * 0.84 * TRUTH[3], rel=0.1)
    assert len(both.undetermined) == 2


def test_doubt_about_the_gear_is_passed_on():
    table = bench(2, 0.001, gear=1.5, efficiency=0.84)
    sure = fit_motor(table, gear=GearKnowledge(1.5, 0.84))
    unsure = fit_motor(table, gear=GearKnowledge(1.5, 0.84, 0.0, 0.042))
    k_m = unsure.find_estimate("kM")
    assert k_m.std / k_m.value == pytest.approx(math.hypot(0.05, sure.find_estimate("kM").std / k_m.value), rel=1e-6)
    assert unsure.find_estimate("Rohm").std == sure.find_estimate("Rohm").std


def changed(table, **columns):
    return BenchTable(table.source, {**table.columns, **columns}, table.headers, table.line_numbers)


def test_duty_and_supply_current():
    table, duty = bench(), np.tile(np.linspace(0.5, 1.0, 12), 3)
    columns = {
        "voltage": table["voltage"] / duty, "duty": duty, "supply_current": table["current"] * duty,
        "speed": table["speed"], "torque": table["torque"],
    }  # fmt: skip
    headers = {k: k for k in columns}
    assert_allclose(values(fit_motor(BenchTable("b.csv", columns, headers, table.line_numbers))), TRUTH, rtol=1e-9)
    with pytest.raises(InputError, match=r"line 2, duty: 50 is not a share"):
        fit_motor(BenchTable("b.csv", {**columns, "duty": 100 * duty}, headers, table.line_numbers))
    idle = {**columns, "duty": np.where(np.arange(36) == 3, 0.0, duty)}
    with pytest.raises(InputError, match=r"line 5, duty: is 0 while the rotor turns"):
        fit_motor(BenchTable("b.csv", idle, headers, table.line_numbers))
    del columns["duty"]
    with pytest.raises(InputError, match="add the column duty"):
        fit_motor(BenchTable("b.csv", columns, headers, table.line_numbers))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"speed": lambda v: v * 30 / math.pi}, r"speed_rad_s is probably in rpm"),
        ({"torque": lambda v: 1e3 * v}, r"torque_Nm is probably in mN m"),
        ({"current": lambda v: 0 * v + 1.0}, r"current_A: is constant \(1 in SI units\)"),
        ({"speed": lambda v: 0 * v + 500.0}, "speed_rad_s: is constant"),
        ({"torque": lambda v: 0 * v}, "torque_Nm: is zero in every line"),
        ({"torque": lambda v: -v}, "delivers no power"),
    ],
)
def test_wrong_input_is_said_in_a_line(change, what):
    table = bench(0, 0.01)
    with pytest.raises(InputError, match=what):
        fit_motor(changed(table, **{k: f(table[k]) for k, f in change.items()}))


def test_too_few_points_and_a_missing_column():
    table = bench()
    with pytest.raises(InputError, match="5 points are too few; give 6 or more"):
        fit_motor(table.select_lines(np.arange(36) < 5))
    columns = {k: v for k, v in table.columns.items() if k != "torque"}
    with pytest.raises(InputError, match="torque: is not among the columns"):
        fit_motor(BenchTable("b.csv", columns, table.headers, table.line_numbers))


def test_a_speed_without_unit_is_guessed_and_said():
    table = bench(0, 0.01)
    rpm = BenchTable(
        "b.csv",
        {**table.columns, "speed": table["speed"] * 30 / math.pi},
        table.headers,
        table.line_numbers,
        ("speed",),
    )
    fit = fit_motor(rpm)
    assert_allclose(values(fit)[:3], TRUTH[:3], rtol=0.03)
    assert any("speed has no unit: taken as rpm" in n for n in fit.notes)
    plain = fit_motor(BenchTable("b.csv", table.columns, table.headers, table.line_numbers, ("speed",)))
    assert any("taken as rad/s" in n for n in plain.notes)
    assert_allclose(values(plain), values(fit), rtol=1e-6)


def test_repeats_and_missing_physics_are_noticed():
    table = bench(3, 0.003)
    rubbing = fit_motor(changed(table, torque=table["torque"] - 4e-4))
    assert [e.symbol for e in rubbing.estimates] == ["kE", "kM", "Rohm", "dR", "Mf"]
    assert rubbing.find_estimate("Mf").low < 4e-4 < rubbing.find_estimate("Mf").high
    assert rubbing.find_estimate("kM").std < 0.02 * TRUTH[1]
    assert [e.symbol for e in fit_motor(table).estimates] == ["kE", "kM", "Rohm", "dR"]
    offset = fit_motor(changed(table, torque=table["torque"] + 4e-4))  # friction that drives is none
    assert any("constant friction" in n for n in offset.notes)
    rng = np.random.default_rng(0)
    base = bench(5, 0.01)
    repeated = {k: np.repeat(v, 4) * (1 + 5e-4 * rng.standard_normal(144)) for k, v in base.columns.items()}
    fit = fit_motor(BenchTable("b.csv", repeated, base.headers, np.arange(2, 146)))
    assert fit.covariance_estimate.pattern != "white"
    once = fit_motor(base)
    assert fit.find_estimate("kM").std == pytest.approx(
        once.find_estimate("kM").std, rel=0.4
    )  # repeats tell nothing new


def test_friction_below_zero_is_held():
    table = bench()
    fit = fit_motor(changed(table, torque=table["torque"] + 3e-6 * table["speed"]))
    assert fit.find_estimate("dR").at_bound
    assert fit.find_estimate("dR").value == 0
    assert any("below zero" in n for n in fit.notes)


def test_into_a_vehicle_file():
    vehicle = load_vehicle("mufly-1.1")
    fit = fit_motor(bench(0, 0.01), vehicle=vehicle)
    assert fit.find_estimate("kE").start == 0.0045
    new = apply_estimates(vehicle, fit.estimates, "bench.csv")
    assert float(new.motor.torque_constant) == fit.find_estimate("kM").value
    assert new.motor.torque_constant.source == "identified"
    assert "bench.csv; std" in new.motor.torque_constant.note
    assert new.body == vehicle.body
    hidden = fit_motor(bench(0, 0.01), gear=GearKnowledge(None, None))
    assert float(apply_estimates(vehicle, hidden.estimates, "x").motor.torque_constant) == 0.0035
    with pytest.raises(InputError, match="no estimate has a key"):
        apply_estimates(vehicle, [e for e in hidden.estimates if not e.key], "x")


def test_noise_is_read():
    noise = parse_channel_noise("current=1%+0.02, speed=0.5%fs", ("voltage", "current", "speed", "torque"))
    assert noise["current"] == ChannelNoise(0.01, 0.0, 0.02)
    assert noise["voltage"] == ChannelNoise()
    assert_allclose(noise["speed"].error_std(np.array([0.0, 100.0])), [0.5, 0.5])
    for text, what in (("wind=1%", "is not a channel"), ("current=x", "is not an amount"), ("current=0", "is zero")):
        with pytest.raises(InputError, match=what):
            parse_channel_noise(text, ("current",))
    fit = fit_motor(bench(0, 0.01), noise=noise)
    assert_allclose(values(fit)[:3], TRUTH[:3], rtol=0.05)


@pytest.mark.parametrize("voltages", [(6.0,), (4.0, 5.5, 7.2), tuple(np.linspace(3, 8, 9))])
def test_the_picture_has_units_on_every_axis(voltages):
    figure = draw_motor_fit(fit_motor(bench(0, 0.01, voltages=voltages)))
    assert len(figure.axes) == 4
    assert all("(" in ax.get_xlabel() and "(" in ax.get_ylabel() for ax in figure.axes)


STAND = "Time (s),ESC signal (µs),Torque (N·m),Thrust (gf),Voltage (V),Current (A),Motor Electrical Speed (RPM)"


def stand():
    """A propeller on a motor with kE = kM = 0.002, R = 0.1 ohm and 1 mN m of friction, 8 V; current of the supply."""
    k, ohm, friction, load, duty = 0.002, 0.1, 1e-3, 5e-10, np.linspace(0.15, 0.9, 16)
    b, c = k**2 / ohm, friction - k * duty * 8.0 / ohm
    speed = (-b + np.sqrt(b**2 - 4.0 * load * c)) / (2.0 * load)
    current = (duty * 8.0 - k * speed) / ohm
    columns = np.column_stack([
        np.arange(16.0), 1000 + 1000 * duty, load * speed**2, 1e-5 * speed**2, np.full(16, 8.0), duty * current,
        speed * 30 / math.pi,
    ])  # fmt: skip
    return STAND + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in columns) + "\n"


def read(tmp_path, text):
    (tmp_path / "b.csv").write_text(text, encoding="utf-8")
    return read_bench_file(tmp_path / "b.csv")


def test_the_signal_of_an_esc_is_the_duty_and_its_current_the_supply_s(tmp_path):
    fit = fit_motor(read(tmp_path, stand()))
    assert fit.find_estimate("Rohm").value == pytest.approx(0.1, rel=1e-6)
    assert fit.find_estimate("kE").value == pytest.approx(0.002, rel=1e-6)
    assert any("a pulse, 1000 us taken as duty 0 and 2000 us as 1" in n for n in fit.notes)
    assert any("Current (A): read as the supply current, because the file has ESC signal (µs)" in n for n in fit.notes)


@pytest.mark.parametrize("at_rest", ["1000", "0.5e3"])
def test_idle_lines_of_a_stand_are_left_out(tmp_path, at_rest):
    fit = fit_motor(read(tmp_path, stand() + f"16,{at_rest},0,0,8,0.02,0\n"))
    assert fit.find_estimate("Rohm").value == pytest.approx(0.1, rel=1e-6)


def test_a_resistance_below_zero_is_refused_with_what_is_missing(tmp_path):
    text = stand().replace("ESC signal (µs)", "Servo 1 (µs)")
    with pytest.raises(
        InputError,
        match=r"the fit gives Rohm = -.* ohm, which is outside the range of real motors; Voltage .*add a column duty",
    ):
        fit_motor(read(tmp_path, text))
    table = bench()
    with pytest.raises(InputError, match="which is outside the range of real motors; check signs, units"):
        fit_motor(changed(table, voltage=3.0 * TRUTH[0] * table["speed"] - table["current"]))


def test_friction_is_asked_for_where_constants_would_make_power(tmp_path):
    rng = np.random.default_rng(0)
    lines = stand().splitlines()
    noisy = [lines[0]]
    for line in lines[1:]:
        row = np.array([float(v) for v in line.split(",")])
        row[2:4] += 1e-5 * rng.standard_normal(2)
        noisy.append(",".join(f"{v:.9g}" for v in row))
    fit = fit_motor(read(tmp_path, "\n".join(noisy) + "\n"))
    assert fit.find_estimate("kM").value <= 1.05 * fit.find_estimate("kE").value


@pytest.mark.parametrize(("head", "unit", "factor"), [("voltage", "mV", 1e3), ("current", "mA", 1e3)])
def test_a_voltage_or_current_without_unit_in_thousandths_is_decided_by_the_power(head, unit, factor):
    table = bench(0, 0.01)
    columns = {**table.columns, head: factor * table[head]}
    heads = {**table.headers, head: head}
    fit = fit_motor(BenchTable("b.csv", columns, heads, table.line_numbers, (head,)))
    assert_allclose(values(fit), values(fit_motor(table)), rtol=1e-6)
    assert any(f"taken as {unit}" in n for n in fit.notes)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("Torque (N·m)", "Torque (bananas)", r"Torque \(bananas\): 'bananas' is not a known unit of torque"),
        ("Voltage (V)", "Voltage (N)", r"Voltage \(N\): 'N' is not a known unit of voltage"),
        (
            "Motor Electrical Speed (RPM)",
            "erpm",
            "speed: is not among the columns; divide erpm by the number of pole",
        ),
    ],
)
def test_units_of_a_stand_that_cannot_be_are_blamed(tmp_path, old, new, what):
    with pytest.raises(InputError, match=what):
        fit_motor(read(tmp_path, stand().replace(old, new)))


def test_pulses_beyond_two_milliseconds_are_refused(tmp_path):
    with pytest.raises(
        InputError, match=r"line 18, ESC signal .*: 1.2 is not a share of the voltage; .*1000 to 2000 us"
    ):
        fit_motor(read(tmp_path, stand() + "16,2200,0.01,1,8,3,30000\n"))
