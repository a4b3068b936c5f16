"""Consistency of errors with a covariance that is known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from mufly.estimate import Estimate, measure_row_consistency


def drawn_estimates(count: int, spread: np.ndarray) -> tuple[np.ndarray, list[Estimate]]:
    """True rows and estimates whose errors have the covariance that they state; ``spread`` (9,) are deviations."""
    rng = np.random.default_rng(4)
    mixed = 0.3 * rng.standard_normal((9, 9)) + np.eye(9)
    root = spread[:, None] * mixed
    covariance = root @ root.T
    errors = rng.standard_normal((count, 9)) @ root.T
    told = [
        Estimate(0.1 * k, e[:3], e[3:6], e[6:], np.zeros(3), np.zeros(4), 7.4, covariance, True)
        for k, e in enumerate(errors)
    ]
    return np.zeros((count, 9)), told


def test_each_block_of_exact_errors_is_consistent_and_a_narrow_one_is_seen() -> None:
    spread = np.array([0.05, 0.05, 0.01, 0.1, 0.1, 0.05, 0.01, 0.01, 0.03])
    true, told = drawn_estimates(4000, spread)
    found = measure_row_consistency(true, told, every=1)
    assert found.block_nees == pytest.approx((1.0, 1.0, 1.0, 1.0), abs=0.06)
    assert found.block_inside_shares == pytest.approx((0.95,) * 4, abs=0.012)
    # A heading error of twice its deviation: one of nine components, which the whole ellipsoid hardly shows
    for e in told:
        e.attitude[2] *= 2.0
    narrow = measure_row_consistency(true, told, every=1)
    assert narrow.block_nees[3] == pytest.approx(4.0, rel=0.1)
    assert narrow.block_nees[:3] == pytest.approx(found.block_nees[:3])
