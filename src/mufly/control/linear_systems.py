"""Linear systems and their closed loops: block diagrams, frequency responses, the H-infinity norm, margins.

A system is ``(A, B, C, D)`` with ``xdot = A x + B u``, ``y = C x + D u``, held as ``control.StateSpace`` with labelled
signals. A block diagram is closed in one step for all its signals. With the blocks side by side,
``y = C x + D u``, and the wiring ``u = M y + N w``, the loop from ``w`` is

    E = (I - M D)^-1,   A' = A + B E M C,   B' = B E N,   C' = C + D E M C,   D' = D E N.

The norm is Bruinsma and Steinbuch's two-step iteration (Syst. Control Lett. 14, 1990) on the Hamiltonian matrix of
Boyd, Balakrishnan and Kabamba (1989): at an imaginary eigenvalue a singular value equals the level.

Loops are continuous or sampled. With plant ``G`` and feedback ``u = -K y`` the loop at the plant's input is
``L_u = K G``, and

    S_u = (I + L_u)^-1,   T_u = L_u (I + L_u)^-1,   S_o = (I + G K)^-1.

Peaks are largest singular values over frequency. A factor or a delay common to all inputs moves the eigenvalues of L_u
alone. So gain, phase and delay margin follow exactly from the crossings of an eigenvalue of L_u with the negative real
axis or the unit circle (generalised Nyquist criterion). Independent changes in the inputs are covered by the
guaranteed phase margin 2 asin(1 / 2 M), M the smaller of the peaks of S_u and T_u (Safonov and Athans 1981).

A sampled loop is analysed in discrete time: plant behind a zero-order hold, controller, and whole samples of delay
between measurement and actuation.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mufly.errors import MuflyError
from mufly.results import result

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]


def state_space(
    A: Array,
    B: Array,
    C: Array,
    D: Array,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    states: Sequence[str] | None = None,
    dt: float = 0.0,
) -> control.StateSpace:
    """Return a labelled ``control.StateSpace`` with every state (python-control by default drops unused ones)."""
    keywords = {} if states is None else {"states": list(states)}
    return control.StateSpace(
        A, B, C, D, dt, remove_useless_states=False, inputs=list(inputs), outputs=list(outputs), **keywords
    )


def _reduce_for_pickle(g: control.StateSpace) -> tuple[Any, ...]:
    """Return constructor and arguments with which pickle restores a system; python-control's own functions are not
    picklable.
    """
    names = {"inputs": g.input_labels, "outputs": g.output_labels, "states": g.state_labels, "dt": g.dt}
    return partial(state_space, **names), (g.A, g.B, g.C, g.D)


copyreg.pickle(control.StateSpace, _reduce_for_pickle)


def replace_matrices(system: control.StateSpace, **changes: Any) -> control.StateSpace:
    """Return the system with some of ``A`` to ``D``, ``inputs``, ``outputs``, ``states`` or ``dt`` replaced."""
    own = {name: getattr(system, name) for name in "ABCD"} | {"dt": system.dt or 0.0}
    own |= {"inputs": system.input_labels, "outputs": system.output_labels}
    if len(changes.get("A", system.A)) == system.nstates:
        own["states"] = system.state_labels
    return state_space(**(own | changes))


def connect_blocks(
    blocks: Sequence[control.StateSpace],
    wiring: Mapping[str, Mapping[str, float]],
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> control.StateSpace:
    """Connect the blocks of a diagram by the names of their signals; return the diagram as one system.

    Parameters
    ----------
    blocks : sequence of control.StateSpace
        Labelled blocks; no two outputs share a name.
    wiring : mapping
        For every block input, the block outputs and external inputs summed into it, with their factors:
        ``{"plant_u": {"controller_y": 1.0, "w": 1.0}}``.
        A name that is no block input defines an output of the diagram as such a sum.
    inputs : sequence of str
        External inputs, in order.
    outputs : sequence of str
        Outputs of the diagram, in order: block outputs or sums named in ``wiring``.

    Returns
    -------
    control.StateSpace
        The diagram, with the blocks' states one after the other.

    Raises
    ------
    MuflyError
        If a name is unknown or an algebraic loop has no solution.
    """
    block_inputs = [name for block in blocks for name in block.input_labels]
    block_outputs = [name for block in blocks for name in block.output_labels]
    row = {name: i for i, name in enumerate(block_outputs)}
    column = {name: i for i, name in enumerate(inputs)}

    def summation_matrix(names: Sequence[str]) -> tuple[Array, Array]:
        M, N = np.zeros((len(names), len(row))), np.zeros((len(names), len(column)))
        for i, name in enumerate(names):
            terms = wiring.get(name)
            if terms is None:
                terms = {name: 1.0} if name in row or name in column else {}
            for source, factor in terms.items():
                if source in row:
                    M[i, row[source]] += factor
                elif source in column:
                    N[i, column[source]] += factor
                else:
                    raise MuflyError(f"block diagram: {name!r} is fed by unknown signal {source!r}")
        return M, N

    A = linalg.block_diag(*(block.A for block in blocks))
    B = linalg.block_diag(*(block.B for block in blocks))
    C = linalg.block_diag(*(block.C for block in blocks))
    D = linalg.block_diag(*(block.D for block in blocks))
    M, N = summation_matrix(block_inputs)
    loop = np.eye(len(block_inputs)) - M @ D
    if np.linalg.cond(loop) > 1e12:
        raise MuflyError("block diagram: its algebraic loop has no unique solution")
    EM, EN = np.linalg.solve(loop, M), np.linalg.solve(loop, N)
    P, Q = summation_matrix(outputs)
    states = [label for block in blocks for label in block.state_labels]
    return state_space(
        A + B @ EM @ C,
        B @ EN,
        P @ (C + D @ EM @ C),
        Q + P @ D @ EN,
        inputs=inputs,
        outputs=outputs,
        states=states if len(set(states)) == len(states) else None,
    )


def frequency_response(system: control.StateSpace, frequency: Array) -> ComplexArray:
    """Return the frequency response on the imaginary axis, or on the unit circle of a discrete-time system.

    Parameters
    ----------
    system : control.StateSpace
    frequency : array, shape (n,)
        Frequencies (rad/s).

    Returns
    -------
    complex array, shape (n, outputs, inputs)
    """
    frequency = np.asarray(frequency, dtype=float)
    dt = system.dt or 0.0
    point = np.exp(1j * frequency * dt) if dt else 1j * frequency
    A, B, C, D = system.A, system.B, system.C, system.D
    n = A.shape[0]
    if n == 0:
        return np.broadcast_to(D.astype(complex), (frequency.size, *D.shape))
    # A Hessenberg reduction would save time on large systems; these have at most about forty states.
    pencil = point[:, None, None] * np.eye(n) - A
    response: ComplexArray = C @ np.linalg.solve(pencil, np.broadcast_to(B, (frequency.size, *B.shape))) + D
    return response


def singular_values(system: control.StateSpace, frequency: Array) -> Array:
    """Return singular values over frequency (rad/s), largest first, shape (n, min(outputs, inputs))."""
    return np.linalg.svd(frequency_response(system, frequency), compute_uv=False)


def _find_singular_value_crossings(A: Array, B: Array, C: Array, D: Array, level: float) -> Array:
    """Return frequencies (rad/s, sorted, at least 0) at which a singular value of the response equals ``level``."""
    R = level**2 * np.eye(D.shape[1]) - D.T @ D
    S = level**2 * np.eye(D.shape[0]) - D @ D.T
    RinvDtC = np.linalg.solve(R, D.T @ C)
    F = A + B @ RinvDtC
    H = np.block(
        [[F, level * B @ np.linalg.solve(R, B.T)], [-level * C.T @ np.linalg.solve(S, C), -F.T]],
    )
    H = linalg.matrix_balance(H, permute=False)[0]
    eigenvalues = np.linalg.eigvals(H)
    scale = np.abs(eigenvalues).max()
    on_axis = np.abs(eigenvalues.real) < 1e-8 * np.abs(eigenvalues) + 1e-12 * scale
    return np.unique(np.abs(eigenvalues[on_axis].imag))


def hinf_norm(system: control.StateSpace, *, tolerance: float = 1e-6) -> tuple[float, float]:
    """Return the H-infinity norm of a stable continuous-time system, and the frequency at which it is attained.

    Parameters
    ----------
    system : control.StateSpace
        System in continuous time.
    tolerance : float
        Relative difference between the attained value returned and a proven upper bound.

    Returns
    -------
    norm : float
        Largest singular value over frequency; ``inf`` for an unstable system.
    frequency : float
        Frequency of the maximum (rad/s); ``inf`` at infinite frequency or for an unstable system.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    top = float(np.linalg.norm(D, 2)) if D.size else 0.0
    if A.shape[0] == 0 or not B.size or not C.size:
        return top, np.inf
    poles = np.linalg.eigvals(A)
    if poles.real.max() >= 0.0:
        return np.inf, np.inf
    # Peaks stand near poles; the grid between them only gives a close start.
    size = np.abs(poles)
    candidates = np.concatenate([[0.0], size, np.abs(poles.imag), np.geomspace(size.min() / 10, size.max() * 10, 60)])
    try:
        gains = singular_values(system, candidates)[:, 0]
    except np.linalg.LinAlgError:  # rounding puts a pole on the axis
        return np.inf, np.inf
    best = int(np.argmax(gains))
    lower, where = float(gains[best]), float(candidates[best])
    if top > lower:
        lower, where = top, np.inf
    if lower == 0.0:
        return 0.0, 0.0
    for _ in range(40):
        crossing = _find_singular_value_crossings(A, B, C, D, lower * (1 + 2 * tolerance))
        if crossing.size == 0:
            break
        middle = np.concatenate([crossing, np.sqrt(crossing[:-1] * crossing[1:]), (crossing[:-1] + crossing[1:]) / 2])
        gains = singular_values(system, middle)[:, 0]
        best = int(np.argmax(gains))
        if gains[best] <= lower * (1 + tolerance / 10):
            break
        lower, where = float(gains[best]), float(middle[best])
    return lower, where


