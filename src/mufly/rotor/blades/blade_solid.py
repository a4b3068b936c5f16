"""Blades as solids: closed triangle surfaces to print or to mesh, and blade stations from such surfaces.

Frame: the blade lies along x, its leading edge towards y, the shaft along z with thrust upwards. The pitch axis is the
quarter chord. Lengths are in m; in STL files, which have no unit, they are in mm.

**Export.** Every station has a contour with points at the same chord fractions on both sides (cosine spacing). Contours
are mixed between stations as the polars are, opened at the trailing edge to the printable thickness, turned by the
twist and moved to their radius. Triangles join neighbouring contours and close the ends. Every edge belongs to two
triangles that traverse it in opposite directions, so the surface is watertight. Its volume follows from the divergence
theorem, V = sum a.(b x c) / 6.

**Import.** A plane x = r cuts a triangle surface in closed curves. On the curve nearest to y = 0 the two points
furthest apart are leading and trailing edge; they give chord and twist. The leading edge is the end that is thicker at
most stations, or, at equal thickness, the higher end. A body is moved onto its shaft
(:mod:`mufly.rotor.blades.scanned_pose`) and turned about it until a blade lies along x; its hub is left out. If the
sections scatter by more than :data:`_MAX_EXACT_SCATTER_CHORDS` or have gaps, smooth contours are fitted
(:mod:`mufly.rotor.blades.scanned_sections`). The radius is then reduced by the expected excess of the outermost vertex.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.rotor.blades.scanned_pose import SHAFT_DIRECTIONS, count_blades, find_shaft
from mufly.rotor.blades.scanned_sections import (
    SectionCut,
    cut_triangles,
    estimate_scatter,
    find_cut_ends,
    fit_section,
)
from mufly.rotor.geometry import Rotor, make_rotor
from mufly.rotor.rotor_system import check_pitch
from mufly.rotor.sections.airfoil import load_airfoil, split_sides
from mufly.rotor.sections.polar_file import is_polar_file

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_POINTS_PER_SIDE = 40
_SPAN_STATION_COUNT = 60
_MM_PER_M = 1e3
_STL_VERTEX_COORDINATE_WORDS = slice(1, 4)  # words of a line that begins with "vertex"
_MIN_RADIUS_IF_MM_M, _MAX_RADIUS_IF_MM_M = 8e-3, 5.0  # m, range of radii in which mm is assumed as the unit
_LENGTH_UNITS_M = {"m": 1.0, "in": 0.0254, "cm": 0.01, "mm": 1e-3, "um": 1e-6}
_END_THICKNESS_REGION_CHORDS, _END_THICKNESS_TOLERANCE_FRACTION = (
    0.15,
    0.25,
)  # of the chord; of the thickness in that region
# Of the chord: thickest blunt trailing edge, and greatest distance of its corners along the chord.
_MAX_BLUNT_TAIL_CHORDS, _BLUNT_TAIL_TOLERANCE_CHORDS = 0.1, 2e-3

_BLOCK_CUTS = 4  # neighbouring cuts share vertices
_FIT_GRID_COUNT, _FIT_WINDOW_RADII = 160, 0.07  # cuts along the blade; half the span of the cuts of one section
_MAX_EXACT_SCATTER_CHORDS = 2.5e-4  # of the chord: above, sections are fitted
_MAX_EXACT_BRIDGED_RATIO = 0.005  # of the outline
_MIN_ROTOR_RADIUS_M, _MAX_ROTOR_RADIUS_M = 5e-3, 20.0
_MAX_BLADES_OF_A_BODY = 12
_MAX_SIGN_ERROR_RAD, _MAX_SIGN_ERROR_CHORDS = math.radians(0.5), 3e-3  # of angle and camber taken as zero
_MAX_SHAFT_MISS_RADII, _MAX_USUAL_ROOT_RADII = 0.05, 0.35
_VERTEX_OVER_CUT_SCATTER = 1.3  # points of a cut lie between two vertices
_TIP_MARGIN_SCATTERS = 8.0  # from the tip to the last section


@dataclass(frozen=True, eq=False)
class TriangleSolid:
    """One or several closed triangle surfaces.

    Attributes
    ----------
    points_m : (n, 3) array
    triangles : (m, 3) array
        Point indices of each triangle, counter-clockwise seen from outside.
    """

    points_m: Array
    triangles: Integers

    @property
    def volume_m3(self) -> float:
        """Enclosed volume (m^3)."""
        a, b, c = (self.points_m[self.triangles[:, k]] for k in range(3))
        return float(np.sum(a * np.cross(b, c)) / 6.0)

    @property
    def area_m2(self) -> float:
        """Area of the surfaces (m^2)."""
        a, b, c = (self.points_m[self.triangles[:, k]] for k in range(3))
        return float(np.sum(np.linalg.norm(np.cross(b - a, c - a), axis=1)) / 2.0)

    def count_open_edges(self) -> int:
        """Return the number of edges not shared by two triangles of opposite direction; 0 if watertight."""
        t = self.triangles
        ways = np.concatenate((t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]))
        n = np.int64(self.points_m.shape[0])
        there, back = ways[:, 0] * n + ways[:, 1], ways[:, 1] * n + ways[:, 0]
        unique, count = np.unique(there, return_counts=True)
        return int(np.sum(count != 1) + np.sum(~np.isin(back, unique)))


def blade_contours(
    rotor: Rotor,
    *,
    along: int = _SPAN_STATION_COUNT,
    per_side: int = _POINTS_PER_SIDE,
    tail_m: float = 0.0,
    pitch_rad: float = 0.0,
) -> Array:
    """Return the contours of a blade from the cut-out to the tip.

    Parameters
    ----------
    rotor : Rotor
    along, per_side : int
        Number of stations, and of points on each side of a contour.
    tail_m : float
        Least thickness of the trailing edge (m). The missing thickness is added in equal parts to both sides, growing
        linearly along the chord.
    pitch_rad : float
        Pitch setting, added to the twist (rad).

    Returns
    -------
    (along, 2 per_side, 3) array
        Points (m) from the tail along the upper side to the nose and back along the lower one.

    Raises
    ------
    InputError
        If a size is not possible, or a section has no contour.
    """
    if along < 2 or per_side < 8:
        raise InputError(
            "blade",
            "stations",
            f"{along} stations with {per_side} points on each side are too few",
            "give 2 stations and 8 points or more",
        )
    check_pitch("blade", "pitch_rad", pitch_rad)
    if not 0.0 <= tail_m < 0.5 * float(np.min(rotor.blade.chord.to_si_array())):
        raise InputError("blade", "tail", f"is {_MM_PER_M * tail_m:g} mm", "give 0 to half the least chord")
    t = np.linspace(0.0, math.pi, along)
    cutout = float(rotor.hub_cutout)
    x = cutout + (1.0 - cutout) * 0.5 * (1.0 - np.cos(t))
    x = np.unique(np.concatenate((x, [s for s in rotor.blade.r_over_R.value if cutout < s < 1.0])))
    x = x[np.concatenate(([True], np.diff(x) > 1e-6))]
    cut = rotor.sections_at(x)
    shapes = []
    for name in cut.airfoil_names:
        if is_polar_file(name):
            raise InputError(name, "", "is a table of coefficients without a contour", "name an airfoil or a .dat file")
        shapes.append(_resample_contour(load_airfoil(name).coordinates, per_side))
    table = np.array(shapes)
    contour = (1.0 - cut.second_weight)[:, None, None] * table[cut.first_airfoil] + cut.second_weight[
        :, None, None
    ] * table[cut.second_airfoil]
    contour = contour * cut.chord_m[:, None, None]
    # The missing thickness of the trailing edge is added in proportion to the distance from the leading edge.
    gap = np.maximum(tail_m - (contour[:, 0, 1] - contour[:, -1, 1]), 0.0)
    side = np.where(np.arange(2 * per_side) < per_side, 0.5, -0.5)
    contour[:, :, 1] += side * gap[:, None] * contour[:, :, 0] / cut.chord_m[:, None]
    aft, up = contour[:, :, 0] - 0.25 * cut.chord_m[:, None], contour[:, :, 1]
    theta = cut.twist_rad + pitch_rad
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    out = np.empty((x.size, 2 * per_side, 3))
    out[:, :, 0] = (x * rotor.radius_m)[:, None]
    out[:, :, 1] = -aft * c - up * s
    out[:, :, 2] = -aft * s + up * c
    return out


def _resample_contour(coordinates: Array, per_side: int) -> Array:
    """Resample a contour at the same chord fractions on both sides: tail, upper side, nose, lower side, tail.

    The nose occurs once: the lower side begins behind it.
    """
    upper, lower = split_sides(coordinates)
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, per_side)))
    below = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, per_side + 1)))[1:]
    return np.concatenate(
        (
            np.column_stack((x, np.interp(x, *upper.T)))[::-1],
            np.column_stack((below, np.interp(below, *lower.T))),
        )
    )


def loft_solid(sections: Array) -> TriangleSolid:
    """Join contours, (stations, points, 3), to a closed solid; a sharp trailing edge is one line of points."""
    stations, around, _ = sections.shape
    points = sections.reshape(-1, 3)
    index = np.arange(stations * around).reshape(stations, around)
    index[:, -1] = np.where(np.linalg.norm(sections[:, 0] - sections[:, -1], axis=1) < 1e-9, index[:, 0], index[:, -1])
    if len({bool(v) for v in index[:, -1] == index[:, 0]}) > 1:  # sharp and blunt trailing edges: two lines of points
        index[:, -1] = np.arange(stations * around).reshape(stations, around)[:, -1]
    a, b = index[:-1], index[1:]
    follow = np.roll(index, -1, axis=1)
    c, d = follow[1:], follow[:-1]
    walls = np.concatenate((np.stack((a, b, c), -1).reshape(-1, 3), np.stack((a, c, d), -1).reshape(-1, 3)))
    half = around // 2
    caps = []
    for ring, outwards in ((index[0], False), (index[-1], True)):
        up, low = ring[:half][::-1], ring[half:]  # from nose to tail
        strip = [(up[0], up[1], low[0])]
        for k in range(half - 1):
            strip.append((up[k + 1], low[k + 1], low[k]))
            if k + 2 < half:
                strip.append((up[k + 1], up[k + 2], low[k + 1]))
        turned = np.array(strip)
        caps.append(turned if outwards else turned[:, ::-1])
    triangles = np.concatenate((walls, *caps))
    real = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    solid = TriangleSolid(points, triangles[real])
    return solid if solid.volume_m3 > 0.0 else TriangleSolid(points, triangles[real][:, ::-1])


def join_solids(solids: Sequence[TriangleSolid]) -> TriangleSolid:
    """Merge solids into one list of triangles; they may overlap, which slicers for 3-D printers accept."""
    starts = np.cumsum([0, *(s.points_m.shape[0] for s in solids)])
    return TriangleSolid(
        np.concatenate([s.points_m for s in solids]),
        np.concatenate([s.triangles + k for s, k in zip(solids, starts[:-1], strict=True)]),
    )


def rotate_about_shaft(solid: TriangleSolid, angle_rad: float) -> TriangleSolid:
    """Return a solid rotated about the shaft (z axis) by an angle (rad)."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return TriangleSolid(solid.points_m @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), solid.triangles)


