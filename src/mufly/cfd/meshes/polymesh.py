"""Polyhedral meshes in OpenFOAM's format: faces, mesh quality, and files.

OpenFOAM stores faces, each with its owner cell and its neighbour cell (the higher number). Internal faces come first,
sorted by owner and neighbour, then the faces of each boundary. Face k of one half of a ``cyclic`` boundary matches face
k of the other half, whose points run in the opposite sense from the same first point.

Quality is measured as by ``checkMesh``. Non-orthogonality is the angle between a face's normal and the line between the
two cell centres. Skewness is the distance between the face's centre and the intersection of that line with the face,
over the line's length or, if larger, a fifth of the face's size in that direction.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from mufly.cfd.meshes.sector_mesh import SectorMesh
from mufly.errors import InputError, MuflyError
from mufly.results import ShownBlock, result, tabulate_fields

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Faces of a hexahedron, normals outwards.
_HEXAHEDRON_FACES = np.array(
    [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)], dtype=np.int64
)
PATCH_NAMES = ("sector_left", "sector_right", "top", "side", "bottom", "blade")
"""Boundary patches: the periodic planes (x below and above 0), top, side and bottom of the cylinder, and the blade."""
LOWER_ROTOR_BLADE_PATCH = "blade_lower"
"""Patch of the blade of a second rotor below the first."""


@dataclass(frozen=True, eq=False)
class PolyMesh:
    """Mesh in OpenFOAM's format.

    Attributes
    ----------
    points : (points, 3) array
        Coordinates (m).
    faces : (faces, 4) array
        Point indices; the normal points out of the owner.
    owner : (faces,) array
        Cell on the inner side of each face.
    neighbour : (inside faces,) array
        Cell on the other side of each inside face.
    patches : dict of (start, count)
        First face and number of faces by patch name.
    cell_strip : (cells,) array
        Spanwise strip of the blade that contains the cell, or -1.
    strip_edges_m : (strips + 1,) array
    blade_count : int
    is_rotating : (cells,) bool array
        True for cells in a rotating frame.
    interface_height_m : float
        Height of the plane above the cells of a second rotor; -inf without one.
    """

    points: Array
    faces: Index
    owner: Index
    neighbour: Index
    patches: dict[str, tuple[int, int]]
    cell_strip: Index
    strip_edges_m: Array
    blade_count: int
    is_rotating: NDArray[np.bool_]
    interface_height_m: float = -math.inf

    @cached_property
    def cell_rotation_sign(self) -> Array:
        """Rotation of each cell's frame: 1 with the rotor, -1 with a second rotor below, 0 at rest; (cells,)."""
        return np.where(self.is_rotating, np.where(self.cell_centres[:, 2] < self.interface_height_m, -1.0, 1.0), 0.0)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.cell_strip)

    def patch_face_slice(self, name: str) -> slice:
        """Return the indices of the faces of a patch."""
        start, count = self.patches[name]
        return slice(start, start + count)

    @cached_property
    def face_centres(self) -> Array:
        """Centres of the faces (m), (faces, 3)."""
        return self._face_and_cell_geometry[0]

    @cached_property
    def face_areas(self) -> Array:
        """Area vectors of the faces (m^2), pointing out of the owner cell, (faces, 3)."""
        return self._face_and_cell_geometry[1]

    @cached_property
    def cell_centres(self) -> Array:
        """Centres of the cells (m), (cells, 3)."""
        return self._face_and_cell_geometry[2]

    @cached_property
    def cell_volumes(self) -> Array:
        """Volumes of the cells (m3)."""
        return self._face_and_cell_geometry[-1]

    @cached_property
    def _face_and_cell_geometry(self) -> tuple[Array, Array, Array, Array]:
        p = self.points[self.faces]
        middle = p.mean(axis=1)
        following = np.roll(p, -1, axis=1)
        n = 0.5 * np.cross(following - p, middle[:, None] - p)
        thirds = (p + following + middle[:, None]) / 3.0
        area = n.sum(axis=1)
        # Triangles are weighted by their area along the face's normal, as in OpenFOAM.
        unit = area / np.maximum(np.linalg.norm(area, axis=1, keepdims=True), 1e-300)
        weight = np.einsum("fti,fi->ft", n, unit)
        centre = np.einsum("ft,fti->fi", weight, thirds) / np.maximum(weight.sum(axis=1), 1e-300)[:, None]
        inside = len(self.neighbour)
        guess, count = np.zeros((self.cell_count, 3)), np.zeros(self.cell_count)
        for faces, cells in ((slice(None), self.owner), (slice(0, inside), self.neighbour)):
            guess += _sum_by_cell(cells, centre[faces], self.cell_count)
            count += np.bincount(cells, minlength=self.cell_count)
        guess /= count[:, None]
        volume, moment = np.zeros(self.cell_count), np.zeros((self.cell_count, 3))
        for faces, cells, sign in ((slice(None), self.owner, 1.0), (slice(0, inside), self.neighbour, -1.0)):
            f = centre[faces]
            pyramid = sign * np.einsum("fi,fi->f", area[faces], f - guess[cells]) / 3.0
            volume += np.bincount(cells, pyramid, self.cell_count)
            moment += _sum_by_cell(cells, pyramid[:, None] * (0.75 * f + 0.25 * guess[cells]), self.cell_count)
        return centre, area, moment / volume[:, None], volume


