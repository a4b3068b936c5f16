r"""Mesh of the sector of one blade: sections stacked along the blade, within a cylinder.

Frame: z up along the shaft, the blade along +y, x against its motion (nose at negative x); the rotor turns about +z. A
rotor of N blades is meshed as a sector of 2 pi / N with one blade, between two planes through the shaft. Each plane is
the image of the other in x, point by point, so that plain cyclic boundaries suffice.

Section k is bent; the first section lies in those planes, the section at the tip is plane::

    y = y_k + f_k (sqrt(y_k^2 + (|x| cot(pi/N))^2) - y_k)          two blades: y = y_k;  f_k from 1 at the root to 0

In plan view the sections fill a box, from the shaft to beyond the tip. From its three free sides lines fan out to a
cylinder around it and on, radially, to the outer cylinder: ``wings`` to the left and right, the last sections
themselves beyond the tip::

              ______________
            /   \  tip   /   \        outer cylinder
           /     |______|     \
          | wing |  ||  | wing |
          |______|__||__|______|      the two periodic planes, or one plane of a two-bladed rotor

Air within the inner cylinder, up to a horizontal plane above the disc and down to the bottom, is computed in the
blade's frame, all other air in a frame at rest (``is_rotating``). The interfaces are surfaces of revolution, so that
the rotation of the frame causes no flux through them. In the blade's frame air at rest moves at Omega r. A horizontal
velocity such as the inflow u_r is turned by convection, which has to balance the Coriolis force. The error of this
balance in a second-order mesh, 0.3 to 0.9 % of Omega u_r, acts as a force against the sense of rotation. If the slow
outer inflow were in the rotating frame, the swirl would be a tenth of the induced velocity and the error of thrust 4 %.

Between shaft and root the section changes from that of the blade to a mirror symmetric one. With a hub the core of
these sections is left out, too. Its half width is that of the hub, sqrt(r^2 - y^2), out to 0.4 r; from there the hub
continues into the root or ends.

Plates (Gurney flaps, tip plates) have no thickness: they are internal faces that become walls on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.meshes.blade_geometry import BladeGeometry, compute_blade_line, compute_blade_line_length, place_sections
from mufly.cfd.meshes.section_mesh import (
    CENTRE_BLOCK_HALF_HEIGHT_CHORDS,
    CENTRE_BLOCK_MARGIN_CHORDS,
    CellCounts,
    SectionBox,
    SectionLayout,
    SectionShape,
    compute_section_points,
    find_ring_layer_at_height,
    load_meshable_airfoil,
    make_geometric_spacing,
    make_ring_contour,
    make_vinokur_spacing,
)
from mufly.errors import InputError
from mufly.rotor import Rotor

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_MEDIUM_CELL_COUNTS = CellCounts(
    aerofoil_side=34, nose_and_tail=8, aerofoil_to_block_edge=16, block_to_side=8, block_to_top=11, block_to_bottom=14,
    axis_to_root=6, root_to_tip=20, beyond_tip=6, box_to_cylinder=5, cylinder_to_boundary=4,
    wall_cell_chords=0.002, tip_cell_radii=0.0067,
)  # fmt: skip


def _scale_cell_counts(factor: float) -> CellCounts:
    numbers = {
        name: max(2, round(factor * getattr(_MEDIUM_CELL_COUNTS, name)))
        for name in (
            "aerofoil_to_block_edge",
            "block_to_side",
            "block_to_top",
            "block_to_bottom",
            "axis_to_root",
            "root_to_tip",
            "beyond_tip",
            "box_to_cylinder",
            "cylinder_to_boundary",
        )
    }
    even = {
        name: 2 * max(2, round(factor * getattr(_MEDIUM_CELL_COUNTS, name) / 2))
        for name in ("aerofoil_side", "nose_and_tail")
    }
    return replace(
        _MEDIUM_CELL_COUNTS,
        **numbers,
        **even,
        wall_cell_chords=_MEDIUM_CELL_COUNTS.wall_cell_chords / factor,
        tip_cell_radii=_MEDIUM_CELL_COUNTS.tip_cell_radii / factor,
    )


MESH_LEVELS: Mapping[str, CellCounts] = MappingProxyType(
    {
        "tiny": _scale_cell_counts(0.5),
        "coarse": _scale_cell_counts(0.77),
        "medium": _MEDIUM_CELL_COUNTS,
        "fine": _scale_cell_counts(1.4),
    }
)
"""Cell counts of the refinement levels; the cell sizes have the ratios 2 : 1.3 : 1 : 0.71 in every direction."""

_MIN_ROOT_CUTOUT_RADII = 0.04  # least root cut-out over R


_SECTION_BOX_HALF_WIDTH_RADII, _SECTION_BOX_SPAN_RADII, _SECTION_BOX_LEVEL_HEIGHT_RADII = (
    0.75,
    1.2,
    0.6,
)  # size of the sections' box, over R
_BOX_CYLINDER_RADIUS_FACTOR = 1.06  # radius of the cylinder around the box over that of its corners


@dataclass(frozen=True)
class MeshDomain:
    """Limits of the meshed domain, in rotor radii.

    Attributes
    ----------
    radius, above, below : float
        Radius of the outer cylinder; distances from the disc to its top and bottom. 300, 200 and 400 mm for R 60 mm.
    turning_above, turning_below : float
        Distances from the disc to the limits of the rotating zone (nearest plane of the mesh). The zone should contain
        the whole wake, because flow that leaves it is treated as steady in the frame at rest.
    """

    radius: float = 5.0
    above: float = 200.0 / 60.0
    below: float = 400.0 / 60.0
    turning_above: float = 0.7
    turning_below: float = math.inf

    def __post_init__(self) -> None:
        for name, least in (("radius", 2.5), ("above", 1.5), ("below", 1.5)):
            if not least <= getattr(self, name) <= 50.0:
                raise InputError("domain", name, f"is {getattr(self, name):g} R", f"give {least:g} to 50")
        for name in ("turning_above", "turning_below"):
            if not getattr(self, name) >= 0.5:
                raise InputError("domain", name, f"is {getattr(self, name):g} R", "give 0.5 R or more")


@dataclass(frozen=True, eq=False)
class SectorMesh:
    """Hexahedral mesh of the sector around one blade.

    Attributes
    ----------
    points : (points, 3) array
        Coordinates (m).
    hexahedra : (cells, 8) array
        Point indices of each cell, in OpenFOAM's order.
    cell_strip : (cells,) array
        Spanwise strip of the blade that contains the cell; -1 elsewhere.
    strip_edges_m : (strips + 1,) array
        Radii between the strips.
    point_marks : dict of (points,) bool arrays
        True for points on ``sector``, ``outer``, ``top``, ``bottom``, and for points of the ``lower`` rotor of a pair.
    blade_count : int
    plate_faces : (faces, 4) array
        Faces between two cells that are walls.
    is_rotating : (cells,) bool array
        True for cells in the blade's frame.
    interface_height_m : float
        Height of the plane above the cells of a second rotor; -inf without one.
    """

    points: Array
    hexahedra: Index
    cell_strip: Index
    strip_edges_m: Array
    point_marks: Mapping[str, NDArray[np.bool_]]
    blade_count: int
    plate_faces: Index
    is_rotating: NDArray[np.bool_]
    interface_height_m: float = -math.inf


def make_sector_mesh(
    rotor: Rotor,
    pitch_rad: float,
    *,
    level: str | CellCounts = "medium",
    domain: MeshDomain | None = None,
    form: BladeGeometry | None = None,
    other_m: float = 0.0,
) -> SectorMesh:
    """Mesh one sector of a rotor.

    Parameters
    ----------
    rotor : Rotor
    pitch_rad : float
        Pitch setting about the quarter chord line, added to the twist.
    level : {'tiny', 'coarse', 'medium', 'fine'} or CellCounts
        Refinement level: 16, 61, 136 or 376 thousand cells.
    domain : MeshDomain, optional
    form : BladeGeometry, optional
        Hub, tip, plates; default: none, a square tip.
    other_m : float
        Height of a second rotor's disc over this disc (negative: below); 0 for none. The mesh then ends half way to it
        in a horizontal plane that is mirror symmetric in x.

    Raises
    ------
    InputError
        If the rotor has one blade, blades that reach the shaft or intersect, or a section without a contour.
    """
    domain, form = domain or MeshDomain(), form or BladeGeometry()
    if isinstance(level, str) and level not in MESH_LEVELS:
        raise InputError("mesh", level, "is unknown", f"use one of: {', '.join(MESH_LEVELS)}")
    k = _raise_counts_for_tip_and_hub(MESH_LEVELS[level] if isinstance(level, str) else level, form)
    radius, root = rotor.radius_m, rotor.hub_radius_m
    _check_rotor_meshable(rotor, pitch_rad, form)
    x = np.linspace(float(rotor.hub_cutout), 1.0, 101)
    widest = float(np.max(rotor.chord_m(x)))
    steepest = math.sin(float(np.max(np.abs(rotor.twist_rad(x) + pitch_rad))))
    slope = 1.0 / math.tan(math.pi / rotor.blades) if rotor.blades > 2 else 0.0
    # Space in which the centre block turns back, and for the sections of a winglet.
    room = 0.6 * widest if form.tip.cant_rad else 0.0
    half, far = (
        max(_SECTION_BOX_HALF_WIDTH_RADII * radius, (1.4 + 2.4 * steepest) * widest),
        _SECTION_BOX_SPAN_RADII * radius + room,
    )
    level_m = max(
        _SECTION_BOX_LEVEL_HEIGHT_RADII * radius + room, (CENTRE_BLOCK_HALF_HEIGHT_CHORDS + 4.0 * steepest) * widest
    )
    if slope:
        half = min(half, 0.6 * radius / slope)
        if half < 1.5 * widest:
            raise InputError(
                rotor.name, "blade.chord", f"{1e3 * widest:.3g} mm is too wide for a sector of {rotor.blades} blades",
                f"give at most {1e3 * half / 1.5:.3g} mm, or fewer blades",
            )  # fmt: skip
    box = SectionBox(half, domain.above * radius, -domain.below * radius, level_m)
    outer, inside = domain.radius * radius, _BOX_CYLINDER_RADIUS_FACTOR * math.hypot(half, far)
    if other_m:
        tall = _pair_block_half_height(rotor, pitch_rad, 0.5 * abs(other_m))
        box = replace(box, **{"top_m" if other_m > 0.0 else "bottom_m": 0.5 * other_m})
    if outer < 1.2 * inside or domain.above * radius < 1.2 * box.level_height_m:
        raise InputError(
            "domain", "",
            f"has a radius of {domain.radius:g} R and ends {domain.above:g} R above the disc: too close to the blade",
            f"give at least {1.2 * inside / radius:.2g} R and {1.2 * box.level_height_m / radius:.2g} R",
        )  # fmt: skip

    size = (inside - 0.5 * (half + far)) / k.box_to_cylinder
    k = _adapt_row_counts(k, domain, radius, widest, inside, size)
    if other_m:
        k = replace(k, **{"block_to_top" if other_m > 0.0 else "block_to_bottom": max(2, k.nose_and_tail // 3)})
    layout = SectionLayout(k)
    tip_chord, tip_angle = float(rotor.chord_m(1.0)), float(rotor.twist_rad(1.0)) + pitch_rad
    span = compute_blade_line_length(form.tip, root, radius, tip_chord)
    blade = (root, root + span)
    tip = min(k.tip_cell_radii * radius, 0.5 * span / k.root_to_tip)
    at_root = min(1.5 * tip, 0.5 * root / k.axis_to_root, 0.5 * span / k.root_to_tip)
    inner, hub = _root_stations(k, root, at_root, form)
    # Beyond the end the line bends back parallel to the disc, so that its length exceeds its radius.
    rest = far - float(compute_blade_line(form.tip, np.array([blade[1]]), blade, tip_chord).radius_m[0])
    behind = compute_blade_line(form.tip, np.array([blade[1] + rest]), blade, tip_chord).radius_m[0]
    rest += far - float(behind)
    s = np.concatenate(
        (
            inner,
            root + span * make_vinokur_spacing(k.root_to_tip, at_root / span, tip / span)[1:],
            blade[1] + rest * make_geometric_spacing(k.beyond_tip, tip / rest)[1:],
        )
    )
    line = compute_blade_line(form.tip, s, blade, tip_chord)
    first, last, top = k.axis_to_root, k.axis_to_root + k.root_to_tip, len(s) - 1
    y = line.radius_m
    if abs(y[-1] - far) > 1e-9 * far:
        raise InputError(
            "tip",
            "bend_radius_chords",
            f"is {form.tip.bend_radius_chords:g} chords, too much for this blade",
            "give less",
        )
    y[-1] = far
    block = (_PAIR_BLOCK_HALF_WIDTH_CHORDS * widest, tall) if other_m else None
    stack, plate_layers = _build_sections(rotor, pitch_rad, layout, s, blade, far, box, form, line.chord_ratio, block)
    t = np.clip((s - root) / span, 0.0, 1.0)
    fade = 1.0 - t * t * (3.0 - 2.0 * t)

    def bend_into_sector(x: Array) -> Array:
        return fade[:, None] * (np.hypot(y[:, None], np.abs(x) * slope) - y[:, None])

    n2, nz = layout.point_count, layout.nz
    flat = place_sections(
        stack, line, form.tip, angle_rad=tip_angle, chord_m=tip_chord, half_m=half, level_m=box.level_height_m
    )
    flat[..., 1] += bend_into_sector(stack[..., 0])
    # Beyond the box the last section fans out to the cylinder around it and on to the outer one.
    corner = math.atan2(half, far)
    near = np.linspace(0.0, 1.0, k.box_to_cylinder + 1)[1:]
    beyond = (
        1.0
        + (outer / inside - 1.0)
        * make_geometric_spacing(
            k.cylinder_to_boundary, min(1.2 * size / (outer - inside), 1.0 / k.cylinder_to_boundary)
        )[1:]
    )
    phi = corner * flat[-1, :, 0] / half
    arc = np.stack((inside * np.sin(phi), inside * np.cos(phi)), axis=-1)
    fan = np.repeat(flat[-1:], k.box_to_cylinder + k.cylinder_to_boundary, axis=0)
    fan[: k.box_to_cylinder, :, :2] += near[:, None, None] * (arc - flat[-1, :, :2])
    fan[k.box_to_cylinder :, :, :2] = beyond[:, None, None] * arc
    # The wings begin at the sides of the box.
    side_y = y + bend_into_sector(np.array([half]))[:, 0]
    share = (side_y - side_y[0]) / (side_y[-1] - side_y[0])
    angle = math.pi / rotor.blades + (corner - math.pi / rotor.blades) * share
    ends = inside * np.stack((np.sin(angle), np.cos(angle)), axis=-1)[:-1]
    starts = np.stack((np.full(top, half), side_y[:-1]), axis=-1)
    wings = k.box_to_cylinder + k.cylinder_to_boundary
    plan = np.empty((top, wings, 2))
    plan[:, : k.box_to_cylinder] = starts[:, None] + near[None, :, None] * (ends - starts)[:, None]
    plan[:, k.box_to_cylinder :] = beyond[None, :, None] * ends[:, None]
    # Lines of z at the box's side; on the cylinder they are those of the last section.
    z_side = stack[:, layout.tensor_ids[0], 1]
    levelled = np.minimum(np.arange(1, wings + 1) / k.box_to_cylinder, 1.0)[None, :, None]
    z_wing = z_side[:-1, None] + levelled * (z_side[-1] - z_side[:-1, None])

    sections = np.concatenate((flat, fan)).reshape(-1, 3)
    ids = np.arange(len(sections)).reshape(-1, n2)
    points, cells, strips = [sections], [], []
    count = len(sections)
    quads = {True: layout.outer_quads, False: np.concatenate((layout.outer_quads, layout.core_quads))}
    for i in range(len(ids) - 1):
        on_blade = first <= i < last
        q = quads[on_blade or i < hub]
        cells.append(np.concatenate((ids[i + 1][q], ids[i][q]), axis=1))
        strips.append(np.full(len(q), i - first if on_blade else -1))
    on_outer = [ids[-1]]
    for edge, sign in ((layout.tensor_ids[-1], 1.0), (layout.tensor_ids[0], -1.0)):
        more = np.empty((top, wings, nz + 1, 3))
        more[..., 0] = sign * plan[:, :, None, 0]
        more[..., 1] = plan[:, :, None, 1]
        more[..., 2] = z_wing
        wing = np.empty((top + 1, wings + 1, nz + 1), dtype=np.int64)
        wing[:-1, 1:] = count + np.arange(more[..., 0].size).reshape(more.shape[:3])
        wing[:, 0] = ids[: top + 1][:, edge]
        wing[-1] = ids[top:][:, edge]
        points.append(more.reshape(-1, 3))
        count += more[..., 0].size
        w = wing
        lower = np.stack((w[:-1, :-1], w[:-1, 1:], w[1:, 1:], w[1:, :-1]), axis=-1)
        if sign < 0:
            lower = lower[..., ::-1]
        hexes = np.concatenate((lower[:, :, :-1], lower[:, :, 1:]), axis=-1).reshape(-1, 8)
        cells.append(hexes)
        strips.append(np.full(len(hexes), -1))
        on_outer.append(wing[:-1, -1].ravel())
    all_points, hexahedra = np.concatenate(points), np.concatenate(cells)
    n = len(all_points)
    marks = {name: np.zeros(n, dtype=bool) for name in ("sector", "outer", "top", "bottom")}
    for i in on_outer:
        marks["outer"][i] = True
    marks["sector"][ids[0]] = True
    beside = len(sections) + np.arange(2 * top * wings * (nz + 1)).reshape(2, top, wings, nz + 1)
    marks["sector"][beside[:, 0].ravel()] = True
    for name, j in (("bottom", 0), ("top", nz)):
        marks[name][ids[:, layout.tensor_ids[:, j]].ravel()] = True
        marks[name][beside[..., j].ravel()] = True
    used = np.zeros(n, dtype=bool)
    used[hexahedra.ravel()] = True
    number = np.cumsum(used) - 1
    return SectorMesh(
        all_points[used], number[hexahedra], np.concatenate(strips), y[first : last + 1],
        {name: mark[used] for name, mark in marks.items()}, rotor.blades,
        number[_find_flap_and_plate_faces(layout, ids, first, last, form, plate_layers)],
        _find_rotating_cells(
            all_points[hexahedra].mean(axis=1), inside, z_side[-1], domain, radius, tall if other_m else level_m
        ),
    )  # fmt: skip


def compute_blade_vertical_reach(rotor: Rotor, pitch_rad: float) -> float:
    """Return the greatest distance (m) of the blade surface above or below the disc."""
    x = np.linspace(float(rotor.hub_cutout), 1.0, 101)
    angle = np.abs(rotor.twist_rad(x) + pitch_rad)
    return float(np.max(rotor.chord_m(x) * (0.75 * np.sin(angle) + 0.1)))


def _pair_block_half_height(rotor: Rotor, pitch_rad: float, half_gap: float) -> float:
    """Return the half height (m) of the centre block between two rotors; raise InputError if the blade does not fit."""
    reach = compute_blade_vertical_reach(rotor, pitch_rad)
    tall = _PAIR_BLOCK_GAP_FRACTION * half_gap
    if reach > 0.8 * tall:
        raise InputError(
            "pair", "gap", f"of {2e3 * half_gap:.3g} mm brings the blades too close to the plane between "
            "the rotors",
            f"give at least {2e3 * reach / (0.8 * _PAIR_BLOCK_GAP_FRACTION):.3g} mm",
        )  # fmt: skip
    return tall


_PAIR_BLOCK_GAP_FRACTION, _PAIR_BLOCK_HALF_WIDTH_CHORDS = 0.82, 1.05
"""For pairs: half height of the centre block over half the distance of the rotors; its half width in chords."""


def _find_rotating_cells(
    centres: Array, around: float, lines: Array, domain: MeshDomain, radius: float, level_m: float
) -> NDArray[np.bool_]:
    """Return the cells of the rotating zone: in a cylinder, between horizontal mesh planes near its limits."""
    level = lines[np.abs(lines) >= level_m]
    low, high = (
        level[int(np.argmin(np.abs(level - z * radius)))]
        for z in (-min(domain.turning_below, domain.below), min(domain.turning_above, domain.above))
    )
    r, z = np.hypot(centres[:, 0], centres[:, 1]), centres[:, 2]
    return (r < around) & (z > low) & (z < high)


def _adapt_row_counts(
    k: CellCounts, domain: MeshDomain, radius: float, chord: float, inside: float, size: float
) -> CellCounts:
    """Adapt the rows of cells to another domain so that cell sizes near the blade are unchanged."""
    own = MeshDomain()
    high = CENTRE_BLOCK_HALF_HEIGHT_CHORDS * chord
    dz = 2.0 * CENTRE_BLOCK_HALF_HEIGHT_CHORDS * chord / k.nose_and_tail

    def adapt_row_count(count: int, first: float, usual: float, length: float) -> int:
        if length == usual:
            return count
        lines = make_geometric_spacing(count, min(first / usual, 1.0 / count))
        widths = np.diff(lines)
        ratio = float(widths[-1] / widths[-2]) if count > 2 else 1.5
        if ratio < 1.01:
            return max(2, round(length / first))
        return max(2, round(math.log1p(length * (ratio - 1.0) / first) / math.log(ratio)))

    return replace(
        k,
        block_to_top=adapt_row_count(k.block_to_top, dz, own.above * radius - high, domain.above * radius - high),
        block_to_bottom=adapt_row_count(k.block_to_bottom, dz, own.below * radius - high, domain.below * radius - high),
        cylinder_to_boundary=adapt_row_count(
            k.cylinder_to_boundary, 1.2 * size, own.radius * radius - inside, domain.radius * radius - inside
        ),
    )


def _raise_counts_for_tip_and_hub(k: CellCounts, form: BladeGeometry) -> CellCounts:
    """Add cells along the blade for a shaped tip, and along the shaft for a hub."""
    shaped = bool(form.tip.length or form.tip.cant_rad)
    return replace(
        k,
        root_to_tip=k.root_to_tip + (k.root_to_tip // 4 if shaped else 0),
        axis_to_root=k.axis_to_root + (3 if form.hub else 0),
    )


def _root_stations(k: CellCounts, root: float, at_root: float, form: BladeGeometry) -> tuple[Array, int]:
    """Return the radii of the sections from shaft to root, and how many of the cells between these sections lie inside
    the hub.
    """
    if form.hub is None:
        return root * (1.0 - make_geometric_spacing(k.axis_to_root, at_root / root)[::-1]), 0
    edge = _HUB_FLAT_RADIUS_RATIO * form.hub.radius_m
    n = max(2, round(0.4 * k.axis_to_root))
    rest = k.axis_to_root - n
    if form.hub.joined:
        outside = np.linspace(0.0, 1.0, rest + 1)
    else:
        outside = make_vinokur_spacing(
            rest, min(at_root / (root - edge), 1.0 / rest), min(at_root / (root - edge), 1.0 / rest)
        )
    return np.concatenate((np.linspace(0.0, edge, n + 1), edge + (root - edge) * outside[1:])), (
        k.axis_to_root if form.hub.joined else n
    )


_HUB_FLAT_RADIUS_RATIO = 0.4
"""Radius at which the flats or grips of a hub begin, over the hub radius."""


def _find_flap_and_plate_faces(
    layout: SectionLayout, ids: Index, first: int, last: int, form: BladeGeometry, count: tuple[int, int]
) -> Index:
    """Return the faces of Gurney flap and tip plates, (faces, 4)."""
    k, out = layout.counts, [np.empty((0, 4), dtype=np.int64)]
    flap, plate = count
    if form.gurney_height:
        line = layout.ring_ids[::-1][: flap + 1, k.aerofoil_side + k.nose_and_tail]
        p = ids[first : last + 1][:, line]
        out.append(np.stack((p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]), axis=-1).reshape(-1, 4))
    n, m = k.aerofoil_side, k.nose_and_tail
    around = layout.ring_ids[::-1][: plate + 1]
    around = ids[last][np.concatenate((around, around[:, :1]), axis=1)]
    quads = np.stack((around[:-1, :-1], around[:-1, 1:], around[1:, 1:], around[1:, :-1]), axis=-1)
    # Above: the upper side; below: the lower one; both: all around.
    tip = form.tip
    if tip.plate_above and tip.plate_below:
        out.append(quads.reshape(-1, 4))
    elif tip.plate_above:
        out.append(quads[:, :n].reshape(-1, 4))
    elif tip.plate_below:
        out.append(quads[:, n + m : 2 * n + m].reshape(-1, 4))
    return np.concatenate(out)


def _build_sections(
    rotor: Rotor,
    pitch_rad: float,
    layout: SectionLayout,
    s: Array,
    ends: tuple[float, float],
    far: float,
    box: SectionBox,
    form: BladeGeometry,
    factor: Array,
    level_block: tuple[float, float] | None,
) -> tuple[Array, tuple[int, int]]:
    """Return the points of every section, (sections, points, 2), and the ring layers at which flap and tip plate end.

    ``level_block`` is half width and half height of the centre block for a pair.
    """
    k, (root, end), hub = layout.counts, ends, form.hub
    # The rotor file's stations are radii of the straight blade; a winglet's line is longer.
    x = (root + np.clip((s - root) / (end - root), 0.0, 1.0) * (rotor.radius_m - root)) / rotor.radius_m
    at = rotor.sections_at(x)
    chord = at.chord_m * factor
    loops = np.stack([make_ring_contour(load_meshable_airfoil(name), k) for name in at.airfoil_names]) - np.array(
        [0.25, 0.0]
    )
    w = at.second_weight[:, None, None]
    loop = (1.0 - w) * loops[at.first_airfoil] + w * loops[at.second_airfoil]
    begin = _HUB_FLAT_RADIUS_RATIO * hub.radius_m if hub else 0.0
    t = np.clip((root - s) / (root - begin), 0.0, 1.0)
    plain = t * t * (3.0 - 2.0 * t)
    t = np.clip((s - end) / (far - end), 0.0, 1.0)
    plain = np.maximum(plain, t * t * (3.0 - 2.0 * t))
    relaxed = np.maximum(plain, t)
    if hub:
        relaxed[s < root] = 0.0
    gurney = plate = (0.0, 0)
    if form.gurney_height:
        gurney = (
            form.gurney_height,
            find_ring_layer_at_height(
                k, form.gurney_height, math.hypot(CENTRE_BLOCK_MARGIN_CHORDS, CENTRE_BLOCK_HALF_HEIGHT_CHORDS)
            ),
        )
    high = max(form.tip.plate_above, form.tip.plate_below)
    if high:
        plate = (high, find_ring_layer_at_height(k, high, CENTRE_BLOCK_HALF_HEIGHT_CHORDS - 0.06))
    typical = float(np.max(at.chord_m))
    sine = math.sin(math.pi / rotor.blades)
    out = np.empty((len(s), layout.point_count, 2))
    for i in range(len(s)):
        inside = s[i] < root
        half = 0.9 * (float(chord[0]) if inside else typical)
        block, core = (half, 0.5 * half), ((0.5 if inside else 0.75) * half, 0.175 * half)
        if inside and hub:
            # Half width at which the section cuts the hub's cylinder; sections of three or more blades are bent.
            wide = sine * math.sqrt(hub.radius_m**2 - min(float(s[i]), begin) ** 2)
            core = (wide, hub.half_height_m)
            block = (
                max(0.7 * half / 0.9, 1.5 * wide),
                max(CENTRE_BLOCK_HALF_HEIGHT_CHORDS * half / 0.9, 2.0 * hub.half_height_m),
            )
        shape = SectionShape(
            loop[i], float(chord[i]), float(at.twist_rad[i]) + pitch_rad, float(plain[i]), level_block or block, core,
            float(relaxed[i]), typical, gurney, plate, level_block is not None,
        )  # fmt: skip
        out[i] = compute_section_points(layout, shape, box)
    # Removes rounding errors on the plane of symmetry: the periodic planes have to match exactly.
    first = out[0]
    mirror = _mirror_indices(layout)
    first[:, 0] = 0.5 * (first[:, 0] - first[mirror, 0])
    first[:, 1] = 0.5 * (first[:, 1] + first[mirror, 1])
    return out, (gurney[1], plate[1])


def _mirror_indices(layout: SectionLayout) -> Index:
    """Return the index of each point's mirror image in x."""
    image = np.arange(layout.point_count)
    on = layout.tensor_ids >= 0
    image[layout.tensor_ids[on]] = layout.tensor_ids[::-1][on]
    image[layout.core_ids.ravel()] = layout.core_ids[::-1].ravel()
    n, m = layout.counts.aerofoil_side, layout.counts.nose_and_tail
    # Around the loop the upper side is reversed, and nose and tail are exchanged.
    around = (n - np.arange(2 * (n + m))) % (2 * (n + m))
    image[layout.ring_ids] = layout.ring_ids[:, around]
    return image


