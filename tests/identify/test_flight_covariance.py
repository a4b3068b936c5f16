"""Uncertainty of linear problems, where everything is known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from mufly.identify.covariance import colour_reach, covariance_of, unseen_in_words


def free(*names):
    return [SimpleNamespace(symbol=n) for n in names]


def linear(n, colour, rng, t=3):
    """Sensitivities (n, 1, t), and a function that draws a residual of unit variance."""
    time = np.arange(n) * 0.01
    s = np.column_stack([np.sin((k + 1) * time) for k in range(t)])[:, None, :]

    def draw():
        e = rng.standard_normal(n + 500)
        e = lfilter([np.sqrt(1 - colour**2)], [1, -colour], e)[500:]
        return e[:, None]

    return s, draw


def test_white_residuals_give_the_cramer_rao_bound():
    s, draw = linear(2000, 0.0, np.random.default_rng(0))
    c, coloured = covariance_of([s], [draw()], np.full(3, np.inf))
    assert not coloured
    assert np.allclose(c, np.linalg.inv(s[:, 0].T @ s[:, 0]), rtol=1e-9)


@pytest.mark.parametrize("colour", [0.5, 0.9])
def test_coloured_residuals_give_the_scatter_of_the_estimates(colour):
    s, draw = linear(3000, colour, np.random.default_rng(1))
    a = s[:, 0]
    scatter = np.cov(np.array([np.linalg.lstsq(a, draw()[:, 0], rcond=None)[0] for _ in range(800)]).T)
    found = []
    for _ in range(30):
        e = draw()
        e = e - (a @ np.linalg.lstsq(a, e[:, 0], rcond=None)[0])[:, None]
        c, coloured = covariance_of([s], [e], np.full(3, np.inf))
        assert coloured
        found.append(np.sqrt(np.diag(c)))
    ratio = np.mean(found, axis=0) / np.sqrt(np.diag(scatter))
    assert np.all((ratio > 0.8) & (ratio < 1.2))
    # ... and the bound for white residuals would have been far too small.
    white = np.sqrt(np.diag(np.linalg.inv(a.T @ a)))
    assert np.all(white < 0.65 * np.sqrt(np.diag(scatter)))


def test_records_add_up_and_the_prior_counts_as_a_measurement():
    s, draw = linear(500, 0.0, np.random.default_rng(2))
    prior = np.array([0.1, 0.2, np.inf])
    c, _ = covariance_of([s, s], [draw(), draw()], prior)
    information = 2 * s[:, 0].T @ s[:, 0] + np.diag([100.0, 25.0, 0.0])
    assert np.allclose(c, np.linalg.inv(information), rtol=1e-8)


def test_reach_of_white_and_of_coloured_noise():
    rng = np.random.default_rng(3)
    white = [colour_reach(rng.standard_normal(2000), 300) for _ in range(40)]
    assert np.mean(np.array(white) > 0) < 0.2
    slow = lfilter([1], [1, -0.95], rng.standard_normal(3000))
    assert 20 < colour_reach(slow, 300) <= 300


def test_a_parameter_without_effect_is_named():
    j = np.column_stack([np.ones(10), np.zeros(10)]) * 10
    said = unseen_in_words(free("a", "b"), j, np.diag([1e-3, 1.0]))
    assert len(said) == 1
    assert said[0].startswith("b is not seen")


@pytest.mark.parametrize(("sign", "words"), [(1.0, "together"), (-1.0, "the ratio")])
def test_two_that_act_together_are_named(sign, words):
    x = 100 * np.random.default_rng(0).standard_normal(50)
    j = np.column_stack([x, sign * x, 100 * np.ones(50)])
    said = unseen_in_words(free("a", "b", "c"), j, np.diag([1.0, 1.0, 1e-4]))
    assert len(said) == 1
    assert words in said[0]
    assert "a" in said[0]
    assert "b" in said[0]


def test_three_in_one_direction_are_named_with_their_shares():
    rng = np.random.default_rng(0)
    j = 100 * rng.standard_normal((50, 3))
    v = np.array([1.0, 0.5, -0.5]) / np.sqrt(1.5)
    said = unseen_in_words(free("a", "b", "c"), j - np.outer(j @ v, v), np.eye(3))
    assert "seen only in combination" in said[0]


def test_a_close_pair_is_named_with_its_correlation():
    c = np.array([[1e-4, -0.9999e-4], [-0.9999e-4, 1e-4]])
    said = unseen_in_words(free("cT_up", "cT_dw"), 1e3 * np.eye(2), c)
    assert len(said) == 1
    assert "correlation -0.9999" in said[0]
    assert "sum" in said[0]


def test_a_close_pair_that_is_known_well_anyway_is_not_worth_a_word():
    c = 1e-8 * np.array([[1.0, 0.999], [0.999, 1.0]])
    assert unseen_in_words(free("a", "b"), 1e5 * np.eye(2), c) == ()