def _sum_by_cell(cells: Index, vectors: Array, count: int) -> Array:
    """Sum vectors over the cells; (count, 3)."""
    return np.stack([np.bincount(cells, vectors[:, i], count) for i in range(3)], axis=-1)


def make_poly_mesh(mesh: SectorMesh) -> PolyMesh:
    """Make faces, owners and boundaries of a sector mesh; renumber the cells to reduce the bandwidth.

    Raises
    ------
    MuflyError
        If more than two cells share a face, or the two periodic planes do not match.
    """
    hexahedra = mesh.hexahedra
    cells = len(hexahedra)
    faces = hexahedra[:, _HEXAHEDRON_FACES].reshape(-1, 4)
    of = np.repeat(np.arange(cells), 6)
    key = np.sort(faces, axis=1)
    order = np.lexsort(key.T[::-1])
    sorted_key = key[order]
    same = np.all(sorted_key[1:] == sorted_key[:-1], axis=1)
    if np.any(same[1:] & same[:-1]):
        raise MuflyError("mesh: a face is shared by three cells")
    # Plate faces are walls of the cells on both sides.
    same[same] = ~_is_face_among(sorted_key[:-1][same], np.sort(mesh.plate_faces, axis=1), len(mesh.points))
    first = order[:-1][same]
    second = order[1:][same]
    alone = np.ones(len(order), dtype=bool)
    alone[:-1] &= ~same
    alone[1:] &= ~same
    outside = np.sort(order[alone])

    graph = coo_array((np.ones(len(first)), (of[first], of[second])), shape=(cells, cells)).tocsr()
    new = np.empty(cells, dtype=np.int64)
    new[reverse_cuthill_mckee((graph + graph.T).tocsr(), symmetric_mode=True)] = np.arange(cells)
    a, b = new[of[first]], new[of[second]]
    inner = np.where((a < b)[:, None], faces[first], faces[second])  # normal out of the owner
    owner, neighbour = np.minimum(a, b), np.maximum(a, b)
    order = np.lexsort((neighbour, owner))
    inner, owner, neighbour = inner[order], owner[order], neighbour[order]

    shell, shell_of = faces[outside], new[of[outside]]
    marked = {name: mark[shell].all(axis=1) for name, mark in mesh.point_marks.items()}
    left = mesh.points[shell].mean(axis=1)[:, 0] < 0.0
    which = np.select(
        [marked["top"], marked["bottom"], marked["outer"], marked["sector"] & left, marked["sector"]],
        [PATCH_NAMES.index(n) for n in ("top", "bottom", "side", "sector_left", "sector_right")],
        PATCH_NAMES.index("blade"),
    )
    names: tuple[str, ...] = PATCH_NAMES
    if "lower" in mesh.point_marks:
        names = (*PATCH_NAMES, LOWER_ROTOR_BLADE_PATCH)
        own = mesh.point_marks["lower"][shell].all(axis=1)
        which[(which == PATCH_NAMES.index("blade")) & own] = len(PATCH_NAMES)
    all_faces, all_owners, patches = [inner], [owner], {}
    start = len(inner)
    left_faces = shell[which == 0]
    left_order, right_order, right_faces = _pair_periodic_faces(mesh, left_faces, shell[which == 1])
    for i, name in enumerate(names):
        at = np.flatnonzero(which == i)
        f = shell[at]
        if name == "sector_left":
            at, f = at[left_order], left_faces[left_order]
        elif name == "sector_right":
            at, f = at[right_order], right_faces
        all_faces.append(f)
        all_owners.append(shell_of[at])
        patches[name] = (start, len(f))
        start += len(f)
    strip = np.empty(cells, dtype=np.int64)
    strip[new] = mesh.cell_strip
    turning = np.empty(cells, dtype=bool)
    turning[new] = mesh.is_rotating
    return PolyMesh(
        mesh.points,
        np.concatenate(all_faces),
        np.concatenate(all_owners),
        neighbour,
        patches,
        strip,
        mesh.strip_edges_m,
        mesh.blade_count,
        turning,
        mesh.interface_height_m,
    )


