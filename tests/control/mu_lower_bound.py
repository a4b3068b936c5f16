"""A lower bound of the structured singular value, with a perturbation that proves it, to check the upper bound with.

For full complex blocks a power iteration (Packard, Fan and Doyle 1988) finds a Delta, whose eigenvalue certifies the
bound. Real blocks are searched from outside: with their values fixed up to a common factor, the remaining complex
problem decides the factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from mufly.control.linear_systems import Array, ComplexArray
from mufly.control.robust import Block
from mufly.control.robust.structured_singular_value import _block_slices

_minimise: Any = optimize.minimize  # its stubs know no options of single methods


class LowerBound(NamedTuple):
    """The lower bound of mu and a perturbation of size ``1 / value`` with ``det(I - M Delta) = 0``."""

    value: float
    perturbation: ComplexArray


def _complex_lower_bound(M: ComplexArray, slices: Sequence[slice], starts: int, tolerance: float = 1e-12) -> LowerBound:
    """Return a lower bound for full complex blocks, by power iterations from several starts."""
    n = len(M)
    rng = np.random.default_rng(0)
    best = LowerBound(0.0, np.zeros((n, n), dtype=complex))
    size = float(np.linalg.norm(M))
    if size == 0.0:
        return best
    Mh = M.conj().T
    U, top_values, Vh = np.linalg.svd(M)
    if len(slices) == 1:
        return LowerBound(float(top_values[0]), np.outer(Vh[0].conj(), U[:, 0].conj()) / top_values[0])
    for k in range(starts):
        b = Vh[0].conj() if k == 0 else rng.normal(size=n) + 1j * rng.normal(size=n)
        w = U[:, 0] if k == 0 else rng.normal(size=n) + 1j * rng.normal(size=n)
        b, w = b / np.linalg.norm(b), w / np.linalg.norm(w)
        last = 0.0
        for _ in range(200):
            a = M @ b
            level = float(np.linalg.norm(a))
            if level == 0.0:
                break
            a = a / level
            z = np.concatenate(
                [a[s] * (np.linalg.norm(w[s]) / max(float(np.linalg.norm(a[s])), 1e-300)) for s in slices]
            )
            w = Mh @ z
            w = w / max(float(np.linalg.norm(w)), 1e-300)
            b = np.concatenate(
                [w[s] * (np.linalg.norm(a[s]) / max(float(np.linalg.norm(w[s])), 1e-300)) for s in slices]
            )
            b = b / max(float(np.linalg.norm(b)), 1e-300)
            if abs(level - last) < tolerance * level:
                break
            last = level
        a = M @ b
        unit = np.zeros((n, n), dtype=complex)
        for s in slices:
            la, lb = float(np.linalg.norm(a[s])), float(np.linalg.norm(b[s]))
            if la > 0.0 and lb > 0.0:
                unit[s, s] = np.outer(b[s], a[s].conj()) / (la * lb)
        values = np.linalg.eigvals(M @ unit)
        top = values[int(np.argmax(np.abs(values)))]
        if abs(top) > best.value * (1.0 + 1e-12):
            best = LowerBound(float(abs(top)), unit / top)
    return best


def mu_lower_bound(M: ComplexArray, blocks: Sequence[Block], *, starts: int = 6) -> LowerBound:
    """Return a lower bound of the structured singular value, with a perturbation that proves it.

    Parameters
    ----------
    M : complex array, shape (n, n)
    blocks : sequence of Block
        Their sizes add up to n.
    starts : int
        Number of starts of the power iteration, and of the search over real blocks.

    Returns
    -------
    LowerBound
        0 with a zero perturbation if all blocks are real and none was found.

    Raises
    ------
    ArgumentError
        If the blocks do not fill the matrix.
    """
    slices = _block_slices(M, blocks)
    real = [k for k, b in enumerate(blocks) if b.is_real]
    if not real:
        return _complex_lower_bound(M, slices, starts)
    n = len(M)
    if len(real) == len(blocks):
        return _real_lower_bound(M, blocks, slices, starts)
    r = np.concatenate([np.arange(n)[slices[k]] for k in real])
    c = np.concatenate([np.arange(n)[s] for s, b in zip(slices, blocks, strict=True) if not b.is_real])
    sizes = [b.size for b in blocks if not b.is_real]
    ends = np.cumsum(sizes)
    inner = [slice(int(e) - k, int(e)) for e, k in zip(ends, sizes, strict=True)]

    def repeated(delta: Array) -> Array:
        return np.concatenate([np.full(blocks[k].size, d) for k, d in zip(real, delta, strict=True)])

    def certify(delta: Array, tries: int = 1, tolerance: float = 1e-5) -> LowerBound:
        """Return the bound for real blocks ``t delta`` and complex blocks of size at most t, for the smallest t."""
        d = repeated(np.clip(delta, -1.0, 1.0))

        def closed(t: float) -> LowerBound:
            F = M[np.ix_(c, c)] + M[np.ix_(c, r)] * (t * d) @ np.linalg.solve(
                np.eye(r.size) - M[np.ix_(r, r)] * (t * d), M[np.ix_(r, c)]
            )
            return _complex_lower_bound(F, inner, tries, 1e-2 * tolerance)

        low, high, kept = 0.0, 1.0 / max(float(np.linalg.norm(M, 2)), 1e-300), None
        for _ in range(60):
            if high * (found := closed(high)).value >= 1.0:
                kept = found
                break
            low, high = high, 1.3 * high
            if high > 1e6 / float(np.linalg.norm(M, 2)):
                break
        if kept is None:
            return LowerBound(0.0, np.zeros((n, n), dtype=complex))
        while high - low > tolerance * high:
            middle = 0.5 * (low + high)
            found = closed(middle)
            if middle * found.value >= 1.0:
                high, kept = middle, found
            else:
                low = middle
        Delta = np.zeros((n, n), dtype=complex)
        Delta[r, r] = high * d
        Delta[np.ix_(c, c)] = kept.perturbation
        return LowerBound(1.0 / high, Delta)

    rng = np.random.default_rng(0)
    best, best_at = LowerBound(0.0, np.zeros((n, n), dtype=complex)), np.zeros(len(real))
    known: dict[tuple[float, ...], LowerBound] = {}

    def look_up(delta: Array) -> LowerBound:
        key = tuple(delta)
        if key not in known:
            known[key] = certify(delta)
        return known[key]

    for corner in (np.ones(len(real)), -np.ones(len(real)), *rng.choice([-1.0, 1.0], (max(starts - 2, 0), len(real)))):
        at, value, improved = np.array(corner), look_up(corner), True
        while improved:  # one coordinate at a time, among the corners
            improved = False
            for k in range(at.size):
                other = at.copy()
                other[k] = -at[k]
                found = look_up(other)
                if found.value > value.value * (1 + 1e-6):
                    at, value, improved = other, found, True
        if value.value > best.value:
            best, best_at = value, at
    simplex = best_at * (1.0 - 0.3 * np.vstack([np.zeros(len(real)), np.eye(len(real))]))
    inside = _minimise(
        lambda d: -certify(d).value + float(np.sum(np.maximum(np.abs(d) - 1.0, 0.0))), best_at, method="Nelder-Mead",
        options={"maxfev": 25 * len(real), "initial_simplex": simplex},
    ).x  # fmt: skip
    return max((certify(d, starts, 1e-10) for d in (best_at, inside)), key=lambda b: b.value)


def _real_lower_bound(M: ComplexArray, blocks: Sequence[Block], slices: Sequence[slice], starts: int) -> LowerBound:
    """Return a bound for real blocks alone: the smallest Delta with det(I - M Delta) = 0, if any is found.

    The determinant is complex, so there are two equations. Gauss-Newton from several starts solves them, and the size
    of the solution is then reduced along the solutions by sequential quadratic programming.
    """
    n = len(M)
    rng = np.random.default_rng(0)
    sizes = [b.size for b in blocks]

    def determinant(delta: Array) -> Array:
        value = np.linalg.det(np.eye(n) - M * np.repeat(delta, sizes))
        return np.array([value.real, value.imag])

    best = LowerBound(0.0, np.zeros((n, n), dtype=complex))
    scale = 1.0 / max(float(np.linalg.norm(M, 2)), 1e-300)
    for _ in range(4 * starts):
        x0 = np.append(scale * 3.0 * rng.choice([-1.0, 1.0], len(blocks)), 3.0 * scale)
        found = _minimise(
            lambda x: x[-1] / scale, x0, jac=lambda x: np.append(np.zeros(len(blocks)), 1.0 / scale), method="SLSQP",
            constraints=[
                {"type": "eq", "fun": lambda x: determinant(x[:-1])},
                {"type": "ineq", "fun": lambda x: np.concatenate([x[-1] - x[:-1], x[-1] + x[:-1]]) / scale},
            ],
            options={"maxiter": 200, "ftol": 1e-10},
        )  # fmt: skip
        delta = found.x[:-1]
        size = float(np.abs(delta).max())
        singular = np.linalg.svd(np.eye(n) - M * np.repeat(delta, sizes), compute_uv=False)
        if size > 0.0 and singular[-1] < 1e-7 * singular[0] and 1.0 / size > best.value:
            best = LowerBound(1.0 / size, np.diag(np.repeat(delta, sizes)).astype(complex))
    return best
