"""The factors of a covariance do what the covariance itself would, in 32 bits too."""

import numpy as np
import pytest

from mufly.estimate.filter.filter_records import PHASE_FLYING, PHASE_MOTORS_RUNNING
from mufly.estimate.filter.strapdown import error_transition, predict_state, rotate_attitude
from mufly.estimate.filter.ud_filter import (
    MOTION_STATE_COUNT,
    gauss_markov_update,
    inflate_variance,
    innovation_variance,
    propagate_error_column,
    state_variance,
    ud_measurement_update,
    ud_time_update,
)

N = 25
SPAN = 0.02


def ud_factorise(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the factors U^T (``ut``) and D (``d``) of a positive definite covariance (n, n)."""
    p = np.array(covariance, dtype=np.float64)
    n = len(p)
    ut, d = np.eye(n), np.zeros(n)
    for j in range(n - 1, -1, -1):
        d[j] = p[j, j]
        ut[j, :j] = p[:j, j] / d[j]
        p[:j, :j] -= d[j] * np.outer(ut[j, :j], ut[j, :j])
    return ut, d


def ud_covariance(ut: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the covariance P = U D U^T from its factors."""
    u = np.eye(len(d)) + np.tril(ut, -1).T
    return (u * d) @ u.T


def _covariance(rng: np.random.Generator) -> np.ndarray:
    a = rng.standard_normal((N, N)) * 10.0 ** rng.uniform(-2, 1, N)[:, None]
    return a @ a.T + 1e-6 * np.eye(N)


def _step(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Inputs of a block and a state with any attitude."""
    e = rng.standard_normal(22)
    e[15:18] = rng.uniform(0, 1, 3)
    e[21] = PHASE_FLYING
    x = rng.standard_normal(26)
    x[6:10] /= np.linalg.norm(x[6:10])
    return e, x


def _shifted(x: np.ndarray, error: np.ndarray) -> np.ndarray:
    """A state that errs by so much: turned about N, E, D, and the rest added to."""
    y = x.copy()
    y[:6] += error[:6]
    rotate_attitude(y, *error[6:9], False)
    y[10:] += error[9:]
    return y


def _apart(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Error of ``y`` against ``x``."""
    w, v = x[6], x[7:10]
    turn = w * y[7:10] - y[6] * v + np.cross(v, y[7:10])
    return np.concatenate([y[:6] - x[:6], 2 * turn, y[10:] - x[10:]])


def test_errors_move_as_states_do() -> None:
    """The matrix of transition is the slope of the nominal equations, but for what it says that it leaves out."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        e, x = _step(rng)
        e[12:15] = 0.0  # drag turns with the attitude; that is left out
        r, push, a = np.zeros(9), np.zeros(6), np.zeros(33)
        after = x.copy()
        predict_state(after, e, SPAN, r, push)
        error_transition(e, SPAN, r, push, a)
        for j in range(N):
            error = np.zeros(N)
            error[j] = 1e-6
            other = _shifted(x, error)
            predict_state(other, e, SPAN, r, push)
            right = _apart(after, other) / 1e-6
            column = error / 1e-6
            propagate_error_column(column, SPAN, a, column)
            assert np.allclose(column[:9], right[:9], atol=2e-4), j
        # On its legs what the floor pushes does not turn with the attitude.
        e[21] = PHASE_MOTORS_RUNNING
        error_transition(e, SPAN, r, push, a)
        assert push.any()
        assert not a[30:].any()


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_filter_by_factors_is_the_kalman_filter(kind: type) -> None:
    """A hundred steps and measurements beside the textbook's equations in double precision."""
    rng = np.random.default_rng(1)
    p = _covariance(rng)
    ut, d = (a.astype(kind) for a in ud_factorise(p))
    f, gain = np.zeros(N, kind), np.zeros(N, kind)
    tolerance = 1e-9 if kind is np.float64 else 2e-3
    for step in range(100):
        e, x = _step(rng)
        r, push, a = np.zeros(9), np.zeros(6), np.zeros(33)
        predict_state(x, e, SPAN, r, push)
        error_transition(e, SPAN, r, push, a)
        big = np.eye(N)
        for j in range(N):
            column = np.eye(N)[j]
            propagate_error_column(column, SPAN, a, column)
            big[:, j] = column
        q = rng.uniform(0, 1, 9)
        g = np.eye(N)[:, :MOTION_STATE_COUNT]
        g[range(3), range(3, 6)] = 0.5 * SPAN
        p = big @ p @ big.T + (g * q) @ g.T
        ud_time_update(ut, d, SPAN, a.astype(kind), q.astype(kind), np.zeros((3, 6), kind), f)
        bias, keep, more = MOTION_STATE_COUNT + step % (N - MOTION_STATE_COUNT), 0.9, rng.uniform(0, 1)
        p[bias] *= keep
        p[:, bias] *= keep
        p[bias, bias] += more
        gauss_markov_update(ut, d, bias, kind(keep), kind(more), f)
        assert np.all(np.triu(ut, 1) == 0.0)
        assert np.all(np.diag(ut) == 1.0)
        at = rng.permutation(N)[:4].astype(np.int32)
        h, r_ = rng.standard_normal(4), 0.3
        row = np.zeros(N)
        row[at] = h
        spread = row @ p @ row
        assert innovation_variance(ut, d, at, h.astype(kind), 4, f) == pytest.approx(spread, rel=tolerance)
        k = p @ row / (spread + r_)
        ud_measurement_update(ut, d, f, kind(r_), gain)
        assert np.allclose(gain, k, rtol=tolerance, atol=tolerance * np.abs(k).max())
        p = p - np.outer(k, row @ p)
        p = 0.5 * (p + p.T)
        assert np.all(d > 0)
        scale = np.sqrt(np.outer(np.diag(p), np.diag(p)))
        assert np.abs(ud_covariance(ut, d) - p).max(where=scale > 0, initial=0) < tolerance * scale.max()
    assert np.allclose([state_variance(ut, d, i) for i in range(N)], np.diag(p), rtol=tolerance)


@pytest.mark.parametrize("j", [0, 7, 15, N - 1])
def test_a_state_can_be_loosened(j: int) -> None:
    p = _covariance(np.random.default_rng(2))
    ut, d = ud_factorise(p)
    inflate_variance(ut, d, j, 4.0, np.zeros(N))
    p[j, j] += 4.0
    assert np.allclose(ud_covariance(ut, d), p)
