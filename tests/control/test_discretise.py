from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.control import (
    FlightController,
    analyse_loop,
    discretise_controller,
    frequency_response,
    sample_plant,
)
from mufly.control.linear_systems import extract_feedback_controller, state_space
from mufly.errors import MuflyError


def random_system(seed: int, n: int = 5):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.2) * np.eye(n)
    return state_space(
        A,
        rng.normal(size=(n, 3)),
        rng.normal(size=(2, n)),
        rng.normal(size=(2, 3)),
        inputs=["a", "b", "c"],
        outputs=["d", "e"],
    )


@given(st.integers(0, 5000), st.sampled_from([1e-3, 5e-3, 2e-2]))
@settings(max_examples=40, deadline=None)
def test_bilinear_rule(seed: int, period: float) -> None:
    """H_d(e^jwT) = H(j 2/T tan(wT/2)): exact at zero, warped above."""
    system = random_system(seed)
    d = discretise_controller(system, np.zeros((5, 2)), period)
    frequency = np.array([0.0, 0.3, 3.0, 0.9 * np.pi / period])
    warped = 2 / period * np.tan(frequency * period / 2)
    np.testing.assert_allclose(
        frequency_response(d.to_state_space(), frequency),
        frequency_response(system, warped),
        rtol=1e-6,
        atol=1e-8,
    )
    assert np.abs(np.linalg.eigvals(d.A)).max() < 1


def test_equal_modes_fall_back_to_a_schur_form() -> None:
    chain = state_space(
        -np.eye(3) + np.diag([1.0, 1.0], 1),
        np.ones((3, 1)),
        np.ones((1, 3)),
        np.zeros((1, 1)),
        inputs=["e"],
        outputs=["u"],
    )
    d = discretise_controller(chain, np.zeros((3, 1)), 0.01)
    assert d.form == "schur"
    assert frequency_response(d.to_state_space(), np.array([0.0]))[0, 0, 0].real == pytest.approx(
        frequency_response(chain, np.array([0.0]))[0, 0, 0].real
    )


def test_the_observers_anti_windup_is_the_continuous_one() -> None:
    """While saturated it runs as A - M C, which forgets as fast as in continuous time."""
    system, actuation = random_system(4), np.full((5, 2), 0.05)
    d = discretise_controller(system, actuation, 1e-3)
    assert d.anti_windup == "observer"
    held = np.log(np.linalg.eigvals(d.A - d.M @ d.C)) / 1e-3
    wanted = np.linalg.eigvals(system.A - actuation @ system.C)
    np.testing.assert_allclose(np.sort_complex(held), np.sort_complex(wanted), rtol=0.02)


def test_a_mode_that_the_rule_cannot_step_through_is_named() -> None:
    A = np.diag([400.0, -1.0])
    system = state_space(A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), inputs=["e"], outputs=["u"])
    with pytest.raises(MuflyError, match="mode at 400 rad/s; choose another rate"):
        discretise_controller(system, np.zeros((2, 1)), 0.005)


def test_an_unstable_anti_windup_is_replaced() -> None:
    system = random_system(3)
    d = discretise_controller(system, -50 * np.ones((5, 2)), 0.01)
    assert d.anti_windup == "kalman"
    assert np.abs(np.linalg.eigvals(d.A - d.M @ d.C)).max() < 1


def test_integrators_follow_the_actuators_and_nothing_else_does() -> None:
    """Their two modes go to the rate asked for, the others stay; not where the rate is slower than they are."""
    system = random_system(3)
    slow = np.diag([-0.01, -0.01])
    system = state_space(
        np.block([[system.A, np.ones((5, 2))], [np.zeros((2, 5)), slow]]),
        np.vstack([system.B, np.eye(2, 3)]),
        np.hstack([system.C, np.array([[1.0, 0.2], [0.0, 1.0]])]),
        system.D,
        inputs=["a", "b", "c"],
        outputs=["d", "e"],
    )
    d = discretise_controller(system, np.zeros((7, 2)), 0.01, windup_rate=50.0)
    assert d.anti_windup == "integrators"
    free, held = (np.sort_complex(np.linalg.eigvals(X)) for X in (d.A, d.A - d.M @ d.C))
    followed = np.isclose(free, np.exp(-0.01 * 0.01), atol=1e-9)
    wanted = np.sort_complex(np.append(free[~followed], [np.exp(-0.5)] * 2))
    np.testing.assert_allclose(held, wanted, atol=1e-6)
    assert discretise_controller(system, np.zeros((7, 2)), 0.01, windup_rate=0.005).anti_windup != "integrators"


def test_impossible_periods() -> None:
    with pytest.raises(MuflyError, match="period"):
        discretise_controller(random_system(0), np.zeros((5, 2)), -0.01)


def test_designs_are_modal_and_stable_when_saturated(controller: FlightController) -> None:
    rates = []
    for d in (controller.heave_yaw, controller.roll_pitch, controller.velocity):
        c = d.discrete
        held = -np.log(np.abs(np.linalg.eigvals(c.A - c.M @ c.C))) / c.period_s
        rates.append([rate for rate in (1.5, 20.0) if np.isclose(held, rate).sum() == 2])
        assert c.form == "modal"
        assert np.abs(np.linalg.eigvals(c.A)).max() < 1
        assert np.abs(np.linalg.eigvals(c.A - c.M @ c.C)).max() < 1
        off = c.A.copy()
        for k in range(-1, 2):
            off -= np.diag(np.diag(off, k), k)
        assert np.abs(off).max() == 0.0  # numbers and 2 x 2 blocks only
        # Each mode is as strongly excited as it is felt.
        ends = [*(k for k in range(len(c.A)) if k == 0 or c.A[k, k - 1] == 0.0), len(c.A)]
        for a, b in pairwise(ends):
            assert np.linalg.norm(c.B[a:b]) == pytest.approx(np.linalg.norm(c.C[:, a:b]))
    # What follows the actuators: docs/explanation/control.md, anti-windup.
    assert rates == [[1.5], [20.0], []]


@pytest.mark.parametrize("name", ["heave_yaw", "roll_pitch"])
def test_modal_coefficients_survive_16_bits(controller: FlightController, name: str) -> None:
    """Each matrix rounded to 16-bit integers of its own largest entry: the loop does not change."""
    d = getattr(controller, name)

    def rounded(M: np.ndarray) -> np.ndarray:
        step = np.abs(M).max() / 2**15
        return np.round(M / step) * step if step else M

    c = d.discrete
    coarse = state_space(
        rounded(c.A),
        rounded(c.B),
        rounded(c.C),
        rounded(c.D),
        inputs=c.inputs,
        outputs=c.outputs,
        dt=c.period_s,
    )
    loop = analyse_loop(
        sample_plant(d.plant, c.period_s, 1), extract_feedback_controller(coarse, d.plant, d.error_inputs)
    )
    assert loop.stable
    assert loop.sensitivity_peak_dB == pytest.approx(d.sampled_loop.sensitivity_peak_dB, abs=0.1)
    assert loop.complementary_peak_dB == pytest.approx(d.sampled_loop.complementary_peak_dB, abs=0.1)


def test_direct_form_loses_stability_at_16_bits(controller: FlightController) -> None:
    """The denominator's coefficients, rounded the same way, put a pole outside the unit circle."""
    denominator = np.poly(np.linalg.eigvals(controller.heave_yaw.discrete.A)).real
    step = np.abs(denominator).max() / 2**15
    assert np.abs(np.roots(np.round(denominator / step) * step)).max() > 1