def _is_face_among(faces: Index, wanted: Index, points: int) -> NDArray[np.bool_]:
    """Return which of the faces are also in ``wanted``; the first three of a face's sorted points identify it."""
    size = np.array([points**2, points, 1], dtype=np.int64)
    return np.isin(faces[:, :3] @ size, wanted[:, :3] @ size)


def _pair_periodic_faces(mesh: SectorMesh, left: Index, right: Index) -> tuple[Index, Index, Index]:
    """Pair the periodic faces; return the orders of the left and of the right faces, and the right faces in this order.

    Each returned right face starts at the partner of its left face's first point.
    """
    if len(left) != len(right):
        raise MuflyError(f"mesh: the periodic planes have {len(left)} and {len(right)} faces")
    turn = 2.0 * math.pi / mesh.blade_count
    c, s = math.cos(turn), math.sin(turn)
    # The right plane (x > 0), rotated about +z, coincides with the left plane.
    turned = mesh.points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    size = float(np.ptp(mesh.points[:, 2]))
    at_left, at_right = mesh.points[left].mean(axis=1) / size, turned[right].mean(axis=1) / size
    from scipy.spatial import cKDTree

    found = cKDTree(at_right).query(at_left)
    miss, partner = np.asarray(found[0]), np.asarray(found[1])
    if len(left) and (miss.max() > 1e-9 or len(np.unique(partner)) != len(left)):
        raise MuflyError(f"mesh: faces of the two periodic planes lie up to {miss.max() * size:.2g} m apart")
    order = np.lexsort((at_left[:, 2], np.hypot(at_left[:, 0], at_left[:, 1])))
    partner = partner[order]
    faces = right[partner][:, ::-1]
    begin = mesh.points[left[order][:, 0]]
    first = np.argmin(np.linalg.norm(turned[faces] - begin[:, None], axis=2), axis=1)
    # Reversed twice: faces keep their outward normal and start at the partner of the left face's first point.
    faces = faces[np.arange(len(faces))[:, None], (first[:, None] + np.arange(4)) % 4]
    return order, partner, np.concatenate((faces[:, :1], faces[:, :0:-1]), axis=1)


