"""Map of the floor: keyframes, the edges between them, and their file."""

from __future__ import annotations

import math
import zipfile
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.slam.camera_pose import d_rays_d_tilt
from mufly.slam.image_tools import find_repeat_shifts
from mufly.slam.pose_graph import (
    HEADING_INDEX,
    LOG_HEIGHT_INDEX,
    NODE_UNKNOWN_COUNT,
    PLACE_SLICE,
    SENSOR_ERROR_SLICE,
    SONAR_ERROR_INDEX,
    TILT_SLICE,
    GraphEdge,
    GraphSolution,
    KeyframePriors,
    edge_jacobian,
    gauss_markov_transition,
    relative_pose,
    solve_graph,
)

_Array = NDArray[np.float64]
MAP_FORMAT_VERSION = 2
_MIN_POINT_SIGMA_PX = 0.04  # lower bound of a point's standard deviation


@dataclass
class Keyframe:
    """A picture of the map with its points.

    Attributes
    ----------
    time_s : float
    picture : (rows, columns) uint8 array
        Undistorted picture.
    turn : (3, 3) array
        Rotation from the camera's axes to N-E-D with heading 0.
    pixels : (n, 2) array
        Points in the undistorted picture.
    slopes : (n,) complex array
        Slopes of their rays, heading 0.
    variance : (n,) array
        Variances of the slopes along an axis.
    missed : (n,) int array
        Number of outliers less inliers of each point.
    tilt : (2,) array
        Assumed error of the reported tilt, about the axes of the heading, for which the slopes are computed (rad).
    log_height : float
        ln h of the camera by the sonar.
    height_sigma, height_time_s, tilt_sigma, tilt_time_s, tilt_white : float
        Errors of height and tilt: :class:`mufly.slam.pose_graph.KeyframePriors`.
    """

    time_s: float
    picture: NDArray[np.uint8]
    turn: _Array
    pixels: _Array
    slopes: NDArray[np.complex128]
    variance: _Array
    missed: NDArray[np.int64]
    tilt: _Array
    log_height: float
    height_sigma: float
    height_time_s: float
    tilt_sigma: float
    tilt_time_s: float
    tilt_white: float
    orb_features: Any = field(default=None, repr=False)
    repeat_shifts_px: Any = field(default=None, repr=False)

    def refine_points(
        self, which: NDArray[np.intp], seen: NDArray[np.complex128], variance: _Array, focal: float
    ) -> None:
        """Update slopes and variances of some points by new measurements."""
        gain = self.variance[which] / (self.variance[which] + variance)
        self.slopes[which] += gain * (seen - self.slopes[which])
        self.variance[which] = np.maximum((1.0 - gain) * self.variance[which], (_MIN_POINT_SIGMA_PX / focal) ** 2)


_SAVED_FIELDS = tuple(f.name for f in fields(Keyframe) if f.default is MISSING)


