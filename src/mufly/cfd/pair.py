"""Two rotors that turn against each other, as a frozen pair: one mesh, each rotor in a frame of its own.

The upper disc lies at z = 0 and turns about +z, the lower at -gap and turns the other way; its mesh is that of a rotor
turning about +z, its own image in x. Each is meshed as far as the level plane half way to the other, where both meshes
have the same points. Both blades stand at the same azimuth for good: what leaves one frame is taken to be steady in the
next. That leaves out all that a passage of blades does in time, and swirl is not mixed around the shaft.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mufly.cfd.mesh import Domain, Mesh, blade_mesh
from mufly.cfd.sections import Counts
from mufly.errors import InputError, MuflyError
from mufly.rotor import Rotor

Array = NDArray[np.float64]


def pair_mesh(
    rotor: Rotor,
    pitch_rad: float,
    lower_pitch_rad: float,
    gap_m: float,
    *,
    level: str | Counts = "medium",
    domain: Domain | None = None,
) -> Mesh:
    """Mesh one sector of two rotors of the same form, one above the other.

    Parameters
    ----------
    rotor : Rotor
        Both.
    pitch_rad, lower_pitch_rad : float
        Pitch setting of the upper and the lower one.
    gap_m : float
        Between their discs.
    level, domain
        As for :func:`mufly.cfd.mesh.blade_mesh`; the domain's heights are over the upper, under the lower disc.

    Raises
    ------
    InputError
        If a rotor cannot be meshed, or the two are too close.
    """
    if not 0.0 < gap_m < 2.0 * rotor.radius_m:
        raise InputError("pair", "gap", f"is {1e3 * gap_m:g} mm", f"give 0 to {2e3 * rotor.radius_m:g} mm")
    upper = blade_mesh(rotor, pitch_rad, level=level, domain=domain, other_m=-gap_m)
    lower = blade_mesh(rotor, lower_pitch_rad, level=level, domain=domain, other_m=gap_m)
    points = lower.points * np.array([-1.0, 1.0, 1.0]) - np.array([0.0, 0.0, gap_m])
    plane, below = np.flatnonzero(upper.marks["bottom"]), np.flatnonzero(lower.marks["top"])
    miss, at = cKDTree(upper.points[plane]).query(points[below])
    if len(plane) != len(below) or len(np.unique(at)) != len(plane) or np.max(miss) > 1e-9 * rotor.radius_m:
        raise MuflyError(
            f"mesh: {len(plane)} and {len(below)} points between the rotors, {np.max(miss):.2g} m apart: "
            "their pitch settings differ too much"
        )
    # The lower mesh's points take numbers after the upper's; those of the plane are the upper's.
    number = np.full(len(points), -1)
    number[below] = plane[at]
    own = number < 0
    number[own] = len(upper.points) + np.arange(int(own.sum()))
    marks = {
        name: np.concatenate((upper.marks[name], lower.marks[name][own])) for name in ("sector", "outer")
    }
    none_up, none_low = np.zeros(len(upper.points), dtype=bool), np.zeros(int(own.sum()), dtype=bool)
    marks["top"] = np.concatenate((upper.marks["top"], none_low))
    marks["bottom"] = np.concatenate((none_up, lower.marks["bottom"][own]))
    marks["lower"] = np.concatenate((none_up, ~none_low))
    # The image of a hexahedron is turned inside out: its two ends change places.
    image = number[lower.hexahedra][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    strips = len(upper.edges_m) - 1
    return replace(
        upper,
        points=np.concatenate((upper.points, points[own])),
        hexahedra=np.concatenate((upper.hexahedra, image)),
        strip=np.concatenate((upper.strip, np.where(lower.strip < 0, -1, lower.strip + strips))),
        marks=marks,
        plates=np.empty((0, 4), dtype=np.int64),
        turning=np.concatenate((upper.turning, lower.turning)),
        middle_m=-0.5 * gap_m,
    )
