"""Two-dimensional meshes of blade sections: quadrilaterals around and inside an aerofoil.

A section is normal to the blade (x against the motion of the blade, z up, lengths in m). It has three parts::

    tensor   NX x NZ quadrilaterals of the whole section, without a centre block of n x m
    ring     2 (n + m) x L quadrilaterals between the centre block's edge and the aerofoil, refined towards the wall
    core     n x m quadrilaterals inside the aerofoil's contour, left out where there is a blade

Contour and core have four sides: n cells along the upper side, m across the tail, n along the lower side, m around the
nose. All sections have the same topology, so that a mesh is a stack of sections.

The ring's lines are cubic Hermite curves that leave the wall along its normal and end at the centre block's edge. On an
edge with given sizes h0 and h1 of the first and last cell, points lie as in M. Vinokur, *On one-dimensional stretching
functions for finite-difference calculations*, J. Comput. Phys. 50 (1983) 215.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mufly.cfd.meshes.blade_geometry import fade_out_cubic
from mufly.errors import InputError
from mufly.rotor import Airfoil, is_polar_file, load_airfoil

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CORE_NOSE_ARC_CHORDS = 0.02
"""Length of the contour (chords) on either side that belongs to the core's nose side."""
MIN_TAIL_THICKNESS_CHORDS = 0.006
"""Least trailing edge thickness over chord (0.12 mm of 20 mm), which can be made and meshed; thinner edges are
opened."""


@dataclass(frozen=True)
class CellCounts:
    """Numbers and sizes of the cells of a mesh.

    Attributes
    ----------
    aerofoil_side, nose_and_tail : int
        Cells along each side of the aerofoil (even); around its nose and across its tail (even).
    aerofoil_to_block_edge : int
        Cells from the aerofoil to the edge of the centre block.
    block_to_side, block_to_top, block_to_bottom : int
        Cells from the centre block to the left and right, to the top and to the bottom.
    axis_to_root, root_to_tip, beyond_tip : int
        Spanwise cells: axis to root, root to tip, beyond the tip.
    box_to_cylinder, cylinder_to_boundary : int
        Cells from the box to the cylinder around the blade, and from that cylinder to the outer one.
    wall_cell_chords : float
        Height of the first cell on the blade, over the chord.
    tip_cell_radii : float
        Spanwise size of the first cell at the tip, over the radius.
    """

    aerofoil_side: int
    nose_and_tail: int
    aerofoil_to_block_edge: int
    block_to_side: int
    block_to_top: int
    block_to_bottom: int
    axis_to_root: int
    root_to_tip: int
    beyond_tip: int
    box_to_cylinder: int
    cylinder_to_boundary: int
    wall_cell_chords: float
    tip_cell_radii: float


