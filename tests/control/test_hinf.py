"""H-infinity synthesis against closed forms, bounds that nothing can beat, and random plants."""

from __future__ import annotations

import re

import control as ct
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import linalg

from mufly.control import compute_lower_lft, hinf_norm, hinfsyn, singular_values
from mufly.control.linear_systems import state_space
from mufly.errors import InputError, MuflyError


def plant(A, B1, B2, C1, C2, D11, D12, D21, D22=None, states=None):
    A, B1, B2, C1, C2, D11, D12, D21 = (np.atleast_2d(np.asarray(M, float)) for M in (A, B1, B2, C1, C2, D11, D12, D21))
    D22 = np.zeros((C2.shape[0], B2.shape[1])) if D22 is None else np.atleast_2d(D22)
    return state_space(
        A,
        np.hstack([B1, B2]),
        np.vstack([C1, C2]),
        np.block([[D11, D12], [D21, D22]]),
        inputs=[f"w{i}" for i in range(B1.shape[1])] + [f"u{i}" for i in range(B2.shape[1])],
        outputs=[f"z{i}" for i in range(C1.shape[0])] + [f"y{i}" for i in range(C2.shape[0])],
        states=states,
    )


def scalar(a: float, b: float = 1.0):
    """xdot = a x + w1 + b u, z = (x, u), y = b x + w2: gamma = (a + sqrt(a^2 + 2 b^2)) / b^2.

    Both Riccati equations are 2 a X - (b^2 - gamma^-2) X^2 + 1 = 0; the optimum is where X Y = X^2 = gamma^2.
    """
    return plant([[a]], [[1, 0]], [[b]], [[1], [0]], [[b]], np.zeros((2, 2)), [[0], [1]], [[0, 1]])


@given(st.floats(-3.0, 5.0), st.floats(-4.0, 1.0))
@example(30.0, -3.0)  # 6.0e7: among the levels that a search by threes from one to 1e8 leaves out
@example(1.0, -5.0)
@settings(max_examples=30, deadline=None)
def test_scalar_problem_has_its_closed_form(a: float, coupling: float) -> None:
    b = 10.0**coupling
    result = hinfsyn(scalar(a, b), 1, 1, gamma_tolerance=1e-5)
    expected = (a + np.sqrt(a * a + 2 * b * b)) / b**2 if a > 0 else 2.0 / (np.sqrt(a * a + 2 * b * b) - a)
    assert result.gamma_optimal == pytest.approx(expected, rel=1e-4)
    assert result.norm <= result.gamma * (1 + 1e-6)
    assert result.iterations < 80  # halvings of a logarithm, however far from one the optimum is


@given(st.integers(1, 5), st.integers(1, 2), st.integers(1, 2), st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_normalised_coprime_factors_have_glover_and_mcfarlanes_optimum(n: int, nu: int, ny: int, seed: int) -> None:
    """gamma = sqrt(1 + rho(X Z)), with X, Z of the LQR and the filter (McFarlane and Glover 1990); D11 is not zero."""
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(n, n)), rng.normal(size=(n, nu)), rng.normal(size=(ny, n))
    X = linalg.solve_continuous_are(A, B, C.T @ C, np.eye(nu))
    Z = linalg.solve_continuous_are(A.T, C.T, B @ B.T, np.eye(ny))
    P = plant(
        A,
        Z @ C.T,
        B,
        np.vstack([np.zeros((nu, n)), C]),
        C,
        np.vstack([np.zeros((nu, ny)), np.eye(ny)]),
        np.vstack([np.eye(nu), np.zeros((ny, nu))]),
        np.eye(ny),
    )
    expected = np.sqrt(1 + np.abs(np.linalg.eigvals(X @ Z)).max())
    result = hinfsyn(P, ny, nu, gamma_tolerance=1e-5)
    assert result.gamma_optimal == pytest.approx(expected, rel=1e-3)


