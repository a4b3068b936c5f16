"""H2, LQG and loop transfer recovery against closed forms and theorems, and the designs by each method."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import linalg

from mufly.control import (
    DesignSettings,
    FlightController,
    LqgWeights,
    OneDegreeWeights,
    TransferFunction,
    analyse_loop,
    compute_input_noise_std,
    compute_lower_lft,
    design_flight_controller,
    design_lqg,
    disk_margin,
    h2_norm,
    h2syn,
    hinfsyn,
    make_one_dof_generalised_plant,
    sample_plant,
)
from mufly.control.analysis.loop_margins import scalar_block_mu
from mufly.control.designs import design_roll_pitch
from mufly.control.linear_systems import (
    extract_feedback_controller,
    frequency_response,
    loop_sensitivities,
    state_space,
)
from mufly.control.synthesis.lqg import augment_integrators, find_largest_ltr_parameter, kalman_gain, lqr_gain
from mufly.control.synthesis.weighting_schemes import scale_plant, unscale_controller
from mufly.dynamics import linearise_vehicle
from mufly.errors import ArgumentError, MuflyError
from mufly.results import to_plain_data
from mufly.vehicle import Vehicle, replace_parameters


def _sorted(values: np.ndarray) -> np.ndarray:
    return values[np.lexsort((values.imag, np.round(values.real, 6)))]


@pytest.mark.parametrize("name", ["heave_yaw", "roll_pitch", "velocity"])
def test_h2_norm_has_four_equal_forms_and_the_poles_separate(controller: FlightController, name: str) -> None:
    d = getattr(controller, name)
    found = h2syn(d.generalised_plant, d.controller.ninputs, 2)
    by_inputs, by_outputs = h2_norm(found.closed_loop)
    assert by_inputs == pytest.approx(by_outputs, rel=1e-8)
    assert found.norm == pytest.approx(found.riccati_norm, rel=1e-5)
    poles = np.linalg.eigvals(found.closed_loop.A)
    both = np.concatenate([found.regulator_poles, found.filter_poles])
    gap = np.abs(_sorted(poles) - _sorted(both)) / np.abs(poles).max()
    assert gap.max() < 1e-8
    # The norm by integration over frequency.
    w = np.geomspace(1e-6, 1e6, 6_001)
    size = np.linalg.norm(frequency_response(found.closed_loop, w), axis=(1, 2)) ** 2
    assert found.norm == pytest.approx(np.sqrt(np.trapezoid(size * w, np.log(w)) / np.pi), rel=1e-3)


def test_h2_is_the_smallest_norm(controller: FlightController) -> None:
    d = controller.roll_pitch
    best = h2syn(d.generalised_plant, 4, 2)
    assert best.norm < h2_norm(compute_lower_lft(d.generalised_plant, hinfsyn(d.generalised_plant, 4, 2).controller))[0]
    rng = np.random.default_rng(1)
    K = best.controller
    for _ in range(5):
        C = K.C * (1 + 0.01 * rng.normal(size=K.C.shape))
        other = state_space(K.A, K.B, C, K.D, inputs=K.input_labels, outputs=K.output_labels)
        assert h2_norm(compute_lower_lft(d.generalised_plant, other))[0] > best.norm


def test_h2_refuses_feedthrough_by_name() -> None:
    weights = OneDegreeWeights(TransferFunction((0.1,)), TransferFunction((1.0,)), TransferFunction((1.0,)))
    plant = state_space(-np.eye(1), np.eye(1), np.eye(1), np.ones((1, 1)), inputs=["u"], outputs=["y"], states=["x"])
    with pytest.raises(MuflyError, match=r"'w_v\[u\]' feeds through to 'z_y\[y\]'"):
        h2syn(make_one_dof_generalised_plant(plant, ["y"], weights), 1, 1)
    assert h2_norm(plant) == (np.inf, np.inf)
    assert h2_norm(control.tf2ss([1.0], [1.0, -1.0])) == (np.inf, np.inf)
    assert h2_norm(control.tf2ss([2.0], [1.0, 3.0])) == pytest.approx([2 / np.sqrt(6)] * 2)


@pytest.mark.parametrize("intensity", [1.0, 60.0, 1000.0])
def test_doyle_1978_is_exact(intensity: float) -> None:
    """Doyle (IEEE Trans. Autom. Control 23, 1978): gains f [1, 1] with f = 2 + sqrt(4 + q), and no margin."""
    A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])
    exact = 2.0 + np.sqrt(4.0 + intensity)
    F = lqr_gain(A, B, intensity * np.ones((2, 2)), np.eye(1))
    L = lqr_gain(A.T, np.array([[1.0], [0.0]]), intensity * np.ones((2, 2)), np.eye(1)).T
    assert pytest.approx(exact * np.ones((1, 2)), rel=1e-9) == F
    assert pytest.approx(exact * np.ones((2, 1)), rel=1e-9) == L
    C = np.array([[1.0, 0.0]])
    # Gain m at the input is stable only near one (his eqs 7 and 8).
    for m, stable in ((1.0, True), (1.0 + 2.0 / exact**2, False), (1.0 - 2.0 / exact, False)):
        loop = np.block([[A, -m * B @ F], [L @ C, A - B @ F - L @ C]])
        assert (np.linalg.eigvals(loop).real.max() < 0) == stable


RECOVERY = LqgWeights((1.0, 1.0), (0.0, 0.0), (4.0, 4.0), 0.02, (0.02,) * 4)


def test_recovery_approaches_state_feedback(controller: FlightController) -> None:
    d = controller.roll_pitch
    G, so, si = scale_plant(d.plant, d.scaling), np.array(d.scaling.outputs), np.array(d.scaling.inputs)
    peaks = []
    for q in (0.05, 1.0, 10.0, 100.0, 1e3, 1e4):
        found = design_lqg(G, (0, 1), RECOVERY, recovery=q)
        K = unscale_controller(found.controller, so, si)
        peaks.append(analyse_loop(d.plant, extract_feedback_controller(K, d.plant, range(4))).sensitivity_peak_dB)
    assert peaks == pytest.approx([2.80, 0.82, 0.20, 0.06, 0.02, 0.01], abs=0.01)
    A, B = augment_integrators(G, (0, 1))
    w = np.geomspace(0.1, 1e4, 300)
    target = state_space(A, B, found.state_gain, np.zeros((2, 2)), inputs=["a", "b"], outputs=["c", "d"])
    sensitivity = loop_sensitivities(frequency_response(target, w))[0]
    assert np.linalg.norm(sensitivity, 2, axis=(1, 2)).max() <= 1.0 + 1e-9  # Kalman's inequality
    poles = np.linalg.eigvals(A - B @ found.state_gain)
    assert _sorted(found.regulator_poles) == pytest.approx(_sorted(poles))


def test_filter_poles_stay_below_the_sampling_rate(controller: FlightController) -> None:
    for d in (controller.heave_yaw, controller.roll_pitch):
        G = scale_plant(d.plant, d.scaling)
        weights = replace(
            controller.settings.heave_yaw_lqg if d.name == "heave-yaw" else controller.settings.roll_pitch_lqg,
            recovery=1e4,
        )
        for rate in (100.0, 200.0, 500.0):
            q = find_largest_ltr_parameter(G, weights, 2 * np.pi * rate)
            L = kalman_gain(G, q, np.array(weights.noise))
            poles = np.abs(np.linalg.eigvals(G.A - L @ G.C))
            assert 0.5 * 2 * np.pi * rate < poles.max() <= max(2 * np.pi * rate, 1000.0 * 1.001)
    with pytest.raises(ArgumentError, match="weights: noise"):
        design_lqg(G, (0, 1), replace(weights, noise=(1.0,)))


@pytest.mark.parametrize(
    ("method", "peaks", "disk"), [("h2", (2.8, 1.6), 1.0), ("lqg", (4.5, 3.7), 0.7), ("ltr", (2.6, 2.6), 0.93)]
)
def test_every_method_gives_a_design_that_fits_on_board(
    vehicle: Vehicle, method: str, peaks: tuple[float, float], disk: float
) -> None:
    c = design_flight_controller(vehicle, settings=DesignSettings(method=method))
    d = c.roll_pitch
    assert d.method == method
    assert d.reduced.nstates <= 8
    assert c.heave_yaw.reduced.nstates <= 10
    assert d.sampled_loop.sensitivity_peak_dB <= peaks[0]
    assert d.sampled_loop.complementary_peak_dB <= peaks[1]
    loop = sample_plant(d.plant, c.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    assert disk_margin(*loop).margin >= disk
    noise = np.radians([0.1, 0.1, 0.3, 0.3])
    assert compute_input_noise_std(*loop, noise).max() < 0.0265  # H-infinity: 0.0264
    assert c.cascade_loop.stable
    record = to_plain_data(c)
    assert record["method"] == method
    assert record["designs"][1]["gamma"] is None
    assert method == "h2" or c.heave_yaw_gains["heave_lead"] < 0.1  # the reference enters at the equilibrium


def test_unknown_method_is_refused(vehicle: Vehicle) -> None:
    with pytest.raises(ArgumentError, match="give one of hinf, h2, lqg, ltr"):
        design_flight_controller(vehicle, settings=DesignSettings(method="pid"))  # type: ignore[arg-type]


@pytest.mark.parametrize("lag_ms", [10, 15, 20, 40])
def test_every_servo_lag_has_a_design(vehicle: Vehicle, lag_ms: float) -> None:
    slow = replace_parameters(vehicle, {"swash_plate.time_constant": lag_ms / 1e3})
    for method in ("hinf", "ltr"):
        d = design_roll_pitch(linearise_vehicle(slow).roll_pitch, DesignSettings(method=method), 1 / 200)
        assert d.sampled_loop.stable
        assert d.reduced.nstates <= 8


def test_disk_margin_of_one_and_two_inputs(controller: FlightController) -> None:
    integrator = control.tf2ss([1.0], [1.0, 0.0])
    one = disk_margin(integrator, control.ss([], [], [], [[1.0]]))
    assert one.margin == pytest.approx(2.0, rel=1e-3)  # S - 1/2 of an integrator is all-pass of size one half
    assert one.phase_deg == pytest.approx(90.0, abs=0.1)
    rng = np.random.default_rng(2)
    for _ in range(20):
        M = rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2))
        scales = np.exp(np.linspace(-5, 5, 2001))
        by_search = min(np.linalg.norm(np.diag([d, 1.0]) @ M @ np.diag([1 / d, 1.0]), 2) for d in scales)
        assert float(scalar_block_mu(M[None])[0]) == pytest.approx(by_search, rel=1e-4)
    with pytest.raises(MuflyError, match="3 inputs"):
        scalar_block_mu(np.eye(3)[None])
    d = controller.roll_pitch
    loop = sample_plant(d.plant, controller.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    found = disk_margin(*loop)
    assert found.margin == pytest.approx(0.83, abs=0.01)
    # The margin holds: gains at its edge, apart in each input, leave the loop stable; far beyond they do not.
    edge = 10 ** (found.gain_dB / 20)
    for gains in ([edge, edge], [1 / edge, edge], [edge, 1 / edge]):
        scaled = control.ss(loop[1].A, loop[1].B, np.diag(gains) @ loop[1].C, np.diag(gains) @ loop[1].D, loop[1].dt)
        closed = linalg.block_diag(loop[0].A, scaled.A)
        n = loop[0].nstates
        closed[:n, :n] -= loop[0].B @ scaled.D @ loop[0].C
        closed[:n, n:] = loop[0].B @ scaled.C
        closed[n:, :n] = -scaled.B @ loop[0].C
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    assert 2 * np.sin(np.radians(found.phase_deg) / 2) <= 1 / 10 ** (-d.sampled_loop.sensitivity_peak_dB / 20)


def test_noise_at_the_inputs_is_that_of_a_simulation(controller: FlightController) -> None:
    d = controller.roll_pitch
    G, K = sample_plant(d.plant, controller.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    noise = np.radians([0.1, 0.1, 0.3, 0.3])
    rng = np.random.default_rng(0)
    x, k, inputs = np.zeros(G.nstates), np.zeros(K.nstates), []
    for _ in range(40_000):
        e = -(G.C @ x + noise * rng.normal(size=4))
        u = K.C @ k + K.D @ e
        x, k = G.A @ x + G.B @ u, K.A @ k + K.B @ e
        inputs.append(u)
    assert np.std(inputs, axis=0) == pytest.approx(compute_input_noise_std(G, K, noise), rel=0.03)
    unstable = control.ss(K.A, K.B, -K.C, -K.D, K.dt)
    assert np.isinf(compute_input_noise_std(G, unstable, noise)).all()