def make_vinokur_spacing(cells: int, first: float, last: float) -> Array:
    """Return points on 0..1 with given sizes of the first and the last cell (Vinokur, 1983).

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


def make_geometric_spacing(cells: int, first: float) -> Array:
    """Return points on 0..1 whose cells grow by a constant ratio from the first size; (cells + 1,) array."""
    if first * cells >= 1.0 - 1e-9:
        return np.linspace(0.0, 1.0, cells + 1)
    ratio = brentq(lambda q: first * (q**cells - 1.0) / (q - 1.0) - 1.0, 1.0 + 1e-9, 1e3)
    return np.asarray((ratio ** np.arange(cells + 1) - 1.0) / (ratio**cells - 1.0), dtype=np.float64)


def make_ring_contour(airfoil: Airfoil, counts: CellCounts) -> Array:
    """Return the points of the aerofoil's contour at which the mesh lines of the cells around it (the ring) begin.

    Returns
    -------
    (2 (n + m), 2) array
        Coordinates over chord, from the upper corner of the nose over the upper side to the tail, down the tail, along
        the lower side to the nose and up around it.

    Raises
    ------
    InputError
        If the contour is too short for its nose.
    """
    n, m = counts.aerofoil_side, counts.nose_and_tail
    points = airfoil.coordinates
    nose = int(np.argmin(points[:, 0]))
    upper, lower = points[: nose + 1][::-1].copy(), points[nose:].copy()
    missing = max(0.0, MIN_TAIL_THICKNESS_CHORDS - float(np.linalg.norm(upper[-1] - lower[-1])))
    for side, sign in ((upper, 0.5), (lower, -0.5)):
        side[:, 1] += sign * missing * np.clip(side[:, 0], 0.0, 1.0)
    whole = np.concatenate((upper[::-1], lower[1:]))
    s = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(whole, axis=0), axis=1))))
    if not len(upper) > 4 < len(lower):
        raise InputError(airfoil.name, "", "has too few points at the nose", "give 20 points a side at least")
    from scipy.interpolate import PchipInterpolator

    # Contours of few points are interpolated by monotone cubics over the arc length, which do not overshoot.
    curve = PchipInterpolator(s, whole)
    at_nose = s[nose]
    tail = float(np.linalg.norm(whole[0] - whole[-1])) / m
    front = 2.0 * CORE_NOSE_ARC_CHORDS / m
    up, low = at_nose - CORE_NOSE_ARC_CHORDS, s[-1] - at_nose - CORE_NOSE_ARC_CHORDS
    top = at_nose - CORE_NOSE_ARC_CHORDS - up * make_vinokur_spacing(n, front / up, min(tail / up, 0.5 / n))
    bottom = at_nose + CORE_NOSE_ARC_CHORDS + low * make_vinokur_spacing(n, front / low, min(tail / low, 0.5 / n))
    base = whole[0] + np.linspace(0.0, 1.0, m + 1)[:, None] * (whole[-1] - whole[0])
    arc = curve(np.linspace(at_nose + CORE_NOSE_ARC_CHORDS, at_nose - CORE_NOSE_ARC_CHORDS, m + 1))
    return np.concatenate((curve(top)[:-1], base[:-1], curve(bottom)[::-1][:-1], arc[:-1]))


class SectionLayout:
    """Topology of a section: point numbers and quadrilaterals, the same for every section of a mesh.

    The order of points is: tensor (without those inside the centre block), layers of the ring from the outside inwards
    (the first layer is part of the tensor), interior of the core.
    """

    def __init__(self, counts: CellCounts) -> None:
        self.counts = c = counts
        self.nx, self.nz = c.aerofoil_side + 2 * c.block_to_side, c.nose_and_tail + c.block_to_top + c.block_to_bottom
        i, j = np.meshgrid(np.arange(self.nx + 1), np.arange(self.nz + 1), indexing="ij")
        inside = (
            (i > c.block_to_side)
            & (i < c.block_to_side + c.aerofoil_side)
            & (j > c.block_to_bottom)
            & (j < c.block_to_bottom + c.nose_and_tail)
        )  # fmt: skip
        self.tensor_ids = np.full(i.shape, -1, dtype=np.int64)
        self.tensor_ids[~inside] = np.arange(int((~inside).sum()))
        around = np.array(self._core_edge_indices())
        edge = self.tensor_ids[c.block_to_side + around[:, 0], c.block_to_bottom + around[:, 1]]
        first = int((~inside).sum())
        layers = first + np.arange(c.aerofoil_to_block_edge * len(edge)).reshape(c.aerofoil_to_block_edge, len(edge))
        self.ring_ids = np.concatenate((edge[None], layers))
        self.core_ids = np.full((c.aerofoil_side + 1, c.nose_and_tail + 1), -1, dtype=np.int64)
        self.core_ids[around[:, 0], around[:, 1]] = self.ring_ids[-1]
        last = int(self.ring_ids[-1, -1]) + 1
        free = self.core_ids < 0
        self.core_ids[free] = last + np.arange(int(free.sum()))
        self.point_count = last + int(free.sum())

    def _core_edge_indices(self) -> list[tuple[int, int]]:
        """Return the indices of the points on the edge of the block inside the aerofoil (the core), in the order of
        :func:`make_ring_contour`.
        """
        n, m = self.counts.aerofoil_side, self.counts.nose_and_tail
        return (
            [(i, m) for i in range(n)]
            + [(n, j) for j in range(m, 0, -1)]
            + [(i, 0) for i in range(n, 0, -1)]
            + [(0, j) for j in range(m)]
        )

    @cached_property
    def outer_quads(self) -> Index:
        """Return the quadrilaterals outside the aerofoil, those around it (ring) and those further away (tensor),
        (q, 4), anticlockwise in (x, z).
        """
        c = self.counts
        t = self.tensor_ids
        quads = np.stack((t[:-1, :-1], t[1:, :-1], t[1:, 1:], t[:-1, 1:]), axis=-1)
        keep = np.ones(quads.shape[:2], dtype=bool)
        keep[
            c.block_to_side : c.block_to_side + c.aerofoil_side, c.block_to_bottom : c.block_to_bottom + c.nose_and_tail
        ] = False
        r = np.concatenate((self.ring_ids, self.ring_ids[:, :1]), axis=1)
        # The ring runs clockwise and inwards.
        ring = np.stack((r[:-1, :-1], r[1:, :-1], r[1:, 1:], r[:-1, 1:]), axis=-1)
        return np.concatenate((quads[keep], ring.reshape(-1, 4)))

    @cached_property
    def core_quads(self) -> Index:
        """Return the quadrilaterals inside the aerofoil's contour (core), (n m, 4), anticlockwise."""
        k = self.core_ids
        return np.stack((k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]), axis=-1).reshape(-1, 4)


