"""Sections of a blade's mesh: quadrilaterals around, and inside, an aerofoil.

A section lies across the blade (x against the motion of the blade, z up, lengths in m). It has three parts::

    tensor   NX x NZ quadrilaterals of the whole section, less a centre block of n x m
    ring     between the centre block's edge and the aerofoil, 2 (n + m) x L quadrilaterals, crowded to the wall
    core     the n x m quadrilaterals inside the aerofoil's contour; where there is a blade they are left out

The contour has four sides as the core has: n cells along the upper side, m across the tail, n along the lower side, m
around the nose. All sections have the same quadrilaterals, so that a mesh is a stack of sections.

The ring's lines are cubic curves (Hermite): they leave the wall along its normal and arrive on the straight line.
On an edge with given sizes h0 and h1 of the first and last cell, points lie as in M. Vinokur, *On one-dimensional
stretching functions for finite-difference calculations*, J. Comput. Phys. 50 (1983) 215.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mufly.errors import InputError
from mufly.rotor import Airfoil, is_polar_file, load_airfoil

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NOSE_LENGTH = 0.02
"""Length of the contour (chords) on either side that the core's side at the nose takes."""
MIN_TAIL_THICKNESS = 0.006
"""Trailing edge over chord: a thinner one is opened to this (0.12 mm of 20 mm): it can be made and meshed."""


@dataclass(frozen=True)
class CellCounts:
    """Numbers of cells of a mesh.

    Attributes
    ----------
    along, across : int
        Along each side of the aerofoil (even); around its nose and across its tail (even).
    ring : int
        From the aerofoil to the edge of the centre block.
    side, above, below : int
        From there to the left and right, the top and the bottom.
    gap, blade, beyond : int
        Spanwise: axis to root, root to tip, beyond the tip.
    inner, outer : int
        From there, and from left and right, to the cylinder around the blade, and from that to the outer one.
    wall : float
        First cell on the blade, over the chord.
    tip : float
        Spanwise size of the first cell at the tip, over the radius.
    """

    along: int
    across: int
    ring: int
    side: int
    above: int
    below: int
    gap: int
    blade: int
    beyond: int
    inner: int
    outer: int
    wall: float
    tip: float


def vinokur_spacing(cells: int, first: float, last: float) -> Array:
    """Points on 0..1 with given sizes of the first and the last cell (Vinokur, 1983).

    Returns
    -------
    (cells + 1,) array
    """
    t = np.linspace(0.0, 1.0, cells + 1)
    a, b = math.sqrt(last / first), 1.0 / (cells * math.sqrt(first * last))
    if b > 1.0 + 1e-6:
        d = brentq(lambda d: math.sinh(d) / d - b, 1e-6, 60.0)
        u = 0.5 * (1.0 + np.tanh(d * (t - 0.5)) / math.tanh(0.5 * d))
    elif b < 1.0 - 1e-6:
        d = brentq(lambda d: math.sin(d) / d - b, 1e-6, math.pi - 1e-6)
        u = 0.5 * (1.0 + np.tan(d * (t - 0.5)) / math.tan(0.5 * d))
    else:
        u = t * (1.0 + 2.0 * (b - 1.0) * (t - 0.5) * (1.0 - t))
    return u / (a + (1.0 - a) * u)


def geometric_spacing(cells: int, first: float) -> Array:
    """Points on 0..1 whose cells grow by one ratio from the given first size; (cells + 1,) array."""
    if first * cells >= 1.0 - 1e-9:
        return np.linspace(0.0, 1.0, cells + 1)
    ratio = brentq(lambda q: first * (q**cells - 1.0) / (q - 1.0) - 1.0, 1.0 + 1e-9, 1e3)
    return np.asarray((ratio ** np.arange(cells + 1) - 1.0) / (ratio**cells - 1.0), dtype=np.float64)


