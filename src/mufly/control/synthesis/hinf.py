"""H-infinity synthesis: a controller that nearly minimises the H-infinity norm from ``w`` to ``z``.

The generalised plant, with disturbances ``w``, errors ``z``, controls ``u`` and measurements ``y``, is

    xdot = A x + B1 w + B2 u,   z = C1 x + D11 w + D12 u,   y = C2 x + D21 w + D22 u.

Method: Glover and Doyle, "State-space formulae for all stabilizing controllers that satisfy an H-infinity norm bound"
(Syst. Control Lett. 11, 1988), as in Zhou, Doyle and Glover, *Robust and Optimal Control* (1996), theorem 17.1.
A controller with norm below gamma exists exactly when two Riccati equations (full information and filter) have
stabilising solutions X, Y >= 0 with spectral radius rho(X Y) < gamma^2. The level gamma is found by bisection; D11 and
D22 are general (the latter by the loop shift K = (I + K0 D22)^-1 K0).

The assumptions of the theorem are checked, and named when violated. ``regularisation`` satisfies those on D12, D21 and
the zeros by small weights on x and u and small noises on x and y.

The states are scaled first (diagonal balancing of the plant), since weights with corners from 1e-4 to 1e3 rad/s would
otherwise make the Riccati equations ill-conditioned. Signals are scaled, too: w and z by one factor each, every control
and measurement by its own. So all tolerances below refer to rounding, not to the size of the plant. The decisive
result is not the level but the norm of the closed loop; it is computed independently, on the plant as given, and
returned.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import control
import numpy as np
from scipy import linalg

from mufly.control.linear_systems import Array, hinf_norm, replace_matrices, state_space
from mufly.errors import ArgumentError, MuflyError
from mufly.results import result


@result
class HinfResult:
    """A controller with the bound of its H-infinity norm (the level gamma), and its closed loop.

    Attributes
    ----------
    controller : control.StateSpace
        Controller from measurements to controls.
    gamma : float
        Level for which it was computed: the theoretical bound of the norm.
    gamma_optimal : float
        Smallest level found feasible (an upper bound of the optimum, within the tolerance).
    norm : float
        H-infinity norm of the closed loop, computed from it; at most ``gamma``.
    peak_frequency : float
        Frequency at which the norm is attained (rad/s).
    closed_loop : control.StateSpace
        Closed loop from ``w`` to ``z``.
    anti_windup_matrix : array, shape (states, controls)
        Input matrix of the control in the controller's plant model, for anti-windup. The central controller is an
        observer ``xhat' = (..) xhat + anti_windup_matrix u + (..) y`` with ``u = C xhat + D y``.
    iterations : int
        Number of levels tried.
    """

    controller: control.StateSpace
    gamma: float
    gamma_optimal: float
    norm: float
    peak_frequency: float
    closed_loop: control.StateSpace
    anti_windup_matrix: Array
    iterations: int


class PartitionedPlant(NamedTuple):
    """Matrices of a generalised plant, partitioned by its signals."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    D12: Array
    D21: Array
    D22: Array


def partition_plant(A: Array, B: Array, C: Array, D: Array, ny: int, nu: int) -> PartitionedPlant:
    """Partition a plant's matrices; its last ``ny`` outputs are measurements, its last ``nu`` inputs are controls."""
    nz, nw = D.shape[0] - ny, D.shape[1] - nu
    rows = D[:nz], D[nz:]
    return PartitionedPlant(
        A, B[:, :nw], B[:, nw:], C[:nz], C[nz:], *(part for d in rows for part in (d[:, :nw], d[:, nw:]))
    )


