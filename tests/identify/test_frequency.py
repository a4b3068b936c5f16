"""Frequency responses against the transfer functions that made the data."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mufly.errors import InputError
from mufly.identify.linear.frequency import frequency_response, misfit, state_space_response

DT = 0.02
A = np.exp(-3.0 * DT)


def lag(u):
    """First-order lag of 3 rad/s behind a zero-order hold."""
    return lfilter([0.0, 1.0 - A], [1.0, -A], u)


def truth(frequency_hz):
    z = np.exp(2j * np.pi * frequency_hz * DT)
    return (1.0 - A) / (z - A)


def made(seed=0, n=60_000, noise=0.0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(n, 2))
    u[:, 1] += 0.7 * u[:, 0]  # inputs that move together
    y = np.column_stack([lag(u[:, 0]) - 0.5 * u[:, 1], lag(u[:, 1])])
    return u, y + noise * rng.normal(size=y.shape)


def test_response_of_correlated_inputs_is_told_apart():
    u, y = made()
    r = frequency_response(u, y, DT, segment_s=20.0, low_hz=0.1, high_hz=10.0, points=40)
    h = truth(r.frequency_hz)
    assert r.response[:, 0, 0] == pytest.approx(h, abs=0.03)
    assert r.response[:, 0, 1] == pytest.approx(-0.5, abs=0.03)
    assert np.abs(r.response[:, 1, 0]).max() < 0.03
    assert r.coherence.min() > 0.99


def test_multiple_coherence_is_the_signals_share_of_the_power():
    rng = np.random.default_rng(1)
    u = rng.normal(size=(200_000, 1))
    y = u + rng.normal(size=u.shape)
    r = frequency_response(u, y, DT, segment_s=5.0, low_hz=1.0, high_hz=20.0, points=30)
    assert r.coherence.mean() == pytest.approx(0.5, abs=0.02)
    assert r.partial[:, 0, 0] == pytest.approx(r.coherence[:, 0])


def test_partial_coherence_of_an_input_without_effect_vanishes():
    rng = np.random.default_rng(2)
    u = rng.normal(size=(100_000, 2))
    u[:, 1] += u[:, 0]
    y = u[:, :1] + 0.3 * rng.normal(size=(100_000, 1))
    r = frequency_response(u, y, DT, segment_s=5.0, low_hz=1.0, high_hz=20.0, points=30)
    assert r.partial[:, 0, 1].max() < 0.03
    assert r.partial[:, 0, 0].min() > 0.8


def test_random_error_is_the_scatter_over_records():
    found, stated = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        u = rng.normal(size=(5000, 1))
        y = u + 1.5 * rng.normal(size=u.shape)
        r = frequency_response(u, y, DT, segment_s=5.0, low_hz=1.0, high_hz=20.0, points=12)
        found.append(np.abs(r.response[:, 0, 0]))
        stated.append(r.error[:, 0, 0] * np.abs(r.response[:, 0, 0]))
    assert np.mean(stated) == pytest.approx(np.std(found, axis=0).mean(), rel=0.25)


def test_chirp_z_transform_puts_frequencies_where_they_are_asked_for():
    u, y = made(3, 20_000)
    r = frequency_response(u, y, DT, segment_s=10.0, low_hz=0.37, high_hz=1.23, points=7)
    assert r.frequency_hz == pytest.approx(np.linspace(0.37, 1.23, 7))
    assert r.response[:, 1, 1] == pytest.approx(truth(r.frequency_hz), abs=0.05)


def test_several_records_are_averaged_and_a_still_input_is_no_answer():
    u, y = made(4, 20_000)
    both = frequency_response([u, u], [y, y], DT, segment_s=10.0, low_hz=0.2, high_hz=5.0, points=9)
    one = frequency_response(u, y, DT, segment_s=10.0, low_hz=0.2, high_hz=5.0, points=9)
    assert both.response == pytest.approx(one.response)
    assert both.averages == pytest.approx(2 * one.averages)
    still = frequency_response(np.c_[u[:, 0], 0 * u[:, 1]], y, DT, segment_s=10.0, low_hz=0.2, high_hz=5.0)
    assert np.isnan(still.response[:, :, 1]).all()


def test_state_space_response_with_delay_is_the_closed_form():
    f = np.array([0.1, 1.0, 4.0])
    h = state_space_response(
        np.array([[-3.0]]), np.array([[3.0]]), np.eye(1), np.zeros((1, 1)), f, np.array([0.1])
    )
    s = 2j * np.pi * f
    assert h[:, 0, 0] == pytest.approx(3.0 / (s + 3.0) * np.exp(-0.1 * s))


def test_misfit_of_the_truth_is_small_and_of_6_dB_and_45_degrees_is_that_of_the_formula():
    u, _ = made(5)
    r = frequency_response(u[:, :1], lag(u[:, :1].T).T, DT, segment_s=20.0, low_hz=0.1, high_hz=5.0)
    exact = truth(r.frequency_hz)[:, None, None]
    assert misfit(r, exact)[0, 0] < 0.5
    off = misfit(r, r.response * 2.0 * np.exp(0.25j * np.pi))[0, 0]
    weight = (1.58 * (1.0 - np.exp(-r.partial[:, 0, 0]))) ** 2
    assert off == pytest.approx(
        20.0 * weight.mean() * ((20 * np.log10(2.0)) ** 2 + 0.01745 * 45.0**2), rel=1e-6
    )


@pytest.mark.parametrize(("low", "high", "segment"), [(1.0, 0.5, 5.0), (0.1, 30.0, 5.0), (0.1, 5.0, 1e4)])
def test_what_cannot_be_had_is_refused_in_one_line(low, high, segment):
    u, y = made(6, 1000)
    with pytest.raises(InputError, match="frequency response"):
        frequency_response(u, y, DT, segment_s=segment, low_hz=low, high_hz=high)