def ring_contour(airfoil: Airfoil, counts: CellCounts) -> Array:
    """The contour's points as the ring meets them.

    Returns
    -------
    (2 (along + across), 2) array
        Over chord; from the upper corner of the nose over the upper side to the tail, down the tail, along the lower
        side to the nose and up around it.

    Raises
    ------
    InputError
        If the contour is too short for its nose.
    """
    n, m = counts.along, counts.across
    points = airfoil.coordinates
    nose = int(np.argmin(points[:, 0]))
    upper, lower = points[: nose + 1][::-1].copy(), points[nose:].copy()
    missing = max(0.0, MIN_TAIL_THICKNESS - float(np.linalg.norm(upper[-1] - lower[-1])))
    for side, sign in ((upper, 0.5), (lower, -0.5)):
        side[:, 1] += sign * missing * np.clip(side[:, 0], 0.0, 1.0)
    whole = np.concatenate((upper[::-1], lower[1:]))
    s = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(whole, axis=0), axis=1))))
    if not len(upper) > 4 < len(lower):
        raise InputError(airfoil.name, "", "has too few points at the nose", "give 20 points a side at least")
    from scipy.interpolate import PchipInterpolator

    # A contour of few points is drawn through by monotone cubics over the arc length, which do not overshoot.
    curve = PchipInterpolator(s, whole)
    at_nose = s[nose]
    tail = float(np.linalg.norm(whole[0] - whole[-1])) / m
    front = 2.0 * NOSE_LENGTH / m
    up, low = at_nose - NOSE_LENGTH, s[-1] - at_nose - NOSE_LENGTH
    top = at_nose - NOSE_LENGTH - up * vinokur_spacing(n, front / up, min(tail / up, 0.5 / n))
    bottom = at_nose + NOSE_LENGTH + low * vinokur_spacing(n, front / low, min(tail / low, 0.5 / n))
    base = whole[0] + np.linspace(0.0, 1.0, m + 1)[:, None] * (whole[-1] - whole[0])
    arc = curve(np.linspace(at_nose + NOSE_LENGTH, at_nose - NOSE_LENGTH, m + 1))
    return np.concatenate((curve(top)[:-1], base[:-1], curve(bottom)[::-1][:-1], arc[:-1]))


class SectionLayout:
    """Which points a section has and which quadrilaterals they make: the same for every section of a mesh.

    Points are numbered: the tensor's (without those inside the centre block), the ring's layers from the outside in
    (the first is the tensor's own), the core's inside.
    """

    def __init__(self, counts: CellCounts) -> None:
        self.counts = c = counts
        self.nx, self.nz = c.along + 2 * c.side, c.across + c.above + c.below
        i, j = np.meshgrid(np.arange(self.nx + 1), np.arange(self.nz + 1), indexing="ij")
        inside = (
            (i > c.side) & (i < c.side + c.along) & (j > c.below) & (j < c.below + c.across)
        )  # fmt: skip
        self.tensor_ids = np.full(i.shape, -1, dtype=np.int64)
        self.tensor_ids[~inside] = np.arange(int((~inside).sum()))
        around = np.array(self._core_edge_indices())
        edge = self.tensor_ids[c.side + around[:, 0], c.below + around[:, 1]]
        first = int((~inside).sum())
        layers = first + np.arange(c.ring * len(edge)).reshape(c.ring, len(edge))
        self.ring_ids = np.concatenate((edge[None], layers))
        self.core_ids = np.full((c.along + 1, c.across + 1), -1, dtype=np.int64)
        self.core_ids[around[:, 0], around[:, 1]] = self.ring_ids[-1]
        last = int(self.ring_ids[-1, -1]) + 1
        free = self.core_ids < 0
        self.core_ids[free] = last + np.arange(int(free.sum()))
        self.point_count = last + int(free.sum())

    def _core_edge_indices(self) -> list[tuple[int, int]]:
        """Indices of the core's edge in the order of :func:`ring_contour`."""
        n, m = self.counts.along, self.counts.across
        return (
            [(i, m) for i in range(n)]
            + [(n, j) for j in range(m, 0, -1)]
            + [(i, 0) for i in range(n, 0, -1)]
            + [(0, j) for j in range(m)]
        )

    @cached_property
    def outer_quads(self) -> Index:
        """Quadrilaterals of tensor and ring, (q, 4), anticlockwise in (x, z)."""
        c = self.counts
        t = self.tensor_ids
        quads = np.stack((t[:-1, :-1], t[1:, :-1], t[1:, 1:], t[:-1, 1:]), axis=-1)
        keep = np.ones(quads.shape[:2], dtype=bool)
        keep[c.side : c.side + c.along, c.below : c.below + c.across] = False
        r = np.concatenate((self.ring_ids, self.ring_ids[:, :1]), axis=1)
        # The ring runs clockwise and inwards.
        ring = np.stack((r[:-1, :-1], r[1:, :-1], r[1:, 1:], r[:-1, 1:]), axis=-1)
        return np.concatenate((quads[keep], ring.reshape(-1, 4)))

    @cached_property
    def core_quads(self) -> Index:
        """Quadrilaterals of the core, (n m, 4), anticlockwise."""
        k = self.core_ids
        return np.stack((k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]), axis=-1).reshape(-1, 4)


