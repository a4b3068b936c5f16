r"""Pose graph of keyframes: similarities of the floor's plane and tilt errors, solved sparsely.

A keyframe k is at C_k (complex, N + i E), h_k above the floor, with heading psi_k; its reported tilt has an error u_k
(two numbers, about the axes of its heading). Two keyframes are related by a similarity of the plane, four numbers:

    t = e^(-i psi_i) (C_j - C_i) / h_i,    psi_j - psi_i,    ln (h_j / h_i)

An edge holds the information of the pixels on these four numbers and on both tilts: an information matrix L (8, 8)
about the measured values, and the gradient g there. The measured values used the tilt priors, which must count only
once. With e for the eight numbers minus those measured, an edge costs e^T L e / 2 - g^T e. For each keyframe the sonar
measures ln h + b_k, with an error b.

**Correlated errors.** The errors of a filter's roll and pitch change slowly: a first-order Gauss-Markov process of
deviation s and time T, and white noise w from vibration of the whole picture. Between neighbours in time

    u_(k+1) = r u_k + noise of variance s^2 (1 - r^2) + (1 + r^2) w^2,    r = e^(-dt / T)

and likewise b, with a deviation and time of its own.

A tilt error common to all keyframes rotates the map in proportion to distance over height, at most by the error itself
(the part seen as shear is estimated, :mod:`mufly.slam.camera_pose`). With n edges, independent errors of s d / h would
grow with the square root of n; common errors grow with n. Common height errors scale the map. The graph propagates both
errors from edge to edge by the correlation above. The covariances of headings and positions therefore include them, and
the shear of any edge, or a loop closure, corrects all keyframes.

The unknowns are all C, psi, ln h, u and b except the first place and heading. Gauss-Newton solves them. Loop closures
have Cauchy weights 1 / (1 + chi^2 / 16), since one wrong closure must not bend the map; edges between a keyframe and
its parent have weight 1. Covariances are computed from the same normal matrix, for the requested columns. Scheme as in
Grisetti et al. 2010 (A tutorial on graph-based SLAM); the similarity's terms and tilts are own derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import SuperLU, splu

_Array = NDArray[np.float64]
HEADING_INDEX, LOG_HEIGHT_INDEX, SONAR_ERROR_INDEX, NODE_UNKNOWN_COUNT = 2, 3, 6, 7
PLACE_SLICE, TILT_SLICE, SENSOR_ERROR_SLICE = slice(0, 4), slice(4, SONAR_ERROR_INDEX), slice(4, NODE_UNKNOWN_COUNT)
"""Slices of a node: place (N, E, heading, ln h), tilt errors about x and y of the heading, errors of tilt and sonar."""
EDGE_FIRST_TILT_SLICE, EDGE_SECOND_TILT_SLICE, EDGE_QUANTITY_COUNT = slice(4, 6), slice(6, 8), 8
"""Slices of an edge after the four numbers of the relation: tilt errors of its first and second node."""
_HEIGHT_CONSTRAINT_VARIANCE = 1e-6  # variance of ln h given the sonar's error
_LOOP_HALF_WEIGHT_CHI2 = 16.0  # chi^2 at which a closure has weight 1/2
_MAX_GRAPH_ITERATIONS = 10


@dataclass(frozen=True)
class GraphEdge:
    """Measurement of keyframe ``second_index`` from keyframe ``first_index``.

    Attributes
    ----------
    first_index, second_index : int
        Indices of the keyframes.
    measurement : (8,) array
        Re t, Im t, heading, ln h, as above; tilt errors of ``first_index`` and ``second_index``.
    information : (8, 8) array
        Information of the pixels on the measurement.
    gradient : (8,) array
        Gradient of the pixels' cost there.
    is_loop_closure : bool
        Whether the edge closes a loop.
    """

    first_index: int
    second_index: int
    measurement: _Array
    information: _Array
    gradient: _Array = field(default_factory=lambda: np.zeros(8))
    is_loop_closure: bool = False

    def compute_residual(self, a: _Array, b: _Array) -> _Array:
        """Return the residual (8,): relative pose and tilts of nodes ``a`` and ``b`` less the measured ones."""
        out = np.concatenate([relative_pose(a, b), a[TILT_SLICE], b[TILT_SLICE]]) - self.measurement
        out[2] = _wrap_angle(out[2])
        return out

    def compute_chi2(self, off: _Array, covariance: _Array | None = None) -> float:
        """Return chi-squared of an edge's residual ``off``; without ``covariance``, only pixel noise is uncertain.

        With ``covariance`` (8, 8), the residual's own uncertainty is included.
        """
        m, g = self.information, self.gradient
        force = m @ off - g
        ridge = 1e-9 * float(np.trace(m)) * np.eye(8)  # directions without pixel information cost nothing
        out = float(off @ m @ off - 2.0 * g @ off + g @ np.linalg.solve(m + ridge, g))
        if covariance is not None:
            # (S + L^-1)^-1 = L - L (L + S^-1)^-1 L, also for singular L
            both = covariance @ np.linalg.solve(np.eye(8) + m @ covariance, force)
            out -= float(force @ both)
        return max(0.0, out)


@dataclass(frozen=True)
class KeyframePriors:
    """Prior knowledge of height and tilt errors of n keyframes, (n,) arrays.

    Attributes
    ----------
    time_s
    log_height, height_sigma, height_time_s
        Sonar measurement of ln h, deviation of its error, and the correlation time of that error.
    tilt_sigma, tilt_time_s, tilt_white
        Deviation of the tilt error (rad), its correlation time, and deviation of its white part (rad).
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
    """Return the correlation r and the noise variance between two samples of a Gauss-Markov error.

    The standard deviations of the errors are ``before`` and ``sigma``. If the second is smaller, the error is scaled
    down in proportion.
    """
    keep = math.exp(-elapsed_s / time_s) * min(1.0, sigma / before) if elapsed_s >= 0.0 else 0.0
    return keep, max(sigma**2 - keep**2 * before**2, 1e-12) + (1.0 + keep**2) * white**2


