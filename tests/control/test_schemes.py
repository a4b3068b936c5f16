"""The generalised plants, closed with any controller, are the transfer functions of eqs 6.3 and 6.5."""

from __future__ import annotations

from types import ModuleType

import control as ct
import numpy as np
import pytest

from mufly.control import (
    OneDegreeWeights,
    SignalScaling,
    TransferFunction,
    TwoDegreeWeights,
    compute_lower_lft,
    frequency_response,
    make_one_dof_generalised_plant,
    make_two_dof_generalised_plant,
)
from mufly.control.linear_systems import state_space
from mufly.control.synthesis.weighting_schemes import (
    ROLL_PITCH_WEIGHTS,
    VELOCITY_WEIGHTS,
    scale_plant,
    unscale_controller,
)
from mufly.errors import MuflyError

FREQUENCY = np.geomspace(1e-2, 1e2, 15)


def value(w: TransferFunction) -> np.ndarray:
    s = 1j * FREQUENCY
    return np.polyval(w.numerator, s) / np.polyval(w.denominator, s)


def random_controller(inputs: int, outputs: int, seed: int) -> ct.StateSpace:
    rng = np.random.default_rng(seed)
    return state_space(
        -np.diag(rng.uniform(1, 5, 3)),
        rng.normal(size=(3, inputs)),
        rng.normal(size=(outputs, 3)),
        rng.normal(size=(outputs, inputs)),
        inputs=[f"e{i}" for i in range(inputs)],
        outputs=[f"u{i}" for i in range(outputs)],
    )


def test_two_degrees_of_freedom_is_equation_6_3(appendix_b: ModuleType) -> None:
    G = appendix_b.linear().heave_yaw
    w = TwoDegreeWeights()
    P = make_two_dof_generalised_plant(G, ["z", "psi"], w)
    assert P.input_labels[-2:] == ["motor_lower", "motor_upper"]
    assert P.output_labels[-5:] == ["reference[z]", "reference[psi]", "error[z]", "error[psi]", "error[r]"]
    K = random_controller(5, 2, 1)
    T = frequency_response(compute_lower_lft(P, K), FREQUENCY)
    g, k = frequency_response(G, FREQUENCY), frequency_response(K, FREQUENCY)
    kf, kb = k[:, :, :2], k[:, :, 2:]
    S = np.linalg.inv(np.eye(2) + kb @ g)
    Tu = S @ kb @ g
    E = np.eye(3)[:, :2]  # the references of z and psi among the outputs
    wu, wd, wdbar, wrbar, wr, wm = (
        value(x)[:, None, None]
        for x in (
            w.control,
            w.output_noise,
            w.input_disturbance,
            w.reference_rolloff,
            w.model_matching,
            w.reference_model,
        )
    )
    Tyr = g @ S @ kf
    expected_u = [-wu * Tu * wdbar, wu * S @ kf * wrbar, wu * S @ kf * wr, wu * S @ kb * wd]
    expected_y = [g @ S * wdbar, Tyr * wrbar, (Tyr - wm * E) * wr, g @ S @ kb * wd]
    np.testing.assert_allclose(T[:, :2], np.concatenate(expected_u, axis=2), rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(T[:, 2:], np.concatenate(expected_y, axis=2), rtol=1e-7, atol=1e-10)


def magnitude(weight: TransferFunction, frequency: float) -> float:
    s = 1j * frequency
    return float(abs(np.polyval(weight.numerator, s) / np.polyval(weight.denominator, s)))


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("control", lambda s: 0.001),
        ("output_noise", lambda s: (s + 10) / (0.1 * s + 20)),
        ("input_disturbance", lambda s: (0.7 * s + 1) / (s + 0.7 / 100)),
        ("reference_rolloff", lambda s: (s + 7) / (0.01 * s + 14)),
        ("model_matching", lambda s: (s**2 + 15 * s + 14) / (s**2 + 14 * s + 0.0014)),
        ("reference_model", lambda s: 14 / (s + 14)),
    ],
)
def test_weights_are_those_of_equation_6_4(name: str, printed) -> None:
    """As printed; W_r without its factor 1e-4."""
    weight = getattr(TwoDegreeWeights(), name)
    for frequency in (1e-5, 0.3, 7.0, 60.0, 1e5):
        assert magnitude(weight, frequency) == pytest.approx(abs(printed(1j * frequency)), rel=1e-12)


