"""Export of a rotor's blades: closed bodies to print or to draw with, and stations as a table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from mufly.errors import MuflyError, convert_write_errors
from mufly.results import ShownBlock, make_lines_block, result, select_fields
from mufly.rotor.blades.blade_solid import (
    TriangleSolid,
    blade_contours,
    join_solids,
    loft_solid,
    make_hub_solid,
    mirror_solid,
    rotate_about_shaft,
    write_step,
    write_stl,
)
from mufly.rotor.geometry import Rotor


@result(eq=False)
class ExportedBlade:
    """Body of a blade or a whole rotor in a file.

    Attributes
    ----------
    file : Path
    rotor : str
    body : TriangleSolid
    has_hub : bool
        Whether blades and a hub overlap where they meet.
    """

    file: Path
    rotor: str
    body: TriangleSolid
    has_hub: bool

    def as_record(self) -> dict[str, Any]:
        """Return file, size and tightness of the body."""
        return {
            "file": self.file, "triangles": len(self.body.triangles), "volume_mm3": 1e9 * self.body.volume_m3,
            "area_mm2": 1e6 * self.body.area_m2, **select_fields(self.body, "open_edges=count_open_edges"),
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return volume and area as printed text."""
        hub = "; bodies overlap where they meet, as slicers allow" if self.has_hub else ""
        size = f"{1e9 * self.body.volume_m3:.0f} mm3, {1e6 * self.body.area_m2:.0f} mm2"
        return (make_lines_block(f"{self.rotor}: {size}, closed{hub}"),)


def export_blade(
    rotor: Rotor, file: Path, *, pitch_rad: float = 0.0, whole: bool = False, clockwise: bool = False,
    tail_m: float = 0.0, hub_m: float = 0.0, bore_m: float = 0.0, stations: int = 60,
) -> ExportedBlade:  # fmt: skip
    """Write a blade along x as a closed body, or all blades around the shaft.

    Parameters
    ----------
    rotor : Rotor
    file : Path
        STL file (mm), or STEP file of one blade.
    pitch_rad : float
        Pitch setting, added to the twist.
    whole, clockwise : bool
        Whether the body has all blades; whether it turns clockwise, seen from above.
    tail_m : float
        Least thickness of the trailing edge.
    hub_m, bore_m : float
        Radius of the hub and of its bore; 0 for none.
    stations : int
        Number of stations along the blade.

    Raises
    ------
    InputError
        If the file cannot be written.
    MuflyError
        If the surface is open, or build123d cannot make a STEP file.
    """
    sections = blade_contours(rotor, along=stations, tail_m=tail_m, pitch_rad=pitch_rad)
    blade = loft_solid(sections)
    count = rotor.blades if whole else 1
    parts = [rotate_about_shaft(blade, 2.0 * math.pi * k / rotor.blades) for k in range(count)]
    if hub_m > 0.0:
        height = sections[0, :, 2]
        parts.append(make_hub_solid(hub_m, bore_m, float(height.min()), float(height.max())))
    body = join_solids([mirror_solid(p) for p in parts] if clockwise else parts)
    is_stl = file.suffix.lower() == ".stl"
    if is_stl and body.count_open_edges():
        raise MuflyError(f"{rotor.name}: {body.count_open_edges()} edges of the surface are open; give fewer stations")
    with convert_write_errors("--out", key=str(file)):
        if is_stl:
            write_stl(file, body, rotor.name)
        else:
            write_step(file, sections * np.array([1.0, -1.0 if clockwise else 1.0, 1.0]))
    return ExportedBlade(file, rotor.name, body, hub_m > 0.0)


def tabulate_export_stations(rotor: Rotor, stations: int, pitch_rad: float = 0.0) -> list[dict[str, float | str]]:
    """Return radius, chord, blade angle and nearest airfoil of each station, in the units of `mufly rotor import`."""
    x = np.linspace(float(rotor.hub_cutout), 1.0, stations)
    cut = rotor.sections_at(x)
    nearest = np.where(cut.second_weight < 0.5, cut.first_airfoil, cut.second_airfoil)
    columns = (1e3 * rotor.radius_m * x, 1e3 * cut.chord_m, np.degrees(cut.twist_rad + pitch_rad), nearest)
    return [
        {"r_mm": float(r), "chord_mm": float(c), "beta_deg": float(b), "airfoil": cut.airfoil_names[int(k)]}
        for r, c, b, k in zip(*columns, strict=True)
    ]
