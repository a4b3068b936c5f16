"""D-K iteration: its parts against identities, Skogestad and Postlethwaite's column, and the design of roll-pitch."""

from __future__ import annotations

from collections.abc import Sequence

import control
import numpy as np
import pytest
from mu_lower_bound import mu_lower_bound

from mufly.control import (
    DesignSettings,
    FlightController,
    TransferFunction,
    compute_input_noise_std,
    compute_lower_lft,
    connect_blocks,
    disk_margin,
    frequency_response,
    sample_plant,
)
from mufly.control.controller_design import ControllerDesign
from mufly.control.linear_systems import replace_matrices, state_space
from mufly.control.robust import Block, mu_upper_bound
from mufly.control.robust.dk_iteration import (
    ScalingFilter,
    UncertaintyChannel,
    fit_filter_to_magnitude,
    iterate_dk,
    scale_uncertainty_channels,
    sweep_complex_mu,
)
from mufly.control.robust.uncertain_plant import add_uncertainty
from mufly.control.synthesis.weighting_schemes import scale_plant, weight_roll_pitch_plant
from mufly.control.tuning.fixed_order import add_input_delay
from mufly.errors import ArgumentError

CHANNELS = [UncertaintyChannel(1, 1), UncertaintyChannel(1, 1), UncertaintyChannel(2, 2)]
G0 = np.array([[87.8, -86.4], [108.2, -109.6]])


@pytest.fixture(scope="module")
def column() -> control.StateSpace:
    """*Multivariable Feedback Control* (2006), Sec. 8.11.3 and 8.12.4; the integrator of w_P stands at 1e-6 rad/s."""
    plant = state_space(
        -np.eye(2) / 75, G0 / 75, np.eye(2), np.zeros((2, 2)), inputs=["gu1", "gu2"], outputs=["g1", "g2"]
    )
    blocks, wiring = [plant], {}
    for i in "12":
        blocks += [
            TransferFunction((5.0, 0.5), (10.0, 1e-5)).to_block(f"wp{i}", f"wp_in{i}", f"zp{i}"),
            TransferFunction((1.0, 0.2), (0.5, 1.0)).to_block(f"wi{i}", f"wi_in{i}", f"zd{i}"),
        ]
        wiring |= {f"gu{i}": {f"u{i}": 1.0, f"d{i}": 1.0}, f"wp_in{i}": {f"g{i}": 1.0, f"w{i}": 1.0}}
        wiring |= {f"wi_in{i}": {f"u{i}": 1.0}, f"e{i}": {f"g{i}": -1.0, f"w{i}": -1.0}}
    return connect_blocks(
        blocks, wiring, ["d1", "d2", "w1", "w2", "u1", "u2"], ["zd1", "zd2", "zp1", "zp2", "e1", "e2"]
    )


def test_inverse_controller_of_the_column(column: control.StateSpace) -> None:
    """Robust performance of the inverse controller, 5.7726."""
    inverse = np.linalg.inv(G0)
    K = state_space(
        -1e-5 * np.eye(2), inverse, 0.7 * (1 - 75e-5) * np.eye(2), 0.7 * 75 * inverse,
        inputs=["e1", "e2"], outputs=["u1", "u2"],
    )  # fmt: skip
    N = frequency_response(compute_lower_lft(column, K), np.geomspace(1e-3, 1e3, 61))
    assert sweep_complex_mu(N, CHANNELS)[0].max() == pytest.approx(5.7726, abs=1e-3)
    assert np.linalg.norm(N[:, 2:, 2:], 2, axis=(1, 2)).max() == pytest.approx(0.500, abs=1e-3)
    scalars = [Block(1, False), Block(1, False)]
    assert max(mu_upper_bound(M[:2, :2], scalars).value for M in N) == pytest.approx(0.524, abs=2e-3)