@given(st.floats(0.5, 5.0), st.floats(0.1, 2.0), st.floats(5.0, 20.0), st.integers(1, 2))
@settings(max_examples=25, deadline=None)
def test_a_zero_in_the_right_half_plane_bounds_the_sensitivity(
    zero: float, corner: float, gain: float, copies: int
) -> None:
    """||W S|| >= |W(zero)| for every controller, and the infimum reaches it (maximum modulus principle)."""
    I = np.eye(copies)  # several of the same loop, side by side
    G = ct.ss(ct.tf([-1, zero], [1, 3 * zero, 2 * zero**2]))
    # W = gain corner / (s + corner): one state driven by the error.
    A = np.block([[np.array([[-corner]]), -gain * corner * G.C], [np.zeros((2, 1)), G.A]])
    B1 = np.array([[gain * corner], [0.0], [0.0]])
    B2 = np.vstack([[[0.0]], G.B])
    C1 = np.array([[1.0, 0.0, 0.0]])
    C2 = np.hstack([[[0.0]], -G.C])
    nothing = [[0.0]]
    P = plant(*(np.kron(M, I) for M in (A, B1, B2, C1, C2, nothing, nothing, [[1.0]])))
    bound = gain * corner / (zero + corner)
    result = hinfsyn(P, copies, copies, regularisation=1e-5)
    assert result.norm >= bound * (1 - 1e-6)
    assert result.norm <= bound * 1.1


@given(st.integers(1, 7), st.integers(1, 3), st.integers(1, 2), st.integers(0, 100_000))
@settings(max_examples=80, deadline=None)
def test_random_plants(n: int, extra: int, signals: int, seed: int) -> None:
    """What is claimed is kept: stable, norm below gamma, on a dense grid too, and not below what D11 forces."""
    rng = np.random.default_rng(seed)
    nu, ny = signals, 3 - signals
    nw, nz = ny + extra, nu + extra
    P = plant(
        rng.normal(size=(n, n)),
        rng.normal(size=(n, nw)),
        rng.normal(size=(n, nu)),
        rng.normal(size=(nz, n)),
        rng.normal(size=(ny, n)),
        rng.normal(size=(nz, nw)),
        rng.normal(size=(nz, nu)),
        rng.normal(size=(ny, nw)),
        0.3 * rng.normal(size=(ny, nu)),
    )
    result = hinfsyn(P, ny, nu)
    # What theory promises just above the optimum is kept there, within a few tries.
    assert result.gamma <= 1.05 * result.gamma_optimal
    assert result.iterations < 60
    loop = compute_lower_lft(P, result.controller)
    assert loop.poles().real.max() < 0
    grid = singular_values(loop, np.geomspace(1e-4, 1e4, 1500))[:, 0].max()
    # Near its optimum a controller has entries of 1e7, and the loop as computed here their rounding.
    assert grid <= result.gamma * (1 + 1e-6 + 1e-13 * np.abs(result.controller.A).max())
    assert result.norm == pytest.approx(max(grid, result.norm), rel=1e-3)
    U, _, Vt = np.linalg.svd(P.D[:nz, nw:])[0], None, np.linalg.svd(P.D[nz:, :nw])[2]
    floor = max(np.linalg.norm(U[:, nu:].T @ P.D[:nz, :nw], 2), np.linalg.norm(P.D[:nz, :nw] @ Vt[ny:].T, 2))
    assert result.norm >= floor * (1 - 1e-6)


UNITS = st.floats(-12.0, 12.0).map(lambda e: 10.0**e)


@given(st.integers(0, 1000), UNITS, UNITS, UNITS, UNITS, UNITS, st.floats(-4.0, 4.0))
@example(0, 1e-12, 1.0, 1.0, 1.0, 1.0, 0.0)
@example(0, 1.0, 1e12, 1.0, 1.0, 1.0, 0.0)
@example(1, 1e12, 1e12, 1e-12, 1e12, 1e-12, 4.0)
@settings(max_examples=25, deadline=None)
def test_no_unit_enters(seed: int, w: float, z: float, u: float, y: float, rate: float, spread: float) -> None:
    """Other units of signals, states (and their order) and time: the level follows, and so does the controller."""
    rng = np.random.default_rng(seed)
    n = 4
    P = plant(
        rng.normal(size=(n, n)), rng.normal(size=(n, 3)), rng.normal(size=(n, 1)), rng.normal(size=(3, n)),
        rng.normal(size=(1, n)), np.zeros((3, 3)), [[0], [0], [1]], [[0, 0, 1]],
    )  # fmt: skip
    t, order = 10.0 ** np.linspace(-spread, spread, n), rng.permutation(n)
    ins, outs = np.array([w, w, w, u]), np.array([z, z, z, y])
    Q = state_space(
        (P.A * t / t[:, None])[np.ix_(order, order)] * rate, (P.B * ins / t[:, None])[order] * rate,
        (P.C * t * outs[:, None])[:, order], P.D * ins * outs[:, None],
        inputs=P.input_labels, outputs=P.output_labels,
    )  # fmt: skip
    one, other = (hinfsyn(X, 1, 1, gamma_tolerance=1e-5, relaxation=1.1) for X in (P, Q))
    assert other.gamma_optimal == pytest.approx(w * z * one.gamma_optimal, rel=1e-4)
    # The controller in the units of P (u = factor of its unit, time too) keeps the level of P.
    K = other.controller
    back = state_space(K.A / rate, K.B * y / rate, K.C * u, K.D * u * y, inputs=K.input_labels, outputs=K.output_labels)
    assert hinf_norm(compute_lower_lft(P, back))[0] <= 1.11 * one.gamma_optimal
    assert hinf_norm(other.closed_loop)[0] == pytest.approx(other.norm, rel=1e-5)
    # What an anti-windup needs: with the control taken out, the plant's copy is an observer, so it does not grow.
    for X in (one, other):
        assert np.linalg.eigvals(X.controller.A - X.anti_windup_matrix @ X.controller.C).real.max() < 0.0


