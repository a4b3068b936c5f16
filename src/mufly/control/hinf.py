"""H-infinity synthesis: a controller that makes the largest gain from ``w`` to ``z`` nearly as small as possible.

The generalised plant, with disturbances ``w``, errors ``z``, controls ``u`` and measurements ``y``, is

    xdot = A x + B1 w + B2 u,   z = C1 x + D11 w + D12 u,   y = C2 x + D21 w + D22 u.

Method: Glover and Doyle, "State-space formulae for all stabilizing controllers that satisfy an H-infinity norm bound"
(Syst. Control Lett. 11, 1988), as in Zhou, Doyle and Glover, *Robust and Optimal Control* (1996), theorem 17.1: for a
level gamma, two Riccati equations (one for full information, one for the filter) have stabilising solutions
X, Y >= 0 with spectral radius rho(X Y) < gamma^2 exactly when a controller with norm below gamma exists.
Bisection on gamma; general D11 and D22 (the latter by the loop shift K = (I + K0 D22)^-1 K0).

The assumptions of the theorem are checked, and named when violated.
``regularisation`` makes those on D12, D21 and the zeros hold by small weights on x and u and small noises on x and y.

The states are scaled first (diagonal balancing of the plant), since weights with corners from 1e-4 to 1e3 rad/s would
otherwise spoil the Riccati equations. What counts in the end is not the level claimed but the norm of the loop that is
closed with the controller found; it is computed independently, on the plant as given, and returned.
"""

from __future__ import annotations

from typing import NamedTuple

import control
import numpy as np
from scipy import linalg

from mufly.control.linear import Array, hinf_norm, state_space
from mufly.errors import MuflyError
from mufly.results import result


@result
class HinfResult:
    """A controller and what it is worth.

    Attributes
    ----------
    controller : control.StateSpace
        From measurements to controls.
    gamma : float
        Level for which it was computed: the bound that theory promises.
    gamma_optimal : float
        Smallest level found feasible (an upper bound of the optimum, within the tolerance).
    norm : float
        H-infinity norm of the closed loop, computed from it; at most ``gamma``.
    peak_frequency : float
        Where that norm is attained, rad/s.
    closed_loop : control.StateSpace
        From ``w`` to ``z``.
    actuation : array, shape (states, controls)
        How the plant's copy inside the controller takes the control: the central controller is an observer,
        ``xhat' = (..) xhat + actuation u + (..) y`` with ``u = C xhat + D y``. What an anti-windup needs.
    iterations : int
        Levels tried.
    """

    controller: control.StateSpace
    gamma: float
    gamma_optimal: float
    norm: float
    peak_frequency: float
    closed_loop: control.StateSpace
    actuation: Array
    iterations: int


