r"""Keyframes tied together: a graph of similarities of the floor's plane and of what tilts are off by, solved sparsely.

A keyframe k stands at C_k (complex, N + i E), h_k above the floor, with heading psi_k; its tilt was told wrong by u_k
(two numbers, about the axes of its heading). Two keyframes are related by a similarity of the plane, four numbers:

    t = e^(-i psi_i) (C_j - C_i) / h_i,    psi_j - psi_i,    ln (h_j / h_i)

An edge is what pixels say of these four and of both tilts: an information matrix L of eight by eight about what was
found, and the gradient g there, as it was found with what was known of tilts beforehand, and that counts but once.
With e for the eight numbers less those found, an edge costs e^T L e / 2 - g^T e. Of each keyframe the sonar tells
ln h + b_k, with an error b.

**Errors hang together.** What a filter's roll and pitch are off by changes slowly: a first-order Gauss-Markov process
of deviation s and time T, and what shakes a whole picture, w, which has no memory. Between neighbours in time

    u_(k+1) = r u_k + noise of variance s^2 (1 - r^2) + (1 + r^2) w^2,    r = e^(-dt / T)

and likewise b, with a deviation and time of its own.

An error that all tilts have in common turns the map by the way over the height times it, up to once (what of it is
seen as shear is found, :mod:`pose`): n edges of independent errors of s d / h would grow with the square root of n,
these grow with n. Heights that are off alike scale the map. The graph carries both from edge to edge, because
neighbours hang together as above: so covariances of headings and places have it, and the shear of any edge, or a loop
that closes, tells it for all.

Sought are all C, psi, ln h, u and b but the first's place and heading. Gauss-Newton; each edge is weighted by Cauchy's
1 / (1 + chi^2 / 16) where it closes a loop (one wrong closure must not bend the map), by 1 where it ties a keyframe
to the one it was made from. Covariances come from the same normal matrix, solved for the columns that are asked for.
Scheme as in Grisetti et al. 2010 (A tutorial on graph-based SLAM); the similarity's terms and tilts are own derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import SuperLU, splu

_Array = NDArray[np.float64]
HEADING, LN_HEIGHT, SONAR, NODE_SIZE = 2, 3, 6, 7
PLACE, TILT, ERRORS = slice(0, 4), slice(4, SONAR), slice(4, NODE_SIZE)
"""A node: place (N, E, heading, ln h), errors of the tilt about x and y of the heading and of the sonar's ln h."""
EDGE_TILT_A, EDGE_TILT_B, EDGE_SIZE = slice(4, 6), slice(6, 8), 8
"""What an edge tells: the four numbers of a relation, tilt of its first node, of its second."""
_HEIGHT_CONSTRAINT_VARIANCE = 1e-6  # variance of ln h given the error of the sonar's
_LOOP_ROBUST_CHI2 = 16.0  # chi^2 at which a closure counts half
_MAX_ITERATIONS = 10


@dataclass(frozen=True)
class GraphEdge:
    """What was seen of keyframe ``second_index`` from keyframe ``first_index``.

    Attributes
    ----------
    first_index, second_index : int
    measurement : (8,) array
        Re t, Im t, heading, ln h, as above; errors of the tilts of ``first_index`` and ``second_index``.
    information : (8, 8) array
        On these.
    gradient : (8,) array
        The gradient that pixels have there.
    is_loop_closure : bool
        Whether it closes a loop.
    """

    first_index: int
    second_index: int
    measurement: _Array
    information: _Array
    gradient: _Array = field(default_factory=lambda: np.zeros(8))
    is_loop_closure: bool = False

    def compute_residual(self, a: _Array, b: _Array) -> _Array:
        """Eight numbers: nodes ``a``, ``b`` less what was found."""
        out = np.concatenate([relative_pose(a, b), a[TILT], b[TILT]]) - self.measurement
        out[2] = _wrap_angle(out[2])
        return out

    def compute_chi2(self, off: _Array, covariance: _Array | None = None) -> float:
        """How far that is from what pixels alone want, squared, in deviations; of numbers that are themselves
        uncertain by a covariance (8, 8), by both."""
        m, g = self.information, self.gradient
        force = m @ off - g
        ridge = 1e-9 * float(np.trace(m)) * np.eye(8)  # what pixels do not tell costs nothing
        out = float(off @ m @ off - 2.0 * g @ off + g @ np.linalg.solve(m + ridge, g))
        if covariance is not None:
            # (S + L^-1)^-1 = L - L (L + S^-1)^-1 L, and there need not be an inverse of L
            both = covariance @ np.linalg.solve(np.eye(8) + m @ covariance, force)
            out -= float(force @ both)
        return max(0.0, out)


