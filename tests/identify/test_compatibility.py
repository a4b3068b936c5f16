"""Flight path reconstruction: instruments with known faults, on paths whose rates and forces are known exactly."""

import json

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError
from mufly.identify import UniformLogTable
from mufly.identify.flight_record import low_pass
from mufly.identify.linear.flight_path_reconstruction import (
    FLIGHT_PATH_STATES,
    IMU_CHANNELS,
    flight_path_derivative,
    reconstruct_flight_path,
)
from mufly.quantities.units import GRAVITY
from mufly.rotations import body_to_ned_matrices

NAMES = {n: n for n in IMU_CHANNELS}, {n: n for n in FLIGHT_PATH_STATES}
NOISE = np.r_[[0.02] * 3, [0.2] * 3], np.r_[[0.005] * 3, [0.03] * 3, [0.005] * 3]


def made(seed, n=700, dt=0.02):
    """A smooth path; what perfect instruments would read on it, then bias, scale factor and noise."""
    rng = np.random.default_rng(seed)
    t = dt * np.arange(n)
    angle = low_pass(rng.normal(size=(n, 3)), dt, 0.6)
    angle = 0.6 * angle / np.abs(angle).max(axis=0) * [1.0, 1.0, 4.0]
    along, speed = (
        CubicSpline(t, angle),
        CubicSpline(t, low_pass(rng.normal(size=(n, 3)), dt, 0.4) * [6.0, 6.0, 5.0]),
    )
    turn, (s1, s2, _), (c1, c2, _) = along(t, 1).T, np.sin(angle).T, np.cos(angle).T
    rates = np.c_[turn[0] - turn[2] * s2, turn[1] * c1 + turn[2] * c2 * s1, -turn[1] * s1 + turn[2] * c2 * c1]
    force = np.einsum("nji,nj->ni", body_to_ned_matrices(angle), speed(t, 1) - [0.0, 0.0, GRAVITY])
    truth = np.r_[rng.normal(size=6) * np.r_[[0.03] * 3, [0.2] * 3], 0.03 * rng.normal(size=6)]
    imu = (1.0 + truth[6:]) * np.c_[rates, force] + truth[:6] + rng.normal(size=(n, 6)) * NOISE[0]
    states = np.c_[angle, speed(t), speed.antiderivative()(t)]
    z = states + rng.normal(size=(n, 9)) * NOISE[1]
    columns = dict(zip((*IMU_CHANNELS, *FLIGHT_PATH_STATES), np.c_[imu, z].T, strict=True))
    return UniformLogTable("made", t, columns), truth, states, np.c_[rates, force], speed(t, 1), along(t, 1)


def test_kinematics_of_a_known_path_are_its_derivatives():
    _, _, states, true, pull, turn = made(0)
    found = flight_path_derivative(states, true)
    assert found[:, :3] == pytest.approx(turn, abs=1e-9)
    assert found[:, 3:6] == pytest.approx(pull, abs=1e-9)
    assert found[:, 6:] == pytest.approx(states[:, 3:6])
    resting = flight_path_derivative(np.zeros((1, 9)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY]]))
    assert not resting.any()


def test_biases_scale_factors_and_the_path_lie_in_their_intervals():
    inside, covered = [], []
    for seed in range(3):
        record, truth, states, *_ = made(seed)
        c = reconstruct_flight_path(record, *NAMES)
        assert c.converged
        inside += [e.low <= v <= e.high for e, v in zip(c.estimates, truth, strict=True)]
        covered.append(np.abs(c.states - states) < 1.96 * c.states_std)
        assert c.imu_noise == pytest.approx(NOISE[0], rel=0.25)
        assert c.output_noise == pytest.approx(NOISE[1], rel=0.25)
    assert np.mean(inside) >= 0.86  # of 36; 94 % of 96 at twice the length
    assert 0.9 < np.mean(covered) < 0.99
    # At rest b_z and lambda_z are one number; here they are nearly.
    assert any("b_az and lambda_az" in w for w in c.undetermined)
    assert c.corrected == pytest.approx(made(2)[3], abs=6.0 * 0.2 + 0.2)


