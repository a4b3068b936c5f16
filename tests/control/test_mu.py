"""The structured singular value against published values and theorems; mu of a vehicle and its unstable corners."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from mu_lower_bound import mu_lower_bound
from typer.testing import CliRunner

from mufly.cli.control import app
from mufly.control import FlightController, sample_plant
from mufly.control.linear_systems import is_stable_loop
from mufly.control.robust import Block, analyse_parameter_robustness, mu_upper_bound
from mufly.control.robust.structured_singular_value import _Scalings
from mufly.control.tuning import minimise_nonsmooth
from mufly.dynamics import linearise_vehicle
from mufly.errors import ArgumentError
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

# The example of SLICOT's routine AB13MD.
AB13MD = np.array(
    [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
)
REAL, COMPLEX = Block(1, True), Block(1, False)
SLICOT_BLOCKS = [REAL, REAL, Block(2, False), COMPLEX, COMPLEX]


def _random(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))


def test_the_example_of_slicot() -> None:
    assert mu_upper_bound(AB13MD, SLICOT_BLOCKS).value == pytest.approx(41.747534, abs=1e-5)
    found = mu_lower_bound(AB13MD, SLICOT_BLOCKS, starts=2)
    assert found.value == pytest.approx(41.747534, rel=1e-3)
    assert np.linalg.svd(np.eye(6) - AB13MD @ found.perturbation, compute_uv=False)[-1] < 1e-6


STRUCTURES = (
    [COMPLEX] * 3,
    [Block(2, False), COMPLEX, COMPLEX],
    [Block(2, False), Block(1, False), Block(3, False)],
    [COMPLEX] * 5,
    [REAL, REAL, COMPLEX],
    [Block(2, True), COMPLEX],
)


@pytest.mark.parametrize("seed", range(30))
def test_bounds_of_random_structures(seed: int) -> None:
    blocks = STRUCTURES[seed % len(STRUCTURES)]
    M = _random(np.random.default_rng(seed), sum(b.size for b in blocks))
    upper = mu_upper_bound(M, blocks, restarts=1).value
    lower = mu_lower_bound(M, blocks, starts=2)
    assert 0.0 < lower.value <= upper * (1 + 1e-6)
    if len(blocks) == 3 and not any(b.is_real for b in blocks):
        assert lower.value == pytest.approx(upper, rel=1e-3)  # exact for three full complex blocks
    Delta = lower.perturbation
    assert np.linalg.norm(Delta, 2) == pytest.approx(1 / lower.value, rel=1e-6)
    assert np.linalg.svd(np.eye(len(M)) - M @ Delta, compute_uv=False)[-1] < 1e-6
    row = 0
    for block in blocks:
        part = Delta[row : row + block.size, row : row + block.size]
        if block.is_real:
            assert part == pytest.approx(part[0, 0].real * np.eye(block.size), abs=1e-12)
        Delta[row : row + block.size, row : row + block.size] = 0.0
        row += block.size
    assert not Delta.any()


def test_extreme_structures_are_the_norm_and_the_real_root() -> None:
    M = _random(np.random.default_rng(5), 4)
    norm = float(np.linalg.norm(M, 2))
    assert mu_upper_bound(M, [Block(4, False)]).value == pytest.approx(norm)
    assert mu_lower_bound(M, [Block(4, False)]).value == pytest.approx(norm)
    A = M.real
    values = np.linalg.eigvals(A)
    real_root = np.abs(values[np.abs(values.imag) < 1e-12].real).max(initial=0.0)
    upper = mu_upper_bound(A.astype(complex), [Block(4, True)], restarts=4).value
    assert real_root - 1e-9 <= upper <= np.abs(values).max() + 1e-3
    # Scaling by a D of the structure leaves mu.
    D = np.diag([2.0, 0.3, 1.0, 1.0])
    blocks = [COMPLEX, REAL, Block(2, False)]
    scaled = D @ M @ np.linalg.inv(D)
    assert mu_upper_bound(scaled, blocks).value == pytest.approx(mu_upper_bound(M, blocks).value, rel=1e-5)
    assert mu_upper_bound(np.zeros((1, 1), dtype=complex), [REAL]).value == 0.0
    with pytest.raises(ArgumentError, match="blocks"):
        mu_upper_bound(M, [REAL])


@pytest.mark.parametrize("blocks", [SLICOT_BLOCKS, [Block(3, True), Block(2, True), COMPLEX]])
def test_gradient_of_the_scalings(blocks: list[Block]) -> None:
    scalings = _Scalings(AB13MD / 30, blocks)
    rng = np.random.default_rng(3)
    for _ in range(10):
        x = 0.5 * rng.normal(size=scalings.size)
        steps = 1e-6 * np.eye(x.size)
        by_difference = [
            (scalings.max_eigenvalue_and_gradient(x + h)[0] - scalings.max_eigenvalue_and_gradient(x - h)[0]) / 2e-6
            for h in steps
        ]
        assert scalings.max_eigenvalue_and_gradient(x)[1] == pytest.approx(by_difference, abs=1e-4)


def test_minimiser_reaches_a_kink() -> None:
    """Nesterov's nonsmooth function: the minimum 0 at ones, where it has no gradient."""

    def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
        r = x[1] - 2 * x[0] ** 2 + 1
        return 0.25 * abs(x[0] - 1) + abs(r), np.array([0.25 * np.sign(x[0] - 1) - 4 * x[0] * np.sign(r), np.sign(r)])

    found = minimise_nonsmooth(objective, np.array([0.3, 0.1]), max_steps=1000, tolerance=1e-12)
    assert found.value < 1e-4
    assert found.x == pytest.approx([1.0, 1.0], abs=1e-3)
    assert minimise_nonsmooth(lambda x: (np.inf, x), np.zeros(2)).steps == 0