def test_an_optimum_of_zero_ends_the_search() -> None:
    P = plant([[-1]], [[1, 0]], [[1]], [[0], [0]], [[1]], np.zeros((2, 2)), [[0], [1]], [[0, 1]])
    assert hinfsyn(P, 1, 1).norm < 1e-12


def test_relaxation_leaves_the_optimum_and_keeps_the_bound() -> None:
    result = hinfsyn(scalar(1.0), 1, 1, relaxation=1.3)
    assert result.gamma == pytest.approx(1.3 * result.gamma_optimal)
    assert result.norm <= result.gamma


def test_the_controller_is_an_observer_of_the_plant() -> None:
    """Its copy of the plant takes the control by ``actuation``: A_K - actuation C_K has the dynamics of a filter."""
    P = scalar(1.0)
    result = hinfsyn(P, 1, 1, relaxation=1.2)
    K = result.controller
    assert (K.A - result.anti_windup_matrix @ K.C)[0, 0] < 0.0
    # xhat = x when nothing disturbs: xhat' - x' must not depend on u, so actuation is the plant's B2 in K's scale.
    assert abs(result.anti_windup_matrix[0, 0]) > 0.0


class TestFaultsAreNamed:
    def test_mode_out_of_the_controls_reach(self) -> None:
        P = plant(
            np.diag([2.0, -1.0]), np.ones((2, 2)), [[0], [1]], np.eye(2), [[1, 1]], np.zeros((2, 2)), [[0], [1]],
            [[0, 1]], states=["heat", "speed"],
        )  # fmt: skip
        with pytest.raises(MuflyError, match=r"not stabilisable by u0: mode 2 rad/s \(mainly state 'heat'\)"):
            hinfsyn(P, 1, 1)

    def test_mode_out_of_sight(self) -> None:
        P = plant(
            np.diag([0.5, -1.0]), np.ones((2, 2)), [[1], [1]], np.eye(2), [[0, 1]], np.zeros((2, 2)), [[0], [1]],
            [[0, 1]], states=["heat", "speed"],
        )  # fmt: skip
        with pytest.raises(MuflyError, match=r"not detectable from y0: mode 0.5 rad/s \(mainly state 'heat'\)"):
            hinfsyn(P, 1, 1)

    def test_control_without_weight(self) -> None:
        P = plant([[1]], [[1, 0]], [[1]], [[1], [0]], [[1]], np.zeros((2, 2)), [[0], [0]], [[0, 1]])
        with pytest.raises(MuflyError, match=r"D12 .* loses rank at signal 'u0'"):
            hinfsyn(P, 1, 1)

    def test_measurement_without_noise(self) -> None:
        P = plant([[1]], [[1, 0]], [[1]], [[1], [0]], [[1]], np.zeros((2, 2)), [[0], [1]], [[0, 0]])
        with pytest.raises(MuflyError, match=r"D21 .* loses rank at signal 'y0'"):
            hinfsyn(P, 1, 1)

    def test_zero_on_the_axis(self) -> None:
        oscillator = [[0, 2], [-2, 0]]
        P = plant(
            oscillator, [[1, 0], [0, 0]], [[0], [1]], np.zeros((2, 2)), [[1, 0]], np.zeros((2, 2)), [[0], [1]],
            [[0, 1]], states=["swing", "rate"],
        )  # fmt: skip
        with pytest.raises(MuflyError, match=r"invariant zero on the imaginary axis at 2 rad/s"):
            hinfsyn(P, 1, 1)
        assert hinfsyn(P, 1, 1, regularisation=1e-3).norm < np.inf

    def test_sampled_plant_and_wrong_sizes(self) -> None:
        P = scalar(1.0)
        sampled = ct.ss(P.A, P.B, P.C, P.D, 0.1)
        with pytest.raises(MuflyError, match="discrete time"):
            hinfsyn(sampled, 1, 1)
        with pytest.raises(MuflyError, match="leaves no errors"):
            hinfsyn(P, 3, 1)

    def test_not_a_number(self) -> None:
        P = scalar(1.0)
        A = P.A.copy()
        A[0, 0] = np.nan
        bad = state_space(A, P.B, P.C, P.D, inputs=P.input_labels, outputs=P.output_labels)
        with pytest.raises(MuflyError, match="not finite"):
            hinfsyn(bad, 1, 1)

    def test_no_level_below_the_limit(self) -> None:
        with pytest.raises(MuflyError, match="no controller found with gamma below 2; the weights contradict"):
            hinfsyn(scalar(3.0), 1, 1, gamma_max=2.0)
        # The limit is in the plant's units, and is tried itself.
        assert hinfsyn(scaled_by(scalar(3.0), 1e9), 1, 1, gamma_max=6.4e9).gamma_optimal < 6.4e9
        with pytest.raises(MuflyError, match=r"below 6e\+09"):
            hinfsyn(scaled_by(scalar(3.0), 1e9), 1, 1, gamma_max=6.0e9)

    @pytest.mark.parametrize("coupling", [1e-5, 1e-6, 1e-7])
    def test_at_the_end_of_numbers_a_level_is_kept_or_the_mode_named(self, coupling: float) -> None:
        """A loop whose poles rounding cannot tell from the axis is no loop, and no traceback either."""
        T, c, none = np.array([[0.8, 0.6], [-0.6, 0.8]]), coupling, np.zeros((2, 1))
        P = plant(
            T @ np.diag([2.0, -1.0]) @ T.T, np.hstack([T, none]), T @ [[c], [1]], np.vstack([T.T, none.T]),
            np.array([[c, 1]]) @ T.T, np.zeros((3, 3)), [[0], [0], [1]], [[0, 0, 1]],
        )  # fmt: skip
        try:
            result = hinfsyn(P, 1, 1)
        except MuflyError as error:
            told = str(error)
            assert "mode 2 rad/s" in told
        else:
            assert result.norm <= result.gamma * (1 + 1e-6)

    @pytest.mark.parametrize(("reach", "sight"), [(1e-9, 1.0), (1.0, 1e-9), (1e-6, 1e-6)])
    def test_a_mode_that_can_hardly_be_held_is_named(self, reach: float, sight: float) -> None:
        """Levels of 1e9 are found; where numbers end, the refusal tells the mode and how far it is from impossible."""
        P = plant(
            np.diag([0.7, -1.0]), np.hstack([np.eye(2), np.zeros((2, 1))]), [[reach], [1]],
            np.vstack([np.eye(2), np.zeros((1, 2))]), [[sight, 1]], np.zeros((3, 3)), [[0], [0], [1]], [[0, 0, 1]],
            states=["heat", "speed"],
        )  # fmt: skip
        with pytest.raises(
            MuflyError, match=r"mode 0.7 rad/s \(mainly state 'heat'\) is almost uncontrollable"
        ) as told:
            hinfsyn(P, 1, 1, gamma_max=1e6)
        of_u, of_y = re.search(r"by u0 (\S+), observability from y0 (\S+) \(", str(told.value)).groups()
        assert float(of_u) == pytest.approx(reach, rel=0.8)
        assert float(of_y) == pytest.approx(sight, rel=0.8)

    @pytest.mark.parametrize(
        ("name", "value"),
        [("gamma_tolerance", -1e-3), ("gamma_tolerance", np.nan), ("relaxation", 0.5), ("relaxation", np.inf),
         ("regularisation", -1e-3), ("gamma_max", 0.0)],
    )  # fmt: skip
    def test_impossible_arguments(self, name: str, value: float) -> None:
        with pytest.raises(InputError, match=f"^{name}: {value:g} is out of range; give "):
            hinfsyn(scalar(1.0), 1, 1, **{name: value})


def scaled_by(P, w: float):
    return state_space(P.A, P.B * [w, w, 1], P.C, P.D * [w, w, 1], inputs=P.input_labels, outputs=P.output_labels)


def test_a_tolerance_of_zero_ends_at_rounding() -> None:
    assert hinfsyn(scalar(1.0), 1, 1, gamma_tolerance=0.0).gamma_optimal == pytest.approx(1 + np.sqrt(3), rel=1e-7)
