"""Blades as solids: closed triangle surfaces to print or to mesh, and their files in STL and STEP.

Frame: the blade lies along x, its leading edge towards y, the shaft along z with thrust upwards. The pitch axis is the
quarter chord. Lengths are in m; in STL files, which have no unit, they are in mm.

Every station has a contour with points at the same chord fractions on both sides (cosine spacing). Contours are mixed
between stations as the polars are, opened at the trailing edge to the printable thickness, turned by the twist and
moved to their radius. Triangles join neighbouring contours and close the ends. Every edge belongs to two triangles that
traverse it in opposite directions, so the surface is watertight. Its volume follows from the divergence theorem,
V = sum a.(b x c) / 6.

:mod:`mufly.rotor.blades.body_import` makes a rotor from such a file.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.rotor.geometry import Rotor
from mufly.rotor.sections.airfoil import load_airfoil, split_sides
from mufly.rotor.sections.polar_file import is_polar_file
from mufly.rotor.validity_checks import check_pitch

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_POINTS_PER_SIDE = 40
_SPAN_STATION_COUNT = 60
_MM_PER_M = 1e3
_STL_VERTEX_COORDINATE_WORDS = slice(1, 4)  # words of a line that begins with "vertex"


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