def _value(vehicle: Vehicle, key: str) -> float:
    return next(float(p.value) for p in list_parameters(vehicle) if p.key == key)


def test_bounds_of_a_vehicle_enclose_its_unstable_corners(vehicle: Vehicle, controller: FlightController) -> None:
    spreads = {
        "body.inertia_xx": 0.2 * float(vehicle.body.inertia_xx),
        "swash_plate.linkage": 0.3 * float(vehicle.swash_plate.linkage),
        "stabiliser_bar.linkage": 0.3 * float(vehicle.stabiliser_bar.linkage),
        "rotors.inplane_drag": 0.5 * float(vehicle.rotors.inplane_drag),
    }
    found = analyse_parameter_robustness(vehicle, controller, spreads, points=16)
    loop = found.roll_pitch
    assert loop.peak_lower_bound <= loop.peak * 1.001
    assert loop.peak_lower_bound == pytest.approx(loop.peak, rel=0.1)
    assert max(abs(z) for z in loop.worst.values()) == pytest.approx(1 / loop.peak_lower_bound)
    assert found.heave_yaw.peak == 0.0  # no parameter of these enters it
    # The bound proves all corners of the box stable; the sampled loops of the vehicles there agree.
    assert loop.peak < 1.0
    d = controller.roll_pitch
    K = d.feedback_controller(d.discrete.to_state_space())
    for corner in itertools.product((-1.0, 1.0), repeat=4):
        moved = {
            key: float(v) + s * spreads[key]
            for (key, v), s in zip(((k, _value(vehicle, k)) for k in spreads), corner, strict=True)
        }
        G = linearise_vehicle(replace_parameters(vehicle, moved)).roll_pitch
        assert is_stable_loop(sample_plant(G, controller.period_s, 1), K)
    assert "proved" in str(found)


def test_the_worst_vehicle_of_the_default_spreads_is_possible(vehicle: Vehicle, controller: FlightController) -> None:
    """Two standard deviations reach below zero for some parameters; the worst vehicle stops at the end of the range."""
    found = analyse_parameter_robustness(vehicle, controller, points=5)
    below = [k for k, spread in found.spreads.items() if _value(vehicle, k) < spread]
    assert below
    worst = replace_parameters(vehicle, found.worst_values)
    assert all(_value(worst, k) >= 0.0 for k in below)


def test_command_writes_a_vehicle_that_loads(tmp_path: Path) -> None:
    arguments = ["mu", "--vary", "swash_plate.linkage=30%", "--vary", "stabiliser_bar.linkage=30%"]
    result = CliRunner().invoke(app, [*arguments, "--frequencies", "8", "--json", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    content = json.loads(result.stdout)
    del content["files"]
    assert content == json.loads((tmp_path / "mu.json").read_text())
    assert (tmp_path / "mu.png").stat().st_size > 5000
    worst = load_vehicle(tmp_path / "worst.toml")
    assert float(worst.swash_plate.linkage) == pytest.approx(content["worst_values"]["swash_plate.linkage"])
    assert abs(float(worst.swash_plate.linkage) / 0.77 - 1) <= 0.3 + 1e-9