def mirror_solid(solid: TriangleSolid) -> TriangleSolid:
    """Return the mirrored solid, for a rotor that turns the other way."""
    return TriangleSolid(solid.points_m * [1.0, -1.0, 1.0], solid.triangles[:, ::-1])


def make_hub_solid(radius_m: float, bore_m: float, low_m: float, high_m: float) -> TriangleSolid:
    """Return a ring about the shaft, or a disc if the bore is 0."""
    around = 96
    angle = 2.0 * math.pi * np.arange(around) / around
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(around)))
    inner = bore_m if bore_m > 0.0 else 0.25 * radius_m
    rings = [
        radius_m * rim + [0, 0, low_m], radius_m * rim + [0, 0, high_m], inner * rim + [0, 0, high_m],
        inner * rim + [0, 0, low_m],
    ]  # fmt: skip
    points = np.concatenate(rings)
    index = np.arange(4 * around).reshape(4, around)
    follow = np.roll(index, -1, axis=1)
    parts = []
    for k in (0, 1, 2, 3) if bore_m > 0.0 else (0, 1, 3):
        a, b, c, d = index[k], follow[k], follow[(k + 1) % 4], index[(k + 1) % 4]
        parts += [np.column_stack((a, b, c)), np.column_stack((a, c, d))]
    if bore_m <= 0.0:
        points = np.concatenate((points, [[0, 0, high_m], [0, 0, low_m]]))
        top, bottom = np.full(around, 4 * around), np.full(around, 4 * around + 1)
        _, _, upper, lower = zip(index, follow, strict=True)
        parts += [np.column_stack((*upper, top)), np.column_stack((*reversed(lower), bottom))]
    return TriangleSolid(points, np.concatenate(parts))


