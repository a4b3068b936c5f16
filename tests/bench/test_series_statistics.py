"""Means of correlated samples, drifts that walk, and moist air: intervals that hold, limits with closed forms."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.signal import lfilter

from mufly.bench.series.block_means import compute_block_mean, has_settled
from mufly.bench.series.moist_air import compute_moist_air_density, compute_relative_density_std
from mufly.bench.series.random_walk_drift import fit_random_walk


def share(samples):
    """How many of the 95 % intervals of rows hold zero."""
    found = [compute_block_mean(row) for row in samples]
    return np.mean([abs(m.value) < stats.t.ppf(0.975, m.dof) * m.std for m in found])


@pytest.mark.parametrize("memory", [0.0, 0.8, 0.95])
def test_intervals_hold_for_samples_that_remember(memory):
    noise = np.random.default_rng(1).standard_normal((400, 1000))
    red = lfilter([1.0], [1.0, -memory], noise, axis=1)[:, 400:]
    assert 0.90 <= share(red) <= 0.99


def test_a_vibration_does_not_make_a_mean_uncertain():
    rng = np.random.default_rng(2)
    t = np.arange(500) / 100.0
    rows = np.array([5.0 * np.sin(2 * np.pi * 13.7 * t + p) for p in rng.uniform(0, 6.3, 200)])
    rows += 0.1 * rng.standard_normal(rows.shape)
    means = [compute_block_mean(r) for r in rows]
    assert np.mean([m.std for m in means]) < 0.2 * 5.0 / np.sqrt(2 * 500) * 2
    assert share(rows) >= 0.9


def test_wild_samples_are_left_out_and_counted():
    x = np.random.default_rng(3).standard_normal(400)
    clean = compute_block_mean(x)
    x[[17, 200]] = 1e6, -8e5
    m = compute_block_mean(x)
    assert (m.outlier_count, m.sample_count, m.largest_sample) == (2, 400, 1e6)
    assert m.value == pytest.approx(clean.value, abs=0.02)
    assert np.isnan(compute_block_mean([]).value)
    assert compute_block_mean([3.0]).value == 3.0


def test_settling():
    rng = np.random.default_rng(4)
    windows = [compute_block_mean(100.0 * (1 - np.exp(-k)) + 0.1 * rng.standard_normal(100)) for k in range(10)]
    verdicts = [has_settled(a, b, 0.2) for a, b in itertools.pairwise(windows)]
    assert not any(verdicts[:4])
    assert all(verdicts[7:])


def test_between_two_exact_readings_the_drift_is_a_bridge():
    t, y = np.linspace(0.0, 100.0, 11), np.array([0, 1, 0, 1, 2, 3, 2, 3, 4, 3, 4.0])
    walk = fit_random_walk(t, y, np.full(11, 1e-6))
    at = np.array([5.0, 13.0, 20.0])
    mean, cov = walk.predict_model_and_drift(at, np.ones((3, 1)))
    assert_allclose(mean, np.interp(at, t, y), atol=1e-3)
    assert cov[0, 0] == pytest.approx(
        walk.hyperparameter_weights @ walk.hyperparameter_nodes[:, 0] * 5 * 5 / 10, rel=1e-3
    )
    assert cov[2, 2] < 1e-6


def test_drift_intervals_hold_whatever_drifts():
    rng, inside = np.random.default_rng(5), []
    t = np.sort(rng.uniform(0, 3600, 40))
    rest = np.arange(40) % 5 == 0
    for k in range(150):
        steps = rng.standard_normal(40) * np.sqrt(np.diff(t, prepend=0.0)) / 60.0
        true = np.cumsum(steps) if k % 2 else 3.0 * np.exp(-t / 1500.0)
        y = true[rest] + 0.05 * rng.standard_normal(rest.sum())
        mean, cov = fit_random_walk(t[rest], y, np.full(rest.sum(), 0.05)).predict_model_and_drift(
            t[~rest][:27], np.ones((27, 1))
        )
        inside.append(np.mean(np.abs(mean - true[~rest][:27]) < 1.96 * np.sqrt(np.diag(cov))))
    assert 0.92 <= np.mean(inside) <= 0.995


def test_no_drift_and_honest_readings_is_the_ordinary_fit():
    rng = np.random.default_rng(6)
    t, x = np.arange(60.0), np.column_stack([np.ones(60), np.linspace(0, 1, 60)])
    y = x @ [1.0, 2.0] + 0.1 * rng.standard_normal(60)
    b, cov = fit_random_walk(t, y, np.full(60, 0.1), x).estimate_coefficients()
    assert_allclose(b, np.linalg.lstsq(x, y, rcond=None)[0], atol=0.03)
    # A trend beside a drift that is not known to be absent is less certain, but not by much.
    ratio = np.sqrt(np.diag(cov)) / (0.1 * np.sqrt(np.diag(np.linalg.inv(x.T @ x))))
    assert np.all((ratio > 0.95) & (ratio < 2.2))


def test_density_of_air():
    # Dry air at 20 C, 101325 Pa: 1.2046 (CIPM-2007); OIML R 111-1's short formula holds to 2e-4 around it.
    assert compute_moist_air_density(101325.0, 293.15) == pytest.approx(1.2046, abs=1e-4)
    p, t, h = 95000.0, 298.15, 0.6
    short = (0.34848 * p / 100 - 0.009 * 100 * h * np.exp(0.061 * (t - 273.15))) / t
    assert compute_moist_air_density(p, t, h) == pytest.approx(short, rel=2e-4)
    doubt = {"pressure_std_Pa": 0.0, "temperature_std_K": 0.3, "humidity_std": 0.0}
    assert compute_relative_density_std(101325.0, 293.15, 0.0, **doubt) == pytest.approx(0.3 / 293.15, rel=0.01)