def interpolate_transfinite(edge: Array, along: int, across: int) -> Array:
    """Fill a four-sided loop, in the order of :func:`ring_contour`, by transfinite interpolation.

    Returns
    -------
    (along + 1, across + 1, 2) array
    """
    n, m = along, across
    closed = np.concatenate((edge, edge[:1]))
    top, right = closed[: n + 1], closed[n : n + m + 1][::-1]
    bottom, left = closed[n + m : 2 * n + m + 1][::-1], closed[2 * n + m :]
    # The lines follow the edges' own spacing: the mean of the two opposite ones.
    u = 0.5 * (_arc_length_fraction(top) + _arc_length_fraction(bottom))[:, None, None]
    v = 0.5 * (_arc_length_fraction(left) + _arc_length_fraction(right))[None, :, None]
    return (
        (1 - v) * bottom[:, None] + v * top[:, None] + (1 - u) * left[None] + u * right[None]
        - (1 - u) * (1 - v) * bottom[0] - u * (1 - v) * bottom[-1] - (1 - u) * v * top[0] - u * v * top[-1]
    )  # fmt: skip


def _arc_length_fraction(line: Array) -> Array:
    s = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    return s / s[-1]


def _rotate_nose_up(points: Array, angle: float) -> Array:
    """Nose up about the origin: x aft, z up."""
    c, s = math.cos(angle), math.sin(angle)
    return np.stack((c * points[..., 0] + s * points[..., 1], -s * points[..., 0] + c * points[..., 1]), axis=-1)


@dataclass(frozen=True)
class SectionBox:
    """Limits of the sections (m): half width, top, bottom (below 0).

    From ``level_height_m`` above the disc upwards, and as far below it downwards, lines are level: the same for all
    sections.
    """

    half_width_m: float
    top_m: float
    bottom_m: float
    level_height_m: float


@dataclass(frozen=True, eq=False)
class SectionShape:
    """One section.

    Attributes
    ----------
    contour_ratio : (2 (n + m), 2) array
        Contour over chord, the quarter chord at (0, 0).
    chord_m, angle_rad : float
        Chord; its angle to the disc, nose up.
    axis_share : float
        0 at the blade; 1 on the axis, where the section is its own mirror image and nothing is crowded.
    block_half_size_m, core_half_size_m : two float
        There: half width and half height of the centre block, and of the core in it.
    ring_relaxation : float
        0 where the ring is crowded to the wall, 1 where it is even.
    typical_chord_m : float
        Chord that sizes the cells outside the centre block: one for all sections.
    gurney_layer, plate_layer : (float, int)
        Height over chord and layer of the ring (from the wall) of the edge of a plate below the tail, and of one above
        and below the blade: the layer lies at that height. (0, 0) for none.
    has_level_block : bool
        Whether the centre block is ``block_half_size_m`` in every section, level and its own mirror image, so that a
        second rotor's sections can join it close below or above.
    """

    contour_ratio: Array
    chord_m: float
    angle_rad: float
    axis_share: float
    block_half_size_m: tuple[float, float]
    core_half_size_m: tuple[float, float]
    ring_relaxation: float
    typical_chord_m: float
    gurney_layer: tuple[float, int] = (0.0, 0)
    plate_layer: tuple[float, int] = (0.0, 0)
    has_level_block: bool = False


BLOCK_MARGIN_CHORDS, BLOCK_HALF_HEIGHT_CHORDS = 0.40, 0.45
_NORMAL_SMOOTHING_PASSES = 6
_FLAP_LEAN_FACTOR = 0.5
_SIDE_STRETCHING = 0.2
"""Margin of the centre block before nose and behind tail, and its half height, in chords."""