@pytest.mark.parametrize(
    ("weight", "low", "high", "one"),
    [
        (ROLL_PITCH_WEIGHTS.input_disturbance, 0.7 * 10 / 0.03, 0.7, 10.0),
        (ROLL_PITCH_WEIGHTS.output_noise, 0.5, 10.0, 70.0),
        (VELOCITY_WEIGHTS.input_disturbance, 0.7 * 0.2 / 0.007, 0.7, 0.2),
        (VELOCITY_WEIGHTS.output_noise, 0.5, 10.0, 40.0),
    ],
)
def test_weights_of_ours_do_what_docs_control_says(weight, low: float, high: float, one: float) -> None:
    """W_v asks for rejection up to ``one`` (rad/s) and no more beyond; W_r bounds T_e by 2, and by 1 near ``one``."""
    assert magnitude(weight, 1e-6) == pytest.approx(low, rel=1e-3)
    assert magnitude(weight, 1e7) == pytest.approx(high, rel=1e-3)
    assert magnitude(weight, one) == pytest.approx(1.0, rel=0.12)


def test_one_degree_of_freedom_is_equation_6_5(appendix_b: ModuleType) -> None:
    G = appendix_b.linear().roll_pitch
    w = OneDegreeWeights(
        control=TransferFunction((0.1,)),
        output_noise=TransferFunction((1.0, 35.0), (0.1, 70.0)),
        input_disturbance=TransferFunction((0.7, 7.0), (1.0, 0.03)),
        output=TransferFunction((1.0, 2.0), (1.0, 9.0)),
        auxiliary=0.5,
    )
    P = make_one_dof_generalised_plant(G, ["phi", "theta"], w)
    K = random_controller(4, 2, 2)
    T = frequency_response(compute_lower_lft(P, K), FREQUENCY)
    g, k = frequency_response(G, FREQUENCY), frequency_response(K, FREQUENCY)
    S = np.linalg.inv(np.eye(2) + k @ g)
    wu, wv, wr, wy = (value(x)[:, None, None] for x in (w.control, w.input_disturbance, w.output_noise, w.output))
    share = np.diag([1, 1, 0.5, 0.5])
    np.testing.assert_allclose(T[:, :2, :2], -wu * S @ k @ g * wv, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(T[:, :2, 2:], wu * S @ k * wr, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(T[:, 2:, :2], wy * share @ g @ S * wv, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(T[:, 2:, 2:], wy * share @ g @ S @ k * wr, rtol=1e-7, atol=1e-10)


def test_scaling_and_its_inverse_leave_the_loop_alone(appendix_b: ModuleType) -> None:
    G = appendix_b.linear().heave_yaw
    # With a way straight through.
    G = state_space(G.A, G.B, G.C, np.arange(6.0).reshape(3, 2), inputs=G.input_labels, outputs=G.output_labels)
    scaling = SignalScaling((0.5, 2.0, 10.0), (0.3, 0.2))
    K = random_controller(3, 2, 3)
    physical = unscale_controller(K, np.array(scaling.outputs), np.array(scaling.inputs))
    scaled_loop = frequency_response(K, FREQUENCY) @ frequency_response(scale_plant(G, scaling), FREQUENCY)
    loop = frequency_response(physical, FREQUENCY) @ frequency_response(G, FREQUENCY)
    turn = np.array(scaling.inputs)
    np.testing.assert_allclose(loop, scaled_loop * turn[:, None] / turn, rtol=1e-10)


def test_a_pure_gain_is_that_gain() -> None:
    block = TransferFunction((3.0,)).to_block("k", "a", "b")
    assert (block.nstates, block.D[0, 0]) == (0, 3.0)


def test_faults_are_named(appendix_b: ModuleType) -> None:
    G = appendix_b.linear().heave_yaw
    with pytest.raises(MuflyError, match="reference 'height' is not an output"):
        make_two_dof_generalised_plant(G, ["height"], TwoDegreeWeights())
    with pytest.raises(MuflyError, match=r"W_M\[z\].*higher degree"):
        make_two_dof_generalised_plant(G, ["z"], TwoDegreeWeights(reference_model=TransferFunction((1.0, 0.0), (1.0,))))
    with pytest.raises(MuflyError, match=r"W_dbar.*right half plane or on the axis"):
        make_two_dof_generalised_plant(
            G, ["z"], TwoDegreeWeights(input_disturbance=TransferFunction((1.0,), (1.0, 0.0)))
        )
    with pytest.raises(MuflyError, match="2 output and 2 input scales"):
        scale_plant(G, SignalScaling((1.0, 1.0), (1.0, 1.0)))
    with pytest.raises(MuflyError, match="positive"):
        scale_plant(G, SignalScaling((1.0, 1.0, -1.0), (1.0, 1.0)))