def write_stl(path: str | Path, solid: TriangleSolid, name: str = "mufly") -> None:
    """Write a binary STL file in mm."""
    corners = _MM_PER_M * solid.points_m[solid.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0.0)
    table = np.zeros(corners.shape[0], dtype=[("v", "<f4", (4, 3)), ("a", "<u2")])
    table["v"] = np.concatenate((normal[:, None], corners), axis=1)
    head = f"{name}, mm".encode("ascii", "replace")[:80].ljust(80)
    Path(path).write_bytes(head + struct.pack("<I", corners.shape[0]) + table.tobytes())


def _import_build123d() -> Any:
    try:
        import build123d
    except ImportError as error:
        raise MuflyError(f"STEP needs build123d ({error}); pip install 'mufly[cad]'") from None
    return build123d


def write_step(path: str | Path, sections: Array) -> None:
    """Write a blade as a STEP file in mm: contours, (stations, points, 3), splined on both sides and lofted.

    Raises
    ------
    MuflyError
        If build123d (the extra ``cad``) is not installed, or cannot make a solid of them.
    """
    cad = _import_build123d()
    half = sections.shape[1] // 2
    wires = []
    for ring in _MM_PER_M * sections:
        points = [tuple(p) for p in ring.tolist()]
        sides_of = [cad.Spline(*points[:half]), cad.Spline(*points[half - 1 :])]
        if math.dist(points[0], points[-1]) > 1e-6:
            sides_of.append(cad.Line(points[-1], points[0]))
        wires.append(cad.Wire(sides_of))
    body = cad.Solid.make_loft(wires)
    if not body.is_valid:
        raise MuflyError("the stations make no valid body; give fewer stations")
    if not cad.export_step(body, str(path)):
        raise MuflyError(f"{path}: could not be written")


def read_step(path: str | Path) -> Array:
    """Read the solids of a STEP file as triangles within 0.01 mm and 0.1 rad: corners, (n, 3, 3) array (m).

    Raises
    ------
    MuflyError
        If build123d (the extra ``cad``) is not installed.
    InputError
        If the file contains no solid.
    """
    where, cad = Path(path).name, _import_build123d()
    if not Path(path).is_file():
        raise InputError(where, "", "is missing", "give a STEP file")
    try:
        points, faces = cad.import_step(str(path)).tessellate(0.01, 0.1)
    except Exception as error:  # OCP raises its own exception classes
        raise InputError(where, "", f"cannot be read ({error})", "give a STEP file of a body") from None
    if not faces:
        raise InputError(where, "", "contains no body", "give a STEP file of a body")
    xyz = np.array([(p.X, p.Y, p.Z) for p in points])
    return np.asarray(xyz[np.array(faces)] / _MM_PER_M, dtype=np.float64)


