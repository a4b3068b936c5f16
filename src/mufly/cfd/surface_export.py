"""Export of blade surfaces with pressure and friction as VTP (ParaView) and glTF 2.0 (browsers).

VTP is VTK's XML of polygons, version 1.0: arrays of little-endian numbers, each preceded by its length in bytes,
appended in base64 (VTK File Formats, Kitware). A binary glTF has two chunks, JSON and numbers (Khronos glTF 2.0, sec.
4.4). Its frame is y up in metres, so that the shaft lies along y. Each face has a single colour.
"""

from __future__ import annotations

import base64
import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mufly.cfd.cfd_solution import CfdSolution, FlowField
from mufly.cfd.meshes.polymesh import PolyMesh
from mufly.cfd.openfoam_case import OperatingPoint
from mufly.errors import convert_write_errors

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_VTK_TYPES = {
    "float64": "Float64",
    "float32": "Float32",
    "int64": "Int64",
    "int32": "Int32",
    "uint8": "UInt8",
}


def extract_blade_surface(mesh: PolyMesh, solution: CfdSolution) -> tuple[Array, Index, dict[str, NDArray]]:
    """Extract the walls of all blades: points, faces and data on the faces.

    Returns
    -------
    points : (points, 3) array
        Coordinates (m).
    faces : (faces, 4) array
        Anticlockwise from outside.
    data : dict of (faces,) and (faces, 3) arrays
        ``pressure_Pa``, ``friction_Pa`` (shear stress of the air on the wall), ``yplus``, ``blade``.
    """
    own = mesh.faces[mesh.patch_face_slice("blade")][:, ::-1]  # normals of the mesh point out of the air
    used, faces = np.unique(own, return_inverse=True)
    faces = faces.reshape(own.shape)
    points, shear, rings = [], [], []
    for i in range(mesh.blade_count):
        turn = 2.0 * math.pi * i / mesh.blade_count
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        points.append(mesh.points[used] @ rotation)
        shear.append(solution.friction_Pa @ rotation)
        rings.append(faces + i * len(used))
    n = mesh.blade_count
    data: dict[str, NDArray] = {
        "pressure_Pa": np.tile(solution.pressure_Pa, n), "friction_Pa": np.concatenate(shear),
        "yplus": np.tile(solution.yplus, n), "blade": np.repeat(np.arange(n), len(faces)),
    }  # fmt: skip
    return np.concatenate(points), np.concatenate(rings), data


def interpolate_cells_to_points(mesh: PolyMesh, values: Array) -> Array:
    """Interpolate cell values to the points by inverse distance, with equal values on both periodic planes."""
    total, weight = np.zeros(len(mesh.points)), np.zeros(len(mesh.points))
    inside = len(mesh.neighbour)
    for faces, cells in ((mesh.faces, mesh.owner), (mesh.faces[:inside], mesh.neighbour)):
        near = 1.0 / np.linalg.norm(mesh.points[faces] - mesh.cell_centres[cells][:, None], axis=-1)
        total += np.bincount(faces.ravel(), (near * values[cells][:, None]).ravel(), len(total))
        weight += np.bincount(faces.ravel(), near.ravel(), len(total))
    left = mesh.faces[mesh.patch_face_slice("sector_left")]
    right = mesh.faces[mesh.patch_face_slice("sector_right")][:, _REVERSED_CORNER_ORDER]
    pairs = np.unique(np.stack((left.ravel(), right.ravel()), axis=-1), axis=0)
    for sums in (total, weight):
        both = sums[pairs].sum(axis=1)
        sums[pairs[:, 0]], sums[pairs[:, 1]] = both, both
    return total / np.maximum(weight, 1e-300)