def test_eight_rounds_on_the_column(column: control.StateSpace) -> None:
    """From the book's first scalings; the book reaches 1.0189 with filters of order 4, the optimum is 0.974."""
    found = iterate_dk(column, CHANNELS, 2, 2, np.geomspace(1e-3, 1e3, 31), scalings=(0.01, 0.01, 1.0))
    assert len(found.rounds) <= 8
    assert found.mu < 1.0 < found.rounds[0].mu
    assert found.mu == min(r.mu for r in found.rounds)
    N = frequency_response(compute_lower_lft(column, found.controller), np.geomspace(1e-4, 1e4, 80))
    between = sweep_complex_mu(N, CHANNELS)[0].max()  # frequencies that the D step did not see
    assert between < 1.0
    blocks = [Block(1, False), Block(1, False), Block(2, False)]
    lower = max(mu_lower_bound(M, blocks, starts=2).value for M in N[20:60:5])
    assert 0.97 < lower <= between * (1 + 1e-6)  # below the optimum of 0.974 but for the grid there is nothing


def test_filter_is_recovered_and_its_inverse_is_exact() -> None:
    w = np.geomspace(1e-2, 1e3, 60)
    true = ScalingFilter(3.0, np.array([0.2, 40.0]), np.array([2.0, 300.0]))
    found = fit_filter_to_magnitude(w, true.magnitude_at(w), 4, 1e-6)
    assert found.poles.size == 2
    assert found.magnitude_at(w) == pytest.approx(true.magnitude_at(w), rel=1e-4)
    assert true.magnitude_at(w) * true.inverse_filter.magnitude_at(w) == pytest.approx(np.ones(60))
    A, B, C, D = true.to_matrices()
    system = state_space(A, B, C, D, inputs=["u"], outputs=["y"])
    assert np.abs(frequency_response(system, w)[:, 0, 0]) == pytest.approx(true.magnitude_at(w))
    assert fit_filter_to_magnitude(w, np.full(60, 2.0), 4, 1e-6).poles.size == 0
    # All weight at the first frequency: a constant meets it.
    weight = np.eye(60)[0]
    assert fit_filter_to_magnitude(w, true.magnitude_at(w), 4, 1e-6, weight).gain == pytest.approx(
        true.magnitude_at(w)[0]
    )


def test_scaled_plant_is_the_plant_between_the_filters(column: control.StateSpace) -> None:
    w = np.geomspace(1e-2, 1e2, 9)
    filters = [
        ScalingFilter(0.5, np.array([1.0]), np.array([3.0])),
        ScalingFilter(2.0, np.array([0.1, 5.0]), np.array([0.4, 20.0])),
        ScalingFilter(1.0, np.zeros(0), np.zeros(0)),
    ]
    N, M = (frequency_response(P, w) for P in (column, scale_uncertainty_channels(column, CHANNELS, filters)))
    size = [f.magnitude_at(w) for f in filters[:2]]
    for i in (0, 1):
        assert M[:, i, i] == pytest.approx(N[:, i, i])  # D and its inverse cancel on a block's own path
        assert np.abs(M[:, i, 2]) == pytest.approx(size[i] * np.abs(N[:, i, 2]))
        assert np.abs(M[:, 2, i]) == pytest.approx(np.abs(N[:, 2, i]) / size[i])
    assert M[:, 2:, 2:] == pytest.approx(N[:, 2:, 2:])


def test_a_block_may_be_wide() -> None:
    rng = np.random.default_rng(0)
    M = rng.normal(size=(4, 2, 3)) + 1j * rng.normal(size=(4, 2, 3))
    assert sweep_complex_mu(M, [UncertaintyChannel(2, 3)])[0] == pytest.approx(
        np.linalg.norm(M, 2, axis=(1, 2)), rel=1e-4
    )
    with pytest.raises(ArgumentError, match="channels"):
        iterate_dk(state_space(-np.eye(1), np.ones((1, 3)), np.ones((3, 1)), np.zeros((3, 3)),
                   inputs=list("abc"), outputs=list("def")), [UncertaintyChannel(2, 1)], 1, 1, np.ones(3))  # fmt: skip