def read_stl(path: str | Path, unit_m: float = 1e-3) -> Array:
    """Read an STL file, binary or text: corners of its triangles, (n, 3, 3) array (m).

    Raises
    ------
    InputError
        If the file is not STL.
    """
    where = Path(path).name
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give an STL file") from error
    remedy = "give an STL file"
    if len(data) >= 84:
        (count,) = struct.unpack_from("<I", data, 80)
        if len(data) == 84 + 50 * count and count:
            table = np.frombuffer(data, dtype=[("v", "<f4", (4, 3)), ("a", "<u2")], offset=84)
            corners = table["v"][:, 1:].astype(np.float64)
            if not np.isfinite(corners).all():
                raise InputError(where, "", "has vertices that are not numbers", remedy)
            return unit_m * corners
    try:
        words = [line.split() for line in data.decode("utf-8").splitlines()]
        rows = [[float(v) for v in w[_STL_VERTEX_COORDINATE_WORDS]] for w in words if w[:1] == ["vertex"]]
    except ValueError:
        rows = []
    if not rows or len(rows) % 3 or any(len(r) != 3 for r in rows):
        raise InputError(where, "", "is not an STL file", remedy)
    return unit_m * np.array(rows).reshape(-1, 3, 3)


@dataclass(frozen=True, eq=False)
class BladeSlice:
    """Cross-section of a blade at a radius.

    Attributes
    ----------
    r_m, chord_m, twist_rad : float
    contour : (n, 2) array
        Coordinates over chord, in Selig's order.
    """

    r_m: float
    chord_m: float
    twist_rad: float
    contour: Array


class OrientedCut(NamedTuple):
    """Cut of a blade at a radius, its nose towards +y, clockwise, with the indices of nose and tail."""

    r_m: float
    cut: SectionCut
    nose: int
    tail: int


def cut_blade(corners_m: Array, r_m: Sequence[float] | Array) -> list[OrientedCut]:
    """Return the cuts of a triangle surface, (n, 3, 3), at radii; radii without a closed curve are skipped."""
    lines = [(float(r), cut) for r in r_m if (cut := cut_triangles(corners_m, float(r))) is not None]
    ends = [_farthest_points(cut.points_m) for _, cut in lines]
    ahead = sum(_find_leading_edge_sign(cut.points_m, i, j) for (_, cut), (i, j) in zip(lines, ends, strict=True))
    sign = 1.0 if ahead >= 0.0 else -1.0
    out = []
    for (r, cut), (i, j) in zip(lines, ends, strict=True):
        flat, bridged = cut.points_m * [sign, 1.0], cut.bridged
        if _signed_area(flat) > 0.0:  # nose to the right: tail, upper side, nose is clockwise
            flat, i, j = flat[::-1], len(flat) - 1 - i, len(flat) - 1 - j
            bridged = np.roll(bridged[::-1], -1)
        nose, tail = (i, j) if flat[i, 0] > flat[j, 0] else (j, i)
        out.append(OrientedCut(r, SectionCut(flat, bridged), nose, tail))
    return out


def slice_blade(corners_m: Array, r_m: Sequence[float] | Array) -> list[BladeSlice]:
    """Return the cross-sections of a triangle surface, (n, 3, 3), at radii; the method is in the module docstring.

    Radii without a closed curve are skipped.
    """
    return [_normalise_cut(cut.r_m, cut.cut.points_m, cut.nose, cut.tail) for cut in cut_blade(corners_m, r_m)]


def _normalise_cut(r: float, flat: Array, nose: int, tail: int) -> BladeSlice:
    """Return chord, twist and contour of a cut with its nose towards +y, clockwise."""
    # Corners of a blunt trailing edge, one of which is the farthest point: the chord ends midway between them.
    edge = np.flatnonzero(
        np.hypot(*(flat - flat[tail]).T) < _MAX_BLUNT_TAIL_CHORDS * np.hypot(*(flat[tail] - flat[nose]))
    )
    edge = edge[
        (flat[edge] - flat[nose]) @ (flat[tail] - flat[nose])
        > (1.0 - _BLUNT_TAIL_TOLERANCE_CHORDS) * np.sum((flat[tail] - flat[nose]) ** 2)
    ]
    upper, lower = edge[np.argmax(flat[edge, 1])], edge[np.argmin(flat[edge, 1])]
    end = 0.5 * (flat[upper] + flat[lower])
    to_tail = end - flat[nose]
    chord = float(np.hypot(*to_tail))
    along, across = to_tail / chord, np.array([to_tail[1], -to_tail[0]]) / chord
    moved = flat - flat[nose]
    contour = np.roll(np.column_stack((moved @ along, moved @ across)) / chord, -upper, axis=0)
    last = (lower - upper) % len(contour)
    # On rough tails the lower corner may precede the upper one.
    contour = contour[: last + 1] if 2 * last > len(contour) else np.concatenate((contour, contour[:1]))
    return BladeSlice(r, chord, math.atan2(-to_tail[1], -to_tail[0]), contour)


