r"""Keyframes tied together: a graph of similarities of the floor's plane, solved sparsely.

A keyframe k stands at C_k (complex, N + i E), h_k above the floor, with heading psi_k; what it saw at slope m lies at
C_k + h_k e^(i psi_k) m. So two keyframes are related by a similarity of the plane, four numbers:

    t = e^(-i psi_i) (C_j - C_i) / h_i,    psi_j - psi_i,    ln (h_j / h_i)

An edge is what was measured of these, with its information. Of each keyframe the sonar tells ln h. Sought are all
C, psi and ln h but the first's place and heading. Gauss-Newton; each edge is weighted by Cauchy's 1 / (1 + chi^2 /
16) where it closes a loop (one wrong closure must not bend the map), by 1 where it ties a keyframe to the one it
was made from.

Covariances come from the same normal matrix, solved for the columns that are asked for. Scheme as in Grisetti et
al. 2010 (A tutorial on graph-based SLAM); the similarity's terms are own derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import SuperLU, splu

_Array = NDArray[np.float64]
DIM = 4  # N, E, heading, ln h
_LOOSE = 16.0  # chi^2 of four numbers at which a closure counts half
_ROUNDS = 10


@dataclass(frozen=True)
class Edge:
    """What was measured of keyframe ``second`` from keyframe ``first``.

    Attributes
    ----------
    first, second : int
    measured : (4,) array
        Re t, Im t, heading, ln h, as above.
    information : (4, 4) array
    closes : bool
        Whether it closes a loop.
    """

    first: int
    second: int
    measured: _Array
    information: _Array
    closes: bool = False


def relation(a: _Array, b: _Array) -> _Array:
    """Return the four numbers of node ``b`` seen from node ``a`` (each N, E, heading, ln h)."""
    c, s, h = math.cos(a[2]), math.sin(a[2]), math.exp(a[3])
    n, e = b[0] - a[0], b[1] - a[1]
    return np.array([(c * n + s * e) / h, (-s * n + c * e) / h, _wrapped(b[2] - a[2]), b[3] - a[3]])


def slopes_of(a: _Array, b: _Array) -> tuple[_Array, _Array]:
    """Return how :func:`relation` changes with ``a`` and with ``b``, (4, 4) each."""
    c, s, h = math.cos(a[2]), math.sin(a[2]), math.exp(a[3])
    t = relation(a, b)
    by_b = np.eye(DIM)
    by_b[:2, :2] = np.array([[c, s], [-s, c]]) / h
    by_a = -by_b.copy()
    by_a[0, 2], by_a[1, 2] = t[1], -t[0]
    by_a[0, 3], by_a[1, 3] = -t[0], -t[1]
    return by_a, by_b


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True)
class Solution:
    """A solved graph.

    Attributes
    ----------
    nodes : (n, 4) array
    chi2 : (e,) array
        Of each edge.
    """

    nodes: _Array
    chi2: _Array
    _factor: SuperLU

    def covariance(self, which: list[int]) -> _Array:
        """Return the joint covariance (4 k, 4 k) of some nodes, in their order."""
        n = DIM * len(self.nodes)
        rows = np.concatenate([np.arange(DIM * k, DIM * k + DIM) for k in which])
        unit = np.zeros((n, len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        return self._factor.solve(unit)[rows]


def solve_graph(
    nodes: _Array,
    edges: list[Edge],
    log_height: _Array,
    height_sigma: _Array,
    start_sigma: tuple[float, float],
) -> Solution:
    """Solve a graph.

    Parameters
    ----------
    nodes : (n, 4) array
        To begin at; the first one's place and heading are held.
    edges : list of Edge
    log_height, height_sigma : (n,) arrays
        What the sonar said of ln h, and its deviation.
    start_sigma : (2,) tuple
        Of the first keyframe's place (m) and heading (rad): they are where the map begins, and may be exact.
    """
    x = np.array(nodes, dtype=np.float64)
    start = x[0].copy()
    n = len(x)
    hold = np.array([*[max(start_sigma[0], 1e-5)] * 2, max(start_sigma[1], 1e-5)]) ** -2
    for turn in range(_ROUNDS):
        blocks: list[tuple[int, int, _Array]] = []
        right = np.zeros(DIM * n)
        chi2 = np.zeros(len(edges))
        for k, edge in enumerate(edges):
            i, j = edge.first, edge.second
            off = edge.measured - relation(x[i], x[j])
            off[2] = _wrapped(off[2])
            chi2[k] = off @ edge.information @ off
            weight = 1.0 / (1.0 + chi2[k] / _LOOSE) if edge.closes else 1.0
            a, b = slopes_of(x[i], x[j])
            m = weight * edge.information
            blocks += [(i, i, a.T @ m @ a), (i, j, a.T @ m @ b), (j, i, b.T @ m @ a), (j, j, b.T @ m @ b)]
            right[DIM * i : DIM * i + DIM] += a.T @ m @ off
            right[DIM * j : DIM * j + DIM] += b.T @ m @ off
        for k in range(n):
            w = height_sigma[k] ** -2
            block = np.diag([1e-9, 1e-9, 1e-9, w])
            if k == 0:
                block[:3, :3] += np.diag(hold)
                away = start[:3] - x[0, :3]
                right[:3] += hold * away
            blocks.append((k, k, block))
            right[DIM * k + 3] += w * (log_height[k] - x[k, 3])
        at = np.array([(first, second) for first, second, _ in blocks])
        rows = DIM * at[:, 0, None, None] + np.arange(DIM)[None, :, None] + np.zeros((1, 1, DIM), int)
        columns = DIM * at[:, 1, None, None] + np.arange(DIM)[None, None, :] + np.zeros((1, DIM, 1), int)
        values = np.array([block for _, _, block in blocks])
        normal = coo_matrix(
            (values.ravel(), (rows.ravel(), columns.ravel())), shape=(DIM * n, DIM * n)
        ).tocsc()
        factor = splu(normal)
        step = factor.solve(right).reshape(n, DIM)
        if turn < _ROUNDS - 1:
            x = x + step
        if np.abs(step).max() < 1e-7 or turn == _ROUNDS - 1:
            break
    return Solution(x, chi2, factor)