@result
class LoopAnalysis:
    """Crossovers, peaks and margins of one loop, broken at the plant's input.

    Attributes
    ----------
    stable : bool
    crossovers : tuple of float
        Frequencies at which a singular value of L_u crosses 0 dB (rad/s), ascending.
    sensitivity_peak_dB, complementary_peak_dB : float
        Peaks of S_u and T_u.
    sensitivity_peak_frequency, complementary_peak_frequency : float
        Frequencies of these peaks (rad/s).
    output_sensitivity_peak_dB : float
        Peak of S_o in the given output scaling.
    gain_margin_dB, gain_reduction_dB : float
        Common factor on all inputs, up (positive) and down (negative), that keeps the loop stable; inf without a
        limit.
    phase_margin_deg, delay_margin_s : float
        Common phase lag and common delay that keep the loop stable.
    guaranteed_phase_margin_deg : float
        Margin for independent phases, one in each input.
    """

    stable: bool
    crossovers: tuple[float, ...]
    sensitivity_peak_dB: float
    complementary_peak_dB: float
    sensitivity_peak_frequency: float
    complementary_peak_frequency: float
    output_sensitivity_peak_dB: float
    gain_margin_dB: float
    gain_reduction_dB: float
    phase_margin_deg: float
    delay_margin_s: float
    guaranteed_phase_margin_deg: float


