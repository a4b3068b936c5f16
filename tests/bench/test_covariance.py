"""Covariance of least squares: the textbook case, drifting errors and repeated ones, against Monte Carlo."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.bench import estimate_parameter_covariance


def line(n):
    return np.column_stack([np.ones(n), np.linspace(-1, 1, n)])


def test_white_errors_give_the_textbook_covariance():
    rng = np.random.default_rng(1)
    a = line(30)
    y = a @ [1.0, 2.0] + rng.standard_normal(30) * 0.1
    r = y - a @ np.linalg.lstsq(a, y, rcond=None)[0]
    s = estimate_parameter_covariance(a, r)
    assert s.pattern == "white"
    assert_allclose(s.covariance, np.linalg.inv(a.T @ a) * (r @ r) / 28, atol=1e-15)
    assert s.dof == pytest.approx(28)
    assert s.t_quantile_95 == pytest.approx(2.048, abs=1e-3)


def coverage(errors, n, trials=200, **kw):
    rng = np.random.default_rng(7)
    a, hits, patterns, stds, slopes = line(n), 0, [], [], []
    for _ in range(trials):
        y = errors(rng)
        solution = np.linalg.lstsq(a, y, rcond=None)[0]
        s = estimate_parameter_covariance(a, y - a @ solution, **kw)
        std = np.sqrt(np.diag(s.covariance))
        hits += int(np.sum(np.abs(solution) < s.t_quantile_95 * std))
        patterns.append(s.pattern)
        stds.append(std[1])
        slopes.append(solution[1])
    return hits / (2 * trials), patterns, np.mean(stds) / np.std(slopes)


def test_intervals_hold_for_white_errors():
    held, patterns, ratio = coverage(lambda rng: rng.standard_normal(24), 24)
    assert 0.92 < held < 0.98
    assert patterns.count("white") > 160
    assert ratio == pytest.approx(1, abs=0.12)


def test_intervals_hold_for_drifting_errors():
    def errors(rng):
        e = np.empty(40)
        e[0] = rng.standard_normal()
        for k in range(1, 40):
            e[k] = 0.7 * e[k - 1] + np.sqrt(1 - 0.49) * rng.standard_normal()
        return e

    held, patterns, _ = coverage(errors, 40)
    assert patterns.count("drift") > 150
    assert held > 0.87  # the textbook formula holds in 56 %


def test_repeats_do_not_count_as_independent():
    group = np.repeat(np.arange(8), 5)

    def errors(rng):
        return rng.standard_normal(8)[group] + 0.3 * rng.standard_normal(40)

    held, patterns, _ = coverage(errors, 40, group=group)
    assert patterns.count("white") < 5
    assert held > 0.88  # 56 % if each repeat counted


def test_a_known_scale_only_grows():
    a = line(20)
    r = np.sin(np.arange(20) * 2.3) * 0.01
    assert_allclose(
        estimate_parameter_covariance(a, r, known_scale=True).covariance, np.linalg.inv(a.T @ a), rtol=1e-6, atol=1e-14
    )
    big = estimate_parameter_covariance(a, 300 * r, known_scale=True)
    assert big.covariance[0, 0] > 2 * np.linalg.inv(a.T @ a)[0, 0]