def _changes(plant: control.StateSpace, spreads: Sequence[float]) -> list[np.ndarray]:
    """Changes of the linear model by its parameters: the bar's and the swash plate's entries, of rank two."""
    whole = np.hstack([plant.A, plant.B])
    names = list(plant.state_labels)
    rows = [[names.index("a_dw"), names.index("b_dw")], [names.index("p"), names.index("q")]]
    found = []
    for chosen, spread in zip(rows, spreads, strict=True):
        E = np.zeros_like(whole)
        E[chosen] = spread * whole[chosen]
        found.append(E)
    return found


def test_uncertain_plant_closed_by_its_parameters_is_the_changed_plant(controller: FlightController) -> None:
    d = controller.roll_pitch
    plant = scale_plant(d.plant, d.scaling)
    changes = _changes(plant, (0.2, 0.3))

    def generalise(g: control.StateSpace) -> control.StateSpace:
        return weight_roll_pitch_plant(add_input_delay(g, 0.0075), controller.settings)

    P, channels = add_uncertainty(generalise(plant), plant, 4, changes, 0.2)
    m, w = len(channels) - 3, np.geomspace(0.1, 100, 7)
    z, inputs, n = (0.7, -0.4), (0.3, -0.2), plant.nstates
    sizes = [np.linalg.matrix_rank(E) for E in changes]
    assert sum(sizes) == m
    Delta = np.diag([*np.repeat(z, sizes), *inputs])
    response = frequency_response(P, w)
    k = m + 2
    upper = response[:, :k, :k]
    closed = response[:, k:, k:] + response[:, k:, :k] @ Delta @ np.linalg.solve(
        np.eye(k) - upper @ Delta, response[:, :k, k:]
    )
    moved = sum(v * E for v, E in zip(z, changes, strict=True))
    W = 4.0 + (0.2 - 4.0) * 400.0 / (1j * w + 400.0)
    assert np.abs(W[0]) == pytest.approx(0.2, rel=1e-3)
    for i in range(w.size):  # the inputs' factors 1 + W Delta are constant at one frequency, so they scale B there
        factor = 1.0 + W[i] * np.array(inputs)
        A, B = plant.A + moved[:, :n], plant.B + moved[:, n:]
        parts = [
            frequency_response(generalise(replace_matrices(plant, A=A, B=B * f)), w[i : i + 1])[0]
            for f in (factor.real, np.ones(2))
        ]
        if i == 0:  # at low frequency the factor is real
            assert closed[i] == pytest.approx(parts[0], rel=2e-2, abs=1e-3 * np.abs(parts[0]).max())
        Delta[m:, m:] = 0.0
        exact = response[i, k:, k:] + response[i, k:, :k] @ Delta @ np.linalg.solve(
            np.eye(k) - upper[i] @ Delta, response[i, :k, k:]
        )
        Delta[m:, m:] = np.diag(inputs)
        assert exact == pytest.approx(parts[1], rel=1e-8, abs=1e-9 * np.abs(parts[1]).max())
    certain, without = add_uncertainty(generalise(plant), plant, 4, changes, 0.0)
    assert len(without) == m + 1
    assert certain.nstates == P.nstates - 2


def test_design_of_roll_pitch_with_few_frequencies(
    mu_roll_pitch: ControllerDesign, controller: FlightController
) -> None:
    d, today = mu_roll_pitch, controller.roll_pitch
    assert d.method == "mu"
    assert d.reduced.nstates <= 8 < d.controller.nstates
    assert d.norm <= d.gamma  # the performance is a part of the robust performance
    loops = [(sample_plant(x.plant, 0.005, 1), x.feedback_controller(x.discrete.to_state_space())) for x in (d, today)]
    assert disk_margin(*loops[0]).margin > disk_margin(*loops[1]).margin
    noise = np.radians([0.1, 0.1, 0.3, 0.3])
    assert compute_input_noise_std(*loops[0], noise).max() < 0.5 * compute_input_noise_std(*loops[1], noise).max()
    assert d.sampled_loop.complementary_peak_dB < today.sampled_loop.complementary_peak_dB
    assert d.sampled_loop.delay_margin_s > today.sampled_loop.delay_margin_s
    assert DesignSettings(method="mu").robust_goals.rounds == 3
