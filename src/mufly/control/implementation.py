"""Order reduction of controllers, judged by the closed loop, and discretisation.

The controller is split into slow modes (practically integrators), which stay unchanged, and the rest. The rest is
transformed to coordinates with equal Gramians of excitation and effect, and the weak directions are removed. Two pairs
of Gramians are tried:

- ``loop``: in the closed loop of the design. A small change dK of the controller changes the loop from ``w`` to ``z``
  by ``T_zu dK T_ew``. So excitation is measured by the controller running in its loop, and effect by the controller in
  series with ``T_zu`` (Enns, 23rd IEEE CDC, 1984, with both weights from the loop).
- ``open``: from the controller's own inputs to its outputs (Moore 1981).

There are two methods of removal. ``match`` sets the weak states to their equilibrium (singular perturbation, Liu and
Anderson 1989): ``A11 - A12 A22^-1 A21`` and so on; it keeps the controller's static gain. ``truncate`` drops them and
keeps the gain at high frequency. Plain balanced truncation ruins the heave-yaw loop, and the criteria reject it.

Modes slower than a threshold are kept. Two thresholds are tried: one that keeps only the integrators (``slow`` small),
and one at the loop's crossover, since modes below it shape the reference response but add little to any Gramian.

A candidate passes when the closed loop is stable, its peaks of S_u and T_u exceed the full controller's by no more than
a tolerance, and the norm from ``w`` to ``z`` by no more than a factor. The lowest order that passes is taken. If none
passes, the next looser tolerance is tried; the result states the tolerance met. Controllers whose observer form
(``A - M C``, active while actuators saturate) is stable are preferred.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import control
import numpy as np
from scipy import linalg

from mufly.control.linear_systems import (
    Array,
    LoopAnalysis,
    analyse_loop,
    connect_blocks,
    extract_feedback_controller,
    frequency_response,
    hinf_norm,
    is_stable_loop,
    largest_gain,
    loop_sensitivities,
    replace_matrices,
    sample_plant,
    state_space,
)
from mufly.control.synthesis.hinf import compute_lower_lft
from mufly.dynamics import extract_submodel
from mufly.errors import MuflyError
from mufly.results import result

REDUCTION_TOLERANCES = ((0.1, 1.01), (0.2, 1.05), (0.5, 1.2), (1.0, 1.5))  # dB on the peaks, factor on the norm
_RELATIVE_NORM_TOLERANCE = 1e-6  # relative difference below which two norms count as equal


@result
class ReducedCandidate:
    """One reduced controller, with the peaks and the norm of its loop.

    Attributes
    ----------
    order : int
    method : str
        ``"loop match"``, ``"loop truncate"``, ``"open match"`` or ``"open truncate"``.
    kept_modes : int
        Number of slow modes kept exactly.
    sensitivity_peak_dB, complementary_peak_dB : float
        Peaks of S_u and T_u; inf if unstable.
    norm : float
        Norm from ``w`` to ``z``; nan if the peaks already exclude the candidate.
    meets_tolerance : bool
    """

    order: int
    method: str
    kept_modes: int
    sensitivity_peak_dB: float
    complementary_peak_dB: float
    norm: float
    meets_tolerance: bool


@result
class ControllerReduction:
    """Result of the order reduction: the chosen controller, and all candidates with their figures.

    Attributes
    ----------
    controller : control.StateSpace
    anti_windup_matrix : array, shape (states, controls)
        The anti-windup input in the reduced coordinates.
    chosen : ReducedCandidate
    tolerance_dB, norm_factor : float
        The tolerance met.
    full_order : int
    full_norm : float
        Norm from ``w`` to ``z`` with the controller of full order.
    candidates : tuple of ReducedCandidate
    """

    controller: control.StateSpace
    anti_windup_matrix: Array
    chosen: ReducedCandidate
    tolerance_dB: float
    norm_factor: float
    full_order: int
    full_norm: float
    candidates: tuple[ReducedCandidate, ...]


def separate_slow_modes(A: Array, slow: float) -> tuple[Array, int]:
    """Return T that block-diagonalises A, and the number of leading modes, unstable or slower than ``slow`` (rad/s)."""

    def is_slow_or_unstable(real: float, imag: float) -> bool:
        return real >= 0.0 or np.hypot(real, imag) < slow

    T, Z, count = linalg.schur(A, output="real", sort=is_slow_or_unstable)
    n = A.shape[0]
    if 0 < count < n:
        # A11 R - R A22 = -A12 removes the coupling.
        R = linalg.solve_sylvester(T[:count, :count], -T[count:, count:], -T[:count, count:])
        Z = Z @ np.block([[np.eye(count), R], [np.zeros((n - count, count)), np.eye(n - count)]])
    return Z, count


def _gramian_root(gramian: Array) -> Array:
    """Return R with R R' = gramian, negative rounding errors removed."""
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def balancing_transform(P: Array, Q: Array) -> tuple[Array, Array]:
    """Return the transformation T that makes two Gramians equal and diagonal (square-root balancing), and its inverse.

    Directions in which a Gramian is zero get an orthonormal basis.
    """
    R, S = _gramian_root(P), _gramian_root(Q)
    U, sigma, Vt = np.linalg.svd(S.T @ R)
    keep = sigma > 1e-14 * sigma[0]
    scale = 1 / np.sqrt(np.where(keep, sigma, 1.0))
    T, Tinv = R @ Vt.T * scale, (scale[:, None] * U.T) @ S.T
    if not keep.all():
        rank = int(keep.sum())
        N = linalg.null_space(Tinv[:rank])
        T = np.hstack([T[:, :rank], N])
        Tinv = np.linalg.inv(T)
    return T, Tinv


