"""Tools on linear systems that the designs share: block diagrams, frequency responses and the H-infinity norm.

A system is ``(A, B, C, D)`` with ``xdot = A x + B u``, ``y = C x + D u``, held as ``control.StateSpace`` with labelled
signals. A block diagram is closed once, for all its signals together: with the blocks side by side,
``y = C x + D u``, and the wiring ``u = M y + N w``, the loop from ``w`` is

    E = (I - M D)^-1,   A' = A + B E M C,   B' = B E N,   C' = C + D E M C,   D' = D E N.

The norm is Bruinsma and Steinbuch's two-step iteration (Syst. Control Lett. 14, 1990) on the Hamiltonian matrix of
Boyd, Balakrishnan and Kabamba (1989): a frequency on the imaginary axis is where a singular value equals the level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mufly.errors import MuflyError

__all__ = ["connect", "frequency_response", "hinf_norm", "singular_values", "state_space"]

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
    """Labelled ``control.StateSpace`` that keeps every state (python-control may otherwise drop unused ones)."""
    keywords = {} if states is None else {"states": list(states)}
    return control.StateSpace(
        A, B, C, D, dt, remove_useless_states=False, inputs=list(inputs), outputs=list(outputs), **keywords
    )


def connect(
    blocks: Sequence[control.StateSpace],
    wiring: Mapping[str, Mapping[str, float]],
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> control.StateSpace:
    """Close a block diagram by the names of its signals.

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

    def sums(names: Sequence[str]) -> tuple[Array, Array]:
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
    M, N = sums(block_inputs)
    loop = np.eye(len(block_inputs)) - M @ D
    if np.linalg.cond(loop) > 1e12:
        raise MuflyError("block diagram: its algebraic loop has no unique solution")
    EM, EN = np.linalg.solve(loop, M), np.linalg.solve(loop, N)
    P, Q = sums(outputs)
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
    """Frequency response on the imaginary axis, or on the unit circle of a discrete-time system.

    Parameters
    ----------
    system : control.StateSpace
    frequency : array, shape (n,)
        rad/s.

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
    # One reduction to Hessenberg form would save time on large systems; these have at most some forty states.
    pencil = point[:, None, None] * np.eye(n) - A
    response: ComplexArray = C @ np.linalg.solve(pencil, np.broadcast_to(B, (frequency.size, *B.shape))) + D
    return response


def singular_values(system: control.StateSpace, frequency: Array) -> Array:
    """Singular values over frequency (rad/s), largest first, shape (n, min(outputs, inputs))."""
    return np.linalg.svd(frequency_response(system, frequency), compute_uv=False)


def _axis_frequencies(A: Array, B: Array, C: Array, D: Array, level: float) -> Array:
    """Frequencies (rad/s, sorted, at least 0) at which a singular value of the response equals ``level``."""
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
    """H-infinity norm of a stable continuous-time system.

    Parameters
    ----------
    system : control.StateSpace
        Continuous time.
    tolerance : float
        Relative width between the returned value, which is attained, and the level shown not to be.

    Returns
    -------
    norm : float
        Largest singular value over frequency; ``inf`` for an unstable system.
    frequency : float
        Where it is attained, rad/s (``inf`` when at infinite frequency or unstable).
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    top = float(np.linalg.norm(D, 2)) if D.size else 0.0
    if A.shape[0] == 0 or not B.size or not C.size:
        return top, np.inf
    poles = np.linalg.eigvals(A)
    if poles.real.max() >= 0.0:
        return np.inf, np.inf
    # Peaks stand near poles; the grid between them only helps to start close.
    size = np.abs(poles)
    candidates = np.concatenate(
        [[0.0], size, np.abs(poles.imag), np.geomspace(size.min() / 10, size.max() * 10, 60)]
    )
    gains = singular_values(system, candidates)[:, 0]
    best = int(np.argmax(gains))
    lower, where = float(gains[best]), float(candidates[best])
    if top > lower:
        lower, where = top, np.inf
    if lower == 0.0:
        return 0.0, 0.0
    for _ in range(40):
        crossing = _axis_frequencies(A, B, C, D, lower * (1 + 2 * tolerance))
        if crossing.size == 0:
            break
        middle = np.concatenate(
            [crossing, np.sqrt(crossing[:-1] * crossing[1:]), (crossing[:-1] + crossing[1:]) / 2]
        )
        gains = singular_values(system, middle)[:, 0]
        best = int(np.argmax(gains))
        if gains[best] <= lower * (1 + tolerance / 10):
            break
        lower, where = float(gains[best]), float(middle[best])
    return lower, where
