"""The structured singular value mu of a matrix: an upper bound by scaling.

``mu(M) = 1 / min { |Delta| : det(I - M Delta) = 0 }`` over block diagonal Delta. A block is a real scalar that repeats
on its diagonal, or a full complex matrix. mu is at most the largest singular value.

Upper bound (Fan, Tits and Doyle, IEEE Trans. Autom. Control 36, 1991). With D > 0 and G Hermitian of the structure, G
for the real blocks only,

    M* D M + j (G M - M* G) - b^2 D <= 0   implies   mu(M) <= b.

The least ``b^2`` for given D and G is the largest eigenvalue of a Hermitian pencil. It is convex-like in (D, G) and has
kinks where eigenvalues coincide; ``minimise_nonsmooth`` descends it with its analytic gradient. Three full complex
blocks give mu exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mufly.control.linear_systems import Array, ComplexArray
from mufly.control.tuning.nonsmooth_bfgs import minimise_nonsmooth
from mufly.errors import ArgumentError

_MAX_SCALING_PARAMETER = 60.0  # of the scalings, for a matrix of norm one: logarithms of D, and G


class Block(NamedTuple):
    """A block of the perturbation: ``size`` rows and columns, a repeated real scalar or a full complex matrix."""

    size: int
    is_real: bool


class MuUpperBound(NamedTuple):
    """The upper bound of mu, the scalings' parameters for a warm start, and D and G that attain it.

    G is in the units of ``M* D M + j (G M - M* G)``.
    """

    value: float
    scaling_parameters: Array
    scaling: ComplexArray
    skew: ComplexArray


def _block_slices(M: ComplexArray, blocks: Sequence[Block]) -> list[slice]:
    total = sum(b.size for b in blocks)
    if M.shape != (total, total):
        raise ArgumentError(
            "blocks", "", f"have {total} rows in all, but the matrix has shape {M.shape}", "give blocks for all rows"
        )
    ends = np.cumsum([b.size for b in blocks])
    return [slice(int(e) - b.size, int(e)) for e, b in zip(ends, blocks, strict=True)]


class _Scalings:
    """D = C* C and G as functions of free parameters; C is upper triangular, G Hermitian, both block diagonal.

    The parameters begin with the logarithms of D's diagonal: one for a full complex block, one a row of a real block.
    Then come real and imaginary parts of C above the diagonal, G's diagonal, and real and imaginary parts above it.
    """

    def __init__(self, M: ComplexArray, blocks: Sequence[Block]) -> None:
        self.M, n = M, len(M)
        owner, pairs, real = np.empty(n, dtype=int), [], []
        k = 0
        for block, at in zip(blocks, _block_slices(M, blocks), strict=True):
            rows = np.arange(n)[at]
            owner[at] = k if not block.is_real else k + np.arange(block.size)
            k = owner[at.stop - 1] + 1
            if block.is_real:
                real.append(rows)
                pairs.append(np.array(np.triu_indices(block.size, 1)) + at.start)
        self.owner, self.n_scales = owner, k
        self.real = np.concatenate(real) if real else np.zeros(0, dtype=int)
        upper = np.hstack(pairs) if pairs else np.zeros((2, 0), dtype=int)
        self.upper = upper[0], upper[1]
        self.sizes = np.cumsum([k, upper.shape[1], upper.shape[1], self.real.size, upper.shape[1], upper.shape[1]])
        self.size = int(self.sizes[-1])

    def scaling_matrices(self, x: Array) -> tuple[ComplexArray, ComplexArray]:
        """Return C and G."""
        d, c_re, c_im, g, g_re, g_im = np.split(x, self.sizes[:-1])
        C = np.diag(np.exp(0.5 * d[self.owner])).astype(complex)
        C[self.upper] = c_re + 1j * c_im
        G = np.zeros_like(C)
        G[self.upper] = g_re + 1j * g_im
        G = G + G.conj().T
        G[self.real, self.real] = g
        return C, G

    def max_eigenvalue_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return the largest eigenvalue of the bound's matrix pencil at parameters ``x``, and its gradient."""
        if np.abs(x).max() > _MAX_SCALING_PARAMETER:
            return np.inf, np.zeros(self.size)
        M = self.M
        C, G = self.scaling_matrices(x)
        inverse = np.linalg.inv(C)
        right = M @ inverse
        scaled = C @ right
        turned = inverse.conj().T @ (G @ right)
        pencil = scaled.conj().T @ scaled + 1j * (turned - turned.conj().T)
        values, vectors = np.linalg.eigh(0.5 * (pencil + pencil.conj().T))
        top = float(values[-1])
        u = inverse @ vectors[:, -1]
        v = M @ u
        W = np.outer(v, v.conj()) - top * np.outer(u, u.conj())
        slope = 2.0 * (W @ C.conj().T).T  # d top = Re sum(slope * dC)
        V = 1j * (np.outer(v, u.conj()) - np.outer(u, v.conj()))  # d top = tr(V dG)
        diagonal = 0.5 * (np.diag(slope) * np.diag(C)).real
        above, turn = slope[self.upper], 2.0 * V.T[self.upper]
        parts = (
            np.bincount(self.owner, diagonal, self.n_scales),
            above.real,
            -above.imag,
            np.diag(V).real[self.real],
            turn.real,
            -turn.imag,
        )
        return top, np.concatenate(parts)


def mu_upper_bound(
    M: ComplexArray,
    blocks: Sequence[Block],
    *,
    start: Array | None = None,
    restarts: int = 2,
    tolerance: float = 1e-9,
    max_steps: int = 400,
    enough: float = 0.0,
) -> MuUpperBound:
    """Return an upper bound of the structured singular value by D and G scaling.

    Parameters
    ----------
    M : complex array, shape (n, n)
        Matrix.
    blocks : sequence of Block
        Their sizes add up to n.
    start : array, optional
        ``MuUpperBound.scaling_parameters`` of a similar matrix.
    restarts : int
        Number of further descents from a disturbed best point.
    tolerance : float
        Relative decrease at which a descent ends.
    max_steps : int
        Steps of one descent.
    enough : float
        Bound at which the descents end.

    Returns
    -------
    MuUpperBound

    Raises
    ------
    ArgumentError
        If the sizes of the blocks do not add up to n.
    """
    size = float(np.linalg.norm(M, 2))
    scalings = _Scalings(M / (size or 1.0), blocks)
    x = np.zeros(scalings.size) if start is None else np.array(start, dtype=float)
    if size == 0.0:
        return MuUpperBound(0.0, x, np.eye(len(M)).astype(complex), np.zeros_like(M, dtype=complex))
    rng = np.random.default_rng(0)
    best = None
    for k in range(restarts + 1):
        if best is not None and k:
            x = best.x + 0.1 * rng.normal(size=x.size)
        found = minimise_nonsmooth(
            scalings.max_eigenvalue_and_gradient,
            x,
            max_steps=max_steps,
            tolerance=tolerance,
            window=10,
            enough=(enough / size) ** 2,
        )
        if best is None or found.value < best.value:
            best = found
        if best.value <= (enough / size) ** 2:
            break
    assert best is not None
    C, G = scalings.scaling_matrices(best.x)
    return MuUpperBound(size * float(np.sqrt(max(best.value, 0.0))), best.x, C.conj().T @ C, size * G)