def keep_leading_states(
    K: control.StateSpace, M: Array, order: int, match: bool
) -> tuple[control.StateSpace, Array] | None:
    """Return a controller with its first ``order`` states, and its reduced anti-windup input M; None if impossible.

    With ``match`` the static gain is kept, else the other states are truncated.
    """
    A, B, C, D = K.A, np.hstack([K.B, M]), K.C, np.hstack([K.D, np.zeros((K.noutputs, M.shape[1]))])
    if match and order < K.nstates:
        A22 = A[order:, order:]
        if np.linalg.cond(A22) > 1e12:
            return None
        X = np.linalg.solve(A22, np.hstack([A[order:, :order], B[order:]]))
        XA, XB = X[:, :order], X[:, order:]
        D = D - C[:, order:] @ XB
        A, B, C = (
            A[:order, :order] - A[:order, order:] @ XA,
            B[:order] - A[:order, order:] @ XB,
            C[:, :order] - C[:, order:] @ XA,
        )
    else:
        A, B, C = A[:order, :order], B[:order], C[:, :order]
    m = K.ninputs
    return replace_matrices(K, A=A, B=B[:, :m], C=C, D=D[:, :m]), B[:, m:]


def reduce_controller(
    generalised: control.StateSpace,
    controller: control.StateSpace,
    actuation: Array,
    plant: control.StateSpace,
    error_inputs: Sequence[int],
    *,
    order_max: int,
    order_min: int = 1,
    tolerances: Sequence[tuple[float, float]] = REDUCTION_TOLERANCES,
    slow: Sequence[float] = (0.1,),
) -> ControllerReduction:
    """Reduce a controller to the lowest order whose closed loop stays within the tolerance.

    Parameters
    ----------
    generalised : control.StateSpace
        Generalised plant of the synthesis, controller signals last.
    controller : control.StateSpace
        Controller of the synthesis (scaled).
    actuation : array, shape (states, controls)
        ``HinfResult.anti_windup_matrix``; transformed like one more input.
    plant : control.StateSpace
        Scaled plant without weights.
    error_inputs : sequence of int
        Controller inputs that are errors of the plant's outputs, in their order.
    order_max, order_min : int
        Range of the orders tried.
    tolerances : sequence of (float, float)
        From strict to loose: permitted increase of the peaks of S_u and T_u (dB), permitted factor on the norm.
    slow : sequence of float
        Thresholds (rad/s) below which controller modes are kept exactly; each is tried.

    Returns
    -------
    ControllerReduction

    Raises
    ------
    MuflyError
        If no order up to ``order_max`` passes; the message names the best.
    """
    rows = list(error_inputs)
    judge = _LoopPeaks(plant, rows)
    full_s, full_t = judge.sensitivity_peaks(controller)
    full_loop = compute_lower_lft(generalised, controller)
    full_norm = hinf_norm(full_loop, tolerance=1e-4)[0]
    n = controller.nstates
    tried: list[tuple[ReducedCandidate, control.StateSpace, Array]] = []
    counts: set[int] = set()
    for threshold in slow:
        Z, kept = separate_slow_modes(controller.A, threshold)
        if kept in counts:
            continue
        counts.add(kept)
        for name, (K, M) in balanced_realisations(generalised, controller, actuation, Z, kept).items():
            for order in range(max(kept, order_min, 1), min(order_max, n) + 1):
                for match in (True, False):
                    removed = keep_leading_states(K, M, order, match)
                    if removed is None:
                        continue
                    s, t = judge.sensitivity_peaks(removed[0])
                    method = f"{name} {'match' if match else 'truncate'}"
                    tried.append((ReducedCandidate(order, method, kept, s, t, np.nan, False), *removed))

    for tolerance, factor in tolerances:
        tried = [_add_loop_norm(entry, generalised, full_s + tolerance, full_t + tolerance) for entry in tried]
        good = [
            entry
            for entry in tried
            if entry[0].sensitivity_peak_dB <= full_s + tolerance
            and entry[0].complementary_peak_dB <= full_t + tolerance
            and entry[0].norm <= factor * full_norm
        ]
        if good:
            sound = [e for e in good if np.linalg.eigvals(e[1].A - e[2] @ e[1].C).real.max() < -1e-4]
            chosen, K, M = _choose_candidate(sound or good)
            meets_tolerance = {id(entry[0]) for entry in good}
            listed = tuple(
                replace(c, meets_tolerance=id(c) in meets_tolerance)
                for c, _, _ in sorted(tried, key=lambda e: e[0].order)
            )
            chosen = replace(chosen, meets_tolerance=True)
            return ControllerReduction(K, M, chosen, tolerance, factor, n, full_norm, listed)
    best = min((entry[0] for entry in tried), key=lambda c: max(c.sensitivity_peak_dB, c.complementary_peak_dB))
    raise MuflyError(
        f"order reduction: no controller of order {order_max} or less is within the tolerance (full order {n}: peaks "
        f"{full_s:.2f} and {full_t:.2f} dB, norm {full_norm:.3g}; nearest: order {best.order} by {best.method!r}, "
        f"peaks {best.sensitivity_peak_dB:.2f} and {best.complementary_peak_dB:.2f} dB, norm {best.norm:.3g}); "
        "allow a larger tolerance or order"
    )


