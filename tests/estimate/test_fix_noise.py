"""The position fix: its estimated variances against a scalar Kalman filter, and the row of a late fix."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mufly.estimate.filter.filter_records import (
    AID_COUNT,
    AID_POSITION,
    ERROR_ATTITUDE,
    MAX_H_TERMS,
    NOMINAL_ATTITUDE,
    STATE_COUNT,
)
from mufly.estimate.filter.measurements import fix_fusion, scalar_fusion

NOISE_M, WANDER_M, TIME_S, PERIOD_S = 0.005, 0.03, 2.0, 0.0667
estimate = fix_fusion._estimate_fix_noise.py_func


def memory() -> SimpleNamespace:
    return SimpleNamespace(
        noise_scale=np.ones(AID_COUNT), bias_walk_scale=np.ones(AID_COUNT), fix_ratio=np.zeros(4),
        fix_ratio_prev=np.zeros(4), fix_ratio_mean=np.zeros(4), is_heading_aligned=1,
    )  # fmt: skip


@pytest.mark.parametrize(("noise", "wander"), [(1.0, 1.0), (3.0, 1.0), (1.0, 2.0), (2.0, 2.0)])
def test_variances_come_to_those_of_the_truth(noise: float, wander: float) -> None:
    """Means over the second half of 8000 fixes (9 minutes); the file has ``noise = wander = 1``."""
    rng, m, keep = np.random.default_rng(3), memory(), np.exp(-PERIOD_S / TIME_S)
    true, bias, variance = rng.normal(0.0, wander * WANDER_M, 3), np.zeros(3), np.full(3, WANDER_M**2)
    scales = []
    for _ in range(8000):
        true = keep * true + rng.normal(0.0, wander * WANDER_M * np.sqrt(1 - keep**2), 3)
        bias, variance = keep * bias, keep**2 * variance + WANDER_M**2 * m.bias_walk_scale[AID_POSITION] * (1 - keep**2)
        spread = variance + NOISE_M**2 * m.noise_scale[AID_POSITION]
        off = true + rng.normal(0.0, noise * NOISE_M, 3) - bias
        for i in range(3):
            m.fix_ratio[i] = off[i] / np.sqrt(spread[i])
            estimate(m, i)
        bias, variance = bias + variance / spread * off, variance * (1 - variance / spread)
        scales.append((m.noise_scale[AID_POSITION], m.bias_walk_scale[AID_POSITION]))
    found = np.sqrt(np.mean(scales[4000:], axis=0))
    np.testing.assert_allclose(found, [noise, wander], rtol=0.25)


def test_a_lasting_error_of_one_sign_is_no_noise() -> None:
    m = memory()
    m.fix_ratio_mean[0] = 2.0
    for _ in range(200):
        m.fix_ratio[0] = 3.0
        estimate(m, 0)
    assert m.noise_scale[AID_POSITION] == m.bias_walk_scale[AID_POSITION] == 1.0


@pytest.mark.parametrize("ahead_s", [0.0, -0.15, -0.25])
def test_the_row_of_a_late_fix_is_the_slope_of_its_prediction(monkeypatch: pytest.MonkeyPatch, ahead_s: float) -> None:
    """A fix taken before the horizon measures the place of then: position and velocity of the horizon count."""
    for name in ("h_row_begin", "h_row_add"):
        monkeypatch.setattr(fix_fusion, name, getattr(scalar_fusion, name).py_func)
    m = SimpleNamespace(
        h_value=np.zeros(MAX_H_TERMS), h_state_index=np.zeros(MAX_H_TERMS, int), x=np.zeros(STATE_COUNT), yaw_rate=0.5
    )
    m.x[:] = np.random.default_rng(4).normal(0.0, 0.5, STATE_COUNT)
    m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4] = 1.0, 0.0, 0.0, 0.0
    innovation = fix_fusion._fix_innovation.py_func
    linear = [k for k in range(STATE_COUNT) if not NOMINAL_ATTITUDE <= k < NOMINAL_ATTITUDE + 4]
    for i in range(2):
        fix_fusion._fix_h_row.py_func(m, i, ahead_s)
        row = np.zeros(STATE_COUNT)
        for state, h in zip(m.h_state_index[: m.h_term_count], m.h_value[: m.h_term_count], strict=True):
            assert not ERROR_ATTITUDE <= state < ERROR_ATTITUDE + 3
            row[state + (state >= ERROR_ATTITUDE)] = h
        before = innovation(m, np.zeros(4), i, ahead_s)
        for k in linear:
            m.x[k] += 1.0
            assert before - innovation(m, np.zeros(4), i, ahead_s) == pytest.approx(row[k], abs=1e-12)
            m.x[k] -= 1.0