def compute_lower_lft(P: control.StateSpace, K: control.StateSpace) -> control.StateSpace:
    """Return the lower linear fractional transformation: ``P`` with its last signals closed by ``K`` (u = K y).

    Raises
    ------
    MuflyError
        If the loop is not well posed (I - D22 Dk singular).
    """
    A, B1, B2, C1, C2, D11, D12, D21, D22 = partition_plant(P.A, P.B, P.C, P.D, K.ninputs, K.noutputs)
    (nz, nw), ny = D11.shape, K.ninputs
    loop = np.eye(ny) - D22 @ K.D
    if np.linalg.cond(loop) > 1e12:
        raise MuflyError("closed loop is not well posed: I - D22 Dk is singular")
    E = np.linalg.inv(loop)  # y = E (C2 x + D22 Ck xk + D21 w)
    Cu = np.hstack([K.D @ E @ C2, K.C + K.D @ E @ D22 @ K.C])
    Cy = np.hstack([E @ C2, E @ D22 @ K.C])
    Du, Dy = K.D @ E @ D21, E @ D21
    A = linalg.block_diag(A, K.A) + np.vstack([B2 @ Cu, K.B @ Cy])
    B = np.vstack([B1 + B2 @ Du, K.B @ Dy])
    C = np.hstack([C1, np.zeros((nz, K.nstates))]) + D12 @ Cu
    return state_space(A, B, C, D11 + D12 @ Du, inputs=P.input_labels[:nw], outputs=P.output_labels[:nz])


_MAX_GAMMA, _MIN_GAMMA = 1e20, 1e-18  # bounds of the level search, for a plant with all signals near one
_MAX_UNSCALED_EXPONENT_BITS = 10  # signals within 2^10 of one are not scaled, so that ordinary plants keep every bit


def _scale_signals(P: control.StateSpace, inputs: Array, outputs: Array) -> control.StateSpace:
    """Return the plant with its inputs and outputs in other units."""
    return replace_matrices(P, B=P.B * inputs, C=P.C * outputs[:, None], D=P.D * inputs * outputs[:, None])


def scale_states_diagonally(P: control.StateSpace) -> control.StateSpace:
    """Return the plant after diagonal scaling, in powers of two, that balances rows and columns of [A B; C 0]."""
    n = P.nstates
    whole = np.block([[P.A, P.B], [P.C, np.zeros(P.D.shape)]])
    for _ in range(20):
        before = whole.copy()
        for i in range(n):
            r = np.sqrt(np.sum(whole[i] ** 2) - whole[i, i] ** 2)
            c = np.sqrt(np.sum(whole[:, i] ** 2) - whole[i, i] ** 2)
            if r > 0 and c > 0:
                f = np.exp2(np.round(np.log2(np.sqrt(c / r))))
                whole[i] *= f
                whole[:, i] /= f
        if np.array_equal(before, whole):
            break
    return replace_matrices(P, A=whole[:n, :n], B=whole[:n, n:], C=whole[n:, :n])


def _signal_scales(P: control.StateSpace, ny: int, nu: int) -> tuple[Array, Array]:
    """Return factors on inputs and outputs (one for all of w, one for all of z) that bring every signal near one.

    The size of a signal is the norm of its column of ``[B / sqrt(r); D]`` or row of ``[C / sqrt(r), D]``. The states
    are balanced, and r is the norm of A. If A is negligible, r is that of a loop closed over D12 or D21. So the units
    of states and of time do not enter."""
    inputs, outputs = np.ones(P.ninputs), np.ones(P.noutputs)
    nw, nz = P.ninputs - nu, P.noutputs - ny
    for _ in range(20):
        even = scale_states_diagonally(_scale_signals(P, inputs, outputs))
        p = partition_plant(even.A, even.B, even.C, even.D, ny, nu)
        loops = ((p.B2 @ np.linalg.pinv(p.D12), p.C1), (p.B1, np.linalg.pinv(p.D21) @ p.C2))
        rate = max(np.linalg.norm(p.A), *(1e-6 * np.linalg.norm(M) * np.linalg.norm(N) for M, N in loops))
        root = np.sqrt(rate or 1.0)
        changed = False
        for factors, size, common in (
            (inputs, np.linalg.norm(np.vstack([even.B / root, even.D]), axis=0), nw),
            (outputs, np.linalg.norm(np.hstack([even.C / root, even.D]), axis=1), nz),
        ):
            size[:common] = np.linalg.norm(size[:common])
            bits = np.round(np.log2(np.where(size > 0, size, 1.0)))
            far = np.abs(bits) > _MAX_UNSCALED_EXPONENT_BITS
            if far.any() and not changed:
                factors *= np.exp2(np.where(far, -bits, 0.0))
                changed = True
        if not changed:
            break
    return inputs, outputs


