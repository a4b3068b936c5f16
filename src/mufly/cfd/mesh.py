r"""The mesh of one blade's sector: sections stacked along the blade, and around them the rest of a cylinder.

Frame: z up along the shaft, the blade along +y, x against its motion (nose at negative x); the rotor turns about +z.
A rotor of N blades is meshed as a sector of 2 pi / N with one blade, between two planes through the shaft that are each
other's image in x, point by point, so that plain cyclic boundaries do.

Section k is bent so that the first lies in those planes and the one at the tip not at all::

    y = y_k + f_k (sqrt(y_k^2 + (|x| cot(pi/N))^2) - y_k)          two blades: y = y_k;  f_k from 1 at the root to 0

In plan view the sections fill a box, from the shaft to beyond the tip; from its three free sides lines fan out to the
outer cylinder (``wings`` to the left and right, the last sections themselves beyond the tip)::

              ______________
            /   \  tip   /   \        outer cylinder
           /     |______|     \
          | wing |  ||  | wing |
          |______|__||__|______|      the two periodic planes, or one plane of a two-bladed rotor

Between shaft and root there is a gap of air; the section changes in it from the blade's to one that is its own image.
With a hub the core of those sections is left out like the blade's, and its half width is the hub's, sqrt(r^2 - y^2),
out to 0.4 r; from there it runs on into the root, or ends.

Plates (Gurney flaps, tip plates) have no thickness: faces between two cells that become walls on both sides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.form import Form, blade_line, blade_span, placed
from mufly.cfd.sections import (
    BESIDE,
    OVER,
    Box,
    Counts,
    Layout,
    Shape,
    contour,
    grown,
    layers,
    section,
    stretched,
    thickness_check,
)
from mufly.errors import InputError
from mufly.rotor import Rotor

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_MEDIUM = Counts(
    along=34, across=8, ring=16, side=8, above=12, below=16, gap=6, blade=20, beyond=8, outer=6, wall=0.002, tip=0.0067
)  # fmt: skip


def _refined(factor: float) -> Counts:
    def times(name: str) -> int:
        return max(2, round(factor * getattr(_MEDIUM, name)))

    numbers = {
        name: times(name) for name in ("ring", "side", "above", "below", "gap", "blade", "beyond", "outer")
    }
    even = {name: 2 * max(2, round(factor * getattr(_MEDIUM, name) / 2)) for name in ("along", "across")}
    return replace(_MEDIUM, **numbers, **even, wall=_MEDIUM.wall / factor, tip=_MEDIUM.tip / factor)


LEVELS: Mapping[str, Counts] = MappingProxyType(
    {"tiny": _refined(0.5), "coarse": _refined(0.77), "medium": _MEDIUM, "fine": _refined(1.4)}
)
"""Numbers of cells, each direction finer by one factor: the sizes of cells are as 2 : 1.3 : 1 : 0.71."""

_NEAREST = 0.04  # root cut-out over R


@dataclass(frozen=True)
class Domain:
    """Limits of the air that is meshed, over the rotor's radius.

    Attributes
    ----------
    radius, above, below : float
        Of the outer cylinder; from the disc to its top and its bottom. 300, 200 and 400 mm for R 60 mm.
    """

    radius: float = 5.0
    above: float = 200.0 / 60.0
    below: float = 400.0 / 60.0

    def __post_init__(self) -> None:
        for name, least in (("radius", 2.5), ("above", 1.0), ("below", 1.5)):
            if not least <= getattr(self, name) <= 50.0:
                raise InputError("domain", name, f"is {getattr(self, name):g} R", f"give {least:g} to 50")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Hexahedra of one sector.

    Attributes
    ----------
    points : (points, 3) array
        m.
    hexahedra : (cells, 8) array
        Points of each cell, in OpenFOAM's order.
    strip : (cells,) array
        Which of the blade's spanwise strips a cell lies in; -1 elsewhere.
    edges_m : (strips + 1,) array
        Radii between the strips.
    marks : dict of (points,) bool arrays
        Which points lie on ``sector``, ``outer``, ``top``, ``bottom``.
    blades : int
    plates : (faces, 4) array
        Faces between two cells that are walls.
    """

    points: Array
    hexahedra: Index
    strip: Index
    edges_m: Array
    marks: Mapping[str, NDArray[np.bool_]]
    blades: int
    plates: Index


