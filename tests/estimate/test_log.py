"""The filter on logs of others: against a made-up flight whose truth and noise are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from mufly.cli.onboard.estimate import app
from mufly.errors import InputError
from mufly.estimate import (
    AidInnovations,
    InertialLog,
    InertialNoise,
    PositionAids,
    check_inertial_log,
    compute_aid_innovations,
    detect_flight,
    estimate_flight_noise,
    estimate_rest_noise,
    inertial_log,
    measure_row_consistency,
    run_filter_on_log,
)
from mufly.quantities.units import GRAVITY

STEP, REST_S, END_S = 0.02, 2.0, 14.0
GYRO, FELT, FIX = 0.01, 0.05, 0.02  # densities of noise in flight; sigma of the aids (m)
AT_REST = 1e-3, 1e-2


def flight(seed: int = 0) -> tuple[InertialLog, PositionAids, np.ndarray]:
    """A circle flown as a rotorcraft flies it: thrust along its axis, nose north; rows are means over a step."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, END_S, STEP)
    fine = np.arange(-STEP, END_S + STEP, STEP / 10)
    s = np.clip((fine - REST_S) / 3.0, 0.0, 1.0)
    grown = s**3 * (10 - 15 * s + 6 * s**2)  # with its two derivatives zero at both ends
    turn = 1.2 * (fine - REST_S)
    p = np.column_stack([grown * np.sin(turn), grown * (1 - np.cos(turn)), -1.5 * grown])
    v = np.gradient(p, fine, axis=0)
    f = np.gradient(v, fine, axis=0) - (0.0, 0.0, GRAVITY)
    size = np.linalg.norm(f, axis=1)
    roll, pitch = np.arcsin(f[:, 1] / size), np.arctan2(-f[:, 0], -f[:, 2])
    r = Rotation.from_euler("ZYX", np.column_stack([0 * roll, pitch, roll]))
    w = (r[:-1].inv() * r[1:]).as_rotvec() / (STEP / 10)
    body = r.inv().apply(f)
    mean = np.searchsorted(fine, t - 1e-9)[:, None] + np.arange(-10, 0)
    flying = t >= REST_S
    noise = np.where(flying, 1.0, 0.0)[:, None] / np.sqrt(STEP)
    still = (1 - np.where(flying, 1.0, 0.0))[:, None] / np.sqrt(STEP)
    n = (len(t), 3)
    rates = w[mean].mean(axis=1) + (noise * GYRO + still * AT_REST[0]) * rng.standard_normal(n) + 0.004
    felt = body[mean].mean(axis=1) + (noise * FELT + still * AT_REST[1]) * rng.standard_normal(n)
    at = np.searchsorted(fine, t - 1e-9)
    truth = np.column_stack([p[at], v[at], roll[at], pitch[at], 0 * t])
    some = np.arange(1, len(t), 4)
    fix = truth[some, :3] + FIX * rng.standard_normal((len(some), 3))
    aids = PositionAids(t[some], t[some] + 0.1, fix, 0.03 * rng.standard_normal(len(some)), FIX, 0.03)
    return InertialLog(t, rates, felt, flying), aids, truth


@pytest.fixture(scope="module")
def made() -> tuple[InertialLog, PositionAids, np.ndarray]:
    return flight()


def test_it_is_as_good_as_it_says_with_the_noise_that_is_there() -> None:
    """NEES of position, velocity and attitude is 1 on average over flights; aids are foretold as well as it says."""
    found = []
    for seed in range(4):
        log, aids, truth = flight(seed)
        told = run_filter_on_log(log, aids, InertialNoise(gyro=GYRO, accelerometer=FELT))
        found.append(
            (
                measure_row_consistency(truth, told, after_s=REST_S + 2).nees,
                compute_aid_innovations(log, aids, told, from_s=4.0, to_s=END_S).nis,
            )
        )
    nees, nis = np.mean(found, axis=0)
    assert 0.5 < nees < 1.5
    assert nis == pytest.approx(1.0, abs=0.2)


def test_noise_is_found_in_the_log(made: tuple[InertialLog, PositionAids, np.ndarray]) -> None:
    log, aids, truth = made
    least = estimate_rest_noise(log)
    assert 0.7 * AT_REST[0] < least.gyro < 2 * AT_REST[0]
    assert 0.7 * AT_REST[1] < least.accelerometer < 2 * AT_REST[1]
    noise = estimate_flight_noise(log, aids, least)
    assert GYRO / 3 < noise.gyro < 3 * GYRO
    assert noise.accelerometer < 4 * FELT  # what tilt does to it can hide it
    told = run_filter_on_log(log, aids, noise)
    assert 0.4 < measure_row_consistency(truth, told, after_s=4.0).nees < 2.0
    # Nothing is known of attitude: its errors do not count, and nothing is said of them.
    blind = truth.copy()
    blind[:, 6:] = np.nan
    assert np.isnan(measure_row_consistency(blind, told, after_s=4.0).block_nees[2])