class SurfaceQuality(NamedTuple):
    """Scatter of a surface's vertices (m), excess of the outermost one (m), bridged part of the sections' outlines."""

    scatter_m: float
    tip_excess_m: float
    bridged_ratio: float
    noisy: bool


def _assess_surface(corners: Array, radius: float) -> SurfaceQuality:
    """Return the quality of a surface; sections of a noisy one are fitted."""
    cuts = cut_blade(corners, radius * np.linspace(0.4, 0.9, 11))
    if not cuts:
        return SurfaceQuality(0.0, 0.0, 0.0, False)
    scatter = float(np.median([estimate_scatter(c.cut.points_m, c.nose, c.tail) for c in cuts]))
    chord = float(np.median([float(np.hypot(*np.ptp(c.cut.points_m, axis=0))) for c in cuts]))
    bridged = float(np.mean([c.cut.bridged_ratio for c in cuts]))
    if scatter <= _MAX_EXACT_SCATTER_CHORDS * chord and bridged <= _MAX_EXACT_BRIDGED_RATIO:
        return SurfaceQuality(0.0, 0.0, bridged, False)
    # The outermost of n vertices at the tip lies beyond it by their greatest normal deviate.
    near = corners.reshape(-1, 3)[corners.reshape(-1, 3)[:, 0] > radius - 5.0 * scatter]
    count = len(np.unique(np.round(near / (1e-7 * radius)), axis=0))
    excess = _VERTEX_OVER_CUT_SCATTER * scatter * float(norm.ppf(1.0 - 0.6 / (count + 0.2)))
    return SurfaceQuality(scatter, max(excess, 0.0), bridged, True)


class FitQuality(NamedTuple):
    """Scatter of a surface, and standard deviations of the contours (m) and angles (rad) fitted to it."""

    scatter_m: float
    contour_std_m: float
    angle_std_rad: float


def _smooth_slices(corners: Array, r_m: Array, radius: float, scatter: float) -> tuple[list[BladeSlice], FitQuality]:
    """Return sections fitted to the cuts around each radius, and the quality of the fits between 0.4 and 0.9 R.

    The standard deviation is half the rms difference of fits to two halves of the cuts, which alternate in blocks.
    """
    grid = np.linspace(float(r_m[0]), radius - 4.0 * scatter, _FIT_GRID_COUNT)
    cuts = cut_blade(corners, grid)
    at = np.array([c.r_m for c in cuts])
    ends = [find_cut_ends(c.cut.points_m, c.nose, c.tail) for c in cuts]
    middles = corners[:, :, 0].mean(axis=1)

    def fit_slice(r: float, chosen: Integers, half: float, share: float) -> tuple[BladeSlice, float] | None:
        fit = None
        if chosen.size > 2:
            vertices = int(share * float(np.sum(np.abs(middles - r) < half))) // 2
            fit = fit_section(r, at[chosen], [cuts[k].cut for k in chosen], [ends[k] for k in chosen], vertices)
        if fit is None:
            return None
        return _normalise_cut(r, fit.points_m, *_find_nose_and_tail(fit.points_m)), fit.scatter_m

    slices, scatters, apart = [], [], []
    with threadpool_limits(1, "blas"):
        for r in r_m.tolist():
            half = min(_FIT_WINDOW_RADII * radius, max(0.5 * (radius - r), 0.01 * radius))
            near = np.flatnonzero(np.abs(at - r) < half)
            found = fit_slice(r, near, half, 1.0)
            if found is None:
                continue
            slices.append(found[0])
            if 0.4 * radius < r < 0.9 * radius:
                scatters.append(found[1])
                block = near // _BLOCK_CUTS % 2
                parts = [fit_slice(r, near[block == k], half, 0.5) for k in (0, 1)]
                if parts[0] is not None and parts[1] is not None:
                    apart.append(_compare_slices(parts[0][0], parts[1][0]))
    if len(slices) < 4 or not apart:
        raise InputError("blade", "", "has a surface too rough for its sections", "smooth or repeat the scan")
    contour, angle = 0.5 * np.sqrt(np.mean(np.square(apart), axis=0))
    return slices, FitQuality(float(np.median(scatters)), float(contour), float(angle))


def _compare_slices(one: BladeSlice, other: BladeSlice) -> tuple[float, float]:
    """Return the rms distance of two contours about their chord lines (m) and the difference of their angles (rad)."""
    x = np.linspace(0.02, 0.98, 49)
    sides = zip(split_sides(one.contour), split_sides(other.contour), strict=True)
    misses = [np.interp(x, *a.T) - np.interp(x, *b.T) for a, b in sides]
    return one.chord_m * float(np.sqrt(np.mean(np.square(misses)))), one.twist_rad - other.twist_rad


def _find_nose_and_tail(flat: Array) -> tuple[int, int]:
    i, j = _farthest_points(flat)
    return (i, j) if flat[i, 0] > flat[j, 0] else (j, i)