def _check_rotor_meshable(rotor: Rotor, pitch_rad: float, form: BladeGeometry) -> None:
    """Raise InputError for a rotor that cannot be meshed."""
    if form.hub and not 0.02 * rotor.radius_m < form.hub.radius_m < 0.95 * rotor.hub_radius_m:
        raise InputError(
            "hub", "radius", f"is {1e3 * form.hub.radius_m:.3g} mm",
            f"give {20 * rotor.radius_m:.2g} to {950 * rotor.hub_radius_m:.3g} mm: the blades begin at "
            f"{1e3 * rotor.hub_radius_m:.3g} mm",
        )  # fmt: skip
    if form.hub and form.hub.half_height_m > 0.2 * rotor.radius_m:
        raise InputError(
            "hub", "half_height", f"is {1e3 * form.hub.half_height_m:.3g} mm",
            f"give at most {200 * rotor.radius_m:.3g} mm",
        )  # fmt: skip
    if rotor.blades < 2:
        raise InputError(rotor.name, "blades", "is 1", "give two or more: one blade has no periodic sector")
    if float(rotor.hub_cutout) < _MIN_ROOT_CUTOUT_RADII:
        raise InputError(
            rotor.name, "hub_cutout", f"{float(rotor.hub_cutout):g} lets the blades meet at the shaft",
            f"give at least {_MIN_ROOT_CUTOUT_RADII:g}, where the blades begin",
        )  # fmt: skip
    if not abs(pitch_rad) <= math.radians(60.0):
        raise InputError(rotor.name, "pitch", f"{math.degrees(pitch_rad):g} deg", "give -60 to 60 deg")
    x = np.linspace(float(rotor.hub_cutout), 1.0, 201)
    angle = rotor.twist_rad(x) + pitch_rad
    if float(np.max(np.abs(angle))) > math.radians(75.0):
        raise InputError(
            rotor.name, "twist",
            f"a section has {math.degrees(float(np.max(np.abs(angle)))):.0f} deg of twist and pitch in sum",
            "give at most 75 deg",
        )  # fmt: skip
    if rotor.blades > 2:
        # The tail is critical: 0.75 chords aft, in a sector whose planes lie at |x| cot(pi/N).
        aft = 0.75 * rotor.chord_m(x) * np.cos(angle)
        wall = aft / math.tan(math.pi / rotor.blades)
        room = x * rotor.radius_m - wall
        if float(np.min(room)) < 0.1 * rotor.hub_radius_m:
            at = float(x[int(np.argmin(room))])
            raise InputError(
                rotor.name, "blade.chord", f"the blades meet at r/R {at:.2g}",
                "give a larger hub_cutout, a smaller chord or fewer blades",
            )  # fmt: skip
