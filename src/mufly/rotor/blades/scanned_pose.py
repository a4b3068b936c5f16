"""Position of a scanned blade or rotor about its shaft: centre, number of blades, and which side is up.

A rotor of N blades is unchanged by a turn of 2 pi / N about its shaft. The shaft of a whole rotor therefore passes
through the area-weighted mean of its surface. The turned surface is compared with the surface by the mean distance of
random points to their nearest neighbours. A single blade has no such symmetry; its shaft is checked by the mean line of
its cuts, which passes near the shaft.

Blades are counted in rings between 0.5 and 0.8 R: the occupied azimuths of a ring form one interval for each blade.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

SHAFT_DIRECTIONS: dict[str, tuple[tuple[float, float, float], ...]] = {
    "z": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "x": ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
    "-x": ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)),
    "y": ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "-y": ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
}
"""Rotations, row by row, that turn a direction of the thrust in a body's file to +z."""

_MAX_BLADES = 8
_SAMPLE_COUNT = 8_000
_MAX_SYMMETRY_DISTANCE_RATIO = 2.0  # of the distance between two samples of one surface
_MIN_SHIFT_RADII, _MAX_SHIFT_RADII = 0.01, 0.8  # distances of the centre from the origin that count as a shift
_RING_EDGES_RADII = np.linspace(0.5, 0.8, 7)
_AZIMUTH_BINS = 360
_MAX_AZIMUTH_GAP_BINS = 4  # narrower gaps are holes of a scan


class ShaftPosition(NamedTuple):
    """Position of the shaft in a body's x-y plane (m), and the number of equal blades about it (1: no symmetry)."""

    centre_m: tuple[float, float]
    blades: int


def _sample_surface(corners: Array, count: int, rng: np.random.Generator) -> Array:
    """Return random points on triangles, (count, 3), evenly distributed over the area."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), count, p=area / area.sum())]
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.column_stack((1.0 - u, u * (1.0 - v), u * v))
    return np.asarray(np.einsum("nk,nkx->nx", weights, chosen))


def find_shaft(corners_m: Array) -> ShaftPosition:
    """Return the shaft position of a whole rotor, or the origin for a body without rotational symmetry.

    Parameters
    ----------
    corners_m : (n, 3, 3) array
        Triangles; the shaft is parallel to z.
    """
    rng = np.random.default_rng(0)
    points, again = _sample_surface(corners_m, _SAMPLE_COUNT, rng), _sample_surface(corners_m, _SAMPLE_COUNT, rng)
    area = np.linalg.norm(np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]), axis=1)
    mean = np.average(corners_m.mean(axis=1), axis=0, weights=area)[:2]
    centre = (float(mean[0]), float(mean[1]))
    radius = float(np.hypot(*(points[:, :2] - centre).T).max())
    tree = cKDTree(points)
    own = float(np.mean(tree.query(again)[0]))
    shift = math.hypot(*centre)
    if shift > _MAX_SHIFT_RADII * radius:
        return ShaftPosition((0.0, 0.0), 1)
    # The largest order is the number of blades: a rotor of 4 blades is also symmetric by half a turn.
    for blades in range(_MAX_BLADES, 1, -1):
        turned = again - [*centre, 0.0]
        c, s = math.cos(2.0 * math.pi / blades), math.sin(2.0 * math.pi / blades)
        turned = turned @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [*centre, 0.0]
        apart = tree.query(turned, distance_upper_bound=5.0 * _MAX_SYMMETRY_DISTANCE_RATIO * own)[0]
        if float(np.mean(np.minimum(apart, 1e3 * radius))) < _MAX_SYMMETRY_DISTANCE_RATIO * own:
            return ShaftPosition(centre if shift > _MIN_SHIFT_RADII * radius else (0.0, 0.0), blades)
    return ShaftPosition((0.0, 0.0), 1)


def count_blades(corners_m: Array) -> int:
    """Return the number of blades of a body about z: occupied intervals of azimuth, the median over rings."""
    rng = np.random.default_rng(0)
    x, y, _ = _sample_surface(corners_m, 10 * _SAMPLE_COUNT, rng).T
    share = np.hypot(x, y) / float(np.hypot(corners_m[..., 0], corners_m[..., 1]).max())
    counts = []
    for low, high in itertools.pairwise(_RING_EDGES_RADII):
        azimuth = np.arctan2(y, x)[(share >= low) & (share < high)]
        bins = np.unique(((azimuth / (2.0 * math.pi)) % 1.0 * _AZIMUTH_BINS).astype(np.int64))
        gaps = np.diff(np.append(bins, bins[:1] + _AZIMUTH_BINS))
        counts.append(int(np.sum(gaps > _MAX_AZIMUTH_GAP_BINS)) if bins.size else 0)
    return int(np.median(counts))
