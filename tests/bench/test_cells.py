"""Load cells and their zero: exact data, Monte Carlo, and what cannot be told."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.bench import BenchTable, fit_cell_calibration, fit_zero_drift
from mufly.errors import InputError

S = np.array([[2.0, 5.0], [0.01, 150.0]])
B = np.array([0.12, -0.4])
LOADS = np.array([[f, m] for f in (0.0, 0.5, 1.0, 1.5) for m in (0.0, 0.005, 0.01)])


def table(readings, loads=LOADS):
    columns = {
        "thrust": loads[:, 0],
        "torque": loads[:, 1],
        "thrust_raw": readings[:, 0],
        "torque_raw": readings[:, 1],
    }
    return BenchTable("cal.csv", columns, {k: k for k in columns}, np.arange(2, 2 + len(loads)))


def test_exact_readings_give_the_exact_cells():
    cal = fit_cell_calibration(table(LOADS @ S.T + B))
    assert_allclose(cal.sensitivity, S, atol=1e-10)
    assert_allclose(cal.offset, B, atol=1e-10)
    assert_allclose(cal.readings_to_loads(LOADS @ S.T + B), LOADS, atol=1e-10)
    gain, _ = cal.channel_gains()
    assert_allclose(gain, np.diag(np.linalg.inv(S)), rtol=1e-9)


def test_stated_deviations_match_the_scatter():
    rng = np.random.default_rng(3)
    gains, stated, parameters, covariance = [], [], [], []
    for _ in range(150):
        cal = fit_cell_calibration(table(LOADS @ S.T + B + rng.standard_normal((12, 2)) * [0.01, 0.02]))
        g, s = cal.channel_gains()
        gains.append(g)
        stated.append(s)
        parameters.append(np.column_stack([cal.offset, cal.sensitivity]).ravel())
        covariance.append(np.diag(cal.covariance))
    assert_allclose(np.mean(stated, axis=0), np.std(gains, axis=0), rtol=0.2)
    assert_allclose(np.sqrt(np.median(covariance, axis=0)), np.std(parameters, axis=0), rtol=0.2)
    text = "\n".join(cal.describe_calibration())
    assert "cross-talk of torque on thrust" in text
    assert "is there" in text


@pytest.mark.parametrize(
    ("loads", "what"),
    [
        (LOADS * [1, 0], "is the same in every line"),
        (LOADS[:4], "too few"),
        (np.outer(np.arange(8), [0.2, 0.001]), "vary together"),
    ],
)
def test_what_a_calibration_cannot_tell(loads, what):
    with pytest.raises(InputError, match=what):
        fit_cell_calibration(table(loads @ S.T + B, loads))


def blocks(n=60, at=(0, 20, 40, 55), length=5):
    rest = np.zeros(n, dtype=bool)
    for k in at:
        rest[k : k + length] = True
    return rest


def test_a_straight_drift_is_found_through_the_runs():
    rng = np.random.default_rng(5)
    time, rest = np.arange(60.0), blocks()
    reading = 0.3 + 0.01 * time + 0.005 * rng.standard_normal(60) + np.where(rest, 0.0, 4.0)
    drift = fit_zero_drift(time, reading, rest)
    assert drift.rest_block_count == 4
    assert_allclose(drift.zero_at(time), 0.3 + 0.01 * time, atol=0.01)
    assert drift.total_change == pytest.approx(0.59, abs=0.02)
    assert np.all(np.abs(drift.zero_at(time) - 0.3 - 0.01 * time) < 4 * drift.zero_std_at(time))


def test_a_steady_zero_stays_a_constant():
    rng = np.random.default_rng(0)
    degrees = [
        fit_zero_drift(np.arange(60.0), 0.1 * rng.standard_normal(60), blocks()).coefficients.size - 1
        for _ in range(40)
    ]
    assert degrees.count(0) > 25


def test_few_zeros():
    time = np.arange(10.0)
    rest = np.zeros(10, dtype=bool)
    assert fit_zero_drift(time, time, rest) is None
    rest[0] = True
    one = fit_zero_drift(time, 0.5 + 0 * time, rest)
    assert_allclose(one.zero_at(time), 0.5)
    rest[9] = True
    both = fit_zero_drift(time, 0.1 * time, rest)
    assert_allclose(both.zero_at(time), 0.1 * time, atol=1e-12)