@result
class LoopCurves:
    """Singular values over frequency (rad/s) as arrays of shape (n, inputs), largest first."""

    frequency: Array
    plant: Array
    loop: Array
    sensitivity: Array
    complementary: Array


def sample_plant(plant: control.StateSpace, period_s: float, delay_samples: int = 0) -> control.StateSpace:
    """Return the sampled plant behind a zero-order hold, its inputs delayed by whole samples.

    Parameters
    ----------
    plant : control.StateSpace
        Plant in continuous time.
    period_s : float
    delay_samples : int
        Samples between a measurement and the output of its command.
    """
    sampled = control.sample_system(plant, period_s, method="zoh")
    A, B, C, D = sampled.A, sampled.B, sampled.C, sampled.D
    for _ in range(delay_samples):
        n, m = B.shape
        A = np.block([[A, B], [np.zeros((m, n + m))]])
        B = np.vstack([np.zeros((n, m)), np.eye(m)])
        C, D = np.hstack([C, D]), np.zeros_like(D)
    return replace_matrices(plant, A=A, B=B, C=C, D=D, dt=period_s)


def extract_feedback_controller(
    controller: control.StateSpace, plant: control.StateSpace, rows: Sequence[int]
) -> control.StateSpace:
    """Return the part of a controller that feeds back the plant's outputs: the controller's inputs with indices
    ``rows``.
    """
    columns = list(rows)
    labels = {"inputs": plant.output_labels, "outputs": plant.input_labels}
    return replace_matrices(controller, B=controller.B[:, columns], D=controller.D[:, columns], **labels)