@result
class MeshQuality:
    """Quality measures of a mesh.

    Attributes
    ----------
    cells : int
        Number of cells.
    non_orthogonality_deg : float
        Greatest angle between a face's normal and the line of the cell centres; OpenFOAM warns from 70.
    mean_non_orthogonality_deg : float
        Mean non-orthogonality over the faces.
    severe : int
        Number of faces above 70 degrees.
    skewness : float
        Greatest skewness; OpenFOAM warns from 4.
    smallest_volume_m3 : float
        Volume of the smallest cell.
    max_cell_openness : float
        Greatest sum of a cell's area vectors, over the sum of areas; 0 for closed cells.
    aspect_ratio : float
        Greatest ratio of a cell's areas in the three directions.
    """

    cells: int
    non_orthogonality_deg: float
    mean_non_orthogonality_deg: float
    severe: int
    skewness: float
    smallest_volume_m3: float
    max_cell_openness: float
    aspect_ratio: float

    @property
    def is_good(self) -> bool:
        """True if the mesh is suitable for the solver."""
        return self.smallest_volume_m3 > 0.0 and self.non_orthogonality_deg < 85.0 and self.skewness < 4.0

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the measures and the verdict as printed text."""
        verdict = ("verdict", "good" if self.is_good else "not good: a solver may fail on it")
        names = "cells non_orthogonality_deg mean_non_orthogonality_deg severe skewness smallest_volume_m3 aspect_ratio"
        return (tabulate_fields(self, [*names.split(), verdict]),)


def measure_mesh_quality(mesh: PolyMesh) -> MeshQuality:
    """Measure the quality of a mesh as ``checkMesh`` does; the periodic planes are left out."""
    inside = len(mesh.neighbour)
    a, b = mesh.cell_centres[mesh.owner[:inside]], mesh.cell_centres[mesh.neighbour]
    area, centre = mesh.face_areas[:inside], mesh.face_centres[:inside]
    d = b - a
    cosine = np.einsum("fi,fi->f", d, area) / (np.linalg.norm(d, axis=1) * np.linalg.norm(area, axis=1))
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    to_a = np.einsum("fi,fi->f", area, centre - a)
    to_b = np.einsum("fi,fi->f", area, b - centre)
    part = np.abs(to_a) / np.maximum(np.abs(to_a) + np.abs(to_b), 1e-300)
    off = centre - (a + part[:, None] * d)
    length = np.linalg.norm(off, axis=1)
    unit = off / np.maximum(length, 1e-300)[:, None]
    own = np.max(np.abs(np.einsum("fi,fpi->fp", unit, mesh.points[mesh.faces[:inside]] - centre[:, None])), axis=1)
    skew = length / np.maximum(np.linalg.norm(d, axis=1), 0.2 * own)
    total, size = np.zeros((mesh.cell_count, 3)), np.zeros((mesh.cell_count, 3))
    for faces, cells, sign in ((slice(None), mesh.owner, 1.0), (slice(0, inside), mesh.neighbour, -1.0)):
        total += _sum_by_cell(cells, sign * mesh.face_areas[faces], mesh.cell_count)
        size += _sum_by_cell(cells, np.abs(mesh.face_areas[faces]), mesh.cell_count)
    return MeshQuality(
        mesh.cell_count,
        float(angle.max()),
        float(angle.mean()),
        int(np.sum(angle > 70.0)),
        float(skew.max()),
        float(mesh.cell_volumes.min()),
        float(np.max(np.abs(total) / np.maximum(size.max(axis=1, keepdims=True), 1e-300))),
        float(np.max(size.max(axis=1) / np.maximum(size.min(axis=1), 1e-300))),
    )


# ----------------------------------------------------------------------------
# Files


def format_foam_header(kind: str, name: str, place: str, *, binary: bool = False, note: str = "") -> str:
    """Return the header of an OpenFOAM file."""
    form = 'binary;\n    arch        "LSB;label=32;scalar=64"' if binary else "ascii"
    more = f'    note        "{note}";\n' if note else ""
    return (
        f"FoamFile\n{{\n    version     2.0;\n    format      {form};\n    class       {kind};\n{more}"
        f'    location    "{place}";\n    object      {name};\n}}\n\n'
    )


def write_poly_mesh(mesh: PolyMesh, case: Path) -> Path:
    """Write ``constant/polyMesh`` of a case with the rotating zones ``rotor`` and ``lower``; return the folder."""
    folder = case / "constant" / "polyMesh"
    folder.mkdir(parents=True, exist_ok=True)
    note = f"nPoints:{len(mesh.points)}  nCells:{mesh.cell_count}  nFaces:{len(mesh.faces)}  "
    note += f"nInternalFaces:{len(mesh.neighbour)}"
    place = "constant/polyMesh"

    def write_openfoam_list(name: str, kind: str, *parts: bytes) -> None:
        head = format_foam_header(kind, name, place, binary=True, note=note if name in ("owner", "neighbour") else "")
        (folder / name).write_bytes(head.encode() + b"\n".join(parts) + b"\n")

    def encode_block(values: NDArray, count: int) -> bytes:
        return f"{count}\n(".encode() + np.ascontiguousarray(values).tobytes() + b")"

    def encode_labels(values: Index) -> bytes:
        return encode_block(values.astype("<i4"), len(values))

    write_openfoam_list("points", "vectorField", encode_block(mesh.points.astype("<f8"), len(mesh.points)))
    starts = np.arange(0, 4 * len(mesh.faces) + 1, 4)
    write_openfoam_list("faces", "faceCompactList", encode_labels(starts), encode_labels(mesh.faces.ravel()))
    write_openfoam_list("owner", "labelList", encode_labels(mesh.owner))
    write_openfoam_list("neighbour", "labelList", encode_labels(mesh.neighbour))
    turn = 360.0 / mesh.blade_count
    entries = []
    for name, (start, count) in mesh.patches.items():
        kind, more = "patch", ""
        if name in ("blade", LOWER_ROTOR_BLADE_PATCH):
            kind, more = "wall", "inGroups 1(wall);"
        elif name.startswith("sector"):
            other = "sector_right" if name == "sector_left" else "sector_left"
            kind = "cyclic"
            more = (
                f"matchTolerance 1e-4; transform rotational; rotationAxis (0 0 1); rotationCentre (0 0 0); "
                f"neighbourPatch {other};"
            )
        entries.append(f"    {name} {{ type {kind}; {more} nFaces {count}; startFace {start}; }}")
    text = format_foam_header("polyBoundaryMesh", "boundary", place, note=f"sector of {turn:g} degrees")
    (folder / "boundary").write_text(text + f"{len(entries)}\n(\n" + "\n".join(entries) + "\n)\n", encoding="utf-8")
    zone = format_foam_header("regIOobject", "cellZones", place, binary=True).encode()
    zones = {"rotor": 1.0, **({"lower": -1.0} if LOWER_ROTOR_BLADE_PATCH in mesh.patches else {})}
    zone += f"{len(zones)}\n(\n".encode()
    for name, sense in zones.items():
        zone += f"{name}\n{{\n    type cellZone;\n    cellLabels List<label> ".encode()
        zone += encode_labels(np.flatnonzero(mesh.cell_rotation_sign == sense)) + b";\n}\n"
    zone += b")\n"
    (folder / "cellZones").write_bytes(zone)
    np.savez(
        folder / _STRIPS_FILE,
        strip=mesh.cell_strip,
        edges_m=mesh.strip_edges_m,
        blades=mesh.blade_count,
        turning=mesh.is_rotating,
        middle_m=mesh.interface_height_m,
    )
    return folder


_STRIPS_FILE = "strips.npz"


def read_poly_mesh(case: Path) -> PolyMesh:
    """Read a mesh written by :func:`write_poly_mesh`.

    Raises
    ------
    InputError
        If a file is missing or truncated.
    """
    folder = case / "constant" / "polyMesh"
    try:
        data = {name: (folder / name).read_bytes() for name in ("points", "faces", "owner", "neighbour", "boundary")}
        with np.load(folder / _STRIPS_FILE) as more:
            strip, edges, blades = more["strip"], more["edges_m"], int(more["blades"])
            turning, middle = more["turning"], float(more["middle_m"]) if "middle_m" in more else -math.inf
        points = _decode_lists(data["points"], "<f8", 3)[0].reshape(-1, 3)
        faces = _decode_lists(data["faces"], "<i4", 1, 2)[1].reshape(-1, 4)
        owner = _decode_lists(data["owner"], "<i4", 1)[0]
        neighbour = _decode_lists(data["neighbour"], "<i4", 1)[0]
        text = data["boundary"].decode()
        patches = {
            name: (int(start), int(count))
            for name, count, start in re.findall(r"(\w+) \{ type.*?nFaces (\d+); startFace (\d+);", text)
        }
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise InputError(
            str(folder), "", f"is not a complete mesh of `mufly cfd` ({error})", "write it again"
        ) from error
    return PolyMesh(
        points,
        faces.astype(np.int64),
        owner.astype(np.int64),
        neighbour.astype(np.int64),
        patches,
        strip,
        edges,
        blades,
        turning,
        middle,
    )


def _decode_lists(data: bytes, kind: str, each: int, lists: int = 1) -> list[NDArray]:
    at, out = data.index(b"}") + 1, []
    for _ in range(lists):
        begin = data.index(b"(", at) + 1
        count = int(data[at : begin - 1].split()[0])
        at = begin + count * each * np.dtype(kind).itemsize
        if at >= len(data):
            raise ValueError("cut short")
        out.append(np.frombuffer(data[begin:at], dtype=kind))
        at += 1
    return out
