"""The assumptions of H-infinity synthesis, checked, and named when they fail.

(A, B2) stabilisable, (C2, A) detectable; D12 of full column rank, D21 of full row rank; no invariant zero of
(A, B2, C1, D12) or (A, B1, C2, D21) on the imaginary axis.

With D12 of full column rank the invariant zeros of (A, B2, C1, D12) are the unobservable modes of
``(A - B2 D12^+ C1, (I - D12 D12^+) C1)``: what the control can hide from the errors. Dually for the other.
"""

from __future__ import annotations

import control
import numpy as np

from mufly.control.linear import Array
from mufly.errors import MuflyError

__all__ = ["check_assumptions"]


def _rank_deficient(M: Array) -> bool:
    s = np.linalg.svd(M, compute_uv=False)
    return bool(s.size and s[-1] <= 1e-10 * max(s[0], 1e-300))


def _describe(mode: complex, vector: Array, labels: list[str]) -> str:
    share = np.abs(vector)
    state = labels[int(np.argmax(share))] if labels else "?"
    value = f"{mode.real:.4g}" if abs(mode.imag) < 1e-12 else f"{mode.real:.4g}{mode.imag:+.4g}j"
    return f"mode {value} rad/s (mainly state {state!r})"


def _uncontrollable(A: Array, B: Array, which: str) -> tuple[complex, Array] | None:
    """First mode of A that is not controllable by B: among those not stable ("unstable") or on the axis ("axis").

    Popov-Belevitch-Hautus: the mode is uncontrollable when a left eigenvector is orthogonal to B.
    """
    values = np.linalg.eigvals(A)
    scale = max(float(np.linalg.norm(A, 2)), 1e-300)
    for value in values:
        if value.real < -1e-9 * max(scale, 1.0) if which == "unstable" else abs(value.real) > 1e-9 * scale:
            continue
        pencil = np.hstack([A - value * np.eye(A.shape[0]), B])
        U, s, _ = np.linalg.svd(pencil)
        if s[-1] < 1e-11 * s[0]:
            return complex(value), U[:, -1]
    return None


def check_assumptions(
    A: Array, B1: Array, B2: Array, C1: Array, C2: Array, D12: Array, D21: Array, P: control.StateSpace
) -> None:
    """Raise a MuflyError that names the first assumption violated.

    Parameters
    ----------
    A, B1, B2, C1, C2, D12, D21 : array
        The plant in the coordinates of the synthesis (balanced, regularised if asked for).
    P : control.StateSpace
        The plant as given: its labels name states and signals.
    """
    labels = list(P.state_labels)
    nz, nw = C1.shape[0], B1.shape[1]
    outputs, inputs = list(P.output_labels), list(P.input_labels)
    found = _uncontrollable(A, B2, "unstable")
    if found:
        raise MuflyError(
            f"H-infinity synthesis: not stabilisable by {', '.join(inputs[nw:])}: "
            f"{_describe(*found, labels)} cannot be moved; remove it or make its weight stable"
        )
    found = _uncontrollable(A.T, C2.T, "unstable")
    if found:
        raise MuflyError(
            f"H-infinity synthesis: not detectable from {', '.join(outputs[nz:])}: "
            f"{_describe(*found, labels)} is not seen; measure it or make its weight stable"
        )
    for D, name, names, remedy in (
        (D12, "D12 (controls to errors)", inputs[nw:], "give every control a weight at high frequency"),
        (D21.T, "D21 (disturbances to measurements)", outputs[nz:], "give every measurement some noise"),
    ):
        if D.shape[0] < D.shape[1] or _rank_deficient(D):
            direction = np.abs(np.linalg.svd(D)[2][-1])
            raise MuflyError(
                f"H-infinity synthesis: {name} loses rank at signal {names[int(np.argmax(direction))]!r}; {remedy} "
                "or set regularisation"
            )
    for F, G, name in (
        (
            A - B2 @ np.linalg.pinv(D12) @ C1,
            (np.eye(nz) - D12 @ np.linalg.pinv(D12)) @ C1,
            "(A, B2, C1, D12)",
        ),
        (
            (A - B1 @ np.linalg.pinv(D21) @ C2).T,
            (B1 @ (np.eye(nw) - np.linalg.pinv(D21) @ D21)).T,
            "(A, B1, C2, D21)",
        ),
    ):
        found = _uncontrollable(F.T, G.T, "axis")
        if found:
            raise MuflyError(
                f"H-infinity synthesis: {name} has an invariant zero on the imaginary axis at {abs(found[0].imag):.4g} "
                f"rad/s (mainly state {labels[int(np.argmax(np.abs(found[1])))]!r}); let a weight act on it or set "
                "regularisation"
            )