def extract_iso_surface(
    mesh: PolyMesh, values: Array, level: float, *, among: NDArray[np.bool_] | None = None
) -> tuple[Array, Index]:
    """Extract a closed isosurface of a cell quantity by marching tetrahedra.

    Every cell is divided into 24 tetrahedra, from its centre and the centres of its faces to their edges. The quantity
    is linear in each; values at points come from :func:`interpolate_cells_to_points`. Source: Doi and Koide, IEICE
    Transactions E74-D, 1991.

    Parameters
    ----------
    mesh : PolyMesh
    values : (cells,) array
        Quantity in the cells.
    level : float
        Value of the quantity on the surface.
    among : (cells,) array of bool, optional
        Cells to be used; default: all.

    Returns
    -------
    points : (points, 3) array
        Coordinates (m).
    triangles : (triangles, 3) array
        Point indices, anticlockwise seen from the side of lower values. Neighbours share points: inside the mesh every
        edge belongs to two triangles.
    """
    at_points = interpolate_cells_to_points(mesh, values)
    inside = len(mesh.neighbour)
    faces = np.concatenate((mesh.faces, mesh.faces[:inside]))
    cell = np.concatenate((mesh.owner, mesh.neighbour))
    # Only cells with values on both sides of the level are cut.
    low, high = values.copy(), values.copy()
    np.minimum.at(low, cell, at_points[faces].min(axis=1))
    np.maximum.at(high, cell, at_points[faces].max(axis=1))
    wanted = (low < level) & (high > level)
    if among is not None:
        wanted &= among
    faces, cell = faces[wanted[cell]], cell[wanted[cell]]
    corner, value = mesh.points[faces], at_points[faces]
    n = 4 * len(faces)
    place, scalar = np.empty((len(faces), 4, 4, 3)), np.empty((len(faces), 4, 4))
    place[:, :, _CELL_CENTRE_CORNER], scalar[:, :, _CELL_CENTRE_CORNER] = (
        mesh.cell_centres[cell][:, None],
        values[cell][:, None],
    )
    place[:, :, _FACE_CENTRE_CORNER], scalar[:, :, _FACE_CENTRE_CORNER] = (
        corner.mean(axis=1)[:, None],
        value.mean(axis=1)[:, None],
    )
    place[:, :, _FACE_CORNER], scalar[:, :, _FACE_CORNER] = corner, value
    place[:, :, _NEXT_FACE_CORNER], scalar[:, :, _NEXT_FACE_CORNER] = (
        np.roll(corner, -1, axis=1),
        np.roll(value, -1, axis=1),
    )
    four: Array = place.reshape(n, 4, 3)
    four_values: Array = scalar.reshape(n, 4)
    order = np.argsort(-four_values, axis=1)  # the highest first
    four = np.take_along_axis(four, order[..., None], 1)
    four_values = np.take_along_axis(four_values, order, 1)
    above = (four_values > level).sum(axis=1)

    # Edges on which a tetrahedron is cut, by the number of its corners above the level.
    cuts = {1: [(0, 1, 0, 2, 0, 3)], 2: [(0, 2, 0, 3, 1, 2), (0, 3, 1, 3, 1, 2)], 3: [(0, 3, 1, 3, 2, 3)]}
    parts = []
    for count, triangles in cuts.items():
        p, s = four[above == count], four_values[above == count]
        down = p[:, count:].mean(axis=1) - p[:, :count].mean(axis=1)
        for ends in triangles:
            one = []
            for a, b in zip(ends[::2], ends[1::2], strict=True):
                share = (s[:, a] - level) / (s[:, a] - s[:, b])
                one.append(p[:, a] + share[:, None] * (p[:, b] - p[:, a]))
            t = np.stack(one, axis=1)
            normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
            wrong = np.einsum("ti,ti->t", normal, down) < 0.0
            t[wrong] = t[wrong][:, ::-1]
            parts.append(t[np.linalg.norm(normal, axis=1) > 0.0])
    return _weld_triangles(np.concatenate(parts))


_WELD_TOLERANCE = 1e-6
_CELL_CENTRE_CORNER, _FACE_CENTRE_CORNER, _FACE_CORNER, _NEXT_FACE_CORNER = range(4)  # corners of a tetrahedron
_REVERSED_CORNER_ORDER = (0, 3, 2, 1)  # corners of a face
"""Distance below which points are merged, over the largest coordinate."""


def _weld_triangles(triangles: Array) -> tuple[Array, Index]:
    """Merge corners, (triangles, 3, 3), to points and indices; triangles with fewer than three points are dropped."""
    corners = triangles.reshape(-1, 3)
    if not len(corners):
        return corners, np.empty((0, 3), dtype=np.int64)
    key = np.round(corners / (_WELD_TOLERANCE * float(np.abs(corners).max()))).astype(np.int64)
    _, first, of = np.unique(key, axis=0, return_index=True, return_inverse=True)
    index = of.reshape(-1, 3)
    a, b, c = index.T
    return corners[first], index[(a != b) & (b != c) & (c != a)]


