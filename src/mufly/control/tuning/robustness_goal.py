"""The structured singular value over a vehicle's parameters as a goal of the tuning.

At fixed frequencies and with fixed scalings D and G the upper bound of mu is the root of the largest eigenvalue of the
pencil ``M* D M + j (G M - M* G)`` and D (Fan, Tits and Doyle, IEEE Trans. Autom. Control 36, 1991). As a function of
the controller this value has the gradient of a simple eigenvalue. :meth:`RobustnessGoal.update_scalings` finds the best
scalings for a controller; tuning and rescaling alternate, as in D-K iteration.

The loop is that of :mod:`mufly.control.robust.parameter_robustness`: affine in the parameters, with 1.5 periods of
exact delay. The frequencies are the tuning's own; ``analyse_parameter_robustness`` judges on others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mufly.control.linear_systems import Array, ComplexArray
from mufly.control.robust.parameter_robustness import UncertainLoop
from mufly.control.robust.structured_singular_value import mu_upper_bound
from mufly.control.tuning.fixed_order import LoopNormByGain

_FREQUENCY_RANGE_FACTORS = (0.5, 2.0)  # of the slowest and fastest mode of the loop, about which the frequencies lie
_FREQUENCY_COUNT = 24
_MU_DESCENT_END_FRACTION = 0.7  # fraction of the level at which the descent for the scalings of a frequency ends


def _largest_pencil_eigenvalues(
    M: ComplexArray, D: ComplexArray, G: ComplexArray
) -> tuple[Array, ComplexArray, ComplexArray]:
    """Return each pencil's largest eigenvalue, a Hermitian matrix with its eigenvalues, and D's Cholesky factor."""
    root = np.linalg.cholesky(D)
    skew = G @ M
    pencil = M.conj().swapaxes(1, 2) @ D @ M + 1j * (skew - skew.conj().swapaxes(1, 2))
    half = np.linalg.solve(root, pencil)
    turned = np.linalg.solve(root, half.conj().swapaxes(1, 2))
    whole: ComplexArray = (0.5 * (turned + turned.conj().swapaxes(1, 2))).astype(complex)
    return np.linalg.eigvalsh(whole)[:, -1], whole, root


class RobustnessGoal:
    """Tuning goal: the upper bound of mu over a vehicle's parameters stays below a level.

    Parameters
    ----------
    loop : UncertainLoop
        Loop in physical units.
    error_inputs : sequence of int
        Controller inputs that are errors of the plant's outputs.
    read_scale, input_scale : array
        Scales of the controller's inputs and outputs.
    level : float
        Level that mu is to stay below.
    """

    name = "mu"

    def __init__(
        self, loop: UncertainLoop, error_inputs: Sequence[int], read_scale: Array, input_scale: Array, level: float
    ) -> None:
        self.level = level
        self.blocks, self.rows, self.n_inputs = loop.blocks, list(error_inputs), len(read_scale)
        poles = np.abs(np.linalg.eigvals(loop.state_matrix_and_derivatives()[0]))
        inside = poles[(poles > 1.0) & (poles < 60.0)]
        low, high = inside.min(initial=4.0), inside.max(initial=20.0)
        self.frequency = np.geomspace(
            _FREQUENCY_RANGE_FACTORS[0] * low, _FREQUENCY_RANGE_FACTORS[1] * high, _FREQUENCY_COUNT
        )
        m, P = loop.left.shape[1], loop.open_loop_responses(self.frequency)
        delay = np.exp(-1j * self.frequency * loop.delay_s)[:, None, None]
        self.M11, self.P12 = P[:, :m, :m], P[:, :m, m:] * np.asarray(input_scale) * delay
        scale = np.asarray(read_scale)[self.rows][:, None]
        self.P21, self.P22 = P[:, m:, :m] / scale, P[:, m:, m:] * np.asarray(input_scale) * delay / scale
        self.size = m
        self._D = np.broadcast_to(np.eye(m, dtype=complex), (_FREQUENCY_COUNT, m, m)).copy()
        self._G = np.zeros((_FREQUENCY_COUNT, m, m), dtype=complex)

    def compute_response_and_factors(self, K: Array, order: int) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return the response M at the frequencies for a gain ``[Ak Bk; Ck Dk]``, and the factors ``dM = left dK
        right``.
        """
        eye = np.eye(order)
        R = np.linalg.inv(1j * self.frequency[:, None, None] * eye - K[:order, :order])
        picked = np.zeros((self.n_inputs, len(self.rows)))
        picked[self.rows, range(len(self.rows))] = -1.0  # the controller reads errors, -y
        B, C, D = K[:order, order:] @ picked, K[order:, :order], K[order:, order:] @ picked
        k = C @ R @ B + D
        loop = np.linalg.inv(np.eye(len(self.rows)) - self.P22 @ k)
        M = self.M11 + self.P12 @ k @ loop @ self.P21
        after = self.P12 @ np.linalg.inv(np.eye(k.shape[1]) - k @ self.P22)
        before = loop @ self.P21
        left = np.concatenate([after @ C @ R, after], axis=2)
        right = np.concatenate([R @ B @ before, np.broadcast_to(picked, (len(R), *picked.shape)) @ before], axis=1)
        return M, left, right

    def update_scalings(self, K: Array, order: int) -> float:
        """Set the scalings that are best for a gain; return the upper bound of mu at the frequencies."""
        M = self.compute_response_and_factors(K, order)[0]
        kept = np.sqrt(np.maximum(_largest_pencil_eigenvalues(M, self._D, self._G)[0], 0.0))
        for k in range(_FREQUENCY_COUNT):
            if kept[k] < _MU_DESCENT_END_FRACTION * self.level:
                continue
            found = mu_upper_bound(
                M[k],
                self.blocks,
                restarts=0,
                tolerance=1e-3,
                max_steps=150,
                enough=_MU_DESCENT_END_FRACTION * self.level,
            )
            if found.value < kept[k]:
                kept[k], self._D[k], self._G[k] = found.value, found.scaling, found.skew
        return float(kept.max())

    def make_loop_norm(self, order: int) -> LoopNormByGain:
        """Return the norm as a function of the gain of a controller of this order."""
        return _MuBoundByGain(self, order)


class _MuBoundByGain:
    """Upper bound of mu over the controller's gain, with the present scalings of a :class:`RobustnessGoal`."""

    def __init__(self, goal: RobustnessGoal, order: int) -> None:
        self.goal, self.order = goal, order

    def norm_and_gradient(self, K: Array) -> tuple[float, Array]:
        """Return the upper bound of mu (at least 1e-3) with the gain ``K``, and its gradient by ``K``."""
        M, left, right = self.goal.compute_response_and_factors(K, self.order)
        values, whole, root = _largest_pencil_eigenvalues(M, self.goal._D, self.goal._G)
        k = int(np.argmax(values))
        u = np.linalg.solve(root[k].conj().T, np.linalg.eigh(whole[k])[1][:, -1])
        norm = float(np.sqrt(max(values[k], 1e-6)))
        co = u.conj() @ (M[k].conj().T @ self.goal._D[k] + 1j * self.goal._G[k])
        slope = 2.0 * np.outer(co @ left[k], right[k] @ u).real
        return norm, slope / (2.0 * norm)
