"""Counter-rotating pairs in CFD: actuator disc for the other rotor, or two frozen rotors in one mesh.

**Actuator disc.** In the frame of a rotor the azimuthal mean of the other rotor's loads is steady. Each rotor therefore
has its own case and mesh, with the other rotor as an actuator disc. Its force per area follows from the loads of the
other case, by radius ::

    down  (dT/dr) / (2 pi r),     azimuthal, in the other rotor's sense  (dQ/dr) / (2 pi r^2)

The two cases alternate until their loads converge (:func:`mufly.cfd.case_studies.solve_rotor_pair`). Mean thrust and
torque are correct to first order in the effect of blade passing; fluctuations are neglected. The disc is OpenFOAM's
``rotorDisk`` in the cells cut by the plane of the other rotor, with a profile for each radius whose coefficients give
these forces.

**Frozen rotors.** Both rotors share a mesh, each in its own frame. The upper disc lies at z = 0 and turns about +z, the
lower lies at -gap and turns the other way; its mesh is the image in x of a rotor that turns about +z. The two meshes
join at the horizontal plane half way, where their points coincide. Both blades keep the same azimuth: flow that leaves
one frame is treated as steady in the next. Unsteady effects of blade passing and azimuthal mixing of the swirl are
neglected.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mufly.cfd.meshes.polymesh import PolyMesh, format_foam_header
from mufly.cfd.meshes.section_mesh import CellCounts
from mufly.cfd.meshes.sector_mesh import MeshDomain, SectorMesh, make_sector_mesh
from mufly.cfd.openfoam_case import OperatingPoint
from mufly.errors import InputError, MuflyError
from mufly.rotor import Rotor

Array = NDArray[np.float64]


def make_pair_mesh(
    rotor: Rotor,
    pitch_rad: float,
    lower_pitch_rad: float,
    gap_m: float,
    *,
    level: str | CellCounts = "medium",
    domain: MeshDomain | None = None,
) -> SectorMesh:
    """Mesh a sector of two rotors of the same geometry, one above the other.

    Parameters
    ----------
    rotor : Rotor
        Rotor used for both discs.
    pitch_rad, lower_pitch_rad : float
        Pitch setting of the upper and the lower rotor.
    gap_m : float
        Distance between the discs.
    level, domain
        As for :func:`mufly.cfd.meshes.sector_mesh.make_sector_mesh`; heights of the domain count from the upper disc
        upwards and from the lower disc downwards.

    Raises
    ------
    InputError
        If a rotor cannot be meshed, or the two are too close.
    """
    if not 0.0 < gap_m < 2.0 * rotor.radius_m:
        raise InputError("pair", "gap", f"is {1e3 * gap_m:g} mm", f"give 0 to {2e3 * rotor.radius_m:g} mm")
    upper = make_sector_mesh(rotor, pitch_rad, level=level, domain=domain, other_m=-gap_m)
    lower = make_sector_mesh(rotor, lower_pitch_rad, level=level, domain=domain, other_m=gap_m)
    points = lower.points * np.array([-1.0, 1.0, 1.0]) - np.array([0.0, 0.0, gap_m])
    plane, below = np.flatnonzero(upper.point_marks["bottom"]), np.flatnonzero(lower.point_marks["top"])
    miss, at = cKDTree(upper.points[plane]).query(points[below])
    if len(plane) != len(below) or len(np.unique(at)) != len(plane) or np.max(miss) > 1e-9 * rotor.radius_m:
        raise MuflyError(
            f"mesh: {len(plane)} and {len(below)} points between the rotors, {np.max(miss):.2g} m apart: "
            "their pitch settings differ too much"
        )
    # Points of the lower mesh are numbered after those of the upper; points of the interface are the upper's.
    number = np.full(len(points), -1)
    number[below] = plane[at]
    own = number < 0
    number[own] = len(upper.points) + np.arange(int(own.sum()))
    marks = {
        name: np.concatenate((upper.point_marks[name], lower.point_marks[name][own])) for name in ("sector", "outer")
    }
    none_up, none_low = np.zeros(len(upper.points), dtype=bool), np.zeros(int(own.sum()), dtype=bool)
    marks["top"] = np.concatenate((upper.point_marks["top"], none_low))
    marks["bottom"] = np.concatenate((none_up, lower.point_marks["bottom"][own]))
    marks["lower"] = np.concatenate((none_up, ~none_low))
    # Reflection inverts a hexahedron: its two ends are exchanged.
    image = number[np.roll(lower.hexahedra, 4, axis=1)]
    strips = len(upper.strip_edges_m) - 1
    return replace(
        upper,
        points=np.concatenate((upper.points, points[own])),
        hexahedra=np.concatenate((upper.hexahedra, image)),
        cell_strip=np.concatenate((upper.cell_strip, np.where(lower.cell_strip < 0, -1, lower.cell_strip + strips))),
        point_marks=marks,
        plate_faces=np.empty((0, 4), dtype=np.int64),
        is_rotating=np.concatenate((upper.is_rotating, lower.is_rotating)),
        interface_height_m=-0.5 * gap_m,
    )


@dataclass(frozen=True)
class ActuatorDisc:
    """Actuator disc with the loads per span of a rotor.

    Attributes
    ----------
    r_m : tuple of float
        Radii, increasing.
    thrust_N_m, torque_Nm_m : tuple of float
        Loads per span of all blades at those radii; zero outside the first and the last.
    thrust_N, torque_Nm : float
        Thrust and torque of the whole rotor, equal to those of the disc.
    pitch_rad, speed_rad_s : float
        Pitch setting and speed of the rotor.
    set_iteration : int
        Iteration of the case at which these loads were set.
    """

    r_m: tuple[float, ...]
    thrust_N_m: tuple[float, ...]
    torque_Nm_m: tuple[float, ...]
    thrust_N: float
    torque_Nm: float
    pitch_rad: float
    speed_rad_s: float
    set_iteration: int = 0

    def scale_loads(self, ratio: float) -> ActuatorDisc:
        """Return the disc with its loads multiplied by a ratio."""
        return replace(
            self,
            thrust_N_m=tuple(ratio * x for x in self.thrust_N_m),
            torque_Nm_m=tuple(ratio * x for x in self.torque_Nm_m),
            thrust_N=ratio * self.thrust_N,
            torque_Nm=ratio * self.torque_Nm,
        )

    def relative_load_change(self, other: ActuatorDisc) -> float:
        """Return the relative difference from another disc in thrust or in torque, whichever is greater."""
        return max(
            abs(other.thrust_N - self.thrust_N) / abs(self.thrust_N),
            abs(other.torque_Nm - self.torque_Nm) / abs(self.torque_Nm),
        )


def find_disc_cells(mesh: PolyMesh, height_m: float, radius_m: float) -> tuple[NDArray[np.int64], Array]:
    """Return the cells cut by a horizontal plane within a radius, and the area (m^2) of each seen from above.

    The area is defined as in ``rotorDisk``: faces to cells outside whose normal has a vertical component above 0.8.
    """
    inside = len(mesh.neighbour)
    low, high = np.full(mesh.cell_count, np.inf), np.full(mesh.cell_count, -np.inf)
    z = mesh.points[mesh.faces][..., 2]
    for faces, cells in ((slice(None), mesh.owner), (slice(0, inside), mesh.neighbour)):
        np.minimum.at(low, cells, z[faces].min(axis=1))
        np.maximum.at(high, cells, z[faces].max(axis=1))
    near = np.hypot(mesh.cell_centres[:, 0], mesh.cell_centres[:, 1]) < radius_m
    cut = (low <= height_m) & (height_m < high) & near
    a, b = mesh.owner[:inside], mesh.neighbour
    up = mesh.face_areas[:inside, 2] / np.linalg.norm(mesh.face_areas[:inside], axis=1)
    size = np.linalg.norm(mesh.face_areas[:inside], axis=1)
    area = np.zeros(mesh.cell_count)
    area += np.bincount(a, size * (cut[a] & ~cut[b] & (up > _MIN_DISC_FACE_NORMAL_Z)), mesh.cell_count)
    area += np.bincount(b, size * (cut[b] & ~cut[a] & (up < -_MIN_DISC_FACE_NORMAL_Z)), mesh.cell_count)
    cells = np.flatnonzero(cut)
    return cells, area[cells]


_MIN_DISC_FACE_NORMAL_Z = 0.8


def write_actuator_disc(folder: Path, mesh: PolyMesh, point: OperatingPoint, disc: ActuatorDisc) -> None:
    """Write the other rotor's loads into a case as an actuator disc, at the height ``point.other_m``.

    Parameters
    ----------
    folder : Path
        Folder of a written case.
    mesh : PolyMesh
        Mesh of the case.
    point : OperatingPoint
    disc : ActuatorDisc

    Raises
    ------
    MuflyError
        If the plane cuts no cells, or the loads nearly cancel along the blade.
    """
    cells, area = find_disc_cells(mesh, point.other_m, point.radius_m)
    if not area.sum() > 0.0:
        raise MuflyError(f"mesh: no cells lie at the other rotor's height, {1e3 * point.other_m:g} mm")
    ends = (0.999 * disc.r_m[0], *disc.r_m, 1.001 * disc.r_m[-1])
    r = np.array(ends)
    thrust, torque = (np.array((0.0, *v, 0.0)) for v in (disc.thrust_N_m, disc.torque_Nm_m))
    # Coefficients for a chord of 1 m and a blade that turns at 1 rad/s in still air.
    lift = thrust / (point.density_kg_m3 * point.blades * 0.5 * r**2)
    drag = -torque / r / (point.density_kg_m3 * point.blades * 0.5 * r**2)
    # Cells only approximate rings: their sum is scaled to the rotor's loads.
    at = np.hypot(mesh.cell_centres[cells, 0], mesh.cell_centres[cells, 1])
    share = point.density_kg_m3 * point.blades**2 * 0.5 * at * area / (2.0 * math.pi)
    part = np.array(
        [
            disc.thrust_N / float(share @ np.interp(at, r, lift)),
            -disc.torque_Nm / float((share * at) @ np.interp(at, r, drag)),
        ]
    )
    if not np.all((part > 0.5) & (part < 2.0)):
        raise MuflyError(
            f"{folder}: the other rotor's loads nearly cancel along its blades (thrust {disc.thrust_N:.3g} N, torque "
            f"{disc.torque_Nm:.3g} N m): a disc of force cannot represent them"
        )
    lift, drag = part[0] * lift, part[1] * drag
    blade = "\n".join(f"        (at{i} ({x:.9g} 0 1))" for i, x in enumerate(r))
    profiles = "\n".join(
        f"        at{i} {{ type lookup; data ((-180 {d:.9g} {c:.9g}) (180 {d:.9g} {c:.9g})); }}"
        for i, (c, d) in enumerate(zip(lift, drag, strict=True))
    )
    text = format_foam_header("dictionary", "fvOptions", "constant") + (
        "other\n{\n    type rotorDisk;\n    active yes;\n    selectionMode cellSet;\n    cellSet disc;\n"
        f"    fields (U);\n    nBlades {point.blades};\n    tipEffect 2;\n    rpm {30.0 / math.pi:.12g};\n"
        f"    rhoRef {point.density_kg_m3:.9g};\n"
        "    inletFlowType fixed;\n    inletVelocity (0 0 0);\n    geometryMode specified;\n    origin (0 0 0);\n"
        "    axis (0 0 1);\n    refDirection (1 0 0);\n    trimModel fixedTrim;\n"
        "    fixedTrimCoeffs { theta0 0; theta1c 0; theta1s 0; }\n"
        "    flapCoeffs { beta0 0; beta1c 0; beta2s 0; }\n"
        f"    blade\n    {{\n        data\n        (\n{blade}\n        );\n    }}\n"
        f"    profiles\n    {{\n{profiles}\n    }}\n}}\n"
    )
    sets = folder / "constant" / "polyMesh" / "sets"
    sets.mkdir(parents=True, exist_ok=True)
    listed = "\n".join(str(i) for i in cells)
    (sets / "disc").write_text(
        format_foam_header("cellSet", "disc", "constant/polyMesh/sets") + f"{len(cells)}\n(\n{listed}\n)\n",
        encoding="utf-8",
    )
    (folder / "constant" / "fvOptions").write_text(text, encoding="utf-8")
    (folder / _ACTUATOR_DISC_FILE).write_text(json.dumps(asdict(disc), indent=1) + "\n", encoding="utf-8")


_ACTUATOR_DISC_FILE = "disc.json"


def read_actuator_disc(folder: Path) -> ActuatorDisc | None:
    """Read the actuator disc of a case; None if there is none.

    Raises
    ------
    InputError
        If its file is truncated.
    """
    file = folder / _ACTUATOR_DISC_FILE
    if not file.is_file():
        return None
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
        found: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in told.items()}
        return ActuatorDisc(**found)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(str(file), "", "is not a complete disc file", "delete the case and run it again") from error