def _find_leading_edge_sign(loop: Array, i: int, j: int) -> float:
    """Return a positive value if the leading edge of a section is its end with the greater y, else a negative one.

    The leading edge is the thicker end, or, at equal thickness, the higher end.
    """
    front, back = (i, j) if loop[i, 0] > loop[j, 0] else (j, i)
    chord = loop[back] - loop[front]
    size = float(np.hypot(*chord))
    along = (loop - loop[front]) @ chord / size**2
    across = (loop - loop[front]) @ [chord[1], -chord[0]] / size**2
    first, last = (
        float(np.ptp(across[part]))
        for part in (along < _END_THICKNESS_REGION_CHORDS, along > 1.0 - _END_THICKNESS_REGION_CHORDS)
    )
    if abs(first - last) > _END_THICKNESS_TOLERANCE_FRACTION * max(first, last):
        return math.copysign(1.0, first - last)
    return math.copysign(1.0, -chord[1]) if chord[1] else 0.0


def rotor_from_body(
    path: str | Path,
    *,
    unit_m: float | None = None,
    folder: str | Path,
    blades: int | None = None,
    name: str = "",
    axis: str | None = None,
    centre: Sequence[float] | None = None,
) -> tuple[Rotor, tuple[str, ...]]:
    """Make a rotor from the solid of a blade or of a whole rotor; write the contours of its sections to ``folder``.

    Parameters
    ----------
    path : str or Path
        STL or STEP file; the shaft lies along z through the origin, thrust upwards. A body whose blades lie elsewhere
        in the plane of the disc is turned; a hub is removed. A whole rotor is moved onto its shaft, and turned over if
        it lies upside down.
    unit_m : float, optional
        Unit of length of an STL file (m); STEP files state it. Default: mm, if the radius is then plausible.
    folder : str or Path
        Folder of the contours ``NAME-K.dat``, to which the rotor refers.
    blades : int, optional
        Number of blades. Default: those of the body; 2 if it is a single blade.
    name : str
        Name of the rotor. Default: the file's.
    axis : str, optional
        Direction of the thrust in the file, one of :data:`mufly.rotor.blades.scanned_pose.SHAFT_DIRECTIONS`. Default:
        z, or -z if the body lies upside down.
    centre : sequence of float, optional
        Point of the shaft, x, y and optionally z, in the file's axes (m). Default: the origin, or the axis of symmetry
        of a whole rotor.

    Returns
    -------
    rotor : Rotor
    notes : tuple of str
        Values that were guessed.

    Raises
    ------
    InputError
        If the file contains no solid, or no plane cuts a closed section.
    """
    where, called = Path(path).name, name or Path(path).stem
    step = Path(path).suffix.lower() in (".step", ".stp")
    notes: list[str] = []
    corners = read_step(path) if step else read_stl(path, unit_m or 1.0 / _MM_PER_M)
    corners, counted = _place_on_shaft(corners, where, axis, centre, notes)
    corners, turned = _turn_blade_to_x(corners)
    corners = _turn_upright(corners, notes, given=axis is not None)
    radius = float(corners[:, :, 0].max())
    if not radius > 0.0:
        raise InputError(where, "", "has no surface at x > 0", "orient the body: one blade along x, shaft along z")
    outer = corners[
        (corners[:, :, 0] > 0.5 * radius).all(axis=1) & (np.abs(corners[:, :, 1]) < 0.5 * radius).all(axis=1)
    ]
    if outer.size and np.ptp(outer[:, :, 2]) > np.ptp(outer[:, :, 1]):
        raise InputError(
            where, "", "has a blade with its chord along z, the direction of the shaft",
            "give --axis with the direction of the thrust in the file, as --axis x",
        )  # fmt: skip
    share = np.linspace(0.05, 1.0, 200)[:-1]
    found = {s.r_m: s for s in slice_blade(corners, radius * share)}
    # The blade begins at the innermost radius where the section's nose lies in front of the x axis and its tail behind.
    good = [s for s in found.values() if s.chord_m < 0.6 * radius and float(np.ptp(s.contour[:, 1])) < 0.5]
    quality = _assess_surface(corners, radius)
    good = _drop_hub_slices(good, float(share[1] - share[0]) * radius, noisy=quality.noisy)
    if len(good) < 4:
        raise InputError(where, "", "has no closed sections along x", "give one closed blade along x")
    least, greatest = (
        (_MIN_RADIUS_IF_MM_M, _MAX_RADIUS_IF_MM_M) if unit_m is None else (_MIN_ROTOR_RADIUS_M, _MAX_ROTOR_RADIUS_M)
    )
    if not step and not least <= radius <= greatest:
        written = radius / (unit_m or 1.0 / _MM_PER_M)
        likely = [
            f"{u} (R {_MM_PER_M * f * written:.4g} mm)" for u, f in _LENGTH_UNITS_M.items() if 0.01 < f * written < 0.7
        ]
        problem = (
            f"is not known: {where} reaches {written:.4g} along x, in mm no rotor's radius"
            if unit_m is None
            else f"is wrong: {where} would have a radius of {_MM_PER_M * radius:.4g} mm"
        )
        raise ArgumentError("unit", "", problem, f"give its unit, as unit={' or '.join(likely) or 'mm'}")
    first = good[0].r_m
    radius -= quality.tip_excess_m
    if counted == 1:
        _check_shaft_of_blade(corners, where, radius, first, given=centre is not None, notes=notes)
    inner = float(corners[:, :, 0].min())
    first = max(first, inner + _TIP_MARGIN_SCATTERS * quality.scatter_m if inner > 0.0 else 0.0)
    last = radius - max(0.005 * radius, _TIP_MARGIN_SCATTERS * quality.scatter_m)
    wanted = first + (last - first) * 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, 15)))
    if quality.noisy:
        cut, fit = _smooth_slices(corners, wanted, radius, quality.scatter_m)
        notes.append(
            f"the surface scatters by {_MM_PER_M * fit.scatter_m:.2g} mm: smooth sections were fitted, with standard "
            f"deviations of {_MM_PER_M * fit.contour_std_m:.2g} mm of the contour and "
            f"{math.degrees(fit.angle_std_rad):.2g} degrees of the angle"
        )
    else:
        cut = slice_blade(corners, wanted)
    if quality.bridged_ratio > 0.0:
        notes.append(
            f"gaps of the surface were closed: {100 * quality.bridged_ratio:.1f} % of the outlines of the sections"
        )
    files = []
    for k, s in enumerate(cut):
        file = Path(folder) / f"{called}-{k}.dat"
        rows = "\n".join(f"{x:.6f} {y:.6f}" for x, y in _drop_duplicate_points(s.contour))
        file.write_text(f"{called}, r {_MM_PER_M * s.r_m:.2f} mm\n{rows}\n", encoding="utf-8")
        load_airfoil(file)
        files.append(str(file))
    x = np.array([s.r_m / radius for s in cut])
    x[-1] = 1.0
    notes[:0] = [f"{len(cut)} sections from {x[0]:.2f} R on, sweep and rake are ignored"]
    if turned:
        notes.append(f"the body was turned by {math.degrees(turned):.0f} degrees about the shaft: a blade lies along x")
    if counted > 1 and counted != blades:
        stated = "" if blades is None else f", not {blades}: --blades prevails"
        notes.append(f"the body has {counted} blades{stated}")
    elif counted == 1 and blades is None:
        notes.append("two blades assumed; give --blades for another number")
    blades = blades or (counted if counted > 1 else 2)
    rotor = make_rotor(
        name=called, radius_m=radius, chord_m=[s.chord_m for s in cut], twist_rad=[s.twist_rad for s in cut],
        airfoils=files, r_over_R=x, blades=blades or 2, hub_cutout=float(x[0]), source="CAD",
        description=f"cut from {where}",
    )  # fmt: skip
    return rotor, tuple(notes)