def blade_mesh(
    rotor: Rotor,
    pitch_rad: float,
    *,
    level: str | Counts = "medium",
    domain: Domain | None = None,
    form: Form | None = None,
) -> Mesh:
    """Mesh one sector of a rotor.

    Parameters
    ----------
    rotor : Rotor
    pitch_rad : float
        Pitch setting, added to the twist; about the quarter chord line.
    level : {'tiny', 'coarse', 'medium', 'fine'} or Counts
        16, 60, 135 and 364 thousand cells.
    domain : Domain, optional
    form : Form, optional
        Hub, tip, plates; default: none, a square tip.

    Raises
    ------
    InputError
        If the rotor cannot be meshed: one blade, blades that reach the shaft or meet, a section without a contour.
    """
    domain, form = domain or Domain(), form or Form()
    if isinstance(level, str) and level not in LEVELS:
        raise InputError("mesh", level, "is no level", f"use one of: {', '.join(LEVELS)}")
    k = _richer(LEVELS[level] if isinstance(level, str) else level, form)
    radius, root = rotor.radius_m, rotor.hub_radius_m
    _check(rotor, pitch_rad, form)
    layout = Layout(k)
    widest = float(np.max(rotor.chord_m(np.linspace(float(rotor.hub_cutout), 1.0, 101))))
    slope = 1.0 / math.tan(math.pi / rotor.blades) if rotor.blades > 2 else 0.0
    half, far = max(1.2 * radius, 2.2 * widest), 1.5 * radius
    if slope:
        half = min(half, 0.6 * radius / slope)
        if half < 1.5 * widest:
            raise InputError(
                rotor.name, "blade.chord", f"{1e3 * widest:.3g} mm is too wide for a sector of {rotor.blades} blades",
                f"give at most {1e3 * half / 1.5:.3g} mm, or fewer blades",
            )  # fmt: skip
    box = Box(half, domain.above * radius, -domain.below * radius)
    outer = domain.radius * radius
    if outer < 1.3 * math.hypot(half, far):
        raise InputError(
            "domain", "radius", f"is {domain.radius:g} R, too close to the blade",
            f"give at least {1.3 * math.hypot(half, far) / radius:.2g}",
        )  # fmt: skip

    tip_chord, tip_angle = float(rotor.chord_m(1.0)), float(rotor.twist_rad(1.0)) + pitch_rad
    span = blade_span(form.tip, root, radius, tip_chord)
    blade = (root, root + span)
    tip = min(k.tip * radius, 0.5 * span / k.blade)
    at_root = min(1.5 * tip, 0.5 * root / k.gap, 0.5 * span / k.blade)
    inner, hub = _to_root(k, root, at_root, form)
    # Beyond the end the line turns back to the disc's direction, so that it is longer than it is far.
    rest = far - float(blade_line(form.tip, np.array([blade[1]]), blade, tip_chord).y_m[0])
    behind = blade_line(form.tip, np.array([blade[1] + rest]), blade, tip_chord).y_m[0]
    rest += far - float(behind)
    s = np.concatenate(
        (
            inner,
            root + span * stretched(k.blade, at_root / span, tip / span)[1:],
            blade[1] + rest * grown(k.beyond, tip / rest)[1:],
        )
    )
    line = blade_line(form.tip, s, blade, tip_chord)
    first, last, top = k.gap, k.gap + k.blade, len(s) - 1
    y = line.y_m
    if abs(y[-1] - far) > 1e-9 * far:
        raise InputError("tip", "bend", f"is {form.tip.bend:g} chords, too much for this blade", "give less")
    y[-1] = far
    stack, plate_layers = _sections(rotor, pitch_rad, layout, s, blade, far, box, form, line.chord)
    t = np.clip((s - root) / span, 0.0, 1.0)
    fade = 1.0 - t * t * (3.0 - 2.0 * t)

    def bent(x: Array) -> Array:
        return fade[:, None] * (np.hypot(y[:, None], np.abs(x) * slope) - y[:, None])

    n2, nz = layout.points, layout.nz
    flat = placed(
        stack, line, form.tip, angle_rad=tip_angle, chord_m=tip_chord, half_m=half, top_m=box.top_m,
        bottom_m=box.bottom_m,
    )  # fmt: skip
    flat[..., 1] += bent(stack[..., 0])
    # Beyond the box the last section fans out to the outer cylinder.
    corner = math.atan2(half, far)
    size = float(np.diff(y)[-1])
    reach = outer - far
    out = grown(k.outer, min(1.2 * size / reach, 1.0 / k.outer))
    phi = corner * flat[-1, :, 0] / half
    arc = np.stack((outer * np.sin(phi), outer * np.cos(phi), flat[-1, :, 2]), axis=-1)
    fan = flat[-1] + out[1:, None, None] * (arc - flat[-1])
    # The wings, from the box's sides.
    side_y = y + bent(np.array([half]))[:, 0]
    share = (side_y - side_y[0]) / (side_y[-1] - side_y[0])
    angle = math.pi / rotor.blades + (corner - math.pi / rotor.blades) * share
    ends = outer * np.stack((np.sin(angle), np.cos(angle)), axis=-1)[:-1]
    starts = np.stack((np.full(top, half), side_y[:-1]), axis=-1)
    plan = starts[:, None] + out[None, 1:, None] * (ends - starts)[:, None]  # section, layer, xy
    z_side = stack[:, layout.tensor[0], 1][:-1]  # lines of z at the box's side

    sections = np.concatenate((flat, fan)).reshape(-1, 3)
    ids = np.arange(len(sections)).reshape(-1, n2)
    points, cells, strips = [sections], [], []
    count = len(sections)
    quads = {True: layout.outside, False: np.concatenate((layout.outside, layout.inside))}
    for i in range(len(ids) - 1):
        on_blade = first <= i < last
        q = quads[on_blade or i < hub]
        cells.append(np.concatenate((ids[i + 1][q], ids[i][q]), axis=1))
        strips.append(np.full(len(q), i - first if on_blade else -1))
    on_outer = [ids[-1]]
    for edge, sign in ((layout.tensor[-1], 1.0), (layout.tensor[0], -1.0)):
        more = np.empty((top, k.outer, nz + 1, 3))
        more[..., 0] = sign * plan[:, :, None, 0]
        more[..., 1] = plan[:, :, None, 1]
        more[..., 2] = z_side[:, None, :]
        wing = np.empty((top + 1, k.outer + 1, nz + 1), dtype=np.int64)
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
    beside = len(sections) + np.arange(2 * top * k.outer * (nz + 1)).reshape(2, top, k.outer, nz + 1)
    marks["sector"][beside[:, 0].ravel()] = True
    for name, j in (("bottom", 0), ("top", nz)):
        marks[name][ids[:, layout.tensor[:, j]].ravel()] = True
        marks[name][beside[..., j].ravel()] = True
    used = np.zeros(n, dtype=bool)
    used[hexahedra.ravel()] = True
    number = np.cumsum(used) - 1
    return Mesh(
        all_points[used], number[hexahedra], np.concatenate(strips), y[first : last + 1],
        {name: mark[used] for name, mark in marks.items()}, rotor.blades,
        number[_plates(layout, ids, first, last, form, plate_layers)],
    )  # fmt: skip