def compute_section_points(layout: SectionLayout, shape: SectionShape, box: SectionBox) -> Array:
    """Coordinates of a section's points.

    Returns
    -------
    (points, 2) array
        x and z (m).
    """
    k, c, g = layout.counts, shape.chord_m, shape.axis_share
    n, m = k.along, k.across
    # The contour, and the centre block before it is turned: blade, and plain (its own mirror image in x).
    loop = _rotate_nose_up(c * shape.contour_ratio, shape.angle_rad)
    (half, high), (wide, thick) = shape.block_half_size_m, shape.core_half_size_m
    plain = _rectangle_points(-wide, wide, -thick, thick, n, m)
    loop = (1 - g) * loop + g * plain
    low, right = -(0.25 + BLOCK_MARGIN_CHORDS) * c, (0.75 + BLOCK_MARGIN_CHORDS) * c
    whole = 1.0 if shape.has_level_block else g  # how far the block is that of the axis
    even = np.linspace(0.0, 1.0, n + 1)
    crowd = np.concatenate((shape.contour_ratio[:n, 0], shape.contour_ratio[n : n + 1, 0]))
    crowd = (crowd - crowd[0]) / (crowd[-1] - crowd[0])
    spread = (1 - g) * (0.65 * even + 0.35 * crowd) + g * even
    wider = 2 * even - 1
    if shape.has_level_block:  # the blade lies behind its middle: wider cells to the sides slant the ring less
        wider = (1.0 - _SIDE_STRETCHING) * wider + _SIDE_STRETCHING * wider**3
    x_in = (1 - whole) * (low + (right - low) * spread) + whole * half * wider
    tall = (1 - whole) * BLOCK_HALF_HEIGHT_CHORDS * c + whole * high
    z_in = tall * np.linspace(-1.0, 1.0, m + 1)
    # Lines of the tensor.
    wide_l, wide_r = box.half_width_m + x_in[0], box.half_width_m - x_in[-1]
    aside, above, below = _compute_outer_lines(
        k,
        shape.typical_chord_m,
        high if shape.has_level_block else BLOCK_HALF_HEIGHT_CHORDS * shape.typical_chord_m,
        box,
    )
    x = np.concatenate((x_in[0] - wide_l * aside[::-1], x_in[1:-1], x_in[-1] + wide_r * aside))
    own = (tall - above[0]) * _smooth_fade((above - above[0]) / (box.level_height_m - above[0]))
    own_below = (tall + below[0]) * _smooth_fade((below[0] - below) / (box.level_height_m + below[0]))
    z = np.concatenate(((below - own_below)[::-1], z_in[1:-1], above + own))
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
    # The centre block is turned with the blade; what surrounds it follows, less with distance.
    near = np.stack((np.clip(grid[..., 0], x_in[0], x_in[-1]), np.clip(grid[..., 1], -tall, tall)), axis=-1)
    away = np.abs(grid - near)
    reach_x = np.where(grid[..., 0] < 0, wide_l, wide_r)
    follow = _smooth_fade(away[..., 0] / reach_x) * _smooth_fade(away[..., 1] / min(4.0 * c, box.level_height_m - tall))
    grid = grid + follow[..., None] * (_rotate_nose_up(near, (1 - whole) * shape.angle_rad) - near)

    out = np.full((layout.point_count, 2), np.nan)
    on = layout.tensor_ids >= 0
    out[layout.tensor_ids[on]] = grid[on]
    out[layout.ring_ids] = _compute_ring_layers(loop, out[layout.ring_ids[0]], shape, k)
    core = interpolate_transfinite(loop, n, m)
    out[layout.core_ids] = core
    return out


def _compute_outer_lines(k: CellCounts, chord_m: float, high: float, box: SectionBox) -> tuple[Array, Array, Array]:
    """Lines from the centre block (half as high as ``high``) of a typical section, outwards: to the sides (0..1), above
    and below (z, m).

    They are one set for all sections: where the chord changes, lines of its own would slant the cells far away from it.
    """
    wide = box.half_width_m - (0.75 + BLOCK_MARGIN_CHORDS) * chord_m
    step = min(max((1 + 2 * BLOCK_MARGIN_CHORDS) * chord_m / k.along, 0.02 * wide), 0.9 * wide / k.side)
    dz = 2 * high / k.across
    up, down = box.top_m - high, -box.bottom_m - high
    return (
        geometric_spacing(k.side, step / wide),
        high + up * geometric_spacing(k.above, dz / up),
        -high - down * geometric_spacing(k.below, dz / down),
    )


def _rectangle_points(x0: float, x1: float, z0: float, z1: float, n: int, m: int) -> Array:
    u, v = np.linspace(0, 1, n + 1)[:-1], np.linspace(0, 1, m + 1)[:-1]
    x = np.concatenate((x0 + u * (x1 - x0), np.full(m, x1), x1 - u * (x1 - x0), np.full(m, x0)))
    z = np.concatenate((np.full(n, z1), z1 - v * (z1 - z0), np.full(n, z0), z0 + v * (z1 - z0)))
    return np.stack((x, z), axis=-1)


def _smooth_fade(t: Array) -> Array:
    u = np.clip(t, 0.0, 1.0)
    return (1.0 - u) ** 2 * (1.0 + 2.0 * u)