def _normalise_plant(
    P: control.StateSpace, ny: int, nu: int, regularisation: float
) -> tuple[PartitionedPlant, Array, Array]:
    """Normalise a plant to D12 = [0; I] and D21 = [0, I]; return it with Ru and Ry, where u = Ru u~ and y~ = Ry y."""
    n = P.nstates
    p = partition_plant(P.A, P.B, P.C, P.D, ny, nu)
    if regularisation > 0.0:
        eps = regularisation
        p = p._replace(
            B1=np.hstack([p.B1, eps * np.eye(n), np.zeros((n, ny))]),
            C1=np.vstack([p.C1, eps * np.eye(n), np.zeros((nu, n))]),
            D12=np.vstack([p.D12, np.zeros((n, nu)), eps * np.eye(nu)]),
            D21=np.hstack([p.D21, np.zeros((ny, n)), eps * np.eye(ny)]),
            D11=np.pad(p.D11, ((0, n + nu), (0, n + ny))),
        )
    _check_assumptions(p, P)
    U, s, Vt = np.linalg.svd(p.D12)
    z_turn = np.hstack([U[:, nu:], U[:, :nu]])  # z = z_turn z~ puts the controls last
    Ru = Vt.T / s
    U, s, Vt = np.linalg.svd(p.D21)
    w_turn = np.hstack([Vt[ny:].T, Vt[:ny].T])
    Ry = (U / s).T
    a, b = len(p.C1) - nu, p.B1.shape[1] - ny
    normal = p._replace(
        B1=p.B1 @ w_turn,
        B2=p.B2 @ Ru,
        C1=z_turn.T @ p.C1,
        C2=Ry @ p.C2,
        D11=z_turn.T @ p.D11 @ w_turn,
        D12=np.vstack([np.zeros((a, nu)), np.eye(nu)]),
        D21=np.hstack([np.zeros((ny, b)), np.eye(ny)]),
    )
    return normal, Ru, Ry