@dataclass(frozen=True)
class KeyframePriors:
    """What is known of keyframes beside what they see of each other, (n,) arrays.

    Attributes
    ----------
    time_s
    log_height, height_sigma, height_time_s
        What the sonar said of ln h, deviation of its error, and the time over which that hangs together.
    tilt_sigma, tilt_time_s, tilt_white
        Deviation of the error of the tilt (rad), the time over which it hangs together, and what has no memory.
    """

    time_s: _Array
    log_height: _Array
    height_sigma: _Array
    height_time_s: _Array
    tilt_sigma: _Array
    tilt_time_s: _Array
    tilt_white: _Array


def gauss_markov_transition(
    elapsed_s: float, before: float, sigma: float, time_s: float, white: float = 0.0
) -> tuple[float, float]:
    """Return r and the variance of the noise by which two errors hang together, as above; of deviations ``before`` and
    ``sigma``: what is known better now is not off by what it was then."""
    keep = math.exp(-elapsed_s / time_s) * min(1.0, sigma / before) if elapsed_s >= 0.0 else 0.0
    return keep, max(sigma**2 - keep**2 * before**2, 1e-12) + (1.0 + keep**2) * white**2


def relative_pose(a: _Array, b: _Array) -> _Array:
    """Return the four numbers of node ``b`` seen from node ``a`` (each N, E, heading, ln h)."""
    c, s, h = math.cos(a[HEADING]), math.sin(a[HEADING]), math.exp(a[LN_HEIGHT])
    n, e = b[0] - a[0], b[1] - a[1]
    turn = _wrap_angle(b[HEADING] - a[HEADING])
    return np.array([(c * n + s * e) / h, (-s * n + c * e) / h, turn, b[LN_HEIGHT] - a[LN_HEIGHT]])


def relative_pose_jacobians(a: _Array, b: _Array) -> tuple[_Array, _Array]:
    """Return how :func:`relative_pose` changes with ``a`` and with ``b``, (4, 4) each."""
    c, s, h = math.cos(a[HEADING]), math.sin(a[HEADING]), math.exp(a[LN_HEIGHT])
    t = relative_pose(a, b)
    by_b = np.eye(4)
    by_b[:2, :2] = np.array([[c, s], [-s, c]]) / h
    by_a = -by_b.copy()
    by_a[0, HEADING], by_a[1, HEADING] = t[1], -t[0]
    by_a[0, LN_HEIGHT], by_a[1, LN_HEIGHT] = -t[0], -t[1]
    return by_a, by_b


def edge_jacobian(a: _Array, b: _Array) -> _Array:
    """Return how an edge's eight numbers change with both nodes, (8, 12)."""
    out = np.zeros((8, 2 * NODE_SIZE))
    out[:4, :4], out[:4, NODE_SIZE : NODE_SIZE + 4] = relative_pose_jacobians(a, b)
    out[EDGE_TILT_A, TILT] = out[EDGE_TILT_B, NODE_SIZE + TILT.start : NODE_SIZE + TILT.stop] = np.eye(2)
    return out