def test_standing_is_told_by_the_unit_alone(made: tuple[InertialLog, PositionAids, np.ndarray]) -> None:
    log = made[0]
    assert abs(log.time_s[np.argmax(detect_flight(log.time_s, log.rates, log.acceleration))] - REST_S) <= 0.5
    assert len(log.acceleration[log.rest_rows]) == int(REST_S / STEP)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"acceleration": lambda f: f / GRAVITY}, "so its unit is g"),
        ({"acceleration": lambda f: -f}, "has its z axis up"),
        ({"acceleration": lambda f: f[:, [2, 0, 1]]}, "gravity along x"),
        ({"acceleration": lambda f: f + np.array([0.0, 0.0, GRAVITY])}, "instead of 9.81"),
        ({"rates": lambda w: np.degrees(w) + 50.0}, "deg/s"),
        ({"rates": lambda w: w + 1.0}, "at rest"),
    ],
)  # fmt: skip
def test_wrong_units_and_axes_are_refused(
    made: tuple[InertialLog, PositionAids, np.ndarray], change: dict, words: str
) -> None:
    (name, how), log = next(iter(change.items())), made[0]
    with pytest.raises(InputError, match=words):
        check_inertial_log(replace(log, **{name: how(getattr(log, name))}), "a log")


def test_a_log_of_others_through_the_command(
    tmp_path: Path, made: tuple[InertialLog, PositionAids, np.ndarray]
) -> None:
    """From a table with columns of its own, units and signs, to figures; and what is wrong with it in one line."""
    log, _, truth = made
    table = np.column_stack([log.time_s, np.degrees(log.rates), log.acceleration / GRAVITY, truth])
    table[300:303, 1:7] = np.nan  # a hole
    names = [
        "wx[deg/s]", "wy[deg/s]", "wz[deg/s]", "fx[gee]", "fy[gee]", "fz[gee]",
        *(f"truth_{n}" for n in ("position_N", "position_E", "position_D", "velocity_N", "velocity_E", "velocity_D",
                                 "attitude_roll", "attitude_pitch", "attitude_yaw")),
    ]  # fmt: skip
    file = tmp_path / "log.csv"
    np.savetxt(file, table, "%.9g", ",", header=",".join(["time[s]", *names]), comments="")
    given = [
        str(file), "-c", "measured_acceleration=fx,fy,fz(gee)",
        "--aid", "position=truth_position", "--aid-rate", "12.5", "--aid-delay", "0.1",
    ]  # fmt: skip
    turns = [f"measured_rates.{x}={y}(deg/s)" for x, y in (("p", "wx"), ("q", "wy"), ("r", "wz"))]
    given += [x for one in turns for x in ("-c", one)]
    noise = ["--gyro-noise", str(GYRO), "--accelerometer-noise", str(FELT)]
    run = CliRunner().invoke(app, [*given, "--aid-std", "0.02", *noise, "--json"])
    assert run.exit_code == 0, run.output
    found = json.loads(run.stdout[run.stdout.index("{") :])
    assert found["errors"]["xy_rms"] < 0.06
    assert 0.4 < found["errors"]["nees"] < 2.0
    assert found["mounting_rad"] == pytest.approx([0.0, 0.0], abs=0.003)
    assert found["aids"]["nis"] == pytest.approx(1.0, abs=0.5)
    # Columns of one's own, one of them with a sign that is wrong: aids and unit do not belong together.
    place = given.index("--aid") + 1
    turned = [
        *given[:place],
        "position=truth_position_N,-truth_position_E,truth_position_D",
        *given[place + 1 :],
    ]
    run = CliRunner().invoke(app, [*turned, "--aid-std", "0.02", *noise, "--json"])
    assert run.exit_code == 0, run.output
    assert json.loads(run.stdout[run.stdout.index("{") :])["aids"]["nis"] > 5.0
    for more, words in (
        ([], "needed when the fixes are made from the truth"),
        (["--aid-std", "0.02", "--aid", "speed=x"], "is not a reference for the estimate"),
        (["--aid-std", "-1"], "not above zero"),
        (["--aid-std", "0.02", "--aid-delay", "9"], "that the filter stores"),
        (["--aid-std", "0.02", "wy turned"], "runs against"),
    ):
        words_ = [x.replace("=wy", "=-wy") if "wy turned" in more else x for x in given]
        bad = CliRunner().invoke(app, [*words_, *(x for x in more if x != "wy turned"), *noise])
        assert isinstance(bad.exception, InputError), more
        assert words in str(bad.exception)


def test_the_search_for_noise_stays_within_its_bounds(
    made: tuple[InertialLog, PositionAids, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """More noise always seems likelier, as with readings cut off on a fast circle; or no run is valid."""
    log, aids, _ = made
    tried = []

    def run_without_filter(log: InertialLog, aids: PositionAids, noise: InertialNoise, **_: object) -> InertialNoise:
        tried.append(noise)
        return noise

    monkeypatch.setattr(inertial_log, "run_filter_on_log", run_without_filter)
    for likelihood in (lambda n: np.log(n.gyro * n.accelerometer) * 100.0, lambda n: -np.inf):
        monkeypatch.setattr(
            inertial_log, "compute_aid_innovations",
            lambda log, aids, noise, likelihood=likelihood, **_: AidInnovations(1, 1.0, 0.1, float(likelihood(noise))),
        )  # fmt: skip
        found = estimate_flight_noise(log, aids, InertialNoise(gyro=1e-3, accelerometer=1e-2))
        if np.isfinite(likelihood(found)):
            assert found.gyro == pytest.approx(inertial_log.MAX_GYRO_NOISE_DENSITY)
            assert found.accelerometer == pytest.approx(inertial_log.MAX_ACCEL_NOISE_DENSITY)
    assert max(n.gyro for n in tried) <= inertial_log.MAX_GYRO_NOISE_DENSITY * (1 + 1e-9)
    assert max(n.accelerometer for n in tried) <= inertial_log.MAX_ACCEL_NOISE_DENSITY * (1 + 1e-9)
