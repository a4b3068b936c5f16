"""The blades' surface with what the air does to it, for viewers of others: VTP (ParaView) and glTF 2.0 (browsers).

VTP is VTK's XML of polygons, version 1.0: arrays of little-endian numbers, each led by its length in bytes, appended in
base64 (VTK File Formats, kitware). A binary glTF is two chunks, JSON and numbers (Khronos glTF 2.0, sec. 4.4); it is
y up and in metres, so that the shaft lies along y there. Faces have colours of their own, not blended at corners.
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

from mufly.cfd.polymesh import PolyMesh
from mufly.cfd.results import Solution
from mufly.errors import InputError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
_TYPES = {"float64": "Float64", "int64": "Int64", "int32": "Int32"}


def blade_surface(mesh: PolyMesh, solution: Solution) -> tuple[Array, Index, dict[str, NDArray]]:
    """The walls of all blades: points, faces and what holds on the faces.

    Returns
    -------
    points : (points, 3) array
        m.
    faces : (faces, 4) array
        Anticlockwise from outside.
    data : dict of (faces,) and (faces, 3) arrays
        ``pressure_Pa``, ``friction_Pa`` (shear stress of the air on the wall), ``yplus``, ``blade``.
    """
    own = mesh.faces[mesh.patch("blade")][:, ::-1]  # the mesh's leave the air
    used, faces = np.unique(own, return_inverse=True)
    faces = faces.reshape(own.shape)
    points, shear, rings = [], [], []
    for i in range(mesh.blades):
        turn = 2.0 * math.pi * i / mesh.blades
        c, s = math.cos(turn), math.sin(turn)
        rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        points.append(mesh.points[used] @ rotation)
        shear.append(solution.friction_Pa @ rotation)
        rings.append(faces + i * len(used))
    n = mesh.blades
    data: dict[str, NDArray] = {
        "pressure_Pa": np.tile(solution.pressure_Pa, n), "friction_Pa": np.concatenate(shear),
        "yplus": np.tile(solution.yplus, n), "blade": np.repeat(np.arange(n), len(faces)),
    }  # fmt: skip
    return np.concatenate(points), np.concatenate(rings), data


def write_vtp(file: Path, points: Array, faces: Index, data: Mapping[str, NDArray]) -> Path:
    """Write polygons with data on their faces.

    Parameters
    ----------
    file : Path
    points : (points, 3) array
        m.
    faces : (faces, corners) array
    data : dict of (faces,) or (faces, 3) arrays

    Raises
    ------
    InputError
        If it cannot be written.
    """
    blocks: list[bytes] = []
    at = 0

    def array(name: str, values: NDArray) -> str:
        nonlocal at
        little = np.ascontiguousarray(values)
        raw = little.astype(little.dtype.newbyteorder("<")).tobytes()
        block = base64.b64encode(struct.pack("<Q", len(raw)) + raw)
        width = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        text = (
            f'<DataArray type="{_TYPES[little.dtype.name]}" Name={quoteattr(name)}{width} format="appended" '
            f'offset="{at}"/>'
        )
        blocks.append(block)
        at += len(block)
        return text

    each = faces.shape[1]
    parts = [
        "<Points>" + array("Points", np.asarray(points, dtype=np.float64)) + "</Points>",
        "<Polys>" + array("connectivity", faces.astype(np.int64).ravel())
        + array("offsets", each * np.arange(1, len(faces) + 1, dtype=np.int64)) + "</Polys>",
        "<CellData>" + "".join(array(name, values) for name, values in data.items()) + "</CellData>",
    ]  # fmt: skip
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">\n<PolyData>\n'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" '
        f'NumberOfPolys="{len(faces)}">\n' + "\n".join(parts) + "\n</Piece>\n</PolyData>\n"
        '<AppendedData encoding="base64">\n_'
    )
    return _write(file, text.encode() + b"".join(blocks) + b"\n</AppendedData>\n</VTKFile>\n")


def write_glb(
    file: Path, points: Array, faces: Index, colours: NDArray[np.uint8], name: str = "rotor"
) -> Path:
    """Write quadrilaterals, each in its own colour, as a binary glTF.

    Parameters
    ----------
    file : Path
    points : (points, 3) array
        m, z up.
    faces : (faces, 4) array
        Anticlockwise from outside.
    colours : (faces, 3) array of uint8
        Red, green, blue, linear.
    name : str

    Raises
    ------
    InputError
        If it cannot be written.
    """
    corner = points[faces][..., [0, 2, 1]] * np.array([1.0, 1.0, -1.0])  # z up becomes y up
    normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    position = corner.reshape(-1, 3).astype("<f4")
    first = 4 * np.arange(len(faces), dtype="<u4")[:, None]
    paint = np.full((len(faces), 4), 255, dtype=np.uint8)
    paint[:, :3] = colours
    arrays = [
        (position, 5126, "VEC3"), (np.repeat(normal, 4, axis=0).astype("<f4"), 5126, "VEC3"),
        (np.repeat(paint, 4, axis=0), 5121, "VEC4"),
        ((first + np.array([0, 1, 2, 0, 2, 3], dtype="<u4")).astype("<u4").ravel(), 5125, "SCALAR"),
    ]  # fmt: skip
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    at = 0
    for i, (values, kind, shape) in enumerate(arrays):
        size = values.nbytes
        views.append(
            {"buffer": 0, "byteOffset": at, "byteLength": size, "target": 34963 if i == 3 else 34962}
        )
        accessors.append(
            {"bufferView": i, "componentType": kind, "count": len(values), "type": shape}
            | ({"normalized": True} if i == 2 else {})
            | ({"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()} if i == 0 else {})
        )
        at += size
    tree = {
        "asset": {"version": "2.0", "generator": "mufly"},
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"name": name, "primitives": [
            {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}
        ]}],
        "materials": [{
            "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        }],
        "buffers": [{"byteLength": at}], "bufferViews": views, "accessors": accessors,
    }  # fmt: skip
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(values.tobytes() for values, _, _ in arrays)  # every part is a multiple of 4 long
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    return _write(
        file,
        head
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(body), b"BIN\0")
        + body,
    )


def pressure_colours(pressure_Pa: Array) -> NDArray[np.uint8]:
    """Colours of pressures, of the 1st to the 99th percentile; (faces, 3) array, linear as glTF wants them."""
    from matplotlib import colormaps

    low, high = np.percentile(pressure_Pa, (1, 99))
    shown = colormaps["viridis"]((pressure_Pa - low) / max(high - low, 1e-300))[:, :3]
    return np.round(255.0 * np.clip(shown, 0.0, 1.0) ** 2.2).astype(np.uint8)


def _write(file: Path, content: bytes) -> Path:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content)
    except OSError as error:
        raise InputError(
            str(file), "", f"cannot be written ({error.strerror or error})", "give another folder"
        ) from error
    return file