def interpolate_transfinite(edge: Array, along: int, across: int) -> Array:
    """Return a grid of points inside a four-sided loop, by transfinite interpolation.

    The points ``edge`` of the loop are in the order of :func:`make_ring_contour`.

    Returns
    -------
    (along + 1, across + 1, 2) array
    """
    n, m = along, across
    closed = np.concatenate((edge, edge[:1]))
    top, right = closed[: n + 1], closed[n : n + m + 1][::-1]
    bottom, left = closed[n + m : 2 * n + m + 1][::-1], closed[2 * n + m :]
    # The spacing of the lines is the mean of the two opposite edges.
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
    """Rotate nose up about the origin: x aft, z up."""
    c, s = math.cos(angle), math.sin(angle)
    return np.stack((c * points[..., 0] + s * points[..., 1], -s * points[..., 0] + c * points[..., 1]), axis=-1)


@dataclass(frozen=True)
class SectionBox:
    """Limits of the plane that is meshed in every section (m): half width, top, and bottom (a negative height).

    Lines further than ``level_height_m`` above or below the disc are horizontal and the same for all sections.
    """

    half_width_m: float
    top_m: float
    bottom_m: float
    level_height_m: float


@dataclass(frozen=True, eq=False)
class SectionShape:
    """Aerofoil of one section of the blade, and sizes of the mesh blocks around and inside it.

    Attributes
    ----------
    contour_ratio : (2 (n + m), 2) array
        Contour over chord, the quarter chord at (0, 0).
    chord_m, angle_rad : float
        Chord, and its angle to the disc, nose up.
    axis_blend : float
        0 at the blade; 1 on the axis, where the section is mirror symmetric without refinement.
    block_half_size_m, core_half_size_m : two float
        Half width and half height of the centre block, and of its core, on the axis.
    ring_uniformity : float
        0 for a ring refined towards the wall, 1 for uniform spacing.
    typical_chord_m : float
        Chord that determines the size of cells outside the centre block, the same for all sections.
    gurney_layer, plate_layer : (float, int)
        Height over chord, and layer of the ring (from the wall) at that height, of the edge of a Gurney flap, and of a
        plate above and below the blade; (0, 0) for none.
    has_level_block : bool
        True if the centre block has ``block_half_size_m`` in every section, horizontal and mirror symmetric, so that
        the sections of a second rotor can join it.
    """

    contour_ratio: Array
    chord_m: float
    angle_rad: float
    axis_blend: float
    block_half_size_m: tuple[float, float]
    core_half_size_m: tuple[float, float]
    ring_uniformity: float
    typical_chord_m: float
    gurney_layer: tuple[float, int] = (0.0, 0)
    plate_layer: tuple[float, int] = (0.0, 0)
    has_level_block: bool = False


CENTRE_BLOCK_MARGIN_CHORDS, CENTRE_BLOCK_HALF_HEIGHT_CHORDS = 0.40, 0.45
_NORMAL_SMOOTHING_PASSES = 6
_GURNEY_NORMAL_LEAN_FACTOR = 0.5
_SIDE_CELL_STRETCHING = 0.2
"""Margin of the centre block ahead of the nose and behind the tail, and its half height, in chords."""