def _add_loop_norm(
    entry: tuple[ReducedCandidate, control.StateSpace, Array], generalised: control.StateSpace, s: float, t: float
) -> tuple[ReducedCandidate, control.StateSpace, Array]:
    """Return the candidate with the norm of its loop, computed if its peaks of S_u and T_u are at most ``s`` and ``t``
    (dB).

    A candidate with larger peaks, or with a norm, is returned unchanged.
    """
    c, K, M = entry
    if c.sensitivity_peak_dB > s or c.complementary_peak_dB > t or np.isfinite(c.norm):
        return entry
    return replace(c, norm=hinf_norm(compute_lower_lft(generalised, K), tolerance=1e-3)[0]), K, M


def _choose_candidate(
    entries: Sequence[tuple[ReducedCandidate, control.StateSpace, Array]],
) -> tuple[ReducedCandidate, control.StateSpace, Array]:
    """Return the candidate of lowest order, and among these of smallest norm.

    Among nearly equal norms the first candidate is chosen, so that every processor makes the same choice.
    """
    least = min((c.order, c.norm) for c, _, _ in entries)
    return next(
        e for e in entries if e[0].order == least[0] and e[0].norm <= least[1] * (1.0 + _RELATIVE_NORM_TOLERANCE)
    )


class _LoopPeaks:
    """Peaks of S_u and T_u for several controllers; the plant's response is computed once."""

    def __init__(self, plant: control.StateSpace, rows: list[int]) -> None:
        self.plant, self.rows = plant, rows
        poles = np.abs(np.linalg.eigvals(plant.A))
        self.frequency = np.unique(np.concatenate([np.geomspace(1e-3, 3e3, 200), poles[poles > 1e-3]]))
        self.response = frequency_response(plant, self.frequency)

    def sensitivity_peaks(self, K: control.StateSpace) -> tuple[float, float]:
        feedback = extract_feedback_controller(K, self.plant, self.rows)
        if not is_stable_loop(self.plant, feedback):
            return np.inf, np.inf
        loop = frequency_response(feedback, self.frequency) @ self.response
        s, t = (largest_gain(X).max() for X in loop_sensitivities(loop))
        return float(20 * np.log10(s)), float(20 * np.log10(t))