def _solve_riccati(H: Array) -> Array | None:
    """Return the stabilising Riccati solution X of Hamiltonian ``H``; None if it has eigenvalues on the axis."""
    n = H.shape[0] // 2
    with np.errstate(invalid="ignore"):  # scipy casts an unused permutation
        balanced, scaling = linalg.matrix_balance(H, permute=False, separate=True)
    d = scaling[0]
    T, Z, stable = linalg.schur(balanced, sort="lhp")
    if stable != n:
        return None
    diagonal = np.abs(np.linalg.eigvals(T[:n, :n]).real)
    if diagonal.min() < 1e-13 * np.abs(T).max():
        return None
    U = d[:, None] * Z[:, :n]
    if n and np.linalg.cond(U[:n]) > 1e15:
        return None
    X = np.linalg.solve(U[:n].T, U[n:].T).T
    symmetric: Array = (X + X.T) / 2
    # X must be positive semidefinite in the balanced coordinates. At an infeasible level X passes through infinity to
    # negative values. But where X is near zero, a rounding error N of the Hamiltonian makes it as negative as -E, with
    # E of the Lyapunov equation Ac' E + E Ac + N = 0.
    even = np.sqrt(d[:n] / d[n:])

    def is_negative_definite(M: Array) -> bool:
        values = np.linalg.eigvalsh(M * even * even[:, None])
        return bool(values[0] < -1e-7 * values[-1])

    if is_negative_definite(symmetric):
        noise = 100.0 * np.finfo(float).eps * np.linalg.norm(balanced) * np.diag(even**-2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a mode near the axis gives a large bound, tested below
            doubt = linalg.solve_continuous_lyapunov((H[:n, :n] + H[:n, n:] @ symmetric).T, -noise)
        # A large error bound is inconclusive.
        if is_negative_definite(symmetric + doubt) or np.linalg.norm(doubt * even * even[:, None]) > 1.0:
            return None
    return symmetric


def _central_controller(p: PartitionedPlant, gamma: float) -> tuple[Array, Array, Array, Array] | None:
    """Return the central controller of level ``gamma`` for the normalised plant, or None if there is none."""
    n, nw, nu = p.A.shape[0], p.B1.shape[1], p.B2.shape[1]
    nz, ny = p.C1.shape[0], p.C2.shape[0]
    a, b = nz - nu, nw - ny  # sizes of the first parts of z and w
    g2 = gamma**2
    D1111, D1112, D1121, D1122 = p.D11[:a, :b], p.D11[:a, b:], p.D11[a:, :b], p.D11[a:, b:]
    B = np.hstack([p.B1, p.B2])
    C = np.vstack([p.C1, p.C2])
    Drow, Dcol = np.hstack([p.D11, p.D12]), np.vstack([p.D11, p.D21])
    R = Drow.T @ Drow - linalg.block_diag(g2 * np.eye(nw), np.zeros((nu, nu)))
    S = Dcol @ Dcol.T - linalg.block_diag(g2 * np.eye(nz), np.zeros((ny, ny)))
    M = np.linalg.solve(R, np.hstack([Drow.T @ p.C1, B.T]))
    H = np.block([[p.A, np.zeros((n, n))], [-p.C1.T @ p.C1, -p.A.T]]) - np.vstack([B, -p.C1.T @ Drow]) @ M
    X = _solve_riccati(H)
    if X is None:
        return None
    M = np.linalg.solve(S, np.hstack([Dcol @ p.B1.T, C]))
    J = np.block([[p.A.T, np.zeros((n, n))], [-p.B1 @ p.B1.T, -p.A]]) - np.vstack([C.T, -p.B1 @ Dcol.T]) @ M
    Y = _solve_riccati(J)
    if Y is None:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        product = X @ Y
    if n and not (np.isfinite(product).all() and np.abs(np.linalg.eigvals(product)).max() < g2):
        return None
    F = -np.linalg.solve(R, Drow.T @ p.C1 + B.T @ X)
    L = -np.linalg.solve(S.T, (p.B1 @ Dcol.T + Y @ C.T).T).T
    F12, F2 = F[b:nw], F[nw:]
    L12, L2 = L[:, a:nz], L[:, nz:]
    left = np.linalg.inv(g2 * np.eye(a) - D1111 @ D1111.T)
    right = np.linalg.inv(g2 * np.eye(b) - D1111.T @ D1111)
    Dk = -D1121 @ D1111.T @ left @ D1112 - D1122
    try:
        D12k = np.linalg.cholesky(np.eye(nu) - D1121 @ right @ D1121.T)
        D21k = np.linalg.cholesky(np.eye(ny) - D1112.T @ left @ D1112).T
    except np.linalg.LinAlgError:
        return None
    Z = np.eye(n) - Y @ X / g2
    B2k = np.linalg.solve(Z, p.B2 + L12) @ D12k
    C2k = -D21k @ (p.C2 + F12)
    Bk = -np.linalg.solve(Z, L2) + B2k @ np.linalg.solve(D12k, Dk)
    Ck = F2 + Dk @ np.linalg.solve(D21k, C2k)
    Ak = p.A + B @ F + Bk @ np.linalg.solve(D21k, C2k)
    return Ak, Bk, Ck, Dk


def _recover_controller(
    p: PartitionedPlant, Ru: Array, Ry: Array, gamma: float, P: control.StateSpace
) -> control.StateSpace | None:
    """Return the central controller of level ``gamma`` in the units of the given plant, corrected for its
    feedthrough D22.
    """
    matrices = _central_controller(p, gamma)
    if matrices is None:
        return None
    (ny, nu), D22 = p.D22.shape, p.D22
    Ak, Bk, Ck, Dk = matrices
    Bk, Ck, Dk = Bk @ Ry, Ru @ Ck, Ru @ Dk @ Ry
    E = np.eye(nu) + Dk @ D22
    if np.linalg.cond(E) > 1e12:
        return None
    Ck, Dk = np.linalg.solve(E, Ck), np.linalg.solve(E, Dk)
    Ak, Bk = Ak - Bk @ D22 @ Ck, Bk - Bk @ D22 @ Dk
    if not all(np.isfinite(M).all() for M in (Ak, Bk, Ck, Dk)):
        return None
    return state_space(Ak, Bk, Ck, Dk, inputs=P.output_labels[-ny:], outputs=P.input_labels[-nu:])


def hinfsyn(
    P: control.StateSpace,
    n_measurements: int,
    n_controls: int,
    *,
    gamma_tolerance: float = 1e-3,
    relaxation: float = 1.0,
    regularisation: float = 0.0,
    gamma_max: float | None = None,
) -> HinfResult:
    """Synthesise a controller with nearly the smallest H-infinity norm from ``w`` to ``z``.

    Parameters
    ----------
    P : control.StateSpace
        Generalised plant, continuous time; its last ``n_measurements`` outputs and ``n_controls`` inputs are those
        of the controller.
    n_measurements, n_controls : int
        Sizes of ``y`` and ``u``.
    gamma_tolerance : float
        Relative width of the bisection on gamma, at least 0; limited by rounding.
    relaxation : float
        Factor (at least 1) of the controller's level above the smallest feasible one. At the optimum the central
        controller has an infinitely fast mode; a few per cent cost little and keep it slow.
    regularisation : float
        Size of small extra weights and noises, relative to the balanced plant; 0 adds none. The level also holds
        for the plant as given, since its loop is part of the extended one.
    gamma_max : float, optional
        Level above which the problem counts as infeasible; by default the numerical limit.

    Returns
    -------
    HinfResult

    Raises
    ------
    ArgumentError
        If tolerance, relaxation, regularisation or ``gamma_max`` is out of range.
    MuflyError
        If an assumption is violated (the message names it with mode, signal or frequency), or no level up to
        ``gamma_max`` is feasible.

    Notes
    -----
    Source: Glover and Doyle (1988); Zhou, Doyle and Glover (1996), theorem 17.1. See the module's docstring.

    Thesis: Fig. 6.1; Sec. 6.1.1.
    """
    for name, value, least, most in (
        ("gamma_tolerance", gamma_tolerance, 0.0, 1.0),
        ("relaxation", relaxation, 1.0, np.inf),
        ("regularisation", regularisation, 0.0, 1.0),
        ("gamma_max", 1.0 if gamma_max is None else gamma_max, np.finfo(float).tiny, np.inf),
    ):
        if not (least <= value <= most and np.isfinite(value)):
            upto = f" to {most:g}" if np.isfinite(most) else " or more"
            raise ArgumentError(name, "", f"{value:g} is out of range", f"give {least:g}{upto}")
    nw, nz = P.ninputs - n_controls, P.noutputs - n_measurements
    if P.dt not in (0, None):
        raise MuflyError("H-infinity synthesis: the plant is in discrete time; give its continuous-time model")
    if nw < 1 or nz < 1 or n_controls < 1 or n_measurements < 1:
        raise MuflyError(
            f"H-infinity synthesis: a plant of {P.noutputs} outputs and {P.ninputs} inputs leaves no errors or "
            f"disturbances beside {n_measurements} measurements and {n_controls} controls"
        )
    if not all(np.isfinite(M).all() for M in (P.A, P.B, P.C, P.D)):
        raise MuflyError("H-infinity synthesis: the plant holds a number that is not finite")
    inputs, outputs = _signal_scales(P, n_measurements, n_controls)
    unit = float(inputs[0] * outputs[0])  # ratio of a level of the scaled plant to one of the plant as given
    scaled = scale_states_diagonally(_scale_signals(P, inputs, outputs))
    p, Ru, Ry = _normalise_plant(scaled, n_measurements, n_controls, regularisation)
    a, b = p.C1.shape[0] - n_controls, p.B1.shape[1] - n_measurements
    floor = float(max(np.linalg.norm(p.D11[:a], 2) if a else 0.0, np.linalg.norm(p.D11[:, :b], 2) if b else 0.0))
    most = _MAX_GAMMA if gamma_max is None else gamma_max * unit
    iterations = 0

    def is_feasible(gamma: float) -> bool:
        nonlocal iterations
        iterations += 1
        try:
            return _central_controller(p, gamma) is not None
        except (np.linalg.LinAlgError, linalg.LinAlgError, ValueError):
            return False

    lower, upper, promised = floor, min(max(1.0, 1.01 * floor), most), None
    while True:
        while not is_feasible(upper):
            if upper >= most:
                raise MuflyError(_explain_infeasible(p, scaled, promised, most, unit))
            lower, upper = upper, min(3.0 * upper, most)
        while upper > (1 + gamma_tolerance) * lower and upper > _MIN_GAMMA:
            # Geometric bisection once the scale is known, so that small optima are found as fast as large ones.
            middle = float(np.sqrt(lower * upper)) if lower > upper / 100 else upper / 10
            if middle <= floor:
                middle = (floor + upper) / 2
            if not lower < middle < upper:  # limit of floating point
                break
            if is_feasible(middle):
                upper = middle
            else:
                lower = middle
        best = upper
        promised = promised or best
        for k in range(-1, 40):
            # Just above the optimum rounding may break the bound: increase the distance in doubled steps.
            gamma = best * relaxation * (1.0 if k < 0 else 1.0 + max(gamma_tolerance, 1e-9) * 2.0**k)
            if gamma > 2.0 * best * relaxation:
                break
            K = _recover_controller(p, Ru, Ry, gamma, scaled)
            if K is not None:
                try:
                    loop = compute_lower_lft(scaled, K)
                    norm, where = hinf_norm(loop)
                except (MuflyError, np.linalg.LinAlgError):  # not well posed, or beyond rounding
                    continue
                if norm <= gamma * (1 + 1e-6):
                    u, y = inputs[-n_controls:], outputs[-n_measurements:]
                    actuation = (p.B2 @ np.linalg.inv(Ru) - K.B @ p.D22) / u
                    return HinfResult(
                        _scale_signals(K, y, u),
                        gamma / unit,
                        min(best, norm) / unit,
                        norm / unit,
                        where,
                        _scale_signals(loop, 1 / inputs[:-n_controls], 1 / outputs[:-n_measurements]),
                        actuation,
                        iterations,
                    )
        # No computed loop meets this level: search above it.
        lower, upper = gamma, min(3.0 * gamma, most)
        if lower >= most:
            raise MuflyError(_explain_infeasible(p, scaled, promised, most, unit))


def _explain_infeasible(
    p: PartitionedPlant, P: control.StateSpace, promised: float | None, most: float, unit: float
) -> str:
    """Return the reason of an infeasible synthesis: the failed level, and the least controllable or observable mode."""
    if promised is None:
        said = f"no controller found with gamma below {most / unit:.3g}"
    else:
        said = f"level {promised / unit:.4g} is feasible in theory, but rounding prevents a controller"
    ny, nu = p.D22.shape
    modes = zip(
        _mode_controllability(p.A, p.B2, "unstable"),
        _mode_controllability(p.A.T, p.C2.T, "unstable"),
        strict=True,
    )
    (mode, moved, state), (_, seen, _) = min(modes, key=lambda m: m[0][1] * m[1][1], default=((0j, 1.0, 0),) * 2)
    if moved * seen > 1e-2:
        return f"H-infinity synthesis: {said}; the weights contradict each other or require more than the plant allows"
    return (
        f"H-infinity synthesis: {said}; mode {_format_mode(mode)} rad/s (mainly state {P.state_labels[state]!r}) is "
        f"almost uncontrollable or unobservable: controllability by {', '.join(P.input_labels[-nu:])} {moved:.1e}, "
        f"observability from {', '.join(P.output_labels[-ny:])} {seen:.1e} (1: full; below 1e-11: none); add a control "
        "or a measurement for it, or make its weight stable"
    )


def _mode_controllability(A: Array, B: Array, which: str) -> list[tuple[complex, float, int]]:
    """Return modes of A, the degree to which B controls each, and the index of the mode's main state.

    ``which`` selects modes that are not stable ("unstable") or on the axis ("axis"). Popov-Belevitch-Hautus: a mode is
    uncontrollable when ``[A - s I, B]`` loses rank; the degree is its smallest singular value over the largest.
    """
    scale = float(np.linalg.norm(A, 2)) if A.size else 0.0
    values = np.linalg.eigvals(A)
    size = np.abs(values)
    # Rounding of the large modes must not make a slow stable weight count as an integrator.
    zero = min(1e-9 * scale, 1e-3 * float(size[size > 1e-13 * scale].min(initial=np.inf)))
    found = []
    for value in values:
        if value.real < -zero if which == "unstable" else abs(value.real) > zero:
            continue
        U, s, _ = np.linalg.svd(np.hstack([A - value * np.eye(A.shape[0]), B]))
        found.append((complex(value), float(s[-1] / (s[0] or 1.0)), int(np.argmax(np.abs(U[:, -1])))))
    return found


def _format_mode(mode: complex) -> str:
    return f"{mode.real:.4g}" if abs(mode.imag) < 1e-12 * abs(mode) else f"{mode.real:.4g}{mode.imag:+.4g}j"


def _check_assumptions(p: PartitionedPlant, P: control.StateSpace) -> None:
    """Raise a MuflyError that names the first assumption of the synthesis that the plant violates.

    The assumptions: (A, B2) stabilisable, (C2, A) detectable; D12 of full column rank, D21 of full row rank; no
    invariant zero of (A, B2, C1, D12) or (A, B1, C2, D21) on the imaginary axis. With D12 of full column rank the
    invariant zeros of (A, B2, C1, D12) are the unobservable modes of ``(A - B2 D12^+ C1, (I - D12 D12^+) C1)``. The
    other zeros follow by duality.

    Parameters
    ----------
    p : PartitionedPlant
        Plant in the coordinates of the synthesis (balanced, regularised if requested).
    P : control.StateSpace
        Plant as given: its labels name states and signals.
    """
    ny, nu = p.D22.shape
    measured, controls, states = P.output_labels[-ny:], P.input_labels[-nu:], P.state_labels
    for A, B, start, end in (
        (p.A, p.B2, f"not stabilisable by {', '.join(controls)}", "is not controllable; remove it"),
        (p.A.T, p.C2.T, f"not detectable from {', '.join(measured)}", "is not observable; add a measurement"),
    ):
        for mode, reach, state in _mode_controllability(A, B, "unstable"):
            if reach < 1e-11:
                raise MuflyError(
                    f"H-infinity synthesis: {start}: mode {_format_mode(mode)} rad/s (mainly state {states[state]!r}) "
                    f"{end} or make its weight stable"
                )
    for D, name, names, remedy in (
        (p.D12, "D12 (controls to errors)", controls, "give every control a weight at high frequency"),
        (p.D21.T, "D21 (disturbances to measurements)", measured, "give every measurement some noise"),
    ):
        _, s, Vt = np.linalg.svd(D)
        if D.shape[0] < D.shape[1] or s[-1] <= 1e-10 * max(s[0], 1e-300):
            raise MuflyError(
                f"H-infinity synthesis: {name} loses rank at signal {names[int(np.argmax(np.abs(Vt[-1])))]!r}; "
                f"{remedy} or set regularisation"
            )
    D12i, D21i = np.linalg.pinv(p.D12), np.linalg.pinv(p.D21)
    nz, nw = p.D11.shape
    for F, G, name in (
        ((p.A - p.B2 @ D12i @ p.C1).T, ((np.eye(nz) - p.D12 @ D12i) @ p.C1).T, "(A, B2, C1, D12)"),
        (p.A - p.B1 @ D21i @ p.C2, p.B1 @ (np.eye(nw) - D21i @ p.D21), "(A, B1, C2, D21)"),
    ):
        for zero, reach, state in _mode_controllability(F, G, "axis"):
            if reach < 1e-11:
                raise MuflyError(
                    f"H-infinity synthesis: {name} has an invariant zero on the imaginary axis at {abs(zero.imag):.4g} "
                    f"rad/s (mainly state {states[state]!r}); add a weight that acts on it or set regularisation"
                )