def compute_section_points(layout: SectionLayout, shape: SectionShape, box: SectionBox) -> Array:
    """Compute the coordinates of a section's points.

    Returns
    -------
    (points, 2) array
        x and z (m).
    """
    k, c, g = layout.counts, shape.chord_m, shape.axis_blend
    n, m = k.aerofoil_side, k.nose_and_tail
    # The contour, and the centre block before it is turned: blade, and plain (its own mirror image in x).
    loop = _rotate_nose_up(c * shape.contour_ratio, shape.angle_rad)
    (half, high), (wide, thick) = shape.block_half_size_m, shape.core_half_size_m
    plain = _rectangle_points(-wide, wide, -thick, thick, n, m)
    loop = (1 - g) * loop + g * plain
    low, right = -(0.25 + CENTRE_BLOCK_MARGIN_CHORDS) * c, (0.75 + CENTRE_BLOCK_MARGIN_CHORDS) * c
    whole = 1.0 if shape.has_level_block else g  # fraction of the axis block in the block
    even = np.linspace(0.0, 1.0, n + 1)
    crowd = np.concatenate((shape.contour_ratio[:n, 0], shape.contour_ratio[n : n + 1, 0]))
    crowd = (crowd - crowd[0]) / (crowd[-1] - crowd[0])
    spread = (1 - g) * (0.65 * even + 0.35 * crowd) + g * even
    wider = 2 * even - 1
    if shape.has_level_block:  # the blade lies behind its middle: wider cells to the sides slant the ring less
        wider = (1.0 - _SIDE_CELL_STRETCHING) * wider + _SIDE_CELL_STRETCHING * wider**3
    x_in = (1 - whole) * (low + (right - low) * spread) + whole * half * wider
    tall = (1 - whole) * CENTRE_BLOCK_HALF_HEIGHT_CHORDS * c + whole * high
    z_in = tall * np.linspace(-1.0, 1.0, m + 1)
    # Lines of the tensor.
    wide_l, wide_r = box.half_width_m + x_in[0], box.half_width_m - x_in[-1]
    aside, above, below = _compute_outer_lines(
        k,
        shape.typical_chord_m,
        high if shape.has_level_block else CENTRE_BLOCK_HALF_HEIGHT_CHORDS * shape.typical_chord_m,
        box,
    )
    x = np.concatenate((x_in[0] - wide_l * aside[::-1], x_in[1:-1], x_in[-1] + wide_r * aside))
    own = (tall - above[0]) * fade_out_cubic((above - above[0]) / (box.level_height_m - above[0]))
    own_below = (tall + below[0]) * fade_out_cubic((below[0] - below) / (box.level_height_m + below[0]))
    z = np.concatenate(((below - own_below)[::-1], z_in[1:-1], above + own))
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1)
    # The centre block is turned with the blade; what surrounds it follows, less with distance.
    near = np.stack((np.clip(grid[..., 0], x_in[0], x_in[-1]), np.clip(grid[..., 1], -tall, tall)), axis=-1)
    away = np.abs(grid - near)
    reach_x = np.where(grid[..., 0] < 0, wide_l, wide_r)
    follow = fade_out_cubic(away[..., 0] / reach_x) * fade_out_cubic(
        away[..., 1] / min(4.0 * c, box.level_height_m - tall)
    )
    grid = grid + follow[..., None] * (_rotate_nose_up(near, (1 - whole) * shape.angle_rad) - near)

    out = np.full((layout.point_count, 2), np.nan)
    on = layout.tensor_ids >= 0
    out[layout.tensor_ids[on]] = grid[on]
    out[layout.ring_ids] = _compute_ring_layers(loop, out[layout.ring_ids[0]], shape, k)
    core = interpolate_transfinite(loop, n, m)
    out[layout.core_ids] = core
    return out


def _compute_outer_lines(k: CellCounts, chord_m: float, high: float, box: SectionBox) -> tuple[Array, Array, Array]:
    """Return the positions of the mesh lines beside the centre block (fraction 0..1), above and below it (z, m).

    The centre block contains the aerofoil and has the half height ``high``.

    All sections share the lines: lines that follow the local chord would skew distant cells.
    """
    wide = box.half_width_m - (0.75 + CENTRE_BLOCK_MARGIN_CHORDS) * chord_m
    step = min(
        max((1 + 2 * CENTRE_BLOCK_MARGIN_CHORDS) * chord_m / k.aerofoil_side, 0.02 * wide), 0.9 * wide / k.block_to_side
    )
    dz = 2 * high / k.nose_and_tail
    up, down = box.top_m - high, -box.bottom_m - high
    return (
        make_geometric_spacing(k.block_to_side, step / wide),
        high + up * make_geometric_spacing(k.block_to_top, dz / up),
        -high - down * make_geometric_spacing(k.block_to_bottom, dz / down),
    )


def _rectangle_points(x0: float, x1: float, z0: float, z1: float, n: int, m: int) -> Array:
    u, v = np.linspace(0, 1, n + 1)[:-1], np.linspace(0, 1, m + 1)[:-1]
    x = np.concatenate((x0 + u * (x1 - x0), np.full(m, x1), x1 - u * (x1 - x0), np.full(m, x0)))
    z = np.concatenate((np.full(n, z1), z1 - v * (z1 - z0), np.full(n, z0), z0 + v * (z1 - z0)))
    return np.stack((x, z), axis=-1)