def balanced_realisations(
    generalised: control.StateSpace, controller: control.StateSpace, actuation: Array, Z: Array, kept: int
) -> dict[str, tuple[control.StateSpace, Array]]:
    """Balance the states of a controller except its first ``kept`` modes; return one realisation for each pair of
    Gramians.
    """
    n = controller.nstates
    if kept == n:
        return {"loop": (controller, actuation)}
    Zinv = np.linalg.inv(Z)
    A, B, C, M = Zinv @ controller.A @ Z, Zinv @ controller.B, controller.C @ Z, Zinv @ actuation
    rest = slice(kept, n)
    Ar, Br, Cr = A[rest, rest], B[rest], C[:, rest]
    gramians = {
        "loop": _loop_gramians(generalised, controller, Zinv[rest], Ar, Cr),
        "open": (
            linalg.solve_continuous_lyapunov(Ar, -_multiply_by_transpose(Br)),
            linalg.solve_continuous_lyapunov(Ar.T, -_multiply_by_transpose(Cr.T)),
        ),
    }
    found: dict[str, tuple[control.StateSpace, Array]] = {}
    for name, (P, Q) in gramians.items():
        T, Tinv = balancing_transform(P, Q)
        T, Tinv = linalg.block_diag(np.eye(kept), T), linalg.block_diag(np.eye(kept), Tinv)
        found[name] = replace_matrices(controller, A=Tinv @ A @ T, B=Tinv @ B, C=C @ T), Tinv @ M
    return found


def _loop_gramians(
    generalised: control.StateSpace, controller: control.StateSpace, rows: Array, Ar: Array, Cr: Array
) -> tuple[Array, Array]:
    """Return controllability and observability Gramians of the controller's modes within the closed loop.

    The modes are (Ar, Cr), with states ``rows @ x``. To first order a change dK of the controller changes the loop by
    T_zu dK T_ew: the measurements of the running loop excite it, and it acts as an addition to the control.
    """
    nu = controller.noutputs
    nw, nz = generalised.ninputs - nu, generalised.noutputs - controller.ninputs
    G = generalised
    opened = replace_matrices(
        G,
        B=np.hstack([G.B, G.B[:, nw:]]),
        D=np.hstack([G.D, G.D[:, nw:]]),
        inputs=[*G.input_labels[:nw], *(f"added[{i}]" for i in range(nu)), *G.input_labels[nw:]],
    )
    loop = compute_lower_lft(opened, controller)
    P = linalg.solve_continuous_lyapunov(loop.A, -_multiply_by_transpose(loop.B[:, :nw]))[G.nstates :, G.nstates :]
    Bu, Du = loop.B[:, nw:], loop.D[:nz, nw:]
    r = Ar.shape[0]
    series = np.block([[Ar, np.zeros((r, loop.nstates))], [Bu @ Cr, loop.A]])
    Q = linalg.solve_continuous_lyapunov(series.T, -_multiply_by_transpose(np.hstack([Du @ Cr, loop.C]).T))
    return rows @ P @ rows.T, Q[:r, :r]