class FloorMap:
    """Map of keyframes and edges.

    Parameters
    ----------
    start_pose : (3,) array_like
        N, E (m) and heading (rad) of the vehicle at the start of the map.
    start_sigma : (2,) tuple
        Standard deviations of that position (m) and heading (rad).
    """

    def __init__(self, start: Any = (0.0, 0.0, 0.0), start_sigma: tuple[float, float] = (0.0, 0.0)) -> None:
        self.start_pose, self.start_sigma = np.asarray(start, dtype=np.float64), start_sigma
        self.keyframes: list[Keyframe] = []
        self.nodes = np.zeros((0, NODE_UNKNOWN_COUNT))
        self.edges: list[GraphEdge] = []
        self.solution: GraphSolution | None = None
        self._covariance_cache: dict[tuple[int, ...], _Array] = {}

    def add_keyframe(self, keyframe: Keyframe, node: _Array, ties: list[GraphEdge]) -> int:
        """Add a keyframe at a node (7,) with edges to others; return its number."""
        self.keyframes.append(keyframe)
        self.nodes = np.vstack([self.nodes, node])
        self.edges += ties
        self.optimise_graph()
        return len(self.keyframes) - 1

    def drop_last_keyframe(self) -> None:
        """Remove the last keyframe and its edges."""
        self.keyframes.pop()
        k = len(self.keyframes)
        self.nodes = self.nodes[:k]
        self.edges = [e for e in self.edges if k not in (e.first_index, e.second_index)]
        self.optimise_graph()

    def try_add_edge(self, edge: GraphEdge, most: float = math.inf) -> bool:
        """Add an edge and return True; if chi-squared then exceeds ``most``, restore the map and return False."""
        before = self.nodes.copy()
        self.edges.append(edge)
        self.optimise_graph()
        assert self.solution is not None
        if self.solution.edge_chi2[-1] > most:
            self.edges.pop()
            self.nodes = before
            self.optimise_graph()
            return False
        return True

    def optimise_graph(self) -> None:
        """Optimise the nodes by the pose graph."""
        known = KeyframePriors(
            *(np.array([getattr(k, f.name) for k in self.keyframes]) for f in fields(KeyframePriors))
        )
        self.solution = solve_graph(self.nodes, self.edges, known, self.start_sigma)
        self.nodes = self.solution.nodes
        self._covariance_cache = {}

    def joint_covariance(self, *which: int) -> _Array:
        """Return the joint covariance of some nodes (7 n, 7 n)."""
        if which not in self._covariance_cache:
            assert self.solution is not None
            self._covariance_cache[which] = self.solution.joint_covariance(list(which))
        return self._covariance_cache[which]

    def edge_covariance(self, a: int, b: int) -> _Array:
        """Return the covariance (8, 8) of what an edge measures: node ``b`` relative to node ``a``, and both tilts."""
        j = edge_jacobian(self.nodes[a], self.nodes[b])
        return j @ self.joint_covariance(a, b) @ j.T

    def predict_sensor_errors(
        self, time_s: float, tilt: tuple[float, float, float], height: tuple[float, float]
    ) -> tuple[_Array, _Array, _Array]:
        """Predict tilt (rad) and sonar error (ln h) of a picture from those of the newest keyframe.

        Return the errors, the factors by which the old errors persist, and the variances of the added noise.

        ``tilt`` and ``height`` are arguments of :func:`mufly.slam.pose_graph.gauss_markov_transition`, which gives the
        factors and noise variances.
        """
        last = self.keyframes[-1] if self.keyframes else None
        since = math.inf if last is None else time_s - last.time_s
        of_tilt = gauss_markov_transition(since, tilt[0] if last is None else last.tilt_sigma, *tilt)
        of_height = gauss_markov_transition(since, height[0] if last is None else last.height_sigma, *height)
        keep, noise = np.array([of_tilt, of_tilt, of_height]).T
        return keep * (0.0 if last is None else self.nodes[-1, SENSOR_ERROR_SLICE]), keep, noise

    def predict_covariance(self, k: int, keep: _Array, noise: _Array) -> _Array:
        """Return the joint covariance (9, 9) of keyframe ``k``'s node and of a new picture's sensor errors.

        Of the node: N, E, heading, ln h and two tilt errors. Of the picture: two tilt errors and the sonar error, with
        ``keep`` and ``noise`` from :meth:`predict_sensor_errors`.
        """
        last = len(self.keyframes) - 1
        to = np.zeros((9, NODE_UNKNOWN_COUNT if k == last else 2 * NODE_UNKNOWN_COUNT))
        to[:SONAR_ERROR_INDEX, :SONAR_ERROR_INDEX] = np.eye(SONAR_ERROR_INDEX)
        to[SONAR_ERROR_INDEX:, -3:] = np.diag(keep)
        out = to @ (self.joint_covariance(k) if k == last else self.joint_covariance(k, last)) @ to.T
        out[SONAR_ERROR_INDEX:, SONAR_ERROR_INDEX:] += np.diag(noise)
        return out

    def connected_keyframes(self, k: int) -> set[int]:
        """Return the keyframes with an edge to keyframe ``k``."""
        return {
            e.second_index if e.first_index == k else e.first_index
            for e in self.edges
            if k in (e.first_index, e.second_index)
        }

    def locate_points(self, k: int) -> _Array:
        """Return the positions (n, 3), N-E-D (m), of a keyframe's points for the present estimate of its tilt error."""
        f = self.keyframes[k]
        moved = d_rays_d_tilt(f.slopes) @ (self.nodes[k, TILT_SLICE] - f.tilt)
        n, e, heading, ln_height = self.nodes[k, PLACE_SLICE]
        c, z = complex(n, e), np.exp(ln_height + 1j * heading)
        x = c + z * (f.slopes + moved[:, 0] + 1j * moved[:, 1])
        return np.stack([x.real, x.imag, np.zeros(len(x))], axis=1)

    def points_tilt_jacobian(self, k: int) -> _Array:
        """Return the derivatives of a keyframe's points (n, 2, 2) by its tilt error (m/rad)."""
        _, _, heading, ln_height = self.nodes[k, PLACE_SLICE].tolist()
        c, s, h = math.cos(heading), math.sin(heading), math.exp(ln_height)
        return h * np.array([[c, -s], [s, c]]) @ d_rays_d_tilt(self.keyframes[k].slopes)

    def texture_repeat_offsets(self, k: int, focal: float) -> _Array:
        """Return the offsets N and E (n, 2) by which the floor in a keyframe repeats, each with both signs (m)."""
        f = self.keyframes[k]
        if f.repeat_shifts_px is None:
            f.repeat_shifts_px = find_repeat_shifts(f.picture)
        m = f.repeat_shifts_px / focal @ f.turn[:2, :2].T
        _, _, heading, ln_height = self.nodes[k, PLACE_SLICE].tolist()
        c, s, h = math.cos(heading), math.sin(heading), math.exp(ln_height)
        way = h * m @ np.array([[c, s], [-s, c]])
        return np.concatenate([way, -way])

    def save(self, path: str | Path) -> None:
        """Write the map to a file (a zip of NumPy arrays)."""
        arrays: dict[str, Any] = {
            "format": np.array(MAP_FORMAT_VERSION),
            "start": self.start_pose,
            "start_sigma": np.array(self.start_sigma),
            "nodes": self.nodes,
            "edges": np.array([(e.first_index, e.second_index, e.is_loop_closure) for e in self.edges], dtype=np.int64),
            "measured": np.array([e.measurement for e in self.edges]).reshape(-1, 8),
            "information": np.array([e.information for e in self.edges]).reshape(-1, 8, 8),
            "pull": np.array([e.gradient for e in self.edges]).reshape(-1, 8),
        }
        for k, f in enumerate(self.keyframes):
            for name in _SAVED_FIELDS:
                arrays[f"{name}_{k}"] = np.asarray(getattr(f, name))
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> FloorMap:
        """Read a map written by :meth:`save`.

        Raises
        ------
        InputError
            If the file is no map, or damaged.
        """
        try:
            with np.load(path, allow_pickle=False) as a:
                if int(a["format"]) != MAP_FORMAT_VERSION:
                    raise InputError(
                        str(path), "format", f"is {int(a['format'])}", f"give a map of format {MAP_FORMAT_VERSION}"
                    )
                out = cls(a["start"], (float(a["start_sigma"][0]), float(a["start_sigma"][1])))
                out.nodes = a["nodes"]
                out.edges = [
                    GraphEdge(int(i), int(j), m, w, g, bool(closes))
                    for (i, j, closes), m, w, g in zip(
                        a["edges"], a["measured"], a["information"], a["pull"], strict=True
                    )
                ]
                for k in range(len(out.nodes)):
                    kept: Any = (a[f"{name}_{k}"] for name in _SAVED_FIELDS)
                    kept = (float(q) if q.ndim == 0 else q for q in kept)
                    out.keyframes.append(Keyframe(*kept))
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
            raise InputError(
                str(path), "", f"is not a map ({error})", "give a file that 'mufly slam run --map' wrote"
            ) from error
        if out.keyframes:
            out.optimise_graph()
        return out