def _compute_ring_layers(loop: Array, edge: Array, shape: SectionShape, counts: CellCounts) -> Array:
    """The ring's layers, (ring + 1, 2 (n + m), 2), from the centre block's edge to the contour."""
    before, after = np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0)
    # The loop runs clockwise: its outward normal is the tangent turned to the left. Corners take the mean of both.
    tangents = [b / np.linalg.norm(b, axis=1, keepdims=True) for b in (loop - before, after - loop)]
    tangent = tangents[0] + tangents[1]
    normal = np.stack((-tangent[:, 1], tangent[:, 0]), axis=-1)
    corner = counts.along + counts.across
    # At the tail's corners neighbouring lines would part at 45 degrees; they turn there over a few points instead.
    for _ in range(_NORMAL_SMOOTHING_PASSES):
        normal = 0.25 * np.roll(normal, 1, axis=0) + 0.5 * normal + 0.25 * np.roll(normal, -1, axis=0)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if shape.gurney_layer[1] and not shape.axis_share:
        # Not beside the blade, where sections change fast: above a hub it would slant the cells to 87 degrees.
        normal = _turn_normals_around_flap(normal, loop, shape, counts)
    across = edge - loop
    far = np.linalg.norm(across, axis=1, keepdims=True)
    first = counts.wall * shape.chord_m / (BLOCK_HALF_HEIGHT_CHORDS * shape.chord_m)
    t = geometric_spacing(counts.ring, first)
    reach = shape.gurney_layer[0] * shape.chord_m / float(far[corner, 0])
    for (height, layer), line in ((shape.gurney_layer, corner), (shape.plate_layer, counts.along // 2)):
        if layer:
            drawn = _stretch_through_value(t, layer, height * shape.chord_m / float(far[line, 0]))
            t = (1 - shape.axis_share) * drawn + shape.axis_share * t
    t = (1 - shape.ring_relaxation) * t + shape.ring_relaxation * np.linspace(0, 1, counts.ring + 1)
    # A plate is plane: the lines stay on the wall's normal as far as it reaches, and bend from there.
    straight = (1 - shape.axis_share) * reach if shape.gurney_layer[1] else 0.0
    begin, leave = loop + straight * far * normal, (1.0 - straight) * far * normal
    u = np.maximum(t[::-1, None, None] - straight, 0.0) / (1.0 - straight)
    within = np.minimum(t[::-1, None, None] - straight, 0.0)
    return (
        (2 * u**3 - 3 * u**2 + 1) * begin
        + (u**3 - 2 * u**2 + u) * leave
        + (3 * u**2 - 2 * u**3) * edge
        + (u**3 - u**2) * (edge - begin)
        + within * far * normal
    )


def _turn_normals_around_flap(normal: Array, loop: Array, shape: SectionShape, counts: CellCounts) -> Array:
    """Directions in which the ring's lines leave a contour with a plate below its tail's lower corner.

    There the line runs along the plate, square to the chord; those ahead of it join it over 0.3 chords and lean away
    from it a little, as lines that lean together would cross; those of the tail fan out between it and the tail's
    upper corner.
    """
    n, corner = counts.along, counts.along + counts.across
    out, (down, ahead) = normal.copy(), _rotate_nose_up(np.array([[0.0, -1.0], [-1.0, 0.0]]), shape.angle_rad)
    off = np.linalg.norm(loop[corner : corner + n] - loop[corner], axis=1) / (0.3 * shape.chord_m)
    w = _smooth_fade(off)[:, None]
    lean = _FLAP_LEAN_FACTOR * (w * (1 - np.exp(-off / 0.05)[:, None]))
    out[corner : corner + n] = (1 - w) * normal[corner : corner + n] + w * down + lean * ahead
    begin, end = math.atan2(normal[n, 1], normal[n, 0]), math.atan2(down[1], down[0])
    angle = np.linspace(begin, end if end < begin else end - 2.0 * math.pi, corner - n + 1)
    out[n : corner + 1] = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def _stretch_through_value(t: Array, layer: int, value: float) -> Array:
    """Points on 0..1, rising, drawn so that one of them lies at a value."""
    return np.where(t <= t[layer], t * (value / t[layer]), 1.0 - (1.0 - t) * ((1.0 - value) / (1.0 - t[layer])))


def layer_at_height(counts: CellCounts, height: float, far: float) -> int:
    """Layers of the ring, from the wall, nearest to a height (chords) where the ring is so far across (chords)."""
    t = geometric_spacing(counts.ring, counts.wall / BLOCK_HALF_HEIGHT_CHORDS)[1:-2]
    return 1 + int(np.argmin(np.abs(np.log(t * far / height))))


def load_meshable_airfoil(airfoil_name: str) -> Any:
    """The airfoil, if it has a contour.

    Raises
    ------
    InputError
        If it is a table of coefficients.
    """
    if is_polar_file(airfoil_name):
        raise InputError(
            airfoil_name, "", "is a table of coefficients, without a contour to mesh",
            "give the rotor an airfoil by name or as a .dat file",
        )  # fmt: skip
    return load_airfoil(airfoil_name)