def _multiply_by_transpose(M: Array) -> Array:
    return M @ M.T


# ----------------------------------------------------------------------------
# Discretisation: from a continuous controller to difference equations at the flight rate, robust to rounding.
#
# The bilinear (Tustin) rule integrates the controller by trapezoids: ``s = 2/T (z-1)/(z+1)`` maps the stable half
# plane onto the unit disc and keeps the static gain. It adds no phase except by its warping of frequencies (below 2 %
# up to a twelfth of the sampling rate). With ``v = (I - A T/2) x - B T/2 e``
#
#     v+ = Ad v + Bd e + Md (sat(u) - u),   u = Cd v + Dd e,
#     Ad = (I - A T/2)^-1 (I + A T/2),  Bd = T (I - A T/2)^-1 B,
#     Cd = C (I - A T/2)^-1,            Dd = D + C (I - A T/2)^-1 B T/2,   Md = T M.
#
# The last input is the anti-windup: the saturated command minus the command. It acts one sample later, so the
# equations stay explicit.
#
# Coordinates: real modal form. Every mode is a number, or a 2 x 2 block of a damped rotation, so rounding a
# coefficient moves one mode by as much as the coefficient. In direct (polynomial) form the slow modes of these
# controllers leave the unit circle even with 24-bit coefficients. Nearly coincident modes have no well-conditioned
# modal form; a real Schur form (an orthogonal change of coordinates) then takes its place.
#
# Anti-windup: while the actuators are at their limit the controller runs as ``Ad - Md Cd``. Two gains are available.
# ``observer`` comes from the synthesis: the controller's plant model receives the saturated input. It relies on the
# plant being as designed for. ``integrators`` makes the integrators follow the actuators, at a rate ``w``, and changes
# no other mode: with V a basis of the slow modes, ``Ad V = V L``,
#
#     Md = V (L - exp(-w T) I) (Cd V)^-1,   so that   (Ad - Md Cd) V = V exp(-w T),
#
# and all other modes stay (own derivation; back-calculation, Fertik and Ross 1967, in modal form). Why heave-yaw and
# roll-pitch use it: docs/explanation/control.md. If ``Ad - Md Cd`` is unstable, the gain of a Kalman filter for the
# pair (Ad, Cd) replaces it, which gives a stable one.