VORTEX_SURFACE_Q_LEVEL = 0.03
"""Level of Q, over (tip speed / chord) squared, of the surfaces that show vortices.

A vortex of circulation G with a uniform core of radius a has the vorticity w = G / (pi a^2) and Q = w^2 / 4. A blade at
a lift coefficient of 0.6 sheds G = 0.3 c V. This level shows its tip vortex until the core radius exceeds half a chord,
a = 0.52 c.
"""


def extract_vortex_surface(
    mesh: PolyMesh, flow: FlowField, point: OperatingPoint
) -> tuple[Array, Index, dict[str, NDArray]]:
    """Extract all blades' vortices within 2 R: surfaces of :data:`VORTEX_SURFACE_Q_LEVEL` outside the boundary layer.

    Cells closer to a wall than the thickness of a laminar boundary layer at the tip's trailing edge, 5 c / sqrt(V c /
    nu), are left out. Source: Blasius, in Schlichting, Boundary-Layer Theory, 1979, ch. VII.

    Returns
    -------
    points : (points, 3) array
        m.
    triangles : (triangles, 3) array
    data : dict of (triangles,) arrays
        ``vorticity_1_s`` (its magnitude) and ``down_m_s``, of the cell whose centre is nearest, and ``blade``.
    """
    speed = point.radius_m * max(abs(speed) for speed in point.patch_speeds_rad_s.values())
    chord = _find_median_chord_m(mesh)
    wall = np.concatenate([mesh.face_centres[mesh.patch_face_slice(name)] for name in point.patch_speeds_rad_s])
    layer = 5.0 * chord / math.sqrt(speed * chord / point.kinematic_viscosity_m2_s)
    among = np.linalg.norm(mesh.cell_centres, axis=1) < 2.0 * point.radius_m
    among &= cKDTree(wall).query(mesh.cell_centres, distance_upper_bound=layer)[0] > layer
    points, triangles = extract_iso_surface(
        mesh, flow.q_1_s2, VORTEX_SURFACE_Q_LEVEL * (speed / chord) ** 2, among=among
    )
    cell = cKDTree(mesh.cell_centres).query(points[triangles].mean(axis=1))[1] if len(triangles) else np.empty(0, int)
    spin = np.linalg.norm(flow.vorticity_1_s, axis=1)[cell]
    n, around = mesh.blade_count, []
    for i in range(n):
        c, s = math.cos(2.0 * math.pi * i / n), math.sin(2.0 * math.pi * i / n)
        around.append(points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
    rings = [triangles + i * len(points) for i in range(n)]
    data: dict[str, NDArray] = {
        "vorticity_1_s": np.tile(spin, n).astype(np.float32),
        "down_m_s": np.tile(-flow.velocity_m_s[cell, 2], n).astype(np.float32),
        "blade": np.repeat(np.arange(n, dtype=np.uint8), len(triangles)),
    }
    return np.concatenate(around), np.concatenate(rings), data


def _find_median_chord_m(mesh: PolyMesh) -> float:
    """Return the blade's median chord (m) over its strips; a strip's chord is half its wall area per span."""
    faces = mesh.patch_face_slice("blade")
    strip, width = mesh.cell_strip[mesh.owner[faces]], np.diff(mesh.strip_edges_m)
    area = np.linalg.norm(mesh.face_areas[faces], axis=1)
    own = (strip >= 0) & (strip < len(width))
    return float(np.median(np.bincount(strip[own], area[own], len(width)) / (2.0 * width)))


def average_faces_at_points(points: Array, faces: Index, values: NDArray) -> Array:
    """Return the mean of the adjacent face values (faces,) at each point; (points,) array."""
    each = faces.shape[1]
    count = np.bincount(faces.ravel(), minlength=len(points))
    total = np.bincount(faces.ravel(), np.repeat(values, each), len(points))
    return np.asarray(total / np.maximum(count, 1), dtype=np.float64)


def write_vtp(file: Path, points: Array, faces: Index, data: Mapping[str, NDArray]) -> Path:
    """Write polygons with data on their faces; points in single precision.

    Parameters
    ----------
    file : Path
    points : (points, 3) array
        m.
    faces : (faces, corners) array
        Point indices of each polygon.
    data : dict of (faces,) or (faces, 3) arrays
        Data on the faces by name.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    blocks: list[bytes] = []
    at = 0

    def append_array(name: str, values: NDArray) -> str:
        nonlocal at
        little = np.ascontiguousarray(values)
        raw = little.astype(little.dtype.newbyteorder("<")).tobytes()
        block = base64.b64encode(struct.pack("<Q", len(raw)) + raw)
        width = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        text = (
            f'<DataArray type="{_VTK_TYPES[little.dtype.name]}" Name={quoteattr(name)}{width} format="appended" '
            f'offset="{at}"/>'
        )
        blocks.append(block)
        at += len(block)
        return text

    each = faces.shape[1]
    parts = [
        "<Points>" + append_array("Points", np.asarray(points, dtype=np.float32)) + "</Points>",
        "<Polys>" + append_array("connectivity", faces.astype(np.int32).ravel())
        + append_array("offsets", each * np.arange(1, len(faces) + 1, dtype=np.int32)) + "</Polys>",
        "<CellData>" + "".join(append_array(name, values) for name, values in data.items()) + "</CellData>",
    ]  # fmt: skip
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">\n<PolyData>\n'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" '
        f'NumberOfPolys="{len(faces)}">\n' + "\n".join(parts) + "\n</Piece>\n</PolyData>\n"
        '<AppendedData encoding="base64">\n_'
    )
    return _write_bytes(file, text.encode() + b"".join(blocks) + b"\n</AppendedData>\n</VTKFile>\n")


def write_glb(
    file: Path,
    points: Array,
    faces: Index,
    colours: NDArray[np.uint8],
    name: str = "rotor",
    *,
    shared: bool = False,
) -> Path:
    """Write quadrilaterals or triangles as a binary glTF, coloured by face or by point.

    Parameters
    ----------
    file : Path
    points : (points, 3) array
        m, z up.
    faces : (faces, 4) or (faces, 3) array
        Anticlockwise from outside.
    colours : (faces, 3) array of uint8
        Red, green, blue, linear; with ``shared`` (points, 3).
    name : str
    shared : bool
        True for colours of points, which neighbours share. The file has a fifth of the size and no normals; viewers use
        flat shading.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    each = faces.shape[1]
    turned = points[..., [0, 2, 1]] * np.array([1.0, 1.0, -1.0])  # z up becomes y up
    corner = turned[faces]
    position = (turned if shared else corner.reshape(-1, 3)).astype("<f4")
    ring = [0, 1, 2, 0, 2, 3][: 3 * each - 6]
    index = faces[:, ring] if shared else each * np.arange(len(faces))[:, None] + np.array(ring)
    paint = np.full((len(colours), 4), 255, dtype=np.uint8)
    paint[:, :3] = colours
    arrays = {"POSITION": (position, 5126, "VEC3")}
    if not shared:
        normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, -1] - corner[:, 1])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        arrays["NORMAL"] = (np.repeat(normal, each, axis=0).astype("<f4"), 5126, "VEC3")
    arrays["COLOR_0"] = (paint if shared else np.repeat(paint, each, axis=0), 5121, "VEC4")
    arrays["indices"] = (index.astype("<u4").ravel(), 5125, "SCALAR")
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    at = 0
    for what, (values, kind, shape) in arrays.items():
        size = values.nbytes
        views.append(
            {
                "buffer": 0,
                "byteOffset": at,
                "byteLength": size,
                "target": 34963 if what == "indices" else 34962,
            }
        )
        accessors.append(
            {"bufferView": len(accessors), "componentType": kind, "count": len(values), "type": shape}
            | ({"normalized": True} if what == "COLOR_0" else {})
            | (
                {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
                if what == "POSITION" and len(position)
                else {}
            )
        )
        at += size
    tree = {
        "asset": {"version": "2.0", "generator": "mufly"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": [
            {"attributes": {k: i for i, k in enumerate(arrays) if k != "indices"},
             "indices": len(arrays) - 1, "material": 0}
        ]}],
        "materials": [{
            "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        }],
        "buffers": [{"byteLength": at}], "bufferViews": views, "accessors": accessors,
    }  # fmt: skip
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(values.tobytes() for values, _, _ in arrays.values())  # every part has a multiple of 4 bytes
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    return _write_bytes(
        file,
        head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body,
    )


def map_colours(values: Array) -> NDArray[np.uint8]:
    """Map values to colours between the 1st and 99th percentile; (faces, 3) array, linear RGB for glTF."""
    from matplotlib import colormaps

    low, high = np.percentile(values, (1, 99)) if len(values) else (0.0, 1.0)
    shown = colormaps["viridis"]((values - low) / max(high - low, 1e-300))[:, :3]
    return np.round(255.0 * np.clip(shown, 0.0, 1.0) ** 2.2).astype(np.uint8)


def _write_bytes(file: Path, content: bytes) -> Path:
    with convert_write_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    return file
