from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.control import connect_blocks, frequency_response, hinf_norm, singular_values
from mufly.control.linear_systems import _closed_loop_poles, is_stable_loop, replace_matrices, state_space
from mufly.errors import MuflyError


@given(st.floats(0.01, 0.6), st.floats(0.1, 1e3))
@settings(max_examples=40, deadline=None)
def test_norm_of_a_resonance_has_its_closed_form(damping: float, frequency: float) -> None:
    system = ct.ss(ct.tf([frequency**2], [1, 2 * damping * frequency, frequency**2]))
    norm, where = hinf_norm(system)
    assert norm == pytest.approx(1 / (2 * damping * np.sqrt(1 - damping**2)), rel=1e-5)
    assert where == pytest.approx(frequency * np.sqrt(1 - 2 * damping**2), rel=2e-2)


def test_norm_at_zero_and_at_infinite_frequency_and_of_a_gain() -> None:
    assert hinf_norm(ct.ss(ct.tf([3], [1, 1])))[0] == pytest.approx(3.0)
    high, where = hinf_norm(ct.ss(ct.tf([2, 1], [1, 10])))
    assert high == pytest.approx(2.0)
    assert where == np.inf
    gain = ct.ss(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.diag([1.0, -4.0]))
    assert hinf_norm(gain)[0] == pytest.approx(4.0)


def test_norm_of_an_unstable_system_is_infinite() -> None:
    assert hinf_norm(ct.ss(ct.tf([1], [1, -1])))[0] == np.inf


@given(st.integers(1, 8), st.integers(1, 3), st.integers(1, 3), st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_norm_is_not_below_a_dense_grid_and_is_attained(n: int, inputs: int, outputs: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
    system = ct.ss(A, rng.normal(size=(n, inputs)), rng.normal(size=(outputs, n)), rng.normal(size=(outputs, inputs)))
    norm, where = hinf_norm(system)
    grid = singular_values(system, np.geomspace(1e-4, 1e4, 3000))[:, 0].max()
    assert norm >= grid * (1 - 1e-5)
    if np.isfinite(where):
        assert norm == pytest.approx(singular_values(system, np.array([where]))[0, 0], rel=1e-9)


@pytest.mark.parametrize("through", [0.0, 0.7])
def test_connect_closes_a_loop_as_feedback_does(through: float) -> None:
    A, B, C, _ = ct.ssdata(ct.ss(ct.tf([2, 1, 3], [1, 3, 5, 4])))
    G = state_space(A, B, C, np.array([[through]]), inputs=["u"], outputs=["y"])
    K = state_space(*ct.ssdata(ct.ss(ct.tf([2, 1], [1, 5]))), inputs=["e"], outputs=["v"])
    loop = connect_blocks(
        [G, K], {"u": {"v": 1.0}, "e": {"r": 1.0, "y": -1.0}, "s": {"r": 1.0, "y": -1.0}}, ["r"], ["y", "s"]
    )
    frequency = np.geomspace(1e-2, 1e2, 30)
    L = (frequency_response(G, frequency) @ frequency_response(K, frequency))[:, 0, 0]
    response = frequency_response(loop, frequency)
    np.testing.assert_allclose(response[:, 0, 0], L / (1 + L), rtol=1e-9)
    np.testing.assert_allclose(response[:, 1, 0], 1 / (1 + L), rtol=1e-9)
    # Whether such a loop is stable is asked without closing the diagram.
    for factor in (1.0, -1.0):
        turned = replace_matrices(K, C=factor * K.C, D=factor * K.D)
        closed = connect_blocks([G, turned], {"u": {"v": 1.0}, "e": {"y": -1.0}}, ["r"], ["y"])
        poles = np.linalg.eigvals(closed.A)
        assert is_stable_loop(G, turned) == (poles.real.max() < 0.0)
        np.testing.assert_allclose(np.sort_complex(_closed_loop_poles(G, turned)), np.sort_complex(poles), atol=1e-8)


def test_connect_names_an_unknown_signal_and_a_singular_loop() -> None:
    gain = state_space(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1), inputs=["a"], outputs=["b"])
    with pytest.raises(MuflyError, match="unknown signal 'c'"):
        connect_blocks([gain], {"a": {"c": 1.0}}, ["r"], ["b"])
    with pytest.raises(MuflyError, match="algebraic loop"):
        connect_blocks([gain], {"a": {"b": 1.0, "r": 1.0}}, ["r"], ["b"])