def _place_on_shaft(
    corners: Array, where: str, axis: str | None, centre: Sequence[float] | None, notes: list[str]
) -> tuple[Array, int]:
    """Return the body with its shaft along z through the origin, and its number of blades."""
    if axis is not None and axis not in SHAFT_DIRECTIONS:
        raise ArgumentError("axis", repr(axis), "is unknown", f"use one of: {', '.join(SHAFT_DIRECTIONS)}")
    if centre is not None:
        if len(centre) not in (2, 3) or not np.all(np.isfinite(centre)):
            raise ArgumentError("centre", "", "is no point", "give x,y or x,y,z of a point of the shaft")
        corners = corners - np.array([*centre, 0.0])[:3]
    if axis is not None:
        corners = corners @ np.array(SHAFT_DIRECTIONS[axis]).T
    shaft = find_shaft(corners)
    if centre is None and shaft.centre_m != (0.0, 0.0):
        corners = corners - [*shaft.centre_m, 0.0]
        x, y = (f"{_MM_PER_M * v:.2f}" for v in shaft.centre_m)
        notes.append(f"the rotor's axis of symmetry lies at ({x}, {y}) mm: moved there; --centre gives another shaft")
    counted = shaft.blades if shaft.blades > 1 and centre is None else count_blades(corners)
    if counted > _MAX_BLADES_OF_A_BODY:
        raise InputError(where, "", f"would have {counted} blades", "give --centre, a point of the shaft")
    return corners, counted


def _turn_upright(corners: Array, notes: list[str], *, given: bool) -> Array:
    """Return a body turned over about x if that makes angle or camber positive at mid-span."""
    over = corners * [1.0, -1.0, -1.0]
    as_given = _count_plausible_signs(corners)
    if not given and _count_plausible_signs(over) > as_given:
        notes.append("the body lay upside down, with negative thrust, and was turned over; --axis z keeps it as it is")
        return over
    if as_given < 2:
        notes.append("blade angle or camber is negative at mid-span: if the body lies upside down, give --axis -z")
    return corners


def _count_plausible_signs(corners: Array) -> int:
    """Return how many of blade angle and camber at mid-span are not negative."""
    slices = slice_blade(corners, float(corners[:, :, 0].max()) * np.linspace(0.5, 0.85, 8))
    if not slices:
        return 2
    cambers = []
    for s in slices:
        upper, lower = split_sides(s.contour)
        cambers.append(0.5 * float(np.interp(0.5, *upper.T) + np.interp(0.5, *lower.T)))
    twist = float(np.median([s.twist_rad for s in slices]))
    return int(twist > -_MAX_SIGN_ERROR_RAD) + int(float(np.median(cambers)) > -_MAX_SIGN_ERROR_CHORDS)


