"""Sections of scanned blades: cuts of a triangle surface with gaps closed, and smooth contours fitted to noisy cuts.

**Gaps.** A plane x = r cuts triangles in segments. Chains of segments that missing triangles interrupt are joined at
their ends, the cheapest pair first. The cost of a joint of length d is d (1.05 - (cos a + cos b) / 2), with the angles
a and b between the joint and the outward directions of the chains. It favours joints that continue both chains.

**Scatter.** The scatter of a cut's points is the median distance, over 0.67, from polynomials of degree 5 through the
middle of both sides.

**Fit.** Points of neighbouring cuts are moved to common axes: nose at 0, middle of the tail at 1, from a quadratic fit
of both ends over the radius. One contour of Kulfan's parameters (:mod:`mufly.rotor.sections.neuralfoil_network`) is
then fitted to them by Gauss-Newton with Huber's weights. The residual is the distance along the contour's normal, so
that noise along the chord does not lengthen it. Shift and turn of the axes are unknowns of the fit. The length of the
chord follows from the area behind 0.9 of it, so that a frayed tail does not lengthen it either. The base of the tail is
a straight segment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import comb

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MAX_GAP_RATIO, _MAX_BRIDGED_RATIO = 0.3, 0.4  # of the cut's diagonal; of its outline
_MIN_LOOP_SIZE_RATIO = 0.3  # of the largest loop's diagonal
_KULFAN_WEIGHTS = 8
_NOSE_WEIGHT, _TAIL_THICKNESS, _PARAMETER_COUNT = 16, 17, 18  # places in Kulfan's parameters, and their number
_POINTS_PER_SIDE = 100
_SCATTER_DEGREE = 5
_FIT_POINTS_PER_CUT = 140
_FIT_ITERATIONS = 5
_FRAME_STD_CHORDS, _NOSE_WEIGHT_STD = 4e-3, 0.3  # priors of shift and turn (rad) of the axes; of the nose's weight
_HUBER_LIMIT = 2.0  # standard deviations
_DAMPING, _MAX_KULFAN_WEIGHT = 1e-7, 2.0
_TAIL_REGION_START = 0.9  # chord fraction
_NOSE_REGION_CHORDS = 0.05  # in front of this, points may belong to either side


class SectionCut(NamedTuple):
    """Closed contour of a cut, (n, 2) points (y, z), and whether a joint leads from each point to the next."""

    points_m: Array
    bridged: Mask

    @property
    def bridged_ratio(self) -> float:
        """Length of the joints over that of the contour."""
        step = np.hypot(*(np.roll(self.points_m, -1, axis=0) - self.points_m).T)
        return float(step[self.bridged].sum() / step.sum())


class FittedSection(NamedTuple):
    """Smooth contour (y, z), and standard deviation of the points from it (m)."""

    points_m: Array
    scatter_m: float


def cut_triangles(corners: Array, r: float) -> SectionCut | None:
    """Return the contour (y, z) nearest to y = 0 in which the plane x = r cuts the triangles, or None."""
    side = corners[:, :, 0] > r
    cut = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    if cut.size < 8:
        return None
    scale = float(max(corners.max(), -corners.min()))
    corners, side = corners[cut], side[cut]
    begin, end = corners[:, [0, 1, 2]], corners[:, [1, 2, 0]]  # the three edges of each triangle
    beyond = side[:, [0, 1, 2], None]
    p, q = np.where(beyond, begin, end), np.where(beyond, end, begin)
    crossed = side[:, [0, 1, 2]] != side[:, [1, 2, 0]]  # two edges of each
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (p + ((r - p[..., 0]) / (q[..., 0] - p[..., 0]))[..., None] * (q - p))[..., 1:]
    ends = at[crossed].reshape(-1, 2, 2)
    key = [tuple(v) for v in np.round(ends.reshape(-1, 2) / (1e-7 * scale)).astype(np.int64).tolist()]
    closed, open_chains = _chain_segments(ends, key)
    loops = [SectionCut(loop, np.zeros(len(loop), dtype=np.bool_)) for loop in closed if len(loop) > 7]
    if open_chains:
        size = float(np.hypot(*np.ptp(ends.reshape(-1, 2), axis=0)))
        loops += _join_chains(open_chains, _MAX_GAP_RATIO * size)
    if not loops:
        return None
    sizes = [float(np.hypot(*np.ptp(loop.points_m, axis=0))) for loop in loops]
    large = [loop for loop, s in zip(loops, sizes, strict=True) if s >= _MIN_LOOP_SIZE_RATIO * max(sizes)]
    return min(large, key=lambda loop: abs(float(loop.points_m[:, 0].mean())))


def _chain_segments(ends: Array, key: list[tuple[int, ...]]) -> tuple[list[Array], list[Array]]:
    """Chain segments with coincident ends; return closed chains, without a repeated point, and open ones."""
    meets: dict[tuple[int, ...], list[int]] = {}
    for k, name in enumerate(key):
        meets.setdefault(name, []).append(k)
    unused = dict.fromkeys(range(len(ends)))

    def walk(now: tuple[int, ...], stop: tuple[int, ...]) -> tuple[list[Array], tuple[int, ...]]:
        chain: list[Array] = []
        while now != stop:
            after = next((k for k in meets[now] if k // 2 in unused), None)
            if after is None:
                break
            del unused[after // 2]
            other = after ^ 1
            chain.append(ends[other // 2][other % 2])
            now = key[other]
        return chain, now

    closed, open_chains = [], []
    while unused:
        first = unused.popitem()[0]
        if key[2 * first] == key[2 * first + 1]:
            continue
        forward, now = walk(key[2 * first + 1], key[2 * first])
        chain = [ends[first][0], ends[first][1], *forward]
        if now == key[2 * first]:
            closed.append(np.array(chain[:-1]))
        else:
            backward, _ = walk(key[2 * first], now)
            open_chains.append(np.array([*backward[::-1], *chain]))
    return closed, open_chains


def _join_chains(chains: list[Array], max_gap: float) -> list[SectionCut]:
    """Join open chains at their ends to closed contours, the cheapest joint first; see the module docstring."""
    tips = np.array([c[e] for c in chains for e in (0, -1)])
    out = np.array([_outward_direction(c, e) for c in chains for e in (0, -1)])
    between = tips[None] - tips[:, None]
    apart = np.hypot(between[..., 0], between[..., 1])
    way = between / np.maximum(apart, 1e-300)[..., None]
    ahead = np.einsum("ijk,ik->ij", way, out) - np.einsum("ijk,jk->ij", way, out)
    cost = apart * (1.05 - 0.5 * ahead)
    i, j = np.triu_indices(len(tips), 1)
    partner: dict[int, int] = {}
    for k in np.argsort(cost[i, j], kind="stable").tolist():
        a, b = int(i[k]), int(j[k])
        if a in partner or b in partner or apart[a, b] > max_gap:
            continue
        partner[a], partner[b] = b, a
    loops = []
    unused = set(range(len(chains)))
    while unused:
        first = min(unused)
        points, bridged, end = [], [], 2 * first  # the end at which a chain is entered
        while end // 2 in unused:
            unused.discard(end // 2)
            chain = chains[end // 2] if end % 2 == 0 else chains[end // 2][::-1]
            points.append(chain)
            bridged.append(np.arange(len(chain)) == len(chain) - 1)
            end = partner.get(end ^ 1, -2)
        loop = SectionCut(np.concatenate(points), np.concatenate(bridged))
        if end == 2 * first and len(loop.points_m) > 7 and loop.bridged_ratio < _MAX_BRIDGED_RATIO:
            loops.append(loop)
    return loops


def _outward_direction(chain: Array, end: int) -> Array:
    """Return the unit vector with which a chain leaves at its first (0) or last (-1) point."""
    ring = chain if end == -1 else chain[::-1]
    way = ring[-1] - ring[max(len(ring) - 3, 0)]
    return np.asarray(way / max(float(np.hypot(*way)), 1e-300))


def estimate_scatter(points: Array, nose: int, tail: int) -> float:
    """Return the standard deviation of the points of a contour in Selig's order from smooth sides (m).

    Parameters
    ----------
    points : (n, 2) array
    nose, tail : int
        Indices of the ends.
    """
    ring = np.roll(points, -tail, axis=0)
    axes = _to_chord_axes(ring, np.concatenate((points[nose], points[tail])))
    front = (nose - tail) % len(points)
    misses = []
    for side in (axes[:front], axes[front:]):
        x, y = side[(side[:, 0] > 0.15) & (side[:, 0] < 0.85)].T
        if len(x) > 2 * _SCATTER_DEGREE:
            fit = np.polynomial.Polynomial.fit(x, y, _SCATTER_DEGREE)
            misses.append((y - fit(x)) * math.sqrt(len(x) / (len(x) - _SCATTER_DEGREE - 1.0)))
    chord = float(np.hypot(*(points[tail] - points[nose])))
    return chord * float(np.median(np.abs(np.concatenate(misses)))) / 0.6745 if misses else 0.0


def _resample_real_points(cut: SectionCut, count: int) -> tuple[Array, Array]:
    """Return points at equal distances on the contour outside joints, and their place on the contour (0 to 1)."""
    step = np.hypot(*(np.roll(cut.points_m, -1, axis=0) - cut.points_m).T)
    place = np.concatenate(([0.0], np.cumsum(step)))
    wanted = place[-1] * (np.arange(count) + 0.5) / count
    index = np.clip(np.searchsorted(place, wanted, side="right") - 1, 0, len(step) - 1)
    ring = np.concatenate((cut.points_m, cut.points_m[:1]))
    share = ((wanted - place[index]) / np.maximum(step[index], 1e-300))[:, None]
    points = ring[index] + share * (ring[index + 1] - ring[index])
    real = ~cut.bridged[index]
    return points[real], (wanted / place[-1])[real]


class CutEnds(NamedTuple):
    """Nose and middle of the tail of a cut, (2,) points (y, z), with the indices of both ends on its contour."""

    nose_m: Array
    tail_m: Array
    nose: int
    tail: int


def find_cut_ends(points: Array, nose: int, tail: int) -> CutEnds:
    """Return the ends of a contour, its tail midway between both sides near the aft end."""
    chord = points[tail] - points[nose]
    size = float(np.hypot(*chord))
    along, across = chord / size, np.array([-chord[1], chord[0]]) / size
    x, y = (points - points[nose]) @ along / size, (points - points[nose]) @ across
    aft = y[x > 0.97]
    middle = points[nose] + x.max() * size * along + 0.5 * (aft.max() + aft.min()) * across
    return CutEnds(points[nose], middle, nose, tail)


def _kulfan_basis(x: Array) -> tuple[Array, Array]:
    """Return the columns of y on the upper and on the lower side for the 18 parameters at chord fractions (n,)."""
    i, degree = np.arange(_KULFAN_WEIGHTS), _KULFAN_WEIGHTS - 1
    shape = (
        np.sqrt(x)[:, None]
        * (1.0 - x)[:, None]
        * (comb(degree, i) * x[:, None] ** i * (1 - x[:, None]) ** (degree - i))
    )
    nose, none = x * (1.0 - x) ** (_KULFAN_WEIGHTS + 0.5), np.zeros_like(shape)
    return np.column_stack((shape, none, nose, 0.5 * x)), np.column_stack((none, shape, nose, -0.5 * x))


_CHORD_STATIONS = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, _POINTS_PER_SIDE)))
_UPPER_BASIS, _LOWER_BASIS = _kulfan_basis(_CHORD_STATIONS)


class _Model(NamedTuple):
    """Points, outward normals and columns of one side of a contour, its base included."""

    points: Array
    normals: Array
    columns: Array


def _model_sides(parameters: Array) -> list[_Model]:
    sides = []
    for basis, sign in ((_UPPER_BASIS, 1.0), (_LOWER_BASIS, -1.0)):
        y = basis @ parameters
        points = np.column_stack((_CHORD_STATIONS, y))
        slope = np.gradient(points, axis=0)
        normal = sign * np.column_stack((-slope[:, 1], slope[:, 0]))
        normal /= np.maximum(np.hypot(*normal.T), 1e-300)[:, None]
        base_y = y[-1] * np.linspace(0.9, 0.0, 8)  # half of the base belongs to each side
        base = np.column_stack((np.ones(8), base_y))
        sides.append(
            _Model(
                np.concatenate((points, base)),
                np.concatenate((normal, np.tile([1.0, 0.0], (8, 1)))),
                np.concatenate((basis, np.zeros((8, basis.shape[1])))),
            )
        )
    return sides


def _fit_kulfan_contour(points: Array, upper: Array, start: Array, vertices: int) -> tuple[Array, Array, float]:
    """Fit a contour to points in chord axes by distances along its normals.

    Parameters
    ----------
    points : (n, 2) array
        Chord fractions and heights.
    upper : (n,) array
        1 for points of the upper side, -1 for the lower side.
    start : (18,) array
        First parameters.
    vertices : int
        Number of independent points.

    Returns
    -------
    parameters : (18,) array
    pose : (2, 3) array
        Affine map from the points' axes to those of the parameters.
    scatter : float
        Robust standard deviation of the distances.
    """
    parameters, moved, pose, scatter = start.copy(), points.copy(), np.eye(2, 3), 0.0
    total, repeat = np.zeros(3), max(len(points) / vertices, 1.0)
    for _ in range(_FIT_ITERATIONS):
        sides = _model_sides(parameters)
        found = [cKDTree(s.points).query(moved) for s in sides]
        front = moved[:, 0] < _NOSE_REGION_CHORDS
        lower = np.where(front, found[1][0] < found[0][0], upper < 0.0)
        index = np.where(lower, found[1][1], found[0][1])
        q, n, columns = (
            np.where(lower[:, None], getattr(sides[1], part)[index], getattr(sides[0], part)[index])
            for part in _Model._fields
        )
        residual = np.sum(n * (moved - q), axis=1)
        x, y = moved.T
        motion = np.column_stack((n[:, 0], n[:, 1], n[:, 1] * x - n[:, 0] * y))
        # residual + motion @ (shift, turn) - n_y columns @ change -> 0
        matrix = np.column_stack((n[:, 1:] * columns, -motion))
        scatter = float(np.median(np.abs(residual)) / 0.6745)
        weight = np.minimum(1.0, _HUBER_LIMIT * scatter / np.maximum(np.abs(residual), 1e-12))
        # Priors, in the weight of the points, of which only ``vertices`` are independent.
        prior = np.concatenate(
            (np.full(_PARAMETER_COUNT, _DAMPING * len(x)), np.full(3, (scatter / _FRAME_STD_CHORDS) ** 2 * repeat))
        )
        prior[_NOSE_WEIGHT] += (scatter / _NOSE_WEIGHT_STD) ** 2 * repeat
        pull = np.zeros(_PARAMETER_COUNT + 3)
        pull[_NOSE_WEIGHT], pull[_PARAMETER_COUNT:] = (
            -prior[_NOSE_WEIGHT] * parameters[_NOSE_WEIGHT],
            -prior[_PARAMETER_COUNT:] * total,
        )
        normal = (weight[:, None] * matrix).T @ matrix + np.diag(prior)
        change = np.linalg.solve(normal, matrix.T @ (weight * residual) + pull)
        total += change[_PARAMETER_COUNT:]
        parameters = parameters + change[:_PARAMETER_COUNT]
        parameters[_TAIL_THICKNESS] = max(parameters[_TAIL_THICKNESS], 0.0)
        a, b, turn = change[_PARAMETER_COUNT:]
        step = np.array([[1.0, -turn, a], [turn, 1.0, b]])
        moved = moved @ step[:, :2].T + step[:, 2]
        pose = _chain_poses(step, pose)
    return parameters, pose, scatter


def _chain_poses(second: Array, first: Array) -> Array:
    """Return the affine map (2, 3) that applies ``first`` and then ``second``."""
    return np.column_stack((second[:, :2] @ first[:, :2], second[:, :2] @ first[:, 2] + second[:, 2]))


def _tail_position(parameters: Array, rings: Sequence[Array]) -> float:
    """Return the chord fraction at which the tail ends: the contour's extrapolated thickness has the cuts' area.

    Unlike the aftmost point, the area behind :data:`_TAIL_REGION_START` is free of bias by noise.
    """
    begin, end = np.searchsorted(_CHORD_STATIONS, (_TAIL_REGION_START - 0.05, _TAIL_REGION_START + 0.05))
    x = _CHORD_STATIONS[begin:end]
    slope, at_start = np.polyfit(x - _TAIL_REGION_START, ((_UPPER_BASIS - _LOWER_BASIS) @ parameters)[begin:end], 1)
    areas = []
    for ring in rings:
        aft, y = np.maximum(ring[:, 0], _TAIL_REGION_START), ring[:, 1]
        areas.append(abs(0.5 * float(np.sum(aft * np.roll(y, -1) - np.roll(aft, -1) * y))))
    area = float(np.median(areas))
    # at_start d + slope d^2 / 2 = area
    root = at_start**2 + 2.0 * slope * area
    length = 2.0 * area / (at_start + math.sqrt(max(root, 0.0)))
    return min(max(_TAIL_REGION_START + length, 0.9), 1.1)


def fit_section(
    r_m: float, cut_r_m: Sequence[float] | Array, cuts: Sequence[SectionCut], ends: Sequence[CutEnds], vertices: int
) -> FittedSection | None:
    """Fit one smooth contour at a radius to the cuts on both sides of it; return None if the fit diverges.

    Parameters
    ----------
    r_m : float
        Radius of the contour.
    cut_r_m : (n,) array_like
        Radii of the cuts.
    cuts : sequence of SectionCut
        Cuts; noses of all in the direction of +y.
    ends : sequence of CutEnds
    vertices : int
        Number of independent points of the surface in the window; it sets the weight of the priors.
    """
    offset = np.asarray(cut_r_m, dtype=np.float64) - r_m
    places = np.array([[*e.nose_m, *e.tail_m] for e in ends])
    span = max(float(np.max(np.abs(offset))), 1e-12)
    degree = min(2, len(offset) - 1)
    columns = np.vander(offset / span, degree + 1, increasing=True)
    smooth = columns @ np.linalg.lstsq(columns, places, rcond=None)[0]
    for _ in range(3):
        miss = np.abs(places - smooth)
        limit = 2.0 * np.median(miss, axis=0) / 0.6745 + 1e-12
        smooth = np.column_stack(
            [
                columns @ np.linalg.lstsq(columns * w[:, None], places[:, k] * w, rcond=None)[0]
                for k in range(4)
                for w in [np.sqrt(np.minimum(1.0, limit[k] / np.maximum(miss[:, k], 1e-15)))]
            ]
        )
    points, upper = [], []
    for cut, end, frame in zip(cuts, ends, smooth, strict=True):
        at, place = _resample_real_points(cut, _FIT_POINTS_PER_CUT)
        points.append(_to_chord_axes(at, frame))
        upper.append(_side_of_points(cut.points_m, place, end))
    table, sides = np.concatenate(points), np.concatenate(upper)
    rings = [_to_chord_axes(cut.points_m, frame) for cut, frame in zip(cuts, smooth, strict=True)]
    basis = np.where((sides > 0)[:, None], *_kulfan_basis(np.clip(table[:, 0], 0.0, 1.0)))
    start: Array = np.asarray(np.linalg.lstsq(basis, table[:, 1], rcond=None)[0], dtype=np.float64)
    start[_TAIL_THICKNESS] = max(start[_TAIL_THICKNESS], 0.0)
    pose, count = np.eye(2, 3), max(vertices, 30)
    for _ in range(2):
        start, step, scatter = _fit_kulfan_contour(table @ pose[:, :2].T + pose[:, 2], sides, start, count)
        pose = _chain_poses(step, pose)
        length = _tail_position(start, [ring @ pose[:, :2].T + pose[:, 2] for ring in rings])
        pose = pose / length
    parameters, step, scatter = _fit_kulfan_contour(table @ pose[:, :2].T + pose[:, 2], sides, start, count)
    pose = _chain_poses(step, pose)
    if not np.all(np.abs(parameters) < _MAX_KULFAN_WEIGHT) or not 0.95 < length < 1.05:
        return None
    contour = np.concatenate(
        (
            np.column_stack((_CHORD_STATIONS, _UPPER_BASIS @ parameters))[::-1],
            np.column_stack((_CHORD_STATIONS, _LOWER_BASIS @ parameters))[1:],
        )
    )
    if parameters[_TAIL_THICKNESS] < 1e-9:
        contour = contour[:-1]
    contour = np.asarray(np.linalg.solve(pose[:, :2], (contour - pose[:, 2]).T).T, dtype=np.float64)
    frame = np.linalg.lstsq(columns, smooth, rcond=None)[0][0]  # at the radius itself
    chord = float(np.hypot(frame[2] - frame[0], frame[3] - frame[1]))
    return FittedSection(_from_chord_axes(contour, frame), scatter * chord)


def _to_chord_axes(points: Array, frame: Array) -> Array:
    """Return points (y, z) in axes with x from nose to tail and y upwards; ``frame`` has nose and tail."""
    chord = frame[2:] - frame[:2]
    size = float(np.hypot(*chord))
    along, across = chord / size, np.array([chord[1], -chord[0]]) / size
    return np.column_stack(((points - frame[:2]) @ along, (points - frame[:2]) @ across)) / size


def _from_chord_axes(points: Array, frame: Array) -> Array:
    """Return points in chord axes as (y, z)."""
    chord = frame[2:] - frame[:2]
    across = np.array([chord[1], -chord[0]])
    return np.asarray(frame[:2] + points[:, :1] * chord + points[:, 1:] * across)


def _side_of_points(ring: Array, place: Array, end: CutEnds) -> Array:
    """Return 1 for places (0 to 1) between the tail and the nose on a contour in Selig's order, -1 for the others."""
    step = np.hypot(*(np.roll(ring, -1, axis=0) - ring).T)
    at = np.concatenate(([0.0], np.cumsum(step)))
    nose, tail = at[end.nose] / at[-1], at[end.tail] / at[-1]
    return np.where((place - tail) % 1.0 < (nose - tail) % 1.0, 1.0, -1.0)