def relative_pose(a: _Array, b: _Array) -> _Array:
    """Return node ``b`` relative to node ``a`` as four numbers (each node: N, E, heading, ln h)."""
    c, s, h = math.cos(a[HEADING_INDEX]), math.sin(a[HEADING_INDEX]), math.exp(a[LOG_HEIGHT_INDEX])
    n, e = b[0] - a[0], b[1] - a[1]
    turn = _wrap_angle(b[HEADING_INDEX] - a[HEADING_INDEX])
    return np.array([(c * n + s * e) / h, (-s * n + c * e) / h, turn, b[LOG_HEIGHT_INDEX] - a[LOG_HEIGHT_INDEX]])


def relative_pose_jacobians(a: _Array, b: _Array) -> tuple[_Array, _Array]:
    """Return the derivatives of :func:`relative_pose` by ``a`` and by ``b``, (4, 4) each."""
    c, s, h = math.cos(a[HEADING_INDEX]), math.sin(a[HEADING_INDEX]), math.exp(a[LOG_HEIGHT_INDEX])
    t = relative_pose(a, b)
    by_b = np.eye(4)
    by_b[:2, :2] = np.array([[c, s], [-s, c]]) / h
    by_a = -by_b.copy()
    by_a[0, HEADING_INDEX], by_a[1, HEADING_INDEX] = t[1], -t[0]
    by_a[0, LOG_HEIGHT_INDEX], by_a[1, LOG_HEIGHT_INDEX] = -t[0], -t[1]
    return by_a, by_b


def edge_jacobian(a: _Array, b: _Array) -> _Array:
    """Return the derivatives (8, 14) of an edge's measured quantities with respect to both nodes.

    The quantities are the relative pose (4) and the tilt errors of ``a`` (2) and ``b`` (2).
    """
    out = np.zeros((8, 2 * NODE_UNKNOWN_COUNT))
    out[:4, :4], out[:4, NODE_UNKNOWN_COUNT : NODE_UNKNOWN_COUNT + 4] = relative_pose_jacobians(a, b)
    out[EDGE_FIRST_TILT_SLICE, TILT_SLICE] = out[
        EDGE_SECOND_TILT_SLICE, NODE_UNKNOWN_COUNT + TILT_SLICE.start : NODE_UNKNOWN_COUNT + TILT_SLICE.stop
    ] = np.eye(2)
    return out