def spoilt(**change):
    record = made(1)[0]
    columns = dict(record.columns)
    for name, with_ in change.items():
        columns[name] = with_(columns)
    return UniformLogTable("made", record.time_s, columns)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"p": lambda c: np.degrees(c["p"])}, "p: is 5.* deg/s"),
        ({"q": lambda c: -c["q"]}, "q: has the opposite sign"),
        ({"p": lambda c: c["q"], "q": lambda c: c["p"]}, "p: follows q of"),
        ({n: lambda c, n=n: c[n] / GRAVITY for n in ("ax", "ay", "az")}, "in g, not"),
        ({"az": lambda c: -c["az"]}, "az: reads"),
        ({"ay": lambda c: -c["ay"]}, "ay: has the opposite sign"),
        ({"down": lambda c: -c["down"]}, "v_down: has the opposite sign of down"),
        ({n: lambda c, n=n: np.degrees(c[n]) for n in ("phi", "theta", "psi")}, "theta: reaches"),
    ],
)
def test_units_signs_and_axes_that_cannot_be_are_named(change, words):
    with pytest.raises(InputError, match=words):
        reconstruct_flight_path(spoilt(**change), *NAMES)


def test_what_was_not_measured_is_reconstructed_and_what_is_needed_is_asked_for():
    record, _, states, *_ = made(4, n=450)
    without = {n: n for n in FLIGHT_PATH_STATES if not n.startswith("v_")}
    c = reconstruct_flight_path(record, NAMES[0], without)
    assert np.abs(c.states - states)[50:-50, 3:6].max() < 0.1
    with pytest.raises(InputError, match="az: is missing"):
        reconstruct_flight_path(record, {n: n for n in IMU_CHANNELS[:5]}, NAMES[1])
    with pytest.raises(InputError, match="psi: is missing"):
        reconstruct_flight_path(record, NAMES[0], {"phi": "phi", "theta": "theta"})


def test_the_command_writes_the_path_and_says_the_biases(tmp_path):
    record, truth, *_ = made(5)
    log, out = tmp_path / "flight.csv", tmp_path / "out"
    table = np.c_[record.time_s, *record.columns.values()]
    np.savetxt(log, table, delimiter=",", header=",".join(["time", *record.columns]), comments="")
    result = CliRunner().invoke(app, ["identify", "compatibility", str(log), "--out", str(out), "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert [e["value"] for e in found["estimates"][:3]] == pytest.approx(truth[:3], abs=0.01)
    path = np.genfromtxt(out / "path.csv", delimiter=",", names=True)
    assert path["phi"] == pytest.approx(record.columns["phi"], abs=0.03)
    assert (out / "path.png").stat().st_size > 20_000
    result = CliRunner().invoke(app, ["identify", "compatibility", str(log), "--imu", "p,q,r,ax,ay,az=2*-az"])
    assert isinstance(result.exception, InputError)


def test_a_shaking_rotor_does_not_enlarge_scale_factors_and_a_recordings_names_are_known():
    """An exact path beside an accelerometer shaken at 17 and 21 Hz, ten times what manoeuvres pull; our own names."""
    record, truth, states, true, *_ = made(6, n=900)
    t, imu = record.time_s, (1.0 + truth[6:]) * true + truth[:6]
    imu[:, 3:] += 5.0 * np.c_[np.sin(107.0 * t), np.cos(107.0 * t), np.sin(132.0 * t + 1.0)]
    axes = (*("rates." + a for a in "pqr"), *("acceleration." + a for a in "xyz"))
    columns = {f"measured_{a}": imu[:, k] for k, a in enumerate(axes)}
    ends = [
        f"{s}.{a}"
        for s, b in (("attitude", ("roll", "pitch", "yaw")), ("velocity", "NED"), ("position", "NED"))
        for a in b
    ]
    columns |= {f"truth_{e}": states[:, k] for k, e in enumerate(ends)}
    columns |= {f"estimated_{e}": states[:, k] + 0.1 for k, e in enumerate(ends)}
    unused = {"measured_pressure": 7}
    c = reconstruct_flight_path(UniformLogTable("made", t, columns, filled_counts=unused), *NAMES)
    assert c.converged
    value = np.array([e.value for e in c.estimates])
    assert value[:3] == pytest.approx(truth[:3], abs=2e-3)
    assert value[9:] == pytest.approx(truth[9:], abs=0.1)
    assert any("replaced by the simulation's truth" in n for n in c.notes)
    assert not any("pressure" in n for n in c.notes)