class _Parts(NamedTuple):
    """A generalised plant by its signals."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    D12: Array
    D21: Array
    D22: Array


def _parts(A: Array, B: Array, C: Array, D: Array, ny: int, nu: int) -> _Parts:
    """Part the matrices of a plant before its last ``ny`` outputs and ``nu`` inputs."""
    nz, nw = D.shape[0] - ny, D.shape[1] - nu
    rows = D[:nz], D[nz:]
    return _Parts(
        A, B[:, :nw], B[:, nw:], C[:nz], C[nz:], *(part for d in rows for part in (d[:, :nw], d[:, nw:]))
    )


def close_loop(P: control.StateSpace, K: control.StateSpace) -> control.StateSpace:
    """Lower linear fractional transformation: ``P`` with its last signals closed by ``K`` (u = K y).

    Raises
    ------
    MuflyError
        If the loop is not well posed (I - D22 Dk singular).
    """
    A, B1, B2, C1, C2, D11, D12, D21, D22 = _parts(P.A, P.B, P.C, P.D, K.ninputs, K.noutputs)
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


def _normalise(P: control.StateSpace, ny: int, nu: int, regularisation: float) -> tuple[_Parts, Array, Array]:
    """Return the plant with balanced states, D12 = [0; I], D21 = [0, I]; Ru, Ry of u = Ru u~, y~ = Ry y."""
    n = P.nstates
    # Diagonal similarity that evens out rows and columns of [A B; C 0].
    whole = np.block([[P.A, P.B], [P.C, np.zeros(P.D.shape)]])
    for _ in range(20):
        for i in range(n):
            r = np.sqrt(np.sum(whole[i] ** 2) - whole[i, i] ** 2)
            c = np.sqrt(np.sum(whole[:, i] ** 2) - whole[i, i] ** 2)
            if r > 0 and c > 0:
                f = np.exp2(np.round(np.log2(np.sqrt(c / r))))
                whole[i] *= f
                whole[:, i] /= f
    p = _parts(whole[:n, :n], whole[:n, n:], whole[n:, :n], P.D, ny, nu)
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


def _riccati(H: Array) -> Array | None:
    """Stabilising solution X of the Riccati equation of Hamiltonian ``H``; None if an eigenvalue is on the axis."""
    n = H.shape[0] // 2
    with np.errstate(invalid="ignore"):  # scipy casts a permutation that is not asked for
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
    return symmetric


def _central(p: _Parts, gamma: float) -> tuple[Array, Array, Array, Array] | None:
    """Central controller of level ``gamma`` for the normalised plant, or None where there is none."""
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
    X = _riccati(H)
    if X is None:
        return None
    M = np.linalg.solve(S, np.hstack([Dcol @ p.B1.T, C]))
    J = np.block([[p.A.T, np.zeros((n, n))], [-p.B1 @ p.B1.T, -p.A]]) - np.vstack([C.T, -p.B1 @ Dcol.T]) @ M
    Y = _riccati(J)
    if Y is None:
        return None
    for solution in (X, Y):
        values = np.linalg.eigvalsh(solution)
        if values[0] < -1e-7 * values[-1] - 1e-10:
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


def _controller(
    p: _Parts, Ru: Array, Ry: Array, gamma: float, P: control.StateSpace
) -> control.StateSpace | None:
    """Central controller of level ``gamma`` for the plant as given: turned back, and shifted by D22."""
    matrices = _central(p, gamma)
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
    gamma_max: float = 1e8,
) -> HinfResult:
    """Synthesise a controller with (nearly) the smallest H-infinity norm from ``w`` to ``z``.

    Parameters
    ----------
    P : control.StateSpace
        Generalised plant, continuous time; its last ``n_measurements`` outputs and ``n_controls`` inputs belong to the
        controller.
    n_measurements, n_controls : int
        Sizes of ``y`` and ``u``.
    gamma_tolerance : float
        Relative width of the bisection on gamma.
    relaxation : float
        Compute the controller at this factor (at least 1) above the smallest feasible level. At the optimum itself
        the central controller has a mode that runs off to infinity; a few per cent cost little and keep it slow.
    regularisation : float
        Size of small extra weights and noises, relative to the balanced plant; 0 leaves the problem as it is. With
        them the level holds for the plant given as well, since its loop is part of the larger one.
    gamma_max : float
        Level above which the problem counts as infeasible.

    Returns
    -------
    HinfResult

    Raises
    ------
    MuflyError
        Naming the violated assumption with mode, signal or frequency; or when no level up to ``gamma_max`` works.

    Notes
    -----
    Source: Glover and Doyle (1988); Zhou, Doyle and Glover (1996), theorem 17.1. See the module's docstring.

    Thesis: Fig. 6.1; Sec. 6.1.1.
    """
    nw, nz = P.ninputs - n_controls, P.noutputs - n_measurements
    if P.dt not in (0, None):
        raise MuflyError(
            "H-infinity synthesis: the plant is in discrete time; give its continuous-time model"
        )
    if nw < 1 or nz < 1 or n_controls < 1 or n_measurements < 1:
        raise MuflyError(
            f"H-infinity synthesis: a plant of {P.noutputs} outputs and {P.ninputs} inputs leaves no errors or "
            f"disturbances beside {n_measurements} measurements and {n_controls} controls"
        )
    if not all(np.isfinite(M).all() for M in (P.A, P.B, P.C, P.D)):
        raise MuflyError("H-infinity synthesis: the plant holds a number that is not finite")
    p, Ru, Ry = _normalise(P, n_measurements, n_controls, regularisation)
    a, b = p.C1.shape[0] - n_controls, p.B1.shape[1] - n_measurements
    floor = float(
        max(np.linalg.norm(p.D11[:a], 2) if a else 0.0, np.linalg.norm(p.D11[:, :b], 2) if b else 0.0)
    )
    iterations = 0

    def feasible(gamma: float) -> bool:
        nonlocal iterations
        iterations += 1
        try:
            return _central(p, gamma) is not None
        except (np.linalg.LinAlgError, linalg.LinAlgError, ValueError):
            return False

    lower, upper = floor, max(1.0, 1.01 * floor)
    while not feasible(upper):
        lower, upper = upper, 3.0 * upper
        if upper > gamma_max:
            raise MuflyError(
                f"H-infinity synthesis: no controller found with gamma below {gamma_max:g}; the weights "
                "contradict each other or the plant is badly scaled"
            )
    tiny = 1e-9 * upper
    while upper > (1 + gamma_tolerance) * lower and upper > tiny:
        # Geometric once a scale is known, so that a small optimum is found as fast as a large one.
        middle = float(np.sqrt(lower * upper)) if lower > upper / 100 else upper / 10
        if middle <= floor:
            middle = (floor + upper) / 2
        if feasible(middle):
            upper = middle
        else:
            lower = middle
    best = upper
    gamma = best * max(relaxation, 1.0)
    for _ in range(30):
        K = _controller(p, Ru, Ry, gamma, P)
        if K is not None:
            loop = close_loop(P, K)
            norm, where = hinf_norm(loop)
            if norm <= gamma * (1 + 1e-6):
                actuation = p.B2 @ np.linalg.inv(Ru) - K.B @ p.D22
                return HinfResult(K, gamma, best, norm, where, loop, actuation, iterations)
        gamma *= 1.0 + gamma_tolerance if gamma < 1.005 * best else 1.02
    raise MuflyError(
        f"H-infinity synthesis: level {best:.4g} is feasible in theory, but no closed loop keeps it in these numbers; "
        "scale the signals nearer to one or raise regularisation"
    )


def _uncontrollable(A: Array, B: Array, which: str) -> tuple[complex, int] | None:
    """First mode of A that is not controllable by B, and its main state, counted.

    Among those not stable ("unstable") or on the axis ("axis"). Popov-Belevitch-Hautus: the mode is uncontrollable when
    a left eigenvector is orthogonal to B.
    """
    scale = max(float(np.linalg.norm(A, 2)), 1e-300)
    for value in np.linalg.eigvals(A):
        if value.real < -1e-9 * max(scale, 1.0) if which == "unstable" else abs(value.real) > 1e-9 * scale:
            continue
        U, s, _ = np.linalg.svd(np.hstack([A - value * np.eye(A.shape[0]), B]))
        if s[-1] < 1e-11 * s[0]:
            return complex(value), int(np.argmax(np.abs(U[:, -1])))
    return None


def _check_assumptions(p: _Parts, P: control.StateSpace) -> None:
    """Raise a MuflyError that names the first assumption of the synthesis that the plant violates.

    (A, B2) stabilisable, (C2, A) detectable; D12 of full column rank, D21 of full row rank; no invariant zero of
    (A, B2, C1, D12) or (A, B1, C2, D21) on the imaginary axis. With D12 of full column rank the invariant zeros of
    (A, B2, C1, D12) are the unobservable modes of ``(A - B2 D12^+ C1, (I - D12 D12^+) C1)``: what the control can hide
    from the errors. Dually for the other.

    Parameters
    ----------
    p : _Parts
        The plant in the coordinates of the synthesis (balanced, regularised if asked for).
    P : control.StateSpace
        The plant as given: its labels name states and signals.
    """
    ny, nu = p.D22.shape
    measured, controls, states = P.output_labels[-ny:], P.input_labels[-nu:], P.state_labels
    for A, B, start, end in (
        (p.A, p.B2, f"not stabilisable by {', '.join(controls)}", "cannot be moved; remove it"),
        (p.A.T, p.C2.T, f"not detectable from {', '.join(measured)}", "is not seen; measure it"),
    ):
        found = _uncontrollable(A, B, "unstable")
        if found:
            mode, state = found
            value = f"{mode.real:.4g}" if abs(mode.imag) < 1e-12 else f"{mode.real:.4g}{mode.imag:+.4g}j"
            raise MuflyError(
                f"H-infinity synthesis: {start}: mode {value} rad/s (mainly state {states[state]!r}) {end} or make "
                "its weight stable"
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
        found = _uncontrollable(F, G, "axis")
        if found:
            raise MuflyError(
                f"H-infinity synthesis: {name} has an invariant zero on the imaginary axis at {abs(found[0].imag):.4g} "
                f"rad/s (mainly state {states[found[1]]!r}); let a weight act on it or set regularisation"
            )