def _wrap_angle(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True)
class GraphSolution:
    """Solution of a pose graph.

    Attributes
    ----------
    nodes : (n, 7) array
        Place (N, E; m), heading (rad), ln h, tilt errors (rad) and sonar error of each keyframe.
    edge_chi2 : (e,) array
        Chi-squared of each edge.
    """

    nodes: _Array
    edge_chi2: _Array
    _factor: SuperLU

    def joint_covariance(self, which: list[int]) -> _Array:
        """Return the joint covariance (7 k, 7 k) of some nodes, in their order."""
        n = NODE_UNKNOWN_COUNT * len(self.nodes)
        rows = np.concatenate(
            [np.arange(NODE_UNKNOWN_COUNT * k, NODE_UNKNOWN_COUNT * k + NODE_UNKNOWN_COUNT) for k in which]
        )
        unit = np.zeros((n, len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        return self._factor.solve(unit)[rows]


def solve_graph(
    nodes: _Array, edges: list[GraphEdge], known: KeyframePriors, start_sigma: tuple[float, float]
) -> GraphSolution:
    """Solve a pose graph.

    Parameters
    ----------
    nodes : (n, 7) array
        Initial nodes; the first place and heading are the start of the map.
    edges : list of GraphEdge
    known : KeyframePriors
    start_sigma : (2,) tuple
        Standard deviations of the first place (m) and heading (rad); zero is allowed.
    """
    x = np.array(nodes, dtype=np.float64)
    start, n = x[0].copy(), len(x)
    hold = np.array([*[max(start_sigma[0], 1e-5)] * 2, max(start_sigma[1], 1e-5)]) ** -2
    pairs = np.array([(e.first_index, e.second_index) for e in edges], dtype=np.int64).reshape(-1, 2)
    # Correlation of tilt and height errors with those of the previous keyframe
    chain = np.zeros((n, 2, 3))
    for k in range(n):
        since = known.time_s[k] - known.time_s[k - 1] if k else math.inf
        last, tilts, heights = max(k - 1, 0), known.tilt_sigma, known.height_sigma
        tilt = gauss_markov_transition(since, tilts[last], tilts[k], known.tilt_time_s[k], known.tilt_white[k])
        height = gauss_markov_transition(since, heights[last], heights[k], known.height_time_s[k])
        chain[k] = np.array([tilt, tilt, height]).T
    chi2 = np.zeros(len(edges))
    for turn in range(_MAX_GRAPH_ITERATIONS):
        blocks: list[tuple[int, int, _Array]] = []
        right = np.zeros((n, NODE_UNKNOWN_COUNT))
        for k, edge in enumerate(edges):
            i, j = pairs[k]
            off = edge.compute_residual(x[i], x[j])
            chi2[k] = edge.compute_chi2(off)
            weight = 1.0 / (1.0 + chi2[k] / _LOOP_HALF_WEIGHT_CHI2) if edge.is_loop_closure else 1.0
            slope = edge_jacobian(x[i], x[j])
            m = weight * slope.T @ edge.information @ slope
            force = weight * slope.T @ (edge.gradient - edge.information @ off)
            blocks += [
                (i, i, m[:NODE_UNKNOWN_COUNT, :NODE_UNKNOWN_COUNT]),
                (i, j, m[:NODE_UNKNOWN_COUNT, NODE_UNKNOWN_COUNT:]),
                (j, i, m[NODE_UNKNOWN_COUNT:, :NODE_UNKNOWN_COUNT]),
                (j, j, m[NODE_UNKNOWN_COUNT:, NODE_UNKNOWN_COUNT:]),
            ]
            right[i] += force[:NODE_UNKNOWN_COUNT]
            right[j] += force[NODE_UNKNOWN_COUNT:]
        for k in range(n):
            keep, noise = chain[k]
            block = np.diag([1e-9, 1e-9, 1e-9, 0.0, *(1.0 / noise)])
            before = x[k - 1, SENSOR_ERROR_SLICE] if k else np.zeros(3)
            off = (x[k, SENSOR_ERROR_SLICE] - keep * before) / noise
            right[k, SENSOR_ERROR_SLICE] -= off
            if k:
                right[k - 1, SENSOR_ERROR_SLICE] += keep * off
                a, b = (
                    np.zeros((NODE_UNKNOWN_COUNT, NODE_UNKNOWN_COUNT)),
                    np.zeros((NODE_UNKNOWN_COUNT, NODE_UNKNOWN_COUNT)),
                )
                a[SENSOR_ERROR_SLICE, SENSOR_ERROR_SLICE], b[SENSOR_ERROR_SLICE, SENSOR_ERROR_SLICE] = (
                    np.diag(-keep / noise),
                    np.diag(keep**2 / noise),
                )
                blocks += [(k - 1, k, a), (k, k - 1, a), (k - 1, k - 1, b)]
            else:
                block[:3, :3] += np.diag(hold)
                right[0, :LOG_HEIGHT_INDEX] += hold * (start[:LOG_HEIGHT_INDEX] - x[0, :LOG_HEIGHT_INDEX])
            sonar = [LOG_HEIGHT_INDEX, SONAR_ERROR_INDEX]
            block[np.ix_(sonar, sonar)] += 1.0 / _HEIGHT_CONSTRAINT_VARIANCE
            right[k, sonar] += (
                known.log_height[k] - x[k, LOG_HEIGHT_INDEX] - x[k, SONAR_ERROR_INDEX]
            ) / _HEIGHT_CONSTRAINT_VARIANCE
            blocks.append((k, k, block))
        at = np.array([(a, b) for a, b, _ in blocks])
        rows = (
            NODE_UNKNOWN_COUNT * at[:, 0, None, None]
            + np.arange(NODE_UNKNOWN_COUNT)[None, :, None]
            + np.zeros((1, 1, NODE_UNKNOWN_COUNT), int)
        )
        columns = (
            NODE_UNKNOWN_COUNT * at[:, 1, None, None]
            + np.arange(NODE_UNKNOWN_COUNT)[None, None, :]
            + np.zeros((1, NODE_UNKNOWN_COUNT, 1), int)
        )
        values = np.array([block for _, _, block in blocks])
        normal = coo_matrix(
            (values.ravel(), (rows.ravel(), columns.ravel())), shape=(NODE_UNKNOWN_COUNT * n, NODE_UNKNOWN_COUNT * n)
        ).tocsc()
        factor = splu(normal)
        step = factor.solve(right.ravel()).reshape(n, NODE_UNKNOWN_COUNT)
        if turn < _MAX_GRAPH_ITERATIONS - 1:
            x = x + step
        if np.abs(step).max() < 1e-7 or turn == _MAX_GRAPH_ITERATIONS - 1:
            break
    return GraphSolution(x, chi2, factor)


def fuse_pose(
    a: _Array, known: _Array, b: _Array, tilts: _Array, seen: _Array, pull: _Array, log_height: float
) -> tuple[_Array, _Array]:  # fmt: skip
    """Fuse map, tilts, sonar and pixels to the pose of a picture: N, E, heading, ln h, and their covariance.

    The thirteen unknowns are the errors of the keyframe's node and tilt, the picture's tilt and sonar errors, and its
    place.

    Parameters
    ----------
    a : (4,) array
        Node of the keyframe.
    known : (9, 9) array
        Covariance of that node, of its tilt error, of the picture's tilt error, and of its ln h by the sonar.
    b : (4,) array
        Node of the picture as estimated from pixels.
    tilts : (4,) array
        Estimated tilt errors of the picture and the keyframe, relative to their expectation.
    seen, pull : (8, 8), (8,) arrays
        Information and gradient of the pixels on N, E, height, heading and these tilts:
        :class:`mufly.slam.camera_pose.PoseEstimate`.
    log_height : float
        Sonar measurement of ln h minus its expected error.
    """
    by_a, by_b = relative_pose_jacobians(a, b)
    to = np.zeros((EDGE_QUANTITY_COUNT, 13))
    # Slices of the unknowns: the keyframe's node and tilt, the picture's tilt, sonar and place
    keyframe, picture, sonar, place = slice(4, 6), slice(6, 8), 8, slice(9, 13)
    # The pixels give the picture's place relative to the keyframe: add the keyframe's error.
    move = np.hstack([np.linalg.solve(by_b, by_a), np.eye(4)])[[0, 1, LOG_HEIGHT_INDEX, HEADING_INDEX]]
    move[2] *= math.exp(b[LOG_HEIGHT_INDEX])
    to[:4, :4], to[:4, place] = np.split(move, 2, axis=1)
    to[EDGE_FIRST_TILT_SLICE, picture] = to[EDGE_SECOND_TILT_SLICE, keyframe] = np.eye(2)
    prior = np.zeros((13, 13))
    prior[:9, :9] = np.linalg.inv(known)
    begin = np.zeros(13)
    begin[keyframe], begin[picture] = tilts[2:], tilts[:2]  # estimated minus expected values
    m = prior + to.T @ seen @ to
    right = to.T @ pull - prior @ begin
    heights = [sonar, place.start + LOG_HEIGHT_INDEX]
    m[np.ix_(heights, heights)] += 1.0 / _HEIGHT_CONSTRAINT_VARIANCE
    right[heights] += (log_height - b[LOG_HEIGHT_INDEX]) / _HEIGHT_CONSTRAINT_VARIANCE
    covariance = np.asarray(np.linalg.inv(m), np.float64)
    return b + (covariance @ right)[place], covariance[place, place]