def _check_shaft_of_blade(
    corners: Array, where: str, radius: float, first: float, *, given: bool, notes: list[str]
) -> None:
    """Raise an error if the cuts of a single blade do not point to the shaft; note a blade that begins far out."""
    cuts = cut_blade(corners, first + (radius - first) * np.linspace(0.1, 0.9, 9))
    if given or len(cuts) < 4:
        return
    r = np.array([c.r_m for c in cuts])
    low, high = (float(np.polyfit(r, [edge(c.cut.points_m[:, 0]) for c in cuts], 1)[1]) for edge in (np.min, np.max))
    miss = max(min(low, high), -max(low, high), 0.0)
    if miss > _MAX_SHAFT_MISS_RADII * radius:
        raise InputError(
            where, "", f"has a blade that passes the shaft at {_MM_PER_M * miss:.3g} mm",
            "give --centre X,Y, a point of the shaft in the file",
        )  # fmt: skip
    if first > _MAX_USUAL_ROOT_RADII * radius:
        notes.append(
            f"the blade begins at {first / radius:.2f} R: is the shaft at the origin of the file? --centre moves it"
        )


def _turn_blade_to_x(corners: Array) -> tuple[Array, float]:
    """Turn a body about the shaft, z, until its longest blade lies along x; return it and the angle (rad).

    A body that already reaches its radius within 20 degrees of x is not turned, because a swept tip does not show the
    direction of the blade. Otherwise the middle of the chord is fitted by a r + b w over the radius r and the width w
    of the blade, and a is the remaining angle of the blade.
    """
    points = corners.reshape(-1, 3)
    size, angle = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    tips = size > 0.99 * size.max()
    if np.any(tips & (np.abs(angle) < _MAX_ASSUMED_TIP_SWEEP_RAD)):
        return corners, 0.0
    first = angle[np.argmax(size)]
    apart = (angle - first + math.pi) % (2.0 * math.pi) - math.pi
    blade = (size > 0.7 * size.max()) & (np.abs(apart) < _MAX_ASSUMED_TIP_SWEEP_RAD)
    turn = -float(first + 0.5 * (apart[blade].min() + apart[blade].max()))
    near = _turn_about_shaft(corners, turn)
    radii = float(near[:, :, 0].max()) * np.linspace(0.35, 0.95, 13)
    cuts = [(r, cut.points_m[:, 0]) for r in radii if (cut := cut_triangles(near, float(r))) is not None]
    if len(cuts) > 2:
        ends = np.array([(r, y.min(), y.max()) for r, y in cuts])
        shape = np.column_stack((ends[:, 0], ends[:, 2] - ends[:, 1]))
        turn -= math.atan(float(np.linalg.lstsq(shape, 0.5 * (ends[:, 1] + ends[:, 2]), rcond=None)[0][0]))
    return _turn_about_shaft(corners, turn), turn


def _turn_about_shaft(corners: Array, angle_rad: float) -> Array:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def _drop_hub_slices(slices: list[BladeSlice], step_m: float, *, noisy: bool = False) -> list[BladeSlice]:
    """Return the slices outside the hub, where chord, thickness or angle jump, or where cuts are missing.

    On noisy surfaces, medians over five cuts are compared.
    """
    table = np.array([(math.log(s.chord_m), math.log(float(np.ptp(s.contour[:, 1]))), s.twist_rad) for s in slices])
    if noisy:
        padded = np.concatenate((table[:1], table[:1], table, table[-1:], table[-1:]))
        table = np.median([padded[k : k + len(table)] for k in range(5)], axis=0)
    middle = next((k for k, s in enumerate(slices) if s.r_m > 0.5 * slices[-1].r_m), 0)
    for k in range(middle, 0, -1):
        jump, bent = np.max(np.abs(table[k, :2] - table[k - 1, :2])), abs(table[k, 2] - table[k - 1, 2])
        if (
            slices[k].r_m - slices[k - 1].r_m > (6.5 if noisy else 2.5) * step_m
            or jump > _MAX_BLADE_CHORD_JUMP_FRACTION
            or bent > _MAX_BLADE_TWIST_JUMP_RAD
        ):
            return slices[k:]
    return slices


_MAX_ASSUMED_TIP_SWEEP_RAD = math.radians(20.0)
_MAX_BLADE_CHORD_JUMP_FRACTION, _MAX_BLADE_TWIST_JUMP_RAD = (
    0.2,
    math.radians(8.0),
)  # of chord or thickness; of the angle, between neighbouring cuts


def _drop_duplicate_points(contour: Array) -> Array:
    """Return a contour without coincident points."""
    step = np.hypot(*np.diff(contour, axis=0).T)
    return contour[np.concatenate(([True], step > 1e-5))]


def _signed_area(loop: Array) -> float:
    x, y = loop.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _farthest_points(loop: Array) -> tuple[int, int]:
    """Return the indices of the two points of a curve that are furthest apart."""
    apart = np.sum((loop[:, None] - loop[None]) ** 2, axis=2)
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    return int(i), int(j)