def is_stable_loop(plant: control.StateSpace, feedback: control.StateSpace) -> bool:
    """Return whether ``u = -feedback y`` stabilises the plant (both continuous or both discrete)."""
    poles = _closed_loop_poles(plant, feedback)
    return bool(np.abs(poles).max() < 1.0) if plant.dt else bool(poles.real.max() < 0.0)


def _closed_loop_poles(plant: control.StateSpace, feedback: control.StateSpace) -> ComplexArray:
    E = np.linalg.inv(np.eye(plant.noutputs) + plant.D @ feedback.D)
    A = np.block(
        [
            [
                plant.A - plant.B @ feedback.D @ E @ plant.C,
                plant.B @ (feedback.C - feedback.D @ E @ plant.D @ feedback.C),
            ],
            [-feedback.B @ E @ plant.C, feedback.A - feedback.B @ E @ plant.D @ feedback.C],
        ]
    )
    return np.linalg.eigvals(A)


def _frequency_grid(plant: control.StateSpace, feedback: control.StateSpace) -> Array:
    """Return frequencies from 1e-4 rad/s to 1e4 rad/s or the Nyquist frequency, including those of the loop's poles."""
    dt = plant.dt or 0.0
    top = 0.999 * np.pi / dt if dt else 1e4
    poles = np.concatenate([np.linalg.eigvals(plant.A), np.linalg.eigvals(feedback.A)])
    if dt:
        poles = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12).astype(complex)) / dt
    size = np.abs(poles)
    size = size[(size > 1e-4) & (size < top)]
    return np.unique(np.concatenate([np.geomspace(1e-4, top, 350), size]))