def compose_pose(a: _Array, b: _Array) -> _Array:
    """Return the node at the pose ``b`` relative to node ``a`` (:func:`mufly.slam.pose_graph.relative_pose`)."""
    c, s, h = math.cos(a[HEADING_INDEX]), math.sin(a[HEADING_INDEX]), math.exp(a[LOG_HEIGHT_INDEX])
    return np.array(
        [a[0] + h * (c * b[0] - s * b[1]), a[1] + h * (s * b[0] + c * b[1]), *(a[PLACE_SLICE] + b)[HEADING_INDEX:]]
    )


def residuals_without_pose_error(
    off: NDArray[np.complex128], own: NDArray[np.complex128], seen: NDArray[np.complex128], weight: _Array
) -> NDArray[np.complex128]:
    """Return the residuals of points without the part that a change of the pose would explain.

    Parameters
    ----------
    off : (n,) complex array
        Residuals (slopes).
    own, seen : (n,) complex arrays
        Slopes of the points from the keyframe, and from the picture.
    weight : (n,) array
        Weights of the fit.
    """
    one = np.ones_like(own)
    turns = [q[:, 0] + 1j * q[:, 1] for s in (own, seen) for q in np.moveaxis(d_rays_d_tilt(s), 2, 0)]
    basis = np.stack([one, 1j * one, own, 1j * own, *turns], axis=1)
    w = np.concatenate([weight, weight])
    of = np.vstack([basis.real, basis.imag]) * w[:, None]
    fit = np.linalg.lstsq(of, np.concatenate([off.real, off.imag]) * w, rcond=1e-6)[0]
    return np.asarray(off - basis @ fit, np.complex128)


def view_overlap(a: _Array, b: _Array, wide: float, high: float) -> float:
    """Return the approximate share of the view from node ``b`` that is also seen from node ``a``, both level.

    It falls with differences in heading and height. ``wide`` and ``high`` are the picture's sides over the focal
    length.
    """
    t = relative_pose(a, b)
    size = min(math.exp(t[LOG_HEIGHT_INDEX]), math.exp(-t[LOG_HEIGHT_INDEX]))
    # The picture's rows are ordered along the nose.
    along, across = max(0.0, 1.0 - abs(t[0]) / high), max(0.0, 1.0 - abs(t[1]) / wide)
    return along * across * size * max(0.0, math.cos(1.5 * t[HEADING_INDEX])) if abs(t[HEADING_INDEX]) < 1.0 else 0.0
