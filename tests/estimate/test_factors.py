"""The factors of a covariance do what the covariance itself would, in 32 bits too."""

import numpy as np
import pytest

from mufly.estimate.factors import (
    MOVING,
    assembled,
    block,
    carry,
    expected,
    factorise,
    forget,
    loosen,
    observe,
    sigmas,
)

N = 25


def _covariance(rng: np.random.Generator) -> np.ndarray:
    a = rng.standard_normal((N, N)) * 10.0 ** rng.uniform(-2, 1, N)[:, None]
    return a @ a.T + 1e-6 * np.eye(N)


def _step(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    top = np.hstack([np.eye(MOVING), np.zeros((MOVING, N - MOVING))]) + 0.1 * rng.standard_normal((MOVING, N))
    return top, rng.uniform(0.8, 1.0, N), np.where(np.arange(N) < 3, 0.0, rng.uniform(0, 1, N))


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_filter_by_factors_is_the_kalman_filter(kind: type) -> None:
    """A hundred steps and measurements beside the textbook's equations in double precision."""
    rng = np.random.default_rng(1)
    p = _covariance(rng)
    ut, d = (a.astype(kind) for a in factorise(p))
    work = np.zeros((2 * N, N), kind), np.zeros(2 * N, kind), np.zeros(N, kind)
    f, gain = np.zeros(N, kind), np.zeros(N, kind)
    tolerance = 1e-9 if kind is np.float64 else 2e-3
    for _ in range(100):
        top, decay, q = _step(rng)
        big = np.diag(decay)
        big[:MOVING] = top
        g = np.eye(N)
        g[range(3), range(3, 6)] = 0.002
        p = big @ p @ big.T + (g * q) @ g.T
        carry(ut, d, top.astype(kind), decay.astype(kind), q.astype(kind), kind(0.002), *work)
        h, r = rng.standard_normal(N), 0.3
        spread = h @ p @ h
        assert expected(ut, d, h.astype(kind), f) == pytest.approx(spread, rel=tolerance)
        k = p @ h / (spread + r)
        observe(ut, d, f, kind(r), gain)
        assert np.allclose(gain, k, rtol=tolerance, atol=tolerance * np.abs(k).max())
        p = p - np.outer(k, h @ p)
        p = 0.5 * (p + p.T)
        assert np.all(d > 0)
        scale = np.sqrt(np.outer(np.diag(p), np.diag(p)))
        assert np.abs(assembled(ut, d) - p).max(where=scale > 0, initial=0) < tolerance * scale.max()
    out, nine = np.zeros(N, kind), np.zeros((9, 9), kind)
    sigmas(ut, d, out)
    block(ut, d, 9, nine)
    assert np.allclose(out, np.sqrt(np.diag(p)), rtol=tolerance)
    assert np.allclose(nine, p[:9, :9], atol=tolerance * np.abs(p[:9, :9]).max())


@pytest.mark.parametrize("j", [0, 7, 15, N - 1])
def test_a_state_can_be_loosened_and_forgotten(j: int) -> None:
    p = _covariance(np.random.default_rng(2))
    ut, d = factorise(p)
    loosen(ut, d, j, 4.0, np.zeros(N))
    p[j, j] += 4.0
    assert np.allclose(assembled(ut, d), p)
    forget(ut, d, j, 9.0, np.zeros(N))
    p[j], p[:, j] = 0.0, 0.0
    p[j, j] = 9.0
    assert np.allclose(assembled(ut, d), p)