def _wrap_angle(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True)
class GraphSolution:
    """A solved graph.

    Attributes
    ----------
    nodes : (n, 7) array
    edge_chi2 : (e,) array
        Of each edge.
    """

    nodes: _Array
    edge_chi2: _Array
    _factor: SuperLU

    def joint_covariance(self, which: list[int]) -> _Array:
        """Return the joint covariance (7 k, 7 k) of some nodes, in their order."""
        n = NODE_SIZE * len(self.nodes)
        rows = np.concatenate([np.arange(NODE_SIZE * k, NODE_SIZE * k + NODE_SIZE) for k in which])
        unit = np.zeros((n, len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        return self._factor.solve(unit)[rows]


def solve_graph(
    nodes: _Array, edges: list[GraphEdge], known: KeyframePriors, start_sigma: tuple[float, float]
) -> GraphSolution:
    """Solve a graph.

    Parameters
    ----------
    nodes : (n, 7) array
        To begin at; the first one's place and heading are held.
    edges : list of Edge
    known : Known
    start_sigma : (2,) tuple
        Of the first keyframe's place (m) and heading (rad): they are where the map begins, and may be exact.
    """
    x = np.array(nodes, dtype=np.float64)
    start, n = x[0].copy(), len(x)
    hold = np.array([*[max(start_sigma[0], 1e-5)] * 2, max(start_sigma[1], 1e-5)]) ** -2
    pairs = np.array([(e.first_index, e.second_index) for e in edges], dtype=np.int64).reshape(-1, 2)
    # How errors of tilt and of height hang together with those of the keyframe before
    chain = np.zeros((n, 2, 3))
    for k in range(n):
        since = known.time_s[k] - known.time_s[k - 1] if k else math.inf
        last, tilts, heights = max(k - 1, 0), known.tilt_sigma, known.height_sigma
        tilt = gauss_markov_transition(since, tilts[last], tilts[k], known.tilt_time_s[k], known.tilt_white[k])
        height = gauss_markov_transition(since, heights[last], heights[k], known.height_time_s[k])
        chain[k] = np.array([tilt, tilt, height]).T
    chi2 = np.zeros(len(edges))
    for turn in range(_MAX_ITERATIONS):
        blocks: list[tuple[int, int, _Array]] = []
        right = np.zeros((n, NODE_SIZE))
        for k, edge in enumerate(edges):
            i, j = pairs[k]
            off = edge.compute_residual(x[i], x[j])
            chi2[k] = edge.compute_chi2(off)
            weight = 1.0 / (1.0 + chi2[k] / _LOOP_ROBUST_CHI2) if edge.is_loop_closure else 1.0
            slope = edge_jacobian(x[i], x[j])
            m = weight * slope.T @ edge.information @ slope
            force = weight * slope.T @ (edge.gradient - edge.information @ off)
            blocks += [
                (i, i, m[:NODE_SIZE, :NODE_SIZE]),
                (i, j, m[:NODE_SIZE, NODE_SIZE:]),
                (j, i, m[NODE_SIZE:, :NODE_SIZE]),
                (j, j, m[NODE_SIZE:, NODE_SIZE:]),
            ]
            right[i] += force[:NODE_SIZE]
            right[j] += force[NODE_SIZE:]
        for k in range(n):
            keep, noise = chain[k]
            block = np.diag([1e-9, 1e-9, 1e-9, 0.0, *(1.0 / noise)])
            before = x[k - 1, ERRORS] if k else np.zeros(3)
            off = (x[k, ERRORS] - keep * before) / noise
            right[k, ERRORS] -= off
            if k:
                right[k - 1, ERRORS] += keep * off
                a, b = np.zeros((NODE_SIZE, NODE_SIZE)), np.zeros((NODE_SIZE, NODE_SIZE))
                a[ERRORS, ERRORS], b[ERRORS, ERRORS] = np.diag(-keep / noise), np.diag(keep**2 / noise)
                blocks += [(k - 1, k, a), (k, k - 1, a), (k - 1, k - 1, b)]
            else:
                block[:3, :3] += np.diag(hold)
                right[0, :LN_HEIGHT] += hold * (start[:LN_HEIGHT] - x[0, :LN_HEIGHT])
            sonar = [LN_HEIGHT, SONAR]
            block[np.ix_(sonar, sonar)] += 1.0 / _HEIGHT_CONSTRAINT_VARIANCE
            right[k, sonar] += (known.log_height[k] - x[k, LN_HEIGHT] - x[k, SONAR]) / _HEIGHT_CONSTRAINT_VARIANCE
            blocks.append((k, k, block))
        at = np.array([(a, b) for a, b, _ in blocks])
        rows = NODE_SIZE * at[:, 0, None, None] + np.arange(NODE_SIZE)[None, :, None] + np.zeros((1, 1, NODE_SIZE), int)
        columns = (
            NODE_SIZE * at[:, 1, None, None] + np.arange(NODE_SIZE)[None, None, :] + np.zeros((1, NODE_SIZE, 1), int)
        )
        values = np.array([block for _, _, block in blocks])
        normal = coo_matrix(
            (values.ravel(), (rows.ravel(), columns.ravel())), shape=(NODE_SIZE * n, NODE_SIZE * n)
        ).tocsc()
        factor = splu(normal)
        step = factor.solve(right.ravel()).reshape(n, NODE_SIZE)
        if turn < _MAX_ITERATIONS - 1:
            x = x + step
        if np.abs(step).max() < 1e-7 or turn == _MAX_ITERATIONS - 1:
            break
    return GraphSolution(x, chi2, factor)


def fuse_pose(
    a: _Array, known: _Array, b: _Array, tilts: _Array, seen: _Array, pull: _Array, log_height: float
) -> tuple[_Array, _Array]:  # fmt: skip
    """Return where a picture is by all that is known, and its covariance: N, E, heading, ln h.

    Unknown are what the keyframe's node and its tilt are off by, the picture's tilt and sonar, and its place: thirteen
    numbers.

    Parameters
    ----------
    a : (4,) array
        Node of the keyframe.
    known : (9, 9) array
        Covariance of that, of the error of its tilt, of the picture's, and of the picture's ln h by the sonar.
    b : (4,) array
        Node of the picture as it was found.
    tilts : (4,) array
        Errors of the picture's tilt and of the keyframe's as they were found, from what was expected.
    seen, pull : (8, 8), (8,) arrays
        What pixels say of N, E, height, heading, and of these tilts: :class:`mufly.slam.camera_pose.PoseEstimate`.
    log_height : float
        What the sonar says of ln h, less the error that is expected of it.
    """
    by_a, by_b = relative_pose_jacobians(a, b)
    to = np.zeros((EDGE_SIZE, 13))
    # Of the unknowns: the keyframe's node and tilt, the picture's tilt, sonar and place
    keyframe, picture, sonar, place = slice(4, 6), slice(6, 8), 8, slice(9, 13)
    # The picture's own place as pixels know it: moved back by what the keyframe is off by.
    move = np.hstack([np.linalg.solve(by_b, by_a), np.eye(4)])[[0, 1, LN_HEIGHT, HEADING]]
    move[2] *= math.exp(b[LN_HEIGHT])
    to[:4, :4], to[:4, place] = np.split(move, 2, axis=1)
    to[EDGE_TILT_A, picture] = to[EDGE_TILT_B, keyframe] = np.eye(2)
    prior = np.zeros((13, 13))
    prior[:9, :9] = np.linalg.inv(known)
    begin = np.zeros(13)
    begin[keyframe], begin[picture] = tilts[2:], tilts[:2]  # how far what was found is from what was expected
    m = prior + to.T @ seen @ to
    right = to.T @ pull - prior @ begin
    heights = [sonar, place.start + LN_HEIGHT]
    m[np.ix_(heights, heights)] += 1.0 / _HEIGHT_CONSTRAINT_VARIANCE
    right[heights] += (log_height - b[LN_HEIGHT]) / _HEIGHT_CONSTRAINT_VARIANCE
    covariance = np.asarray(np.linalg.inv(m), np.float64)
    return b + (covariance @ right)[place], covariance[place, place]
