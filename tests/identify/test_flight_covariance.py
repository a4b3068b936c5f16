"""Uncertainty of linear problems, where everything is known in closed form."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mufly.identify.fit_result import (
    coloured_covariance,
    covariance_from_information,
    describe_undetermined_combinations,
    find_largest_correlated_lag,
)
from mufly.identify.flight_record import low_pass
from mufly.identify.linear.equation_error import regress_rate_derivatives
from mufly.identify.linear.linear_fit import fit_linear_model, simulate_linear_fit
from mufly.identify.linear.linear_structure import build_structure_by_name, simulate_linear_structure


def undetermined(names, jacobian, covariance):
    return describe_undetermined_combinations(names, covariance_from_information(jacobian.T @ jacobian), covariance)


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
    c, _, coloured = coloured_covariance([s], [draw()], np.full(3, np.inf))
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
        c, _, coloured = coloured_covariance([s], [e], np.full(3, np.inf))
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
    c, _, _ = coloured_covariance([s, s], [draw(), draw()], prior)
    information = 2 * s[:, 0].T @ s[:, 0] + np.diag([100.0, 25.0, 0.0])
    assert np.allclose(c, np.linalg.inv(information), rtol=1e-8)


def test_reach_of_white_and_of_coloured_noise():
    rng = np.random.default_rng(3)
    white = [find_largest_correlated_lag(rng.standard_normal(2000), 300) for _ in range(40)]
    assert np.mean(np.array(white) > 0) < 0.2
    slow = lfilter([1], [1, -0.95], rng.standard_normal(3000))
    assert 20 < find_largest_correlated_lag(slow, 300) <= 300


def test_a_parameter_without_effect_is_named():
    j = np.column_stack([np.ones(10), np.zeros(10)]) * 10
    said = undetermined(("a", "b"), j, np.diag([1e-3, 1.0]))
    assert len(said) == 1
    assert said[0].startswith("b is not determined")


@pytest.mark.parametrize(("sign", "words"), [(1.0, "the product"), (-1.0, "the ratio")])
def test_two_that_act_together_are_named(sign, words):
    x = 100 * np.random.default_rng(0).standard_normal(50)
    j = np.column_stack([x, sign * x, 100 * np.ones(50)])
    said = undetermined(("a", "b", "c"), j, np.diag([1.0, 1.0, 1e-4]))
    assert len(said) == 1
    assert words in said[0]
    assert "a" in said[0]
    assert "b" in said[0]


def test_three_in_one_direction_are_named_with_their_shares():
    rng = np.random.default_rng(0)
    j = 100 * rng.standard_normal((50, 3))
    v = np.array([1.0, 0.5, -0.5]) / np.sqrt(1.5)
    said = undetermined(("a", "b", "c"), j - np.outer(j @ v, v), np.eye(3))
    assert "determined only in combination" in said[0]


def test_a_close_pair_is_named_with_its_correlation():
    c = np.array([[1e-4, -0.9999e-4], [-0.9999e-4, 1e-4]])
    said = undetermined(("cT_up", "cT_dw"), 1e3 * np.eye(2), c)
    assert len(said) == 1
    assert "correlation -0.9999" in said[0]
    assert "sum" in said[0]


def test_a_close_pair_that_is_known_well_anyway_is_not_worth_a_word():
    c = 1e-8 * np.array([[1.0, 0.999], [0.999, 1.0]])
    assert undetermined(("a", "b"), 1e5 * np.eye(2), c) == ()


def made(n=900, pole=0.9):
    """A first-order roll, its noise coloured."""
    rng = np.random.default_rng(5)
    structure = build_structure_by_name("first-order", ("lat",), ("p",))
    u = lfilter([0.2], [1, -0.8], np.repeat(rng.normal(size=n // 20), 20))[:, None]
    y, _ = simulate_linear_structure(structure, np.array([-4.0, 10.0, 0.06]), u, 0.04)
    return (
        structure,
        u,
        y + 0.05 * lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.normal(size=y.shape), axis=0),
    )


def test_a_linear_fit_has_the_covariance_of_flights():
    """Before there was one: the same sensitivities and residuals gave two covariances."""
    structure, u, y = made()
    f = fit_linear_model(structure, u, y, 0.04, starts=1)
    assert not f.at_bound.any()
    predicted, _ = simulate_linear_fit(f, u, 0.04)
    columns = []
    for k, v in enumerate(f.values):
        ends = [f.values + side * 1e-4 * abs(v) * np.eye(3)[k] for side in (1, -1)]
        a, b = (simulate_linear_structure(structure, e, u - f.input_trim, 0.04, x0=f.x0)[0] for e in ends)
        columns.append((a - b)[:, 0] / (2e-4 * abs(v)))
    s = np.column_stack(columns)
    # What starts, trim and bias could make up for is not the parameters'.
    free = np.exp(f.values[0] * 0.04 * np.arange(len(u)))
    q, _ = np.linalg.qr(np.column_stack([free, np.ones(len(u))]))
    e = y - predicted
    c, bound, coloured = coloured_covariance([(s - q @ (q.T @ s))[:, None, :] / e.std()], [e / e.std()])
    assert coloured
    assert np.allclose(np.sqrt(np.diag(f.covariance)), np.sqrt(np.diag(c)), rtol=0.02)
    assert np.allclose(np.sqrt(np.diag(f.cramer_rao_bound)), np.sqrt(np.diag(bound)), rtol=0.02)


def test_so_has_the_equation_error():
    _, u, y = made()
    found = regress_rate_derivatives(y, u, 0.04, rate_names=("p",), input_names=("lat",), cut_hz=2.0)
    smooth = low_pass(np.column_stack([y, u]), 0.04, 2.0)
    rows = np.column_stack([smooth, np.ones(len(y))])
    slope = np.gradient(smooth[:, 0], 0.04)
    e = slope - rows @ np.linalg.lstsq(rows, slope, rcond=None)[0]
    c, _, _ = coloured_covariance([rows[:, None, :] / e.std()], [e[:, None] / e.std()])
    assert [found[k][1] for k in ("L_p", "L_lat")] == pytest.approx(np.sqrt(np.diag(c))[:2])


def test_a_parameter_that_nothing_knows_of_has_no_finite_deviation():
    s, draw = linear(500, 0.0, np.random.default_rng(4))
    s[:, :, 1] = 0.0
    c, bound, _ = coloured_covariance([s], [draw()])
    assert np.isfinite(np.diag(c)).tolist() == [True, False, True]
    assert bound[1, 1] == np.inf
    assert describe_undetermined_combinations(("a", "b", "c"), c) == ("b is not determined by the data",)