def _richer(k: Counts, form: Form) -> Counts:
    """More cells along the blade where its end has a shape, and along the shaft where there is a hub."""
    shaped = bool(form.tip.length or form.tip.cant_rad)
    return replace(k, blade=k.blade + (k.blade // 4 if shaped else 0), gap=k.gap + (3 if form.hub else 0))


def _to_root(k: Counts, root: float, at_root: float, form: Form) -> tuple[Array, int]:
    """Radii of the sections from the shaft to the root, and how many of the cells between them hold the hub."""
    if form.hub is None:
        return root * (1.0 - grown(k.gap, at_root / root)[::-1]), 0
    edge = _FLAT * form.hub.radius_m
    n = max(2, round(0.4 * k.gap))
    rest = k.gap - n
    if form.hub.joined:
        outside = np.linspace(0.0, 1.0, rest + 1)
    else:
        outside = stretched(
            rest, min(at_root / (root - edge), 1.0 / rest), min(at_root / (root - edge), 1.0 / rest)
        )
    return np.concatenate((np.linspace(0.0, edge, n + 1), edge + (root - edge) * outside[1:])), (
        k.gap if form.hub.joined else n
    )


_FLAT = 0.4
"""Where a hub's flats begin, or its grips, over its radius."""


def _plates(layout: Layout, ids: Index, first: int, last: int, form: Form, count: tuple[int, int]) -> Index:
    """Faces of the Gurney flap and of the tip's plates, (faces, 4)."""
    k, out = layout.counts, [np.empty((0, 4), dtype=np.int64)]
    flap, plate = count
    if form.gurney:
        line = layout.ring[::-1][: flap + 1, k.along + k.across]
        p = ids[first : last + 1][:, line]
        out.append(np.stack((p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]), axis=-1).reshape(-1, 4))
    n, m = k.along, k.across
    around = layout.ring[::-1][: plate + 1]
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


def _sections(
    rotor: Rotor, pitch_rad: float, layout: Layout, s: Array, ends: tuple[float, float], far: float, box: Box,
    form: Form, factor: Array,
) -> tuple[Array, tuple[int, int]]:  # fmt: skip
    """Every section's points, (sections, points, 2), and the layers that flap and tip plate take."""
    k, (root, end), hub = layout.counts, ends, form.hub
    # The rotor file's stations are radii of the straight blade; a winglet's line is longer.
    x = (root + np.clip((s - root) / (end - root), 0.0, 1.0) * (rotor.radius_m - root)) / rotor.radius_m
    at = rotor.sections(x)
    chord = at.chord_m * factor
    loops = np.stack([contour(thickness_check(name), k) for name in at.names]) - np.array([0.25, 0.0])
    w = at.weight[:, None, None]
    loop = (1.0 - w) * loops[at.first] + w * loops[at.second]
    begin = _FLAT * hub.radius_m if hub else 0.0
    t = np.clip((root - s) / (root - begin), 0.0, 1.0)
    plain = t * t * (3.0 - 2.0 * t)
    t = np.clip((s - end) / (far - end), 0.0, 1.0)
    plain = np.maximum(plain, t * t * (3.0 - 2.0 * t))
    relaxed = np.maximum(plain, t)
    if hub:
        relaxed[s < root] = 0.0
    gurney = plate = (0.0, 0)
    if form.gurney:
        gurney = (form.gurney, layers(k, form.gurney, math.hypot(BESIDE, OVER)))
    high = max(form.tip.plate_above, form.tip.plate_below)
    if high:
        plate = (high, layers(k, high, OVER - 0.06))
    typical = float(np.max(at.chord_m))
    sine = math.sin(math.pi / rotor.blades)
    out = np.empty((len(s), layout.points, 2))
    for i in range(len(s)):
        inside = s[i] < root
        half = 0.9 * float(chord[0 if inside else -1])
        block, core = (half, 0.5 * half), ((0.5 if inside else 0.75) * half, 0.175 * half)
        if inside and hub:
            # The section's plane meets the hub's cylinder at this half width; three blades and more: it is bent.
            wide = sine * math.sqrt(hub.radius_m**2 - min(float(s[i]), begin) ** 2)
            core = (wide, hub.half_height_m)
            block = (max(0.7 * half / 0.9, 1.5 * wide), max(OVER * half / 0.9, 2.0 * hub.half_height_m))
        shape = Shape(
            loop[i], float(chord[i]), float(at.twist_rad[i]) + pitch_rad, float(plain[i]), block, core,
            float(relaxed[i]), typical, gurney, plate,
        )  # fmt: skip
        out[i] = section(layout, shape, box)
    # What turning left off zero on the plane of symmetry is rounding; the two periodic planes are to match to the bit.
    first = out[0]
    mirror = _mirror(layout)
    first[:, 0] = 0.5 * (first[:, 0] - first[mirror, 0])
    first[:, 1] = 0.5 * (first[:, 1] + first[mirror, 1])
    return out, (gurney[1], plate[1])


def _mirror(layout: Layout) -> Index:
    """Number of each point's image in x."""
    image = np.arange(layout.points)
    on = layout.tensor >= 0
    image[layout.tensor[on]] = layout.tensor[::-1][on]
    image[layout.core.ravel()] = layout.core[::-1].ravel()
    n, m = layout.counts.along, layout.counts.across
    # Around the loop: the upper side runs back to front, nose and tail change places.
    around = (n - np.arange(2 * (n + m))) % (2 * (n + m))
    image[layout.ring] = layout.ring[:, around]
    return image


def _check(rotor: Rotor, pitch_rad: float, form: Form) -> None:
    """InputError for a rotor that cannot be meshed."""
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
    if float(rotor.hub_cutout) < _NEAREST:
        raise InputError(
            rotor.name, "hub_cutout", f"{float(rotor.hub_cutout):g} lets the blades meet at the shaft",
            f"give at least {_NEAREST:g}, where the blades begin",
        )  # fmt: skip
    if not abs(pitch_rad) <= math.radians(60.0):
        raise InputError(rotor.name, "pitch", f"{math.degrees(pitch_rad):g} deg", "give -60 to 60 degrees")
    x = np.linspace(float(rotor.hub_cutout), 1.0, 201)
    angle = rotor.twist_rad(x) + pitch_rad
    if float(np.max(np.abs(angle))) > math.radians(75.0):
        raise InputError(
            rotor.name, "twist", f"and pitch turn a section by {math.degrees(float(np.max(np.abs(angle)))):.0f} deg",
            "give at most 75 in all",
        )  # fmt: skip
    if rotor.blades > 2:
        # The tail reaches furthest: 0.75 chords aft, in a sector whose planes lie at |x| cot(pi/N).
        aft = 0.75 * rotor.chord_m(x) * np.cos(angle)
        wall = aft / math.tan(math.pi / rotor.blades)
        room = x * rotor.radius_m - wall
        if float(np.min(room)) < 0.1 * rotor.hub_radius_m:
            at = float(x[int(np.argmin(room))])
            raise InputError(
                rotor.name, "blade.chord", f"the blades meet at r/R {at:.2g}",
                "give a larger hub_cutout, a smaller chord or fewer blades",
            )  # fmt: skip
