"""Margins and peaks of loops whose answers are known."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from saturated_gain import saturated_gain_limit
from scipy import linalg

from mufly.control import (
    DesignSettings,
    FlightController,
    analyse_loop,
    compute_loop_singular_values,
    design_flight_controller,
    hinf_norm,
    sample_plant,
)
from mufly.control.linear_systems import _tracked_eigenvalues, is_stable_loop, state_space
from mufly.dynamics import linearise_vehicle
from mufly.vehicle import Vehicle, list_parameters, replace_parameters


def twin(numerator: list[float], denominator: list[float]) -> ct.StateSpace:
    """Two equal channels side by side."""
    one = ct.ss(ct.tf(numerator, denominator))
    A, B, C, D = (np.kron(np.eye(2), M) for M in (one.A, one.B, one.C, one.D))
    return state_space(A, B, C, D, inputs=["u1", "u2"], outputs=["y1", "y2"])


def gain(k: float) -> ct.StateSpace:
    empty = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0))
    return state_space(*empty, k * np.eye(2), inputs=["y1", "y2"], outputs=["u1", "u2"])


@given(st.floats(0.05, 50.0))
@settings(max_examples=20, deadline=None)
def test_integrator(k: float) -> None:
    loop = analyse_loop(twin([1], [1, 0]), gain(k))
    assert loop.stable
    assert loop.crossovers == pytest.approx([k, k], rel=1e-3)
    assert loop.phase_margin_deg == pytest.approx(90, abs=0.1)
    assert loop.delay_margin_s == pytest.approx(np.pi / 2 / k, rel=1e-3)
    assert loop.complementary_peak_dB == pytest.approx(0, abs=1e-3)
    assert loop.gain_margin_dB == np.inf
    # S and T peak at one: each phase may be off by 60 degrees, by itself.
    assert loop.guaranteed_phase_margin_deg == pytest.approx(60.0, abs=0.1)


@given(st.floats(0.2, 5.5))
@settings(max_examples=20, deadline=None)
def test_three_lags(k: float) -> None:
    """k / (s (s+1) (s+2)): the gain margin is 6 / k, and |L| = 1 where w^2 (w^2 + 1) (w^2 + 4) = k^2."""
    loop = analyse_loop(twin([1], [1, 3, 2, 0]), gain(k))
    assert loop.stable
    assert loop.gain_margin_dB == pytest.approx(20 * np.log10(6 / k), abs=0.05)
    squares = np.roots([1.0, 5.0, 4.0, -(k**2)])
    w = np.sqrt(squares[np.abs(squares.imag) < 1e-9].real.max())
    phase_margin_deg = 90.0 - np.degrees(np.arctan(w) + np.arctan(w / 2))
    assert loop.phase_margin_deg == pytest.approx(phase_margin_deg, abs=0.02)  # of a grid of frequencies
    # Both are equal where S or T peaks at the crossover.
    assert 0.0 < loop.guaranteed_phase_margin_deg < phase_margin_deg + 1e-6
    assert loop.gain_reduction_dB == -np.inf


@given(st.floats(0.3, 5.0))
@settings(max_examples=20, deadline=None)
def test_peaks_are_the_norms(k: float) -> None:
    G, K = twin([1], [1, 3, 2, 0]), gain(k)
    loop = analyse_loop(G, K)
    L = ct.ss(ct.tf([k], [1, 3, 2, 0]))
    S = ct.feedback(ct.ss([], [], [], [[1]]), L)
    T = ct.feedback(L, 1)
    assert loop.sensitivity_peak_dB == pytest.approx(20 * np.log10(hinf_norm(S)[0]), abs=0.01)
    assert loop.complementary_peak_dB == pytest.approx(20 * np.log10(hinf_norm(T)[0]), abs=0.01)


@pytest.mark.parametrize("sampled", [False, True])
def test_a_resonance_sharper_than_the_grid_is_not_missed(sampled: bool) -> None:
    """k w^2 / (s^2 + 2 z w s + w^2) passes one where it resonates, from w (1 - k/2) to w (1 + k/2)."""
    G, K = twin([0.01 * 9.0], [1, 2 * 2.5e-4 * 3.0, 9.0]), gain(1.0)
    if sampled:
        G = sample_plant(G, 1e-3)
        K = state_space(K.A, K.B, K.C, K.D, inputs=K.input_labels, outputs=K.output_labels, dt=1e-3)
    loop = analyse_loop(G, K)
    assert loop.crossovers == pytest.approx([3.0 * 0.995] * 2 + [3.0 * 1.005] * 2, rel=0.02)


def test_the_margins_of_two_loops_are_those_of_the_worse() -> None:
    """Mixed so that no input belongs to one of them, and as strong as one another at one frequency."""
    slow, quick = ct.tf([2.0], [1, 3, 2, 0]), ct.tf([4.0], [1, 12, 20, 0])
    T = np.array([[1.0, 0.6], [-0.4, 1.0]])
    one = [analyse_loop(twin(g.num[0][0], g.den[0][0]), gain(1.0)) for g in (slow, quick)]
    systems = [ct.ss(g) for g in (slow, quick)]
    A, B, C, D = (linalg.block_diag(*(getattr(g, name) for g in systems)) for name in "ABCD")
    mixed = state_space(A, B @ np.linalg.inv(T), T @ C, D, inputs=["u1", "u2"], outputs=["y1", "y2"])
    loop = analyse_loop(mixed, gain(1.0))
    for name in ("gain_margin_dB", "phase_margin_deg", "delay_margin_s"):
        assert getattr(loop, name) == pytest.approx(min(getattr(x, name) for x in one), rel=2e-3)


def test_an_eigenvalue_is_followed_over_frequency_in_whatever_order_it_comes() -> None:
    """Two loci that cross: as strong as one another at one frequency, and given in turn first and second."""
    s = 1j * np.geomspace(0.1, 10.0, 60)
    pair = np.stack([1.0 / (1.0 + s), 3.0 / (1.0 + s) ** 2], axis=1)
    given = pair.copy()
    given[1::2] = given[1::2, ::-1]
    np.testing.assert_array_equal(_tracked_eigenvalues(given[:, :, None] * np.eye(2)), pair)


def test_conditionally_stable_loop_has_a_gain_reduction() -> None:
    """k (s+1)^2 / s^3 is stable for k > 1/2."""
    loop = analyse_loop(twin([1, 2, 1], [1, 0, 0, 0]), gain(2.0))
    assert loop.stable
    assert loop.gain_reduction_dB == pytest.approx(-20 * np.log10(4), abs=0.05)
    assert not analyse_loop(twin([1, 2, 1], [1, 0, 0, 0]), gain(0.4)).stable


@given(st.floats(3.0, 8.0), st.sampled_from([40.0, 60.0]))
@settings(max_examples=20, deadline=None)
def test_the_delay_margin_is_where_delay_destabilises(k: float, rate: float) -> None:
    G, K = twin([10], [1, 10, 0]), gain(k)
    sampled_gain = state_space(K.A, K.B, K.C, K.D, inputs=K.input_labels, outputs=K.output_labels, dt=1 / rate)
    samples = analyse_loop(sample_plant(G, 1 / rate), sampled_gain).delay_margin_s * rate
    for count in (0, int(samples), int(samples) + 1):
        assert is_stable_loop(sample_plant(G, 1 / rate, count), sampled_gain) == (count < samples)


def test_curves_add_up() -> None:
    """S + T = 1: their singular values can differ by no more than one."""
    frequency = np.geomspace(1e-2, 1e3, 50)
    curves = compute_loop_singular_values(twin([10], [1, 10, 0]), gain(2.0), frequency)
    assert np.all(np.abs(curves.sensitivity - curves.complementary) <= 1 + 1e-9)
    np.testing.assert_allclose(curves.loop, 2 * curves.plant, rtol=1e-12)


def test_a_saturated_loop_begins_to_swing_where_its_gain_margin_downwards_says() -> None:
    """k (s+1)^2 / s^3 is stable for k above 1/2: with no anti-windup saturation takes its gain down to that."""
    plant = sample_plant(state_space([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["y"]), 0.002)
    T, k = 0.002, 4.0
    A, B = np.array([[1.0, T], [0.0, 1.0]]), np.array([[0.5 * T * T], [T]])
    law = (A, B, k * np.array([[1.0, 2.0]]), np.array([[k]]), np.zeros((2, 1)))
    share, frequency = saturated_gain_limit(plant, law, np.ones(1), points=6000)
    assert share == pytest.approx(0.5 / k, rel=0.02)
    assert frequency == pytest.approx(1.0, rel=0.02)
    # Told at once what the actuator did, it has nothing left that could wind up.
    told = (*law[:4], np.array([[0.0], [40.0 * T / (2.0 * k)]]))
    assert saturated_gain_limit(plant, told, np.ones(1))[0] == 0.0


def test_motors_that_rail_do_not_swing(vehicle: Vehicle, controller: FlightController) -> None:
    """Light or heavy, fast or slow against what its controller was designed for, and as it was designed."""
    now = {p.key: p.value for p in list_parameters(vehicle)}
    rotors = ("rotors.upper.thrust_coefficient", "rotors.lower.thrust_coefficient")
    inertia = ("rotors.upper.drive_inertia", "rotors.lower.drive_inertia")

    def altered(mass: float, thrust: float, slow: float, kE: float) -> Vehicle:
        shares = {"body.mass": mass, "motor.back_emf_constant": kE, "motor.resistance": slow}
        shares |= dict.fromkeys(rotors, thrust) | dict.fromkeys(inertia, slow)
        return replace_parameters(vehicle, {key: float(now[key]) * share for key, share in shares.items()})

    light = altered(0.9, 1.1, 0.9, 0.92)
    observer = design_flight_controller(vehicle, settings=DesignSettings(heave_yaw_anti_windup_rad_s=None))
    for one in (vehicle, light, altered(1.05, 0.95, 1.1, 1.0), altered(0.9, 1.1, 1.1, 1.1)):
        plant = sample_plant(linearise_vehicle(one, voltage=7.2).heave_yaw, controller.period_s, 1)
        shares = []
        for c in (controller, observer):
            k = c.heave_yaw.discrete
            shares.append(saturated_gain_limit(plant, (k.A, k.B[:, 2:], k.C, k.D[:, 2:], k.M), np.ones(2))[0])
        assert shares[0] == 0.0
        # The observer's knows another vehicle than this one.
        assert shares[1] > (0.1 if one is light else 0.0)