def _compute_ring_layers(loop: Array, edge: Array, shape: SectionShape, counts: CellCounts) -> Array:
    """Return the points of the layers of cells around the aerofoil (the ring), from the centre block's edge to the
    contour, (layers + 1, 2 (n + m), 2).
    """
    before, after = np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0)
    # The loop runs clockwise: its outward normal is the tangent rotated to the left. Corners have the mean normal.
    tangents = [b / np.linalg.norm(b, axis=1, keepdims=True) for b in (loop - before, after - loop)]
    tangent = tangents[0] + tangents[1]
    normal = np.stack((-tangent[:, 1], tangent[:, 0]), axis=-1)
    corner = counts.aerofoil_side + counts.nose_and_tail
    # At the tail's corners neighbouring lines would diverge by 45 degrees; the change is spread over a few points.
    for _ in range(_NORMAL_SMOOTHING_PASSES):
        normal = 0.25 * np.roll(normal, 1, axis=0) + 0.5 * normal + 0.25 * np.roll(normal, -1, axis=0)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    if shape.gurney_layer[1] and not shape.axis_blend:
        # Only at the blade: near a hub, where sections change fast, it would skew the cells to 87 degrees.
        normal = _turn_normals_around_flap(normal, loop, shape, counts)
    across = edge - loop
    far = np.linalg.norm(across, axis=1, keepdims=True)
    first = counts.wall_cell_chords * shape.chord_m / (CENTRE_BLOCK_HALF_HEIGHT_CHORDS * shape.chord_m)
    t = make_geometric_spacing(counts.aerofoil_to_block_edge, first)
    reach = shape.gurney_layer[0] * shape.chord_m / float(far[corner, 0])
    for (height, layer), line in ((shape.gurney_layer, corner), (shape.plate_layer, counts.aerofoil_side // 2)):
        if layer:
            drawn = _stretch_through_value(t, layer, height * shape.chord_m / float(far[line, 0]))
            t = (1 - shape.axis_blend) * drawn + shape.axis_blend * t
    t = (1 - shape.ring_uniformity) * t + shape.ring_uniformity * np.linspace(0, 1, counts.aerofoil_to_block_edge + 1)
    # A plate is plane: the lines follow the wall's normal up to its edge and bend beyond.
    straight = (1 - shape.axis_blend) * reach if shape.gurney_layer[1] else 0.0
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
    """Return the directions in which the ring's mesh lines leave a contour with a Gurney flap.

    At that corner the line follows the flap, normal to the chord. Ahead of it the directions change gradually over 0.3
    chords and diverge slightly, because converging lines would cross. Lines of the tail fan out between the flap and
    the tail's upper corner.
    """
    n, corner = counts.aerofoil_side, counts.aerofoil_side + counts.nose_and_tail
    out, (down, ahead) = normal.copy(), _rotate_nose_up(np.array([[0.0, -1.0], [-1.0, 0.0]]), shape.angle_rad)
    off = np.linalg.norm(loop[corner : corner + n] - loop[corner], axis=1) / (0.3 * shape.chord_m)
    w = fade_out_cubic(off)[:, None]
    lean = _GURNEY_NORMAL_LEAN_FACTOR * (w * (1 - np.exp(-off / 0.05)[:, None]))
    out[corner : corner + n] = (1 - w) * normal[corner : corner + n] + w * down + lean * ahead
    begin, end = math.atan2(normal[n, 1], normal[n, 0]), math.atan2(down[1], down[0])
    angle = np.linspace(begin, end if end < begin else end - 2.0 * math.pi, corner - n + 1)
    out[n : corner + 1] = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def _stretch_through_value(t: Array, layer: int, value: float) -> Array:
    """Stretch increasing points on 0..1 so that the point with index ``layer`` lies at ``value``."""
    return np.where(t <= t[layer], t * (value / t[layer]), 1.0 - (1.0 - t) * ((1.0 - value) / (1.0 - t[layer])))


def find_ring_layer_at_height(counts: CellCounts, height: float, far: float) -> int:
    """Return the layer of cells around the aerofoil, counted from the wall, that is nearest to a ``height``; all layers
    together are ``far`` thick (both in chords).
    """
    t = make_geometric_spacing(
        counts.aerofoil_to_block_edge, counts.wall_cell_chords / CENTRE_BLOCK_HALF_HEIGHT_CHORDS
    )[1:-2]
    return 1 + int(np.argmin(np.abs(np.log(t * far / height))))


def load_meshable_airfoil(airfoil_name: str) -> Any:
    """Load an airfoil that has a contour.

    Raises
    ------
    InputError
        If the airfoil is a polar without contour.
    """
    if is_polar_file(airfoil_name):
        raise InputError(
            airfoil_name, "", "is a table of coefficients, without a contour to mesh",
            "give the rotor an airfoil by name or as a .dat file",
        )  # fmt: skip
    return load_airfoil(airfoil_name)