def loop_sensitivities(L: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return sensitivity ``(I + L)^-1`` and complementary sensitivity of a loop gain, shape (..., n, n)."""
    S = np.linalg.inv(np.eye(L.shape[-1]) + L)
    return S, S @ L


def largest_gain(response: ComplexArray) -> Array:
    """Return the largest singular value of each matrix."""
    return np.linalg.svd(response, compute_uv=False)[..., 0]


def find_crossovers(frequency: Array, gains: Array) -> tuple[float, ...]:
    """Return frequencies where a column of ``gains`` (n, k) crosses 0 dB, by log-log interpolation, ascending."""
    found: list[float] = []
    for y in np.log(np.maximum(gains, 1e-300)).T:
        i = np.nonzero((y[:-1] > 0) != (y[1:] > 0))[0]
        found += list(frequency[i] * (frequency[i + 1] / frequency[i]) ** (-y[i] / (y[i + 1] - y[i])))
    return tuple(float(w) for w in sorted(found))


def _refined_peak(function: Callable[[Array], Array], frequency: Array, values: Array) -> tuple[float, float]:
    """Return the largest value of ``function`` near its largest sample, and its frequency."""
    for _ in range(2):
        i = int(np.argmax(values))
        low, high = frequency[max(i - 1, 0)], frequency[min(i + 1, frequency.size - 1)]
        frequency = np.geomspace(low, high, 25)
        values = function(frequency)
    i = int(np.argmax(values))
    return float(values[i]), float(frequency[i])


def _to_decibel(value: float) -> float:
    return float(20 * np.log10(max(value, 1e-300)))


def _tracked_eigenvalues(L: ComplexArray) -> ComplexArray:
    """Return eigenvalues of L over frequency, ordered so that each column is continuous."""
    values = np.linalg.eigvals(L)
    if values.shape[1] == 2:  # all plants here have two inputs: swapping is the only choice
        for k in range(1, values.shape[0]):
            straight = abs(values[k] - values[k - 1]).sum()
            if abs(values[k, ::-1] - values[k - 1]).sum() < straight:
                values[k] = values[k, ::-1]
    return values


def _loop_margins(frequency: Array, L: ComplexArray) -> tuple[float, float, float, float]:
    """Return gain margin (dB), gain reduction (dB), phase margin (deg), delay margin (s), common to all inputs."""
    upper, lower, phase, delay = np.inf, -np.inf, np.inf, np.inf
    for locus in _tracked_eigenvalues(L).T:
        angle = np.unwrap(np.angle(locus))
        size = np.log10(np.abs(locus))
        # At -180 degrees modulo 360 the loop gain gives the permitted increase or decrease.
        turns = np.floor((angle + np.pi) / (2 * np.pi))
        for i in np.nonzero(turns[:-1] != turns[1:])[0]:
            target = 2 * np.pi * max(turns[i], turns[i + 1]) - np.pi
            t = (target - angle[i]) / (angle[i + 1] - angle[i])
            gain = -20 * (size[i] + t * (size[i + 1] - size[i]))
            if gain > 0:
                upper = min(upper, gain)
            else:
                lower = max(lower, gain)
        for i in np.nonzero((size[:-1] > 0) != (size[1:] > 0))[0]:
            t = -size[i] / (size[i + 1] - size[i])
            lag = (angle[i] + t * (angle[i + 1] - angle[i]) + np.pi) % (2 * np.pi)
            where = frequency[i] * (frequency[i + 1] / frequency[i]) ** t
            phase = min(phase, lag, 2 * np.pi - lag)
            delay = min(delay, lag / where)
    return float(upper), float(lower), float(np.degrees(phase)), float(delay)


def analyse_loop(
    plant: control.StateSpace, feedback: control.StateSpace, *, output_scale: Array | None = None
) -> LoopAnalysis:
    """Analyse the loop ``u = -feedback y``.

    Parameters
    ----------
    plant, feedback : control.StateSpace
        Both continuous, or both discrete with the same period (see ``sample_plant``).
    output_scale : array, shape (outputs,), optional
        Scale of each output for S_o; ones by default.

    Returns
    -------
    LoopAnalysis
        Analysis of the loop; infinite peaks if it is unstable.
    """
    stable = is_stable_loop(plant, feedback)
    frequency = _frequency_grid(plant, feedback)
    g, k = frequency_response(plant, frequency), frequency_response(feedback, frequency)
    L = k @ g

    def sensitivity_gain(which: int, w: Array) -> Array:
        return largest_gain(loop_sensitivities(frequency_response(feedback, w) @ frequency_response(plant, w))[which])

    S, T = loop_sensitivities(L)
    s_peak, s_at = _refined_peak(partial(sensitivity_gain, 0), frequency, largest_gain(S))
    t_peak, t_at = _refined_peak(partial(sensitivity_gain, 1), frequency, largest_gain(T))
    scale = np.ones(plant.noutputs) if output_scale is None else np.asarray(output_scale, dtype=float)
    So = np.linalg.inv(np.eye(plant.noutputs) + g @ k) * scale / scale[:, None]
    o_peak = float(largest_gain(So).max())
    gain_up, gain_down, phase, delay = _loop_margins(frequency, L)
    if not stable:
        s_peak = t_peak = o_peak = np.inf
        gain_up = gain_down = phase = delay = 0.0
    smaller = min(s_peak, t_peak)
    guaranteed = 2 * np.degrees(np.arcsin(min(1.0, 0.5 / smaller))) if np.isfinite(smaller) else 0.0
    return LoopAnalysis(
        stable=stable,
        crossovers=find_crossovers(frequency, np.linalg.svd(L, compute_uv=False)),
        sensitivity_peak_dB=_to_decibel(s_peak),
        complementary_peak_dB=_to_decibel(t_peak),
        sensitivity_peak_frequency=s_at,
        complementary_peak_frequency=t_at,
        output_sensitivity_peak_dB=_to_decibel(o_peak),
        gain_margin_dB=gain_up,
        gain_reduction_dB=gain_down,
        phase_margin_deg=phase,
        delay_margin_s=delay,
        guaranteed_phase_margin_deg=float(guaranteed),
    )


def compute_loop_singular_values(
    plant: control.StateSpace, feedback: control.StateSpace, frequency: Array
) -> LoopCurves:
    """Return singular values of plant, L_u, S_u and T_u over ``frequency`` (rad/s)."""
    g, k = frequency_response(plant, frequency), frequency_response(feedback, frequency)
    L = k @ g
    values = [np.linalg.svd(M, compute_uv=False) for M in (g, L, *loop_sensitivities(L))]
    return LoopCurves(np.asarray(frequency, dtype=float), *values)