@result
class DiscreteController:
    """Discrete controller ``x+ = A x + B e + M (sat(u) - u)``, ``u = C x + D e``, in physical units.

    Attributes
    ----------
    A, B, C, D : array
        Shapes (n, n), (n, inputs), (outputs, n), (outputs, inputs).
    M : array, shape (n, outputs)
        Anti-windup gain.
    period_s : float
    form : str
        ``"modal"`` or ``"schur"``.
    anti_windup : str
        ``"integrators"``, ``"observer"`` or ``"kalman"``; see the comment above this class.
    inputs, outputs : tuple of str
        Labels of the signals.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    M: Array
    period_s: float
    form: str
    anti_windup: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def order(self) -> int:
        """Number of states of the controller."""
        return self.A.shape[0]

    @property
    def rate_Hz(self) -> float:
        """Number of periods in a second (Hz)."""
        return 1 / self.period_s

    def to_state_space(self) -> control.StateSpace:
        """Return the controller as ``control.StateSpace``, without the anti-windup input."""
        return state_space(self.A, self.B, self.C, self.D, inputs=self.inputs, outputs=self.outputs, dt=self.period_s)


def _modal_transform(A: Array) -> tuple[Array, Array] | None:
    """Return T and inv(T) with inv(T) A T real modal; None if the eigenvectors are nearly dependent."""
    values, vectors = np.linalg.eig(A)
    columns = []
    order = np.lexsort((values.imag, -np.abs(values)))
    seen: set[int] = set()
    for i in order:
        if i in seen:
            continue
        seen.add(int(i))
        if abs(values[i].imag) > 0.0:
            partner = int(np.argmin(np.abs(values - values[i].conj())))
            seen.add(partner)
            columns += [vectors[:, i].real, vectors[:, i].imag]
        else:
            columns.append(vectors[:, i].real)
    T = np.column_stack(columns)
    T = T / np.linalg.norm(T, axis=0)
    if np.linalg.cond(T) > 1e5:
        return None
    return T, np.linalg.inv(T)


def _state_scales(A: Array, B: Array, C: Array) -> Array:
    """Return a scale of each state that makes the norms of its input row and output column equal; the two states of a
    complex pair share one.
    """
    n = A.shape[0]
    scale = np.ones(n)
    i = 0
    while i < n:
        block = slice(i, i + 2) if i + 1 < n and abs(A[i + 1, i]) > 1e-14 else slice(i, i + 1)
        b, c = np.linalg.norm(B[block]), np.linalg.norm(C[:, block])
        if b > 0 and c > 0:
            scale[block] = np.sqrt(b / c)
        i = block.stop
    return scale


def discretise_controller(
    controller: control.StateSpace, actuation: Array, period_s: float, windup_rate: float | None = None
) -> DiscreteController:
    """Discretise a controller in well-conditioned coordinates, with an anti-windup gain.

    Parameters
    ----------
    controller : control.StateSpace
        Controller: continuous, in physical units.
    actuation : array, shape (n, outputs)
        Effect on its states of actuation beyond its own command, per unit (see ``hinf.HinfResult.anti_windup_matrix``).
    period_s : float
    windup_rate : float, optional
        Rate at which the integrators follow saturated actuators (rad/s). Without it, or if the integrators are as
        fast or not observable at the outputs, ``actuation`` gives the anti-windup.

    Returns
    -------
    DiscreteController

    Raises
    ------
    MuflyError
        If the period is not positive or a mode is too fast for the period.
    """
    if not (np.isfinite(period_s) and period_s > 0):
        raise MuflyError(f"discretisation: a period of {period_s} s is out of range; give a positive one")
    T = period_s
    n = controller.nstates
    left = np.eye(n) - controller.A * (T / 2)
    if n and np.linalg.cond(left) > 1e12:
        raise MuflyError(f"discretisation: Tustin's rule fails for a mode at {2 / T:.4g} rad/s; choose another rate")
    A = np.linalg.solve(left, np.eye(n) + controller.A * (T / 2))
    B = T * np.linalg.solve(left, controller.B)
    C = np.linalg.solve(left.T, controller.C.T).T
    D = controller.D + C @ controller.B * (T / 2)
    M = T * actuation

    changed = _modal_transform(A)
    form = "modal"
    if changed is None:
        form = "schur"
        _, Z = linalg.schur(A, output="real")
        changed = Z, Z.T
    S, Sinv = changed
    A, B, C, M = Sinv @ A @ S, Sinv @ B, C @ S, Sinv @ M
    A[np.abs(A) < 1e-12] = 0.0
    scale = _state_scales(A, B, C)
    A, B, C, M = A * scale / scale[:, None], B / scale[:, None], C * scale, M / scale[:, None]

    anti_windup = "observer"
    back = None if windup_rate is None else _back_calculation_gain(A, C, math.exp(-windup_rate * T))
    if back is not None:
        anti_windup, M = "integrators", back
    if n and np.abs(np.linalg.eigvals(A - M @ C)).max() >= 1.0 - 1e-7:
        anti_windup = "kalman"
        M = _predictor_gain(A, C)
    return DiscreteController(
        A, B, C, D, M, T, form, anti_windup, tuple(controller.input_labels), tuple(controller.output_labels)
    )


def _back_calculation_gain(A: Array, C: Array, pole: float) -> Array | None:
    """Return M that moves the slowest modes, one per output, to ``pole`` and keeps the others; None if impossible."""
    n, m = A.shape[0], C.shape[0]
    if n <= m:
        return None
    sizes = np.sort(np.abs(np.linalg.eigvals(A)))
    if sizes[-m] <= pole or sizes[-m - 1] >= sizes[-m]:
        return None
    edge = math.sqrt(sizes[-m] * sizes[-m - 1])
    slow, V, count = linalg.schur(A, output="real", sort=lambda re, im: math.hypot(re, im) > edge)
    V, slow = V[:, :m], slow[:m, :m]
    seen = C @ V
    if count != m or np.linalg.cond(seen) > 1e8:
        return None
    M: Array = V @ (slow - pole * np.eye(m)) @ np.linalg.inv(seen)
    return M


def _predictor_gain(A: Array, C: Array) -> Array:
    """Return the gain M of a Kalman predictor with equal process noise on all states; A - M C is stable."""
    W, R = 1e-4 * np.eye(A.shape[0]), np.eye(C.shape[0])
    P = linalg.solve_discrete_are(A.T, C.T, W, R)
    gain: Array = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    return gain


LATERAL_STATES = ("x", "y", "u", "v", "phi", "theta", "p", "q", "a_dw", "b_dw", "bar_roll", "bar_pitch")
SERVO_INPUTS, TILT_REFERENCES = ("servo_1", "servo_2"), ("phi_reference", "theta_reference")


def _sample_tilt_to_position(
    full: control.StateSpace, roll_pitch: DiscreteController, divider: int
) -> control.StateSpace:
    """Return the system, sampled at the cascade rate, from tilt reference (phi, theta) to position and velocity (x,
    y, u, v).
    """
    plant = sample_plant(extract_submodel(full, LATERAL_STATES, SERVO_INPUTS, LATERAL_STATES), roll_pitch.period_s, 1)
    errors = roll_pitch.inputs
    wiring: dict[str, dict[str, float]] = {servo: {f"command_{servo}": 1.0} for servo in SERVO_INPUTS}
    for error, output in zip(errors, ("phi", "theta", "p", "q"), strict=True):
        wiring[error] = {output: -1.0}
    for error, reference in zip(errors[:2], TILT_REFERENCES, strict=True):
        wiring[error][reference] = 1.0
    K = replace_matrices(roll_pitch.to_state_space(), outputs=[f"command_{servo}" for servo in SERVO_INPUTS])
    loop = connect_blocks([plant, K], wiring, TILT_REFERENCES, LATERAL_STATES[:4])
    A, B = np.eye(loop.nstates), np.zeros_like(loop.B)
    for _ in range(divider):
        A, B = loop.A @ A, loop.A @ B + loop.B
    return replace_matrices(loop, A=A, B=B, D=np.zeros((4, 2)), dt=divider * roll_pitch.period_s)


def analyse_position_cascade(
    full: control.StateSpace,
    roll_pitch: DiscreteController,
    velocity: DiscreteController,
    position_gain: float,
    divider: int,
) -> LoopAnalysis:
    """Analyse the position cascade with the sampled attitude loop; the loop is broken at the tilt reference.

    The velocity controller is designed on a point mass with ideal tilt (eq. 6.10). The analysis uses the lateral part
    of the whole linear model (tilted rotor thrust and stabiliser bar included) under the sampled roll-pitch controller
    with one sample of delay. The tilt reference is held over ``divider`` periods of that inner loop. So with the inner
    loop ``x+ = Ai x + Bi ref`` the plant of the cascade is exactly

        x+ = Ai^divider x + (I + Ai + ... + Ai^(divider - 1)) Bi ref,   y = (x, y, u, v),

    and the cascade is the feedback ``tilt = K_vel (K_p (0 - position) - velocity)``, at zero heading.

    Parameters
    ----------
    full : control.StateSpace
        ``Linearisation.full``.
    roll_pitch, velocity : DiscreteController
        Discrete controllers; ``velocity`` runs at ``divider`` times the period of ``roll_pitch``.
    position_gain : float
        Gain of the position loop (1/s).
    divider : int
        Number of roll-pitch periods in a period of the cascade.

    Returns
    -------
    LoopAnalysis
    """
    mix = np.hstack([position_gain * np.eye(2), np.eye(2)])
    K = velocity.to_state_space()
    K = replace_matrices(K, B=K.B @ mix, D=K.D @ mix, inputs=LATERAL_STATES[:4], outputs=TILT_REFERENCES)
    return analyse_loop(_sample_tilt_to_position(full, roll_pitch, divider), K)
